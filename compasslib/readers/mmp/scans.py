"""Find rows, scans and profiles in the files of a moored profiler and its 3D-ACM: unpacked text, or binary.

A row of text is a time stamp (MM-DD-YYYY HH:MM:SS, or with slashes) and numbers, or numbers only, separated by spaces
or commas. All rows of a file have the same number of columns and, in each column, the same number of decimals; others
are damaged: a flipped or lost character nearly always changes one of the two. Lines are checked by their patterns, in
which every digit is a zero: a file has few different ones. A, C and E files (current meter, CTD, engineering) frame the
rows of a profile alike: ``Profile N`` before and after, the switch-on and switch-off times before or after, and in A
files the sample rate before and the meter's header after. Files may also lack all header lines.

A binary A file holds of each profile its length (four bytes), a header that ends in DATA, records of 47 bytes, and the
switch-on and switch-off times. Records are found by their content, so that lost bytes or a damaged header cost no other
record.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.times import FIRST_YEAR, LAST_YEAR, civil_seconds
from compasslib.records import take
from compasslib.types import DAY_S, Bools, Floats

Ints = NDArray[np.int64]
Form = tuple[bool, int]  # whether rows have a time stamp; number of other columns
COLUMNS = ("HDNG", "TX", "TY", "HX", "HY", "HZ", "VPAB", "VPCD", "VPEF", "VPGH")
FORMS = ((True, 10), (False, 9))  # of scans; those of early instruments have neither clock nor heading
EXPECTED = "unpacked ASCII or binary scans of a Falmouth 3D-ACM"
UNKNOWN = -1  # profile number if it is not stated
PAUSE_S = 60.0  # between the clocks of scans, that divides profiles whose header is lost
MARK = b"DATA"  # the end of the header
FRONT = np.dtype([("length", ">u4"), ("settings", "V63"), ("rate_hz", "<f4"), ("instrument", "V208"), ("mark", "S4")])
RECORD = np.dtype([("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))])
TAIL = np.dtype([("on_s", ">u4"), ("off_s", ">u4")])  # UTC seconds since 1970
BETWEEN = TAIL.itemsize + FRONT.itemsize  # bytes between the records of two profiles
_ZEROS = bytes.maketrans(b"123456789", b"000000000")
_ROW_CHARACTERS = b"0 \t\r.,+-:/"
_STAMP = re.compile(rb"00[-/]00[-/]0000 00:00:00")
_NUMBER = re.compile(rb"[-+]?(?:0++(?:\.0*)?|\.0+)")
_STAMP_DIGITS = (0, 1, 3, 4, 6, 7, 8, 9, 10, 11, 13, 14, 16, 17)  # of MM-DD-YYYYHH:MM:SS
_WORDS = re.compile(
    rb"""[ \t,]*(?:sample\ rate:\s*(?P<rate>[\d.]+)
    | profile\s+(?P<profile>\d+)\s*$
    | .*?turned\ on\ at\s+(?P<on>[\d/ :]+)
    | .*?(?:turned\ off|logging\ stopped)\ at\s+(?P<off>[\d/ :]+)
    | (?P<contents>.*header\ contents)
    | (?P<names>mm-dd-yyyy|date\b|mmho|hdng|tx\b)
    | (?P<other>exception|end\ of\ file|ramp\ exit|profile\ exit|vehicle))""",
    re.IGNORECASE | re.VERBOSE,
)
_SWITCHED = re.compile(rb"\s*(\d\d?)/(\d\d?)/(\d{4})\s+(\d\d?):(\d\d):(\d\d)")
_NUMBER_IN_NAME = re.compile(r"(\d{3,7})(?:\.dec)?(?:\.\w+)?$", re.IGNORECASE)


class Statement(NamedTuple):
    """A header line: its kind (a group of ``_WORDS``), its value, and its index in the file."""

    kind: str
    value: float
    line: int = 0


@dataclass(frozen=True)
class ProfileBlock:
    """Range of rows, sample rate and switching times of one profile."""

    begin: int  # index of the first row in the file
    end: int  # index after the last row
    number: int = UNKNOWN
    rate_hz: float = np.nan
    on_s: float = np.nan  # UTC seconds since 1970
    off_s: float = np.nan


@dataclass(frozen=True, eq=False)
class Text:
    """Rows of a text file, r in all."""

    form: Form | None  # None without any row
    time_s: Floats  # (r,) time stamp, UTC seconds since 1970, NaN without one
    values: Floats  # (r, k)
    place: Ints  # (r,) index of each row in its profile, damaged rows included
    blocks: tuple[ProfileBlock, ...]  # (p,) profiles
    damaged: int  # number of lines of numbers that are not valid rows
    foreign: int  # number of these whose number of columns one lost or added character does not explain
    framed: bool  # whether the file has header lines


@dataclass(frozen=True, eq=False)
class Scans:
    """Scans logged by the meter: r scans in p profiles."""

    clock_s: Floats  # (r,) whole UTC seconds since 1970, NaN where scans carry no clock
    values: Floats  # (r, 10) in the order of COLUMNS, degrees and cm/s; HDNG is NaN where not recorded
    place: Ints  # (r,) index of the scan in its profile, including damaged scans
    profile: Ints  # (r,) index of the profile of each scan
    blocks: tuple[ProfileBlock, ...]  # (p,) number, rate and times of each profile
    damaged: int  # number of rows or records dropped
    damaged_files: tuple[str, ...] = ()
    empty_files: tuple[str, ...] = ()
    strange: int = 0  # number of unprintable bytes in text files, ignored
    notes: tuple[str, ...] = ()  # sentences on how files were read


def read_scans(paths: Sequence[Path]) -> Scans:
    """Read the scans of several files, text or binary, in the order given.

    Raises:
        InputError: a file is unreadable or of neither kind, or no file holds a scan.
    """
    parts = [_read_file(path) for path in paths]
    shift = np.cumsum([0, *(len(part.blocks) for part in parts)])
    profile = np.concatenate([part.profile + first for part, first in zip(parts, shift[:-1], strict=True)])
    occupied, profile = np.unique(profile, return_inverse=True)
    blocks = [block for part in parts for block in part.blocks]
    joined: dict[str, Any] = {}
    for name, value in vars(parts[0]).items():
        each = [getattr(part, name) for part in parts]
        joined[name] = np.concatenate(each) if isinstance(value, np.ndarray) else sum(each, type(value)())
    scans = Scans(**joined | {"profile": profile, "blocks": tuple(blocks[k] for k in occupied)})
    if not len(profile):
        where = f"{paths[0]}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
        shown = f"none ({scans.damaged} damaged rows)" if scans.damaged else "none"
        raise InputError(where, expected=EXPECTED, found=shown, advice="check files and format of the instrument")
    return scans


def _read_file(path: Path) -> Scans:
    """Read the scans of a file, without impossible ones; InputError if more scans are damaged than intact."""
    data, notes = _undo_modem(path, files.read_bytes(path))
    at, records = _find_records(data)
    strange = 0
    if (np.diff(at) == RECORD.itemsize).any() or _follows_mark(data, at).any():
        scans, failed = _parse_binary(data, at, records)
        if len(scans.blocks) == 1:
            scans = replace(scans, blocks=(replace(scans.blocks[0], number=_number_in_name(path)),))
    else:
        text = parse(data if is_text(data) else b"", FORMS.__contains__, path)
        if data.strip() and text.form is None and not text.framed:
            raise files.foreign(path, EXPECTED, "mmp_acm")
        values = np.full((len(text.place), len(COLUMNS)), np.nan)
        values[:, len(COLUMNS) - text.values.shape[1] :] = text.values
        profile = np.repeat(np.arange(len(text.blocks)), [block.end - block.begin for block in text.blocks])
        scans = Scans(text.time_s, values, text.place, profile, text.blocks, text.damaged)
        failed, strange = text.damaged - text.foreign, files.count_unprintable(data)
    heading, tilts, field, paths = np.split(scans.values, (1, 3, 6), axis=1)
    good = (np.isnan(heading) | ((heading >= -180.0) & (heading <= 360.0)))[:, 0]
    good &= np.isfinite(field).all(axis=1) & (np.abs(tilts) <= 180.0).all(axis=1)  # degrees
    good &= (np.abs(paths) <= 2000.0).all(axis=1) & ~_is_misplaced(scans.clock_s, scans.profile)  # cm/s
    impossible = int(np.sum(~good))
    files.refuse_mostly_damaged(path, "scans", damaged=failed + impossible, whole=len(good) - impossible)
    damaged = scans.damaged + impossible
    return replace(
        take(scans, good),
        damaged=damaged,
        damaged_files=(str(path),) if damaged else (),
        empty_files=() if good.any() else (str(path),),
        strange=strange,
        notes=notes,
    )


def is_text(data: bytes) -> bool:
    """Return whether a file consists mostly of printable characters, ignoring the fill of erased memory at its end."""
    sample = data[:65536].rstrip(b"\x00\xff")
    return not data or files.count_unprintable(sample) < 0.05 * len(sample)


def parse(data: bytes, wanted: Callable[[Form], bool], path: Path) -> Text:
    """Parse the rows of the most frequent accepted form in a text file, and divide them into profiles."""
    lines, patterns = data.split(b"\n"), data.translate(_ZEROS).split(b"\n")
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
                statements.append(statement._replace(line=k))
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
        # Whole columns of digits: splitting each row into words takes twice as long.
        digits = np.frombuffer(stamps, np.uint8).reshape(-1, 18)[:, _STAMP_DIGITS].astype(np.int64) - ord("0")
        month, day, century, year, *clock = (10 * digits[:, ::2] + digits[:, 1::2]).T
        time_s = civil_seconds(100 * century + year, month, day, *clock)
        dated = np.isfinite(time_s)
    numbers = b" ".join([lines[k][end:] for k, end in zip(rows, ends, strict=True)])
    values = np.fromstring(numbers.replace(b",", b" "), sep=" ").reshape(len(rows), columns)
    places = np.array(rows, dtype=np.int64)
    lost = np.sort(np.append(places[~dated], np.array(damaged, dtype=np.int64)))
    blocks, place = _divide(places[dated], time_s[dated], lost, statements)
    if len(blocks) == 1 and blocks[0].number == UNKNOWN:
        blocks = [replace(blocks[0], number=_number_in_name(path))]
    width = columns + 2 * stamped
    return Text(
        form=usual if dated.any() else None,
        time_s=time_s[dated],
        values=values[dated],
        place=place,
        blocks=tuple(blocks),
        damaged=len(lost),
        foreign=sum(counts[each] for each, (stamp, n) in forms.items() if usual and abs(n + 2 * stamp - width) > 1),
        framed=bool(statements),
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


@lru_cache(maxsize=1024)  # the same instrument header follows every profile
def _statement(line: bytes) -> Statement | None:
    match = _WORDS.match(line)
    if match is None:
        return None
    kind, value = match.lastgroup or "", np.nan
    if kind in ("rate", "profile") and re.fullmatch(rb"\d+\.?\d*|\.\d+", match[kind]):
        value = float(match[kind])
    elif kind in ("on", "off") and (stamp := _SWITCHED.match(match[kind])):
        month, day, year, *clock = (np.array([int(part)]) for part in stamp.groups())
        value = float(civil_seconds(year, month, day, *clock)[0])
    return Statement(kind, value)


def _divide(
    lines: Ints, time_s: Floats, damaged: Ints, statements: Sequence[Statement]
) -> tuple[list[ProfileBlock], Ints]:
    """Divide rows, (r,) lines, into profiles by the statements between them, and index each row in its profile."""
    ends = [statement for statement in statements if statement.kind != "other"]
    before = np.searchsorted([statement.line for statement in ends], lines)
    begins = np.flatnonzero(np.append(True, np.diff(before) > 0)) if len(before) else np.zeros(0, dtype=int)
    between = [ends[a:b] for a, b in pairwise([0, *before[begins].tolist(), len(ends)])]
    times_first = any(statement.kind == "off" for statement in between[0])
    cuts = [0, *(_cut([each.kind for each in part], times_first) for part in between[1:-1]), len(between[-1])]
    blocks, rate = list[ProfileBlock](), np.nan
    place = np.arange(len(lines)) + np.searchsorted(damaged, lines)
    for k, (begin, end) in enumerate(pairwise([*begins.tolist(), len(before)])):
        head, tail = between[k][cuts[k] :], between[k + 1][: cuts[k + 1]]
        known = {statement.kind: statement.value for statement in [*reversed(tail), *head]}
        rate = known["rate"] if known.get("rate", 0.0) > 0.0 else rate  # applies until another is stated
        number, on, off = int(known.get("profile", UNKNOWN)), known.get("on", np.nan), known.get("off", np.nan)
        pauses = np.zeros(0, dtype=np.int64)
        if number == UNKNOWN:  # header lines may be missing: divide at pauses of the clock, in either direction
            with np.errstate(invalid="ignore"):
                pauses = np.flatnonzero(np.abs(np.diff(time_s[begin:end])) > PAUSE_S) + 1 + begin
        for first, stop in pairwise([begin, *pauses.tolist(), end]):
            introduced = between[k] and first == begin
            start = between[k][-1].line if introduced else int(lines[first]) if first else 0
            place[first:stop] -= np.searchsorted(lines, start) + np.searchsorted(damaged, start)
            blocks.append(ProfileBlock(first, stop, number, rate, on, off))
    return blocks, place


def _cut(kinds: Sequence[str], times_first: bool) -> int:
    """Find the index at which the tail of a profile ends and the head of the next, perhaps with its times, begins."""
    for first in ("rate", *(["on"] if times_first else [])):
        if first in kinds:
            return kinds.index(first)
    last = max((k for k, kind in enumerate(kinds) if kind == "profile"), default=-1)
    closed = max((k for k, kind in enumerate(kinds) if kind in ("off", "contents")), default=-1)
    return closed + 1 if closed > last or last < 0 else last


def _number_in_name(path: Path) -> int:
    """Parse the profile number that a file's name ends with, as in A0000012.TXT."""
    match = _NUMBER_IN_NAME.search(path.name)
    return int(match[1]) if match else UNKNOWN


