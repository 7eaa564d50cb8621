"""Blocks of samples that count as one, and the resolution of recorded angles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

NORMAL_95 = 1.959964  # quantile of the normal law
EVEN_BLOCKS = 10.0  # blocks of even noise that a group's own blocks are held against


def blocks_by_count(time_s: Floats, count: int) -> NDArray[np.intp]:
    """Number the equal stretches of time that samples lie in, (n,)."""
    share = (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-9)
    return np.minimum((share * count).astype(np.intp), count - 1)


def blocks_by_span(time_s: Floats, span_s: float) -> NDArray[np.intp]:
    """Number the stretches of some length that samples lie in, counted from the first, (n,)."""
    return np.floor((time_s - time_s[0]) / span_s).astype(np.intp)


def block_sums(rows: Floats, block: NDArray[np.intp]) -> Floats:
    """Sum the rows of each block, (b, ...), those without any left out.

    Args:
        rows: (n, ...).
        block: number of the block of each, from 0, (n,).
    """
    order = np.argsort(block, kind="stable")
    return np.add.reduceat(rows[order], np.flatnonzero(np.diff(block[order], prepend=-1)), axis=0)


def block_scores(basis: Floats, residual: Floats, block: NDArray[np.intp]) -> Floats:
    """Compute the score of each block, (b, k): their squares are a sandwich by clusters.

    The group's own fit is taken out of the residual (Liang and Zeger, Biometrika 73, 13, 1986).

    Args:
        basis: the group's columns, orthonormal, (n, k).
        residual: (n,), in units of the columns' noise.
    """
    left = residual - basis @ (basis.T @ residual)
    return block_sums(basis * left[:, None], block)


def resample_blocks(series: Floats, length: int, repeats: int, seed: int) -> Floats:
    """Draw a series' own noise: blocks of it from other places, turned at random, (repeats, n)."""
    rng, n = np.random.default_rng(seed), len(series)
    count = -(-n // length)
    begin = rng.integers(0, n, (repeats, count))
    sign = rng.choice([-1.0, 1.0], (repeats, count)).astype(series.dtype)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([series, series]), length)
    return np.asarray((windows[begin] * sign[:, :, None]).reshape(repeats, -1)[:, :n])


def cluster_variance_inflation(
    basis: Floats, residual: Floats, block: NDArray[np.intp], variance: float
) -> tuple[float, float]:
    """Compute the variance inflation of a group's block scores over even noise, and its effective number of blocks.

    Args:
        basis: the group's columns, orthonormal, (n, k).
        residual: (n,), in units of the columns' noise.
        variance: of the residual, as if it were even.
    """
    k = basis.shape[1]
    held = block_sums(np.sum(basis**2, axis=1), block) / k
    concentration = float(np.sum(held**2))
    return float(np.sum(block_scores(basis, residual, block) ** 2)) / k / variance / max(
        1.0 - concentration, 0.1
    ), 1.0 / concentration


def block_jackknife(rows: Floats, pulls: Floats, block: NDArray[np.intp], information: Floats) -> Floats:
    """Estimate the covariance of parameters by leaving out each block, by one Newton step from the whole fit.

    It is the estimator CR3 of Bell and McCaffrey (Survey Methodology 28, 169, 2002), which does not flatter itself when
    there are few blocks.

    Args:
        rows: whose products are the information, (n, p).
        pulls: what each sample adds to the gradient, (n, p).
        information: of all samples, (p, p).
    """
    members = [block == b for b in np.unique(block)]
    lesser = [information - rows[member].T @ rows[member] for member in members]
    steps = [np.linalg.lstsq(x, pulls[member].sum(axis=0))[0] for x, member in zip(lesser, members, strict=True)]
    moved = np.array(steps)
    return np.asarray(moved.T @ moved * (len(members) - 1) / len(members))


def student_factor(freedom: float) -> float:
    """Compute by how much a standard deviation from few residuals must grow for 1.96 of it to hold 95 %."""
    from scipy.special import stdtrit

    return float(stdtrit(max(freedom, 1.0), 0.975)) / NORMAL_95


RESOLUTION_RUN = 500  # samples in which the step is looked for
MAX_DISTINCT = 0.4  # distinct values among them; of one that steps by 1 degree there are more


def adjacent(windows: Bools) -> Bools:
    """Find the windows that have a selected one before or after them, (w,)."""
    return np.append(windows[1:], False) | np.append(False, windows[:-1])


def angle_resolution(angle_deg: Floats) -> Floats:
    """Measure the step of a series of angles, sample by sample, (n,) degrees; 0 where it is too fine to tell.

    Args:
        angle_deg: (n,) in order of time, NaN where missing.
    """
    step = np.zeros(angle_deg.shape)
    known = np.flatnonzero(np.isfinite(angle_deg))
    for run in np.array_split(known, max(1, len(known) // RESOLUTION_RUN)):
        values = np.unique(angle_deg[run].round(2))
        if len(run) > RESOLUTION_RUN // 2 and 2 < len(values) < MAX_DISTINCT * len(run):
            step[run[0] : run[-1] + 1] = np.median(np.diff(values))
    return step


def rounding_sigma(step: Floats) -> Floats:
    """Compute the standard error that steps leave, (n,): nobody knows whether they round down, up or to the nearest."""
    return step / np.sqrt(3.0)
