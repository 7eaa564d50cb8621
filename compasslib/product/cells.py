"""Velocities of one instrument at fixed depths and times.

Profiles are interpolated linearly in depth over gaps up to a limit; elsewhere, the nearest bin is used if it contains
the depth. Samples are averaged over the interval of each time, and empty cells interpolated in time over gaps up to a
limit. A cell without a measurement inside it counts as interpolated; nothing is extrapolated.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation.references import combine_references
from compasslib.records import DEEPEST_M, MISSING, Flags, Pairs
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Bools, Complexes, Floats

NONE = complex(np.nan, np.nan)
PRESSURE_SIGMA_M, NOMINAL_SIGMA_M = 0.5, 5.0  # of a measured depth (0.25 % of 200 m), and of a nominal depth
PROFILER_M_S = 0.02  # least vertical speed of an instrument that climbs along the line; spheres dive at some mm/s


@dataclass(frozen=True)
class Axes:
    """Depths and times of the grid, in even steps."""

    time_s: Floats  # (t,) middle of each interval
    step_s: float
    depth_m: Floats  # (z,) increasing
    step_m: float

    def slot_of(self, time_s: Floats) -> NDArray[np.intp]:
        """Find the interval that contains each time, (n,); before or after all, negative or beyond the last."""
        if not len(self.time_s):
            return np.full(len(time_s), -1)
        return np.floor((time_s - self.time_s[0]) / self.step_s + 0.5).astype(np.intp)


@dataclass(frozen=True)
class Velocities:
    """Velocities of k samples in m bins, true east + i north."""

    velocity: Complexes  # (k, m) m/s, NaN where it is not used
    depth_m: Floats  # (k, m)
    quality: Flags  # (k, m)
    up: Floats | None = None  # (k, m) vertical velocity, m/s; None if it was not measured


@dataclass(frozen=True)
class Source:
    """An instrument with n samples whose velocities are gridded."""

    name: str
    time_s: Floats  # (n,) increasing
    depth_m: Floats  # (n,) of the instrument
    tilt_deg: Floats  # (n,) NaN where unknown
    bins: int
    beam_angle_deg: float
    rows: Callable[[slice], Velocities]  # reads a slice of the samples
    rising: bool = False  # whether vertical velocities were measured
    slowed: tuple[tuple[float, float], ...] = ()  # periods in which a fouled rotor yields to the affected instruments

    @property
    def profiles(self) -> bool:
        """Whether it moves along the line or delivers separate profiles, between which nothing is interpolated."""
        if self.bins > 1:
            return self.beam_angle_deg == 0.0
        known = np.isfinite(self.depth_m)
        speed = np.abs(np.diff(self.depth_m[known])) / np.maximum(np.diff(self.time_s[known]), 1e-3)
        return bool(len(speed)) and float(np.percentile(speed, 75)) > PROFILER_M_S

    @cached_property
    def depth_sigma_m(self) -> float:
        """Standard deviation of its depth, m; a depth that never varies is nominal, not measured."""
        known = self.depth_m[np.isfinite(self.depth_m)]
        return PRESSURE_SIGMA_M if known.size and np.ptp(known) > 0.0 else NOMINAL_SIGMA_M


@dataclass(frozen=True)
class Differences:
    """Structure function: half the mean squared velocity difference, both components, by distance in depth or time."""

    step: float  # metres or seconds
    values: Floats  # (k,) (m/s)^2 at 0, 1, 2, ... steps
    noise: float = 0.0  # variance of one measurement, (m/s)^2, not included in the values

    def at(self, distance: Floats) -> Floats:
        """Look up the structure function at distances, constant beyond the last value."""
        index = np.minimum(distance * (1.0 / self.step) + 0.5, len(self.values) - 1.0).astype(np.intp)
        return self.values[index]

    def of_interpolation(self, share: Floats, gap: Floats) -> Floats:
        """Compute the mean squared error of a linear interpolation, at a share of the gap, without noise."""
        toward, back = self.at(share * gap), self.at((1.0 - share) * gap)
        return 2.0 * ((1.0 - share) * toward + share * back) - 2.0 * share * (1.0 - share) * self.at(gap)


@dataclass(frozen=True)
class Learnt:
    """Structure functions, noise and motion of an instrument, estimated from the records."""

    by_depth: Differences
    by_time: Differences
    bin_noise: Floats  # (m,) variance of the noise, summed over both components, (m/s)^2
    cell_m: float
    motion: Floats  # (n,) horizontal velocity of the instrument itself, one standard deviation, m/s


@dataclass(frozen=True)
class Cells:
    """Velocities at t times and z successive depths of the axes, NaN in empty cells."""

    velocity: Complexes  # (t, z) m/s
    up: Floats | None  # (t, z) m/s
    quality: Flags  # (t, z) worst flag of the contributing measurements
    count: NDArray[np.int32]  # (t, z) number of contributing measurements
    measured: Bools  # (t, z) whether one of them lies inside the cell
    noise: Floats  # (t, z) variance of a component due to noise, (m/s)^2
    spread: Floats  # (t, z) the same due to distances in depth and time and to errors of depth and tilt
    levels: slice  # of the depths of the axes

    @property
    def there(self) -> Bools:
        """Mask of the cells with a velocity, (t, z)."""
        return np.isfinite(self.velocity.real)


def empty_cells(times: int, levels: slice, rising: bool) -> Cells:
    """Make cells without velocities."""
    shape = times, levels.stop - levels.start
    return Cells(
        velocity=np.full(shape, NONE), up=np.full(shape, np.nan) if rising else None,
        quality=np.full(shape, MISSING, dtype=np.int8), count=np.zeros(shape, dtype=np.int32),
        measured=np.zeros(shape, dtype=bool), noise=np.zeros(shape), spread=np.zeros(shape), levels=levels,
    )  # fmt: skip


def place(source: Source, learnt: Learnt, axes: Axes, slots: range, max_gap_m: float) -> Cells:
    """Average the velocities of an instrument over the intervals of a piece, at the depths that they reach."""
    ends = axes.time_s[[slots.start, slots.stop - 1]] + axes.step_s * np.array([-0.5, 0.5])
    rows = slice(*np.searchsorted(source.time_s, ends).tolist())
    if source.bins == 1:
        return _place_points(source, learnt, rows, axes, slots)
    return _place_profiles(source, learnt, rows, axes, slots, max_gap_m)


def _place_profiles(source: Source, learnt: Learnt, rows: slice, axes: Axes, slots: range, max_gap_m: float) -> Cells:
    """Interpolate profiles to the depths, between bins up to ``max_gap_m`` apart, and average them."""
    profiles, cell_m, by_depth = source.rows(rows), learnt.cell_m, learnt.by_depth
    descending = np.nansum(np.diff(profiles.depth_m, axis=1)) < 0.0
    line = slice(None, None, -1) if descending else slice(None)
    depth, velocity, quality = profiles.depth_m[:, line], profiles.velocity[:, line], profiles.quality[:, line]
    usable, noise = np.isfinite(velocity.real) & np.isfinite(depth), learnt.bin_noise[line]
    reached = depth[usable]
    beyond_m = cell_m / 2.0 + 1e-3
    ends = (reached.min() - beyond_m, reached.max() + beyond_m) if len(reached) else (0.0, 0.0)
    window = slice(*np.searchsorted(axes.depth_m, ends).tolist())
    if window.start == window.stop:
        return empty_cells(len(slots), window, profiles.up is not None)
    levels, (k, m) = axes.depth_m[window], depth.shape
    row = np.arange(k)[:, None]
    # Number of bins of each sample at or above each level, (k, z), by one search among rows set apart.
    depths, apart = np.where(np.isfinite(depth), depth, DEEPEST_M + np.arange(m)), 2.0 * (DEEPEST_M + m) * row
    below = np.searchsorted((depths + apart).ravel(), (levels + 1e-6 + apart).ravel(), side="right")
    below = below.reshape(k, len(levels)) - m * row
    last = np.maximum.accumulate(np.where(usable, np.arange(m), -1), axis=1)
    next_ = np.minimum.accumulate(np.where(usable, np.arange(m), m)[:, ::-1], axis=1)[:, ::-1]
    first = np.where(below > 0, last[row, np.maximum(below - 1, 0)], -1)
    second = np.where(below < m, next_[row, np.minimum(below, m - 1)], m)
    has = first >= 0, second < m
    at = tuple(row * m + np.clip(index, 0, m - 1) for index in (first, second))
    off = tuple(np.where(h, np.abs(levels - depth.ravel()[a]), np.inf) for h, a in zip(has, at, strict=True))
    nearest = np.minimum(*off)
    gap = off[0] + off[1]
    between = gap <= max_gap_m * 1.001
    there = between | (nearest <= cell_m / 2.0)
    share = np.where(off[0] <= off[1], 0.0, 1.0)
    share[between] = off[0][between] / np.maximum(gap[between], 1e-9)
    alone = np.abs(share - np.rint(share)) < 1e-4  # a bin at the depth itself, but for rounding
    share[alone] = np.rint(share[alone])
    weights = np.where(there & (share < 1.0), 1.0 - share, 0.0), np.where(there & (share > 0.0), share, 0.0)

    def mixed(values: NDArray) -> NDArray:
        known = np.where(usable, values, 0.0).ravel()
        return weights[0] * known[at[0]] + weights[1] * known[at[1]]

    up = None
    if profiles.up is not None:
        rising = profiles.up[:, line]
        up = np.where(mixed(np.isfinite(rising).astype(float)) > 0.999, mixed(np.nan_to_num(rising)), np.nan)
    interpolated = by_depth.of_interpolation(share, np.where(between, gap, 0.0))
    spread = np.where(between, interpolated, 2.0 * by_depth.at(np.where(there, nearest, 0.0)))
    placed = Cells(
        velocity=mixed(velocity), up=up,
        quality=np.maximum(*(np.where(w > 0.0, quality.ravel()[a], 0) for w, a in zip(weights, at, strict=True))),
        count=np.add(*((w > 0.0).astype(np.int32) for w in weights)),
        measured=there & (nearest <= axes.step_m / 2.0 + 1e-6),
        noise=(weights[0] ** 2 * noise[at[0] % m] + weights[1] ** 2 * noise[at[1] % m]) / 2.0,
        spread=(spread + _of_stance(source, rows, levels, by_depth)) / 2.0, levels=window,
    )  # fmt: skip
    return _average(placed, there, source.time_s[rows], axes, slots, learnt.by_time)


def _of_stance(source: Source, rows: slice, levels_m: Floats, by_depth: Differences) -> Floats:
    """Compute the mean squared error due to the instrument's uncertain depth and its tilt, (k, z).

    A tilt t shifts a cell at range r by r(1 - cos t) in depth, and the cells of two opposite beams at an angle b by
    r tan b sin t in opposite directions: the measured velocity is the mean of those at two depths.
    """
    sine, cosine = angles.sin_cos(np.nan_to_num(source.tilt_deg[rows]))
    range_m = np.abs(levels_m - np.nan_to_num(source.depth_m[rows])[:, None])
    wrong_m = np.hypot(source.depth_sigma_m, range_m * (1.0 - cosine)[:, None])
    squared = 2.0 * by_depth.at(wrong_m)
    if not source.beam_angle_deg:
        return squared
    across, along = angles.sin_cos(source.beam_angle_deg)
    apart_m = range_m * (float(across / along) * np.abs(sine))[:, None]
    return squared + np.maximum(2.0 * by_depth.at(apart_m) - 0.5 * by_depth.at(2.0 * apart_m), 0.0)


def _average(cells: Cells, there: Bools, time_s: Floats, axes: Axes, slots: range, by_time: Differences) -> Cells:
    """Average ``cells``, whose rows are samples, over the intervals of the axes."""
    slot = axes.slot_of(time_s) - slots.start
    inside = np.flatnonzero((slot >= 0) & (slot < len(slots)))
    result = empty_cells(len(slots), cells.levels, cells.up is not None)
    if not len(inside):
        return result
    there, slot = there[inside], slot[inside]
    begin = np.flatnonzero(np.diff(slot, prepend=-1))
    rows = slot[begin]

    def total(values: NDArray, where: Bools) -> NDArray:
        return np.add.reduceat(np.where(where, values[inside], 0), begin, axis=0)

    number = np.add.reduceat(there.astype(np.int32), begin, axis=0)
    share = 1.0 / np.maximum(number, 1)
    late = share * total(np.broadcast_to((time_s - axes.time_s[0])[:, None], cells.velocity.shape), there)
    late = np.where(number > 0, late + axes.time_s[0] - axes.time_s[slots.start + rows, None], 0.0)
    columns = {
        "velocity": share * total(cells.velocity, there),
        "quality": np.maximum.reduceat(np.where(there, cells.quality[inside], 0), begin, axis=0),
        "count": total(cells.count, there),
        "measured": np.logical_or.reduceat(there & cells.measured[inside], begin, axis=0),
        "noise": share**2 * total(cells.noise, there),
        "spread": share * total(cells.spread, there) + by_time.at(np.abs(late)),
    }
    if cells.up is not None:
        rising = there & np.isfinite(cells.up[inside])
        count = np.add.reduceat(rising.astype(np.int32), begin, axis=0)
        columns["up"] = np.where(count > 0, total(cells.up, rising) / np.maximum(count, 1), np.nan)
    for name, values in columns.items():
        column = getattr(result, name)
        column[rows] = np.where(number > 0, values, column[rows])
    return result


def _place_points(source: Source, learnt: Learnt, rows: slice, axes: Axes, slots: range) -> Cells:
    """Average single velocities, of a point meter or of a profiler's scans, over the cells that contain them."""
    points, time_s, by_depth = source.rows(rows), source.time_s[rows], learnt.by_depth
    velocity, depth = points.velocity[:, 0], points.depth_m[:, 0]
    slot = axes.slot_of(time_s) - slots.start
    level = np.floor((np.nan_to_num(depth - axes.depth_m[0], nan=-axes.step_m)) / axes.step_m + 0.5).astype(np.intp)
    inside = (slot >= 0) & (slot < len(slots)) & (level >= 0) & (level < len(axes.depth_m))
    inside &= np.isfinite(velocity.real)
    if not inside.any():
        return empty_cells(len(slots), slice(0, 0), points.up is not None)
    window = slice(int(level[inside].min()), int(level[inside].max()) + 1)
    width = window.stop - window.start
    place, index = np.unique((slot * width + level - window.start)[inside], return_inverse=True)
    at, count = np.divmod(place, width), np.bincount(index)

    def mean(values: Floats) -> Floats:
        return np.bincount(index, values[inside]) / count

    late = mean(time_s - axes.time_s[0]) + axes.time_s[0] - axes.time_s[slots.start + at[0]]
    off = mean(depth) - axes.depth_m[window.start + at[1]]
    worst = np.zeros(len(place), dtype=np.int8)
    np.maximum.at(worst, index, points.quality[:, 0][inside])
    cells = empty_cells(len(slots), window, points.up is not None)
    cells.velocity[at] = mean(velocity.real) + 1j * mean(velocity.imag)
    if cells.up is not None and points.up is not None:
        cells.up[at] = mean(points.up[:, 0])
    cells.quality[at], cells.count[at], cells.measured[at] = worst, count, True
    cells.noise[at] = by_depth.noise / (2.0 * count)
    cells.spread[at] = by_depth.at(np.hypot(off, source.depth_sigma_m)) + learnt.by_time.at(np.abs(late))
    return cells


