"""The exact compass with tilt: five coefficients of the level compass and one of heeling, in the full three dimensions.

Iron turns with the instrument, the earth's field does not. With the level coefficients known, tilt adds one unknown at
first order: what stands along the instrument's own vertical, the hard iron's third axis and (S33 - S11) Z together.
It is carried here as hard iron, K = b_z / H; the other parts of the tilted compass follow from A, D, E and the dip
(physics page, section 4; von Appen 2015 leaves them out). A pair's scores of B and C times pitch and roll are its score
of K, so the level likelihood serves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compasslib import angles, compass
from compasslib.deviation import exact, model, spread
from compasslib.deviation.model import Fit
from compasslib.deviation.prior import Prior
from compasslib.records import Pairs
from compasslib.types import Floats

STEPS = 8
HEELING_PRIOR = 0.5  # width of the weak prior of K: vertical iron of half the horizontal field


def coefficients_at(level: Floats, heeling: float, dip_ratio: float, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Return A..E at each tilt, (5, n).

    Args:
        level: A..E of the level compass, (5,).
        heeling: K, vertical hard iron over the horizontal field.
        dip_ratio: Z/H of the earth's field.
        pitch_deg: forward up, (n,), degrees; NaN counts as level.
        roll_deg: starboard down, (n,), degrees; NaN counts as level.
    """
    a, b, c, d, e = level
    soft = np.array([[1.0 + d, e - a, 0.0], [e + a, 1.0 - d, 0.0], [0.0, 0.0, 1.0]])
    return compass.level_coefficients(
        soft,
        np.array([b, c, heeling]),
        horizontal_nT=1.0,
        vertical_nT=dip_ratio,
        pitch_deg=np.nan_to_num(pitch_deg),
        roll_deg=np.nan_to_num(roll_deg),
    )


def along(fit: Fit, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Return the coefficients of a fit at each sample, (5, n), or (5,) where it is level.

    Args:
        pitch_deg: forward up, (n,), degrees.
        roll_deg: starboard down, (n,), degrees.
    """
    if not fit.tilted:
        return fit.coefficients
    return coefficients_at(fit.coefficients, fit.heeling, fit.dip_ratio, pitch_deg, roll_deg)


def jacobian(fit: Fit, pitch_deg: Floats, roll_deg: Floats) -> Floats:
    """Return the derivative of the coefficients at each tilt by A..E and K, (5, 6, n).

    Args:
        fit: a compass with tilt.
        pitch_deg: forward up, (n,), degrees.
        roll_deg: starboard down, (n,), degrees.
    """
    at = np.append(fit.coefficients, fit.heeling)
    columns = []
    for unit in 1e-5 * np.eye(6):
        ahead, behind = (
            coefficients_at((at + s * unit)[:5], (at + s * unit)[5], fit.dip_ratio, pitch_deg, roll_deg)
            for s in (1.0, -1.0)
        )
        columns.append((ahead - behind) / 2e-5)
    return np.stack(columns, axis=1)


def fit(pairs: Pairs, level: Fit, dip_ratio: float) -> Fit:
    """Return the compass with heeling that best explains the pairs, starting from the level one.

    Args:
        pairs: overlapping measurements with pitch and roll.
        level: the exact compass fitted without tilt.
        dip_ratio: Z/H of the earth's field.
    """
    at = np.append(level.coefficients, 0.0)
    value, scores = _scores(at, pairs, level, dip_ratio)
    precision = np.append(exact.PRIOR_WIDTH[:5] ** -2.0, HEELING_PRIOR**-2.0)
    believed, told, expected = _believed(pairs, level)
    for _ in range(STEPS):
        pull = scores.sum(axis=0) - precision * at - told @ (at - expected)
        step = np.linalg.solve(scores.T @ scores + np.diag(precision) + told, pull)
        tried, (better, new) = at + step, _scores(at + step, pairs, level, dip_ratio)
        while better < value and np.abs(step).max() > 1e-4:
            step = step / 2.0
            tried, (better, new) = at + step, _scores(at + step, pairs, level, dip_ratio)
        if better < value:
            break
        at, value, scores = tried, better, new
    found = replace(level, coefficients=at[:5], heeling=float(at[5]), dip_ratio=dip_ratio)
    levelled = _levelled(at, pairs, dip_ratio)
    covariance = spread.covariance(scores, precision, found, levelled, level.n_effective, believed)
    return replace(found, covariance=covariance)


def _believed(pairs: Pairs, level: Fit) -> tuple[Prior | None, Floats, Floats]:
    """Return what other records tell as often as the pairs repeat each other; its precision and mean with K, (6,)."""
    told, expected = np.zeros((6, 6)), np.zeros(6)
    if level.prior is None:
        return None, told, expected
    counted = spread.repeated(pairs, level.n_effective)
    believed = replace(level.prior, precision=counted * level.prior.precision)
    told[:5, :5], expected[:5] = believed.precision, believed.mean
    return believed, told, expected


def _scores(at: Floats, pairs: Pairs, level: Fit, dip_ratio: float) -> tuple[float, Floats]:
    """Return the log-likelihood and each pair's gradient by A..E and K, (n, 6)."""
    value, scores = exact.scores_at(at[:5], _levelled(at, pairs, dip_ratio), level)
    tried = replace(level, coefficients=at[:5], heeling=float(at[5]), dip_ratio=dip_ratio)
    return value, np.einsum("nj,jkn->nk", scores, jacobian(tried, pairs.pitch_deg, pairs.roll_deg))


def _levelled(at: Floats, pairs: Pairs, dip_ratio: float) -> Pairs:
    """Return the pairs as a level compass would have recorded them, at the heading that the overlap favours."""
    tilted = coefficients_at(at[:5], at[5], dip_ratio, pairs.pitch_deg, pairs.roll_deg)
    heading = model.nearest_root(compass.inverse(tilted, pairs.heading_deg), model.observed_heading(pairs))
    moved = compass.recorded_heading(tilted, heading) - compass.recorded_heading(at[:5], heading)
    shift = np.where(np.isfinite(moved), angles.wrap180(moved), 0.0)
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, -shift)
    return replace(pairs, heading_deg=angles.wrap360(pairs.heading_deg - shift), upper_east=east, upper_north=north)
