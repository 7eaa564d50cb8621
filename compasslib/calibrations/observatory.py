"""Observatory declination compared with IGRF: slow level, quiet-day curve, storms, and a constant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.errors import InputError
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries, iso_time
from compasslib.types import DAY_S, HOUR_S, Bools, Floats

MIN_SHARE = 0.5  # fraction of the samples required for a mean
WINDOW_S = 3 * HOUR_S
APART_S = 24 * HOUR_S  # windows farther apart belong to separate storms
MIN_DAYS = 5  # of a record from which its usual day and disturbance are known
BLOCK_DAYS = 27  # a rotation of the sun
KIND = "declination"
AVERAGED_S = 600.0  # averaging interval of one-minute values: storms last longer
CONSTANT_HOW = "blocks of 27 days; under 135 days a middle latitude's spread of daily levels, assumed"
AMBIGUITY = (
    "A includes the crustal field, the error of IGRF and an error of the observatory's azimuth mark; one series cannot "
    "separate them."
)
CRUST_NT = 600.0  # largest crustal field that is accepted; most stations have less than 300
ADVICE = "correct the file's columns, units or place, or take the observatory's own file"


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the constant difference of an observatory's declination from the model, the quiet day and the storms."""
    series = iaga2002.read(files)
    place, header = _station_place(series, settings), (series.latitude, series.longitude)
    warnings = [*series.warnings]
    if np.any(np.abs(angles.difference(place, header)) > 0.5):  # degrees
        warnings.append("the file has the station at {:g} N {:g} E; the YAML's place counts".format(*header))
    located = {"latitude": place[0], "longitude": place[1], "elevation_m": series.elevation_m}
    of_file = {
        "station": series.station,
        **{name: float(value) if np.isfinite(value) else None for name, value in located.items()},
        "date": iso_time(float(np.mean(series.time_s[[0, -1]])))[:10],
        "definitive": series.definitive,
        "rows": dict(series.counts),
    }
    if why := too_short_reason(series):
        return Calibration(KIND, "none", 0, 0, details=of_file, why=why, warnings=tuple(warnings))
    field, mistakes = station_field(series, settings, str(files[0]))
    compared = compare(series, field)
    warnings += mistakes
    if compared.spikes:
        warnings.append(f"{compared.spikes} isolated outliers: spikes, or storms shorter than three hours")
    constant, sigma = compared.constant_deg, compared.constant_sigma_deg
    covariance = np.full((5, 5), np.nan)
    covariance[0, 0] = sigma**2
    # The same constant at every heading: the correction of headings converted to true with the model's declination.
    heading = np.arange(0.0, 360.0, float(settings.get("table_step_deg", 10.0)))
    curve = compared.curve_deg - np.mean(compared.curve_deg)
    residual, calm = compared.residual_deg - constant, compared.disturbed_deg[~compared.stormy]
    of_curve = f"rms of the curve of {compared.quiet_days} days"
    return Calibration(
        kind=KIND,
        model=f"{'IGRF' if field.source == 'IGRF' else 'the given declination'} plus a constant",
        n=len(compared.time_s),
        coverage=0,
        coefficients=np.append(constant, np.full(4, np.nan)),
        covariance=covariance,
        residual_rms_deg=angles.rms(residual),
        sources=(
            Source("constant", sigma, CONSTANT_HOW),
            Source("daily variation", float(np.std(np.nan_to_num(curve))), of_curve),
            Source("disturbance", angles.rms(calm), "rms of what level and quiet day leave, storms left out"),
        ),
        table=DeviationTable(heading, np.full(len(heading), constant), np.full(len(heading), sigma)),
        points={
            "time_s": compared.time_s,
            "declination_deg": compared.observed_deg,
            "model_deg": compared.model_deg,
            "level_deg": compared.level_deg,
            "quiet_day_deg": interpolate_daily_curve(curve, compared.time_s),
            "residual_deg": residual,
            "disturbance_deg": compared.disturbed_deg,
            "storm": compared.stormy.astype(float),
        },
        details=of_file | _describe(series, compared, curve) | {"model_source": field.source},
        warnings=(*warnings, *field.warnings),
    )


