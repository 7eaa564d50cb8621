"""Read RDI PD0, the raw files of WorkHorse, Ocean Surveyor, Sentinel V and related ADCPs.

Damaged ensembles are dropped and counted, never repaired: a flipped byte costs one ensemble. Bottom track, navigation
and the separate blocks of a fifth beam are ignored; other than four columns raise an error. Beam velocities are mapped
to the bin depths of a level instrument before they are combined.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError, applicable
from compasslib.readers import files
from compasslib.readers.pd0 import currents, fields
from compasslib.readers.pd0.currents import Settings, looks_up
from compasslib.readers.pd0.fields import COUNTS, DROPPED, STRAY, Coordinates, Ensembles
from compasslib.readers.pd0.frames import EnsembleRun, Skipped, batches, find_ensembles
from compasslib.readers.times import describe_averages
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_GOOD, Flags, Record
from compasslib.types import DAY_S, Floats

ADVICE = "give each recording as a file of its own"
FOUR = "export its four slanted beams, or give the velocities as a table"
Columns = dict[str, NDArray[Any]]  # by name, (n, m, ...) each
# Types of the profiles that a record keeps: velocities are computed in float64, and stored in float32 in any case.
PROFILES = dict.fromkeys(("east", "north", "up", "error_velocity"), "f4") | {"quality": "i1"}
PROFILES |= dict.fromkeys(COUNTS, "4u1")


@dataclass(frozen=True, eq=False)
class _File:
    """Leaders of one file, and the batches whose profiles are decoded later, straight to the arrays of the record."""

    batches: list[list[EnsembleRun]]
    leaders: Ensembles  # without profiles
    counts: dict[str, int]
    warnings: tuple[str, ...]


def decode(path: str | Path) -> Ensembles:
    """Decode all intact ensembles of a file as recorded, without any rotation.

    Raises:
        InputError: the file cannot be read or holds no ensemble with velocities.
    """
    runs, _ = find_ensembles(path)
    decoded = [fields.decode_runs(batch) for batch in batches(runs)]
    parts = [part for part, _ in decoded if part]
    _refuse_empty(path, sum(map(len, parts)), sum((dropped for _, dropped in decoded), Counter[str]()))
    return fields.concatenate(parts)


def read(
    paths: Sequence[Path],
    *,
    orientation: str | None,
    declination_applied: float | Mapping[str, float] | None,
    heading_alignment: float | None,
    serial_number: str | None = None,
    sound_speed: str | Mapping[str, float] | None = None,
) -> Record:
    """Read one record from files sorted by their first times, with currents rotated by the recorded magnetic heading.

    The settings override what the file states, see ``currents.Settings``.

    Raises:
        InputError: a file is unreadable, holds no ensemble or other than four beams, the serial number differs, or EA
            and ``heading_alignment`` contradict each other.
    """
    applied = parse_applied_declination(declination_applied)
    settings = Settings(orientation, applied, heading_alignment, serial_number, sound_speed)
    content = sorted((_read_file(path, settings) for path in paths), key=lambda file: float(file.leaders.time_s[0]))
    return _record(", ".join(map(str, paths)), content, settings)


def _refuse_empty(path: str | Path, count: int, dropped: Counter[str]) -> None:
    misfits = dropped["not_of_four_beams"]
    if misfits > STRAY * (misfits + count):  # more than damage explains
        expected = "blocks of four columns, as many rows as the leader tells cells"
        shown = f"others, perhaps of five beams, in {misfits} of {misfits + count} ensembles"
        raise InputError(str(path), expected=expected, found=shown, advice=FOUR)
    if count:
        return
    shown = f"{dropped.total()} ensembles without velocities or with impossible dates" if dropped else ""
    raise files.foreign(path, "PD0 ensembles (7F 7F) with velocities", "pd0", shown)


def _read_file(path: Path, settings: Settings) -> _File:
    """Read the leaders of one file in batches."""
    runs, skipped = find_ensembles(path)
    size, widest, dropped = Path(path).stat().st_size, 0, Counter[str]()
    most, count = sum(run.count for run in runs), 0
    used, columns = list[list[EnsembleRun]](), Columns()
    for batch in batches(runs):
        leaders, left_out = fields.decode_runs(batch, profiles=False)
        dropped += left_out
        if leaders is None:
            continue
        aligned = leaders.heading_alignment_deg
        refuse_alignment(f"{path}: heading alignment EA", aligned, settings.heading_alignment)
        is_earth = bool((leaders.coordinates == Coordinates.EARTH).all())
        refuse_rotation(str(path), settings.declination_applied, is_earth=is_earth)
        used.append(batch)
        for name, column in vars(leaders).items():
            whole = columns.setdefault(name, np.empty((most, *column.shape[1:]), column.dtype))
            whole[count : count + len(column)] = column
        count += len(leaders)
        widest = max(widest, int(leaders.cells.max()))
        _refuse_padding(str(path), count, widest, size)
    _refuse_empty(path, count, dropped)
    failed = sum(each.failed for each in skipped)
    files.refuse_mostly_damaged(path, "PD0 ensembles", damaged=failed, whole=count + dropped.total())
    leaders = Ensembles(**{name: column[:count] for name, column in columns.items()})
    counts = {"three_beam": 0, "ensembles": count} | {reason: dropped[reason] for reason in DROPPED}
    counts["damaged"] = sum(each.damaged for each in skipped)
    counts["bytes_skipped"] = sum(each.length for each in skipped)
    counts["bytes_total"] = counts["bytes_skipped"] + sum(run.size for run in runs)
    # Count the ensembles lost where bytes were skipped, from the numbers of the intact ensembles around them.
    after = np.searchsorted(leaders.offset, [each.offset for each in skipped])
    inside = after[(after > 0) & (after < count)]
    gaps = leaders.number[inside] - leaders.number[inside - 1] - 1
    # Decreasing numbers mark the start of a new recording, where the loss is unknown.
    counts["lost"] = int(gaps[gaps > 0].sum())
    return _File(used, leaders, counts, tuple(describe_file(Path(path).name, counts, skipped)))


def _refuse_padding(where: str, count: int, cells: int, size: int) -> None:
    """Reject profiles whose arrays, padded to the widest, would take far more memory than the size of the files."""
    each = sum(np.dtype(form).itemsize for form in PROFILES.values())
    files.refuse_large_arrays(where, count * cells * each, size, cells)


def _decode_profiles(content: Sequence[_File], factor: Floats, shape: tuple[int, int], settings: Settings) -> Columns:
    """Decode the profiles of files batch by batch to arrays of a shape (n, m), and the echo next to the instrument.

    Three-beam solutions are added to the counts of each file.

    Args:
        factor: (n,) of the velocities.
    """
    arrays: Columns = {name: np.empty(shape, form) for name, form in PROFILES.items()}
    arrays["near_echo"] = np.empty(shape[:1])
    end = 0
    for file in content:
        first = end
        for batch in file.batches:
            ensembles, _ = fields.decode_runs(batch)
            if ensembles is None:
                continue
            begin, end = end, end + len(ensembles)
            east, north, up, error, three_beam = currents.compute_currents(ensembles, settings)
            file.counts["three_beam"] += three_beam
            by = factor[begin:end, None]
            columns: Columns = {"quality": currents.flag_currents(ensembles, east, north)}
            columns |= {
                "east": east * by,
                "north": north * by,
                "up": up.astype(np.float32) * by,
                "error_velocity": error.astype(np.float32) * by,
            }
            columns |= {name: getattr(ensembles, name) for name in COUNTS}
            for name, part in columns.items():
                arrays[name][begin:end, : part.shape[1]] = part
                fill = MISSING if name == "quality" else np.nan if part.dtype.kind == "f" else 0
                arrays[name][begin:end, part.shape[1] :] = fill
            near = ensembles.echo[:, :2].astype(float)  # low where water is clear
            arrays["near_echo"][begin:end] = np.where(near.any(axis=(1, 2)), near.mean(axis=(1, 2)), np.nan)
        quality = arrays["quality"][first:end]
        if not arrays["percent_good"][first:end].any():
            # An all-zero percent-good block was never filled, and says nothing about the velocities.
            quality[quality == BAD] = GOOD
    return arrays


def _record(where: str, content: Sequence[_File], settings: Settings) -> Record:
    leaders = fields.concatenate([file.leaders for file in content])
    refuse_mixed(where, leaders)
    written = str(next(iter(frequent_numbers(leaders.serial)), ""))
    serial = match_serial_number(where, written, settings.serial_number)
    cells = int(leaders.cells.max())
    _refuse_padding(where, len(leaders), cells, sum(file.counts["bytes_total"] for file in content))
    flags, strays, notes = flag_strays(leaders)
    sound = currents.correct_sound_speed(leaders, settings.sound_speed)
    notes += [sound.sentence] if sound.sentence else []
    velocity_flags = np.where(sound.doubtful, np.maximum(flags, PROBABLY_GOOD), flags)
    arrays = _decode_profiles(content, sound.factor, (len(leaders), cells), settings)
    counts = {key: sum(file.counts[key] for file in content) for key in content[0].counts}
    heading = currents.magnetic_heading(leaders, settings)
    upward = mostly_looks_up(leaders, settings)
    # Without the distance of bin 1, which varies with the speed of sound.
    setup = leaders.cells, leaders.cell_m, leaders.blank_m, leaders.coordinates
    setups = np.column_stack([*setup, leaders.beam_angle_deg, leaders.frequency_khz])
    counts |= strays | {
        "velocities": int(np.isfinite(arrays["east"]).sum()),
        "orientation_disagrees": int(np.sum(leaders.looks_up != upward)),
        "heading_missing": int(np.isnan(heading).sum()),
        "configurations": len(np.unique(_number_rows(np.nan_to_num(setups, nan=-1.0)))),
        "sound_speed_corrected": int(np.sum(sound.factor != 1.0)),
        "sound_speed_doubtful": int(sound.doubtful.sum()),
    }
    profiles: dict[str, NDArray[Any]] = {name: arrays[name] for name in ("up", "error_velocity")}
    for name, (_, bit) in COUNTS.items():
        if arrays[name].any():  # else the block was never filled
            lacking = (np.arange(cells) >= leaders.cells[:, None]) | ((leaders.blocks & bit) == 0)[:, None]
            profiles[name] = np.where(lacking[..., None], np.int16(-1), arrays[name]) if lacking.any() else arrays[name]
    codes = np.unique(leaders.coordinates)
    # Distances of the bins, (n, m) metres, NaN beyond the last bin of an ensemble.
    # With a single configuration all ensembles share one row.
    same = all(np.ptp(column) == 0.0 for column in (leaders.bin1_m, leaders.cell_m, leaders.cells))
    rows = slice(1) if same else slice(None)
    ranges = leaders.bin1_m[rows, None] + leaders.cell_m[rows, None] * np.arange(cells)
    ranges[np.arange(cells) >= leaders.cells[rows, None]] = np.nan
    ranges *= sound.range_factor
    return Record(
        time_s=leaders.time_s,
        east=arrays["east"],
        north=arrays["north"],
        bin_range_m=(np.broadcast_to(ranges, (len(leaders), cells)) if same else ranges),
        heading_deg=heading,
        pitch_deg=currents.true_pitch(leaders.tilt1_deg, leaders.tilt2_deg),
        roll_deg=leaders.tilt2_deg,
        pressure_dbar=leaders.pressure_dbar,
        depth_m=leaders.depth_m,
        temperature_c=leaders.temperature_c,
        supply_voltage=leaders.supply_voltage,
        channels={
            "transmit_current": leaders.transmit_current,
            "heading_spread": leaders.heading_spread_deg,
            "echo": arrays["near_echo"],
        },
        channel_units={"transmit_current": "count", "heading_spread": "degree", "echo": "count"},
        profiles=profiles,
        bins_mapped=bool(np.all(leaders.bins_mapped | (leaders.coordinates == Coordinates.BEAM))),
        recorded_in=Coordinates(codes[0]).name.lower() if len(codes) == 1 else "several",
        quality=np.maximum(arrays["quality"], velocity_flags[:, None]),
        heading_quality=np.where(np.isnan(heading), MISSING, flags).astype(np.int8),
        looks_up=upward,
        beam_angle_deg=_most_frequent(leaders.beam_angle_deg),
        direction_reference="magnetic",
        heading_bias_deg=_most_frequent(currents.heading_bias(leaders, settings)),
        velocity_bias_deg=_most_frequent(currents.velocity_bias(leaders, settings)),
        serial_number=serial,
        counts=counts,
        sound_speed=sound.sentence,
        warnings=(
            *(line for file in content for line in file.warnings),
            *describe_recording(leaders, counts, settings),
            *notes,
        ),
    )


def _most_frequent(values: Floats) -> float:
    distinct, times = np.unique(values, return_counts=True)
    return float(distinct[np.argmax(times)])


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
    """Flag ensembles of another instrument, (n,); also give their count, and warnings about them and steps of time."""
    kinds = _number_kinds(leaders)
    other = kinds != np.bincount(kinds).argmax()
    count = int(other.sum())
    notes = [f"{count} ensembles are of another instrument than the rest; they were flagged."] if count else []
    steps = np.diff(leaders.time_s)
    usual = float(np.median(np.abs(steps))) if len(steps) else 0.0
    lasting = leaders.time_s[1:] <= np.minimum.accumulate(leaders.time_s[:0:-1])[::-1]
    jumps = (np.diff(leaders.number) == 1) & (steps > max(DAY_S, 20.0 * usual)) & lasting
    for k in np.flatnonzero(jumps)[:3].tolist():  # which of the two it was, the file does not tell
        ends, numbers = leaders.time_s[k : k + 2].astype("datetime64[s]").astype(str), leaders.number[k : k + 2]
        notes.append(
            f"Time steps from {' to '.join(ends)} between ensembles {numbers[0]} and {numbers[1]}, whose numbers "
            "follow each other: recording paused, or the clock was set and later times are wrong; check the log."
        )
    return np.where(other, BAD, GOOD).astype(np.int8), {"other_instrument": count}, notes


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


def describe_file(name: str, counts: Mapping[str, int], skipped: Sequence[Skipped]) -> Iterator[str]:
    """Compose the warnings about one file."""
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
    heading_alignment, aligned = settings.heading_alignment or 0.0, settings.heading_alignment is not None
    yield from applicable(
        {
            f"The file's heading bias EB of {bias} degrees was taken out of the headings.": (
                applied is None and biases.any()
            ),
            f"declination_applied of {applied} degrees was taken out of the directions, although the file's heading "
            f"bias EB is {bias} degrees.": applied is not None
            and np.round(np.subtract.outer(biases, applied), 2).any(),
            f"heading_alignment of {heading_alignment:g} degrees was added to the headings; the file's "
            f"heading alignment EA is {alignment} degrees.": alignments.any() and aligned,
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


def mostly_looks_up(leaders: Ensembles, settings: Settings) -> bool:
    """Return whether the instrument looks up, by the metadata or else by the majority of ensembles."""
    return bool(np.mean(looks_up(leaders, settings)) > 0.5)


def _join_numbers(values: Floats) -> str:
    return " and ".join(f"{value:g}" for value in values[:5]) + (" and others" if len(values) > 5 else "")
