"""Whether the reference's record is the affected one's own: its bins again, rounded, rescaled, averaged or shifted.

Two instruments never agree to a millimetre a second, whatever their compasses: pings and the water between them differ.
Speeds know no compass. A deeper cell of the same profiler, given at its own depth, is water of its own and passes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib.preparation.gridding import nearest
from compasslib.records import Record
from compasslib.statistics import robust
from compasslib.types import Complexes, Floats

HOUR_S = 3600.0
# Difference that no two instruments keep under, and the same as a share of a table's last digit.
ALIKE_M_S, ROUNDED = 2e-3, 0.5
SMALL = 0.1  # of the scatter of the speeds: in still water two instruments may agree by having nothing to measure
LAGS_H, SHIFTED_H = np.arange(-12, 13), 6  # hours over which an average may reach, and by which stamps may be shifted
FEWEST, MOST = 100, 500  # samples that are compared
WIDEST = 3  # neighbouring bins that an export may have averaged
OFF_M = 5.0  # from its cells' depth, beyond what a nominal depth may be wrong by


@dataclass(frozen=True)
class CellSeries:
    """Velocities of one cell, or of some neighbouring ones averaged."""

    velocity: Complexes  # (n,) NaN where none
    depth_m: float
    bins: range


@dataclass(frozen=True)
class Matched:
    """Some of the reference's velocities, and where the affected record was measured hours before and after."""

    velocity: Complexes  # (k,)
    place: NDArray[np.intp]  # (k, lags)
    there: NDArray[np.bool_]  # (k, lags)
    least_m_s: float  # what rounding explains


def one_recording(upper: Record, lower: Record, bins: int) -> str:
    """Return why the reference's record is the affected one's own, nothing where it is not.

    Args:
        upper: the affected instrument on the grid of the pairs.
        bins: how many of the nearest bins are averaged for a pair.
    """
    if len(upper.time_s) < FEWEST or len(lower.time_s) < FEWEST:
        return ""
    for trusted in _near(upper, lower, bins):
        met = _matched(trusted, upper.time_s, lower.time_s)
        for own in _runs(upper):
            shared, off_m = own.bins.start < bins, abs(own.depth_m - trusted.depth_m)
            if (shared or off_m > OFF_M) and (_same(own, met) or (own.bins.start == 0 and _averaged(own, met))):
                return _reason(own, shared, off_m)
    return ""


def _near(upper: Record, lower: Record, bins: int) -> Iterator[CellSeries]:
    """Give the trusted cells that pairs may take, each by itself and averaged."""
    velocity, depth = lower.east + 1j * lower.north, lower.bin_depth_m()
    away = np.abs(np.nanmedian(depth, axis=0) - np.nanmedian(upper.depth_m))
    order = sorted(np.argsort(away, kind="stable")[:bins].tolist())
    for run in [order, *([k] for k in order if len(order) > 1)]:
        yield CellSeries(velocity[:, run].mean(axis=1), float(np.nanmedian(depth[:, run])), range(run[0], run[-1] + 1))


def _matched(trusted: CellSeries, upper_s: Floats, lower_s: Floats) -> Matched:
    some = np.flatnonzero(np.isfinite(trusted.velocity))
    some = some[:: 1 + len(some) // MOST]
    wanted = lower_s[some, None] - HOUR_S * LAGS_H
    place = nearest(upper_s, wanted.ravel()).reshape(wanted.shape)
    velocity = trusted.velocity[some]
    return Matched(velocity, place, np.abs(upper_s[place] - wanted) <= HOUR_S / 2.0, ROUNDED * _last_digit(velocity))


def _last_digit(velocity: Complexes) -> float:
    """Return the step of a table's numbers, 0 where they have none that shows."""
    steps = []
    for x in (velocity.real, np.abs(velocity)):
        values = np.unique(np.round(x, 6))
        steps.append(float(np.min(np.diff(values))) if 1 < len(values) < len(x) / 2 else 0.0)
    return max(steps)


def _runs(upper: Record) -> Iterator[CellSeries]:
    velocity, depth = upper.east + 1j * upper.north, upper.bin_depth_m()
    for wide in range(1, WIDEST + 1):
        for first in range(velocity.shape[1] - wide + 1):
            run = range(first, first + wide)
            yield CellSeries(velocity[:, run].mean(axis=1), float(np.nanmedian(depth[:, run])), run)


def _same(own: CellSeries, met: Matched) -> bool:
    """Tell whether two series have the same speeds, but for a factor, at one lag for all."""
    found, wanted = np.abs(own.velocity), np.abs(met.velocity)
    near = np.flatnonzero(np.abs(LAGS_H) <= SHIFTED_H)
    columns = np.where(met.there[:, near], found[met.place[:, near]], np.nan)
    return any(_equal(column, wanted, met.least_m_s) for column in columns.T)


def _equal(first: NDArray, second: NDArray, least: float) -> bool:
    """Tell whether two series are alike but for a factor to what no two instruments keep under."""
    known = np.isfinite(first)
    if known.sum() < FEWEST:
        return False
    first, second = first[known], second[known]
    sizes = np.median(np.abs(first)), np.median(np.abs(second))
    if min(sizes) <= 0.0:
        return False
    factor = sizes[1] / sizes[0]
    off = robust.width(first - second / factor)
    return off < max(ALIKE_M_S, least / factor) and off < SMALL * float(np.std(first))


def _averaged(own: CellSeries, met: Matched) -> bool:
    """Tell whether a weighted mean over hours of one velocity, turned by a constant, is the other."""
    columns = own.velocity[met.place]
    whole = met.there.all(axis=1) & np.isfinite(columns).all(axis=1)
    if whole.sum() < FEWEST:
        return False
    weight, *_ = np.linalg.lstsq(columns[whole], met.velocity[whole], rcond=None)
    return _equal(columns[whole] @ weight, met.velocity[whole], met.least_m_s)


def _reason(own: CellSeries, shared: bool, off_m: float) -> str:
    first, last = own.bins.start + 1, own.bins.stop
    which = f"bin {first}" if first == last else f"bins {first} to {last}"
    why = "whose water every pair already holds" if shared else f"given {off_m:.0f} m from their depth"
    return (
        "the two instruments recorded the same velocities: one recording was given twice, and no pair counts (those "
        f"of the reference are {which} of the affected one, {why})"
    )
