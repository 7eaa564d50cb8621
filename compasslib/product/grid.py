"""Grid the velocities of a mooring's instruments: axes, cells, merging, uncertainty and daily means."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.errors import InputError
from compasslib.preparation.clocks import common_phase
from compasslib.product.cells import (
    NONE,
    PROFILER_M_S,
    Axes,
    Cells,
    Learnt,
    Source,
    bridge_gaps,
    empty_cells,
    merge,
    place,
)
from compasslib.product.errors import (
    UNMEASURED_MOTION_M_S,
    HeadingErrors,
    error_memory,
    learn_bin_noise,
    learn_by_depth,
    learn_by_time,
    marginals,
    mean_factor,
    sphere_motion,
)
from compasslib.records import DEEPEST_M, MISSING, PROBABLY_BAD, Flags, take
from compasslib.types import DAY_S, HOUR_S, Complexes, Floats

PIECE, CELLS = 4096, 1 << 21  # times gridded at once, and cells, of some 300 bytes each
INTERPOLATED = 8  # OceanSITES reference table 2
SLOWEST_STEP_S = HOUR_S
BLOCK = 1500  # largest length of the blocks that structure functions are fitted to


@dataclass(frozen=True)
class GridRules:
    """Requested grid; None stands for the sampling of the affected instrument."""

    step_m: float | None = None
    from_m: float | None = None
    to_m: float | None = None
    minutes: float | None = None
    max_gap_m: float | None = None
    max_gap_minutes: float = 180.0


@dataclass(frozen=True)
class Survey:
    """Summary of an instrument's velocities, from one pass through them."""

    share: Floats  # of the samples, or of a profiler's profiles, with a velocity within half a cell of each metre
    flow: Complexes  # (n,) mean over the usable bins
    blocks: tuple[Complexes, ...]  # velocities of consecutive samples, (k, m) each
    range_m: Floats  # (m,) median distance of the bins from the instrument
    cell_m: float

    @property
    def empty(self) -> bool:
        """Whether no velocity is usable."""
        return not self.share.any()


@dataclass(frozen=True)
class Piece:
    """The product over a slice of its times, (t, z) each."""

    slots: slice
    cells: Cells
    source: NDArray[np.int8]  # position of the instrument, -1 without any
    quality: Flags
    east_variance: Floats
    north_variance: Floats
    covariance: Floats
    noise: Floats  # part of the variance that is independent from time to time
    spread: Floats  # part of the variance that is correlated in time but not due to the heading


