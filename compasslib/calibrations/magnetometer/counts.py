"""What a magnetometer's converter did to its counts: over the end of the scale, at its end, or standing still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib.calibrations.magnetometer import log as magnetometer_log
from compasslib.calibrations.magnetometer.log import Log
from compasslib.types import Floats

Flags = NDArray[np.bool_]

JUMP, SMOOTH = 0.7, 0.1  # of an axis' range: a step over the end of the scale, and the middle step of a smooth log
USUAL = 8.0  # middle steps by which the others differ
FEWEST_AT_END, PILED = 8, 4.0  # readings at one largest value, and how many times more than at the values next to it
BESIDE = 5  # values next to the largest
FEWEST_STILL = 20  # readings in a row with one value
MOVED = 0.1  # of another axis' range, while an axis shows one value


def sound(log: Log) -> Log:
    """Return the log with counts that went over the end of the scale put back, saturated and stuck ones left out.

    What went over the end of a scale that is not one of whole counts is left out: how far it is off is a guess.

    Args:
        log: as read, in the order of the file; one that is refused comes back as it is.
    """
    if magnetometer_log.refusal(log):
        return log
    raw, warnings, out = np.array(log.raw, dtype=float), [], np.zeros(len(log.raw), dtype=bool)
    for k, name in enumerate("xyz"):
        turns, bits = _wrapped(raw[:, k])
        over = f"{np.count_nonzero(turns)} readings of {name} went over the end of their scale"
        if turns.any() and bits:
            warnings.append(f"{over}, {bits} bits, and are put back.")
            raw[:, k] += 2.0**bits * turns
        elif turns.any():
            warnings.append(f"{over}, which is none of whole counts, and are left out.")
            out |= turns != 0.0
    log = replace(log, raw=raw).take(~out, *warnings)
    gone, why = np.zeros(len(log.raw), dtype=bool), []
    for text, flags in (("at the end of its scale: saturated", _saturated), ("standing still: stuck", _stuck)):
        for k, name in enumerate("xyz"):
            found = flags(log.raw, k)
            gone |= found
            why += [f"{found.sum()} readings of {name} {text}, and left out."] if found.any() else []
    return log.take(~gone, *why)


def _wrapped(column: Floats) -> tuple[Floats, int]:
    """Return how often each reading went over the end of the scale, and of how many bits that is; 0 where of none.

    A smooth log shows it: its steps are small but for those that are nearly the whole scale, all alike.
    """
    none = np.zeros(len(column)), 0
    step, reach = np.diff(column), float(np.ptp(column)) if len(column) else 0.0
    jumps, usual = np.abs(step) > JUMP * reach, float(np.median(np.abs(step))) if len(step) else 0.0
    if not jumps.any() or usual > SMOOTH * reach:
        return none
    each = np.abs(step[jumps])
    size, near = float(np.median(each)), USUAL * max(usual, 1.0)
    turns = np.concatenate([[0.0], np.cumsum(-np.sign(step) * jumps)])
    left = np.abs(step + size * np.diff(turns))
    if np.max(np.abs(each - size)) > near or np.max(left) > near:
        return none
    bits = int(np.rint(np.log2(size)))
    exact = np.all(column == np.rint(column)) and abs(2.0**bits - size) <= near and reach < 2.0**bits
    small = np.abs(column) < size / 4.0 if exact else turns == np.median(turns)
    first = np.median(turns[small]) if small.any() else 0.0
    return turns - first, bits if exact else 0


def _saturated(raw: Floats, k: int) -> Flags:
    """Return which readings of an axis share its largest or least value, where far more do than next to it."""
    out = np.zeros(len(raw), dtype=bool)
    value, count = np.unique(raw[:, k], return_counts=True)
    for at, beside in ((-1, slice(-1 - BESIDE, -1)), (0, slice(1, 1 + BESIDE))):
        piled = len(value) > 2 * BESIDE and count[at] >= max(FEWEST_AT_END, PILED * count[beside].max())
        there = raw[:, k] == value[at]
        if piled and _others_move(raw, k, there):
            out |= there
    return out


def _stuck(raw: Floats, k: int) -> Flags:
    """Return which readings of an axis lie in a long row of one value while another axis moves."""
    out = np.zeros(len(raw), dtype=bool)
    if not np.ptp(raw[:, k]):
        return out  # an axis that is not there, or is refused
    begins = np.flatnonzero(np.diff(raw[:, k], prepend=np.inf) != 0.0)
    ends = np.append(begins[1:], len(raw))
    long = ends - begins >= FEWEST_STILL
    for begin, end in zip(begins[long], ends[long], strict=True):
        row = np.zeros(len(raw), dtype=bool)
        row[begin:end] = True
        out |= row & _others_move(raw, k, row)
    return out


def _others_move(raw: Floats, k: int, some: Flags) -> bool:
    """Tell whether another axis moves among some readings."""
    others = np.delete(raw, k, axis=1)
    return bool(np.any(np.ptp(others[some], axis=0) > MOVED * np.maximum(np.ptp(others, axis=0), 1e-12)))
