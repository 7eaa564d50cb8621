"""RDI PD0: the raw files of WorkHorse, Ocean Surveyor, Sentinel V and their relatives.

Damage is left out and counted, never guessed: a flipped byte costs one ensemble. Bottom track, navigation and a
fifth beam in blocks of its own are passed over; other columns than four are refused. Beams are combined bin by bin;
under tilt their bins lie at slightly different depths, which is not mapped.

A boundary shows in the echo: from one bin to the next the echo of water falls, and surface and bottom stand far above
it (in two genuine moored records by 80 to 160 counts). A layer of animals rises by 10 to 20 dB at most.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.declination import applied
from compasslib.errors import InputError
from compasslib.readers.files import refuse_mostly_damaged
from compasslib.readers.pd0 import checks
from compasslib.readers.pd0.checks import (
    FileReport,
    count_lost_ensembles,
    describe_reading,
    mostly_looks_up,
    summarize_counts,
)
from compasslib.readers.pd0.currents import (
    Settings,
    compute_currents,
    contradicted_coordinates,
    heading_bias,
    magnetic_heading,
    quality,
    true_pitch,
    velocity_bias,
)
from compasslib.readers.pd0.fields import COUNTS, DroppedCounts, Ensembles, GrowableArrays, decode_runs, joined
from compasslib.readers.pd0.frames import CHUNK_BYTES, Skipped, is_escaped, iter_chunks
from compasslib.records import BAD, GOOD, MISSING, Record
from compasslib.types import Floats

BOUNDARY_COUNTS = 50  # above the least echo before it; 0.45 dB a count
HEARD_COUNTS = 15  # above the least echo of the ensemble, which is the noise of the receiver or more
BEAMS = 4
NEAR_CELLS = 2


@dataclass(frozen=True, eq=False)
class _DecodedChunk:
    """A decoded chunk of a file."""

    ensembles: Ensembles
    left_out: DroppedCounts
    size: int  # bytes in ensembles, good ones
    skipped: tuple[Skipped, ...]


@dataclass(frozen=True, eq=False)
class _Water:
    """The part of a piece that the record keeps."""

    leaders: Ensembles  # without their profiles
    echo_range_m: Floats
    echo_near: Floats  # (n,) counts
    three_beam: int
    has_percent_good: bool
    contradicted_coordinates: tuple[int, int]  # cells that contradict EX, and those that could


def decode(path: str | Path, chunk_bytes: int = CHUNK_BYTES) -> Ensembles:
    """Return all good ensembles of a file as the instrument recorded them.

    Args:
        chunk_bytes: bytes read at a time; the result does not depend on it.

    Raises:
        InputError: the file cannot be read or holds no ensemble with velocities.
    """
    pieces = list(_pieces(path, chunk_bytes))
    _refuse_empty(path, pieces)
    return joined([piece.ensembles for piece in pieces])


def read(
    paths: Sequence[Path],
    *,
    orientation: str | None,
    declination_applied: float | Mapping[str, float] | None,
    heading_alignment: float | None,
    serial_number: str | None = None,
) -> Record:
    """Return one record from files in order of their first times, currents turned by the recorded magnetic heading.

    Args:
        paths: files of one instrument, by its own clock.
        orientation: up or down; counts where ensembles disagree. Each ensemble's own bit where None.
        declination_applied: degrees inside the recorded headings (and earth velocities), instead of the file's EB.
        heading_alignment: degrees added to the recorded heading to get that of beam 3; needed where EA is not 0.
        serial_number: the instrument's by the metadata, perhaps with letters around its digits.

    Raises:
        InputError: a file that cannot be read, holds no ensemble or other than four beams, a serial number of another
            instrument, or EA and ``heading_alignment`` that do not go together.
    """
    choices = Settings(orientation, applied(declination_applied), heading_alignment, serial_number)
    return read_with_reports(paths, choices)[0]


def read_with_reports(paths: Sequence[Path], choices: Settings) -> tuple[Record, tuple[FileReport, ...]]:
    """Return the record as ``read`` does, and of every file what was skipped, range by range.

    Raises:
        InputError: as for ``read``.
    """
    if not paths:
        raise InputError("files", expected="at least one PD0 file", found="none", advice="name the instrument's files")
    if choices.orientation not in (None, "up", "down"):
        found = repr(choices.orientation)
        raise InputError("orientation", expected="up or down", found=found, advice="write orientation: up")
    # Downloads may be listed in any order.
    ordered = sorted(paths, key=_first_time) if len(paths) > 1 else paths
    where = ", ".join(map(str, paths))
    grown = GrowableArrays(where, sum(Path(path).stat().st_size for path in paths if Path(path).is_file()))
    files = [_file(path, choices, grown) for path in ordered]
    reports = tuple(report for _, report in files)
    return _record([part for of_file, _ in files for part in of_file], grown, reports, choices), reports


def echo_ranges(ensembles: Ensembles) -> Floats:
    """Return vertical ranges, (n, 2) metres, NaN where there is none: of a boundary, and of the last bin heard."""
    if not ensembles.echo.any():
        return np.full((len(ensembles), 2), np.nan)
    one, two, three, four = np.moveaxis(ensembles.echo, 2, 0)
    echo = one.astype(np.int16) + two + three + four  # six times as fast as a sum over the last axis
    beyond = np.arange(echo.shape[1]) >= ensembles.cells[:, None]
    ragged = beyond.any()
    if ragged:
        echo[beyond] = np.iinfo(np.int16).max
    least = np.minimum.accumulate(echo, axis=1)
    rise, loud = echo - least, echo - least[:, -1:]
    if ragged:
        rise[beyond] = loud[beyond] = 0
    strongest = rise.argmax(axis=1)
    last = echo.shape[1] - 1 - (loud > BEAMS * HEARD_COUNTS)[:, ::-1].argmax(axis=1)
    seen = np.column_stack([rise.max(axis=1, initial=0) > BEAMS * BOUNDARY_COUNTS, loud.any(axis=1)])
    ranges = ensembles.bin1_m[:, None] + ensembles.cell_m[:, None] * np.column_stack([strongest, last])
    return np.where(seen, ranges, np.nan)


def _pieces(path: str | Path, chunk_bytes: int = CHUNK_BYTES) -> Iterator[_DecodedChunk]:
    for chunk in iter_chunks(path, chunk_bytes):
        ensembles, left_out = decode_runs(chunk.runs)
        size = sum(run.rows.size for run in chunk.runs)
        yield _DecodedChunk(ensembles, left_out, size, chunk.skipped)


def _refuse_empty(path: str | Path, pieces: Sequence[_DecodedChunk]) -> None:
    left_out = sum((piece.left_out for piece in pieces), DroppedCounts())
    kept = sum(len(piece.ensembles) for piece in pieces)
    checks.refuse_columns(str(path), left_out.not_of_four_beams, kept)
    if kept:
        return
    with Path(path).open("rb") as file:
        beginning = file.read(16)
    found = f"a file that begins with {beginning!r}" if beginning else "an empty file"
    if int(left_out):
        found = f"{int(left_out)} ensembles without velocities or with impossible dates"
    advice = "check that format: pd0 and the file belong together"
    raise InputError(str(path), expected="PD0 ensembles (7F 7F) with velocities", found=found, advice=advice)


def _first_time(path: str | Path) -> float:
    pieces = (piece.ensembles for piece in _pieces(path))
    return next((float(ensembles.time_s[0]) for ensembles in pieces if len(ensembles)), np.inf)


def _file(path: str | Path, choices: Settings, grown: GrowableArrays) -> tuple[list[_Water], FileReport]:
    """Read one file piece by piece, so that the ensembles of a piece are gone before the next is there."""
    bare: list[_DecodedChunk] = []
    water: list[_Water] = []
    begin = len(grown)
    for piece in _pieces(path):
        bare.append(replace(piece, ensembles=_leaders(piece.ensembles)))
        if len(piece.ensembles):
            checks.refuse_alignment(str(path), piece.ensembles, choices.heading_alignment)
            checks.refuse_rotation(str(path), piece.ensembles, choices.declination_applied)
            water.append(_turned(piece.ensembles, piece.size, choices, grown))
    _refuse_empty(path, bare)
    kept = sum(len(piece.ensembles) + int(piece.left_out) for piece in bare)
    failed = sum(each.failed for piece in bare for each in piece.skipped)
    refuse_mostly_damaged(path, "PD0 ensembles", damaged=failed, whole=kept)
    cells = np.sum([part.contradicted_coordinates for part in water], axis=0)
    checks.refuse_coordinates(str(path), joined([part.leaders for part in water]), *cells.tolist())
    if not any(part.has_percent_good for part in water):
        # Nobody has filled the block: it says nothing about the velocities.
        flags = grown["quality"][begin:]
        flags[flags == BAD] = GOOD
    return water, _report(path, bare, sum(part.three_beam for part in water))


def _leaders(ensembles: Ensembles) -> Ensembles:
    none, no_bytes = np.empty((len(ensembles), 0, 4)), np.empty((len(ensembles), 0, 4), np.uint8)
    return replace(ensembles, velocity=none, correlation=no_bytes, echo=no_bytes, percent_good=no_bytes)


def _turned(ensembles: Ensembles, size: int, choices: Settings, grown: GrowableArrays) -> _Water:
    flow = compute_currents(ensembles, choices)
    columns = {"east": flow.east, "north": flow.north, "quality": quality(ensembles, flow.east, flow.north)}
    columns |= {"up": flow.up.astype(np.float32), "error_velocity": flow.error.astype(np.float32)}
    grown.add(columns | {name: getattr(ensembles, name) for name in COUNTS}, {"quality": MISSING}, size)
    return _Water(
        leaders=_leaders(ensembles),
        echo_range_m=echo_ranges(ensembles),
        echo_near=_echo_near(ensembles),
        three_beam=flow.three_beam,
        has_percent_good=bool(ensembles.percent_good.any()),
        contradicted_coordinates=contradicted_coordinates(ensembles),
    )


def _echo_near(ensembles: Ensembles) -> Floats:
    """Return the mean echo of the nearest cells, (n,) counts: where it is low, few scatterers are heard."""
    near = ensembles.echo[:, :NEAR_CELLS].astype(float)
    return np.where(near.any(axis=(1, 2)), near.mean(axis=(1, 2)), np.nan)


def _report(path: str | Path, pieces: Sequence[_DecodedChunk], three_beam: int) -> FileReport:
    skipped = tuple(each for piece in pieces for each in piece.skipped)
    offset = np.concatenate([piece.ensembles.offset for piece in pieces])
    number = np.concatenate([piece.ensembles.number for piece in pieces])
    return FileReport(
        path=str(path),
        bytes_total=sum(piece.size for piece in pieces) + sum(each.length for each in skipped),
        ensembles=len(offset),
        left_out=sum((piece.left_out for piece in pieces), DroppedCounts()),
        three_beam=three_beam,
        lost=count_lost_ensembles(offset, number, skipped),
        skipped=skipped,
        escaped=is_escaped(path),
    )


def _record(water: Sequence[_Water], grown: GrowableArrays, reports: Sequence[FileReport], choices: Settings) -> Record:
    leaders = joined([part.leaders for part in water])
    where = ", ".join(report.path for report in reports)
    checks.refuse(where, leaders)
    serial = checks.serial_number(where, leaders, choices.serial_number)
    flags, stray, notes = checks.stray(leaders)
    heading = magnetic_heading(leaders, choices)
    known = {"velocities": int(np.isfinite(grown["east"]).sum())}
    counts = summarize_counts(reports, leaders, heading, choices) | stray | known
    return Record(
        time_s=leaders.time_s,
        east=grown["east"],
        north=grown["north"],
        bin_range_m=_bin_range(leaders, int(leaders.cells.max())),
        heading_deg=heading,
        pitch_deg=true_pitch(leaders.tilt1_deg, leaders.tilt2_deg),
        roll_deg=leaders.tilt2_deg,
        pressure_dbar=leaders.pressure_dbar,
        depth_m=leaders.depth_m,
        temperature_c=leaders.temperature_c,
        supply_voltage=leaders.supply_voltage,
        channels={
            "transmit_current": leaders.transmit_current,
            "heading_spread": leaders.heading_spread_deg,
            "echo": np.concatenate([part.echo_near for part in water]),
        },
        channel_units={"transmit_current": "count", "heading_spread": "degree", "echo": "count"},
        profiles=_profiles(grown, leaders),
        recorded_in=_in_words(leaders),
        quality=np.maximum(grown["quality"], flags[:, None]),
        heading_quality=np.where(np.isnan(heading), MISSING, flags).astype(np.int8),
        looks_up=mostly_looks_up(leaders, choices),
        beam_angle_deg=_most_frequent(leaders.beam_angle_deg),
        direction_reference="magnetic",
        heading_bias_deg=_most_frequent(heading_bias(leaders, choices)),
        velocity_bias_deg=_most_frequent(velocity_bias(leaders, choices)),
        serial_number=serial,
        echo_range_m=np.concatenate([part.echo_range_m for part in water]),
        counts=counts,
        warnings=(*describe_reading(reports, leaders, counts, choices), *notes),
    )


def _profiles(grown: GrowableArrays, leaders: Ensembles) -> dict[str, NDArray[Any]]:
    """Return what the velocities came with where there is any of it; counts that some ensembles lack become -1."""
    found = {name: grown[name] for name in ("up", "error_velocity")}
    beyond = np.arange(grown["east"].shape[1]) >= leaders.cells[:, None]
    for name, (_, bit) in COUNTS.items():
        counts, absent = grown[name], (leaders.blocks & bit) == 0
        if not counts.any():  # nobody has filled the block
            continue
        lacking = beyond | absent[:, None]
        found[name] = np.where(lacking[..., None], np.int16(-1), counts) if lacking.any() else counts
    return found


def _in_words(leaders: Ensembles) -> str:
    codes = np.unique(leaders.coordinates)
    return checks.COORDINATES[int(codes[0])] if len(codes) == 1 else "several"


def _bin_range(leaders: Ensembles, cells: int) -> Floats:
    cell = np.arange(cells)
    if all(np.ptp(of) == 0.0 for of in (leaders.bin1_m, leaders.cell_m, leaders.cells)):
        # One setting throughout: one row that all ensembles share.
        one = leaders.bin1_m[:1, None] + leaders.cell_m[:1, None] * cell
        one[:, cell >= leaders.cells[0]] = np.nan
        return np.broadcast_to(one, (len(leaders), cells))
    ranges = leaders.bin1_m[:, None] + leaders.cell_m[:, None] * cell
    ranges[cell >= leaders.cells[:, None]] = np.nan
    return ranges


def _most_frequent(values: Floats) -> float:
    distinct, times = np.unique(values, return_counts=True)
    return float(distinct[np.argmax(times)])
