"""What the search of a short recording tells: findings, what has no name, and what held-out readings say of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.term import Term, slices
from compasslib.inference import findings, show
from compasslib.inference.comparison import Outcome
from compasslib.inference.finding import Finding, Parameter, Ranked, Unexplained, Where
from compasslib.inference.posterior import Slot
from compasslib.inference.short_record import fitting
from compasslib.inference.short_record.channel import Channel
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.inference.short_record.local import LOCAL
from compasslib.inference.short_record.search import NamedEffects
from compasslib.inference.show import BinnedResidual, HeldOut
from compasslib.statistics import arma, robust
from compasslib.types import Floats

FEWEST_IN_BIN = 5  # of a figure's curve


def of(named: NamedEffects) -> Outcome:
    """Return what the search of one comparison tells."""
    fitted, channel = named.fitted, named.fitted.channel
    own = [k for k, term in enumerate(fitted.terms) if not isinstance(term, LOCAL)]
    covariance = fitting.covariance(fitted) if own else np.zeros((0, 0))
    every = tuple(_finding(named, k, covariance) for k in own)

    def curves(found: Sequence[Finding], left: Unexplained | None) -> list[BinnedResidual]:
        wanted = {"heading", *(left.covariates if left else ())}
        wanted |= {one.where.covariate for one in found if one.effect in {term.name for term in fitted.terms}}
        return [curve(named.before, fitted, name) for name in channel.covariates if name in wanted]

    scatter = fitted.scale_deg, fitted.scale_deg / float(np.sqrt(2.0 * max(fitting.effective(fitted), 1.0)))
    acts = named.found.acting
    return Outcome(
        comparison=channel,
        posterior=named.found,
        findings=every,
        slots=tuple(named.slots[k] for k in own),
        left=_unexplained(named, [one.effect for one in every]),
        small=named.rest.small,
        curves=curves,
        noise={"white_deg": scatter},
        tried=tuple(Ranked(effect, *one, acts[effect]) for effect, one in named.alone.items()),
        deniable=True,
    )


def _finding(named: NamedEffects, k: int, covariance: Floats) -> Finding:
    fitted, channel = named.fitted, named.fitted.channel
    term = fitted.terms[k]
    return findings.of_term(
        channel,
        term,
        _chances(named.slots[k], channel),
        _parameters(fitted, k, covariance),
        size_deg=fitting.effect_deg(fitted, k),
        proof=held_out(fitted, k),
        place=channel.outside(curve(named.before, named.before, channel.lives(term))),
    )


def _chances(slot: Slot, channel: Channel) -> dict[str, float]:
    """Return the probability of an effect and of what else it could be; what looks the same here has equal shares."""
    shared: dict[str, float] = {}
    for effect, p in {slot.effect: slot.probability, **slot.alternatives}.items():
        alike = (effect, *channel.confused.get(effect, ()))
        for name in alike:
            shared[name] = shared.get(name, 0.0) + p / len(alike)
    return shared


def _parameters(fitted: FittedTerms, k: int, covariance: Floats) -> dict[str, Parameter]:
    own = slices(fitted.terms, len(fitted.base))[k]
    sigma, term = np.sqrt(np.maximum(np.diag(covariance), 0.0))[own], fitted.terms[k]
    found = {}
    for j, name in enumerate(term.fitted()):
        factor, unit = fitted.channel.unit(term, j)
        plain = name if factor == 1.0 and unit == term.units()[j] else name.replace("_nT", "")
        found[plain] = Parameter(factor * float(term.values[j]), factor * float(sigma[j]), unit)
    return found


def held_out(fitted: FittedTerms, k: int) -> HeldOut:
    """Return what a term adds on stretches that were not fitted, the others refitted with and without it."""
    rest = [term for j, term in enumerate(fitted.terms) if j != k]
    return _compared(fitted, fitted, rest)


def held_out_base(fitted: FittedTerms, part: slice) -> HeldOut:
    """Return what some of the base parameters add on stretches that were not fitted, all others refitted."""
    steps = fitted.channel.steps.copy()
    steps[part] = 0.0
    without = replace(fitted, channel=replace(fitted.channel, steps=steps), base=fitted.base * (steps > 0.0))
    return _compared(without, fitted, list(fitted.terms))


def _compared(less: FittedTerms, fitted: FittedTerms, terms: Sequence[Term]) -> HeldOut:
    """Return the gain of a fit over one with fewer parameters on held-out stretches."""
    block = fitting.stretches(fitted)
    folds = min(show.FOLDS, block.max() + 1) if not fitted.channel.independent else block.max() + 1
    before, after = left_out(less, terms, block, folds), left_out(fitted, fitted.terms, block, folds)
    return show.improved(before, after, max(robust.width(before), fitting.FINEST_DEG), block)


def left_out(fitted: FittedTerms, terms: Sequence[Term], block: NDArray[np.intp], folds: int) -> Floats:
    """Return the residual of each stretch by a fit to the others, (n,) degrees.

    Args:
        fitted: to start from.
        terms: what is fitted beside the base.
        block: number of the stretch, (n,).
        folds: so many stretches after another are in different folds.
    """
    left = np.empty(len(fitted.channel))
    for fold in range(folds):
        out = block % folds == fold
        left[out] = fitting.fit(fitted.channel, terms, near=fitted, use=~out).residual_deg[out]
    return left


def _unexplained(named: NamedEffects, listed: Sequence[str]) -> Unexplained | None:
    """Return what stays proven and without a name: an error at a few headings or for a while, or a mean residual.

    Args:
        listed: effects that stand beside it.
    """
    fitted, channel, rest = named.fitted, named.fitted.channel, named.rest
    local = [(fitting.effect_deg(fitted, k), k) for k, term in enumerate(fitted.terms) if isinstance(term, LOCAL)]
    size, k = max(local, default=(0.0, 0))
    if local and size >= rest.min_effect_deg:
        bare = fitting.fit(channel, [other for j, other in enumerate(fitted.terms) if j != k], near=fitted)
        place = _covered(channel, fitted.terms[k])
        return channel.unexplained([curve(bare, bare, place.covariate)], size, listed, place)
    if not rest.worth:
        return None
    group, size = rest.worth[0]
    return channel.unexplained([curve(fitted, fitted, name) for name in group.covariates], size, listed)


def _covered(channel: Channel, term: Term) -> Where:
    """Return the range of a covariate that a local error covers; one of headings may go through north."""
    assert isinstance(term, LOCAL)
    name = next(name for name in term.along if name in channel.covariates)
    share = term.share(channel.covariates[name])
    inside = channel.covariates[name][share > np.max(share) / 2.0]
    low, high = float(inside.min()), float(inside.max())
    if name == "heading":
        away = angles.difference(inside, angles.mean(inside))
        low, high = (float(angles.wrap360(angles.mean(inside) + end)) for end in (away.min(), away.max()))
    return channel.where(name, (low, high))


def curve(before: FittedTerms, after: FittedTerms, name: str) -> BinnedResidual:
    """Return the residual in bins of a covariate, with and without terms, and the standard error of each bin."""
    column = before.channel.covariates[name]
    count = int(np.clip(len(column) // 4, 4, show.BINS))
    edges = np.unique(np.quantile(column, np.linspace(0.0, 1.0, count + 1)))
    if name == "heading":
        edges = np.linspace(0.0, 360.0, min(2 * show.BINS, 2 * count) + 1)
    bins = np.clip(np.searchsorted(edges, column, side="right") - 1, 0, len(edges) - 2)
    there = np.bincount(bins, minlength=len(edges) - 1)
    least = 1 if before.channel.independent or before.channel.remembered else FEWEST_IN_BIN
    held = np.flatnonzero(there >= least)
    centre = np.bincount(bins, column, len(edges) - 1)[held] / there[held]
    left = (before.clipped if before is after else before.residual_deg, after.clipped)
    means = [np.bincount(bins, one, len(edges) - 1)[held] / there[held] for one in left]
    return BinnedResidual(name, centre, means[0], means[1], _bin_sigma(after, bins, held, there), after.channel.what)


def _bin_sigma(after: FittedTerms, bins: NDArray[np.intp], held: NDArray[np.intp], there: NDArray[np.intp]) -> Floats:
    """Return the standard error of a bin's mean: samples of one stretch of time in it count once."""
    scatter = float(np.std(after.clipped))
    if after.channel.independent:
        return scatter / np.sqrt(there[held])
    if after.channel.remembered:
        weights = (bins[:, None] == held) / there[held]
        return arma.standard_errors(after.clipped, after.columns, weights)
    block = fitting.stretches(after)
    apart = np.array([len(np.unique(block[bins == b])) for b in held])
    within = [_between(after.clipped[bins == b], block[bins == b]) for b in held]
    return np.maximum(np.array(within), scatter / np.sqrt(there[held])) / np.where(apart < 2, 0.5, 1.0)


def _between(x: Floats, block: NDArray[np.intp]) -> float:
    """Return the standard error of a mean from the sums of the stretches."""
    sums = np.bincount(block, x - x.mean())
    return float(np.sqrt(np.sum(sums**2))) / len(x)
