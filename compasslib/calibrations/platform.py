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
from compasslib.errors import InputError
from compasslib.readers import delimited
from compasslib.types import Floats

ROLES = ("reference_deg", "recorded_deg")
FORMS = (SMITH, EXACT, POLYNOMIAL, ONE_CYCLE, EMPIRICAL)
SAME_HEADING_DEG = 1.0  # reference directions that round to one multiple repeat a setting of the bench
SWING = "swing 16 to 24 headings all round the circle"
ADVICE = "correct columns in the calibration's file"


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
    columns, notes = read_columns(files, settings, (*ROLES, "time_utc") if observatory else ROLES)
    known = np.isfinite(columns["reference_deg"] + columns["recorded_deg"])
    mounting = settings.get("mounting_deg")
    reference = angles.wrap360(columns["reference_deg"][known] + (mounting or 0.0))
    conditions: dict[str, Any] = {}
    if observatory:
        reference, conditions["observatory"] = bench.correct_field(reference, columns["time_utc"][known], observatory)
    read = BenchReadings(reference, columns["recorded_deg"][known])
    given = settings.get("uncertainty") or {}
    if spun:
        turned = read_columns(spun, settings)[0]
        spun_reference = angles.wrap360(turned["reference_deg"] + (mounting or 0.0))
        found = bench.measure_homogeneity(read.reference_deg, read.recorded_deg, spun_reference, turned["recorded_deg"])
        conditions["homogeneity"] = found
        if given.get("homogeneity_deg") is None and found["max_deg"] is not None:
            given = {**given, "homogeneity_deg": abs(found["max_deg"])}
    rows = budget.sources(given, settings.get("budget"))
    step = float(settings.get("table_step_deg", 10.0))
    fitted = calibrate_readings("platform", read, rows, table_step_deg=step)
    where = ", ".join(str(file) for file in files)
    shift = fitted.details.get("constant_shift", {"value_deg": 0.0})["value_deg"]
    if mounting is None and abs(shift) >= 87.0:  # a quarter turn, but for a compass's own constant
        stood = float(angles.wrap360(-90.0 * np.round(shift / 90.0)))
        raise InputError(
            where,
            expected="a constant of less than a quarter turn, or mounting_deg in the calibration's file",
            found=f"A {shift:+.1f} degrees",
            advice=f"write mounting_deg: {stood:.0f} if the instrument stood so on the bench, clockwise, or the bench "
            "was read from the other side; mounting_deg: 0 if the constant is the compass's own",
        )
    misfits = [] if mounting is not None else _constant_reasons(fitted, settings.get("declination_deg"))
    lost = [] if known.all() else [f"{int(np.sum(~known))} lines without both headings are excluded"]
    warnings = [*notes, *lost, *fitted.warnings, *misfits, *budget.notes(given, rows)]
    details: dict[str, Any] = {**fitted.details, **conditions, "doubts": misfits}
    if settings.get("budget") == budget.LE_MENN and given.get("field_deg") is None and fitted.model != "none":
        level = (settings.get("field") or {}).get("horizontal_nT", budget.PAPER_FIELD_NT)
        details["physical_field"] = budget.physical_field(fitted.sources, level)
    return replace(fitted, details=details, warnings=tuple(warnings))


def _constant_reasons(
    fitted: Calibration, declination_deg: float | None, *, large_deg: float = 5.0, least_deg: float = 2.0
) -> list[str]:
    """Explain a constant that is large or equals the declination, and is thus unlikely to be the compass's own.

    Args:
        large_deg: larger than the alignment errors of benches and mounts.
        least_deg: smallest declination and constant that are compared.
    """
    shift = fitted.details.get("constant_shift")
    if shift is None or abs(shift["value_deg"]) <= 2.0 * shift["sigma_deg"]:
        return []
    value, near = float(shift["value_deg"]), max(2.0 * float(shift["sigma_deg"]), 0.5)
    reasons = []
    if declination_deg is not None and min(abs(declination_deg), abs(value)) > least_deg:
        signs = {"": 1.0, " with the other sign": -1.0}
        alike = [text for text, sign in signs.items() if abs(value - sign * declination_deg) < near]
        reasons = [f"it is the declination, {declination_deg:+.1f}{text}: reference_deg may be true" for text in alike]
    if abs(value) > large_deg:
        reasons.append("the instrument may have stood turned (mounting_deg), or reference_deg is true")
    text = f"a constant of {value:+.1f} degrees, which turns all headings alike: {'; '.join(reasons)}"
    return [text] if reasons else []


