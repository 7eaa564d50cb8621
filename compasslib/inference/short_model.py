"""Model of a short recording: hypotheses fitted in the forward model, candidate effects beside one, and their evidence.

Base parameters and terms are fitted jointly by Gauss-Newton steps with Huber weights: effects may be a thousand times
the noise, which is 0.01 to 5 degrees. What no listed effect describes is a composed one: a curve of a covariate, or an
offset in a sector of headings or for a while. Otherwise a card that is pulled in one sector is taken for a harmonic,
and a temporary offset for a slip.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from compasslib import angles
from compasslib.effects.composed import ComposedEffect, bump, compose_effect, place_effect
from compasslib.effects.effect import Effect, Scene, parameter_slices
from compasslib.inference.comparison import Comparison
from compasslib.inference.evidence import (
    DATE_MARGIN,
    MOST_DATES,
    PAIRS_SHARE,
    Evidence,
    Option,
    log_bayes_factors,
    log_sum,
    scale_option,
    with_shares,
)
from compasslib.inference.finding import MOST_WIDTHS
from compasslib.statistics.least_squares import MISFIT_TOLERANCE, gauss_newton, robust_width
from compasslib.statistics.noise import (
    PHI,
    THETA,
    arma_covariance,
    arma_effective_size,
    arma_innovations,
    arma_variance_ratio,
    effective_sample_size,
)
from compasslib.statistics.resampling import (
    EVEN_BLOCKS,
    block_sums,
    blocks_by_count,
    cluster_variance_inflation,
    student_factor,
)
from compasslib.statistics.whitening import orthonormal_basis, project_out, scaled_inverse
from compasslib.types import Floats

FINEST_DEG = 1e-4  # least uncertainty of a heading
MOST_BLOCKS, FEWEST_BLOCKS, SAMPLES_IN_BLOCK = 40, 10, 5.0  # number of blocks; effective samples in one
NEIGHBOURS = 5  # samples whose median an outlier of a log is far from
PROBE_STEP = 0.02  # finite difference, relative to a parameter's step
AMPLITUDES = 4.0 ** np.arange(-1, 6)  # rms of an effect over the noise, equally probable; logs have effects of 1000
SAME = 1e-6  # singular value that is none, relative to the largest
SPELL_EDGES = 14  # edges of temporary offsets that are tried first
FEWEST_AFFECTED = 3  # samples on either side of a date, or of an offset
SECTOR_STEP_DEG, REACHES_DEG = 10, (15, 25, 40)  # distance of the sectors that are tried first, and their half widths
FINER = 4  # ratio of the distances of candidate places and of finer ones around the best

# Observed minus simulated, (n,) degrees, for base parameters (b,) and terms.
ResidualModel = Callable[[Floats, tuple[Effect, ...]], Floats]
Places = NDArray[np.intp]  # (g, d) candidate places of a term
Law = tuple[float, float]  # autoregressive and moving-average coefficient of the noise

WHITE: Law = (0.0, 0.0)
LAWS: tuple[Law, ...] = tuple((float(p), float(t)) for p in PHI[::2] for t in THETA[::2] if t >= -p)


@dataclass(frozen=True, kw_only=True)
class ShortComparison(Comparison):
    """A short recording compared with its simulation; n samples in order of time."""

    residual: ResidualModel
    start: Floats  # (b,) base parameters of the simulation, before any fit
    steps: Floats  # (b,) change of each that turns the heading by about a degree; 0 holds it fixed
    confused: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effect -> effects that look the same here
    field_unit: tuple[float, str] = (1.0, "nT")  # factor from nT, and name
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # effect -> starts of its first parameter
    rule_deg: float = 0.0  # systematic error of the simulation that no number of samples averages out, rms
    independent: bool = False  # whether errors of the readings are independent
    arma_noise: bool = False  # whether the noise is modelled as ARMA instead of estimated from blocks
    reads: bool = True  # whether what is compared is a reading of a compass

    @property
    def laws(self) -> tuple[Law, ...]:
        """Candidate laws of the noise."""
        return (WHITE,) if self.independent else LAWS

    @cached_property
    def conditions(self) -> Scene:
        """The covariates, as departures of a scene."""
        departures = {name: x - x.mean() for name, x in self.covariates.items()}
        none = np.zeros(len(self))
        return Scene(self.time_s, none, none, none, none, self.span_s[0], departures)

    def difference(self, base: Floats, terms: Sequence[Effect]) -> Floats:
        """Compute observed minus simulated values, (n,) degrees; composed terms are added to the simulated ones."""
        listed = tuple(term for term in terms if not isinstance(term, ComposedEffect))
        unlisted = (term for term in terms if isinstance(term, ComposedEffect))
        return self.residual(base, listed) - sum(self.series(term) @ term.values for term in unlisted)

    def series(self, term: ComposedEffect) -> Floats:
        """Compute the columns that a composed term adds, (n, p)."""
        return term.series(self.conditions, self.covariates.get("heading"))

    def unit(self, term: Effect, k: int) -> tuple[float, str]:
        unit = term.units()[k]
        if not unit.startswith("nT"):
            return 1.0, unit
        return self.field_unit[0], self.field_unit[1] + unit.removeprefix("nT")


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis, linearized at its parameters."""

    comparison: ShortComparison
    base: Floats  # (b,)
    terms: tuple[Effect, ...]
    used: NDArray[np.bool_]  # (n,) the samples that are fitted

    @cached_property
    def residual_deg(self) -> Floats:
        """Observed minus simulated values, (n,)."""
        return self.comparison.difference(self.base, self.terms)

    @cached_property
    def columns(self) -> Floats:
        """Derivative of the simulated heading by each parameter, (n, b + p) degrees a unit."""
        at, steps = self.parameters, self.steps
        columns = np.zeros((len(self.comparison), len(at)))
        for term, place in zip(self.terms, parameter_slices(self.terms, len(self.base)), strict=True):
            if isinstance(term, ComposedEffect):
                columns[:, place], steps[place] = self.comparison.series(term), 0.0
        for j in np.flatnonzero(steps):
            probe = PROBE_STEP * steps[j]
            columns[:, j] = (self.residual_deg - self.at(at + probe * (np.arange(len(at)) == j)).residual_deg) / probe
        return columns

    @cached_property
    def scale_deg(self) -> float:
        """Robust width of the residual."""
        return max(robust_width(self.residual_deg - np.median(self.residual_deg)), FINEST_DEG)

    @property
    def parameters(self) -> Floats:
        """Base parameters and those of the terms, (b + p,)."""
        return np.concatenate([self.base, *(term.values for term in self.terms)])

    @property
    def steps(self) -> Floats:
        """Changes of the parameters that turn the heading by about a degree, (b + p,); 0 holds one fixed."""
        return np.concatenate([self.comparison.steps, *(term.steps() for term in self.terms)])

    @property
    def clipped(self) -> Floats:
        """The residual, clipped unless readings are independent, (n,)."""
        if self.comparison.independent:
            return self.residual_deg
        return np.clip(self.residual_deg, -MOST_WIDTHS * self.scale_deg, MOST_WIDTHS * self.scale_deg)

    @cached_property
    def evident(self) -> Floats:
        """The residual without the isolated outliers of a log, (n,)."""
        if self.comparison.independent or self.comparison.arma_noise:
            return self.residual_deg
        middle = median_filter(self.residual_deg, NEIGHBOURS, mode="nearest")
        away = self.residual_deg - middle
        most = MOST_WIDTHS * max(robust_width(away), FINEST_DEG)
        return np.asarray(middle + np.clip(away, -most, most))

    @property
    def square(self) -> float:
        """Sum of squares of the clipped residual, at least that of the finest headings."""
        return max(float(self.clipped @ self.clipped), len(self.clipped) * FINEST_DEG**2)

    def projected(self, columns: Floats) -> Floats:
        """Project the columns of all parameters out of other columns, (n, k)."""
        return project_out(columns, orthonormal_basis(self.columns))

    def derivative(self, term: Effect) -> Floats:
        """Differentiate the simulated heading by the parameters of a term added to the hypothesis, (n, p)."""
        if isinstance(term, ComposedEffect):
            return self.comparison.series(term)
        made = []
        for j, step in enumerate(0.1 * term.steps()):
            moved = term.at(term.values + step * (np.arange(len(term.values)) == j))
            made.append((self.residual_deg - self.comparison.difference(self.base, (*self.terms, moved))) / step)
        return np.stack(made, axis=1)

    @cached_property
    def effective_samples(self) -> float:
        """Effective number of independent samples in the residual."""
        n = len(self.comparison)
        if self.comparison.independent:
            return float(n)
        if self.comparison.arma_noise:
            return arma_effective_size(self.clipped, self.columns)
        return effective_sample_size(self.clipped, np.arange(n, dtype=float), longest_s=n / 10.0)

    @cached_property
    def blocks(self) -> NDArray[np.intp]:
        """Number of the block of each sample, (n,); a block has several effective samples, or one reading."""
        order = np.arange(len(self.comparison))
        if self.comparison.independent:
            return order
        count = int(np.clip(self.effective_samples / SAMPLES_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
        return blocks_by_count(order.astype(float), count)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of base and terms from scores of blocks, at least that of independent samples.

        The systematic error ``rule_deg`` is added as if it were entirely along each parameter's own column.
        """
        columns, residual = self.columns, self.clipped
        if self.comparison.arma_noise:
            return arma_covariance(residual, columns)
        inverse = scaled_inverse(columns.T @ columns)
        free = max(len(residual) - columns.shape[1], 1)
        plain = inverse * self.square / free * student_factor(free) ** 2
        if self.comparison.independent:
            return plain
        sums = block_sums(columns * residual[:, None], self.blocks)
        count = len(sums)
        robust = inverse @ (sums.T @ sums) @ inverse * count / (count - 1) * student_factor(count - 1) ** 2
        share = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
        rule = self.comparison.rule_deg**2 * len(residual) * np.diag(np.diag(inverse))
        return plain * np.outer(share, share) + rule

    def visible_size_deg(self, k: int) -> float:
        """Compute the visible size of a term, with all other parameters projected out, rms degrees."""
        others = orthonormal_basis(np.delete(self.columns, parameter_slices(self.terms, len(self.base))[k], axis=1))
        without = self.comparison.difference(self.base, (*self.terms[:k], *self.terms[k + 1 :])) - self.residual_deg
        return angles.rms(project_out(without, others))

    def step(self) -> tuple[Floats, float]:
        """Compute the weighted least-squares step, 0 in undetermined directions, and its length in about degrees."""
        weight = self.used.astype(float)
        if not self.comparison.independent:
            size = np.maximum(np.abs(self.residual_deg), 1e-300)
            weight = np.sqrt(np.minimum(1.0, MOST_WIDTHS * self.scale_deg / size)) * weight
        columns = self.columns * self.steps * weight[:, None]
        step, *_ = np.linalg.lstsq(columns, self.residual_deg * weight, rcond=1e-6)
        return step * self.steps, float(np.max(np.abs(step)))

    def at(self, parameters: Floats) -> FittedHypothesis:
        """Replace the parameters, (b + p,)."""
        each = zip(self.terms, parameter_slices(self.terms, len(self.base)), strict=True)
        terms = tuple(term.at(parameters[place]) for term, place in each)
        return replace(self, base=parameters[: len(self.base)], terms=terms)

    def moved(self, step: Floats) -> FittedHypothesis:
        """Add a step to the parameters."""
        return self.at(self.parameters + step)

    def misfit(self, other: FittedHypothesis) -> float:
        """Compute the ratio of another hypothesis' sum of squares to this one's."""
        square, then = (float(np.sum(each.clipped[self.used] ** 2)) for each in (self, other))
        return then / max(square, 1e-300)


def fit_hypothesis(
    comparison: ShortComparison,
    terms: Sequence[Effect],
    *,
    near: FittedHypothesis | None = None,
    use: NDArray[np.bool_] | None = None,
) -> FittedHypothesis:
    """Fit the base parameters, from those of a fit near, and terms, from their values; dates are held fixed."""
    base = comparison.start if near is None else near.base
    begin = FittedHypothesis(comparison, base, tuple(terms), np.ones(len(comparison), bool) if use is None else use)
    return gauss_newton(begin, rounds=12, close=1e-3, worse=1.0 + MISFIT_TOLERANCE) if len(begin.steps) else begin


def short_options(state: FittedHypothesis, taken: Collection[str] = ()) -> tuple[Option, ...]:
    """Enumerate the candidate effects beside a hypothesis but those taken, each at its candidate places."""
    listed = []
    for kind in (kind for kind in state.comparison.terms if kind.name not in taken):
        listed += [*_dated(state, kind)] if kind.dated() else [_option(state, kind())]
    unlisted = [option for option in _unlisted(state) if option.name not in taken] if state.comparison.reads else []
    shares = np.log([1.0 - PAIRS_SHARE * bool(unlisted), PAIRS_SHARE]).tolist()
    return tuple(
        replace(option, share=option.share + share)
        for made, share in zip((listed, unlisted), shares, strict=True)
        for option in with_shares([option for option in made if option.columns.shape[1]])
    )


def _dated(state: FittedHypothesis, kind: type[Effect]) -> Iterator[Option]:
    n = len(state.comparison)
    edge = max(int(DATE_MARGIN * n), FEWEST_AFFECTED)

    def term(k: float) -> Effect:
        return replace(kind(), date_s=_time_between(state, k))  # type: ignore[call-arg]

    def acting(places: Places) -> Floats:
        inside = (places[:, 0] >= edge) & (places[:, 0] <= n - edge)
        return _during(n, places[:, 0], np.where(inside, n, 0))

    grid = np.unique(np.linspace(edge, n - edge, min(n, MOST_DATES)).astype(np.intp))[:, None]
    always = state.derivative(replace(kind(), date_s=-np.inf))  # type: ignore[call-arg]
    yield from _located(state, term, always, acting, grid, [-(-n // MOST_DATES)])


def _unlisted(state: FittedHypothesis) -> Iterator[Option]:
    """Yield curves along the covariates, and offsets in a sector of headings or for a while."""
    comparison, n = state.comparison, len(state.comparison)
    sector, spell = (compose_effect("reading", *each) for each in (("heading", "bump"), ("time", "box")))
    curves: list[Effect] = [place_effect(compose_effect("reading", "time", "slow"), *comparison.span_s)]

    def during(places: Places) -> Floats:
        inside = (places[:, 0] > 0) & (places[:, 1] < n)
        return _during(n, places[:, 0], np.where(inside, places[:, 1], 0))

    edges = np.unique(np.linspace(1, n - 1, min(n - 1, SPELL_EDGES)).astype(np.intp))
    yield from _located(
        state, lambda *at: place_effect(spell, *(_time_between(state, k) for k in at)), np.ones((n, 1)),
        during, np.array(list(itertools.combinations(edges, 2))), [-(-n // SPELL_EDGES)] * 2,
    )  # fmt: skip
    if "heading" in comparison.covariates:
        heading = comparison.covariates["heading"]
        centres = np.array(list(itertools.product(range(0, 360, SECTOR_STEP_DEG), REACHES_DEG)))
        yield from _located(
            state, lambda *at: place_effect(sector, *at), np.ones((n, 1)),
            lambda places: np.stack([bump(heading, *at) for at in places.tolist()], axis=1), centres,
            [SECTOR_STEP_DEG, 0],
        )  # fmt: skip
        curves.append(compose_effect("reading", "heading", "harmonics")())
    for name, x in comparison.covariates.items():
        if name not in ("heading", "time", "reading") and np.ptp(x) > 0.0:
            curves.append(place_effect(compose_effect("reading", name, "smooth"), 0.0, float(np.std(x))))
    yield from (_option(state, term) for term in curves)


def _located(
    state: FittedHypothesis,
    term: Callable[..., Effect],
    always: Floats,
    acting: Callable[[Places], Floats],
    grid: Places,
    step: Sequence[int],
) -> Iterator[Option]:
    """Yield a term at candidate places, and at finer ones around the likeliest.

    Args:
        term: function of a place that returns the term at zero size.
        always: derivative by the term's parameters where it acts, (n, p) degrees a unit.
        acting: function of places that returns the share that acts at each sample, (n, g).
        step: distance between candidate places, (d,).
    """

    def columns_at(places: Places) -> tuple[Places, Floats]:
        share = acting(places)
        enough = np.count_nonzero(share, axis=0) >= FEWEST_AFFECTED
        return places[enough], always[:, None, :] * share[:, enough, None]

    def likeliest(columns: Floats) -> int:
        n, count, parameters = columns.shape
        ends = parameters * np.arange(count + 1)
        flat = columns.reshape(n, -1)
        return int(np.argmax(log_evidence(WHITE, state.columns, flat, ends, state.evident[:, None])(1.0)[1]))

    places, columns = columns_at(grid)
    cells, finer = np.ones(len(places)), np.array(step)
    if (finer > 1).any() and len(places):
        first = best = likeliest(columns)
        others = np.arange(len(places)) != first
        coarse, cell = (places[others], columns[:, others]), 1.0
        while (finer > 1).any():
            closer = np.maximum(finer // FINER, np.minimum(finer, 1))
            cell *= float(np.prod(closer[finer > 0] / finer[finer > 0]))
            offsets = np.array(list(itertools.product(range(-FINER, FINER + 1), repeat=len(closer))))
            places, columns = columns_at(np.unique(places[best] + closer * offsets, axis=0))
            best, finer = likeliest(columns), closer
        cells = np.append(np.ones(len(coarse[0])), np.full(len(places), cell))
        places, columns = np.concatenate([coarse[0], places]), np.concatenate([coarse[1], columns], axis=1)
    for k, at in enumerate(places.tolist()):
        yield _option(state, term(*at), columns[:, k], float(cells[k]))


def _during(n: int, first: Places, end: Places) -> Floats:
    """Compute the share of offsets that act at each sample, from one sample to before another, (n, g)."""
    return ((np.arange(n)[:, None] >= first) & (np.arange(n)[:, None] < end)).astype(float)


def _time_between(state: FittedHypothesis, k: float) -> float:
    return float(np.mean(state.comparison.time_s[int(k) - 1 : int(k) + 1]))


def _option(state: FittedHypothesis, term: Effect, derivative: Floats | None = None, cell: float = 1.0) -> Option:
    derivative = state.derivative(term) if derivative is None else derivative
    return scale_option(term, derivative, np.sqrt(np.mean(derivative**2, axis=0)), cell=cell)


def weigh(
    comparison: ShortComparison, base: Floats, options: Sequence[Option], residuals: Floats
) -> Callable[[float], Evidence]:
    """Prepare the evidence of options under each noise law, as a function of the scatter.

    Args:
        base: columns of the hypothesis, (n, b).
        residuals: (n, r).
    """
    laws, rule_deg = comparison.laws, comparison.rule_deg
    ends = np.cumsum([0, *(option.columns.shape[1] for option in options)])
    columns = np.concatenate([np.zeros((len(residuals), 0)), *(option.columns for option in options)], axis=1)
    each = [log_evidence(law, base, columns, ends, residuals, rule_deg) for law in laws]

    def evidence(scatter: float) -> Evidence:
        none, factors = (np.array(part) for part in zip(*(of_law(scatter) for of_law in each), strict=True))
        return Evidence(tuple(options), laws, np.zeros((len(laws), 1)), none, factors)

    return evidence


def log_evidence(
    law: Law, base: Floats, columns: Floats, ends: NDArray[np.intp], residuals: Floats, rule_deg: float = 0.0
) -> Callable[[float], tuple[Floats, Floats]]:
    """Prepare the log likelihood without options, (r,), and the log Bayes factor of each, (g, r), under one noise law.

    Coefficients of the base have a flat prior, and the variance of the noise is unknown (Student's law).

    Args:
        base, columns: of the hypothesis, (n, b), and of the options, (n, m), with boundaries ``ends``.
        rule_deg: systematic error, the least standard deviation of the noise.

    Returns:
        Function of the variance of scores between blocks over that of homogeneous noise.
    """
    n, ratio = len(base), arma_variance_ratio(law)
    orthonormal, triangle = np.linalg.qr(arma_innovations(base, law))
    left, size, _ = np.linalg.svd(triangle)
    retained = size > SAME * size.max(initial=0.0)
    basis, white = orthonormal @ left[:, retained], arma_innovations(columns, law)
    target, cross = project_out(arma_innovations(residuals, law), basis), basis.T @ white
    square = np.sum(target**2, axis=0) + n * max(rule_deg, FINEST_DEG) ** 2 / ratio
    volume = 0.5 * np.log(ratio) + np.sum(np.log(size[retained]))
    score, sizes, groups = white.T @ target, np.diff(ends), []
    for count in np.unique(sizes):
        options = np.flatnonzero(sizes == count)
        index = ends[options][:, None] + np.arange(count)
        part, taken = (x[:, index].transpose(1, 2, 0) for x in (white, cross))
        values, vectors = np.linalg.eigh(part @ part.transpose(0, 2, 1) - taken @ taken.transpose(0, 2, 1))
        along = (vectors.transpose(0, 2, 1) @ score[index]) ** 2
        groups.append((options, np.maximum(values, 0.0), along))

    def evidence(scatter: float) -> tuple[Floats, Floats]:
        freedom = max(n - int(retained.sum()), 1) / scatter
        factors = np.empty((len(sizes), residuals.shape[1]))
        for options, values, along in groups:
            each = np.array([log_bayes_factors(values, along, a, square, freedom) for a in AMPLITUDES])
            factors[options] = log_sum(each) - np.log(len(AMPLITUDES))
        return -0.5 * freedom * np.log(square) - volume, factors

    return evidence


def score_scatter(fitted: FittedHypothesis, law: Law, columns: Sequence[Floats]) -> float:
    """Estimate by how much scores of effects vary more between blocks than homogeneous noise explains, at least 1."""
    base = orthonormal_basis(arma_innovations(fitted.columns, law))
    left = project_out(arma_innovations(fitted.evident[:, None], law), base)[:, 0]
    variance = max(float(np.mean(left**2)), FINEST_DEG**2)
    ratios, block = [], fitted.blocks
    for each in columns:
        white = orthonormal_basis(project_out(arma_innovations(each, law), base))
        if white.shape[1]:
            ratio, count = cluster_variance_inflation(white, left, block, variance)
            ratios.append((count * ratio + EVEN_BLOCKS) / (count + EVEN_BLOCKS))
    return max(float(np.median(ratios)), 1.0) if ratios else 1.0
