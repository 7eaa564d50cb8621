"""Draw moorings (currents, diagnosis, von Appen's Figs 6, 7 and 9, sections), calibrations, compasses and cruises."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from compasslib.archive import calibrations as stored
from compasslib.archive import netcdf, summary
from compasslib.archive.files import read_json, write_pictures
from compasslib.archive.gridded import read_section
from compasslib.inference import product as products
from compasslib.plots import page
from compasslib.plots import timeseries as water
from compasslib.plots.figures import FIGURES
from compasslib.plots.moorings import AssessedMooring
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
    data = SimpleNamespace(
        shown=shown,
        reference=reference,
        averaged=averaged,
        coarser=coarser,
        headings={"recorded": page.usable_headings(corrected), "corrected": corrected.heading_corrected_deg},
        pairs=both,
        product=corrected,
        fit=products.from_json(read_json(deviation)).fit,
        diagnosis=read_json(diagnosis),
        assessment=read_json(assessment),
        histograms=summary.read_histograms(histograms),
    )
    _draw("mooring", figures, data)
    write_pictures(pictures, [figure for figure in figures if figure.endswith(".png")])
    say(f"{mooring}: {len(figures)} figures")


def _draw(subject: str, figures: Sequence[str], data: Any) -> None:
    """Draw the figures of a subject, each by its row of the table, from the data of the subject."""
    rows = {row.name: row for row in FIGURES[subject]}
    for figure in figures:
        rows[Path(figure).stem].draw(figure, data)


def sections(mooring: str, *, gridded: str, figures: Sequence[str], pictures: str, say: Callable[[str], None]) -> None:
    """Draw the section, the mean profile and the rotary spectra of the gridded velocities."""
    data = SimpleNamespace(means=read_section(gridded), series=summary.read_depth_series(gridded))
    _draw("sections", figures, data)
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
    content = read_json(diagnosis[0]) if diagnosis else None
    _draw("calibration", figures, SimpleNamespace(stored=made, diagnosis=content))
    say(f"{name}: {len(figures)} figures")


def joined_figures(name: str, /, *, joined: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw the figures of a shared compass (``joined``: compass.json), each selected by its file name."""
    _draw("compass", figures, read_json(joined))
    say(f"{name}: {len(figures)} figures")


def cruise_figures(
    *,
    deviations: Sequence[str],
    assessments: Sequence[str],
    array: Sequence[Mapping[str, Any]],
    figures: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Draw the configured ``array`` and the figures of all moorings that have results."""
    moorings = [
        AssessedMooring(Path(file).parent.name, products.from_json(read_json(file)).fit, read_json(assessment))
        for file, assessment in zip(deviations, assessments, strict=True)
    ]
    _draw("cruise", figures, SimpleNamespace(moorings=moorings, array=array))
    say(f"{len(figures)} figures of {len(moorings)} moorings")
