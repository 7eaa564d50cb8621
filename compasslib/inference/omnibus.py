"""Test for a mismatch that no listed effect explains, and for sectors in which a compass sticks.

Scores of many groups of columns are tested jointly against resamples of the record's own noise. The readings of a
sticking compass accumulate at one heading and are missing on both sides of it: the histogram shows this, the mean
residual hardly does. Corrected headings are counted, since readings of a two-valued compass accumulate where they turn.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.effects.readout import HeadingSlip
from compasslib.inference import covariates as covariate_series
from compasslib.inference import design as designs
from compasslib.inference import finding
from compasslib.inference.comparison import TIDE_PERIODS_H, LongComparison
from compasslib.inference.design import ColumnGroup, FittedModel, step_columns
from compasslib.statistics.resampling import block_scores, blocks_by_span, resample_blocks
from compasslib.statistics.whitening import scaled_inverse, whitened_basis
from compasslib.types import Floats

COVARIATE_KNOTS = 8  # number of hat functions of a covariate
ONSET_QUANTILES = (0.07, 0.13, 0.2, 0.35, 0.5, 0.65, 0.8, 0.87, 0.93)  # quantiles beyond which an effect may set in
HEADING_HAT_DEG, FEWEST_IN_HAT = 6.0, 30  # width of heading sectors; least sum of weights in one
HEADING_HARMONICS = 24  # highest harmonic of the recorded heading
TIME_KNOTS, SHORTEST_WAVE_S = (12, 36), 20 * 86400.0  # numbers of hat functions of time; shortest period
SPELL, SPELL_STEP_S, SPELLS = "spell", 5 * 86400.0, (4, 6, 8, 12, 18)  # temporary offsets: spacing, lengths in steps
FAINTEST_DIRECTION = 1e-2  # least eigenvalue, relative to the largest, of a combination of columns that is kept
COVARIATE_PERIODS = {"hour_of_day": 24.0, "reference_heading": 360.0}  # periods of cyclic covariates
PRODUCT_COVARIATES = ("time", "temperature", "depth", "pitch", "roll", "speed", "supply_voltage")  # in products

NOISE_DRAWS = 300  # noise realizations: they determine the precision of the threshold
SLOW_PERIODS_DAYS, WEEKLY_PERIODS_DAYS = (400.0, 14.0), (14.0, 5.0)  # longest and shortest periods, days
FEWEST_WAVES = 8  # fewest weekly waves for a mean power known within a half
TRIMMED_SHARE, TRIMMED_MEAN = 0.95, 0.759  # share of the smallest chi-squared values retained, their expected mean
SPELL_HANDICAP = 0.4  # subtracted from scores of the many temporary offsets, which would otherwise raise the threshold

CELL_DEG = 2.0  # width of the cells of the heading histogram
NEAREST_CELL, FARTHEST_CELL = 2, 8  # cells on either side that predict the one in the middle
SECTOR_BLOCK_S = 5 * 86400.0  # a sphere keeps its heading for days: counts within a block are correlated
CLUSTER_SIGMAS = 5.0  # excess of a cluster over its standard error from the scatter between blocks
CLUSTER_RATIO = 2.5  # count of a cluster over what its neighbours predict
FEWEST_IN_CLUSTER = 30  # readings in a cluster
# Most cells from the cluster to the sector's edge; cells averaged for the density outside; its share at the edge.
WIDEST_SECTOR, RIM_CELLS, EMPTIED_SHARE = 30, 4, 0.4


@dataclass(frozen=True)
class ScoreTests:
    """Groups of columns with their statistics under the data and under the record's own noise."""

    groups: list[ColumnGroup]
    freedom: Floats  # (g,) degrees of freedom of each group
    inflation: Floats  # (g,) mean statistic of the noise over the degrees of freedom, at least 1
    score: Floats  # (g,) normal score of each group's statistic
    highest: Floats  # (r,) highest normal score of each noise draw

    def threshold(self, alarm: float) -> float:
        """Compute the score that the highest of all groups exceeds under noise with probability ``alarm``.

        The effective number of independent normal scores is fitted to the noise draws by maximum likelihood. The
        Gumbel limit converges too slowly: its threshold for 6 in 1000 is exceeded by 2 in 1000.
        """
        from scipy.special import log_ndtr, ndtri_exp  # here: it takes 0.2 s, and jobs that only correct do not need it

        return float(ndtri_exp(np.log1p(-alarm) * -np.mean(log_ndtr(self.highest))))


