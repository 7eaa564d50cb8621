"""Parse rows and profiles in the text files of a profiler's unpacker, checking each row character by character.

A row is a time stamp (MM-DD-YYYY HH:MM:SS, or with slashes) and numbers, or numbers only, separated by spaces or
commas. All rows of a file have the same number of columns and, in each column, the same number of decimals. Others are
dropped as damaged: a flipped or lost character nearly always changes one of the two.

A, C and E files (current meter, CTD, engineering) frame the rows of a profile alike: ``Profile N`` before and after,
the switch-on and switch-off times before or after, the column names, and in A files the sample rate before and the
instrument's header after. An exception replaces the tail; files may also lack all header lines.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.readers.cells import parse_figures
from compasslib.readers.files import CHUNK_BYTES
from compasslib.readers.times import civil_seconds
from compasslib.types import Bools, Floats

Ints = NDArray[np.int64]
Octets = NDArray[np.uint8]
Form = tuple[bool, int]  # whether rows have a time stamp; number of other columns
_SPACE, _DIGIT, _DOT, _SIGN, _COLON, _SLASH, _COMMA, _OTHER = (1 << bit for bit in range(8))
_KIND = np.full(256, _OTHER, dtype=np.uint8)
for _characters, _kind in (
    (b" \t\r\n", _SPACE), (b"0123456789", _DIGIT), (b".", _DOT), (b"+-", _SIGN), (b":", _COLON), (b"/", _SLASH),
    (b",", _COMMA | _SPACE),
):  # fmt: skip
    _KIND[list(_characters)] = _kind
_DATE, _TIME = (np.array(digits) for digits in ((0, 1, 3, 4, 6, 7, 8, 9), (0, 1, 3, 4, 6, 7)))
UNKNOWN = -1  # profile number if it is not stated
_WORDS = re.compile(
    rb"""[ \t,]*(?:(?P<rate>sample\ rate:\s*(?P<hertz>[\d.]+))
    | (?P<profile>profile\s+(?P<number>\d+)\s*$)
    | (?P<on>.*?turned\ on\ at\s+(?P<on_at>[\d/ :]+))
    | (?P<off>.*?(?:turned\ off|logging\ stopped)\ at\s+(?P<off_at>[\d/ :]+))
    | (?P<contents>.*header\ contents)
    | (?P<names>mm-dd-yyyy|date\b|mmho|hdng|tx\b)
    | (?P<other>exception|end\ of\ file|ramp\ exit|profile\ exit|vehicle))""",
    re.IGNORECASE | re.VERBOSE,
)
_NUMBER_IN_NAME = re.compile(r"(\d{3,7})(?:\.dec)?(?:\.\w+)?$", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class Text:
    """Parsed lines of a text file, with their byte offsets in the file."""

    form: Form | None  # of the rows; None without any
    offset: Ints  # (r,) byte offset of each row
    time_s: Floats  # (r,) time stamp, UTC seconds since 1970, NaN without one
    values: Floats  # (r, k)
    damaged: Ints  # offsets of numeric lines that are not valid rows
    lines: tuple[tuple[int, bytes], ...]  # offset and content of lines that are not numeric
    foreign: int = 0  # damaged lines whose number of columns one lost or added character does not explain


@dataclass(frozen=True, eq=False)
class _RowChunk:
    offset: Ints
    time_s: Floats
    values: Floats
    texture: Ints  # (r, k + 1) number of decimals in each column, number of commas


class _Rows:
    """Lines with the same number of words, tokenized into the begin, end and characters of each word."""

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
        """Flag lines of valid numbers: an optional leading sign, at most one decimal point, at least one digit."""
        signed = (self.kind[self.begin] & _SIGN) != 0
        points = self._count(_DOT)
        strange = self._count(_COLON | _SLASH | _SIGN) - signed
        digits = self.end - self.begin - signed - points
        return ((points <= 1) & (strange == 0) & (digits > 0))[self.numbers].all(axis=1)

    def texture(self) -> Ints:
        """Count the decimals of each number and the commas in each line, (r, k + 1); -1 without a decimal point."""
        at = np.flatnonzero(self.kind & _DOT)
        decimals = np.full(self.begin.size, -1, dtype=np.int64)
        decimals[self.word[at]] = self.end.ravel()[self.word[at]] - 1 - at
        commas = np.searchsorted(np.flatnonzero(self.kind & _COMMA), np.append(self.lines, len(self.kind)))
        return np.column_stack([decimals.reshape(self.begin.shape)[self.numbers], np.diff(commas)])

    def stamps(self) -> tuple[Floats, Bools]:
        """Parse time stamps to UTC seconds since 1970, NaN without one, and flag lines with a valid stamp or none."""
        if not self.form[0]:
            return np.full(len(self.begin), np.nan), np.ones(len(self.begin), dtype=bool)
        date, clock = self._characters(0, 10), self._characters(1, 8)
        sized = (self.end - self.begin)[:, :2] == (10, 8)
        marks = np.isin(date[:, (2, 5)], (ord("-"), ord("/"))) & (clock[:, (2, 5)] == ord(":"))
        digits = np.column_stack([date[:, _DATE], clock[:, _TIME]]).astype(np.int64) - ord("0")
        good = (sized & marks).all(axis=1) & ((digits >= 0) & (digits <= 9)).all(axis=1)
        pairs = 10 * digits[:, 0::2] + digits[:, 1::2]
        month, day, century, year, *hms = pairs.T
        time_s = civil_seconds(100 * century + year, month, day, *hms)
        return time_s, good & np.isfinite(time_s)

    def _characters(self, column: int, count: int) -> Octets:
        at = self.begin[:, column, None] + np.arange(count)
        return self.octets[np.minimum(at, len(self.octets) - 1)]

    def _count(self, kinds: int) -> Ints:
        words = self.word[np.flatnonzero(self.kind & kinds)]
        return np.bincount(words, minlength=self.begin.size).reshape(self.begin.shape)


@dataclass(frozen=True)
class ProfileBlock:
    """Range of rows, sample rate and switching times of one profile."""

    begin: int  # index of the first row in the file
    end: int  # index after the last row
    number: int = UNKNOWN
    rate_hz: float = np.nan
    on_s: float = np.nan  # UTC seconds since 1970
    off_s: float = np.nan


@dataclass(frozen=True)
class _Statement:
    """A recognized header line, its value and its byte offset in the file."""

    kind: str
    value: float = np.nan
    offset: int = 0


def parse(data: bytes, wanted: Callable[[Form], bool], chunk: int = CHUNK_BYTES) -> Text:
    """Parse the rows of the most frequent accepted form, damaged lines, and non-numeric lines of a text file."""
    form: Form | None = None
    pieces: list[_RowChunk] = []
    damaged: list[Ints] = []
    lines: list[tuple[int, bytes]] = []
    foreign = 0
    for start, octets in _chunks(data, chunk):
        kind = _KIND[octets]
        ends = np.flatnonzero(octets == ord("\n")) + 1
        begins = np.append(0, ends[:-1])
        present = np.bitwise_or.reduceat(kind, begins)
        words = (present & _OTHER) != 0
        lines += [(start + b, octets[b:e].tobytes()) for b, e in zip(begins[words], ends[words], strict=True)]
        numeric = ~words & ((present & _DIGIT) != 0)
        solid = (kind & _SPACE) == 0
        starts = solid & np.append(True, ~solid[:-1])
        stamped, tokens = ((present & _COLON) != 0)[numeric], np.add.reduceat(starts, begins, dtype=np.int64)[numeric]
        form = form or _form(stamped, tokens, wanted)
        fits = np.zeros(len(begins), dtype=bool)
        fits[numeric] = False if form is None else (stamped == form[0]) & (tokens == form[1] + 2 * stamped)
        lost = begins[numeric & ~fits]
        foreign += int(np.sum(np.abs(tokens - form[1] - 2 * form[0]) > 1)) if form else 0
        if form and fits.any():
            piece, bad = _row_chunk(octets, form, begins[fits], ends[fits])
            pieces.append(replace(piece, offset=start + piece.offset))
            lost = np.append(lost, bad)
        damaged.append(start + lost)
    return replace(_regular(form, pieces, damaged, lines), foreign=foreign)


def parse_profiles(text: Text, path: Path) -> tuple[list[ProfileBlock], Ints, int]:
    """Divide rows into profiles, index each row in its profile (damaged rows included), and count the damaged rows."""
    stated, garbled = statements(text)
    damaged = np.sort(np.append(text.damaged, np.array(garbled, dtype=np.int64)))
    ends = [statement for statement in stated if statement.kind != "other"]
    before = np.searchsorted([statement.offset for statement in ends], text.offset)
    begins = np.flatnonzero(np.append(True, np.diff(before) > 0)) if len(before) else np.zeros(0, dtype=int)
    marks = [0, *before[begins].tolist(), len(ends)]
    between = [ends[a:b] for a, b in pairwise(marks)]
    limits = [*begins.tolist(), len(before)]
    profiles: list[ProfileBlock] = []
    place = np.arange(len(text.offset)) + np.searchsorted(damaged, text.offset)
    for k, group in enumerate(pairwise(limits)):
        head, tail = _around(between, k)
        known = {statement.kind: statement.value for statement in [*reversed(tail), *head]}
        hertz, on, off = (known.get(kind, np.nan) for kind in ("rate", "on", "off"))
        number = int(known.get("profile", UNKNOWN))
        block = ProfileBlock(*group, number=number, rate_hz=hertz if hertz > 0 else np.nan, on_s=on, off_s=off)
        for piece in _pieces(block, text.time_s):
            introduced = between[k] and piece.begin == group[0]
            start = between[k][-1].offset if introduced else int(text.offset[piece.begin]) if piece.begin else 0
            place[piece.begin : piece.end] -= np.searchsorted(text.offset, start) + np.searchsorted(damaged, start)
            profiles.append(piece)
    if len(profiles) == 1 and profiles[0].number == UNKNOWN:
        profiles = [replace(profiles[0], number=number_in_name(path))]
    rate = np.nan
    for k, profile in enumerate(profiles):  # a rate applies until another is stated
        rate = profile.rate_hz if np.isfinite(profile.rate_hz) else rate
        profiles[k] = replace(profile, rate_hz=rate)
    return profiles, place, len(damaged)


def number_in_name(path: Path) -> int:
    """Parse the profile number that a file's name ends with, as in A0000012.TXT."""
    match = _NUMBER_IN_NAME.search(path.name)
    return int(match[1]) if match else UNKNOWN


