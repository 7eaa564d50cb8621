"""Test for a mismatch that no listed effect explains, and for sectors in which a compass sticks.

Scores of many groups of columns are tested jointly against resamples of the record's own noise. The readings of a
sticking compass accumulate at one heading and are missing on both sides of it: the histogram shows this, the mean
residual hardly does. Corrected headings are counted, since readings of a two-valued compass accumulate where they turn.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.inference.comparison import LongComparison
from compasslib.inference.design import ColumnGroup, FittedModel
from compasslib.types import Floats

COVARIATE_KNOTS = 8  # number of hat functions of a covariate
HEADING_HAT_DEG, FEWEST_IN_HAT = 6.0, 30  # width of heading sectors; least sum of weights in one
FAINTEST_DIRECTION = 1e-2  # least eigenvalue, relative to the largest, of a combination of columns that is kept

NOISE_DRAWS = 300  # noise realizations: they determine the precision of the threshold

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
