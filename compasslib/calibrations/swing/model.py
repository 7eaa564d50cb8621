"""What a swing observes, as a function of compass, declination, water and delay.

The ground's velocity is the water's plus the ship's through it, so the direction of what remains when the drift is
taken from the velocity over ground is the true heading, whatever the speed. No speed through the water is needed; where
the ship's log gives one, its length closes the triangle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

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
from compasslib.types import Bools, Floats

ROUNDS, STEPS = 4, 3
MIN_INFORMATION = 2.0  # the data know a parameter that they tell twice as well as the prior
SERIES = slice(0, 5)
DECLINATION, EAST, NORTH, EAST_CHANGE, NORTH_CHANGE, LAG, LOG = range(5, 12)
SIZE = 12
DRIFT, CHANGES = [EAST, NORTH], [EAST_CHANGE, NORTH_CHANGE]
FIXED_SIGMA = 1e-9  # prior width of a parameter that cannot be determined
MAX_PRIOR_SHARE = 0.5  # drift is told from B and C where the swing halves its prior
LOG_SIGMA = 0.1  # of a ship's log's scale
SPRING_S = 3 * 3600.0  # a tide goes from slack to full in three hours
MIN_WATER_KN = 0.5
SMOOTHED_S = 60.0  # over which speeds are averaged
HARMONICS = (3, 4)  # which compasses have too
MIN_LEFT = 1e-6  # of a harmonic of amplitude 1 beside the compass's own terms
MIN_SPEED_SHARE = 0.3  # of a speed, where the drift is faster than the ship
COURSE, VISUAL, WATER = "course", "visual", "log"


@dataclass(frozen=True)
class Block:
    """Observations of one kind."""

    name: str
    observe: Callable[[Floats], tuple[Floats, Floats]]  # parameters -> residuals (n,), their derivatives (n, k)
    speed_kn: Floats | None = None  # where slow ones scatter more
    blocks: NDArray[np.int_] | None = None  # (n,) number of the block in time; None: their order says nothing
    sigma: float | None = None  # scatter, where it is known
    groups: NDArray[np.int_] | None = None  # (n,) which were taken on one heading
    prior_sigma: float | None = None  # scatter of a reading, where too few degrees of freedom show it


@dataclass(frozen=True)
class SwingFit:
    """Parameters with covariance, and what the covariance is made of."""

    parameters: Floats  # (k,)
    covariance: Floats  # (k, k)
    parts: Mapping[str, Floats]  # name of a block, or number of a parameter with a prior -> (k, k); they add up
    residuals: Mapping[str, Floats]
    noises: Mapping[str, SwingNoise]


def solve(blocks: Sequence[Block], mean: Floats, sigma: Floats, start: Floats) -> SwingFit:
    """Fit the parameters to all blocks by Gauss-Newton.

    Args:
        blocks: observations; the first sets the least scatter of those with a known one.
        sigma: (k,) their width, infinite for a parameter without.
    """
    parameters, noises = start.astype(float), dict[str, SwingNoise]()
    for _ in range(ROUNDS):
        noises = _noises(blocks, parameters, sigma, noises)
        for _ in range(STEPS):
            rows = _rows(blocks, parameters, noises)
            prior = np.column_stack([np.diag(1.0 / sigma), (parameters - mean) / sigma])
            stacked = np.vstack([*rows.values(), prior])
            parameters = parameters - np.linalg.lstsq(stacked[:, :-1], stacked[:, -1])[0]
    return _solution(blocks, parameters, sigma, noises)


def _noises(
    blocks: Sequence[Block], parameters: Floats, sigma: Floats, before: Mapping[str, SwingNoise]
) -> dict[str, SwingNoise]:
    noises: dict[str, SwingNoise] = {}
    for block in blocks:
        residual, columns = block.observe(parameters)
        if block.sigma is not None:
            first = next(iter(noises.values())).sigma if noises else np.zeros(1)
            scatter = np.hypot(block.sigma, np.sqrt(np.mean(first**2)))
            noises[block.name] = SwingNoise(np.full(residual.shape, scatter), dof=np.inf)
            continue
        size = before[block.name].sigma if before else np.full(residual.shape, np.std(residual) + MIN_SCATTER_DEG)
        # What the fit takes up: free parameters, and those that the data know better than the prior.
        scaled, known = columns / size[:, None], np.isfinite(sigma)
        free, by_priors = span_basis(scaled[:, np.isinf(sigma)]), scaled[:, known] * sigma[known]
        beyond = span_basis(by_priors - free @ (free.T @ by_priors), least=MIN_INFORMATION)
        basis = span_basis(np.column_stack([free, beyond]) * size[:, None])
        noise = estimate_swing_noise(residual, basis, speed_kn=block.speed_kn, blocks=block.blocks)
        if block.groups is not None:  # what is common to the readings on one heading does not average out
            count, total = np.bincount(block.groups), np.bincount(block.groups, residual)
            occupied = count > 0
            dof = int(occupied.sum()) - basis.shape[1]
            if dof < noise.dof:
                between = np.sqrt(np.sum(total[occupied] ** 2 / count[occupied]) / max(dof, 1))
                scatter = np.maximum(noise.sigma, between)
                noise = SwingNoise(scatter, n_effective=float(occupied.sum()), dof=float(max(dof, 0)))
        if block.prior_sigma is not None and noise.dof < 1.0:  # no degree of freedom shows the scatter: as stated
            repeats = 1.0 if block.groups is None else len(block.groups) / len(np.unique(block.groups))
            stated = block.prior_sigma * np.sqrt(repeats)  # a reading that repeats a heading has its error again
            noise = replace(noise, sigma=np.maximum(noise.sigma, stated), dof=np.inf)
        # So few residuals that their scatter may be small by chance must not overrule the priors.
        noises[block.name] = replace(noise, weight=noise.weight / student_factor(noise.dof) ** 2)
    return noises


def _rows(blocks: Sequence[Block], parameters: Floats, noises: Mapping[str, SwingNoise]) -> dict[str, Floats]:
    rows = {}
    for block in blocks:
        residual, columns = block.observe(parameters)
        noise = noises[block.name]
        clipped = clip_residuals(residual, noise)
        scaled = np.column_stack([columns, clipped]) / noise.sigma[:, None]
        rows[block.name] = scaled * np.sqrt(noise.weight)
    return rows


def _solution(blocks: Sequence[Block], parameters: Floats, sigma: Floats, noises: Mapping[str, SwingNoise]) -> SwingFit:
    rows = {name: each[:, :-1] for name, each in _rows(blocks, parameters, noises).items()}
    in_time = {block.name: block.blocks for block in blocks}
    priors = {str(k): np.diag((np.arange(len(sigma)) == k) * sigma**-2.0) for k in np.flatnonzero(np.isfinite(sigma))}
    information = np.sum([*(each.T @ each for each in rows.values()), *priors.values()], axis=0)
    inverse = np.linalg.inv(information)
    spreads = {}
    for name, each in rows.items():
        widened = noises[name].weight * student_factor(noises[name].dof) ** 2
        spreads[name] = widened * score_covariance(each, noises[name], in_time[name])
    parts = {name: inverse @ middle @ inverse for name, middle in (spreads | priors).items()}
    residuals = {block.name: block.observe(parameters)[0] for block in blocks}
    return SwingFit(parameters, np.sum(list(parts.values()), axis=0), parts, residuals, noises)


@dataclass(frozen=True)
class Prediction:
    """What a compass shows on headings."""

    residual_deg: Floats  # (n,)
    by_compass: Floats  # (n, 5) its derivatives by the coefficients
    by_heading: Floats  # (n,) and by the heading
    facing_deg: Floats  # (n,) magnetic heading by the reading


Curve = Callable[[Floats, Floats, Floats], Prediction]  # coefficients, headings, readings, degrees


@dataclass(frozen=True)
class Swing:
    """Observations with what is needed to explain them."""

    observed: Observations
    options: SwingOptions
    declination_deg: float
    declination_sigma_deg: float
    marks: tuple[tuple[float, float], ...] = ()  # (recorded, true) headings by a visual mark or the sun
    horizontal_nT: float | None = None  # the earth's field, None where it is unknown

    @property
    def has_speed(self) -> bool:
        """Whether speeds were logged; else the ship's speed is the unit and the drift a share of it."""
        return bool(np.isfinite(self.observed.speed_kn).all())

    @property
    def widest_drift(self) -> float:
        """The largest drift that the prior allows, knots, or over the ship's speed where that is not known."""
        return self.options.max_drift_kn if self.has_speed else self.options.drift_ratio

    @property
    def speed_kn(self) -> Floats:
        """The speed over ground, 1 where it is not known, (n,)."""
        return self.observed.speed_kn if self.has_speed else np.ones(len(self.observed))


