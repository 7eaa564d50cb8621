"""The exact compass fitted to overlapping instruments by the latent-heading likelihood.

The same five coefficients describe iron weaker and stronger than the earth's horizontal field, without a change of
method at the fold. Starting values cover directions and strengths of the iron on both sides of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.deviation import likelihood, model
from compasslib.deviation.likelihood import CELL_DEG, CELLS, EXACT, FINE, STUDENT_DOF, CurveForm
from compasslib.deviation.model import DeviationFit, ScatterNoise
from compasslib.deviation.series import invert_series, series_design, series_slope
from compasslib.records import Pairs
from compasslib.statistics.least_squares import minimize_bfgs
from compasslib.statistics.noise import effective_sample_size
from compasslib.statistics.resampling import block_jackknife, block_sums, blocks_by_span
from compasslib.types import DAY_S, Floats

Priors = tuple[model.CoefficientPrior, ...]  # of A..E and log(compass noise / degree)

STRENGTHS = (0.3, 0.6, 0.85, 1.1, 1.35, 1.7, 2.2, 3.3)  # hard iron over the earth's horizontal field, as of EG4
# Directions of the iron, from the mean reading: near strong iron a compass reads within some 20 degrees of it. From
# starts at fixed directions, 4 of 8 windows of EG4's year ended at a wrong compass.
DIRECTIONS_DEG = np.append(np.arange(0.0, 360.0, 22.5), (-10.0, 10.0))
START_NOISE = ScatterNoise(floor_deg=10.0, slow_deg_m_s=2.0, outliers=0.02)
LARGE_SOFT_IRON = 0.15  # magnitude of (D, E) from which other starts are tried; the demonstration has up to 0.10
TURNS_DEG = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)  # constant rotations of all readings, as starting values
FAR_BETTER = 100.0  # gain in log likelihood of 900 pairs: over 200 with exchanged components, none in sound moorings
MIRRORED = (
    "the directions of the two instruments agree where those of one are mirrored: east and north are exchanged, one of "
    "them has the other sign, or the orientation (up, down) is wrong"
)
FRAMES = {  # signs of the reference's east and north, and the mistake that they undo
    (-1.0, -1.0): "the directions of the two instruments agree where those of one are turned by 180°: they are those "
    "that its current comes from, both components have the other sign, or it is mounted backwards",
    (-1.0, 1.0): MIRRORED,
    (1.0, -1.0): MIRRORED,
}
ROUNDS = 2  # repetitions of a fit with its updated noise or prior


def _about_zero(*sigma: float) -> tuple[model.CoefficientPrior, ...]:
    return (model.CoefficientPrior(np.zeros(6), np.diag(np.array(sigma) ** -2.0)),)


# Weak priors that only matter without data, of A..E and log(compass noise / degree).
WEAK = _about_zero(0.5, 1.5, 1.5, 0.3, 0.3, 0.15)
HARD_IRON_FIRST = _about_zero(0.02, 1.5, 1.5, 0.02, 0.02, 0.3)  # while a start locates its fold
WITHOUT_CONSTANT = _about_zero(0.001, 1.5, 1.5, 0.3, 0.3, 0.15)
# Bounding |D|, |E| below |u| prevents the induced part from reversing the field, which no iron near an instrument does.
# The last lower bound is the smallest compass noise that the grids resolve.
PARAMETER_BOUNDS = np.array([(-np.inf, np.inf)] * 3 + [(-0.6, 0.6)] * 2 + [(np.log(0.8), np.log(8.0))])
# Bounds of log(floor), log(slow part), logit(outliers); the cells do not resolve a smaller floor.
NOISE_BOUNDS = np.array([(np.log(CELL_DEG), np.log(90.0)), (np.log(0.05), np.log(50.0)), (-9.0, 2.0)])
NOISE_PRIOR = np.array([np.log(8.0), np.log(2.5), -4.0])  # means of weak priors with standard deviation 1


def fit_exact(pairs: Pairs, near: DeviationFit | None = None) -> DeviationFit:
    """Fit the exact compass to the pairs by penalized maximum likelihood, from ``near`` if its fold is known."""
    if len(pairs) < model.MIN_PAIRS:
        return model.unfitted("exact", len(pairs))
    overlap, prior = _overlap(pairs), None if near is None else near.prior
    state = _optimum(overlap) if near is None else _refined(_at(near), overlap)
    if prior is None or near is None:
        return _described(state, pairs, overlap)
    counted = pairs_per_independent(pairs, _described(state, pairs, overlap).n_effective)
    others = model.CoefficientPrior(np.append(prior.mean, 0.0), counted * np.pad(prior.precision, (0, 1)))
    priors = (*WEAK, others)
    return replace(_described(_refined(state, overlap, priors=priors), pairs, overlap, priors), prior=prior)


def recognize_frame(pairs: Pairs, fit: DeviationFit) -> str:
    """Name the mistake in the directions of an instrument without which the exact compass fits far better, or none.

    Tried where the soft iron is implausible, or a quarter of the headings impossible: both are usual with a mistake.
    """
    if fit.method != "exact" or not fit.fitted:
        return ""
    possible = float(np.isfinite(model.heading_residual(fit, pairs)).mean())
    if float(np.hypot(*fit.coefficients[3:5])) < model.MAX_SOFT_IRON and possible > 0.75:
        return ""
    losses = {"": _start(_overlap(pairs), EXACT).loss - FAR_BETTER}
    for (east, north), mistake in FRAMES.items():
        reframed = replace(pairs, lower_east=east * pairs.lower_east, lower_north=north * pairs.lower_north)
        losses[mistake] = min(_start(_overlap(reframed), EXACT).loss, losses.get(mistake, np.inf))
    return min(losses, key=losses.__getitem__)


def constant_sigmas(pairs: Pairs, fit: DeviationFit) -> float:
    """Compute by how many standard errors pairs prefer the constant of a fit to any iron without a constant.

    Where few headings occur, A is nearly collinear with B and C: the covariance about one solution lacks the others.
    """
    overlap = _overlap(pairs)
    without = _refined(_start(overlap, EXACT, WITHOUT_CONSTANT), overlap, priors=WITHOUT_CONSTANT)
    own, other = (
        likelihood.log_likelihood(state.parameters, overlap.sample(state.noise, FINE, EXACT), state.prior, FINE)
        for state in (_at(fit), without)
    )
    return float(np.sqrt(max(2.0 * (own - other) / pairs_per_independent(pairs, fit.n_effective), 0.0)))


def start_from_prior(prior: model.CoefficientPrior, pairs: Pairs) -> DeviationFit:
    """Make a starting fit from a prior by other records; if A is unconstrained, add the pairs' mean residual."""
    unscored = DeviationFit("exact", len(pairs), prior.mean, heading_density=np.full(CELLS, 1.0 / CELLS))
    off = model.heading_residual(unscored, pairs)
    turned = np.where(np.isfinite(off), angles.phasor(off), 0.0).sum()
    mean = prior.mean.copy()
    mean[0] += 0.0 if prior.precision[0, 0] else np.clip(np.angle(turned), -0.5, 0.5)
    return replace(unscored, coefficients=mean, prior=prior)


