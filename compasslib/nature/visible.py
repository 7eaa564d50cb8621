"""How much of an effect can be seen: what is left of it after five coefficients were fitted to the true headings."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compasslib.nature import readings
from compasslib.nature import water as sea
from compasslib.nature.effects import Effect, total
from compasslib.nature.sealed import Ground
from compasslib.nature.series import Complexes, Floats, direction

EVERY = 3  # hours: the size of an effect needs no more
ITERATIONS = 12
STEADIEST = 0.2  # slope of the recorded over the correct heading below which a deviation is not blown up further


def left_deg(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Return the error of the heading that the best compass of five coefficients leaves, degrees, (n,).

    Args:
        recorded_deg: readings, (n,).
        heading_deg: correct headings, (n,).
    """
    w = np.exp(1j * np.deg2rad(heading_deg))
    columns = np.stack([-1j * w, np.ones_like(w), -1j * np.ones_like(w), 1.0 / w, -1j / w], axis=1)
    values = np.zeros(5)
    for _ in range(ITERATIONS):
        q = w + columns @ values
        miss = _turn(recorded_deg, np.rad2deg(np.angle(q)))
        values = values + np.linalg.lstsq(np.imag(columns / q[:, None]), miss, rcond=None)[0]
    q = w + columns @ values
    slope = np.real((w + columns[:, 0] * values[0] - columns[:, 3] * values[3] - columns[:, 4] * values[4]) / q)
    return np.rad2deg(_turn(recorded_deg, np.rad2deg(np.angle(q)))) / np.maximum(slope, STEADIEST)


def visible_deg(ground: Ground, effect: Effect) -> float:
    """Return the visible size of one effect alone, rms degrees.

    Args:
        ground: the mooring.
        effect: what is planted.
    """
    if effect.ahead_s is not None:
        return _clock_deg(ground, effect.ahead_s)
    bare, with_it = (_ideal(ground, planted) for planted in ((), (effect,)))
    return float(np.std(with_it - bare))


def background_deg(ground: Ground) -> float:
    """Return what five coefficients leave where nothing is planted, rms degrees.

    Args:
        ground: the mooring.
    """
    return float(np.std(_ideal(ground, ())))


def _ideal(ground: Ground, effects: Sequence[Effect]) -> Floats:
    made = readings.read(ground, effects, ground.stamp_s)
    # Water that veers clockwise at the trusted instrument looks like a compass that reads too little.
    seen = made.recorded_deg - total(effects, "veer_deg", np.zeros(ground.stamp_s.size))
    return left_deg(seen[::EVERY], made.heading_deg[::EVERY])


def _clock_deg(ground: Ground, ahead_s: Floats) -> float:
    """Return by how much the direction that is paired moves, robustly: slow water may point anywhere."""
    stamps = ground.stamp_s
    at = [direction(_flow(ground, when)) for when in (stamps, stamps - ahead_s)]
    return float(1.4826 * np.median(np.abs(np.rad2deg(_turn(at[1], at[0])))))


def _flow(ground: Ground, time_s: Floats) -> Complexes:
    depth = np.interp(time_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    return sea.velocity(ground.currents, time_s, depth, depth)


def _turn(a_deg: Floats, b_deg: Floats) -> Floats:
    """Return a - b in radians, the short way."""
    return np.asarray(np.angle(np.exp(1j * np.deg2rad(a_deg - b_deg))))
