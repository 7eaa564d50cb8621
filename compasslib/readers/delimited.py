"""Read text tables: columns of numbers, times and quality flags, by the names in a header line or by their numbers.

The delimiter, decimal commas, lines above the header, unit lines below it, compression and encoding are detected where
they are unambiguous, and reported in ``Table.notes``; anything else raises an error that names the key of the YAML file
(``Layout``) to set. The header is the first line that contains every requested column.

A row with surplus cells, a missing requested cell or a word in place of a number raises an error, as shifted cells can
still parse as numbers. Only an unterminated last line may be truncated; it is dropped and counted.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import flags, times
from compasslib.readers.cells import BLANKS, MISSING_TEXT, NUMBER, WITH_COMMA, Column, Rows, parse_numbers, split_rows
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
DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}  # in order of preference
HEAD_LINES = 1000  # searched for the header
NUMBER_STARTS = tuple("+-.0123456789")
COMMENT_MARKS = ("#", "%")
QUOTES = " \t=\"'"  # stripped around headers and times: left by repeated export, or ="..."
# Typographic minus sign, no-break spaces and quotation marks.
TYPESETTING = {"\u2212": "-", "\xa0": " ", "\u202f": " "} | dict.fromkeys("\u201c\u201d\u2018\u2019", "'")
APART = "\x1f"  # stands between cells that were quoted
Header = str | int | Sequence[str | int]  # name or number of a column; several are the parts of a time
_WHOLE = re.compile(r"[-+]?\d+", re.ASCII)
_WITH_THOUSANDS = re.compile(r"[-+]?\d{1,3}(?:([,.' ])\d{3})+(?!\1)[.,]\d*|[-+]?\d{1,3}(?:[' ]\d{3})+", re.ASCII)
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
        """Create a layout from the table keys of a settings mapping; absent keys keep their defaults."""
        given = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**(given | {"missing": tuple(given["missing"] or ())}))

    @property
    def comments(self) -> tuple[str, ...]:
        """Marks at the beginning of lines without data."""
        return (self.comment,) if self.comment else COMMENT_MARKS


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
    text: bytes = b""  # of the header line
    clock: int | None = None  # index of a column without a name that continues the time before it
    ended: bool = True  # whether the last line was terminated
    sample: list[list[str]] = field(default_factory=list)  # cells of the first rows


@dataclass(frozen=True)
class Table:
    """Columns of a table by role."""

    columns: dict[str, Floats]  # (rows,) each; times in UTC seconds since 1970, NaN where missing
    rows: int
    cut: int  # number of truncated last lines dropped
    notes: tuple[str, ...]  # detected format, in words
    said: Mapping[str, tuple[str, ...]]  # role -> header, and cells of the unit lines
    unknown_flags: tuple[str, ...] = ()  # warnings about flags of unknown meaning


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
        headers: role -> header, or number of the column from 1; ``time`` and ``time_utc`` hold times, or list the
            columns of their parts, ``date`` and ``clock`` are combined into ``time``, ``flag`` and ``flag_ROLE`` hold
            quality flags, and all other roles hold numbers.
        advice: advice in the error message for a missing column.
        meanings: flag value or meaning -> OceanSITES flag, see ``flags.parse_flag_settings``.
        carried: roles whose empty cells repeat the cell above.

    Raises:
        InputError: the file or a column is missing, or a time or number is unreadable or ambiguous.
    """
    if {*DATE_AND_CLOCK} <= {*headers} and {*TIMES} & {*headers}:
        expected, advice = "a time, or date and clock apart", "keep one of the two under columns"
        raise InputError(f"{path}: columns", expected=expected, found="all three", advice=advice)
    named = {role: (header,) if isinstance(header, str | int) else (*header,) for role, header in headers.items()}
    head = read_head(path, [each for several in named.values() for each in several], layout)
    places = {
        role: [_place(path, head, role, header, advice, layout) for header in each] for role, each in named.items()
    }
    wanted = {place for several in places.values() for place in several}
    units = _count_units(head, sorted(wanted))
    body, notes = open_body(path, head, wanted, layout, skip=units)
    body = replace(body, carried=carried)
    timed = [role for role in places if role in (*TIMES, *DATE_AND_CLOCK)]
    columns, time_note = body.times({role: [body.column(place, role) for place in places[role]] for role in timed})
    cells = {role: body.column(each[0], role) for role, each in places.items() if role not in timed}
    flagged, unknown = [role for role in cells if role.partition("_")[0] == FLAG], list[str]()
    for role in flagged:
        columns[role], said = body.flags(cells.pop(role), meanings)
        unknown += said
    if not flagged and "north" in headers and (unused := [name for name in head.names if _FLAGS.search(name)]):
        shown = ", ".join(unused)
        unknown = [f"{path.name}: flags stand in {shown}, which columns do not name as flag: none was used."]
    numbers, by_comma = body.numbers(cells)
    notes += ["units below the header"] * (units > 0) + ["decimal commas"] * by_comma + [time_note] * bool(time_note)
    twice = {header for several in named.values() for header in several if f"{header}.2" in head.names}
    notes += [f"the first of the columns {name}, of which {name}.2 is the second" for name in sorted(twice)]
    above = [head.names, *head.sample[:units]]
    said_by = {role: tuple(row[place].strip() for place in each for row in above) for role, each in places.items()}
    return Table(columns | numbers, len(body.rows.line), body.cut, (*head.notes, *notes), said_by, tuple(unknown))


