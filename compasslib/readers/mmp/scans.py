"""The files of a Falmouth 3D-ACM on a McLane profiler: unpacked ASCII or binary, distinguished by their content.

ASCII rows are a stamp, HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH, between spaces or commas, with or without header lines;
scans of early instruments carry no clock and no heading: nine numbers from TX on. Binary records hold the same ten.

A binary file (A*.DAT) holds one or several profiles: four bytes of length (big-endian), a header of 279 bytes that ends
in DATA, records of 47 bytes, and the times of switching on and off. Lengths lead from profile to profile; where one is
damaged the next header is sought.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.readers.mmp import rows
from compasslib.readers.mmp.rows import UNKNOWN, Ints, ProfileBlock
from compasslib.readers.times import civil_seconds
from compasslib.types import DAY_S, Bools, Floats

COLUMNS = ("HDNG", "TX", "TY", "HX", "HY", "HZ", "VPAB", "VPCD", "VPEF", "VPGH")
STAMPED, UNSTAMPED = (True, 10), (False, 9)
STEEPEST_DEG, FASTEST_CM_S = 180.0, 2000.0  # beyond these a number is no reading but a damaged one
EXPECTED = "unpacked ASCII or binary scans of a Falmouth 3D-ACM"
TEXT_SHARE = 0.95  # of the characters of a text are printable
HEADER_BYTES = 279
MARK = b"DATA"  # the end of the header
RATE_AT = 63  # of the sample rate in the header, a float
RECORD = np.dtype([("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))])
LENGTH_BYTES, TAIL_BYTES = 4, 8
FRONT_BYTES = LENGTH_BYTES + HEADER_BYTES
LONGEST_S = 30 * DAY_S  # a profiler turns its meter on before a profile, which lasts hours
NO_SPEED = 1e-30  # cm/s: a float of which zeros took all but its first bytes
LIKENESS = 0.8  # share of the bytes that a header has in common with the file's first; the settings do not change
MISPLACED_S = 2.0  # a clock that leaves its neighbours by more and comes back is a damaged one
TRUSTED_RATE = 0.2  # a nominal rate is accepted where the clock shows it to within this share
FEW = 10  # scans below which a clock of whole seconds shows no rate


@dataclass(frozen=True, eq=False)
class Scans:
    """The scans that the meter logged: r of them in p profiles."""

    clock_s: Floats  # (r,) whole UTC seconds since 1970, NaN where scans carry no clock
    values: Floats  # (r, 10) in the order of COLUMNS, degrees and cm/s; HDNG is NaN where it is not recorded
    place: Ints  # (r,) in its profile, damaged scans counted
    profile: Ints  # (r,) index of its profile
    blocks: tuple[ProfileBlock, ...]  # (p,) number, rate and times of each profile
    damaged: int  # rows or records left out
    damaged_files: tuple[str, ...]
    empty_files: tuple[str, ...]
    strange: int = 0  # bytes of text files that are no text, and were passed over
    notes: tuple[str, ...] = ()  # sentences on how files were read


@dataclass(frozen=True, eq=False)
class BinaryScans:
    """The scans of a binary file."""

    blocks: list[ProfileBlock]
    place: Ints  # (r,) of each scan in its profile, damaged ones counted
    time_s: Floats  # (r,) whole seconds
    values: Floats  # (r, 10)
    damaged: int  # records that are no scans
    failed: int  # of these, those of profiles that are recognised, neither filled up nor moved by lost bytes


@dataclass(frozen=True)
class _Span:
    """Place of the records of one profile, or of what lies before, between and behind profiles."""

    begin: int
    end: int  # behind the records and the times of switching on and off
    records: int
    tail: int = -1  # where those times stand; -1 where they are lost
    torn: int = 0  # records in what cannot be separated


def read_scans(paths: Sequence[Path]) -> Scans:
    """Read the scans of several files, unpacked ASCII or binary, in the order given.

    Raises:
        InputError: a file that cannot be read or is neither, or no scan in any of them.
    """
    if not paths:
        raise InputError("files", expected=EXPECTED, found="no file", advice="name the instrument's files")
    scans = _concatenate([_read_file(path) for path in paths])
    if not len(scans.profile):
        where = f"{paths[0]}" + (f" and {len(paths) - 1} more" if len(paths) > 1 else "")
        shown = f"none ({scans.damaged} damaged rows)" if scans.damaged else "none"
        raise InputError(where, expected=EXPECTED, found=shown, advice="check files and format of the instrument")
    return scans


def is_text(data: bytes) -> bool:
    """Return whether a file is mostly made of printable characters, the filling of an erased store at its end apart."""
    sample = data[:65536].rstrip(b"\x00\xff")
    return not data or files.count_unprintable(sample) < (1.0 - TEXT_SHARE) * len(sample)


def _parse_binary(data: bytes) -> BinaryScans:
    """Parse the scans of a binary file, damaged records left out."""
    blocks: list[ProfileBlock] = []
    places: list[Ints] = [np.zeros(0, dtype=np.int64)]
    times: list[Floats] = [np.zeros(0)]
    values: list[Floats] = [np.zeros((0, RECORD["values"].shape[0]))]
    damaged, failed, begin = 0, 0, 0
    for span in _spans(data):
        damaged += span.torn + span.records
        if span.records:
            records = np.frombuffer(data, dtype=RECORD, count=span.records, offset=span.begin)
            time_s, good = _record_times(records)
            torn = np.zeros(len(records), dtype=bool)
            if good.any():
                last = int(np.flatnonzero(good)[-1])
                ends_in_zeros = abs(float(records["values"][last, -1])) < NO_SPEED
                torn[last] = ends_in_zeros and not any(data[span.begin + (last + 1) * RECORD.itemsize : span.end])
            good &= ~torn
            count = int(good.sum())
            end = begin + count
            rate = float(np.frombuffer(data, "<f4", 1, span.begin - HEADER_BYTES + RATE_AT)[0])
            on, off = np.frombuffer(data, ">u4", 2, span.tail).astype(float) if span.tail >= 0 else (np.nan, np.nan)
            rate = rate if 0 < rate < 100 else np.nan
            blocks.append(ProfileBlock(begin, end, rate_hz=rate, on_s=float(on), off_s=float(off)))
            places.append(np.flatnonzero(good))
            times.append(time_s[good])
            values.append(records["values"][good].astype(float))
            failed += _count_failed(data, span, records, good)
            damaged, begin = damaged - count, begin + count
    return BinaryScans(blocks, np.concatenate(places), np.concatenate(times), np.concatenate(values), damaged, failed)


def _count_failed(data: bytes, span: _Span, records: np.ndarray, good: Bools) -> int:
    """Count the records of a profile that fail, without fillings of one byte and what is whole but moved."""
    octets = records[~good].view(np.uint8).reshape(-1, RECORD.itemsize)
    failed = int((octets != octets[:, :1]).any(axis=1).sum())
    if failed <= good.sum():
        return failed
    for phase in range(1, RECORD.itemsize):
        count = (span.end - span.begin - phase) // RECORD.itemsize
        _, whole = _record_times(np.frombuffer(data, dtype=RECORD, count=count, offset=span.begin + phase))
        failed -= int(np.sum(whole[:-1] & whole[1:] & ~good[: count - 1]))
    return max(failed, 0)


def _read_file(path: Path) -> Scans:
    data, notes = _undo_modem(path, files.read_bytes(path))
    if _is_binary(data):
        binary = _parse_binary(data)
        number = rows.number_in_name(path) if len(binary.blocks) == 1 else UNKNOWN
        blocks = [ProfileBlock(**(vars(block) | {"number": number})) for block in binary.blocks]
        columns = binary.place, binary.time_s, binary.values
        return replace(_select_possible(path, blocks, *columns, binary.damaged, binary.failed), notes=notes)
    text = rows.parse(data if is_text(data) else b"", lambda form: form in (STAMPED, UNSTAMPED))
    if data.strip() and text.form is None and not rows.has_statements(text):
        shown = f"a file that begins with {data[:24]!r}"
        raise InputError(str(path), expected=EXPECTED, found=shown, advice="check that format and file belong together")
    profiles, place, damaged = rows.parse_profiles(text, path)
    values = text.values if text.form == STAMPED else np.full((len(text.offset), len(COLUMNS)), np.nan)
    if text.form == UNSTAMPED:
        values[:, 1:] = text.values
    scans = _select_possible(path, profiles, place, text.time_s, values, damaged, damaged - text.foreign)
    return replace(scans, strange=files.count_unprintable(data))


def _is_binary(data: bytes) -> bool:
    return _precedes_record(data, FRONT_BYTES) or bool(_find_marks(data))


def _undo_modem(path: Path, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Restore the profiles of a file that came through a modem as the meter wrote them, and describe what was undone.

    Other instruments' frames are left out, and so is a profile that was sent once more. What holds no more scans
    without frames and escapes than with them stays as it is.
    """
    profiles: list[list[bytes]] = []
    last: dict[str, list[bytes]] = {}  # of each instrument
    for payload in files.payloads(data):
        if _is_binary(payload.data):
            profiles.append(last.setdefault(payload.instrument, []))
            last[payload.instrument] = profiles[-1] = [payload.data]
        elif payload.instrument in last:  # the rest of its last profile
            last[payload.instrument].append(payload.data)
    undone = files.looks_escaped(data)
    sent = b"".join(dict.fromkeys(b"".join(parts) for parts in profiles))
    sent = sent or (files.unescape(data) if undone else b"")
    if not sent or _count_scans(sent) <= _count_scans(data):
        return data, ()
    notes = [f"{path.name} {files.ESCAPES_UNDONE}"] * undone
    if len(last) > 1:
        names = " and ".join(last)
        held = f"{path.name} holds frames of {len(last)} instruments, {names}"
        notes.append(f"{held}: give those of each as its own file")
    return sent, tuple(notes)