@dataclass(frozen=True)
class OmnibusResult:
    """Result of the omnibus tests: significant groups with their visible sizes (rms degrees), strongest first."""

    threshold: float  # score that noise alone exceeds with the alarm probability
    strong: tuple[tuple[ColumnGroup, float], ...]
    min_effect_deg: float

    @property
    def curve(self) -> ColumnGroup:
        """Columns of all significant groups along the covariates of the strongest."""
        first = self.strong[0][0]
        alike = [group.columns for group, _ in self.strong if group.covariates == first.covariates]
        return replace(first, columns=np.concatenate(alike, axis=1))

    @property
    def above_min_effect(self) -> list[tuple[ColumnGroup, float]]:
        """Significant groups of at least the minimum size."""
        return [strong for strong in self.strong if strong[1] >= self.min_effect_deg]

    @property
    def small(self) -> tuple[tuple[str, float], ...]:
        """Names and sizes of smaller significant groups, each name once."""
        return tuple({group.name: size for group, size in self.strong if size < self.min_effect_deg}.items())


def omnibus_test(
    tested: ScoreTests, alarm: float, size_deg: Callable[[ColumnGroup, float], float], min_effect_deg: float
) -> OmnibusResult:
    """Select the significant groups with their visible sizes.

    Args:
        alarm: probability that noise alone makes any group significant.
        size_deg: function of a group and its inflation that returns its visible size, rms.
    """
    if not tested.groups:
        return OmnibusResult(float("inf"), (), min_effect_deg)
    threshold = tested.threshold(alarm)
    strong = [int(k) for k in np.argsort(-tested.score) if tested.score[k] > threshold]
    sized = [(tested.groups[k], size_deg(tested.groups[k], float(tested.inflation[k]))) for k in strong]
    return OmnibusResult(threshold, tuple(sized), min_effect_deg)


def normal_score(statistic: Floats, freedom: Floats) -> Floats:
    """Convert a chi-squared statistic to a normal score (Wilson and Hilferty, PNAS 17, 684, 1931)."""
    spread = 2.0 / (9.0 * freedom)
    return (np.cbrt(np.maximum(statistic, 0.0) / freedom) - 1.0 + spread) / np.sqrt(spread)


def heading_hats(heading_deg: Floats, width_deg: float, fewest: float) -> Floats:
    """Build hat functions over the heading sectors with enough readings, (n, k)."""
    centres = np.arange(0.0, 360.0, width_deg)
    away = np.abs(angles.difference(heading_deg[:, None], centres)) / width_deg
    hats = np.maximum(1.0 - away, 0.0)
    return hats[:, hats.sum(axis=0) >= fewest]


def fourier_columns(angle_deg: Floats, harmonics: range) -> Floats:
    """Build sine and cosine of some multiples of an angle, (n, 2 k)."""
    return np.column_stack([x for k in harmonics for x in angles.sin_cos(k * angle_deg)])


