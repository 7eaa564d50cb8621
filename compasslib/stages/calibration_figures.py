"""Draw one calibration."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive import calibrations as archive
from compasslib.plots import calibrations as plots


def run(
    name: str, /, *, calibration: str, table: str, points: str, figures: Sequence[str], say: Callable[[str], None]
) -> None:
    """Draw each figure of its kind, by its file's name."""
    page = archive.read(calibration=calibration, table=table, points=points)
    for figure in figures:
        plots.draw(Path(figure).stem, figure, page)
    say(f"{name}: {len(figures)} figures")
