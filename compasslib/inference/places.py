"""Options in the place of each effect of a model, and the models that are fitted with the likeliest ones."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import Effect
from compasslib.inference import design, noise
from compasslib.inference.blocks import Option
from compasslib.inference.design import FittedModel
from compasslib.inference.linear_model import Entered, Evidence, LinearModel, Products, linearize
from compasslib.inference.noise import SlowNoise, SlowNoiseBasis
from compasslib.types import Floats

MOST_ROUNDS = 4  # exchanges of terms; limits the run time
# Probability of no effect up to which one enters and stays: a Bayes factor of 3 (Kass and Raftery, JASA 90, 773, 1995).
UNLIKELY = 0.25
SIDES_IN_ORDER = ("compass", "clock", "reference", "water")


@dataclass(frozen=True)
class Place:
    """The place of one effect in a model: the probability of each option in it, the other effects given."""

    probability: Floats  # (g,) of each option; the rest is that of none
    evidence: Evidence  # of the options in this place

    @property
    def none(self) -> float:
        """Probability that no effect is there."""
        return float(max(1.0 - self.probability.sum(), 0.0))

    def not_favoured(self, odds: float) -> Place:
        """Limit the odds of an effect that is not detected to those beforehand: surrogates have evidence like it."""
        most = odds / (1.0 + odds)
        return replace(self, probability=self.probability * min(most / max(float(self.probability.sum()), 1e-12), 1.0))


@dataclass(frozen=True)
class Settled:
    """A fitted model, linearized, with the options in the place of each of its terms."""

    fitted: FittedModel
    model: LinearModel
    entered: Entered
    places: tuple[Place, ...]

    @property
    def kinds(self) -> tuple[type[Effect], ...]:
        """Classes of the terms."""
        return tuple(type(self.model.options[k].term) for k, _ in self.entered)

    def held(self) -> float:
        """Compute the smallest probability that a term has in its place, all dates together."""
        each = zip(self.kinds, self.places, strict=True)
        alike = [([type(option.term) is kind for option in self.model.options], place) for kind, place in each]
        return min((float(place.probability[same].sum()) for same, place in alike), default=1.0)

    def averaged(self, other: Settled) -> Settled:
        """Average the probabilities with those of another linearization, in the places beside the same terms."""
        twins = {frozenset(other.kinds) - {kind}: place for kind, place in zip(other.kinds, other.places, strict=True)}
        places = []
        for kind, place in zip(self.kinds, self.places, strict=True):
            if (twin := twins.get(frozenset(self.kinds) - {kind})) is not None:
                terms = (option.term for option in other.model.options)
                known = dict(zip(terms, twin.probability.tolist(), strict=True))
                there = np.array([known.get(option.term, 0.0) for option in self.model.options])
                place = replace(place, probability=(place.probability + there) / 2.0)
            places.append(place)
        return replace(self, places=tuple(places))


def settle(
    fitted: FittedModel,
    slow: SlowNoiseBasis | None,
    slow_noises: Sequence[SlowNoise | None],
    amplitudes: Sequence[float],
    odds: float,
) -> Settled:
    """Linearize a model, and replace or remove terms that are not the likeliest ones in their places."""
    before = dict[frozenset[type[Effect]], Settled]()
    for rounds in range(1, MOST_ROUNDS + 1):
        model = linearize(fitted, slow)
        entered = _located(model, fitted, amplitudes)
        places = []
        for k in range(len(entered)):
            weighed = model.weigh(slow_noises, [*entered[:k], *entered[k + 1 :]])
            places.append(Place(probabilities(model.options, weighed, odds), weighed))
        settled = Settled(fitted, model, entered, tuple(places))
        better = _better(model, entered, places)
        kinds = frozenset(type(model.options[k].term) for k, _ in better)
        before[frozenset(settled.kinds)] = settled
        if better == entered or rounds == MOST_ROUNDS:
            break
        if kinds in before:  # each is likelier where the other is linearized
            other = before[kinds]
            both = settled.averaged(other), other.averaged(settled)
            return max(both, key=Settled.held)
        slow_noise = model.weigh(slow_noises, better).likeliest_noise()
        fitted, amplitudes = fit_terms(fitted, model, better, slow_noise), [size for _, size in better]
    return settled


def _better(model: LinearModel, entered: Entered, places: Sequence[Place]) -> list[tuple[int, float]]:
    """Replace the first term that is not the likeliest in its place, or remove it if none is likelier."""
    for number, ((chosen, _), place) in enumerate(zip(entered, places, strict=True)):
        others = [*entered[:number], *entered[number + 1 :]]
        taken = {type(model.options[k].term) for k, _ in others}
        k = likeliest_option(model.options, place.evidence, taken)
        if place.none > UNLIKELY:
            return list(others)
        if type(model.options[k].term) is not type(model.options[chosen].term):
            return sorted([*others, (k, model.likeliest_amplitude(k, place.evidence.likeliest_noise(k), others))])
    return list(entered)


def side_probabilities(
    options: Sequence[Sequence[Option]], places: Sequence[Place], dropped: Collection[str] = ()
) -> dict[str, float]:
    """Compute the probability that each side acts, the first of SIDES_IN_ORDER if several do, and of none.

    Args:
        options: those of each place.
        dropped: names of effects to ignore.
    """
    result, before = dict[str, float](), 1.0
    for number in range(1, len(SIDES_IN_ORDER) + 1):
        without = 1.0
        for each, place in zip(options, places, strict=True):
            acts = [o.block[0] in SIDES_IN_ORDER[:number] and o.name not in dropped for o in each]
            without *= 1.0 - float(place.probability[acts].sum())
        result[SIDES_IN_ORDER[number - 1]], before = max(before - without, 0.0), without
    return {"none": before} | result


def name_probabilities(options: Sequence[Option], place: Place) -> dict[str, float]:
    """Sum the probability of each effect in a place over its forms and dates."""
    sums: dict[str, float] = {}
    for option, probability in zip(options, place.probability.tolist(), strict=True):
        sums[option.name] = sums.get(option.name, 0.0) + probability
    return sums


def probabilities(options: Sequence[Option], evidence: Evidence, odds: float, taken: Collection[int] = ()) -> Floats:
    """Compute the probability of each option in a place, (g,)."""
    fault = np.array([option.block[0] in ("compass", "clock") for option in options])
    log = evidence.log_bayes_factors[:, 0] + np.where(fault, np.log(odds), 0.0)
    log[list(taken)] = -np.inf
    top = max(float(log.max(initial=-np.inf)), 0.0)
    weight = np.exp(log - top)
    return np.asarray(weight / (weight.sum() + np.exp(-top)))


def likeliest_option(options: Sequence[Option], evidence: Evidence, taken: Collection[type[Effect]]) -> int:
    """Select the likeliest form, dates together, that is not in the model yet, at its likeliest date."""
    sums, log = dict[type[Effect], float](), evidence.log_bayes_factors[:, 0]
    for option, each in zip(options, log.tolist(), strict=True):
        if type(option.term) not in taken:
            sums[type(option.term)] = float(np.logaddexp(sums.get(type(option.term), -np.inf), each))
    form = max(sums, key=lambda kind: sums[kind])
    alike = [k for k, option in enumerate(options) if type(option.term) is form]
    return max(alike, key=lambda k: float(log[k]))


def _located(model: LinearModel, fitted: FittedModel, amplitudes: Sequence[float]) -> list[tuple[int, float]]:
    """Locate the terms of a model among the options that are linearized at it, with their amplitudes."""
    zero_terms = [term.at(0.0 * term.values) for term in fitted.simulation.terms]
    places = {option.term: k for k, option in enumerate(model.options)}
    return [(places[term], size) for term, size in zip(zero_terms, amplitudes, strict=True)]


def fit_terms(fitted: FittedModel, model: LinearModel, entered: Entered, slow_noise: SlowNoise | None) -> FittedModel:
    """Fit options in the forward model, with slow noise of given parameters in the whitener."""
    terms = [
        model.options[k].term.at(values) for (k, _), values in zip(entered, model.fit(entered, slow_noise), strict=True)
    ]
    usual = {type(model.options[k].term): size * model.options[k].usual for k, size in entered}
    fitted = replace(fitted, comparison=replace(fitted.comparison, usual={**fitted.comparison.usual, **usual}))
    learnt = learn_current(model, entered, slow_noise)
    return design.refit(with_slow_noise(fitted, model.freed, learnt, slow_noise), terms)


def learn_current(model: LinearModel, entered: Entered, slow_noise: SlowNoise | None) -> SlowNoiseBasis | None:
    """Set the variances of the current in the slow noise to their estimate beside some options."""
    current = model.current(entered, slow_noise)
    if current is None or model.slow is None:
        return model.slow
    excluded = model.slow.current == 0.0 if model.slow.current is not None else np.zeros(len(current.variances), bool)
    return replace(model.slow, current=np.where(excluded, 0.0, current.variances))


def with_slow_noise(
    fitted: FittedModel, freed: FittedModel, slow: SlowNoiseBasis | None, slow_noise: SlowNoise | None
) -> FittedModel:
    """Add slow noise to the noise model of a fitted model.

    Args:
        freed: fitted model whose whitener excludes slow noise.
    """
    low_rank = None if slow is None or slow_noise is None else noise.low_rank_noise(freed, slow, slow_noise)
    return design.evaluate_model(replace(fitted.comparison, low_rank=low_rank), fitted.simulation, fitted.nuisance)


def with_likeliest_noise(
    fitted: FittedModel, slow: SlowNoiseBasis | None, slow_noises: Sequence[SlowNoise | None]
) -> FittedModel:
    """Add the likeliest slow noise without effects to the noise model of a fitted model."""
    if slow is None:
        return fitted
    white = fitted.whiten_and_project(slow.columns.astype(np.float32)) * np.float32(fitted.response / fitted.sigma)
    model = LinearModel(fitted, (), slow, white, 1.0)
    return with_slow_noise(fitted, fitted, slow, model.weigh(slow_noises).likeliest_noise())


def marginalize(information: Floats, score: Floats, n: int, variance: Floats) -> tuple[Floats, Floats, float]:
    """Marginalize the coefficients of noise columns in the products of columns; return also the log likelihood.

    Args:
        information: products of all columns, those of the noise last, (n + q, n + q).
        score: products with the residual, (n + q,).
        n: number of columns that are not marginalized.
        variance: prior variance of the noise's coefficients, (q,).
    """
    marginal = Products(information, score[:, None], np.arange(n + 1), np.ones((1, n))).marginalize(variance)
    left, score_left = marginal.left(np.arange(n))
    return left, score_left[:, 0], float(marginal.none[0])
