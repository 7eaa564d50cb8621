"""What no term of the catalogue is and some of them imitate: an error at a few headings only, or for a while only.

A card that is pulled in one sector looks like lobes, a while astray like a slip. Where such an error explains more than
the terms that stand for it, these lose their names and it stays unexplained. Nothing goes astray and comes back by as
much of itself, and no iron acts on one sector alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.discrepancy import whitening
from compasslib.discrepancy.recordings import fitting, testing
from compasslib.discrepancy.recordings.fitting import Fitted
from compasslib.discrepancy.recordings.terms import Drift, IronDrift
from compasslib.discrepancy.recordings.testing import Group, Tested
from compasslib.discrepancy.rivals import DATE_CHARGE, PARAMETER_CHARGE
from compasslib.physics.octantal import Octantal
from compasslib.physics.sextantal import Sextantal
from compasslib.physics.term import Term

Floats = NDArray[np.floating]

PLACES, REACHES_DEG = 36, (15.0, 25.0, 40.0)  # where an error at a few headings is tried, and how far it reaches
FEWEST = 3  # samples in it
MOST_DATES = 200  # begins and ends of a while
FAINT = 1e-6  # of the largest column: less is rounding
CHARGE = PARAMETER_CHARGE + 2.0 * DATE_CHARGE  # one size, two places


@dataclass(frozen=True)
class Family:
    """Terms that imitate, and what they imitate."""

    imitates: Callable[[Term], bool]
    strangers: Callable[[Fitted, Fitted], list[Group]]  # where these terms are left out; by whose residual as noise


def instead(fitted: Fitted, family: Family) -> tuple[list[int], Tested] | None:
    """Return which terms stay, and what explains more than the others did; None where nothing does.

    Args:
        fitted: the chosen hypothesis.
        family: of terms in question.
    """
    own = [term for term in fitted.terms if family.imitates(term)]
    if not own:
        return None
    kept = [k for k, term in enumerate(fitted.terms) if not family.imitates(term)]
    free = fitting.fit(fitted.channel, [fitted.terms[k] for k in kept], near=fitted)
    groups = family.strangers(free, fitted)
    if not groups:
        return None
    named = np.concatenate([testing.columns(free, term.at(0.0 * term.values)) for term in own], axis=1)
    scores = {one.group.name: one for one in testing.test(free, fitted, [Group("named", named, own[0]), *groups])}
    stranger = scores.get(groups[0].name)
    charged = sum(PARAMETER_CHARGE * len(term.fitted()) + DATE_CHARGE * term.dated() for term in own)
    if stranger is None or stranger.gain - CHARGE <= scores["named"].gain - charged:
        return None
    return kept, stranger


def _sectors(free: Fitted, _: Fitted) -> list[Group]:
    """Return errors at a few headings."""
    heading = free.channel.covariates.get("heading")
    if heading is None:
        return []
    away = np.abs(angles.difference(heading[:, None], 360.0 / PLACES * np.arange(PLACES)))
    hats = [np.where(away < reach, 1.0 + np.cos(np.pi * away / reach), 0.0) / 2.0 for reach in REACHES_DEG]
    columns = np.concatenate(hats, axis=1)
    return [Group("heading", c[:, None], None, ("heading",)) for c in columns.T if np.count_nonzero(c) >= FEWEST]


def _whiles(free: Fitted, noise: Fitted) -> list[Group]:
    """Return the offset with a begin and an end that gains most; its dates must be right to the sample."""
    n, name = len(free.channel), "time" if "time" in free.channel.covariates else "reading"
    if name not in free.channel.covariates or n < 2 * FEWEST:
        return []
    at = np.unique(np.linspace(1, n - 1, min(n - 1, MOST_DATES)).astype(int))
    begin, end = np.triu_indices(len(at), k=1)
    white = noise.whitener if free.channel.remembered else np.eye(n)
    steps = (np.arange(n)[:, None] >= at).astype(float)
    base = whitening.orthonormal(white @ free.columns)
    left = white @ steps - base @ (base.T @ (white @ steps))
    pull, gram = left.T @ (white @ free.clipped), left.T @ left
    power = gram[begin, begin] + gram[end, end] - 2.0 * gram[begin, end]
    long = (at[end] - at[begin] >= FEWEST) & (power > FAINT * power.max())
    best = int(np.argmax(np.where(long, (pull[begin] - pull[end]) ** 2 / np.maximum(power, 1e-300), -1.0)))
    return [Group(name, steps[:, [begin[best]]] - steps[:, [end[best]]], None, (name,))]


FAMILIES = (
    Family(lambda term: isinstance(term, Sextantal | Octantal), _sectors),
    Family(lambda term: term.dated() or isinstance(term, Drift | IronDrift), _whiles),
)
