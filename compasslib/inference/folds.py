"""Whether days that were left out confirm a finding: everything is chosen anew without them.

Fifths of the recording are left out in turn. What the rest foretells of one is the probability of all over that of the
rest, every hypothesis, size, date and slow water weighed again; the gain is that of all hypotheses over those without
the effect. What lives inside one fifth cannot be learnt from the others: blocks between its own are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.term import slices
from compasslib.inference import show, weighing
from compasslib.inference.baseline import State
from compasslib.inference.inference import Inference
from compasslib.inference.show import HeldOut
from compasslib.statistics import blocks, whitening
from compasslib.types import Floats

LIKELY = 1e-4  # probability below which a hypothesis is not weighed again
MOST, MOST_WATERS = 200, 12  # hypotheses and kinds of water that are weighed again: seconds only


def proof(found: Inference, k: int) -> HeldOut:
    """Return what a term adds on days that were left out.

    Args:
        k: its place among the terms.
    """
    state, term = found.state, found.state.simulation.terms[k]
    time_s = state.case.scene.time_s
    share = (term.date - time_s[0]) / np.ptp(time_s) if term.dated() else 0.5
    lasting = 1.0 / show.FOLDS < share < 1.0 - 1.0 / show.FOLDS
    block = blocks.of_span(time_s, show.BLOCK_S)
    fold = blocks.in_time(time_s, show.FOLDS) if lasting else block % show.FOLDS
    each, rms_deg = _on_others(state, k, fold)
    anew = _chosen_anew(found, {term.name, *found.slots[k].alternatives}, fold)
    method = "fifths" if lasting else "within_event"
    return replace(show.judged(each, block, rms_deg), anew=anew, method=method)


def _chosen_anew(found: Inference, names: set[str], fold: NDArray[np.intp]) -> float:
    """Return by how much all hypotheses foretell what was left out better than those without some effects."""
    whole = found.posterior
    some = [i for i, p in enumerate(whole.probability) if p > LIKELY or not names & set(whole.names[i])]
    some = sorted({0, *sorted(some, key=lambda i: -float(whole.probability[i]))[:MOST]})
    without = np.array([not names & set(whole.names[i]) for i in some])
    hypotheses, prior = [whole.hypotheses[i] for i in some], whole.prior[some]
    waters = [whole.waters[i] for i in np.argsort(-whole.water_probability)[:MOST_WATERS]]

    def logs(kept: NDArray[np.bool_]) -> Floats:
        joint = weighing.log_joint(whole.candidates.on(kept), hypotheses, waters) + prior
        return np.array([np.logaddexp.reduce(joint.ravel()), np.logaddexp.reduce(joint[:, without].ravel())])

    everything = logs(np.ones(len(fold), dtype=bool))
    gains = [everything - logs(fold != f) for f in np.unique(fold)]
    return float(np.sum([gain[0] - gain[1] for gain in gains]))


def _on_others(state: State, k: int, fold: NDArray[np.intp]) -> tuple[Floats, tuple[float, float]]:
    """Return what a term adds to the log score of each sample, sizes fitted without its fold, and the rms around it."""
    values = np.zeros(state.base.shape[1])
    parameters = state.simulation.parameters
    values[5 : len(parameters)] = parameters[5:]
    own = np.zeros(len(values), dtype=bool)
    own[slices(state.simulation.terms, 5)[k]] = True
    white = state.whitener(state.base)
    target = state.whitener.filtered(state.standard[:, None])[:, 0] / state.response + white @ values
    total = state.residual_deg + state.base @ values
    left, rms_deg = [], []
    for kept in (~own, own | True):
        fitted = _fitted(white[:, kept], target, state.base_ridge[kept], fold)
        left.append(target - np.sum(white[:, kept] * fitted, axis=1))
        rms_deg.append(angles.rms(total - np.sum(state.base[:, kept] * fitted, axis=1)))
    each = (left[0] ** 2 - left[1] ** 2) * state.response**2 / (2.0 * state.sigma**2)
    return each, (rms_deg[0], rms_deg[1])


def _fitted(white: Floats, target: Floats, ridge: Floats, fold: NDArray[np.intp]) -> Floats:
    """Return for each sample the values of the columns fitted without its fold, (n, k)."""
    values = np.empty(white.shape)
    for f in np.unique(fold):
        out = fold == f
        some = white[~out]
        values[out] = whitening.inverse(some.T @ some + np.diag(ridge)) @ (some.T @ target[~out])
    return values
