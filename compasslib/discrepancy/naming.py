"""Which of the catalogue's terms: hypotheses of one, two or three, compared on one scale, and all that come close.

Scores are those of the whitened residual (twice the log-likelihood gained) minus a charge for each parameter and each
date that was searched for. A hypothesis grows only while a further term is significant against the record's own noise
and large enough to matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from compasslib.discrepancy import baseline, columns, model, scan
from compasslib.discrepancy.baseline import State
from compasslib.discrepancy.columns import Group
from compasslib.discrepancy.scan import Tested
from compasslib.discrepancy.whitening import inverse
from compasslib.physics import CATALOGUE, Term

Floats = NDArray[np.floating]
Hypothesis = tuple[int, ...]

MOST_TERMS = 3
PARAMETER_CHARGE, DATE_CHARGE = 5.0, 6.0
CLOSE = 10.0  # hypotheses within this many units of the best are not told apart
LOST = 0.7  # share of the least size below which a refitted term has lost its effect
FAR_DEG = 2.5  # visible size above which the columns are taken anew where the simulation stands
TRIES = 4  # hypotheses that are refitted before none is believed
WATER_FREELY = "current_veer"  # the only effect that may come in several forms at once


@dataclass(frozen=True)
class Named:
    """The hypothesis that was chosen, and what comes close."""

    state: State  # with the chosen terms refitted
    alternatives: tuple[tuple[str, ...], ...] = ()  # for each chosen term
    tested: Tested | None = None  # what was tested beside the chosen terms last
    threshold: float = np.inf
    negligible: tuple[tuple[str, float], ...] = ()  # significant effects too small to matter, with visible degrees
    best_score: float = field(default=0.0)


@dataclass(frozen=True)
class Field:
    """All candidates on one scale: their whitened columns' products with each other and with the residual."""

    groups: list[Group]
    parts: list[slice]
    gram: Floats
    pull: Floats
    visible: Floats  # products of the visible columns, square degrees
    state: State
    inflation: float

    def score(self, members: Hypothesis) -> float:
        """Return the charged score of a hypothesis."""
        _, gain = self._solved(members)
        return gain / self.inflation - sum(charge(self.groups[k]) for k in members)

    def terms(self, members: Hypothesis) -> list[Term]:
        """Return the terms of a hypothesis at their linear estimates."""
        values, _ = self._solved(members)
        terms, at = [], 0
        for k in members:
            term = self.groups[k].term
            assert term is not None
            terms.append(term.at(values[at : at + len(term.fitted())]))
            at += len(term.fitted())
        return terms

    def sizes(self, members: Hypothesis) -> list[float]:
        """Return the visible size of each member, rms degrees, freed of what noise adds to it."""
        index = self._index(members)
        values, _ = self._solved(members)
        covariance = inverse(self.gram[np.ix_(index, index)]) * (self.state.sigma / self.state.response) ** 2
        sizes, at = [], 0
        for k in members:
            own = slice(at, at := at + self.parts[k].stop - self.parts[k].start)
            product = self.visible[self.parts[k], self.parts[k]]
            square = values[own] @ product @ values[own] - np.sum(product * covariance[own, own]) * self.inflation
            sizes.append(float(np.sqrt(max(square, 0.0))))
        return sizes

    def alike(self, a: int, b: int) -> float:
        """Return how much of one candidate's best column the other explains, 0 to 1."""
        first, second = self.parts[a], self.parts[b]
        cross = inverse(self.gram[first, first]) @ self.gram[first, second]
        overlap = cross @ inverse(self.gram[second, second]) @ self.gram[second, first]
        return float(np.max(np.real(np.linalg.eigvals(overlap))))

    def _index(self, members: Hypothesis) -> NDArray[np.intp]:
        return np.concatenate([np.arange(self.parts[k].start, self.parts[k].stop) for k in members])

    def _solved(self, members: Hypothesis) -> tuple[Floats, float]:
        index = self._index(members)
        values = inverse(self.gram[np.ix_(index, index)]) @ self.pull[index]
        return values / self.state.response, float(values @ self.pull[index]) / self.state.sigma**2


def charge(group: Group) -> float:
    """Return what a candidate must gain to be worth its parameters and its date.

    Args:
        group: columns of a term.
    """
    assert group.term is not None
    return PARAMETER_CHARGE * len(group.term.fitted()) + DATE_CHARGE * group.term.dated()


