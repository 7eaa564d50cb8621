"""Draw one mooring: the equivalents of von Appen's Figs 6 to 9, and the record along time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive import netcdf
from compasslib.archive import pictures as small
from compasslib.plots import agreement, timeline
from compasslib.plots import deviation as curve
from compasslib.plots import diagnosis as hypotheses
from compasslib.preparation import several
from compasslib.search import product as products


def run(
    mooring: str,
    *,
    pairs: str,
    deviation: str,
    diagnosis: str,
    product: str,
    figures: Sequence[str],
    pictures: str,
    say: Callable[[str], None],
) -> None:
    """Draw each figure, by its file's name, and write small ones for the page."""
    both, corrected = several.together(netcdf.read_pairs(pairs)), netcdf.read_corrected(product, velocities=False)
    fit = products.from_json(netcdf.read_json(deviation)).fit
    to = {Path(figure).stem: figure for figure in figures}
    curve.deviation(to["deviation"], both, fit, mooring)
    hypotheses.of_mooring(to["diagnosis"], netcdf.read_json(diagnosis), mooring)
    agreement.histograms(to["histograms"], both, corrected, mooring, method=fit.method)
    agreement.scatter(to["scatter"], both, corrected, mooring, method=fit.method)
    timeline.timeline(to["timeline"], corrected, both, mooring, method=fit.method)
    small.write(pictures, figures)
    say(f"{mooring}: {len(figures)} figures")
