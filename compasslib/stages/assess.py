"""Assess the correction on pairs held out from the fit."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from compasslib.archive import netcdf
from compasslib.core import earthfield
from compasslib.deviation import assessment as assessments
from compasslib.preparation import several
from compasslib.search import covariates, product


def run(
    mooring: str,
    *,
    record: str,
    pairs: str,
    deviation: str,
    field: str,
    observatory: Sequence[str],
    assessment: str,
    say: Callable[[str], None],
) -> None:
    """Write how well the two instruments agree before and after.

    Raises:
        InputError: an observatory's file cannot be read.
    """
    own, both = netcdf.read_record(record), several.together(netcdf.read_pairs(pairs))
    along = earthfield.from_json(netcdf.read_json(field))
    made_by = product.from_json(netcdf.read_json(deviation))
    plain = product.plain(made_by, both, own, along, covariates.logged(own, observatory))
    verdict = assessments.assess(both, made_by.fit, plain)
    netcdf.write_json(assessment, verdict)
    say(assessments.log_line(mooring, verdict))
