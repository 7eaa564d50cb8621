"""The profiles in an unpacked text file of a moored profiler: which rows belong to which, and what is said of them.

A, C and E files (current meter, CTD, engineering) frame their rows alike: ``Profile N`` before and after, the times of
switching on and off before or after, names of the columns, in A files the sample rate before and the instrument's
header behind. An exception replaces the tail; without header lines nothing but rows may be left.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from compasslib.readers.mmp_clock import FIRST_YEAR, LAST_YEAR, Ints
from compasslib.readers.mmp_rows import Text
from compasslib.records import Floats

PAUSE_S = 60.0  # rows without header lines further apart, or going back as much, belong to different profiles
UNKNOWN = -1  # number of a profile that nothing names

_WORDS = re.compile(
    rb"""[ \t,]*(?:(?P<rate>sample\ rate:\s*(?P<hertz>[\d.]+))
    | (?P<profile>profile\s+(?P<number>\d+)\s*$)
    | (?P<on>.*?turned\ on\ at\s+(?P<on_at>[\d/ :]+))
    | (?P<off>.*?(?:turned\ off|logging\ stopped)\ at\s+(?P<off_at>[\d/ :]+))
    | (?P<contents>.*header\ contents)
    | (?P<names>mm-dd-yyyy|date\b|mmho|hdng|tx\b)
    | (?P<told>exception|end\ of\ file|ramp\ exit|profile\ exit|vehicle))""",
    re.IGNORECASE | re.VERBOSE,
)
_NUMBER_IN_NAME = re.compile(r"(\d{3,7})(?:\.dec)?(?:\.\w+)?$", re.IGNORECASE)


@dataclass(frozen=True)
class Block:
    """The rows of one profile."""

    begin: int  # among the file's rows
    end: int
    number: int = UNKNOWN
    rate_hz: float = np.nan
    on_s: float = np.nan  # UTC seconds since 1970
    off_s: float = np.nan


@dataclass(frozen=True)
class _Item:
    """A line of words that means something."""

    kind: str
    value: float = np.nan
    offset: int = 0


def blocks(text: Text, path: Path) -> tuple[list[Block], Ints, int]:
    """Return the profiles, each row's place in its profile with damaged rows counted, and how many rows are damaged.

    Args:
        text: a file's rows.
        path: the file; its name numbers a single profile that nothing else does.
    """
    items, garbled = _items(text)
    damaged = np.sort(np.append(text.damaged, np.array(garbled, dtype=np.int64)))
    groups, between = _groups(text, items)
    found: list[Block] = []
    place = np.arange(len(text.offset)) + np.searchsorted(damaged, text.offset)
    for k, group in enumerate(groups):
        for piece in _pieces(_block(group, *_around(between, k)), text.time_s):
            led = between[k] and piece.begin == group[0]
            start = between[k][-1].offset if led else int(text.offset[piece.begin]) if piece.begin else 0
            place[piece.begin : piece.end] -= np.searchsorted(text.offset, start) + np.searchsorted(damaged, start)
            found.append(piece)
    if len(found) == 1 and found[0].number == UNKNOWN:
        found = [replace(found[0], number=number_in_name(path))]
    return _with_rate_of_the_one_before(found), place, len(damaged)


def number_in_name(path: Path) -> int:
    """Return the profile number that a file's name ends with, as in A0000012.TXT.

    Args:
        path: the file.
    """
    found = _NUMBER_IN_NAME.search(path.name)
    return int(found[1]) if found else UNKNOWN


def says_something(text: Text) -> bool:
    """Return whether any line is one that an unpacker writes.

    Args:
        text: a file's rows and lines.
    """
    return bool(_items(text)[0])


def _items(text: Text) -> tuple[list[_Item], list[int]]:
    """Return the lines that mean something, and the offsets of damaged rows among the others."""
    items: list[_Item] = []
    garbled: list[int] = []
    inside = False
    for offset, line in text.lines:
        item = _item(line)
        if item:
            items.append(replace(item, offset=offset))
            inside = item.kind == "contents"
        elif not inside and sum(48 <= c < 58 for c in line) > len(line) // 4:
            garbled.append(offset)
    return items, garbled


@lru_cache(maxsize=1024)  # the instrument's header stands behind every profile, line for line the same
def _item(line: bytes) -> _Item | None:
    found = _WORDS.match(line)
    if not found:
        return None
    kind = found.lastgroup or ""
    for name, given in (("rate", "hertz"), ("profile", "number")):
        if found[name]:
            return _Item(name, _float(found[given]))
    for name in ("on", "off"):
        if found[name]:
            return _Item(name, _stamp(found[f"{name}_at"]))
    return _Item(kind)


def _float(digits: bytes) -> float:
    try:
        return float(digits)
    except ValueError:
        return float("nan")


def _stamp(words: bytes) -> float:
    found = re.match(rb"\s*(\d\d?)/(\d\d?)/(\d{4})\s+(\d\d?):(\d\d):(\d\d)", words)
    if not found:
        return float("nan")
    month, day, year, hour, minute, second = (int(part) for part in found.groups())
    try:
        known = datetime(year, month, day, hour, minute, second, tzinfo=UTC)
    except ValueError:
        return float("nan")
    return known.timestamp() if FIRST_YEAR <= year <= LAST_YEAR else float("nan")


def _groups(text: Text, items: Sequence[_Item]) -> tuple[list[tuple[int, int]], list[list[_Item]]]:
    """Return the rows between lines that end a profile, and the lines before, between and behind them."""
    ends = [item for item in items if item.kind != "told"]
    before = np.searchsorted([item.offset for item in ends], text.offset)
    begins = np.flatnonzero(np.append(True, np.diff(before) > 0)) if len(before) else np.zeros(0, dtype=int)
    marks = [0, *before[begins].tolist(), len(ends)]
    between = [ends[a:b] for a, b in pairwise(marks)]
    limits = [*begins.tolist(), len(before)]
    return list(pairwise(limits)), between


def _pieces(block: Block, time_s: Floats) -> list[Block]:
    """Cut a profile that nothing names where its clock pauses: header lines were left out, or lost."""
    if block.number != UNKNOWN:
        return [block]
    with np.errstate(invalid="ignore"):
        step = np.diff(time_s[block.begin : block.end])
        cuts = np.flatnonzero((step > PAUSE_S) | (step < -PAUSE_S)) + 1 + block.begin
    limits = [block.begin, *cuts.tolist(), block.end]
    return [replace(block, begin=a, end=b) for a, b in pairwise(limits)]


def _around(between: Sequence[list[_Item]], k: int) -> tuple[list[_Item], list[_Item]]:
    """Return the lines in front of and behind the k-th group that speak of it."""
    leads = any(item.kind == "off" for item in between[0])
    head = between[k][0 if k == 0 else _cut(between[k], leads) :]
    tail = between[k + 1][: None if k + 2 == len(between) else _cut(between[k + 1], leads)]
    return head, tail


def _cut(items: Sequence[_Item], leads: bool) -> int:
    """Return where the tail of a profile ends and the head of the next begins; the times may lead the head."""
    kinds = [item.kind for item in items]
    for first in ("rate", *(["on"] if leads else [])):
        if first in kinds:
            return kinds.index(first)
    last = max((k for k, kind in enumerate(kinds) if kind == "profile"), default=-1)
    closed = max((k for k, kind in enumerate(kinds) if kind in ("off", "contents")), default=-1)
    return closed + 1 if closed > last or last < 0 else last


def _block(group: tuple[int, int], head: Sequence[_Item], tail: Sequence[_Item]) -> Block:
    said = {item.kind: item.value for item in [*reversed(tail), *head]}
    number = said.get("profile", float(UNKNOWN))
    rate, on, off = (said.get(kind, float("nan")) for kind in ("rate", "on", "off"))
    return Block(*group, number=int(number), rate_hz=rate if rate > 0 else np.nan, on_s=on, off_s=off)


def _with_rate_of_the_one_before(found: Sequence[Block]) -> list[Block]:
    rates, rate = [], np.nan
    for block in found:
        rate = block.rate_hz if np.isfinite(block.rate_hz) else rate
        rates.append(rate)
    return [replace(block, rate_hz=rate) for block, rate in zip(found, rates, strict=True)]
