"""Observations of a swing: recorded headings and courses from a table or an NMEA log, with counts of excluded ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations import read_columns
from compasslib.calibrations.curves import count_sectors
from compasslib.deviation.series import series_design
from compasslib.effects.reference import filter_course
from compasslib.errors import InputError
from compasslib.readers import nmea
from compasslib.records import take
from compasslib.types import Bools, Floats

OPTIONAL = ("cog_deg", "true_deg", "speed_kn", "water_speed_kn", "time_utc")
BOUNDS = {"deg": (-180.0, 360.0), "kn": (0.0, nmea.FASTEST_KN)}
TURN_WINDOW_S = 20.0  # a receiver's filter and a compass card settle in this time
BLOCK_S = 20.0  # blocks over which residuals are averaged to estimate their autocorrelation
STEADY_S = 60.0  # longer than a helmsman's wandering about the course
APART_S = 30.0  # samples further apart belong to different runs
REFUSED_GAP_DEG = 180.0


@dataclass(frozen=True)
class SwingOptions:
    """Keys of a swing's YAML file that are specific to this kind."""

    min_speed_kn: float = 2.0  # fixes at or below it are excluded: slow courses over ground are noise
    max_turn_deg_s: float = 1.0  # faster turns, averaged over 20 s, are excluded
    max_lag_s: float = 10.0  # largest allowed delay of the course behind the compass
    max_drift_kn: float = 1.0  # largest allowed drift of the water (MM section 7.3)
    drift_ratio: float = 1.0 / 7.0  # the same relative to the ship's speed, for files without speeds
    declination_sigma_deg: float | None = None  # standard uncertainty; None: computed from the field strength
    visual: Sequence[Mapping[str, Any]] = ()  # {compass_deg, true_deg}: heading for a mark of known true bearing
    sun: Sequence[Mapping[str, Any]] = ()  # {compass_deg, time_utc}: heading for the sun
    visual_sigma_deg: float = 1.0  # standard uncertainty of such a heading
    course_sigma_deg: float = 1.0  # standard uncertainty of course and reading, if headings are too few to estimate it
    vessel_length_m: float | None = None
    table_step_deg: float = 10.0  # 10 or 15

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> SwingOptions:
        """Make options from the settings, with defaults for absent keys."""
        return cls(**{f.name: settings[f.name] for f in fields(cls) if settings.get(f.name) is not None})


@dataclass(frozen=True)
class Observations:
    """Recorded headings, each with the course over ground or the true heading of the ship."""

    recorded_deg: Floats  # (n,) compass, magnetic
    course_deg: Floats  # (n,) from true north: course over ground, or heading of the bow
    over_ground: bool  # whether course_deg is over ground
    speed_kn: Floats  # (n,) over ground, NaN where absent
    water_speed_kn: Floats  # (n,) by the ship's log, NaN where absent
    time_s: Floats  # (n,) UTC seconds since 1970, NaN where absent
    turn_deg_s: Floats  # (n,) rate over the preceding 20 s, 0 without times
    steady_turn_deg_s: Floats  # (n,) rate over the minute around, separately for fast turns; 0 without times
    settled_deg: Floats  # (n,) recorded headings averaged over 20 s
    also_course_deg: Floats  # (n,) course over ground where course_deg is of the bow, NaN where absent
    delay_s: float = 0.0  # of the course relative to the reading that it is paired with
    misfit_deg: tuple[float, float] = (np.nan, np.nan)  # mean misfit of a log to a curve, without and with that delay
    place: tuple[float, float] | None = None  # latitude, longitude, if the log has them
    variation_deg: float = float("nan")  # declination stated in the log
    left_out: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.recorded_deg)

    @property
    def timed(self) -> bool:
        """Whether all observations have a time."""
        return bool(len(self) and np.isfinite(self.time_s).all())

    def keep(self, good: Bools, why: str) -> Observations:
        """Select observations by a mask, (n,), and count the others by reason."""
        lost = {} if good.all() else {why: int((~good).sum())}
        return replace(take(self, good), left_out={**self.left_out, **lost})


