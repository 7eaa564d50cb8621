"""Score tests of many groups of columns at once, against what the record's own noise makes of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.inference import baseline, columns, show
from compasslib.inference.baseline import State
from compasslib.inference.omnibus import Group, Tested, normal_score
from compasslib.statistics import blocks
from compasslib.statistics.whitening import directions, inverse
from compasslib.types import Floats

REPEATS = 300  # draws of noise, which set how well the alarm of the omnibus is known
SLOW, WEEKLY = (400.0, 14.0), (14.0, 5.0)  # longest and shortest periods, days
FEWEST_WAVES = 8  # below which their mean power is not known within a half
TRIMMED, MEAN_OF_TRIMMED = 0.95, 0.759  # share of the smallest of chi-squared values that are kept, and their mean
DATE_HANDICAP = 0.4  # score taken off each of many spells, so that they do not raise the bar for the other groups


def test(state: State, groups: Sequence[Group], seed: int = 0) -> Tested:
    """Return the score tests of all groups."""
    groups = [group for group in groups if group.columns.shape[1]]
    ends = np.cumsum([group.columns.shape[1] for group in groups])
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1, dtype=np.float32))
    parts = np.split(white, ends[:-1], axis=1)
    bases = [directions(part) for part in parts]
    kept = [k for k, basis in enumerate(bases) if basis.shape[1]]
    groups, bases = [groups[k] for k in kept], [bases[k] for k in kept]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    every = np.concatenate(bases, axis=1)
    seen = np.add.reduceat((every.T @ state.innovation) ** 2, begins) / state.sigma**2
    noise = np.add.reduceat((_resampled(state, seed) @ every) ** 2, begins, axis=1) / state.sigma**2
    inflation = noise.mean(axis=0) / freedom
    handicap = np.array([DATE_HANDICAP * (group.name == columns.SPELL) for group in groups])
    highest = (normal_score(noise / inflation, freedom) - handicap).max(axis=1)
    uneven = np.array([_uneven(state, basis) for basis in bases])
    inflation = np.maximum(np.maximum(inflation, uneven), 1.0) * _slow(state, every, begins, freedom)
    return Tested(groups, freedom, inflation, normal_score(seen / inflation, freedom) - handicap, highest)


def size_of(state: State, group: Group, inflation: float) -> float:
    """Return the visible size of a group's best fit, rms degrees, freed of what noise adds to it."""
    values, covariance = solved(state, group)
    seen = state.visible(group.columns)
    product = seen.T @ seen / len(seen)
    return float(np.sqrt(max(float(values @ product @ values) - inflation * float(np.sum(product * covariance)), 0.0)))


def solved(state: State, group: Group) -> tuple[Floats, Floats]:
    """Return the values of columns fitted to the residual, and their covariance."""
    white = state.projected(group.columns)
    inverted = inverse(white.T @ white)
    return inverted @ (white.T @ state.innovation) / state.response, inverted * (state.sigma / state.response) ** 2


def _resampled(state: State, seed: int, repeats: int = REPEATS) -> Floats:
    """Return draws of the record's own noise: blocks of days of its innovations at other dates, turned at random.

    What changes over weeks is taken out first: a real drift must not raise the bar for itself.
    """
    counts = np.isfinite(state.whitener.width_deg)
    trend = directions(state.projected(baseline.trend(state.case.scene.time_s).astype(np.float32)))
    innovation = (state.innovation - trend @ (trend.T @ state.innovation))[counts].astype(np.float32)
    step = float(np.median(np.diff(state.case.scene.time_s)))
    length = int(np.clip(show.BLOCK_S / step, 5, max(len(innovation) // 10, 5)))
    result = np.zeros((repeats, len(counts)), dtype=np.float32)
    result[:, counts] = blocks.drawn(innovation, length, repeats, seed)
    return result


def _uneven(state: State, basis: Floats) -> float:
    """Return what the noise makes of a group's statistic where the group weighs most, 1 where noise is even.

    Real water scatters more in some weeks and at some headings than speeds tell. The group's own fit is taken out, and
    the scores of blocks of days are squared as they are (a sandwich by clusters; Liang and Zeger, Biometrika 73, 1986).

    Args:
        basis: the group's whitened columns, orthonormal, (n, k).
    """
    block = blocks.of_span(state.case.scene.time_s, show.MEMORY_S)
    scores = blocks.scores(basis, state.innovation, block)
    return float(np.sum(scores**2)) / basis.shape[1] / state.sigma**2 * len(scores) / max(len(scores) - 1, 1)


def _slow(state: State, every: Floats, begins: NDArray[np.intp], freedom: Floats) -> Floats:
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
