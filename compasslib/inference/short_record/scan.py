"""What noise alone would do: columns tested against the residual, and against draws of the record's own noise."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from compasslib.inference import omnibus
from compasslib.inference.omnibus import Group, Tested, normal_score
from compasslib.inference.short_record import fitting
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.statistics import arma, blocks, whitening
from compasslib.types import Floats

REPEATS = 400  # draws of noise, which set how well a p-value of 1 % is known
HEADING_HAT_DEG, FEWEST_IN_HAT = 15.0, 5  # sectors that the omnibus sees, and readings in one
FAINT = 0.2  # of the largest direction of a group of splines
SHARE_OF_FREEDOM = 3  # an omnibus group has no more columns than this part of the independent samples


def groups(now: FittedTerms) -> list[Group]:
    """Return harmonics and hats of the heading, hats of every other covariate, and products with the heading."""
    found = now.channel.covariates
    worth = len(now.channel) if now.channel.remembered else fitting.effective(now)  # the law's draws know the memory
    most = int(worth) // SHARE_OF_FREEDOM
    heading, made = found.get("heading"), []
    if heading is not None:
        made = [omnibus.periodic(heading, range(3, 7)), omnibus.heading_hats(heading, HEADING_HAT_DEG, FEWEST_IN_HAT)]
    every = [Group("heading", columns, covariates=("heading",)) for columns in made]
    for name, column in found.items():
        if name == "heading" or np.ptp(column) == 0.0:
            continue
        hats = omnibus.hats(column, min(omnibus.KNOTS, max(3, most // 2)))
        every.append(Group(name, hats, covariates=(name,)))
        if heading is not None:
            both = omnibus.periodic(heading, range(1, 3)) * omnibus.standard(column)[:, None]
            every.append(Group(f"heading x {name}", both, covariates=("heading", name)))
    return [group for group in every if 0 < group.columns.shape[1] <= most]


def test(now: FittedTerms, noise: FittedTerms, groups: Sequence[Group], seed: int = 0) -> Tested:
    """Return the score tests of all groups.

    Args:
        noise: the hypothesis whose residual is taken for noise: an effect must not raise the bar for itself.
    """
    white = arma.whitening_matrix(noise.clipped, noise.columns) if now.channel.remembered else None
    seen_as = [group.columns if white is None else white @ group.columns for group in groups]
    base = whitening.orthonormal(now.columns if white is None else white @ now.columns)
    bases = [directions(columns, base) for columns in seen_as]
    kept = [k for k, basis in enumerate(bases) if basis.shape[1] and _lives(seen_as[k], bases[k], base)]
    if not kept:
        none = np.zeros(0)
        return Tested([], none, none, none, none)
    some, bases = [groups[k] for k in kept], [bases[k] for k in kept]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    every = np.concatenate(bases, axis=1)
    rows = np.vstack([now.clipped[None, :], draws(noise, seed)])
    gains = _gains(rows if white is None else rows @ white.T, every, begins, base)
    inflation = np.maximum(gains[1:].mean(axis=0) / freedom, np.finfo(float).tiny)  # a residual that is 0 has no noise
    score = normal_score(gains / inflation, freedom)
    return Tested(some, freedom, np.maximum(inflation, 1.0), score[0], score[1:].max(axis=1))


def directions(columns: Floats, base: Floats) -> Floats:
    """Return an orthonormal basis of what the base leaves of some columns, (n, k).

    What the base nearly is leaves faint directions that are no splines any more: they are left out.

    Args:
        base: orthonormal, (n, b).
    """
    return whitening.orthonormal(whitening.without(columns, base), FAINT)


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


def size_of(now: FittedTerms, group: Group, inflation: float) -> float:
    """Return the visible size of a group's best fit, rms degrees, freed of what noise adds to it."""
    seen = directions(group.columns, whitening.orthonormal(now.columns))
    pull, n = seen.T @ now.clipped, len(now.channel)
    noise = inflation * seen.shape[1] * now.square / n
    return float(np.sqrt(max(float(pull @ pull) - noise, 0.0) / n))


def _gains(rows: Floats, every: Floats, begins: NDArray[np.intp], base: Floats) -> Floats:
    """Return twice the log likelihood that each group adds to each row, (rows, groups)."""
    bare = rows - (rows @ base) @ base.T
    total = np.sum(bare**2, axis=1)[:, None]
    taken = np.add.reduceat((bare @ every) ** 2, begins, axis=1)
    return -rows.shape[1] * np.log(np.maximum(1.0 - taken / np.maximum(total, 1e-300), 1e-12))


def _lives(columns: Floats, basis: Floats, base: Floats) -> bool:
    """Tell whether the base leaves more than rounding of a group."""
    return float(np.linalg.norm(whitening.without(columns, base))) > 1e-6 * max(float(np.linalg.norm(columns)), 1e-300)
