"""The exact compass with tilt, and any compass along the samples of a record.

Iron rotates with the instrument, the earth's field does not. Given the level coefficients, tilt adds one unknown at
first order: the field along the instrument's own vertical, the hard iron's third axis and (S33 - S11) Z combined. It is
represented as hard iron, K = b_z / H; the other parts of the tilted compass follow from A, D, E and the dip (physics
page, section 4; von Appen 2015 omits them). A pair's scores of B and C times pitch and roll give its score of K, so the
level likelihood can be used.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.exact import MIN_SLOPE, PRIOR_WIDTH, pairs_per_independent, robust_covariance, scores_at
from compasslib.deviation.model import DeviationFit, nearest_root, observed_heading
from compasslib.records import Pairs, Readings
from compasslib.types import Floats


def tilted_coefficients(level: Floats, heeling: float, dip_ratio: float, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Compute A..E at each tilt, (5, n).

    Args:
        level: A..E of the level compass, (5,).
        heeling: K, vertical hard iron over the horizontal field.
        dip_ratio: Z/H of the earth's field.
        pitch_deg: forward up, (n,), degrees; NaN counts as level.
        roll_deg: starboard down, (n,), degrees; NaN counts as level.
    """
    a, b, c, d, e = level
    soft = np.array([[1.0 + d, e - a, 0.0], [e + a, 1.0 - d, 0.0], [0.0, 0.0, 1.0]])
    return compass.level_coefficients(
        soft,
        np.array([b, c, heeling]),
        horizontal_nT=1.0,
        vertical_nT=dip_ratio,
        pitch_deg=np.nan_to_num(pitch_deg),
        roll_deg=np.nan_to_num(roll_deg),
    )


def coefficients_along(fit: DeviationFit, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Compute the coefficients of a fit at each sample, (5, n), or (5,) for a level model."""
    if not fit.tilted:
        return fit.coefficients
    return tilted_coefficients(fit.coefficients, fit.heeling, fit.dip_ratio, pitch_deg, roll_deg)


def tilt_jacobian(fit: DeviationFit, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Compute the derivative of the coefficients at each tilt with respect to A..E and K, (5, 6, n)."""
    at = np.append(fit.coefficients, fit.heeling)
    columns = []
    for unit in 1e-5 * np.eye(6):
        ahead, behind = (
            tilted_coefficients((at + s * unit)[:5], (at + s * unit)[5], fit.dip_ratio, pitch_deg, roll_deg)
            for s in (1.0, -1.0)
        )
        columns.append((ahead - behind) / 2e-5)
    return np.stack(columns, axis=1)


def fit_tilt(pairs: Pairs, level: DeviationFit, dip_ratio: float, *, heeling_prior: float = 0.5) -> DeviationFit:
    """Fit the compass including the heeling coefficient K to the pairs, starting from the level fit.

    Args:
        level: the exact compass fitted without tilt.
        heeling_prior: width of the weak prior of K: vertical iron of half the horizontal field.
    """
    at = np.append(level.coefficients, 0.0)
    value, scores = _scores(at, pairs, level, dip_ratio)
    precision = np.append(PRIOR_WIDTH[:5] ** -2.0, heeling_prior**-2.0)
    external, prior_precision, expected = None, np.zeros((6, 6)), np.zeros(6)
    if level.prior is not None:  # scaled for the autocorrelation of the pairs
        counted = pairs_per_independent(pairs, level.n_effective)
        external = replace(level.prior, precision=counted * level.prior.precision)
        prior_precision[:5, :5], expected[:5] = external.precision, external.mean
    for _ in range(8):
        pull = scores.sum(axis=0) - precision * at - prior_precision @ (at - expected)
        step = np.linalg.solve(scores.T @ scores + np.diag(precision) + prior_precision, pull)
        trial, (better, new) = at + step, _scores(at + step, pairs, level, dip_ratio)
        while better < value and np.abs(step).max() > 1e-4:
            step = step / 2.0
            trial, (better, new) = at + step, _scores(at + step, pairs, level, dip_ratio)
        if better < value:
            break
        at, value, scores = trial, better, new
    fitted = replace(level, coefficients=at[:5], heeling=float(at[5]), dip_ratio=dip_ratio)
    levelled = _levelled(at, pairs, dip_ratio)
    covariance = robust_covariance(scores, precision, fitted, levelled, level.n_effective, external)
    return replace(fitted, covariance=covariance)


def _scores(at: Floats, pairs: Pairs, level: DeviationFit, dip_ratio: float) -> tuple[float, Floats]:
    """Compute the log-likelihood and each pair's gradient with respect to A..E and K, (n, 6)."""
    value, scores = scores_at(at[:5], _levelled(at, pairs, dip_ratio), level)
    trial = replace(level, coefficients=at[:5], heeling=float(at[5]), dip_ratio=dip_ratio)
    return value, np.einsum("nj,jkn->nk", scores, tilt_jacobian(trial, pairs.pitch_deg, pairs.roll_deg))


def _levelled(at: Floats, pairs: Pairs, dip_ratio: float) -> Pairs:
    """Convert the pairs to those of a level compass, using the root nearest to the observed heading."""
    tilted = tilted_coefficients(at[:5], at[5], dip_ratio, pairs.pitch_deg, pairs.roll_deg)
    heading = nearest_root(compass.inverse(tilted, pairs.heading_deg), observed_heading(pairs))
    moved = compass.recorded_heading(tilted, heading) - compass.recorded_heading(at[:5], heading)
    shift = np.where(np.isfinite(moved), angles.wrap180(moved), 0.0)
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, -shift)
    return replace(pairs, heading_deg=angles.wrap360(pairs.heading_deg - shift), upper_east=east, upper_north=north)