def bridge_gaps(cells: Cells, step_s: float, max_gap_s: float, by_time: Differences) -> Cells:
    """Interpolate empty cells linearly in time over gaps up to a limit."""
    there, times = cells.there, np.arange(len(cells.velocity))[:, None]
    before = np.maximum.accumulate(np.where(there, times, -1), axis=0)
    after = np.minimum.accumulate(np.where(there, times, len(times))[::-1], axis=0)[::-1]
    near = (before >= 0) & (after < len(times)) & ((after - before) * step_s <= max_gap_s * 1.001)
    row, column = np.nonzero(near & ~there)
    if not len(row):
        return cells
    ends = before[row, column], after[row, column]
    share = (row - ends[0]) / (ends[1] - ends[0])

    def filled(values: NDArray, power: int = 1) -> NDArray:
        made = values.copy()
        made[row, column] = (1.0 - share) ** power * values[ends[0], column] + share**power * values[ends[1], column]
        return made

    quality, count, spread = cells.quality.copy(), cells.count.copy(), filled(cells.spread)
    quality[row, column] = np.maximum(*(cells.quality[end, column] for end in ends))
    count[row, column] = sum(cells.count[end, column] for end in ends)
    spread[row, column] += by_time.of_interpolation(share, (ends[1] - ends[0]) * step_s) / 2.0
    up = None if cells.up is None else filled(cells.up)
    velocity, noise = filled(cells.velocity), filled(cells.noise, 2)
    return replace(cells, velocity=velocity, up=up, quality=quality, count=count, noise=noise, spread=spread)


