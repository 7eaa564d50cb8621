"""The latent-heading fit: gradients, recovery on both sides of the fold, honesty on a null."""

from dataclasses import replace

import numpy as np
import pytest
from sea import FOLDED, MILD, pairs

from compasslib import angles, compass
from compasslib.deviation import exact, likelihood, model
from compasslib.deviation import exact as scatter
from compasslib.deviation.forms import FORMS
from compasslib.deviation.model import Noise


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.name)
@pytest.mark.parametrize("coefficients", [MILD, FOLDED])
def test_gradient_equals_numeric(coefficients, form):
    seen, _ = pairs(coefficients, n=400)
    noise = Noise()
    width = likelihood.widths(noise, *model.speeds(seen))
    density = likelihood.scatter(likelihood.squared_chords(model.observed_heading(seen)), width, noise.outliers)
    data = likelihood.sample(seen.heading_deg, density, likelihood.FINE, form)
    prior = np.full(likelihood.CELLS, 1.0 / likelihood.CELLS)
    at = np.append(np.array(coefficients) + 0.03, np.log(2.0))
    value, slopes = likelihood.value_and_gradient(at, data, prior, likelihood.FINE)
    assert value == pytest.approx(likelihood.value(at, data, prior, likelihood.FINE))
    for j, unit in enumerate(np.eye(6)):
        step = 1e-6
        ahead, behind = (likelihood.value(at + s * step * unit, data, prior, likelihood.FINE) for s in (1, -1))
        assert slopes[j] == pytest.approx((ahead - behind) / (2 * step), rel=1e-4, abs=1e-2)
    scores = likelihood.scores(at, data, prior, likelihood.FINE)
    assert scores.sum(axis=0) == pytest.approx(slopes, rel=1e-9)


def test_gradient_of_the_scatter_equals_numeric():
    seen, _ = pairs(MILD, n=400)
    chords = likelihood.squared_chords(model.observed_heading(seen))
    given = exact.smoothed(np.ones(likelihood.CELLS)) * np.ones((len(seen), 1))
    seen = scatter.ScatterData(given, chords, *model.speeds(seen))
    at, step = np.array([1.5, 0.6, -4.0]), 1e-5
    _, slopes = scatter.log_likelihood(at, seen)
    for slope, unit in zip(slopes, step * np.eye(3), strict=True):
        ahead, behind = (scatter.log_likelihood(at + sign * unit, seen)[0] for sign in (1.0, -1.0))
        assert slope == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-5, abs=1e-6)


def test_scatter_is_a_density_and_slow_water_is_nearly_uniform():
    density = likelihood.scatter(likelihood.squared_chords(np.array([10.0, 10.0])), np.array([8.0, 300.0]), 0.02)
    assert density.sum(axis=1) * likelihood.CELL_DEG == pytest.approx([1.0, 1.0])
    assert np.ptp(density[1]) < 0.2 * density[1].mean()


@pytest.mark.parametrize(("coefficients", "seed"), [(MILD, 3), (FOLDED, 4), ((0.05, 0.1, -0.8, 0.05, 0.0), 6)])
def test_recovers_the_compass_on_both_sides_of_the_fold(coefficients, seed):
    seen, heading = pairs(coefficients, n=4000, seed=seed)
    fit = exact.fit(seen)
    sigma = np.sqrt(np.diag(fit.covariance))
    assert fit.folded == (not compass.turns_full_circle(coefficients))
    assert np.abs(fit.coefficients - coefficients).max() < 0.1
    assert np.abs((fit.coefficients - coefficients) / sigma).max() < 5.0
    off = angles.difference(compass.inverse(fit.coefficients, seen.heading_deg), heading[:, None])
    assert np.sqrt(np.nanmean(np.fmin(*np.abs(off).T) ** 2)) < 4.0
    assert 100 < fit.n_effective < len(seen)


def test_a_null_record_stays_null_within_its_uncertainty():
    seen, _ = pairs((0, 0, 0, 0, 0), n=6000, seed=9, spread=35.0)
    fit = exact.fit(seen)
    assert np.abs(fit.coefficients / np.sqrt(np.diag(fit.covariance))).max() < 3.5
    assert fit.noise.floor_deg < 12.0 and not fit.folded


def test_water_that_may_be_turned_for_good_makes_a_as_unsure_and_the_rest_no_surer():
    seen, _ = pairs((0, 0, 0, 0, 0), n=6000, seed=9, spread=60.0)
    sure, unsure = (exact.fit(replace(seen, veer_deg=size)) for size in (0.0, 5.0))
    assert unsure.coefficients == pytest.approx(sure.coefficients)
    before, after = (np.rad2deg(np.sqrt(np.diag(fit.covariance)[:5])) for fit in (sure, unsure))
    assert before[0] < 1.5 and after[0] == pytest.approx(5.0, rel=0.2) and np.all(after > 0.999 * before)


def test_outliers_do_not_move_it():
    seen, heading = pairs(MILD, n=3000, seed=5)
    rng = np.random.default_rng(0)
    wrong = rng.choice(len(seen), 150, replace=False)
    east, north = seen.lower_east.copy(), seen.lower_north.copy()
    east[wrong], north[wrong] = 0.4 * rng.normal(size=(2, 150))
    fit = exact.fit(type(seen)(**{**vars(seen), "lower_east": east, "lower_north": north}))
    off = angles.difference(compass.inverse(fit.coefficients, seen.heading_deg)[:, 0], heading)
    assert angles.rms(off) < 2.5


def test_it_travels_through_json():
    fit = exact.fit(pairs(MILD, n=600)[0])
    again = model.from_json(fit.to_json())
    assert again.coefficients == pytest.approx(fit.coefficients) and again.noise == fit.noise
    assert again.covariance == pytest.approx(fit.covariance)
    nothing = model.from_json(model.too_few("exact", 0).to_json())
    assert not nothing.fitted and nothing.why == "no overlapping pairs"
