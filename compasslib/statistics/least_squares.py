"""Least squares and minimization: robust widths, bounded BFGS, Gauss-Newton steps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, Self, TypeVar

import numpy as np

from compasslib.types import Floats

SIGMA_PER_MAD = 1.4826  # of normal noise: standard deviation over median absolute deviation
HUBER_CLIP = 2.5  # Huber's, in widths: of normal noise 1 in 80 is clipped, and 1 % of the information is lost


def robust_width(deviation: Floats) -> float:
    """Estimate the standard deviation of normal noise with the same median absolute deviation."""
    return SIGMA_PER_MAD * float(np.median(np.abs(deviation)))


Loss = Callable[[Floats], tuple[float, Floats]]

ARMIJO = 1e-4  # share of the decrease predicted by the gradient that a step must reach
MAX_HALVINGS = 20  # of a step, at most
GRADIENT_TOLERANCE, LOSS_TOLERANCE = 1e-5, 2.2e-9  # gradient, and relative decrease of the loss, at which it ends
POWELL_DAMPING = 0.2  # least curvature along a step, over the one so far


def minimize_bfgs(
    loss: Loss, start: Floats, bounds: Floats, steps: int, hessian: Floats | None = None
) -> tuple[Floats, float]:
    """Minimize a function, and evaluate it there.

    Quasi-Newton steps (BFGS, damped after Powell, Lect. Notes Math. 630, 144, 1978), projected on the bounds
    (Bertsekas, SIAM J. Control Optim. 20, 221, 1982). SciPy's solvers cost half a second of imports, which is more than
    a fit takes.

    Args:
        loss: gives value and gradient, (p,).
        start: (p,), brought within the bounds.
        bounds: least and greatest, (p, 2), infinite where there is none.
        hessian: a first estimate, (p, p), positive definite.
    """
    at = np.clip(start, *bounds.T)
    value, gradient = loss(at)
    unscaled = hessian is None
    if hessian is None:
        hessian = _even(gradient)
    for _ in range(steps):
        active = ((at <= bounds[:, 0]) & (gradient > 0.0)) | ((at >= bounds[:, 1]) & (gradient < 0.0))
        free = ~active
        if not free.any() or np.abs(gradient[free]).max() < GRADIENT_TOLERANCE:
            break
        direction = np.zeros(len(at))
        try:
            direction[free] = -np.linalg.solve(hessian[np.ix_(free, free)], gradient[free])
        except np.linalg.LinAlgError:  # singular by rounding: begun anew down the gradient
            unscaled, hessian = True, _even(gradient)
            direction[free] = -gradient[free] / hessian[0, 0]
        trial, lower, new = _line_search(loss, at, value, gradient, direction, bounds)
        decrease, step, change = value - lower, trial - at, new - gradient
        if decrease <= 0.0:
            break
        if unscaled and step @ change > 0.0:
            unscaled, hessian = False, np.eye(len(at)) * (change @ change) / (step @ change)
        hessian = _updated(hessian, step, change)
        at, value, gradient = trial, lower, new
        if decrease <= LOSS_TOLERANCE * max(abs(value), 1.0):
            break
    return at, value


def _even(gradient: Floats) -> Floats:
    """Compute the Hessian by which a first step down the gradient has a length of one."""
    return np.eye(len(gradient)) * max(float(np.linalg.norm(gradient)), GRADIENT_TOLERANCE)


def _line_search(
    loss: Loss, at: Floats, value: float, gradient: Floats, direction: Floats, bounds: Floats
) -> tuple[Floats, float, Floats]:
    """Find the first point along a direction that satisfies Armijo's rule, or the start where none does."""
    length = 1.0
    for _ in range(MAX_HALVINGS):
        trial = np.clip(at + length * direction, *bounds.T)
        predicted = float(gradient @ (trial - at))
        lower, new = loss(trial)
        if lower <= value + ARMIJO * predicted:
            return trial, lower, new
        length *= float(np.clip(-0.5 * predicted / max(lower - value - predicted, 1e-300), 0.1, 0.5))
    return at, value, gradient


def _updated(hessian: Floats, step: Floats, change: Floats) -> Floats:
    """Update the Hessian by the change of the gradient along a step (BFGS with Powell's damping)."""
    expected = hessian @ step
    before, now = float(step @ expected), float(step @ change)
    if before <= 0.0:
        return hessian
    if now < POWELL_DAMPING * before:
        share = (1.0 - POWELL_DAMPING) * before / (before - now)
        change, now = share * change + (1.0 - share) * expected, POWELL_DAMPING * before
    return hessian - np.outer(expected, expected) / before + np.outer(change, change) / now


MAX_STEP_DEG = 12.0  # of one step, in about degrees: beyond it a simulation of angles is no longer linear
MISFIT_TOLERANCE = 1e-9  # relative change of the misfit that is rounding


class GaussNewtonState(Protocol):
    """Where a fit stands."""

    def step(self) -> tuple[Floats, float]:
        """Compute the least-squares step, and how far it goes in about degrees."""
        ...

    def moved(self, step: Floats) -> Self | None:
        """Go a step, None where there is no such point."""
        ...

    def misfit(self, other: Self) -> float:
        """Compute the misfit of another point over its own, both by its own widths."""
        ...


State = TypeVar("State", bound=GaussNewtonState)


def gauss_newton(point: State, *, rounds: int, close: float, worse: float) -> State:
    """Iterate Gauss-Newton steps from a point.

    Args:
        rounds: points that are looked at, at most.
        close: length of a step that is the last, in about degrees.
        worse: growth of the misfit at which a step is not taken.
    """
    step, length = _cut(*point.step())
    for _ in range(rounds):
        then = point.moved(step)
        growth = np.inf if then is None else point.misfit(then)
        if then is None or growth > worse:
            step, length = step / 2.0, length / 2.0
            continue
        point = then
        if length < close or abs(growth - 1.0) < MISFIT_TOLERANCE:
            break
        step, length = _cut(*point.step())
    return point


def _cut(step: Floats, length: float) -> tuple[Floats, float]:
    share = min(1.0, MAX_STEP_DEG / max(length, 1e-12))
    return step * share, length * share
