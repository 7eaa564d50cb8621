"""Calibration of a compass on a bench with known directions: Le Menn et al. 2023, sections 2 and 6."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import bench, budget, curves
from compasslib.calibrations.budget import Source
from compasslib.calibrations.curves import EMPIRICAL, EXACT, ONE_CYCLE, POLYNOMIAL, SMITH, FittedCurve
from compasslib.calibrations.result import Calibration, DeviationTable
from compasslib.calibrations.tables import TWO_TURNS, read_columns
from compasslib.deviation.series import series_design
from compasslib.errors import InputError, applicable
from compasslib.types import Floats

ROLES = ("reference_deg", "recorded_deg")
FORMS = (SMITH, EXACT, POLYNOMIAL, ONE_CYCLE, EMPIRICAL)
SAME_HEADING_DEG = 1.0  # reference directions that round to one multiple repeat a setting of the bench
SWING = "swing 16 to 24 headings all round the circle"


@dataclass(frozen=True)
class BenchReadings:
    """Reference and recorded headings, (n,) each, magnetic."""

    reference_deg: Floats
    recorded_deg: Floats

    def __len__(self) -> int:
        return len(self.reference_deg)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a compass on a bench.

    Args:
        settings: ``columns``, ``withhold``, the keys of tables, ``table_step_deg``, ``budget``, ``uncertainty``;
            ``mounting_deg``, clockwise angle from the bench's direction to the instrument's;
            ``declination_deg`` of the place; ``observatory`` and ``spun``, those of the files that record the field
            and the readings of the instrument spun in one place.

    Raises:
        InputError: a file cannot be read, a column is absent or not in degrees, or a
            constant of a quarter turn or more is not resolved by ``mounting_deg``.
    """
    spun, observatory = list(settings.get("spun") or ()), list(settings.get("observatory") or ())
    files = [file for file in files if str(file) not in {*spun, *observatory}]
    columns, notes = read_columns(files, settings, (*ROLES, "time_utc") if observatory else ROLES, bounds=TWO_TURNS)
    known = np.isfinite(columns["reference_deg"] + columns["recorded_deg"])
    mounting = settings.get("mounting_deg")
    reference = angles.wrap360(columns["reference_deg"][known] + (mounting or 0.0))
    recorded, conditions = columns["recorded_deg"][known], dict[str, Any]()
    if observatory:
        reference, conditions["observatory"] = bench.correct_field(reference, columns["time_utc"][known], observatory)
    given = settings.get("uncertainty") or {}
    if spun:
        turned, _ = read_columns(spun, settings, ROLES, bounds=TWO_TURNS)
        spun_reference = angles.wrap360(turned["reference_deg"] + (mounting or 0.0))
        found = bench.measure_homogeneity(reference, recorded, spun_reference, turned["recorded_deg"])
        conditions["homogeneity"] = found
        if given.get("homogeneity_deg") is None and found["max_deg"] is not None:
            given = {**given, "homogeneity_deg": abs(found["max_deg"])}
    rows, missing = budget.sources(given, settings.get("budget"))
    step = float(settings.get("table_step_deg", 10.0))
    fitted = calibrate_readings(BenchReadings(reference, recorded), rows, table_step_deg=step)
    doubts: list[str] = []
    if mounting is None and (shift := fitted.details.get("constant_shift")):
        doubts = _constant_doubts(shift["value_deg"], shift["sigma_deg"], settings.get("declination_deg"), files)
    lost = [] if known.all() else [f"{int(np.sum(~known))} lines without both headings are excluded"]
    details: dict[str, Any] = {**fitted.details, **conditions, "doubts": doubts}
    if settings.get("budget") == budget.LE_MENN and given.get("field_deg") is None and fitted.model != "none":
        level = (settings.get("field") or {}).get("horizontal_nT", budget.PAPER_FIELD_NT)
        details["physical_field"] = budget.physical_field(fitted.sources, level)
    return replace(fitted, details=details, warnings=(*notes, *lost, *fitted.warnings, *doubts, *missing))


