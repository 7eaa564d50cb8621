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
from compasslib.deviation import von_appen
from compasslib.statistics import swing_noise
from compasslib.statistics.arma import orthonormal
from compasslib.statistics.blocks import student
from compasslib.statistics.swing_noise import SwingNoise, spread
from compasslib.types import Floats

ROUNDS, STEPS = 4, 3
KNOWN = 2.0  # the data know a parameter that they tell twice as well as the prior


@dataclass(frozen=True)
class Block:
    """Observations of one kind."""

    name: str
    observe: Callable[[Floats], tuple[Floats, Floats]]  # parameters -> residuals (n,), their derivatives (n, k)
    speed_kn: Floats | None = None  # where slow ones scatter more
    blocks: NDArray[np.int_] | None = None  # (n,) number of the block in time; None: their order says nothing
    sigma: float | None = None  # scatter, where it is known
    groups: NDArray[np.int_] | None = None  # (n,) which were taken on one heading


@dataclass(frozen=True)
class SwingFit:
    """Parameters with covariance, and what the covariance is made of."""

    parameters: Floats  # (k,)
    covariance: Floats  # (k, k)
    parts: Mapping[str, Floats]  # name of a block, or number of a parameter with a prior -> (k, k); they add up
    residuals: Mapping[str, Floats]
    noises: Mapping[str, SwingNoise]


