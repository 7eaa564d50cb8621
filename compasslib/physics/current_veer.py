"""Veer of the current between the two depths."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter

# In narrow headings the harmonics stand for each other, up to 60 degrees each. Real veer ran from +22 to -7 degrees.
USUAL_DEG = 15.0


@dataclass(frozen=True)
class VeerWithSpeed(Term):
    """The lower water veers from the upper one the more, the faster it flows."""

    name: ClassVar[str] = "current_veer"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "von Appen 2015, appendix, assumes none; lower minus upper direction, clockwise"
    needs: ClassVar[tuple[str, ...]] = ("speed",)
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)

    deg_s_m: float = parameter("degrees/(m/s)", "veer by speed", 5.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        return x + self.deg_s_m * scene.departures["speed"]


@dataclass(frozen=True)
class VeerWithSeparation(Term):
    """The lower water veers from the upper one in proportion to the metres between them."""

    name: ClassVar[str] = "current_veer"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "Ekman's spiral, linear over few metres; lower minus upper direction, clockwise"
    needs: ClassVar[tuple[str, ...]] = ("separation",)
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)

    deg_m: float = parameter("degrees/m", "veer by metres of separation", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        return x + self.deg_m * scene.departures["separation"]


@dataclass(frozen=True)
class VeerWithDepth(Term):
    """The lower water veers from the upper one as the pair is blown down to other water."""

    name: ClassVar[str] = "current_veer"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "veer of the water column, linear in depth; lower minus upper direction, clockwise"
    needs: ClassVar[tuple[str, ...]] = ("depth",)
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)

    deg_100m: float = parameter("degrees/100 m", "veer by depth", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        return x + self.deg_100m * scene.departures["depth"] / 100.0


@dataclass(frozen=True)
class VeerWithDirection(Term):
    """The lower water veers from the upper one by another angle for each direction of the flow."""

    name: ClassVar[str] = "current_veer"
    side: ClassVar = "water"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "steering by topography, two harmonics; lower minus upper direction, clockwise"
    needs: ClassVar[tuple[str, ...]] = ("flow_east", "flow_north", "flow_sine2", "flow_cosine2")
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)

    sine_deg: float = parameter("degrees", "times the sine of the flow's direction", 1.0, usual=USUAL_DEG)
    cosine_deg: float = parameter("degrees", "times its cosine", 1.0, usual=USUAL_DEG)
    sine2_deg: float = parameter("degrees", "times the sine of its double", 1.0, usual=USUAL_DEG)
    cosine2_deg: float = parameter("degrees", "times the cosine of its double", 1.0, usual=USUAL_DEG)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the veer."""
        flow = (scene.departures[name] for name in self.needs)
        return x + sum(size * part for size, part in zip(self.values, flow, strict=True))
