"""Eddy currents: metal that turns in the earth's field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib import angles
from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class RotationRate(Term):
    """The field of the currents that a turn induces is added: proportional to the field's rate of change."""

    name: ClassVar[str] = "rotation_rate"
    literature: ClassVar[str] = "Tolles and Lawson's eddy terms, isotropic in the plane; clockwise turn positive"
    needs: ClassVar[tuple[str, ...]] = ("turn_rate",)
    recordings: ClassVar[tuple[str, ...]] = ("swing", "magnetometer")  # hourly samples do not resolve a turn

    delay_s: float = parameter("s", "induced field over the field's rate of change", 0.5)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the eddies' added: a body that turns clockwise sees the field turn the other way."""
        spin = self.delay_s * angles.DEGREE * scene.departures["turn_rate"]
        return x + np.stack([spin * x[:, 1], -spin * x[:, 0], np.zeros(len(x))], axis=-1)
