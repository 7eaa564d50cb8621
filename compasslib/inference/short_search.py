"""Search short recordings for effects, with the linear Gaussian model of long ones and another noise.

Effects enter one after the other while the evidence of one more ranks among the highest of surrogates. Each effect is
weighed in its place beside the others; its likeliest form and place are fitted in the forward model, since effects may
exceed the noise a thousandfold.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib import angles
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference import finding
from compasslib.inference.comparison import Options, build_finding
from compasslib.inference.diagnosis import Outcome
from compasslib.inference.evidence import MOST_EFFECTS, UNLIKELY, Evidence, Place, side_probabilities
from compasslib.inference.finding import (
    LISTED_SHARE,
    BinnedResidual,
    CovariateRange,
    Detection,
    Finding,
    HeldOut,
    Parameter,
    Unexplained,
    compare_names,
)
from compasslib.inference.short_model import (
    FINEST_DEG,
    FittedHypothesis,
    ShortComparison,
    fit_hypothesis,
    score_scatter,
    short_options,
    weigh,
)
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.noise import arma_innovations, arma_series
from compasslib.statistics.resampling import resample_blocks
from compasslib.types import Floats

Terms = tuple[Effect, ...]  # at zero size

NEARLY = 0.8  # share of the best log evidence from which composed effects, which are nearly linear, are fitted too


@dataclass(frozen=True)
class ShortPlace(Place):
    """The place of one effect beside others."""

    base: FittedHypothesis
    likeliest_fit: FittedHypothesis  # with the likeliest option
    scatter: float  # variance of scores between blocks over that of homogeneous noise
    detection: Detection | None = None  # of an effect in it; None if it was not computed

    @property
    def logs(self) -> Floats:
        """Log Bayes factor of each option over none, times its prior share."""
        return np.asarray(self.evidence.log_bayes_factors[:, 0])


@dataclass(frozen=True)
class ShortInference:
    """The effects of a short recording, with the probability of every option in the place of each."""

    before: FittedHypothesis  # fit of the base parameters alone
    fitted: FittedHypothesis
    places: tuple[ShortPlace, ...]  # of each term
    further: ShortPlace  # of one more effect
    detection: Detection | None  # of any effect

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability that each side acts, the first of SIDES_IN_ORDER if several do, and of none."""
        return side_probabilities((*self.places, self.further), dropped)

    def chances(self, k: int) -> dict[str, float]:
        """Compute the probability of each effect in the place of a term, which comes first, given that one is there."""
        return compare_names(self.fitted.terms[k].name, self.places[k].names)


def search_effects(comparison: ShortComparison, options: Options) -> ShortInference:
    """Search for the terms that explain a comparison, each with its alternatives."""
    search = _Search(comparison, options)
    entered = search.run(listed=False)
    if any(isinstance(term, ComposedEffect) for term in entered):  # one wide form may stand for two listed effects
        entered = max(entered, search.run(listed=True), key=search.gain)
    return ShortInference(
        before=search.fit(()),
        fitted=search.fit(entered),
        places=tuple(search.weigh((*entered[:k], *entered[k + 1 :])) for k in range(len(entered))),
        further=search.further(entered),
        detection=search.further(()).detection,
    )


