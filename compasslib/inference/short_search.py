"""Search short recordings for effects, with the linear Gaussian model of long ones and another noise.

Effects enter one after the other while the evidence of one more ranks among the highest of surrogates. Each effect is
weighed in its place beside the others; its likeliest form and place are fitted in the forward model, since effects may
exceed the noise a thousandfold.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference import short_fit
from compasslib.inference.blocks import Option
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import LISTED_SHARE
from compasslib.inference.finding import Detection, FindingPosterior, RankedEffect, compare_names
from compasslib.inference.linear_model import Evidence
from compasslib.inference.places import (
    UNLIKELY,
    Place,
    likeliest_option,
    name_probabilities,
    probabilities,
    side_probabilities,
)
from compasslib.inference.search import MOST_EFFECTS
from compasslib.inference.short_fit import FittedHypothesis, ShortComparison
from compasslib.inference.short_options import Law, laws, score_scatter, short_options, weigh
from compasslib.statistics.noise import arma_innovations, arma_series
from compasslib.statistics.resampling import resample_blocks
from compasslib.statistics.whitening import orthonormal_basis
from compasslib.types import Floats

Terms = tuple[Effect, ...]  # at zero size

NEARLY = 0.8  # share of the best log evidence from which composed effects, which are nearly linear, are fitted too


@dataclass(frozen=True)
class ShortPlace:
    """The place of one effect beside others, with the options in it."""

    base: FittedHypothesis
    options: tuple[Option, ...]
    evidence: Evidence
    likeliest: FittedHypothesis  # with the likeliest option
    scatter: float = 1.0  # variance of scores between blocks over that of homogeneous noise
    odds: float = 1.0  # prior odds of a fault of compass or clock
    detection: Detection | None = None  # of an effect in it; None without surrogates

    @property
    def logs(self) -> Floats:
        """Log Bayes factor of each option over none, times its prior share."""
        return np.asarray(self.evidence.log_bayes_factors[:, 0])

    @cached_property
    def place(self) -> Place:
        """The probability of each option; what is not detected is not more probable than beforehand."""
        place = Place(probabilities(self.options, self.evidence, self.odds), self.evidence)
        return place if self.detection is None or self.detection.significant else place.not_favoured(self.odds)

    def law(self) -> Law:
        """Select the likeliest law of the noise beside the likeliest option."""
        return laws(self.base.comparison)[int(np.argmax(self.evidence.noise_probability(int(np.argmax(self.logs)))))]

    def alike(self, form: type[Effect]) -> list[int]:
        """List the options of one form, at its various places."""
        return [k for k, option in enumerate(self.options) if type(option.term) is form]


@dataclass(frozen=True)
class ShortInference:
    """The effects of a short recording, with the probability of every option in the place of each."""

    before: FittedHypothesis  # fit of the base parameters alone
    fitted: FittedHypothesis
    places: tuple[ShortPlace, ...]  # of each term
    further: ShortPlace  # of one more effect
    detection: Detection | None  # of any effect
    alone: tuple[RankedEffect, ...]

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability that each side acts, the first of SIDES_IN_ORDER if several do, and of none."""
        places = (*self.places, self.further)
        return side_probabilities([each.options for each in places], [each.place for each in places], dropped)

    def probabilities(self, k: int) -> FindingPosterior:
        """Compute the probability of each effect in the place of a term, given that one is there."""
        return compare_names(
            self.fitted.terms[k].name, name_probabilities(self.places[k].options, self.places[k].place)
        )


def search_effects(comparison: ShortComparison, options: Options) -> ShortInference:
    """Search for the terms that explain a comparison, each with its alternatives."""
    search = _Search(comparison, options)
    entered = search.run(listed=False)
    if any(isinstance(term, ComposedEffect) for term in entered):  # one wide form may stand for two listed effects
        entered = max(entered, search.run(listed=True), key=search.gain)
    places = [search.weigh_in_place((*entered[:k], *entered[k + 1 :])) for k in range(len(entered))]
    return ShortInference(
        before=search.fit(()),
        fitted=search.fit(entered),
        places=tuple(places),
        further=search.further(entered),
        detection=search.further(()).detection,
        alone=_rank_alone(search.weigh_in_place(())),
    )


