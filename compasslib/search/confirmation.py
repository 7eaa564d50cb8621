"""Names that do not stand: held-out days do not confirm them, or what stays unexplained does their work.

A catalogue lays its nearest column over whatever is there: a veer with depth over a threshold in depth, two lobes over
a card that sticks. Once the empirical curve of what is left is fitted beside it, such a name has nothing to add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from compasslib.core import angles
from compasslib.core.types import Floats
from compasslib.effects import composition
from compasslib.effects.water import VeerWithDirection
from compasslib.search import baseline, dispersion, findings, model, scan, show, within_weeks
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.search.naming import Named
from compasslib.stats.whitening import directions

REFUTED = 0.15  # p-value on held-out days from which on a name is dropped; those above PROVEN touch no product
BESIDE = 0.2  # the same beside other names: that something was left out is proven then
NOTHING = 0.5  # from here on they rather show that nothing was there
LIKE_WATER = 2.5  # inflation by uneven noise and by water, from which on water may do what a change seems to do
LITTLE, MUCH = 0.2, 1.0 / 3.0  # what is left over what the names explain: too little to doubt, enough at any size


def unproven(named: Named) -> tuple[Named, tuple[Group, float] | None]:
    """Return the hypothesis without terms that held-out days do not confirm, and the largest that stays unexplained.

    What a sensor shows by itself keeps its name.
    """
    gone: list[tuple[Group, float]] = []
    while (weakest := _weakest(named.state)) is not None:
        k, p_value = weakest
        if p_value < NOTHING:
            gone.append((_group(named.state, k), model.sizes_deg(named.state)[k]))
        named = _without(named, [k])
    return named, max(gone, key=lambda one: one[1], default=None)


def replaced(named: Named, group: Group, size_deg: float, min_effect_deg: float) -> Named:
    """Return the hypothesis without the terms that add nothing beside the curve of what stays unexplained.

    Args:
        group: splines along which something is left.
        size_deg: its visible size, rms.
    """
    state = named.state
    terms = state.simulation.terms
    if not terms:
        return named
    view = baseline.examine(state.case, state.simulation, state.nuisance, freed=True)
    explained = _explained(view)
    if size_deg < max(LITTLE * explained, min(MUCH * explained, min_effect_deg)):
        return named
    idle = [k for k, term in enumerate(terms) if not term.evident and _score(view, k, group) <= named.threshold]
    return _without(named, idle) if idle else named


def or_water(named: Named) -> Named:
    """Return the hypothesis with the water among the alternatives of what changes where the water changes alike.

    Of a real record whose own noise of that kind was two to six times what chance makes, each change of the iron that
    was applied had made the headings worse. Noise that is merely slow, as simulated moorings have too, does not count.
    """
    scene, terms, water = named.state.case.scene, named.state.simulation.terms, VeerWithDirection
    changing = [k for k, term in enumerate(terms) if term.change(scene) is not None]
    if not changing or water not in named.state.case.terms:
        return named
    view = baseline.examine(named.state.case, named.state.simulation, named.state.nuisance, freed=True)
    like = {k for k in changing if _feigned(*_beside(view, k)) > LIKE_WATER}
    others = [
        (*names, water.name) if k in like and water.name not in names else names
        for k, names in enumerate(named.alternatives)
    ]
    return replace(named, alternatives=tuple(others))


def _weakest(state: State) -> tuple[int, float] | None:
    """Return the term that held-out days confirm least with its p-value, None where they confirm all.

    One that its own series refutes within weeks is as good as not confirmed.
    """
    if refuted := within_weeks.refuted(state):
        return refuted[0], BESIDE
    terms = state.simulation.terms
    p_values = {k: show.held_out(state, [k]).p_value for k, term in enumerate(terms) if not term.evident}
    least = max(p_values.items(), key=lambda one: one[1], default=None)
    return least if least is not None and least[1] >= (BESIDE if len(p_values) > 1 else REFUTED) else None


def _without(named: Named, gone: Sequence[int]) -> Named:
    terms = named.state.simulation.terms
    kept = [k for k in range(len(terms)) if k not in gone]
    state = model.refit(named.state, [terms[k] for k in kept])
    return replace(named, state=state, alternatives=tuple(named.alternatives[k] for k in kept))


def _columns(state: State) -> list[Floats]:
    """Return the columns of each term where the simulation stands, (n, k) degrees a unit."""
    derivative = np.nan_to_num(composition.derivative(state.simulation, state.case.scene, state.heading_deg, first=5))
    ends = np.cumsum([len(term.fitted()) for term in state.simulation.terms])
    return np.split(derivative, ends[:-1], axis=1)


def _group(state: State, k: int) -> Group:
    term = state.simulation.terms[k]
    along = "time" if term.dated() else findings.lives(state, term).covariate
    return Group(term.name, _columns(state)[k], covariates=(along,))


def _explained(view: State) -> float:
    """Return the visible size of what the terms that may fall do together, rms degrees."""
    terms = view.simulation.terms
    each = [own @ term.values for own, term in zip(_columns(view), terms, strict=True) if not term.evident]
    return angles.rms(view.visible(np.sum(each, axis=0)[:, None])[:, 0]) if each else np.inf


def _score(view: State, k: int, group: Group) -> float:
    """Return the score of a term beside the other terms and the curve of what is left."""
    tested = scan.test(*_beside(view, k, group.columns))
    return float(tested.score[0]) if len(tested.groups) else -np.inf


def _feigned(fitted: State, groups: Sequence[Group]) -> float:
    """Return by how much noise that is uneven, and water that changes alike, inflate a group's statistic."""
    basis = directions(fitted.projected(groups[0].columns.astype(np.float32)))
    scattered = dispersion.uneven(fitted, basis) if basis.shape[1] else 1.0
    return max(scattered, 1.0) * float(dispersion.by_water(fitted, groups)[0])


def _beside(view: State, k: int, *beside: Floats) -> tuple[State, list[Group]]:
    """Return the state with the other terms and further columns fitted, and the group of a term to be tested there."""
    own = _columns(view)
    others = [*beside, *own[:k], *own[k + 1 :]]
    fitted = scan.beside(view, np.concatenate(others, axis=1)) if others else view
    term = view.simulation.terms[k]
    return fitted, [Group(term.name, own[k], term)]
