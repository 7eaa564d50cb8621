"""Which terms a recording calls for: each refitted beside those already chosen, and all that come close."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.discrepancy import whitening
from compasslib.discrepancy.naming import MOST_TERMS
from compasslib.discrepancy.recordings import fitting, strangers, testing
from compasslib.discrepancy.recordings.channel import Channel, dated
from compasslib.discrepancy.recordings.fitting import Fitted
from compasslib.discrepancy.recordings.strangers import Family
from compasslib.discrepancy.recordings.testing import Group, Tested
from compasslib.discrepancy.rivals import CLOSE, DATE_CHARGE, PARAMETER_CHARGE

Floats = NDArray[np.floating]

WORTH_SAYING = 0.1  # of the size that matters: less is not even listed
FINER = 24  # dates around the best of those that were tried


@dataclass(frozen=True)
class Entry:
    """One term beside others: refitted, with how sure it is, how large, and its score."""

    fitted: Fitted  # the term is the last
    p_value: float
    score: float
    size_deg: float

    @property
    def name(self) -> str:
        """Return the effect's name."""
        return self.fitted.terms[-1].name

    @property
    def believable(self) -> bool:
        """Whether all terms are within the ranges that are believed of them."""
        return all(term.believable for term in self.fitted.terms)


@dataclass(frozen=True)
class Named:
    """The hypothesis that was chosen, and for each of its terms what comes close."""

    before: Fitted  # the base alone
    fitted: Fitted
    entries: tuple[Entry, ...] = ()  # each chosen term beside the others
    alternatives: tuple[tuple[str, ...], ...] = ()
    negligible: tuple[tuple[str, float], ...] = ()
    alone: tuple[Entry, ...] = ()  # every term beside the base alone
    left: tuple[tuple[Tested, float], ...] = ()  # omnibus groups that stay significant, with their visible sizes


def search(channel: Channel, *, alarm: float, min_effect_deg: float) -> Named:
    """Return the terms that the comparison calls for, one after the other, each held against all others in its place.

    Args:
        channel: the comparison.
        alarm: probability that noise alone gives a name, and that it gives an unexplained mismatch.
        min_effect_deg: visible size below which an effect does not matter.
    """
    before = now = fitting.fit(channel, ())
    small: dict[str, float] = {}
    alone: list[Entry] = []
    while len(now.terms) < MOST_TERMS:
        entries = contest(now, None)
        alone = alone or entries
        sure = [entry for entry in entries if entry.p_value < alarm / len(entries)]
        least = WORTH_SAYING * min_effect_deg
        small = {entry.name: entry.size_deg for entry in sure if least < entry.size_deg < min_effect_deg}
        worth = [entry for entry in sure if entry.size_deg >= min_effect_deg and entry.believable]
        if not worth:
            break
        now = _swapped(max(worth, key=lambda entry: entry.score).fitted)
    now, own, others = _held(now, min_effect_deg)
    found = {term.name for term in now.terms}
    little = tuple((k, v) for k, v in small.items() if k not in found)
    named = Named(before, now, own, others, little, tuple(alone), _left(now, alarm))
    for family in strangers.FAMILIES:
        named = _unmasked(named, family)
    return named


def _unmasked(named: Named, family: Family) -> Named:
    """Return the hypothesis without terms that imitate what is in no catalogue."""
    better = strangers.instead(named.fitted, family)
    if better is None:
        return named
    kept, stranger = better
    terms = [named.fitted.terms[k] for k in kept]
    free = fitting.fit(named.fitted.channel, terms, near=named.fitted)
    own, others = tuple(named.entries[k] for k in kept), tuple(named.alternatives[k] for k in kept)
    left = (*named.left, (stranger, _size(free, stranger)))
    return replace(named, fitted=free, entries=own, alternatives=others, left=left)


