"""A second simulation: internal waves of random phases in a slow current, and blow-down of a string of instruments.

Frequencies and vertical wavenumbers follow the spectrum of Garrett and Munk (Deep-Sea Research 19, 823, 1972), ellipses
and displacements the linear theory of waves on a rotating earth. A wave whose intrinsic frequency in the slow current
approaches the inertial frequency grows and is absorbed (a critical layer). The string leans due to drag, by which both
instruments sink and their vertical distance decreases; a cage with a fin turns on a swivel with friction.
"""

import numpy as np

from benchmarks.proof.world import seas
from benchmarks.proof.world.scene import DAY_S, HOUR_S, Complexes, Floats, Scene, towards, turned
from benchmarks.proof.world.seas import Weather

WATER = "internal waves"
WAVES, OF_TIDE = 200, 24  # number of waves, and of those of the semidiurnal internal tide
SHORTEST_M, SHORTEST_S = 8.0, 2.0 * HOUR_S  # shortest wavelength and period
SPEED_M_S, PLAIN_N = 0.05, 5.2e-3  # rms of one component at this buoyancy frequency, rad/s
NEAR = 0.3  # distance from the inertial frequency, relative to it, within which a wave is absorbed
LARGEST = 2.0  # largest factor of growth of a wave before absorption
LEANING_M_S = 0.4  # speed of the slow current at which the string leans by the angle drawn
STEEPEST_DEG = 18.0  # tilt
SUBSTEPS = 4  # per hour in the rotation of the cage


def make(rng: np.random.Generator, weather: Weather) -> Scene:
    """Simulate a mooring in this water."""
    time = 1.2e9 + DAY_S * int(rng.integers(0, 4000)) + HOUR_S * np.arange(weather.hours)
    place = (float(rng.uniform(48.0, 70.0)), float(rng.uniform(-50.0, 10.0)), float(rng.uniform(300.0, 900.0)))
    slow = _slow(rng, time, wide=weather.wide)
    lean = np.deg2rad(rng.uniform(6.0, 20.0)) * np.minimum(np.abs(slow[0]) / LEANING_M_S, 1.3) ** 2
    height, apart = float(rng.uniform(80.0, 250.0)), float(rng.uniform(7.0, 12.0))
    ranges = seas.FIRST_M + seas.CELL_M * np.arange(seas.CELLS)
    along = np.cos(lean)[:, None]
    heights = along * np.append(np.full(seas.CELLS, height), height - apart) + np.append(ranges, 0.0)
    waves, heave = _waves(rng, time, place, (slow[1], heights), weather.noise)
    flow = slow[0][:, None] + slow[1][:, None] * np.sin(np.pi * heights / place[2]) + waves
    lower = turned(flow[:, -1], weather.veer_deg * _red(rng, time, 1.2))
    declination, horizontal, vertical = seas.earth(time, place)
    way = towards(flow[:, 0]) - declination
    heading = (_untwisting if weather.spinning else _swivelled)(rng, way, np.abs(flow[:, 0]))
    pitch, roll = _leaning(rng, time, np.rad2deg(lean) * rng.uniform(0.5, 1.0), way - heading)
    depth = place[2] - heights[:, 0] + ranges[0]
    warm = 5.0 + _red(rng, time, 1.5) + rng.uniform(0.005, 0.02) * (heave - depth + depth.mean())
    return Scene(
        time, heading, pitch, roll, depth, warm, seas.supply(rng, warm, weather.battery), flow[:, :-1], lower,
        declination, horizontal, vertical, ranges, place, True, apart * along[:, 0], HOUR_S,
    )  # fmt: skip


def _red(rng: np.random.Generator, time_s: Floats, slope: float) -> Floats:
    """Draw a series of random phases with power-law amplitudes at periods above a day, (n,), with unit rms."""
    rates = 2.0 * np.pi * np.arange(1, int(np.ptp(time_s) / DAY_S) + 1) / np.ptp(time_s)
    size = (rates + 2.0 * np.pi / (120.0 * DAY_S)) ** -slope
    phases = np.exp(2j * np.pi * rng.random(rates.size))
    series = np.real(np.exp(1j * np.outer(time_s - time_s[0], rates)) @ (size * phases))
    return np.asarray(series / series.std())


def _slow(rng: np.random.Generator, time_s: Floats, *, wide: bool) -> tuple[Complexes, Complexes]:
    """Simulate the slow barotropic current with the tide, and that of the first baroclinic mode, m/s, (n,) each."""
    along = np.exp(2j * np.pi * rng.random())
    mean, eddy, tide = (0.06, 0.13, 0.15) if wide else (0.24, 0.08, 0.06)
    whole = mean + eddy * (_red(rng, time_s, 1.1) + 0.7j * _red(rng, time_s, 1.1))
    hours = (time_s - time_s[0]) / HOUR_S
    for period, share in seas.TIDES_H.values():
        phase = 2.0 * np.pi * (hours / period + rng.random())
        whole = whole + tide * share * (np.cos(phase) + 1j * rng.uniform(-0.8, 0.8) * np.sin(phase))
    mode = 0.1 * (_red(rng, time_s, 1.3) + 1j * _red(rng, time_s, 1.3))
    return along * whole, along * mode


