"""Findings of short recordings: scores on held-out stretches, curves of the residual, mismatches without a cause."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from compasslib import angles
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, parameter_slices
from compasslib.inference import comparison as comparisons
from compasslib.inference import finding, short_fit
from compasslib.inference.diagnosis import Outcome
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.inference.short_fit import FittedHypothesis
from compasslib.inference.short_search import ShortInference
from compasslib.statistics.least_squares import robust_width
from compasslib.types import Floats


def build_outcome(inferred: ShortInference, min_effect_deg: float) -> Outcome:
    """Collect the outcome of the search of one comparison."""
    fitted, comparison = inferred.fitted, inferred.fitted.comparison
    listed = [k for k, term in enumerate(fitted.terms) if not isinstance(term, ComposedEffect)]
    covariance = short_fit.parameter_covariance(fitted) if listed else np.zeros((0, 0))
    findings = tuple(_finding(inferred, k, covariance, min_effect_deg) for k in listed)
    left, small = _unlisted(inferred, [item.effect for item in findings], min_effect_deg)

    def curves(shown: Sequence[Finding], left: Unexplained | None) -> list[BinnedResidual]:
        wanted = {"heading", *(left.covariates if left else ())}
        wanted |= {item.where.covariate for item in shown if item.effect in {term.name for term in fitted.terms}}
        return [residual_curve(inferred.before, fitted, name) for name in comparison.covariates if name in wanted]

    scatter = fitted.scale_deg / float(np.sqrt(2.0 * max(short_fit.effective_samples(fitted), 1.0)))
    return Outcome(
        comparison=comparison,
        posterior=inferred,
        findings=findings,
        finding_posteriors=tuple(inferred.probabilities(k) for k in listed),
        left=left,
        small=small,
        curves=curves,
        noise={"white_deg": (fitted.scale_deg, scatter)},
        ranked=inferred.alone,
        detection=inferred.detection,
        deniable=True,
    )


def _finding(inferred: ShortInference, k: int, covariance: Floats, min_effect_deg: float) -> Finding:
    fitted, comparison, slot = inferred.fitted, inferred.fitted.comparison, inferred.probabilities(k)
    term, columns = fitted.terms[k], parameter_slices(fitted.terms, len(fitted.base))[k]
    sigma, parameters = np.sqrt(np.maximum(np.diag(covariance), 0.0))[columns], {}
    for j, name in enumerate(term.fitted()):
        factor, unit = comparison.unit(term, j)
        plain = name if factor == 1.0 and unit == term.units()[j] else name.replace("_nT", "")
        parameters[plain] = Parameter(factor * float(term.values[j]), factor * float(sigma[j]), unit)
    shared: dict[str, float] = {}
    for effect, p in {slot.effect: slot.probability, **slot.alternatives}.items():
        alike = (effect, *comparison.confused.get(effect, ()))
        for name in alike:
            shared[name] = shared.get(name, 0.0) + p / len(alike)
    before = inferred.before
    others = [j for j in range(len(fitted.terms)) if j != k and short_fit.visible_size_deg(fitted, j) >= min_effect_deg]
    return comparisons.build_finding(
        comparison,
        term,
        shared,
        parameters,
        size_deg=short_fit.visible_size_deg(fitted, k),
        proof=held_out(fitted, k),
        place=comparison.outside(residual_curve(before, before, comparison.main_covariate(term))),
        others=[fitted.terms[j] for j in others],
    )


def _unlisted(
    inferred: ShortInference, listed: Sequence[str], min_effect_deg: float
) -> tuple[Unexplained | None, tuple[tuple[str, float], ...]]:
    """Describe the largest mismatch that no listed effect explains, and list those that are negligible."""
    fitted, comparison = inferred.fitted, inferred.fitted.comparison
    unlisted = [(k, term) for k, term in enumerate(fitted.terms) if isinstance(term, ComposedEffect)]
    sizes = {k: short_fit.visible_size_deg(fitted, k) for k, _ in unlisted}
    small = tuple((_along(fitted, term), sizes[k]) for k, term in unlisted if sizes[k] < min_effect_deg)
    k, term = max(unlisted, key=lambda item: sizes[item[0]], default=(None, None))
    if k is None or term is None or sizes[k] < min_effect_deg:
        return None, small
    others = [other for j, other in enumerate(fitted.terms) if j != k]
    base = short_fit.fit_hypothesis(comparison, others, near=fitted)
    place = _covered_range(fitted, term) if term.composition[2] in ("bump", "box") else None
    curve = residual_curve(base, base, _along(fitted, term))
    return comparison.unexplained([curve], sizes[k], listed, place), small


def _along(fitted: FittedHypothesis, term: ComposedEffect) -> str:
    driver = term.composition[1]
    return driver if driver in fitted.comparison.covariates else "reading"


def _covered_range(fitted: FittedHypothesis, term: ComposedEffect) -> CovariateRange:
    """Describe the covariate range that a local offset covers; a heading range may cross north."""
    name, share = _along(fitted, term), fitted.comparison.series(term)[:, 0]
    inside = fitted.comparison.covariates[name][share > np.max(share) / 2.0]
    low, high = float(inside.min()), float(inside.max())
    if name == "heading":
        away = angles.difference(inside, angles.mean(inside))
        low, high = (float(angles.wrap360(angles.mean(inside) + end)) for end in (away.min(), away.max()))
    return fitted.comparison.where(name, (low, high))


def held_out(fitted: FittedHypothesis, k: int) -> HeldOut:
    """Score a term on held-out stretches, with the other terms refitted with and without it."""
    return held_out_gain(fitted, fitted, [term for j, term in enumerate(fitted.terms) if j != k])


def held_out_base(fitted: FittedHypothesis, part: slice) -> HeldOut:
    """Score some base parameters on held-out stretches, with all others refitted."""
    steps = fitted.comparison.steps.copy()
    steps[part] = 0.0
    without = replace(fitted, comparison=replace(fitted.comparison, steps=steps), base=fitted.base * (steps > 0.0))
    return held_out_gain(without, fitted, fitted.terms)


def held_out_gain(
    less: FittedHypothesis,
    fitted: FittedHypothesis,
    terms: Sequence[Effect],
    error: Callable[[FittedHypothesis], Floats] = lambda fitted: fitted.residual_deg,
) -> HeldOut:
    """Score a fit on held-out stretches against one with other terms or fewer parameters.

    Args:
        error: of each reading by a fit, (n,) degrees; by default its residual.
    """
    block, left = short_fit.memory_blocks(fitted), []
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
    share = short_fit.effective_samples(after) / len(column)
    sigma = float(np.std(after.clipped)) / np.sqrt(np.maximum(there[held] * share, 1.0))
    return BinnedResidual(name, centre, means[0], means[1], sigma, comparison.what)
