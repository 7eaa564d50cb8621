"""Readings of a compass near iron in a scene: three separate sensors, quantized inclinometers, ensemble averages."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.proof.world.scene import Acts, Complexes, Family, Floats, Scene, towards, turned, wrap
from compasslib.demo.compass import tilting

PINGS = 3
YAW_DEG, WOBBLE_DEG, NOISE_DEG = 1.2, 0.35, 0.4  # yaw and tilt of pings about their ensemble; noise of its heading
TILT_STEP_DEG = 180.0 / 4096.0
EVERY, ROUNDS, NEWTON = 3, 4, 10
Tilts = tuple[Floats, Floats]  # pitch and roll, degrees, (n,)
STEADIEST = 0.2  # lower limit of the slope of recorded by correct heading in the conversion of errors


@dataclass(frozen=True, eq=False)
class Meter:
    """Three sensors, one per row: response to the earth's field in the body frame, and offset by hard iron."""

    matrix: Floats  # (3, 3)
    hard_nt: Floats  # (3,)


@dataclass(frozen=True, eq=False)
class Planted:
    """An effect with its size and visible size."""

    family: Family
    make: Callable[[float], Acts]
    size: float
    visible_deg: float

    @property
    def acts(self) -> Acts:
        """Action of the effect at its size."""
        return self.make(self.size)


@dataclass(frozen=True, eq=False)
class Read:
    """Readings of a compass in its ensembles, (n,)."""

    heading_deg: Floats  # mean correct heading
    recorded_deg: Floats
    pitch_deg: Floats  # sensed
    roll_deg: Floats
    resultant: Complexes  # mean phasor of the yaw of pings about the correct heading, 1 without yaw


def build(rng: np.random.Generator, scene: Scene, strength: float) -> Meter:
    """Draw a compass with magnets and a rod of soft iron nearby, at different distances from the three sensors.

    Args:
        strength: horizontal hard iron relative to the earth's horizontal field.
    """
    horizontal, vertical = float(scene.horizontal_nt.mean()), float(scene.vertical_nt.mean())
    sensors = rng.normal(0.0, 0.018, (3, 3))
    axes = np.eye(3) + rng.normal(0.0, 0.005, (3, 3))
    places, moments = _places(rng, int(rng.integers(2, 6)), 0.25, 0.9), rng.normal(0.0, 1.0, (5, 3))
    rod, along = _places(rng, 1, 0.4, 0.8)[0], _places(rng, 1, 1.0, 1.0)[0]
    mass = rng.uniform(0.0005, 0.006)  # polarisability of the rod along itself, m³
    hard = np.array([sum(_dipole(m, s - p) for p, m in zip(places, moments, strict=False)) for s in sensors])
    soft = np.array([np.eye(3) + mass * _dipole(along, s - rod)[:, None] * along / 100.0 for s in sensors])
    matrix = np.einsum("ij,ijk->ik", axes, soft)
    added = np.einsum("ij,ij->i", axes, hard)
    added *= strength * horizontal / max(float(np.hypot(added[0], added[1])), 1.0)
    # The maker's calibration removes vertical iron, which causes heeling error, to within about 80 nT.
    added[2] = rng.normal(0.0, 80.0) - (matrix[2, 2] - 0.5 * (matrix[0, 0] + matrix[1, 1])) * vertical
    return Meter(matrix, added)


def read(scene: Scene, meter: Meter, effects: Sequence[Acts], rng: np.random.Generator | None = None) -> Read:
    """Simulate the readings of the compass.

    Args:
        rng: random generator of pings and noise; without one, a single ping without noise and quantization.
    """
    shape = (1 if rng is None else PINGS, scene.time_s.size)
    yaw, *wobble = np.zeros((3, *shape)) if rng is None else rng.normal(0.0, 1.0, (3, *shape))
    yaw, pitch, roll = YAW_DEG * yaw, scene.pitch_deg + WOBBLE_DEG * wobble[0], scene.roll_deg + WOBBLE_DEG * wobble[1]
    sensed = _sensed(effects, pitch, roll, stepped=rng is not None)
    each = [
        _reading(scene, meter, effects, scene.heading_deg + yaw[k], (pitch[k], roll[k]), (sensed[0][k], sensed[1][k]))
        for k in range(len(yaw))
    ]
    noise = 0.0 if rng is None else rng.normal(0.0, NOISE_DEG, scene.time_s.size)
    turn = np.exp(1j * np.deg2rad(yaw)).mean(axis=0)
    recorded = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(each)).mean(axis=0))) + noise
    heading = scene.heading_deg + np.rad2deg(np.angle(turn))
    return Read(heading % 360.0, recorded % 360.0, sensed[0].mean(axis=0), sensed[1].mean(axis=0), turn)


def plant(scene: Scene, meter: Meter, family: Family, wanted_deg: float, rng: np.random.Generator) -> Planted:
    """Scale an effect to a wanted visible size, at most to its largest plausible size."""
    make, size = family.make(rng, scene), 1.0
    seen = visible_deg(scene, meter, make(size))
    for _ in range(ROUNDS * family.sized):
        size = min(size * float(np.clip(wanted_deg / max(seen, 1e-3), 0.1, 10.0)), family.most)
        seen = visible_deg(scene, meter, make(size))
    return Planted(family, make, size, seen)


