"""Clocks: valid times of a recording, and offsets of hours to a month between two instruments.

Samples are checked in the order in which they were recorded. A clock that jumps back into time already recorded was
reset: the samples after it have no known time and are omitted.

Offsets are estimated from current speeds, which do not depend on a compass. High-passed speeds are multiplied in
windows of days at every hourly lag. A lag is accepted if it fits better than the stated clocks, and than every other
lag including tidal aliases, by more than the scatter between windows. Clocks that drift, or were set during the
deployment, are treated in the same way. Errors of a few hours between hourly records are left to the search for
unmodelled effects, which has a finer resolution and identifies them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray

from compasslib.records import Record, take
from compasslib.types import HOUR_S, Bools, Floats

Hours = NDArray[np.intp]

DAY_H = 24
FARTHEST_H = 45 * DAY_H  # largest lag: an error of a month, with a margin
DRIFT_H, BEGAN_H = 72, 5 * DAY_H  # largest drift searched, and largest offset of a drifting clock at its start
SLOW_H = 36  # half-width of the running mean removed: slow changes of speed do not resolve hours
WINDOW_H, WEEK_H = 2 * DAY_H, 7 * DAY_H  # high-passed speeds decorrelate within half a day
SHORTEST_H, MIN_COMMON_HOURS = 20 * DAY_H, 60  # least duration of the records, and hours measured by both
LONG_H = 60 * DAY_H  # common hours from which uncorrelated speeds are reported
CLIP, QUIET = 3.0, 0.2  # bound of speeds in units of their local rms; its lower bound as a share of the whole record's
SIGMAS, SIGMAS_WARNED = 4.0, 2.0  # normal score from which a lag is accepted, and from which it is reported
NEAR_H = 6  # half-width of a peak; the next tidal alias is 12 hours away
AS_STATED_H = 1  # the delay of currents between two depths is shorter
SEARCHED_H, DENSE_S = 6, 2 * HOUR_S  # lags and sampling that the search for unmodelled effects resolves more finely
SPAN = 5  # windows per span of ten days
CHANGE = 8.0  # cost of a clock change, in standard deviations of a span's sum: chance gains among 2000 lags are smaller
FEWEST_SHARE = 0.3  # of the most common hours at any lag; products at lags with fewer are reduced
# Records are related above the first two (correlation of high-passed speeds, score) or the third (of original speeds).
RELATED, RELATED_SIGMAS, RELATED_WHOLE = 0.05, 3.0, 0.5


@dataclass(frozen=True)
class SpeedSeries:
    """A series of speeds, (n,) each."""

    time_s: Floats
    speed: Floats  # m/s, NaN where nothing was measured


@dataclass(frozen=True)
class ClockOffset:
    """Accepted offset of the reference's clock relative to the affected instrument's, reference ahead positive."""

    time_s: tuple[float, ...] = (0.0,)  #: nodes, UTC seconds since 1970 by the affected clock, linear between
    ahead_h: tuple[float, ...] = (0.0,)  #: hours by which the reference's clock is ahead at each node
    warnings: tuple[str, ...] = ()  #: sentences for the report
    same_recording: str = ""  #: why both records are the same recording and all pairs are rejected, else empty
    uncorrelated: str = ""  #: why the records may be of different places or times, else empty

    def align(self, record: Record) -> Record:
        """Convert the reference's record to the affected clock, dropping hours repeated by a clock set back."""
        if not any(self.ahead_h):
            return record
        time_s = record.time_s
        for _ in range(2):  # the offset is a function of the affected clock, so iterate
            time_s = record.time_s - HOUR_S * np.interp(time_s, self.time_s, self.ahead_h)
        later = np.append(True, time_s[1:] > np.maximum.accumulate(time_s)[:-1])
        return take(replace(record, time_s=time_s), later)


@dataclass(frozen=True)
class LagPath:
    """A lag for each of w windows: hours by which the reference's clock is ahead."""

    hours: Hours  # (w,)
    set_at: bool = False  # whether the lag changes in steps, as a clock was set, and not by drift


