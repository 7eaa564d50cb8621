"""Read RDI PD0, the raw files of WorkHorse, Ocean Surveyor, Sentinel V and related ADCPs.

Damaged ensembles are dropped and counted, never repaired: a flipped byte costs one ensemble. Bottom track, navigation
and the separate blocks of a fifth beam are ignored; other than four columns raise an error. Beam velocities are mapped
to the bin depths of a level instrument before they are combined.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.readers.pd0 import checks, currents, fields
from compasslib.readers.pd0.checks import FileReport
from compasslib.readers.pd0.currents import Settings
from compasslib.readers.pd0.fields import COUNTS, Coordinates, Ensembles, GrowableArrays
from compasslib.readers.pd0.frames import Skipped, is_escaped, iter_chunks
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_GOOD, Record
from compasslib.types import Floats


@dataclass(frozen=True, eq=False)
class _ChunkCurrents:
    """Results of a chunk that are needed for the record, apart from its currents and profiles."""

    leaders: Ensembles  # without profiles
    echo_range_m: Floats  # (n, 2) see ``echo_ranges``
    echo_near: Floats  # (n,) mean echo of the two nearest bins, counts; low where scatterers are few
    three_beam: int  # number of currents solved from three beams
    has_percent_good: bool


def decode(path: str | Path) -> Ensembles:
    """Decode all intact ensembles of a file as recorded, without any rotation.

    Raises:
        InputError: the file cannot be read or holds no ensemble with velocities.
    """
    parts = [fields.decode_runs(chunk.runs) for chunk in iter_chunks(path)]
    ensembles = fields.concatenate([part for part, _ in parts])
    _refuse_empty(path, len(ensembles), sum((dropped for _, dropped in parts), Counter[str]()))
    return ensembles


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

    Args:
        orientation: up or down, overrides that of the ensembles; None uses the recorded orientation of each ensemble.
        declination_applied: declination contained in headings (and earth velocities), degrees; overrides EB.
        heading_alignment: degrees to add to the recorded heading to get that of beam 3; required if EA is not 0.
        serial_number: expected serial number, possibly with letters around its digits.
        sound_speed: auto (as None), keep or {salinity: S}, see ``currents.correct_sound_speed``.

    Raises:
        InputError: a file is unreadable, holds no ensemble or other than four beams, the serial number differs, or EA
            and ``heading_alignment`` contradict each other.
    """
    applied = parse_applied_declination(declination_applied)
    settings = Settings(orientation, applied, heading_alignment, serial_number, sound_speed)
    if not paths:
        raise InputError("files", expected="at least one PD0 file", found="none", advice="name the instrument's files")
    if orientation not in (None, "up", "down"):
        shown, advice = repr(orientation), "write orientation: up"
        raise InputError("orientation", expected="up or down", found=shown, advice=advice)

    def first_time(path: Path) -> float:
        parts = (fields.decode_runs(chunk.runs)[0] for chunk in iter_chunks(path))
        return next((float(ensembles.time_s[0]) for ensembles in parts if len(ensembles)), np.inf)

    # The files may be listed in any order.
    ordered = sorted(paths, key=first_time) if len(paths) > 1 else paths
    where = ", ".join(map(str, paths))
    arrays = GrowableArrays(where, sum(Path(path).stat().st_size for path in paths if Path(path).is_file()))
    files = [_read_file(path, settings, arrays) for path in ordered]
    return _record([part for parts, _ in files for part in parts], arrays, [report for _, report in files], settings)


