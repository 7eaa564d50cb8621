"""Score tests of many groups of columns at once, against what the record's own noise makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib.core.types import Floats
from compasslib.search import columns, dispersion
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.stats.whitening import directions, inverse

DATE_HANDICAP = 0.4  # score taken off each of many dates, so that they do not raise the bar for the other terms
NINE_IN_TEN = 1.28  # normal score of it
WORTH_A_LOOK = 2.5  # score from which on a term is held against such water


@dataclass(frozen=True)
class Tested:
    """Groups of columns with their statistics under the data and under the record's own noise."""

    groups: list[Group]
    freedom: Floats  # (g,) directions of each group
    inflation: Floats  # (g,) mean statistic of the noise over the freedom
    score: Floats  # (g,) normal score of each group's statistic
    highest: Floats  # (r,) highest normal score of each draw of the noise
    before: Mapping[type, float] = field(default_factory=dict)  # inflation of terms that were tested before these

    @property
    def usual(self) -> dict[type, float]:
        """Middle inflation of each term, of now or of when it was tested last."""
        now: dict[type, list[float]] = {}
        for group, inflation in zip(self.groups, self.inflation, strict=True):
            now.setdefault(type(group.term), []).append(float(inflation))
        return {**self.before, **{kind: float(np.median(each)) for kind, each in now.items()}}

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
    bases = [directions(_beyond_prior(state, group, part)) for group, part in zip(groups, parts, strict=True)]
    kept = [k for k, basis in enumerate(bases) if basis.shape[1]]
    groups, bases = [groups[k] for k in kept], [bases[k] for k in kept]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    every = np.concatenate(bases, axis=1)
    seen = np.add.reduceat((every.T @ state.innovation) ** 2, begins) / state.sigma**2
    noise = np.add.reduceat((dispersion.resampled(state, seed) @ every) ** 2, begins, axis=1) / state.sigma**2
    inflation = noise.mean(axis=0) / freedom
    handicap = np.array([_handicap(group) for group in groups])
    highest = (normal_score(noise / inflation, freedom) - handicap).max(axis=1)
    uneven = np.array([dispersion.uneven(state, basis) for basis in bases])
    inflation = np.maximum(np.maximum(inflation, uneven), 1.0) * dispersion.slow(state, every, begins, freedom)
    score = normal_score(seen / inflation, freedom) - handicap
    looked = [k for k, group in enumerate(groups) if score[k] > WORTH_A_LOOK and group.term is not None]
    inflation[looked] *= dispersion.by_water(state, [groups[k] for k in looked])
    inflation = np.maximum(inflation, dispersion.usual(groups, inflation))
    return Tested(groups, freedom, inflation, normal_score(seen / inflation, freedom) - handicap, highest)


def size_of(state: State, group: Group, inflation: float) -> float:
    """Return the visible size of a group's best fit, rms degrees, freed of what noise adds to it."""
    values, covariance = solved(state, group)
    seen = state.visible(group.columns)
    product = seen.T @ seen / len(seen)
    return float(np.sqrt(max(float(values @ product @ values) - inflation * float(np.sum(product * covariance)), 0.0)))


def detectable(state: State, tested: Tested, threshold: float) -> dict[str, float]:
    """Return for each effect the visible size that would have been named nine times in ten, rms degrees.

    Of an effect with several forms or dates it is the middle one.

    Args:
        threshold: score that noise hardly exceeds.
    """
    taken = tuple(map(type, state.simulation.terms))
    some = [(g, i) for g, i in zip(tested.groups, tested.inflation, strict=True) if not isinstance(g.term, taken)]
    if not some:
        return {}
    columns_deg = np.concatenate([group.columns for group, _ in some], axis=1)
    ends = np.cumsum([group.columns.shape[1] for group, _ in some])[:-1]
    whites, seens = (np.split(x, ends, axis=1) for x in (state.projected(columns_deg), state.visible(columns_deg)))
    sizes: dict[str, list[float]] = {}
    for (group, inflation), white, seen in zip(some, whites, seens, strict=True):
        # visible size of a unit of the whitened columns, as a mean over the group's directions
        unit = np.trace(inverse(white.T @ white + ridge(state, group)) @ (seen.T @ seen)) / len(seen) / white.shape[1]
        noise = state.sigma / state.response * np.sqrt(inflation)
        sizes.setdefault(group.name, []).append((threshold + NINE_IN_TEN) * noise * float(np.sqrt(unit)))
    return {name: float(np.median(size)) for name, size in sizes.items()}


def solved(state: State, group: Group) -> tuple[Floats, Floats]:
    """Return the values of columns fitted to the residual, and their covariance."""
    white = state.projected(group.columns)
    inverted = inverse(white.T @ white + ridge(state, group))
    return inverted @ (white.T @ state.innovation) / state.response, inverted * (state.sigma / state.response) ** 2


def ridge(state: State, group: Group) -> Floats:
    """Return the prior precision of a group's values, to be added to products of whitened columns, (k, k)."""
    return np.diag(np.zeros(group.columns.shape[1]) if group.term is None else state.ridge([group.term]))


def _beyond_prior(state: State, group: Group, white: Floats) -> Floats:
    """Return a group's whitened columns without the directions of which the record tells less than the prior."""
    known = np.diag(ridge(state, group))
    if not known.any():
        return white
    unit = white / np.sqrt(known)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    return unit @ vectors[:, values > 1.0].astype(white.dtype)


def beside(state: State, columns_deg: Floats) -> State:
    """Return the state with further columns fitted beside its base.

    Args:
        columns_deg: (n, k), degrees a unit.
    """
    more = directions(state.projected(columns_deg.astype(np.float32)))
    innovation = state.innovation - more @ (more.T @ state.innovation)
    return replace(state, basis=np.concatenate([state.basis, more], axis=1), innovation=innovation)


def gains(state: State, groups: Sequence[Group]) -> Floats:
    """Return the statistic of each group of columns, about its freedom where there is nothing, (g,)."""
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1))
    parts = np.split(white, np.cumsum([group.columns.shape[1] for group in groups])[:-1], axis=1)
    pulls = [part.T @ state.innovation for part in parts]
    each = [pull @ inverse(part.T @ part) @ pull for part, pull in zip(parts, pulls, strict=True)]
    return np.array(each) / state.sigma**2


def _handicap(group: Group) -> float:
    dated = group.name == columns.SPELL if group.term is None else group.term.dated()
    return DATE_HANDICAP * dated


def normal_score(statistic: Floats, freedom: Floats) -> Floats:
    """Return the normal score of a chi-squared statistic (Wilson and Hilferty, PNAS 17, 684, 1931).

    Args:
        statistic: (..., g).
        freedom: (g,).
    """
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt(np.maximum(statistic, 0.0) / freedom) - 1.0 + spread) / np.sqrt(spread)
