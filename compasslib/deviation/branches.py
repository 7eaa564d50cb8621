"""Choice between the two headings of a folded compass, by a hidden Markov model over the whole record.

The correct heading is a hidden state on a circle of cells that changes little from sample to sample. When the
instrument turns, the current, which changes slowly, turns the other way in its frame: on the wrong branch it turns by
twice the angle. The wake favours some headings; recorded heading and any overlapping reference are observations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.deviation.average import CompassSeries
from compasslib.deviation.likelihood import CELL_CENTRES, CELLS, FINE, UNEXPLAINED_DENSITY, normal_density
from compasslib.deviation.model import DeviationFit
from compasslib.records import Readings
from compasslib.types import Complexes, Floats

STEP_WIDTHS_DEG = (3.0, 6.0, 10.0, 16.0, 25.0, 40.0, 80.0)  # candidate standard deviations of a heading step
WATER_CHANGES = (0.02, 0.035, 0.06, 0.1, 0.2, 10.0)  # candidate changes of the current over an interval, m/s
LEAP_SHARES = (0.003, 0.03)  # candidate probabilities of a jump to an unrelated heading
PRECISION_DEG = 0.5  # assumed for a moored compass; an unfolded record cannot separate it from the water's scatter
MERGED_DEG = 25.0  # roots closer than this merge at a fold into one heading between them


@dataclass(frozen=True)
class HeadingDecision:
    """The heading chosen at each sample, with its uncertainty."""

    heading_deg: Floats  # (n,) NaN where nothing was recorded
    sigma_deg: Floats  # (n,) from the compass's noise and the probability of the other branch
    probability: Floats  # (n,) of the chosen branch; 1 if single or merged at a fold, 0 if the reading is impossible
    other_deg: Floats  # (n,) the other root, NaN where there is none
    common_deg: Floats  # (n,) part of sigma_deg that is common to the record


def single_branch(root_deg: Floats, slope: Floats) -> HeadingDecision:
    """Take the only root of each reading, (n,) degrees; the precision of the reading limits its uncertainty."""
    return HeadingDecision(
        heading_deg=angles.wrap360(root_deg),
        sigma_deg=PRECISION_DEG / np.maximum(np.abs(slope), 0.05),
        probability=np.where(np.isfinite(root_deg), 1.0, np.nan),
        other_deg=np.full(root_deg.shape, np.nan),
        common_deg=np.zeros(root_deg.shape),
    )


def choose_branches(
    readings: Readings, along: CompassSeries, fit: DeviationFit, overlap: NDArray[np.intp], scatter: Floats
) -> HeadingDecision:
    """Choose the heading at each sample by the record and the headings observed (``scatter``) at ``overlap``.

    Args:
        overlap: indices of the samples at which the reference overlaps, (k,).
        scatter: density of the heading observed there, on the cells, (k, CELLS).
    """
    roots = along.roots()
    if not np.isfinite(roots[:, 1]).any():
        return single_branch(roots[:, 0], compass.slope(along.coefficients, roots[:, 0] - along.north_deg))
    known = np.isfinite(along.reading_deg)
    recorded = angles.wrap360(np.where(known, along.reading_deg, 0.0))
    if along.coefficients.ndim == 1:
        table = _rows(FINE.heading_deg, along.coefficients, FINE.heading_deg, fit.noise.compass_deg)
        rows = table[FINE.bin_of(recorded)]
    else:
        towards = FINE.heading_deg - np.broadcast_to(along.north_deg, recorded.shape)[:, None]
        parts = np.array_split(np.arange(len(recorded)), max(1, len(recorded) // 500))
        at = along.coefficients[:, :, None]
        rows = np.concatenate([_rows(recorded[i], at[:, i], towards[i], fit.noise.compass_deg) for i in parts])
    evidence = np.where(known[:, None], rows, 1.0 / 360.0)
    impossible = evidence.max(axis=1) < 2.0 * UNEXPLAINED_DENSITY  # the heading follows from adjacent samples
    evidence[overlap] *= np.sqrt(scatter)  # neighbouring overlaps share the water's veer
    moves = _water_turns(readings.time_s, readings.water)
    posterior = forward_backward(evidence, moves, _learn(evidence, moves, fit.heading_density), fit.heading_density)
    decision = _chosen(posterior, roots, readings.heading_deg)
    return replace(decision, probability=np.where(impossible, 0.0, decision.probability))


def open_branches(decision: HeadingDecision, shown: int, pairs: int) -> HeadingDecision:
    """Reduce the branch probability to 0.5 or less if too few pairs show which branch is right."""
    if shown >= min(200, 0.1 * pairs):
        return decision
    apart = np.nan_to_num(angles.difference(decision.other_deg, decision.heading_deg))
    two = np.isfinite(decision.other_deg)
    probability = np.where(two, np.minimum(decision.probability, 0.5), decision.probability)
    return replace(decision, sigma_deg=np.hypot(decision.sigma_deg, apart), probability=probability)


def shows_branch(roots_deg: Floats, width_deg: Floats) -> NDArray[np.bool_]:
    """Find the overlaps whose directions show the branch: only one root, or two apart by five widths, (n,)."""
    single = np.isfinite(roots_deg).sum(axis=1) == 1
    with np.errstate(invalid="ignore"):
        return single | (np.abs(angles.difference(roots_deg[:, 0], roots_deg[:, 1])) >= 5.0 * width_deg)


@dataclass(frozen=True)
class WaterTurns:
    """Changes of the current between neighbouring samples, (n - 1,) each."""

    steps: Floats  # time difference in sampling intervals
    turn_deg: Floats  # clockwise turn of the water in the instrument's frame; 0 where unknown
    strength: Floats  # product of the two speeds, m2/s2; 0 where unknown


@dataclass(frozen=True)
class MotionModel:
    """Parameters of the motion of heading and current over one sampling interval."""

    width_deg: float  # standard deviation of the heading's step
    water_m_s: float  # typical change of the current
    leaps: float  # probability of a jump to an unrelated heading


def forward_backward(evidence: Floats, moves: WaterTurns, habit: MotionModel, stationary: Floats) -> Floats:
    """Compute the posterior of the hidden heading by the forward-backward recursion, (n, CELLS)."""
    kernels, last = _kernels(moves, [habit], stationary), len(evidence) - 1
    forward, backward = np.empty((2, last + 1, CELLS))
    forward[0], backward[last] = stationary * evidence[0] / np.sum(stationary * evidence[0]), 1.0
    for t in range(last):
        s = last - t  # both directions at once, as calling a transform costs more than the transform
        state, message = kernels.both(t, forward[t], s - 1, backward[s] * evidence[s])
        state *= evidence[t + 1]
        forward[t + 1], backward[s - 1] = state / state.sum(), message / message.sum()
    forward *= backward
    return forward / forward.sum(axis=1, keepdims=True)


@dataclass(frozen=True)
class _Kernels:
    """Transitions over each interval for h motion models: a step weighted by the wake's preference, or a jump."""

    spectrum: NDArray[np.complex64]  # (n - 1, h, CELLS / 2 + 1) of the step's density, times the chance of no jump
    norm: NDArray[np.float32]  # (n - 1, h, CELLS) normalization of a step from each cell
    draw: Floats  # (CELLS,) weight of a step's end by the wake
    stationary: Floats  # (CELLS,)
    leaps: Floats  # (n - 1, h, 1) probability of a jump

    def ahead(self, t: int, state: Floats) -> Floats:
        stepped = np.fft.irfft(np.fft.rfft(state / self.norm[t]) * self.spectrum[t], CELLS)
        return np.maximum(stepped, 0.0) * self.draw + self.leaps[t] * self.stationary

    def both(self, t: int, state: Floats, s: int, message: Floats) -> tuple[Floats, Floats]:
        """Propagate a state over interval t and a message back over s by the first model, (CELLS,) each."""
        begun = np.fft.rfft([state / self.norm[t, 0], message * self.draw])
        begun[0] *= self.spectrum[t, 0]
        begun[1] *= np.conj(self.spectrum[s, 0])
        ahead, back = np.maximum(np.fft.irfft(begun, CELLS), 0.0)
        ahead = ahead * self.draw + self.leaps[t, 0] * self.stationary
        return ahead, back / self.norm[s, 0] + self.leaps[s, 0] * (message @ self.stationary)