def search(state: State, *, alarm: float, min_effect_deg: float) -> Named:
    """Return the terms that the residual calls for, one after the other and together.

    Args:
        state: the simulation without terms.
        alarm: probability that noise alone gives a name.
        min_effect_deg: visible size below which an effect does not matter.
    """
    found = Named(state)
    small: tuple[tuple[str, float], ...] = ()
    for count in range(1, MOST_TERMS + 1):
        tested = scan.test(found.state, columns.of_terms(found.state, state.case.terms), seed=count)
        found = Named(found.state, found.alternatives, tested, tested.threshold(alarm), small, found.best_score)
        strong = np.flatnonzero(tested.score > found.threshold)
        sizes = {int(k): size_of(found.state, tested.groups[k], float(tested.inflation[k])) for k in strong}
        small = tuple((tested.groups[k].name, size) for k, size in sizes.items() if size < min_effect_deg)
        worth = [k for k, size in sizes.items() if size >= min_effect_deg]
        if not worth:
            return Named(found.state, found.alternatives, tested, found.threshold, _largest(small), found.best_score)
        grown = _grow(state, found, worth, count, min_effect_deg)
        if grown is None:
            break
        found = grown
    return found


def _grow(empty: State, found: Named, worth: Sequence[int], count: int, min_effect_deg: float) -> Named | None:
    """Return the best hypothesis of a number of terms, refitted, with its rivals; None where none is believable."""
    assert found.tested is not None
    rivals = _candidates(empty, found, worth)
    for best in _best(rivals, count, found, min_effect_deg):
        state = model.dated(model.refit(found.state, rivals.terms(best)))
        if _holds(found.state, state, min_effect_deg):
            break
    else:
        return None
    far = max(*model.sizes_deg(state), *rivals.sizes(best)) > FAR_DEG or any(t.dated() for t in state.simulation.terms)
    again = _candidates(empty, Named(state, (), found.tested), worth) if far else rivals
    chosen = tuple(_place(again, term) for term in state.simulation.terms) if far else best
    others = _alternatives(again, chosen, min_effect_deg)
    return Named(state, others, found.tested, found.threshold, (), again.score(chosen))


def _holds(before: State, after: State, min_effect_deg: float) -> bool:
    """Tell whether refitted terms are still there, believable, and leave a smaller residual than without the last."""
    believable = all(term.believable for term in after.simulation.terms)
    smaller = model.misfit(after, before.whitener.width_deg) < model.misfit(before, before.whitener.width_deg)
    return believable and smaller and min(model.sizes_deg(after)) >= LOST * min_effect_deg


def _candidates(empty: State, found: Named, worth: Sequence[int]) -> Field:
    """Return all candidates, the chosen terms among them, where the chosen simulation stands.

    Of a term with a date three stay: the date chosen, the best by itself, the best beside the chosen terms.
    """
    assert found.tested is not None
    chosen = found.state.simulation.terms
    view = baseline.examine(empty.case, found.state.simulation, found.state.nuisance, freed=True)
    groups = [columns.of_term(view, kind()) for kind in empty.case.terms if not kind.dated()]
    for kind in (kind for kind in empty.case.terms if kind.dated()):
        tried = columns.of_dates(view, kind, columns.dates(empty.case.scene.time_s))
        gains = _gains(view, tried)
        groups.append(tried[int(np.argmax(gains))])
        beside = [k for k, group in enumerate(found.tested.groups) if isinstance(group.term, kind)]
        if beside:
            term = found.tested.groups[max(beside, key=lambda k: found.tested.score[k])].term  # type: ignore[union-attr]
            groups.append(next(g for g in tried if g.term == term.at(0.0 * term.values)))  # type: ignore[union-attr]
        groups += [columns.of_dates(view, kind, np.array([t.date]))[0] for t in chosen if isinstance(t, kind)]
    ends = np.cumsum([0, *(group.columns.shape[1] for group in groups)])
    together = np.concatenate([group.columns for group in groups], axis=1)
    white, seen = view.projected(together), view.visible(together)
    return Field(
        groups=groups,
        parts=[slice(int(a), int(b)) for a, b in itertools.pairwise(ends)],
        gram=white.T @ white,
        pull=white.T @ view.innovation,
        visible=seen.T @ seen / len(seen),
        state=view,
        inflation=max(1.0, float(np.median([found.tested.inflation[k] for k in worth]))),
    )


