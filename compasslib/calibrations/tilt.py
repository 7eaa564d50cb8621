"""Calibration of a tilt sensor on a tilting platform: Le Menn et al. 2023, section 2 and Table 5."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import budget, curves
from compasslib.calibrations.budget import Source
from compasslib.calibrations.curves import CurveForm, FittedCurve, Points
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.tables import TWO_TURNS, read_columns
from compasslib.types import Floats

KIND = "tilt"
ROLES = ("reference_tilt_deg", "recorded_pitch_deg", "recorded_roll_deg")
AXES = ("pitch", "roll")
FORMS = {"line": "AB", "quadratic": "ABC", "cubic": "ABCD"}  # in powers of the recorded tilt


@dataclass(frozen=True)
class AxisReadings:
    """Readings with the platform tilted about one axis, (n,) each, degrees."""

    reference_deg: Floats  # with the instrument's sign convention
    recorded_deg: Floats


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate the pitch and the roll of a tilt sensor against the tilts of a platform, by CSV files of all three.

    Raises:
        InputError: a file cannot be read, or a column is absent or is not in degrees.
    """
    columns, notes = read_columns(files, settings, ROLES, bounds=TWO_TURNS)
    known = np.isfinite(np.sum([columns[role] for role in ROLES], axis=0))
    reference, *recorded = (columns[role][known] for role in ROLES)
    readings, skew, signs = split_axes(reference, np.array(recorded))
    rows, missing = budget.sources(settings.get("uncertainty") or {}, settings.get("budget"), KIND)
    warnings = [*notes, *signs, *missing]
    if not known.all():
        warnings.append(f"{int(np.sum(~known))} lines without reference tilt, pitch and roll are excluded")
    if skew:
        warnings.append(f"{skew} readings tilt pitch and roll together and are excluded: tilt one axis at a time")
    return replace(calibrate_axes(readings, rows), n=int(known.sum()) - skew, warnings=tuple(warnings))


def split_axes(
    reference_deg: Floats,  # tilts of the platform, (n,), signed or absolute
    recorded_deg: Floats,  # pitch and roll, (2, n)
    *,
    level_deg: float = 0.5,  # above the least reference tilt, both axes count as level
    skew_deg: float = 1.0,
    skew_share: float = 0.25,
    same_tilt_deg: float = 0.2,  # reference tilts that round to one multiple repeat a setting of the platform
) -> tuple[dict[str, AxisReadings], int, list[str]]:
    """Assign readings to the tilted axis, level ones to both, with the instrument's signs; repeats are averaged.

    Returns:
        The readings of each axis, the number of readings with both axes tilted, and notes on signs.
    """
    readings, notes = dict.fromkeys(AXES, AxisReadings(np.zeros(0), np.zeros(0))), list[str]()
    if not len(reference_deg):
        return readings, 0, notes
    size = np.abs(reference_deg)
    level = (size <= size.min() + level_deg) & (size <= skew_deg)
    zero = np.median(recorded_deg[:, level], axis=1) if level.any() else np.zeros(2)
    lean = recorded_deg - zero[:, None]
    most, least = np.max(np.abs(lean), axis=0), np.min(np.abs(lean), axis=0)
    skew = ~level & (least > np.maximum(skew_deg, skew_share * most))
    tilted = np.argmax(np.abs(lean), axis=0)
    for k, name in enumerate(AXES):
        chosen = level | (tilted == k) & ~skew
        if not (chosen & ~level).any():
            continue
        reference, leaning = reference_deg[chosen], lean[k][chosen]
        if np.min(reference) >= 0.0 and np.min(leaning) < -level_deg:
            reference = np.where(level[chosen], reference, np.sign(leaning) * reference)
            notes.append(f"{name}: reference tilts have no sign; that of the recorded tilt is taken")
        elif np.sum(reference * leaning) < 0.0:
            reference = -reference
            notes.append(f"{name}: the platform counts tilts in the other sense; their sign is changed")
        _, which, count = np.unique(np.round(reference / same_tilt_deg), return_inverse=True, return_counts=True)
        means = (np.bincount(which, x) / count for x in (reference, recorded_deg[k][chosen]))
        readings[name] = AxisReadings(*means)
    return readings, int(skew.sum()), notes


