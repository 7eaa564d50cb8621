"""Encode Nortek files from the manuals, independently of the readers: the older format and the Signature's."""

import struct
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

import numpy as np

START = datetime(2016, 3, 4, 5, 6, 7, tzinfo=UTC)
TRANSFORM = np.array([[2.9, -1.45, -1.45], [0.0, -2.51, 2.51], [0.38, 0.38, 0.38]])  # close to the matrix of an AWAC
SIGNATURE = np.array([[1.1831, 0, -1.1831, 0], [0, -1.1831, 0, 1.1831], [0.5518, 0, 0.5518, 0], [0, 0.5518, 0, 0.5518]])
ENU, XYZ, BEAM = 0, 1, 2


@dataclass(frozen=True)
class Sample:
    """One sample; velocities (beams, bins) in m/s."""

    k: int
    velocity: np.ndarray
    heading: float = 123.4
    pitch: float = 2.5
    roll: float = -3.5
    pressure: float = 70.123
    temperature: float = 4.56
    volts: float = 11.1
    down: bool = False
    minutes: float = 10.0
    magnetometer: tuple[int, int, int] = (120, -340, 410)
    correlation: np.ndarray | None = None
    extra: dict[str, int] = field(default_factory=dict)
    begin: datetime = START

    @property
    def time(self) -> datetime:
        return self.begin + timedelta(minutes=self.minutes * self.k)


def checksum(block: bytes) -> int:
    words = block + b"\0" * (len(block) % 2)
    last = 0
    if len(block) % 2:  # Nortek's code uses an odd last byte as the high byte of a word
        words, last = block[:-1], block[-1] << 8
    return (0xB58C + sum(struct.unpack(f"<{len(words) // 2}H", words)) + last) % 65536


# ------------------------------------------------------------------------------------------------------ older format


def record(kind: int, contents: bytes) -> bytes:
    contents += b"\0" * (len(contents) % 2)
    block = struct.pack("<BBH", 0xA5, kind, (len(contents) + 6) // 2) + contents
    return block + struct.pack("<H", checksum(block))


def configuration(
    coordinates: int, cells: int, *, serial: str = "WPR 1234", khz: int = 1000, average_s: int = 60, beams: int = 3
) -> bytes:
    hardware = serial.ljust(14).encode() + bytes(24) + b"3.36"
    matrix = np.rint(TRANSFORM * 4096).astype("<i2").tobytes()
    head = struct.pack("<HHH12s", 0x0F, khz, 0, b"WAV 55") + bytes(8) + matrix + bytes(150) + bytes(22)
    head += struct.pack("<H", 3)
    first = struct.pack("<9H", 34, 20, 44, 512, 512, 60, average_s, beams, 0)
    second = struct.pack("<HHHHHHHHH", 0, 0, 0, 0, 1, coordinates, cells, 256, 600)
    user = first + second + b"NORTEK" + bytes(508 - 2 - 4 - 36 - 6)
    return record(0x05, hardware) + record(0x04, head) + record(0x00, user[: 512 - 6])


def older(sample: Sample, kind: int = 0x20) -> bytes:
    """Encode a record of the older format: 01 point, 20 AWAC profile, 21 Aquadopp profile, 80 diagnostic sample."""
    at = sample.time
    clock = bytes.fromhex(at.strftime("%M%S%d%H%y%m"))  # binary-coded decimals
    tenths = [round(10 * x) for x in (sample.heading, sample.pitch, sample.roll)]
    millibars = round(1000 * sample.pressure)
    sensors = struct.pack("<HHHH", sample.extra.get("error", 0), 0, round(10 * sample.volts), 14800)
    sensors += struct.pack("<HhhBBH", *tenths, millibars >> 16, 0x30 | sample.down, millibars & 0xFFFF)
    sensors += struct.pack("<h", round(100 * sample.temperature))
    counts = np.rint(1000 * sample.velocity).astype("<i2").tobytes()
    spare = bytes(88) if kind == 0x20 else b""
    return record(kind, clock + sensors + spare + counts + bytes([60]) * sample.velocity.size)


# ------------------------------------------------------------------------------------------------------- Signature


def packet(kind: int, contents: bytes) -> bytes:
    head = struct.pack("<BBBBHH", 0xA5, 10, kind, 0x10, len(contents), checksum(contents))
    return head + struct.pack("<H", checksum(head)) + contents


def text(declination: float = 0.0, average_s: int = 60) -> bytes:
    rows = ",".join(f"M{i + 1}{j + 1}={SIGNATURE[i, j]:.4f}" for i in range(4) for j in range(4))
    lines = [
        'GETCLOCKSTR,TIME="2016-03-04 05:06:07"',
        'ID,STR="Signature500",SN=100123',
        "GETPLAN,MIAVG=600,AVG=1,DIAVG=0,VD=0,MV=10,SA=35.0,BURST=0",
        f'GETAVG,NC=5,CS=1.00,BD=0.50,CY="BEAM",PL=0.0,AI={average_s},DF=3,NPING=30,NB=4,BW="BROAD"',
        "GETBURST,NC=5,CS=1.00,BD=0.50,DF=3,SR=1.0,NB=4",
        f"GETXFAVG,ROWS=4,COLS=4,{rows}",
        f"GETXFBURST,ROWS=4,COLS=4,{rows}",
        f"GETUSER,POFF=9.50,DECL={declination:.2f},HX=0,HY=0,HZ=0",
        *(f"BEAMCFGLIST,BEAM={k + 1},THETA=25.00,PHI={90.0 * k:.2f},FREQ=500" for k in range(4)),
    ]
    return packet(0xA0, b"\x10" + "\r\n".join(lines).encode() + b"\0")


def signature(sample: Sample, coordinates: int = BEAM, kind: int = 0x16) -> bytes:
    beams, cells = sample.velocity.shape
    at = sample.time
    configuration = 0x0F | 0x20 | 0x40 | 0x80
    clock = bytes([at.year - 1900, at.month - 1, at.day, at.hour, at.minute, at.second])
    block = struct.pack("<BBHI", 3, 76, configuration, 100123) + clock + struct.pack("<H", at.microsecond // 100)
    block += struct.pack("<HhI", 14800, round(100 * sample.temperature), round(1000 * sample.pressure))
    block += struct.pack("<Hhh", *(round(100 * x) for x in (sample.heading, sample.pitch, sample.roll)))
    block += struct.pack("<HHHBB", cells | coordinates << 10 | beams << 12, 1000, 50, 78, 100)
    block += struct.pack("<H3h3h", round(10 * sample.volts), *sample.magnetometer, 0, 0, 16384)
    status = sample.extra.get("orientation", 5 if sample.down else 4) << 25 | 2  # bit 1: blanking in centimetres
    block += struct.pack("<HHHbbhhHHII", 500, 0x4321, 0, -3, 0, 0, 450, 0, 0, status, sample.k + 1)
    correlation = np.full((beams, cells), 90) if sample.correlation is None else sample.correlation
    counts = np.rint(1000 * sample.velocity).astype("<i2").tobytes()
    return packet(kind, block + counts + bytes([120]) * (beams * cells) + correlation.astype(np.uint8).tobytes())
