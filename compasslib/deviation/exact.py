"""The exact compass fitted to overlapping instruments by the latent-heading likelihood.

Compasses with iron weaker and stronger than the earth's horizontal field are one family here: the same five numbers, no
change of method at the fold. Starts cover the direction and the strength of the iron on both sides of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.deviation import likelihood, model, spread
from compasslib.deviation.forms import EXACT, Form
from compasslib.deviation.likelihood import CELL_DEG, COARSE, FINE, FREEDOM, Grid, Sample, widths
from compasslib.deviation.model import Fit, Noise
from compasslib.deviation.prior import Prior
from compasslib.records import Pairs
from compasslib.statistics import autocorrelation, bfgs
from compasslib.types import Floats

STRENGTHS = (0.0, 0.3, 0.6, 0.85, 1.1, 1.35, 1.7, 2.2)  # hard iron over the earth's horizontal field
DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)
START_PAIRS, START_COUNT, START_KEPT, START_ROUNDS = 900, 5, 2, 2
START_NOISE, START_COMPASS_DEG = Noise(floor_deg=10.0, slow_deg_m_s=2.0, outliers=0.02), 6.0
MOST_SOFT = 0.3  # D and E together; spheres and frames induce a few per cent
TURNS_DEG = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)  # of all readings, that these begin with
ROUNDS, STEPS, NOISE_PAIRS = 2, 40, 1000
# Weak beliefs that only matter where the record says nothing: centre and width of A..E and log(compass noise / degree).
PRIOR_CENTRE = np.zeros(6)
PRIOR_WIDTH = np.array([0.5, 1.5, 1.5, 0.3, 0.3, 0.15])
HARD_IRON_FIRST = np.array([0.02, 1.5, 1.5, 0.02, 0.02, 0.3])  # the same while a start finds its fold
# |D|, |E| under |u| keeps the induced part from turning the field round, which no iron near an instrument does. The
# grids resolve no less compass noise than the last.
PARAMETER_BOUNDS = np.array([(-np.inf, np.inf)] * 3 + [(-0.6, 0.6)] * 2 + [(np.log(0.8), np.log(8.0))])
PRIOR_SMOOTHING_DEG, PRIOR_FLOOR = 12.0, 0.1
# The cells resolve no less than these: log(floor), log(slow part), logit(outliers).
NOISE_BOUNDS = np.array([(np.log(CELL_DEG), np.log(90.0)), (np.log(0.05), np.log(50.0)), (-9.0, 2.0)])
NOISE_PRIOR = np.array([np.log(8.0), np.log(2.5), -4.0])  # weak, of width 1
NOISE_STEPS = 15
POWER = (FREEDOM + 1.0) / 2.0  # of Student's t: three


def fit(pairs: Pairs, near: Fit | None = None) -> Fit:
    """Return the exact compass that best explains the overlap's directions given the recorded headings.

    Args:
        near: a fit to start from, where the right fold is known already.
    """
    if len(pairs) < model.FEWEST_PAIRS:
        return model.too_few("exact", len(pairs))
    overlap, prior = _overlap(pairs), None if near is None else near.prior
    state = _maximised(overlap, EXACT, near)
    if prior is None or near is None:
        return _described(state, pairs, overlap)
    counted = spread.repeated(pairs, _described(state, pairs, overlap).n_effective)
    believed = replace(prior, precision=counted * prior.precision)
    for _ in range(ROUNDS):
        state = _improve(state, overlap, FINE, EXACT, believed=believed)
    return replace(_described(state, pairs, overlap, believed), prior=prior)


def beside(prior: Prior, pairs: Pairs) -> Fit:
    """Return where a fit starts of which other records tell the compass: its A is that of the pairs' middle."""
    bare = Fit("exact", len(pairs), prior.mean, heading_density=np.full(likelihood.CELLS, 1.0 / likelihood.CELLS))
    off = model.residual(bare, pairs)
    turned = np.where(np.isfinite(off), angles.phasor(off), 0.0).sum()
    mean = prior.mean.copy()
    mean[0] += 0.0 if prior.precision[0, 0] else np.clip(np.angle(turned), -0.5, 0.5)
    return replace(bare, coefficients=mean, prior=prior)


