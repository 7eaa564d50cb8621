"""What the figures draw, as numbers: where a circle is cut, curves without jumps, points beside them, shares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles, compass
from compasslib.deviation.model import DeviationFit, observed_deviation, observed_heading
from compasslib.deviation.series import inverse_table, series_design, series_deviation
from compasslib.records import BAD, CorrectedRecord, Pairs
from compasslib.types import Floats

STEP_DEG = 0.25  # along a curve
SECTOR_DEG = 10.0  # of a histogram
GAP_WIDTH_DEG = 25.0  # over which a circle's occupation is smoothed before its gap is sought
INVERTED, BACKWARDS, GIVEN_UP = 0, 1, 2  # stretches of a curve


@dataclass(frozen=True)
class DeviationByHeading:
    """A deviation along one turn of the correct heading, continuous: nothing in it jumps by 360 degrees."""

    heading_deg: Floats  # (n,) correct heading, increasing
    deviation_deg: Floats  # (n,)
    sigma_deg: Floats  # (n,) of the deviation, from the coefficients' covariance; NaN where that is unknown
    stretch: NDArray[np.int_]  # (n,) INVERTED, BACKWARDS or GIVEN_UP

    @property
    def recorded_deg(self) -> Floats:
        """The recorded heading along the curve, (n,), continuous too."""
        return self.heading_deg - self.deviation_deg


def emptiest(angle_deg: ArrayLike) -> float:
    """Find where a circle is best cut: the middle of its emptiest part, to the sector, -180 where it is all empty.

    Args:
        angle_deg: angles of any shape, degrees, NaN left out.
    """
    occupied = sectors(angle_deg, 0.0)
    if not occupied.any():
        return -180.0
    cuts = SECTOR_DEG * np.arange(len(occupied))
    away = angles.difference(cuts[:, None], cuts + SECTOR_DEG / 2.0)
    around = np.exp(-0.5 * (away / GAP_WIDTH_DEG) ** 2) @ occupied
    return float(angles.wrap180(cuts[np.argmin(around)]))


def placed(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Wrap angles to the turn that begins at the cut, [begin, begin + 360).

    Args:
        angle_deg: angles of any shape, degrees.
    """
    return begin_deg + angles.wrap360(np.asarray(angle_deg, dtype=float) - begin_deg)


def nearest_turn(angle_deg: ArrayLike, reference_deg: ArrayLike) -> Floats:
    """Unwrap angles to less than half a turn from a reference that may stand on any turn.

    Args:
        angle_deg: angles, degrees.
        reference_deg: what they are to stand beside, degrees.
    """
    reference = np.asarray(reference_deg, dtype=float)
    return reference + angles.difference(angle_deg, reference)


def sectors(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Compute the share of the angles in each sector clockwise from the cut, (36,), percent.

    Args:
        angle_deg: angles of any shape, degrees, NaN left out.
        begin_deg: the cut, at an edge of a sector.
    """
    angle = np.asarray(angle_deg, dtype=float)
    turn = placed(angle[np.isfinite(angle)], begin_deg) - begin_deg
    count = np.histogram(turn, bins=round(360.0 / SECTOR_DEG), range=(0.0, 360.0))[0]
    return 100.0 * count / max(int(count.sum()), 1)


def curve(fit: DeviationFit, begin_deg: float, headings_deg: ArrayLike) -> DeviationByHeading:
    """Evaluate a fitted deviation over one turn.

    Args:
        begin_deg: heading at which the turn begins.
        headings_deg: correct headings at which the deviation is to be in [-180, 180) on average; all where empty.
    """
    beta = begin_deg + np.arange(0.0, 360.0 + STEP_DEG / 2.0, STEP_DEG)
    if fit.method == "von_appen":
        deviation = series_deviation(fit.coefficients, beta)
    else:
        deviation = angles.difference(beta, compass.recorded_heading(fit.coefficients, beta))
    deviation = deviation[0] + np.concatenate([[0.0], np.cumsum(angles.difference(deviation[1:], deviation[:-1]))])
    where = placed(headings_deg, begin_deg)
    there = np.interp(where[np.isfinite(where)], beta, deviation)
    level = np.median(there if there.size else deviation)
    deviation = deviation - (level - angles.wrap180(level))
    sigma = np.full(beta.shape, np.nan)
    if fit.covariance.size:
        by = series_design(beta).T if fit.method == "von_appen" else compass.gradient(fit.coefficients, beta)
        sigma = np.sqrt(np.einsum("in,ij,jn->n", by, fit.covariance[:5, :5], by))
    # The exact compass gives up no heading, but two of its headings may read the same.
    if fit.method == "von_appen":
        inverted = inverse_table(fit.coefficients)[1]
        first, last = inverted.min(), inverted.max()
        stretch = np.where(angles.wrap360(beta - first) <= last - first, INVERTED, GIVEN_UP)
    else:
        stretch = np.where(compass.slope(fit.coefficients, beta) >= 0.0, INVERTED, BACKWARDS)
    return DeviationByHeading(beta, deviation, sigma, stretch)


def observed(pairs: Pairs, shape: DeviationByHeading | None, begin_deg: float) -> tuple[Floats, Floats]:
    """Compute correct heading and deviation of each pair, (n,) each, the deviation on the curve's turn.

    Args:
        shape: the curve; the mean deviation takes its place where absent.
        begin_deg: heading at which the turn begins.
    """
    beta, deviation = placed(observed_heading(pairs), begin_deg), observed_deviation(pairs)
    if shape is None:
        return beta, nearest_turn(deviation, angles.wrap180(angles.mean(deviation)))
    return beta, nearest_turn(deviation, np.interp(beta, shape.heading_deg, shape.deviation_deg))


def usable_headings(product: CorrectedRecord) -> Floats:
    """Select the recorded headings, (n,) degrees, NaN where they are flagged bad."""
    return np.where(product.record.heading_quality < BAD, product.record.heading_deg, np.nan)
