"""Decode the fields of PD0 ensembles, vectorized over all ensembles of one layout.

Leaders are zero-padded to their full length before decoding, so a field that an old firmware does not write reads as
zero; where zero would be a valid value, the length of the block is checked instead. Byte offsets count from zero at
the identifier of the block. Source: RDI, WorkHorse Commands and Output Data Format, PD0.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from enum import IntEnum
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.readers.files import MISSING_COUNT, block_type
from compasslib.readers.pd0.frames import (
    FIXED_LEADERS,
    VARIABLE_LEADERS,
    Bytes,
    EnsembleRun,
    Layout,
    Places,
    Skipped,
    find_ensembles,
)
from compasslib.readers.times import FIRST_YEAR, civil_seconds
from compasslib.records import take
from compasslib.types import Bools, Floats

T = TypeVar("T", bound=np.generic)


class Coordinates(IntEnum):
    """Coordinates of the recorded velocities, bits 4 and 3 of EX."""

    BEAM = 0
    INSTRUMENT = 1
    SHIP = 2
    EARTH = 3


class Block(IntEnum):
    """Identifiers of the blocks of an ensemble beside the leaders."""

    VELOCITY = 0x0100
    CORRELATION = 0x0200
    ECHO = 0x0300
    PERCENT_GOOD = 0x0400
    BOTTOM_TRACK = 0x0600


STRAY = 0.01  # largest share of foreign ensembles that damage with a valid checksum, or time on deck, explains
DROPPED = {  # why intact ensembles are dropped
    "without_velocity": "hold no velocities",
    "bad_dates": "have an impossible date",
    "not_of_four_beams": "hold other columns than those of four beams",
}
# Identifier, and bit of ``Ensembles.blocks``.
COUNTS = {"echo": (Block.ECHO, 1), "correlation": (Block.CORRELATION, 2), "percent_good": (Block.PERCENT_GOOD, 4)}
LAST_YEAR = 2079  # two-digit years are unique from FIRST_YEAR to here; other dates indicate a damaged clock
_FIXED = block_type(
    firmware=(2, "u1"), system=(4, "<u2"), beams=(8, "u1"), cells=(9, "u1"), pings=(10, "<u2"), cell_cm=(12, "<u2"),
    blank_cm=(14, "<u2"), between_pings=(22, "3u1"), ex=(25, "u1"), ea=(26, "<i2"), eb=(28, "<i2"), ez=(30, "u1"),
    sensors=(31, "u1"), bin1_cm=(32, "<u2"), board=(42, "<i8"), serial=(54, "<u4"), beam_angle=(58, "u1"),
)  # fmt: skip
_VARIABLE = block_type(
    number=(2, "<u2"), clock=(4, "7u1"), number_high=(11, "u1"), sound=(14, "<u2"), depth_dm=(16, "<u2"),
    heading=(18, "<u2"), tilt1=(20, "<i2"), tilt2=(22, "<i2"), salinity=(24, "<u2"), temperature=(26, "<i2"),
    heading_spread=(31, "u1"), current=(34, "u1"), voltage=(35, "u1"), pressure=(48, "<i4"), century=(57, "u1"),
    clock_2000=(58, "7u1"),
)  # fmt: skip
# Versions of the firmware of Ocean Surveyor, RiverRay and Pinnacle (MHKiT-Python, dolfyn/io/rdi.py); the others are
# pistons, Long Ranger and QuarterMaster among them.
_PHASED_ARRAYS = (14, 23, 44, 61)
_NO_HEADING = np.iinfo(np.uint16).max  # marks a missing heading
# Bytes per bin of four beams or components.
_PER_CELL: dict[int, int] = {Block.VELOCITY: 8, Block.CORRELATION: 4, Block.ECHO: 4, Block.PERCENT_GOOD: 4}
_FREQUENCIES_KHZ = np.array([75.0, 150.0, 300.0, 600.0, 1200.0, 2400.0, 38.0, np.nan])
_BEAM_ANGLES_DEG = np.array([15.0, 20.0, 30.0, np.nan])  # the fourth is "other"


@dataclass(frozen=True, eq=False)
class Ensembles:
    """Ensembles as recorded, without any rotation; n is their number, m the largest number of bins."""

    offset: Places  # (n,) byte offset in the file
    number: Places  # (n,) ensemble number
    time_s: Floats  # (n,) seconds since 1970-01-01 by the instrument's clock
    heading_deg: Floats  # (n,) including the heading bias EB; NaN outside [0, 360)
    tilt1_deg: Floats  # (n,) recorded pitch, positive with beam 3 up
    tilt2_deg: Floats  # (n,) recorded roll, positive with starboard down
    velocity: Floats  # (n, m, 4) m/s, NaN where missing
    correlation: Bytes  # (n, m, 4) counts, 0 where the block is absent
    echo: Bytes  # (n, m, 4) intensity, counts, 0 where the block is absent
    percent_good: Bytes  # (n, m, 4), 0 where the block is absent
    blocks: Bytes  # (n,) which of the last three are present, by the bits of ``COUNTS``
    pressure_dbar: Floats  # (n,) NaN without a sensor
    depth_m: Floats  # (n,) of the transducer
    temperature_c: Floats  # (n,) degrees Celsius
    sound_m_s: Floats  # (n,) EC, speed of sound from which velocities and ranges were computed
    salinity: Floats  # (n,) ES, measured or set
    measured: Bytes  # (n,) EZ: sensors that are fitted and used; bits 1 and 2: of temperature and conductivity
    phased_array: Bools  # (n,) whether the beams are formed by one array instead of four pistons
    supply_voltage: Floats  # (n,) counts of the transmit voltage
    transmit_current: Floats  # (n,) counts
    heading_spread_deg: Floats  # (n,) standard deviation of the pings' headings
    serial: Places  # (n,) serial number of the instrument, 0 where unknown
    board: Places  # (n,) serial number of the CPU board, 0 where unknown
    beams: Bytes  # (n,) number of beams
    cells: Places  # (n,) number of bins
    cell_m: Floats  # (n,) size of a bin
    bin1_m: Floats  # (n,) vertical distance to the middle of the first bin
    blank_m: Floats  # (n,) blanking distance
    coordinates: Bytes  # (n,) ``Coordinates``
    tilts_used: Bools  # (n,) whether the instrument applied its tilts in its coordinate transformation
    bins_mapped: Bools  # (n,) whether the instrument mapped bins to equal depths by its tilts
    looks_up: Bools  # (n,) as the instrument states
    convex: Bools  # (n,) whether the transducer head is convex
    beam_angle_deg: Floats  # (n,) from the vertical; NaN where the file does not state it
    angle_contradicted: Bools  # (n,) whether byte 58 states another angle than the system configuration
    frequency_khz: Floats  # (n,) NaN where unknown
    heading_alignment_deg: Floats  # (n,) EA
    heading_bias_deg: Floats  # (n,) EB
    heading_measured: Bools  # (n,) whether the heading is the sensor's (EZ), not the one set by hand (EH)
    average_s: Floats  # (n,) averaging time of an ensemble: number of pings times the time between them

    def __len__(self) -> int:
        return len(self.number)


def misfit(layout: Layout) -> str:
    """Tell why ensembles of a layout are dropped, by the keys of ``DROPPED``; empty if they hold four beams.

    Blocks with room for a fifth column or a surplus bin are not supported.
    """
    if not _has_profile(layout, Block.VELOCITY):
        return "without_velocity"
    for identifier in layout.blocks.keys() & _PER_CELL.keys():
        spare, column = _spare(layout, identifier), _PER_CELL[identifier] // 4 * layout.cells
        last = layout.blocks[identifier][1] == layout.length  # two reserved bytes precede the checksum
        if not 0 <= spare - 2 * (last and spare >= 2) < min(column, _PER_CELL[identifier]):
            return "not_of_four_beams"
    return ""


def decode_runs(runs: Sequence[EnsembleRun], *, profiles: bool = True) -> tuple[Ensembles | None, Counter[str]]:
    """Decode the ensembles of several runs in file order, and count those dropped by the reasons in ``DROPPED``.

    Without ``profiles`` only their leaders are decoded, and the profiles have no bins.
    """
    groups: dict[bytes, list[EnsembleRun]] = {}
    dropped = Counter[str]()
    for run in runs:
        if reason := misfit(run.layout):
            dropped[reason] += run.count
        else:
            groups.setdefault(run.layout.signature, []).append(run)
    if not groups:
        return None, dropped
    ensembles = concatenate([_decode(group[0].layout, group, profiles=profiles) for group in groups.values()])
    if len(groups) > 1:
        ensembles = take(ensembles, np.argsort(ensembles.offset))
    dated = np.isfinite(ensembles.time_s)
    if not dated.all():
        dropped["bad_dates"] = int(np.sum(~dated))
        ensembles = take(ensembles, dated)
    return (ensembles if dated.any() else None), dropped


def concatenate(parts: Sequence[Ensembles]) -> Ensembles:
    """Concatenate ensembles, with missing bins padded by NaN (velocity) or 0."""
    if len(parts) == 1:
        return parts[0]
    return Ensembles(**{f.name: _stack_padded([getattr(part, f.name) for part in parts]) for f in fields(Ensembles)})


def _stack_padded(parts: Sequence[NDArray[T]]) -> NDArray[T]:
    """Concatenate arrays, those of two or more axes padded along the second with NaN, or 0 for integers."""
    if parts[0].ndim == 1:
        return np.concatenate(parts)
    cells = max(part.shape[1] for part in parts)
    whole = np.empty((sum(len(part) for part in parts), cells, *parts[0].shape[2:]), dtype=parts[0].dtype)
    at = 0
    for part in parts:
        whole[at : at + len(part), : part.shape[1]] = part
        whole[at : at + len(part), part.shape[1] :] = np.nan if whole.dtype.kind == "f" else 0
        at += len(part)
    return whole


def _decode(layout: Layout, runs: Sequence[EnsembleRun], *, profiles: bool = True) -> Ensembles:
    rows = runs[0].rows if len(runs) == 1 else np.concatenate([run.rows for run in runs])
    cells = layout.cells if profiles else 0
    counts = _profile(rows, layout, Block.VELOCITY, cells).view("<i2")
    # Division, unlike multiplication by 0.001, gives the float nearest to 0.123 for 123 mm/s.
    velocity = counts / 1000.0
    np.copyto(velocity, np.nan, where=counts == MISSING_COUNT)
    of_cells: dict[str, Any] = {name: _profile(rows, layout, block, cells) for name, (block, _) in COUNTS.items()}
    return Ensembles(
        offset=np.concatenate([run.offset + rows.shape[1] * np.arange(run.count) for run in runs]),
        velocity=velocity,
        **of_cells,
        blocks=np.full(len(rows), sum(bit for block, bit in COUNTS.values() if _has_profile(layout, block)), np.uint8),
        **_decode_fixed(rows, layout),
        **_decode_variable(rows, layout),
    )


def _spare(layout: Layout, identifier: int) -> int:
    """Count the bytes of a block beyond four columns of the leader's number of bins; negative if they do not fit."""
    start, stop = layout.blocks.get(identifier, (0, 0))
    return stop - start - 2 - _PER_CELL[identifier] * layout.cells


