"""Read text tables: columns of numbers, times and quality flags, by the names in a header line or by their numbers.

What a ``Layout`` leaves open is detected where it is unambiguous, and reported; else an error names the key to set.
A row with surplus cells, a missing requested cell or a word in place of a number raises an error, as shifted cells can
still parse as numbers; only an unterminated last line may be truncated, and is dropped.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import reduce
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import times, vocabulary
from compasslib.readers.cells import BLANKS, MISSING_TEXT, NUMBER, Column, Rows, parse_numbers, split_rows
from compasslib.readers.files import read_text
from compasslib.records import NOT_CHECKED, PROBABLY_BAD
from compasslib.types import Floats

COLUMN_MAP = "correct columns in the mooring file"
TIMES = ("time", "time_utc")  # roles of time columns
FLAG = "flag"  # role of quality flags: words or values; ``flag_ROLE`` are those of one column
DATE_AND_CLOCK = ("date", "clock")  # roles of the date and the time of day, combined into ``time``
NUMBER_FORM = "a number or nothing"
MEND = "mend or remove the line"
JOIN = "list the columns of the time: time: [YEAR, MONTH, DAY, HOUR, MINUTE, SECOND]"
APART_TIMES = "date and time of day are two columns: date and clock"
DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}  # in order of preference
HEAD_LINES = 1000  # searched for the header
NUMBER_STARTS = tuple("+-.0123456789")
COMMENT_MARKS = ("#", "%")  # at the beginning of lines without data
QUOTES = " \t=\"'"  # stripped around headers and times: left by repeated export, or ="..."
APART = "\x1f"  # stands between cells that were quoted
Header = str | int | Sequence[str | int]  # name or number of a column; several are the parts of a time
_ONLY_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
_APART = re.compile(r"\d +[-+.\d]")
_CLOCK = re.compile(r"\d{1,2}:\d\d")
_WORD = re.compile(r'=?"[^"\n]*"|\S+')
_FLAGS = re.compile(r"(?i)(?:^|[\W_])(?:qv|qc|flags?)(?:$|[\W_])")  # headers of quality flags
_PART = re.compile(r"(?i)y{2,4}|years?|months?|days?|hours?|minutes?|seconds?")  # headers of a part of a time
_UNIT = re.compile(r"(?=.*[^\W\d_]|.*%|.*°)(?!.*\d\d)[^\n]{1,40}|", re.DOTALL)  # metres, cm s-1, [°C], %


@dataclass(frozen=True)
class Layout:
    """Format of a table as set in the YAML file; None where it is not set."""

    delimiter: str | None = None  # character between cells
    decimal: str | None = None  # decimal mark, a point or a comma
    time_format: str | None = None  # strptime format, or a key of ``times.SCALES``
    timezone: str | None = None  # UTC or an offset such as +02:00
    missing: tuple[str, ...] = ()  # texts that stand for missing values, besides ``cells.MISSING_TEXT``
    skip_rows: int | None = None  # number of lines to skip above the header
    header: int | None = None  # number of the header line, 0 for none
    comment: str | None = None  # mark at the beginning of lines without data

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Layout:
        """Create a layout from the table keys of a mooring file's section."""
        given = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**(given | {"missing": tuple(given["missing"] or ())}))

    def is_comment(self, line: str) -> bool:
        """Return whether a line begins with a mark of lines without data."""
        return line.lstrip().startswith(self.comment or COMMENT_MARKS)

    def split_header(self, line: str, delimiter: str) -> list[str]:
        """Split a header line, which may be written as a comment, as by numpy.savetxt."""
        text = line.lstrip()
        if self.is_comment(line):
            line = text.lstrip(self.comment or text[0]).strip() or line
        return [cell.strip(QUOTES) for cell in split_line(line, delimiter)]


DEFAULT_LAYOUT = Layout()


