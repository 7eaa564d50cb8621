"""A hypothesis refitted: base parameters and terms together, by Gauss and Newton's steps with Huber's weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.term import Term, slices
from compasslib.inference import show
from compasslib.inference.short_record.channel import Channel
from compasslib.statistics import arma, blocks, gauss_newton, robust, whitening
from compasslib.statistics.autocorrelation import effective_number
from compasslib.types import Floats

ROUNDS, CLOSE_ENOUGH = 12, 1e-3  # of refitting; a step in about degrees
FINEST_DEG = 1e-4  # no heading is known better
MOST_BLOCKS, FEWEST_BLOCKS, SAMPLES_IN_BLOCK = 40, 10, 5.0  # longer than the memory, and enough to tell a scatter
PROBE = 0.02  # of a step, for differences


@dataclass(frozen=True)
class FittedTerms:
    """A hypothesis at its best parameters."""

    channel: Channel
    base: Floats  # (b,)
    terms: tuple[Term, ...]
    residual_deg: Floats  # (n,)
    columns: Floats  # (n, b + p) derivative of the simulated heading by each parameter, degrees a unit
    scale_deg: float

    @property
    def clipped(self) -> Floats:
        """Return the residual, clipped where samples are many enough to know a width, (n,)."""
        if self.channel.independent:
            return self.residual_deg
        return np.clip(self.residual_deg, -show.FARTHEST * self.scale_deg, show.FARTHEST * self.scale_deg)

    @property
    def square(self) -> float:
        """Return the sum of the squares."""
        return float(self.clipped @ self.clipped)

    def reordered(self, order: Sequence[int]) -> FittedTerms:
        """Return the same with its terms in another order.

        Args:
            order: number of each term, the first first.
        """
        places = slices(self.terms, len(self.base))
        columns = self.columns[:, np.r_[: len(self.base), *(places[k] for k in order)]]
        return replace(self, terms=tuple(self.terms[k] for k in order), columns=columns)

    def projected(self, columns: Floats) -> Floats:
        """Return columns without what the parameters can take of them, (n, k).

        Args:
            columns: (n, k).
        """
        return whitening.without(columns, whitening.orthonormal(self.columns))


def fit(
    channel: Channel, terms: Sequence[Term], *, near: FittedTerms | None = None, use: NDArray[np.bool_] | None = None
) -> FittedTerms:
    """Return a hypothesis refitted.

    Args:
        terms: beside the base, where the fit begins; their dates stay.
        near: a fit whose base is taken to begin with.
        use: samples that count, (n,).
    """
    base = channel.start if near is None else near.base
    theta = np.concatenate([base, *(term.values for term in terms)])
    steps = np.concatenate([channel.steps, *(term.steps() for term in terms)])
    keep = np.ones(len(channel), dtype=bool) if use is None else use
    begin = _Standing(_at(channel, theta, tuple(terms), steps), theta, steps, keep)
    if not len(steps):
        return begin.fitted
    return gauss_newton.fit(begin, rounds=ROUNDS, close=CLOSE_ENOUGH, worse=1.0 + gauss_newton.SETTLED).fitted


@dataclass(frozen=True)
class _Standing:
    """A hypothesis as a point of a fit."""

    fitted: FittedTerms
    theta: Floats  # (b + p,)
    steps: Floats  # (b + p,) of about a degree
    keep: NDArray[np.bool_]  # (n,) samples that count

    def step(self) -> tuple[Floats, float]:
        """Return the step of all parameters."""
        step = _step(self.fitted, self.steps, self.keep)  # in the parameters' own steps
        return step * self.steps, float(np.max(np.abs(step)))

    def moved(self, step: Floats) -> _Standing:
        """Return the hypothesis a step away."""
        theta = self.theta + step
        return replace(self, fitted=_at(self.fitted.channel, theta, self.fitted.terms, self.steps), theta=theta)

    def misfit(self, other: _Standing) -> float:
        """Return the sum of the squares of another hypothesis over that of this."""
        square, then = (float(np.sum(one.fitted.clipped[self.keep] ** 2)) for one in (self, other))
        return then / max(square, 1e-300)


def columns(now: FittedTerms, term: Term) -> Floats:
    """Return the derivative of the simulated heading by a term's parameters beside a hypothesis, (n, p).

    Args:
        term: where the derivative is taken.
    """
    made = []
    for j, step in enumerate(term.steps()):
        moved = term.at(term.values + 0.1 * step * (np.arange(len(term.values)) == j))
        made.append((now.residual_deg - now.channel.residual(now.base, (*now.terms, moved))) / (0.1 * step))
    return np.stack(made, axis=1)


def _at(channel: Channel, theta: Floats, terms: tuple[Term, ...], steps: Floats) -> FittedTerms:
    """Return the residual and its derivative where the parameters stand."""
    base, placed = _split(channel, theta, terms)
    residual = channel.residual(base, placed)
    columns = np.zeros((len(channel), len(theta)))
    for j in np.flatnonzero(steps):  # a step of 0 holds a parameter
        probe = PROBE * steps[j]
        more = channel.residual(*_split(channel, theta + probe * (np.arange(len(theta)) == j), terms))
        columns[:, j] = (residual - more) / probe
    scale = max(robust.width(residual - np.median(residual)), FINEST_DEG)
    return FittedTerms(channel, base, placed, residual, columns, scale)


def _split(channel: Channel, theta: Floats, terms: tuple[Term, ...]) -> tuple[Floats, tuple[Term, ...]]:
    own = slices(terms, len(channel.start))
    placed = tuple(term.at(theta[part]) for term, part in zip(terms, own, strict=True))
    return theta[: len(channel.start)], placed


def _step(now: FittedTerms, steps: Floats, keep: NDArray[np.bool_]) -> Floats:
    """Return the weighted least-squares step in the parameters' own steps; directions that nothing determines stay."""
    size = np.maximum(np.abs(now.residual_deg), 1e-300)
    weight = np.sqrt(np.minimum(1.0, show.FARTHEST * now.scale_deg / size)) * keep
    if now.channel.independent:
        weight = keep.astype(float)
    columns = now.columns * steps
    step, *_ = np.linalg.lstsq(columns * weight[:, None], now.residual_deg * weight, rcond=1e-6)
    return np.asarray(step)