def _count_scans(data: bytes) -> int:
    return len(_parse_binary(data).time_s) if _is_binary(data) else 0


def _select_possible(
    path: Path, blocks: Sequence[ProfileBlock], place: Ints, clock_s: Floats, values: Floats, damaged: int, failed: int
) -> Scans:
    """Drop what no meter can log; refuse a file of which more fails than is whole.

    Args:
        damaged: rows or records that are no scans.
        failed: of these, those that are recognised as such.
    """
    profile = np.repeat(np.arange(len(blocks)), [block.end - block.begin for block in blocks])
    heading, tilts, field, paths = values[:, 0], values[:, 1:3], values[:, 3:6], values[:, 6:]
    good = np.isnan(heading) | ((heading >= -180.0) & (heading <= 360.0))
    good &= np.isfinite(field).all(axis=1) & (np.abs(tilts) <= STEEPEST_DEG).all(axis=1)
    good &= (np.abs(paths) <= FASTEST_CM_S).all(axis=1) & ~is_misplaced(clock_s, profile)
    impossible = int(np.sum(~good))
    refuse_mostly_damaged(path, "scans", damaged=failed + impossible, whole=len(good) - impossible)
    damaged += impossible
    return Scans(
        clock_s=clock_s[good],
        values=values[good],
        place=place[good],
        profile=profile[good],
        blocks=tuple(blocks),
        damaged=damaged,
        damaged_files=(str(path),) if damaged else (),
        empty_files=() if good.any() else (str(path),),
    )