def _constant_doubts(
    value: float,
    sigma: float,
    declination_deg: float | None,
    files: Sequence[str | Path],
    *,
    quarter_deg: float = 87.0,  # a quarter turn, but for a compass's own constant
    large_deg: float = 5.0,  # larger than the alignment errors of benches and mounts
    least_deg: float = 2.0,  # smallest declination and constant that are compared
) -> list[str]:
    """Explain a constant that is large or equals the declination, and is thus unlikely to be the compass's own.

    Raises:
        InputError: the constant is a quarter turn or more.
    """
    if abs(value) >= quarter_deg:
        stood = float(angles.wrap360(-90.0 * np.round(value / 90.0)))
        raise InputError(
            ", ".join(str(file) for file in files),
            expected="a constant of less than a quarter turn, or mounting_deg in the calibration's file",
            found=f"A {value:+.1f} degrees",
            advice=f"write mounting_deg: {stood:.0f} if the instrument stood so on the bench, clockwise, or the bench "
            "was read from the other side; mounting_deg: 0 if the constant is the compass's own",
        )
    if abs(value) <= 2.0 * sigma:
        return []
    near, reasons = max(2.0 * sigma, 0.5), []
    if declination_deg is not None and min(abs(declination_deg), abs(value)) > least_deg:
        signs = {"": 1.0, " with the other sign": -1.0}
        alike = [text for text, sign in signs.items() if abs(value - sign * declination_deg) < near]
        reasons = [f"it is the declination, {declination_deg:+.1f}{text}: reference_deg may be true" for text in alike]
    if abs(value) > large_deg:
        reasons.append("the instrument may have stood turned (mounting_deg), or reference_deg is true")
    text = f"a constant of {value:+.1f} degrees, which turns all headings alike: {'; '.join(reasons)}"
    return [text] if reasons else []


def calibrate_readings(
    readings: BenchReadings,
    sources: Sequence[Source] = (),  # rows of the uncertainty budget besides the scatter about the curve
    *,
    table_step_deg: float = 10.0,
    max_leakage: float = 0.5,  # fraction of an omitted quadrantal deviation that may appear in A, B or C
) -> Calibration:
    """Fit the curves to bench readings and select one, if any is determined."""
    # Repeats share the error of the bench's setting: they are averaged and count once.
    slots = np.round(angles.wrap360(readings.reference_deg) / SAME_HEADING_DEG)
    groups = [np.flatnonzero(slots == slot) for slot in np.unique(slots)]
    reference, recorded = (
        np.array([float(angles.mean(x[group])) for group in groups])
        for x in (readings.reference_deg, readings.recorded_deg)
    )
    observed = curves.deviation_points(recorded, reference)
    fits = {form.name: curves.fit_curve(form, observed) for form in FORMS}
    if isinstance(fits[SMITH.name], str) and isinstance(fits[ONE_CYCLE.name], FittedCurve):
        columns = series_design(observed.recorded_deg)
        if np.max(np.abs(np.linalg.pinv(columns[:, :3]) @ columns[:, 3:])) > max_leakage:
            fits[ONE_CYCLE.name] = "an unobservable quadrantal deviation would look like one cycle"
    fitted = {name: fit for name, fit in fits.items() if isinstance(fit, FittedCurve)}
    reasons = {name: fit for name, fit in fits.items() if isinstance(fit, str)}
    made = Calibration(
        kind="platform",
        model="none",
        n=len(readings),
        coverage=curves.count_sectors(readings.recorded_deg),
        sources=tuple(sources),
        points=_points(readings, None),
        details={"headings": len(recorded)},
    )
    if not fitted:
        return replace(made, why=_refusal(observed, reasons))
    chosen = curves.select_curve([*fitted.values()])
    rows = (*sources, budget.residual(chosen.scatter_deg, chosen.dof))
    points, coefficients = _points(readings, chosen), dict[str, Any]()
    if smith := fitted.get(SMITH.name):
        coefficients = {"coefficients": smith.coefficients, "covariance": smith.covariance}
    elif chosen.form is ONE_CYCLE:
        unknown = np.full((5, 5), np.nan)
        unknown[:3, :3] = chosen.covariance
        coefficients = {"coefficients": np.append(chosen.coefficients, [np.nan, np.nan]), "covariance": unknown}
    if exact := fitted.get(EXACT.name):
        coefficients |= {"exact": exact.coefficients, "exact_covariance": exact.covariance}
    heading = np.arange(0.0, 360.0, table_step_deg)
    deviation, sigma = chosen.deviation(heading), np.hypot(chosen.sigma(heading), budget.common(rows))
    return replace(
        made,
        model=chosen.form.name,
        **coefficients,
        residual_rms_deg=angles.rms(points["residual_deg"]),
        sources=rows,
        table=DeviationTable(heading, deviation, np.where(np.isfinite(deviation), sigma, np.nan)),
        points=points,
        details={**made.details}
        | {"errors": _extremes(-observed.deviation_deg)}
        | _details(fitted, reasons, chosen, sources),
        warnings=tuple(_warnings(readings, observed, reasons, chosen)),
    )


