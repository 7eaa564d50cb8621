"""Weeks in which the reading was off, and then was not: two steps that undo each other are no two faults.

No iron comes and goes of itself, and no mount slips back by as much. Where one offset with a begin and an end scores
higher than the steps and drifts that were chosen, they lose their names; what they stood for stays unexplained.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.discrepancy import columns, model, rivals, scan
from compasslib.discrepancy.baseline import State
from compasslib.discrepancy.columns import Group
from compasslib.discrepancy.naming import Named
from compasslib.physics.compass_drift import CompassDrift
from compasslib.physics.hard_iron_drift import HardIronDrift
from compasslib.physics.heading_slip import HeadingSlip

Floats = NDArray[np.floating]

DRIFTS = (CompassDrift, HardIronDrift)
CHARGE = rivals.PARAMETER_CHARGE + 2.0 * rivals.DATE_CHARGE  # of one offset with two dates


@dataclass(frozen=True)
class Episode:
    """An offset of the reading with a begin and an end."""

    begin_s: float
    end_s: float
    rms_deg: float  # visible, of the whole record


def taken_out(named: Named) -> tuple[Named, Episode | None]:
    """Return the hypothesis without steps that one episode explains better, and the episode.

    Args:
        named: the chosen hypothesis.
    """
    terms = named.state.simulation.terms
    changes = [k for k, term in enumerate(terms) if term.dated() or isinstance(term, DRIFTS)]
    if len(changes) < 2:
        return named, None
    kept = [k for k in range(len(terms)) if k not in changes]
    free = model.refit(named.state, [terms[k] for k in kept])
    found, score = _best(free)
    if found is None or score <= _score(
        free, [columns.of_term(free, terms[k].at(0.0 * terms[k].values)) for k in changes]
    ):
        return named, None
    return replace(named, state=free, alternatives=tuple(named.alternatives[k] for k in kept)), found


def _score(free: State, groups: list[Group]) -> float:
    together = Group("changes", np.concatenate([group.columns for group in groups], axis=1))
    return float(scan.gains(free, [together])[0]) - sum(rivals.charge(group) for group in groups)


def _best(free: State) -> tuple[Episode | None, float]:
    """Return the offset with a begin and an end that gains most, with its score."""
    time_s = free.case.scene.time_s
    dates = columns.dates(time_s)
    steps = np.concatenate([group.columns for group in columns.of_dates(free, HeadingSlip, dates)], axis=1)
    white = free.projected(steps)
    pull, gram = white.T @ free.innovation, white.T @ white
    pairs = np.array(list(itertools.combinations(range(len(dates)), 2)), dtype=np.intp)
    if not len(pairs):
        return None, -np.inf
    a, b = pairs.T
    power = np.maximum(gram[a, a] + gram[b, b] - 2.0 * gram[a, b], 1e-12)
    gain = (pull[a] - pull[b]) ** 2 / power / free.sigma**2
    k = int(np.argmax(gain))
    offset = Group("episode", steps[:, [a[k]]] - steps[:, [b[k]]])
    return Episode(dates[a[k]], dates[b[k]], scan.size_of(free, offset, 1.0)), float(gain[k]) - CHARGE
