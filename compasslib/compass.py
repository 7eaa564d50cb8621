"""The exact compass near iron: forward model, with tilt, and its inverse in closed form.

In the body frame (forward, starboard, down) the level horizontal field is q = X - iY. By Poisson's equations it is, up
to a positive factor, q = u w + p + v / w with w = e^{i beta}, where beta is the correct magnetic heading; the compass
records gamma = arg q. The five real coefficients A, B, C, D, E, dimensionless, shape (5,) or (5, n), enter as
u = 1 - iA, p = B - iC, v = D - iE. This is Le Menn et al. 2023, eq. (4), with the cosine in its denominator and the
correct heading as its argument; its first order is von Appen 2015, eq. (1).
"""

import numpy as np
from numpy.typing import ArrayLike

from compasslib import angles
from compasslib.types import Complexes, Floats


def level_field(coefficients: ArrayLike, heading_deg: ArrayLike) -> Complexes:
    """Compute q, the horizontal field in the body frame relative to the scaled earth's field."""
    u, p, v = _complex(coefficients)
    w = angles.phasor(heading_deg)
    return u * w + p + v * np.conj(w)


def recorded_heading(coefficients: ArrayLike, heading_deg: ArrayLike) -> Floats:
    """Compute gamma, the heading that the compass records, degrees in [0, 360)."""
    return angles.argument(level_field(coefficients, heading_deg))


def slope(coefficients: ArrayLike, heading_deg: ArrayLike) -> Floats:
    """Compute d gamma / d beta: sluggish below 1, unsteady above 1, negative where the compass turns backwards."""
    u, p, v = _complex(coefficients)
    w = angles.phasor(heading_deg)
    with np.errstate(invalid="ignore"):  # no heading, no slope
        return np.real((u * w - v * np.conj(w)) / (u * w + p + v * np.conj(w)))


def gradient(coefficients: ArrayLike, heading_deg: ArrayLike) -> Floats:
    """Compute the derivative of gamma by A, B, C, D, E, degrees per unit coefficient, shape (5, n)."""
    w = angles.phasor(heading_deg)
    unit = np.ones_like(w)
    columns = np.stack([-1j * w, unit, -1j * unit, np.conj(w), -1j * np.conj(w)])
    with np.errstate(invalid="ignore"):  # no heading, no slope
        return np.imag(columns / level_field(coefficients, heading_deg)) / angles.DEGREE


def inverse(coefficients: ArrayLike, recorded_deg: ArrayLike) -> Floats:
    """Compute the correct headings that correspond to recorded headings.

    With g = e^{-i gamma} the quadratic [g u - (g v)*] w^2 + [g p - (g p)*] w + [g v - (g u)*] = 0 is self-inversive:
    its roots lie on the unit circle exactly where the middle coefficient's modulus is at most twice the leading one's.

    Returns:
        Headings beta in [0, 360), shape (n, 2), the root of larger slope first, NaN where there is none.
    """
    u, p, v = _complex(coefficients)
    g = np.conj(angles.phasor(recorded_deg))
    lead = g * u - np.conj(g * v)
    middle = g * p - np.conj(g * p)
    last = g * v - np.conj(g * u)
    on_circle = np.abs(middle) <= 2.0 * np.abs(lead)
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(middle**2 - 4.0 * lead * last)
        w = np.stack([-middle + root, -middle - root], axis=-1) / (2.0 * lead)[..., None]
        beta = angles.argument(w)
        q = level_field(np.asarray(coefficients, dtype=float)[..., None], beta)
        facing = np.real(g[..., None] * q) > 0
    beta = np.where(facing & on_circle[..., None], beta, np.nan)
    steepness = slope(np.asarray(coefficients, dtype=float)[..., None], beta)
    order = np.argsort(np.where(np.isfinite(beta), -steepness, np.inf), axis=-1)
    return np.take_along_axis(beta, order, axis=-1)


def turns_full_circle(coefficients: ArrayLike) -> bool:
    """Check whether the compass turns once per turn of the instrument, so that every reading has one inverse."""
    u, p, v = (complex(np.asarray(z)) for z in _complex(coefficients))
    return abs(np.conj(u) * p - v * np.conj(p)) < abs(u) ** 2 - abs(v) ** 2


def recorded_range(coefficients: ArrayLike) -> tuple[float, float]:
    """Compute the range of headings that can be recorded, clockwise: (0, 360), or both folds, the second up to 720."""
    if turns_full_circle(coefficients):
        return 0.0, 360.0
    fine = np.arange(0.0, 360.0, 0.05)
    gamma = recorded_heading(coefficients, fine)
    unwrapped = gamma[0] + np.cumsum(np.append(0.0, angles.difference(gamma[1:], gamma[:-1])))
    width = float(np.ptp(unwrapped))
    low = float(angles.wrap360(unwrapped.min()))
    return low, low + width


def levelling(pitch_deg: ArrayLike, roll_deg: ArrayLike) -> Floats:
    """Compute T = Ry(pitch, forward up) Rx(roll, starboard down), from the body to the level frame, (..., 3, 3)."""
    sp, cp = angles.sin_cos(pitch_deg)
    sr, cr = angles.sin_cos(roll_deg)
    sp, cp, sr, cr = np.broadcast_arrays(sp, cp, sr, cr)
    rows = [[cp, sp * sr, sp * cr], [np.zeros_like(cp), cr, -sr], [-sp, cp * sr, cp * cr]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def level_coefficients(
    soft: ArrayLike,
    hard_nT: ArrayLike,
    *,
    horizontal_nT: ArrayLike,
    vertical_nT: ArrayLike,
    pitch_deg: ArrayLike = 0.0,
    roll_deg: ArrayLike = 0.0,
) -> Floats:
    """Compute A, B, C, D, E due to iron in the body frame at each tilt, shape (5, ...).

    In a tilted instrument S' = T S T^T and b' = T b (physics page, section 4): the vertical field and the third axis
    of the iron contribute (heeling error), to first order in proportion to pitch and roll.

    Args:
        soft: soft-iron matrix S acting on the field, identity without iron, shape (3, 3) or (n, 3, 3).
        hard_nT: field of the hard iron, forward, starboard, down, nT, shape (3,) or (n, 3).
        vertical_nT: earth's vertical field Z, nT, down positive.
    """
    t = levelling(pitch_deg, roll_deg)
    s = t @ np.asarray(soft, dtype=float) @ np.swapaxes(t, -1, -2)
    b = (t @ np.asarray(hard_nT, dtype=float)[..., None])[..., 0]
    h, z = np.asarray(horizontal_nT, dtype=float), np.asarray(vertical_nT, dtype=float)
    scale = (s[..., 0, 0] + s[..., 1, 1]) / 2.0
    return np.stack(
        [
            (s[..., 1, 0] - s[..., 0, 1]) / (2.0 * scale),
            (b[..., 0] + s[..., 0, 2] * z) / (scale * h),
            (b[..., 1] + s[..., 1, 2] * z) / (scale * h),
            (s[..., 0, 0] - s[..., 1, 1]) / (2.0 * scale),
            (s[..., 1, 0] + s[..., 0, 1]) / (2.0 * scale),
        ]
    )


def _complex(coefficients: ArrayLike) -> tuple[Complexes, Complexes, Complexes]:
    a, b, c, d, e = np.asarray(coefficients, dtype=float)
    return 1.0 - 1j * a, b - 1j * c, d - 1j * e