def _describe(series: FieldSeries, compared: FieldComparison, curve_deg: Floats) -> dict[str, Any]:
    observed = angles.difference(series.declination_deg, compared.observed_deg[0])
    amplitude, days = float(np.ptp(curve_deg)) / 2.0, compared.quiet_days
    return {
        "constant_deg": compared.constant_deg,
        "constant_sigma_deg": compared.constant_sigma_deg,
        "days": compared.days,
        "from": iso_time(series.time_s[0]),
        "to": iso_time(series.time_s[-1]),
        "range_deg": float(np.ptp(observed[np.isfinite(observed)])),
        "quiet_day": {"days": days, "amplitude_deg": amplitude, "by_hour_deg": curve_deg} if days else None,
        "storms": [
            {"from": iso_time(x.begin_s), "to": iso_time(x.end_s), "range_deg": x.range_deg, "rms_deg": x.rms_deg}
            for x in compared.storms
        ],
        "cannot_tell": [AMBIGUITY],
    }


def _station_place(series: FieldSeries, settings: Mapping[str, Any]) -> tuple[float, float]:
    """Look up latitude and longitude, degrees: in the settings, else in the header."""
    latitude, longitude = settings.get("latitude"), settings.get("longitude")
    return (series.latitude, series.longitude) if latitude is None or longitude is None else (latitude, longitude)


def station_field(series: FieldSeries, settings: Mapping[str, Any], where: str) -> tuple[EarthField, list[str]]:
    """Evaluate the field model, or the declination of the settings, along a series; with ``check_field``'s warnings.

    Raises:
        InputError: the position is unknown, a date lies outside the model, or the field is not that of the place.
    """
    latitude, longitude = place = _station_place(series, settings)
    if not np.isfinite(latitude + longitude):
        expected = "geodetic latitude and longitude in the header"
        advice = "add latitude and longitude to the calibration's YAML file"
        raise InputError(where, expected=expected, found="none", advice=advice)
    given = settings.get("declination")
    number = None if given in (None, "auto") else float(given)
    first_s, last_s = (float(series.time_s[k]) for k in (0, -1))
    field = earthfield.field_along(latitude, float(angles.wrap180(longitude)), first_s, last_s, number)
    return field, check_field(series, place)


def check_field(series: FieldSeries, place: tuple[float, float]) -> list[str]:
    """Warn if the medians of a month of a file are not the model's at its place, (latitude, longitude), if known.

    Raises:
        InputError: a mistake that affects the declination is identified, or the field is impossible at that place.
    """
    warnings: dict[str, str] = {}
    known = np.isfinite(series.declination_deg)
    if not (np.isfinite(place).all() and known.any()):
        return []
    file = series.origin if len(series.origin) == len(series) else np.zeros(len(series), dtype=np.intp)
    months = np.stack([file, np.floor(series.time_s / (BLOCK_DAYS * DAY_S)).astype(np.intp)])
    for month in np.unique(months[:, known], axis=1).T:
        part = np.all(months == month[:, None], axis=0)
        first = series.declination_deg[part & known][0]
        off = np.nanmedian(angles.difference(series.declination_deg[part], first))
        declination, time_s = float(angles.wrap180(first + off)), float(np.median(series.time_s[part]))
        horizontal, vertical = (
            float(np.nanmedian(x[part])) if np.isfinite(x[part]).any() else float("nan")
            for x in (series.horizontal_nT, series.vertical_nT)
        )
        model = [float(x[0]) for x in earthfield.igrf(*place, [time_s])]
        across = model[1] * angles.DEGREE * float(np.abs(angles.chord(angles.difference(declination, model[0]))))
        if not np.nanmax([across, abs(horizontal - model[1]), abs(vertical - model[2])]) > CRUST_NT:
            continue
        variation = abs(declination) < 0.3 < abs(model[0]) or horizontal < 0.1 * model[1]
        why = f"rocks rarely make more than {CRUST_NT:.0f} nT; check columns, units, place and dates"
        why = "a variation about zero: the baseline is missing" if variation else why
        parts = [f"D {declination:+.2f} degrees"]
        parts += [f" H {horizontal:.0f} nT"] if np.isfinite(horizontal) else []
        parts += [f" Z {vertical:+.0f} nT"] if np.isfinite(vertical) else []
        by_model = "D {:+.1f} degrees, H {:.0f} nT, Z {:+.0f} nT at {:g} N {:g} E".format(*model, *place)
        year = iso_time(time_s)[:4]
        where = series.files[month[0]] if series.files else series.station
        observed = f"{','.join(parts)} ({why})"
        if variation or across > 5000.0:  # nT, more than any crustal field at an observatory
            raise InputError(where, expected=f"about {by_model} in {year}, as IGRF has", found=observed, advice=ADVICE)
        warnings.setdefault(where, f"{where}: {observed}, where IGRF has {by_model} in {year}")
    return list(warnings.values())


