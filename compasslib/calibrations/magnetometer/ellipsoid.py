"""Hard and soft iron from the readings of a magnetometer alone: the field has one modulus, whichever way it is turned.

Le Menn et al. 2023, eqs. (1), (2), after Fang et al. 2011: m = S f + b + n and |G (m - b)| = 1 with G the inverse of S
over the field's strength. Two families share the algebra. In ``space`` the whole modulus is constant; where a platform
is ``level`` but for small tilts it is the horizontal one, |h|^2 - (t h)^2 with t the downward direction.

The noise term of eq. (2) is -2 (m - b)^T G^T G n + n^T G^T G n (the print has lost the first sign). Its mean is not
zero, which biases the plain algebraic fit. The loss here is the adjusted one (Kukush, Markovsky and Van Huffel 2004):
with isotropic Gaussian noise of variance s its mean is the loss of readings without noise, to every order, and s
follows from its being zero.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib.types import Floats

STEPS, LONGEST_STEP, CONVERGED = 60, 0.3, 1e-11
BLOCKS = 20  # of the jackknife: each longer than the memory of the noise, enough of them for a variance
NORMAL_95 = 1.96
CENTRE, SOFT = ("x offset", "y offset", "z offset"), ("S11", "S22", "S33", "S12", "S13", "S23")
EVERY = CENTRE + SOFT
PLACES = {"S11": (0, 0), "S22": (1, 1), "S33": (2, 2), "S12": (0, 1), "S13": (0, 2), "S23": (1, 2)}


@dataclass(frozen=True)
class ScaledReadings:
    """Readings over a scale that makes the field's modulus about 1, with the downward direction where that matters."""

    field: Floats  # (n, 3) body frame
    down: Floats  # (n, 3) unit vector in the body frame, zero in space

    def __len__(self) -> int:
        return len(self.field)

    def take(self, index: NDArray[np.bool_]) -> ScaledReadings:
        """Return some of the readings, by a mask (n,)."""
        return ScaledReadings(self.field[index], self.down[index])


@dataclass(frozen=True)
class Model:
    """Which parameters are free, and how each moves the centre (3) and the matrix G (9)."""

    name: str
    free: tuple[str, ...]
    chain: Floats  # (p, 12)


@dataclass(frozen=True)
class FittedEllipsoid:
    """One model fitted; ``replicates`` are the parameters without each block, which carry every uncertainty."""

    model: Model
    parameters: Floats  # (p,)
    noise: float  # standard deviation of one axis over the modulus
    replicates: Floats  # (blocks, p)

    def iron(self) -> tuple[Floats, Floats]:
        """Return centre and G as one vector, (12,), and the same of each replicate, (blocks, 12)."""
        return self.parameters @ self.model.chain, self.replicates @ self.model.chain


def _chain(*rows: dict[str, float]) -> Floats:
    chain = np.zeros((len(rows), 12))
    for row, moves in zip(chain, rows, strict=True):
        for name, by in moves.items():
            if name in CENTRE:
                row[CENTRE.index(name)] = by
            else:
                i, j = PLACES[name]
                row[3 + 3 * i + j] = row[3 + 3 * j + i] = by
    return chain


X, Y, Z = ({name: 1.0} for name in CENTRE)
ALIKE = {"S11": 1.0, "S22": 1.0, "S33": 1.0}
SPHERE = Model("sphere", (*CENTRE, "scale"), _chain(X, Y, Z, ALIKE))
AXES = Model("ellipsoid along the axes", (*CENTRE, *SOFT[:3]), _chain(X, Y, Z, *({k: 1.0} for k in SOFT[:3])))
ELLIPSOID = Model("ellipsoid", EVERY, _chain(X, Y, Z, *({k: 1.0} for k in SOFT)))
CIRCLE = Model("circle", (*CENTRE[:2], "scale"), _chain(X, Y, ALIKE))
# The third axis is not seen: its sensitivity is held at the mean of the two others.
ELLIPSE = Model(
    "ellipse",
    (*CENTRE[:2], "S11", "S22", "S12"),
    _chain(X, Y, {"S11": 1.0, "S33": 0.5}, {"S22": 1.0, "S33": 0.5}, {"S12": 1.0}),
)
# What tilts could add on a level platform; it is only judged.
LEVEL_AND_THIRD = Model(
    "ellipse and third axis",
    (*CENTRE, "S11", "S22", "S33", "S12"),
    _chain(X, Y, Z, *({k: 1.0} for k in ("S11", "S22", "S33", "S12"))),
)


def unpack(model: Model, parameters: Floats) -> tuple[Floats, Floats]:
    """Return the centre (3,) and the matrix G (3, 3).

    Args:
        parameters: (p,).
    """
    full = parameters @ model.chain
    return full[:3], full[3:].reshape(3, 3)