def detect(place: ShortPlace, surrogates: int) -> Detection:
    """Rank the evidence of an effect in a place among surrogates without it, as for long records.

    Args:
        surrogates: number of each kind; without any, no effect is detected.
    """
    statistics = []
    if surrogates and place.options:
        kinds = (False,) if place.base.comparison.independent else (False, True)
        residuals = np.concatenate([_draw(place, surrogates, resampled) for resampled in kinds], axis=1)
        each = weigh(place.base, place.options, residuals)(place.scatter).statistic
        statistics = np.split(each, len(kinds))
    return Detection.by_rank(float(place.evidence.statistic[0]), statistics)


def _draw(place: ShortPlace, count: int, resampled: bool) -> Floats:
    """Draw residuals without an effect in a place, (n, count) degrees.

    Args:
        resampled: whether blocks of the residual with the likeliest effect are resampled, in place of noise whose laws
            are drawn by their probability without it.
    """
    noise, known = place.likeliest, laws(place.base.comparison)
    seed = zlib.crc32(place.base.residual_deg.tobytes())
    if resampled:
        white = arma_innovations(noise.evident[:, None], place.law())[:, 0]
        length = int(np.max(np.bincount(short_fit.memory_blocks(noise))))
        return arma_series(resample_blocks(white - white.mean(), length, count, seed).T, place.law())
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(known), count, p=place.evidence.noise_probability())
    innovations = noise.scale_deg * rng.normal(size=(len(noise.evident), count))
    each = [arma_series(x[:, None], known[k])[:, 0] for x, k in zip(innovations.T, chosen, strict=True)]
    return np.stack(each, axis=1)


