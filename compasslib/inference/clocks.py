"""The clocks of the two instruments, from the speeds that both measured: no compass is in them.

The time by which one series of speeds trails the other is estimated in some sixteen windows, so that the record itself
says how sure it is. Water that arrives at one depth later looks the same, by 0.2 h where no clock was wrong.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.deviation import model
from compasslib.effects.term import HOUR_S, YEAR_S
from compasslib.records import Pairs, take
from compasslib.statistics import whitening
from compasslib.types import Floats

LEAST_HOURS = 0.3  # real water delays by less
WINDOWS, FEWEST_IN_WINDOW = 16, 100  # in which the clocks are compared
LONGEST_HOURS = 12.0  # time zones; beyond, tides repeat
SLOW_HOURS = 12.0  # half of the running mean that is taken off
SIGMAS = 4.0  # normal score of what is named
CLOSE = 10.0
# Delay between the instruments that is no clock: water that arrives at one depth later (0.21 h in a real record of one
# instrument with one clock), stamps at the begin, middle or end of an average. Assumed.
DELAY_SIGMA_H = 0.1  # delay of real water itself, over a whole record
CLEAREST = 0.2  # correlation of the speeds below which a window says nothing


@dataclass(frozen=True)
class ClockError:
    """By how much the affected clock is ahead of the reference, hours: offset at the beginning, and drift."""

    offset_h: float = 0.0
    drift_h_year: float = 0.0
    offset_sigma_h: float = np.inf
    drift_sigma_h_year: float = np.inf
    offset_named: bool = False
    drift_named: bool = False
    ambiguous: bool = False  # whether the other of offset and drift fits nearly as well

    @property
    def named(self) -> bool:
        """Whether a clock error is proven and larger than water can feign."""
        return self.offset_named or self.drift_named

    def ahead_s(self, time_s: Floats) -> Floats:
        """Return the named error along time, seconds, (n,).

        Args:
            time_s: UTC seconds, the first sample first, (n,).
        """
        years = (time_s - time_s[0]) / YEAR_S
        hours = self.offset_named * self.offset_h + self.drift_named * self.drift_h_year * years
        return np.asarray(HOUR_S * hours)


def compare(pairs: Pairs) -> ClockError:
    """Return the clock error that the speeds show; nothing named where they cannot tell."""
    step = float(np.median(np.diff(pairs.time_s)))
    if step > 2.0 * HOUR_S:
        return ClockError()
    slot = whitening.slots(pairs.time_s)
    upper, lower = (_fast(slot, speed, step) for speed in model.speeds(pairs))
    width = max(len(upper) // WINDOWS, FEWEST_IN_WINDOW)
    windows = [slice(begin, begin + width) for begin in range(0, len(upper) - width + 1, width)]
    later = np.interp(np.arange(len(upper)), slot, pairs.separation_minutes / 60.0)
    found = [
        (
            (window.start + width / 2.0) * step / YEAR_S,
            _ahead_h(upper[window], lower[window], step) - later[window].mean(),
        )
        for window in windows
    ]
    known = np.array([one for one in found if np.isfinite(one[1])]).reshape(-1, 2)
    return _judged(known[:, 0], known[:, 1], len(upper) * step / YEAR_S) if len(known) >= 5 else ClockError()


def _judged(years: Floats, ahead_h: Floats, span_years: float) -> ClockError:
    """Return the simplest clock that fits the windows: an offset, a drift from zero, or both."""
    ones = np.ones(len(years))
    (mean, mean_sigma, _), (rate, rate_sigma, _) = (_fit(x[:, None], ahead_h) for x in (ones, years))
    square = [_fit(x, ahead_h)[2] for x in (ones[:, None], years[:, None], np.column_stack([ones, years]))]
    line, line_sigma, _ = _fit(np.column_stack([ones, years]), ahead_h)
    large = abs(line[0]) >= LEAST_HOURS and abs(line[1]) * span_years >= LEAST_HOURS
    both = min(square[:2]) / square[2] - 1.0 > SIGMAS**2 / (len(years) - 2)
    if both and large and all(_clear(*one, len(years) - 2) for one in zip(line, line_sigma, strict=True)):
        return ClockError(line[0], line[1], np.hypot(line_sigma[0], DELAY_SIGMA_H), line_sigma[1], True, True)
    if square[1] < square[0]:
        named = _clear(rate[0], rate_sigma[0], len(years) - 1) and abs(rate[0]) * span_years >= LEAST_HOURS
        # A drift that begins at zero takes a constant delay for 1.5 of it over the whole span.
        sigma = np.hypot(rate_sigma[0], 1.5 * DELAY_SIGMA_H / span_years)
        return ClockError(0.0, rate[0], line_sigma[0], sigma, False, named, _close(square[0], square[1], len(years)))
    named = _clear(mean[0], mean_sigma[0], len(years) - 1) and abs(mean[0]) >= LEAST_HOURS
    sigma = np.hypot(mean_sigma[0], DELAY_SIGMA_H)
    return ClockError(mean[0], 0.0, sigma, line_sigma[1], named, False, _close(square[1], square[0], len(years)))


def _fit(design: Floats, ahead_h: Floats) -> tuple[list[float], list[float], float]:
    """Return values, standard errors and the sum of squares of a least-squares fit."""
    values, *_ = np.linalg.lstsq(design, ahead_h, rcond=None)
    square = float(np.sum((ahead_h - design @ values) ** 2))
    variance = square / (len(ahead_h) - design.shape[1])
    return values.tolist(), np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * variance).tolist(), square


def _close(other: float, best: float, windows: int) -> bool:
    """Tell whether another clock fits nearly as well: twice the log-likelihood by less than ten."""
    return windows * np.log(other / best) < CLOSE


def _clear(value: float, sigma: float, freedom: int) -> bool:
    """Tell whether a value is proven: few windows give Student's law (its normal score by Wallace 1959)."""
    t = value / max(sigma, 1e-6)
    score = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0) * np.sqrt(freedom * np.log1p(t**2 / freedom))
    return bool(score > SIGMAS)


