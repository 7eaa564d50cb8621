"""All candidates of the catalogue on one scale, alone and together: scores, sizes, and what comes close to a choice."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats
from compasslib.effects import Term, composition
from compasslib.search import baseline, columns, dispersion
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.search.scan import Tested
from compasslib.stats.whitening import directions, inverse

Hypothesis = tuple[int, ...]

PARAMETER_CHARGE, DATE_CHARGE = 5.0, 6.0
CLOSE = 10.0  # hypotheses within this many units of the best are not told apart
FAR_DEG = 2.5  # size above which columns are no longer those where the simulation stands
WATER_FREELY = "current_veer"  # the only effect that may come in several forms at once


@dataclass(frozen=True)
class Rivals:
    """All candidates on one scale: their whitened columns' products with each other and with the residual."""

    groups: list[Group]
    parts: list[slice]
    gram: Floats
    ridge: Floats  # (p,) prior precision of the values, to be added to the products' diagonal
    pull: Floats
    visible: Floats  # products of the visible columns, square degrees
    state: State
    inflation: float  # of all statistics alike
    own_inflation: Floats  # (g,) of each candidate's, at least the common one
    charges: Floats  # (g,) what each must gain to be worth its parameters and its date

    def score(self, members: Hypothesis, gain: float | None = None) -> float:
        """Return the charged score of a hypothesis, by what it gains once it is refitted where that is given.

        What a term adds to the others counts by its own inflation.
        """
        linear = self._gain(members)
        gain = linear if gain is None else gain
        bent, unsure = max(gain / max(linear, 1e-12), 1.0), 0.0
        for k in members:
            if (share := 1.0 - self.inflation / float(self.own_inflation[k])) > 0.0:
                unsure += share * bent * (linear - self._gain(tuple(j for j in members if j != k)))
        return (gain - unsure) / self.inflation - float(sum(self.charges[k] for k in members))

    def likeness(self, members: Hypothesis, gain: float | None = None) -> float:
        """Return the charged score by the common inflation: what each one's own is, is known to some tenths only."""
        gain = self._gain(members) if gain is None else gain
        return gain / self.inflation - float(sum(self.charges[k] for k in members))

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
        covariance = self._inverse(index) * (self.state.sigma / self.state.response) ** 2
        sizes, at = [], 0
        for k in members:
            own = slice(at, at := at + self.parts[k].stop - self.parts[k].start)
            product = self.visible[self.parts[k], self.parts[k]]
            square = values[own] @ product @ values[own] - np.sum(product * covariance[own, own]) * self.inflation
            sizes.append(float(np.sqrt(max(square, 0.0))))
        return sizes

    def far(self, members: Hypothesis) -> bool:
        """Tell whether an effect turns headings by so much, seen or not, that its columns bend on the way."""
        each = zip(members, self.terms(members), strict=True)
        return max(float(np.std(self.groups[k].columns @ term.values)) for k, term in each) > FAR_DEG

    def alike(self, a: int, b: int) -> float:
        """Return how much of one candidate's best column the other explains, 0 to 1."""
        first, second = self.parts[a], self.parts[b]
        cross = inverse(self.gram[first, first]) @ self.gram[first, second]
        overlap = cross @ inverse(self.gram[second, second]) @ self.gram[second, first]
        return float(np.max(np.real(np.linalg.eigvals(overlap))))

    def place(self, term: Term) -> int:
        """Return the candidate that a chosen term is."""
        bare = term.at(0.0 * term.values)
        return next(k for k, group in enumerate(self.groups) if group.term == bare)

    def sound(self, members: Hypothesis) -> bool:
        """Tell whether no effect stands twice in a hypothesis."""
        names = [self.groups[k].name for k in members]
        twice = {name for name in names if names.count(name) > 1}
        kinds = [type(self.groups[k].term) for k in members]
        return twice <= {WATER_FREELY} and len(set(kinds)) == len(kinds)

    def acceptable(self, members: Hypothesis, least_deg: float) -> bool:
        """Tell whether all terms of a hypothesis are plausible and large enough to be seen."""
        return all(term.plausible for term in self.terms(members)) and min(self.sizes(members)) >= least_deg

    def _gain(self, members: Hypothesis) -> float:
        return self._solved(members)[1]

    def _index(self, members: Hypothesis) -> NDArray[np.intp]:
        return np.concatenate([np.arange(self.parts[k].start, self.parts[k].stop) for k in members])

    def _inverse(self, index: NDArray[np.intp]) -> Floats:
        return inverse(self.gram[np.ix_(index, index)] + np.diag(self.ridge[index]))

    def _solved(self, members: Hypothesis) -> tuple[Floats, float]:
        if not members:
            return np.zeros(0), 0.0
        index = self._index(members)
        values = self._inverse(index) @ self.pull[index]
        return values / self.state.response, float(values @ self.pull[index]) / self.state.sigma**2


