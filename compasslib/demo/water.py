"""Simulation of currents of the East Greenland shelf and slope, and of the motion of a mooring in them.

A mean along-slope flow, tides, inertial oscillations, red noise and passing cyclones, each with its own vertical
structure (orders of magnitude of von Appen 2014b); and layers that decorrelate with distance and over hours to
months, compared with real profiles in docs/background/method.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from math import sin
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.types import DAY_S, HOUR_S, Complexes, Floats


def stream(seed: int, mooring: str, purpose: str) -> np.random.Generator:
    """Seed the random generator of one purpose on one mooring, independent of all other simulated quantities."""
    return np.random.default_rng([seed, int.from_bytes(f"{mooring}/{purpose}".encode(), "big")])


def red_noise(rng: np.random.Generator, count: int, *, memory: float, deviation: float) -> Floats:
    """Draw a stationary first-order autoregressive series, (count,), with an e-folding time of ``memory`` steps."""
    keep = float(np.exp(-1.0 / memory))
    kicks = rng.normal(0.0, deviation * np.sqrt(1.0 - keep**2), count)
    kicks[0] = rng.normal(0.0, deviation)
    return np.fromiter(accumulate(kicks.tolist(), lambda state, kick: keep * state + kick), float, count)


def red_vector(rng: np.random.Generator, count: int, *, memory: float, deviation: float) -> Complexes:
    """Draw a vector series, east + i north, (count,), with independent red-noise components."""
    east = red_noise(rng, count, memory=memory, deviation=deviation)
    return east + 1j * red_noise(rng, count, memory=memory, deviation=deviation)


def white_vector(rng: np.random.Generator, shape: int | tuple[int, ...], deviation: float) -> Complexes:
    """Draw vectors, east + i north, with independent normal components."""
    return rng.normal(0.0, deviation, shape) + 1j * rng.normal(0.0, deviation, shape)


def towards(direction_deg: ArrayLike) -> Complexes:
    """Compute the unit vector east + i north of a direction, degrees clockwise from north."""
    return np.asarray(1j * np.conj(angles.phasor(direction_deg)))


def direction(velocity: Complexes) -> Floats:
    """Compute the direction towards which east + i north points, degrees clockwise from north in [0, 360)."""
    return angles.direction(velocity.real, velocity.imag)


def clockwise(velocity: ArrayLike, by_deg: ArrayLike) -> Complexes:
    """Rotate vectors, east + i north, clockwise by angles in degrees that broadcast with them."""
    return np.asarray(velocity * np.conj(angles.phasor(by_deg)))


def calendar(time_s: NDArray[np.int64]) -> tuple[NDArray[np.int64], ...]:
    """Convert whole UTC seconds since 1970 to year, month, day, hour, minute and second."""
    days = time_s.astype("datetime64[s]").astype("datetime64[D]")
    months, second = days.astype("datetime64[M]"), time_s % 86400
    month, day = months.astype(np.int64), (days - months.astype("datetime64[D]")).astype(np.int64)
    return month // 12 + 1970, month % 12 + 1, day + 1, second // 3600, second // 60 % 60, second % 60


STEP_S = 600.0
TIDES = ((12.4206, 0.55), (12.0000, 0.20), (23.9345, 0.25))  # M2, S2, K1: period in hours, share of the speed


@dataclass(frozen=True)
class Climate:
    """Statistics of the currents at one place; speeds in m/s, direction true and towards."""

    mean_m_s: float
    along_deg: float = 238.0
    tide_m_s: float = 0.10
    inertial_m_s: float = 0.04
    red_m_s: float = 0.07
    cyclone_m_s: float = 0.0  # median peak speed of a passing cyclone
    shear_m_s: float = 0.036  # rms difference of one component at GAP_M
    veer_deg_100m: float = 4.0  # rms of the slow turning of the current with depth


@dataclass(frozen=True)
class Layers:
    """Differences over depth as vertical waves, with time series of their cosine and sine components."""

    wavenumber: Floats  # (k,) rad/m
    cosine: Complexes  # (k, g) m/s
    sine: Complexes  # (k, g)

    def times(self, factor: Floats) -> Layers:
        """Scale by a factor at each time, (g,)."""
        return Layers(self.wavenumber, self.cosine * factor, self.sine * factor)


@dataclass(frozen=True)
class Water:
    """Currents at one mooring: a time series for each vertical structure, east + i north, m/s."""

    time_s: Floats  # (g,) UTC seconds since 1970, every STEP_S
    surface: Complexes  # (g,) decays downwards
    column: Complexes  # (g,) the same at every depth
    wave: Complexes  # (g,) reverses between surface and bottom
    cyclone: Complexes  # (g,) strongest at the bottom
    layers: Layers
    veer_deg_m: Floats  # (g,) clockwise with depth
    water_depth_m: float


def make_water(
    seed: int, name: str, climate: Climate, *, site: tuple[float, float], span_s: tuple[float, float]
) -> Water:
    """Simulate the currents of one mooring over a span of time; ``site``: latitude, and water depth in metres."""
    latitude_deg, water_depth_m = site
    time_s = np.arange(span_s[0], span_s[1] + STEP_S, STEP_S)
    days = 50 * HOUR_S / STEP_S
    along = towards(climate.along_deg)
    slow, baroclinic, veer = (stream(seed, name, purpose) for purpose in ("red", "wave", "veer"))
    # Fluctuations follow the slope: twice as large along it as across.
    along_red = red_noise(slow, time_s.size, memory=days, deviation=1.4 * climate.red_m_s)
    across_red = red_noise(slow, time_s.size, memory=days, deviation=0.7 * climate.red_m_s)
    red = along * (along_red + 1j * across_red)
    season = 1.0 + 0.25 * np.cos(2 * np.pi * (time_s / DAY_S - 15.0) / 365.25)
    rng = stream(seed, name, "tide")
    total = np.zeros(time_s.size, dtype=complex)
    for period_h, share in TIDES:
        phase = 2 * np.pi * time_s / (period_h * HOUR_S) + rng.uniform(0.0, 2 * np.pi)
        ellipse = np.cos(phase) + 1j * rng.uniform(-0.5, 0.5) * np.sin(phase)
        total += climate.tide_m_s * share * ellipse * towards(climate.along_deg + rng.normal(0.0, 20.0))
    # Clockwise rotation at the Coriolis frequency, with an amplitude that decorrelates in three days.
    rng = stream(seed, name, "inertial")
    amplitude = red_vector(rng, time_s.size, memory=3 * DAY_S / STEP_S, deviation=climate.inertial_m_s / np.sqrt(2.0))
    turned_deg = 720.0 * angles.sin_cos(latitude_deg)[0] * (time_s - time_s[0]) / 86164.1  # a sidereal day
    return Water(
        time_s=time_s,
        surface=along * climate.mean_m_s * season + clockwise(amplitude, turned_deg),
        column=red + total,
        wave=red_vector(baroclinic, time_s.size, memory=40 * HOUR_S / STEP_S, deviation=0.4 * climate.red_m_s),
        cyclone=along * _cyclones(stream(seed, name, "cyclone"), climate.cyclone_m_s, time_s),
        layers=_layers(stream(seed, name, "layers"), climate.shear_m_s, time_s),
        veer_deg_m=red_noise(veer, time_s.size, memory=30 * DAY_S / STEP_S, deviation=0.01 * climate.veer_deg_100m),
        water_depth_m=water_depth_m,
    )


def velocity(water: Water, time_s: Floats, depth_m: Floats) -> Complexes:
    """Compute the current, true east + i north in m/s, with the shape of ``depth_m``, (n,) or (n, m, ...)."""
    lift = (slice(None), *(None,) * (depth_m.ndim - 1))

    def at(series: NDArray[Any]) -> NDArray[Any]:
        return np.interp(time_s, water.time_s, series)[lift]

    relative = depth_m / water.water_depth_m
    flow = at(water.surface) * np.exp(-depth_m / 600.0) + at(water.column)
    flow = flow + at(water.wave) * np.cos(np.pi * relative) + at(water.cyclone) * (0.75 + 0.5 * relative)
    for wavenumber, cosine, sine in zip(water.layers.wavenumber, water.layers.cosine, water.layers.sine, strict=True):
        flow += at(cosine) * np.cos(wavenumber * depth_m) + at(sine) * np.sin(wavenumber * depth_m)
    return clockwise(flow, at(water.veer_deg_m) * (depth_m - 100.0))


def sea_level(time_s: ArrayLike) -> Floats:
    """Compute the tidal elevation of the surface, metres."""
    turns = 2 * np.pi * np.asarray(time_s, dtype=float) / HOUR_S
    return np.asarray(0.7 * np.cos(turns / TIDES[0][0]) + 0.25 * np.cos(turns / TIDES[1][0]))


def _layers(rng: np.random.Generator, shear_m_s: float, time_s: Floats) -> Layers:
    """Draw layers of 12 to 160 m with a given rms difference of one component, m/s, over 14 m, about a sphere's gap."""
    gap_m, edges = 14.0, np.geomspace(12.0, 160.0, 9)
    lengths = np.exp(rng.uniform(np.log(edges[:-1]), np.log(edges[1:])))
    wavenumber = 2.0 * np.pi / lengths
    variance = lengths**1.5  # larger differences at larger distances
    variance *= shear_m_s**2 / np.sum(2.0 * variance * (1.0 - np.cos(wavenumber * gap_m)))
    courses = [
        [_course(rng, time_s, 6.0 * length / (2.0 * gap_m)) * np.sqrt(size) for _ in range(2)]  # 6 h across the gap
        for length, size in zip(lengths.tolist(), variance.tolist(), strict=True)
    ]
    return Layers(wavenumber, *(np.stack(each) for each in zip(*courses, strict=True)))


