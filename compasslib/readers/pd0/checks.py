"""Check the consistency of the intact ensembles of a PD0 recording, and report what was dropped.

The ensembles of a recording share one instrument, one sequence of numbers and one clock. Settings in the metadata that
contradict them raise an error.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import AppliedDeclination
from compasslib.errors import InputError, applicable
from compasslib.readers import files
from compasslib.readers.pd0.currents import Settings, looks_up
from compasslib.readers.pd0.fields import DROPPED, STRAY, Coordinates, Ensembles
from compasslib.readers.pd0.frames import Skipped
from compasslib.readers.times import describe_averages
from compasslib.records import BAD, GOOD, PROBABLY_BAD, Flags
from compasslib.types import DAY_S, Floats

ADVICE = "give each recording as a file of its own"
FOUR = "export its four slanted beams, or give the velocities as a table"


def refuse_mixed(where: str, leaders: Ensembles) -> None:
    """Reject ensembles of two instruments, as of one that looks up and one that looks down, or not of four beams.

    Raises:
        InputError: there are more of the second kind than a share STRAY.
    """
    for name, numbers in (("serial number", leaders.serial), ("processor board", leaders.board)):
        several = frequent_numbers(numbers)
        if len(several) > 1:
            shown = " and ".join(f"{name} {number} in {count}" for number, count in several.items())
            advice = f"name one instrument's files only, or {ADVICE}"
            raise InputError(where, expected="ensembles of one instrument", found=shown, advice=advice)
    beams, count = Counter(leaders.beams.tolist()).most_common(1)[0]
    if beams != 4:
        raise InputError(where, expected="4 beams", found=f"{beams} in {count} ensembles", advice=FOUR)
    number = _number_kinds(leaders).tolist()
    kinds = Counter(number).most_common(3)
    if len(kinds) > 1 and kinds[1][1] > STRAY * len(leaders):
        described = []
        for k, count in ((number.index(label), count) for label, count in kinds):
            cells, facing = (
                f"{leaders.cells[k]} cells of {leaders.cell_m[k]:g} m",
                "up" if leaders.looks_up[k] else "down",
            )
            described.append(f"{count} of {leaders.frequency_khz[k]:g} kHz with {cells} looking {facing}")
        raise InputError(where, expected="ensembles of one instrument", found=" and ".join(described), advice=ADVICE)


def refuse_alignment(where: str, aligned: Floats, stated: float | None) -> None:
    """Reject an EA without ``heading_alignment``, and a nonzero ``heading_alignment`` with a zero or changing EA.

    Args:
        aligned: EA of each ensemble, degrees.
    """
    if stated is None and aligned.any():
        advice = "give heading_alignment: degrees to add to the recorded heading to get beam 3's, or 0 to ignore EA"
        shown = f"{aligned[np.flatnonzero(aligned)[0]]:g} degrees"
        raise InputError(where, expected="0 degrees", found=shown, advice=advice)
    written = sorted(value for value, count in Counter(aligned.tolist()).items() if count > STRAY * len(aligned))
    if stated and (len(written) > 1 or 0.0 in written):
        expected = f"one that is not 0, as heading_alignment is {stated:g}"
        advice = "delete heading_alignment: it only says how to take an EA that the file holds"
        shown = " and ".join(f"{value:g} degrees" for value in written)
        raise InputError(where, expected=expected, found=shown, advice=advice)


def refuse_rotation(where: str, stated: AppliedDeclination | None, *, is_earth: bool) -> None:
    """Reject a declination of velocities that differs from that of headings unless they are in earth coordinates."""
    if stated is not None and stated.velocity and stated.differs and not is_earth:
        expected = "velocity: 0, as velocities are not in earth coordinates and are turned by the headings"
        raise InputError(f"{where}: declination_applied", expected=expected, found=stated, advice="correct it")


def match_serial_number(where: str, recorded: str, stated: str | None) -> str:
    """Compare a file's serial number, possibly empty, with that of the metadata, ignoring letters around the digits.

    Raises:
        InputError: the two differ.
    """
    number, numbers = ([int(digits) for digits in re.findall(r"\d+", text or "")] for text in (recorded, stated))
    if number and numbers and not {*number} & {*numbers}:
        advice = "the files may be another instrument's: correct files or serial_number"
        raise InputError(where, expected=f"serial number {stated}", found=recorded, advice=advice)
    return recorded


def frequent_numbers(numbers: NDArray[np.int64]) -> dict[int, int]:
    """Count the nonzero numbers that occur too often to be damage, in descending order of frequency.

    Values that differ from ensemble to ensemble are not numbers of an instrument.
    """
    most = Counter(numbers[numbers != 0].tolist()).most_common()
    return {number: count for number, count in most if count > max(1.0, STRAY * len(numbers))}


def flag_strays(leaders: Ensembles) -> tuple[Flags, dict[str, int], list[str]]:
    """Flag ensembles of another instrument, or after the clock jumped by days, (n,); also give counts and warnings."""
    kinds = _number_kinds(leaders)
    other = kinds != np.bincount(kinds).argmax()
    count = int(other.sum())
    notes = [f"{count} ensembles are of another instrument than the rest; they were flagged."] if count else []
    steps = np.diff(leaders.time_s)
    usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
    # Up to three: pauses between bursts are more, and shorter.
    jumps = (np.diff(leaders.number) == 1) & (steps > max(DAY_S, 20.0 * usual))
    jumped = np.append(False, np.cumsum(jumps) > 0) & (jumps.sum() <= 3)
    if jumped.any():
        notes.append(
            f"The clock jumps ahead by days between ensembles whose numbers follow each other; the {int(jumped.sum())} "
            "after that were flagged, as their time is not known."
        )
    flags = np.where(other, BAD, np.where(jumped, PROBABLY_BAD, GOOD)).astype(np.int8)
    return flags, {"other_instrument": count, "after_clock_jump": int(jumped.sum())}, notes


def _number_kinds(leaders: Ensembles) -> NDArray[np.int64]:
    """Label ensembles by instrument, (n,): number, frequency, beams, and the usual orientation of each bin layout."""
    other = np.zeros(len(leaders), dtype=bool)
    for numbers in (leaders.serial, leaders.board):
        usual = next(iter(frequent_numbers(numbers)), 0)
        other |= (numbers != 0) & (numbers != usual) & (usual != 0)
    known = [np.nan_to_num(leaders.frequency_khz), np.nan_to_num(leaders.beam_angle_deg)]
    heads = np.column_stack([*known, leaders.convex, leaders.beams, other])
    cells = np.column_stack([heads, leaders.cells, leaders.cell_m, leaders.blank_m])
    layout = _number_rows(cells)
    up = np.bincount(layout, leaders.looks_up) / np.bincount(layout) > 0.5
    faces = up[layout] if len(up) > 1 else np.zeros(len(leaders), dtype=bool)
    return _number_rows(np.column_stack([heads, faces]))


def _number_rows(rows: Floats) -> NDArray[np.int64]:
    """Label each row by its index among the distinct rows, (n,); only rows unlike the previous one are sorted."""
    new = np.append(True, (rows[1:] != rows[:-1]).any(axis=1))[: len(rows)]
    _, number = np.unique(rows[new], axis=0, return_inverse=True)
    return np.asarray(number.ravel()[np.cumsum(new) - 1], dtype=np.int64)


def describe_file(name: str, counts: Mapping[str, int], skipped: Sequence[Skipped], *, escaped: bool) -> Iterator[str]:
    """Compose the warnings about one file."""
    if escaped:
        yield f"{name} {files.ESCAPES_UNDONE}; places are those of the bytes after that."
    if skipped:
        damage = (
            f"; {counts['damaged']} places in them begin like an ensemble and fail its checksum, chance pairs of 7F "
            f"included, and by the ensemble numbers {counts['lost']} ensembles are lost"
        )
        belong = f"{name}: {counts['bytes_skipped']} of {counts['bytes_total']} bytes belong to no good ensemble"
        yield f"{belong} and were skipped{damage if counts['damaged'] else ''}."
        ranges = [f"{each.offset} to {each.offset + each.length - 1} ({each.reason})" for each in skipped]
        yield f"{name}: skipped bytes {files.list_some(ranges)}."
    yield from (
        f"{name}: {counts[key]} good ensembles {reason} and were left out."
        for key, reason in DROPPED.items()
        if counts[key]
    )


def describe_recording(leaders: Ensembles, counts: Mapping[str, int], settings: Settings) -> Iterator[str]:
    """Compose the warnings about the headings and the configuration of a recording."""
    n, biases, applied = len(leaders), np.unique(leaders.heading_bias_deg), settings.declination_applied
    alignments, contradicted = np.unique(leaders.heading_alignment_deg), leaders.angle_contradicted
    bias, alignment, angle = map(_join_numbers, (biases, alignments, np.unique(leaders.beam_angle_deg[contradicted])))
    words = ("up", "down") if mostly_looks_up(leaders, settings) else ("down", "up")
    says = "the others do, and each was turned by its own" if settings.orientation is None else "the metadata do"
    in_earth, in_ship = (
        ~leaders.tilts_used & (leaders.coordinates == code) for code in (Coordinates.EARTH, Coordinates.SHIP)
    )
    yield from applicable(
        {
            f"The file's heading bias EB of {bias} degrees was taken out of the headings.": (
                applied is None and biases.any()
            ),
            f"declination_applied of {applied} degrees was taken out of the headings, although the file's heading bias "
            f"EB is {bias} degrees.": applied is not None and np.round(np.subtract.outer(biases, applied), 2).any(),
            f"heading_alignment of {settings.heading_alignment or 0.0:g} degrees was added to the headings; the file's heading "
            f"alignment EA is {alignment} degrees.": alignments.any() and settings.heading_alignment is not None,
            f"The heading of {leaders.heading_deg[0]:g} degrees was set by hand (EH), as EZ takes none from the "
            "compass: it cannot be corrected.": (
                not leaders.heading_measured.any() and np.ptp(leaders.heading_deg) == 0.0
            ),
            f"{counts['heading_missing']} of {n} ensembles have no valid heading.": (
                np.isnan(leaders.heading_deg).any()
            ),
            f"{counts['orientation_disagrees']} of {n} ensembles say that they looked {words[1]}; {words[0]} counts, "
            f"as {says}.": counts["orientation_disagrees"] > STRAY * n,
            f"{counts['three_beam']} of {counts['velocities']} currents come from three beams: one beam is dead or "
            "weak, and nothing checks the other three.": 2 * counts["three_beam"] > counts["velocities"],
            f"The recording holds {counts['configurations']} configurations; bins that one lacks are padded, each has "
            "its ranges.": counts["configurations"] > 1,
            "Velocities in earth coordinates were turned by the instrument without its tilts.": in_earth.any(),
            "Velocities in ship coordinates were recorded without tilts; they were turned as the instrument's own.": (
                in_ship.any()
            ),
            "Some ensembles do not say their beam angle; beam velocities of theirs cannot be used.": (
                np.isnan(leaders.beam_angle_deg).any()
            ),
            f"{contradicted.sum()} of {n} ensembles state another beam angle in byte 58; the {angle} degrees of the "
            "system configuration count.": contradicted.any(),
        }
    )
    yield from describe_averages(float(np.median(leaders.average_s)), leaders.time_s)


def count_configurations(leaders: Ensembles) -> int:
    """Count the configurations, without the distance of bin 1, which varies with the speed of sound."""
    columns = leaders.cells, leaders.cell_m, leaders.blank_m, leaders.coordinates
    setups = np.column_stack([*columns, leaders.beam_angle_deg, leaders.frequency_khz])
    return len(np.unique(_number_rows(np.nan_to_num(setups, nan=-1.0))))


def mostly_looks_up(leaders: Ensembles, settings: Settings) -> bool:
    """Return whether the instrument looks up, by the metadata or else by the majority of ensembles."""
    return bool(np.mean(looks_up(leaders, settings)) > 0.5)


def _join_numbers(values: Floats) -> str:
    return " and ".join(f"{value:g}" for value in values[:5]) + (" and others" if len(values) > 5 else "")