def held_out_scores(form: Form, pairs: Pairs, fold: NDArray[np.signedinteger], near: Fit | None = None) -> Floats:
    """Return the log-likelihood of each pair under a form fitted to the other folds, (n,).

    Args:
        fold: number of the fold that each pair belongs to, (n,).
        near: a fit of the same form to all pairs, to start from.
    """
    overlap, scores = _overlap(pairs), np.empty(len(pairs))
    whole = _start(overlap, form) if near is None else _at(near)
    for k in np.unique(fold):
        left_out, seen = np.flatnonzero(fold == k), np.flatnonzero(fold != k)
        state = whole
        for _ in range(ROUNDS):
            state = _improve(state, overlap.take(seen), FINE, form)
        data = overlap.take(left_out).sample(state.noise, FINE, form)
        scores[left_out] = likelihood.values(state.parameters, data, state.prior, FINE)
    return scores


def _maximised(overlap: _Overlap, form: Form, near: Fit | None) -> _State:
    state = _refined(_start(overlap, form) if near is None else _at(near), overlap, form)
    soft = float(np.hypot(*state.parameters[3:5]))
    if near is not None or form is not EXACT or soft < MOST_SOFT:
        return state
    # More soft iron than an instrument has stands for something else: where a compass is two-valued, for readings that
    # are all turned by one angle.
    turned = [_refined(_start_turned(overlap, angle, form), overlap, form) for angle in TURNS_DEG]
    return min([state, *turned], key=lambda each: each.loss)


def _refined(state: _State, overlap: _Overlap, form: Form) -> _State:
    for _ in range(ROUNDS):
        state = _improve(state, overlap, FINE, form)
    return state


def _start_turned(overlap: _Overlap, angle_deg: float, form: Form) -> _State:
    """Start from readings that an angle was added to: q e^{i angle} is q with other coefficients, up to a factor."""
    start = _start(replace(overlap, recorded_deg=angles.wrap360(overlap.recorded_deg - angle_deg)), form)
    turn = angles.phasor(angle_deg) / float(angles.sin_cos(angle_deg)[1])
    a, b, c, d, e = start.parameters[:5]
    u, p, v = (1.0 - 1j * a) * turn, (b - 1j * c) * turn, (d - 1j * e) * turn
    scaled = np.array([-u.imag, p.real, -p.imag, v.real, -v.imag]) / u.real
    return replace(start, parameters=np.append(scaled, start.parameters[5]))


def _overlap(pairs: Pairs) -> _Overlap:
    observed = model.observed_heading(pairs)
    return _Overlap(pairs.heading_deg, observed, likelihood.squared_chords(observed), *model.speeds(pairs))


def scores_at(coefficients: Floats, pairs: Pairs, fit: Fit) -> tuple[float, Floats]:
    """Return the log-likelihood of other coefficients under a fit's scatter, and each pair's gradient by A..E, (n, 5).

    Args:
        coefficients: A..E of the exact compass, (5,).
    """
    data = _overlap(pairs).sample(fit.noise, FINE, EXACT)
    parameters = np.append(coefficients, np.log(fit.noise.compass_deg))
    value = likelihood.value(parameters, data, fit.heading_density, FINE)
    return value, likelihood.scores(parameters, data, fit.heading_density, FINE)[:, :5]


@dataclass(frozen=True)
class _Overlap:
    """The pairs as the fit needs them, (n,) each."""

    recorded_deg: Floats
    observed_deg: Floats
    squared_chord: Floats  # (n, CELLS)
    upper_speed: Floats
    lower_speed: Floats

    def width_deg(self, noise: Noise) -> Floats:
        return likelihood.widths(noise, self.upper_speed, self.lower_speed)

    def take(self, index: NDArray[np.signedinteger]) -> _Overlap:
        return _Overlap(*(column[index] for column in vars(self).values()))

    def sample(self, noise: Noise, grid: Grid, form: Form) -> Sample:
        density = likelihood.scatter(self.squared_chord, self.width_deg(noise), noise.outliers)
        return likelihood.sample(self.recorded_deg, density, grid, form)


@dataclass(frozen=True)
class _State:
    """Where a search for the maximum stands."""

    parameters: Floats  # A..E and log(compass noise / degree)
    noise: Noise
    prior: Floats
    loss: float = float("inf")


