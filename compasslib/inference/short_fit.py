"""Compare a short recording with its simulation, fitting each hypothesis in the forward model.

Base parameters and terms are fitted jointly by Gauss-Newton steps with Huber weights: effects may be a thousand times
the noise, which is 0.01 to 5 degrees.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from compasslib import angles, compass
from compasslib.deviation.model import nearest_root
from compasslib.deviation.series import series_design
from compasslib.effects.composed import ComposedEffect
from compasslib.effects.effect import Effect, Scene, parameter_slices
from compasslib.effects.forward import ForwardModel, invert_heading, invert_readout, recorded_heading
from compasslib.inference.comparison import Comparison
from compasslib.inference.finding import MOST_WIDTHS
from compasslib.statistics.least_squares import MISFIT_TOLERANCE, gauss_newton, robust_width
from compasslib.statistics.noise import PHI, THETA, arma_covariance, arma_effective_size, effective_sample_size
from compasslib.statistics.resampling import block_sums, blocks_by_count, student_factor
from compasslib.statistics.whitening import orthonormal_basis, project_out, scaled_inverse
from compasslib.types import Floats

# Nominal horizontal field where the place is unknown; iron is then given in percent of it.
PLACELESS_NT, PERCENT = 20000.0, (100.0 / 20000.0, "% of the horizontal field")
FINEST_DEG = 1e-4  # least uncertainty of a heading
MOST_BLOCKS, FEWEST_BLOCKS, SAMPLES_IN_BLOCK = 40, 10, 5.0  # number of blocks; effective samples in one
NEIGHBOURS = 5  # samples whose median an outlier of a log is far from
PROBE_STEP = 0.02  # finite difference, relative to a parameter's step
MOST_SAMPLES = 2500  # of a recording; limits the run time of a search


# Observed minus simulated, (n,) degrees, for base parameters (b,) and terms.
ResidualModel = Callable[[Floats, tuple[Effect, ...]], Floats]
Law = tuple[float, float]  # autoregressive and moving-average coefficient of the noise

WHITE: Law = (0.0, 0.0)
LAWS: tuple[Law, ...] = tuple((float(p), float(t)) for p in PHI[::2] for t in THETA[::2] if t >= -p)


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

    @property
    def laws(self) -> tuple[Law, ...]:
        """Candidate laws of the noise."""
        return (WHITE,) if self.independent else LAWS

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
        unit = term.units()[k]
        if not unit.startswith("nT"):
            return 1.0, unit
        return self.field_unit[0], self.field_unit[1] + unit.removeprefix("nT")


def thin_indices(length: int) -> NDArray[np.intp]:
    """Select evenly spaced samples of a record, at most ``MOST_SAMPLES``."""
    return np.arange(0, length, max(1, -(-length // MOST_SAMPLES)))


@dataclass(frozen=True)
class CurveResidual:
    """Residual of a deviation curve in the recorded heading: Smith's five-term series, or the exact compass."""

    correct_deg: Floats  # (n,)
    recorded_deg: Floats  # (n,)
    scene: Scene
    exact: bool

    def _simulation(self, base: Floats, terms: tuple[Effect, ...]) -> ForwardModel:
        return ForwardModel(base, float(np.mean(self.scene.horizontal_nT)), terms)

    def __call__(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Compute the error of the simulated correct heading, (n,) degrees.

        For the exact compass it is that of the recorded heading, with the same sign, since a two-valued compass has a
        reading for every heading, but no heading for some readings.
        """
        if self.exact:
            recorded = recorded_heading(self._simulation(base, terms), self.scene, self.correct_deg)
            return angles.difference(recorded, self.recorded_deg)
        reading = invert_readout(self._simulation(np.zeros(5), terms), self.scene, self.recorded_deg)
        return angles.difference(self.correct_deg, reading + series_design(reading) @ base)

    def heading_error(self, base: Floats, terms: tuple[Effect, ...]) -> Floats:
        """Compute correct headings minus those of an exact compass, (n,) degrees; beyond a fold, minus the fold's."""
        roots = invert_heading(self._simulation(base, terms), self.scene, self.recorded_deg)
        root, turn = nearest_root(roots, self.correct_deg), np.arange(0.0, 360.0, 0.5)
        off = angles.difference(compass.recorded_heading(base, turn), self.recorded_deg[:, None])
        fold = turn[np.argmin(np.abs(off), axis=1)]
        return angles.difference(self.correct_deg, np.where(np.isfinite(root), root, fold))


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
    """
    unit_field, zero = np.ones(len(time_s)), np.zeros(len(time_s))
    h, z = (PLACELESS_NT, 0.0) if field is None else (field["horizontal_nT"], field["vertical_nT"])
    pitch, roll = tilt_deg or (zero, zero)
    unit = PERCENT if field is None else (1.0, "nT")
    return Scene(time_s, h * unit_field, z * unit_field, pitch, roll, float(time_s[0]), departures or {}), unit


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis, linearized at its parameters."""

    comparison: ShortComparison
    base: Floats  # (b,)
    terms: tuple[Effect, ...]
    residual_deg: Floats  # (n,)
    columns: Floats  # (n, b + p) derivative of the simulated heading by each parameter, degrees a unit
    used: NDArray[np.bool_]  # (n,) the samples that are fitted

    @cached_property
    def scale_deg(self) -> float:
        """Robust width of the residual."""
        return max(robust_width(self.residual_deg - np.median(self.residual_deg)), FINEST_DEG)

    @property
    def parameters(self) -> Floats:
        """Base parameters and those of the terms, (b + p,)."""
        return np.concatenate([self.base, *(term.values for term in self.terms)])

    @property
    def steps(self) -> Floats:
        """Changes of the parameters that turn the heading by about a degree, (b + p,); 0 holds one fixed."""
        return np.concatenate([self.comparison.steps, *(term.steps() for term in self.terms)])

    @property
    def clipped(self) -> Floats:
        """The residual, clipped unless readings are independent, (n,)."""
        if self.comparison.independent:
            return self.residual_deg
        return np.clip(self.residual_deg, -MOST_WIDTHS * self.scale_deg, MOST_WIDTHS * self.scale_deg)

    @cached_property
    def evident(self) -> Floats:
        """The residual without the isolated outliers of a log, (n,)."""
        if self.comparison.independent or self.comparison.arma_noise:
            return self.residual_deg
        middle = median_filter(self.residual_deg, NEIGHBOURS, mode="nearest")
        away = self.residual_deg - middle
        most = MOST_WIDTHS * max(robust_width(away), FINEST_DEG)
        return np.asarray(middle + np.clip(away, -most, most))

    @property
    def square(self) -> float:
        """Sum of squares of the clipped residual, at least that of the finest headings."""
        return max(float(self.clipped @ self.clipped), len(self.clipped) * FINEST_DEG**2)

    def projected(self, columns: Floats) -> Floats:
        """Project the columns of all parameters out of other columns, (n, k)."""
        return project_out(columns, orthonormal_basis(self.columns))

    def derivative(self, term: Effect) -> Floats:
        """Differentiate the simulated heading by the parameters of a term added to the hypothesis, (n, p)."""
        made = []
        for j, step in enumerate(0.1 * term.steps()):
            moved = term.at(term.values + step * (np.arange(len(term.values)) == j))
            made.append((self.residual_deg - self.comparison.difference(self.base, (*self.terms, moved))) / step)
        return np.stack(made, axis=1)

    @cached_property
    def effective_samples(self) -> float:
        """Effective number of independent samples in the residual."""
        n = len(self.comparison)
        if self.comparison.independent:
            return float(n)
        if self.comparison.arma_noise:
            return arma_effective_size(self.clipped, self.columns)
        return effective_sample_size(self.clipped, np.arange(n, dtype=float), longest_s=n / 10.0)

    @cached_property
    def blocks(self) -> NDArray[np.intp]:
        """Number of the block of each sample, (n,); a block has several effective samples, or one reading."""
        order = np.arange(len(self.comparison))
        if self.comparison.independent:
            return order
        count = int(np.clip(self.effective_samples / SAMPLES_IN_BLOCK, FEWEST_BLOCKS, MOST_BLOCKS))
        return blocks_by_count(order.astype(float), count)

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of base and terms from scores of blocks, at least that of independent samples.

        The systematic error ``rule_deg`` is added as if it were entirely along each parameter's own column.
        """
        columns, residual = self.columns, self.clipped
        if self.comparison.arma_noise:
            return arma_covariance(residual, columns)
        inverse = scaled_inverse(columns.T @ columns)
        free = max(len(residual) - columns.shape[1], 1)
        plain = inverse * self.square / free * student_factor(free) ** 2
        if self.comparison.independent:
            return plain
        sums = block_sums(columns * residual[:, None], self.blocks)
        count = len(sums)
        robust = inverse @ (sums.T @ sums) @ inverse * count / (count - 1) * student_factor(count - 1) ** 2
        share = np.sqrt(np.maximum(np.diag(robust) / np.maximum(np.diag(plain), 1e-300), 1.0))
        rule = self.comparison.rule_deg**2 * len(residual) * np.diag(np.diag(inverse))
        return plain * np.outer(share, share) + rule

    def visible_size_deg(self, k: int) -> float:
        """Compute the visible size of a term, with all other parameters projected out, rms degrees."""
        others = orthonormal_basis(np.delete(self.columns, parameter_slices(self.terms, len(self.base))[k], axis=1))
        without = self.comparison.difference(self.base, (*self.terms[:k], *self.terms[k + 1 :])) - self.residual_deg
        return angles.rms(project_out(without, others))

    def step(self) -> tuple[Floats, float]:
        """Compute the weighted least-squares step, 0 in undetermined directions, and its length in about degrees."""
        weight = self.used.astype(float)
        if not self.comparison.independent:
            size = np.maximum(np.abs(self.residual_deg), 1e-300)
            weight = np.sqrt(np.minimum(1.0, MOST_WIDTHS * self.scale_deg / size)) * weight
        columns = self.columns * self.steps * weight[:, None]
        step, *_ = np.linalg.lstsq(columns, self.residual_deg * weight, rcond=1e-6)
        return step * self.steps, float(np.max(np.abs(step)))

    def moved(self, step: Floats) -> FittedHypothesis:
        """Linearize at other parameters."""
        return _linearize(self.comparison, self.parameters + step, self.terms, self.used)

    def misfit(self, other: FittedHypothesis) -> float:
        """Compute the ratio of another hypothesis' sum of squares to this one's."""
        square, then = (float(np.sum(each.clipped[self.used] ** 2)) for each in (self, other))
        return then / max(square, 1e-300)


def fit_hypothesis(
    comparison: ShortComparison,
    terms: Sequence[Effect],
    *,
    near: FittedHypothesis | None = None,
    use: NDArray[np.bool_] | None = None,
) -> FittedHypothesis:
    """Fit the base parameters, from those of a fit near, and terms, from their values; dates are held fixed."""
    base = comparison.start if near is None else near.base
    begin = _linearize(
        comparison,
        np.concatenate([base, *(term.values for term in terms)]),
        tuple(terms),
        np.ones(len(comparison), dtype=bool) if use is None else use,
    )
    return gauss_newton(begin, rounds=12, close=1e-3, worse=1.0 + MISFIT_TOLERANCE) if len(begin.steps) else begin


def _linearize(
    comparison: ShortComparison, theta: Floats, terms: tuple[Effect, ...], used: NDArray[np.bool_]
) -> FittedHypothesis:
    count = len(comparison.start)
    places = parameter_slices(terms, count)

    def at(theta: Floats) -> tuple[Floats, tuple[Effect, ...]]:
        return theta[:count], tuple(term.at(theta[part]) for term, part in zip(terms, places, strict=True))

    residual, columns = comparison.difference(*at(theta)), np.zeros((len(comparison), len(theta)))
    now = FittedHypothesis(comparison, *at(theta), residual, columns, used)
    for j in np.flatnonzero(now.steps):
        probe = PROBE_STEP * now.steps[j]
        columns[:, j] = (residual - comparison.difference(*at(theta + probe * (np.arange(len(theta)) == j)))) / probe
    return now
