"""Clock offsets of hours, days or a month between two instruments, by the speeds of the water: no compass is in them.

Speeds without their slow part are multiplied in windows of days at every hour's lag. A lag is accepted where it beats
the clocks as stated, and every other lag with its tidal aliases, by more than the windows' own scatter. Clocks
that drift, or that were set in between, are looked for alike. Errors of a few hours between hourly records are left to
the search for unmodelled effects, which reads them more finely and names them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.records import Record, take
from compasslib.types import Floats

Hours = NDArray[np.intp]

HOUR_S, DAY_H = 3600.0, 24
FARTHEST_H = 45 * DAY_H  # a wrong month, with days to spare
DRIFT_H, BEGAN_H = 72, 5 * DAY_H  # the most that a clock is looked for to have drifted, and to be off where it begins
SLOW_H = 36  # half of the running mean that is taken off: weeks of strong and of weak flow tell no hour
WINDOW_H, WEEK_H = 2 * DAY_H, 7 * DAY_H  # speeds without their slow part remember half a day
SHORTEST_H, FEWEST = 20 * DAY_H, 60  # hours of the record, hours that both measured
LONG_H = 60 * DAY_H  # from here on speeds that have nothing in common are reported
CLIP, QUIET = 3.0, 0.2  # of speeds over their scatter of days, which counts as no less than this share of the whole
SIGMAS, SIGMAS_WARNED = 4.0, 2.0  # normal score of a lag that is accepted, and of one that is reported
NEAR_H = 6  # shoulders of a peak; the next tidal alias is 12 hours away
AS_STATED_H = 1  # water that arrives at one depth later delays by less
SEARCHED_H, DENSE_S = 6, 2 * HOUR_S  # what the search for unmodelled effects reads finely
SPAN = 5  # windows of ten days together
CHANGE = 8.0  # what setting a clock costs, in the scatter of that many windows: two lags of 2000 gain less by chance
FEWEST_SHARE = 0.3  # of hours that meet at a lag, below which its products count for less
RELATED, RELATED_SIGMAS = 0.05, 3.0  # correlation of speeds and its score below which two records share nothing


@dataclass(frozen=True)
class Speeds:
    """A series of speeds, (n,) each."""

    time_s: Floats
    speed: Floats  # m/s, NaN where nothing was measured


@dataclass(frozen=True)
class Clocks:
    """By how much the reference's clock is ahead of the affected one, as far as it is to be corrected."""

    time_s: tuple[float, ...] = (0.0,)  # by the affected clock, linear between
    ahead_h: tuple[float, ...] = (0.0,)
    warnings: tuple[str, ...] = ()
    one_recording: str = ""  # why both records are one, and no pair counts

    def aligned(self, record: Record) -> Record:
        """Return the reference's record by the affected clock, without hours that a clock set back counted twice."""
        if not any(self.ahead_h):
            return record
        time_s = record.time_s
        for _ in range(2):  # the error is known by the other clock
            time_s = record.time_s - HOUR_S * np.interp(time_s, self.time_s, self.ahead_h)
        later = np.append(True, time_s[1:] > np.maximum.accumulate(time_s)[:-1])
        return take(replace(record, time_s=time_s), later)


@dataclass(frozen=True)
class Path:
    """A lag for each of w windows, hours by which the reference's clock is ahead."""

    hours: Hours  # (w,)
    set_at: bool = False  # whether it changes because a clock was set, and not by its drift


@dataclass(frozen=True)
class Windows:
    """Products of the two speeds in each of w windows at each of k lags."""

    upper: Floats  # (n,) each hour's speed without its slow part, 0 where none
    lower: Floats  # (n,) by the reference's clock
    edges: Hours  # (w + 1,) of the windows among the hours
    first_s: float  # the first hour
    products: Floats  # (w, k), whose sum is the correlation
    lags: Hours  # (k,)

    def along(self, path: Path) -> Floats:
        """Return each window's product at its lag, (w,).

        Args:
            path: a lag for each window.
        """
        place = np.clip(path.hours - self.lags[0], 0, len(self.lags) - 1)
        return np.asarray(self.products[np.arange(len(place)), place])

    def best(self, allowed: NDArray[np.bool_]) -> Path:
        """Return the best lag for all windows.

        Args:
            allowed: which may be, (k,).
        """
        total = np.where(allowed, self.products.sum(axis=0), -np.inf)
        return Path(np.full(len(self.products), self.lags[int(np.argmax(total))]))