def _has_profile(layout: Layout, identifier: int) -> bool:
    return layout.cells > 0 and _spare(layout, identifier) >= 0


def _profile(rows: Bytes, layout: Layout, identifier: int, cells: int) -> Bytes:
    """Extract the bytes of a block by bin, (n, cells, 4 or 8), or zeros if it is absent."""
    shape = len(rows), cells, _PER_CELL[identifier]
    if not cells or not _has_profile(layout, identifier):
        return np.zeros(shape, np.uint8)
    start = layout.blocks[identifier][0] + 2
    return np.ascontiguousarray(rows[:, start : start + cells * _PER_CELL[identifier]]).reshape(shape)


def _leader(rows: Bytes, layout: Layout, identifiers: tuple[int, ...], form: np.dtype[np.void]) -> tuple[Any, set[str]]:
    """Extract the fields of a leader, and the names of those that it holds as a whole."""
    start, stop = next(layout.blocks[i] for i in identifiers if i in layout.blocks)
    length = min(stop - start, form.itemsize)
    block = np.zeros((len(rows), form.itemsize), dtype=np.uint8)
    block[:, :length] = rows[:, start : start + length]
    ends = {name: form[name].itemsize + entry[1] for name, entry in (form.fields or {}).items()}
    return block.view(form)[:, 0], {name for name, end in ends.items() if end <= length}


