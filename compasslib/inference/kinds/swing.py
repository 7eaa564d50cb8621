"""A swing against the fitted curve: readings at headings as a bench's, a log along time by its own search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations import swing
from compasslib.calibrations.result import Calibration
from compasslib.deviation import von_appen
from compasslib.effects.composition import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep
from compasslib.effects.short import IronDrift
from compasslib.effects.swing import (
    ClocksApart,
    FilteredCourse,
    LateCourse,
    LateReading,
    SetAndDrift,
    TidalSetAndDrift,
)
from compasslib.effects.term import Term
from compasslib.inference import diagnosis, findings, show, verdict
from compasslib.inference.comparison import Options
from compasslib.inference.finding import Finding, Parameter
from compasslib.inference.kinds import platform
from compasslib.inference.kinds import swing_forward as forward
from compasslib.inference.kinds.swing_forward import KNOT_M_S, ByCourse, BySpeed, Stretches, Track, read
from compasslib.inference.omnibus import Group
from compasslib.inference.short_record import curve, fitting, outcome, scan, search
from compasslib.inference.short_record.channel import Channel, Forward
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.inference.short_record.search import NamedEffects
from compasslib.inference.verdict import Diagnosis
from compasslib.types import Floats

CONFOUNDED = "set and drift of the water cannot be separated from B and C where speeds do not vary"


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Return what a swing shows that its fitted curve does not hold.

    Args:
        files: a table of readings, or logs.
        settings: settled keys of the calibration's file.
    """
    made = swing.calibrate(files, settings)
    if made.why or not len(made.points.get("recorded_deg", ())):
        return verdict.insufficient(made.why or "no reading is left")
    if along_time(made.points["time_s"]):
        return diagnose_log(files, settings, options, made)
    recorded = made.points["recorded_deg"]
    correct = angles.wrap360(recorded + made.points["deviation_deg"])
    found = platform.judge(correct, recorded, field=settings.get("field"), options=options)
    return replace(found, not_testable=(*found.not_testable, ("water_drift", CONFOUNDED)))


# A swing logged along time, held against the deviation curve alone: five terms, no water, no delay.
#
# The heading by course over ground is compared with that by the compass, in means over 20 s: neighbouring samples are
# alike, and what is alike for longer is the law of the noise that the thresholds are drawn from. Where the ship logs
# her speed through the water that is a second comparison: it shows set and drift, and has no compass in it.


FIELD: tuple[type[Term], ...] = (HardIronStep, IronDrift)
WATER: tuple[type[Term], ...] = (SetAndDrift, TidalSetAndDrift)
DELAYS: tuple[type[Term], ...] = (FilteredCourse, LateCourse, LateReading)
BEGIN_S = 5.0  # where the fit of a delay begins, beside none
OFTEN_S = 10.0  # a log has a sample more often than that
FEWEST_STRETCHES = 24  # of 20 s: eight minutes
VARIED = 0.1  # share of the mean speed by which speeds must vary to show the zero of a ship's log beside its scale
LOG_STEP = 0.02  # of a log's scale, and of its zero in m/s
COURSE, TRUE = "courses over ground", "true headings"
SPEED = "the speed over ground against that through the water"


def along_time(time_s: Floats) -> bool:
    """Tell whether observations are a log, not readings at headings.

    Args:
        time_s: (n,) increasing, NaN without a clock.
    """
    return bool(len(time_s) > 1 and np.isfinite(time_s).all() and np.median(np.diff(time_s)) <= OFTEN_S)


def diagnose_log(
    files: Sequence[str | Path], settings: Mapping[str, Any], options: Options, made: Calibration
) -> Diagnosis:
    """Return what a log shows that the deviation curve alone does not hold.

    Args:
        files: tables or NMEA 0183 logs.
        settings: settled keys of the calibration's file.
    """
    track = read(files, settings, float(made.details["declination_deg"]))
    over = forward.without_outliers(track.seen.time_s, angles.difference(track.seen.course_deg, track.reading()))
    one_clock = settings.get("format") == "nmea0183"
    if len(over) < FEWEST_STRETCHES:
        return verdict.insufficient(too_short(len(over), FEWEST_STRETCHES))
    by_speed = _by_speed(track, over, settings, options)
    known = (
        replace(by_speed, rest=replace(by_speed.rest, strong=()))
        if by_speed is not None and by_speed.fitted.terms
        else None
    )
    fits = _bases(track, over, settings, made, known)
    before = _chosen(*fits)
    terms = platform.READOUT + (FIELD if before is fits[1] else ()) + DELAYS
    terms += () if one_clock else (ClocksApart,)
    terms += WATER if track.has_speed and known is None else ()
    channel = replace(before.channel, terms=terms)
    named = search.search(channel, options)
    beside = too_large(fits[0], named.fitted, options) if before is fits[1] else []
    found = diagnosis.of(
        [outcome.of(one) for one in ((named,) if known is None else (named, known))],
        options,
        beside=beside,
        not_testable=untested(made, named.fitted, one_clock=one_clock),
    )
    return settled(found, made, named.fitted)


