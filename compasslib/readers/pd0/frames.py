"""Find the ensembles of a PD0 file among arbitrary other bytes.

An ensemble is 7F 7F, its length L without the checksum, a table of offsets, its blocks, and at L the sum of all bytes
before it modulo 65,536. Runs of ensembles with the same layout are checked as one matrix. Only if that fails are all
7F 7F of the next 2 MB searched, where a cumulative sum yields the checksums of all candidates at once, so that the cost
is linear in the length even of malicious input. Source: RDI, WorkHorse Commands and Output Data Format, PD0.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from compasslib.readers import files

Bytes: TypeAlias = NDArray[np.uint8]
Places: TypeAlias = NDArray[np.int64]

FIXED_LEADERS, VARIABLE_LEADERS = (0x0000, 0x0001), (0x0080, 0x0081)
SHORTEST_FIXED, SHORTEST_VARIABLE = 34, 28  # bytes including the distance of bin 1; including the temperature
CHECKSUM, PAST_THE_END, NO_ENSEMBLE = "checksum", "length runs past the end of the file", "not an ensemble"

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
    count: int
    layout: Layout
    source: Path | Bytes  # the file, or its bytes

    @property
    def size(self) -> int:
        """Number of bytes."""
        return self.count * (self.layout.length + 2)

    @property
    def rows(self) -> Bytes:
        """Bytes of each ensemble, (k, length + 2), read on access."""
        if isinstance(self.source, Path):
            data = np.fromfile(self.source, dtype=np.uint8, count=self.size, offset=self.offset)
        else:
            data = self.source[self.offset : self.offset + self.size]
        return data.reshape(self.count, -1)


@dataclass(frozen=True)
class Skipped:
    """Range of bytes that belong to no intact ensemble."""

    offset: int
    length: int
    reason: str
    damaged: int  # number of places that begin like a complete ensemble but fail its checksum
    failed: int = 0  # number of these with a valid offset of a fixed leader, i.e. not a chance 7F 7F


@dataclass(frozen=True, eq=False)
class _Candidates:
    """Sorted byte offsets, in one window of the file, at which a complete ensemble may start."""

    good: Places  # with a valid checksum
    failed: Places  # with an invalid checksum
    led: Places  # of the failed, those whose first offset points to a fixed leader directly behind the offsets


def find_ensembles(path: str | Path) -> tuple[list[EnsembleRun], list[Skipped]]:
    """Find the ensembles of a file and the bytes between them; together they cover the whole file.

    Raises:
        InputError: the file cannot be read.
    """
    runs, skipped = scan(files.read_bytes(path))
    # Years of bytes are not held while their velocities fill the memory.
    return [replace(run, source=Path(path)) for run in runs], skipped


def batches(runs: Sequence[EnsembleRun]) -> Iterator[list[EnsembleRun]]:
    """Divide runs into batches of some 2 MB, to be decoded together."""
    batch = np.cumsum([run.size for run in runs]) // files.CHUNK_BYTES
    for _, group in groupby(range(len(runs)), key=batch.__getitem__):
        yield [runs[k] for k in group]


def scan(stream: bytes, window: int = files.CHUNK_BYTES) -> tuple[list[EnsembleRun], list[Skipped]]:
    """Find the ensembles and the bytes between them; the result does not depend on the window of the search."""
    data = np.frombuffer(stream, dtype=np.uint8)
    runs, skipped = list[EnsembleRun](), list[Skipped]()
    candidates = lru_cache(maxsize=1)(lambda begin: _find_candidates(data, begin, begin + window))
    start = 0
    while start < data.size:
        layout = layout_at(data, start)
        count = _count_run(data, start, layout) if layout else 0
        if layout and count:
            runs.append(EnsembleRun(start, count, layout, data))
            start += runs[-1].size
            continue
        length, left = int.from_bytes(stream[start + 2 : start + 4], "little"), data.size - start
        reason = NO_ENSEMBLE
        if stream.startswith(b"\x7f\x7f", start) and (left < _HEADER or _SHORTEST <= length > left - 2):
            reason = PAST_THE_END
        stop, damaged, failed = data.size, 0, 0
        for begin in range(start // window * window, data.size, window):
            found = candidates(begin)
            likely = found.good[np.searchsorted(found.good, start) :]
            stop = next((int(place) for place in likely if layout_at(data, int(place))), data.size)
            bad = found.failed[slice(*np.searchsorted(found.failed, [start, stop]))]
            reason = CHECKSUM if len(bad) and bad[0] == start else reason
            damaged += len(bad)
            failed += int(np.diff(np.searchsorted(found.led, [start, stop]))[0])
            if stop < data.size:
                break
        skipped.append(Skipped(start, stop - start, reason, damaged, failed))
        start = stop
    return runs, skipped


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
    """Count the consecutive intact ensembles of one layout from ``start`` on, up to 2 MB.

    They are checked in windows of growing size, of which the largest stay in the processor's cache.
    """
    stride = layout.length + 2
    most = min(data.size - start, max(stride, files.CHUNK_BYTES)) // stride
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


def _find_candidates(whole: Bytes, begin: int, end: int) -> _Candidates:
    data = whole[begin : end + 2**16 + _HEADER]  # an ensemble may end behind the window
    size = min(end - begin, data.size - 1)
    marks = np.flatnonzero((data[:size] == _MARK) & (data[1 : size + 1] == _MARK))
    marks = marks[marks + _HEADER <= data.size]
    length = files.read_words(data, marks + 2).astype(np.int64)
    complete = (length >= _SHORTEST) & (marks + length + 2 <= data.size)
    marks, length = marks[complete], length[complete]
    sums = np.concatenate([np.zeros(1, np.uint16), np.cumsum(data, dtype=np.uint16)])
    holds = (sums[marks + length] - sums[marks]) == files.read_words(data, marks + length)
    failed, length = marks[~holds], length[~holds]
    leader = 6 + 2 * data[failed + 5].astype(np.int64)
    fits = (files.read_words(data, failed + 6) == leader) & (leader + 2 <= length)
    fits &= np.isin(files.read_words(data, failed + np.where(fits, leader, 0)), FIXED_LEADERS)
    return _Candidates(begin + marks[holds], begin + failed, begin + failed[fits])
