"""Errors of the reference's own compass, and how they enter the corrected headings.

The reference's directions err by a constant and by iron of its own, b sin + c cos of the *reference's* heading. A fit
to these directions turns with the constant, and takes up what of the iron looks like iron of the affected compass.
The mean veer between the two depths acts like the constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles, earthfield
from compasslib.records import EarthField, Pairs, ReferenceCompass
from compasslib.types import Floats

# Assumed for a moored magnetic compass that was not calibrated in place (docs/background/limits.md; keys of the
# instrument give others), and for constants of affected compasses, by their mounting and alignment.
CONSTANT_SIGMA_DEG, ALIGNMENT_SIGMA_DEG, IRON_SIGMA_NT, TILT_OFFSET_DEG = 2.0, 4.0, 525.0, 0.4
STUDENT_68 = 1.1416  # 68.27 % of Student's t with four degrees of freedom lie within this, as of a normal within 1


def declination_sigma(field: EarthField) -> float:
    """Compute the standard deviation of the field model's declination, degrees."""
    return earthfield.model_sigma(float(np.mean(field.horizontal_nT)))


def reference_compass(
    name: str, field: EarthField, *, magnetic: bool, sigma_deg: float | None = None, iron_nT: float | None = None
) -> ReferenceCompass:
    """Describe the compass of a reference by the keys of its instrument, ``compass_sigma_deg`` and ``compass_iron_nT``.

    True directions were rotated by another declination, whose error is added to the usual standard deviation.
    """
    horizontal, declination = float(np.mean(field.horizontal_nT)), declination_sigma(field)
    dip_ratio = abs(float(np.mean(field.vertical_nT))) / horizontal
    usual = CONSTANT_SIGMA_DEG if magnetic else float(np.hypot(CONSTANT_SIGMA_DEG, declination))
    iron = (IRON_SIGMA_NT if iron_nT is None else iron_nT) / horizontal / angles.DEGREE
    return ReferenceCompass(
        name,
        usual if sigma_deg is None else sigma_deg,
        float(np.hypot(iron, TILT_OFFSET_DEG * dip_ratio)) if iron_nT is None else iron,
        0.0 if magnetic else declination,
    )


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors of the reference's compass and of the mean veer in a fit to the reference's directions."""

    constant_deg: float  #: standard deviation of the reference's constant, from magnetic north
    veer_deg: float  #: of the mean veer between the depths
    iron: Floats  #: (5, 2) change of the coefficients by one standard deviation of the reference's B and of its C
    magnetic: bool  #: whether its directions are from magnetic north
    veer_included: bool  #: whether the covariance of the fit includes the mean veer
    share: float = 1.0  #: probability that the compass has a deviation, and follows the reference


def iron_pattern(pairs: Pairs) -> Floats:
    """Compute the error of the reference's directions by one σ of its B and of its C, (n, 2) degrees."""
    heading = angles.direction(pairs.lower_east, pairs.lower_north)  # of a vane, the worst case, where not recorded
    if pairs.lower_heading_deg is not None:
        heading = np.where(np.isfinite(pairs.lower_heading_deg), pairs.lower_heading_deg, heading)
    return (pairs.compass.iron_deg if pairs.compass else 0.0) * np.column_stack(angles.sin_cos(heading))


def reference_errors(pairs: Pairs, iron: Floats, *, veer_included: bool) -> ReferenceErrors | None:
    """Collect the errors of the reference of a fit, with the change of A..E by its iron; None if not stated."""
    if (compass := pairs.compass) is None:
        return None
    constant = float(np.hypot(compass.sigma_deg, compass.declination_deg))
    return ReferenceErrors(constant, pairs.veer_deg, iron, compass.declination_deg == 0.0, veer_included)


def constant_sigma(constant_deg: float, sigma_deg: float, error_deg: float) -> float:
    """Compute the rms of the part of a fitted constant, degrees, that is not the affected compass's own.

    The own part is normal with ``ALIGNMENT_SIGMA_DEG``, the error of the reference Student's t with four degrees of
    freedom, 68 % of it within ``error_deg``; given their sum, the error has a mean and a standard deviation.
    """
    if error_deg == 0.0:
        return 0.0
    width, scale = float(np.hypot(ALIGNMENT_SIGMA_DEG, sigma_deg)), error_deg / STUDENT_68
    error = np.linspace(-1.0, 1.0, 2001) * (abs(constant_deg) + 8.0 * error_deg + 4.0 * width)
    log_density = -2.5 * np.log1p((error / scale) ** 2 / 4.0)
    log_density = log_density - 0.5 * ((constant_deg - error) / width) ** 2
    weight = np.exp(log_density - log_density.max())
    return float(np.sqrt(np.average(error**2, weights=weight)))
