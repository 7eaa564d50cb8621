"""A compass on a bench whose directions are known: Le Menn et al. 2023, sections 2 and 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.calibration import budget, curves, readings
from compasslib.calibration.curves import Readings
from compasslib.calibration.result import Calibration, Source

ROLES = ("reference_deg", "recorded_deg")


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the calibration on a bench.

    Args:
        files: CSV files with the magnetic reference direction and the recorded heading, degrees.
        settings: ``columns``, ``withhold``, ``table_step_deg``, ``budget``, ``uncertainty``.

    Raises:
        InputError: a file cannot be read, or a column is absent or is not in degrees.
    """
    columns = readings.read(files, settings, required=ROLES)
    readings.check_degrees(columns, files)
    known = np.isfinite(columns["reference_deg"] + columns["recorded_deg"])
    read = Readings(*(columns[role][known] for role in ROLES))
    rows = budget.sources(settings.get("uncertainty") or {}, settings.get("budget"))
    step = float(settings.get("table_step_deg", 10.0))
    found = curves.calibration("platform", read, rows, table_step_deg=step)
    return replace(found, warnings=(*_left_out(int(np.sum(~known))), *found.warnings, *_missing(rows)))


def _left_out(count: int) -> list[str]:
    return [f"{count} lines without both headings are left out"] if count else []


def _missing(rows: tuple[Source, ...]) -> list[str]:
    names = budget.absent(rows)
    if not names:
        return []
    holds = "only the scatter about the curve" if not rows else "the other rows only"
    return [f"the budget has no row {', '.join(names)}: the expanded uncertainty holds {holds}"]