def _chunks(data: bytes, size: int) -> Iterator[tuple[int, Octets]]:
    """Iterate over (offset, chunk) cut at line ends; an unterminated last line is terminated."""
    begin = 0
    while begin < len(data):
        end = data.find(b"\n", begin + size) + 1 or len(data)
        part = data[begin:end]
        yield begin, np.frombuffer(part if part.endswith(b"\n") else part + b"\n", dtype=np.uint8)
        begin = end


def _form(stamped: Bools, tokens: Ints, wanted: Callable[[Form], bool]) -> Form | None:
    code, times = np.unique(2 * (tokens - 2 * stamped) + stamped, return_counts=True)
    forms = {(bool(c & 1), int(c >> 1)): int(n) for c, n in zip(code, times, strict=True)}
    allowed = {form: n for form, n in forms.items() if form[1] > 0 and wanted(form)}
    return max(allowed, key=lambda form: allowed[form]) if allowed else None


def _row_chunk(octets: Octets, form: Form, begins: Ints, ends: Ints) -> tuple[_RowChunk, Ints]:
    """Parse the valid rows among lines with the right number of words; also give the offsets of the others."""
    inside = np.zeros(len(octets) + 1, dtype=np.int8)  # the rows do not overlap
    inside[begins] += 1
    inside[ends] -= 1
    octets = octets[np.cumsum(inside[:-1], dtype=np.int8).astype(bool)]
    size = ends - begins
    rows = _Rows(octets, np.cumsum(size) - size, form)
    time_s, stamp_good = rows.stamps()
    good = rows.number_good() & stamp_good
    begin, end = (places[good][rows.numbers].ravel() for places in (rows.begin, rows.end))
    numbers, plain, _ = parse_figures(octets, begin, end)
    for k in np.flatnonzero(~plain):  # more digits than the fast parser converts exactly
        numbers[k] = float(octets[begin[k] : end[k]].tobytes())
    piece = _RowChunk(begins[good], time_s[good], numbers.reshape(-1, form[1]), rows.texture()[good])
    return piece, begins[~good]


