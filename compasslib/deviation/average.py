"""Any compass along the samples of a record, and the average of the headings over all possible compasses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.exact import MIN_SLOPE
from compasslib.deviation.model import DeviationFit, nearest_root
from compasslib.records import Readings
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

    def sensitivity(heading_deg: Floats) -> Floats:
        slope = compass.slope(fit.coefficients, heading_deg)
        columns = compass.gradient(fit.coefficients, heading_deg)
        return (-columns / np.copysign(np.maximum(np.abs(slope), MIN_SLOPE), slope)).T

    return CompassSeries(readings.heading_deg, fit.coefficients, fit.covariance, sensitivity)
