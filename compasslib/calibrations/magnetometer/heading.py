"""What iron does to the heading: the exact compass of a calibrated magnetometer, its series, table and tilt angles.

Iron travels here as one vector (12,): the centre b and the nine numbers of G, over the readings' scale. Whatever is
computed from it is computed from each replicate of the jackknife too, which gives its uncertainty.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer.ellipsoid import ScaledReadings
from compasslib.calibrations.magnetometer.log import level_heading
from compasslib.calibrations.result import DeviationTable
from compasslib.deviation import von_appen
from compasslib.types import Floats

TABLE_DEG = np.arange(0.0, 360.0, 10.0)
GRID_DEG = np.arange(0.0, 360.0, 5.0)
ROUNDS = 3  # of the tilt angles' linear step
MOST_DILUTED = 10.0  # tilt angles, radians for an error of the whole field: 0.3 % then makes 1.7 degrees


def exact(iron: Floats, dip_ratio: float) -> Floats:
    """Return A..E of the exact compass of an instrument that stands level, (5,).

    Args:
        iron: centre and G, (12,), with the field's modulus 1.
        dip_ratio: downward over horizontal field; 0 where the modulus is that of the horizontal field alone.
    """
    horizontal = 1.0 / np.hypot(1.0, dip_ratio)
    soft = np.linalg.inv(iron[3:].reshape(3, 3))
    return compass.level_coefficients(soft, iron[:3], horizontal_nT=horizontal, vertical_nT=dip_ratio * horizontal)


def deviation(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Return beta - gamma at recorded headings, the steadier root, (n,) degrees.

    Args:
        coefficients: A..E of the exact compass, (5,).
        recorded_deg: recorded headings, (n,).
    """
    return angles.difference(compass.inverse(coefficients, recorded_deg)[:, 0], recorded_deg)


def series(coefficients: Floats) -> Floats:
    """Return A..E in degrees, the least-squares series in the recorded heading over the whole circle, (5,).

    Args:
        coefficients: A..E of an exact compass that turns full circle, (5,).
    """
    return np.linalg.lstsq(von_appen.design(GRID_DEG), deviation(coefficients, GRID_DEG), rcond=None)[0]


def table(coefficients: Floats, replicates: Floats, moved: Floats) -> DeviationTable:
    """Return the exact deviation every 10 degrees of the recorded heading.

    Args:
        coefficients: A..E of the exact compass, (5,).
        replicates: the same without each block, (blocks, 5).
        moved: the same with one standard deviation of what no reading shows, (5,).
    """
    value = deviation(coefficients, TABLE_DEG)
    off = np.array([angles.difference(deviation(one, TABLE_DEG), value) for one in (moved, *replicates)])
    return DeviationTable(TABLE_DEG, value, ellipsoid.sigma(off[1:], off[0]))


def headings(iron: Floats, readings: ScaledReadings, levelling: Floats) -> tuple[Floats, Floats]:
    """Return recorded and corrected heading of each reading, (n,) degrees each.

    Args:
        iron: centre and G, (12,).
        levelling: matrices that turn the body frame level, (n, 3, 3).
    """
    field = ellipsoid.corrected(iron[:3], iron[3:].reshape(3, 3), readings)
    return level_heading(readings.field, levelling), level_heading(field, levelling)


def harmonics(modulus: Floats, heading_deg: Floats) -> tuple[float, float]:
    """Return the first and second harmonic of a modulus against the heading, percent of its mean.

    Args:
        modulus: (n,).
        heading_deg: (n,).
    """
    k = np.linalg.lstsq(von_appen.design(heading_deg), modulus, rcond=None)[0]
    return float(100.0 * np.hypot(k[1], k[2]) / k[0]), float(100.0 * np.hypot(k[3], k[4]) / k[0])


def tilt_angles(iron: Floats, readings: ScaledReadings, down: Floats) -> tuple[Floats, float, Floats]:
    """Return the small turn from the magnetometer to the tilt sensor that keeps the vertical field constant.

    With the downward direction t the vertical field t . (h + e x h) is one number c wherever the instrument points, so
    t . h = c - e . (h x t) is linear in the turn e about forward, starboard and down.

    Args:
        iron: centre and G, (12,).
        down: t of the tilt sensor, (n, 3).

    Returns:
        The turn (3,) in degrees, NaN about an axis that the tilts do not determine; c, the sine of the dip; and the
        iron with the turn in its G.
    """
    field = ellipsoid.corrected(iron[:3], iron[3:].reshape(3, 3), readings)
    turn, wide = np.eye(3), np.zeros(3, dtype=bool)
    for _ in range(ROUNDS):
        turned = field @ turn.T
        columns = np.column_stack([np.ones(len(field)), -np.cross(turned, down)])
        if not wide.any():
            wide = _diluted(columns)
        columns[:, 1:] *= ~wide
        solved = np.linalg.lstsq(columns, np.sum(turned * down, axis=1), rcond=None)[0]
        turn = _rotation(solved[1:]) @ turn
    vector = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    matrix = turn @ iron[3:].reshape(3, 3)
    return np.where(wide, np.nan, vector / angles.DEGREE), float(solved[0]), np.append(iron[:3], matrix.ravel())


def _diluted(columns: Floats) -> NDArray[np.bool_]:
    values, vectors = np.linalg.eigh(columns.T @ columns / len(columns))
    inverse = (vectors / np.maximum(values, 1e-14)) @ vectors.T
    return np.sqrt(np.diag(inverse))[1:] > MOST_DILUTED


def _rotation(vector: Floats) -> Floats:
    """Return the matrix that turns about a vector by its length, radians (Rodrigues)."""
    length = float(np.linalg.norm(vector))
    x, y, z = vector / max(length, 1e-300)
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = (float(v) for v in angles.sin_cos(length / angles.DEGREE))
    return np.eye(3) + sine * across + (1.0 - cosine) * across @ across
