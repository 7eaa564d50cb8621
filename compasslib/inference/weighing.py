"""Compute the posterior of all hypotheses with slow noise marginalized, and the detection limits of effects."""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import COMPOSED, SLOW_WATER, Effect
from compasslib.effects.composed import ComposedEffect
from compasslib.inference import design, evidence, noise
from compasslib.inference.current import coupled_drivers
from compasslib.inference.design import Estimate, FittedModel, Products
from compasslib.inference.evidence import TEMPERATURE, Candidates, follows_current
from compasslib.inference.noise import SlowNoiseBasis, SlowNoiseParams
from compasslib.inference.posterior import (
    AGAIN,
    LOG_EVIDENCE_CUTOFF,
    MOST_TERMS,
    UNLISTED,
    FindingPosterior,
    Hypothesis,
    Posterior,
    log_prior,
    log_shares,
)
from compasslib.statistics.whitening import scaled_inverse
from compasslib.types import Floats

NINE_IN_TEN = 1.28  # normal score of a probability of 90 %
NEIGHBOURS = 3  # number of dates that fit about as well as the true one
MOST_PAIRS, MOST_TRIPLES, JOINED, MOST_WATERS = 150, 60, 12, 40  # limits of run time and memory
LIKELY = 25  # likeliest effects in calm and in rough water, for which every kind of water is evaluated
STATED = 3.0  # Bayes factor of tempered evidence from which an effect is stated; 12 null records reach at most 0.3

STEADY = 1e-8  # ridge relative to a column's information, which stabilizes the inverse
LEAST_WEIGHT = 0.05  # probability below which a hypothesis does not enter the correction


@dataclass(frozen=True)
class NoiseMarginalPosterior(Posterior):
    """Hypotheses with their probabilities, marginalized over slow water of unknown size and memory."""

    candidates: Candidates
    waters: list[SlowNoiseParams | None]
    by_water: Floats  # (w, h) joint probability, sums to 1
    odds: float  # prior odds of a fault of compass or clock

    @property
    def water_probability(self) -> Floats:
        """Posterior probability of each kind of slow water, (w,)."""
        return np.asarray(self.by_water.sum(axis=1))

    @property
    def counts(self) -> list[int]:
        """Number of effects of each hypothesis, excluding those always present."""
        kinds = self.candidates.kinds
        return [sum(not kinds[k].always_present for k in hypothesis) for hypothesis in self.hypotheses]

    @property
    def stated_count(self) -> int:
        """Number of effects, each additional one with a Bayes factor of at least ``STATED``."""
        count = np.array(self.counts)
        held = [float(self.probability[count == k].sum()) for k in range(MOST_TERMS + 1)]
        stated = 0
        for k in range(1, MOST_TERMS + 1):
            beforehand = self.odds if k == 1 else AGAIN / (1.0 - AGAIN)
            if sum(held[k:]) < STATED * beforehand * held[k - 1]:
                break
            stated = k
        return stated

    def water_of(self, hypothesis: Hypothesis) -> SlowNoiseParams | None:
        """Select the likeliest slow water under a hypothesis, or under those containing it if it was not retained."""
        at = [k for k, other in enumerate(self.hypotheses) if other == hypothesis]
        at = at or [k for k, other in enumerate(self.hypotheses) if set(hypothesis) <= set(other)]
        return self.waters[int(np.argmax(self.by_water[:, at].sum(axis=1)))]

    def terms_of(self, hypothesis: Hypothesis) -> list[Effect]:
        """Build the terms of a hypothesis at their likeliest values, given its likeliest slow water."""
        absent = self.candidates.rivals(hypothesis)
        return self.candidates.terms(self.candidates.marginalize(self.water_of(hypothesis), absent), hypothesis)

    def rival_compass(self, driver: str | None, min_effect_deg: float) -> tuple[float, str]:
        """Compute the probability that the compass, not the current, follows a driver; return also the driver's name.

        Readings that follow the driver exclude that current; other compass effects of the driver do not.

        Args:
            driver: driver of the current, None for any.
            min_effect_deg: size below which the current is negligible, degrees rms.
        """
        kinds, currents, sums = self.candidates.kinds, self.candidates.currents, defaultdict[str, float](float)
        beside: list[tuple[float, Hypothesis, str]] = []
        for hypothesis, probability in zip(self.hypotheses, self.probability.tolist(), strict=True):
            coupled = [k for k in hypothesis if driver is None or driver in coupled_drivers(kinds[k].driver)]
            if followed := {kinds[k].driver for k in coupled if k in currents}:
                for name in followed:
                    sums[name] += probability
            elif others := [kinds[k].driver for k in coupled if kinds[k].side == "compass"]:
                beside.append((probability, hypothesis, others[0]))
        if beside:
            _, likeliest, name = max(beside)
            current = self.candidates.current(likeliest, self.water_of(likeliest))
            assert current is not None
            present = current.exceeds(driver, self.candidates.current_visible, min_effect_deg)
            sums[name] += (1.0 - present) * sum(probability for probability, _, _ in beside)
        return min(sum(sums.values()), 1.0), max(sums, key=lambda name: sums[name], default="")

    def findings_of(self, chosen: Hypothesis) -> list[FindingPosterior]:
        """Compute the probability of each effect of a hypothesis and of its alternatives, slow water among them."""
        products = self.candidates.marginalize(self.water_of(chosen))
        return self.finding_posteriors(
            chosen, instead=SLOW_WATER, alike=lambda a, b: _alike(self.candidates, products, a, b)
        )


