"""Text tables with a header line: columns of numbers and times, nothing else.

What parts the cells, decimal commas, lines above the header, units below it, packing and encoding are recognised where
there is one way to read them, and said in ``Table.notes``; the rest is refused in a line that names the key of the YAML
file (``Layout``) that settles it. The header is the first line that holds every column that is asked for.

A line that holds more or fewer cells than the header, or a word where a number belongs, ends the reading in one line:
cells that have moved are numbers too. Only a last line without its end may be cut; it is left out and counted.
"""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import files, flags, times
from compasslib.readers.files import read_text
from compasslib.records import NOT_CHECKED, PROBABLY_BAD
from compasslib.types import Floats

MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
COLUMN_MAP = "correct columns in the mooring file"
TIMES = ("time", "time_utc")  # roles that hold times
FLAG = "flag"  # the role of quality flags: words or values
NO_MEANINGS: Mapping[str, int] = MappingProxyType({})
DATE_AND_CLOCK = ("date", "clock")  # roles that hold the two parts of one
LARGEST = 1e30  # no measurement in any unit; its square still is a number
NUMBER_FORM = "a number or nothing"
MEND = "mend or remove the line"
LONGEST_WORD = 20  # that may stand for nothing
DELIMITERS = {"\t": "tabs", ";": "semicolons", ",": "commas", " ": "blanks"}  # in the order in which they are tried
SEARCHED = 400  # lines among which the header is looked for
MOST_UNITS = 2  # lines of units or the like below a header
DIGITS = tuple("+-.0123456789")  # with which cells of data begin
MARKS = "#%"  # of a comment
ALIKE = {0x2212: "-", 0xA0: " ", 0x202F: " "}  # the minus sign and blanks of typesetters
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_PLAIN = re.compile(r"[0-9eE+\-.\n]*")
_WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)
_WHOLE = re.compile(r"[-+]?\d+", re.ASCII)
_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
_PARTED = re.compile(r"[-+]?\d{1,3}(?:([,.' ])\d{3})+(?!\1)[.,]\d*|[-+]?\d{1,3}(?:[' ]\d{3})+", re.ASCII)
_UNIT = re.compile(r"(?=.*[^\W\d_]|.*%|.*°)(?!.*\d\d)[^\n]{1,40}|", re.DOTALL)  # metres, cm s-1, [°C], %


@dataclass(frozen=True)
class Layout:
    """What the YAML file says on how a table is written, None where it does not."""

    delimiter: str | None = None  # the character
    decimal: str | None = None  # the character
    time_format: str | None = None  # strptime, or a scale of ``times.SCALES``
    timezone: str | None = None  # UTC or +02:00
    missing: tuple[str, ...] = ()
    skip_rows: int | None = None  # lines above the header

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Layout:
        """Return the layout among the settings of a file."""
        given = {field.name: settings.get(field.name) for field in fields(cls)}
        return cls(**(given | {"missing": tuple(given["missing"] or ())}))


DEFAULT_LAYOUT = Layout()


@dataclass(frozen=True)
class Lines:
    """The lines of a table that are not empty and no comments; cells of rows are not stripped."""

    header: list[str]
    rows: list[list[str]]
    numbers: Sequence[int]  # of each row's line in the file
    cut: int = 0  # last lines that were left out
    notes: tuple[str, ...] = ()  # what was recognised


@dataclass(frozen=True)
class Table:
    """Columns of a table by role."""

    columns: dict[str, Floats]  # times as UTC seconds since 1970, nothing as NaN
    rows: int
    cut: int
    notes: tuple[str, ...]  # what was recognised, in words
    unknown_flags: str = ""  # the sentence about flags that nobody knows


def read_columns(
    path: Path, headers: Mapping[str, str], advice: str = COLUMN_MAP, layout: Layout = DEFAULT_LAYOUT
) -> dict[str, Floats]:
    """Return columns of one table, times as UTC seconds since 1970, nothing as NaN.

    Args:
        headers: role -> header; ``time`` and ``time_utc`` hold times, ``date`` and ``clock`` the two parts of one,
            which becomes ``time``; all others numbers.

    Raises:
        InputError: the file or a column is absent, or a time or number cannot be read in one way only.
    """
    return read_table(path, headers, advice, layout).columns


def read_table(
    path: Path,
    headers: Mapping[str, str],
    advice: str = COLUMN_MAP,
    layout: Layout = DEFAULT_LAYOUT,
    meanings: Mapping[str, int] = NO_MEANINGS,
) -> Table:
    """Return the same with what was recognised and lost; arguments and errors as for ``read_columns``.

    Args:
        meanings: of the flags in a column ``flag``, see ``flags.parse_flag_settings``.
    """
    return parse_table(path, read_lines(path, headers.values(), layout), headers, advice, layout, meanings)


