"""A compass calibrated from the raw axes of its magnetometer: hard and soft iron, and what they do to the heading.

Le Menn et al. 2023, eqs. (1), (2) and section 6. The axes are forward, starboard, down unless a logged heading tells
otherwise. An ellipsoid gives G^T G only: the turn between magnetometer and instrument stays open, but for what tilts
and heading show. What the orientations do not determine is named and not fitted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibration import ellipsoid, magnetometer_heading, magnetometer_log
from compasslib.calibration.ellipsoid import Fitted, Readings
from compasslib.calibration.magnetometer_choice import Choice, choose
from compasslib.calibration.magnetometer_heading import of_each
from compasslib.calibration.magnetometer_log import Axes, Log
from compasslib.calibration.result import Calibration, Source, Table
from compasslib.deviation import von_appen

Floats = NDArray[np.floating]

KIND = "magnetometer"
SECTOR_DEG = 10.0
TILT_SENSOR_DEG = 0.20  # standard: Le Menn et al. 2023, section 2, gives 0.40 degrees expanded
WEAK_FIELD_NT = 5000.0  # Le Menn et al. 2023, section 7
FOLLOWS = 0.5  # scatter about the corrected heading over that about the raw one
TURNS = ("forward", "starboard", "vertical")


@dataclass(frozen=True)
class _Solved:
    """The iron with the turn that tilts show, and all that a heading needs."""

    choice: Choice
    readings: Readings
    iron: Floats  # (12,)
    replicates: Floats  # (blocks, 12)
    levelling: Floats  # (n, 3, 3)
    dip_ratio: float  # NaN where unknown
    turn_deg: Floats  # (3,) about forward, starboard, down; NaN where open
    turn_sigma_deg: Floats  # (3,)
    logged_is_correct: bool = False  # the logged heading follows the corrected axes


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the calibration of a magnetometer from its log.

    Args:
        files: CSV files with x, y and perhaps z, pitch_deg, roll_deg, heading_deg, time_utc.
        settings: ``columns``, ``withhold`` and ``field`` {horizontal_nT, vertical_nT, ...} or None.

    Raises:
        InputError: a column is absent or a cell is not a number.
    """
    log = magnetometer_log.read(files, settings)
    why = magnetometer_log.refusal(log)
    if why:
        return _refused(log, why)
    axes, said = magnetometer_log.axes(log)
    body = log.raw @ axes.matrix.T
    choice = choose(log, body)
    if choice.fitted is None or choice.readings is None:
        return _refused(log, choice.why)
    solved = _on_heading(log, axes, _solved(log, choice, choice.fitted, choice.readings, settings.get("field")))
    return _described(log, axes, solved, settings.get("field"), [*log.warnings, *said])


def _refused(log: Log, why: str) -> Calibration:
    details = {"hard_iron": None, "soft_iron": None, "undetermined": [*ellipsoid.EVERY], "left_out": log.left_out}
    return Calibration(KIND, "none", len(log.raw), 0, details=details, why=why, warnings=log.warnings)


def _solved(log: Log, choice: Choice, fitted: Fitted, readings: Readings, field: Mapping[str, float] | None) -> _Solved:
    """Turn the iron into the frame of the tilt sensor where tilts in space show how, and find the dip."""
    iron, replicates = fitted.iron()
    open_turn = np.full(3, np.nan)
    levelling = log.levelling()
    if choice.level or not log.tilted:
        known = 0.0 if choice.level else np.nan if field is None else field["vertical_nT"] / field["horizontal_nT"]
        return _Solved(choice, readings, iron, replicates, levelling, known, open_turn, open_turn)
    down = levelling[:, 2, :]
    turn, sine, turned = magnetometer_heading.tilt_angles(iron, readings, down)
    block = ellipsoid.blocks(len(readings))
    each = [
        magnetometer_heading.tilt_angles(one, readings.take(block != k), down[block != k])
        for k, one in enumerate(replicates)
    ]
    sigma = ellipsoid.sigma(np.array([one[0] for one in each]))
    dip_ratio = sine / float(np.sqrt(max(1.0 - sine**2, 1e-6)))
    return _Solved(choice, readings, turned, np.array([one[2] for one in each]), levelling, dip_ratio, turn, sigma)


