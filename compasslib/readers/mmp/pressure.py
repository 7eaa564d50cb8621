"""Read the pressure of a moored profiler from its engineering (E) or CTD (C) files, or from a table.

E rows hold a time stamp, milliamperes, volts, decibars and more; the oldest unpackers write the stamp as six numbers.
C rows hold conductivity, temperature and decibars without a clock; they are spread evenly between switch-on and
switch-off times, and used only far from samples with a clock. A table is CSV with a header line.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.delimited import DEFAULT_LAYOUT, Layout, find_lines, parse_table, table_notes
from compasslib.readers.detect import detect_kind
from compasslib.readers.files import read_bytes, refuse_mostly_damaged
from compasslib.readers.mmp.rows import UNKNOWN, Form, Text, parse, parse_profiles
from compasslib.readers.mmp.scans import is_text
from compasslib.readers.times import civil_seconds
from compasslib.types import Floats

TIMES = ("time_utc", "time", "datetime", "date_time", "timestamp", "date")
PRESSURES = ("pressure_dbar", "pressure", "pres", "dbar", "p_dbar")
PROFILES = ("profile", "profile_number")
EXPECTED = (
    "an unpacked engineering (E) or CTD (C) file of the profiler, or a CSV table with a header line and the columns"
    " time and pressure (time_utc or time, ISO; pressure_dbar or pressure, dbar)"
)
BRIDGED_S = 60.0  # pressure is interpolated across gaps up to this long,
BRIDGED_STEPS = 5.0  # or up to this many median steps,
BRIDGED_AT_MOST_S = 600.0  # but never across longer gaps than this
OLD_STAMP = 6  # numbers of a time stamp written as month day year hour minute second
DBAR_OF_E, DBAR_OF_C = 2, 2  # index of the pressure column after the time stamp


@dataclass(frozen=True)
class Start:
    """Switch-on and switch-off times of the sensors for one profile, NaN where unknown."""

    number: int  # profile number, UNKNOWN if not stated
    on_s: float  # UTC seconds since 1970
    off_s: float  # UTC seconds since 1970


@dataclass(frozen=True, eq=False)
class Companion:
    """Time series of pressure and start times of profiles, of one file or of all files together."""

    time_s: Floats  # (c,) UTC seconds since 1970, increasing if merged from all files
    pressure_dbar: Floats  # (c,)
    starts: tuple[Start, ...]  # sorted by time if merged from all files
    damaged: int = 0  # number of rows dropped
    notes: tuple[str, ...] = ()  # notes on the format of tables
    clocked: bool = True  # whether the samples of a file carry a clock

    def at(self, time_s: Floats) -> Floats:
        """Interpolate the pressure to other times, (r,) dbar; NaN outside the series and in long gaps."""
        if len(self.time_s) < 2:
            return np.full(len(time_s), np.nan)
        step = np.diff(self.time_s)
        bridged = step <= _bridge(step)
        gap = np.searchsorted(self.time_s, time_s, side="right") - 1
        inside = (gap >= 0) & (gap < len(step))
        inside[inside] = bridged[gap[inside]]
        inside |= np.isin(time_s, self.time_s)
        return np.where(inside, np.interp(time_s, self.time_s, self.pressure_dbar), np.nan)

    def distance_s(self, time_s: Floats) -> Floats:
        """Compute the time from each of the given times to the nearest sample, (r,) seconds; infinite without any."""
        if not len(self.time_s):
            return np.full(len(time_s), np.inf)
        after = np.searchsorted(self.time_s, time_s).clip(0, len(self.time_s) - 1)
        before = (after - 1).clip(0)
        return np.minimum(np.abs(self.time_s[after] - time_s), np.abs(time_s - self.time_s[before]))


def read_companions(paths: Sequence[Path], layout: Layout = DEFAULT_LAYOUT) -> Companion:
    """Read the pressure of all files together.

    Raises:
        InputError: a file cannot be read or is of another kind.
    """
    series = [_read_file(path, layout) for path in paths]
    clocked = _merge([each for each in series if each.clocked])
    known = {start.number for start in clocked.starts} - {UNKNOWN}
    for k, each in enumerate(series):
        if not each.clocked:  # samples without a clock only fill gaps between those with one
            alone = clocked.distance_s(each.time_s) > BRIDGED_S
            starts = () if not alone.all() else tuple(start for start in each.starts if start.number not in known)
            series[k] = replace(each, time_s=each.time_s[alone], pressure_dbar=each.pressure_dbar[alone], starts=starts)
    return _merge(series)


def _merge(series: Sequence[Companion]) -> Companion:
    nothing = np.zeros(0)
    time = np.concatenate([nothing, *(each.time_s for each in series)])
    pressure = np.concatenate([nothing, *(each.pressure_dbar for each in series)])
    known = np.isfinite(time) & np.isfinite(pressure)
    time, first = np.unique(time[known], return_index=True)
    starts = sorted((start for each in series for start in each.starts), key=lambda start: start.on_s)
    notes = tuple(dict.fromkeys(note for each in series for note in each.notes))
    return Companion(time, pressure[known][first], tuple(starts), sum(each.damaged for each in series), notes)


def _read_file(path: Path, layout: Layout) -> Companion:
    data = read_bytes(path)
    try:
        lines = find_lines(path, lambda names: bool(_columns(names)), layout, delimiters=",;\t", must=True)
    except InputError:  # a binary file
        lines = None
    if lines:
        table = parse_table(path, lines, _columns(lines.header), "correct the header", layout)
        time_s, pressure = table.columns["time"], table.columns["pressure"]
        number = np.full(table.rows, float(UNKNOWN))
        step = np.diff(time_s)
        new = np.append(True, step > _bridge(step))[: len(time_s)]  # start after a gap
        if "profile" in table.columns:
            number = table.columns["profile"]
            new = np.append(True, np.diff(number) != 0)[: len(number)]
        begins = np.flatnonzero(new & np.isfinite(number))
        starts = tuple(Start(int(number[k]), float(time_s[k]), np.nan) for k in begins)
        return Companion(time_s, pressure, starts, damaged=table.cut, notes=table_notes([table]))
    if not is_text(data):
        advice, known = "unpack the profiler's binary files with the maker's unpacker", detect_kind(path)
        raise InputError(str(path), expected=EXPECTED, found=known.name if known else "a binary file", advice=advice)
    text = parse(data, lambda form: form[1] > DBAR_OF_C)
    if text.form is None:
        first = data.strip().split(b"\n")[0][:60].decode("latin-1").strip()
        shown = f"a first line {first!r}" if first else "an empty file"
        raise InputError(str(path), expected=EXPECTED, found=shown, advice="correct pressure_files")
    return _parse_rows(path, _parse_old_stamp(text))


def _parse_old_stamp(text: Text) -> Text:
    """Convert six leading numbers (month, day, year, hour, minute, second) to a time stamp if valid in every row."""
    if text.form is None or text.form[0] or text.form[1] < OLD_STAMP + DBAR_OF_E + 1:
        return text
    month, day, year, *clock = text.values[:, :OLD_STAMP].astype(np.int64).T
    time_s = civil_seconds(year, month, day, *clock)
    if not np.isfinite(time_s).all():
        return text
    form: Form = (True, text.form[1] - OLD_STAMP)
    return Text(form, text.offset, time_s, text.values[:, OLD_STAMP:], text.damaged, text.lines)


def _parse_rows(path: Path, text: Text) -> Companion:
    profiles, _, damaged = parse_profiles(text, path)
    refuse_mostly_damaged(path, "rows of pressure", damaged=damaged - text.foreign, whole=len(text.offset))
    stamped = text.form is not None and text.form[0]
    time_s = text.time_s
    if not stamped:
        if any(not block.off_s > block.on_s for block in profiles):
            expected, shown = "'turned on at' and 'turned off at' lines", "rows without a clock and no such lines"
            advice = "unpack with header lines, or give the engineering (E) files"
            raise InputError(str(path), expected=expected, found=shown, advice=advice)
        halves = [(block, np.arange(block.end - block.begin) + 0.5) for block in profiles]
        spread = [block.on_s + half * (block.off_s - block.on_s) / len(half) for block, half in halves]
        time_s = np.concatenate(spread)
    dbar = text.values[:, DBAR_OF_E if stamped else DBAR_OF_C]
    begins = [b.on_s if np.isfinite(b.on_s) else float(time_s[b.begin]) for b in profiles]
    starts = tuple(Start(b.number, on_s, b.off_s) for b, on_s in zip(profiles, begins, strict=True))
    # The profiler writes zeros before its first reading.
    return Companion(time_s, np.where(dbar == 0, np.nan, dbar), starts, damaged, clocked=stamped)


def _columns(names: Sequence[str]) -> dict[str, str]:
    """Match the headers of a table to roles; empty if time or pressure is missing."""
    header = {name.lower(): name for name in names}
    wanted = {"time": TIMES, "pressure": PRESSURES, "profile": PROFILES}
    columns = {role: header[name] for role, given in wanted.items() for name in reversed(given) if name in header}
    if {"date", "time"} <= set(header) and columns["time"] == header["time"]:
        columns |= {"date": header["date"], "clock": columns.pop("time")}
    return columns if "pressure" in columns and {"time", "clock"} & set(columns) else {}


def _bridge(step: Floats) -> float:
    usual = float(np.median(step)) if len(step) else 0.0
    return min(max(BRIDGED_S, BRIDGED_STEPS * usual), BRIDGED_AT_MOST_S)