def _concatenate(parts: Sequence[Scans]) -> Scans:
    """Concatenate the scans of files; profiles without a scan are dropped from the list of profiles."""
    sizes = [len(part.blocks) for part in parts]
    shift = np.cumsum([0, *sizes])
    profile = np.concatenate([part.profile + first for part, first in zip(parts, shift[:-1], strict=True)])
    blocks = [block for part in parts for block in part.blocks]
    occupied, profile = np.unique(profile, return_inverse=True)
    return Scans(
        clock_s=np.concatenate([part.clock_s for part in parts]),
        values=np.concatenate([part.values for part in parts]),
        place=np.concatenate([part.place for part in parts]),
        profile=profile,
        blocks=tuple(blocks[k] for k in occupied),
        damaged=sum(part.damaged for part in parts),
        damaged_files=tuple(file for part in parts for file in part.damaged_files),
        empty_files=tuple(file for part in parts for file in part.empty_files),
        strange=sum(part.strange for part in parts),
        notes=tuple(note for part in parts for note in part.notes),
    )


def _precedes_record(data: bytes, end: int) -> bool:
    """Return whether in front of this place stands the length of a profile and behind it a record."""
    length = int.from_bytes(data[end - FRONT_BYTES : end - HEADER_BYTES], "big")
    first = np.frombuffer(data[end : end + RECORD.itemsize].ljust(RECORD.itemsize, b"\0"), dtype=RECORD)
    good = bool(_record_times(first)[1][0])
    return good and (_is_profile_length(length) or data[end - len(MARK) : end] == MARK)


