"""Where in time and on the circle a swing's observations lie: blocks, means, rates of turn, headings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]

BLOCK_S = 20.0  # over which residuals are averaged to find how alike they are
STEADY_S = 60.0  # a helmsman's wandering about the course is over in that time
APART_S = 30.0  # samples further apart do not hang together
HEADING_GAP_DEG = 2.0  # headings less apart are one heading, repeated


def smoothed(values: Floats, time_s: Floats, window_s: float) -> Floats:
    """Return values averaged over a window about each, (n,); as they are where a time is not known.

    Args:
        values: (n,).
        time_s: (n,) increasing.
        window_s: width.
    """
    if not np.isfinite(time_s).all():
        return values
    first = np.searchsorted(time_s, time_s - window_s / 2.0, side="left")
    last = np.searchsorted(time_s, time_s + window_s / 2.0, side="right")
    total = np.append(0.0, np.cumsum(values))
    return (total[last] - total[first]) / (last - first)


def settled(time_s: Floats, turned_deg: Floats, slow: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return the rate of turn, the slope over the minute about each, and headings averaged over 20 s, (n,) each.

    Where less than 20 s hang together it is the rate over the minute about each sample, and the heading as it was. A
    difference of readings would not do: a compass's noise stands in it and in the deviation, and looks like a delay.
    Nor would single readings as the place on the curve: water and compass are alike only on the same headings.

    Args:
        time_s: (n,) increasing.
        turned_deg: recorded headings, not wrapped, (n,).
        slow: which are not in a quick turn, (n,).
    """
    apart = (np.diff(time_s) > APART_S) | (np.diff(slow.astype(int)) != 0)
    ends = np.clip(np.stack([time_s - STEADY_S / 2.0, time_s + STEADY_S / 2.0]), time_s[0], time_s[-1])
    rate = np.diff(np.interp(ends, time_s, turned_deg), axis=0)[0] / np.maximum(np.diff(ends, axis=0)[0], 1.0)
    rate, mean = np.where(_often(time_s), rate, 0.0), turned_deg.copy()
    for run in np.split(np.arange(len(time_s)), np.flatnonzero(apart) + 1):
        if np.ptp(time_s[run]) >= BLOCK_S:
            rate[run], mean[run] = _in_one_run(time_s[run] - time_s[run[0]], turned_deg[run])
    return rate, mean


def _in_one_run(since_s: Floats, turned_deg: Floats) -> tuple[Floats, Floats]:
    """Return rate of turn and mean heading; near the ends the rate of the nearest minute that lies whole in the run."""
    at, on, square, both = (
        smoothed(x, since_s, STEADY_S)
        for x in (since_s, turned_deg - turned_deg[0], since_s**2, since_s * (turned_deg - turned_deg[0]))
    )
    slope = (both - at * on) / np.maximum(square - at**2, 1.0)
    half = min(STEADY_S, float(since_s[-1])) / 2.0
    rate = np.interp(np.clip(since_s, half, since_s[-1] - half), since_s, slope)
    return rate, smoothed(turned_deg, since_s, BLOCK_S) + rate * (since_s - smoothed(since_s, since_s, BLOCK_S))


def _often(time_s: Floats) -> bool:
    return bool(np.median(np.diff(time_s)) <= APART_S) if len(time_s) > 1 else False


def since_middle(time_s: Floats) -> Floats:
    """Return time from -1/2 to 1/2 of the swing, (n,); 0 where a time is not known.

    Args:
        time_s: (n,).
    """
    if not np.isfinite(time_s).all():
        return np.zeros(time_s.shape)
    first, last = time_s.min(), time_s.max()
    return (time_s - (first + last) / 2.0) / max(last - first, 1.0)


def blocks_of(time_s: Floats) -> NDArray[np.int_]:
    """Return the number of each sample's block of 20 s, (n,), empty blocks not counted.

    Args:
        time_s: (n,) increasing.
    """
    block = np.floor((time_s - time_s[0]) / BLOCK_S)
    return np.unique(block, return_inverse=True)[1]


def headings_of(recorded_deg: Floats) -> NDArray[np.int_]:
    """Return which heading each observation was taken on, (n,): repeated ones share a number.

    Args:
        recorded_deg: recorded headings, (n,).
    """
    order = np.argsort(recorded_deg, kind="stable")
    first = np.append(0.0, np.diff(recorded_deg[order])) > HEADING_GAP_DEG
    groups = np.empty(len(order), dtype=int)
    groups[order] = np.cumsum(first)
    if len(order) and recorded_deg[order[0]] + 360.0 - recorded_deg[order[-1]] <= HEADING_GAP_DEG:
        groups[groups == groups.max()] = 0
    return groups
