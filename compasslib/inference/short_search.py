"""Search short recordings for effects: hypotheses of up to three terms, each refitted in the forward model.

Offsets without a physical cause, confined to a heading sector or a time interval, are among the hypotheses: otherwise
a card that is pulled in one sector is taken for a heading harmonic, and a temporary offset for a slip.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference import comparison, finding, omnibus, short_evidence, short_fit
from compasslib.inference import posterior as posteriors
from compasslib.inference.comparison import Options
from compasslib.inference.covariates import hat_columns, standardize
from compasslib.inference.design import ColumnGroup
from compasslib.inference.diagnosis import Outcome
from compasslib.inference.finding import (
    BinnedResidual,
    CovariateRange,
    Finding,
    HeldOut,
    Parameter,
    RankedEffect,
    Unexplained,
)
from compasslib.inference.omnibus import OmnibusResult, ScoreTests, normal_score
from compasslib.inference.posterior import LOG_EVIDENCE_CUTOFF, MOST_TERMS, FindingPosterior, Hypothesis, Posterior
from compasslib.inference.short_evidence import LOCAL_OFFSETS, ShortEvidence
from compasslib.inference.short_fit import FittedHypothesis, ShortComparison
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.noise import arma_draws, arma_standard_errors, arma_whitening_matrix
from compasslib.statistics.resampling import resample_blocks
from compasslib.statistics.whitening import orthonormal_basis, project_out
from compasslib.types import Floats

NOISE_DRAWS = 400  # noise realizations: they determine the precision of a p-value of 1 %
HEADING_HAT_DEG, FEWEST_IN_HAT = 15.0, 5  # width of the omnibus test's heading sectors; least sum of weights in one
FAINTEST_DIRECTION = 0.2  # relative singular value below which a direction of a group's columns is dropped
SHARE_OF_FREEDOM = 3  # least number of independent samples per column of an omnibus group

PRIOR_FACTOR = 5.0  # prior odds relative to those of moorings: a compass is swung if suspect, and naming needs ``SURE``
MOST_PARENTS = 6  # most hypotheses of each size that are extended by another effect
MOST_PLACES = 3  # most candidate places at which one term is refitted
PARAMETER_COST = 1.0  # lower bound of a parameter's cost in log evidence, for skipping hypotheses without a refit

FEWEST_IN_BIN = 5  # fewest samples per bin of a plotted residual curve


def omnibus_groups(now: FittedHypothesis) -> list[ColumnGroup]:
    """Build omnibus columns: harmonics and hats of the heading, hats of other covariates, products with the heading."""
    covariates = now.channel.covariates
    # ARMA draws reproduce the autocorrelation, therefore every sample counts.
    worth = len(now.channel) if now.channel.arma_noise else short_fit.effective_samples(now)
    most = int(worth) // SHARE_OF_FREEDOM
    heading, made = covariates.get("heading"), []
    if heading is not None:
        made = [
            omnibus.fourier_columns(heading, range(3, 7)),
            omnibus.heading_hats(heading, HEADING_HAT_DEG, FEWEST_IN_HAT),
        ]
    groups = [ColumnGroup("heading", columns, covariates=("heading",)) for columns in made]
    for name, column in covariates.items():
        if name == "heading" or np.ptp(column) == 0.0:
            continue
        hats = hat_columns(column, min(omnibus.COVARIATE_KNOTS, max(3, most // 2)))
        groups.append(ColumnGroup(name, hats, covariates=(name,)))
        if heading is not None:
            both = omnibus.fourier_columns(heading, range(1, 3)) * standardize(column)[:, None]
            groups.append(ColumnGroup(f"heading x {name}", both, covariates=("heading", name)))
    return [group for group in groups if 0 < group.columns.shape[1] <= most]


def score_tests(
    now: FittedHypothesis, noise: FittedHypothesis, groups: Sequence[ColumnGroup], seed: int = 0
) -> ScoreTests:
    """Compute the score tests of all groups.

    Args:
        noise: hypothesis whose residual is the noise; a tested effect that it includes does not raise the threshold.
    """
    white = arma_whitening_matrix(noise.clipped, noise.columns) if now.channel.arma_noise else None
    filtered = [group.columns if white is None else white @ group.columns for group in groups]
    base = orthonormal_basis(now.columns if white is None else white @ now.columns)
    bases = [directions(columns, base) for columns in filtered]
    size = [max(float(np.linalg.norm(columns)), 1e-300) for columns in filtered]
    free = [float(np.linalg.norm(project_out(columns, base))) for columns in filtered]
    determined = [k for k, basis in enumerate(bases) if basis.shape[1] and free[k] > 1e-6 * size[k]]
    if not determined:
        none = np.zeros(0)
        return ScoreTests([], none, none, none, none)
    groups_bases, bases = [groups[k] for k in determined], [bases[k] for k in determined]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    basis_all = np.concatenate(bases, axis=1)
    rows = np.vstack([now.clipped[None, :], noise_draws(noise, seed)])
    gains = _gains(rows if white is None else rows @ white.T, basis_all, begins, base)
    inflation = np.maximum(gains[1:].mean(axis=0) / freedom, np.finfo(float).tiny)  # a zero residual has no noise
    score = normal_score(gains / inflation, freedom)
    return ScoreTests(groups_bases, freedom, np.maximum(inflation, 1.0), score[0], score[1:].max(axis=1))


def directions(columns: Floats, base: Floats) -> Floats:
    """Build an orthonormal basis of columns with the base projected out, (n, k).

    Directions nearly in the span of the base are dropped: what remains of them no longer resembles a spline.
    """
    return orthonormal_basis(project_out(columns, base), FAINTEST_DIRECTION)


def noise_draws(noise: FittedHypothesis, seed: int, repeats: int = NOISE_DRAWS) -> Floats:
    """Resample the record's own noise: blocks from random positions with random signs, (repeats, n).

    Independent readings are drawn from a normal distribution, and averages over stretches of a log from the fitted
    ARMA process: a short log has too few blocks to resample.
    """
    if noise.channel.independent:
        return np.random.default_rng(seed).normal(size=(repeats, len(noise.channel)))
    if noise.channel.arma_noise:
        return arma_draws(noise.clipped, noise.columns, seed, repeats)
    length = int(np.max(np.bincount(short_fit.memory_blocks(noise))))
    return resample_blocks(noise.clipped - noise.clipped.mean(), length, repeats, seed)


def group_size_deg(now: FittedHypothesis, group: ColumnGroup, inflation: float) -> float:
    """Compute the visible size of a group's best fit with the noise contribution subtracted, rms degrees."""
    columns = directions(group.columns, orthonormal_basis(now.columns))
    pull, n = columns.T @ now.clipped, len(now.channel)
    noise = inflation * columns.shape[1] * now.square / n
    return float(np.sqrt(max(float(pull @ pull) - noise, 0.0) / n))


