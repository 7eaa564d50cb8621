"""An observatory's declination against a model of the field: slow level, quiet day, storms, the constant of its rocks.

``hold`` is the door for calibration and diagnosis, ``covariate`` that for a mooring.
"""

from __future__ import annotations

from compasslib.observatory.course import (
    DAY_S,
    HOUR_S,
    WINDOW_S,
    Storm,
    covariate,
    daily,
    departure,
    hourly_median,
    means,
    strongest,
    worst,
)
from compasslib.observatory.held import BLOCK_DAYS, Held, field_of, hold, place_of, refusal
from compasslib.observatory.plausible import CRUST_NT, held_against, said

__all__ = [
    "BLOCK_DAYS",
    "CRUST_NT",
    "DAY_S",
    "HOUR_S",
    "WINDOW_S",
    "Held",
    "Storm",
    "covariate",
    "daily",
    "departure",
    "field_of",
    "held_against",
    "hold",
    "hourly_median",
    "means",
    "place_of",
    "refusal",
    "said",
    "strongest",
    "worst",
]