def calibrate_readings(
    kind: str,
    readings: BenchReadings,
    sources: Sequence[Source] = (),
    *,
    table_step_deg: float = 10.0,
    max_leakage: float = 0.5,
) -> Calibration:
    """Fit the curves to bench readings and select one, if any is determined.

    Args:
        sources: rows of the uncertainty budget besides the scatter about the curve.
        max_leakage: fraction of an omitted quadrantal deviation that may appear in A, B or C.
    """
    # Repeats share the error of the bench's setting: they are averaged and count once.
    slots = np.round(angles.wrap360(readings.reference_deg) / SAME_HEADING_DEG)
    _, which = np.unique(slots, return_inverse=True)
    groups = [np.flatnonzero(which == k) for k in range(which.max(initial=-1) + 1)]
    columns = readings.reference_deg, readings.recorded_deg
    means = [[float(angles.mean(x[group])) for group in groups] for x in columns]
    settings = BenchReadings(*np.array(means, dtype=float).reshape(2, -1))
    observed = curves.deviation_points(settings.recorded_deg, settings.reference_deg)
    fits = {form.name: curves.fit_curve(form, observed) for form in FORMS}
    reduced = isinstance(fits[SMITH.name], str) and isinstance(fits[ONE_CYCLE.name], FittedCurve)
    if reduced and curves.max_leakage(observed) > max_leakage:
        fits[ONE_CYCLE.name] = "an unobservable quadrantal deviation would look like one cycle"
    fitted = [curve for curve in fits.values() if isinstance(curve, FittedCurve)]
    empty = Calibration(
        kind=kind,
        model="none",
        n=len(readings),
        coverage=curves.count_sectors(readings.recorded_deg),
        sources=tuple(sources),
        points=_points(readings, None),
        details={"headings": len(settings)},
    )
    if not fitted:
        return replace(empty, why=_refusal(settings, fits))
    chosen = curves.select_curve(fitted)
    rows = (*sources, budget.residual(chosen.scatter_deg, chosen.dof))
    points = _points(readings, chosen)
    heading = np.arange(0.0, 360.0, table_step_deg)
    deviation, sigma = chosen.deviation(heading), np.hypot(chosen.sigma(heading), budget.common(rows))
    return replace(
        empty,
        model=chosen.form.name,
        **_coefficients(fits, chosen),
        residual_rms_deg=angles.rms(points["residual_deg"]),
        sources=rows,
        table=DeviationTable(heading, deviation, np.where(np.isfinite(deviation), sigma, np.nan)),
        points=points,
        details={**empty.details, "errors": _extremes(-observed.deviation_deg), **_details(fits, chosen, sources)},
        warnings=_warnings(readings, settings, fits, chosen),
    )


def _coefficients(fits: Mapping[str, FittedCurve | str], chosen: FittedCurve) -> dict[str, Any]:
    """Collect the series in the recorded heading and the exact compass, as far as the headings determine them."""
    smith, exact, coefficients = fits[SMITH.name], fits[EXACT.name], dict[str, Any]()
    if isinstance(smith, FittedCurve):
        coefficients |= {"coefficients": smith.coefficients, "covariance": smith.covariance}
    elif chosen.form is ONE_CYCLE:
        unknown = np.full((5, 5), np.nan)
        unknown[:3, :3] = chosen.covariance
        coefficients |= {"coefficients": np.append(chosen.coefficients, [np.nan, np.nan]), "covariance": unknown}
    if isinstance(exact, FittedCurve):
        coefficients |= {"exact": exact.coefficients, "exact_covariance": exact.covariance}
    return coefficients


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


def _details(fits: Mapping[str, FittedCurve | str], chosen: FittedCurve, sources: Sequence[Source]) -> dict[str, Any]:
    models: dict[str, dict[str, Any]] = {}
    for name, fit in fits.items():
        if isinstance(fit, str):
            models[name] = {"why": fit}
            continue
        total = budget.expanded((*sources, budget.residual(fit.scatter_deg, fit.dof)))
        models[name] = curves.curve_to_json(fit) | {"expanded_deg": total} | _extremes(-fit.residual_deg)
    common_deg = budget.common(tuple(sources))
    scores = [f"{name} {fit.score_deg:.2f}" for name, fit in fits.items() if isinstance(fit, FittedCurve)]
    chosen_by = f"{chosen.form.name}; degrees rms on headings left out one by one: {', '.join(scores)}"
    shift = {} if chosen.form is POLYNOMIAL else {"constant_shift": _constant_shift(fits, chosen, common_deg)}
    return {"models": models, "chosen_by": chosen_by, **shift}


def _extremes(error_deg: Floats) -> dict[str, float]:
    """Compute the largest and the peak-to-peak error, recorded minus reference, as Le Menn et al. 2023 do."""
    largest = float(error_deg[np.argmax(np.abs(error_deg))])
    return {"max_error_deg": largest, "peak_to_peak_deg": float(np.ptp(error_deg))}


def _constant_shift(fits: Mapping[str, FittedCurve | str], chosen: FittedCurve, common_deg: float) -> dict[str, Any]:
    """Describe the constant of the deviation, which a compass's own calibration may cause (Le Menn, Fig. 18)."""
    series_fit = fits[SMITH.name] if isinstance(fits[SMITH.name], FittedCurve) else chosen
    assert isinstance(series_fit, FittedCurve)
    unit = 1.0 if series_fit.form is not EXACT else 1.0 / angles.DEGREE
    value = unit * float(series_fit.coefficients[0])
    sigma = float(np.hypot(unit * np.sqrt(series_fit.covariance[0, 0]), common_deg))
    proven = abs(value) > 2.0 * sigma
    text = (
        f"A constant shift of {value:+.2f} ± {2.0 * sigma:.2f} degrees (k = 2) is {'' if proven else 'not '}"
        "significant; it may be of the compass, its mounting or the reference direction."
    )
    return {"value_deg": value, "sigma_deg": sigma, "differs_from_none": proven, "text": text}


