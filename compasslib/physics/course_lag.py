"""Lag of the course over ground: a receiver filters it, and a hull slides on in a turn."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class CourseLag(Term):
    """The course over ground is that of some time before."""

    name: ClassVar[str] = "course_lag"
    side: ClassVar = "reference"
    acts_on: ClassVar = "water"
    literature: ClassVar[str] = "first order: course minus lag times the rate of turn, clockwise positive"
    needs: ClassVar[tuple[str, ...]] = ("turn_rate",)
    recordings: ClassVar[tuple[str, ...]] = ("swing",)

    lag_s: float = parameter("s", "time by which the course is late", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return course minus heading."""
        return x - self.lag_s * scene.departures["turn_rate"]
