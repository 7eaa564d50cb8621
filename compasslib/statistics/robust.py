"""Robust widths: the standard deviation of normal noise from a median, which outliers hardly move."""

from __future__ import annotations

import numpy as np

from compasslib.types import Floats

SIGMA_PER_MAD = 1.4826  # of normal noise: standard deviation over median absolute deviation
CLIP = 2.5  # Huber's, in widths: of normal noise 1 in 80 is clipped, and 1 % of the information is lost


def width(deviation: Floats) -> float:
    """Return the standard deviation of normal noise with the same median absolute deviation.

    Args:
        deviation: from the centre, of any shape; signs do not matter.
    """
    return SIGMA_PER_MAD * float(np.median(np.abs(deviation)))
