"""Read Nortek current meters and profilers: Aquadopp, Aquadopp profiler, AWAC (aqd, prf, wpr) and Signature (ad2cp).

The text files to which Nortek's programs convert older recordings are read by their header file (.hdr), which states
the configuration and the columns of the others. Damaged records are dropped and counted, never repaired: a flipped byte
costs one sample. Velocities in beam or head coordinates are rotated to the earth's by recorded heading, pitch and roll:
x points along the heading, y to port and z up on an up-looker, y and z the opposite way on a down-looker. Sources:
Nortek, transformation of coordinates (Xform.m); Comprehensive Manual (2018), data conversion.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.earthfield import AppliedDeclination, parse_applied_declination
from compasslib.errors import InputError
from compasslib.readers import files
from compasslib.readers.delimited import Layout, read_head, read_table
from compasslib.readers.files import MISSING_COUNT, block_type, list_some, read_text
from compasslib.readers.nortek import signature
from compasslib.readers.nortek.packets import (
    SLANT_DEG,
    Coordinates,
    Packets,
    Samples,
    by_beam,
    find_packets,
)
from compasslib.readers.pd0 import match_serial_number, refuse_rotation
from compasslib.readers.pd0.currents import map_cells
from compasslib.readers.pd0.fields import STRAY
from compasslib.readers.times import FIRST_YEAR, Ints, civil_seconds, describe_averages
from compasslib.records import BAD, GOOD, MAGNETOMETER, MISSING, Record, join_records, new_record, take
from compasslib.types import Floats

USER, HEAD, HARDWARE, DIAGNOSTIC = 0x00, 0x04, 0x05, 0x80  # identifiers of the older records without velocities
VELOCITY = {0x01: 30, 0x81: 40, 0x21: 30, 0x20: 118, 0x24: 118}  # identifier: byte offset of the velocities
POINT = (0x01, 0x81)
AQUADOPP_MAGNETOMETER = {0x81: 34}
OTHERS = {0x11: "a Vector", 0x12: "a Vector", 0x2A: "an Aquadopp in its high-resolution mode"}
BEAMS = 3
CELL_M = {2000: 0.0239, 1000: 0.0478, 600: 0.0797, 400: 0.1195}  # kHz: bin size of 256 counts, along a beam
BLANKING_M = {2000: 0.02228, 1000: 0.02266, 600: 0.02281, 400: 0.02289}  # kHz: blanking of one count, along a beam
HEADER = ".hdr"
CONVERTED = Layout(header=0, delimiter=" ")
CLOCK = ("year", "month", "day", "hour", "minute", "second")
SENSORS = ("heading", "pitch", "roll", "pressure", "temperature", "battery voltage", "error code", "status code")
SYSTEMS = {"ENU": Coordinates.EARTH, "XYZ": Coordinates.INSTRUMENT, "BEAM": Coordinates.BEAM}
_SECTION = re.compile(r"^\[(?:.*[\\/])?[^\]\\/]*\.(\w+)\]\s*$", re.MULTILINE)
_COLUMN = re.compile(r"^ *(\d+) +(\S.*?)(?:  .*|\t.*| *\([^)]*\) *)?$", re.MULTILINE)
_BCD = np.array([10 * (k >> 4) + (k & 15) if max(k >> 4, k & 15) < 10 else -1 for k in range(256)])  # -1: not BCD
_SENSORS = block_type(
    clock=(4, "6u1"), error=(10, "<u2"), battery=(14, "<u2"), heading=(18, "<u2"), pitch=(20, "<i2"), roll=(22, "<i2"),
    pressure_high=(24, "u1"), status=(25, "u1"), pressure_low=(26, "<u2"), temperature=(28, "<i2"),
)  # fmt: skip
_USER = block_type(
    blanking=(6, "<u2"), average_s=(16, "<u2"), beams=(18, "<u2"), coordinates=(32, "<u2"), cells=(34, "<u2"),
    cell=(36, "<u2"),
)  # fmt: skip
_HEAD = block_type(sensors=(4, "u1"), khz=(6, "<u2"), matrix=(30, "(3,3)<i2"))


def decode_older(packets: Packets) -> Samples:
    """Decode the samples of a file of the older format.

    Raises:
        InputError: the file lacks a configuration or velocities, has two configurations, or is of another instrument.
    """
    user, head = _configuration(packets, USER, _USER), _configuration(packets, HEAD, _HEAD)
    kinds = [kind for kind in VELOCITY if (packets.kind == kind).any()]
    if len(kinds) != 1:
        meant = next((name for kind, name in OTHERS.items() if (packets.kind == kind).any()), None)
        shown = f"those of {meant}" if meant else "several kinds" if kinds else "none"
        advice = "give its velocities as a table" if meant else "give each recording as a file of its own"
        expected = "velocities of an Aquadopp, an Aquadopp profiler or an AWAC"
        raise InputError(str(packets.path), expected=expected, found=shown, advice=advice)
    kind = kinds[0]
    of_kind, point = packets.kind == kind, kind in POINT
    # A record of another length belongs to another configuration, or has a valid checksum by chance.
    length = packets.end - packets.start
    usual = int(np.bincount(length[of_kind]).argmax())
    mine = of_kind & (length == usual)
    rows, first, cells = packets.rows(mine), VELOCITY[kind], 1 if point else int(user["cells"])
    if usual < first + BEAMS * cells * 3 + 2 or not cells:
        beams = int(user["beams"])
        level = ", which are level, as of an AWAC that looks sideways" if beams == 2 else ""
        shown, expected = f"{beams} beam{'s' * (beams > 1)}{level}", f"{BEAMS} slanted beams"
        advice = "export its velocities with Nortek's program and write format: table"
        if beams == BEAMS or usual not in (whole := first + beams * cells * 3 + 2, whole + whole % 2):
            shown, expected = f"{usual} bytes for {cells} cells", "records that hold their cells"
            advice = "the configuration is of another recording: give each as a file of its own"
        raise InputError(str(packets.path), expected=expected, found=shown, advice=advice)
    sensors = np.ascontiguousarray(rows[:, : _SENSORS.itemsize]).view(_SENSORS)[:, 0]
    counts = np.ascontiguousarray(rows[:, first : first + 6 * cells]).view("<i2").reshape(len(rows), BEAMS, -1)
    # Division, unlike multiplication by 0.001, gives the float nearest to 0.123 for 123 mm/s.
    velocity = counts / np.where(sensors["status"] & 2, 10000.0, 1000.0)[:, None, None]
    velocity[counts == MISSING_COUNT] = np.nan
    velocity = np.moveaxis(velocity, 1, 2)
    minute, second, day, hour, year, month = _BCD[sensors["clock"]].astype(np.int64).T
    century = np.where(year < FIRST_YEAR - 1900, 2000, 1900)
    heading = sensors["heading"] / 10.0
    pressure = (65536 * sensors["pressure_high"].astype(np.int64) + sensors["pressure_low"]) / 1000.0
    ranges, khz = [0.0], int(head["khz"])
    if not point:
        if khz not in CELL_M:
            expected, advice = f"a head of {', '.join(map(str, CELL_M))} kHz", "give its velocities as a table"
            raise InputError(str(packets.path), expected=expected, found=f"{khz} kHz", advice=advice)
        cosine = float(angles.sin_cos(SLANT_DEG)[1])
        cell = round(int(user["cell"]) / 256 * CELL_M[khz] * cosine, 2)
        blanking = round(int(user["blanking"]) * BLANKING_M[khz] * cosine - cell, 2)
        ranges = (blanking + cell * (1.0 + np.arange(cells))).tolist()
    recorded, magnetometer = int(user["coordinates"]), AQUADOPP_MAGNETOMETER.get(kind)
    at = np.flatnonzero(packets.kind == HARDWARE)
    hardware = packets.data[packets.begin[at[0]] : packets.end[at[0]]] if len(at) else np.zeros(0, np.uint8)
    matrix = head["matrix"] / 4096.0
    return Samples(
        offset=packets.start[mine],
        time_s=civil_seconds(century + year, month, day, hour, minute, second),
        heading_deg=np.where(heading < 360.0, heading, np.nan),
        pitch_deg=sensors["pitch"] / 10.0,
        roll_deg=sensors["roll"] / 10.0,
        pressure_dbar=pressure if head["sensors"] & 1 else np.full(len(rows), np.nan),
        temperature_c=sensors["temperature"] / 100.0,
        supply_voltage=sensors["battery"] / 10.0,
        **_interpret_codes(velocity, recorded, sensors["error"], sensors["status"]),
        bin_range_m=ranges,
        recorded=recorded,
        beam_angle_deg=0.0 if point else SLANT_DEG,
        serial=hardware[4:12].tobytes().decode("ascii", "replace").strip(" \0") if hardware.size >= 18 else "",
        beams_to_axes=matrix.tolist() if recorded == Coordinates.BEAM else None,
        average_s=float(user["average_s"]),
        magnetometer=rows[:, magnetometer : magnetometer + 6].copy().view("<i2") * 1.0 if magnetometer else None,
        profiles={"echo": by_beam(rows, first + 2 * BEAMS * cells, BEAMS, cells)},
        counts={
            "diagnostic_samples": int(np.sum(packets.kind == DIAGNOSTIC)),
            "other_lengths": int(of_kind.sum()) - len(rows),
        },
    )


def _interpret_codes(velocity: Floats, recorded: int, error: Ints, status: Ints) -> dict[str, Any]:
    """Select the horizontal and upward velocities, and derive flags and orientation from the instrument's codes.

    It reports failed measurements and compasses, and tilts beyond the range of the sensor.
    """
    in_earth, beyond = recorded == Coordinates.EARTH, (status & 12) > 0
    flags = np.where(((error & 7) > 0) | beyond, BAD, GOOD)[:, None]
    return {
        "velocity": velocity[..., :2] if in_earth else velocity,
        "up": velocity[..., 2] if in_earth else None,
        "quality": np.where(np.isnan(velocity).any(axis=-1), MISSING, flags).astype(np.int8),
        "heading_quality": np.where(((error & 1) > 0) | beyond, BAD, GOOD).astype(np.int8),
        "looks_up": (status & 1) == 0,
    }


def _configuration(packets: Packets, kind: int, form: np.dtype[np.void]) -> Any:
    """Get the only configuration of a kind; identical copies are accepted, as in concatenated recordings."""
    mine = packets.kind == kind
    expected = f"the configuration A5 {kind:02X}, which tells what the velocities are"
    if not mine.any():
        advice = "take the instrument's own file from its first byte on"
        raise InputError(str(packets.path), expected=expected, found="none that is whole", advice=advice)
    sizes = packets.end[mine] - packets.begin[mine]
    rows = packets.rows(mine) if (sizes == sizes[0]).all() else None
    if rows is None or (rows != rows[0]).any():
        advice = "give each recording as a file of its own"
        raise InputError(str(packets.path), expected=expected, found=f"{len(sizes)} that differ", advice=advice)
    return np.frombuffer(rows[0].tobytes().ljust(form.itemsize, b"\0"), form, 1)[0]


def header_of(path: Path) -> Path | None:
    """Find the header file that belongs to a text file, or is it; None without one, or for a recording (A5)."""
    candidates = (path, *(path.with_suffix(suffix) for suffix in (HEADER, HEADER.upper())))
    match = next((each for each in candidates if each.suffix.lower() == HEADER and each.is_file()), None)
    if match is None or not path.is_file():
        return match
    with path.open("rb") as stream:
        return None if stream.read(1) == b"\xa5" else match


def decode_converted(header: Path) -> Samples:
    """Decode the samples of a conversion by its header file.

    Raises:
        InputError: a file is absent or damaged, or the header does not state what its columns are.
    """
    text = read_text(header)[0].decode()
    pieces = _SECTION.split(text)
    columns = {
        suffix.lower(): {name.lower(): int(k) for k, name in reversed(_COLUMN.findall(body))}  # dbar stands before m
        for suffix, body in zip(pieces[1::2], pieces[2::2], strict=True)
    }
    source = next((suffix for suffix in ("sen", "dat") if {*CLOCK, "heading"} <= columns.get(suffix, {}).keys()), None)
    system = SYSTEMS.get(_stated(text, "Coordinate system"))
    if source is None or system is None:
        expected = "a conversion of an Aquadopp or AWAC: a coordinate system, and columns of the time and heading"
        advice = "give the file that the instrument recorded"
        raise InputError(
            str(header), expected=expected, found=", ".join(columns) or "no list of columns", advice=advice
        )
    names = columns[source]
    wanted = {name: names[name] for name in SENSORS if name in names}
    velocities = sorted(k for name, k in names.items() if name.startswith("velocity"))
    wanted |= {f"velocity {beam}": k for beam, k in enumerate(velocities)}
    table = read_table(_sibling(header, source), {"time": [names[part] for part in CLOCK], **wanted}, layout=CONVERTED)
    values = {name: table.columns.get(name, np.full(table.rows, np.nan)) for name in SENSORS}
    ranges = [0.0]
    if velocities:
        velocity = np.stack([table.columns[f"velocity {beam}"] for beam in range(3)], axis=-1)[:, None]
    else:
        cells = int(_number(header, text, "Number of cells"))
        beams = []  # (n, cells) each, behind any counters of bursts
        for beam in (1, 2, 3):
            path = _sibling(header, f"v{beam}")
            width = len(read_head(path, [1], CONVERTED).names)
            places = {str(k): width - cells + k for k in range(1, cells + 1)}
            profile = read_table(path, places, layout=CONVERTED)
            if profile.rows != table.rows:
                expected, advice = f"{table.rows} rows, as the sensors have", "convert the recording again"
                raise InputError(str(path), expected=expected, found=f"{profile.rows}", advice=advice)
            beams.append(np.column_stack([*profile.columns.values()]))
        velocity = np.stack(beams, axis=-1)
        size, blanking = _number(header, text, "Cell size"), _number(header, text, "Blanking distance")
        ranges = (blanking + size * (1.0 + np.arange(cells))).tolist()
    heading = np.where((values["heading"] >= 0.0) & (values["heading"] <= 360.0), values["heading"], np.nan)
    numbers = re.search(r"Transformation matrix((?:\s+-?\d+\.\d+){9})", text)
    if system == Coordinates.BEAM and numbers is None:
        advice = "give the file that the instrument recorded"
        raise InputError(str(header), expected="a transformation matrix of 9 numbers", found="none", advice=advice)
    matrix = np.reshape(numbers[1].split(), (3, 3)).astype(float).tolist() if numbers else None
    return Samples(
        offset=np.zeros(table.rows, dtype=np.int64),
        time_s=table.columns["time"],
        heading_deg=heading,
        pitch_deg=values["pitch"],
        roll_deg=values["roll"],
        pressure_dbar=values["pressure"],
        temperature_c=values["temperature"],
        supply_voltage=values["battery voltage"],
        **_interpret_codes(velocity, system, _bits(values["error code"]), _bits(values["status code"])),
        bin_range_m=ranges,
        recorded=system,
        beam_angle_deg=0.0 if velocities else SLANT_DEG,
        serial=(_stated(text, "Serial number") or _stated(text, "Hardware serial number")),
        beams_to_axes=matrix if system == Coordinates.BEAM else None,
        average_s=_number(header, text, "Average interval"),
        counts={"diagnostic_samples": 0, "other_lengths": 0},
    )


def _stated(text: str, name: str) -> str:
    """Find the value of a line of the header; empty without one."""
    match = re.search(rf"^{name} {{2,}}(.*\S)", text, re.MULTILINE)
    return match[1] if match else ""


def _number(header: Path, text: str, name: str) -> float:
    """Find the number of a line of the header, centimetres converted to metres."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(\S*)", value := _stated(text, name))
    if match is None:
        raise InputError(
            f"{header}: {name}", expected="a number", found=value or "none", advice="convert the recording again"
        )
    return float(match[1]) * (0.01 if match[2] == "cm" else 1.0)