def corrected(centre: Floats, matrix: Floats, readings: ScaledReadings) -> Floats:
    """Return h = G (m - b), the field without iron over its modulus, (n, 3)."""
    return (readings.field - centre) @ matrix.T


def modulus(field: Floats, down: Floats) -> Floats:
    """Return the modulus of what is across the downward direction, (n,); the whole one where that is zero."""
    along = np.sum(field * down, axis=1)
    return np.sqrt(np.maximum(np.sum(field**2, axis=1) - along**2, 0.0))


def start(readings: ScaledReadings) -> tuple[Floats, float]:
    """Return centre (3,) and radius of the sphere or circle by linear least squares on the squared modulus."""
    across = readings.field - np.sum(readings.field * readings.down, axis=1)[:, None] * readings.down
    level = bool(readings.down.any())
    use = across[:, :2] if level else across
    columns = np.column_stack([2.0 * use, np.ones(len(use))])
    solved = np.linalg.lstsq(columns, np.sum(across**2, axis=1), rcond=None)[0]
    centre = np.append(solved[:-1], np.zeros(4 - len(solved)))
    return centre, float(np.sqrt(max(solved[-1] + centre @ centre, 0.0)))


def solve(model: Model, readings: ScaledReadings, centre: Floats, *, adjusted: bool = True) -> tuple[Floats, float]:
    """Return the parameters (p,) that minimise the adjusted loss, and the noise variance of one axis.

    Args:
        readings: n of them over the modulus.
        centre: where to begin, (3,).
        adjusted: False leaves the noise's bias in, as the plain algebraic fit does.

    Raises:
        np.linalg.LinAlgError: the readings do not determine the parameters.
    """
    wanted = np.concatenate([centre, np.eye(3).ravel()])
    parameters = np.linalg.lstsq(model.chain.T, wanted, rcond=None)[0]
    for _ in range(STEPS):
        variance = _variance(model, parameters, readings) if adjusted else 0.0
        score, columns = _scores(model, parameters, readings, variance)
        step = -np.linalg.solve(columns.T @ columns, score.sum(axis=0))
        parameters = parameters + step * min(1.0, LONGEST_STEP / max(float(np.linalg.norm(step)), 1e-300))
        if np.max(np.abs(step)) < CONVERGED:
            return parameters, variance
    raise np.linalg.LinAlgError(f"the fit of the {model.name} does not settle")


def fit(model: Model, readings: ScaledReadings, centre: Floats) -> FittedEllipsoid:
    """Return a model fitted, with a block jackknife that allows for memory.

    Args:
        readings: n of them over the modulus, in the order of time.
        centre: where to begin, (3,).

    Raises:
        np.linalg.LinAlgError: the readings do not determine the parameters.
    """
    parameters, variance = solve(model, readings, centre)
    replicates = _without_each_block(model, parameters, readings, variance)
    return FittedEllipsoid(model, parameters, float(np.sqrt(max(variance, 0.0))), replicates)


def _without_each_block(model: Model, parameters: Floats, readings: ScaledReadings, variance: float) -> Floats:
    """Return the parameters after one step of the fit without each contiguous block, (blocks, p)."""
    score, columns = _scores(model, parameters, readings, variance)
    information = columns.T @ columns
    parts = [blocks(len(readings)) == k for k in range(BLOCKS)]
    return np.array(
        [
            parameters + np.linalg.solve(information - columns[i].T @ columns[i], score[i].sum(axis=0))
            if i.any()
            else parameters
            for i in parts
        ]
    )


def blocks(n: int) -> NDArray[np.signedinteger]:
    """Return the number of the contiguous block that each of n readings belongs to, (n,)."""
    return np.arange(n) * BLOCKS // max(n, 1)


def covariance(replicates: Floats, shift: Floats | float = 0.0) -> Floats:
    """Return the jackknife covariance of whatever was computed from each replicate, (q, q).

    It is widened so that 1.96 standard deviations hold what Student's distribution of the few blocks asks for.

    Args:
        replicates: (blocks, q).
        shift: what one standard deviation of something that no reading shows does to it, (q,).
    """
    k = len(replicates)
    off = replicates - replicates.mean(axis=0)
    wider = 1.0 + (NORMAL_95**2 + 1.0) / (4.0 * (k - 1))  # Student's quantile over the normal one, first order
    unseen = np.broadcast_to(shift, off.shape[1:])
    return wider**2 * (k - 1) / k * off.T @ off + np.outer(unseen, unseen)


def sigma(replicates: Floats, shift: Floats | float = 0.0) -> Floats:
    """Return the standard deviation of whatever was computed from each replicate, in its own shape.

    Args:
        replicates: (blocks, ...).
        shift: as for the covariance, (...).
    """
    shape = replicates.shape[1:]
    flat = replicates.reshape(len(replicates), -1)
    return np.sqrt(np.diag(covariance(flat, np.broadcast_to(shift, shape).ravel()))).reshape(shape)


