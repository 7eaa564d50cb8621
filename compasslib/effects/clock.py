"""Clock offset: the instrument's clock is ahead or behind."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.core.types import Floats
from compasslib.effects.term import Scene, Term, parameter


@dataclass(frozen=True)
class ClockOffset(Term):
    """The compromised instrument's clock is ahead of the trusted one's by a constant."""

    name: ClassVar[str] = "clock_offset"
    side: ClassVar = "clock"
    stage: ClassVar = "clock"
    acts_on: ClassVar = "time"
    literature: ClassVar[str] = "instrument clock minus UTC, positive ahead"
    recordings: ClassVar[tuple[str, ...]] = ("mooring", "two_heads")

    hours: float = parameter("h", "compromised minus trusted clock", 0.3)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the clock's error, seconds."""
        return x + 3600.0 * self.hours


# Clock drift: the instrument's clock runs fast or slow.


@dataclass(frozen=True)
class ClockDrift(Term):
    """The compromised instrument's clock gains on the trusted one's."""

    name: ClassVar[str] = "clock_drift"
    side: ClassVar = "clock"
    stage: ClassVar = "clock"
    acts_on: ClassVar = "time"
    literature: ClassVar[str] = "instrument clock minus UTC, growing from the beginning, positive ahead"
    recordings: ClassVar[tuple[str, ...]] = ("mooring", "two_heads")

    hours_year: float = parameter("h/year", "gain of the compromised clock", 0.3)

    def act(self, x: Floats, scene: Scene) -> Floats:
        """Return the clock's error, seconds."""
        return x + 3600.0 * self.hours_year * scene.years
