"""A fitted simulation, its whitened residual, and the design-matrix columns of the effects that are tested.

The residual is observed minus simulated heading, given the recorded heading; it is never regressed on the observed
heading, whose noise it shares. Compass coefficients and nuisance columns are projected out of every tested column: what
remains of an effect is its visible size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.deviation.branches import shows_branch
from compasslib.deviation.model import nearest_root
from compasslib.effects import Effect
from compasslib.effects.effect import parameter_slices
from compasslib.effects.forward import (
    MIN_HEADING_SLOPE,
    ForwardModel,
    added_term_jacobian,
    heading_jacobian,
    heading_slope,
    invert_heading,
    water_veer,
)
from compasslib.inference.comparison import LongComparison
from compasslib.statistics.least_squares import gauss_newton
from compasslib.statistics.whitening import (
    Whitener,
    clip_response,
    clip_standardized,
    fit_whitener,
    orthonormal_basis,
    project_out,
    robust_widths,
)
from compasslib.types import Floats

WIDTH_ROUNDS = 2  # iterations between widths and fit
FEWEST_SAMPLES = 50  # usable samples below which the residual is not tested
TINY = 1e-12  # least prior standard deviation, in any unit
BASE_RIDGE = 1e-4  # ridge of the base, relative to the mean square of its columns, for columns that hardly vary

REFIT_ROUNDS = 4  # maximum number of Gauss-Newton steps
MOST_HALVINGS = 4  # maximum number of times that the sizes of the initial terms are halved
CONVERGED_DEG = 0.02  # step length at convergence, approximately degrees
MISFIT_GROWTH = 1.5  # growth of the misfit at which a step is rejected
DAMPING = 1e-4  # ridge of unit-length whitened columns: tides sampled twice a day are nearly collinear with a constant


class TooFewSamples(ArithmeticError):
    """Raised if hardly any sample has a known branch of the simulated compass, or an informative direction."""


@dataclass(frozen=True)
class FittedModel:
    """A simulation with its whitened residual from a recording; n samples."""

    comparison: LongComparison
    simulation: ForwardModel
    nuisance: Floats  # (k,) coefficients of the nuisance columns
    heading_deg: Floats  # (n,) simulated correct heading given the recorded one, NaN without a root
    residual_deg: Floats  # (n,) observed minus simulated, degrees, NaN without a root
    base: Floats  # (n, b) columns of A..E, the terms unless freed, and the nuisances, degrees per unit
    whitener: Whitener
    basis: Floats  # (n, b) orthonormal basis of the whitened base
    standard: Floats  # (n,) clipped residual divided by its width
    shift: Floats  # (b,) coefficients of the base already subtracted from the residual, from a fit without filter
    innovation: Floats  # (n,) whitened residual with the base projected out
    sigma: float  # standard deviation of ``innovation``
    response: float  # share of a small shift that remains after clipping

    @property
    def base_ridge(self) -> Floats:
        """Prior precision of the columns of the base, scaled as the products of whitened columns, (b,)."""
        ridge, usual = np.zeros(self.base.shape[1]), self.comparison.usual
        for term, columns in zip(self.simulation.terms, parameter_slices(self.simulation.terms, 5), strict=True):
            kind = type(term)
            ridge[columns] = np.maximum(usual[kind], TINY) ** -2.0 if kind in usual else term.expected()
        return ridge * (self.sigma / self.response) ** 2

    def external_information(self) -> tuple[Floats, Floats]:
        """Collect the information (b, b) and score (b,) on the base's coefficients from other records."""
        information, score = np.zeros((self.base.shape[1],) * 2), np.zeros(self.base.shape[1])
        if self.comparison.prior is not None:
            information[:5, :5] = self.comparison.prior.precision
            score[:5] = self.comparison.prior.precision @ self.comparison.prior.mean
        for term, columns in zip(self.simulation.terms, parameter_slices(self.simulation.terms, 5), strict=True):
            if type(term) in self.comparison.shared:
                information[columns, columns], score[columns] = self.comparison.shared[type(term)]
        return information, score

    def whiten_and_project(self, columns_deg: Floats) -> Floats:
        """Whiten columns and project the base out, (n, k)."""
        return self.project_out_nuisance(self.whitener(np.nan_to_num(columns_deg, posinf=0.0, neginf=0.0)))

    def project_out_nuisance(self, white: Floats) -> Floats:
        """Project the base out of whitened columns, (n, k)."""
        return project_out(white, self.basis.astype(white.dtype))

    def visible(self, columns_deg: Floats, base: Floats | None = None) -> Floats:
        """Project the base out of columns weighted by the widths, not whitened; usable samples only, (m, k) degrees."""
        base, weight = self.base if base is None else base, 1.0 / self.whitener.width_deg
        columns = np.where(np.isfinite(columns_deg), columns_deg, 0.0)
        taken, *_ = np.linalg.lstsq(base * weight[:, None], columns * weight[:, None], rcond=1e-9)
        left = columns - base @ taken
        return left[np.isfinite(weight) & (weight > 0)]

    def step(self) -> tuple[Floats, float]:
        """Compute the Gauss-Newton step of all parameters from the clipped, whitened residual, and its length.

        The length is in about degrees; nuisances do not count.
        """
        white = self.whitener(self.base)
        scale = np.linalg.norm(white, axis=0)
        scale = np.where(scale > 0.0, scale, 1.0)
        # ``shift`` was already subtracted from the residual and is therefore added to the step.
        total = self.whitener.filtered(self.standard[:, None])[:, 0]
        unit, ridge = white / scale, self.base_ridge / scale**2
        count, values = len(self.simulation.parameters), np.zeros(len(scale))
        values[5:count] = self.simulation.parameters[5:]
        pull = unit.T @ total / self.response - ridge * (values + self.shift) * scale
        precision = np.diag(DAMPING + ridge)
        if self.comparison.prior is not None or self.comparison.shared:
            values[:5] = self.simulation.coefficients
            information, score = (x * (self.sigma / self.response) ** 2 for x in self.external_information())
            precision += information / np.outer(scale, scale)
            pull += (score - information @ (values + self.shift)) / scale
        step = np.linalg.solve(unit.T @ unit + precision, pull) / scale + self.shift
        return step, float(np.max(np.abs(step[:count]) / self.simulation.steps))

    def moved(self, step: Floats) -> FittedModel | None:
        """Take a step; None if too few samples are usable there."""
        count = len(self.simulation.parameters)
        simulation = self.simulation.at(self.simulation.parameters + step[:count])
        try:
            return evaluate_model(self.comparison, simulation, self.nuisance + step[count:])
        except TooFewSamples:
            return None

    def misfit(self, other: FittedModel) -> float:
        """Compute the ratio of another model's median absolute residual to this one's, both in widths of this one."""
        left = (np.abs(angles.wrap180(each.residual_deg)) for each in (other, self))
        theirs, own = (float(np.nanmedian(each / self.whitener.width_deg)) for each in left)
        return theirs / max(own, TINY)


