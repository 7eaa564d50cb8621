"""Read the files of a Falmouth 3D-ACM on a McLane profiler: unpacked ASCII or binary, distinguished by their content.

An ASCII row is a time stamp and HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH, separated by spaces or commas; rows of early
instruments have neither clock nor heading, but nine numbers from TX on. Binary records hold a clock and the same ten.

A binary file (A*.DAT) holds one or several profiles: four bytes of length (big-endian), a header of 279 bytes that ends
in DATA, records of 47 bytes, and the switch-on and switch-off times. Lengths lead to the next profile; if damaged, the
next header is searched for.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.readers.mmp import rows
from compasslib.readers.mmp.rows import UNKNOWN, Ints, ProfileBlock
from compasslib.readers.times import civil_seconds
from compasslib.records import take
from compasslib.types import DAY_S, Bools, Floats

COLUMNS = ("HDNG", "TX", "TY", "HX", "HY", "HZ", "VPAB", "VPCD", "VPEF", "VPGH")
STAMPED, UNSTAMPED = (True, 10), (False, 9)
EXPECTED = "unpacked ASCII or binary scans of a Falmouth 3D-ACM"
MARK = b"DATA"  # the end of the header
FRONT = np.dtype([("length", ">u4"), ("settings", "V63"), ("rate_hz", "<f4"), ("instrument", "V208"), ("mark", "S4")])
RECORD = np.dtype([("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))])
TAIL = np.dtype([("on_s", ">u4"), ("off_s", ">u4")])  # UTC seconds since 1970
HEADER_BYTES = FRONT.itemsize - FRONT["length"].itemsize  # of which ``length`` counts all, and the records


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


@dataclass(frozen=True)
class _Span:
    """Byte range of the records of one profile, or of unrecognized bytes outside profiles."""

    begin: int
    end: int  # after the records and the switch-on and switch-off times
    records: int
    tail: int = -1  # offset of those times, -1 if they are lost
    torn: int = 0  # estimated number of records in bytes that cannot be divided into records


def read_scans(paths: Sequence[Path]) -> Scans:
    """Read the scans of several files, unpacked ASCII or binary, in the order given.

    Raises:
        InputError: a file is unreadable or of neither kind, or no file holds a scan.
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
    """Return whether a file consists mostly of printable characters, ignoring the fill of erased memory at its end."""
    sample = data[:65536].rstrip(b"\x00\xff")
    return not data or files.count_unprintable(sample) < 0.05 * len(sample)


def _parse_binary(data: bytes) -> tuple[Scans, int]:
    """Parse the records of a binary file, and count those that are recognizable but damaged."""
    blocks: list[ProfileBlock] = []
    places, profiles = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)]
    times: list[Floats] = [np.zeros(0)]
    values: list[Floats] = [np.zeros((0, RECORD["values"].shape[0]))]
    damaged, failed, begin = 0, 0, 0
    for span in _spans(data):
        damaged += span.torn
        if not span.records:
            continue
        records = np.frombuffer(data, dtype=RECORD, count=span.records, offset=span.begin)
        time_s, good = _record_times(records)
        if good.any():
            last = int(np.flatnonzero(good)[-1])
            # A float of which only the first bytes were written is smaller than any speed.
            ends_in_zeros = abs(float(records["values"][last, -1])) < 1e-30
            good[last] = not ends_in_zeros or any(data[span.begin + (last + 1) * RECORD.itemsize : span.end])
        end = begin + int(good.sum())
        rate = float(np.frombuffer(data, FRONT, 1, span.begin - FRONT.itemsize)["rate_hz"][0])
        on, off = np.frombuffer(data, TAIL, 1, span.tail)[0].item() if span.tail >= 0 else (np.nan, np.nan)
        profiles.append(np.full(end - begin, len(blocks)))
        blocks.append(ProfileBlock(begin, end, UNKNOWN, rate if 0 < rate < 100 else np.nan, float(on), float(off)))
        places.append(np.flatnonzero(good))
        times.append(time_s[good])
        values.append(records["values"][good].astype(float))
        failed += _count_failed(data, span, records, good)
        damaged, begin = damaged + int(np.sum(~good)), end
    of_scans = np.concatenate(places), np.concatenate(profiles)
    return Scans(np.concatenate(times), np.concatenate(values), *of_scans, tuple(blocks), damaged), failed


