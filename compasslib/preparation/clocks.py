"""Clocks: valid times of a recording, and offsets of hours to a month between two instruments.

A clock that jumps back into time already recorded was reset: the samples after it have no known time.

Offsets are estimated from current speeds, which do not depend on a compass, in windows of days at every hourly lag. A
lag is accepted if it fits better than the stated clocks, and than every other lag including tidal aliases, by more than
the scatter between windows. Drifts, and errors of a few hours, are left to the search for unmodelled effects.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.records import Record
from compasslib.statistics.whitening import grid_positions, sampling_interval_s
from compasslib.types import DAY_S, HOUR_S, YEAR_S, Bools, Floats

SpeedSeries = tuple[Floats, Floats]  # times and speeds, m/s, NaN where nothing was measured, (n,) each


@dataclass(frozen=True)
class ClockOffset:
    """Accepted offset of the reference's clock relative to the affected instrument's, reference ahead positive."""

    ahead_h: float = 0.0  #: hours by which the reference's clock is ahead
    warnings: tuple[str, ...] = ()  #: sentences for the report
    uncorrelated: str = ""  #: why the records may be of different places or times, else empty

    def align(self, record: Record) -> Record:
        """Convert the reference's record to the affected clock."""
        return replace(record, time_s=record.time_s - HOUR_S * self.ahead_h) if self.ahead_h else record


def compare_speeds(upper: SpeedSeries, lower: SpeedSeries) -> ClockOffset:
    """Estimate the clock offset of the affected instrument (upper) and a reference from their current speeds."""
    sigmas = 4.0  # normal score by which a lag must fit better than any other
    near_h = 6  # half-width of a peak; the next tidal alias is 12 hours away
    if not (len(upper[0]) and len(lower[0])) or (products := _multiply(upper, lower)) is None:
        return ClockOffset()
    sums, both, whole = products
    lags_h, correlation = np.arange(sums.shape[1]) - sums.shape[1] // 2, sums.sum(axis=0)
    # Currents are delayed by up to an hour between two depths.
    stated, best = int(np.argmax(np.where(np.abs(lags_h) <= 1, correlation, -np.inf))), int(np.argmax(correlation))
    step_s = max(float(np.median(np.diff(time_s))) for time_s, _ in (upper, lower))
    # The search resolves these more finely, unless half a tide lies between the clocks: no fit is possible then.
    searched = step_s <= 2 * HOUR_S and abs(lags_h[best]) <= near_h and correlation[stated] > 0.0
    if searched or _score(sums[:, best] - sums[:, stated]) <= sigmas:
        shared = sums[both, best if searched else stated]
        if _score(shared) > 3.0 or whole > 0.5 or len(shared) < 30:
            return ClockOffset()
        why = (
            f"the speeds of the two instruments are uncorrelated ({shared.sum():.2f}) at any clock offset within "
            f"{lags_h[-1] // 24} days: check that both files are of this mooring and this year"
        )
        return ClockOffset(uncorrelated=why)
    rival = int(np.argmax(np.where(np.abs(lags_h - lags_h[best]) > near_h, correlation, -np.inf)))
    sure = abs(lags_h[best]) < lags_h[-1] and _score(sums[:, best] - sums[:, rival]) > sigmas
    lag_h, first, second = int(lags_h[best]), float(sums[:, best].sum()), float(sums[:, stated].sum())
    done = "pairs were made after correcting it" if sure else "not surely, and nothing was corrected"
    warning = (
        f"by the speeds of the water the clock of the reference {'is' if sure else 'may be'} {abs(lag_h)} h "
        f"{'ahead of' if lag_h > 0 else 'behind'} the affected one (correlation {first:.2f}, with the clocks as set "
        f"{second:.2f}); {done}: check clock_offset_seconds, time zone and date of both, as speeds do not show "
        "which is wrong"
    )
    return ClockOffset(float(lag_h) if sure else 0.0, (warning,))