def visible_deg(scene: Scene, meter: Meter, acts: Acts) -> float:
    """Compute the visible size, degrees: rms residual of a fit of five coefficients; of clocks, the direction error."""
    if acts.ahead_s is not None:
        late = towards(scene.at(scene.time_s - acts.ahead_s).lower)
        return float(1.4826 * np.nanmedian(np.abs(wrap(late - towards(scene.lower)))))
    bare, with_it = (ideal(scene, meter, one) for one in ((), (acts,)))
    return float(np.std(with_it - bare))


def ideal(scene: Scene, meter: Meter, effects: Sequence[Acts]) -> Floats:
    """Compute the residual of five coefficients from readings without noise, every few ensembles, degrees."""
    made = read(scene, meter, effects)
    # A clockwise rotation of the current at the reference appears as a compass that reads too little.
    seen = made.recorded_deg - total(effects, "veer_deg", scene.time_s.size)
    return left_deg(seen[::EVERY], made.heading_deg[::EVERY])


def left_deg(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Compute the heading error that remains after a fit of five coefficients, degrees, (n,)."""
    w = np.exp(1j * np.deg2rad(heading_deg))
    columns = np.stack([-1j * w, w**0, -1j * w**0, 1.0 / w, -1j / w], axis=1)
    five = np.zeros(5)
    for _ in range(NEWTON):
        q = w + columns @ five
        miss = np.deg2rad(wrap(recorded_deg - np.rad2deg(np.angle(q))))
        five = five + np.linalg.lstsq(np.imag(columns / q[:, None]), miss, rcond=None)[0]
    q = w + columns @ five
    slope = np.real((w * (1.0 - 1j * five[0]) - (five[3] - 1j * five[4]) / w) / q)
    return np.asarray(wrap(recorded_deg - np.rad2deg(np.angle(q))) / np.maximum(slope, STEADIEST))


def total(effects: Sequence[Acts], part: str, count: int) -> Floats:
    """Sum one series over several effects, (count,)."""
    return sum((getattr(one, part) for one in effects if getattr(one, part) is not None), np.zeros(count))


def ensemble(flow: Complexes, made: Read, declination_deg: Floats, *, by_ping: bool) -> Complexes:
    """Compute velocities of an instrument in earth coordinates, relative to its own magnetic north, (n, m)."""
    wrong = made.recorded_deg - made.heading_deg - declination_deg
    seen = turned(flow, wrong[:, None])
    return seen if by_ping else np.asarray(seen * np.abs(made.resultant)[:, None])


def _sensed(effects: Sequence[Acts], pitch: Floats, roll: Floats, *, stepped: bool) -> Tilts:
    if stepped:
        pitch, roll = (TILT_STEP_DEG * np.rint(x / TILT_STEP_DEG) for x in (pitch, roll))
    for change in (one.tilts for one in effects if one.tilts is not None):
        pitch, roll = (np.stack(rows) for rows in zip(*map(change, pitch, roll), strict=True))
    return pitch, roll


def _reading(
    scene: Scene, meter: Meter, effects: Sequence[Acts], heading_deg: Floats, tilt_deg: Tilts, sensed_deg: Tilts
) -> Floats:
    """Compute the reading of one ping, (n,) degrees, not wrapped."""
    n, felt = scene.time_s.size, []
    beside = sum((one.body_nt for one in effects if one.body_nt is not None), np.zeros((n, 3)))
    share = sum(one.unlevelled for one in effects)
    for lag in next((one.late_s for one in effects if one.late_s), (0.0,)):
        turn = np.deg2rad(_ago(scene, heading_deg, lag) - total(effects, "north_deg", n))
        level = np.stack([np.cos(turn), -np.sin(turn), 0.0 * turn], axis=-1) * scene.horizontal_nt[:, None]
        level[:, 2] = scene.vertical_nt
        body = np.einsum("nji,nj->ni", tilting(*tilt_deg), level)
        raw = (body + beside) @ meter.matrix.T + meter.hard_nt
        for warp in (one.warp for one in effects if one.warp is not None):
            raw = warp(raw)
        flat = (1.0 - share) * np.einsum("nij,nj->ni", tilting(*sensed_deg), raw) + share * raw
        felt.append(np.rad2deg(np.arctan2(-flat[:, 1], flat[:, 0])))
    gamma = np.rad2deg(np.angle(np.exp(1j * np.deg2rad(felt)).mean(axis=0)))
    return np.asarray(gamma + sum((one.reading(gamma) for one in effects if one.reading is not None), 0.0))


def _ago(scene: Scene, heading_deg: Floats, lag_s: float) -> Floats:
    if not lag_s:
        return heading_deg
    turning = np.unwrap(np.deg2rad(scene.heading_deg))
    return heading_deg + np.rad2deg(np.interp(scene.time_s - lag_s, scene.time_s, turning) - turning)


def _places(rng: np.random.Generator, count: int, nearest: float, farthest: float) -> Floats:
    away = rng.normal(size=(count, 3))
    return rng.uniform(nearest, farthest, (count, 1)) * away / np.linalg.norm(away, axis=1, keepdims=True)


def _dipole(moment: Floats, away_m: Floats) -> Floats:
    """Compute the field of a dipole, nT, from its moment in A m² and the vector from it in metres."""
    distance = float(np.linalg.norm(away_m))
    along = away_m / distance
    return np.asarray(100.0 * (3.0 * along * (along @ moment) - moment) / distance**3)


def clocks(planted: Sequence[Planted]) -> list[Acts]:
    """List the actions of clock errors only."""
    return [Acts(ahead_s=one.acts.ahead_s) for one in planted if one.acts.ahead_s is not None]
