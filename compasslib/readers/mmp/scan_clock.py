"""The clock of a moored profiler's meter: whole seconds as logged, sub-seconds and gaps from the order of scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

Ints = NDArray[np.int64]

FIRST_YEAR, LAST_YEAR = 1980, 2100
MISPLACED_S = 2.0  # a clock that leaves its neighbours by more and comes back is a damaged one
TRUSTED_RATE = 0.2  # a nominal rate is accepted where the clock shows it to within this share
FEW = 10  # scans below which a clock of whole seconds shows no rate


def civil(date: tuple[Ints, Ints, Ints], clock: tuple[Ints, Ints, Ints]) -> Floats:
    """Return UTC seconds since 1970; NaN where the calendar has no such date or the clock no such time.

    Args:
        date: year, month, day, (n,) each.
        clock: hour, minute, second, (n,) each.
    """
    (year, month, day), (hour, minute, second) = date, clock
    months = 12 * (np.clip(year, FIRST_YEAR, LAST_YEAR) - 1970) + np.clip(month, 1, 12) - 1
    first, following = (
        m.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) for m in (months, months + 1)
    )
    real = (year >= FIRST_YEAR) & (year <= LAST_YEAR) & (month >= 1) & (month <= 12)
    real &= (day >= 1) & (day <= following - first) & (hour < 24) & (minute < 60) & (second < 60)
    real &= (hour >= 0) & (minute >= 0) & (second >= 0)
    seconds = 86400 * (first + day - 1) + 3600 * hour + 60 * minute + second
    return np.where(real, seconds.astype(float), np.nan)


def misplaced(clock_s: Floats, profile: Ints) -> Bools:
    """Return where a single clock stands apart from both of its neighbours in the same profile.

    Args:
        clock_s: (r,) seconds; NaN is never misplaced.
        profile: (r,) to which profile each scan belongs.
    """
    apart = np.zeros(len(clock_s), dtype=bool)
    if len(clock_s) > 2:
        step = np.where(np.diff(profile) == 0, np.diff(clock_s), 0.0)
        with np.errstate(invalid="ignore"):
            far = (np.abs(step[:-1]) > MISPLACED_S) & (np.abs(step[1:]) > MISPLACED_S)
            apart[1:-1] = far & (step[:-1] * step[1:] < 0)
    return apart


def rates(clock_s: Floats, profile: Ints, place: Ints, nominal_hz: Floats) -> Floats:
    """Return each profile's sample rate: the nominal one, unless the clock shows another.

    Args:
        clock_s: (r,) whole seconds, NaN where there is no clock.
        profile: (r,) to which profile each scan belongs, non-decreasing.
        place: (r,) its place there, damaged scans counted.
        nominal_hz: (p,) NaN where the file names none.
    """
    count = len(nominal_hz)
    first, last = (np.searchsorted(profile, np.arange(count), side=side) for side in ("left", "right"))
    known = np.flatnonzero(last - first > FEW)
    begin, end = first[known], last[known] - 1
    shown = np.full(count, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        shown[known] = (place[end] - place[begin]) / (clock_s[end] - clock_s[begin])
        contradicts = np.isfinite(shown) & ~(np.abs(shown / nominal_hz - 1.0) < TRUSTED_RATE)
    return np.where(contradicts, shown, nominal_hz)


def spread(clock_s: Floats, profile: Ints, rate_hz: Floats) -> Floats:
    """Return the clock with sub-seconds: scans that share a second are spread over it, in their order.

    Args:
        clock_s: (r,) whole seconds.
        profile: (r,) to which profile each scan belongs.
        rate_hz: (r,) sample rate as the file names it, NaN where it does not.
    """
    if not len(clock_s):
        return clock_s
    new = np.append(True, (np.diff(clock_s) != 0) | (np.diff(profile) != 0))
    begins = np.flatnonzero(new)
    group = np.cumsum(new) - 1
    size = np.diff(np.append(begins, len(new)))[group]
    return clock_s + (np.arange(len(new)) - begins[group]) / np.fmax(size, rate_hz)


def joined(clock_s: Floats, profile: Ints, place: Ints, rate_hz: Floats) -> Bools:
    """Return whether each scan follows the one before without a gap, (r - 1,).

    Args:
        clock_s: (r,) whole seconds, NaN where there is no clock.
        profile: (r,) to which profile each scan belongs.
        place: (r,) its place there, damaged scans counted.
        rate_hz: (r,) sample rate.
    """
    step = np.diff(clock_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Whole seconds hide up to one of them.
        waited = (step < 0) | (step > 1.0 + 1.0 / rate_hz[1:])
    return (np.diff(profile) == 0) & (np.diff(place) == 1) & ~waited
