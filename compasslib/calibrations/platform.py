"""Calibration of compasses and tilt sensors on a bench of known directions or tilts: Le Menn et al. 2023."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations import TWO_TURNS, curves, read_columns, result
from compasslib.calibrations.curves import EXACT, ONE_CYCLE, SMITH, CurveForm, FittedCurve, Points
from compasslib.calibrations.result import PLATFORM, TILT, Calibration, DeviationTable, Source
from compasslib.deviation.series import series_design
from compasslib.errors import applicable
from compasslib.types import Floats

ROLES = ("reference_deg", "recorded_deg")
FORMS = (SMITH, EXACT, curves.POLYNOMIAL, ONE_CYCLE, curves.EMPIRICAL)
SAME_HEADING_DEG = 1.0  # reference directions that round to one multiple repeat a setting of the bench
SAME_TILT_DEG = 0.2  # the same for tilts
LEVEL_DEG, SKEW_DEG = 0.5, 1.0  # tilts up to which an axis is level, and from which two axes are tilted together
SWING = "swing 16 to 24 headings all round the circle"
TILT_ROLES = ("reference_tilt_deg", "recorded_pitch_deg", "recorded_roll_deg")
AXES = ("pitch", "roll")
TILT_FORMS = {"line": "AB", "quadratic": "ABC", "cubic": "ABCD"}  # in powers of the recorded tilt


@dataclass(frozen=True)
class BenchReadings:
    """Reference and recorded headings, magnetic, or tilts about one axis, (n,) each, degrees."""

    reference_deg: Floats
    recorded_deg: Floats

    def __len__(self) -> int:
        return len(self.reference_deg)

    @cached_property
    def heading_slots(self) -> NDArray[np.intp]:
        """Number of the heading of each reading, (n,), equal for repeats."""
        slots = np.round(angles.wrap360(self.reference_deg) / SAME_HEADING_DEG) % (360.0 / SAME_HEADING_DEG)
        return np.unique(slots, return_inverse=True)[1]


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a compass on a bench, with readings of it spun in one place."""
    spun = list(settings.get("spun") or ())
    columns, notes = read_columns([file for file in files if str(file) not in spun], settings, ROLES, bounds=TWO_TURNS)
    known = np.isfinite(columns["reference_deg"] + columns["recorded_deg"])
    reference, recorded = angles.wrap360(columns["reference_deg"][known]), columns["recorded_deg"][known]
    conditions, given = dict[str, Any](), settings.get("uncertainty") or {}
    if spun:
        turned, _ = read_columns(spun, settings, ROLES, bounds=TWO_TURNS)
        found = measure_homogeneity(reference, recorded, turned["reference_deg"], turned["recorded_deg"])
        conditions["homogeneity"] = found
        if given.get("homogeneity_deg") is None and found["max_deg"] is not None:
            given = {**given, "homogeneity_deg": abs(found["max_deg"])}
    rows, missing = result.sources(given, settings.get("budget"))
    step = float(settings.get("table_step_deg", 10.0))
    fitted = calibrate_readings(BenchReadings(reference, recorded), rows, table_step_deg=step)
    doubts = _column_doubts(columns["reference_deg"][known], columns["recorded_deg"][known])
    if shift := fitted.details.get("constant_shift"):
        doubts += _constant_doubts(shift["value_deg"], shift["sigma_deg"], settings.get("declination_deg"))
    if settings.get("budget") == result.LE_MENN and given.get("field_deg") is None and fitted.model != "none":
        level = (settings.get("field") or {}).get("horizontal_nT", result.PAPER_FIELD_NT)
        conditions["physical_field"] = result.physical_field(fitted.sources, level)
    lost = [] if known.all() else [f"{int(np.sum(~known))} lines without both headings are excluded"]
    return replace(
        fitted,
        details={**fitted.details, **conditions, "doubts": doubts},
        warnings=(*notes, *lost, *fitted.warnings, *doubts, *missing),
    )


