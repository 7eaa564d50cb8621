"""A battery change: another battery is other iron."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, horizontal, parameter


@dataclass(frozen=True)
class BatteryChange(Term):
    """A horizontal field in the body frame is there from each jump of the supply voltage on; every jump has its own."""

    name: ClassVar[str] = "battery_change"
    literature: ClassVar[str] = "Poisson's P and Q, a step with each battery; forward and starboard positive"
    needs: ClassVar[tuple[str, ...]] = ("battery_number",)

    b_x_nT: float = parameter("nT", "step forward", 200.0)
    b_y_nT: float = parameter("nT", "step to starboard", 200.0)
    second_x_nT: float = parameter("nT", "step forward at the second change", 200.0)
    second_y_nT: float = parameter("nT", "step to starboard at the second change", 200.0)
    third_x_nT: float = parameter("nT", "step forward at the third change and each later one", 200.0)
    third_y_nT: float = parameter("nT", "step to starboard at the third change and each later one", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the new batteries'; the departure counts them."""
        number = scene.departures["battery_number"]
        first, second, third = number.clip(0.0, 1.0), (number - 1.0).clip(0.0, 1.0), (number - 2.0).clip(0.0)
        forward = self.b_x_nT * first + self.second_x_nT * second + self.third_x_nT * third
        return x + horizontal(forward, self.b_y_nT * first + self.second_y_nT * second + self.third_y_nT * third)
