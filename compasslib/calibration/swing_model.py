"""What a swing observes, as a function of compass, declination, water and delay.

The ground's velocity is the water's plus the ship's through it, so the direction of what remains when the drift is taken
from the velocity over ground is the true heading, whatever the speed. No speed through the water is needed; where the
ship's log gives one, its length closes the triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibration.swing_data import Observations, Options
from compasslib.calibration.swing_fit import Block, Solution, solve
from compasslib.deviation import von_appen

Floats = NDArray[np.floating]

SERIES = slice(0, 5)
DECLINATION, EAST, NORTH, EAST_CHANGE, NORTH_CHANGE, LAG, LOG = range(5, 12)
SIZE = 12
DRIFT = [EAST, NORTH]
NEVER = 1e-9  # width of the belief in a parameter that cannot be told
LOG_SIGMA = 0.1  # of a ship's log's scale
SPRING_S = 3 * 3600.0  # a tide goes from slack to full in three hours
LONG_GAP_S = 120.0  # beyond it nothing is left of a wander at the helm
LEAST_WATER_KN = 0.5
HEADING_GAP_DEG = 2.0  # headings less apart are one heading, repeated
COURSE, VISUAL, WATER = "course", "visual", "log"

Curve = Callable[[Floats, Floats, Floats], tuple[Floats, Floats, Floats]]


@dataclass(frozen=True)
class Swing:
    """Observations with what is needed to explain them."""

    seen: Observations
    options: Options
    declination_deg: float
    declination_sigma_deg: float
    marks: tuple[tuple[float, float], ...] = ()  # (recorded, true) headings by a visual mark or the sun

    @property
    def has_speed(self) -> bool:
        """Tell whether speeds were logged; else the ship's speed is the unit and the drift a share of it."""
        return bool(np.isfinite(self.seen.speed_kn).all())

    @property
    def widest_drift(self) -> float:
        """Return the largest drift that is believed, knots, or over the ship's speed where that is not known."""
        return self.options.max_drift_kn if self.has_speed else self.options.drift_ratio

    @property
    def speed_kn(self) -> Floats:
        """Return the speed over ground, 1 where it is not known, (n,)."""
        return self.seen.speed_kn if self.has_speed else np.ones(len(self.seen))


def fit(swing: Swing, *, exact: bool = False, start: Floats | None = None) -> Solution:
    """Return the compass that explains a swing, with the water's drift and the course's delay.

    Args:
        swing: observations.
        exact: the exact compass (coefficients dimensionless) instead of the series in the recorded heading (degrees).
        start: parameters to begin from.
    """
    mean, begin = np.zeros(SIZE), np.zeros(SIZE) if start is None else start.copy()
    mean[LOG] = 1.0
    begin[LOG] = begin[LOG] or 1.0
    if exact:
        begin[SERIES] = exact_start(swing.seen.recorded_deg, corrected_course(begin, swing)[0])
    return solve(_blocks(swing, _exact if exact else _series), mean, beliefs(swing), begin)


def beliefs(swing: Swing) -> Floats:
    """Return the width of the belief in each parameter, infinite for the compass.

    A drift that may be anything up to a largest one, in any direction, has half of that as its standard deviation
    along either axis.

    Args:
        swing: observations.
    """
    seen, sigma = swing.seen, np.full(SIZE, NEVER)
    sigma[SERIES] = np.inf
    sigma[DECLINATION] = max(swing.declination_sigma_deg, NEVER)
    if seen.over_ground:
        sigma[DRIFT] = max(swing.widest_drift / 2.0, NEVER)
    if seen.timed:
        lasted = float(np.ptp(seen.time_s))
        sigma[[EAST_CHANGE, NORTH_CHANGE]] = np.maximum(sigma[DRIFT] * min(1.0, lasted / SPRING_S), NEVER)
        sigma[LAG] = max(swing.options.max_lag_s / 2.0, NEVER)
    if _by_log(swing).any():
        sigma[LOG] = LOG_SIGMA
    return sigma


