"""Noise of a swing: wider at low speed, alike from second to second, with outliers.

A helmsman's wandering, the swell and a receiver's filter make neighbouring residuals alike. Means over blocks of 20 s
are free of most of the swing about the course; what is left alike between blocks is an autoregression with a moving
average of first order. It widens the covariance; it does not steer the fit, because a filter to independence would
weigh most what a boat does within seconds, where the course lags behind the compass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats

Ints = NDArray[np.int_]

CLIP = 2.5  # residuals count no more than this many standard deviations (Huber)
FEWEST_ROBUST = 30
SLOW_KN = np.concatenate([[0.0], np.geomspace(0.3, 30.0, 14)])  # speeds at which both parts of the scatter are equal
MEMORY = np.concatenate([[0.0], 1.0 - np.geomspace(0.85, 0.05, 14)])  # of the autoregression, from block to block
SHARE = np.array([0.0, -0.2, -0.4, -0.6, -0.8])  # of the moving average
RANK_TOLERANCE = 1e-6
TINY = 1e-3  # degrees of scatter; no compass reads finer, and what holds to the last digit was copied
FEWEST_DOF = 3.0
HALF_AN_ERROR = 0.125  # of log likelihood


@dataclass(frozen=True)
class Noise:
    """Scatter of the residuals of one kind of observation."""

    sigma: Floats  # (n,) of each residual
    memory: float = 0.0  # of the blocks' means
    share: float = 0.0
    level: float = 1.0  # variance of a block's mean over that of a residual
    n_effective: float = 0.0  # independent residuals that would say as much
    dof: float = np.inf  # degrees of freedom of the scatter
    weight: float = 1.0  # information of a row over that of an independent one


def spread(rows: Floats, noise: Noise, blocks: Ints | None) -> Floats:
    """Return the covariance of the sums of rows times residuals, (k, k), for rows over their scatter.

    Args:
        rows: (n, k) in order of time, over the scatter.
        blocks: (n,) number of each row's block in time, without gaps; None where rows are independent.
    """
    if blocks is None:
        return rows.T @ rows
    summed = _summed(rows, blocks)
    apart = np.abs(np.subtract.outer(np.arange(len(summed)), np.arange(len(summed))))
    return noise.level * summed.T @ correlation(noise.memory, noise.share, apart) @ summed


def estimate(residual: Floats, basis: Floats, *, speed_kn: Floats | None, blocks: Ints | None) -> Noise:
    """Return the scatter, by restricted likelihood where residuals are alike.

    Args:
        residual: (n,) of the present fit.
        basis: (n, rank) orthonormal, what the fit can take up.
        speed_kn: (n,) where slow courses scatter more.
        blocks: (n,) number of each residual's block in time; None where they are independent.
    """
    n, rank = basis.shape
    if n < FEWEST_ROBUST:
        flat = np.full(n, np.sqrt(np.sum(residual**2) / max(n - rank, 1)))
        return Noise(np.maximum(flat, TINY), n_effective=float(n), dof=float(n - rank))
    shape, clipped = _shape(residual, speed_kn)
    scale = np.sqrt(np.sum((clipped / shape) ** 2) / (n - rank))
    noise = Noise(np.maximum(shape * scale, TINY))
    kept = float(np.mean(residual == clipped))  # Huber's estimate varies as if the clipped ones were not there
    if blocks is None:
        return replace(noise, sigma=noise.sigma / kept, n_effective=float(n), dof=float(n - rank))
    columns = orthonormal(basis / noise.sigma[:, None])
    noise = _alike(noise, _means(clipped / noise.sigma, blocks), _means(columns, blocks))
    noise = replace(noise, level=noise.level / kept**2)
    told = columns if rank else np.full((n, 1), n**-0.5)
    weight = min(told.shape[1] / float(np.trace(spread(told, noise, blocks))), 1.0)
    return replace(noise, n_effective=weight * n, dof=max(weight * n - rank, FEWEST_DOF), weight=weight)


def clip(residual: Floats, noise: Noise) -> Floats:
    """Return residuals that count no more than a few standard deviations (Huber's pseudo-observations).

    Args:
        residual: (n,).
    """
    if len(residual) < FEWEST_ROBUST:
        return residual
    bound = CLIP * noise.sigma
    return np.clip(residual, -bound, bound)


def orthonormal(columns: Floats, least: float = 0.0) -> Floats:
    """Return an orthonormal basis of what columns span, directions without length left out.

    Args:
        columns: (n, k).
        least: length that a direction must have.
    """
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > max(least, RANK_TOLERANCE * size.max(initial=0.0))]


def _shape(residual: Floats, speed_kn: Floats | None) -> tuple[Floats, Floats]:
    """Return the scatter of each residual and the residuals clipped by it, the likeliest share of slowness taken."""
    slowness = np.zeros(residual.shape) if speed_kn is None else 1.0 / np.maximum(speed_kn, 0.1)
    best, found = np.inf, (residual, residual)
    for equal_kn in SLOW_KN if speed_kn is not None else SLOW_KN[:1]:
        shape = np.hypot(1.0, equal_kn * slowness)
        scale = np.median(np.abs(residual / shape)) / 0.6745 + 1e-9
        clipped = np.clip(residual, -CLIP * scale * shape, CLIP * scale * shape)
        loss = float(np.sum(np.log(shape)) + 0.5 * len(shape) * np.log(np.mean((clipped / shape) ** 2) + 1e-18))
        if loss < best:
            best, found = loss, (scale * shape, clipped)
    return found


def _alike(noise: Noise, means: Floats, columns: Floats) -> Noise:
    """Fit memory and level of the blocks' means by restricted likelihood; blocks wholly alike where there are few.

    Of what is as likely as the likeliest but for half a standard error the slowest noise is taken: too short a memory
    understates the uncertainty, too long a one hardly overstates it.
    """
    tried = likelihoods(means, columns)
    if not len(tried):
        return noise
    likely = tried[tried[:, 0] <= tried[:, 0].min() + HALF_AN_ERROR]
    _, memory, share, level = max(likely.tolist(), key=lambda each: each[3] * _slow(each[1], each[2]))
    return replace(noise, memory=memory, share=share, level=level)


def likelihoods(means: Floats, columns: Floats) -> Floats:
    """Return loss, memory, share and level of each law of the blocks' means, (laws, 4); none where there are too few.

    Args:
        means: of the residuals, (m,).
        columns: that the fit can take up, (m, k).
    """
    columns = orthonormal(columns)
    dof = len(means) - columns.shape[1]
    if dof < FEWEST_DOF:
        return np.zeros((0, 4))
    rows, tried = np.column_stack([columns, means]), []
    apart = np.abs(np.subtract.outer(np.arange(len(means)), np.arange(len(means))))
    for memory in MEMORY:
        for share in SHARE[np.greater_equal(SHARE, -memory)]:
            lower = np.linalg.cholesky(correlation(memory, share, apart))
            upper = np.asarray(np.linalg.qr(np.linalg.solve(lower, rows), mode="r"))
            size = np.log(np.abs(np.diag(upper)) + 1e-12)
            loss = dof * size[-1] + float(np.sum(size[:-1])) + float(np.sum(np.log(np.diag(lower))))
            tried.append((loss, float(memory), float(share), float(upper[-1, -1] ** 2) / dof))
    return np.array(tried)


def _slow(memory: float, share: float) -> float:
    """Return the spectrum of an ARMA(1, 1) series at its slow end over its variance."""
    first = (1.0 + memory * share) * (memory + share) / (1.0 + 2.0 * memory * share + share**2)
    return 1.0 + 2.0 * first / (1.0 - memory)


def correlation(memory: float, share: float, apart: Ints) -> Floats:
    """Return the correlation of an ARMA(1, 1) series at lags.

    Args:
        apart: steps, any shape.
    """
    first = (1.0 + memory * share) * (memory + share) / (1.0 + 2.0 * memory * share + share**2)
    return np.where(apart == 0, 1.0, first * memory ** np.maximum(apart - 1, 0))


def _summed(rows: Floats, blocks: Ints) -> Floats:
    return np.add.reduceat(rows, np.flatnonzero(np.diff(blocks, prepend=-1)), axis=0)


def _means(values: Floats, blocks: Ints) -> Floats:
    count = np.bincount(blocks)
    return _summed(values, blocks) / (count if values.ndim == 1 else count[:, None])
