"""A McLane profiler with a Falmouth 3D-ACM that climbs a mooring's wire twice a day, and what the meter logs.

A genuine profiler logs its whole way at 2 Hz, some 600 MB a mooring and year. Here the ACM is switched on for the
uppermost 60 m of each profile only, next to the bumper under the sphere, and logs four minutes at 1 Hz: 20 MB. While
the wire leans too much the profiler is stuck at depth for days and logs one minute there.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isnan, nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib.demo import water as sea
from compasslib.demo.compass import Field
from compasslib.demo.mmp import Scans
from compasslib.demo.mooring import NOMINAL_M, Motion, pressure
from compasslib.demo.series import HOUR_S, Complexes, Floats, circle, clockwise, direction
from compasslib.demo.water import Water

SPEED_M_S = 0.25
BUMPER_M = 2.0  # below the sphere
LOGGED_S, DWELL_S, STUCK_S = 240, 10, 60
STICKS_M, FREES_M = 100.0, 25.0  # blow-down at which it sticks, and below which it comes free
LEVER_M = 0.43  # of the paths about the wire
ENGINEERING_S = 10


@dataclass(frozen=True)
class Profiler:
    """When a profiler starts and how deep it goes."""

    first_s: float  # seconds from deployment to the first profile's start, at the bottom
    bottom_m: float
    binary: bool  # files as logged, not unpacked
    serial: int


@dataclass(frozen=True)
class Plan:
    """Every profile of the deployment, (p,) each."""

    number: NDArray[np.int64]
    ascending: NDArray[np.bool_]
    begin_s: Floats  # first scan
    scans: NDArray[np.int64]
    top_s: Floats  # at the bumper: arrival, or departure
    stuck_m: Floats  # depth where it is stuck, NaN where it runs


def plan(rng: np.random.Generator, profiler: Profiler, motion: Motion, span_s: tuple[float, float]) -> Plan:
    """Return the profiles: up with odd numbers, down with even ones, none that passes the top while it is stuck.

    Args:
        motion: how the sphere moves; its depth decides where the profiler sticks.
        span_s: the deployment, UTC seconds since 1970.
    """
    start = np.arange(span_s[0] + profiler.first_s, span_s[1] - 4 * HOUR_S, 12 * HOUR_S)
    number = np.arange(start.size) + 1
    ascending = number % 2 == 1
    way_s = (profiler.bottom_m - NOMINAL_M - BUMPER_M) / SPEED_M_S
    top = np.rint(start + np.where(ascending, way_s, 30.0))
    blown = np.interp(top, motion.time_s, motion.sphere_depth_m) - NOMINAL_M
    stuck = _stuck_depths(rng, blown, profiler.bottom_m)
    running = np.isnan(stuck)
    before = np.where(ascending, LOGGED_S - DWELL_S, DWELL_S)
    begin = np.where(running, top - before, np.rint(start + 120.0))
    return Plan(number, ascending, begin, np.where(running, LOGGED_S, STUCK_S), top, stuck)


def log(rng: np.random.Generator, schedule: Plan, water: Water, motion: Motion, *, field: Field) -> Scans:
    """Return what the current meter logs."""
    count = schedule.number.size
    profile = np.repeat(np.arange(count), schedule.scans)
    first = np.cumsum(schedule.scans) - schedule.scans
    time = schedule.begin_s[profile] + np.arange(profile.size) - first[profile]
    sphere = np.interp(time, motion.time_s, motion.sphere_depth_m)
    depth, sinking = _position(schedule, profile, time, sphere)
    flow = sea.velocity(water, time, depth)
    flow = clockwise(flow, -field.at(time)[0])
    heading, turning = _swing(rng, flow, time, profile, first)
    compass = _compass(rng, heading, profile, field.at(time))
    paths = _paths(rng, flow, heading, sinking=sinking, turning=turning, ascending=schedule.ascending[profile])
    reading = np.column_stack([*compass, *paths])
    # The first scan after switching on is aliased.
    reading[first] += rng.normal(0.0, (30.0, 3.0, 3.0, 0.0, 0.0, 0.0, 2.0, 2.0, 2.0, 2.0), (count, 10))
    reading[:, 0] = circle(np.round(reading[:, 0], 2))
    on = schedule.begin_s - rng.integers(5, 11, count)
    off = schedule.begin_s + schedule.scans
    return Scans(schedule.number, schedule.scans, on.astype(int), off.astype(int), time.astype(int), reading)


def write_engineering(path: Path, schedule: Plan, motion: Motion, latitude_deg: float) -> None:
    """Write the profiler's own table of time and pressure around every logged stretch."""
    steps = 5 + schedule.scans // ENGINEERING_S
    profile = np.repeat(np.arange(steps.size), steps)
    position = np.arange(profile.size) - (np.cumsum(steps) - steps)[profile]
    time = schedule.begin_s[profile] + ENGINEERING_S * (position - 2.0)
    depth = _position(schedule, profile, time, np.interp(time, motion.time_s, motion.sphere_depth_m))[0]
    stamps = np.datetime_as_string(time.astype("datetime64[s]")).tolist()
    pairs = zip(stamps, pressure(depth, latitude_deg).tolist(), strict=True)
    path.write_text("time_utc,pressure_dbar\n" + "".join(f"{stamp}Z,{dbar:.2f}\n" for stamp, dbar in pairs))