@dataclass
class _Search:
    """Hypotheses of one comparison that were fitted and weighed, by the terms at zero size."""

    comparison: ShortComparison
    options: Options
    fits: dict[Terms, FittedHypothesis] = field(default_factory=dict)
    weighed: dict[frozenset[Effect], ShortPlace] = field(default_factory=dict)
    prepared: dict[Terms, Callable[[float], Evidence]] = field(default_factory=dict)  # evidence of the last term's fit

    def run(self, *, listed: bool) -> Terms:
        """Enter effects while one more is detected, only listed ones if so asked."""
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
            term = self._likeliest(self.weigh(others), listed)
            changed = others if term is None else (*entered[:k], term, *entered[k + 1 :])
            if frozenset(changed) in visited:
                k += 1
            else:
                visited.add(frozenset(changed))
                entered, k = changed, 0
        return entered

    def _likeliest(self, place: ShortPlace, listed: bool) -> Effect | None:
        """Select the likeliest term of a place; None if none is likely, or its visible size is negligible."""
        kinds = {type(each.term) for each in place.evidence.options}
        taken = {kind for kind in kinds if listed and issubclass(kind, ComposedEffect)}
        if place.none > UNLIKELY or taken == kinds:
            return None
        term = place.evidence.options[place.likeliest(taken)].term
        fitted = self.fit((*_zeros(place.base), term))
        size = fitted.visible_size_deg(len(fitted.terms) - 1)
        return term if size >= LISTED_SHARE * self.options.min_effect_deg else None

    def fit(self, terms: Terms) -> FittedHypothesis:
        """Fit a hypothesis in the forward model, the last term from each of its starting values."""
        if terms not in self.fits and not terms:
            self.fits[terms] = fit_hypothesis(self.comparison, ())
        elif terms not in self.fits:
            near, last = self.fit(terms[:-1]), terms[-1]
            starts = [np.append(first, last.values[1:]) for first in self.comparison.starts.get(last.name, ())]
            fits = [
                fit_hypothesis(self.comparison, (*near.terms, last.at(start)), near=near)
                for start in (last.values, *starts)
            ]
            self.fits[terms] = min(fits, key=lambda fit: fit.square)
        return self.fits[terms]

    def weigh(self, others: Terms) -> ShortPlace:
        """Weigh every option beside some terms."""
        key = frozenset(others)
        if key not in self.weighed:
            base = self.fit(others)
            options = short_options(base, {term.name for term in others})
            evidence = weigh(self.comparison, base.columns, options, base.evident[:, None])
            place = self._refit(base, evidence(1.0), 1.0)
            if options and not self.comparison.independent:
                # Weigh them again, with the scatter that is left once the likeliest effect is fitted.
                first = {type(option.term): option.columns for option in reversed(options)}
                law = place.evidence.likeliest_noise(int(np.argmax(place.logs)))
                scatter = score_scatter(place.likeliest_fit, law, list(first.values()))
                place = self._refit(base, evidence(scatter), scatter)
            self.weighed[key] = place
        return self.weighed[key]

    def _refit(self, base: FittedHypothesis, linear: Evidence, scatter: float) -> ShortPlace:
        """Replace the evidence of listed and of likely forms, at their likeliest places, by that of their fits."""
        options, terms, factors = linear.options, _zeros(base), linear.factors.copy()
        logs, forms = linear.log_bayes_factors[:, 0], dict[type[Effect], list[int]]()
        for k, option in enumerate(options):
            forms.setdefault(type(option.term), []).append(k)
        for form, alike in forms.items():
            k = max(alike, key=logs.__getitem__)
            if form not in self.comparison.terms and logs[k] < NEARLY * logs.max():
                continue
            fitted = self.fit(beside := (*terms, options[k].term))
            if beside not in self.prepared:
                own = parameter_slices(fitted.terms, len(fitted.base))[-1]
                columns, others = fitted.columns[:, own], np.delete(fitted.columns, own, axis=1)
                pull = fitted.evident + columns @ fitted.terms[-1].values
                option = replace(options[k], columns=columns * options[k].usual)
                self.prepared[beside] = weigh(self.comparison, others, [option], pull[:, None])
            again = self.prepared[beside](scatter)
            factors[:, alike] += (again.none + again.factors[:, 0] - linear.none - factors[:, k])[:, None]
            if form in self.comparison.terms and not fitted.terms[-1].possible:
                factors[:, alike] = -np.inf
        evidence = replace(linear, factors=factors)
        best = [options[int(np.argmax(evidence.log_bayes_factors[:, 0]))].term] if options else []
        probability = Place.weigh(evidence, self.options.prior_odds).probability
        return ShortPlace(evidence, probability, base, self.fit((*terms, *best)), scatter)

    def further(self, entered: Terms) -> ShortPlace:
        """Weigh one more effect, and rank its evidence among surrogates without it."""
        place, key = self.weigh(entered), frozenset(entered)
        if place.detection is None:
            fits, surrogates = (place.base, place.likeliest_fit), self.options.surrogates
            detection = detect(*fits, place.evidence, place.scatter, surrogates)
            limited = place if detection.significant else place.not_favoured(self.options.prior_odds)
            self.weighed[key] = replace(limited, detection=detection)
        return self.weighed[key]

    def gain(self, entered: Terms) -> float:
        """Sum the log evidence of terms, each beside those before it."""
        places = [self.weigh(entered[:k]) for k in range(len(entered))]
        each = zip(places, entered, strict=True)
        return sum(float(np.logaddexp.reduce(place.logs[place.alike(type(term))])) for place, term in each)