def solve(blocks: Sequence[Block], mean: Floats, sigma: Floats, start: Floats) -> SwingFit:
    """Return the parameters that explain all blocks.

    Args:
        blocks: observations; the first sets the least scatter of those with a known one.
        mean: (k,) of the priors.
        sigma: (k,) their width, infinite for a parameter without.
        start: (k,) parameters to begin from.
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
        size = before[block.name].sigma if before else np.full(residual.shape, np.std(residual) + swing_noise.TINY)
        basis = _taken_up(columns / size[:, None], sigma) * size[:, None]
        basis = orthonormal(basis)
        noise = swing_noise.estimate(residual, basis, speed_kn=block.speed_kn, blocks=block.blocks)
        noise = noise if block.groups is None else _grouped(noise, residual, block.groups, basis.shape[1])
        # So few residuals that their scatter may be small by chance must not overrule the priors.
        noises[block.name] = replace(noise, weight=noise.weight / student(noise.dof) ** 2)
    return noises


def _taken_up(columns: Floats, sigma: Floats) -> Floats:
    """Return a basis of what the fit takes up: free parameters, and those that the data know better than the prior."""
    free = orthonormal(columns[:, np.isinf(sigma)])
    by_priors = columns[:, np.isfinite(sigma)] * sigma[np.isfinite(sigma)]
    beyond = by_priors - free @ (free.T @ by_priors)
    return np.column_stack([free, orthonormal(beyond, least=KNOWN)])


def _grouped(noise: SwingNoise, residual: Floats, groups: NDArray[np.int_], rank: int) -> SwingNoise:
    """Return the scatter for headings that were taken repeatedly: what is common to one heading is not averaged out."""
    count = np.bincount(groups)
    total = np.bincount(groups, residual)
    occupied = count > 0
    dof = int(occupied.sum()) - rank
    if dof >= noise.dof or dof < 1:
        return noise
    between = np.sqrt(np.sum(total[occupied] ** 2 / count[occupied]) / dof)
    return SwingNoise(np.maximum(noise.sigma, between), n_effective=float(occupied.sum()), dof=float(dof))


def _rows(blocks: Sequence[Block], parameters: Floats, noises: Mapping[str, SwingNoise]) -> dict[str, Floats]:
    rows = {}
    for block in blocks:
        residual, columns = block.observe(parameters)
        noise = noises[block.name]
        clipped = swing_noise.clip(residual, noise)
        scaled = np.column_stack([columns, clipped]) / noise.sigma[:, None]
        rows[block.name] = scaled * np.sqrt(noise.weight)
    return rows


def _solution(blocks: Sequence[Block], parameters: Floats, sigma: Floats, noises: Mapping[str, SwingNoise]) -> SwingFit:
    rows = {name: each[:, :-1] for name, each in _rows(blocks, parameters, noises).items()}
    in_time = {block.name: block.blocks for block in blocks}
    priors = {str(k): np.diag((np.arange(len(sigma)) == k) * sigma**-2.0) for k in np.flatnonzero(np.isfinite(sigma))}
    information = np.sum([*(each.T @ each for each in rows.values()), *priors.values()], axis=0)
    inverse = np.linalg.inv(information)
    spreads = {
        name: noises[name].weight * student(noises[name].dof) ** 2 * spread(each, noises[name], in_time[name])
        for name, each in rows.items()
    }
    parts = {name: inverse @ middle @ inverse for name, middle in (spreads | priors).items()}
    residuals = {block.name: block.observe(parameters)[0] for block in blocks}
    return SwingFit(parameters, np.sum(list(parts.values()), axis=0), parts, residuals, noises)


SERIES = slice(0, 5)
DECLINATION, EAST, NORTH, EAST_CHANGE, NORTH_CHANGE, LAG, LOG = range(5, 12)
SIZE = 12
DRIFT, CHANGES = [EAST, NORTH], [EAST_CHANGE, NORTH_CHANGE]
NEVER = 1e-9  # prior width of a parameter that cannot be determined
SEPARATED = 0.5  # drift is told from B and C where the swing halves its prior
KNOT = "kn"
LOG_SIGMA = 0.1  # of a ship's log's scale
SPRING_S = 3 * 3600.0  # a tide goes from slack to full in three hours
LEAST_WATER_KN = 0.5
SMOOTHED_S = 60.0  # over which speeds are averaged
HIGHER = (3, 4)  # harmonics
LEAST_SHARE = 0.3  # of a speed, where the drift is faster than the ship
COURSE, VISUAL, WATER, SECOND = "course", "visual", "log", "second"


@dataclass(frozen=True)
class Shown:
    """What a compass shows on headings."""

    residual_deg: Floats  # (n,)
    by_compass: Floats  # (n, 5) its derivatives by the coefficients
    by_heading: Floats  # (n,) and by the heading
    facing_deg: Floats  # (n,) magnetic heading by the reading


Curve = Callable[[Floats, Floats, Floats], Shown]  # coefficients, headings, readings, degrees


@dataclass(frozen=True)
class Swing:
    """Observations with what is needed to explain them."""

    seen: Observations
    options: SwingOptions
    declination_deg: float
    declination_sigma_deg: float
    marks: tuple[tuple[float, float], ...] = ()  # (recorded, true) headings by a visual mark or the sun

    @property
    def has_speed(self) -> bool:
        """Tell whether speeds were logged; else the ship's speed is the unit and the drift a share of it."""
        return bool(np.isfinite(self.seen.speed_kn).all())

    @property
    def widest_drift(self) -> float:
        """Return the largest drift that the prior allows, knots, or over the ship's speed where that is not known."""
        return self.options.max_drift_kn if self.has_speed else self.options.drift_ratio

    @property
    def speed_kn(self) -> Floats:
        """Return the speed over ground, 1 where it is not known, (n,)."""
        return self.seen.speed_kn if self.has_speed else np.ones(len(self.seen))


def fit_swing(swing: Swing, *, exact: bool = False, start: Floats | None = None) -> SwingFit:
    """Return the compass that explains a swing, with the water's drift and the course's delay.

    Args:
        exact: the exact compass (coefficients dimensionless) instead of the series in the recorded heading (degrees).
    """
    mean = np.zeros(SIZE)
    mean[LOG] = 1.0
    begin = mean.copy() if start is None else start.copy()
    if start is None:  # a compass mounted askew is no outlier
        begin[0] = angles.wrap180(angles.mean(swing.seen.course_deg - swing.seen.recorded_deg) - swing.declination_deg)
    if exact:
        begin[SERIES] = exact_start(swing.seen.recorded_deg, corrected_course(begin, swing))
    found = solve(_blocks(swing, _exact if exact else _series), mean, prior_widths(swing), begin)
    return _with_second_order(found, swing, unit=angles.DEGREE if exact else 1.0)