def merge(each: list[Cells], times: int, depths: int) -> tuple[Cells, NDArray[np.int8]]:
    """Take each cell from the first instrument that measured it, else interpolated it; return also its index, or -1."""
    whole = empty_cells(times, slice(0, depths), any(cells.up is not None for cells in each))
    source = np.full((times, depths), -1, dtype=np.int8)
    for best in (False, True):  # measured cells overwrite interpolated ones
        for k, cells in reversed([*enumerate(each)]):
            source[:, cells.levels][cells.measured if best else cells.there] = k
    for k, cells in enumerate(each):
        here = source[:, cells.levels] == k
        for name in ("velocity", "up", "quality", "count", "measured", "noise", "spread"):
            if (part := getattr(cells, name)) is not None:
                getattr(whole, name)[:, cells.levels][here] = part[here]
    return whole, source


def compare_at_seam(pairs: Pairs, assessment: Mapping[str, Any]) -> dict[str, Any]:
    """Compare affected and reference velocities by speed, which headings do not affect, and by held-out directions.

    The fit makes the directions of its own pairs agree; ``assessment`` therefore uses pairs that were held out.

    Returns:
        Means of affected minus reference, each with its standard error; None for less than 30 pairs.
    """
    pairs, speed, sigma = combine_references(pairs), None, None
    if len(pairs) >= 30:
        upper, lower = pairs.flows
        off = np.abs(upper) - np.abs(lower)
        speed, sigma = float(off.mean()), float(off.std() / np.sqrt(effective_sample_size(off, pairs.time_s)))
    after = assessment["after"]
    known = after["n"] >= 30
    independent = (after["rms_deg"] / after["rms_deg_sigma"]) ** 2 / 2.0 if known else 1.0
    return {
        "pairs": len(pairs),
        "speed_difference_m_s": speed,
        "speed_difference_sigma_m_s": sigma,
        "held_out_pairs": after["n"],
        "direction_difference_deg": after["mean_deg"] if known else None,
        "direction_difference_sigma_deg": after["rms_deg"] / float(np.sqrt(independent)) if known else None,
    }


