"""Checks of the reference against the affected instrument, and the combination of several references.

Each reference yields its own pairs, with the water predicted at its own depth. At a given time the deviation of the
affected compass rotates all pairs equally, so it is preserved in their mean; the weights follow from the differences
between the measured and the predicted speeds, which do not depend on a compass.

A reference may turn out to be the affected record itself, with bins rounded, rescaled, averaged or shifted. Two
instruments never agree to a millimetre per second, as their pings and the water between them differ. A deeper cell of
the same profiler, given at its own depth, is accepted.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation.gridding import nearest_index
from compasslib.preparation.water import usable_velocities
from compasslib.records import Pairs, Record, ReferenceCompass, iso_time, take
from compasslib.statistics.least_squares import robust_width
from compasslib.types import DAY_S, HOUR_S, Bools, Complexes, Floats

BLOCK_S = 10 * DAY_S
MIN_BLOCKS, MIN_COMMON_PAIRS = 5, 100  # common to two references, before they are compared
LEAST_DEG, SURE = 5.0, 4.0  # smallest difference of directions that is reported, and in standard errors
CONTRADICTING = "the references differ by {:.0f}°, and the record cannot tell which is wrong"
LEAST_NOISE_M_S = 0.002
REFERENCE_HEADING = "lower_heading_deg"  # belongs to a single instrument, so it is not joined
AVERAGED = (
    *("upper_east", "upper_north", "lower_east", "lower_north"),
    *("upper_depth_m", "lower_depth_m", "separation_minutes"),
)


def join_references(each: Sequence[Pairs], names: Sequence[str]) -> Pairs:
    """Join the pairs of all consistent references in order of time, with warnings about the others.

    Of three or more references, one that disagrees with all others, which agree, is excluded. If two disagree, the
    faulty one cannot be determined: only the first in the mooring's file is used, and the difference is added as a
    doubt to all headings. A recording that is given twice is used once.
    """
    if len(each) == 1:
        return each[0]
    used, said, differ_deg = _agreeing(each, names)
    there = [k for k in used if len(each[k])] or used[:1]
    notes = [f"{names[k]}: {warning}" for k, pairs in enumerate(each) for warning in pairs.warnings]
    arrays = [name for name, column in vars(each[0]).items() if isinstance(column, np.ndarray)]
    columns = [name for name in arrays if name != REFERENCE_HEADING]
    rows = {name: np.concatenate([getattr(each[k], name) for k in there]) for name in columns}
    index = np.concatenate([np.full(len(each[k]), k, dtype=np.int8) for k in there])
    order = np.lexsort((index, rows["time_s"]))
    # Errors of the published mean and of the prediction, rms over all pairs that have them.
    known = [(len(each[k]), each[k].expected_m_s) for k in there if each[k].expected_m_s is not None]
    expected = None
    if known:
        counts, errors = zip(*known, strict=True)
        mean, predicted = np.sqrt(np.average(np.square(errors), weights=counts, axis=0)).tolist()
        expected = mean, predicted
    return Pairs(
        **{name: column[order] for name, column in rows.items()},
        reference_index=index[order],
        reference_names=tuple(names),
        warnings=(*said, *notes),
        expected_m_s=expected,
        veer_deg=float(np.average([each[k].veer_deg for k in there], weights=[max(len(each[k]), 1) for k in there])),
        slow_shear=max((each[k] for k in there), key=len).slow_shear,
        compass=_combined_compass([each[k].compass for k in there], [len(each[k]) for k in there]),
        doubts=(
            *(((differ_deg, CONTRADICTING.format(differ_deg)),) if differ_deg else ()),
            *(doubt for k in there for doubt in each[k].doubts),
        ),
        slowed=tuple((k, *span[1:]) for k, pairs in enumerate(each) for span in pairs.slowed),
    )


def _combined_compass(compasses: Sequence[ReferenceCompass | None], counts: Sequence[int]) -> ReferenceCompass | None:
    """Combine independent errors of compasses, weighted by their numbers of pairs."""
    known = [compass for compass in compasses if compass is not None]
    if len(known) < len(compasses):
        return None
    weight = np.maximum(counts, 1) / np.maximum(counts, 1).sum()
    errors = [(each.sigma_deg, each.iron_deg, each.declination_deg) for each in known]
    # The error of the declination is common to all directions that are true already.
    constant, iron = np.sqrt(weight**2 @ np.square(errors))[:2].tolist()
    return ReferenceCompass(
        " and ".join(each.name for each in known), constant, iron, float(weight @ [each[2] for each in errors])
    )


def combine_references(pairs: Pairs) -> Pairs:
    """Combine the simultaneous pairs of several references into their weighted mean."""
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


def _weights(missed: Floats) -> Floats:
    """Compute non-negative weights of the references at each time, (t, k), for minimum variance of their mean.

    Args:
        missed: predicted minus reference speed, (t, k) m/s, NaN where a reference has no pair.
    """
    there = np.isfinite(missed)
    off = np.where(there, missed - np.nanmedian(missed, axis=0), 0.0)
    both = np.maximum(there.T.astype(float) @ there, 1.0)
    covariance = off.T @ off / both + LEAST_NOISE_M_S**2 * np.eye(missed.shape[1])
    result = np.zeros(missed.shape)
    for pattern in np.unique(there, axis=0):
        solution = np.linalg.solve(covariance[np.ix_(pattern, pattern)], np.ones(int(pattern.sum())))
        # A reference whose noise is correlated with a better one's has a negative optimal weight: it is excluded.
        result[np.ix_(np.all(there == pattern, axis=1), pattern)] = np.maximum(solution, 0.0)
    return result


def _agreeing(each: Sequence[Pairs], names: Sequence[str]) -> tuple[list[int], list[str], float]:
    """Select consistent references, with notes on the others, and the unresolved disagreement, degrees, else 0."""
    doubted = {k: why for k, pairs in enumerate(each) for _, why in pairs.doubts}
    if len(doubted) == len(each):
        doubted = {}
    used, notes = list[int](), [f"{names[k]} is left out: {why}" for k, why in doubted.items()]
    rest = (k for k in range(len(each)) if k not in doubted)
    for k in sorted(rest, key=lambda k: -len(each[k])):  # of two files of one recording use the longer
        if (twin := next((j for j in used if _identical(each[j], each[k])), None)) is None:
            used = sorted([*used, k])
        else:
            notes.append(f"the references {names[twin]} and {names[k]} are one recording: {names[k]} is left out")
    off = {(a, b): _apart(each[a], each[b]) for a, b in combinations(used, 2)}
    wrong = {pair: difference for pair, difference in off.items() if difference is not None}
    if not wrong:
        return used, notes, 0.0
    against = {k: sum(k in pair for pair in wrong) for k in used}
    worst = max(used, key=lambda k: against[k])
    texts = [f"the references {names[a]} and {names[b]} {how}" for (a, b), (how, _) in wrong.items()]
    if len(used) > 2 and against[worst] == len(wrong) and against[worst] > 1:
        said = f"{'; '.join(texts)}: {names[worst]} is left out, as the others agree"
        return [k for k in used if k != worst], [*notes, said], 0.0
    alone = f"{names[used[0]]}, first in reference, is used alone"
    said = f"{'; '.join(texts)}: which is wrong cannot be determined; {alone}"
    return used[:1], [*notes, said], max(abs(size_deg) for _, size_deg in wrong.values())


def _identical(first: Pairs, second: Pairs) -> bool:
    """Check whether two references have the same velocities, as two files of one recording have."""
    _, a, b = np.intersect1d(first.time_s, second.time_s, return_indices=True)
    if len(a) < MIN_COMMON_PAIRS:
        return False
    velocity, other = _flows(take(first, a))[1], _flows(take(second, b))[1]
    apart = float(np.median(np.abs(velocity - other)))
    return apart < min(ALIKE_M_S, SMALL * float(np.std(velocity)))


def _apart(first: Pairs, second: Pairs) -> tuple[str, float] | None:
    """Describe by how many degrees two references' directions differ beyond the shear predicted by the profile.

    None if the difference is not significant or data are too few. The affected compass cancels in the difference of the
    predictions at the two depths, which is due to shear alone.
    """
    _, a, b = np.intersect1d(first.time_s, second.time_s, return_indices=True)
    if len(a) < MIN_COMMON_PAIRS:
        return None
    (up_a, low_a), (up_b, low_b) = _flows(take(first, a)), _flows(take(second, b))
    turn = low_a * np.conj(low_b) * np.conj(up_a * np.conj(up_b))
    slowest = np.min(np.abs([up_a, low_a, up_b, low_b]), axis=0)
    turn = np.where(np.abs(turn) > 0.0, turn / np.maximum(np.abs(turn), 1e-12), 0.0) * slowest**2
    time_s = first.time_s[a]
    block = np.unique(np.floor((time_s - time_s[0]) / BLOCK_S), return_inverse=True)[1]
    sums = np.asarray(np.bincount(block, turn.real) + 1j * np.bincount(block, turn.imag), dtype=complex)
    if len(sums) < MIN_BLOCKS:
        return None
    if (at_once := _at_once(sums, time_s[0])) is not None:
        return at_once
    mean = complex(sums.sum())
    across = np.imag(sums * np.conj(mean)) / abs(mean)
    sigma = float(np.sqrt(np.sum(across**2))) / abs(mean) / angles.DEGREE
    off = -float(np.angle(mean)) / angles.DEGREE
    if abs(off) < max(LEAST_DEG, SURE * sigma):
        return None
    return f"differ in direction by {off:+.0f} ± {1.96 * sigma:.0f} degrees (95 %) all along", off


def _at_once(sums: Complexes, begin_s: float) -> tuple[str, float] | None:
    """Describe a significant step in the difference of directions, with its date and size in degrees, else None."""
    angle = -np.angle(sums * np.conj(sums.sum())) / angles.DEGREE
    weight = np.abs(sums)
    best: tuple[float, float, float, int] | None = None
    for k in range(2, len(sums) - 1):
        parts = [(angle[:k], weight[:k]), (angle[k:], weight[k:])]
        means = [float(np.average(x, weights=w)) for x, w in parts]
        spreads = (np.sqrt(np.sum((w * (x - mean)) ** 2)) for (x, w), mean in zip(parts, means, strict=True))
        errors = [float(spread / np.sum(w)) for spread, (_, w) in zip(spreads, parts, strict=True)]
        step, sigma = means[1] - means[0], max(math.hypot(*errors), 1e-3)
        if best is None or abs(step) / sigma > best[0]:
            best = (abs(step) / sigma, step, sigma, k)
    if best is None or abs(best[1]) < LEAST_DEG or best[0] < SURE + 1.0:  # stricter, as the best of many dates
        return None
    date = str(np.datetime64(round(begin_s + best[3] * BLOCK_S), "s"))[:10]
    text = f"differ in direction by {best[1]:+.0f} ± {1.96 * best[2]:.0f} degrees (95 %) more from about {date} on"
    return text, best[1]


def _flows(pairs: Pairs) -> tuple[Complexes, Complexes]:
    return pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north


# Two instruments always differ by more than this, or than this share of a table's last digit.
ALIKE_M_S, ROUNDED = 2e-3, 0.5
SMALL = 0.1  # the same as a share of the standard deviation of speed: in still water two instruments may agree
LAGS_H, SHIFTED_H = np.arange(-12, 13), 6  # lags that a time average may span, largest shift of time stamps, hours
MIN_COMPARED, MAX_COMPARED = 100, 500  # samples compared
WIDEST = 3  # adjacent bins that an export may have averaged
OFF_M = 5.0  # larger than the error of a nominal depth


@dataclass(frozen=True)
class CellSeries:
    """Velocities of one cell, or averaged over several cells."""

    velocity: Complexes  # (n,) NaN where missing
    depth_m: float
    bins: range


@dataclass(frozen=True)
class MatchedVelocities:
    """A sample of the reference's velocities, and the affected record's samples at lags of hours around them."""

    velocity: Complexes  # (k,)
    place: NDArray[np.intp]  # (k, lags) index of the nearest sample of the affected record
    there: Bools  # (k, lags) whether it is near enough in time
    least_m_s: float  # difference that rounding explains


def find_same_recording(upper: Record, lower: Record, bins: int) -> str:
    """Explain that the reference repeats the affected record, given on the pairs' time grid; empty if it does not."""
    if len(upper.time_s) < MIN_COMPARED or len(lower.time_s) < MIN_COMPARED:
        return ""
    near = np.flatnonzero(np.abs(LAGS_H) <= SHIFTED_H)
    for trusted in _near(upper, lower, bins):
        sample = np.flatnonzero(np.isfinite(trusted.velocity))
        sample = sample[:: 1 + len(sample) // MAX_COMPARED]
        wanted = lower.time_s[sample, None] - HOUR_S * LAGS_H
        place = nearest_index(upper.time_s, wanted.ravel()).reshape(wanted.shape)
        velocity = trusted.velocity[sample]
        steps = []
        for x in (velocity.real, np.abs(velocity)):
            values = np.unique(np.round(x, 6))
            steps.append(float(np.min(np.diff(values))) if 1 < len(values) < len(x) / 2 else 0.0)
        there = np.abs(upper.time_s[place] - wanted) <= HOUR_S / 2.0
        met = MatchedVelocities(velocity, place, there, ROUNDED * max(steps))
        velocity, depth = upper.east + 1j * upper.north, upper.bin_depth_m()
        bins_there = velocity.shape[1]
        runs = [range(k, k + n) for n in (*range(1, WIDEST + 1), bins_there) for k in range(bins_there - n + 1)]
        averages = (CellSeries(velocity[:, r].mean(axis=1), float(np.nanmedian(depth[:, r])), r) for r in runs)
        for cells in averages:
            shared, off_m = cells.bins.start < bins, abs(cells.depth_m - trusted.depth_m)
            if not (shared or off_m > OFF_M):
                continue
            speed = np.where(met.there[:, near], np.abs(cells.velocity)[met.place[:, near]], np.nan)
            same = any(_equal(column, np.abs(met.velocity), met.least_m_s) for column in speed.T)  # at any one lag
            if same or (cells.bins.start == 0 and _averaged(cells, met)):
                first, last = cells.bins.start + 1, cells.bins.stop
                which = f"bin {first}" if first == last else f"bins {first} to {last}"
                why = "whose water every pair already holds" if shared else f"given {off_m:.0f} m from their depth"
                those = f"those of the reference are {which} of the affected one, {why}"
                twice = "the two instruments recorded the same velocities: one recording was given twice"
                return f"{twice}, and no pair counts ({those})"
    return ""


def _near(upper: Record, lower: Record, bins: int) -> Iterator[CellSeries]:
    """Yield the reference cells that pairs may use, averaged and one by one."""
    velocity, depth = lower.east + 1j * lower.north, lower.bin_depth_m()
    away = np.abs(np.nanmedian(depth, axis=0) - np.nanmedian(upper.depth_m))
    order = sorted(np.argsort(away, kind="stable")[:bins].tolist())
    for run in [order, *([k] for k in order if len(order) > 1)]:
        yield CellSeries(velocity[:, run].mean(axis=1), float(np.nanmedian(depth[:, run])), range(run[0], run[-1] + 1))


def _equal(first: NDArray, second: NDArray, least: float) -> bool:
    """Check whether two series agree, up to a factor, more closely than two instruments ever do."""
    known = np.isfinite(first)
    if known.sum() < MIN_COMPARED:
        return False
    first, second = first[known], second[known]
    sizes = np.median(np.abs(first)), np.median(np.abs(second))
    if min(sizes) <= 0.0:
        return False
    factor = sizes[1] / sizes[0]
    off = robust_width(first - second / factor)
    return off < max(ALIKE_M_S, least / factor) and off < SMALL * float(np.std(first))


def _averaged(cells: CellSeries, met: MatchedVelocities) -> bool:
    """Check whether a weighted mean over hours of one velocity, rotated by a constant angle, equals the other."""
    columns = cells.velocity[met.place]
    whole = met.there.all(axis=1) & np.isfinite(columns).all(axis=1)
    if whole.sum() < MIN_COMPARED:
        return False
    weight, *_ = np.linalg.lstsq(columns[whole], met.velocity[whole], rcond=None)
    return _equal(columns[whole] @ weight, met.velocity[whole], met.least_m_s)


WINDOW_S, MIN_WINDOWS, MIN_WINDOW_PAIRS = 5 * DAY_S, 6, 10  # the last: a profiler passes twice a day
# Least change of the ratio of speeds that is reported; the same in standard deviations of the ratio between own bins;
# windows that it lasts. Of 24 combinations of bins of eh2 one reaches it in two windows, none in three; none of papa.
LEAST_CHANGE, CHANGE_SIGMAS, LASTS = 0.2, 3.0, 3


def find_speed_changes(pairs: Pairs, upper: Record) -> Pairs:
    """Hold the ratio of both instruments' speeds against time, in windows; note where it leaves that of the beginning.

    The ratio also changes with the water: a change counts if it exceeds those between the affected instrument's own
    bins as far apart as the reference, for two weeks. Without such bins nothing is tested.

    Args:
        pairs: those of one reference.
        upper: samples of the affected record at the pairs.
    """
    number = np.floor((pairs.time_s - pairs.time_s[0]) / WINDOW_S).astype(int)
    windows = [rows for k in range(number[-1] + 1) if len(rows := np.flatnonzero(number == k)) >= MIN_WINDOW_PAIRS]
    speed = np.where(usable_velocities(upper), np.hypot(upper.east, upper.north), np.nan)
    range_m = np.nanmedian(upper.bin_range_m, axis=0)
    apart_m = float(np.nanmedian(np.abs(pairs.lower_depth_m - pairs.upper_depth_m)))
    other = [k + 1 + int(np.argmin(np.abs(np.abs(range_m[k + 1 :] - x) - apart_m))) for k, x in enumerate(range_m[:-1])]
    if len(windows) < MIN_WINDOWS:
        return pairs
    upper_speed, lower_speed = (np.abs(flow)[:, None] for flow in _flows(pairs))
    change = _changes(lower_speed, upper_speed, windows)[:, 0]
    own = _changes(speed[:, other], speed[:, : len(other)], windows)
    if not own.size:
        return pairs
    least = max(-np.log(1.0 - LEAST_CHANGE), CHANGE_SIGMAS * float(np.sqrt(np.nanmean(own**2))))
    begins = [*(float(pairs.time_s[rows[0]]) for rows in windows), float(pairs.time_s[-1])]
    fallen, notes = [], []
    for way, said in ((-1.0, "fall"), (1.0, "rise")):
        far = way * change > least
        edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin < LASTS:
                continue
            ratio = float(np.exp(np.mean(change[begin:end])))
            fallen += [(0, begins[begin], begins[end], ratio)] if way < 0.0 else []
            notes.append(
                f"from {iso_time(begins[begin])} to {iso_time(begins[end])} the speeds of the reference {said} to "
                f"{ratio:.2f} of their ratio to those of the affected instrument at the beginning: one of the two was "
                "fouled or failed, or the water changed; velocities of a mechanical rotor (kind: rotor) that fall have "
                "flag 2, and others take precedence"
            )
    return replace(pairs, slowed=tuple(fallen), warnings=(*pairs.warnings, *notes))


def _changes(speed: Floats, other: Floats, windows: Sequence[NDArray[np.intp]]) -> Floats:
    """Compute the log of the ratio of mean speeds in windows, less its median in the first quarter, (w, k)."""
    both = np.isfinite(speed + other)
    sums = [np.array([np.where(both, x, 0.0)[rows].sum(axis=0) for rows in windows]) for x in (speed, other)]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(sums[0] / sums[1])
    first = max(len(windows) // 4, LASTS)
    ratio = ratio[:, np.isfinite(ratio[:first]).any(axis=0)]
    return ratio - np.nanmedian(ratio[:first], axis=0)
