"""Which of two headings: decided over the whole record from persistence, the wake's habit and every overlap.

Where iron is stronger than the earth's horizontal field each recorded heading has two correct ones. The correct heading
is a hidden state on a circle of cells; it moves little from sample to sample, prefers the headings in which the wake
holds the instrument, must make the compass record what it recorded, and agrees with the trusted instrument where that
overlaps. Forward and backward passes give its distribution at every sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.deviation import likelihood
from compasslib.deviation.forms import EXACT
from compasslib.deviation.likelihood import CELL_CENTRES, CELLS, FINE, UNPREDICTED
from compasslib.deviation.model import Fit

Floats = NDArray[np.floating]

STEP_WIDTHS_DEG = (3.0, 6.0, 10.0, 16.0, 25.0, 40.0)  # persistence that is tried
LEAP_SHARES = (0.003, 0.03)  # share of samples at which the heading starts anew
MERGED_DEG = 25.0  # roots nearer than this meet at a fold: one heading between them, not a choice
LEARNING_SAMPLES = 3000
LONGEST_GAP = 64  # sampling intervals after which nothing is remembered
SHARED_NOISE = 0.5  # neighbouring overlaps share the water's veer: each counts for this much of an independent one


@dataclass(frozen=True)
class Decision:
    """The heading chosen at each sample, with how sure that is."""

    heading_deg: Floats  # (n,) NaN where nothing was recorded
    sigma_deg: Floats  # (n,) from the compass's noise and the chance of the other branch
    probability: Floats  # (n,) of the chosen branch; 1 where there is only one, or where two meet at a fold
    other_deg: Floats  # (n,) the other root, NaN where there is none


def decide(time_s: Floats, recorded_deg: Floats, fit: Fit, seen: NDArray[np.intp], scatter: Floats) -> Decision:
    """Return the heading at each sample of a compass that can fold.

    Args:
        time_s: increasing times, (n,).
        recorded_deg: recorded headings, (n,), degrees, NaN where missing.
        fit: a fitted exact compass.
        seen: samples at which the trusted instrument overlaps, (k,).
        scatter: density of its observed heading on the cells, (k, CELLS).
    """
    roots = compass.inverse(fit.coefficients, recorded_deg)
    if not fit.folded:
        return _single(roots[:, 0], recorded_deg, fit)
    evidence = _evidence(recorded_deg, fit)
    evidence[seen] *= scatter**SHARED_NOISE
    steps = np.rint(np.diff(time_s) / np.median(np.diff(time_s))).astype(int) if len(time_s) > 1 else np.zeros(0, int)
    posterior = smooth(evidence, steps, _learn(evidence, steps, fit.heading_density), fit.heading_density)
    return _chosen(posterior, roots, recorded_deg)


def smooth(evidence: Floats, steps: NDArray[np.int_], transition: Floats, stationary: Floats) -> Floats:
    """Return the posterior of the hidden heading by the forward-backward recursion, (n, CELLS).

    Args:
        evidence: likelihood of what was seen at each sample, (n, CELLS).
        steps: sampling intervals between neighbours, (n - 1,).
        transition: row-stochastic over one interval, (CELLS, CELLS).
        stationary: distribution when nothing is known, (CELLS,).
    """
    powers = _powers(transition, stationary, steps)
    forward, _ = _forward(evidence, steps, powers, stationary)
    backward = np.ones(CELLS)
    for t in range(len(evidence) - 2, -1, -1):
        backward = powers[min(steps[t], LONGEST_GAP)] @ (backward * evidence[t + 1])
        backward /= backward.sum()
        forward[t] *= backward
    return forward / forward.sum(axis=1, keepdims=True)


def _forward(
    evidence: Floats, steps: NDArray[np.int_], powers: dict[int, Floats], stationary: Floats
) -> tuple[Floats, float]:
    forward, total = np.empty_like(evidence), 0.0
    state = stationary
    for t in range(len(evidence)):
        state = (state @ powers[min(steps[t - 1], LONGEST_GAP)] if t else state) * evidence[t]
        mass = state.sum()
        total += np.log(mass)
        state = forward[t] = state / mass
    return forward, float(total)


def _powers(transition: Floats, stationary: Floats, steps: NDArray[np.int_]) -> dict[int, Floats]:
    known = {0: np.eye(CELLS), LONGEST_GAP: np.tile(stationary, (CELLS, 1))}
    for gap in np.unique(steps):
        if 0 < gap < LONGEST_GAP:
            known[int(gap)] = np.linalg.matrix_power(transition, int(gap))
    return known


def _transition(width_deg: float, leaps: float, density: Floats) -> Floats:
    """Return one interval's transition: a step on the circle, drawn to where the wake holds, or a leap."""
    away = angles.difference(CELL_CENTRES[:, None], CELL_CENTRES[None, :])
    drawn = np.exp(-0.5 * (away / width_deg) ** 2) * np.sqrt(density)
    return (1.0 - leaps) * drawn / drawn.sum(axis=1, keepdims=True) + leaps * density