def _with_second_order(found: SwingFit, swing: Swing, unit: float) -> SwingFit:
    """Add what an unknown drift does to A, D and E in second order: 57.3 (d/S)^2 in D and E, MM (37) and (43).

    The drift acts by the heading, the series by the recorded one; their difference adds d/S times half of B and C.

    Args:
        unit: of the coefficients, in degrees: 1, or that of the exact ones.
    """
    if not swing.seen.over_ground:
        return found
    slowness = 1.0 / float(np.median(swing.speed_kn))
    variance = float(np.mean(np.diag(found.covariance)[DRIFT])) * slowness**2
    square = float(np.sum(found.parameters[DRIFT] ** 2)) * slowness**2 + variance
    iron = float(np.sum((found.parameters[1:3] * angles.DEGREE / unit) ** 2))
    part = np.zeros((SIZE, SIZE))
    part[[0, 3, 4], [0, 3, 4]] = variance * (np.array([0.0, square, square]) + iron / 4.0) * (unit / angles.DEGREE) ** 2
    return replace(found, covariance=found.covariance + part, parts={**found.parts, SECOND: part})


def prior_widths(swing: Swing) -> Floats:
    """Return the prior width of each parameter, infinite for the compass.

    A drift that may be anything up to a largest one, in any direction, has half of that as its standard deviation
    along either axis.
    """
    seen, sigma = swing.seen, np.full(SIZE, NEVER)
    sigma[SERIES] = np.inf
    sigma[DECLINATION] = max(swing.declination_sigma_deg, NEVER)
    if seen.over_ground:
        sigma[DRIFT] = max(swing.widest_drift / 2.0, NEVER)
    if seen.timed:
        lasted = float(np.ptp(seen.time_s))
        sigma[CHANGES] = np.maximum(sigma[DRIFT] * min(1.0, lasted / SPRING_S), NEVER)
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
    """Return the magnetic headings that the courses stand for, water and delay taken off, (n,) degrees."""
    through = angles.direction(*_through_water(parameters, swing)) if swing.seen.over_ground else swing.seen.course_deg
    return angles.wrap360(through - _offset(parameters, swing))


