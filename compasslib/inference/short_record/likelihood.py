"""How likely a short recording is under a refitted hypothesis: sizes, the scatter and its memory integrated over.

The memory is a law with one autoregressive and one moving-average coefficient: white noise beside a slow wander. What
is left is filtered by each law, the base is free, and the parameters of terms have a wide-tailed law of usual size
(Laplace's approximation; Bishop, Pattern Recognition and Machine Learning, 2006, section 4.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from compasslib.effects.term import USUAL_DEG
from compasslib.inference import show
from compasslib.inference.short_record import fitting
from compasslib.inference.short_record.channel import Channel
from compasslib.inference.short_record.fitting import FittedTerms
from compasslib.statistics import arma, blocks, whitening
from compasslib.types import Floats

Law = tuple[float, float]  # autoregressive and moving-average coefficient

LAWS: tuple[Law, ...] = tuple((float(p), float(t)) for p in arma.PHI for t in arma.THETA if t >= -p)
WHITE: tuple[Law, ...] = ((0.0, 0.0),)
STEADY, TINY = 1e-6, 1e-20  # what keeps an inverse steady; square below which a column is none


@dataclass(frozen=True)
class Evidence:
    """What one hypothesis leaves, by each law of memory, and what is known of its parameters."""

    squares: Floats  # (laws,) of the filtered residual
    information: Floats  # (p, p) of the terms' parameters in units of their usual sizes, by the likeliest law
    size: float  # mean square of their values in those units


def laws(channel: Channel) -> tuple[Law, ...]:
    """Return the laws of memory that are integrated over."""
    return WHITE if channel.independent else LAWS


def log_evidence(channel: Channel, every: Sequence[Evidence], uneven: float) -> Floats:
    """Return the log evidence of hypotheses, up to a constant of the recording, (h,).

    Args:
        uneven: variance of the scores of slow or local columns over what even noise makes of it: what a hypothesis
            leaves more than the best is taken over it.
    """
    squares = np.array([one.squares for one in every])
    least = squares.min(axis=0)
    first = np.array([arma.first_variance(law) for law in laws(channel)])
    fit = -0.5 * _freedom(channel) * (np.log(least) + np.log1p((squares / least - 1.0) / uneven)) - 0.5 * np.log(first)
    return np.logaddexp.reduce(fit, axis=1) - np.array([_charge(one, uneven) for one in every])


def _charge(one: Evidence, uneven: float) -> float:
    """Return what a hypothesis pays for sizes that it could have had: a wide-tailed law of them beforehand."""
    p = len(one.information)
    if not p:
        return 0.0
    determinant = np.linalg.slogdet(np.eye(p) + one.information / uneven)[1]
    return 0.5 * float(determinant) + 0.5 * (p + 1) * float(np.log1p(one.size))


def of(fitted: FittedTerms) -> Evidence:
    """Return the evidence of a hypothesis where it was refitted."""
    tried = [_fit(fitted, law) for law in laws(fitted.channel)]
    squares = np.array([one[0] for one in tried])
    usual = usual_sizes(fitted)
    values = np.concatenate([np.zeros(0), *(term.values for term in fitted.terms)]) / usual
    information = tried[int(np.argmin(squares))][1] * np.outer(usual, usual)
    return Evidence(squares, information, float(np.mean(values**2)) if len(values) else 0.0)


def likeliest(channel: Channel, one: Evidence) -> Law:
    """Return the law of memory that makes what a hypothesis leaves likeliest."""
    first = np.array([arma.first_variance(law) for law in laws(channel)])
    return laws(channel)[int(np.argmin(_freedom(channel) * np.log(one.squares) + np.log(first)))]


def usual_sizes(fitted: FittedTerms) -> Floats:
    """Return what is expected of each parameter of the terms, (p,): by physics, or that it turns by some degrees."""
    own = fitted.columns[:, len(fitted.base) :]
    turn = np.maximum(np.sqrt(np.mean(own**2, axis=0)), 1e-12)
    with np.errstate(divide="ignore"):
        physical = np.concatenate([np.zeros(0), *(term.expected() for term in fitted.terms)]) ** -0.5
    return np.where(np.isfinite(physical), physical, USUAL_DEG / turn)


def gains(fitted: FittedTerms, law: Law, columns: Floats) -> Floats:
    """Return the log likelihood that a term would add to a hypothesis at each of its places, (g,).

    Args:
        columns: of the term's parameters at each place, (n, g, p) degrees a unit.
    """
    n, places, count = columns.shape
    base = whitening.orthonormal(arma.filtered(fitted.columns, law))
    left = whitening.without(arma.filtered(fitted.clipped[:, None], law)[:, 0], base)
    white = whitening.without(arma.filtered(columns.reshape(n, -1), law), base).reshape(n, places, count)
    total = max(float(left @ left) + _excess(fitted) / arma.first_variance(law), _floor(fitted.channel))
    length = np.sqrt(np.maximum(np.einsum("ngp,ngp->gp", white, white), TINY))
    pull = np.einsum("ngp,n->gp", white, left) / length
    alike = np.einsum("ngp,ngq->gpq", white, white) / (length[:, :, None] * length[:, None, :])
    solved = np.linalg.solve(alike + STEADY * np.eye(count), pull[:, :, None])[:, :, 0]
    taken = np.minimum(np.sum(pull * solved, axis=1) / total, 1.0 - 1e-9)
    return np.asarray(-0.5 * _freedom(fitted.channel) * np.log1p(-taken))


def uneven(fitted: FittedTerms, law: Law, groups: list[Floats]) -> float:
    """Return what blocks make of the scores of columns over what even noise would, in the middle, at least 1.

    A rule that is known to some hundredths of a degree only counts as noise that no number of samples averages out.

    Args:
        groups: columns, (n, p) each.
    """
    channel = fitted.channel
    if channel.independent or not groups:
        return 1.0
    base = whitening.orthonormal(arma.filtered(fitted.columns, law))
    left = whitening.without(arma.filtered(fitted.clipped[:, None], law)[:, 0], base)
    variance = max(float(left @ left), _floor(channel)) / _freedom(channel)
    block, ratios = fitting.stretches(fitted), []
    for group in groups:
        white = whitening.orthonormal(whitening.without(arma.filtered(group, law), base))
        if white.shape[1]:
            ratio, count = blocks.unevenness(white, left, block, variance)
            ratios.append((count * ratio + blocks.TRUST) / (count + blocks.TRUST))
    constant = arma.filtered(np.ones((len(channel), 1)), law)
    middle = float(np.quantile(ratios, 0.5)) if ratios else 1.0
    return max(middle, 1.0) + channel.rule_deg**2 * float(np.sum(constant**2)) / variance


def _fit(fitted: FittedTerms, law: Law) -> tuple[float, Floats]:
    """Return the sum of squares by one law, and what is known of the terms' parameters beside a free base."""
    count = len(fitted.base)
    white = arma.filtered(np.column_stack([fitted.columns, fitted.clipped]), law)
    free = whitening.orthonormal(white[:, :count])
    left, own = (whitening.without(part, free) for part in (white[:, -1], white[:, count:-1]))
    square = max(float(left @ left) + _excess(fitted) / arma.first_variance(law), _floor(fitted.channel))
    return square, own.T @ own / (square / _freedom(fitted.channel))


def _excess(fitted: FittedTerms) -> float:
    """Return what clipped samples add to the squares by Huber's law: what is left out for a while is not free."""
    clip = show.FARTHEST * fitted.scale_deg
    beyond = np.maximum(np.abs(fitted.residual_deg) - clip, 0.0) * (not fitted.channel.independent)
    return float(2.0 * clip * np.sum(beyond))


def _freedom(channel: Channel) -> float:
    return float(max(len(channel) - int(np.count_nonzero(channel.steps)), 1))


def _floor(channel: Channel) -> float:
    return len(channel) * fitting.FINEST_DEG**2
