"""Hard and soft iron from magnetometer readings alone: the field's modulus is the same in every orientation.

Le Menn et al. 2023, eqs. (1), (2), after Fang et al. 2011: m = S f + b + n and |G (m - b)| = 1 with G the inverse of S
over the field strength. In space the full modulus is constant; on a platform that stays level but for small tilts, the
horizontal one, squared |h|^2 - (t h)^2 with t pointing down. The noise term of eq. (2), printed without its first sign,
biases the plain algebraic fit; the adjusted loss (Kukush, Markovsky and Van Huffel 2004) has the expectation of the
loss of noise-free readings. The noise variance is that at which the adjusted loss vanishes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations.curves import count_sectors
from compasslib.calibrations.magnetometer.log import Log
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import student_factor
from compasslib.types import Bools, Floats

BLOCKS = 20  # of the jackknife: long compared to the noise's correlation time, and enough to estimate a variance
CENTRE = ("x offset", "y offset", "z offset")
PLACES = {"S11": (0, 0), "S22": (1, 1), "S33": (2, 2), "S12": (0, 1), "S13": (0, 2), "S23": (1, 2)}
DIAGONAL, OTHERS, LEVEL_SOFT = ("S11", "S22", "S33"), ("S12", "S13", "S23"), ("S11", "S22", "S12")
PARAMETERS = CENTRE + DIAGONAL + OTHERS
# Where each parameter stands in a vector of centre (3) and matrix (9).
ENTRIES = {name: [k] for k, name in enumerate(CENTRE)}
ENTRIES |= {name: [3 + 3 * i + j, 3 + 3 * j + i] for name, (i, j) in PLACES.items()}
MAX_STANDARD_ERROR = 0.05  # relative to the field: parameters with a larger one are undetermined
# Relative to the field: errors by nonlinearity, cross-axis sensitivity and gradients, which do not average out.
SYSTEMATIC_ERROR = 0.003
MAX_SCATTER = 0.25  # about the fitted circle or sphere, relative to the field


@dataclass(frozen=True)
class ScaledReadings:
    """Readings scaled to a field modulus of about 1, with the downward direction for level platforms."""

    field: Floats  # (n, 3) body frame
    down: Floats  # (n, 3) unit vector in the body frame, zero for models in ``space``

    def __len__(self) -> int:
        return len(self.field)


@dataclass(frozen=True)
class Model:
    """Free parameters of a model, and their linear map to the centre (3) and the matrix G (9), (p, 12)."""

    name: str
    parameters: tuple[str, ...]
    chain: Floats


def _model(name: str, moves: Mapping[str, Mapping[str, float]]) -> Model:
    """Make a model from the entries of centre and G that each parameter changes, and by how much."""
    chain = np.zeros((len(moves), 12))
    for row, changed in zip(chain, moves.values(), strict=True):
        for entry, by in changed.items():
            row[ENTRIES[entry]] = by
    return Model(name, tuple(moves), chain)


def _alone(*names: str) -> dict[str, dict[str, float]]:
    return {name: {name: 1.0} for name in names}


SCALE = {"scale": dict.fromkeys(DIAGONAL, 1.0)}
SPHERE = _model("sphere", _alone(*CENTRE) | SCALE)
AXES = _model("ellipsoid along the axes", _alone(*CENTRE, *DIAGONAL))
ELLIPSOID = _model("ellipsoid", _alone(*PARAMETERS))
CIRCLE = _model("circle", _alone(*CENTRE[:2]) | SCALE)
# The third axis is unobservable: its sensitivity is set to the mean of the other two.
HALVES = {"S11": {"S11": 1.0, "S33": 0.5}, "S22": {"S22": 1.0, "S33": 0.5}}
ELLIPSE = _model("ellipse", _alone(*CENTRE[:2]) | HALVES | _alone("S12"))
# Never fitted: serves to assess which parameters the tilts of a level platform would determine.
LEVEL_AND_THIRD = _model("ellipse and third axis", _alone(*CENTRE, *DIAGONAL, "S12"))


@dataclass(frozen=True)
class FittedEllipsoid:
    """Fitted centre and G as one vector; all uncertainties follow from the jackknife ``replicates``."""

    name: str  # of the model
    iron: Floats  # (12,)
    replicates: Floats  # (blocks, 12) with one block left out each
    noise: float  # standard deviation per axis, relative to the modulus


def corrected(iron: Floats, readings: ScaledReadings) -> Floats:
    """Correct readings for the iron (12,), centre b and G: h = G (m - b), the normalized field (n, 3)."""
    return (readings.field - iron[:3]) @ iron[3:].reshape(3, 3).T


def modulus(field: Floats, down: Floats) -> Floats:
    """Compute the modulus of the field component perpendicular to ``down`` (n,), or the full one where that is zero."""
    along = np.sum(field * down, axis=1)
    return np.sqrt(np.maximum(np.sum(field**2, axis=1) - along**2, 0.0))


def solve(model: Model, readings: ScaledReadings, centre: Floats) -> tuple[Floats, float]:
    """Minimise the adjusted loss over the parameters, (p,), and estimate the noise variance of one axis.

    Raises:
        np.linalg.LinAlgError: the readings do not determine the parameters.
    """
    wanted = np.concatenate([centre, np.eye(3).ravel()])
    parameters = np.linalg.lstsq(model.chain.T, wanted, rcond=None)[0]
    for _ in range(60):
        variance, score, columns = adjusted_scores(model, parameters, readings)
        step = -np.linalg.solve(columns.T @ columns, score.sum(axis=0))
        parameters = parameters + step * min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-300))
        if np.max(np.abs(step)) < 1e-11:
            return parameters, variance
    raise np.linalg.LinAlgError(f"the fit of the {model.name} does not settle")


def fit(model: Model, readings: ScaledReadings, centre: Floats) -> FittedEllipsoid | None:
    """Fit a model, with a block jackknife for autocorrelated noise; None if the readings do not determine it."""
    try:
        parameters, variance = solve(model, readings, centre)
        _, score, columns = adjusted_scores(model, parameters, readings, variance)
        information, replicates = columns.T @ columns, np.tile(parameters, (BLOCKS, 1))
        for k in range(BLOCKS):  # one Gauss-Newton step of the fit without the block
            i = blocks(len(readings)) == k
            if i.any():
                replicates[k] += np.linalg.solve(information - columns[i].T @ columns[i], score[i].sum(axis=0))
    except np.linalg.LinAlgError:
        return None
    noise = float(np.sqrt(max(variance, 0.0)))
    return FittedEllipsoid(model.name, parameters @ model.chain, replicates @ model.chain, noise)


def blocks(n: int) -> NDArray[np.signedinteger]:
    """Assign n readings to contiguous blocks, (n,) numbers from 0."""
    return np.arange(n) * BLOCKS // max(n, 1)


def covariance(replicates: Floats, shift: Floats | float = 0.0) -> Floats:
    """Compute the jackknife covariance (q, q) of a quantity from its replicates (blocks, q).

    It is inflated so that 1.96 standard deviations cover 95 % of Student's distribution for the number of blocks.
    ``shift`` (q,) is the change of the quantity by one standard deviation of an unobservable parameter.
    """
    k = len(replicates)
    off = replicates - replicates.mean(axis=0)
    unseen = np.broadcast_to(shift, off.shape[1:])
    return student_factor(k - 1) ** 2 * (k - 1) / k * off.T @ off + np.outer(unseen, unseen)


def sigma(replicates: Floats, shift: Floats | float = 0.0) -> Floats:
    """Compute the jackknife standard deviation of a quantity from its replicates, in the quantity's shape."""
    shape = replicates.shape[1:]
    flat = replicates.reshape(len(replicates), -1)
    return np.sqrt(np.diag(covariance(flat, np.broadcast_to(shift, shape).ravel()))).reshape(shape)


