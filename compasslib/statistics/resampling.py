"""Block-based statistics of correlated samples, and the resolution of recorded angles."""

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Bools, Floats

NORMAL_95 = 1.959964  # two-sided 95 % quantile of the normal distribution
EVEN_BLOCKS = 10.0  # pseudo-count of blocks in shrinking a group's variance inflation


def blocks_by_count(time_s: Floats, count: int) -> NDArray[np.intp]:
    """Assign samples to a number of blocks of equal duration, (n,) block numbers."""
    share = (time_s - time_s[0]) / max(float(np.ptp(time_s)), 1e-9)
    return np.minimum((share * count).astype(np.intp), count - 1)


def blocks_by_span(time_s: Floats, span_s: float) -> NDArray[np.intp]:
    """Assign samples to blocks of given duration from the first sample on, (n,) block numbers."""
    return np.floor((time_s - time_s[0]) / span_s).astype(np.intp)


def block_sums(rows: Floats, block: NDArray[np.intp]) -> Floats:
    """Sum the rows of each non-empty block, (b, ...)."""
    order = np.argsort(block, kind="stable")
    return np.add.reduceat(rows[order], np.flatnonzero(np.diff(block[order], prepend=-1)), axis=0)


def resample_blocks(series: Floats, length: int, repeats: int, seed: int) -> Floats:
    """Resample a series from its blocks at random positions and with random signs, (repeats, n)."""
    rng, n = np.random.default_rng(seed), len(series)
    count = -(-n // length)
    begin = rng.integers(0, n, (repeats, count))
    sign = rng.choice([-1.0, 1.0], (repeats, count)).astype(series.dtype)
    windows = np.lib.stride_tricks.sliding_window_view(np.concatenate([series, series]), length)
    return np.asarray((windows[begin] * sign[:, :, None]).reshape(repeats, -1)[:, :n])


def cluster_variance_inflation(
    basis: Floats, residual: Floats, block: NDArray[np.intp], variance: float
) -> tuple[float, float]:
    """Compute a group's variance inflation relative to homogeneous noise, and its effective number of blocks."""
    # Cluster-robust (sandwich; Liang and Zeger, Biometrika 73, 13, 1986).
    k = basis.shape[1]
    held = block_sums(np.sum(basis**2, axis=1), block) / k
    concentration = float(np.sum(held**2))
    left = residual - basis @ (basis.T @ residual)
    scores = block_sums(basis * left[:, None], block)
    return float(np.sum(scores**2)) / k / variance / max(1.0 - concentration, 0.1), 1.0 / concentration


def block_jackknife(rows: Floats, pulls: Floats, block: NDArray[np.intp], information: Floats) -> Floats:
    """Estimate the covariance of parameters by the block jackknife, with one Newton step per block from the full fit.

    It is the estimator CR3 of Bell and McCaffrey (Survey Methodology 28, 169, 2002), which does not underestimate the
    covariance if there are few blocks.

    Args:
        rows: rows whose outer products sum to the information, (n, p).
        pulls: contribution of each sample to the gradient, (n, p).
    """
    members = [block == b for b in np.unique(block)]
    moved = np.array(
        [
            np.linalg.lstsq(information - rows[member].T @ rows[member], pulls[member].sum(axis=0))[0]
            for member in members
        ]
    )
    return np.asarray(moved.T @ moved * (len(members) - 1) / len(members))


def student_factor(freedom: float) -> float:
    """Compute the factor on a standard deviation from few residuals for which 1.96 of it is a 95 % interval."""
    from scipy.special import stdtrit

    return float(stdtrit(max(freedom, 1.0), 0.975)) / NORMAL_95


def adjacent(windows: Bools) -> Bools:
    """Find the windows that directly precede or follow a selected one, (w,)."""
    return np.append(windows[1:], False) | np.append(False, windows[:-1])


def angle_resolution(angle_deg: Floats) -> Floats:
    """Estimate the resolution of angles from runs of 500, (n,) degrees; 0 where it is too fine to repeat values."""
    step = np.zeros(angle_deg.shape)
    known = np.flatnonzero(np.isfinite(angle_deg))
    for run in np.array_split(known, max(1, len(known) // 500)):
        values = np.unique(angle_deg[run].round(2))
        if len(run) > 250 and 2 < len(values) < 0.4 * len(run):
            step[run[0] : run[-1] + 1] = np.median(np.diff(values))
    return step