def compare(upper: Speeds, lower: Speeds) -> Clocks:
    """Return what the speeds say of the clocks.

    Args:
        upper: of the affected instrument.
    """
    if not (len(upper.time_s) and len(lower.time_s)) or (found := _windows(upper, lower)) is None:
        return Clocks()
    stated = best = found.best(np.abs(found.lags) <= AS_STATED_H)
    constant = found.best(found.lags == found.lags)
    stairs, unsure = _stepwise(found), constant
    for path in (constant, _linear_drift(found)):
        best = path if _score(found, path, best) > SIGMAS else best
    if _score(found, stairs, best) > SIGMAS:
        best, unsure = (stairs, unsure) if _unambiguous(found, stairs) else (best, stairs)
    dense = max(float(np.median(np.diff(series.time_s))) for series in (upper, lower)) <= DENSE_S
    if dense and not best.set_at and np.abs(best.hours).max() <= SEARCHED_H:
        return _unrelated(found, best)
    if best is stated:
        return _with_warning(found, unsure, stated) if _possible(found, unsure, stated) else _unrelated(found, stated)
    inside = np.abs(best.hours).max() < found.lags[-1]
    proven = inside and _score(found, best, stated) > SIGMAS and _unambiguous(found, best)
    return _to_correct(found, best) if proven else _with_warning(found, best, stated)


