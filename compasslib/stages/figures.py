"""Draw one mooring: currents before and after, diagnosis, von Appen's Figs 6, 7 and 9, the record along time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive import currents, netcdf
from compasslib.archive import pictures as small
from compasslib.inference import product as products
from compasslib.plots import agreement, curves, timeline
from compasslib.plots import currents as water
from compasslib.plots import deviation as curve
from compasslib.plots import diagnosis as hypotheses
from compasslib.preparation import several


def figures(
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
    shown, reference = currents.of_product(product), currents.of_reference(both)
    averaged = water.averaged(shown, reference)
    headings = {"recorded": curves.usable_headings(corrected), "corrected": corrected.heading_corrected_deg}
    to = {Path(figure).stem: figure for figure in figures}
    water.sticks(to["sticks"], averaged)
    water.progressive(to["progressive"], averaged)
    water.roses(to["roses"], shown, reference, headings)
    hypotheses.of_mooring(to["diagnosis"], netcdf.read_json(diagnosis))
    curve.deviation(to["deviation"], both, products.from_json(netcdf.read_json(deviation)).fit)
    agreement.scatter(to["scatter"], both, corrected)
    timeline.timeline(to["timeline"], corrected, both)
    small.write(pictures, figures)
    say(f"{mooring}: {len(figures)} figures")
