"""Slow water: its veer and its additive shear as Gaussian processes, whose size and memory the record tells.

Directions of two depths differ by weeks of other water. A term of the compass that changes as slowly must be weighed
against it in the same currency: what the processes may do is as quiet in the whitened residual as everything else.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.core import angles
from compasslib.core.types import Floats
from compasslib.search import baseline, columns, covariates, model, scan
from compasslib.search.baseline import State
from compasslib.search.columns import Group
from compasslib.stats import whitening
from compasslib.stats.whitening import Louder

DAY_S = 86400.0
SHORTEST_DAYS = 8.0  # period below which the filter holds the memory
MOST_WAVES = 120  # of a process: those of sixteen months; of longer records only what is slower
SPEED_SPAN_S, SLOWEST_M_S = 12 * 3600.0, 0.03
VEER_DEG = (0.5, 1.0, 2.0, 3.5, 6.0, 10.0, 16.0)
SHEAR_M_S = (0.003, 0.006, 0.01, 0.016, 0.025, 0.04, 0.06)
MEMORY_DAYS = (4.0, 8.0, 16.0, 32.0, 64.0, 128.0)
CHARGE, SHARES, TRIED = 3.0, (0.15, 0.4), 6  # log likelihood a parameter; of the water's size; names beside it
USUAL_VEER_DEG, USUAL_SHEAR_M_S = 3.0, 0.02  # of half a normal law, beforehand: two depths of real water
QUIET = 0.05  # variance over white below which a direction is as it is


@dataclass(frozen=True)
class Process:
    """A process of first order: size and memory."""

    size: float  # degrees of veer, or m/s of shear in each component, rms
    memory_days: float

    def variances(self, frequency: Floats, step: float) -> Floats:
        """Return the variance of each cosine's coefficient.

        Args:
            frequency: cycles a day, (k,), evenly spaced from 0.
            step: between them.
        """
        spectrum = 4.0 * self.size**2 * self.memory_days / (1.0 + (2.0 * np.pi * frequency * self.memory_days) ** 2)
        return spectrum * step * np.where(frequency > 0.0, 1.0, 0.5)


@dataclass(frozen=True)
class Slow:
    """What the record tells of slow water."""

    veer: Process
    shear: Process
    gain: float  # log posterior over none


def heard(state: State) -> State:
    """Return the state with slow water in its noise, as large and as lasting as makes the record likeliest."""
    parts = _columns(state)
    if parts is None:
        return state
    frequency, step, raw = parts
    variance = _beside_what_changes(state, frequency, step, raw)
    scale = np.sqrt(variance) * state.response / state.sigma
    white = state.whitener(raw.astype(np.float32)).astype(float)[:, variance > 0.0] * scale[variance > 0.0]
    if not white.shape[1]:
        return state
    values, vectors = np.linalg.eigh(white.T @ white)
    loud = values > QUIET
    basis = white @ vectors[:, loud] / np.sqrt(values[loud])
    louder = Louder(basis.astype(np.float32), 1.0 / np.sqrt(1.0 + values[loud]))
    case = replace(state.case, louder=louder)
    again = baseline.examine(case, state.simulation, state.nuisance)
    return model.refit(again, state.simulation.terms)


def _beside_what_changes(state: State, frequency: Floats, step: float, raw: Floats) -> Floats:
    """Return the variances of the columns' coefficients, learnt beside what changes at once where that is likelier.

    One large step looks like much slow water, which then hides it. What may change is therefore tried beside less
    water, at a charge for each parameter and for the number of dates, and for the likeliest the water is learnt anew.
    """
    found, variance = learnt(state, frequency, step, raw)
    if found.gain == 0.0:
        return variance
    waves, spells = columns.waves(state.case.scene.time_s), columns.spells(state)
    groups = [*columns.of_terms(state, state.case.terms), *waves, *spells]
    tried = Counter(group.name for group in groups)
    charges = [CHARGE * group.columns.shape[1] + float(np.log(tried[group.name])) for group in groups]
    alone = scan.gains(state, groups) / 2.0
    first: dict[str, tuple[float, int]] = {}
    for share in SHARES:
        scaled = _gains(state, groups, raw, variance * share**2)
        for k, group in enumerate(groups):
            first[group.name] = max(first.get(group.name, (-np.inf, 0)), (scaled[k] - charges[k], k))
    best = found.gain
    for _, k in sorted(first.values(), reverse=True)[:TRIED]:
        again, other = learnt(scan.beside(state, groups[k].columns), frequency, step, raw)
        if (value := again.gain + alone[k] - charges[k]) > best:
            best, variance = value, other
    return variance


def _gains(state: State, groups: Sequence[Group], raw: Floats, variance: Floats) -> Floats:
    """Return by how much each group makes the record likelier beside slow water, (g,)."""
    some, scale = variance > 0.0, state.response / state.sigma
    ends = np.cumsum([group.columns.shape[1] for group in groups])
    every = np.concatenate([group.columns for group in groups], axis=1)
    own, white = (state.projected(x.astype(np.float32)).astype(float) * scale for x in (every, raw[:, some]))
    inner = np.diag(1.0 / variance[some]) + white.T @ white
    score = state.innovation / state.sigma
    score = score - white @ np.linalg.solve(inner, white.T @ score)
    rest = own - white @ np.linalg.solve(inner, white.T @ own)
    parts = zip(*(np.split(x, ends[:-1], axis=1) for x in (own, rest)), strict=True)
    each = [(part.T @ left, part.T @ score) for part, left in parts]
    return np.array([0.5 * pull @ whitening.inverse(known) @ pull for known, pull in each])


def learnt(state: State, frequency: Floats, step: float, raw: Floats) -> tuple[Slow, Floats]:
    """Return the likeliest processes, and the variance of each column's coefficient.

    Args:
        frequency: of the waves, cycles a day, (k,), ``step`` apart.
        raw: cosines of the veer, and perhaps of eastward and northward shear, (n, k) or (n, 3 k).
    """
    white = state.projected(raw.astype(np.float32)).astype(float) * state.response / state.sigma
    gram, pull = white.T @ white, white.T @ state.innovation / state.sigma
    count = len(frequency)
    kinds = raw.shape[1] // count

    def variance(veer: Process, shear: Process) -> Floats:
        return np.concatenate([each.variances(frequency, step) for each in (veer, shear, shear)[:kinds]])

    none = Process(0.0, MEMORY_DAYS[0])
    best, chosen = 0.0, (none, none)
    tries_veer = [Process(s, m) for s in VEER_DEG for m in MEMORY_DAYS]
    tries_shear = [Process(s, m) for s in SHEAR_M_S for m in MEMORY_DAYS]
    for _ in range(2):
        for k, tries in enumerate((tries_veer, tries_shear)[: 1 + (kinds > 1)]):
            for one in (none, *tries):
                pair = (one, chosen[1]) if k == 0 else (chosen[0], one)
                value = _marginal(gram, pull, variance(*pair)) - _unusual(*pair)
                if value > best + 1e-9:
                    best, chosen = value, pair
    return Slow(*chosen, best), variance(*chosen)


def _unusual(veer: Process, shear: Process) -> float:
    """Return by how much the log prior falls for processes of these sizes."""
    return 0.5 * (veer.size / USUAL_VEER_DEG) ** 2 + 0.5 * (shear.size / USUAL_SHEAR_M_S) ** 2


def _marginal(gram: Floats, pull: Floats, variance: Floats) -> float:
    """Return the log marginal likelihood over that of no process."""
    some = variance > 0.0
    if not some.any():
        return 0.0
    root = np.sqrt(variance[some])
    inner = np.eye(len(root)) + root[:, None] * gram[np.ix_(some, some)] * root
    lower = np.linalg.cholesky(inner)
    half = np.linalg.solve(lower, root * pull[some])
    return float(0.5 * half @ half - np.sum(np.log(np.diag(lower))))


def _columns(state: State) -> tuple[Floats, float, Floats] | None:
    """Return frequencies, their spacing, and the columns: cosines of the veer, of eastward and of northward shear."""
    time_s = state.case.scene.time_s
    days = float(np.ptp(time_s)) / DAY_S
    count = min(int(2.0 * days / SHORTEST_DAYS) + 1, MOST_WAVES)
    if count < 4 or state.case.kind != "mooring":
        return None
    frequency, step = np.arange(count) / (2.0 * days), 1.0 / (2.0 * days)
    waves = np.cos(np.pi * (time_s - time_s[0])[:, None] / (days * DAY_S) * np.arange(count))
    departures = state.case.scene.departures
    if "flow_east" not in departures or "speed" not in state.case.covariates:
        return frequency, step, waves
    speed = covariates.running(state.case.covariates["speed"], time_s, SPEED_SPAN_S)
    slowness = 1.0 / np.maximum(speed, SLOWEST_M_S) / angles.DEGREE
    east = waves * (departures["flow_north"] * slowness)[:, None]
    north = -waves * (departures["flow_east"] * slowness)[:, None]
    return frequency, step, np.concatenate([waves, east, north], axis=1)
