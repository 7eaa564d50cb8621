"""Recordings that are not moorings, held against their simulations; this table says which kinds there are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from compasslib import calibration
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.verdict import Diagnosis

# Each module's diagnose(files, settings, options) returns the Diagnosis; a kind is imported only by its own job.
KINDS: dict[str, str] = {
    "platform": "compasslib.discrepancy.recordings.platform",
    "magnetometer": "compasslib.discrepancy.recordings.magnetometer",
    "two_heads": "compasslib.discrepancy.recordings.two_heads",
}


def diagnose(
    kind: str, files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None
) -> Diagnosis:
    """Return what a calibration's recording shows that its simulation does not hold.

    Args:
        kind: a key of ``KINDS``.
        files: raw files in the order of the YAML file.
        settings: keys of the YAML file, settled or not.
        options: what may be chosen.

    Raises:
        InputError: a file that cannot be read.
    """
    made: Diagnosis = import_module(KINDS[kind]).diagnose(files, calibration.settled(settings), options or Options())
    return made
