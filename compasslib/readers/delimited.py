"""Read text tables with a header line: columns of numbers, times and quality flags.

The delimiter, decimal commas, lines above the header, unit lines below it, compression and encoding are detected where
they are unambiguous, and reported in ``Table.notes``; anything else raises an error that names the key of the YAML file
(``Layout``) to set. The header is the first line that contains every requested column.

A row with surplus cells, a missing requested cell or a word in place of a number raises an error, as shifted cells can
still parse as numbers. Only an unterminated last line may be truncated; it is dropped and counted.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import flags, plain, times
from compasslib.readers.files import GZIP_MAGIC, read_text, read_text_bytes
from compasslib.readers.plain import MISSING_TEXT, NUMBER
from compasslib.records import NOT_CHECKED, PROBABLY_BAD
from compasslib.types import Floats

COLUMN_MAP = "correct columns in the mooring file"
TIMES = ("time", "time_utc")  # roles of time columns
FLAG = "flag"  # role of quality flags: words or values
DATE_AND_CLOCK = ("date", "clock")  # roles of the date and the time of day, combined into ``time``
NUMBER_FORM = "a number or nothing"
MEND = "mend or remove the line"
JOIN = "join the columns of the time into one in a copy, as 2007-09-04T00:00:00Z"
DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}  # in order of preference
HEAD_LINES = 1000  # searched for the header, and from which the vectorized parser takes the format of a table
NUMBER_STARTS = tuple("+-.0123456789")
COMMENT_MARKS = "#%"
QUOTES = " \t=\"'\u201c\u201d\u2018\u2019"  # stripped around headers and times: left by repeated export, or ="..."
TYPESETTING = {0x2212: "-", 0xA0: " ", 0x202F: " "}  # typographic minus sign and no-break spaces
_WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[-+]?\d+", re.ASCII)
_ONLY_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
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
    missing: tuple[str, ...] = ()  # texts that stand for missing values, besides ``plain.MISSING_TEXT``
    skip_rows: int | None = None  # number of lines to skip above the header

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Layout:
        """Create a layout from the table keys of a settings mapping; absent keys keep their defaults."""
        given = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**(given | {"missing": tuple(given["missing"] or ())}))


DEFAULT_LAYOUT = Layout()


@dataclass(frozen=True)
class Lines:
    """Header and rows of a table without empty lines and comments; the cells of rows are not stripped."""

    header: list[str]
    rows: list[list[str]]
    numbers: Sequence[int]  # line number of each row in the file, from 1
    cut: int = 0  # number of truncated last lines dropped
    delimiter: str = ""
    notes: tuple[str, ...] = ()  # detected format, in words


@dataclass(frozen=True)
class Table:
    """Columns of a table by role."""

    columns: dict[str, Floats]  # (rows,) each; times in UTC seconds since 1970, NaN where missing
    rows: int
    cut: int  # number of truncated last lines dropped
    notes: tuple[str, ...]  # detected format, in words
    said: Mapping[str, tuple[str, ...]]  # role -> header, and cells of the unit lines
    unknown_flags: str = ""  # warning about flags of unknown meaning, empty without any


def read_table(
    path: Path,
    headers: Mapping[str, str],
    advice: str = COLUMN_MAP,
    layout: Layout = DEFAULT_LAYOUT,
    meanings: Mapping[str, int] = MappingProxyType({}),
) -> Table:
    """Read the requested columns of one table.

    Args:
        headers: role -> header; ``time`` and ``time_utc`` hold times, ``date`` and ``clock`` are combined into
            ``time``, ``flag`` holds quality flags, and all other roles hold numbers.
        advice: advice in the error message for a missing column.
        meanings: flag value or meaning -> OceanSITES flag, see ``flags.parse_flag_settings``.

    Raises:
        InputError: the file or a column is missing, or a time or number is unreadable or ambiguous.
    """
    fast = _read_plain(path, headers, layout)
    return fast or parse_table(path, read_lines(path, headers.values(), layout), headers, advice, layout, meanings)


def _read_plain(path: Path, headers: Mapping[str, str], layout: Layout) -> Table | None:
    """Read a table with the vectorized parser below its first lines; None where the rows are not plain enough."""
    timed = [role for role in headers if role in TIMES]
    if len(timed) != 1 or {FLAG, *DATE_AND_CLOCK} & {*headers} or layout.decimal == "," or layout.time_format:
        return None
    data = read_text_bytes(path).removeprefix(codecs.BOM_UTF8)
    with path.open("rb") as raw:
        if raw.read(len(GZIP_MAGIC)) == GZIP_MAGIC or (layout.skip_rows or 0) >= HEAD_LINES:
            return None
    if b"\r\n" in data:
        data = data.replace(b"\r\n", b"\n")
    begin = 0
    for _ in range(HEAD_LINES):
        if not 0 < (begin := data.find(b"\n", begin) + 1) < len(data):
            return None
    if not (data.isascii() and data.endswith(b"\n")) or any(data.find(mark, begin) >= 0 for mark in b'\0\r"#%'):
        return None
    wanted = {*headers.values()}
    try:
        lines = find_lines(path, lambda names: wanted <= {*names}, layout, text=data[:begin].decode("ascii"))
        assert lines is not None
        head = parse_table(path, lines, headers, "", layout)
    except InputError:
        return None
    places = {role: lines.header.index(header) for role, header in headers.items()}
    like = lines.rows[-1][places[timed[0]]].strip() if head.rows else ""
    if lines.delimiter == " " or "decimal commas" in head.notes or not times.is_iso(like, layout.timezone):
        return None

    def others(cells: list[str]) -> Floats | None:
        values, row = plain.parse_texts(cells, ".", layout.missing)
        return values if row is None else None

    parts = {role: [column] for role, column in head.columns.items()}
    for cells in plain.split_cells(data, begin, lines.delimiter, len(lines.header)):
        if cells is None:
            return None
        for role, place in places.items():
            is_time = role in TIMES
            column = plain.parse_iso(cells, place, like) if is_time else plain.parse_numbers(cells, place, others)
            if column is None:
                return None
            parts[role].append(column if is_time else plain.without_missing(column, layout.missing))
    columns = {role: np.concatenate(listed) for role, listed in parts.items()}
    return replace(head, columns=columns, rows=len(columns[timed[0]]))


def parse_table(
    path: Path, lines: Lines, headers: Mapping[str, str], advice: str, layout: Layout,
    meanings: Mapping[str, int] = MappingProxyType({}),
) -> Table:  # fmt: skip
    """Parse the requested columns from the lines of one table; arguments and errors as for ``read_table``."""
    for role, header in headers.items():
        if (count := lines.header.count(header)) != 1:
            # A wrong skip_rows or delimiter may have hidden the column: suggest these keys first.
            keys = " or ".join(key for key in ("skip_rows", "delimiter") if getattr(layout, key) is not None)
            advice = f"correct {keys}, else {advice}" if keys else advice
            if lines.header and all(name[:1] in NUMBER_STARTS for name in lines.header):
                advice = "write a line of names above the numbers in a copy, with the time in one column or two"
            raise InputError(
                f"{path}: column {header!r} ({role})",
                expected="one of the file's columns",
                found=f"{count} of that name" if count else ", ".join(lines.header) or "an empty file",
                advice="give each column a name of its own in a copy" if count else advice,
            )
    if {*DATE_AND_CLOCK} <= {*headers} and {*TIMES} & {*headers}:
        expected, advice = "a time, or date and clock apart", "keep one of the two under columns"
        raise InputError(f"{path}: columns", expected=expected, found="all three", advice=advice)
    places = {role: lines.header.index(header) for role, header in headers.items()}
    lines, unit_lines = _drop_units(lines, list(places.values()))
    said = {role: (headers[role], *(row[k].strip() for row in unit_lines)) for role, k in places.items()}
    lines = _join_decimals(path, lines) if (layout.delimiter, layout.decimal) == (",", ",") else lines
    n = len(lines.header)
    if long := [k for k, row in enumerate(lines.rows) if len(row) > n and any(cell.strip() for cell in row[n:])]:
        advice = MEND
        if len(long) == len(lines.rows) > 1:
            advice = "if commas are decimals too, write delimiter: comma and decimal: comma, else correct delimiter"
        shown = f"a line of {len(lines.rows[long[0]])} cells"
        _refuse_line(path, lines.numbers[long[0]], f"{n} cells as in the header", shown, advice)
    timed = [role for role in places if role in (*TIMES, *DATE_AND_CLOCK)]
    columns, time_note = _parse_times(path, lines, {role: places[role] for role in timed}, layout)
    texts = {role: _column(path, lines, place, role) for role, place in places.items() if role not in timed}
    unknown = ""
    if FLAG in texts:
        cells = texts.pop(FLAG)
        counts = Counter(cells)
        known = {cell: NOT_CHECKED if not cell else flags.flag_of(cell, cell, meanings) for cell in counts}
        codes = {cell: PROBABLY_BAD if flag is None else flag for cell, flag in known.items()}
        columns[FLAG] = np.array([codes[cell] for cell in cells], dtype=float)
        nameless = {cell: counts[cell] for cell, flag in known.items() if flag is None}
        where = f"{path.name}: column {headers[FLAG]}"
        unknown = flags.describe_unknown_flags(where, nameless) if nameless else ""
    elif unused := [name for name in dict.fromkeys(lines.header) if _FLAGS.search(name)] * ("north" in headers):
        unknown = f"{path.name}: flags stand in {', '.join(unused)}, which columns do not name as flag: none was used."
    decimal, by_comma = _detect_decimal(path, texts, headers, layout)
    for role, cells in texts.items():
        columns[role], row = plain.parse_texts(cells, decimal, layout.missing)
        if row is not None:
            to_do = "correct decimal" if layout.decimal else _advise_on_word(cells[row])
            _refuse_line(path, f"{lines.numbers[row]}, {headers[role]}", NUMBER_FORM, repr(cells[row]), to_do)
    recognised = (
        ["units below the header"] * bool(unit_lines) + ["decimal commas"] * by_comma + [time_note] * bool(time_note)
    )
    return Table(columns, len(lines.rows), lines.cut, (*lines.notes, *recognised), said, unknown)


def _advise_on_word(cell: str, longest: int = 20) -> str:
    """Word the advice on a cell that is not a number; malformed text with digits is not offered as a missing value."""
    if _WITH_THOUSANDS.fullmatch(cell):
        return "export numbers without marks between thousands"
    word = len(cell) <= longest and (NUMBER.fullmatch(cell) or not any(map(str.isdigit, cell)))
    return f"{MEND}, or write missing: [{cell!r}]" if word else MEND


def date_and_clock(headers: Mapping[str, str], withheld: Collection[str] = ()) -> dict[str, str]:
    """Select the headers of date and clock; empty unless both are given and neither these nor a time is withheld."""
    parts = {role: headers[role] for role in DATE_AND_CLOCK if headers.get(role)}
    usable = len(parts) == len(DATE_AND_CLOCK) and not {*parts, *parts.values(), *TIMES} & set(withheld)
    return parts if usable else {}


def table_notes(tables: Iterable[Table]) -> tuple[str, ...]:
    """Collect the notes on detected formats and unknown flags of several tables, without duplicates."""
    tables = [*tables]
    read = [f"the table was read as it is written: {', '.join(table.notes)}" for table in tables if table.notes]
    return tuple(dict.fromkeys([*read, *(table.unknown_flags for table in tables if table.unknown_flags)]))


def read_header(path: Path, needed: Iterable[str], layout: Layout = DEFAULT_LAYOUT) -> list[str]:
    """Read the column names of a table, empty for an empty file; arguments and errors as for ``read_lines``."""
    return read_lines(path, needed, layout).header


def read_lines(path: Path, needed: Iterable[str], layout: Layout = DEFAULT_LAYOUT) -> Lines:
    """Read the header and the rows of a table without comments.

    Args:
        needed: column names that identify the header; if no line contains them all, the first line is the header.

    Raises:
        InputError: the file cannot be read.
    """
    wanted = set(needed)
    lines = find_lines(path, lambda names: wanted <= set(names), layout)
    assert lines is not None  # without ``must`` the first line is the fallback
    return lines


def find_lines(
    path: Path,
    fits: Callable[[Sequence[str]], bool],
    layout: Layout = DEFAULT_LAYOUT,
    *,
    delimiters: Iterable[str] = DELIMITERS,
    must: bool = False,
    text: str | None = None,
) -> Lines | None:
    """Locate the header by a predicate, and split the header and the rows below it into cells.

    Args:
        fits: predicate that accepts the column names of the header.
        delimiters: candidates, in order of preference.
        must: return None if no line fits, instead of taking the first line as the header.
        text: beginning of the file, if only that is to be parsed.

    Raises:
        InputError: the file cannot be read.
    """
    text, text_notes = read_text(path) if text is None else (text, ())
    raw = list(io.StringIO(text, newline=""))
    skipped = min(layout.skip_rows or 0, len(raw))
    first = next((k for k in range(skipped, len(raw)) if _has_content(raw[k])), skipped)
    places = range(skipped, min(skipped + HEAD_LINES, len(raw))) if layout.skip_rows is None else [first]
    candidates = [layout.delimiter] if layout.delimiter else list(delimiters)
    headers = (_find_header(raw, places, candidate, fits) for candidate in candidates)
    begin, delimiter = next(filter(None, headers), (None, ""))
    if begin is None:  # numpy.savetxt writes the header as a comment
        bare = [re.sub(r"^\s*[#%]+\s*", "", line) if line.lstrip()[:1] in COMMENT_MARKS else "" for line in raw]
        headers = (_find_header(bare, places, candidate, fits) for candidate in candidates)
        begin, delimiter = next(filter(None, headers), (None, ""))
        raw = raw if begin is None else [*raw[:begin], bare[begin], *raw[begin + 1 :]]
    if begin is None and must:
        return None
    if begin is None:
        line = raw[first] if first < len(raw) else ","
        counts = {candidate: line.count(candidate) for candidate in (",", ";", "\t")}
        usual = max(counts, key=lambda candidate: counts[candidate]) if any(counts.values()) else " "
        begin, delimiter = first, layout.delimiter or usual
    if any(mark in text for mark in map(chr, TYPESETTING)):
        raw[begin + 1 :] = [line.translate(TYPESETTING) for line in raw[begin + 1 :]]
    lines = _split_lines(path, raw, begin, delimiter, ended=text.endswith(("\n", "\r")))
    above = sum(map(_has_content, raw[skipped:begin]))
    notes = [f"cells between {DELIMITERS.get(delimiter)}"] * (delimiter != "," and layout.delimiter is None)
    notes += [f"{above} line{'s' * (above > 1)} above the header"] * (above > 0)
    return replace(lines, notes=(*text_notes, *notes, *lines.notes), delimiter=delimiter)


def _find_header(
    raw: Sequence[str], places: Iterable[int], delimiter: str, fits: Callable[[Sequence[str]], bool]
) -> tuple[int, str] | None:
    """Find the index of the first line that fits, and its delimiter; None if a row of numbers comes first."""
    for k in places:
        if k >= len(raw) or not _has_content(raw[k]):
            continue
        try:
            row = _strip_quotes(split_words(raw[k]) if delimiter == " " else next(_reader([raw[k]], delimiter)))
        except csv.Error:
            continue
        if row and fits(row):
            return k, delimiter
        if len(row) > 1 and all(cell[:1] in NUMBER_STARTS for cell in row):
            return None
    return None


def _has_content(line: str) -> bool:
    return bool(line.strip(" \t\r\n,;")) and line.lstrip()[0] not in COMMENT_MARKS


def _reader(lines: Iterable[str], delimiter: str) -> Any:
    return csv.reader(lines, delimiter=delimiter, skipinitialspace=True)  # quoted cells may follow blanks


def split_words(line: str) -> list[str]:
    """Split a line at blanks outside quotation marks."""
    return line.split() if '"' not in line else [cell.strip('="') for cell in _WORD.findall(line)]


def _strip_quotes(row: Sequence[str]) -> list[str]:
    return [cell.strip(QUOTES) for cell in row]


def _split_lines(path: Path, raw: list[str], begin: int, delimiter: str, *, ended: bool) -> Lines:
    """Split the header line and the rows below it into cells."""
    if delimiter == " ":
        listed = [split_words(line) for line in raw[begin:]]
    else:
        reader = _reader(raw[begin:], delimiter)
        try:
            listed = list(reader)
        except csv.Error as error:
            advice = "check path and format"
            raise InputError(str(path), expected="a readable CSV file", found=error, advice=advice) from None
        if len(listed) < reader.line_num:  # a cell spans lines: a stray quotation mark swallows rows
            reader = _reader(raw[begin:], delimiter)
            line = next(k for k, _ in enumerate(reader, 1) if reader.line_num > k) + begin
            _refuse_line(path, line, "cells that end in their line", "a quotation mark that is not closed")
    filled = [k for k, row in enumerate(listed) if row and (row[0].strip() or any(map(str.strip, row)))]
    filled = [k for k in filled if listed[k][0].lstrip()[:1] not in COMMENT_MARKS or not listed[k][0].strip()]
    if not filled:
        return Lines([], [], [])
    header = _strip_quotes(listed[filled[0]])
    # Printed pages and concatenated files repeat the header.
    again = {k for k in filled[1:] if header[0] in listed[k][0] and _strip_quotes(listed[k]) == header}
    places = [k for k in filled[1:] if k not in again]
    rows = [listed[k] for k in places]
    if delimiter == " " and rows and all(len(row) == len(header) + 1 for row in rows):
        k = next((k for k, cell in enumerate(rows[0]) if k and ":" in cell), 0)
        if k and all(":" in row[k] for row in rows):  # one header names date and clock
            rows = [[*row[: k - 1], f"{row[k - 1]} {row[k]}", *row[k + 1 :]] for row in rows]

    def decimals(row: list[str]) -> int:
        return len(row[-1].strip().replace(",", ".").partition(".")[2])

    # An unterminated last line is truncated if it lacks cells, or its last cell has fewer decimals than any other.
    usual = min((decimals(row) for row in rows[:-1] if row[-1].strip()), default=0)
    cut = bool(rows) and not ended and (len(rows[-1]) < len(header) or decimals(rows[-1]) < usual)
    notes = (f"{len(again)} more header line{'s' * (len(again) > 1)}",) if again else ()
    return Lines(header, rows[: len(rows) - cut], [begin + k + 1 for k in places], int(cut), notes=notes)


def _drop_units(lines: Lines, places: Sequence[int], most: int = 2) -> tuple[Lines, list[list[str]]]:
    """Take unit lines from below the header, whose requested cells hold unit-like words instead of numbers."""
    count = 0
    for row in lines.rows[:most]:
        cells = [row[k].strip() for k in places if k < len(row)]
        words = [cell for cell in cells if cell.lower() not in MISSING_TEXT]
        if not words or len(cells) < len(places) or not all(map(_UNIT.fullmatch, words)):
            break
        count += 1
    return replace(lines, rows=lines.rows[count:], numbers=lines.numbers[count:]), lines.rows[:count]


def _join_decimals(path: Path, lines: Lines) -> Lines:
    """Rejoin numbers split at decimal commas where the delimiter is a comma too; reject numbers without decimals."""
    n, rows = len(lines.header), list(lines.rows)
    for k, row in enumerate(rows):
        if len(row) <= n:  # quoted numbers were not split
            continue
        halves = iter(row)
        whole = [f"{cell.strip()},{next(halves, '')}" if _WHOLE.fullmatch(cell.strip()) else cell for cell in halves]
        if len(whole) != n or not all("," not in cell or _WITH_COMMA.fullmatch(cell) for cell in whole):
            expected, shown = "decimals in every number, as commas part cells too", ",".join(row)
            advice = "write every number with decimals, or export with semicolons and write delimiter: semicolon"
            _refuse_line(path, lines.numbers[k], expected, shown, advice)
        rows[k] = whole
    return replace(lines, rows=rows)


def _column(path: Path, lines: Lines, place: int, role: str) -> list[str]:
    if min(map(len, lines.rows), default=place + 1) <= place:
        row = next(k for k, row in enumerate(lines.rows) if len(row) <= place)
        expected = times.TIME_FORM if role in (*TIMES, *DATE_AND_CLOCK) else NUMBER_FORM
        where, shown = f"{lines.numbers[row]}, {lines.header[place]}", f"a line of {len(lines.rows[row])} cells"
        _refuse_line(path, where, expected, shown)
    return [row[place].strip() for row in lines.rows]


def _detect_decimal(
    path: Path, texts: Mapping[str, list[str]], headers: Mapping[str, str], layout: Layout
) -> tuple[str, bool]:
    """Detect the decimal mark, and whether it is an inferred comma; reject commas that may separate thousands."""
    if layout.decimal:
        return layout.decimal, False
    with_comma = [
        (role, cell)
        for role, cells in texts.items()
        for cell in cells
        if "," in cell and (_WITH_COMMA.fullmatch(cell) or _ONLY_THOUSANDS.fullmatch(cell))
    ]
    if not with_comma:
        return ".", False
    expected, advice = "numbers with decimals behind points", "write decimal: comma or decimal: point"
    point = next((cell for cells in texts.values() for cell in cells if "." in cell and NUMBER.fullmatch(cell)), None)
    if point is not None or all(_ONLY_THOUSANDS.fullmatch(cell) for _, cell in with_comma):
        role, cell = with_comma[0]
        shown = repr(cell) + (f" beside {point!r}" if point else ", which may be thousands")
        raise InputError(f"{path}: column {headers[role]!r}", expected=expected, found=shown, advice=advice)
    return ",", True


def _parse_times(path: Path, lines: Lines, places: Mapping[str, int], layout: Layout) -> tuple[dict[str, Floats], str]:
    """Parse the time columns by role, with date and clock combined, and describe the detected format."""
    around = "".join({*QUOTES} - {*(layout.time_format or "")})  # never strip characters of the format itself
    texts = {}
    for role, place in places.items():
        texts[role] = [cell.strip(around) for cell in _column(path, lines, place, role)], lines.header[place]
    if set(DATE_AND_CLOCK) <= set(texts):
        (dates, date), (clocks, clock) = (texts[role] for role in DATE_AND_CLOCK)
        texts = {"time": ([f"{day} {time}" for day, time in zip(dates, clocks, strict=True)], f"{date} and {clock}")}
    columns, note = {}, ""
    for role, (cells, header) in texts.items():

        def numbers(cells: list[str] = cells) -> Floats | None:
            """Parse times as numbers, None unless all are; commas are decimal, as times have no thousands separator."""
            by_comma = layout.decimal is None and any("," in cell for cell in cells)
            values, row = plain.parse_texts(cells, "," if by_comma else layout.decimal or ".", ())
            return values if row is None else None

        try:
            columns[role], note = times.parse_times(cells, numbers, form=layout.time_format, zone=layout.timezone)
        except times.Unreadable as error:
            line = "" if error.row is None else f"line {lines.numbers[error.row]}, "
            quoted = error.row is not None and any(mark in cells[error.row] for mark in "\"'")
            advice = "delete the quotation marks" if quoted else error.advice
            advice = JOIN if _PART.fullmatch(header) else advice
            advice = advice or f"{MEND}; {times.SETTLE} for another form"
            where = f"{path}: {line}{header}"
            raise InputError(where, expected=error.expected, found=error.shown, advice=advice) from None
    return columns, note


def _refuse_line(path: Path, line: int | str, expected: str, shown: str, advice: str = MEND) -> None:
    raise InputError(f"{path}: line {line}", expected=expected, found=shown, advice=advice) from None