def _refusal(settings: BenchReadings, fits: Mapping[str, FittedCurve | str]) -> str:
    if not len(settings):
        return f"no reading with both headings; {SWING}"
    if len(settings) == 1:
        off = float(angles.difference(settings.reference_deg[0], settings.recorded_deg[0]))
        return f"one heading only: the deviation there is {off:+.1f} degrees, elsewhere it is unknown; {SWING}"
    sectors = curves.count_sectors(settings.recorded_deg)
    return (
        f"{len(settings)} headings in {sectors} of 36 sectors determine no curve (five terms: {fits[SMITH.name]}; "
        f"one cycle: {fits[ONE_CYCLE.name]}); {SWING}"
    )


def _warnings(
    readings: BenchReadings, settings: BenchReadings, fits: Mapping[str, FittedCurve | str], chosen: FittedCurve
) -> tuple[str, ...]:
    warnings = []
    full_circle = chosen.form is not EXACT or compass.turns_full_circle(chosen.coefficients)
    if len(settings) < len(readings):
        warnings.append(f"{len(readings)} readings at {len(settings)} headings: repeats are averaged and count once")
    if len(settings) < 16:
        warnings.append(
            f"{len(settings)} headings leave {chosen.dof} degrees of freedom: the uncertainty includes Student's t, "
            f"and third and fourth harmonics cannot be tested; {SWING}"
        )
    recorded = np.sort(angles.wrap360(settings.recorded_deg))
    ahead = angles.wrap360(np.roll(recorded, -1) - recorded)
    widest = int(np.argmax(ahead))
    if ahead[widest] > 90.0 and full_circle:
        ends = f"{recorded[widest]:.0f} and {recorded[(widest + 1) % len(recorded)]:.0f}"
        warnings.append(f"no reading between recorded {ends} degrees: there the curve is an extrapolation")
    if chosen.form is ONE_CYCLE and isinstance(fits[SMITH.name], str):
        warnings.append(f"reduced to one cycle, A, B and C: five terms: {fits[SMITH.name]}; D and E stay unknown")
    if chosen.form is EMPIRICAL:
        warnings.append(
            "the curve has harmonics that no iron makes, such as by a wrong table in the firmware: it holds for the "
            "heading alone and in any field, and the coefficients A to E are not the whole of it"
        )
    if chosen.form is POLYNOMIAL:
        low, high = (float(chosen.deviation(np.array([end]))[0]) for end in (0.0, 359.999))
        warnings.append(f"the polynomial is not periodic: it jumps by {low - high:+.1f} degrees where 360 meets 0")
    if not full_circle:
        low, high = (float(angles.wrap360(x)) for x in compass.recorded_range(chosen.coefficients))
        warnings.append(
            f"the compass cannot turn full circle: it shows {low:.0f} to {high:.0f} degrees, each for two correct "
            "headings; no series represents it and the table is empty"
        )
    return tuple(warnings)


def read_columns(
    files: Sequence[str | Path], settings: Mapping[str, Any], roles: Sequence[str] = ROLES
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Read columns of angles by role, concatenated over the files, and notes on the tables.

    In the settings, ``columns`` gives headers that differ from the roles, ``withhold`` roles or headers to ignore, and
    the keys of ``delimited.Layout`` the format of the tables.

    Raises:
        InputError: a file or column is absent or withheld, or a value cannot be read or is not an angle in degrees.
    """
    paths, withheld = [Path(file) for file in files], set(settings.get("withhold") or ())
    where = ", ".join(str(path) for path in paths)
    header = {role: (settings.get("columns") or {}).get(role, role) for role in roles}
    layout = delimited.Layout.from_settings(settings)
    names = set().union(*(delimited.read_head(path, [*header.values()], layout).names for path in paths))
    if unknown := sorted(withheld - set(header) - names):
        expected = f"columns of it ({', '.join(sorted(names)) or 'an empty file'})"
        raise InputError(f"{where}: withhold", expected=expected, found=unknown[0], advice="correct withhold")
    for role in roles:
        if {role, header[role]} & withheld:
            expected, needed = "columns that the calibration can do without", f"{role}, which it needs"
            raise InputError("withhold", expected=expected, found=needed, advice="take it out of withhold")
    tables = [delimited.read_table(path, header, ADVICE, layout) for path in paths]
    columns = {role: np.concatenate([table.columns[role] for table in tables]) for role in roles}
    for role in (role for role in roles if role != "time_utc"):
        if (largest := np.nanmax(np.abs(columns[role]), initial=0.0)) > 720.0:  # two turns
            advice = "turn the column to degrees"
            raise InputError(f"{where}: {role}", expected="degrees", found=f"{largest:g}", advice=advice)
    return columns, delimited.table_notes(tables)