def omnibus_groups(state: FittedModel) -> list[ColumnGroup]:
    """Build hats and thresholds of each covariate, harmonics and hats of the heading, and products."""
    covariates, groups = state.case.covariates, []
    heading = state.case.recorded_deg
    each = [
        fourier_columns(heading, range(3, 7)),
        heading_hats(heading, HEADING_HAT_DEG, FEWEST_IN_HAT),
        fourier_columns(heading, range(7, HEADING_HARMONICS + 1)),
    ]
    groups += [ColumnGroup("heading", hats, covariates=("heading",)) for hats in each]
    for name, column in covariates.items():
        if name in COVARIATE_PERIODS:
            groups.append(
                ColumnGroup(
                    name, fourier_columns(360.0 / COVARIATE_PERIODS[name] * column, range(1, 4)), covariates=(name,)
                )
            )
        elif name == "time":
            groups += [
                ColumnGroup(name, covariate_series.hat_columns(column, k), covariates=(name,)) for k in TIME_KNOTS
            ]
            groups += [*time_waves(column), *spell_groups(state)]
            tides = [fourier_columns(360.0 * column / (3600.0 * hours), range(1, 2)) for hours in TIDE_PERIODS_H]
            groups += [ColumnGroup(name, tide, covariates=(name,)) for tide in tides]
        elif name != "heading" and name not in covariate_series.TILT_CORRECTIONS:
            groups.append(ColumnGroup(name, covariate_series.hat_columns(column, COVARIATE_KNOTS), covariates=(name,)))
            onsets = np.unique(np.quantile(column, ONSET_QUANTILES))  # hats do not resolve a long tail
            steps = [(column > onset)[:, None].astype(float) for onset in onsets]
            groups += [ColumnGroup(name, step, covariates=(name,)) for step in steps]
    linear = {name: covariate_series.standardize(covariates[name]) for name in PRODUCT_COVARIATES if name in covariates}
    turning = np.column_stack([np.ones(len(heading)), fourier_columns(heading, range(1, 4))])
    for name, column in linear.items():
        groups.append(ColumnGroup(f"heading x {name}", turning * column[:, None], covariates=("heading", name)))
    for (a, x), (b, y) in itertools.combinations(linear.items(), 2):
        both = [u * v for u in _linear_and_square(x) for v in _linear_and_square(y)]
        groups.append(ColumnGroup(f"{a} x {b}", np.column_stack(both), covariates=(a, b)))
    return [replace(group, columns=_well_determined(group.columns)) for group in groups]


def time_waves(time_s: Floats) -> list[ColumnGroup]:
    """Build groups of one wave each: a single period is hardly detectable among all knots."""
    turns = 360.0 * (time_s - time_s[0]) / np.ptp(time_s)
    each = [fourier_columns(turns, range(k, k + 1)) for k in range(1, int(np.ptp(time_s) / SHORTEST_WAVE_S) + 1)]
    return [ColumnGroup("time", wave, covariates=("time",)) for wave in each]


def spell_groups(state: FittedModel) -> list[ColumnGroup]:
    """Build groups of one temporary offset of the reading each: it is hardly detectable among all knots."""
    time_s = state.case.scene.time_s
    begins = np.arange(time_s[0], time_s[-1], max(SPELL_STEP_S, float(np.ptp(time_s)) / 120.0))[1:]
    steps = [group.columns for group in step_columns(state, HeadingSlip, begins)]
    both = [(first, last) for length in SPELLS for first, last in zip(steps, steps[length:], strict=False)]
    return [ColumnGroup(SPELL, first - last, covariates=("time",)) for first, last in both]


def _well_determined(columns_deg: Floats) -> Floats:
    """Drop combinations of columns that only a few samples at the edge of the range determine.

    Of 36 harmonics over headings that spread by 34 degrees 22 remain; the others depend on single samples.
    """
    if columns_deg.shape[1] < 2:
        return columns_deg
    unit = columns_deg / np.maximum(np.linalg.norm(columns_deg, axis=0), 1e-300)
    values, vectors = np.linalg.eigh(unit.T @ unit)
    return np.asarray(unit @ vectors[:, values > FAINTEST_DIRECTION * values[-1]] * np.sqrt(len(unit)))


def _linear_and_square(x: Floats) -> tuple[Floats, Floats]:
    return x, x**2 - np.mean(x**2)


