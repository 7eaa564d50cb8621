"""Infer effects that all records of an instrument share, with one amplitude, by adding scores and information.

Priors, odds and slow water are those of a single record's search. Two alternatives compete: a season of the water, of
unknown size, that recurs in every deployment and explains what only follows the season; and an effect of independent
size in each record, or in one record only.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation.exact import positive_part
from compasslib.deviation.model import DeviationFit
from compasslib.effects import SLOW_WATER, Effect
from compasslib.effects.effect import USUAL_DEG, YEAR_S, parameter_slices
from compasslib.effects.forward import heading_jacobian
from compasslib.inference import design, joint_compass, posterior
from compasslib.inference import noise as noise_models
from compasslib.inference.blocks import scaled_option
from compasslib.inference.comparison import LongComparison
from compasslib.inference.design import Products
from compasslib.inference.inference import Inference
from compasslib.inference.joint_compass import EffectInformation, Member, RecordInformation, log_sum
from compasslib.inference.places import marginalize
from compasslib.inference.posterior import Hypothesis, Posterior
from compasslib.statistics.least_squares import robust_width
from compasslib.types import Floats

ANYTHING = 1e6  # prior variance of free coefficients, in units of one sample's noise
MOST_SHARED_NOISE, LEAST_NOISE_PROBABILITY = 8, 1e-3  # kinds of slow water that are stored, their least probability
SEASON_HARMONICS = (1, 2, 3, 4)  # harmonics of the year in the season of the water; its shear has half as many
SHEAR_M_S_DEG = 0.007  # shear in m/s per degree of veer
SEASON_COLUMNS = 2 * len(SEASON_HARMONICS) * 2

SEASONS_DEG = np.array([0.1, 0.5, 1.0, 2.0, 4.0, 8.0])  # grid of sizes of the season, rms
SEASON_PRIOR_DEG = 2.0  # scale of the half-Cauchy prior of this size
MOST_SHARED = 2
NEWTON_STEPS = 5  # iterations to the likeliest amplitudes, averaged over kinds of slow water
MOST_LOG = 700.0


def record_information(inferred: Inference, fit: DeviationFit) -> RecordInformation:
    """Summarize the inference from one record for other records of the same compass.

    Args:
        fit: fit of the exact compass; its covariance includes uncertainty that blocks of days do not show.
    """
    each = [(weight, *_coefficients(inferred, state)) for weight, state in inferred.weighted]
    weights = np.array([weight for weight, _, _ in each])
    weights /= weights.sum()
    centres = np.array([centre for _, centre, _ in each])
    mean = weights @ centres
    inner = np.einsum("h,hij->ij", weights, np.array([covariance for _, _, covariance in each]))
    covariance = inner + (weights[:, None] * (centres - mean)).T @ (centres - mean)
    covariance += positive_part(fit.covariance[:5, :5] - covariance)
    return RecordInformation(mean, covariance, _effect_information(inferred))


def fit_information(fit: DeviationFit) -> RecordInformation | None:
    """Summarize a fit without a search; None unless the exact compass was fitted."""
    known = fit.fitted and fit.method == "exact"
    return RecordInformation(fit.coefficients, fit.covariance[:5, :5], None) if known else None


def _coefficients(inferred: Inference, state: Any) -> tuple[Floats, Floats]:
    return state.simulation.coefficients, inferred.estimate(state).covariance[:5, :5]


def _effect_information(inferred: Inference) -> EffectInformation:
    state, model = inferred.state, inferred.model
    view, half = design.freed_model(state)
    kinds = tuple(kind for kind in state.case.terms if kind.instrument)
    options = [scaled_option(half, kind()) for kind in kinds]
    listed = [option.columns * USUAL_DEG for option in options]
    usual = np.concatenate([np.zeros(0), *(option.usual * USUAL_DEG for option in options)])
    shared = np.concatenate([np.zeros((len(state.case), 0)), *listed], axis=1)
    slopes = np.nan_to_num(heading_jacobian(half.simulation, half.case.scene, half.heading_deg, first=5))
    chosen = [np.full(len(term.fitted()), not term.instrument) for term in half.simulation.terms]
    season = season_columns(view.case)
    record_only = slopes[:, np.concatenate([np.zeros(0, dtype=bool), *chosen])]
    waves = np.zeros((len(state.case), 0)) if model.slow is None else model.slow.columns
    sigma = view.sigma * np.sqrt(model.scatter)
    all_columns = np.concatenate([shared, season, waves, record_only], axis=1, dtype=np.float32)
    white = view.whiten_and_project(all_columns) * np.float32(view.response / sigma)
    information = (white.T @ white).astype(float)
    score = (white.T @ (view.innovation / sigma).astype(np.float32)).astype(float)
    shared_count = shared.shape[1] + season.shape[1]
    evidence = inferred.further.evidence
    weight = evidence.water_probability()
    likely = [int(i) for i in np.argsort(-weight)[:MOST_SHARED_NOISE] if weight[i] >= LEAST_NOISE_PROBABILITY]
    conditional = []
    unit = np.append(1.0 / np.maximum(usual, 1e-12), np.ones(season.shape[1]))
    for water in (evidence.waters[i] for i in likely):
        variance = np.append(model.noise_variances(water), np.full(record_only.shape[1], ANYTHING))
        left, score_left, log_likelihood = marginalize(information, score, shared_count, variance)
        beforehand = log_likelihood + (0.0 if water is None else water.log_prior)
        conditional.append(Products(left * np.outer(unit, unit), score_left * unit, beforehand))
    visible = view.visible(shared / np.maximum(usual, 1e-12))
    return EffectInformation(
        forms=tuple(kind.__name__ for kind in kinds),
        parts=tuple(columns.shape[1] for columns in listed),
        usual=usual,
        uneven=np.ones(shared.shape[1]),
        visible=visible.T @ visible / max(len(visible), 1),
        conditional=tuple(conditional),
        residual_deg=robust_width(state.residual_deg[np.isfinite(state.residual_deg)]),
        n=len(state.case),
    )


def season_columns(case: LongComparison) -> Floats:
    """Build the columns of a yearly season of the water, degrees per degree of its size, (n, SEASON_COLUMNS).

    Harmonics of the year for veer and for eastward and northward shear; the k-th is scaled by 1/k.
    """
    phase = 360.0 * case.scene.time_s / YEAR_S
    waves = np.column_stack([x / k for k in SEASON_HARMONICS for x in angles.sin_cos(k * phase)])
    departures = case.scene.departures
    if "flow_east" not in departures or "speed" not in case.covariates:
        return np.concatenate([waves, np.zeros_like(waves)], axis=1)
    shear = noise_models.shear_columns(case, waves[:, : len(SEASON_HARMONICS)], noise_models.SPEED_SPAN_S)
    return np.concatenate([waves, SHEAR_M_S_DEG * shear], axis=1)


@dataclass(frozen=True)
class ConditionalInformation:
    """Information and score of one record for all effects and the season, given each kind of slow water."""

    information: Floats  # (w, p + s, p + s)
    score: Floats  # (w, p + s)
    log_weight: Floats  # (w,)
    uneven: Floats  # (p,)


@dataclass(frozen=True)
class Mode:
    """The likeliest amplitudes of one hypothesis."""

    values: Floats  # (k + s,)
    information: Floats  # (k + s, k + s) without the prior
    score: Floats  # (k + s,)
    log_evidence: float


@dataclass(frozen=True)
class SharedAmplitude:
    """An effect with one amplitude in all records."""

    kind: type[Effect]
    values: Floats  # (k,) of the fitted parameters
    covariance: Floats  # (k, k)
    rms_effect_deg: float
    probability: float
    alternatives: dict[str, float]
    each: dict[str, tuple[Floats, Floats]]  # values and standard errors by each record alone
    gain: float  # log score of predicting each record from the others, relative to no effect


@dataclass(frozen=True)
class SharedEffects:
    """Effects inferred jointly from the records of one compass."""

    kinds: tuple[type[Effect], ...]
    records: tuple[str, ...]
    amplitudes: tuple[SharedAmplitude, ...]
    acting: dict[str, float]  # probability of each effect that all records share it
    sides: dict[str, float]
    season_deg: tuple[float, float]  # size of the season of the water, with its standard error


class JointEvidence:
    """The records of one compass in common units, with their evidence under any hypothesis."""

    def __init__(self, members: Sequence[Member]):
        self.members = [member for member in members if member.effects is not None]
        forms = dict.fromkeys(form for member in self.members if member.effects for form in member.effects.forms)
        self.kinds = tuple(joint_compass.effect_class(form) for form in forms)
        self.parts = [np.r_[columns] for columns in parameter_slices(self.kinds)]
        self.count = sum(len(part) for part in self.parts)
        sizes: list[list[Floats]] = [[] for _ in forms]
        for member in self.members:
            assert member.effects is not None
            for form, part in _form_parts(member):
                sizes[list(forms).index(form)].append(member.effects.usual[part])
        self.usual = np.concatenate([np.zeros(0), *(np.median(each, axis=0) for each in sizes)])
        self.records = [self._record(member, list(forms)) for member in self.members]

    def _record(self, member: Member, forms: list[str]) -> ConditionalInformation:
        effects = member.effects
        assert effects is not None
        columns = np.concatenate([np.zeros(0, dtype=np.intp), *(self.parts[forms.index(f)] for f in effects.forms)])
        at = np.append(columns, self.count + np.arange(SEASON_COLUMNS))
        unit = np.append(self.usual[columns], np.ones(SEASON_COLUMNS))
        size = self.count + SEASON_COLUMNS
        information, score = (
            np.zeros((len(effects.conditional), size, size)),
            np.zeros((len(effects.conditional), size)),
        )
        for k, products in enumerate(effects.conditional):
            information[k][np.ix_(at, at)] = products.information * np.outer(unit, unit)
            score[k, at] = products.score * unit
        uneven = np.ones(self.count)
        uneven[columns] = effects.uneven
        return ConditionalInformation(
            information, score, np.array([products.log_likelihood for products in effects.conditional]), uneven
        )

    def columns(self, hypothesis: Hypothesis) -> NDArray[np.intp]:
        """List the columns of a hypothesis, followed by those of the season."""
        effect_columns = [self.parts[k] for k in hypothesis]
        return np.concatenate([*effect_columns, self.count + np.arange(SEASON_COLUMNS)]).astype(np.intp)

    def mode(self, hypothesis: Hypothesis, season_deg: float, chosen: Sequence[int]) -> Mode:
        """Find the likeliest amplitudes from some of the records, and the log evidence.

        Args:
            hypothesis: indices of the effects that these records share.
            season_deg: size of the season of the water, rms.
            chosen: indices of the records.
        """
        at, effect_count = self.columns(hypothesis), sum(len(self.parts[k]) for k in hypothesis)
        precision = np.ones(len(at))
        precision[effect_count:] = season_deg**-2.0
        each = []
        for j in chosen:
            record = self.records[j]
            uneven = float(record.uneven[at[:effect_count]].max(initial=1.0))
            each.append((record.information[:, at[:, None], at] / uneven, record.score[:, at] / uneven, record))
        values: Floats = np.zeros(len(at))
        for _ in range(NEWTON_STEPS):
            information, score, logs = np.zeros((len(at),) * 2), np.zeros(len(at)), 0.0
            for products, scores, record in each:
                likely = record.log_weight + scores @ values - 0.5 * np.einsum("wij,i,j->w", products, values, values)
                share = np.exp(likely - likely.max())
                logs += float(likely.max() + np.log(share.sum()) - log_sum(record.log_weight))
                share /= share.sum()
                information += np.einsum("w,wij->ij", share, products)
                score += share @ scores
            before, values = values, np.linalg.solve(information + np.diag(precision), score)
        whole = information + np.diag(precision)
        evidence = logs - 0.5 * float(precision @ before**2)
        evidence += 0.5 * float(np.log(precision).sum() - np.linalg.slogdet(whole)[1])
        return Mode(before, information, score, evidence)

    def possible(self, hypothesis: Hypothesis, mode: Mode) -> bool:
        """Return whether the amplitudes of a hypothesis are possible, see ``Effect.possible``."""
        at = 0
        for k in hypothesis:
            part = self.parts[k]
            if not self.kinds[k]().at(mode.values[at : at + len(part)] * self.usual[part]).possible:
                return False
            at += len(part)
        return True


def infer_shared(members: Sequence[Member], alarm: float) -> SharedEffects | None:
    """Infer the effects that records share, None where fewer than two were searched."""
    evidence = JointEvidence(members)
    if len(evidence.members) < 2 or not evidence.kinds:
        return None
    forms = Counter(kind.name for kind in evidence.kinds)
    odds = [
        o - np.log(forms[k.name])
        for o, k in zip(posterior.log_prior_odds(evidence.kinds, alarm), evidence.kinds, strict=True)
    ]
    everyone = range(len(evidence.members))
    hypotheses = [
        hypothesis
        for n in range(MOST_SHARED + 1)
        for hypothesis in itertools.combinations(range(len(evidence.kinds)), n)
    ]
    hypotheses = [
        hypothesis for hypothesis in hypotheses if len({evidence.kinds[k].name for k in hypothesis}) == len(hypothesis)
    ]
    season = -np.log1p((SEASONS_DEG / SEASON_PRIOR_DEG) ** 2) + np.log(SEASONS_DEG)
    modes = [[evidence.mode(hypothesis, float(size), everyone) for size in SEASONS_DEG] for hypothesis in hypotheses]
    table = np.array([[mode.log_evidence for mode in row] for row in modes]) + season
    prior = np.array([posterior.joint_odds([odds[k] for k in hypothesis]) for hypothesis in hypotheses])
    likeliest = [row[int(np.argmax(logs))] for row, logs in zip(modes, table, strict=True)]
    table[
        [not evidence.possible(hypothesis, mode) for hypothesis, mode in zip(hypotheses, likeliest, strict=True)]
    ] = -MOST_LOG
    shared = np.array([log_sum(row) for row in table]) + prior
    apart = np.zeros(len(evidence.kinds))  # log odds of independent effects in at least one record, over none
    for k, _ in enumerate(evidence.kinds):
        alone = [evidence.mode((k,), float(SEASONS_DEG[0]), [j]).log_evidence for j in everyone]
        without = [evidence.mode((), 0.1, [j]).log_evidence for j in everyone]
        whole = float(np.sum(np.logaddexp(0.0, [odds[k] + a - b for a, b in zip(alone, without, strict=True)])))
        apart[k] = whole + float(np.log(-np.expm1(-whole))) if whole > 0.0 else -MOST_LOG
    apart += shared[0]
    logs = np.concatenate([shared, apart])
    probability = np.exp(logs - log_sum(logs))
    posterior_shared = Posterior(
        [kind.name for kind in evidence.kinds], hypotheses, probability[: len(hypotheses)], prior
    )
    sizes = np.exp(table + prior[:, None] - log_sum((table + prior[:, None]).ravel()))
    middle = float(sizes.sum(axis=0) @ SEASONS_DEG)
    spread = float(np.sqrt(sizes.sum(axis=0) @ (SEASONS_DEG - middle) ** 2))
    best = posterior_shared.best
    at = hypotheses.index(best)
    size = int(np.argmax(table[at]))
    finding_posteriors = posterior_shared.finding_posteriors(best, instead=SLOW_WATER)
    amplitudes = tuple(
        _amplitude(evidence, best, place, modes[at][size], slot, float(SEASONS_DEG[size]))
        for place, slot in enumerate(finding_posteriors)
    )
    acting, on_compass = posterior_shared.acting, float(posterior_shared.probability[1:].sum())
    return SharedEffects(
        kinds=evidence.kinds,
        records=tuple(member.name for member in evidence.members),
        amplitudes=amplitudes,
        acting=acting,
        sides={"none": 1.0 - on_compass, "compass": on_compass, "clock": 0.0, "reference": 0.0, "water": 0.0},
        season_deg=(middle, spread),
    )


def information_from_others(members: Sequence[Member], shared: SharedEffects) -> dict[str, tuple[Floats, Floats]]:
    """Compute information and score of the shared effects from some records, in the parameters' units.

    Args:
        members: all records except the one that receives the information.
    """
    evidence = JointEvidence(members)
    result: dict[str, tuple[Floats, Floats]] = {}
    for amplitude in shared.amplitudes:
        if amplitude.kind in evidence.kinds:
            number = evidence.kinds.index(amplitude.kind)
            mode = evidence.mode(
                (number,), max(shared.season_deg[0], float(SEASONS_DEG[0])), range(len(evidence.members))
            )
            k, usual = len(amplitude.values), evidence.usual[evidence.parts[number]]
            season = mode.information[k:, k:] + np.eye(SEASON_COLUMNS) * max(shared.season_deg[0], 0.1) ** -2.0
            gain = np.linalg.solve(season, mode.information[k:, :k]).T
            information = mode.information[:k, :k] - gain @ mode.information[k:, :k]
            score = mode.score[:k] - gain @ mode.score[k:]
            result[amplitude.kind.__name__] = (information / np.outer(usual, usual), score / usual)
    return result


def _amplitude(
    evidence: JointEvidence,
    best: Hypothesis,
    place: int,
    mode: Mode,
    slot: posterior.FindingPosterior,
    season_deg: float,
) -> SharedAmplitude:
    k = best[place]
    begin = sum(len(evidence.parts[j]) for j in best[:place])
    columns = np.arange(begin, begin + len(evidence.parts[k]))
    precision = np.ones(len(mode.values))
    precision[sum(len(evidence.parts[j]) for j in best) :] = season_deg**-2.0
    covariance, usual = np.linalg.inv(mode.information + np.diag(precision)), evidence.usual[evidence.parts[k]]
    values = mode.values[columns] * usual
    each: dict[str, tuple[Floats, Floats]] = {}
    for j, member in enumerate(evidence.members):
        alone = evidence.mode((k,), season_deg, [j])
        prior = np.append(np.ones(len(usual)), np.full(SEASON_COLUMNS, season_deg**-2.0))
        spread = np.linalg.inv(alone.information + np.diag(prior))
        each[member.name] = (
            alone.values[: len(usual)] * usual,
            np.sqrt(np.diag(spread)[: len(usual)]) * usual,
        )
    everyone, total = range(len(evidence.members)), 0.0
    for j in everyone:
        others = [i for i in everyone if i != j]
        both, without = evidence.mode((k,), season_deg, list(everyone)), evidence.mode((), season_deg, list(everyone))
        less, none = evidence.mode((k,), season_deg, others), evidence.mode((), season_deg, others)
        total += both.log_evidence - less.log_evidence - (without.log_evidence - none.log_evidence)
    return SharedAmplitude(
        kind=evidence.kinds[k],
        values=values,
        covariance=covariance[np.ix_(columns, columns)] * np.outer(usual, usual),
        rms_effect_deg=float(np.sqrt(values @ _visible_products(evidence, k) @ values)),
        probability=slot.probability,
        alternatives=dict(slot.alternatives),
        each=each,
        gain=total,
    )


def _visible_products(evidence: JointEvidence, k: int) -> Floats:
    """Average the products of an effect's visible columns over the records, square degrees."""
    each = []
    for member in evidence.members:
        assert member.effects is not None
        each += [
            member.effects.visible[np.ix_(part, part)]
            for form, part in _form_parts(member)
            if form == evidence.kinds[k].__name__
        ]
    return np.asarray(np.mean(each, axis=0))


def _form_parts(member: Member) -> list[tuple[str, NDArray[np.intp]]]:
    assert member.effects is not None
    ends = np.cumsum([0, *member.effects.parts])
    return [
        (form, np.arange(a, b)) for form, (a, b) in zip(member.effects.forms, itertools.pairwise(ends), strict=True)
    ]
