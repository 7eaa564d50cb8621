"""Coefficients, terms and nuisances refitted together in the forward model, with their covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.effects import Term
from compasslib.effects.term import slices
from compasslib.inference import baseline, columns
from compasslib.inference.baseline import TINY, State
from compasslib.inference.omnibus import Group
from compasslib.statistics import gauss_newton, robust, whitening
from compasslib.statistics.whitening import Whitener
from compasslib.types import Floats

ROUNDS = 4  # of refitting, at most
HALVED = 4  # times that the sizes of terms are halved before a compass is given up
CLOSE_ENOUGH = 0.02  # degrees, roughly, of a step that is the last
WORSE = 1.5  # growth of the residual at which a step is not taken
DAMPING = 1e-4  # of whitened columns of length one: waves of the tides, sampled twice a day, stand for a constant too
NEARBY_S, FINE_S = 12 * 86400.0, 86400.0  # reach and spacing of the finer search of a date


@dataclass(frozen=True)
class Estimate:
    """The refit's solution."""

    state: State
    covariance: Floats  # (b, b) of A..E, the terms' parameters and the nuisances

    @property
    def term_covariances(self) -> list[Floats]:
        """Covariance of each term's own parameters."""
        return [self.covariance[own, own] for own in slices(self.state.simulation.terms, 5)]


def refit(state: State, terms: Sequence[Term]) -> State:
    """Return the state with terms beside the compass, all fitted together by Gauss and Newton's steps."""
    begin = _Standing(_begun(state, terms))
    return gauss_newton.fit(begin, rounds=ROUNDS, close=CLOSE_ENOUGH, worse=WORSE).state


@dataclass(frozen=True)
class _Standing:
    """A state as a point of a fit."""

    state: State

    def step(self) -> tuple[Floats, float]:
        """Return the step of all parameters; nuisances go along, however far."""
        step, simulation = _step(self.state), self.state.simulation
        return step, float(np.max(np.abs(step[: len(simulation.parameters)]) / simulation.steps))

    def moved(self, step: Floats) -> _Standing | None:
        """Return the state a step away, None where there is no such compass."""
        state, count = self.state, len(self.state.simulation.parameters)
        simulation = state.simulation.at(state.simulation.parameters + step[:count])
        try:
            return _Standing(baseline.examine(state.case, simulation, state.nuisance + step[count:]))
        except baseline.Lost:
            return None

    def misfit(self, other: _Standing) -> float:
        """Return the middle size of another state's residual over that of this, by the widths of this."""
        return _size(other.state, self.state) / max(_size(self.state, self.state), TINY)


def _begun(state: State, terms: Sequence[Term]) -> State:
    """Return the state with terms beside the compass, smaller where there is no such compass.

    Raises:
        Lost: there is none however small they are.
    """
    for _ in range(HALVED):
        try:
            return baseline.examine(state.case, replace(state.simulation, terms=tuple(terms)), state.nuisance)
        except baseline.Lost:
            terms = [term.at(term.values / 2.0) for term in terms]
    return baseline.examine(state.case, replace(state.simulation, terms=tuple(terms)), state.nuisance)


def _size(state: State, common: State) -> float:
    """Return the middle size of a state's residual over another's widths."""
    return float(np.nanmedian(np.abs(angles.wrap180(state.residual_deg)) / common.whitener.width_deg))


def dated(state: State) -> State:
    """Return the state with the dates of its terms looked for more finely, refitted."""
    terms = list(state.simulation.terms)
    if not any(term.dated() for term in terms):
        return state
    for k, term in enumerate(terms):
        if not term.dated():
            continue
        others = [t for j, t in enumerate(terms) if j != k]
        free = refit(state, others)
        near = np.arange(term.date - NEARBY_S, term.date + NEARBY_S, FINE_S)
        tried = columns.of_dates(free, type(term), near)
        best = tried[int(np.argmax(gains(free, tried)))].term
        assert best is not None
        terms[k] = best.at(term.values)
    return refit(state, terms)


