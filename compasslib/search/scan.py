"""Score tests of many groups of columns at once, against what the record's own noise makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compasslib.core.types import Floats
from compasslib.search import columns, dispersion
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.stats.whitening import directions, inverse

DATE_HANDICAP = 0.4  # score taken off each of many dates, so that they do not raise the bar for the other terms


@dataclass(frozen=True)
class Tested:
    """Groups of columns with their statistics under the data and under the record's own noise."""

    groups: list[Group]
    freedom: Floats  # (g,) directions of each group
    inflation: Floats  # (g,) mean statistic of the noise over the freedom
    score: Floats  # (g,) normal score of each group's statistic
    highest: Floats  # (r,) highest normal score of each draw of the noise

    def threshold(self, alarm: float) -> float:
        """Return the score that noise exceeds anywhere with a given probability, as the highest of some normal scores.

        To how many independent ones the draws of the noise amount is fitted by likelihood. Gumbel's law, the limit
        of very many, is reached too slowly: it lets 2 in 1000 pass where it says 6.
        """
        from scipy.special import log_ndtr, ndtri_exp  # 0.2 s that jobs which only correct do not pay

        return float(ndtri_exp(np.log1p(-alarm) * -np.mean(log_ndtr(self.highest))))


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
    noise = np.add.reduceat((dispersion.resampled(state, seed) @ every) ** 2, begins, axis=1) / state.sigma**2
    inflation = noise.mean(axis=0) / freedom
    handicap = np.array([DATE_HANDICAP * (group.name == columns.SPELL) for group in groups])
    highest = (normal_score(noise / inflation, freedom) - handicap).max(axis=1)
    uneven = np.array([dispersion.uneven(state, basis) for basis in bases])
    inflation = np.maximum(np.maximum(inflation, uneven), 1.0) * dispersion.slow(state, every, begins, freedom)
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


def normal_score(statistic: Floats, freedom: Floats) -> Floats:
    """Return the normal score of a chi-squared statistic (Wilson and Hilferty, PNAS 17, 684, 1931).

    Args:
        statistic: (..., g).
        freedom: (g,).
    """
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt(np.maximum(statistic, 0.0) / freedom) - 1.0 + spread) / np.sqrt(spread)
