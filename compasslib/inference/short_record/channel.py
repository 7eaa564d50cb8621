"""A comparison whose hypotheses are each refitted in its forward model.

A long record is weighed by slopes. Recordings here have 16 readings or 20,000, noise of 0.01 degrees or 5,
and effects a thousand times the noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from compasslib.effects.term import Term
from compasslib.inference.comparison import Comparison
from compasslib.types import Floats


class Forward(Protocol):
    """Observed minus simulated, (n,) degrees, for base parameters (b,) and terms."""

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats: ...


@dataclass(frozen=True, kw_only=True)
class Channel(Comparison):
    """A short recording held against its simulation; n samples in the order of time."""

    residual: Forward
    start: Floats  # (b,) base parameters of the simulation, before any fit
    steps: Floats  # (b,) a change of each that turns the heading by very roughly a degree
    confused: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effect -> effects that look the same here
    field_unit: tuple[float, str] = (1.0, "nT")  # for one nT of the forward model, and its name
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # effect -> values of its first parameter
    rule_deg: float = 0.0  # systematic error of the simulation that no number of samples averages out, rms
    independent: bool = False  # readings whose errors have no memory
    remembered: bool = False  # means over stretches whose memory is known by its law, not by its own blocks
    reads: bool = True  # whether what is compared is a reading of a compass

    def unit(self, term: Term, k: int) -> tuple[float, str]:
        """Return by what a parameter is multiplied for people, and its unit."""
        unit = term.units()[k]
        if not unit.startswith("nT"):
            return 1.0, unit
        return self.field_unit[0], self.field_unit[1] + unit.removeprefix("nT")


def thinned(length: int, most: int) -> NDArray[np.intp]:
    """Return which samples of a record stay, evenly."""
    return np.arange(0, length, max(1, -(-length // most)))
