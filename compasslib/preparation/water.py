"""The water at the reference's depth, predicted from the affected instrument's own profile at the same time.

Weights follow from how the velocities of two bins differ with their distance (best linear unbiased prediction as of
Bretherton, Davis & Fandry 1976; ordinary kriging). Differences of one instrument's bins have one length however its
heading errs, so that nothing needs to be known of the compass. Weights are real and add up to one: the prediction turns
with the heading as a single bin does, and water that is the same in all bins stays as it is.

Directions also turn with depth, for days and for the whole record, which real weights do not follow. The profile
shows by how much: its bins are predicted in the same way from those beyond them, and of how far the nearest is off a
share is taken from the prediction, as learnt between bins as far apart. What may be left for good is stated.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import GOOD, NOT_CHECKED, PROBABLY_GOOD, Record
from compasslib.types import DAY_S, Bools, Complexes, Floats

NEAREST = 4  # bins that a prediction is made of
LOOKED_AT, REACH = 8, 10.0  # bins next to the sphere that the structure is learnt from; cells between two of them
FEWEST, FEWEST_BINS = 100, 4  # differences of two bins; bins, as two distances alone do not tell how layers decorrelate
LEAST_GOOD = 0.9  # of the share of the best bin: what is often bad, as near a boundary, is not trusted when it is good
STEP = 0.1  # cells; nearer distances to the reference share their weights
LENGTHS = (2.0, 4.0, 8.0, 16.0, 32.0, 64.0)  # cells over which layers decorrelate
POWERS = (1.0, 2.0)  # at short distance: layers that are rough, and sheared evenly
CLEARLY = 0.5  # of the mean square
BLOCK_S, SURE = 2 * DAY_S, 2.0  # speeds are alike from hour to hour; standard errors that are no chance
VEER_S = 2 * DAY_S  # turning that lasts as long is followed
MOST_WINDOWS = 8  # places in the profile that it is learnt from, those next to the reference
HALF_A_CELL, LEAST_M_S = 0.51, 1e-6
OUTWARD = 0.05  # cells by which bins half a cell off are looked for farther away, not nearer
LEAST_NOISE = 0.02  # of the difference of two neighbours: no velocity is measured without noise


@dataclass(frozen=True)
class StructureFunction:
    """Half the mean squared difference of two bins by their distance: noise, and a sum of decorrelating layers."""

    cell_m: float
    noise: float  # (m/s)^2, of two measurements at one depth
    parts: tuple[tuple[float, float, float], ...]  # (m/s)^2, length in cells, power

    def layers(self, distance_m: Floats) -> Floats:
        """Compute it without noise, (m/s)^2."""
        cells = np.abs(distance_m) / self.cell_m
        return np.sum([size * _shape(cells, length, power) for size, length, power in self.parts], axis=0)

    def weights(self, away_m: Floats) -> Floats:
        """Compute the weights, (k,), by which bins off a depth, signed, predict the water there; they add up to 1."""
        known = np.block([[self._between(away_m), np.ones((len(away_m), 1))], [np.ones(len(away_m)), np.zeros(1)]])
        solved: Floats = np.linalg.solve(known, np.append(self.layers(away_m) + self.noise, 1.0))
        return solved[:-1]

    def variance(self, away_m: Floats, weights: Floats) -> float:
        """Compute the mean squared error of a weighted mean as a prediction, both components together, (m/s)^2."""
        towards = 2.0 * weights @ (self.layers(away_m) + self.noise)
        return float(towards - weights @ self._between(away_m) @ weights)

    def _between(self, away_m: Floats) -> Floats:
        return self.layers(away_m[:, None] - away_m) + self.noise * (1.0 - np.eye(len(away_m)))


@dataclass(frozen=True)
class WaterPrediction:
    """The water at the reference's depth, as the profile has it; turned as the profile is."""

    velocity: Complexes  # (n,) m/s, NaN where no bin is good
    expected_m_s: float  # rms error of one component by the structure, median over the samples
    published_m_s: float  # the same of the mean of the nearest bins
    veer_deg: float  # by how much it may be turned for the whole record, 1 sigma; 0 where the profile cannot tell


def usable_velocities(record: Record) -> Bools:
    """Select the velocities that may be used, (n, m)."""
    flagged = np.isin(record.quality, (NOT_CHECKED, GOOD, PROBABLY_GOOD))
    return flagged & np.isfinite(record.east) & np.isfinite(record.north)


def fit_structure(record: Record) -> StructureFunction | None:
    """Fit the structure function of velocity by the distance of two bins, None where there are too few."""
    usable = usable_velocities(record)
    range_m, share = np.median(record.bin_range_m, axis=0), usable.mean(axis=0)
    near = _sound_bins(share, range_m)  # of all bins the velocities would be a third of the memory
    velocity = np.where(usable[:, near], record.east[:, near] + 1j * record.north[:, near], np.nan)
    return fit_structure_function(velocity, range_m[near])


