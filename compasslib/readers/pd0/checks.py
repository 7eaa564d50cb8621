"""Check the consistency of the intact ensembles of a PD0 recording, and report what was dropped.

The ensembles of a recording share one instrument, one sequence of numbers and one clock. Settings in the metadata that
contradict them raise an error.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import AppliedDeclination
from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.pd0.currents import Settings, looks_up
from compasslib.readers.pd0.fields import DROPPED, STRAY, Coordinates, Ensembles
from compasslib.readers.pd0.frames import Places, Skipped
from compasslib.readers.times import describe_averages
from compasslib.records import BAD, GOOD, PROBABLY_BAD, Flags
from compasslib.types import DAY_S, Bools, Floats

ADVICE = "give each recording as a file of its own"
FOUR = "export its four slanted beams, or give the velocities as a table"


def refuse_mixed(where: str, leaders: Ensembles) -> None:
    """Reject ensembles of two instruments, as of one that looks up and one that looks down, or not of four beams.

    Raises:
        InputError: there are more of the second kind than a share STRAY.
    """
    for name, numbers in (("serial number", leaders.serial), ("processor board", leaders.board)):
        several = _frequent_numbers(numbers)
        if len(several) > 1:
            shown = " and ".join(f"{name} {number} in {count}" for number, count in several.items())
            advice = f"name one instrument's files only, or {ADVICE}"
            raise InputError(where, expected="ensembles of one instrument", found=shown, advice=advice)
    beams, count = Counter(leaders.beams.tolist()).most_common(1)[0]
    if beams != 4:
        raise InputError(where, expected="4 beams", found=f"{beams} in {count} ensembles", advice=FOUR)
    number = _number_kinds(leaders)
    kinds = Counter(number.tolist())
    if len(kinds) > 1 and kinds.most_common(2)[1][1] > STRAY * len(leaders):
        described = []
        for kind, count in kinds.most_common(3):
            k = int(np.flatnonzero(number == kind)[0])
            cells = f"{leaders.cells[k]} cells of {leaders.cell_m[k]:g} m"
            facing = "up" if leaders.looks_up[k] else "down"
            described.append(f"{count} of {leaders.frequency_khz[k]:g} kHz with {cells} looking {facing}")
        shown = " and ".join(described)
        raise InputError(where, expected="ensembles of one instrument", found=shown, advice=ADVICE)


def refuse_alignment(where: str, leaders: Ensembles, stated: float | None) -> None:
    """Reject an EA without ``heading_alignment``, and a nonzero ``heading_alignment`` with a zero or changing EA."""
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


def refuse_rotation(where: str, stated: AppliedDeclination | None, *, is_earth: bool) -> None:
    """Reject a declination of velocities that differs from that of headings unless they are in earth coordinates."""
    if stated is not None and stated.velocity and stated.differs and not is_earth:
        expected = "velocity: 0, as velocities are not in earth coordinates and are turned by the headings"
        raise InputError(f"{where}: declination_applied", expected=expected, found=stated, advice="correct it")


def serial_number(where: str, leaders: Ensembles, stated: str | None) -> str:
    """Determine the instrument's serial number, empty if the file states none; see ``match_serial_number``."""
    return match_serial_number(where, str(next(iter(_frequent_numbers(leaders.serial)), "")), stated)


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


def _frequent_numbers(numbers: NDArray[np.int64]) -> dict[int, int]:
    """Count the nonzero numbers that occur too often to be damage, in descending order of frequency.

    Values that differ from ensemble to ensemble are not numbers of an instrument.
    """
    most = Counter(numbers[numbers != 0].tolist()).most_common()
    return {number: count for number, count in most if count > max(1.0, STRAY * len(numbers))}


def _has_other_number(numbers: NDArray[np.int64]) -> Bools:
    """Flag ensembles with a serial or board number other than the usual one of the recording, (n,)."""
    usual = next(iter(_frequent_numbers(numbers)), 0)
    return (numbers != 0) & (numbers != usual) & (usual != 0)


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
    angle = np.nan_to_num(leaders.beam_angle_deg)
    other = _has_other_number(leaders.serial) | _has_other_number(leaders.board)
    heads = np.column_stack([np.nan_to_num(leaders.frequency_khz), angle, leaders.convex, leaders.beams, other])
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


