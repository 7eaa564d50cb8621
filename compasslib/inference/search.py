"""The search: effects enter the model one after the other, and the noise is fitted again under each.

An effect is detected if its evidence ranks among the highest of surrogates, records simulated without it. Which effect
it is, is a matter of probability: every option is weighed in the place of each effect that entered, beside the others.
"""

from __future__ import annotations

import zlib
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from compasslib.effects import SLOW_WATER, Effect
from compasslib.effects.composed import COMPOSED, ComposedEffect
from compasslib.effects.effect import HOUR_S
from compasslib.inference import design, noise
from compasslib.inference.design import Estimate, FittedModel
from compasslib.inference.finding import Detection, FindingPosterior, compare_names
from compasslib.inference.limits import detection_limits
from compasslib.inference.linear_model import LEAST_PROBABILITY, Entered, Evidence, LinearModel
from compasslib.inference.noise import SlowNoise, SlowNoiseBasis
from compasslib.inference.places import (
    UNLIKELY,
    Place,
    fit_terms,
    learn_current,
    likeliest_option,
    marginalize,
    name_probabilities,
    probabilities,
    settle,
    side_probabilities,
    with_likeliest_noise,
)
from compasslib.inference.rivals import Rival, find_rivals
from compasslib.statistics.whitening import correlation_time, sampling_interval_s, scaled_inverse
from compasslib.types import Floats

MOST_EFFECTS = 3  # in a record; limits the run time
LEAST_WEIGHT = 0.05  # probability below which a combination of effects does not enter the correction
SUGGESTED_P = 0.1  # rank up to which an effect that is not detected enters it, by its probability
LIKELY = -float(np.log(UNLIKELY / (1.0 - UNLIKELY)))  # log Bayes factor from which an effect enters with even odds
STEADY = 1e-8  # ridge relative to a column's information, which stabilizes the inverse