def _sound_bins(share: Floats, range_m: Floats) -> NDArray[np.intp]:
    """Return the bins next to the instrument that are good nearly as often as the best, nearest first."""
    sound = np.flatnonzero(share >= LEAST_GOOD * share.max(initial=0.0))
    return sound[np.argsort(np.abs(range_m[sound]))[:LOOKED_AT]]


def fit_structure_function(velocity: Complexes, range_m: Floats) -> StructureFunction | None:
    """Fit the structure function to velocities, (n, m) m/s, and ranges, (m,); None where they are too few."""
    share = np.isfinite(velocity.real).mean(axis=0) if len(velocity) else np.zeros(len(range_m))
    near = _sound_bins(share, range_m)
    if len(near) < FEWEST_BINS:
        return None
    cell_m = float(np.median(np.diff(np.sort(np.abs(range_m[near])))))
    velocity = velocity[:, near]
    first, second = np.triu_indices(len(near), 1)
    cells = np.abs(range_m[near][first] - range_m[near][second]) / max(cell_m, 1e-3)
    half = np.full(len(first), np.nan)
    for k, (a, b) in enumerate(zip(first, second, strict=True)):
        differences = velocity[:, a] - velocity[:, b]
        squares = np.abs(differences[np.isfinite(differences)]) ** 2
        half[k] = float(np.mean(squares)) / 2.0 if len(squares) >= FEWEST else np.nan
    valid = np.isfinite(half) & (half > 0.0) & (cells <= REACH)
    if valid.sum() < 3 or cell_m <= 0.0:
        return None
    from scipy.optimize import nnls  # only where there is a profile

    cells, half = cells[valid], half[valid]
    shapes = [(length, power) for length in LENGTHS for power in POWERS]
    columns = np.column_stack([np.ones_like(cells), *(_shape(cells, *shape) for shape in shapes)])
    # Noise and layers, none of them negative, each difference by its share.
    sizes = nnls(columns / half[:, None], np.ones_like(half))[0]
    least = LEAST_NOISE * float(np.median(half[cells <= cells.min() + 0.5]))
    parts = tuple((float(size), *shape) for size, shape in zip(sizes[1:], shapes, strict=True) if size > 0.0)
    return StructureFunction(cell_m, max(float(sizes[0]), least), parts or ((least, LENGTHS[-1], POWERS[0]),))


def predict_water(
    record: Record, depth_m: Floats, bins: int, learnt: StructureFunction | None = None
) -> WaterPrediction | None:
    """Predict the water at given depths, None where the profile cannot tell.

    Args:
        depth_m: of the reference's cell at each sample, (n,).
        bins: how many the published mean takes, for comparison.
    """
    learnt = learnt or fit_structure(record)
    if learnt is None:
        return None
    away = record.bin_depth_m() - depth_m[:, None]
    distance = np.where(usable_velocities(record) & np.isfinite(away), np.abs(away), np.inf)
    index = np.argsort(distance, axis=1, kind="stable")[:, :NEAREST]
    row = np.arange(len(index))[:, None]
    there = np.isfinite(distance[row, index])
    from_nearest = np.round(away[np.arange(len(away)), index[:, 0]] / (STEP * learnt.cell_m))
    known = there[:, 0] & np.isfinite(from_nearest)
    key = np.column_stack([np.where(there, index, -1), np.where(known, from_nearest, 0.0)])[known].astype(np.int64)
    alike, inverse = np.unique(key, axis=0, return_inverse=True)
    range_m = np.median(record.bin_range_m, axis=0) * (-1.0 if record.looks_up else 1.0)
    first = np.argsort(np.abs(range_m))[:bins]
    weights, errors = np.zeros((len(alike), index.shape[1])), np.zeros((len(alike), 2))
    for k, (*which, steps) in enumerate(alike.tolist()):
        used = [series for series in which if series >= 0]
        offset = range_m[used] - range_m[used[0]] + steps * STEP * learnt.cell_m
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
    turned, veer_deg = _predict_veer(record, np.nanmedian(away[known], axis=0), learnt.cell_m, learnt.weights, NEAREST)
    return WaterPrediction(velocity * angles.phasor(-turned), expected, published, veer_deg)


def depth_shift_by_speed(record: Record, depth_m: Floats, speed_m_s: Floats) -> float:
    """Estimate the depth shift at which the profile matches the reference's speeds clearly best, m, else 0.

    Only depths that the profile covers are tried, one cell after the other: beyond it a prediction is vague everywhere.
    """
    bins = record.bin_depth_m()
    away = np.median(bins, axis=0) - float(np.median(depth_m))
    shifts = [0.0, *away[np.isfinite(away)].tolist()]
    learnt = fit_structure(record)
    flows = [predict_water(record, depth_m + shift, 1, learnt) for shift in shifts]
    off = [float(np.nanmean((np.abs(series.velocity) - speed_m_s) ** 2)) if series else np.inf for series in flows]
    best = int(np.argmin(off))
    return shifts[best] if off[best] < CLEARLY * off[0] else 0.0


