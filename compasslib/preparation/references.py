"""Checks of the reference against the affected instrument, and the combination of several references.

The deviation of the affected compass rotates simultaneous pairs equally, so it is preserved in their mean. Weights
follow from differences between measured and predicted speeds, which do not depend on a compass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation.water import bins_apart, usable_velocities
from compasslib.records import Pairs, Record, ReferenceCompass, iso_time, take
from compasslib.statistics.resampling import block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats

CONTRADICTING = "the references differ by {:.0f}°, and the record cannot tell which is wrong"
SAME_M_S = 0.001  # median difference of velocities below which two files are of one recording, but for rounding
BEYOND_USUAL = 2.58  # standard deviations of two compasses' usual errors; 1 % of sound pairs differ by more
REFERENCE_HEADING = "lower_heading_deg"  # belongs to a single instrument, so it is not joined
AVERAGED = (
    *("upper_east", "upper_north", "lower_east", "lower_north"),
    *("upper_depth_m", "lower_depth_m", "separation_minutes"),
)


def join_references(each: Sequence[Pairs], names: Sequence[str]) -> Pairs:
    """Join the pairs of all consistent references in order of time, with warnings about the others.

    The second of two files of one recording is excluded, and of three or more references one that disagrees with all
    others, which agree. If two disagree by more than their compasses usually err, the faulty one cannot be determined:
    only the first in the mooring's file is used, and the difference is added as a doubt to all headings.
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
    sorted_rows: dict[str, Any] = {name: column[order] for name, column in rows.items()}
    joined = Pairs(
        **sorted_rows,
        reference_index=index[order],
        reference_names=tuple(names),
        warnings=(*said, *notes),
        expected_m_s=expected,
        veer_deg=float(np.average([each[k].veer_deg for k in there], weights=[max(len(each[k]), 1) for k in there])),
        slow_shear=max((each[k] for k in there), key=len).slow_shear,
        delay_h=max(each[k].delay_h for k in there),
        speed_late_h=max((each[k] for k in there), key=len).speed_late_h,
        doubts=(
            *(((differ_deg, CONTRADICTING.format(differ_deg)),) if differ_deg else ()),
            *(doubt for k in there for doubt in each[k].doubts),
        ),
        slowed=tuple((k, *span[1:]) for k, pairs in enumerate(each) for span in pairs.slowed),
    )
    if not len(joined):
        return replace(joined, compass=each[used[0]].compass)
    row, share = _shares(joined)
    mean_share = np.bincount(index[order], share, len(each))[there] / (row[-1] + 1)
    return replace(joined, compass=_combined_compass([each[k].compass for k in there], mean_share))


def _combined_compass(compasses: Sequence[ReferenceCompass | None], weight: Floats) -> ReferenceCompass | None:
    """Combine independent errors of compasses by their shares in the mean, (k,)."""
    known = [compass for compass in compasses if compass is not None]
    if len(known) < len(compasses):
        return None
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
    row, share = _shares(pairs)
    means: dict[str, Any] = {name: np.bincount(row, share * getattr(pairs, name)) for name in AVERAGED}
    whole = replace(pairs, reference_index=None, lower_heading_deg=None)
    return replace(take(whole, np.unique(pairs.time_s, return_index=True)[1]), **means)


def _shares(pairs: Pairs) -> tuple[NDArray[np.intp], Floats]:
    """Compute the time, as its number, and the weight in the mean at that time of each pair in order of time, (n,)."""
    times, row = np.unique(pairs.time_s, return_inverse=True)
    used, column = np.unique(np.asarray(pairs.reference_index), return_inverse=True)
    missed = np.full((len(times), len(used)), np.nan)
    upper, lower = pairs.flows
    missed[row, column] = np.abs(upper) - np.abs(lower)
    weight = _weights(missed)
    return row, (weight / weight.sum(axis=1, keepdims=True))[row, column]


def _weights(missed: Floats) -> Floats:
    """Compute non-negative weights of the references at each time, (t, k), for minimum variance of their mean.

    Args:
        missed: predicted minus reference speed, (t, k) m/s, NaN where a reference has no pair.
    """
    there = np.isfinite(missed)
    off = np.where(there, missed - np.nanmedian(missed, axis=0), 0.0)
    both = np.maximum(there.T.astype(float) @ there, 1.0)
    covariance = off.T @ off / both + 0.002**2 * np.eye(missed.shape[1])
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
    used = [k for k in range(len(each)) if k not in doubted]
    notes = [f"{names[k]} is left out: {why}" for k, why in doubted.items()]
    for a, b in combinations(used.copy(), 2):
        if {a, b} <= {*used} and _same_recording(each[a], each[b]):
            used.remove(b)
            notes.append(f"{names[b]} is left out: it is another file of the recording {names[a]}")
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
    usual_deg = {k: _usual_error(each[k]) for k in used}
    if all(abs(size) < BEYOND_USUAL * np.hypot(usual_deg[a], usual_deg[b]) for (a, b), (_, size) in wrong.items()):
        return used, [*notes, f"{'; '.join(texts)}, as compasses usually do: all are used"], 0.0
    alone = f"{names[used[0]]}, first in reference, is used alone"
    said = f"{'; '.join(texts)}: which is wrong cannot be determined; {alone}"
    return used[:1], [*notes, said], max(abs(size_deg) for _, size_deg in wrong.values())


