"""Findings of short recordings: scores on held-out stretches, curves of the residual, mismatches without a cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from compasslib import angles
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference import finding, short_fit
from compasslib.inference.comparison import build_finding
from compasslib.inference.diagnosis import Outcome
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.inference.short_fit import FittedHypothesis
from compasslib.inference.short_search import ShortInference
from compasslib.statistics.least_squares import robust_width
from compasslib.types import Floats


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
        posterior=inferred,
        findings=findings,
        finding_posteriors=tuple(inferred.probabilities(k) for k in listed),
        left=left,
        small=tuple((_along(fitted, k), sizes[k]) for k in unlisted if sizes[k] < min_effect_deg),
        curves=curves,
        noise={"white_deg": (fitted.scale_deg, scatter)},
        ranked=inferred.alone,
        detection=inferred.detection,
        deniable=True,
    )


def _finding(
    inferred: ShortInference, k: int, covariance: Floats, sizes: Sequence[float], min_effect_deg: float
) -> Finding:
    fitted, comparison, slot = inferred.fitted, inferred.fitted.comparison, inferred.probabilities(k)
    term, columns = fitted.terms[k], parameter_slices(fitted.terms, len(fitted.base))[k]
    sigma, parameters = np.sqrt(np.maximum(np.diag(covariance), 0.0))[columns], {}
    for j, name in enumerate(term.fitted()):
        factor, unit = comparison.unit(term, j)
        shown = name if unit == term.units()[j] else name.replace("_nT", "")
        parameters[shown] = Parameter(factor * float(term.values[j]), factor * float(sigma[j]), unit)
    shared: dict[str, float] = {}
    for effect, p in {slot.effect: slot.probability, **slot.alternatives}.items():
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
        others=[other for j, other in enumerate(fitted.terms) if j != k and sizes[j] >= min_effect_deg],
    )


def _unexplained(fitted: FittedHypothesis, k: int, size_deg: float, listed: Sequence[str]) -> Unexplained:
    """Describe the mismatch of a composed term, which no listed effect explains; a heading range may cross north."""
    comparison, name, term = fitted.comparison, _along(fitted, k), fitted.terms[k]
    assert isinstance(term, ComposedEffect)
    base = short_fit.fit_hypothesis(comparison, fitted.terms[:k] + fitted.terms[k + 1 :], near=fitted)
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
    """Score a fit on held-out stretches against one with other terms or another base.

    Args:
        error: of each reading by a fit, (n,) degrees; by default its residual.
    """
    block, left = fitted.blocks, []
    folds = block.max() + 1 if fitted.comparison.independent else min(finding.FOLDS, block.max() + 1)
    for near, free in ((less, terms), (fitted, fitted.terms)):
        residual = np.empty(len(block))
        for out in (block % folds == fold for fold in range(folds)):
            residual[out] = error(short_fit.fit_hypothesis(near.comparison, free, near=near, use=~out))[out]
        left.append(residual)
    return finding.compare_residuals(left[0], left[1], max(robust_width(left[0]), short_fit.FINEST_DEG), block)


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
