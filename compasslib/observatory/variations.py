"""Variations of a declination: means, the median day, the departure from the secular variation, and storms.

Disturbance is measured over three hours, as the index K has it (Bartels et al. 1939).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, earthfield
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries
from compasslib.types import Floats

Flags = NDArray[np.bool_]
DAY_S, HOUR_S = 86400.0, 3600.0
FULL = 0.5  # share of the samples that a mean needs
MONTH_DAYS = 27  # a rotation of the sun
Measures = tuple[float, float, float, float]  # of a storm: begin, end, rms and rms of its worst three hours
WINDOW_S = 3 * HOUR_S
APART_S = 24 * HOUR_S  # windows that are farther apart are storms of their own
BESIDES = 0.5  # of the limit: what a window must hold besides its largest value, else that one is a spike
HALF, QUARTER, MOST_STRETCHES = 0.5, 0.25, 12  # of the largest; more stretches than these are no storm but a habit
ORDINARY, FEWEST_DAYS = 3.0, 5  # times the record's own middle disturbance that a storm must exceed, if it has days


@dataclass(frozen=True)
class Storm:
    """A stretch of disturbance."""

    begin_s: float
    end_s: float
    range_deg: float  # of the declination, highest minus lowest sample
    rms_deg: float  # over its disturbed hours
    worst_deg: float  # rms of its worst three hours


def means(series: FieldSeries, step_s: float) -> tuple[Floats, Floats]:
    """Return times and declinations averaged over steps, those with too few samples left out; coarser ones as they are.

    Args:
        step_s: seconds.
    """
    known = np.isfinite(series.declination_deg)
    time_s, declination = series.time_s[known], series.declination_deg[known]
    own = float(np.median(np.diff(series.time_s))) if len(series) > 1 else step_s
    if own > FULL * step_s or not len(time_s):
        return time_s, declination
    number = np.floor(time_s / step_s)
    slots, which, count = np.unique(number, return_inverse=True, return_counts=True)
    middle = declination[0]
    mean = middle + np.bincount(which, angles.difference(declination, middle)) / count
    full = count * own >= FULL * step_s
    return (slots[full] + 0.5) * step_s, angles.wrap180(mean[full])


def departure(series: FieldSeries, time_s: Floats) -> Floats:
    """Return how far magnetic north stood from its slow course at given instants, (n,) degrees, NaN where unknown.

    Hourly means of the declination minus the median of the 27 days around: storms and daily variation remain, the
    secular variation and the rocks' constant go. That is the covariate of ``field_disturbance``.

    Args:
        time_s: (n,), UTC seconds.
    """
    known = np.flatnonzero(np.isfinite(series.declination_deg))
    first = series.declination_deg[known[0]] if len(known) else 0.0
    return _from_slow_course(series.time_s, angles.difference(series.declination_deg, first), time_s)


def lengthening(series: FieldSeries, time_s: Floats) -> Floats:
    """Return the same of the horizontal field along magnetic north, over its own strength, (n,) degrees.

    Elsewhere, where magnetic north points otherwise, it is across the needle.

    Args:
        time_s: (n,), UTC seconds.
    """
    off = _from_slow_course(series.time_s, series.horizontal_nT, time_s)
    return np.asarray(off / (np.nanmedian(series.horizontal_nT) if np.isfinite(off).any() else 1.0) / angles.DEGREE)


def _from_slow_course(every_s: Floats, every: Floats, time_s: Floats) -> Floats:
    """Return hourly means of a series minus the median of the 27 days around, (n,), NaN where unknown."""
    known = np.isfinite(every)
    own, off = every_s[known], every[known]
    if not len(own):
        return np.full(len(time_s), np.nan)
    first, last = (np.searchsorted(own, time_s + side) for side in (-HOUR_S / 2.0, HOUR_S / 2.0))
    total = np.concatenate([[0.0], np.cumsum(off)])
    step = float(np.median(np.diff(own))) if len(own) > 1 else HOUR_S
    enough = (last - first) >= max(FULL * HOUR_S / step, 1.0)
    mean = np.where(enough, (total[last] - total[first]) / np.maximum(last - first, 1), np.nan)
    return np.asarray(mean - _slow_course(own, off, time_s))


def covariates(files: Sequence[str | Path], time_s: Floats) -> tuple[Floats, Floats]:
    """Return what the files of an observatory give a mooring's search: across and along its magnetic north, degrees.

    Args:
        files: IAGA-2002 files of one observatory.
        time_s: (n,) of the mooring, UTC seconds.

    Raises:
        InputError: a file cannot be read.
    """
    series = iaga2002.read(files)
    return departure(series, time_s), lengthening(series, time_s)


def daily_curve_at(curve_deg: Floats, time_s: Floats) -> Floats:
    """Return a daily curve at given instants, (n,) degrees, 0 where it is not known.

    Args:
        curve_deg: (24,) at the half hours of UTC.
        time_s: (n,), UTC seconds.
    """
    if not np.isfinite(curve_deg).all():
        return np.zeros(len(time_s))
    hour = (time_s / HOUR_S) % 24.0
    return np.interp(hour, np.arange(24) + 0.5, curve_deg, period=24.0)


def hourly_median(time_s: Floats, off: Floats, chosen: Flags) -> Floats:
    """Return the median of the hourly means by hour of the day, (24,), about its median; NaN where an hour is missing.

    Args:
        off: (n,), degrees.
        chosen: which count, (n,).
    """
    hours, which = np.unique(np.floor(time_s[chosen] / HOUR_S), return_inverse=True)
    if not len(hours):
        return np.full(24, np.nan)
    mean = np.bincount(which, off[chosen]) / np.bincount(which)
    clock = (hours % 24).astype(int)
    if len(np.unique(clock)) < 24:
        return np.full(24, np.nan)
    curve = np.array([np.median(mean[clock == k]) for k in range(24)])
    return curve - np.median(curve)


def strongest_disturbance(time_s: Floats, off_deg: Floats) -> tuple[float, float]:
    """Return first and last instant of the strongest disturbance; of the record where it is disturbed throughout.

    Args:
        off_deg: (n,), degrees.
    """
    size, _ = three_hour_rms(time_s, off_deg)
    at = np.flatnonzero(size >= HALF * size.max())
    groups = np.split(at, np.flatnonzero(np.diff(time_s[at]) > APART_S) + 1)
    one = next(group for group in groups if np.argmax(size) in group)
    if len(groups) > MOST_STRETCHES or not size.max():
        return float(time_s[0]), float(time_s[-1])
    clear = one[np.abs(off_deg[one]) >= QUARTER * np.abs(off_deg[one]).max()]
    return float(time_s[clear[0]]), float(time_s[clear[-1]])


def three_hour_rms(time_s: Floats, off_deg: Floats) -> tuple[Floats, Floats]:
    """Return the rms of the three hours around each mean, and the same without its largest value, (n,) each.

    Args:
        off_deg: (n,), degrees.
    """
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else HOUR_S
    slot = np.rint((time_s - time_s[0]) / step).astype(np.intp)
    half = max(int(WINDOW_S / step) // 2, 1)
    gaps = np.concatenate([[0], np.cumsum(np.minimum(np.diff(slot), 4 * half))])  # years of nothing cost nothing
    grid = np.full(gaps[-1] + 1 + 2 * half, np.nan)
    grid[half + gaps] = off_deg**2
    windows = np.lib.stride_tricks.sliding_window_view(grid, 2 * half + 1)[gaps]
    count = np.sum(np.isfinite(windows), axis=1)
    total, most = np.nansum(windows, axis=1), np.nanmax(windows, axis=1)
    full = count >= FULL * (2 * half + 1)
    return (
        np.where(full, np.sqrt(total / count), 0.0),
        np.where(full, np.sqrt(np.maximum(total - most, 0.0) / np.maximum(count - 1, 1)), 0.0),
    )


def storms(
    time_s: Floats, off: Floats, limit_deg: float
) -> tuple[Flags, list[tuple[float, float, float, float]], float, int]:
    """Return the disturbed means, each storm's measures, the ordinary disturbance, and the number of spikes.

    Args:
        off: what level and quiet day leave, (n,), degrees.
        limit_deg: rms over three hours from which a disturbance is a storm.
    """
    size, besides = three_hour_rms(time_s, off)
    ordinary = float(np.median(size)) if np.ptp(time_s) >= FEWEST_DAYS * DAY_S else 0.0
    limit = max(limit_deg, ORDINARY * ordinary)
    core = (size >= limit) & (besides >= BESIDES * limit)
    spikes = int(np.sum((size >= limit) & ~core & (np.abs(off) >= limit)))
    stormy = _grown(time_s, core, WINDOW_S / 2.0)
    at = np.flatnonzero(stormy & (np.abs(off) >= BESIDES * limit))
    groups = np.split(at, np.flatnonzero(np.diff(time_s[at]) > APART_S) + 1) if len(at) else []
    half = float(np.median(np.diff(time_s))) / 2.0
    storms = [
        (
            time_s[g[0]] - half,
            time_s[g[-1]] + half,
            angles.rms(off[g[0] : g[-1] + 1][stormy[g[0] : g[-1] + 1]]),
            float(size[g].max()),
        )
        for g in groups
    ]
    return stormy, storms, ordinary, spikes


def measured(series: FieldSeries, model: EarthField, measures: Measures) -> Storm:
    """Return a storm with the range of the samples in it."""
    begin_s, end_s, rms_deg, worst_deg = measures
    inside = (series.time_s >= begin_s) & (series.time_s <= end_s)
    off = angles.difference(series.declination_deg, earthfield.declination_at(model, series.time_s))[inside]
    return Storm(begin_s, end_s, float(np.nanmax(off) - np.nanmin(off)), rms_deg, worst_deg)


def _slow_course(own_s: Floats, off: Floats, time_s: Floats) -> Floats:
    """Return the running median of daily medians over 27 days at given instants."""
    days, begins = np.unique(np.floor(own_s / DAY_S), return_index=True)
    levels = np.array([np.median(part) for part in np.split(off, begins[1:])])
    reach = MONTH_DAYS // 2
    ends = zip(np.searchsorted(days, days - reach), np.searchsorted(days, days + reach, side="right"), strict=True)
    course = np.array([np.median(levels[a:b]) for a, b in ends])
    return np.interp(time_s, (days + 0.5) * DAY_S, course)


def _grown(time_s: Floats, core: Flags, reach_s: float) -> Flags:
    """Return the means within a reach of those of the core."""
    at = time_s[core]
    if not len(at):
        return core
    near = np.clip(np.searchsorted(at, time_s), 1, len(at)) if len(at) > 1 else np.ones(len(time_s), dtype=int)
    before, after = at[near - 1], at[np.minimum(near, len(at) - 1)]
    return np.minimum(np.abs(time_s - before), np.abs(after - time_s)) <= reach_s
