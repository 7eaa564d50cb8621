"""The curve of a fitted deviation, by its method: the series of von Appen 2015 or the exact compass."""

from __future__ import annotations

import numpy as np

from compasslib import compass
from compasslib.deviation.exact import MIN_SLOPE
from compasslib.deviation.model import DeviationFit
from compasslib.deviation.series import invert_series, series_design, series_slope
from compasslib.types import Floats


def correct_roots(fit: DeviationFit, recorded_deg: Floats) -> Floats:
    """Compute the correct headings of recorded ones, (n, 2) degrees, NaN where there is none."""
    if fit.method != "von_appen":
        return compass.inverse(fit.coefficients, recorded_deg)
    beta = invert_series(fit.coefficients, recorded_deg)
    return np.stack([beta, np.full(beta.shape, np.nan)], axis=-1)


def reading_slope(fit: DeviationFit, heading_deg: Floats) -> Floats:
    """Compute |d recorded / d correct heading|, (n,)."""
    slope = series_slope if fit.method == "von_appen" else compass.slope
    return np.abs(slope(fit.coefficients, heading_deg))


def heading_sensitivity(fit: DeviationFit, heading_deg: Floats) -> Floats:
    """Compute the derivative of the correct heading of a reading by A..E, (n, 5) degrees per unit."""
    least = np.maximum(reading_slope(fit, heading_deg), MIN_SLOPE)
    if fit.method == "von_appen":
        return series_design(heading_deg) / least[:, None]
    slope = np.copysign(least, compass.slope(fit.coefficients, heading_deg))
    return (-compass.gradient(fit.coefficients, heading_deg) / slope).T
