"""An observatory's declination against a model of the field: slow level, quiet day, storms, the constant of its rocks.

``compare`` is the entry for calibration and diagnosis, ``covariates`` that for a mooring. Ten quiet days 0.3 degrees
off the model, with a storm on the fifth:

>>> import numpy as np
>>> from compasslib import observatory
>>> from compasslib.records import EarthField, FieldSeries
>>> time_s = np.arange(0.0, 10 * observatory.DAY_S, 60.0)
>>> storm = np.where(np.abs(time_s - 4.5 * observatory.DAY_S) < 7200.0, 0.5 * np.sin(time_s / 600.0), 0.0)
>>> declination, unknown = -4.7 + storm, np.full(time_s.shape, np.nan)
>>> series = FieldSeries(time_s, declination, unknown, unknown, "XYZ", 66.5, 0.4, 0.0)
>>> ends, constant = time_s[[0, -1]], np.ones(2)
>>> model = EarthField(ends, -5.0 * constant, 12000.0 * constant, 50000.0 * constant, -5.0 * constant)
>>> found = observatory.compare(series, model, limit_deg=0.2)
>>> round(found.constant_deg, 3), len(found.storms), round(found.storms[0].range_deg, 2)
(0.3, 1, 1.0)
"""

from __future__ import annotations

from compasslib.observatory.comparison import BLOCK_DAYS, FieldComparison, compare, field_of, place_of, refusal
from compasslib.observatory.igrf_check import CRUST_NT, check, with_observatory
from compasslib.observatory.variations import (
    DAY_S,
    HOUR_S,
    WINDOW_S,
    Storm,
    covariates,
    daily_curve_at,
    departure,
    hourly_median,
    means,
    strongest_disturbance,
    three_hour_rms,
)

__all__ = [
    "BLOCK_DAYS",
    "CRUST_NT",
    "DAY_S",
    "HOUR_S",
    "WINDOW_S",
    "FieldComparison",
    "Storm",
    "check",
    "compare",
    "covariates",
    "daily_curve_at",
    "departure",
    "field_of",
    "hourly_median",
    "means",
    "place_of",
    "refusal",
    "strongest_disturbance",
    "three_hour_rms",
    "with_observatory",
]
