"""Effects in the log of a swing: water that carries the ship, and time offsets between courses and readings.

Effects of the water act on its velocity, (n, 2) m/s true east and north. Effects on time act on the delay of a reading
relative to its course, (n,) seconds. A filter acts on the heading that the course follows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib import angles
from compasslib.effects.effect import Effect, Scene, elapsed_share, parameter
from compasslib.types import Floats

TRIANGLE = "Moncunill et al. 2023, eqs. (29)-(37), not linearised: velocity over ground less that of the water"


@dataclass(frozen=True)
class SetAndDrift(Effect):
    """A current of constant set and drift carries the ship."""

    name, driver = "water_drift", "heading"
    words = "the current carries the vessel sideways, so that its course over ground differs from its heading"
    shows_along = ("heading",)
    separated_by: ClassVar[Mapping[str, str]] = {
        "sextantal": "each heading at two speeds, or a log of the speed through the water",
        "octantal": "each heading at two speeds, or a log of the speed through the water",
        "heading_slip": "the first headings swung again at the end",
        "compass_drift": "the first headings swung again at the end",
        "hard_iron_step": "the first headings swung again, each at two speeds",
        "hard_iron_drift": "the first headings swung again, each at two speeds",
    }
    recordings = ("swing",)
    side = "water"
    acts_on = "velocity"
    literature = TRIANGLE

    east_m_s: float = parameter("m/s", "current towards east", 0.05)
    north_m_s: float = parameter("m/s", "current towards north", 0.05)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return x + np.array([self.east_m_s, self.north_m_s])


@dataclass(frozen=True)
class TidalSetAndDrift(Effect):
    """A current that changes linearly along the log carries the ship."""

    name = "water_drift"
    recordings = ("swing",)
    side = "water"
    acts_on = "velocity"
    literature = TRIANGLE

    east_m_s: float = parameter("m/s", "current towards east in the middle of the log", 0.05)
    north_m_s: float = parameter("m/s", "current towards north in the middle of the log", 0.05)
    east_gain_m_s: float = parameter("m/s over the record", "gain towards east", 0.05)
    north_gain_m_s: float = parameter("m/s over the record", "gain towards north", 0.05)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        gain = np.array([self.east_gain_m_s, self.north_gain_m_s])
        return x + np.array([self.east_m_s, self.north_m_s]) + gain * (elapsed_share(scene)[:, None] - 0.5)


@dataclass(frozen=True)
class Late(Effect):
    """An effect that delays a quantity; a negative delay would mean that another quantity is late."""

    driver = "turn_rate"
    recordings = ("swing",)
    stage = "readout"

    lag_s: float = parameter("s", "time by which it is late", 1.0)

    @property
    def possible(self) -> bool:
        """Whether the delay is not negative."""
        return self.lag_s >= 0.0


@dataclass(frozen=True)
class LateReading(Late):
    """The reading of the compass is delayed by a constant time."""

    name = "compass_lag"
    acts_on = "time"
    literature = "a delay; for slow turns its first order, reading minus lag times the rate of turn"

    lag_s: float = parameter("s", "time by which the reading is late", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Add to the delay of the reading, seconds."""
        return x + self.lag_s


@dataclass(frozen=True)
class LateCourse(Late):
    """The course over ground is delayed by a constant time, by a receiver's filter or a hull sliding on in a turn."""

    name = "course_lag"
    words = "the course over ground lags: the receiver filters it, and a hull slides on in a turn"
    shows_along = ("turn_rate",)
    separated_by: ClassVar[Mapping[str, str]] = {"clock_offset": "headings and courses logged by one clock"}
    side = "reference"
    acts_on = "time"
    literature = "a delay; for slow turns its first order, course minus lag times the rate of turn"

    lag_s: float = parameter("s", "time by which the course is late", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Subtract from the delay of the reading relative to the course, seconds."""
        return x - self.lag_s


@dataclass(frozen=True)
class FilteredCourse(Late):
    """The course over ground follows the heading through a first-order low-pass filter."""

    name = "course_lag"
    side = "reference"
    acts_on = "reading"
    literature = "a filter of first order of the velocity: a receiver's, or the inertia of a hull"

    lag_s: float = parameter("s", "mean delay of the filter", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Filter headings sampled once per second, not wrapped, (n,) degrees."""
        return self.delayed(x)

    def delayed(self, x: Floats, *, filter_reach: float = 5.0) -> Floats:
        """Filter headings sampled once per second, not wrapped, (n,) degrees; a negative lag gives a lead.

        Args:
            filter_reach: length of a filter's impulse response in time constants.
        """
        size = abs(self.lag_s)
        kernel = (size / (1.0 + size)) ** np.arange(int(filter_reach * size) + 2) / (1.0 + size)
        unit = angles.phasor(np.concatenate([np.full(len(kernel) - 1, x[0]), x]))
        late = angles.difference(angles.argument(np.convolve(unit, kernel, "valid")), x)
        return np.asarray(x + np.sign(self.lag_s) * late)


@dataclass(frozen=True)
class ClocksApart(Effect):
    """Headings and courses were logged by clocks that differ by a constant."""

    name = "clock_offset"
    recordings = ("swing",)
    side = "clock"
    stage = "clock"
    acts_on = "time"
    literature = "time of the compass minus that of the receiver"

    offset_s: float = parameter("s", "the compass's clock minus the receiver's", 1.0)

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Add to the delay of the reading, seconds."""
        return x + self.offset_s