@dataclass(frozen=True)
class FileReport:
    """Content of one file; ``skipped`` and the intact ensembles account for all of its bytes."""

    path: str
    bytes_total: int
    ensembles: int  # number of intact, dated ensembles with velocities of four beams
    dropped: Counter[str]
    three_beam: int  # number of currents solved from three beams, by this reader or by the instrument
    lost: int  # number of ensembles missing where bytes were skipped, by their numbers
    skipped: tuple[Skipped, ...]
    escaped: bool = False  # whether a modem's escapes were removed from the bytes

    @property
    def bytes_skipped(self) -> int:
        """Number of bytes that belong to no intact ensemble."""
        return sum(each.length for each in self.skipped)

    @property
    def damaged(self) -> int:
        """Number of places that begin like an ensemble but fail its checksum, including chance pairs of 7F."""
        return sum(each.damaged for each in self.skipped)


def count_lost_ensembles(offset: Places, number: Places, skipped: Sequence[Skipped]) -> int:
    """Count the ensembles lost where bytes were skipped, from the numbers of the intact ensembles around them."""
    after = np.searchsorted(offset, [each.offset for each in skipped])
    inside = after[(after > 0) & (after < len(offset))]
    gaps = number[inside] - number[inside - 1] - 1
    # Decreasing numbers mark the start of a new recording, where the loss is unknown.
    return int(gaps[gaps > 0].sum())


def summarize_counts(
    reports: Sequence[FileReport], leaders: Ensembles, heading_deg: Floats, settings: Settings
) -> dict[str, int]:
    """Summarize the counts of all files for the record."""
    names = "ensembles damaged lost bytes_skipped bytes_total three_beam"
    summed = {name: sum(getattr(report, name) for report in reports) for name in names.split()}
    summed |= {reason: sum(report.dropped[reason] for report in reports) for reason in DROPPED}
    # Without the distance of bin 1, which varies by centimetres with the speed of sound.
    columns = leaders.cells, leaders.cell_m, leaders.blank_m, leaders.coordinates
    setups = np.column_stack([*columns, leaders.beam_angle_deg, leaders.frequency_khz])
    return summed | {
        "orientation_disagrees": int(np.sum(leaders.looks_up != mostly_looks_up(leaders, settings))),
        "heading_missing": int(np.isnan(heading_deg).sum()),
        "configurations": len(np.unique(_number_rows(np.nan_to_num(setups, nan=-1.0)))),
    }


def mostly_looks_up(leaders: Ensembles, settings: Settings) -> bool:
    """Return whether the instrument looks up, by the metadata or else by the majority of ensembles."""
    return bool(np.mean(looks_up(leaders, settings)) > 0.5)


def describe_reading(
    reports: Sequence[FileReport], leaders: Ensembles, counts: dict[str, int], settings: Settings
) -> tuple[str, ...]:
    """Compose the warnings of the record; ``counts`` are those of ``summarize_counts`` and ``velocities``."""
    files = [line for report in reports for line in _describe_file(report)]
    headings = _describe_headings(leaders, counts, settings)
    return (*files, *headings, *_describe_configuration(leaders, counts, settings))


def _describe_file(report: FileReport) -> list[str]:
    name = Path(report.path).name
    lines = [f"{name} {files.ESCAPES_UNDONE}; places are those of the bytes after that."] * report.escaped
    if report.skipped:
        belong = f"{name}: {report.bytes_skipped} of {report.bytes_total} bytes belong to no good ensemble"
        damage = (
            f"; {report.damaged} places in them begin like an ensemble and fail its checksum, chance pairs of 7F "
            f"included, and by the ensemble numbers {report.lost} ensembles are lost"
        )
        lines.append(f"{belong} and were skipped{damage if report.damaged else ''}.")
        ranges = [f"{s.offset} to {s.offset + s.length - 1} ({s.reason})" for s in report.skipped]
        lines.append(f"{name}: skipped bytes {files.list_some(ranges)}.")
    why = "hold no velocities", "have an impossible date", "hold other columns than those of four beams"
    counts = zip(why, (report.dropped[reason] for reason in DROPPED), strict=True)
    return lines + [f"{name}: {count} good ensembles {reason} and were left out." for reason, count in counts if count]