def _same_recording(first: Pairs, second: Pairs) -> bool:
    """Return whether two references are one recording: their velocities at 30 common times or more hardly differ."""
    _, a, b = np.intersect1d(first.time_s, second.time_s, return_indices=True)
    off = np.abs(first.flows[1][a] - second.flows[1][b])
    return len(a) >= 30 and float(np.median(off)) < SAME_M_S


def _usual_error(pairs: Pairs) -> float:
    """Compute the usual error of a reference's directions, degrees: of its compass, and by the mean shear."""
    compass = pairs.compass
    known = (0.0, 0.0) if compass is None else (compass.sigma_deg, compass.iron_deg)
    return float(np.hypot(np.hypot(*known), pairs.veer_deg))


def _apart(first: Pairs, second: Pairs) -> tuple[str, float] | None:
    """Describe by how many degrees two references' directions differ beyond the shear predicted by the profile.

    None if the difference is below 5 degrees or 4 standard errors, from the scatter between blocks of 10 days, or
    of an eighth of a shorter time. The affected compass cancels in the difference of the predictions at the two depths,
    which is due to shear alone.
    """
    _, a, b = np.intersect1d(first.time_s, second.time_s, return_indices=True)
    if not len(a):
        return None
    (up_a, low_a), (up_b, low_b) = take(first, a).flows, take(second, b).flows
    turn = low_a * np.conj(low_b) * np.conj(up_a * np.conj(up_b))
    slowest = np.min(np.abs([up_a, low_a, up_b, low_b]), axis=0)
    turn = np.where(np.abs(turn) > 0.0, turn / np.maximum(np.abs(turn), 1e-12), 0.0) * slowest**2
    span_s = float(np.ptp(first.time_s[a]))
    block_s = min(10.0 * DAY_S, max(span_s / 8.0, 0.5 * DAY_S))
    sums = block_sums(turn, blocks_by_span(first.time_s[a], block_s))
    if len(sums) < 5:
        return None
    mean = complex(sums.sum())
    across = np.imag(sums * np.conj(mean)) / abs(mean)
    sigma = float(np.sqrt(np.sum(across**2))) / abs(mean) / angles.DEGREE
    off = -float(np.angle(mean)) / angles.DEGREE
    if abs(off) < max(5.0, 4.0 * sigma):
        return None
    return f"differ in direction by {off:+.0f} ± {1.96 * sigma:.0f} degrees (95 %) all along", off


def find_speed_changes(pairs: Pairs, upper: Record) -> Pairs:
    """Note where the ratio of both instruments' speeds, in windows of 5 days, leaves that of the beginning.

    The ratio also changes with the water: a change counts if it exceeds 20 %, and three times those between the
    affected instrument's own bins as far apart as the reference. Without such bins nothing is tested.
    """
    lasts = 3  # windows that a change lasts; of 24 combinations of bins of eh2 one reaches two, none three
    number = blocks_by_span(pairs.time_s, 5.0 * DAY_S)
    # A profiler passes twice a day, ten times in a window.
    windows = [rows for k in range(number[-1] + 1) if len(rows := np.flatnonzero(number == k)) >= 10]
    speed = np.where(usable_velocities(upper), np.hypot(upper.east, upper.north), np.nan)
    other = bins_apart(upper, float(np.nanmedian(np.abs(pairs.lower_depth_m - pairs.upper_depth_m))))
    if len(windows) < 2 * lasts:
        return pairs
    upper_speed, lower_speed = (np.abs(flow)[:, None] for flow in pairs.flows)
    change = _changes(lower_speed, upper_speed, windows, lasts)[:, 0]
    own = _changes(speed[:, other], speed[:, : len(other)], windows, lasts)
    if not own.size:
        return pairs
    least = max(-np.log(0.8), 3.0 * float(np.sqrt(np.nanmean(own**2))))
    begins = [*(float(pairs.time_s[rows[0]]) for rows in windows), float(pairs.time_s[-1])]
    fallen, notes = [], []
    for way, said in ((-1.0, "fall"), (1.0, "rise")):
        far = way * change > least
        edges = np.flatnonzero(np.diff(np.concatenate([[0], far.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if end - begin < lasts:
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


def _changes(speed: Floats, other: Floats, windows: Sequence[NDArray[np.intp]], lasts: int) -> Floats:
    """Compute the log of the ratio of mean speeds in windows, less its median in the first quarter, (w, k)."""
    both = np.isfinite(speed + other)
    known = [np.where(both, x, 0.0) for x in (speed, other)]
    sums = [np.array([x[rows].sum(axis=0) for rows in windows]) for x in known]
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(sums[0] / sums[1])
    first = max(len(windows) // 4, lasts)
    ratio = ratio[:, np.isfinite(ratio[:first]).any(axis=0)]
    return ratio - np.nanmedian(ratio[:first], axis=0)
