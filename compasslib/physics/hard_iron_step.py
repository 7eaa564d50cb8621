"""Step of the hard iron: a knock, a shackle that shifts, gear that comes or goes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, date, horizontal, parameter

LARGEST_NT = 6000.0  # a sphere's own iron is of this size; more does not come or go under water


@dataclass(frozen=True)
class HardIronStep(Term):
    """A horizontal field in the body frame is there from a date on."""

    name: ClassVar[str] = "hard_iron_step"
    literature: ClassVar[str] = "Poisson's P and Q, a step in time; forward and starboard positive"

    b_x_nT: float = parameter("nT", "step forward", 200.0, least=-LARGEST_NT, most=LARGEST_NT)
    b_y_nT: float = parameter("nT", "step to starboard", 200.0, least=-LARGEST_NT, most=LARGEST_NT)
    date_s: float = date()

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the step."""
        return x + horizontal(self.b_x_nT * scene.since(self.date_s), self.b_y_nT * scene.since(self.date_s))