def calibrate_axes(readings: Mapping[str, AxisReadings], sources: Sequence[Source]) -> Calibration:
    """Fit a polynomial to each axis; the larger of their scatters enters the budget."""
    axes, points, fits, residuals = dict[str, Any](), [], dict[str, FittedCurve](), list[Source]()
    for k, axis in enumerate(AXES):
        read, fit = readings[axis], _fit(readings[axis])
        correction, fitted = read.reference_deg - read.recorded_deg, np.full(len(read.recorded_deg), np.nan)
        if isinstance(fit, FittedCurve):
            fits[axis], fitted = fit, fit.deviation(read.recorded_deg)
            residuals.append(budget.residual(fit.scatter_deg, fit.dof))
            axes[axis] = _describe(axis, read, fit, (*sources, residuals[-1]))
        else:
            axes[axis] = {"why": fit}
        points.append(
            {
                "axis": np.full(len(correction), float(k)),
                "reference_tilt_deg": read.reference_deg,
                "recorded_tilt_deg": read.recorded_deg,
                "correction_deg": correction,
                "residual_deg": correction - fitted,
            }
        )
    made = Calibration(
        kind=KIND,
        model="none",
        n=sum(len(read.recorded_deg) for read in readings.values()),
        coverage=0,
        sources=tuple(sources),
        points={name: np.concatenate([each[name] for each in points]) for name in points[0]},
    )
    if not fits:
        reasons = "; ".join(f"{axis}: {each['why']}" for axis, each in axes.items())
        return replace(made, why=f"{reasons}; tilt the platform in 8 steps or more, one axis at a time")
    return replace(
        made,
        model=", ".join(f"{axis} by a {fit.form.name}" for axis, fit in fits.items()),
        residual_rms_deg=angles.rms(made.points["residual_deg"]),
        sources=(*sources, max(residuals, key=lambda row: row.standard_deg)),
        details={"axes": axes},
    )


def _fit(read: AxisReadings, *, min_dof: int = 4) -> FittedCurve | str:
    if not len(read.recorded_deg):
        return "no reading leans this axis alone"
    # The highest degree allowed, not the best fit: otherwise the uncertainty would neglect undetected curvature.
    allowed = [name for name, letters in FORMS.items() if len(read.recorded_deg) - len(letters) >= min_dof]
    name = allowed[-1] if allowed else "line"
    design = partial(np.vander, N=len(FORMS[name]), increasing=True)
    span = np.linspace(read.recorded_deg.min(), read.recorded_deg.max(), 21)
    form = CurveForm(name, FORMS[name], "Le Menn et al. 2023, section 2", design, span)
    return curves.fit_curve(form, Points(read.recorded_deg, read.reference_deg - read.recorded_deg))


def _describe(axis: str, read: AxisReadings, curve: FittedCurve, rows: Sequence[Source]) -> dict[str, Any]:
    low, high = float(read.recorded_deg.min()), float(read.recorded_deg.max())
    steps = 5.0 * np.arange(np.ceil(low / 5.0), np.floor(high / 5.0) + 1)
    common, expanded = budget.common(rows), budget.expanded(rows)
    error = -curve.deviation(np.linspace(low, high, 101))
    largest = float(error[np.argmax(np.abs(error))])
    return {
        **curve.to_json(),
        "covariance": curve.covariance,
        "form": curve.form.name,
        "n": len(read.recorded_deg),
        "recorded_range_deg": [low, high],
        "max_error_deg": largest,
        "expanded_deg": expanded,
        "common_deg": common,
        "table": {
            "recorded_deg": steps,
            "correction_deg": curve.deviation(steps),
            "sigma_deg": np.hypot(curve.sigma(steps), common),
        },
        "text": f"{axis.capitalize()}: a {curve.form.name} through {len(read.recorded_deg)} tilts from {low:.1f} to "
        f"{high:.1f} degrees leaves {angles.rms(curve.residual_deg):.2f} degrees rms; the largest error is "
        f"{largest:+.2f} degrees, the expanded uncertainty of a corrected tilt {expanded:.2f} degrees (k = 2).",
    }
