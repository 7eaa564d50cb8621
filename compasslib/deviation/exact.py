"""The exact compass fitted to overlapping instruments by the latent-heading likelihood.

Compasses with iron weaker and stronger than the earth's horizontal field are one family here: the same five numbers, no
change of method at the fold. Starts cover the direction and the strength of the iron on both sides of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, compass
from compasslib.deviation import likelihood, model
from compasslib.deviation.likelihood import CELL_DEG, COARSE, FINE, Grid, Sample
from compasslib.deviation.model import Fit, Noise
from compasslib.records import Pairs

Floats = NDArray[np.floating]

STRENGTHS = (0.0, 0.3, 0.6, 0.9, 1.2, 1.6, 2.2)  # hard iron over the earth's horizontal field
DIRECTIONS_DEG = np.arange(0.0, 360.0, 22.5)
START_PAIRS, START_COUNT = 900, 5
ROUNDS = 3
# Weak beliefs that only matter where the record says nothing: centre and width of A..E and log(compass noise / degree).
BELIEF_CENTRE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.log(1.5)])
BELIEF_WIDTH = np.array([0.5, 1.5, 1.5, 0.3, 0.3, 0.3])
# The grids resolve no less than this: log(compass noise), then log(floor), log(slow part), logit(outliers).
COMPASS_NOISE_BOUNDS = (np.log(1.0), np.log(8.0))
NOISE_BOUNDS = [(np.log(CELL_DEG), np.log(90.0)), (np.log(0.05), np.log(50.0)), (-9.0, 2.0)]
PRIOR_SMOOTHING_DEG, PRIOR_FLOOR = 12.0, 0.1
BLOCK_S = 5 * 86400.0  # longer than the memory of the currents' veer
FEWEST_BLOCKS = 12


def fit(pairs: Pairs) -> Fit:
    """Return the exact compass that best explains the overlap's directions given the recorded headings.

    Args:
        pairs: overlapping measurements.
    """
    if len(pairs) < model.FEWEST_PAIRS:
        return model.too_few("exact", len(pairs))
    observed = model.observed_heading(pairs)
    noise = Noise()
    prior = _smoothed(np.histogram(observed, bins=likelihood.CELLS, range=(0.0, 360.0))[0].astype(float))
    parameters = _start(pairs, observed, noise, prior)
    for _ in range(ROUNDS):
        data = _sample(pairs, observed, noise, FINE)
        parameters = _climb(parameters, data, prior, FINE, steps=40)
        prior = _smoothed(likelihood.responsibilities(parameters, data, prior, FINE).sum(axis=0))
        noise = _fit_noise(noise, pairs, observed, parameters, prior)
    data = _sample(pairs, observed, noise, FINE)
    parameters = _climb(parameters, data, prior, FINE, steps=60)
    noise = replace(noise, compass_deg=float(np.exp(parameters[5])))
    return _described(parameters, pairs, observed, noise, prior, data)


def residual(fit: Fit, pairs: Pairs) -> Floats:
    """Return the observed heading minus the model's, the nearer root where there are two, degrees; NaN without a root.

    Args:
        fit: a fitted exact compass.
        pairs: overlapping measurements.
    """
    roots = compass.inverse(fit.coefficients, pairs.heading_deg)
    off = angles.difference(model.observed_heading(pairs)[:, None], roots)
    nearer = np.argmin(np.where(np.isfinite(off), np.abs(off), np.inf), axis=1)
    return off[np.arange(len(off)), nearer]


def _described(
    parameters: Floats, pairs: Pairs, observed: Floats, noise: Noise, prior: Floats, data: Sample
) -> Fit:
    coefficients = parameters[:5]
    bare = Fit("exact", len(pairs), coefficients)
    left = residual(bare, pairs)
    standard = np.clip(left / likelihood.widths(noise, *model.speeds(pairs)), -3.0, 3.0)
    known = np.isfinite(standard)
    effective = model.effective_number(standard[known], pairs.time_s[known])
    return replace(
        bare,
        covariance=_covariance(parameters, data, prior, pairs.time_s, effective),
        n_effective=effective,
        residual_rms_deg=angles.rms(left),
        recorded_range_deg=compass.recorded_range(coefficients),
        folded=not compass.turns_full_circle(coefficients),
        noise=noise,
        heading_density=prior,
    )


def _sample(pairs: Pairs, observed: Floats, noise: Noise, grid: Grid) -> Sample:
    width = likelihood.widths(noise, *model.speeds(pairs))
    return likelihood.sample(pairs.heading_deg, likelihood.scatter(observed, width, noise.outliers), grid)


def _start(pairs: Pairs, observed: Floats, noise: Noise, prior: Floats) -> Floats:
    """Climb from the best of many strengths and directions of the iron, on the pairs whose directions say most."""
    width = likelihood.widths(noise, *model.speeds(pairs))
    clear = np.argsort(width, kind="stable")[: max(len(width) // 2, min(START_PAIRS, len(width)))]
    clear = np.sort(clear)[:: max(1, len(clear) // START_PAIRS)]
    density = likelihood.scatter(observed[clear], width[clear], noise.outliers)
    data = likelihood.sample(pairs.heading_deg[clear], density, COARSE)
    starts = [_iron(strength, towards) for strength in STRENGTHS for towards in DIRECTIONS_DEG]
    values = [_penalised(start, data, prior, COARSE, gradient=False)[0] for start in starts]
    best = [starts[i] for i in np.argsort(values)[:START_COUNT]]
    climbed = [_climb(start, data, prior, COARSE, steps=25) for start in best]
    return min(climbed, key=lambda p: _penalised(p, data, prior, COARSE, gradient=False)[0])


def _iron(strength: float, towards_deg: float) -> Floats:
    starboard, forward = angles.components(strength, towards_deg)
    return np.array([0.0, float(forward), float(starboard), 0.0, 0.0, np.log(2.5)])


def _penalised(
    parameters: Floats, data: Sample, prior: Floats, grid: Grid, *, gradient: bool = True
) -> tuple[float, Floats]:
    """Return minus the log-likelihood and the weak beliefs' part, with gradient."""
    value, slopes = likelihood.value_and_gradient(parameters, data, prior, grid, gradient=gradient)
    pull = (parameters - BELIEF_CENTRE) / BELIEF_WIDTH
    return -value + 0.5 * float(pull @ pull), -slopes + pull / BELIEF_WIDTH


