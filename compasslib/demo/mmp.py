"""Writes the files of a Falmouth 3D-ACM on a McLane profiler: unpacked ASCII, and the binary it is unpacked from.

Both hold all profiles of a mooring one after another, each with its own head and tail, exactly as the single files
of a genuine deployment would follow one another. The order and sizes of the binary header's fields were read off a
genuine file against its own unpacked listing.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.demo.series import Floats

ROW = "   %s%9.2f%9.2f%9.2f%10.4f%10.4f%10.4f%10.2f%10.2f%10.2f%10.2f\r\n"
COLUMNS = (
    "   MM-DD-YYYY HH:MM:SS     HDNG       TX       TY        HX        HY        HZ"
    "      VPAB      VPCD      VPEF      VPGH\r\n"
)
PARTIAL_EVERY = 97  # one profile in so many ends in the middle of a row
ROW_CHARACTERS, PARTIAL_CHARACTERS = 121, 64
FLAGS = {
    "op_flag1": " TIME HDNG",
    "op_flag2": " TX   TY   HX   HY   HZ  ",
    "op_flag4": " TILT COMP VPTH",
    "op_flag5": " ECHO LOG ",
    "op_mode": " NRML",
}

_RECORD = np.dtype(
    [("clock", "u1", (3,)), ("month", "u1"), ("day", "u1"), ("year", "<u2"), ("values", "<f4", (10,))],
)


@dataclass(frozen=True)
class Acm:
    """The current meter, as its header names it."""

    serial: int
    user: str
    latitude_deg: float
    longitude_deg: float
    rate_hz: float = 1.0


@dataclass(frozen=True)
class Scans:
    """What it logged: r scans in p profiles; headings magnetic, degrees, paths in cm/s."""

    number: NDArray[np.int64]  # (p,) of the profile
    size: NDArray[np.int64]  # (p,) scans in it
    on_s: NDArray[np.int64]  # (p,) switched on, UTC seconds since 1970
    off_s: NDArray[np.int64]  # (p,)
    time_s: NDArray[np.int64]  # (r,) the clock has whole seconds
    values: Floats  # (r, 10) HDNG TX TY HX HY HZ VPAB VPCD VPEF VPGH


def write_text(path: Path, acm: Acm, scans: Scans) -> None:
    """Write unpacked ASCII, space delimited, with header."""
    stamps = _stamps(scans.time_s)
    head = f"Sample rate: {acm.rate_hz:.4f} Hz\r\n\r\n\r\n"
    with path.open("w", newline="") as file:
        for k, number, begin, end in _profiles(scans):
            cells = np.empty((end - begin, 11), dtype=object)
            cells[:, 0], cells[:, 1:] = stamps[begin:end], scans.values[begin:end]
            # One template for a whole profile: a call a row would take most of the time of the cruise.
            rows = (ROW * (end - begin)) % tuple(cells.ravel())
            if number % PARTIAL_EVERY == 0:
                rows = rows[: PARTIAL_CHARACTERS - ROW_CHARACTERS] + "\r\n"
            file.write(f"{head} Profile {number}\r\n\r\n{COLUMNS}\r\n{rows}\r\n{_tail(acm, scans, k)}")


def write_binary(path: Path, acm: Acm, scans: Scans) -> None:
    """Write the logger's own binary, one ``A*.DAT`` after another."""
    records = _records(scans)
    header = b"".join(struct.pack("<" + code, value) for _, code, value in _header_fields(acm))
    with path.open("wb") as file:
        for k, _, begin, end in _profiles(scans):
            body = header + records[begin:end].tobytes()
            file.write(struct.pack(">I", len(body)) + body + struct.pack(">II", scans.on_s[k], scans.off_s[k]))


def _profiles(scans: Scans) -> list[tuple[int, int, int, int]]:
    """Return position, number, first scan and end of each profile."""
    ends = np.cumsum(scans.size)
    begins = ends - scans.size
    return list(zip(range(ends.size), scans.number.tolist(), begins.tolist(), ends.tolist(), strict=True))


def _stamps(time_s: NDArray[np.int64]) -> NDArray[np.str_]:
    """Return MM-DD-YYYY HH:MM:SS."""
    iso = np.datetime_as_string(time_s.astype("datetime64[s]")).astype("U19")
    letters = iso.view("U1").reshape(iso.size, 19)
    letters = letters[:, [5, 6, 4, 8, 9, 7, 0, 1, 2, 3, 10, *range(11, 19)]]
    letters[:, 10] = " "
    return np.ascontiguousarray(letters).view("U19").ravel()


