"""Noise that remembers: stretches of a record whose residuals are alike for minutes, as an ARMA(1, 1) series.

A record of a quarter of an hour holds a dozen independent stretches: drawn from itself it would hold no distribution.
Draws therefore come from the law itself, and each from another one as likely as the record makes it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats
from compasslib.stats import clipping

WIDEST = 20.0  # units of log likelihood beyond which a law is never drawn


def draws(residual: Floats, columns: Floats, seed: int, repeats: int) -> Floats:
    """Return draws of the noise, each by a law that is drawn too, (repeats, n) of unit variance.

    Args:
        residual: of the hypothesis, a stretch each, (n,).
        columns: that its fit takes up, (n, k).
    """
    rng, n = np.random.default_rng(seed), len(residual)
    laws = clipping.likelihoods(residual, columns)
    made = rng.normal(size=(repeats, n))
    if not len(laws):
        return made
    which, apart = rng.choice(len(laws), repeats, p=_weight(laws)), _apart(n)
    for law in np.unique(which):
        lower = np.linalg.cholesky(clipping.correlation(float(laws[law, 1]), float(laws[law, 2]), apart))
        made[which == law] = made[which == law] @ lower.T
    return made


def covariance(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of least squares, over the laws as likely as the record makes them, (k, k).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    size = np.linalg.norm(columns, axis=0)
    scale = np.where(size > 0.0, size, 1.0)
    unit = columns / scale
    solved = unit @ np.linalg.pinv(unit.T @ unit, rcond=1e-10, hermitian=True)
    weight, each = _laws(residual, columns)
    spread = np.stack([solved.T @ alike @ solved for alike in each])
    own = np.log(np.maximum(np.diagonal(spread, axis1=1, axis2=2), 1e-300))
    middle = np.tensordot(weight, spread, 1)
    # The mean of variances over laws is that of the slowest; their middle is that of their logarithms.
    share = np.exp(weight @ own / 2.0) / np.sqrt(np.maximum(np.diagonal(middle), 1e-300)) / scale
    return np.asarray(middle * np.outer(share, share))


def whitener(residual: Floats, columns: Floats) -> Floats:
    """Return what makes stretches independent by the mean of the likely laws, (n, n).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, c).
    """
    weight, each = _laws(residual, columns)
    lower = np.linalg.cholesky(np.tensordot(weight, np.stack(each), 1))
    return np.asarray(np.linalg.inv(lower))


def of_sums(residual: Floats, columns: Floats, weights: Floats) -> Floats:
    """Return the standard errors of weighted sums of stretches, (k,).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, c).
        weights: (n, k).
    """
    weight, each = _laws(residual, columns)
    alike = np.tensordot(weight, np.stack(each), 1)
    return np.sqrt(np.einsum("nk,nm,mk->k", weights, alike, weights))


def effective(residual: Floats, columns: Floats) -> float:
    """Return how many independent stretches would say as much of a mean.

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    weight, each = _laws(residual, columns)
    alike, n = np.tensordot(weight, np.stack(each), 1), len(residual)
    return float(n * np.trace(alike) / alike.sum())


def _laws(residual: Floats, columns: Floats) -> tuple[Floats, list[Floats]]:
    """Return how likely each law is, and the covariance of the stretches by it, (n, n) each."""
    n, laws = len(residual), clipping.likelihoods(residual, columns)
    if not len(laws):
        return np.ones(1), [np.eye(n) * float(residual @ residual) / max(n - columns.shape[1], 1)]
    apart = _apart(n)
    return _weight(laws), [law[3] * clipping.correlation(law[1], law[2], apart) for law in laws]


def _weight(laws: Floats) -> Floats:
    weight = np.exp(-np.minimum(laws[:, 0] - laws[:, 0].min(), WIDEST))
    return np.asarray(weight / weight.sum())


def _apart(n: int) -> NDArray[np.int_]:
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
