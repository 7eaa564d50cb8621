"""Read the files of a Falmouth 3D-ACM on a McLane profiler: unpacked ASCII or binary, distinguished by their content.

An ASCII row is a time stamp and HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH, separated by spaces or commas; rows of early
instruments have neither clock nor heading, but nine numbers from TX on. Binary records hold a clock and the same ten.

A binary file (A*.DAT) holds one or several profiles: four bytes of length (big-endian), a header of 279 bytes that ends
in DATA, records of 47 bytes, and the switch-on and switch-off times. Records are found by their content, so that lost
bytes or a damaged header cost no other record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.readers.mmp import rows
from compasslib.readers.mmp.rows import PAUSE_S, UNKNOWN, Ints, ProfileBlock
from compasslib.readers.times import FIRST_YEAR, LAST_YEAR, civil_seconds
from compasslib.records import take
from compasslib.types import DAY_S, Bools, Floats

COLUMNS = ("HDNG", "TX", "TY", "HX", "HY", "HZ", "VPAB", "VPCD", "VPEF", "VPGH")
STAMPED, UNSTAMPED = (True, 10), (False, 9)
EXPECTED = "unpacked ASCII or binary scans of a Falmouth 3D-ACM"
MARK = b"DATA"  # the end of the header
FRONT = np.dtype([("length", ">u4"), ("settings", "V63"), ("rate_hz", "<f4"), ("instrument", "V208"), ("mark", "S4")])
RECORD = np.dtype([("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))])
TAIL = np.dtype([("on_s", ">u4"), ("off_s", ">u4")])  # UTC seconds since 1970
BETWEEN = TAIL.itemsize + FRONT.itemsize  # bytes between the records of two profiles


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
    good = np.isfinite(record_times(records)) & np.isfinite(records["values"]).all(axis=1)
    at, records = at[good], records[good]
    if (np.diff(at) >= size).all():
        return at, records
    apart, end = np.ones(len(at), dtype=bool), 0
    for k, begin in enumerate(at.tolist()):
        apart[k] = begin >= end
        end = begin + size if begin >= end else end
    return at[apart], records[apart]


def record_times(records: np.ndarray) -> Floats:
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
    time_s, end = record_times(records), at + RECORD.itemsize
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


def _read_file(path: Path) -> Scans:
    data, notes = _undo_modem(path, files.read_bytes(path))
    at, records = _find_records(data)
    if (np.diff(at) == RECORD.itemsize).any() or _follows_mark(data, at).any():
        scans, failed = _parse_binary(data, at, records)
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


def _undo_modem(path: Path, data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Remove the framing and escapes of a modem from the profiles of a file, and describe the changes.

    Frames of other instruments and repeated profiles are dropped. Data without frames that hold no more scans without
    escapes than with them are returned unchanged.
    """
    profiles: list[list[bytes]] = []
    last: dict[str, list[bytes]] = {}  # last profile of each instrument
    for instrument, content in files.payloads(data):
        if content[FRONT.itemsize - len(MARK) : FRONT.itemsize] == MARK:
            last[instrument] = [content]
            profiles.append(last[instrument])
        elif instrument in last:  # continues the last profile of the instrument
            last[instrument].append(content)
    undone = files.looks_escaped(data)
    sent = b"".join(dict.fromkeys(b"".join(parts) for parts in profiles))
    if undone and not profiles:
        sent = files.unescape(data)
        sent = sent if len(_find_records(sent)[0]) > len(_find_records(data)[0]) else b""
    if not sent:
        return data, ()
    notes = [f"{path.name} {files.ESCAPES_UNDONE}"] * undone
    if len(last) > 1:
        names = " and ".join(last)
        held = f"{path.name} holds frames of {len(last)} instruments, {names}"
        notes.append(f"{held}: give those of each as its own file")
    return sent, tuple(notes)


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