def _points(readings: BenchReadings, chosen: FittedCurve | None) -> dict[str, Floats]:
    points = curves.deviation_points(readings.recorded_deg, readings.reference_deg)
    columns = {"reference_deg": angles.wrap360(readings.reference_deg), "recorded_deg": points.recorded_deg}
    columns |= {"deviation_deg": points.deviation_deg}
    if chosen is None:
        return columns
    fitted = chosen.deviation(points.recorded_deg)
    if chosen.form is EXACT:  # the nearer of the two headings that give the same reading
        roots = compass.inverse(chosen.coefficients, points.recorded_deg)
        off = angles.difference(roots, (points.recorded_deg + points.deviation_deg)[:, None])
        nearer = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
        fitted = points.deviation_deg + off[np.arange(len(off)), nearer]
    return columns | {"fitted_deg": fitted, "residual_deg": angles.wrap180(points.deviation_deg - fitted)}


def _details(
    fitted: Mapping[str, FittedCurve], reasons: Mapping[str, str], chosen: FittedCurve, sources: Sequence[Source]
) -> dict[str, Any]:
    """Describe each form, and the constant of the deviation, which a compass's own calibration may cause (Fig. 18)."""
    models: dict[str, dict[str, Any]] = {name: {"why": why} for name, why in reasons.items()}
    for name, fit in fitted.items():
        total = budget.expanded((*sources, budget.residual(fit.scatter_deg, fit.dof)))
        models[name] = fit.to_json() | {"expanded_deg": total} | _extremes(-fit.residual_deg)
    details: dict[str, Any] = {"models": {form.name: models[form.name] for form in FORMS}}
    if chosen.form is POLYNOMIAL:
        return details
    curve = fitted.get(SMITH.name, chosen)
    unit = 1.0 / angles.DEGREE if curve.form is EXACT else 1.0
    value = unit * float(curve.coefficients[0])
    sigma = float(np.hypot(unit * np.sqrt(curve.covariance[0, 0]), budget.common(sources)))
    proven = abs(value) > 2.0 * sigma
    text = (
        f"A constant shift of {value:+.2f} ± {2.0 * sigma:.2f} degrees (k = 2) is {'' if proven else 'not '}"
        "significant; it may be of the compass, its mounting or the reference direction."
    )
    shift = {"value_deg": value, "sigma_deg": sigma, "differs_from_none": proven, "text": text}
    return details | {"constant_shift": shift}


def _extremes(error_deg: Floats) -> dict[str, float]:
    """Compute the largest and the peak-to-peak error, recorded minus reference, as Le Menn et al. 2023 do."""
    largest = float(error_deg[np.argmax(np.abs(error_deg))])
    return {"max_error_deg": largest, "peak_to_peak_deg": float(np.ptp(error_deg))}


def _refusal(observed: curves.Points, reasons: Mapping[str, str]) -> str:
    if not len(observed):
        return f"no reading with both headings; {SWING}"
    if len(observed) == 1:
        off = float(observed.deviation_deg[0])
        return f"one heading only: the deviation there is {off:+.1f} degrees, elsewhere it is unknown; {SWING}"
    sectors = curves.count_sectors(observed.recorded_deg)
    return (
        f"{len(observed)} headings in {sectors} of 36 sectors determine no curve (five terms: {reasons[SMITH.name]}; "
        f"one cycle: {reasons[ONE_CYCLE.name]}); {SWING}"
    )


def _warnings(
    readings: BenchReadings, observed: curves.Points, reasons: Mapping[str, str], chosen: FittedCurve
) -> list[str]:
    recorded, count = np.sort(observed.recorded_deg), len(observed)
    ahead = angles.wrap360(np.roll(recorded, -1) - recorded)
    widest = int(np.argmax(ahead))
    ends = f"{recorded[widest]:.0f} and {recorded[(widest + 1) % count]:.0f}"
    full_circle = chosen.form is not EXACT or compass.turns_full_circle(chosen.coefficients)
    warnings = applicable(
        {
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
                chosen.form is EMPIRICAL
            ),
        }
    )
    if chosen.form is POLYNOMIAL:
        low, high = chosen.deviation([0.0, 359.999])
        warnings.append(f"the polynomial is not periodic: it jumps by {low - high:+.1f} degrees where 360 meets 0")
    if not full_circle:
        low, high = angles.wrap360(compass.recorded_range(chosen.coefficients))
        warnings.append(
            f"the compass cannot turn full circle: it shows {low:.0f} to {high:.0f} degrees, each for two correct "
            "headings; no series represents it and the table is empty"
        )
    return warnings