def _best(rivals: Field, count: int, found: Named, min_effect_deg: float) -> list[Hypothesis]:
    """Return the few best hypotheses of a number of terms; pairs are all tried, a third joins the best pair."""
    everything = range(len(rivals.groups))
    tries: list[Hypothesis] = []
    if count <= 2:
        tries = list(itertools.combinations(everything, count))
    else:
        chosen = tuple(_place(rivals, term) for term in found.state.simulation.terms)
        tries = [tuple(sorted((*chosen, k))) for k in everything if k not in chosen]
    best: list[Hypothesis] = []
    for hypothesis in sorted((h for h in tries if _sound(rivals, h)), key=rivals.score, reverse=True):
        believable = all(term.believable for term in rivals.terms(hypothesis))
        if believable and min(rivals.sizes(hypothesis)) >= min_effect_deg:
            best.append(tuple(sorted(hypothesis, key=lambda k: CATALOGUE.index(type(rivals.groups[k].term)))))
        if len(best) == TRIES:
            break
    return best


def _sound(rivals: Field, members: Hypothesis) -> bool:
    """Tell whether no effect stands twice in a hypothesis."""
    names = [rivals.groups[k].name for k in members]
    twice = {name for name in names if names.count(name) > 1}
    kinds = [type(rivals.groups[k].term) for k in members]
    return twice <= {WATER_FREELY} and len(set(kinds)) == len(kinds)


def _alternatives(rivals: Field, chosen: Hypothesis, min_effect_deg: float) -> tuple[tuple[str, ...], ...]:
    """Return for each chosen term the other effects that could stand in its place."""
    least = rivals.score(chosen) - CLOSE
    found: list[dict[str, float]] = [{} for _ in chosen]
    tries = [
        h
        for h in itertools.combinations(range(len(rivals.groups)), len(chosen))
        if len(set(h) & set(chosen)) >= len(chosen) - 2
    ]
    for hypothesis in tries:
        if not _sound(rivals, hypothesis) or (score := rivals.score(hypothesis)) < least:
            continue
        if (
            not all(term.believable for term in rivals.terms(hypothesis))
            or min(rivals.sizes(hypothesis)) < min_effect_deg / 2.0
        ):
            continue
        gone = [i for i, k in enumerate(chosen) if k not in hypothesis]
        come = [k for k in hypothesis if k not in chosen]
        for i, k in _matched(rivals, chosen, gone, come):
            name = rivals.groups[k].name
            found[i][name] = max(score, found[i].get(name, -np.inf))
    names = [rivals.groups[k].name for k in chosen]
    return tuple(
        tuple(sorted((n for n in options if n != own), key=lambda n: options[n], reverse=True))
        for own, options in zip(names, found, strict=True)
    )


def _matched(rivals: Field, chosen: Hypothesis, gone: Sequence[int], come: Sequence[int]) -> list[tuple[int, int]]:
    """Return which newcomer stands for which chosen term: those that look most alike."""
    orders = [list(zip(gone, order, strict=True)) for order in itertools.permutations(come)]
    return max(orders, key=lambda pairs: sum(rivals.alike(chosen[i], k) for i, k in pairs))


def _place(rivals: Field, term: Term) -> int:
    """Return the candidate that a chosen term is."""
    bare = term.at(0.0 * term.values)
    return next(k for k, group in enumerate(rivals.groups) if group.term == bare)


def size_of(state: State, group: Group, inflation: float) -> float:
    """Return the visible size of a group's best fit, rms degrees, freed of what noise adds to it.

    Args:
        state: the simulation where it stands.
        group: columns.
        inflation: of the noise's statistic.
    """
    values, covariance = solved(state, group.columns)
    seen = state.visible(group.columns)
    product = seen.T @ seen / len(seen)
    return float(np.sqrt(max(float(values @ product @ values) - inflation * float(np.sum(product * covariance)), 0.0)))


def solved(state: State, columns_deg: Floats) -> tuple[Floats, Floats]:
    """Return the values of columns fitted to the residual, and their covariance.

    Args:
        state: the simulation where it stands.
        columns_deg: (n, k), degrees a unit.
    """
    white = state.projected(columns_deg)
    inverted = inverse(white.T @ white)
    return inverted @ (white.T @ state.innovation) / state.response, inverted * (state.sigma / state.response) ** 2


def _gains(state: State, groups: Sequence[Group]) -> Floats:
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1))
    parts = np.split(white, np.cumsum([group.columns.shape[1] for group in groups])[:-1], axis=1)
    return np.array([_gain(part, state.innovation) for part in parts])


def _gain(white: Floats, innovation: Floats) -> float:
    pull = white.T @ innovation
    return float(pull @ inverse(white.T @ white) @ pull)


def _largest(small: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    sizes: dict[str, float] = {}
    for name, size in small:
        sizes[name] = max(size, sizes.get(name, 0.0))
    return tuple(sizes.items())