def _find_records(data: bytes) -> tuple[Ints, np.ndarray]:
    """Find the records of a binary file by their content, and give their byte offsets.

    Seven bytes of a date and ten finite numbers are valid by chance once in some 100 MB.
    """
    octets, size = np.frombuffer(data, np.uint8), RECORD.itemsize
    century = octets[6 : max(len(octets) - size + 7, 6)]
    at = np.flatnonzero((century == FIRST_YEAR >> 8) | (century == LAST_YEAR >> 8))
    hour, minute, second, month, day = (octets[at + k] for k in range(5))
    at = at[(hour < 24) & (minute < 60) & (second < 60) & (month > 0) & (month <= 12) & (day > 0) & (day <= 31)]
    records = octets[at[:, None] + np.arange(size)].view(RECORD)[:, 0]
    good = np.isfinite(_record_times(records)) & np.isfinite(records["values"]).all(axis=1)
    at, records = at[good], records[good]
    apart, end = np.ones(len(at), dtype=bool), 0
    if (np.diff(at) < size).any():
        for k, begin in enumerate(at.tolist()):
            apart[k] = begin >= end
            end = begin + size if begin >= end else end
    return at[apart], records[apart]


def _record_times(records: np.ndarray) -> Floats:
    """Compute the times of records, UTC seconds since 1970, NaN where invalid."""
    year, month, day = (records[name].astype(np.int64) for name in ("year", "month", "day"))
    return civil_seconds(year, month, day, *records["clock"].astype(np.int64).T)


