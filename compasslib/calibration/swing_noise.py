"""Noise of a swing: wider at low speed, alike from second to second, with outliers.

A helmsman's wandering and a receiver's filter make neighbouring residuals alike. An autoregression with a moving average
of first order stands for both. It widens the covariance; it does not steer the fit, because a filter to independence
would weigh most what a boat does within seconds, where the course lags behind the compass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]

CLIP = 2.5  # residuals count no more than this many standard deviations (Huber)
FEWEST_ROBUST, FEWEST_CORRELATED = 30, 60
SLOW_KN = np.concatenate([[0.0], np.geomspace(0.3, 30.0, 14)])  # speeds at which both parts of the scatter are equal
MEMORY = np.concatenate([[0.0], 1.0 - np.geomspace(0.6, 0.01, 16)])  # of the autoregression, a sample
SHARE = np.array([0.0, -0.2, -0.4, -0.55, -0.7, -0.8, -0.9])  # of the moving average
RANK_TOLERANCE, TINY = 1e-6, 1e-6
FEWEST_DOF = 3.0


@dataclass(frozen=True)
class Noise:
    """Scatter of the residuals of one kind of observation."""

    sigma: Floats  # (n,) of each residual
    memory: float = 0.0
    share: float = 0.0
    n_effective: float = 0.0  # independent residuals that would say as much
    dof: float = np.inf  # degrees of freedom of the scatter
    weight: float = 1.0  # information of a row over that of an independent one


def spread(rows: Floats, noise: Noise, starts: NDArray[np.int_] | None) -> Floats:
    """Return the covariance of the sums of rows times residuals, (k, k), for rows over their scatter.

    Args:
        rows: (n, k) in order of time, over the scatter.
        noise: scatter and memory.
        starts: first rows of the stretches without gap.
    """
    if starts is None or noise.memory == 0.0:
        return rows.T @ rows
    from scipy.signal import lfilter  # only logs pay for it

    total = np.zeros((rows.shape[1], rows.shape[1]))
    for begin, end in zip(starts, np.append(starts[1:], len(rows)), strict=True):
        # R = L L^T with L the filter from independent rows to alike ones, so that R's quadratic form runs backwards.
        back = lfilter([1.0, noise.share], [1.0, -noise.memory], rows[begin:end][::-1], axis=0)
        total += _innovation(noise.memory, noise.share) * back.T @ back
        before = (noise.memory * back[-1] + noise.share * rows[begin]) / np.sqrt(1.0 - noise.memory**2)  # the past's
        total += _innovation(noise.memory, noise.share) * np.outer(before, before)
    return total


def estimate(
    residual: Floats, basis: Floats, *, speed_kn: Floats | None, starts: NDArray[np.int_] | None
) -> Noise:
    """Return the scatter by restricted likelihood, which allows for what the fit has taken up.

    Args:
        residual: (n,) of the present fit.
        basis: (n, rank) orthonormal, what the fit can take up.
        speed_kn: (n,) where slow courses scatter more.
        starts: first rows of the stretches without gap; None where the order of the rows says nothing.
    """
    n, rank = basis.shape
    if n < FEWEST_ROBUST:
        flat = np.full(n, np.sqrt(np.sum(residual**2) / max(n - rank, 1)))
        return Noise(np.maximum(flat, TINY), n_effective=float(n), dof=float(n - rank))
    shape, clipped = _shape(residual, speed_kn)
    standard, columns = clipped / shape, orthonormal(basis / shape[:, None])
    correlated = starts is not None and n >= FEWEST_CORRELATED
    memory, share = _memory(standard, columns, starts) if correlated else (0.0, 0.0)
    huber = float(np.mean(residual == clipped))
    left = _left(_filtered(np.column_stack([columns, standard]), memory, share, starts))
    scale = np.sqrt(left / (n - rank) / _innovation(memory, share)) / huber
    noise = Noise(np.maximum(shape * scale, TINY), memory, share)
    told = columns if rank else np.full((n, 1), n**-0.5)
    weight = min(told.shape[1] / float(np.trace(spread(told, noise, starts))), 1.0)
    return replace(noise, n_effective=weight * n, dof=max(weight * n - rank, FEWEST_DOF), weight=weight)


def clip(residual: Floats, noise: Noise) -> Floats:
    """Return residuals that count no more than a few standard deviations (Huber's pseudo-observations).

    Args:
        residual: (n,).
        noise: their scatter.
    """
    if len(residual) < FEWEST_ROBUST:
        return residual
    bound = CLIP * noise.sigma
    return np.clip(residual, -bound, bound)


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


def _memory(standard: Floats, basis: Floats, starts: NDArray[np.int_]) -> tuple[float, float]:
    rows, dof = np.column_stack([basis, standard]), len(standard) - basis.shape[1]
    best, found = np.inf, (0.0, 0.0)
    for memory in MEMORY:
        for share in SHARE if memory > 0.0 else SHARE[:1]:
            if memory + share < 0.0:
                continue
            upper = np.linalg.qr(_filtered(rows, memory, share, starts), mode="r")
            size = np.log(np.abs(np.diag(upper)) + 1e-12)
            first = -0.5 * len(starts) * np.log(_innovation(memory, share))
            loss = dof * size[-1] + float(np.sum(size[:-1])) + first
            if loss < best:
                best, found = loss, (float(memory), float(share))
    return found


def _filtered(rows: Floats, memory: float, share: float, starts: NDArray[np.int_] | None) -> Floats:
    """Return the innovations of an ARMA(1, 1) series, stretch by stretch; a stretch's first row keeps its due weight."""
    if memory == 0.0 or starts is None:
        return rows
    from scipy.signal import lfilter  # only logs pay for it

    ends, out = np.append(starts[1:], len(rows)), np.empty_like(rows)
    for begin, end in zip(starts, ends, strict=True):
        out[begin:end] = lfilter([1.0, -memory], [1.0, share], rows[begin:end], axis=0)
    out[starts] *= np.sqrt(_innovation(memory, share))
    return out


def _innovation(memory: float, share: float) -> float:
    return (1.0 - memory**2) / (1.0 + 2.0 * memory * share + share**2)


def _left(rows: Floats) -> float:
    return float(np.linalg.qr(rows, mode="r")[-1, -1] ** 2)


def orthonormal(columns: Floats, least: float = RANK_TOLERANCE) -> Floats:
    """Return an orthonormal basis of what columns span.

    Args:
        columns: (n, k).
        least: singular values that are not greater are left out, over the greatest if that is above 1.
    """
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > least * max(1.0, size.max(initial=0.0))]
