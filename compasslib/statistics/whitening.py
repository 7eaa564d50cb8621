"""Whitening of residuals and design columns: division by the width, clipping, and autoregressive filtering.

Hourly currents are correlated over hours to days, and a test that ignores this finds an effect in every record. An
autoregressive filter, fitted to the residual, is applied to residual and columns alike; missing samples are 0 in both,
so gaps reduce the power slightly but cause no bias.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.statistics.least_squares import HUBER_CLIP, SIGMA_PER_MAD, robust_width
from compasslib.statistics.noise import lagged_sums
from compasslib.types import DAY_S, Floats

ORDER = 24  # of the filter: a day of hourly samples
NARROWEST = 0.25  # least width relative to the median one


@dataclass(frozen=True)
class LowRankNoise:
    """Directions in which slow processes make the filtered noise larger than white noise."""

    basis: Floats  # (n, k) orthonormal, float32
    keep: Floats  # (k,) factor on each direction's amplitude that makes it white

    def whiten(self, filtered: Floats) -> Floats:
        """Scale these directions of filtered columns, (n, k), to the variance of all others."""
        basis = self.basis.astype(filtered.dtype)
        return filtered - basis @ ((1.0 - self.keep).astype(filtered.dtype)[:, None] * (basis.T @ filtered))


@dataclass(frozen=True)
class Whitener:
    """Autoregressive filter and widths of one record."""

    slot: NDArray[np.intp]  # (n,) position of each sample on the regular grid
    filter: Floats  # (p + 1,) 1 and minus the autoregressive coefficients
    width_deg: Floats  # (n,) infinite for ignored samples
    low_rank: LowRankNoise | None = None

    def __call__(self, columns_deg: Floats) -> Floats:
        """Divide columns, (n, k) degrees, by the widths and filter them."""
        width = self.width_deg.astype(np.promote_types(columns_deg.dtype, np.float32))  # avoids a copy in float64
        return self.filtered(columns_deg / width[:, None])

    def filtered(self, standard: Floats) -> Floats:
        """Filter columns, (n, k), that are already divided by the widths."""
        chunk = 32  # samples filtered at once, for speed
        lags, width = len(self.filter) - 1, standard.shape[1]
        chunks = -(-(int(self.slot[-1]) + 1) // chunk)
        grid = np.zeros((lags + chunks * chunk, width), dtype=standard.dtype)
        grid[lags + self.slot] = standard
        band = np.zeros((chunk, chunk + lags), dtype=standard.dtype)
        for i in range(chunk):
            band[i, i : i + lags + 1] = self.filter[::-1]
        windows = np.lib.stride_tricks.sliding_window_view(grid, chunk + lags, axis=0)[::chunk].transpose(0, 2, 1)
        filtered = (band @ windows).reshape(chunks * chunk, width)[self.slot]
        return filtered if self.low_rank is None else self.low_rank.whiten(filtered)


def fit_whitener(residual_deg: Floats, width_deg: Floats, time_s: Floats) -> Whitener:
    """Fit the autoregressive filter that whitens a residual; samples of infinite width are ignored.

    A real drift must not be mistaken for autocorrelation of the water: power at periods of weeks is replaced by that at
    neighbouring frequencies. Removing it altogether would leave half as much again of slow noise after filtering.
    """
    slot = grid_positions(time_s)
    standard = clip_standardized(residual_deg, width_deg)
    series, present = np.zeros(slot[-1] + 1), np.zeros(slot[-1] + 1)
    counts, lags = np.isfinite(width_deg), min(ORDER, len(time_s) // 40)  # 40 samples per lag or more
    step_s = sampling_interval_s(time_s)
    knots_s = max(10 * lags * step_s, 10 * DAY_S)  # between which a trend counts as slow
    series[slot[counts]], present[slot[counts]] = standard[counts] - standard[counts].mean(), 1.0
    together = np.maximum(lagged_sums(present, lags), 1.0)
    size = 1 << (2 * len(series) - 1).bit_length()
    power = np.abs(np.fft.rfft(series, size)) ** 2
    slow = np.arange(len(power)) * (2.0 * knots_s / step_s) / size
    near = (slow >= 1.0) & (slow < 4.0)
    power[slow < 1.0] = power[near].mean() if near.any() else 0.0
    correlation = np.fft.irfft(power, size)[: lags + 1] / together
    # The ridge stabilizes the filter where gaps make the autocorrelation rough.
    correlation = correlation / correlation[0] / (1.0 + 1e-3 * (np.arange(lags + 1) > 0))
    toeplitz = correlation[np.abs(np.subtract.outer(np.arange(lags), np.arange(lags)))]
    coefficients = np.linalg.solve(toeplitz, correlation[1:]) if lags else np.zeros(0)
    return Whitener(slot, np.append(1.0, -coefficients), width_deg)


def sampling_interval_s(time_s: Floats) -> float:
    """Compute the median sampling interval, seconds; 0 for a single sample."""
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0


def grid_positions(time_s: Floats) -> NDArray[np.intp]:
    """Compute the position of each sample on a regular grid of the median interval, (n,), with long gaps shortened."""
    apart = np.maximum(np.rint(np.diff(time_s) / sampling_interval_s(time_s)).astype(np.intp), 1)
    return np.concatenate([[0], np.cumsum(np.minimum(apart, 10 * ORDER))]).astype(np.intp)


def clip_standardized(residual_deg: Floats, width_deg: Floats) -> Floats:
    """Divide residuals by their widths and clip them, (n,); 0 for ignored samples.

    Residuals beyond 90 degrees decrease again, to 0 at 180: slow water in the opposite direction is on neither side,
    and its contribution must not jump when a heading changes by a degree.
    """
    known = np.isfinite(width_deg)
    near = angles.wrap180(np.where(known, residual_deg, 0.0))
    folded = np.where(np.abs(near) > 90.0, np.sign(near) * 180.0 - near, near)
    return np.clip(folded / width_deg, -HUBER_CLIP, HUBER_CLIP)


def clip_response(residual_deg: Floats, width_deg: Floats) -> float:
    """Compute the mean response of clipped residuals to a small shift, weighted by the samples' precision."""
    weight = width_deg**-2.0
    falls = np.where(np.abs(angles.wrap180(np.where(weight > 0.0, residual_deg, 0.0))) > 90.0, -1.0, 1.0)
    return float(np.average(falls * (np.abs(clip_standardized(residual_deg, width_deg)) < HUBER_CLIP), weights=weight))