def describe_seam(seam: Mapping[str, Any]) -> str:
    """Describe the comparison of ``compare_at_seam`` in a sentence; empty if there are too few pairs."""
    parts = []
    for key, unit, scale in (("speed_difference", "m_s", 100.0), ("direction_difference", "deg", 1.0)):
        value, sigma = seam[f"{key}_{unit}"], seam[f"{key}_sigma_{unit}"]
        if value is None:
            continue
        half = NORMAL_95 * scale * sigma
        shown = f"{scale * value:+.1f} ± {half:.1f} {'cm/s' if unit == 'm_s' else 'degrees'}"
        words = f"{key.replace('_', ' ')} {shown} (95 %)"
        parts.append(words + ("" if abs(scale * value) <= half else ", more than chance"))
    return f"affected minus reference: {'; '.join(parts)}" if parts else ""


def average_slots(values: Floats, time_s: Floats, axes: Axes, max_gap_s: float) -> Floats:
    """Average columns (n, ...) over the intervals of the axes, (t, ...); interpolate gaps up to a limit, else NaN."""
    slot, at = axes.slot_of(time_s), np.arange(len(axes.time_s))
    known = np.isfinite(values).all(axis=tuple(range(1, values.ndim))) & (slot >= 0) & (slot < len(at))
    result = np.full((len(at), *values.shape[1:]), np.nan)
    if not known.any():
        return result
    begin = np.flatnonzero(np.diff(slot[known], prepend=-1))
    rows, size = slot[known][begin], np.diff(np.append(begin, known.sum()))
    means = (np.add.reduceat(values[known], begin, axis=0).T / size).T
    after = np.clip(np.searchsorted(rows, at), 0, len(rows) - 1)
    before = np.where(rows[after] == at, after, np.maximum(after - 1, 0))
    gap = rows[after] - rows[before]
    inside = (rows[before] <= at) & (rows[after] >= at) & (gap * axes.step_s <= max_gap_s * 1.001)
    share = (at - rows[before]) / np.maximum(gap, 1)
    result[inside] = ((1.0 - share) * means[before].T + share * means[after].T).T[inside]
    return result


def average_angle(angle_deg: Floats, time_s: Floats, axes: Axes, max_gap_s: float) -> Floats:
    """Average an angle over the intervals of the axes, (t,) in [-180, 180)."""
    sine, cosine = (average_slots(part, time_s, axes, max_gap_s) for part in angles.sin_cos(angle_deg))
    return angles.wrap180(angles.direction(sine, cosine))
