"""Cross-validation on held-out days, with the effect selected anew without them.

For each fold that is left out, the effect, its driver, its date and its sizes are selected from the other folds, among
all compositions; compass, nuisances, slow noise and the current are free. The gain is what the fold then adds to the
log score; the amplitude is the size of the held-out residual along the predicted turn. Surrogates are draws of the
fitted noise with the real covariates, processed alike; the rank of the gain among theirs measures its significance.
Every fold is predicted by the others and predicts them: a regression on the predictions as if they were given would
have a slope of 1 - 1.25/z^2 for five equal folds whatever the noise, and an interval that always covers 1. Both are
therefore calibrated by records simulated with the effect. (Slow noise alone, searched for a step, has an amplitude
above 0 in 23 to 85 % of such intervals; the best of 300 columns selected from all days in 93 %.)
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky

from compasslib import angles
from compasslib.effects import COMPOSED
from compasslib.effects.effect import parameter_slices
from compasslib.inference import design, evidence, finding, grammar, posterior
from compasslib.inference.design import ColumnGroup, FittedModel
from compasslib.inference.evidence import ANYTHING, TEMPERATURE
from compasslib.inference.finding import Amplitude, BinnedResidual, HeldOut, Interval, Placebo
from compasslib.inference.weighing import Inference
from compasslib.statistics.resampling import NORMAL_95, blocks_by_count, blocks_by_span
from compasslib.statistics.whitening import scaled_inverse
from compasslib.types import Floats

MOST_CHOICES = 2  # compositions admitted per fold and record, limited for speed
SEED = 11  # of the surrogates
CLEAR_Z = 4.0  # signal-to-noise ratio of the predicted turn from which a slope is informative
RECORDS = 200  # simulated with the effect to calibrate the slope
FEWEST_IN_BIN = 10  # samples of a bin that is plotted


def cross_validate(inferred: Inference, k: int, without: FittedModel, surrogates: int) -> HeldOut:
    """Score a term on held-out days, and rank its gain among surrogates of the record without it.

    Args:
        without: the same recording, refitted without the term.
        surrogates: number of surrogates, may be 0.
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
    scored = refit_folds(inferred, without, fold, surrogates if in_water else 0)
    if not in_water:  # no surrogates are needed without slow noise and without compositions
        scored["placebo"] = None
    return replace(finding.bootstrap_gain(each, block, rms_deg), method=method, **scored)


@dataclass(frozen=True)
class _Alternatives:
    """Candidates in the place of a term: their columns and their log shares of the prior odds."""

    groups: list[ColumnGroup]
    usual: list[Floats]
    log_share: Floats  # (g,)
    allowed: Floats  # (g, f, r) 0 if the candidate is admitted for a fold of a target, else minus infinity

    @cached_property
    def parts(self) -> list[NDArray[np.intp]]:
        """Column indices of each candidate."""
        ends = np.cumsum([0, *(len(usual) for usual in self.usual)])
        return [np.arange(a, b) for a, b in itertools.pairwise(ends)]

    def choose(self, products: _Marginal, fold: int | slice) -> NDArray[np.intp]:
        """Select the most probable candidate for each target, among those admitted for any of the folds, (r,)."""
        allowed = self.allowed[:, fold].reshape(len(self.groups), -1, self.allowed.shape[2]).max(axis=1)
        return np.argmax(_log_evidence(products, self.parts) + self.log_share[:, None] + allowed, axis=0)


class _Marginal(NamedTuple):
    """Products of the candidates' columns with the noise marginalized, and of all columns before that."""

    information: Floats  # (p, p)
    score: Floats  # (p, r)
    square: Floats  # (p + q, p + q) of all columns
    pull: Floats  # (p + q, r) of all columns with the targets

    def without(self, square: Floats, pull: Floats, variance: Floats) -> _Marginal:
        """Leave out some days, given the products of all columns over these days."""
        return _marginalize(self.square - square, self.pull - pull, len(self.information), variance)

    def nonnegative(self, parts: Sequence[NDArray[np.intp]]) -> _Marginal:
        """Replace information matrices that are not positive definite with the prior by the nearest semidefinite ones.

        Where the noise absorbs the columns of a candidate, rounding in single precision leaves negative eigenvalues.
        """
        information = self.information.copy()
        for at in parts:
            values, vectors = np.linalg.eigh(information[np.ix_(at, at)])
            if values[0] <= -1.0:  # the prior adds 1
                information[np.ix_(at, at)] = vectors * np.maximum(values, 0.0) @ vectors.T
        return self._replace(information=information)

    def fit(self, at: NDArray[np.intp], r: NDArray[np.intp]) -> Floats:
        """Compute the posterior mean of a candidate's parameters for some targets, (k, r)."""
        return np.linalg.solve(self.information[np.ix_(at, at)] + np.eye(len(at)), self.score[np.ix_(at, r)])