def with_observatory_warnings(field: EarthField, files: Sequence[str | Path]) -> EarthField:
    """Add warnings about a mooring's observatory to its field: mistakes in the file, days not covered."""
    if not files:
        return field
    series = iaga2002.read(files)
    warnings = check_field(series, (series.latitude, series.longitude))
    days = np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / DAY_S))
    first, last = np.floor(field.time_s[[0, -1]] / DAY_S)
    covered = float(np.sum((days >= first) & (days <= last)) / (last - first + 1.0))
    if covered < 0.5:
        warnings.append(
            f"the observatory {series.station} covers {100.0 * covered:.0f} % of the deployment's days; elsewhere the "
            "disturbance of the field is taken as zero"
        )
    return replace(field, warnings=(*field.warnings, *warnings))


@dataclass(frozen=True)
class Storm:
    """A period of disturbance."""

    begin_s: float
    end_s: float
    range_deg: float  # of the declination, highest minus lowest sample
    rms_deg: float  # over its disturbed hours
    worst_deg: float  # rms of its worst three hours


def average(series: FieldSeries, step_s: float) -> tuple[Floats, Floats]:
    """Average declinations over time steps, omitting those with too few samples; keep coarser series unchanged."""
    known = np.isfinite(series.declination_deg)
    time_s, declination = series.time_s[known], series.declination_deg[known]
    interval_s = _step(series.time_s, step_s)
    if interval_s > MIN_SHARE * step_s or not len(time_s):
        return time_s, declination
    slots, which, count = np.unique(np.floor(time_s / step_s), return_inverse=True, return_counts=True)
    middle = declination[0]
    mean = middle + np.bincount(which, angles.difference(declination, middle)) / count
    full = count * interval_s >= MIN_SHARE * step_s
    return (slots[full] + 0.5) * step_s, angles.wrap180(mean[full])


def _step(time_s: Floats, otherwise_s: float = HOUR_S) -> float:
    """Compute the sampling interval, seconds."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else otherwise_s


def covariates(files: Sequence[str | Path], time_s: Floats) -> tuple[Floats, Floats]:
    """Compute the variation across and along an observatory's north, (n,) degrees each: storms and quiet days."""
    series = iaga2002.read(files)
    # The variation along north, relative to the field, turns a needle where magnetic north has another direction.
    off = departure(series.time_s, series.horizontal_nT, time_s)
    strength = np.nanmedian(series.horizontal_nT) if np.isfinite(off).any() else 1.0
    declination = series.declination_deg
    first = declination[np.isfinite(declination)][:1] if np.isfinite(declination).any() else 0.0
    across = departure(series.time_s, angles.difference(declination, first), time_s)
    return across, np.asarray(off / strength / angles.DEGREE)