def measure_homogeneity(
    reference_deg: Floats, recorded_deg: Floats, spun_reference_deg: Floats, spun_recorded_deg: Floats
) -> dict[str, Any]:
    """Compare an instrument spun in place, (m,), with the curve fitted to the rotated platform, (n,), degrees."""
    points = curves.deviation_points(recorded_deg, reference_deg)
    fits = [curves.fit_curve(form, points) for form in (SMITH, EXACT)]
    fitted = [fit for fit in fits if isinstance(fit, FittedCurve)]
    observed = angles.difference(spun_reference_deg, spun_recorded_deg)
    known = np.isfinite(observed)
    if not fitted or known.sum() < 4:  # Table 3
        few = f"{known.sum()} directions of the spun instrument, at least 4 tell it"
        text = f"The homogeneity of the field is not determined: {few if fitted else fits[0]}"
        return {"max_deg": None, "mean_deg": None, "text": text}
    off = angles.difference(observed[known], curves.select_curve(fitted).deviation(spun_recorded_deg[known]))
    largest, mean = float(off[np.argmax(np.abs(off))]), float(np.mean(off))
    text = (
        f"The instrument spun in {len(off)} directions differs from the rotated platform by up to {largest:+.2f} "
        f"degrees, by {mean:+.2f} on average: the largest is the homogeneity's row of the budget"
    )
    return {"max_deg": largest, "mean_deg": mean, "text": text}


def _column_doubts(reference_deg: Floats, recorded_deg: Floats) -> list[str]:
    """Say where headings may be gradians, or only the recorded ones are round numbers, as a platform is set to."""
    if 360.0 < np.max([*reference_deg, *recorded_deg], initial=0.0) < 400.0:
        return ["headings between 360 and 400, and none beyond: they may be gradians, of which 400 are a turn"]
    uneven = [np.abs(angles.difference(x, 5.0 * np.round(x / 5.0))) > 0.05 for x in (reference_deg, recorded_deg)]
    if len(reference_deg) < 5 or np.mean(uneven[0]) < 0.8 or uneven[1].any():
        return []
    return ["all recorded_deg are multiples of 5 degrees and few reference_deg are: the two columns may be exchanged"]


def _constant_doubts(value: float, sigma: float, declination_deg: float | None) -> list[str]:
    """Explain a constant that is large or equals the declination, and is thus unlikely to be the compass's own."""
    if abs(value) <= 2.0 * sigma:
        return []
    near, reasons = max(2.0 * sigma, 0.5), []
    if declination_deg is not None and min(abs(declination_deg), abs(value)) > 2.0:
        signs = {"": 1.0, " with the other sign": -1.0}
        alike = [text for text, sign in signs.items() if abs(value - sign * declination_deg) < near]
        reasons = [f"it is the declination, {declination_deg:+.1f}{text}: reference_deg may be true" for text in alike]
    if abs(value) > result.ALIGNMENT_DEG:
        reasons.append("the instrument may have stood turned, or reference_deg is true")
    text = f"a constant of {value:+.1f} degrees, which turns all headings alike: {'; '.join(reasons)}"
    return [text] if reasons else []


def calibrate_readings(
    readings: BenchReadings,
    sources: Sequence[Source] = (),  # rows of the uncertainty budget besides the scatter about the curve
    *,
    table_step_deg: float = 10.0,
) -> Calibration:
    """Fit the curves to bench readings and select one, if any is determined."""
    all_points = curves.deviation_points(readings.recorded_deg, readings.reference_deg)
    points = {
        "reference_deg": angles.wrap360(readings.reference_deg),
        "recorded_deg": all_points.recorded_deg,
        "deviation_deg": all_points.deviation_deg,
    }
    observed, fitted, reasons = _fit_forms(readings)
    made = Calibration(
        kind=PLATFORM,
        model="none",
        n=len(readings),
        coverage=curves.count_sectors(readings.recorded_deg),
        sources=tuple(sources),
        points=points,
        details={"headings": len(observed)},
    )
    if not fitted:
        return replace(made, why=_refusal(observed, reasons))
    chosen = curves.select_curve([*fitted.values()])
    points["fitted_deg"] = chosen.form.nearest_deviation(chosen.coefficients, all_points)
    points["residual_deg"] = angles.wrap180(points["deviation_deg"] - points["fitted_deg"])
    coefficients: dict[str, Any] = {}
    if smith := fitted.get(SMITH.name):
        coefficients = {"coefficients": smith.coefficients, "covariance": smith.covariance}
    elif chosen.form is ONE_CYCLE:
        unknown = np.full((5, 5), np.nan)
        unknown[:3, :3] = chosen.covariance
        coefficients = {"coefficients": np.append(chosen.coefficients, [np.nan, np.nan]), "covariance": unknown}
    if exact := fitted.get(EXACT.name):
        coefficients |= {"exact": exact.coefficients, "exact_covariance": exact.covariance}
    sources = (*sources, *_repeatability(readings, points["residual_deg"], chosen))
    rows = (*sources, _fit_residual(chosen))
    heading = np.arange(0.0, 360.0, table_step_deg)
    deviation, sigma = chosen.deviation(heading), np.hypot(chosen.sigma(heading), result.common(rows))
    return replace(
        made,
        model=chosen.form.name,
        **coefficients,
        residual_rms_deg=angles.rms(points["residual_deg"]),
        sources=rows,
        table=DeviationTable(heading, deviation, np.where(np.isfinite(deviation), sigma, np.nan)),
        details={
            **made.details,
            "errors": _extremes(-observed.deviation_deg),
            **_describe_models(fitted, reasons, chosen, sources),
        },
        warnings=tuple(_warnings(readings, observed, reasons, chosen)),
    )