def score_tests(state: FittedModel, groups: Sequence[ColumnGroup], seed: int = 0) -> ScoreTests:
    """Compute the score tests of all groups."""
    groups = [group for group in groups if group.columns.shape[1]]
    ends = np.cumsum([group.columns.shape[1] for group in groups])
    white = state.whiten_and_project(np.concatenate([group.columns for group in groups], axis=1, dtype=np.float32))
    parts = np.split(white, ends[:-1], axis=1)
    bases = [whitened_basis(part) for part in parts]
    determined = [k for k, basis in enumerate(bases) if basis.shape[1]]
    groups, bases = [groups[k] for k in determined], [bases[k] for k in determined]
    freedom = np.array([basis.shape[1] for basis in bases], dtype=float)
    begins = np.concatenate([[0], np.cumsum(freedom)[:-1]]).astype(int)
    basis_all = np.concatenate(bases, axis=1)
    observed = np.add.reduceat((basis_all.T @ state.innovation) ** 2, begins) / state.sigma**2
    noise = np.add.reduceat((_resample_noise(state, seed) @ basis_all) ** 2, begins, axis=1) / state.sigma**2
    inflation = noise.mean(axis=0) / freedom
    handicap = np.array([SPELL_HANDICAP * (group.name == SPELL) for group in groups])
    highest = (normal_score(noise / inflation, freedom) - handicap).max(axis=1)
    uneven = np.array([_cluster_inflation(state, basis) for basis in bases])
    inflation = np.maximum(np.maximum(inflation, uneven), 1.0) * _slow_inflation(state, basis_all, begins, freedom)
    return ScoreTests(groups, freedom, inflation, normal_score(observed / inflation, freedom) - handicap, highest)


def group_size_deg(state: FittedModel, group: ColumnGroup, inflation: float) -> float:
    """Compute the visible size of a group's best fit with the noise contribution subtracted, rms degrees."""
    values, covariance = solve_group(state, group)
    columns = state.visible(group.columns)
    product = columns.T @ columns / len(columns)
    return float(np.sqrt(max(float(values @ product @ values) - inflation * float(np.sum(product * covariance)), 0.0)))


def solve_group(state: FittedModel, group: ColumnGroup) -> tuple[Floats, Floats]:
    """Fit columns to the residual: values and covariance."""
    white = state.whiten_and_project(group.columns)
    inverted = scaled_inverse(white.T @ white)
    return inverted @ (white.T @ state.innovation) / state.response, inverted * (state.sigma / state.response) ** 2


