"""Find the records of a Nortek file among arbitrary other bytes.

In both formats a record begins with A5, and its checksum is B58C plus the sum of its 16-bit words. An older record
holds its identifier, its size in words, and a checksum at its end; a Signature record has a header of 10 or 12 bytes
with checksums of header and data. A cumulative sum of the file yields all checksums at once, so the cost is linear in
the length even of malicious input. Sources: Nortek, System Integrator Manual (2010); Integrators Guide AD2CP (2017).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.readers import files
from compasslib.readers.files import NORTEK_START, refuse_mostly_damaged
from compasslib.records import Flags
from compasslib.types import Bools, Floats

Bytes = NDArray[np.uint8]
Places = NDArray[np.int64]
_Columns = tuple[Places, Places, Places, Places]  # kind, start, begin of the contents, and end of records

HEADERS = {10: "<u2", 12: "<u4"}  # length of the Signature's header -> data type of the data size
SLANT_DEG = 25.0  # of the beams, unless a file states it


class Coordinates(IntEnum):
    """Coordinates of the recorded velocities, as both formats number them."""

    EARTH = 0
    INSTRUMENT = 1
    BEAM = 2


@dataclass(frozen=True, eq=False)
class Packets:
    """Records of a file with valid checksums; bytes between them are skipped."""

    path: Path
    data: Bytes  # all bytes of the file
    signature: bool  # whether the records are a Signature's
    kind: Places  # (k,) identifier
    begin: Places  # (k,) begin of the contents: after a Signature's header; equal to start for older records
    end: Places  # (k,) end of the record
    start: Places  # (k,) start of the record
    damaged: int  # number of places that begin like one of these records but fail its checksum

    @cached_property
    def skipped(self) -> list[tuple[int, int]]:
        """Offsets of the first and last byte of each range that belongs to no record."""
        first, last = np.append(0, self.end), np.append(self.start, self.data.size) - 1
        return [(int(first[k]), int(last[k])) for k in np.flatnonzero(last >= first)]

    @property
    def bytes_skipped(self) -> int:
        """Number of bytes that belong to no record."""
        return sum(last - first + 1 for first, last in self.skipped)

    def rows(self, which: Bools | Places) -> Bytes:
        """Get the contents of selected records, which must have equal lengths, (k, length) bytes."""
        begin, end = self.begin[which], self.end[which]
        length = int(end[0] - begin[0])
        steps = np.diff(begin)
        if len(steps) and (steps == steps[0]).all() and steps[0] >= length:  # equally spaced: no copy
            return np.lib.stride_tricks.as_strided(self.data[begin[0] :], (len(begin), length), (int(steps[0]), 1))
        return np.lib.stride_tricks.sliding_window_view(self.data, length)[begin]


def find_packets(path: str | Path) -> Packets:
    """Find the records of a file, in the Signature's format if it contains any such record.

    Raises:
        InputError: the file cannot be read, holds no record of either format, or more damaged than intact records.
    """
    data = np.frombuffer(files.read_bytes(path), dtype=np.uint8)
    marks, records, signature = _find_records(data)
    if not len(records[0]):
        raise files.foreign(path, "records of a Nortek file (A5)", "nortek")
    # Drop records that begin before the previous one ends: their checksum is valid by chance.
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
    damaged = int(np.isin(heads[0], heads[1]).sum())  # same first four bytes as a record of the file
    refuse_mostly_damaged(path, "Nortek records", damaged=damaged, whole=len(kind))
    return Packets(Path(path), data, signature, kind, begin, end, start, damaged)


def _find_records(data: Bytes) -> tuple[Places, _Columns, bool]:
    """Find the positions of A5, records that may overlap, and whether they are a Signature's."""
    marks = np.flatnonzero(data == 0xA5)
    sums = np.zeros(data.size + 1, dtype=np.uint16)
    for parity in (0, 1):
        words = data[parity : parity + (data.size - parity) // 2 * 2].view("<u2")
        np.cumsum(words, dtype=np.uint16, out=sums[parity + 2 :: 2])
    records = _find_signature(data, marks, sums)
    if len(records[0]):
        return marks, records, True
    start = marks[marks + 8 <= data.size]  # header, one word and checksum
    end = start + 2 * files.read_words(data, start + 2).astype(np.int64)
    whole = (end >= start + 8) & (end <= data.size)
    start, end = start[whole], end[whole]
    holds = sums[end - 2] - sums[start] + np.uint16(NORTEK_START) == files.read_words(data, end - 2)
    start, end = start[holds], end[holds]
    return marks, (data[start + 1].astype(np.int64), start, start, end), False


def _find_signature(data: Bytes, marks: Places, sums: NDArray[np.uint16]) -> _Columns:
    records = []
    for length, size_type in HEADERS.items():
        start = marks[marks + length <= data.size]
        start = start[data[start + 1] == length]
        start = start[
            sums[start + length - 2] - sums[start] + np.uint16(NORTEK_START)
            == files.read_words(data, start + length - 2)
        ]
        columns = np.arange(4, 4 + np.dtype(size_type).itemsize)
        size = data[start[:, None] + columns].view(size_type)[:, 0].astype(np.int64)
        begin = start + length
        whole = begin + size <= data.size
        start, begin, size = start[whole], begin[whole], size[whole]
        last = np.where(size % 2, data[np.maximum(begin + size, 1) - 1], 0).astype(np.uint16) * np.uint16(256)
        holds = sums[begin + size // 2 * 2] - sums[begin] + np.uint16(NORTEK_START) + last == files.read_words(
            data, begin - 4
        )
        records.append(np.stack([data[start + 2], start, begin, begin + size])[:, holds].astype(np.int64))
    both = np.concatenate(records, axis=1)
    kind, start, begin, end = both[:, np.argsort(both[1], kind="stable")]
    return kind, start, begin, end


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples in file order; n is their number, m the number of bins, and all arrays run along them."""

    offset: Places  # (n,) byte offset in the file
    time_s: Floats  # (n,) seconds since 1970-01-01 by the instrument's clock; NaN where invalid
    heading_deg: Floats  # (n,) of the x axis
    pitch_deg: Floats  # (n,) positive with the x axis up
    roll_deg: Floats  # (n,) positive with the y axis, which points to port on an up-looker, up
    pressure_dbar: Floats  # (n,) NaN without a sensor
    temperature_c: Floats  # (n,) degrees Celsius
    supply_voltage: Floats  # (n,) volts
    velocity: Floats  # (n, m, k) m/s: east and north (earth), x, y and z (instrument), or along beams
    quality: Flags  # (n, m) OceanSITES flags of velocities
    heading_quality: Flags  # (n,) OceanSITES flags of headings
    looks_up: Bools  # (n,) as the instrument states
    bin_range_m: list[float]  # (m,) vertical distance from the head; 0 for a point meter
    recorded: int  # of ``Coordinates``
    beam_angle_deg: float  # from the vertical; 0 for a point meter
    serial: str
    sideways: Bools | None = None  # (n,) whether the instrument lay on its side, if it states that
    model: str = ""  # empty if the file does not state it
    declination_deg: float = 0.0  # declination that the instrument added to its headings
    beams_to_axes: list[list[float]] | None = None  # matrix from beams to x, y, z; None unless in beam coordinates
    average_s: float = 0.0  # averaging time of a sample, which begins at ``time_s``
    magnetometer: Floats | None = None  # (n, 3) counts along x, y, z
    up: Floats | None = None  # (n, m) m/s, only for velocities in earth coordinates
    profiles: Mapping[str, Bytes] = field(default_factory=dict)  # (n, m, beams) or (n, m), see ``Record.profiles``
    counts: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # warnings for the report


def by_beam(rows: Bytes, at: int, beams: int, cells: int) -> Bytes:
    """Reorder bytes stored beam by beam from offset ``at`` on to (n, cells, beams)."""
    return np.moveaxis(rows[:, at : at + beams * cells].reshape(len(rows), beams, cells), 1, 2).copy()
