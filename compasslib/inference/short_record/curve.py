"""A compass whose correct heading is known, held against its fitted curve: benches, swings, heads on one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.deviation import von_appen
from compasslib.effects import composition
from compasslib.effects.composition import Simulation
from compasslib.effects.term import Scene, Term
from compasslib.types import Floats

# Without a place the field is of this strength, and the iron is in percent of it.
PLACELESS_NT, PERCENT = 20000.0, (100.0 / 20000.0, "% of the horizontal field")


@dataclass(frozen=True)
class Compass:
    """The exact compass; its residual is one of the recorded heading, which every correct heading has."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return simulated minus recorded heading, (n,) degrees: the sign of observed minus simulated correct ones."""
        simulation = Simulation(base, float(np.mean(self.scene.horizontal_nT)), terms)
        correct = self.correct_deg - composition.veer(simulation, self.scene)
        return angles.difference(composition.recorded_heading(simulation, self.scene, correct), self.recorded_deg)


@dataclass(frozen=True)
class SmithSeries:
    """Smith's five terms in the recorded heading, degrees; terms act on the reading."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Term, ...]) -> Floats:
        """Return observed minus simulated correct heading, (n,) degrees."""
        bare = Simulation(np.zeros(5), float(np.mean(self.scene.horizontal_nT)), terms)
        reading = composition.undone_readout(bare, self.scene, self.recorded_deg)
        corrected = reading + von_appen.design(reading) @ base
        return angles.difference(self.correct_deg, corrected + composition.veer(bare, self.scene))


def scene(
    time_s: Floats,
    field: Mapping[str, float] | None,
    *,
    tilt_deg: tuple[Floats, Floats] | None = None,
    departures: Mapping[str, Floats] | None = None,
) -> tuple[Scene, tuple[float, str]]:
    """Return in what a recording was made, and the unit of its iron.

    Args:
        time_s: (n,), UTC seconds or numbers of readings.
        field: {horizontal_nT, vertical_nT}, None where the place is unknown.
        tilt_deg: pitch and roll, (n,) each.
        departures: what terms need, (n,) each.
    """
    one, zero = np.ones(len(time_s)), np.zeros(len(time_s))
    h, z = (PLACELESS_NT, 0.0) if field is None else (field["horizontal_nT"], field["vertical_nT"])
    pitch, roll = tilt_deg or (zero, zero)
    unit = PERCENT if field is None else (1.0, "nT")
    return Scene(time_s, h * one, z * one, pitch, roll, float(time_s[0]), departures or {}), unit
