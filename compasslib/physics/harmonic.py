"""A harmonic of the recorded heading: a readout or a calibration table with teeth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib import angles
from compasslib.physics.term import Floats, Scene, Term, parameter

STRONGEST_DEG = 15.0  # more would leave a reading that hardly turns with the instrument


@dataclass(frozen=True)
class Harmonic(Term):
    """The reading is shifted by a harmonic of what the compass would have recorded."""

    order: ClassVar[float]
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"

    sine_deg: float = parameter("degrees", "times the sine", 1.0, least=-STRONGEST_DEG, most=STRONGEST_DEG)
    cosine_deg: float = parameter("degrees", "times the cosine", 1.0, least=-STRONGEST_DEG, most=STRONGEST_DEG)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the harmonic added."""
        sine, cosine = angles.sin_cos(self.order * x)
        return x + self.sine_deg * sine + self.cosine_deg * cosine
