"""What a swing observed: recorded headings and courses from a table or an NMEA log, and what was left out of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations.curves import count_sectors
from compasslib.deviation.series import series_design
from compasslib.effects.ship import FilteredCourse
from compasslib.errors import InputError
from compasslib.readers import delimited, nmea
from compasslib.types import Bools, Floats

ROLES = ("compass_deg", "cog_deg", "true_deg", "speed_kn", "water_speed_kn", "time_utc")
SENTENCES = {"compass_deg": "HDG", "cog_deg": "RMC"}  # what stands for a header in an NMEA log
BOUNDS = {"deg": (-180.0, 360.0), "kn": (0.0, nmea.FASTEST_KN)}
TURN_WINDOW_S = 20.0  # a receiver's filter and a compass card settle in this time
BLOCK_S = 20.0  # over which residuals are averaged to find how alike they are
NEIGHBOURS, ALIKE_DEG = 3, 40.0  # readings either side that are compared, and how far a ship may turn meanwhile
STEADY_S = 60.0  # a helmsman's wandering about the course is over in that time
APART_S = 30.0  # samples further apart do not hang together
REFUSED_GAP_DEG = 180.0
HEADING_GAP_DEG = 2.0  # headings less apart are one heading, repeated
MIN_LASTED_S = 480.0  # of a log that shows a delay
DELAY_STEP_S = 0.5
MAX_LEFT = 0.7  # of the mean misfit of a log, by a delay that is applied: half of its square


@dataclass(frozen=True)
class SwingOptions:
    """The keys of a swing's YAML file that only this kind has."""

    min_speed_kn: float = 2.0  # fixes that are not faster are left out: slow courses over ground are noise
    max_turn_deg_s: float = 1.0  # quicker turns, averaged over 20 s, are left out
    max_lag_s: float = 10.0  # largest delay of the course behind the compass that is allowed
    max_drift_kn: float = 1.0  # largest drift of the water that is allowed (MM section 7.3)
    drift_ratio: float = 1.0 / 7.0  # the same over the ship's speed, for files without a speed
    declination_sigma_deg: float | None = None  # standard uncertainty; by the field's strength where absent
    visual: tuple[Mapping[str, Any], ...] = ()  # {compass_deg, true_deg}: heading for a mark of known true bearing
    sun: tuple[Mapping[str, Any], ...] = ()  # {compass_deg, time_utc}: heading for the sun
    visual_sigma_deg: float = 1.0  # standard uncertainty of such a heading
    course_sigma_deg: float = 1.0  # the same of a course and the reading on it, where too few headings show it
    vessel_length_m: float | None = None
    table_step_deg: float = 10.0  # 10 or 15

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> SwingOptions:
        """Make options from the settings, defaults where they are silent."""
        given = {f.name: settings[f.name] for f in fields(cls) if settings.get(f.name) is not None}
        marks: dict[str, Any] = {name: tuple(given.pop(name)) for name in ("visual", "sun") if name in given}
        return cls(**given, **marks)


@dataclass(frozen=True)
class Observations:
    """Recorded headings, each with the course that the ship made or the heading that it had."""

    recorded_deg: Floats  # (n,) compass, magnetic
    course_deg: Floats  # (n,) true north: over ground, or of the bow
    over_ground: bool  # what course_deg is
    speed_kn: Floats  # (n,) over ground, NaN where absent
    water_speed_kn: Floats  # (n,) by the ship's log, NaN where absent
    time_s: Floats  # (n,) UTC seconds since 1970, NaN where absent
    turn_deg_s: Floats  # (n,) over the 20 s before, 0 without times
    steady_turn_deg_s: Floats  # (n,) over the minute about it, quick turns left out; 0 without times
    settled_deg: Floats  # (n,) recorded headings, means over 20 s
    also_course_deg: Floats  # (n,) over ground where course_deg is of the bow, NaN where absent
    delay_s: float = 0.0  # by which the course is later than the reading that it is paired with
    misfit_deg: tuple[float, float] = (np.nan, np.nan)  # of a log, mean about a curve, without that delay and with it
    place: tuple[float, float] | None = None  # latitude, longitude, where the log has them
    variation_deg: float = float("nan")  # declination that the log states
    left_out: Mapping[str, int] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.recorded_deg)

    @property
    def timed(self) -> bool:
        """Whether all observations carry their time."""
        return bool(len(self) and np.isfinite(self.time_s).all())

    def keep(self, good: Bools, why: str) -> Observations:
        """Select the good ones, (n,), and count the others."""
        lost = int((~good).sum())
        columns = {f.name: getattr(self, f.name)[good] for f in fields(self) if f.type == "Floats"}
        return replace(self, **columns, left_out={**self.left_out, **({why: lost} if lost else {})})


