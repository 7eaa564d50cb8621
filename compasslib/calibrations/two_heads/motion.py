"""Motion of a head by its own clock: heading and tilts as smooth functions of time, their rates, and clock offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import BAD, Record
from compasslib.statistics.resampling import blocks_by_count, student_factor
from compasslib.types import DAY_S, Complexes, Floats

GAP_STEPS = 3.0  # longest gap that is interpolated, in sampling intervals
STRETCHES = 30  # of a record, left out one by one for standard errors
RESOLUTION_S = 0.01 / np.sqrt(12.0)  # PD0 clocks count hundredths of a second
UNKNOWN = (float("nan"), float("nan"))


@dataclass(frozen=True)
class GapSpline:
    """Cubic spline through samples, undefined inside gaps."""

    time_s: Floats  # (n,) increasing
    values: NDArray  # (n,) real or complex

    @cached_property
    def _spline(self) -> Any:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.time_s - self.time_s[0], self.values)

    def at(self, time_s: Floats, derivative: int = 0) -> NDArray:
        """Evaluate the spline, or a derivative per second, at times (k,); NaN in gaps and beyond the ends."""
        left = np.searchsorted(self.time_s, time_s, side="right") - 1
        inside = (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1])
        left = np.clip(left, 0, len(self.time_s) - 2)
        whole = self.time_s[left + 1] - self.time_s[left] <= GAP_STEPS * step(self.time_s)
        there = inside & (whole | (time_s == self.time_s[left]))
        return np.where(there, self._spline(time_s - self.time_s[0], derivative), np.nan)


Rates = tuple[GapSpline, GapSpline]  # of a quantity measured by both heads: of a, of b


@dataclass(frozen=True)
class Motion:
    """Heading and tilt of one head by its own clock, (n,) each, all finite."""

    time_s: Floats  # increasing
    heading_deg: Floats  # recorded, unwrapped along time
    lean: Complexes  # downward vector in the body, forward + i starboard: the sines of the tilts

    @property
    def middle_s(self) -> float:
        """Middle of the record."""
        return float(self.time_s[0] + self.time_s[-1]) / 2.0

    @property
    def recorded_deg(self) -> Floats:
        """Recorded heading, [0, 360)."""
        return angles.wrap360(self.heading_deg)

    @cached_property
    def heading(self) -> GapSpline:
        """Spline of the heading, degrees."""
        return GapSpline(self.time_s, self.heading_deg)

    @cached_property
    def rates(self) -> tuple[GapSpline, GapSpline]:
        """Splines of the rates of tilt and of turn between samples, degrees per second."""
        interval, middle = np.diff(self.time_s), (self.time_s[1:] + self.time_s[:-1]) / 2.0
        near = interval <= GAP_STEPS * step(self.time_s)
        tilt, turn = (np.diff(x) / interval for x in (self.lean / angles.DEGREE, self.heading_deg))
        return GapSpline(middle[near], tilt[near]), GapSpline(middle[near], turn[near])


@dataclass(frozen=True)
class PairedHeads:
    """Both heads at the sampling times of b, (n,) each."""

    time_s: Floats  # by b's clock
    recorded_a: Floats  # degrees, interpolated
    recorded_b: Floats
    lean_a: Complexes
    lean_b: Complexes
    rate_deg_s: Floats  # rate of turn of a

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class ClockDifference:
    """Clock of b minus clock of a at the middle of the record, and its drift."""

    offset_s: float = 0.0
    sigma_s: float = float("nan")
    drift_s_per_day: float = 0.0
    drift_sigma_s_per_day: float = float("nan")
    drift_applied: bool = False
    middle_s: float = 0.0  # by b's clock
    from_tilts_s: tuple[float, float] = UNKNOWN  # offset and standard deviation
    from_headings_s: tuple[float, float] = UNKNOWN
    determined: bool = False
    warnings: tuple[str, ...] = ()

    def by_a(self, time_s: Floats) -> Floats:
        """Convert times of b's clock to a's clock, (n,)."""
        drift = self.drift_s_per_day / DAY_S if self.drift_applied else 0.0
        return time_s - self.offset_s - drift * (time_s - self.middle_s)

    def to_json(self) -> dict[str, Any]:
        """Describe the difference for calibration.json."""
        hidden = ("middle_s", "determined", "warnings")
        return {name: x for name, x in vars(self).items() if name not in hidden} | {"found": self.determined}

    def heading_error_deg(self, rate_deg_s: Floats) -> Floats:
        """Compute the error of heading differences due to one standard deviation of the offset, (n,) degrees."""
        return rate_deg_s * (self.sigma_s if np.isfinite(self.sigma_s) else 0.0)


def step(time_s: Floats) -> float:
    """Compute the sampling interval, seconds."""
    return float(np.median(np.diff(time_s)))


def extract_motion(record: Record, start_s: float = -np.inf, end_s: float = np.inf) -> Motion:
    """Select the usable part of a record: finite headings and tilts, in order of time, upright, inside a window."""
    tilts = np.abs(record.pitch_deg) + np.abs(record.roll_deg)
    with np.errstate(invalid="ignore"):
        upright = tilts < 45.0  # larger tilts occur on deck or after a fall
    usable = np.isfinite(record.heading_deg) & (record.heading_quality < BAD) & upright
    usable &= (record.time_s >= start_s) & (record.time_s <= end_s)
    time_s, first = np.unique(record.time_s[usable], return_index=True)
    index = np.flatnonzero(usable)[first]
    heading = record.heading_deg[index]
    turned = np.concatenate([heading[:1], angles.difference(heading[1:], heading[:-1])])
    return Motion(time_s, np.cumsum(turned), lean(record.pitch_deg[index], record.roll_deg[index]))


def overlap_in_time(a: Motion, b: Motion, max_offset_s: float) -> bool:
    """Return whether two heads measured at the same time, for a largest clock offset in seconds."""
    return bool(max(a.time_s[0], b.time_s[0] - max_offset_s) < min(a.time_s[-1], b.time_s[-1] + max_offset_s))


def pair_samples(a: Motion, b: Motion, clock: ClockDifference) -> PairedHeads:
    """Interpolate a to the times of b, converted to a's clock."""
    at = clock.by_a(b.time_s)
    heading, lean, rate = a.heading.at(at), GapSpline(a.time_s, a.lean).at(at), a.heading.at(at, 1)
    known = np.isfinite(heading) & np.isfinite(lean)
    recorded = angles.wrap360(heading[known])
    return PairedHeads(b.time_s[known], recorded, b.recorded_deg[known], lean[known], b.lean[known], rate[known])


