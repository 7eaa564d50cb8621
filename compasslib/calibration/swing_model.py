"""What a swing observes, as a function of compass, declination, water and delay.

The ground's velocity is the water's plus the ship's through it, so the direction of what remains when the drift is
taken from the velocity over ground is the true heading, whatever the speed. No speed through the water is needed; where
the ship's log gives one, its length closes the triangle.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
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
BLOCK_S = 20.0  # over which residuals are averaged to find how alike they are
LEAST_WATER_KN = 0.5
SMOOTHED_S = 30.0
HEADING_GAP_DEG = 2.0  # headings less apart are one heading, repeated
COURSE, VISUAL, WATER, SECOND = "course", "visual", "log", "second"

Curve = Callable[[Floats, Floats, Floats], tuple[Floats, Floats, Floats, Floats]]


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
        begin[SERIES] = exact_start(swing.seen.recorded_deg, corrected_course(begin, swing))
    found = solve(_blocks(swing, _exact if exact else _series), mean, beliefs(swing), begin)
    return _with_second_order(found, swing, unit=angles.DEGREE if exact else 1.0)


def _with_second_order(found: Solution, swing: Swing, unit: float) -> Solution:
    """Add what an unknown drift does to D and E in second order, MM (37) and (43)."""
    if not swing.seen.over_ground:
        return found
    variance = float(np.mean(np.diag(found.covariance)[DRIFT]))
    square = float(np.sum(found.parameters[DRIFT] ** 2)) + variance
    part = np.zeros((SIZE, SIZE))
    sigma = unit / angles.DEGREE * np.sqrt(variance * square) / float(np.median(swing.speed_kn)) ** 2
    part[[3, 4], [3, 4]] = sigma**2
    return replace(found, covariance=found.covariance + part, parts={**found.parts, SECOND: part})


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


def corrected_course(parameters: Floats, swing: Swing) -> Floats:
    """Return the magnetic headings that the courses stand for, water and delay taken off, (n,) degrees.

    Args:
        parameters: of the swing.
        swing: observations.
    """
    through = angles.direction(*_through_water(parameters, swing)) if swing.seen.over_ground else swing.seen.course_deg
    return angles.wrap360(through - _offset(parameters, swing))


def _through_water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return the ship's velocity through the water, true east and north, knots."""
    since = _since_middle(swing.seen)
    east, north = angles.components(swing.speed_kn, swing.seen.course_deg)
    return (
        east - parameters[EAST] - parameters[EAST_CHANGE] * since,
        north - parameters[NORTH] - parameters[NORTH_CHANGE] * since,
    )


def _offset(parameters: Floats, swing: Swing) -> Floats:
    return swing.declination_deg + parameters[DECLINATION] - parameters[LAG] * swing.seen.turn_deg_s


def _slopes(parameters: Floats, swing: Swing, facing_deg: Floats) -> Floats:
    """Return the derivatives of the corrected courses, (n, k).

    They are taken where the ship faces by the fitted compass and at smoothed speeds: the course's own noise in them
    would look like speeds and directions that vary, and tell the drift from B and C where nothing does. So would the
    first harmonic that a wrong drift puts into the speed through the water round the circle: it is taken out.
    """
    seen, since, slopes = swing.seen, _since_middle(swing.seen), np.zeros((len(swing.seen), SIZE))
    slopes[:, DECLINATION], slopes[:, LAG] = -1.0, seen.turn_deg_s
    if seen.over_ground:
        sine, cosine = angles.sin_cos(facing_deg + _offset(parameters, swing))
        speed = smoothed(np.hypot(*_through_water(parameters, swing)), seen)
        round_circle = np.stack([np.ones_like(sine), sine, cosine], axis=-1)
        harmonic = np.linalg.lstsq(round_circle, speed, rcond=1e-6)[0]
        speed = np.maximum(speed - round_circle[:, 1:] @ harmonic[1:], 0.3 * speed) * angles.DEGREE
        slopes[:, EAST], slopes[:, NORTH] = -cosine / speed, sine / speed
        slopes[:, EAST_CHANGE], slopes[:, NORTH_CHANGE] = slopes[:, EAST] * since, slopes[:, NORTH] * since
    return slopes


