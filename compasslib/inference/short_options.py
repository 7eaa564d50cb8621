"""Candidate effects of a short recording, linearized at a fitted hypothesis, and their evidence.

What no listed effect describes is a composed one: a curve of a covariate, or an offset in a sector of headings or for a
while. Otherwise a card that is pulled in one sector is taken for a harmonic, and a temporary offset for a slip.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib.effects.composed import bump, compose_effect, place_effect
from compasslib.effects.effect import Effect
from compasslib.inference.blocks import DATE_MARGIN, MOST_DATES, PAIRS_SHARE, Option, block_of, with_shares
from compasslib.inference.linear_model import Evidence, log_bayes_factors
from compasslib.inference.short_fit import (
    FINEST_DEG,
    FittedHypothesis,
    ShortComparison,
    memory_blocks,
    term_derivative,
)
from compasslib.statistics.noise import PHI, THETA, arma_innovations, arma_variance_ratio
from compasslib.statistics.resampling import EVEN_BLOCKS, cluster_variance_inflation
from compasslib.statistics.whitening import orthonormal_basis, project_out
from compasslib.types import Floats

Law = tuple[float, float]  # autoregressive and moving-average coefficient of the noise
Places = NDArray[np.intp]  # (g, d) candidate places of a term

WHITE: Law = (0.0, 0.0)
LAWS: tuple[Law, ...] = tuple((float(p), float(t)) for p in PHI[::2] for t in THETA[::2] if t >= -p)
AMPLITUDES = 4.0 ** np.arange(-1, 6)  # rms of an effect over the noise, equally probable; logs have effects of 1000
SAME = 1e-6  # singular value that is none, relative to the largest

SPELL_EDGES = 14  # edges of temporary offsets that are tried first
FEWEST_AFFECTED = 3  # samples on either side of a date, or of an offset
SECTOR_STEP_DEG, REACHES_DEG = 10, (15, 25, 40)  # distance of the sectors that are tried first, and their half widths
FINER = 4  # ratio of the distances of candidate places and of finer ones around the best


def laws(comparison: ShortComparison) -> tuple[Law, ...]:
    """List the candidate laws of the noise of a recording."""
    return (WHITE,) if comparison.independent else LAWS


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
        return ((np.arange(n)[:, None] >= places[:, 0]) & inside).astype(float)

    grid = np.unique(np.linspace(edge, n - edge, min(n, MOST_DATES)).astype(np.intp))[:, None]
    always = term_derivative(state, replace(kind(), date_s=-np.inf))  # type: ignore[call-arg]
    yield from _located(state, term, always, acting, grid, [-(-n // MOST_DATES)])


def _unlisted(state: FittedHypothesis) -> Iterator[Option]:
    """Yield curves along the covariates, and offsets in a sector of headings or for a while."""
    comparison, n = state.comparison, len(state.comparison)
    sector, spell = (compose_effect("reading", *each) for each in (("heading", "bump"), ("time", "box")))
    curves: list[Effect] = [place_effect(compose_effect("reading", "time", "slow"), *comparison.span_s)]

    def during(places: Places) -> Floats:
        inside = (places[:, 0] > 0) & (places[:, 1] < n)
        number = np.arange(n)[:, None]
        return ((number >= places[:, 0]) & (number < places[:, 1]) & inside).astype(float)

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


def _time_between(state: FittedHypothesis, k: float) -> float:
    return float(np.mean(state.comparison.time_s[int(k) - 1 : int(k) + 1]))


def _option(state: FittedHypothesis, term: Effect, derivative: Floats | None = None, cell: float = 1.0) -> Option:
    """Scale the derivative by a term's parameters, (n, p), to equal sizes and a mean square of 1 together."""
    derivative = term_derivative(state, term) if derivative is None else derivative
    turn = np.sqrt(np.mean(derivative**2, axis=0))
    acting = turn > 0.0
    if not acting.any():
        return Option(term, block_of(type(term)), np.zeros((len(derivative), 0)), np.zeros(0))
    usual = np.where(acting, 1.0 / np.where(acting, turn, 1.0), 0.0) / np.sqrt(acting.sum())
    return Option(term, block_of(type(term)), derivative * usual, usual, cell=cell)


def weigh(state: FittedHypothesis, options: Sequence[Option], residuals: Floats) -> Callable[[float], Evidence]:
    """Prepare the evidence of options under each law of the noise, for residuals (n, r).

    Returns:
        Function of the variance of scores between blocks over that of homogeneous noise.
    """
    ends = np.cumsum([0, *(option.columns.shape[1] for option in options)])
    columns = np.concatenate([np.zeros((len(residuals), 0)), *(option.columns for option in options)], axis=1)
    shares, rule_deg = np.array([option.share for option in options]), state.comparison.rule_deg
    each = [log_evidence(law, state.columns, columns, ends, residuals, rule_deg) for law in laws(state.comparison)]

    def evidence(scatter: float) -> Evidence:
        none, factors = (np.array(part) for part in zip(*(of_law(scatter) for of_law in each), strict=True))
        return Evidence((None,) * len(each), shares, none, factors)

    return evidence


def log_evidence(
    law: Law, base: Floats, columns: Floats, ends: NDArray[np.intp], residuals: Floats, rule_deg: float = 0.0
) -> Callable[[float], tuple[Floats, Floats]]:
    """Prepare the log likelihood without options, (r,), and the log Bayes factor of each, (g, r), under one noise law.

    Coefficients of the base have a flat prior, and the variance of the noise is unknown (Student's law).

    Args:
        base, columns: of the hypothesis, (n, b), and of the options, (n, m).
        ends: boundaries between the options' columns, (g + 1,).
        residuals: (n, r) degrees.
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
            each = [log_bayes_factors(values, along, a, square, freedom) for a in AMPLITUDES]
            factors[options] = np.logaddexp.reduce(each, axis=0) - np.log(len(AMPLITUDES))
        return -0.5 * freedom * np.log(square) - volume, factors

    return evidence


def score_scatter(fitted: FittedHypothesis, law: Law, columns: Sequence[Floats]) -> float:
    """Estimate by how much scores of effects vary more between blocks than homogeneous noise explains, at least 1."""
    base = orthonormal_basis(arma_innovations(fitted.columns, law))
    left = project_out(arma_innovations(fitted.evident[:, None], law), base)[:, 0]
    variance = max(float(np.mean(left**2)), FINEST_DEG**2)
    ratios, block = [], memory_blocks(fitted)
    for each in columns:
        white = orthonormal_basis(project_out(arma_innovations(each, law), base))
        if white.shape[1]:
            ratio, count = cluster_variance_inflation(white, left, block, variance)
            ratios.append((count * ratio + EVEN_BLOCKS) / (count + EVEN_BLOCKS))
    return max(float(np.median(ratios)), 1.0) if ratios else 1.0
