"""The posterior of a recording, linearized at its likeliest hypothesis, which is refitted in the forward model.

Every hypothesis, none or up to three effects, is weighed with slow noise marginalized. Columns of effects are slopes,
and widths, filter and slow noise are estimated from the residual: both are computed again where the likeliest
hypothesis has been refitted, until it stays the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import COMPOSED, SLOW_WATER, Effect
from compasslib.effects.composed import DRIVERS, ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.effects.forward import heading_jacobian
from compasslib.inference import design, evidence, grammar, noise
from compasslib.inference.current import coupled_drivers
from compasslib.inference.design import Estimate, FittedModel
from compasslib.inference.evidence import TEMPERATURE, Candidates, follows_current
from compasslib.inference.grammar import Composition
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import FindingPosterior, Hypothesis
from compasslib.inference.weighing import NoiseMarginalPosterior, average_posteriors, compute_posterior, likeliest_water
from compasslib.statistics.whitening import correlation_time, sampling_interval_s, scaled_inverse
from compasslib.types import Floats

SLOW: Mapping[str, Callable[[SlowNoiseParams], float]] = {
    "slow_rms_deg": lambda water: water.veer.size,
    "slow_memory_days": lambda water: water.veer.memory_days,
    "slow_shear_m_s": lambda water: water.shear.size,
}
STEADY = 1e-8  # share of what is known of a column that keeps its inverse steady
MUCH_VEER_DEG, PLAIN = 1.4, 50.0  # slow veer that may hide an effect; its log evidence but for it: water feigns half
MOST_BEGINNINGS, CHARGE = 4, 5.0  # effects that are tried so, and what each of their parameters must gain
MOST_SURE = 1.4  # log odds of one of two views that contradict each other: neither counts for less than a fifth
MOST_ROUNDS = 5  # of standing elsewhere and looking again: seconds
LEAST_WEIGHT = 0.05  # probability below which a hypothesis does not enter the product


@dataclass(frozen=True)
class Inference:
    """The likeliest hypothesis refitted, and how probable it and the others are."""

    state: FittedModel  # with its terms, slow water in the noise
    posterior: NoiseMarginalPosterior
    chosen: Hypothesis  # the terms' candidates, in their order
    finding_posteriors: tuple[FindingPosterior, ...]
    slow: SlowNoiseBasis | None  # with the current as it was learnt

    def estimate(self, state: FittedModel) -> Estimate:
        """Compute the covariance of everything that a state was refitted with, averaged over slow water.

        Args:
            state: of this recording, with any terms.
        """
        posterior, slow = self.posterior, _without_rivals(self.slow, state.simulation.terms)
        quiet = design.evaluate_model(replace(state.case, low_rank=None), state.simulation, state.nuisance)
        columns = quiet.base if slow is None else np.concatenate([quiet.base, slow.columns], axis=1)
        scale = np.linalg.norm(quiet.base, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        white = quiet.whitener(columns) * quiet.response / quiet.sigma / np.sqrt(posterior.candidates.scatter)
        white[:, : len(scale)] /= scale
        information = white.T @ white
        score = white.T @ quiet.innovation / quiet.sigma / np.sqrt(posterior.candidates.scatter)
        known = STEADY * np.diag(information)[: len(scale)]
        ridge = np.diag(quiet.base_ridge * (quiet.response / quiet.sigma / scale) ** 2 + known)
        ridge += quiet.external_information()[0] / np.outer(scale, scale)
        steps, covariances = [], []
        for water in posterior.waters:
            products = evidence.marginalize_slow_noise(
                information, score, len(scale), evidence.noise_variances(slow, water)
            )
            covariances.append(scaled_inverse(products.information + ridge))
            steps.append(covariances[-1] @ products.score)
        weight = posterior.water_probability
        step = np.array(steps) - weight @ np.array(steps)
        covariance = np.einsum("w,wij->ij", weight, np.array(covariances)) + (weight[:, None] * step).T @ step
        return Estimate(state, covariance / np.outer(scale, scale))

    def display_name(self, effect: str) -> str:
        """Name an effect as a diagnosis does: a composed field by its larger part.

        Args:
            effect: name of a candidate.
        """
        if not effect.startswith(COMPOSED):
            return effect
        posterior = self.posterior
        containing = [i for i, names in enumerate(posterior.names) if effect in names]
        best = posterior.hypotheses[max(containing, key=lambda i: float(posterior.probability[i]))]
        term = next(each for each in posterior.terms_of(best) if each.name == effect)
        assert isinstance(term, ComposedEffect)
        return COMPOSED + "/".join(term.said())

    def only(self, selection: Sequence[bool]) -> Inference:
        """Refit with some of the terms only.

        Args:
            selection: of each term whether it stays.
        """
        if all(selection):
            return self
        terms = [term for term, stays in zip(self.state.simulation.terms, selection, strict=True) if stays]
        chosen = tuple(k for k, stays in zip(self.chosen, selection, strict=True) if stays)
        finding_posteriors = tuple(
            finding for finding, stays in zip(self.finding_posteriors, selection, strict=True) if stays
        )
        return replace(
            self, state=design.refit(self.state, terms), chosen=chosen, finding_posteriors=finding_posteriors
        )

    @property
    def weighted(self) -> list[tuple[float, FittedModel]]:
        """The states that correct the record, each by the probability of its hypotheses, less than 1 in all.

        Of hypotheses that differ by a date only, or by the form in which a reading follows what the current may, the
        likeliest stands for all.
        """
        groups, posterior = self.posterior.candidates.groups, self.posterior
        chosen = self._alike(self.state.simulation.terms)
        weighed = list(zip(posterior.hypotheses, posterior.probability.tolist(), strict=True))
        if len(self.chosen) < len(posterior.best):  # names were taken back: nothing is known of the others' weights
            weighed = [(self.chosen, 1.0)]
        weights: dict[frozenset[type | str], float] = {}
        best: dict[frozenset[type | str], tuple[float, Hypothesis]] = {}
        for hypothesis, p in weighed:
            kinds = self._alike([groups[k].term for k in hypothesis])
            weights[kinds] = weights.get(kinds, 0.0) + p
            best[kinds] = max(best.get(kinds, (0.0, hypothesis)), (p, hypothesis), key=lambda x: x[0])
        likely = {kinds: weight for kinds, weight in weights.items() if weight >= LEAST_WEIGHT or kinds == chosen}
        for kinds in weights.keys() - likely.keys():  # some effects and a doubtful further one: counted without it
            if contained := [other for other in likely if other and other < kinds]:
                likely[max(contained, key=lambda other: weights[other])] += weights[kinds]
        states = [
            (weight, self.state if kinds == chosen else self._refitted(best[kinds][1]))
            for kinds, weight in likely.items()
        ]
        return sorted(states, key=lambda each: (each[1] is not self.state, -each[0]))

    def _alike(self, terms: Sequence[Effect | None]) -> frozenset[type | str]:
        drivers = () if self.slow is None else self.slow.drivers
        return frozenset(
            min(coupled_drivers(term.driver)) if term is not None and follows_current(term, drivers) else type(term)
            for term in terms
        )

    def _refitted(self, hypothesis: Hypothesis) -> FittedModel:
        """Refit a hypothesis, the current that its readings stand for left out of the noise."""
        candidates, water, state = self.posterior.candidates, self.posterior.water_of(hypothesis), self.state
        terms = self.posterior.terms_of(hypothesis)
        if candidates.rivals(hypothesis):
            quiet = design.evaluate_model(replace(state.case, low_rank=None), state.simulation, state.nuisance)
            state = _with_noise(state, quiet, _without_rivals(self.slow, terms), water)
        return design.refit(state, terms)


def infer(empty: FittedModel, odds: float) -> Inference:
    """Infer what acts beside the fitted compass.

    Args:
        empty: the simulation without terms.
        odds: prior odds of a fault of compass or clock.
    """
    slow = noise.slow_noise_basis(empty.case)
    waters: Sequence[SlowNoiseParams | None] = [None] if slow is None else slow.waters()
    listed = evidence.enumerate_candidates(empty, [])
    state = replace(empty, case=replace(empty.case, usual=listed.by_kind))
    whole = evidence.build_candidates(state, slow, listed, np.ones(len(listed.groups)))
    state, learnt, water = _initialize(state, whole, waters)
    composed = _screen(state, learnt, water)
    state = _with_priors(state, composed)
    stood = {_kinds(state.simulation.terms): state}
    for _ in range(MOST_ROUNDS):
        candidates, view = _candidates_at(state, slow, composed)
        posterior = compute_posterior(candidates, odds, waters)
        best = posterior.best
        kinds = _kinds([candidates.groups[k].term for k in best])
        if _same_terms(state, candidates, best):
            break
        if kinds in stood and kinds and kinds != _kinds(state.simulation.terms):
            # Each is likelier when linearized at the other: both count, by what each leaves.
            other, state = state, stood[kinds]
            candidates, _ = _candidates_at(state, slow, composed)
            likelier = (
                (design.log_likelihood_gain(other, state) - design.log_likelihood_gain(state, other))
                / 2.0
                / candidates.scatter
                * TEMPERATURE
            )
            share = 1.0 / (1.0 + np.exp(-np.clip(likelier, -MOST_SURE, MOST_SURE)))
            posterior = average_posteriors(compute_posterior(candidates, odds, waters), posterior, share)
            best = posterior.best
            if not _same_terms(state, candidates, best):
                state = design.refit(state, posterior.terms_of(best))
            break
        water = posterior.water_of(best)
        learnt = _learn_current(candidates, best, water)
        state = _with_noise(state, view, learnt, water)
        state = design.refit(state, posterior.terms_of(best))
        state, composed = _refine_places(state, composed)
        stood[kinds] = state
        if best:
            composed = grammar.merge_compositions(composed, _screen(state, learnt, water))
            state = _with_priors(state, composed)
    learnt = _learn_current(posterior.candidates, best, posterior.water_of(best))
    return _retitle(Inference(design.refine_dates(state), posterior, best, tuple(posterior.findings_of(best)), learnt))


def _learn_current(
    candidates: Candidates, hypothesis: Hypothesis, water: SlowNoiseParams | None
) -> SlowNoiseBasis | None:
    """Set the variances of the current in the noise to those under a hypothesis."""
    current = candidates.current(hypothesis, water)
    if current is None or candidates.slow is None:
        return candidates.slow
    return replace(candidates.slow, current=current.variances).without_current(candidates.rivals(hypothesis))


def _without_rivals(slow: SlowNoiseBasis | None, terms: Sequence[Effect]) -> SlowNoiseBasis | None:
    """Remove from the noise the current of drivers that readings follow instead."""
    if slow is None:
        return None
    rivals = [coupled_drivers(term.driver) for term in terms if follows_current(term, slow.drivers)]
    return slow.without_current(set().union(*rivals)) if rivals else slow


def _screen(state: FittedModel, learnt: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> list[Composition]:
    """Screen compositions, readings that follow a driver of the current without the current, which would hide them."""
    composed = grammar.screen(state)
    drivers = [] if learnt is None else [driver for driver in DRIVERS if coupled_drivers(driver) & learnt.acting]
    if learnt is None or not drivers:
        return composed
    quiet = design.evaluate_model(replace(state.case, low_rank=None), state.simulation, state.nuisance)
    without_current = _with_noise(
        state, quiet, learnt.without_current(set().union(*map(coupled_drivers, drivers))), water
    )
    return grammar.merge_compositions(composed, grammar.screen(without_current, drivers))


def _retitle(inferred: Inference) -> Inference:
    """Put in each place the likeliest name that may stand there, refitted."""
    posterior, chosen = inferred.posterior, list(inferred.chosen)
    for place, finding in enumerate(inferred.finding_posteriors):
        names = {finding.effect: finding.probability, **finding.alternatives}
        title = max((name for name in names if name != SLOW_WATER), key=lambda name: names[name])
        others = {posterior.effects[k] for k in chosen[:place] + chosen[place + 1 :]}
        if title != finding.effect and title not in others:
            acting = [
                sum(posterior.probability[[k in each for each in posterior.hypotheses]])
                for k in range(len(posterior.effects))
            ]
            alike = [k for k, name in enumerate(posterior.effects) if name == title]
            chosen[place] = max(alike, key=lambda k: float(acting[k]))
    if tuple(chosen) == inferred.chosen:
        return inferred
    best = tuple(sorted(chosen))
    terms = posterior.terms_of(best)
    state = design.refine_dates(design.refit(inferred.state, terms))
    return replace(inferred, state=state, chosen=best, finding_posteriors=tuple(posterior.findings_of(best)))


def _refine_places(state: FittedModel, composed: Sequence[Composition]) -> tuple[FittedModel, list[Composition]]:
    """Move compositions to their best places between those that were tried, and refit.

    Rivals that have the same driver are moved to their best places too, or the chosen one would look surer.
    """
    compositions, terms = list(composed), list(state.simulation.terms)
    for k, term in enumerate(terms):
        if not isinstance(term, ComposedEffect) or not term.name.startswith(COMPOSED):
            continue
        free = design.refit(state, [other for j, other in enumerate(terms) if j != k])
        for rival in grammar.rivals(term, compositions):
            around = grammar.near(rival.term, state.case.scene)
            gains = design.score_gains(free, [design.term_columns(free, place) for place in around])
            best = around[int(np.argmax(gains))]
            compositions = grammar.merge_compositions(compositions, [replace(rival, term=best, moved=True)])
            terms[k] = best.at(term.values) if type(best) is type(term) else terms[k]
    return (
        (state, compositions) if terms == list(state.simulation.terms) else (design.refit(state, terms), compositions)
    )


def _with_priors(state: FittedModel, composed: Sequence[Composition]) -> FittedModel:
    """Add the prior scales of compositions to a state."""
    usual: dict[type[Effect], Floats] = {type(each.term): each.usual for each in composed}
    return replace(state, case=replace(state.case, usual={**usual, **state.case.usual}))


def _kinds(terms: Sequence[Effect | None]) -> frozenset[type]:
    return frozenset(map(type, terms))


def _same_terms(state: FittedModel, candidates: Candidates, hypothesis: Hypothesis) -> bool:
    zero_terms = [term.at(0.0 * term.values) for term in state.simulation.terms]
    return [candidates.groups[k].term for k in hypothesis] == zero_terms  # in the order of the catalogue, both


def _initialize(
    state: FittedModel, whole: Candidates, waters: Sequence[SlowNoiseParams | None]
) -> tuple[FittedModel, SlowNoiseBasis | None, SlowNoiseParams | None]:
    """Choose the state from which the search begins: without terms, or with one that hides in the noise it makes.

    A step of many degrees widens the scatter that it is held against, and looks like much slow water. Effects that
    would be plain without slow water are therefore refitted, with width, filter and water estimated again, and the
    search begins with the likeliest.
    """
    slow, quiet = whole.slow, whole.marginalize(None)
    water = likeliest_water(whole, waters)
    if slow is not None and (water is None or water.veer.size < MUCH_VEER_DEG):
        learnt = _learn_current(whole, (), water)
        return _with_noise(state, state, learnt, water), learnt, water
    alone = whole.log_evidence(quiet, whole.index([(k,) for k in range(len(whole.groups))]))
    best: dict[str, int] = {}
    for k in np.argsort(-alone):
        best.setdefault(whole.groups[int(k)].name, int(k))
    beginnings: list[tuple[float, FittedModel, SlowNoiseParams | None]] = [
        (_log_likelihood(state, slow, water), state, water)
    ]
    for k in [k for k in best.values() if alone[k] > PLAIN][:MOST_BEGINNINGS]:
        grown = design.refit(state, whole.terms(quiet, (k,)))
        other = None if slow is None else likeliest_water(_noise_only(grown, slow), waters)
        charge = CHARGE * len(whole.parts[k]) + np.log(
            sum(group.name == whole.groups[k].name for group in whole.groups)
        )
        beginnings.append((_log_likelihood(grown, slow, other) - charge, grown, other))
    _, begun, water = max(beginnings, key=lambda each: each[0])
    learnt = None if slow is None else _learn_current(_noise_only(begun, slow), (), water)
    return _with_noise(begun, begun, learnt, water), learnt, water


def _noise_only(state: FittedModel, slow: SlowNoiseBasis) -> Candidates:
    """Build the products of slow noise alone, without candidates."""
    return evidence.build_candidates(state, slow, evidence.CandidateColumns([], np.zeros(0), []), np.ones(1))


def _log_likelihood(state: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> float:
    """Compute the log likelihood of a state with slow water, up to a constant of the recording."""
    width = state.whitener.width_deg
    known = np.isfinite(width)
    gain = 0.0
    if slow is not None and water is not None:
        gain = _noise_only(state, slow).marginalize(water).log_likelihood + water.log_prior
    return gain - float(np.sum(np.log(width[known]))) - int(known.sum()) * float(np.log(state.sigma))


def _with_noise(
    state: FittedModel, view: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None
) -> FittedModel:
    """Put slow noise into the noise of a state.

    Args:
        view: whose whitener knows no slow water.
    """
    low_rank = None if slow is None or water is None else noise.low_rank_noise(view, slow, water)
    return design.evaluate_model(replace(state.case, low_rank=low_rank), state.simulation, state.nuisance)


def _candidates_at(
    state: FittedModel, slow: SlowNoiseBasis | None, composed: Sequence[Composition]
) -> tuple[Candidates, FittedModel]:
    """Build all candidates, linearized at a state, and the state without slow water."""
    view, half = freed_model(state)
    groups = evidence.enumerate_candidates(half, composed)
    return evidence.build_candidates(view, slow, groups, evidence.score_inflation(state, groups.groups)), view


def freed_model(state: FittedModel) -> tuple[FittedModel, FittedModel]:
    """Give the terms back to the residual, without slow water, and build a state for slopes half way."""
    quiet, half = replace(state.case, low_rank=None), design.midpoint_linearization(state)
    slopes = heading_jacobian(half.simulation, quiet.scene, half.heading_deg, first=5)
    effect = np.nan_to_num(slopes) @ state.simulation.parameters[5:]
    return design.evaluate_model(quiet, state.simulation, state.nuisance, freed_deg=effect), half


def summarize_noise(inferred: Inference) -> dict[str, tuple[float, float]]:
    """Summarize the noise, each number with its standard error."""
    state, weight = inferred.state, inferred.posterior.water_probability
    time_s = state.case.scene.time_s
    hours, step = float(np.ptp(time_s)) / HOUR_S, sampling_interval_s(time_s) / HOUR_S
    short = correlation_time(state.whitener) * step
    width = state.whitener.width_deg
    white = float(np.median(width[np.isfinite(width)]))
    result = {
        "white_deg": (white, white * float(np.sqrt((step + 2.0 * short) / (2.0 * hours)))),
        "short_hours": (short, short * float(np.sqrt(2.0 * (step + short) / hours))),
    }
    for name, value_of in SLOW.items():
        each = np.array([0.0 if water is None else value_of(water) for water in inferred.posterior.waters])
        mean = float(weight @ each)
        result[name] = (mean, float(np.sqrt(weight @ (each - mean) ** 2)))
    return result