def _zeros(state: FittedHypothesis) -> Terms:
    return tuple(term.at(0.0 * term.values) for term in state.terms)


def detect(
    base: FittedHypothesis, likeliest: FittedHypothesis, evidence: Evidence, scatter: float, surrogates: int
) -> Detection:
    """Rank the evidence of an effect among surrogates without it, of which there may be none."""
    statistics = []
    if surrogates and evidence.options:
        kinds = (False,) if base.comparison.independent else (False, True)
        residuals = [_draw(base, likeliest, evidence, surrogates, resampled) for resampled in kinds]
        drawn = np.concatenate(residuals, axis=1)
        each = weigh(base.comparison, base.columns, evidence.options, drawn)(scatter).statistic
        statistics = np.split(each, len(kinds))
    return Detection.by_rank(float(evidence.statistic[0]), statistics)


def _draw(
    base: FittedHypothesis, likeliest: FittedHypothesis, evidence: Evidence, count: int, resampled: bool
) -> Floats:
    """Draw residuals without a further effect, (n, count) degrees.

    Args:
        resampled: whether blocks of the residual with the likeliest effect are resampled, in place of noise whose laws
            are drawn by their probability without it.
    """
    seed = zlib.crc32(base.residual_deg.tobytes())
    if resampled:
        law = evidence.likeliest_noise(int(np.argmax(evidence.log_bayes_factors[:, 0])))
        white = arma_innovations(likeliest.evident[:, None], law)[:, 0]
        length = int(np.max(np.bincount(likeliest.blocks)))
        return arma_series(resample_blocks(white - white.mean(), length, count, seed).T, law)
    rng = np.random.default_rng(seed)
    chosen = rng.choice(len(evidence.noises), count, p=evidence.noise_probability())
    innovations = likeliest.scale_deg * rng.normal(size=(len(likeliest.evident), count))
    each = [arma_series(x[:, None], evidence.noises[k])[:, 0] for x, k in zip(innovations.T, chosen, strict=True)]
    return np.stack(each, axis=1)


def build_outcome(inferred: ShortInference, min_effect_deg: float) -> Outcome:
    """Collect the outcome of the search of one comparison."""
    fitted, comparison = inferred.fitted, inferred.fitted.comparison
    sizes = [fitted.visible_size_deg(k) for k in range(len(fitted.terms))]
    unlisted = [k for k, term in enumerate(fitted.terms) if isinstance(term, ComposedEffect)]
    listed = [k for k in range(len(fitted.terms)) if k not in unlisted]
    covariance = fitted.covariance if listed else np.zeros((0, 0))
    findings = tuple(_finding(inferred, k, covariance, sizes, min_effect_deg) for k in listed)
    left = None
    if unlisted and sizes[k := max(unlisted, key=sizes.__getitem__)] >= min_effect_deg:
        left = _unexplained(fitted, k, sizes[k], [item.effect for item in findings])

    def curves(shown: Sequence[Finding], left: Unexplained | None) -> list[BinnedResidual]:
        names = {term.name for term in fitted.terms}
        wanted = {"heading", *(left.covariates if left else ())}
        wanted |= {item.where.covariate for item in shown if item.effect in names}
        return [residual_curve(inferred.before, fitted, name) for name in comparison.covariates if name in wanted]

    scatter = fitted.scale_deg / float(np.sqrt(2.0 * max(fitted.effective_samples, 1.0)))
    return Outcome(
        comparison=comparison,
        sides=inferred.sides,
        findings=findings,
        chances=tuple(inferred.chances(k) for k in listed),
        left=left,
        small=tuple((_along(fitted, k), sizes[k]) for k in unlisted if sizes[k] < min_effect_deg),
        curves=curves,
        noise={"white_deg": (fitted.scale_deg, scatter)},
        detection=inferred.detection,
        deniable=True,
    )


