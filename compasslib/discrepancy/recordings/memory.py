"""Noise that remembers: stretches of a record whose residuals are alike for minutes, as an ARMA(1, 1) series.

A record of a quarter of an hour holds a dozen independent stretches: drawn from itself it would hold no distribution.
Draws therefore come from the law itself, and each from another one as likely as the record makes it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.calibration import swing_noise
from compasslib.calibration.swing_noise import Noise

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
    weight = np.exp(-np.minimum(laws[:, 0] - laws[:, 0].min(), WIDEST))
    which, apart = rng.choice(len(laws), repeats, p=weight / weight.sum()), _apart(n)
    for law in np.unique(which):
        lower = np.linalg.cholesky(swing_noise.correlation(*laws[law, 1:3], apart))
        made[which == law] = made[which == law] @ lower.T
    return made


def covariance(residual: Floats, columns: Floats) -> Floats:
    """Return the covariance of least squares by the slowest of the likely laws, (k, k).

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    law = _law(residual, columns)
    inverse = np.linalg.pinv(columns.T @ columns, rcond=1e-12, hermitian=True)
    return np.asarray(inverse @ swing_noise.spread(columns, law, np.arange(len(residual))) @ inverse)


def effective(residual: Floats, columns: Floats) -> float:
    """Return how many independent stretches would say as much of a mean.

    Args:
        residual: of the fit, (n,).
        columns: its derivatives, (n, k).
    """
    law, n = _law(residual, columns), len(residual)
    alike = swing_noise.correlation(law.memory, law.share, _apart(n))
    return float(n**2 / alike.sum())


def _law(residual: Floats, columns: Floats) -> Noise:
    return swing_noise.remembered(Noise(np.ones(len(residual))), residual, columns)


def _apart(n: int) -> NDArray[np.int_]:
    return np.abs(np.subtract.outer(np.arange(n), np.arange(n)))