def _gains(rows: Floats, basis_all: Floats, begins: NDArray[np.intp], base: Floats) -> Floats:
    """Compute twice the log-likelihood gain of each group for each row, (rows, groups)."""
    projected = rows - (rows @ base) @ base.T
    total = np.sum(projected**2, axis=1)[:, None]
    taken = np.add.reduceat((projected @ basis_all) ** 2, begins, axis=1)
    return -rows.shape[1] * np.log(np.maximum(1.0 - taken / np.maximum(total, 1e-300), 1e-12))


@dataclass(frozen=True)
class RefittedHypothesis:
    """A refitted hypothesis with its evidence."""

    fitted: FittedHypothesis
    evidence: ShortEvidence
    share: float  # log fraction of candidate places that fit about as well as the best, summed over its terms


@dataclass(frozen=True)
class SearchResult:
    """The chosen hypothesis with the alternatives to each of its terms."""

    before: FittedHypothesis  # fit of the base parameters alone
    fitted: FittedHypothesis
    posterior: Posterior
    finding_posteriors: tuple[FindingPosterior, ...]
    alone: dict[str, tuple[float, float]]  # log evidence and visible size (rms degrees) of each effect, alone
    omnibus: OmnibusResult  # tests of the residual of ``fitted``


@dataclass
class HypothesisSearch:
    """Stepwise search over the hypotheses of one comparison."""

    channel: ShortComparison
    alarm: float
    refitted: dict[Hypothesis, RefittedHypothesis] = field(default_factory=dict)

    @cached_property
    def kinds(self) -> list[type[Effect]]:
        """Effects that can be tested, and local offsets without a physical cause."""
        return [*self.channel.terms, *(kind for kind in LOCAL_OFFSETS if kind.fits(self.channel))]

    @cached_property
    def odds(self) -> list[float]:
        """Log prior odds of each kind, divided among the forms of an effect."""
        forms = Counter(kind.name for kind in self.kinds)
        whole = posteriors.log_prior_odds(self.kinds, PRIOR_FACTOR * self.alarm)
        return [odds - float(np.log(forms[kind.name])) for odds, kind in zip(whole, self.kinds, strict=True)]

    def logs(self, uneven: float = 1.0) -> dict[Hypothesis, float]:
        """Compute the log posterior of each hypothesis, up to a constant."""
        evidence = short_evidence.log_evidence(
            self.channel, [hypothesis.evidence for hypothesis in self.refitted.values()], uneven
        )
        each = zip(self.refitted.items(), evidence.tolist(), strict=True)
        return {key: log + hypothesis.share + self.prior(key) for (key, hypothesis), log in each}

    def prior(self, hypothesis: Hypothesis) -> float:
        return posteriors.joint_odds([self.odds[k] for k in hypothesis])

    def run(self) -> None:
        """Try single effects, then extend the likeliest hypotheses to pairs and triples."""
        base = short_fit.fit_hypothesis(self.channel, ())
        self.refitted[()] = RefittedHypothesis(base, short_evidence.short_evidence(base), 0.0)
        for size in range(MOST_TERMS):
            logs = self.logs()
            parents = sorted(
                (hypothesis for hypothesis in self.refitted if len(hypothesis) == size), key=logs.__getitem__
            )[-MOST_PARENTS:]
            for parent in reversed(parents):
                self._extended(parent)

    def _extended(self, parent: Hypothesis) -> None:
        """Extend a hypothesis by every other effect, refitting where the linearized gain is large enough."""
        base, logs = self.refitted[parent].fitted, self.logs()
        law = short_evidence.likeliest_law(self.channel, self.refitted[parent].evidence)
        taken = {self.kinds[k].name for k in parent}
        for k, kind in enumerate(self.kinds):
            hypothesis = tuple(sorted((*parent, k)))
            terms = short_evidence.candidate_places(base, kind)
            if kind.name in taken or hypothesis in self.refitted or not terms:
                continue
            columns = short_evidence.place_columns(base, terms)
            gains, plain = (
                short_evidence.likelihood_gains(base, memory, columns) for memory in (law, short_evidence.WHITE[0])
            )
            promised = logs[parent] + float(gains.max()) - PARAMETER_COST * len(kind.fitted()) + self.odds[k]
            if parent and promised < max(logs.values()) - LOG_EVIDENCE_CUTOFF:
                continue
            refitted = self._place(base, terms, columns, plain)
            fitted = refitted.fitted.reordered(np.argsort((*parent, k)).tolist())
            self.refitted[hypothesis] = RefittedHypothesis(
                fitted, refitted.evidence, self.refitted[parent].share + refitted.share
            )

    def _place(self, base: FittedHypothesis, terms: list[Effect], columns: Floats, gains: Floats) -> RefittedHypothesis:
        """Add a term at its best place, under the noise model that is likeliest once it is fitted.

        Args:
            gains: log-likelihood gain of each place under white noise: an effect not yet fitted mimics a long memory.
        """
        best: int | None = None
        for _ in range(MOST_PLACES):
            if best == int(np.argmax(gains)):
                break
            best = int(np.argmax(gains))
            fitted = self._refitted(base, terms[best])
            evidence = short_evidence.short_evidence(fitted)
            gains = short_evidence.likelihood_gains(base, short_evidence.likeliest_law(self.channel, evidence), columns)
        return RefittedHypothesis(fitted, evidence, float(np.log(np.mean(np.exp(gains - gains.max())))))

    def _refitted(self, base: FittedHypothesis, term: Effect) -> FittedHypothesis:
        """Refit a hypothesis with one more term, from each of its starting values."""
        starts = [np.append(first, term.values[1:]) for first in self.channel.starts.get(term.name, ())]
        fits = [
            short_fit.fit_hypothesis(self.channel, (*base.terms, term.at(v)), near=base) for v in (term.values, *starts)
        ]
        return _refine_places(min(fits, key=lambda fit: fit.square))

    def posterior(self) -> Posterior:
        """Compute the posterior, with score variances inflated as by blocks of the likeliest hypothesis's residual."""
        logs = self.logs()
        possible = [
            key for key, hypothesis in self.refitted.items() if all(t.possible for t in hypothesis.fitted.terms)
        ]
        best = self.refitted[max(possible, key=logs.__getitem__)]
        law = short_evidence.likeliest_law(self.channel, best.evidence)
        alone = [self.refitted[(k,)].fitted.terms[0] for k in range(len(self.kinds)) if (k,) in self.refitted]
        slow = [short_evidence.place_columns(best.fitted, [term.at(0.0 * term.values)])[:, 0] for term in alone]
        logs = self.logs(short_evidence.cluster_inflation(best.fitted, law, slow))
        log_posterior = np.array([logs[key] for key in possible])
        probability = np.exp(log_posterior - log_posterior.max())
        prior = np.array([self.prior(key) for key in possible])
        return Posterior([kind.name for kind in self.kinds], possible, probability / probability.sum(), prior)

    def alone(self) -> dict[str, tuple[float, float]]:
        """Compute log evidence and visible size of each effect when added alone to the base, best first."""
        sizes: dict[str, tuple[float, float]] = {}
        logs = self.logs()
        for hypothesis in sorted(
            (hypothesis for hypothesis in self.refitted if len(hypothesis) == 1), key=logs.__getitem__, reverse=True
        ):
            score = logs[hypothesis] - self.prior(hypothesis) - logs[()]
            sizes.setdefault(
                self.kinds[hypothesis[0]].name, (score, short_fit.visible_size_deg(self.refitted[hypothesis].fitted, 0))
            )
        return sizes


