"""Tilt that is not compensated: the compass takes the angle in its own plane, not in the level one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class TiltUncompensated(Term):
    """A share of the levelling is left out."""

    name: ClassVar[str] = "tilt_uncompensated"
    stage: ClassVar = "sensor"
    literature: ClassVar[str] = "physics page, section 4: n = m instead of T m; 1 means no compensation at all"

    share: float = parameter("1", "of the levelling that is left out", 0.05, least=0.65, most=1.5)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field that, levelled rightly, gives what is left without levelling."""
        level = scene.levelling
        return (1.0 - self.share) * x + self.share * np.einsum("nji,nj->ni", level, x)
