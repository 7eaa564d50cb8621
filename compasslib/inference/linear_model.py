"""Linear Gaussian model of a recording: all options beside slow noise, their evidence, and surrogates.

    y = base b + slow noise c + options w + white noise,   w ~ N(0, a^2) in units of each option, c ~ N(0, variances)

Products of the whitened columns with each other and with the residual are sufficient for every hypothesis (Bishop,
Pattern Recognition and Machine Learning, 2006, section 3.5). Amplitudes a and parameters of slow noise are marginalized
over grids. Surrogates are further residuals, drawn from the noise: only their products with the columns are needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from compasslib.inference import design
from compasslib.inference.blocks import Option, enumerate_options
from compasslib.inference.current import CurrentPosterior, infer_current
from compasslib.inference.design import FittedModel
from compasslib.inference.noise import SlowNoise, SlowNoiseBasis
from compasslib.statistics.resampling import (
    EVEN_BLOCKS,
    blocks_by_span,
    cluster_variance_inflation,
)
from compasslib.statistics.whitening import whitened_basis
from compasslib.types import DAY_S, Floats

AMPLITUDES_DEG = np.array([0.5, 1.0, 2.0, 4.0, 8.0])  # rms of an effect, equally probable
BLOCK_S = 3 * DAY_S  # longer than the autocorrelation that the filter leaves
FAINT = 1e-3  # variance over that of white noise below which a column of slow noise is left out
# Kinds of slow noise for surrogates and covariances: fewest, and least probability relative to the likeliest.
FEWEST_NOISES, LEAST_PROBABILITY = 8, 1e-3

Entered = Sequence[tuple[int, float]]  # index and amplitude, degrees, of options that are part of the noise


@dataclass(frozen=True)
class Products:
    """Products of whitened columns with each other and with residuals: those of the options first, then of noise."""

    information: Floats  # (m, m)
    score: Floats  # (m, r)
    ends: NDArray[np.intp]  # (g + 1,) boundaries between the columns of the options
    amplitudes: Floats  # (a, g) prior rms of each option, degrees, equally probable

    def columns(self, option: int) -> NDArray[np.intp]:
        """Indices of an option's columns."""
        return np.arange(self.ends[option], self.ends[option + 1])

    def marginalize(self, variance: Floats, entered: Entered = ()) -> Marginal:
        """Marginalize the columns of noise, with given prior variances, and the entered options."""
        active = np.flatnonzero(variance * np.diag(self.information)[self.ends[-1] :] > FAINT)
        at = np.concatenate([self.ends[-1] + active, *(self.columns(k) for k, _ in entered)])
        sizes = (np.full(len(self.columns(k)), size) for k, size in entered)
        root = np.concatenate([np.sqrt(variance[active]), *sizes])
        precision = np.eye(len(root)) + root[:, None] * self.information[np.ix_(at, at)] * root
        return Marginal(self, at, root, np.linalg.cholesky(precision))


