"""Whether ensembles, whole one by one, also make one recording: one instrument, one run of numbers, one clock.

And whether it is the one of the metadata: a setting that contradicts them is refused, never guessed.
"""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
from numpy.typing import NDArray

from compasslib.declination import Applied
from compasslib.errors import InputError
from compasslib.readers.pd0.fields import BEAM, EARTH, INSTRUMENT, SHIP, Ensembles
from compasslib.records import BAD, GOOD, PROBABLY_BAD, Flags
from compasslib.types import Floats

STRAY = 0.01  # share of another instrument's ensembles that may be damage that met its checksum
FEWEST_BACK = 10  # numbers may fall back where a recording begins anew
JUMP_S, JUMP_STEPS, MOST_JUMPS = 86400.0, 20.0, 3  # longer, and rarer, than the pauses between bursts
ADVICE = "give each recording as a file of its own"
BEAMS = 4
FEWEST_CELLS, MOST = 100, 0.5
COORDINATES = {BEAM: "beam", INSTRUMENT: "instrument", SHIP: "ship", EARTH: "earth"}
FOUR = "export its four slanted beams, or give the velocities as a table"


def refuse(where: str, leaders: Ensembles) -> None:
    """Refuse ensembles of two recordings, which would be shuffled into one, and headings that are no degrees.

    Args:
        leaders: n ensembles in the order of the files.

    Raises:
        InputError: two instruments, or one that looks up and one that looks down, or numbers of two recordings, or
            other than four beams, or more than STRAY of the headings beyond the circle.
    """
    for name, numbers in (("serial number", leaders.serial), ("processor board", leaders.board)):
        several = _often(numbers)
        if len(several) > 1:
            found = " and ".join(f"{name} {number} in {count}" for number, count in several.items())
            advice = f"name one instrument's files only, or {ADVICE}"
            raise InputError(where, expected="ensembles of one instrument", found=found, advice=advice)
    beams, count = Counter(leaders.beams.tolist()).most_common(1)[0]
    if beams != BEAMS:
        raise InputError(where, expected="4 beams", found=f"{beams} in {count} ensembles", advice=FOUR)
    kinds = Counter(_kinds(leaders).tolist())
    if len(kinds) > 1 and kinds.most_common(2)[1][1] > STRAY * len(leaders):
        found = " and ".join(f"{count} {_in_words(leaders, kind)}" for kind, count in kinds.most_common(3))
        raise InputError(where, expected="ensembles of one instrument", found=found, advice=ADVICE)
    back = int(np.sum((np.diff(leaders.number) < 0) & (np.diff(leaders.time_s) > 0)))
    if back > max(FEWEST_BACK, STRAY * len(leaders)):
        found = f"numbers that fall back {back} times while the clock goes on, as of two recordings mixed"
        raise InputError(where, expected="ensemble numbers that rise with time", found=found, advice=ADVICE)
    beyond = int(leaders.beyond_circle.sum())
    if beyond > max(FEWEST_BACK, STRAY * len(leaders)):
        expected = "headings from 0 to 359.99 degrees, stored as hundredths"
        found = f"{beyond} of {len(leaders)} of 360 degrees and more, as of gradians or another unit"
        raise InputError(where, expected=expected, found=found, advice="take the file as the instrument recorded it")


def refuse_columns(where: str, misfits: int, kept: int) -> None:
    """Refuse a file whose blocks do not hold four columns for the cells of its leader.

    Raises:
        InputError: they are more than damage.
    """
    if misfits > STRAY * (misfits + kept):
        expected = "blocks of four columns, as many rows as the leader tells cells"
        found = f"others, perhaps of five beams, in {misfits} of {misfits + kept} ensembles"
        raise InputError(where, expected=expected, found=found, advice=FOUR)


def refuse_coordinates(where: str, leaders: Ensembles, other: int, decisive: int) -> None:
    """Refuse a file whose cells are not in the coordinates of EX.

    Args:
        other: cells that contradict EX by their percent good and velocities.

    Raises:
        InputError: most of them do.
    """
    if decisive < FEWEST_CELLS or other <= MOST * decisive:
        return
    code = Counter(leaders.coordinates.tolist()).most_common(1)[0][0]
    frame, columns = COORDINATES[code], "that add up to 100" if code == BEAM else "of one beam each"
    raise InputError(
        f"{where}: coordinates EX",
        expected=f"percent good as in {frame} coordinates",
        found=f"columns {columns} in {other} of {decisive} cells looked at",
        advice="EX does not tell what the velocities are: take the instrument's own file, or export them as a table",
    )


