"""Effects in the log of a swing: water that carries the ship, and time offsets between courses and readings.

Effects of the water act on its velocity, (n, 2) m/s true east and north. Effects on time act on the delay of a reading
relative to its course, (n,) seconds. A filter acts on the heading that the course follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from compasslib import angles
from compasslib.effects.effect import Effect, Scene, additive, parameter
from compasslib.types import Floats

_drift = partial(
    additive,
    name="water_drift", recordings=("swing",), side="water", acts_on="velocity",
    literature="Moncunill et al. 2023, eqs. (29)-(37), not linearised: velocity over ground less that of the water",
)  # fmt: skip
_late = partial(
    additive,
    driver="turn_rate", recordings=("swing",), stage="readout", acts_on="time",
    possible=property(lambda term: term.lag_s >= 0.0),  # a negative delay is one of another quantity
)  # fmt: skip

SetAndDrift = _drift(
    "SetAndDrift", "A current of constant set and drift carries the ship.", lambda term, _: term.values,
    driver="heading", shows_along=("heading",),
    words="the current carries the vessel sideways, so that its course over ground differs from its heading",
    separated_by={
        "sextantal": "each heading at two speeds, or a log of the speed through the water",
        "octantal": "each heading at two speeds, or a log of the speed through the water",
        "heading_slip": "the first headings swung again at the end",
        "compass_drift": "the first headings swung again at the end",
        "hard_iron_step": "the first headings swung again, each at two speeds",
        "hard_iron_drift": "the first headings swung again, each at two speeds",
    },
    east_m_s=parameter("m/s", "current towards east", 0.05),
    north_m_s=parameter("m/s", "current towards north", 0.05),
)  # fmt: skip
TidalSetAndDrift = _drift(
    "TidalSetAndDrift", "A current that changes linearly along the log carries the ship.",
    lambda term, scene: term.values[:2] + term.values[2:] * (scene.elapsed_share[:, None] - 0.5),
    east_m_s=parameter("m/s", "current towards east in the middle of the log", 0.05),
    north_m_s=parameter("m/s", "current towards north in the middle of the log", 0.05),
    east_gain_m_s=parameter("m/s over the record", "gain towards east", 0.05),
    north_gain_m_s=parameter("m/s over the record", "gain towards north", 0.05),
)  # fmt: skip
LateReading = _late(
    "LateReading", "The reading of the compass is delayed by a constant time.", lambda term, _: term.lag_s,
    name="compass_lag",
    literature="a delay; for slow turns its first order, reading minus lag times the rate of turn",
    lag_s=parameter("s", "time by which the reading is late", 1.0),
)  # fmt: skip
LateCourse = _late(
    "LateCourse",
    "The course over ground is delayed by a constant time, by a receiver's filter or a hull sliding on in a turn.",
    lambda term, _: -term.lag_s,
    name="course_lag", shows_along=("turn_rate",), side="reference",
    words="the course over ground lags: the receiver filters it, and a hull slides on in a turn",
    separated_by={"clock_offset": "headings and courses logged by one clock"},
    literature="a delay; for slow turns its first order, course minus lag times the rate of turn",
    lag_s=parameter("s", "time by which the course is late", 1.0),
)  # fmt: skip
ClocksApart = additive(
    "ClocksApart", "Headings and courses were logged by clocks that differ by a constant.",
    lambda term, _: term.offset_s,
    name="clock_offset", recordings=("swing",), side="clock", stage="clock", acts_on="time",
    literature="time of the compass minus that of the receiver",
    offset_s=parameter("s", "the compass's clock minus the receiver's", 1.0),
)  # fmt: skip


@dataclass(frozen=True)
class FilteredCourse(Effect):
    """The course over ground follows the heading through a first-order low-pass filter."""

    name, driver = "course_lag", "turn_rate"
    recordings = ("swing",)
    side, stage, acts_on = "reference", "readout", "reading"
    literature = "a filter of first order of the velocity: a receiver's, or the inertia of a hull"

    lag_s: float = parameter("s", "mean delay of the filter", 1.0)

    @property
    def possible(self) -> bool:
        return self.lag_s >= 0.0

    def apply(self, x: Floats, scene: Scene) -> Floats:
        return self.delayed(x)

    def delayed(self, x: Floats) -> Floats:
        """Filter headings sampled once per second, not wrapped, (n,) degrees; a negative lag gives a lead."""
        size = abs(self.lag_s)
        kernel = (size / (1.0 + size)) ** np.arange(int(5.0 * size) + 2) / (1.0 + size)  # five time constants
        unit = angles.phasor(np.concatenate([np.full(len(kernel) - 1, x[0]), x]))
        late = angles.difference(angles.argument(np.convolve(unit, kernel, "valid")), x)
        return np.asarray(x + np.sign(self.lag_s) * late)
