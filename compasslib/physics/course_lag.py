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
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "first order: heading minus lag times its rate of turn, clockwise positive"
    needs: ClassVar[tuple[str, ...]] = ("turn_rate",)
    recordings: ClassVar[tuple[str, ...]] = ("swing",)

    lag_s: float = parameter("s", "time by which the course is late", 1.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the heading that the course shows."""
        return x - self.lag_s * scene.departures["turn_rate"]