def _finding(
    inferred: ShortInference, k: int, covariance: Floats, sizes: Sequence[float], min_effect_deg: float
) -> Finding:
    fitted, comparison = inferred.fitted, inferred.fitted.comparison
    term, columns = fitted.terms[k], parameter_slices(fitted.terms, len(fitted.base))[k]
    sigma, parameters = np.sqrt(np.maximum(np.diag(covariance), 0.0))[columns], {}
    for j, name in enumerate(term.fitted()):
        factor, unit = comparison.unit(term, j)
        shown = name if unit == term.units()[j] else name.replace("_nT", "")
        parameters[shown] = Parameter(factor * float(term.values[j]), factor * float(sigma[j]), unit)
    shared: dict[str, float] = {}
    for effect, p in inferred.chances(k).items():
        alike = (effect, *comparison.confused.get(effect, ()))
        for name in alike:
            shared[name] = shared.get(name, 0.0) + p / len(alike)
    along = residual_curve(inferred.before, inferred.before, comparison.main_covariate(term))
    return build_finding(
        comparison,
        term,
        shared,
        parameters,
        size_deg=sizes[k],
        proof=held_out_gain(fitted, fitted, fitted.terms[:k] + fitted.terms[k + 1 :]),
        place=comparison.outside(along),
        others=[
            other
            for j, other in enumerate(fitted.terms)
            if j != k and sizes[j] >= min_effect_deg and other.driver == term.driver
        ],
    )


def _unexplained(fitted: FittedHypothesis, k: int, size_deg: float, listed: Sequence[str]) -> Unexplained:
    """Describe the mismatch of a composed term, which no listed effect explains; a heading range may cross north."""
    comparison, name, term = fitted.comparison, _along(fitted, k), fitted.terms[k]
    assert isinstance(term, ComposedEffect)
    base = fit_hypothesis(comparison, fitted.terms[:k] + fitted.terms[k + 1 :], near=fitted)
    place: CovariateRange | None = None
    if term.composition[2] in ("bump", "box"):
        share = comparison.series(term)[:, 0]
        inside = comparison.covariates[name][share > np.max(share) / 2.0]
        low, high = float(inside.min()), float(inside.max())
        if name == "heading":
            away = angles.difference(inside, angles.mean(inside))
            low, high = (float(angles.wrap360(angles.mean(inside) + end)) for end in (away.min(), away.max()))
        place = comparison.where(name, (low, high))
    return comparison.unexplained([residual_curve(base, base, name)], size_deg, listed, place)


def _along(fitted: FittedHypothesis, k: int) -> str:
    driver = fitted.terms[k].driver
    return driver if driver in fitted.comparison.covariates else "reading"


def held_out_gain(
    less: FittedHypothesis,
    fitted: FittedHypothesis,
    terms: Sequence[Effect],
    error: Callable[[FittedHypothesis], Floats] = lambda fitted: fitted.residual_deg,
) -> HeldOut:
    """Score a fit on held-out stretches against one with other terms or another base, by default by the residual."""
    block, left = fitted.blocks, []
    folds = block.max() + 1 if fitted.comparison.independent else min(finding.FOLDS, block.max() + 1)
    for near, free in ((less, terms), (fitted, fitted.terms)):
        residual = np.empty(len(block))
        for out in (block % folds == fold for fold in range(folds)):
            residual[out] = error(fit_hypothesis(near.comparison, free, near=near, use=~out))[out]
        left.append(residual)
    return finding.compare_residuals(left[0], left[1], max(robust_width(left[0]), FINEST_DEG), block)


def residual_curve(before: FittedHypothesis, after: FittedHypothesis, name: str) -> BinnedResidual:
    """Bin the residual along a covariate, with and without terms, with the standard error of each bin."""
    comparison = before.comparison
    column = comparison.covariates[name]
    bins, edges = finding.bins_along(name, column)
    there = np.bincount(bins, minlength=len(edges) - 1)
    held = np.flatnonzero(there >= (1 if comparison.independent or comparison.arma_noise else finding.FEWEST_IN_BIN))
    centre, *means = (
        np.bincount(bins, x, len(edges) - 1)[held] / there[held] for x in (column, before.residual_deg, after.clipped)
    )
    share = after.effective_samples / len(column)
    sigma = float(np.std(after.clipped)) / np.sqrt(np.maximum(there[held] * share, 1.0))
    return BinnedResidual(name, centre, means[0], means[1], sigma, comparison.what)