def _linearize(iron: Floats, readings: ScaledReadings) -> tuple[Floats, Floats, Floats]:
    """Compute a = N h, the field component that enters the modulus, w = G^T a and the derivative of |a|^2, (n, 12)."""
    centre, matrix = iron[:3], iron[3:].reshape(3, 3)
    field = (readings.field - centre) @ matrix.T
    across = field - np.sum(field * readings.down, axis=1)[:, None] * readings.down
    weight = across @ matrix
    by_matrix = 2.0 * across[:, :, None] * (readings.field - centre)[:, None, :]
    return across, weight, np.hstack([-2.0 * weight, by_matrix.reshape(-1, 9)])


def adjusted_scores(
    model: Model, parameters: Floats, readings: ScaledReadings, variance: float | None = None
) -> tuple[float, Floats, Floats]:
    """Compute half the gradient of each reading's adjusted loss, and the columns of its Gauss-Newton matrix, (n, p).

    The loss is (rho - s tr M)^2 - 4 s |M v|^2 + 2 s^2 tr M^2 with v = m - b, M = G^T N G, rho = v^T M v - 1. Unless the
    noise variance s is given, it is the smaller root of the quadratic that makes the sum of the losses vanish.
    """
    iron, down, n = parameters @ model.chain, readings.down, len(readings)
    centre, matrix = iron[:3], iron[3:].reshape(3, 3)
    across, weight, by_rho = _linearize(iron, readings)
    rho = np.sum(across**2, axis=1) - 1.0
    # Traces of M and of its square.
    square, vertical = matrix.T @ matrix, down @ matrix
    length = np.sum(vertical**2, axis=1)
    trace = np.trace(square) - length
    if variance is None:
        second = np.sum(square**2) - 2.0 * np.sum((vertical @ square) * vertical, axis=1) + length**2
        c = float(np.sum(rho**2)) * n / (n - len(parameters))
        b = 2.0 * float(np.sum(rho * trace)) + 4.0 * float(np.sum(weight**2))
        a = float(np.sum(trace**2) + 2.0 * np.sum(second))
        variance = 2.0 * c / (b + float(np.sqrt(max(b * b - 4.0 * a * c, 0.0))))
    v, s = readings.field - centre, variance
    turned = weight @ matrix.T
    turned -= np.sum(turned * down, axis=1)[:, None] * down  # N G w
    projected = matrix - down[:, :, None] * vertical[:, None, :]  # N G
    by_rho[:, 3:] -= 2.0 * s * projected.reshape(-1, 9)
    by_weight = turned[:, :, None] * v[:, None, :] + across[:, :, None] * weight[:, None, :]
    by_matrix = -4.0 * s * by_weight + 4.0 * s**2 * projected @ (np.swapaxes(projected, 1, 2) @ projected)
    noise = np.hstack([4.0 * s * turned @ matrix, by_matrix.reshape(-1, 9)])
    columns = by_rho @ model.chain.T
    return s, (rho - s * trace)[:, None] * columns + noise @ model.chain.T, columns