def _climb(parameters: Floats, data: Sample, prior: Floats, grid: Grid, *, steps: int) -> Floats:
    from scipy.optimize import minimize  # 0.4 s: only jobs that fit pay for it

    bounds = [(None, None)] * 5 + [COMPASS_NOISE_BOUNDS]
    options = {"maxiter": steps}
    found = minimize(
        _penalised, parameters, args=(data, prior, grid), jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    return np.asarray(found.x)


def _smoothed(mass: Floats) -> Floats:
    """Return a distribution of headings from counts on the cells, smoothed, with a uniform floor."""
    distance = angles.wrap180(likelihood.CELL_CENTRES)
    kernel = np.exp(-0.5 * (distance / PRIOR_SMOOTHING_DEG) ** 2)
    smooth = np.fft.irfft(np.fft.rfft(mass) * np.fft.rfft(kernel / kernel.sum()), len(mass))
    smooth = np.maximum(smooth, 0.0) / smooth.sum()
    return (1.0 - PRIOR_FLOOR) * smooth + PRIOR_FLOOR / len(mass)


def _fit_noise(noise: Noise, pairs: Pairs, observed: Floats, parameters: Floats, prior: Floats) -> Noise:
    """Fit floor, slow part and outliers of the scatter with the compass held."""
    from scipy.optimize import minimize

    some = np.arange(0, len(observed), max(1, len(observed) // 1200))
    upper, lower = (speed[some] for speed in model.speeds(pairs))
    flat = likelihood.sample(pairs.heading_deg[some], np.ones((len(some), likelihood.CELLS)), FINE)
    given = np.empty((len(some), likelihood.CELLS))
    given[flat.order] = likelihood.responsibilities(parameters, flat, prior, FINE)

    def loss(x: Floats) -> float:
        width = likelihood.widths(_noise(x), upper, lower)
        density = likelihood.scatter(observed[some], width, _noise(x).outliers)
        belief = 0.5 * ((x[0] - np.log(8.0)) ** 2 + (x[1] - np.log(2.5)) ** 2 + (x[2] + 4.0) ** 2)
        return belief - float(np.sum(np.log(np.einsum("nc,nc->n", given, density))))

    start = [np.log(noise.floor_deg), np.log(noise.slow_deg_m_s), np.log(noise.outliers / (1.0 - noise.outliers))]
    return _noise(minimize(loss, start, method="L-BFGS-B", bounds=NOISE_BOUNDS, options={"maxiter": 15}).x)


def _noise(x: Floats) -> Noise:
    return Noise(float(np.exp(x[0])), float(np.exp(x[1])), float(1.0 / (1.0 + np.exp(-x[2]))))


def _covariance(parameters: Floats, data: Sample, prior: Floats, time_s: Floats, effective: float) -> Floats:
    """Return the covariance of A..E that holds for autocorrelated pairs: the jackknife over blocks of days.

    Each block is left out by one Newton step from the whole fit (the estimator CR3 of Bell and McCaffrey, Survey
    Methodology 28, 169, 2002), which does not flatter itself when there are few blocks. The information is the scores'
    outer product: it stays positive where the record hardly determines a coefficient.
    """
    scores = likelihood.scores(parameters, data, prior, FINE)
    information = scores.T @ scores + np.diag(BELIEF_WIDTH[:5] ** -2.0)
    block = np.floor((time_s - time_s[0]) / BLOCK_S).astype(int)
    blocks = np.unique(block)
    if len(blocks) < FEWEST_BLOCKS:
        return np.linalg.inv(information) * len(time_s) / max(effective, 6.0)
    parts = [scores[block == b] for b in blocks]
    steps = np.array([np.linalg.solve(information - part.T @ part, part.sum(axis=0)) for part in parts])
    return steps.T @ steps * (len(blocks) - 1) / len(blocks)
