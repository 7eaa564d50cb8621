"""Build the contents of results/compasses/NAME (compass.json, diagnosis.json), and apply them to each record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from compasslib.deviation.model import LETTERS, CoefficientPrior, prior_from_json
from compasslib.effects.forward import ForwardModel
from compasslib.inference import joint_compass, joint_effects, product
from compasslib.inference.comparison import Options, SharedInformation
from compasslib.inference.diagnosis import Diagnosis, combine_outcomes, insufficient
from compasslib.inference.joint_compass import IRON_NAMES, SIZE_PAIRS_NT, JointCompass, Member
from compasslib.inference.joint_effects import SharedEffects
from compasslib.inference.product import AppliedCompass, CorrectionModel
from compasslib.records import EarthField
from compasslib.types import Floats


@dataclass(frozen=True)
class SiblingInformation:
    """Information for one record from the others of its compass."""

    compass: str
    others: tuple[str, ...]
    sigma_between_nT: float
    prior: CoefficientPrior
    effects: SharedInformation  # information and score, in the parameters' units

    def block(self, text: str) -> dict[str, Any]:
        """Encode the block ``shared`` of deviation.json."""
        named = {"compass": self.compass, "from": list(self.others)}
        return {**named, "sigma_between": self.sigma_between_nT, "text": text}


def read_returned(content: Mapping[str, Any], mooring: str) -> SiblingInformation | None:
    """Read the information for a mooring from a compass.json; None if no other record informs it."""
    block = content["returned"].get(mooring)
    if block is None:
        return None
    effects = {
        joint_compass.effect_class(form): (np.array(entry["information"]), np.array(entry["score"]))
        for form, entry in block["effects"].items()
    }
    prior = prior_from_json(block["prior"])
    assert prior is not None
    return SiblingInformation(content["compass"], tuple(block["from"]), content["sigma_between"], prior, effects)


def apply_shared_effects(
    made: CorrectionModel, shared: SiblingInformation, field: EarthField, logged: Mapping[str, Floats]
) -> CorrectionModel:
    """Correct a record that cannot be searched with the effects known from others, but those of series not logged."""
    terms, covariances = [], [made.fit.covariance[:5, :5]]
    for kind, (information, score) in shared.effects.items():
        if all(name in logged or name in product.RECORD_SERIES for name in kind.needs):
            covariances.append(np.linalg.inv(information))
            terms.append(kind().at(covariances[-1] @ score))
    if not terms:
        return made
    needed = sorted({name for term in terms for name in term.needs})
    references = {name: float(np.nanmean(logged[name])) for name in needed if name in logged}
    known = AppliedCompass(
        simulation=ForwardModel(made.fit.coefficients, float(np.mean(field.horizontal_nT)), tuple(terms)),
        covariance=block_diag(*covariances),
        references=references | {"time": float(field.time_s[0])},
        logged=tuple(references),
    )
    names = tuple(term.name for term in terms)
    return replace(made, effects=names, applied=(product.WeightedCompass(1.0, "+".join(names), known),))


def join_compass(name: str, members: Sequence[Member], min_effect_deg: float) -> tuple[dict[str, Any], Diagnosis]:
    """Join the records of a compass into compass.json and its diagnosis."""
    joined = joint_compass.join_records(members)
    fitting = [member for member in members if member.name in joined.consistent]
    shared = joint_effects.infer_shared(fitting)
    if shared is None:
        count = sum(member.effects is not None for member in fitting)
        why = f"{count} of its records fit each other and were searched; 2 are needed to share an effect"
        diagnosis = insufficient(why)
    else:
        findings = [effect.finding for effect in shared.effects]
        diagnosis = replace(
            combine_outcomes([], Options(min_effect_deg=min_effect_deg), extra=findings),
            why=f"The records {', '.join(shared.records)} were judged together, one amplitude of each effect for all.",
            sides=shared.sides,
            noise={"season_deg": shared.season_deg},
            warnings=tuple(f"{entry.name}: {entry.why}" for entry in joined.rejected),
        )
    named = {finding.effect for finding in diagnosis.findings}
    iron: dict[str, Any] = dict.fromkeys(("coefficients", "covariance", "sigma_between"))
    if joined.consistent:
        law = joined.shared
        iron["coefficients"] = dict(zip(IRON_NAMES, law.mean.tolist(), strict=True))
        iron["covariance"] = law.covariance.tolist()
        # Of the hard iron between deployments, by sphere and battery together, in each horizontal direction.
        iron["sigma_between"] = float(np.hypot(*(law.weight @ SIZE_PAIRS_NT)))
    effects = []
    for effect in shared.effects if shared else ():
        if effect.kind.name in named:
            parameters = effect.finding.parameters
            entry: dict[str, Any] = {
                "effect": effect.kind.name,
                "form": effect.kind.__name__,
                "parameters": list(parameters),
            }
            entry["units"] = [parameter.unit for parameter in parameters.values()]
            entry["values"] = [parameter.value for parameter in parameters.values()]
            entry["sigma"] = [parameter.sigma for parameter in parameters.values()]
            each = effect.each.items()
            entry["each"] = {x: {"values": value.tolist(), "sigma": sigma.tolist()} for x, (value, sigma) in each}
            effects.append(entry)
    moorings = [member for member in members if member.kind == "mooring"]
    content = {
        "compass": name,
        "deployments": [_deployment_json(member, joined) for member in members],
        **iron,
        "rejected": [vars(entry) for entry in joined.rejected],
        "effects": effects,
        "returned": {member.name: _returned_json(member, joined, shared, named) for member in moorings},
    }
    return content, diagnosis


def log_line(content: Mapping[str, Any], diagnosis: Diagnosis) -> str:
    """Summarize a joint fit in lines of the log."""
    name, siblings = content["compass"], [entry["name"] for entry in content["deployments"] if entry["fits"]]
    names, count = ", ".join(siblings) or "none", len(content["deployments"])
    lines = [f"{name}: {count} records, {len(siblings)} of one compass ({names})"]
    lines += [f"{name}: {entry['name']}: {entry['why']}" for entry in content["rejected"]]
    return "\n".join([*lines, diagnosis.log_line(name)])


def _deployment_json(member: Member, joined: JointCompass) -> dict[str, Any]:
    coefficients = sigma = None
    if member.tells:
        coefficients = dict(zip(LETTERS, member.coefficients.tolist(), strict=True))
        sigma = dict(zip(LETTERS, np.sqrt(np.diag(member.covariance)).tolist(), strict=True))
    names = ("name", "kind", "sphere", "horizontal_nT", "vertical_nT", "why")
    return {
        **{name: getattr(member, name) for name in names},
        "coefficients": coefficients,
        "sigma": sigma,
        "fits": member.name in joined.consistent,
        "probability_same": joined.same.get(member.name),
    }


def _returned_json(
    member: Member, joined: JointCompass, shared: SharedEffects | None, named: set[str]
) -> dict[str, Any] | None:
    """Encode the information of the other records for one record, excluding its own."""
    prior, others = joined.prior(member.name), joined.others(member.name)
    if prior is None:
        return None
    searched = [other for other in joined.members if other.name in others and other.effects is not None]
    effects = joint_effects.information_from_others(searched, shared) if shared is not None and searched else {}
    return {
        "from": list(others),
        "prior": prior.to_json(),
        "effects": {
            form: {"information": information.tolist(), "score": score.tolist()}
            for form, (information, score) in effects.items()
            if joint_compass.effect_class(form).name in named
        },
    }
