"""Diagnose a swing against its fitted curve: readings at headings as on a bench, or a log as a time series.

The heading from the course over ground is compared with the compass in averages over 20 s, since neighbouring samples
are correlated; longer correlation is modelled as ARMA noise, from which the thresholds are drawn. Speeds through the
water, where logged, are a second comparison, which shows set and drift and is independent of the compass.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
from compasslib.effects.effect import Effect, Scene
from compasslib.effects.forward import COMPASS_STEPS
from compasslib.effects.iron import HardIronStep, HardIronTrend
from compasslib.effects.ship import ClocksApart, FilteredCourse, LateCourse, LateReading, SetAndDrift, TidalSetAndDrift
from compasslib.inference import comparison, diagnosis, short_findings, short_fit, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis, Outcome
from compasslib.inference.finding import Finding, Parameter
from compasslib.inference.kinds import platform
from compasslib.inference.short_fit import (
    CompassResidual,
    FittedHypothesis,
    ResidualModel,
    SeriesResidual,
    ShortComparison,
)
from compasslib.inference.short_search import ShortInference
from compasslib.statistics.least_squares import robust_width
from compasslib.types import Floats

Filter = Callable[[Floats], Floats]

STRETCH_S, MOST_STRETCHES = 20.0, 150  # averaging time, longer than a helmsman's yaw; most intervals
FULL = 0.25  # least number of samples in a stretch, relative to the median
WIDE = 4.0  # robust widths from the median of its stretch beyond which a sample is an outlier

CONFOUNDED = "set and drift of the water cannot be separated from B and C where speeds do not vary"


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
        number = self.number[self.number >= 0]
        return np.asarray(np.bincount(number, x[self.number >= 0]) / np.bincount(number))

    def heading(self, x_deg: Floats) -> Floats:
        """Average directions, (n,) degrees, over each stretch, (k,) degrees."""
        sine, cosine = angles.sin_cos(x_deg)
        return angles.direction(self.mean(sine), self.mean(cosine))


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
    inside = first.number >= 0
    middle = np.full(len(first), np.nan)
    for k in range(len(first)):
        inside_deg = off_deg[first.number == k]
        middle[k] = inside_deg[0] + np.median(angles.difference(inside_deg, inside_deg[0]))
    away = np.where(inside, np.abs(angles.difference(off_deg, middle[first.number])), np.inf)
    return stretches(time_s, away <= WIDE * max(robust_width(away[inside]), 0.5))


@dataclass(frozen=True)
class ByCourse:
    """Heading from the courses, corrected for the current, minus compass heading, averaged over stretches."""

    ground_m_s: Floats | None  # (n, 2) velocity over ground, true east and north; None without speeds
    course_deg: Floats  # (n,) relative to true north
    declination_deg: float
    reading: Callable[[Floats, Sequence[Filter]], Floats]  # delays (n,) s, filters -> (n,) degrees
    scene: Scene
    exact: bool  # whether the exact compass is used instead of the series
    over: Stretches

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated heading, (k,) degrees; base is A to E, degrees or dimensionless."""
        correct = self.by_course(terms)
        later: Floats = np.zeros(len(self.scene))
        for term in (term for term in terms if term.acts_on == "time"):
            later = term.apply(later, self.scene)
        recorded = self.reading(later, [partial(term.apply, scene=self.scene) for term in terms if _of_course(term)])
        compass_terms = tuple(term for term in terms if term.acts_on in ("field", "reading") and not _of_course(term))
        form = CompassResidual if self.exact else SeriesResidual
        return self.over.mean(form(correct, recorded, self.scene)(base, compass_terms))

    def by_course(self, terms: tuple[Effect, ...]) -> Floats:
        """Compute magnetic headings, (n,) degrees, from the courses with the velocity of the water subtracted."""
        if self.ground_m_s is None:
            return self.course_deg - self.declination_deg
        through = self.ground_m_s - water(terms, self.scene)
        return angles.direction(through[:, 0], through[:, 1]) - self.declination_deg


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


def _of_course(term: Effect) -> bool:
    """Return whether a term filters the heading that the course over ground follows."""
    return term.acts_on == "reading" and term.side == "reference"


def water(terms: tuple[Effect, ...], scene: Scene) -> Floats:
    """Sum the velocities of the water in terms, (n, 2) m/s, true east and north."""
    moving: Floats = np.zeros((len(scene), 2))
    for term in (term for term in terms if term.acts_on == "velocity"):
        moving = term.apply(moving, scene)
    return moving


