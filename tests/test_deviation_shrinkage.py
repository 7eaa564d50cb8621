"""Model averaging of the fitted compass with one without deviation, and cases that are not averaged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from compasslib.deviation.model import DeviationFit
from compasslib.deviation.shrinkage import average_with_none

SIGMA = np.array([0.02, 0.04, 0.04, 0.02, 0.02])  # typical of real currents at two depths


def fitted(coefficients, sigma=SIGMA, **other):
    return DeviationFit("exact", 3000, np.array(coefficients), np.diag(sigma**2), **other)


def drawn(strength, count=400, seed=1):
    """Draw fits of compasses with iron of a given strength, with errors by their stated covariance."""
    rng = np.random.default_rng(seed)
    towards = rng.uniform(0.0, 2.0 * np.pi, count)
    true = np.zeros((count, 5))
    true[:, 1:3] = strength * np.column_stack([np.cos(towards), np.sin(towards)])
    return true, [fitted(t + SIGMA * rng.normal(size=5)) for t in true]


def test_a_compass_without_deviation_is_shrunk_to_none():
    _, fits = drawn(0.0)
    averaged = [average_with_none(fit) for fit in fits]
    before, after = (np.array([fit.coefficients for fit in some]) for some in (fits, [fit for fit, _ in averaged]))
    assert np.sqrt((after**2).mean()) < 0.5 * np.sqrt((before**2).mean())
    assert np.median([chance for _, chance in averaged]) > 0.5
    inside = np.abs(after) <= 1.96 * np.sqrt([np.diag(fit.covariance) for fit, _ in averaged])
    assert inside.mean() > 0.95


@pytest.mark.parametrize("strength", [0.12, 0.3, 0.8])
def test_iron_is_corrected_no_worse_and_intervals_cover_it(strength):
    true, fits = drawn(strength)
    averaged = [average_with_none(fit)[0] for fit in fits]
    off, was = (np.array([fit.coefficients for fit in some]) - true for some in (averaged, fits))
    assert np.sqrt((off**2).mean()) < 1.1 * np.sqrt((was**2).mean())
    sigma = np.sqrt([np.diag(fit.covariance) for fit in averaged])
    assert (np.abs(off) <= 1.96 * sigma).mean() > 0.93


def test_strong_iron_and_large_misalignment_stay_as_fitted():
    """Coefficients of twenty standard errors change by less than a third of one."""
    for coefficients in ([0.0, 0.8, -0.3, 0.0, 0.0], [0.4, 0.0, 0.0, 0.0, 0.0]):
        averaged, chance = average_with_none(fitted(coefficients))
        assert chance < 1e-6 and (np.abs(averaged.coefficients - coefficients) < SIGMA / 3.0).all()


@pytest.mark.parametrize("other", [{"folded": True}, {"fixed": True}])
def test_folded_and_given_compasses_are_not_averaged(other):
    fit = fitted([0.01, 0.02, 0.0, 0.0, 0.0], **other)
    assert average_with_none(fit) == (fit, None)
    assert average_with_none(replace(fit, method="von_appen", folded=False))[1] is None