def charge(group: Group, effective: float | None = None) -> float:
    """Return what a candidate must gain to be worth its parameters and its date.

    Args:
        group: columns of a term.
        effective: number of its parameters that the record determines rather than the prior; all where absent.
    """
    assert group.term is not None
    count = len(group.term.fitted()) if effective is None else effective
    return PARAMETER_CHARGE * count + DATE_CHARGE * group.term.dated()


def gathered(state: State, tested: Tested, worth: Sequence[int], *, standing: bool = False) -> Rivals:
    """Return all candidates, the chosen terms among them, where the chosen simulation stands.

    Of a term with a date few stay: the date chosen, the best by itself, and the best beside others.

    Args:
        state: with the chosen terms.
        worth: of that the groups that are significant and large enough.
        standing: whether the chosen terms have the slopes of what stands there, or those of newcomers as all others.
    """
    view = baseline.examine(state.case, state.simulation, state.nuisance, freed=True)
    groups = [columns.of_term(view, kind()) for kind in state.case.terms if not kind.dated()]
    beside = _companions(view, groups)
    for kind in (kind for kind in state.case.terms if kind.dated()):
        groups += _of_date(view, kind, tested, beside)
    groups = _where_they_stand(view, groups) if standing and view.simulation.terms else groups
    ends = np.cumsum([0, *(group.columns.shape[1] for group in groups)])
    together = np.concatenate([group.columns for group in groups], axis=1)
    white, seen = view.projected(together), view.visible(together)
    gram, parts = white.T @ white, [slice(int(a), int(b)) for a, b in itertools.pairwise(ends)]
    ridge = view.ridge([group.term for group in groups if group.term is not None])
    effective = [float(np.trace(inverse(gram[p, p] + np.diag(ridge[p])) @ gram[p, p])) for p in parts]
    inflation = max(1.0, float(np.median([tested.inflation[k] for k in worth or range(len(tested.groups))])))
    return Rivals(
        groups=groups,
        parts=parts,
        gram=gram,
        ridge=ridge,
        pull=white.T @ view.innovation,
        visible=seen.T @ seen / len(seen),
        state=view,
        inflation=inflation,
        own_inflation=_own_inflation(state, groups, tested, inflation),
        charges=np.array([charge(group, count) for group, count in zip(groups, effective, strict=True)]),
    )


def _own_inflation(state: State, groups: Sequence[Group], tested: Tested, common: float) -> Floats:
    """Return the inflation of each candidate's statistic: as it was tested last, or by water that changes alike."""
    as_tested = np.array([tested.usual.get(type(group.term), common) for group in groups])
    chosen = np.array([type(group.term) in map(type, state.simulation.terms) for group in groups])
    # Of the chosen, water is in what they were tested by.
    water = np.where(chosen, 1.0, dispersion.by_water(state, groups))
    return np.maximum(np.maximum(as_tested, common * water), common)


def _where_they_stand(view: State, groups: list[Group]) -> list[Group]:
    """Return the groups, those of the chosen terms with the slope of what stands there.

    A second harmonic laid over a first of many degrees begins at a reading that is bent already: it is not the first
    one growing, and would be given its effect wrongly.
    """
    derivative = composition.derivative(view.simulation, view.case.scene, view.heading_deg, first=5)
    found, at = list(groups), 0
    for term in view.simulation.terms:
        end, bare = at + len(term.fitted()), term.at(0.0 * term.values)
        found = [g if g.term != bare else replace(g, columns=np.nan_to_num(derivative[:, at:end])) for g in found]
        at = end
    return found


