"""Model slow noise (veer, shear and tides of the water) and scatter of directions that follows a storm index.

Veer and shear are Gaussian processes of unknown size and memory. Directions at two depths differ for weeks, as slowly
as some terms of the compass change; both processes are therefore part of every hypothesis, and their sizes and
memories are marginalized. Tidal ellipses differ between the depths as well.

A storm index shows that magnetic north moved, but not in which direction: the cause is named, nothing is corrected.
Significance comes from shifting the index in time, which preserves its storms and their autocorrelation.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.effects.effect import DAY_S
from compasslib.effects.reference import IndexedDisturbance
from compasslib.inference import covariates, current, finding
from compasslib.inference.comparison import CANCELS, LongComparison, build_finding, equal_chances, tide_waves
from compasslib.inference.design import FittedModel
from compasslib.inference.finding import CovariateRange, Finding, HeldOut, Parameter
from compasslib.records import SlowShear
from compasslib.statistics.whitening import LowRankNoise
from compasslib.types import Floats

SHORTEST_DAYS = 8.0  # shortest period; faster variability is whitened by the filter
MOST_WAVES = 120  # of a process, enough for sixteen months; in longer records the fastest are omitted
SPEED_SPAN_S = 12 * 3600.0  # averaging time of the speed, for the turn by shear
VEER_DEG, VEER_DAYS = (1.0, 2.5, 6.0), (6.0, 25.0, 100.0)  # grid of sizes and memories
SHEAR_M_S, SHEAR_DAYS = (0.006, 0.02, 0.06), (5.0, 40.0)  # the same
LEAST_LOUD_VARIANCE = 0.05  # relative excess of variance over white noise below which a direction is ignored
USUAL_VEER_DEG, USUAL_SHEAR_M_S = 3.0, 0.02  # scales of half-Cauchy priors, from two depths of real water
# Of known slow water: widening of the logarithms of size and memory, from bins of two real profiles against the others;
# grid in standard deviations, shares of veer in the variance, range of memories, degrees of freedom of the prior.
SIZE_WIDENED, MEMORY_WIDENED = 0.3, 0.5
STEPS, VEER_SHARES, MEMORIES_DAYS, FREEDOM = (-1.6, -0.8, 0.0, 0.8, 1.6), (0.0, 0.5, 1.0), (2.0, 300.0), 4.0
LARGE_CURRENT = 2.0  # times its usual size: what the current can explain is not attributed to the compass
TIDE_SPAN_S = 3600.0  # averaging time of the speed, for the turn by tidal shear of USUAL_SHEAR_M_S per wave

STORM_SIZES_NT = np.geomspace(0.3, 100.0, 8)  # perpendicular to magnetic north, per unit of ap
STORM_SHIFTS, NEAREST_SHIFT_S = 400, 5 * 86400.0  # shifts of the index in time, and the least one; storms last for days
STORM_BLOCKS = 12  # blocks of a record for the jackknife
STORMY_QUANTILE = 0.9  # quantile of the index from which a time is stormy
STORM_PHYSICS = (
    "magnetic north is unsteady where the index of storms is high; its course only an observatory could tell. "
    "Nothing is corrected by it"
)


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
    """Parameters of slow water: veer, and shear of either component."""

    veer: Process
    shear: Process
    log_prior: float  # up to a constant


def _usual_log_prior(veer: Process, shear: Process) -> float:
    """Compute the log prior of sizes of which nothing is known."""
    return -float(np.sum(np.log1p(np.square([veer.size / USUAL_VEER_DEG, shear.size / USUAL_SHEAR_M_S]))))


def known_slow_noises(known: SlowShear, speed_m_s: float) -> list[SlowNoise]:
    """List parameters of slow water around those that a profile shows, with their priors.

    Its size across the flow is divided between veer and shear in several ways. The errors of size and memory are
    widened, since water outside the profile may differ, and have long tails.

    Args:
        speed_m_s: median speed of the flow.
    """
    size_sigma, memory_sigma = np.hypot(known.log_sigma, SIZE_WIDENED), np.hypot(known.memory_log_sigma, MEMORY_WIDENED)
    slow_noises = []
    for a, b in itertools.product(STEPS, STEPS):
        memory = float(np.clip(known.memory_days * np.exp(b * memory_sigma), *MEMORIES_DAYS))
        prior = sum(-(FREEDOM + 1.0) / 2.0 * np.log1p(step**2 / FREEDOM) for step in (a, b))
        for share in VEER_SHARES:
            size = known.size_m_s * float(np.exp(a * size_sigma))
            veer = size * float(np.sqrt(share)) / max(speed_m_s, covariates.SLOWEST_M_S) / angles.DEGREE
            shear = size * float(np.sqrt(1.0 - share))
            slow_noises.append(SlowNoise(Process(veer, memory), Process(shear, memory), prior))
    return slow_noises


@dataclass(frozen=True)
class SlowNoiseBasis:
    """Columns of slow water, with the variances of their coefficients."""

    columns: Floats  # (n, q) degrees a unit: cosines of veer, of east and north shear; waves of their tides; current
    frequency: Floats  # (k,) cycles a day, evenly spaced from 0
    kinds: int  # number of processes: 1, or 3 with shear
    drivers: tuple[str, ...] = ()  # of the last columns, those of the current in units of prior sizes
    current: Floats | None = None  # variance of each of these, once estimated
    known: tuple[SlowShear, float] | None = None  # slow shear that a profile shows, and the median speed in m/s

    def variances(self, slow_noise: SlowNoise) -> Floats:
        """Compute the variance of each column's coefficient."""
        step = float(self.frequency[1])
        each = [
            process.variances(self.frequency, step) for process in (slow_noise.veer, slow_noise.shear, slow_noise.shear)
        ]
        slow = np.concatenate(each[: self.kinds])
        tides = self.columns.shape[1] - len(slow) - len(self.drivers)
        current = np.full(len(self.drivers), LARGE_CURRENT**2) if self.current is None else self.current
        return np.concatenate([slow, np.full(tides, USUAL_SHEAR_M_S**2), current])

    @property
    def acting(self) -> set[str]:
        """The drivers that the current was found to follow."""
        current = np.zeros(len(self.drivers)) if self.current is None else self.current
        return {driver for driver, variance in zip(self.drivers, current, strict=True) if variance > 0.0}

    def without_current(self, drivers: Collection[str]) -> SlowNoiseBasis:
        """Remove the current of some drivers from the noise."""
        current = np.full(len(self.drivers), LARGE_CURRENT**2) if self.current is None else self.current
        return replace(self, current=np.where(np.isin(self.drivers, list(drivers)), 0.0, current))

    def slow_noises(self) -> list[SlowNoise]:
        """List the grid of parameters of slow water."""
        if self.known is not None and self.kinds > 1:
            return known_slow_noises(*self.known)
        none = Process(0.0, VEER_DAYS[0])
        veers = [none, *(Process(*process) for process in itertools.product(VEER_DEG, VEER_DAYS))]
        shears = [none, *(Process(*process) for process in itertools.product(SHEAR_M_S, SHEAR_DAYS))]
        both = itertools.product(veers, shears if self.kinds > 1 else [none])
        return [SlowNoise(veer, shear, _usual_log_prior(veer, shear)) for veer, shear in both]


