"""The current of one bin as a product holds it, and what the reference measured, to be looked at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compasslib.archive.files import get, opened
from compasslib.archive.netcdf import DAYS_1950_TO_1970
from compasslib.records import BAD, Pairs
from compasslib.types import Complexes, Floats

NEARLY_AS_MANY = 0.9  # of the samples that the fullest bin has: the nearest such bin is shown
HOUR_S = 3600.0
SPANS_H = (1, 6, 24, 48, 120, 240, 720, 2400)  # over which a mean may go
MOST_MEANS = 420


@dataclass(frozen=True)
class Flow:
    """A current along time, east + i north, m/s; NaN where it is missing."""

    time_s: Floats  # (n,)
    velocity: Complexes  # (n,)


@dataclass(frozen=True)
class Currents:
    """The current of one bin by the recorded and by the corrected heading."""

    depth_m: float  # median of the bin's; NaN where no bin has a sample
    recorded: Flow
    corrected: Flow

    @property
    def mean(self) -> tuple[complex, complex]:
        """Return the means, recorded and corrected, m/s, over the samples that have both; over all where none has."""
        before, after = self.recorded.velocity, self.corrected.velocity
        both = np.isfinite(before) & np.isfinite(after)
        return _mean(before[both] if both.any() else before), _mean(after[both])


def of_product(path: str | Path) -> Currents:
    """Return the current of the bin nearest to the instrument of those with nearly as many samples as the fullest.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with opened(path) as nc:
        time_s = (get(nc, "TIME") - DAYS_1950_TO_1970) * 86400.0
        count = np.sum(get(nc, "UCUR_RECORDED_QC") < BAD, axis=0)
        if not count.any():
            nothing = Flow(time_s, np.full(time_s.shape, complex(np.nan, np.nan)))
            return Currents(float("nan"), nothing, nothing)
        shown = int(np.argmax(count >= NEARLY_AS_MANY * count.max()))
        flows = [_flow(time_s, *(get(nc, name)[:, shown] for name in (*pair, f"{pair[0]}_QC"))) for pair in PAIRS]
        depth = get(nc, "DEPTH")[:, shown]
    return Currents(float(np.median(depth[np.isfinite(depth)])) if np.isfinite(depth).any() else float("nan"), *flows)


PAIRS = (("UCUR_RECORDED", "VCUR_RECORDED"), ("UCUR", "VCUR"))


def of_reference(pairs: Pairs) -> Flow:
    """Return what the reference measured at the overlaps."""
    return Flow(pairs.time_s, pairs.lower_east + 1j * pairs.lower_north)


def span_of_means(time_s: Floats) -> float:
    """Return over how many hours means go, so that a record has a few hundred of them.

    Args:
        time_s: increasing times, perhaps none.
    """
    hours = (time_s[-1] - time_s[0]) / HOUR_S if len(time_s) else 0.0
    return float(next((span for span in SPANS_H if hours <= MOST_MEANS * span), SPANS_H[-1]))


def means(flow: Flow, begin_s: float, hours: float, count: int) -> Complexes:
    """Return the means of a current over equal spans, (count,); NaN where a span has none."""
    there = np.isfinite(flow.velocity)
    place = np.floor((flow.time_s[there] - begin_s) / (hours * HOUR_S)).astype(int)
    inside = (place >= 0) & (place < count)
    number = np.bincount(place[inside], minlength=count)
    velocity = flow.velocity[there][inside]
    sums = [np.bincount(place[inside], part, count) for part in (velocity.real, velocity.imag)]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(number > 0, (sums[0] + 1j * sums[1]) / number, complex(np.nan, np.nan))


def _flow(time_s: Floats, east: Floats, north: Floats, quality: Floats) -> Flow:
    return Flow(time_s, np.where(quality < BAD, east + 1j * north, complex(np.nan, np.nan)))


def _mean(velocity: Complexes) -> complex:
    there = velocity[np.isfinite(velocity)]
    return complex(there.mean()) if there.size else complex(np.nan, np.nan)
