"""Account of reading PD0 files: what was left out or is odd, as counts and warnings of the record."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from compasslib.readers import telemetry
from compasslib.readers.averages import describe_averages
from compasslib.readers.pd0.currents import Choices, looks_up
from compasslib.readers.pd0.fields import EARTH, SHIP, Ensembles, LeftOut
from compasslib.readers.pd0.frames import Places, Skipped
from compasslib.types import Floats

RANGES_SHOWN = 20
FEW_DISAGREE = 0.01  # of the ensembles: on deck and in the hand an instrument looks any way; they are counted only
MOST_OF_THREE = 0.5  # of the currents; more than that solved from three beams is a beam that fails
_BIAS_TOLERANCE_DEG = 0.01


@dataclass(frozen=True)
class FileReport:
    """What one file held; ``skipped`` and the ensembles are all of its bytes."""

    path: str
    bytes_total: int
    ensembles: int  # good, dated and with velocities of four beams
    left_out: LeftOut
    three_beam: int  # currents solved from three beams, by this reader or by the instrument
    lost: int  # ensembles missing by their numbers where bytes were skipped
    skipped: tuple[Skipped, ...]
    escaped: bool = False  # the bytes came with a modem's escapes, which were undone

    @property
    def bytes_skipped(self) -> int:
        """Bytes that belong to no good ensemble."""
        return sum(each.length for each in self.skipped)

    @property
    def damaged(self) -> int:
        """Places that begin like an ensemble and whose checksum fails; chance pairs of 7F are among them."""
        return sum(each.damaged for each in self.skipped)


def lost_ensembles(offset: Places, number: Places, skipped: Sequence[Skipped]) -> int:
    """Return how many ensembles are missing by number where bytes were skipped between two good ones.

    Args:
        offset: (n,) where the good ones begin, bytes, ascending.
        number: (n,) their numbers.
    """
    after = np.searchsorted(offset, [each.offset for each in skipped])
    inside = after[(after > 0) & (after < len(offset))]
    gaps = number[inside] - number[inside - 1] - 1
    # Numbers fall back where a recording begins anew: then nothing is known.
    return int(gaps[gaps > 0].sum())


def counts_of(
    reports: Sequence[FileReport], leaders: Ensembles, heading_deg: Floats, choices: Choices
) -> dict[str, int]:
    """Return the numbers that go into the record.

    Args:
        heading_deg: (n,) NaN where missing.
    """
    names = "ensembles damaged lost bytes_skipped bytes_total three_beam"
    summed = {name: sum(getattr(report, name) for report in reports) for name in names.split()}
    summed |= asdict(sum((report.left_out for report in reports), LeftOut()))
    return summed | {
        "orientation_disagrees": int(np.sum(leaders.looks_up != faces_up(leaders, choices))),
        "heading_missing": int(np.isnan(heading_deg).sum()),
        "configurations": _configurations(leaders),
    }


def faces_up(leaders: Ensembles, choices: Choices) -> bool:
    """Return whether the instrument looks up: by the metadata, else by most of its ensembles."""
    return bool(np.mean(looks_up(leaders, choices)) > 0.5)


def warnings_of(
    reports: Sequence[FileReport], leaders: Ensembles, counts: dict[str, int], choices: Choices
) -> tuple[str, ...]:
    """Return the warnings of the record.

    Args:
        counts: from ``counts_of``, and ``velocities``, how many are known.
    """
    of_files = [line for report in reports for line in _of_file(report)]
    return (*of_files, *_of_headings(leaders, counts, choices), *_of_configuration(leaders, counts, choices))


def _of_file(report: FileReport) -> list[str]:
    name = Path(report.path).name
    lines = [f"{name} {telemetry.UNDONE}; places are those of the bytes after that."] * report.escaped
    if report.skipped:
        belong = f"{name}: {report.bytes_skipped} of {report.bytes_total} bytes belong to no good ensemble"
        lines.append(f"{belong} and were skipped{_damage(report)}.")
        lines.append(f"{name}: skipped {_ranges(report.skipped)}.")
    why = {
        "hold no velocities": report.left_out.without_velocity,
        "have an impossible date": report.left_out.bad_dates,
        "hold other columns than those of four beams": report.left_out.not_of_four_beams,
    }
    lines += [f"{name}: {count} good ensembles {reason} and were left out." for reason, count in why.items() if count]
    return lines


def _damage(report: FileReport) -> str:
    if not report.damaged:
        return ""
    return (
        f"; {report.damaged} places in them begin like an ensemble and fail its checksum, chance pairs of 7F included, "
        f"and by the ensemble numbers {report.lost} ensembles are lost"
    )


def _ranges(skipped: Sequence[Skipped]) -> str:
    shown = [f"bytes {s.offset} to {s.offset + s.length - 1} ({s.reason})" for s in skipped[:RANGES_SHOWN]]
    rest = skipped[RANGES_SHOWN:]
    if rest:
        shown.append(f"and {len(rest)} more ranges of {sum(s.length for s in rest)} bytes in all")
    return ", ".join(shown)


def _of_headings(leaders: Ensembles, counts: dict[str, int], choices: Choices) -> list[str]:
    lines = []
    biases, applied = np.unique(leaders.heading_bias_deg), choices.declination_applied
    written = _list(biases)
    if applied is None and biases.any():
        lines.append(f"The file's heading bias EB of {written} degrees was taken out of the headings.")
    if applied is not None and (np.abs(np.subtract.outer(biases, applied)) > _BIAS_TOLERANCE_DEG).any():
        lines.append(
            f"declination_applied of {applied} degrees was taken out of the headings, "
            f"although the file's heading bias EB is {written} degrees."
        )
    if leaders.heading_alignment_deg.any() and choices.heading_alignment is not None:
        found = _list(np.unique(leaders.heading_alignment_deg))
        added = f"heading_alignment of {choices.heading_alignment:g} degrees was added to the headings"
        lines.append(f"{added}; the file's heading alignment EA is {found} degrees.")
    if counts["heading_missing"]:
        lines.append(f"{counts['heading_missing']} of {len(leaders)} ensembles have no valid heading.")
    return lines


def _of_configuration(leaders: Ensembles, counts: dict[str, int], choices: Choices) -> list[str]:
    lines = []
    if counts["orientation_disagrees"] > FEW_DISAGREE * len(leaders):
        word, other = ("up", "down") if faces_up(leaders, choices) else ("down", "up")
        says = "the others do, and each was turned by its own" if choices.orientation is None else "the metadata do"
        count = counts["orientation_disagrees"]
        lines.append(f"{count} of {len(leaders)} ensembles say that they looked {other}; {word} counts, as {says}.")
    if counts["three_beam"] > MOST_OF_THREE * counts["velocities"]:
        shown = f"{counts['three_beam']} of {counts['velocities']} currents"
        lines.append(f"{shown} come from three beams: one beam is dead or weak, and nothing checks the other three.")
    if counts["configurations"] > 1:
        count = counts["configurations"]
        lines.append(
            f"The recording holds {count} configurations; bins that one lacks are padded, each has its ranges."
        )
    level = ~leaders.tilts_used
    if (level & (leaders.coordinates == EARTH)).any():
        lines.append("Velocities in earth coordinates were turned by the instrument without its tilts.")
    if (level & (leaders.coordinates == SHIP)).any():
        lines.append(
            "Velocities in ship coordinates were recorded without tilts; they were turned as the instrument's own."
        )
    if np.isnan(leaders.beam_angle_deg).any():
        lines.append("Some ensembles do not say their beam angle; beam velocities of theirs cannot be used.")
    return [*lines, *describe_averages(float(np.median(leaders.average_s)), leaders.time_s)]


def _configurations(leaders: Ensembles) -> int:
    """Count them; the distance of bin 1 follows the speed of sound by a centimetre and makes none."""
    columns = (
        *(leaders.cells, leaders.cell_m, leaders.blank_m, leaders.coordinates),
        *(leaders.beam_angle_deg, leaders.frequency_khz),
    )
    table: Floats = np.stack([np.asarray(column, dtype=float) for column in columns], axis=1)
    table = np.where(np.isnan(table), -1.0, table)
    # Most ensembles equal the one before; only the others are worth sorting.
    changes = np.any(table[1:] != table[:-1], axis=1)
    return len(np.unique(table[np.r_[True, changes]], axis=0))


def _list(values: Floats) -> str:
    return " and ".join(f"{value:g}" for value in values[:5]) + (" and others" if len(values) > 5 else "")
