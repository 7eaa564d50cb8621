"""Simulated half-year moorings, diagnosed."""

import numpy as np

from benchmarks.discrepancy import field_of, fitted
from compasslib.inference import design
from compasslib.inference.comparison import Options, compare_pairs
from compasslib.inference.kinds.mooring import diagnose
from tests.world import pairs as world

HOURS = 4000


def seen(wanted, seed=1, **options):
    """With half of the surrogates by default, the fewest by which anything can be detected."""
    drawn = world.planted(world.make(seed, wide=True, n=HOURS), wanted)
    asked = Options(surrogates=99, **options)
    return drawn, diagnose(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn), asked)


def state_of(drawn, more=None, *, magnetic=True):
    """Evaluate the fitted compass without effects; more: further logged series."""
    logged = drawn.covariates | (more or {})
    case = compare_pairs(drawn.pairs, logged, fitted(drawn), field_of(drawn), reference_magnetic=magnetic)
    return design.evaluate_model(case, case.simulation, np.zeros(case.nuisance.shape[1]))