def date_and_clock(headers: Mapping[str, str], withheld: Collection[str] = ()) -> dict[str, str]:
    """Select the headers of date and clock; empty unless both are given and neither these nor a time is withheld."""
    parts = {role: headers[role] for role in DATE_AND_CLOCK if headers.get(role)}
    usable = len(parts) == len(DATE_AND_CLOCK) and not {*parts, *parts.values(), *TIMES} & set(withheld)
    return parts if usable else {}


def table_notes(tables: Iterable[Table]) -> tuple[str, ...]:
    """Collect the notes on detected formats and unknown flags of several tables, without duplicates."""
    tables = [*tables]
    read = [f"the table was read as it is written: {', '.join(table.notes)}" for table in tables if table.notes]
    return tuple(dict.fromkeys([*read, *(warning for table in tables for warning in table.unknown_flags)]))


def read_head(path: Path, needed: Iterable[str | int], layout: Layout = DEFAULT_LAYOUT) -> Head:
    """Read the header of a table by the names that it contains; if no line has them all, the first line is the header.

    Raises:
        InputError: the file cannot be read.
    """
    needed = [*needed]
    wanted = {name for name in needed if isinstance(name, str)}
    if needed and not wanted and layout.header is None:
        layout = replace(layout, header=0)  # columns by their numbers need no header
    head = find_head(path, lambda names: wanted <= {*names}, layout)
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
    """Locate the header by a predicate.

    Args:
        fits: predicate that accepts the column names of the header.
        delimiters: candidates, in order of preference.
        must: return None if no line fits, instead of taking the first line as the header.

    Raises:
        InputError: the file cannot be read.
    """
    source, notes, ended = read_text(path)
    if not source.isascii():
        for mark, plain in TYPESETTING.items():
            source = source.replace(mark.encode(), plain.encode())
    end = 0
    for _ in range((layout.skip_rows or 0) + HEAD_LINES):
        end = source.find(b"\n", end) + 1 or len(source)
    raw = source[:end].decode(errors="replace").split("\n")[:-1]
    candidates = [layout.delimiter] if layout.delimiter else list(delimiters)
    located = _header_line(raw, layout, candidates, fits)
    if located is None and must:
        return None
    skipped = min(layout.skip_rows or 0, len(raw))
    first = next((k for k in range(skipped, len(raw)) if _has_content(raw[k], layout)), skipped)
    at, delimiter = located or (layout.header - 1 if layout.header else first, "")
    if layout.header and at >= len(raw):
        expected, shown = f"a header in line {layout.header}", f"{len(raw)} lines"
        raise InputError(str(path), expected=expected, found=shown, advice="correct header")
    line = (_uncommented(raw[at], layout) or raw[at]) if at < len(raw) else ""
    delimiter = delimiter or layout.delimiter or next((each for each in candidates if each in line.strip()), " ")
    names = [cell.strip(QUOTES) for cell in _split_line(line, delimiter)] if at < len(raw) else []
    if layout.header == 0:
        names, at = [str(k) for k in range(1, len(names) + 1)], at - 1
    notes += [f"cells between {DELIMITERS.get(delimiter)}"] * (delimiter != "," and layout.delimiter is None)
    above = sum(_has_content(line, layout) for line in raw[skipped : max(at, 0)]) * (layout.header is None)
    notes += [f"{above} line{'s' * (above > 1)} above the header"] * (above > 0)
    sample = [_split_line(line, delimiter) for line in raw[at + 1 :] if _has_content(line, layout)]
    clock = None
    if delimiter == " " and sample and all(len(row) == len(names) + 1 for row in sample):  # one name for date and clock
        clock = next((k for k, cell in enumerate(sample[0]) if k and ":" in cell), None)
        names = names if clock is None else [*names[:clock], "", *names[clock:]]
    repeated = Counter[str]()
    for k, name in enumerate(names):
        repeated[name] += 1
        names[k] = name if repeated[name] == 1 else f"{name}.{repeated[name]}"
    begin, text = sum(len(line.encode()) + 1 for line in raw[: at + 1]), "".join(raw[max(at, 0) : at + 1]).encode()
    return Head(source, names, at + 1, begin, delimiter, tuple(notes), text, clock, ended, sample)