def autoregress(driver: Floats, coefficients: ArrayLike) -> Floats:
    """Solve the autoregression a_0 y(t) + a_1 y(t - 1) + ... = x(t), with a_0 = 1, for y, (n,)."""
    from scipy.linalg.lapack import dtbtrs  # scipy.signal would take a second to import

    band = np.tile(np.asarray(coefficients, dtype=float)[:, None], len(driver))
    return np.asarray(dtbtrs(band, driver[:, None], uplo="L", diag="U")[0][:, 0])


def correlation_time(fitted: Whitener) -> float:
    """Compute the number of samples, up to 512, in which the autocorrelation removed by a filter falls to 1/e."""
    max_memory = 512
    pulse = autoregress(np.eye(1, max_memory)[0], fitted.filter)
    lagged = lagged_sums(pulse, max_memory // 2)
    known = lagged / lagged[0]
    below = int(np.argmax(known < np.exp(-1.0)))
    return below - (np.exp(-1.0) - known[below]) / (known[below - 1] - known[below]) if below else float(max_memory)


def robust_widths(residual_deg: Floats, slowness: Floats) -> Floats:
    """Estimate the robust width of the residual, increasing with slowness, (n,) degrees; infinite where it is NaN."""
    width_bins = 12
    known = np.isfinite(residual_deg)
    size = np.abs(residual_deg[known])
    edges = np.quantile(slowness[known], np.linspace(0.0, 1.0, width_bins + 1))
    bins = np.clip(np.searchsorted(edges, slowness[known], side="right") - 1, 0, width_bins - 1)
    filled = [b for b in range(width_bins) if np.sum(bins == b) >= 5]
    centre = np.array([np.median(slowness[known][bins == b]) for b in filled])
    middle = np.array([robust_width(size[bins == b]) for b in filled])
    middle = np.maximum(np.maximum.accumulate(middle), NARROWEST * np.median(middle))
    width = np.interp(slowness, centre, middle) * _beyond(slowness, centre, middle)
    # Uniform directions are uninformative although their robust width is finite: for a wrapped normal distribution this
    # approximates the information on the mean direction within a fifth.
    width = np.maximum(width, 1e-6)
    with np.errstate(divide="ignore"):
        on_circle = width / np.maximum(1.0 - (width / (SIGMA_PER_MAD * 90.0)) ** 2, 0.0)
    return np.where(known, on_circle, np.inf)


def scaled_inverse(gram: Floats) -> Floats:
    """Invert a symmetric matrix of products of columns of any units, ignoring directions that vanish."""
    scale = np.sqrt(np.where(np.diag(gram) > 0.0, np.diag(gram), 1.0))
    outer = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(gram / outer, rcond=1e-8, hermitian=True) / outer)


