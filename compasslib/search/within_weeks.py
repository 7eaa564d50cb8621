"""Whether an effect follows its cause: what goes with the temperature of a season goes with that of a week.

Two series of one season look alike, whatever their cause. Where the logged series changes within weeks by enough to be
seen, and the heading does not change with it, the season alone is no proof.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compasslib.core.types import Floats
from compasslib.effects import Term
from compasslib.search import baseline, columns, covariates, scan
from compasslib.search.baseline import State
from compasslib.search.columns import Group

SERIES = "temperature"  # a supply voltage changes within weeks as the temperature does
WEEKS_S = 20 * 86400.0  # changes slower than this are a season's, or a battery's
MISSING, SEEN = 2.33, 2.0  # normal scores: of what is missing from the whole effect, and of what would be there of it


def refuted(state: State) -> list[int]:
    """Return the positions of the terms that the changes of their series within weeks refute."""
    return [k for k, share, sigma in _shares(state) if _missing(share, sigma)]


def unseen(state: State) -> list[int]:
    """Return the positions of the terms that the changes of their series within weeks do not show."""
    return [k for k, share, sigma in _shares(state) if share < SEEN * sigma]


def _shares(state: State) -> list[tuple[int, float, float]]:
    """Return the positions of the terms that go with the series, with their shares and errors."""
    logged = [k for k, term in enumerate(state.simulation.terms) if SERIES in term.needs]
    if not logged:
        return []
    view = baseline.examine(state.case, state.simulation, state.nuisance, freed=True)
    return [(k, *_share(view, k)) for k in logged]


def _missing(share: float, sigma: float) -> bool:
    return share < min(1.0 - MISSING * sigma, SEEN * sigma)


def _share(view: State, k: int) -> tuple[float, float]:
    """Return the share of a term's effect that is seen in the changes of its series within weeks, and its error."""
    terms = view.simulation.terms
    own, others = terms[k], [columns.of_term(view, term).columns for j, term in enumerate(terms) if j != k]
    bands = np.column_stack([_effect(view, own, band) for band in _bands(view)])
    free = scan.beside(view, np.concatenate(others, axis=1)) if others else view
    values, covariance = scan.solved(free, Group(own.name, bands))
    return float(values[0]), float(np.sqrt(covariance[0, 0]))


def _bands(view: State) -> list[Floats]:
    """Return the departures of the series within weeks, beyond them and within a day, (n,) each."""
    scene = view.case.scene
    series = scene.departures[SERIES]
    day, weeks = (covariates.running(series, scene.time_s, span) for span in (covariates.DAY_S, WEEKS_S))
    return [day - weeks, weeks, series - day]


def _effect(view: State, term: Term, series: Floats) -> Floats:
    """Return what a term does to the heading if the series were another, (n,) degrees."""
    scene = replace(view.case.scene, departures={**view.case.scene.departures, SERIES: series})
    bare = term.at(0.0 * term.values)
    return columns.of_term(replace(view, case=replace(view.case, scene=scene)), bare).columns @ term.values
