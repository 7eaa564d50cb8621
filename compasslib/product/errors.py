"""Uncertainty of gridded velocities: modes of the heading error along time, and errors not due to the heading.

A mode is a function of time times a standard normal variable. The heading error rotates all simultaneous velocities
alike: du = v delta, dv = -u delta.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation.average import CompassSeries, compass_series
from compasslib.deviation.correction import MIN_PROBABILITY
from compasslib.deviation.model import DeviationFit, nearest_root
from compasslib.preparation.water import fit_structure_function
from compasslib.product.cells import Axes, Differences, average_slots
from compasslib.records import Readings, ReferenceCompass
from compasslib.statistics.noise import lagged_sums
from compasslib.statistics.whitening import autoregress
from compasslib.types import HOUR_S, Bools, Complexes, Floats

UNMEASURED_MOTION_M_S = 0.005  # of a sphere without a pressure record: a bound, not an estimate
MIN_MEMORY_S = HOUR_S
FEWEST = 100  # values needed for a variance


@dataclass(frozen=True)
class HeadingErrors:
    """The heading error of the instruments of a mooring along t times."""

    names: tuple[str, ...]  #: names of the modes
    modes: Floats  #: (k, t) heading error by one standard deviation of each mode, radians; NaN without a heading
    random: Floats  #: (a, t) standard deviation of the random part of each affected instrument, radians
    memory_s: float  #: s, e-folding time of the random part
    shares: Floats  #: (s, k) factor of each mode in the heading error of each instrument, affected ones first

    def variance(self, source: int) -> Floats:
        """Compute the variance of an instrument's heading, (t,) square radians."""
        common = np.einsum("k,kt->t", self.shares[source] ** 2, np.nan_to_num(self.modes) ** 2)
        return common + self.random[source] ** 2 if source < len(self.random) else common


def compass_modes(fit: DeviationFit, at: CompassSeries | None, readings: Readings, heading_deg: Floats) -> Floats:
    """Decompose the heading error by the covariance of the compass, averaged or not, (n, p) degrees per unit normal."""
    if not fit.fitted:
        return np.zeros((len(heading_deg), 0))
    at = compass_series(fit, readings) if at is None else at
    likeliest, columns = nearest_root(at.roots(), heading_deg) if at.others else heading_deg, []
    members = [at, *at.others]
    shifts = np.array([
        np.zeros_like(heading_deg) if each is at
        else np.nan_to_num(angles.difference(nearest_root(each.roots(), heading_deg), likeliest))
        for each in members
    ])  # fmt: skip
    weight = np.array([each.weight for each in members])
    weight = weight / weight.sum()
    mean = weight @ shifts
    for each, share, shift in zip(members, weight, shifts, strict=True):
        values, vectors = np.linalg.eigh((each.covariance + each.covariance.T) / 2.0)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        columns.append(np.sqrt(share) * np.nan_to_num(each.sensitivity(heading_deg)) @ root)
        if len(members) > 1:
            columns.append(np.sqrt(share) * (shift - mean)[:, None])
    return np.concatenate(columns, axis=1)


def compress(columns: Floats, count: int) -> tuple[Floats, Floats]:
    """Reduce columns to their leading principal components, and the residual variance of each row, (n,)."""
    if columns.shape[1] == 0 or not len(columns):
        return columns[:, :0], np.zeros(len(columns))
    values, vectors = np.linalg.eigh(columns.T @ columns)
    leading = columns @ vectors[:, ::-1][:, : min(count, int(np.sum(values > 1e-12 * values[-1])))]
    return leading, np.maximum(np.sum(columns**2, axis=1) - np.sum(leading**2, axis=1), 0.0)


