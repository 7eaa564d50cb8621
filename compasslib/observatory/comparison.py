"""An observatory's series compared with the model: level, quiet day, storms, and the constant with its uncertainty.

The calm half of a day gives its level, the days around give the slow level, the quietest days the quiet-day curve;
what is left is disturbance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, earthfield
from compasslib.errors import InputError
from compasslib.observatory.variations import (
    DAY_S,
    HOUR_S,
    Storm,
    daily_curve_at,
    hourly_median,
    means,
    measured,
    storms,
)
from compasslib.records import EarthField, FieldSeries
from compasslib.types import Floats

Flags = NDArray[np.bool_]

BIN_S = 600.0  # means of samples that are closer; noise of single minutes averages out
LEAST_HOURS = 12
NEAR_DAYS, FEWEST_NEAR = 4, 5  # the slow level of a day: median of so many days around, if so many are there
FEWEST_DAYS = 5  # for a median day
QUIETEST = 0.2  # share of the days that make the quiet-day curve
WHOLE_DAY = 0.9  # share of a day that a quiet one needs
BLOCK_DAYS, FEWEST_BLOCKS = 27, 5  # a rotation of the sun
WHOLE_YEAR_DAYS = 330
# Standard deviation of one day's mean about the year's, its part by disturbance, and that of a season's. Set by the
# years 1980 and 2003 of Eskdalemuir, on which the benchmark measures the coverage too: that is no independent check.
DAY_LEVEL_DEG, OF_DISTURBANCE, SEASON_DEG = 0.016, 0.4, 0.006


@dataclass(frozen=True)
class FieldComparison:
    """A series compared with the model; n means, d days."""

    time_s: Floats  # (n,) middle of each mean
    observed_deg: Floats  # (n,) declination
    model_deg: Floats  # (n,) of the field's model
    level_deg: Floats  # (n,) slow level of observed minus model
    curve_deg: Floats  # (24,) quiet day by hour of UTC, about its median; NaN where no quiet day is known
    quiet_days: int
    disturbed_deg: Floats  # (n,) what level and quiet day leave
    stormy: Flags  # (n,) in the disturbed hours of a storm
    storms: tuple[Storm, ...]  # in the order of time
    ordinary_deg: float  # middle three-hourly disturbance
    spikes: int  # lone values that no storm explains
    constant_deg: float  # of observed minus model: middle of the means of days without their storms
    constant_sigma_deg: float
    days: int

    @property
    def residual_deg(self) -> Floats:
        """Observed minus model, (n,) degrees."""
        return angles.difference(self.observed_deg, self.model_deg)

    @property
    def quiet_deg(self) -> Floats:
        """The quiet-day curve at each mean, (n,) degrees, 0 where it is not known."""
        return daily_curve_at(self.curve_deg, self.time_s)

    @property
    def step_s(self) -> float:
        """Distance of the means, seconds."""
        return float(np.median(np.diff(self.time_s)))


def field_of(series: FieldSeries, settings: Mapping[str, Any], where: str) -> EarthField:
    """Return the model's declination along a series, or the number that stands in its place.

    Args:
        settings: ``latitude`` and ``longitude`` where the header lacks them, ``declination`` (auto or degrees east).
        where: file, for the message.

    Raises:
        InputError: neither header nor settings tell the place, or a date lies outside the model.
    """
    latitude, longitude = place_of(series, settings)
    if not np.isfinite(latitude + longitude):
        raise InputError(
            where,
            expected="geodetic latitude and longitude in the header",
            found="none",
            advice="add latitude and longitude to the calibration's YAML file",
        )
    given = settings.get("declination")
    number = None if given in (None, "auto") else float(given)
    return earthfield.along_time(
        latitude, float(angles.wrap180(longitude)), float(series.time_s[0]), float(series.time_s[-1]), number
    )


def place_of(series: FieldSeries, settings: Mapping[str, Any]) -> tuple[float, float]:
    """Return latitude and longitude, degrees: as the settings have them, else as the header has them.

    Args:
        settings: ``latitude`` and ``longitude``, or None.
    """
    latitude, longitude = settings.get("latitude"), settings.get("longitude")
    return (series.latitude, series.longitude) if latitude is None or longitude is None else (latitude, longitude)


def refusal(series: FieldSeries) -> str:
    """Return why a series is too short to be compared with a model, or nothing."""
    hours = len(np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / HOUR_S)))
    if hours >= LEAST_HOURS:
        return ""
    return f"the series has a declination in {hours} hours; {LEAST_HOURS} are needed"


def compare(series: FieldSeries, model: EarthField, *, limit_deg: float) -> FieldComparison:
    """Return the comparison of a series with the field's model.

    Args:
        series: of an observatory, with some declinations.
        limit_deg: rms over three hours from which a disturbance is a storm.
    """
    time_s, observed = means(series, BIN_S)
    by_model = earthfield.declination_at(model, time_s)
    off = angles.difference(observed, by_model)
    first = _rough_curve(time_s, off)
    levels, days = _levels(time_s, off - daily_curve_at(first, time_s))
    level = _slow(levels, days)[np.searchsorted(days, np.floor(time_s / DAY_S))]
    rough = off - level - daily_curve_at(first, time_s)
    quiet = _quiet_days(time_s, rough, storms(time_s, rough, limit_deg)[0])
    curve = hourly_median(time_s, off - level, quiet) if quiet.any() else first
    disturbed = off - level - daily_curve_at(curve, time_s)
    stormy, found, ordinary, spikes = storms(time_s, disturbed, limit_deg)
    each = _daily_means(time_s, off - daily_curve_at(curve - np.mean(curve), time_s), stormy)
    return FieldComparison(
        time_s=time_s,
        observed_deg=observed,
        model_deg=by_model,
        level_deg=level,
        curve_deg=curve,
        quiet_days=len(np.unique(np.floor(time_s[quiet] / DAY_S))),
        disturbed_deg=disturbed,
        stormy=stormy,
        storms=tuple(measured(series, model, one) for one in found),
        ordinary_deg=ordinary,
        spikes=spikes,
        constant_deg=float(np.median(each)),
        constant_sigma_deg=_sigma(each, days, disturbed, limit_deg),
        days=len(days),
    )


def _rough_curve(time_s: Floats, off: Floats) -> Floats:
    """Return the median day of all days about their medians, (24,); NaN where they are few."""
    days, which = np.unique(np.floor(time_s / DAY_S), return_inverse=True)
    if len(days) < FEWEST_DAYS:
        return np.full(24, np.nan)
    begins = np.searchsorted(which, np.arange(len(days)))
    middle = np.array([np.median(part) for part in np.split(off, begins[1:])])
    return hourly_median(time_s, off - middle[which], np.ones(len(off), dtype=bool))


def _levels(time_s: Floats, off: Floats) -> tuple[Floats, Floats]:
    """Return the level of each day, the median of its calm half, and the days' numbers."""
    number = np.floor(time_s / DAY_S)
    change = np.abs(np.diff(off, prepend=off[0], append=off[-1]))
    hour = np.unique(np.floor(time_s / HOUR_S), return_inverse=True)[1]
    rough = np.zeros(hour[-1] + 1)
    np.maximum.at(rough, hour, np.maximum(change[:-1], change[1:]))
    days, begins = np.unique(number, return_index=True)
    parts = zip(np.split(off, begins[1:]), np.split(rough[hour], begins[1:]), strict=True)
    return np.array([np.median(x[r <= np.median(r)]) for x, r in parts]), days


