"""The published method: Smith's series in the correct heading, inverted where the compass is most sluggish.

Von Appen 2015, eqs. (1) to (4), section 4, reproduced with its flaws: the noisy lower direction enters both axes of the
scatter plot, and headings outside the inverted region are discarded. Coefficients are A to E of eq. (1), degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.deviation import model
from compasslib.deviation.model import DeviationFit, iron_pattern, reference_errors
from compasslib.records import Pairs
from compasslib.statistics.noise import effective_sample_size
from compasslib.types import Floats

STEP_DEG = 0.25  # of the lookup table
STARTS_DEG = (30.0, 60.0, 90.0, 120.0)  # starting amplitudes of the semicircular part, in addition to zero


def series_design(heading_deg: ArrayLike) -> Floats:
    """Compute the columns 1, sin, cos, sin 2, cos 2 of eq. (1), shape (n, 5)."""
    heading = np.asarray(heading_deg, dtype=float)
    sine, cosine = angles.sin_cos(heading)
    sine2, cosine2 = angles.sin_cos(2.0 * heading)
    return np.stack([np.ones_like(sine), sine, cosine, sine2, cosine2], axis=-1)


def series_deviation(coefficients: ArrayLike, heading_deg: ArrayLike) -> Floats:
    """Compute the deviation beta - gamma at correct headings, eq. (1), degrees."""
    return series_design(heading_deg) @ np.asarray(coefficients, dtype=float)


def fit_series(pairs: Pairs, near: DeviationFit | None = None) -> DeviationFit:
    """Fit the least-squares series to deviation against correct heading, from all starts; ``near`` is not used."""
    if len(pairs) < model.MIN_PAIRS:
        return model.unfitted("von_appen", len(pairs))
    heading, deviation = model.observed_heading(pairs), model.observed_deviation(pairs)
    columns = series_design(heading)
    coefficients = multistart_least_squares(columns, deviation)
    residual = angles.wrap180(deviation - columns @ coefficients)
    effective = effective_sample_size(residual, pairs.time_s)
    variance = float(np.mean(residual**2)) * len(pairs) / max(effective - 5.0, 1.0)
    recorded_range, folded = series_range(coefficients)
    solver = np.linalg.pinv(columns)
    iron = iron_pattern(pairs) * series_slope(coefficients, heading)[:, None]  # it turns observed headings too
    return DeviationFit(
        method="von_appen",
        coefficients=coefficients,
        covariance=variance * solver @ solver.T,
        n_pairs=len(pairs),
        n_effective=effective,
        residual_rms_deg=angles.rms(residual),
        recorded_range_deg=recorded_range,
        folded=folded,
        reference=reference_errors(pairs, solver @ iron, veer_included=False),
    )


def fit_series_about_mean(pairs: Pairs) -> Floats:
    """Fit the series to deviations unwrapped about their mean, as in von Appen's Figs 6 and 7, (5,) degrees."""
    heading, deviation = model.observed_heading(pairs), model.observed_deviation(pairs)
    middle = angles.wrap180(angles.mean(deviation))
    return np.linalg.lstsq(series_design(heading), middle + angles.difference(deviation, middle))[0]


def series_range(coefficients: Floats) -> tuple[tuple[float, float], bool]:
    """Compute the range of recorded headings that a series inverts, degrees, and whether the series folds."""
    if not series_folds(coefficients):
        return (0.0, 360.0), False
    recorded = inverse_table(coefficients)[0]
    return (float(recorded[0]), float(recorded[-1])), True


def series_folds(coefficients: ArrayLike) -> bool:
    """Check whether d gamma / d beta is negative somewhere, which makes beta(gamma) many-valued."""
    return bool(np.min(series_slope(coefficients, np.arange(0.0, 360.0, STEP_DEG))) < 0.0)