def _fit_forms(readings: BenchReadings) -> tuple[Points, dict[str, FittedCurve], dict[str, str]]:
    """Fit all forms to readings averaged by heading: the points, fitted curves, and why the others cannot be fitted."""
    # Repeats share the error of the bench's setting: they count once.
    slot = readings.heading_slots
    recorded, reference = (
        np.array([float(angles.mean(x[slot == k])) for k in range(slot.max(initial=-1) + 1)])
        for x in (readings.recorded_deg, readings.reference_deg)
    )
    observed = curves.deviation_points(recorded, reference)
    fits = {form.name: curves.fit_curve(form, observed) for form in FORMS}
    if isinstance(fits[SMITH.name], str) and isinstance(fits[ONE_CYCLE.name], FittedCurve):
        columns = series_design(observed.recorded_deg)
        leakage = np.linalg.pinv(columns[:, :3]) @ columns[:, 3:]  # of omitted terms into A, B and C
        if np.max(np.abs(leakage)) > 0.5:
            fits[ONE_CYCLE.name] = "an unobservable quadrantal deviation would look like one cycle"
    fitted = {name: fit for name, fit in fits.items() if isinstance(fit, FittedCurve)}
    return observed, fitted, {name: fit for name, fit in fits.items() if isinstance(fit, str)}


def _fit_residual(curve: FittedCurve) -> Source:
    how = f"scatter about the curve, {curve.dof} degrees of freedom, by Student's t"
    return Source(result.FIT_RESIDUAL, curve.scatter_deg, how)


def _repeatability(readings: BenchReadings, residual_deg: Floats, curve: FittedCurve) -> list[Source]:
    """Compute by how much repeats disagree beyond the scatter of their means about the curve, if there are any.

    0 where an F test at 5 % shows no excess: sound repeats would widen the uncertainty by half of their noise.
    """
    from scipy.special import fdtrc  # imported late: only needed for repeats

    slot = readings.heading_slots
    count = np.bincount(slot)
    if not (count > 1).any():
        return []
    off = residual_deg - (np.bincount(slot, residual_deg) / count)[slot]
    free, expected = len(slot) - len(count), float(np.mean(count)) * curve.scatter_deg**2
    within = float(off @ off) / free
    shown = fdtrc(free, curve.dof, within / max(expected, 1e-12)) < 0.05
    beyond = max(within - expected, 0.0) if shown else 0.0
    return [Source("repeats", float(np.sqrt(beyond)), "disagreement of repeated headings beyond the scatter")]