def evaluate_model(
    comparison: LongComparison, simulation: ForwardModel, nuisance: Floats, *, freed_deg: Floats | None = None
) -> FittedModel:
    """Compute the residual of a simulation, whiten it and project the base out.

    Args:
        nuisance: coefficients of the nuisance columns, (k,).
        freed_deg: total effect of the terms, (n,) degrees, which is added back to the residual so that other terms can
            be tested in their place; if absent, the terms belong to the base.

    Raises:
        TooFewSamples: fewer than ``FEWEST_SAMPLES`` are usable.
    """
    heading, residual, width_floor = _residual(comparison, simulation, nuisance)
    if (usable := int(np.isfinite(residual).sum())) < FEWEST_SAMPLES:
        raise TooFewSamples(f"{usable} of {len(comparison)} samples show on which branch of the compass they are")
    derivative = np.nan_to_num(heading_jacobian(simulation, comparison.scene, heading))
    base = np.column_stack([derivative[:, : None if freed_deg is None else 5], comparison.nuisance])
    left, width, shift = residual, np.full(len(comparison), np.inf), np.zeros(base.shape[1])
    for _ in range(WIDTH_ROUNDS):
        width = np.hypot(robust_widths(left, comparison.slowness), width_floor)
        if (usable := int(np.isfinite(width).sum())) < FEWEST_SAMPLES:
            raise TooFewSamples(f"{usable} of {len(comparison)} samples show a direction")
        weighted = np.where(np.isfinite(width)[:, None], base, 0.0) / width[:, None]
        gram = weighted.T @ weighted
        ridge = BASE_RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        step = np.linalg.solve(gram + ridge, weighted.T @ clip_standardized(left, width))
        left, shift = left - base @ step, shift + step
    white = replace(fit_whitener(left, width, comparison.scene.time_s), low_rank=comparison.low_rank)
    basis = orthonormal_basis(white(base))
    standard = clip_standardized(left, width)
    innovation = white.filtered(standard[:, None])[:, 0]
    response = clip_response(left, width)
    projected = innovation - basis @ (basis.T @ innovation)
    counts = np.isfinite(width)
    sigma = float(np.sqrt(projected @ projected / max(counts.sum() - basis.shape[1], 1)))
    if freed_deg is not None:  # added after clipping and filtering, which are those of the residual without the effect
        innovation = innovation + response * white(freed_deg[:, None])[:, 0]
    innovation = innovation - basis @ (basis.T @ innovation)
    return FittedModel(
        comparison=comparison, simulation=simulation, nuisance=nuisance, heading_deg=heading, residual_deg=left,
        base=base, whitener=white, basis=basis, standard=standard, shift=shift, innovation=innovation, sigma=sigma,
        response=response,
    )  # fmt: skip