def _drift(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return the water's velocity at each observation, true east and north, knots."""
    since = observations.since_middle(swing.seen.time_s)
    return (
        parameters[EAST] + parameters[EAST_CHANGE] * since,
        parameters[NORTH] + parameters[NORTH_CHANGE] * since,
    )


def _through_water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return the ship's velocity through the water, true east and north, knots."""
    (east, north), drift = angles.components(swing.speed_kn, swing.seen.course_deg), _drift(parameters, swing)
    return east - drift[0], north - drift[1]


def _offset(parameters: Floats, swing: Swing) -> Floats:
    return swing.declination_deg + parameters[DECLINATION] - parameters[LAG] * swing.seen.steady_turn_deg_s


def _set_aside(parameters: Floats, swing: Swing, facing_deg: Floats, by_compass: Floats) -> tuple[Floats, Floats]:
    """Return by how much the water sets the courses aside, (n,) degrees, and the derivatives by the parameters, (n, k).

    Only speeds that vary may tell the drift from B and C. At one speed it differs from what a compass can be in higher
    harmonics of the heading alone, which compasses have too: what is like these is taken out of its derivatives.
    """
    speed = _through_speed(parameters, swing, facing_deg)
    aside, across = _triangle(facing_deg, speed, _drift(parameters, swing))
    higher = np.column_stack([np.stack(angles.sin_cos(order * facing_deg), axis=-1) for order in HIGHER])
    higher = higher - by_compass @ np.linalg.lstsq(by_compass, higher, rcond=1e-9)[0]
    basis, slopes = orthonormal(higher), np.zeros((len(speed), SIZE))
    slopes[:, DRIFT] = across - basis @ (basis.T @ across)
    slopes[:, CHANGES] = across * observations.since_middle(swing.seen.time_s)[:, None]
    return aside, slopes


def _triangle(facing_deg: Floats, speed: Floats, drift: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Return course minus heading, (n,) degrees, and its derivatives by the drift towards east and north, (n, 2)."""
    sine, cosine = angles.sin_cos(facing_deg)
    east, north = speed * sine + drift[0], speed * cosine + drift[1]
    square = np.maximum(east**2 + north**2, (LEAST_SHARE * speed) ** 2)
    slopes = np.stack([north, -east], axis=-1) / square[:, None] / angles.DEGREE
    return angles.difference(angles.direction(east, north), facing_deg), slopes


def _through_speed(parameters: Floats, swing: Swing, facing_deg: Floats) -> Floats:
    """Return the speed through the water, (n,): it follows from that over ground, the drift and where the ship faces.

    Noise in the speeds would look like speeds that vary, and noise of the compass too, by where the ship faces: both
    are smoothed.
    """
    (sine, cosine), (east, north) = angles.sin_cos(facing_deg), _drift(parameters, swing)
    along, across, over_ground = (
        observations.smoothed(x, swing.seen.time_s, SMOOTHED_S)
        for x in (east * sine + north * cosine, east * cosine - north * sine, swing.speed_kn)
    )
    through = np.sqrt(np.maximum(over_ground**2 - across**2, 0.0)) - along
    return np.maximum(through, np.maximum(LEAST_SHARE * over_ground, 1e-3))  # where the drift is faster than the ship


def _blocks(swing: Swing, curve: Curve) -> list[Block]:
    seen = swing.seen
    in_time = observations.blocks_of(seen.time_s) if seen.timed else None
    slow = seen.speed_kn if swing.has_speed and seen.over_ground else None
    groups = None if seen.timed else observations.headings_of(seen.recorded_deg)
    blocks = [Block(COURSE, partial(_course, swing=swing, curve=curve), slow, in_time, groups=groups)]
    if swing.marks:
        observe = partial(_mark, swing=swing, curve=curve)
        blocks.append(Block(VISUAL, observe, sigma=swing.options.visual_sigma_deg))
    if _by_log(swing).any():
        blocks.append(Block(WATER, partial(_water, swing=swing), blocks=in_time))
    return blocks


def _course(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    seen, offset = swing.seen, _offset(parameters, swing)
    heading: Floats = seen.course_deg - offset
    slopes: Floats = np.zeros((len(seen), SIZE))
    shown = curve(parameters[SERIES], heading, seen.settled_deg)
    if seen.over_ground:
        alike = shown.by_compass / shown.by_heading[:, None]
        aside, slopes = _set_aside(parameters, swing, shown.facing_deg + offset, alike)
        heading, slopes = heading - aside, -slopes
    slopes[:, DECLINATION], slopes[:, LAG] = -1.0, seen.steady_turn_deg_s
    slopes *= shown.by_heading[:, None]
    slopes[:, SERIES] = shown.by_compass
    unsettled = angles.difference(seen.recorded_deg, seen.settled_deg)
    return angles.difference(curve(parameters[SERIES], heading, seen.settled_deg).residual_deg, unsettled), slopes


def _mark(parameters: Floats, swing: Swing, curve: Curve) -> tuple[Floats, Floats]:
    recorded, true = np.transpose(swing.marks)
    shown = curve(parameters[SERIES], true - swing.declination_deg - parameters[DECLINATION], recorded)
    slopes = np.zeros((len(recorded), SIZE))
    slopes[:, SERIES], slopes[:, DECLINATION] = shown.by_compass, -shown.by_heading
    return shown.residual_deg, slopes


def _water(parameters: Floats, swing: Swing) -> tuple[Floats, Floats]:
    """Return speed through the water from the triangle minus that of the ship's log times its scale, knots."""
    since, used = observations.since_middle(swing.seen.time_s), _by_log(swing)
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


def _series(coefficients: Floats, heading: Floats, recorded: Floats) -> Shown:
    columns = von_appen.design(recorded)
    fitted = recorded + columns @ coefficients
    return Shown(angles.difference(heading, fitted), -columns, np.ones(len(recorded)), fitted)


def _exact(coefficients: Floats, heading: Floats, recorded: Floats) -> Shown:
    residual = angles.difference(compass.recorded_heading(coefficients, angles.wrap360(heading)), recorded)
    root = compass.inverse(coefficients, recorded)[:, 0]
    fitted = np.where(np.isfinite(root), root, heading)  # a reading that the compass cannot show has no root
    return Shown(residual, compass.gradient(coefficients, fitted).T, compass.slope(coefficients, fitted), fitted)


def drift_of(parameters: Floats) -> tuple[float, float]:
    """Return set (degrees, true) and drift of the water."""
    return float(angles.direction(*parameters[DRIFT])), float(np.hypot(*parameters[DRIFT]))


def separate_drift(swing: Swing, series: SwingFit) -> dict[str, object]:
    """Return set and drift of the water, how well they are told from B and C, and what stays confounded."""
    set_deg, drift = drift_of(series.parameters)
    covariance, prior = series.covariance, prior_widths(swing)
    sigma = np.sqrt(np.diag(covariance))
    along = np.array(angles.components(1.0, set_deg))
    across = np.array(angles.components(1.0, set_deg + 90.0))
    water = covariance[np.ix_(DRIFT, DRIFT)]
    left = float(np.max(sigma[DRIFT] / prior[DRIFT]))
    unit = KNOT if swing.has_speed else "of the ship's speed"
    side = float(np.sqrt(max(float(across @ water @ across), 0.0)))
    return {
        "set_deg": set_deg,
        "drift_kn": drift if swing.has_speed else None,
        "drift_ratio": drift / float(np.median(swing.speed_kn)),
        "sigma_drift_kn": float(np.sqrt(max(float(along @ water @ along), 0.0))) if swing.has_speed else None,
        "sigma_set_deg": float(angles.direction(side, drift)) if drift else 90.0,
        "east": float(series.parameters[EAST]),
        "north": float(series.parameters[NORTH]),
        "covariance": water.tolist(),
        "correlation": _with_b_and_c(covariance),
        "left_of_belief": left,
        "largest_alike": _alike(series),
        "log_scale": float(series.parameters[LOG]) if np.isfinite(prior[LOG]) and prior[LOG] > 1e-6 else None,
        "separable": left < SEPARATED,
        "text": _sentence(swing, (set_deg, drift, unit), left, sigma),
    }


def _sentence(swing: Swing, water: tuple[float, float, str], left: float, sigma: Floats) -> str:
    set_deg, drift, unit = water
    speed = swing.seen.speed_kn
    ratio = f"speeds from {speed.min():.1f} to {speed.max():.1f} kn" if swing.has_speed else "no speeds"
    if left < SEPARATED:
        return (
            f"With {ratio} the water is told from the compass: set {set_deg:.0f}°, drift {drift:.2f} {unit} "
            f"(± {np.max(sigma[DRIFT]):.2f}). A steady leeway by wind would look the same."
        )
    return (
        f"With {ratio} set and drift cannot be separated from B and C: to first order they are one function of the "
        f"heading. B and C carry ± {sigma[1]:.1f}° and ± {sigma[2]:.1f}°; A, D and E do not suffer. A visual mark, the "
        "sun, a log of the speed through the water, or each heading at two speeds would separate them."
    )


def _with_b_and_c(covariance: Floats) -> dict[str, float]:
    sigma = np.sqrt(np.diag(covariance))
    pairs = [(k, j) for k in (1, 2) for j in DRIFT]
    names = {1: "B", 2: "C", EAST: "east", NORTH: "north"}
    return {f"{names[k]}_{names[j]}": float(covariance[k, j] / (sigma[k] * sigma[j])) for k, j in pairs}


def _alike(series: SwingFit) -> dict[str, object]:
    """Return what the swing knows least: the combination of B, C and drift with the widest covariance."""
    index = [1, 2, *DRIFT]
    sigma = np.sqrt(np.diag(series.covariance))[index]
    size, vectors = np.linalg.eigh(series.covariance[np.ix_(index, index)] / np.outer(sigma, sigma))
    weakest = dict(zip(("B", "C", "east", "north"), (float(x) for x in vectors[:, -1]), strict=True))
    return {"share": float(size[-1] / size.sum()), "direction": weakest}
