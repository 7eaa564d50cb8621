"""Simulation of a boat that swings its compass, and of the records of compass, satellite receiver and speed log.

There is one sample per second. Steering varies about the course, wind causes leeway, and the current moves the boat;
the receiver filters the velocity over ground, and the compass, near iron, may lag or turn in its mount.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from compasslib.angles import wrap360
from compasslib.demo.compass import Iron, recorded_heading
from compasslib.demo.water import Complexes, Floats, direction, red_noise, red_vector, towards

FIELD_NT = (25000.0, 38000.0)
NO_IRON = Iron()
LEGS, CIRCLES, ONE_CIRCLE = "legs", "circles both ways", "circles one way"
PULLED = (25.0, 9.0)  # sector in which a card is pulled: half width, and width of its edge, degrees


@dataclass(frozen=True)
class Boat:
    """Manoeuvre of a boat and errors of its records."""

    plan: str = LEGS
    minutes: float = 25.0
    speed_kn: float = 5.0
    speeds_vary: bool = True
    wander_deg: float = 2.0  # standard deviation of the steering
    leeway_deg: float = 1.5  # standard deviation
    leeway_s: float = 40.0  # memory of the leeway
    water_kn: complex = 0.0  # current, east + i north
    filter_s: float = 0.0  # time constant of the receiver's filter
    lag_s: float = 0.0  # lag of the compass
    clock_s: float = 0.0  # clock of the compass minus that of the receiver
    iron: Iron = NO_IRON
    lobes: tuple[int, float, float] = (0, 0.0, 0.0)  # harmonic error: cycles, amplitude and phase in degrees
    slip_deg: float = 0.0  # of the mount
    slip_at: float = 0.5  # elapsed share of the swing at the slip
    hangs_deg: float = 0.0  # offset of the reading in one sector, where the card is pulled
    hangs_at_deg: float = 0.0
    astray: tuple[float, float, float] = (0.0, 0.0, 0.0)  # temporary offset, degrees, and shares elapsed at its ends
    log_scale: float = 0.0  # scale factor of the speed log; 0: no log


@dataclass(frozen=True)
class Passage:
    """Log of a swing, one sample per second, and the correct headings; (n,) each."""

    time_s: Floats
    compass_deg: Floats
    course_deg: Floats  # over ground, true north
    speed_kn: Floats
    water_speed_kn: Floats  # NaN without a log
    heading_deg: Floats  # correct, magnetic


def sail(rng: np.random.Generator, boat: Boat, declination_deg: float, start_s: float = 1.6e9) -> Passage:
    """Simulate the log of a swing that starts at a time in UTC seconds since 1970; the declination is positive east."""
    steered, speed = _plan(rng, boat)
    n = steered.size
    heading = steered + red_noise(rng, n, memory=20.0, deviation=boat.wander_deg)
    leeway = red_noise(rng, n, memory=boat.leeway_s, deviation=boat.leeway_deg)
    through = speed * towards(heading + leeway + declination_deg)
    ground = _filtered(through + boat.water_kn + red_vector(rng, n, memory=10.0, deviation=0.08), boat.filter_s)
    logged: Floats = np.full(n, np.nan)
    if boat.log_scale:
        logged = np.round(boat.log_scale * speed + red_noise(rng, n, memory=5.0, deviation=0.1), 1)
    time: Floats = start_s + np.arange(n, dtype=float)
    reading, course = wrap360(np.rint(_read(rng, boat, heading))), wrap360(np.rint(direction(ground)))
    return Passage(time, reading, course, np.round(np.abs(ground), 1), logged, wrap360(heading))


def _plan(rng: np.random.Generator, boat: Boat) -> tuple[Floats, Floats]:
    """Draw the steered heading, degrees, not wrapped, and the speed through water, knots."""
    n = int(60.0 * boat.minutes)
    if boat.plan == LEGS:
        return _legs(rng, boat, n)
    sense = np.where(np.arange(n) < n // 2, 1.0, -1.0) if boat.plan == CIRCLES else np.ones(n)
    rate = rng.uniform(1.2, 1.6) * 360.0 / (n / 2.0)
    along = np.sin(2.0 * np.pi * np.arange(n) / rng.uniform(150.0, 400.0) + rng.uniform(0.0, 6.0))
    speed = boat.speed_kn * (1.0 + boat.speeds_vary * 0.35 * along)
    return rng.uniform(0.0, 360.0) + np.cumsum(rate * sense), speed


def _legs(rng: np.random.Generator, boat: Boat, n: int) -> tuple[Floats, Floats]:
    count = int(rng.integers(10, 17))
    stay = n // count
    at, headings, speeds = rng.uniform(0.0, 360.0), [], []
    for leg in rng.permutation(count) * (360.0 / count) + at:
        off = (leg - at + 180.0) % 360.0 - 180.0
        seconds = max(int(abs(off) / rng.uniform(1.5, 4.0)), 1)
        turning, steady = np.linspace(at, at + off, seconds), np.full(stay - min(seconds, stay // 2), at + off)
        headings.append(np.append(turning, steady))
        speeds.append(np.full(headings[-1].size, boat.speed_kn * (1.0 + boat.speeds_vary * rng.uniform(-0.4, 0.4))))
        at += off
    return np.concatenate(headings), _filtered(np.concatenate(speeds), 20.0).real


def _read(rng: np.random.Generator, boat: Boat, heading: Floats) -> Floats:
    n, seconds = heading.size, np.arange(heading.size)
    late = np.interp(seconds - boat.lag_s - boat.clock_s, seconds, heading)
    level = np.zeros(n)
    reading = recorded_heading(FIELD_NT, late, tilt_deg=(level, level), iron=boat.iron)
    cycles, size, phase = boat.lobes
    reading = reading + size * np.sin(np.deg2rad(cycles * reading + phase))
    reading = reading + boat.slip_deg * (seconds >= boat.slip_at * n)
    off, begin, end = boat.astray
    reading = reading + off * ((seconds >= begin * n) & (seconds < end * n))
    away = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(reading - boat.hangs_at_deg))))
    reading = reading + boat.hangs_deg / (1.0 + np.exp((np.abs(away) - PULLED[0]) / (PULLED[1] / 3.0)))
    return np.asarray(reading + rng.normal(0.0, 0.5, n))


def _filtered(x: Floats | Complexes, seconds: float) -> Complexes:
    """Apply a first-order low-pass filter with a time constant in seconds; 0: no filter."""
    keep = float(np.exp(-1.0 / seconds)) if seconds else 0.0
    filtered, _ = lfilter([1.0 - keep], [1.0, -keep], x, zi=[keep * x[0]])
    return np.asarray(filtered, dtype=complex)
