"""The fourth harmonic of the recorded heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.harmonic import Harmonic


@dataclass(frozen=True)
class Octantal(Harmonic):
    """The reading is shifted by the fourth harmonic of what the compass would have recorded."""

    name: ClassVar[str] = "octantal"
    order: ClassVar[float] = 4.0
    literature: ClassVar[str] = "Moncunill et al. 2023, section 5.3 (octantal); clockwise positive"
