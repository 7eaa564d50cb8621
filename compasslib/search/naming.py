"""Which of the catalogue's terms: hypotheses of one, two or three, compared on one scale, and all that come close.

Scores are those of the whitened residual (twice the log-likelihood gained) minus a charge for each parameter and each
date that was searched for. A hypothesis grows only while a further term is significant against the record's own noise
and large enough to matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import CATALOGUE, Term
from compasslib.search import columns, model, rivals, scan, within_weeks
from compasslib.search.baseline import State
from compasslib.search.rivals import Hypothesis, Rivals
from compasslib.search.scan import Tested

MOST_TERMS = 3
FIRST = 1.6  # of the alarm, for a first name: at the alarm itself, of 0.6 %, one of 600 records of nothing got one
FURTHER = 3.0  # of the alarm, for a name beside another: of 132 records of one effect 1 got a second name
LOST = 0.7  # share of the least size below which a refitted term has lost its effect
SEEN = 0.5  # the same for a term of another hypothesis that could stand there
BENT = 0.75  # share of the best score, less what is not told apart, that another must have to be refitted too
AHEAD = 6.0  # of a pair where none speaks alone: by 4.9 in 346 records of nothing, by 5.2 in 66 of one effect
TRIES = 4  # hypotheses that are refitted before none is taken


@dataclass(frozen=True)
class Named:
    """The hypothesis that was chosen, and what comes close."""

    state: State  # with the chosen terms refitted
    alternatives: tuple[tuple[str, ...], ...] = ()  # for each chosen term
    tested: Tested | None = None  # what was tested last, beside the chosen terms
    threshold: float = np.inf  # of that test
    negligible: tuple[tuple[str, float], ...] = ()  # significant effects too small to matter, with visible degrees


def search(state: State, *, alarm: float, min_effect_deg: float) -> Named:
    """Return the terms that the residual calls for, one after the other and together.

    Args:
        alarm: probability that noise alone gives a name.
    """
    found = Named(state)
    while (count := len(found.state.simulation.terms)) < MOST_TERMS:
        tested = scan.test(found.state, columns.of_terms(found.state, state.case.terms), seed=count + 1)
        tested = tested if found.tested is None else replace(tested, before=found.tested.usual)
        threshold = tested.threshold(alarm * (FURTHER if count else FIRST))
        strong = np.flatnonzero(tested.score > threshold).tolist()
        sizes = {k: scan.size_of(found.state, tested.groups[k], float(tested.inflation[k])) for k in strong}
        worth = [k for k, size in sizes.items() if size >= min_effect_deg]
        small = _largest([(tested.groups[k].name, size) for k, size in sizes.items() if size < min_effect_deg])
        # Two terms may hide each other, and one stand for two, as a step for a drift and a season: pairs are tried too.
        grown = _grow(found.state, tested, worth, min_effect_deg) if worth or count < 2 else None
        if grown is None:
            return replace(found, tested=tested, threshold=threshold, negligible=() if worth else small)
        found = replace(grown, tested=tested, threshold=threshold)
    return found


def without_season_first(named: Named, min_effect_deg: float) -> Named:
    """Return the hypothesis in which what weeks do not show leads no set: another that is not told from it does.

    A temperature of another season looks like the cause of whatever changes within a year.
    """
    for k in within_weeks.unseen(named.state):
        named = _instead(named, k, min_effect_deg) or named
    return named


def _instead(named: Named, k: int, min_effect_deg: float) -> Named | None:
    """Return the hypothesis with the likeliest alternative in the place of a term, None where none holds."""
    state, others = named.state, named.alternatives[k]
    if not others or named.tested is None:
        return None
    field = rivals.gathered(state, named.tested, (), standing=True)
    chosen = [field.place(term) for term in state.simulation.terms]
    tries = [(*chosen[:k], j, *chosen[k + 1 :]) for j, group in enumerate(field.groups) if group.name in others]
    tries = [one for one in tries if field.sound(one) and field.acceptable(one, SEEN * min_effect_deg)]
    without = model.refit(state, [*state.simulation.terms[:k], *state.simulation.terms[k + 1 :]])
    ranked = sorted(tries, key=field.likeness, reverse=True)[:TRIES]
    grown = next((found for _, found in _standing(without, field, ranked, min_effect_deg)), None)
    if grown is None:
        return None
    name = grown.simulation.terms[k].name
    swapped = (state.simulation.terms[k].name, *(other for other in others if other != name))
    return replace(named, state=grown, alternatives=(*named.alternatives[:k], swapped, *named.alternatives[k + 1 :]))


def _grow(state: State, tested: Tested, worth: Sequence[int], min_effect_deg: float) -> Named | None:
    """Return the best hypothesis with one term more, refitted, with its rivals; None where none is plausible.

    One for which no single group speaks must be far ahead of what stands.
    """
    field = rivals.gathered(state, tested, worth)
    shown = {type(tested.groups[k].term) for k in worth} | set(map(type, state.simulation.terms))
    chosen = tuple(field.place(term) for term in state.simulation.terms)
    kept = set(chosen) if len(chosen) > 1 else set()  # pairs are all tried, a third joins the pair that was chosen
    count = len(chosen) + 1 if worth else 2
    hypotheses = list(
        _best(field, count, kept | _evident(field, shown), _speaking(field, tested, worth), min_effect_deg)
    )
    if not worth:
        hypotheses = [one for one in hypotheses if field.score(one) > field.score(chosen) + AHEAD]
    found = _refitted(state, field, hypotheses, min_effect_deg)
    if found is None:
        return None
    best, grown, near = found
    if not worth and _scored(state, field, best, grown) < _scored(state, field, chosen, state) + AHEAD:
        return None
    if field.far(best) or any(term.dated() for term in grown.simulation.terms):
        best, grown, field = _settled(state, grown, tested, worth, min_effect_deg)
    others = rivals.alternatives(field, best, SEEN * min_effect_deg)
    others = tuple(
        _with_near(term, names, near, grown) for term, names in zip(grown.simulation.terms, others, strict=True)
    )
    pairs = zip(grown.simulation.terms, others, strict=True)
    return Named(grown, tuple(() if term.evident else names for term, names in pairs))


def _refitted(
    state: State, field: Rivals, hypotheses: Sequence[Hypothesis], min_effect_deg: float
) -> tuple[Hypothesis, State, list[State]] | None:
    """Return the best of some hypotheses, the state it was refitted to, and other states that are not told from it.

    None where none is plausible.
    """
    first = next(_standing(state, field, hypotheses, min_effect_deg), None)
    if first is None:
        return None
    # Columns are slopes: of large effects another may fit better once all are refitted where they stand.
    least = BENT * field.score(first[0]) - rivals.CLOSE
    others = [one for one in hypotheses if one != first[0] and field.score(one) > least]
    far = any(field.far(one) for one in (first[0], *others))
    every = [first, *(_standing(state, field, others, min_effect_deg) if far else ())]
    best, grown = max(every, key=lambda one: _scored(state, field, *one))
    # By the noise that the best leaves: that of the state before still holds the effect.
    least = field.likeness(best, 0.0) - rivals.CLOSE
    near = [x for one, x in every if x is not grown and field.likeness(one, model.gained(grown, x)) > least]
    return best, grown, near


def _with_near(term: Term, names: tuple[str, ...], near: Sequence[State], chosen: State) -> tuple[str, ...]:
    """Return the alternatives of a chosen term with those that took its place in states that are not told apart."""
    kinds, found = set(map(type, chosen.simulation.terms)), list(names)
    for state in near:
        others = {type(one): one.name for one in state.simulation.terms}
        come = [name for kind, name in others.items() if kind not in kinds]
        if kinds - set(others) == {type(term)} and len(come) == 1:
            found += come
    return tuple(name for name in dict.fromkeys(found) if name != term.name)


def _standing(
    state: State, field: Rivals, hypotheses: Sequence[Hypothesis], min_effect_deg: float
) -> Iterator[tuple[Hypothesis, State]]:
    """Give those of some hypotheses that hold when they are refitted, with their states."""
    tried = ((one, model.dated(model.refit(state, field.terms(one)))) for one in hypotheses)
    return ((one, grown) for one, grown in tried if _stands(state, grown, min_effect_deg))


def _settled(
    state: State, grown: State, tested: Tested, worth: Sequence[int], min_effect_deg: float
) -> tuple[Hypothesis, State, Rivals]:
    """Return the choice where it stands, or another one that is better there, and all candidates.

    A step that was dated alone lies elsewhere beside a drift or a season.
    """
    field = rivals.gathered(grown, tested, worth, standing=True)
    best = tuple(field.place(term) for term in grown.simulation.terms)
    needed = _evident(field, set(map(type, grown.simulation.terms)))
    few = len(best) <= 2  # of three, two were settled before
    tries = _best(field, len(best), needed, _speaking(field, tested, worth), min_effect_deg)
    first = next(tries, best) if few else best
    other = None if field.score(first) <= field.score(best) else _refitted(state, field, [first], min_effect_deg)
    if other is None or _scored(state, field, *other[:2]) <= _scored(state, field, best, grown):
        return best, grown, field
    field = rivals.gathered(other[1], tested, worth, standing=True)
    return tuple(field.place(term) for term in other[1].simulation.terms), other[1], field


def _evident(field: Rivals, shown: set[type]) -> set[int]:
    """Return the candidates that a sensor shows by itself, of what was shown."""
    terms = enumerate(group.term for group in field.groups)
    return {k for k, term in terms if term is not None and term.evident and type(term) in shown}


def _speaking(field: Rivals, tested: Tested, worth: Sequence[int]) -> set[int]:
    """Return the candidates of the kinds that were significant by themselves; all where none was."""
    kinds = {type(tested.groups[k].term) for k in worth}
    return {k for k, group in enumerate(field.groups) if not kinds or type(group.term) in kinds}


def _stands(before: State, after: State, min_effect_deg: float) -> bool:
    """Tell whether refitted terms are still there, plausible, and leave a smaller residual than without the last."""
    plausible = all(term.plausible for term in after.simulation.terms) and model.gained(before, after) > 0.0
    return plausible and min(model.sizes_deg(after)) >= LOST * min_effect_deg and not within_weeks.refuted(after)


def _scored(before: State, field: Rivals, hypothesis: Hypothesis, after: State) -> float:
    """Return the score of a hypothesis refitted from a state."""
    return field.score(hypothesis, model.gained(before, after))


def _best(
    field: Rivals, count: int, needed: set[int], speaking: set[int], min_effect_deg: float
) -> Iterator[Hypothesis]:
    """Give the best hypotheses of some terms, of each choice of effects one.

    Those that are needed are in all, and in each at least one that speaks by itself.
    """
    tries = itertools.combinations(range(len(field.groups)), count)
    sound = (one for one in tries if needed <= set(one) and not speaking.isdisjoint(one) and field.sound(one))
    ranked = sorted(sound, key=field.score, reverse=True)
    acceptable = (one for one in ranked if field.acceptable(one, min_effect_deg))
    for hypothesis in itertools.islice(_one_a_choice(field, acceptable), TRIES):
        yield tuple(sorted(hypothesis, key=lambda k: CATALOGUE.index(type(field.groups[k].term))))


def _one_a_choice(field: Rivals, hypotheses: Iterable[Hypothesis]) -> Iterator[Hypothesis]:
    """Give the first of those that differ by their dates only."""
    seen = set()
    for hypothesis in hypotheses:
        kinds = frozenset(type(field.groups[k].term) for k in hypothesis)
        if kinds not in seen:
            seen.add(kinds)
            yield hypothesis


def _largest(small: Sequence[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    sizes: dict[str, float] = {}
    for name, size in small:
        sizes[name] = max(size, sizes.get(name, 0.0))
    return tuple(sizes.items())