def _course(rng: np.random.Generator, time_s: Floats, memory_h: float) -> Complexes:
    """Draw the time series of a layer, with unit variance in each component.

    The shares of hours, tides of drifting phase and slow changes have a memory each; that of hours is proportional to
    the wavelength.
    """
    parts = ((0.65, memory_h * HOUR_S), (0.27, 5 * DAY_S), (0.08, 12 * DAY_S))
    hours, tide, slow = (
        red_vector(rng, time_s.size, memory=memory_s / STEP_S, deviation=np.sqrt(share)) for share, memory_s in parts
    )
    return hours + clockwise(tide, 360.0 * (time_s - time_s[0]) / (TIDES[0][0] * HOUR_S)) + slow


def _cyclones(rng: np.random.Generator, speed_m_s: float, time_s: Floats) -> Complexes:
    """Draw velocity pulses of passing cyclones, along-slope + i to the left of it, (g,)."""
    total = np.zeros(time_s.size, dtype=complex)
    passage_s = time_s[0] + rng.exponential(3 * DAY_S)
    while passage_s < time_s[-1]:
        peak, half_s, swirl = speed_m_s * rng.lognormal(0.0, 0.3), rng.uniform(9, 16) * HOUR_S, rng.normal(0.25, 0.25)
        near = slice(*np.searchsorted(time_s, (passage_s - 5 * half_s, passage_s + 5 * half_s)))
        phase = (time_s[near] - passage_s) / half_s
        # The core passes with the flow; before and after it the circulation points off and on shore.
        total[near] += peak * np.exp(-(phase**2) / 2) * (1.0 + 1j * swirl * phase)
        passage_s += 2 * DAY_S + rng.exponential(3 * DAY_S)
    return total


