"""Decline to diagnose a tilt sensor's calibration: it has no headings, on which the catalogue's effects act."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from compasslib.inference import diagnosis
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis

WHY = "a tilt sensor's calibration has no headings, on which the effects of the catalogue act"


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Explain why a tilt sensor's calibration is not diagnosed."""
    return diagnosis.insufficient(WHY)
