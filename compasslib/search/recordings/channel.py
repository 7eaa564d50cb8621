"""One comparison inside a recording: what was recorded, and a forward model of it that takes terms of physics.

A mooring's search is made for a year of hours. Recordings here have 16 readings or 20,000, noise of 0.01 degrees or 5,
and effects a thousand times the noise: each hypothesis is refitted in its forward model instead of linearised.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats
from compasslib.effects.term import Term


class Forward(Protocol):
    """Observed minus simulated, (n,) degrees, for base parameters (b,) and terms."""

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats: ...


@dataclass(frozen=True)
class Channel:
    """A recording held against its simulation; n samples in the order of time."""

    what: str  # is compared, in words
    residual: Forward
    start: Floats  # (b,) base parameters of the simulation, before any fit
    steps: Floats  # (b,) a change of each that turns the heading by very roughly a degree
    time_s: Floats  # (n,) increasing: UTC seconds, or the number of the reading where there is no clock
    clocked: bool
    terms: tuple[type[Term], ...]  # that can be tested
    covariates: Mapping[str, Floats]  # (n,) each; what the omnibus tests look along
    confused: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effect -> effects that look the same here
    field_unit: tuple[float, str] = (1.0, "nT")  # for one nT of the forward model, and its name
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # effect -> values of its first parameter
    rule_deg: float = 0.0  # systematic error of the simulation that no number of samples averages out, rms
    independent: bool = False  # readings whose errors have no memory
    remembered: bool = False  # means over stretches whose memory is known by its law, not by its own blocks
    reads: bool = True  # whether what is compared is a reading of a compass

    def __len__(self) -> int:
        return len(self.time_s)

    def unit(self, term: Term, k: int) -> tuple[float, str]:
        """Return by what a parameter is multiplied for people, and its unit."""
        unit = term.units()[k]
        if not unit.startswith("nT"):
            return 1.0, unit
        return self.field_unit[0], self.field_unit[1] + unit.removeprefix("nT")


def thinned(length: int, most: int) -> NDArray[np.intp]:
    """Return which samples of a record stay, evenly."""
    return np.arange(0, length, max(1, -(-length // most)))