def _regular(
    form: Form | None, pieces: list[_RowChunk], damaged: list[Ints], lines: list[tuple[int, bytes]], alike: float = 0.95
) -> Text:
    """Concatenate the pieces and drop rows whose decimals or commas differ from those of a share ``alike`` of the rows.

    In short files, all but one must agree.
    """
    lost = np.concatenate([np.zeros(0, dtype=np.int64), *damaged])
    if form is None or not any(len(piece.offset) for piece in pieces):
        nothing = np.zeros(0)
        return Text(None, nothing.astype(np.int64), nothing, nothing.reshape(0, 0), np.sort(lost), tuple(lines))
    texture = np.concatenate([piece.texture for piece in pieces])
    usual = np.array([_most_frequent(column) for column in texture.T])
    same = texture == usual
    uniform = (~same).sum(axis=0) <= max(1.0, (1.0 - alike) * len(same))
    like = same[:, uniform].all(axis=1)
    offset, time_s, values = (np.concatenate([getattr(p, k) for p in pieces]) for k in ("offset", "time_s", "values"))
    lost = np.sort(np.append(lost, offset[~like]))
    return Text(form, offset[like], time_s[like], values[like], lost, tuple(lines))


def _most_frequent(values: Ints) -> int:
    distinct, times = np.unique(values, return_counts=True)
    return int(distinct[np.argmax(times)])