def _windows(upper: Speeds, lower: Speeds) -> Windows | None:
    """Return the products of both series, None where there is too little."""
    first_s = float(min(upper.time_s[0], lower.time_s[0]))
    hours = 1 + round((float(max(upper.time_s[-1], lower.time_s[-1])) - first_s) / HOUR_S)
    (x, seen), (y, there) = (_high_passed(series, first_s, hours) for series in (upper, lower))
    if hours < SHORTEST_H or np.sum(seen * there) < FEWEST:
        return None
    reach = min(FARTHEST_H, hours // 3)
    edges = np.linspace(0, hours, hours // WINDOW_H + 1).astype(int)
    spans = list(itertools.pairwise(edges))
    products = np.array([_lagged(x, y, span, reach) for span in spans])
    counts = np.sum([_lagged(seen, there, span, reach) for span in spans], axis=0)
    scale = np.maximum(counts, FEWEST_SHARE * counts.max())
    return Windows(x, y, edges, first_s, products / scale, np.arange(-reach, reach + 1))


def _high_passed(series: Speeds, first_s: float, hours: int) -> tuple[Floats, Floats]:
    """Return hourly speeds without their slow part, over their scatter of days, 0 where none; where there are any."""
    known = np.isfinite(series.speed)
    slot = np.rint((series.time_s[known] - first_s) / HOUR_S).astype(int)
    count = np.bincount(slot, minlength=hours)
    mean, there = np.bincount(slot, series.speed[known], hours) / np.maximum(count, 1), (count > 0).astype(float)
    fast = (mean - _running_mean(mean, there, SLOW_H)) * there
    whole = np.sum(fast**2) / max(float(there.sum()), 1.0)
    size = np.sqrt(np.maximum(_running_mean(fast**2, there, WEEK_H), QUIET**2 * whole))
    return np.clip(fast / np.maximum(size, 1e-12), -CLIP, CLIP), there


def _running_mean(x: Floats, there: Floats, reach: int) -> Floats:
    """Return the mean of what is there within a reach of hours of each, (n,)."""
    reach = min(reach, len(x) - 1)
    sums = [
        np.concatenate([np.zeros(reach + 1), np.cumsum(y * there), np.full(reach, np.sum(y * there))])
        for y in (x, there * 1)
    ]
    total, count = (one[2 * reach + 1 :] - one[: len(x)] for one in sums)
    return np.asarray(total / np.maximum(count, 1.0))


def _lagged(x: Floats, y: Floats, span: tuple[int, int], reach: int) -> Floats:
    """Return the sums of a span of one series times the other -reach..reach hours later, (2 reach + 1,)."""
    begin, end = span
    around = np.pad(y, reach)[begin : end + 2 * reach]
    size = 1 << (2 * len(around)).bit_length()
    product = np.conj(np.fft.rfft(x[begin:end], size)) * np.fft.rfft(around, size)
    return np.fft.irfft(product, size)[: 2 * reach + 1]


def _linear_drift(found: Windows) -> Path:
    """Return the best way of a clock that drifts evenly."""
    share = np.linspace(0.0, 1.0, len(found.products))
    begin = np.flatnonzero(np.abs(found.lags) <= BEGAN_H)
    best, most = begin[:1], -np.inf
    for drift in range(-DRIFT_H, DRIFT_H + 1):
        way = np.rint(drift * share).astype(int)
        at = np.clip(begin[:, None] + way, 0, len(found.lags) - 1)
        sums = found.products[np.arange(len(way)), at].sum(axis=1)
        if sums.max() > most:
            most, best = sums.max(), at[int(np.argmax(sums))]
    return Path(found.lags[best])


def _stepwise(found: Windows) -> Path:
    """Return the best way through spans of ten days where each change costs (Viterbi, IEEE Trans. IT 13, 260)."""
    span = np.arange(len(found.products)) // SPAN
    sums = np.array([found.products[span == k].sum(axis=0) for k in range(span[-1] + 1)])
    cost, came = CHANGE * float(np.std(sums[:, np.abs(found.lags) > found.lags[-1] // 2])), []
    total = sums[0]
    for row in sums[1:]:
        best = int(np.argmax(total))
        came.append(np.where(total < total[best] - cost, best, np.arange(len(total))))
        total = np.maximum(total, total[best] - cost) + row
    way = [int(np.argmax(total))]
    for origin in reversed(came):
        way.append(int(origin[way[-1]]))
    return Path(found.lags[np.array(way[::-1])][span], set_at=True)


def _score(found: Windows, path: Path, other: Path | None = None, part: Hours | None = None) -> float:
    """Return the normal score by which (some) windows prefer one path to another, or to none (Wallace 1959)."""
    gain = found.along(path)
    if other is not None:
        gain = np.where(path.hours != other.hours, gain - found.along(other), np.nan)
    gain = gain[part] if part is not None else gain
    gain = gain[np.isfinite(gain)]
    if (freedom := len(gain) - 1) < 2:
        return 0.0
    t = float(gain.mean() / max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), 1e-12))
    size = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(freedom * np.log1p(t**2 / freedom))
    return float(np.sign(t) * size)


def _unambiguous(found: Windows, path: Path) -> bool:
    """Tell whether no other lag beyond a peak's shoulders, tidal aliases among them, does nearly as well anywhere."""
    changes = np.flatnonzero(np.diff(path.hours) * path.set_at) + 1
    beside = [replace(path, hours=path.hours + lag) for lag in found.lags if abs(lag) > NEAR_H]
    sums = np.array([found.along(other) for other in beside])
    for part in np.split(np.arange(len(path.hours)), changes):
        rival = beside[int(np.argmax(sums[:, part].sum(axis=1)))]
        if _score(found, path, rival, part) <= SIGMAS:
            return False
    return True


def _possible(found: Windows, path: Path, stated: Path) -> bool:
    """Tell whether another path does better than the clocks as stated, near them or by far, though not surely."""
    near = path.set_at or abs(path.hours[0]) <= 2 * NEAR_H
    far = float(found.along(stated).sum()) < 0.5 * float(found.along(path).sum())
    return (near or far) and _score(found, path, stated) > SIGMAS_WARNED


def _unrelated(found: Windows, stated: Path) -> Clocks:
    """Say where months of speeds have nothing in common."""
    alike = float(found.along(stated).sum())
    if len(found.upper) < LONG_H or (alike > RELATED and _score(found, stated) > RELATED_SIGMAS):
        return Clocks()
    warning = (
        f"the speeds of the two instruments are uncorrelated ({alike:.2f}) at any clock offset within "
        f"{found.lags[-1] // DAY_H} days: check that both files are of this mooring and this year"
    )
    return Clocks(warnings=(warning,))


def _with_warning(found: Windows, best: Path, stated: Path) -> Clocks:
    first, second = (float(found.along(path).sum()) for path in (best, stated))
    warning = (
        f"by the speeds of the water the clock of the reference may be {_in_words(best)} the affected one "
        f"(correlation {first:.2f}, with the clocks as set {second:.2f}): not surely, and nothing was corrected; "
        "check clock_offset_seconds, time zone and date of both, and their files"
    )
    return Clocks(warnings=(warning,))


def _to_correct(found: Windows, best: Path) -> Clocks:
    """Return a clock that the windows prove, to be put right."""
    nodes = _nodes(found, best)
    warning = (
        f"by the speeds of the water the clock of the reference is {_in_words(best)} the affected one "
        f"(correlation {found.along(best).sum():.2f}); pairs were made after correcting it: check "
        "clock_offset_seconds, time zone and date of both, as speeds do not show which of the two is wrong"
    )
    return Clocks(tuple(time for time, _ in nodes), tuple(hours for _, hours in nodes), (warning,))


def _in_words(path: Path) -> str:
    lags = [int(path.hours[0]), *(int(lag) for before, lag in itertools.pairwise(path.hours) if lag != before)]
    if len(lags) == 1:
        return f"{abs(lags[0])} h {'ahead of' if lags[0] > 0 else 'behind'}"
    if path.set_at:
        return "first " + ", then ".join(f"{lag:+d} h" for lag in lags) + " ahead of"
    return f"{lags[0]:+d} h at the start and {lags[-1]:+d} h at the end ahead of"


def _nodes(found: Windows, path: Path) -> list[tuple[float, float]]:
    """Return instants and hours between which the error is linear."""
    ends = (found.first_s, found.first_s + HOUR_S * len(found.upper))
    if not path.set_at:
        return [(ends[0], float(path.hours[0])), (ends[1], float(path.hours[-1]))]
    nodes = [(ends[0], float(path.hours[0]))]
    for window in np.flatnonzero(np.diff(path.hours)) + 1:
        before, after = int(path.hours[window - 1]), int(path.hours[window])
        at = found.first_s + HOUR_S * _set_at(found, int(found.edges[window]), before, after)
        nodes += [(at - 1.0, float(before)), (at, float(after))]
    return nodes


def _set_at(found: Windows, edge: int, before: int, after: int) -> int:
    """Return the hour within a week of an edge at which a change of the lag fits best."""
    hours = np.arange(max(edge - WEEK_H, 0), min(edge + WEEK_H, len(found.upper)))
    padded = np.pad(found.lower, FARTHEST_H)
    first, second = (found.upper[hours] * padded[hours + FARTHEST_H + lag] for lag in (before, after))
    return int(hours[int(np.argmax(np.cumsum(first - second)))]) + 1
