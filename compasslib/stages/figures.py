"""Draw one mooring: currents before and after, diagnosis, von Appen's Figs 6, 7 and 9, sections, the record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive import netcdf, summary, tables
from compasslib.archive.files import read_json, write_pictures
from compasslib.archive.gridded import read_section
from compasslib.inference import product as products
from compasslib.plots import deviation as curve
from compasslib.plots import diagnosis as hypotheses
from compasslib.plots import page
from compasslib.plots import timeseries as water
from compasslib.preparation.references import combine_references


def figures(
    mooring: str,
    *,
    pairs: str,
    deviation: str,
    diagnosis: str,
    assessment: str,
    histograms: str,
    product: str,
    gridded: Sequence[str],
    figures: Sequence[str],
    pictures: str,
    say: Callable[[str], None],
) -> None:
    """Draw the figures of a mooring in each format, and write the PNGs as data URIs for the report."""
    both, corrected = combine_references(netcdf.read_pairs(pairs)), netcdf.read_corrected(product, velocities=False)
    shown, reference = summary.read_bin_currents(product), summary.reference_current(both)
    averaged, coarser = (water.average_currents(shown, reference, n) for n in (summary.MAX_MEANS, summary.MAX_STICKS))
    headings = {"recorded": page.usable_headings(corrected), "corrected": corrected.heading_corrected_deg}
    counts = tables.read_histograms(histograms)
    section = read_section(gridded[0], water.COLUMNS) if gridded else None
    for ending in dict.fromkeys(Path(figure).suffix for figure in figures):
        to = {Path(figure).stem: figure for figure in figures if figure.endswith(ending)}
        water.draw_sticks(to["sticks"], coarser)
        water.draw_progressive(to["progressive"], averaged)
        water.draw_roses(to["roses"], shown, reference, headings)
        hypotheses.draw_mooring(to["diagnosis"], read_json(diagnosis))
        curve.draw_deviation(to["deviation"], both, products.from_json(read_json(deviation)).fit)
        curve.draw_histograms(to["histograms"], counts, read_json(assessment))
        curve.draw_scatter(to["scatter"], both, corrected)
        water.draw_timeline(to["timeline"], corrected, both)
        if section is not None:
            water.draw_section(to["section"], section)
            water.draw_profile(to["profile"], section)
    write_pictures(pictures, [figure for figure in figures if figure.endswith(".png")])
    say(f"{mooring}: {len(figures)} figures")


def sections(
    mooring: str, *, gridded: Sequence[str], figures: Sequence[str], pictures: str, say: Callable[[str], None]
) -> None:
    """Draw section and mean profile of a mooring with several affected instruments."""
    section = read_section(gridded[0], water.COLUMNS)
    for figure in figures:
        (water.draw_section if Path(figure).stem == "section" else water.draw_profile)(figure, section)
    write_pictures(pictures, [figure for figure in figures if figure.endswith(".png")])
    say(f"{mooring}: {len(figures)} figures")