def count_usable(comparison: LongComparison, simulation: ForwardModel, nuisance: Floats) -> int:
    """Count the samples for which the branch of the simulated compass is known."""
    return int(np.isfinite(_residual(comparison, simulation, nuisance)[1]).sum())


def _residual(comparison: LongComparison, simulation: ForwardModel, nuisance: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute simulated heading, residual, and the heading error due to compass noise, (n,) degrees each."""
    shown = comparison.observed_deg - water_veer(simulation, comparison.scene) - comparison.nuisance @ nuisance
    roots = invert_heading(simulation, comparison.scene, comparison.recorded_deg)
    heading = nearest_root(roots, shown)
    slope = np.maximum(np.abs(heading_slope(simulation, comparison.scene, heading)), MIN_HEADING_SLOPE)
    # Where both branches of a two-valued compass are close, taking the one nearer to a noisy direction is biased.
    heading = np.where(shows_branch(roots, comparison.expected_deg), heading, np.nan)
    return heading, angles.difference(shown, heading), comparison.precision_deg / slope


def term_columns(fitted: FittedModel, term: Effect) -> Floats:
    """Compute the columns of one term added to a simulation, (n, k) degrees per unit."""
    columns = added_term_jacobian(fitted.simulation, fitted.comparison.scene, fitted.heading_deg, term)
    return np.where(np.isfinite(columns), columns, 0.0)


def refit(fitted: FittedModel, terms: Sequence[Effect]) -> FittedModel:
    """Fit terms, compass and nuisances together by Gauss-Newton steps, from sizes that leave enough samples usable.

    Raises:
        TooFewSamples: too few are usable even at the smallest sizes tried.
    """
    for halvings in range(MOST_HALVINGS + 1):
        try:
            begin = evaluate_model(fitted.comparison, replace(fitted.simulation, terms=tuple(terms)), fitted.nuisance)
            break
        except TooFewSamples:
            if halvings == MOST_HALVINGS:
                raise
            terms = [term.at(term.values / 2.0) for term in terms]
    return gauss_newton(begin, rounds=REFIT_ROUNDS, close=CONVERGED_DEG, worse=MISFIT_GROWTH)


def visible_size_deg(fitted: FittedModel, k: int, covariance: Floats) -> float:
    """Compute the visible size of a fitted term, rms degrees, with the bias by its uncertainty subtracted."""
    columns = fitted.base[:, parameter_slices(fitted.simulation.terms, 5)[k]]
    others = np.column_stack([fitted.base[:, :5], fitted.base[:, len(fitted.simulation.parameters) :]])
    visible, values = fitted.visible(columns, others), fitted.simulation.terms[k].values
    product = visible.T @ visible / len(visible)
    return float(np.sqrt(max(float(values @ product @ values) - float(np.sum(product * covariance)), 0.0)))


def freed_model(fitted: FittedModel) -> tuple[FittedModel, FittedModel]:
    """Add the terms' effect back to the residual, without slow noise, and build the midpoint model for slopes."""
    without_slow, terms = replace(fitted.comparison, low_rank=None), fitted.simulation.terms
    # At the midpoint the slopes approximate the chord from no effect to the full effect; those at the full effect
    # would put alternatives to it at a disadvantage.
    simulation = replace(fitted.simulation, terms=tuple(term.at(term.values / 2.0) for term in terms))
    roots = invert_heading(simulation, without_slow.scene, without_slow.recorded_deg)
    midpoint = replace(fitted, simulation=simulation, heading_deg=nearest_root(roots, fitted.heading_deg))
    slopes = heading_jacobian(midpoint.simulation, without_slow.scene, midpoint.heading_deg, first=5)
    effect = np.nan_to_num(slopes) @ fitted.simulation.parameters[5:]
    return evaluate_model(without_slow, fitted.simulation, fitted.nuisance, freed_deg=effect), midpoint
