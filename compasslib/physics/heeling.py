"""Heeling error: iron along the instrument's own vertical turns into the horizontal when it tilts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class Heeling(Term):
    """A constant field along the body's vertical is added; the levelling brings it into the heading."""

    name: ClassVar[str] = "heeling"
    literature: ClassVar[str] = "physics page, section 4: n = T m, so tilt turns b_z into q; left out by von Appen 2015"

    b_z_nT: float = parameter("nT", "field down, induced part (S33 - S11) Z included", 1000.0, least=-25e3, most=25e3)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the vertical iron's added."""
        return x + np.array([0.0, 0.0, self.b_z_nT])
