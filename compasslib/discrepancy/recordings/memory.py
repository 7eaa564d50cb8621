"""Noise that remembers: stretches of a record whose residuals are alike for minutes, as an ARMA(1, 1) series.

A record of a quarter of an hour holds a dozen independent stretches: drawn from itself it would hold no distribution.
Draws therefore come from the law itself, and each from another one as likely as the record makes it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration import swing_noise

Floats = NDArray[np.floating]

WIDEST = 20.0  # units of log likelihood beyond which a law is never drawn


def draws(residual: Floats, columns: Floats, seed: int, repeats: int) -> Floats:
    """Return draws of the noise, each by a law that is drawn too, (repeats, n) of unit variance.

    Args:
        residual: of the hypothesis, a stretch each, (n,).
        columns: that its fit takes up, (n, k).
        seed: of the draws.
        repeats: number of draws.
    """
    rng, n = np.random.default_rng(seed), len(residual)
    laws = swing_noise.likelihoods(residual, columns)
    made = rng.normal(size=(repeats, n))
    if not len(laws):
        return made
    which, apart = rng.choice(len(laws), repeats, p=_weight(laws)), _apart(n)
    for law in np.unique(which):
        lower = np.linalg.cholesky(swing_noise.correlation(*laws[law, 1:3], apart))
        made[which == law] = made[which == law] @ lower.T
    return made


def covariance(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of least squares, over the laws as likely as the record makes them, (k, k).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    inverse = np.linalg.pinv(columns.T @ columns / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    middle = (columns / scale).T @ _alike(residual, columns) @ (columns / scale)
    return np.asarray(inverse @ middle @ inverse / np.outer(scale, scale))


def effective(residual: Floats, columns: Floats) -> float:
    """Return how many independent stretches would say as much of a mean.

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    alike, n = _alike(residual, columns), len(residual)
    return float(n * np.trace(alike) / alike.sum())


def _alike(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of the stretches, the mean of the laws', (n, n)."""
    n, laws = len(residual), swing_noise.likelihoods(residual, columns)
    if not len(laws):
        return np.eye(n) * float(residual @ residual) / max(n - columns.shape[1], 1)
    weight, apart = _weight(laws), _apart(n)
    return np.sum(
        [w * law[3] * swing_noise.correlation(law[1], law[2], apart) for w, law in zip(weight, laws, strict=True)],
        axis=0,
    )


def _weight(laws: Floats) -> Floats:
    weight = np.exp(-np.minimum(laws[:, 0] - laws[:, 0].min(), WIDEST))
    return np.asarray(weight / weight.sum())


def _apart(n: int) -> NDArray[np.int_]:
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