def read(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Observations:
    """Read a swing from CSV tables or NMEA 0183 logs, excluding and counting slow fixes and fast turns."""
    options, log = SwingOptions.from_settings(settings), settings.get("format") == "nmea0183"
    columns, more = _read_logs(files, settings) if log else _read_tables(files, settings)
    empty, over_ground = np.full(columns["compass_deg"].shape, np.nan), "true_deg" not in columns
    known = Observations(
        recorded_deg=columns["compass_deg"],
        course_deg=columns["cog_deg" if over_ground else "true_deg"],
        over_ground=over_ground,
        speed_kn=columns.get("speed_kn", empty),
        water_speed_kn=columns.get("water_speed_kn", empty),
        time_s=columns.get("time_utc", empty),
        turn_deg_s=np.zeros(empty.shape),
        steady_turn_deg_s=np.zeros(empty.shape),
        settled_deg=columns["compass_deg"],
        also_course_deg=empty if over_ground else columns.get("cog_deg", empty),
        **more,
    )
    known = known.keep(np.isfinite(known.recorded_deg + known.course_deg), "without heading or course")
    if over_ground and np.isfinite(known.speed_kn).any():
        known = known.keep(known.speed_kn > options.min_speed_kn, f"not above {options.min_speed_kn:g} kn")
    if not known.timed:
        return known
    known = take(known, np.argsort(known.time_s, kind="stable"))
    steps = angles.difference(known.recorded_deg[1:], known.recorded_deg[:-1])
    turned = np.cumsum(np.append(known.recorded_deg[:1], steps))
    # Rate of turn over the seconds before each sample, interpolated where these are too few.
    before = np.searchsorted(known.time_s, known.time_s - TURN_WINDOW_S, side="left")
    lasted = known.time_s - known.time_s[before]
    enough, turn = lasted >= TURN_WINDOW_S / 2.0, np.zeros(known.time_s.shape)
    if enough.any():
        turn = np.interp(known.time_s, known.time_s[enough], (turned - turned[before])[enough] / lasted[enough])
    slow = np.abs(turn) <= options.max_turn_deg_s
    steady, settled = rate_and_heading(known.time_s, turned, slow)
    known = replace(known, turn_deg_s=turn, steady_turn_deg_s=steady, settled_deg=angles.wrap360(settled))
    known = _with_delay(known, turned, options.max_lag_s)
    if known.delay_s:
        return known
    return known.keep(slow, f"turning quicker than {options.max_turn_deg_s:g} degrees a second, or just after")


def _read_logs(files: Sequence[str | Path], settings: Mapping[str, Any]) -> tuple[dict[str, Floats], dict[str, Any]]:
    named = {"compass_deg": "HDG", "cog_deg": "RMC", **(settings.get("columns") or {})}  # sentences, by role
    heading, course = str(named["compass_deg"]), str(named["cog_deg"])
    log = nmea.read([Path(file) for file in files], heading=heading, course=course, talker=settings.get("talker"))
    known, more = np.isfinite(log.latitude + log.longitude), dict[str, Any](warnings=log.warnings)
    if known.any():
        longitude = log.longitude[known]
        middle = longitude[0] + np.median(angles.difference(longitude, longitude[0]))  # also across the date line
        more["place"] = float(np.median(log.latitude[known])), float(angles.wrap180(middle))
    if np.isfinite(log.variation_deg).any():
        more["variation_deg"] = float(np.nanmedian(log.variation_deg))
    columns = {"speed_kn": log.speed_kn, "water_speed_kn": log.water_speed_kn, "time_utc": log.time_s}
    columns = {role: x for role, x in columns.items() if role not in (settings.get("withhold") or ())}
    columns |= {"compass_deg": log.heading_deg, "cog_deg": log.course_deg}
    return columns | ({"true_deg": log.true_heading_deg} if "true_deg" in named else {}), more


def _read_tables(files: Sequence[str | Path], settings: Mapping[str, Any]) -> tuple[dict[str, Floats], dict[str, Any]]:
    columns, notes = read_columns(files, settings, ("compass_deg",), OPTIONAL, bounds=BOUNDS)
    courses = {"cog_deg", "true_deg"} & {*columns}
    if not courses:
        expected = "a column of the course over ground (cog_deg) or of the true heading (true_deg)"
        raise InputError(", ".join(map(str, files)), expected=expected, found="neither", advice="name it under columns")
    if len(courses) == 2:
        notes = (*notes, "both true_deg and cog_deg are there: the true heading is used, the course is not")
    wrapped = {role: angles.wrap360(x) if role.endswith("_deg") else x for role, x in columns.items()}
    return wrapped, {"warnings": notes}


def _with_delay(known: Observations, turned_deg: Floats, max_lag_s: float) -> Observations:
    """Pair each course of a log of at least eight minutes with a delayed reading, if that reduces the misfit by 30 %.

    The misfit is the mean absolute 20 s average of residuals about a series in the recorded heading: it is robust to
    outliers, and the series absorbs a steady drift to first order. Turns, which reveal a delay, need not be excluded.
    """
    time_s = known.time_s
    if len(known) < 2 or np.ptp(time_s) < 480.0 or np.median(np.diff(time_s)) > APART_S:
        return known
    seconds = np.arange(time_s[0], time_s[-1] + 1.0)
    turned = np.interp(seconds, time_s, turned_deg)

    def paired(delay_s: float, filtered: bool) -> tuple[Floats, Floats]:
        """Delay readings by a shift or a first-order filter; give the reading and its 20 s mean for each course."""
        series = filter_course(turned, delay_s) if filtered else turned
        at = time_s if filtered else time_s - delay_s
        return np.interp(at, seconds, series), np.interp(at, seconds, moving_average(series, seconds, BLOCK_S))

    def misfit(delay_s: float, filtered: bool) -> float:
        recorded, on = paired(delay_s, filtered)
        apart, columns = known.course_deg - recorded, series_design(on)
        off = angles.difference(apart, angles.mean(apart))
        off -= columns @ np.linalg.lstsq(columns, off)[0]
        return float(np.mean(np.abs(moving_average(off, time_s, BLOCK_S))))

    delays = np.arange(-max_lag_s, max_lag_s + 0.25, 0.5).tolist()
    forms = [(delay, False) for delay in delays] + [(delay, True) for delay in delays if delay > 0.0]
    misfits = [misfit(*form) for form in forms]
    (delay, filtered), left, without = forms[int(np.argmin(misfits))], min(misfits), misfit(0.0, False)
    if left > 0.7 * without:
        return known
    recorded, on = paired(delay, filtered)
    return replace(
        known,
        recorded_deg=angles.wrap360(recorded),
        settled_deg=angles.wrap360(on),
        steady_turn_deg_s=on - paired(delay + 1.0, filtered)[1],
        delay_s=delay,
        misfit_deg=(without, left),
    )


# Observations in time and around the circle: moving averages, rates of turn, distinct headings.


def moving_average(values: Floats, time_s: Floats, window_s: float) -> Floats:
    """Average values over a window centred on each, (n,), for increasing times; unchanged if any time is unknown."""
    if not np.isfinite(time_s).all():
        return values
    first = np.searchsorted(time_s, time_s - window_s / 2.0, side="left")
    last = np.searchsorted(time_s, time_s + window_s / 2.0, side="right")
    total = np.append(0.0, np.cumsum(values))
    return (total[last] - total[first]) / (last - first)


def rate_and_heading(time_s: Floats, turned_deg: Floats, slow: Bools) -> tuple[Floats, Floats]:
    """Compute the rate of turn, a slope over one minute, and headings averaged over 20 s, (n,) each.

    In runs shorter than 20 s, the rate is the difference over a minute and the heading is the reading. Differences of
    readings would share the compass noise with the deviation, which would look like a delay.
    """
    apart = (np.diff(time_s) > APART_S) | (np.diff(slow.astype(int)) != 0)
    ends = np.clip(np.stack([time_s - STEADY_S / 2.0, time_s + STEADY_S / 2.0]), time_s[0], time_s[-1])
    rate = np.diff(np.interp(ends, time_s, turned_deg), axis=0)[0] / np.maximum(np.diff(ends, axis=0)[0], 1.0)
    dense = len(time_s) > 1 and np.median(np.diff(time_s)) <= APART_S
    rate, mean = np.where(dense, rate, 0.0), turned_deg.copy()
    for run in np.split(np.arange(len(time_s)), np.flatnonzero(apart) + 1):
        since, turned = time_s[run] - time_s[run[0]], turned_deg[run] - turned_deg[run[0]]
        if since[-1] < BLOCK_S:
            continue
        products = since, turned, since**2, since * turned
        at, on, square, both = (moving_average(x, since, STEADY_S) for x in products)
        slope = (both - at * on) / np.maximum(square - at**2, 1.0)
        half = min(STEADY_S, float(since[-1])) / 2.0
        rate[run] = np.interp(np.clip(since, half, since[-1] - half), since, slope)
        away = since - moving_average(since, since, BLOCK_S)
        mean[run] = moving_average(turned_deg[run], since, BLOCK_S) + rate[run] * away
    return rate, mean


def group_headings(recorded_deg: Floats) -> NDArray[np.int_]:
    """Assign observations to numbered headings, (n,): repeats, at most 2 degrees apart, share a number."""
    order = np.argsort(recorded_deg, kind="stable")
    groups = np.empty(len(order), dtype=int)
    groups[order] = np.cumsum(np.append(0.0, np.diff(recorded_deg[order])) > 2.0)
    if len(order) and recorded_deg[order[0]] + 360.0 - recorded_deg[order[-1]] <= 2.0:
        groups[groups == groups.max()] = 0
    return groups


def distinct_headings(recorded_deg: Floats) -> int:
    """Count distinct headings; for 100 observations or more, occupied sectors of ten degrees."""
    return len(np.unique(group_headings(recorded_deg))) if len(recorded_deg) < 100 else count_sectors(recorded_deg)


def widest_gap(recorded_deg: Floats) -> float:
    """Find the widest arc without a heading, degrees."""
    ordered = np.sort(recorded_deg)
    return float(np.max(np.diff(ordered, append=ordered[0] + 360.0)))