def exact_start(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Return A..E of the exact compass by the linear fit Im(e^{-i gamma} q) = 0 (physics page, section 3), (5,).

    Args:
        recorded_deg: recorded headings gamma, (n,).
        heading_deg: correct magnetic headings beta, (n,).
    """
    g, w = np.conj(angles.phasor(recorded_deg)), angles.phasor(heading_deg)
    one = np.ones_like(w)
    columns = np.imag(g[:, None] * np.stack([-1j * w, one, -1j * one, np.conj(w), -1j * np.conj(w)], axis=-1))
    return np.asarray(np.linalg.lstsq(columns, -np.imag(g * w))[0])


def corrected_course(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return the magnetic headings that the courses stand for, (n,) degrees, and their derivatives, (n, k).

    Args:
        parameters: of the swing.
        swing: observations.
    """
    seen, slopes = swing.seen, np.zeros((len(swing.seen), SIZE))
    through, east, north = seen.course_deg, *angles.components(swing.speed_kn, seen.course_deg)
    if seen.over_ground:
        since = _since_middle(seen)
        east = east - parameters[EAST] - parameters[EAST_CHANGE] * since
        north = north - parameters[NORTH] - parameters[NORTH_CHANGE] * since
        through = angles.direction(east, north)
        square = np.maximum(east**2 + north**2, 1e-6) * angles.DEGREE
        slopes[:, EAST], slopes[:, NORTH] = -north / square, east / square
        slopes[:, EAST_CHANGE], slopes[:, NORTH_CHANGE] = slopes[:, EAST] * since, slopes[:, NORTH] * since
    slopes[:, DECLINATION], slopes[:, LAG] = -1.0, seen.turn_deg_s
    offset = swing.declination_deg + parameters[DECLINATION] - parameters[LAG] * seen.turn_deg_s
    return angles.wrap360(through - offset), slopes


def _blocks(swing: Swing, curve: Curve) -> list[Block]:
    seen = swing.seen
    starts = stretches(seen) if seen.timed else None
    slow = seen.speed_kn if swing.has_speed and seen.over_ground else None
    groups = None if seen.timed else headings_of(seen.recorded_deg)
    blocks = [Block(COURSE, partial(_course, swing=swing, curve=curve), slow, starts, groups=groups)]
    if swing.marks:
        observe = partial(_mark, swing=swing, curve=curve)
        blocks.append(Block(VISUAL, observe, sigma=swing.options.visual_sigma_deg))
    if _by_log(swing).any():
        blocks.append(Block(WATER, partial(_water, swing=swing), starts=starts))
    return blocks


def _course(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    heading, slopes = corrected_course(parameters, swing)
    residual, by_compass, by_heading = curve(parameters[SERIES], heading, swing.seen.recorded_deg)
    slopes = slopes * by_heading[:, None]
    slopes[:, SERIES] = by_compass
    return residual, slopes


def _mark(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    recorded, true = np.transpose(swing.marks)
    heading = true - swing.declination_deg - parameters[DECLINATION]
    residual, by_compass, by_heading = curve(parameters[SERIES], heading, recorded)
    slopes = np.zeros((len(recorded), SIZE))
    slopes[:, SERIES], slopes[:, DECLINATION] = by_compass, -by_heading
    return residual, slopes


def _water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return speed through the water from the triangle minus that of the ship's log times its scale, knots."""
    seen, since = swing.seen, _since_middle(swing.seen)
    east, north = angles.components(seen.speed_kn, seen.course_deg)
    east = east - parameters[EAST] - parameters[EAST_CHANGE] * since
    north = north - parameters[NORTH] - parameters[NORTH_CHANGE] * since
    through, used = np.maximum(np.hypot(east, north), 1e-3), _by_log(swing)
    logged = np.where(used, seen.water_speed_kn, 0.0)
    slopes = np.zeros((len(seen), SIZE))
    slopes[:, EAST], slopes[:, NORTH], slopes[:, LOG] = -east / through, -north / through, -logged
    slopes[:, EAST_CHANGE], slopes[:, NORTH_CHANGE] = slopes[:, EAST] * since, slopes[:, NORTH] * since
    return (through - parameters[LOG] * logged) * used, slopes * used[:, None]


def _by_log(swing: Swing) -> NDArray[np.bool_]:
    """Tell which samples carry a speed through the water; none unless half of them do."""
    seen = swing.seen
    logged = np.nan_to_num(seen.water_speed_kn) > LEAST_WATER_KN
    return logged & (seen.over_ground and swing.has_speed and len(seen) > 0 and logged.mean() > 0.5)


def _since_middle(seen: Observations) -> Floats:
    """Return time from -1/2 to 1/2 of the swing; 0 without times."""
    if not seen.timed:
        return np.zeros(len(seen))
    first, last = seen.time_s.min(), seen.time_s.max()
    return (seen.time_s - (first + last) / 2.0) / max(last - first, 1.0)


def stretches(seen: Observations) -> NDArray[np.int_]:
    """Return the first sample of each stretch of a log without a gap.

    Args:
        seen: observations in order of time.
    """
    step = np.diff(seen.time_s)
    return np.append(0, 1 + np.flatnonzero(step > LONG_GAP_S) if step.size else [])


def headings_of(recorded_deg: Floats) -> NDArray[np.int_]:
    """Return which heading each observation was taken on, (n,): repeated ones share a number.

    Args:
        recorded_deg: recorded headings, (n,).
    """
    order = np.argsort(recorded_deg, kind="stable")
    first = np.append(0.0, np.diff(recorded_deg[order])) > HEADING_GAP_DEG
    groups = np.empty(len(order), dtype=int)
    groups[order] = np.cumsum(first)
    if len(order) and recorded_deg[order[0]] + 360.0 - recorded_deg[order[-1]] <= HEADING_GAP_DEG:
        groups[groups == groups.max()] = 0
    return groups


def _series(coefficients: Floats, heading: Floats, recorded: Floats) -> tuple[Floats, Floats, Floats]:
    columns = von_appen.design(recorded)
    residual = angles.wrap180(angles.difference(heading, recorded) - columns @ coefficients)
    return residual, -columns, np.ones(len(recorded))


def _exact(coefficients: Floats, heading: Floats, recorded: Floats) -> tuple[Floats, Floats, Floats]:
    residual = angles.difference(compass.recorded_heading(coefficients, heading), recorded)
    return residual, compass.gradient(coefficients, heading).T, compass.slope(coefficients, heading)


def parts_of_budget(solution: Solution, columns: Floats) -> dict[str, float]:
    """Return the standard uncertainty of the deviation that each source leaves, rms over headings, degrees.

    Args:
        solution: a fitted series.
        columns: of the series at those headings, (m, 5).
    """
    return {name: _rms_over(part[SERIES, SERIES], columns) for name, part in solution.parts.items()}


def _rms_over(covariance: Floats, columns: Floats) -> float:
    return float(np.sqrt(np.mean(np.einsum("ij,jk,ik->i", columns, covariance, columns))))


def drift_of(parameters: Floats) -> tuple[float, float]:
    """Return set (degrees, true) and drift of the water.

    Args:
        parameters: of the swing.
    """
    return float(angles.direction(*parameters[DRIFT])), float(np.hypot(*parameters[DRIFT]))


def belief_names() -> Mapping[int, str]:
    """Return what the parameters with a belief stand for in a budget."""
    water = "set and drift of the water"
    return {
        DECLINATION: "declination",
        **dict.fromkeys((EAST, NORTH, EAST_CHANGE, NORTH_CHANGE), water),
        LAG: "delay of the course behind the compass",
        LOG: "scale of the ship's log",
    }


def names() -> Sequence[str]:
    """Return the parameters in order."""
    return ("A", "B", "C", "D", "E", "declination", "east", "north", "east_change", "north_change", "lag_s", "log")
