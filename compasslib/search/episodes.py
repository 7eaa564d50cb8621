"""Weeks in which the reading was off, and then was not, or that come and go: steps and drifts are not their names.

No iron comes and goes of itself, and no mount slips back by as much. Where one offset with a begin and an end, or one
wave, scores higher than the steps and drifts that were chosen, they lose their names; what they stood for stays
unexplained.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from compasslib.core.types import Floats
from compasslib.effects import Term
from compasslib.effects.iron import HardIronDrift, SupplyVoltageOfField, SupplyVoltageOfReading
from compasslib.effects.reading import CompassDrift, HeadingSlip
from compasslib.search import columns, model, rivals, scan
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.search.naming import Named

CHANGES = (CompassDrift, HardIronDrift, SupplyVoltageOfField, SupplyVoltageOfReading)  # beside what has a date
SEARCHED = rivals.PARAMETER_CHARGE + 2.0 * rivals.DATE_CHARGE  # charge of one offset with two dates
SWUNG = 2.0 * rivals.PARAMETER_CHARGE + rivals.DATE_CHARGE  # charge of one wave, its period searched for


@dataclass(frozen=True)
class Episode:
    """An offset of the reading with a begin and an end, or one that swings to and fro all the time."""

    begin_s: float
    end_s: float
    rms_deg: float  # visible, of the whole record
    swings: bool = False


def taken_out(named: Named) -> tuple[Named, Episode | None]:
    """Return the hypothesis without the steps and drifts that one episode explains better, and the episode.

    A lone one must be far behind: the episode had the freer search.
    """
    terms = named.state.simulation.terms
    changes = [k for k, term in enumerate(terms) if term.dated() or isinstance(term, CHANGES)]
    if not changes:
        return named, None
    kept = [k for k in range(len(terms)) if k not in changes]
    free = model.refit(named.state, [terms[k] for k in kept])
    found, score = max(_candidates(free), key=lambda one: one[1], default=(None, -np.inf))
    ahead = rivals.CLOSE if len(changes) == 1 else 0.0
    if found is None or score <= ahead + _score(free, [_same(free, terms[k]) for k in changes]):
        return named, None
    return replace(named, state=free, alternatives=tuple(named.alternatives[k] for k in kept)), found


def _same(free: State, term: Term) -> Group:
    return columns.of_term(free, term.at(0.0 * term.values))


def _score(free: State, groups: list[Group]) -> float:
    together = Group("changes", np.concatenate([group.columns for group in groups], axis=1))
    return float(scan.gains(free, [together])[0]) - sum(rivals.charge(group) for group in groups)


def _candidates(free: State) -> Iterator[tuple[Episode, float]]:
    """Give the offset with a begin and an end that gains most and the wave that does, with their scores."""
    time_s = free.case.scene.time_s
    waves = columns.waves(time_s)
    if waves:
        gain = scan.gains(free, waves)
        k = int(np.argmax(gain))
        ends = (float(time_s[0]), float(time_s[-1]))
        yield Episode(*ends, scan.size_of(free, waves[k], 1.0), swings=True), float(gain[k]) - SWUNG
    dates = columns.dates(time_s)
    if len(dates) < 2:
        return
    begin, end = _best(free, dates, dates)
    for _ in range(2):  # each date more finely, the other kept
        near = np.arange(-model.NEARBY_S, model.NEARBY_S + 1.0, model.FINE_S)
        # Within the dates that are tried: what began before the record, or outlasts it, is a step.
        begin, end = _best(free, np.clip(begin + near, dates[0], dates[-1]), np.array([end]))
        begin, end = _best(free, np.array([begin]), np.clip(end + near, dates[0], dates[-1]))
    offset = _offset(free, begin, end)
    yield Episode(begin, end, scan.size_of(free, offset, 1.0)), float(scan.gains(free, [offset])[0]) - SEARCHED


def _offset(free: State, begin_s: float, end_s: float) -> Group:
    first, last = (group.columns for group in columns.of_dates(free, HeadingSlip, np.array([begin_s, end_s])))
    return Group("episode", first - last, covariates=("time",))


def _best(free: State, begins_s: Floats, ends_s: Floats) -> tuple[float, float]:
    """Return the begin and the end, of some, of the offset that gains most."""
    every = np.unique(np.concatenate([begins_s, ends_s]))
    white = free.projected(np.concatenate([g.columns for g in columns.of_dates(free, HeadingSlip, every)], axis=1))
    pull, gram = white.T @ free.innovation, white.T @ white
    at = {date: k for k, date in enumerate(every.tolist())}
    pairs = [(at[a], at[b]) for a, b in itertools.product(begins_s.tolist(), ends_s.tolist()) if a < b]
    a, b = np.array(pairs, dtype=np.intp).T
    power = np.maximum(gram[a, a] + gram[b, b] - 2.0 * gram[a, b], 1e-12)
    k = int(np.argmax((pull[a] - pull[b]) ** 2 / power))
    return float(every[a[k]]), float(every[b[k]])
