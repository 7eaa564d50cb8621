"""Slow water: learnt from the record, not mistaken for a compass, and no cloak for one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_search_mooring import field_of, fitted

from compasslib.core import angles
from compasslib.search import baseline, slow
from compasslib.search.case import mooring_case
from compasslib.search.diagnosis import diagnose
from compasslib.simulation import pairs as world

HOURS, MEMORY_H = 6000, 480.0


def veered(size_deg, seed, wanted=None):
    """Return a simulated mooring whose lower water veers by a first-order process of twenty days."""
    drawn = world.planted(world.make(seed, wide=True, n=HOURS), wanted or {})
    rng, keep = np.random.default_rng(seed), np.exp(-1.0 / MEMORY_H)
    kicks = size_deg * np.sqrt(1.0 - keep**2) * rng.normal(size=len(drawn.pairs))
    veer = np.empty(len(kicks))
    state = size_deg * rng.normal()
    for k, kick in enumerate(kicks):
        veer[k] = state = keep * state + kick
    east, north = angles.turn(drawn.pairs.lower_east, drawn.pairs.lower_north, veer)
    return replace(drawn, pairs=replace(drawn.pairs, lower_east=east, lower_north=north))


def learnt(drawn):
    case = mooring_case(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn))
    state = baseline.examine(case, case.simulation, np.zeros(case.nuisance.shape[1]))
    return slow.learnt(state, *slow._columns(state))[0]


def test_the_size_of_a_slow_veer_is_learnt():
    sizes = {size: [learnt(veered(size, seed)).veer.size for seed in range(4)] for size in (0.0, 4.0)}
    assert np.median(sizes[0.0]) <= 2.0 < np.median(sizes[4.0]) <= 6.0


@pytest.mark.parametrize("seed", range(3))
def test_slow_veer_alone_is_no_finding(seed):
    drawn = veered(4.0, seed)
    found = diagnose(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn))
    assert not any(one.applied for one in found.findings)
    assert found.verdict in ("consistent", "ambiguous")


def test_a_large_slip_is_seen_through_it():
    drawn = veered(1.5, 5, {"heading_slip": 5.0})
    found = diagnose(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn))
    assert "heading_slip" in {name for one in found.findings for name in (one.effect, *one.alternatives)}