@dataclass(frozen=True)
class Inference:
    """The effects that were detected, refitted, with the probability of every option in the place of each."""

    fitted: FittedModel  # fitted with its terms, slow noise in the whitener
    model: LinearModel  # linearized at this model
    chosen: tuple[int, ...]  # option of each term, in order
    amplitudes: tuple[float, ...]  # prior rms of each, degrees
    places: tuple[Place, ...]  # of each term
    further: Place  # of one more effect, which was not detected
    detections: tuple[Detection, ...]  # of each term, and of one more
    odds: float  # prior odds of a fault of compass or clock
    seed: int  # of the surrogates

    @property
    def entered(self) -> Entered:
        """The chosen options with their amplitudes."""
        return tuple(zip(self.chosen, self.amplitudes, strict=True))

    @cached_property
    def slow(self) -> SlowNoiseBasis | None:
        """Slow noise, with the estimated variances of the current."""
        return learn_current(self.model, self.entered, self.slow_noise)

    @cached_property
    def slow_noise(self) -> SlowNoise | None:
        """The likeliest slow noise beside the chosen effects."""
        return self.further.evidence.likeliest_noise()

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability of each side; if several act, it counts for the first in SIDES_IN_ORDER.

        Args:
            dropped: names of effects to ignore.
        """
        everywhere = [self.model.options] * len(self._all_places)
        result = side_probabilities(everywhere, self._all_places, dropped)
        before = result["none"]
        rivals = 1.0 - float(np.prod([1.0 - rival.probability for rival in self.rivals.values()]))
        # What is not detected is not more probable than beforehand.
        instead = min(before * rivals, max(self.odds / (1.0 + self.odds) - (1.0 - before), 0.0))
        return result | {"none": before - instead, "compass": result["compass"] + instead}

    @cached_property
    def rivals(self) -> dict[frozenset[str], Rival]:
        """Readings that may follow the drivers of the current in its place, by groups of drivers that vary together."""
        return find_rivals(self.model, self.entered, self.slow_noise, self.further.evidence.likely_noises)

    @property
    def lacks_effect(self) -> bool:
        """Whether a further effect is detected beside as many as are searched for."""
        return len(self.chosen) == MOST_EFFECTS and _stands_out(self.detections[-1], self.further)

    @cached_property
    def limits(self) -> dict[str, float | None]:
        """Detection limit of each listed effect that was not found, visible rms degrees; None if there is none."""
        last = self.detections[-1]
        if last.threshold is None:
            return {}
        drawings = self.model.draw(self.further.evidence, last.n_surrogates, self.seed + len(self.chosen), self.entered)
        least = max(last.threshold, LIKELY - float(np.log(self.odds)))  # from which an effect is found
        return detection_limits(self.model, self.further.evidence, self.entered, drawings, least)

    @cached_property
    def current_visible(self) -> Floats:
        """Mean products of the columns of the current with the compass projected out, square degrees."""
        slow = self.model.slow
        count = 0 if slow is None else len(slow.drivers)
        columns = (
            np.zeros((len(self.fitted.comparison), 0))
            if slow is None
            else slow.columns[:, slow.columns.shape[1] - count :]
        )
        turned = self.model.freed.visible(columns)
        return turned.T @ turned / len(turned)

    def further_size_deg(self, k: int) -> float:
        """Compute the visible size of an option beside the chosen effects, rms degrees."""
        entered = (*self.entered, (k, self.model.likeliest_amplitude(k, self.slow_noise, self.entered)))
        values = self.model.fit(entered, self.slow_noise)[-1]
        usual = self.model.options[k].usual
        turn = self.model.options[k].columns @ (values / np.where(usual > 0.0, usual, 1.0))
        return float(np.sqrt(np.mean(self.model.freed.visible(turn[:, None]) ** 2)))

    @property
    def _all_places(self) -> tuple[Place, ...]:
        return (*self.places, self.further)

    @cached_property
    def finding_posteriors(self) -> tuple[FindingPosterior, ...]:
        """Probability of each term's effect and of its alternatives, slow water among them."""
        result = []
        for k, place in zip(self.chosen, self.places, strict=True):
            names = name_probabilities(self.model.options, place) | {SLOW_WATER: place.none}
            result.append(compare_names(self.model.options[k].name, names))
        return tuple(result)

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

    def estimate(self, fitted: FittedModel) -> Estimate:
        """Compute the covariance of all parameters of a refitted model, averaged over slow noise.

        Args:
            state: model of this recording, with any terms.
        """
        without_slow = design.evaluate_model(
            replace(fitted.comparison, low_rank=None), fitted.simulation, fitted.nuisance
        )
        columns = (
            without_slow.base if self.slow is None else np.concatenate([without_slow.base, self.slow.columns], axis=1)
        )
        scale = np.linalg.norm(without_slow.base, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        unit = 1.0 / without_slow.sigma / np.sqrt(self.model.scatter)
        white = without_slow.whitener(columns) * without_slow.response * unit
        white[:, : len(scale)] /= scale
        information, score = white.T @ white, white.T @ without_slow.innovation * unit
        known = STEADY * np.diag(information)[: len(scale)]
        ridge = np.diag(without_slow.base_ridge * (without_slow.response / without_slow.sigma / scale) ** 2 + known)
        ridge += without_slow.external_information()[0] / np.outer(scale, scale)
        evidence = self.further.evidence
        weight = evidence.noise_probability()
        likely = np.flatnonzero(weight > LEAST_PROBABILITY * weight.max())
        weight = weight[likely] / weight[likely].sum()
        steps, covariances = [], []
        for w in likely:
            slow_noise = evidence.slow_noises[w]
            variance = np.zeros(0) if self.slow is None or slow_noise is None else self.slow.variances(slow_noise)
            left, score_left, _ = marginalize(information, score, len(scale), variance)
            covariances.append(scaled_inverse(left + ridge))
            steps.append(covariances[-1] @ score_left)
        step = np.array(steps) - weight @ np.array(steps)
        covariance = np.einsum("w,wij->ij", weight, np.array(covariances)) + (weight[:, None] * step).T @ step
        return Estimate(fitted, covariance / np.outer(scale, scale))

    @cached_property
    def combinations(self) -> list[tuple[float, tuple[int, ...]]]:
        """Combinations of options that may act, with their probabilities; dates and places of one form are one.

        In each place, the alternatives are combined with the chosen effects of all other places.
        """
        each = [self._alternatives(place, k) for place, k in zip(self._all_places, (*self.chosen, None), strict=True)]
        taken = [options[k] for options, k in zip(each, (*self.chosen, None), strict=True)]
        # Where a further effect is likely but not in the model, the chosen effects still are the first approximation.
        taken[-1] = max(taken[-1], 0.5)
        main = float(np.prod(taken))
        result = [(main, self.chosen)]
        for place, options in enumerate(each):
            for k, probability in options.items():
                others = [*self.chosen[:place], *self.chosen[place + 1 :]]
                if k != (*self.chosen, None)[place] and k not in others:
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
        sums: dict[int | None, float] = {None: place.none}
        options = self.model.options
        best: dict[type[Effect], int] = {} if chosen is None else {type(options[chosen].term): chosen}
        for k in np.argsort(-place.probability).tolist():
            first = best.setdefault(type(options[k].term), k)
            sums[first] = sums.get(first, 0.0) + float(place.probability[k])
        return {chosen: 0.0} | sums

    @cached_property
    def weighted(self) -> list[tuple[float, FittedModel]]:
        """Fitted models that correct the record, with their probabilities, which sum to at most 1; the chosen first."""
        suggested = self.detections[-1].rank_p is not None and self.detections[-1].rank_p <= SUGGESTED_P
        likely = {
            each: p
            for p, each in self.combinations
            if each == self.chosen
            or (p >= LEAST_WEIGHT and (suggested or len(each) <= len(self.chosen) or self._is_rival(each)))
        }
        for (
            p,
            each,
        ) in self.combinations:  # the chosen effects and an unlikely further one: the chosen ones represent it
            if each not in likely and set(self.chosen) < set(each):
                likely[self.chosen] += p
        return [(p, self.fitted if each == self.chosen else self._refitted(each)) for each, p in likely.items()]

    def _is_rival(self, combination: tuple[int, ...]) -> bool:
        return any(rival.option in combination for rival in self.rivals.values())

    def _refitted(self, combination: tuple[int, ...]) -> FittedModel:
        known = dict(self.entered)
        amplitudes = [
            known[k] if k in known else self.model.likeliest_amplitude(k, self.slow_noise) for k in combination
        ]
        model, slow = self.model, self.model.slow
        instead = [group for group, rival in self.rivals.items() if rival.option in combination]
        if instead and slow is not None:
            model = replace(model, slow=slow.without_current(frozenset[str]().union(*instead)))
        return fit_terms(self.fitted, model, list(zip(combination, amplitudes, strict=True)), self.slow_noise)


def infer(initial: FittedModel, odds: float, surrogates: int) -> Inference:
    """Detect the effects that act in addition to the fitted compass, and weigh all options in their places.

    Args:
        initial: the fitted simulation without terms.
        odds: prior odds of a fault of compass or clock.
        surrogates: number of records simulated without a further effect, of each kind; without any, none is detected.
    """
    slow = noise.slow_noise_basis(initial.comparison)
    slow_noises: Sequence[SlowNoise | None] = [None] if slow is None else slow.slow_noises()
    seed = zlib.crc32(np.ascontiguousarray(initial.comparison.recorded_deg).tobytes())
    fitted, amplitudes, detections = with_likeliest_noise(initial, slow, slow_noises), list[float](), list[Detection]()
    visited = set[frozenset[type[Effect]]]()
    while True:
        settled = settle(fitted, slow, slow_noises, amplitudes, odds)
        model, entered = settled.model, list(settled.entered)
        evidence, kinds = model.weigh(slow_noises, entered), frozenset(type(model.options[k].term) for k, _ in entered)
        detections = [*detections[: len(entered)], detect(model, evidence, entered, surrogates, seed + len(entered))]
        further = Place(probabilities(model.options, evidence, odds, [k for k, _ in entered]), evidence)
        if not detections[-1].significant:
            further = further.not_favoured(odds)
        if len(entered) == MOST_EFFECTS or kinds in visited or not _stands_out(detections[-1], further):
            break
        visited.add(kinds)
        k = likeliest_option(model.options, evidence, kinds)
        slow_noise = evidence.likeliest_noise(k)
        entered = sorted([*entered, (k, model.likeliest_amplitude(k, slow_noise, entered))])
        fitted, amplitudes = fit_terms(settled.fitted, model, entered, slow_noise), [size for _, size in entered]
    chosen = tuple(k for k, _ in entered)
    sizes = tuple(size for _, size in entered)
    return Inference(settled.fitted, model, chosen, sizes, settled.places, further, tuple(detections), odds, seed)


def _stands_out(detection: Detection, place: Place) -> bool:
    """Return whether a further effect is detected, and likelier than none."""
    return detection.significant and place.none <= UNLIKELY


def detect(model: LinearModel, evidence: Evidence, entered: Entered, surrogates: int, seed: int) -> Detection:
    """Rank the evidence of a further effect among surrogates without it.

    Two kinds are drawn: simulated noise, and, for records whose noise the model does not describe, the record's own
    residual without any likely effect, with random signs of its blocks.
    """
    statistics = []
    for residual in (None, _residual(model, evidence, entered)) if surrogates else ():
        score = model.scores(model.draw(evidence, surrogates, seed, entered, residual))
        statistics.append(model.weigh(evidence.likely_noises, entered, score).statistic)
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


SLOW = {"slow_rms_deg": "veer.size", "slow_memory_days": "veer.memory_days", "slow_shear_m_s": "shear.size"}


def summarize_noise(inferred: Inference) -> dict[str, tuple[float, float]]:
    """Estimate the parameters of the noise, each with its standard error."""
    fitted, evidence = inferred.fitted, inferred.further.evidence
    time_s, weight = fitted.comparison.scene.time_s, evidence.noise_probability()
    hours, step = float(np.ptp(time_s)) / HOUR_S, sampling_interval_s(time_s) / HOUR_S
    short = correlation_time(fitted.whitener) * step
    width = fitted.whitener.width_deg
    white = float(np.median(width[np.isfinite(width)]))
    result = {
        "white_deg": (white, white * float(np.sqrt((step + 2.0 * short) / (2.0 * hours)))),
        "short_hours": (short, short * float(np.sqrt(2.0 * (step + short) / hours))),
    }
    for name, path in SLOW.items():
        process, value = path.split(".")
        each = np.array(
            [
                0.0 if slow_noise is None else getattr(getattr(slow_noise, process), value)
                for slow_noise in evidence.slow_noises
            ]
        )
        mean = float(weight @ each)
        result[name] = (mean, float(np.sqrt(weight @ (each - mean) ** 2)))
    return result
