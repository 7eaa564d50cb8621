"""Large deviation: the small-angle series is too small a model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, parameter


@dataclass(frozen=True)
class LargeDeviation(Term):
    """The reading is that of the exact compass, not that of the series."""

    name: ClassVar[str] = "large_deviation"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "Le Menn et al. 2023, eq. (4), against von Appen 2015, eq. (1), its first order"
    needs: ClassVar[tuple[str, ...]] = ("exact_minus_series",)

    share: float = parameter("1", "of the difference; 1 is the exact compass", 0.2)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the difference of the two compasses added."""
        return x + self.share * scene.departures["exact_minus_series"]
