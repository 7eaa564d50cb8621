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
from compasslib.calibrations.budget import Source
from compasslib.calibrations.curves import count_sectors
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.swing import adjustment, model, observations
from compasslib.calibrations.swing.model import COURSE, LAG, SERIES, Swing, SwingFit, set_and_drift
from compasslib.calibrations.swing.observations import Observations, SwingOptions
from compasslib.deviation.series import series_design, series_deviation
from compasslib.errors import InputError, applicable
from compasslib.types import DAY_S, Floats

KIND, MODEL = "swing", "series"
BLOCKS = {
    COURSE: ("scatter of the courses about the curve", "least squares, alike neighbours and Student's t allowed for"),
    model.VISUAL: ("visual references", "as given, and the scatter about the curve"),
    model.WATER: ("speed through the water", "scatter of the ship's log about the triangle of speeds"),
}
ALLOWED = "anything up to the {} allowed, reduced by the information of the swing"
WATER = ("set and drift of the water", ALLOWED.format("largest"))
DELAY = ("delay of the course behind the compass", ALLOWED.format("longest"))
PRIORS = {
    model.DECLINATION: ("declination", "as given, or error of the world model at this field strength"),
    **dict.fromkeys((model.EAST, model.NORTH, model.EAST_CHANGE, model.NORTH_CHANGE), WATER),
    model.LAG: DELAY,
    model.LOG: ("scale of the ship's log", "0.1, normal, reduced by the information of the swing"),
}
REMEDY = "swing 16 to 24 headings round the full circle"


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the deviation from a swing, with uncertainty, table, verdict and magnets.

    Args:
        files: CSV tables, or NMEA 0183 logs with ``format: nmea0183``.
        settings: the keys of the calibration file (see ``observations.SwingOptions`` for those specific to swings).

    Raises:
        InputError: a file or column cannot be used, or the declination is not known.
    """
    observed = observations.read(files, settings)
    swing = _make_swing(observed, settings)
    details = _details(swing, settings)
    sectors = count_sectors(observed.recorded_deg)
    shell = Calibration(KIND, MODEL, len(observed), sectors, details=details)
    if why := _refusal(swing):
        lost = tuple(f"left out: {n} {what}" for what, n in observed.left_out.items())
        return replace(shell, why=why, points=_points(swing, None), warnings=lost + observed.warnings)
    series = model.fit_swing(swing)
    exact = model.fit_swing(swing, exact=True, start=series.parameters)
    return _make_calibration(shell, swing, series, exact)


def _make_swing(observed: Observations, settings: Mapping[str, Any]) -> Swing:
    options, place = SwingOptions.from_settings(settings), _place(observed, settings)
    date_s = _date(observed, settings)
    declination, field = settings.get("declination_deg"), settings.get("field")
    horizontal = None if field is None else float(field["horizontal_nT"])
    if declination is None:
        if place is None or date_s is None:
            expected = "a number, or position and date for the model of the earth's field"
            advice = "write declination, or latitude, longitude and date"
            raise InputError("declination", expected=expected, found="neither", advice=advice)
        east, level, _ = earthfield.igrf(*place, date_s)
        declination, horizontal = float(east[0]), float(level[0])
    sigma = options.declination_sigma_deg
    if sigma is None:
        sigma = earthfield.model_sigma(horizontal or 18_000.0)  # nT, of middle latitudes
    return Swing(observed, options, float(declination), sigma, _marks(options, place))


def _place(
    observed: Observations, settings: Mapping[str, Any], *, max_error_deg: float = 2.0
) -> tuple[float, float] | None:
    """Look up the position of the swing, and refuse one that is not that of the log."""
    if settings.get("latitude") is None or settings.get("longitude") is None:
        return observed.place
    given = float(settings["latitude"]), float(settings["longitude"])
    if observed.place and np.max(np.abs(angles.difference(given, observed.place))) > max_error_deg:
        raise InputError(
            "latitude, longitude",
            expected="the place of the log's own positions, {:.2f}, {:.2f}".format(*observed.place),
            found="{:.2f}, {:.2f}".format(*given),
            advice="correct the sign or the hemisphere, or leave both out",
        )
    return given


def _date(observed: Observations, settings: Mapping[str, Any]) -> float | None:
    """Look up the date of the swing, UTC seconds; if none is given, the median time of the log."""
    if settings.get("date_s") is not None:
        return float(settings["date_s"])
    known = observed.time_s[np.isfinite(observed.time_s)]
    return float(np.median(known)) if known.size else None


def _marks(options: SwingOptions, place: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
    marks = [(float(mark["compass_deg"]), float(mark["true_deg"])) for mark in options.visual]
    if options.sun and place is None:
        advice = "write the position of the swing"
        raise InputError("sun", expected="latitude and longitude", found="neither", advice=advice)
    latitude, longitude = place or (0.0, 0.0)
    for sight in options.sun:
        time = sight["time_utc"]
        if not isinstance(time, int | float):
            try:
                at = datetime.fromisoformat(time)
            except ValueError:
                expected = "an ISO time like 2021-05-24T11:30:00Z"
                raise InputError("sun: time_utc", expected=expected, found=repr(time), advice="correct it") from None
            time = (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()
        marks.append((float(sight["compass_deg"]), azimuth(latitude, longitude, float(time))))
    return tuple(marks)


def _details(swing: Swing, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Collect the details that need no five-term fit: principal courses, position, date, excluded observations."""
    observed, place, date_s = swing.observed, _place(swing.observed, settings), _date(swing.observed, settings)
    psi = adjustment.pseudo_deviations(observed.course_deg, observed.recorded_deg)
    principal = adjustment.principal_coefficients(psi, swing.declination_deg)
    minus_true = None  # A, D and E from courses over ground minus those from true headings (MM Table 3)
    if len(observed) and np.isfinite(observed.also_course_deg).all():
        also = adjustment.pseudo_deviations(observed.also_course_deg, observed.recorded_deg)
        by_course = adjustment.principal_coefficients(also, swing.declination_deg)
        minus_true = {letter: by_course[letter] - principal[letter] for letter in "ADE"}
    speed = float(np.median(observed.speed_kn)) if swing.has_speed and len(observed) else None
    ratio = (swing.widest_drift / speed if speed else swing.widest_drift) if observed.over_ground else 0.0
    return {
        "cardinal": _to_json(principal),
        "pseudo_deviation_deg": _to_json(psi),
        "cardinal_bound_deg": float(adjustment.error_bound_deg(ratio)),
        "drift_ratio": ratio,
        "residual_b_c": _residual_b_c(principal, swing, ratio),
        "pseudo_minus_true": minus_true,
        "declination_deg": swing.declination_deg,
        "latitude": place[0] if place else None,
        "longitude": place[1] if place else None,
        "date": datetime.fromtimestamp(date_s, UTC).strftime("%Y-%m-%d") if date_s is not None else None,
        "speed_kn": speed,
        "left_out": dict(observed.left_out),
        "marks": [{"compass_deg": c, "true_deg": t} for c, t in swing.marks],
    }


