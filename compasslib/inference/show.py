"""Whether the fit improves on days that it has not seen, and where.

The interval of a gain comes from blocks of days: neighbouring hours repeat each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.statistics import blocks
from compasslib.types import Floats

BLOCK_S = 10 * 86400.0  # longer than any memory of the water that a filter leaves
FOLDS = 5  # parts of a recording that are left out in turn
RANGE = (0.05, 0.95)  # quantiles of a covariate that tell where an effect lives
FARTHEST = 3.0  # robust widths beyond which a residual counts no more
REPEATS = 1000  # draws of blocks, which set the smallest p-value
PROVEN = 0.05  # p-value on held-out days above which a finding is refuted where they agree worse
WORSE = 1.1  # growth of the rms that is no chance of weights: the score, which is judged, clips outliers
BINS = 18  # of a figure's curve
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


UNTESTED = HeldOut(np.nan, np.nan, np.nan, (np.nan, np.nan), np.nan)


@dataclass(frozen=True)
class BinnedResidual:
    """The residual along one covariate, before and after; what the fitted compass can take of it is taken."""

    covariate: str
    centre: Floats  # (b,) middle of each bin
    before_deg: Floats  # (b,)
    after_deg: Floats
    sigma_deg: Floats
    compared: str = ""  # what was, where a recording holds more than one comparison


def improved(before_deg: Floats, after_deg: Floats, width_deg: Floats | float, block: NDArray[np.intp]) -> HeldOut:
    """Return by how much a residual became smaller, what is far off counting no more than near.

    Args:
        before_deg: (n,).
        after_deg: (n,).
        width_deg: width of the residual, (n,) or one.
        block: number of the block of each, (n,).
    """
    sizes = [np.abs(angles.wrap180(np.nan_to_num(left))) / width_deg for left in (before_deg, after_deg)]
    squares = [np.minimum(size, FARTHEST) ** 2 for size in sizes]
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
