"""Whether the recorded headings are those by which the instrument turned its velocities.

Heading minus direction of flow is the direction from which the water came at the instrument, in its own frame: no
compass is in it, however bent. A moored instrument turns with the water, so that this direction keeps to one side; by
windows of five days its speed-weighted mean vector stays within 0.61 of the record's in two real records of 21 months
together. Where the column of headings was changed later (turned, mirrored, taken from elsewhere) it does not. Nor does
a compass that turns repeat a sequence of readings to the last digit.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import PROBABLY_BAD, Record, iso_time
from compasslib.types import DAY_S, Bools, Complexes, Floats

WINDOW_S, FEWEST, FEWEST_WINDOWS = 5 * DAY_S, 40, 6
FIRM, TURNED_DEG = 0.4, 60.0  # mean vector that has a direction, and how far that of two windows in a row may be off
# A single window may be further off: of 553 of the demonstration cruise one is by 79 degrees and 0.81.
ALONE, ALONE_DEG = 1.4, 110.0
OFF, OFF_TIMES = 0.75, 5.0  # distance of a window's mean vector from the record's, and over the median distance
SEQUENCE, DISTINCT = 12, 8  # readings in a row that are compared, and the different ones that they must hold
MIRRORED = 0.15  # by which the mirrored headings keep more to one side
NEAR_BINS = 3  # whose mean velocity is the flow
# Headings equal to the extreme one, the same over those equal to each of the next values, and how many of these.
AT_LIMIT, CROWDED, COMPARED_VALUES = 10, 10.0, 9


def flag_altered(record: Record) -> Record:
    """Flag headings doubtful that cannot be those by which the instrument turned its velocities.

    A record of less than a month, as of a package lowered from a ship, is held against its own repetitions and limits
    only.
    """
    record = _flag_limits(_flag_repeated(record))
    flow, known = _flow(record), np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD)
    speed = np.where(known, np.abs(flow), 0.0)
    if np.count_nonzero(speed) < FEWEST_WINDOWS * FEWEST or np.ptp(record.time_s) < FEWEST_WINDOWS * WINDOW_S:
        return record
    weight = np.minimum(speed, np.median(speed[speed > 0.0]))  # slow flow has no direction
    # Unit vectors of heading minus direction of flow, 0 where one is missing.
    towards = angles.direction(flow.real, flow.imag)
    vectors = (angles.phasor(sign * record.heading_deg - towards) for sign in (1.0, -1.0))
    direction, mirrored = (np.where(np.isfinite(vector), vector, 0.0) for vector in vectors)
    if abs(_mean(mirrored, weight)) > abs(_mean(direction, weight)) + MIRRORED:
        note = (
            "the recorded headings turn with the flow where they are mirrored (counted anticlockwise), and not as they "
            "are: all are flagged doubtful; check the column of headings"
        )
        return _flag(record, np.ones(weight.shape, dtype=bool), note)
    number = np.floor((record.time_s - record.time_s[0]) / WINDOW_S).astype(int)
    altered = _far_windows(number, direction, weight)[number]
    if altered.any():
        note = (
            f"{_span(record, altered)} are not those by which the velocities were turned, as the flow in "
            "the instrument's own frame shows: they are flagged doubtful, with five days on either side; check the "
            "column of headings"
        )
        record = _flag(record, altered, note)
    return record


def _flow(record: Record) -> Complexes:
    """Compute the mean velocity of the good near bins, (n,), 0 where there is none."""
    velocity = record.east[:, :NEAR_BINS] + 1j * record.north[:, :NEAR_BINS]
    good = np.isfinite(velocity) & (record.quality[:, :NEAR_BINS] < PROBABLY_BAD)
    return np.where(good, velocity, 0.0).sum(axis=1) / np.maximum(good.sum(axis=1), 1)


def _mean(direction: Complexes, weight: Floats) -> complex:
    return complex(np.sum(weight * direction) / weight.sum())


def _far_windows(number: NDArray[np.intp], direction: Complexes, weight: Floats) -> Bools:
    """Find the windows whose mean vector lies far from the record's, with those beside them, (w,)."""
    size = int(number[-1]) + 1
    total = np.bincount(number, weight, size)
    mean = np.bincount(number, weight * direction.real, size) + 1j * np.bincount(number, weight * direction.imag, size)
    mean = mean / np.maximum(total, 1e-12)
    enough = np.bincount(number, weight > 0.0, size) >= FEWEST
    if enough.sum() < FEWEST_WINDOWS:
        return np.zeros(size, dtype=bool)
    usual = complex(np.median(mean[enough].real), np.median(mean[enough].imag))
    away, turned = np.abs(mean - usual), np.abs(angles.wrap180(angles.argument(mean * np.conj(usual))))
    firm = np.minimum(np.abs(mean), abs(usual)) > FIRM
    least = max(OFF, OFF_TIMES * float(np.median(away[enough])))
    sure, far = (
        enough & ((away > times * least) | (firm & (turned > degrees)))
        for times, degrees in ((ALONE, ALONE_DEG), (1.0, TURNED_DEG))
    )
    far = sure | (far & _adjacent(far))
    return np.asarray(far | _adjacent(far))