def _follows_mark(data: bytes, at: Ints) -> Bools:
    """Flag the byte offsets at which a header ends."""
    octets, mark = np.frombuffer(data, np.uint8), np.frombuffer(MARK, np.uint8)
    ends = octets[np.maximum(at, len(mark))[:, None] + np.arange(-len(mark), 0)] == mark
    return np.asarray(ends.all(axis=1) & (at >= FRONT.itemsize))


def _parse_binary(data: bytes, at: Ints, records: np.ndarray) -> tuple[Scans, int]:
    """Divide the records of a binary file into profiles, and count the damaged ones, which the memory's fill is not.

    A profile begins behind a header, or behind other bytes of its length if the clock pauses. How many records are lost
    is estimated from the number of bytes between others.
    """
    time_s, end = _record_times(records), at + RECORD.itemsize
    marked = _follows_mark(data, at)
    gap = at[1:] - end[:-1]
    new = np.append(True, marked[1:] | ((gap >= FRONT.itemsize) & (np.abs(np.diff(time_s)) > PAUSE_S)))
    begins = np.flatnonzero(new)
    ends = np.append(begins[1:], len(at))
    surplus = np.append(at[0] - FRONT.itemsize, gap - np.where(new[1:], BETWEEN, 0))
    lost = np.ceil(surplus / RECORD.itemsize).astype(np.int64).clip(0)
    rest = data[end[-1] :]
    written = rest.rstrip(rest[-1:]) if rest[-1:] in (b"\x00", b"\xff") else rest  # without the fill of erased memory
    damaged, failed = (
        int(lost.sum()) + max(0, math.ceil((size - TAIL.itemsize) / RECORD.itemsize))
        for size in (len(rest), len(written))
    )
    if len(rest) <= BETWEEN + RECORD.itemsize:  # at most a header and part of a record
        damaged = failed = int(lost.sum()) + (len(rest) > TAIL.itemsize)
    place, good, times = np.cumsum(1 + np.where(new, 0, lost)), np.ones(len(at), dtype=bool), list[tuple[float, ...]]()
    for first, stop in zip(begins.tolist(), ends.tolist(), strict=True):
        behind = data[end[stop - 1] : at[stop] - FRONT.itemsize if stop < len(at) else len(data)]
        # A float of which only the first bytes were written is smaller than any speed.
        good[stop - 1] = abs(float(records["values"][stop - 1, -1])) >= 1e-30 or any(behind)
        front = np.frombuffer(data, FRONT, 1, at[first] - FRONT.itemsize)["rate_hz"] if marked[first] else [np.nan]
        rate = float(front[0]) if 0 < front[0] < 100 else np.nan
        on, off = np.frombuffer(behind, TAIL, 1)[0].item() if len(behind) >= TAIL.itemsize else (np.nan, np.nan)
        known = abs(on - time_s[first]) < DAY_S and on <= off < on + 30 * DAY_S
        times.append((rate, float(on), float(off)) if known else (rate, np.nan, np.nan))
    kept = np.append(0, np.cumsum(good))
    spans = zip(kept[begins].tolist(), kept[ends].tolist(), times, strict=True)
    blocks = tuple(ProfileBlock(begin, stop, UNKNOWN, *known) for begin, stop, known in spans)
    profile = np.cumsum(new) - 1
    place -= place[begins][profile]
    torn = int(np.sum(~good))
    values = records["values"][good].astype(float)
    return Scans(time_s[good], values, place[good], profile[good], blocks, damaged + torn), failed + torn