def gains(state: State, groups: Sequence[Group]) -> Floats:
    """Return what each group of columns takes off the whitened residual's square, (g,)."""
    white = state.projected(np.concatenate([group.columns for group in groups], axis=1))
    parts = np.split(white, np.cumsum([group.columns.shape[1] for group in groups])[:-1], axis=1)
    pulls = [part.T @ state.innovation for part in parts]
    return np.array([x @ whitening.inverse(part.T @ part) @ x for part, x in zip(parts, pulls, strict=True)])


def visible(state: State, k: int) -> Floats:
    """Return what of a fitted term's columns the compass and the nuisances cannot take, (n, k) degrees a unit."""
    own = state.base[:, slices(state.simulation.terms, 5)[k]]
    others = np.column_stack([state.base[:, :5], state.base[:, len(state.simulation.parameters) :]])
    weight = 1.0 / state.whitener.width_deg
    taken, *_ = np.linalg.lstsq(others * weight[:, None], own * weight[:, None], rcond=1e-9)
    return np.asarray(own - others @ taken)


def effect_deg(state: State, k: int, covariance: Floats) -> float:
    """Return the visible size of a fitted term, rms degrees, freed of what its own uncertainty adds."""
    values, seen = state.simulation.terms[k].values, visible(state, k)[np.isfinite(state.whitener.width_deg)]
    product = seen.T @ seen / len(seen)
    return float(np.sqrt(max(float(values @ product @ values) - float(np.sum(product * covariance)), 0.0)))


def gained(before: State, after: State) -> float:
    """Return the log likelihood that one hypothesis gains on another, each where it stands.

    It is followed along the straight way from one to the other, by the mean of the clipped and whitened residuals at
    its ends: squares of clipped residuals alone do not see by how much a direction far off moves. What the base of
    either could still take is no gain. A sample without a root counts in full.

    Args:
        before: the hypothesis that gives widths and filter.
    """
    whitener = before.whitener
    lost, width = ~np.isfinite(after.residual_deg), whitener.width_deg
    first, second = (whitening.clipped(np.nan_to_num(x.residual_deg), width) for x in (before, after))
    second = np.where(lost, np.minimum(robust.CLIP, 90.0 / width), second)
    moved = angles.difference(np.nan_to_num(before.residual_deg), np.nan_to_num(after.residual_deg)) / width
    ends = [_left(x, whitener, standard) for x, standard in ((before, first), (after, second))]
    way = whitener.filtered(np.where(lost, first - second, moved)[:, None])[:, 0]
    return float(sum(ends) @ way) * before.response / before.sigma**2 / 2.0


def _left(state: State, whitener: Whitener, standard: Floats) -> Floats:
    """Return a residual filtered, without what the state's base can take of it."""
    white, basis = whitener.filtered(standard[:, None])[:, 0], whitening.orthonormal(whitener(state.base))
    return np.asarray(white - basis @ (basis.T @ white))


def _step(state: State) -> Floats:
    """Return the least-squares step of all parameters from the whitened, clipped residual."""
    white = state.whitener(state.base)
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    # The residual of the state has the base taken out already: put the step back that did so.
    total = state.whitener.filtered(state.standard[:, None])[:, 0]
    unit, ridge = white / scale, state.base_ridge / scale**2
    values = np.zeros(len(scale))
    values[5 : len(state.simulation.parameters)] = state.simulation.parameters[5:]
    pull = unit.T @ total / state.response - ridge * (values + state.shift) * scale
    precision = np.diag(DAMPING + ridge)
    if state.case.prior is not None or state.case.shared:
        values[:5] = state.simulation.coefficients
        told, score = (x * (state.sigma / state.response) ** 2 for x in state.told())
        precision += told / np.outer(scale, scale)
        pull += (score - told @ (values + state.shift)) / scale
    step = np.linalg.solve(unit.T @ unit + precision, pull)
    return np.asarray(step / scale + state.shift)