def _resample_noise(state: FittedModel, seed: int, repeats: int = NOISE_DRAWS) -> Floats:
    """Resample the record's own noise: blocks of innovations from random dates, with random signs, (repeats, n).

    Changes over weeks are removed first: a real drift must not raise the threshold for its own detection.
    """
    counts = np.isfinite(state.whitener.width_deg)
    trend = whitened_basis(state.whiten_and_project(designs.slow_hats(state.case.scene.time_s).astype(np.float32)))
    innovation = (state.innovation - trend @ (trend.T @ state.innovation))[counts].astype(np.float32)
    step = float(np.median(np.diff(state.case.scene.time_s)))
    length = int(np.clip(finding.HELD_OUT_BLOCK_S / step, 5, max(len(innovation) // 10, 5)))
    result = np.zeros((repeats, len(counts)), dtype=np.float32)
    result[:, counts] = resample_blocks(innovation, length, repeats, seed)
    return result


def _cluster_inflation(state: FittedModel, basis: Floats) -> float:
    """Compute the inflation of a group's statistic by clustered noise, 1 for homogeneous noise.

    Real water scatters more in some weeks and at some headings than the speed predicts. The group's own fit is removed,
    and the scores of blocks of days are squared (cluster-robust sandwich; Liang and Zeger, Biometrika 73, 1986).

    Args:
        basis: the group's whitened columns, orthonormal, (n, k).
    """
    block = blocks_by_span(state.case.scene.time_s, finding.RESIDUAL_MEMORY_S)
    scores = block_scores(basis, state.innovation, block)
    return float(np.sum(scores**2)) / basis.shape[1] / state.sigma**2 * len(scores) / max(len(scores) - 1, 1)


def _slow_inflation(state: FittedModel, basis_all: Floats, begins: NDArray[np.intp], freedom: Floats) -> Floats:
    """Compute the inflation of each group's statistic by slow noise beyond the reach of filter and blocks, (g,).

    Water veers for weeks. The power above white noise at periods of about a week inflates every group in proportion to
    the group's share of slow waves; drifts, steps and seasons hardly contribute at such short periods.

    Args:
        basis_all: orthonormal whitened columns of all groups, (n, k).
        begins: first column of each group, (g,).
        freedom: number of columns of each group, (g,).
    """
    days = float(np.ptp(state.case.scene.time_s)) / 86400.0
    monthly, weekly = (
        np.arange(int(days / longest), int(days / shortest) + 1)
        for longest, shortest in (SLOW_PERIODS_DAYS, WEEKLY_PERIODS_DAYS)
    )
    if len(weekly) < FEWEST_WAVES:
        return np.ones(len(freedom))
    heard = _wave_basis(state, weekly)
    power = np.sort((heard.T @ state.innovation) ** 2)[: round(TRIMMED_SHARE * heard.shape[1])] / state.sigma**2
    excess = float(power.mean()) / TRIMMED_MEAN
    share = np.add.reduceat(np.sum((basis_all.T @ _wave_basis(state, monthly)) ** 2, axis=1), begins) / freedom
    return 1.0 + max(excess - 1.0, 0.0) * share


def _wave_basis(state: FittedModel, number: NDArray[np.intp]) -> Floats:
    """Build an orthonormal basis of whitened and projected waves over the record."""
    time_s = state.case.scene.time_s
    phase = 360.0 * (time_s - time_s[0])[:, None] / np.ptp(time_s) * np.maximum(number, 1)
    return whitened_basis(state.whiten_and_project(np.column_stack(angles.sin_cos(phase)).astype(np.float32)))


@dataclass(frozen=True)
class HeadingCluster:
    """Readings that cluster at one heading."""

    recorded_deg: float  # heading of the cluster
    width_deg: float  # of the sector whose readings are drawn to it
    rms_deg: float  # rms heading error that it causes in the whole record


def sticking_sector(state: FittedModel) -> HeadingCluster | None:
    """Find the largest cluster of readings at one heading, None where there is none."""
    known = np.isfinite(state.heading_deg)
    recorded = state.case.recorded_deg[known]
    values = np.unique(recorded)
    if len(values) < 2 or np.median(np.diff(values)) > CELL_DEG / 4.0:
        return None
    time_s = state.case.scene.time_s[known]
    block = np.floor((time_s - time_s[0]) / SECTOR_BLOCK_S).astype(np.intp)
    cells = int(360.0 / CELL_DEG)
    cell = (angles.wrap360(state.heading_deg[known]) / CELL_DEG).astype(np.intp) % cells
    counts = np.bincount(block * cells + cell, minlength=(block[-1] + 1) * cells).reshape(-1, cells).astype(float)
    # Predict each cell's count by a parabola through its neighbours, (blocks, cells).
    away = np.arange(NEAREST_CELL, FARTHEST_CELL + 1.0)
    design = np.column_stack([np.ones(len(away)), away**2])
    weights = np.linalg.pinv(design)[0] / 2.0
    expected_by_cell = sum(
        w * (np.roll(counts, int(k), axis=1) + np.roll(counts, -int(k), axis=1))
        for w, k in zip(weights, away, strict=True)
    )
    excess = counts - expected_by_cell
    score = excess.sum(axis=0) / np.maximum(np.linalg.norm(excess, axis=0), 1.0)
    held, expected = counts.sum(axis=0), np.maximum(expected_by_cell.sum(axis=0), 1.0)
    clustered = (score > CLUSTER_SIGMAS) & (held > CLUSTER_RATIO * expected) & (held >= FEWEST_IN_CLUSTER)
    if not clustered.any():
        return None
    k = int(np.argmax(np.where(clustered, held, 0.0)))
    around, middle = np.roll(held, cells // 2 - k), len(held) // 2
    both_sides = np.array([around[middle - j] + around[middle + j] for j in range(1, WIDEST_SECTOR + 1)])
    dense = np.convolve(both_sides, np.full(RIM_CELLS, 1.0 / RIM_CELLS), "valid").max()
    reach = int(np.argmax(both_sides >= EMPTIED_SHARE * dense))
    inside = float(around[middle - reach : middle + reach + 1].sum())
    width = CELL_DEG * (2 * reach + 1)
    share = inside / len(state.case)
    return HeadingCluster(float(angles.mean(recorded[cell == k])), width, width / float(np.sqrt(12.0 / share)))


def observed_outside(case: LongComparison, cluster: HeadingCluster) -> Floats:
    """Mask the observed headings, (n,) degrees, with NaN where the reading sticks."""
    away = np.abs(angles.difference(case.recorded_deg, cluster.recorded_deg))
    return np.where(away > cluster.width_deg / 2.0, case.observed_deg, np.nan)
