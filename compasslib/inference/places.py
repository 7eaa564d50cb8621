"""Models whose terms are the likeliest in their places, and readings that rival a driver of the current."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import Effect
from compasslib.effects.composed import ComposedEffect, as_current
from compasslib.inference import design, noise
from compasslib.inference.design import FittedModel
from compasslib.inference.evidence import UNLIKELY, Evidence, Place
from compasslib.inference.finding import SURE
from compasslib.inference.linear_model import Entered, LinearModel, linear_option, linearize
from compasslib.inference.noise import SlowNoise, SlowNoiseBasis
from compasslib.statistics.whitening import LowRankNoise
from compasslib.types import Floats

MOST_ROUNDS = 4  # exchanges of terms; limits the run time
LEAST_LOUD_VARIANCE = 0.05  # relative excess of variance over white noise below which a direction is ignored
READING = ("compass", "reading")
CURRENT_ODDS = 3.0  # of the current: in real records directions differ by its speed (docs/background/method.md)
MOST_LOG = 700.0  # logarithm of a ratio that can still be represented


@dataclass(frozen=True)
class Settled:
    """A fitted model, linearized, with the options in the place of each of its terms."""

    fitted: FittedModel  # with slow noise in the whitener
    model: LinearModel  # linearized at this model
    entered: Entered  # option and amplitude of each term
    places: tuple[Place, ...]  # of each term

    @property
    def kinds(self) -> tuple[type[Effect], ...]:
        """Classes of the terms."""
        return tuple(type(self.model.options[k].term) for k, _ in self.entered)

    def held(self) -> float:
        """Compute the smallest probability that a term has in its place, all dates together."""
        each = zip(self.kinds, self.places, strict=True)
        return min((float(place.probability[place.alike(kind)].sum()) for kind, place in each), default=1.0)

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
    slow: SlowNoiseBasis,
    slow_noises: Sequence[SlowNoise],
    amplitudes: Sequence[float],
    odds: float,
) -> Settled:
    """Linearize a model, and replace or remove terms that are not the likeliest ones in their places."""
    before = dict[frozenset[type[Effect]], Settled]()
    for rounds in range(1, MOST_ROUNDS + 1):
        model = linearize(fitted, slow)
        numbers = {option.term: k for k, option in enumerate(model.options)}
        entered = [
            (numbers[term.at(0.0 * term.values)], size)
            for term, size in zip(fitted.simulation.terms, amplitudes, strict=True)
        ]
        others = [[*entered[:k], *entered[k + 1 :]] for k in range(len(entered))]
        places = [Place.weigh(model.weigh(slow_noises, each), odds) for each in others]
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
        slow_noise = model.likeliest_noise(slow_noises, better)
        fitted, amplitudes = fit_terms(fitted, model, better, slow_noise), [size for _, size in better]
    return settled


def _better(model: LinearModel, entered: Entered, places: Sequence[Place]) -> list[tuple[int, float]]:
    """Replace the first term that is not the likeliest in its place, or remove it if none is likelier."""
    for number, ((chosen, _), place) in enumerate(zip(entered, places, strict=True)):
        others = [*entered[:number], *entered[number + 1 :]]
        taken = {type(model.options[k].term) for k, _ in others}
        k = place.likeliest(taken)
        if place.none > UNLIKELY:
            return list(others)
        if type(model.options[k].term) is not type(model.options[chosen].term):
            return sorted([*others, (k, model.likeliest_amplitude(k, place.evidence.likeliest_noise(k), others))])
    return list(entered)


def fit_terms(fitted: FittedModel, model: LinearModel, entered: Entered, slow_noise: SlowNoise) -> FittedModel:
    """Fit options in the forward model, with slow noise of given parameters in the whitener."""
    terms = [
        model.options[k].term.at(values) for (k, _), values in zip(entered, model.fit(entered, slow_noise), strict=True)
    ]
    usual = {type(model.options[k].term): size * model.options[k].usual for k, size in entered}
    fitted = replace(fitted, comparison=replace(fitted.comparison, usual={**fitted.comparison.usual, **usual}))
    learnt = learn_current(model, entered, slow_noise)
    return design.refit(with_slow_noise(fitted, model.freed, learnt, slow_noise), terms)


def learn_current(model: LinearModel, entered: Entered, slow_noise: SlowNoise) -> SlowNoiseBasis:
    """Set the variances of the current in the slow noise to their estimate beside some options."""
    variances = model.current(entered, slow_noise).variances
    return replace(model.slow, current=np.where(model.slow.current == 0.0, 0.0, variances))


def with_slow_noise(
    fitted: FittedModel, freed: FittedModel, slow: SlowNoiseBasis, slow_noise: SlowNoise
) -> FittedModel:
    """Add slow noise to a fitted model, as directions of increased variance of the whitened noise of a freed one."""
    variance, low_rank = slow.variances(slow_noise), None
    variance[0] = 0.0  # a constant veer looks like A, which would be lost in rounding errors beside it
    present = variance > 0.0
    if present.any():
        scale = np.sqrt(variance[present]) * freed.response / freed.sigma
        white = freed.whitener(slow.columns[:, present].astype(np.float32)).astype(float) * scale
        values, vectors = np.linalg.eigh(white.T @ white)
        loud = values > LEAST_LOUD_VARIANCE
        basis = white @ vectors[:, loud] / np.sqrt(values[loud])
        low_rank = LowRankNoise(basis.astype(np.float32), 1.0 / np.sqrt(1.0 + values[loud]))
    return design.evaluate_model(replace(fitted.comparison, low_rank=low_rank), fitted.simulation, fitted.nuisance)


def with_likeliest_noise(fitted: FittedModel, slow: SlowNoiseBasis, slow_noises: Sequence[SlowNoise]) -> FittedModel:
    """Add the likeliest slow noise without effects to the noise model of a fitted model."""
    white = fitted.whiten_and_project(slow.columns.astype(np.float32)) * np.float32(fitted.response / fitted.sigma)
    model = LinearModel(fitted, (), slow, white, 1.0)
    return with_slow_noise(fitted, fitted, slow, model.likeliest_noise(slow_noises))


@dataclass(frozen=True)
class Rival:
    """A reading that may follow drivers of the current."""

    probability: float  # that it is the compass, not the current
    option: int  # its likeliest form


def find_rivals(
    model: LinearModel,
    entered: Entered,
    slow_noise: SlowNoise,
    slow_noises: Sequence[SlowNoise],
) -> dict[frozenset[str], Rival]:
    """Find a rival for each group of drivers that vary together and that the current is likely to follow."""
    current, rivals = model.current(entered, slow_noise), dict[frozenset[str], Rival]()
    present = np.mean(current.values != 0.0, axis=0) >= SURE
    acting = [driver for driver, there in zip(current.drivers, present, strict=True) if there]
    taken = {model.options[k].block for k, _ in entered}
    for group in dict.fromkeys(map(noise.coupled_drivers, acting)):
        readings = [
            k
            for k, option in enumerate(model.options)
            if option.block[:2] == READING and option.term.driver in group and option.block not in taken
        ]
        if readings:
            rivals[group] = _compare(model, entered, slow_noises, group, readings)
    return rivals


def _compare(
    model: LinearModel,
    entered: Entered,
    slow_noises: Sequence[SlowNoise],
    group: frozenset[str],
    readings: Sequence[int],
) -> Rival:
    """Compare the compass with the current, which follows the drivers in the same forms or as in the noise."""
    without = replace(model, slow=model.slow.without_current(group))
    alike = _as_current(without, entered, readings)
    shares = np.array([model.options[k].share for k in readings])
    shares -= np.logaddexp.reduce(shares)
    place = [(number, size) for number, (_, size) in enumerate(entered)]
    of_compass = _log_evidence(without.weigh(slow_noises, entered), readings) + shares
    in_same_form = _log_evidence(alike.weigh(slow_noises, place), range(len(entered), len(alike.options))) + shares
    weighed = model.weigh(slow_noises, entered)
    as_noise = np.logaddexp.reduce(weighed.log_prior[:, 0] + weighed.none[:, 0])
    of_current = np.log(CURRENT_ODDS) + np.logaddexp(np.logaddexp.reduce(in_same_form), as_noise)
    ratio = float(np.clip(of_current - np.logaddexp.reduce(of_compass), -MOST_LOG, MOST_LOG))
    return Rival(1.0 / (1.0 + float(np.exp(ratio))), readings[int(np.argmax(of_compass))])


def _log_evidence(evidence: Evidence, options: Sequence[int]) -> Floats:
    """Compute the log evidence of some options, slow noise marginalized, (k,)."""
    none = evidence.log_prior[:, 0] + evidence.none[:, 0]
    return np.asarray(np.logaddexp.reduce(none[:, None] + evidence.factors[:, list(options), 0], axis=0))


def _as_current(model: LinearModel, entered: Entered, readings: Sequence[int]) -> LinearModel:
    """Build the model whose options are the entered ones, and turns of the current in the forms of some readings."""
    turned = []
    for k in readings:
        term = model.options[k].term
        assert isinstance(term, ComposedEffect)
        turned.append(linear_option(model.freed, as_current(term)))
    options = (*(model.options[k] for k, _ in entered), *turned)
    columns = np.concatenate([option.columns for option in options], axis=1)
    unit = np.float32(model.freed.response / model.freed.sigma / np.sqrt(model.scatter))
    white = [model.freed.whiten_and_project(columns) * unit, model.white[:, model.products.ends[-1] :]]
    return replace(model, options=options, white=np.concatenate(white, axis=1))