@dataclass(frozen=True)
class _Prediction:
    """Agreement of held-out days with the prediction from the others, summed over folds; r targets."""

    gain: Floats  # (r,) in log score
    predicted: Floats  # (r,) sum of squares of the predicted turn, in units of the noise
    followed: Floats  # (r,) product of the predicted turn and the held-out residual, in units of the noise
    values: Floats  # (f, p) parameters fitted to the first target without each fold
    chosen: Floats  # (p,) parameters fitted to the first target on all days


@dataclass(frozen=True)
class _PartitionedRecord:
    """A record in folds, each predicted from the others with the noise marginalized."""

    quiet: FittedModel  # whose whitener does not contain slow noise
    unit: float  # factor that scales whitened columns to noise of unit variance
    noise: Floats  # (n, q) whitened columns of slow noise, the current, compass and nuisances
    variance: Floats  # (q,) prior variance of their coefficients
    folds: list[NDArray[np.bool_]]

    @property
    def measured(self) -> NDArray[np.bool_]:
        return np.isfinite(self.quiet.whitener.width_deg)

    def draw(self, seed: int, count: int) -> Floats:
        """Draw whitened residuals from the fitted noise: white noise, slow noise and the current, (n, count)."""
        rng, own = np.random.default_rng(seed), slice(0, self.noise.shape[1] - self.quiet.basis.shape[1])
        white = rng.normal(size=(len(self.noise), count))
        deviations = self.noise[:, own] * np.sqrt(self.variance[own])
        return white + deviations @ rng.normal(size=(deviations.shape[1], count))

    def project(self, whitened: Floats) -> Floats:
        """Project compass and nuisances out, (n, r)."""
        return np.where(self.measured[:, None], self.quiet.project_out_nuisance(whitened), 0.0)

    def whiten(self, columns: Floats) -> Floats:
        """Whiten columns in degrees, (n, k) float32."""
        return self.quiet.whitener(columns.astype(np.float32)) * np.float32(self.unit)

    def predict(self, white: Floats, targets: Floats, choices: _Alternatives) -> _Prediction:
        """Predict each fold from the others.

        Args:
            white: whitened columns of the candidates, (n, p).
            targets: whitened residuals, (n, r).
        """
        rows = np.concatenate([white, self.noise], axis=1, dtype=np.float32)
        squares = [(rows[inside].T @ rows[inside]).astype(float) for inside in self.folds]
        pulls = [(rows[inside].T @ targets[inside]).astype(float) for inside in self.folds]
        whole = _marginalize(np.sum(squares, axis=0), np.sum(pulls, axis=0), white.shape[1], self.variance)
        whole = whole.nonnegative(choices.parts)
        gain, predicted, followed = np.zeros((3, targets.shape[1]))
        values, chosen = np.zeros((len(squares), white.shape[1])), np.zeros(white.shape[1])
        for f, (square, pull) in enumerate(zip(squares, pulls, strict=True)):
            training = whole.without(square, pull, self.variance).nonnegative(choices.parts)
            best = choices.choose(training, f)
            for g in np.unique(best):
                at, r = choices.parts[g], np.flatnonzero(best == g)
                fitted = training.fit(at, r)
                added = (whole.information - training.information)[np.ix_(at, at)]
                gain[r] += _log_of(whole, at, r) - _log_of(training, at, r)
                predicted[r] += np.maximum(np.sum(fitted * (added @ fitted), axis=0), 0.0)
                followed[r] += np.sum(fitted * (whole.score - training.score)[np.ix_(at, r)], axis=0)
                if r[0] == 0:
                    values[f, at] = fitted[:, 0]
        at = choices.parts[choices.choose(whole, slice(None))[0]]
        chosen[at] = whole.fit(at, np.arange(1))[:, 0]
        return _Prediction(gain, predicted, followed, values, chosen)

    def bin_left_out(self, turns: Floats, residual: Floats) -> BinnedResidual:
        """Bin held-out days by the turn predicted from the others, and estimate the observed turn in each bin.

        Bins are estimated with the covariance of the noise: the slope through them is that of all held-out days.

        Args:
            turns: predicted without each fold, (n, f) degrees.
            residual: whitened, (n, 1).
        """
        part, known = np.argmax(self.folds, axis=0), self.measured
        seen = np.zeros(turns.shape)
        seen[known] = self.quiet.visible(turns)
        left_out = seen[np.arange(len(part)), part]
        edges = np.concatenate(
            [_quarters(left_out[known & (left_out < 0)]), [0.0], _quarters(left_out[known & (left_out > 0)])]
        )
        information, score = np.zeros((len(edges) + 1,) * 2), np.zeros(len(edges) + 1)
        for f, inside in enumerate(self.folds):
            here = np.searchsorted(edges, seen[:, f])
            white = self.whiten(turns[:, [f]] * (here[:, None] == np.arange(len(score))))
            rows = np.concatenate([white, self.noise], axis=1, dtype=np.float32)
            whole = _marginalize((rows.T @ rows).astype(float), rows.T @ residual, len(score), self.variance)
            left = rows[inside]
            training = whole.without((left.T @ left).astype(float), left.T @ residual[inside], self.variance)
            information += whole.information - training.information
            score += (whole.score - training.score)[:, 0]
        inverse = np.linalg.pinv(information, hermitian=True)
        weight = np.where(known, self.quiet.whitener.width_deg, np.inf) ** -2.0
        here = np.searchsorted(edges, left_out)
        filled = np.bincount(here[known], minlength=len(score)) >= FEWEST_IN_BIN
        total = np.maximum(np.bincount(here, weight, len(score)), 1e-300)
        middle = np.bincount(here, weight * left_out, len(score)) / total
        shown, sigma = middle * (inverse @ score), np.abs(middle) * np.sqrt(np.maximum(np.diag(inverse), 0.0))
        middle, shown, sigma = middle[filled], shown[filled], sigma[filled]
        return BinnedResidual("", middle, shown, shown - middle, sigma)


