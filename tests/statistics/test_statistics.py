"""Would catch minimizers that stop early, widths that outliers bias, noise that is not whitened."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.signal import lfilter

from compasslib import angles
from compasslib.statistics.least_squares import MAX_STEP_DEG, gauss_newton, minimize_bfgs, robust_width
from compasslib.statistics.noise import (
    arma_correlation,
    arma_covariance,
    arma_innovations,
    arma_variance_ratio,
    effective_sample_size,
    lag_matrix,
    rotary_spectrum,
)
from compasslib.statistics.resampling import block_jackknife, block_sums, cluster_variance_inflation, resample_blocks
from compasslib.statistics.whitening import clip_response, clip_standardized, fit_whitener, robust_widths
from tests.world.pairs import red_from_rest as red_noise

TIME_S = 1.19e9 + 3600.0 * np.arange(4000)


def test_minimize_bfgs_finds_free_and_bounded_minima():
    """Rosenbrock's function has its minimum at (1, 1), and at (0.5, 0.25) if x is at most 0.5."""

    def valley(x):
        value = (1.0 - x[0]) ** 2 + 100.0 * (x[1] - x[0] ** 2) ** 2
        by_x = -2.0 * (1.0 - x[0]) - 400.0 * x[0] * (x[1] - x[0] ** 2)
        return value, np.array([by_x, 200.0 * (x[1] - x[0] ** 2)])

    free = np.array([(-np.inf, np.inf)] * 2)
    cut = np.array([(-np.inf, 0.5), (-np.inf, np.inf)])
    assert minimize_bfgs(valley, np.array([-1.2, 1.0]), free, 200)[0] == pytest.approx([1.0, 1.0], abs=1e-3)
    assert minimize_bfgs(valley, np.array([-1.2, 1.0]), cut, 200)[0] == pytest.approx([0.5, 0.25], abs=1e-3)
    flat = np.zeros((2, 2))  # a singular Hessian restarts with steepest descent
    assert minimize_bfgs(valley, np.array([-1.2, 1.0]), free, 200, flat)[0] == pytest.approx([1.0, 1.0], abs=1e-3)


@dataclass(frozen=True)
class Root:
    """Newton iteration for x² − 9 = 0 with steps that are too long by a factor, and a lower limit of x."""

    x: float
    too_long: float = 1.0
    least: float = -np.inf

    def step(self):
        step = -self.too_long * (self.x**2 - 9.0) / (2.0 * self.x)
        return np.array([step]), abs(step)

    def moved(self, step):
        x = self.x + float(step[0])
        return None if x < self.least else Root(x, self.too_long, self.least)

    def misfit(self, other):
        return (other.x**2 - 9.0) ** 2 / max((self.x**2 - 9.0) ** 2, 1e-300)


def test_gauss_newton_clips_and_halves_steps_that_are_too_long():
    def found(begin):
        return gauss_newton(begin, rounds=60, close=1e-9, worse=1.0).x

    assert found(Root(1.0)) == pytest.approx(3.0, abs=1e-9)
    assert found(Root(4.0, too_long=3.0)) == pytest.approx(3.0, abs=1e-6)
    assert found(Root(4.0, too_long=3.0, least=2.9)) == pytest.approx(3.0, abs=1e-6)
    assert gauss_newton(Root(100.0), rounds=1, close=0.0, worse=1.0).x == 100.0 - MAX_STEP_DEG


def test_resampled_noise_consists_of_blocks_with_either_sign():
    series = np.arange(1.0, 13.0)
    drawn = resample_blocks(series, 4, 50, seed=0)
    steps = np.diff(drawn.reshape(50, 3, 4), axis=2)
    assert drawn.shape == (50, 12)
    assert np.all(np.isin(np.abs(steps), [1.0, 11.0]))  # 11 where a block wraps around to the beginning
    assert (drawn < 0.0).any() and (drawn > 0.0).any()


def test_robust_width_is_insensitive_to_outliers():
    noise = np.random.default_rng(7).normal(0.0, 3.0, 20_000)
    noise[:1000] = 1e9
    assert robust_width(noise) == pytest.approx(3.0, rel=0.08)