def parse_table(
    path: Path,
    lines: Lines,
    headers: Mapping[str, str],
    advice: str,
    layout: Layout,
    meanings: Mapping[str, int] = NO_MEANINGS,
) -> Table:
    """Return columns of the lines of one table; arguments and errors as for ``read_table``."""
    for role, header in headers.items():
        if (times_there := lines.header.count(header)) != 1:
            raise InputError(
                f"{path}: column {header!r} ({role})",
                expected="one of the file's columns",
                found=f"{times_there} of that name" if times_there else ", ".join(lines.header) or "an empty file",
                advice="give each column a name of its own in a copy" if times_there else _or_key(advice, layout),
            )
    if {*DATE_AND_CLOCK} <= {*headers} and {*TIMES} & {*headers}:
        expected, advice = "a time, or date and clock apart", "keep one of the two under columns"
        raise InputError(f"{path}: columns", expected=expected, found="all three", advice=advice)
    places = {role: lines.header.index(header) for role, header in headers.items()}
    lines, units = _without_units(lines, list(places.values()))
    lines = _rejoined(path, lines) if (layout.delimiter, layout.decimal) == (",", ",") else lines
    _refuse_long(path, lines)
    timed = [role for role in places if role in (*TIMES, *DATE_AND_CLOCK)]
    columns, said = _times_in(path, lines, {role: places[role] for role in timed}, layout)
    texts = {role: _column(path, lines, place, role) for role, place in places.items() if role not in timed}
    unknown = ""
    if FLAG in texts:
        columns[FLAG], unknown = _flags(f"{path.name}: column {headers[FLAG]}", texts.pop(FLAG), meanings)
    decimal, by_comma = _decimal(path, texts, headers, layout)
    for role, cells in texts.items():
        columns[role], row = _numbers(cells, decimal, layout.missing)
        if row is not None:
            to_do = "correct decimal" if layout.decimal else _mend(cells[row])
            _refuse_line(path, f"{lines.numbers[row]}, {headers[role]}", NUMBER_FORM, repr(cells[row]), to_do)
    notes = (*lines.notes, *["units below the header"] * units, *["decimal commas"] * by_comma, *filter(None, [said]))
    return Table(columns, len(lines.rows), lines.cut, notes, unknown)


def _flags(where: str, cells: Sequence[str], meanings: Mapping[str, int]) -> tuple[Floats, str]:
    """Return OceanSITES flags of cells that hold meanings or values, and the sentence about those that nobody knows."""
    counts = Counter(cells)
    known = {cell: NOT_CHECKED if not cell else flags.flag_of(cell, cell, meanings) for cell in counts}
    unknown = {cell: counts[cell] for cell, flag in known.items() if flag is None}
    codes = {cell: PROBABLY_BAD if flag is None else flag for cell, flag in known.items()}
    found = np.array([codes[cell] for cell in cells], dtype=float)
    return found, flags.describe_unknown_flags(where, unknown) if unknown else ""


def _mend(cell: str) -> str:
    """Return what to do about a cell that is no number: what holds digits may be one, and is not to be left out."""
    if _PARTED.fullmatch(cell):
        return "export numbers without marks between thousands"
    word = len(cell) <= LONGEST_WORD and (_NUMBER.fullmatch(cell) or not any(map(str.isdigit, cell)))
    return f"{MEND}, or write missing: [{cell!r}]" if word else MEND


def _or_key(advice: str, layout: Layout) -> str:
    """Return what to do about a column that is not there, first the keys that may have hidden it."""
    given = [key for key in ("skip_rows", "delimiter") if getattr(layout, key) is not None]
    return f"correct {' or '.join(given)}, else {advice}" if given else advice


def date_and_clock(headers: Mapping[str, str], withheld: Collection[str] = ()) -> dict[str, str]:
    """Return the headers of date and clock where both are named and neither is withheld."""
    apart = {role: headers[role] for role in DATE_AND_CLOCK if headers.get(role)}
    return apart if len(apart) == len(DATE_AND_CLOCK) and not {*apart, *apart.values(), *TIMES} & set(withheld) else {}


def table_notes(tables: Iterable[Table]) -> tuple[str, ...]:
    """Return the sentences on what was recognised in tables, each once."""
    listed = [*tables]
    read = [f"the table was read as it is written: {', '.join(one.notes)}" for one in listed if one.notes]
    return tuple(dict.fromkeys([*read, *(one.unknown_flags for one in listed if one.unknown_flags)]))


