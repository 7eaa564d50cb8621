"""Degrees of declination that stand in what an instrument recorded, in its headings and in its velocities."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Applied(NamedTuple):
    """Degrees east inside recorded headings and inside recorded earth velocities."""

    heading: float
    velocity: float

    @property
    def differs(self) -> bool:
        """Whether only one of them was rotated, or each by its own angle."""
        return self.heading != self.velocity

    def __str__(self) -> str:
        return f"{{heading: {self.heading:g}, velocity: {self.velocity:g}}}" if self.differs else f"{self.heading:g}"


def applied(stated: float | Mapping[str, float] | None) -> Applied | None:
    """Return ``declination_applied`` of a mooring file, one number for both or one for each; None where it has none."""
    if stated is None:
        return None
    if isinstance(stated, Mapping):
        return Applied(float(stated["heading"]), float(stated["velocity"]))
    return Applied(float(stated), float(stated))
