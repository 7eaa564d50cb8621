"""Findings made of a search: where, when, how large, how sure, in numbers and in sentences."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib.core import angles
from compasslib.core.types import Floats
from compasslib.effects.term import Term, slices
from compasslib.search import show, verdict
from compasslib.search.posterior import Slot
from compasslib.search.recordings import fitting, search, wording
from compasslib.search.recordings.channel import Channel
from compasslib.search.recordings.fitting import FittedTerms
from compasslib.search.recordings.local import LOCAL
from compasslib.search.recordings.search import NamedEffects
from compasslib.search.show import BinnedResidual, HeldOut
from compasslib.search.verdict import Diagnosis, Finding, Parameter, Ranked, Unexplained, Where
from compasslib.stats import arma, robust

FEWEST_IN_BIN = 5  # of a figure's curve
OUTSIDE = 3.0  # standard errors by which a bin leaves the band


def findings(named: NamedEffects) -> list[Finding]:
    """Return one finding for each chosen term that has a name."""
    fitted = named.fitted
    if not fitted.terms:
        return []
    covariance = fitting.covariance(fitted)
    return [_finding(named, k, covariance) for k, term in enumerate(fitted.terms) if not isinstance(term, LOCAL)]


def _finding(named: NamedEffects, k: int, covariance: Floats) -> Finding:
    fitted, channel = named.fitted, named.fitted.channel
    term = fitted.terms[k]
    probability, others = _chances(named.slots[k], channel)
    parameters = _parameters(fitted, k, covariance)
    proof = held_out(fitted, k)
    place = where(channel, wording.along(term.name, channel.covariates), named.before)
    begin = term.date if term.dated() else float(channel.time_s[0])
    span = (begin, float(channel.time_s[-1])) if channel.clocked else None
    size = fitting.effect_deg(fitted, k)
    numbers = {name: (p.value, p.sigma, p.unit) for name, p in parameters.items()}
    if term.dated():
        place = since(channel, begin)
    text = wording.finding(
        term.name, tuple(others), where=place.text, parameters=numbers, size_deg=size, proof=proof, what=channel.what
    )
    return Finding(
        term.name, term.side, tuple(others), place, span, parameters, size, proof, text,
        probability=probability, alternatives_probability=others,
    )  # fmt: skip


def _chances(slot: Slot, channel: Channel) -> tuple[float, dict[str, float]]:
    """Return the probability of an effect and of what else it could be; what looks the same here has equal shares."""
    shared: dict[str, float] = {}
    for effect, p in {slot.effect: slot.probability, **slot.alternatives}.items():
        alike = (effect, *channel.confused.get(effect, ()))
        for name in alike:
            shared[name] = shared.get(name, 0.0) + p / len(alike)
    own = shared.pop(slot.effect)
    return own, shared


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


def unexplained(named: NamedEffects, min_effect_deg: float) -> tuple[Unexplained | None, tuple[tuple[str, float], ...]]:
    """Return what stays proven and without a name, and what is too small to matter.

    Args:
        min_effect_deg: visible size below which a mismatch does not matter.
    """
    local = _of_local(named, min_effect_deg)
    worth = [one for one in named.left if one[1] >= min_effect_deg]
    least = search.WORTH_SAYING * min_effect_deg
    small = {one.group.name: size for one, size in named.left}
    little = tuple((name, size) for name, size in small.items() if least < size < min_effect_deg)
    if local is not None or not worth:
        return local, little
    first, size = max(worth, key=lambda one: one[1])
    channel = named.fitted.channel
    places = [where(channel, name, named.fitted) for name in first.group.covariates]
    span = (float(channel.time_s[0]), float(channel.time_s[-1])) if channel.clocked else None
    curves = tuple(curve(named.fitted, named.fitted, name) for name in first.group.covariates)
    text = wording.unexplained(" and ".join(p.text for p in places), size, _listed(named))
    return Unexplained(first.group.covariates, places[0], span, size, curves, text), little


def _listed(named: NamedEffects) -> list[str]:
    return [term.name for term in named.fitted.terms if not isinstance(term, LOCAL)]


def _of_local(named: NamedEffects, min_effect_deg: float) -> Unexplained | None:
    """Return an error at a few headings or for a while only as what has no name, None where there is none."""
    fitted, channel = named.fitted, named.fitted.channel
    local = [(k, term) for k, term in enumerate(fitted.terms) if isinstance(term, LOCAL)]
    sizes = {k: fitting.effect_deg(fitted, k) for k, _ in local}
    if not local or max(sizes.values()) < min_effect_deg:
        return None
    k, term = max(local, key=lambda one: sizes[one[0]])
    name = next(name for name in term.along if name in channel.covariates)
    column = channel.covariates[name]
    place = _where_column_lives(channel, name, term.share(column))
    span = (float(channel.time_s[0]), float(channel.time_s[-1])) if channel.clocked else None
    span = (place.low, place.high) if channel.clocked and name == "time" else span
    bare = fitting.fit(channel, [other for j, other in enumerate(fitted.terms) if j != k], near=fitted)
    text = wording.unexplained(place.text, sizes[k], _listed(named))
    return Unexplained((name,), place, span, sizes[k], (curve(bare, bare, name),), text)


def where(channel: Channel, name: str, fitted: FittedTerms) -> Where:
    """Return the range of a covariate in which the binned residual leaves its band; all of it where no bin does.

    Args:
        fitted: whose residual is looked at.
    """
    column, shown = channel.covariates[name], curve(fitted, fitted, name)
    low, high = (float(x) for x in np.quantile(column, show.RANGE))
    far = np.abs(shown.before_deg) > OUTSIDE * shown.sigma_deg
    if far.any() and not far.all() and len(shown.centre) > 1:
        half = float(np.median(np.diff(shown.centre))) / 2.0
        low = max(float(shown.centre[far].min()) - half, float(column.min()))
        high = min(float(shown.centre[far].max()) + half, float(column.max()))
    return Where(name, low, high, wording.place(name, low, high, channel.clocked))


def _where_column_lives(channel: Channel, name: str, column: Floats) -> Where:
    """Return the range of a covariate that a local error covers; one of headings may go through north."""
    inside = channel.covariates[name][column > np.max(column) / 2.0]
    low, high = float(inside.min()), float(inside.max())
    if name == "heading":
        middle = angles.mean(inside)
        away = angles.difference(inside, middle)
        low, high = (float(angles.wrap360(middle + end)) for end in (away.min(), away.max()))
    return Where(name, low, high, wording.place(name, low, high, channel.clocked))


def since(channel: Channel, date_s: float) -> Where:
    """Return the time from a date on."""
    last = float(channel.time_s[-1])
    name = "time" if channel.clocked else "reading"
    if channel.clocked:
        return Where(name, date_s, last, f"from {verdict.stamp(date_s)} on")
    first = int(np.searchsorted(channel.time_s, date_s))
    return Where(name, float(channel.time_s[first]), last, f"from reading {channel.time_s[first]:.0f} on")


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


def diagnosis(
    parts: Sequence[NamedEffects],
    *,
    min_effect_deg: float,
    beside: Sequence[Finding] = (),
    not_testable: Sequence[tuple[str, str]] = (),
    separated_by: str | None = None,
) -> Diagnosis:
    """Return what all comparisons of a recording show together.

    Args:
        min_effect_deg: visible size below which a mismatch does not matter.
        beside: findings that were made apart from a search.
        separated_by: an observation that this kind of recording always lacks, said beside a finding.
    """
    every = [*beside, *(finding for part in parts for finding in findings(part))]
    stands = [one for one in every if not one.held_out.refuted and one.rms_effect_deg >= min_effect_deg]
    found = _once(stands)
    left = [unexplained(part, min_effect_deg) for part in parts]
    denied = [_unconfirmed(one) for one in every if one.held_out.refuted and one.rms_effect_deg >= min_effect_deg]
    open_ = max([*(one for one, _ in left if one), *denied], key=lambda one: one.rms_effect_deg, default=None)
    least = search.WORTH_SAYING * min_effect_deg
    small = {one.effect: one.rms_effect_deg for one in every if least < one.rms_effect_deg < min_effect_deg}
    small |= {k: v for _, more in left for k, v in more}
    phrases = [wording.separated_by(f.effect, f.alternatives) for f in found if f.alternatives]
    if separated_by and any(f.side == "compass" for f in found):
        phrases.append(separated_by)
    return Diagnosis(
        verdict=verdict.of(found, open_),
        findings=found,
        unexplained=open_,
        separated_by="; ".join(dict.fromkeys(phrases)) or None,
        not_testable=tuple(not_testable),
        negligible=tuple(small.items()),
        why=wording.why(found, open_, [part.fitted.channel.what for part in parts]),
        curves=_curves(parts, found, open_),
        hypotheses=_ranked(parts),
        sides=_sides(parts, _told(one for one in every if one not in stands) - _told(found)),
        noise=_noise(parts),
    )


def _unconfirmed(one: Finding) -> Unexplained:
    """Return a mismatch that is proven where it was fitted, and whose name held-out readings deny."""
    phrases = wording.unexplained(one.where.text, one.rms_effect_deg, [])
    return Unexplained((one.where.covariate,), one.where, one.when_s, one.rms_effect_deg, (), phrases)


def _ranked(parts: Sequence[NamedEffects]) -> tuple[Ranked, ...]:
    """Return every effect that was tried alone, the best first, each once."""
    best: dict[str, Ranked] = {}
    for part in parts:
        acts = part.found.acting
        for effect, (score, size) in part.alone.items():
            if effect not in best or best[effect].score < score:
                best[effect] = Ranked(effect, score, size, acts[effect])
    return tuple(sorted(best.values(), key=lambda one: -one.score))


def _told(some: Iterable[Finding]) -> set[str]:
    return {name for one in some for name in (one.effect, *one.alternatives)}


def _sides(parts: Sequence[NamedEffects], fallen: Collection[str]) -> dict[str, float]:
    """Return the probability of each side: of the comparison that shows most.

    Args:
        fallen: names that are no findings; they count as nothing.
    """
    return min((part.found.sides(fallen) for part in parts), key=lambda sides: sides["none"], default={})


def _noise(parts: Sequence[NamedEffects]) -> dict[str, tuple[float, float]]:
    """Return the scatter that is left in the first comparison, with its standard error."""
    widths = [(part.fitted.scale_deg, max(fitting.effective(part.fitted), 1.0)) for part in parts]
    return {"white_deg": (widths[0][0], widths[0][0] / float(np.sqrt(2.0 * widths[0][1])))} if widths else {}


def _once(every: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings, strongest first, each effect once: two comparisons may show the same."""
    kept: dict[str, Finding] = {}
    for one in sorted(every, key=lambda one: -one.rms_effect_deg):
        if one.effect not in kept:
            kept[one.effect] = one
        else:
            same = kept[one.effect]
            both = tuple(name for name in same.alternatives if name in one.alternatives)
            kept[one.effect] = replace(same, alternatives=both, text=f"{same.text} A second comparison shows it too.")
    return tuple(kept.values())


def _curves(
    parts: Sequence[NamedEffects], found: Sequence[Finding], left: Unexplained | None
) -> tuple[BinnedResidual, ...]:
    made = []
    for part in parts:
        own = {term.name for term in part.fitted.terms}
        wanted = {"heading", *(left.covariates if left else ())}
        wanted |= {one.where.covariate for one in found if one.effect in own}
        made += [curve(part.before, part.fitted, name) for name in part.fitted.channel.covariates if name in wanted]
    return tuple(made)
