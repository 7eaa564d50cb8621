"""Search short recordings for effects, with the linear Gaussian model of long ones and another noise.

Effects enter one after the other while the evidence of one more ranks among the highest of surrogates. Each effect is
weighed in its place beside the others; its likeliest form and place are fitted in the forward model, since effects may
exceed the noise a thousandfold. What no listed effect describes is a composed one: a curve of a covariate, or an offset
in a sector of headings or for a while. Otherwise a card that is pulled in one sector is taken for a harmonic, and a
temporary offset for a slip.
"""

from __future__ import annotations

import itertools
import zlib
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.effects.composed import ComposedEffect, bump, compose_effect, place_effect
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference.comparison import Options
from compasslib.inference.evidence import (
    DATE_MARGIN,
    MOST_DATES,
    MOST_EFFECTS,
    PAIRS_SHARE,
    UNLIKELY,
    Evidence,
    Option,
    Place,
    log_bayes_factors,
    scale_option,
    side_probabilities,
    with_shares,
)
from compasslib.inference.finding import LISTED_SHARE, Detection, FindingPosterior, RankedEffect, compare_names
from compasslib.inference.short_fit import FINEST_DEG, WHITE, FittedHypothesis, Law, ShortComparison, fit_hypothesis
from compasslib.statistics.noise import arma_innovations, arma_series, arma_variance_ratio
from compasslib.statistics.resampling import EVEN_BLOCKS, cluster_variance_inflation, resample_blocks
from compasslib.statistics.whitening import orthonormal_basis, project_out
from compasslib.types import Floats

Terms = tuple[Effect, ...]  # at zero size
Places = NDArray[np.intp]  # (g, d) candidate places of a term

AMPLITUDES = 4.0 ** np.arange(-1, 6)  # rms of an effect over the noise, equally probable; logs have effects of 1000
SAME = 1e-6  # singular value that is none, relative to the largest
NEARLY = 0.8  # share of the best log evidence from which composed effects, which are nearly linear, are fitted too
SPELL_EDGES = 14  # edges of temporary offsets that are tried first
FEWEST_AFFECTED = 3  # samples on either side of a date, or of an offset
SECTOR_STEP_DEG, REACHES_DEG = 10, (15, 25, 40)  # distance of the sectors that are tried first, and their half widths
FINER = 4  # ratio of the distances of candidate places and of finer ones around the best


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
    alone: tuple[RankedEffect, ...]

    def sides(self, dropped: Collection[str] = ()) -> dict[str, float]:
        """Compute the probability that each side acts, the first of SIDES_IN_ORDER if several do, and of none."""
        return side_probabilities((*self.places, self.further), dropped)

    def probabilities(self, k: int) -> FindingPosterior:
        """Compute the probability of each effect in the place of a term, given that one is there."""
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
        alone=_rank_alone(search.weigh(())),
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
            evidence = weigh(base, options, base.evident[:, None])
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
                self.prepared[beside] = weigh(replace(fitted, columns=others), [option], pull[:, None])
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
            fits = place.base, place.likeliest_fit
            place = replace(place, detection=detect(*fits, place.evidence, place.scatter, self.options.surrogates))
            if place.detection and not place.detection.significant:
                place = place.not_favoured(self.options.prior_odds)
            self.weighed[key] = place
        return self.weighed[key]

    def gain(self, entered: Terms) -> float:
        """Sum the log evidence of terms, each beside those before it."""
        places = [self.weigh(entered[:k]) for k in range(len(entered))]
        each = zip(places, entered, strict=True)
        return sum(float(np.logaddexp.reduce(place.logs[place.alike(type(term))])) for place, term in each)


