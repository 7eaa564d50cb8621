"""Compare forms of the deviation curve on pairs held out from each."""

from __future__ import annotations

from collections.abc import Callable

from compasslib.archive import netcdf
from compasslib.deviation import assessment
from compasslib.inference import product
from compasslib.preparation import several


def run(mooring: str, *, pairs: str, deviation: str, forms: str, say: Callable[[str], None]) -> None:
    """Write which form predicts best; no other stage waits for it."""
    made_by = product.from_json(netcdf.read_json(deviation))
    compared = assessment.compare_forms(several.together(netcdf.read_pairs(pairs)), made_by.fit)
    netcdf.write_json(forms, {"forms": compared})
    say(assessment.forms_line(mooring, compared))
