"""A compass calibrated from the raw axes of its magnetometer: hard and soft iron, and what they do to the heading.

Le Menn et al. 2023, eqs. (1), (2) and section 6. The axes are forward, starboard, down unless a logged heading tells
otherwise. An ellipsoid gives G^T G only: the turn between magnetometer and instrument stays open, but for what tilts
and heading show. What the orientations do not determine is named and not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import readings
from compasslib.calibrations.magnetometer import counts, ellipsoid, heading, report
from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.choice import choose, far_off
from compasslib.calibrations.magnetometer.log import Log
from compasslib.calibrations.magnetometer.solve import Solved, solve
from compasslib.calibrations.result import Calibration
from compasslib.deviation import von_appen
from compasslib.types import Floats

KIND, NO_MODEL = "magnetometer", "none"
SECTOR_DEG = 10.0
NO_DIP = (
    "Hard and soft iron are found, but what they do to the heading depends on the dip: log the tilts, or give "
    "latitude, longitude and date."
)
FOLDED = (
    "The iron is stronger than the earth's horizontal field: a recorded heading has two correct ones and no table can "
    "correct it; take hard_iron off the raw axes instead."
)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the calibration of a magnetometer from its log.

    Args:
        files: CSV files with x, y and perhaps z, pitch_deg, roll_deg, heading_deg, time_utc.
        settings: ``columns``, ``withhold`` and ``field`` {horizontal_nT, vertical_nT, ...} or None.

    Raises:
        InputError: a column is absent or a cell is not a number.
    """
    log = counts.sound(magnetometer_log.read(files, settings))
    why = magnetometer_log.refusal(log)
    if why:
        return _refused(log, why)
    field = settings.get("field")
    axes, warnings = magnetometer_log.axes(log)
    choice = choose(log, log.raw @ axes.matrix.T)
    far = far_off(choice)
    if far.any():
        log = log.take(~far, f"{far.sum()} of {far.size} readings lie far off the fitted modulus and are left out.")
        choice = choose(log, log.raw @ axes.matrix.T)
    solved = solve(log, axes, choice, field)
    if solved is None:
        return _refused(log, choice.why)
    warnings = [*log.warnings, *warnings, *readings.dated(log.time_s, settings.get("date_s"))]
    return _described(solved, field, settings.get("columns") or {}, warnings)


def _refused(log: Log, why: str) -> Calibration:
    details = {"hard_iron": None, "soft_iron": None, "undetermined": [*ellipsoid.EVERY], "left_out": log.left_out}
    return Calibration(KIND, NO_MODEL, len(log.raw), 0, details=details, why=why, warnings=log.warnings)


def _described(
    solved: Solved, field: Mapping[str, float] | None, columns: Mapping[str, str], warnings: Sequence[str]
) -> Calibration:
    exact = heading.exact(solved.iron, solved.dip_ratio)
    known = bool(np.isfinite(exact).all())
    folded = known and not compass.turns_full_circle(exact)
    recorded, _ = solved.headings()
    misfits = report.misfits(solved)
    return Calibration(
        kind=KIND,
        model=solved.fitted.model.name,
        n=len(solved.log.raw),
        coverage=len(np.unique(recorded // SECTOR_DEG)),
        points=report.points(solved),
        details={**report.details(solved, field), "doubts": misfits},
        why=FOLDED if folded else "" if known else NO_DIP,
        warnings=(*warnings, *report.warnings(solved, field, columns), *misfits),
        **(_correction(solved, exact, folded=folded) if known else {}),
    )


def _correction(solved: Solved, exact: Floats, *, folded: bool) -> dict[str, Any]:
    """Return what the iron does to the heading; the exact coefficients alone where it folds."""
    each = zip(solved.replicates, solved.dip_replicates, strict=True)
    replicates = np.array([heading.exact(iron, float(dip)) for iron, dip in each])
    moved = heading.exact(solved.moved, solved.dip_ratio)
    found: dict[str, Any] = {"exact": exact, "exact_covariance": ellipsoid.covariance(replicates, moved - exact)}
    if folded:
        return found
    series, table = heading.series(exact), heading.table(exact, replicates, moved)
    each_series = np.array([heading.series(one) for one in replicates])
    return found | {
        "coefficients": series,
        "covariance": ellipsoid.covariance(each_series, heading.series(moved) - series),
        "residual_rms_deg": _residual(solved, series, exact),
        "sources": report.sources(solved, table, series),
        "table": table,
    }


def _residual(solved: Solved, series: Floats, exact: Floats) -> float:
    """Return the rms of the deviation about the series: of the readings, or along the circle without headings."""
    if solved.headed:
        recorded, corrected = solved.headings()
        deviation = angles.difference(corrected, recorded)
    else:
        recorded = heading.GRID_DEG
        deviation = heading.deviation(exact, recorded)
    return angles.rms(deviation - von_appen.predict(series, recorded))