@dataclass(frozen=True)
class Marginal:
    """Products with some columns marginalized."""

    products: Products
    at: NDArray[np.intp]  # the marginalized columns
    root: Floats  # square roots of their prior variances
    lower: Floats  # Cholesky factor of their posterior precision, in units of these

    def half(self, columns: Floats) -> Floats:
        """Compute the part of products, (m, ...), that the marginalized columns take, as a square root."""
        scaled = self.root[:, None] * columns[self.at]
        return np.asarray(solve_triangular(self.lower, scaled, lower=True, check_finite=False))

    @cached_property
    def taken(self) -> Floats:
        """The part of the products with the residuals, (a, r)."""
        return self.half(self.products.score)

    @property
    def mean(self) -> Floats:
        """Posterior means of the coefficients of the marginalized columns for the first residual, (a,)."""
        unit = solve_triangular(self.lower, self.taken[:, 0], lower=True, trans="T", check_finite=False)
        return np.asarray(self.root * unit)

    def left(self, at: NDArray[np.intp]) -> tuple[Floats, Floats]:
        """Compute the products of some columns with each other, (k, k), and with the residuals, (k, r)."""
        half = self.half(self.products.information[:, at])
        information = self.products.information[np.ix_(at, at)] - half.T @ half
        return information, self.products.score[at] - half.T @ self.taken

    def fit(self, chosen: Entered) -> Floats:
        """Compute the posterior mean of the coefficients of some options together, (k, r)."""
        at = np.concatenate([self.products.columns(k) for k, _ in chosen])
        size = np.concatenate([np.full(len(self.products.columns(k)), a) for k, a in chosen])
        information, score = self.left(at)
        precision = np.eye(len(at)) + size[:, None] * information * size
        return np.asarray(size[:, None] * np.linalg.solve(precision, size[:, None] * score))

    @cached_property
    def _options(self) -> list[tuple[NDArray[np.intp], Floats, Floats]]:
        """Options of each number of columns: eigenvalues, (g, k), and squared scores along them, (g, k, r)."""
        ends, result = self.products.ends, list[tuple[NDArray[np.intp], Floats, Floats]]()
        cross = self.half(self.products.information[:, : ends[-1]])
        left = self.products.score[: ends[-1]] - cross.T @ self.taken
        sizes = np.diff(ends)
        for size in np.unique(sizes):
            options = np.flatnonzero(sizes == size)
            index = ends[options][:, None] + np.arange(size)
            part = cross[:, index.ravel()].T.reshape(*index.shape, len(self.at))
            information = self.products.information[index[:, :, None], index[:, None, :]]
            values, vectors = np.linalg.eigh(information - part @ part.transpose(0, 2, 1))
            along = (vectors.transpose(0, 2, 1) @ left[index]) ** 2
            result.append((options, np.maximum(values, 0.0), along))
        return result

    @cached_property
    def by_amplitude(self) -> Floats:
        """Log Bayes factor of each option over none at each amplitude, (a, g, r)."""
        result = np.empty((*self.products.amplitudes.shape, self.products.score.shape[1]))
        for options, values, along in self._options:
            for a, amplitude in enumerate(self.products.amplitudes[:, options, None]):
                result[a, options] = log_bayes_factors(values, along, amplitude)
        return result

    @property
    def evidence(self) -> Floats:
        """Log Bayes factor of each option over none, (g, r)."""
        return np.asarray(np.logaddexp.reduce(self.by_amplitude, axis=0) - np.log(len(self.products.amplitudes)))

    @property
    def none(self) -> Floats:
        """Log likelihood without options, relative to white noise, (r,)."""
        return np.asarray(0.5 * np.sum(self.taken**2, axis=0) - np.sum(np.log(np.diag(self.lower))))


def log_bayes_factors(
    values: Floats, along: Floats, amplitude: Floats | float, square: Floats | None = None, freedom: float = np.inf
) -> Floats:
    """Compute the log Bayes factor of options over none at a prior amplitude, (g, r).

    If the variance of the noise is unknown, its Student's law of few residuals is used, and all are in its units.

    Args:
        values: eigenvalues of each option's information, (g, k).
        along: squared scores along the eigenvectors, (g, k, r).
        square: sum of squares of the residuals without options, (r,).
        freedom: degrees of freedom of the noise's variance; infinite if it is known.
    """
    grown = amplitude**2 * values
    gain = ((0.5 * amplitude**2 / (1.0 + grown))[:, None, :] @ along)[:, 0]
    if square is not None:
        gain = -0.5 * freedom * np.log1p(-2.0 * gain / square)
    return np.asarray(gain - 0.5 * np.log1p(grown).sum(axis=1)[:, None])


