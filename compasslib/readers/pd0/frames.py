"""Find the ensembles of a PD0 file among arbitrary other bytes.

An ensemble is 7F 7F, its length L without the checksum, a table of offsets, its blocks, and at L the sum of all bytes
before it modulo 65,536. Runs of ensembles with the same layout are checked as one matrix. Only if that fails are all
7F 7F of the chunk searched, where a cumulative sum yields the checksums of all candidates at once, so that the cost is
linear in the length even of malicious input. Source: RDI, WorkHorse Commands and Output Data Format, PD0.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers import files

Bytes: TypeAlias = NDArray[np.uint8]
Places: TypeAlias = NDArray[np.int64]

FIXED_LEADERS, VARIABLE_LEADERS = (0x0000, 0x0001), (0x0080, 0x0081)
SHORTEST_FIXED, SHORTEST_VARIABLE = 34, 28  # bytes including the distance of bin 1; including the temperature
CHECKSUM, PAST_THE_END, NO_ENSEMBLE = "checksum", "length runs past the end of the file", "not an ensemble"
BEFORE_THE_FIRST = "junk before the first ensemble"

_MARK = 0x7F
_HEADER = 8  # bytes up to and including the first offset, needed to check a candidate
_SHORTEST = _HEADER + SHORTEST_FIXED + SHORTEST_VARIABLE


@dataclass(frozen=True, eq=False)
class Layout:
    """Positions of the blocks in an ensemble; ensembles with equal signatures have equal layouts."""

    signature: bytes  # header, identifiers of the blocks, number of bins
    columns: Places  # byte offsets of the signature in the ensemble
    length: int  # bytes before the checksum
    cells: int  # number of bins
    blocks: dict[int, tuple[int, int]]  # identifier -> offsets of its begin and of the next block


@dataclass(frozen=True, eq=False)
class EnsembleRun:
    """Consecutive ensembles of one layout without gaps."""

    offset: int  # byte offset of the first ensemble in the file
    rows: Bytes  # (k, length + 2), a view into the chunk
    layout: Layout


@dataclass(frozen=True)
class Skipped:
    """Range of bytes that belong to no intact ensemble."""

    offset: int
    length: int
    reason: str
    damaged: int  # number of places that begin like a complete ensemble but fail its checksum
    failed: int = 0  # number of these with a valid offset of a fixed leader, i.e. not a chance 7F 7F


@dataclass(frozen=True)
class Chunk:
    """Content of one chunk of the file, in file order."""

    runs: tuple[EnsembleRun, ...]
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Sorted byte offsets in a chunk at which an ensemble may start."""

    good: Places  # with a valid checksum
    failed: Places  # with an invalid checksum
    cut: Places  # truncated by the end of the chunk


def iter_chunks(path: str | PathLike[str], chunk_bytes: int = files.CHUNK_BYTES) -> Iterator[Chunk]:
    """Iterate over the ensembles of a file and the bytes between them; together they cover the whole file.

    Args:
        chunk_bytes: bytes read at a time; the ensembles and byte ranges found do not depend on it.

    Raises:
        InputError: the file cannot be opened or read.
    """
    pending: Skipped | None = None
    begun = False
    for items, last in _scan_file(path, max(1, chunk_bytes)):
        skipped: list[Skipped] = []
        for item in items:
            if isinstance(item, Skipped):
                pending = _merge(pending, item)
                continue
            if pending and not begun and pending.reason == NO_ENSEMBLE:
                pending = replace(pending, reason=BEFORE_THE_FIRST)
            skipped += [pending] if pending else []
            pending, begun = None, True
        # A range may continue in the next chunk: yield it only when an ensemble or the end of the file follows.
        skipped += [pending] if last and pending else []
        yield Chunk(tuple(item for item in items if isinstance(item, EnsembleRun)), tuple(skipped))


def _merge(before: Skipped | None, after: Skipped) -> Skipped:
    if before is None:
        return after
    added = {name: getattr(before, name) + getattr(after, name) for name in ("length", "damaged", "failed")}
    return replace(before, **added)