def refuse_alignment(where: str, leaders: Ensembles, stated: float | None) -> None:
    """Refuse a heading alignment EA that nobody says how to take, and a word on it where the file has none.

    Args:
        stated: ``heading_alignment`` of the metadata.

    Raises:
        InputError: one of the two stands without the other, or EA changes.
    """
    aligned = leaders.heading_alignment_deg
    if stated is None and aligned.any():
        raise InputError(
            f"{where}: heading alignment EA",
            expected="0 degrees",
            found=f"{aligned[np.flatnonzero(aligned)[0]]:g} degrees",
            advice="give heading_alignment: degrees to add to the recorded heading to get beam 3's, or 0 to ignore EA",
        )
    written = [value for value, count in Counter(aligned.tolist()).items() if count > STRAY * len(aligned)]
    if stated and (len(written) > 1 or 0.0 in written):
        raise InputError(
            f"{where}: heading alignment EA",
            expected=f"one that is not 0, as heading_alignment is {stated:g}",
            found=" and ".join(f"{value:g} degrees" for value in sorted(written)),
            advice="delete heading_alignment: it only says how to take an EA that the file holds",
        )


def refuse_rotation(where: str, leaders: Ensembles, stated: Applied | None) -> None:
    """Refuse degrees inside velocities that hold no north: only earth coordinates were rotated apart from headings.

    Args:
        stated: ``declination_applied`` of the metadata.

    Raises:
        InputError: velocities in beam, instrument or ship coordinates are said to hold degrees of their own.
    """
    if stated is not None and stated.velocity and stated.differs and (leaders.coordinates != EARTH).any():
        expected = "velocity: 0, as velocities are not in earth coordinates and are turned by the headings"
        raise InputError(f"{where}: declination_applied", expected=expected, found=stated, advice="correct it")


def serial_number(where: str, leaders: Ensembles, stated: str | None) -> str:
    """Return the instrument's serial number, empty where the file tells none; see ``same_number``."""
    return same_number(where, str(next(iter(_often(leaders.serial)), "")), stated)


def same_number(where: str, found: str, stated: str | None) -> str:
    """Return the serial number that a file tells.

    Args:
        found: by the file, empty where it tells none; perhaps with letters, as the other.
        stated: by the metadata.

    Raises:
        InputError: the metadata tell another.
    """
    number, numbers = ([int(digits) for digits in re.findall(r"\d+", text or "")] for text in (found, stated))
    if number and numbers and not {*number} & {*numbers}:
        advice = "the files may be another instrument's: correct files or serial_number"
        raise InputError(where, expected=f"serial number {stated}", found=found, advice=advice)
    return found


def _often(numbers: NDArray[np.int64]) -> dict[int, int]:
    """Return the numbers that are stated and no accident, the most frequent first, and how often each stands there.

    What differs from ensemble to ensemble is no number of an instrument.
    """
    most = Counter(numbers[numbers != 0].tolist()).most_common()
    return {number: count for number, count in most if count > max(1.0, STRAY * len(numbers))}


def _other(numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell ensembles that carry another number than the recording's, (n,)."""
    own = next(iter(_often(numbers)), 0)
    return (numbers != 0) & (numbers != own) & (own != 0)


def stray(leaders: Ensembles) -> tuple[Flags, dict[str, int], list[str]]:
    """Return the flag of each ensemble, (n,), counts and sentences on those that hardly belong to the rest.

    Args:
        leaders: n ensembles in the order of the files.
    """
    kinds = _kinds(leaders)
    other = kinds != np.bincount(kinds).argmax()
    jumped = _after_a_jump(leaders.time_s, leaders.number)
    flags = np.where(other, BAD, np.where(jumped, PROBABLY_BAD, GOOD)).astype(np.int8)
    notes = []
    if other.any():
        notes.append(f"{int(other.sum())} ensembles are of another instrument than the rest; they were flagged.")
    if jumped.any():
        notes.append(
            f"The clock jumps ahead by days between ensembles whose numbers follow each other; the {int(jumped.sum())} "
            "after that were flagged, as their time is not known."
        )
    return flags, {"other_instrument": int(other.sum()), "after_clock_jump": int(jumped.sum())}, notes


def _after_a_jump(time_s: Floats, number: NDArray[np.int64]) -> NDArray[np.bool_]:
    steps = np.diff(time_s)
    if not len(steps):
        return np.zeros(len(time_s), dtype=bool)
    jumps = (np.diff(number) == 1) & (steps > max(JUMP_S, JUMP_STEPS * float(np.median(np.abs(steps)))))
    few = 0 < jumps.sum() <= MOST_JUMPS
    return np.append(False, np.cumsum(jumps) > 0) & few


def _kinds(leaders: Ensembles) -> NDArray[np.int64]:
    """Number the instruments, (n,): by number, frequency and beams, and by orientation where it goes with the cells."""
    angle = np.nan_to_num(leaders.beam_angle_deg)
    other = _other(leaders.serial) | _other(leaders.board)
    heads = np.column_stack([np.nan_to_num(leaders.frequency_khz), angle, leaders.convex, leaders.beams, other])
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


def _in_words(leaders: Ensembles, kind: int) -> str:
    first = int(np.flatnonzero(_kinds(leaders) == kind)[0])
    facing = "up" if leaders.looks_up[first] else "down"
    khz, cells, size = leaders.frequency_khz[first], leaders.cells[first], leaders.cell_m[first]
    return f"of {khz:g} kHz with {cells} cells of {size:g} m looking {facing}"
