"""Read RDI PD0, the raw files of WorkHorse, Ocean Surveyor, Sentinel V and related ADCPs.

Damaged ensembles are dropped and counted, never repaired: a flipped byte costs one ensemble. Bottom track, navigation
and the separate blocks of a fifth beam are ignored; other than four columns raise an error. Beam velocities are mapped
to the bin depths of a level instrument before they are combined.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.pd0 import checks, currents, fields
from compasslib.readers.pd0.currents import Settings
from compasslib.readers.pd0.fields import COUNTS, DROPPED, Coordinates, Ensembles
from compasslib.readers.pd0.frames import batches, find_ensembles
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_GOOD, Record
from compasslib.types import Floats

Columns = dict[str, NDArray[Any]]  # by name, (n, m, ...) each


@dataclass(frozen=True, eq=False)
class _File:
    """Content of one file, in batches."""

    leaders: list[Ensembles]  # without profiles
    columns: list[Columns]  # profiles of the record
    echo: list[Floats]  # (n,) mean of the two nearest bins, low where water is clear
    counts: dict[str, int]
    warnings: tuple[str, ...]


def decode(path: str | Path) -> Ensembles:
    """Decode all intact ensembles of a file as recorded, without any rotation.

    Raises:
        InputError: the file cannot be read or holds no ensemble with velocities.
    """
    runs, _, _ = find_ensembles(path)
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
    # The files may be listed in any order.
    content = sorted((_read_file(path, settings) for path in paths), key=lambda file: float(file.leaders[0].time_s[0]))
    return _record(", ".join(map(str, paths)), content, settings)


def _refuse_empty(path: str | Path, count: int, dropped: Counter[str]) -> None:
    misfits = dropped["not_of_four_beams"]
    if misfits > fields.STRAY * (misfits + count):  # more than damage explains
        expected = "blocks of four columns, as many rows as the leader tells cells"
        shown = f"others, perhaps of five beams, in {misfits} of {misfits + count} ensembles"
        raise InputError(str(path), expected=expected, found=shown, advice=checks.FOUR)
    if count:
        return
    beginning = files.read_bytes(path)[:16]
    shown = f"a file that begins with {beginning!r}" if beginning else "an empty file"
    if dropped:
        shown = f"{dropped.total()} ensembles without velocities or with impossible dates"
    advice = "check that format: pd0 and the file belong together"
    raise InputError(str(path), expected="PD0 ensembles (7F 7F) with velocities", found=shown, advice=advice)


def _read_file(path: Path, settings: Settings) -> _File:
    """Read one file in batches, of which only the profiles that a record has are kept."""
    runs, skipped, escaped = find_ensembles(path)
    size, widest, dropped = Path(path).stat().st_size, 0, Counter[str]()
    content = _File([], [], [], {"three_beam": 0, "ensembles": 0}, ())
    counts = content.counts
    for batch in batches(runs):
        ensembles, left_out = fields.decode_runs(batch)
        dropped += left_out
        if ensembles is None:
            continue
        aligned = ensembles.heading_alignment_deg
        checks.refuse_alignment(f"{path}: heading alignment EA", aligned, settings.heading_alignment)
        is_earth = bool((ensembles.coordinates == Coordinates.EARTH).all())
        checks.refuse_rotation(str(path), settings.declination_applied, is_earth=is_earth)
        east, north, up, error, three_beam = currents.compute_currents(ensembles, settings)
        columns = {"east": east, "north": north, "quality": currents.flag_currents(ensembles, east, north)}
        columns |= {"up": up.astype(np.float32), "error_velocity": error.astype(np.float32)}
        columns |= {name: getattr(ensembles, name) for name in COUNTS}
        near = ensembles.echo[:, :2].astype(float)
        near = np.where(near.any(axis=(1, 2)), near.mean(axis=(1, 2)), np.nan)
        none, no_bytes = np.empty((len(ensembles), 0, 4)), np.empty((len(ensembles), 0, 4), np.uint8)
        content.leaders.append(
            replace(ensembles, velocity=none, correlation=no_bytes, echo=no_bytes, percent_good=no_bytes)
        )
        content.columns.append(columns)
        content.echo.append(near)
        counts["three_beam"] += three_beam
        counts["ensembles"] += len(ensembles)
        widest = max(widest, east.shape[1])
        _refuse_padding(str(path), columns, counts["ensembles"], widest, size)
    _refuse_empty(path, counts["ensembles"], dropped)
    failed, whole = sum(each.failed for each in skipped), counts["ensembles"] + dropped.total()
    files.refuse_mostly_damaged(path, "PD0 ensembles", damaged=failed, whole=whole)
    if not any(columns["percent_good"].any() for columns in content.columns):
        # An all-zero percent-good block was never filled, and says nothing about the velocities.
        for columns in content.columns:
            columns["quality"][columns["quality"] == BAD] = GOOD
    counts |= {reason: dropped[reason] for reason in DROPPED}
    counts["damaged"] = sum(each.damaged for each in skipped)
    counts["bytes_skipped"] = sum(each.length for each in skipped)
    counts["bytes_total"] = counts["bytes_skipped"] + sum(run.rows.size for run in runs)
    # Count the ensembles lost where bytes were skipped, from the numbers of the intact ensembles around them.
    offset, number = (np.concatenate([getattr(x, name) for x in content.leaders]) for name in ("offset", "number"))
    after = np.searchsorted(offset, [each.offset for each in skipped])
    inside = after[(after > 0) & (after < len(offset))]
    gaps = number[inside] - number[inside - 1] - 1
    # Decreasing numbers mark the start of a new recording, where the loss is unknown.
    counts["lost"] = int(gaps[gaps > 0].sum())
    return replace(content, warnings=tuple(checks.describe_file(Path(path).name, counts, skipped, escaped=escaped)))


def _refuse_padding(where: str, columns: Columns, count: int, cells: int, size: int) -> None:
    """Reject profiles whose arrays, padded to the widest, would take far more memory than the size of the files."""
    each = sum(part.dtype.itemsize * prod(part.shape[2:]) for part in columns.values())
    files.refuse_large_arrays(where, count * cells * each, size, cells)


def _record(where: str, content: Sequence[_File], settings: Settings) -> Record:
    leaders = fields.concatenate([part for file in content for part in file.leaders])
    counts = {key: sum(file.counts[key] for file in content) for key in content[0].counts}
    checks.refuse_mixed(where, leaders)
    written = str(next(iter(checks.frequent_numbers(leaders.serial)), ""))
    serial = checks.match_serial_number(where, written, settings.serial_number)
    batched = [columns for file in content for columns in file.columns]
    cells = int(leaders.cells.max())
    _refuse_padding(where, batched[0], len(leaders), cells, counts["bytes_total"])
    # The pieces of each column are freed before the next one is stacked.
    arrays = {
        name: fields.stack_padded([columns.pop(name) for columns in batched], MISSING if name == "quality" else 0)
        for name in [*batched[0]]
    }
    flags, strays, notes = checks.flag_strays(leaders)
    sound = currents.correct_sound_speed(leaders, settings.sound_speed)
    notes += [sound.sentence] if sound.sentence else []
    velocity_flags = np.where(sound.doubtful, np.maximum(flags, PROBABLY_GOOD), flags)
    for name in ("east", "north", "up", "error_velocity"):
        arrays[name] *= sound.factor[:, None]
    heading = currents.magnetic_heading(leaders, settings)
    looks_up = checks.mostly_looks_up(leaders, settings)
    counts |= strays | {
        "velocities": int(np.isfinite(arrays["east"]).sum()),
        "orientation_disagrees": int(np.sum(leaders.looks_up != looks_up)),
        "heading_missing": int(np.isnan(heading).sum()),
        "configurations": checks.count_configurations(leaders),
        "sound_speed_corrected": int(np.sum(sound.factor != 1.0)),
        "sound_speed_doubtful": int(sound.doubtful.sum()),
    }
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
            "echo": np.concatenate([part for file in content for part in file.echo]),
        },
        channel_units={"transmit_current": "count", "heading_spread": "degree", "echo": "count"},
        profiles=_profiles(arrays, leaders),
        bins_mapped=bool(np.all(leaders.bins_mapped | (leaders.coordinates == Coordinates.BEAM))),
        recorded_in=Coordinates(codes[0]).name.lower() if len(codes) == 1 else "several",
        quality=np.maximum(arrays["quality"], velocity_flags[:, None]),
        heading_quality=np.where(np.isnan(heading), MISSING, flags).astype(np.int8),
        looks_up=looks_up,
        beam_angle_deg=_most_frequent(leaders.beam_angle_deg),
        direction_reference="magnetic",
        heading_bias_deg=_most_frequent(currents.heading_bias(leaders, settings)),
        velocity_bias_deg=_most_frequent(currents.velocity_bias(leaders, settings)),
        serial_number=serial,
        counts=counts,
        sound_speed=sound.sentence,
        warnings=(
            *(line for file in content for line in file.warnings),
            *checks.describe_headings(leaders, settings),
            *checks.describe_configuration(leaders, counts, settings),
            *notes,
        ),
    )


def _profiles(arrays: Columns, leaders: Ensembles) -> dict[str, NDArray[Any]]:
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