def contest(without: Fitted, noise: Fitted | None) -> list[Entry]:
    """Return every term that is not yet there, refitted beside a hypothesis.

    Args:
        without: the hypothesis.
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


def _refitted(without: Fitted, group: Group) -> Fitted:
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


def _square_at(fitted: Fitted, date_s: float) -> float:
    moved = (*fitted.terms[:-1], dated(fitted.terms[-1], date_s))
    residual = fitted.channel.residual(fitted.base, moved)
    return float(np.sum(np.minimum(np.abs(residual), fitting.CLIP * fitted.scale_deg) ** 2))


def _entry(without: Fitted, fitted: Fitted, tested: Tested, noise: Fitted) -> Entry:
    term, n = fitted.terms[-1], len(fitted.channel)
    squares = [testing.square(one, noise) for one in (without, fitted)]
    gained = n * np.log(max(squares[0], 1e-300) / max(squares[1], 1e-300)) / tested.inflation
    charge = PARAMETER_CHARGE * len(term.fitted()) + DATE_CHARGE * term.dated()
    by_chance = tested.inflation * len(term.fitted()) * fitted.square / n**2
    size = fitting.effect_deg(fitted, len(fitted.terms) - 1, by_chance)
    return Entry(fitted, tested.p_value, float(gained - charge), size)


def _swapped(now: Fitted) -> Fitted:
    """Return the hypothesis with each term but the last replaced where another does better in its place."""
    for k in range(len(now.terms) - 1):
        rest = [term for j, term in enumerate(now.terms) if j != k]
        entries = contest(fitting.fit(now.channel, rest, near=now), now)
        own = next((entry for entry in entries if type(entry.fitted.terms[-1]) is type(now.terms[k])), None)
        best = max((entry for entry in entries if entry.believable), key=lambda entry: entry.score, default=None)
        if own is not None and best is not None and best.score > own.score:
            return best.fitted
    return now


def _held(now: Fitted, min_effect_deg: float) -> tuple[Fitted, tuple[Entry, ...], tuple[tuple[str, ...], ...]]:
    """Return each chosen term beside the others with what could stand in its place; those that faded are let go."""
    own, others = [], []
    for k, term in enumerate(now.terms):
        rest = [other for j, other in enumerate(now.terms) if j != k]
        entries = contest(fitting.fit(now.channel, rest, near=now), now)
        mine = next(entry for entry in entries if type(entry.fitted.terms[-1]) is type(term))
        if mine.size_deg < min_effect_deg / 2.0:
            return _held(fitting.fit(now.channel, rest, near=now), min_effect_deg)
        own.append(mine)
        others.append(_close(entries, mine, now, min_effect_deg))
    return now, tuple(own), tuple(others)


def _close(entries: Sequence[Entry], mine: Entry, now: Fitted, min_effect_deg: float) -> tuple[str, ...]:
    """Return the effects that do as well in a term's place, the best first."""
    near = [
        entry
        for entry in entries
        if entry.name != mine.name
        and entry.believable
        and entry.score >= mine.score - CLOSE
        and entry.size_deg >= min_effect_deg / 2.0
    ]
    names = [entry.name for entry in sorted(near, key=lambda entry: -entry.score)]
    return tuple(dict.fromkeys((*names, *now.channel.confused.get(mine.name, ()))))


def _left(now: Fitted, alarm: float) -> tuple[tuple[Tested, float], ...]:
    """Return what the omnibus tests still find, the surest first."""
    tested = testing.test(now, now, testing.omnibus(now), seed=99)
    sure = sorted((one for one in tested if one.p_value < alarm / len(tested)), key=lambda one: one.p_value)
    return tuple((one, _size(now, one)) for one in sure)


def _size(now: Fitted, one: Tested) -> float:
    seen = testing.directions(one.group, whitening.orthonormal(now.columns))
    pull, n = seen.T @ now.clipped, len(now.channel)
    noise = one.inflation * seen.shape[1] * now.square / n
    return float(np.sqrt(max(float(pull @ pull) - noise, 0.0) / n))
