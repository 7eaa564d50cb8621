"""Draw calibrations and shared compasses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive import calibrations as archive
from compasslib.archive.files import read_json
from compasslib.plots import calibrations as plots
from compasslib.plots import deviation
from compasslib.plots import diagnosis as hypotheses


def calibration_figures(
    name: str, /, *, calibration: str, table: str, points: str, figures: Sequence[str], say: Callable[[str], None]
) -> None:
    """Draw each figure of its kind, by its file's name."""
    page = archive.read(calibration=calibration, table=table, points=points)
    for figure in figures:
        plots.draw_figure(Path(figure).stem, figure, page)
    say(f"{name}: {len(figures)} figures")


def diagnosis_figure(name: str, /, *, diagnosis: str, figure: str, say: Callable[[str], None]) -> None:
    """Draw where the mismatch lives, before and after, and the ranked hypotheses."""
    hypotheses.draw_calibration(figure, read_json(diagnosis))
    say(f"{name}: figure of the diagnosis")


def joined_figures(name: str, /, *, joined: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw each figure, by its file's name.

    Args:
        joined: compass.json.
    """
    content = read_json(joined)
    for figure in figures:
        deviation.draw_shared(Path(figure).stem, figure, content)
    say(f"{name}: {len(figures)} figures")
