"""How alike a series is to itself later, and how few independent values it is worth."""

from __future__ import annotations

import numpy as np

from compasslib.types import Floats


def effective_number(residual: Floats, time_s: Floats, *, longest_s: float = 5 * 86400.0) -> float:
    """Return n over the integral of the residual's autocorrelation, which real currents make much less than n.

    Args:
        residual: standardised residuals, (n,).
        longest_s: longest lag that is looked at, seconds.
    """
    n = len(residual)
    if n < 3:
        return float(n)
    step = float(np.median(np.diff(time_s)))
    slot = np.rint((time_s - time_s[0]) / step).astype(int)
    series, present = np.zeros(slot[-1] + 1), np.zeros(slot[-1] + 1)
    series[slot], present[slot] = residual - residual.mean(), 1.0
    lags = min(int(longest_s / step), len(series) // 3)
    together = lagged(present, lags)
    rho = lagged(series, lags) / np.maximum(together, 1.0)
    if not rho[0] > 0.0:  # one value throughout, as of a sensor that is stuck
        return 1.0
    rho = np.where(together > 0.02 * n, rho, 0.0) / rho[0]
    return float(np.clip(n / (1.0 + 2.0 * _positive_sum(rho[1:])), 1.0, n))


def lagged(x: Floats, lags: int) -> Floats:
    """Return the sums of a series times itself 0, 1, ... steps later, (lags + 1,).

    Args:
        x: the series, 0 where nothing was measured.
        lags: the most steps.
    """
    size = 1 << (2 * len(x) - 1).bit_length()
    spectrum = np.fft.rfft(x, size)
    return np.fft.irfft(np.abs(spectrum) ** 2, size)[: lags + 1]


def _positive_sum(rho: Floats) -> float:
    """Sum neighbouring pairs of the autocorrelation while they stay positive (Geyer's initial positive sequence)."""
    pairs = rho[: len(rho) // 2 * 2].reshape(-1, 2).sum(axis=1)
    stop = np.flatnonzero(pairs <= 0)
    return float(pairs[: stop[0]].sum() if stop.size else pairs.sum())