def lean(pitch_deg: Floats, roll_deg: Floats) -> Complexes:
    """Compute the downward vector, forward + i starboard, from pitch (forward up) and roll (starboard down)."""
    (sp, cp), (sr, _) = angles.sin_cos(pitch_deg), angles.sin_cos(roll_deg)
    return -sp + 1j * cp * sr


def down(lean: Complexes) -> Floats:
    """Compute the downward unit vector in the body axes forward, starboard, down, (n, 3), from a lean."""
    return np.stack([lean.real, lean.imag, np.sqrt(np.maximum(1.0 - np.abs(lean) ** 2, 0.0))], axis=-1)


def tilt_angles(lean: Complexes) -> tuple[Floats, Floats]:
    """Compute pitch and roll, degrees: the inverse of ``lean``."""
    x, y, z = down(lean).T
    pitch = angles.wrap180(angles.direction(-x, np.hypot(y, z)))
    return pitch, angles.wrap180(angles.direction(y, z))


def estimate_clock_offset(a: Motion, b: Motion, max_offset_s: float) -> ClockDifference:
    """Estimate the offset of b's clock from a's, and its drift, which is applied from three standard deviations on."""
    needed = max(0.3, 5.0 / np.sqrt(min(len(a.time_s), len(b.time_s))))
    lag, correlations = _lattice_peak(a, b, max_offset_s)
    middle, pairs = b.middle_s, list(zip(a.rates, b.rates, strict=True))
    alone = {k: _solve_lag(pairs[k], np.array([lag]), middle) for k in (0, 1) if correlations[k] >= needed}
    if not alone:
        warning = "tilts and headings of the two heads hardly change together: the clocks are used uncorrected"
        return ClockDifference(middle_s=middle, warnings=(warning,))
    by_tilts, by_headings = (_offset(*alone[k]) if k in alone else UNKNOWN for k in (0, 1))
    used, apart, warnings = [*alone], abs(by_tilts[0] - by_headings[0]), tuple[str, ...]()
    if apart > 0.02 and apart > 4.0 * float(np.hypot(by_tilts[1], by_headings[1])):
        used = [0]
        warnings = (
            f"b's clock differs from a's by {by_tilts[0]:+.3f} s according to the tilts and by {by_headings[0]:+.3f} s "
            "according to the headings: one compass lags behind its tilt sensors; the tilts are used",
        )
    value, covariance = _weighted_mean([alone[k] for k in used])
    both, both_covariance = _weighted_mean([_solve_lag(pairs[k], np.array([value[0], 0.0]), middle) for k in used])
    drift, sigma = float(both[1]), float(np.sqrt(both_covariance[1, 1]))
    applied = abs(drift) > 3.0 * sigma and abs(drift) * float(np.ptp(b.time_s)) > RESOLUTION_S
    offset_s, sigma_s = _offset(both, both_covariance) if applied else _offset(value, covariance)
    return ClockDifference(
        offset_s=offset_s,
        sigma_s=sigma_s,
        drift_s_per_day=drift * DAY_S,
        drift_sigma_s_per_day=sigma * DAY_S,
        drift_applied=applied,
        middle_s=middle,
        from_tilts_s=by_tilts,
        from_headings_s=by_headings,
        determined=True,
        warnings=warnings,
    )


