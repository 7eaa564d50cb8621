"""results/compasses/NAME: what compass.json and diagnosis.json hold, and what each record takes from the first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from compasslib.deviation import prior as priors
from compasslib.deviation.model import LETTERS
from compasslib.deviation.prior import Prior
from compasslib.effects.composition import Simulation
from compasslib.inference import joint_compass, joint_effects, product, wording
from compasslib.inference.comparison import SharedInformation
from compasslib.inference.diagnosis import Diagnosis, insufficient
from compasslib.inference.finding import CovariateRange, Finding, HeldOut, Parameter
from compasslib.inference.joint_compass import IRON_NAMES, JointCompass, Member
from compasslib.inference.joint_effects import SharedAmplitude, SharedEffects
from compasslib.inference.product import AppliedCompass, Product
from compasslib.records import EarthField
from compasslib.types import Floats

ALARM = 0.006  # as of a single record


@dataclass(frozen=True)
class SiblingInformation:
    """What one record takes from the others of its compass."""

    compass: str
    others: tuple[str, ...]
    sigma_between_nT: float
    prior: Prior
    effects: SharedInformation  # in the parameters' own units

    def block(self, text: str) -> dict[str, Any]:
        """Return the block ``shared`` of deviation.json.

        Args:
            text: whose data carry the fit, in words.
        """
        return {
            "compass": self.compass,
            "from": list(self.others),
            "sigma_between": self.sigma_between_nT,
            "text": text,
        }


def read_returned(content: Mapping[str, Any], mooring: str) -> SiblingInformation | None:
    """Return what a compass.json gives back to a mooring, None where nothing of others belongs to it."""
    block = content["returned"].get(mooring)
    if block is None:
        return None
    told = {
        joint_compass.effect_class(form): (np.array(one["information"]), np.array(one["score"]))
        for form, one in block["effects"].items()
    }
    prior = priors.from_json(block["prior"])
    assert prior is not None
    return SiblingInformation(content["compass"], tuple(block["from"]), content["sigma_between"], prior, told)


def apply_shared_effects(
    made: Product, told: SiblingInformation, field: EarthField, logged: Mapping[str, Floats]
) -> Product:
    """Return what corrects a record that cannot be searched, with the effects that the others tell.

    Args:
        field: the earth's field along the deployment.
        logged: series beside the record, by which an effect may change; one that it has not is left out.
    """
    terms, covariances = [], [made.fit.covariance[:5, :5]]
    for kind, (information, score) in told.effects.items():
        if all(name in logged or name in product.RECORD_SERIES for name in kind.needs):
            covariance = np.linalg.inv(information)
            terms.append(kind().at(covariance @ score))
            covariances.append(covariance)
    if not terms:
        return made
    needed = sorted({name for term in terms for name in term.needs})
    references = {name: float(np.nanmean(logged[name])) for name in needed if name in logged}
    known = AppliedCompass(
        simulation=Simulation(made.fit.coefficients, float(np.mean(field.horizontal_nT)), tuple(terms)),
        covariance=block_diag(*covariances),
        references=references | {"time": float(field.time_s[0])},
        logged=tuple(references),
    )
    names = tuple(term.name for term in terms)
    return replace(made, effects=names, applied=(product.WeightedCompass(1.0, "+".join(names), known),))


def join_compass(name: str, members: Sequence[Member], min_effect_deg: float) -> tuple[dict[str, Any], Diagnosis]:
    """Return compass.json and the diagnosis of a compass.

    Args:
        min_effect_deg: visible size below which a shared effect does not matter.
    """
    found = joint_compass.join_records(members)
    fitting = [member for member in members if member.name in found.kept]
    shared = joint_effects.infer_shared(fitting, ALARM)
    diagnosis = _diagnosis(found, shared, min_effect_deg)
    named = {finding.effect for finding in diagnosis.findings}
    content = {
        "compass": name,
        "deployments": [_deployment_json(member, found) for member in members],
        **_iron_json(found),
        "rejected": [vars(one) for one in found.rejected],
        "effects": [_effect_json(one) for one in (shared.found if shared else ()) if one.kind.name in named],
        "returned": {
            member.name: _returned_json(member, found, shared, named) for member in members if member.kind == "mooring"
        },
    }
    return content, diagnosis


def log_line(content: Mapping[str, Any], diagnosis: Diagnosis) -> str:
    """Return what the job says of its result."""
    name, kept = content["compass"], [one["name"] for one in content["deployments"] if one["fits"]]
    lines = [f"{name}: {len(content['deployments'])} records, {len(kept)} of one compass ({', '.join(kept) or 'none'})"]
    lines += [f"{name}: {one['name']}: {one['why']}" for one in content["rejected"]]
    return "\n".join([*lines, diagnosis.log_line(name)])


def _deployment_json(member: Member, found: JointCompass) -> dict[str, Any]:
    known = member.tells
    sigma = np.sqrt(np.diag(member.covariance)) if known else np.zeros(0)
    return {
        "name": member.name,
        "kind": member.kind,
        "sphere": member.sphere,
        "horizontal_nT": member.horizontal_nT,
        "vertical_nT": member.vertical_nT,
        "coefficients": dict(zip(LETTERS, member.coefficients.tolist(), strict=True)) if known else None,
        "sigma": dict(zip(LETTERS, sigma.tolist(), strict=True)) if known else None,
        "fits": member.name in found.kept,
        "probability_same": found.same.get(member.name),
        "why": member.why,
    }


def _iron_json(found: JointCompass) -> dict[str, Any]:
    if not found.kept:
        return dict.fromkeys(("coefficients", "covariance", "sigma_between", "sigma_between_nT"))
    law, (sphere, battery) = found.shared, found.between_nT
    sizes = {"sphere": sphere, "battery": battery}
    return {
        "coefficients": dict(zip(IRON_NAMES, law.mean.tolist(), strict=True)),
        "covariance": law.covariance.tolist(),
        "sigma_between": found.sigma_between_nT,
        "sigma_between_nT": {name: {"value": value, "sigma": sigma} for name, (value, sigma) in sizes.items()},
    }


def _effect_json(one: SharedAmplitude) -> dict[str, Any]:
    each = {name: {"values": values.tolist(), "sigma": sigma.tolist()} for name, (values, sigma) in one.each.items()}
    sigma = np.sqrt(np.diag(one.covariance))
    return {
        "effect": one.kind.name,
        "form": one.kind.__name__,
        "parameters": list(one.kind.fitted()),
        "units": list(one.kind.units()),
        "values": one.values.tolist(),
        "sigma": sigma.tolist(),
        "each": each,
    }


def _returned_json(
    member: Member, found: JointCompass, shared: SharedEffects | None, named: set[str]
) -> dict[str, Any] | None:
    """Return what the other records tell one: never what it told itself."""
    prior, others = found.prior(member.name), found.others(member.name)
    if prior is None:
        return None
    told: dict[str, tuple[Floats, Floats]] = {}
    searched = [one for one in found.members if one.name in others and one.effects is not None]
    if shared is not None and searched:
        told = joint_effects.information_from_others(searched, shared)
    return {
        "from": list(others),
        "prior": prior.to_json(),
        "effects": {
            form: {"information": information.tolist(), "score": score.tolist()}
            for form, (information, score) in told.items()
            if joint_compass.effect_class(form).name in named
        },
    }


def _diagnosis(found: JointCompass, shared: SharedEffects | None, min_effect_deg: float) -> Diagnosis:
    if shared is None:
        count = sum(member.effects is not None for member in found.members if member.name in found.kept)
        return insufficient(f"{count} of its records fit each other and were searched; 2 are needed to share an effect")
    every = [_finding(one, shared, found) for one in shared.found]
    stands = tuple(sorted((one for one in every if one.rms_effect_deg >= min_effect_deg), key=_negative_size))
    small = tuple((one.effect, one.rms_effect_deg) for one in every if one.rms_effect_deg < min_effect_deg)
    verdict = "consistent" if not stands else "ambiguous" if any(one.alternatives for one in stands) else "explained"
    doubted = tuple(f"{one.name}: {one.why}" for one in found.rejected)
    return Diagnosis(
        verdict=verdict,
        findings=stands,
        separated_by="; ".join(
            wording.separating_observations(f.named, f.alternatives) for f in stands if f.alternatives
        )
        or None,
        negligible=small,
        why=f"The records {', '.join(shared.records)} were judged together, one amplitude of each effect for all.",
        sides=shared.sides,
        noise={"season_deg": shared.season_deg},
        warnings=doubted,
    )


def _negative_size(one: Finding) -> float:
    return -one.rms_effect_deg


def _finding(one: SharedAmplitude, shared: SharedEffects, found: JointCompass) -> Finding:
    sigma = np.sqrt(np.diag(one.covariance))
    names = zip(one.kind.fitted(), one.values.tolist(), sigma.tolist(), one.kind.units(), strict=True)
    parameters = {name: Parameter(value, s, unit) for name, value, s, unit in names}
    searched = [m.effects for m in found.members if m.name in shared.records and m.effects is not None]
    before = float(np.sqrt(np.mean([each.residual_deg**2 for each in searched])))
    samples = sum(each.n for each in searched)
    after = before * float(np.sqrt(max(1.0 - 2.0 * one.gain / samples, 0.0)))
    known = wording.SHOWN_ALONG.get(one.kind.name, ("heading",))
    place = CovariateRange(known[0], 0.0, 0.0, f"in all of {', '.join(shared.records)}")
    return Finding(
        effect=one.kind.name,
        side=one.kind.side,
        alternatives=tuple(one.alternatives),
        where=place,
        when_s=None,
        parameters=parameters,
        rms_effect_deg=one.rms_effect_deg,
        held_out=HeldOut(before, after, one.gain, (np.nan, np.nan), np.nan, method="records"),
        text=wording.shared_finding_text(
            one.kind.name,
            tuple(one.alternatives),
            where=f"In all of {', '.join(shared.records)}",
            parameters={name: (p.value, p.sigma, p.unit) for name, p in parameters.items()},
            size_deg=one.rms_effect_deg,
            gain=one.gain,
        ),
        applied=True,
        probability=one.probability,
        alternatives_probability=one.alternatives,
    )
