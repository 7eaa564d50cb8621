"""Which terms a recording calls for: each refitted beside those already chosen, and all that come close."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.core import angles
from compasslib.effects.reading import Octantal, Sextantal
from compasslib.effects.term import Term
from compasslib.search.posterior import MOST_TERMS
from compasslib.search.recordings import fitting, testing
from compasslib.search.recordings.channel import Channel, dated
from compasslib.search.recordings.fitting import FittedTerms
from compasslib.search.recordings.terms import Drift, IronDrift
from compasslib.search.recordings.testing import TestedColumns, TestedEffect
from compasslib.stats import whitening

WORTH_SAYING = 0.1  # of the size that matters: less is not even listed
FINER = 24  # dates around the best of those that were tried

PARAMETER_CHARGE, DATE_CHARGE = 5.0, 6.0  # of twice the log likelihood, for each parameter and each date
CLOSE = 10.0  # hypotheses within this many units of the best are not told apart


@dataclass(frozen=True)
class RefittedTerm:
    """One term beside others: refitted, with how sure it is, how large, and its score."""

    fitted: FittedTerms  # the term is the last
    p_value: float
    score: float
    size_deg: float

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.fitted.terms[-1].name

    @property
    def plausible(self) -> bool:
        """Whether all terms are within their plausible ranges."""
        return all(term.plausible for term in self.fitted.terms)


@dataclass(frozen=True)
class NamedEffects:
    """The hypothesis that was chosen, and for each of its terms what comes close."""

    before: FittedTerms  # the base alone
    fitted: FittedTerms
    entries: tuple[RefittedTerm, ...] = ()  # each chosen term beside the others
    alternatives: tuple[tuple[str, ...], ...] = ()
    negligible: tuple[tuple[str, float], ...] = ()
    alone: tuple[RefittedTerm, ...] = ()  # every term beside the base alone
    left: tuple[tuple[TestedEffect, float], ...] = ()  # omnibus groups that stay significant, with their visible sizes


def search(channel: Channel, *, alarm: float, min_effect_deg: float) -> NamedEffects:
    """Return the terms that the comparison calls for, one after the other, each held against all others in its place.

    Args:
        alarm: probability that noise alone gives a name, and that it gives an unexplained mismatch.
    """
    before = now = fitting.fit(channel, ())
    small: dict[str, float] = {}
    alone: list[RefittedTerm] = []
    while len(now.terms) < MOST_TERMS:
        entries = contest(now, None)
        alone = alone or entries
        sure = [entry for entry in entries if entry.p_value < alarm / len(entries)]
        least = WORTH_SAYING * min_effect_deg
        small = {entry.name: entry.size_deg for entry in sure if least < entry.size_deg < min_effect_deg}
        worth = [entry for entry in sure if entry.size_deg >= min_effect_deg and entry.plausible]
        if not worth:
            break
        now = _swapped(max(worth, key=lambda entry: entry.score).fitted)
    now, own, others = _beside_others(now, min_effect_deg)
    found = {term.name for term in now.terms}
    little = tuple((k, v) for k, v in small.items() if k not in found)
    named = NamedEffects(before, now, own, others, little, tuple(alone), _left(now, alarm))
    for family in FAMILIES:
        named = _unmasked(named, family)
    return named


def _unmasked(named: NamedEffects, family: Family) -> NamedEffects:
    """Return the hypothesis without terms that imitate what is in no catalogue."""
    better = instead(named.fitted, family)
    if better is None:
        return named
    kept, empirical = better
    terms = [named.fitted.terms[k] for k in kept]
    free = fitting.fit(named.fitted.channel, terms, near=named.fitted)
    own, others = tuple(named.entries[k] for k in kept), tuple(named.alternatives[k] for k in kept)
    left = (*named.left, (empirical, _size(free, empirical)))
    return replace(named, fitted=free, entries=own, alternatives=others, left=left)


def contest(without: FittedTerms, noise: FittedTerms | None) -> list[RefittedTerm]:
    """Return every term that is not yet there, refitted beside a hypothesis.

    Args:
        noise: whose residual counts as noise; that of the best entry where None.
    """
    taken = {term.name for term in without.terms}
    kinds = [kind for kind in without.channel.terms if kind.name not in taken]
    groups = testing.of_terms(without, kinds)
    first = testing.test(without, noise or without, groups)
    fits = {one.group.name: _refitted(without, one.group) for one in first}
    if noise is None and fits:
        noise = min(fits.values(), key=lambda fitted: fitted.square)
        first = testing.test(without, noise, groups)
    return [_entry(without, fits[one.group.name], one, noise or without) for one in first]


def _refitted(without: FittedTerms, group: TestedColumns) -> FittedTerms:
    term = group.term
    assert term is not None
    values = [term.values] + [np.append(first, term.values[1:]) for first in without.channel.starts.get(term.name, ())]
    tried = [fitting.fit(without.channel, (*without.terms, term.at(value)), near=without) for value in values]
    fitted = min(tried, key=lambda one: one.square)
    if not term.dated():
        return fitted
    channel, at = without.channel, term.date
    reach = float(np.ptp(channel.time_s)) / testing.DATES
    inside = np.flatnonzero(np.abs(channel.time_s - at) <= reach)
    inside = inside[(inside > 0) & (inside < len(channel) - 1)]
    some = inside[np.unique(np.linspace(0, len(inside) - 1, FINER).astype(int))] if len(inside) else inside
    tries = [float((channel.time_s[k - 1] + channel.time_s[k]) / 2.0) for k in some]
    squares = [_square_at(fitted, date) for date in tries]
    if not squares or min(squares) >= fitted.square:
        return fitted
    better = dated(fitted.terms[-1], tries[int(np.argmin(squares))])
    return fitting.fit(channel, (*fitted.terms[:-1], better), near=fitted)


def _square_at(fitted: FittedTerms, date_s: float) -> float:
    moved = (*fitted.terms[:-1], dated(fitted.terms[-1], date_s))
    residual = fitted.channel.residual(fitted.base, moved)
    return float(np.sum(np.minimum(np.abs(residual), fitting.CLIP * fitted.scale_deg) ** 2))


def _entry(without: FittedTerms, fitted: FittedTerms, tested: TestedEffect, noise: FittedTerms) -> RefittedTerm:
    term, n = fitted.terms[-1], len(fitted.channel)
    squares = [testing.square(one, noise) for one in (without, fitted)]
    gained = n * np.log(max(squares[0], 1e-300) / max(squares[1], 1e-300)) / tested.inflation
    charge = PARAMETER_CHARGE * len(term.fitted()) + DATE_CHARGE * term.dated()
    by_chance = tested.inflation * len(term.fitted()) * fitted.square / n**2
    size = fitting.effect_deg(fitted, len(fitted.terms) - 1, by_chance)
    return RefittedTerm(fitted, tested.p_value, float(gained - charge), size)


def _swapped(now: FittedTerms) -> FittedTerms:
    """Return the hypothesis with each term but the last replaced where another does better in its place."""
    for k in range(len(now.terms) - 1):
        rest = [term for j, term in enumerate(now.terms) if j != k]
        entries = contest(fitting.fit(now.channel, rest, near=now), now)
        own = next((entry for entry in entries if type(entry.fitted.terms[-1]) is type(now.terms[k])), None)
        best = max((entry for entry in entries if entry.plausible), key=lambda entry: entry.score, default=None)
        if own is not None and best is not None and best.score > own.score:
            return best.fitted
    return now


def _beside_others(
    now: FittedTerms, min_effect_deg: float
) -> tuple[FittedTerms, tuple[RefittedTerm, ...], tuple[tuple[str, ...], ...]]:
    """Return each chosen term beside the others with what could stand in its place; those that faded are let go."""
    own, others = [], []
    for k, term in enumerate(now.terms):
        rest = [other for j, other in enumerate(now.terms) if j != k]
        entries = contest(fitting.fit(now.channel, rest, near=now), now)
        mine = next(entry for entry in entries if type(entry.fitted.terms[-1]) is type(term))
        if mine.size_deg < min_effect_deg / 2.0:
            return _beside_others(fitting.fit(now.channel, rest, near=now), min_effect_deg)
        own.append(mine)
        others.append(_close(entries, mine, now, min_effect_deg))
    return now, tuple(own), tuple(others)


def _close(
    entries: Sequence[RefittedTerm], mine: RefittedTerm, now: FittedTerms, min_effect_deg: float
) -> tuple[str, ...]:
    """Return the effects that do as well in a term's place, the best first."""
    near = [
        entry
        for entry in entries
        if entry.name != mine.name
        and entry.plausible
        and entry.score >= mine.score - CLOSE
        and entry.size_deg >= min_effect_deg / 2.0
    ]
    names = [entry.name for entry in sorted(near, key=lambda entry: -entry.score)]
    return tuple(dict.fromkeys((*names, *now.channel.confused.get(mine.name, ()))))