def held_out_scores(
    form: CurveForm, pairs: Pairs, fold: NDArray[np.signedinteger], near: DeviationFit | None = None
) -> Floats:
    """Compute the log-likelihood of each pair under a form fitted to the other folds, (n,)."""
    overlap, scores = _overlap(pairs), np.empty(len(pairs))
    whole = _start(overlap, form) if near is None else _at(near)
    for k in np.unique(fold):
        left_out, training = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        state = _refined(whole, overlap.take(training), form)
        data = overlap.take(left_out).sample(state.noise, FINE, form)
        scores[left_out] = likelihood.pair_log_likelihoods(state.parameters, data, state.prior, FINE)
    return scores


def _optimum(overlap: Overlap) -> OptimizerState:
    """Find the likeliest compass, from starts without a constant and, where the soft iron is large, with one."""
    state = _refined(_start(overlap, EXACT), overlap)
    if float(np.hypot(*state.parameters[3:5])) < LARGE_SOFT_IRON:
        return state
    # Large soft iron may substitute for another cause: for a two-valued compass, a constant rotation of all readings.
    turned = [_refined(_start_turned(overlap, angle), overlap) for angle in TURNS_DEG]
    return min([state, *turned], key=lambda each: each.loss)


def _refined(state: OptimizerState, overlap: Overlap, form: CurveForm = EXACT, priors: Priors = WEAK) -> OptimizerState:
    for _ in range(ROUNDS):
        state = _improve(state, overlap, FINE, form, priors)
    return state