def _describe_models(
    fitted: Mapping[str, FittedCurve], reasons: Mapping[str, str], chosen: FittedCurve, sources: Sequence[Source]
) -> dict[str, Any]:
    """Describe each form, and the constant of the deviation, which a compass's own calibration may cause (Fig. 18)."""
    models: dict[str, dict[str, Any]] = {form.name: {"why": reasons.get(form.name)} for form in FORMS}
    for name, fit in fitted.items():
        total = result.expanded((*sources, _fit_residual(fit)))
        models[name] = fit.to_json() | {"expanded_deg": total} | _extremes(-fit.residual_deg)
    if chosen.form is curves.POLYNOMIAL:
        return {"models": models}
    curve = fitted.get(SMITH.name, chosen)
    unit = 1.0 / angles.DEGREE if curve.form is EXACT else 1.0
    value = unit * float(curve.coefficients[0])
    sigma = float(np.hypot(unit * np.sqrt(curve.covariance[0, 0]), result.common(sources)))
    proven = abs(value) > 2.0 * sigma
    text = (
        f"A constant shift of {value:+.2f} ± {2.0 * sigma:.2f} degrees (k = 2) is {'' if proven else 'not '}"
        "significant; it may be of the compass, its mounting or the reference direction."
    )
    shift = {"value_deg": value, "sigma_deg": sigma, "differs_from_none": proven, "text": text}
    return {"models": models, "constant_shift": shift}


def _extremes(error_deg: Floats) -> dict[str, float]:
    """Compute the largest and the peak-to-peak error, recorded minus reference, as Le Menn et al. 2023 do."""
    return {"max_error_deg": _largest(error_deg), "peak_to_peak_deg": float(np.ptp(error_deg))}


def _largest(error_deg: Floats) -> float:
    return float(error_deg[np.argmax(np.abs(error_deg))])


def _refusal(observed: Points, reasons: Mapping[str, str]) -> str:
    if not len(observed):
        return f"no reading with both headings; {SWING}"
    if len(observed) == 1:
        off = float(observed.deviation_deg[0])
        return f"one heading only: the deviation there is {off:+.1f} degrees, elsewhere it is unknown; {SWING}"
    sectors, mistyped = curves.count_sectors(observed.recorded_deg), _mistyped(observed)
    return (
        f"{len(observed)} headings in {sectors} of 36 sectors determine no curve (five terms: {reasons[SMITH.name]}; "
        f"one cycle: {reasons[ONE_CYCLE.name]}); {mistyped or SWING}"
    )


def _mistyped(observed: Points, exact: FittedCurve | None = None) -> str:
    """Name the reading that is an outlier from the curve through the others (Bonferroni's test at 0.1 %), or none.

    The curve is the series, or the exact compass if that was chosen, with the mean leverage of a reading.
    """
    from scipy.special import stdtr  # imported late: only this kind needs it

    design, off = series_design(observed.recorded_deg), angles.wrap180(observed.deviation_deg)
    n, parameters = design.shape
    if n < parameters + 3 or np.linalg.matrix_rank(design) < parameters:
        return ""
    basis, _ = np.linalg.qr(design)
    left, free = off - basis @ (basis.T @ off), 1.0 - np.sum(basis**2, axis=1)
    if exact is not None:
        reading = compass.recorded_heading(exact.coefficients, observed.recorded_deg + observed.deviation_deg)
        left[:], free[:] = angles.difference(reading, observed.recorded_deg), 1.0 - parameters / n
    dof = n - parameters - 1
    others = np.maximum(left @ left - left**2 / free, 1e-12) / dof
    student = np.abs(left) / np.sqrt(others * free)
    k = int(np.argmax(student))
    if float(stdtr(dof, -student[k])) > 0.0005 / n:
        return ""
    return (
        f"the reading of {observed.recorded_deg[k]:.1f} degrees lies {left[k] / free[k]:+.1f} degrees off the curve "
        "through the others: check its line"
    )