def departure(series_s: Floats, values: Floats, time_s: Floats) -> Floats:
    """Compute hourly means of a series minus the median of the surrounding 27 days, (n,), NaN where unknown."""
    known = np.isfinite(values)
    known_s, off = series_s[known], values[known]
    if not len(known_s):
        return np.full(len(time_s), np.nan)
    first, last = (np.searchsorted(known_s, time_s + side) for side in (-HOUR_S / 2.0, HOUR_S / 2.0))
    total = np.concatenate([[0.0], np.cumsum(off)])
    enough = (last - first) >= max(MIN_SHARE * HOUR_S / _step(known_s), 1.0)
    mean = np.where(enough, (total[last] - total[first]) / np.maximum(last - first, 1), np.nan)
    days, begins = np.unique(np.floor(known_s / DAY_S), return_index=True)
    levels = np.array([np.median(part) for part in np.split(off, begins[1:])])  # daily, then running medians
    course = _running_median(days, levels, BLOCK_DAYS // 2)
    return np.asarray(mean - np.interp(time_s, (days + 0.5) * DAY_S, course))


def _running_median(days: Floats, values: Floats, reach: int, least: int = 1) -> Floats:
    """Compute medians over the days at most ``reach`` away, (n,); of all days where fewer than ``least`` are near."""
    ends = zip(np.searchsorted(days, days - reach), np.searchsorted(days, days + reach, side="right"), strict=True)
    return np.array([np.median(values[a:b] if b - a >= least else values) for a, b in ends])


def interpolate_daily_curve(curve_deg: Floats, time_s: Floats) -> Floats:
    """Interpolate a daily curve, given at the half hours of UTC (24,), to times, (n,) degrees; 0 if it is unknown."""
    if not np.isfinite(curve_deg).all():
        return np.zeros(len(time_s))
    return np.interp((time_s / HOUR_S) % 24.0, np.arange(24) + 0.5, curve_deg, period=24.0)


def hourly_median(time_s: Floats, off: Floats, chosen: Bools) -> Floats:
    """Compute medians of hourly means by hour of day, (24,), minus the overall median; NaN if an hour is missing."""
    hours, which, count = np.unique(np.floor(time_s[chosen] / HOUR_S), return_inverse=True, return_counts=True)
    clock = (hours % 24).astype(int)
    if len(np.unique(clock)) < 24:
        return np.full(24, np.nan)
    mean = np.bincount(which, off[chosen]) / count
    curve = np.array([np.median(mean[clock == k]) for k in range(24)])
    return curve - np.median(curve)


def strongest_disturbance(time_s: Floats, off_deg: Floats) -> tuple[float, float]:
    """Find start and end of the strongest disturbance, or of the record if many stretches are as strong."""
    size, _ = three_hour_rms(time_s, off_deg)
    at = np.flatnonzero(size >= 0.5 * size.max())
    groups = np.split(at, np.flatnonzero(np.diff(time_s[at]) > APART_S) + 1)
    strongest = next(group for group in groups if np.argmax(size) in group)
    if len(groups) > 12 or not size.max():
        return float(time_s[0]), float(time_s[-1])
    clear = strongest[np.abs(off_deg[strongest]) >= 0.25 * np.abs(off_deg[strongest]).max()]
    return float(time_s[clear[0]]), float(time_s[clear[-1]])


def three_hour_rms(time_s: Floats, off_deg: Floats) -> tuple[Floats, Floats]:
    """Compute the rms over the three hours around each value, with and without the largest one, (n,) each."""
    step = _step(time_s)
    slot = np.rint((time_s - time_s[0]) / step).astype(np.intp)
    half = max(int(WINDOW_S / step) // 2, 1)
    gaps = np.concatenate([[0], np.cumsum(np.minimum(np.diff(slot), 4 * half))])  # shorten long gaps, to save memory
    grid = np.full(gaps[-1] + 1 + 2 * half, np.nan)
    grid[half + gaps] = off_deg**2
    windows = np.lib.stride_tricks.sliding_window_view(grid, 2 * half + 1)[gaps]
    count = np.sum(np.isfinite(windows), axis=1)
    total, most = np.nansum(windows, axis=1), np.nanmax(windows, axis=1)
    full = count >= MIN_SHARE * (2 * half + 1)
    without_largest = np.sqrt(np.maximum(total - most, 0.0) / np.maximum(count - 1, 1))
    return np.where(full, np.sqrt(total / count), 0.0), np.where(full, without_largest, 0.0)


def find_storms(time_s: Floats, off: Floats, limit_deg: float) -> tuple[Bools, list[tuple[float, ...]], float, int]:
    """Detect storms in the declination without level and quiet-day curve, (n,) degrees.

    Returns:
        Mask of disturbed values; begin, end, rms and worst three-hour rms of each storm; median disturbance; spikes.
    """
    size, without_largest = three_hour_rms(time_s, off)
    ordinary = float(np.median(size)) if np.ptp(time_s) >= MIN_DAYS * DAY_S else 0.0
    limit = max(limit_deg, 3.0 * ordinary)
    core = (size >= limit) & (without_largest >= 0.5 * limit)
    spikes = int(np.sum((size >= limit) & ~core & (np.abs(off) >= limit)))
    stormy, within = core, time_s[core]
    if len(within):
        near = np.clip(np.searchsorted(within, time_s), 1, len(within))
        before, after = within[near - 1], within[np.minimum(near, len(within) - 1)]
        stormy = np.minimum(np.abs(time_s - before), np.abs(after - time_s)) <= WINDOW_S / 2.0
    at, half = np.flatnonzero(stormy & (np.abs(off) >= 0.5 * limit)), _step(time_s) / 2.0
    found: list[tuple[float, ...]] = []
    for group in np.split(at, np.flatnonzero(np.diff(time_s[at]) > APART_S) + 1) if len(at) else []:
        span = slice(group[0], group[-1] + 1)
        rms, worst = angles.rms(off[span][stormy[span]]), float(size[group].max())
        found.append((time_s[group[0]] - half, time_s[group[-1]] + half, rms, worst))
    return stormy, found, ordinary, spikes


@dataclass(frozen=True)
class FieldComparison:
    """Comparison of a series with the model, at n averaged times."""

    time_s: Floats  # (n,) middle of each mean
    observed_deg: Floats  # (n,) declination
    model_deg: Floats  # (n,) declination of the field model
    level_deg: Floats  # (n,) slow level of observed minus model
    curve_deg: Floats  # (24,) quiet day by hour of UTC, about its median; NaN where no quiet day is known
    quiet_days: int
    disturbed_deg: Floats  # (n,) observed minus model, without level and quiet-day curve
    stormy: Bools  # (n,) mask of the disturbed hours of storms
    storms: tuple[Storm, ...]  # in order of time
    ordinary_deg: float  # median three-hour rms of the disturbance
    spikes: int  # number of isolated outliers that are no storms
    constant_deg: float  # observed minus model: median of the daily means without storms
    constant_sigma_deg: float
    days: int

    @property
    def residual_deg(self) -> Floats:
        """Observed minus model, (n,) degrees."""
        return angles.difference(self.observed_deg, self.model_deg)

    @property
    def quiet_deg(self) -> Floats:
        """Quiet-day curve at each time, (n,) degrees, 0 if it is unknown."""
        return interpolate_daily_curve(self.curve_deg, self.time_s)

    @property
    def step_s(self) -> float:
        """Interval between the averaged times, seconds."""
        return _step(self.time_s)


def too_short_reason(series: FieldSeries) -> str:
    """Explain why a series is too short to be compared with a model; empty if it is not."""
    hours = len(np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / HOUR_S)))
    return "" if hours >= 12 else f"the series has a declination in {hours} hours; 12 are needed"


