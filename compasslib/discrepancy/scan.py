"""Score tests of many groups of columns at once, against what the record's own noise makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.discrepancy import baseline, columns
from compasslib.discrepancy.baseline import State
from compasslib.discrepancy.columns import Group
from compasslib.discrepancy.whitening import inverse

Floats = NDArray[np.floating]

THINNEST = 1e-6  # share of a group's largest direction below which a direction is taken for absorbed by the base
BLOCK_S = 10 * 86400.0
CLUSTER_S = 2 * 86400.0  # longer than the memory that the filter leaves
REPEATS = 300
DATE_HANDICAP = 0.4  # score taken off each of many dates, so that they do not raise the bar for the other terms
SLOW, WEEKLY = (400.0, 14.0), (14.0, 5.0)  # longest and shortest periods, days
FEWEST_WAVES = 8
NINE_IN_TEN = 1.28  # normal score of it
WATERS = (2, 3, 4)  # harmonics of the heading that water's veer reaches and iron's change hardly does
TRUSTED = 6.0  # directions' worth of trust that there is no such water
WORTH_A_LOOK = 2.5  # score from which on a term is held against such water
MEDIAN_OF_CHI_SQUARED = 0.455  # of one degree of freedom


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

        To how many independent ones the draws of the noise amount is told by their likelihood. Gumbel's law, the limit
        of very many, is reached too slowly: it lets 2 in 1000 pass where it says 6.

        Args:
            alarm: the probability.
        """
        from scipy.special import log_ndtr, ndtri_exp  # 0.2 s that jobs which only correct do not pay

        return float(ndtri_exp(np.log1p(-alarm) * -np.mean(log_ndtr(self.highest))))


def test(state: State, groups: Sequence[Group], seed: int = 0) -> Tested:
    """Return the score tests of all groups.

    Args:
        state: the simulation where it stands.
        groups: columns to test.
        seed: of the draws.
    """
    groups = [group for group in groups if group.columns.shape[1]]
    ends = np.cumsum([group.columns.shape[1] for group in groups])
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1, dtype=np.float32))
    parts = np.split(white, ends[:-1], axis=1)
    bases = [directions(_told(state, group, part)) for group, part in zip(groups, parts, strict=True)]
    kept = [k for k, basis in enumerate(bases) if basis.shape[1]]
    groups, bases = [groups[k] for k in kept], [bases[k] for k in kept]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    every = np.concatenate(bases, axis=1)
    seen = np.add.reduceat((every.T @ state.innovation) ** 2, begins) / state.sigma**2
    noise = np.add.reduceat((resampled(state, seed) @ every) ** 2, begins, axis=1) / state.sigma**2
    inflation = noise.mean(axis=0) / freedom
    handicap = np.array([_handicap(group) for group in groups])
    highest = (normal_score(noise / inflation, freedom) - handicap).max(axis=1)
    uneven = np.array([_uneven(state, basis) for basis in bases])
    inflation = np.maximum(np.maximum(inflation, uneven), 1.0) * _slow_inflation(state, every, begins, freedom)
    score = normal_score(seen / inflation, freedom) - handicap
    looked = [k for k, group in enumerate(groups) if score[k] > WORTH_A_LOOK and group.term is not None]
    inflation[looked] *= water_inflation(state, [groups[k] for k in looked])
    inflation = np.maximum(inflation, _usual(groups, inflation))
    return Tested(groups, freedom, inflation, normal_score(seen / inflation, freedom) - handicap, highest)


def size_of(state: State, group: Group, inflation: float) -> float:
    """Return the visible size of a group's best fit, rms degrees, freed of what noise adds to it.

    Args:
        state: the simulation where it stands.
        group: columns.
        inflation: of the noise's statistic.
    """
    values, covariance = solved(state, group)
    seen = state.visible(group.columns)
    product = seen.T @ seen / len(seen)
    return float(np.sqrt(max(float(values @ product @ values) - inflation * float(np.sum(product * covariance)), 0.0)))


