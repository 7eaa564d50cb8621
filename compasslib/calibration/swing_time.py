"""Where in time and on the circle a swing's observations lie: blocks, means over half a minute, repeated headings."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration.swing_data import Observations

Floats = NDArray[np.floating]

BLOCK_S = 20.0  # over which residuals are averaged to find how alike they are
SMOOTHED_S = 30.0
HEADING_GAP_DEG = 2.0  # headings less apart are one heading, repeated


def smoothed(values: Floats, seen: Observations) -> Floats:
    """Return values averaged over half a minute of a log, (n,); as they are without times.

    Args:
        values: (n,).
        seen: observations in order of time.
    """
    if not seen.timed:
        return values
    first = np.searchsorted(seen.time_s, seen.time_s - SMOOTHED_S / 2.0, side="left")
    last = np.searchsorted(seen.time_s, seen.time_s + SMOOTHED_S / 2.0, side="right")
    total = np.append(0.0, np.cumsum(values))
    return (total[last] - total[first]) / (last - first)


def since_middle(seen: Observations) -> Floats:
    """Return time from -1/2 to 1/2 of the swing, (n,); 0 without times.

    Args:
        seen: observations in order of time.
    """
    if not seen.timed:
        return np.zeros(len(seen))
    first, last = seen.time_s.min(), seen.time_s.max()
    return (seen.time_s - (first + last) / 2.0) / max(last - first, 1.0)


def blocks_of(seen: Observations) -> NDArray[np.int_]:
    """Return the number of each sample's block of 20 s, (n,), empty blocks not counted.

    Args:
        seen: observations in order of time.
    """
    block = np.floor((seen.time_s - seen.time_s[0]) / BLOCK_S)
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