def statements(text: Text) -> tuple[list[_Statement], list[int]]:
    """Parse the header lines, and find damaged rows (many digits) among the other non-numeric lines."""
    found: list[_Statement] = []
    garbled: list[int] = []
    inside = False
    for offset, line in text.lines:
        statement = _statement(line)
        if statement:
            found.append(replace(statement, offset=offset))
            inside = statement.kind == "contents"
        elif not inside and sum(48 <= c < 58 for c in line) > len(line) // 4:
            garbled.append(offset)
    return found, garbled


@lru_cache(maxsize=1024)  # the same instrument header follows every profile
def _statement(line: bytes) -> _Statement | None:
    match = _WORDS.match(line)
    if not match:
        return None
    kind = match.lastgroup or ""
    for name, given in (("rate", "hertz"), ("profile", "number")):
        if match[name]:
            digits = match[given].decode()
            return _Statement(name, float(digits) if re.fullmatch(r"\d+\.?\d*|\.\d+", digits) else np.nan)
    for name in ("on", "off"):
        if match[name]:
            return _Statement(name, _stamp(match[f"{name}_at"]))
    return _Statement(kind)


def _stamp(words: bytes) -> float:
    match = re.match(rb"\s*(\d\d?)/(\d\d?)/(\d{4})\s+(\d\d?):(\d\d):(\d\d)", words)
    if not match:
        return float("nan")
    month, day, year, *clock = (np.array([int(part)]) for part in match.groups())
    return float(civil_seconds(year, month, day, *clock)[0])


def _pieces(block: ProfileBlock, time_s: Floats, pause_s: float = 60.0) -> list[ProfileBlock]:
    """Split a profile without a number at pauses of its clock, in either direction: its header lines may be missing."""
    if block.number != UNKNOWN:
        return [block]
    with np.errstate(invalid="ignore"):
        step = np.diff(time_s[block.begin : block.end])
        cuts = np.flatnonzero(np.abs(step) > pause_s) + 1 + block.begin
    limits = [block.begin, *cuts.tolist(), block.end]
    return [replace(block, begin=a, end=b) for a, b in pairwise(limits)]


def _around(between: Sequence[list[_Statement]], k: int) -> tuple[list[_Statement], list[_Statement]]:
    """Select the header lines before and after the k-th group of rows that belong to it."""
    times_first = any(statement.kind == "off" for statement in between[0])
    head = between[k][0 if k == 0 else _cut(between[k], times_first) :]
    tail = between[k + 1][: None if k + 2 == len(between) else _cut(between[k + 1], times_first)]
    return head, tail


def _cut(statements: Sequence[_Statement], times_first: bool) -> int:
    """Find the index at which the tail of a profile ends and the head of the next, perhaps with its times, begins."""
    kinds = [statement.kind for statement in statements]
    for first in ("rate", *(["on"] if times_first else [])):
        if first in kinds:
            return kinds.index(first)
    last = max((k for k, kind in enumerate(kinds) if kind == "profile"), default=-1)
    closed = max((k for k, kind in enumerate(kinds) if kind in ("off", "contents")), default=-1)
    return closed + 1 if closed > last or last < 0 else last
