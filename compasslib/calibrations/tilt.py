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
from compasslib.calibrations.curves import FittedCurve, Points
from compasslib.calibrations.platform import read_columns
from compasslib.calibrations.result import Calibration
from compasslib.types import Bools, Floats

KIND = "tilt"
ROLES = ("reference_tilt_deg", "recorded_pitch_deg", "recorded_roll_deg")
AXES = ("pitch", "roll")
FORMS = {"line": "AB", "quadratic": "ABC", "cubic": "ABCD"}  # in powers of the recorded tilt
LEVEL_DEG = 0.5  # above the least reference tilt: both axes count as level


@dataclass(frozen=True)
class AxisReadings:
    """Readings with the platform tilted about one axis, (n,) each, degrees."""

    reference_deg: Floats  # with the instrument's sign convention
    recorded_deg: Floats
    turned_deg: float  # rotation of the instrument on the platform, from the other axis; NaN where unknown
    notes: tuple[str, ...] = ()


NOTHING = AxisReadings(np.zeros(0), np.zeros(0), np.nan)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate the pitch and the roll of a tilt sensor against the tilts of a platform, by CSV files of all three.

    The settings are ``columns``, ``withhold``, the keys of tables, ``budget`` and ``uncertainty``.

    Raises:
        InputError: a file cannot be read, or a column is absent or is not in degrees.
    """
    columns, notes = read_columns(files, settings, ROLES)
    known = np.isfinite(np.sum([columns[role] for role in ROLES], axis=0))
    reference, *recorded = (columns[role][known] for role in ROLES)
    readings, skew = split_axes(reference, np.array(recorded))
    given = settings.get("uncertainty") or {}
    rows = budget.sources(given, settings.get("budget"), KIND)
    warnings = [*notes, *(note for read in readings.values() for note in read.notes), *budget.notes(given, rows, KIND)]
    if not known.all():
        warnings.append(f"{int(np.sum(~known))} lines without reference tilt, pitch and roll are excluded")
    if skew:
        warnings.append(f"{skew} readings tilt pitch and roll together and are excluded: tilt one axis at a time")
    made = calibrate_axes(readings, rows, settings.get("field"))
    return replace(made, n=int(known.sum()) - skew, warnings=tuple(warnings))


def calibrate_axes(
    readings: Mapping[str, AxisReadings], sources: Sequence[Source], field: Mapping[str, float] | None = None
) -> Calibration:
    """Fit a polynomial to each axis; the larger of their scatters enters the budget."""
    fits = {axis: _fit(read) for axis, read in readings.items()}
    fitted = {axis: fit for axis, fit in fits.items() if isinstance(fit, FittedCurve)}
    reasons = "; ".join(f"{axis}: {fit}" for axis, fit in fits.items() if isinstance(fit, str))
    points = [_points(k, readings[axis], fits[axis]) for k, axis in enumerate(AXES)]
    empty = Calibration(
        kind=KIND,
        model="none",
        n=sum(len(read.recorded_deg) for read in readings.values()),
        coverage=0,
        sources=tuple(sources),
        points={name: np.concatenate([each[name] for each in points]) for name in points[0]},
    )
    if not fitted:
        return replace(empty, why=f"{reasons}; tilt the platform in 8 steps or more, one axis at a time")
    residuals = {axis: budget.residual(curve.scatter_deg, curve.dof) for axis, curve in fitted.items()}
    widest = max(residuals.values(), key=lambda row: row.standard_deg)
    described = {
        axis: _describe(axis, readings[axis], fitted[axis], (*sources, row)) for axis, row in residuals.items()
    }
    axes = {axis: described.get(axis, {"why": fit}) for axis, fit in fits.items()}
    residual = empty.points["residual_deg"]
    return replace(
        empty,
        model=", ".join(f"{axis} by a {curve.form.name}" for axis, curve in fitted.items()),
        residual_rms_deg=angles.rms(residual[np.isfinite(residual)]),
        sources=(*sources, widest),
        details={"axes": axes, "heading_error": _heading_error((*sources, widest), field)},
    )


def split_axes(
    reference_deg: Floats, recorded_deg: Floats, *, skew_deg: float = 1.0, skew_share: float = 0.25
) -> tuple[dict[str, AxisReadings], int]:
    """Assign each reading to the tilted axis, level readings to both; count and omit those with both axes tilted.

    The tilts of the platform, (n,), are signed or absolute; pitch and roll are (2, n).

    Args:
        skew_deg, skew_share: tilt of the other axis, absolute and relative, above which both are tilted.
    """
    if not len(reference_deg):
        return dict.fromkeys(AXES, NOTHING), 0
    size = np.abs(reference_deg)
    level = (size <= size.min() + LEVEL_DEG) & (size <= skew_deg)
    zero = np.median(recorded_deg[:, level], axis=1) if level.any() else np.zeros(2)
    lean = recorded_deg - zero[:, None]
    most, least = np.max(np.abs(lean), axis=0), np.min(np.abs(lean), axis=0)
    skew = ~level & (least > np.maximum(skew_deg, skew_share * most))
    axis = np.argmax(np.abs(lean), axis=0)
    readings = {
        name: _axis_readings(name, reference_deg, lean, recorded_deg[k], level | (axis == k) & ~skew, level, k)
        for k, name in enumerate(AXES)
    }
    return readings, int(skew.sum())


def _axis_readings(
    name: str,
    reference_deg: Floats,
    lean_deg: Floats,
    recorded_deg: Floats,
    chosen: Bools,
    level: Bools,
    k: int,
    *,
    same_tilt_deg: float = 0.2,
    turned_deg: float = 5.0,
) -> AxisReadings:
    """Convert the readings of one axis to the instrument's sign convention and average repeats of a setting.

    Args:
        same_tilt_deg: reference tilts that round to one multiple repeat a setting of the platform.
        turned_deg: rotation of the instrument on the platform that makes recorded tilts 0.4 % too small.
    """
    if not (chosen & ~level).any():
        return NOTHING
    reference, lean, other = reference_deg[chosen], lean_deg[k][chosen], lean_deg[1 - k][chosen]
    notes = []
    if np.min(reference) >= 0.0 and np.min(lean) < -LEVEL_DEG:
        reference = np.where(level[chosen], reference, np.sign(lean) * reference)
        notes = [f"{name}: reference tilts have no sign; that of the recorded tilt is taken"]
    elif np.sum(reference * lean) < 0.0:
        reference = -reference
        notes = [f"{name}: the platform counts tilts in the other sense; reference tilts are taken with the other sign"]
    slope = float(np.sum(other * lean) / np.sum(lean**2))
    turned = float(angles.wrap180(angles.direction(slope, 1.0)))
    if abs(turned) > turned_deg:
        notes.append(
            f"{name}: the other axis leans by {abs(slope):.0%} of it: the instrument stood turned by {turned:+.0f} "
            f"degrees on the platform, which makes the recorded tilt {1.0 - 1.0 / np.hypot(1.0, slope):.1%} too small"
        )
    _, which = np.unique(np.round(reference / same_tilt_deg), return_inverse=True)
    count = np.bincount(which)
    mean_reference, mean_recorded = (np.bincount(which, x) / count for x in (reference, recorded_deg[chosen]))
    return AxisReadings(mean_reference, mean_recorded, turned, tuple(notes))


def _fit(read: AxisReadings, *, min_dof: int = 4) -> FittedCurve | str:
    """Fit a polynomial with at least ``min_dof`` degrees of freedom; if it cannot be fitted, give the reason."""
    if not len(read.recorded_deg):
        return "no reading leans this axis alone"
    points = Points(read.recorded_deg, read.reference_deg - read.recorded_deg, np.ones(len(read.recorded_deg)))
    span = np.linspace(read.recorded_deg.min(), read.recorded_deg.max(), 21)
    # The highest degree allowed, not the best fit: otherwise the uncertainty would neglect undetected curvature.
    carried = [name for name, letters in FORMS.items() if len(points) - len(letters) >= min_dof]
    name = carried[-1] if carried else next(iter(FORMS))
    design = partial(np.vander, N=len(FORMS[name]), increasing=True)
    form = curves.series_form(name, FORMS[name], "Le Menn et al. 2023, section 2", design, around=span)
    return curves.fit_curve(form, points)


def _describe(
    axis: str, read: AxisReadings, curve: FittedCurve, rows: tuple[Source, ...], *, table_step_deg: float = 5.0
) -> dict[str, Any]:
    low, high = float(read.recorded_deg.min()), float(read.recorded_deg.max())
    steps = np.arange(np.ceil(low / table_step_deg), np.floor(high / table_step_deg) + 1) * table_step_deg
    sigma = np.hypot(curve.sigma(steps), budget.common(rows))
    error = -curve.deviation(np.linspace(low, high, 101))
    largest = float(error[np.argmax(np.abs(error))])
    return {
        **curves.curve_to_json(curve),
        "covariance": curve.covariance,
        "form": curve.form.name,
        "n": len(read.recorded_deg),
        "recorded_range_deg": [low, high],
        "max_error_deg": largest,
        "turned_deg": read.turned_deg,
        "expanded_deg": budget.expanded(rows),
        "common_deg": budget.common(rows),
        "table": {"recorded_deg": steps, "correction_deg": curve.deviation(steps), "sigma_deg": sigma},
        "text": f"{axis.capitalize()}: a {curve.form.name} through {len(read.recorded_deg)} tilts from {low:.1f} to "
        f"{high:.1f} degrees leaves {angles.rms(curve.residual_deg):.2f} degrees rms; the largest error is "
        f"{largest:+.2f} degrees, the expanded uncertainty of a corrected tilt "
        f"{budget.expanded(rows):.2f} degrees (k = 2).",
    }


def _heading_error(rows: tuple[Source, ...], field: Mapping[str, float] | None) -> dict[str, Any] | None:
    """Convert a tilt uncertainty to that of a tilt-compensated heading: times vertical over horizontal field."""
    if field is None:
        return None
    ratio = abs(field["vertical_nT"]) / field["horizontal_nT"]
    heading = ratio * budget.expanded(rows)
    text = f"A compass that levels its field by these tilts gains up to {heading:.2f} degrees of heading by them here"
    return {"expanded_deg": heading, "text": f"{text}: vertical over horizontal field is {ratio:.2f}."}


def _points(k: int, read: AxisReadings, fit: FittedCurve | str) -> dict[str, Floats]:
    correction = read.reference_deg - read.recorded_deg
    unknown = np.full(len(correction), np.nan)
    fitted = fit.deviation(read.recorded_deg) if isinstance(fit, FittedCurve) else unknown
    return {
        "axis": np.full(len(correction), float(k)),
        "reference_tilt_deg": read.reference_deg,
        "recorded_tilt_deg": read.recorded_deg,
        "correction_deg": correction,
        "residual_deg": correction - fitted,
    }
