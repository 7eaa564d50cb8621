"""A fitted simulation, its whitened residual, and the columns of effects that are tested on it.

The residual is observed minus simulated heading at the recorded one; it is never regressed on the observed heading,
whose noise it shares. The compass's coefficients and the nuisances are projected out of everything that is tested:
what remains of an effect after their refit is its visible size.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
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
from compasslib.statistics.least_squares import HUBER_CLIP, gauss_newton
from compasslib.statistics.whitening import (
    Whitener,
    clip_response,
    clip_standardized,
    fit_whitener,
    orthonormal_basis,
    project_out,
    robust_widths,
    scaled_inverse,
    trend_spacing_s,
)
from compasslib.types import Floats

WIDTH_ROUNDS = 2  # of widths and fit
FEWEST_SAMPLES = 50  # samples that show where they are, below which there is nothing to examine
TINY = 1e-12  # of any unit: a parameter of which nothing is expected
BASE_RIDGE = 1e-4  # prior precision of a baseline column in whitened units, against columns that hardly vary

DATE_STEP_S, DATE_MARGIN = 10 * 86400.0, 0.04  # dates of steps that are tried, and how near to the ends

REFIT_ROUNDS = 4  # of refitting, at most
MOST_HALVINGS = 4  # times that the sizes of terms are halved before a compass is given up
CONVERGED_DEG = 0.02  # degrees, roughly, of a step that is the last
MISFIT_GROWTH = 1.5  # growth of the residual at which a step is not taken
DAMPING = 1e-4  # of whitened columns of length one: waves of the tides, sampled twice a day, stand for a constant too
DATE_REACH_S, DATE_SPACING_S = 12 * 86400.0, 86400.0  # reach and spacing of the finer search of a date


class TooFewSamples(ArithmeticError):
    """Hardly any sample shows on which branch of the simulated compass it is, or any direction at all."""


@dataclass(frozen=True)
class FittedModel:
    """A simulation held against a recording, everything else refitted; n samples."""

    case: LongComparison
    simulation: ForwardModel
    nuisance: Floats  # (k,) values of the nuisances
    heading_deg: Floats  # (n,) simulated correct heading at the recorded one, NaN without a root
    residual_deg: Floats  # (n,) observed minus simulated, degrees, NaN without a root
    base: Floats  # (n, b) columns of A..E, of the terms unless freed, and of the nuisances, degrees a unit
    whitener: Whitener
    basis: Floats  # (n, b) orthonormal, of the whitened base
    standard: Floats  # (n,) clipped residual over its width
    shift: Floats  # (b,) of the base's values that the residual was freed of, by the widths alone
    innovation: Floats  # (n,) whitened residual, the base projected out
    sigma: float  # its standard deviation
    response: float  # share of a small shift that survives the clip

    def ridge(self, terms: Iterable[type[Effect] | Effect]) -> Floats:
        """Compute the prior precision of terms' parameters, in units of products of whitened columns, (k,)."""
        usual = self.case.usual
        each: list[Floats] = [np.zeros(0)]
        for term in terms:
            kind = term if isinstance(term, type) else type(term)
            each.append(np.maximum(usual[kind], TINY) ** -2.0 if kind in usual else term.expected())
        return np.concatenate(each) * (self.sigma / self.response) ** 2

    @property
    def base_ridge(self) -> Floats:
        """The same of the base's columns, (b,)."""
        ridge = np.zeros(self.base.shape[1])
        terms = self.ridge(self.simulation.terms)
        ridge[5 : 5 + len(terms)] = terms
        return ridge

    def external_information(self) -> tuple[Floats, Floats]:
        """Collect what other records tell of the base's columns: information (b, b) and score (b,)."""
        information, score = np.zeros((self.base.shape[1],) * 2), np.zeros(self.base.shape[1])
        if self.case.prior is not None:
            information[:5, :5] = self.case.prior.precision
            score[:5] = self.case.prior.precision @ self.case.prior.mean
        for term, columns in zip(self.simulation.terms, parameter_slices(self.simulation.terms, 5), strict=True):
            if type(term) in self.case.shared:
                information[columns, columns], score[columns] = self.case.shared[type(term)]
        return information, score

    def whiten_and_project(self, columns_deg: Floats) -> Floats:
        """Whiten columns and project the base out, (n, k)."""
        return self.project_out_nuisance(self.whitener(np.nan_to_num(columns_deg, posinf=0.0, neginf=0.0)))

    def project_out_nuisance(self, white: Floats) -> Floats:
        """Project the base out of whitened columns, (n, k)."""
        return project_out(white, self.basis.astype(white.dtype))

    def visible(self, columns_deg: Floats) -> Floats:
        """Subtract from columns what the base can take, by the widths, not whitened, (n, k) degrees."""
        weight = 1.0 / self.whitener.width_deg
        columns = np.where(np.isfinite(columns_deg), columns_deg, 0.0)
        taken, *_ = np.linalg.lstsq(self.base * weight[:, None], columns * weight[:, None], rcond=1e-9)
        left = columns - self.base @ taken
        return left[np.isfinite(weight) & (weight > 0)]


