"""A swing: deviation by courses over ground (GNSS), true headings, a visual mark or the sun.

Least squares over all headings with the water's set and drift beside the compass; Moncunill Marimon et al. 2023 (MM)
for the eight principal courses, the table, the certificate's verdict and the magnets.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.calibrations.result import Calibration, Source
from compasslib.calibrations.swing import cardinal, data, model, nullify, words
from compasslib.calibrations.swing.data import Observations, SwingOptions
from compasslib.calibrations.swing.fit import SwingFit
from compasslib.calibrations.swing.model import COURSE, SERIES, Swing
from compasslib.deviation import von_appen
from compasslib.errors import InputError
from compasslib.types import Floats

KIND, MODEL = "swing", "series"
# Error of declination by a world model, crust included: hypot(0.26, 5417 nT / H) degrees (WMM2025).
MODEL_DEG, MODEL_NT = 0.26, 5417.0
FAR_DEG = 2.0  # between the place that is given and the log's own
UNKNOWN_FIELD_DEG = 0.4  # the same at H = 18,000 nT
BLOCKS = {
    COURSE: ("scatter of the courses about the curve", "least squares, alike neighbours and Student's t allowed for"),
    model.VISUAL: ("visual references", "as given, and the scatter about the curve"),
    model.SECOND: ("set and drift in second order", "57.3 (d/S)² in D and E, MM (37), (43)"),
    model.WATER: ("speed through the water", "scatter of the ship's log about the triangle of speeds"),
}
WATER = ("set and drift of the water", "anything up to the largest allowed, less what the swing tells")
DELAY = (
    "delay of the course behind the compass",
    "anything up to the longest allowed, less what the swing tells",
)
PRIORS = {
    model.DECLINATION: ("declination", "as given, or error of the world model at this field strength"),
    **dict.fromkeys((model.EAST, model.NORTH, model.EAST_CHANGE, model.NORTH_CHANGE), WATER),
    model.LAG: DELAY,
    model.LOG: ("scale of the ship's log", "0.1, normal, less what the swing tells"),
}
NOTHING = 1e-12
UNIX_EPOCH_IN_EPHEM_DAYS = 25567.5  # days from its zero, noon of 31 December 1899


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the deviation that a swing shows, with uncertainty, table, verdict and magnets.

    Args:
        files: CSV tables, or NMEA 0183 logs with ``format: nmea0183``.
        settings: the keys of the calibration file (``swing_data.SwingOptions`` has those of this kind alone).

    Raises:
        InputError: a file or column cannot be used, or the declination is not known.
    """
    seen = data.read(files, settings)
    swing = _swing(seen, settings)
    details = _details(swing, settings)
    shell = Calibration(
        KIND, MODEL, len(seen), words.coverage(seen.recorded_deg), details=details, warnings=seen.warnings
    )
    why = words.refusal(swing)
    if why:
        lost = tuple(f"left out: {n} {what}" for what, n in seen.left_out.items())
        return replace(shell, why=why, points=_points(swing, None), warnings=lost + seen.warnings)
    series = model.fit(swing)
    exact = model.fit(swing, exact=True, start=series.parameters)
    return _fitted(shell, swing, series, exact)


def _swing(seen: Observations, settings: Mapping[str, Any]) -> Swing:
    options, place = SwingOptions.of(settings), _place(seen, settings)
    date_s = _date(seen, settings)
    declination, horizontal = settings.get("declination_deg"), _horizontal(settings.get("field"))
    if declination is None:
        if place is None or date_s is None:
            raise InputError(
                "declination",
                expected="a number, or position and date for the model of the earth's field",
                found="neither",
                advice="write declination, or latitude, longitude and date",
            )
        east, level, _ = earthfield.igrf(*place, date_s)
        declination, horizontal = float(east[0]), float(level[0])
    sigma = options.declination_sigma_deg
    if sigma is None:
        sigma = float(np.hypot(MODEL_DEG, MODEL_NT / horizontal)) if horizontal else UNKNOWN_FIELD_DEG
    return Swing(seen, options, float(declination), sigma, _marks(options, place))