def _residual_b_c(principal: Mapping[str, Any], swing: Swing, drift_ratio: float) -> dict[str, Any] | None:
    """Compute residual B and C by the methods of MM: from one heading (Lushnikov) and two 60 to 120 degrees apart.

    Also computes B and C corrected for the drift from speeds on opposite courses, and the drift error of one heading.
    """
    known = {letter: principal[letter] for letter in "ADE"}
    bars = principal["B_bar"], principal["C_bar"]
    if not np.isfinite([*known.values(), *bars]).all():
        return None
    observed, residual = swing.observed, dict[str, Any]()
    shown = [(c, float(angles.difference(t - swing.declination_deg, c))) for c, t in swing.marks]
    if shown:
        compass_deg, deviation_deg = shown[0]
        one = {**adjustment.residual_by_lushnikov(known, bars, *shown[0])}
        residual["one_heading"] = {**one, "compass_deg": compass_deg, "deviation_deg": deviation_deg}
    if len(shown) > 1:
        try:
            b, c = adjustment.residual_from_two_headings(known, shown[0], shown[1])
            residual["two_headings"] = {"B": b, "C": c}
        except InputError as error:
            residual["two_headings"] = {"why": str(error)}
    if shown and drift_ratio and "B" not in residual.get("two_headings", {}):
        residual["one_heading"]["drift"] = adjustment.drift_in_one_heading(drift_ratio, sum(shown[0]))
    if observed.over_ground and swing.has_speed:
        speeds = adjustment.mean_by_point(observed.speed_kn, observed.course_deg, observed.recorded_deg)
        if water := adjustment.drift_by_opposite_courses(speeds):
            by_speed = {"B": bars[0] + water["x"], "C": bars[1] - water["y"]}
            residual["opposite_courses"] = {**by_speed, **water}
    return residual or None


