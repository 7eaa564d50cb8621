"""Simulation of an ADCP on a mooring and of its PD0 file: bins, noise, surface echo, hours on deck.

In earth coordinates the instrument has rotated its velocities by its own compass, hence they contain its heading
error; in beam coordinates it has not.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.demo import water as sea
from compasslib.demo.water import Water, clockwise, pressure
from compasslib.types import DAY_S, Complexes, Floats

Counts = NDArray[np.uint8]

BEAM_ANGLE_DEG = 20.0
FREQUENCY_BITS = {75: 0b000, 150: 0b001, 300: 0b010, 600: 0b011}
COORDINATE_BITS = {"beam": 0b00, "instrument": 0b01, "ship": 0b10, "earth": 0b11}
BLOCKS = 6


def _leader(size: int, *fields: tuple[str, str, int]) -> np.dtype:
    names, formats, offsets = zip(*fields, strict=True)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})


_FIXED = _leader(
    59, ("id", "<u2", 0), ("firmware", "2u1", 2), ("system", "2u1", 4), ("beams", "u1", 8), ("cells", "u1", 9),
    ("pings", "<u2", 10), ("cell_cm", "<u2", 12), ("blank_cm", "<u2", 14), ("mode", "u1", 16),
    ("low_correlation", "u1", 17), ("code_repeats", "u1", 18), ("error_limit_mm_s", "<u2", 20),
    ("ping_time", "3u1", 22), ("coordinates", "u1", 25), ("source", "u1", 30), ("fitted", "u1", 31),
    ("first_bin_cm", "<u2", 32), ("pulse_cm", "<u2", 34), ("reference_layer", "2u1", 36), ("false_target", "u1", 38),
    ("lag_cm", "<u2", 40), ("power", "u1", 52), ("serial", "<u4", 54), ("beam_angle", "u1", 58),
)  # fmt: skip

_VARIABLE = _leader(
    65, ("id", "<u2", 0), ("number", "<u2", 2), ("clock", "7u1", 4), ("number_high", "u1", 11),
    ("sound_m_s", "<u2", 14), ("depth_dm", "<u2", 16), ("heading", "<u2", 18), ("pitch", "<i2", 20),
    ("roll", "<i2", 22), ("salinity", "<u2", 24), ("temperature", "<i2", 26), ("wait", "3u1", 28),
    ("deviation", "3u1", 31), ("adc", "8u1", 34), ("pressure_dapa", "<u4", 48), ("pressure_variance", "<u4", 52),
    ("clock_y2k", "8u1", 57),
)  # fmt: skip


@dataclass(frozen=True)
class Setup:
    """Configuration and mounting of an instrument."""

    kilohertz: int
    looks_up: bool
    cells: int
    cell_m: float
    blank_m: float
    first_bin_m: float
    pings: int
    coordinates: str  # a key of COORDINATE_BITS
    serial: int
    noise_m_s: float = 0.014  # standard deviation of a horizontal component in the nearest bin
    sample_s: float = 0.0  # seconds after the full hour
    first_number: int = 1  # of its ensembles


@dataclass(frozen=True)
class Ensembles:
    """Record of an instrument: n ensembles of m cells and four components or beams."""

    time_s: Floats  # (n,) UTC seconds since 1970
    number: NDArray[np.int64]  # (n,) ensemble number
    upside: NDArray[np.bool_]  # (n,) the orientation bit: True looks up
    heading_deg: Floats  # (n,)
    pitch_deg: Floats  # (n,) as recorded by the sensor
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
    """Encode the ensembles in PD0, one row of bytes each, including the checksum."""
    layout = _layout(setup.cells)
    rows = np.zeros(ensembles.time_s.size, dtype=layout)
    # The length in the header excludes the two bytes of the checksum.
    offsets = np.cumsum([layout[place].itemsize for place in range(BLOCKS)])
    header = np.array([0x7F7F, layout.itemsize - 2, BLOCKS << 8, *offsets], dtype="<u2")
    rows["header"] = header.view(np.uint8)
    fixed: dict[str, Any] = {
        "id": 0x0000, "firmware": (16, 28), "beams": 4, "cells": setup.cells, "pings": setup.pings, "mode": 1,
        "system": (FREQUENCY_BITS[setup.kilohertz] | 0b0100_1000, 0x41),  # convex, head attached; four beams at 20°
        "cell_cm": round(100 * setup.cell_m), "blank_cm": round(100 * setup.blank_m), "low_correlation": 64,
        "code_repeats": 5, "error_limit_mm_s": 2000, "ping_time": (0, 1, 0),
        "coordinates": COORDINATE_BITS[setup.coordinates] << 3 | 0b111,  # tilts, three beams, mapped bins
        "source": 0x7F, "fitted": 0b0011_1101,  # pressure, heading, pitch, roll, temperature; no conductivity
        "first_bin_cm": round(100 * setup.first_bin_m),
        "pulse_cm": round(100 * setup.cell_m), "reference_layer": (1, 5), "false_target": 50, "lag_cm": 49,
        "power": 255, "serial": setup.serial, "beam_angle": round(BEAM_ANGLE_DEG),
    }  # fmt: skip
    for name, value in fixed.items():
        rows["fixed"][name] = value
    # Bit 7 of the system configuration follows the orientation switch of the instrument in each ensemble.
    rows["fixed"]["system"][:, 0] |= np.where(ensembles.upside, 0b1000_0000, 0).astype(np.uint8)
    _fill_variable_leader(rows["variable"], ensembles)
    for k, block in enumerate(("velocity", "correlation", "echo", "percent_good"), 1):
        rows[block]["id"] = k << 8
    known = np.isfinite(ensembles.velocity_m_s)
    rounded = np.clip(np.rint(1000 * np.where(known, ensembles.velocity_m_s, 0.0)), -32767, 32767)
    rows["velocity"]["cells"] = np.where(known, rounded, -32768).astype(np.int16)
    for block in ("correlation", "echo", "percent_good"):
        rows[block]["cells"] = getattr(ensembles, block)
    octets = rows.view(np.uint8).reshape(rows.size, layout.itemsize)
    rows["checksum"] = octets[:, :-2].sum(axis=1, dtype=np.uint32) & 0xFFFF
    return octets


def _layout(cells: int) -> np.dtype:
    numbers, octets = (np.dtype([("id", "<u2"), ("cells", kind, (cells, 4))]) for kind in ("<i2", "u1"))
    leaders = [("header", "u1", (6 + 2 * BLOCKS,)), ("fixed", _FIXED), ("variable", _VARIABLE)]
    blocks = [("velocity", numbers), ("correlation", octets), ("echo", octets), ("percent_good", octets)]
    return np.dtype([*leaders, *blocks, ("reserved", "<u2"), ("checksum", "<u2")])


def _fill_variable_leader(leader: NDArray[np.void], ensembles: Ensembles) -> None:
    hundredths = np.rint(100 * ensembles.time_s).astype(np.int64)
    year, *parts = sea.calendar(hundredths // 100)
    clock = np.stack([year // 100, year % 100, *parts, hundredths % 100], axis=-1).astype(np.uint8)
    leader["id"] = 0x0080
    leader["number"], leader["number_high"] = ensembles.number & 0xFFFF, ensembles.number >> 16
    leader["clock"], leader["clock_y2k"] = clock[:, 1:], clock
    leader["sound_m_s"] = np.rint(1449.0 + 4.6 * ensembles.temperature_c + 0.016 * ensembles.depth_m)
    leader["depth_dm"] = np.rint(10 * ensembles.depth_m)
    leader["heading"] = np.rint(100 * angles.wrap360(ensembles.heading_deg)) % 36000
    leader["pitch"], leader["roll"] = np.rint(100 * ensembles.pitch_deg), np.rint(100 * ensembles.roll_deg)
    leader["salinity"] = 34
    leader["temperature"] = np.rint(100 * ensembles.temperature_c)
    leader["deviation"] = (2, 3, 3)  # of heading in degrees, of pitch and roll in tenths
    leader["adc"] = (78, 0, 98, 255, 255, 95, 130, 159)
    leader["adc"][:, 1] = ensembles.supply_counts
    # Decapascals, thousandths of a dbar; the field is unsigned, hence negative pressures are set to zero.
    leader["pressure_dapa"] = np.rint(1000 * np.maximum(ensembles.pressure_dbar, 0.0))


ABSORPTION_DB_M = {75: 0.025, 300: 0.065}
SIN, COS = (float(x) for x in angles.sin_cos(BEAM_ANGLE_DEG))


@dataclass(frozen=True)
class Stance:
    """True depth and attitude of an instrument at its samples, and the readings of its sensors; (n,) each."""

    time_s: Floats
    depth_m: Floats
    heading_deg: Floats  # correct, magnetic
    recorded_deg: Floats  # by its compass
    tilt_deg: tuple[Floats, Floats]  # true pitch, forward up, and roll, starboard down
    sensed_tilt_deg: tuple[Floats, Floats]  # the same with noise of the inclinometers, as used by the compass
    declination_deg: Floats
    in_water: NDArray[np.bool_]
    gain: float = 0.0  # relative excess gain of the forward beam pair over the other pair
    bias_m_s: complex = 0.0  # starboard + i forward, in every bin


def ranges(setup: Setup) -> Floats:
    """Compute the distance of each bin from the transducer along the vertical, metres, (m,)."""
    return setup.first_bin_m + setup.cell_m * np.arange(setup.cells, dtype=float)


def measure(rng: np.random.Generator, setup: Setup, stance: Stance, water: Water, *, latitude_deg: float) -> Ensembles:
    """Simulate the record of an instrument."""
    n, wet = stance.time_s.size, stance.in_water
    moving = _spoil(rng, setup, stance, _velocity(rng, setup, stance, water))
    # Share of pings with a valid velocity: decreasing with range, and small beyond the surface.
    good = np.broadcast_to(1.0 - 0.3 * (ranges(setup) / ranges(setup)[-1]) ** 6, (n, setup.cells))
    good = np.where(ranges(setup) > stance.depth_m[:, None], 0.1, good) if setup.looks_up else good
    pitch, roll = inclinometers(*stance.sensed_tilt_deg)
    deck_roll = np.where(stance.time_s < stance.time_s[n // 2], -52.0, 61.0) + rng.normal(0.0, 0.05, n)
    flipped = ~wet & (np.arange(n) < 5)  # the orientation switch, on deck
    depth = np.where(wet, np.maximum(stance.depth_m + rng.normal(0.0, 0.05, n), 0.0), 0.0)
    deck_pitch = 4.0 + rng.normal(0.0, 0.05, n)
    season = np.cos(2 * np.pi * (stance.time_s / DAY_S - 250.0) / 365.25)
    water_c = 2.5 + 1.5 * season * np.exp(-stance.depth_m / 200.0)
    temperature = np.where(wet, water_c, 8.0) + rng.normal(0.0, 0.05, n)
    used = np.linspace(0.0, 1.0, n)
    supply = np.rint(166.0 - 14.0 * used - 9.0 * used**6 + rng.normal(0.0, 0.6, n))
    return Ensembles(
        time_s=stance.time_s,
        number=np.arange(n) + setup.first_number,
        upside=flipped ^ setup.looks_up,
        heading_deg=stance.recorded_deg,
        pitch_deg=np.where(wet, pitch, deck_pitch),
        roll_deg=np.where(wet, roll, deck_roll),
        depth_m=depth,
        pressure_dbar=pressure(depth, latitude_deg),
        temperature_c=temperature,
        supply_counts=supply.astype(np.uint8),
        velocity_m_s=np.where(wet[:, None, None], moving, np.nan),
        correlation=_scatter(rng, np.where(wet[:, None], 40 + 80 * good, 8.0), 4.0),
        echo=_scatter(rng, np.where(wet[:, None], _echo(setup, stance), 45.0), 2.0),
        percent_good=_percent_good(rng, setup, np.where(wet[:, None], good, 0.0)),
    )


def near_bins(setup: Setup, stance: Stance, water: Water) -> Complexes:
    """Average the current over the first two bins, including errors of the beams, true east + i north, m/s, (n,)."""
    depth = _bin_depths(setup, stance)[:, :2]
    return _flawed(stance, sea.velocity(water, stance.time_s, depth)).mean(axis=1)


def _bin_depths(setup: Setup, stance: Stance) -> Floats:
    return stance.depth_m[:, None] + ranges(setup) * (-1.0 if setup.looks_up else 1.0)


def _velocity(rng: np.random.Generator, setup: Setup, stance: Stance, water: Water) -> Floats:
    deviation = setup.noise_m_s * (1.0 + 1.5 * (ranges(setup) / ranges(setup)[-1]) ** 4)
    shape = (stance.time_s.size, deviation.size, 4)
    if setup.coordinates == "beam":
        of_beams = (deviation * np.sqrt(2) * SIN)[:, None]
        return _beams(setup, stance, water) + rng.standard_normal(shape, dtype=np.float32) * of_beams
    flow = _flawed(stance, sea.velocity(water, stance.time_s, _bin_depths(setup, stance)))
    # Rotate from true to magnetic north, and by the error of the compass.
    wrong = stance.recorded_deg - stance.heading_deg - stance.declination_deg
    flow = clockwise(flow, wrong[:, None])
    still = np.zeros_like(flow.real)
    upward = deviation / np.sqrt(2) * np.tan(np.deg2rad(BEAM_ANGLE_DEG))
    noise = rng.standard_normal(shape, dtype=np.float32) * np.stack([deviation, deviation, upward, deviation], axis=-1)
    return np.stack([flow.real, flow.imag, still, still], axis=-1) + noise


def _flawed(stance: Stance, flow: Complexes) -> Complexes:
    true_heading = (stance.heading_deg + stance.declination_deg)[:, None]
    body = clockwise(flow, -true_heading)  # starboard + i forward
    return clockwise(by_beams(body, stance.gain, stance.bias_m_s), true_heading)


def by_beams(body: Complexes, gain: float, bias_m_s: complex) -> Complexes:
    """Apply an excess gain of the forward beams and a bias to a current in the body frame, starboard + i forward."""
    return np.asarray(body + 1j * gain * body.imag + bias_m_s)


def _beams(setup: Setup, stance: Stance, water: Water) -> Floats:
    """Compute the velocity along each beam, positive towards the head, at the depth of each of its cells."""
    beams = np.array([[SIN, -SIN, 0, 0], [0, 0, -SIN, SIN], [COS] * 4])
    pitch_deg, roll_deg = stance.tilt_deg
    roll_deg = roll_deg + (180.0 if setup.looks_up else 0.0)
    (sh, ch), (sp, cp), (sr, cr) = (angles.sin_cos(x) for x in (stance.heading_deg, pitch_deg, roll_deg))
    rows = (
        (ch * cr + sh * sp * sr, sh * cp, ch * sr - sh * sp * cr),
        (-sh * cr + ch * sp * sr, ch * cp, -sh * sr - ch * sp * cr),
        (-cp * sr, sp, cp * cr),
    )
    # Unit vectors of the beams towards the head, in magnetic east, north and up, (n, 3, 4).
    head = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2) @ beams
    # That of a beam that looks up points down, and its depth decreases with range.
    depth = stance.depth_m[:, None, None] + (ranges(setup) / COS)[None, :, None] * head[:, None, 2, :]
    flow = clockwise(sea.velocity(water, stance.time_s, depth), -stance.declination_deg[:, None, None])
    return flow.real * head[:, None, 0, :] + flow.imag * head[:, None, 1, :]


def inclinometers(pitch_deg: Floats, roll_deg: Floats) -> tuple[Floats, Floats]:
    """Convert tilts to the readings of two inclinometers, of which that of pitch also depends on roll."""
    return np.rad2deg(np.arctan(np.tan(np.deg2rad(pitch_deg)) / np.cos(np.deg2rad(roll_deg)))), roll_deg


def _spoil(rng: np.random.Generator, setup: Setup, stance: Stance, velocity: Floats) -> Floats:
    """Degrade the velocities of an upward-looking instrument near and beyond the surface."""
    if not setup.looks_up:
        return velocity
    height = stance.depth_m[:, None]
    reach = ranges(setup) + setup.cell_m / 2
    row, column = np.nonzero(reach > height * COS)
    beyond = (ranges(setup)[column] > stance.depth_m[row])[:, None]
    waves = 0.4 * velocity[row, column] + rng.normal(0.0, 0.15, (row.size, 4))
    garbage = rng.normal(0.0, 0.6, (row.size, 4))
    lost = beyond & (rng.random((row.size, 1)) < 0.4)
    spoilt = velocity.copy()
    spoilt[row, column] = np.where(lost, np.nan, np.where(beyond, garbage, waves))
    return spoilt


def _echo(setup: Setup, stance: Stance) -> Floats:
    """Simulate the mean echo intensity in counts, (n, m), including the surface echo."""
    away = ranges(setup)
    loss_db = 20 * np.log10(away / away[0]) + 2 * ABSORPTION_DB_M[setup.kilohertz] * (away - away[0])
    counts = np.maximum(190.0 - loss_db / 0.45, 42.0)
    if not setup.looks_up:
        return np.broadcast_to(counts, (stance.time_s.size, setup.cells))
    surface = 70.0 * np.exp(-(((away - stance.depth_m[:, None]) / setup.cell_m) ** 2))
    return np.where(away > stance.depth_m[:, None] + setup.cell_m, counts - 15.0, counts) + surface


def _scatter(rng: np.random.Generator, mean: Floats, deviation: float) -> NDArray[np.uint8]:
    noise = rng.standard_normal((*mean.shape, 4), dtype=np.float32)
    return np.clip(mean[..., None] + deviation * noise, 0, 255).astype(np.uint8)


def _percent_good(rng: np.random.Generator, setup: Setup, share: Floats) -> NDArray[np.uint8]:
    """Simulate percent good: by beam, or of three-beam, rejected, too few beams and four-beam solutions."""
    percent = np.clip(100 * share - np.abs(rng.normal(0.0, 1.0, share.shape)), 0, 100)
    if setup.coordinates == "beam":
        return np.repeat(percent[..., None], 4, axis=-1).astype(np.uint8)
    three = np.floor(0.05 * percent)
    parts = (three, np.zeros_like(three), 100 - np.floor(percent), np.floor(percent) - three)
    return np.stack(parts, axis=-1).astype(np.uint8)
