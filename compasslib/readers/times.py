"""Parse time cells to UTC seconds: unambiguous formats are detected, all others require ``time_format``.

All rows of a column must have the same format. A numeric day and month are distinguished by a value above 12, with
which all rows and their order must agree. Numeric times are identified by their magnitude: seconds and milliseconds
since 1970, MATLAB's datenum, and decimal years.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from compasslib.types import DAY_S, HOUR_S, Bools, Floats

Ints = NDArray[np.int64]

TIME_FORM = "an ISO time like 2007-09-04T00:00:00Z"
SETTLE = "write time_format, for example '%d/%m/%Y %H:%M'"
DATENUM_1970 = 719529.0  # 1970-01-01 in MATLAB's day numbers
JULIAN_DAY_1970 = 2440588  # Julian day number of noon on 1970-01-01; EPIC's of that day
FARTHEST_ZONE_H = 14  # hours, largest UTC offset in use
FIRST_YEAR, LAST_YEAR = 1980, 2100  # accepted years of instrument clocks
YEARS, USUAL_YEARS = (1950, 2101), (1980, 2030)  # numeric times: accepted, and those in which a scale is detected
MONTHS = "january february march april may june july august september october november december"

_CLOCK = (
    r"(?:[T ] *(?P<H>\d{1,2})(?::(?P<M>\d\d)(?::(?P<S>\d\d(?:[.,]\d{1,9})?))?)?(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?)?"
    r"(?:Z| ?UTC| ?GMT| ?(?P<zone>[+-](?:0\d|1[0-4])(?::?[0-5]\d)))?"
)
_FORMS = {
    "iso": r"(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})",
    "compact": r"(?P<y>19[5-9]\d|20\d\d)(?P<m>\d\d)(?P<d>\d\d)",
    "figures": r"(?P<a>\d{1,2})(?P<part>[-/. ])(?P<b>\d{1,2})(?P=part)(?P<y>\d{4})",
    "name": r"(?P<d>\d{1,2})[-/. ]?(?P<name>[A-Za-z]{3,9})[-/., ]{0,2}(?P<y>\d{4})",
    "name first": r"(?P<name>[A-Za-z]{3,9})[-. ]{0,2}(?P<d>\d{1,2})[-, ]{1,2}(?P<y>\d{4})",
    "year and name": r"(?P<y>\d{4})[-/ ]?(?P<name>[A-Za-z]{3,9})[-/ ]?(?P<d>\d{1,2})",
}
_PATTERNS = {form: re.compile(date + _CLOCK, re.ASCII) for form, date in _FORMS.items()}
_PATTERNS["run together"] = re.compile(
    _FORMS["compact"] + r"[T ]?(?P<H>\d\d)(?P<M>\d\d)(?P<S>\d\d)?(?:Z| ?(?P<zone>[+-]\d\d:?\d\d))?", re.ASCII
)
_SINCE = re.compile(
    r"(?:(?P<packed>\d{8})|(?P<y>[+-]?\d{1,4})(?:(?P<part>[-/])(?P<m>\d{1,2})(?:(?P=part)(?P<d>\d{1,2}))?)?)"
    r"(?:(?: *T| +) *(?P<H>\d{1,2})(?::(?P<M>\d{1,2})(?::(?P<S>\d{1,2}(?:\.\d*)?))?)?"
    r" *(?:Z|UTC|GMT|(?P<zone>(?:[+-]| +[+-]?)\d{1,2}(?::?\d\d)?))?| *(?:Z|UTC|GMT))?",
    re.ASCII | re.IGNORECASE,
)
_ISO = re.compile(r"\d{4}-\d\d-\d\d(?:[T ]\d\d(?::\d\d(?::\d\d(?:\.\d{1,6})?)?)?)?Z?", re.ASCII)
_SECOND_60 = re.compile(r"((?<!\d)\d\d:\d\d:)60(?!\d|[.,]\d*[1-9])", re.ASCII)
_SHORT_YEAR = re.compile(r"\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3,9})[-/. ]\d\d(?:[T ].*)?", re.ASCII)
_ZONE_NAME = re.compile(r".*\d ?(?:[AaPp]\.?[Mm]\.? )? ?([A-Z]{2,5}\d?)", re.ASCII)
_NUMBERLIKE = re.compile(r"[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?", re.ASCII)


class Unreadable(Exception):
    """A cell of times, by the index of its row, or a column (None) that cannot be parsed."""

    def __init__(self, row: int | None, shown: str, expected: str = TIME_FORM, advice: str = ""):
        super().__init__(shown)
        self.row, self.shown, self.expected, self.advice = row, shown, expected, advice


def _refused(cells: Sequence[str], row: int, expected: str = TIME_FORM, advice: str = "") -> Unreadable:
    return Unreadable(row, repr(cells[row]), expected, advice)


def parse_times(
    cells: Sequence[str], numbers: Callable[[], Floats | None], *, form: str | None = None, zone: str | None = None
) -> tuple[Floats, str]:
    """Parse cells as UTC seconds since 1970, (n,), and describe the detected format; empty for ISO or a given format.

    Args:
        numbers: function that parses the cells as numbers, (n,), or gives None if they are not all numbers.
        form: a strptime format, or a scale: epoch, epoch_ms, datenum, decimal_year, excel.
        zone: time zone of cells that state none, UTC or an offset such as +02:00.

    Raises:
        Unreadable: a cell is not a valid time, or is ambiguous.
    """
    if leap := [row for row, cell in enumerate(cells) if ":60" in cell and _SECOND_60.search(cell)]:
        given = [_SECOND_60.sub(r"\g<1>59", cell) for cell in cells]
        time_s, note = parse_times(given, numbers, form=form, zone=zone)
        time_s[leap] += 0.999  # before the next minute, whose row is another
        return time_s, f"{note}{', ' * bool(note)}second 60 as a leap second ({cells[leap[0]]})"
    ahead_s = 0.0 if zone in (None, "UTC") else _offset_s(str(zone))
    if form is None and all(map(_ISO.fullmatch, cells)):
        time_s = _parse_iso(cells)
        row = next((k for k, cell in enumerate(cells) if cell.endswith("Z")), None)
        if row is not None and ahead_s:
            raise _refused(cells, row, "times without a zone beside timezone", "correct or delete timezone")
        return time_s - ahead_s, ""
    if form in SCALES:
        return _from_scale(str(form), cells, numbers()) - ahead_s, ""
    if form is not None:
        return _parse_format(cells, form, ahead_s), ""
    if (parsed := _parse_fields(cells)) is None:
        scale = _detect_scale(cells, numbers())
        return _from_scale(scale, cells, numbers()) - ahead_s, f"times as {SCALES[scale][1]}"
    clock_s, zone_s, note = parsed
    return clock_s - _zone_offset_s(cells, zone_s, zone, ahead_s), note


def is_iso(cell: str, zone: str | None) -> bool:
    """Return whether a cell is an ISO time in UTC, which needs neither ``time_format`` nor a note."""
    return zone in (None, "UTC") and _ISO.fullmatch(cell) is not None


def _parse_iso(cells: Sequence[str]) -> Floats:
    try:
        return np.array([cell.rstrip("Z") for cell in cells], dtype="datetime64[us]").astype(np.int64) / 1e6
    except ValueError:
        for row, cell in enumerate(cells):
            try:
                np.datetime64(cell.rstrip("Z"))
            except ValueError:
                raise Unreadable(row, repr(cell)) from None
        raise


def _offset_s(zone: str) -> float:
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (60 * int(digits[:2]) + int(digits[2:])) * (-60.0 if zone[0] == "-" else 60.0)


def parse_origin(text: str, calendar: str) -> float:
    """Parse the reference time of a unit such as "days since", UTC seconds since 1970.

    Args:
        text: text after "since" by CF 4.4 and UDUNITS: a date, optionally a time of day (default 0 h) and an offset
            from UTC (default 0), as in 1992-10-8 15:15:42.5 -6:00.
        calendar: standard, proleptic_gregorian or julian.

    Raises:
        Unreadable: the text is not such a time, or contains anything else.
    """
    import cftime

    advice = "write for example days since 1950-01-01 00:00:00 +00:00"
    unreadable = Unreadable(None, repr(text), "a date, a time of day and an offset from UTC", advice)
    if (match := _SINCE.fullmatch(" ".join(text.split()))) is None:
        raise unreadable
    packed, clock = match["packed"], [float(match[part] or 0.0) for part in "HMS"]
    date = (packed[:4], packed[4:6], packed[6:]) if packed else (match["y"], match["m"] or 1, match["d"] or 1)
    digits = re.sub(r"[^\d]", "", match["zone"] or "")
    hours, minutes = (int(digits[:-2]), int(digits[-2:])) if len(digits) > 2 else (int(digits or 0), 0)
    if clock[0] > 23.0 or clock[1] > 59.0 or clock[2] >= 60.0 or hours > FARTHEST_ZONE_H or minutes > 59:
        raise unreadable
    year_zero = calendar == "proleptic_gregorian"
    try:
        with warnings.catch_warnings():  # cftime warns of years before year 1
            warnings.simplefilter("ignore", cftime.CFWarning)
            day = cftime.datetime(*map(int, date), calendar=calendar, has_year_zero=year_zero).toordinal()
    except ValueError:
        raise unreadable from None
    ahead_s = 60.0 * (60 * hours + minutes) * (-1.0 if "-" in (match["zone"] or "") else 1.0)
    return (day - JULIAN_DAY_1970) * DAY_S + HOUR_S * clock[0] + 60.0 * clock[1] + clock[2] - ahead_s


def _decimal_years(years: Floats) -> Floats:
    whole = np.floor(years)
    begin, end = ((whole + k - 1970.0).astype("datetime64[Y]").astype("datetime64[s]").astype(float) for k in (0, 1))
    return np.round(begin + (years - whole) * (end - begin), 3)


SCALES: dict[str, tuple[Callable[[Floats], Floats], str]] = {
    "epoch": (lambda x: x, "seconds since 1970"),
    "epoch_ms": (lambda x: x / 1e3, "milliseconds since 1970"),
    "datenum": (lambda x: np.round((x - DATENUM_1970) * DAY_S, 3), "MATLAB's datenum"),
    "excel": (lambda x: np.round((x - 25569.0) * DAY_S, 3), "Excel's days"),
    "decimal_year": (_decimal_years, "years with a fraction of their own length"),
}


def _from_scale(scale: str, cells: Sequence[str], values: Floats | None) -> Floats:
    if values is None or not np.isfinite(values).all():
        row = next((k for k, cell in enumerate(cells) if values is None or not np.isfinite(values[k])), 0)
        raise _refused(cells, row, f"a number ({SCALES[scale][1]})", "mend the line or correct time_format")
    if (beyond := np.flatnonzero(~_within(scale, values, YEARS))).size:
        expected = f"{SCALES[scale][1]} between {YEARS[0]} and {YEARS[1] - 1}"
        raise _refused(cells, int(beyond[0]), expected, "mend the line or correct time_format")
    return SCALES[scale][0](values)


def _within(scale: str, values: Floats, years: tuple[int, int]) -> Bools:
    """Return whether each number is a time between two years, the last excluded, (n,)."""
    low, high = (np.datetime64(f"{year}-01-01", "s").astype(float) for year in years)
    time_s = SCALES[scale][0](values if scale != "decimal_year" else np.clip(values, 1.0, 9999.0))
    return (time_s >= low) & (time_s < high)


def _detect_scale(cells: Sequence[str], values: Floats | None) -> str:
    """Detect the scale on which all numbers lie between 1980 and 2030."""
    if values is None or not np.isfinite(values).all() or not len(values):
        row = next((k for k, cell in enumerate(cells) if values is None or not np.isfinite(values[k])), 0)
        row = next((k for k, cell in enumerate(cells) if not _NUMBERLIKE.fullmatch(cell)), row)
        if _SHORT_YEAR.fullmatch(cells[row]):
            raise _refused(cells, row, "years of four figures", "write time_format, for example '%d/%m/%y'")
        if named := _ZONE_NAME.fullmatch(cells[row]):
            advice = "take the name out, and write timezone where it is not UTC"
            raise _refused(cells, row, f"UTC or an offset instead of {named[1]}", advice)
        raise _refused(cells, row)
    # Integers of days or years may be anything, such as concatenated dates.
    scales = ("epoch", "epoch_ms", *(("datenum", "decimal_year") if np.any(values % 1.0) else ()))
    if scale := next((scale for scale in scales if _within(scale, values, USUAL_YEARS).all()), None):
        return scale
    advice = "write time_format: epoch, epoch_ms, datenum, decimal_year or excel"
    raise Unreadable(None, f"numbers from {np.min(values):.10g} to {np.max(values):.10g}", "times", advice)


def _parse_format(cells: Sequence[str], form: str, ahead_s: float) -> Floats:
    import pandas as pd  # imported only for a given format, as this takes longer than parsing a table

    try:
        parsed = pd.to_datetime(pd.Index(cells, dtype=object), format=form, errors="coerce", utc=True)
    except ValueError as error:
        raise Unreadable(None, repr(form), "a strptime format", f"correct time_format ({error})") from None
    lost = np.flatnonzero(parsed.isna())
    if len(lost):
        row = int(lost[0])
        raise _refused(cells, row, f"a time like {form}", "mend the line or correct time_format")
    time_s = parsed.to_numpy(dtype="datetime64[us]").astype(np.int64) / 1e6
    return time_s - (0.0 if "%z" in form else ahead_s)


def _parse_fields(cells: Sequence[str]) -> tuple[Floats, Floats, str] | None:
    """Parse cells by the format of the first one, as (local time, UTC offset, note); None if no known format matches.

    Local times are seconds since 1970, offsets seconds ahead of UTC, (n,) each; offsets are NaN where not stated.
    """
    form = next((form for form, pattern in _PATTERNS.items() if cells and pattern.fullmatch(cells[0])), None)
    if form is None:
        return None
    matches = list(map(_PATTERNS[form].fullmatch, cells))
    if None in matches:
        row = matches.index(None)
        expected = TIME_FORM if form == "iso" else f"a time like {cells[0]!r}, as in the first row"
        raise _refused(cells, row, expected, "" if form == "iso" else f"mend the line, or {SETTLE}")
    names = list(_PATTERNS[form].groupindex)
    groups = dict(zip(names, zip(*(match.groups() for match in matches if match), strict=True), strict=True))
    n = len(cells)
    column = {
        name: np.array([float(text.replace(",", ".")) if text else 0.0 for text in groups[name]])
        for name in ("y", "m", "d", "a", "b", "H", "M", "S")
        if name in groups
    }
    note = {"iso": "", "compact": "dates as yyyymmdd", "run together": "times as yyyymmddhhmm"}.get(form, "")
    if form == "figures":
        column["d"], column["m"], note = _day_and_month(cells, column["a"], column["b"], column["y"])
    if "name" in groups:
        number = {name: k for k, long in enumerate(MONTHS.split(), 1) for name in (long, long[:3])} | {"sept": 9}
        for row, name in enumerate(groups["name"]):
            if name.lower() not in number:
                advice = "write the months in figures or in English"
                raise _refused(cells, row, "an English name of a month", advice)
        column["m"], note = np.array([float(number[name.lower()]) for name in groups["name"]]), "months by their names"
    hour, half = column.get("H", np.zeros(n)), groups.get("half", (None,) * n)
    if any(half):  # 12-hour clock with AM or PM
        wrong = next((k for k, letter in enumerate(half) if not letter or not 1 <= hour[k] <= 12), None)
        if wrong is not None:
            raise _refused(cells, wrong, "an hour from 1 to 12 with AM or PM, as in other rows")
        hour = hour % 12.0 + 12.0 * np.array([letter in "pP" for letter in half if letter])
    zones = [np.nan if zone is None else _offset_s(zone) for zone in groups["zone"]] if any(groups["zone"]) else []
    zone_s = np.array(zones) if zones else np.full(n, np.nan)
    zone_s[np.isnan(zone_s) & np.array([cell[-1] in "ZCT" for cell in cells])] = 0.0  # Z, UTC, GMT
    clock = hour, column.get("M", np.zeros(n)), column.get("S", np.zeros(n))
    return _fields_to_seconds(cells, column["y"], column["m"], column["d"], *clock), zone_s, note


def _day_and_month(cells: Sequence[str], a: Floats, b: Floats, year: Floats) -> tuple[Floats, Floats, str]:
    """Distinguish days from months in numeric dates, and describe the row that decides; reject ambiguous columns."""
    first, second = np.flatnonzero(a > 12.0), np.flatnonzero(b > 12.0)
    expected = "dates in which day and month can be told apart"
    if len(first) and len(second):
        row = int(max(first[0], second[0]))
        raise Unreadable(row, f"{cells[row]!r} beside {cells[int(min(first[0], second[0]))]!r}", expected, SETTLE)
    if not len(first) and not len(second) and (a != b).any():
        row = int(np.flatnonzero(a != b)[0])
        advice = "write time_format: '%d/%m/%Y ...' or '%m/%d/%Y ...' with the file's own signs"
        raise Unreadable(row, f"{cells[row]!r}, and no row with a number above 12", expected, advice)
    day, month, which, settles = (b, a, "month first", second) if len(second) else (a, b, "day first", first)
    order = np.diff(year * 372.0 + month * 31.0 + day)
    if (order < 0.0).any() and (order > 0.0).any():
        back = int(np.flatnonzero(order * np.sign(np.sum(np.sign(order)) or 1.0) < 0.0)[0]) + 1
        shown = f"{cells[back]!r} behind {cells[back - 1]!r}, which goes back if it is {which}"
        raise Unreadable(back, shown, expected, SETTLE)
    return day, month, f"dates {which}" + (f" ({cells[settles[0]]} settles it)" if len(settles) else "")


def _fields_to_seconds(
    cells: Sequence[str], year: Floats, month: Floats, day: Floats, hour: Floats, minute: Floats, second: Floats
) -> Floats:
    """Convert date and time fields, (n,) each, to seconds since 1970; reject invalid dates and times."""
    months = ((year - 1970.0) * 12.0 + np.clip(month, 1.0, 12.0) - 1.0).astype(np.int64).astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (day - 1.0).astype("timedelta64[D]")
    wrong: Bools = (days.astype("datetime64[M]") != months) | (month < 1.0) | (month > 12.0)
    wrong |= (hour > 23.0) | (minute > 59.0) | (second >= 60.0)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise _refused(cells, row)
    clock_us = np.round((hour * HOUR_S + minute * 60.0 + second) * 1e6)
    return (days.astype("datetime64[us]").astype(np.int64) + clock_us) / 1e6


def _zone_offset_s(cells: Sequence[str], zone_s: Floats, zone: str | None, ahead_s: float) -> Floats:
    """Determine the UTC offset of each cell, (n,) seconds ahead: as stated in the cell, or else the given zone."""
    stated = np.isfinite(zone_s)
    unstated = np.flatnonzero(~stated)
    if len(unstated) and np.any(zone_s[stated] != 0.0) and zone is None:
        raise _refused(cells, int(unstated[0]), "an offset from UTC as in other rows", "write timezone")
    if zone is not None and np.any(zone_s[stated] != ahead_s):
        row = int(np.flatnonzero(stated & (zone_s != ahead_s))[0])
        raise _refused(cells, row, f"times at {zone}, as timezone says", "correct or delete timezone")
    return np.where(stated, zone_s, ahead_s)


def describe_averages(average_s: float, time_s: Floats, *, least_s: float = 120.0) -> tuple[str, ...]:
    """Describe the offset between the midpoints of averages and their time stamps, if it is a minute or more.

    Samples at intervals shorter than 90 % of the averaging time are single pings, whatever setting was recorded.
    """
    steps = np.diff(time_s)
    steps = steps[steps > 0.0]
    single = len(steps) > 0 and float(np.median(steps)) < 0.9 * average_s
    if not average_s >= least_s or single:
        return ()
    half = average_s / 2.0
    return (
        f"Each sample is the mean of {average_s:g} s from its time on: its middle is {half:g} s later; "
        f"clock_offset_seconds: -{half:g} moves it there.",
    )


def civil_seconds(
    year: Ints, month: Ints, day: Ints, hour: Ints, minute: Ints, second: Ints, hundredths: Ints | int = 0, *,
    last_year: int = LAST_YEAR,
) -> Floats:  # fmt: skip
    """Convert dates and times of day, (n,) each, to UTC seconds since 1970; NaN for invalid dates or times."""
    real = (year >= FIRST_YEAR) & (year <= last_year) & (month >= 1) & (month <= 12)
    months = np.where(real, 12 * (year - 1970) + month - 1, 0)
    first, following = (
        m.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) for m in (months, months + 1)
    )
    real &= (day >= 1) & (day <= following - first)
    for value, end in ((hour, 24), (minute, 60), (second, 60), (hundredths, 100)):
        real &= (value >= 0) & (value < end)
    seconds = 86400 * (first + day - 1) + 3600 * hour + 60 * minute + second
    return np.where(real, seconds + hundredths / 100.0, np.nan)