@dataclass(frozen=True)
class ModelChoice:
    """The largest model that the readings determine."""

    fitted: FittedEllipsoid
    readings: ScaledReadings
    scale: float  # file units per unit of the scaled readings
    level: bool
    undetermined: dict[str, str]  # parameter -> reason


def choose_model(log: Log, body: Floats) -> ModelChoice | str:
    """Choose the model that readings (n, 3) in the body frame determine, an ellipsoid, else one for level platforms.

    Where no model can be fitted, the reason is returned instead.
    """
    return (_choose_spatial(body) if log.has_z else None) or _choose_level(log, body)


def find_outliers(choice: ModelChoice) -> Bools:
    """Flag readings far from the fitted modulus, (n,); none if these would be 5 % or more."""
    off = modulus(corrected(choice.fitted.iron, choice.readings), choice.readings.down) - 1.0
    off = np.abs(off - np.median(off))
    far = off > 6.0 * max(robust_width(off), SYSTEMATIC_ERROR)
    return far if far.mean() < 0.05 else np.zeros_like(far)


def _choose_spatial(body: Floats) -> ModelChoice | None:
    """Choose a sphere or an ellipsoid; None if the readings determine neither."""
    readings, scale, centre = _scaled(body, np.zeros_like(body))
    sphere = fit(SPHERE, readings, centre)
    if sphere is None or (noise := _noise(ELLIPSOID, sphere, readings))[0] > MAX_SCATTER:
        return None
    unsure = _standard_errors(ELLIPSOID, sphere, readings, noise)
    if any(unsure[name] > MAX_STANDARD_ERROR for name in CENTRE):
        return None
    lost = _undetermined_groups(unsure, DIAGONAL, OTHERS)
    models = [model for model in (SPHERE, AXES, ELLIPSOID) if not set(lost) & set(model.parameters)]
    reasons = {name: _reason(unsure[name], "the orientations leave it") for name in lost}
    return ModelChoice(_fit_largest(models, readings, centre), readings, scale, level=False, undetermined=reasons)