def _left(now: FittedTerms, alarm: float) -> tuple[tuple[TestedEffect, float], ...]:
    """Return what the omnibus tests still find, the surest first."""
    tested = testing.test(now, now, testing.omnibus(now), seed=99)
    sure = sorted((one for one in tested if one.p_value < alarm / len(tested)), key=lambda one: one.p_value)
    return tuple((one, _size(now, one)) for one in sure)


def _size(now: FittedTerms, one: TestedEffect) -> float:
    seen = testing.directions(one.group, whitening.orthonormal(now.columns))
    pull, n = seen.T @ now.clipped, len(now.channel)
    noise = one.inflation * seen.shape[1] * now.square / n
    return float(np.sqrt(max(float(pull @ pull) - noise, 0.0) / n))


# What no term of the catalogue is and some of them imitate: an error at a few headings only, or for a while only.
#
# A card that is pulled in one sector looks like lobes, a while astray like a slip. Where such an error explains more
# than the terms that stand for it, these lose their names and it stays unexplained. Nothing goes astray and comes back
# by as much of itself, and no iron acts on one sector alone.

PLACES, REACHES_DEG = 36, (15.0, 25.0, 40.0)  # where an error at a few headings is tried, and how far it reaches
FEWEST = 3  # samples in it
MOST_DATES = 200  # begins and ends of a while
FAINT = 1e-6  # of the largest column: less is rounding
CHARGE = PARAMETER_CHARGE + 2.0 * DATE_CHARGE  # one size, two places