def slow_noise_basis(comparison: LongComparison) -> SlowNoiseBasis | None:
    """Build the basis of slow water and of the current; None unless the recording is a long enough mooring record."""
    time_s = comparison.scene.time_s
    days = float(np.ptp(time_s)) / DAY_S
    count = min(int(2.0 * days / SHORTEST_DAYS) + 1, MOST_WAVES)
    if count < 4:
        return None
    frequency = np.arange(count) / (2.0 * days)
    waves = np.cos(np.pi * (time_s - time_s[0])[:, None] / (days * DAY_S) * np.arange(count))
    blocks = current.current_blocks(comparison)
    drivers = tuple(block.driver for block in blocks for _ in range(block.columns.shape[1]))
    each, kinds = [block.columns for block in blocks], 1
    if "flow_east" in comparison.scene.departures and "speed" in comparison.covariates:
        shears = ((waves, SPEED_SPAN_S), (tide_waves(time_s), TIDE_SPAN_S))
        each, kinds = [*(shear_columns(comparison, *shear) for shear in shears), *each], 3
    known = None
    if comparison.slow_shear is not None and "speed" in comparison.covariates:
        known = comparison.slow_shear, float(np.median(comparison.covariates["speed"]))
    return SlowNoiseBasis(np.concatenate([waves, *each], axis=1), frequency, kinds, drivers, known=known)


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


def low_rank_noise(freed: FittedModel, slow: SlowNoiseBasis, slow_noise: SlowNoise) -> LowRankNoise | None:
    """Express slow noise as directions of increased variance of the whitened noise; None without slow noise.

    Args:
        freed: fitted model whose whitener excludes slow water.
    """
    variance = slow.variances(slow_noise)
    variance[0] = 0.0  # a constant veer looks like A, which would be lost in rounding errors beside it
    present = variance > 0.0
    scale = np.sqrt(variance[present]) * freed.response / freed.sigma
    white = freed.whitener(slow.columns[:, present].astype(np.float32)).astype(float) * scale
    if not white.shape[1]:
        return None
    values, vectors = np.linalg.eigh(white.T @ white)
    loud = values > LEAST_LOUD_VARIANCE
    basis = white @ vectors[:, loud] / np.sqrt(values[loud])
    return LowRankNoise(basis.astype(np.float32), 1.0 / np.sqrt(1.0 + values[loud]))


