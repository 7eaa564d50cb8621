"""Compare the results of the demonstration moorings whose errors are concealed with the truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from compasslib.archive import netcdf, provenance
from compasslib.archive.files import read_json
from compasslib.deviation.correction import correct_headings, record_readings
from compasslib.deviation.model import fit_from_json
from compasslib.plots.timeseries import error_reach
from compasslib.preparation.references import combine_references
from compasslib.report import concealed as revealing
from compasslib.report import write_page
from compasslib.types import Floats


def concealed(*, page: str, truths: Sequence[str], corrected: Sequence[str], say: Callable[[str], None]) -> None:
    """Write the page of the comparison; this is the only stage that reads the truth.

    Args:
        truths: file of the truth of each mooring; those without a corrected record are left out.
        corrected: corrected.nc of the moorings that were not stopped.
    """
    there = {Path(path).parent.name for path in corrected}
    root, shown = Path(page).parent, [path for path in truths if Path(path).stem in there]
    known = {Path(path).stem: read_json(path) for path in shown}
    errors = {name: revealing.heading_errors(truth, read_headings(root / name)) for name, truth in known.items()}
    reach = error_reach([error for x in errors.values() for error in (x.fit_deg, x.corrected_deg)])
    moorings = [revealing.reveal(name, root, truth, errors[name], reach) for name, truth in known.items()]
    write_page(page, "concealed.html", moorings=moorings, software=provenance.software())
    say(f"{page}: {len(moorings)} moorings beside the truth")


def read_headings(folder: Path) -> dict[str, Floats]:
    """Read the headings of a mooring's results: as recorded, by the fitted coefficients alone, and as corrected."""
    product = netcdf.read_corrected(folder / "corrected.nc", velocities=False)
    near = combine_references(netcdf.read_pairs(folder / "overlap.nc"))
    fit = fit_from_json(read_json(folder / "deviation.json")["fitted"])
    alone = correct_headings(record_readings(product.record), fit, near, None).heading_deg
    return {
        "time_s": product.record.time_s,
        "recorded_deg": product.record.heading_deg,
        "fit_deg": alone,
        "corrected_deg": product.heading_corrected_deg,
        "sigma_deg": product.heading_uncertainty_deg,
        "flag": np.asarray(product.heading_corrected_quality, dtype=float),
    }