def echo_ranges(ensembles: Ensembles, boundary: int = 50, heard: int = 15) -> Floats:
    """Determine vertical ranges, (n, 2) metres, of a boundary and of the last bin above noise; NaN without one.

    Echo decreases with range in water: surface and bottom exceed it by far (by 80 to 160 counts in two genuine moored
    records), a layer of animals by 10 to 20 dB at most.

    Args:
        boundary: echo of a boundary above the minimum at shorter range, counts of 0.45 dB.
        heard: echo of water above the minimum of the ensemble, which is at least the receiver noise, counts.
    """
    if not ensembles.echo.any():
        return np.full((len(ensembles), 2), np.nan)
    b1, b2, b3, b4 = np.moveaxis(ensembles.echo, 2, 0)
    echo = b1.astype(np.int16) + b2 + b3 + b4  # six times as fast as a sum over the last axis
    beyond = np.arange(echo.shape[1]) >= ensembles.cells[:, None]
    ragged = beyond.any()
    if ragged:
        echo[beyond] = np.iinfo(np.int16).max
    least = np.minimum.accumulate(echo, axis=1)
    rise, loud = echo - least, echo - least[:, -1:]
    if ragged:
        rise[beyond] = loud[beyond] = 0
    strongest = rise.argmax(axis=1)
    last = echo.shape[1] - 1 - (loud > 4 * heard)[:, ::-1].argmax(axis=1)
    known = np.column_stack([rise.max(axis=1, initial=0) > 4 * boundary, loud.any(axis=1)])
    ranges = ensembles.bin1_m[:, None] + ensembles.cell_m[:, None] * np.column_stack([strongest, last])
    return np.where(known, ranges, np.nan)


def _refuse_empty(path: str | Path, count: int, dropped: Counter[str]) -> None:
    misfits = dropped["not_of_four_beams"]
    if misfits > fields.STRAY * (misfits + count):  # more than damage explains
        expected = "blocks of four columns, as many rows as the leader tells cells"
        shown = f"others, perhaps of five beams, in {misfits} of {misfits + count} ensembles"
        raise InputError(str(path), expected=expected, found=shown, advice=checks.FOUR)
    if count:
        return
    with Path(path).open("rb") as file:
        beginning = file.read(16)
    shown = f"a file that begins with {beginning!r}" if beginning else "an empty file"
    if dropped:
        shown = f"{dropped.total()} ensembles without velocities or with impossible dates"
    advice = "check that format: pd0 and the file belong together"
    raise InputError(str(path), expected="PD0 ensembles (7F 7F) with velocities", found=shown, advice=advice)


def _read_file(path: str | Path, settings: Settings, arrays: GrowableArrays) -> tuple[list[_ChunkCurrents], FileReport]:
    """Read one file chunk by chunk, freeing the profiles of each chunk before the next one is read."""
    parts: list[_ChunkCurrents] = []
    dropped, skipped, intact_bytes, begin = Counter[str](), list[Skipped](), 0, len(arrays)
    for chunk in iter_chunks(path):
        ensembles, left_out = fields.decode_runs(chunk.runs)
        size = sum(run.rows.size for run in chunk.runs)
        dropped += left_out
        intact_bytes += size
        skipped += chunk.skipped
        if len(ensembles):
            checks.refuse_alignment(str(path), ensembles, settings.heading_alignment)
            is_earth = bool((ensembles.coordinates == Coordinates.EARTH).all())
            checks.refuse_rotation(str(path), settings.declination_applied, is_earth=is_earth)
            parts.append(_turn_chunk(ensembles, size, settings, arrays))
    leaders = fields.concatenate([part.leaders for part in parts])
    _refuse_empty(path, len(leaders), dropped)
    damaged, whole = sum(each.failed for each in skipped), len(leaders) + dropped.total()
    refuse_mostly_damaged(path, "PD0 ensembles", damaged=damaged, whole=whole)
    if not any(part.has_percent_good for part in parts):
        # An all-zero percent-good block was never filled, and says nothing about the velocities.
        flags = arrays["quality"][begin:]
        flags[flags == BAD] = GOOD
    return parts, FileReport(
        path=str(path),
        bytes_total=intact_bytes + sum(each.length for each in skipped),
        ensembles=len(leaders),
        dropped=dropped,
        three_beam=sum(part.three_beam for part in parts),
        lost=checks.count_lost_ensembles(leaders.offset, leaders.number, skipped),
        skipped=tuple(skipped),
        escaped=is_escaped(path),
    )