def _record_times(records: np.ndarray) -> tuple[Floats, Bools]:
    number = {name: records[name].astype(np.int64) for name in ("year", "month", "day", "clock")}
    time_s = civil_seconds(number["year"], number["month"], number["day"], *number["clock"].T)
    return time_s, np.isfinite(time_s) & np.isfinite(records["values"]).all(axis=1)


def _is_profile_length(length: int) -> bool:
    return length >= HEADER_BYTES and (length - HEADER_BYTES) % RECORD.itemsize == 0


def _find_marks(data: bytes) -> list[int]:
    """Find where headers end: behind DATA, what is before like the first header or with a profile behind it."""
    ends: list[int] = []
    at = data.find(MARK)
    while at >= 0:
        end = at + len(MARK)
        if end >= FRONT_BYTES and (_precedes_record(data, end) or (ends and _like_header(data, ends[0], end))):
            ends.append(end)
        at = data.find(MARK, at + 1)
    return ends


def _like_header(data: bytes, first: int, other: int) -> bool:
    a, b = (np.frombuffer(data, np.uint8, HEADER_BYTES, end - HEADER_BYTES) for end in (first, other))
    return bool(np.mean(a == b) >= LIKENESS)


def _spans(data: bytes) -> Iterator[_Span]:
    """Go from profile to profile; where a length leads to no header go on to the next one that is recognised."""
    marks = _find_marks(data) or [FRONT_BYTES]
    at = 0
    while at < len(data):
        mark = at + FRONT_BYTES
        if mark in marks or (mark < len(data) and _like_header(data, marks[0], mark)):
            following = marks[bisect_left(marks, mark + FRONT_BYTES) :]
            span = _span(data, mark, following[0] - FRONT_BYTES if following else len(data), last=not following)
        else:
            following = marks[bisect_right(marks, mark) :]
            limit = following[0] - FRONT_BYTES if following else len(data)
            # As many records as one profile of this size would hold.
            span = _Span(at, limit, 0, torn=max(1, (limit - mark - TAIL_BYTES) // RECORD.itemsize))
        yield span
        at = span.end


def _span(data: bytes, mark: int, limit: int, *, last: bool) -> _Span:
    """Locate the records behind a header: as many as its length says, unless what follows says otherwise.

    A profiler that sends every so many scans of a profile leaves the length of the whole in front of them.
    """
    length = int.from_bytes(data[mark - FRONT_BYTES : mark - HEADER_BYTES], "big")
    stated = (length - HEADER_BYTES) // RECORD.itemsize if _is_profile_length(length) else -1
    fit, odd = divmod(limit - mark - TAIL_BYTES, RECORD.itemsize)
    if odd == 0 and fit >= 0 and (stated <= fit or not last or _ends_in_switch_times(data, mark, limit - TAIL_BYTES)):
        return _Span(mark, limit, fit, limit - TAIL_BYTES)
    end = mark + stated * RECORD.itemsize
    if stated >= 0 and end + TAIL_BYTES <= limit:
        return _Span(mark, end + TAIL_BYTES, stated, end)
    if stated >= 0 and last and end <= limit:
        return _Span(mark, limit, stated)
    fit, odd = divmod(limit - mark, RECORD.itemsize)
    return _Span(mark, limit, fit, torn=int(odd > 0))


def _ends_in_switch_times(data: bytes, begin: int, tail: int) -> bool:
    """Return whether times of switching on and off stand there, near the record that stands first."""
    first_s, good = _record_times(np.frombuffer(data, dtype=RECORD, count=int(tail > begin), offset=begin))
    on, off = np.frombuffer(data, ">u4", 2, tail).astype(float)
    return bool(good.any()) and abs(on - first_s[0]) < DAY_S and on <= off < on + LONGEST_S


def is_misplaced(clock_s: Floats, profile: Ints) -> Bools:
    """Flag a single clock that stands apart from both of its neighbours in the same profile, (r,); NaN never does."""
    apart = np.zeros(len(clock_s), dtype=bool)
    if len(clock_s) > 2:
        step = np.where(np.diff(profile) == 0, np.diff(clock_s), 0.0)
        with np.errstate(invalid="ignore"):
            far = (np.abs(step[:-1]) > MISPLACED_S) & (np.abs(step[1:]) > MISPLACED_S)
            apart[1:-1] = far & (step[:-1] * step[1:] < 0)
    return apart


def sample_rates(clock_s: Floats, profile: Ints, place: Ints, nominal_hz: Floats) -> Floats:
    """Choose each profile's sample rate: the nominal one, unless the clock shows another.

    Args:
        place: (r,) in the profile, damaged scans counted.
        nominal_hz: (p,) NaN where the file names none.
    """
    count = len(nominal_hz)
    first, last = (np.searchsorted(profile, np.arange(count), side=side) for side in ("left", "right"))
    known = np.flatnonzero(last - first > FEW)
    begin, end = first[known], last[known] - 1
    shown = np.full(count, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        shown[known] = (place[end] - place[begin]) / (clock_s[end] - clock_s[begin])
        contradicts = np.isfinite(shown) & ~(np.abs(shown / nominal_hz - 1.0) < TRUSTED_RATE)
    return np.where(contradicts, shown, nominal_hz)


def interpolate_clock(clock_s: Floats, profile: Ints, rate_hz: Floats) -> Floats:
    """Add sub-seconds to the clock of whole seconds: scans that share one are spread over it, in their order.

    The rate is that which the file names, (r,), NaN where it does not.
    """
    if not len(clock_s):
        return clock_s
    new = np.append(True, (np.diff(clock_s) != 0) | (np.diff(profile) != 0))
    begins = np.flatnonzero(new)
    group = np.cumsum(new) - 1
    size = np.diff(np.append(begins, len(new)))[group]
    return clock_s + (np.arange(len(new)) - begins[group]) / np.fmax(size, rate_hz)


def follows_previous(clock_s: Floats, profile: Ints, place: Ints, rate_hz: Floats) -> Bools:
    """Return whether each scan follows the one before without a gap, (r - 1,); arguments as for ``sample_rates``."""
    step = np.diff(clock_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Whole seconds hide up to one of them.
        waited = (step < 0) | (step > 1.0 + 1.0 / rate_hz[1:])
    return (np.diff(profile) == 0) & (np.diff(place) == 1) & ~waited
