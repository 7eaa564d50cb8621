"""Compare a short recording with its simulation, refitting each hypothesis in the forward model.

Base parameters and terms are fitted jointly by Gauss-Newton steps with Huber weights: effects may be a thousand times
the noise, which is 0.01 to 5 degrees.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from compasslib import angles, compass
from compasslib.deviation.model import nearest_root
from compasslib.deviation.series import series_design
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, Scene, parameter_slices
from compasslib.effects.forward import ForwardModel, invert_heading, invert_readout, recorded_heading, water_veer
from compasslib.inference import finding
from compasslib.inference.comparison import Comparison
from compasslib.statistics.least_squares import MISFIT_TOLERANCE, gauss_newton, robust_width
from compasslib.statistics.noise import arma_covariance, arma_effective_size, effective_sample_size
from compasslib.statistics.resampling import block_sums, blocks_by_count, student_factor
from compasslib.statistics.whitening import orthonormal_basis, project_out, scaled_inverse
from compasslib.types import Floats

# Nominal horizontal field where the place is unknown; iron is then given in percent of it.
PLACELESS_NT, PERCENT = 20000.0, (100.0 / 20000.0, "% of the horizontal field")

REFIT_ROUNDS, CONVERGED_STEPS = 12, 1e-3  # Gauss-Newton rounds, at most; step at convergence, in about degrees
FINEST_DEG = 1e-4  # least uncertainty of a heading
MOST_BLOCKS, FEWEST_BLOCKS, SAMPLES_IN_BLOCK = 40, 10, 5.0  # number of blocks; effective samples in one
NEIGHBOURS = 5  # samples whose median an outlier of a log is far from
PROBE_STEP = 0.02  # finite difference, relative to a parameter's step


class ResidualModel(Protocol):
    """Observed minus simulated, (n,) degrees, for base parameters (b,) and terms."""

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats: ...


@dataclass(frozen=True, kw_only=True)
class ShortComparison(Comparison):
    """A short recording compared with its simulation; n samples in order of time."""

    residual: ResidualModel
    start: Floats  # (b,) base parameters of the simulation, before any fit
    steps: Floats  # (b,) change of each that turns the heading by about a degree; 0 holds it fixed
    confused: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # effect -> effects that look the same here
    field_unit: tuple[float, str] = (1.0, "nT")  # factor from nT, and name
    starts: Mapping[str, tuple[float, ...]] = field(default_factory=dict)  # effect -> starts of its first parameter
    rule_deg: float = 0.0  # systematic error of the simulation that no number of samples averages out, rms
    independent: bool = False  # whether errors of the readings are independent
    arma_noise: bool = False  # whether the noise is modelled as ARMA instead of estimated from blocks
    reads: bool = True  # whether what is compared is a reading of a compass

    @cached_property
    def conditions(self) -> Scene:
        """The covariates, as departures of a scene."""
        departures = {name: x - x.mean() for name, x in self.covariates.items()}
        none = np.zeros(len(self))
        return Scene(self.time_s, none, none, none, none, self.span_s[0], departures)

    def difference(self, base: Floats, terms: Sequence[Effect]) -> Floats:
        """Compute observed minus simulated values, (n,) degrees; composed terms are added to the simulated ones."""
        listed = tuple(term for term in terms if not isinstance(term, ComposedEffect))
        unlisted = (term for term in terms if isinstance(term, ComposedEffect))
        return self.residual(base, listed) - sum(self.series(term) @ term.values for term in unlisted)

    def series(self, term: ComposedEffect) -> Floats:
        """Compute the columns that a composed term adds, (n, p)."""
        return term.series(self.conditions, self.covariates.get("heading"))

    def unit(self, term: Effect, k: int) -> tuple[float, str]:
        """Get the factor and the unit in which a parameter is displayed."""
        unit = term.units()[k]
        if not unit.startswith("nT"):
            return 1.0, unit
        return self.field_unit[0], self.field_unit[1] + unit.removeprefix("nT")


def thin_indices(length: int, most: int = 2500) -> NDArray[np.intp]:
    """Select evenly spaced samples of a record; ``most`` limits the run time of a search."""
    return np.arange(0, length, max(1, -(-length // most)))


@dataclass(frozen=True)
class CompassResidual:
    """Residual of the exact compass in the recorded heading, which exists for every correct heading."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return simulated minus recorded heading, (n,) degrees; its sign is that of observed minus simulated."""
        simulation = ForwardModel(base, float(np.mean(self.scene.horizontal_nT)), terms)
        correct = self.correct_deg - water_veer(simulation, self.scene)
        return angles.difference(recorded_heading(simulation, self.scene, correct), self.recorded_deg)

    def heading_error(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return correct minus simulated correct heading, (n,) degrees; of readings beyond a fold, that of the fold."""
        simulation = ForwardModel(base, float(np.mean(self.scene.horizontal_nT)), terms)
        correct = self.correct_deg - water_veer(simulation, self.scene)
        root = nearest_root(invert_heading(simulation, self.scene, self.recorded_deg), correct)
        turn = np.arange(0.0, 360.0, 0.5)
        off = angles.difference(compass.recorded_heading(base, turn), self.recorded_deg[:, None])
        fold = turn[np.argmin(np.abs(off), axis=1)]
        return angles.difference(correct, np.where(np.isfinite(root), root, fold))


@dataclass(frozen=True)
class SeriesResidual:
    """Residual of Smith's five-term series in the recorded heading, degrees; terms act on the reading."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Return observed minus simulated correct heading, (n,) degrees."""
        no_iron = ForwardModel(np.zeros(5), float(np.mean(self.scene.horizontal_nT)), terms)
        reading = invert_readout(no_iron, self.scene, self.recorded_deg)
        corrected = reading + series_design(reading) @ base
        return angles.difference(self.correct_deg, corrected + water_veer(no_iron, self.scene))


def recording_scene(
    time_s: Floats,
    field: Mapping[str, float] | None,
    *,
    tilt_deg: tuple[Floats, Floats] | None = None,
    departures: Mapping[str, Floats] | None = None,
) -> tuple[Scene, tuple[float, str]]:
    """Build the scene of a recording, and the factor and unit of its iron.

    Args:
        time_s: (n,), UTC seconds or numbers of readings.
        field: {horizontal_nT, vertical_nT}, None where the place is unknown.
        tilt_deg: pitch and roll, (n,) each.
        departures: series that terms require, (n,) each.
    """
    unit_field, zero = np.ones(len(time_s)), np.zeros(len(time_s))
    h, z = (PLACELESS_NT, 0.0) if field is None else (field["horizontal_nT"], field["vertical_nT"])
    pitch, roll = tilt_deg or (zero, zero)
    unit = PERCENT if field is None else (1.0, "nT")
    return Scene(time_s, h * unit_field, z * unit_field, pitch, roll, float(time_s[0]), departures or {}), unit


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis at its best parameters."""

    comparison: ShortComparison
    base: Floats  # (b,)
    terms: tuple[Effect, ...]
    residual_deg: Floats  # (n,)
    columns: Floats  # (n, b + p) derivative of the simulated heading by each parameter, degrees a unit
    scale_deg: float  # robust width of the residual

    @property
    def clipped(self) -> Floats:
        """The residual, clipped unless readings are independent, (n,)."""
        if self.comparison.independent:
            return self.residual_deg
        return np.clip(self.residual_deg, -finding.MOST_WIDTHS * self.scale_deg, finding.MOST_WIDTHS * self.scale_deg)

    @cached_property
    def evident(self) -> Floats:
        """The residual without the isolated outliers of a log, (n,)."""
        if self.comparison.independent or self.comparison.arma_noise:
            return self.residual_deg
        middle = median_filter(self.residual_deg, NEIGHBOURS, mode="nearest")
        away = self.residual_deg - middle
        most = finding.MOST_WIDTHS * max(robust_width(away), FINEST_DEG)
        return np.asarray(middle + np.clip(away, -most, most))

    @property
    def square(self) -> float:
        """Sum of squares of the clipped residual, at least that of the finest headings."""
        return max(float(self.clipped @ self.clipped), len(self.clipped) * FINEST_DEG**2)

    def projected(self, columns: Floats) -> Floats:
        """Project the columns of all parameters out of other columns, (n, k)."""
        return project_out(columns, orthonormal_basis(self.columns))


def fit_hypothesis(
    comparison: ShortComparison,
    terms: Sequence[Effect],
    *,
    near: FittedHypothesis | None = None,
    use: NDArray[np.bool_] | None = None,
) -> FittedHypothesis:
    """Fit the base parameters and terms of a hypothesis.

    Args:
        terms: terms at their starting values; their dates are held fixed.
        near: fit whose base parameters are the starting values.
        use: mask of the samples used, (n,).
    """
    base = comparison.start if near is None else near.base
    theta = np.concatenate([base, *(term.values for term in terms)])
    steps = np.concatenate([comparison.steps, *(term.steps() for term in terms)])
    keep = np.ones(len(comparison), dtype=bool) if use is None else use
    begin = _FitState(_linearize(comparison, theta, tuple(terms), steps), theta, steps, keep)
    if not len(steps):
        return begin.fitted
    return gauss_newton(begin, rounds=REFIT_ROUNDS, close=CONVERGED_STEPS, worse=1.0 + MISFIT_TOLERANCE).fitted


@dataclass(frozen=True)
class _FitState:
    """State of the iterative fit of a hypothesis."""

    fitted: FittedHypothesis
    theta: Floats  # (b + p,)
    steps: Floats  # (b + p,) of about a degree
    keep: NDArray[np.bool_]  # (n,) mask of the samples used

    def step(self) -> tuple[Floats, float]:
        step = _least_squares_step(self.fitted, self.steps, self.keep)  # in the parameters' own steps
        return step * self.steps, float(np.max(np.abs(step)))

    def moved(self, step: Floats) -> _FitState:
        theta = self.theta + step
        return replace(
            self, fitted=_linearize(self.fitted.comparison, theta, self.fitted.terms, self.steps), theta=theta
        )

    def misfit(self, other: _FitState) -> float:
        """Compute the ratio of another state's sum of squares to this one's."""
        square, then = (float(np.sum(state.fitted.clipped[self.keep] ** 2)) for state in (self, other))
        return then / max(square, 1e-300)


def term_derivative(now: FittedHypothesis, term: Effect) -> Floats:
    """Differentiate the simulated heading by the parameters of a term added to a hypothesis, (n, p)."""
    made = []
    for j, step in enumerate(term.steps()):
        moved = term.at(term.values + 0.1 * step * (np.arange(len(term.values)) == j))
        made.append((now.residual_deg - now.comparison.difference(now.base, (*now.terms, moved))) / (0.1 * step))
    return np.stack(made, axis=1)


def _linearize(
    comparison: ShortComparison, theta: Floats, terms: tuple[Effect, ...], steps: Floats
) -> FittedHypothesis:
    base, placed = _split_parameters(comparison, theta, terms)
    residual = comparison.difference(base, placed)
    columns = np.zeros((len(comparison), len(theta)))
    for j in np.flatnonzero(steps):  # a step of 0 holds a parameter fixed
        probe = PROBE_STEP * steps[j]
        more = comparison.difference(
            *_split_parameters(comparison, theta + probe * (np.arange(len(theta)) == j), terms)
        )
        columns[:, j] = (residual - more) / probe
    scale = max(robust_width(residual - np.median(residual)), FINEST_DEG)
    return FittedHypothesis(comparison, base, placed, residual, columns, scale)


def _split_parameters(
    comparison: ShortComparison, theta: Floats, terms: tuple[Effect, ...]
) -> tuple[Floats, tuple[Effect, ...]]:
    places = parameter_slices(terms, len(comparison.start))
    placed = tuple(term.at(theta[part]) for term, part in zip(terms, places, strict=True))
    return theta[: len(comparison.start)], placed


def _least_squares_step(now: FittedHypothesis, steps: Floats, keep: NDArray[np.bool_]) -> Floats:
    """Solve for the weighted least-squares step in units of ``steps``; it is 0 in undetermined directions."""
    size = np.maximum(np.abs(now.residual_deg), 1e-300)
    weight = np.sqrt(np.minimum(1.0, finding.MOST_WIDTHS * now.scale_deg / size)) * keep
    if now.comparison.independent:
        weight = keep.astype(float)
    columns = now.columns * steps
    step, *_ = np.linalg.lstsq(columns * weight[:, None], now.residual_deg * weight, rcond=1e-6)
    return np.asarray(step)


def memory_blocks(fitted: FittedHypothesis) -> NDArray[np.intp]:
    """Number the block of each sample, (n,); a block has several effective samples, or one independent reading."""
    comparison = fitted.comparison
    if comparison.independent:
        return np.arange(len(comparison))
    order = np.arange(len(comparison), dtype=float)
    count = int(np.clip(effective_samples(fitted) / SAMPLES_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
    return blocks_by_count(order, count)


def effective_samples(fitted: FittedHypothesis) -> float:
    """Estimate the effective number of independent samples in the residual."""
    n = len(fitted.comparison)
    if fitted.comparison.independent:
        return float(n)
    if fitted.comparison.arma_noise:
        return arma_effective_size(fitted.clipped, fitted.columns)
    return effective_sample_size(fitted.clipped, np.arange(n, dtype=float), longest_s=n / 10.0)


def parameter_covariance(fitted: FittedHypothesis) -> Floats:
    """Estimate the covariance of base and terms from scores of blocks, at least that of independent samples.

    The systematic error ``rule_deg`` is added as if it were entirely along each parameter's own column.
    """
    if fitted.comparison.arma_noise:
        return arma_covariance(fitted.clipped, fitted.columns)
    columns, residual, block = fitted.columns, fitted.clipped, memory_blocks(fitted)
    inverse = scaled_inverse(columns.T @ columns)
    free = max(len(residual) - columns.shape[1], 1)
    plain = inverse * fitted.square / free * student_factor(free) ** 2
    if fitted.comparison.independent:
        return plain
    sums = block_sums(columns * residual[:, None], block)
    count = len(sums)
    robust = inverse @ (sums.T @ sums) @ inverse * count / (count - 1) * student_factor(count - 1) ** 2
    share = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
    rule = fitted.comparison.rule_deg**2 * len(residual) * np.diag(np.diag(inverse))
    return plain * np.outer(share, share) + rule


def visible_size_deg(fitted: FittedHypothesis, k: int) -> float:
    """Compute the visible size of a term, with all other parameters projected out, rms degrees."""
    columns = parameter_slices(fitted.terms, len(fitted.base))[k]
    other_terms = [term for j, term in enumerate(fitted.terms) if j != k]
    without = fitted.comparison.difference(fitted.base, other_terms) - fitted.residual_deg
    others = orthonormal_basis(np.delete(fitted.columns, columns, axis=1))
    return angles.rms(project_out(without, others))
