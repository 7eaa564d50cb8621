"""Several references: held against each other, and taken together where they agree.

Each gives pairs of its own, with the water predicted at its own depth. At one time the affected compass turns all of
them alike, so that their mean turns as each does; they are weighted by how much their speeds, which no compass turns,
leave the predicted ones.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.records import Pairs, take
from compasslib.types import Complexes, Floats

BLOCK_S = 10 * 86400.0
FEWEST_BLOCKS, FEWEST = 5, 100  # that both must have at the same times before they are held against each other
LEAST_DEG, SURE = 5.0, 4.0  # a difference of directions that is told, and its standard errors
LEAST_NOISE_M_S = 0.002
OWN_HEADING = "lower_heading_deg"  # of one instrument: not of several together
AVERAGED = (
    *("upper_east", "upper_north", "lower_east", "lower_north"),
    *("upper_depth_m", "lower_depth_m", "separation_minutes"),
)


def joined(each: Sequence[Pairs], names: Sequence[str]) -> Pairs:
    """Return the pairs of all references that agree, by time, with what is to be said of the others.

    Where three or more are there, one that disagrees with all others, which agree, is left out; where two disagree,
    nobody can tell whose fault it is, and the first, which the mooring's file names first, stands alone.

    Args:
        each: by reference, perhaps none of some.
        names: of the instruments.
    """
    if len(each) == 1:
        return each[0]
    kept, said = _agreeing(each, names)
    there = [k for k in kept if len(each[k])] or kept[:1]
    notes = [f"{names[k]}: {warning}" for k, one in enumerate(each) for warning in one.warnings]
    rows = {name: np.concatenate([getattr(each[k], name) for k in there]) for name in _columns(each[0])}
    index = np.concatenate([np.full(len(each[k]), k, dtype=np.int8) for k in there])
    order = np.lexsort((index, rows["time_s"]))
    return Pairs(
        **{name: column[order] for name, column in rows.items()},
        reference_index=index[order],
        reference_names=tuple(names),
        warnings=(*said, *notes),
        expected_m_s=_expected([each[k] for k in there]),
        veer_deg=float(np.average([each[k].veer_deg for k in there], weights=[max(len(each[k]), 1) for k in there])),
    )


def together(pairs: Pairs) -> Pairs:
    """Return pairs of which no two are of one time: those of several references become their weighted mean."""
    if pairs.reference_index is None:
        return pairs
    if not len(pairs):
        return replace(pairs, reference_index=None, reference_names=())
    times, first, row = np.unique(pairs.time_s, return_index=True, return_inverse=True)
    used, column = np.unique(pairs.reference_index, return_inverse=True)
    weight = np.zeros((len(times), len(used)))
    weight[row, column] = 1.0
    missed = np.full(weight.shape, np.nan)
    upper, lower = _flows(pairs)
    missed[row, column] = np.abs(upper) - np.abs(lower)
    weight *= _weights(missed)
    share = (weight / weight.sum(axis=1, keepdims=True))[row, column]
    means: dict[str, Any] = {name: np.bincount(row, share * getattr(pairs, name), len(times)) for name in AVERAGED}
    whole = replace(pairs, reference_index=None, reference_names=(), lower_heading_deg=None)
    return replace(take(whole, first), **means)


def _expected(each: Sequence[Pairs]) -> tuple[float, float] | None:
    """Return the errors of the published mean and of the prediction, rms over all pairs that have them."""
    known = [(len(one), one.expected_m_s) for one in each if one.expected_m_s is not None]
    if not known:
        return None
    counts, errors = zip(*known, strict=True)
    mean, predicted = np.sqrt(np.average(np.square(errors), weights=counts, axis=0)).tolist()
    return mean, predicted


def _columns(pairs: Pairs) -> list[str]:
    return [name for name, column in vars(pairs).items() if isinstance(column, np.ndarray) and name != OWN_HEADING]


def _weights(missed: Floats) -> Floats:
    """Return the weight of each reference at each time, (t, k), not below 0, for the least noise together.

    Args:
        missed: predicted minus trusted speed, (t, k), NaN where an instrument has no pair.
    """
    there = np.isfinite(missed)
    off = np.where(there, missed - np.nanmedian(missed, axis=0), 0.0)
    both = np.maximum(there.T.astype(float) @ there, 1.0)
    covariance = off.T @ off / both + LEAST_NOISE_M_S**2 * np.eye(missed.shape[1])
    result = np.zeros(missed.shape)
    for pattern in np.unique(there, axis=0):
        own = np.linalg.solve(covariance[np.ix_(pattern, pattern)], np.ones(int(pattern.sum())))
        # Where one only adds noise that another has too, its best weight is negative: it is left out.
        result[np.ix_(np.all(there == pattern, axis=1), pattern)] = np.maximum(own, 0.0)
    return result


def _agreeing(each: Sequence[Pairs], names: Sequence[str]) -> tuple[list[int], list[str]]:
    """Return which references are used, and what is said of those that disagree."""
    count = len(each)
    off = {(a, b): _apart(each[a], each[b]) for a in range(count) for b in range(a + 1, count)}
    wrong = {pair: found for pair, found in off.items() if found is not None}
    if not wrong:
        return list(range(count)), []
    against = [sum(k in pair for pair in wrong) for k in range(count)]
    worst = int(np.argmax(against))
    rest = [k for k in range(count) if k != worst]
    texts = [f"the references {names[a]} and {names[b]} {how}" for (a, b), how in wrong.items()]
    if count > 2 and against[worst] == len(wrong) and against[worst] > 1:
        return rest, [f"{'; '.join(texts)}: {names[worst]} is left out, as the others agree"]
    return [0], [
        f"{'; '.join(texts)}: which is wrong cannot be determined; {names[0]}, first in reference, is used alone"
    ]


def _apart(one: Pairs, other: Pairs) -> str | None:
    """Return how the directions of two references differ beyond what the profile shows of the water.

    None where they do not, or where too little is there. The predictions at their two depths share the affected
    compass: their difference is the water's alone.
    """
    _, a, b = np.intersect1d(one.time_s, other.time_s, return_indices=True)
    if len(a) < FEWEST:
        return None
    (up_a, low_a), (up_b, low_b) = _flows(take(one, a)), _flows(take(other, b))
    turn = low_a * np.conj(low_b) * np.conj(up_a * np.conj(up_b))
    slowest = np.min(np.abs([up_a, low_a, up_b, low_b]), axis=0)
    turn = np.where(np.abs(turn) > 0.0, turn / np.maximum(np.abs(turn), 1e-12), 0.0) * slowest**2
    time_s = one.time_s[a]
    block = np.unique(np.floor((time_s - time_s[0]) / BLOCK_S), return_inverse=True)[1]
    sums = np.asarray(np.bincount(block, turn.real) + 1j * np.bincount(block, turn.imag), dtype=complex)
    if len(sums) < FEWEST_BLOCKS:
        return None
    return _at_once(sums, time_s[0]) or _constant(sums)


def _constant(sums: Complexes) -> str | None:
    """Say by how much directions differ all along."""
    mean = complex(sums.sum())
    across = np.imag(sums * np.conj(mean)) / abs(mean)
    sigma = float(np.sqrt(np.sum(across**2))) / abs(mean) / angles.DEGREE
    off = -float(np.angle(mean)) / angles.DEGREE
    if abs(off) < max(LEAST_DEG, SURE * sigma):
        return None
    return f"differ in direction by {off:+.0f} ± {1.96 * sigma:.0f} degrees (95 %) all along"


def _at_once(sums: Complexes, begin_s: float) -> str | None:
    """Say by how much directions differ from a date on, where a step is there."""
    angle = -np.angle(sums * np.conj(sums.sum())) / angles.DEGREE
    weight = np.abs(sums)
    best: tuple[float, float, float, int] | None = None
    for k in range(2, len(sums) - 1):
        parts = [(angle[:k], weight[:k]), (angle[k:], weight[k:])]
        means = [float(np.average(x, weights=w)) for x, w in parts]
        errors = [
            float(np.sqrt(np.sum((w * (x - mean)) ** 2)) / np.sum(w)) for (x, w), mean in zip(parts, means, strict=True)
        ]
        step, sigma = means[1] - means[0], max(math.hypot(*errors), 1e-3)
        if best is None or abs(step) / sigma > best[0]:
            best = (abs(step) / sigma, step, sigma, k)
    if best is None or abs(best[1]) < LEAST_DEG or best[0] < SURE + 1.0:  # the best of many dates
        return None
    date = str(np.datetime64(round(begin_s + best[3] * BLOCK_S), "s"))[:10]
    return f"differ in direction by {best[1]:+.0f} ± {1.96 * best[2]:.0f} degrees (95 %) more from about {date} on"


def _flows(pairs: Pairs) -> tuple[Complexes, Complexes]:
    return pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north