def read(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Observations:
    """Read a swing, slow fixes and quick turns left out and counted.

    Args:
        files: CSV tables or NMEA 0183 logs.
        settings: ``format``, ``columns``, ``withhold`` and the keys of ``SwingOptions``.

    Raises:
        InputError: a file, a column or a value cannot be read.
    """
    paths, options = [Path(file) for file in files], SwingOptions.from_settings(settings)
    reader = {"nmea0183": _read_logs}.get(str(settings.get("format")), _read_tables)
    raw = reader(paths, settings)
    known = raw.keep(np.isfinite(raw.recorded_deg + raw.course_deg), "without heading or course")
    if known.over_ground and np.isfinite(known.speed_kn).any():
        known = known.keep(known.speed_kn > options.min_speed_kn, f"not above {options.min_speed_kn:g} kn")
    if not known.timed:
        return known
    order = np.argsort(known.time_s, kind="stable")
    known = replace(known, **{f.name: getattr(known, f.name)[order] for f in fields(known) if f.type == "Floats"})
    known = known.keep(~isolated_readings(known.time_s, known.recorded_deg), "unlike the readings before and after")
    steps = angles.difference(known.recorded_deg[1:], known.recorded_deg[:-1])
    turned = np.cumsum(np.append(known.recorded_deg[:1], steps))
    # The rate of turn over the seconds before each sample; the earliest known one where there are too few.
    before = np.searchsorted(known.time_s, known.time_s - TURN_WINDOW_S, side="left")
    lasted = known.time_s - known.time_s[before]
    enough, turn = lasted >= TURN_WINDOW_S / 2.0, np.zeros(known.time_s.shape)
    if enough.any():
        turn = np.interp(known.time_s, known.time_s[enough], (turned - turned[before])[enough] / lasted[enough])
    slow = np.abs(turn) <= options.max_turn_deg_s
    steady, settled = rate_and_heading(known.time_s, turned, slow)
    known = replace(known, turn_deg_s=turn, steady_turn_deg_s=steady, settled_deg=angles.wrap360(settled))
    known = _with_delay(known, turned, options)
    if known.delay_s:
        return known
    return known.keep(slow, f"turning quicker than {options.max_turn_deg_s:g} degrees a second, or just after")


def isolated_readings(time_s: Floats, recorded_deg: Floats) -> Bools:
    """Find readings of a dense log that less than half of the nearest ones agree with, as dropouts written as zero."""
    n, agree, near = len(time_s), np.zeros(len(time_s)), np.zeros(len(time_s))
    for k in range(1, min(NEIGHBOURS, n - 1) + 1):
        close = time_s[k:] - time_s[:-k] <= TURN_WINDOW_S / 2.0
        alike = close & (np.abs(angles.difference(recorded_deg[k:], recorded_deg[:-k])) <= ALIKE_DEG)
        for part in (slice(k, n), slice(0, n - k)):
            near[part] += close
            agree[part] += alike
    return (near > NEIGHBOURS) & (agree < near / 2.0)


def _with_delay(known: Observations, turned_deg: Floats, options: SwingOptions) -> Observations:
    """Pair each course of a log with the reading of some seconds before, where that explains most of the misfit.

    Turns, in which a delay shows, then need not be left out. The misfit is the mean distance of averages over 20 s from
    a series in the recorded heading: outliers hardly move it, the series takes up a steady drift to first order, and a
    filter of the readings, which averages their noise, gains nothing by that.

    Args:
        turned_deg: recorded headings, not wrapped, (n,).
    """
    time_s, most = known.time_s, options.max_lag_s
    if len(known) < 2 or np.ptp(time_s) < MIN_LASTED_S or np.median(np.diff(time_s)) > APART_S:
        return known
    seconds = np.arange(time_s[0], time_s[-1] + 1.0)
    turned = np.interp(seconds, time_s, turned_deg)

    def paired(delay_s: float, *, filtered: bool) -> tuple[Floats, Floats]:
        """Delay the readings by a filter of first order, or as they are: for each course the reading and its mean."""
        series = FilteredCourse(delay_s).delayed(turned) if filtered else turned
        at = time_s if filtered else time_s - delay_s
        return np.interp(at, seconds, series), np.interp(at, seconds, moving_average(series, seconds, BLOCK_S))

    def misfit(form: tuple[float, bool]) -> float:
        recorded, on = paired(form[0], filtered=form[1])
        apart, columns = known.course_deg - recorded, series_design(on)
        off = angles.difference(apart, angles.mean(apart))
        off -= columns @ np.linalg.lstsq(columns, off)[0]
        return float(np.mean(np.abs(moving_average(off, time_s, BLOCK_S))))

    delays = np.arange(-most, most + DELAY_STEP_S / 2.0, DELAY_STEP_S).tolist()
    forms = [(delay, False) for delay in delays] + [(delay, True) for delay in delays if delay > 0.0]
    misfits = [misfit(form) for form in forms]
    (delay, filtered), left, without = forms[int(np.argmin(misfits))], min(misfits), misfit((0.0, False))
    if left > MAX_LEFT * without:
        return known
    recorded, on = paired(delay, filtered=filtered)
    rate = on - paired(delay + 1.0, filtered=filtered)[1]
    return replace(
        known,
        recorded_deg=angles.wrap360(recorded),
        settled_deg=angles.wrap360(on),
        steady_turn_deg_s=rate,
        delay_s=delay,
        misfit_deg=(without, left),
    )


def _read_logs(paths: list[Path], settings: Mapping[str, Any]) -> Observations:
    named = {**SENTENCES, **(settings.get("columns") or {})}
    log = nmea.read(paths, heading=str(named["compass_deg"]), course=str(named["cog_deg"]))
    withheld = set(settings.get("withhold") or ())
    stated = log.variation_deg[np.isfinite(log.variation_deg)]
    known, place = np.isfinite(log.latitude + log.longitude), None
    if known.any():
        longitude = log.longitude[known]
        middle = longitude[0] + np.median(angles.difference(longitude, longitude[0]))  # across the date line too
        place = float(np.median(log.latitude[known])), float(angles.wrap180(middle))
    columns = {"compass_deg": log.heading_deg, "cog_deg": log.course_deg}
    columns |= {"true_deg": log.true_heading_deg} if "true_deg" in named else {}
    others = {"speed_kn": log.speed_kn, "water_speed_kn": log.water_speed_kn, "time_utc": log.time_s}
    columns |= {role: column for role, column in others.items() if role not in withheld}
    variation = float(np.median(stated)) if stated.size else float("nan")
    return replace(_observe(columns), place=place, variation_deg=variation, warnings=log.warnings)


def _observe(columns: Mapping[str, Floats]) -> Observations:
    """Make observations of columns by role; rates of turn and settled headings follow when times are known."""
    empty, over_ground = np.full(columns["compass_deg"].shape, np.nan), "true_deg" not in columns
    return Observations(
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
    )


def _read_tables(paths: list[Path], settings: Mapping[str, Any]) -> Observations:
    tables, notes = zip(*(_read_table(path, settings) for path in paths), strict=True)
    roles = set(tables[0]).intersection(*tables)
    columns = {role: np.concatenate([t[role] for t in tables]) for role in roles}
    both = {"true_deg", "cog_deg"} <= {*columns}
    ignored = ["both true_deg and cog_deg are there: the true heading is used, the course is not"] * both
    warnings = dict.fromkeys(note for said in notes for note in said)
    return replace(_observe(columns), warnings=(*warnings, *ignored))


def _read_table(path: Path, settings: Mapping[str, Any]) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Read the columns of one table by role, and notes; what is withheld is not looked at."""
    mapped, withheld = settings.get("columns") or {}, set(settings.get("withhold") or ())
    layout, headers = delimited.Layout.from_settings(settings), {role: str(mapped.get(role) or role) for role in ROLES}
    names = delimited.read_header(path, [headers["compass_deg"]], layout)
    wanted = {role: header for role, header in headers.items() if not {role, header} & withheld}
    for role, header in wanted.items():
        if header not in names and (mapped.get(role) or role == "compass_deg"):
            raise _absent_column(path, f"column {header!r} ({role})", names)
    there = {role: header for role, header in wanted.items() if header in names}
    if not {"cog_deg", "true_deg"} & set(there):
        course = "column of the course over ground (cog_deg) or of the true heading (true_deg)"
        raise _absent_column(path, course, names)
    table = delimited.read_table(path, there | delimited.date_and_clock(mapped, withheld), layout=layout)
    parsed = {"time_utc" if role == "time" else role: column for role, column in table.columns.items()}
    for role in (role for role in parsed if role != "time_utc"):
        (low, high), values = BOUNDS[role.rpartition("_")[2]], parsed[role]
        beyond = values[(values < low) | (values > high)]
        if beyond.size:
            raise InputError(
                f"{path}: column {there[role]!r} ({role})",
                expected=f"numbers from {low:g} to {high:g}, or nothing",
                found=f"{beyond.size} beyond, {beyond[0]:g} first",
                advice="check the column and its unit; leave cells without a reading empty",
            )
    turned = {role: angles.wrap360(values) if role.endswith("_deg") else values for role, values in parsed.items()}
    return turned, delimited.table_notes([table])


def _absent_column(path: Path, what: str, names: list[str]) -> InputError:
    return InputError(
        f"{path}: {what}",
        expected="one of the file's columns",
        found=", ".join(names) or "an empty file",
        advice="correct columns in the calibration file",
    )


# Where in time and on the circle a swing's observations lie: blocks, means, rates of turn, headings.


def moving_average(values: Floats, time_s: Floats, window_s: float) -> Floats:
    """Average values over a window about each, (n,), times increasing; as they are where a time is not known."""
    if not np.isfinite(time_s).all():
        return values
    first = np.searchsorted(time_s, time_s - window_s / 2.0, side="left")
    last = np.searchsorted(time_s, time_s + window_s / 2.0, side="right")
    total = np.append(0.0, np.cumsum(values))
    return (total[last] - total[first]) / (last - first)


def rate_and_heading(time_s: Floats, turned_deg: Floats, slow: Bools) -> tuple[Floats, Floats]:
    """Compute the rate of turn, the slope over the minute about each, and headings averaged over 20 s, (n,) each.

    Where less than 20 s hang together it is the rate over the minute about each sample, and the heading as it was. A
    difference of readings would not do: a compass's noise stands in it and in the deviation, and looks like a delay.
    Nor would single readings as the place on the curve: water and compass are alike only on the same headings.

    Args:
        turned_deg: recorded headings, not wrapped, (n,).
        slow: which are not in a quick turn, (n,).
    """
    apart = (np.diff(time_s) > APART_S) | (np.diff(slow.astype(int)) != 0)
    ends = np.clip(np.stack([time_s - STEADY_S / 2.0, time_s + STEADY_S / 2.0]), time_s[0], time_s[-1])
    rate = np.diff(np.interp(ends, time_s, turned_deg), axis=0)[0] / np.maximum(np.diff(ends, axis=0)[0], 1.0)
    dense = len(time_s) > 1 and np.median(np.diff(time_s)) <= APART_S
    rate, mean = np.where(dense, rate, 0.0), turned_deg.copy()
    for run in np.split(np.arange(len(time_s)), np.flatnonzero(apart) + 1):
        if np.ptp(time_s[run]) >= BLOCK_S:
            rate[run], mean[run] = _smooth_run(time_s[run] - time_s[run[0]], turned_deg[run])
    return rate, mean


def _smooth_run(since_s: Floats, turned_deg: Floats) -> tuple[Floats, Floats]:
    """Compute rate of turn and mean heading of one run; near its ends the rate of the nearest whole minute."""
    turned = turned_deg - turned_deg[0]
    products = since_s, turned, since_s**2, since_s * turned
    at, on, square, both = (moving_average(x, since_s, STEADY_S) for x in products)
    slope = (both - at * on) / np.maximum(square - at**2, 1.0)
    half = min(STEADY_S, float(since_s[-1])) / 2.0
    rate = np.interp(np.clip(since_s, half, since_s[-1] - half), since_s, slope)
    away = since_s - moving_average(since_s, since_s, BLOCK_S)
    return rate, moving_average(turned_deg, since_s, BLOCK_S) + rate * away


def since_middle(time_s: Floats) -> Floats:
    """Scale time to -1/2 to 1/2 of the swing, (n,); 0 where a time is not known."""
    if not np.isfinite(time_s).all():
        return np.zeros(time_s.shape)
    first, last = time_s.min(), time_s.max()
    return (time_s - (first + last) / 2.0) / max(last - first, 1.0)


def group_headings(recorded_deg: Floats) -> NDArray[np.int_]:
    """Number the heading of each observation, (n,): repeated ones share a number."""
    order = np.argsort(recorded_deg, kind="stable")
    first = np.append(0.0, np.diff(recorded_deg[order])) > HEADING_GAP_DEG
    groups = np.empty(len(order), dtype=int)
    groups[order] = np.cumsum(first)
    if len(order) and recorded_deg[order[0]] + 360.0 - recorded_deg[order[-1]] <= HEADING_GAP_DEG:
        groups[groups == groups.max()] = 0
    return groups


def distinct_headings(recorded_deg: Floats) -> int:
    """Count the headings that were steered, repeated ones once."""
    return len(np.unique(group_headings(recorded_deg))) if len(recorded_deg) < 100 else count_sectors(recorded_deg)


def widest_gap(recorded_deg: Floats) -> float:
    """Find the widest arc without a heading, degrees."""
    ordered = np.sort(recorded_deg)
    return float(np.max(np.append(np.diff(ordered), ordered[0] + 360.0 - ordered[-1])))
