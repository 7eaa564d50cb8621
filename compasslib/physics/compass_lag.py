"""Lag of the compass: a damped needle or filter reads an earlier heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class CompassLag(Term):
    """The reading is what the heading was some time before."""

    name: ClassVar[str] = "compass_lag"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "first order: reading minus lag times its rate of turn, clockwise positive"
    needs: ClassVar[tuple[str, ...]] = ("turn_rate",)

    lag_s: float = parameter("s", "time by which the reading is late", 300.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the late reading."""
        return x - self.lag_s * scene.departures["turn_rate"]