def storm_finding(fitted: FittedModel, alarm: float = 0.006) -> Finding | None:
    """Test whether directions scatter with the storm index; None if they do not, or without an index.

    Args:
        fitted: fitted model with all terms that were found.
        alarm: probability of a false finding from noise alone.
    """
    scene, width = fitted.comparison.scene, fitted.whitener.width_deg
    if (IndexedDisturbance.name, CANCELS) in fitted.comparison.not_testable or "storm_index" not in scene.departures:
        return None
    known = np.isfinite(width) & np.isfinite(fitted.residual_deg)
    index = scene.departures["storm_index"]
    unit = index / scene.horizontal_nT / angles.DEGREE  # degrees for 1 nT per unit of ap
    ratio = np.clip(fitted.residual_deg[known] / width[known], -finding.MOST_WIDTHS, finding.MOST_WIDTHS)
    squares, share = ratio**2, (unit[known] / width[known]) ** 2
    if not share.any() or (chance := _chance_of_shifts(scene.time_s[known], squares, share)) > alarm:
        return None
    block = np.arange(len(share)) * STORM_BLOCKS // len(share)
    size = _storm_size(squares, share)
    sizes = np.array([_storm_size(squares[block != k], share[block != k]) for k in range(STORM_BLOCKS)])  # jackknife
    gains = np.array([_storm_gains(x, squares, share)[block == k].sum() for k, x in enumerate(sizes.tolist())])
    sigma = float(np.std(sizes) * np.sqrt(STORM_BLOCKS - 1))
    spread, rms_deg = 1.96 * float(np.std(gains) * np.sqrt(STORM_BLOCKS)), angles.rms(fitted.residual_deg[known])
    interval = float(gains.sum()) - spread, float(gains.sum()) + spread
    low, high = np.quantile(index, [STORMY_QUANTILE, 1.0]).tolist()
    return build_finding(
        fitted.comparison,
        IndexedDisturbance(),
        equal_chances(IndexedDisturbance.name),
        {"nT_ap": Parameter(size, sigma, "nT")},
        size_deg=size * angles.rms(unit),
        proof=HeldOut(rms_deg, rms_deg, float(gains.sum()), interval, chance, method="shifts"),
        place=CovariateRange("storm_index", low, high, f"where ap is {low:.0f} to {high:.0f}"),
        span_s=observatory.strongest_disturbance(scene.time_s, index),
        physics=f"{STORM_PHYSICS}; the index at other dates does as well {chance:.1%} of the time",
    )


def _storm_gains(size_nT: float, squares: Floats, share: Floats) -> Floats:
    """Compute the log-likelihood gain of each sample over homogeneous noise, with free noise width, (n,).

    Args:
        size_nT: per unit of ap.
        squares: squared ratio of residual to width, clipped, (n,).
        share: variance for 1 nT per unit of ap, relative to the noise, (n,).
    """
    variance = 1.0 + size_nT**2 * share
    width, even = np.mean(squares / variance), np.mean(squares)
    return np.asarray((squares / even - squares / variance / width - np.log(variance * width / even)) / 2.0)


def _storm_size(squares: Floats, share: Floats) -> float:
    """Find the likeliest size, nT per unit of ap."""
    from scipy.optimize import minimize_scalar

    limits = np.log(STORM_SIZES_NT[[0, -1]])
    likeliest = minimize_scalar(lambda log: -np.sum(_storm_gains(np.exp(log), squares, share)), bounds=limits)
    return float(np.exp(likeliest.x))


def _chance_of_shifts(time_s: Floats, squares: Floats, share: Floats) -> float:
    """Estimate the p-value of the gain from shifts of the index in time."""
    nearest = int(NEAREST_SHIFT_S / max(float(np.median(np.diff(time_s))), 1.0)) + 1
    count = min(STORM_SHIFTS, max(len(time_s) - 2 * nearest, 1))
    shifts = [0, *np.linspace(nearest, len(time_s) - nearest, count).astype(int).tolist()]
    gains = [max(np.sum(_storm_gains(x, squares, np.roll(share, k))) for x in STORM_SIZES_NT.tolist()) for k in shifts]
    return (1 + int(np.sum(np.array(gains[1:]) >= gains[0]))) / (1 + count)