@dataclass(frozen=True)
class CompassSeries:
    """The compass at each of n samples, with p parameters."""

    reading_deg: Floats  # (n,) recorded headings, corrected for effects on the readout
    coefficients: Floats  # (5,) or (5, n) A..E of the exact compass
    covariance: Floats  # (p, p) of the parameters
    sensitivity: Callable[[Floats], Floats]  # correct headings (n,) -> their derivatives by the parameters, (n, p)
    north_deg: Floats | float = 0.0  # (n,) magnetic north relative to the assumed declination, east positive
    tilted: bool = False  # whether the model includes the heeling coefficient
    weight: float = 1.0  # posterior probability of this compass
    others: tuple[CompassSeries, ...] = ()  # alternative compasses

    def roots(self) -> Floats:
        """Compute the correct headings of each reading, (n, 2) degrees, NaN where there is none."""
        roots = compass.inverse(self.coefficients, self.reading_deg)
        return roots + np.broadcast_to(self.north_deg, self.reading_deg.shape)[:, None]

    def sigma(self, heading_deg: Floats) -> Floats:
        """Compute the standard error of correct headings due to the parameters' covariance, (n,) degrees."""
        columns = self.sensitivity(heading_deg)
        return np.sqrt(np.einsum("ni,ij,nj->n", columns, self.covariance, columns))


@dataclass(frozen=True)
class CompassAverage:
    """Average of each heading over all possible compasses, (n,) each."""

    shift_deg: Floats  # average minus the heading of the most probable compass
    sigma_deg: Floats  # standard error, from the parameters and the choice between the compasses
    agreed: Floats  # weight of the compasses that agree with the most probable one, or its complement if larger


def average_compasses(at: CompassSeries, heading_deg: Floats, *, distinct_sigmas: float = 3.0) -> CompassAverage:
    """Average all possible compasses on the branch of given headings.

    Args:
        heading_deg: correct headings by the most probable compass, (n,), degrees, NaN where there is none.
        distinct_sigmas: difference in standard errors above which two compasses disagree.
    """
    first = at.sigma(heading_deg)
    shifts, variances, weights = [np.zeros_like(first)], [first**2], [np.full_like(first, at.weight)]
    likeliest = nearest_root(at.roots(), heading_deg)
    for other in at.others:
        root = nearest_root(other.roots(), heading_deg)
        shift = angles.difference(root, likeliest)
        variances.append(np.nan_to_num(other.sigma(np.where(np.isfinite(root), root, heading_deg))) ** 2)
        weights.append(np.where(np.isfinite(shift), other.weight, 0.0))
        shifts.append(np.nan_to_num(shift))
    shift, variance, weight = np.array(shifts), np.array(variances), np.array(weights)
    weight /= weight.sum(axis=0)
    mean = np.sum(weight * shift, axis=0)
    spread = np.sum(weight * (variance + (shift - mean) ** 2), axis=0)
    far = np.sum(weight * (np.abs(shift) > distinct_sigmas * np.sqrt(np.maximum(variance, first**2))), axis=0)
    return CompassAverage(mean, np.sqrt(spread), np.maximum(far, 1.0 - far))


def compass_series(fit: DeviationFit, readings: Readings) -> CompassSeries:
    """Evaluate a fitted exact compass along its own record."""
    at = coefficients_along(fit, readings.pitch_deg, readings.roll_deg)

    def sensitivity(heading_deg: Floats) -> Floats:
        columns = compass.gradient(at, heading_deg)
        if fit.tilted:
            columns = np.einsum("in,ikn->kn", columns, tilt_jacobian(fit, readings.pitch_deg, readings.roll_deg))
        slope = compass.slope(at, heading_deg)
        return (-columns / np.copysign(np.maximum(np.abs(slope), MIN_SLOPE), slope)).T

    return CompassSeries(readings.heading_deg, at, fit.covariance, sensitivity, tilted=fit.tilted)
