"""Least squares and minimization: robust widths, bounded BFGS, Gauss-Newton steps."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from compasslib.types import Floats

SIGMA_PER_MAD = 1.4826  # of normal noise: standard deviation over median absolute deviation
HUBER_CLIP = 2.5  # Huber's constant in widths: clips 1 in 80 of normal noise and loses 1 % of the information


def robust_width(deviation: Floats) -> float:
    """Estimate the standard deviation of normal noise with the same median absolute deviation."""
    return SIGMA_PER_MAD * float(np.median(np.abs(deviation)))


Loss = Callable[[Floats], tuple[float, Floats]]  # point -> value and gradient

GRADIENT_TOLERANCE = 1e-5  # largest gradient at convergence


def minimize_bfgs(
    loss: Loss, start: Floats, bounds: Floats, steps: int, hessian: Floats | None = None
) -> tuple[Floats, float]:
    """Minimize a function within bounds, (p, 2); return the minimizer and the minimum.

    Quasi-Newton steps (BFGS, damped after Powell, Lect. Notes Math. 630, 144, 1978), projected on the bounds
    (Bertsekas, SIAM J. Control Optim. 20, 221, 1982). SciPy's solvers take half a second to import, which is longer
    than a fit.
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
        except np.linalg.LinAlgError:  # singular by rounding: restart with steepest descent
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
        if decrease <= 2.2e-9 * max(abs(value), 1.0):
            break
    return at, value


def _even(gradient: Floats) -> Floats:
    """Compute the multiple of the identity as Hessian for which the first step has unit length."""
    return np.eye(len(gradient)) * max(float(np.linalg.norm(gradient)), GRADIENT_TOLERANCE)


def _line_search(
    loss: Loss, at: Floats, value: float, gradient: Floats, direction: Floats, bounds: Floats
) -> tuple[Floats, float, Floats]:
    """Find a point along a direction by backtracking to Armijo's rule; return the start if there is none."""
    length = 1.0
    for _ in range(20):
        trial = np.clip(at + length * direction, *bounds.T)
        predicted = float(gradient @ (trial - at))
        lower, new = loss(trial)
        if lower <= value + 1e-4 * predicted:
            return trial, lower, new
        length *= float(np.clip(-0.5 * predicted / max(lower - value - predicted, 1e-300), 0.1, 0.5))
    return at, value, gradient


def _updated(hessian: Floats, step: Floats, change: Floats) -> Floats:
    """Update the Hessian from the change of the gradient along a step (BFGS with Powell's damping)."""
    expected = hessian @ step
    before, now = float(step @ expected), float(step @ change)
    if before <= 0.0:
        return hessian
    if now < 0.2 * before:
        share = 0.8 * before / (before - now)
        change, now = share * change + (1.0 - share) * expected, 0.2 * before
    return hessian - np.outer(expected, expected) / before + np.outer(change, change) / now


MAX_STEP_DEG = 12.0  # length of a step, in approximate degrees, beyond which a model of angles is not linear
MISFIT_TOLERANCE = 1e-9  # relative change of the misfit within rounding errors


def gauss_newton(point: Any, *, rounds: int, close: float, worse: float) -> Any:
    """Iterate Gauss-Newton steps from a point until a step is shorter than ``close``, in approximate degrees.

    Args:
        point: current point of a fit, with methods ``step()``, the least-squares step and its length in approximate
            degrees; ``moved(step)``, the point after it or None if that is not admissible; and ``misfit(other)``, the
            ratio of another point's misfit to its own, both with its own widths.
        rounds: maximum number of points to evaluate.
        worse: ratio of misfits above which a step is halved instead of taken.
    """
    step, length = _cut(*point.step())
    for _ in range(rounds):
        then = point.moved(step)
        growth = np.inf if then is None else point.misfit(then)
        if then is None or growth > worse:
            step, length = step / 2.0, length / 2.0
            if length < close:
                break
            continue
        point = then
        if length < close or abs(growth - 1.0) < MISFIT_TOLERANCE:
            break
        step, length = _cut(*point.step())
    return point


def _cut(step: Floats, length: float) -> tuple[Floats, float]:
    share = min(1.0, MAX_STEP_DEG / max(length, 1e-12))
    return step * share, length * share


def mixed_covariance(
    weights: Sequence[float] | Floats, means: Sequence[Floats] | Floats, covariances: Sequence[Floats] | Floats
) -> Floats:
    """Compute the covariance of a mixture of normal distributions, (k, k); the weights sum to 1."""
    weight, off = np.array(weights), np.array(means) - np.array(weights) @ np.array(means)
    return np.asarray(np.einsum("w,wij->ij", weight, np.array(covariances)) + (weight[:, None] * off).T @ off)
