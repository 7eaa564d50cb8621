"""The search: effects enter the model one after the other, and the noise is fitted again under each.

An effect is detected if its evidence ranks among the highest of surrogates, records simulated without it. Which effect
it is, is a matter of probability: every option is weighed in the place of each effect that entered, beside the others.
The detection limit of an effect is the size at which it is detected in nine of ten simulations of the recording.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compasslib.effects import SLOW_WATER, Effect
from compasslib.effects.composed import COMPOSED, ComposedEffect
from compasslib.inference import design, noise
from compasslib.inference.design import FittedModel
from compasslib.inference.evidence import (
    MOST_EFFECTS,
    UNLIKELY,
    Evidence,
    Place,
    log_bayes_factors,
    log_sum,
    side_probabilities,
)
from compasslib.inference.finding import Detection, compare_names
from compasslib.inference.linear_model import Entered, LinearModel, Marginal, Products
from compasslib.inference.noise import SlowNoise, SlowNoiseBasis
from compasslib.inference.places import (
    Rival,
    Settled,
    find_rivals,
    fit_terms,
    learn_current,
    settle,
    with_likeliest_noise,
)
from compasslib.statistics.least_squares import mixed_covariance
from compasslib.statistics.whitening import scaled_inverse
from compasslib.types import Floats

LEAST_WEIGHT = 0.05  # probability below which a combination of effects does not enter the correction
SUGGESTED_P = 0.1  # rank up to which an effect that is not detected enters it, by its probability
LIKELY = -float(np.log(UNLIKELY / (1.0 - UNLIKELY)))  # log Bayes factor from which an effect enters with even odds
STEADY = 1e-8  # ridge relative to a column's information, which stabilizes the inverse
POWER = 0.9  # share of simulations in which an effect at its limit is detected
SIZES_DEG = np.geomspace(0.25, 32.0, 22)  # visible sizes that are simulated, rms
MOST_PLACES = 8  # dates of one effect that are simulated


@dataclass(frozen=True)
class Inference(Settled):
    """The effects that were detected, with the probability of every option in the place of each, and of one more."""

    further: Place  # of one more effect, which was not detected
    detections: tuple[Detection, ...]  # of each term, and of one more
    odds: float  # prior odds of a fault of compass or clock
    seed: int  # of the surrogates

    @property
    def chosen(self) -> tuple[int, ...]:
        """Option of each term, in order."""
        return tuple(k for k, _ in self.entered)

    @cached_property
    def slow(self) -> SlowNoiseBasis:
        """Slow noise, with the estimated variances of the current."""
        return learn_current(self.model, self.entered, self.slow_noise)

    @cached_property
    def slow_noise(self) -> SlowNoise:
        """The likeliest slow noise beside the chosen effects."""
        likeliest: SlowNoise = self.further.evidence.likeliest_noise()
        return likeliest

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability of each side, the first in order if several act, and of none; some names dropped."""
        result = side_probabilities(self._all_places, dropped)
        before = result["none"]
        rivals = 1.0 - float(np.prod([1.0 - rival.probability for rival in self.rivals.values()]))
        # What is not detected is not more probable than beforehand.
        instead = min(before * rivals, max(self.odds / (1.0 + self.odds) - (1.0 - before), 0.0))
        return result | {"none": before - instead, "compass": result["compass"] + instead}

    @cached_property
    def rivals(self) -> dict[frozenset[str], Rival]:
        """Readings that may follow the drivers of the current in its place, by groups of drivers that vary together."""
        return find_rivals(self.model, self.entered, self.slow_noise, self.further.evidence.likely_noises)

    @cached_property
    def limits(self) -> dict[str, float | None]:
        """Detection limit of each listed effect that was not found, visible rms degrees; None if there is none."""
        last = self.detections[-1]
        if last.threshold is None:
            return {}
        drawings = self.model.draw(self.further.evidence, last.n_surrogates, self.seed + len(self.chosen), self.entered)
        least = max(last.threshold, LIKELY - float(np.log(self.odds)))  # from which an effect is found
        return _detection_limits(self.model, self.further.evidence, self.entered, drawings, least)

    @property
    def _all_places(self) -> tuple[Place, ...]:
        return (*self.places, self.further)

    @cached_property
    def chances(self) -> tuple[dict[str, float], ...]:
        """Probability of each term's effect, which comes first, and of its alternatives, slow water among them."""
        each = zip(self.chosen, self.places, strict=True)
        return tuple(
            compare_names(self.model.options[k].name, place.names | {SLOW_WATER: place.none}) for k, place in each
        )

    def display_name(self, effect: str, place: Place) -> str:
        """Name an effect as in a diagnosis: a composed one as composed:ACTS_ON/DRIVER/FORM, by its larger component."""
        if not effect.startswith(COMPOSED):
            return effect
        alike = [k for k, option in enumerate(self.model.options) if option.name == effect]
        k = max(alike, key=lambda k: float(place.probability[k]))
        slow_noise = place.evidence.likeliest_noise(k)
        (values,) = self.model.fit([(k, self.model.likeliest_amplitude(k, slow_noise))], slow_noise)
        term = self.model.options[k].term.at(values)
        assert isinstance(term, ComposedEffect)
        return COMPOSED + "/".join(term.reported_composition())

    def covariance(self, fitted: FittedModel) -> Floats:
        """Compute the covariance of A..E, terms and nuisances of a fitted model, averaged over slow noise, (b, b)."""
        without_slow = design.evaluate_model(
            replace(fitted.comparison, low_rank=None), fitted.simulation, fitted.nuisance
        )
        columns = np.concatenate([without_slow.base, self.slow.columns], axis=1)
        n = without_slow.base.shape[1]
        scale = np.linalg.norm(without_slow.base, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        unit = 1.0 / without_slow.sigma / np.sqrt(self.model.scatter)
        white = without_slow.whitener(columns) * without_slow.response * unit
        white[:, :n] /= scale
        information, score = white.T @ white, white.T @ without_slow.innovation[:, None] * unit
        products = Products(information, score, np.arange(n + 1), np.ones((1, n)))
        known = STEADY * np.diag(information)[:n]
        ridge = np.diag(without_slow.base_ridge * (without_slow.response / without_slow.sigma / scale) ** 2 + known)
        ridge += without_slow.external_information()[0] / np.outer(scale, scale)
        weights, steps, covariances = [], [], []
        for weight, slow_noise in self.further.evidence.weighted_noises():
            left, score_left = products.marginalize(self.slow.variances(slow_noise)).left(np.arange(n))
            weights.append(weight)
            covariances.append(scaled_inverse(left + ridge))
            steps.append(covariances[-1] @ score_left[:, 0])
        return mixed_covariance(weights, steps, covariances) / np.outer(scale, scale)

    @cached_property
    def combinations(self) -> list[tuple[float, tuple[int, ...]]]:
        """Combinations of options that may act, with their probabilities; dates and places of one form are one.

        In each place, the alternatives are combined with the chosen effects of all other places.
        """
        chosen = (*self.chosen, None)
        each = [self._alternatives(place, k) for place, k in zip(self._all_places, chosen, strict=True)]
        taken = [options[k] for options, k in zip(each, chosen, strict=True)]
        # Where a further effect is likely but not in the model, the chosen effects still are the first approximation.
        taken[-1] = max(taken[-1], 0.5)
        main = float(np.prod(taken))
        result = [(main, self.chosen)]
        for place, options in enumerate(each):
            others = [*self.chosen[:place], *self.chosen[place + 1 :]]
            for k, probability in options.items():
                if k != chosen[place] and k not in others:
                    combination = tuple(sorted([*others, *([] if k is None else [k])]))
                    result.append((main * probability / max(taken[place], 1e-12), combination))
        for rival in self.rivals.values():
            result.append((result[0][0] * rival.probability, tuple(sorted([*self.chosen, rival.option]))))
            result[0] = result[0][0] * (1.0 - rival.probability), self.chosen
        sums: dict[tuple[int, ...], float] = {}
        for probability, combination in result:
            sums[combination] = sums.get(combination, 0.0) + probability
        merged = [(probability, combination) for combination, probability in sums.items()]
        return sorted(merged, key=lambda item: (item[1] != self.chosen, -item[0]))

    def _alternatives(self, place: Place, chosen: int | None) -> dict[int | None, float]:
        """Sum the probability of each form at its likeliest date, the chosen option representing its own form."""
        sums: dict[int | None, float] = {chosen: 0.0, None: place.none}
        options = self.model.options
        best: dict[type[Effect], int] = {} if chosen is None else {type(options[chosen].term): chosen}
        for k in np.argsort(-place.probability).tolist():
            first = best.setdefault(type(options[k].term), k)
            sums[first] = sums.get(first, 0.0) + float(place.probability[k])
        return sums

    @cached_property
    def weighted(self) -> list[tuple[float, FittedModel]]:
        """Fitted models that correct the record, with their probabilities, which sum to at most 1; the chosen first."""
        suggested = self.detections[-1].rank_p is not None and self.detections[-1].rank_p <= SUGGESTED_P
        rivals = {rival.option for rival in self.rivals.values()}
        likely = {
            each: p
            for p, each in self.combinations
            if each == self.chosen
            or (p >= LEAST_WEIGHT and (suggested or len(each) <= len(self.chosen) or rivals & {*each}))
        }
        for p, each in self.combinations:  # the chosen effects also represent them with an unlikely further one
            if each not in likely and set(self.chosen) < set(each):
                likely[self.chosen] += p
        return [(p, self.fitted if each == self.chosen else self._refitted(each)) for each, p in likely.items()]

    def _refitted(self, combination: tuple[int, ...]) -> FittedModel:
        entered = {k: self.model.likeliest_amplitude(k, self.slow_noise) for k in combination} | dict(self.entered)
        instead = [group for group, rival in self.rivals.items() if rival.option in combination]
        model = replace(self.model, slow=self.model.slow.without_current(frozenset[str]().union(*instead)))
        return fit_terms(self.fitted, model, [(k, entered[k]) for k in combination], self.slow_noise)


def infer(initial: FittedModel, odds: float, surrogates: int) -> Inference:
    """Detect the effects that act in addition to a fitted compass without terms, and weigh all options in their places.

    Args:
        odds: prior odds of a fault of compass or clock.
        surrogates: number of records simulated without a further effect, of each kind; without any, none is detected.
    """
    slow = noise.slow_noise_basis(initial.comparison)
    slow_noises = slow.slow_noises()
    seed = zlib.crc32(np.ascontiguousarray(initial.comparison.recorded_deg).tobytes())
    fitted, amplitudes, detections = with_likeliest_noise(initial, slow, slow_noises), list[float](), list[Detection]()
    visited = set[frozenset[type[Effect]]]()
    while True:
        settled = settle(fitted, slow, slow_noises, amplitudes, odds)
        model, entered, kinds = settled.model, list(settled.entered), frozenset(settled.kinds)
        evidence = model.weigh(slow_noises, entered)
        slow_noises = evidence.possible_noises
        detections = [*detections[: len(entered)], detect(model, evidence, entered, surrogates, seed + len(entered))]
        further = Place.weigh(evidence, odds, [k for k, _ in entered])
        removed = kinds in visited  # the effect that entered did not hold once it was fitted
        if removed or not detections[-1].significant:
            further = further.not_favoured(odds)
        if removed or len(entered) == MOST_EFFECTS or not stands_out(detections[-1], further):
            break
        visited.add(kinds)
        k = further.likeliest(kinds)
        slow_noise = evidence.likeliest_noise(k)
        entered = sorted([*entered, (k, model.likeliest_amplitude(k, slow_noise, entered))])
        fitted, amplitudes = fit_terms(settled.fitted, model, entered, slow_noise), [size for _, size in entered]
    return Inference(settled.fitted, model, entered, settled.places, further, tuple(detections), odds, seed)


def stands_out(detection: Detection, place: Place) -> bool:
    """Return whether a further effect is detected, and likelier than none."""
    return detection.significant and place.none <= UNLIKELY


def detect(model: LinearModel, evidence: Evidence, entered: Entered, surrogates: int, seed: int) -> Detection:
    """Rank the evidence of a further effect among surrogates without it.

    Two kinds are drawn: simulated noise, and, for records whose noise the model does not describe, the record's own
    residual without any likely effect, with random signs of its blocks.
    """
    statistics: Sequence[Floats] = []
    if surrogates:
        kinds = (None, _residual(model, evidence, entered))
        scores = [model.scores(model.draw(evidence, surrogates, seed, entered, residual)) for residual in kinds]
        each = model.weigh(evidence.likely_noises, entered, np.concatenate(scores, axis=1)).statistic
        statistics = np.split(each, len(kinds))
    return Detection.by_rank(float(evidence.statistic[0]), statistics)


def _residual(model: LinearModel, evidence: Evidence, entered: Entered) -> Floats:
    """Compute the residual without the entered options and all further ones that are likely, at least one."""
    slow_noises, effects = evidence.likely_noises, list(entered)
    while len(effects) == len(entered) or (len(effects) < MOST_EFFECTS and evidence.statistic[0] > LIKELY):
        k = int(np.argmax(evidence.log_bayes_factors[:, 0]))
        slow_noise = evidence.likeliest_noise(k)
        effects.append((k, model.likeliest_amplitude(k, slow_noise, effects)))
        evidence = model.weigh(slow_noises, effects)
    return model.without(effects, evidence.likeliest_noise())


def _detection_limits(
    model: LinearModel, evidence: Evidence, entered: Entered, residuals: Floats, threshold: float
) -> dict[str, float | None]:
    """Find the visible size of each listed effect, rms degrees, that is detected with ``POWER``; None without."""
    score, rng = model.scores(residuals), np.random.default_rng(0)
    taken = {model.options[k].name for k, _ in entered}
    listed: dict[str, list[int]] = {}
    for k, option in enumerate(model.options):
        if not option.name.startswith(COMPOSED) and option.name not in taken:
            listed.setdefault(option.name, []).append(k)
    products = replace(model.products, score=score)
    marginals = [
        (slow_noise.log_prior, products.marginalize(model.slow.variances(slow_noise), entered))
        for slow_noise in evidence.likely_noises
    ]
    result: dict[str, float | None] = {}
    for name, options in listed.items():
        places = [options[i] for i in np.linspace(0, len(options) - 1, min(MOST_PLACES, len(options))).astype(int)]
        parts = np.array_split(np.arange(score.shape[1]), len(places))
        power = np.zeros(len(SIZES_DEG))
        for k, part in zip(places, parts, strict=True):
            power += np.sum(_statistics(model, marginals, k, part, rng) >= threshold, axis=1) / score.shape[1]
        k = int(np.argmax(power >= POWER))
        result[name] = float(SIZES_DEG[k]) if power[k] >= POWER else None
        if k > 0:  # interpolate
            share = (POWER - power[k - 1]) / (power[k] - power[k - 1])
            result[name] = float(SIZES_DEG[k - 1] * (SIZES_DEG[k] / SIZES_DEG[k - 1]) ** share)
    return result


def _statistics(
    model: LinearModel,
    marginals: Sequence[tuple[float, Marginal]],
    k: int,
    part: NDArray[np.intp],
    rng: np.random.Generator,
) -> Floats:
    """Compute the statistic of an option in r surrogates with its effect, in random directions, at s sizes, (s, r)."""
    at = model.products.columns(k)
    visible = model.freed.visible(model.options[k].columns)
    direction = rng.normal(size=(len(at), len(part)))
    direction /= np.sqrt(np.mean((visible @ direction) ** 2, axis=0))
    planted = []
    for prior, marginal in marginals:
        cross, taken = marginal.cross[:, at], marginal.taken[:, part]
        information = model.products.information[np.ix_(at, at)] - cross.T @ cross
        left = marginal.products.score[np.ix_(at, part)] - cross.T @ taken
        values, vectors = np.linalg.eigh(information)
        half = cross @ direction
        none = np.array([marginal.none[part], np.sum(half * taken, axis=0), 0.5 * np.sum(half**2, axis=0)])
        along = np.array([vectors.T @ left, vectors.T @ information @ direction])
        planted.append(_Planted(prior, none, along, np.maximum(values, 0.0), model.products.amplitudes[:, k]))
    each = [slow_noise.log_likelihoods(SIZES_DEG) for slow_noise in planted]
    none, effect = (log_sum(np.array(logs)) for logs in zip(*each, strict=True))
    return np.asarray(effect - none + model.options[k].share)


@dataclass(frozen=True)
class _Planted:
    """Surrogates with an effect of unit visible size, under one kind of slow noise; r surrogates."""

    prior: float  # log prior of the slow noise
    none: Floats  # (3, r) log likelihood of no effect: constant, linear and quadratic in the size
    score: Floats  # (2, k, r) score along each eigenvector of the information: constant and linear in the size
    values: Floats  # (k,) eigenvalues
    amplitudes: Floats  # (a,) prior rms of the effect, degrees

    def log_likelihoods(self, sizes_deg: Floats) -> tuple[Floats, Floats]:
        """Compute the log likelihood of no effect, and that of the effect that was planted, (s, r) each."""
        size = sizes_deg[:, None]
        none = self.prior + self.none[0] + size * self.none[1] + size**2 * self.none[2]
        along = (self.score[0] + size[:, None] * self.score[1]) ** 2
        effect = log_bayes_factors(self.values[None], along[:, None], self.amplitudes[:, None, None, None])
        return none, none + log_sum(effect[..., 0, :]) - np.log(len(self.amplitudes))