LEAST_WATER_KN = 0.5  # least speed at which the impeller of a ship's log turns
SMOOTHED_S = 30.0  # averaging time of the speed over ground: longer than a swell, shorter than a turn


@dataclass(frozen=True)
class Track:
    """Courses with the compass readings around them."""

    observations: Observations  # (n,)
    declination_deg: float
    time_s: Floats  # (m,) 1 s grid over the log
    turned_deg: Floats  # (m,) unwrapped readings

    def reading(self, later_s: Floats | float = 0.0, filters: Sequence[Filter] = ()) -> Floats:
        """Interpolate the reading at a delay after each course, (n,) degrees.

        Args:
            later_s: delay of each reading, (n,) s.
            filters: applied in turn to the readings on the 1 s grid.
        """
        series = self.turned_deg
        for filtered in filters:
            series = filtered(series)
        return np.interp(self.observations.time_s + later_s, self.time_s, series)

    @property
    def has_speed(self) -> bool:
        """Return whether the courses are over ground and have speeds."""
        return self.observations.over_ground and bool(np.isfinite(self.observations.speed_kn).all())

    @property
    def ground_m_s(self) -> Floats | None:
        """Velocity over ground with smoothed speeds, (n, 2), true east and north; None without speeds."""
        if not self.has_speed:
            return None
        speed = knot * observations.moving_average(self.observations.speed_kn, self.observations.time_s, SMOOTHED_S)
        return np.stack(angles.components(speed, self.observations.course_deg), axis=-1)

    @property
    def logged_m_s(self) -> Floats:
        """Speed through the water, (n,), NaN where missing."""
        turns = np.nan_to_num(self.observations.water_speed_kn) > LEAST_WATER_KN
        return np.where(turns, knot * self.observations.water_speed_kn, np.nan)


def read(files: Sequence[str | Path], settings: Mapping[str, Any], declination_deg: float) -> Track:
    """Read the track of a log, without slow fixes but with turns, which show delays, and with all readings.

    Args:
        files: tables or NMEA 0183 logs.
        declination_deg: east positive.
    """
    turning = {**settings, "max_turn_deg_s": np.inf, "max_lag_s": 0.0}
    all_samples = observations.read(files, {**turning, "min_speed_kn": -1.0})
    time_s, first = np.unique(all_samples.time_s, return_index=True)
    heading = all_samples.recorded_deg[first]
    turned = np.cumsum(np.append(heading[:1], angles.difference(heading[1:], heading[:-1])))
    seconds = np.arange(time_s[0], time_s[-1] + 1.0)
    return Track(observations.read(files, turning), declination_deg, seconds, np.interp(seconds, time_s, turned))


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options) -> Diagnosis:
    """Diagnose a swing from a table of readings or from logs, with the resolved settings of its calibration file."""
    made = swing.calibrate(files, settings)
    if made.why or not len(made.points.get("recorded_deg", ())):
        return diagnosis.insufficient(made.why or "no reading is left")
    if along_time(made.points["time_s"]):
        return diagnose_log(files, settings, options, made)
    recorded = made.points["recorded_deg"]
    correct = angles.wrap360(recorded + made.points["deviation_deg"])
    searched = platform.diagnose_readings(correct, recorded, field=settings.get("field"), options=options)
    return replace(searched, not_testable=(*searched.not_testable, ("water_drift", CONFOUNDED)))


FIELD: tuple[type[Effect], ...] = (HardIronStep, HardIronTrend)
WATER: tuple[type[Effect], ...] = (SetAndDrift, TidalSetAndDrift)
DELAYS: tuple[type[Effect], ...] = (FilteredCourse, LateCourse, LateReading)
BEGIN_S = 5.0  # starting value of a delay, in addition to zero
OFTEN_S = 10.0  # longest median sampling interval of a log
FEWEST_STRETCHES = 24  # of 20 s, i.e. eight minutes
VARIED = 0.1  # standard deviation over mean speed from which a ship's log's zero is fitted as well as its scale
LOG_STEP = 0.02  # fit step of a ship's log's scale, and of its zero in m/s
COURSE, TRUE = "courses over ground", "true headings"
SPEED = "the speed over ground against that through the water"


def along_time(time_s: Floats) -> bool:
    """Return whether observations form a time series, not readings at headings; times are NaN without a clock."""
    return bool(len(time_s) > 1 and np.isfinite(time_s).all() and np.median(np.diff(time_s)) <= OFTEN_S)


