"""Whether a bench's deviation is too large for the five-term series: against the exact compass, which has five too."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibration import exact_curve, series
from compasslib.calibration.series import SMITH, Points
from compasslib.deviation import von_appen
from compasslib.discrepancy import show
from compasslib.discrepancy.recordings import telling
from compasslib.discrepancy.show import HeldOut
from compasslib.discrepancy.verdict import Finding

Floats = NDArray[np.floating]

REPEATS, FOLDS = 400, 5
LEAST_SQUARES = 1e-12  # squared degrees: readings that a curve holds to the last digit prefer none
CLEARLY = 6.0  # twice the log likelihood by which the series must be better to stand for the compass


def findings(seen: Points, min_effect_deg: float, alarm: float) -> list[Finding]:
    """Return the finding that the exact compass fits where the series does not, or none.

    The likelihood ratio is held against benches drawn from the series itself.

    Args:
        seen: the readings.
        min_effect_deg: size below which the difference does not matter, rms.
        alarm: probability of a name where the series holds.
    """
    left = _residuals(seen)
    if left is None:
        return []
    size = angles.rms(left[0] - left[1])
    if size < min_effect_deg or _probability(seen, _ratio(seen, left)) > alarm:
        return []
    proof = _held_out(seen, max(angles.rms(left[1]), 1e-3))
    return [] if proof.refuted else [telling.large(size, proof, "the five-term series")]


def _held_out(seen: Points, scale_deg: float) -> HeldOut:
    """Return the gain of the exact compass over the series on readings that neither was fitted to."""
    fold, left = np.arange(len(seen)) % FOLDS, np.full((2, len(seen)), np.nan)
    for k in range(FOLDS):
        both = _residuals(seen, fold != k)
        if both is not None:
            left[:, fold == k] = np.stack(both)[:, fold == k]
    known = np.isfinite(left).all(axis=0)
    left = left[:, known]
    squares = np.minimum(left**2, (10.0 * scale_deg) ** 2)
    gains = (squares[0] - squares[1]) / (2.0 * scale_deg**2)
    return show.judged(gains, np.flatnonzero(known), (angles.rms(left[0]), angles.rms(left[1])))


def series_fits_better(seen: Points) -> bool:
    """Tell whether the series stands for the compass better than the exact one does.

    Args:
        seen: the readings.
    """
    left = _residuals(seen)
    return left is None or _ratio(seen, left) < -CLEARLY


def _residuals(seen: Points, fitted: NDArray[np.bool_] | None = None) -> tuple[Floats, Floats] | None:
    """Return what the best series and the best exact compass (of some readings) leave of the correct heading, (n,)."""
    some = (
        seen if fitted is None else Points(seen.recorded_deg[fitted], seen.deviation_deg[fitted], seen.weight[fitted])
    )
    solved, five = exact_curve.solve(some), SMITH.solve(some)
    if solved is None or five is None:
        return None
    by_series = angles.wrap180(seen.deviation_deg - von_appen.design(seen.recorded_deg) @ five.coefficients)
    roots = compass.inverse(solved.coefficients, seen.recorded_deg)
    off = angles.difference((seen.recorded_deg + seen.deviation_deg)[:, None], roots)
    nearest = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
    by_exact = off[np.arange(len(off)), nearest]
    slope = -1.0 / exact_curve.steepness(solved.coefficients, seen)
    lost = slope * solved.residual_deg if fitted is None else np.full(len(seen), show.LOST_DEG)
    return by_series, np.where(np.isfinite(by_exact), by_exact, lost)


def _ratio(seen: Points, left: tuple[Floats, Floats]) -> float:
    by_series, by_exact = (max(float(np.sum(each**2)), LEAST_SQUARES) for each in left)
    return len(seen) * float(np.log(by_series / by_exact))


def _probability(seen: Points, ratio: float) -> float:
    """Return how often a bench that the series holds gives as large a ratio."""
    solution, rng = SMITH.solve(seen), np.random.default_rng(7)
    if solution is None:
        return 1.0
    scatter = float(np.sqrt(np.sum(solution.residual_deg**2) / (len(seen) - 5)))
    drawn = 0
    for _ in range(REPEATS):
        deviation = von_appen.design(seen.recorded_deg) @ solution.coefficients
        again = series.Points(seen.recorded_deg, deviation + rng.normal(0.0, scatter, len(seen)), seen.weight)
        left = _residuals(again)
        drawn += left is not None and _ratio(again, left) >= ratio
    return (drawn + 1) / (REPEATS + 1)