def _adjacent(windows: Bools) -> Bools:
    """Tell which windows have a selected one before or after them, (w,)."""
    return np.append(windows[1:], False) | np.append(False, windows[:-1])


def _flag_repeated(record: Record) -> Record:
    """Flag sequences of readings that stand at two places, both of them: nobody knows which was recorded there."""
    latest = np.maximum.accumulate(np.append(-np.inf, record.time_s[:-1]))
    later = record.time_s > latest  # one sample given twice repeats nothing
    known = np.flatnonzero(later & np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD))
    if len(known) < SEQUENCE:
        return record
    runs = np.lib.stride_tricks.sliding_window_view(record.heading_deg[known].round(2), SEQUENCE)
    distinct = 1 + np.count_nonzero(np.diff(np.sort(runs, axis=1), axis=1), axis=1)
    varied = np.flatnonzero(distinct >= DISTINCT)
    _, index, count = np.unique(runs[varied], axis=0, return_inverse=True, return_counts=True)
    begins = varied[count[index.ravel()] > 1]
    repeated = np.zeros(record.heading_deg.shape, dtype=bool)
    repeated[known[(begins[:, None] + np.arange(SEQUENCE)).ravel()]] = True
    if not repeated.any():
        return record
    note = (
        f"{_span(record, repeated)} repeat others to the last digit: part of the record was copied, and both places "
        "are flagged doubtful"
    )
    return _flag(record, repeated, note)


def _span(record: Record, which: Bools) -> str:
    first, last = record.time_s[which][[0, -1]]
    return f"{int(which.sum())} recorded headings between {iso_time(first)} and {iso_time(last)}"


def _flag_limits(record: Record) -> Record:
    """Flag headings equal to the smallest or greatest recorded one, where many are: they were cut there."""
    heading = record.heading_deg
    known = np.isfinite(heading) & (record.heading_quality < PROBABLY_BAD)
    if not known.any():
        return record
    for limit in (heading[known].min(), heading[known].max()):
        at = known & (heading == limit)
        values, counts = np.unique(heading[known & ~at], return_counts=True)
        others = np.median(counts[np.argsort(np.abs(values - limit))[:COMPARED_VALUES]]) if len(values) else np.inf
        if at.sum() >= AT_LIMIT and at.sum() > CROWDED * others:
            note = f"{int(at.sum())} recorded headings are exactly {limit:g} degrees, the limit of all others"
            record = _flag(record, at, f"{note}: they were cut there, and are flagged doubtful")
    return record


def _flag(record: Record, which: Bools, note: str) -> Record:
    flags = np.where(which & (record.heading_quality < PROBABLY_BAD), PROBABLY_BAD, record.heading_quality)
    return replace(record, heading_quality=flags.astype(np.int8), warnings=(*record.warnings, note))
