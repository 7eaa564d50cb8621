"""A tilt sensor that sticks: the compass levels with the wrong tilt."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib import compass
from compasslib.physics.term import Floats, Scene, Term, date, parameter


@dataclass(frozen=True)
class StuckTilt(Term):
    """From a date on the compass levels with tilts that are off by constants from the true ones."""

    name: ClassVar[str] = "stuck_tilt"
    stage: ClassVar = "sensor"
    literature: ClassVar[str] = (
        "physics page, section 4: n = T(sensed) m; sensed minus true tilt, forward up, starboard down"
    )
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)  # the true tilt must be known from elsewhere

    pitch_deg: float = parameter("degrees", "sensed minus true pitch", 0.2)
    roll_deg: float = parameter("degrees", "sensed minus true roll", 0.2)
    date_s: float = date()

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field that, levelled rightly, gives what the wrong levelling gives."""
        stuck = scene.since(self.date_s)
        right = scene.levelling
        wrong = compass.levelling(scene.pitch_deg + self.pitch_deg * stuck, scene.roll_deg + self.roll_deg * stuck)
        return np.einsum("nji,njk,nk->ni", right, wrong, x)


@dataclass(frozen=True)
class StuckTiltOfLean(Term):
    """While the tilts stick, the compass levels without the lean that the flow then gave the instrument."""

    name: ClassVar[str] = "stuck_tilt"
    stage: ClassVar = "sensor"
    literature: ClassVar[str] = "physics page, section 4: n = T(stuck) m; 1: all of the lean that the flow foretells"
    needs: ClassVar[tuple[str, ...]] = ("lean_pitch", "lean_roll")
    recordings: ClassVar[tuple[str, ...]] = ("mooring",)
    evident: ClassVar[bool] = True  # a sensor that shows one value for weeks

    share: float = parameter("1", "of the foretold lean", 0.05, least=0.3, most=2.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field of the leaning body in place of that of the body as the tilts have it."""
        pitch, roll = (scene.departures[name] for name in self.needs)
        right = compass.levelling(scene.pitch_deg + self.share * pitch, scene.roll_deg + self.share * roll)
        return np.einsum("nji,njk,nk->ni", right, scene.levelling, x)