def fit_swing(swing: Swing, *, exact: bool = False, start: Floats | None = None) -> SwingFit:
    """Fit the water's drift, the course's delay and the compass: exact (dimensionless), or a series (degrees)."""
    mean = np.zeros(SIZE)
    mean[LOG] = 1.0
    begin = mean.copy() if start is None else start.copy()
    if start is None:  # a compass mounted askew is no outlier
        off = angles.mean(swing.observed.course_deg - swing.observed.recorded_deg)
        begin[0] = angles.wrap180(off - swing.declination_deg)
    if exact:  # by courses without water and delay: magnetic headings
        ground = swing.observed.over_ground
        through = angles.direction(*_through_water(begin, swing)) if ground else swing.observed.course_deg
        heading_deg = angles.wrap360(through - _offset(begin, swing))
        begin[SERIES] = exact_start(swing.observed.recorded_deg, heading_deg)
    return solve(_blocks(swing, _exact if exact else _series), mean, prior_widths(swing), begin)


def prior_widths(swing: Swing) -> Floats:
    """Compute the prior width of each parameter, infinite for the compass.

    A drift that may be anything up to a largest one, in any direction, has half of that as its standard deviation
    along either axis.
    """
    observed, sigma = swing.observed, np.full(SIZE, FIXED_SIGMA)
    sigma[SERIES] = np.inf
    sigma[DECLINATION] = max(swing.declination_sigma_deg, FIXED_SIGMA)
    if observed.over_ground:
        sigma[DRIFT] = max(swing.widest_drift / 2.0, FIXED_SIGMA)
    if observed.timed:
        lasted = float(np.ptp(observed.time_s))
        sigma[CHANGES] = np.maximum(sigma[DRIFT] * min(1.0, lasted / SPRING_S), FIXED_SIGMA)
        sigma[LAG] = max(swing.options.max_lag_s / 2.0, FIXED_SIGMA)
    if _by_log(swing).any():
        sigma[LOG] = LOG_SIGMA
    return sigma


