"""Prediction of the water velocity at the reference's depth from the affected instrument's simultaneous profile.

Weights follow from the structure function of velocity between bins (best linear unbiased prediction as in Bretherton,
Davis & Fandry 1976; ordinary kriging), which a heading error does not change. They are real and add up to one, so that
a heading error rotates the prediction exactly as a single bin.

Directions also veer with depth, which real weights cannot represent. The profile shows by how much: its bins are
predicted in the same way from the bins beyond them, and a share of the nearest bin's error, learnt from bins equally
far apart, is removed from the prediction.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation.clocks import speed_delays
from compasslib.records import GOOD, NOT_CHECKED, PROBABLY_GOOD, Record, SlowShear
from compasslib.statistics.resampling import block_sums
from compasslib.types import DAY_S, Bools, Complexes, Floats

LEAST_GOOD = 0.9  # of the best bin's share of good data: bins that are often bad, as near a boundary, are not trusted
LENGTHS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # decorrelation lengths of the layers, in cells
POWERS = (1.0, 2.0)  # exponents at short distance: rough layers, and uniform shear
VEER_S = 2 * DAY_S  # time scale from which veer is corrected
SLOW_DAYS = np.geomspace(2.0, 200.0, 9)  # memories that are tried
SLOW_SHARES = np.geomspace(0.1, 2.0, 12)  # sizes that are tried, of the slow part and of noise, over the rms
LEAST_M_S = 1e-6  # lower bound of a denominator


@dataclass(frozen=True)
class StructureFunction:
    """Half the mean squared difference of two bins by their distance: noise plus a sum of saturating terms (layers)."""

    cell_m: float
    noise: float  # (m/s)^2, between two measurements at the same depth
    parts: tuple[tuple[float, float, float], ...]  # (m/s)^2, length in cells, power

    def layers(self, distance_m: Floats) -> Floats:
        """Compute the structure function without noise, (m/s)^2."""
        cells = np.abs(distance_m) / self.cell_m
        return np.sum([size * _shape(cells, length, power) for size, length, power in self.parts], axis=0)

    def weights(self, away_m: Floats) -> Floats:
        """Compute the kriging weights, (k,), of bins at signed distances from the predicted depth; they add up to 1."""
        known = np.block([[self._between(away_m), np.ones((len(away_m), 1))], [np.ones(len(away_m)), np.zeros(1)]])
        solved: Floats = np.linalg.solve(known, np.append(self.layers(away_m) + self.noise, 1.0))
        return solved[:-1]

    def variance(self, away_m: Floats, weights: Floats) -> float:
        """Compute the mean squared error of predicting by a weighted mean, both components together, (m/s)^2."""
        towards = 2.0 * weights @ (self.layers(away_m) + self.noise)
        return float(towards - weights @ self._between(away_m) @ weights)

    def _between(self, away_m: Floats) -> Floats:
        return self.layers(away_m[:, None] - away_m) + self.noise * (1.0 - np.eye(len(away_m)))


@dataclass(frozen=True)
class WaterPrediction:
    """Predicted velocity at the reference's depth, rotated by the same heading error as the profile."""

    velocity: Complexes  # (n,) m/s, NaN where no bin is good
    expected_m_s: float  # expected rms error of one component, median over the samples
    published_m_s: float  # the same for the mean of the nearest bins
    veer: Veer


@dataclass(frozen=True)
class Veer:
    """Difference in direction between predicted and actual velocities that remains, by the profile's own bins."""

    mean_deg: float = 0.0  # uncertainty of the mean over the record, 1 sigma; 0 if the profile cannot show it
    slow: SlowShear | None = None  # its slow part across the flow


def usable_velocities(record: Record) -> Bools:
    """Select the velocities that may be used, (n, m)."""
    flagged = np.isin(record.quality, (NOT_CHECKED, GOOD, PROBABLY_GOOD))
    return flagged & np.isfinite(record.east) & np.isfinite(record.north)


def fit_structure(record: Record) -> StructureFunction | None:
    """Fit the structure function of velocity against the distance of two bins; None if there are too few."""
    velocity = np.where(usable_velocities(record), record.east + 1j * record.north, np.nan)
    return fit_structure_function(velocity, np.median(record.bin_range_m, axis=0))


