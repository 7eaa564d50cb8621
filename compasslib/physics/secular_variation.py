"""Secular variation: magnetic north drifts over the years."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class SecularVariation(Term):
    """Magnetic north drifts faster than the declination that was applied says."""

    name: ClassVar[str] = "secular_variation"
    acts_on: ClassVar = "north"
    literature: ClassVar[str] = "IGRF's rate of change; east positive"

    deg_year: float = parameter("degrees/year", "drift beyond what was applied", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the direction of magnetic north by then."""
        return x + self.deg_year * scene.years
