"""The field on a bench: its changes by an observatory, its homogeneity by an instrument spun in place.

Le Menn et al. 2023, section 2: a record of the field during the calibration, and Table 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.calibrations import curves
from compasslib.calibrations.curves import FittedCurve
from compasslib.readers import iaga2002
from compasslib.types import Floats

MAX_STEPS = 1.5  # of the series between a reading and its nearest sample
MIN_DIRECTIONS = 4  # in which an instrument is spun


def correct_field(reference_deg: Floats, time_s: Floats, files: Sequence[str]) -> tuple[Floats, dict[str, Any]]:
    """Take the declination's changes off magnetic reference directions, its mean over the readings kept.

    Args:
        reference_deg: by the mean declination of the readings, (n,).
        time_s: of the readings, (n,), NaN where unknown; those far from any sample stay as they are.
        files: IAGA-2002 files of one observatory.

    Raises:
        InputError: a file cannot be read.
    """
    series = iaga2002.read(files)
    known = np.isfinite(series.declination_deg)
    at, declination = series.time_s[known], series.declination_deg[known]
    if len(at) < 2 or not np.isfinite(time_s).any():
        text = f"{series.station} has no declination at the times of the readings, which stay uncorrected"
        return reference_deg, {"station": series.station, "corrected": 0, "range_deg": None, "text": text}
    nearest = np.array([np.min(np.abs(at - t)) if np.isfinite(t) else np.inf for t in time_s])
    near = nearest <= MAX_STEPS * np.median(np.diff(at))
    change = np.zeros(reference_deg.shape)
    change[near] = np.interp(time_s[near], at, declination)
    change[near] -= np.mean(change[near]) if near.any() else 0.0
    count, size = int(near.sum()), float(np.ptp(change[near])) if near.any() else 0.0
    text = (
        f"{count} of {len(near)} readings are corrected for changes of the declination at {series.station}, "
        f"{size:.2f} degrees in all; field_deg may then be the noise alone"
    )
    corrected = {"station": series.station, "corrected": count, "range_deg": size, "text": text}
    return angles.wrap360(reference_deg - change), corrected


def measure_homogeneity(
    reference_deg: Floats, recorded_deg: Floats, spun_reference_deg: Floats, spun_recorded_deg: Floats
) -> dict[str, Any]:
    """Compare an instrument spun in one place with the curve by which the platform was rotated, degrees.

    Args:
        reference_deg: of the platform's readings, (n,).
        recorded_deg: of the platform's readings, (n,).
        spun_reference_deg: of those of the instrument spun in place, (m,).
        spun_recorded_deg: of those of the instrument spun in place, (m,).
    """
    points = curves.deviation_points(recorded_deg, reference_deg)
    fits = [curves.fit_curve(form, points) for form in (curves.SMITH, curves.EXACT)]
    fitted = [fit for fit in fits if isinstance(fit, FittedCurve)]
    observed = angles.difference(spun_reference_deg, spun_recorded_deg)
    known, unknown = np.isfinite(observed), {"max_deg": None, "mean_deg": None}
    if not fitted or known.sum() < MIN_DIRECTIONS:
        few = f"{known.sum()} directions of the spun instrument, at least {MIN_DIRECTIONS} tell it"
        return {**unknown, "text": f"The homogeneity of the field is not determined: {few if fitted else fits[0]}"}
    off = angles.difference(observed[known], curves.select_curve(fitted).deviation(spun_recorded_deg[known]))
    largest, mean = float(off[np.argmax(np.abs(off))]), float(np.mean(off))
    text = (
        f"The instrument spun in {len(off)} directions differs from the rotated platform by up to {largest:+.2f} "
        f"degrees, by {mean:+.2f} on average: the largest is the homogeneity's row of the budget"
    )
    return {"max_deg": largest, "mean_deg": mean, "text": text}