def diagnose_log(
    files: Sequence[str | Path], settings: Mapping[str, Any], options: Options, made: Calibration
) -> Diagnosis:
    """Diagnose a time series against the deviation curve: five coefficients, no current, no delay."""
    track = read(files, settings, float(made.details["declination_deg"]))
    over = without_outliers(
        track.observations.time_s, angles.difference(track.observations.course_deg, track.reading())
    )
    same_clock = settings.get("format") == "nmea0183"
    if len(over) < FEWEST_STRETCHES:
        return diagnosis.insufficient(too_short(len(over), FEWEST_STRETCHES))
    by_speed = _by_speed(track, over, settings, options)
    known = by_speed if by_speed is not None and by_speed.fitted.terms else None
    fits = _bases(track, over, settings, made, known)
    before = fits[0] if platform.series_fits_better(*fits) else fits[1]
    terms = platform.READOUT + (FIELD if before is fits[1] else ()) + DELAYS
    terms += () if same_clock else (ClocksApart,)
    terms += WATER if track.has_speed and known is None else ()
    named = short_search.search_effects(replace(before.comparison, terms=terms), options)
    extra = platform.too_large(fits[0], named.fitted, options) if before is fits[1] else []
    searched = (named,) if known is None else (named, known)
    outcomes = [short_findings.build_outcome(each, options.min_effect_deg) for each in searched]
    diagnosed = diagnosis.combine_outcomes(
        [replace(each, findings=tuple(_with_water(item, each, made) for item in each.findings)) for each in outcomes],
        options,
        extra=extra,
        not_testable=untested(made, named.fitted, same_clock=same_clock),
    )
    return add_water_statement(diagnosed, made)


def _by_speed(track: Track, over: Stretches, settings: Mapping[str, Any], options: Options) -> ShortInference | None:
    """Search speeds over ground and through the water for a current; None without enough speeds through the water."""
    ground, logged = track.ground_m_s, track.logged_m_s
    with_log = over.without(~np.isfinite(logged))
    if ground is None or len(with_log) < FEWEST_STRETCHES:
        return None
    scene, unit = short_fit.recording_scene(track.observations.time_s, settings.get("field"))
    by_speed = BySpeed(ground, np.nan_to_num(logged), scene, with_log)
    means = with_log.mean(np.nan_to_num(logged))
    zero = LOG_STEP if np.std(means) > VARIED * np.mean(means) else 0.0  # a step of 0 holds a parameter
    of_speed = _compare(track, with_log, by_speed, start=np.array([1.0, 0.0]), steps=np.array([LOG_STEP, zero]))
    of_speed = replace(of_speed, what=SPEED, terms=WATER, reads=False, field_unit=unit)
    return short_search.search_effects(of_speed, options)


def _bases(
    track: Track, over: Stretches, settings: Mapping[str, Any], made: Calibration, known: ShortInference | None
) -> tuple[FittedHypothesis, FittedHypothesis]:
    """Fit the deviation curve as the series and as the exact compass."""
    scene, unit = short_fit.recording_scene(track.observations.time_s, settings.get("field"))
    observed, ground = track.observations, track.ground_m_s
    carried = water(known.fitted.terms, scene) if known is not None else np.zeros((len(observed), 2))
    free = None if ground is None else ground - carried
    by_course = ByCourse(free, observed.course_deg, track.declination_deg, track.reading, scene, False, over)
    by_exact = replace(by_course, exact=True)
    series = _compare(track, over, by_course, start=made.coefficients, steps=np.ones(len(made.coefficients)))
    exact = _compare(track, over, by_exact, start=made.exact, steps=COMPASS_STEPS)
    return tuple(
        short_fit.fit_hypothesis(replace(comparison_form, field_unit=unit), ()) for comparison_form in (series, exact)
    )  # type: ignore[return-value]


def _compare(
    track: Track, over: Stretches, residual: ResidualModel, *, start: Floats, steps: Floats
) -> ShortComparison:
    observed = track.observations
    covariates = {"heading": over.heading(observed.recorded_deg), "time": over.mean(observed.time_s)}
    covariates |= {"speed": over.mean(observed.speed_kn)} if np.isfinite(observed.speed_kn).all() else {}
    covariates |= {"turn_rate": over.mean(observed.turn_deg_s)}
    return ShortComparison(
        what=f"{COURSE if observed.over_ground else TRUE} against the fitted curve",
        residual=residual,
        start=start,
        steps=steps,
        time_s=covariates["time"],
        clocked=True,
        terms=(),
        covariates=covariates,
        starts={"course_lag": (BEGIN_S,), "compass_lag": (BEGIN_S,), "clock_offset": (-BEGIN_S, BEGIN_S)},
        arma_noise=True,
    )


