"""Gauss and Newton's steps to the parameters that fit best; a step that is too long is cut or halved."""

from __future__ import annotations

from typing import Protocol, Self, TypeVar

import numpy as np

from compasslib.types import Floats

LONGEST = 12.0  # of one step, in about degrees: beyond it a simulation of angles is no longer linear
SETTLED = 1e-9  # relative change of the misfit that is rounding


class Point(Protocol):
    """Where a fit stands."""

    def step(self) -> tuple[Floats, float]:
        """Return the least-squares step, and how far it goes in about degrees."""
        ...

    def moved(self, step: Floats) -> Self | None:
        """Return the point a step away, None where there is none."""
        ...

    def misfit(self, other: Self) -> float:
        """Return the misfit of another point over its own, both by its own widths."""
        ...


P = TypeVar("P", bound=Point)


def fit(point: P, *, rounds: int, close: float, worse: float) -> P:
    """Return the point that is reached.

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
        if length < close or abs(growth - 1.0) < SETTLED:
            break
        step, length = _cut(*point.step())
    return point


def _cut(step: Floats, length: float) -> tuple[Floats, float]:
    share = min(1.0, LONGEST / max(length, 1e-12))
    return step * share, length * share
