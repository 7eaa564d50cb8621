"""Simulated currents: Matérn processes, eddies, tides, inertial packets, fronts, and random waves over depth.

None of them is a first-order process, and waves are not tied to layers: differences over depth are 160 waves in depth
and time with wavenumbers from Student's t distribution, which give the field a Matérn covariance.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.proof.world.scene import DAY_S, HOUR_S, Complexes, Floats, Scene, towards, turned
from compasslib.demo.compass import earth_field

WAVES = 160
CELLS, CELL_M, FIRST_M = 8, 2.0, 3.5
GAP_M = 14.0  # distance for which the shear is given
TIDES_H = {"M2": (12.4206, 1.0), "S2": (12.0, 0.4), "N2": (12.6583, 0.2), "K1": (23.9345, 0.5), "O1": (25.8193, 0.35)}
SUBSTEPS = 4  # per time step in the rotation of the sphere
STEEPEST_DEG = 12.0
DEEP_M = 60.0  # instruments that are not deeper have no blow-down


@dataclass(frozen=True)
class Weather:
    """Requested properties of simulated conditions."""

    hours: int = 8800
    wide: bool = False
    noise: float = 1.0
    veer_deg: float = 0.8  # rms of the slow veer between the two instruments
    spinning: bool = False  # whether the sphere turns independently of the current
    battery: str = "knee"  # knee, line, change


@dataclass(frozen=True, eq=False)
class Water:
    """True currents, east + i north in m/s, in the bins of the affected instrument and at the reference."""

    time_s: Floats  # (n,)
    flow: Complexes  # (n, m)
    lower: Complexes  # (n,)
    range_m: Floats  # (m,)
    place: tuple[float, float, float]
    looks_up: bool = True
    below_m: float = 10.0
    depth_m: float = 100.0


def make(rng: np.random.Generator, weather: Weather) -> Scene:
    """Simulate a mooring in this water."""
    time = 1.2e9 + DAY_S * int(rng.integers(0, 4000)) + HOUR_S * np.arange(weather.hours)
    place = (float(rng.uniform(48.0, 70.0)), float(rng.uniform(-50.0, 10.0)), float(rng.uniform(250.0, 900.0)))
    column = _column(rng, time, place[0], wide=weather.wide)
    below, ranges = float(rng.uniform(7.0, 12.0)), FIRST_M + CELL_M * np.arange(CELLS)
    heights = np.concatenate([ranges, [-below]])
    shear = _shear(rng, time, heights, weather.noise * rng.uniform(0.02, 0.04))
    shear *= (0.7 + 0.3 * np.abs(column) / np.abs(column).mean())[:, None]
    flow = column[:, None] + shear
    veer = weather.veer_deg * matern(rng, time, rng.uniform(15.0, 60.0) * DAY_S)
    water = Water(time, flow[:, :-1], turned(flow[:, -1], veer), ranges, place, below_m=below)
    return settled(rng, water, weather, flow[:, 0])


def settled(rng: np.random.Generator, water: Water, weather: Weather, near: Complexes) -> Scene:
    """Simulate the motion of the sphere in given currents, and return the scene.

    Args:
        near: current at the sphere, (n,), without instrument noise.
    """
    time = water.time_s
    declination, horizontal, vertical = earth(time, water.place)
    speed, way, step = np.abs(near), towards(near) - declination, float(np.median(np.diff(time)))
    heading = _spinning(rng, time) if weather.spinning else _wake(rng, way, speed, step)
    pitch, roll = _lean(rng, time, speed, way - heading)
    blown = 160.0 * rng.uniform(0.2, 1.0) * speed**2 * (water.depth_m > DEEP_M)
    depth = water.depth_m + blown + 0.8 * np.cos(time / 7118.0)
    warm = temperature(rng, time, depth)
    return Scene(
        time, heading, pitch, roll, depth, warm, supply(rng, warm, weather.battery), water.flow, water.lower,
        declination, horizontal, vertical, water.range_m, water.place, water.looks_up, water.below_m, step,
    )  # fmt: skip


def earth(time_s: Floats, place: tuple[float, float, float]) -> tuple[Floats, Floats, Floats]:
    """Compute declination, horizontal and vertical field of the IGRF, degrees and nT, (n,) each."""
    return earth_field(place[0], place[1], (float(time_s[0]), float(time_s[-1]) + DAY_S)).at(time_s)


def matern(rng: np.random.Generator, time_s: Floats, memory_s: float, smooth: float = 1.5) -> Floats:
    """Draw a series with a Matérn covariance and unit standard deviation, (n,); ``smooth`` 0.5 is of first order."""
    count = 2 * time_s.size
    frequency = 2.0 * np.pi * np.fft.rfftfreq(count, float(np.median(np.diff(time_s))))
    size = (2.0 * smooth / memory_s**2 + frequency**2) ** (-0.5 * (smooth + 0.5))
    drawn = rng.normal(size=(2, size.size))
    series = np.fft.irfft(size * (drawn[0] + 1j * drawn[1]), count)
    scale = np.sqrt(2.0 * (size[0] ** 2 + 2.0 * np.sum(size[1:] ** 2))) / count
    return np.asarray(series[: time_s.size] / scale)


def temperature(rng: np.random.Generator, time_s: Floats, depth_m: Floats) -> Floats:
    """Simulate the water temperature, °C, (n,): a skewed seasonal cycle, weather, fronts, and blow-down."""
    season = 2.0 * np.pi * (time_s / (365.25 * DAY_S) + rng.uniform())
    front = np.tanh(matern(rng, time_s, rng.uniform(8.0, 25.0) * DAY_S) / 0.3)
    fast = matern(rng, time_s, 8.0 * HOUR_S)
    wave = np.cos(season) + 0.3 * np.cos(2.0 * season + 0.8)
    return np.asarray(5.0 + 1.4 * wave + 0.4 * front + 0.15 * fast - 0.004 * (depth_m - depth_m.mean()))


def supply(rng: np.random.Generator, temperature_c: Floats, battery: str) -> Floats:
    """Simulate the supply voltage in counts, (n,): discharge with a knee, linear, or with a change of battery."""
    used, drain = np.linspace(0.0, 1.0, temperature_c.size), rng.uniform(12.0, 22.0)
    if battery == "line":
        return np.asarray(165.0 - drain * used)
    if battery == "change":
        begin = rng.uniform(0.35, 0.7)
        used = np.where(used < begin, used / begin, (used - begin) / (1.0 - begin) * 0.7)
    knee = rng.uniform(6.0, 12.0) * np.expm1(6.0 * used) / np.expm1(6.0)
    return np.asarray(165.0 - drain * np.sqrt(used) * 0.7 - knee + 0.3 * (temperature_c - temperature_c.mean()))


def _column(rng: np.random.Generator, time_s: Floats, latitude_deg: float, *, wide: bool) -> Complexes:
    """Simulate the current common to all depths, m/s, (n,)."""
    along = np.exp(1j * rng.uniform(0.0, 2.0 * np.pi))
    mean, eddy, tide = (0.08, 0.13, 0.14) if wide else (0.26, 0.07, 0.06)
    slow = [matern(rng, time_s, rng.uniform(3.0, 9.0) * DAY_S) for _ in range(2)]
    season = 1.0 + 0.2 * np.cos(2.0 * np.pi * time_s / (365.25 * DAY_S))
    flow = along * (mean * season + eddy * (slow[0] + 0.6j * slow[1]))
    return flow + along * (_tides(rng, time_s, tide) + _eddies(rng, time_s)) + _inertial(rng, time_s, latitude_deg)


def _tides(rng: np.random.Generator, time_s: Floats, speed: float) -> Complexes:
    """Simulate tides whose phase and amplitude vary with the stratification, m/s, (n,)."""
    total = np.zeros(time_s.size, dtype=complex)
    for period, share in TIDES_H.values():
        drift = 0.5 * matern(rng, time_s, 12.0 * DAY_S)
        phase = 2.0 * np.pi * (time_s / (period * HOUR_S) + rng.uniform()) + drift
        strength = speed * share * np.exp(0.25 * matern(rng, time_s, 20.0 * DAY_S))
        total += strength * (np.cos(phase) + 1j * rng.uniform(-0.6, 0.6) * np.sin(phase)) / 1.3
    return total


def _eddies(rng: np.random.Generator, time_s: Floats) -> Complexes:
    """Simulate passing eddies, v = U r/R exp((1 - r²/R²)/2), each on a straight track."""
    total, when = np.zeros(time_s.size, dtype=complex), time_s[0] + rng.exponential(6.0) * DAY_S
    while when < time_s[-1]:
        radius, drift = rng.uniform(6e3, 18e3), rng.uniform(0.04, 0.15)
        away = (time_s - when) * drift + 1j * radius * rng.normal(0.0, 0.8)
        total += rng.normal(0.0, 0.22) * 1j * away / radius * np.exp(0.5 - 0.5 * np.abs(away / radius) ** 2)
        when += rng.exponential(9.0) * DAY_S
    return total


def _inertial(rng: np.random.Generator, time_s: Floats, latitude_deg: float) -> Complexes:
    turn = 4.0 * np.pi * np.sin(np.deg2rad(latitude_deg)) * (time_s - time_s[0]) / 86164.1
    packet = [matern(rng, time_s, 4.0 * DAY_S, 2.5) for _ in range(2)]
    return np.asarray(0.035 * (packet[0] + 1j * packet[1]) * np.exp(-1j * turn))


def _shear(rng: np.random.Generator, time_s: Floats, height_m: Floats, size_m_s: float) -> Complexes:
    """Simulate differences over depth, (n, m): random waves with memory increasing with wavelength, and fronts.

    Args:
        size_m_s: rms difference of one component at the distance ``GAP_M``.
    """
    numbers = rng.standard_t(3, WAVES) / rng.uniform(15.0, 40.0)  # rad/m
    rates = rng.standard_t(3, WAVES) * (0.15 + np.abs(numbers) * 12.0) / (12.0 * HOUR_S)
    rates[: WAVES // 5] = 2.0 * np.pi / (12.4206 * HOUR_S) + rng.normal(0.0, 0.05, WAVES // 5) / DAY_S
    rates[WAVES // 5 : WAVES // 3] /= 40.0  # waves that persist for weeks
    sizes = rng.normal(size=WAVES) + 1j * rng.normal(size=WAVES)
    over_depth = sizes[:, None] * np.exp(1j * np.outer(numbers, height_m))
    made = np.exp(1j * np.outer(time_s - time_s[0], rates)) @ over_depth
    apart = 2.0 * np.sum(np.abs(sizes) ** 2 * (1.0 - np.cos(numbers * GAP_M)))
    front = np.zeros((time_s.size, height_m.size), dtype=complex)
    for when in rng.uniform(time_s[0], time_s[-1], max(1, int(np.ptp(time_s) / (20.0 * DAY_S)))):
        # A front is tilted: it passes different depths some hours apart.
        late = (time_s[:, None] - when - height_m * rng.uniform(-900.0, 900.0)) / (2.0 * HOUR_S)
        passed = (1.0 + np.tanh(late)) * np.exp(-np.maximum(late, 0.0) / 40.0)
        front += 1.5 * (rng.normal() + 1j * rng.normal()) * passed
    return np.asarray(size_m_s * (made * np.sqrt(2.0 / apart) + front - front.mean(axis=1, keepdims=True)))


def _wake(rng: np.random.Generator, flow_deg: Floats, speed: Floats, step_s: float) -> Floats:
    """Simulate the heading of a body aligned by its wake, more strongly at high speed, with Student-t disturbances."""
    pull = np.minimum(speed / 0.2, 3.0) ** 1.5 * step_s / SUBSTEPS / (2.5 * HOUR_S)
    kicks = rng.standard_t(4, speed.size * SUBSTEPS) * np.deg2rad(9.0) * np.sqrt(step_s / SUBSTEPS / HOUR_S)
    rest = np.deg2rad(flow_deg + rng.uniform(0.0, 360.0))
    heading, path = float(rest[0]), np.empty(speed.size)
    for k in range(speed.size):
        for kick in kicks[k * SUBSTEPS : (k + 1) * SUBSTEPS]:
            heading += float(kick) - min(pull[k], 0.8) * np.sin(heading - rest[k])
        path[k] = heading
    return np.asarray(np.rad2deg(path) % 360.0)


def _spinning(rng: np.random.Generator, time_s: Floats) -> Floats:
    hours = (time_s - time_s[0]) / HOUR_S
    turns = rng.choice([-1.0, 1.0]) * hours / rng.uniform(15.0, 60.0) + 0.7 * matern(rng, time_s, 30.0 * HOUR_S)
    return np.asarray((360.0 * turns + rng.uniform(0.0, 360.0)) % 360.0)


def _lean(rng: np.random.Generator, time_s: Floats, speed: Floats, way_deg: Floats) -> tuple[Floats, Floats]:
    """Simulate pitch and roll: tilt at rest, downstream lean by drag, and sway."""
    drag, way = rng.uniform(8.0, 20.0) * speed**2 / (0.25 + speed**2), np.deg2rad(way_deg)
    sway = [0.7 * matern(rng, time_s, 3.0 * HOUR_S) for _ in range(2)]
    pitch = rng.uniform(-3.0, 3.0) - drag * np.cos(way) + sway[0]
    roll = rng.uniform(-3.0, 3.0) + drag * np.sin(way) + sway[1]
    return STEEPEST_DEG * np.tanh(pitch / STEEPEST_DEG), STEEPEST_DEG * np.tanh(roll / STEEPEST_DEG)
