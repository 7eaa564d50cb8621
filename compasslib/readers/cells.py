"""Find the cells of a text table by their bytes, and parse columns of numbers with vectorized operations."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

TENS = 10.0 ** np.arange(19)  # exact, so quotients are the nearest floats, as by float()
LARGEST = 1e30  # above any measurement in any unit; its square is still finite
MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
BLANKS = b" \t"
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

    def __len__(self) -> int:
        return len(self.begin)

    def __getitem__(self, rows: Any) -> Column:
        return Column(self.source, self.begin[rows], self.end[rows])

    def __iter__(self) -> Iterator[str]:
        for begin, end in zip(self.begin.tolist(), self.end.tolist(), strict=True):
            yield self.source[begin:end].decode(errors="replace")

    def text(self, row: int) -> str:
        """Decode one cell."""
        return next(iter(self[row : row + 1]))

    def strip(self, marks: bytes) -> Column:
        """Leave out certain characters before and after the content of each cell."""
        is_mark, data, begin, end = np.zeros(256, dtype=bool), self.data, self.begin, self.end
        is_mark[list(marks)] = True
        while len(self) and (more := is_mark[data[begin]] & (begin < end)).any():
            begin = begin + more
        while len(self) and (more := is_mark[data[end - 1]] & (begin < end)).any():
            end = end - more
        return Column(self.source, begin, end)

    def characters(self) -> Bytes:
        """Copy the bytes of the cells, (longest, rows), with zeros behind the shorter ones."""
        length = self.end - self.begin
        taken = take_bytes(self.data, self.begin, int(np.max(length, initial=1)))
        taken[np.arange(len(taken))[:, None] >= length] = 0
        return taken

    def joined(self, other: Column) -> Column:
        """Join the cells of two columns by a blank."""
        parts = [self.characters(), np.full((1, len(self)), BLANK, np.uint8), other.characters()]
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
    lines: Column
    number: Places  # (rows,) of the lines, from 0 for the first one that was split
    width: Places  # (rows,) number of cells

    def __getitem__(self, rows: Any) -> Rows:
        columns = {k: column[rows] for k, column in self.columns.items()}
        return Rows(columns, self.lines[rows], self.number[rows], self.width[rows])


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
    first, behind, width = np.concatenate(lines, axis=1)
    return Rows(columns, Column(source, first, behind), np.arange(len(width)), width)


def parse_numbers(
    column: Column, decimal: str | None, missing: Sequence[str], size: int = 2**15
) -> tuple[Floats, Bytes]:
    """Parse cells as numbers to the nearest floats, and get the decimal mark of each, zero without one; (n,) each.

    Numbers are NaN where the text stands for a missing one, and infinite where it is no number.

    Args:
        decimal: mark; None accepts points and commas.
        missing: texts that stand for missing values, besides the usual ones.
    """
    values, marks = np.empty(len(column)), np.zeros(len(column), np.uint8)
    words = MISSING_TEXT | {text.lower() for text in missing}
    for begin in range(0, len(column), size):
        here = slice(begin, begin + size)
        part = column[here]
        values[here], plain, marks[here] = parse_figures(part.data, part.begin, part.end, decimal or ".,")
        odd = np.flatnonzero(~plain)
        texts = [*part[odd]]
        known = {text: _parse_odd(text, decimal or ".,", words) for text in {*texts}}
        for k, text in zip(begin + odd, texts, strict=True):
            values[k], marks[k] = known[text]
    for text in (text.replace(",", ".") for text in missing):
        if NUMBER.fullmatch(text):
            values[values == float(text)] = np.nan
    return values, marks


def _parse_odd(text: str, decimals: str, words: frozenset[str]) -> tuple[float, int]:
    """Parse a number with an exponent or many digits, or a text for a missing value, and get its decimal mark."""
    if text.lower() in words:
        return np.nan, 0
    mark = next((mark for mark in decimals if mark in text), "")
    number = text.replace(",", ".") if mark == "," else text
    if not NUMBER.fullmatch(number) or ("." in text and "." not in decimals) or abs(float(number)) >= LARGEST:
        return np.inf, 0
    return float(number), ord(mark or "\0")


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
        mantissa = np.where(counts, 10.0 * mantissa + figure, mantissa)
        figures += counts
        decimals += counts & (mark > 0)
        plain &= ~inside | counts | (parts & (mark == 0))
        mark = np.where(parts, byte, mark)
    plain &= (figures > 0) & (figures <= np.finfo(float).precision)
    values = mantissa / TENS[decimals]
    return np.where(negative, -values, values), plain, np.where(plain, mark, np.uint8(0))
