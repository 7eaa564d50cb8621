"""The correct headings of each whole recorded degree, with their standard deviation: a table to correct by hand."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compasslib import angles, compass
from compasslib.deviation.branches import PRECISION_DEG
from compasslib.deviation.doubts import UNIFORM_SIGMA_DEG, Doubt
from compasslib.deviation.model import DeviationFit
from compasslib.deviation.series import invert_series, series_sigma, series_slope
from compasslib.deviation.tilt import compass_series
from compasslib.records import Readings
from compasslib.types import Floats

LOOKUP_COLUMNS = ("recorded_deg", "corrected_deg", "deviation_deg", "sigma_deg", "root")
MIN_READING_SLOPE = 0.05  # least slope that the precision of a reading is divided by


def correct_roots(fit: DeviationFit, recorded_deg: Floats) -> Floats:
    """Invert recorded headings by the method's own inverse, (n, 2) degrees, NaN where there is no root.

    Args:
        recorded_deg: (n,).
    """
    if fit.method != "von_appen":
        return compass.inverse(fit.coefficients, recorded_deg)
    beta = invert_series(fit.coefficients, recorded_deg)
    return np.stack([beta, np.full(beta.shape, np.nan)], axis=-1)


def tabulate_deviation(
    fit: DeviationFit, unmodelled_deg: float = 0.0, doubts: Sequence[Doubt] = ()
) -> dict[str, Floats]:
    """Tabulate the level compass at every whole recorded degree that is reachable; empty without coefficients.

    The standard deviation is that of a heading whose branch is known: of the coefficients, of a reading, of what is
    seen and not modelled, and of what makes the whole record doubtful.

    Args:
        unmodelled_deg: standard deviation of what the fit is known to lack.
        doubts: those of single stretches are left out.

    Returns:
        The columns of ``LOOKUP_COLUMNS``, root 1 (the steadier) or 2 of a two-valued compass.
    """
    if not fit.fitted:
        return {name: np.zeros(0) for name in LOOKUP_COLUMNS}
    recorded = np.arange(360.0)
    roots, level = correct_roots(fit, recorded), np.zeros(recorded.shape)
    readings = Readings(level, recorded, level, level, level.astype(complex))
    whole = [doubt.sigma_deg for doubt in doubts if np.isinf([doubt.from_s, doubt.to_s]).all()]
    further = unmodelled_deg**2 + float(np.sum(np.square(whole)))
    rows = []
    for k, root in enumerate(roots.T, start=1):
        known = np.isfinite(root)
        if fit.method == "von_appen":
            parameters, slope = series_sigma(fit, root), series_slope(fit.coefficients, root)
        else:
            parameters, slope = compass_series(fit, readings).sigma(root), compass.slope(fit.coefficients, root)
        reading = PRECISION_DEG / np.maximum(np.abs(slope), MIN_READING_SLOPE)
        sigma = np.minimum(np.sqrt(parameters**2 + reading**2 + further), UNIFORM_SIGMA_DEG)
        deviation = angles.difference(root, recorded)
        rows += list(zip(*(c[known] for c in (recorded, root, deviation, sigma, np.full(360, k))), strict=True))
    ordered = np.array(sorted(rows, key=lambda row: (row[0], row[-1]))).reshape(-1, len(LOOKUP_COLUMNS))
    return dict(zip(LOOKUP_COLUMNS, ordered.T, strict=True))