WATER_DRIFT = "water_drift"
LEAST_SEPARABLE = 0.3  # least share of a delay's column outside the span of the fit, below which it is not testable
NO_SPEED = "no speeds over ground were logged: what a drift does to the course is not known"
SAME_CLOCK = "courses and headings are in one log, by one clock"
SAME_TURN = "the ship turned one way only, so that a delay is a constant like A; swing to both sides"
CONSTANT = "a constant of the course cannot be separated from A of the curve"
NO_SENSOR = "the log carries no temperature, voltage or tilt"


def too_short(count: int, fewest: int) -> str:
    """Explain that a log of a swing is too short to be searched."""
    return (
        f"the log holds {count} stretches of 20 s that count, at least {fewest} are needed: residuals are alike for "
        "minutes, and so few do not tell an effect from them; swing for a quarter of an hour or longer"
    )


def untested(made: Calibration, fitted: FittedHypothesis, *, same_clock: bool) -> tuple[tuple[str, str], ...]:
    """List the effects that a log cannot show, with reasons; ``same_clock``: headings and courses have one clock."""
    absent = [("declination_error", CONSTANT)]
    absent += [(effect, NO_SENSOR) for effect in ("temperature", "supply_voltage", "heeling")]
    absent += [("clock_offset", SAME_CLOCK)] if same_clock else []
    column = short_fit.term_derivative(fitted, LateCourse())
    shown = float(np.linalg.norm(fitted.projected(column))) > LEAST_SEPARABLE * float(np.linalg.norm(column))
    if not shown and not any(term.acts_on == "time" for term in fitted.terms):
        absent += [(effect, SAME_TURN) for effect in ("course_lag", "compass_lag")]
    if water := _water_unseparated(made):
        absent.append((WATER_DRIFT, water))
    return tuple(absent)


def _water_unseparated(made: Calibration) -> str:
    """Explain why set and drift cannot be separated from B and C; empty if they can, or without courses over ground."""
    drift = made.details["drift"]
    if drift is None or drift["separable"]:
        return ""
    return NO_SPEED if drift["drift_kn"] is None else str(drift["text"])


def add_water_statement(diagnosed: Diagnosis, made: Calibration) -> Diagnosis:
    """Add a bound on the current, or the reason why set and drift cannot be separated from B and C."""
    drift = made.details["drift"]
    if drift is None or any(WATER_DRIFT in (item.effect, *item.alternatives) for item in diagnosed.findings):
        return diagnosed
    why = _water_unseparated(made)
    if not why and drift["drift_kn"] is None:
        return diagnosed
    if not why:
        most = drift["drift_kn"] + 1.96 * np.sqrt(np.linalg.eigvalsh(drift["covariance"])[-1])
        bound = f"Set and drift of the water do not show in the courses: less than {most:.2g} kn (95 %)."
        return replace(diagnosed, why=f"{diagnosed.why} {bound}".strip())
    if diagnosed.verdict == "consistent":
        return replace(diagnosed, verdict="insufficient", why=f"{diagnosed.why} {why}", separated_by=SEPARATED)
    return replace(diagnosed, separated_by="; ".join(filter(None, (diagnosed.separated_by, SEPARATED))))


SEPARATED = (
    "water_drift or B and C of the curve: each heading at two speeds, a log of the speed through the water, a visual "
    "mark or the sun, not the same circle the other way round, which tells only a delay"
)


def _with_water(item: Finding, outcome: Outcome, made: Calibration) -> Finding:
    """Replace set and drift of a finding by those of the curve's fit: the report must state only one current."""
    drift = made.details["drift"]
    if item.effect != WATER_DRIFT or drift["drift_kn"] is None:
        return item
    sigma = knot * np.sqrt(np.diag(drift["covariance"]))
    names = {"east_m_s": "east", "north_m_s": "north"}
    components = {
        name: Parameter(knot * drift[towards], float(sigma[k]), "m/s")
        for k, (name, towards) in enumerate(names.items())
    }
    chances = {item.effect: item.probability, **item.alternatives_probability}
    size, proof, place = item.rms_effect_deg, item.held_out, item.where
    rebuilt = comparison.build_finding(
        outcome.comparison, SetAndDrift(), chances, components, size_deg=size, proof=proof, place=place
    )
    more = {
        "drift_kn": Parameter(drift["drift_kn"], drift["sigma_drift_kn"], "kn"),
        "set_deg": Parameter(drift["set_deg"], drift["sigma_set_deg"], "degrees"),
    }
    text = f"{rebuilt.text} The water: {drift['described']} (95 %); a steady leeway would look the same."
    return replace(rebuilt, parameters={**more, **components}, text=text)
