"""Observation model of a swing: compass, declination, set and drift of the water, delay of the courses.

Velocity over ground minus the drift is the velocity through the water: its direction is the true heading, its size the
speed of the ship's log, where there is one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.calibrations.swing import observations
from compasslib.calibrations.swing.observations import Observations, SwingOptions
from compasslib.deviation.series import series_design
from compasslib.statistics.noise import (
    MIN_SCATTER_DEG,
    SwingNoise,
    clip_residuals,
    estimate_swing_noise,
    score_covariance,
    span_basis,
)
from compasslib.statistics.resampling import student_factor
from compasslib.types import HOUR_S, Bools, Floats

SERIES = slice(0, 5)
DECLINATION, EAST, NORTH, EAST_CHANGE, NORTH_CHANGE, LAG, LOG = range(5, 12)
SIZE = 12
DRIFT, CHANGES = [EAST, NORTH], [EAST_CHANGE, NORTH_CHANGE]
MAX_PRIOR_SHARE = 0.5  # drift counts as separated from B and C if the swing halves its prior width
HARMONICS = (3, 4)  # of the heading, which compasses may have beyond the five terms
COURSE, VISUAL, WATER = "course", "visual", "log"
GNSS_KN = 0.1  # accuracy of a receiver's velocity, 0.05 m/s (data sheet of the u-blox NEO-M8)


@dataclass(frozen=True)
class Block:
    """Observations of one kind."""

    name: str
    observe: Callable[[Floats], tuple[Floats, Floats]]  # parameters -> residuals (n,), their derivatives (n, k)
    speed_kn: Floats | None = None  # (n,) given where slow observations scatter more
    blocks: NDArray[np.int_] | None = None  # (n,) number of the block in time; None where the order is irrelevant
    sigma: float | None = None  # standard deviation, where it is known
    groups: NDArray[np.int_] | None = None  # (n,) number of the heading, common to repeated readings
    prior_sigma: float | None = None  # standard deviation of a reading, used without degrees of freedom to estimate it

    def rows(self, parameters: Floats, noise: SwingNoise) -> Floats:
        """Compute derivatives and residuals, weighted and divided by their scatter, (n, k + 1)."""
        residual, columns = self.observe(parameters)
        scaled = np.column_stack([columns, clip_residuals(residual, noise)]) / noise.sigma[:, None]
        return scaled * np.sqrt(noise.weight)


@dataclass(frozen=True)
class SwingFit:
    """Fitted parameters with their covariance and the contributions to it."""

    parameters: Floats  # (k,)
    covariance: Floats  # (k, k)
    parts: Mapping[str, Floats]  # name of a block, or number of a parameter with a prior -> (k, k); they add up
    residuals: Mapping[str, Floats]
    noises: Mapping[str, SwingNoise]


def solve(blocks: Sequence[Block], mean: Floats, sigma: Floats, start: Floats) -> SwingFit:
    """Fit the parameters to all blocks by Gauss-Newton, with a prior mean and standard deviation of each, (k,).

    The scatter of the first block is added in quadrature to the known ``sigma`` of others. The standard deviation is
    infinite for a parameter without a prior.
    """
    parameters, noises = start.astype(float), dict[str, SwingNoise]()
    for _ in range(4):
        before, noises = noises, {}
        for block in blocks:
            first = next(iter(noises.values())).sigma if noises else np.zeros(1)
            noises[block.name] = _estimate_noise(block, parameters, sigma, before.get(block.name), first)
        for block in blocks:  # not to the marks, which have the scatter of the compass but no receiver
            if block.speed_kn is not None:
                least = GNSS_KN / block.speed_kn / angles.DEGREE
                noises[block.name] = replace(noises[block.name], sigma=np.maximum(noises[block.name].sigma, least))
        for _ in range(3):
            prior = np.column_stack([np.diag(1.0 / sigma), (parameters - mean) / sigma])
            stacked = np.vstack([*(block.rows(parameters, noises[block.name]) for block in blocks), prior])
            parameters = parameters - np.linalg.lstsq(stacked[:, :-1], stacked[:, -1])[0]
    spreads, informations = dict[str, Floats](), []
    for block in blocks:
        noise, rows = noises[block.name], block.rows(parameters, noises[block.name])[:, :-1]
        spread = score_covariance(rows, noise, block.blocks)
        spreads[block.name] = noise.weight * student_factor(noise.dof) ** 2 * spread
        informations.append(rows.T @ rows)
    priors = {str(k): np.diag((np.arange(len(sigma)) == k) * sigma**-2.0) for k in np.flatnonzero(np.isfinite(sigma))}
    inverse = np.linalg.inv(np.sum([*informations, *priors.values()], axis=0))
    parts = {name: inverse @ middle @ inverse for name, middle in (spreads | priors).items()}
    residuals = {block.name: block.observe(parameters)[0] for block in blocks}
    return SwingFit(parameters, np.sum(list(parts.values()), axis=0), parts, residuals, noises)


def _estimate_noise(
    block: Block,
    parameters: Floats,
    sigma: Floats,
    before: SwingNoise | None,  # noise of the round before
    first_sigma: Floats,  # scatter of the first block
) -> SwingNoise:
    """Estimate the noise of one kind of observation."""
    residual, columns = block.observe(parameters)
    if block.sigma is not None:
        scatter = np.hypot(block.sigma, np.sqrt(np.mean(first_sigma**2)))
        return SwingNoise(np.full(residual.shape, scatter), dof=np.inf)
    size = np.full(residual.shape, np.std(residual) + MIN_SCATTER_DEG) if before is None else before.sigma
    # Degrees of freedom of the fit: free parameters, and those that the data determine better than the prior.
    scaled, known = columns / size[:, None], np.isfinite(sigma)
    free, by_priors = span_basis(scaled[:, ~known]), scaled[:, known] * sigma[known]
    beyond = span_basis(by_priors - free @ (free.T @ by_priors), least=2.0)
    basis = span_basis(np.column_stack([free, beyond]) * size[:, None])
    noise, repeats = estimate_swing_noise(residual, basis, speed_kn=block.speed_kn, blocks=block.blocks), 1.0
    if block.groups is not None:  # errors common to the readings on one heading do not average out
        _, group, count = np.unique(block.groups, return_inverse=True, return_counts=True)
        repeats, dof = len(group) / len(count), len(count) - basis.shape[1]
        if dof < noise.dof:
            between = np.sqrt(np.sum(np.bincount(group, residual) ** 2 / count) / max(dof, 1))
            scatter = np.maximum(noise.sigma, between)
            noise = SwingNoise(scatter, n_effective=float(len(count)), dof=float(max(dof, 0)))
    if block.prior_sigma is not None and noise.dof < 1.0:  # no degrees of freedom: stated scatter
        stated = block.prior_sigma * np.sqrt(repeats)  # repeated readings on a heading share one error
        noise = replace(noise, sigma=np.maximum(noise.sigma, stated), dof=np.inf)
    # The scatter of few residuals may be small by chance: they must not overrule the priors.
    return replace(noise, weight=noise.weight / student_factor(noise.dof) ** 2)


@dataclass(frozen=True)
class Prediction:
    """Residuals of a compass at given headings, with their derivatives."""

    residual_deg: Floats  # (n,)
    by_compass: Floats  # (n, 5) derivatives of the residuals with respect to the coefficients
    by_heading: Floats  # (n,) derivative of the residuals with respect to the heading
    facing_deg: Floats  # (n,) magnetic heading inferred from the reading


@dataclass(frozen=True)
class Swing:
    """Observations of a swing with the known inputs of the model, and their observation equations.

    An equation maps the parameters to residuals, (n,), and their derivatives, (n, k).
    """

    observed: Observations
    options: SwingOptions
    declination_deg: float
    declination_sigma_deg: float
    marks: tuple[tuple[float, float], ...] = ()  # (recorded, true) headings by a visual mark or the sun
    exact: bool = False  # whether the compass is the exact model (dimensionless) or the series (degrees)

    @property
    def has_speed(self) -> bool:
        """Whether speeds were logged; otherwise the drift is in units of the ship's speed."""
        return bool(np.isfinite(self.observed.speed_kn).all())

    @property
    def widest_drift(self) -> float:
        """Largest drift that the prior allows, knots, or relative to the ship's speed where that is unknown."""
        return self.options.max_drift_kn if self.has_speed else self.options.drift_ratio

    @property
    def speed_kn(self) -> Floats:
        """Speed over ground (n,), knots; 1 where it is unknown."""
        return self.observed.speed_kn if self.has_speed else np.ones(len(self.observed))

    @cached_property
    def logged(self) -> Bools:
        """Samples with a logged speed through the water of more than half a knot; none unless most have one."""
        observed = self.observed
        logged = np.nan_to_num(observed.water_speed_kn) > 0.5
        return logged & (observed.over_ground and self.has_speed and len(observed) > 0 and logged.mean() > 0.5)

    @cached_property
    def since(self) -> Floats:
        """Time scaled to -1/2 to 1/2 over the swing, (n,); 0 if any time is unknown."""
        time_s = self.observed.time_s
        if not np.isfinite(time_s).all():
            return np.zeros(time_s.shape)
        first, last = time_s.min(), time_s.max()
        return (time_s - (first + last) / 2.0) / max(last - first, 1.0)

    def drift(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Compute the water's velocity at each observation, true east and north, knots."""
        east = parameters[EAST] + parameters[EAST_CHANGE] * self.since
        return east, parameters[NORTH] + parameters[NORTH_CHANGE] * self.since

    def through_water(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Compute the ship's velocity through the water, true east and north, knots."""
        (east, north), drift = angles.components(self.speed_kn, self.observed.course_deg), self.drift(parameters)
        return east - drift[0], north - drift[1]

    def offset(self, parameters: Floats) -> Floats:
        """Compute courses minus magnetic headings due to declination and delay, (n,) degrees."""
        turn_deg_s = self.observed.steady_turn_deg_s
        return self.declination_deg + parameters[DECLINATION] - parameters[LAG] * turn_deg_s

    def predict(self, coefficients: Floats, heading: Floats, recorded: Floats) -> Prediction:
        """Compare readings with those of the compass at headings, (n,) degrees each."""
        if not self.exact:
            columns = series_design(recorded)
            fitted = recorded + columns @ coefficients
            return Prediction(angles.difference(heading, fitted), -columns, np.ones(len(recorded)), fitted)
        residual = angles.difference(compass.recorded_heading(coefficients, angles.wrap360(heading)), recorded)
        root = compass.inverse(coefficients, recorded)[:, 0]
        fitted = np.where(np.isfinite(root), root, heading)  # readings outside the compass's range have no root
        by_compass, slope = compass.gradient(coefficients, fitted).T, compass.slope(coefficients, fitted)
        return Prediction(residual, by_compass, slope, fitted)

    def by_courses(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Compute the residuals of the compass against the courses, degrees."""
        observed, offset = self.observed, self.offset(parameters)
        heading: Floats = observed.course_deg - offset
        slopes: Floats = np.zeros((len(observed), SIZE))
        predicted = self.predict(parameters[SERIES], heading, observed.settled_deg)
        if observed.over_ground:
            alike = predicted.by_compass / predicted.by_heading[:, None]
            aside, slopes = self._drift_angle(parameters, predicted.facing_deg + offset, alike)
            heading, slopes = heading - aside, -slopes
        slopes[:, DECLINATION], slopes[:, LAG] = -1.0, observed.steady_turn_deg_s
        slopes *= predicted.by_heading[:, None]
        slopes[:, SERIES] = predicted.by_compass
        unsettled = angles.difference(observed.recorded_deg, observed.settled_deg)
        residual = self.predict(parameters[SERIES], heading, observed.settled_deg).residual_deg
        return angles.difference(residual, unsettled), slopes

    def _drift_angle(self, parameters: Floats, facing_deg: Floats, by_compass: Floats) -> tuple[Floats, Floats]:
        """Compute the drift angle of the courses, (n,) degrees, and its derivatives by the parameters, (n, k).

        Linearised at B and C, which absorb part of the drift, it includes the second order on A, D and E (MM (37),
        (43)). Harmonics beyond the five terms, which compasses may have, are projected out: only speeds separate the
        drift.
        """
        (sine, cosine), (east, north) = angles.sin_cos(facing_deg), self.drift(parameters)
        # Noise of speeds, and of the compass through the heading, would look like varying speeds: both are smoothed.
        along, beside, over_ground = (
            observations.moving_average(x, self.observed.time_s, 60.0)
            for x in (east * sine + north * cosine, east * cosine - north * sine, self.speed_kn)
        )
        least = np.maximum(0.3 * over_ground, 1e-3)  # where the drift is faster than the ship
        speed = np.maximum(np.sqrt(np.maximum(over_ground**2 - beside**2, 0.0)) - along, least)  # through the water
        east, north = speed * sine + east, speed * cosine + north
        square = np.maximum(east**2 + north**2, (0.3 * speed) ** 2)
        across = np.stack([north, -east], axis=-1) / square[:, None] / angles.DEGREE  # by the drift's east and north
        higher = np.column_stack([np.stack(angles.sin_cos(order * facing_deg), axis=-1) for order in HARMONICS])
        higher = higher - by_compass @ np.linalg.lstsq(by_compass, higher, rcond=1e-9)[0]
        # On five headings only rounding errors remain of the higher harmonics.
        basis, slopes = span_basis(higher, least=1e-6), np.zeros((len(speed), SIZE))
        slopes[:, DRIFT] = across - basis @ (basis.T @ across)
        slopes[:, CHANGES] = across * self.since[:, None]
        return angles.difference(angles.direction(east, north), facing_deg), slopes

    def by_marks(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Compute the residuals of the compass against the marks, degrees."""
        recorded, true = np.transpose(self.marks)
        predicted = self.predict(parameters[SERIES], true - self.declination_deg - parameters[DECLINATION], recorded)
        slopes = np.zeros((len(recorded), SIZE))
        slopes[:, SERIES], slopes[:, DECLINATION] = predicted.by_compass, -predicted.by_heading
        return predicted.residual_deg, slopes

    def by_log(self, parameters: Floats) -> tuple[Floats, Floats]:
        """Compute the speed through the water minus the scaled speed of the ship's log, knots."""
        east, north = self.through_water(parameters)
        through = np.maximum(np.hypot(east, north), 1e-3)
        logged = np.where(self.logged, self.observed.water_speed_kn, 0.0)
        slopes = np.zeros((len(self.observed), SIZE))
        slopes[:, EAST], slopes[:, NORTH], slopes[:, LOG] = -east / through, -north / through, -logged
        slopes[:, CHANGES] = slopes[:, DRIFT] * self.since[:, None]
        return (through - parameters[LOG] * logged) * self.logged, slopes * self.logged[:, None]


def fit_swing(swing: Swing, start: Floats | None = None) -> SwingFit:
    """Fit drift, course delay and the compass."""
    observed, mean = swing.observed, np.zeros(SIZE)
    mean[LOG] = 1.0
    begin = mean.copy() if start is None else start.copy()
    if start is None:  # start A at the mean offset, lest readings of a misaligned compass be clipped
        off = angles.mean(observed.course_deg - observed.recorded_deg)
        begin[0] = angles.wrap180(off - swing.declination_deg)
    if swing.exact:  # start from magnetic headings: courses corrected for drift and delay
        through = angles.direction(*swing.through_water(begin)) if observed.over_ground else observed.course_deg
        w = angles.phasor(angles.wrap360(through - swing.offset(begin)))
        g, ones = np.conj(angles.phasor(observed.recorded_deg)), np.ones_like(w)
        # Linear in A to E: Im(e^{-i gamma} q) = 0 (physics page, section 3).
        columns = np.imag(g[:, None] * np.stack([-1j * w, ones, -1j * ones, np.conj(w), -1j * np.conj(w)], axis=-1))
        begin[SERIES] = np.linalg.lstsq(columns, -np.imag(g * w))[0]
    in_time, groups = None, None
    if observed.timed:  # blocks of 20 s, numbered without the empty ones
        block = np.floor((observed.time_s - observed.time_s[0]) / observations.BLOCK_S)
        in_time = np.unique(block, return_inverse=True)[1]
    else:
        groups = observations.group_headings(observed.recorded_deg)
    slow, scatter = observed.speed_kn if swing.has_speed and observed.over_ground else None, swing.options
    blocks = [Block(COURSE, swing.by_courses, slow, in_time, groups=groups, prior_sigma=scatter.course_sigma_deg)]
    if swing.marks:
        blocks.append(Block(VISUAL, swing.by_marks, sigma=scatter.visual_sigma_deg))
    if swing.logged.any():
        blocks.append(Block(WATER, swing.by_log, blocks=in_time))
    return solve(blocks, mean, prior_widths(swing), begin)


def prior_widths(swing: Swing) -> Floats:
    """Compute the prior standard deviation of each parameter, infinite for the compass coefficients."""
    fixed_sigma = 1e-9  # of a parameter that cannot be determined
    observed, sigma = swing.observed, np.full(SIZE, fixed_sigma)
    sigma[SERIES] = np.inf
    sigma[DECLINATION] = max(swing.declination_sigma_deg, fixed_sigma)
    if observed.over_ground:
        sigma[DRIFT] = max(swing.widest_drift / 2.0, fixed_sigma)
    if observed.timed:
        # A tidal current rises from slack to full in three hours.
        share = min(1.0, float(np.ptp(observed.time_s)) / (3.0 * HOUR_S))
        sigma[CHANGES] = np.maximum(sigma[DRIFT] * share, fixed_sigma)
        sigma[LAG] = max(swing.options.max_lag_s / 2.0, fixed_sigma)
    if swing.logged.any():
        sigma[LOG] = 0.1
    return sigma


def set_and_drift(parameters: Floats) -> tuple[float, float]:
    """Convert the drift components to set (degrees true, towards) and drift speed."""
    return float(angles.direction(*parameters[DRIFT])), float(np.hypot(*parameters[DRIFT]))


def separate_drift(swing: Swing, series: SwingFit) -> dict[str, Any]:
    """Describe set and drift of the water, and whether they are separated from B and C."""
    (set_deg, drift), covariance, prior = set_and_drift(series.parameters), series.covariance, prior_widths(swing)
    sigma, water = np.sqrt(np.diag(covariance)), covariance[np.ix_(DRIFT, DRIFT)]
    separable = bool(np.max(sigma[DRIFT] / prior[DRIFT]) < MAX_PRIOR_SHARE)
    along, across = (np.array(angles.components(1.0, towards)) for towards in (set_deg, set_deg + 90.0))
    ahead, side = (float(np.sqrt(max(float(x @ water @ x), 0.0))) for x in (along, across))
    sigma_set = float(angles.direction(side, drift)) if drift else 90.0
    unit, ratio = "of the ship's speed", "no speeds"
    if swing.has_speed:
        speed = swing.observed.speed_kn
        unit, ratio = "kn", f"speeds from {speed.min():.1f} to {speed.max():.1f} kn"
    described = f"set {set_deg:.0f} ± {1.96 * sigma_set:.0f}° (true), drift {drift:.2f} ± {1.96 * ahead:.2f} {unit}"
    text = (
        f"With {ratio} the current is separated from the compass: {described} (95 %). A steady leeway by wind has the "
        "same signature."
        if separable
        else f"With {ratio} set and drift cannot be separated from B and C: to first order they are the same function "
        f"of the heading. B and C have ± {sigma[1]:.1f}° and ± {sigma[2]:.1f}°; A, D and E are not affected. A visual "
        "mark, the sun, a log of the speed through the water, or each heading at two speeds would separate them."
    )
    return {
        "set_deg": set_deg,
        "drift_kn": drift if swing.has_speed else None,
        "drift_ratio": drift / float(np.median(swing.speed_kn)),
        "sigma_drift_kn": ahead if swing.has_speed else None,
        "sigma_set_deg": sigma_set,
        "east": float(series.parameters[EAST]),
        "north": float(series.parameters[NORTH]),
        "covariance": water.tolist(),
        "log_scale": float(series.parameters[LOG]) if np.isfinite(prior[LOG]) and prior[LOG] > 1e-6 else None,
        "separable": separable,
        "described": described,
        "text": text,
    }