def orthonormal_basis(columns: Floats) -> Floats:
    """Compute an orthonormal basis of columns, without directions of negligible size, (n, at most k)."""
    scale = np.linalg.norm(columns, axis=0)
    if not np.any(scale > 0.0):
        return np.zeros((len(columns), 0))
    left, size, _ = np.linalg.svd(columns[:, scale > 0] / scale[scale > 0], full_matrices=False)
    return left[:, size > 1e-5 * size[0]]


def project_out(columns: Floats, basis: Floats) -> Floats:
    """Subtract the projection of columns, (n, ...), on an orthonormal basis, (n, b)."""
    return columns - basis @ (basis.T @ columns)


def whitened_basis(white: Floats) -> Floats:
    """Compute an orthonormal basis, (n, at most k), of whitened columns, (n, k), float32 both."""
    scale = np.linalg.norm(white, axis=0)
    unit = white[:, scale > 0] / scale[scale > 0]
    if unit.shape[1] < 2:
        return unit
    values, vectors = np.linalg.eigh((unit.T @ unit).astype(float))
    strong = values > max(1e-6 * values[-1], 1e-5)  # others count as absorbed by the base
    return (unit @ (vectors[:, strong] / np.sqrt(values[strong])).astype(np.float32)).astype(np.float32)


def _beyond(slowness: Floats, centre: Floats, middle: Floats) -> Floats:
    """Compute the factor on the width beyond the centres of the fastest and the slowest bin, else 1, (n,).

    Towards fast water the squared width is a floor plus a term in squared slowness, as in the noise of the fit, by
    least squares over the faster half of the bins: veer and heeling are largest and best observed there. Towards slow
    water it grows with slowness: slow water has unusual directions, and too narrow a width would turn noise into veer.
    """
    faster = slice(0, max(len(centre) // 2, 2))
    x, y = centre[faster] ** 2, middle[faster] ** 2
    slower = np.maximum(slowness / max(centre[-1], 1e-12), 1.0)
    if np.ptp(x) == 0.0:
        return slower
    growth = max(float(np.sum((x - x.mean()) * (y - y.mean())) / np.sum((x - x.mean()) ** 2)), 0.0)
    floor = max(float(y.mean() - growth * x.mean()), NARROWEST**2 * float(y[0]))
    square = np.minimum(slowness, centre[0]) ** 2
    return np.asarray(slower * np.sqrt((floor + growth * square) / (floor + growth * centre[0] ** 2)))
