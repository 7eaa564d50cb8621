"""Diagnose a swing against its fitted curve: readings at headings as on a bench, or a log as a time series.

Courses are compared with the compass in averages over 20 s, as neighbouring samples are correlated; longer correlation
is modelled as ARMA noise. Speeds through the water are a second comparison, which is independent of the compass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.constants import knot

from compasslib import angles
from compasslib.calibrations import swing
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.swing import observations
from compasslib.calibrations.swing.observations import Observations
from compasslib.effects import reference
from compasslib.effects.effect import Effect, Scene
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.reference import LateCourse, SetAndDrift
from compasslib.inference import comparison, diagnosis, short_search
from compasslib.inference.comparison import Comparison, Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import Finding, Parameter
from compasslib.inference.kinds import platform
from compasslib.inference.kinds.platform import CurveResidual, recording_scene
from compasslib.inference.short_model import FittedHypothesis, ResidualModel, ShortComparison
from compasslib.inference.short_search import ShortInference, build_outcome
from compasslib.statistics.least_squares import robust_width
from compasslib.types import Floats

Filter = Callable[[Floats], Floats]

STRETCH_S, MOST_STRETCHES, FEWEST_STRETCHES = 20.0, 150, 24  # averaging time, longer than a helmsman's yaw; intervals
FULL = 0.25  # least number of samples in a stretch, relative to the median
WIDE = 4.0  # robust widths from the median of its stretch beyond which a sample is an outlier
OFTEN_S = 10.0  # longest median sampling interval of a log
BEGIN_S = 5.0  # starting value of a delay, in addition to zero
VARIED = 0.1  # standard deviation over mean speed from which a ship's log's zero is fitted as well as its scale
LOG_STEP = 0.02  # fit step of a ship's log's scale, and of its zero in m/s
LEAST_WATER_KN = 0.5  # least speed at which the impeller of a ship's log turns
SMOOTHED_S = 30.0  # averaging time of the speed over ground: longer than a swell, shorter than a turn
LEAST_SEPARABLE = 0.3  # least share of a delay's column outside the span of the fit, below which it is not testable

WATER: tuple[type[Effect], ...] = (SetAndDrift, reference.TidalSetAndDrift)
DELAYS: tuple[type[Effect], ...] = (reference.FilteredCourse, LateCourse, reference.LateReading)
STARTS = {"course_lag": (BEGIN_S,), "compass_lag": (BEGIN_S,), "clock_offset": (-BEGIN_S, BEGIN_S)}

CONFOUNDED = "set and drift of the water cannot be separated from B and C where speeds do not vary"
NO_SPEED = "no speeds over ground were logged: what a drift does to the course is not known"
SAME_CLOCK = "courses and headings are in one log, by one clock"
SAME_TURN = "the ship turned one way only, so that a delay is a constant like A; swing to both sides"
CONSTANT = "a constant of the course cannot be separated from A of the curve"
NO_SENSOR = "the log carries no temperature, voltage or tilt"
SEPARATED = (
    "water_drift or B and C of the curve: each heading at two speeds, a log of the speed through the water, a visual "
    "mark or the sun, not the same circle the other way round, which tells only a delay"
)


@dataclass(frozen=True)
class Stretches:
    """Assignment of n samples to k stretches of time."""

    number: NDArray[np.intp]  # (n,) index of each sample's stretch, -1 for none

    def __len__(self) -> int:
        return int(self.number.max(initial=-1)) + 1

    def without(self, lost: NDArray[np.bool_]) -> Stretches:
        """Remove the samples ``lost``, (n,), and stretches left without any."""
        used, number = (self.number >= 0) & ~lost, np.full(len(lost), -1)
        number[used] = np.unique(self.number[used], return_inverse=True)[1]
        return Stretches(number)

    def mean(self, x: Floats) -> Floats:
        """Average a series, (n,), over each stretch, (k,)."""
        used = self.number >= 0
        return np.asarray(np.bincount(self.number[used], x[used]) / np.bincount(self.number[used]))


def stretches(time_s: Floats, good: NDArray[np.bool_]) -> Stretches:
    """Divide a log into stretches of 20 s, longer for logs over 50 minutes; stretches with few samples are dropped."""
    count = len(np.unique(np.floor((time_s - time_s[0]) / STRETCH_S)))
    length = STRETCH_S * max(1.0, count / MOST_STRETCHES)
    number = np.floor((time_s - time_s[0]) / length).astype(np.intp)
    there = np.bincount(number[good], minlength=number[-1] + 1)
    full = there >= FULL * np.median(there[there > 0])
    return Stretches(number).without(~(good & full[number]))


def without_outliers(time_s: Floats, off_deg: Floats) -> Stretches:
    """Divide a log into stretches, excluding outliers of course minus reading (``off_deg``, (n,) degrees)."""
    first = stretches(time_s, np.ones(len(time_s), dtype=bool))
    inside, away = first.number >= 0, np.full(len(time_s), np.inf)
    for k in range(len(first)):
        inside_deg = off_deg[first.number == k]
        middle = inside_deg[0] + np.median(angles.difference(inside_deg, inside_deg[0]))
        away[first.number == k] = np.abs(angles.difference(inside_deg, middle))
    return stretches(time_s, away <= WIDE * max(robust_width(away[inside]), 0.5))


@dataclass(frozen=True)
class Track:
    """Courses, n, with the compass readings around them."""

    observations: Observations
    declination_deg: float
    seconds: Floats  # (m,) 1 s grid over the log
    turned_deg: Floats  # (m,) unwrapped readings
    scene: Scene
    field_unit: tuple[float, str]

    def reading(self, later_s: Floats | float = 0.0, filters: Sequence[Filter] = ()) -> Floats:
        """Interpolate the reading on the 1 s grid, filtered, at a delay after each course, (n,) degrees."""
        series = reduce(lambda turned, filtered: filtered(turned), filters, self.turned_deg)
        return np.interp(self.observations.time_s + later_s, self.seconds, series)

    @property
    def ground_m_s(self) -> Floats | None:
        """Velocity over ground with smoothed speeds, (n, 2), true east and north; None without speeds."""
        observed = self.observations
        if not (observed.over_ground and np.isfinite(observed.speed_kn).all()):
            return None
        speed = knot * observations.moving_average(observed.speed_kn, observed.time_s, SMOOTHED_S)
        return np.stack(angles.components(speed, observed.course_deg), axis=-1)


def read(files: Sequence[str | Path], settings: Mapping[str, Any], declination_deg: float) -> Track:
    """Read the track of a log, without slow fixes but with turns, which show delays, and with all readings."""
    turning = {**settings, "max_turn_deg_s": np.inf, "max_lag_s": 0.0}
    all_samples = observations.read(files, {**turning, "min_speed_kn": -1.0})
    time_s, first = np.unique(all_samples.time_s, return_index=True)
    heading = all_samples.recorded_deg[first]
    turned = np.cumsum(np.append(heading[:1], angles.difference(heading[1:], heading[:-1])))
    seconds, observed = np.arange(time_s[0], time_s[-1] + 1.0), observations.read(files, turning)
    scene = recording_scene(observed.time_s, settings.get("field"))
    return Track(observed, declination_deg, seconds, np.interp(seconds, time_s, turned), *scene)


@dataclass(frozen=True)
class ByCourse:
    """Heading from the courses, corrected for the current, minus compass heading, averaged over stretches."""

    track: Track
    ground_m_s: Floats | None  # (n, 2) velocity over ground, true east and north; None without speeds
    exact: bool  # whether the exact compass is used instead of the series
    over: Stretches

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated heading, (k,) degrees; base is A to E, degrees or dimensionless."""
        scene, true_deg = self.track.scene, self.track.observations.course_deg
        of_time = (term for term in terms if term.acts_on == "time")
        at_once: Floats = np.zeros(len(scene))
        later = reduce(lambda seconds, term: term.apply(seconds, scene), of_time, at_once)
        if self.ground_m_s is not None:
            through = self.ground_m_s - water(terms, scene)
            true_deg = angles.direction(through[:, 0], through[:, 1])
        of_reading = [term for term in terms if term.acts_on == "reading"]
        filters = [partial(term.apply, scene=scene) for term in of_reading if term.side == "reference"]
        of_compass = tuple(term for term in terms if term.acts_on in ("field", "reading") and term.side == "compass")
        recorded, correct = self.track.reading(later, filters), true_deg - self.track.declination_deg
        return self.over.mean(CurveResidual(correct, recorded, scene, self.exact)(base, of_compass))


