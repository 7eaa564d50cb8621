"""A recording, its simulation and what was logged beside it: all that the search for left-out physics needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from compasslib.core.types import Floats
from compasslib.effects.composition import Simulation
from compasslib.effects.term import Scene, Term


@dataclass(frozen=True)
class Case:
    """One recording held against its simulation; n samples in the order of time."""

    kind: str  # mooring | platform | swing | magnetometer | declination | two_heads
    simulation: Simulation  # what the recording is held against
    scene: Scene  # in what it was made, with the departures that terms need
    recorded_deg: Floats  # (n,) heading that the compromised compass gave
    observed_deg: Floats  # (n,) heading that the trusted side shows
    slowness: Floats  # (n,) what widens the scatter, 1/speed; 0 where nothing does
    expected_deg: (
        Floats  # (n,) width of the scatter as the fit has it; two headings nearer than a few are not told apart
    )
    precision_deg: float  # noise of the recorded heading itself
    covariates: Mapping[str, Floats]  # (n,) each; what the omnibus tests look along
    nuisance: Floats  # (n, k) columns that are fitted and never named
    terms: tuple[type[Term], ...]  # that can be tested here
    not_testable: tuple[tuple[str, str], ...] = ()  # (effect, why)

    def __len__(self) -> int:
        return len(self.recorded_deg)