def read_header(path: Path, needed: Iterable[str], layout: Layout = DEFAULT_LAYOUT) -> list[str]:
    """Return the names of a table's columns, none for an empty file.

    Args:
        needed: names that the header holds.

    Raises:
        InputError: the file cannot be read.
    """
    return read_lines(path, needed, layout).header


def read_lines(path: Path, needed: Iterable[str], layout: Layout = DEFAULT_LAYOUT) -> Lines:
    """Return the header and the rows of a table, comments left out.

    Args:
        needed: names that the header holds; where no line does the first is taken for it.

    Raises:
        InputError: the file cannot be read.
    """
    wanted = set(needed)
    found = find_lines(path, lambda names: wanted <= set(names), layout)
    assert found is not None  # any line fits in the end
    return found


def find_lines(
    path: Path,
    fits: Callable[[Sequence[str]], bool],
    layout: Layout = DEFAULT_LAYOUT,
    *,
    delimiters: Iterable[str] = DELIMITERS,
    must: bool = False,
) -> Lines | None:
    """Return the lines of a table whose header fits.

    Args:
        fits: whether names may be those of the header.
        delimiters: that are tried, in this order.
        must: None is returned where no line fits, else the first is the header.

    Raises:
        InputError: the file cannot be read.
    """
    read = read_text(path)
    raw = list(io.StringIO(read.text, newline=""))
    skipped = min(layout.skip_rows or 0, len(raw))
    meant = range(skipped, min(skipped + SEARCHED, len(raw)))
    first = next((k for k in range(skipped, len(raw)) if _holds(raw[k])), skipped)
    places = meant if layout.skip_rows is None else [first]
    tried = [layout.delimiter] if layout.delimiter else list(delimiters)
    begin, delimiter = next(filter(None, (_header(raw, places, one, fits) for one in tried)), (None, ""))
    if begin is None and must:
        return None
    if begin is None:
        begin, delimiter = first, layout.delimiter or _usual(raw[first : first + 1])
    if any(mark in read.text for mark in map(chr, ALIKE)):
        raw[begin + 1 :] = [line.translate(ALIKE) for line in raw[begin + 1 :]]
    lines = _below(path, raw, begin, delimiter, ended=read.text.endswith(("\n", "\r")))
    above = sum(map(_holds, raw[skipped:begin]))
    said = [f"cells between {DELIMITERS.get(delimiter)}"] * (delimiter != "," and layout.delimiter is None)
    said += [f"{above} line{'s' * (above > 1)} above the header"] * (above > 0)
    return replace(lines, notes=(*read.notes, *said, *lines.notes))


def _header(
    raw: Sequence[str], places: Iterable[int], delimiter: str, fits: Callable[[Sequence[str]], bool]
) -> tuple[int, str] | None:
    """Return the first line that fits, and the delimiter; none below rows of numbers, which nothing may pass over."""
    for k in places:
        row = _parted(raw[k], delimiter) if k < len(raw) and _holds(raw[k]) else []
        if row and fits(row):
            return k, delimiter
        if len(row) > 1 and all(cell[:1] in DIGITS for cell in row):
            return None
    return None


def _holds(line: str) -> bool:
    return bool(line.strip(" \t\r\n,;")) and line.lstrip()[0] not in MARKS


def _parted(line: str, delimiter: str) -> list[str]:
    try:
        return files.without_quotes(
            files.split_words(line) if delimiter == " " else next(files.split_rows([line], delimiter))
        )
    except csv.Error:
        return []


def _usual(lines: Sequence[str]) -> str:
    """Return what parts a line into most cells; blanks only where nothing else does."""
    counts = {one: line.count(one) for line in lines for one in (",", ";", "\t")}
    return max(counts, key=lambda one: counts[one]) if any(counts.values()) else "," if not lines else " "


def _below(path: Path, raw: list[str], begin: int, delimiter: str, *, ended: bool) -> Lines:
    """Return the header in one line and the rows below it."""
    if delimiter == " ":
        listed = [files.split_words(line) for line in raw[begin:]]
    else:
        reader = files.split_rows(raw[begin:], delimiter)
        try:
            listed = list(reader)
        except csv.Error as error:
            advice = "check path and format"
            raise InputError(str(path), expected="a readable CSV file", found=error, advice=advice) from None
        if len(listed) < reader.line_num:
            _refuse_quote(path, raw, begin, delimiter)
    filled = [k for k, row in enumerate(listed) if row and (row[0].strip() or any(map(str.strip, row)))]
    kept = [k for k in filled if listed[k][0].lstrip()[:1] not in MARKS or not listed[k][0].strip()]
    if not kept:
        return Lines([], [], [])
    header = files.without_quotes(listed[kept[0]])
    # Of pages or files put together.
    again = {k for k in kept[1:] if header[0] in listed[k][0] and files.without_quotes(listed[k]) == header}
    kept = [k for k in kept if k not in again]
    rows = [listed[k] for k in kept[1:]]
    rows = _with_clocks(header, rows) if delimiter == " " else rows
    cut = bool(rows) and not ended and _is_cut(rows[-1], rows[:-1], header)
    notes = (f"{len(again)} more header line{'s' * (len(again) > 1)}",) if again else ()
    return Lines(header, rows[: len(rows) - cut], [begin + k + 1 for k in kept[1:]], int(cut), notes)


