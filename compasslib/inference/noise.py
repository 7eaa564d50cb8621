"""Slow noise of directions at two depths, which is part of every hypothesis: slow water, tides and the current.

Veer and shear of slow water are Gaussian processes of unknown size and memory, which are marginalized: they differ for
weeks, as slowly as some terms of the compass change, and may have a yearly season. Tidal ellipses differ too. The
directions also differ with speed, depth, tide and direction of the current, with mooring motion, and by errors of the
velocity measurement. None of this changes a heading. All these columns have Gaussian coefficients of typical size;
which drivers of the current act, and how strongly, is inferred under the most probable hypothesis and used when a
compass is refitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.composed import compose_effect, play
from compasslib.effects.effect import DAY_S, USUAL_DEG, YEAR_S
from compasslib.inference import covariates
from compasslib.inference.comparison import TIDE_RESOLVING_STEP_S, LongComparison, tide_waves
from compasslib.inference.finding import SURE
from compasslib.records import SlowShear
from compasslib.types import Floats

SHORTEST_DAYS = 8.0  # shortest period; faster variability is whitened by the filter
MOST_WAVES = 120  # of a process, enough for sixteen months; in longer records the fastest are omitted
SPEED_SPAN_S = 12 * 3600.0  # averaging time of the speed, for the turn by shear
VEER_DEG, VEER_DAYS = (1.0, 2.5, 6.0), (6.0, 25.0, 100.0)  # grid of sizes and memories
SHEAR_M_S, SHEAR_DAYS = (0.006, 0.02, 0.06), (5.0, 40.0)  # the same
USUAL_VEER_DEG, USUAL_SHEAR_M_S = 3.0, 0.02  # scales of half-Cauchy priors, from two depths of real water
# Of known slow water: widening of the logarithms of size and memory, from bins of two real profiles against the others;
# grid in standard deviations, shares of veer in the variance, range of memories, degrees of freedom of the prior.
SIZE_WIDENED, MEMORY_WIDENED = 0.3, 0.5
STEPS, VEER_SHARES, MEMORIES_DAYS, FREEDOM = (-1.6, -0.8, 0.0, 0.8, 1.6), (0.0, 0.5, 1.0), (2.0, 300.0), 4.0
# The directions of two depths, 8 m (eh2) and 20 m (papa) apart, averaged over a month, differ by over 10 degrees from
# those of the whole record in 12 % of the months.
OTHER_LAYER = 0.1  # prior odds that the reference is in a layer whose water veers for weeks: eh2, papa
LARGE_CURRENT = 2.0  # times its usual size: what the current can explain is not attributed to the compass
TIDE_SPAN_S = 3600.0  # averaging time of the speed, for the turn by tidal shear of USUAL_SHEAR_M_S per wave

KNOTS = 6  # of the directional shear along speed or depth
PLAYS = (1.0, 2.5)  # widths of hysteresis, standard deviations of the driver
SEASON_HARMONICS = (1, 2)  # annual and semiannual, as in the seasonal cycle of a climatology
SEASON_COLUMNS = 3 * 2 * len(SEASON_HARMONICS)  # veer, northward and eastward shear; sine and cosine of each
USUAL_TIDE_DEG = 2.0  # prior standard deviation of each sine and cosine of tidal directional shear
PRESENT = 0.75  # probability from which a driver enters the noise of a refit: a Bayes factor of 3
LEAN_SHARE = 0.05  # of the scatter of directions, prior standard deviation by tilt: the flow leans the instrument
# Drivers that vary together: by mooring knock-down, and by the lean of the instrument.
COUPLED = (frozenset({"speed", "depth", "separation"}), frozenset({"tilt", "pitch", "roll"}))
VELOCITY_ERRORS, MODULATORS = ("velocity_bias", "beam_gain"), ("speed", "depth")  # that may modulate the former
LEAST_SPREAD = 1e-6  # standard deviation, degrees, below which a column is left out
WORDS = {
    "speed": "with the speed of the flow",
    "depth": "with depth",
    "separation": "with the distance between the two layers",
    "tide": "with the tide",
    "tilt": "with the lean of the instrument",
    "flow_direction": "with the direction of the flow",
    "motion": "as the mooring's own motion makes them",
    "velocity_bias": "as a constant velocity in the instrument's frame makes them",
    "beam_gain": "as unequal gain of the beam pairs makes them",
}
NONE_ASSUMED = "The simulation assumed none."
ON_VELOCITY = "It acts on the velocity, not on the heading: headings are unchanged, their uncertainty includes it."
RIVAL = (
    "A compass whose reading follows {driver}, or what varies with it, would show nearly the same (P = {rival:.2f}): "
    "headings are the average of both by these probabilities, their uncertainty includes the difference. "
    "{separated_by} would separate them."
)
REFERENCE_TOO = " A deviation of the reference, whose heading is unknown or follows the flow, would show the same."
SEPARATED_BY = "a second current meter at the depth of the affected instrument"
CONTESTED = 0.05  # probability of a compass effect instead, from which a statement on the current is qualified


@dataclass(frozen=True)
class Process:
    """A first-order Gaussian process, with exponential autocorrelation."""

    size: float  # degrees of veer, or m/s of shear in each component, rms
    memory_days: float

    def variances(self, frequency: Floats, step: float) -> Floats:
        """Compute the variance of each column's coefficient.

        Args:
            frequency: cycles a day, (k,), evenly spaced from 0.
            step: frequency spacing in cycles a day, half a cycle per record.
        """
        spectrum = 8.0 * self.size**2 * self.memory_days / (1.0 + (2.0 * np.pi * frequency * self.memory_days) ** 2)
        return spectrum * step * np.where(frequency > 0.0, 1.0, 0.5)


@dataclass(frozen=True)
class SlowNoise:
    """Parameters of slow water: veer, shear of either component, and a yearly season of both."""

    veer: Process
    shear: Process
    log_prior: float  # up to a constant
    season_deg: tuple[float, float] = (0.0, 0.0)  # sizes of the annual harmonics of veer and of shear


def known_slow_noises(known: SlowShear, speed_m_s: float) -> list[SlowNoise]:
    """List parameters of slow water around those that a profile shows, with their priors.

    Its size across the flow is divided between veer and shear in several ways. The errors of size and memory are
    widened, since water outside the profile may differ, and have long tails. Or the water of the reference veers slowly
    beside it, as that of another layer.

    Args:
        speed_m_s: median speed of the flow.
    """
    size_sigma, memory_sigma = np.hypot(known.log_sigma, SIZE_WIDENED), np.hypot(known.memory_log_sigma, MEMORY_WIDENED)
    slow_noises, others = list[SlowNoise](), list[SlowNoise]()
    priors = {step: -(FREEDOM + 1.0) / 2.0 * float(np.log1p(step**2 / FREEDOM)) for step in STEPS}
    for a, b in itertools.product(STEPS, STEPS):
        memory = float(np.clip(known.memory_days * np.exp(b * memory_sigma), *MEMORIES_DAYS))
        for share in VEER_SHARES:
            size = known.size_m_s * float(np.exp(a * size_sigma))
            veer = size * float(np.sqrt(share)) / max(speed_m_s, covariates.SLOWEST_M_S) / angles.DEGREE
            shear = size * float(np.sqrt(1.0 - share))
            slow_noises.append(SlowNoise(Process(veer, memory), Process(shear, memory), priors[a] + priors[b]))
    within = float(np.logaddexp.reduce([each.log_prior for each in slow_noises])) + np.log(OTHER_LAYER)
    for veer_deg, days, step in itertools.product(VEER_DEG, VEER_DAYS[1:], STEPS[1:-1]):
        known_shear = Process(known.size_m_s * float(np.exp(step * size_sigma)), known.memory_days)
        prior = priors[step] - float(np.log1p((veer_deg / USUAL_VEER_DEG) ** 2))
        others.append(SlowNoise(Process(veer_deg, days), known_shear, prior))
    total = float(np.logaddexp.reduce([each.log_prior for each in others]))
    return slow_noises + [replace(each, log_prior=each.log_prior + within - total) for each in others]


@dataclass(frozen=True)
class SlowNoiseBasis:
    """Columns of slow water, with the variances of their coefficients."""

    columns: Floats  # (n, q) degrees a unit: cosines of veer, of east and north shear; their tides; season; current
    frequency: Floats  # (k,) cycles a day, evenly spaced from 0
    kinds: int  # number of processes: 1, or 3 with shear
    drivers: tuple[str, ...]  # of the last columns, those of the current in units of prior sizes
    current: Floats  # variance of each of these
    known: tuple[SlowShear, float] | None = None  # slow shear that a profile shows, and the median speed in m/s

    def variances(self, slow_noise: SlowNoise) -> Floats:
        """Compute the variance of each column's coefficient."""
        step = float(self.frequency[1])
        each = [
            process.variances(self.frequency, step) for process in (slow_noise.veer, slow_noise.shear, slow_noise.shear)
        ]
        tides = int(self.season[0]) - self.kinds * len(self.frequency)
        season = np.repeat(np.square(slow_noise.season_deg), [SEASON_COLUMNS // 3, 2 * SEASON_COLUMNS // 3])
        return np.concatenate([*each[: self.kinds], np.full(tides, USUAL_SHEAR_M_S**2), season, self.current])

    @property
    def season(self) -> NDArray[np.intp]:
        """Columns of the season, (SEASON_COLUMNS,)."""
        return np.arange(SEASON_COLUMNS) + self.columns.shape[1] - len(self.drivers) - SEASON_COLUMNS

    def without_current(self, drivers: Collection[str]) -> SlowNoiseBasis:
        """Remove the current of some drivers from the noise."""
        return replace(self, current=np.where(np.isin(self.drivers, list(drivers)), 0.0, self.current))

    def slow_noises(self) -> list[SlowNoise]:
        """List the grid of parameters of slow water; where a profile shows it, its memory covers a season."""
        if self.known is not None and self.kinds > 1:
            return known_slow_noises(*self.known)
        slow_noises = []
        for season in ((0.0, 0.0), (USUAL_VEER_DEG, 0.0), (USUAL_VEER_DEG, USUAL_VEER_DEG)):
            veers = _processes(VEER_DEG, VEER_DAYS, longest=not season[0])
            shears = _processes(SHEAR_M_S, SHEAR_DAYS, longest=not season[1])
            for veer, shear in itertools.product(veers, shears if self.kinds > 1 else shears[:1]):
                scaled = veer.size / USUAL_VEER_DEG, shear.size / USUAL_SHEAR_M_S, *np.divide(season, USUAL_VEER_DEG)
                slow_noises.append(SlowNoise(veer, shear, -float(np.sum(np.log1p(np.square(scaled)))), season))
        return slow_noises


def _processes(sizes: Sequence[float], memories_days: Sequence[float], *, longest: bool) -> list[Process]:
    """List processes, none first; those of the longest memory are left out beside a season, which they resemble."""
    memories = memories_days if longest else memories_days[:-1]
    return [Process(0.0, memories[0]), *(Process(*each) for each in itertools.product(sizes, memories))]


def slow_noise_basis(comparison: LongComparison) -> SlowNoiseBasis:
    """Build the basis of slow water and of the current of a mooring."""
    time_s = comparison.scene.time_s
    days = float(np.ptp(time_s)) / DAY_S
    count = min(int(2.0 * days / SHORTEST_DAYS) + 1, MOST_WAVES)
    frequency = np.arange(count) / (2.0 * days)
    waves = np.cos(np.pi * (time_s - time_s[0])[:, None] / (days * DAY_S) * np.arange(count))
    current, kinds = current_columns(comparison), 1
    drivers = tuple(driver for driver, columns in current.items() for _ in range(columns.shape[1]))
    each = [season_columns(comparison), *current.values()]
    if "speed" in comparison.covariates:
        shears = ((waves, SPEED_SPAN_S), (tide_waves(time_s), TIDE_SPAN_S))
        each, kinds = [*(shear_columns(comparison, *shear) for shear in shears), *each], 3
    known = None
    if comparison.slow_shear is not None and "speed" in comparison.covariates:
        known = comparison.slow_shear, float(np.median(comparison.covariates["speed"]))
    prior = np.full(len(drivers), LARGE_CURRENT**2)
    return SlowNoiseBasis(np.concatenate([waves, *each], axis=1), frequency, kinds, drivers, prior, known)


def season_columns(comparison: LongComparison) -> Floats:
    """Build the columns of a yearly season of the water, degrees per degree of its size, (n, SEASON_COLUMNS).

    Harmonics of the year for veer and for eastward and northward shear; the k-th is scaled by 1/k.
    """
    phase = 360.0 * comparison.scene.time_s / YEAR_S
    waves = np.column_stack([x / k for k in SEASON_HARMONICS for x in angles.sin_cos(k * phase)])
    if "speed" not in comparison.covariates:
        return np.concatenate([waves, np.zeros((len(waves), SEASON_COLUMNS - waves.shape[1]))], axis=1)
    per_degree = USUAL_SHEAR_M_S / USUAL_VEER_DEG
    return np.concatenate([waves, per_degree * shear_columns(comparison, waves, SPEED_SPAN_S)], axis=1)


def shear_columns(comparison: LongComparison, waves: Floats, span_s: float) -> Floats:
    """Compute the turn of directions by northward and eastward shear of 1 m/s that follows waves, (n, 2 k) degrees.

    Args:
        waves: (n, k).
        span_s: of the running mean of the speed.
    """
    speed = covariates.running_mean(comparison.covariates["speed"], comparison.scene.time_s, span_s)
    slowness = 1.0 / np.maximum(speed, covariates.SLOWEST_M_S) / angles.DEGREE
    north, east = (comparison.scene.departures[name] * slowness for name in ("flow_north", "flow_east"))
    return np.concatenate([waves * north[:, None], -waves * east[:, None]], axis=1)


def coupled_drivers(driver: str) -> frozenset[str]:
    """Collect the drivers of the current that cannot be separated from a driver, including itself."""
    return next((group for group in COUPLED if driver in group), frozenset({driver}))


def current_columns(comparison: LongComparison) -> dict[str, Floats]:
    """Build the columns of the current of a mooring by driver, (n, k) degrees per prior standard deviation."""
    columns: dict[str, list[Floats]] = {}
    for name in ("speed", "depth"):
        if name in comparison.covariates:
            x = comparison.covariates[name]
            hats = covariates.hat_columns(x, KNOTS)
            columns[name] = [USUAL_DEG * (hats - hats.mean(axis=0))]
            # The current at a speed differs while it rises and while it falls, as in real water (eh2).
            lagged = [play(x, width * float(np.std(x))) for width in PLAYS]
            columns[name] += [USUAL_DEG * covariates.standardize(each)[:, None] for each in lagged if np.std(each)]
            if name == "depth" and np.std(x):  # three moorings without a fault of the sealed proof followed its history
                history = compose_effect("reading", name, "bands")().evaluate(comparison.scene, comparison.recorded_deg)
                columns[name].append(USUAL_DEG * history / float(np.std(x)))
    leans = [comparison.scene.departures[name] for name in ("pitch", "roll") if name in comparison.covariates]
    usual_deg = LEAN_SHARE * float(np.median(comparison.expected_deg))
    columns["tilt"] = [usual_deg * covariates.standardize(lean)[:, None] for lean in leans if np.std(lean)]
    if np.median(np.diff(comparison.scene.time_s)) < TIDE_RESOLVING_STEP_S:
        columns["tide"] = [USUAL_TIDE_DEG * tide_waves(comparison.scene.time_s)]
    for kind in comparison.terms:
        if kind.side == "water" and kind.driver not in ("speed", "depth"):
            # The turn by each parameter at its prior standard deviation, (n, k) degrees.
            unit, still = np.eye(len(kind.fitted())), np.zeros(len(comparison))
            turn = np.stack([kind().at(values).apply(still, comparison.scene) for values in unit], axis=1)
            size, usual = np.sqrt(np.mean(turn**2, axis=0)), kind.expected()
            with np.errstate(divide="ignore"):
                scale = np.where(usual > 0.0, usual**-0.5, USUAL_DEG / np.maximum(size, 1e-12))
            turn = np.asarray(turn * np.where(size > 0.0, scale, 0.0))
            columns.setdefault(kind.driver, []).append(turn)
            if kind.driver in VELOCITY_ERRORS:
                series = (comparison.scene.departures.get(name) for name in MODULATORS)
                varying = [x for x in series if x is not None and np.std(x) > LEAST_SPREAD]
                columns[kind.driver] += [turn * covariates.standardize(x)[:, None] for x in varying]
    blocks = {driver: np.concatenate(each, axis=1) for driver, each in columns.items() if each}
    return {driver: x for driver, x in blocks.items() if np.max(x.std(axis=0), initial=0.0) > LEAST_SPREAD}


@dataclass(frozen=True)
class CurrentStatement:
    """An effect of the current, or of the velocity measurement, that the simulation does not contain."""

    driver: str | None  #: variable on which it depends; None if only the side is established
    probability: float  #: that its size exceeds ``min_effect_deg``
    size_deg: float  #: visible size, degrees rms
    low_deg: float  #: lower end of the 95 % interval of ``size_deg``
    high_deg: float  #: upper end of the 95 % interval of ``size_deg``
    text: str  #: the statement in sentences

    def contested(self, rival: float, followed: str) -> CurrentStatement:
        """Reduce the probability by that of a compass whose reading follows a driver instead, and mention it."""
        if rival < CONTESTED:
            return self
        left = self.probability * (1.0 - rival)
        text = _text(self.driver, left, (self.size_deg, self.low_deg, self.high_deg))
        said = RIVAL.format(driver=followed, rival=rival, separated_by=SEPARATED_BY.capitalize())
        return replace(self, probability=left, text=f"{text} {NONE_ASSUMED} {said}")

    def to_json(self) -> dict[str, Any]:
        """Encode an entry of ``current`` in diagnosis.json."""
        return {
            "level": "side" if self.driver is None else "driver",
            "driver": self.driver,
            "probability": self.probability,
            "size": self.size_deg,
            "unit": "degrees",
            "low": self.low_deg,
            "high": self.high_deg,
            "heldout": None,  # not tested on held-out days
            "text": self.text,
        }


@dataclass(frozen=True)
class CurrentPosterior:
    """Posterior over all subsets of drivers, with coefficients drawn from the mixture."""

    drivers: tuple[str, ...]  # of each column, (p,)
    values: Floats  # (d, p) drawn coefficients, in prior standard deviations; 0 if the driver does not act
    acting: float  # posterior probability that any driver acts; the prior is 0.5

    @property
    def variances(self) -> Floats:
        """Mean square of each coefficient whose driver is likely to act, 0 for the others, (p,).

        A driver that hardly acts would otherwise widen the covariance of a compass where the data do not constrain it.
        """
        present = np.mean(self.values != 0.0, axis=0) >= PRESENT
        return np.asarray(np.where(present, np.mean(self.values**2, axis=0), 0.0))

    def statements(
        self, visible: Floats, min_effect_deg: float, *, aligned: bool = False
    ) -> tuple[float, tuple[CurrentStatement, ...]]:
        """Compute the probability that the current exceeds a size, and state by which drivers it does.

        Args:
            visible: mean products of the columns with the compass projected out, square degrees, (p, p).
            min_effect_deg: size, degrees rms, below which an effect is negligible.
            aligned: whether the instrument points along the flow; no driver is stated then for errors of its velocity,
                as its heading contains the shear.
        """
        sizes = _sizes(self.values[np.any(self.values != 0.0, axis=1)], visible)
        probability = self.acting * float(np.mean(sizes > min_effect_deg)) if len(sizes) else 0.0
        if probability < SURE:
            return probability, ()
        stated = []
        drivers = [None if aligned and driver in VELOCITY_ERRORS else driver for driver in self.drivers]
        for name in dict.fromkeys(drivers):
            each = _sizes(self.values * [driver == name for driver in drivers], visible)
            if (established := float(np.mean(each > min_effect_deg))) >= SURE:
                stated.append(_statement(name, established, each[each > min_effect_deg]))
        return probability, tuple(stated) or (_statement(None, probability, sizes),)


def infer_current(drivers: Sequence[str], information: Floats, score: Floats, draws: int = 2000) -> CurrentPosterior:
    """Infer which drivers of the current act, each with even prior odds.

    With these odds it would be nearly certain a priori that some driver acts. For the probability that any acts, the
    prior odds of each driver are lowered until those of any driver are even.

    Args:
        drivers: driver of each column, (p,).
        information: products of the columns, all other unknowns marginalized, in units of the noise, (p, p).
        score: products of the columns with the residual, (p,).
        draws: of the current's size; the standard error of a probability of 0.95 is 0.5 %.
    """
    names = list(dict.fromkeys(drivers))
    at = np.array([names.index(driver) for driver in drivers])
    subsets = [np.flatnonzero(np.array(subset)[at]) for subset in itertools.product((False, True), repeat=len(names))]
    fits = []
    for subset in subsets:
        lower = np.linalg.cholesky(information[np.ix_(subset, subset)] + np.eye(len(subset)))
        half, root = np.linalg.solve(lower, score[subset]), np.linalg.inv(lower).T
        fits.append((root @ half, root, float(0.5 * half @ half - np.sum(np.log(np.diag(lower))))))
    log = np.array([fit[2] for fit in fits])  # even prior odds of each driver
    weight = np.exp(log - log.max())
    rng, values = np.random.default_rng(5), np.zeros((draws, len(at)))
    chosen = rng.choice(len(subsets), draws, p=weight / weight.sum())
    for k in np.unique(chosen):
        mine, (mean, root, _) = np.flatnonzero(chosen == k), fits[k]
        values[np.ix_(mine, subsets[k])] = mean + rng.normal(size=(len(mine), len(mean))) @ root.T
    each = 1.0 - 0.5 ** (
        1.0 / max(len(names), 1)
    )  # prior probability of a driver for which none acts with probability 0.5
    count = np.array([len(set(at[subset])) for subset in subsets])
    few = log + count * np.log(each / (1.0 - each))
    return CurrentPosterior(tuple(drivers), values, float(1.0 - np.exp(few[0] - np.logaddexp.reduce(few))))


def _sizes(values: Floats, visible: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(np.einsum("di,ij,dj->d", values, visible, values), 0.0)))


def _statement(driver: str | None, probability: float, sizes: Floats) -> CurrentStatement:
    size, low, high = (float(x) for x in np.quantile(sizes, [0.5, 0.025, 0.975]))
    text = f"{_text(driver, probability, (size, low, high))} {NONE_ASSUMED} {ON_VELOCITY}"
    return CurrentStatement(driver, probability, size, low, high, text)


def _text(driver: str | None, probability: float, sizes_deg: tuple[float, float, float]) -> str:
    size, low, high = sizes_deg
    how = f", {WORDS.get(driver, f'with {driver}')}" if driver else ""
    return (
        f"Directions at the two depths differ by {size:.1f}° rms ({low:.1f} to {high:.1f}°, 95 %){how} "
        f"(P = {probability:.2f})."
    )