def _start_turned(overlap: Overlap, angle_deg: float) -> OptimizerState:
    """Find a start for readings rotated by an angle: q e^{i angle} is q with other coefficients, up to a factor."""
    start = _start(replace(overlap, recorded_deg=angles.wrap360(overlap.recorded_deg - angle_deg)), EXACT)
    turn = angles.phasor(angle_deg) / float(angles.sin_cos(angle_deg)[1])
    a, b, c, d, e = start.parameters[:5]
    u, p, v = (1.0 - 1j * a) * turn, (b - 1j * c) * turn, (d - 1j * e) * turn
    scaled = np.array([-u.imag, p.real, -p.imag, v.real, -v.imag]) / u.real
    return replace(start, parameters=np.append(scaled, start.parameters[5]))


def _overlap(pairs: Pairs) -> Overlap:
    observed = model.observed_heading(pairs)
    return Overlap(pairs.heading_deg, observed, likelihood.squared_chords(observed), *model.pair_speeds(pairs))


@dataclass(frozen=True)
class Overlap:
    """Columns of the pairs that the fit uses, (n,) each."""

    recorded_deg: Floats
    observed_deg: Floats
    squared_chord: Floats  # (n, CELLS)
    upper_speed: Floats
    lower_speed: Floats

    def width_deg(self, noise: ScatterNoise) -> Floats:
        return likelihood.scatter_widths(noise, self.upper_speed, self.lower_speed)

    def take(self, index: NDArray[np.signedinteger]) -> Overlap:
        return Overlap(*(column[index] for column in vars(self).values()))

    def sample(self, noise: ScatterNoise, grid: likelihood.HeadingGrid, form: CurveForm) -> likelihood.BinnedSample:
        density = likelihood.scatter_density(self.squared_chord, self.width_deg(noise), noise.outliers)
        return likelihood.bin_sample(self.recorded_deg, density, grid, form)


@dataclass(frozen=True)
class OptimizerState:
    """Current state of the optimization."""

    parameters: Floats  # A..E and log(compass noise / degree)
    noise: ScatterNoise
    prior: Floats
    loss: float = float("inf")