def _turn_chunk(ensembles: Ensembles, size: int, settings: Settings, arrays: GrowableArrays) -> _ChunkCurrents:
    flow = currents.compute_currents(ensembles, settings)
    quality = currents.flag_currents(ensembles, flow.east, flow.north)
    columns = {"east": flow.east, "north": flow.north, "quality": quality}
    columns |= {"up": flow.up.astype(np.float32), "error_velocity": flow.error.astype(np.float32)}
    arrays.add(columns | {name: getattr(ensembles, name) for name in COUNTS}, {"quality": MISSING}, size)
    near = ensembles.echo[:, :2].astype(float)
    none, no_bytes = np.empty((len(ensembles), 0, 4)), np.empty((len(ensembles), 0, 4), np.uint8)
    return _ChunkCurrents(
        leaders=replace(ensembles, velocity=none, correlation=no_bytes, echo=no_bytes, percent_good=no_bytes),
        echo_range_m=echo_ranges(ensembles),
        echo_near=np.where(near.any(axis=(1, 2)), near.mean(axis=(1, 2)), np.nan),
        three_beam=flow.three_beam,
        has_percent_good=bool(ensembles.percent_good.any()),
    )


def _record(
    parts: Sequence[_ChunkCurrents], arrays: GrowableArrays, reports: Sequence[FileReport], settings: Settings
) -> Record:
    leaders = fields.concatenate([part.leaders for part in parts])
    where = ", ".join(report.path for report in reports)
    checks.refuse_mixed(where, leaders)
    serial = checks.serial_number(where, leaders, settings.serial_number)
    flags, strays, notes = checks.flag_strays(leaders)
    sound = currents.correct_sound_speed(leaders, settings.sound_speed)
    notes += [sound.sentence] if sound.sentence else []
    velocity_flags = np.where(sound.doubtful, np.maximum(flags, PROBABLY_GOOD), flags)
    for name in ("east", "north", "up", "error_velocity"):
        velocity = arrays[name]
        velocity *= sound.factor[:, None]
    heading = currents.magnetic_heading(leaders, settings)
    known = {"velocities": int(np.isfinite(arrays["east"]).sum())}
    counts = checks.summarize_counts(reports, leaders, heading, settings) | strays | known | sound.counts
    codes = np.unique(leaders.coordinates)
    # Distances of the bins, (n, m) metres, NaN beyond the last bin of an ensemble.
    cells = int(leaders.cells.max())
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
            "echo": np.concatenate([part.echo_near for part in parts]),
        },
        channel_units={"transmit_current": "count", "heading_spread": "degree", "echo": "count"},
        profiles=_profiles(arrays, leaders),
        bins_mapped=bool(np.all(leaders.bins_mapped | (leaders.coordinates == Coordinates.BEAM))),
        recorded_in=Coordinates(codes[0]).name.lower() if len(codes) == 1 else "several",
        quality=np.maximum(arrays["quality"], velocity_flags[:, None]),
        heading_quality=np.where(np.isnan(heading), MISSING, flags).astype(np.int8),
        looks_up=checks.mostly_looks_up(leaders, settings),
        beam_angle_deg=_most_frequent(leaders.beam_angle_deg),
        direction_reference="magnetic",
        heading_bias_deg=_most_frequent(currents.heading_bias(leaders, settings)),
        velocity_bias_deg=_most_frequent(currents.velocity_bias(leaders, settings)),
        serial_number=serial,
        echo_range_m=np.concatenate([part.echo_range_m for part in parts]) * sound.range_factor,
        counts=counts,
        sound_speed=sound.sentence,
        warnings=(*checks.describe_reading(reports, leaders, counts, settings), *notes),
    )


def _profiles(arrays: GrowableArrays, leaders: Ensembles) -> dict[str, NDArray[Any]]:
    """Collect the profiles recorded with the velocities, without all-zero ones; -1 where an ensemble lacks counts."""
    profiles = {name: arrays[name] for name in ("up", "error_velocity")}
    beyond = np.arange(arrays["east"].shape[1]) >= leaders.cells[:, None]
    for name, (_, bit) in COUNTS.items():
        counts, absent = arrays[name], (leaders.blocks & bit) == 0
        if not counts.any():  # the block was never filled
            continue
        lacking = beyond | absent[:, None]
        profiles[name] = np.where(lacking[..., None], np.int16(-1), counts) if lacking.any() else counts
    return profiles


def _most_frequent(values: Floats) -> float:
    distinct, times = np.unique(values, return_counts=True)
    return float(distinct[np.argmax(times)])
