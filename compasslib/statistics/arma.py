"""ARMA(1, 1) noise: stretches of a record whose residuals are correlated for minutes.

A record of a quarter of an hour holds a dozen independent stretches: a bootstrap of it would hold no distribution.
Draws therefore come from the model itself, and each from another one as likely as the record makes it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Floats

Ints = NDArray[np.int_]

PHI = np.concatenate([[0.0], 1.0 - np.geomspace(0.85, 0.05, 14)])  # autoregressive coefficients that are tried
THETA = np.array([0.0, -0.2, -0.4, -0.6, -0.8])  # moving-average coefficients that are tried
FEWEST_DOF = 3.0  # of Student's law, which has a variance from there
LIKELIHOOD_RANGE = 20.0  # units of log likelihood beyond which a model is hardly ever drawn
RANK_TOLERANCE = 1e-6  # of the largest direction


def likelihoods(residual: Floats, columns: Floats) -> Floats:
    """Return minus log restricted likelihood, phi, theta and variance of each model, (models, 4); none of too few data.

    Args:
        residual: (n,).
        columns: that the fit can take up, (n, k).
    """
    columns = orthonormal(columns)
    dof = len(residual) - columns.shape[1]
    if dof < FEWEST_DOF:
        return np.zeros((0, 4))
    rows, tried = np.column_stack([columns, residual]), []
    lags = lags_between(len(residual))
    for phi in PHI:
        for theta in THETA[np.greater_equal(THETA, -phi)]:
            lower = np.linalg.cholesky(correlation(phi, theta, lags))
            upper = np.asarray(np.linalg.qr(np.linalg.solve(lower, rows), mode="r"))
            size = np.log(np.abs(np.diag(upper)) + 1e-12)
            loss = dof * size[-1] + float(np.sum(size[:-1])) + float(np.sum(np.log(np.diag(lower))))
            tried.append((loss, float(phi), float(theta), float(upper[-1, -1] ** 2) / dof))
    return np.array(tried)


def correlation(phi: float, theta: float, lags: Ints) -> Floats:
    """Return the correlation of an ARMA(1, 1) series.

    Args:
        phi: autoregressive coefficient.
        theta: moving-average coefficient.
    """
    return np.where(lags == 0, 1.0, _first_lag(phi, theta) * phi ** np.maximum(lags - 1, 0))


def first_variance(law: tuple[float, float]) -> float:
    """Return the variance of an ARMA(1, 1) series over that of its innovations.

    Args:
        law: autoregressive and moving-average coefficient.
    """
    phi, theta = law
    return (1.0 + 2.0 * phi * theta + theta**2) / (1.0 - phi**2)


def filtered(columns: Floats, law: tuple[float, float]) -> Floats:
    """Return the innovations that an ARMA(1, 1) law makes of evenly sampled columns, (n, k).

    The first sample is taken over its own variance, and foretells its own innovation.

    Args:
        columns: (n, k).
        law: autoregressive and moving-average coefficient.
    """
    from scipy.signal import lfilter

    phi, theta = law
    if not phi and not theta:
        return columns
    first = first_variance(law)
    begun = lfilter([1.0, -phi], [1.0, theta], columns[1:], axis=0, zi=-(phi + theta / first) * columns[:1])[0]
    return np.concatenate([columns[:1] / np.sqrt(first), begun])


def low_frequency_power(phi: float, theta: float) -> float:
    """Return the spectrum of an ARMA(1, 1) series at frequency zero over its variance."""
    return 1.0 + 2.0 * _first_lag(phi, theta) / (1.0 - phi)


def lags_between(n: int) -> Ints:
    """Return how many steps n samples are apart, (n, n)."""
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))


def orthonormal(columns: Floats, least: float = 0.0) -> Floats:
    """Return an orthonormal basis of what columns span, directions without length left out.

    Args:
        columns: (n, k).
        least: length that a direction must have.
    """
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > max(least, RANK_TOLERANCE * size.max(initial=0.0))]


def draws(residual: Floats, columns: Floats, seed: int, repeats: int) -> Floats:
    """Return draws of the noise, each by a model that is drawn too, (repeats, n) of unit variance.

    Args:
        residual: of the hypothesis, a stretch each, (n,).
        columns: that its fit takes up, (n, k).
    """
    rng, n = np.random.default_rng(seed), len(residual)
    models = likelihoods(residual, columns)
    made = rng.normal(size=(repeats, n))
    if not len(models):
        return made
    which, lags = rng.choice(len(models), repeats, p=_weight(models)), lags_between(n)
    for model in np.unique(which):
        lower = np.linalg.cholesky(correlation(float(models[model, 1]), float(models[model, 2]), lags))
        made[which == model] = made[which == model] @ lower.T
    return made


def covariance(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of least squares, averaged over the models by their likelihood, (k, k).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    size = np.linalg.norm(columns, axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    unit = columns / scale
    solved = unit @ np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    weight, each = _weighted_models(residual, columns)
    spread = np.stack([solved.T @ of_noise @ solved for of_noise in each])
    own = np.log(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 1e-300))
    middle = np.tensordot(weight, spread, 1)
    # The mean of variances over models is that of the slowest; their middle is that of their logarithms.
    share = np.exp(weight @ own / 2.0) / np.sqrt(np.maximum(np.diagonal(middle), 1e-300)) / scale
    return np.asarray(middle * np.outer(share, share))


def whitening_matrix(residual: Floats, columns: Floats) -> Floats:
    """Return what makes stretches independent by the mean covariance of the models, (n, n).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, c).
    """
    return np.asarray(np.linalg.inv(np.linalg.cholesky(_noise_covariance(residual, columns))))


def standard_errors(residual: Floats, columns: Floats, weights: Floats) -> Floats:
    """Return the standard errors of weighted sums of stretches, (k,).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, c).
        weights: (n, k).
    """
    return np.sqrt(np.einsum("nk,nm,mk->k", weights, _noise_covariance(residual, columns), weights))


def effective_number(residual: Floats, columns: Floats) -> float:
    """Return how many independent stretches would say as much of a mean.

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    of_noise = _noise_covariance(residual, columns)
    return float(len(residual) * np.trace(of_noise) / of_noise.sum())


def _first_lag(phi: float, theta: float) -> float:
    """Return the correlation of an ARMA(1, 1) series at lag one."""
    return (1.0 + phi * theta) * (phi + theta) / (1.0 + 2.0 * phi * theta + theta**2)


def _noise_covariance(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of the stretches, the mean over the models by their likelihood, (n, n)."""
    weight, each = _weighted_models(residual, columns)
    return np.asarray(np.tensordot(weight, np.stack(each), 1))


def _weighted_models(residual: Floats, columns: Floats) -> tuple[Floats, list[Floats]]:
    """Return the weight of each model, and the covariance of the stretches by it, (n, n) each."""
    n, models = len(residual), likelihoods(residual, columns)
    if not len(models):
        return np.ones(1), [np.eye(n) * float(residual @ residual) / max(n - columns.shape[1], 1)]
    lags = lags_between(n)
    return _weight(models), [model[3] * correlation(model[1], model[2], lags) for model in models]


def _weight(models: Floats) -> Floats:
    weight = np.exp(-np.minimum(models[:, 0] - models[:, 0].min(), LIKELIHOOD_RANGE))
    return np.asarray(weight / weight.sum())