def _multiply(upper: SpeedSeries, lower: SpeedSeries) -> tuple[Floats, Bools, float] | None:
    """Multiply the two high-passed speeds in windows of two days, at each hourly lag up to 45 days.

    Returns:
        Products, (w, k), whose sum over windows is the correlation; whether both measured in each window, (w,); and
        the correlation before high-passing, clocks as stated. None if the series are too short.
    """
    window_h = 48  # high-passed speeds decorrelate within half a day
    first_s = float(min(upper[0][0], lower[0][0]))
    hours = 1 + round((float(max(upper[0][-1], lower[0][-1])) - first_s) / HOUR_S)
    if hours < 10 * window_h:
        return None
    (x, measured, upper_speed), (y, there, lower_speed) = (_hourly(series, first_s, hours) for series in (upper, lower))
    both = measured * there > 0.0
    if both.sum() < window_h:
        return None
    reach = min(45 * 24, hours // 3)
    edges = np.linspace(0, hours, hours // window_h + 1).astype(int)

    def lagged(first: Floats, second: Floats) -> Floats:
        around = np.pad(second, reach)
        spans = itertools.pairwise(edges.tolist())
        return np.array([np.correlate(around[a : b + 2 * reach], first[a:b], "valid") for a, b in spans])

    counts = lagged(measured, there).sum(axis=0)
    scale = np.maximum(counts, 0.3 * counts.max())  # so that lags with few common hours do not win by chance
    with np.errstate(invalid="ignore", divide="ignore"):  # a constant series has no correlation
        whole = float(np.corrcoef(upper_speed[both], lower_speed[both])[0, 1])
    return lagged(x, y) / scale, np.add.reduceat(both, edges[:-1]) > 0, whole


def _hourly(series: SpeedSeries, first_s: float, hours: int) -> tuple[Floats, Floats, Floats]:
    """Average speeds by the hour; return them high-passed in units of their rms, the hours that have one, and them.

    The running mean of 73 hours is removed, as slow changes of speed do not resolve hours.
    """
    time_s, speed = (column[np.isfinite(series[1])] for column in series)
    slot = np.rint((time_s - first_s) / HOUR_S).astype(int)
    count = np.bincount(slot, minlength=hours)
    mean, present = np.bincount(slot, speed, hours) / np.maximum(count, 1), (count > 0).astype(float)
    fast = _high_pass(mean * present, present, 73)
    rms = np.sqrt(np.sum(fast**2) / max(float(present.sum()), 1.0))
    return np.clip(fast / max(rms, 1e-12), -3.0, 3.0), present, mean  # clipped, as a storm would outweigh months


def speed_delays(
    time_s: Floats, upper: Floats, lower: Floats, separation_h: Floats | float = 0.0
) -> tuple[Floats, Floats, float]:
    """Estimate how much later the upper of two series of speeds, (n,) m/s, NaN where missing, is in up to 16 windows.

    Args:
        separation_h: times of the lower series minus ``time_s``, (n,).

    Returns:
        Years since the first sample and delays in hours of the windows in which the speeds are correlated, (w,), and
        years of the record. No window if the interval exceeds two hours, or the record is shorter than ten days.
    """
    most_windows, fewest_samples, slow_h, clearest = 16, 100, 12.0, 0.2
    step_s = sampling_interval_s(time_s)
    if step_s > 2.0 * HOUR_S or len(time_s) < fewest_samples or np.ptp(time_s) < 10.0 * DAY_S:
        return np.zeros(0), np.zeros(0), 0.0
    slot = grid_positions(time_s)
    count, span = slot[-1] + 1, 2 * max(int(slow_h * HOUR_S / step_s), 1) + 1
    fast = np.zeros((2, count))  # on a regular grid, high-pass filtered, 0 where missing
    for series, speed in zip(fast, (upper, lower), strict=True):
        grid, present = np.zeros(count), np.zeros(count)
        grid[slot], present[slot] = np.nan_to_num(speed), np.isfinite(speed)
        series[:] = _high_pass(grid, present, span)
    width = max(count // most_windows, fewest_samples)
    begins = np.arange(0, count - width + 1, width)
    later = np.interp(np.arange(count), slot, np.broadcast_to(separation_h, len(slot)))
    delays = [_peak_h(fast[:, k : k + width], step_s, clearest) - later[k : k + width].mean() for k in begins.tolist()]
    clear = np.isfinite(delays)
    return ((begins + width / 2.0) * step_s / YEAR_S)[clear], np.array(delays)[clear], count * step_s / YEAR_S


def _high_pass(values: Floats, present: Floats, span: int) -> Floats:
    """Subtract the running mean over a number of samples, (n,); 0 where no value is present."""
    total, near = (np.convolve(x, np.ones(span), "same") for x in (values, present))
    return (values - total / np.maximum(near, 1.0)) * present


def _peak_h(speeds: Floats, step_s: float, least: float) -> float:
    """Find the hours by which the upper of two series is later, from their correlation; NaN below ``least``."""
    upper, lower = speeds
    reach = int(12 * HOUR_S / step_s)  # time zones; at longer lags tides repeat
    size = 1 << (2 * len(upper)).bit_length()
    product = np.fft.irfft(np.conj(np.fft.rfft(upper, size)) * np.fft.rfft(lower, size), size)
    lags = np.arange(-reach, reach + 1)
    cross = product[lags] / max(float(np.linalg.norm(upper) * np.linalg.norm(lower)), 1e-12)
    k = int(np.argmax(cross))
    if cross[k] < least or k in (0, len(cross) - 1):
        return float("nan")
    before, at, after = (float(cross[j]) for j in (k - 1, k, k + 1))
    top = 0.5 * (before - after) / (before - 2.0 * at + after)
    return -(float(lags[k]) + top) * step_s / HOUR_S


def _score(gain: Floats) -> float:
    """Compute the normal score of the mean of independent gains, (w,), from Student's t (Wallace 1959)."""
    if (freedom := len(gain) - 1) < 2:
        return 0.0
    t = float(gain.mean() / max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), 1e-12))
    size = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(freedom * np.log1p(t**2 / freedom))
    return float(np.sign(t) * size)


def find_valid_times(record: Record) -> tuple[Bools, dict[str, int], list[str]]:
    """Find samples with a valid time, (n,), count the others, and compose warnings about them."""
    time_s = record.time_s
    finite = np.isfinite(time_s)
    keep, known = finite.copy(), time_s[finite]
    if len(known) >= 3:  # single times that are far from both neighbours, which are close to each other
        slack, steps, across = _slack(known), np.diff(known), known[2:] - known[:-2]
        apart = (np.abs(steps[:-1]) > slack) & (np.abs(steps[1:]) > slack) & (steps[:-1] * steps[1:] < 0)
        outlying = np.pad(apart & (across >= 0) & (across <= 2.0 * slack), 1)
        # Adjacent outliers, as from two recordings interleaved sample by sample, are not single errors.
        keep[finite] = ~outlying | np.roll(outlying, 1) | np.roll(outlying, -1)
    wild = int(np.sum(~keep))
    index = np.flatnonzero(keep)
    back = np.flatnonzero(np.diff(time_s[index]) < -_slack(time_s[index])) + 1  # by more than jitter
    runs = sorted(np.split(index, back), key=lambda part: len(part) < 3) if len(index) else []
    clashing = [run for k, run in enumerate(runs) if _clashes(run, runs[:k], record)]
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
    """Warn if most samples lie outside the deployment, or if less than 90 % of it is covered."""
    if not len(time_s):
        return ["there is no sample with a time"]
    outside, samples = int(np.sum(~inside)), f"samples ({_span(time_s)})"
    if outside > 0.5 * len(time_s):
        return [f"{outside} of {len(time_s)} {samples} lie outside the deployment: check clock and dates"]
    covered = np.ptp(time_s[inside]) / (end_s - start_s)
    uncovered = f"the record covers {covered:.0%} of the deployment ({_span(time_s[inside])})"
    return [uncovered] * bool(covered < 0.9)


def _slack(time_s: Floats) -> float:
    """Compute the largest step back, an hour or five usual steps, that is jitter and corrected by sorting."""
    steps = np.abs(np.diff(time_s))
    return max(HOUR_S, 5.0 * float(np.median(steps))) if len(steps) else HOUR_S


def _clashes(run: NDArray[np.intp], earlier: list[NDArray[np.intp]], record: Record) -> bool:
    """Check whether a run lies within time that earlier runs have filled with other values.

    One or two samples may do so, or 5 %; where 90 % of them have the earlier values the run was read twice.
    """
    if not earlier:
        return False
    before = np.sort(np.concatenate(earlier))
    before = before[np.argsort(record.time_s[before], kind="stable")]
    taken, at = record.time_s[before], record.time_s[run]
    right = np.clip(np.searchsorted(taken, at), 0, len(taken) - 1)
    left = np.clip(np.searchsorted(taken, at, side="right") - 1, 0, len(taken) - 1)
    filled = (at >= taken[left]) & (at <= taken[right]) & (taken[right] - taken[left] <= _slack(taken))
    if filled.sum() <= max(0.05 * len(run), min(2, len(run) - 1)):
        return False
    return float(same_samples(record, run[filled], before[left[filled]]).mean()) < 0.9


def same_samples(record: Record, first: NDArray[np.intp], second: NDArray[np.intp]) -> Bools:
    """Compare heading and velocities of two sets of samples, (k,); True where all are equal."""
    same = np.ones(len(first), dtype=bool)
    for values in (record.heading_deg, record.east, record.north):
        a, b = values[first], values[second]
        same &= ((a == b) | (np.isnan(a) & np.isnan(b))).reshape(len(first), -1).all(axis=1)
    return same


def _span(time_s: Floats) -> str:
    with np.errstate(invalid="ignore"):  # a damaged time may be beyond any date, and is shown as NaT
        ends = np.array([time_s.min(), time_s.max()]).astype("datetime64[s]")
    return " to ".join(ends.astype("datetime64[D]").astype(str))


# Samples on a regular time grid, and series, (n,), interpolated to given times, (k,).

Indices = NDArray[np.intp]


def _neighbours(series_s: Floats, at_s: Floats) -> tuple[Indices, Indices]:
    """Find the indices of the samples before and after each time, (k,); both the same in a series of one."""
    right = np.clip(np.searchsorted(series_s, at_s), 1, max(len(series_s) - 1, 1))
    return right - 1, np.minimum(right, len(series_s) - 1)


def nearest_index(series_s: Floats, at_s: Floats) -> Indices:
    """Find the index of the sample nearest to each time, (k,); the series must not be empty."""
    left, right = _neighbours(series_s, at_s)
    return np.where(at_s - series_s[left] <= series_s[right] - at_s, left, right)


def grid_indices(time_s: Floats, *, step_s: float, tolerance_s: float) -> Indices:
    """Select the samples nearest to the nodes of a regular grid, within a tolerance and without repetition.

    The grid adopts the sampling phase of the series, so that an hourly record is its own grid. Headings are never
    interpolated: a compass near iron has no meaningful value between two recorded ones.
    """
    if not len(time_s):
        return np.zeros(0, dtype=np.intp)
    phase = common_phase(time_s, step_s)
    first = np.floor((time_s[0] - phase) / step_s)
    nodes = phase + step_s * np.arange(first, np.ceil((time_s[-1] - phase) / step_s) + 1)
    index = nearest_index(time_s, nodes)
    return np.unique(index[np.abs(time_s[index] - nodes) <= tolerance_s])


def interpolate_series(series_s: Floats, values: NDArray, at_s: Floats, *, tolerance_s: float) -> NDArray:
    """Interpolate real or complex values linearly across gaps up to twice the tolerance, else take the nearest.

    The result is NaN where the nearest sample is farther than the tolerance.
    """
    if not len(series_s):
        return np.full(len(at_s), np.nan, dtype=values.dtype)
    near, (left, right) = nearest_index(series_s, at_s), _neighbours(series_s, at_s)
    gap = series_s[right] - series_s[left]
    bridged = (gap > 0) & (gap <= 2.0 * tolerance_s) & (at_s >= series_s[left]) & (at_s <= series_s[right])
    weight = np.where(bridged, (at_s - series_s[left]) / np.where(gap > 0, gap, 1.0), 0.0)
    linear = values[left] * (1.0 - weight) + values[right] * weight
    taken = np.where(bridged, linear, values[near])
    return np.where(np.abs(series_s[near] - at_s) <= tolerance_s, taken, np.nan)


def common_phase(time_s: Floats, step_s: float) -> float:
    """Estimate the common phase of the samples within a step, seconds."""
    mean = np.exp(2j * np.pi * (time_s % step_s) / step_s).mean()
    # Without a common phase where a step has several samples.
    return 0.0 if abs(mean) < 0.1 else float(np.angle(mean) / (2 * np.pi) * step_s)
