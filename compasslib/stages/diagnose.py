"""Search for unmodelled effects: what the fit leaves, and the compass that is to correct the record."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from compasslib import deviation as deviations
from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.core.records import EarthField, Pairs
from compasslib.core.types import Floats
from compasslib.deviation.model import Fit
from compasslib.preparation import several
from compasslib.search import covariates, product, verdict

if TYPE_CHECKING:  # only where it searches: half of what its job imports
    from compasslib.search.case import Shared
    from compasslib.search.verdict import Diagnosis

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
    summary: str = "",
) -> None:
    """Write the diagnosis, and the fit with what was found and is applied.

    Args:
        wide: pairs that may stand further apart, from which the shear of the water is learnt.
        observatory: IAGA-2002 files of one observatory, perhaps none.
        options: of the mooring's diagnosis.
        summary: what other records of the compass may learn from this one, where there are others.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    near, along = several.together(netcdf.read_pairs(pairs)), earthfield.from_json(netcdf.read_json(field))
    series, units = logged(record, observatory, near)
    configured = netcdf.read_json(fit)
    fitted = deviations.from_json(configured)
    found = search(near, series, fitted, along, {**options, "tell": bool(summary)}, wide=wide, units=units)
    netcdf.write_json(diagnosis, found.to_json())
    netcdf.write_json(deviation, configured | {"applied": product.of(fitted, found).to_json(), "shared": None})
    if summary:
        netcdf.write_json(summary, _summary(mooring, near, fitted, along, found))
    say(found.log_line(mooring))


def logged(record: str, observatory: Sequence[str], near: Pairs) -> tuple[dict[str, Floats], dict[str, str]]:
    """Return what was logged beside the pairs, and the units of series that have no name of their own.

    The record by itself is not kept: its velocities are a third of the memory.
    """
    own = netcdf.read_record(record)
    return covariates.logged(own, observatory, at=near), dict(own.channel_units)


def search(
    near: Pairs,
    series: Mapping[str, Floats],
    fitted: Fit,
    along: EarthField,
    options: Mapping[str, Any],
    *,
    wide: str,
    units: Mapping[str, str],
    shared: Shared | None = None,
) -> Diagnosis:
    """Return what the pairs show that the fit does not hold; arguments as of ``search.kinds.mooring.diagnose``.

    Args:
        wide: the file of pairs that may stand further apart.
    """
    if not options["enabled"]:
        return verdict.insufficient(DISABLED)
    from compasslib.search.comparison import Options
    from compasslib.search.kinds.mooring import diagnose

    chosen = Options(**{name: value for name, value in options.items() if name != "enabled"})
    far = several.together(netcdf.read_pairs(wide))
    return diagnose(near, series, fitted, along, chosen, wide=far, units=units, shared=shared)


def _summary(mooring: str, near: Pairs, fitted: Fit, along: EarthField, found: Diagnosis) -> dict[str, Any]:
    from compasslib.joint import members
    from compasslib.search import sharing

    told = found.told or sharing.of_fit(fitted)
    place = float(np.mean(along.horizontal_nT)), float(np.mean(along.vertical_nT))
    return members.summary(
        mooring, place, told, span_s=near.time_s[[0, -1]].tolist() if len(near) else [], why=fitted.why
    )