def _waves(
    rng: np.random.Generator,
    time_s: Floats,
    place: tuple[float, float, float],
    through: tuple[Complexes, Floats],
    noise: float,
) -> tuple[Complexes, Floats]:
    """Simulate the currents of the waves, m/s, (n, m), and their displacement at the first height, m, (n,).

    Args:
        through: the first baroclinic mode, m/s, (n,), and the heights above the bottom in metres, (n, m).
        noise: factor of the amplitude of the waves.
    """
    mode, heights = through
    inertial, buoyancy = 1.4584e-4 * np.sin(np.deg2rad(place[0])), rng.uniform(2e-3, 7e-3)
    # By the inverse of the distribution f / w / sqrt(w^2 - f^2), which is uniform in arccos(f / w).
    fastest = np.arccos(inertial / (2.0 * np.pi / SHORTEST_S))
    rates = inertial / np.cos(rng.uniform(0.02, 1.0, WAVES) * fastest)
    rates[:OF_TIDE] = np.maximum(2.0 * np.pi / (12.4206 * HOUR_S) + rng.normal(0.0, 0.03, OF_TIDE) / DAY_S, inertial)
    longest = 2.0 * np.pi / rng.uniform(80.0, 200.0)
    numbers = np.minimum(longest * np.tan(rng.uniform(0.0, np.pi / 2.0, WAVES)), 2.0 * np.pi / SHORTEST_M)
    numbers *= rng.choice([-1.0, 1.0], WAVES)
    across = np.abs(numbers) * np.sqrt((rates**2 - inertial**2) / (buoyancy**2 - rates**2))
    ways = np.exp(2j * np.pi * rng.random(WAVES))
    sizes = noise * SPEED_M_S * np.sqrt(buoyancy / PLAIN_N) * np.abs(rng.normal(size=WAVES)) * np.sqrt(2.0 / WAVES)
    phases = 2.0 * np.pi * rng.random(WAVES)
    flow, heave = np.zeros(heights.shape, dtype=complex), np.zeros(time_s.size)
    sheared = mode[:, None] * np.sin(np.pi * heights / place[2])
    for k in range(WAVES):
        carried = np.abs(rates[k] - across[k] * np.real(sheared * np.conj(ways[k])))
        grown = np.minimum(np.sqrt(rates[k] / np.maximum(carried, 1e-9)), LARGEST)
        size = sizes[k] * grown * np.clip((carried / inertial - 1.0) / NEAR, 0.0, 1.0)
        phase = numbers[k] * heights - rates[k] * (time_s - time_s[0])[:, None] + phases[k]
        flow += ways[k] * size * (np.cos(phase) - 1j * inertial / rates[k] * np.sin(phase))
        heave += size[:, 0] * across[k] / (np.abs(numbers[k]) * rates[k]) * np.sin(phase[:, 0])
    return flow, heave


def _swivelled(rng: np.random.Generator, way_deg: Floats, speed: Floats) -> Floats:
    """Simulate the heading of a cage turned by its fin when the torque exceeds the friction of the swivel, (n,)."""
    rest = np.deg2rad(way_deg + rng.uniform(0.0, 360.0))
    friction, heading = rng.uniform(0.05, 0.4), float(rest[0])
    path, kicks = np.empty(speed.size), np.deg2rad(rng.uniform(4.0, 9.0)) * rng.normal(size=(speed.size, SUBSTEPS))
    for k in range(speed.size):
        for kick in kicks[k]:
            torque = min((speed[k] / 0.2) ** 2, 3.0) * np.sin(rest[k] - heading)
            heading += 0.3 * np.sign(torque) * max(abs(torque) - friction, 0.0) + kick
        path[k] = heading
    return np.asarray(np.rad2deg(path) % 360.0)


def _untwisting(rng: np.random.Generator, way_deg: Floats, speed: Floats) -> Floats:
    """Simulate the heading of a cage without a fin on a line that twists and untwists with the drag, (n,)."""
    turns = rng.uniform(1.0, 4.0) * (speed - speed.mean()) / speed.std() + np.cumsum(rng.normal(0.0, 0.03, speed.size))
    return np.asarray((360.0 * turns + way_deg[0]) % 360.0)


def _leaning(rng: np.random.Generator, time_s: Floats, lean_deg: Floats, way_deg: Floats) -> tuple[Floats, Floats]:
    """Simulate pitch and roll of a cage that leans downstream with the string and sways, (n,) each."""
    sway, way = [0.5 * seas.matern(rng, time_s, 2.0 * HOUR_S, 0.5) for _ in range(2)], np.deg2rad(way_deg)
    pitch = rng.uniform(-3.0, 3.0) - lean_deg * np.cos(way) + sway[0]
    roll = rng.uniform(-3.0, 3.0) + lean_deg * np.sin(way) + sway[1]
    return STEEPEST_DEG * np.tanh(pitch / STEEPEST_DEG), STEEPEST_DEG * np.tanh(roll / STEEPEST_DEG)