def _header_line(
    raw: Sequence[str], layout: Layout, candidates: Sequence[str], fits: Callable[[Sequence[str]], bool]
) -> tuple[int, str] | None:
    """Find the index and delimiter of the first line that fits; None if a row of numbers comes first."""
    uncommented = [_uncommented(line, layout) for line in raw]  # numpy.savetxt writes the header as a comment
    rows_only = ["" if text else line for line, text in zip(raw, uncommented, strict=True)]
    places = [k for k in range(layout.skip_rows or 0, len(raw)) if _has_content(raw[k], layout) or uncommented[k]]
    places = places if layout.skip_rows is None else [k for k in places if not uncommented[k]][:1]
    for lines, delimiter in product((rows_only, uncommented), candidates if layout.header is None else ()):
        for k in places:
            row = [cell.strip(QUOTES) for cell in _split_line(lines[k], delimiter)]
            if any(row) and fits(row):
                return k, delimiter
            if len(row) > 1 and all(cell[:1] in NUMBER_STARTS for cell in row):
                break
    return None


def _has_content(line: str, layout: Layout) -> bool:
    return bool(line.strip(" \t\r\n,;")) and not line.lstrip().startswith(layout.comments)


def _uncommented(line: str, layout: Layout) -> str:
    """Take the mark off a comment; empty for other lines."""
    text = line.lstrip()
    return next((text.lstrip(mark).strip() for mark in layout.comments if text.startswith(mark)), "")


def _split_line(line: str, delimiter: str) -> list[str]:
    """Split a line at a delimiter outside quotation marks; several blanks count as one."""
    if delimiter == " ":
        return line.split() if '"' not in line else [cell.strip('="') for cell in _WORD.findall(line)]
    if '"' not in line:
        return line.split(delimiter)
    try:
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    except csv.Error:
        return []


