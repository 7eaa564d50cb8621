"""Draw moorings (currents, diagnosis, von Appen's Figs 6, 7 and 9, sections), calibrations, compasses and cruises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib.archive import calibrations as stored
from compasslib.archive import netcdf, summary
from compasslib.archive.files import read_json, write_pictures
from compasslib.archive.gridded import read_section
from compasslib.inference import product as products
from compasslib.plots import calibrations, page
from compasslib.plots import deviation as curve
from compasslib.plots import diagnosis as hypotheses
from compasslib.plots import moorings as together
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
    figures: Sequence[str],
    pictures: str,
    say: Callable[[str], None],
) -> None:
    """Draw the figures of a mooring in each format, and write the PNGs as data URIs for the report."""
    both, corrected = combine_references(netcdf.read_pairs(pairs)), netcdf.read_corrected(product, velocities=False)
    shown, reference = summary.read_bin_currents(product), summary.reference_current(both)
    averaged, coarser = (water.average_currents(shown, reference, n) for n in (summary.MAX_MEANS, summary.MAX_STICKS))
    headings = {"recorded": page.usable_headings(corrected), "corrected": corrected.heading_corrected_deg}
    counts = summary.read_histograms(histograms)
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
    write_pictures(pictures, [figure for figure in figures if figure.endswith(".png")])
    say(f"{mooring}: {len(figures)} figures")


def sections(mooring: str, *, gridded: str, figures: Sequence[str], pictures: str, say: Callable[[str], None]) -> None:
    """Draw the section and the mean profile of the gridded velocities."""
    section = read_section(gridded, water.COLUMNS)
    for figure in figures:
        (water.draw_section if Path(figure).stem == "section" else water.draw_profile)(figure, section)
    write_pictures(pictures, [figure for figure in figures if figure.endswith(".png")])
    say(f"{mooring}: {len(figures)} figures")


def calibration_figures(
    name: str,
    /,
    *,
    calibration: str,
    table: str,
    points: str,
    diagnosis: Sequence[str],
    figures: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Draw the figures of a calibration, each selected by its file name; ``diagnosis``: its file, if it has one."""
    made = stored.read(calibration=calibration, table=table, points=points)
    for figure in figures:
        if Path(figure).stem == "diagnosis":
            hypotheses.draw_calibration(figure, read_json(diagnosis[0]))
        else:
            calibrations.draw_figure(Path(figure).stem, figure, made)
    say(f"{name}: {len(figures)} figures")


def joined_figures(name: str, /, *, joined: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw the figures of a shared compass (``joined``: compass.json), each selected by its file name."""
    content = read_json(joined)
    for figure in figures:
        curve.draw_shared(Path(figure).stem, figure, content)
    say(f"{name}: {len(figures)} figures")


def cruise_figures(
    *,
    deviations: Sequence[str],
    assessments: Sequence[str],
    array: Sequence[Mapping[str, Any]],
    figures: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Draw the configured array and the figures of all moorings that have results, each selected by its file name.

    Args:
        deviations: deviation.json of each mooring with results.
        assessments: assessment.json of the same moorings.
        array: arguments of ``plots.moorings.draw_array``.
    """
    moorings = [
        together.AssessedMooring(Path(file).parent.name, products.from_json(read_json(file)).fit, read_json(assessment))
        for file, assessment in zip(deviations, assessments, strict=True)
    ]
    for figure in figures:
        if Path(figure).stem == "array":
            together.draw_array(figure, array)
        else:
            together.draw_figure(Path(figure).stem, figure, moorings)
    say(f"{len(figures)} figures of {len(moorings)} moorings")
