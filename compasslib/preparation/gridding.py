"""Selection of samples on a regular time grid, and interpolation of series, (n,), to given times, (k,)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Floats

Indices = NDArray[np.intp]


def nearest_index(series_s: Floats, at_s: Floats) -> Indices:
    """Find the index of the sample nearest to each time, (k,); the series must not be empty."""
    right = np.clip(np.searchsorted(series_s, at_s), 1, max(len(series_s) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(series_s) - 1)
    return np.where(at_s - series_s[left] <= series_s[right] - at_s, left, right)


def grid_indices(time_s: Floats, *, step_s: float, tolerance_s: float) -> Indices:
    """Select the samples nearest to the nodes of a regular grid, within a tolerance and without repetition.

    The grid adopts the sampling phase of the series, so that an hourly record is its own grid. Headings are never
    interpolated: a compass near iron has no meaningful value between two recorded ones.
    """
    if not len(time_s):
        return np.zeros(0, dtype=np.intp)
    phase = common_phase(time_s, step_s)
    first = np.floor((time_s[0] - phase) / step_s)
    nodes = phase + step_s * np.arange(first, np.ceil((time_s[-1] - phase) / step_s) + 1)
    index = nearest_index(time_s, nodes)
    return np.unique(index[np.abs(time_s[index] - nodes) <= tolerance_s])


def interpolate_series(series_s: Floats, values: NDArray, at_s: Floats, *, tolerance_s: float) -> NDArray:
    """Interpolate real or complex values linearly across gaps up to twice the tolerance, else take the nearest.

    The result is NaN where the nearest sample is farther than the tolerance.
    """
    if not len(series_s):
        return np.full(len(at_s), np.nan, dtype=values.dtype)
    near = nearest_index(series_s, at_s)
    right = np.clip(np.searchsorted(series_s, at_s), 1, max(len(series_s) - 1, 1))
    right, left = np.minimum(right, len(series_s) - 1), right - 1
    gap = series_s[right] - series_s[left]
    bridged = (gap > 0) & (gap <= 2.0 * tolerance_s) & (at_s >= series_s[left]) & (at_s <= series_s[right])
    weight = np.where(bridged, (at_s - series_s[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    linear = values[left] * (1.0 - weight) + values[right] * weight
    taken = np.where(bridged, linear, values[near])
    return np.where(np.abs(series_s[near] - at_s) <= tolerance_s, taken, np.nan)


def common_phase(time_s: Floats, step_s: float) -> float:
    """Estimate the common phase of the samples within a step, seconds."""
    turn = np.exp(2j * np.pi * (time_s % step_s) / step_s)
    mean = turn.mean()
    if abs(mean) < 0.1:  # sampled several times per step: no common phase
        return 0.0
    return float(np.angle(mean) / (2 * np.pi) * step_s)
