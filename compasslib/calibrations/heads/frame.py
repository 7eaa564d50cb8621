"""Whether two heads stand on one rigid frame, by their tilts alone, and how one is turned in the other's body.

What points down, seen in b's body, is a constant rotation of what points down in a's: v_b = R v_a. The rotation is
found by Procrustes' method (Kabsch, Acta Cryst. A32, 922, 1976), with noise in both heads alike. Its turn about the
vertical is the mounting angle, with no compass in it. Both orientations use the same body axes forward, starboard,
down (physics page, section 8), so that a head which looks up fits like any other; a mirrored fit betrays a roll that
was counted the other way.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations.heads.motion import down, independent, tilts
from compasslib.statistics import autocorrelation, blocks
from compasslib.types import Complexes, Floats

STRETCHES = 30  # in which the residual is looked at
RIGID_DEG = 0.5  # rms of the difference of two inclinometers by their makers' word
LOOSE_DEG = 1.5  # no two inclinometers of one frame differ so much
STILL_DEG = 0.3  # tilts that vary less than this tell nothing of a rotation
TWISTS = 3  # a lean turns the forward axis in the second order, taken back by iteration
FOLLOWS = 0.5  # correlation of the tilts below which b does not follow a


@dataclass(frozen=True)
class Frame:
    """How b is mounted against a."""

    rotation: Floats  # (3, 3) from a's body to b's
    residual_deg: Floats  # (n,) angle between what points down by b and by a, turned
    offset_deg: float  # of b's forward axis clockwise from a's, by the tilts
    offset_sigma_deg: float  # NaN where the tilts do not tell
    rms_deg: float
    variation_deg: float  # rms of a's tilt about its mean
    correlation: float  # of the tilts, mirrored or not
    mirrored: bool
    verdict: str  # rigid | doubtful | not rigid | mirrored | not testable
    text: str


def fit(time_s: Floats, lean_a: Complexes, lean_b: Complexes) -> Frame:
    """Return the constant rotation that best takes a's tilts to b's, and what is left.

    Args:
        time_s: of the samples, increasing, (n,).
        lean_a: forward + i starboard of what points down in a's body, (n,).
        lean_b: the same in b's, (n,).
    """
    rotation = _rotation(down(lean_b).T @ down(lean_a))
    residual = _angle(down(lean_a) @ rotation.T, down(lean_b))
    offset, sigma = twist(rotation), _twist_sigma(time_s, lean_a, lean_b, rotation)
    proper, mirrored, variation = _correlations(lean_a, lean_b)
    rms = float(np.sqrt(np.mean(residual**2)))
    verdict, text = _verdict(rms, variation, proper, mirrored, residual, blocks.in_time(time_s, STRETCHES))
    determined = variation >= STILL_DEG and verdict in ("rigid", "doubtful")
    return Frame(
        rotation=rotation,
        residual_deg=residual,
        offset_deg=offset,
        offset_sigma_deg=sigma if determined else float("nan"),
        rms_deg=rms,
        variation_deg=variation,
        correlation=max(proper, mirrored),
        mirrored=verdict == "mirrored",
        verdict=verdict,
        text=text,
    )


def twist(rotation: Floats) -> float:
    """Return by how much b's forward axis points clockwise of a's on an upright frame, degrees.

    Args:
        rotation: from a's body to b's, (3, 3).
    """
    return float(angles.wrap180(angles.direction(rotation[0, 1], rotation[0, 0])))


def upright(offset_deg: float, lean_a: Complexes, lean_b: Complexes) -> Floats:
    """Return the rotation from a's body to b's with a given turn about the vertical, the least lean added, (3, 3).

    Args:
        offset_deg: of b's forward axis clockwise from a's.
        lean_a: forward + i starboard of what points down in a's body, (n,).
        lean_b: the same in b's, (n,).
    """
    turn = offset_deg
    for _ in range(TWISTS):
        rotation = _leaned(turn, down(lean_a).mean(axis=0), down(lean_b).mean(axis=0))
        turn += float(angles.difference(offset_deg, twist(rotation)))
    return rotation


def turned_heading(heading_a_deg: Floats, lean_a: Complexes, rotation: Floats) -> Floats:
    """Return the heading that b must have, from a's heading and tilts and the rotation between them, [0, 360).

    The forward axis of b, seen in a's body, is turned level by a's tilts and north by a's heading. Under tilt this
    differs from a constant offset in the second order: up to half a degree at ten.

    Args:
        heading_a_deg: (n,).
        lean_a: forward + i starboard of what points down in a's body, (n,).
        rotation: from a's body to b's, (3, 3).
    """
    level = compass.levelling(*tilts(lean_a)) @ rotation[0]
    return angles.wrap360(heading_a_deg + angles.direction(level[:, 1], level[:, 0]))


def _leaned(turn_deg: float, down_a: Floats, down_b: Floats) -> Floats:
    """Return a turn about the vertical followed by the least rotation that takes one mean tilt to the other."""
    sine, cosine = (float(x) for x in angles.sin_cos(turn_deg))
    turned = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    one, other = (x / np.linalg.norm(x) for x in (turned @ down_a, down_b))
    return _swing(one, other) @ turned


def _twist_sigma(time_s: Floats, lean_a: Complexes, lean_b: Complexes, rotation: Floats) -> float:
    """Return the standard deviation of the turn about the vertical, by leaving out stretches of the record."""
    a, b = down(lean_a), down(lean_b)
    back = (b @ rotation)[:, :2] @ np.array([1.0, 1.0j])
    aside = np.imag(np.conj(lean_a - lean_a.mean()) * (back - lean_a))
    count, widened = independent(autocorrelation.effective_number(aside - aside.mean(), time_s))
    stretch = blocks.in_time(time_s, count)
    parts = [b[stretch == k].T @ a[stretch == k] for k in np.unique(stretch)]
    whole = np.sum(parts, axis=0)
    away = angles.difference([twist(_rotation(whole - part)) for part in parts], twist(rotation))
    return float(np.sqrt(np.sum((away - away.mean()) ** 2) * (len(parts) - 1) / len(parts) * widened))


def _rotation(moment: Floats) -> Floats:
    left, _, right = np.linalg.svd(moment)
    sign = np.sign(np.linalg.det(left @ right))
    return np.asarray(left * [1.0, 1.0, sign] @ right)


def _swing(one: Floats, other: Floats) -> Floats:
    """Return the least rotation that takes one unit vector to another (Rodrigues)."""
    x, y, z = np.cross(one, other)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + one @ other))


def _angle(one: Floats, other: Floats) -> Floats:
    return 2.0 * np.arcsin(np.minimum(np.linalg.norm(one - other, axis=1) / 2.0, 1.0)) / angles.DEGREE


def _correlations(lean_a: Complexes, lean_b: Complexes) -> tuple[float, float, float]:
    """Return how well b's tilts follow a's turned, how well a's mirrored, and how much a's vary, degrees rms."""
    a, b = lean_a - lean_a.mean(), lean_b - lean_b.mean()
    scale = max(float(np.sqrt(np.sum(np.abs(a) ** 2) * np.sum(np.abs(b) ** 2))), 1e-300)
    variation = float(np.sqrt(np.mean(np.abs(a) ** 2))) / angles.DEGREE
    return float(abs(np.sum(np.conj(a) * b))) / scale, float(abs(np.sum(a * b))) / scale, variation


def _verdict(
    rms: float, variation: float, proper: float, mirrored: float, residual: Floats, stretch: NDArray[np.intp]
) -> tuple[str, str]:
    if variation < STILL_DEG:
        return (
            "not testable",
            f"The tilts vary by {variation:.2f}° rms only: they cannot tell whether the frame is rigid.",
        )
    if mirrored >= FOLLOWS and mirrored > proper + 0.2:
        return "mirrored", (
            "The tilts of b follow those of a mirrored: one head counts its roll the other way, or its orientation "
            "(up or down) was mistaken. No mounting angle is taken from them."
        )
    if proper < FOLLOWS or rms > LOOSE_DEG:
        return "not rigid", (
            f"The tilts of b do not follow those of a by one rotation ({rms:.2f}° rms is left of {variation:.2f}°, "
            f"correlation {proper:.2f}): the heads do not stand on one rigid frame, or a tilt sensor is broken."
        )
    worst = max(float(np.sqrt(np.mean(residual[stretch == k] ** 2))) for k in np.unique(stretch))
    rotation = (
        f"One rotation takes a's tilts to b's; {rms:.2f}° rms is left of {variation:.2f}° (worst stretch {worst:.2f}°)"
    )
    if rms <= RIGID_DEG and worst <= LOOSE_DEG:
        return "rigid", rotation + ": the frame is rigid as far as inclinometers tell."
    return "doubtful", rotation + ": more than two good inclinometers differ by."