def search_effects(channel: ShortComparison, options: Options) -> SearchResult:
    """Search for the terms that explain a comparison, each with its alternatives."""
    made = HypothesisSearch(channel, options.alarm)
    made.run()
    posterior = made.posterior()
    chosen = posterior.likeliest_of(posterior.count_of(finding.SURE))
    fitted = made.refitted[chosen].fitted
    finding_posteriors = tuple(posterior.finding_posteriors(chosen, instead=None))
    tested = score_tests(fitted, fitted, omnibus_groups(fitted), seed=99)
    remainder = omnibus.omnibus_test(tested, options.alarm, partial(group_size_deg, fitted), options.min_effect_deg)
    return SearchResult(made.refitted[()].fitted, fitted, posterior, finding_posteriors, made.alone(), remainder)


def _refine_places(fitted: FittedHypothesis) -> FittedHypothesis:
    """Refine the place of the last term on a finer grid around it."""
    term = fitted.terms[-1]
    near = [candidate.at(term.values) for candidate in short_evidence.candidate_places(fitted, type(term), near=term)]
    residuals = [fitted.channel.residual(fitted.base, (*fitted.terms[:-1], candidate)) for candidate in near]
    clip = finding.MOST_WIDTHS * fitted.scale_deg
    squares = [float(np.sum(np.minimum(np.abs(residual), clip) ** 2)) for residual in residuals]
    if not squares or min(squares) >= fitted.square:
        return fitted
    better = near[int(np.argmin(squares))]
    return short_fit.fit_hypothesis(fitted.channel, (*fitted.terms[:-1], better), near=fitted)