def fit_structure_function(velocity: Complexes, range_m: Floats) -> StructureFunction | None:
    """Fit the structure function to velocities, (n, m) m/s, at ranges, (m,) m; None if there are too few.

    It is fitted to up to 8 bins next to the instrument that are good nearly as often as the best. Four are needed, as
    two distances cannot constrain decorrelation. The noise is at least 2 % of half the mean squared difference of
    adjacent bins.
    """
    share = np.isfinite(velocity.real).mean(axis=0) if len(velocity) else np.zeros(len(range_m))
    sound = np.flatnonzero(share >= LEAST_GOOD * share.max(initial=0.0))
    near = sound[np.argsort(np.abs(range_m[sound]))[:8]]
    if len(near) < 4:
        return None
    cell_m = float(np.median(np.diff(np.sort(np.abs(range_m[near])))))
    velocity = velocity[:, near]
    first, second = np.triu_indices(len(near), 1)
    cells = np.abs(range_m[near][first] - range_m[near][second]) / max(cell_m, 1e-3)
    half = np.full(len(first), np.nan)
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        differences = velocity[:, a] - velocity[:, b]
        squares = np.abs(differences[np.isfinite(differences)]) ** 2
        half[k] = float(np.mean(squares)) / 2.0 if len(squares) >= 100 else np.nan
    valid = np.isfinite(half) & (half > 0.0) & (cells <= 10.0)
    if valid.sum() < 3 or cell_m <= 0.0:
        return None
    from scipy.optimize import nnls  # only where there is a profile

    cells, half = cells[valid], half[valid]
    shapes = [(length, power) for length in LENGTHS for power in POWERS]
    columns = np.column_stack([np.ones_like(cells), *(_shape(cells, *shape) for shape in shapes)])
    # Non-negative least squares for noise and layers, minimizing relative misfits.
    sizes = nnls(columns / half[:, None], np.ones_like(half))[0]
    least = 0.02 * float(np.median(half[cells <= cells.min() + 0.5]))
    parts = tuple((float(size), *shape) for size, shape in zip(sizes[1:], shapes, strict=True) if size > 0.0)
    return StructureFunction(cell_m, max(float(sizes[0]), least), parts or ((least, LENGTHS[-1], POWERS[0]),))


def predict_water(record: Record, depth_m: Floats, bins: int) -> WaterPrediction | None:
    """Predict the water velocity at given depths; None if the profile does not suffice."""
    nearest, step = 4, 0.1  # bins used; cells, resolution of the distance for which weights are computed
    learnt = fit_structure(record)
    if learnt is None:
        return None
    away = record.bin_depth_m() - depth_m[:, None]
    distance = np.where(usable_velocities(record) & np.isfinite(away), np.abs(away), np.inf)
    index = np.argsort(distance, axis=1, kind="stable")[:, :nearest]
    row = np.arange(len(index))[:, None]
    there = np.isfinite(distance[row, index])
    from_nearest = np.round(away[np.arange(len(away)), index[:, 0]] / (step * learnt.cell_m))
    known = there[:, 0] & np.isfinite(from_nearest)
    key = np.column_stack([np.where(there, index, -1), np.where(known, from_nearest, 0.0)])[known].astype(np.int64)
    alike, inverse = np.unique(key, axis=0, return_inverse=True)
    range_m = np.median(record.bin_range_m, axis=0) * (-1.0 if record.looks_up else 1.0)
    first = np.argsort(np.abs(range_m))[:bins]
    weights, errors = np.zeros((len(alike), index.shape[1])), np.zeros((len(alike), 2))
    for k, (*which, steps) in enumerate(alike.tolist()):
        used = [series for series in which if series >= 0]
        offset = range_m[used] - range_m[used[0]] + steps * step * learnt.cell_m
        weights[k, : len(used)] = learnt.weights(offset)
        plain = range_m[first] - range_m[used[0]] + offset[0]
        mean = learnt.variance(plain, np.full(len(first), 1.0 / len(first)))
        errors[k] = learnt.variance(offset, weights[k, : len(used)]), mean
    measured = np.where(there, record.east[row, index] + 1j * record.north[row, index], 0.0)
    velocity = np.full(len(index), np.nan, dtype=complex)
    velocity[known] = (weights[inverse.ravel()] * measured[known]).sum(axis=1)
    if not known.any():
        return None
    expected, published = np.sqrt(np.median(errors[inverse.ravel()], axis=0) / 2.0).tolist()
    turned, veer = _predict_veer(record, np.nanmedian(away[known], axis=0), learnt.cell_m, learnt.weights, nearest)
    return WaterPrediction(velocity * angles.phasor(-turned), expected, published, veer)


def fails_speed_check(time_s: Floats, mean: Complexes, predicted: Complexes, trusted: Complexes) -> bool:
    """Check whether the reference's speeds agree significantly less with the prediction than with the published mean.

    Speeds do not depend on headings, but do reveal a wrong depth or layers that differ. A difference is significant
    beyond two standard errors, from the scatter between blocks of two days.
    """
    off = [(np.abs(series) - np.abs(trusted)) ** 2 for series in (mean, predicted)]
    worse = block_sums(off[1] - off[0], np.floor(time_s / (2 * DAY_S)).astype(np.intp))
    return bool(worse.sum() > 2.0 * np.sqrt(np.sum(worse**2)))


