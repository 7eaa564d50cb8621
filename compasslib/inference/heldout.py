"""Cross-validation on held-out days, with the effect selected anew without them.

For each fold that is left out, the effect, its driver, its date and its size are selected from the other folds, among
all options; compass, nuisances, slow noise, the current and the other effects are free. The gain is what the fold then
adds to the log score; the amplitude is the size of the held-out residual along the predicted turn. Surrogates are drawn
as for the detection and processed alike: records of the fitted noise with the real covariates, without the effect.
Folds of blocks of days are interleaved, so that each contains the whole range of a driver; effects that are functions
of time alone, unlike changed iron, whose turn depends on the heading, are tested on fifths of the record. Every fold is
predicted by the others and predicts them: a regression on the predictions as if they were given would have a slope of
1 - 1.25/z^2 for five equal folds whatever the noise. Slope and amplitude are therefore calibrated by records simulated
with the effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.effect import parameter_slices
from compasslib.inference import finding
from compasslib.inference.design import FittedModel
from compasslib.inference.finding import Amplitude, BinnedResidual, HeldOut, Interval, Placebo
from compasslib.inference.linear_model import LinearModel, Marginal, Products
from compasslib.inference.search import Inference
from compasslib.statistics.resampling import NORMAL_95, blocks_by_count, blocks_by_span
from compasslib.statistics.whitening import scaled_inverse
from compasslib.types import Floats

FREE = 1e5  # prior variance of coefficients of compass and nuisances, in units of one sample's noise
CLEAR_Z = 4.0  # signal-to-noise ratio of the predicted turn from which a slope is informative
TURNING_WITH_HEADING = ("field", "lobe")  # targets where the effect of a change in time depends on the heading too
RECORDS = 200  # simulated with the effect to calibrate the slope


def cross_validate(inferred: Inference, k: int, surrogates: int) -> HeldOut:
    """Score the k-th term on held-out days, and rank its gain among surrogates of the record without it."""
    model, place = inferred.model, inferred.places[k]
    time_s, option = inferred.fitted.comparison.scene.time_s, inferred.chosen[k]
    _, target, driver = model.options[option].block
    in_fifths = driver == "time" and target not in TURNING_WITH_HEADING
    block = blocks_by_span(time_s, finding.HELD_OUT_BLOCK_S)
    fold = blocks_by_count(time_s, finding.FOLDS) if in_fifths else block % finding.FOLDS
    each, rms_deg = _fold_gains(inferred.fitted, k, fold)
    # Effect, gain, amplitude, slope and placebo are selected without each fold.
    others = (*inferred.entered[:k], *inferred.entered[k + 1 :])
    record = _PartitionedRecord(model, inferred, k, [fold == f for f in np.unique(fold)])
    drawings = model.draw(place.evidence, surrogates, inferred.seed, others) if surrogates else np.zeros((len(fold), 0))
    prediction = record.predict(np.column_stack([model.residual, drawings]).astype(np.float32))
    turns = record.turns(prediction)
    size_deg = float(np.mean([angles.rms(turn) for turn in model.freed.visible(turns).T]))
    points, expected = record.bin_left_out(turns), np.ones(3)
    if prediction.predicted[0] >= CLEAR_Z**2:
        columns = model.white[:, model.products.columns(option)]
        noise = model.draw(place.evidence, RECORDS, inferred.seed + 1, others)
        again = record.predict(noise + (columns @ prediction.whole.astype(np.float32))[:, None])
        clear = again.predicted >= CLEAR_Z**2  # no slope would be reported for the others
        if np.count_nonzero(clear) >= RECORDS / 2:
            expected = np.quantile(again.followed[clear] / again.predicted[clear], [0.5, 0.025, 0.975])
            turned = points.centre * float(expected[0])
            points = replace(points, centre=turned, after_deg=points.before_deg - turned)
    predicted, gain = max(float(prediction.predicted[0]), 1e-12), prediction.gain
    slope, spread = float(prediction.followed[0]) / predicted, NORMAL_95 * float(np.sqrt(predicted))
    low, high = (slope + side * spread / predicted for side in (-1.0, 1.0))
    middle, least, most = expected.tolist()
    calibrated = slope / middle - (most - middle) / middle, slope / middle + (middle - least) / middle
    chance = (1 + int(np.sum(gain[1:] >= gain[0]))) / (1 + surrogates) if surrogates else None
    return replace(
        finding.bootstrap_gain(each, block, rms_deg),
        method="fifths" if in_fifths else "interleaved",
        anew=Interval(float(gain[0]), float(gain[0]) - spread, float(gain[0]) + spread),
        amplitude=Amplitude(size_deg * middle, size_deg * slope, size_deg * low, size_deg * high),
        slope=Interval(slope / middle, *calibrated) if most > least else None,
        placebo=Placebo(surrogates, chance),
        points=points,
    )


@dataclass(frozen=True)
class _Prediction:
    """Agreement of held-out days with the prediction from the others, summed over folds; r targets."""

    gain: Floats  # (r,) in log score
    predicted: Floats  # (r,) sum of squares of the predicted turn, in units of the noise
    followed: Floats  # (r,) product of the predicted turn and the held-out residual, in units of the noise
    chosen: Sequence[int]  # option selected for the first target without each fold
    values: Sequence[Floats]  # its coefficients
    whole: Floats  # (k,) coefficients of the chosen option on all days


@dataclass(frozen=True)
class _PartitionedRecord:
    """A record in folds, each predicted from the others with the noise marginalized."""

    model: LinearModel
    inferred: Inference
    place: int  # number of the term that is tested
    folds: Sequence[NDArray[np.bool_]]

    @cached_property
    def rows(self) -> Floats:
        """Whitened columns of options, slow noise, compass and nuisances, (n, m) float32."""
        return np.concatenate([self.model.white, self.model.freed.basis], axis=1, dtype=np.float32)

    @cached_property
    def squares(self) -> list[Floats]:
        """Products of the columns over each fold."""
        return [(self.rows[inside].T @ self.rows[inside]).astype(float) for inside in self.folds]

    @property
    def variance(self) -> Floats:
        """Prior variance of the coefficients of noise."""
        slow_noise = self.inferred.places[self.place].evidence.likeliest_noise(self.inferred.chosen[self.place])
        return np.append(self.model.slow.variances(slow_noise), np.full(self.model.freed.basis.shape[1], FREE))

    def _marginal(self, information: Floats, score: Floats) -> Marginal:
        others = [each for j, each in enumerate(self.inferred.entered) if j != self.place]
        return replace(self.model.products, information=information, score=score).marginalize(self.variance, others)

    def predict(self, targets: Floats) -> _Prediction:
        """Predict each fold of whitened residuals, (n, r) float32, from the others."""
        pulls = [(self.rows[inside].T @ targets[inside]).astype(float) for inside in self.folds]
        total, pull = np.sum(self.squares, axis=0), np.sum(pulls, axis=0)
        whole, shares = self._marginal(total, pull), np.array([option.share for option in self.model.options])
        term = self.inferred.chosen[self.place]
        shares[[k for k in self.inferred.chosen if k != term]] = -np.inf
        gain, predicted, followed = np.zeros((3, targets.shape[1]))
        chosen, values = [], []
        size = self.inferred.entered[self.place][1]
        for square, held_out in zip(self.squares, pulls, strict=True):
            training = self._marginal(total - square, pull - held_out)
            evidence = training.evidence
            best = np.argmax(evidence + shares[:, None], axis=0)
            gain += (whole.evidence - evidence)[best, np.arange(len(best))]
            for k in np.unique(best):
                at, r = self.model.products.columns(k), np.flatnonzero(best == k)
                (inside, score), (trained, before) = whole.left(at), training.left(at)
                coefficients = size * np.linalg.solve(np.eye(len(at)) + size**2 * trained, size * before[:, r])
                predicted[r] += np.maximum(np.sum(coefficients * ((inside - trained) @ coefficients), axis=0), 0.0)
                followed[r] += np.sum(coefficients * (score - before)[:, r], axis=0)
                if r[0] == 0:
                    chosen.append(int(k))
                    values.append(coefficients[:, 0])
        return _Prediction(gain, predicted, followed, chosen, values, whole.fit([(term, size)])[:, 0])

    def turns(self, prediction: _Prediction) -> Floats:
        """Compute the turn that is predicted without each fold, (n, f) degrees."""
        each = zip(prediction.chosen, prediction.values, strict=True)
        return np.stack([self.model.options[k].columns @ values for k, values in each], axis=1)

    def bin_left_out(self, turns: Floats) -> BinnedResidual:
        """Bin held-out days by the turn predicted from the others, and estimate the observed turn in each bin.

        Bins are estimated with the covariance of the noise: the slope through them is that of all held-out days.
        """
        freed = self.model.freed
        part, known = np.argmax(self.folds, axis=0), np.isfinite(freed.whitener.width_deg)
        visible = np.zeros(turns.shape)
        visible[known] = freed.visible(turns)
        left_out = visible[np.arange(len(part)), part]
        below, above = left_out[known & (left_out < 0)], left_out[known & (left_out > 0)]
        quarters = [np.quantile(x, [0.25, 0.5, 0.75]) if len(x) else x for x in (below, above)]
        edges = np.concatenate([quarters[0], [0.0], quarters[1]])
        information, score = np.zeros((len(edges) + 1,) * 2), np.zeros(len(edges) + 1)
        unit = np.float32(freed.response / freed.sigma / np.sqrt(self.model.scatter))
        noise, at = self.rows[:, self.model.products.ends[-1] :], np.arange(len(score))
        ends, size = np.array([0, len(score)]), np.ones((1, 1))
        for f, inside in enumerate(self.folds):
            here = np.searchsorted(edges, visible[:, f])
            bins = (turns[:, [f]] * (here[:, None] == np.arange(len(score)))).astype(np.float32)
            rows = np.concatenate([freed.whiten_and_project(bins) * unit, noise], axis=1)
            both = []
            for days in (slice(None), ~inside):
                square, pull = rows[days].T @ rows[days], rows[days].T @ self.model.residual[days, None]
                products = Products(square.astype(float), pull.astype(float), ends, size)
                both.append(products.marginalize(self.variance).left(at))
            information += both[0][0] - both[1][0]
            score += (both[0][1] - both[1][1])[:, 0]
        inverse = np.linalg.pinv(information, hermitian=True)
        weight = np.where(known, freed.whitener.width_deg, np.inf) ** -2.0
        here = np.searchsorted(edges, left_out)
        filled = np.bincount(here[known], minlength=len(score)) >= finding.FEWEST_IN_BIN
        total = np.maximum(np.bincount(here, weight, len(score)), 1e-300)
        middle = np.bincount(here, weight * left_out, len(score)) / total
        shown, sigma = middle * (inverse @ score), np.abs(middle) * np.sqrt(np.maximum(np.diag(inverse), 0.0))
        middle, shown, sigma = middle[filled], shown[filled], sigma[filled]
        return BinnedResidual("", middle, shown, shown - middle, sigma)


def _fold_gains(fitted: FittedModel, k: int, fold: NDArray[np.intp]) -> tuple[Floats, tuple[float, float]]:
    """Compute the gain of a term at each sample, sizes fitted without its fold, and the rms without and with it."""
    values = np.zeros(fitted.base.shape[1])
    parameters = fitted.simulation.parameters
    values[5 : len(parameters)] = parameters[5:]
    term_columns = np.zeros(len(values), dtype=bool)
    term_columns[parameter_slices(fitted.simulation.terms, 5)[k]] = True
    white = fitted.whitener(fitted.base)
    target = fitted.whitener.filtered(fitted.standard[:, None])[:, 0] / fitted.response + white @ values
    total = fitted.residual_deg + fitted.base @ values
    left, rms_deg = [], []
    for columns in (~term_columns, term_columns | True):
        coefficients, training = np.empty(white[:, columns].shape), white[:, columns]
        for f in np.unique(fold):
            inside = training[fold != f]
            inverse = scaled_inverse(inside.T @ inside + np.diag(fitted.base_ridge[columns]))
            coefficients[fold == f] = inverse @ (inside.T @ target[fold != f])
        left.append(target - np.sum(white[:, columns] * coefficients, axis=1))
        rms_deg.append(angles.rms(total - np.sum(fitted.base[:, columns] * coefficients, axis=1)))
    each = (left[0] ** 2 - left[1] ** 2) * fitted.response**2 / (2.0 * fitted.sigma**2)
    return each, (rms_deg[0], rms_deg[1])