def compute_posterior(
    candidates: Candidates, odds: float, waters: Sequence[SlowNoiseParams | None]
) -> NoiseMarginalPosterior:
    """Compute the posterior of all hypotheses.

    Args:
        odds: prior odds of a fault of compass or clock.
        waters: parameters of slow water to marginalize over.
    """
    shares = [name + form for name, form in zip(log_shares(candidates.kinds), candidates.shares, strict=True)]
    always = [kind.always_present for kind in candidates.kinds]

    def prior(hypotheses: Sequence[Hypothesis]) -> Floats:
        return log_prior(hypotheses, always, shares, odds)

    best: Hypothesis = ()
    rivalry: Floats = np.zeros(len(candidates.groups))

    def scored(hypotheses: Sequence[Hypothesis], indices: Sequence[int]) -> Floats:
        rivals = [max((rivalry[k] for k in each if k in candidates.currents), default=0.0) for each in hypotheses]
        return log_joint(candidates, hypotheses, [waters[i] for i in indices], best) + prior(hypotheses) + rivals

    alone: list[Hypothesis] = [(), *((k,) for k in range(len(candidates.groups)))]
    calm_and_rough = scored(alone, sorted({0, len(waters) - 1}))
    some = sorted({*candidates.currents, *(int(k) for row in calm_and_rough[:, 1:] for k in np.argsort(-row)[:LIKELY])})
    few: list[Hypothesis] = [(), *((k,) for k in some)]
    table = log_joint(candidates.subset(some), [(), *((k,) for k in range(len(some)))], waters) + prior(few)
    kept = _within_cutoff(table.max(axis=1), MOST_WATERS)
    modes = sorted({int(np.argmax(table.max(axis=1))), int(np.argmax(table[:, 0]))})
    rivalry = log_rivalry(candidates, waters[int(np.argmax(table[:, 0]))])
    best = few[int(np.argmax(table[modes].max(axis=0)))]
    near = _best_of(candidates, itertools.combinations(range(len(candidates.groups)), 2), MOST_PAIRS, scored, modes)
    tried = range(len(candidates.groups))
    triples = sorted({tuple(sorted((*pair, k))) for pair in near[:JOINED] for k in tried if k not in pair})
    near += _best_of(candidates, triples, MOST_TRIPLES, scored, modes)
    hypotheses = [*alone, *near]
    best = hypotheses[int(np.argmax(scored(hypotheses, modes).max(axis=0)))]
    joint = scored(hypotheses, kept)
    products = candidates.marginalize(waters[kept[int(np.argmax(joint.max(axis=1)))]])
    joint[
        :, [not all(term.possible for term in candidates.terms(products, hypothesis)) for hypothesis in hypotheses]
    ] = -np.inf
    joint = np.exp(joint - joint.max())
    joint /= joint.sum()
    names, likely = [group.name for group in candidates.groups], [waters[i] for i in kept]
    return NoiseMarginalPosterior(
        names, hypotheses, joint.sum(axis=0), prior(hypotheses), candidates, likely, joint, odds
    )


def average_posteriors(
    first: NoiseMarginalPosterior, second: NoiseMarginalPosterior, share: float
) -> NoiseMarginalPosterior:
    """Average two posteriors of one recording, linearized at two hypotheses.

    Args:
        first: posterior whose candidates are retained.
        share: weight of the first.
    """
    hypotheses = list(dict.fromkeys([*first.hypotheses, *second.hypotheses]))
    place = {hypothesis: k for k, hypothesis in enumerate(hypotheses)}
    rows, prior = [], np.zeros(len(hypotheses))
    for each, weight in ((first, share), (second, 1.0 - share)):
        at = [place[hypothesis] for hypothesis in each.hypotheses]
        rows.append(np.zeros((len(each.waters), len(hypotheses))))
        rows[-1][:, at] = weight * each.by_water
        prior[at] = each.prior
    joint = np.concatenate(rows)
    waters = [*first.waters, *second.waters]
    return NoiseMarginalPosterior(
        first.effects, hypotheses, joint.sum(axis=0), prior, first.candidates, waters, joint, first.odds
    )


