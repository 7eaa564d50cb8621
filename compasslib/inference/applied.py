"""The compass with the terms that were found on its side, as a correction needs it: for any sample of the instrument.

It gives the correct headings of a recorded one with the terms' covariates at that sample, and what the fit does not
know of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib.deviation import model, spread
from compasslib.deviation.along import Along
from compasslib.deviation.model import Fit
from compasslib.effects import Scene, composition
from compasslib.effects.composition import Simulation
from compasslib.inference import covariates
from compasslib.records import EarthField
from compasslib.types import Floats

FROM_TILT = ("pitch", "roll", "tilt")
FROM_RECORD = (*FROM_TILT, "turn_rate")  # what every record has


@dataclass(frozen=True)
class Applied:
    """A compass with terms, fitted to a record."""

    simulation: Simulation
    covariance: Floats  # (p, p) of A..E and the terms' parameters
    references: Mapping[str, float]  # what the terms' departures count from, by covariate
    logged: tuple[str, ...]  # series beside heading and tilt without which the terms cannot be applied

    def scene(
        self,
        time_s: Floats,
        recorded_deg: Floats,
        tilt_deg: tuple[Floats, Floats],
        series: Mapping[str, Floats],
        *,
        field: EarthField,
    ) -> Scene:
        """Return in what samples of the affected instrument were made; what is missing counts as the reference.

        Args:
            time_s: (n,) increasing, UTC seconds.
            recorded_deg: recorded headings, (n,), degrees.
            tilt_deg: pitch and roll, (n,) each, degrees.
            series: the logged covariates, (n,) each.
        """
        used = {name: covariates.as_used(name, column, time_s) for name, column in series.items()}
        found = {name: np.nan_to_num(used[name] - self.references[name]) for name in self.logged if name in used}
        found |= {name: np.zeros(len(time_s)) for name in self.logged if name not in (*series, *FROM_TILT)}
        if "supply_voltage" in used:
            filled = covariates.filled(used["supply_voltage"])
            found["battery_number"] = covariates.battery_number(filled)
        leans = dict(zip(("pitch", "roll"), (np.nan_to_num(x) for x in tilt_deg), strict=True))
        leans["tilt"] = np.hypot(leans["pitch"], leans["roll"])
        found |= {name: lean - self.references[name] for name, lean in leans.items() if name in self.references}
        found["turn_rate"] = np.nan_to_num(covariates.rate(recorded_deg, time_s))
        h, z = (np.interp(time_s, field.time_s, x) for x in (field.horizontal_nT, field.vertical_nT))
        pitch, roll = (np.nan_to_num(x) for x in tilt_deg)
        return Scene(time_s, h, z, pitch, roll, self.references["time"], found)

    def along(self, scene: Scene, recorded_deg: Floats) -> Along:
        """Return the compass at every sample.

        Args:
            recorded_deg: recorded headings, (n,), degrees, NaN where there is none.
        """
        return Along(
            reading_deg=composition.undone_readout(self.simulation, scene, recorded_deg),
            coefficients=composition.coefficients_at(self.simulation, scene),
            covariance=self.covariance,
            sensitivity=lambda heading_deg: composition.derivative(self.simulation, scene, heading_deg),
            north_deg=composition.north(self.simulation, scene),
            tilted=any(term.name == "heeling" for term in self.simulation.terms),
        )

    def to_json(self) -> dict[str, Any]:
        """Return it for diagnosis.json."""
        return {
            "coefficients": dict(zip(model.LETTERS, self.simulation.coefficients.tolist(), strict=True)),
            "horizontal_nT": self.simulation.horizontal_nT,
            "terms": [
                {"effect": term.name, "form": type(term).__name__} | vars(term) for term in self.simulation.terms
            ],
            "covariance": self.covariance.tolist(),
            "references": dict(self.references),
            "logged": list(self.logged),
        }


@dataclass(frozen=True)
class Member:
    """One hypothesis of those whose average corrects a record."""

    weight: float  # probability
    effect: str  # names joined by +, or none
    compass: Applied | None  # None where the fit by itself is it

    def to_json(self) -> dict[str, Any]:
        """Return it for deviation.json."""
        compass = None if self.compass is None else self.compass.to_json()
        return {"effect": self.effect, "weight": self.weight, "compass": compass}


def as_unsure(fit: Fit, covariance: Floats) -> Fit:
    """Return the fit with coefficients no surer than what the search makes of them, slow water being in its noise.

    Args:
        covariance: of A..E, (5, 5).
    """
    own = fit.covariance.copy()
    own[:5, :5] += spread.positive_part(covariance - own[:5, :5])
    return replace(fit, covariance=own)


def no_surer(member: Member, fit: Fit) -> Member:
    """Return a compass with coefficients that are no surer than the fit by itself has them.

    The search judges by blocks of days. These do not show water that veers for months by its direction, nor veer in
    step with the heading, and the fit counts both (``deviation.spread``).

    Args:
        fit: the exact compass without terms.
    """
    if member.compass is None:
        return member
    covariance = member.compass.covariance.copy()
    covariance[:5, :5] += spread.positive_part(fit.covariance[:5, :5] - covariance[:5, :5])
    return replace(member, compass=replace(member.compass, covariance=covariance))