def _companions(view: State, undated: Sequence[Group]) -> list[Floats]:
    """Return bases of what a date may stand beside: nothing, all chosen terms but one, or any candidate of a pair."""
    terms = [columns.of_term(view, term).columns for term in view.simulation.terms]
    others = [np.concatenate(terms[:k] + terms[k + 1 :], axis=1) for k in range(len(terms)) if len(terms) > 1]
    others += [group.columns for group in undated] if len(terms) <= 1 else []
    return [np.zeros((len(view.case), 0)), *(directions(view.projected(one)) for one in others)]


def _of_date(view: State, kind: type[Term], tested: Tested, beside: Sequence[Floats]) -> list[Group]:
    tried = columns.of_dates(view, kind, columns.dates(view.case.scene.time_s))
    dates = {tried[k].term.date for k in _best_dates(view, tried, beside)}  # type: ignore[union-attr]
    seen = [(score, g.term) for score, g in zip(tested.score, tested.groups, strict=True) if isinstance(g.term, kind)]
    dates |= {max(seen, key=lambda one: one[0])[1].date} if seen else set()
    dates |= {term.date for term in view.simulation.terms if isinstance(term, kind)}
    return columns.of_dates(view, kind, np.array(sorted(dates)))


def _best_dates(view: State, tried: Sequence[Group], beside: Sequence[Floats]) -> set[int]:
    """Return the dates, by their numbers, that gain most beside each of some bases."""
    count = tried[0].columns.shape[1]
    white = view.projected(np.concatenate([group.columns for group in tried], axis=1))
    every = np.arange(len(tried))
    gram = (white.T @ white).reshape(len(tried), count, len(tried), count)[every, :, every, :]
    pull = (white.T @ view.innovation).reshape(-1, count)
    best = set()
    for basis in beside:
        taken = (basis.T @ white).reshape(-1, len(tried), count)
        left = gram - np.einsum("qga,qgb->gab", taken, taken)
        pulls = pull - np.einsum("qga,q->ga", taken, basis.T @ view.innovation)
        best.add(max(range(len(tried)), key=lambda k: float(pulls[k] @ inverse(left[k]) @ pulls[k])))
    return best


def alternatives(rivals: Rivals, chosen: Hypothesis, least_deg: float) -> tuple[tuple[str, ...], ...]:
    """Return for each chosen term the other effects that could stand in its place, likeliest first.

    Args:
        least_deg: visible size that each term of another hypothesis must have, rms.
    """
    least = rivals.likeness(chosen) - CLOSE
    found: list[dict[str, float]] = [{} for _ in chosen]
    for hypothesis in itertools.combinations(range(len(rivals.groups)), len(chosen)):
        if len(chosen) - len(set(hypothesis) & set(chosen)) > 2 or not rivals.sound(hypothesis):
            continue
        if (score := rivals.likeness(hypothesis)) < least or not rivals.acceptable(hypothesis, least_deg):
            continue
        for i, k in _matched(rivals, chosen, hypothesis):
            name = rivals.groups[k].name
            found[i][name] = max(score, found[i].get(name, -np.inf))
    for k, options in zip(chosen, found, strict=True):
        options.pop(rivals.groups[k].name, None)
    return tuple(tuple(name for name, _ in sorted(options.items(), key=_falling)) for options in found)


def _falling(scored: tuple[str, float]) -> float:
    return -scored[1]


def _matched(rivals: Rivals, chosen: Hypothesis, other: Hypothesis) -> list[tuple[int, int]]:
    """Return which newcomer stands for which chosen term, by its position: those that look most alike."""
    gone = [i for i, k in enumerate(chosen) if k not in other]
    come = [k for k in other if k not in chosen]
    orders = [list(zip(gone, order, strict=True)) for order in itertools.permutations(come)]
    return max(orders, key=lambda pairs: sum(rivals.alike(chosen[i], k) for i, k in pairs))
