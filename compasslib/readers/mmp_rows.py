"""Rows of numbers out of the text files of a profiler's unpacker, each checked character by character.

A row is a stamp (MM-DD-YYYY HH:MM:SS, or with slashes) and numbers, or numbers alone, between spaces or commas. All
rows of a file have one form: the same count of numbers and, column by column, the same decimals. Whatever differs is
damaged and left out: a flipped or lost character nearly always shows in one of the two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.readers.mmp_clock import Bools, Ints, civil
from compasslib.records import Floats

Octets = NDArray[np.uint8]
Form = tuple[bool, int]  # with a stamp; how many numbers

CHUNK_BYTES = 1 << 21  # larger ones leave the cache and are slower
# Share of the rows, of a few all but one, that agree on a column's decimals before the others count as damaged.
UNIFORM = 0.95

_SPACE, _DIGIT, _DOT, _SIGN, _COLON, _SLASH, _COMMA, _OTHER = (1 << bit for bit in range(8))
_KIND = np.full(256, _OTHER, dtype=np.uint8)
for _characters, _kind in (
    (b" \t\r\n", _SPACE), (b"0123456789", _DIGIT), (b".", _DOT), (b"+-", _SIGN), (b":", _COLON), (b"/", _SLASH),
    (b",", _COMMA | _SPACE),
):  # fmt: skip
    _KIND[list(_characters)] = _kind
_DATE, _TIME = (np.array(digits) for digits in ((0, 1, 3, 4, 6, 7, 8, 9), (0, 1, 3, 4, 6, 7)))


@dataclass(frozen=True, eq=False)
class Text:
    """What a text file holds, by where it begins in the file."""

    form: Form | None  # of the rows; None without any
    offset: Ints  # (r,) of each row
    time_s: Floats  # (r,) of its stamp, NaN without
    values: Floats  # (r, k)
    damaged: Ints  # offsets of lines of numbers that are no rows
    lines: tuple[tuple[int, bytes], ...]  # offset and words of the lines that are no numbers


@dataclass(frozen=True, eq=False)
class _Piece:
    offset: Ints
    time_s: Floats
    values: Floats
    texture: Ints  # (r, k + 1) decimals of every number, count of commas


def parse(data: bytes, wanted: Callable[[Form], bool]) -> Text:
    """Return rows, damaged lines and lines of words of a text file.

    Args:
        data: the file.
        wanted: which forms rows may have; the most frequent one of them in the file is the rows'.
    """
    form: Form | None = None
    pieces: list[_Piece] = []
    damaged: list[Ints] = []
    lines: list[tuple[int, bytes]] = []
    for start, octets in _chunks(data):
        kind = _KIND[octets]
        begins, ends, present = _lines(octets, kind)
        words = (present & _OTHER) != 0
        lines += [(start + b, octets[b:e].tobytes()) for b, e in zip(begins[words], ends[words], strict=True)]
        numeric = ~words & ((present & _DIGIT) != 0)
        stamped, tokens = ((present & _COLON) != 0)[numeric], _tokens(kind, begins, numeric)
        form = form or _form(stamped, tokens, wanted)
        fits = np.zeros(len(begins), dtype=bool)
        fits[numeric] = False if form is None else (stamped == form[0]) & (tokens == form[1] + 2 * stamped)
        lost = begins[numeric & ~fits]
        if form and fits.any():
            piece, bad = _piece(octets, form, begins[fits], ends[fits])
            pieces.append(replace(piece, offset=start + piece.offset))
            lost = np.append(lost, bad)
        damaged.append(start + lost)
    return _regular(form, pieces, damaged, lines)


def _chunks(data: bytes) -> Iterator[tuple[int, Octets]]:
    """Cut behind line ends; the last line gets an end where it has none."""
    begin = 0
    while begin < len(data):
        end = data.find(b"\n", begin + CHUNK_BYTES) + 1 or len(data)
        part = data[begin:end]
        yield begin, np.frombuffer(part if part.endswith(b"\n") else part + b"\n", dtype=np.uint8)
        begin = end


def _lines(octets: Octets, kind: Octets) -> tuple[Ints, Ints, Octets]:
    ends = np.flatnonzero(octets == ord("\n")) + 1
    begins = np.append(0, ends[:-1])
    return begins, ends, np.bitwise_or.reduceat(kind, begins)


def _tokens(kind: Octets, begins: Ints, numeric: Bools) -> Ints:
    """Count the words of every line of numbers."""
    solid = (kind & _SPACE) == 0
    starts = solid & np.append(True, ~solid[:-1])
    return np.add.reduceat(starts, begins, dtype=np.int64)[numeric]


def _form(stamped: Bools, tokens: Ints, wanted: Callable[[Form], bool]) -> Form | None:
    code, times = np.unique(2 * (tokens - 2 * stamped) + stamped, return_counts=True)
    forms = {(bool(c & 1), int(c >> 1)): int(n) for c, n in zip(code, times, strict=True)}
    allowed = {form: n for form, n in forms.items() if form[1] > 0 and wanted(form)}
    return max(allowed, key=lambda form: allowed[form]) if allowed else None


def _piece(octets: Octets, form: Form, begins: Ints, ends: Ints) -> tuple[_Piece, Ints]:
    """Return the rows among lines of the right count of words, and where the others begin."""
    own = _marked(len(octets), begins, ends)
    octets = octets[own]
    size = ends - begins
    rows = _Rows(octets, np.cumsum(size) - size, form)
    time_s, stamp_good = rows.stamps()
    good = rows.number_good() & stamp_good
    if form[0]:
        octets[_marked(len(octets), rows.begin[:, 0], rows.end[:, 1])] = ord(" ")
    octets[np.repeat(~good, size)] = ord(" ")
    octets[octets == ord(",")] = ord(" ")
    # Of nothing but spaces fromstring makes a number.
    numbers = np.fromstring(octets.tobytes(), sep=" ") if good.any() else np.zeros(0)
    piece = _Piece(begins[good], time_s[good], numbers.reshape(-1, form[1]), rows.texture()[good])
    return piece, begins[~good]


def _marked(length: int, begins: Ints, ends: Ints) -> Bools:
    """Return a mask of stretches that do not overlap."""
    step = np.zeros(length + 1, dtype=np.int8)
    step[begins] += 1
    step[ends] -= 1
    return np.cumsum(step[:-1], dtype=np.int8).astype(bool)


class _Rows:
    """Lines of the same count of words, taken apart: where each word begins and ends, what stands in it."""

    def __init__(self, octets: Octets, lines: Ints, form: Form):
        self.octets, self.lines, self.form = octets, lines, form
        self.kind = _KIND[octets]
        solid = (self.kind & _SPACE) == 0
        starts = solid & np.append(True, ~solid[:-1])
        width = form[1] + 2 * form[0]
        self.begin = np.flatnonzero(starts).reshape(-1, width)
        self.end = (np.flatnonzero(solid & np.append(~solid[1:], True)) + 1).reshape(-1, width)
        self.word = np.cumsum(starts, dtype=np.int32) - 1
        self.numbers = np.s_[:, 2 * form[0] :]

    def number_good(self) -> Bools:
        """Return which lines hold nothing but numbers: a sign in front, one point at most, a digit at least."""
        signed = (self.kind[self.begin] & _SIGN) != 0
        points = self._count(_DOT)
        strange = self._count(_COLON | _SLASH | _SIGN) - signed
        digits = self.end - self.begin - signed - points
        return ((points <= 1) & (strange == 0) & (digits > 0))[self.numbers].all(axis=1)

    def texture(self) -> Ints:
        """Return the decimals of every number and the count of commas, line by line."""
        at = np.flatnonzero(self.kind & _DOT)
        decimals = np.full(self.begin.size, -1, dtype=np.int64)
        decimals[self.word[at]] = self.end.ravel()[self.word[at]] - 1 - at
        commas = np.searchsorted(np.flatnonzero(self.kind & _COMMA), np.append(self.lines, len(self.kind)))
        return np.column_stack([decimals.reshape(self.begin.shape)[self.numbers], np.diff(commas)])

    def stamps(self) -> tuple[Floats, Bools]:
        """Return UTC seconds since 1970, NaN without a stamp, and which lines are right in this respect."""
        if not self.form[0]:
            return np.full(len(self.begin), np.nan), np.ones(len(self.begin), dtype=bool)
        date, clock = self._characters(0, 10), self._characters(1, 8)
        sized = (self.end - self.begin)[:, :2] == (10, 8)
        marks = np.isin(date[:, (2, 5)], (ord("-"), ord("/"))) & (clock[:, (2, 5)] == ord(":"))
        digits = np.column_stack([date[:, _DATE], clock[:, _TIME]]).astype(np.int64) - ord("0")
        good = (sized & marks).all(axis=1) & ((digits >= 0) & (digits <= 9)).all(axis=1)
        pairs = 10 * digits[:, 0::2] + digits[:, 1::2]
        month, day, century, year, *hms = pairs.T
        time_s = civil((100 * century + year, month, day), (hms[0], hms[1], hms[2]))
        return time_s, good & np.isfinite(time_s)

    def _characters(self, column: int, count: int) -> Octets:
        at = self.begin[:, column, None] + np.arange(count)
        return self.octets[np.minimum(at, len(self.octets) - 1)]

    def _count(self, kinds: int) -> Ints:
        words = self.word[np.flatnonzero(self.kind & kinds)]
        return np.bincount(words, minlength=self.begin.size).reshape(self.begin.shape)


def _regular(form: Form | None, pieces: list[_Piece], damaged: list[Ints], lines: list[tuple[int, bytes]]) -> Text:
    """Put the pieces together and leave out rows that differ from the others in their texture."""
    lost = np.concatenate([np.zeros(0, dtype=np.int64), *damaged])
    if form is None or not any(len(piece.offset) for piece in pieces):
        nothing = np.zeros(0)
        return Text(None, nothing.astype(np.int64), nothing, nothing.reshape(0, 0), np.sort(lost), tuple(lines))
    texture = np.concatenate([piece.texture for piece in pieces])
    usual = np.array([_most_frequent(column) for column in texture.T])
    same = texture == usual
    uniform = (~same).sum(axis=0) <= max(1.0, (1.0 - UNIFORM) * len(same))
    like = same[:, uniform].all(axis=1)
    offset, time_s, values = (np.concatenate([getattr(p, k) for p in pieces]) for k in ("offset", "time_s", "values"))
    lost = np.sort(np.append(lost, offset[~like]))
    return Text(form, offset[like], time_s[like], values[like], lost, tuple(lines))


def _most_frequent(values: Ints) -> int:
    distinct, times = np.unique(values, return_counts=True)
    return int(distinct[np.argmax(times)])
