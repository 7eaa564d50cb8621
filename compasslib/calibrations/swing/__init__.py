"""Compass swing: deviation from courses over ground (GNSS), true headings, a visual mark or the sun.

Compass and set and drift of the water are fitted jointly by least squares over all headings; the eight principal
courses, the table, the certificate's verdict and the magnets follow Moncunill Marimon et al. 2023 (MM).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.calibrations.curves import count_sectors
from compasslib.calibrations.result import ALIGNMENT_DEG, Calibration, Source
from compasslib.calibrations.swing import adjustment, model, observations
from compasslib.calibrations.swing.model import COURSE, LAG, SERIES, Swing, SwingFit, set_and_drift
from compasslib.calibrations.swing.observations import Observations, SwingOptions
from compasslib.deviation.series import series_design, series_deviation
from compasslib.errors import InputError, applicable
from compasslib.records import iso_time
from compasslib.types import DAY_S, Floats

KIND, MODEL = "swing", "series"
ALLOWED = "anything up to the {} allowed, reduced by the information of the swing"
WATER = ("set and drift of the water", ALLOWED.format("largest"))
BUDGET = {  # rows of the budget by block or parameter with a prior, and their origins
    COURSE: ("scatter of the courses about the curve", "least squares, alike neighbours and Student's t allowed for"),
    model.VISUAL: ("visual references", "as given, and the scatter about the curve"),
    model.WATER: ("speed through the water", "scatter of the ship's log about the triangle of speeds"),
    str(model.DECLINATION): ("declination", "as given, or error of the world model at this field strength"),
    **dict.fromkeys(map(str, (*model.DRIFT, *model.CHANGES)), WATER),
    str(model.LAG): ("delay of the course behind the compass", ALLOWED.format("longest")),
    str(model.LOG): ("scale of the ship's log", "0.1, normal, reduced by the information of the swing"),
}
REMEDY = "swing 16 to 24 headings round the full circle"
MIDDLE_NT = 18_000.0  # horizontal field of middle latitudes
MOST_SCATTER_DEG = 15.0  # of courses about the curve; three real swings: 1.6 to 3.9
YEAR_S = 366.0 * DAY_S  # in which the declination changes by some tenths of a degree


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the deviation from a swing, with uncertainty, table, verdict and magnets."""
    observed, options = observations.read(files, settings), SwingOptions.from_settings(settings)
    place, date_s, dates = _place(observed, settings), settings.get("date_s"), list[str]()
    if np.isfinite(observed.time_s).any():
        logged_s = float(np.nanmedian(observed.time_s))
        date_s = logged_s if date_s is None else date_s
        if logged_s > YEAR_S and abs(logged_s - date_s) > YEAR_S:  # a log without dates counts from 0
            dates = [f"the log is of {iso_time(logged_s)[:10]}, the declination of {iso_time(date_s)[:10]} (date)"]
    declination, horizontal = settings.get("declination_deg"), (settings.get("field") or {}).get("horizontal_nT")
    if declination is None:
        if place is None or date_s is None:
            expected = "a number, or position and date for the model of the earth's field"
            advice = "write declination, or latitude, longitude and date"
            found = "no position" if place is None else "no date"
            raise InputError("declination", expected=expected, found=found, advice=advice)
        east, level, _ = earthfield.igrf(*place, date_s)
        declination, horizontal = float(east[0]), float(level[0])
    sigma = options.declination_sigma_deg or earthfield.model_sigma(horizontal or MIDDLE_NT)
    swing = Swing(observed, options, float(declination), sigma, _marks(options, place))
    made = Calibration(
        KIND,
        MODEL,
        n=len(observed),
        coverage=count_sectors(observed.recorded_deg),
        details={
            **_principal_courses(swing),
            "declination_deg": swing.declination_deg,
            "latitude": place[0] if place else None,
            "longitude": place[1] if place else None,
            "date": None if date_s is None else iso_time(date_s)[:10],
            "left_out": dict(observed.left_out),
            "marks": [{"compass_deg": c, "true_deg": t} for c, t in swing.marks],
        },
        why=_refusal(swing),
        warnings=(*(f"left out: {n} {why}" for why, n in observed.left_out.items()), *observed.warnings, *dates),
    )
    if made.why:
        return replace(made, points=_points(swing, None))
    series = model.fit_swing(swing)
    exact = model.fit_swing(replace(swing, exact=True), start=series.parameters)
    drift = model.separate_drift(swing, series) if observed.over_ground else None
    return replace(
        made,
        coefficients=series.parameters[SERIES],
        covariance=series.covariance[SERIES, SERIES],
        exact=exact.parameters[SERIES],
        exact_covariance=exact.covariance[SERIES, SERIES],
        residual_rms_deg=angles.rms(series.residuals[COURSE]),
        points=_points(swing, series),
        warnings=(*made.warnings, *_warnings(swing, series, exact, drift)),
        **_certificate(made.details, swing, series, drift),
    )


