"""The third harmonic of the recorded heading: a readout or a calibration table with teeth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib import angles
from compasslib.physics.term import Floats, Scene, Term, parameter

STRONGEST_DEG = 15.0  # more would leave a reading that hardly turns with the instrument


@dataclass(frozen=True)
class Sextantal(Term):
    """The reading is shifted by the third harmonic of what the compass would have recorded."""

    name: ClassVar[str] = "sextantal"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "Moncunill et al. 2023, section 5.3 (sextantal); clockwise positive"

    sine_deg: float = parameter("degrees", "times sin 3 gamma", 1.0, least=-STRONGEST_DEG, most=STRONGEST_DEG)
    cosine_deg: float = parameter("degrees", "times cos 3 gamma", 1.0, least=-STRONGEST_DEG, most=STRONGEST_DEG)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the harmonic added."""
        sine, cosine = angles.sin_cos(3.0 * x)
        return x + self.sine_deg * sine + self.cosine_deg * cosine
