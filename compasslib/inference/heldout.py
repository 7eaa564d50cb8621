"""Held-out days: whether what was learnt elsewhere predicts what was left out, with everything chosen anew.

For each part that is left out the effect, its driver, its date and its sizes are chosen from the other parts, all
compositions included; compass, nuisances, slow water and the current are free beside it. What the part then adds to
the log score is the gain; the amplitude is that of the left-out days along the predicted turn. Surrogates are records
of the fitted noise beside the real covariates, through all of the same: the rank of the gain among theirs is what
chance does. (Slow water alone, searched for a step, has an amplitude above 0 in 23 to 85 % of such intervals; the best
of 300 columns chosen from all days in 93 %.)
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from compasslib import angles
from compasslib.effects import COMPOSED
from compasslib.effects.effect import parameter_slices
from compasslib.inference import design, evidence, finding, grammar, posterior
from compasslib.inference.design import ColumnGroup, FittedModel
from compasslib.inference.evidence import ANYTHING, TEMPERATURE
from compasslib.inference.finding import Amplitude, HeldOut, Interval, Placebo
from compasslib.inference.weighing import Inference
from compasslib.statistics.resampling import NORMAL_95, blocks_by_count, blocks_by_span
from compasslib.statistics.whitening import scaled_inverse
from compasslib.types import Floats

MOST_CHOICES = 2  # compositions that each choice may take: seconds
SEED = 11  # of the surrogates
CLEAR_Z = 4.0  # fitted amplitude over its standard error from which a slope says anything of size and form


def cross_validate(inferred: Inference, k: int, without: FittedModel, surrogates: int) -> HeldOut:
    """Score a term on days that were left out, and against surrogates of the record without it.

    Args:
        without: the same recording, refitted without the term.
        surrogates: how many; none where 0.
    """
    state, term = inferred.state, inferred.state.simulation.terms[k]
    time_s = state.case.scene.time_s
    share = (term.date - time_s[0]) / np.ptp(time_s) if term.dated() else 0.5
    lasting = 1.0 / finding.FOLDS < share < 1.0 - 1.0 / finding.FOLDS
    block = blocks_by_span(time_s, finding.HELD_OUT_BLOCK_S)
    fold = blocks_by_count(time_s, finding.FOLDS) if lasting else block % finding.FOLDS
    each, rms_deg = _fold_gains(state, k, fold)
    method = "fifths" if lasting else "within_event"
    in_water = state.case.has_slow_noise
    scored = _refit_folds(inferred, without, fold, surrogates if in_water else 0)
    if not in_water:  # neither water nor a search of thousands can feign it
        scored["placebo"] = None
    return replace(finding.bootstrap_gain(each, block, rms_deg), method=method, **scored)


@dataclass(frozen=True)
class _Alternatives:
    """What may stand in a place: columns of each candidate and its log share of the odds."""

    groups: list[ColumnGroup]
    usual: list[Floats]
    log_share: Floats  # (g,)
    allowed: Floats  # (g, f, r) 0 where a fold of a target may choose it, else minus infinity


def _refit_folds(inferred: Inference, without: FittedModel, fold: NDArray[np.intp], surrogates: int) -> dict[str, Any]:
    """Choose, fit and score what stands in the place of a term, for each fold and each surrogate."""
    candidates, slow = inferred.posterior.candidates, inferred.slow
    quiet = design.evaluate_model(replace(without.case, low_rank=None), without.simulation, without.nuisance)
    unit = quiet.response / quiet.sigma / np.sqrt(candidates.scatter)
    waves = np.zeros((len(fold), 0)) if slow is None else quiet.whitener(slow.columns.astype(np.float32)) * unit
    variance = evidence.noise_variances(slow, inferred.posterior.water_of(inferred.chosen))
    # The whitened residual and surrogates of it: white noise, slow water and the current redrawn, (n, 1 + r).
    rng, deviations = np.random.default_rng(SEED), waves * np.sqrt(variance)
    measured = np.isfinite(quiet.whitener.width_deg)[:, None]
    surrogate = rng.normal(size=(len(measured), surrogates))
    surrogate = surrogate + deviations @ rng.normal(size=(deviations.shape[1], surrogates))
    residual = quiet.innovation[:, None] / quiet.response * unit
    targets = np.where(measured, quiet.project_out_nuisance(np.column_stack([residual, surrogate])), 0.0)
    low_rank, loud = without.case.low_rank, targets.astype(np.float32)
    loud = loud if low_rank is None else low_rank.whiten(loud)
    choices = _alternatives(inferred, without, loud * np.sqrt(candidates.scatter), fold)
    columns = [group.columns * usual for group, usual in zip(choices.groups, choices.usual, strict=True)]
    white = quiet.whitener(np.concatenate(columns, axis=1, dtype=np.float32)) * np.float32(unit)
    rows = np.concatenate([white, waves, quiet.basis], axis=1, dtype=np.float32)
    variance = np.append(variance, np.full(quiet.basis.shape[1], ANYTHING))
    ends = np.cumsum([0, *(column.shape[1] for column in columns)])
    parts = [np.arange(a, b) for a, b in itertools.pairwise(ends)]
    folds = [fold == f for f in np.unique(fold)]
    squares = [(rows[inside].T @ rows[inside]).astype(float) for inside in folds]
    scores = [(rows[inside].T @ targets[inside]).astype(float) for inside in folds]
    whole = _marginal(sum(squares), sum(scores), ends[-1], variance)
    gain, predicted, followed, size_deg = np.zeros(targets.shape[1]), 0.0, 0.0, 0.0
    for f, (square, score) in enumerate(zip(squares, scores, strict=True)):
        training = _marginal(whole[2] - square, whole[3] - score, ends[-1], variance)
        best = np.argmax(_log_evidence(training, parts) + choices.log_share[:, None] + choices.allowed[:, f], axis=0)
        for r, g in enumerate(best):
            at = parts[g]
            known, all_known = training[0][np.ix_(at, at)], whole[0][np.ix_(at, at)]
            values = np.linalg.solve(known + np.eye(len(at)), training[1][at, r])
            gain[r] += _log_of(whole, at, r) - _log_of(training, at, r)
            if r == 0:
                predicted += max(float(values @ (all_known - known) @ values), 0.0)
                followed += float(values @ (whole[1][at, r] - training[1][at, r]))
                size_deg += angles.rms(quiet.visible(columns[g]) @ values) / len(folds)
    return _describe_gain(gain, predicted, followed, size_deg, surrogates)


def _describe_gain(gain: Floats, predicted: float, followed: float, size_deg: float, surrogates: int) -> dict[str, Any]:
    """Describe gain, amplitude, slope and placebo; the noise is as much wider as evidence is tempered."""
    spread = NORMAL_95 * float(np.sqrt(predicted / TEMPERATURE))
    slope = followed / max(predicted, 1e-12)
    wide = spread / max(predicted, 1e-12)
    z = float(np.sqrt(predicted * TEMPERATURE))
    interval = Interval(slope, slope - wide, slope + wide)
    chance = (1 + int(np.sum(gain[1:] >= gain[0]))) / (1 + surrogates) if surrogates else None
    return {
        "anew": Interval(float(gain[0]), float(gain[0]) - spread, float(gain[0]) + spread),
        "amplitude": Amplitude(size_deg, size_deg * slope, size_deg * interval.low, size_deg * interval.high),
        "slope": interval if z >= CLEAR_Z else None,
        "placebo": Placebo(surrogates, chance),
    }


def _alternatives(inferred: Inference, without: FittedModel, loud: Floats, fold: NDArray[np.intp]) -> _Alternatives:
    """Collect the listed candidates, and the compositions that each fold and surrogate would take."""
    candidates = inferred.posterior.candidates
    others = {type(term) for term in without.simulation.terms}
    names = posterior.log_shares(candidates.kinds)
    listed = [
        k
        for k, group in enumerate(candidates.groups)
        if not group.name.startswith(COMPOSED) and type(group.term) not in others
    ]
    groups = [candidates.groups[k] for k in listed]
    usual = [candidates.usual[candidates.parts[k]] for k in listed]
    shares = [names[k] + candidates.shares[k] for k in listed]
    screened = grammar.screen_folds(without, loud, fold, MOST_CHOICES)
    half = design.midpoint_linearization(inferred.state)
    numbers: dict[Any, int] = {}
    for composition in (composition for each in screened.values() for composition in each):
        if composition.term not in numbers and type(composition.term) not in others:
            numbers[composition.term] = len(groups)
            groups.append(design.term_columns(half, composition.term))
            usual.append(composition.usual)
            shares.append(float(np.log(posterior.UNLISTED)) + composition.log_share)
    allowed = np.zeros((len(groups), len(np.unique(fold)), loud.shape[1]))
    allowed[len(listed) :] = -np.inf
    for (f, r), each in screened.items():
        for composition in each:
            if composition.term in numbers:
                allowed[numbers[composition.term], f, r] = 0.0
    return _Alternatives(groups, usual, np.array(shares), allowed)


def _marginal(square: Floats, score: Floats, n: int, variance: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Integrate noise columns out of products for several targets; the products themselves come with them."""
    root = np.sqrt(variance)
    lower = cholesky(np.eye(len(root)) + root[:, None] * square[n:, n:] * root, lower=True)
    cross = root[:, None] * square[n:, :n]
    taken = cho_solve((lower, True), np.column_stack([cross, root[:, None] * score[n:]]))
    return square[:n, :n] - cross.T @ taken[:, :n], score[:n] - cross.T @ taken[:, n:], square, score