def _on_heading(log: Log, axes: Axes, solved: _Solved) -> _Solved:
    """Turn the iron about the vertical onto a logged heading that follows the corrected axes better than the raw ones.

    Such a heading knows what is correct, so it shows how the magnetometer is mounted.
    """
    if log.heading_deg is None or np.isfinite(axes.vertical_deg) or not (log.tilted or solved.choice.level):
        return solved
    recorded, corrected = magnetometer_heading.headings(solved.iron, solved.readings, solved.levelling)
    raw, off = (angles.difference(log.heading_deg, heading) for heading in (recorded, corrected))
    centre = float(angles.mean(off))
    scatter = angles.rms(angles.difference(off, centre))
    if scatter > FOLLOWS * angles.rms(angles.difference(raw, angles.mean(raw))):
        return solved
    block = ellipsoid.blocks(len(off))
    own = [
        angles.mean(
            angles.difference(
                log.heading_deg, magnetometer_heading.headings(one, solved.readings, solved.levelling)[1]
            )[block != k]
        )
        for k, one in enumerate(solved.replicates)
    ]
    turn, sigma = solved.turn_deg.copy(), solved.turn_sigma_deg.copy()
    turn[2] = float(angles.wrap180(centre))
    sigma[2] = float(ellipsoid.sigma(angles.difference(own, centre)))
    replicates = np.array([_about_down(one, float(a)) for one, a in zip(solved.replicates, own, strict=True)])
    return replace(
        solved,
        iron=_about_down(solved.iron, centre),
        replicates=replicates,
        turn_deg=turn,
        turn_sigma_deg=sigma,
        logged_is_correct=True,
    )


def _about_down(iron: Floats, angle_deg: float) -> Floats:
    """Return iron whose corrected headings are an angle larger."""
    matrix = magnetometer_log.about_down(angle_deg) @ iron[3:].reshape(3, 3)
    return np.append(iron[:3], matrix.ravel())