def evaluate_model(
    case: LongComparison, simulation: ForwardModel, nuisance: Floats, *, freed_deg: Floats | None = None
) -> FittedModel:
    """Compute the residual of a simulation, whiten it and project the base out.

    Args:
        nuisance: values of the nuisances, (k,).
        freed_deg: the terms' effects, (n,), which are then given back to the residual, so that other terms can be tried
            in their place; else the terms belong to the base.

    Raises:
        TooFewSamples: too few samples are left to be examined.
    """
    heading, residual, width_floor = _residual(case, simulation, nuisance)
    if (usable := int(np.isfinite(residual).sum())) < FEWEST_SAMPLES:
        raise TooFewSamples(f"{usable} of {len(case)} samples show on which branch of the compass they are")
    derivative = np.nan_to_num(heading_jacobian(simulation, case.scene, heading))
    base = np.column_stack([derivative[:, : None if freed_deg is None else 5], case.nuisance])
    left, width, shift = residual, np.full(len(case), np.inf), np.zeros(base.shape[1])
    for _ in range(WIDTH_ROUNDS):
        width = np.hypot(robust_widths(left, case.slowness), width_floor)
        if (usable := int(np.isfinite(width).sum())) < FEWEST_SAMPLES:
            raise TooFewSamples(f"{usable} of {len(case)} samples show a direction")
        weighted = np.where(np.isfinite(width)[:, None], base, 0.0) / width[:, None]
        gram = weighted.T @ weighted
        ridge = BASE_RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
        step = np.linalg.solve(gram + ridge, weighted.T @ clip_standardized(left, width))
        left, shift = left - base @ step, shift + step
    white = replace(fit_whitener(left, width, case.scene.time_s), low_rank=case.low_rank)
    basis = orthonormal_basis(white(base))
    standard = clip_standardized(left, width)
    innovation = white.filtered(standard[:, None])[:, 0]
    response = clip_response(left, width)
    projected = innovation - basis @ (basis.T @ innovation)
    counts = np.isfinite(width)
    sigma = float(np.sqrt(projected @ projected / max(counts.sum() - basis.shape[1], 1)))
    if freed_deg is not None:  # the clip and the filter are those of what is left, not of the effect
        innovation = innovation + response * white(freed_deg[:, None])[:, 0]
    innovation = innovation - basis @ (basis.T @ innovation)
    return FittedModel(
        case=case, simulation=simulation, nuisance=nuisance, heading_deg=heading, residual_deg=left, base=base,
        whitener=white, basis=basis, standard=standard, shift=shift, innovation=innovation, sigma=sigma,
        response=response,
    )  # fmt: skip


def midpoint_linearization(state: FittedModel) -> FittedModel:
    """Halve the terms of a model for columns only; nothing is refitted there.

    There the slopes are those of the chord from none to all of an effect; where it stands whole they are not, and what
    would do as well in its place looks worse than it is.
    """
    terms = tuple(term.at(term.values / 2.0) for term in state.simulation.terms)
    simulation = replace(state.simulation, terms=terms)
    roots = invert_heading(simulation, state.case.scene, state.case.recorded_deg)
    return replace(state, simulation=simulation, heading_deg=nearest_root(roots, state.heading_deg))


def count_usable(case: LongComparison, simulation: ForwardModel, nuisance: Floats) -> int:
    """Count the samples whose branch of a simulation's compass is known."""
    return int(np.isfinite(_residual(case, simulation, nuisance)[1]).sum())


def _residual(case: LongComparison, simulation: ForwardModel, nuisance: Floats) -> tuple[Floats, Floats, Floats]:
    """Compute simulated heading, residual, and its noise from the compass itself, (n,) each."""
    shown = case.observed_deg - water_veer(simulation, case.scene) - case.nuisance @ nuisance
    roots = invert_heading(simulation, case.scene, case.recorded_deg)
    heading = nearest_root(roots, shown)
    slope = np.maximum(np.abs(heading_slope(simulation, case.scene, heading)), MIN_HEADING_SLOPE)
    # Where a folded compass leaves two headings close together, the nearer one to a noisy direction is no residual.
    heading = np.where(shows_branch(roots, case.expected_deg), heading, np.nan)
    return heading, angles.difference(shown, heading), case.precision_deg / slope


