"""Simulated half-year moorings, diagnosed."""

from dataclasses import replace

import numpy as np

from benchmarks.discrepancy import field_of, fitted
from compasslib.inference import design
from compasslib.inference.comparison import Options, compare_pairs
from compasslib.inference.kinds.mooring import diagnose
from compasslib.records import take
from tests.world import pairs as world

HOURS = 4000
FEWEST = Options(surrogates=39)  # a fifth of the default: an effect exceeds all of them


def seen(wanted, seed=1, **options):
    drawn = world.planted(world.make(seed, wide=True, n=HOURS), wanted)
    return drawn, diagnosed(drawn, **options)


def every_second(drawn):
    """Take every second sample: two-hourly."""
    even = np.arange(0, len(drawn.pairs), 2)
    logged = {name: column[even] for name, column in drawn.covariates.items()}
    return replace(drawn, pairs=take(drawn.pairs, even), covariates=logged, heading=drawn.heading[even])


def diagnosed(drawn, **options):
    """Diagnose a simulated mooring; options: of ``FEWEST``."""
    return diagnose(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn), replace(FEWEST, **options))


def state_of(drawn, more=None, *, magnetic=True):
    """Evaluate the fitted compass without effects; more: further logged series."""
    logged = drawn.covariates | (more or {})
    case = compare_pairs(drawn.pairs, logged, fitted(drawn), field_of(drawn), reference_magnetic=magnetic)
    return design.evaluate_model(case, case.simulation, np.zeros(case.nuisance.shape[1]))