def _kernels(moves: WaterTurns, habits: Sequence[MotionModel], stationary: Floats) -> _Kernels:
    """Compute the transition probabilities between samples of each motion model."""
    longest_gap = 64.0  # sampling intervals after which the heading is independent
    steps = np.minimum(moves.steps, longest_gap)[:, None, None]
    width, change, leap = np.array([(h.width_deg, h.water_m_s, h.leaps) for h in habits]).T[:, :, None]
    away = angles.wrap180(CELL_CENTRES)
    grip = np.minimum(moves.strength[:, None, None] / (change**2 * steps), 300.0)  # what the cells resolve
    # |v' e^{i beta'} - v e^{i beta}|^2 depends on the step beta' - beta only: the factor is von Mises about -turn
    cosine = angles.sin_cos(away + moves.turn_deg[:, None])[1][:, None, :]
    density = grip * (cosine - 1.0)
    density -= 0.5 * away**2 / (width**2 * steps)
    density -= density.max(axis=-1, keepdims=True)
    np.exp(density, out=density)
    density /= density.sum(axis=-1, keepdims=True)
    spectrum = np.fft.rfft(density)
    draw = np.sqrt(stationary)
    norm = np.fft.irfft(np.fft.rfft(draw) * np.conj(spectrum), CELLS)
    leaps = np.where(steps >= longest_gap, 1.0, 1.0 - (1.0 - leap) ** steps)
    floor = np.maximum(norm, 1e-12).astype(np.float32)
    spectrum *= 1.0 - leaps
    return _Kernels(spectrum.astype(np.complex64), floor, draw, stationary, leaps)