def stretches(fitted: FittedTerms) -> NDArray[np.intp]:
    """Return the block of each sample, (n,): longer than the memory, each reading one where there is none."""
    channel = fitted.channel
    if channel.independent:
        return np.arange(len(channel))
    order = np.arange(len(channel), dtype=float)
    count = int(np.clip(effective(fitted) / SAMPLES_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
    return blocks.in_time(order, count)


def effective(fitted: FittedTerms) -> float:
    """Return how many independent samples the residual is worth."""
    n = len(fitted.channel)
    if fitted.channel.independent:
        return float(n)
    if fitted.channel.remembered:
        return arma.effective_number(fitted.clipped, fitted.columns)
    return effective_number(fitted.clipped, np.arange(n, dtype=float), longest_s=n / 10.0)


def covariance(fitted: FittedTerms) -> Floats:
    """Return the covariance of base and terms: by the scores of blocks, never below that of independent samples.

    What the simulation itself does not know is added, as if it lay all along each parameter's own column.
    """
    if fitted.channel.remembered:
        return arma.covariance(fitted.clipped, fitted.columns)
    columns, residual, block = fitted.columns, fitted.clipped, stretches(fitted)
    inverse = whitening.inverse(columns.T @ columns)
    free = max(len(residual) - columns.shape[1], 1)
    plain = inverse * fitted.square / free * blocks.student(free) ** 2
    if fitted.channel.independent:
        return plain
    sums = blocks.sums(columns * residual[:, None], block)
    count = len(sums)
    robust = inverse @ (sums.T @ sums) @ inverse * count / (count - 1) * blocks.student(count - 1) ** 2
    share = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
    rule = fitted.channel.rule_deg**2 * len(residual) * np.diag(np.diag(inverse))
    return plain * np.outer(share, share) + rule


def effect_deg(fitted: FittedTerms, k: int) -> float:
    """Return the visible size of a term: what no other parameter can take of it, rms degrees."""
    own = slices(fitted.terms, len(fitted.base))[k]
    rest = [term for j, term in enumerate(fitted.terms) if j != k]
    without = fitted.channel.residual(fitted.base, tuple(rest)) - fitted.residual_deg
    others = whitening.orthonormal(np.delete(fitted.columns, own, axis=1))
    return angles.rms(whitening.without(without, others))