def compare(series: FieldSeries, model: EarthField, *, limit_deg: float = 0.5) -> FieldComparison:
    """Separate observed minus model declination into level (over nine days), quiet-day curve and storms."""
    time_s, observed = average(series, AVERAGED_S)
    by_model = earthfield.declination_at(model, time_s)
    off = angles.difference(observed, by_model)
    days, begins, which_day = np.unique(np.floor(time_s / DAY_S), return_index=True, return_inverse=True)
    first = np.full(24, np.nan)  # median day of all days, if these are not too few
    if len(days) >= MIN_DAYS:
        middle = np.array([np.median(part) for part in np.split(off, begins[1:])])
        first = hourly_median(time_s, off - middle[which_day], np.ones(len(off), dtype=bool))
    # Level of each day: the median of its calmer half, by the largest change in each hour.
    left = off - interpolate_daily_curve(first, time_s)
    change = np.abs(np.diff(left, prepend=left[0], append=left[-1]))
    hour = np.unique(np.floor(time_s / HOUR_S), return_inverse=True)[1]
    rough = np.zeros(hour[-1] + 1)
    np.maximum.at(rough, hour, np.maximum(change[:-1], change[1:]))
    parts = zip(np.split(left, begins[1:]), np.split(rough[hour], begins[1:]), strict=True)
    levels = np.array([np.median(x[r <= np.median(r)]) for x, r in parts])
    level = _running_median(days, levels, reach=4, least=5)[which_day]
    quiet = _quiet_days(time_s, left - level, find_storms(time_s, left - level, limit_deg)[0])
    curve = hourly_median(time_s, off - level, quiet) if quiet.any() else first
    disturbed = off - level - interpolate_daily_curve(curve, time_s)
    stormy, measures, ordinary, spikes = find_storms(time_s, disturbed, limit_deg)
    samples = angles.difference(series.declination_deg, earthfield.declination_at(model, series.time_s))
    storms = []
    for begin_s, end_s, rms_deg, worst_deg in measures:
        inside = samples[(series.time_s >= begin_s) & (series.time_s <= end_s)]
        storms.append(Storm(begin_s, end_s, float(np.nanmax(inside) - np.nanmin(inside)), rms_deg, worst_deg))
    # Daily means, without storms except on days that have no other values.
    calm = ~stormy | (np.bincount(which_day, ~stormy) == 0)[which_day]
    without = off - interpolate_daily_curve(curve - np.mean(curve), time_s)
    each = np.bincount(which_day[calm], without[calm]) / np.bincount(which_day[calm])
    return FieldComparison(
        time_s=time_s,
        observed_deg=observed,
        model_deg=by_model,
        level_deg=level,
        curve_deg=curve,
        quiet_days=len(np.unique(which_day[quiet])),
        disturbed_deg=disturbed,
        stormy=stormy,
        storms=tuple(storms),
        ordinary_deg=ordinary,
        spikes=spikes,
        constant_deg=float(np.median(each)),
        constant_sigma_deg=_constant_sigma(each, days, min(angles.rms(disturbed), limit_deg)),
        days=len(days),
    )