@dataclass(frozen=True)
class GriddedProduct:
    """Velocities of a mooring at fixed depths and times; iteration yields pieces along time."""

    sources: tuple[Source, ...]  # affected instruments first
    learnt: tuple[Learnt, ...]
    axes: Axes
    errors: HeadingErrors
    deviation_deg: Floats  # (a, t) corrected minus recorded heading of each affected instrument
    max_gap_m: float
    max_gap_s: float
    memory_s: float  # correlation time of the errors that are not due to the heading

    @cached_property
    def heading_variance(self) -> Floats:
        """The variance of each instrument's heading, (s, t) square radians."""
        return np.array([self.errors.variance(k) for k in range(len(self.sources))])

    def __iter__(self) -> Iterator[Piece]:
        """Yield the pieces in order of time."""
        halo = int(np.ceil(self.max_gap_s / self.axes.step_s)) + 1
        count, size = len(self.axes.time_s), max(1, min(PIECE, CELLS // len(self.axes.depth_m)))
        for begin in range(0, count, size):
            inner = slice(begin, min(begin + size, count))
            wide = range(max(begin - halo, 0), min(inner.stop + halo, count))
            here = slice(inner.start - wide.start, inner.stop - wide.start)
            each = []
            for source, learnt in zip(self.sources, self.learnt, strict=True):
                cells = place(source, learnt, self.axes, wide, self.max_gap_m)
                if not source.profiles:
                    cells = bridge_gaps(cells, self.axes.step_s, self.max_gap_s, learnt.by_time)
                moving = np.full(len(wide), UNMEASURED_MOTION_M_S)
                if len(source.time_s):
                    moving = np.interp(self.axes.time_s[wide.start : wide.stop], source.time_s, learnt.motion)
                each.append(take(replace(cells, spread=cells.spread + moving[:, None] ** 2), here))
            yield self._combine(each, inner)

    def _combine(self, each: list[Cells], inner: slice) -> Piece:
        # References take precedence over affected instruments: their headings are better known.
        affected, time_s = len(self.errors.random), self.axes.time_s[inner]
        first, last = range(affected, len(each)), [k for k in range(affected, len(each)) if self.sources[k].slowed]
        order = [*first, *range(affected), *last]
        ordered = [each[k] for k in order]
        for at, k in enumerate(first):  # while its rotor was fouled it yields
            slow = np.any([(time_s >= a) & (time_s <= b) for a, b in self.sources[k].slowed], axis=0)[..., None]
            velocity = np.where(slow, NONE, each[k].velocity)
            ordered[at] = replace(each[k], velocity=velocity, measured=each[k].measured & ~slow)
        cells, taken = merge(ordered, len(time_s), len(self.axes.depth_m))
        source, there = np.array([*order, -1], dtype=np.int8)[taken], taken >= 0
        heading = self.heading_variance[source[there], inner.start + np.nonzero(there)[0]]
        noise, spread = cells.noise[there], cells.spread[there]
        parts = [*marginals(cells.velocity[there], heading, noise + spread), noise, spread]
        columns = np.full((len(parts), *there.shape), np.nan)
        columns[:, there] = parts
        interpolated = there & ~cells.measured & (cells.quality < PROBABLY_BAD)
        quality = np.where(interpolated, INTERPOLATED, cells.quality)
        return Piece(inner, cells, source, quality.astype(np.int8), *columns)


def empty_piece(depths: int, rising: bool) -> Piece:
    """Make a piece without times."""
    none = np.zeros((0, depths))
    cells = empty_cells(0, slice(0, depths), rising)
    return Piece(slice(0, 0), cells, none.astype(np.int8), none.astype(np.int8), *[none] * 5)


def survey(source: Source) -> Survey:
    """Summarize an instrument's velocities in one pass, of which some eight short blocks are kept."""
    n = len(source.time_s)
    count, flow = np.zeros(DEEPEST_M, dtype=int), np.full(n, complex(np.nan, np.nan))
    blocks, ranges, steps, samples = [], [], [], 0
    scans = source.bins == 1 and source.profiles
    stride = max(1, -(-n // PIECE) // 8)
    read_at_once = PIECE * max(64 // source.bins, 1)
    for number, begin in enumerate(range(0, n, PIECE)):
        rows = slice(begin, begin + PIECE)
        if begin % read_at_once == 0:
            read = source.rows(slice(begin, begin + read_at_once))
        here = take(read, slice(begin % read_at_once, begin % read_at_once + PIECE))
        usable = np.isfinite(here.velocity.real) & np.isfinite(here.depth_m)
        metre = here.depth_m[usable]
        metre = np.rint(metre[(metre >= 0.0) & (metre < DEEPEST_M - 0.5)]).astype(int)
        if scans:  # each metre between two scans that follow each other is passed once
            ends = np.minimum(metre[1:], metre[:-1]), np.maximum(metre[1:], metre[:-1])
            count += np.cumsum(np.subtract(*(np.bincount(end, minlength=DEEPEST_M) for end in ends)))
        else:
            count += np.bincount(metre, minlength=DEEPEST_M)
        samples += int(usable.any(axis=1).sum())
        total = np.where(usable, here.velocity, 0.0).sum(axis=1)
        number_of = usable.sum(axis=1)
        flow[rows] = np.where(number_of > 0, total / np.maximum(number_of, 1), np.nan)
        if number % stride == 0 and len(here.velocity):
            blocks.append(here.velocity[:BLOCK])
            ranges.append(np.abs(here.depth_m[:BLOCK] - source.depth_m[rows][:BLOCK, None]))
            steps.append(np.abs(np.diff(here.depth_m[:BLOCK], axis=1)))
    away = np.concatenate(ranges) if ranges else np.zeros((0, source.bins))
    known = np.concatenate([step[np.isfinite(step)] for step in steps]) if steps else np.zeros(0)
    cell_m = round(float(np.median(known)), 2) if known.size else 0.0
    if scans and count.any():  # how often the metre of a typical passage is passed
        passed = np.sort(count)
        samples = int(passed[np.searchsorted(np.cumsum(passed), passed.sum() / 2.0)])
    around = np.convolve(count, np.ones(max(round(cell_m), 1)), "same") * (count > 0)
    range_m = np.nanmedian(away, axis=0) if np.isfinite(away).any() else np.zeros(source.bins)
    return Survey(around / max(samples, 1), flow, tuple(blocks), range_m, cell_m)


def make_axes(sources: Sequence[Source], surveys: Sequence[Survey], rules: GridRules) -> Axes:
    """Make the axes: as requested, else with the steps of the first instrument over the range that any measured.

    Raises:
        InputError: there would be too many depths.
    """
    cells = [each.cell_m for each in surveys if each.cell_m > 0.0 and not each.empty]
    cell_m = surveys[0].cell_m if not surveys[0].empty else 0.0
    step_m = rules.step_m or cell_m or (cells[0] if cells else 10.0)
    phase_m = _depth_phase(sources[0], surveys[0], step_m) if rules.from_m is None else rules.from_m
    ends = [_ends(each, step_m, phase_m) for each in surveys if not each.empty] or [(phase_m, phase_m)]
    first = min(low for low, _ in ends) if rules.from_m is None else rules.from_m
    last = max(max(high for _, high in ends) if rules.to_m is None else rules.to_m, first)
    if (depths := int((last - first) / step_m + 1e-6) + 1) > 6000:  # 1 m apart over most of the ocean
        actual, advice = f"{depths} from {first:g} to {last:g} m", "write a larger step_m, or from_m and to_m"
        raise InputError("product.grid", expected="up to 6000 depths", found=actual, advice=advice)
    depth_m = np.round(first + step_m * np.arange(depths), 3)
    used = [s for s, each in zip(sources, surveys, strict=True) if not each.empty] or list(sources[:1])
    timed = next((s for s in used if not s.profiles and len(s.time_s) > 1), None)
    step_s = SLOWEST_STEP_S if timed is None else float(np.rint(np.median(np.diff(timed.time_s))))
    step_s = 60.0 * rules.minutes if rules.minutes else max(step_s, 60.0)
    times = [s.time_s for s in used if len(s.time_s)]
    if not times:
        return Axes(np.zeros(0), step_s, depth_m, step_m)
    middle = step_s / 2.0 if rules.minutes or timed is None else common_phase(timed.time_s, step_s)
    span = np.array([min(t[0] for t in times), max(t[-1] for t in times)])
    begin, end = np.floor((span - middle) / step_s + 0.5)
    return Axes(np.round(middle + step_s * np.arange(begin, end + 1), 3), step_s, depth_m, step_m)


def learn(
    sources: Sequence[Source], surveys: Sequence[Survey], max_gap_s: float, water_depth_m: float | None
) -> tuple[Learnt, ...]:
    """Estimate each instrument's structure functions and noise, borrowing those of the first where data are too few."""
    learnt: list[Learnt] = []
    for source, survey in zip(sources, surveys, strict=True):
        step_s = float(np.median(np.diff(source.time_s))) if len(source.time_s) > 1 else SLOWEST_STEP_S
        together = np.concatenate(survey.blocks or (np.zeros((0, source.bins), dtype=complex),))
        by_depth = learn_by_depth(together, survey.range_m, survey.cell_m)
        noise = by_depth.noise if survey.cell_m and len(survey.range_m) >= 4 else None
        fullest = [np.argsort(-np.isfinite(b.real).sum(axis=0), kind="stable")[:4] for b in survey.blocks]
        few = tuple(block[:, bins] for block, bins in zip(survey.blocks, fullest, strict=True))
        by_time = learn_by_time(few, step_s, max(max_gap_s, 6 * HOUR_S), noise)
        if noise is None:
            by_depth = replace(by_depth, noise=by_time.noise)
        if learnt and not surveys[0].empty and (source.profiles or noise is None):
            first = learnt[0]
            by_depth = replace(first.by_depth, noise=first.by_depth.noise if source.profiles else by_time.noise)
            by_time = first.by_time if source.profiles else by_time
        motion = sphere_motion(source.depth_m, survey.flow, source.time_s, water_depth_m)
        if source.profiles:
            motion = np.full(len(source.time_s), UNMEASURED_MOTION_M_S)
        learnt.append(Learnt(by_depth, by_time, learn_bin_noise(together, by_depth), survey.cell_m, motion))
    return tuple(learnt)


def grid(
    sources: Sequence[Source],
    surveys: Sequence[Survey],
    axes: Axes,
    rules: GridRules,
    errors: HeadingErrors,
    deviation_deg: Floats,
    *,
    water_depth_m: float | None,
) -> GriddedProduct:
    """Grid the instruments of a mooring; cells are computed lazily, when the product is iterated.

    Args:
        sources: affected instruments first, then references; where both have a measured cell, the reference's is used.
        errors: heading errors at the times of the axes.
        deviation_deg: (a, t) corrected minus recorded heading of each affected instrument.
    """
    max_gap_s = 60.0 * rules.max_gap_minutes
    learnt = learn(sources, surveys, max_gap_s, water_depth_m)
    step_s = float(np.median(np.diff(sources[0].time_s))) if len(sources[0].time_s) > 1 else axes.step_s
    return GriddedProduct(
        tuple(sources), learnt, axes, errors, deviation_deg,
        # Across one missing bin, unless a distance is requested.
        max_gap_m=2.0 * (surveys[0].cell_m or axes.step_m) if rules.max_gap_m is None else rules.max_gap_m,
        max_gap_s=max_gap_s,
        memory_s=error_memory(surveys[0].blocks, step_s, learnt[0].by_depth.noise),
    )  # fmt: skip


def _depth_phase(source: Source, survey: Survey, step_m: float) -> float:
    """Find the depth to align the levels with: that of the first bin of an instrument at steady depth, else 0."""
    known = source.depth_m[np.isfinite(source.depth_m)]
    if survey.empty or not known.size or np.std(known) > 0.1 * step_m or not len(survey.range_m):
        return 0.0
    nearest = source.rows(slice(0, BLOCK)).depth_m[:, 0]
    nearest = nearest[np.isfinite(nearest)]
    return round(float(np.median(nearest)), 1) if nearest.size else 0.0


def _ends(survey: Survey, step_m: float, phase_m: float) -> tuple[float, float]:
    """Find the first and last level, m, that at least 10 % of samples or profiles have; a mean of fewer is biased."""
    metre = np.flatnonzero(survey.share >= min(0.1, survey.share.max()))
    first, last = np.rint((metre[[0, -1]] - phase_m) / step_m)
    return phase_m + step_m * float(first), phase_m + step_m * float(last)


def describe_parking(source: Source) -> str:
    """Describe the stretches in which a profiler measured without climbing for 6 hours; empty where there are none."""
    known = np.isfinite(source.depth_m)
    time_s, depth_m = source.time_s[known], source.depth_m[known]
    if not source.profiles or source.bins > 1 or len(time_s) < 2:
        return ""
    steps_s = np.diff(time_s)
    still = (np.abs(np.diff(depth_m)) < PROFILER_M_S * steps_s) & (steps_s <= 3.0 * np.median(steps_s))  # no gaps
    edges = np.diff(np.concatenate([[False], still, [False]]).astype(int))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    lasting = time_s[ends] - time_s[begins] >= 6 * HOUR_S
    if not lasting.any():
        return ""
    begins, ends = begins[lasting], ends[lasting]
    hours = float(np.sum(time_s[ends] - time_s[begins])) / HOUR_S
    depths = np.concatenate([depth_m[b : e + 1] for b, e in zip(begins, ends, strict=True)])
    return f"{source.name} was parked {len(begins)} times, {hours:.0f} hours in all, near {np.median(depths):.0f} m"


# Means over UTC days, and low-passed values at noon, accumulated piece by piece.

GODIN_H = (24.0, 24.0, 25.0)  # running means whose succession removes the tides (Godin 1972, The Analysis of Tides)


@dataclass(frozen=True)
class Daily:
    """Means over d days, or values of a filter at their noons."""

    time_s: Floats  # (d,) noon
    piece: Piece
    errors: HeadingErrors
    deviation_deg: Floats  # (a, d)
    count: NDArray[np.int_]  # (d, z) number of averaged times
    shrinkage: Floats  # (d,) exp(-heading variance / 2) of the first instrument


@dataclass
class DailyMeans:
    """Daily sums of a product: over the UTC day, or by a filter of successive running means about noon."""

    axes: Axes
    errors: HeadingErrors
    running_h: tuple[float, ...] = ()  # lengths of running means; none for the mean of the UTC day
    sums: dict[str, NDArray[Any]] = field(default_factory=dict)

    @cached_property
    def days(self) -> NDArray[np.intp]:
        """Day number of each time, counted from the first day, (t,)."""
        day = np.floor(self.axes.time_s / DAY_S).astype(np.intp)
        return day - day[0] if len(day) else day

    @cached_property
    def kernel(self) -> tuple[Floats, Floats]:
        """Lags from noon, s, and weights relative to the largest."""
        if not self.running_h:
            return np.array([-0.5, 0.5]) * DAY_S, np.ones(2)
        step_s = HOUR_S / 4.0
        weights = np.ones(1)
        for hours in self.running_h:
            weights = np.convolve(weights, np.ones(round(hours * HOUR_S / step_s)))
        return step_s * (np.arange(len(weights)) - (len(weights) - 1) / 2.0), weights / weights.max()

    def add(self, piece: Piece) -> None:
        """Add a piece to the daily sums."""
        there, flow, sources = piece.source >= 0, piece.cells.velocity, np.maximum(piece.source, 0)
        flow = np.where(there, flow, 0.0)
        modes, random = self.errors.modes[:, piece.slots], self.errors.random[:, piece.slots]
        of_affected = there & (sources < len(random))
        here = np.arange(random.shape[1])[:, None]
        random2 = np.where(of_affected, random[np.minimum(sources, len(random) - 1), here] ** 2, 0.0)
        quality = piece.quality
        columns = {
            "weight": there.astype(float), "flow": flow, "spread": np.where(there, piece.spread, 0.0),
            "interpolated": (quality == INTERPOLATED).astype(float),
            "east2": np.where(of_affected, random2 * flow.imag**2, 0.0),
            "north2": np.where(of_affected, random2 * flow.real**2, 0.0),
            "cross": np.where(of_affected, -random2 * flow.real * flow.imag, 0.0),
        }  # fmt: skip
        for k, mode in enumerate(modes):
            columns[f"mode{k}"] = flow * np.nan_to_num(mode)[:, None] * self.errors.shares[sources, k]
        for s in range(len(self.errors.shares)):
            columns[f"source{s}"] = (there & (piece.source == s)).astype(float)
        squared = {"weight2": columns["weight"], "noise": np.where(there, piece.noise, 0.0)}
        plain = {"count": there.astype(int), "cells": np.where(there, piece.cells.count, 0)}
        worst, shape = np.where(there & (quality != INTERPOLATED), quality, 0), (int(self.days[-1]) + 1, there.shape[1])
        noon_s = DAY_S * (np.floor(self.axes.time_s[:1] / DAY_S) + 0.5 + self.days[piece.slots])
        for shift in (-1, 0, 1) if self.running_h else (0,):
            lag = self.axes.time_s[piece.slots] - noon_s - DAY_S * shift
            weight = np.interp(lag, *self.kernel, left=0.0, right=0.0)[:, None]
            day = self.days[piece.slots] + shift
            inside = np.flatnonzero((day >= 0) & (day <= self.days[-1]) & (weight[:, 0] > 0.0))
            if not len(inside):
                continue
            begin = np.flatnonzero(np.diff(day[inside], prepend=-1))
            rows = day[inside][begin]
            for factor, group in ((weight, columns), (weight**2, squared), (1, plain)):
                for name, values in group.items():
                    total = self.sums.setdefault(name, np.zeros(shape, dtype=values.dtype))
                    total[rows] += np.add.reduceat((factor * values)[inside], begin, axis=0)
            total = self.sums.setdefault("worst", np.zeros(shape, dtype=np.int8))
            total[rows] = np.maximum(total[rows], np.maximum.reduceat(worst[inside], begin, axis=0))

    def means(self, product: GriddedProduct) -> Daily:
        """Compute the means; errors common to the velocities of a mean are not reduced by averaging.

        A mean needs half of a day's times, except for profilers; a filter needs 0.99 of its weights, as a missing hour
        brings back tides.
        """
        axes, sums, depths = self.axes, self.sums, len(self.axes.depth_m)
        if not sums:
            nothing, count = np.zeros(0), np.zeros((0, depths), dtype=int)
            return Daily(nothing, empty_piece(depths, False), self.errors, product.deviation_deg, count, nothing)
        count, weight = sums["count"], sums["weight"]
        per_source = np.array([sums[f"source{s}"] for s in range(len(self.errors.shares))])
        source = np.argmax(per_source, axis=0)
        moving = np.array([s.profiles for s in product.sources])[source]
        lags, weights = self.kernel
        expected = float(np.trapezoid(weights, lags)) / axes.step_s
        enough = weight >= 0.99 * expected if self.running_h else moving | (weight >= 0.5 * expected)
        there = (count > 0) & enough
        safe = np.where(there, weight, 1.0)
        number = safe**2 / np.where(there, sums["weight2"], 1.0)  # of equally weighted times with the same variance
        flow = np.where(there, sums["flow"] / safe, NONE)
        remembered = mean_factor(number, self.errors.memory_s / axes.step_s) / safe
        variances = [sums[name] * remembered for name in ("east2", "north2", "cross")]
        for k in range(len(self.errors.modes)):
            turned = sums[f"mode{k}"] / safe
            squares = turned.imag**2, turned.real**2, -turned.real * turned.imag
            for variance, square in zip(variances, squares, strict=True):
                variance += square
        # Missing times are no random sample: they are consecutive, and the current sets the depth of a sphere. Their
        # velocities differ from the rest of the day as those six hours apart.
        apart = float(product.learnt[0].by_time.at(np.array([6 * HOUR_S]))[0])
        missing = 0.5 * np.maximum(1.0 - weight / expected, 0.0) ** 2 * apart  # means differ less than single values
        spread = sums["spread"] / safe * mean_factor(number, product.memory_s / axes.step_s) + missing
        noise = sums["noise"] / safe**2
        quality = np.where(sums["interpolated"] > 0.5 * weight, INTERPOLATED, np.maximum(sums["worst"], 1))
        quality = np.where(there, quality, MISSING).astype(np.int8)
        blank = empty_cells(len(count), slice(0, depths), False)
        cells = replace(blank, velocity=flow, quality=quality, count=sums["cells"].astype(np.int32))
        east, north, cross = (np.where(there, v, np.nan) for v in variances)
        piece = Piece(
            slice(0, len(count)), cells, np.where(there, source, -1), quality, east + noise + spread,
            north + noise + spread, cross, noise, spread,
        )  # fmt: skip
        days, size = self.days, len(count)

        def mean(rows: Floats) -> Floats:
            """Average each row by day, (k, d)."""
            means = np.full((len(rows), size), np.nan)
            for series, of_days in zip(rows, means, strict=True):
                known = np.isfinite(series)
                n = np.bincount(days[known], minlength=size)
                of_days[n > 0] = (np.bincount(days[known], series[known], size) / np.maximum(n, 1))[n > 0]
            return means

        per_day = mean_factor(np.bincount(days, minlength=size), self.errors.memory_s / axes.step_s)
        random = np.sqrt(mean(self.errors.random**2) * per_day)
        sine, cosine = map(mean, angles.sin_cos(product.deviation_deg))
        return Daily(
            DAY_S * (np.floor(axes.time_s[0] / DAY_S) + np.arange(size) + 0.5), piece,
            replace(self.errors, modes=mean(self.errors.modes), random=random),
            np.asarray(angles.wrap180(angles.direction(sine, cosine))), np.where(there, count, 0).astype(int),
            np.exp(-0.5 * mean(self.errors.variance(0)[None])[0]),
        )  # fmt: skip
