"""Temperature: the magnetometer's zero or the iron beside it change with it, or the reading does."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, horizontal, parameter


@dataclass(frozen=True)
class TemperatureOfField(Term):
    """A horizontal field in the body frame grows with temperature."""

    name: ClassVar[str] = "temperature"
    stage: ClassVar = "sensor"
    literature: ClassVar[str] = "zero shift of the magnetometer's axes; forward and starboard positive"
    needs: ClassVar[tuple[str, ...]] = ("temperature",)

    b_x_nT_K: float = parameter("nT/K", "forward", 200.0)
    b_y_nT_K: float = parameter("nT/K", "to starboard", 200.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the shift by temperature."""
        warm = scene.departures["temperature"]
        return x + horizontal(self.b_x_nT_K * warm, self.b_y_nT_K * warm)


@dataclass(frozen=True)
class TemperatureOfReading(Term):
    """The reading grows with temperature."""

    name: ClassVar[str] = "temperature"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "thermal drift of the readout; clockwise positive"
    needs: ClassVar[tuple[str, ...]] = ("temperature",)

    deg_K: float = parameter("degrees/K", "of the reading", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading shifted by temperature."""
        return x + self.deg_K * scene.departures["temperature"]