def _refuse_quote(path: Path, raw: list[str], begin: int, delimiter: str) -> None:
    """Refuse a cell that goes on in the next line: a stray quotation mark would swallow rows."""
    reader = files.split_rows(raw[begin:], delimiter)
    line = next(k for k, _ in enumerate(reader, 1) if reader.line_num > k) + begin
    _refuse_line(path, line, "cells that end in their line", "a quotation mark that is not closed")


def _with_clocks(header: Sequence[str], rows: list[list[str]]) -> list[list[str]]:
    """Return rows between blanks with date and clock in one cell, where every row has one cell more than the header."""
    if not rows or any(len(row) != len(header) + 1 for row in rows):
        return rows
    k = next((k for k, cell in enumerate(rows[0]) if k and ":" in cell), 0)
    if not k or not all(":" in row[k] for row in rows):
        return rows
    return [[*row[: k - 1], f"{row[k - 1]} {row[k]}", *row[k + 1 :]] for row in rows]


def _without_units(lines: Lines, places: Sequence[int]) -> tuple[Lines, bool]:
    """Return the lines without those of units below the header: words in every column, where rows hold numbers."""
    count = 0
    for row in lines.rows[:MOST_UNITS]:
        cells = [row[k].strip() for k in places if k < len(row)]
        words = [cell for cell in cells if cell.lower() not in MISSING_TEXT]
        if not words or len(cells) < len(places) or not all(map(_UNIT.fullmatch, words)):
            break
        count += 1
    return replace(lines, rows=lines.rows[count:], numbers=lines.numbers[count:]), count > 0


def _rejoined(path: Path, lines: Lines) -> Lines:
    """Return the lines with the halves of numbers together, where commas part cells and decimals: all have decimals.

    Raises:
        InputError: a number has none, so that nobody can tell which halves belong together.
    """
    n, rows = len(lines.header), list(lines.rows)
    for k, row in enumerate(rows):
        if len(row) <= n:  # numbers between quotation marks
            continue
        halves = iter(row)
        whole = [f"{cell.strip()},{next(halves, '')}" if _WHOLE.fullmatch(cell.strip()) else cell for cell in halves]
        if len(whole) != n or not all("," not in cell or _WITH_COMMA.fullmatch(cell) for cell in whole):
            expected, found = "decimals in every number, as commas part cells too", ",".join(row)
            advice = "write every number with decimals, or export with semicolons and write delimiter: semicolon"
            _refuse_line(path, lines.numbers[k], expected, found, advice)
        rows[k] = whole
    return replace(lines, rows=rows)


def _refuse_long(path: Path, lines: Lines) -> None:
    n = len(lines.header)
    if max(map(len, lines.rows), default=0) <= n:
        return
    long = [k for k, row in enumerate(lines.rows) if any(cell.strip() for cell in row[n:])]
    if long:
        advice = MEND
        if len(long) == len(lines.rows) > 1:
            advice = "if commas are decimals too, write delimiter: comma and decimal: comma, else correct delimiter"
        found = f"a line of {len(lines.rows[long[0]])} cells"
        _refuse_line(path, lines.numbers[long[0]], f"{n} cells as in the header", found, advice)


def _column(path: Path, lines: Lines, place: int, role: str) -> list[str]:
    if min(map(len, lines.rows), default=place + 1) <= place:
        row = next(k for k, row in enumerate(lines.rows) if len(row) <= place)
        expected = times.TIME_FORM if role in (*TIMES, *DATE_AND_CLOCK) else NUMBER_FORM
        where, found = f"{lines.numbers[row]}, {lines.header[place]}", f"a line of {len(lines.rows[row])} cells"
        _refuse_line(path, where, expected, found)
    return [row[place].strip() for row in lines.rows]