def _place(observed: Observations, settings: Mapping[str, Any]) -> tuple[float, float] | None:
    """Look up the position of the swing, and refuse one that is not that of the log."""
    if settings.get("latitude") is None or settings.get("longitude") is None:
        return observed.place
    given = float(settings["latitude"]), float(settings["longitude"])
    if observed.place and np.max(np.abs(angles.difference(given, observed.place))) > 2.0:  # degrees
        raise InputError(
            "latitude, longitude",
            expected="the place of the log's own positions, {:.2f}, {:.2f}".format(*observed.place),
            found="{:.2f}, {:.2f}".format(*given),
            advice="correct the sign or the hemisphere, or leave both out",
        )
    return given


def _marks(options: SwingOptions, place: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
    marks = [(float(mark["compass_deg"]), float(mark["true_deg"])) for mark in options.visual]
    for sight in options.sun:
        if place is None:
            advice = "write the position of the swing"
            raise InputError("sun", expected="latitude and longitude", found="neither", advice=advice)
        time = sight["time_utc"]
        if isinstance(time, str):
            at = datetime.fromisoformat(time)
            time = (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()
        marks.append((float(sight["compass_deg"]), azimuth(*place, float(time))))
    return tuple(marks)


def azimuth(latitude: float, longitude: float, time_s: float) -> float:
    """Compute the sun's true azimuth, degrees, at a time in UTC seconds since 1970, by VSOP87 (PyEphem)."""
    import ephem  # imported late: only sun sights need it

    here = ephem.Observer()
    here.lat, here.lon, here.pressure = str(latitude), str(float(angles.wrap180(longitude))), 0.0
    here.date = time_s / DAY_S + 25567.5  # from PyEphem's epoch, noon of 31 December 1899
    return float(angles.wrap360(ephem.Sun(here).az / angles.DEGREE))


def _principal_courses(swing: Swing) -> dict[str, Any]:
    """Compute the coefficients from the principal courses, and residual B and C, by the formulae of MM."""
    observed, declination = swing.observed, swing.declination_deg
    psi = adjustment.pseudo_deviations(observed.course_deg, observed.recorded_deg)
    principal = adjustment.principal_coefficients(psi, declination)
    minus_true = None  # A, D and E from courses over ground minus those from true headings (MM Table 3)
    if len(observed) and np.isfinite(observed.also_course_deg).all():
        also = adjustment.pseudo_deviations(observed.also_course_deg, observed.recorded_deg)
        by_course = adjustment.principal_coefficients(also, declination)
        minus_true = {letter: by_course[letter] - principal[letter] for letter in "ADE"}
    speed = float(np.median(observed.speed_kn)) if swing.has_speed and len(observed) else None
    ratio = swing.widest_drift / (speed or 1.0) if observed.over_ground else 0.0
    speeds = None
    if observed.over_ground and swing.has_speed:
        speeds = adjustment.mean_by_point(observed.speed_kn, observed.course_deg, observed.recorded_deg)
    marks = [(c, float(angles.difference(t - declination, c))) for c, t in swing.marks]
    return {
        "cardinal": principal,
        "pseudo_deviation_deg": psi,
        "cardinal_bound_deg": adjustment.error_bound_deg(ratio),
        "residual_b_c": adjustment.residual_b_and_c(principal, marks, ratio, speeds) or None,
        "pseudo_minus_true": minus_true,
        "speed_kn": speed,
    }


def _certificate(
    details: Mapping[str, Any], swing: Swing, series: SwingFit, drift: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Make table, uncertainty budget and details: drift and delay, verdict, magnets and their adjustment."""
    observed, principal, options = swing.observed, details["cardinal"], swing.options
    coefficients, covariance = series.parameters[SERIES], series.covariance[SERIES, SERIES]
    table = adjustment.deviation_table(coefficients, covariance, options.table_step_deg)
    lag_s = [observed.delay_s + float(series.parameters[LAG]), float(np.sqrt(series.covariance[LAG, LAG]))]
    without_water = None  # B, C, D and E corrected for set and drift, MM (36), (40) to (42)
    if drift and drift["separable"] and np.isfinite([principal[k] for k in ("B_bar", "C_bar", "D", "E")]).all():
        water = adjustment.set_and_drift_terms(drift["drift_ratio"], drift["set_deg"] - swing.declination_deg)
        without_water = {"B": principal["B_bar"] + water["x"], "C": principal["C_bar"] - water["y"]}
        without_water |= {"D": principal["D"] - water["D"], "E": principal["E"] + water["E"]}
    delay = None
    if observed.delay_s:
        late, other = ("courses", "readings") if lag_s[0] > 0.0 else ("readings", "courses")
        without, left = observed.misfit_deg
        text = (
            f"The {late} are late by {abs(lag_s[0]):.1f} ± {1.96 * lag_s[1]:.1f} s (95 %). They are paired with the "
            f"{other} of then, and turns are kept: the mean misfit is {left:.1f}° instead of {without:.1f}°."
        )
        delay = {"applied_s": observed.delay_s, "text": text}
    magnets, steps = adjustment.plan_magnets(coefficients, table.heading_deg), adjustment.adjust(coefficients)
    correctors: dict[str, Any] = {"steps": steps}
    if magnets["largest_deg"]["none"] > adjustment.LIMIT_DEG:
        correctors["text"] = " ".join(step["text"] for step in steps)
    # Uncertainty budget: rms of each source over the table's headings; the squares sum to the table's mean square.
    columns, squares = series_design(table.heading_deg), dict[tuple[str, str], float]()
    for key, part in series.parts.items():
        left_over = np.einsum("ij,jk,ik->i", columns, part[SERIES, SERIES], columns)
        squares[BUDGET[key]] = squares.get(BUDGET[key], 0.0) + float(np.mean(left_over))
    more = {
        "drift": drift,
        "cardinal_without_water": without_water,
        "lag_s": lag_s if observed.timed else None,
        "delay": delay,
        "iso_25862": adjustment.verdict(table, options.vessel_length_m, details["speed_kn"]),
        "nullify": magnets,
        "correctors": correctors,
        "directive_force": adjustment.directive_force(coefficients, table.heading_deg).tolist(),
    }
    sources = tuple(Source(name, float(np.sqrt(x)), how) for (name, how), x in squares.items() if x > 1e-12)
    return {"table": table, "sources": sources, "details": {**details, **more}}


def _points(swing: Swing, series: SwingFit | None) -> dict[str, Floats]:
    observed = swing.observed
    names = ("recorded_deg", "course_deg", "speed_kn", "time_s", "turn_deg_s")
    columns = {name: getattr(observed, name) for name in names}
    columns["pseudo_deviation_deg"] = angles.difference(observed.course_deg, observed.recorded_deg)
    if series is not None:
        residual = series.residuals[COURSE]
        columns["deviation_deg"] = series_deviation(series.parameters[SERIES], observed.settled_deg) + residual
        columns["residual_deg"] = residual
        columns["sigma_deg"] = series.noises[COURSE].sigma
    return columns


def _refusal(swing: Swing) -> str:
    """Explain why the five-term series cannot be fitted; empty if it can."""
    observed = swing.observed
    if not len(observed):
        lost = "; ".join(f"{n} {why}" for why, n in observed.left_out.items())
        return f"no usable observations{f': {lost}' if lost else ''}"
    distinct = observations.distinct_headings(observed.recorded_deg)
    if distinct < 5:
        count = "one heading" if distinct == 1 else f"{distinct} headings"
        return f"{count} cannot carry the five coefficients: {REMEDY}"
    if len(observed) + len(swing.marks) <= 5:
        return f"{len(observed)} observations leave no degree of freedom for the uncertainty: {REMEDY}"
    gap = observations.widest_gap(observed.recorded_deg)
    if gap <= observations.REFUSED_GAP_DEG:
        return ""
    if observations.widest_gap(observed.course_deg) <= gap / 2.0:
        return (
            f"the courses go round the circle, the compass does not (a gap of {gap:.0f}°): iron stronger than the "
            "earth's horizontal field gives each reading for two headings; use kind: platform, with "
            "recorded_deg and, as reference_deg, the course minus the declination"
        )
    lost = "; ".join(f"{n} left out: {why}" for why, n in observed.left_out.items())
    return (
        f"the headings cover {count_sectors(observed.recorded_deg)} of 36 sectors and leave a gap of {gap:.0f}°: so "
        f"narrow an arc does not determine five coefficients{f' ({lost})' if lost else ''}; {REMEDY}"
    )


def _warnings(swing: Swing, series: SwingFit, exact: SwingFit, drift: Mapping[str, Any] | None) -> list[str]:
    """List the conditions under which the curve holds: of headings, water, delay and size of the deviation."""
    observed, declination, most_s = swing.observed, swing.declination_deg, swing.options.max_lag_s
    n, distinct = len(observed), observations.distinct_headings(observed.recorded_deg)
    gap, stated = observations.widest_gap(observed.recorded_deg), observed.variation_deg
    water, widest = drift is not None, swing.widest_drift
    psi = adjustment.pseudo_deviations(observed.course_deg, observed.recorded_deg)
    steered = [point for point in adjustment.POINTS[1::2] if np.isfinite(psi[point])]
    marked = {adjustment.POINTS[2 * int(angles.wrap360(compass) // 90.0) + 1] for compass, _ in swing.marks}
    sigma, effective = np.sqrt(np.diag(series.covariance)), series.noises[COURSE].n_effective
    columns = series_design(np.arange(0.0, 360.0, angles.SECTOR_DEG))
    largest = float(np.max(np.abs(columns @ series.parameters[SERIES])))
    left, by_exact = angles.rms(series.residuals[COURSE]), angles.rms(exact.residuals[COURSE])
    conditions = {
        f"{distinct} headings determine at most {distinct} coefficients, 5 of which are fitted"
        f"{': sin 4 of the heading is not observable' if distinct == 8 else ''}; "
        f"third and fourth harmonics cannot be tested. To test them, {REMEDY}": distinct < 16,
        f"{n - distinct} of {n} observations repeat a heading and do not add to it": distinct < n < 100,
        f"{gap:.0f}° of the circle hold no heading: the table is extrapolated there": gap > 100.0,
        f"no speeds were logged: a drift up to {widest:.2f} of the ship's speed is assumed (drift_ratio)": (
            water and not swing.has_speed
        ),
        str(drift and drift["text"]): drift and not drift["separable"],
        f"the estimated drift exceeds the {widest:g} kn that are allowed: raise max_drift_kn if that is possible": (
            water and swing.has_speed and set_and_drift(series.parameters)[1] > widest > 0.0
        ),
        f"the mark lies in the quadrant of {', '.join(sorted(marked))} and D comes from {', '.join(steered)} "
        "alone, so that an error of D by higher harmonics enters B and C: steer the quadrantal course of the "
        "mark's quadrant, between the first two cardinal courses": (
            water and len(steered) == 1 and not marked <= set(steered)
        ),
        f"the delay of the courses is the longest allowed, {most_s:g} s: raise max_lag_s if it may be longer": (
            observed.delay_s and abs(observed.delay_s) >= most_s
        ),
        f"residuals are autocorrelated; effective sample size {effective:.0f} of {n}": (
            observed.timed and effective < n / 2.0
        ),
        "the ship turned one way only, so that the delay of the course cannot be separated from A: swing to both "
        "sides": observed.timed and abs(series.covariance[0, LAG]) / (sigma[0] * sigma[LAG]) > 0.7,
        f"the courses scatter by {left:.0f}° about the curve, where those of real swings scatter by 1 to 4°: they are "
        "not of this ship or time, the compass has no constant deviation, or courses without way were logged": (
            left > MOST_SCATTER_DEG
        ),
        f"the log states a declination of {stated:+.1f}°, {declination:+.1f}° is used": (
            np.isfinite(stated) and abs(float(angles.difference(stated, declination))) >= 0.5
        ),
        f"deviations up to {largest:.0f}° exceed the validity of the five-term series (about 20°): its residual is "
        f"{left:.1f}° rms, that of the exact compass {by_exact:.1f}°": largest >= 20.0,
    }
    return [*_constant_warnings(swing, series), *applicable(conditions)]


def _constant_warnings(swing: Swing, series: SwingFit) -> list[str]:
    """Warn if A is large; close to -1 or -2 times the declination, north references or a sign are probably confused."""
    constant, declination = float(series.parameters[0]), swing.declination_deg
    near = max(2.0 * float(np.sqrt(series.covariance[0, 0])), 0.5)
    confused = {
        1.0: "the recorded headings are probably true already (HDG of some logs is), or the courses magnetic; if so, "
        "write declination: 0",
        2.0: "the declination probably has the wrong sign; if so, correct declination, or latitude and longitude",
    }
    begin = f"A is {constant:+.1f}°, which is"
    alike = [
        f"{begin} {'twice ' * (times == 2.0)}minus the declination of {declination:+.1f}°: {what}"
        for times, what in confused.items()
        if abs(float(angles.difference(constant, -times * declination))) < near
        and min(abs(constant), abs(declination)) > max(2.0, near)
    ]
    large = f"A is {constant:+.1f}°, which turns all headings alike: check position, date, and how the compass stands"
    return alike or [large] * (abs(constant) > max(ALIGNMENT_DEG, near))
