"""The posterior of a recording, linearized at its most probable hypothesis, which is refitted in the forward model.

The posterior of all hypotheses, none or up to three effects, is computed with slow noise marginalized. The columns of
effects are derivatives, and widths, filter and slow noise are estimated from the residual: both are recomputed after
the most probable hypothesis has been refitted, until it no longer changes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from compasslib.effects import COMPOSED, SLOW_WATER, Effect
from compasslib.effects.composed import DRIVERS, ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.inference import design, evidence, grammar, noise
from compasslib.inference.current import coupled_drivers
from compasslib.inference.design import FittedModel
from compasslib.inference.evidence import TEMPERATURE, Candidates
from compasslib.inference.grammar import Composition
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import Hypothesis
from compasslib.inference.weighing import (
    Inference,
    average_posteriors,
    compute_posterior,
    likeliest_water,
    with_slow_noise,
)
from compasslib.statistics.whitening import correlation_time, sampling_interval_s
from compasslib.types import Floats

SLOW: Mapping[str, Callable[[SlowNoiseParams], float]] = {
    "slow_rms_deg": lambda water: water.veer.size,
    "slow_memory_days": lambda water: water.veer.memory_days,
    "slow_shear_m_s": lambda water: water.shear.size,
}
MUCH_VEER_DEG, PLAIN = 1.4, 50.0  # veer that may hide effects; their log evidence without slow noise, which mimics half
MOST_BEGINNINGS, CHARGE = 4, 5.0  # number of effects tried as starting point, and log likelihood cost of each parameter
MOST_SURE = 1.4  # largest log odds between two conflicting linearizations: the weight of each is at least a fifth
MOST_ROUNDS = 5  # maximum number of relinearizations, limited for speed


def infer(empty: FittedModel, odds: float) -> Inference:
    """Infer which effects act in addition to the fitted compass.

    Args:
        empty: the fitted simulation without terms.
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
            # Each is more probable when linearized at the other: average both, weighted by their likelihoods.
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
        state = with_slow_noise(state, view, learnt, water)
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
    """Set the variances of the current in the slow noise to their estimate under a hypothesis."""
    current = candidates.current(hypothesis, water)
    if current is None or candidates.slow is None:
        return candidates.slow
    return replace(candidates.slow, current=current.variances).without_current(candidates.rivals(hypothesis))


def _screen(state: FittedModel, learnt: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> list[Composition]:
    """Screen compositions; readings that depend on a driver of the current are screened without that current too."""
    composed = grammar.screen(state)
    drivers = [] if learnt is None else [driver for driver in DRIVERS if coupled_drivers(driver) & learnt.acting]
    if learnt is None or not drivers:
        return composed
    quiet = design.evaluate_model(replace(state.case, low_rank=None), state.simulation, state.nuisance)
    without_current = with_slow_noise(
        state, quiet, learnt.without_current(set().union(*map(coupled_drivers, drivers))), water
    )
    return grammar.merge_compositions(composed, grammar.screen(without_current, drivers))


def _retitle(inferred: Inference) -> Inference:
    """Replace each selected effect by its most probable alternative, if that is more probable, and refit."""
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
    """Refine the places of compositions between those of the screening, and refit.

    Alternatives with the same driver are refined too, otherwise the selected one would appear too probable.
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
    """Add the prior standard deviations of compositions to a model."""
    usual: dict[type[Effect], Floats] = {type(each.term): each.usual for each in composed}
    return replace(state, case=replace(state.case, usual={**usual, **state.case.usual}))


def _kinds(terms: Sequence[Effect | None]) -> frozenset[type]:
    return frozenset(map(type, terms))


def _same_terms(state: FittedModel, candidates: Candidates, hypothesis: Hypothesis) -> bool:
    zero_terms = [term.at(0.0 * term.values) for term in state.simulation.terms]
    return [candidates.groups[k].term for k in hypothesis] == zero_terms  # both in the order of the catalogue


def _initialize(
    state: FittedModel, whole: Candidates, waters: Sequence[SlowNoiseParams | None]
) -> tuple[FittedModel, SlowNoiseBasis | None, SlowNoiseParams | None]:
    """Select the model from which the search starts: without terms, or with a large effect that inflates the noise.

    A step of many degrees widens the scatter against which it is tested, and resembles strong slow noise. Effects that
    would be evident without slow noise are therefore refitted, with width, filter and slow noise estimated again, and
    the search starts from the most likely model.
    """
    slow, quiet = whole.slow, whole.marginalize(None)
    water = likeliest_water(whole, waters)
    if slow is not None and (water is None or water.veer.size < MUCH_VEER_DEG):
        learnt = _learn_current(whole, (), water)
        return with_slow_noise(state, state, learnt, water), learnt, water
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
    return with_slow_noise(begun, begun, learnt, water), learnt, water


def _noise_only(state: FittedModel, slow: SlowNoiseBasis) -> Candidates:
    """Build the linear model of slow noise alone, without candidates."""
    return evidence.build_candidates(state, slow, evidence.CandidateColumns([], np.zeros(0), []), np.ones(1))


def _log_likelihood(state: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None) -> float:
    """Compute the log likelihood of a model with slow noise, up to a constant of the recording."""
    width = state.whitener.width_deg
    known = np.isfinite(width)
    gain = 0.0
    if slow is not None and water is not None:
        gain = _noise_only(state, slow).marginalize(water).log_likelihood + water.log_prior
    return gain - float(np.sum(np.log(width[known]))) - int(known.sum()) * float(np.log(state.sigma))


def _candidates_at(
    state: FittedModel, slow: SlowNoiseBasis | None, composed: Sequence[Composition]
) -> tuple[Candidates, FittedModel]:
    """Build all candidates, linearized at a model, and that model with its terms freed, without slow noise."""
    view, half = design.freed_model(state)
    groups = evidence.enumerate_candidates(half, composed)
    return evidence.build_candidates(view, slow, groups, evidence.score_inflation(state, groups.groups)), view


def summarize_noise(inferred: Inference) -> dict[str, tuple[float, float]]:
    """Estimate the parameters of the noise, each with its standard error."""
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