def _place(seen: Observations, settings: Mapping[str, Any]) -> tuple[float, float] | None:
    latitude, longitude = settings.get("latitude"), settings.get("longitude")
    if latitude is None or longitude is None:
        return seen.place
    given = float(latitude), float(longitude)
    if seen.place and max(abs(angles.difference(a, b)) for a, b in zip(given, seen.place, strict=True)) > FAR_DEG:
        raise InputError(
            "latitude, longitude",
            expected="the place of the log's own positions, {:.2f}, {:.2f}".format(*seen.place),
            found="{:.2f}, {:.2f}".format(*given),
            advice="correct the sign or the hemisphere, or leave both out",
        )
    return given


def _date(seen: Observations, settings: Mapping[str, Any]) -> float | None:
    """Return the day of the swing, UTC seconds; the log's own where none is given."""
    if settings.get("date_s") is not None:
        return float(settings["date_s"])
    known = seen.time_s[np.isfinite(seen.time_s)]
    return float(np.median(known)) if known.size else None


def _horizontal(field: Any) -> float | None:
    if field is None:
        return None
    value = field["horizontal_nT"] if isinstance(field, Mapping) else field.horizontal_nT
    return float(np.mean(value))


def _marks(options: SwingOptions, place: tuple[float, float] | None) -> tuple[tuple[float, float], ...]:
    marks = [(float(mark["compass_deg"]), float(mark["true_deg"])) for mark in options.visual]
    if options.sun and place is None:
        raise InputError(
            "sun", expected="latitude and longitude", found="neither", advice="write the position of the swing"
        )
    latitude, longitude = place or (0.0, 0.0)
    suns = [(float(x["compass_deg"]), azimuth(latitude, longitude, _seconds(x["time_utc"]))) for x in options.sun]
    return tuple(marks + suns)


def _seconds(time: float | str) -> float:
    if isinstance(time, int | float):
        return float(time)
    try:
        at = datetime.fromisoformat(time)
    except ValueError:
        raise InputError(
            "sun: time_utc", expected="an ISO time like 2021-05-24T11:30:00Z", found=repr(time), advice="correct it"
        ) from None
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


