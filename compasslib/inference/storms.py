"""Storms that no observatory saw: directions that scatter more where a global index of storms is larger.

An index tells that magnetic north moved, not whereto: the cause is named, nothing is corrected. Chance is judged by the
index at other dates, turned round the record, which keeps its storms and their memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles, observatory
from compasslib.effects.earth import IndexedDisturbance
from compasslib.inference import show
from compasslib.inference.baseline import State
from compasslib.inference.case import ALIKE
from compasslib.inference.finding import Finding, Parameter, Where
from compasslib.inference.show import HeldOut
from compasslib.records import stamp
from compasslib.types import Floats

SIZES_NT = np.geomspace(0.3, 100.0, 24)  # across magnetic north for one unit of ap
SHIFTS, NEAREST_S = 400, 5 * 86400.0  # dates at which the index is tried; storms last for days
BLOCKS = 12  # parts of a record by which the excess is proven
STORMY = 0.9  # quantile of the index from which it is stormy
PHYSICS = "magnetic north is unsteady where the index of storms is high; its course only an observatory could tell"


@dataclass(frozen=True)
class _Scatter:
    """What a simulation leaves of the directions, and what the index lets expect; n samples that count."""

    squares: Floats  # (n,) of the residual over its width, clipped
    share: Floats  # (n,) variance for 1 nT a unit of ap, over the noise's

    def gains(self, sizes_nT: Floats, share: Floats) -> Floats:
        """Return the log likelihood gained over even noise by each size, the noise's own width being free, (k,)."""
        return np.sum(self._each(sizes_nT, share), axis=1)

    def _each(self, sizes_nT: Floats, share: Floats) -> Floats:
        variance = 1.0 + np.square(sizes_nT)[:, None] * share
        own, even = (self.squares / variance).mean(axis=1, keepdims=True), self.squares.mean()
        return (self.squares / even - self.squares / variance / own - np.log(variance * own / even)) / 2.0

    def best(self, kept: Floats | slice = slice(None)) -> float:
        """Return the likeliest size by some of the samples, nT a unit of ap."""
        from scipy.optimize import minimize_scalar

        some = _Scatter(self.squares[kept], self.share[kept])
        first = float(np.log(SIZES_NT[int(np.argmax(some.gains(SIZES_NT, some.share)))]))
        step = float(np.log(SIZES_NT[1] / SIZES_NT[0]))
        found = minimize_scalar(
            lambda log: -some.gains(np.exp([log]), some.share)[0], bounds=(first - step, first + step), method="bounded"
        )
        return float(np.exp(found.x))

    def chance(self, time_s: Floats) -> float:
        """Return how often the index at other dates does as well."""
        step = max(float(np.median(np.diff(time_s))), 1.0)
        nearest = int(NEAREST_S / step) + 1
        count = min(SHIFTS, max(len(time_s) - 2 * nearest, 1))
        shifts = np.linspace(nearest, len(time_s) - nearest, count).astype(int)
        sizes = SIZES_NT[::3]
        seen = self.gains(sizes, self.share).max()
        others = [self.gains(sizes, np.roll(self.share, shift)).max() for shift in shifts]
        return (1 + int(np.sum(np.array(others) >= seen))) / (1 + count)

    def left_out(self, block: Floats) -> tuple[float, float, Floats]:
        """Return the size, its standard error by the jackknife, and the gain of each block by the others' size."""
        sizes = np.array([self.best(np.asarray(block != k)) for k in range(BLOCKS)])
        whole, off = self.best(), sizes - sizes.mean()
        gains = [self._each(sizes[k : k + 1], self.share)[0, block == k].sum() for k in range(BLOCKS)]
        return whole, float(np.sqrt((BLOCKS - 1) / BLOCKS * off @ off)), np.array(gains)


def of(state: State, alarm: float) -> Finding | None:
    """Return the finding that directions scatter with the index of storms, None where they do not or there is none.

    Args:
        state: with all that was found in its simulation.
        alarm: probability that noise alone is allowed to give a name.
    """
    scene, width = state.case.scene, state.whitener.width_deg
    if (IndexedDisturbance.name, ALIKE) in state.case.not_testable or "storm_index" not in scene.departures:
        return None
    known = np.isfinite(width) & np.isfinite(state.residual_deg)
    index = scene.departures["storm_index"] / scene.horizontal_nT / angles.DEGREE
    time_s, unit = scene.time_s[known], index[known]
    standard = np.clip(state.residual_deg[known] / width[known], -show.FARTHEST, show.FARTHEST)
    scatter = _Scatter(standard**2, (unit / width[known]) ** 2)
    if not unit.any() or (chance := scatter.chance(time_s)) > alarm:
        return None
    block = np.floor(np.arange(len(unit)) * BLOCKS / len(unit))
    size, sigma, gains = scatter.left_out(block)
    rms = angles.rms(np.clip(state.residual_deg[known], -90.0, 90.0))
    spread = 1.96 * float(np.std(gains)) * np.sqrt(BLOCKS)
    total = float(gains.sum())
    proof = HeldOut(rms, rms, total, (total - spread, total + spread), chance)
    return _finding(state, Parameter(size, sigma, "nT"), size * angles.rms(index), proof)


def _finding(state: State, size: Parameter, rms_deg: float, proof: HeldOut) -> Finding:
    index, time_s = state.case.scene.departures["storm_index"], state.case.scene.time_s
    low, high = np.quantile(index, [STORMY, 1.0]).tolist()
    span = observatory.strongest_disturbance(time_s, index)
    place = Where("storm_index", low, high, f"where ap is {low:.0f} to {high:.0f}")
    first, last = (stamp(one)[:10] for one in span)
    text = (
        f"W{place.text[1:]}, most of all from {first} to {last}: {PHYSICS}. Directions scatter with it by "
        f"{rms_deg:.1f}° rms, {size.value:.2g} ± {1.96 * size.sigma:.1g} nT (95 %) for one unit of ap; "
        f"the index at other dates does as well {proof.p_value:.1%} of the time. Nothing is corrected by it."
    )
    name, side = IndexedDisturbance.name, IndexedDisturbance.side
    return Finding(name, side, (), place, span, {"nT_ap": size}, rms_deg, proof, text)