@dataclass(frozen=True)
class Head:
    """Header of a table, and its first lines."""

    source: bytes  # the whole text in UTF-8, all lines terminated by line feeds
    names: list[str]  # of the columns; NAME.2 for the second of a name, 1, 2, ... without a header
    line: int  # index of the first line below the header
    begin: int  # its byte offset
    delimiter: str = ""
    notes: tuple[str, ...] = ()  # detected format, in words
    text: str = ""  # header line
    clock: int | None = None  # index of a column without a name that continues the time before it
    ended: bool = True  # whether the last line was terminated
    sample: list[list[str]] = field(default_factory=list)  # cells of the first rows
    remarks: list[list[str]] = field(default_factory=list)  # cells of the comments between header and first row


@dataclass(frozen=True)
class Table:
    """Columns of a table by role."""

    columns: dict[str, Floats]  # (rows,) each; times in UTC seconds since 1970, NaN where missing
    rows: int
    cut: int  # number of lines dropped, as they lack cells
    said: Mapping[str, tuple[str, ...]]  # role -> header, and cells of the unit lines
    warnings: tuple[str, ...]  # detected format, in words, lines dropped, and flags of unknown meaning


def read_table(
    path: Path,
    headers: Mapping[str, Header],
    advice: str = COLUMN_MAP,
    layout: Layout = DEFAULT_LAYOUT,
    meanings: Mapping[str, int] = MappingProxyType({}),
    *,
    carried: Collection[str] = (),
) -> Table:
    """Read the requested columns of one table.

    Args:
        headers: role -> header, or number of the column from 1; several are the parts of a time. ``date`` and ``clock``
            become ``time``, ``flag`` and ``flag_ROLE`` hold quality flags, which ``meanings`` interprets.
        advice: for a missing column.
        carried: roles whose empty cells repeat the cell above.

    Raises:
        InputError: the file or a column is missing, or a time or number is unreadable or ambiguous.
    """
    named = {role: [header] if isinstance(header, str | int) else [*header] for role, header in headers.items()}
    head = read_head(path, [header for each in named.values() for header in each], layout)
    places = {role: [_place(path, head, role, header, advice) for header in each] for role, each in named.items()}
    wanted = {place for each in places.values() for place in each}
    units = _count_units(head, sorted(wanted), head.sample)
    body = open_body(path, head, wanted, layout, skip=units)
    written = unit_lines(head, sorted(wanted))
    said = {
        role: tuple(row[place].strip() for place in each for row in (head.names, *written))
        for role, each in places.items()
    }
    timed = {role: places.pop(role) for role in (*TIMES, *DATE_AND_CLOCK) if role in places}
    columns, time_note = body.times(timed, carried)
    flagged, unknown = [role for role in places if role.partition("_")[0] == FLAG], list[str]()
    for role in flagged:
        columns[role], warnings = body.flags(places.pop(role)[0], meanings)
        unknown += warnings
    if not flagged and "north" in headers and (unused := [name for name in head.names if _FLAGS.search(name)]):
        shown = ", ".join(unused)
        unknown = [f"{path.name}: flags stand in {shown}, which columns do not name as flag: none was used."]
    numbers, by_comma = body.numbers({role: each[0] for role, each in places.items()})
    notes = [*head.notes, *["units below the header"] * bool(written)]
    notes += ["decimal commas"] * by_comma + [time_note] * bool(time_note)
    twice = {header for each in named.values() for header in each if f"{header}.2" in head.names}
    notes += [f"the first of the columns {name}, of which {name}.2 is the second" for name in sorted(twice)]
    read = [f"the table was read as it is written: {', '.join(notes)}"] if notes else []
    return Table(columns | numbers, len(body.rows.width), body.cut, said, (*read, *body.notes, *unknown))


def date_and_clock(headers: Mapping[str, str], withheld: Collection[str] = ()) -> dict[str, str]:
    """Select the headers of date and clock; empty unless both are given and neither these nor a time is withheld."""
    parts = {role: headers[role] for role in DATE_AND_CLOCK if headers.get(role)}
    usable = len(parts) == len(DATE_AND_CLOCK) and not {*parts, *parts.values(), *TIMES} & set(withheld)
    return parts if usable else {}


