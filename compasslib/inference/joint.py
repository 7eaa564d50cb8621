"""Join the records of one compass: effects that all share, results/compasses/NAME, and what each record gets back.

An effect that all records share has one amplitude. The model is that of a single record's search: the products of the
effects' columns, slow noise marginalized, are summed over the records. Two alternatives compete with a shared effect: a
season of the water, of unknown size, that recurs in every deployment and explains what only follows the season; and an
effect of independent size in each record.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from compasslib.deviation.exact import positive_part
from compasslib.deviation.model import LETTERS, CoefficientPrior, DeviationFit, listed, prior_from_json
from compasslib.effects import SLOW_WATER, Effect
from compasslib.effects.effect import parameter_slices
from compasslib.effects.forward import ForwardModel
from compasslib.inference import joint_compass, product, wording
from compasslib.inference import noise as noise_models
from compasslib.inference.comparison import Comparison, Options, SharedInformation, build_finding
from compasslib.inference.diagnosis import Diagnosis, combine_outcomes, insufficient
from compasslib.inference.evidence import UNLIKELY
from compasslib.inference.finding import CovariateRange, Finding, HeldOut, Parameter, compare_names
from compasslib.inference.joint_compass import (
    IRON_NAMES,
    SIZE_PAIRS_NT,
    EffectInformation,
    JointCompass,
    Member,
    RecordInformation,
    effect_class,
)
from compasslib.inference.linear_model import AMPLITUDES_DEG, Entered, Marginal, Products
from compasslib.inference.product import AppliedCompass, CorrectionModel
from compasslib.inference.search import Inference
from compasslib.records import EarthField
from compasslib.statistics.least_squares import mixed_covariance, robust_width
from compasslib.types import Floats

# Sizes of the season: a grid, rms degrees, with a half-Cauchy prior whose scale is that of slow water.
SEASONS_DEG = np.array([0.1, 0.5, 1.0, 2.0, 4.0, 8.0])
SEASON_LOG_PRIOR = np.log(SEASONS_DEG) - np.log1p((SEASONS_DEG / noise_models.USUAL_VEER_DEG) ** 2)
MOST_SHARED = 2  # effects; limits the run time


def record_information(inferred: Inference, fit: DeviationFit) -> RecordInformation:
    """Summarize the inference from one record for other records of the same compass.

    Args:
        fit: fit of the exact compass; its covariance includes uncertainty that blocks of days do not show.
    """
    weights = np.array([weight for weight, _ in inferred.weighted])
    weights /= weights.sum()
    centres = [fitted.simulation.coefficients for _, fitted in inferred.weighted]
    inner = [inferred.covariance(fitted)[:5, :5] for _, fitted in inferred.weighted]
    covariance = mixed_covariance(weights, centres, inner)
    covariance += positive_part(fit.covariance[:5, :5] - covariance)
    return RecordInformation(weights @ np.array(centres), covariance, _effect_information(inferred))


def fit_information(fit: DeviationFit) -> RecordInformation | None:
    """Summarize a fit without a search; None unless the exact compass was fitted."""
    known = fit.fitted and fit.method == "exact"
    return RecordInformation(fit.coefficients, fit.covariance[:5, :5], None) if known else None


def _effect_information(inferred: Inference) -> EffectInformation:
    """Collect the products of the instrument's effects and the season, averaged over slow noise.

    Effects that belong to the record alone, such as a slip of its mount, are marginalized.
    """
    fitted, model = inferred.fitted, inferred.model
    shared = [k for k, option in enumerate(model.options) if option.term.instrument]
    specific = [(k, size) for k, size in inferred.entered if k not in shared]
    retained = [*shared, *(k for k, _ in specific)]
    of_options = np.concatenate([np.zeros(0, dtype=np.intp), *(model.products.columns(k) for k in retained)])
    white = np.concatenate([model.white[:, of_options], model.white[:, model.products.ends[-1] :]], axis=1)
    products = replace(model, options=tuple(model.options[k] for k in retained), white=white).products
    entered = [(len(shared) + k, size) for k, (_, size) in enumerate(specific)]
    at = np.append(np.arange(products.ends[len(shared)]), products.ends[-1] + model.slow.season)
    information, score = np.zeros((len(at), len(at))), np.zeros(len(at))
    for share, slow_noise in inferred.further.evidence.weighted_noises():
        variance = model.slow.variances(slow_noise)
        variance[model.slow.season] = 0.0  # left to the joint model, as all records share it
        left, score_left = products.marginalize(variance, entered).left(at)
        information, score = information + share * left, score + share * score_left[:, 0]
    usual = np.concatenate([np.zeros(0), *(model.options[k].usual for k in shared)])
    unit = np.divide(1.0, usual, out=np.zeros_like(usual), where=usual > 0.0)
    scale = np.append(unit, np.ones(noise_models.SEASON_COLUMNS))
    columns = np.concatenate([np.zeros((len(white), 0)), *(model.options[k].columns for k in shared)], axis=1)
    visible = model.freed.visible(columns * unit)
    return EffectInformation(
        forms=tuple(type(model.options[k].term).__name__ for k in shared),
        usual=usual,
        visible=visible.T @ visible / max(len(visible), 1),
        information=information * np.outer(scale, scale),
        score=score * scale,
        residual_deg=robust_width(fitted.residual_deg[np.isfinite(fitted.residual_deg)]),
        n=len(fitted.comparison),
    )


@dataclass(frozen=True)
class SharedEffect:
    """An effect with one amplitude in all records."""

    kind: type[Effect]
    finding: Finding
    each: dict[str, tuple[Floats, Floats]]  # values and standard errors of its parameters by each record alone

    def to_json(self) -> dict[str, Any]:
        """Encode an entry of ``effects`` in compass.json."""
        parameters = self.finding.parameters
        each = {x: {"values": values.tolist(), "sigma": sigma.tolist()} for x, (values, sigma) in self.each.items()}
        return {
            "effect": self.kind.name,
            "form": self.kind.__name__,
            "parameters": list(parameters),
            "units": [parameter.unit for parameter in parameters.values()],
            "values": [parameter.value for parameter in parameters.values()],
            "sigma": [parameter.sigma for parameter in parameters.values()],
            "each": each,
        }


@dataclass(frozen=True)
class SharedEffects:
    """Effects inferred jointly from the records of one compass."""

    records: tuple[str, ...]
    effects: tuple[SharedEffect, ...]
    sides: dict[str, float]
    season_deg: tuple[float, float]  # size of the season of the water, with its standard error


@dataclass(frozen=True)
class SharedEvidence:
    """Probabilities of g effects in one place, beside others."""

    shared: Floats  # (g,) that all records share the effect
    apart: float  # that an effect acts in some records, with an independent size in each
    season: Floats  # of each of SEASONS_DEG, without a further effect

    @property
    def season_deg(self) -> float:
        """The likeliest size of the season."""
        return float(SEASONS_DEG[int(np.argmax(self.season))])


@dataclass(frozen=True)
class SharedModel:
    """Products of m records in common columns: p of the effects, in prior standard deviations, and s of the season."""

    records: tuple[str, ...]
    kinds: tuple[type[Effect], ...]
    usual: Floats  # (p,) of the effects' parameters
    information: Floats  # (m, p + s, p + s)
    score: Floats  # (m, p + s)
    visible: Floats  # (p, p) mean products of the visible columns, square degrees
    residual_deg: float  # rms
    n: int  # number of pairs

    @cached_property
    def log_prior(self) -> Floats:
        """Log prior odds of each effect: even odds of any, divided among names and the forms of each, (g,)."""
        forms = Counter(kind.name for kind in self.kinds)
        return -np.log([float(len(forms) * forms[kind.name]) for kind in self.kinds])

    def marginalized(self, season_deg: float, entered: Entered = (), records: Sequence[int] | None = None) -> Marginal:
        """Marginalize season and entered effects in the summed products of some records, by default of all."""
        chosen = range(len(self.records)) if records is None else records
        sized = np.array([np.isfinite(kind.expected()).all() for kind in self.kinds], dtype=bool)
        products = Products(
            information=self.information[chosen].sum(axis=0),
            score=self.score[chosen].sum(axis=0)[:, None],
            ends=np.cumsum([0, *(len(kind.fitted()) for kind in self.kinds)]),
            amplitudes=np.where(sized, 1.0, AMPLITUDES_DEG[:, None]),
        )
        return products.marginalize(np.full(noise_models.SEASON_COLUMNS, season_deg**2), entered)

    def weigh(self, entered: Entered = ()) -> SharedEvidence:
        """Compute the probability of each effect beside the entered ones."""
        none, shared, apart = [], [], []
        for size in SEASONS_DEG.tolist():
            marginal = self.marginalized(size, entered)
            none.append(marginal.none[0])
            shared.append(self.log_prior + marginal.evidence[:, 0])
            alone = [self.marginalized(size, entered, [j]).evidence[:, 0] for j in range(len(self.records))]
            acting = np.logaddexp(0.0, self.log_prior + np.array(alone)).sum(axis=0)
            apart.append(acting + np.log(-np.expm1(-acting)))
        season = SEASON_LOG_PRIOR + np.array(none)
        season -= np.logaddexp.reduce(season)
        log = np.logaddexp.reduce(season[:, None] + np.concatenate([shared, apart], axis=1), axis=0)
        taken = {self.kinds[k].name for k, _ in entered}
        log[np.tile([kind.name in taken for kind in self.kinds], 2)] = -np.inf
        weight = np.exp(log - np.logaddexp.reduce(log, initial=0.0))
        return SharedEvidence(weight[: len(self.kinds)], float(weight[len(self.kinds) :].sum()), np.exp(season))

    def likeliest(self, entered: Entered) -> tuple[int, float]:
        """Select the likeliest effect beside the entered ones, with its likeliest amplitude."""
        evidence = self.weigh(entered)
        k = int(np.argmax(evidence.shared))
        marginal = self.marginalized(evidence.season_deg, entered)
        return k, float(marginal.products.amplitudes[int(np.argmax(marginal.by_amplitude[:, k, 0])), k])

    def fit(self, k: int, amplitude: float, marginal: Marginal) -> tuple[Floats, Floats]:
        """Fit an effect: its parameters, (k,), and their covariance, (k, k)."""
        columns = marginal.products.columns(k)
        information, score = marginal.left(columns)
        covariance = np.linalg.inv(information + np.eye(len(columns)) / amplitude**2)
        unit = self.usual[columns]
        return unit * (covariance @ score[:, 0]), covariance * np.outer(unit, unit)


def align_records(members: Sequence[Member]) -> SharedModel:
    """Express what the searched records tell of their effects in common columns."""
    searched = {member.name: member.effects for member in members if member.effects is not None}
    kinds = tuple(
        effect_class(form) for form in dict.fromkeys(form for effects in searched.values() for form in effects.forms)
    )
    parts = dict(zip(kinds, parameter_slices(kinds), strict=True))
    count = sum(len(kind.fitted()) for kind in kinds)
    size = count + noise_models.SEASON_COLUMNS
    usual, visible = np.full((len(searched), count), np.nan), np.full((len(searched), count, count), np.nan)
    information, score = np.zeros((len(searched), size, size)), np.zeros((len(searched), size))
    for j, effects in enumerate(searched.values()):
        of_effects = np.r_[tuple(parts[effect_class(form)] for form in effects.forms)].astype(int)
        at = np.append(of_effects, count + np.arange(noise_models.SEASON_COLUMNS))
        usual[j, of_effects], visible[j][np.ix_(of_effects, of_effects)] = effects.usual, effects.visible
        information[j][np.ix_(at, at)], score[j, at] = effects.information, effects.score
    middle = np.nanmedian(usual, axis=0)
    unit = np.append(middle, np.ones(noise_models.SEASON_COLUMNS))
    return SharedModel(
        records=tuple(searched),
        kinds=kinds,
        usual=middle,
        information=information * np.outer(unit, unit),
        score=score * unit,
        visible=np.nanmean(visible, axis=0),
        residual_deg=float(np.sqrt(np.mean([effects.residual_deg**2 for effects in searched.values()]))),
        n=sum(effects.n for effects in searched.values()),
    )


def infer_shared(members: Sequence[Member]) -> SharedEffects | None:
    """Infer the effects that records share, None where fewer than two were searched.

    Effects enter one after the other, while one is likely; each is then selected again beside the other.
    """
    if sum(member.effects is not None and bool(member.effects.forms) for member in members) < 2:
        return None
    model = align_records(members)
    entered: list[tuple[int, float]] = []
    while len(entered) < MOST_SHARED and 1.0 - model.weigh(entered).shared.sum() <= UNLIKELY:
        entered.append(model.likeliest(entered))
        entered = [model.likeliest([*entered[:k], *entered[k + 1 :]]) for k in range(len(entered))]
    further = model.weigh(entered)
    places = [model.weigh([*entered[:k], *entered[k + 1 :]]) for k in range(len(entered))]
    none = float(np.prod([1.0 - place.shared.sum() for place in (*places, further)]))
    middle = float(further.season @ SEASONS_DEG)
    return SharedEffects(
        records=model.records,
        effects=tuple(_describe(model, entered, k, place, further.season_deg) for k, place in enumerate(places)),
        sides={"none": none, "compass": 1.0 - none, "clock": 0.0, "reference": 0.0, "water": 0.0},
        season_deg=(middle, float(np.sqrt(further.season @ (SEASONS_DEG - middle) ** 2))),
    )


def _describe(
    model: SharedModel, entered: Entered, number: int, place: SharedEvidence, season_deg: float
) -> SharedEffect:
    """Describe an entered effect, with its probability given that no effect of the place acts in some records only."""
    (k, size), others = entered[number], [*entered[:number], *entered[number + 1 :]]
    kind, everyone = model.kinds[k], range(len(model.records))
    marginal = model.marginalized(season_deg, others)
    values, covariance = model.fit(k, size, marginal)
    alone = [model.fit(k, size, model.marginalized(season_deg, others, [j])) for j in everyone]
    names = Counter({SLOW_WATER: max(1.0 - float(place.shared.sum()) - place.apart, 0.0)})
    for other, weight in zip(model.kinds, place.shared.tolist(), strict=True):
        names[other.name] += weight
    # Log score of predicting each record from the others, relative to no effect.
    without = [model.marginalized(season_deg, others, [i for i in everyone if i != j]) for j in everyone]
    gain = float(np.sum([marginal.evidence[k, 0] - other.evidence[k, 0] for other in without]))
    after_deg = model.residual_deg * float(np.sqrt(max(1.0 - 2.0 * gain / model.n, 0.0)))
    columns = marginal.products.columns(k)
    rows = zip(kind.fitted(), values.tolist(), np.sqrt(np.diag(covariance)).tolist(), kind.units(), strict=True)
    parameters = {name: Parameter(value, sigma, unit) for name, value, sigma, unit in rows}
    where = f"in all of {', '.join(model.records)}"
    finding = build_finding(
        Comparison(time_s=np.zeros(0), terms=(), covariates={}, clocked=False),
        kind().at(values),
        compare_names(kind.name, names),
        parameters,
        size_deg=float(np.sqrt(values @ model.visible[np.ix_(columns, columns)] @ values)),
        proof=HeldOut(model.residual_deg, after_deg, gain, (np.nan, np.nan), np.nan, method="records"),
        place=CovariateRange(wording.SHOWN_ALONG.get(kind.name, ("heading",))[0], 0.0, 0.0, where),
    )
    text = f"{finding.text} Each record predicted by the others gains {gain:.1f} in log score, all together."
    finding = replace(finding, text=text, applied=True)
    each = {name: (x, np.sqrt(np.diag(spread))) for name, (x, spread) in zip(model.records, alone, strict=True)}
    return SharedEffect(kind, finding, each)


def information_from_others(members: Sequence[Member], shared: SharedEffects) -> dict[str, tuple[Floats, Floats]]:
    """Compute information and score of the shared effects from the other records, in the parameters' units."""
    model = align_records(members)
    marginal, result = model.marginalized(shared.season_deg[0]), dict[str, tuple[Floats, Floats]]()
    for kind in (effect.kind for effect in shared.effects if effect.kind in model.kinds):
        columns = marginal.products.columns(model.kinds.index(kind))
        (information, score), usual = marginal.left(columns), model.usual[columns]
        result[kind.__name__] = information / np.outer(usual, usual), score[:, 0] / usual
    return result


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
        effect_class(form): (np.array(entry["information"]), np.array(entry["score"]))
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
    shared = infer_shared(fitting)
    if shared is None:
        count = sum(member.effects is not None for member in fitting)
        why = f"{len(fitting)} of its records fit each other, {count} were searched; 2 are needed to share an effect"
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
    content = {
        "compass": name,
        "deployments": [_deployment_json(member, joined) for member in members],
        **iron,
        "rejected": [vars(entry) for entry in joined.rejected],
        "effects": [effect.to_json() for effect in shared.effects if effect.kind.name in named] if shared else [],
        "returned": {
            member.name: _returned_json(member, joined, shared, named) for member in members if member.kind == "mooring"
        },
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
    effects = information_from_others(searched, shared) if shared is not None and searched else {}
    return {
        "from": list(others),
        "prior": listed(prior),
        "effects": {
            form: {"information": information.tolist(), "score": score.tolist()}
            for form, (information, score) in effects.items()
            if effect_class(form).name in named
        },
    }
