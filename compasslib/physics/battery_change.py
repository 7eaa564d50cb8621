"""A battery change: another battery is other iron."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, horizontal, parameter


@dataclass(frozen=True)
class BatteryChange(Term):
    """A horizontal field in the body frame is there from the jump of the supply voltage on."""

    name: ClassVar[str] = "battery_change"
    literature: ClassVar[str] = "Poisson's P and Q, a step with the battery; forward and starboard positive"
    needs: ClassVar[tuple[str, ...]] = ("battery_number",)

    b_x_nT: float = parameter("nT", "step forward", 200.0)
    b_y_nT: float = parameter("nT", "step to starboard", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the new battery's; the departure counts the batteries."""
        number = scene.departures["battery_number"]
        return x + horizontal(self.b_x_nT * number, self.b_y_nT * number)