def slow_hats(time_s: Floats) -> Floats:
    """Build hat functions of time that follow what changes over weeks, (n, k)."""
    knots = np.linspace(time_s[0], time_s[-1], max(int(np.ptp(time_s) / trend_spacing_s(time_s)), 1) + 1)
    return np.column_stack([np.interp(time_s, knots, row) for row in np.eye(len(knots))])


@dataclass(frozen=True)
class ColumnGroup:
    """Columns that are tested together, (n, k) degrees a unit."""

    name: str  # effect, or covariates joined by x
    columns: Floats
    term: Effect | None = None  # at zero size, its date set
    covariates: tuple[str, ...] = ()


@dataclass(frozen=True)
class Products:
    """Products of the candidates' columns beside slow water."""

    information: Floats  #: (p, p) of the columns with each other
    score: Floats  #: (p,) products with the residual
    log_likelihood: float  #: of the water alone, over that of white noise


def term_columns(state: FittedModel, term: Effect) -> ColumnGroup:
    """Build the columns of one term beside a simulation."""
    return ColumnGroup(term.name, _term_derivative(state, term), term)


def step_columns(state: FittedModel, kind: type[Effect], dates_s: Floats) -> list[ColumnGroup]:
    """Build the columns of a term that begins at each of some dates."""
    always = _term_derivative(state, kind())
    since = state.case.scene.since
    return [ColumnGroup(kind.name, always * since(d)[:, None], replace(kind(), date_s=float(d))) for d in dates_s]  # type: ignore[call-arg]


def step_dates(time_s: Floats) -> Floats:
    """List the dates at which steps are tried, (m,)."""
    first, last = np.quantile(time_s, [DATE_MARGIN, 1.0 - DATE_MARGIN])
    return np.arange(first, last, max(DATE_STEP_S, (last - first) / 60.0))


def _term_derivative(state: FittedModel, term: Effect) -> Floats:
    columns = added_term_jacobian(state.simulation, state.case.scene, state.heading_deg, term)
    return np.where(np.isfinite(columns), columns, 0.0)


@dataclass(frozen=True)
class Estimate:
    """The refit's solution."""

    state: FittedModel
    covariance: Floats  # (b, b) of A..E, the terms' parameters and the nuisances

    @property
    def term_covariances(self) -> list[Floats]:
        """Covariance of each term's own parameters."""
        return [self.covariance[columns, columns] for columns in parameter_slices(self.state.simulation.terms, 5)]


def refit(state: FittedModel, terms: Sequence[Effect]) -> FittedModel:
    """Fit terms, compass and nuisances together by Gauss-Newton steps."""
    begin = _RefitState(_initialize(state, terms))
    return gauss_newton(begin, rounds=REFIT_ROUNDS, close=CONVERGED_DEG, worse=MISFIT_GROWTH).state


@dataclass(frozen=True)
class _RefitState:
    """A state as a point of a fit."""

    state: FittedModel

    def step(self) -> tuple[Floats, float]:
        """Solve for the step of all parameters; nuisances do not count for its length."""
        step, simulation = _least_squares_step(self.state), self.state.simulation
        return step, float(np.max(np.abs(step[: len(simulation.parameters)]) / simulation.steps))

    def moved(self, step: Floats) -> _RefitState | None:
        """Take a step; None where there is no such compass."""
        state, count = self.state, len(self.state.simulation.parameters)
        simulation = state.simulation.at(state.simulation.parameters + step[:count])
        try:
            return _RefitState(evaluate_model(state.case, simulation, state.nuisance + step[count:]))
        except TooFewSamples:
            return None

    def misfit(self, other: _RefitState) -> float:
        """Compare another model's median residual with this one's, by the widths of this."""
        return _median_misfit(other.state, self.state) / max(_median_misfit(self.state, self.state), TINY)


def _initialize(state: FittedModel, terms: Sequence[Effect]) -> FittedModel:
    """Evaluate the model with terms, halved in size until there is such a compass.

    Raises:
        TooFewSamples: there is none however small they are.
    """
    for _ in range(MOST_HALVINGS):
        try:
            return evaluate_model(state.case, replace(state.simulation, terms=tuple(terms)), state.nuisance)
        except TooFewSamples:
            terms = [term.at(term.values / 2.0) for term in terms]
    return evaluate_model(state.case, replace(state.simulation, terms=tuple(terms)), state.nuisance)


def _median_misfit(state: FittedModel, common: FittedModel) -> float:
    return float(np.nanmedian(np.abs(angles.wrap180(state.residual_deg)) / common.whitener.width_deg))


def refine_dates(state: FittedModel) -> FittedModel:
    """Search the dates of the terms on a finer grid and refit."""
    terms = list(state.simulation.terms)
    if not any(term.dated() for term in terms):
        return state
    for k, term in enumerate(terms):
        if not term.dated():
            continue
        others = [t for j, t in enumerate(terms) if j != k]
        free = refit(state, others)
        near = np.arange(term.date - DATE_REACH_S, term.date + DATE_REACH_S, DATE_SPACING_S)
        candidates = step_columns(free, type(term), near)
        best = candidates[int(np.argmax(score_gains(free, candidates)))].term
        assert best is not None
        terms[k] = best.at(term.values)
    return refit(state, terms)