def log_joint(
    candidates: Candidates,
    hypotheses: Sequence[Hypothesis],
    waters: Sequence[SlowNoiseParams | None],
    best: Hypothesis = (),
) -> Floats:
    """Compute the tempered log likelihood of hypotheses under each slow water, plus the log prior of the water, (w, h).

    Args:
        best: the most probable hypothesis so far, see ``Candidates.log_evidence``.
    """
    index, rows = candidates.index(hypotheses), []
    for water in waters:
        products = candidates.marginalize(water)
        evidence = products.log_likelihood + candidates.log_evidence(products, index, best)
        rows.append(TEMPERATURE * evidence + (0.0 if water is None else water.log_prior))
    return np.array(rows)


def log_rivalry(candidates: Candidates, water: SlowNoiseParams | None) -> Floats:
    """Compute the log-evidence gain of readings that follow a driver of the current if that current is excluded, (g,).

    With the current in the noise such a reading is hardly detectable, since both have nearly the same column. A driver
    is therefore assumed to act on only one of them. The current follows it in the reading's form or in any other, each
    with the prior probability of the reading at odds of one.
    """
    result = np.zeros(len(candidates.groups))
    columns = [candidates.currents.get(k, part) for k, part in enumerate(candidates.parts)]
    of_current = replace(candidates, parts=columns)
    products = candidates.marginalize(water)
    for drivers in {coupled_drivers(candidates.kinds[k].driver) for k in candidates.currents}:
        rivals = [k for k in candidates.currents if candidates.kinds[k].driver in drivers]
        alone, without = candidates.index([(k,) for k in rivals]), candidates.marginalize(water, drivers)
        share = np.log(UNLISTED * (1.0 - AGAIN)) + np.array([candidates.shares[k] for k in rivals])
        both = TEMPERATURE * candidates.log_evidence(products, alone)
        change = TEMPERATURE * (without.log_likelihood - products.log_likelihood)  # if nothing follows the driver
        reading = TEMPERATURE * candidates.log_evidence(without, alone) + change
        same_form = TEMPERATURE * of_current.log_evidence(without, of_current.index([(k,) for k in rivals])) + change
        total = np.logaddexp.reduce(share)
        current = np.logaddexp(total, np.logaddexp.reduce(share + same_form))
        result[rivals] = np.logaddexp(reading, current + both) - np.logaddexp(change, current) - both
    return result


def likeliest_water(candidates: Candidates, waters: Sequence[SlowNoiseParams | None]) -> SlowNoiseParams | None:
    """Select the slow water under which the recording is likeliest without any effect."""
    none = candidates.subset([])
    scores = [0.0 if water is None else none.marginalize(water).log_likelihood + water.log_prior for water in waters]
    return waters[int(np.argmax(scores))]


def detection_limits(posterior: NoiseMarginalPosterior) -> dict[str, float]:
    """Compute the visible size at which each effect is stated with a probability of 90 %, rms degrees.

    For an effect with several forms or dates this is the median.
    """
    candidates = posterior.candidates
    products = candidates.marginalize(posterior.water_of(posterior.best))
    taken = {candidates.groups[k].name for k in posterior.best}
    sizes: dict[str, list[float]] = {}
    for k, group in enumerate(candidates.groups):
        part = candidates.parts[k]
        information = products.information[np.ix_(part, part)] / candidates.uneven[k]
        share = float(posterior.prior[posterior.hypotheses.index((k,))]) - np.log(posterior.odds)
        alike = min(candidates.kinds.count(candidates.kinds[k]), NEIGHBOURS)
        charge = (np.log(STATED / alike) - share) / TEMPERATURE
        needed = np.sqrt(2.0 * (charge + 0.5 * np.linalg.slogdet(information + np.eye(len(part)))[1]))
        unit = np.trace(scaled_inverse(information) @ candidates.visible[np.ix_(part, part)]) / len(part)
        if group.name not in taken and not group.name.startswith(COMPOSED):
            sizes.setdefault(group.name, []).append((needed + NINE_IN_TEN) * float(np.sqrt(unit)))
    return {name: float(np.median(size)) for name, size in sizes.items()}


