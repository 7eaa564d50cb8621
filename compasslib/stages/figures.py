"""Draw moorings (currents, diagnosis, von Appen's Figs 6, 7 and 9, sections), calibrations, compasses and cruises."""

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from compasslib.archive import netcdf, summary
from compasslib.archive.calibrations import StoredCalibration, read_table
from compasslib.archive.files import embed_png, read_csv, read_json, write_json
from compasslib.archive.gridded import read_depth_series, read_section
from compasslib.inference import product as products
from compasslib.plots import page
from compasslib.plots import timeseries as water
from compasslib.plots.figures import FIGURES
from compasslib.plots.moorings import AssessedMooring
from compasslib.preparation.references import combine_references
from compasslib.stages import Files, Say, Settings


def figures(mooring: str, files: Files, say: Say) -> None:
    """Draw the figures of a mooring in each format, and write the PNGs as data URIs for the report."""
    both = combine_references(netcdf.read_pairs(files.pairs))
    corrected = netcdf.read_corrected(files.product, velocities=False)
    shown, reference = summary.read_bin_currents(files.product), summary.reference_current(both)
    data = SimpleNamespace(
        shown=shown,
        reference=reference,
        averaged=water.average_currents(shown, reference),
        coarser=water.average_currents(shown, reference, 70),  # more sticks cannot be told apart
        headings={"recorded": page.usable_headings(corrected), "corrected": corrected.heading_corrected_deg},
        pairs=both,
        product=corrected,
        fit=products.from_json(read_json(files.deviation)).fit,
        diagnosis=read_json(files.diagnosis),
        histograms=summary.read_histograms(files.histograms),
    )
    _draw("mooring", mooring, files.product, files, data, say)


def sections(mooring: str, files: Files, say: Say) -> None:
    """Draw the section, the mean profile and the rotary spectra of the gridded velocities."""
    data = SimpleNamespace(means=read_section(files.gridded), series=read_depth_series(files.gridded))
    _draw("sections", mooring, files.gridded, files, data, say)


def calibration_figures(name: str, files: Files, say: Say) -> None:
    """Draw the figures of a calibration, among them those of its ``diagnosis``, if it has one."""
    stored = StoredCalibration(read_json(files.calibration), read_table(files.table), read_csv(files.points))
    diagnosis = read_json(files.diagnosis[0]) if files.diagnosis else None
    _draw("calibration", name, files.calibration, files, SimpleNamespace(stored=stored, diagnosis=diagnosis), say)


def joined_figures(name: str, files: Files, say: Say) -> None:
    """Draw the figures of a shared compass, by its compass.json (``joined``)."""
    _draw("compass", name, files.joined, files, read_json(files.joined), say)


def cruise_figures(files: Files, say: Say, *, array: Sequence[Settings]) -> None:
    """Draw the configured ``array`` and the figures of all moorings that have results."""
    moorings = [
        AssessedMooring(Path(file).parent.name, products.from_json(read_json(file)).fit, read_json(assessment))
        for file, assessment in zip(files.deviations, files.assessments, strict=True)
    ]
    data = SimpleNamespace(moorings=moorings, array=array)
    _draw("cruise", f"{len(moorings)} moorings", files.usable, files, data, say)


def _draw(subject: str, name: str, sibling: str, files: Files, data: Any, say: Say) -> None:
    """Draw the figures of a subject, each by its row of the table, and delete those of formats no longer configured.

    Args:
        sibling: a file beside the folder ``figures`` of the subject.
        data: what the rows draw.
    """
    rows = {row.name: row for row in FIGURES[subject]}
    for former in {*Path(sibling).parent.glob("figures/*")} - {*map(Path, files.figures)}:
        if former.stem in rows:
            former.unlink()
    for figure in files.figures:
        rows[Path(figure).stem].draw(figure, data)
    if hasattr(files, "pictures"):
        pictures = [Path(figure) for figure in files.figures if figure.endswith(".png")]
        write_json(files.pictures, {picture.stem: embed_png(picture) for picture in pictures})
    say(f"{name}: {len(files.figures)} figures")
