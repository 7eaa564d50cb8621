"""Find sectors in which a compass sticks.

Its readings accumulate at one heading and are missing on both sides of it: the histogram shows this, the mean residual
hardly does. Corrected headings are counted, since readings of a two-valued compass accumulate where they turn.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.inference import design
from compasslib.inference.comparison import FEWEST_PAIRS
from compasslib.inference.design import FittedModel

CELL_DEG = 2.0  # width of the cells of the heading histogram
NEAREST_CELL, FARTHEST_CELL = 2, 8  # cells on either side that predict the one in the middle
SECTOR_BLOCK_S = 5 * 86400.0  # a sphere keeps its heading for days: counts within a block are correlated
CLUSTER_SIGMAS = 5.0  # excess of a cluster over its standard error from the scatter between blocks
CLUSTER_RATIO = 2.5  # count of a cluster over what its neighbours predict
# Most cells from the cluster to the sector's edge; cells averaged for the density outside; its share at the edge.
WIDEST_SECTOR, RIM_CELLS, EMPTIED_SHARE = 30, 4, 0.4


@dataclass(frozen=True)
class HeadingCluster:
    """Readings that cluster at one heading."""

    recorded_deg: float  # heading of the cluster
    width_deg: float  # of the sector whose readings are drawn to it
    rms_deg: float  # rms heading error that it causes in the whole record


def sticking_sector(fitted: FittedModel) -> HeadingCluster | None:
    """Find the largest cluster of readings at one heading, None where there is none."""
    known = np.isfinite(fitted.heading_deg)
    recorded = fitted.comparison.recorded_deg[known]
    values = np.unique(recorded)
    if len(values) < 2 or np.median(np.diff(values)) > CELL_DEG / 4.0:
        return None
    time_s = fitted.comparison.scene.time_s[known]
    block = np.floor((time_s - time_s[0]) / SECTOR_BLOCK_S).astype(np.intp)
    cells = int(360.0 / CELL_DEG)
    cell = (angles.wrap360(fitted.heading_deg[known]) / CELL_DEG).astype(np.intp) % cells
    counts = np.bincount(block * cells + cell, minlength=(block[-1] + 1) * cells).reshape(-1, cells).astype(float)
    # Predict each cell's count by a parabola through its neighbours, (blocks, cells).
    away = np.arange(NEAREST_CELL, FARTHEST_CELL + 1)
    weights = np.linalg.pinv(np.column_stack([np.ones(len(away)), away**2.0]))[0] / 2.0
    neighbours = [np.roll(counts, k, axis=1) + np.roll(counts, -k, axis=1) for k in away.tolist()]
    expected_by_cell = np.tensordot(weights, neighbours, 1)
    excess = counts - expected_by_cell
    score = excess.sum(axis=0) / np.maximum(np.linalg.norm(excess, axis=0), 1.0)
    held, expected = counts.sum(axis=0), np.maximum(expected_by_cell.sum(axis=0), 1.0)
    clustered = (score > CLUSTER_SIGMAS) & (held > CLUSTER_RATIO * expected)
    if not clustered.any():
        return None
    k = int(np.argmax(np.where(clustered, held, 0.0)))
    around, middle = np.roll(held, cells // 2 - k), len(held) // 2
    both_sides = np.array([around[middle - j] + around[middle + j] for j in range(1, WIDEST_SECTOR + 1)])
    dense = np.convolve(both_sides, np.full(RIM_CELLS, 1.0 / RIM_CELLS), "valid").max()
    reach = int(np.argmax(both_sides >= EMPTIED_SHARE * dense))
    inside = float(around[middle - reach : middle + reach + 1].sum())
    width = CELL_DEG * (2 * reach + 1)
    share = inside / len(fitted.comparison)
    return HeadingCluster(float(angles.mean(recorded[cell == k])), width, width / float(np.sqrt(12.0 / share)))


def exclude_sticking(initial: FittedModel) -> tuple[FittedModel, HeadingCluster | None]:
    """Evaluate a model without the readings of a sector in which the compass sticks, as they mimic effects."""
    comparison, cluster = initial.comparison, sticking_sector(initial)
    if cluster is None:
        return initial, None
    away = np.abs(angles.difference(comparison.recorded_deg, cluster.recorded_deg))
    observed = np.where(away > cluster.width_deg / 2.0, comparison.observed_deg, np.nan)
    outside = replace(comparison, observed_deg=observed)
    if design.count_usable(outside, initial.simulation, initial.nuisance) < FEWEST_PAIRS:
        return initial, cluster
    return design.evaluate_model(outside, initial.simulation, initial.nuisance), cluster