def _by_speed(track: Track, over: Stretches, settings: Mapping[str, Any], options: Options) -> NamedEffects | None:
    """Return what the two speeds show of the water, None without a log of the speed through it."""
    ground, logged = track.ground_m_s, track.logged_m_s
    if ground is None or logged is None:
        return None
    own = over.without(~np.isfinite(logged))
    if len(own) < FEWEST_STRETCHES:
        return None
    scene, unit = curve.scene(track.seen.time_s, settings.get("field"))
    by_speed = BySpeed(ground, np.nan_to_num(logged), scene, own)
    means = own.mean(np.nan_to_num(logged))
    zero = LOG_STEP if np.std(means) > VARIED * np.mean(means) else 0.0  # a step of 0 holds a parameter
    channel = _channel(track, own, by_speed, start=np.array([1.0, 0.0]), steps=np.array([LOG_STEP, zero]))
    channel = replace(channel, what=SPEED, terms=WATER, reads=False, field_unit=unit)
    return search.search(channel, options)


def _bases(
    track: Track, over: Stretches, settings: Mapping[str, Any], made: Calibration, known: NamedEffects | None
) -> tuple[FittedTerms, FittedTerms]:
    """Return the deviation curve fitted as the series and as the exact compass."""
    scene, unit = curve.scene(track.seen.time_s, settings.get("field"))
    seen, ground = track.seen, track.ground_m_s
    carried = forward.water(known.fitted.terms, scene) if known is not None else np.zeros((len(seen), 2))
    free = None if ground is None else ground - carried
    by_course = ByCourse(free, seen.course_deg, track.declination_deg, track.reading, scene, False, over)
    by_exact = replace(by_course, exact=True)
    series = _channel(track, over, by_course, start=made.coefficients, steps=np.ones(len(made.coefficients)))
    exact = _channel(track, over, by_exact, start=made.exact, steps=COMPASS_STEPS)
    return tuple(fitting.fit(replace(one, field_unit=unit), ()) for one in (series, exact))  # type: ignore[return-value]


def _channel(track: Track, over: Stretches, residual: Forward, *, start: Floats, steps: Floats) -> Channel:
    seen = track.seen
    covariates = {"heading": over.heading(seen.recorded_deg), "time": over.mean(seen.time_s)}
    covariates |= {"speed": over.mean(seen.speed_kn)} if np.isfinite(seen.speed_kn).all() else {}
    covariates |= {"turn_rate": over.mean(seen.turn_deg_s)}
    return Channel(
        what=f"{COURSE if seen.over_ground else TRUE} against the fitted curve",
        residual=residual,
        start=start,
        steps=steps,
        time_s=covariates["time"],
        clocked=True,
        terms=(),
        covariates=covariates,
        starts={"course_lag": (BEGIN_S,), "compass_lag": (BEGIN_S,), "clock_offset": (-BEGIN_S, BEGIN_S)},
        remembered=True,
    )


def _chosen(series: FittedTerms, exact: FittedTerms) -> FittedTerms:
    """Return the exact compass, and the series where that is clearly nearer."""
    gained = fitting.effective(series) * np.log(exact.square / series.square)
    return series if gained > platform.CLEARLY else exact


# What the search of a swing's log says of water and delays, found or not, and what it cannot test.

WATER_DRIFT = "water_drift"
SEEN = 0.3  # share of a delay's column that the curve must leave, or it is listed as what cannot be tested
NO_SPEED = "no speeds over ground were logged: what a drift does to the course is not known"
ONE_CLOCK = "courses and headings are in one log, by one clock"
ONE_WAY = "the ship turned one way only, so that a delay is a constant like A; swing to both sides"
CONSTANT = "a constant of the course cannot be separated from A of the curve"
NO_SENSOR = "the log carries no temperature, voltage or tilt"


def too_short(count: int, fewest: int) -> str:
    """Return why a log is too short.

    Args:
        fewest: that are needed.
    """
    return (
        f"the log holds {count} stretches of 20 s that count, at least {fewest} are needed: residuals are alike for "
        "minutes, and so few do not tell an effect from them; swing for a quarter of an hour or longer"
    )


def untested(made: Calibration, fitted: FittedTerms, *, one_clock: bool) -> tuple[tuple[str, str], ...]:
    """Return what a log cannot show, with the reasons.

    Args:
        one_clock: whether headings and courses were logged by one.
    """
    absent = [("declination_error", CONSTANT)]
    absent += [(effect, NO_SENSOR) for effect in ("temperature", "supply_voltage", "heeling")]
    absent += [("clock_offset", ONE_CLOCK)] if one_clock else []
    if not _one_way(fitted):
        absent += [(effect, ONE_WAY) for effect in ("course_lag", "compass_lag")]
    if water := _water_unseparated(made):
        absent.append((WATER_DRIFT, water))
    return tuple(absent)