@dataclass(frozen=True)
class Family:
    """Terms that imitate, and what they imitate."""

    imitates: Callable[[Term], bool]
    empirical: Callable[
        [FittedTerms, FittedTerms], list[TestedColumns]
    ]  # where these terms are left out; by whose residual as noise


def instead(fitted: FittedTerms, family: Family) -> tuple[list[int], TestedEffect] | None:
    """Return which terms stay, and what explains more than the others did; None where nothing does."""
    own = [term for term in fitted.terms if family.imitates(term)]
    if not own:
        return None
    kept = [k for k, term in enumerate(fitted.terms) if not family.imitates(term)]
    free = fitting.fit(fitted.channel, [fitted.terms[k] for k in kept], near=fitted)
    groups = family.empirical(free, fitted)
    if not groups:
        return None
    named = np.concatenate([testing.columns(free, term.at(0.0 * term.values)) for term in own], axis=1)
    scores = {
        one.group.name: one for one in testing.test(free, fitted, [TestedColumns("named", named, own[0]), *groups])
    }
    empirical = scores.get(groups[0].name)
    charged = sum(PARAMETER_CHARGE * len(term.fitted()) + DATE_CHARGE * term.dated() for term in own)
    if empirical is None or empirical.gain - CHARGE <= scores["named"].gain - charged:
        return None
    return kept, empirical


def _sectors(free: FittedTerms, _: FittedTerms) -> list[TestedColumns]:
    """Return errors at a few headings."""
    heading = free.channel.covariates.get("heading")
    if heading is None:
        return []
    away = np.abs(angles.difference(heading[:, None], 360.0 / PLACES * np.arange(PLACES)))
    hats = [np.where(away < reach, 1.0 + np.cos(np.pi * away / reach), 0.0) / 2.0 for reach in REACHES_DEG]
    columns = np.concatenate(hats, axis=1)
    return [
        TestedColumns("heading", c[:, None], None, ("heading",)) for c in columns.T if np.count_nonzero(c) >= FEWEST
    ]


def _whiles(free: FittedTerms, noise: FittedTerms) -> list[TestedColumns]:
    """Return the offset with a begin and an end that gains most; its dates must be right to the sample."""
    n, name = len(free.channel), "time" if "time" in free.channel.covariates else "reading"
    if name not in free.channel.covariates or n < 2 * FEWEST:
        return []
    at = np.unique(np.linspace(1, n - 1, min(n - 1, MOST_DATES)).astype(int))
    begin, end = np.triu_indices(len(at), k=1)
    white = noise.whitener if free.channel.remembered else np.eye(n)
    steps = (np.arange(n)[:, None] >= at).astype(float)
    base = whitening.orthonormal(white @ free.columns)
    left = white @ steps - base @ (base.T @ (white @ steps))
    pull, gram = left.T @ (white @ free.clipped), left.T @ left
    power = gram[begin, begin] + gram[end, end] - 2.0 * gram[begin, end]
    long = (at[end] - at[begin] >= FEWEST) & (power > FAINT * power.max())
    best = int(np.argmax(np.where(long, (pull[begin] - pull[end]) ** 2 / np.maximum(power, 1e-300), -1.0)))
    return [TestedColumns(name, steps[:, [begin[best]]] - steps[:, [end[best]]], None, (name,))]


FAMILIES = (
    Family(lambda term: isinstance(term, Sextantal | Octantal), _sectors),
    Family(lambda term: term.dated() or isinstance(term, Drift | IronDrift), _whiles),
)