def _start(overlap: _Overlap, form: Form) -> _State:
    """Climb from the best of many strengths and directions of the iron, on the pairs whose directions say most.

    The scatter is fitted anew for each maximum before they are compared: under too wide a scatter a fold blurs and a
    wrong compass looks as good as the right one.
    """
    width = overlap.width_deg(START_NOISE)
    clear = np.sort(np.argsort(width, kind="stable")[: max(len(width) // 2, min(START_PAIRS, len(width)))])
    few = overlap.take(clear[:: max(1, len(clear) // START_PAIRS)])
    prior = smoothed(np.histogram(few.observed_deg, bins=likelihood.CELLS, range=(0.0, 360.0))[0].astype(float))
    data = few.sample(START_NOISE, COARSE, form)
    starts = [_iron(strength, towards) for strength in STRENGTHS for towards in DIRECTIONS_DEG]
    values = [-likelihood.value(start, data, prior, COARSE) for start in starts]
    states = [_State(starts[i], START_NOISE, prior) for i in np.argsort(values)[:START_COUNT]]
    states = [_improve(state, few, COARSE, form, HARD_IRON_FIRST) for state in states]
    states = sorted(states, key=lambda state: state.loss)[:START_KEPT]
    for _ in range(START_ROUNDS):
        states = [_improve(state, few, COARSE, form) for state in states]
    return min(states, key=lambda state: state.loss)


def _at(fit: Fit) -> _State:
    return _State(np.append(fit.coefficients, np.log(fit.noise.compass_deg)), fit.noise, fit.heading_density)


def _improve(
    state: _State,
    overlap: _Overlap,
    grid: Grid,
    form: Form,
    prior_width: Floats = PRIOR_WIDTH,
    *,
    believed: Prior | None = None,
) -> _State:
    """Climb with the scatter held, then fit the scatter and the headings' distribution with the compass held."""
    data = overlap.sample(state.noise, grid, form)
    parameters, loss = _maximise(state.parameters, data, state.prior, grid, prior_width, believed=believed)
    prior = smoothed(likelihood.occupancy(parameters, data, state.prior, grid))
    return _State(parameters, _fit_noise(state.noise, overlap, parameters, prior, form), prior, loss)


def _described(state: _State, pairs: Pairs, overlap: _Overlap, believed: Prior | None = None) -> Fit:
    data = overlap.sample(state.noise, FINE, EXACT)
    parameters, _ = _maximise(state.parameters, data, state.prior, FINE, believed=believed)
    noise = replace(state.noise, compass_deg=float(np.exp(parameters[5])))
    scores = likelihood.scores(parameters, data, state.prior, FINE)[:, :5]
    bare = Fit("exact", len(pairs), parameters[:5], noise=noise)
    left = model.residual(bare, pairs)
    standard = np.clip(left / overlap.width_deg(noise), -3.0, 3.0)
    known = np.isfinite(standard)
    effective = autocorrelation.effective_number(standard[known], pairs.time_s[known])
    return replace(
        bare,
        covariance=spread.covariance(scores, PRIOR_WIDTH[:5] ** -2.0, bare, pairs, effective, believed),
        n_effective=effective,
        residual_rms_deg=angles.rms(left),
        recorded_range_deg=compass.recorded_range(parameters[:5]),
        folded=not compass.turns_full_circle(parameters[:5]),
        noise=noise,
        heading_density=state.prior,
    )


def _iron(strength: float, towards_deg: float) -> Floats:
    starboard, forward = angles.components(strength, towards_deg)
    return np.array([0.0, float(forward), float(starboard), 0.0, 0.0, np.log(START_COMPASS_DEG)])


def _penalised(
    parameters: Floats, data: Sample, prior: Floats, grid: Grid, prior_width: Floats, believed: Prior | None
) -> tuple[float, Floats]:
    """Return minus the log-likelihood and the priors' part, with gradient."""
    value, slopes = likelihood.value_and_gradient(parameters, data, prior, grid)
    pull = (parameters - PRIOR_CENTRE) / prior_width
    loss, slopes = -value + 0.5 * float(pull @ pull), -slopes + pull / prior_width
    if believed is not None:
        off = parameters[:5] - believed.mean
        loss, slopes[:5] = loss + 0.5 * float(off @ believed.precision @ off), slopes[:5] + believed.precision @ off
    return loss, slopes


def _maximise(
    parameters: Floats,
    data: Sample,
    prior: Floats,
    grid: Grid,
    prior_width: Floats = PRIOR_WIDTH,
    *,
    believed: Prior | None = None,
) -> tuple[Floats, float]:
    def loss(at: Floats) -> tuple[float, Floats]:
        return _penalised(at, data, prior, grid, prior_width, believed)

    scores = likelihood.scores(parameters, data, prior, grid)
    curvature = scores.T @ scores + np.diag(prior_width**-2.0)
    if believed is not None:
        curvature[:5, :5] += believed.precision
    return bfgs.minimise(loss, parameters, PARAMETER_BOUNDS, STEPS, curvature)


def smoothed(mass: Floats) -> Floats:
    """Return a distribution of headings, smoothed and with a uniform floor, that sums to 1.

    Args:
        mass: counts on the cells, (CELLS,), not all zero.
    """
    distance = angles.wrap180(likelihood.CELL_CENTRES)
    kernel = np.exp(-0.5 * (distance / PRIOR_SMOOTHING_DEG) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(mass) * np.fft.rfft(kernel / kernel.sum()), len(mass))
    smooth = np.maximum(smooth, 0.0) / smooth.sum()
    return (1.0 - PRIOR_FLOOR) * smooth + PRIOR_FLOOR / len(mass)


def _fit_noise(near: Noise, overlap: _Overlap, parameters: Floats, prior: Floats, form: Form) -> Noise:
    """Fit floor, slow part and outliers of the scatter with the compass held."""
    few = overlap.take(np.arange(0, len(overlap.observed_deg), max(1, len(overlap.observed_deg) // NOISE_PAIRS)))
    given = likelihood.given_recorded(parameters, few.recorded_deg, prior, FINE, form)
    return fit_noise(ScatterData(given, few.squared_chord, few.upper_speed, few.lower_speed), near)


# The scatter of directions fitted with the compass held: its floor, what slow water adds, the outliers.


@dataclass(frozen=True)
class ScatterData:
    """What the scatter is fitted to; n pairs."""

    given: Floats  # (n, CELLS) distribution of the correct heading, the direction left out
    squared_chord: Floats  # (n, CELLS) of the observed heading, square degrees
    upper_speed: Floats  # (n,) m/s
    lower_speed: Floats  # (n,) m/s


def fit_noise(seen: ScatterData, near: Noise) -> Noise:
    """Return the scatter under which the observed headings are likeliest; the compass's own noise is not in it.

    Args:
        near: where to start.
    """

    def loss(x: Floats) -> tuple[float, Floats]:
        value, slope = log_likelihood(x, seen)
        off = x - NOISE_PRIOR
        return 0.5 * float(off @ off) - value, off - slope

    start = [np.log(near.floor_deg), np.log(near.slow_deg_m_s), np.log(near.outliers / (1.0 - near.outliers))]
    return _noise(bfgs.minimise(loss, np.array(start), NOISE_BOUNDS, NOISE_STEPS)[0])


def log_likelihood(x: Floats, seen: ScatterData) -> tuple[float, Floats]:
    """Return the log-likelihood and its gradient.

    With r = 1 / (1 + chord^2 / (FREEDOM width^2)) the density is r^POWER over its sum, and a relative change of the
    width moves the logarithm of r^POWER by 2 POWER (1 - r).

    Args:
        x: logarithms of floor and slow part (degrees, degrees times m/s), logit of the share of outliers, (3,).
    """
    noise = _noise(x)
    width = widths(noise, seen.upper_speed, seen.lower_speed)
    ratio = seen.squared_chord / (FREEDOM * width[:, None] ** 2)
    ratio += 1.0
    np.reciprocal(ratio, out=ratio)
    density = ratio * ratio  # a power is ten times as slow
    density *= ratio
    whole, agreeing = density.sum(axis=1), np.einsum("nc,nc->n", seen.given, density)
    density *= ratio
    by_width = 2.0 * POWER * (agreeing * density.sum(axis=1) / whole - np.einsum("nc,nc->n", seen.given, density))
    scale = (1.0 - noise.outliers) / (CELL_DEG * whole)
    joint = scale * agreeing + noise.outliers / 360.0
    by_width *= scale / joint * (width < 360.0) / width**2  # capped at a full turn
    by_outliers = (noise.outliers / 360.0 - noise.outliers * agreeing / (CELL_DEG * whole)) * (1.0 - noise.outliers)
    floor = noise.floor_deg**2
    slope = [np.sum(by_width) * floor, np.sum(by_width * (width**2 - floor)), np.sum(by_outliers / joint)]
    return float(np.sum(np.log(joint))), np.array(slope)


def _noise(x: Floats) -> Noise:
    return Noise(float(np.exp(x[0])), float(np.exp(x[1])), float(1.0 / (1.0 + np.exp(-x[2]))))
