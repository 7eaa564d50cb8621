"""Storms and daily variation: magnetic north itself moves."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class FieldDisturbance(Term):
    """Magnetic north moves by a share of what an observatory recorded."""

    name: ClassVar[str] = "field_disturbance"
    acts_on: ClassVar = "north"
    literature: ClassVar[str] = "declination of an observatory minus its quiet value; east positive"
    needs: ClassVar[tuple[str, ...]] = ("declination_observatory",)

    share: float = parameter("1", "of the observatory's variation", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the direction of magnetic north with the disturbance."""
        return x + self.share * scene.departures["declination_observatory"]
