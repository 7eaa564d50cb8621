"""Search for left-out physics: what the fit leaves, and the compass that is to correct the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from compasslib import deviation as deviations
from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.preparation import several
from compasslib.search import covariates, product, verdict

DISABLED = "the search was switched off (diagnose: {enabled: false})"


def run(
    mooring: str,
    *,
    record: str,
    pairs: str,
    wide: str,
    fit: str,
    field: str,
    observatory: Sequence[str],
    diagnosis: str,
    deviation: str,
    options: Mapping[str, Any],
    say: Callable[[str], None],
) -> None:
    """Write the diagnosis, and the fit with what was found and is applied.

    Args:
        wide: pairs that may stand further apart, from which the shear of the water is learnt.
        observatory: IAGA-2002 files of one observatory, perhaps none.
        options: of the mooring's diagnosis.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    near, along = several.together(netcdf.read_pairs(pairs)), earthfield.from_json(netcdf.read_json(field))
    # The record by itself is not kept: its velocities are a third of the memory.
    own = netcdf.read_record(record)
    series, units = covariates.logged(own, observatory, at=near), own.channel_units
    del own
    configured = netcdf.read_json(fit)
    fitted = deviations.from_json(configured)
    if not options["enabled"]:
        found = verdict.insufficient(DISABLED)
    else:
        from compasslib.search.diagnosis import (  # only where it searches: half of what its job imports
            Options,
            diagnose,
        )

        chosen = Options(**{name: value for name, value in options.items() if name != "enabled"})
        far = several.together(netcdf.read_pairs(wide))
        found = diagnose(near, series, fitted, along, chosen, wide=far, units=units)
    netcdf.write_json(diagnosis, found.to_json())
    netcdf.write_json(deviation, configured | {"applied": product.of(fitted, found).to_json()})
    say(found.log_line(mooring))
