"""Arithmetic of angles: wrapping, averaging, differences, conversion to and from components.

All angles in the library are processed here. They are in degrees, clockwise from north (or from the forward direction),
float64, in arrays of any shapes that broadcast. A horizontal vector as a single number is the complex
``east + i north``.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib.types import Floats

DEGREE = np.pi / 180.0  # one degree in radians
SECTOR_DEG, SECTORS = 10.0, 36  # of the circle, by which the coverage of headings is counted
UNIFORM_SIGMA_DEG = 360.0 / np.sqrt(12.0)  # standard deviation of a uniformly distributed direction


def wrap360(angle_deg: ArrayLike) -> Floats:
    """Wrap an angle to [0, 360)."""
    angle = np.asarray(angle_deg, dtype=float)
    wrapped = angle - 360.0 * np.floor(angle / 360.0)  # three times as fast as np.mod
    # Rounding errors can leave the interval at either end, which is north.
    return np.where((wrapped >= 360.0) | (wrapped < 0.0), 0.0, wrapped)


def wrap180(angle_deg: ArrayLike) -> Floats:
    """Wrap an angle to [-180, 180)."""
    return wrap360(np.asarray(angle_deg, dtype=float) + 180.0) - 180.0


def difference(a_deg: ArrayLike, b_deg: ArrayLike) -> Floats:
    """Compute a - b in [-180, 180)."""
    return wrap180(np.asarray(a_deg, dtype=float) - np.asarray(b_deg, dtype=float))


def phasor(angle_deg: ArrayLike) -> NDArray[np.complex128]:
    """Compute e^{i angle}."""
    return np.exp(1j * np.deg2rad(np.asarray(angle_deg, dtype=float)))


def argument(z: ArrayLike) -> Floats:
    """Compute arg z in [0, 360)."""
    return wrap360(np.rad2deg(np.angle(np.asarray(z, dtype=complex))))


def sin_cos(angle_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Compute sine and cosine of angles in degrees."""
    radians = np.deg2rad(np.asarray(angle_deg, dtype=float))
    return np.sin(radians), np.cos(radians)


def direction(east: ArrayLike, north: ArrayLike) -> Floats:
    """Compute the direction towards which a vector points, degrees in [0, 360); NaN for the zero vector."""
    east, north = np.asarray(east, dtype=float), np.asarray(north, dtype=float)
    towards = wrap360(np.rad2deg(np.arctan2(east, north)))
    return np.where((east == 0) & (north == 0), np.nan, towards)


def chord(angle_deg: ArrayLike) -> Floats:
    """Compute the chord of an angle, scaled to equal the angle if it is small, degrees."""
    return 2.0 * sin_cos(np.asarray(angle_deg, dtype=float) / 2.0)[0] / DEGREE


def components(speed: ArrayLike, towards_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Compute (east, north) of a vector given by its length and the direction towards which it points."""
    sine, cosine = sin_cos(towards_deg)
    length = np.asarray(speed, dtype=float)
    return length * sine, length * cosine


def turn(east: ArrayLike, north: ArrayLike, by_deg: ArrayLike) -> tuple[Floats, Floats]:
    """Rotate a vector (east, north) clockwise by an angle in degrees."""
    sine, cosine = sin_cos(by_deg)
    east, north = np.asarray(east, dtype=float), np.asarray(north, dtype=float)
    return east * cosine + north * sine, north * cosine - east * sine


def rotation_errors(variance: Floats) -> tuple[Floats, Floats]:
    """Compute the mean squared errors across and along a unit vector, from the variance of its direction, rad2."""
    # Of a normal error delta, sin(delta) acts across and 1 - cos(delta) along the vector.
    once, twice = np.exp(-0.5 * variance), np.exp(-2.0 * variance)
    return 0.5 * (1.0 - twice), 1.5 + 0.5 * twice - 2.0 * once


def mean(angle_deg: ArrayLike, weights: ArrayLike | None = None, axis: int | None = None) -> Floats:
    """Compute the circular mean in [0, 360), ignoring NaN; NaN if no angle is finite."""
    return argument(_resultant(angle_deg, weights, axis))


def resultant_length(angle_deg: ArrayLike) -> Floats:
    """Compute the mean resultant length, 1 if all angles agree and 0 if they cancel, ignoring NaN."""
    return np.abs(_resultant(angle_deg, None, None))


def rms(difference_deg: ArrayLike) -> float:
    """Compute the root mean square of differences, wrapped to [-180, 180), ignoring NaN; NaN if none is finite."""
    wrapped = wrap180(difference_deg)
    finite = wrapped[np.isfinite(wrapped)]
    return float(np.sqrt(np.mean(finite**2))) if finite.size else float("nan")


def position(latitude: float, longitude: float) -> str:
    """Format a position, 65.3333° N, 32.9550° W."""
    east = float(wrap180(longitude))
    return f"{abs(latitude):.4f}° {'N' if latitude >= 0 else 'S'}, {abs(east):.4f}° {'E' if east >= 0 else 'W'}"


def _resultant(angle_deg: ArrayLike, weights: ArrayLike | None, axis: int | None) -> NDArray[np.complex128]:
    angle = np.asarray(angle_deg, dtype=float)
    weight = np.isfinite(angle) * (np.ones(angle.shape) if weights is None else np.asarray(weights, dtype=float))
    total = np.sum(weight, axis=axis)
    summed = np.sum(weight * np.where(np.isfinite(angle), phasor(angle), 0.0), axis=axis)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(total > 0, summed / total, complex(np.nan, np.nan))
