"""A PD0 file once more with other headings: the good ensembles, their checksums made anew, every other byte as it was.

Velocities in earth coordinates turn with the heading, those of the bottom track too; along beams, in the instrument's
axes and in the ship's they do not depend on it. An ensemble without a heading to give gets what PD0 has for a bad one:
-32768 in every velocity, and 655.35 degrees, which no compass shows. Source: RDI, WorkHorse Commands and Output Data
Format, PD0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.readers.pd0.fields import (
    EARTH,
    MISSING_COUNT,
    NO_HEADING,
    VELOCITY,
    Leaders,
    decode_leaders,
    has_velocities,
)
from compasslib.readers.pd0.frames import VARIABLE_LEADERS, Bytes, EnsembleRun, Layout, Skipped, iter_chunks
from compasslib.types import Bools, Floats

FULL_CIRCLE = 36000  # hundredths of a degree
HEADING_AT = 18  # byte of the variable leader
BOTTOM_TRACK, TRACKED = 0x0600, (24, 50)  # bytes at which its velocities stand, and those of the water's layer
LARGEST = 32767  # mm/s that the format can hold
Turn = Callable[[Leaders], Floats]


@dataclass(frozen=True)
class Rewritten:
    """Counts of the ensembles of one file that was rewritten."""

    corrected: int
    flagged: int  # without a heading to give
    skipped: tuple[Skipped, ...]  # ranges of the original that belong to no good ensemble, and were left out


def rewrite(source: str | Path, target: str | Path, turn: Turn) -> Rewritten:
    """Write a file with every heading turned.

    Args:
        target: takes the ensembles one after the other; what is there is lost.
        turn: gives the degrees clockwise by which the heading of each ensemble turns, NaN where there is none to give.

    Raises:
        InputError: the source cannot be read.
    """
    corrected, flagged = 0, 0
    skipped: list[Skipped] = []
    with Path(target).open("wb") as file:
        for chunk in iter_chunks(source):
            skipped += chunk.skipped
            for run in chunk.runs:
                leaders = decode_leaders(run)
                by = turn(leaders) if has_velocities(run.layout) else np.full(len(run.rows), np.nan)
                file.write(_turn_run(run, leaders, by).tobytes())
                corrected, flagged = corrected + int(np.isfinite(by).sum()), flagged + int(np.isnan(by).sum())
    return Rewritten(corrected, flagged, tuple(skipped))


def _turn_run(run: EnsembleRun, leaders: Leaders, by: Floats) -> Bytes:
    rows, layout = run.rows.copy(), run.layout
    begin = next(layout.blocks[i][0] for i in VARIABLE_LEADERS if i in layout.blocks) + HEADING_AT
    hundredths = np.rint(100.0 * angles.wrap360(leaders.heading_deg + by)) % FULL_CIRCLE
    rows[:, begin : begin + 2] = _bytes(np.where(np.isfinite(by), hundredths, NO_HEADING).astype("<u2"))
    for begin, stop in _velocities(layout):
        counts = np.ascontiguousarray(rows[:, begin:stop]).view("<i2").copy()
        if has_velocities(layout):
            _turn(counts.reshape(len(rows), -1, 4), by, (leaders.coordinates == EARTH) & np.isfinite(by))
        counts[np.isnan(by)] = MISSING_COUNT
        rows[:, begin:stop] = _bytes(counts)
    sums = rows[:, : layout.length].sum(axis=1, dtype=np.uint16)  # wraps modulo 65,536, as the checksum does
    rows[:, layout.length :] = _bytes(sums.astype("<u2"))
    return rows


def _bytes(numbers: NDArray[np.integer]) -> Bytes:
    return np.ascontiguousarray(numbers).reshape(len(numbers), -1).view(np.uint8)


def _velocities(layout: Layout) -> Iterator[tuple[int, int]]:
    """Locate velocities, in bytes of the ensemble."""
    begin, stop = layout.blocks.get(VELOCITY, (0, 0))
    room = 8 * layout.cells if has_velocities(layout) else (stop - begin - 2) // 2 * 2
    if room > 0:
        yield begin + 2, begin + 2 + room
    begin, stop = layout.blocks.get(BOTTOM_TRACK, (0, 0))
    yield from ((begin + at, begin + at + 8) for at in TRACKED if begin + at + 8 <= stop)


def _turn(counts: NDArray[np.int16], by: Floats, which: Bools) -> None:
    """Turn velocities, (k, m, 4) mm/s, of some ensembles in place; bad where the format cannot hold the result."""
    known = (counts[..., :2] != MISSING_COUNT).all(axis=-1) & which[:, None]
    turned = np.rint(np.stack(angles.turn(counts[..., 0], counts[..., 1], np.nan_to_num(by)[:, None]), axis=-1))
    fits = known & (np.abs(turned) <= LARGEST).all(axis=-1)
    counts[fits, :2] = turned[fits].astype(np.int16)
    counts[known & ~fits] = MISSING_COUNT