@dataclass(frozen=True)
class LinearModel:
    """All options and slow noise, linearized at a fitted model; p columns of options, then q of slow noise."""

    freed: FittedModel  # whose whitener excludes slow noise
    options: tuple[Option, ...]
    slow: SlowNoiseBasis | None
    white: Floats  # (n, p + q) float32 whitened columns, in units of the white noise
    scatter: float  # variance of the scores between blocks of days over that of homogeneous noise

    @cached_property
    def residual(self) -> Floats:
        """Whitened residual in units of the white noise, (n,) float32."""
        return (self.freed.innovation / self.freed.sigma / np.sqrt(self.scatter)).astype(np.float32)

    @cached_property
    def products(self) -> Products:
        """Products of the columns with each other and with the residual."""
        ends = np.cumsum([0, *(option.columns.shape[1] for option in self.options)])
        information, score = self.white.T @ self.white, self.white.T @ self.residual[:, None]
        sized = np.array([option.sized for option in self.options], dtype=bool)
        amplitudes = np.where(sized, 1.0, AMPLITUDES_DEG[:, None])
        return Products(information.astype(float), score.astype(float), ends, amplitudes)

    def noise_variances(self, slow_noise: SlowNoise | None) -> Floats:
        """Compute the prior variance of the coefficient of each column of slow noise, (q,)."""
        return np.zeros(0) if self.slow is None or slow_noise is None else self.slow.variances(slow_noise)

    def marginalized(self, slow_noise: SlowNoise | None, entered: Entered = ()) -> Marginal:
        """Marginalize slow noise and the entered options."""
        return self.products.marginalize(self.noise_variances(slow_noise), entered)

    def weigh(
        self, slow_noises: Sequence[SlowNoise | None], entered: Entered = (), score: Floats | None = None
    ) -> Evidence:
        """Compute the evidence of each option alone beside the entered ones.

        Args:
            score: products of other residuals with the columns, (p + q, r); by default of the recording's.
        """
        products = self.products if score is None else replace(self.products, score=score)
        each = [products.marginalize(self.noise_variances(slow_noise), entered) for slow_noise in slow_noises]
        shares = np.array([option.share for option in self.options])
        none, options = zip(*((marginal.none, marginal.evidence.astype(np.float32)) for marginal in each), strict=True)
        return Evidence(tuple(slow_noises), shares, np.array(none), np.array(options))

    def draw(
        self, evidence: Evidence, count: int, seed: int, entered: Entered = (), residual: Floats | None = None
    ) -> Floats:
        """Draw whitened residuals of the recording without further effects, (n, count) float32.

        Args:
            evidence: of the recording, by whose probabilities slow noise is drawn.
            residual: the recording's own without any effect, (n,), whose blocks get random signs, in place of simulated
                noise: the wild cluster bootstrap (Cameron, Gelbach and Miller, Rev. Econ. Stat. 90, 414, 2008).
        """
        rng = np.random.default_rng(seed)
        if residual is not None:
            block = blocks_by_span(self.freed.comparison.scene.time_s, BLOCK_S)
            sign = rng.choice(np.array([-1.0, 1.0], dtype=np.float32), (block[-1] + 1, count))
            surrogates: Floats = residual[:, None] * sign[block]
        else:
            chosen = rng.choice(len(evidence.slow_noises), count, p=evidence.noise_probability())
            deviations = np.sqrt([self.noise_variances(slow_noise) for slow_noise in evidence.slow_noises]).T
            slow = rng.normal(size=(len(deviations), count)) * deviations[:, chosen]
            surrogates = self.white[:, self.products.ends[-1] :] @ slow.astype(np.float32)
            surrogates += rng.normal(size=surrogates.shape).astype(np.float32)
        surrogates[~np.isfinite(self.freed.whitener.width_deg)] = 0.0
        for k, size in entered:
            at = self.products.columns(k)
            surrogates += self.white[:, at] @ (size * rng.normal(size=(len(at), count))).astype(np.float32)
        return self.freed.project_out_nuisance(surrogates)

    def without(self, chosen: Entered, slow_noise: SlowNoise | None) -> Floats:
        """Subtract some options and the current, fitted together, from the whitened residual, (n,) float32."""
        marginal = self.marginalized(slow_noise, chosen)
        slow = self.white.shape[1] - (0 if self.slow is None else len(self.slow.drivers))
        taken = (marginal.at < self.products.ends[-1]) | (marginal.at >= slow)
        return self.residual - self.white[:, marginal.at[taken]] @ marginal.mean[taken].astype(np.float32)

    def scores(self, residuals: Floats) -> Floats:
        """Compute the products of the columns with whitened residuals, (n, r)."""
        return (self.white.T @ residuals).astype(float)

    def fit(self, chosen: Entered, slow_noise: SlowNoise | None) -> list[Floats]:
        """Compute the posterior means of the parameters of some options together, in the terms' units."""
        if not chosen:
            return []
        mean = self.marginalized(slow_noise).fit(chosen)[:, 0]
        ends = np.cumsum([len(self.products.columns(k)) for k, _ in chosen])[:-1]
        return [x * self.options[k].usual for x, (k, _) in zip(np.split(mean, ends), chosen, strict=True)]

    def current(self, chosen: Entered, slow_noise: SlowNoise | None) -> CurrentPosterior | None:
        """Infer the drivers of the current beside some options; None if the noise has no current."""
        if self.slow is None or slow_noise is None or not self.slow.drivers:
            return None
        at = np.arange(self.white.shape[1] - len(self.slow.drivers), self.white.shape[1])
        variance = self.slow.without_current(self.slow.drivers).variances(slow_noise)
        information, score = self.products.marginalize(variance, chosen).left(at)
        return infer_current(self.slow.drivers, information, score[:, 0])

    def likeliest_amplitude(self, option: int, slow_noise: SlowNoise | None, entered: Entered = ()) -> float:
        """Find the likeliest amplitude of an option, degrees."""
        by_amplitude = self.marginalized(slow_noise, entered).by_amplitude
        return float(self.products.amplitudes[int(np.argmax(by_amplitude[:, option, 0])), option])