@dataclass
class _Search:
    """Hypotheses of one comparison that were fitted and weighed, by the terms at zero size."""

    comparison: ShortComparison
    options: Options
    fits: dict[Terms, FittedHypothesis] = field(default_factory=dict)
    weighed: dict[frozenset[Effect], ShortPlace] = field(default_factory=dict)
    prepared: dict[Terms, Callable[[float], Evidence]] = field(default_factory=dict)  # evidence of the last term's fit

    def run(self, *, listed: bool) -> Terms:
        """Enter effects while one more is detected.

        Args:
            listed: whether composed effects are left out.
        """
        entered, visited = Terms(), set[frozenset[Effect]]()
        while True:
            entered = self._settle(entered, listed)
            further = self.further(entered)
            assert further.detection is not None
            full = len(entered) == MOST_EFFECTS or frozenset(entered) in visited
            if full or not further.detection.significant or (term := self._likeliest(further, listed)) is None:
                return entered
            visited.add(frozenset(entered))
            entered = (*entered, term)

    def _settle(self, entered: Terms, listed: bool) -> Terms:
        """Replace or remove terms that are not the likeliest in their places."""
        visited, k = {frozenset(entered)}, 0
        while k < len(entered):
            others = (*entered[:k], *entered[k + 1 :])
            term = self._likeliest(self.weigh_in_place(others), listed)
            changed = others if term is None else (*entered[:k], term, *entered[k + 1 :])
            if frozenset(changed) in visited:
                k += 1
            else:
                visited.add(frozenset(changed))
                entered, k = changed, 0
        return entered

    def _likeliest(self, place: ShortPlace, listed: bool) -> Effect | None:
        """Select the likeliest term of a place; None if none is likely, or its visible size is negligible."""
        kinds = {type(each.term) for each in place.options}
        taken = {kind for kind in kinds if listed and issubclass(kind, ComposedEffect)}
        if place.place.none > UNLIKELY or taken == kinds:
            return None
        term = place.options[likeliest_option(place.options, place.evidence, taken)].term
        fitted = self.fit((*_zeros(place.base), term))
        size = short_fit.visible_size_deg(fitted, len(fitted.terms) - 1)
        return term if size >= LISTED_SHARE * self.options.min_effect_deg else None

    def fit(self, terms: Terms) -> FittedHypothesis:
        """Fit a hypothesis in the forward model, the last term from each of its starting values."""
        if not terms:
            self.fits.setdefault(terms, short_fit.fit_hypothesis(self.comparison, ()))
        elif terms not in self.fits:
            near, last = self.fit(terms[:-1]), terms[-1]
            starts = [np.append(first, last.values[1:]) for first in self.comparison.starts.get(last.name, ())]
            fits = [
                short_fit.fit_hypothesis(self.comparison, (*near.terms, last.at(start)), near=near)
                for start in (last.values, *starts)
            ]
            self.fits[terms] = min(fits, key=lambda fit: fit.square)
        return self.fits[terms]

    def weigh_in_place(self, others: Terms) -> ShortPlace:
        """Weigh every option beside some terms."""
        key = frozenset(others)
        if key not in self.weighed:
            state = self.fit(others)
            options = short_options(state, {term.name for term in others})
            evidence = weigh(state, options, state.evident[:, None])
            place = self._fitted(ShortPlace(state, options, evidence(1.0), state))
            if options and not self.comparison.independent:
                # Weigh them again, with the scatter that is left once the likeliest effect is fitted.
                first = {type(option.term): option.columns for option in reversed(options)}
                scatter = score_scatter(place.likeliest, place.law(), list(first.values()))
                place = self._fitted(replace(place, evidence=evidence(scatter), scatter=scatter))
            self.weighed[key] = replace(place, odds=self.options.prior_odds)
        return self.weighed[key]

    def _fitted(self, linear: ShortPlace) -> ShortPlace:
        """Replace the evidence of listed and of likely forms, at their likeliest places, by that of their fits."""
        options, terms, logs = linear.options, _zeros(linear.base), linear.logs
        corrected = linear.evidence.options.copy()
        for form in dict.fromkeys(type(option.term) for option in options):
            alike = linear.alike(form)
            k = max(alike, key=logs.__getitem__)
            if form not in self.comparison.terms and logs[k] < NEARLY * logs.max():
                continue
            fitted = self.fit(beside := (*terms, options[k].term))
            if beside not in self.prepared:
                own = parameter_slices(fitted.terms, len(fitted.base))[-1]
                columns, others = fitted.columns[:, own], np.delete(fitted.columns, own, axis=1)
                pull = fitted.evident + columns @ fitted.terms[-1].values
                option = replace(options[k], columns=columns * options[k].usual)
                self.prepared[beside] = weigh(replace(fitted, columns=others), [option], pull[:, None])
            again = self.prepared[beside](linear.scatter)
            corrected[:, alike] += (again.none + again.options[:, 0] - linear.evidence.none - corrected[:, k])[:, None]
            if form in self.comparison.terms and not fitted.terms[-1].possible:
                corrected[:, alike] = -np.inf
        place = replace(linear, evidence=replace(linear.evidence, options=corrected))
        best = [options[int(np.argmax(place.logs))].term] if options else []
        return replace(place, likeliest=self.fit((*terms, *best)))

    def further(self, entered: Terms) -> ShortPlace:
        """Weigh one more effect, and rank its evidence among surrogates without it."""
        place, key = self.weigh_in_place(entered), frozenset(entered)
        if place.detection is None:
            self.weighed[key] = replace(place, detection=detect(place, self.options.surrogates))
        return self.weighed[key]

    def gain(self, entered: Terms) -> float:
        """Sum the log evidence of terms, each beside those before it."""
        places = [self.weigh_in_place(entered[:k]) for k in range(len(entered))]
        each = zip(places, entered, strict=True)
        return sum(float(np.logaddexp.reduce(place.logs[place.alike(type(term))])) for place, term in each)


def _rank_alone(place: ShortPlace) -> tuple[RankedEffect, ...]:
    """Rank the effects, each alone."""
    ranked = []
    for name, chance in name_probabilities(place.options, place.place).items():
        alike = [k for k, option in enumerate(place.options) if option.name == name]
        share = np.logaddexp.reduce([place.options[k].share for k in alike])
        columns = place.options[max(alike, key=place.logs.__getitem__)].columns
        basis = orthonormal_basis(place.base.projected(columns))
        size_deg = float(np.linalg.norm(basis.T @ place.base.evident) / np.sqrt(len(basis)))
        ranked.append(RankedEffect(name, float(np.logaddexp.reduce(place.logs[alike]) - share), size_deg, chance))
    return tuple(sorted(ranked, key=lambda effect: -effect.score))


def _zeros(state: FittedHypothesis) -> Terms:
    return tuple(term.at(0.0 * term.values) for term in state.terms)
