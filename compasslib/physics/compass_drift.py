"""Drift of the compass: A changes over the deployment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class CompassDrift(Term):
    """The reading drifts with time."""

    name: ClassVar[str] = "compass_drift"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "A of von Appen 2015, eq. (1), linear in time; reading clockwise positive"

    deg_year: float = parameter("degrees/year", "of the reading", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with what has drifted by then."""
        return x + self.deg_year * scene.years