def repaired(pairs: Pairs, clock: ClockError) -> Pairs:
    """Return the pairs with the reference read at the affected one's true times.

    A affected clock that is ahead stamps too late: its sample belongs to an earlier one of the reference.
    """
    wanted = pairs.time_s - clock.ahead_s(pairs.time_s)
    stamped, one = np.unique(pairs.time_s + 60.0 * pairs.separation_minutes, return_index=True)
    after = np.clip(np.searchsorted(stamped, wanted, side="right"), 1, len(stamped) - 1)
    step = float(np.median(np.diff(pairs.time_s)))
    inside = (wanted >= stamped[0]) & (wanted <= stamped[-1]) & (stamped[after] - stamped[after - 1] <= 1.5 * step)
    moved = {
        name: np.interp(wanted, stamped, getattr(pairs, name)[one])
        for name in ("lower_east", "lower_north", "lower_depth_m")
    }
    moved["separation_minutes"] = np.zeros(len(pairs))
    return take(replace(pairs, **moved), inside)


def kept(pairs: Pairs, again: Pairs) -> NDArray[np.bool_]:
    """Return which pairs a repair kept, (n,)."""
    return np.isin(pairs.time_s, again.time_s)


def _fast(slot: NDArray[np.intp], speed: Floats, step_s: float) -> Floats:
    """Return the speed on an even grid without what changes slowly, 0 where missing."""
    grid, present = np.zeros(slot[-1] + 1), np.zeros(slot[-1] + 1)
    grid[slot], present[slot] = np.where(np.isfinite(speed), speed, 0.0), np.isfinite(speed)
    reach = max(int(SLOW_HOURS * HOUR_S / step_s), 1)
    window = np.ones(2 * reach + 1)
    mean = np.convolve(grid, window, "same") / np.maximum(np.convolve(present, window, "same"), 1.0)
    return (grid - mean) * present


def _ahead_h(upper: Floats, lower: Floats, step_s: float) -> float:
    """Return by how much the upper clock is ahead where the correlation of the speeds is highest, hours."""
    reach = int(LONGEST_HOURS * HOUR_S / step_s)
    size = 1 << (2 * len(upper)).bit_length()
    product = np.fft.irfft(np.conj(np.fft.rfft(upper, size)) * np.fft.rfft(lower, size), size)
    lags = np.arange(-reach, reach + 1)
    cross = product[lags] / max(float(np.linalg.norm(upper) * np.linalg.norm(lower)), 1e-12)
    k = int(np.argmax(cross))
    if cross[k] < CLEAREST or k in (0, len(cross) - 1):
        return float("nan")
    before, at, after = (float(cross[j]) for j in (k - 1, k, k + 1))
    top = 0.5 * (before - after) / (before - 2.0 * at + after)
    return -(float(lags[k]) + top) * step_s / HOUR_S