def build_outcome(named: SearchResult) -> Outcome:
    """Collect the outcome of the search of one comparison."""
    fitted, channel = named.fitted, named.fitted.channel
    named_terms = [k for k, term in enumerate(fitted.terms) if not isinstance(term, LOCAL_OFFSETS)]
    covariance = short_fit.parameter_covariance(fitted) if named_terms else np.zeros((0, 0))
    findings = tuple(_finding(named, k, covariance) for k in named_terms)

    def curves(shown: Sequence[Finding], left: Unexplained | None) -> list[BinnedResidual]:
        wanted = {"heading", *(left.covariates if left else ())}
        wanted |= {item.where.covariate for item in shown if item.effect in {term.name for term in fitted.terms}}
        return [residual_curve(named.before, fitted, name) for name in channel.covariates if name in wanted]

    scatter = fitted.scale_deg, fitted.scale_deg / float(np.sqrt(2.0 * max(short_fit.effective_samples(fitted), 1.0)))
    acts = named.posterior.acting
    return Outcome(
        comparison=channel,
        posterior=named.posterior,
        findings=findings,
        finding_posteriors=tuple(named.finding_posteriors[k] for k in named_terms),
        left=_unexplained_mismatch(named, [item.effect for item in findings]),
        small=named.omnibus.small,
        curves=curves,
        noise={"white_deg": scatter},
        ranked=tuple(RankedEffect(effect, *item, acts[effect]) for effect, item in named.alone.items()),
        deniable=True,
    )