def test_effective_sample_size_of_red_noise():
    rng = np.random.default_rng(2)
    keep, n = 0.8, 20000
    series = lfilter([1.0], [1.0, -keep], rng.normal(size=n))
    expected = n * (1 - keep) / (1 + keep)
    assert effective_sample_size(series, 3600.0 * np.arange(n)) == pytest.approx(expected, rel=0.15)


def test_correlated_noise_widens_the_covariance():
    rng, n, off = np.random.default_rng(3), 90, []
    columns = np.column_stack([np.ones(n), np.cos(np.arange(n) / 7.0)])
    for _ in range(60):
        noise = lfilter([1.0], [1.0, -0.6], rng.normal(size=n))
        fitted = np.linalg.lstsq(columns, noise, rcond=None)[0]
        spread = arma_covariance(noise - columns @ fitted, columns)
        off.append(fitted / np.sqrt(np.diag(spread)))
    assert 0.7 < np.sqrt(np.mean(np.square(off))) < 1.2  # 2 if the errors were taken as independent


def test_whitener_removes_the_correlation_and_is_linear():
    residual = red_noise(np.random.default_rng(1), 4000, 10, 8.0)
    width = robust_widths(residual, np.zeros(4000))
    white = fit_whitener(residual, width, TIME_S)
    innovation = white(residual[:, None])[:, 0]
    assert abs(np.corrcoef(innovation[1:], innovation[:-1])[0, 1]) < 0.05  # 3 standard errors at n = 4000
    columns = np.random.default_rng(2).normal(size=(4000, 3))
    together = white(columns @ np.array([[1.0], [2.0], [3.0]]))
    np.testing.assert_allclose(together, white(columns) @ np.array([[1.0], [2.0], [3.0]]), atol=1e-12)


def test_missing_samples_have_infinite_width_and_are_ignored():
    rng = np.random.default_rng(3)
    residual = red_noise(rng, 4000, 10, 8.0)
    residual[rng.random(4000) < 0.1] = np.nan
    kept = np.ones(4000, dtype=bool)
    kept[1000:1700] = False
    width = robust_widths(residual[kept], np.zeros(kept.sum()))
    white = fit_whitener(residual[kept], width, TIME_S[kept])
    shown = white(np.nan_to_num(residual[kept])[:, None])
    assert np.isfinite(shown).all() and np.isinf(width[np.isnan(residual[kept])]).all()


@pytest.mark.parametrize("floor", [0.0, 1.0])
def test_the_width_follows_slowness_to_the_fastest_and_slowest_flow(floor):
    rng = np.random.default_rng(4)
    slowness = rng.lognormal(1.0, 0.6, 8000)
    true = np.hypot(floor, 2.0 * slowness)
    ratio = (robust_widths(rng.normal(0.0, true), slowness) / true)[np.argsort(slowness)]
    assert np.median(ratio) == pytest.approx(1.0, abs=0.1)
    assert np.mean(ratio[:80]) == pytest.approx(1.0, abs=0.15)  # of bins of 667, whose width is known within 4 %
    assert np.mean(ratio[-80:]) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("spread", [12.0, 45.0, 70.0, 1000.0])
def test_the_width_of_wrapped_directions_matches_their_information(spread):
    directions = angles.wrap180(np.random.default_rng(5).normal(0.0, spread, 40_000))
    width = robust_widths(directions, np.zeros(40_000))[0]
    # Information on the mean of a wrapped normal distribution from the sines: rho**2 / variance.
    rho, twice = (np.exp(-((k * np.radians(spread)) ** 2) / 2.0) for k in (1, 2))
    known = np.degrees(np.sqrt((1.0 - twice) / 2.0)) / max(rho, 1e-9)
    assert width == pytest.approx(known, rel=0.2) or min(width, known) > 3000.0