def table_notes(tables: Iterable[Table]) -> tuple[str, ...]:
    """Collect the warnings of several tables, without duplicates."""
    return tuple(dict.fromkeys(warning for table in tables for warning in table.warnings))


def read_head(path: Path, needed: Iterable[str | int], layout: Layout = DEFAULT_LAYOUT) -> Head:
    """Read the header of a table, the first line with all the names that are needed, else the first line of all.

    Raises:
        InputError: the file cannot be read.
    """
    needed = [*needed]
    wanted = {name for name in needed if isinstance(name, str)}
    if needed and not wanted and layout.header is None:
        layout = replace(layout, header=0)  # columns by their numbers need no header

    def has_all(names: Sequence[str]) -> bool:
        numbered = _number_repeated(names)
        return all(_index(name, numbered) is not None for name in wanted)

    head = find_head(path, has_all, layout)
    assert head is not None  # without ``must`` the first line is the fallback
    return head


def find_head(
    path: Path,
    fits: Callable[[Sequence[str]], bool],
    layout: Layout = DEFAULT_LAYOUT,
    *,
    delimiters: Iterable[str] = DELIMITERS,
    must: bool = False,
) -> Head | None:
    """Locate the header by a predicate of its column names; if no line fits, it is the first, or None if one ``must``.

    Raises:
        InputError: the file cannot be read.
    """
    source, notes, ended = read_text(path)
    end, skipped = 0, layout.skip_rows or 0
    for _ in range(skipped + HEAD_LINES):
        end = source.find(b"\n", end) + 1 or len(source)
    lines = source[:end].decode(errors="replace").split("\n")[:-1]
    filled = [k for k in range(min(skipped, len(lines)), len(lines)) if lines[k].strip(" \t\r\n,;")]
    rows = [k for k in filled if not layout.is_comment(lines[k])]
    candidates = [layout.delimiter] if layout.delimiter else [*delimiters]
    located = _locate_header(lines, rows, [k for k in filled if k not in {*rows}], layout, candidates, fits)
    if located is None and must:
        return None
    at, delimiter = located or (layout.header - 1 if layout.header else next(iter(rows), skipped), "")
    line = lines[at] if at < len(lines) else ""
    delimiter = delimiter or next((each for each in candidates if _parts(line.strip(), each)), " ")
    names = layout.split_header(line, delimiter) if line else []
    remarks = list[list[str]]()
    if layout.header == 0:  # columns by their numbers; names and units may stand in comments, or in a row of words
        first = at if any(name.startswith(NUMBER_STARTS) for name in names) else at + 1  # row of numbers
        worded = [layout.split_header(lines[k], delimiter) for k in filled if k < first]
        named = [cells for cells in worded if len(cells) == len(names)]
        names, *remarks = named or [[str(k) for k in range(1, len(names) + 1)]]
        at, line = first - 1, ""
    if delimiter != "," and layout.delimiter is None:
        notes.append(f"cells between {DELIMITERS.get(delimiter)}")
    if layout.header is None and (above := sum(k < at for k in rows)):
        notes.append(f"{above} line{'s' * (above > 1)} above the header")
    sample = [split_line(lines[k], delimiter) for k in rows if k > at]
    clock = None
    if delimiter == " " and sample and all(len(row) == len(names) + 1 for row in sample):  # one name for date and clock
        clock = next((k for k, cell in enumerate(sample[0]) if k and ":" in cell), None)
        names = names if clock is None else [*names[:clock], "", *names[clock:]]
    names = _number_repeated(names)
    begin = sum(len(line.encode()) + 1 for line in lines[: at + 1])
    first = next((k for k in rows if k > at), at)
    marks = " " + (layout.comment or "".join(COMMENT_MARKS))
    below = [lines[k].lstrip(marks).rstrip(" \r") for k in filled if at < k < first]
    remarks += [split_line(line, delimiter) for line in below]
    return Head(source, names, at + 1, begin, delimiter, tuple(notes), line, clock, ended, sample, remarks)