def _scan_file(path: str | PathLike[str], chunk_bytes: int) -> Iterator[tuple[list[EnsembleRun | Skipped], bool]]:
    offset, tail, last = 0, b"", False
    undo = is_escaped(path)
    with _opened(path) as file:
        while not last:
            piece = _read(file, path, chunk_bytes)
            while undo and piece.endswith(files.ESCAPE) and (more := _read(file, path, 1)):
                piece += more
            piece = files.unescape(piece) if undo else piece
            last = not piece
            data = np.frombuffer(tail + piece, dtype=np.uint8)
            items, used = _scan(data, offset, last)
            yield items, last
            offset, tail = offset + used, data[used:].tobytes()


def is_escaped(path: str | PathLike[str]) -> bool:
    """Return whether the file contains a modem's escapes, whose removal yields more intact ensembles at its start."""
    with _opened(path) as file:
        sample = _read(file, path, files.CHUNK_BYTES)
    return files.looks_escaped(sample) and _count_good(files.unescape(sample)) > _count_good(sample)


def _count_good(data: bytes) -> int:
    items, _ = _scan(np.frombuffer(data, dtype=np.uint8), 0, True)
    return sum(len(item.rows) for item in items if isinstance(item, EnsembleRun))


def _opened(path: str | PathLike[str]) -> BinaryIO:
    try:
        return Path(path).open("rb", buffering=0)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from None


def _read(file: BinaryIO, path: str | PathLike[str], count: int) -> bytes:
    try:
        return file.read(count)
    except OSError as error:
        raise _unreadable(path, error) from None


def _unreadable(path: str | PathLike[str], error: Exception) -> InputError:
    shown = getattr(error, "strerror", None) or str(error)
    advice = "check the path and its permissions, and name files, not folders"
    return InputError(str(path), expected="a PD0 file that can be read", found=shown, advice=advice)


def _scan(data: Bytes, offset: int, last: bool) -> tuple[list[EnsembleRun | Skipped], int]:
    items: list[EnsembleRun | Skipped] = []
    candidates: _Candidates | None = None
    start = 0
    while start < data.size:
        layout = layout_at(data, start)
        count = _count_run(data, start, layout) if layout else 0
        if layout and count:
            stop = start + count * (layout.length + 2)
            items.append(EnsembleRun(offset + start, data[start:stop].reshape(count, -1), layout))
        else:
            candidates = candidates or _find_candidates(data, start, last)
            stop = _next_start(data, start, candidates, last)
            if stop == start:
                break
            items.append(_describe_skipped(data, candidates, start, stop, offset))
        start = stop
    return items, start


def layout_at(data: Bytes, start: int) -> Layout | None:
    """Parse the layout of the ensemble at an offset; None if the bytes are not a complete ensemble."""
    if data.size - start < _HEADER or data[start] != _MARK or data[start + 1] != _MARK:
        return None
    length, types = int(data[start + 2]) + 256 * int(data[start + 3]), int(data[start + 5])
    if length < _SHORTEST or length < 6 + 2 * types or start + length + 2 > data.size:
        return None
    columns = _columns(data[start : start + 6 + 2 * types].tobytes())
    return None if columns is None else _layout(data[start + columns].tobytes())


def _offsets(header: bytes) -> list[int]:
    """Parse the block offsets inside the ensemble; empty if the first, that of the fixed leader, lies outside."""
    length = int.from_bytes(header[2:4], "little")
    table = [int.from_bytes(header[i : i + 2], "little") for i in range(6, len(header), 2)]
    if not table or not len(header) <= table[0] <= length - SHORTEST_FIXED:
        return []
    return [offset for offset in table if len(header) <= offset <= length - 2]


@lru_cache(maxsize=4096)
def _columns(header: bytes) -> Places | None:
    offsets = np.array(_offsets(header), dtype=np.int64)
    if not offsets.size:
        return None
    identifiers = np.stack([offsets, offsets + 1], axis=1).ravel()
    return np.concatenate([np.arange(len(header)), identifiers, offsets[:1] + 9])


