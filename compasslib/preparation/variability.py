"""Whether the reference was averaged, filtered, interpolated or held: its variability beside the affected one's.

The structure function of speed, the mean square of its changes over a lag, knows no compass and no gaps. At one site
its ratio between two instruments is about the same at the shortest lag and at two days, but for their noise: 0.8 to 1.9
times on ten simulated and two real moorings.
"""

from __future__ import annotations

import numpy as np

from compasslib.records import Pairs, Record
from compasslib.types import Floats

SLOW_S = 2 * 86400.0  # lag with which the shortest is compared
FEWEST = 50  # changes of which a mean square is taken
MOST_REPEATED, EQUAL_M_S = 0.3, 1e-5  # share of values that repeat the one before, and how nearly
# Ratio of the structure functions at the shortest lag over that at two days, and of the curvatures of both series.
SMOOTHED, SMOOTHED_CURVATURE = 0.6, 0.6
ROUGHENED = 3.0


def warn_of_filtering(pairs: Pairs, reference: Record) -> tuple[str, ...]:
    """Compare how much both instruments' speeds change from one pair to the next and over two days.

    Args:
        reference: its record inside the deployment.
    """
    if (share := _share_repeated(reference)) > MOST_REPEATED:
        return (f"{share:.0%} of the reference's velocities repeat the one before: it was sampled less often, or held",)
    if len(pairs) < FEWEST:
        return ()
    step_s = float(np.median(np.diff(pairs.time_s)))
    slot = np.rint((pairs.time_s - pairs.time_s[0]) / max(step_s, 1.0)).astype(int)
    speeds = (np.full(slot[-1] + 1, np.nan), np.full(slot[-1] + 1, np.nan))
    speeds[0][slot] = np.hypot(pairs.upper_east, pairs.upper_north)
    speeds[1][slot] = np.hypot(pairs.lower_east, pairs.lower_north)
    slow = max(round(SLOW_S / step_s), 4)
    fast, days = (_mean_squares(*speeds, lag) for lag in (1, slow))
    if min(fast[0], days[0], days[1]) <= 0.0:
        return ()
    contrast = (fast[1] / fast[0]) / (days[1] / days[0])
    smooth = _curvature(speeds[1]) < SMOOTHED_CURVATURE * _curvature(speeds[0])
    if not (contrast > ROUGHENED or (contrast < SMOOTHED and smooth)):
        return ()
    what = "averaged, filtered or interpolated" if contrast < 1.0 else "high-pass filtered, noisy or merged"
    return (
        f"relative to changes over {slow * step_s / 3600.0:.0f} h, the reference's speed changes from one pair to the "
        f"next {np.sqrt(contrast):.2g} times as much as the affected instrument's: it may have been {what}; use the "
        "reference as it was measured",
    )


def _mean_squares(upper: Floats, lower: Floats, lag: int) -> tuple[float, float]:
    """Compute both structure functions at a lag from the changes that both have; zeros where these are too few."""
    changes = [speed[lag:] - speed[:-lag] for speed in (upper, lower)]
    known = np.isfinite(changes[0] + changes[1])
    if known.sum() < FEWEST:
        return 0.0, 0.0
    first, second = (float(np.mean(change[known] ** 2)) for change in changes)
    return first, second


def _curvature(speed: Floats) -> float:
    """Compute the ratio of the median second to the median first difference: 0 for straight lines, 1.7 for noise."""
    first, second = (np.abs(np.diff(speed, k)) for k in (1, 2))
    if np.isfinite(second).sum() < FEWEST:
        return np.nan
    return float(np.nanmedian(second) / max(float(np.nanmedian(first)), 1e-9))


def _share_repeated(reference: Record) -> float:
    """Compute the share of samples whose velocities are, in all cells, those of the sample before."""
    change = np.maximum(np.abs(np.diff(reference.east, axis=0)), np.abs(np.diff(reference.north, axis=0)))
    known = np.isfinite(change)
    compared = known.any(axis=1)
    repeated = np.where(known, change, 0.0).max(axis=1, initial=0.0) < EQUAL_M_S
    return float(repeated[compared].mean()) if compared.sum() >= FEWEST else 0.0
