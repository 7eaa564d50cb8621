"""A compass as it was at every sample of a record: level or tilted, and with whatever else acted on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import model, tilt
from compasslib.deviation.model import Fit
from compasslib.records import Readings
from compasslib.types import Floats

PEAKS = 3.0  # standard errors by which two compasses are apart that do not agree
FLATTEST = 0.3  # least slope that is divided by; at a fold the spread over both branches holds the rest


@dataclass(frozen=True)
class Along:
    """What turns recorded headings into correct ones, sample by sample; n samples, p parameters."""

    reading_deg: Floats  # (n,) recorded headings, what acts on the readout undone
    coefficients: Floats  # (5,) or (5, n) A..E of the exact compass
    covariance: Floats  # (p, p) of the parameters
    sensitivity: Callable[[Floats], Floats]  # correct headings (n,) -> how far each moves by each parameter, (n, p)
    north_deg: Floats | float = 0.0  # how far magnetic north stood east of where the declination puts it, (n,)
    tilted: bool = False  # whether the iron that only tilt shows is in the model
    weight: float = 1.0  # probability that this compass is the right one
    others: tuple[Along, ...] = ()  # that may be it too

    def roots(self) -> Floats:
        """Return the correct headings that the compass recorded as it did, (n, 2), NaN where there is none."""
        roots = compass.inverse(self.coefficients, self.reading_deg)
        return roots + np.broadcast_to(self.north_deg, self.reading_deg.shape)[:, None]

    def sigma(self, heading_deg: Floats) -> Floats:
        """Return the standard error that the parameters' covariance makes, (n,) degrees.

        Args:
            heading_deg: correct headings, (n,), degrees.
        """
        columns = self.sensitivity(heading_deg)
        return np.sqrt(np.einsum("ni,ij,nj->n", columns, self.covariance, columns))


@dataclass(frozen=True)
class Averaged:
    """What all compasses that may be the right one make of each heading, (n,) each."""

    shift_deg: Floats  # from the heading of the likeliest one
    sigma_deg: Floats  # what parameters, and the choice between the compasses, leave open
    agreed: Floats  # weight of those that agree, or of those that do not where it is more


def averaged(at: Along, heading_deg: Floats) -> Averaged:
    """Return the average of all compasses on the branch of a heading.

    Args:
        heading_deg: correct headings by the likeliest compass, (n,), degrees, NaN where there is none.
    """
    first = at.sigma(heading_deg)
    shifts, variances, weights = [np.zeros_like(first)], [first**2], [np.full_like(first, at.weight)]
    own = model.nearest_root(at.roots(), heading_deg)
    for other in at.others:
        root = model.nearest_root(other.roots(), heading_deg)
        shift = angles.difference(root, own)
        variances.append(np.nan_to_num(other.sigma(np.where(np.isfinite(root), root, heading_deg))) ** 2)
        weights.append(np.where(np.isfinite(shift), other.weight, 0.0))
        shifts.append(np.nan_to_num(shift))
    shift, variance, weight = np.array(shifts), np.array(variances), np.array(weights)
    weight /= weight.sum(axis=0)
    mean = np.sum(weight * shift, axis=0)
    spread = np.sum(weight * (variance + (shift - mean) ** 2), axis=0)
    far = np.sum(weight * (np.abs(shift) > PEAKS * np.sqrt(np.maximum(variance, first**2))), axis=0)
    return Averaged(mean, np.sqrt(spread), np.maximum(far, 1.0 - far))


def of_fit(fit: Fit, readings: Readings) -> Along:
    """Return a fitted exact compass along its own record.

    Args:
        fit: coefficients with covariance, level or with tilt.
    """
    at = tilt.along(fit, readings.pitch_deg, readings.roll_deg)

    def sensitivity(heading_deg: Floats) -> Floats:
        columns = compass.gradient(at, heading_deg)
        if fit.tilted:
            columns = np.einsum("in,ikn->kn", columns, tilt.jacobian(fit, readings.pitch_deg, readings.roll_deg))
        return (columns / np.maximum(np.abs(compass.slope(at, heading_deg)), FLATTEST)).T

    return Along(readings.heading_deg, at, fit.covariance, sensitivity, tilted=fit.tilted)