def _rank_alone(place: ShortPlace) -> tuple[RankedEffect, ...]:
    """Rank the effects, each alone."""
    ranked, options = [], place.evidence.options
    for name, chance in place.names.items():
        alike = [k for k, option in enumerate(options) if option.name == name]
        share = np.logaddexp.reduce([options[k].share for k in alike])
        columns = options[max(alike, key=place.logs.__getitem__)].columns
        basis = orthonormal_basis(place.base.projected(columns))
        size_deg = float(np.linalg.norm(basis.T @ place.base.evident) / np.sqrt(len(basis)))
        ranked.append(RankedEffect(name, float(np.logaddexp.reduce(place.logs[alike]) - share), size_deg, chance))
    return tuple(sorted(ranked, key=lambda effect: -effect.score))


def _zeros(state: FittedHypothesis) -> Terms:
    return tuple(term.at(0.0 * term.values) for term in state.terms)


def detect(
    base: FittedHypothesis, likeliest: FittedHypothesis, evidence: Evidence, scatter: float, surrogates: int
) -> Detection:
    """Rank the evidence of an effect beside a hypothesis among surrogates without it, as for long records.

    Args:
        likeliest: with the likeliest effect.
        surrogates: number of each kind; without any, no effect is detected.
    """
    statistics = []
    if surrogates and evidence.options:
        kinds = (False,) if base.comparison.independent else (False, True)
        residuals = [_draw(base, likeliest, evidence, surrogates, resampled) for resampled in kinds]
        each = weigh(base, evidence.options, np.concatenate(residuals, axis=1))(scatter).statistic
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


def short_options(state: FittedHypothesis, taken: Collection[str] = ()) -> tuple[Option, ...]:
    """Enumerate the candidate effects beside a hypothesis but those taken, each at its candidate places."""
    listed = []
    for kind in (kind for kind in state.comparison.terms if kind.name not in taken):
        listed += [*_dated(state, kind)] if kind.dated() else [_option(state, kind())]
    unlisted = [option for option in _unlisted(state) if option.name not in taken] if state.comparison.reads else []
    shares = np.log([1.0 - PAIRS_SHARE * bool(unlisted), PAIRS_SHARE]).tolist()
    return tuple(
        replace(option, share=option.share + share)
        for made, share in zip((listed, unlisted), shares, strict=True)
        for option in with_shares([option for option in made if option.columns.shape[1]])
    )


