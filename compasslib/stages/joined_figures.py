"""Draw one compass that several records share."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.archive.files import read_json
from compasslib.plots import compass


def run(name: str, /, *, joined: str, figures: Sequence[str], say: Callable[[str], None]) -> None:
    """Draw each figure, by its file's name.

    Args:
        joined: compass.json.
    """
    content = read_json(joined)
    for figure in figures:
        compass.draw(Path(figure).stem, figure, content)
    say(f"{name}: {len(figures)} figures")
