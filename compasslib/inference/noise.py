"""Slow water and its tides: veer and additive shear as Gaussian processes of unknown size and memory.

Directions of two depths differ by weeks of other water. A term of the compass that changes as slowly must be weighed
against it in the same currency: both processes stand beside every hypothesis, and what may be their sizes and memories
is summed over. The ellipses of the tides differ between the depths too, and their waves stand beside both.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.effects.term import DAY_S
from compasslib.inference import covariates
from compasslib.inference.baseline import State
from compasslib.inference.case import Case, tides
from compasslib.statistics.whitening import Louder
from compasslib.types import Floats

SHORTEST_DAYS = 8.0  # period below which the filter holds the memory
MOST_WAVES = 120  # of a process: those of sixteen months; of longer records only what is slower
SPEED_SPAN_S = 12 * 3600.0  # of the speed by which shear turns a direction
VEER_DEG, VEER_DAYS = (0.7, 1.4, 2.8, 5.6, 11.0), (5.0, 15.0, 45.0, 135.0)  # sizes and memories that are summed over
SHEAR_M_S, SHEAR_DAYS = (0.003, 0.007, 0.017, 0.04, 0.1), (3.0, 15.0, 75.0)  # the same
QUIET = 0.05  # variance over white below which a direction is as it is
USUAL_VEER_DEG, USUAL_SHEAR_M_S = 3.0, 0.02  # of half a Cauchy law, beforehand: two depths of real water
TIDE_SPAN_S = 3600.0  # of the speed by which a tide's shear, of USUAL_SHEAR_M_S a wave, turns a direction


@dataclass(frozen=True)
class Process:
    """A process of first order."""

    size: float  # degrees of veer, or m/s of shear in each component, rms
    memory_days: float

    def variances(self, frequency: Floats, step: float) -> Floats:
        """Return the variance of each cosine's coefficient.

        Args:
            frequency: cycles a day, (k,), evenly spaced from 0.
            step: between them, half a cycle in the whole record.
        """
        spectrum = 8.0 * self.size**2 * self.memory_days / (1.0 + (2.0 * np.pi * frequency * self.memory_days) ** 2)
        return spectrum * step * np.where(frequency > 0.0, 1.0, 0.5)


@dataclass(frozen=True)
class Water:
    """What slow water may do: veer, and shear of either component."""

    veer: Process
    shear: Process

    @property
    def log_prior(self) -> float:
        """Log of what is expected beforehand, up to a constant."""
        sizes = self.veer.size / USUAL_VEER_DEG, self.shear.size / USUAL_SHEAR_M_S
        return -float(np.sum(np.log1p(np.square(sizes))))


@dataclass(frozen=True)
class Slow:
    """Columns that slow water is made of, and what each kind of it makes of their coefficients."""

    columns: Floats  # (n, q) degrees a unit: cosines of the veer, of eastward and northward shear; waves of their tides
    frequency: Floats  # (k,) cycles a day, evenly spaced from 0
    kinds: int  # processes: 1, or 3 with the shear

    def variances(self, water: Water) -> Floats:
        """Return the variance of each column's coefficient, (q,)."""
        step = float(self.frequency[1])
        each = [process.variances(self.frequency, step) for process in (water.veer, water.shear, water.shear)]
        slow = np.concatenate(each[: self.kinds])
        return np.concatenate([slow, np.full(self.columns.shape[1] - len(slow), USUAL_SHEAR_M_S**2)])

    def waters(self) -> list[Water]:
        """Return the kinds of water that are summed over."""
        none = Process(0.0, VEER_DAYS[0])
        veers = [none, *(Process(*one) for one in itertools.product(VEER_DEG, VEER_DAYS))]
        shears = [none, *(Process(*one) for one in itertools.product(SHEAR_M_S, SHEAR_DAYS))]
        return [Water(*both) for both in itertools.product(veers, shears if self.kinds > 1 else [none])]


def of(case: Case) -> Slow | None:
    """Return what slow water a recording may show, None where it is no mooring or too short."""
    time_s = case.scene.time_s
    days = float(np.ptp(time_s)) / DAY_S
    count = min(int(2.0 * days / SHORTEST_DAYS) + 1, MOST_WAVES)
    if count < 4 or not case.in_water:
        return None
    frequency = np.arange(count) / (2.0 * days)
    waves = np.cos(np.pi * (time_s - time_s[0])[:, None] / (days * DAY_S) * np.arange(count))
    departures = case.scene.departures
    if "flow_east" not in departures or "speed" not in case.covariates:
        return Slow(waves, frequency, 1)
    each = [sheared(case, *one) for one in ((waves, SPEED_SPAN_S), (tides(time_s), TIDE_SPAN_S))]
    return Slow(np.concatenate([waves, *each], axis=1), frequency, 3)


def sheared(case: Case, waves: Floats, span_s: float) -> Floats:
    """Return by how many degrees eastward and northward shear of 1 m/s that goes as some waves turns directions.

    Args:
        waves: (n, k).
        span_s: of the running mean of the speed.
    """
    speed = covariates.running(case.covariates["speed"], case.scene.time_s, span_s)
    slowness = 1.0 / np.maximum(speed, covariates.SLOWEST_M_S) / angles.DEGREE
    north, east = (case.scene.departures[name] * slowness for name in ("flow_north", "flow_east"))
    return np.concatenate([waves * north[:, None], -waves * east[:, None]], axis=1)


def louder(view: State, slow: Slow, water: Water) -> Louder | None:
    """Return slow water as directions in which the whitened noise of a recording is louder; None where it is none.

    Args:
        view: whose whitener knows no slow water.
    """
    variance = slow.variances(water)
    some = variance > 0.0
    scale = np.sqrt(variance[some]) * view.response / view.sigma
    white = view.whitener(slow.columns[:, some].astype(np.float32)).astype(float) * scale
    if not white.shape[1]:
        return None
    values, vectors = np.linalg.eigh(white.T @ white)
    loud = values > QUIET
    basis = white @ vectors[:, loud] / np.sqrt(values[loud])
    return Louder(basis.astype(np.float32), 1.0 / np.sqrt(1.0 + values[loud]))