def _index(header: str | int, names: Sequence[str]) -> int | None:
    """Find the position of a header; the first may be given with the comment mark before it, as #YY."""
    bare = str(header).lstrip(" ".join(COMMENT_MARKS))
    return next((k for k, name in enumerate(names) if name == header or (k == 0 and name == bare)), None)


def _number_repeated(names: Sequence[str]) -> list[str]:
    """Name the second column of a name NAME.2, the third NAME.3."""
    earlier = [names[:k].count(name) for k, name in enumerate(names)]
    return [f"{name}.{n + 1}" if n else name for name, n in zip(names, earlier, strict=True)]


def _locate_header(
    lines: Sequence[str],
    rows: list[int],
    comments: list[int],
    layout: Layout,
    delimiters: Sequence[str],
    fits: Callable[[Sequence[str]], bool],
) -> tuple[int, str] | None:
    """Find the index and delimiter of the first row, else comment, that fits; None if a row of numbers comes first."""
    if layout.header is not None:
        return None
    if layout.skip_rows is not None:
        rows, comments = rows[:1], []
    for places, delimiter in product((rows, comments), delimiters):
        for k in places:
            names = layout.split_header(lines[k], delimiter)
            if any(names) and fits(names):
                return k, delimiter
            if len(names) > 1 and all(name.startswith(NUMBER_STARTS) for name in names):
                break
    return None


def _parts(line: str, delimiter: str) -> bool:
    """Return whether a delimiter is in a line without leaving numbers with blanks between them in several cells."""
    return delimiter in line and sum(bool(_APART.search(cell)) for cell in line.split(delimiter)) < 2


def split_line(line: str, delimiter: str) -> list[str]:
    """Split a line at a delimiter outside quotation marks; several blanks count as one."""
    if delimiter == " ":
        return line.split() if '"' not in line else [cell.strip('="') for cell in _WORD.findall(line)]
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return []


def _place(path: Path, head: Head, role: str, header: str | int, advice: str) -> int:
    """Find the index of a column."""
    if isinstance(header, int) and 0 < header <= len(head.names):
        return header - 1
    if (at := _index(header, head.names)) is not None:
        return at
    if head.names and all(name[:1] in NUMBER_STARTS for name in head.names):
        advice = "a file without a header has its columns by numbers, 1 for the first: columns: {time: 1, ...}"
    if isinstance(header, int):
        advice = "correct the number, or write delimiter: comma, semicolon, tab or blank"
    shown = ", ".join(head.names) or "an empty file"
    raise InputError(
        f"{path}: column {header!r} ({role})", expected="one of the file's columns", found=shown, advice=advice
    )


def unit_lines(head: Head, wanted: Sequence[int]) -> list[list[str]]:
    """Select the cells of unit lines below the header, in comments and in rows."""
    return [row for rows in (head.remarks, head.sample) for row in rows[: _count_units(head, wanted, rows)]]


def _count_units(head: Head, wanted: Sequence[int], rows: Sequence[Sequence[str]], most: int = 2) -> int:
    """Count unit lines below the header, whose requested cells hold unit-like words instead of numbers."""
    count = 0
    for row in rows[:most] if head.line else ():
        cells = [row[k].strip() for k in wanted if k < len(row)]
        words = [cell for cell in cells if cell.lower() not in MISSING_TEXT]
        if not words or len(cells) < len(wanted) or not all(map(_UNIT.fullmatch, words)):
            break
        count += 1
    return count


