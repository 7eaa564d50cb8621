"""Soft iron: parts that the earth's field magnetises."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class SoftIron(Term):
    """The field is multiplied by a matrix; the trace cannot be seen in a heading and stays what it is."""

    name: ClassVar[str] = "soft_iron"
    literature: ClassVar[str] = "Poisson's a to h; Le Menn et al. 2023, eq. (1); physics page, section 3"
    recordings: ClassVar[tuple[str, ...]] = ("magnetometer",)  # elsewhere A, D, E of the fitted curve hold it

    stretch: float = parameter("1", "(a - e)/2, forward against starboard", 0.02)
    shear: float = parameter("1", "(d + b)/2", 0.02)
    turn: float = parameter("1", "(d - b)/2", 0.02)
    c: float = parameter("1", "forward field by the vertical one", 0.005)
    f: float = parameter("1", "starboard field by the vertical one", 0.005)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the field with the induced one added."""
        rows = [[self.stretch, self.shear - self.turn, self.c], [self.shear + self.turn, -self.stretch, self.f]]
        return x + x @ np.array([*rows, [0.0, 0.0, 0.0]]).T
