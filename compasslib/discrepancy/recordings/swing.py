"""A swing against the fitted curve: readings at headings as a bench's, a log along time by its own search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from compasslib import angles
from compasslib.calibration import swing
from compasslib.discrepancy import verdict
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import platform, swing_log
from compasslib.discrepancy.verdict import Diagnosis

CONFOUNDED = "set and drift of the water are one function of the heading with B and C where speeds do not vary"


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Return what a swing shows that its fitted curve does not hold.

    Args:
        files: a table of readings, or logs.
        settings: settled keys of the calibration's file.
        options: what may be chosen.
    """
    made = swing.calibrate(files, settings)
    if made.why or not len(made.points.get("recorded_deg", ())):
        return verdict.insufficient(made.why or "no reading is left")
    if swing_log.along_time(made.points["time_s"]):
        return swing_log.diagnose(files, settings, options, made)
    recorded = made.points["recorded_deg"]
    correct = angles.wrap360(recorded + made.points["deviation_deg"])
    found = platform.judge(correct, recorded, field=settings.get("field"), options=options)
    return replace(found, not_testable=(*found.not_testable, ("water_drift", CONFOUNDED)))