def _decimal(
    path: Path, texts: Mapping[str, list[str]], headers: Mapping[str, str], layout: Layout
) -> tuple[str, bool]:
    """Return the character before decimals, and whether it was recognised as a comma.

    Raises:
        InputError: cells hold points and commas, or commas that could part thousands.
    """
    if layout.decimal:
        return layout.decimal, False
    numbers = [(role, cell) for role, cells in texts.items() for cell in cells if "," in cell and _comma(cell)]
    if not numbers:
        return ".", False
    expected, advice = "numbers with decimals behind points", "write decimal: comma or decimal: point"
    point = next((cell for cells in texts.values() for cell in cells if "." in cell and _NUMBER.fullmatch(cell)), None)
    if point is not None or all(_THOUSANDS.fullmatch(cell) for _, cell in numbers):
        role, cell = numbers[0]
        found = repr(cell) + (f" beside {point!r}" if point else ", which may be thousands")
        raise InputError(f"{path}: column {headers[role]!r}", expected=expected, found=found, advice=advice)
    return ",", True


def _comma(cell: str) -> bool:
    return bool(_WITH_COMMA.fullmatch(cell) or _THOUSANDS.fullmatch(cell))


def _numbers(cells: list[str], decimal: str, missing: Sequence[str]) -> tuple[Floats, int | None]:
    """Return cells as numbers, (n,), NaN for nothing, and the first row that holds something else."""
    turned = [cell.replace(",", ".") if "." not in cell else f"{cell}?" for cell in cells] if decimal == "," else cells
    words = MISSING_TEXT | {text.lower() for text in missing}
    try:
        if not _PLAIN.fullmatch("\n".join(turned)):
            raise ValueError
        values = np.fromiter(map(float, turned), dtype=float, count=len(turned))
        sound = bool((np.abs(values) < LARGEST).all())
    except ValueError:
        sound = False
    if not sound:
        values = np.full(len(cells), np.nan)
        for row, (cell, text) in enumerate(zip(cells, turned, strict=True)):
            if cell.lower() in words:
                continue
            if not (_NUMBER.fullmatch(text) and abs(value := float(text)) < LARGEST):
                return values, row
            values[row] = value
    for text in (text.replace(",", ".") for text in missing):
        values[values == float(text) if _NUMBER.fullmatch(text) else np.isnan(values)] = np.nan
    return values, None


def _times_in(path: Path, lines: Lines, places: Mapping[str, int], layout: Layout) -> tuple[dict[str, Floats], str]:
    """Return the times of a table by their role, date and clock together, and what was recognised."""
    around = "".join({*files.QUOTES} - {*(layout.time_format or "")})  # a format may hold them
    texts = {
        role: ([cell.strip(around) for cell in _column(path, lines, place, role)], lines.header[place])
        for role, place in places.items()
    }
    if set(DATE_AND_CLOCK) <= set(texts):
        (dates, date), (clocks, clock) = (texts[role] for role in DATE_AND_CLOCK)
        texts = {"time": ([f"{one} {other}" for one, other in zip(dates, clocks, strict=True)], f"{date} and {clock}")}
    found, said = {}, ""
    for role, (cells, header) in texts.items():
        numbers = partial(_as_numbers, cells, layout)
        try:
            found[role], said = times.seconds(cells, numbers, form=layout.time_format, zone=layout.timezone)
        except times.Unreadable as error:
            line = "" if error.row is None else f"line {lines.numbers[error.row]}, "
            quoted = error.row is not None and any(mark in cells[error.row] for mark in "\"'")
            advice = "delete the quotation marks" if quoted else error.advice
            advice = advice or f"{MEND}; {times.SETTLE} for another form"
            where = f"{path}: {line}{header}"
            raise InputError(where, expected=error.expected, found=error.found, advice=advice) from None
    return found, said


def _as_numbers(cells: list[str], layout: Layout) -> Floats | None:
    """Return times as numbers, None where a cell is none; a comma is a decimal one, as thousands part no time."""
    by_comma = layout.decimal is None and any("," in cell for cell in cells)
    values, row = _numbers(cells, "," if by_comma else layout.decimal or ".", ())
    return values if row is None else None


def _refuse_line(path: Path, line: int | str, expected: str, found: str, advice: str = MEND) -> None:
    raise InputError(f"{path}: line {line}", expected=expected, found=found, advice=advice) from None


def _is_cut(last: list[str], others: list[list[str]], header: list[str]) -> bool:
    """Return whether a last line without its end lacks cells, or its last cell decimals that all others have."""
    if len(last) < len(header) or not others:
        return len(last) < len(header)
    return _decimals(last[-1]) < min((_decimals(row[-1]) for row in others if row[-1].strip()), default=0)


def _decimals(cell: str) -> int:
    return len(cell.strip().replace(",", ".").partition(".")[2])
