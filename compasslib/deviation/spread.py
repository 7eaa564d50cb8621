"""How far the fitted coefficients may be off: autocorrelated pairs, water that veers by direction, the wake's lock."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.deviation import model
from compasslib.deviation.likelihood import FREEDOM
from compasslib.deviation.model import Fit
from compasslib.deviation.prior import Prior
from compasslib.records import Pairs
from compasslib.statistics import blocks, robust
from compasslib.types import Floats

BLOCK_S = 5 * 86400.0  # longer than the memory of the currents' veer
FEWEST_BLOCKS = 12
# Independent pairs in time, and by water that is passed through, as a lowered instrument does: days show hardly any of
# the veer's own memory, which takes itself for its mean.
MOST_A_DAY, LAYER_M = 4.0, 20.0
OCTANTS = 8
# Gradient by a dimensionless coefficient: of a direction known to a degree it is 60. Where the iron's field cancels
# the earth's the compass turns round at once, the gradient has no bound, and one pair would settle all coefficients.
STEEPEST = 1e3
# Correlation of the veer with the heading's own excursions. The wake locks the heading to water that is itself sheared
# across the sphere; simulated moorings show 0.03 to 0.1, and no record can tell that part from iron. Assumed.
WAKE_LOCKED_VEER = 0.05


def covariance(
    scores: Floats, precision: Floats, fit: Fit, pairs: Pairs, effective: float, believed: Prior | None = None
) -> Floats:
    """Return the covariance that holds for autocorrelated pairs and for water that veers by direction.

    Along time it is the jackknife over blocks of days. Across flow directions the scores of each octant are summed:
    real water veers between two depths differently for each direction of flow, for months, which no block of days
    shows. What the octants vary beyond the blocks is added, and so is what the profile tells of water turned for good;
    then an allowance for veer that follows the heading.

    Args:
        scores: each pair's gradient of the log-likelihood, (n, p).
        precision: of the weak priors, (p,).
        fit: coefficients and noise of the exact compass.
        believed: what other records tell, counted as often as the pairs repeat each other (``repeated``).
    """
    scores = np.clip(scores, -STEEPEST, STEEPEST)
    information = scores.T @ scores + np.diag(precision)
    if believed is not None:
        information[:5, :5] += believed.precision
    along_time = _jackknife(scores, information, pairs, effective)
    inverse = np.linalg.inv(information)
    octant = _flow_octant(fit, pairs)
    sums = blocks.sums(scores, octant)
    across = inverse @ (sums.T @ sums) @ inverse * OCTANTS / (OCTANTS - 1)
    by_degree = _by_degree(fit, pairs)
    turned = inverse @ (scores.T @ by_degree) * pairs.veer_deg
    locked = inverse @ (scores.T @ (by_degree * _locked_veer(fit, pairs)))
    few = len(np.unique(blocks.of_span(pairs.time_s, BLOCK_S))) < FEWEST_BLOCKS
    if believed is not None and not few:  # with few, the inverse holds it already
        along_time += repeated(pairs, effective) * inverse[:, :5] @ believed.precision @ inverse[:5]
    shown = along_time + positive_part(across - along_time)
    return shown + positive_part(np.outer(turned, turned) - shown) + np.outer(locked, locked)


def _by_degree(fit: Fit, pairs: Pairs) -> Floats:
    """Return what a degree of veer does to each pair's log-likelihood, (n,)."""
    left = np.nan_to_num(model.residual(fit, pairs))
    return (FREEDOM + 1.0) * left / (FREEDOM * _width(fit, pairs) ** 2 + left**2)


def _width(fit: Fit, pairs: Pairs) -> Floats:
    """Return the noise of each pair's direction, degrees, (n,)."""
    return fit.noise.width_deg(*(np.maximum(speed, 1e-3) for speed in model.speeds(pairs)))


def _locked_veer(fit: Fit, pairs: Pairs) -> Floats:
    """Return veer in step with the heading at each pair, one standard deviation, degrees, (n,)."""
    left, weight = np.nan_to_num(model.residual(fit, pairs)), _width(fit, pairs) ** -2.0
    heading = angles.wrap360(model.observed_heading(pairs) - left)
    excursion = angles.sin_cos(heading - angles.mean(heading, weight))[0]
    excursion = excursion - np.average(excursion, weights=weight)
    excursion = excursion / max(np.sqrt(np.average(excursion**2, weights=weight)), 1e-6)
    return WAKE_LOCKED_VEER * robust.width(left) * excursion


def _jackknife(scores: Floats, information: Floats, pairs: Pairs, effective: float) -> Floats:
    """Return the covariance by leaving out each block of days, or by how many pairs count where there are few.

    The information is the scores' outer product: it stays positive where the record hardly determines a coefficient.
    """
    block = blocks.of_span(pairs.time_s, BLOCK_S)
    if len(np.unique(block)) < FEWEST_BLOCKS:
        return np.asarray(np.linalg.inv(information) * len(pairs) / independent(pairs, effective))
    return blocks.jackknife(scores, scores, block, information)


def independent(pairs: Pairs, effective: float) -> float:
    """Return how many pairs count, what they are fitted with taken off."""
    apart = MOST_A_DAY * float(np.ptp(pairs.time_s)) / 86400.0 + float(np.ptp(pairs.upper_depth_m)) / LAYER_M
    return max(min(effective, apart) - 5.0, 3.0)


def repeated(pairs: Pairs, effective: float) -> float:
    """Return how many pairs there are for each independent one."""
    return len(pairs) / independent(pairs, effective)


def _flow_octant(fit: Fit, pairs: Pairs) -> NDArray[np.intp]:
    """Return the octant of the flow's direction, from both instruments alike so that neither's noise decides it."""
    turn = np.nan_to_num(model.observed_deviation(pairs) - model.residual(fit, pairs))
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, turn)
    towards = angles.direction(east + pairs.lower_east, north + pairs.lower_north)
    return np.floor(np.nan_to_num(towards) / (360.0 / OCTANTS)).astype(np.intp) % OCTANTS


def positive_part(matrix: Floats) -> Floats:
    """Return the nearest matrix that can be a covariance.

    Args:
        matrix: symmetric but for rounding, (p, p).
    """
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