def _learn(evidence: Floats, steps: NDArray[np.int_], density: Floats) -> Floats:
    """Return the transition under which the record itself is likeliest."""
    begin = max(0, (len(evidence) - LEARNING_SAMPLES) // 2)
    part = slice(begin, begin + LEARNING_SAMPLES)
    some, gaps = evidence[part], steps[part][: len(evidence[part]) - 1]
    tried = [_transition(width, leaps, density) for width in STEP_WIDTHS_DEG for leaps in LEAP_SHARES]
    fits = [_forward(some, gaps, _powers(t, density, gaps), density)[1] for t in tried]
    return tried[int(np.argmax(fits))]


def _evidence(recorded_deg: Floats, fit: Fit) -> Floats:
    """Return how likely each cell makes the recorded heading, (n, CELLS); flat where nothing was recorded."""
    offset = EXACT.offset(fit.coefficients, FINE.heading_deg, FINE.heading_deg)
    density = likelihood.compass_noise(offset, fit.noise.compass_deg)
    hats = FINE.hats()
    table = density @ (hats / hats.sum(axis=0)) + UNPREDICTED
    known = np.isfinite(recorded_deg)
    rows = table[FINE.bin_of(np.where(known, recorded_deg, 0.0))]
    return np.where(known[:, None], rows, 1.0 / 360.0)


def _chosen(posterior: Floats, roots: Floats, recorded_deg: Floats) -> Decision:
    """Give each cell to the nearer root; take the root with more mass and the mean heading of its cells.

    Near a fold the roots meet and every cell counts.
    """
    away = np.abs(angles.difference(roots[:, :, None], CELL_CENTRES))
    away = np.where(np.isfinite(away), away, np.inf)
    first = away[:, 0, :] <= away[:, 1, :]
    mass = np.sum(posterior * first, axis=1)
    takes_first = mass >= 0.5
    close = np.abs(angles.difference(roots[:, 0], roots[:, 1])) < MERGED_DEG
    own = posterior * ((first == takes_first[:, None]) | close[:, None])
    centre = own @ angles.phasor(CELL_CENTRES)
    share = own.sum(axis=1)
    heading = angles.argument(centre)
    spread = angles.difference(CELL_CENTRES, heading[:, None])
    variance = np.sum(posterior * spread**2, axis=1)  # about the chosen heading, the other branch included
    known = np.isfinite(recorded_deg)
    two = np.isfinite(roots).all(axis=1) & ~close
    other = np.where(takes_first, roots[:, 1], roots[:, 0])
    return Decision(
        heading_deg=np.where(known, heading, np.nan),
        sigma_deg=np.where(known, np.sqrt(variance), np.nan),
        probability=np.where(known, np.where(two, share, 1.0), np.nan),
        other_deg=np.where(two, other, np.nan),
    )


def _single(root: Floats, recorded_deg: Floats, fit: Fit) -> Decision:
    slope = np.maximum(np.abs(compass.slope(fit.coefficients, root)), 0.05)
    return Decision(
        heading_deg=root,
        sigma_deg=fit.noise.compass_deg / slope,
        probability=np.where(np.isfinite(root), 1.0, np.nan),
        other_deg=np.full(root.shape, np.nan),
    )