def detectable(state: State, tested: Tested, threshold: float) -> dict[str, float]:
    """Return for each effect the visible size that would have been named nine times in ten, rms degrees.

    Of an effect with several forms or dates it is the middle one.

    Args:
        state: the simulation where it stands.
        tested: the catalogue's groups, tested there.
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
    """Return the values of columns fitted to the residual, and their covariance.

    Args:
        state: the simulation where it stands.
        group: columns.
    """
    white = state.projected(group.columns)
    inverted = inverse(white.T @ white + ridge(state, group))
    return inverted @ (white.T @ state.innovation) / state.response, inverted * (state.sigma / state.response) ** 2


def ridge(state: State, group: Group) -> Floats:
    """Return what is believed of a group's values beforehand, to be added to products of whitened columns, (k, k).

    Args:
        state: the simulation where it stands.
        group: columns.
    """
    return np.diag(np.zeros(group.columns.shape[1]) if group.term is None else state.ridge([group.term]))


def _told(state: State, group: Group, white: Floats) -> Floats:
    """Return a group's whitened columns without the directions of which the record tells less than is known before."""
    known = np.diag(ridge(state, group))
    if not known.any():
        return white
    unit = white / np.sqrt(known)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    return unit @ vectors[:, values > 1.0].astype(white.dtype)


def beside(state: State, columns_deg: Floats) -> State:
    """Return the state with further columns fitted beside its base.

    Args:
        state: the simulation where it stands.
        columns_deg: (n, k), degrees a unit.
    """
    more = directions(state.projected(columns_deg.astype(np.float32)))
    innovation = state.innovation - more @ (more.T @ state.innovation)
    return replace(state, basis=np.concatenate([state.basis, more], axis=1), innovation=innovation)


def gains(state: State, groups: Sequence[Group]) -> Floats:
    """Return the statistic of each group of columns, about its freedom where there is nothing, (g,).

    Args:
        state: the simulation where it stands.
        groups: columns.
    """
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1))
    parts = np.split(white, np.cumsum([group.columns.shape[1] for group in groups])[:-1], axis=1)
    pulls = [part.T @ state.innovation for part in parts]
    each = [pull @ inverse(part.T @ part) @ pull for part, pull in zip(parts, pulls, strict=True)]
    return np.array(each) / state.sigma**2


