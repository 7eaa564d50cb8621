"""The geometry of four slanted beams: from along-beam velocities to the earth's axes.

Y points along beam 3, which is forward. X is starboard and Z up on a down-looker; X is port and Z down on an up-looker.
Recorded tilts: tilt 1 positive with beam 3 up, tilt 2 positive starboard down, in both orientations. Source: RDI, ADCP
Coordinate Transformation; design of signs checked against known answers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.records import Floats

# Error velocity is a multiple of b1 + b2 - b3 - b4.
_ERROR_SIGNS = np.array([1.0, 1.0, -1.0, -1.0])


def three_beam(beams: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the beams with a single missing one filled so that the error velocity is zero, and where that was done.

    Args:
        beams: (..., 4) m/s, NaN where missing; two or more missing ones stay missing.
    """
    missing = np.isnan(beams)
    alone = missing.sum(axis=-1) == 1
    if not alone.any():
        return beams, alone
    rest = np.nansum(beams * _ERROR_SIGNS, axis=-1, keepdims=True)
    return np.where(missing & alone[..., None], -_ERROR_SIGNS * rest, beams), alone


def beams_to_instrument(
    beams: Floats, beam_angle_deg: ArrayLike, convex: ArrayLike = True
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return (x, y, z, error) in the instrument's axes.

    Args:
        beams: (..., 4) m/s, positive towards the head.
        beam_angle_deg: of the beams from the vertical, degrees; broadcasts with (...).
        convex: whether the head is convex; broadcasts with (...).
    """
    b1, b2, b3, b4 = (beams[..., i] for i in range(4))
    sine, cosine = angles.sin_cos(beam_angle_deg)
    # The beams of a concave head cross, so that each looks to the other side.
    across = np.where(convex, 1.0, -1.0) / (2.0 * sine)
    x, y = across * (b1 - b2), across * (b4 - b3)
    return x, y, (b1 + b2 + b3 + b4) / (4.0 * cosine), (b1 + b2 - b3 - b4) / (2.0 * np.sqrt(2.0) * sine)


def true_pitch(tilt1_deg: ArrayLike, tilt2_deg: ArrayLike) -> Floats:
    """Return the pitch proper, atan(tan tilt1 cos tilt2), degrees; the pitch sensor hangs inside the roll.

    Args:
        tilt1_deg: recorded pitch, degrees.
        tilt2_deg: recorded roll, degrees.
    """
    (sine, cosine), (_, across) = angles.sin_cos(tilt1_deg), angles.sin_cos(tilt2_deg)
    return angles.wrap180(angles.direction(sine * across, cosine))


def instrument_to_earth(
    xyz: tuple[Floats, Floats, Floats], heading_deg: Floats, tilt1_deg: Floats, tilt2_deg: Floats, looks_up: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Return (east, north, up), to the north that the heading refers to.

    Args:
        xyz: velocities in the instrument's axes, (n, m) or (n,), m/s.
        heading_deg: of beam 3, (n,) degrees.
        tilt1_deg: recorded pitch, (n,) degrees.
        tilt2_deg: recorded roll, (n,) degrees.
        looks_up: (n,) or one; the maker turns an up-looker by 180 degrees about its roll axis.
    """
    x, y, z = xyz
    roll = np.asarray(tilt2_deg) + np.where(looks_up, 180.0, 0.0)
    pitch = true_pitch(tilt1_deg, tilt2_deg)
    (sp, cp), (sr, cr) = ((_column(a, x), _column(b, x)) for a, b in (angles.sin_cos(pitch), angles.sin_cos(roll)))
    starboard = x * cr + z * sr
    forward = x * (sp * sr) + y * cp - z * (sp * cr)
    up = -x * (cp * sr) + y * sp + z * (cp * cr)
    east, north = ship_to_earth(starboard, forward, heading_deg)
    return east, north, up


def ship_to_earth(starboard: Floats, forward: Floats, heading_deg: Floats) -> tuple[Floats, Floats]:
    """Return (east, north) of velocities in level axes.

    Args:
        starboard: (n, m) or (n,), m/s.
        forward: the same.
        heading_deg: of the forward axis, (n,) degrees.
    """
    return angles.turn(starboard, forward, _column(heading_deg, starboard))


def _column(per_sample: ArrayLike, like: Floats) -> Floats:
    values = np.asarray(per_sample, dtype=float)
    return values.reshape(values.shape + (1,) * (like.ndim - values.ndim)) if values.ndim else values