def _warnings(readings: BenchReadings, observed: Points, reasons: Mapping[str, str], chosen: FittedCurve) -> list[str]:
    recorded, count = np.sort(observed.recorded_deg), len(observed)
    ahead = angles.wrap360(np.roll(recorded, -1) - recorded)
    widest = int(np.argmax(ahead))
    ends = f"{recorded[widest]:.0f} and {recorded[(widest + 1) % count]:.0f}"
    full_circle = chosen.form is not EXACT or compass.turns_full_circle(chosen.coefficients)
    mistyped = _mistyped(observed, chosen if chosen.form is EXACT else None)
    warnings = applicable(
        {
            mistyped: bool(mistyped),
            f"{len(readings)} readings at {count} headings: repeats are averaged and count once": (
                count < len(readings)
            ),
            f"{count} headings leave {chosen.dof} degrees of freedom: the uncertainty includes Student's t, "
            f"and third and fourth harmonics cannot be tested; {SWING}": count < 16,
            f"no reading between recorded {ends} degrees: there the curve is an extrapolation": (
                ahead[widest] > 90.0 and full_circle
            ),
            f"reduced to one cycle, A, B and C: five terms: {reasons.get(SMITH.name)}; D and E stay unknown": (
                chosen.form is ONE_CYCLE and SMITH.name in reasons
            ),
            "the curve has harmonics that no iron makes, such as by a wrong table in the firmware: it holds for the "
            "heading alone and in any field, and the coefficients A to E are not the whole of it": (
                chosen.form is curves.EMPIRICAL
            ),
        }
    )
    if chosen.form is curves.POLYNOMIAL:
        low, high = chosen.deviation([0.0, 359.999])
        warnings.append(f"the polynomial is not periodic: it jumps by {low - high:+.1f} degrees where 360 meets 0")
    if not full_circle:
        low, high = angles.wrap360(compass.recorded_range(chosen.coefficients))
        warnings.append(
            f"the compass cannot turn full circle: it shows {low:.0f} to {high:.0f} degrees, each for two correct "
            "headings; no series represents it and the table is empty"
        )
    return warnings


# Tilt sensors: section 2 and Table 5.


