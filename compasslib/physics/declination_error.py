"""Declination error: a wrong number in the metadata."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class DeclinationError(Term):
    """Magnetic north lies elsewhere than the declination that was applied says, by the same angle always."""

    name: ClassVar[str] = "declination_error"
    acts_on: ClassVar = "north"
    literature: ClassVar[str] = "von Appen 2015, eq. (2): the same as A, a mean veer and a turned mount; east positive"

    error_deg: float = parameter("degrees", "true minus applied declination", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the direction of magnetic north."""
        return x + self.error_deg