def memory_of(heading_deg: Floats, time_s: Floats) -> float:
    """Estimate the correlation time of a heading, s, the first lag below 1/e, which errors of a compass share."""
    known = np.isfinite(heading_deg)
    if known.sum() < FEWEST:
        return MIN_MEMORY_S
    series = np.where(known, angles.phasor(np.nan_to_num(heading_deg)), 0.0)
    series = np.where(known, series - series[known].mean(), 0.0)
    power = np.sum([lagged_sums(part, len(series) - 1) for part in (series.real, series.imag)], axis=0)
    below = np.flatnonzero(power < power[0] / np.e)
    step_s = float(np.median(np.diff(time_s)))
    return float(max(below[0] * step_s if len(below) else len(series) * step_s, MIN_MEMORY_S))


def learn_by_depth(velocity: Complexes, range_m: Floats, cell_m: float) -> Differences:
    """Fit the structure function of velocities (n, m) by depth, up to 200 m; for too few bins, scale a fixed one."""
    growth = 1.5  # exponent at distances within a cell, and of the fixed structure function
    learnt = fit_structure_function(velocity, range_m)
    step = (cell_m or 1.0) / 50.0
    distance = np.arange(0.0, 200.0 + step, step)
    if learnt is not None:
        values = learnt.layers(distance)
        within = distance < cell_m  # a bin is a mean over its cell, hence smooth growth there
        values[within] = np.interp(cell_m, distance, values) * (distance[within] / cell_m) ** growth
        return Differences(step, values, learnt.noise)
    known = velocity[np.isfinite(velocity.real)]
    variance = float(np.var(known)) if known.size else 0.0
    # A decorrelation depth of 150 m is typical of the ocean's upper hundreds of metres.
    return Differences(step, variance * (1.0 - np.exp(-((distance / 150.0) ** growth))), 0.02 * variance)


