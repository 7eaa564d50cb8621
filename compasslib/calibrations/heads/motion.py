"""How a head moved by its own clock: heading and tilts as smooth functions of time, and their rates."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import BAD, Record
from compasslib.statistics import blocks
from compasslib.types import Complexes, Floats

STEEPEST_TILT = 45.0  # degrees: on deck, or fallen
MOST_STRETCHES, LEAST_STRETCHES, SAMPLES_IN_STRETCH = 16, 5, 40.0
GAP_STEPS = 3.0  # sampling intervals without a sample over which nothing is interpolated


@dataclass(frozen=True)
class GapSpline:
    """A smooth curve through samples, silent inside gaps."""

    time_s: Floats  # (n,) increasing
    values: NDArray  # (n,) real or complex

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.time_s - self.time_s[0], self.values)

    def at(self, time_s: Floats, derivative: int = 0) -> NDArray:
        """Return the value, or a derivative by seconds, at instants; NaN in gaps and beyond the ends.

        Args:
            time_s: instants, (k,).
        """
        left = np.searchsorted(self.time_s, time_s, side="right") - 1
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        left = np.clip(left, 0, len(self.time_s) - 2)
        whole = self.time_s[left + 1] - self.time_s[left] <= GAP_STEPS * step(self.time_s)
        there = inside & (whole | (time_s == self.time_s[left]))
        found = self._spline(time_s - self.time_s[0], derivative)
        return np.where(there, found, np.nan)


@dataclass(frozen=True)
class Motion:
    """Heading and tilt of one head by its own clock, (n,) each, all finite."""

    time_s: Floats  # increasing
    heading_deg: Floats  # recorded, unwrapped along time
    lean: Complexes  # forward + i starboard of what points down in its body: the sines of the tilts

    @property
    def recorded_deg(self) -> Floats:
        """Return the recorded heading, [0, 360)."""
        return angles.wrap360(self.heading_deg)

    @cached_property
    def heading(self) -> GapSpline:
        """Return the heading as a curve, degrees."""
        return GapSpline(self.time_s, self.heading_deg)

    @cached_property
    def leaning(self) -> GapSpline:
        """Return the tilt as a curve."""
        return GapSpline(self.time_s, self.lean)

    @cached_property
    def turn_rate(self) -> GapSpline:
        """Return how fast the heading turns, degrees a second, between the samples."""
        return _rate(self.time_s, self.heading_deg)

    @cached_property
    def lean_rate(self) -> GapSpline:
        """Return how fast the tilt changes, degrees a second, between the samples."""
        return _rate(self.time_s, self.lean / angles.DEGREE)


@dataclass(frozen=True)
class Compared:
    """Both heads at b's instants, (n,) each."""

    time_s: Floats  # by b's clock
    recorded_a: Floats  # degrees, interpolated
    recorded_b: Floats
    lean_a: Complexes
    lean_b: Complexes
    rate_deg_s: Floats  # how fast a turns

    def __len__(self) -> int:
        return len(self.time_s)


def step(time_s: Floats) -> float:
    """Return the sampling interval, seconds."""
    return float(np.median(np.diff(time_s)))


def motion(record: Record, start_s: float | None = None, end_s: float | None = None) -> Motion:
    """Return the usable part of a record: finite headings and tilts, in order of time, upright, inside a window.

    Args:
        record: of a head, by its own clock.
        start_s: begin of the window; the record's where None.
        end_s: end of the window; the record's where None.
    """
    tilts = np.abs(record.pitch_deg) + np.abs(record.roll_deg)
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(record.heading_deg) & (record.heading_quality < BAD) & (tilts < STEEPEST_TILT)
    usable &= (record.time_s >= (-np.inf if start_s is None else start_s)) & (
        record.time_s <= (np.inf if end_s is None else end_s)
    )
    time_s, first = np.unique(record.time_s[usable], return_index=True)
    index = np.flatnonzero(usable)[first]
    heading = record.heading_deg[index]
    turned = np.concatenate([heading[:1], angles.difference(heading[1:], heading[:-1])])
    return Motion(time_s, np.cumsum(turned), lean(record.pitch_deg[index], record.roll_deg[index]))


def lean(pitch_deg: Floats, roll_deg: Floats) -> Complexes:
    """Return what points down, seen in the body: forward + i starboard, the third row of Ry(pitch) Rx(roll).

    Args:
        pitch_deg: forward up, (n,).
        roll_deg: starboard down, (n,).
    """
    (sp, cp), (sr, _) = angles.sin_cos(pitch_deg), angles.sin_cos(roll_deg)
    return -sp + 1j * cp * sr


def down(lean: Complexes) -> Floats:
    """Return the unit vector that points down in the body's axes forward, starboard, down, (n, 3).

    Args:
        lean: forward + i starboard of it, (n,).
    """
    return np.stack([lean.real, lean.imag, np.sqrt(np.maximum(1.0 - np.abs(lean) ** 2, 0.0))], axis=-1)


def tilts(lean: Complexes) -> tuple[Floats, Floats]:
    """Return pitch and roll, degrees: the inverse of ``lean``.

    Args:
        lean: forward + i starboard of what points down, (n,).
    """
    x, y, z = down(lean).T
    pitch = angles.wrap180(angles.direction(-x, np.hypot(y, z)))
    return pitch, angles.wrap180(angles.direction(y, z))


def independent(effective: float, parameters: int = 1) -> tuple[int, float]:
    """Return into how many stretches a record is cut, and by how much the variance between them is widened.

    Neighbouring stretches share what is remembered across their border: a stretch of m independent samples shows
    1 - 1/(2m) of the variance of long ones (first-order memory). And few stretches make Student's t of a normal.

    Args:
        effective: independent samples in the record.
    """
    count = int(np.clip(effective / SAMPLES_IN_STRETCH, LEAST_STRETCHES, MOST_STRETCHES))
    shared = 1.0 - 0.5 / max(effective / count, 1.0)
    return count, blocks.student(count - parameters) ** 2 / shared


def _rate(time_s: Floats, values: NDArray) -> GapSpline:
    interval = np.diff(time_s)
    near = interval <= GAP_STEPS * step(time_s)
    return GapSpline(((time_s[1:] + time_s[:-1]) / 2.0)[near], (np.diff(values) / interval)[near])
