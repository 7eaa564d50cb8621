"""Parse rows and profiles in the text files of a profiler's unpacker.

A row is a time stamp (MM-DD-YYYY HH:MM:SS, or with slashes) and numbers, or numbers only, separated by spaces or
commas. All rows of a file have the same number of columns and, in each column, the same number of decimals. Others are
dropped as damaged: a flipped or lost character nearly always changes one of the two. Lines are checked by their
patterns, in which every digit is a zero: a file has few different ones.

A, C and E files (current meter, CTD, engineering) frame the rows of a profile alike: ``Profile N`` before and after,
the switch-on and switch-off times before or after, the column names, and in A files the sample rate before and the
instrument's header after. An exception replaces the tail; files may also lack all header lines.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.readers.times import civil_seconds
from compasslib.types import Floats

Ints = NDArray[np.int64]
Form = tuple[bool, int]  # whether rows have a time stamp; number of other columns
UNKNOWN = -1  # profile number if it is not stated
PAUSE_S = 60.0  # between the clocks of scans, that divides profiles whose header is lost
_ZEROS = bytes.maketrans(b"123456789", b"000000000")
_ROW_CHARACTERS = b"0 \t\r.,+-:/"
_STAMP = re.compile(rb"00[-/]00[-/]0000 00:00:00")
_NUMBER = re.compile(rb"[-+]?(?:0++(?:\.0*)?|\.0+)")
_STAMP_DIGITS = (0, 1, 3, 4, 6, 7, 8, 9, 10, 11, 13, 14, 16, 17)  # of MM-DD-YYYYHH:MM:SS
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


@dataclass(frozen=True)
class Statement:
    """A recognized header line, its value and its byte offset in the file."""

    kind: str
    value: float = np.nan
    offset: int = 0


@dataclass(frozen=True, eq=False)
class Text:
    """Parsed lines of a text file, with their byte offsets in the file."""

    form: Form | None  # of the rows; None without any
    offset: Ints  # (r,) byte offset of each row
    time_s: Floats  # (r,) time stamp, UTC seconds since 1970, NaN without one
    values: Floats  # (r, k)
    damaged: Ints  # offsets of lines of numbers that are not valid rows
    foreign: int  # number of these whose number of columns one lost or added character does not explain
    statements: tuple[Statement, ...]  # header lines


@dataclass(frozen=True)
class ProfileBlock:
    """Range of rows, sample rate and switching times of one profile."""

    begin: int  # index of the first row in the file
    end: int  # index after the last row
    number: int = UNKNOWN
    rate_hz: float = np.nan
    on_s: float = np.nan  # UTC seconds since 1970
    off_s: float = np.nan


def parse(data: bytes, wanted: Callable[[Form], bool]) -> Text:
    """Parse the rows of the most frequent accepted form, damaged lines, and header lines of a text file."""
    lines, patterns = data.split(b"\n"), data.translate(_ZEROS).split(b"\n")
    offset = np.cumsum([0, *(len(line) + 1 for line in lines)])
    counts = Counter(patterns)
    words = {pattern for pattern in counts if pattern.translate(None, _ROW_CHARACTERS)}
    forms: dict[bytes, Form] = {}
    for pattern in counts:
        if b"0" in pattern and pattern not in words:
            stamped = b":" in pattern
            forms[pattern] = stamped, len(pattern.replace(b",", b" ").split()) - 2 * stamped
    often = Counter[Form]()
    for pattern, form in forms.items():
        often[form] += counts[pattern] if form[1] > 0 and wanted(form) else 0
    usual = next((form for form, count in often.most_common(1) if count), None)
    good = _select_regular({pattern: counts[pattern] for pattern, form in forms.items() if form == usual})
    rows, damaged, statements, inside = list[int](), list[int](), list[Statement](), False
    for k, pattern in enumerate(patterns):
        if pattern in good:
            rows.append(k)
        elif pattern in forms:
            damaged.append(k)
        elif pattern in words:
            if statement := _statement(lines[k]):
                statements.append(replace(statement, offset=int(offset[k])))
                inside = statement.kind == "contents"
            elif not inside and pattern.count(b"0") > (len(pattern) + 1) // 4:  # a row with a flipped character
                damaged.append(k)
    stamped, columns = usual or (False, 0)
    ends = [patterns[k].find(b":") + 6 if stamped else 0 for k in rows]  # of the time stamps
    time_s, dated = np.full(len(rows), np.nan), np.ones(len(rows), dtype=bool)
    if stamped and rows:
        begins = [patterns[k].find(b"0") for k in rows]
        each = zip(rows, begins, ends, strict=True)
        stamps = b"".join([lines[k][begin : begin + 10] + lines[k][end - 8 : end] for k, begin, end in each])
        digits = np.frombuffer(stamps, np.uint8).reshape(-1, 18)[:, _STAMP_DIGITS].astype(np.int64) - ord("0")
        month, day, century, year, *clock = (10 * digits[:, ::2] + digits[:, 1::2]).T
        time_s = civil_seconds(100 * century + year, month, day, *clock)
        dated = np.isfinite(time_s)
    numbers = b" ".join([lines[k][end:] for k, end in zip(rows, ends, strict=True)])
    values = np.fromstring(numbers.replace(b",", b" "), sep=" ").reshape(len(rows), columns)
    places = np.array(rows, dtype=np.int64)
    width = columns + 2 * stamped
    return Text(
        form=usual if dated.any() else None,
        offset=offset[places[dated]],
        time_s=time_s[dated],
        values=values[dated],
        damaged=np.sort(offset[np.append(places[~dated], np.array(damaged, dtype=np.int64))]),
        foreign=sum(counts[each] for each, (stamp, n) in forms.items() if usual and abs(n + 2 * stamp - width) > 1),
        statements=tuple(statements),
    )


def _select_regular(counts: Mapping[bytes, int], alike: float = 0.95) -> set[bytes]:
    """Select the patterns of valid rows whose decimals and commas are those of a share ``alike`` of the rows.

    Columns in which fewer agree may have any number of decimals; in short files, all rows but one must agree.
    """
    textures = {}
    for pattern in counts:
        words = pattern.replace(b",", b" ").split()
        stamp, numbers = (words[:2], words[2:]) if b":" in pattern else ([], words)
        if all(map(_NUMBER.fullmatch, numbers)) and (not stamp or _STAMP.fullmatch(b" ".join(stamp))):
            decimals = (len(word.rpartition(b".")[2]) if b"." in word else -1 for word in numbers)
            textures[pattern] = (*decimals, pattern.count(b","))
    if not textures:
        return set()
    texture, rows = np.array([*textures.values()]), np.array([counts[pattern] for pattern in textures])
    same = texture == [np.bincount(column + 1, rows).argmax() - 1 for column in texture.T]
    uniform = rows @ ~same <= max(1.0, (1.0 - alike) * rows.sum())
    return {pattern for pattern, fits in zip(textures, same[:, uniform].all(axis=1), strict=True) if fits}


def parse_profiles(text: Text, path: Path) -> tuple[list[ProfileBlock], Ints]:
    """Divide rows into profiles, and index each row in its profile, damaged rows included."""
    ends = [statement for statement in text.statements if statement.kind != "other"]
    before = np.searchsorted([statement.offset for statement in ends], text.offset)
    begins = np.flatnonzero(np.append(True, np.diff(before) > 0)) if len(before) else np.zeros(0, dtype=int)
    between = [ends[a:b] for a, b in pairwise([0, *before[begins].tolist(), len(ends)])]
    times_first = any(statement.kind == "off" for statement in between[0])
    cuts = [0, *(_cut(statements, times_first) for statements in between[1:-1]), len(between[-1])]
    profiles: list[ProfileBlock] = []
    place = np.arange(len(text.offset)) + np.searchsorted(text.damaged, text.offset)
    for k, (begin, end) in enumerate(pairwise([*begins.tolist(), len(before)])):
        head, tail = between[k][cuts[k] :], between[k + 1][: cuts[k + 1]]
        known = {statement.kind: statement.value for statement in [*reversed(tail), *head]}
        hertz, on, off = (known.get(kind, np.nan) for kind in ("rate", "on", "off"))
        number = int(known.get("profile", UNKNOWN))
        pauses = np.zeros(0, dtype=np.int64)
        if number == UNKNOWN:  # header lines may be missing: divide at pauses of the clock, in either direction
            with np.errstate(invalid="ignore"):
                pauses = np.flatnonzero(np.abs(np.diff(text.time_s[begin:end])) > PAUSE_S) + 1 + begin
        for first, stop in pairwise([begin, *pauses.tolist(), end]):
            introduced = between[k] and first == begin
            start = between[k][-1].offset if introduced else int(text.offset[first]) if first else 0
            place[first:stop] -= np.searchsorted(text.offset, start) + np.searchsorted(text.damaged, start)
            profiles.append(ProfileBlock(first, stop, number, hertz if hertz > 0 else np.nan, on, off))
    if len(profiles) == 1 and profiles[0].number == UNKNOWN:
        profiles = [replace(profiles[0], number=number_in_name(path))]
    rate = np.nan
    for k, profile in enumerate(profiles):  # a rate applies until another is stated
        rate = profile.rate_hz if np.isfinite(profile.rate_hz) else rate
        profiles[k] = replace(profile, rate_hz=rate)
    return profiles, place


def number_in_name(path: Path) -> int:
    """Parse the profile number that a file's name ends with, as in A0000012.TXT."""
    match = _NUMBER_IN_NAME.search(path.name)
    return int(match[1]) if match else UNKNOWN