def _start(overlap: Overlap, form: CurveForm, priors: Priors = WEAK) -> OptimizerState:
    """Optimize from the best of many strengths and directions of the iron, using 900 pairs with the least scatter."""
    width = overlap.width_deg(START_NOISE)
    clear = np.sort(np.argsort(width, kind="stable")[: max(len(width) // 2, 900)])
    few = overlap.take(clear[:: max(1, len(clear) // 900)])
    prior = smooth_density(np.histogram(few.observed_deg, bins=CELLS, range=(0.0, 360.0))[0].astype(float))
    data = few.sample(START_NOISE, likelihood.COARSE, form)
    centred = DIRECTIONS_DEG - angles.mean(few.recorded_deg)
    irons = [angles.components(strength, towards) for strength in STRENGTHS for towards in centred]
    irons.append(angles.components(0.0, 0.0))
    starts = [np.array([0.0, float(b), float(c), 0.0, 0.0, np.log(6.0)]) for c, b in irons]
    values = [-likelihood.log_likelihood(start, data, prior, likelihood.COARSE) for start in starts]
    states = [OptimizerState(starts[i], START_NOISE, prior) for i in np.argsort(values)[:3]]
    states = [_improve(state, few, likelihood.COARSE, form, HARD_IRON_FIRST) for state in states]
    states = sorted(states, key=lambda state: state.loss)[:2]
    for _ in range(ROUNDS):  # too wide a scatter blurs a fold, and a wrong compass fits as well: it is refitted first
        states = [_improve(state, few, likelihood.COARSE, form, priors) for state in states]
    return min(states, key=lambda state: state.loss)


def _at(fit: DeviationFit) -> OptimizerState:
    return OptimizerState(np.append(fit.coefficients, np.log(fit.noise.compass_deg)), fit.noise, fit.heading_density)


def _improve(
    state: OptimizerState, overlap: Overlap, grid: likelihood.HeadingGrid, form: CurveForm, priors: Priors
) -> OptimizerState:
    """Optimize the compass at fixed scatter, then the scatter and the distribution of headings at fixed compass."""
    data = overlap.sample(state.noise, grid, form)
    parameters, loss = _maximise(state, data, grid, priors)
    prior = smooth_density(likelihood.heading_occupancy(parameters, data, state.prior, grid))
    few = overlap.take(np.arange(0, len(overlap.observed_deg), max(1, len(overlap.observed_deg) // 1000)))
    given = likelihood.heading_given_reading(parameters, few.recorded_deg, prior, FINE, form)
    return OptimizerState(parameters, fit_scatter(few, given, state.noise), prior, loss)


def _described(state: OptimizerState, pairs: Pairs, overlap: Overlap, priors: Priors = WEAK) -> DeviationFit:
    data = overlap.sample(state.noise, FINE, EXACT)
    parameters, _ = _maximise(state, data, FINE, priors)
    noise = replace(state.noise, compass_deg=float(np.exp(parameters[5])))
    scores = likelihood.pair_scores(parameters, data, state.prior, FINE)[:, :5]
    unscored = DeviationFit("exact", len(pairs), parameters[:5], noise=noise)
    left = model.heading_residual(unscored, pairs)
    standard = np.clip(left / overlap.width_deg(noise), -3.0, 3.0)
    known = np.isfinite(standard)
    effective = effective_sample_size(standard[known], pairs.time_s[known])
    return replace(
        unscored,
        covariance=robust_covariance(scores, unscored, pairs, effective, priors),
        reference=model.reference_errors(pairs, reference_response(unscored, pairs, priors), veer_included=True),
        n_effective=effective,
        residual_rms_deg=angles.rms(left),
        recorded_range_deg=compass.recorded_range(parameters[:5]),
        folded=not compass.turns_full_circle(parameters[:5]),
        noise=noise,
        heading_density=state.prior,
    )


def _maximise(
    state: OptimizerState, data: likelihood.BinnedSample, grid: likelihood.HeadingGrid, priors: Priors
) -> tuple[Floats, float]:
    def loss(at: Floats) -> tuple[float, Floats]:
        value, slopes = likelihood.log_likelihood_and_gradient(at, data, state.prior, grid)
        minus, slopes = -value, -slopes
        for prior in priors:
            pull = prior.precision @ (at - prior.mean)
            minus, slopes = minus + 0.5 * float((at - prior.mean) @ pull), slopes + pull
        return minus, slopes

    scores = likelihood.pair_scores(state.parameters, data, state.prior, grid)
    curvature = scores.T @ scores + sum(prior.precision for prior in priors)
    return minimize_bfgs(loss, state.parameters, PARAMETER_BOUNDS, 40, curvature)


def smooth_density(mass: Floats) -> Floats:
    """Smooth a distribution of headings over 12 degrees and add a uniform tenth; the result sums to 1."""
    kernel = np.exp(-0.5 * (angles.wrap180(likelihood.CELL_CENTRES) / 12.0) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(mass) * np.fft.rfft(kernel / kernel.sum()), len(mass))
    smooth = np.maximum(smooth, 0.0) / smooth.sum()
    return 0.9 * smooth + 0.1 / len(mass)


def fit_scatter(overlap: Overlap, given: Floats, near: ScatterNoise) -> ScatterNoise:
    """Fit the scatter of the observed headings.

    Args:
        given: distribution of the correct heading given the recorded one only, (n, CELLS).
    """

    def loss(x: Floats) -> tuple[float, Floats]:
        value, slope = scatter_log_likelihood(x, overlap, given)
        off = x - NOISE_PRIOR
        return 0.5 * float(off @ off) - value, off - slope

    start = [np.log(near.floor_deg), np.log(near.slow_deg_m_s), np.log(near.outliers / (1.0 - near.outliers))]
    return _scatter_noise(minimize_bfgs(loss, np.array(start), NOISE_BOUNDS, 15)[0])


def scatter_log_likelihood(x: Floats, overlap: Overlap, given: Floats) -> tuple[float, Floats]:
    """Compute the log-likelihood of log floor, log slow part and logit of outliers, (3,), and its gradient.

    With r = 1 / (1 + chord^2 / (STUDENT_DOF width^2)) the density is r^power over its sum, and the derivative of
    log r^power with respect to log width is 2 power (1 - r), with a power of (STUDENT_DOF + 1) / 2.

    Args:
        x: logarithms of floor and slow part (degrees, degrees times m/s), logit of the share of outliers, (3,).
    """
    noise = _scatter_noise(x)
    width = overlap.width_deg(noise)
    ratio = overlap.squared_chord / (STUDENT_DOF * width[:, None] ** 2)
    ratio += 1.0
    np.reciprocal(ratio, out=ratio)
    density = ratio * ratio  # products, as a power is ten times slower
    density *= ratio
    whole, agreeing = density.sum(axis=1), np.einsum("nc,nc->n", given, density)
    density *= ratio
    by_width = (STUDENT_DOF + 1.0) * (agreeing * density.sum(axis=1) / whole - np.einsum("nc,nc->n", given, density))
    scale = (1.0 - noise.outliers) / (CELL_DEG * whole)
    joint = scale * agreeing + noise.outliers / 360.0
    by_width *= scale / joint * (width < 360.0) / width**2  # the width is capped at a full turn
    by_outliers = (noise.outliers / 360.0 - noise.outliers * agreeing / (CELL_DEG * whole)) * (1.0 - noise.outliers)
    floor = noise.floor_deg**2
    slope = [np.sum(by_width) * floor, np.sum(by_width * (width**2 - floor)), np.sum(by_outliers / joint)]
    return float(np.sum(np.log(joint))), np.array(slope)


def _scatter_noise(x: Floats) -> ScatterNoise:
    return ScatterNoise(float(np.exp(x[0])), float(np.exp(x[1])), float(1.0 / (1.0 + np.exp(-x[2]))))


BLOCK_S = 5 * DAY_S  # longer than the decorrelation time of the currents' veer
MIN_SLOPE = 0.3  # lower bound of a slope in a denominator; at a fold the spread over both branches dominates


def robust_covariance(scores: Floats, fit: DeviationFit, pairs: Pairs, effective: float, priors: Priors) -> Floats:
    """Estimate the covariance, allowing for autocorrelated pairs and for veer that depends on flow direction.

    In time it is the jackknife over blocks of days. The veer differs between flow directions for months, which these do
    not show: the variance of the scores, (n, 5), between octants beyond it is added, then the mean veer by the profile.

    Args:
        scores: each pair's gradient of the log-likelihood by A..E, (n, 5).
        priors: the weak prior, then that from other records, its precision multiplied by ``pairs_per_independent``.
    """
    # Where the iron cancels the earth's field the gradient is unbounded, and one pair would determine all coefficients;
    # it is 60 for a direction known to a degree.
    scores = np.clip(scores, -1e3, 1e3)
    information = scores.T @ scores + sum(prior.precision[:5, :5] for prior in priors)
    # The outer product of scores stays positive where the record hardly constrains a coefficient, unlike the Hessian.
    inverse = np.linalg.inv(information)
    block = blocks_by_span(pairs.time_s, BLOCK_S)
    few = len(np.unique(block)) < 12
    if few:
        along_time = inverse * pairs_per_independent(pairs, effective)
    else:
        along_time = block_jackknife(scores, scores, block, information)
    residual = model.heading_residual(fit, pairs)
    turn = np.nan_to_num(model.observed_deviation(pairs) - residual)
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, turn)
    towards = angles.direction(east + pairs.lower_east, north + pairs.lower_north)
    octant = np.floor(np.nan_to_num(towards) / 45.0).astype(np.intp) % 8
    sums = block_sums(scores, octant)
    across = inverse @ (sums.T @ sums) @ inverse * 8 / 7
    left = np.nan_to_num(residual)
    width = fit.noise.width_deg(*(np.maximum(speed, 1e-3) for speed in model.pair_speeds(pairs)))
    by_degree = (STUDENT_DOF + 1.0) * left / (STUDENT_DOF * width**2 + left**2)
    turned = inverse @ (scores.T @ by_degree) * pairs.veer_deg
    if not few:  # with few blocks, the inverse includes the prior
        for prior in priors[1:]:
            along_time += pairs_per_independent(pairs, effective) * inverse @ prior.precision[:5, :5] @ inverse
    shown = along_time + positive_part(across - along_time)
    return shown + positive_part(np.outer(turned, turned) - shown)


def reference_response(fit: DeviationFit, pairs: Pairs, priors: Priors) -> Floats:
    """Compute the change of A..E by one σ of the reference's B and of its C, (5, 2), by weighted least squares."""
    observed = model.observed_heading(pairs)
    root = model.nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    known = np.isfinite(root)
    root = np.where(known, root, observed)
    left = angles.difference(observed, root)
    slope = np.maximum(reading_slope(fit, root), MIN_SLOPE)
    width = fit.noise.width_deg(*(np.maximum(speed, 1e-3) for speed in model.pair_speeds(pairs)))
    square = STUDENT_DOF * (width**2 + (fit.noise.compass_deg / slope) ** 2)
    weight = known * (STUDENT_DOF + 1.0) * (square - left**2) / (square + left**2) ** 2
    columns = heading_sensitivity(fit, root)
    information = (columns.T * weight) @ columns + sum(prior.precision[:5, :5] for prior in priors)
    return np.linalg.solve(information, (columns.T * weight) @ model.iron_pattern(pairs))


def pairs_per_independent(pairs: Pairs, effective: float) -> float:
    """Estimate the number of pairs per independent pair, of which five determine the coefficients."""
    # At most four pairs a day, and one a layer of 20 m: in days the slow veer is absorbed in its mean.
    apart = 4.0 * float(np.ptp(pairs.time_s)) / DAY_S + float(np.ptp(pairs.upper_depth_m)) / 20.0
    return len(pairs) / max(min(effective, apart) - 5.0, 3.0)


def positive_part(matrix: Floats) -> Floats:
    """Project a symmetric matrix, (p, p), onto the positive semidefinite matrices."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2.0)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


# The curve of a fitted deviation, by its method.


def correct_roots(fit: DeviationFit, recorded_deg: Floats) -> Floats:
    """Compute the correct headings of recorded ones, (n, 2) degrees, NaN where there is none."""
    if fit.method != "von_appen":
        return compass.inverse(fit.coefficients, recorded_deg)
    beta = invert_series(fit.coefficients, recorded_deg)
    return np.stack([beta, np.full(beta.shape, np.nan)], axis=-1)


def reading_slope(fit: DeviationFit, heading_deg: Floats) -> Floats:
    """Compute |d recorded / d correct heading|, (n,)."""
    slope = series_slope if fit.method == "von_appen" else compass.slope
    return np.abs(slope(fit.coefficients, heading_deg))


def heading_sensitivity(fit: DeviationFit, heading_deg: Floats) -> Floats:
    """Compute the derivative of the correct heading of a reading by A..E, (n, 5) degrees per unit."""
    least = np.maximum(reading_slope(fit, heading_deg), MIN_SLOPE)
    if fit.method == "von_appen":
        return series_design(heading_deg) / least[:, None]
    slope = np.copysign(least, compass.slope(fit.coefficients, heading_deg))
    return (-compass.gradient(fit.coefficients, heading_deg) / slope).T
