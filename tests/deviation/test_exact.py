"""Would catch wrong gradients, a compass not recovered on either side of the fold, iron found where there is none."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles, compass
from compasslib.deviation.average import average_with_none
from compasslib.deviation.exact import Overlap, fit_exact, scatter_log_likelihood, smooth_density
from compasslib.deviation.likelihood import (
    CELL_DEG,
    CELLS,
    EXACT,
    FINE,
    SERIES,
    bin_sample,
    log_likelihood,
    log_likelihood_and_gradient,
    pair_scores,
    scatter_density,
    scatter_widths,
    squared_chords,
)
from compasslib.deviation.model import (
    DeviationFit,
    ScatterNoise,
    fit_from_json,
    observed_heading,
    pair_speeds,
    unfitted,
)
from tests.world.sea import FOLDED, MILD, pairs


@pytest.mark.parametrize(("form", "coefficients"), [(EXACT, MILD), (EXACT, FOLDED), (SERIES, MILD)])
def test_gradient_equals_numeric(coefficients, form):
    seen, _ = pairs(coefficients, n=400)
    noise = ScatterNoise()
    width = scatter_widths(noise, *pair_speeds(seen))
    density = scatter_density(squared_chords(observed_heading(seen)), width, noise.outliers)
    data = bin_sample(seen.heading_deg, density, FINE, form)
    prior = np.full(CELLS, 1.0 / CELLS)
    at = np.append(np.array(coefficients) + 0.03, np.log(2.0))
    value, slopes = log_likelihood_and_gradient(at, data, prior, FINE)
    assert value == pytest.approx(log_likelihood(at, data, prior, FINE))
    for j, unit in enumerate(np.eye(6)):
        step = 1e-6
        ahead, behind = (log_likelihood(at + s * step * unit, data, prior, FINE) for s in (1, -1))
        assert slopes[j] == pytest.approx((ahead - behind) / (2 * step), rel=1e-4, abs=1e-2)
    scores = pair_scores(at, data, prior, FINE)
    assert scores.sum(axis=0) == pytest.approx(slopes, rel=1e-9)


def test_gradient_of_the_scatter_equals_numeric():
    seen, _ = pairs(MILD, n=400)
    chords = squared_chords(observed_heading(seen))
    given = smooth_density(np.ones(CELLS)) * np.ones((len(seen), 1))
    overlap = Overlap(seen.heading_deg, observed_heading(seen), chords, *pair_speeds(seen))
    at, step = np.array([1.5, 0.6, -4.0]), 1e-5
    _, slopes = scatter_log_likelihood(at, overlap, given)
    for slope, unit in zip(slopes, step * np.eye(3), strict=True):
        ahead, behind = (scatter_log_likelihood(at + sign * unit, overlap, given)[0] for sign in (1.0, -1.0))
        assert slope == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=1e-6)


def test_scatter_is_a_density_and_slow_water_is_nearly_uniform():
    density = scatter_density(squared_chords(np.array([10.0, 10.0])), np.array([8.0, 300.0]), 0.02)
    assert density.sum(axis=1) * CELL_DEG == pytest.approx([1.0, 1.0])
    assert np.ptp(density[1]) < 0.2 * density[1].mean()


@pytest.mark.parametrize(("coefficients", "seed"), [(MILD, 3), (FOLDED, 4)])
def test_recovers_the_compass_on_both_sides_of_the_fold(coefficients, seed):
    seen, heading = pairs(coefficients, n=4000, seed=seed)
    fit = fit_exact(seen)
    sigma = np.sqrt(np.diag(fit.covariance))
    assert fit.folded == (not compass.turns_full_circle(coefficients))
    assert np.abs(fit.coefficients - coefficients).max() < 0.1
    assert np.abs((fit.coefficients - coefficients) / sigma).max() < 5.0
    off = angles.difference(compass.inverse(fit.coefficients, seen.heading_deg), heading[:, None])
    assert np.sqrt(np.nanmean(np.fmin(*np.abs(off).T) ** 2)) < 4.0
    assert 100 < fit.n_effective < len(seen)


def test_a_null_record_stays_null_within_its_uncertainty():
    seen, _ = pairs((0, 0, 0, 0, 0), n=6000, seed=9, spread=35.0)
    fit = fit_exact(seen)
    assert np.abs(fit.coefficients / np.sqrt(np.diag(fit.covariance))).max() < 3.5
    assert fit.noise.floor_deg < 12.0 and not fit.folded


def test_uncertainty_of_a_constant_veer_widens_that_of_a():
    seen, _ = pairs((0, 0, 0, 0, 0), n=6000, seed=9, spread=60.0)
    sure, unsure = (fit_exact(replace(seen, veer_deg=size)) for size in (0.0, 5.0))
    assert unsure.coefficients == pytest.approx(sure.coefficients)
    before, after = (np.rad2deg(np.sqrt(np.diag(fit.covariance)[:5])) for fit in (sure, unsure))
    assert before[0] < 1.5 and after[0] == pytest.approx(5.0, rel=0.2) and np.all(after > 0.999 * before)


def test_outliers_do_not_bias_the_fit():
    seen, heading = pairs(MILD, n=3000, seed=5)
    rng = np.random.default_rng(0)
    wrong = rng.choice(len(seen), 150, replace=False)
    east, north = seen.lower_east.copy(), seen.lower_north.copy()
    east[wrong], north[wrong] = 0.4 * rng.normal(size=(2, 150))
    fit = fit_exact(replace(seen, lower_east=east, lower_north=north))
    off = angles.difference(compass.inverse(fit.coefficients, seen.heading_deg)[:, 0], heading)
    assert angles.rms(off) < 2.5


def test_fit_is_restored_from_json():
    fit = fit_exact(pairs(MILD, n=600)[0])
    again = fit_from_json(fit.to_json())
    assert again.coefficients == pytest.approx(fit.coefficients) and again.noise == fit.noise
    assert again.covariance == pytest.approx(fit.covariance)
    nothing = fit_from_json(unfitted("exact", 0).to_json())
    assert not nothing.fitted and nothing.why == "no overlapping pairs"


# Model averaging of the fitted compass with one without deviation, and cases that are not averaged.
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


@pytest.mark.parametrize("strength", [0.12, 0.8])
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


def test_declared_iron_leaves_no_chance_of_no_deviation():
    weak = fitted([0.0, 0.03, 0.0, 0.0, 0.0])
    assert average_with_none(weak)[1] > 0.5
    declared, chance = average_with_none(replace(weak, iron_declared=True))
    assert chance == 0.0 and declared.coefficients[1] > 2.0 * average_with_none(weak)[0].coefficients[1]
    assert fit_from_json(declared.to_json()).iron_declared


@pytest.mark.parametrize("other", [{"folded": True}, {"fixed": True}])
def test_folded_and_given_compasses_are_not_averaged(other):
    fit = fitted([0.01, 0.02, 0.0, 0.0, 0.0], **other)
    assert average_with_none(fit) == (fit, None)
    assert average_with_none(replace(fit, method="von_appen", folded=False))[1] is None
