"""The third harmonic of the recorded heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from compasslib.physics.harmonic import Harmonic


@dataclass(frozen=True)
class Sextantal(Harmonic):
    """The reading is shifted by the third harmonic of what the compass would have recorded."""

    name: ClassVar[str] = "sextantal"
    order: ClassVar[float] = 3.0
    literature: ClassVar[str] = "Moncunill et al. 2023, section 5.3 (sextantal); clockwise positive"
