"""A frame lowered from a ship: how it sinks, spins and sways, and what profilers bolted to it record of that.

The frame spins on its wire, sways with the swell and leans back against the water that the ship drags it through.
Each head hangs in the frame by a fixed rotation, has a clock of its own, and reads its own compass and inclinometers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.demo import adcp, compass
from compasslib.demo.adcp import Ensembles, Setup
from compasslib.demo.compass import Iron
from compasslib.demo.water import Floats, circle, red_noise, red_vector

STEP_S = 0.1
FIELD_NT = (22000.0, 40000.0)  # horizontal and vertical, of the middle latitudes
NO_IRON = Iron()
SMOOTH_STEPS = 20  # a heavy frame does not jerk


@dataclass(frozen=True)
class Sea:
    """How a frame moves while it is lowered."""

    turns: float = 4.0  # of the frame over the cast, clockwise
    wander_deg: float = 40.0  # standard deviation of the heading about that
    wander_s: float = 120.0  # memory of the wander
    swell_deg: float = 1.5  # standard deviation of either tilt
    swell_s: float = 9.0  # its period
    lean_deg: float = 2.0  # against the water, always towards the same side of the earth
    deepest_m: float = 2000.0
    speed_m_s: float = 1.0


@dataclass(frozen=True)
class Motion:
    """How the frame truly stands along a fine axis of time; (g,) each."""

    time_s: Floats
    depth_m: Floats
    heading_deg: Floats  # magnetic, not wrapped
    pitch_deg: Floats  # forward up
    roll_deg: Floats  # starboard down


@dataclass(frozen=True)
class Head:
    """A profiler bolted to the frame."""

    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # heading, pitch, roll of its body in the frame's
    looks_up: bool = False
    ping_s: float = 1.0
    first_s: float = 0.0  # of its first ping after the motion begins
    clock_s: float = 0.0  # its clock minus the true time, at the middle of the cast
    drift_s: float = 0.0  # gain of its clock over the cast
    iron: Iron = NO_IRON
    deviation_deg: tuple[float, ...] = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )  # A..E, series in the recorded heading, instead of iron
    noise_deg: float = 0.5  # of the compass
    tilt_noise_deg: float = 0.1
    slow_deg: float = 0.0  # of the compass too, but remembered: its damping, iron that moves, accelerations
    slow_s: float = 30.0  # memory of that; the tilts have a fifth of it


@dataclass(frozen=True)
class Posture:
    """How one head truly stands at its pings, and what its sensors give; (n,) each."""

    time_s: Floats  # true
    clock_s: Floats  # by its own clock
    depth_m: Floats
    heading_deg: Floats  # correct, magnetic
    recorded_deg: Floats
    tilt_deg: tuple[Floats, Floats]  # true pitch and roll
    sensed_deg: tuple[Floats, Floats]  # what the two inclinometers give


def lower(rng: np.random.Generator, sea: Sea, start_s: float) -> Motion:
    """Return how a frame moves on its way down and up again.

    Args:
        start_s: when it enters the water, UTC seconds since 1970.
    """
    duration = 2.0 * sea.deepest_m / sea.speed_m_s
    since = np.arange(0.0, duration, STEP_S)
    count = since.size
    wander = _smooth(red_noise(rng, count, memory=sea.wander_s / STEP_S, deviation=sea.wander_deg))
    heading = rng.uniform(0.0, 360.0) + 360.0 * sea.turns * since / duration + wander
    groups = red_vector(rng, count, memory=6 * sea.swell_s / STEP_S, deviation=sea.swell_deg)
    cross = red_vector(rng, count, memory=6 * sea.swell_s / STEP_S, deviation=sea.swell_deg)
    wave = np.exp(2j * np.pi * since / sea.swell_s)
    # Swell and lean keep to the earth; the frame turns under them.
    ahead = _smooth((groups * wave).real) + sea.lean_deg
    aside = _smooth((cross * wave).real)
    turned = (ahead + 1j * aside) * np.exp(-1j * np.deg2rad(heading))
    depth = sea.deepest_m - np.abs(since * sea.speed_m_s - sea.deepest_m)
    # What points down leans forward where the bow is lower: there the pitch, forward up, is negative.
    return Motion(start_s + since, depth, heading, 0.8 - turned.real, turned.imag - 0.5)


def stand(rng: np.random.Generator, motion: Motion, head: Head, field_nt: tuple[float, float] = FIELD_NT) -> Posture:
    """Return how a head stands at its pings and what its compass and inclinometers give.

    Args:
        field_nt: horizontal and vertical field, nT.
    """
    time = np.arange(motion.time_s[0] + head.first_s, motion.time_s[-1], head.ping_s)
    depth, heading, pitch, roll = (
        np.interp(time, motion.time_s, series)
        for series in (motion.depth_m, motion.heading_deg, motion.pitch_deg, motion.roll_deg)
    )
    heading, pitch, roll = mounted(heading, (pitch, roll), head.mount_deg)
    memory = head.slow_s / head.ping_s
    sensed = tuple(
        x
        + rng.normal(0.0, head.tilt_noise_deg, time.size)
        + red_noise(rng, time.size, memory=memory, deviation=head.slow_deg / 5.0)
        for x in adcp.inclinometers(pitch, roll)
    )
    if head.iron == NO_IRON:
        recorded = read_through(heading, head.deviation_deg)
    else:
        recorded = compass.recorded_heading(field_nt, heading, tilt_deg=(pitch, roll), iron=head.iron)
    slow = red_noise(rng, time.size, memory=memory, deviation=head.slow_deg)
    recorded = circle(recorded + slow + rng.normal(0.0, head.noise_deg, time.size))
    share = (time - motion.time_s[0]) / np.ptp(motion.time_s) - 0.5
    clock = time + head.clock_s + head.drift_s * share
    return Posture(time, clock, depth, heading, recorded, (pitch, roll), (sensed[0], sensed[1]))


def ensembles(posture: Posture, *, looks_up: bool, velocity_m_s: Floats | None = None) -> Ensembles:
    """Return what a head records, its clock's times and its compass's headings; velocities of one cell where absent.

    Args:
        looks_up: the orientation bit.
        velocity_m_s: the four recorded components, (n, m, 4), NaN where bad.
    """
    n = posture.time_s.size
    velocity = np.zeros((n, 1, 4)) if velocity_m_s is None else velocity_m_s
    cells = (n, velocity.shape[1], 4)
    return Ensembles(
        time_s=posture.clock_s,
        number=np.arange(n) + 1,
        upside=np.full(n, looks_up),
        heading_deg=posture.recorded_deg,
        pitch_deg=posture.sensed_deg[0],
        roll_deg=posture.sensed_deg[1],
        depth_m=posture.depth_m,
        pressure_dbar=1.01 * posture.depth_m,
        temperature_c=np.full(n, 4.0),
        supply_counts=np.full(n, 150, dtype=np.uint8),
        velocity_m_s=velocity,
        correlation=_counts(cells, 110),
        echo=_counts(cells, 120),
        percent_good=np.where(np.arange(4) == 3, np.uint8(100), np.uint8(0)) * np.ones(cells, dtype=np.uint8),
    )


def setup(*, looks_up: bool, cells: int = 1, coordinates: str = "earth", serial: int = 7301) -> Setup:
    """Return the programme of a lowered 300 kHz profiler.

    Args:
        looks_up: whether it looks up.
        coordinates: in which it records.
    """
    return Setup(
        kilohertz=300, looks_up=looks_up, cells=cells, cell_m=8.0, blank_m=0.0, first_bin_m=8.6, pings=1,
        coordinates=coordinates, serial=serial,
    )  # fmt: skip


def encoded(posture: Posture, *, looks_up: bool = False, mirrored: bool = False) -> bytes:
    """Return the PD0 file of a head without water.

    Args:
        looks_up: the orientation bit.
        mirrored: its roll sensor counts the other way, as in a head whose convention is another.
    """
    pitch, roll = posture.sensed_deg
    posture = replace(posture, sensed_deg=(pitch, -roll)) if mirrored else posture
    # The orientation bit is set ensemble by ensemble.
    return adcp.encode(setup(looks_up=looks_up), ensembles(posture, looks_up=looks_up)).tobytes()


def _counts(shape: tuple[int, ...], value: int) -> NDArray[np.uint8]:
    return np.full(shape, value, dtype=np.uint8)


def _smooth(series: Floats) -> Floats:
    """Average over two seconds twice, the ends held."""
    kernel = np.convolve(np.ones(SMOOTH_STEPS), np.ones(SMOOTH_STEPS)) / SMOOTH_STEPS**2
    padded = np.pad(series, SMOOTH_STEPS, mode="edge")
    return np.convolve(padded, kernel, mode="same")[SMOOTH_STEPS:-SMOOTH_STEPS]


def mounted(
    heading_deg: Floats, tilt_deg: tuple[Floats, Floats], mount_deg: tuple[float, float, float]
) -> tuple[Floats, Floats, Floats]:
    """Return heading (not wrapped), pitch and roll of a body that is turned in the frame by a fixed rotation.

    Args:
        heading_deg: of the frame, (n,).
        tilt_deg: its pitch, forward up, and roll, starboard down, (n,) each.
        mount_deg: heading, pitch and roll of the body in the frame.
    """
    zero = np.zeros(1)
    inner = (_turning(zero + mount_deg[0]) @ compass.tilting(zero + mount_deg[1], zero + mount_deg[2]))[0]
    whole = _turning(heading_deg) @ compass.tilting(*tilt_deg) @ inner
    heading = np.rad2deg(np.unwrap(np.arctan2(whole[:, 1, 0], whole[:, 0, 0])))
    pitch = np.rad2deg(np.arcsin(-whole[:, 2, 0]))
    return heading, pitch, np.rad2deg(np.arctan2(whole[:, 2, 1], whole[:, 2, 2]))


def _turning(heading_deg: Floats) -> Floats:
    turn = np.deg2rad(heading_deg)
    s, c, zero, one = np.sin(turn), np.cos(turn), np.zeros_like(turn), np.ones_like(turn)
    return np.stack([np.stack(row, axis=-1) for row in ((c, -s, zero), (s, c, zero), (zero, zero, one))], axis=-2)


def read_through(heading_deg: Floats, series_deg: tuple[float, ...]) -> Floats:
    """Return the recorded heading whose series in the recorded heading gives the correct one, by iteration.

    Args:
        heading_deg: correct headings, (n,).
    """
    a, b, c, d, e = series_deg
    recorded = np.array(heading_deg)
    for _ in range(60):
        turn = np.deg2rad(recorded)
        added = a + b * np.sin(turn) + c * np.cos(turn) + d * np.sin(2 * turn) + e * np.cos(2 * turn)
        recorded = heading_deg - added
    return recorded