def _quiet_days(time_s: Floats, rough: Floats, stormy: Bools) -> Bools:
    """Select the values of the quietest fifth of the days, among those without storms and with 90 % of samples."""
    days, which, count = np.unique(np.floor(time_s / DAY_S), return_inverse=True, return_counts=True)
    whole = (count * _step(time_s) >= 0.9 * DAY_S) & (np.bincount(which, stormy) == 0)
    about = rough - (np.bincount(which, rough) / count)[which]
    size = np.where(whole, np.bincount(which, about**2) / count, np.inf)
    quietest = np.argsort(size)[: max(int(0.2 * len(days)), 1)]
    return np.isin(which, quietest[np.isfinite(size[quietest])])


def _constant_sigma(each_day: Floats, days: Floats, disturbance_deg: float) -> float:
    """Estimate the standard error of the constant from blocks of days, or from an assumed spread if these are few.

    Spreads and share of the disturbance are tuned to Eskdalemuir 1980 and 2003, on which the benchmark measures
    coverage.
    """
    blocks = np.unique(np.floor(days / BLOCK_DAYS), return_inverse=True)[1]
    season_deg = 0.006
    if blocks[-1] + 1 < 5:
        spread = np.hypot(0.016, 0.4 * disturbance_deg)
        return float(np.hypot(spread / np.sqrt(len(days)), season_deg))
    each = np.array([np.median(each_day[blocks == k]) for k in range(blocks[-1] + 1)])
    season = season_deg if np.ptp(days) < 330 else 0.0
    return float(np.hypot(np.std(each, ddof=1) / np.sqrt(len(each)), season))