def _decode_fixed(rows: Bytes, layout: Layout) -> dict[str, Any]:
    leader, whole = _leader(rows, layout, FIXED_LEADERS, _FIXED)
    system, written = leader["system"].astype(np.int64), leader["beam_angle"]
    by_bits = _BEAM_ANGLES_DEG[(system >> 8) & 3]
    serial, board = leader["serial"].astype(np.int64), leader["board"]
    return {
        "serial": np.where(("serial" in whole) & (serial != np.iinfo(np.uint32).max), serial, 0),
        "board": np.where(("board" in whole) & (board != -1), board, 0),
        "beams": leader["beams"].copy(),
        "cells": leader["cells"].astype(np.int64),
        "cell_m": leader["cell_cm"] / 100.0,
        "bin1_m": leader["bin1_cm"] / 100.0,
        "blank_m": leader["blank_cm"] / 100.0,
        "coordinates": (leader["ex"] >> 3) & 3,
        "tilts_used": (leader["ex"] & 4) > 0,
        "bins_mapped": (leader["ex"] & 5) == 5,
        "looks_up": (system & 0x80) > 0,
        "convex": (system & 0x08) > 0,
        # Byte 58 serves "other", as 25 degrees of a Sentinel V; some files have a 3 there (bartverm/adcptools#28).
        "beam_angle_deg": np.where(np.isnan(by_bits) & (written > 0) & (written < 90), written, by_bits),
        "angle_contradicted": ~np.isnan(by_bits) & (written > 0) & (written != by_bits),
        "frequency_khz": _FREQUENCIES_KHZ[system & 7],
        "heading_alignment_deg": leader["ea"] / 100.0,
        "heading_bias_deg": leader["eb"] / 100.0,
        "measured": leader["ez"] & leader["sensors"],
        "phased_array": np.isin(leader["firmware"], _PHASED_ARRAYS),
        "heading_measured": (leader["ez"] & 0x10) > 0,
        "average_s": leader["pings"] * (leader["between_pings"] @ [60.0, 1.0, 0.01]),
    }