@dataclass(frozen=True)
class Evidence:
    """Evidence of no further effect and of each option, under each kind of slow noise, for r residuals."""

    slow_noises: tuple[SlowNoise | None, ...]
    shares: Floats  # (g,) log prior probability of each option, given one effect
    none: Floats  # (w, r)
    options: Floats  # (w, g, r) log Bayes factor over none

    @cached_property
    def log_prior(self) -> Floats:
        """Log prior of each kind of slow noise, (w, 1)."""
        return np.array([[0.0 if slow_noise is None else slow_noise.log_prior] for slow_noise in self.slow_noises])

    @cached_property
    def log_bayes_factors(self) -> Floats:
        """Log Bayes factor of each option over none, times its prior share, slow noise marginalized, (g, r)."""
        none = self.none + self.log_prior
        total = np.logaddexp.reduce(none, axis=0)
        return np.logaddexp.reduce(none[:, None] - total + self.options, axis=0) + self.shares[:, None]

    @cached_property
    def statistic(self) -> Floats:
        """Log Bayes factor of any option over none, (r,), by which an effect is detected."""
        return np.asarray(np.logaddexp.reduce(self.log_bayes_factors, axis=0))

    def noise_probability(self, option: int | None = None) -> Floats:
        """Compute the probability of each kind of slow noise for the first residual, given an option or none, (w,)."""
        log = self.none[:, 0] + self.log_prior[:, 0] + (0.0 if option is None else self.options[:, option, 0])
        weight = np.exp(log - log.max())
        return np.asarray(weight / weight.sum())

    @property
    def likely_noises(self) -> list[SlowNoise | None]:
        """The kinds of slow noise that are not improbable without a further effect."""
        probability = self.noise_probability()
        most = max(FEWEST_NOISES, int(np.sum(probability > LEAST_PROBABILITY)))
        return [self.slow_noises[w] for w in np.argsort(-probability)[:most]]

    def likeliest_noise(self, option: int | None = None) -> SlowNoise | None:
        """Select the likeliest slow noise for the first residual, given an option or none."""
        return self.slow_noises[int(np.argmax(self.noise_probability(option)))]


def linearize(fitted: FittedModel, slow: SlowNoiseBasis | None) -> LinearModel:
    """Linearize all options at a fitted model, whose terms are freed, and compute the products of their columns."""
    freed, midpoint = design.freed_model(fitted)
    options = enumerate_options(freed, midpoint)
    slow_columns = np.zeros((len(freed.comparison), 0), dtype=np.float32) if slow is None else slow.columns
    columns = np.concatenate([*(option.columns for option in options), slow_columns], axis=1, dtype=np.float32)
    scatter = _score_inflation(fitted, options)
    sigma = freed.sigma * np.sqrt(scatter)
    white = freed.whiten_and_project(columns) * np.float32(freed.response / sigma)
    return LinearModel(freed, options, slow, white, scatter)


def _score_inflation(fitted: FittedModel, options: Sequence[Option]) -> float:
    """Estimate by how much scores vary more between blocks of days than homogeneous noise explains, at least 1.

    Real directions scatter more in some weeks than their widths imply: the median of a cluster-robust variance over the
    blocks (Liang and Zeger, Biometrika 73, 13, 1986).

    Args:
        fitted: model whose whitener contains slow noise.
    """
    first = list({option.block: option for option in reversed(options)}.values())
    white = fitted.whiten_and_project(np.concatenate([option.columns for option in first], axis=1))
    block = blocks_by_span(fitted.comparison.scene.time_s, BLOCK_S)
    ends = np.cumsum([option.columns.shape[1] for option in first])[:-1]
    inflation, count = [], []
    for part in np.split(white, ends, axis=1):
        basis = whitened_basis(part).astype(float)
        if basis.shape[1]:
            each = cluster_variance_inflation(basis, fitted.innovation, block, fitted.sigma**2)
            inflation.append(each[0])
            count.append(each[1])
    weight = np.array(count) / (np.array(count) + EVEN_BLOCKS)
    order = np.argsort(inflation)
    middle = np.searchsorted(np.cumsum(weight[order]), weight.sum() / 2.0)
    return max(float(np.array(inflation)[order][middle]), 1.0) if len(order) else 1.0