def _details(swing: Swing, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return what does not need the five-term fit: the eight courses, place, date, what was left out."""
    seen, place, date_s = swing.seen, _place(swing.seen, settings), _date(swing.seen, settings)
    psi = cardinal.pseudo_deviations(seen.course_deg, seen.recorded_deg)
    principal = cardinal.coefficients(psi, swing.declination_deg)
    speed = float(np.median(seen.speed_kn)) if swing.has_speed and len(seen) else None
    ratio = (swing.widest_drift / speed if speed else swing.widest_drift) if seen.over_ground else 0.0
    return {
        "cardinal": _plain(principal),
        "pseudo_deviation_deg": _plain(psi),
        "cardinal_bound_deg": float(cardinal.error_bound_deg(ratio)),
        "drift_ratio": ratio,
        "residual_b_c": _residual(principal, swing),
        "declination_deg": swing.declination_deg,
        "latitude": place[0] if place else None,
        "longitude": place[1] if place else None,
        "date": datetime.fromtimestamp(date_s, UTC).strftime("%Y-%m-%d") if date_s is not None else None,
        "speed_kn": speed,
        "left_out": dict(seen.left_out),
        "marks": [{"compass_deg": c, "true_deg": t} for c, t in swing.marks],
    }


def _residual(principal: Mapping[str, Any], swing: Swing) -> dict[str, Any] | None:
    """Return residual B and C by MM's own ways: two headings 60 to 120 degrees apart, else one (Lushnikov)."""
    known = {letter: principal[letter] for letter in "ADE"}
    bars = principal["B_bar"], principal["C_bar"]
    if not (swing.marks and np.isfinite([*known.values(), *bars]).all()):
        return None
    shown = [(c, float(angles.difference(t - swing.declination_deg, c))) for c, t in swing.marks]
    one = cardinal.from_one_heading(known, bars, *shown[0])
    found: dict[str, Any] = {"one_heading": {**one, "compass_deg": shown[0][0], "deviation_deg": shown[0][1]}}
    if len(shown) > 1:
        try:
            b, c = cardinal.from_two_headings(known, shown[0], shown[1])
            found["two_headings"] = {"B": b, "C": c}
        except InputError as error:
            found["two_headings"] = {"why": str(error)}
    return found


def _fitted(shell: Calibration, swing: Swing, series: SwingFit, exact: SwingFit) -> Calibration:
    coefficients, covariance = series.parameters[SERIES], series.covariance[SERIES, SERIES]
    found = nullify.table(coefficients, covariance, swing.options.table_step_deg)
    lag = model.LAG
    drift = words.separation(swing, series) if swing.seen.over_ground else None
    more = {
        "drift": drift,
        "cardinal_without_water": _without_water(shell.details["cardinal"], drift, swing.declination_deg),
        "lag_s": [float(series.parameters[lag]), float(np.sqrt(series.covariance[lag, lag]))]
        if swing.seen.timed
        else None,
        "iso_25862": nullify.verdict(found, swing.options.vessel_length_m, shell.details["speed_kn"]),
        "nullify": nullify.plan(coefficients, swing.options.table_step_deg),
        "n_effective": series.noises[COURSE].n_effective,
        "exact_residual_rms_deg": angles.rms(exact.residuals[COURSE]),
    }
    return replace(
        shell,
        coefficients=coefficients,
        covariance=covariance,
        exact=exact.parameters[SERIES],
        exact_covariance=exact.covariance[SERIES, SERIES],
        residual_rms_deg=angles.rms(series.residuals[COURSE]),
        sources=_sources(series, found.heading_deg),
        table=found,
        points=_points(swing, series),
        details={**shell.details, **more},
        warnings=words.warnings(swing, series, exact),
    )


def _without_water(
    principal: Mapping[str, Any], drift: Mapping[str, Any] | None, declination_deg: float
) -> dict[str, float] | None:
    """Return B, C, D and E with the water taken out, MM (36), (40) to (42), where the swing tells it."""
    if not drift or not drift["separable"] or None in (principal[k] for k in ("B_bar", "C_bar", "D", "E")):
        return None
    water = cardinal.set_and_drift_terms(drift["drift_ratio"], drift["set_deg"] - declination_deg)
    return {
        "B": principal["B_bar"] + water["x"],
        "C": principal["C_bar"] - water["y"],
        "D": principal["D"] - water["D"],
        "E": principal["E"] + water["E"],
    }


def _sources(series: SwingFit, heading_deg: Floats) -> tuple[Source, ...]:
    """Return the budget: what each source leaves in the table, rms over its headings; squares add up to the table's."""
    columns, squares = von_appen.design(heading_deg), dict[tuple[str, str], float]()
    for key, part in series.parts.items():
        name = BLOCKS[key] if key in BLOCKS else PRIORS[int(key)]
        left = np.einsum("ij,jk,ik->i", columns, part[SERIES, SERIES], columns)
        squares[name] = squares.get(name, 0.0) + float(np.mean(left))
    return tuple(Source(name, float(np.sqrt(x)), how) for (name, how), x in squares.items() if x > NOTHING)


def _points(swing: Swing, series: SwingFit | None) -> dict[str, Floats]:
    seen = swing.seen
    columns = {"recorded_deg": seen.recorded_deg, "course_deg": seen.course_deg, "speed_kn": seen.speed_kn}
    columns |= {"time_s": seen.time_s, "turn_deg_s": seen.turn_deg_s}
    columns["pseudo_deviation_deg"] = angles.difference(seen.course_deg, seen.recorded_deg)
    if series is not None:
        columns["deviation_deg"] = (
            von_appen.predict(series.parameters[SERIES], seen.settled_deg) + series.residuals[COURSE]
        )
        columns["residual_deg"] = series.residuals[COURSE]
        columns["sigma_deg"] = series.noises[COURSE].sigma
    return columns


def _plain(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers for JSON, None where there is none."""
    return {
        key: _plain(x) if isinstance(x, Mapping) else (float(x) if np.isfinite(x) else None)
        for key, x in content.items()
    }


def azimuth(latitude: float, longitude: float, time_s: float) -> float:
    """Return the sun's azimuth from true north, degrees, by VSOP87 (PyEphem).

    Args:
        time_s: UTC seconds since 1970.
    """
    import ephem  # only swings by the sun need it

    here = ephem.Observer()
    here.lat, here.lon, here.pressure = str(latitude), str(float(angles.wrap180(longitude))), 0.0
    here.date = time_s / 86400.0 + UNIX_EPOCH_IN_EPHEM_DAYS
    return float(angles.wrap360(ephem.Sun(here).az / angles.DEGREE))
