"""Averages over possible compasses: along a record over alternatives, and of a fitted compass with none.

Between two depths real water veers for months, and a fit attributes part of it to iron. The coefficients therefore have
priors of physical size, no deviation is a hypothesis, and the likelihood is the normal distribution of the fit.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.exact import heading_sensitivity
from compasslib.deviation.model import DeviationFit, covariance_sigma, nearest_root
from compasslib.records import Readings
from compasslib.statistics.least_squares import mixed_covariance
from compasslib.types import Floats


@dataclass(frozen=True)
class CompassSeries:
    """The compass at each of n samples, with p parameters."""

    reading_deg: Floats  # (n,) recorded headings, corrected for effects on the readout
    coefficients: Floats  # (5,) or (5, n) A..E of the exact compass
    covariance: Floats  # (p, p) of the parameters
    sensitivity: Callable[[Floats], Floats]  # correct headings (n,) -> their derivatives by the parameters, (n, p)
    north_deg: Floats | float = 0.0  # (n,) magnetic north relative to the assumed declination, east positive
    tilted: bool = False  # whether the model includes vertical iron, which acts with the tilt
    weight: float = 1.0  # posterior probability of this compass
    others: tuple[CompassSeries, ...] = ()  # alternative compasses

    def roots(self) -> Floats:
        """Compute the correct headings of each reading, (n, 2) degrees, NaN where there is none."""
        roots = compass.inverse(self.coefficients, self.reading_deg)
        return roots + np.broadcast_to(self.north_deg, self.reading_deg.shape)[:, None]

    def sigma(self, heading_deg: Floats) -> Floats:
        """Compute the standard error of correct headings due to the parameters' covariance, (n,) degrees."""
        return covariance_sigma(self.sensitivity(heading_deg), self.covariance)


@dataclass(frozen=True)
class CompassAverage:
    """Average of each heading over all possible compasses, (n,) each."""

    shift_deg: Floats  # average minus the heading of the most probable compass
    sigma_deg: Floats  # standard error, from the parameters and the choice between the compasses
    agreed: Floats  # weight of the compasses that agree with the most probable one, or its complement if larger


def average_compasses(at: CompassSeries, heading_deg: Floats) -> CompassAverage:
    """Average all possible compasses on the branch of the most probable one's headings, (n,) degrees.

    Args:
        heading_deg: correct headings by the most probable compass, (n,), degrees, NaN where there is none.
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
    far = np.sum(weight * (np.abs(shift) > 3.0 * np.sqrt(np.maximum(variance, first**2))), axis=0)
    return CompassAverage(mean, np.sqrt(spread), np.maximum(far, 1.0 - far))


def compass_series(fit: DeviationFit, readings: Readings) -> CompassSeries:
    """Evaluate a fitted compass along its own record."""
    by = partial(heading_sensitivity, fit)
    return CompassSeries(readings.heading_deg, fit.coefficients, fit.covariance, by)


# Equally probable prior scales: of B and C, the iron's field over the earth's horizontal one, and of A, the
# instrument's alignment in radians. D and E are induced and have a tenth of the former.
IRON_SCALES, ALIGNMENT_SCALES = (0.05, 0.15, 0.5, 1.5), (0.05, 0.35)


def average_with_none(fit: DeviationFit) -> tuple[DeviationFit, float | None]:
    """Average a fitted exact compass with one without deviation, and compute the latter's probability, if possible."""
    if not has_average(fit):
        return fit, None
    mean, covariance, response, none = average_coefficients(fit.coefficients, fit.covariance, fit)
    reference = fit.reference
    if reference is not None:  # a compass without deviation does not follow the reference's errors
        reference = replace(reference, iron=response @ reference.iron, share=1.0 - none)
    return replace(fit, coefficients=mean, covariance=covariance, reference=reference), none


def has_average(fit: DeviationFit) -> bool:
    """Check that a compass may have no deviation: it is not two-valued, fixed, or with a prior from other records."""
    return fit.method == "exact" and fit.fitted and not (fit.folded or fit.fixed) and fit.prior is None


def average_coefficients(
    parameters: Floats, covariance: Floats, fit: DeviationFit
) -> tuple[Floats, Floats, Floats, float]:
    """Average A..E and further parameters, (p,), over the priors of A..E, that of no deviation among them.

    Returns mean, covariance, the share of an error of A..E that remains, (5, 5), and the probability of no deviation.

    Args:
        parameters: A..E, and further parameters, whose prior is flat, (p,).
        covariance: (p, p).
        fit: the fit that states the errors of the reference, and whether iron is declared.
    """
    estimate, spread_of_fit = parameters[:5], covariance[:5, :5]
    deviated = [
        np.array([align, iron, iron, *2 * [max(0.1 * iron, 0.02)]])
        for iron, align in product(IRON_SCALES, ALIGNMENT_SCALES)
    ]
    prior = np.array([np.diag(scale**2) for scale in (np.zeros(5), *deviated)])
    none = 0.0 if fit.iron_declared else 0.2
    chance = np.append(none, np.full(len(deviated), (1.0 - none) / len(deviated)))
    constant, iron = np.zeros((2, 5, 5))  # covariance of the coefficients by the reference's constant and by its iron
    if fit.reference is not None:
        # A turn e of all directions multiplies u by e^{-ie}, v by e^{ie}: with Re u = 1 again, the change is:
        a, b, c, d, e = fit.coefficients
        turned = np.array([1.0 + a**2, a * b, a * c, a * d + e, a * e - d]) * fit.reference.constant_deg * angles.DEGREE
        constant, iron = np.outer(turned, turned), fit.reference.iron @ fit.reference.iron.T
    gain = prior @ np.linalg.inv(spread_of_fit + iron + prior)
    total = spread_of_fit + iron + constant + prior
    misfit = np.einsum("i,kij,j->k", estimate, np.linalg.inv(total), estimate)
    # Half of the logarithm, as veer that a fit attributes to iron is not independent noise.
    log_likelihood = -0.25 * (np.linalg.slogdet(total).logabsdet + misfit)
    weight = chance * np.exp(log_likelihood - log_likelihood.max())
    weight /= weight.sum()
    means = gain @ estimate
    mean = weight @ means
    unknown = np.eye(5) - gain  # the iron is not included: it has modes of its own
    spread = gain @ spread_of_fit @ gain.transpose(0, 2, 1) + unknown @ prior @ unknown.transpose(0, 2, 1)
    # The further parameters follow by their regression on A..E.
    slope = np.linalg.solve(spread_of_fit, covariance[:5]).T
    averaged = covariance + slope @ (mixed_covariance(weight, means, spread) - spread_of_fit) @ slope.T
    response = np.einsum("k,kij->ij", weight, gain)
    return parameters + slope @ (mean - estimate), (averaged + averaged.T) / 2.0, response, float(weight[0])
