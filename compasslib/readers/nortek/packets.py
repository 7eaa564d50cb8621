"""Finding the records of a Nortek file, whatever stands between them.

Both formats begin a record with A5 and an identifier, and sum up 16-bit words on top of B58C. The older one has the
size in words behind the identifier and one sum at its end; the Signature's has a header of 10 or 12 bytes with a sum of
its own and one of the data. One running sum of the file gives every place its checksum at once, so that hostile input
costs no more than its length. Sources: Nortek, System Integrator Manual (2010), and Integrators Guide AD2CP (2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.records import Flags
from compasslib.types import Bools, Floats

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
_Columns = tuple[Places, Places, Places, Places]  # of records: kind, start, begin of the contents, end

SYNC, START = 0xA5, 0xB58C
SHORTEST = 8  # bytes of an older record: its head, one word and the sum
HEADERS = {10: "<u2", 12: "<u4"}  # length of the Signature's: how it writes the size of the data
EARTH, INSTRUMENT, BEAM = 0, 1, 2  # as both formats number them
MISSING_COUNT = -32768


@dataclass(frozen=True, eq=False)
class Packets:
    """The records of a file whose checksums hold; what lies between them belongs to none."""

    path: Path
    data: Bytes  # the whole file
    signature: bool  # whether they are the Signature's
    kind: Places  # (k,) identifier
    begin: Places  # (k,) of the record's contents: after the Signature's header; of the older ones with their head
    end: Places  # (k,) of the record
    start: Places  # (k,) of the record
    damaged: int  # places that begin like one of these records and whose checksum fails
    escaped: bool = False  # the data came with a modem's escapes, which were undone

    @cached_property
    def skipped(self) -> list[tuple[int, int]]:
        """First and last byte of each range that belongs to no record."""
        first, last = np.append(0, self.end), np.append(self.start, self.data.size) - 1
        return [(int(first[k]), int(last[k])) for k in np.flatnonzero(last >= first)]

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no record."""
        return sum(last - first + 1 for first, last in self.skipped)

    def rows(self, which: Bools | Places) -> Bytes:
        """Take the contents of some records, which have one length, (k, length) bytes."""
        begin, end = self.begin[which], self.end[which]
        length = int(end[0] - begin[0])
        steps = np.diff(begin)
        if len(steps) and (steps == steps[0]).all() and steps[0] >= length:  # evenly laid: nothing is copied
            return np.lib.stride_tricks.as_strided(self.data[begin[0] :], (len(begin), length), (int(steps[0]), 1))
        return np.lib.stride_tricks.sliding_window_view(self.data, length)[begin]


def find_packets(path: str | Path) -> Packets:
    """Find the records of a file, of the Signature's format where it holds one of them.

    Raises:
        InputError: the file cannot be read, holds no record of either format, or more damaged ones than whole ones.
    """
    data = np.frombuffer(files.read_bytes(path), dtype=np.uint8)
    marks, records, signature = _find_records(data)
    escaped = False
    if files.looks_escaped(data[: files.ESCAPE_SAMPLE].tobytes()):
        undone = np.frombuffer(files.unescape(data.tobytes()), dtype=np.uint8)
        other = _find_records(undone)
        if escaped := len(other[1][0]) > len(records[0]):
            data, (marks, records, signature) = undone, other
    if not len(records[0]):
        beginning = data[:16].tobytes()
        shown = f"a file that begins with {beginning!r}" if beginning else "an empty file"
        advice = "check that format: nortek and the file belong together"
        raise InputError(str(path), expected="records of a Nortek file (A5)", found=shown, advice=advice)
    # Select records that begin where none before has not ended: a chance sum inside another is no record.
    apart = np.ones(len(records[1]), dtype=bool)
    after = 0
    for first in np.flatnonzero(records[1][1:] < records[3][:-1]).tolist():
        if first >= after:
            after = first + int(np.searchsorted(records[1][first:], records[3][first]))
            apart[first + 1 : after] = False
    kind, start, begin, end = (column[apart] for column in records)
    inside = np.searchsorted(start, marks, "right") - 1
    between = marks[(inside < 0) | (marks >= end[inside])]
    heads = [data[at[at + 4 <= data.size][:, None] + np.arange(4)].copy().view("<u4")[:, 0] for at in (between, start)]
    damaged = int(np.isin(heads[0], heads[1]).sum())  # whose first four bytes are those of a record of the file
    refuse_mostly_damaged(path, "Nortek records", damaged=damaged, whole=len(kind))
    return Packets(Path(path), data, signature, kind, begin, end, start, damaged, escaped)