def _offset(value: Floats, covariance: Floats) -> tuple[float, float]:
    return float(value[0]), float(np.sqrt(covariance[0, 0] + RESOLUTION_S**2))


def _weighted_mean(solutions: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Average independent solutions weighted by their inverse covariances; give the mean and its covariance."""
    inverses = [np.linalg.inv(covariance) for _, covariance in solutions]
    whole = np.linalg.inv(np.sum(inverses, axis=0))
    parts = [inverse @ value for inverse, (value, _) in zip(inverses, solutions, strict=True)]
    return np.asarray(whole @ np.sum(parts, axis=0)), np.asarray(whole)


def _lattice_peak(a: Motion, b: Motion, max_offset_s: float) -> tuple[float, tuple[float, float]]:
    """Find the lag at which the rates of tilts, or of tilts and headings, correlate best, and both correlations."""
    lattice = min(step(a.time_s), step(b.time_s))
    end = max(a.time_s[-1], b.time_s[-1])
    grid = np.arange(min(a.time_s[0], b.time_s[0]), end + lattice, lattice)
    tilts, headings = (_correlations(*pair, grid) for pair in zip(a.rates, b.rates, strict=True))
    place = np.arange(len(grid))
    lags = lattice * np.where(place > len(grid) // 2, place - len(grid), place)
    reachable = np.abs(lags) <= max(max_offset_s, lattice / 2.0)
    best = int(np.argmax(np.where(reachable, tilts**2 + headings**2, -1.0)))
    by_tilts = int(np.argmax(np.where(reachable, tilts, -1.0)))
    gain = np.arctanh(min(tilts[by_tilts], 0.999)) - np.arctanh(min(tilts[best], 0.999))  # in Fisher's z
    if abs(lags[by_tilts] - lags[best]) > 1.5 * lattice and gain > 5.0 * np.sqrt(20.0 / len(b.time_s)):
        best = by_tilts
    return float(lags[best]), (float(tilts[best]), float(headings[best]))


def _correlations(first: GapSpline, second: GapSpline, grid: Floats) -> Floats:
    """Compute the modulus of the correlation of two rates on a grid at each lag, in FFT order, zero-padded."""
    x, y = (_interpolate_rate(rate, grid) for rate in (first, second))
    size, half = len(grid), len(grid) // 2 + 1
    whole = np.fft.ifft(np.conj(np.fft.fft(x, 2 * size)) * np.fft.fft(y, 2 * size))
    scale = float(np.sqrt(np.sum(np.abs(x) ** 2) * np.sum(np.abs(y) ** 2)))
    return np.abs(np.concatenate([whole[:half], whole[size + half :]])) / max(scale, 1e-300)


def _interpolate_rate(curve: GapSpline, grid: Floats) -> Complexes:
    """Interpolate a rate to a regular grid, remove its mean, and fill gaps with zero."""
    value = np.asarray(np.interp(grid, curve.time_s, curve.values), dtype=complex)
    after = np.clip(np.searchsorted(curve.time_s, grid), 1, len(curve.time_s) - 1)
    there = (grid >= curve.time_s[0]) & (grid <= curve.time_s[-1])
    there &= curve.time_s[after] - curve.time_s[after - 1] <= GAP_STEPS * step(curve.time_s)
    apart = np.where(there, value - value[there].mean() if there.any() else 0.0, 0.0)
    # A frame that turns steadily, or not at all, gives no signal to compare clocks by: only rounding errors remain.
    steady = np.abs(apart).max(initial=0.0) <= 1e-6 * np.abs(value).max(initial=0.0)
    return np.zeros_like(apart) if steady else apart


def _solve_lag(rates: Rates, start: Floats, middle_s: float) -> tuple[Floats, Floats]:
    """Solve for the offset (and drift, if ``start`` has two parameters) where the correlation's derivative vanishes."""
    solution, time_s = start, rates[1].time_s
    for _ in range(20):
        curvature, parts = _gradient_sums(rates, solution, middle_s)
        change = -np.linalg.solve(curvature, parts.sum(axis=0))
        solution = solution + change / max(1.0, 2.0 * abs(change[0]) / step(time_s))
        if abs(change[0]) < 1e-6:
            break
    curvature, parts = _gradient_sums(rates, solution, middle_s)
    inverse = np.linalg.inv(curvature)
    widened = student_factor(STRETCHES - len(start)) ** 2 * STRETCHES / (STRETCHES - len(start))
    # The least standard deviation of an offset, even for two identical files, is 1e-4 s.
    floor = np.diag([1e-4, 1e-4 / max(float(np.ptp(time_s)), 1.0)][: len(start)]) ** 2
    return solution, inverse @ (parts.T @ parts) @ inverse * widened + floor


def _gradient_sums(rates: Rates, parameters: Floats, middle_s: float) -> tuple[Floats, Floats]:
    """Compute the curvature of the correlation and the contribution of each block to its gradient."""
    other, time_s, value = rates[0], rates[1].time_s, rates[1].values.astype(complex)
    columns = np.stack([np.ones_like(time_s), time_s - middle_s])[: len(parameters)]
    at = time_s - parameters @ columns
    here = other.at(at)
    known = np.isfinite(here)
    along = np.sum(np.conj(value[known]) * here[known])
    turned = value * along / max(abs(along), 1e-300)  # samples of b rotated into a's frame
    first, second = -np.real(np.conj(turned) * other.at(at, 1)), np.real(np.conj(turned) * other.at(at, 2))
    known = np.isfinite(first) & np.isfinite(second)
    columns, first, second = columns[:, known], first[known], second[known]
    stretch = blocks_by_count(time_s, STRETCHES)[known]
    parts = np.stack([np.bincount(stretch, first * column, STRETCHES) for column in columns], axis=1)
    return np.asarray((columns * second) @ columns.T), np.asarray(parts, dtype=float)