def _records(scans: Scans) -> NDArray[np.void]:
    days = scans.time_s.astype("datetime64[s]").astype("datetime64[D]")
    months = days.astype("datetime64[M]")
    second = scans.time_s % 86400
    records = np.zeros(scans.time_s.size, dtype=_RECORD)
    records["clock"] = np.stack([second // 3600, second // 60 % 60, second % 60], axis=-1)
    records["month"] = months.astype(np.int64) % 12 + 1
    records["day"] = (days - months.astype("datetime64[D]")).astype(np.int64) + 1
    records["year"] = months.astype(np.int64) // 12 + 1970
    records["values"] = scans.values
    return records


def _tail(acm: Acm, scans: Scans, k: int) -> str:
    on, off = (np.datetime64(int(t), "s").item().strftime("%m/%d/%Y %H:%M:%S") for t in (scans.on_s[k], scans.off_s[k]))
    fields = _header_fields(acm)
    length = struct.calcsize("<" + "".join(code for _, code, _ in fields)) + _RECORD.itemsize * int(scans.size[k])
    listing = [("FILELEN", "I", length), *fields]
    shown = "".join(f"{name:<12}: {_shown(name, code, value)}\r\n" for name, code, value in listing if name)
    return (
        f" Profile {scans.number[k]}\r\n  ACM turned on at {on}\r\n  ACM turned off at {off}\r\n\r\n"
        f"ACM+ Header Contents:\r\n\r\n{shown}"
    )


def _shown(name: str, code: str, value: float | int | bytes) -> str:
    if isinstance(value, bytes):
        text = value.decode("latin-1")
        return text if text.isprintable() else value.hex(" ").upper() + " "
    if code == "B":
        return f"{value:02X} : {FLAGS.get(name, '')}"
    return f"{value:.4f}" if isinstance(value, float) else str(value)


def _header_fields(acm: Acm) -> list[tuple[str, str, float | int | bytes]]:
    """Return name, struct code and value in the order of the file; 279 bytes, nameless ones fill gaps."""
    unity = [(f"T{row}{column}", "f", 0.0002 * (row == column)) for column in (1, 2, 3) for row in (1, 2, 3)]
    zeros = ("tilt_temp0", "K9", "sal", "dbar")
    ks = (0.49, 0.30, 0.0, 0.0, 0.49, 0.30, 0.0, 0.0)
    return [
        ("cal_date", "3s", bytes((0x07, 0x06, 0x15))), ("ser_num", "H", acm.serial),
        ("mux", "H", 0), ("wdly", "H", 0), ("mux2", "H", 0), ("", "8s", b""),
        ("UserID", "32s", acm.user.encode()), ("BaudRate", "f", 19200.0), ("InitValue", "H", 1066), ("", "6s", b""),
        ("SRate", "f", acm.rate_hz), ("Latitude", "d", acm.latitude_deg), ("Longitude", "d", acm.longitude_deg),
        *[(name, "f", 0.0) for name in ("abof", "cdof", "efof", "ghof")],
        *[(name, "f", 1.0) for name in ("absl", "cdsl", "efsl", "ghsl")],
        *[(f"K{k}", "f", value) for k, value in enumerate(ks, 1)],
        *[(name, "f", 0.0) for name in zeros],
        ("seatoff", "f", -2.1), ("seatslp", "f", 0.0097), ("velscl", "f", 1.0),
        ("zhx", "f", -510.0), ("zhy", "f", 24.0), ("zhz", "f", -480.0), *unity,
        *[(name, "f", 0.0) for name in ("dex", "dey", "dez")],
        ("aux_delay", "I", 0), ("avgintv", "3s", bytes(3)), ("intv", "3s", bytes((0, 5, 0))),
        ("on", "3s", bytes((0, 0, 10))), ("dly_strt", "8s", bytes((0, 1, 10, 28, 9, 17, 4, 0))),
        ("op_flag1", "B", 0x28), ("op_flag2", "B", 0xF8), ("op_flag3", "B", 0x00), ("op_flag4", "B", 0x07),
        ("op_flag5", "B", 0x22), ("op_mode1", "B", 0x00), ("op_mode", "B", 0x10), ("version", "5s", b"v3.20"),
        ("Declination", "f", 0.0), ("checksum", "1s", bytes(1)), ("", "2s", b""), ("start", "4s", b"DATA"),
    ]  # fmt: skip