def bins_apart(record: Record, apart_m: float) -> NDArray[np.intp]:
    """Find for each bin but the last, (m - 1,), the bin after it that is nearest to a given distance from it."""
    range_m = np.nanmedian(record.bin_range_m, axis=0)
    away = [np.abs(np.abs(range_m[k + 1 :] - x) - apart_m) for k, x in enumerate(range_m[:-1])]
    return np.array([k + 1 + int(np.argmin(each)) for k, each in enumerate(away)], dtype=np.intp)


def delay_of_current(record: Record, apart_m: float) -> float:
    """Estimate the rms delay, hours, of current speeds between the record's own bins a given distance apart.

    Near-inertial waves with vertical wavelengths of 100 to 400 m (Leaman & Sanford 1975) reach one depth up to hours
    before the other. The delay is scaled up from the longest distance of a shorter profile.
    """
    first, speed = 4, np.where(usable_velocities(record), np.hypot(record.east, record.north), np.nan)
    range_m, delays_h = np.nanmedian(record.bin_range_m, axis=0), []
    for k, other in enumerate(bins_apart(record, apart_m)[:first].tolist()):
        distance_m = abs(float(range_m[other] - range_m[k]))
        delays = speed_delays(record.time_s, speed[:, k], speed[:, other])[1]
        if len(delays) and distance_m > 0.0:  # bins without length have no distance
            delays_h.append(float(np.median(delays)) * max(apart_m / distance_m, 1.0))
    return angles.rms(np.array(delays_h)) if delays_h else 0.0


def veer_of_nearest_bins(record: Record, depth_m: Floats, bins: int) -> Veer:
    """Estimate the veer between the mean of the nearest bins and the reference's cell."""
    away_m = np.median(record.bin_depth_m() - depth_m[:, None], axis=0)
    cells_m = np.diff(np.sort(away_m[np.isfinite(away_m)]))
    if not np.any(cells_m > 0.0):
        return Veer()
    cell_m = float(np.median(cells_m[cells_m > 0.0]))
    return _predict_veer(record, away_m, cell_m, lambda bins_m: np.full(len(bins_m), 1.0 / len(bins_m)), bins)[1]


def _predict_veer(
    record: Record, away_m: Floats, cell_m: float, weights: Callable[[Floats], Floats], bins: int
) -> tuple[Floats, Veer]:
    """Estimate the veer of a prediction at each sample, (n,) degrees, and what remains of it.

    If the profile is too short for the whole distance, the mean is scaled up from a shorter one; if it is too short for
    the number of bins, fewer are used. In both cases the veer of the samples is 0.

    Args:
        away_m: distance of each bin from the predicted depth, (m,).
        weights: function from the distances of bins from the predicted depth to their weights.
    """
    nothing = np.zeros(len(record.time_s))
    nearest_m = float(away_m[np.nanargmin(np.abs(away_m))])
    beyond = max(round(abs(nearest_m) / cell_m), 1)
    for count, nearer in itertools.product(range(bins, 0, -1), range(beyond)):
        closer_m = np.sign(nearest_m) * nearer * cell_m
        off = _windows(record, away_m - closer_m, cell_m, weights, count)
        if len(off):
            break
    else:
        return nothing, Veer()
    block = np.unique(np.floor(record.time_s / VEER_S), return_inverse=True)[1]
    sums = np.array([np.bincount(block, series.real) + 1j * np.bincount(block, series.imag) for series in off])
    slow, weight = angles.wrap180(angles.argument(sums)), np.abs(sums)
    lasting = np.average(slow, axis=1, weights=np.maximum(weight, LEAST_M_S))
    if nearer or count < bins or len(off) == 1:
        farther = beyond / (beyond - nearer)
        slow_part = fit_slow_shear(record.time_s, off.imag * farther, off != 0.0)
        return nothing, Veer(float(np.sqrt(np.mean(lasting**2))) * farther, slow_part)
    apart = min(beyond, len(off) - 1)
    near, far = slice(None, -apart), slice(apart, None)
    both = np.minimum(weight[near], weight[far])
    like = np.sum(both * slow[near] * slow[far]) / max(np.sum(both * slow[far] ** 2), LEAST_M_S)
    like = float(np.clip(like, 0.0, 1.0))
    share = like ** (beyond / apart)  # as for layers whose correlation decays exponentially with depth
    middle = np.bincount(block, record.time_s) / np.bincount(block)
    between = angles.wrap180(angles.argument(np.interp(record.time_s, middle, angles.phasor(slow[0]))))
    # Few windows constrain the remainder poorly, so the veer without any correction is included once.
    left = np.append(lasting[near] - like * lasting[far], np.sqrt(np.mean(lasting**2)))
    across, known = off[near].imag - like * off[far].imag, (off[near] != 0.0) & (off[far] != 0.0)
    return share * between, Veer(float(np.sqrt(np.mean(left**2))), fit_slow_shear(record.time_s, across, known))