def _alike(candidates: Candidates, products: Products, a: int, b: int) -> float:
    """Measure the overlap of two candidates' columns, 0 to 1."""
    first, second = candidates.parts[a], candidates.parts[b]
    size = [np.trace(products.information[np.ix_(part, part)]) for part in (first, second)]
    return float(np.sum(products.information[np.ix_(first, second)] ** 2) / max(size[0] * size[1], 1e-300))


def _within_cutoff(scores: Floats, most: int) -> list[int]:
    order = np.argsort(-scores)[:most]
    return [int(i) for i in order if scores[i] > scores[order[0]] - LOG_EVIDENCE_CUTOFF]


def _best_of(
    candidates: Candidates,
    hypotheses: Iterable[Hypothesis],
    most: int,
    scored: Callable[[Sequence[Hypothesis], Sequence[int]], Floats],
    waters: Sequence[int],
) -> list[Hypothesis]:
    """Select the likeliest hypotheses under any of the given kinds of slow water."""
    admissible = [
        hypothesis
        for hypothesis in hypotheses
        if len({candidates.groups[k].name for k in hypothesis}) == len(hypothesis)  # no effect twice
    ]
    return [admissible[i] for i in _within_cutoff(scored(admissible, waters).max(axis=0), most)] if admissible else []


@dataclass(frozen=True)
class Inference:
    """The likeliest hypothesis, refitted, with the posterior of all hypotheses."""

    state: FittedModel  # fitted with its terms, slow water in the noise
    posterior: NoiseMarginalPosterior
    chosen: Hypothesis  # index of each term's candidate, in order
    finding_posteriors: tuple[FindingPosterior, ...]
    slow: SlowNoiseBasis | None  # with the estimated variances of the current

    def estimate(self, state: FittedModel) -> Estimate:
        """Compute the covariance of all parameters of a refitted model, averaged over slow water.

        Args:
            state: model of this recording, with any terms.
        """
        posterior, slow = self.posterior, without_rivals(self.slow, state.simulation.terms)
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
        """Name an effect as in a diagnosis: a composed field by its larger component.

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
        """Refit with a subset of the terms.

        Args:
            selection: whether each term is retained.
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
        """Fitted models that correct the record, with their probabilities, which sum to at most 1.

        Of hypotheses that differ only in a date, or in the form in which a reading follows a driver of the current,
        the likeliest represents all.
        """
        groups, posterior = self.posterior.candidates.groups, self.posterior
        chosen = self._alike(self.state.simulation.terms)
        weighed = list(zip(posterior.hypotheses, posterior.probability.tolist(), strict=True))
        if len(self.chosen) < len(posterior.best):  # findings were withdrawn: the other weights no longer apply
            weighed = [(self.chosen, 1.0)]
        weights: dict[frozenset[type | str], float] = {}
        best: dict[frozenset[type | str], tuple[float, Hypothesis]] = {}
        for hypothesis, p in weighed:
            kinds = self._alike([groups[k].term for k in hypothesis])
            weights[kinds] = weights.get(kinds, 0.0) + p
            best[kinds] = max(best.get(kinds, (0.0, hypothesis)), (p, hypothesis), key=lambda x: x[0])
        likely = {kinds: weight for kinds, weight in weights.items() if weight >= LEAST_WEIGHT or kinds == chosen}
        for kinds in weights.keys() - likely.keys():  # likely effects plus an unlikely one: add to those without it
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
        """Refit a hypothesis, excluding from the noise the current whose drivers its readings follow."""
        candidates, water, state = self.posterior.candidates, self.posterior.water_of(hypothesis), self.state
        terms = self.posterior.terms_of(hypothesis)
        if candidates.rivals(hypothesis):
            quiet = design.evaluate_model(replace(state.case, low_rank=None), state.simulation, state.nuisance)
            state = with_slow_noise(state, quiet, without_rivals(self.slow, terms), water)
        return design.refit(state, terms)


def without_rivals(slow: SlowNoiseBasis | None, terms: Sequence[Effect]) -> SlowNoiseBasis | None:
    """Exclude from the noise the current of those drivers that compass readings follow instead."""
    if slow is None:
        return None
    rivals = [coupled_drivers(term.driver) for term in terms if follows_current(term, slow.drivers)]
    return slow.without_current(set().union(*rivals)) if rivals else slow


def with_slow_noise(
    state: FittedModel, view: FittedModel, slow: SlowNoiseBasis | None, water: SlowNoiseParams | None
) -> FittedModel:
    """Add slow noise to the noise model of a fitted model.

    Args:
        view: fitted model whose whitener excludes slow water.
    """
    low_rank = None if slow is None or water is None else noise.low_rank_noise(view, slow, water)
    return design.evaluate_model(replace(state.case, low_rank=low_rank), state.simulation, state.nuisance)
