"""Checks of a long record beside the search: sectors in which its compass sticks, and storms known by an index.

At a sticking heading readings accumulate, and are missing on both sides: the histogram shows this, the mean residual
hardly does. Corrected headings are counted, since readings of a two-valued compass accumulate where they turn.

A storm index shows that magnetic north moved, but not in which direction: the cause is named, nothing is corrected.
Significance comes from shifting the index in time, which preserves its storms and their autocorrelation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.effects.earth import IndexedDisturbance
from compasslib.inference import finding
from compasslib.inference.comparison import CANCELS, LongComparison, build_finding
from compasslib.inference.design import FittedModel
from compasslib.inference.finding import CovariateRange, Finding, HeldOut, Parameter
from compasslib.types import Floats

CELL_DEG = 2.0  # width of the cells of the heading histogram
NEAREST_CELL, FARTHEST_CELL = 2, 8  # cells on either side that predict the one in the middle
SECTOR_BLOCK_S = 5 * 86400.0  # a sphere keeps its heading for days: counts within a block are correlated
CLUSTER_SIGMAS = 5.0  # excess of a cluster over its standard error from the scatter between blocks
CLUSTER_RATIO = 2.5  # count of a cluster over what its neighbours predict
# Most cells from the cluster to the sector's edge; cells averaged for the density outside; its share at the edge.
WIDEST_SECTOR, RIM_CELLS, EMPTIED_SHARE = 30, 4, 0.4

STORM_SIZES_NT = np.geomspace(0.3, 100.0, 8)  # perpendicular to magnetic north, per unit of ap
STORM_SHIFTS, NEAREST_SHIFT_S = 400, 5 * 86400.0  # shifts of the index in time, and the least one; storms last for days
STORM_BLOCKS = 12  # blocks of a record for the jackknife
STORMY_QUANTILE = 0.9  # quantile of the index from which a time is stormy
STORM_PHYSICS = (
    "magnetic north is unsteady where the index of storms is high; its course only an observatory could tell. "
    "Nothing is corrected by it"
)


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


def observed_outside(comparison: LongComparison, cluster: HeadingCluster) -> Floats:
    """Mask the observed headings, (n,) degrees, with NaN where the reading sticks."""
    away = np.abs(angles.difference(comparison.recorded_deg, cluster.recorded_deg))
    return np.where(away > cluster.width_deg / 2.0, comparison.observed_deg, np.nan)


def storm_finding(fitted: FittedModel, alarm: float = 0.006) -> Finding | None:
    """Test whether directions scatter with the storm index; None if they do not, or without an index.

    Args:
        fitted: fitted model with all terms that were found.
        alarm: probability of a false finding from noise alone.
    """
    scene, width = fitted.comparison.scene, fitted.whitener.width_deg
    if (IndexedDisturbance.name, CANCELS) in fitted.comparison.not_testable or "storm_index" not in scene.departures:
        return None
    known = np.isfinite(width) & np.isfinite(fitted.residual_deg)
    index = scene.departures["storm_index"]
    unit = index / scene.horizontal_nT / angles.DEGREE  # degrees for 1 nT per unit of ap
    ratio = np.clip(fitted.residual_deg[known] / width[known], -finding.MOST_WIDTHS, finding.MOST_WIDTHS)
    squares, share = ratio**2, (unit[known] / width[known]) ** 2
    if not share.any() or (chance := _chance_of_shifts(scene.time_s[known], squares, share)) > alarm:
        return None
    block = np.arange(len(share)) * STORM_BLOCKS // len(share)
    size = _storm_size(squares, share)
    sizes = np.array([_storm_size(squares[block != k], share[block != k]) for k in range(STORM_BLOCKS)])  # jackknife
    gains = np.array([_storm_gains(x, squares, share)[block == k].sum() for k, x in enumerate(sizes.tolist())])
    sigma = float(np.std(sizes) * np.sqrt(STORM_BLOCKS - 1))
    spread, rms_deg = 1.96 * float(np.std(gains) * np.sqrt(STORM_BLOCKS)), angles.rms(fitted.residual_deg[known])
    interval = float(gains.sum()) - spread, float(gains.sum()) + spread
    low, high = np.quantile(index, [STORMY_QUANTILE, 1.0]).tolist()
    return build_finding(
        fitted.comparison,
        IndexedDisturbance(),
        {IndexedDisturbance.name: 1.0},
        {"nT_ap": Parameter(size, sigma, "nT")},
        size_deg=size * angles.rms(unit),
        proof=HeldOut(rms_deg, rms_deg, float(gains.sum()), interval, chance, method="shifts"),
        place=CovariateRange("storm_index", low, high, f"where ap is {low:.0f} to {high:.0f}"),
        span_s=observatory.strongest_disturbance(scene.time_s, index),
        physics=f"{STORM_PHYSICS}; the index at other dates does as well {chance:.1%} of the time",
    )


def _storm_gains(size_nT: float, squares: Floats, share: Floats) -> Floats:
    """Compute the log-likelihood gain of each sample over homogeneous noise, with free noise width, (n,).

    Args:
        size_nT: per unit of ap.
        squares: squared ratio of residual to width, clipped, (n,).
        share: variance for 1 nT per unit of ap, relative to the noise, (n,).
    """
    variance = 1.0 + size_nT**2 * share
    width, even = np.mean(squares / variance), np.mean(squares)
    return np.asarray((squares / even - squares / variance / width - np.log(variance * width / even)) / 2.0)


def _storm_size(squares: Floats, share: Floats) -> float:
    """Find the likeliest size, nT per unit of ap."""
    from scipy.optimize import minimize_scalar

    limits = np.log(STORM_SIZES_NT[[0, -1]])
    likeliest = minimize_scalar(lambda log: -np.sum(_storm_gains(np.exp(log), squares, share)), bounds=limits)
    return float(np.exp(likeliest.x))


def _chance_of_shifts(time_s: Floats, squares: Floats, share: Floats) -> float:
    """Estimate the p-value of the gain from shifts of the index in time."""
    nearest = int(NEAREST_SHIFT_S / max(float(np.median(np.diff(time_s))), 1.0)) + 1
    count = min(STORM_SHIFTS, max(len(time_s) - 2 * nearest, 1))
    shifts = [0, *np.linspace(nearest, len(time_s) - nearest, count).astype(int).tolist()]
    gains = [max(np.sum(_storm_gains(x, squares, np.roll(share, k))) for x in STORM_SIZES_NT.tolist()) for k in shifts]
    return (1 + int(np.sum(np.array(gains[1:]) >= gains[0]))) / (1 + count)