def _finding(named: SearchResult, k: int, covariance: Floats) -> Finding:
    fitted, channel = named.fitted, named.fitted.channel
    term, columns = fitted.terms[k], parameter_slices(fitted.terms, len(fitted.base))[k]
    sigma, parameters = np.sqrt(np.maximum(np.diag(covariance), 0.0))[columns], {}
    for j, name in enumerate(term.fitted()):
        factor, unit = channel.unit(term, j)
        plain = name if factor == 1.0 and unit == term.units()[j] else name.replace("_nT", "")
        parameters[plain] = Parameter(factor * float(term.values[j]), factor * float(sigma[j]), unit)
    shared: dict[str, float] = {}
    for effect, p in {
        named.finding_posteriors[k].effect: named.finding_posteriors[k].probability,
        **named.finding_posteriors[k].alternatives,
    }.items():
        alike = (effect, *channel.confused.get(effect, ()))
        for name in alike:
            shared[name] = shared.get(name, 0.0) + p / len(alike)
    return comparison.build_finding(
        channel,
        term,
        shared,
        parameters,
        size_deg=short_fit.visible_size_deg(fitted, k),
        proof=held_out(fitted, k),
        place=channel.outside(residual_curve(named.before, named.before, channel.main_covariate(term))),
        others=[other for j, other in enumerate(fitted.terms) if j != k],
    )


def held_out(fitted: FittedHypothesis, k: int) -> HeldOut:
    """Score a term on held-out stretches, with the other terms refitted with and without it."""
    other_terms = [term for j, term in enumerate(fitted.terms) if j != k]
    return _held_out_gain(fitted, fitted, other_terms)


def held_out_base(fitted: FittedHypothesis, part: slice) -> HeldOut:
    """Score some base parameters on held-out stretches, with all others refitted."""
    steps = fitted.channel.steps.copy()
    steps[part] = 0.0
    without = replace(fitted, channel=replace(fitted.channel, steps=steps), base=fitted.base * (steps > 0.0))
    return _held_out_gain(without, fitted, list(fitted.terms))


def _held_out_gain(less: FittedHypothesis, fitted: FittedHypothesis, terms: Sequence[Effect]) -> HeldOut:
    """Score a fit against one with fewer parameters on held-out stretches."""
    block = short_fit.memory_blocks(fitted)
    folds = min(finding.FOLDS, block.max() + 1) if not fitted.channel.independent else block.max() + 1
    before, after = held_out_residual(less, terms, block, folds), held_out_residual(fitted, fitted.terms, block, folds)
    return finding.compare_residuals(before, after, max(robust_width(before), short_fit.FINEST_DEG), block)


def held_out_residual(fitted: FittedHypothesis, terms: Sequence[Effect], block: NDArray[np.intp], folds: int) -> Floats:
    """Compute the residual of each stretch from a fit to the other folds, (n,) degrees.

    Args:
        fitted: starting point of the fits.
        terms: terms fitted jointly with the base.
        block: number of the stretch of each sample, (n,).
        folds: number of folds, to which stretches are assigned in turn.
    """
    left = np.empty(len(fitted.channel))
    for fold in range(folds):
        out = block % folds == fold
        left[out] = short_fit.fit_hypothesis(fitted.channel, terms, near=fitted, use=~out).residual_deg[out]
    return left