def _decode_variable(rows: Bytes, layout: Layout) -> dict[str, Any]:
    leader, whole = _leader(rows, layout, VARIABLE_LEADERS, _VARIABLE)
    fixed, _ = _leader(rows, layout, FIXED_LEADERS, _FIXED)
    heading = leader["heading"] / 100.0
    full = 100 * leader["century"].astype(np.int64) + leader["clock_2000"][:, 0]
    newer = (full >= FIRST_YEAR) & (full <= LAST_YEAR)  # else the clock with a two-digit year
    clock = np.where(newer[:, None], leader["clock_2000"], leader["clock"]).astype(np.int64)
    two_digits = clock[:, 0] + np.where(clock[:, 0] < FIRST_YEAR - 1900, 2000, 1900)
    year = np.where(newer, full, two_digits)
    has_pressure = ((fixed["sensors"] & 0x20) > 0) & ("pressure" in whole)
    return {
        "number": leader["number"] + 65536 * leader["number_high"].astype(np.int64),
        "time_s": civil_seconds(year, *clock[:, 1:].T, last_year=LAST_YEAR),
        "heading_deg": np.where(heading < 360.0, heading, np.nan),
        "tilt1_deg": from_hundredths(leader["tilt1"]),
        "tilt2_deg": from_hundredths(leader["tilt2"]),
        "temperature_c": from_hundredths(leader["temperature"]),
        "depth_m": leader["depth_dm"] / 10.0,
        "sound_m_s": leader["sound"].astype(float),
        "salinity": leader["salinity"].astype(float),
        "supply_voltage": np.where("voltage" in whole, leader["voltage"], np.nan),
        "transmit_current": np.where("current" in whole, leader["current"], np.nan),
        "heading_spread_deg": np.where("heading_spread" in whole, leader["heading_spread"], np.nan),
        # Recorded in decapascals: 1000 daPa are 1 dbar.
        "pressure_dbar": np.where(has_pressure, leader["pressure"] / 1000.0, np.nan),
    }


