"""The cells of comma-separated files with a header line: columns of numbers and times, nothing else.

A line that holds more or fewer cells than the header, or a word where a number belongs, ends the reading in one line:
cells that have moved are numbers too. Only a last line without its end may be cut; it is left out and counted.
The checks of raw text, for strange bytes and endless lines, serve the other text formats too.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compasslib.core.errors import InputError
from compasslib.core.types import Floats

MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
COLUMN_MAP = "correct columns in the mooring file"
TIMES = ("time", "time_utc")  # roles that hold times
LARGEST = 1e30  # no measurement in any unit; its square still is a number
TIME_FORM = "an ISO time like 2007-09-04T00:00:00Z"
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_CLOCK = r"[T ]\d\d(?::\d\d(?::\d\d(?:\.\d{1,9})?)?)?"
_TIME = re.compile(rf"(\d{{4}}-\d\d-\d\d(?:{_CLOCK})?)(?:Z| ?UTC|([+-])([01]\d):?([0-5]\d))?", re.ASCII)
LONGEST_LINE = 2**20  # bytes; a table of 10,000 columns has fewer
_TEXT = bytes([*range(9, 14), *range(32, 127)])


@dataclass(frozen=True)
class Lines:
    """The lines of a table that are not empty and no comments."""

    header: list[str]
    rows: list[tuple[int, list[str]]]  # number of the line, cells
    cut: int = 0  # last lines that were left out


def columns_of(path: Path, headers: Mapping[str, str], advice: str = COLUMN_MAP) -> dict[str, Floats]:
    """Return columns of one table, times as UTC seconds since 1970, nothing as NaN.

    Args:
        headers: role -> header; the roles ``time`` and ``time_utc`` hold times, all others numbers.

    Raises:
        InputError: the file or a column is absent, or a time or number cannot be read.
    """
    return columns_in(path, lines_of(path), headers, advice)


def columns_in(path: Path, lines: Lines, headers: Mapping[str, str], advice: str = COLUMN_MAP) -> dict[str, Floats]:
    """Return columns of the lines of one table; arguments and errors as for ``columns_of``."""
    names = lines.header
    for role, header in headers.items():
        if names.count(header) != 1:
            raise InputError(
                f"{path}: column {header!r} ({role})",
                expected="one of the file's columns",
                found=", ".join(names) or "an empty file",
                advice=advice,
            )
    return {role: _parsed(path, lines, names.index(header), role, header) for role, header in headers.items()}


def header_of(path: Path) -> list[str]:
    """Return the names of a table's columns, none for an empty file.

    Raises:
        InputError: the file cannot be read.
    """
    return lines_of(path).header


def lines_of(path: Path) -> Lines:
    """Return the header and the rows of a table, cells stripped, comments left out.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        text = of_lines(path).decode("utf-8-sig")
        reader = csv.reader(io.StringIO(text, newline=""))
        listed = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            str(path), expected="a readable CSV file in UTF-8", found=error, advice="check path and format"
        ) from None
    rows = [(line, row) for line, row in listed if any(row) and not row[0].startswith("#")]
    header = rows[0][1] if rows else []
    cut = (
        bool(rows[1:])
        and not text.endswith(("\n", "\r"))
        and _is_cut(rows[-1][1], [row for _, row in rows[1:-1]], header)
    )
    return Lines(header, rows[1 : len(rows) - cut], int(cut))


def strange(data: bytes) -> int:
    """Return how many bytes are neither printable ASCII nor space between words and lines."""
    return len(data.translate(None, _TEXT))


def of_lines(path: Path) -> bytes:
    """Return the bytes of a text file, after a look that it has lines.

    Raises:
        InputError: it cannot be read, or a line of it is longer than any instrument's.
    """
    blocks = []
    try:
        with Path(path).open("rb") as stream:
            while block := stream.read(LONGEST_LINE):
                if len(block) == LONGEST_LINE and not (b"\n" in block or b"\r" in block):
                    expected, found = f"lines of less than {LONGEST_LINE} bytes", "a longer one"
                    raise InputError(str(path), expected=expected, found=found, advice="check that it is a text file")
                blocks.append(block)
    except OSError as error:
        found = error.strerror or type(error).__name__
        raise InputError(str(path), expected="a readable file", found=found, advice="check the path") from None
    return b"".join(blocks)


def _parsed(path: Path, lines: Lines, column: int, role: str, header: str) -> Floats:
    parse = _time if role in TIMES else _number
    expected = TIME_FORM if role in TIMES else "a number or nothing"
    values = np.empty(len(lines.rows))
    for i, (line, row) in enumerate(lines.rows):
        if any(row[len(lines.header) :]):
            _refuse_line(path, line, f"{len(lines.header)} cells as in the header", f"a line of {len(row)} cells")
        try:
            values[i] = parse(row[column])
        except (ValueError, IndexError):
            found = repr(row[column]) if column < len(row) else f"a line of {len(row)} cells"
            _refuse_line(path, f"{line}, {header}", expected, found)
    return values


def _time(text: str) -> float:
    match = _TIME.fullmatch(text.replace("/", "-"))
    if not match:
        raise ValueError(text)
    date, sign, hours, minutes = match.groups(default="0")
    ahead_s = (60 * int(hours) + int(minutes)) * (-60.0 if sign == "-" else 60.0)  # +02:00: local time is ahead of UTC
    return float(np.datetime64(date.replace(" ", "T"), "us").astype(np.int64)) / 1e6 - ahead_s


def _number(text: str) -> float:
    if text.lower() in MISSING_TEXT:
        return float("nan")
    if not (_NUMBER.fullmatch(text) and abs(value := float(text)) < LARGEST):
        raise ValueError(text)
    return value


def _refuse_line(path: Path, line: int | str, expected: str, found: str) -> None:
    raise InputError(f"{path}: line {line}", expected=expected, found=found, advice="mend or remove the line") from None


def _is_cut(last: list[str], others: list[list[str]], header: list[str]) -> bool:
    """Return whether a last line without its end lacks cells, or its last cell decimals that all others have."""
    if len(last) < len(header) or not others:
        return len(last) < len(header)
    return _decimals(last[-1]) < min((_decimals(row[-1]) for row in others if row[-1]), default=0)


def _decimals(cell: str) -> int:
    return len(cell.partition(".")[2])
