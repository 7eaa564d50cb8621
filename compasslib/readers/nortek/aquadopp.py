"""Aquadopp, Aquadopp profiler and AWAC: configuration and velocity records of the older format.

Diagnostic samples and waves are passed over and counted. Byte numbers count from the A5. The head's matrix turns beams
into x, y, z. Ranges of cells: along beams of 25 degrees, by the factors that Nortek gives for each frequency. Source:
Nortek, System Integrator Manual (2010); the magnetometer's record as later firmware writes it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers.nortek.packets import BEAM, EARTH, MISSING_COUNT, Bytes, Packets, Samples, by_beam
from compasslib.readers.times import FIRST_YEAR, civil_seconds
from compasslib.records import BAD, GOOD, MISSING
from compasslib.types import Floats

USER, HEAD, HARDWARE = 0x00, 0x04, 0x05
VELOCITY = {0x01: 30, 0x81: 40, 0x21: 30, 0x20: 118, 0x24: 118}  # identifier: byte at which the velocities begin
POINT = (0x01, 0x81)
MAGNETOMETER = {0x81: 34}
DIAGNOSTIC = 0x80
OTHERS = {0x11: "a Vector", 0x12: "a Vector", 0x2A: "an Aquadopp in its high-resolution mode"}
BEAMS, SLANT_DEG = 3, 25.0
CELL_M = {2000: 0.0239, 1000: 0.0478, 600: 0.0797, 400: 0.1195}  # along a beam, by kHz, of 256 counts
BLANKING_M = {2000: 0.02228, 1000: 0.02266, 600: 0.02281, 400: 0.02289}  # of a count
COMPASS_FAILED, SAMPLE_FAILED = 0x01, 0x06  # bits of the error code
DOWN, FINE_SCALE, TILTED_BEYOND = 0x01, 0x02, 0x0C  # bits of the status
_BCD = np.array([10 * (k >> 4) + (k & 15) if max(k >> 4, k & 15) < 10 else -1 for k in range(256)])  # -1: no digits
_SENSORS = np.dtype(
    {
        "names": [
            *("clock", "error", "battery", "heading", "pitch", "roll"),
            *("pressure_high", "status", "pressure_low", "temperature"),
        ],
        "formats": ["6u1", "<u2", "<u2", "<u2", "<i2", "<i2", "u1", "u1", "<u2", "<i2"],
        "offsets": [4, 10, 14, 18, 20, 22, 24, 25, 26, 28],
        "itemsize": 30,
    }
)


def decode(packets: Packets) -> Samples:
    """Decode the samples of a file of the older format.

    Raises:
        InputError: no configuration or no velocities in it, two configurations, or a meter of another kind.
    """
    user, head = (_configuration(packets, kind) for kind in (USER, HEAD))
    kind = _kind(packets)
    of_kind = packets.kind == kind
    # A record of another length is of another configuration, or a chance sum.
    length = packets.end - packets.start
    usual = int(np.bincount(length[of_kind]).argmax())
    mine = of_kind & (length == usual)
    rows, first = packets.rows(mine), VELOCITY[kind]
    cells = 1 if kind in POINT else int(_number(user, 34))
    if usual < first + BEAMS * cells * 3 + 2 or not cells:
        raise _contradicts_configuration(packets, usual, first, cells, int(_number(user, 18)))
    sensors = np.ascontiguousarray(rows[:, : _SENSORS.itemsize]).view(_SENSORS)[:, 0]
    velocity = _velocity(rows[:, first : first + 6 * cells], sensors["status"])
    recorded = int(_number(user, 32))
    up = velocity[..., 2] if recorded == EARTH else None
    if recorded == EARTH:
        velocity = velocity[..., :2]
    elif recorded == BEAM:
        velocity = velocity @ (head[30:48].view("<i2").reshape(3, 3) / 4096.0).T
    magnetometer = MAGNETOMETER.get(kind)
    at = np.flatnonzero(packets.kind == HARDWARE)
    hardware = packets.data[packets.begin[at[0]] : packets.end[at[0]]] if len(at) else np.zeros(0, np.uint8)
    serial = hardware[4:12].tobytes().decode("ascii", "replace").strip(" \0") if hardware.size >= 18 else ""
    return Samples(
        offset=packets.start[mine],
        **_decode_sensors(sensors, velocity, has_pressure=bool(head[4] & 1)),
        velocity=velocity,
        bin_range_m=(0.0,) if kind in POINT else _ranges(packets, user, head, cells),
        recorded=recorded,
        beam_angle_deg=0.0 if kind in POINT else SLANT_DEG,
        serial=serial,
        average_s=float(_number(user, 16)),
        magnetometer=rows[:, magnetometer : magnetometer + 6].copy().view("<i2") * 1.0 if magnetometer else None,
        up=up,
        profiles={"echo": by_beam(rows, first + 2 * BEAMS * cells, BEAMS, cells)},
        counts={
            "diagnostic_samples": int(np.sum(packets.kind == DIAGNOSTIC)),
            "other_lengths": int(of_kind.sum()) - len(rows),
        },
    )


def _configuration(packets: Packets, kind: int) -> Bytes:
    """Find the one configuration of a kind; the same may stand there again where a recording was joined."""
    mine = packets.kind == kind
    part = "user's" if kind == USER else "head's"
    expected = f"the {part} configuration (A5 {kind:02X}), which tells what the velocities are"
    if not mine.any():
        advice = "take the instrument's own file from its first byte on"
        raise InputError(str(packets.path), expected=expected, found="none that is whole", advice=advice)
    sizes = packets.end[mine] - packets.begin[mine]
    rows = packets.rows(mine) if (sizes == sizes[0]).all() else None
    if rows is None or (rows != rows[0]).any():
        advice = "give each recording as a file of its own"
        raise InputError(str(packets.path), expected=expected, found=f"{len(sizes)} that differ", advice=advice)
    return rows[0]


def _kind(packets: Packets) -> int:
    there = [kind for kind in VELOCITY if (packets.kind == kind).any()]
    if len(there) == 1:
        return there[0]
    meant = next((name for kind, name in OTHERS.items() if (packets.kind == kind).any()), None)
    shown = f"those of {meant}" if meant else "several kinds" if there else "none"
    advice = "give its velocities as a table" if meant else "give each recording as a file of its own"
    kinds = "velocities of an Aquadopp, an Aquadopp profiler or an AWAC"
    raise InputError(str(packets.path), expected=kinds, found=shown, advice=advice)


def _contradicts_configuration(packets: Packets, size: int, first: int, cells: int, beams: int) -> InputError:
    """Word why records of some bytes, velocities from ``first`` on, do not hold the cells of three beams."""
    if beams != BEAMS and size in (whole := first + beams * cells * 3 + 2, whole + whole % 2):
        level = ", which are level, as of an AWAC that looks sideways" if beams == 2 else ""
        shown, expected = f"{beams} beam{'s' * (beams > 1)}{level}", f"{BEAMS} slanted beams"
        advice = "export its velocities with Nortek's program and write format: table"
    else:
        shown, expected = f"{size} bytes for {cells} cells", "records that hold their cells"
        advice = "the configuration is of another recording: give each as a file of its own"
    return InputError(str(packets.path), expected=expected, found=shown, advice=advice)


def _number(block: Bytes, at: int) -> np.uint16:
    return np.uint16(block[at : at + 2].view("<u2")[0])


def _velocity(rows: Bytes, status: Bytes) -> Floats:
    counts = np.ascontiguousarray(rows).view("<i2").reshape(len(rows), BEAMS, -1)
    # Divided, so that 123 mm/s is the number nearest to 0.123.
    velocity = counts / np.where(status & FINE_SCALE, 10000.0, 1000.0)[:, None, None]
    velocity[counts == MISSING_COUNT] = np.nan
    return np.moveaxis(velocity, 1, 2)


def _decode_sensors(sensors: Any, velocity: Floats, *, has_pressure: bool) -> dict[str, Any]:
    minute, second, day, hour, year, month = _BCD[sensors["clock"]].astype(np.int64).T
    century = np.where(year < FIRST_YEAR - 1900, 2000, 1900)
    # The instrument itself calls wrong: failed measurements and compasses, tilts beyond their sensor.
    error, beyond = sensors["error"], (sensors["status"] & TILTED_BEYOND) > 0
    failed, no_compass = ((error & bits) > 0 for bits in (SAMPLE_FAILED, COMPASS_FAILED))
    flags = np.where(failed | no_compass | beyond, BAD, GOOD)[:, None]
    heading = sensors["heading"] / 10.0
    pressure = (65536 * sensors["pressure_high"].astype(np.int64) + sensors["pressure_low"]) / 1000.0
    return {
        "time_s": civil_seconds(century + year, month, day, hour, minute, second),
        "heading_deg": np.where(heading < 360.0, heading, np.nan),
        "pitch_deg": sensors["pitch"] / 10.0,
        "roll_deg": sensors["roll"] / 10.0,
        "pressure_dbar": pressure if has_pressure else np.full(len(sensors), np.nan),
        "temperature_c": sensors["temperature"] / 100.0,
        "supply_voltage": sensors["battery"] / 10.0,
        "looks_up": (sensors["status"] & DOWN) == 0,
        "sideways": np.zeros(len(sensors), dtype=bool),
        "quality": np.where(np.isnan(velocity).any(axis=-1), MISSING, flags).astype(np.int8),
        "heading_quality": np.where(no_compass | beyond, BAD, GOOD).astype(np.int8),
    }


def _ranges(packets: Packets, user: Bytes, head: Bytes, cells: int) -> tuple[float, ...]:
    khz = int(_number(head, 6))
    if khz not in CELL_M:
        expected, advice = f"a head of {', '.join(map(str, CELL_M))} kHz", "give its velocities as a table"
        raise InputError(str(packets.path), expected=expected, found=f"{khz} kHz", advice=advice)
    cosine = float(angles.sin_cos(SLANT_DEG)[1])
    cell = round(int(_number(user, 36)) / 256 * CELL_M[khz] * cosine, 2)
    blanking = round(int(_number(user, 6)) * BLANKING_M[khz] * cosine - cell, 2)
    return tuple((blanking + cell * (1.0 + np.arange(cells))).tolist())