def _place(path: Path, head: Head, role: str, header: str | int, advice: str, layout: Layout) -> int:
    """Find the index of a column."""
    if isinstance(header, int) and 0 < header <= len(head.names):
        return header - 1
    if header in head.names:
        return head.names.index(header)
    # A wrong skip_rows or delimiter may have hidden the column: suggest these keys first.
    keys = " or ".join(key for key in ("header", "skip_rows", "delimiter") if getattr(layout, key))
    advice = f"correct {keys}, else {advice}" if keys else advice
    if head.names and all(name[:1] in NUMBER_STARTS for name in head.names):
        advice = "a file without a header has its columns by numbers, 1 for the first: columns: {time: 1, ...}"
    shown = ", ".join(head.names) or "an empty file"
    raise InputError(
        f"{path}: column {header!r} ({role})", expected="one of the file's columns", found=shown, advice=advice
    )


def _count_units(head: Head, wanted: Sequence[int], most: int = 2) -> int:
    """Count unit lines below the header, whose requested cells hold unit-like words instead of numbers."""
    count = 0
    for row in head.sample[:most] if head.line else ():
        cells = [row[k].strip() for k in wanted if k < len(row)]
        words = [cell for cell in cells if cell.lower() not in MISSING_TEXT]
        if not words or len(cells) < len(wanted) or not all(map(_UNIT.fullmatch, words)):
            break
        count += 1
    return count


def open_body(
    path: Path, head: Head, wanted: Collection[int], layout: Layout = DEFAULT_LAYOUT, *, skip: int = 0
) -> tuple[Body, list[str]]:
    """Split the lines below the header into rows of cells, and note headers that are repeated between them.

    Args:
        wanted: indices of the columns to read.
        skip: number of rows below the header that hold no data.

    Raises:
        InputError: a line has more cells than the header, or a quotation mark is not closed.
    """
    source, begin, delimiter, text, n = head.source, head.begin, head.delimiter, head.text, len(head.names)
    if (layout.delimiter, layout.decimal) == (",", ",") or source.find(b'"', begin) >= 0:
        source, begin, delimiter = _requoted(path, head, layout), 0, APART
        text = APART.join(_split_line(text.decode(), head.delimiter)).encode()
    rows = split_rows(source, begin, delimiter, sorted({*wanted, *([head.clock] if head.clock else [])}))
    content = Column(source, rows.begin, rows.end).strip(BLANKS + delimiter.encode())
    keep = content.begin < content.end
    marked = keep & np.isin(content.data[content.begin], [ord(mark[0]) for mark in layout.comments])
    lines = Column(source, rows.begin, rows.end)
    keep[marked] = [not line.lstrip().startswith(layout.comments) for line in lines[marked].texts()]
    again, at = list[int](), begin - 1
    while text and (at := source.find(text + b"\n", at + 1)) >= 0:
        again += [int(np.searchsorted(rows.begin, at))] * (at == 0 or source[at - 1 : at] == b"\n")
    keep[again] = False
    rows, lines = rows[keep][skip:], lines[keep][skip:]
    by = None if delimiter == " " else delimiter
    last, cut = [] if head.ended else [line.split(by) for line in lines[-HEAD_LINES:].texts()], 0
    if last:  # truncated if it lacks cells, or its last cell has fewer decimals than any other
        decimals = [len(row[-1].strip().replace(",", ".").partition(".")[2]) for row in last if row[-1].strip()]
        cut = int(len(last[-1]) < n or not last[-1][-1].strip() or decimals[-1] < min(decimals[:-1], default=0))
    rows = rows[: len(rows.line) - cut]
    long = np.flatnonzero(rows.width > n)
    for row, line in zip(long, lines[long].texts(), strict=True):
        if any(map(str.strip, line.split(by)[n:])):
            advice = "if commas are decimals too, write delimiter: comma and decimal: comma, else correct delimiter"
            where, shown = f"{path}: line {head.line + rows.line[row] + 1}", f"a line of {rows.width[row]} cells"
            advice = advice if len(long) == len(rows.line) > 1 else MEND
            raise InputError(where, expected=f"{n} cells as in the header", found=shown, advice=advice)
    notes = [f"{len(again)} more header line{'s' * (len(again) > 1)}"] * bool(again)
    return Body(path, head, rows, layout, cut), notes