def _water_turns(time_s: Floats, water: Complexes) -> WaterTurns:
    if len(time_s) < 2:
        return WaterTurns(*np.zeros((3, 0)))
    product = water[1:] * np.conj(water[:-1])
    known = np.isfinite(product)
    return WaterTurns(
        steps=np.maximum(np.rint(np.diff(time_s) / np.median(np.diff(time_s))), 1.0),
        turn_deg=np.where(known, angles.argument(np.where(known, product, 1.0)), 0.0),
        strength=np.where(known, np.abs(product), 0.0),
    )


def _learn(evidence: Floats, moves: WaterTurns, density: Floats) -> MotionModel:
    """Select the motion model with the greatest likelihood in 2000 samples of the middle, one parameter at a time."""
    begin = max(0, (len(evidence) - 2000) // 2)
    middle = evidence[begin : begin + 2000]
    between = slice(begin, begin + len(middle) - 1)
    part = WaterTurns(moves.steps[between], moves.turn_deg[between], moves.strength[between])

    @cache  # often the width does not change, and both searches over the water's changes are the same
    def likelier(*habits: MotionModel) -> MotionModel:
        kernels, masses = _kernels(part, habits, density), []
        state = np.broadcast_to(kernels.stationary, (len(habits), CELLS))
        for t in range(len(middle)):
            state = (kernels.ahead(t - 1, state) if t else state) * middle[t]
            masses.append(state.sum(axis=1))
            state = state / masses[-1][:, None]
        return habits[int(np.argmax(np.log(masses).sum(axis=0)))]

    habit = MotionModel(STEP_WIDTHS_DEG[3], WATER_CHANGES[-1], LEAP_SHARES[0])
    habit = likelier(*(replace(habit, water_m_s=change) for change in WATER_CHANGES))
    habit = likelier(*(replace(habit, width_deg=width) for width in STEP_WIDTHS_DEG))
    habit = likelier(*(replace(habit, water_m_s=change) for change in WATER_CHANGES))
    return likelier(*(replace(habit, leaps=leaps) for leaps in LEAP_SHARES))


def _rows(recorded_deg: Floats, coefficients: Floats, heading_deg: Floats, compass_deg: float) -> Floats:
    """Compute the density of each recorded heading given each cell, (k, CELLS)."""
    offset = angles.difference(recorded_deg[:, None], compass.recorded_heading(coefficients, heading_deg))
    weights = FINE.hats / FINE.hats.sum(axis=0)
    return np.asarray(normal_density(offset, compass_deg) @ weights + UNEXPLAINED_DENSITY)


def _chosen(posterior: Floats, roots: Floats, recorded_deg: Floats) -> HeadingDecision:
    """Assign each cell to the nearer root, choose the root with more probability, and average over its cells."""
    away = np.abs(angles.difference(roots[:, :, None], CELL_CENTRES))
    away = np.where(np.isfinite(away), away, np.inf)
    first = away[:, 0, :] <= away[:, 1, :]
    mass = np.sum(posterior * first, axis=1)
    takes_first = mass >= 0.5
    close = np.abs(angles.difference(roots[:, 0], roots[:, 1])) < MERGED_DEG
    chosen = posterior * ((first == takes_first[:, None]) | close[:, None])
    centre = chosen @ angles.phasor(CELL_CENTRES)
    share = chosen.sum(axis=1)
    heading = angles.argument(centre)
    spread = angles.difference(CELL_CENTRES, heading[:, None])
    variance = np.sum(posterior * spread**2, axis=1)  # about the chosen heading, including the other branch
    known = np.isfinite(recorded_deg)
    two = np.isfinite(roots).all(axis=1) & ~close
    other = np.where(takes_first, roots[:, 1], roots[:, 0])
    return HeadingDecision(
        heading_deg=np.where(known, heading, np.nan),
        sigma_deg=np.where(known, np.sqrt(variance), np.nan),
        probability=np.where(known, np.where(two, share, 1.0), np.nan),
        other_deg=np.where(two, other, np.nan),
        common_deg=np.zeros(known.shape),
    )