def _daily_means(time_s: Floats, off: Floats, stormy: Flags) -> Floats:
    """Return the mean of each day, storms left out where a day is more than one, (d,)."""
    which = np.unique(np.floor(time_s / DAY_S), return_inverse=True)[1]
    calm = ~stormy | (np.bincount(which, ~stormy) == 0)[which]
    return np.bincount(which[calm], off[calm]) / np.bincount(which[calm])


def _slow(levels: Floats, days: Floats) -> Floats:
    """Return the median of the days around each day; of all days where too few are around."""
    result = np.full(len(days), np.median(levels))
    ends = np.searchsorted(days, days + NEAR_DAYS, side="right")
    for k, (a, b) in enumerate(zip(np.searchsorted(days, days - NEAR_DAYS), ends, strict=True)):
        if b - a >= FEWEST_NEAR:
            result[k] = np.median(levels[a:b])
    return result


def _quiet_days(time_s: Floats, rough: Floats, stormy: Flags) -> Flags:
    """Return which means lie on the quietest days: whole ones without a storm."""
    number = np.floor(time_s / DAY_S)
    days, which, count = np.unique(number, return_inverse=True, return_counts=True)
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else HOUR_S
    whole = (count * step >= WHOLE_DAY * DAY_S) & (np.bincount(which, stormy) == 0)
    if not whole.any():
        return np.zeros(len(time_s), dtype=bool)
    about = rough - (np.bincount(which, rough) / count)[which]
    size = np.where(whole, np.bincount(which, about**2) / count, np.inf)
    quietest = np.argsort(size)[: max(int(QUIETEST * len(days)), 1)]
    return np.isin(which, quietest[np.isfinite(size[quietest])])


def _sigma(each_day: Floats, days: Floats, disturbed: Floats, limit_deg: float) -> float:
    """Return the standard error of the constant: from blocks of days, or by an assumed spread where there are few."""
    spread = np.hypot(DAY_LEVEL_DEG, OF_DISTURBANCE * min(angles.rms(disturbed), limit_deg))
    blocks = np.unique(np.floor(days / BLOCK_DAYS), return_inverse=True)[1]
    if blocks[-1] + 1 < FEWEST_BLOCKS:
        return float(np.hypot(spread / np.sqrt(len(days)), SEASON_DEG))
    each = np.array([np.median(each_day[blocks == k]) for k in range(blocks[-1] + 1)])
    season = SEASON_DEG if np.ptp(days) < WHOLE_YEAR_DAYS else 0.0
    return float(np.hypot(np.std(each, ddof=1) / np.sqrt(len(each)), season))