def open_body(
    path: Path, head: Head, wanted: Collection[int], layout: Layout = DEFAULT_LAYOUT, *, skip: int = 0
) -> Body:
    """Split the rows below the header, without the first ones to skip, into the wanted columns.

    Raises:
        InputError: a line has more cells than the header, or a quotation mark is not closed.
    """
    source, begin, delimiter, n = head.source, head.begin, head.delimiter, len(head.names)
    if source.find(b'"', begin) >= 0:  # write the rows without quotation marks, with a separator that no cell holds
        lines = source[begin:].decode(errors="replace").split("\n")[:-1]
        if torn := next((k for k, line in enumerate(lines, head.line + 1) if line.count('"') % 2), None):
            expected, shown = "cells that end in their line", "a quotation mark that is not closed"
            raise InputError(f"{path}: line {torn}", expected=expected, found=shown, advice=MEND)
        source = "".join(f"{APART.join(split_line(line, delimiter))}\n" for line in lines).encode()
        begin, delimiter = 0, APART
    rows = split_rows(source, begin, delimiter, sorted({*wanted, *([head.clock] if head.clock else [])}))
    content = rows.lines.strip(BLANKS + delimiter.encode())
    keep = content.begin < content.end
    marked = keep & np.isin(content.data[content.begin], [ord(mark[0]) for mark in (layout.comment or COMMENT_MARKS)])
    keep[marked] = [not layout.is_comment(line) for line in rows.lines[marked]]
    rows, cut, by = rows[keep][skip:], 0, None if delimiter == " " else delimiter
    if not head.ended and len(rows.lines):
        # The last line is truncated if it lacks cells, or its last cell has fewer decimals than any other.
        last = [line.split(by) for line in rows.lines[-HEAD_LINES:]]
        decimals = [len(row[-1].strip().replace(",", ".").partition(".")[2]) for row in last if row[-1].strip()]
        cut = int(len(last[-1]) < n or not last[-1][-1].strip() or decimals[-1] < min(decimals[:-1], default=0))
    rows = rows[: len(rows.lines) - cut]
    long = np.flatnonzero(rows.width > n)
    for row, line in zip(long, rows.lines[long], strict=True):
        if any(map(str.strip, line.split(by)[n:])):
            where, shown = f"{path}: line {head.line + rows.number[row] + 1}", f"a line of {rows.width[row]} cells"
            advice = "correct delimiter" if len(long) == len(rows.lines) > 1 else MEND
            raise InputError(where, expected=f"{n} cells as in the header", found=shown, advice=advice)
    usual = int(np.bincount(rows.width, minlength=1).argmax())
    short = np.flatnonzero(rows.width < min(n, usual))
    notes = [f"{path.name}: the last line was truncated and left out"] * cut
    if short.size:  # an empty cell that was not written may be any of them
        first = f"line {head.line + rows.number[short[0]] + 1} first"
        notes.append(
            f"{path.name}: {short.size} lines with fewer cells than the others were left out ({first}): {MEND}"
        )
        rows = rows[np.delete(np.arange(len(rows.width)), short)]
    return Body(path, head, rows, layout, cut + short.size, tuple(notes))


