"""Sectors in which a compass hangs: readings heap up at one heading and are missing beside it.

What hangs reads too much on one side and too little on the other: the mean residual hardly sees it, the histogram does.
It is counted in corrected headings, since a folded compass by itself heaps its readings up where it turns back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.inference.baseline import State
from compasslib.inference.case import Case
from compasslib.types import Floats

BIN_DEG = 2.0  # width of the cells in which readings heap up
NEAREST, FARTHEST = 2, 8  # bins on either side that foretell the one between
BLOCK_S = 5 * 86400.0  # a sphere stays where it is for days
SIGMAS = 5.0  # by the scatter from block to block
TIMES = 2.5  # what a heap holds over what its neighbours foretell
FEWEST = 30  # readings in a heap
WIDEST, RIM, EMPTIED = 30, 4, 0.4  # bins on either side that a sector may reach; bins and share of the density beside


@dataclass(frozen=True)
class Heap:
    """Readings that heap up."""

    recorded_deg: float  # where they do
    width_deg: float  # of the sector that they came from
    rms_deg: float  # what it does to the headings of the whole record


def heap(state: State) -> Heap | None:
    """Return the largest heap of readings, None where there is none."""
    known = np.isfinite(state.heading_deg)
    recorded = state.case.recorded_deg[known]
    if _resolution_deg(recorded) > BIN_DEG / 4.0:
        return None
    time_s = state.case.scene.time_s[known]
    block = np.floor((time_s - time_s[0]) / BLOCK_S).astype(np.intp)
    cells = int(360.0 / BIN_DEG)
    cell = (angles.wrap360(state.heading_deg[known]) / BIN_DEG).astype(np.intp) % cells
    counts = np.bincount(block * cells + cell, minlength=(block[-1] + 1) * cells).reshape(-1, cells).astype(float)
    foretold = _foretold(counts)
    excess = counts - foretold
    score = excess.sum(axis=0) / np.maximum(np.linalg.norm(excess, axis=0), 1.0)
    held, expected = counts.sum(axis=0), np.maximum(foretold.sum(axis=0), 1.0)
    heaped = (score > SIGMAS) & (held > TIMES * expected) & (held >= FEWEST)
    if not heaped.any():
        return None
    k = int(np.argmax(np.where(heaped, held, 0.0)))
    reach, inside = _sector(np.roll(held, cells // 2 - k))
    width = BIN_DEG * (2 * reach + 1)
    share = inside / len(state.case)
    return Heap(float(angles.mean(recorded[cell == k])), width, width / float(np.sqrt(12.0 / share)))


def outside(case: Case, heap: Heap) -> Floats:
    """Return the headings that the reference's side shows, NaN where the reading hangs, (n,) degrees.

    Args:
        heap: where its readings heap up.
    """
    away = np.abs(angles.difference(case.recorded_deg, heap.recorded_deg))
    return np.where(away > heap.width_deg / 2.0, case.observed_deg, np.nan)


def _sector(held: Floats) -> tuple[int, float]:
    """Return how many cells on either side of the middle one are emptied, and the readings in all of them."""
    middle = len(held) // 2
    beside = np.array([held[middle - k] + held[middle + k] for k in range(1, WIDEST + 1)])
    dense = np.convolve(beside, np.full(RIM, 1.0 / RIM), "valid").max()
    reach = int(np.argmax(beside >= EMPTIED * dense))
    return reach, float(held[middle - reach : middle + reach + 1].sum())


def _foretold(counts: Floats) -> Floats:
    """Return what each cell's neighbours foretell for it, by a parabola through them, (blocks, cells)."""
    away = np.arange(NEAREST, FARTHEST + 1.0)
    design = np.column_stack([np.ones(len(away)), away**2])
    weights = np.linalg.pinv(design)[0] / 2.0
    return sum(
        w * (np.roll(counts, int(k), axis=1) + np.roll(counts, -int(k), axis=1))
        for w, k in zip(weights, away, strict=True)
    )


def _resolution_deg(recorded_deg: Floats) -> float:
    values = np.unique(recorded_deg)
    return float(np.median(np.diff(values))) if len(values) > 1 else np.inf