def _quarters(values: Floats) -> Floats:
    return np.quantile(values, [0.25, 0.5, 0.75]) if len(values) else np.zeros(0)


def refit_folds(inferred: Inference, without: FittedModel, fold: NDArray[np.intp], surrogates: int) -> dict[str, Any]:
    """Select, fit and score an effect in the place of a term, for each fold and each surrogate."""
    candidates, slow = inferred.posterior.candidates, inferred.slow
    quiet = design.evaluate_model(replace(without.case, low_rank=None), without.simulation, without.nuisance)
    unit = quiet.response / quiet.sigma / float(np.sqrt(candidates.scatter))
    waves = np.zeros((len(fold), 0)) if slow is None else quiet.whitener(slow.columns.astype(np.float32)) * unit
    variance = evidence.noise_variances(slow, inferred.posterior.water_of(inferred.chosen))
    record = _PartitionedRecord(
        quiet,
        unit,
        np.concatenate([waves, quiet.basis], axis=1),
        np.append(variance, np.full(quiet.basis.shape[1], ANYTHING)),
        [fold == f for f in np.unique(fold)],
    )
    residual = quiet.innovation[:, None] / quiet.response * unit
    targets = record.project(np.column_stack([residual, record.draw(SEED, surrogates)]))
    low_rank, loud = without.case.low_rank, targets.astype(np.float32)
    loud = loud if low_rank is None else low_rank.whiten(loud)
    choices = _alternatives(inferred, without, loud * np.sqrt(candidates.scatter), fold)
    scaled = [group.columns * usual for group, usual in zip(choices.groups, choices.usual, strict=True)]
    columns = np.concatenate(scaled, axis=1, dtype=np.float32)
    white = record.whiten(columns)
    result = record.predict(white, targets, choices)
    turns = columns @ result.values.T
    size_deg = float(np.mean([angles.rms(turn) for turn in quiet.visible(turns).T]))
    points, expected = record.bin_left_out(turns, targets[:, :1]), np.ones(3)
    if result.predicted[0] >= CLEAR_Z**2:
        present = record.project((white @ result.chosen)[:, None] + record.draw(SEED + 1, RECORDS))
        again = record.predict(white, present.astype(np.float32), replace(choices, allowed=choices.allowed[:, :, :1]))
        clear = again.predicted >= CLEAR_Z**2  # no slope would be reported for the others
        if np.count_nonzero(clear) >= RECORDS / 2:
            expected = np.quantile(again.followed[clear] / again.predicted[clear], [0.5, 0.025, 0.975])
            points = points.times(float(expected[0]))
    return _describe_gain(result, size_deg, expected, surrogates) | {"points": points}


