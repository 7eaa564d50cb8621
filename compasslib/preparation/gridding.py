"""The regular grid in time, and how a series, (n,) at increasing times, is taken to given instants, (k,)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Floats

Indices = NDArray[np.intp]


def nearest_index(series_s: Floats, at_s: Floats) -> Indices:
    """Find the position of the sample nearest to each instant; there is at least one."""
    right = np.clip(np.searchsorted(series_s, at_s), 1, max(len(series_s) - 1, 1))
    left = right - 1
    right = np.minimum(right, len(series_s) - 1)
    return np.where(at_s - series_s[left] <= series_s[right] - at_s, left, right)


def grid_indices(time_s: Floats, *, step_s: float, tolerance_s: float) -> Indices:
    """Select the samples that stand for the nodes of a regular grid, each once, none farther than the tolerance.

    The grid takes the sampling phase of the series itself, so that an hourly record is its own grid and no heading is
    ever interpolated: a compass near iron has no meaningful value between two recorded ones.
    """
    if not len(time_s):
        return np.zeros(0, dtype=np.intp)
    phase = common_phase(time_s, step_s)
    first = np.floor((time_s[0] - phase) / step_s)
    nodes = phase + step_s * np.arange(first, np.ceil((time_s[-1] - phase) / step_s) + 1)
    index = nearest_index(time_s, nodes)
    return np.unique(index[np.abs(time_s[index] - nodes) <= tolerance_s])


def interpolate_series(series_s: Floats, values: NDArray, at_s: Floats, *, tolerance_s: float) -> NDArray:
    """Interpolate real or complex values: linear inside gaps up to twice the tolerance, else the nearest.

    NaN stands where even that is farther than the tolerance.
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
    """Find the phase within a step at which most samples stand."""
    turn = np.exp(2j * np.pi * (time_s % step_s) / step_s)
    mean = turn.mean()
    if abs(mean) < 0.1:  # sampled several times a step: no phase of its own
        return 0.0
    return float(np.angle(mean) / (2 * np.pi) * step_s)