def exact_start(recorded_deg: Floats, heading_deg: Floats) -> Floats:
    """Fit A..E of the exact compass linearly, Im(e^{-i gamma} q) = 0 (physics page, section 3), (5,)."""
    g, w = np.conj(angles.phasor(recorded_deg)), angles.phasor(heading_deg)
    ones = np.ones_like(w)
    columns = np.imag(g[:, None] * np.stack([-1j * w, ones, -1j * ones, np.conj(w), -1j * np.conj(w)], axis=-1))
    return np.asarray(np.linalg.lstsq(columns, -np.imag(g * w))[0])


def _drift(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Compute the water's velocity at each observation, true east and north, knots."""
    since = observations.since_middle(swing.observed.time_s)
    east = parameters[EAST] + parameters[EAST_CHANGE] * since
    return east, parameters[NORTH] + parameters[NORTH_CHANGE] * since


def _through_water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Compute the ship's velocity through the water, true east and north, knots."""
    (east, north), drift = angles.components(swing.speed_kn, swing.observed.course_deg), _drift(parameters, swing)
    return east - drift[0], north - drift[1]


def _offset(parameters: Floats, swing: Swing) -> Floats:
    return swing.declination_deg + parameters[DECLINATION] - parameters[LAG] * swing.observed.steady_turn_deg_s


def _drift_angle(parameters: Floats, swing: Swing, facing_deg: Floats, by_compass: Floats) -> tuple[Floats, Floats]:
    """Compute the drift angle of the courses, (n,) degrees, and its derivatives by the parameters, (n, k).

    Linearised at the fitted B and C, which hold part of the drift, it has what is of second order in the drift in A, D
    and E too (MM (37), (43)). Only speeds that vary may separate the drift from B and C. At one speed it differs from
    what a compass can be in higher harmonics of the heading alone, which compasses have too: what is like these is
    taken out of its derivatives.
    """
    speed = _through_speed(parameters, swing, facing_deg)
    (sine, cosine), (east, north) = angles.sin_cos(facing_deg), _drift(parameters, swing)
    east, north = speed * sine + east, speed * cosine + north
    square = np.maximum(east**2 + north**2, (MIN_SPEED_SHARE * speed) ** 2)
    across = np.stack([north, -east], axis=-1) / square[:, None] / angles.DEGREE  # by the drift towards east and north
    higher = np.column_stack([np.stack(angles.sin_cos(order * facing_deg), axis=-1) for order in HARMONICS])
    higher = higher - by_compass @ np.linalg.lstsq(by_compass, higher, rcond=1e-9)[0]
    # On five headings rounding is all that is left of them.
    basis, slopes = span_basis(higher, least=MIN_LEFT), np.zeros((len(speed), SIZE))
    slopes[:, DRIFT] = across - basis @ (basis.T @ across)
    slopes[:, CHANGES] = across * observations.since_middle(swing.observed.time_s)[:, None]
    return angles.difference(angles.direction(east, north), facing_deg), slopes


def _through_speed(parameters: Floats, swing: Swing, facing_deg: Floats) -> Floats:
    """Compute the speed through the water, (n,), from that over ground, the drift and the ship's heading.

    Noise in the speeds would look like speeds that vary, and noise of the compass too, by the heading: both are
    smoothed.
    """
    (sine, cosine), (east, north) = angles.sin_cos(facing_deg), _drift(parameters, swing)
    along, across, over_ground = (
        observations.moving_average(x, swing.observed.time_s, SMOOTHED_S)
        for x in (east * sine + north * cosine, east * cosine - north * sine, swing.speed_kn)
    )
    through = np.sqrt(np.maximum(over_ground**2 - across**2, 0.0)) - along
    least = np.maximum(MIN_SPEED_SHARE * over_ground, 1e-3)  # where the drift is faster than the ship
    return np.maximum(through, least)


def _blocks(swing: Swing, curve: Curve) -> list[Block]:
    observed = swing.observed
    in_time = None
    if observed.timed:  # blocks of 20 s, empty ones not counted
        block = np.floor((observed.time_s - observed.time_s[0]) / observations.BLOCK_S)
        in_time = np.unique(block, return_inverse=True)[1]
    slow = observed.speed_kn if swing.has_speed and observed.over_ground else None
    groups = None if observed.timed else observations.group_headings(observed.recorded_deg)
    course = partial(_course, swing=swing, curve=curve)
    blocks = [Block(COURSE, course, slow, in_time, groups=groups, prior_sigma=swing.options.course_sigma_deg)]
    if swing.marks:
        observe = partial(_mark, swing=swing, curve=curve)
        blocks.append(Block(VISUAL, observe, sigma=swing.options.visual_sigma_deg))
    if _by_log(swing).any():
        blocks.append(Block(WATER, partial(_water, swing=swing), blocks=in_time))
    return blocks


def _course(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    observed, offset = swing.observed, _offset(parameters, swing)
    heading: Floats = observed.course_deg - offset
    slopes: Floats = np.zeros((len(observed), SIZE))
    predicted = curve(parameters[SERIES], heading, observed.settled_deg)
    if observed.over_ground:
        alike = predicted.by_compass / predicted.by_heading[:, None]
        aside, slopes = _drift_angle(parameters, swing, predicted.facing_deg + offset, alike)
        heading, slopes = heading - aside, -slopes
    slopes[:, DECLINATION], slopes[:, LAG] = -1.0, observed.steady_turn_deg_s
    slopes *= predicted.by_heading[:, None]
    slopes[:, SERIES] = predicted.by_compass
    unsettled = angles.difference(observed.recorded_deg, observed.settled_deg)
    return angles.difference(curve(parameters[SERIES], heading, observed.settled_deg).residual_deg, unsettled), slopes


def _mark(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    recorded, true = np.transpose(swing.marks)
    predicted = curve(parameters[SERIES], true - swing.declination_deg - parameters[DECLINATION], recorded)
    slopes = np.zeros((len(recorded), SIZE))
    slopes[:, SERIES], slopes[:, DECLINATION] = predicted.by_compass, -predicted.by_heading
    return predicted.residual_deg, slopes


def _water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Compute speed through the water from the triangle minus that of the ship's log times its scale, knots."""
    since, used = observations.since_middle(swing.observed.time_s), _by_log(swing)
    east, north = _through_water(parameters, swing)
    through, logged = np.maximum(np.hypot(east, north), 1e-3), np.where(used, swing.observed.water_speed_kn, 0.0)
    slopes = np.zeros((len(swing.observed), SIZE))
    slopes[:, EAST], slopes[:, NORTH], slopes[:, LOG] = -east / through, -north / through, -logged
    slopes[:, EAST_CHANGE], slopes[:, NORTH_CHANGE] = slopes[:, EAST] * since, slopes[:, NORTH] * since
    return (through - parameters[LOG] * logged) * used, slopes * used[:, None]


def _by_log(swing: Swing) -> Bools:
    """Flag samples with a speed through the water; none unless half of them have one."""
    observed = swing.observed
    logged = np.nan_to_num(observed.water_speed_kn) > MIN_WATER_KN
    return logged & (observed.over_ground and swing.has_speed and len(observed) > 0 and logged.mean() > 0.5)


def _series(coefficients: Floats, heading: Floats, recorded: Floats) -> Prediction:
    columns = series_design(recorded)
    fitted = recorded + columns @ coefficients
    return Prediction(angles.difference(heading, fitted), -columns, np.ones(len(recorded)), fitted)


def _exact(coefficients: Floats, heading: Floats, recorded: Floats) -> Prediction:
    residual = angles.difference(compass.recorded_heading(coefficients, angles.wrap360(heading)), recorded)
    root = compass.inverse(coefficients, recorded)[:, 0]
    fitted = np.where(np.isfinite(root), root, heading)  # a reading that the compass cannot show has no root
    return Prediction(residual, compass.gradient(coefficients, fitted).T, compass.slope(coefficients, fitted), fitted)


def set_and_drift(parameters: Floats) -> tuple[float, float]:
    """Convert the drift to set (degrees, true) and speed."""
    return float(angles.direction(*parameters[DRIFT])), float(np.hypot(*parameters[DRIFT]))


def separate_drift(swing: Swing, series: SwingFit) -> dict[str, object]:
    """Describe set and drift of the water, how well they are separated from B and C, and what stays confounded."""
    set_deg, drift = set_and_drift(series.parameters)
    covariance, prior = series.covariance, prior_widths(swing)
    sigma = np.sqrt(np.diag(covariance))
    along = np.array(angles.components(1.0, set_deg))
    across = np.array(angles.components(1.0, set_deg + 90.0))
    water = covariance[np.ix_(DRIFT, DRIFT)]
    left = float(np.max(sigma[DRIFT] / prior[DRIFT]))
    unit = "kn" if swing.has_speed else "of the ship's speed"
    ahead, side = (float(np.sqrt(max(float(x @ water @ x), 0.0))) for x in (along, across))
    sigma_set = float(angles.direction(side, drift)) if drift else 90.0
    described = f"set {set_deg:.0f} ± {1.96 * sigma_set:.0f}° (true), drift {drift:.2f} ± {1.96 * ahead:.2f} {unit}"
    index = [1, 2, *DRIFT]  # B, C and the drift: their combination with the widest covariance
    scale = sigma[index]
    size, vectors = np.linalg.eigh(covariance[np.ix_(index, index)] / np.outer(scale, scale))
    weakest = dict(zip(("B", "C", "east", "north"), (float(x) for x in vectors[:, -1]), strict=True))
    return {
        "set_deg": set_deg,
        "drift_kn": drift if swing.has_speed else None,
        "drift_ratio": drift / float(np.median(swing.speed_kn)),
        "sigma_drift_kn": ahead if swing.has_speed else None,
        "sigma_set_deg": sigma_set,
        "east": float(series.parameters[EAST]),
        "north": float(series.parameters[NORTH]),
        "covariance": water.tolist(),
        "correlation": {
            f"{name}_{towards}": float(covariance[k, j] / (sigma[k] * sigma[j]))
            for name, k in (("B", 1), ("C", 2))
            for towards, j in (("east", EAST), ("north", NORTH))
        },
        "left_of_belief": left,
        "largest_alike": {"share": float(size[-1] / size.sum()), "direction": weakest},
        "log_scale": float(series.parameters[LOG]) if np.isfinite(prior[LOG]) and prior[LOG] > 1e-6 else None,
        "separable": left < MAX_PRIOR_SHARE,
        "described": described,
        "text": _describe_drift(swing, left, sigma, described),
    }


def _describe_drift(swing: Swing, left: float, sigma: Floats, water: str) -> str:
    speed = swing.observed.speed_kn
    ratio = f"speeds from {speed.min():.1f} to {speed.max():.1f} kn" if swing.has_speed else "no speeds"
    if left < MAX_PRIOR_SHARE:
        return (
            f"With {ratio} the current is separated from the compass: {water} (95 %). A steady leeway by wind has the "
            "same signature."
        )
    return (
        f"With {ratio} set and drift cannot be separated from B and C: to first order they are the same function of "
        f"the heading. B and C have ± {sigma[1]:.1f}° and ± {sigma[2]:.1f}°; A, D and E are not affected. A visual "
        "mark, the sun, a log of the speed through the water, or each heading at two speeds would separate them."
    )
