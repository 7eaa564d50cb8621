"""A swing logged along time, held against the deviation curve alone: five terms, no water, no delay.

The heading by course over ground is compared with that by the compass, in means over 20 s: neighbouring samples are
alike, and what is alike for longer is the law of the noise that the thresholds are drawn from. Where the ship logs her
speed through the water that is a second comparison: it shows set and drift, and has no compass in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibration.result import Calibration
from compasslib.discrepancy import verdict
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.recordings import curve, fitting, report, search, swing_told
from compasslib.discrepancy.recordings import swing_forward as forward
from compasslib.discrepancy.recordings.channel import Channel, Forward
from compasslib.discrepancy.recordings.fitting import Fitted
from compasslib.discrepancy.recordings.search import Named
from compasslib.discrepancy.recordings.swing_forward import ByCourse, BySpeed, Stretches
from compasslib.discrepancy.recordings.swing_terms import (
    Carried,
    CarriedByTide,
    ClocksApart,
    FilteredCourse,
    LateCourse,
    LateReading,
)
from compasslib.discrepancy.recordings.swing_track import Track, read
from compasslib.discrepancy.recordings.terms import Drift, IronDrift
from compasslib.discrepancy.verdict import Diagnosis
from compasslib.physics.hard_iron_step import HardIronStep
from compasslib.physics.heading_slip import HeadingSlip
from compasslib.physics.octantal import Octantal
from compasslib.physics.sextantal import Sextantal
from compasslib.physics.term import Term

Floats = NDArray[np.floating]

READOUT: tuple[type[Term], ...] = (Sextantal, Octantal, HeadingSlip, Drift)
FIELD: tuple[type[Term], ...] = (HardIronStep, IronDrift)
WATER: tuple[type[Term], ...] = (Carried, CarriedByTide)
DELAYS: tuple[type[Term], ...] = (FilteredCourse, LateCourse, LateReading)
BEGIN_S = 5.0  # where the fit of a delay begins, beside none
OFTEN_S = 10.0  # a log has a sample more often than that
FEWEST_STRETCHES = 24
VARIED = 0.1  # share of the mean speed by which speeds must vary to show the zero of a ship's log beside its scale
LOG_STEP = 0.02  # of a log's scale, and of its zero in m/s
CLEARLY = 6.0  # twice the log likelihood by which the series must be better to stand for the compass
COURSE, TRUE = "courses over ground", "true headings"
SPEED = "the speed over ground against that through the water"


def along_time(time_s: Floats) -> bool:
    """Tell whether observations are a log, not readings at headings.

    Args:
        time_s: (n,) increasing, NaN without a clock.
    """
    return bool(len(time_s) > 1 and np.isfinite(time_s).all() and np.median(np.diff(time_s)) <= OFTEN_S)


def diagnose(
    files: Sequence[str | Path], settings: Mapping[str, Any], options: Options, made: Calibration
) -> Diagnosis:
    """Return what a log shows that the deviation curve alone does not hold.

    Args:
        files: tables or NMEA 0183 logs.
        settings: settled keys of the calibration's file.
        options: what may be chosen.
        made: the calibration of the same files.
    """
    track = read(files, settings, float(made.details["declination_deg"]))
    over = forward.without_outliers(track.seen.time_s, angles.difference(track.seen.course_deg, track.reading()))
    one_clock = settings.get("format") == "nmea0183"
    if len(over) < FEWEST_STRETCHES:
        return verdict.insufficient(swing_told.too_short(len(over), FEWEST_STRETCHES))
    by_speed = _by_speed(track, over, settings, options)
    known = replace(by_speed, left=()) if by_speed is not None and by_speed.fitted.terms else None
    fits = _bases(track, over, settings, made, known)
    before = _chosen(*fits)
    terms = READOUT + (FIELD if before is fits[1] else ()) + DELAYS
    terms += () if one_clock else (ClocksApart,)
    terms += WATER if track.has_speed and known is None else ()
    channel = replace(before.channel, terms=terms)
    named = search.search(channel, alarm=options.alarm, min_effect_deg=options.min_effect_deg)
    beside = swing_told.too_large(fits[0], named.fitted, options) if before is fits[1] else []
    found = report.diagnosis(
        [named] if known is None else [named, known],
        min_effect_deg=options.min_effect_deg,
        beside=beside,
        not_testable=swing_told.untested(made, named.fitted, one_clock=one_clock),
    )
    return swing_told.settled(found, made, named.fitted)


def _by_speed(track: Track, over: Stretches, settings: Mapping[str, Any], options: Options) -> Named | None:
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
    channel = replace(channel, what=SPEED, terms=WATER, field_unit=unit)
    return search.search(channel, alarm=options.alarm, min_effect_deg=options.min_effect_deg)


def _bases(
    track: Track, over: Stretches, settings: Mapping[str, Any], made: Calibration, known: Named | None
) -> tuple[Fitted, Fitted]:
    """Return the deviation curve fitted as the series and as the exact compass."""
    scene, unit = curve.scene(track.seen.time_s, settings.get("field"))
    seen, ground = track.seen, track.ground_m_s
    carried = forward.water(known.fitted.terms, scene) if known is not None else np.zeros((len(seen), 2))
    free = None if ground is None else ground - carried
    by_course = ByCourse(free, seen.course_deg, track.declination_deg, track.reading, scene, False, over)
    by_exact = replace(by_course, exact=True)
    series = _channel(track, over, by_course, start=made.coefficients, steps=np.ones(len(made.coefficients)))
    exact = _channel(track, over, by_exact, start=made.exact, steps=curve.STEPS)
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


def _chosen(series: Fitted, exact: Fitted) -> Fitted:
    """Return the exact compass, and the series where that is clearly nearer."""
    gained = fitting.effective(series) * np.log(exact.square / series.square)
    return series if gained > CLEARLY else exact
