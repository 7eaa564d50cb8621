"""Encode small PD0 files for tests, from the manufacturer's byte tables and independently of the reader."""

import struct
from collections.abc import Sequence
from datetime import datetime
from typing import Any

START = datetime(2007, 9, 4, 12)
MISSING = -32768


def fixed_leader(
    *,
    cells: int,
    cell_cm: int = 200,
    blank_cm: int = 176,
    bin1_cm: int = 420,
    ex: int = 0b11111,
    ea: int = 0,
    eb: int = 0,
    up: bool = False,
    convex: bool = True,
    sensors: int = 0b0011_1101,
    beam_angle: int | None = 20,
    angle_bits: int = 1,
    beams: int = 4,
    firmware: int = 50,
    ez: int = 0x7D,
    pings: int = 10,
    between_pings: Sequence[int] = (0, 0, 0),
    serial: int = 0,
    board: bytes = bytes(8),
    length: int = 59,
    identifier: int = 0x0000,
) -> bytes:
    """Encode a fixed leader of ``length`` bytes: 300 kHz, beams at 20 degrees; between pings minutes, s and 1/100 s."""
    system = 0x4002 | angle_bits << 8 | (0x80 if up else 0) | (0x08 if convex else 0)
    block = bytearray(59)
    struct.pack_into("<HBBH", block, 0, identifier, firmware, 36, system)
    struct.pack_into("<BBHHH", block, 8, beams, cells, pings, cell_cm, blank_cm)
    block[22:25] = bytes(between_pings)
    struct.pack_into("<BhhBBH", block, 25, ex, ea, eb, ez, sensors, bin1_cm)
    block[42:50] = board
    struct.pack_into("<I", block, 54, serial)
    block[58] = beam_angle or 0
    return bytes(block[:length])


def variable_leader(
    *,
    number: int = 1,
    when: datetime | Sequence[int] = START,
    century: int = 20,
    heading: int = 0,
    tilt1: int = 0,
    tilt2: int = 0,
    depth_dm: int = 1000,
    temperature: int = 450,
    salinity: int = 35,
    sound: int = 1470,
    voltage: int = 150,
    pressure: int = 101_000,
    length: int = 65,
    identifier: int = 0x0080,
) -> bytes:
    """Encode a variable leader of ``length`` bytes; angles and temperature in hundredths, ``when`` or seven bytes.

    The speed of sound is that of the other values (1470.3 m/s).
    """
    clock = when if not isinstance(when, datetime) else (when.year - 2000, *when.timetuple()[1:6], 0)
    block = bytearray(65)
    struct.pack_into("<HH7BB", block, 0, identifier, number & 0xFFFF, *clock, number >> 16)
    struct.pack_into("<HHHhhHh", block, 14, sound, depth_dm, heading, tilt1, tilt2, salinity, temperature)
    block[31], block[34], block[35] = 2, 90, voltage  # spread of headings, degrees; transmit current, counts
    struct.pack_into("<i", block, 48, pressure)
    struct.pack_into("<B7B", block, 57, century, *(clock if century else [0] * 7))
    return bytes(block[:length])


def assemble(blocks: Sequence[bytes]) -> bytes:
    """Assemble blocks into an ensemble with header and checksum."""
    start = 6 + 2 * len(blocks)
    offsets = [start + sum(len(block) for block in blocks[:i]) for i in range(len(blocks))]
    body = b"".join(blocks) + b"\0\0"
    header = struct.pack(f"<HHBB{len(blocks)}H", 0x7F7F, start + len(body), 0, len(blocks), *offsets)
    return header + body + struct.pack("<H", sum(header + body) % 65536)


def ensemble(
    velocity: Sequence[Sequence[int]],
    *,
    fixed: dict[str, Any] | None = None,
    percent_good: Sequence[Sequence[int]] | None = None,
    extra: Sequence[bytes] = (),
    **variable: Any,
) -> bytes:
    """Encode an ensemble with velocities (m, 4) in mm/s and optional percent good (m, 4)."""
    blocks = [
        fixed_leader(cells=len(velocity), **(fixed or {})),
        variable_leader(**variable),
        b"\x00\x01" + b"".join(struct.pack("<4h", *row) for row in velocity),
        b"\x00\x02" + bytes([70, 71, 72, 73]) * len(velocity),
    ]
    if percent_good is not None:
        blocks.append(b"\x00\x04" + b"".join(bytes(row) for row in percent_good))
    return assemble([*blocks, *extra])