def _described(
    log: Log, axes: Axes, solved: _Solved, field: Mapping[str, float] | None, warnings: list[str]
) -> Calibration:
    recorded, corrected = magnetometer_heading.headings(solved.iron, solved.readings, solved.levelling)
    value = magnetometer_heading.exact(solved.iron, solved.dip_ratio)
    why = _no_heading(solved, value)
    headed = log.tilted or solved.choice.level
    points = _points(log, solved, recorded if headed else None, corrected if headed else None)
    common: dict[str, Any] = {
        "kind": KIND,
        "model": solved.choice.fitted.model.name if solved.choice.fitted else "none",
        "n": len(log.raw),
        "coverage": len(np.unique(recorded // SECTOR_DEG)),
        "points": points,
        "details": _details(log, axes, solved, field, points),
        "warnings": (*warnings, *_warnings(log, solved, field)),
        "why": why,
    }
    if not np.isfinite(value).all():
        return Calibration(**common)
    exact = of_each(lambda one: magnetometer_heading.exact(one, solved.dip_ratio), solved.replicates)
    common |= {"exact": value, "exact_covariance": ellipsoid.covariance(exact)}
    if why:
        return Calibration(**common)
    series = magnetometer_heading.series(value)
    table = magnetometer_heading.table(value, exact)
    rms = _residual(series, value, points)
    return Calibration(
        **common,
        coefficients=series,
        covariance=ellipsoid.covariance(of_each(magnetometer_heading.series, exact)),
        residual_rms_deg=rms,
        sources=_sources(log, solved, table, series),
        table=table,
    )


def _no_heading(solved: _Solved, exact: Floats) -> str:
    if not np.isfinite(exact).all():
        return (
            "Hard and soft iron are found, but what they do to the heading depends on the dip: log the tilts, or give "
            "latitude, longitude and date."
        )
    if not compass.turns_full_circle(exact):
        return (
            "The iron is stronger than the earth's horizontal field: a recorded heading has two correct ones and no "
            "table can correct it; take hard_iron off the raw axes instead."
        )
    return ""


def _residual(series: Floats, exact: Floats, points: Mapping[str, Floats]) -> float:
    """Return the rms of the deviation about the series, of the readings where they have headings."""
    if "recorded_deg" in points:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
    else:
        recorded = magnetometer_heading.GRID_DEG
        deviation = magnetometer_heading.deviation(exact, recorded)
    return angles.rms(deviation - von_appen.predict(series, recorded))


def _points(log: Log, solved: _Solved, recorded: Floats | None, corrected: Floats | None) -> dict[str, Floats]:
    """Return the columns of what was read and of what it becomes, in the file's unit, body frame."""
    scale, readings = solved.choice.scale, solved.readings
    level = solved.levelling[:, 2, :] if solved.choice.level else np.zeros_like(readings.field)
    field = ellipsoid.corrected(solved.iron[:3], solved.iron[3:].reshape(3, 3), readings)
    size = scale * _gain(solved)
    points = {name: scale * readings.field[:, k] for k, name in enumerate(("forward", "starboard", "down"))}
    points |= {f"{name}_corrected": size * field[:, k] for k, name in enumerate(("forward", "starboard", "down"))}
    points["modulus"] = scale * ellipsoid.modulus(readings.field, level)
    points["modulus_corrected"] = size * ellipsoid.modulus(field, level)
    if recorded is not None and corrected is not None:
        points |= {"recorded_deg": recorded, "corrected_deg": corrected}
        points["deviation_deg"] = angles.difference(corrected, recorded)
    extra = {"pitch_deg": log.pitch_deg, "roll_deg": log.roll_deg, "logged_deg": log.heading_deg, "time_s": log.time_s}
    return points | {name: values for name, values in extra.items() if values is not None}


def _gain(solved: _Solved, iron: Floats | None = None) -> float:
    """Return the field's modulus over the readings' scale: the mean of the axes that are seen."""
    soft = np.linalg.inv((solved.iron if iron is None else iron)[3:].reshape(3, 3))
    return float(np.mean(np.diag(soft)[: 2 if solved.choice.level else 3]))


def _soft(solved: _Solved, iron: Floats) -> Floats:
    """Return the soft iron S over the mean of its seen diagonal, body frame, (3, 3)."""
    return np.linalg.inv(iron[3:].reshape(3, 3)) / _gain(solved, iron)


def _details(
    log: Log, axes: Axes, solved: _Solved, field: Mapping[str, float] | None, points: Mapping[str, Floats]
) -> dict[str, Any]:
    choice, to_file = solved.choice, axes.matrix.T
    centre = choice.scale * solved.replicates[:, :3] @ axes.matrix
    full = choice.full.iron()[1] if choice.full else solved.replicates
    spread = full if len(choice.scores) > 1 and choice.fitted is not choice.full else solved.replicates
    soft = np.array([to_file @ _soft(solved, one) @ axes.matrix for one in spread])
    open_names = _open(solved, axes)
    modulus, after = points["modulus"], points["modulus_corrected"]
    field_size = choice.scale * _gain(solved)
    details: dict[str, Any] = {
        "model": choice.fitted.model.name if choice.fitted else "none",
        "axes": axes.text,
        "hard_iron": _seen(choice.scale * to_file @ solved.iron[:3], choice.level),
        "hard_iron_sigma": _seen(ellipsoid.sigma(centre), choice.level),
        "soft_iron": _seen(to_file @ _soft(solved, solved.iron) @ axes.matrix, choice.level),
        "soft_iron_sigma": _seen(ellipsoid.sigma(soft), choice.level),
        "undetermined": list(open_names),
        "undetermined_why": open_names,
        "standard_error_of_field": choice.weakest,
        "scores": choice.scores,
        "noise": field_size * (choice.fitted.noise if choice.fitted else np.nan),
        "field_in_file_unit": field_size,
        "field_is": "horizontal" if choice.level else "total",
        "modulus_residual_percent": {"before": _scatter(modulus), "after": _scatter(after)},
        "harmonics_percent": _harmonics(solved, points),
        "misalignment_deg": _misalignment(solved, axes),
        "left_out": log.left_out,
    }
    if field is not None:
        strength = field["horizontal_nT"] if choice.level else np.hypot(field["horizontal_nT"], field["vertical_nT"])
        details["counts_per_nT"] = field_size / float(strength)
    return details


def _seen(values: Floats, level: bool) -> list[Any]:
    """Return an array for JSON, null where a level platform shows nothing."""
    shown = values.astype(object)
    if level:
        shown[2, ...] = None
        if shown.ndim == 2:
            shown[:, 2] = None
    return shown.tolist()


def _scatter(modulus: Floats) -> float:
    return float(100.0 * modulus.std() / modulus.mean())


def _harmonics(solved: _Solved, points: Mapping[str, Floats]) -> dict[str, Any] | None:
    """Return the harmonics of the horizontal modulus against the heading, before and after; None without headings."""
    if "recorded_deg" not in points:
        return None
    field = ellipsoid.corrected(solved.iron[:3], solved.iron[3:].reshape(3, 3), solved.readings)
    down = solved.levelling[:, 2, :]
    pairs = {
        "before": (ellipsoid.modulus(solved.readings.field, down), points["recorded_deg"]),
        "after": (ellipsoid.modulus(field, down), points["corrected_deg"]),
    }
    named = {}
    for when, (modulus, heading) in pairs.items():
        first, second = magnetometer_heading.harmonics(modulus, heading)
        named[when] = {"first": first, "second": second}
    return named


def _misalignment(solved: _Solved, axes: Axes) -> dict[str, Any]:
    """Return the angles from the magnetometer to the instrument with their sigma, None where open."""
    value, sigma = solved.turn_deg.copy(), solved.turn_sigma_deg.copy()
    if np.isfinite(axes.vertical_deg):
        value[2], sigma[2] = axes.vertical_deg, axes.vertical_sigma_deg
    return {
        name: {"value": float(v), "sigma": float(s)} if np.isfinite(v) else None
        for name, v, s in zip(TURNS, value, sigma, strict=True)
    }


def _open(solved: _Solved, axes: Axes) -> dict[str, str]:
    """Return all that stays undetermined with its reason, the turns of the magnetometer too."""
    reason = "an ellipsoid is the same however the sensor is turned; only tilts and a logged heading show it"
    turns = [name for name, angle in _misalignment(solved, axes).items() if angle is None]
    return {**solved.choice.undetermined, **{f"turn about {name}": reason for name in turns}}


def _warnings(log: Log, solved: _Solved, field: Mapping[str, float] | None) -> list[str]:
    said = []
    if solved.logged_is_correct:
        said.append("The logged heading follows the corrected axes: it counts as correct and shows the mounting, A.")
    else:
        said.append("A is zero by convention: a magnetometer does not see how it is mounted about the vertical.")
    if solved.choice.level and not log.tilted:
        said.append("No tilts: the readings count as level, and the correction holds for a level instrument.")
    if solved.choice.level:
        said.append("Hard iron in x and y holds what the vertical field induces there; it changes with the dip.")
    if "S11" in solved.choice.undetermined:
        said.append("Soft iron is not determined: hard iron and headings assume that there is none.")
    if not solved.choice.level and not log.tilted:
        said.append("No tilts are logged: a magnetometer that stands askew in its instrument is not seen.")
    if field is not None and field["horizontal_nT"] < WEAK_FIELD_NT:
        strength = f"The horizontal field is {field['horizontal_nT']:.0f} nT"
        said.append(f"{strength}: under {WEAK_FIELD_NT:.0f} nT no correction can be relied on (Le Menn et al. 2023).")
    return said


def _sources(log: Log, solved: _Solved, table: Table, series: Floats) -> tuple[Source, ...]:
    """Return the budget of a corrected heading."""
    noise = solved.choice.fitted.noise if solved.choice.fitted else np.nan
    horizontal = 1.0 / float(np.hypot(1.0, solved.dip_ratio))
    off = table.deviation_deg - von_appen.predict(series, table.heading_deg)
    rows = [
        Source("fit", float(np.sqrt(np.mean(table.sigma_deg**2))), "block jackknife, rms over the table"),
        Source("series", angles.rms(off), "rms of the five terms about the exact deviation"),
        Source("one reading", noise / horizontal / angles.DEGREE, "scatter of the modulus, one axis"),
    ]
    if not log.tilted:
        return tuple(rows)
    down = solved.levelling[:, 2, :]
    ratio = solved.dip_ratio
    if solved.choice.level:
        field = ellipsoid.corrected(solved.iron[:3], solved.iron[3:].reshape(3, 3), solved.readings)
        ratio = float(np.mean(np.abs(np.sum(field * down, axis=1))))
        tilt = float(np.sqrt(np.mean(down[:, :2] ** 2)))
        hard = float(np.hypot(*solved.iron[:2]))
        how = "tilt's rms times a vertical iron as strong as the horizontal one, which the tilts do not determine"
        rows.append(Source("vertical iron", hard * tilt / angles.DEGREE, how))
    how = "0.40° expanded (Le Menn et al. 2023, section 2) times vertical over horizontal field"
    rows.append(Source("tilt sensor", TILT_SENSOR_DEG * abs(ratio), how))
    return tuple(rows)