@lru_cache(maxsize=4096)
def _layout(signature: bytes) -> Layout | None:
    size = 6 + 2 * signature[5]
    header = signature[:size]
    length = int.from_bytes(header[2:4], "little")
    offsets = _offsets(header)
    stops = sorted({*offsets, length})
    blocks: dict[int, tuple[int, int]] = {}
    for place, start in enumerate(offsets):
        identifier = int.from_bytes(signature[size + 2 * place : size + 2 * place + 2], "little")
        blocks.setdefault(identifier, (start, next(stop for stop in stops if stop > start)))
    columns = _columns(header)
    if columns is None:
        return None
    fixed = [b - a for i, (a, b) in blocks.items() if i in FIXED_LEADERS and a == offsets[0]]
    variable = [b - a for i, (a, b) in blocks.items() if i in VARIABLE_LEADERS]
    if max(fixed, default=0) < SHORTEST_FIXED or max(variable, default=0) < SHORTEST_VARIABLE:
        return None
    return Layout(signature, columns, length, signature[-1], blocks)


def _count_run(data: Bytes, start: int, layout: Layout, window: int = 1 << 19) -> int:
    """Count the consecutive intact ensembles of one layout from ``start`` on, checked in windows of growing size.

    A window of at most 0.5 MB stays in the processor's cache.
    """
    stride = layout.length + 2
    most = (data.size - start) // stride
    done, step = 0, 1
    while done < most:
        at = start + done * stride
        rows = data[at : at + min(step, most - done) * stride].reshape(-1, stride)
        length = layout.length
        sums = rows[:, :length].sum(axis=1, dtype=np.uint16)  # wraps modulo 65,536, as the checksum does
        stored = rows[:, length] + rows[:, length + 1].astype(np.uint16) * np.uint16(256)
        same = rows[:, layout.columns] == np.frombuffer(layout.signature, dtype=np.uint8)
        good = np.asarray((sums == stored) & same.all(axis=1))
        if not good.all():
            return done + int(good.argmin())
        done += len(rows)
        step = max(1, min(8 * step, window // stride))
    return done


def _find_candidates(whole_data: Bytes, begin: int, last: bool) -> _Candidates:
    data = whole_data[begin:]
    marks = np.flatnonzero((data[:-1] == _MARK) & (data[1:] == _MARK))
    headless = marks + _HEADER > data.size
    marks, cut = marks[~headless], [marks[headless]]
    length = _pair(data, marks + 2)
    likely = length >= _SHORTEST
    whole = marks + length + 2 <= data.size
    cut.append(marks[likely & ~whole])
    if not last:
        # An ensemble may begin in the last bytes of the chunk.
        cut.append(np.array([max(0, data.size - _HEADER + 1)]))
    marks, length = marks[likely & whole], length[likely & whole]
    sums = np.concatenate([np.zeros(1, np.uint16), np.cumsum(data, dtype=np.uint16)])
    holds = (sums[marks + length] - sums[marks]) == _pair(data, marks + length)
    return _Candidates(begin + marks[holds], begin + marks[~holds], begin + np.unique(np.concatenate(cut)))


def _pair(data: Bytes, at: Places) -> Places:
    return data[at].astype(np.int64) + 256 * data[at + 1].astype(np.int64)


def _next_start(data: Bytes, start: int, candidates: _Candidates, last: bool) -> int:
    """Find the offset at which the next ensemble begins, or may begin once more of the file is read."""
    cut = candidates.cut[np.searchsorted(candidates.cut, start) :]
    undecided = data.size if last else int(cut[0]) if cut.size else start
    for place in candidates.good[np.searchsorted(candidates.good, start) :]:
        if place >= undecided:
            break
        if layout_at(data, int(place)):
            return int(place)
    return undecided


def _describe_skipped(data: Bytes, candidates: _Candidates, start: int, stop: int, offset: int) -> Skipped:
    first, end = np.searchsorted(candidates.failed, [start, stop])
    # Count failed candidates whose first offset points to a fixed leader directly after the table of offsets.
    at = candidates.failed[first:end]
    leader = 6 + 2 * data[at + 5].astype(np.int64)
    fits = (_pair(data, at + 6) == leader) & (leader + 2 <= _pair(data, at + 2))
    failed = int(np.sum(fits & np.isin(_pair(data, at + np.where(fits, leader, 0)), FIXED_LEADERS)))
    reason = NO_ENSEMBLE
    if first < end and candidates.failed[first] == start:
        reason = CHECKSUM
    elif start in candidates.cut:
        reason = PAST_THE_END
    return Skipped(offset + start, stop - start, reason, int(end - first), failed)
