"""The course of a declination: means, the median day, and its departure from its slow course as moorings need it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.readers import iaga2002
from compasslib.records import FieldSeries

Floats = NDArray[np.floating]
Flags = NDArray[np.bool_]

DAY_S, HOUR_S = 86400.0, 3600.0
FULL = 0.5  # share of the samples that a mean needs
MONTH_DAYS = 27  # a rotation of the sun


def means(series: FieldSeries, step_s: float) -> tuple[Floats, Floats]:
    """Return times and declinations averaged over steps, those with too few samples left out; coarser ones as they are.

    Args:
        series: of an observatory.
        step_s: seconds.
    """
    known = np.isfinite(series.declination_deg)
    time_s, declination = series.time_s[known], series.declination_deg[known]
    own = float(np.median(np.diff(series.time_s))) if len(series) > 1 else step_s
    if own > FULL * step_s or not len(time_s):
        return time_s, declination
    number = np.floor(time_s / step_s)
    slots, which, count = np.unique(number, return_inverse=True, return_counts=True)
    middle = declination[0]
    mean = middle + np.bincount(which, angles.difference(declination, middle)) / count
    full = count * own >= FULL * step_s
    return (slots[full] + 0.5) * step_s, angles.wrap180(mean[full])


def departure(series: FieldSeries, time_s: Floats) -> Floats:
    """Return how far magnetic north stood from its slow course at given instants, (n,) degrees, NaN where unknown.

    Hourly means of the declination minus the median of the 27 days around: storms and daily variation remain, the
    secular variation and the rocks' constant go. That is the covariate of ``field_disturbance``.

    Args:
        series: of an observatory.
        time_s: (n,), UTC seconds.
    """
    known = np.isfinite(series.declination_deg)
    own, declination = series.time_s[known], series.declination_deg[known]
    if not len(own):
        return np.full(len(time_s), np.nan)
    off = angles.difference(declination, declination[0])
    first, last = (np.searchsorted(own, time_s + side) for side in (-HOUR_S / 2.0, HOUR_S / 2.0))
    total = np.concatenate([[0.0], np.cumsum(off)])
    step = float(np.median(np.diff(own))) if len(own) > 1 else HOUR_S
    enough = (last - first) >= max(FULL * HOUR_S / step, 1.0)
    mean = np.where(enough, (total[last] - total[first]) / np.maximum(last - first, 1), np.nan)
    return np.asarray(mean - _slow_course(own, off, time_s))


def covariate(files: Sequence[str | Path], time_s: Floats) -> Floats:
    """Return what the files of an observatory give a mooring's search for ``field_disturbance``, as ``departure``.

    Args:
        files: IAGA-2002 files of one observatory.
        time_s: (n,) of the mooring, UTC seconds.

    Raises:
        InputError: a file cannot be read.
    """
    return departure(iaga2002.read(files), time_s)


def daily(curve_deg: Floats, time_s: Floats) -> Floats:
    """Return a daily curve at given instants, (n,) degrees, 0 where it is not known.

    Args:
        curve_deg: (24,) at the half hours of UTC.
        time_s: (n,), UTC seconds.
    """
    if not np.isfinite(curve_deg).all():
        return np.zeros(len(time_s))
    hour = (time_s / HOUR_S) % 24.0
    return np.interp(hour, np.arange(24) + 0.5, curve_deg, period=24.0)


def hourly_median(time_s: Floats, off: Floats, chosen: Flags) -> Floats:
    """Return the median of the hourly means by hour of the day, (24,), about its median; NaN where an hour is missing.

    Args:
        time_s: increasing times, (n,).
        off: (n,), degrees.
        chosen: which count, (n,).
    """
    hours, which = np.unique(np.floor(time_s[chosen] / HOUR_S), return_inverse=True)
    if not len(hours):
        return np.full(24, np.nan)
    mean = np.bincount(which, off[chosen]) / np.bincount(which)
    clock = (hours % 24).astype(int)
    if len(np.unique(clock)) < 24:
        return np.full(24, np.nan)
    curve = np.array([np.median(mean[clock == k]) for k in range(24)])
    return curve - np.median(curve)


def _slow_course(own_s: Floats, off: Floats, time_s: Floats) -> Floats:
    """Return the running median of daily medians over 27 days at given instants."""
    days, begins = np.unique(np.floor(own_s / DAY_S), return_index=True)
    levels = np.array([np.median(part) for part in np.split(off, begins[1:])])
    reach = MONTH_DAYS // 2
    ends = zip(np.searchsorted(days, days - reach), np.searchsorted(days, days + reach, side="right"), strict=True)
    course = np.array([np.median(levels[a:b]) for a, b in ends])
    return np.interp(time_s, (days + 0.5) * DAY_S, course)