def dilution(judged: Model, iron: Floats, readings: ScaledReadings) -> dict[str, float]:
    """Return by how much an error of one reading that does not average out is magnified in each parameter.

    It is the root of the diagonal of the inverse information of one average reading, every other parameter free,
    by the eigenvalues of the information; one that is nothing beside the largest counts as such.

    Args:
        iron: centre and G at which the readings are linearised, (12,).
    """
    centre, matrix = iron[:3], iron[3:].reshape(3, 3)
    across, weight = _across(centre, matrix, readings)
    steepness = 2.0 * np.linalg.norm(weight, axis=1)[:, None]  # of the squared modulus along a reading
    columns = _gradient(centre, readings, across, weight) @ judged.chain.T / np.maximum(steepness, 1e-6)
    values, vectors = np.linalg.eigh(columns.T @ columns / len(readings))
    inverse = (vectors / np.maximum(values, 1e-14 * values[-1])) @ vectors.T
    return dict(zip(judged.free, np.sqrt(np.diag(inverse)).tolist(), strict=True))


def _across(centre: Floats, matrix: Floats, readings: ScaledReadings) -> tuple[Floats, Floats]:
    """Return a = N h, the part of the field that the modulus is made of, and w = G^T a, (n, 3) each."""
    field = corrected(centre, matrix, readings)
    across = field - np.sum(field * readings.down, axis=1)[:, None] * readings.down
    return across, across @ matrix


def _gradient(centre: Floats, readings: ScaledReadings, across: Floats, weight: Floats) -> Floats:
    """Return the derivative of the squared modulus by centre and G, (n, 12)."""
    by_matrix = 2.0 * across[:, :, None] * (readings.field - centre)[:, None, :]
    return np.hstack([-2.0 * weight, by_matrix.reshape(-1, 9)])


def _traces(matrix: Floats, readings: ScaledReadings) -> tuple[Floats, Floats]:
    """Return the traces of M = G^T N G and of its square for each reading, (n,) each."""
    square, seen = matrix.T @ matrix, readings.down @ matrix
    length = np.sum(seen**2, axis=1)
    second = np.sum(square**2) - 2.0 * np.sum((seen @ square) * seen, axis=1) + length**2
    return np.trace(square) - length, second


def _variance(model: Model, parameters: Floats, readings: ScaledReadings) -> float:
    """Return the noise variance s that makes the adjusted loss vanish: the smaller root of a quadratic."""
    centre, matrix = unpack(model, parameters)
    across, weight = _across(centre, matrix, readings)
    rho, (trace, second) = np.sum(across**2, axis=1) - 1.0, _traces(matrix, readings)
    n, free = len(readings), len(parameters)
    c = float(np.sum(rho**2)) * n / (n - free)
    b = 2.0 * float(np.sum(rho * trace)) + 4.0 * float(np.sum(weight**2))
    a = float(np.sum(trace**2) + 2.0 * np.sum(second))
    return 2.0 * c / (b + float(np.sqrt(max(b * b - 4.0 * a * c, 0.0))))


def _scores(model: Model, parameters: Floats, readings: ScaledReadings, s: float) -> tuple[Floats, Floats]:
    """Return half the gradient of each reading's adjusted loss, and the columns of its Gauss-Newton matrix, (n, p).

    The loss is (rho - s tr M)^2 - 4 s |M v|^2 + 2 s^2 tr M^2 with v = m - b, rho = v^T M v - 1.
    """
    centre, matrix = unpack(model, parameters)
    across, weight = _across(centre, matrix, readings)
    down, v = readings.down, readings.field - centre
    rho, (trace, _) = np.sum(across**2, axis=1) - 1.0, _traces(matrix, readings)
    turned = weight @ matrix.T
    turned -= np.sum(turned * down, axis=1)[:, None] * down  # N G w
    seen = matrix - down[:, :, None] * (down @ matrix)[:, None, :]  # N G
    square = np.swapaxes(seen, 1, 2) @ seen  # M, for N N = N
    by_rho = _gradient(centre, readings, across, weight)
    by_rho[:, 3:] -= 2.0 * s * seen.reshape(-1, 9)
    by_weight = turned[:, :, None] * v[:, None, :] + across[:, :, None] * weight[:, None, :]
    noise = np.hstack([4.0 * s * turned @ matrix, (-4.0 * s * by_weight + 4.0 * s**2 * seen @ square).reshape(-1, 9)])
    columns = by_rho @ model.chain.T
    return (rho - s * trace)[:, None] * columns + noise @ model.chain.T, columns
