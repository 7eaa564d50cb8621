"""Simulation of a frame lowered from a ship, of its motion, and of the records of profilers mounted on it.

The frame spins on its wire, sways with the swell and leans because of the drag as the ship moves. Each head is mounted
with a fixed rotation and has its own clock, compass and inclinometers.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from compasslib.angles import wrap360
from compasslib.demo import adcp, compass
from compasslib.demo.adcp import Ensembles, Setup
from compasslib.demo.compass import Iron
from compasslib.demo.water import Floats, red_noise, red_vector

STEP_S = 0.1
FIELD_NT = (22000.0, 40000.0)  # horizontal and vertical, of the middle latitudes
NO_IRON = Iron()
SMOOTH_STEPS = 20


@dataclass(frozen=True)
class Sea:
    """Motion of a frame while it is lowered."""

    turns: float = 4.0  # of the frame over the cast, clockwise
    wander_deg: float = 40.0  # standard deviation of the heading about that
    wander_s: float = 120.0  # memory of the wander
    swell_deg: float = 1.5  # standard deviation of either tilt
    swell_s: float = 9.0  # its period
    lean_deg: float = 2.0  # constant relative to the earth, due to drag
    deepest_m: float = 2000.0
    speed_m_s: float = 1.0


@dataclass(frozen=True)
class Motion:
    """True depth and attitude of the frame on a fine time axis; (g,) each."""

    time_s: Floats
    depth_m: Floats
    heading_deg: Floats  # magnetic, not wrapped
    pitch_deg: Floats  # forward up
    roll_deg: Floats  # starboard down


@dataclass(frozen=True)
class Head:
    """A profiler bolted to the frame."""

    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)  # heading, pitch, roll relative to the frame
    looks_up: bool = False
    ping_s: float = 1.0
    first_s: float = 0.0  # time of its first ping after the start of the motion
    clock_s: float = 0.0  # its clock minus the true time, at the middle of the cast
    drift_s: float = 0.0  # gain of its clock over the cast
    iron: Iron = NO_IRON
    deviation_deg: tuple[float, ...] = (0.0,) * 5  # A..E, series in the recorded heading, instead of iron
    noise_deg: float = 0.5  # of the compass
    tilt_noise_deg: float = 0.1
    slow_deg: float = 0.0  # red noise of the compass: damping, moving iron, accelerations; a fifth of it on the tilts
    slow_s: float = 30.0  # memory of the red noise


@dataclass(frozen=True)
class Posture:
    """True depth and attitude of a head at its pings, and the readings of its sensors; (n,) each."""

    time_s: Floats  # true
    clock_s: Floats  # by its own clock
    depth_m: Floats
    heading_deg: Floats  # correct, magnetic
    recorded_deg: Floats
    tilt_deg: tuple[Floats, Floats]  # true pitch and roll
    sensed_deg: tuple[Floats, Floats]  # readings of both inclinometers


def lower(rng: np.random.Generator, sea: Sea, start_s: float) -> Motion:
    """Simulate the motion of a frame on its way down and up again, from a time in UTC seconds since 1970."""

    def smooth(series: Floats) -> Floats:  # a heavy frame has inertia: a running mean over two seconds, twice
        once = uniform_filter1d(series, SMOOTH_STEPS, mode="nearest")
        return np.asarray(uniform_filter1d(once, SMOOTH_STEPS, mode="nearest", origin=-1))

    duration = 2.0 * sea.deepest_m / sea.speed_m_s
    since = np.arange(0.0, duration, STEP_S)
    count = since.size
    wander = smooth(red_noise(rng, count, memory=sea.wander_s / STEP_S, deviation=sea.wander_deg))
    heading = rng.uniform(0.0, 360.0) + 360.0 * sea.turns * since / duration + wander
    groups = red_vector(rng, count, memory=6 * sea.swell_s / STEP_S, deviation=sea.swell_deg)
    cross = red_vector(rng, count, memory=6 * sea.swell_s / STEP_S, deviation=sea.swell_deg)
    wave = np.exp(2j * np.pi * since / sea.swell_s)
    # Swell and lean are fixed relative to the earth while the frame turns.
    ahead = smooth((groups * wave).real) + sea.lean_deg
    aside = smooth((cross * wave).real)
    turned = (ahead + 1j * aside) * np.exp(-1j * np.deg2rad(heading))
    depth = sea.deepest_m - np.abs(since * sea.speed_m_s - sea.deepest_m)
    # If the top leans forward, the bow is lower, and the pitch, forward up, is negative.
    return Motion(start_s + since, depth, heading, 0.8 - turned.real, turned.imag - 0.5)


def stand(rng: np.random.Generator, motion: Motion, head: Head, field_nt: tuple[float, float] = FIELD_NT) -> Posture:
    """Simulate attitude and readings of a head at its pings; the field is horizontal and vertical."""
    time = np.arange(motion.time_s[0] + head.first_s, motion.time_s[-1], head.ping_s)
    depth, heading, pitch, roll = (
        np.interp(time, motion.time_s, series)
        for series in (motion.depth_m, motion.heading_deg, motion.pitch_deg, motion.roll_deg)
    )
    heading, pitch, roll = mounted(heading, (pitch, roll), head.mount_deg)
    memory = head.slow_s / head.ping_s
    slow = {"memory": memory, "deviation": head.slow_deg / 5.0}
    sensed = tuple(
        x + rng.normal(0.0, head.tilt_noise_deg, time.size) + red_noise(rng, time.size, **slow)
        for x in adcp.inclinometers(pitch, roll)
    )
    if head.iron == NO_IRON:
        recorded = read_through(heading, head.deviation_deg)
    else:
        recorded = compass.recorded_heading(field_nt, heading, tilt_deg=(pitch, roll), iron=head.iron)
    recorded = recorded + red_noise(rng, time.size, memory=memory, deviation=head.slow_deg)
    recorded = wrap360(recorded + rng.normal(0.0, head.noise_deg, time.size))
    share = (time - motion.time_s[0]) / np.ptp(motion.time_s) - 0.5
    clock = time + head.clock_s + head.drift_s * share
    return Posture(time, clock, depth, heading, recorded, (pitch, roll), (sensed[0], sensed[1]))


def ensembles(posture: Posture, *, looks_up: bool, velocity_m_s: Floats | None = None) -> Ensembles:
    """Build the record of a head by its clock; velocities are (n, m, 4), NaN where bad, or zeros in one cell."""
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
        correlation=np.full(cells, 110, dtype=np.uint8),
        echo=np.full(cells, 120, dtype=np.uint8),
        percent_good=np.where(np.arange(4) == 3, np.uint8(100), np.uint8(0)) * np.ones(cells, dtype=np.uint8),
    )


def setup(*, looks_up: bool, cells: int = 1, coordinates: str = "earth", serial: int = 7301) -> Setup:
    """Build the configuration of a lowered 300 kHz profiler."""
    return Setup(
        kilohertz=300, looks_up=looks_up, cells=cells, cell_m=8.0, blank_m=0.0, first_bin_m=8.6, pings=1,
        coordinates=coordinates, serial=serial,
    )  # fmt: skip


def encoded(posture: Posture, *, looks_up: bool = False, mirrored: bool = False) -> bytes:
    """Encode the PD0 file of a head, with all velocities 0; ``mirrored``: its roll has the opposite sign."""
    pitch, roll = posture.sensed_deg
    posture = replace(posture, sensed_deg=(pitch, -roll)) if mirrored else posture
    return adcp.encode(setup(looks_up=looks_up), ensembles(posture, looks_up=looks_up)).tobytes()


def mounted(
    heading_deg: Floats, tilt_deg: tuple[Floats, Floats], mount_deg: tuple[float, float, float]
) -> tuple[Floats, Floats, Floats]:
    """Compute heading (not wrapped), pitch and roll of a body mounted on the frame with a fixed rotation, degrees.

    Args:
        heading_deg: heading of the frame, (n,).
        tilt_deg: pitch, forward up, and roll, starboard down, of the frame, (n,) each.
        mount_deg: heading, pitch and roll of the body relative to the frame.
    """
    inner = Rotation.from_euler("ZYX", mount_deg, degrees=True)
    frame = Rotation.from_euler("ZYX", np.column_stack([heading_deg, *tilt_deg]), degrees=True)
    heading, pitch, roll = (frame * inner).as_euler("ZYX", degrees=True).T
    return np.unwrap(heading, period=360.0), pitch, roll


def read_through(heading_deg: Floats, series_deg: tuple[float, ...]) -> Floats:
    """Compute recorded headings by fixed-point iteration of a deviation series in the recorded heading, degrees."""
    a, b, c, d, e = series_deg
    recorded = np.array(heading_deg)
    for _ in range(60):
        turn = np.deg2rad(recorded)
        added = a + b * np.sin(turn) + c * np.cos(turn) + d * np.sin(2 * turn) + e * np.cos(2 * turn)
        recorded = heading_deg - added
    return recorded