def _count_failed(data: bytes, span: _Span, records: np.ndarray, good: Bools) -> int:
    """Count the invalid records of a profile, except padding with one byte and intact records at a shifted position."""
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
        scans, failed = _parse_binary(data)
        if len(scans.blocks) == 1:
            scans = replace(scans, blocks=(replace(scans.blocks[0], number=rows.number_in_name(path)),))
        return replace(_select_possible(path, scans, failed), notes=notes)
    text = rows.parse(data if is_text(data) else b"", lambda form: form in (STAMPED, UNSTAMPED))
    if data.strip() and text.form is None and not text.statements:
        shown = f"a file that begins with {data[:24]!r}"
        raise InputError(str(path), expected=EXPECTED, found=shown, advice="check that format and file belong together")
    blocks, place = rows.parse_profiles(text, path)
    values = np.full((len(place), len(COLUMNS)), np.nan)
    values[:, len(COLUMNS) - text.values.shape[1] :] = text.values
    profile = np.repeat(np.arange(len(blocks)), [block.end - block.begin for block in blocks])
    scans = Scans(text.time_s, values, place, profile, tuple(blocks), len(text.damaged))
    strange = files.count_unprintable(data)
    return replace(_select_possible(path, scans, len(text.damaged) - text.foreign), strange=strange)


def _is_binary(data: bytes) -> bool:
    return _precedes_record(data, FRONT.itemsize) or bool(_find_marks(data))


