"""Parse times to UTC seconds since 1970: unambiguous formats are detected, all others require ``time_format``.

A value above 12 tells the day from the month. Cells that differ in their digits only are parsed together.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers.cells import ZERO, Column, parse_numbers
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
NUMBER_OF = {name: k for k, long in enumerate(MONTHS.split(), 1) for name in (long, long[:3])} | {"sept": 9}

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
_NOTES = {"compact": "dates as yyyymmdd", "run together": "times as yyyymmddhhmm"}
DIRECTIVES = {  # of strptime
    "Y": r"(?P<y>\d{4})", "y": r"(?P<short>\d\d)", "m": r"(?P<m>\d{1,2})", "d": r"(?P<d>\d{1,2})",
    "j": r"(?P<day>\d{1,3})", "b": r"(?P<name>[A-Za-z]{3,9})", "B": r"(?P<name>[A-Za-z]{3,9})",
    "H": r"(?P<H>\d{1,2})", "I": r"(?P<H>\d{1,2})", "M": r"(?P<M>\d{1,2})", "S": r"(?P<S>\d{1,2})",
    "f": r"(?P<f>\d{1,9})", "p": r"(?P<half>[AaPp])[Mm]", "z": r"(?:Z|(?P<zone>[+-]\d\d:?\d\d))", "%": "%",
}  # fmt: skip
_SINCE = re.compile(
    r"(?:(?P<packed>\d{8})|(?P<y>[+-]?\d{1,4})(?:(?P<part>[-/])(?P<m>\d{1,2})(?:(?P=part)(?P<d>\d{1,2}))?)?)"
    r"(?:(?: *T| +) *(?P<H>\d{1,2})(?::(?P<M>\d{1,2})(?::(?P<S>\d{1,2}(?:\.\d*)?))?)?"
    r" *(?:Z|UTC|GMT|(?P<zone>(?:[+-]| +[+-]?)\d{1,2}(?::?\d\d)?))?| *(?:Z|UTC|GMT))?",
    re.ASCII | re.IGNORECASE,
)


class Unreadable(Exception):
    """A cell of times, by the index of its row, or a column (None) that cannot be parsed."""

    def __init__(self, row: int | None, shown: str, expected: str, advice: str):
        super().__init__(shown)
        self.row, self.shown, self.expected, self.advice = row, shown, expected, advice


@dataclass(frozen=True)
class _Cells:
    """Time cells, and the form that all must have."""

    column: Column
    expected: str
    advice: str

    def refuse(self, wrong: Bools, expected: str = "") -> None:
        """Raise the error for the first wrong cell, if any is."""
        if wrong.any():
            row = int(np.argmax(wrong))
            raise Unreadable(row, repr(self.column.text(row)), expected or self.expected, self.advice)


def parse_times(
    column: Column, *, form: str | None = None, zone: str | None = None, decimal: str | None = None
) -> tuple[Floats, str]:
    """Parse cells as UTC seconds since 1970, (n,), and describe the detected format; empty for ISO or a given format.

    Args:
        form: a strptime format, or a scale of ``SCALES``.
        zone: of cells that state none, UTC or an offset such as +02:00.
        decimal: mark of times that are numbers; None accepts both.

    Raises:
        Unreadable: a cell is not a valid time, or is ambiguous.
    """
    if not len(column):
        return np.zeros(0), ""
    first, name = column.text(0), ""
    if form is None:
        name = next((name for name, pattern in _PATTERNS.items() if pattern.fullmatch(first)), "")
        expected = f"a time like {first!r}, as in the first row" if name not in ("", "iso") else TIME_FORM
        cells = _Cells(column, expected, f"mend the line, or {SETTLE} for another form")
        pattern = _PATTERNS.get(name)
    else:
        expected = SCALES[form][1] if form in SCALES else f"a time like {form}"
        cells = _Cells(column, expected, "mend the line or correct time_format")
        pattern = None if form in SCALES else _pattern_of(form)
    if pattern is None:
        values, _ = parse_numbers(column, decimal, ())
        cells.refuse(~np.isfinite(values))
        time_s, note = from_numbers(values, form)
        return time_s - parse_zone(zone), note
    fields = _read_fields(cells, pattern)
    note = _NOTES.get(name, "months by their names" * ("name" in fields and form is None))
    if "a" in fields:
        fields["d"], fields["m"], note = _day_and_month(cells, fields["a"], fields["b"])
    if "half" in fields and (fields["half"] > 0.0).any():  # 12-hour clock with AM or PM
        wrong = (fields["half"] == 0.0) | (fields["H"] < 1.0) | (fields["H"] > 12.0)
        cells.refuse(wrong, "an hour from 1 to 12 with AM or PM, as in other rows")
        fields["H"] = fields["H"] % 12.0 + 12.0 * (fields["half"] - 1.0)
    stated, ahead_s = np.isfinite(fields["zone"]), parse_zone(zone)
    if zone is not None:
        cells.refuse(stated & (fields["zone"] != ahead_s), f"times at {zone}, as timezone says")
    elif np.any(fields["zone"][stated] != 0.0):
        cells.refuse(~stated, "an offset from UTC as in other rows")
    time_s = _to_seconds(cells, fields, packed=name in _NOTES)
    return time_s - np.where(stated, fields["zone"], ahead_s), note


def _pattern_of(form: str) -> re.Pattern[str]:
    """Translate a strptime format; Unreadable if it has an unknown directive, or one twice."""
    parts = re.split(r"(%.|\s+)", form, flags=re.DOTALL)
    try:
        parts = [DIRECTIVES[part[1:]] if part[:1] == "%" else re.escape(part) for part in parts if part.strip()]
        return re.compile(r"\s*".join(parts) if " " in form else "".join(parts), re.ASCII)
    except (KeyError, re.error) as error:
        known = " ".join(f"%{letter}" for letter in DIRECTIVES)
        raise Unreadable(None, repr(form), f"a format of {known}", f"correct time_format ({error})") from None


def _read_fields(cells: _Cells, pattern: re.Pattern[str]) -> dict[str, Floats]:
    """Read the numbers of the named groups of a pattern, (n,) each, from cells that differ in their digits only.

    Zero stands for an absent one; ``half`` is 1 for AM and 2 for PM, ``zone`` in seconds ahead of UTC, NaN if absent.
    """
    column, n = cells.column, len(cells.column)
    characters, length = column.characters(), column.end - column.begin
    figures = characters - np.uint8(ZERO)
    shape = np.ascontiguousarray(np.where(figures < 10, np.uint8(ZERO), characters).T)
    shape = shape.view(f"S{shape.shape[1]}")[:, 0]
    fields: dict[str, Floats] = {name: np.zeros(n) for name in {*pattern.groupindex} - {"part"}}
    fields["zone"] = np.full(n, np.nan)
    unread = np.arange(n)
    while unread.size:
        row = int(unread[0])
        alike = (shape[unread] == shape[row]) & (length[unread] == length[row])
        match = pattern.fullmatch(text := column.text(row))
        if match is None:
            cells.refuse(np.arange(n) == row)
            break
        here: Any = slice(None) if alike.all() and len(unread) == n else unread[alike]
        for name in fields.keys() & match.groupdict().keys():
            begin, end = match.span(name)
            at = [k for k in range(begin, end) if text[k].isdigit()]
            number = reduce(lambda value, k: 10.0 * value + figures[k, here], at, 0.0)
            if name == "name":
                number = NUMBER_OF.get(text[begin:end].lower(), 0)
                cells.refuse((np.arange(n) == row) & (number == 0), "an English name of a month")
            if name == "half":
                number = 0.0 if begin < 0 else 1.0 + (text[begin] in "pP")
            if name in "Sf":  # seconds with a fraction, or the fraction alone
                number = number / 10.0 ** max(len(at) - 2 * (name == "S"), 0)
            if name == "zone" and at:
                number = 60.0 * (60.0 * (number // 100.0) + number % 100.0) if len(at) > 2 else number * HOUR_S
                number = -number if text[begin] == "-" else number
            if name != "zone" or at:
                fields[name][here] = number
        if text[-1] in "ZCT":  # Z, UTC, GMT
            fields["zone"][here] = 0.0
        unread = unread[~alike]
    return fields


def _day_and_month(cells: _Cells, a: Floats, b: Floats) -> tuple[Floats, Floats, str]:
    """Distinguish days from months in numeric dates, and describe the row that decides; reject ambiguous columns."""
    first, second = np.flatnonzero(a > 12.0), np.flatnonzero(b > 12.0)
    settling = [cells.column.text(int(rows[0])) for rows in (first, second) if rows.size]
    if len(settling) != 1 and (a != b).any():
        row = int(np.argmax(a != b)) if not settling else max(int(first[0]), int(second[0]))
        shown = " beside ".join(map(repr, settling)) or f"{cells.column.text(row)!r}, and no row with a number above 12"
        advice = "write time_format: '%d/%m/%Y ...' or '%m/%d/%Y ...' with the file's own signs"
        raise Unreadable(row, shown, "dates in which day and month can be told apart", advice)
    day, month, which = (b, a, "month first") if second.size else (a, b, "day first")
    return day, month, f"dates {which}" + "".join(f" ({text} settles it)" for text in settling)


def _to_seconds(cells: _Cells, fields: dict[str, Floats], *, packed: bool) -> Floats:
    """Convert dates and times of day to seconds since 1970; refuse invalid ones."""
    zero = np.zeros(len(cells.column))
    if "short" in fields:
        fields["y"] = full_years(fields["short"])
    month, day = fields.get("m", fields.get("name", zero + 1.0)), fields.get("d", zero + 1.0)
    second = fields.get("S", zero) + fields.get("f", zero)
    leap = second == 60.0
    whole = (fields["y"], month, day, fields.get("H", zero), fields.get("M", zero), zero)
    time_s = civil_seconds(*(part.astype(np.int64) for part in whole), first_year=1, last_year=9999)
    wrong = np.isnan(time_s) | (second >= 60.0) & ~leap | (np.abs(np.nan_to_num(fields["zone"])) > 14.99 * HOUR_S)
    if packed:  # eight figures may be anything
        wrong |= (fields["y"] < YEARS[0]) | (fields["y"] >= 2100.0)
    if "day" in fields:
        time_s = time_s + (fields["day"] - 1.0) * DAY_S
        wrong |= (fields["day"] < 1.0) | (time_s >= new_year(fields["y"] + 1.0))
    cells.refuse(wrong)
    # A leap second stays before the next minute, whose row is another.
    return np.asarray(np.round(time_s * 1e6) + np.round(np.where(leap, 59.999, second) * 1e6), dtype=float) / 1e6


def from_numbers(values: Floats, scale: str | None = None) -> tuple[Floats, str]:
    """Convert numbers to UTC seconds since 1970, (n,), NaN where missing, and describe the detected scale.

    It is the first on which all numbers lie between 1980 and 2030.

    Raises:
        Unreadable: the scale is not stated, and the numbers do not determine it; or a number is no time on it.
    """
    known = values[np.isfinite(values)]
    # Integers of days or years may be anything, such as concatenated dates.
    detected = ("epoch", "epoch_ms", *(("datenum", "decimal_year") if np.any(known % 1.0) else ()))
    name = scale or next((name for name in detected if _within(name, known, USUAL_YEARS).all()), None)
    if name is None:
        advice = "write time_format: epoch, epoch_ms, datenum, matplotlib, decimal_year or excel"
        shown = f"numbers from {np.min(known):.10g} to {np.max(known):.10g}"
        raise Unreadable(None, shown, "times", advice)
    wrong = np.isfinite(values) & ~_within(name, values, YEARS)
    if wrong.any():
        row, expected = int(np.argmax(wrong)), f"{SCALES[name][1]} between {YEARS[0]} and {YEARS[1] - 1}"
        raise Unreadable(row, repr(float(values[row])), expected, "mend the line or correct time_format")
    return SCALES[name][0](values), "" if scale else f"times as {SCALES[name][1]}"


def _within(scale: str, values: Floats, years: tuple[int, int]) -> Bools:
    """Return whether each number is a time between two years, the last excluded, (n,)."""
    low, high = (np.datetime64(f"{year}-01-01", "s").astype(float) for year in years)
    time_s = SCALES[scale][0](values)
    return (time_s >= low) & (time_s < high)


def full_years(year: Floats) -> Floats:
    """Complete years of two figures, as POSIX does."""
    return year + np.where(year >= 100.0, 0.0, np.where(year >= 69.0, 1900.0, 2000.0))


def from_parts(parts: Sequence[Floats]) -> tuple[Floats, int | None]:
    """Combine columns of a time, (n,) each, to UTC seconds since 1970; also give the first row that is no time.

    Args:
        parts: year and day of the year, 1.0 on 1 January at 0 h; or year, month, day, and hour, minute and second as
            far as they are known. The last one may have a fraction.
    """
    year, *others = [np.nan_to_num(part, nan=-1.0) for part in parts]
    if len(others) == 1:
        time_s: Floats = np.round(new_year(year) + (others[0] - 1.0) * DAY_S, 3)
        wrong = (others[0] < 1.0) | (time_s >= new_year(year + 1.0))
    else:
        whole = [np.floor(part).astype(np.int64) for part in (year, *others)]
        whole += [np.zeros_like(whole[0])] * (6 - len(whole))
        fraction = (others[-1] % 1.0) * (0.0, DAY_S, HOUR_S, 60.0, 1.0)[len(others) - 1]
        time_s = np.asarray(np.round((civil_seconds(*whole, first_year=YEARS[0]) + fraction) * 1e3) / 1e3, dtype=float)
        wrong = np.any([part % 1.0 != 0.0 for part in (year, *others[:-1])], axis=0)
    wrong |= np.isnan(time_s) | (year < YEARS[0])
    return time_s, int(np.argmax(wrong)) if wrong.any() else None


def new_year(year: Floats) -> Floats:
    """Find the beginning of years, UTC seconds since 1970; NaN if they are not in 1 to 9999."""
    real = (year >= 1.0) & (year <= 9999.0)
    begin = (np.where(real, year, 1970.0) - 1970.0).astype("datetime64[Y]").astype("datetime64[s]").astype(float)
    return np.where(real, begin, np.nan)


def parse_zone(zone: str | None) -> float:
    """Parse UTC or an offset such as +02:00 as seconds ahead of UTC; InputError if it is neither."""
    if zone in (None, "UTC"):
        return 0.0
    if not (parts := re.fullmatch(r"([+-])(\d\d):?(\d\d)", str(zone))):
        raise InputError("timezone", "UTC, or an offset such as +02:00", repr(zone), "give the offset from UTC")
    return (60 * int(parts[2]) + int(parts[3])) * (-60.0 if parts[1] == "-" else 60.0)


def parse_origin(text: str, calendar: str) -> float:
    """Parse the reference time of a unit such as "days since", UTC seconds since 1970.

    The text is a date, optionally a time of day and an offset from UTC, as in 1992-10-8 15:15:42.5 -6:00 (CF 4.4).

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
    begin, end = new_year(whole), new_year(whole + 1.0)
    return np.round(begin + (years - whole) * (end - begin), 3)


