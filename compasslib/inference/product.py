"""Represent the compass that corrects a record: the configured fit, or the exact compass with compass-side terms.

It is stored in deviation.json, which is sufficient for the correction and documents it in an archive.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.average import CompassSeries, average_coefficients, has_average
from compasslib.deviation.average import compass_series as along_of_fit
from compasslib.deviation.doubts import Doubt, doubts_from_json
from compasslib.deviation.exact import positive_part
from compasslib.deviation.model import LETTERS, DeviationFit, fit_from_json, nearest_root, observed_heading
from compasslib.effects import Scene
from compasslib.effects.forward import (
    ForwardModel,
    coefficients_with_effects,
    heading_jacobian,
    invert_readout,
    north_shift,
)
from compasslib.inference import covariates
from compasslib.records import BAD, EarthField, Pairs, Readings, Record, take
from compasslib.types import Floats

TILT_SERIES = ("pitch", "roll", "tilt")
RECORD_SERIES = (*TILT_SERIES, "turn_rate")  # series that every record has

Series = Mapping[str, Floats]


@dataclass(frozen=True)
class AppliedCompass:
    """A compass with terms, fitted to a record."""

    simulation: ForwardModel  #: compass and terms
    covariance: Floats  #: (p, p) of A..E and the terms' parameters
    references: Mapping[str, float]  #: reference value of each covariate, subtracted for the terms' departures
    logged: tuple[str, ...]  #: logged series, or tilts, that the terms require

    def scene(
        self,
        time_s: Floats,
        recorded_deg: Floats,
        tilt_deg: tuple[Floats, Floats],
        series: Mapping[str, Floats],
        *,
        field: EarthField,
    ) -> Scene:
        """Build the scene of samples of the affected instrument; missing values are set to the reference value."""
        used = {name: covariates.smooth_supply(name, column, time_s) for name, column in series.items()}
        known = {name: np.nan_to_num(used[name] - self.references[name]) for name in self.logged if name in used}
        known |= {name: np.zeros(len(time_s)) for name in self.logged if name not in (*series, *TILT_SERIES)}
        if "supply_voltage" in used:
            known["battery_number"] = covariates.battery_count(covariates.fill_gaps(used["supply_voltage"]))
        pitch, roll = (np.nan_to_num(x) for x in tilt_deg)
        tilts = {"pitch": pitch, "roll": roll, "tilt": np.hypot(pitch, roll)}
        known |= {name: lean - self.references[name] for name, lean in tilts.items() if name in self.references}
        known["turn_rate"] = np.nan_to_num(covariates.turn_rate(recorded_deg, time_s))
        h, z = (np.interp(time_s, field.time_s, x) for x in (field.horizontal_nT, field.vertical_nT))
        return Scene(time_s, h, z, pitch, roll, self.references["time"], known)

    def along(self, scene: Scene, recorded_deg: Floats) -> CompassSeries:
        """Evaluate the compass at every sample."""
        return CompassSeries(
            reading_deg=invert_readout(self.simulation, scene, recorded_deg),
            coefficients=coefficients_with_effects(self.simulation, scene),
            covariance=self.covariance,
            sensitivity=lambda heading_deg: heading_jacobian(self.simulation, scene, heading_deg),
            north_deg=north_shift(self.simulation, scene),
            tilted=any(term.name == "heeling" for term in self.simulation.terms),
        )

    def to_json(self) -> dict[str, Any]:
        return {
            "coefficients": dict(zip(LETTERS, self.simulation.coefficients.tolist(), strict=True)),
            "horizontal_nT": self.simulation.horizontal_nT,
            "terms": [
                {"effect": term.name, "form": type(term).__name__} | vars(term) for term in self.simulation.terms
            ],
            "covariance": self.covariance.tolist(),
            "references": dict(self.references),
            "logged": list(self.logged),
        }


@dataclass(frozen=True)
class WeightedCompass:
    """One of the hypotheses whose weighted average corrects a record."""

    weight: float  #: probability
    effect: str  #: names joined by +, or none
    compass: AppliedCompass | None  #: None for the fit without terms

    def to_json(self) -> dict[str, Any]:
        compass = None if self.compass is None else self.compass.to_json()
        return {"effect": self.effect, "weight": self.weight, "compass": compass}


def inflate_covariance(fit: DeviationFit, covariance: Floats) -> DeviationFit:
    """Inflate the covariance of a fit to at least that of the search, which includes slow noise."""
    return replace(fit, covariance=_at_least(fit.covariance, covariance))


def with_priors(member: WeightedCompass, fit: DeviationFit) -> WeightedCompass:
    """Average a compass with effects over the priors of its coefficients, with at least the uncertainty of the fit.

    The search estimates uncertainty from blocks of days, which do not show veer that depends for months on the flow's
    direction; the fit includes it. Coefficients that an effect leaves undetermined, such as A beside iron of the
    reference, are limited by their priors.
    """
    if member.compass is None:
        return member
    covariance, simulation = _at_least(member.compass.covariance, fit.covariance[:5, :5]), member.compass.simulation
    if has_average(fit):
        parameters, averaged, *_ = average_coefficients(simulation.parameters, covariance, fit)
        shifted = simulation.at(parameters)
        if all(term.possible for term in shifted.terms):  # else no reading would have a unique heading
            simulation, covariance = shifted, averaged
    return replace(member, compass=replace(member.compass, simulation=simulation, covariance=covariance))


def _at_least(covariance: Floats, of_coefficients: Floats) -> Floats:
    """Raise the part of the coefficients of a covariance to at least another, (p, p)."""
    raised = covariance.copy()
    raised[:5, :5] += positive_part(of_coefficients - raised[:5, :5])
    return raised


@dataclass(frozen=True)
class CorrectionModel:
    """The correction of a record."""

    fit: DeviationFit  # the compass; as configured if no compass-side effect was found
    effects: tuple[str, ...] = ()  # compass-side effects found by the search and included
    applied: tuple[WeightedCompass, ...] = ()  # compasses that are averaged, the chosen one first; empty: the fit
    accounted: tuple[str, ...] = ()  # effects of clocks and water, removed from the fit; headings are unchanged
    left_deg: float = 0.0  # visible size of effects that were detected but not corrected, rms
    doubts: tuple[Doubt, ...] = ()  # stretches whose headings are flagged doubtful
    no_deviation: float | None = None  # probability of no deviation, averaged into the fit

    def to_json(self) -> dict[str, Any]:
        return {
            "method": self.fit.method,
            "effects": list(self.effects),
            "accounted_for": list(self.accounted),
            "compasses": [member.to_json() for member in self.applied],
            "weights": [{"effect": member.effect, "weight": member.weight} for member in self.applied],
            "dropped_probability": max(1.0 - sum(member.weight for member in self.applied), 0.0) * bool(self.applied),
            "uncorrected_deg": self.left_deg,
            "doubts": [doubt.to_json() for doubt in self.doubts],
            "no_deviation_probability": self.no_deviation,
        }


def from_json(content: Mapping[str, Any]) -> CorrectionModel:
    """Read the product from a deviation.json."""
    block = content["applied"]
    compasses = [entry["compass"] and _compass_from_json(entry["compass"]) for entry in block["compasses"]]
    each = zip(block["compasses"], compasses, strict=True)
    return CorrectionModel(
        fit=fit_from_json(content),
        effects=tuple(block["effects"]),
        applied=tuple(WeightedCompass(entry["weight"], entry["effect"], compass) for entry, compass in each),
        accounted=tuple(block["accounted_for"]),
        left_deg=block["uncorrected_deg"],
        doubts=doubts_from_json(block["doubts"]),
        no_deviation=block["no_deviation_probability"],
    )


def equivalent_pairs(
    product: CorrectionModel, pairs: Pairs, record: Record, field: EarthField, series: Series
) -> Pairs:
    """Convert the pairs to what the compass would have recorded without effects beyond its five coefficients."""
    when = np.searchsorted(record.time_s, pairs.time_s)
    at = compass_along_record(
        product, take(record, when), field, {name: column[when] for name, column in series.items()}
    )
    if at is None or product.applied[0].compass is None:
        return pairs
    heading = nearest_root(at.roots(), observed_heading(pairs))
    recorded = compass.recorded_heading(product.fit.coefficients, heading)
    shift = np.nan_to_num(angles.difference(recorded, pairs.heading_deg))
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, shift)
    return replace(pairs, heading_deg=angles.wrap360(pairs.heading_deg + shift), upper_east=east, upper_north=north)


def compass_along_record(
    product: CorrectionModel, record: Record, field: EarthField, series: Series
) -> CompassSeries | None:
    """Evaluate the compass at every sample of the affected instrument's record; None if the fit alone applies."""
    if not product.applied:
        return None
    recorded = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    tilts = record.pitch_deg, record.roll_deg
    plain = along_of_fit(product.fit, Readings(record.time_s, recorded, *tilts, np.zeros(len(recorded), dtype=complex)))
    compasses = []
    for member in product.applied:
        at = plain
        if member.compass is not None:
            scene = member.compass.scene(record.time_s, recorded, tilts, series, field=field)
            at = member.compass.along(scene, recorded)
        compasses.append(replace(at, weight=member.weight))
    return replace(compasses[0], others=tuple(compasses[1:]))


def _compass_from_json(content: Mapping[str, Any]) -> AppliedCompass:
    # Imported here: the catalogue dominates the import time of a correction, and not every product has effects.
    from compasslib.effects import all_effects
    from compasslib.effects.composed import effect_by_name
    from compasslib.effects.forward import ForwardModel

    forms, terms = {term.__name__: term for term in all_effects()}, []
    for entry in content["terms"]:
        values = {name: value for name, value in entry.items() if name not in ("effect", "form")}
        form = forms[entry["form"]] if entry["form"] in forms else effect_by_name(entry["effect"])
        terms.append(form(**values))
    coefficients = np.array([content["coefficients"][letter] for letter in LETTERS])
    return AppliedCompass(
        simulation=ForwardModel(coefficients, content["horizontal_nT"], tuple(terms)),
        covariance=np.array(content["covariance"]),
        references=content["references"],
        logged=tuple(content["logged"]),
    )