def _undo_modem(path: Path, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Remove the framing and escapes of a modem from the profiles of a file, and describe the changes.

    Frames of other instruments and repeated profiles are dropped. Data that hold no more scans without framing and
    escapes than with them are returned unchanged.
    """
    profiles: list[list[bytes]] = []
    last: dict[str, list[bytes]] = {}  # last profile of each instrument
    for instrument, content in files.payloads(data):
        if _is_binary(content):
            last[instrument] = [content]
            profiles.append(last[instrument])
        elif instrument in last:  # continues the last profile of the instrument
            last[instrument].append(content)
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
    return len(_parse_binary(data)[0].place) if _is_binary(data) else 0


def _select_possible(path: Path, scans: Scans, failed: int) -> Scans:
    """Drop scans with impossible values; raise an error if more scans are damaged than intact.

    Args:
        failed: number of damaged scans that are recognizable as such: neither padding nor shifted by lost bytes.
    """
    heading, tilts, field, paths = np.split(scans.values, (1, 3, 6), axis=1)
    good = (np.isnan(heading) | ((heading >= -180.0) & (heading <= 360.0)))[:, 0]
    good &= np.isfinite(field).all(axis=1) & (np.abs(tilts) <= 180.0).all(axis=1)  # degrees
    good &= (np.abs(paths) <= 2000.0).all(axis=1) & ~is_misplaced(scans.clock_s, scans.profile)  # cm/s
    impossible = int(np.sum(~good))
    refuse_mostly_damaged(path, "scans", damaged=failed + impossible, whole=len(good) - impossible)
    damaged = scans.damaged + impossible
    return replace(
        take(scans, good),
        damaged=damaged,
        damaged_files=(str(path),) if damaged else (),
        empty_files=() if good.any() else (str(path),),
    )


def _concatenate(parts: Sequence[Scans]) -> Scans:
    """Concatenate the scans of several files, dropping profiles without scans."""
    shift = np.cumsum([0, *(len(part.blocks) for part in parts)])
    profile = np.concatenate([part.profile + first for part, first in zip(parts, shift[:-1], strict=True)])
    blocks = [block for part in parts for block in part.blocks]
    occupied, profile = np.unique(profile, return_inverse=True)
    joined: dict[str, Any] = {}
    for name, value in vars(parts[0]).items():
        each = [getattr(part, name) for part in parts]
        joined[name] = np.concatenate(each) if isinstance(value, np.ndarray) else sum(each, type(value)())
    return Scans(**joined | {"profile": profile, "blocks": tuple(blocks[k] for k in occupied)})


def _precedes_record(data: bytes, end: int) -> bool:
    """Return whether a header ends here: a valid record follows, and a valid profile length or DATA precedes."""
    length = int.from_bytes(data[end - FRONT.itemsize : end - HEADER_BYTES], "big")
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
    """Find the ends of headers: positions after DATA that precede a record, or whose header resembles the first."""
    ends: list[int] = []
    at = data.find(MARK)
    while at >= 0:
        end = at + len(MARK)
        if end >= FRONT.itemsize and (_precedes_record(data, end) or (ends and _like_header(data, ends[0], end))):
            ends.append(end)
        at = data.find(MARK, at + 1)
    return ends


def _like_header(data: bytes, first: int, other: int, alike: float = 0.8) -> bool:
    """Return whether a share of the bytes equals the first header of the file, as settings do not change."""
    a, b = (np.frombuffer(data, np.uint8, HEADER_BYTES, end - HEADER_BYTES) for end in (first, other))
    return bool(np.mean(a == b) >= alike)


def _spans(data: bytes) -> Iterator[_Span]:
    """Iterate over profiles; where a length does not lead to a header, continue at the next recognized one."""
    marks = _find_marks(data) or [FRONT.itemsize]
    at = 0
    while at < len(data):
        mark = at + FRONT.itemsize
        if mark in marks or (mark < len(data) and _like_header(data, marks[0], mark)):
            following = marks[bisect_left(marks, mark + FRONT.itemsize) :]
            span = _span(data, mark, following[0] - FRONT.itemsize if following else len(data), last=not following)
        else:
            following = marks[bisect_right(marks, mark) :]
            limit = following[0] - FRONT.itemsize if following else len(data)
            # Estimate the lost records by the size, as of a single profile.
            span = _Span(at, limit, 0, torn=max(1, (limit - mark - TAIL.itemsize) // RECORD.itemsize))
        yield span
        at = span.end


def _span(data: bytes, mark: int, limit: int, *, last: bool) -> _Span:
    """Locate the records after a header: as many as its length states, unless the following bytes contradict it.

    A profiler that transmits a subset of the scans of a profile leaves the original length in front of them.
    """
    length = int.from_bytes(data[mark - FRONT.itemsize : mark - HEADER_BYTES], "big")
    stated = (length - HEADER_BYTES) // RECORD.itemsize if _is_profile_length(length) else -1
    tail = limit - TAIL.itemsize
    fit, odd = divmod(tail - mark, RECORD.itemsize)
    if odd == 0 and fit >= 0 and (stated <= fit or not last or _ends_in_switch_times(data, mark, tail)):
        return _Span(mark, limit, fit, tail)
    end = mark + stated * RECORD.itemsize
    if stated >= 0 and end + TAIL.itemsize <= limit:
        return _Span(mark, end + TAIL.itemsize, stated, end)
    if stated >= 0 and last and end <= limit:
        return _Span(mark, limit, stated)
    fit, odd = divmod(limit - mark, RECORD.itemsize)
    return _Span(mark, limit, fit, torn=int(odd > 0))


def _ends_in_switch_times(data: bytes, begin: int, tail: int) -> bool:
    """Return whether ``tail`` holds plausible switch-on and switch-off times, near the time of the first record."""
    first_s, good = _record_times(np.frombuffer(data, dtype=RECORD, count=int(tail > begin), offset=begin))
    on, off = np.frombuffer(data, TAIL, 1, tail)[0].item()
    return bool(good.any()) and abs(on - first_s[0]) < DAY_S and on <= off < on + 30 * DAY_S


def is_misplaced(clock_s: Floats, profile: Ints, jump_s: float = 2.0) -> Bools:
    """Flag single times that jump away from both neighbours in the same profile, (r,); NaN is never flagged."""
    apart = np.zeros(len(clock_s), dtype=bool)
    if len(clock_s) > 2:
        step = np.where(np.diff(profile) == 0, np.diff(clock_s), 0.0)
        with np.errstate(invalid="ignore"):
            far = (np.abs(step[:-1]) > jump_s) & (np.abs(step[1:]) > jump_s)
            apart[1:-1] = far & (step[:-1] * step[1:] < 0)
    return apart


def sample_rates(
    clock_s: Floats, profile: Ints, place: Ints, nominal_hz: Floats, *, few: int = 10, close: float = 0.2
) -> Floats:
    """Choose the sample rate of each profile, (p,) Hz: the nominal one, unless the clock contradicts it.

    Args:
        place: (r,) index of each scan in its profile, including damaged scans.
        nominal_hz: (p,) NaN where the file states none.
        few: number of scans up to which a clock of whole seconds does not determine the rate.
        close: largest relative difference of the two rates.
    """
    count = len(nominal_hz)
    first, last = (np.searchsorted(profile, np.arange(count), side=side) for side in ("left", "right"))
    known = np.flatnonzero(last - first > few)
    begin, end = first[known], last[known] - 1
    shown = np.full(count, np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        shown[known] = (place[end] - place[begin]) / (clock_s[end] - clock_s[begin])
        contradicts = np.isfinite(shown) & ~(np.abs(shown / nominal_hz - 1.0) < close)
    return np.where(contradicts, shown, nominal_hz)


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


def follows_previous(clock_s: Floats, profile: Ints, place: Ints, rate_hz: Floats) -> Bools:
    """Return whether each scan follows the previous one without a gap, (r - 1,); ``rate_hz`` is per scan, (r,)."""
    step = np.diff(clock_s)
    with np.errstate(invalid="ignore", divide="ignore"):
        # Whole seconds may conceal a difference of up to one second.
        waited = (step < 0) | (step > 1.0 + 1.0 / rate_hz[1:])
    return (np.diff(profile) == 0) & (np.diff(place) == 1) & ~waited