def _undo_modem(path: Path, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Remove the framing and escapes of a modem from the profiles of a file, and describe the changes.

    Frames of other instruments and repeated profiles are dropped; data without frames are returned unchanged.
    """
    profiles: list[list[bytes]] = []
    last: dict[str, list[bytes]] = {}  # last profile of each instrument
    for instrument, content in files.payloads(data):
        if content[FRONT.itemsize - len(MARK) : FRONT.itemsize] == MARK:
            last[instrument] = [content]
            profiles.append(last[instrument])
        elif instrument in last:  # continues the last profile of the instrument
            last[instrument].append(content)
    if not profiles:
        return data, ()
    notes = [f"{path.name} {files.ESCAPES_UNDONE}"] * files.looks_escaped(data)
    if len(last) > 1:
        held = f"{path.name} holds frames of {len(last)} instruments, {' and '.join(last)}"
        notes.append(f"{held}: give those of each as its own file")
    return b"".join(dict.fromkeys(b"".join(parts) for parts in profiles)), tuple(notes)


def _is_misplaced(clock_s: Floats, profile: Ints, jump_s: float = 2.0) -> Bools:
    """Flag single times that jump away from both neighbours in the same profile, (r,); NaN is never flagged."""
    apart = np.zeros(len(clock_s), dtype=bool)
    if len(clock_s) > 2:
        step = np.where(np.diff(profile) == 0, np.diff(clock_s), 0.0)
        with np.errstate(invalid="ignore"):
            far = (np.abs(step[:-1]) > jump_s) & (np.abs(step[1:]) > jump_s)
            apart[1:-1] = far & (step[:-1] * step[1:] < 0)
    return apart


def interpolate_clock(clock_s: Floats, profile: Ints, rate_hz: Floats) -> Floats:
    """Interpolate the clock of whole seconds: scans within the same second are spread evenly over it.

    ``rate_hz`` is the rate stated in the file, (r,), NaN where there is none.
    """
    if not len(clock_s):
        return clock_s
    new = np.append(True, (np.diff(clock_s) != 0) | (np.diff(profile) != 0))
    begins = np.flatnonzero(new)
    group = np.cumsum(new) - 1
    size = np.diff(np.append(begins, len(new)))[group]
    return clock_s + (np.arange(len(new)) - begins[group]) / np.fmax(size, rate_hz)
