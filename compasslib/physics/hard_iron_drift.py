"""Drift of the hard iron: steel that loses or gains magnetisation over the deployment."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, horizontal, parameter


@dataclass(frozen=True)
class HardIronDrift(Term):
    """A horizontal field in the body frame grows with time."""

    name: ClassVar[str] = "hard_iron_drift"
    literature: ClassVar[str] = "Poisson's P and Q, linear in time; forward and starboard positive"

    b_x_nT_year: float = parameter("nT/year", "rate forward", 200.0)
    b_y_nT_year: float = parameter("nT/year", "rate to starboard", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with what has grown by then."""
        return x + horizontal(self.b_x_nT_year * scene.years, self.b_y_nT_year * scene.years)