def _stuck_depths(rng: np.random.Generator, blown_m: Floats, bottom_m: float) -> Floats:
    """Return the depth at which each profile finds the profiler jammed, NaN where it is free."""
    drawn = rng.uniform(0.45, 0.85, blown_m.size) * bottom_m
    depth, stuck = nan, []
    for blown, here in zip(blown_m.tolist(), drawn.tolist(), strict=True):
        if isnan(depth) and blown > STICKS_M:
            depth = here
        elif blown < FREES_M:
            depth = nan
        stuck.append(depth)
    return np.array(stuck)


def _position(schedule: Plan, profile: NDArray[np.intp], time_s: Floats, sphere_m: Floats) -> tuple[Floats, Floats]:
    """Return depth in metres and its rate of change in m/s."""
    away = np.where(schedule.ascending, -1.0, 1.0)[profile]
    since = away * (time_s - schedule.top_s[profile])
    running = np.isnan(schedule.stuck_m)[profile]
    below = BUMPER_M + SPEED_M_S * np.maximum(since, 0.0)
    depth = np.where(running, sphere_m + below, schedule.stuck_m[profile])
    return depth, np.where(running & (since > 0), SPEED_M_S * away, 0.0)


def _swing(
    rng: np.random.Generator, flow: Complexes, time_s: Floats, profile: NDArray[np.intp], first: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Return the heading, into the flow and swinging about it, degrees, and its rate of change, radians a second."""
    mean = np.add.reduceat(flow, first)
    middle = direction(mean) + 180.0 + rng.normal(0.0, 15.0, first.size)
    angular = 2 * np.pi / rng.uniform(60.0, 100.0, first.size)
    amplitude, start = np.abs(rng.normal(4.0, 1.5, first.size)), rng.uniform(0.0, 2 * np.pi, first.size)
    phase = angular[profile] * (time_s - time_s[first][profile]) + start[profile]
    rate = np.deg2rad(amplitude * angular)[profile] * np.cos(phase)
    return middle[profile] + amplitude[profile] * np.sin(phase), rate


def _compass(
    rng: np.random.Generator, heading_deg: Floats, profile: NDArray[np.intp], field: tuple[Floats, Floats, Floats]
) -> tuple[Floats, ...]:
    """Return heading, tilts in degrees and the field's direction cosines, which obey the logger's levelling rule.

    x = HX cos TX - HZ sin TX, y = HY cos TY - HZ sin TY, heading = atan2(y, x), with z upwards.
    """
    steady = rng.normal(0.0, 0.35, profile[-1] + 1)[profile]
    heading = circle(heading_deg + steady + rng.normal(0.0, 0.35, profile.size))
    tilts = [
        np.round(rng.normal(mean, 0.8, profile[-1] + 1)[profile] + rng.normal(0.0, 0.4, profile.size), 2)
        for mean in (1.6, -0.9)
    ]
    turn, (tx, ty) = np.deg2rad(heading), np.deg2rad(tilts)
    flat = field[1] / field[2]
    hx = (flat * np.cos(turn) - np.sin(tx)) / np.cos(tx)
    hy = (flat * np.sin(turn) - np.sin(ty)) / np.cos(ty)
    length = np.sqrt(hx**2 + hy**2 + 1.0)
    return heading, tilts[0], tilts[1], hx / length, hy / length, -1.0 / length


def _paths(
    rng: np.random.Generator,
    flow: Complexes,
    heading_deg: Floats,
    *,
    sinking: Floats,
    turning: Floats,
    ascending: NDArray[np.bool_],
) -> tuple[Floats, ...]:
    """Return VPAB, VPCD, VPEF, VPGH in cm/s of the magnetic flow, the meter's own motion in them."""
    frame = flow * np.exp(-1j * np.deg2rad(90.0 - heading_deg))
    noise = rng.normal(0.0, 0.6, (4, heading_deg.size))
    x, y = 100 * frame.real, 100 * (frame.imag + LEVER_M * turning)
    # A meter that sinks sees the water rise past it.
    z = 100 * sinking
    upper, lower = (x + z) / np.sqrt(2), (x - z) / np.sqrt(2)
    # One of the two inclined paths lies in the wake of the strut, the upper one on the way up.
    wake = 0.6, rng.normal(0.0, 2.0, heading_deg.size)
    upper = np.where(ascending, wake[0] * upper + wake[1], upper)
    lower = np.where(ascending, lower, wake[0] * lower + wake[1])
    return (y - x) / np.sqrt(2) + noise[0], upper + noise[1], (-x - y) / np.sqrt(2) + noise[2], lower + noise[3]
