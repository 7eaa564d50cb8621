"""The exact compass of Evans and Smith through points whose correct and recorded headings are both known.

Le Menn et al. 2023, eq. (4), with the cosine in its denominator. Where both headings are known, Im(e^{-i gamma} q) = 0
is linear in A to E; Gauss-Newton steps from there make the residual one of the recorded heading, in degrees.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compasslib import angles, compass
from compasslib.calibrations.series import CIRCLE_DEG, LeastSquares, Points, SeriesForm, least_squares
from compasslib.types import Floats

STEPS = 20  # two are enough where the points are a compass's
SETTLED = 1e-9
STEEPEST_ERROR = 0.3  # a smaller slope, near a fold, says nothing of the correct heading's error


def solve(seen: Points) -> LeastSquares | None:
    """Return A to E of the exact compass by least squares of the recorded heading; None where none comes near.

    Args:
        seen: observed deviations, at least five.
    """
    correct = seen.recorded_deg + seen.deviation_deg
    coefficients = _linear(seen, correct)
    for _ in range(STEPS):
        step = _step(coefficients, seen, correct)
        coefficients = coefficients + step.coefficients
        if np.max(np.abs(step.coefficients)) < SETTLED:
            return replace(step, coefficients=coefficients)
        if not np.all(np.abs(coefficients) < 10.0):
            return None
    return None


def deviation(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Return the deviation at recorded headings, degrees; NaN for a compass that cannot turn full circle.

    Args:
        coefficients: A to E, dimensionless, (5,).
        recorded_deg: recorded headings, (n,), degrees.
    """
    return angles.difference(_only_root(coefficients, recorded_deg), recorded_deg)


def gradient(coefficients: Floats, recorded_deg: Floats) -> Floats:
    """Return the derivative of the deviation by A to E, (n, 5) degrees per unit.

    Args:
        coefficients: A to E, dimensionless, (5,).
        recorded_deg: recorded headings, (n,), degrees.
    """
    root = _only_root(coefficients, recorded_deg)
    # The correct heading that keeps the reading: d beta = -d gamma / (d gamma / d beta).
    return -(compass.gradient(coefficients, root) / compass.slope(coefficients, root)).T


def steepness(coefficients: Floats, seen: Points) -> Floats:
    """Return d recorded / d correct heading at each point, not nearer to 0 than it can be used, (n,).

    Args:
        coefficients: A to E, dimensionless, (5,).
    """
    slope = compass.slope(coefficients, seen.recorded_deg + seen.deviation_deg)
    return np.where(slope < 0, -1.0, 1.0) * np.maximum(np.abs(slope), STEEPEST_ERROR)


def around(coefficients: Floats) -> Floats:
    """Return the weighted derivative of the recorded heading by A to E all round, (m, 5) degrees per unit.

    Args:
        coefficients: A to E, dimensionless, (5,).
    """
    return compass.gradient(coefficients, CIRCLE_DEG).T * np.sqrt(_trust(coefficients, CIRCLE_DEG))[:, None]


def _trust(coefficients: Floats, correct_deg: Floats) -> Floats:
    """Return the weight of a recorded heading, (n,): bench and compass err alike, the bench's times the slope."""
    return 2.0 / (1.0 + compass.slope(coefficients, correct_deg) ** 2)


def _only_root(coefficients: Floats, recorded_deg: Floats) -> Floats:
    if not compass.turns_full_circle(coefficients):
        return np.full(recorded_deg.shape, np.nan)
    return compass.inverse(coefficients, recorded_deg)[:, 0]


def _linear(seen: Points, correct: Floats) -> Floats:
    """Solve sin D = A cos D + B sin g + C cos g + D sin(b + g) + E cos(b + g), which is Im(e^{-ig} q) = 0."""
    sine, cosine = angles.sin_cos(seen.recorded_deg)
    sine_sum, cosine_sum = angles.sin_cos(seen.recorded_deg + correct)
    sine_off, cosine_off = angles.sin_cos(seen.deviation_deg)
    columns = np.stack([cosine_off, sine, cosine, sine_sum, cosine_sum], axis=-1)
    return least_squares(columns, sine_off, seen.weight).coefficients


def _step(coefficients: Floats, seen: Points, correct: Floats) -> LeastSquares:
    """Return the Gauss-Newton step, with the residual of the recorded heading before it."""
    off = angles.difference(seen.recorded_deg, compass.recorded_heading(coefficients, correct))
    columns = compass.gradient(coefficients, correct).T
    return replace(least_squares(columns, off, seen.weight * _trust(coefficients, correct)), residual_deg=off)


EXACT = SeriesForm("exact", "ABCDE", "Le Menn et al. 2023, eq. (4)", solve, deviation, gradient, around, steepness)