def smoothed(values: Floats, seen: Observations) -> Floats:
    """Return values averaged over half a minute of a log, (n,); as they are without times.

    Args:
        values: (n,).
        seen: observations in order of time.
    """
    if not seen.timed:
        return values
    first = np.searchsorted(seen.time_s, seen.time_s - SMOOTHED_S / 2.0, side="left")
    last = np.searchsorted(seen.time_s, seen.time_s + SMOOTHED_S / 2.0, side="right")
    total = np.append(0.0, np.cumsum(values))
    return (total[last] - total[first]) / (last - first)


def _blocks(swing: Swing, curve: Curve) -> list[Block]:
    seen = swing.seen
    in_time = blocks_of(seen) if seen.timed else None
    slow = seen.speed_kn if swing.has_speed and seen.over_ground else None
    groups = None if seen.timed else headings_of(seen.recorded_deg)
    blocks = [Block(COURSE, partial(_course, swing=swing, curve=curve), slow, in_time, groups=groups)]
    if swing.marks:
        observe = partial(_mark, swing=swing, curve=curve)
        blocks.append(Block(VISUAL, observe, sigma=swing.options.visual_sigma_deg))
    if _by_log(swing).any():
        blocks.append(Block(WATER, partial(_water, swing=swing), blocks=in_time))
    return blocks


def _course(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    residual, by_compass, by_heading, facing = curve(
        parameters[SERIES], corrected_course(parameters, swing), swing.seen.recorded_deg
    )
    slopes = _slopes(parameters, swing, facing) * by_heading[:, None]
    slopes[:, SERIES] = by_compass
    return residual, slopes


def _mark(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    recorded, true = np.transpose(swing.marks)
    heading = true - swing.declination_deg - parameters[DECLINATION]
    residual, by_compass, by_heading, _ = curve(parameters[SERIES], heading, recorded)
    slopes = np.zeros((len(recorded), SIZE))
    slopes[:, SERIES], slopes[:, DECLINATION] = by_compass, -by_heading
    return residual, slopes


def _water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return speed through the water from the triangle minus that of the ship's log times its scale, knots."""
    since, used = _since_middle(swing.seen), _by_log(swing)
    east, north = _through_water(parameters, swing)
    through, logged = np.maximum(np.hypot(east, north), 1e-3), np.where(used, swing.seen.water_speed_kn, 0.0)
    slopes = np.zeros((len(swing.seen), SIZE))
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


def blocks_of(seen: Observations) -> NDArray[np.int_]:
    """Return the number of each sample's block of 20 s, (n,), empty blocks not counted.

    Args:
        seen: observations in order of time.
    """
    block = np.floor((seen.time_s - seen.time_s[0]) / BLOCK_S)
    return np.unique(block, return_inverse=True)[1]


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


def _series(coefficients: Floats, heading: Floats, recorded: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    columns = von_appen.design(recorded)
    fitted = recorded + columns @ coefficients
    return angles.difference(heading, fitted), -columns, np.ones(len(recorded)), fitted


def _exact(coefficients: Floats, heading: Floats, recorded: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    residual = angles.difference(compass.recorded_heading(coefficients, heading), recorded)
    root = compass.inverse(coefficients, recorded)[:, 0]
    fitted = np.where(np.isfinite(root), root, heading)  # a reading that the compass cannot show has no root
    return residual, compass.gradient(coefficients, fitted).T, compass.slope(coefficients, fitted), fitted


def drift_of(parameters: Floats) -> tuple[float, float]:
    """Return set (degrees, true) and drift of the water.

    Args:
        parameters: of the swing.
    """
    return float(angles.direction(*parameters[DRIFT])), float(np.hypot(*parameters[DRIFT]))
