"""By how much the record's own noise inflates a score test's statistic: uneven, or slow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.core import angles
from compasslib.core.types import Floats
from compasslib.search import baseline, show
from compasslib.search.baseline import State
from compasslib.stats import blocks
from compasslib.stats.whitening import directions

REPEATS = 300  # draws of noise, which set how well the alarm of the omnibus is known
SLOW, WEEKLY = (400.0, 14.0), (14.0, 5.0)  # longest and shortest periods, days
FEWEST_WAVES = 8  # below which their mean power is not known within a half
TRIMMED, MEAN_OF_TRIMMED = 0.95, 0.759  # share of the smallest of chi-squared values that are kept, and their mean


def resampled(state: State, seed: int, repeats: int = REPEATS) -> Floats:
    """Return draws of the record's own noise: blocks of days of its innovations at other dates, turned at random.

    What changes over weeks is taken out first: a real drift must not raise the bar for itself.
    """
    counts = np.isfinite(state.whitener.width_deg)
    trend = directions(state.projected(baseline.trend(state.case.scene.time_s).astype(np.float32)))
    innovation = (state.innovation - trend @ (trend.T @ state.innovation))[counts].astype(np.float32)
    rng, n = np.random.default_rng(seed), len(innovation)
    step = float(np.median(np.diff(state.case.scene.time_s)))
    length = int(np.clip(show.BLOCK_S / step, 5, max(n // 10, 5)))
    blocks = -(-n // length)
    begin = rng.integers(0, n, (repeats, blocks))
    sign = rng.choice([-1.0, 1.0], (repeats, blocks)).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([innovation, innovation]), length)
    result = np.zeros((repeats, len(counts)), dtype=np.float32)
    result[:, counts] = (windows[begin] * sign[:, :, None]).reshape(repeats, -1)[:, :n]
    return result


def uneven(state: State, basis: Floats) -> float:
    """Return what the noise makes of a group's statistic where the group weighs most, 1 where noise is even.

    Real water scatters more in some weeks and at some headings than speeds tell. The group's own fit is taken out, and
    the scores of blocks of days are squared as they are (a sandwich by clusters; Liang and Zeger, Biometrika 73, 1986).

    Args:
        basis: the group's whitened columns, orthonormal, (n, k).
    """
    block = blocks.of_span(state.case.scene.time_s, show.MEMORY_S)
    left = state.innovation - basis @ (basis.T @ state.innovation)
    sums = blocks.sums(basis * left[:, None], block)
    return float(np.sum(sums**2)) / basis.shape[1] / state.sigma**2 * len(sums) / max(len(sums) - 1, 1)


def slow(state: State, every: Floats, begins: NDArray[np.intp], freedom: Floats) -> Floats:
    """Return by how much each group's statistic is inflated by slow changes that the filter and the blocks do not hold.

    Water veers for weeks. What the record holds at periods of about a week, beyond white noise, is taken for the noise
    of every group as far as the group is slow itself; drifts, steps and seasons hardly reach to such short periods.

    Args:
        every: orthonormal whitened columns of all groups, (n, k).
        begins: first column of each group, (g,).
        freedom: number of columns of each group, (g,).
    """
    days = float(np.ptp(state.case.scene.time_s)) / 86400.0
    monthly, weekly = (np.arange(int(days / longest), int(days / shortest) + 1) for longest, shortest in (SLOW, WEEKLY))
    if len(weekly) < FEWEST_WAVES:
        return np.ones(len(freedom))
    heard = _waves(state, weekly)
    power = np.sort((heard.T @ state.innovation) ** 2)[: round(TRIMMED * heard.shape[1])] / state.sigma**2
    excess = float(power.mean()) / MEAN_OF_TRIMMED
    share = np.add.reduceat(np.sum((every.T @ _waves(state, monthly)) ** 2, axis=1), begins) / freedom
    return 1.0 + max(excess - 1.0, 0.0) * share


def _waves(state: State, number: NDArray[np.intp]) -> Floats:
    """Return an orthonormal basis of waves over the record, projected."""
    time_s = state.case.scene.time_s
    phase = 360.0 * (time_s - time_s[0])[:, None] / np.ptp(time_s) * np.maximum(number, 1)
    return directions(state.projected(np.column_stack(angles.sin_cos(phase)).astype(np.float32)))