def _make_calibration(shell: Calibration, swing: Swing, series: SwingFit, exact: SwingFit) -> Calibration:
    coefficients, covariance = series.parameters[SERIES], series.covariance[SERIES, SERIES]
    table = adjustment.deviation_table(coefficients, covariance, swing.options.table_step_deg)
    lag_s = [swing.observed.delay_s + float(series.parameters[LAG]), float(np.sqrt(series.covariance[LAG, LAG]))]
    drift = model.separate_drift(swing, series) if swing.observed.over_ground else None
    planned = adjustment.plan_magnets(coefficients, swing.options.table_step_deg)
    steps, largest = adjustment.adjust(coefficients), planned["largest_deg"]["none"]
    more = {
        "drift": drift,
        "cardinal_without_water": _without_water(shell.details["cardinal"], drift, swing.declination_deg),
        "lag_s": lag_s if swing.observed.timed else None,
        "delay": _describe_delay(swing.observed, *lag_s) if swing.observed.delay_s else None,
        "iso_25862": adjustment.verdict(table, swing.options.vessel_length_m, shell.details["speed_kn"]),
        "nullify": planned,
        "correctors": {"steps": steps}
        | ({"text": " ".join(step["text"] for step in steps)} if largest > adjustment.LIMIT_DEG else {}),
        "directive_force": adjustment.directive_force(coefficients, table.heading_deg),
        "n_effective": series.noises[COURSE].n_effective,
        "exact_residual_rms_deg": angles.rms(exact.residuals[COURSE]),
    }
    # Uncertainty budget: rms of each source over the table's headings; the squares sum to the table's mean square.
    columns, squares = series_design(table.heading_deg), dict[tuple[str, str], float]()
    for key, part in series.parts.items():
        name = BLOCKS[key] if key in BLOCKS else PRIORS[int(key)]
        left = np.einsum("ij,jk,ik->i", columns, part[SERIES, SERIES], columns)
        squares[name] = squares.get(name, 0.0) + float(np.mean(left))
    return replace(
        shell,
        coefficients=coefficients,
        covariance=covariance,
        exact=exact.parameters[SERIES],
        exact_covariance=exact.covariance[SERIES, SERIES],
        residual_rms_deg=angles.rms(series.residuals[COURSE]),
        sources=tuple(Source(name, float(np.sqrt(x)), how) for (name, how), x in squares.items() if x > 1e-12),
        table=table,
        points=_points(swing, series),
        details={**shell.details, **more},
        warnings=_warnings(swing, series, exact),
    )


def _describe_delay(observed: Observations, lag_s: float, sigma_s: float) -> dict[str, Any]:
    late, of = ("courses", "readings") if lag_s > 0.0 else ("readings", "courses")
    without, left = observed.misfit_deg
    text = (
        f"The {late} are late by {abs(lag_s):.1f} ± {1.96 * sigma_s:.1f} s (95 %). They are paired with the {of} of "
        f"then, and turns are kept: the mean misfit is {left:.1f}° instead of {without:.1f}°."
    )
    return {"applied_s": observed.delay_s, "misfit_deg": {"without": without, "with": left}, "text": text}


def _without_water(
    principal: Mapping[str, Any], drift: Mapping[str, Any] | None, declination_deg: float
) -> dict[str, float] | None:
    """Correct B, C, D and E for set and drift, MM (36), (40) to (42); None if these cannot be separated."""
    if not drift or not drift["separable"] or None in (principal[k] for k in ("B_bar", "C_bar", "D", "E")):
        return None
    water = adjustment.set_and_drift_terms(drift["drift_ratio"], drift["set_deg"] - declination_deg)
    semicircular = {"B": principal["B_bar"] + water["x"], "C": principal["C_bar"] - water["y"]}
    return semicircular | {"D": principal["D"] - water["D"], "E": principal["E"] + water["E"]}


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