def fit_slow_shear(time_s: Floats, across_m_s: Floats, known: Bools) -> SlowShear | None:
    """Estimate the slow part of velocity differences across the flow in k windows; None if the record is too short.

    Means of days with half of their samples, or of several days in records of over 1000, are modelled as a process with
    exponential autocorrelation and independent noise. The likelihood is the mean of all windows, since neighbouring
    bins hardly differ; the spread between windows is part of the uncertainty.
    """
    days_each = int(np.ptp(time_s) / DAY_S / 1000) + 1  # the size of the covariance matrix limits the run time
    day = np.floor((time_s - time_s[0]) / DAY_S / days_each).astype(np.intp)
    count = np.array([np.bincount(day, each, day[-1] + 1) for each in known])
    usual = float(np.median(np.bincount(day)))
    kept = np.flatnonzero((count >= 0.5 * usual).all(axis=0))
    if len(kept) < 30:
        return None
    sums = np.array(
        [np.bincount(day, each * there, day[-1] + 1) for each, there in zip(across_m_s, known, strict=True)]
    )
    means = (sums / np.maximum(count, 1.0))[:, kept]
    means = means - means.mean(axis=1, keepdims=True)
    scale = float(np.sqrt(np.mean(means**2)))
    if scale <= 0.0:
        return None
    apart, centred = days_each * np.abs(np.subtract.outer(kept, kept)), np.eye(len(kept)) - 1.0 / len(kept)
    log = np.empty((len(means), len(SLOW_DAYS), len(SLOW_SHARES), len(SLOW_SHARES)))
    for m, memory in enumerate(SLOW_DAYS):
        values, vectors = np.linalg.eigh(centred @ np.exp(-apart / memory) @ centred)
        squares = (means @ vectors[:, 1:]) ** 2  # the first vector is the mean, whose value is 0
        for s, size in enumerate(SLOW_SHARES):
            for w, noise in enumerate(SLOW_SHARES):
                variance = scale**2 * (size**2 * np.maximum(values[1:], 0.0) + noise**2)
                log[:, m, s, w] = -0.5 * np.sum(np.log(variance) + squares / variance, axis=1)
    together = np.exp(log.mean(axis=0) - log.mean(axis=0).max())
    of_size, of_memory = together.sum(axis=(0, 2)), together.sum(axis=(1, 2))
    size, size_sigma = _moments(np.log(SLOW_SHARES), of_size)
    memory_log, memory_sigma = _moments(np.log(SLOW_DAYS), of_memory)
    each = [_moments(np.log(SLOW_SHARES), np.exp(x - x.max()).sum(axis=(0, 2)))[0] for x in log]
    return SlowShear(
        scale * float(np.exp(size)), float(np.exp(memory_log)), float(np.hypot(size_sigma, np.std(each))), memory_sigma
    )


def _moments(values: Floats, weights: Floats) -> tuple[float, float]:
    mean = float(np.average(values, weights=weights))
    return mean, float(np.sqrt(np.average((values - mean) ** 2, weights=weights)))


def _windows(
    record: Record, away_m: Floats, cell_m: float, weights: Callable[[Floats], Floats], count: int
) -> Complexes:
    """Predict bins from those beyond them, relative to the bins' own directions, (k, n) m/s, 0 where one is bad.

    The predicting bins are as far from a bin as the bins next to the reference are from it. The eight bins nearest to
    the reference are predicted, nearest first.
    """
    usable = usable_velocities(record)
    share = usable.mean(axis=0)
    sound = np.flatnonzero((share >= LEAST_GOOD * share.max(initial=0.0)) & np.isfinite(away_m))
    order = sound[np.argsort(np.abs(away_m[sound]))]
    pattern = away_m[order[:count]]
    pattern += np.sign(pattern) * 0.05 * cell_m  # ties at half a cell select the farther bin
    velocity = np.where(usable, record.east + 1j * record.north, 0.0)
    predictions = []
    for target in order[:8].tolist():
        wanted = away_m[target] + pattern
        others = sound[sound != target]
        if not len(others):
            break
        which = others[np.argmin(np.abs(away_m[others] - wanted[:, None]), axis=1)]
        if len(np.unique(which)) < len(which) or np.any(np.abs(away_m[which] - wanted) > 0.51 * cell_m):
            continue
        predicted = velocity[:, which] @ weights(away_m[which] - away_m[target])
        direction = velocity[:, target] / np.maximum(np.abs(velocity[:, target]), LEAST_M_S)
        predictions.append(np.where(usable[:, [target, *which]].all(axis=1), predicted * np.conj(direction), 0.0))
    return np.array(predictions)


def _shape(cells: Floats, length: float, power: float) -> Floats:
    return 1.0 - np.exp(-((cells / length) ** power))
