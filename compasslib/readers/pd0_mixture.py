"""Whether ensembles, whole one by one, also make one recording: one instrument, one run of numbers, one clock."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers.pd0_fields import Ensembles
from compasslib.records import BAD, GOOD, PROBABLY_BAD, Flags, Floats

STRAY = 0.01  # share of another instrument's ensembles that may be damage that met its checksum
FEWEST_BACK = 10  # numbers may fall back where a recording begins anew
JUMP_S, JUMP_STEPS, MOST_JUMPS = 86400.0, 20.0, 3  # longer, and rarer, than the pauses between bursts
ADVICE = "give each recording as a file of its own"


def refuse(where: str, leaders: Ensembles) -> None:
    """Refuse ensembles of two recordings, which would be shuffled into one.

    Args:
        where: the files.
        leaders: n ensembles in the order of the files.

    Raises:
        InputError: two instruments, or one that looks up and one that looks down, or numbers of two recordings.
    """
    kinds = Counter(_kinds(leaders).tolist())
    if len(kinds) > 1 and kinds.most_common(2)[1][1] > STRAY * len(leaders):
        found = " and ".join(f"{count} {_worded(leaders, kind)}" for kind, count in kinds.most_common(3))
        raise InputError(where, expected="ensembles of one instrument", found=found, advice=ADVICE)
    back = int(np.sum((np.diff(leaders.number) < 0) & (np.diff(leaders.time_s) > 0)))
    if back > max(FEWEST_BACK, STRAY * len(leaders)):
        found = f"numbers that fall back {back} times while the clock goes on, as of two recordings mixed"
        raise InputError(where, expected="ensemble numbers that rise with time", found=found, advice=ADVICE)


def doubts(leaders: Ensembles) -> tuple[Flags, dict[str, int], list[str]]:
    """Return the flag of each ensemble, (n,), counts and sentences on those that hardly belong to the rest.

    Args:
        leaders: n ensembles in the order of the files.
    """
    kinds = _kinds(leaders)
    stray = kinds != np.bincount(kinds).argmax()
    jumped = _after_a_jump(leaders.time_s, leaders.number)
    flags = np.where(stray, BAD, np.where(jumped, PROBABLY_BAD, GOOD)).astype(np.int8)
    notes = []
    if stray.any():
        notes.append(f"{int(stray.sum())} ensembles are of another instrument than the rest; they were flagged.")
    if jumped.any():
        notes.append(
            f"The clock jumps ahead by days between ensembles whose numbers follow each other; the {int(jumped.sum())} "
            "after that were flagged, as their time is not known."
        )
    return flags, {"other_instrument": int(stray.sum()), "after_clock_jump": int(jumped.sum())}, notes


def _after_a_jump(time_s: Floats, number: NDArray[np.int64]) -> NDArray[np.bool_]:
    steps = np.diff(time_s)
    if not len(steps):
        return np.zeros(len(time_s), dtype=bool)
    jumps = (np.diff(number) == 1) & (steps > max(JUMP_S, JUMP_STEPS * float(np.median(np.abs(steps)))))
    few = 0 < jumps.sum() <= MOST_JUMPS
    return np.append(False, np.cumsum(jumps) > 0) & few


def _kinds(leaders: Ensembles) -> NDArray[np.int64]:
    """Number the instruments, (n,): by frequency and beams, and by orientation where it goes with the cells."""
    angle = np.nan_to_num(leaders.beam_angle_deg)
    heads = np.column_stack([np.nan_to_num(leaders.frequency_khz), angle, leaders.convex])
    cells = np.column_stack([heads, leaders.cells, leaders.cell_m, leaders.blank_m])
    layout = _numbered(cells)
    up = np.bincount(layout, leaders.looks_up) / np.bincount(layout) > 0.5
    faces = up[layout] if len(up) > 1 else np.zeros(len(leaders), dtype=bool)
    return _numbered(np.column_stack([heads, faces]))


def _numbered(rows: Floats) -> NDArray[np.int64]:
    """Return the number of each row among the distinct ones, (n,); only rows unlike the one before are sorted."""
    new = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]
    _, number = np.unique(rows[new], axis=0, return_inverse=True)
    return np.asarray(number.ravel()[np.cumsum(new) - 1], dtype=np.int64)


def _worded(leaders: Ensembles, kind: int) -> str:
    first = int(np.flatnonzero(_kinds(leaders) == kind)[0])
    facing = "up" if leaders.looks_up[first] else "down"
    khz, cells, size = leaders.frequency_khz[first], leaders.cells[first], leaders.cell_m[first]
    return f"of {khz:g} kHz with {cells} cells of {size:g} m looking {facing}"