SEAWATER_KG_M3 = 1027.0
SPHERE_DRAG_M2 = 0.9  # drag coefficient times area of the sphere with its gear
NOMINAL_M = 100.0


@dataclass(frozen=True)
class Rig:
    """Construction of a mooring and attitude of its sphere."""

    buoyancy_n: float  # net buoyancy of sphere and gear
    heading_offset_deg: float  # beam 3 from the direction towards which the water flows
    wobble_deg: float  # standard deviation of the heading about its equilibrium at 25 cm/s
    rest_pitch_deg: float  # tilt in still water, due to the clamping of the instrument
    rest_roll_deg: float
    wire_drag_m: float = 1.7 * 0.008  # drag coefficient of a strumming wire times its diameter of 5/16 inch
    wire_weight_n_m: float = 1.2  # in water, including the glass floats along it


@dataclass(frozen=True)
class Motion:
    """Depth and attitude of the top of a mooring on the time axis of the water; headings are correct and magnetic."""

    time_s: Floats  # (g,)
    sphere_depth_m: Floats  # (g,)
    heading_deg: Floats  # (g,) unwrapped for interpolation
    pitch_deg: Floats  # (g,) forward up
    roll_deg: Floats  # (g,) starboard down


def make_motion(seed: int, name: str, rig: Rig, water: Water, *, declination_deg: float) -> Motion:
    """Simulate depth, magnetic heading and tilt of the sphere."""
    depth = blow_down(rig, water)
    flow = velocity(water, water.time_s, depth)
    magnetic_deg = direction(flow) - declination_deg
    heading = wake_heading(
        stream(seed, name, "heading"), magnetic_deg + rig.heading_offset_deg, np.abs(flow), wobble_deg=rig.wobble_deg
    )
    pitch, roll = _tilt(stream(seed, name, "tilt"), rig, np.abs(flow), magnetic_deg - heading)
    return Motion(water.time_s, depth + sea_level(water.time_s), heading, pitch, roll)


