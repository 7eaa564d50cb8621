"""Disturbance of a declination and its storms, over three hours as the index K has it (Bartels et al. 1939)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, earthfield
from compasslib.observatory.course import DAY_S, HOUR_S
from compasslib.records import EarthField, FieldSeries

Floats = NDArray[np.floating]
Flags = NDArray[np.bool_]
Measures = tuple[float, float, float, float]  # of a storm: begin, end, rms and rms of its worst three hours

WINDOW_S = 3 * HOUR_S
FULL = 0.5  # share of the means that a window needs
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


def strongest(time_s: Floats, off_deg: Floats) -> tuple[float, float]:
    """Return first and last instant of the strongest disturbance; of the record where it is disturbed throughout.

    Args:
        time_s: increasing times, (n,).
        off_deg: (n,), degrees.
    """
    size, _ = worst(time_s, off_deg)
    at = np.flatnonzero(size >= HALF * size.max())
    groups = np.split(at, np.flatnonzero(np.diff(time_s[at]) > APART_S) + 1)
    one = next(group for group in groups if np.argmax(size) in group)
    if len(groups) > MOST_STRETCHES or not size.max():
        return float(time_s[0]), float(time_s[-1])
    clear = one[np.abs(off_deg[one]) >= QUARTER * np.abs(off_deg[one]).max()]
    return float(time_s[clear[0]]), float(time_s[clear[-1]])


def worst(time_s: Floats, off_deg: Floats) -> tuple[Floats, Floats]:
    """Return the rms of the three hours around each mean, and the same without its largest value, (n,) each.

    Args:
        time_s: increasing times, (n,).
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
        time_s: increasing times, (n,).
        off: what level and quiet day leave, (n,), degrees.
        limit_deg: rms over three hours from which a disturbance is a storm.
    """
    size, besides = worst(time_s, off)
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


def _grown(time_s: Floats, core: Flags, reach_s: float) -> Flags:
    """Return the means within a reach of those of the core."""
    at = time_s[core]
    if not len(at):
        return core
    near = np.clip(np.searchsorted(at, time_s), 1, len(at)) if len(at) > 1 else np.ones(len(time_s), dtype=int)
    before, after = at[near - 1], at[np.minimum(near, len(at) - 1)]
    return np.minimum(np.abs(time_s - before), np.abs(after - time_s)) <= reach_s


def measured(series: FieldSeries, model: EarthField, measures: Measures) -> Storm:
    """Return a storm with the range of the samples in it.

    Args:
        series: of an observatory.
        model: declination along time.
        measures: of the storm.
    """
    begin_s, end_s, rms_deg, worst_deg = measures
    inside = (series.time_s >= begin_s) & (series.time_s <= end_s)
    off = angles.difference(series.declination_deg, earthfield.declination_at(model, series.time_s))[inside]
    return Storm(begin_s, end_s, float(np.nanmax(off) - np.nanmin(off)), rms_deg, worst_deg)