def _log_of(products: Sequence[Floats], at: NDArray[np.intp], r: int) -> float:
    lower = np.linalg.cholesky(products[0][np.ix_(at, at)] + np.eye(len(at)))
    half = np.linalg.solve(lower, products[1][at, r])
    return float(0.5 * half @ half - np.sum(np.log(np.diag(lower))))


def _log_evidence(products: Sequence[Floats], parts: Sequence[NDArray[np.intp]]) -> Floats:
    """Compute the tempered log evidence of each candidate alone for each target, (g, r)."""
    result = np.zeros((len(parts), products[1].shape[1]))
    count = np.array([len(part) for part in parts])
    for size in np.unique(count):
        equal = np.flatnonzero(count == size)
        index = np.array([parts[int(k)] for k in equal])
        lower = np.linalg.cholesky(products[0][index[:, :, None], index[:, None, :]] + np.eye(size))
        half = np.linalg.solve(lower, products[1][index])
        result[equal] = 0.5 * np.sum(half**2, axis=1) - np.log(np.einsum("gkk->gk", lower)).sum(axis=1)[:, None]
    return TEMPERATURE * result


def _fold_gains(state: FittedModel, k: int, fold: NDArray[np.intp]) -> tuple[Floats, tuple[float, float]]:
    """Score a term for each sample, sizes fitted without its fold, and give the rms with and without it."""
    values = np.zeros(state.base.shape[1])
    parameters = state.simulation.parameters
    values[5 : len(parameters)] = parameters[5:]
    term_columns = np.zeros(len(values), dtype=bool)
    term_columns[parameter_slices(state.simulation.terms, 5)[k]] = True
    white = state.whitener(state.base)
    target = state.whitener.filtered(state.standard[:, None])[:, 0] / state.response + white @ values
    total = state.residual_deg + state.base @ values
    left, rms_deg = [], []
    for columns in (~term_columns, term_columns | True):
        fitted, training = np.empty(white[:, columns].shape), white[:, columns]
        for f in np.unique(fold):
            inside = training[fold != f]
            inverse = scaled_inverse(inside.T @ inside + np.diag(state.base_ridge[columns]))
            fitted[fold == f] = inverse @ (inside.T @ target[fold != f])
        left.append(target - np.sum(white[:, columns] * fitted, axis=1))
        rms_deg.append(angles.rms(total - np.sum(state.base[:, columns] * fitted, axis=1)))
    each = (left[0] ** 2 - left[1] ** 2) * state.response**2 / (2.0 * state.sigma**2)
    return each, (rms_deg[0], rms_deg[1])