def _requoted(path: Path, head: Head, layout: Layout) -> bytes:
    """Write the rows anew with a separator that no cell holds, without quotation marks and with decimals rejoined.

    Raises:
        InputError: a quotation mark is not closed, or a number between commas has no decimals.
    """
    lines, n, made = head.source[head.begin :].decode(errors="replace").split("\n")[:-1], len(head.names), []
    both = (layout.delimiter, layout.decimal) == (",", ",")
    for k, line in enumerate(lines, head.line + 1):
        if line.count('"') % 2:
            expected, shown = "cells that end in their line", "a quotation mark that is not closed"
            raise InputError(f"{path}: line {k}", expected=expected, found=shown, advice=MEND)
        row = _split_line(line, head.delimiter)
        if both and len(row) > n:  # quoted numbers were not split
            halves = iter(row)
            row = [f"{cell.strip()},{next(halves, '')}" if _WHOLE.fullmatch(cell.strip()) else cell for cell in halves]
            if len(row) != n or not all("," not in cell or WITH_COMMA.fullmatch(cell) for cell in row):
                expected, advice = (
                    "decimals in every number, as commas part cells too",
                    "write every number with decimals",
                )
                advice += ", or export with semicolons and write delimiter: semicolon"
                raise InputError(f"{path}: line {k}", expected=expected, found=line, advice=advice)
        made.append(APART.join(row))
    return "\n".join([*made, ""]).encode()


