"""Draw a calibration's diagnosis."""

from __future__ import annotations

from collections.abc import Callable

from compasslib.archive.files import read_json
from compasslib.plots import diagnosis as hypotheses


def run(name: str, /, *, diagnosis: str, figure: str, say: Callable[[str], None]) -> None:
    """Draw where the mismatch lives, before and after, and the ranked hypotheses."""
    hypotheses.of_calibration(figure, read_json(diagnosis))
    say(f"{name}: figure of the diagnosis")