def from_hundredths(counts: NDArray[np.int16]) -> Floats:
    """Convert counts of hundredths to whole units, with NaN for missing values."""
    return np.where(counts == MISSING_COUNT, np.nan, counts / 100.0)


# Copy a file with corrected headings: intact ensembles with new checksums, all their other bytes unchanged.
#
# Velocities in earth coordinates, including those of the bottom track, rotate with the heading; those in beam,
# instrument or ship coordinates do not depend on it. An ensemble without a corrected heading gets PD0's missing
# values: -32768 in every velocity, and a heading of 655.35 degrees, which no compass reports.

TRACKED = (24, 50)  # byte offsets of the velocities of the bottom track, and of those of the water layer
Turn = Callable[[Ensembles], Floats]


@dataclass(frozen=True)
class Rewritten:
    """Numbers of corrected and flagged ensembles of a rewritten file, and the byte ranges dropped."""

    corrected: int
    flagged: int  # ensembles without a corrected heading, set to missing
    skipped: tuple[Skipped, ...]  # byte ranges of the original that belong to no intact ensemble, dropped


def rewrite(source: str | Path, target: str | Path, turn: Turn) -> Rewritten:
    """Write a copy of a file with each heading rotated clockwise by ``turn``, degrees; where NaN, it becomes missing.

    An existing target is overwritten.

    Raises:
        InputError: the source cannot be read.
    """
    runs, skipped = find_ensembles(source)
    corrected, flagged = 0, 0
    with Path(target).open("wb") as file:
        for run in runs:
            ensembles = None if misfit(run.layout) else _decode(run.layout, [run])
            by = np.full(run.count, np.nan) if ensembles is None else turn(ensembles)
            file.write(_turn_run(run, ensembles, by).tobytes())
            corrected, flagged = corrected + int(np.isfinite(by).sum()), flagged + int(np.isnan(by).sum())
    return Rewritten(corrected, flagged, tuple(skipped))


def _turn_run(run: EnsembleRun, ensembles: Ensembles | None, by: Floats) -> Bytes:
    rows, layout = run.rows.copy(), run.layout
    heading = np.full(len(rows), np.nan) if ensembles is None else ensembles.heading_deg + by
    hundredths = np.rint(100.0 * angles.wrap360(np.rint(100.0 * heading) / 100.0))
    begin = next(layout.blocks[i][0] for i in VARIABLE_LEADERS if i in layout.blocks) + 18  # of the heading
    rows[:, begin : begin + 2] = _bytes(np.where(np.isfinite(by), hundredths, _NO_HEADING).astype("<u2"))
    begin, stop = layout.blocks.get(Block.VELOCITY, (0, 0))
    room = 8 * layout.cells if ensembles else (stop - begin - 2) // 2 * 2
    places = [(begin + 2, begin + 2 + room)] * (room > 0)
    begin, stop = layout.blocks.get(Block.BOTTOM_TRACK, (0, 0))
    places += [(begin + at, begin + at + 8) for at in TRACKED if begin + at + 8 <= stop]
    for begin, stop in places:
        counts = np.ascontiguousarray(rows[:, begin:stop]).view("<i2").copy()
        if ensembles:
            in_earth = (ensembles.coordinates == Coordinates.EARTH) & np.isfinite(by)
            flow = counts.reshape(len(rows), -1, 4)
            known = (flow[..., :2] != MISSING_COUNT).all(axis=-1) & in_earth[:, None]
            turned = np.rint(np.stack(angles.turn(flow[..., 0], flow[..., 1], np.nan_to_num(by)[:, None]), axis=-1))
            fits = known & (np.abs(turned) <= np.iinfo(np.int16).max).all(axis=-1)
            flow[fits, :2] = turned[fits].astype(np.int16)
            flow[known & ~fits] = MISSING_COUNT
        counts[np.isnan(by)] = MISSING_COUNT
        rows[:, begin:stop] = _bytes(counts)
    sums = rows[:, : layout.length].sum(axis=1, dtype=np.uint16)  # wraps modulo 65,536, as the checksum does
    rows[:, layout.length :] = _bytes(sums.astype("<u2"))
    return rows


def _bytes(numbers: NDArray[np.integer]) -> Bytes:
    return np.ascontiguousarray(numbers).reshape(len(numbers), -1).view(np.uint8)