def test_clipped_residuals_vanish_continuously_at_180_degrees():
    width = np.full(7, 40.0)
    shown = clip_standardized(np.array([-181.0, -179.0, 0.0, 20.0, 100.0, 179.0, 181.0]), width)
    np.testing.assert_allclose(shown, [1.0 / 40.0, -1.0 / 40.0, 0.0, 0.5, 2.0, 1.0 / 40.0, -1.0 / 40.0], atol=1e-12)


def test_clip_response_is_the_mean_change_by_a_small_shift():
    rng = np.random.default_rng(6)
    residual = angles.wrap180(40.0 * rng.standard_t(4.0, 200_000))
    width = np.full(len(residual), 40.0)
    moved = np.mean(clip_standardized(residual + 1.0, width) - clip_standardized(residual, width)) * 40.0
    assert clip_response(residual, width) == pytest.approx(moved, abs=0.01)


def test_innovations_of_arma_noise_are_white():
    law, n = (0.9, -0.5), 300
    root = np.linalg.cholesky(arma_correlation(*law, lag_matrix(n)) * arma_variance_ratio(law))
    drawn = root @ np.random.default_rng(1).normal(size=(n, 400))
    white = arma_innovations(drawn, law)
    assert np.std(white) == pytest.approx(1.0, abs=0.02)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.01
    np.testing.assert_allclose(np.sum(white**2, axis=0), np.sum(np.linalg.solve(root, drawn) ** 2, axis=0), rtol=0.01)


def test_block_jackknife_equals_refits_without_each_block():
    rng = np.random.default_rng(5)
    rows, block = rng.normal(size=(60, 3)), rng.integers(0, 6, 60)
    observed = rows @ [1.0, -2.0, 0.5] + rng.normal(size=60)
    whole = np.linalg.lstsq(rows, observed)[0]
    pulls = rows * (observed - rows @ whole)[:, None]
    moved = np.array([np.linalg.lstsq(rows[block != b], observed[block != b])[0] - whole for b in range(6)])
    expected = moved.T @ moved * 5.0 / 6.0
    np.testing.assert_allclose(block_jackknife(rows, pulls, block, rows.T @ rows), expected, rtol=1e-9)


def test_correlation_within_blocks_inflates_the_variance():
    rng = np.random.default_rng(6)
    block, basis = np.repeat(np.arange(200), 25), np.full((5000, 1), 5000**-0.5)
    each, shared = rng.normal(size=5000), rng.normal(size=200)[block]
    np.testing.assert_array_equal(block_sums(each[:, None], np.repeat([3, 0], 2500))[:, 0] != 0.0, [True, True])
    ratio, count = cluster_variance_inflation(basis, each, block, 1.0)
    assert count == pytest.approx(200.0)
    assert ratio == pytest.approx(1.0, abs=0.3)  # three standard errors of 200 squares
    ratio, _ = cluster_variance_inflation(basis, shared, block, 1.0)
    assert ratio == pytest.approx(25.0, rel=0.3)


def test_rotary_spectrum_parts_senses_and_its_interval_holds_white_noise():
    hours = np.arange(6000)
    turning = 0.1 * np.exp(-2j * np.pi * hours / 12.0)  # clockwise, seen from above, twice a day
    made = rotary_spectrum(turning, 3600.0)
    step = made.frequency_cpd[1] - made.frequency_cpd[0]
    assert made.frequency_cpd[np.argmax(made.clockwise)] == pytest.approx(2.0)
    assert np.sum(made.clockwise) * step == pytest.approx(0.01, rel=0.01) and made.counterclockwise.max() < 1e-8
    shares, true = [], 2.0 / 24.0  # variance by 24 cycles per day of both senses
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(size=(2, 6000)).T @ [1.0, 1j]
        made = rotary_spectrum(noise, 3600.0)
        low, high = made.interval
        shares += [np.mean((d * low < true) & (true < d * high)) for d in (made.clockwise, made.counterclockwise)]
    assert np.mean(shares) == pytest.approx(0.95, abs=0.015)  # four standard errors of 20 shares, 0.018 each
    noise[::300] = np.nan  # no segment of 15 days is whole
    assert np.isnan(rotary_spectrum(noise, 3600.0).clockwise).all()
