"""Set and drift of the water: a ship's track over ground is not its heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class WaterDrift(Term):
    """The water carries the ship sideways; the course over ground leaves the heading by drift over speed."""

    name: ClassVar[str] = "water_drift"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = (
        "Moncunill et al. 2023, eqs. (29)-(37), first order in drift over speed; course minus heading"
    )
    needs: ClassVar[tuple[str, ...]] = ("drift_east_deg", "drift_north_deg")
    recordings: ClassVar[tuple[str, ...]] = ("swing",)

    east_m_s: float = parameter("m/s", "water towards east", 0.05)
    north_m_s: float = parameter("m/s", "water towards north", 0.05)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return course minus heading; the departures are its degrees for a drift of 1 m/s."""
        return (
            x
            + self.east_m_s * scene.departures["drift_east_deg"]
            + self.north_m_s * scene.departures["drift_north_deg"]
        )