@dataclass(frozen=True)
class Body:
    """Rows of a table, whose errors name file, line and column."""

    path: Path
    head: Head
    rows: Rows
    layout: Layout
    cut: int  # number of lines dropped, as they lack cells
    notes: tuple[str, ...] = ()  # about these lines

    def column(self, place: int, expected: str = NUMBER_FORM) -> Column:
        """Select the cells of a column, which every row must have."""
        if (short := np.flatnonzero(self.rows.width <= place)).size:
            raise self.error(int(short[0]), place, expected, f"a line of {self.rows.width[short[0]]} cells")
        return self.rows.columns[place].strip(BLANKS)

    def error(self, row: int | None, place: int, expected: str, shown: str, advice: str = MEND) -> InputError:
        """Create the error for a cell, or for a column."""
        line = "" if row is None else f"line {self.head.line + self.rows.number[row] + 1}, "
        where = f"{self.path}: {line}{self.head.names[place]}"
        return InputError(where, expected=expected, found=shown, advice=advice)

    def times(self, places: Mapping[str, Sequence[int]], carried: Collection[str]) -> tuple[dict[str, Floats], str]:
        """Parse the time columns by role, with date and clock or parts combined, and describe the detected format."""
        layout, columns, note = self.layout, dict[str, Floats](), ""
        around = "".join({*QUOTES} - {*(layout.time_format or "")}).encode()  # never characters of the format itself
        if apart := {*DATE_AND_CLOCK} <= {*places}:
            places = {"time": [places[role][0] for role in DATE_AND_CLOCK]}
        for role, several in places.items():
            if len(several) > 1 and not apart:
                parts = self.numbers({str(place): place for place in several})[0]
                columns[role], row = times.from_parts([*parts.values()])
                if row is not None:
                    shown = " ".join(self.column(place).text(row) for place in several)
                    expected = "year and day of the year, or year, month, day and so on"
                    raise self.error(row, several[0], expected, shown)
                columns[role] -= times.parse_zone(layout.timezone)
                continue
            if self.head.clock == several[0] + 1:
                several = [several[0], self.head.clock]
            column = reduce(Column.joined, [self.column(place, times.TIME_FORM).strip(around) for place in several])
            if role in carried:
                filled = np.where(column.begin < column.end, np.arange(len(column)), 0)
                column = column[np.maximum.accumulate(filled)]
            try:
                columns[role], note = times.parse_times(
                    column, form=layout.time_format, zone=layout.timezone, decimal=layout.decimal
                )
            except times.Unreadable as error:
                advice = JOIN if _PART.fullmatch(self.head.names[several[0]]) else error.advice
                if self.head.delimiter == " " and " " in (layout.time_format or "") and len(several) == 1:
                    advice = f"between blanks {APART_TIMES}"
                raise self.error(error.row, several[0], error.expected, error.shown, advice) from None
        return columns, note

    def flags(self, place: int, meanings: Mapping[str, int]) -> tuple[Floats, list[str]]:
        """Convert words or values of quality flags to those of OceanSITES, and warn of unknown ones."""
        texts = [*self.column(place)]
        counts = Counter(texts)
        known = {cell: NOT_CHECKED if not cell else vocabulary.flag_of(cell, cell, meanings) for cell in counts}
        codes = {cell: PROBABLY_BAD if flag is None else flag for cell, flag in known.items()}
        nameless = {cell: counts[cell] for cell, flag in known.items() if flag is None}
        where = f"{self.path.name}: column {self.head.names[place]}"
        said = [vocabulary.describe_unknown_flags(where, nameless)] if nameless else []
        return np.fromiter(map(codes.__getitem__, texts), dtype=float, count=len(texts)), said

    def numbers(self, places: Mapping[str, int]) -> tuple[dict[str, Floats], bool]:
        """Parse columns of numbers by role; also whether commas were found to be their decimal marks."""
        layout = self.layout
        cells = {role: self.column(place) for role, place in places.items()}
        parsed = {role: parse_numbers(column, layout.decimal, layout.missing) for role, column in cells.items()}
        points, commas = (
            [(role, int(np.argmax(marks == mark))) for role, (_, marks) in parsed.items() if (marks == mark).any()]
            for mark in b".,"
        )
        if commas and not layout.decimal:
            at_comma = (text for role, _ in commas for text in cells[role][parsed[role][1] == ord(",")])
            if points or all(map(_ONLY_THOUSANDS.fullmatch, at_comma)):
                (role, row), pointed = commas[0], [cells[role].text(row) for role, row in points[:1]]
                also = f" beside {pointed[0]!r}" if pointed else ", which may be thousands"
                raise InputError(
                    f"{self.path}: column {self.head.names[places[role]]!r}",
                    expected="numbers with decimals behind points",
                    found=repr(cells[role].text(row)) + also,
                    advice="write decimal: comma or decimal: point",
                )
        for role, (values, _) in parsed.items():
            if (wrong := np.isinf(values)).any():
                row = int(np.argmax(wrong))
                cell = cells[role].text(row)
                is_word = NUMBER.fullmatch(cell) or not any(map(str.isdigit, cell))  # may stand for a missing value
                advice = f"{MEND}, or write missing: [{cell!r}]" if is_word and len(cell) <= 20 else MEND
                advice = "correct decimal" if layout.decimal else advice
                advice = f"between blanks {APART_TIMES}" if _CLOCK.match(cell) else advice
                raise self.error(row, places[role], NUMBER_FORM, repr(cell), advice)
        return {role: values for role, (values, _) in parsed.items()}, bool(commas) and not layout.decimal
