"""Random series that can be made again by name, and the few angles that this world needs."""

from __future__ import annotations

from itertools import accumulate

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

HOUR_S = 3600.0
DAY_S = 86400.0


def stream(seed: int, mooring: str, purpose: str) -> np.random.Generator:
    """Seed the generator of one purpose on one mooring, so that nothing depends on what else is made or when."""
    return np.random.default_rng([seed, int.from_bytes(f"{mooring}/{purpose}".encode(), "big")])


def red_noise(rng: np.random.Generator, count: int, *, memory: float, deviation: float) -> Floats:
    """Draw a stationary first-order autoregressive series, shape (count,).

    Args:
        memory: steps after which the correlation has fallen to 1/e.
    """
    keep = float(np.exp(-1.0 / memory))
    kicks = rng.normal(0.0, deviation * np.sqrt(1.0 - keep**2), count)
    kicks[0] = rng.normal(0.0, deviation)
    return np.fromiter(accumulate(kicks.tolist(), lambda state, kick: keep * state + kick), float, count)


def red_vector(rng: np.random.Generator, count: int, *, memory: float, deviation: float) -> Complexes:
    """Draw east + i north with independent red components, shape (count,).

    Args:
        memory: steps after which the correlation has fallen to 1/e.
    """
    east = red_noise(rng, count, memory=memory, deviation=deviation)
    return east + 1j * red_noise(rng, count, memory=memory, deviation=deviation)


def white_vector(rng: np.random.Generator, shape: int | tuple[int, ...], deviation: float) -> Complexes:
    """Draw east + i north with independent normal components."""
    return rng.normal(0.0, deviation, shape) + 1j * rng.normal(0.0, deviation, shape)


def towards(direction_deg: ArrayLike) -> Complexes:
    """Compute the unit vector east + i north of a direction, degrees clockwise from north."""
    return np.asarray(1j * np.exp(-1j * np.deg2rad(np.asarray(direction_deg, dtype=float))))


def direction(velocity: Complexes) -> Floats:
    """Compute the direction towards which east + i north points, degrees clockwise from north in [0, 360)."""
    return circle(90.0 - np.rad2deg(np.angle(velocity)))


def circle(angle_deg: ArrayLike) -> Floats:
    """Wrap an angle to [0, 360)."""
    turned = np.asarray(np.mod(angle_deg, 360.0))
    # The remainder of a tiny negative angle rounds to the full circle.
    return np.where(turned < 360.0, turned, 0.0)


def clockwise(velocity: ArrayLike, by_deg: ArrayLike) -> Complexes:
    """Turn east + i north clockwise by degrees that broadcast with it."""
    return np.asarray(velocity * np.exp(-1j * np.deg2rad(np.asarray(by_deg, dtype=float))))