def _to_json(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert numbers for JSON, non-finite ones to None."""
    return {
        key: _to_json(x) if isinstance(x, Mapping) else (float(x) if np.isfinite(x) else None)
        for key, x in content.items()
    }


def azimuth(latitude: float, longitude: float, time_s: float) -> float:
    """Compute the sun's true azimuth, degrees, at a time in UTC seconds since 1970, by VSOP87 (PyEphem)."""
    import ephem  # imported late: only sun sights need it

    here = ephem.Observer()
    here.lat, here.lon, here.pressure = str(latitude), str(float(angles.wrap180(longitude))), 0.0
    here.date = time_s / DAY_S + 25567.5  # from PyEphem's epoch, noon of 31 December 1899
    return float(angles.wrap360(ephem.Sun(here).az / angles.DEGREE))


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
    if gap > observations.REFUSED_GAP_DEG:
        sectors = count_sectors(observed.recorded_deg)
        if observations.widest_gap(observed.course_deg) <= observations.REFUSED_GAP_DEG:
            return (
                f"the courses go round the circle, the compass does not (a gap of {gap:.0f}°): iron stronger than the "
                "earth's horizontal field gives each reading for two headings; use kind: platform, with "
                "recorded_deg and, as reference_deg, the course minus the declination"
            )
        return (
            f"the headings cover {sectors} of 36 sectors and leave a gap of {gap:.0f}°: so narrow an arc does not "
            f"determine five coefficients; {REMEDY}"
        )
    return ""


def _warnings(swing: Swing, series: SwingFit, exact: SwingFit, *, series_limit_deg: float = 20.0) -> tuple[str, ...]:
    """List the conditions under which the curve holds; Smith's series is valid to 20° (Le Menn et al. 2023)."""
    observed = swing.observed
    warnings = [
        *_constant_warnings(swing, series),
        *(f"left out: {n} {why}" for why, n in observed.left_out.items()),
        *observed.warnings,
        *_heading_warnings(swing, series),
        *_drift_warnings(swing, series),
        *_quadrant_warnings(swing),
        *_time_warnings(swing, series),
    ]
    stated = observed.variation_deg
    if np.isfinite(stated) and abs(float(angles.difference(stated, swing.declination_deg))) >= 0.5:
        warnings.append(f"the log states a declination of {stated:+.1f}°, {swing.declination_deg:+.1f}° is used")
    columns = series_design(np.arange(0.0, 360.0, angles.SECTOR_DEG))
    largest = float(np.max(np.abs(columns @ series.parameters[SERIES])))
    if largest >= series_limit_deg:
        left, by_exact = angles.rms(series.residuals[COURSE]), angles.rms(exact.residuals[COURSE])
        warnings.append(
            f"deviations up to {largest:.0f}° exceed the validity of the five-term series (about 20°): its residual is "
            f"{left:.1f}° rms, that of the exact compass {by_exact:.1f}°"
        )
    return tuple(warnings)


def _heading_warnings(
    swing: Swing, series: SwingFit, *, wide_gap_deg: float = 100.0, structure_deg: float = 2.0
) -> list[str]:
    """Warn of few headings, wide gaps, and a residual of a steady swing that reading errors do not explain."""
    recorded, rms = swing.observed.recorded_deg, angles.rms(series.residuals[COURSE])
    distinct, gap = observations.distinct_headings(recorded), observations.widest_gap(recorded)
    warnings = []
    if distinct < 16:
        warnings.append(
            f"{distinct} headings determine at most {distinct} coefficients, 5 of which are fitted"
            f"{': sin 4 of the heading is not observable' if distinct == 8 else ''}; "
            f"third and fourth harmonics cannot be tested. To test them, {REMEDY}"
        )
    if distinct < (n := len(recorded)) < 100:
        warnings.append(f"{n - distinct} of {n} observations repeat a heading and do not add to it")
    if rms > structure_deg and not swing.observed.timed:
        warnings.append(_harmonic_warning(swing, series, rms))
    if gap > wide_gap_deg:
        warnings.append(f"{gap:.0f}° of the circle hold no heading: the table is extrapolated there")
    return warnings


def _harmonic_warning(swing: Swing, series: SwingFit, rms: float) -> str:
    recorded, residual = swing.observed.recorded_deg, series.residuals[COURSE]
    size = {}
    for order, name in ((3, "third"), (4, "fourth")):
        columns = np.stack(angles.sin_cos(order * recorded), axis=-1)
        if order == 4 and observations.distinct_headings(recorded) == 8:
            columns = columns[:, 1:]  # sin 4 of the heading is unobservable
        both = np.column_stack([series_design(recorded), columns])
        taken = residual - both @ np.linalg.lstsq(both, residual, rcond=1e-6)[0]
        size[name] = angles.rms(taken)
    return (
        f"residual of the series {rms:.2f}° rms; with the third harmonic of the heading {size['third']:.2f}°, with the "
        f"fourth {size['fourth']:.2f}°: sextantal or octantal deviation is possible"
    )


def _drift_warnings(swing: Swing, series: SwingFit) -> list[str]:
    if not swing.observed.over_ground:
        return []
    drift, widest = model.separate_drift(swing, series), swing.widest_drift
    sentences = {
        f"no speeds were logged: a drift up to {widest:.2f} of the ship's speed is assumed (drift_ratio)": (
            not swing.has_speed
        ),
        str(drift["text"]): not drift["separable"],
        f"the estimated drift exceeds the {widest:g} kn that are allowed: raise max_drift_kn if that is possible": (
            swing.has_speed and set_and_drift(series.parameters)[1] > widest
        ),
    }
    return applicable(sentences)


def _quadrant_warnings(swing: Swing) -> list[str]:
    """Warn if the only quadrantal course does not lie in the mark's quadrant (MM section 7.1, point 4)."""
    psi = adjustment.pseudo_deviations(swing.observed.course_deg, swing.observed.recorded_deg)
    steered = [point for point in adjustment.POINTS[1::2] if np.isfinite(psi[point])]
    if len(steered) != 1 or not swing.marks or not swing.observed.over_ground:
        return []
    wanted = {adjustment.POINTS[2 * int(angles.wrap360(compass) // 90.0) + 1] for compass, _ in swing.marks}
    if wanted <= set(steered):
        return []
    return [
        f"the mark lies in the quadrant of {', '.join(sorted(wanted))} and D comes from {steered[0]} alone, so that an "
        "error of D by higher harmonics enters B and C: steer the quadrantal course of the mark's quadrant, between "
        "the first two cardinal courses"
    ]


def _time_warnings(swing: Swing, series: SwingFit) -> list[str]:
    observed, most = swing.observed, swing.options.max_lag_s
    if not observed.timed:
        return []
    sigma, effective = np.sqrt(np.diag(series.covariance)), series.noises[COURSE].n_effective
    sentences = {
        f"the delay of the courses is the longest allowed, {most:g} s: raise max_lag_s if a longer one is possible": (
            observed.delay_s and abs(observed.delay_s) >= most
        ),
        f"residuals are autocorrelated; effective sample size {effective:.0f} of {len(observed)}": (
            effective < len(observed) / 2.0
        ),
        "the ship turned one way only, so that the delay of the course cannot be separated from A: swing to both "
        "sides": abs(series.covariance[0, LAG]) / (sigma[0] * sigma[LAG]) > 0.7,
    }
    return applicable(sentences)


def _constant_warnings(swing: Swing, series: SwingFit, least_deg: float = 2.0) -> list[str]:
    """Warn if A is close to -1 or -2 times the declination: north references or a sign are then probably confused.

    Smaller angles are not compared.
    """
    constant, declination = float(series.parameters[0]), swing.declination_deg
    near = max(2.0 * float(np.sqrt(series.covariance[0, 0])), 0.5)
    if min(abs(constant), abs(declination)) <= max(least_deg, near):
        return []
    confused = {
        1.0: "the recorded headings are probably true already (HDG of some logs is), or the courses magnetic; if so, "
        "write declination: 0",
        2.0: "the declination probably has the wrong sign; if so, correct declination, or latitude and longitude",
    }
    begin = f"A is {constant:+.1f}°, which is"
    return [
        f"{begin} {'twice ' * (times == 2.0)}minus the declination of {declination:+.1f}°: {what}"
        for times, what in confused.items()
        if abs(float(angles.difference(constant, -times * declination))) < near
    ]
