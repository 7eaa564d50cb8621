"""How the deviation falls with the compass's distance from the iron (von Appen 2015, conclusion: a few metres help)."""

from __future__ import annotations

from typing import Any

import numpy as np

from compasslib import angles
from compasslib.deviation.model import DeviationFit
from compasslib.statistics.resampling import NORMAL_95

DISTANCES_M = (0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0, 10.0)
ORIENTATION = (0.5, 2.0)  # a dipole's field along its axis is twice that across it, and either may have been met


def estimate_safe_distance(fit: DeviationFit, sphere_distance_m: tuple[float, float] | None) -> dict[str, Any] | None:
    """Estimate the largest deviation at other distances from the iron's centre, as of a dipole: asin(|p| (r0/r)^3).

    |p| is the field of hard and induced iron over the earth's horizontal one, at this latitude. A range holds the
    bounds of r0, a factor of 0.5 to 2 for the orientation, and 95 % of |p|.

    Args:
        sphere_distance_m: bounds of the distance r0 from the compass to the iron's centre, which no mooring can tell.

    Returns:
        The block ``safe_distance`` of deviation.json; None without bounds, or of a series, whose terms are no field.
    """
    if sphere_distance_m is None or not fit.fitted or fit.method == "von_appen":
        return None
    b_c = fit.coefficients[1:3]
    field = float(np.hypot(*b_c))
    sigma = float(np.sqrt(b_c @ fit.covariance[1:3, 1:3] @ b_c)) / max(field, 1e-12) if fit.covariance.size else 0.0
    bounds = max(field - NORMAL_95 * sigma, 0.0), field + NORMAL_95 * sigma
    ends = list(zip(bounds, ORIENTATION, sphere_distance_m, strict=True))
    reached = [r for r in DISTANCES_M if r > sphere_distance_m[1]]
    return {
        "relative_field": field,
        "relative_field_sigma": sigma,
        "assumed": {"distance_m": list(sphere_distance_m), "orientation": list(ORIENTATION)},
        "distances": [
            {"m": r, "deviation_deg": [_largest_deviation(share * p * (r0 / r) ** 3) for p, share, r0 in ends]}
            for r in reached
        ],
    }


def _largest_deviation(relative_field: float) -> float:
    """Compute the largest deviation that a field beside the earth's makes, degrees; 180 where it is the stronger."""
    if relative_field >= 1.0:
        return 180.0
    return float(angles.argument(complex(np.sqrt(1.0 - relative_field**2), relative_field)))
