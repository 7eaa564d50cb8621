"""Parse rows of plain cells with vectorized operations: decimal numbers and ISO times of constant width.

Everything else, including damage, is left to ``delimited``, which parses line by line and reports errors.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

TENS = 10.0 ** np.arange(19)  # exact, so quotients are the nearest floats, as by float()
LARGEST = 1e30  # above any measurement in any unit; its square is still finite
MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_PLAIN = re.compile(r"[0-9eE+\-.\n]*")
NEWLINE, BLANK, PLUS, MINUS, POINT, ZERO = b"\n +-.0"

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]


def parse_texts(cells: list[str], decimal: str, missing: Sequence[str]) -> tuple[Floats, int | None]:
    """Parse cells as numbers, (n,), NaN where missing; also give the first row that is neither, None without one."""
    points = [cell.replace(",", ".") if "." not in cell else f"{cell}?" for cell in cells] if decimal == "," else cells
    words = MISSING_TEXT | {text.lower() for text in missing}
    try:
        if not _PLAIN.fullmatch("\n".join(points)):
            raise ValueError
        values = np.fromiter(map(float, points), dtype=float, count=len(points))
        valid = bool((np.abs(values) < LARGEST).all())
    except ValueError:
        valid = False
    if not valid:
        values = np.full(len(cells), np.nan)
        for row, (cell, text) in enumerate(zip(cells, points, strict=True)):
            if cell.lower() in words:
                continue
            if not (NUMBER.fullmatch(text) and abs(value := float(text)) < LARGEST):
                return values, row
            values[row] = value
    return without_missing(values, missing), None


def without_missing(values: Floats, missing: Sequence[str]) -> Floats:
    """Set numbers that stand for missing values to NaN, in place."""
    for text in (text.replace(",", ".") for text in missing):
        values[values == float(text) if NUMBER.fullmatch(text) else np.isnan(values)] = np.nan
    return values


@dataclass(frozen=True)
class Cells:
    """Cells of a block of lines, as (lines, cells) offsets of the first byte and of the byte after each cell."""

    data: Bytes
    first: Places
    behind: Places

    def texts(self, rows: Places, column: int) -> list[str]:
        """List the texts of selected cells of a column, stripped of surrounding blanks."""
        raw = self.data.tobytes()
        ends = zip(self.first[rows, column].tolist(), self.behind[rows, column].tolist(), strict=True)
        return [raw[first:behind].decode("ascii").strip() for first, behind in ends]


def split_cells(data: bytes, begin: int, delimiter: str, count: int, size: int = 2**20) -> Iterator[Cells | None]:
    """Split lines without quotation marks into ``count`` cells, by blocks that fit into the processor's cache.

    Yield None and stop at a line with another number of cells. The last line must end with a line feed.
    """
    while begin < len(data):
        end = data.rfind(b"\n", begin, begin + size) + 1 or data.find(b"\n", begin) + 1
        block = np.frombuffer(data, np.uint8, end - begin, begin)
        ends = np.flatnonzero((block == NEWLINE) | (block == ord(delimiter)))
        if len(ends) % count or not (np.flatnonzero(block[ends] == NEWLINE) % count == count - 1).all():
            yield None
            return
        behind = ends.reshape(-1, count)
        if not (block[behind[:, -1]] == NEWLINE).all():
            yield None
            return
        yield Cells(block, np.concatenate([[0], ends[:-1] + 1]).reshape(-1, count), behind)
        begin = end


def parse_numbers(cells: Cells, column: int, other: Callable[[list[str]], Floats | None]) -> Floats | None:
    """Parse a column of numbers exactly, with ``other`` for cells that are not plain; None if it fails for any."""
    first, behind = cells.first[:, column], cells.behind[:, column]
    while (blank := (cells.data[first] == BLANK) & (first < behind)).any():
        first = first + blank
    values, plain = parse_figures(cells.data, first, behind)
    if not plain.all():
        rows = np.flatnonzero(~plain)
        if (parsed := other(cells.texts(rows, column))) is None:
            return None
        values[rows] = parsed
    return values


def parse_figures(data: Bytes, first: Places, behind: Places) -> tuple[Floats, Bools]:
    """Parse numbers of at most 15 digits, a decimal point and a sign to the nearest floats, (n,), and flag valid ones.

    The byte after each number must be inside the data.
    """
    sign = data[first]
    negative = sign == MINUS
    first = first + (negative | (sign == PLUS))
    length, longest = behind - first, len(TENS) - 1
    mantissa, figures, decimals = (np.zeros(len(first), np.int64) for _ in range(3))
    pointed, plain = np.zeros(len(first), bool), length <= longest
    for k in range(int(min(np.max(length, initial=0), longest))):
        inside = length > k
        byte = data[np.minimum(first + k, behind)]
        figure = byte - np.uint8(ZERO)
        counts, point = inside & (figure < 10), inside & (byte == POINT)
        mantissa = np.where(counts, mantissa * 10 + figure, mantissa)
        figures += counts
        decimals += counts & pointed
        plain &= ~inside | counts | (point & ~pointed)
        pointed |= point
    plain &= (figures > 0) & (figures <= np.finfo(float).precision)
    values = mantissa / TENS[decimals]
    values[negative] *= -1.0
    return values, plain


def parse_iso(cells: Cells, column: int, like: str) -> Floats | None:
    """Parse a column of times with the same format as ``like`` to UTC seconds since 1970; None if one differs."""
    first, width = cells.first[:, column], len(like)
    if (cells.behind[:, column] - first != width).any():
        return None
    characters = cells.data[first[:, None] + np.arange(width)]
    form = np.frombuffer(like.encode("ascii"), np.uint8)
    figure = (form >= ZERO) & (form < ZERO + 10)
    if (characters[:, ~figure] != form[~figure]).any() or (characters[:, figure] - np.uint8(ZERO) > 9).any():
        return None
    texts = np.ascontiguousarray(characters[:, : len(like.rstrip("Z"))])
    try:
        dates = texts.view(f"S{texts.shape[1]}")[:, 0].astype("datetime64[us]")
    except ValueError:
        return None
    return dates.astype(np.int64) / 1e6
