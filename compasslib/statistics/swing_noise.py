"""Noise of a swing: wider at low speed, correlated from second to second, with outliers.

A helmsman's wandering, the swell and a receiver's filter correlate neighbouring residuals. Means over blocks of 20 s
are free of most of the swing about the course; the correlation that is left between blocks is an ARMA(1, 1) series. It
widens the covariance; it does not steer the fit, because a filter to independence would weigh most what a boat does
within seconds, where the course lags behind the compass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compasslib.statistics import arma, robust
from compasslib.statistics.arma import Ints, orthonormal
from compasslib.statistics.blocks import sums
from compasslib.types import Floats

FEWEST_ROBUST = 30  # residuals from which a median tells a width within a fifth
SLOW_KN = np.concatenate([[0.0], np.geomspace(0.3, 30.0, 14)])  # speeds at which both parts of the scatter are equal
TINY = 1e-3  # degrees of scatter; no compass reads finer, and what agrees to the last digit was copied
LIKELIHOOD_TOLERANCE = 0.125  # of log likelihood: half a standard error


@dataclass(frozen=True)
class SwingNoise:
    """Scatter of the residuals of one kind of observation."""

    sigma: Floats  # (n,) of each residual
    phi: float = 0.0  # autoregressive coefficient of the blocks' means
    theta: float = 0.0  # moving-average coefficient
    level: float = 1.0  # variance of a block's mean over that of a residual
    n_effective: float = 0.0  # independent residuals that would say as much
    dof: float = np.inf  # degrees of freedom of the scatter
    weight: float = 1.0  # information of a row over that of an independent one


def estimate(residual: Floats, basis: Floats, *, speed_kn: Floats | None, blocks: Ints | None) -> SwingNoise:
    """Return the scatter, by restricted likelihood where residuals are correlated.

    Args:
        residual: (n,) of the present fit.
        basis: (n, rank) orthonormal, what the fit can take up.
        speed_kn: (n,) where slow courses scatter more.
        blocks: (n,) number of each residual's block in time; None where they are independent.
    """
    n, rank = basis.shape
    if n < FEWEST_ROBUST:
        flat = np.full(n, np.sqrt(np.sum(residual**2) / max(n - rank, 1)))
        return SwingNoise(np.maximum(flat, TINY), n_effective=float(n), dof=float(n - rank))
    shape, clipped = _shape(residual, speed_kn)
    scale = np.sqrt(np.sum((clipped / shape) ** 2) / (n - rank))
    noise = SwingNoise(np.maximum(shape * scale, TINY))
    kept = float(np.mean(residual == clipped))  # Huber's estimate varies as if the clipped ones were not there
    if blocks is None:
        return replace(noise, sigma=noise.sigma / kept, n_effective=float(n), dof=float(n - rank))
    columns = orthonormal(basis / noise.sigma[:, None])
    noise = _correlated(noise, _means(clipped / noise.sigma, blocks), _means(columns, blocks))
    noise = replace(noise, level=noise.level / kept**2)
    fitted = columns if rank else np.full((n, 1), n**-0.5)
    weight = min(fitted.shape[1] / float(np.trace(spread(fitted, noise, blocks))), 1.0)
    return replace(noise, n_effective=weight * n, dof=max(weight * n - rank, arma.FEWEST_DOF), weight=weight)


def spread(rows: Floats, noise: SwingNoise, blocks: Ints | None) -> Floats:
    """Return the covariance of the sums of rows times residuals, (k, k), for rows over their scatter.

    Args:
        rows: (n, k) in order of time, over the scatter.
        blocks: (n,) number of each row's block in time, without gaps; None where rows are independent.
    """
    if blocks is None:
        return rows.T @ rows
    summed = sums(rows, blocks)
    return noise.level * summed.T @ arma.correlation(noise.phi, noise.theta, arma.lags_between(len(summed))) @ summed


def clip(residual: Floats, noise: SwingNoise) -> Floats:
    """Return residuals that count no more than a few standard deviations (Huber's pseudo-observations).

    Args:
        residual: (n,).
    """
    if len(residual) < FEWEST_ROBUST:
        return residual
    bound = robust.CLIP * noise.sigma
    return np.clip(residual, -bound, bound)


def _shape(residual: Floats, speed_kn: Floats | None) -> tuple[Floats, Floats]:
    """Return the scatter of each residual and the residuals clipped by it, the likeliest share of slowness taken."""
    slowness = np.zeros(residual.shape) if speed_kn is None else 1.0 / np.maximum(speed_kn, 0.1)
    best, found = np.inf, (residual, residual)
    for equal_kn in SLOW_KN if speed_kn is not None else SLOW_KN[:1]:
        shape = np.hypot(1.0, equal_kn * slowness)
        scale = robust.width(residual / shape) + 1e-9
        clipped = np.clip(residual, -robust.CLIP * scale * shape, robust.CLIP * scale * shape)
        loss = float(np.sum(np.log(shape)) + 0.5 * len(shape) * np.log(np.mean((clipped / shape) ** 2) + 1e-18))
        if loss < best:
            best, found = loss, (scale * shape, clipped)
    return found


def _correlated(noise: SwingNoise, means: Floats, columns: Floats) -> SwingNoise:
    """Fit correlation and level of the blocks' means by restricted likelihood; none where the blocks are too few.

    Of the models as likely as the likeliest but for half a standard error the one of the slowest noise is taken: too
    short a correlation understates the uncertainty, too long a one hardly overstates it.
    """
    tried = arma.likelihoods(means, columns)
    if not len(tried):
        return noise
    likely = tried[tried[:, 0] <= tried[:, 0].min() + LIKELIHOOD_TOLERANCE]
    _, phi, theta, level = max(likely.tolist(), key=lambda each: each[3] * arma.low_frequency_power(each[1], each[2]))
    return replace(noise, phi=phi, theta=theta, level=level)


def _means(values: Floats, blocks: Ints) -> Floats:
    count = np.bincount(blocks)
    return sums(values, blocks) / (count if values.ndim == 1 else count[:, None])
