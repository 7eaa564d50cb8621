"""What the currents do to a mooring: blow-down by drag, tilt, and a heading locked to the sphere's wake.

The statics are those of a taut line: at every point the tangent of its lean is the drag above it over the net
buoyancy above it. The sphere leans little because only its own drag acts there (von Appen 2015, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sin

import numpy as np

from compasslib.demo import water as sea
from compasslib.demo.water import HOUR_S, Floats, Water, direction, red_noise, stream

SEAWATER_KG_M3 = 1027.0
SPHERE_DRAG_M2 = 0.9  # drag coefficient times area of the sphere with its gear
WIRE_DRAG_M = 1.7 * 0.008  # drag coefficient of a strumming wire times its diameter of 5/16 inch
WIRE_WEIGHT_N_M = 1.2  # in water, the glass floats along it included
SEGMENTS = 12
ITERATIONS = 5
STEEPEST_DEG = 9.9
NOMINAL_M = 100.0


@dataclass(frozen=True)
class Rig:
    """How a mooring is built and how its sphere hangs."""

    buoyancy_n: float  # net buoyancy of sphere and gear
    heading_offset_deg: float  # beam 3 from the direction towards which the water flows
    wobble_deg: float  # standard deviation of the heading about it at 25 cm/s
    rest_pitch_deg: float  # lean in still water, from how the instrument is clamped
    rest_roll_deg: float


@dataclass(frozen=True)
class Motion:
    """How the top of a mooring stands along the time axis of the water; the heading is magnetic and correct."""

    time_s: Floats  # (g,)
    sphere_depth_m: Floats  # (g,)
    heading_deg: Floats  # (g,) not wrapped, so that it can be interpolated
    pitch_deg: Floats  # (g,) forward up
    roll_deg: Floats  # (g,) starboard down


def make_motion(seed: int, name: str, rig: Rig, water: Water, *, declination_deg: float) -> Motion:
    """Simulate how the sphere moves.

    Args:
        declination_deg: east positive; headings are magnetic.
    """
    depth = blow_down(rig, water)
    flow = sea.velocity(water, water.time_s, depth)
    magnetic_deg = direction(flow) - declination_deg
    heading = wake_heading(
        stream(seed, name, "heading"),
        magnetic_deg + rig.heading_offset_deg,
        np.abs(flow),
        wobble_deg=rig.wobble_deg,
    )
    pitch, roll = _tilt(stream(seed, name, "tilt"), rig, np.abs(flow), magnetic_deg - heading)
    return Motion(water.time_s, depth + sea.sea_level(water.time_s), heading, pitch, roll)


def blow_down(rig: Rig, water: Water) -> Floats:
    """Compute the depth of the sphere along the water's time axis, metres below the mean surface, shape (g,)."""
    hours = water.time_s[::6]
    length = (water.water_depth_m - NOMINAL_M) / SEGMENTS
    along = length * (np.arange(SEGMENTS, dtype=float) + 0.5)
    net_n = rig.buoyancy_n - WIRE_WEIGHT_N_M * along
    depth = np.tile(NOMINAL_M + along, (hours.size, 1))
    upright = np.ones((hours.size, SEGMENTS))
    for _ in range(ITERATIONS):
        flow = sea.velocity(water, hours, depth)
        # Half of the newest slope: the full step overshoots where the line leans most.
        sphere = 0.5 * SEAWATER_KG_M3 * SPHERE_DRAG_M2 * np.abs(flow[:, :1]) * flow[:, :1]
        wire = 0.5 * SEAWATER_KG_M3 * WIRE_DRAG_M * length * np.abs(flow) * flow * upright**2
        drag = sphere + np.cumsum(wire, axis=1) - 0.5 * wire  # of all that is above
        upright = 0.5 * upright + 0.5 * (1.0 / np.hypot(1.0, np.abs(drag) / net_n))
        depth = water.water_depth_m - length * (np.cumsum(upright[:, ::-1], axis=1)[:, ::-1] - 0.5 * upright)
    return np.interp(water.time_s, hours, depth[:, 0] - 0.5 * length * upright[:, 0])


def wake_heading(rng: np.random.Generator, equilibrium_deg: Floats, speed_m_s: Floats, *, wobble_deg: float) -> Floats:
    """Simulate the heading of a body turned into its own wake, degrees, not wrapped, shape (g,).

    The restoring moment grows with the speed: at 25 cm/s the memory is three hours, in still water the body is free
    and drifts round the circle.

    Args:
        equilibrium_deg: heading at which the moment vanishes, (g,).
        wobble_deg: standard deviation about it at 25 cm/s.
    """
    pull = np.minimum(speed_m_s / 0.25, 2.5) * sea.STEP_S / (3 * HOUR_S)
    kick = rng.normal(0.0, np.deg2rad(wobble_deg) * np.sqrt(2 * sea.STEP_S / (3 * HOUR_S)), equilibrium_deg.size)
    equilibrium = np.deg2rad(equilibrium_deg)
    heading, path = float(equilibrium[0]), []
    for target, moment, push in zip(equilibrium.tolist(), pull.tolist(), kick.tolist(), strict=True):
        heading += push - moment * sin(heading - target)
        path.append(heading)
    return np.rad2deg(np.array(path))


def pressure(depth_m: Floats, latitude_deg: float) -> Floats:
    """Compute the pressure at a depth, dbar (Saunders 1981, J. Phys. Oceanogr. 11, 573, inverted)."""
    first = 1.0 - (5.92 + 5.25 * np.sin(np.deg2rad(latitude_deg)) ** 2) * 1e-3
    return np.asarray((first - np.sqrt(first**2 - 8.84e-6 * depth_m)) / 4.42e-6)


def _tilt(rng: np.random.Generator, rig: Rig, speed_m_s: Floats, relative_deg: Floats) -> tuple[Floats, Floats]:
    """Simulate pitch and roll: rest, the lean of the sphere downstream, and a wobble; never above STEEPEST_DEG."""
    drag_n = 0.5 * SEAWATER_KG_M3 * SPHERE_DRAG_M2 * speed_m_s**2
    lean_deg = np.rad2deg(np.arctan(drag_n / rig.buoyancy_n))
    relative = np.deg2rad(relative_deg)
    memory = 2 * HOUR_S / sea.STEP_S
    wobble = [red_noise(rng, speed_m_s.size, memory=memory, deviation=0.6) for _ in range(2)]
    pitch = rig.rest_pitch_deg - lean_deg * np.cos(relative) + wobble[0]
    roll = rig.rest_roll_deg + lean_deg * np.sin(relative) + wobble[1]
    # No instrument of the array ever leaned by ten degrees (von Appen 2015): the approach to it is smooth.
    shrink = (1.0 + (np.hypot(pitch, roll) / STEEPEST_DEG) ** 8) ** -0.125
    return pitch * shrink, roll * shrink
