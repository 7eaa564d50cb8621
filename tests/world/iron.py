"""Simulated logs of a magnetometer near known iron, turned on a platform in waves or by hand over the sphere."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from compasslib.demo.water import Floats

FIELD = 500.0  # modulus of the earth's field, counts


@dataclass(frozen=True)
class Iron:
    """Soft iron (no unit) and hard iron (counts) in the body frame forward, starboard, down, and the dip."""

    soft: Floats
    hard: Floats
    dip_deg: float

    @property
    def level(self) -> tuple[float, float]:
        """Horizontal and downward field, counts."""
        return FIELD * np.cos(np.deg2rad(self.dip_deg)), FIELD * np.sin(np.deg2rad(self.dip_deg))

    def deviation(self, recorded_deg: Floats) -> Floats:
        """Interpolate correct minus recorded heading of the level compass to recorded headings, degrees."""
        beta = np.linspace(-720.0, 720.0, 57601)
        h, z = self.level
        field = np.stack([h * np.cos(np.deg2rad(beta)), -h * np.sin(np.deg2rad(beta)), np.full(beta.shape, z)])
        x, y, _ = self.soft @ field + self.hard[:, None]
        gamma = np.unwrap(np.arctan2(-y, x))
        gamma = np.rad2deg(gamma - 2 * np.pi * np.round((gamma[28800]) / (2 * np.pi)))
        return np.asarray(np.interp(recorded_deg, gamma, beta) - recorded_deg)


def some(rng: np.random.Generator, *, strength: float = 0.15) -> Iron:
    """Draw iron at a dip of 50 to 70°; strength: standard deviation of hard iron over the horizontal field."""
    dip = rng.uniform(50.0, 70.0)
    off = rng.normal(size=(3, 3)) * 0.04
    soft = np.eye(3) + (off + off.T) / 2.0
    return Iron(soft, strength * FIELD * np.cos(np.deg2rad(dip)) * rng.normal(size=3), dip)


def red(rng: np.random.Generator, n: int, memory: float, columns: int) -> Floats:
    """Draw noise with unit variance and autocorrelation memory^lag, (n, columns)."""
    white = rng.normal(size=(n + 200, columns))
    return np.asarray(lfilter([np.sqrt(1.0 - memory**2)], [1.0, -memory], white, axis=0)[200:])


def level_motion(rng: np.random.Generator, n: int, *, turns: float = 12.0, tilt_deg: float = 4.0) -> Floats:
    """Simulate heading, pitch and roll, (n, 3) degrees, of a platform that turns about the vertical in waves."""
    heading = np.linspace(0.0, 360.0 * turns, n) + 15.0 * red(rng, n, 0.98, 1)[:, 0]
    tilts = tilt_deg / 2.0 * red(rng, n, 0.6, 2)
    return np.column_stack([heading, tilts])


def tumble(rng: np.random.Generator, n: int) -> Floats:
    """Simulate heading, pitch and roll, (n, 3) degrees, of an instrument turned by hand over the sphere."""
    heading = np.linspace(0.0, 360.0 * 23.0, n) + rng.uniform(0.0, 360.0)
    roll = np.linspace(0.0, 360.0 * 7.0, n) + rng.uniform(0.0, 360.0)
    return np.column_stack([heading, 75.0 * np.sin(np.linspace(0.0, 2 * np.pi * 11.0, n)), roll])


def turned(motion: Floats) -> Floats:
    """Compute the rotation C^T from earth (north, east, down) to body for each attitude, (n, 3, 3)."""
    return np.asarray(Rotation.from_euler("ZYX", motion, degrees=True).inv().as_matrix())


def readings(
    rng: np.random.Generator, iron: Iron, motion: Floats, *, noise: float = 0.01, memory: float = 0.0
) -> Floats:
    """Simulate the readings of the three axes, (n, 3) counts; noise is relative to the modulus of the field."""
    h, z = iron.level
    field = turned(motion) @ np.array([h, 0.0, z])
    return np.asarray(field @ iron.soft.T + iron.hard + noise * FIELD * red(rng, len(motion), memory, 3))


def write(path: Path, **columns: Floats) -> Path:
    """Write columns to a CSV file and return its path."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.6f")
    return path
