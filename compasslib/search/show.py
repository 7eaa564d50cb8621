"""Whether the fit improves on days that it has not seen, and where.

The interval of a gain comes from blocks of days: neighbouring hours repeat each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import deviation
from compasslib.core import angles, compass
from compasslib.core.records import Pairs, take
from compasslib.core.types import Floats
from compasslib.deviation import model as fits
from compasslib.deviation import von_appen
from compasslib.deviation.model import Fit
from compasslib.search import wording
from compasslib.search.baseline import State
from compasslib.stats import blocks, robust

BLOCK_S = 10 * 86400.0  # longer than any memory of the water that a filter leaves
FOLDS = 5  # parts of a recording that are left out in turn
RANGE = (0.05, 0.95)  # quantiles of a covariate that tell where an effect lives
FARTHEST = 3.0  # robust widths beyond which a residual counts no more
REPEATS = 1000  # draws of blocks, which set the smallest p-value
PROVEN = 0.05  # p-value on held-out days above which a finding does not touch the product
WORSE = 1.1  # growth of the rms that is no chance of weights: the score, which is judged, clips outliers
BINS, FEWEST_IN_BIN = 18, 10  # of a figure's curve
LOST_DEG = 90.0  # residual of a heading that a fit cannot give
MEMORY_S = 2 * 86400.0  # the residual's own memory, for the error of a bin


@dataclass(frozen=True)
class HeldOut:
    """What terms add on days that were not fitted."""

    rms_before_deg: float
    rms_after_deg: float
    gain: float  # log score, all held-out samples together
    gain_interval: tuple[float, float]  # 95 %, from the blocks
    p_value: float  # share of drawn blocks whose gain is not positive
    method: str | None = None  # how days were held out: fifths | within_event
    anew: float | None = None  # gain where every hypothesis is weighed anew without the days, not sizes only

    @property
    def refuted(self) -> bool:
        """Whether held-out data deny what was found rather than confirm it: they agree worse with it."""
        return self.gain < 0.0 or (self.p_value >= PROVEN and self.rms_after_deg > WORSE * self.rms_before_deg)

    def to_json(self) -> dict[str, object]:
        """Return it for diagnosis.json."""
        return {
            "rms_before_deg": self.rms_before_deg,
            "rms_after_deg": self.rms_after_deg,
            "log_score_gain": self.gain,
            "log_score_gain_interval": list(self.gain_interval),
            "p_value": self.p_value,
            "method": self.method,
            "log_score_gain_anew": self.anew,
        }


@dataclass(frozen=True)
class BinnedResidual:
    """The residual along one covariate, before and after; what the fitted compass can take of it is taken."""

    covariate: str
    centre: Floats  # (b,) middle of each bin
    before_deg: Floats  # (b,)
    after_deg: Floats
    sigma_deg: Floats
    compared: str = ""  # what was, where a recording holds more than one comparison


def left_out(pairs: Pairs, fit: Fit) -> Floats:
    """Return the observed heading minus that of a fit of the same method to the other half of the blocks, (n,) degrees.

    What no heading explains is as far off as chance takes it.

    Args:
        fit: to all of them.
    """
    block = blocks.of_span(pairs.time_s, BLOCK_S)
    observed, left = fits.observed_heading(pairs), np.full(len(pairs), LOST_DEG)
    for out in (block % 2 == 0, block % 2 == 1):
        again = deviation.fit(fit.method, take(pairs, ~out), fit)
        if again.fitted:
            left[out] = angles.difference(observed, _corrected(again, pairs, observed))[out]
    return np.where(np.isfinite(left), left, LOST_DEG)


def _corrected(fit: Fit, pairs: Pairs, observed_deg: Floats) -> Floats:
    if fit.method == "von_appen":
        return von_appen.invert(fit.coefficients, pairs.heading_deg)
    return fits.nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed_deg)


def compared(before_deg: Floats, after_deg: Floats, width_deg: Floats, time_s: Floats) -> HeldOut:
    """Return what a change that was not fitted to the directions does to their residual.

    Args:
        before_deg: residual before, (n,), degrees.
        after_deg: the same after.
        width_deg: width of the residual, (n,), degrees.
    """
    block = blocks.of_span(time_s, BLOCK_S)
    sizes = [np.abs(angles.wrap180(np.nan_to_num(left))) / width_deg for left in (before_deg, after_deg)]
    squares = [np.minimum(size, robust.CLIP) ** 2 for size in sizes]
    return judged((squares[0] - squares[1]) / 2.0, block, (angles.rms(before_deg), angles.rms(after_deg)))


def improved(before_deg: Floats, after_deg: Floats, width_deg: float, block: NDArray[np.intp]) -> HeldOut:
    """Return by how much a residual of one width became smaller, what is far off counting no more than near.

    Args:
        before_deg: (n,).
        after_deg: (n,).
        block: number of the block of each, (n,).
    """
    squares = [np.minimum(np.abs(left) / width_deg, FARTHEST) ** 2 for left in (before_deg, after_deg)]
    return judged((squares[0] - squares[1]) / 2.0, block, (angles.rms(before_deg), angles.rms(after_deg)))


def judged(each: Floats, block: NDArray[np.intp], rms_deg: tuple[float, float]) -> HeldOut:
    """Return a gain with its interval and p-value from blocks drawn again.

    Args:
        each: gain of each sample's log score, (n,).
        block: number of the block of each, (n,).
        rms_deg: of the residual, before and after.
    """
    sums = blocks.sums(each, block)
    drawn = np.random.default_rng(0).choice(sums, (REPEATS, len(sums))).sum(axis=1)
    low, high = np.quantile(drawn, [0.025, 0.975])
    share = float((np.sum(drawn <= 0.0) + 1) / (REPEATS + 1))
    return HeldOut(*rms_deg, float(sums.sum()), (float(low), float(high)), share)


def curve(before: State, after: State, covariate: str) -> BinnedResidual:
    """Return the residual in bins of a covariate, with and without the terms; what tells nothing is in no bin."""
    x = before.case.covariates[covariate]
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
    if covariate == "heading":
        edges = np.arange(0.0, 361.0, 360.0 / (2 * BINS))
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    finite = np.isfinite(before.whitener.width_deg) & np.isfinite(after.whitener.width_deg)
    filled = np.flatnonzero(np.bincount(bins[finite], minlength=len(edges) - 1) >= FEWEST_IN_BIN)
    (first, _), (second, sigma) = (_binned(state, bins, len(edges) - 1) for state in (before, after))
    return BinnedResidual(
        covariate, (edges[filled] + edges[filled + 1]) / 2.0, first[filled], second[filled], sigma[filled]
    )


def turn(state: State, effect: str, turned_deg: Floats) -> BinnedResidual:
    """Return the residual in bins of the turn that a fitted effect foretells, without the effect and with it.

    Where the effect is there, what it leaves out follows the line on which both are equal, however small it is.

    Args:
        turned_deg: by the effect, as far as the fitted compass cannot take it, (n,).
    """
    finite = np.isfinite(state.whitener.width_deg)
    edges = np.unique(np.quantile(turned_deg[finite], np.linspace(0.0, 1.0, BINS // 2 + 1)))
    bins = np.clip(np.searchsorted(edges, turned_deg, side="right") - 1, 0, len(edges) - 2)
    count = len(edges) - 1
    left, sigma = _binned(state, bins, count)
    weight = np.where(finite, state.whitener.width_deg, np.inf) ** -2.0
    middle = np.bincount(bins, weight * turned_deg, count) / np.maximum(np.bincount(bins, weight, count), 1e-300)
    return BinnedResidual(f"{wording.TURN}{effect}", middle, left + middle, left, sigma)


def _binned(state: State, bins: NDArray[np.intp], count: int) -> tuple[Floats, Floats]:
    """Return mean residual and its standard error in each bin, by width; blocks of days count as one each.

    The error is never under what the blocks of all bins together make likely: the few of one bin may agree by chance,
    and on nulls some bins then lay seven of their own standard errors off.
    """
    width = state.whitener.width_deg
    weight, left = width**-2.0, state.standard * np.where(np.isfinite(width), width, 0.0)  # no root: no weight
    total = np.maximum(np.bincount(bins, weight, count), 1e-12)
    mean = np.bincount(bins, weight * left, count) / total
    time_s = state.case.scene.time_s
    block = np.floor((time_s - time_s[0]) / MEMORY_S).astype(int)
    sums = np.bincount(block * count + bins, weight * (left - mean[bins]), (block[-1] + 1) * count)
    own = np.sum(sums.reshape(-1, count) ** 2, axis=0)
    return mean, np.sqrt(np.maximum(own, total * own.sum() / total.sum())) / total
