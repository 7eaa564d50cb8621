"""Hard iron: magnetised parts fixed to the instrument."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class HardIron(Term):
    """A constant field in the body frame is added."""

    name: ClassVar[str] = "hard_iron"
    literature: ClassVar[str] = "Poisson's P, Q, R; Le Menn et al. 2023, eq. (1); forward, starboard, down positive"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)  # elsewhere B and C of the fitted curve hold it

    b_x_nT: float = parameter("nT", "field forward", 200.0)
    b_y_nT: float = parameter("nT", "field to starboard", 200.0)
    b_z_nT: float = parameter("nT", "field down", 2000.0)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the iron's added."""
        return x + np.array([self.b_x_nT, self.b_y_nT, self.b_z_nT])
