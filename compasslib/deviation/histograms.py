"""Histograms of headings and directions before and after the correction (von Appen 2015, Figs 8 and 9)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.preparation.clocks import nearest_index
from compasslib.records import BAD, Pairs, Record
from compasslib.types import Floats

Counts = NDArray[np.int_]

BIN_DEG = 5.0
BINS = round(360.0 / BIN_DEG)
# Lower edge of the first bin of each quantity in histograms.csv, degrees.
QUANTITIES = {
    "heading_recorded": 0.0,
    "heading_corrected": 0.0,
    "direction_recorded": 0.0,
    "direction_corrected": 0.0,
    "direction_reference": 0.0,
    "difference_before": -180.0,
    "difference_after": -180.0,
}


def count_angles(angle_deg: ArrayLike, from_deg: float = 0.0) -> Counts:
    """Count angles, without NaN, in bins of 5 degrees over one turn from a lower edge, (72,)."""
    angle = np.asarray(angle_deg, dtype=float)
    turn = angles.wrap360(angle[np.isfinite(angle)] - from_deg)
    return np.bincount((turn / BIN_DEG).astype(int), minlength=BINS)[:BINS]


def count_differences(east: Floats, north: Floats, pairs: Pairs) -> Counts:
    """Count the directions of a current at the pairs minus the reference's, (72,) from -180 degrees."""
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    return count_angles(angles.difference(angles.direction(east, north), lower), -180.0)


def directions_at_pairs(pairs: Pairs, time_s: Floats, heading_corrected_deg: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute directions at each pair, (n,) degrees each: reference, affected as recorded, affected corrected."""
    lower = angles.direction(pairs.lower_east, pairs.lower_north)
    upper = angles.direction(pairs.upper_east, pairs.upper_north)
    if not (len(pairs) and len(time_s)):
        return lower, upper, np.full(upper.shape, np.nan)
    near = nearest_index(time_s, pairs.time_s)
    known = np.abs(time_s[near] - pairs.time_s) <= 60.0  # files round times
    turned = angles.difference(heading_corrected_deg[near], pairs.heading_deg)
    return lower, upper, angles.wrap360(np.where(known, upper + turned, np.nan))


def build_histograms(
    record: Record, heading_corrected_deg: Floats, pairs: Pairs, differences: Mapping[str, ArrayLike]
) -> dict[str, Counts]:
    """Count headings of the record, directions at the pairs and held-out differences (those of assessment.json)."""
    usable = np.where(record.heading_quality < BAD, record.heading_deg, np.nan)
    lower, upper, corrected = directions_at_pairs(pairs, record.time_s, heading_corrected_deg)
    counted = [count_angles(angle) for angle in (usable, heading_corrected_deg, upper, corrected, lower)]
    counted += [np.asarray(differences[when], dtype=int) for when in ("before", "after")]
    return dict(zip(QUANTITIES, counted, strict=True))
