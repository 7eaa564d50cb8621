"""The scatter of directions fitted with the compass held: its floor, what slow water adds, the outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib.deviation import climb
from compasslib.deviation.likelihood import CELL_DEG, FREEDOM, widths
from compasslib.deviation.model import Noise

Floats = NDArray[np.floating]

# The cells resolve no less than these: log(floor), log(slow part), logit(outliers).
BOUNDS = np.array([(np.log(CELL_DEG), np.log(90.0)), (np.log(0.05), np.log(50.0)), (-9.0, 2.0)])
BELIEF = np.array([np.log(8.0), np.log(2.5), -4.0])  # weak, of width 1
STEPS = 15
POWER = (FREEDOM + 1.0) / 2.0  # of Student's t: three


@dataclass(frozen=True)
class Seen:
    """What the scatter is fitted to; n pairs."""

    given: Floats  # (n, CELLS) distribution of the correct heading, the direction left out
    squared_chord: Floats  # (n, CELLS) of the observed heading, square degrees
    upper_speed: Floats  # (n,) m/s
    lower_speed: Floats  # (n,) m/s


def fit(seen: Seen, near: Noise) -> Noise:
    """Return the scatter under which the observed headings are likeliest; the compass's own noise is not in it.

    Args:
        seen: the pairs.
        near: where to start.
    """

    def loss(x: Floats) -> tuple[float, Floats]:
        value, slope = log_likelihood(x, seen)
        off = x - BELIEF
        return 0.5 * float(off @ off) - value, off - slope

    start = [np.log(near.floor_deg), np.log(near.slow_deg_m_s), np.log(near.outliers / (1.0 - near.outliers))]
    return _noise(climb.minimise(loss, np.array(start), BOUNDS, STEPS)[0])


def log_likelihood(x: Floats, seen: Seen) -> tuple[float, Floats]:
    """Return the log-likelihood and its gradient.

    With r = 1 / (1 + chord^2 / (FREEDOM width^2)) the density is r^POWER over its sum, and a relative change of the
    width moves the logarithm of r^POWER by 2 POWER (1 - r).

    Args:
        x: logarithms of floor and slow part (degrees, degrees times m/s), logit of the share of outliers, (3,).
        seen: the pairs.
    """
    noise = _noise(x)
    width = widths(noise, seen.upper_speed, seen.lower_speed)
    ratio = seen.squared_chord / (FREEDOM * width[:, None] ** 2)
    ratio += 1.0
    np.reciprocal(ratio, out=ratio)
    density = ratio * ratio  # a power is ten times as slow
    density *= ratio
    whole, agreeing = density.sum(axis=1), np.einsum("nc,nc->n", seen.given, density)
    density *= ratio
    by_width = 2.0 * POWER * (agreeing * density.sum(axis=1) / whole - np.einsum("nc,nc->n", seen.given, density))
    told = (1.0 - noise.outliers) / (CELL_DEG * whole)
    joint = told * agreeing + noise.outliers / 360.0
    by_width *= told / joint * (width < 360.0) / width**2  # capped at a full turn
    by_outliers = (noise.outliers / 360.0 - noise.outliers * agreeing / (CELL_DEG * whole)) * (1.0 - noise.outliers)
    floor = noise.floor_deg**2
    slope = [np.sum(by_width) * floor, np.sum(by_width * (width**2 - floor)), np.sum(by_outliers / joint)]
    return float(np.sum(np.log(joint))), np.array(slope)


def _noise(x: Floats) -> Noise:
    return Noise(float(np.exp(x[0])), float(np.exp(x[1])), float(1.0 / (1.0 + np.exp(-x[2]))))