def _choose_level(log: Log, body: Floats) -> ModelChoice | str:
    """Choose a circle or an ellipse, for a level platform."""
    down = log.levelling()[:, 2, :]
    tilt = float(np.percentile(angles.argument(down[:, 2] + 1j * np.hypot(down[:, 0], down[:, 1])), 99.0))
    if log.tilted and tilt > 30.0:
        return "The orientations neither cover the sphere nor stay level."
    readings, scale, centre = _scaled(body, down)
    circle = fit(CIRCLE, readings, centre)
    if circle is None:
        return "The readings lie on no circle: the instrument did not turn, or the record is constant."
    noise = _noise(ELLIPSE, circle, readings)
    if why := _unusable_circle(circle, readings, noise[0]):
        return why
    if log.has_z and not log.tilted and readings.field[:, 2].std() > 0.3:
        return "The orientations neither cover the sphere nor stay level, and no tilts are logged."
    both = _standard_errors(ELLIPSE, circle, readings, noise)
    lost = _undetermined_groups(both, LEVEL_SOFT)
    standard_errors = _standard_errors(CIRCLE, circle, readings, noise) if lost else both
    if max(standard_errors["x offset"], standard_errors["y offset"]) > MAX_STANDARD_ERROR:
        return (
            f"Not even the centre of the circle is determined, by {count_sectors(_towards(circle, readings))} of 36 "
            f"sectors and a scatter of {100.0 * noise[0]:.0f} % of the field about it: turn all round, and check "
            "signs, units and order of the columns of axes and tilts."
        )
    # What turning about the vertical does not determine.
    mixed = "turning about the vertical, what the vertical field induces looks like hard iron in x and y"
    vertical = dict.fromkeys(("z offset", "S33"), "without tilts the horizontal field does not show it")
    if log.tilted:
        unsure = _standard_errors(LEVEL_AND_THIRD, circle, readings, noise)
        vertical = {name: _reason(unsure[name], f"tilts of up to {tilt:.0f}° leave it") for name in vertical}
    reasons = {**vertical, "S13": mixed, "S23": mixed}
    if not log.has_z:
        reasons = dict.fromkeys(reasons, "there is no z")
    reasons |= {name: _reason(both[name], "the part of a turn leaves it") for name in lost}
    models = [CIRCLE] if lost else [CIRCLE, ELLIPSE]
    return ModelChoice(_fit_largest(models, readings, centre), readings, scale, level=True, undetermined=reasons)


def _undetermined_groups(unsure: dict[str, float], *groups: tuple[str, ...]) -> list[str]:
    """List all parameters of each group with an undetermined member: a model has all of a group or none."""
    return [name for group in groups if any(unsure[k] > MAX_STANDARD_ERROR for k in group) for name in group]


def _reason(unsure: float, spans: str) -> str:
    if unsure <= MAX_STANDARD_ERROR:
        return f"{spans} with others of its kind undetermined"
    size = f"unsure by {100.0 * unsure:.0f} % of the field" if unsure < 1.0 else "open by more than the whole field"
    return f"{spans} {size}; at most {100.0 * MAX_STANDARD_ERROR:.0f} % is accepted"


