"""A harmonic of the recorded heading: a readout or a calibration table with teeth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib import angles
from compasslib.physics.term import Floats, Scene, Term, parameter

FLATTEST = 0.2  # least slope of a reading that is believed: a readout that hardly turns with the field is none
POLISHED = 4  # Newton's steps from a table of whole degrees: the last digit of a double


@dataclass(frozen=True)
class Harmonic(Term):
    """The reading is shifted by a harmonic of what the compass would have recorded."""

    order: ClassVar[float]
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"

    sine_deg: float = parameter("degrees", "times the sine", 1.0)
    cosine_deg: float = parameter("degrees", "times the cosine", 1.0)

    @property
    def believable(self) -> bool:
        """Whether the reading always turns with the field: the order times the amplitude is well under a radian."""
        return self._flattest >= FLATTEST

    @property
    def _flattest(self) -> float:
        return 1.0 - self.order * angles.DEGREE * float(np.hypot(self.sine_deg, self.cosine_deg))

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the harmonic added."""
        sine, cosine = angles.sin_cos(self.order * x)
        return x + self.sine_deg * sine + self.cosine_deg * cosine

    def undone(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Return what the reading was made of; NaN everywhere where some readings have three such angles."""
        if self._flattest <= 0.0:
            return np.full_like(reading_deg, np.nan)
        period = 360.0 / self.order
        whole = np.linspace(0.0, period, int(period) + 1)
        begins = self.act(whole[:1], scene)
        turns = np.floor((reading_deg - begins) / period)
        x = period * turns + np.interp(reading_deg - period * turns, self.act(whole, scene), whole)
        for _ in range(POLISHED):
            sine, cosine = angles.sin_cos(self.order * x)
            slope = 1.0 + self.order * angles.DEGREE * (self.sine_deg * cosine - self.cosine_deg * sine)
            x = x + (reading_deg - self.act(x, scene)) / slope
        return np.asarray(x)