def _unexplained_mismatch(named: SearchResult, listed: Sequence[str]) -> Unexplained | None:
    """Describe a significant mismatch without a known cause: a local offset or a mean residual."""
    fitted, channel, remainder = named.fitted, named.fitted.channel, named.omnibus
    local = [
        (short_fit.visible_size_deg(fitted, k), k)
        for k, term in enumerate(fitted.terms)
        if isinstance(term, LOCAL_OFFSETS)
    ]
    size, k = max(local, default=(0.0, 0))
    if local and size >= remainder.min_effect_deg:
        base = short_fit.fit_hypothesis(channel, [other for j, other in enumerate(fitted.terms) if j != k], near=fitted)
        place = _covered_range(channel, fitted.terms[k])
        return channel.unexplained([residual_curve(base, base, place.covariate)], size, listed, place)
    if not remainder.above_min_effect:
        return None
    group, size = remainder.above_min_effect[0]
    return channel.unexplained([residual_curve(fitted, fitted, name) for name in group.covariates], size, listed)


def _covered_range(channel: ShortComparison, term: Effect) -> CovariateRange:
    """Describe the covariate range that a local offset covers; a heading range may cross north."""
    assert isinstance(term, LOCAL_OFFSETS)
    name = next(name for name in term.along if name in channel.covariates)
    share = term.share(channel.covariates[name])
    inside = channel.covariates[name][share > np.max(share) / 2.0]
    low, high = float(inside.min()), float(inside.max())
    if name == "heading":
        away = angles.difference(inside, angles.mean(inside))
        low, high = (float(angles.wrap360(angles.mean(inside) + end)) for end in (away.min(), away.max()))
    return channel.where(name, (low, high))


def residual_curve(before: FittedHypothesis, after: FittedHypothesis, name: str) -> BinnedResidual:
    """Bin the residual along a covariate, with and without terms, with the standard error of each bin."""
    column = before.channel.covariates[name]
    count = int(np.clip(len(column) // 4, 4, finding.CURVE_BINS))
    edges = np.unique(np.quantile(column, np.linspace(0.0, 1.0, count + 1)))
    if name == "heading":
        edges = np.linspace(0.0, 360.0, min(2 * finding.CURVE_BINS, 2 * count) + 1)
    bins = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, len(edges) - 2)
    there = np.bincount(bins, minlength=len(edges) - 1)
    least = 1 if before.channel.independent or before.channel.arma_noise else FEWEST_IN_BIN
    held = np.flatnonzero(there >= least)
    centre = np.bincount(bins, column, len(edges) - 1)[held] / there[held]
    left = (before.clipped if before is after else before.residual_deg, after.clipped)
    means = [np.bincount(bins, side, len(edges) - 1)[held] / there[held] for side in left]
    return BinnedResidual(name, centre, means[0], means[1], _bin_sigma(after, bins, held, there), after.channel.what)


def _bin_sigma(
    after: FittedHypothesis, bins: NDArray[np.intp], held: NDArray[np.intp], there: NDArray[np.intp]
) -> Floats:
    """Estimate the standard error of each bin's mean, (bins,); the samples of one time block count as one."""
    scatter = float(np.std(after.clipped))
    if after.channel.independent:
        return scatter / np.sqrt(there[held])
    if after.channel.arma_noise:
        weights = (bins[:, None] == held) / there[held]
        return arma_standard_errors(after.clipped, after.columns, weights)
    block = short_fit.memory_blocks(after)
    apart = np.array([len(np.unique(block[bins == b])) for b in held])
    within = []  # cluster-robust standard errors of the means, by block
    for x, of_block in ((after.clipped[bins == b], block[bins == b]) for b in held):
        within.append(float(np.linalg.norm(np.bincount(of_block, x - x.mean()))) / len(x))
    return np.maximum(np.array(within), scatter / np.sqrt(there[held])) / np.where(apart < 2, 0.5, 1.0)