def _describe_headings(leaders: Ensembles, counts: dict[str, int], settings: Settings) -> list[str]:
    lines = []
    biases, applied = np.unique(leaders.heading_bias_deg), settings.declination_applied
    written = _join_numbers(biases)
    if applied is None and biases.any():
        lines.append(f"The file's heading bias EB of {written} degrees was taken out of the headings.")
    if applied is not None and np.round(np.subtract.outer(biases, applied), 2).any():
        reason = f"although the file's heading bias EB is {written} degrees"
        lines.append(f"declination_applied of {applied} degrees was taken out of the headings, {reason}.")
    if leaders.heading_alignment_deg.any() and settings.heading_alignment is not None:
        shown = _join_numbers(np.unique(leaders.heading_alignment_deg))
        added = f"heading_alignment of {settings.heading_alignment:g} degrees was added to the headings"
        lines.append(f"{added}; the file's heading alignment EA is {shown} degrees.")
    if not leaders.heading_measured.any() and np.ptp(leaders.heading_deg) == 0.0:
        heading = f"The heading of {leaders.heading_deg[0]:g} degrees was set by hand (EH)"
        lines.append(f"{heading}, as EZ takes none from the compass: it cannot be corrected.")
    if counts["heading_missing"]:
        lines.append(f"{counts['heading_missing']} of {len(leaders)} ensembles have no valid heading.")
    return lines


def _describe_configuration(leaders: Ensembles, counts: dict[str, int], settings: Settings) -> list[str]:
    lines = []
    if counts["orientation_disagrees"] > STRAY * len(leaders):
        word, other = ("up", "down") if mostly_looks_up(leaders, settings) else ("down", "up")
        says = "the others do, and each was turned by its own" if settings.orientation is None else "the metadata do"
        count = counts["orientation_disagrees"]
        lines.append(f"{count} of {len(leaders)} ensembles say that they looked {other}; {word} counts, as {says}.")
    if 2 * counts["three_beam"] > counts["velocities"]:
        shown = f"{counts['three_beam']} of {counts['velocities']} currents"
        lines.append(f"{shown} come from three beams: one beam is dead or weak, and nothing checks the other three.")
    if counts["configurations"] > 1:
        shown = f"The recording holds {counts['configurations']} configurations"
        lines.append(f"{shown}; bins that one lacks are padded, each has its ranges.")
    level = ~leaders.tilts_used
    if (level & (leaders.coordinates == Coordinates.EARTH)).any():
        lines.append("Velocities in earth coordinates were turned by the instrument without its tilts.")
    if (level & (leaders.coordinates == Coordinates.SHIP)).any():
        lines.append(
            "Velocities in ship coordinates were recorded without tilts; they were turned as the instrument's own."
        )
    if np.isnan(leaders.beam_angle_deg).any():
        lines.append("Some ensembles do not say their beam angle; beam velocities of theirs cannot be used.")
    if leaders.angle_contradicted.any():
        angle = _join_numbers(np.unique(leaders.beam_angle_deg[leaders.angle_contradicted]))
        shown = f"{leaders.angle_contradicted.sum()} of {len(leaders)} ensembles state another beam angle in byte 58"
        lines.append(f"{shown}; the {angle} degrees of the system configuration count.")
    return [*lines, *describe_averages(float(np.median(leaders.average_s)), leaders.time_s)]


def _join_numbers(values: Floats) -> str:
    return " and ".join(f"{value:g}" for value in values[:5]) + (" and others" if len(values) > 5 else "")