SCALES: dict[str, tuple[Callable[[Floats], Floats], str]] = {
    "epoch": (lambda x: x, "seconds since 1970"),
    "epoch_ms": (lambda x: x / 1e3, "milliseconds since 1970"),
    "datenum": (lambda x: np.round((x - DATENUM_1970) * DAY_S, 3), "MATLAB's datenum"),
    "matplotlib": (  # since 1970, or since the end of the year 0 as before version 3.3
        lambda x: np.round(np.where(x > DATENUM_1970 - 366.0, x - DATENUM_1970 + 366.0, x) * DAY_S, 3),
        "matplotlib's days",
    ),
    "excel": (lambda x: np.round((x - 25569.0) * DAY_S, 3), "Excel's days"),
    "julian": (lambda x: np.round((x - JULIAN_DAY_1970) * DAY_S, 3), "chronological Julian days, from midnight on"),
    "decimal_year": (_decimal_years, "years with a fraction of their own length"),
}


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
    first_year: int = FIRST_YEAR, last_year: int = LAST_YEAR,
) -> Floats:  # fmt: skip
    """Convert dates and times of day, (n,) each, to UTC seconds since 1970; NaN for invalid dates or times."""
    real = (year >= first_year) & (year <= last_year) & (month >= 1) & (month <= 12)
    months = np.where(real, 12 * (year - 1970) + month - 1, 0)
    first, following = (
        m.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) for m in (months, months + 1)
    )
    real &= (day >= 1) & (day <= following - first)
    for value, end in ((hour, 24), (minute, 60), (second, 60), (hundredths, 100)):
        real &= (value >= 0) & (value < end)
    seconds = 86400 * (first + day - 1) + 3600 * hour + 60 * minute + second
    return np.where(real, seconds + hundredths / 100.0, np.nan)
