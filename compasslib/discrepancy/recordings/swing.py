"""A swing against the fitted curve: readings at headings as a bench's; a log along time is refused with its reason."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibration import swing
from compasslib.discrepancy import verdict
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import platform
from compasslib.discrepancy.verdict import Diagnosis

CONFOUNDED = "set and drift of the water are one function of the heading with B and C where speeds do not vary"
ALONG_TIME = (
    "this version does not search logs along time for left-out physics; calibration.json holds set and drift of the "
    "water, as far as the speeds tell them from B and C, beside the curve"
)


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
    if np.isfinite(made.points["time_s"]).all():
        return verdict.insufficient(ALONG_TIME, (("water_drift", ALONG_TIME),))
    recorded = made.points["recorded_deg"]
    correct = angles.wrap360(recorded + made.points["deviation_deg"])
    found = platform.judge(correct, recorded, field=settings.get("field"), options=options)
    return replace(found, not_testable=(*found.not_testable, ("water_drift", CONFOUNDED)))