def _one_way(fitted: FittedTerms) -> bool:
    """Tell whether the turns show a delay beside the curve, or one was found."""
    if any(term.acts_on == "time" for term in fitted.terms):
        return True
    column = fitting.columns(fitted, LateCourse())
    return float(np.linalg.norm(fitted.projected(column))) > SEEN * float(np.linalg.norm(column))


def _water_unseparated(made: Calibration) -> str:
    """Return why set and drift cannot be told from B and C, empty where they can or where there is no water."""
    drift = made.details["drift"]
    if drift is None or drift["separable"]:
        return ""
    return NO_SPEED if drift["drift_kn"] is None else str(drift["text"])


def too_large(bare: FittedTerms, exact: FittedTerms, options: Options) -> list[Finding]:
    """Return the finding that the exact compass fits where the series does not, or none.

    Args:
        exact: the exact compass with what was found beside it; the series gets the same.
    """
    needs_it = any(term.acts_on == "field" for term in exact.terms)
    if needs_it or _beyond_series(exact.base) < options.min_effect_deg:
        return []
    series = fitting.fit(bare.channel, exact.terms, near=bare)
    apart = series.residual_deg - exact.residual_deg
    if angles.rms(apart) < options.min_effect_deg or exact.square >= series.square:
        return []
    tested = scan.test(series, exact, [Group("large_deviation", apart[:, None])])
    if not tested.groups or tested.score[0] <= tested.threshold(options.alarm):
        return []
    block = fitting.stretches(exact)
    folds = min(show.FOLDS, block.max() + 1)
    left = [outcome.left_out(one, exact.terms, block, folds) for one in (series, exact)]
    proof = show.improved(left[0], left[1], exact.scale_deg, block)
    return [] if proof.refuted else [findings.large_deviation(angles.rms(apart), proof, what=series.channel.what)]


def _beyond_series(coefficients: Floats) -> float:
    """Return what the five-term series cannot take of an exact compass's curve, rms degrees round the circle."""
    correct = np.arange(0.0, 360.0, 5.0)
    recorded = compass.recorded_heading(coefficients, correct)
    columns, deviation = von_appen.design(recorded), angles.difference(correct, recorded)
    return angles.rms(deviation - columns @ np.linalg.lstsq(columns, deviation, rcond=None)[0])


def settled(found: Diagnosis, made: Calibration, fitted: FittedTerms) -> Diagnosis:
    """Return the diagnosis with what it says of the water: set and drift, a bound, or why they cannot be separated.

    Args:
        found: by the search.
    """
    found = replace(found, findings=tuple(_with_set(one) for one in found.findings))
    drift = made.details["drift"]
    if drift is None or any(WATER_DRIFT in (one.effect, *one.alternatives) for one in found.findings):
        return found
    why = _water_unseparated(made)
    if not why:
        return replace(found, why=f"{found.why} {_bound(fitted)}")
    if found.verdict == "consistent":
        return replace(found, verdict="insufficient", why=f"{found.why} {why}", separated_by=SEPARATED)
    return replace(found, separated_by="; ".join(filter(None, (found.separated_by, SEPARATED))))


SEPARATED = (
    "water_drift or B and C of the curve: each heading at two speeds, a log of the speed through the water, a visual "
    "mark or the sun; the same circle the other way round tells only a delay"
)


def _bound(fitted: FittedTerms) -> str:
    """Return how large a drift the courses still allow."""
    if fitted.channel.covariates.get("speed") is None:
        return ""
    with_water = fitting.fit(fitted.channel, (*fitted.terms, SetAndDrift()), near=fitted)
    drift, spread = with_water.terms[-1].values, fitting.covariance(with_water)[-2:, -2:]
    most = float(np.hypot(*drift) + 1.96 * np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    return f"Set and drift of the water do not show in the courses: less than {most / KNOT_M_S:.2g} kn (95 %)."


def _with_set(one: Finding) -> Finding:
    """Return the finding of the water with set and drift beside its components."""
    if one.effect != WATER_DRIFT:
        return one
    east, north = (one.parameters[name] for name in ("east_m_s", "north_m_s"))
    drift = max(float(np.hypot(east.value, north.value)), 1e-9)
    along = np.abs([east.value, north.value]) / drift
    sigma = np.array([east.sigma, north.sigma])
    size, side = (float(np.hypot(*(sigma * share))) for share in (along, along[::-1]))
    more = {
        "drift_kn": Parameter(drift / KNOT_M_S, size / KNOT_M_S, "kn"),
        "set_deg": Parameter(float(angles.direction(east.value, north.value)), np.degrees(side / drift), "degrees"),
    }
    text = (
        f" The water sets {more['set_deg'].value:.0f}° ± {1.96 * more['set_deg'].sigma:.0f}° (true) at "
        f"{more['drift_kn'].value:.2f} ± {1.96 * more['drift_kn'].sigma:.2f} kn; a steady leeway would look the same."
    )
    return replace(one, parameters={**more, **one.parameters}, text=one.text + text)