def _find_records(data: Bytes) -> tuple[Places, _Columns, bool]:
    """Find where A5 stands, records that may overlap, and whether they are the Signature's."""
    marks = np.flatnonzero(data == SYNC)
    sums = np.zeros(data.size + 1, dtype=np.uint16)
    for parity in (0, 1):
        words = data[parity : parity + (data.size - parity) // 2 * 2].view("<u2")
        np.cumsum(words, dtype=np.uint16, out=sums[parity + 2 :: 2])
    records = _find_signature(data, marks, sums)
    if len(records[0]):
        return marks, records, True
    start = marks[marks + SHORTEST <= data.size]
    end = start + 2 * word(data, start + 2).astype(np.int64)
    whole = (end >= start + SHORTEST) & (end <= data.size)
    start, end = start[whole], end[whole]
    holds = sums[end - 2] - sums[start] + np.uint16(START) == word(data, end - 2)
    start, end = start[holds], end[holds]
    return marks, (data[start + 1].astype(np.int64), start, start, end), False


def word(data: Bytes, at: Places) -> NDArray[np.uint16]:
    """Read the 16-bit words at some places."""
    return data[at] + data[at + 1].astype(np.uint16) * np.uint16(256)


def _find_signature(data: Bytes, marks: Places, sums: NDArray[np.uint16]) -> _Columns:
    records = []
    for length, size_type in HEADERS.items():
        start = marks[marks + length <= data.size]
        start = start[data[start + 1] == length]
        start = start[sums[start + length - 2] - sums[start] + np.uint16(START) == word(data, start + length - 2)]
        columns = np.arange(4, 4 + np.dtype(size_type).itemsize)
        size = data[start[:, None] + columns].view(size_type)[:, 0].astype(np.int64)
        begin = start + length
        whole = begin + size <= data.size
        start, begin, size = start[whole], begin[whole], size[whole]
        last = np.where(size % 2, data[np.maximum(begin + size, 1) - 1], 0).astype(np.uint16) * np.uint16(256)
        holds = sums[begin + size // 2 * 2] - sums[begin] + np.uint16(START) + last == word(data, begin - 4)
        records.append(np.stack([data[start + 2], start, begin, begin + size])[:, holds].astype(np.int64))
    both = np.concatenate(records, axis=1)
    kind, start, begin, end = both[:, np.argsort(both[1], kind="stable")]
    return kind, start, begin, end


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples in the order of the file; n of them, m cells."""

    offset: Places  # (n,) in the file, bytes
    time_s: Floats  # (n,) since 1970-01-01 by the instrument's clock; NaN where impossible
    heading_deg: Floats  # (n,) of the x axis
    pitch_deg: Floats  # (n,) x axis up
    roll_deg: Floats  # (n,) y axis, which is port on an up-looker, up
    pressure_dbar: Floats  # (n,) NaN without a sensor
    temperature_c: Floats  # (n,)
    supply_voltage: Floats  # (n,) volts
    velocity: Floats  # (n, m, k) m/s: east and north (earth); x, y, z of the head; or along its beams
    quality: Flags  # (n, m)
    heading_quality: Flags  # (n,)
    looks_up: Bools  # (n,) as the instrument states
    sideways: Bools  # (n,) it lay on its side, as it states
    bin_range_m: tuple[float, ...]  # (m,) vertical distance from the head; 0 for a point meter
    recorded: int  # EARTH, INSTRUMENT or BEAM
    beam_angle_deg: float  # from the vertical; 0 for a point meter
    serial: str
    model: str = ""  # where the file names it
    declination_deg: float = 0.0  # that the instrument added to its headings
    beams_to_axes: tuple[tuple[float, ...], ...] = ()  # matrix from beams to x, y, z, where velocities are of beams
    average_s: float = 0.0  # over which a sample is a mean; its time is the beginning
    magnetometer: Floats | None = None  # (n, 3) counts along x, y, z
    up: Floats | None = None  # (n, m) m/s, where velocities were recorded as the earth's
    profiles: Mapping[str, Bytes] = field(default_factory=dict)  # (n, m, beams) or (n, m), as the record's
    counts: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # sentences for the report


def by_beam(rows: Bytes, at: int, beams: int, cells: int) -> Bytes:
    """Reorder bytes that records hold beam after beam, from ``at`` on, to (n, cells, beams)."""
    return np.moveaxis(rows[:, at : at + beams * cells].reshape(len(rows), beams, cells), 1, 2).copy()


def axes_of(matrix: Floats) -> Floats:
    """Select the rows of x, y and z, (3, k), of a matrix from beams to axes; of two estimates of z their mean."""
    return matrix if len(matrix) == 3 else np.vstack([matrix[:2], matrix[2:].mean(axis=0)])