def _describe_gain(result: _Prediction, size_deg: float, expected: Floats, surrogates: int) -> dict[str, Any]:
    """Describe gain, amplitude, slope and placebo; intervals are widened by the temperature of the evidence.

    Args:
        expected: slope in records simulated with the effect, median and 95 % range.
    """
    predicted, gain = max(float(result.predicted[0]), 1e-12), result.gain
    slope, spread = float(result.followed[0]) / predicted, NORMAL_95 * float(np.sqrt(predicted / TEMPERATURE))
    low, high = (slope + side * spread / predicted for side in (-1.0, 1.0))
    middle, least, most = expected.tolist()
    below, above = (abs(edge - middle) / middle / float(np.sqrt(TEMPERATURE)) for edge in (most, least))
    given = Interval(slope / middle, slope / middle - below, slope / middle + above)
    chance = (1 + int(np.sum(gain[1:] >= gain[0]))) / (1 + surrogates) if surrogates else None
    return {
        "anew": Interval(float(gain[0]), float(gain[0]) - spread, float(gain[0]) + spread),
        "amplitude": Amplitude(size_deg * middle, size_deg * slope, size_deg * low, size_deg * high),
        "slope": given if most > least else None,
        "placebo": Placebo(surrogates, chance),
    }


def _alternatives(inferred: Inference, without: FittedModel, loud: Floats, fold: NDArray[np.intp]) -> _Alternatives:
    """Collect the candidates of the catalogue, and the compositions screened for each fold and surrogate."""
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


def _marginalize(square: Floats, pull: Floats, n: int, variance: Floats) -> _Marginal:
    """Marginalize the coefficients of the noise columns in the products for several targets."""
    root = np.sqrt(variance)
    lower = cholesky(np.eye(len(root)) + root[:, None] * square[n:, n:] * root, lower=True)
    cross = root[:, None] * square[n:, :n]
    taken = cho_solve((lower, True), np.column_stack([cross, root[:, None] * pull[n:]]))
    return _Marginal(square[:n, :n] - cross.T @ taken[:, :n], pull[:n] - cross.T @ taken[:, n:], square, pull)


def _log_of(products: _Marginal, at: NDArray[np.intp], r: NDArray[np.intp]) -> Floats:
    lower = np.linalg.cholesky(products.information[np.ix_(at, at)] + np.eye(len(at)))
    half = np.linalg.solve(lower, products.score[np.ix_(at, r)])
    return np.asarray(0.5 * np.sum(half**2, axis=0) - np.sum(np.log(np.diag(lower))))


def _log_evidence(products: _Marginal, parts: Sequence[NDArray[np.intp]]) -> Floats:
    """Compute the tempered log evidence of each candidate alone for each target, (g, r)."""
    result = np.zeros((len(parts), products.score.shape[1]))
    count = np.array([len(part) for part in parts])
    for size in np.unique(count):
        equal = np.flatnonzero(count == size)
        index = np.array([parts[int(k)] for k in equal])
        lower = np.linalg.cholesky(products.information[index[:, :, None], index[:, None, :]] + np.eye(size))
        half = np.linalg.solve(lower, products.score[index])
        result[equal] = 0.5 * np.sum(half**2, axis=1) - np.log(np.einsum("gkk->gk", lower)).sum(axis=1)[:, None]
    return TEMPERATURE * result


def _fold_gains(state: FittedModel, k: int, fold: NDArray[np.intp]) -> tuple[Floats, tuple[float, float]]:
    """Compute the gain of a term at each sample, sizes fitted without its fold, and the rms without and with it."""
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