@lru_cache(maxsize=1024)  # the same instrument header follows every profile
def _statement(line: bytes) -> Statement | None:
    match = _WORDS.match(line)
    if not match:
        return None
    for name, given in (("rate", "hertz"), ("profile", "number")):
        if match[name]:
            digits = match[given].decode()
            return Statement(name, float(digits) if re.fullmatch(r"\d+\.?\d*|\.\d+", digits) else np.nan)
    for name in ("on", "off"):
        if match[name]:
            stamp = re.match(rb"\s*(\d\d?)/(\d\d?)/(\d{4})\s+(\d\d?):(\d\d):(\d\d)", match[f"{name}_at"])
            if not stamp:
                return Statement(name)
            month, day, year, *clock = (np.array([int(part)]) for part in stamp.groups())
            return Statement(name, float(civil_seconds(year, month, day, *clock)[0]))
    return Statement(match.lastgroup or "")


def _cut(statements: Sequence[Statement], times_first: bool) -> int:
    """Find the index at which the tail of a profile ends and the head of the next, perhaps with its times, begins."""
    kinds = [statement.kind for statement in statements]
    for first in ("rate", *(["on"] if times_first else [])):
        if first in kinds:
            return kinds.index(first)
    last = max((k for k, kind in enumerate(kinds) if kind == "profile"), default=-1)
    closed = max((k for k, kind in enumerate(kinds) if kind in ("off", "contents")), default=-1)
    return closed + 1 if closed > last or last < 0 else last