@dataclass(frozen=True)
class LagWindows:
    """Products of the two speeds in each of w windows at each of k lags."""

    upper: Floats  # (n,) hourly high-passed speed over its local rms, 0 where missing
    lower: Floats  # (n,) the same of the reference, by its own clock
    edges: Hours  # (w + 1,) window edges, as indices of hours
    first_s: float  # time of the first hour
    products: Floats  # (w, k), normalized so that their sum over windows is the correlation
    lags: Hours  # (k,)
    whole: float  # correlation of the speeds before high-passing, clocks as stated

    def along(self, path: LagPath) -> Floats:
        """Select each window's product at its lag, (w,)."""
        place = np.clip(path.hours - self.lags[0], 0, len(self.lags) - 1)
        return np.asarray(self.products[np.arange(len(place)), place])

    def best(self, allowed: Bools) -> LagPath:
        """Find the best lag for all windows among those allowed, (k,)."""
        total = np.where(allowed, self.products.sum(axis=0), -np.inf)
        return LagPath(np.full(len(self.products), self.lags[int(np.argmax(total))]))


def compare_speeds(upper: SpeedSeries, lower: SpeedSeries) -> ClockOffset:
    """Estimate the clock offset of the affected instrument (upper) and a reference from their current speeds."""
    if not (len(upper.time_s) and len(lower.time_s)) or (windows := _windows(upper, lower)) is None:
        return ClockOffset()
    stated = best = windows.best(np.abs(windows.lags) <= AS_STATED_H)
    constant = windows.best(windows.lags == windows.lags)
    stairs, unsure = _stepwise(windows), constant
    for path in (constant, _linear_drift(windows)):
        best = path if _score(windows, path, best) > SIGMAS else best
    if _score(windows, stairs, best) > SIGMAS:
        best, unsure = (stairs, unsure) if _unambiguous(windows, stairs) else (best, stairs)
    dense = max(float(np.median(np.diff(series.time_s))) for series in (upper, lower)) <= DENSE_S
    if dense and not best.set_at and np.abs(best.hours).max() <= SEARCHED_H:
        return _unrelated(windows, best)
    if best is stated:
        # Warn if another path fits better, though not significantly: one near the stated clocks, or a far better one.
        near = unsure.set_at or abs(unsure.hours[0]) <= 2 * NEAR_H
        far = float(windows.along(stated).sum()) < 0.5 * float(windows.along(unsure).sum())
        possible = (near or far) and _score(windows, unsure, stated) > SIGMAS_WARNED
        return _with_warning(windows, unsure, stated) if possible else _unrelated(windows, stated)
    inside = np.abs(best.hours).max() < windows.lags[-1]
    if not (inside and _score(windows, best, stated) > SIGMAS and _unambiguous(windows, best)):
        return _with_warning(windows, best, stated)
    nodes = _nodes(windows, best)
    warning = (
        f"by the speeds of the water the clock of the reference is {_in_words(best)} the affected one "
        f"(correlation {windows.along(best).sum():.2f}); pairs were made after correcting it: check "
        "clock_offset_seconds, time zone and date of both, as speeds do not show which of the two is wrong"
    )
    return ClockOffset(tuple(time for time, _ in nodes), tuple(hours for _, hours in nodes), (warning,))


