"""Least squares over several kinds of observations at once, each with its own noise, and weak priors.

Gauss-Newton on rows over their scatter, each block weighed by what it really knows where its residuals are alike from
second to second. The covariance is that of this estimate (sandwich), so it splits exactly into what each kind of
observation and each prior leaves: the lines of an uncertainty budget.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.statistics import swing_noise
from compasslib.statistics.arma import orthonormal
from compasslib.statistics.blocks import student
from compasslib.statistics.swing_noise import SwingNoise, spread
from compasslib.types import Floats

ROUNDS, STEPS = 4, 3
KNOWN = 2.0  # the data know a parameter that they tell twice as well as the prior


@dataclass(frozen=True)
class Block:
    """Observations of one kind."""

    name: str
    observe: Callable[[Floats], tuple[Floats, Floats]]  # parameters -> residuals (n,), their derivatives (n, k)
    speed_kn: Floats | None = None  # where slow ones scatter more
    blocks: NDArray[np.int_] | None = None  # (n,) number of the block in time; None: their order says nothing
    sigma: float | None = None  # scatter, where it is known
    groups: NDArray[np.int_] | None = None  # (n,) which were taken on one heading


@dataclass(frozen=True)
class SwingFit:
    """Parameters with covariance, and what the covariance is made of."""

    parameters: Floats  # (k,)
    covariance: Floats  # (k, k)
    parts: Mapping[str, Floats]  # name of a block, or number of a parameter with a prior -> (k, k); they add up
    residuals: Mapping[str, Floats]
    noises: Mapping[str, SwingNoise]


def solve(blocks: Sequence[Block], mean: Floats, sigma: Floats, start: Floats) -> SwingFit:
    """Return the parameters that explain all blocks.

    Args:
        blocks: observations; the first sets the least scatter of those with a known one.
        mean: (k,) of the priors.
        sigma: (k,) their width, infinite for a parameter without.
        start: (k,) parameters to begin from.
    """
    parameters, noises = start.astype(float), dict[str, SwingNoise]()
    for _ in range(ROUNDS):
        noises = _noises(blocks, parameters, sigma, noises)
        for _ in range(STEPS):
            rows = _rows(blocks, parameters, noises)
            prior = np.column_stack([np.diag(1.0 / sigma), (parameters - mean) / sigma])
            stacked = np.vstack([*rows.values(), prior])
            parameters = parameters - np.linalg.lstsq(stacked[:, :-1], stacked[:, -1])[0]
    return _solution(blocks, parameters, sigma, noises)


def _noises(
    blocks: Sequence[Block], parameters: Floats, sigma: Floats, before: Mapping[str, SwingNoise]
) -> dict[str, SwingNoise]:
    noises: dict[str, SwingNoise] = {}
    for block in blocks:
        residual, columns = block.observe(parameters)
        if block.sigma is not None:
            first = next(iter(noises.values())).sigma if noises else np.zeros(1)
            scatter = np.hypot(block.sigma, np.sqrt(np.mean(first**2)))
            noises[block.name] = SwingNoise(np.full(residual.shape, scatter), dof=np.inf)
            continue
        size = before[block.name].sigma if before else np.full(residual.shape, np.std(residual) + swing_noise.TINY)
        basis = _taken_up(columns / size[:, None], sigma) * size[:, None]
        basis = orthonormal(basis)
        noise = swing_noise.estimate(residual, basis, speed_kn=block.speed_kn, blocks=block.blocks)
        noise = noise if block.groups is None else _grouped(noise, residual, block.groups, basis.shape[1])
        # So few residuals that their scatter may be small by chance must not overrule the priors.
        noises[block.name] = replace(noise, weight=noise.weight / student(noise.dof) ** 2)
    return noises


def _taken_up(columns: Floats, sigma: Floats) -> Floats:
    """Return a basis of what the fit takes up: free parameters, and those that the data know better than the prior."""
    free = orthonormal(columns[:, np.isinf(sigma)])
    by_priors = columns[:, np.isfinite(sigma)] * sigma[np.isfinite(sigma)]
    beyond = by_priors - free @ (free.T @ by_priors)
    return np.column_stack([free, orthonormal(beyond, least=KNOWN)])


def _grouped(noise: SwingNoise, residual: Floats, groups: NDArray[np.int_], rank: int) -> SwingNoise:
    """Return the scatter for headings that were taken repeatedly: what is common to one heading is not averaged out."""
    count = np.bincount(groups)
    total = np.bincount(groups, residual)
    occupied = count > 0
    dof = int(occupied.sum()) - rank
    if dof >= noise.dof or dof < 1:
        return noise
    between = np.sqrt(np.sum(total[occupied] ** 2 / count[occupied]) / dof)
    return SwingNoise(np.maximum(noise.sigma, between), n_effective=float(occupied.sum()), dof=float(dof))


def _rows(blocks: Sequence[Block], parameters: Floats, noises: Mapping[str, SwingNoise]) -> dict[str, Floats]:
    rows = {}
    for block in blocks:
        residual, columns = block.observe(parameters)
        noise = noises[block.name]
        clipped = swing_noise.clip(residual, noise)
        scaled = np.column_stack([columns, clipped]) / noise.sigma[:, None]
        rows[block.name] = scaled * np.sqrt(noise.weight)
    return rows


def _solution(blocks: Sequence[Block], parameters: Floats, sigma: Floats, noises: Mapping[str, SwingNoise]) -> SwingFit:
    rows = {name: each[:, :-1] for name, each in _rows(blocks, parameters, noises).items()}
    in_time = {block.name: block.blocks for block in blocks}
    priors = {str(k): np.diag((np.arange(len(sigma)) == k) * sigma**-2.0) for k in np.flatnonzero(np.isfinite(sigma))}
    information = np.sum([*(each.T @ each for each in rows.values()), *priors.values()], axis=0)
    inverse = np.linalg.inv(information)
    spreads = {
        name: noises[name].weight * student(noises[name].dof) ** 2 * spread(each, noises[name], in_time[name])
        for name, each in rows.items()
    }
    parts = {name: inverse @ middle @ inverse for name, middle in (spreads | priors).items()}
    residuals = {block.name: block.observe(parameters)[0] for block in blocks}
    return SwingFit(parameters, np.sum(list(parts.values()), axis=0), parts, residuals, noises)
