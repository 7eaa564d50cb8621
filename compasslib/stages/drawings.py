"""Draw calibrations, shared compasses and all moorings of a cruise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib.archive import calibrations as archive
from compasslib.archive.files import read_json
from compasslib.inference import product
from compasslib.plots import calibrations as plots
from compasslib.plots import deviation
from compasslib.plots import diagnosis as hypotheses
from compasslib.plots import moorings as together


def calibration_figures(
    name: str, /, *, calibration: str, table: str, points: str, figures: Sequence[str], say: Callable[[str], None]
) -> None:
    """Draw the figures of a calibration, each selected by its file name."""
    page = archive.read(calibration=calibration, table=table, points=points)
    for figure in figures:
        plots.draw_figure(Path(figure).stem, figure, page)
    say(f"{name}: {len(figures)} figures")


def diagnosis_figure(name: str, /, *, diagnosis: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw a calibration's residuals before and after, and the ranked hypotheses, in each format."""
    for figure in figures:
        hypotheses.draw_calibration(figure, read_json(diagnosis))
    say(f"{name}: figure of the diagnosis")


def joined_figures(name: str, /, *, joined: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw the figures of a shared compass (``joined``: compass.json), each selected by its file name."""
    content = read_json(joined)
    for figure in figures:
        deviation.draw_shared(Path(figure).stem, figure, content)
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
        together.AssessedMooring(Path(file).parent.name, product.from_json(read_json(file)).fit, read_json(assessment))
        for file, assessment in zip(deviations, assessments, strict=True)
    ]
    for figure in figures:
        if Path(figure).stem == "array":
            together.draw_array(figure, array)
        else:
            together.draw_figure(Path(figure).stem, figure, moorings)
    say(f"{len(figures)} figures of {len(moorings)} moorings")