def fails_speed_check(time_s: Floats, mean: Complexes, predicted: Complexes, trusted: Complexes) -> bool:
    """Return whether the reference's speeds agree clearly less with the prediction than with the published mean.

    Speeds do not turn: where a depth is wrong or the layers are not alike, they show it without any heading.
    """
    off = [(np.abs(series) - np.abs(trusted)) ** 2 for series in (mean, predicted)]
    block = np.unique(np.floor(time_s / BLOCK_S), return_inverse=True)[1]
    worse = np.bincount(block, off[1] - off[0])
    return bool(worse.sum() > SURE * np.sqrt(np.sum(worse**2)))


def mean_shear_sigma(record: Record, depth_m: Floats, bins: int) -> float:
    """Estimate the mean directional shear between the nearest bins and the reference's cell, (n,), 1 sigma, degrees.

    As ``WaterPrediction.veer_deg`` says it of a prediction.
    """
    away_m = np.median(record.bin_depth_m() - depth_m[:, None], axis=0)
    cells_m = np.diff(np.sort(away_m[np.isfinite(away_m)]))
    if not np.any(cells_m > 0.0):
        return 0.0
    cell_m = float(np.median(cells_m[cells_m > 0.0]))
    return _predict_veer(record, away_m, cell_m, lambda bins_m: np.full(len(bins_m), 1.0 / len(bins_m)), bins)[1]


def _predict_veer(
    record: Record, away_m: Floats, cell_m: float, weights: Callable[[Floats], Floats], bins: int
) -> tuple[Floats, float]:
    """Predict by how much a prediction is turned at each sample, (n,), and how far it may still be for good, degrees.

    Where the profile is too short to show it over the whole distance, it is stated as it grows over a shorter one;
    where it is too short for as many bins, by what fewer would make of it.

    Args:
        away_m: of each bin from the depth that is predicted, (m,).
        weights: of bins by their distances from the predicted depth.
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
        return nothing, 0.0
    block = np.unique(np.floor(record.time_s / VEER_S), return_inverse=True)[1]
    sums = np.array([np.bincount(block, series.real) + 1j * np.bincount(block, series.imag) for series in off])
    slow, weight = angles.wrap180(angles.argument(sums)), np.abs(sums)
    lasting = np.average(slow, axis=1, weights=np.maximum(weight, LEAST_M_S))
    if nearer or count < bins or len(off) == 1:
        return nothing, float(np.sqrt(np.mean(lasting**2))) * beyond / (beyond - nearer)
    apart = min(beyond, len(off) - 1)
    near, far = slice(None, -apart), slice(apart, None)
    both = np.minimum(weight[near], weight[far])
    like = np.sum(both * slow[near] * slow[far]) / max(np.sum(both * slow[far] ** 2), LEAST_M_S)
    like = float(np.clip(like, 0.0, 1.0))
    share = like ** (beyond / apart)  # as of layers that forget evenly with depth
    middle = np.bincount(block, record.time_s) / np.bincount(block)
    between = angles.wrap180(angles.argument(np.interp(record.time_s, middle, angles.phasor(slow[0]))))
    # Few windows tell little of what is left: one more counts, of which nothing is followed.
    left = np.append(lasting[near] - like * lasting[far], np.sqrt(np.mean(lasting**2)))
    return share * between, float(np.sqrt(np.mean(left**2)))


def _windows(
    record: Record, away_m: Floats, cell_m: float, weights: Callable[[Floats], Floats], count: int
) -> Complexes:
    """Predict bins from those beyond them, over the bins' directions, (k, n) m/s, 0 where one is bad.

    The bins that predict one lie from it as those next to the reference lie from the reference. Nearest comes first.
    """
    usable = usable_velocities(record)
    share = usable.mean(axis=0)
    sound = np.flatnonzero((share >= LEAST_GOOD * share.max(initial=0.0)) & np.isfinite(away_m))
    order = sound[np.argsort(np.abs(away_m[sound]))]
    pattern = away_m[order[:count]]
    pattern += np.sign(pattern) * OUTWARD * cell_m
    velocity = np.where(usable, record.east + 1j * record.north, 0.0)
    predictions = []
    for target in order[:MOST_WINDOWS].tolist():
        wanted = away_m[target] + pattern
        others = sound[sound != target]
        if not len(others):
            break
        which = others[np.argmin(np.abs(away_m[others] - wanted[:, None]), axis=1)]
        if len(np.unique(which)) < len(which) or np.any(np.abs(away_m[which] - wanted) > HALF_A_CELL * cell_m):
            continue
        predicted = velocity[:, which] @ weights(away_m[which] - away_m[target])
        direction = velocity[:, target] / np.maximum(np.abs(velocity[:, target]), LEAST_M_S)
        predictions.append(np.where(usable[:, [target, *which]].all(axis=1), predicted * np.conj(direction), 0.0))
    return np.array(predictions)


def _shape(cells: Floats, length: float, power: float) -> Floats:
    return 1.0 - np.exp(-((cells / length) ** power))
