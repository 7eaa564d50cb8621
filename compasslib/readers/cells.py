"""Find the cells of a text table by their bytes, and parse columns of numbers and texts with vectorized operations."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

TENS = 10.0 ** np.arange(19)  # exact, so quotients are the nearest floats, as by float()
LARGEST = 1e30  # above any measurement in any unit; its square is still finite
MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
WITH_COMMA = re.compile(r"[-+]?\d*,\d+(?:[eE][-+]?\d+)?", re.ASCII)
ONLY_THOUSANDS = re.compile(r"[-+]?[1-9]\d{0,2}(?:,\d{3})+", re.ASCII)
BLANKS = b" \t"
_PLAIN = re.compile(r"[0-9eE+\-.\n]*")
NEWLINE, BLANK, PLUS, MINUS, ZERO = b"\n +-0"

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]


@dataclass(frozen=True)
class Column:
    """Cells of one column, as (rows,) offsets of the first byte and of the byte after each cell."""

    source: bytes
    begin: Places
    end: Places

    @property
    def data(self) -> Bytes:
        """The bytes in which the cells lie."""
        return np.frombuffer(self.source, np.uint8)

    def __getitem__(self, rows: Any) -> Column:
        return Column(self.source, self.begin[rows], self.end[rows])

    def strip(self, marks: bytes) -> Column:
        """Leave out certain characters before and after the content of each cell."""
        is_mark, data, begin, end = np.zeros(256, dtype=bool), self.data, self.begin, self.end
        is_mark[list(marks)] = True
        while len(begin) and (more := is_mark[data[begin]] & (begin < end)).any():
            begin = begin + more
        while len(end) and (more := is_mark[data[end - 1]] & (begin < end)).any():
            end = end - more
        return Column(self.source, begin, end)

    def texts(self) -> list[str]:
        """Decode the cells."""
        source = self.source
        pairs = zip(self.begin.tolist(), self.end.tolist(), strict=True)
        return [source[begin:end].decode(errors="replace") for begin, end in pairs]

    def characters(self) -> Bytes:
        """Copy the bytes of the cells, (longest, rows), with zeros behind the shorter ones."""
        length = self.end - self.begin
        taken = take_bytes(self.data, self.begin, int(np.max(length, initial=1)))
        taken[np.arange(len(taken))[:, None] >= length] = 0
        return taken

    def joined(self, other: Column) -> Column:
        """Join the cells of two columns by a blank."""
        parts = [self.characters(), np.full((1, len(self.begin)), BLANK, np.uint8), other.characters()]
        together = np.concatenate(parts).T
        ends = np.cumsum((together > 0).sum(axis=1))
        return Column(together[together > 0].tobytes() + b"\n", np.append(0, ends[:-1])[: len(ends)], ends)


def take_bytes(data: Bytes, begin: Places, width: int) -> Bytes:
    """Copy some bytes from each of several offsets on, (width, offsets), zeros behind the end of the data."""
    if len(begin) and begin.max() + width > len(data):
        data = np.append(data, np.zeros(width, np.uint8))
    return np.ascontiguousarray(np.lib.stride_tricks.sliding_window_view(data, width)[begin].T)


@dataclass(frozen=True)
class Rows:
    """Lines of a table that hold cells."""

    columns: Mapping[int, Column]  # the requested ones by index; empty cells where a line has fewer
    line: Places  # (rows,) index of the line, from the first one that was split
    begin: Places  # (rows,) byte offsets of the lines
    end: Places
    width: Places  # (rows,) number of cells

    def __getitem__(self, rows: Any) -> Rows:
        columns = {k: column[rows] for k, column in self.columns.items()}
        return Rows(columns, *(each[rows] for each in (self.line, self.begin, self.end, self.width)))


def split_rows(source: bytes, begin: int, delimiter: str, wanted: Sequence[int], size: int = 2**20) -> Rows:
    """Split the lines from an offset on into cells, by blocks that fit into the processor's cache.

    Args:
        source: lines that all end with a line feed.
        delimiter: character between cells; a blank stands for any number of blanks and tabs.
        wanted: indices of the columns to locate.
    """
    places: dict[int, list[Places]] = {k: [np.zeros((2, 0), np.int64)] for k in wanted}
    lines = [np.zeros((3, 0), np.int64)]
    while begin < len(source):
        stop = source.rfind(b"\n", begin, begin + size) + 1 or source.find(b"\n", begin) + 1
        block = np.frombuffer(source, np.uint8, stop - begin, begin)
        if delimiter == " ":
            solid = (block != BLANK) & (block != NEWLINE) & (block != BLANKS[1])
            first = np.flatnonzero(solid & np.append(True, ~solid[:-1]))
            behind = np.flatnonzero(solid & np.append(~solid[1:], True)) + 1
            ends = np.flatnonzero(block == NEWLINE)
            last = np.searchsorted(first, ends)
        else:
            behind = np.flatnonzero((block == NEWLINE) | (block == ord(delimiter)))
            first = np.append(0, behind[:-1] + 1)
            last = np.flatnonzero(block[behind] == NEWLINE) + 1
            ends = behind[last - 1]
        from_cell = np.append(0, last[:-1])
        width = last - from_cell
        for k, located in places.items():
            cell, there = np.minimum(from_cell + k, max(len(first) - 1, 0)), width > k
            at = (np.where(there, edge[cell], ends) if len(edge) else ends for edge in (first, behind))
            located.append(begin + np.stack([*at]))
        lines.append(np.stack([begin + np.append(0, ends[:-1] + 1), begin + ends, width]))
        begin = stop
    columns = {k: Column(source, *np.concatenate(located, axis=1)) for k, located in places.items()}
    each = np.concatenate(lines, axis=1)
    return Rows(columns, np.arange(each.shape[1]), *each)


@dataclass(frozen=True)
class Numbers:
    """Numbers of a column, and the rows that decide on the decimal mark."""

    values: Floats  # (rows,) NaN where missing
    wrong: int | None  # first row that holds neither a number nor a text for a missing one
    point: int | None  # first row with a decimal point
    comma: int | None  # first row with a comma
    thousands: bool  # whether every comma may stand between thousands


def parse_numbers(column: Column, decimal: str | None, missing: Sequence[str], size: int = 2**15) -> Numbers:
    """Parse cells as numbers to the nearest floats.

    Args:
        column: cells without surrounding blanks.
        decimal: decimal mark; None accepts points and commas.
        missing: texts that stand for missing values, besides the usual ones.
    """
    values, marks = np.empty(len(column.begin)), np.zeros(len(column.begin), np.uint8)
    wrong, thousands = None, True
    words = MISSING_TEXT | {text.lower() for text in missing}
    for begin in range(0, len(values), size):
        part = column[begin : begin + size]
        values[begin : begin + size], good, mark = parse_figures(part.data, part.begin, part.end, decimal or ".,")
        odd = np.flatnonzero(~good)
        texts = part[odd].texts()
        values[begin + odd], failed = _parse_odd(texts, decimal or ".,", words)
        wrong = begin + int(odd[failed]) if failed is not None and wrong is None else wrong
        if decimal is None:
            with_comma = [bool(WITH_COMMA.fullmatch(text) or ONLY_THOUSANDS.fullmatch(text)) for text in texts]
            mark[odd] = np.where(with_comma, ord(","), 0)
            cells = part[mark == ord(",")].texts() if thousands and (mark == ord(",")).any() else ()
            thousands = thousands and all(map(ONLY_THOUSANDS.fullmatch, cells))
        marks[begin : begin + size] = mark
    for text in (text.replace(",", ".") for text in missing):
        values[values == float(text) if NUMBER.fullmatch(text) else np.isnan(values)] = np.nan
    point, comma = ((int(np.argmax(located)) if (located := marks == ord(each)).any() else None) for each in ".,")
    return Numbers(values, wrong, point, comma, thousands)


def _parse_odd(cells: list[str], marks: str, words: frozenset[str]) -> tuple[Floats, int | None]:
    """Parse numbers with an exponent or many digits, and texts for missing values; find the first that is neither."""
    if "," in marks:
        cells = [cell.replace(",", ".") if "." not in cell else cell + "?" * (marks == ",") for cell in cells]
    try:
        values = np.array([*map(float, cells)] if _PLAIN.fullmatch("\n".join(cells)) else None, dtype=float)
    except ValueError:
        values = np.array(None, dtype=float)
    if not values.ndim:
        of_text = {text: np.nan if text.lower() in words else np.inf for text in dict.fromkeys(cells)}
        of_text |= {text: float(text) for text, value in of_text.items() if value > 0.0 and NUMBER.fullmatch(text)}
        values = np.fromiter(map(of_text.__getitem__, cells), dtype=float, count=len(cells))
    failed = np.flatnonzero(np.abs(values) >= LARGEST)
    return values, int(failed[0]) if failed.size else None


def parse_figures(data: Bytes, first: Places, behind: Places, marks: str = ".") -> tuple[Floats, Bools, Bytes]:
    """Parse numbers of at most 15 digits, a decimal mark and a sign to the nearest floats, (n,).

    Also flag the numbers that are valid, and give the decimal mark of each, zero without one. The byte after each
    number must be inside the data.
    """
    sign = data[first]
    negative = sign == MINUS
    first = first + ((negative | (sign == PLUS)) & (first < behind))
    length, longest = np.minimum(behind - first, 255).astype(np.uint8), len(TENS) - 1
    width = int(min(np.max(length, initial=0), longest))
    mantissa, (figures, decimals, mark) = np.zeros(len(first)), np.zeros((3, len(first)), np.uint8)
    plain = length <= longest
    for k, byte in enumerate(take_bytes(data, first, max(width, 1))[:width]):
        inside, figure = length > k, byte - np.uint8(ZERO)
        counts, parts = inside & (figure < 10), inside & (byte == ord(marks[0]))
        if len(marks) > 1:
            parts |= inside & (byte == ord(marks[1]))
        np.multiply(mantissa, 10.0, out=mantissa, where=counts)
        np.add(mantissa, figure, out=mantissa, where=counts)
        figures += counts
        decimals += counts & (mark > 0)
        plain &= ~inside | counts | (parts & (mark == 0))
        mark = np.where(parts, byte, mark)
    plain &= (figures > 0) & (figures <= np.finfo(float).precision)
    values = mantissa / TENS[decimals]
    np.negative(values, out=values, where=negative)
    return values, plain, np.where(plain, mark, np.uint8(0))
