"""The one solver: a smooth function of a few numbers between bounds, climbed down by its gradient."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats

Loss = Callable[[Floats], tuple[float, Floats]]

ENOUGH_DECREASE = 1e-4  # Armijo's share of what the slope promises
SHORTENINGS = 20
FLAT, SETTLED = 1e-5, 2.2e-9  # gradient, and relative gain of a step, at which the climb ends
LEAST_CURVATURE = 0.2  # Powell's damping


def minimise(
    loss: Loss, start: Floats, bounds: Floats, steps: int, curvature: Floats | None = None
) -> tuple[Floats, float]:
    """Return where a function is least, and its value there.

    Newton's steps with the curvature learnt from the gradients (BFGS, damped after Powell, Lect. Notes Math. 630, 144,
    1978), projected on the bounds (Bertsekas, SIAM J. Control Optim. 20, 221, 1982). SciPy's solvers cost half a second
    of imports, which is more than a fit takes.

    Args:
        loss: gives value and gradient, (p,).
        start: (p,), brought within the bounds.
        bounds: least and greatest, (p, 2), infinite where there is none.
        steps: at most.
        curvature: the second derivatives as far as they are known, (p, p), positive definite.
    """
    at = np.clip(start, *bounds.T)
    value, slope = loss(at)
    learning = curvature is None
    if curvature is None:
        curvature = np.eye(len(at)) * max(float(np.linalg.norm(slope)), FLAT)
    for _ in range(steps):
        free = ~_held(at, slope, bounds)
        if not free.any() or np.abs(slope[free]).max() < FLAT:
            break
        tried, better, new = _searched(loss, at, value, slope, _towards(curvature, slope, free), bounds)
        gain, moved, bent = value - better, tried - at, new - slope
        if gain <= 0.0:
            break
        if learning and moved @ bent > 0.0:
            learning, curvature = False, np.eye(len(at)) * (bent @ bent) / (moved @ bent)
        curvature = _learnt(curvature, moved, bent)
        at, value, slope = tried, better, new
        if gain <= SETTLED * max(abs(value), 1.0):
            break
    return at, value


def _held(at: Floats, slope: Floats, bounds: Floats) -> NDArray[np.bool_]:
    """Tell which numbers stand at a bound that they would leave."""
    return ((at <= bounds[:, 0]) & (slope > 0.0)) | ((at >= bounds[:, 1]) & (slope < 0.0))


def _towards(curvature: Floats, slope: Floats, free: NDArray[np.bool_]) -> Floats:
    direction = np.zeros(len(slope))
    direction[free] = -np.linalg.solve(curvature[np.ix_(free, free)], slope[free])
    return direction


def _searched(
    loss: Loss, at: Floats, value: float, slope: Floats, direction: Floats, bounds: Floats
) -> tuple[Floats, float, Floats]:
    """Return the first point along a direction that is low enough, or the start where none is."""
    length = 1.0
    for _ in range(SHORTENINGS):
        tried = np.clip(at + length * direction, *bounds.T)
        promised = float(slope @ (tried - at))
        better, new = loss(tried)
        if better <= value + ENOUGH_DECREASE * promised:
            return tried, better, new
        length *= float(np.clip(-0.5 * promised / max(better - value - promised, 1e-300), 0.1, 0.5))
    return at, value, slope


def _learnt(curvature: Floats, moved: Floats, bent: Floats) -> Floats:
    pushed = curvature @ moved
    known, seen = float(moved @ pushed), float(moved @ bent)
    if known <= 0.0:
        return curvature
    if seen < LEAST_CURVATURE * known:
        share = (1.0 - LEAST_CURVATURE) * known / (known - seen)
        bent, seen = share * bent + (1.0 - share) * pushed, LEAST_CURVATURE * known
    return curvature - np.outer(pushed, pushed) / known + np.outer(bent, bent) / seen