def blow_down(rig: Rig, water: Water) -> Floats:
    """Compute the depth of the sphere along the water's time axis, metres below the mean surface, shape (g,)."""
    hours, segments = water.time_s[::6], 12
    length = (water.water_depth_m - NOMINAL_M) / segments
    along = length * (np.arange(segments, dtype=float) + 0.5)
    net_n = rig.buoyancy_n - rig.wire_weight_n_m * along
    depth = np.tile(NOMINAL_M + along, (hours.size, 1))
    upright = np.ones((hours.size, segments))
    for _ in range(5):
        flow = velocity(water, hours, depth)
        # Only half of the step to the new slope, as the full step overshoots where the line leans most.
        sphere = 0.5 * SEAWATER_KG_M3 * SPHERE_DRAG_M2 * np.abs(flow[:, :1]) * flow[:, :1]
        wire = 0.5 * SEAWATER_KG_M3 * rig.wire_drag_m * length * np.abs(flow) * flow * upright**2
        drag = sphere + np.cumsum(wire, axis=1) - 0.5 * wire  # of everything above
        upright = 0.5 * upright + 0.5 * (1.0 / np.hypot(1.0, np.abs(drag) / net_n))
        depth = water.water_depth_m - length * (np.cumsum(upright[:, ::-1], axis=1)[:, ::-1] - 0.5 * upright)
    return np.interp(water.time_s, hours, depth[:, 0] - 0.5 * length * upright[:, 0])


def wake_heading(rng: np.random.Generator, equilibrium_deg: Floats, speed_m_s: Floats, *, wobble_deg: float) -> Floats:
    """Simulate the heading of a body aligned by its wake, degrees, unwrapped, shape (g,).

    The moment that restores the equilibrium increases with speed: at 25 cm/s the memory is three hours and the standard
    deviation ``wobble_deg``; in still water the heading is a random walk.
    """
    pull = np.minimum(speed_m_s / 0.25, 2.5) * STEP_S / (3 * HOUR_S)
    kick = rng.normal(0.0, np.deg2rad(wobble_deg) * np.sqrt(2 * STEP_S / (3 * HOUR_S)), equilibrium_deg.size)
    equilibrium = np.deg2rad(equilibrium_deg)
    heading, path = float(equilibrium[0]), []
    for target, moment, push in zip(equilibrium.tolist(), pull.tolist(), kick.tolist(), strict=True):
        heading += push - moment * sin(heading - target)
        path.append(heading)
    return np.rad2deg(np.array(path))


def pressure(depth_m: Floats, latitude_deg: float) -> Floats:
    """Compute the pressure at a depth, dbar (Saunders 1981, J. Phys. Oceanogr. 11, 573, inverted)."""
    first = 1.0 - (5.92 + 5.25 * angles.sin_cos(latitude_deg)[0] ** 2) * 1e-3
    return np.asarray((first - np.sqrt(first**2 - 8.84e-6 * depth_m)) / 4.42e-6)


def _tilt(rng: np.random.Generator, rig: Rig, speed_m_s: Floats, relative_deg: Floats) -> tuple[Floats, Floats]:
    """Simulate pitch and roll: tilt at rest, downstream lean of the sphere, and wobble."""
    drag_n = 0.5 * SEAWATER_KG_M3 * SPHERE_DRAG_M2 * speed_m_s**2
    lean_deg = np.rad2deg(np.arctan(drag_n / rig.buoyancy_n))
    sine, cosine = angles.sin_cos(relative_deg)
    wobble = [red_noise(rng, speed_m_s.size, memory=2 * HOUR_S / STEP_S, deviation=0.6) for _ in range(2)]
    pitch = rig.rest_pitch_deg - lean_deg * cosine + wobble[0]
    roll = rig.rest_roll_deg + lean_deg * sine + wobble[1]
    # No instrument of the array tilted by ten degrees (von Appen 2015), which is therefore a smooth limit.
    shrink = (1.0 + (np.hypot(pitch, roll) / 9.9) ** 8) ** -0.125
    return pitch * shrink, roll * shrink
