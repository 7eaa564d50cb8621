"""What noise alone would do: columns tested against the residual, and against draws of the record's own noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import erfc, sqrt

import numpy as np
from numpy.typing import NDArray

from compasslib.core.types import Floats
from compasslib.search import columns
from compasslib.search.recordings import fitting
from compasslib.search.recordings.fitting import FittedTerms
from compasslib.search.scan import normal_score
from compasslib.stats import arma, blocks, whitening

REPEATS = 400  # draws of noise, which set how well a p-value of 1 % is known
HEADING_HAT_DEG, FEWEST_IN_HAT = 15.0, 5  # sectors that the omnibus sees, and readings in one
FAINT = 0.2  # of the largest direction of a group of splines
SHARE_OF_FREEDOM = 3  # an omnibus group has no more columns than this part of the independent samples


@dataclass(frozen=True)
class TestedColumns:
    """Columns that are tested together, (n, k) degrees a unit."""

    name: str  # of the covariates
    columns: Floats
    covariates: tuple[str, ...] = ()


@dataclass(frozen=True)
class TestedEffect:
    """One effect or covariate: its best group, how probable noise makes it, and how much memory inflates it."""

    group: TestedColumns
    p_value: float
    inflation: float  # mean statistic of the noise over its freedom, at least 1


def omnibus(now: FittedTerms) -> list[TestedColumns]:
    """Return harmonics and hats of the heading, hats of every other covariate, and products with the heading."""
    found = now.channel.covariates
    worth = len(now.channel) if now.channel.remembered else fitting.effective(now)  # the law's draws know the memory
    most = int(worth) // SHARE_OF_FREEDOM
    heading, groups = found.get("heading"), []
    if heading is not None:
        groups = [TestedColumns("heading", columns.periodic(heading, range(3, 7)), ("heading",))]
        hats = columns.heading_hats(heading, HEADING_HAT_DEG, FEWEST_IN_HAT)
        groups.append(TestedColumns("heading", hats, ("heading",)))
    for name, column in found.items():
        if name == "heading" or np.ptp(column) == 0.0:
            continue
        groups.append(TestedColumns(name, columns.hats(column, min(columns.KNOTS, max(3, most // 2))), (name,)))
        if heading is not None:
            both = columns.periodic(heading, range(1, 3)) * columns.standard(column)[:, None]
            groups.append(TestedColumns(f"heading x {name}", both, ("heading", name)))
    return [group for group in groups if 0 < group.columns.shape[1] <= most]


def test(now: FittedTerms, noise: FittedTerms, groups: Sequence[TestedColumns], seed: int = 0) -> list[TestedEffect]:
    """Return for each name its best group with the probability that noise makes it as good.

    Args:
        noise: the hypothesis whose residual is taken for noise: an effect must not raise the bar for itself.
    """
    white = arma.whitening_matrix(noise.clipped, noise.columns) if now.channel.remembered else None
    seen_as = groups if white is None else [replace(group, columns=white @ group.columns) for group in groups]
    base = whitening.orthonormal(now.columns if white is None else white @ now.columns)
    bases = [directions(group, base) for group in seen_as]
    kept = [k for k, basis in enumerate(bases) if basis.shape[1] and _lives(seen_as[k].columns, bases[k], base)]
    if not kept:
        return []
    groups, bases = [groups[k] for k in kept], [bases[k] for k in kept]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    every = np.concatenate(bases, axis=1)
    rows = np.vstack([now.clipped[None, :], draws(noise, seed)])
    gains = _gains(rows if white is None else rows @ white.T, every, begins, base)
    seen, null = gains[0], gains[1:]
    inflation = np.maximum(null.mean(axis=0) / freedom, np.finfo(float).tiny)  # a residual that is 0 has no noise
    score, scores = normal_score(seen / inflation, freedom), normal_score(null / inflation, freedom)
    names = list(dict.fromkeys(group.name for group in groups))
    return [_tested(name, groups, score, scores, inflation) for name in names]


def directions(group: TestedColumns, base: Floats) -> Floats:
    """Return an orthonormal basis of what the base leaves of a group, (n, k).

    What the base nearly is leaves faint directions that are no splines any more: they are left out.

    Args:
        base: orthonormal, (n, b).
    """
    return whitening.orthonormal(whitening.without(group.columns, base), FAINT)


def _tested(
    name: str, groups: Sequence[TestedColumns], score: Floats, scores: Floats, inflation: Floats
) -> TestedEffect:
    own = [k for k, group in enumerate(groups) if group.name == name]
    best = max(own, key=lambda k: score[k])
    highest = scores[:, own].max(axis=1)
    away = (float(score[best]) - float(highest.mean())) / float(highest.std())
    # One group: a normal score. The highest of many: Gumbel's law.
    p = 0.5 * erfc(away / sqrt(2.0)) if len(own) == 1 else float(-np.expm1(-np.exp(-away * np.pi / sqrt(6.0) - 0.5772)))
    return TestedEffect(groups[best], p, max(float(inflation[best]), 1.0))


def draws(noise: FittedTerms, seed: int, repeats: int = REPEATS) -> Floats:
    """Return draws of the record's own noise: blocks of it at other places with random signs, (repeats, n).

    Readings without memory are drawn from a normal distribution, and stretches of a short log by the law of their
    memory: a dozen of them hold no distribution of their own.
    """
    if noise.channel.independent:
        return np.random.default_rng(seed).normal(size=(repeats, len(noise.channel)))
    if noise.channel.remembered:
        return arma.draws(noise.clipped, noise.columns, seed, repeats)
    length = int(np.max(np.bincount(fitting.stretches(noise))))
    return blocks.drawn(noise.clipped - noise.clipped.mean(), length, repeats, seed)


def _gains(rows: Floats, every: Floats, begins: NDArray[np.intp], base: Floats) -> Floats:
    """Return twice the log likelihood that each group adds to each row, (rows, groups)."""
    bare = rows - (rows @ base) @ base.T
    total = np.sum(bare**2, axis=1)[:, None]
    taken = np.add.reduceat((bare @ every) ** 2, begins, axis=1)
    return -rows.shape[1] * np.log(np.maximum(1.0 - taken / np.maximum(total, 1e-300), 1e-12))


def _lives(columns: Floats, basis: Floats, base: Floats) -> bool:
    """Tell whether the base leaves more than rounding of a group."""
    return float(np.linalg.norm(whitening.without(columns, base))) > 1e-6 * max(float(np.linalg.norm(columns)), 1e-300)