def calibrate_tilt(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate the pitch and the roll of a tilt sensor against the tilts of a platform, by CSV files of all three."""
    columns, notes = read_columns(files, settings, TILT_ROLES, bounds=TWO_TURNS)
    known = np.isfinite(np.sum([columns[role] for role in TILT_ROLES], axis=0))
    reference, *recorded = (columns[role][known] for role in TILT_ROLES)
    readings, skew, signs = split_axes(reference, np.array(recorded))
    rows, missing = result.sources(settings.get("uncertainty") or {}, settings.get("budget"), TILT)
    warnings = [*notes, *signs, *missing]
    if not known.all():
        warnings.append(f"{int(np.sum(~known))} lines without reference tilt, pitch and roll are excluded")
    for axis, read in readings.items():
        gain = float(np.ptp(read.reference_deg)) / max(float(np.ptp(read.recorded_deg)), 1e-9) if len(read) else 1.0
        if not 0.5 < gain < 2.0:  # no sensor is that far off
            warnings.append(f"{axis}: the platform tilts {gain:.3g} times as far as the sensor: check the unit of both")
    if skew:
        warnings.append(f"{skew} readings tilt pitch and roll together and are excluded: tilt one axis at a time")
    return replace(calibrate_axes(readings, rows), n=int(known.sum()) - skew, warnings=tuple(warnings))


def split_axes(
    reference_deg: Floats,  # tilts of the platform, (n,), signed or absolute
    recorded_deg: Floats,  # pitch and roll, (2, n)
) -> tuple[dict[str, BenchReadings], int, list[str]]:
    """Assign readings to the tilted axis, level ones to both; count those with both tilted, and note changed signs."""
    readings, notes = dict.fromkeys(AXES, BenchReadings(np.zeros(0), np.zeros(0))), list[str]()
    if not len(reference_deg):
        return readings, 0, notes
    size = np.abs(reference_deg)
    level = (size <= size.min() + LEVEL_DEG) & (size <= SKEW_DEG)
    zero = np.median(recorded_deg[:, level], axis=1) if level.any() else np.zeros(2)
    lean = recorded_deg - zero[:, None]
    most, least = np.max(np.abs(lean), axis=0), np.min(np.abs(lean), axis=0)
    skew = ~level & (least > np.maximum(SKEW_DEG, 0.25 * most))
    tilted = np.argmax(np.abs(lean), axis=0)
    for k, name in enumerate(AXES):
        chosen = level | (tilted == k) & ~skew
        if not (chosen & ~level).any():
            continue
        reference, leaning = reference_deg[chosen], lean[k][chosen]
        if np.min(reference) >= 0.0 and np.min(leaning) < -LEVEL_DEG:
            reference = np.where(level[chosen], reference, np.sign(leaning) * reference)
            notes.append(f"{name}: reference tilts have no sign; that of the recorded tilt is taken")
        elif np.sum(reference * leaning) < 0.0:
            reference = -reference
            notes.append(f"{name}: the platform counts tilts in the other sense; their sign is changed")
        _, which, count = np.unique(np.round(reference / SAME_TILT_DEG), return_inverse=True, return_counts=True)
        means = (np.bincount(which, x) / count for x in (reference, recorded_deg[k][chosen]))
        readings[name] = BenchReadings(*means)
    return readings, int(skew.sum()), notes


def calibrate_axes(readings: Mapping[str, BenchReadings], sources: Sequence[Source]) -> Calibration:
    """Fit a polynomial to each axis; the larger of their scatters enters the budget."""
    axes, fits, columns = dict[str, Any](), dict[str, FittedCurve](), list[tuple[Floats, ...]]()
    for k, (axis, read) in enumerate(readings.items()):
        correction, fitted = read.reference_deg - read.recorded_deg, np.full(len(read), np.nan)
        fit: FittedCurve | str = "no reading leans this axis alone"
        if len(read):
            # The highest degree allowed, not the best fit: otherwise undetected curvature would be neglected.
            name = [each for each, letters in TILT_FORMS.items() if len(read) - len(letters) >= 4 or each == "line"][-1]
            design = partial(np.vander, N=len(TILT_FORMS[name]), increasing=True)
            span = np.linspace(read.recorded_deg.min(), read.recorded_deg.max(), 21)
            form = CurveForm(name, TILT_FORMS[name], "Le Menn et al. 2023, section 2", design, span)
            fit = curves.fit_curve(form, Points(read.recorded_deg, correction))
        if isinstance(fit, FittedCurve):
            fits[axis], fitted = fit, fit.deviation(read.recorded_deg)
            axes[axis] = _describe_tilt(axis, read.recorded_deg, fit, (*sources, _fit_residual(fit)))
        else:
            axes[axis] = {"why": fit}
        number = np.full(len(read), float(k))
        columns.append((number, read.reference_deg, read.recorded_deg, correction, correction - fitted))
    names = ("axis", "reference_tilt_deg", "recorded_tilt_deg", "correction_deg", "residual_deg")
    points = {name: np.concatenate(column) for name, column in zip(names, zip(*columns, strict=True), strict=True)}
    made = Calibration(TILT, "none", len(points["axis"]), 0, sources=tuple(sources), points=points)
    if not fits:
        reasons = "; ".join(f"{axis}: {each['why']}" for axis, each in axes.items())
        return replace(made, why=f"{reasons}; tilt the platform in 8 steps or more, one axis at a time")
    widest = max(fits.values(), key=lambda fit: fit.scatter_deg)
    return replace(
        made,
        model=", ".join(f"{axis} by a {fit.form.name}" for axis, fit in fits.items()),
        residual_rms_deg=angles.rms(points["residual_deg"]),
        sources=(*sources, _fit_residual(widest)),
        details={"axes": axes},
    )


def _describe_tilt(axis: str, recorded_deg: Floats, curve: FittedCurve, rows: Sequence[Source]) -> dict[str, Any]:
    low, high = float(recorded_deg.min()), float(recorded_deg.max())
    steps = 5.0 * np.arange(np.ceil(low / 5.0), np.floor(high / 5.0) + 1)
    common, expanded = result.common(rows), result.expanded(rows)
    largest = _largest(-curve.deviation(np.linspace(low, high, 101)))
    return {
        **curve.to_json(),
        "covariance": curve.covariance,
        "form": curve.form.name,
        "n": len(recorded_deg),
        "recorded_range_deg": [low, high],
        "max_error_deg": largest,
        "expanded_deg": expanded,
        "common_deg": common,
        "table": {
            "recorded_deg": steps,
            "correction_deg": curve.deviation(steps),
            "sigma_deg": np.hypot(curve.sigma(steps), common),
        },
        "text": f"{axis.capitalize()}: a {curve.form.name} through {len(recorded_deg)} tilts from {low:.1f} to "
        f"{high:.1f} degrees leaves {angles.rms(curve.residual_deg):.2f} degrees rms; the largest error is "
        f"{largest:+.2f} degrees, the expanded uncertainty of a corrected tilt {expanded:.2f} degrees (k = 2).",
    }