def _dated(state: FittedHypothesis, kind: type[Effect]) -> Iterator[Option]:
    n = len(state.comparison)
    edge = max(int(DATE_MARGIN * n), FEWEST_AFFECTED)

    def term(k: float) -> Effect:
        return replace(kind(), date_s=_time_between(state, k))  # type: ignore[call-arg]

    def acting(places: Places) -> Floats:
        inside = (places[:, 0] >= edge) & (places[:, 0] <= n - edge)
        return ((np.arange(n)[:, None] >= places[:, 0]) & inside).astype(float)

    grid = np.unique(np.linspace(edge, n - edge, min(n, MOST_DATES)).astype(np.intp))[:, None]
    always = state.derivative(replace(kind(), date_s=-np.inf))  # type: ignore[call-arg]
    yield from _located(state, term, always, acting, grid, [-(-n // MOST_DATES)])


def _unlisted(state: FittedHypothesis) -> Iterator[Option]:
    """Yield curves along the covariates, and offsets in a sector of headings or for a while."""
    comparison, n = state.comparison, len(state.comparison)
    sector, spell = (compose_effect("reading", *each) for each in (("heading", "bump"), ("time", "box")))
    curves: list[Effect] = [place_effect(compose_effect("reading", "time", "slow"), *comparison.span_s)]

    def during(places: Places) -> Floats:
        inside = (places[:, 0] > 0) & (places[:, 1] < n)
        number = np.arange(n)[:, None]
        return ((number >= places[:, 0]) & (number < places[:, 1]) & inside).astype(float)

    edges = np.unique(np.linspace(1, n - 1, min(n - 1, SPELL_EDGES)).astype(np.intp))
    yield from _located(
        state, lambda *at: place_effect(spell, *(_time_between(state, k) for k in at)), np.ones((n, 1)),
        during, np.array(list(itertools.combinations(edges, 2))), [-(-n // SPELL_EDGES)] * 2,
    )  # fmt: skip
    if "heading" in comparison.covariates:
        heading = comparison.covariates["heading"]
        centres = np.array(list(itertools.product(range(0, 360, SECTOR_STEP_DEG), REACHES_DEG)))
        yield from _located(
            state, lambda *at: place_effect(sector, *at), np.ones((n, 1)),
            lambda places: np.stack([bump(heading, *at) for at in places.tolist()], axis=1), centres,
            [SECTOR_STEP_DEG, 0],
        )  # fmt: skip
        curves.append(compose_effect("reading", "heading", "harmonics")())
    for name, x in comparison.covariates.items():
        if name not in ("heading", "time", "reading") and np.ptp(x) > 0.0:
            curves.append(place_effect(compose_effect("reading", name, "smooth"), 0.0, float(np.std(x))))
    yield from (_option(state, term) for term in curves)


def _located(
    state: FittedHypothesis,
    term: Callable[..., Effect],
    always: Floats,
    acting: Callable[[Places], Floats],
    grid: Places,
    step: Sequence[int],
) -> Iterator[Option]:
    """Yield a term at candidate places, and at finer ones around the likeliest.

    Args:
        term: function of a place that returns the term at zero size.
        always: derivative by the term's parameters where it acts, (n, p) degrees a unit.
        acting: function of places that returns the share that acts at each sample, (n, g).
        step: distance between candidate places, (d,).
    """

    def columns_at(places: Places) -> tuple[Places, Floats]:
        share = acting(places)
        enough = np.count_nonzero(share, axis=0) >= FEWEST_AFFECTED
        return places[enough], always[:, None, :] * share[:, enough, None]

    def likeliest(columns: Floats) -> int:
        n, count, parameters = columns.shape
        ends = parameters * np.arange(count + 1)
        flat = columns.reshape(n, -1)
        return int(np.argmax(log_evidence(WHITE, state.columns, flat, ends, state.evident[:, None])(1.0)[1]))

    places, columns = columns_at(grid)
    cells, finer = np.ones(len(places)), np.array(step)
    if (finer > 1).any() and len(places):
        first = best = likeliest(columns)
        others = np.arange(len(places)) != first
        coarse, cell = (places[others], columns[:, others]), 1.0
        while (finer > 1).any():
            closer = np.maximum(finer // FINER, np.minimum(finer, 1))
            cell *= float(np.prod(closer[finer > 0] / finer[finer > 0]))
            offsets = np.array(list(itertools.product(range(-FINER, FINER + 1), repeat=len(closer))))
            places, columns = columns_at(np.unique(places[best] + closer * offsets, axis=0))
            best, finer = likeliest(columns), closer
        cells = np.append(np.ones(len(coarse[0])), np.full(len(places), cell))
        places, columns = np.concatenate([coarse[0], places]), np.concatenate([coarse[1], columns], axis=1)
    for k, at in enumerate(places.tolist()):
        yield _option(state, term(*at), columns[:, k], float(cells[k]))


def _time_between(state: FittedHypothesis, k: float) -> float:
    return float(np.mean(state.comparison.time_s[int(k) - 1 : int(k) + 1]))


def _option(state: FittedHypothesis, term: Effect, derivative: Floats | None = None, cell: float = 1.0) -> Option:
    derivative = state.derivative(term) if derivative is None else derivative
    return scale_option(term, derivative, np.sqrt(np.mean(derivative**2, axis=0)), cell=cell)


def weigh(state: FittedHypothesis, options: Sequence[Option], residuals: Floats) -> Callable[[float], Evidence]:
    """Prepare the evidence of options under each law of the noise, for residuals (n, r).

    Returns:
        Function of the variance of scores between blocks over that of homogeneous noise.
    """
    laws, rule_deg = state.comparison.laws, state.comparison.rule_deg
    ends = np.cumsum([0, *(option.columns.shape[1] for option in options)])
    columns = np.concatenate([np.zeros((len(residuals), 0)), *(option.columns for option in options)], axis=1)
    each = [log_evidence(law, state.columns, columns, ends, residuals, rule_deg) for law in laws]

    def evidence(scatter: float) -> Evidence:
        none, factors = (np.array(part) for part in zip(*(of_law(scatter) for of_law in each), strict=True))
        return Evidence(tuple(options), laws, np.zeros((len(laws), 1)), none, factors)

    return evidence


def log_evidence(
    law: Law, base: Floats, columns: Floats, ends: NDArray[np.intp], residuals: Floats, rule_deg: float = 0.0
) -> Callable[[float], tuple[Floats, Floats]]:
    """Prepare the log likelihood without options, (r,), and the log Bayes factor of each, (g, r), under one noise law.

    Coefficients of the base have a flat prior, and the variance of the noise is unknown (Student's law).

    Args:
        base, columns: of the hypothesis, (n, b), and of the options, (n, m).
        ends: boundaries between the options' columns, (g + 1,).
        residuals: (n, r) degrees.
        rule_deg: systematic error, the least standard deviation of the noise.

    Returns:
        Function of the variance of scores between blocks over that of homogeneous noise.
    """
    n, ratio = len(base), arma_variance_ratio(law)
    orthonormal, triangle = np.linalg.qr(arma_innovations(base, law))
    left, size, _ = np.linalg.svd(triangle)
    retained = size > SAME * size.max(initial=0.0)
    basis, white = orthonormal @ left[:, retained], arma_innovations(columns, law)
    target, cross = project_out(arma_innovations(residuals, law), basis), basis.T @ white
    square = np.sum(target**2, axis=0) + n * max(rule_deg, FINEST_DEG) ** 2 / ratio
    volume = 0.5 * np.log(ratio) + np.sum(np.log(size[retained]))
    score, sizes, groups = white.T @ target, np.diff(ends), []
    for count in np.unique(sizes):
        options = np.flatnonzero(sizes == count)
        index = ends[options][:, None] + np.arange(count)
        part, taken = (x[:, index].transpose(1, 2, 0) for x in (white, cross))
        values, vectors = np.linalg.eigh(part @ part.transpose(0, 2, 1) - taken @ taken.transpose(0, 2, 1))
        along = (vectors.transpose(0, 2, 1) @ score[index]) ** 2
        groups.append((options, np.maximum(values, 0.0), along))

    def evidence(scatter: float) -> tuple[Floats, Floats]:
        freedom = max(n - int(retained.sum()), 1) / scatter
        factors = np.empty((len(sizes), residuals.shape[1]))
        for options, values, along in groups:
            each = [log_bayes_factors(values, along, a, square, freedom) for a in AMPLITUDES]
            factors[options] = np.logaddexp.reduce(each, axis=0) - np.log(len(AMPLITUDES))
        return -0.5 * freedom * np.log(square) - volume, factors

    return evidence


def score_scatter(fitted: FittedHypothesis, law: Law, columns: Sequence[Floats]) -> float:
    """Estimate by how much scores of effects vary more between blocks than homogeneous noise explains, at least 1."""
    base = orthonormal_basis(arma_innovations(fitted.columns, law))
    left = project_out(arma_innovations(fitted.evident[:, None], law), base)[:, 0]
    variance = max(float(np.mean(left**2)), FINEST_DEG**2)
    ratios, block = [], fitted.blocks
    for each in columns:
        white = orthonormal_basis(project_out(arma_innovations(each, law), base))
        if white.shape[1]:
            ratio, count = cluster_variance_inflation(white, left, block, variance)
            ratios.append((count * ratio + EVEN_BLOCKS) / (count + EVEN_BLOCKS))
    return max(float(np.median(ratios)), 1.0) if ratios else 1.0
