"""Correlated noise: effective sample size, ARMA(1, 1) models, and the noise of a swing.

A record of a quarter of an hour contains only a dozen independent segments, too few for a bootstrap. Covariances are
therefore those of ARMA(1, 1) models, averaged by their likelihood.

In a swing the helmsman's corrections, the swell and a receiver's filter correlate neighbouring residuals. Means over
blocks of 20 s remove most of the oscillation about the course; the remaining correlation between blocks is modelled as
an ARMA(1, 1) series. It increases the covariance but is not used to whiten the fit, because whitening would give most
weight to motions within seconds, where the course lags behind the compass.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib.statistics.least_squares import HUBER_CLIP, robust_width
from compasslib.statistics.resampling import block_sums
from compasslib.types import DAY_S, Complexes, Floats


def effective_sample_size(residual: Floats, time_s: Floats, *, longest_s: float = 5 * DAY_S) -> float:
    """Estimate the effective sample size, n over the summed autocorrelation; for real currents it is much below n."""
    n = len(residual)
    if n < 3:
        return float(n)
    step = float(np.median(np.diff(time_s)))
    slot = np.rint((time_s - time_s[0]) / step).astype(int)
    series, present = np.zeros(slot[-1] + 1), np.zeros(slot[-1] + 1)
    series[slot], present[slot] = residual - residual.mean(), 1.0
    lags = min(int(longest_s / step), len(series) // 3)
    together = lagged_sums(present, lags)
    rho = lagged_sums(series, lags) / np.maximum(together, 1.0)
    if not rho[0] > 0.0:  # constant, as for a stuck sensor
        return 1.0
    rho = np.where(together > 0.02 * n, rho, 0.0) / rho[0]
    rho = rho[1:]
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(pairs <= 0)
    return float(np.clip(n / (1.0 + 2.0 * float(pairs[: stop[0]].sum() if stop.size else pairs.sum())), 1.0, n))


def lagged_sums(x: Floats, lags: int) -> Floats:
    """Compute sums of products of a series (0 where not measured) with itself at lags 0, 1, ..., (lags + 1,)."""
    size = 1 << (2 * len(x) - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[: lags + 1]


Ints = NDArray[np.int_]

PHI = np.concatenate([[0.0], 1.0 - np.geomspace(0.85, 0.05, 14)])  # candidate autoregressive coefficients
THETA = np.array([0.0, -0.2, -0.4, -0.6, -0.8])  # candidate moving-average coefficients
MIN_DOF = 3.0  # degrees of freedom from which Student's distribution has a finite variance


@dataclass(frozen=True)
class RotarySpectrum:
    """Power density of a velocity by frequency and sense of rotation."""

    frequency_cpd: Floats  # (k,) cycles per day, above 0
    clockwise: Floats  # (k,) (m/s)^2 per cycle per day; NaN without a segment
    counterclockwise: Floats  # (k,)
    interval: tuple[float, float]  # factors on a density to the ends of its 95 % interval


def rotary_spectrum(velocity: Complexes, step_s: float) -> RotarySpectrum:
    """Estimate the rotary spectrum (Gonella 1972) by half-overlapping segments under a Hann window (Welch 1967).

    Segments of 15 days part M2 and S2, 1 / (2 - 1.9323) days; those with a missing value are left out. Degrees of
    freedom: Percival and Walden (1993, equation 292b).
    """
    from scipy.special import chdtri

    length = int(15.0 * DAY_S / step_s) // 2 * 2
    window = np.hanning(length + 1)[:-1]
    begins = range(0, len(velocity) - length + 1, max(length // 2, 1))
    parts = [part for begin in begins if np.isfinite(part := velocity[begin : begin + length]).all()]
    cycles = np.fft.fftfreq(length, step_s / DAY_S)
    positive = slice(1, length // 2)
    if not parts:
        nothing = np.full(len(cycles[positive]), np.nan)
        return RotarySpectrum(cycles[positive], nothing, nothing, (np.nan, np.nan))
    powers = [np.abs(np.fft.fft(window * (part - part.mean()))) ** 2 for part in parts]
    density = np.mean(powers, axis=0) * step_s / DAY_S / np.sum(window**2)
    shared = (np.sum(window[: length // 2] * window[length // 2 :]) / np.sum(window**2)) ** 2
    freedom = 2.0 * len(parts) / (1.0 + 2.0 * shared * (1.0 - 1.0 / len(parts)))
    low, high = (freedom / chdtri(freedom, tail) for tail in (0.025, 0.975))
    return RotarySpectrum(cycles[positive], density[::-1][: length // 2 - 1], density[positive], (low, high))


def arma_likelihoods(residual: Floats, columns: Floats) -> Floats:
    """Compute minus log restricted likelihood, phi, theta and variance of each model, (models, 4); none if n is low."""
    columns = span_basis(columns)
    dof = len(residual) - columns.shape[1]
    if dof < MIN_DOF:
        return np.zeros((0, 4))
    rows, models = np.column_stack([columns, residual]), []
    lags = lag_matrix(len(residual))
    for phi in PHI:
        for theta in THETA[np.greater_equal(THETA, -phi)]:
            lower = np.linalg.cholesky(arma_correlation(phi, theta, lags))
            upper = np.asarray(np.linalg.qr(np.linalg.solve(lower, rows), mode="r"))
            size = np.log(np.abs(np.diag(upper)) + 1e-12)
            loss = dof * size[-1] + float(np.sum(size[:-1])) + float(np.sum(np.log(np.diag(lower))))
            models.append((loss, float(phi), float(theta), float(upper[-1, -1] ** 2) / dof))
    return np.array(models)


def arma_correlation(phi: float, theta: float, lags: Ints) -> Floats:
    """Compute the correlation of an ARMA(1, 1) series with autoregressive phi and moving-average theta."""
    return np.where(lags == 0, 1.0, _first_lag(phi, theta) * phi ** np.maximum(lags - 1, 0))


def arma_variance_ratio(law: tuple[float, float]) -> float:
    """Compute the variance of an ARMA(1, 1) series over that of its innovations."""
    phi, theta = law
    return (1.0 + 2.0 * phi * theta + theta**2) / (1.0 - phi**2)


def arma_innovations(columns: Floats, law: tuple[float, float]) -> Floats:
    """Compute the innovations of columns under an ARMA(1, 1) model, (n, k), the first divided by its own sigma."""
    from scipy.signal import lfilter

    phi, theta = law
    if not phi and not theta:
        return columns
    first = arma_variance_ratio(law)
    begun = lfilter([1.0, -phi], [1.0, theta], columns[1:], axis=0, zi=-(phi + theta / first) * columns[:1])[0]
    return np.concatenate([columns[:1] / np.sqrt(first), begun])


def arma_series(innovations: Floats, law: tuple[float, float]) -> Floats:
    """Compute the series whose innovations under an ARMA(1, 1) model are given, (n, k), see ``arma_innovations``."""
    from scipy.signal import lfilter

    phi, theta = law
    first = arma_variance_ratio(law)
    begun = innovations[:1] * np.sqrt(first)
    rest = lfilter([1.0, theta], [1.0, -phi], innovations[1:], axis=0, zi=(phi + theta / first) * begun)[0]
    return np.concatenate([begun, rest])


def lag_matrix(n: int) -> Ints:
    """Compute the lags between n samples, (n, n)."""
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))


def span_basis(columns: Floats, least: float = 0.0) -> Floats:
    """Compute an orthonormal basis of the span of columns, without directions of negligible singular value."""
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > max(least, 1e-6 * size.max(initial=0.0))]


def arma_covariance(residual: Floats, columns: Floats) -> Floats:
    """Estimate the covariance of least squares, averaged over the models by their likelihood, (k, k)."""
    size = np.linalg.norm(columns, axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    unit = columns / scale
    solved = unit @ np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    weight, each = _weighted_models(residual, columns)
    spread = np.stack([solved.T @ of_noise @ solved for of_noise in each])
    logs = np.log(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 1e-300))
    middle = np.tensordot(weight, spread, 1)
    # The slowest noise dominates an arithmetic mean of variances, so their geometric mean over the models is used.
    share = np.exp(weight @ logs / 2.0) / np.sqrt(np.maximum(np.diagonal(middle), 1e-300)) / scale
    return np.asarray(middle * np.outer(share, share))


def arma_effective_size(residual: Floats, columns: Floats) -> float:
    """Compute the effective sample size of a mean."""
    weight, each = _weighted_models(residual, columns)
    of_noise = np.tensordot(weight, np.stack(each), 1)
    return float(len(residual) * np.trace(of_noise) / of_noise.sum())


def _first_lag(phi: Any, theta: Any) -> Any:
    """Compute the correlation of an ARMA(1, 1) series at lag one."""
    return (1.0 + phi * theta) * (phi + theta) / (1.0 + 2.0 * phi * theta + theta**2)


def _weighted_models(residual: Floats, columns: Floats) -> tuple[Floats, list[Floats]]:
    """Compute the weight of each model, and its covariance of the time segments, (n, n) each."""
    n, models = len(residual), arma_likelihoods(residual, columns)
    if not len(models):
        return np.ones(1), [np.eye(n) * float(residual @ residual) / max(n - columns.shape[1], 1)]
    lags = lag_matrix(n)
    weight = np.exp(-np.minimum(models[:, 0] - models[:, 0].min(), 20.0))  # of likelihoods that are distinguished
    return weight / weight.sum(), [model[3] * arma_correlation(model[1], model[2], lags) for model in models]


MIN_ROBUST = 30  # residuals from which the median absolute deviation gives a width within a fifth
SLOW_KN = np.concatenate([[0.0], np.geomspace(0.3, 30.0, 14)])  # candidate speeds of equal constant and slow scatter
MIN_SCATTER_DEG = 1e-3  # degrees; no compass has a finer resolution, and exact agreement means copied data


@dataclass(frozen=True)
class SwingNoise:
    """Scatter of the residuals of one kind of observation."""

    sigma: Floats  # (n,) of each residual
    phi: float = 0.0  # autoregressive coefficient of the blocks' means
    theta: float = 0.0  # moving-average coefficient
    level: float = 1.0  # variance of a block's mean over that of a residual
    n_effective: float = 0.0  # effective number of independent residuals
    dof: float = np.inf  # degrees of freedom of the scatter
    weight: float = 1.0  # information of a row relative to an independent one


def estimate_swing_noise(
    residual: Floats, basis: Floats, *, speed_kn: Floats | None, blocks: Ints | None
) -> SwingNoise:
    """Estimate the scatter, with its correlation by restricted likelihood if blocks are given.

    Args:
        basis: (n, rank) orthonormal basis of what the fit can absorb.
        speed_kn: (n,) speed, for courses that scatter more when slow; None for constant scatter.
        blocks: (n,) number of each residual's block in time; None if residuals are independent.
    """
    n, rank = basis.shape
    if n < MIN_ROBUST:
        flat = np.full(n, np.sqrt(np.sum(residual**2) / max(n - rank, 1)))
        return SwingNoise(np.maximum(flat, MIN_SCATTER_DEG), n_effective=float(n), dof=float(n - rank))
    shape, clipped = _scatter_shape(residual, speed_kn)
    scale = np.sqrt(np.sum((clipped / shape) ** 2) / (n - rank))
    noise = SwingNoise(np.maximum(shape * scale, MIN_SCATTER_DEG))
    unclipped = float(np.mean(residual == clipped))  # Huber's estimate has the variance of the unclipped residuals
    if blocks is None:
        return replace(noise, sigma=noise.sigma / unclipped, n_effective=float(n), dof=float(n - rank))
    columns = span_basis(basis / noise.sigma[:, None])
    noise = _correlated(noise, _block_means(clipped / noise.sigma, blocks), _block_means(columns, blocks))
    noise = replace(noise, level=noise.level / unclipped**2)
    fitted = columns if rank else np.full((n, 1), n**-0.5)
    weight = min(fitted.shape[1] / float(np.trace(score_covariance(fitted, noise, blocks))), 1.0)
    return replace(noise, n_effective=weight * n, dof=max(weight * n - rank, MIN_DOF), weight=weight)


def score_covariance(rows: Floats, noise: SwingNoise, blocks: Ints | None) -> Floats:
    """Compute the covariance, (k, k), of sums of rows, (n, k) in order of time, times residuals over their scatter."""
    if blocks is None:
        return rows.T @ rows
    summed = block_sums(rows, blocks)
    return noise.level * summed.T @ arma_correlation(noise.phi, noise.theta, lag_matrix(len(summed))) @ summed


def clip_residuals(residual: Floats, noise: SwingNoise) -> Floats:
    """Clip residuals, (n,), to a few standard deviations (Huber's pseudo-observations)."""
    if len(residual) < MIN_ROBUST:
        return residual
    bound = HUBER_CLIP * noise.sigma
    return np.clip(residual, -bound, bound)


def _scatter_shape(residual: Floats, speed_kn: Floats | None) -> tuple[Floats, Floats]:
    """Fit the scatter of each residual, with the maximum-likelihood share of slowness, and clip the residuals by it."""
    slowness = np.zeros(residual.shape) if speed_kn is None else 1.0 / np.maximum(speed_kn, 0.1)
    best, best_fit = np.inf, (residual, residual)
    for equal_kn in SLOW_KN if speed_kn is not None else SLOW_KN[:1]:
        shape = np.hypot(1.0, equal_kn * slowness)
        scale = robust_width(residual / shape) + 1e-9
        clipped = np.clip(residual, -HUBER_CLIP * scale * shape, HUBER_CLIP * scale * shape)
        loss = float(np.sum(np.log(shape)) + 0.5 * len(shape) * np.log(np.mean((clipped / shape) ** 2) + 1e-18))
        if loss < best:
            best, best_fit = loss, (scale * shape, clipped)
    return best_fit


def _correlated(noise: SwingNoise, means: Floats, columns: Floats) -> SwingNoise:
    """Fit correlation and level of the blocks' means by restricted likelihood; no correlation if blocks are too few.

    Of the models within half a standard error of the maximum likelihood the one with the slowest noise is used: too
    short a correlation understates the uncertainty, while too long a one hardly overstates it.
    """
    models = arma_likelihoods(means, columns)
    if not len(models):
        return noise
    _, phi, theta, level = models[models[:, 0] <= models[:, 0].min() + 0.125].T
    slowest = np.argmax(level * (1.0 + 2.0 * _first_lag(phi, theta) / (1.0 - phi)))  # spectrum at frequency zero
    return replace(noise, phi=float(phi[slowest]), theta=float(theta[slowest]), level=float(level[slowest]))


def _block_means(values: Floats, blocks: Ints) -> Floats:
    count = np.bincount(blocks)
    return block_sums(values, blocks) / (count if values.ndim == 1 else count[:, None])
