"""Writes PD0, the binary format of RDI's Workhorse family, byte for byte in the layout of a genuine moored record.

Layout and units: WorkHorse Commands and Output Data Format, P/N 957-6156; order and sizes of the blocks as in
Workhorse files with a pressure sensor (firmware 16.28: fixed leader of 59 bytes, variable leader of 65).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.demo.series import Floats, circle

Counts = NDArray[np.uint8]

BEAM_ANGLE_DEG = 20.0
BAD_VELOCITY = -32768
FREQUENCY_BITS = {75: 0b000, 150: 0b001, 300: 0b010, 600: 0b011}
CONVEX, HEAD_ATTACHED, UP = 0b0000_1000, 0b0100_0000, 0b1000_0000
JANUS_20_DEG = 0x41
COORDINATE_BITS = {"beam": 0b00, "instrument": 0b01, "ship": 0b10, "earth": 0b11}
TILTS_THREE_BEAM_MAPPING = 0b111
FITTED = 0b0011_1101  # pressure, heading, pitch, roll, temperature; no conductivity
BLOCKS = 6

_FIXED = np.dtype(
    {
        "names": [
            "id", "firmware", "system", "beams", "cells", "pings", "cell_cm", "blank_cm", "mode", "low_correlation",
            "code_repeats", "error_limit_mm_s", "ping_time", "coordinates", "source", "fitted", "first_bin_cm",
            "pulse_cm", "reference_layer", "false_target", "lag_cm", "power", "serial", "beam_angle",
        ],
        "formats": [
            "<u2", "2u1", "2u1", "u1", "u1", "<u2", "<u2", "<u2", "u1", "u1",
            "u1", "<u2", "3u1", "u1", "u1", "u1", "<u2",
            "<u2", "2u1", "u1", "<u2", "u1", "<u4", "u1",
        ],
        "offsets": [
            0, 2, 4, 8, 9, 10, 12, 14, 16, 17,
            18, 20, 22, 25, 30, 31, 32,
            34, 36, 38, 40, 52, 54, 58,
        ],
        "itemsize": 59,
    }
)  # fmt: skip

_VARIABLE = np.dtype(
    {
        "names": [
            "id", "number", "clock", "number_high", "sound_m_s", "depth_dm", "heading", "pitch", "roll",
            "salinity", "temperature", "wait", "deviation", "adc", "pressure_dapa", "pressure_variance", "clock_y2k",
        ],
        "formats": [
            "<u2", "<u2", "7u1", "u1", "<u2", "<u2", "<u2", "<i2", "<i2",
            "<u2", "<i2", "3u1", "3u1", "8u1", "<u4", "<u4", "8u1",
        ],
        "offsets": [0, 2, 4, 11, 14, 16, 18, 20, 22, 24, 26, 28, 31, 34, 48, 52, 57],
        "itemsize": 65,
    }
)  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """How an instrument is programmed and mounted."""

    kilohertz: int
    looks_up: bool
    cells: int
    cell_m: float
    blank_m: float
    first_bin_m: float
    pings: int
    coordinates: str  # a key of COORDINATE_BITS
    serial: int


@dataclass(frozen=True)
class Ensembles:
    """What an instrument records: n ensembles of m cells and four components or beams."""

    time_s: Floats  # (n,) UTC seconds since 1970
    number: NDArray[np.int64]  # (n,) counted by the instrument
    upside: NDArray[np.bool_]  # (n,) the orientation bit: True looks up
    heading_deg: Floats  # (n,)
    pitch_deg: Floats  # (n,) as the sensor gives it
    roll_deg: Floats  # (n,)
    depth_m: Floats  # (n,)
    pressure_dbar: Floats  # (n,)
    temperature_c: Floats  # (n,)
    supply_counts: Counts  # (n,) transmit voltage
    velocity_m_s: Floats  # (n, m, 4) NaN where bad
    correlation: Counts  # (n, m, 4)
    echo: Counts  # (n, m, 4)
    percent_good: Counts  # (n, m, 4)


def write(path: Path, setup: Setup, ensembles: Ensembles) -> None:
    """Write the ensembles as one PD0 file."""
    path.write_bytes(encode(setup, ensembles).tobytes())


def encode(setup: Setup, ensembles: Ensembles) -> Counts:
    """Return the bytes of the ensembles, one row each, checksum included.

    Args:
        ensembles: what it recorded, n ensembles.
    """
    layout = _layout(setup.cells)
    rows = np.zeros(ensembles.time_s.size, dtype=layout)
    rows["header"] = _header(layout)
    rows["fixed"] = _fixed_leader(setup)
    # Bit 7 of the system configuration follows the instrument's own tilt switch, ensemble by ensemble.
    rows["fixed"]["system"][:, 0] |= np.where(ensembles.upside, UP, 0).astype(np.uint8)
    _fill_variable_leader(rows["variable"], ensembles)
    blocks = (("velocity", 0x0100), ("correlation", 0x0200), ("echo", 0x0300), ("percent_good", 0x0400))
    for block, identity in blocks:
        rows[block]["id"] = identity
    rows["velocity"]["cells"] = _millimetres(ensembles.velocity_m_s)
    for block in ("correlation", "echo", "percent_good"):
        rows[block]["cells"] = getattr(ensembles, block)
    octets = rows.view(np.uint8).reshape(rows.size, layout.itemsize)
    rows["checksum"] = octets[:, :-2].sum(axis=1, dtype=np.uint32) & 0xFFFF
    return octets


def _layout(cells: int) -> np.dtype:
    def block(kind: str) -> np.dtype:
        return np.dtype([("id", "<u2"), ("cells", kind, (cells, 4))])

    return np.dtype(
        [
            ("header", "u1", (6 + 2 * BLOCKS,)),
            ("fixed", _FIXED),
            ("variable", _VARIABLE),
            ("velocity", block("<i2")),
            ("correlation", block("u1")),
            ("echo", block("u1")),
            ("percent_good", block("u1")),
            ("reserved", "<u2"),
            ("checksum", "<u2"),
        ]
    )


def _header(layout: np.dtype) -> Counts:
    offsets = np.cumsum([layout[place].itemsize for place in range(BLOCKS)])
    # The length counts every byte but the checksum's two.
    words = np.array([0x7F7F, layout.itemsize - 2, BLOCKS << 8, *offsets], dtype="<u2")
    return words.view(np.uint8)


def _fixed_leader(setup: Setup) -> NDArray[np.void]:
    leader = np.zeros((), dtype=_FIXED)
    values = {
        "id": 0x0000, "firmware": (16, 28), "beams": 4, "cells": setup.cells, "pings": setup.pings, "mode": 1,
        "system": (FREQUENCY_BITS[setup.kilohertz] | CONVEX | HEAD_ATTACHED, JANUS_20_DEG),
        "cell_cm": round(100 * setup.cell_m), "blank_cm": round(100 * setup.blank_m), "low_correlation": 64,
        "code_repeats": 5, "error_limit_mm_s": 2000, "ping_time": (0, 1, 0),
        "coordinates": COORDINATE_BITS[setup.coordinates] << 3 | TILTS_THREE_BEAM_MAPPING,
        "source": 0x7F, "fitted": FITTED, "first_bin_cm": round(100 * setup.first_bin_m),
        "pulse_cm": round(100 * setup.cell_m), "reference_layer": (1, 5), "false_target": 50, "lag_cm": 49,
        "power": 255, "serial": setup.serial, "beam_angle": round(BEAM_ANGLE_DEG),
    }  # fmt: skip
    for name, value in values.items():
        leader[name] = value
    return leader


def _fill_variable_leader(leader: NDArray[np.void], ensembles: Ensembles) -> None:
    clock = _clock(ensembles.time_s)
    leader["id"] = 0x0080
    leader["number"], leader["number_high"] = ensembles.number & 0xFFFF, ensembles.number >> 16
    leader["clock"], leader["clock_y2k"] = clock[:, 1:], clock
    leader["sound_m_s"] = np.rint(1449.0 + 4.6 * ensembles.temperature_c + 0.016 * ensembles.depth_m)
    leader["depth_dm"] = np.rint(10 * ensembles.depth_m)
    leader["heading"] = np.rint(100 * circle(ensembles.heading_deg)) % 36000
    leader["pitch"], leader["roll"] = np.rint(100 * ensembles.pitch_deg), np.rint(100 * ensembles.roll_deg)
    leader["salinity"] = 34
    leader["temperature"] = np.rint(100 * ensembles.temperature_c)
    leader["deviation"] = (2, 3, 3)  # of heading in degrees, of pitch and roll in tenths
    leader["adc"] = (78, 0, 98, 255, 255, 95, 130, 159)
    leader["adc"][:, 1] = ensembles.supply_counts
    # Decapascals: thousandths of a dbar. An unsigned field, so that air reads as zero.
    leader["pressure_dapa"] = np.rint(1000 * np.maximum(ensembles.pressure_dbar, 0.0))


def _clock(time_s: Floats) -> Counts:
    """Return century, year, month, day, hour, minute, second, hundredths, (n, 8)."""
    hundredths = np.rint(100 * time_s).astype(np.int64)
    instants = (hundredths // 100).astype("datetime64[s]")
    months = instants.astype("datetime64[M]")
    year = months.astype("datetime64[Y]").astype(np.int64) + 1970
    month = months.astype(np.int64) % 12 + 1
    day = (instants.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.int64) + 1
    second = hundredths // 100 % 86400
    parts = (year // 100, year % 100, month, day, second // 3600, second // 60 % 60, second % 60, hundredths % 100)
    return np.stack(parts, axis=-1).astype(np.uint8)


def _millimetres(velocity_m_s: Floats) -> NDArray[np.int16]:
    known = np.isfinite(velocity_m_s)
    rounded = np.clip(np.rint(1000 * np.where(known, velocity_m_s, 0.0)), -32767, 32767)
    return np.where(known, rounded, BAD_VELOCITY).astype(np.int16)
