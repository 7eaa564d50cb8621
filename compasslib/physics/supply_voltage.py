"""Supply voltage: the current that the battery gives, and its stray field, change as it runs down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, horizontal, parameter


@dataclass(frozen=True)
class SupplyVoltageOfField(Term):
    """A horizontal field in the body frame grows with the supply voltage."""

    name: ClassVar[str] = "supply_voltage"
    stage: ClassVar = "sensor"
    literature: ClassVar[str] = "stray field of the supply current; forward and starboard positive"
    needs: ClassVar[tuple[str, ...]] = ("supply_voltage",)

    b_x_nT_V: float = parameter("nT/V", "forward; V or counts as logged", 100.0)
    b_y_nT_V: float = parameter("nT/V", "to starboard; V or counts as logged", 100.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the supply's added."""
        volt = scene.departures["supply_voltage"]
        return x + horizontal(self.b_x_nT_V * volt, self.b_y_nT_V * volt)


@dataclass(frozen=True)
class SupplyVoltageOfReading(Term):
    """The reading grows with the supply voltage."""

    name: ClassVar[str] = "supply_voltage"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "reference voltage of the readout; clockwise positive"
    needs: ClassVar[tuple[str, ...]] = ("supply_voltage",)

    deg_V: float = parameter("degrees/V", "of the reading; V or counts as logged", 0.5)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading shifted by the supply voltage."""
        return x + self.deg_V * scene.departures["supply_voltage"]