def learn_bin_noise(velocity: Complexes, by_depth: Differences) -> Floats:
    """Estimate the noise of each bin, (m,) (m/s)^2: far bins, with weaker echoes, differ more from their neighbours."""
    steps = np.abs(np.diff(velocity, axis=1)) ** 2
    known = np.isfinite(steps)
    half = np.where(known, steps, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1) / 2.0
    known_bins = known.sum(axis=0) >= FEWEST
    if not known_bins.any():
        return np.full(velocity.shape[1], by_depth.noise)
    usual = float(np.median(np.sort(half[known_bins])[: max(known_bins.sum() // 2, 1)]))
    excess = np.where(known_bins, np.maximum(half - usual, 0.0), 0.0)
    return by_depth.noise + np.maximum(np.append(excess, 0.0), np.append(0.0, excess))


def learn_by_time(blocks: Sequence[Complexes], step_s: float, reach_s: float, noise: float | None) -> Differences:
    """Estimate the structure function of velocity by time in one bin, without noise.

    Args:
        blocks: velocities of consecutive samples, (k, m) each, NaN where missing.
        noise: (m/s)^2 of one measurement, estimated by depth; None to extrapolate it from the first two lags.
    """
    lags = np.arange(1, int(np.clip(np.ceil(reach_s / step_s), 2, 400)) + 1)
    half = np.full(len(lags), np.nan)
    for k, lag in enumerate(lags.tolist()):
        steps = [(block[lag:] - block[:-lag]).ravel() for block in blocks if len(block) > lag]
        changes = np.concatenate(steps or [np.zeros(0, dtype=complex)])
        known = np.abs(changes[np.isfinite(changes)]) ** 2
        half[k] = known.mean() / 2.0 if known.size >= FEWEST else np.nan
    if not np.isfinite(half[:2]).all():
        return Differences(step_s, np.zeros(1), noise or 0.0)
    half = half[: np.argmin(np.isfinite(np.append(half, np.nan)))]
    least = max(half[0] - (half[1] - half[0]), 0.02 * half[0])  # linear extrapolation to lag 0
    left = min(least if noise is None else noise, 0.9 * half[0])
    smooth = np.maximum.accumulate(np.append(0.0, half - left))
    power = float(np.clip(np.log2(max(smooth[2], 1e-12) / max(smooth[1], 1e-12)), 0.7, 2.0))
    fine = 20  # steps between two samples
    places = np.arange(fine * len(half) + 1) / fine
    table = np.interp(places, np.arange(len(smooth)), smooth)
    table[:fine] = smooth[1] * places[:fine] ** power
    return Differences(step_s / fine, table, left)


def error_memory(blocks: Sequence[Complexes], step_s: float, noise: float) -> float:
    """Estimate the correlation time of differences between adjacent bins, and so of interpolation errors, seconds."""
    shears = [np.diff(block, axis=1) for block in blocks if block.shape[1] > 1]
    if not shears:
        return step_s
    known = np.concatenate([np.abs(shear[np.isfinite(shear)]) ** 2 for shear in shears])
    variance = max(float(known.mean()) - 2.0 * noise, 1e-12) if known.size else 1e-12
    for lag in (2**k for k in range(12)):
        products = [(shear[lag:] * np.conj(shear[:-lag])).real.ravel() for shear in shears if len(shear) > lag]
        both = np.concatenate(products) if products else np.zeros(0)
        both = both[np.isfinite(both)]
        if both.size < FEWEST or both.mean() < variance / np.e:
            return float(lag * step_s)
    return float(2**12 * step_s)


def sphere_motion(depth_m: Floats, flow: Complexes, time_s: Floats, water_depth_m: float | None) -> Floats:
    """Estimate the horizontal velocity of a diving sphere, one standard deviation of a component, (n,) m/s.

    If a straight line of length l leans so that its top dips by d, the top moves sqrt(2 l d) downstream. The position
    is averaged over three hours before differentiation.
    """
    still_m = 0.5  # least dive that is analysed, added to dives so that the slope of their square root stays finite
    known = np.isfinite(depth_m)
    if len(time_s) < 3 or known.sum() < 3 or water_depth_m is None or np.ptp(depth_m[known]) < still_m:
        return np.full(len(time_s), UNMEASURED_MOTION_M_S)
    dive = np.interp(time_s, time_s[known], depth_m[known])
    dive = np.maximum(dive - np.percentile(dive, 1), 0.0) + still_m
    length = max(water_depth_m - float(np.median(depth_m[known])), 1.0)
    along = np.nan_to_num(flow)
    away = np.sqrt(2.0 * length * dive) * along / np.maximum(np.abs(along), 1e-6)
    width = min(max(1, round(3 * HOUR_S / float(np.median(np.diff(time_s))))), len(time_s))
    kernel = np.ones(width) / width
    smooth = np.convolve(away, kernel, "same")
    speed2 = np.convolve(np.abs(np.gradient(smooth, time_s)) ** 2, kernel, "same")
    return np.sqrt(np.minimum(speed2, 0.1**2) / 2.0)  # bounded: at a gap the position jumps


def marginals(velocity: Complexes, heading_variance: Floats, other: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute the variances of u and v and their covariance, (t, z) (m/s)^2, from heading variance and other errors."""
    across, along = angles.rotation_errors(heading_variance)
    u, v = velocity.real, velocity.imag
    return across * v**2 + along * u**2 + other, across * u**2 + along * v**2 + other, (along - across) * u * v


def sum_sigma(
    weight_east: Floats, weight_north: Floats, velocity: Complexes, other: Floats, source: NDArray[np.integer],
    errors: HeadingErrors, step_s: float, *, memory_s: float = 0.0,
) -> float:  # fmt: skip
    """Compute the standard deviation of a weighted sum of eastward and northward velocities, such as a transport.

    With g = weight_east v - weight_north u, summed over the cells of a time and instrument, each mode adds the square
    of its sum over all times, the random part the products of all pairs of times by correlation, the rest squares.

    Args:
        weight_east: weight of each cell, (t, z), zero for cells that do not contribute.
        other: variance of a component not due to the heading, (t, z).
        source: instrument of each cell as row of ``errors.shares``, negative if there is none.
        memory_s: e-folding time of the errors not due to the heading.
    """
    modes, random, white = errors_by_time(weight_east, weight_north, velocity, other, source, errors)
    decay = float(np.exp(-step_s / max(errors.memory_s, 1e-9)))
    remembered = sum(series @ (2.0 * autoregress(series, [1.0, -decay]) - series) for series in random if series.size)
    correlated = (1.0 + 2.0 * memory_s / step_s) * white.sum()
    return float(np.sqrt(np.sum(modes.sum(axis=1) ** 2) + remembered + correlated))


def errors_by_time(
    weight_east: Floats, weight_north: Floats, velocity: Complexes, other: Floats, source: NDArray[np.integer],
    errors: HeadingErrors,
) -> tuple[Floats, Floats, Floats]:  # fmt: skip
    """Compute errors of a weighted sum at each time: by mode (k, t), random (a, t), and the variance of others (t,)."""
    flow = np.where(np.isfinite(velocity), velocity, 0.0)
    turned = weight_east * flow.imag - weight_north * flow.real
    by_source = np.array([np.where(source == s, turned, 0.0).sum(axis=1) for s in range(len(errors.shares))])
    modes = np.einsum("st,kt,sk->kt", by_source, np.nan_to_num(errors.modes), errors.shares)
    random = by_source[: len(errors.random)] * np.nan_to_num(errors.random)
    return modes, random, np.sum(np.nan_to_num(other) * (weight_east**2 + weight_north**2), axis=1)


def mean_factor(count: NDArray[Any], memory: float) -> Floats:
    """Compute the variance ratio of a mean of consecutive values to one; correlation exp(-lag / memory) in steps."""
    decay = np.exp(-1.0 / max(memory, 1e-3))
    n = np.maximum(count, 1)
    return (1.0 + decay) / (1.0 - decay) / n - 2.0 * decay * (1.0 - decay**n) / (1.0 - decay) ** 2 / n**2


@dataclass(frozen=True)
class AffectedHeadings:
    """Corrected headings of an affected instrument at n samples, with their error components."""

    name: str
    time_s: Floats
    used: Bools  # (n,) whether its velocities go into the grid
    heading_deg: Floats
    sigma_deg: Floats  # whole
    probability: Floats  # of the selected branch
    columns_deg: Floats  # (n, p) modes of the error due to coefficients and iron of the reference, per unit normal
    constant_deg: float  # standard deviation of the constant due to the reference, included in sigma_deg
    doubted_deg: Floats  # (n,) standard deviation of suspected errors, included in sigma_deg
    unexplained_deg: float  # standard deviation of detected but uncorrected errors, included in sigma_deg
    weights: Floats  # (r,) share of each reference in the pairs that the coefficients are fitted to; zero without pairs


def heading_errors(
    affected: Sequence[AffectedHeadings],
    references: Sequence[ReferenceCompass],
    axes: Axes,
    max_gap_s: float,
    declination_deg: float,
) -> HeadingErrors:
    """Decompose the heading errors of a mooring into modes along time and a random part.

    The modes are those of HEADING_CORRECTED_UNCERTAINTY, and the declination, which rotates affected and reference
    velocities alike unless the reference's directions are true already. There are at most eight; a third reference and
    further ones share a mode.
    """
    # B sin + C cos of a reference's heading, of equal variances, has the same variance at any heading.
    whole = [float(np.hypot(r.sigma_deg, r.iron_deg)) for r in references]
    constants = {"declination": declination_deg}
    constants |= {f"compass of {r.name}": x for r, x in zip(references[:2], whole, strict=False)}
    if others := references[2:]:
        name = "compass of " + " and ".join(r.name for r in others)
        constants[name] = max(whole[2:])
    sizes = np.array(list(constants.values()))
    count = (8 - len(constants)) // len(affected)
    follows = np.zeros((len(affected), len(constants)))  # share of each constant in the headings of each instrument
    for k, each in enumerate(affected):
        for r, (reference, weight) in enumerate(zip(references, each.weights, strict=False)):
            mode = min(1 + r, len(constants) - 1)
            follows[k, mode] += weight * reference.sigma_deg / max(sizes[mode], 1e-9)
        along = float(np.hypot.reduce(follows[k] * sizes))
        follows[k] *= min(1.0, each.constant_deg / along) if along else 0.0
    shared = np.hypot.reduce(follows * sizes, axis=1)
    parts = [_decompose(each, axes, max_gap_s, count, float(x)) for each, x in zip(affected, shared, strict=True)]
    own = {f"{name}{f' of {each.name}' * (len(affected) > 1)}": mode
           for each, (modes, _) in zip(affected, parts, strict=True) for name, mode in modes.items()}  # fmt: skip
    constant = {name: np.full(len(axes.time_s), size * angles.DEGREE) for name, size in constants.items()}
    # Factors of the constants, then of the modes of each affected instrument.
    shares = np.zeros((len(affected) + len(references), len(constant) + len(own)))
    magnetic = np.array([r.magnetic for r in references], dtype=float)
    begin = len(constant)
    for row, each, factors, (modes, _) in zip(shares, affected, follows, parts, strict=False):
        row[: len(constant)] = factors
        row[0] = each.weights @ magnetic if np.any(each.weights) else 1.0
        row[begin : begin + len(modes)] = 1.0
        begin += len(modes)
    for k, row in enumerate(shares[len(affected) :]):
        row[min(1 + k, len(constant) - 1)], row[0] = 1.0, magnetic[k]
    return HeadingErrors(
        (*constant, *own),
        np.array([*constant.values(), *own.values()]),
        np.array([random for _, random in parts]),
        max(memory_of(each.heading_deg, each.time_s) for each in affected),
        shares,
    )


def _decompose(
    affected: AffectedHeadings, axes: Axes, max_gap_s: float, count: int, shared_deg: float
) -> tuple[dict[str, Floats], Floats]:
    """Decompose the heading error of one instrument into modes, at most ``count``, and a random part, (t,) radians."""
    samples = len(affected.time_s)
    veer = float(np.sqrt(max(affected.constant_deg**2 - shared_deg**2, 0.0)))
    by_time = {"veer": np.full(samples, veer), "unexplained": np.full(samples, affected.unexplained_deg)}
    by_time |= {"doubts": affected.doubted_deg}
    by_time = {name: series for name, series in by_time.items() if np.any(series > 0.0)}
    columns, name = affected.columns_deg, "coefficients"
    within = np.sum(columns**2, axis=1)
    within += sum((series**2 for series in by_time.values()), np.full(samples, shared_deg**2))
    if len(by_time) + 2 > count:  # several instruments share the modes
        columns, name, by_time = np.column_stack([columns, *by_time.values()]), "errors", {}
    leading, left = compress(columns, count - len(by_time))
    random = np.maximum(affected.sigma_deg**2 - within, 0.0) + left
    undecided = (affected.probability > 0.0) & (affected.probability < MIN_PROBABILITY)
    random = np.where(undecided, 1e8, random)  # either of two headings: the error is not normal
    columns = np.column_stack([*by_time.values(), leading, random]) if samples else np.zeros((0, len(by_time) + 1))
    columns = np.where((affected.used & np.isfinite(affected.heading_deg))[:, None], columns, np.nan)
    *modes, mean = average_slots(columns, affected.time_s, axes, max_gap_s).T * angles.DEGREE
    names = (*by_time, *(f"{name} {k + 1}" for k in range(leading.shape[1])))
    variance = mean * angles.DEGREE
    return dict(zip(names, modes, strict=True)), np.sqrt(np.where(variance > 100.0, np.nan, variance))