def _windows(upper: SpeedSeries, lower: SpeedSeries) -> LagWindows | None:
    """Compute the lagged products of both series; None if they are too short or have too few common hours."""
    first_s = float(min(upper.time_s[0], lower.time_s[0]))
    hours = 1 + round((float(max(upper.time_s[-1], lower.time_s[-1])) - first_s) / HOUR_S)
    parts = []
    for series in (upper, lower):
        # Hourly high-passed speeds over their local rms (0 where missing), and where speeds exist.
        known = np.isfinite(series.speed)
        slot = np.rint((series.time_s[known] - first_s) / HOUR_S).astype(int)
        count = np.bincount(slot, minlength=hours)
        mean, present = np.bincount(slot, series.speed[known], hours) / np.maximum(count, 1), (count > 0).astype(float)
        fast = (mean - _running_mean(mean, present, SLOW_H)) * present
        whole = np.sum(fast**2) / max(float(present.sum()), 1.0)
        size = np.sqrt(np.maximum(_running_mean(fast**2, present, WEEK_H), QUIET**2 * whole))
        parts.append((np.clip(fast / np.maximum(size, 1e-12), -CLIP, CLIP), present, mean))
    (x, measured, upper_speed), (y, there, lower_speed) = parts
    if hours < SHORTEST_H or np.sum(measured * there) < MIN_COMMON_HOURS:
        return None
    reach = min(FARTHEST_H, hours // 3)
    edges = np.linspace(0, hours, hours // WINDOW_H + 1).astype(int)
    spans = list(itertools.pairwise(edges))
    products = np.array([_lagged(x, y, span, reach) for span in spans])
    counts = np.sum([_lagged(measured, there, span, reach) for span in spans], axis=0)
    scale = np.maximum(counts, FEWEST_SHARE * counts.max())
    both = measured * there > 0.0
    with np.errstate(invalid="ignore", divide="ignore"):  # a constant series has no correlation
        correlation = float(np.corrcoef(upper_speed[both], lower_speed[both])[0, 1])
    return LagWindows(x, y, edges, first_s, products / scale, np.arange(-reach, reach + 1), correlation)


def _running_mean(x: Floats, there: Floats, reach: int) -> Floats:
    """Compute the running mean of the existing values within ``reach`` hours of each hour, (n,)."""
    reach = min(reach, len(x) - 1)
    sums = [
        np.concatenate([np.zeros(reach + 1), np.cumsum(y * there), np.full(reach, np.sum(y * there))])
        for y in (x, there * 1)
    ]
    total, count = (total_[2 * reach + 1 :] - total_[: len(x)] for total_ in sums)
    return np.asarray(total / np.maximum(count, 1.0))


def _lagged(x: Floats, y: Floats, span: tuple[int, int], reach: int) -> Floats:
    """Compute the summed products of a span of x with y at lags -reach..reach hours, (2 reach + 1,)."""
    begin, end = span
    around = np.pad(y, reach)[begin : end + 2 * reach]
    size = 1 << (2 * len(around)).bit_length()
    product = np.conj(np.fft.rfft(x[begin:end], size)) * np.fft.rfft(around, size)
    return np.fft.irfft(product, size)[: 2 * reach + 1]


def _linear_drift(windows: LagWindows) -> LagPath:
    """Find the best lag path of a clock that drifts linearly."""
    share = np.linspace(0.0, 1.0, len(windows.products))
    begin = np.flatnonzero(np.abs(windows.lags) <= BEGAN_H)
    best, most = begin[:1], -np.inf
    for drift in range(-DRIFT_H, DRIFT_H + 1):
        way = np.rint(drift * share).astype(int)
        at = np.clip(begin[:, None] + way, 0, len(windows.lags) - 1)
        sums = windows.products[np.arange(len(way)), at].sum(axis=1)
        if sums.max() > most:
            most, best = sums.max(), at[int(np.argmax(sums))]
    return LagPath(windows.lags[best])


def _stepwise(windows: LagWindows) -> LagPath:
    """Find the best stepwise lag path over spans of ten days with a cost per step (Viterbi, IEEE Trans. IT 13, 260)."""
    span = np.arange(len(windows.products)) // SPAN
    sums = np.array([windows.products[span == k].sum(axis=0) for k in range(span[-1] + 1)])
    cost, came = CHANGE * float(np.std(sums[:, np.abs(windows.lags) > windows.lags[-1] // 2])), []
    total = sums[0]
    for row in sums[1:]:
        best = int(np.argmax(total))
        came.append(np.where(total < total[best] - cost, best, np.arange(len(total))))
        total = np.maximum(total, total[best] - cost) + row
    way = [int(np.argmax(total))]
    for origin in reversed(came):
        way.append(int(origin[way[-1]]))
    return LagPath(windows.lags[np.array(way[::-1])][span], set_at=True)


def _score(windows: LagWindows, path: LagPath, other: LagPath | None = None, part: Hours | None = None) -> float:
    """Compute the normal score of one path's gain over another, or over zero, in (some) windows (Wallace 1959)."""
    gain = windows.along(path)
    if other is not None:
        gain = np.where(path.hours != other.hours, gain - windows.along(other), np.nan)
    gain = gain[part] if part is not None else gain
    gain = gain[np.isfinite(gain)]
    if (freedom := len(gain) - 1) < 2:
        return 0.0
    t = float(gain.mean() / max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), 1e-12))
    size = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(freedom * np.log1p(t**2 / freedom))
    return float(np.sign(t) * size)


def _unambiguous(windows: LagWindows, path: LagPath) -> bool:
    """Check that each part of a path fits significantly better than any lag off its peak, tidal aliases included."""
    changes = np.flatnonzero(np.diff(path.hours) * path.set_at) + 1
    shifted = [replace(path, hours=path.hours + lag) for lag in windows.lags if abs(lag) > NEAR_H]
    sums = np.array([windows.along(other) for other in shifted])
    for part in np.split(np.arange(len(path.hours)), changes):
        rival = shifted[int(np.argmax(sums[:, part].sum(axis=1)))]
        if _score(windows, path, rival, part) <= SIGMAS:
            return False
    return True


def _unrelated(windows: LagWindows, stated: LagPath) -> ClockOffset:
    """Report if the speeds are uncorrelated over months."""
    alike = float(windows.along(stated).sum())
    shared = np.flatnonzero(np.add.reduceat(windows.upper * windows.lower != 0.0, windows.edges[:-1]))
    related = alike > RELATED and _score(windows, stated, part=shared) > RELATED_SIGMAS
    if related or windows.whole > RELATED_WHOLE or len(shared) * WINDOW_H < LONG_H:
        return ClockOffset()
    why = (
        f"the speeds of the two instruments are uncorrelated ({alike:.2f}) at any clock offset within "
        f"{windows.lags[-1] // DAY_H} days: check that both files are of this mooring and this year"
    )
    return ClockOffset(uncorrelated=why)


def _with_warning(windows: LagWindows, best: LagPath, stated: LagPath) -> ClockOffset:
    first, second = (float(windows.along(path).sum()) for path in (best, stated))
    warning = (
        f"by the speeds of the water the clock of the reference may be {_in_words(best)} the affected one "
        f"(correlation {first:.2f}, with the clocks as set {second:.2f}): not surely, and nothing was corrected; "
        "check clock_offset_seconds, time zone and date of both, and their files"
    )
    return ClockOffset(warnings=(warning,))


def _in_words(path: LagPath) -> str:
    lags = [int(path.hours[0]), *(int(lag) for before, lag in itertools.pairwise(path.hours) if lag != before)]
    if len(lags) == 1:
        return f"{abs(lags[0])} h {'ahead of' if lags[0] > 0 else 'behind'}"
    if path.set_at:
        return "first " + ", then ".join(f"{lag:+d} h" for lag in lags) + " ahead of"
    return f"{lags[0]:+d} h at the start and {lags[-1]:+d} h at the end ahead of"


def _nodes(windows: LagWindows, path: LagPath) -> list[tuple[float, float]]:
    ends = (windows.first_s, windows.first_s + HOUR_S * len(windows.upper))
    if not path.set_at:
        return [(ends[0], float(path.hours[0])), (ends[1], float(path.hours[-1]))]
    nodes, padded = [(ends[0], float(path.hours[0]))], np.pad(windows.lower, FARTHEST_H)
    for window in np.flatnonzero(np.diff(path.hours)) + 1:
        before, after = int(path.hours[window - 1]), int(path.hours[window])
        # Hour within a week of the window's edge at which the change fits best.
        edge = int(windows.edges[window])
        hours = np.arange(max(edge - WEEK_H, 0), min(edge + WEEK_H, len(windows.upper)))
        first, second = (windows.upper[hours] * padded[hours + FARTHEST_H + lag] for lag in (before, after))
        at = windows.first_s + HOUR_S * (int(hours[int(np.argmax(np.cumsum(first - second)))]) + 1)
        nodes += [(at - 1.0, float(before)), (at, float(after))]
    return nodes


SLACK_S = HOUR_S  # smaller steps back, or within SLACK_STEPS median steps, are jitter and are corrected by sorting
SLACK_STEPS = 5.0
CLASH_SHARE, MIN_RUN = 0.05, 3  # share and number of a run's samples; fewer within an earlier run's time are tolerated
SAME_SHARE = 0.9  # share of these with the values of the earlier run from which the run was read twice
COVERED = 0.9  # share of the deployment; a record that covers less causes a warning


def find_valid_times(record: Record) -> tuple[Bools, dict[str, int], list[str]]:
    """Find samples with a valid time, (n,), count the others, and compose warnings about them."""
    time_s = record.time_s
    finite = np.isfinite(time_s)
    keep = finite.copy()
    keep[finite] = ~_outlying(time_s[finite])
    wild = int(np.sum(~keep))
    index = np.flatnonzero(keep)
    back = np.flatnonzero(np.diff(time_s[index]) < -_slack(time_s[index])) + 1  # by more than jitter
    runs = sorted(np.split(index, back), key=lambda part: len(part) < MIN_RUN) if len(index) else []
    clashing = [run for k, run in enumerate(runs) if _clashes(run, runs, k, record)]
    for run in clashing:
        keep[run] = False
    lost = sum(len(run) for run in clashing)
    warnings = [f"{wild} samples have a time far from their neighbours' and were left out"] * bool(wild)
    if lost:
        spans = ", ".join(_span(time_s[run]) for run in clashing[:3])
        warnings.append(
            f"the clock was set back {len(clashing)} times into time already recorded: the {lost} samples after that "
            f"({spans} by their clock) were left out; give them as a file of their own with clock_offset_seconds"
        )
    return keep, {"time_wild": wild, "clock_unsure": lost}, warnings


def check_coverage(time_s: Floats, inside: Bools, start_s: float, end_s: float) -> list[str]:
    """Warn if many samples lie outside the deployment, or if much of the deployment has none."""
    if not len(time_s):
        return ["there is no sample with a time"]
    outside = time_s[~inside]
    span = f"{_day(time_s.min())} to {_day(time_s.max())}"
    if len(outside) > 0.5 * len(time_s):
        return [f"{len(outside)} of {len(time_s)} samples ({span}) lie outside the deployment: check clock and dates"]
    covered = np.ptp(time_s[inside]) / (end_s - start_s)
    if covered < COVERED:
        return [f"the record covers {covered:.0%} of the deployment ({_span(time_s[inside])})"]
    return []


def _slack(time_s: Floats) -> float:
    steps = np.abs(np.diff(time_s))
    return max(SLACK_S, SLACK_STEPS * float(np.median(steps))) if len(steps) else SLACK_S


def _outlying(time_s: Floats) -> Bools:
    """Find single times that are far from both neighbours, which are close to each other."""
    outlying = np.zeros(time_s.shape, dtype=bool)
    if len(time_s) < MIN_RUN:
        return outlying
    slack, steps = _slack(time_s), np.diff(time_s)
    apart = (np.abs(steps[:-1]) > slack) & (np.abs(steps[1:]) > slack) & (steps[:-1] * steps[1:] < 0)
    across = time_s[2:] - time_s[:-2]
    outlying[1:-1] = apart & (across >= 0) & (across <= 2.0 * slack)
    # Adjacent outliers, as from two recordings interleaved sample by sample, are not single errors.
    return outlying & ~(np.roll(outlying, 1) | np.roll(outlying, -1))


def _clashes(run: NDArray[np.intp], runs: list[NDArray[np.intp]], k: int, record: Record) -> bool:
    """Check whether a run lies within time that earlier runs have filled with other values."""
    if k == 0:
        return False
    before = np.sort(np.concatenate(runs[:k]))
    before = before[np.argsort(record.time_s[before], kind="stable")]
    taken, at = record.time_s[before], record.time_s[run]
    right = np.clip(np.searchsorted(taken, at), 0, len(taken) - 1)
    left = np.clip(np.searchsorted(taken, at, side="right") - 1, 0, len(taken) - 1)
    filled = (at >= taken[left]) & (at <= taken[right]) & (taken[right] - taken[left] <= _slack(taken))
    if filled.sum() <= max(CLASH_SHARE * len(run), min(MIN_RUN, len(run)) - 1):
        return False
    return float(same_samples(record, run[filled], before[left[filled]]).mean()) < SAME_SHARE


def same_samples(record: Record, first: NDArray[np.intp], second: NDArray[np.intp]) -> Bools:
    """Compare heading and velocities of two sets of samples, (k,); True where all are equal."""
    same = np.ones(len(first), dtype=bool)
    for values in (record.heading_deg, record.east, record.north):
        a, b = values[first], values[second]
        same &= ((a == b) | (np.isnan(a) & np.isnan(b))).reshape(len(first), -1).all(axis=1)
    return same


def _span(time_s: Floats) -> str:
    return f"{_day(time_s.min())} to {_day(time_s.max())}"


def _day(time_s: float) -> str:
    try:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d}"
    except (ValueError, OverflowError, OSError):
        return f"{time_s:.3g} s"