def _scaled(body: Floats, down: Floats) -> tuple[ScaledReadings, float, Floats]:
    """Scale readings by the radius of a circle or sphere fitted to the squared modulus; give scale and centre."""
    across = body - np.sum(body * down, axis=1)[:, None] * down
    use = across[:, :2] if down.any() else across
    columns = np.column_stack([2.0 * use, np.ones(len(use))])
    solved = np.linalg.lstsq(columns, np.sum(across**2, axis=1), rcond=None)[0]
    centre = np.append(solved[:-1], np.zeros(4 - len(solved)))
    radius = float(np.sqrt(max(solved[-1] + centre @ centre, 0.0)))
    scale = radius if radius > 0.0 else 1.0
    return ScaledReadings(body / scale, down), scale, centre / scale


def _towards(circle: FittedEllipsoid, readings: ScaledReadings) -> Floats:
    """Compute the direction of each reading from the centre of the circle, (n,) degrees."""
    return angles.argument((readings.field - circle.iron[:3])[:, :2] @ np.array([1.0, -1.0j]))


def _unusable_circle(circle: FittedEllipsoid, readings: ScaledReadings, noise: float) -> str:
    """Explain why the circle fitted to the readings is unusable; empty if it is usable."""
    if noise > MAX_SCATTER:
        return (
            f"The readings scatter by {100.0 * noise:.0f} % about a circle or ellipse: the instrument did not turn, "
            "or its field is not the earth's with iron."
        )
    towards = np.sort(_towards(circle, readings))
    arc = 360.0 - float(np.max(np.diff(towards, append=towards[0] + 360.0)))
    if arc < 120.0:
        return f"The instrument turned through {arc:.0f}°, at least 120° (a third of a turn) is needed."
    if (sectors := count_sectors(towards)) < 6:
        return f"The readings repeat {sectors} headings, at least 6 apart by 10° are needed."
    return ""


def _standard_errors(
    model: Model, fitted: FittedEllipsoid, readings: ScaledReadings, noise: tuple[float, float]
) -> dict[str, float]:
    """Compute each parameter's standard error relative to the field, with all parameters free."""
    _, weight, gradient = _linearize(fitted.iron, readings)
    steepness = 2.0 * np.linalg.norm(weight, axis=1)[:, None]  # |d(squared modulus) / d(reading)|
    columns = gradient @ model.chain.T / np.maximum(steepness, 1e-6)
    values, vectors = np.linalg.eigh(columns.T @ columns / len(readings))
    inverse = (vectors / np.maximum(values, 1e-14 * values[-1])) @ vectors.T
    each = float(np.hypot(noise[0] / np.sqrt(noise[1]), SYSTEMATIC_ERROR))
    return dict(zip(model.parameters, (each * np.sqrt(np.diag(inverse))).tolist(), strict=True))


def _noise(largest: Model, fitted: FittedEllipsoid, readings: ScaledReadings) -> tuple[float, float]:
    """Estimate noise per axis and effective sample size from the largest model, without soft iron in the residual."""
    iron, noise = fitted.iron, fitted.noise
    try:
        parameters, variance = solve(largest, readings, iron[:3])
        iron, noise = parameters @ largest.chain, float(np.sqrt(max(variance, 0.0)))
    except np.linalg.LinAlgError:
        pass  # the caller's standard errors then reveal which parameters are undetermined
    residual = modulus(corrected(iron, readings), readings.down) - 1.0
    times = np.arange(len(readings), dtype=float)
    return noise, effective_sample_size(residual, times, longest_s=len(readings) / 10.0)


def _fit_largest(models: Sequence[Model], readings: ScaledReadings, centre: Floats) -> FittedEllipsoid:
    """Fit the largest of the models, in order of size, that the readings determine; the first is known to be one.

    Iron that a smaller model leaves out is unknown, not absent: intervals without it cover too little.
    """
    return next(fitted for model in reversed(models) if (fitted := fit(model, readings, centre)))