def series_slope(coefficients: ArrayLike, heading_deg: ArrayLike) -> Floats:
    """Compute d gamma / d beta of the series."""
    _, b, c, d, e = np.asarray(coefficients, dtype=float)
    sine, cosine = angles.sin_cos(heading_deg)
    sine2, cosine2 = angles.sin_cos(2.0 * np.asarray(heading_deg, dtype=float))
    return 1.0 - angles.DEGREE * (b * cosine - c * sine + 2.0 * d * cosine2 - 2.0 * e * sine2)


def inverse_table(coefficients: ArrayLike, headings_deg: ArrayLike | None = None) -> tuple[Floats, Floats]:
    """Tabulate (gamma, beta) of the inverted region, gamma increasing and unwrapped, degrees.

    With a fold it is the interval around the minimum of d gamma / d beta in which the compass turns backwards (green
    curves of the paper's Fig. 7), or the one that contains most headings.
    """
    grid = np.arange(0.0, 360.0, STEP_DEG)
    steepness = series_slope(coefficients, grid)
    if steepness.min() >= 0.0:
        beta = np.append(grid, 360.0)
        return beta - series_deviation(coefficients, beta), beta
    seed = int(np.argmin(steepness))
    if headings_deg is not None:
        stretch = np.cumsum(np.diff(steepness >= 0.0, prepend=steepness[-1] >= 0.0))
        stretch[stretch == stretch[-1]] = stretch[0] if stretch[0] == 0 else stretch[-1]  # the last one ends past north
        cell = (angles.wrap360(headings_deg) / STEP_DEG).astype(int) % grid.size
        seed = int(np.argmax(stretch == np.argmax(np.bincount(stretch[cell]))))
    around, forward = np.roll(np.arange(grid.size), -seed), steepness >= 0.0
    ahead = int(np.argmax(forward[around] != forward[seed]))
    behind = int(np.argmax(forward[around[::-1]] != forward[seed]))
    beta = grid[seed] + STEP_DEG * np.arange(-behind + 1, ahead)
    gamma = beta - series_deviation(coefficients, beta)
    return (gamma, beta) if forward[seed] else (gamma[::-1], beta[::-1])


def invert_series(coefficients: ArrayLike, recorded_deg: ArrayLike, headings_deg: ArrayLike | None = None) -> Floats:
    """Invert the series for each recorded heading, NaN outside the inverted region."""
    gamma, beta = inverse_table(coefficients, headings_deg)
    recorded = np.asarray(recorded_deg, dtype=float)
    with np.errstate(invalid="ignore"):
        unwrapped = gamma[0] + angles.wrap360(recorded - gamma[0])
    heading = np.interp(unwrapped, gamma, beta, left=np.nan, right=np.nan)
    return np.where(np.isfinite(recorded), angles.wrap360(heading), np.nan)


def series_sigma(fit: DeviationFit, heading_deg: ArrayLike) -> Floats:
    """Compute the standard error of the inverted heading due to the coefficients' covariance, (n,) degrees."""
    sigma = model.covariance_sigma(series_design(heading_deg), fit.covariance)
    return sigma / np.maximum(np.abs(series_slope(fit.coefficients, heading_deg)), 0.05)


def multistart_least_squares(columns: Floats, deviation: Floats) -> Floats:
    """Find the coefficients with the least squared, wrapped residuals of beta - gamma over all starts, (5,) degrees."""
    eight = [tuple(map(float, angles.sin_cos(direction))) for direction in range(0, 360, 45)]
    starts = [np.zeros(5), *(np.array([0.0, r * s, r * c, 0.0, 0.0]) for r in STARTS_DEG for s, c in eight)]
    solver = np.linalg.pinv(columns)
    solved = []
    for coefficients in starts:  # iterate linear steps on the wrapped residuals until convergence
        for _ in range(50):
            step = solver @ angles.wrap180(deviation - columns @ coefficients)
            coefficients = coefficients + step
            if np.max(np.abs(step)) < 1e-7:
                break
        solved.append(coefficients)
    return min(solved, key=lambda k: float(np.sum(angles.wrap180(deviation - columns @ k) ** 2)))
