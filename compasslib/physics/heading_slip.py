"""A mount that slips: the compass sits at another angle from a date on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.term import Floats, Scene, Term, date, parameter


@dataclass(frozen=True)
class HeadingSlip(Term):
    """The reading is shifted from a date on: a step in A."""

    name: ClassVar[str] = "heading_slip"
    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "a step of A in von Appen 2015, eq. (1); reading clockwise positive"

    offset_deg: float = parameter("degrees", "of the reading after the date", 1.0)
    date_s: float = date()

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the slip."""
        return x + self.offset_deg * scene.since(self.date_s)
