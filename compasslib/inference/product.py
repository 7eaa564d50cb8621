"""The compass that corrects a record: the configured fit, or the exact compass with what was found on its side.

It stands in deviation.json, so that the correction needs nothing else and an archive tells what it was made by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import doubts, model
from compasslib.deviation.along import Along
from compasslib.deviation.along import of_fit as along_of_fit
from compasslib.deviation.doubts import Doubt
from compasslib.deviation.model import Fit
from compasslib.inference.show import UNTESTED
from compasslib.records import BAD, EarthField, Pairs, Readings, Record, take
from compasslib.types import Floats

if TYPE_CHECKING:  # the jobs that correct need no search
    from compasslib.inference.applied import Applied, Member
    from compasslib.inference.verdict import Diagnosis


Series = Mapping[str, Floats]


@dataclass(frozen=True)
class Product:
    """What corrects a record."""

    fit: Fit  # the compass; the configured one where nothing was found on its side
    effects: tuple[str, ...] = ()  # what the search found on the compass side and put into it
    applied: tuple[Member, ...] = ()  # compasses whose average it is, the chosen one first; none: the fit by itself
    accounted: tuple[str, ...] = ()  # of clocks and water: the fit is freed of them, headings are not touched
    left_deg: float = 0.0  # visible size of what was seen and is not corrected, rms
    doubts: tuple[Doubt, ...] = ()  # stretches whose headings are flagged doubtful

    @property
    def searched(self) -> bool:
        """Whether it is another than the configured fit."""
        return bool(self.effects or self.accounted or self.applied)

    def to_json(self) -> dict[str, Any]:
        """Return the block ``applied`` of deviation.json."""
        return {
            "method": self.fit.method,
            "effects": list(self.effects),
            "accounted_for": list(self.accounted),
            "fit": self.fit.to_json() if self.searched else None,
            "compasses": [member.to_json() for member in self.applied],
            "weights": [{"effect": member.effect, "weight": member.weight} for member in self.applied],
            "dropped_probability": max(1.0 - sum(member.weight for member in self.applied), 0.0)
            if self.applied
            else 0.0,
            "uncorrected_deg": self.left_deg,
            "doubts": [doubt.to_json() for doubt in self.doubts],
        }


def of(fit: Fit, diagnosis: Diagnosis) -> Product:
    """Return what is to correct the record after the search for unmodelled effects."""
    left_deg = _left(diagnosis)
    if diagnosis.fit is None:
        return Product(fit, left_deg=left_deg)
    effects = tuple(one.effect for one in diagnosis.findings if one.applied)
    accounted = tuple(one.effect for one in diagnosis.findings if one.beside_compass)
    return Product(diagnosis.fit, effects, diagnosis.applied, accounted, left_deg)


def _left(diagnosis: Diagnosis) -> float:
    """Return the visible size of what bends the compass, or may, and does not enter the product, rms degrees."""
    kept_out = [one for one in diagnosis.findings if not one.applied and one.held_out is not UNTESTED]
    if diagnosis.applied:  # an average holds what may not be as well, but for storms whose course nobody knows
        kept_out = [one for one in kept_out if one.side == "compass"]
    sizes = [one.rms_effect_deg for one in kept_out if one.of_compass]
    sizes += [] if diagnosis.unexplained is None else [diagnosis.unexplained.rms_effect_deg]
    return float(np.hypot.reduce(sizes)) if sizes else 0.0


def from_json(content: Mapping[str, Any]) -> Product:
    """Return what a deviation.json says the record is to be corrected by."""
    from compasslib.inference.applied import Member

    block = content["applied"]
    left_deg, stretches = block["uncorrected_deg"], doubts.from_json(block.get("doubts", ()))
    if block["fit"] is None:
        return Product(model.from_json(content), left_deg=left_deg, doubts=stretches)
    applied = tuple(
        Member(one["weight"], one["effect"], None if one["compass"] is None else _applied(one["compass"]))
        for one in block["compasses"]
    )
    fit, effects, accounted = model.from_json(block["fit"]), tuple(block["effects"]), tuple(block["accounted_for"])
    return Product(fit, effects, applied, accounted, left_deg, stretches)


def plain(product: Product, pairs: Pairs, record: Record, field: EarthField, series: Series) -> Pairs:
    """Return the pairs as the compass by itself would have recorded them, without what was found beside it.

    A method that knows five coefficients and no effects can go on from there.

    Args:
        pairs: overlapping measurements, at times of the record.
        record: the affected instrument.
        series: what was logged besides at the record's samples.
    """
    when = np.searchsorted(record.time_s, pairs.time_s)
    at = along(product, take(record, when), field, {name: column[when] for name, column in series.items()})
    if at is None or product.applied[0].compass is None:
        return pairs
    heading = model.nearest_root(at.roots(), model.observed_heading(pairs))
    recorded = compass.recorded_heading(product.fit.coefficients, heading)
    shift = np.nan_to_num(angles.difference(recorded, pairs.heading_deg))
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, shift)
    return replace(pairs, heading_deg=angles.wrap360(pairs.heading_deg + shift), upper_east=east, upper_north=north)


def along(product: Product, record: Record, field: EarthField, series: Series) -> Along | None:
    """Return the compass at every sample of the record, None where the fit by itself says it.

    Args:
        record: the affected instrument.
        series: what was logged besides, (n,) each, see ``covariates.logged``.
    """
    if not product.applied:
        return None
    recorded = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    tilts = record.pitch_deg, record.roll_deg
    plain = along_of_fit(product.fit, Readings(record.time_s, recorded, *tilts, np.zeros(len(recorded), dtype=complex)))
    every = []
    for member in product.applied:
        at = plain
        if member.compass is not None:
            scene = member.compass.scene(record.time_s, recorded, tilts, series, field=field)
            at = member.compass.along(scene, recorded)
        every.append(replace(at, weight=member.weight))
    return replace(every[0], others=tuple(every[1:]))


def _applied(content: Mapping[str, Any]) -> Applied:
    # Here, because most of a correcting job's imports are the catalogue, and not every product has effects.
    from compasslib import effects as physics
    from compasslib.effects import composed
    from compasslib.effects.composition import Simulation
    from compasslib.inference.applied import Applied

    forms, terms = {term.__name__: term for term in physics.all_terms()}, []
    for entry in content["terms"]:
        values = {name: value for name, value in entry.items() if name not in ("effect", "form")}
        form = forms[entry["form"]] if entry["form"] in forms else composed.of_name(entry["effect"])
        terms.append(form(**values))
    coefficients = np.array([content["coefficients"][letter] for letter in model.LETTERS])
    return Applied(
        simulation=Simulation(coefficients, content["horizontal_nT"], tuple(terms)),
        covariance=np.array(content["covariance"]),
        references=content["references"],
        logged=tuple(content["logged"]),
    )
