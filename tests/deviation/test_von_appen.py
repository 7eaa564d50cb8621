"""Would catch a published number missed, headings outside the series' range, its known bias gone unnoticed."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles
from compasslib.deviation.series import (
    fit_series,
    fit_series_about_mean,
    inverse_table,
    invert_series,
    series_deviation,
    series_folds,
    series_slope,
)
from tests.world.sea import MILD, pairs


@pytest.mark.parametrize(("b", "recorded"), [(0, 90), (45, 45), (135, -45)])
def test_figure_5_at_a_correct_heading_of_90(b, recorded):
    assert 90.0 - series_deviation((0, b, 0, 0, 0), 90.0) == pytest.approx(recorded)


def test_series_folds_beyond_180_over_pi():
    edge = 180.0 / np.pi
    assert not series_folds((0, edge - 0.01, 0, 0, 0))
    assert series_folds((0, edge + 0.05, 0, 0, 0))


@pytest.mark.parametrize("coefficients", [(3, 10, -8, 2, 1), (-1, 40, 20, 3, 2)])
def test_lookup_inverts_the_series_on_the_whole_circle(coefficients):
    heading = np.arange(0.3, 360.0, 1.7)
    recorded = angles.wrap360(heading - series_deviation(coefficients, heading))
    # linear interpolation in a table of a quarter degree
    assert np.abs(angles.difference(invert_series(coefficients, recorded), heading)).max() < 0.02


def test_folded_series_inverts_only_its_sluggish_stretch():
    coefficients = (0, 100.0, 0, 0, 0)
    gamma, beta = inverse_table(coefficients)
    assert (np.diff(gamma) > 0).all() and (np.diff(beta) < 0).all()
    assert (series_slope(coefficients, beta[1:-1]) < 0).all()
    inside, outside = float(gamma.mean()), float(gamma[-1]) + 20.0
    found = invert_series(coefficients, np.array([inside, outside, np.nan]))
    assert np.isfinite(found[0]) and np.isnan(found[1:]).all()
    assert angles.difference(found[0] - series_deviation(coefficients, found[0]), inside) == pytest.approx(0, abs=0.02)


def test_fit_recovers_a_curve_without_noise():
    seen, _ = pairs(MILD, n=500)
    heading = np.linspace(0.0, 359.0, 500)
    truth = np.array([3.0, 20.0, -10.0, 2.0, 1.0])
    deviation = series_deviation(truth, heading)
    lower = angles.turn(seen.upper_east, seen.upper_north, deviation)
    recorded = angles.wrap360(heading - deviation)
    clean = replace(seen, heading_deg=recorded, lower_east=lower[0], lower_north=lower[1])
    fit = fit_series(clean)
    assert fit.coefficients == pytest.approx(truth, abs=1e-6)
    assert fit.recorded_range_deg == (0.0, 360.0) and not fit.folded


def test_the_branch_with_most_headings_can_be_inverted():
    """If the curve folds and the headings are on its rising branch, an author would invert that branch."""
    coefficients, heading = (0.0, 100.0, 0.0, 0.0, 0.0), np.linspace(120.0, 240.0, 60)
    recorded = angles.wrap360(heading - series_deviation(coefficients, heading))
    sluggish, steady = invert_series(coefficients, recorded), invert_series(coefficients, recorded, heading)
    assert np.abs(angles.difference(steady, heading)).max() < 0.02
    assert np.isnan(sluggish).all()
    turned = invert_series(coefficients, recorded, np.append(heading[:5], np.linspace(-40.0, 40.0, 60)))
    assert np.array_equal(turned, sluggish, equal_nan=True)
    seen, _ = pairs((0, 0, 0, 0, 0), n=500)
    assert fit_series_about_mean(seen) == pytest.approx(fit_series(seen).coefficients, abs=1e-6)


def test_shared_noise_biases_the_series():
    """The noisy direction of the reference is on both axes, which biases the slope towards +1 (hence the exact fit)."""
    seen, _ = pairs((0, 0, 0, 0, 0), n=6000, spread=35.0)
    assert np.hypot(*fit_series(seen).coefficients[1:3]) > 10.0