@dataclass(frozen=True)
class Body:
    """Rows of a table, whose errors name file, line and column."""

    path: Path
    head: Head
    rows: Rows
    layout: Layout
    cut: int  # number of truncated last lines dropped
    carried: Collection[str] = ()  # roles whose empty cells repeat the cell above

    def column(self, place: int, role: str) -> tuple[int, Column]:
        """Select the cells of a column, and its index; empty ones repeat the cell above where they are carried on."""
        if (short := np.flatnonzero(self.rows.width <= place)).size:
            expected = times.TIME_FORM if role in (*TIMES, *DATE_AND_CLOCK) else NUMBER_FORM
            raise self.error(int(short[0]), place, expected, f"a line of {self.rows.width[short[0]]} cells")
        column = self.rows.columns[place].strip(BLANKS)
        if role in self.carried:
            filled = np.where(column.begin < column.end, np.arange(len(column.begin)), 0)
            column = column[np.maximum.accumulate(filled)]
        return place, column

    def error(self, row: int | None, place: int, expected: str, shown: str, advice: str = MEND) -> InputError:
        """Create the error for a cell, or for a column."""
        line = "" if row is None else f"line {self.head.line + self.rows.line[row] + 1}, "
        where = f"{self.path}: {line}{self.head.names[place]}"
        return InputError(where, expected=expected, found=shown, advice=advice)

    def times(self, texts: Mapping[str, Sequence[tuple[int, Column]]]) -> tuple[dict[str, Floats], str]:
        """Parse the time columns by role, with date and clock or parts combined, and describe the detected format."""
        layout, columns, note = self.layout, dict[str, Floats](), ""
        around = "".join({*QUOTES} - {*(layout.time_format or "")}).encode()  # never characters of the format itself
        if {*DATE_AND_CLOCK} <= {*texts}:
            (place, dates), (_, clocks) = (texts[role][0] for role in DATE_AND_CLOCK)
            texts = {"time": [(place, dates.strip(around).joined(clocks.strip(around)))]}
        for role, cells in texts.items():
            if len(cells) > 1:
                parts = self.numbers({str(place): (place, column) for place, column in cells})[0]
                columns[role], row = times.from_parts([*parts.values()])
                if row is not None:
                    shown = " ".join(column[row : row + 1].texts()[0] for _, column in cells)
                    raise self.error(row, cells[0][0], "year and day of the year, or year, month, day and so on", shown)
                ahead_s = times.parse_zone(layout.timezone)
                columns[role] -= ahead_s
                continue
            place, column = cells[0]
            if self.head.clock == place + 1:
                column = column.joined(self.rows.columns[place + 1])
            try:
                columns[role], note = times.parse_times(
                    column.strip(around), form=layout.time_format, zone=layout.timezone, decimal=layout.decimal
                )
            except times.Unreadable as error:
                quoted = error.row is not None and re.search("[\"']", column[error.row : error.row + 1].texts()[0])
                advice = "delete the quotation marks" if quoted else error.advice
                advice = JOIN if _PART.fullmatch(self.head.names[place]) else advice
                advice = advice or f"{MEND}; {times.SETTLE} for another form"
                raise self.error(error.row, place, error.expected, error.shown, advice) from None
        return columns, note

    def flags(self, cells: tuple[int, Column], meanings: Mapping[str, int]) -> tuple[Floats, list[str]]:
        """Convert words or values of quality flags to those of OceanSITES, and warn of unknown ones."""
        texts = cells[1].texts()
        counts = Counter(texts)
        known = {cell: NOT_CHECKED if not cell else flags.flag_of(cell, cell, meanings) for cell in counts}
        codes = {cell: PROBABLY_BAD if flag is None else flag for cell, flag in known.items()}
        nameless = {cell: counts[cell] for cell, flag in known.items() if flag is None}
        where = f"{self.path.name}: column {self.head.names[cells[0]]}"
        said = [flags.describe_unknown_flags(where, nameless)] if nameless else []
        return np.fromiter(map(codes.__getitem__, texts), dtype=float, count=len(texts)), said

    def numbers(self, texts: Mapping[str, tuple[int, Column]]) -> tuple[dict[str, Floats], bool]:
        """Parse columns of numbers by role; also whether commas were found to be their decimal marks.

        Raises:
            InputError: a cell is no number, or commas may stand between thousands.
        """
        layout = self.layout
        parsed = {role: parse_numbers(column, layout.decimal, layout.missing) for role, (_, column) in texts.items()}
        if commas := [role for role, each in parsed.items() if each.comma is not None and not layout.decimal]:
            pointed = next((role for role, each in parsed.items() if each.point is not None), None)
            if pointed or all(parsed[role].thousands for role in commas):
                shown = repr(self._cell(texts[commas[0]], parsed[commas[0]].comma))
                also = pointed and f" beside {self._cell(texts[pointed], parsed[pointed].point)!r}"
                where, advice = (
                    f"{self.path}: column {self.head.names[texts[commas[0]][0]]!r}",
                    "write decimal: comma or decimal: point",
                )
                expected, shown = "numbers with decimals behind points", shown + (also or ", which may be thousands")
                raise InputError(where, expected=expected, found=shown, advice=advice)
        for role, each in parsed.items():
            if each.wrong is not None:
                cell = self._cell(texts[role], each.wrong)
                advice = "correct decimal" if layout.decimal else _advise_on_word(cell)
                raise self.error(each.wrong, texts[role][0], NUMBER_FORM, repr(cell), advice)
        return {role: each.values for role, each in parsed.items()}, bool(commas)

    def _cell(self, cells: tuple[int, Column], row: int | None) -> str:
        return cells[1][row : (row or 0) + 1].texts()[0]


def _advise_on_word(cell: str, longest: int = 20) -> str:
    """Word the advice on a cell that is not a number; malformed text with digits is not offered as a missing value."""
    if _WITH_THOUSANDS.fullmatch(cell):
        return "export numbers without marks between thousands"
    word = len(cell) <= longest and (NUMBER.fullmatch(cell) or not any(map(str.isdigit, cell)))
    return f"{MEND}, or write missing: [{cell!r}]" if word else MEND