@dataclass(frozen=True)
class BySpeed:
    """Speed from the velocity over ground minus that of the ship's log, relative to the mean speed, in degrees."""

    ground_m_s: Floats  # (n, 2) true east and north
    logged_m_s: Floats  # (n,)
    scene: Scene
    over: Stretches

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated over mean speed, (k,) degrees; base is the log's scale and zero (m/s)."""
        through = self.ground_m_s - water(terms, self.scene)
        off = np.hypot(through[:, 0], through[:, 1]) - base[0] * self.logged_m_s - base[1]
        return self.over.mean(off / angles.DEGREE / float(np.mean(np.hypot(*self.ground_m_s.T))))


def water(terms: Sequence[Effect], scene: Scene) -> Floats:
    """Sum the velocities of the water in terms, (n, 2) m/s, true east and north."""
    still: Floats = np.zeros((len(scene), 2))
    of_water = (term for term in terms if term.acts_on == "velocity")
    return reduce(lambda moving, term: term.apply(moving, scene), of_water, still)


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose a swing from a table of readings or from logs, with the resolved settings of its calibration file."""
    made = swing.calibrate(files, settings)
    if made.why or not len(made.points.get("recorded_deg", ())):
        return diagnosis.insufficient(made.why or "no reading is left")
    time_s = made.points["time_s"]  # NaN without a clock
    if len(time_s) > 1 and np.isfinite(time_s).all() and np.median(np.diff(time_s)) <= OFTEN_S:
        track = read(files, settings, float(made.details["declination_deg"]))
        return _diagnose_log(track, options, made, same_clock=settings.get("format") == "nmea0183")
    recorded = made.points["recorded_deg"]
    correct = angles.wrap360(recorded + made.points["deviation_deg"])
    searched = platform.diagnose_readings(correct, recorded, field=settings.get("field"), options=options)
    return replace(searched, not_testable=(*searched.not_testable, ("water_drift", CONFOUNDED)))


def _diagnose_log(track: Track, options: Options, made: Calibration, *, same_clock: bool) -> Diagnosis:
    """Diagnose a time series against the deviation curve: five coefficients, no current, no delay."""
    observed, ground = track.observations, track.ground_m_s
    over = without_outliers(observed.time_s, angles.difference(observed.course_deg, track.reading()))
    if len(over) < FEWEST_STRETCHES:
        return diagnosis.insufficient(
            f"the log holds {len(over)} stretches of 20 s that count, at least {FEWEST_STRETCHES} are needed: "
            "residuals are alike for minutes, and so few do not tell an effect from them; swing for a quarter of an "
            "hour or longer"
        )
    searched = [] if ground is None else _search_speeds(track, ground, over, options)
    if ground is not None and searched:
        ground = ground - water(searched[0].fitted.terms, track.scene)
    what = f"{'courses over ground' if observed.over_ground else 'true headings'} against the fitted curve"
    series, exact = (
        _compare(track, over, what, ByCourse(track, ground, exact, over), start=start, steps=steps)
        for exact, start, steps in (
            (False, made.coefficients, np.ones(len(made.coefficients))),
            (True, made.exact, COMPASS_STEPS),
        )
    )
    more = (
        DELAYS
        + (() if same_clock else (reference.ClocksApart,))
        + (WATER if ground is not None and not searched else ())
    )
    named, first = platform.search_curve(series, exact, options, more)
    outcomes = [
        replace(each, findings=tuple(_with_water(item, each.comparison, made) for item in each.findings))
        for each in (build_outcome(found, options.min_effect_deg) for found in (named, *searched))
    ]
    untested = _untested(made, named.fitted, same_clock=same_clock)
    return _state_water(diagnosis.combine_outcomes(outcomes, options, extra=first, not_testable=untested), made)


def _search_speeds(track: Track, ground: Floats, over: Stretches, options: Options) -> list[ShortInference]:
    """Search speeds over ground and through the water; empty without a current, or enough speeds through the water."""
    turns = np.nan_to_num(track.observations.water_speed_kn) > LEAST_WATER_KN
    logged, with_log = np.where(turns, knot * track.observations.water_speed_kn, 0.0), over.without(~turns)
    if len(with_log) < FEWEST_STRETCHES:
        return []
    means, what = with_log.mean(logged), "the speed over ground against that through the water"
    zero = LOG_STEP if np.std(means) > VARIED * np.mean(means) else 0.0  # a step of 0 holds a parameter
    by_speed, steps = BySpeed(ground, logged, track.scene, with_log), np.array([LOG_STEP, zero])
    of_speed = _compare(track, with_log, what, by_speed, start=np.array([1.0, 0.0]), steps=steps)
    found = short_search.search_effects(replace(of_speed, terms=WATER, reads=False), options)
    return [found] if found.fitted.terms else []


def _compare(
    track: Track, over: Stretches, what: str, residual: ResidualModel, *, start: Floats, steps: Floats
) -> ShortComparison:
    observed = track.observations
    heading = angles.direction(*(over.mean(wave) for wave in angles.sin_cos(observed.recorded_deg)))
    covariates = {"heading": heading, "time": over.mean(observed.time_s)}
    covariates |= {"speed": over.mean(observed.speed_kn)} if np.isfinite(observed.speed_kn).all() else {}
    covariates |= {"turn_rate": over.mean(observed.turn_deg_s)}
    return ShortComparison(
        what=what,
        residual=residual,
        start=start,
        steps=steps,
        time_s=covariates["time"],
        terms=(),
        covariates=covariates,
        field_unit=track.field_unit,
        starts=STARTS,
        arma_noise=True,
    )


def _untested(made: Calibration, fitted: FittedHypothesis, *, same_clock: bool) -> tuple[tuple[str, str], ...]:
    """List the effects that a log cannot show, with reasons; ``same_clock``: headings and courses have one clock."""
    column = fitted.derivative(LateCourse())
    shown = float(np.linalg.norm(fitted.projected(column))) > LEAST_SEPARABLE * float(np.linalg.norm(column))
    one_way = not shown and not any(term.acts_on == "time" for term in fitted.terms)
    reasons = {
        "declination_error": CONSTANT,
        **dict.fromkeys(("temperature", "supply_voltage", "heeling"), NO_SENSOR),
        "clock_offset": SAME_CLOCK if same_clock else "",
        **dict.fromkeys(("course_lag", "compass_lag"), SAME_TURN if one_way else ""),
        SetAndDrift.name: _water_unseparated(made),
    }
    return tuple((effect, why) for effect, why in reasons.items() if why)


def _water_unseparated(made: Calibration) -> str:
    """Explain why set and drift cannot be separated from B and C; empty if they can, or without courses over ground."""
    drift = made.details["drift"]
    if drift is None or drift["separable"]:
        return ""
    return NO_SPEED if drift["drift_kn"] is None else str(drift["text"])


def _state_water(diagnosed: Diagnosis, made: Calibration) -> Diagnosis:
    """Add a bound on the current, or the reason why set and drift cannot be separated from B and C."""
    drift, why = made.details["drift"], _water_unseparated(made)
    if drift is None or any(SetAndDrift.name in (item.effect, *item.alternatives) for item in diagnosed.findings):
        return diagnosed
    if why:
        separated = "; ".join(filter(None, (diagnosed.separated_by, SEPARATED)))
        if diagnosed.verdict == "consistent":
            diagnosed = replace(diagnosed, verdict="insufficient", why=f"{diagnosed.why} {why}")
        return replace(diagnosed, separated_by=separated)
    if drift["drift_kn"] is None:
        return diagnosed
    most = drift["drift_kn"] + 1.96 * np.sqrt(np.linalg.eigvalsh(drift["covariance"])[-1])
    bound = f"Set and drift of the water do not show in the courses: less than {most:.2g} kn (95 %)."
    return replace(diagnosed, why=f"{diagnosed.why} {bound}".strip())


def _with_water(item: Finding, compared: Comparison, made: Calibration) -> Finding:
    """Replace set and drift of a finding by those of the curve's fit: the report must state only one current."""
    drift = made.details["drift"]
    if item.effect != SetAndDrift.name or drift["drift_kn"] is None:
        return item
    sigma = (knot * np.sqrt(np.diag(drift["covariance"]))).tolist()
    components = {
        "east_m_s": Parameter(knot * drift["east"], sigma[0], "m/s"),
        "north_m_s": Parameter(knot * drift["north"], sigma[1], "m/s"),
    }
    chances = {item.effect: item.probability, **item.alternatives_probability}
    size, proof, place = item.rms_effect_deg, item.held_out, item.where
    rebuilt = comparison.build_finding(
        compared, SetAndDrift(), chances, components, size_deg=size, proof=proof, place=place
    )
    more = {
        "drift_kn": Parameter(drift["drift_kn"], drift["sigma_drift_kn"], "kn"),
        "set_deg": Parameter(drift["set_deg"], drift["sigma_set_deg"], "degrees"),
    }
    text = f"{rebuilt.text} The water: {drift['described']} (95 %); a steady leeway would look the same."
    return replace(rebuilt, parameters={**more, **components}, text=text)