def _sibling(header: Path, suffix: str) -> Path:
    """Find a file of the same conversion, whose suffix may have capital letters."""
    there = [header.with_suffix(f".{each}") for each in (suffix, suffix.upper())]
    if path := next(filter(Path.is_file, there), None):
        return path
    advice = "give all files of the conversion in one folder"
    raise InputError(str(there[0]), expected="a file of the conversion beside its header", found="none", advice=advice)


def _bits(digits: Floats) -> Ints:
    """Read numbers of which each digit is a bit, as 110000."""
    whole = np.nan_to_num(digits).astype(np.int64)
    return sum(((whole // 10**k % 10) << k for k in range(8)), np.zeros(len(whole), dtype=np.int64))


def read(
    paths: Sequence[Path],
    *,
    orientation: str | None = None,
    declination_applied: float | Mapping[str, float] | None = None,
    serial_number: str | None = None,
) -> Record:
    """Read the files of one instrument in order of time, with currents rotated by the recorded magnetic heading.

    Settings override what the file states.

    Raises:
        InputError: a file is unreadable or holds no velocities, files do not belong together, the instrument lay on
            its side, or the serial number differs.
    """
    sources = dict.fromkeys(header_of(Path(path)) or Path(path) for path in paths)
    stated = parse_applied_declination(declination_applied)
    return join_records([_record(path, orientation, stated, serial_number) for path in sources])


def _record(
    path: Path, orientation: str | None, stated: AppliedDeclination | None, serial_number: str | None
) -> Record:
    if path.suffix.lower() == HEADER:
        nothing = np.zeros(0, dtype=np.int64)
        packets, samples = (
            Packets(path, nothing.astype(np.uint8), False, nothing, nothing, nothing, nothing, 0),
            decode_converted(path),
        )
    else:
        packets = find_packets(path)
        samples = signature.decode(packets) if packets.signature else decode_older(packets)
    dated = np.isfinite(samples.time_s)
    if not dated.any():
        raise files.foreign(path, "samples with velocities", "nortek", f"{len(dated)} with impossible dates")
    undated, samples = int(np.sum(~dated)), samples if dated.all() else take(samples, dated)
    serial = match_serial_number(str(path), samples.serial, serial_number)
    n, lying = len(samples.time_s), 0 if samples.sideways is None else int(samples.sideways.sum())
    if orientation is None and lying > STRAY * n:
        shown = f"an instrument on its side by its own word in {lying} of {n} samples"
        expected, advice = "one that looks up or down", "give orientation: up or down"
        raise InputError(str(path), expected=expected, found=shown, advice=advice)
    inside = AppliedDeclination(samples.declination_deg, samples.declination_deg) if stated is None else stated
    refuse_rotation(str(path), inside, is_earth=samples.up is not None)
    looks_up = samples.looks_up if orientation is None else np.full(n, orientation == "up")
    up = bool(np.mean(looks_up) > 0.5)
    heading = angles.wrap360(samples.heading_deg - inside.heading)
    if samples.up is None:
        side = np.where(looks_up, -1.0, 1.0)[:, None]
        level = compass.levelling(samples.pitch_deg, samples.roll_deg)  # in axes forward, starboard, down
        axes = samples.velocity if samples.beams_to_axes is None else _map_beams(samples, level, side)
        east, north, upward = turn_axes(axes, level, side, heading)
    else:
        (east, north), upward = np.moveaxis(samples.velocity, 2, 0), samples.up
        if inside.velocity:
            east, north = angles.turn(east, north, -inside.velocity)
    # Count the samples lost where bytes were skipped, from the time steps across the gaps.
    steps = np.diff(samples.time_s)
    after = np.searchsorted(samples.offset, [first for first, _ in packets.skipped])
    across = steps[np.unique(after[(after > 0) & (after < n)]) - 1]
    usual = float(np.median(steps)) if len(steps) else 0.0
    counts = samples.counts | {
        "samples": n,
        "records": len(packets.kind),
        "damaged": packets.damaged,
        "bytes_skipped": packets.bytes_skipped,
        "bytes_total": packets.data.size,
        "bad_dates": undated,
        "lost": int(np.maximum(np.rint(across / usual) - 1, 0).sum()) if usual > 0.0 else 0,
        "orientation_disagrees": int(np.sum(samples.looks_up != up)),
        "heading_missing": int(np.isnan(heading).sum()),
    }
    field = {} if samples.magnetometer is None else dict(zip(MAGNETOMETER, samples.magnetometer.T, strict=True))
    same = ["pitch_deg", "roll_deg", "pressure_dbar", "temperature_c", "supply_voltage"]
    same += ["quality", "heading_quality", "beam_angle_deg", "model"]
    return new_record(
        samples.time_s,
        east,
        north,
        **{name: getattr(samples, name) for name in same},
        bin_range_m=np.array(samples.bin_range_m),
        heading_deg=heading,
        looks_up=up,
        heading_bias_deg=inside.heading,
        velocity_bias_deg=inside.heading if samples.up is None else inside.velocity,
        serial_number=serial,
        manufacturer="Nortek",
        profiles={"up": upward.astype(np.float32), **samples.profiles},
        recorded_in=Coordinates(samples.recorded).name.lower(),
        bins_mapped=samples.beams_to_axes is not None,
        channels=field,
        channel_units=dict.fromkeys(field, "count"),
        counts=counts,
        warnings=tuple(_describe(packets, samples, counts, stated, up)),
    )


def turn_axes(axes: Floats, level: Floats, side: Floats, heading_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Rotate x, y and z, (n, m, 3) m/s, to (east, north, up) by the heading.

    Args:
        level: (n, 3, 3) of ``compass.levelling``.
        side: (n, 1) -1 for an up-looker, whose y points to port and z up, 1 for a down-looker.
    """
    x, y, z = np.moveaxis(axes, -1, 0)
    forward, starboard, down = np.moveaxis(level @ np.stack([x, side * y, side * z], axis=1), 1, 0)
    return *angles.turn(starboard, forward, heading_deg[:, None]), -down


def _map_beams(samples: Samples, level: Floats, side: Floats) -> Floats:
    """Map beam velocities to the bin depths of a level instrument and convert them to x, y and z, (n, m, 3) m/s."""
    matrix, ranges, beams = np.array(samples.beams_to_axes), samples.bin_range_m, samples.velocity
    if len(ranges) > 1:
        directions = np.linalg.pinv(matrix)  # (k, 3) of the beams in x, y, z
        turned = directions[:, None] * np.concatenate([np.ones_like(side), side, side], axis=1)
        down = np.einsum("ni,kni->nk", level[:, 2], turned)
        n = len(beams)
        mapped = map_cells(
            beams, np.abs(down / directions[:, 2]), np.full(n, ranges[0]), np.full(n, ranges[1] - ranges[0]),
            np.full(n, len(ranges)),
        )  # fmt: skip
        beams = np.where(np.isnan(beams), np.nan, mapped)
    return beams @ matrix.T


def _describe(
    packets: Packets, samples: Samples, counts: Mapping[str, int], stated: AppliedDeclination | None, up: bool
) -> Iterator[str]:
    """Compose the warnings about a file and its settings."""
    name, n, inside = packets.path.name, len(samples.time_s), samples.declination_deg
    if packets.skipped:
        yield (
            f"{name}: {packets.bytes_skipped} of {packets.data.size} bytes belong to no good record and were "
            f"skipped; {packets.damaged} places in them begin like a record and fail its checksum, and by their "
            f"times {counts['lost']} samples are lost."
        )
        yield f"{name}: skipped bytes {list_some([f'{first} to {last}' for first, last in packets.skipped])}."
    if counts["bad_dates"]:
        yield f"{name}: {counts['bad_dates']} good samples have an impossible date and were left out."
    yield from samples.notes
    if stated is None and inside:
        yield f"The declination of {inside:g} degrees that was set was taken out of the headings."
    elif stated is not None and {*stated} != {inside}:
        says = f"the file tells {inside:g}" if inside else "the file tells none"
        yield f"declination_applied of {stated} degrees was taken out of the directions; {says}."
    if counts["orientation_disagrees"] > STRAY * n:
        word, other = ("up", "down") if up else ("down", "up")
        effect = " though its velocities are turned already" if samples.recorded == Coordinates.EARTH else ""
        yield f"{counts['orientation_disagrees']} of {n} samples say that it looked {other}; {word} counts{effect}."
    if counts["heading_missing"]:
        yield f"{counts['heading_missing']} of {n} samples have no valid heading."
    yield from describe_averages(samples.average_s, samples.time_s)