def resampled(state: State, seed: int, repeats: int = REPEATS) -> Floats:
    """Return draws of the record's own noise: blocks of days of its innovations at other dates, turned at random.

    What changes over weeks is taken out first: a real drift must not raise the bar for itself.

    Args:
        state: the simulation where it stands.
        seed: of the draws.
        repeats: number of draws.
    """
    counts = np.isfinite(state.whitener.width_deg)
    trend = directions(state.projected(baseline.trend(state.case.scene.time_s).astype(np.float32)))
    innovation = (state.innovation - trend @ (trend.T @ state.innovation))[counts].astype(np.float32)
    rng, n = np.random.default_rng(seed), len(innovation)
    step = float(np.median(np.diff(state.case.scene.time_s)))
    length = int(np.clip(BLOCK_S / step, 5, max(n // 10, 5)))
    blocks = -(-n // length)
    begin = rng.integers(0, n, (repeats, blocks))
    sign = rng.choice([-1.0, 1.0], (repeats, blocks)).astype(np.float32)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([innovation, innovation]), length)
    result = np.zeros((repeats, len(counts)), dtype=np.float32)
    result[:, counts] = (windows[begin] * sign[:, :, None]).reshape(repeats, -1)[:, :n]
    return result


def _handicap(group: Group) -> float:
    dated = group.name == columns.SPELL if group.term is None else group.term.dated()
    return DATE_HANDICAP * dated


def _usual(groups: Sequence[Group], inflation: Floats) -> Floats:
    """Return the middle inflation of each term over its dates: the best of many dates is often that of a low estimate.

    Args:
        groups: columns.
        inflation: of each group, (g,).
    """
    kinds = [type(group.term) for group in groups]
    dated = [group.term is not None and group.term.dated() for group in groups]
    middle = {kind: np.median(inflation[[k is kind for k in kinds]]) for kind in set(kinds)}
    return np.array([middle[kind] if has else 0.0 for kind, has in zip(kinds, dated, strict=True)])


def _uneven(state: State, basis: Floats) -> float:
    """Return what the noise makes of a group's statistic where the group weighs most, 1 where noise is even.

    Real water scatters more in some weeks and at some headings than speeds tell. The group's own fit is taken out, and
    the scores of blocks of days are squared as they are (a sandwich by clusters; Liang and Zeger, Biometrika 73, 1986).
    """
    left = state.innovation - basis @ (basis.T @ state.innovation)
    time_s = state.case.scene.time_s
    starts = np.unique(np.floor((time_s - time_s[0]) / CLUSTER_S), return_index=True)[1]
    sums = np.add.reduceat(basis * left[:, None], starts, axis=0)
    return float(np.sum(sums**2)) / basis.shape[1] / state.sigma**2 * len(starts) / max(len(starts) - 1, 1)


def _slow_inflation(state: State, every: Floats, begins: NDArray[np.intp], freedom: Floats) -> Floats:
    """Return by how much each group's statistic is inflated by slow changes that the filter and the blocks do not hold.

    Water veers for weeks. What the record holds at periods of about a week, beyond white noise, is taken for the noise
    of every group as far as the group is slow itself; drifts, steps and seasons hardly reach to such short periods.
    """
    days = float(np.ptp(state.case.scene.time_s)) / 86400.0
    slow, weekly = (np.arange(int(days / longest), int(days / shortest) + 1) for longest, shortest in (SLOW, WEEKLY))
    if len(weekly) < FEWEST_WAVES:
        return np.ones(len(freedom))
    heard = _waves(state, weekly)
    excess = float(np.median((heard.T @ state.innovation) ** 2)) / state.sigma**2 / MEDIAN_OF_CHI_SQUARED
    share = np.add.reduceat(np.sum((every.T @ _waves(state, slow)) ** 2, axis=1), begins) / freedom
    return 1.0 + max(excess - 1.0, 0.0) * share


def water_inflation(state: State, groups: Sequence[Group]) -> Floats:
    """Return by how much the statistics of terms are inflated by water whose veer by direction changes as they do.

    A wake locks the heading to the flow, so that water which veers otherwise from some date on, or as it warms, feigns
    an instrument that changes. Such water does not stop at iron's first harmonic. What higher harmonics of the heading
    hold along the same change, beside the term itself, is therefore taken for noise of it.

    Args:
        state: the simulation where it stands.
        groups: columns of terms.
    """
    turning = np.column_stack([x for k in WATERS for x in angles.sin_cos(k * np.nan_to_num(state.heading_deg))])
    always, found = state.projected(turning.astype(np.float32)), np.ones(len(groups))
    for k, group in enumerate(groups):
        change = None if group.term is None else group.term.change(state.case.scene)
        if change is None:
            continue
        kept = directions(np.concatenate([state.projected(group.columns.astype(np.float32)), always], axis=1))
        white = state.projected((turning * change[:, None]).astype(np.float32))
        basis = directions(white - kept @ (kept.T @ white))
        heard = float(np.sum((basis.T @ state.innovation) ** 2)) / state.sigma**2
        found[k] = max((heard + TRUSTED) / (basis.shape[1] + TRUSTED), 1.0)
    return found


def _waves(state: State, number: NDArray[np.intp]) -> Floats:
    """Return an orthonormal basis of waves over the record, projected."""
    time_s = state.case.scene.time_s
    phase = 360.0 * (time_s - time_s[0])[:, None] / np.ptp(time_s) * np.maximum(number, 1)
    return directions(state.projected(np.column_stack(angles.sin_cos(phase)).astype(np.float32)))


def normal_score(statistic: Floats, freedom: Floats) -> Floats:
    """Return the normal score of a chi-squared statistic (Wilson and Hilferty, PNAS 17, 684, 1931).

    Args:
        statistic: (..., g).
        freedom: (g,).
    """
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt(np.maximum(statistic, 0.0) / freedom) - 1.0 + spread) / np.sqrt(spread)


def directions(white: Floats) -> Floats:
    """Return an orthonormal basis of whitened columns, float32, (n, at most k).

    Args:
        white: whitened columns, (n, k).
    """
    scale = np.linalg.norm(white, axis=0)
    unit = white[:, scale > 0] / scale[scale > 0]
    if unit.shape[1] < 2:
        return unit
    values, vectors = np.linalg.eigh((unit.T @ unit).astype(float))
    kept = values > max(THINNEST * values[-1], 1e-5)
    return (unit @ (vectors[:, kept] / np.sqrt(values[kept])).astype(np.float32)).astype(np.float32)