def score_gains(state: FittedModel, groups: Sequence[ColumnGroup]) -> Floats:
    """Compute the drop of the whitened residual's square by each group of columns, (g,)."""
    white = state.whiten_and_project(np.concatenate([group.columns for group in groups], axis=1))
    parts = np.split(white, np.cumsum([group.columns.shape[1] for group in groups])[:-1], axis=1)
    pulls = [part.T @ state.innovation for part in parts]
    return np.array([x @ scaled_inverse(part.T @ part) @ x for part, x in zip(parts, pulls, strict=True)])


def visible_columns(state: FittedModel, k: int) -> Floats:
    """Project compass and nuisances out of a fitted term's columns, (n, k) degrees a unit."""
    columns = state.base[:, parameter_slices(state.simulation.terms, 5)[k]]
    others = np.column_stack([state.base[:, :5], state.base[:, len(state.simulation.parameters) :]])
    weight = 1.0 / state.whitener.width_deg
    taken, *_ = np.linalg.lstsq(others * weight[:, None], columns * weight[:, None], rcond=1e-9)
    return np.asarray(columns - others @ taken)


def visible_size_deg(state: FittedModel, k: int, covariance: Floats) -> float:
    """Compute the visible size of a fitted term, rms degrees, its own uncertainty taken off."""
    values, columns = state.simulation.terms[k].values, visible_columns(state, k)[np.isfinite(state.whitener.width_deg)]
    product = columns.T @ columns / len(columns)
    return float(np.sqrt(max(float(values @ product @ values) - float(np.sum(product * covariance)), 0.0)))


def log_likelihood_gain(before: FittedModel, after: FittedModel) -> float:
    """Compute the log likelihood that one hypothesis gains on another, each where it stands.

    It is followed along the straight way from one to the other, by the mean of the clipped and whitened residuals at
    its ends: squares of clipped residuals alone do not see by how much a direction far off moves. What the base of
    either could still take is no gain. A sample without a root counts in full.

    Args:
        before: the hypothesis that gives widths and filter.
    """
    whitener = before.whitener
    lost, width = ~np.isfinite(after.residual_deg), whitener.width_deg
    first, second = (clip_standardized(np.nan_to_num(x.residual_deg), width) for x in (before, after))
    second = np.where(lost, np.minimum(HUBER_CLIP, 90.0 / width), second)
    moved = angles.difference(np.nan_to_num(before.residual_deg), np.nan_to_num(after.residual_deg)) / width
    ends = []
    for state, standard in ((before, first), (after, second)):
        white, basis = whitener.filtered(standard[:, None])[:, 0], orthonormal_basis(whitener(state.base))
        ends.append(np.asarray(white - basis @ (basis.T @ white)))
    way = whitener.filtered(np.where(lost, first - second, moved)[:, None])[:, 0]
    return float(sum(ends) @ way) * before.response / before.sigma**2 / 2.0


def _least_squares_step(state: FittedModel) -> Floats:
    """Solve for the step of all parameters from the whitened, clipped residual."""
    white = state.whitener(state.base)
    scale = np.linalg.norm(white, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    # The residual of the state has the base taken out already: put the step back that did so.
    total = state.whitener.filtered(state.standard[:, None])[:, 0]
    unit, ridge = white / scale, state.base_ridge / scale**2
    values = np.zeros(len(scale))
    values[5 : len(state.simulation.parameters)] = state.simulation.parameters[5:]
    pull = unit.T @ total / state.response - ridge * (values + state.shift) * scale
    precision = np.diag(DAMPING + ridge)
    if state.case.prior is not None or state.case.shared:
        values[:5] = state.simulation.coefficients
        information, score = (x * (state.sigma / state.response) ** 2 for x in state.external_information())
        precision += information / np.outer(scale, scale)
        pull += (score - information @ (values + state.shift)) / scale
    step = np.linalg.solve(unit.T @ unit + precision, pull)
    return np.asarray(step / scale + state.shift)


def freed_model(state: FittedModel) -> tuple[FittedModel, FittedModel]:
    """Give the terms back to the residual, without slow water, and build a state for slopes half way."""
    quiet, half = replace(state.case, low_rank=None), midpoint_linearization(state)
    slopes = heading_jacobian(half.simulation, quiet.scene, half.heading_deg, first=5)
    effect = np.nan_to_num(slopes) @ state.simulation.parameters[5:]
    return evaluate_model(quiet, state.simulation, state.nuisance, freed_deg=effect), half
