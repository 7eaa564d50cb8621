"""Motion of the mooring: the sphere is carried to and fro as the flow changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class MooringMotion(Term):
    """The instrument's own velocity is missing from what it measures, across the flow while the lean turns."""

    name: ClassVar[str] = "mooring_motion"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "excursion proportional to speed squared; true minus measured direction, clockwise"
    needs: ClassVar[tuple[str, ...]] = ("excursion_turn",)
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)

    m_s2_m2: float = parameter("m/(m/s)^2", "excursion by speed squared", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer; the departure is its degrees for an excursion of 1 m at 1 m/s."""
        return x + self.m_s2_m2 * scene.departures["excursion_turn"]
