"""Compute the evidence of refitted hypotheses of a short recording, and list candidate places and dates of terms.

The noise is ARMA(1, 1), i.e. white noise plus a slow wander. The residual is filtered by each noise model, the base is
free, and the parameters of terms have a heavy-tailed prior of typical size (Laplace's approximation; Bishop, Pattern
Recognition and Machine Learning, 2006, section 4.4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from compasslib.effects.composed import bump
from compasslib.effects.effect import USUAL_DEG, Effect, Scene, parameter, place_parameter
from compasslib.inference import finding, short_fit
from compasslib.inference.short_fit import FittedHypothesis, ShortComparison
from compasslib.statistics.noise import PHI, THETA, arma_innovations, arma_variance_ratio
from compasslib.statistics.resampling import EVEN_BLOCKS, cluster_variance_inflation
from compasslib.statistics.whitening import orthonormal_basis, project_out
from compasslib.types import Floats

Law = tuple[float, float]  # autoregressive and moving-average coefficient

LAWS: tuple[Law, ...] = tuple((float(p), float(t)) for p in PHI for t in THETA if t >= -p)
WHITE: tuple[Law, ...] = ((0.0, 0.0),)
STEADY, TINY = 1e-6, 1e-20  # ridge that stabilizes an inverse; least sum of squares of a column

STEP_DATES, STEP_MARGIN = 150, 0.06  # candidate dates of a step; their margin as a share of the record
FINER_DATES = 24  # candidate dates in the refinement around the best
SPELL_EDGES, FINER_EDGES = (40, 120), 9  # edges of a temporary offset in a long and a short recording; around the best
SHORT_RECORDING = 250  # fewest samples of a long recording

SECTORS, REACHES_DEG = 36, (15.0, 25.0, 40.0)  # candidate centres of a sector offset, and its half widths
FINER_SECTORS_DEG = (-8.0, -4.0, 0.0, 4.0, 8.0)  # in the refinement, relative to the best sector
FEWEST_AFFECTED = 3  # fewest samples affected by either local offset


@dataclass(frozen=True)
class ShortEvidence:
    """Misfit of one hypothesis under each noise model, and the information on its parameters."""

    squares: Floats  # (laws,) sum of squares of the filtered residual
    information: Floats  # (p, p) of the terms' parameters in units of prior scales, best noise model
    size: float  # mean square of their values in those units


def laws(channel: ShortComparison) -> tuple[Law, ...]:
    """List the candidate noise models of a short recording."""
    return WHITE if channel.independent else LAWS


def log_evidence(channel: ShortComparison, evidences: Sequence[ShortEvidence], uneven: float) -> Floats:
    """Compute the log evidence of hypotheses, up to a constant of the recording, (h,).

    Args:
        uneven: inflation of the score variance of slow or local columns over homogeneous noise, by which the excess
            misfit of a hypothesis over the best one is divided.
    """
    squares = np.array([evidence.squares for evidence in evidences])
    least = squares.min(axis=0)
    first = np.array([arma_variance_ratio(law) for law in laws(channel)])
    fit = -0.5 * _degrees_of_freedom(channel) * (
        np.log(least) + np.log1p((squares / least - 1.0) / uneven)
    ) - 0.5 * np.log(first)
    # Occam factor of the parameters, with a heavy-tailed prior.
    cost = []
    for evidence in evidences:
        p = len(evidence.information)
        determinant = np.linalg.slogdet(np.eye(p) + evidence.information / uneven)[1]
        cost.append(0.5 * float(determinant) + 0.5 * (p + 1) * float(np.log1p(evidence.size)) if p else 0.0)
    return np.logaddexp.reduce(fit, axis=1) - np.array(cost)


def short_evidence(fitted: FittedHypothesis) -> ShortEvidence:
    """Compute the evidence of a refitted hypothesis."""
    fits = [_filtered_fit(fitted, law) for law in laws(fitted.channel)]
    squares = np.array([fit[0] for fit in fits])
    usual = prior_sizes(fitted)
    values = np.concatenate([np.zeros(0), *(term.values for term in fitted.terms)]) / usual
    information = fits[int(np.argmin(squares))][1] * np.outer(usual, usual)
    return ShortEvidence(squares, information, float(np.mean(values**2)) if len(values) else 0.0)


def likeliest_law(channel: ShortComparison, evidence: ShortEvidence) -> Law:
    """Choose the noise model under which the residual of a hypothesis is likeliest."""
    first = np.array([arma_variance_ratio(law) for law in laws(channel)])
    return laws(channel)[int(np.argmin(_degrees_of_freedom(channel) * np.log(evidence.squares) + np.log(first)))]


def prior_sizes(fitted: FittedHypothesis) -> Floats:
    """Compute the prior scale of each parameter of the terms, (p,): from physics, or a turn by ``USUAL_DEG``."""
    columns = fitted.columns[:, len(fitted.base) :]
    turn = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    with np.errstate(divide="ignore"):
        physical = np.concatenate([np.zeros(0), *(term.expected() for term in fitted.terms)]) ** -0.5
    return np.where(np.isfinite(physical), physical, USUAL_DEG / turn)


def likelihood_gains(fitted: FittedHypothesis, law: Law, columns: Floats) -> Floats:
    """Compute the log-likelihood gain of adding a term to a hypothesis at each of its places, (g,).

    Args:
        columns: derivatives by the term's parameters at each place, (n, g, p), degrees per unit.
    """
    n, places, count = columns.shape
    base = orthonormal_basis(arma_innovations(fitted.columns, law))
    left = project_out(arma_innovations(fitted.clipped[:, None], law)[:, 0], base)
    white = project_out(arma_innovations(columns.reshape(n, -1), law), base).reshape(n, places, count)
    total = max(float(left @ left) + _huber_excess(fitted) / arma_variance_ratio(law), _least_square(fitted.channel))
    length = np.sqrt(np.maximum(np.einsum("ngp,ngp->gp", white, white), TINY))
    pull = np.einsum("ngp,n->gp", white, left) / length
    alike = np.einsum("ngp,ngq->gpq", white, white) / (length[:, :, None] * length[:, None, :])
    solved = np.linalg.solve(alike + STEADY * np.eye(count), pull[:, :, None])[:, :, 0]
    taken = np.minimum(np.sum(pull * solved, axis=1) / total, 1.0 - 1e-9)
    return np.asarray(-0.5 * _degrees_of_freedom(fitted.channel) * np.log1p(-taken))


def cluster_inflation(fitted: FittedHypothesis, law: Law, groups: list[Floats]) -> float:
    """Compute the median inflation of the score variance of columns by blocks over homogeneous noise, at least 1.

    The systematic error ``rule_deg`` is added as noise that does not average out.
    """
    channel = fitted.channel
    if channel.independent or not groups:
        return 1.0
    base = orthonormal_basis(arma_innovations(fitted.columns, law))
    left = project_out(arma_innovations(fitted.clipped[:, None], law)[:, 0], base)
    variance = max(float(left @ left), _least_square(channel)) / _degrees_of_freedom(channel)
    block, ratios = short_fit.memory_blocks(fitted), []
    for group in groups:
        white = orthonormal_basis(project_out(arma_innovations(group, law), base))
        if white.shape[1]:
            ratio, count = cluster_variance_inflation(white, left, block, variance)
            ratios.append((count * ratio + EVEN_BLOCKS) / (count + EVEN_BLOCKS))
    constant = arma_innovations(np.ones((len(channel), 1)), law)
    middle = float(np.quantile(ratios, 0.5)) if ratios else 1.0
    return max(middle, 1.0) + channel.rule_deg**2 * float(np.sum(constant**2)) / variance


def _filtered_fit(fitted: FittedHypothesis, law: Law) -> tuple[float, Floats]:
    """Compute the sum of squares under one noise model, and the terms' information with the base projected out."""
    count = len(fitted.base)
    white = arma_innovations(np.column_stack([fitted.columns, fitted.clipped]), law)
    free = orthonormal_basis(white[:, :count])
    left, term_columns = (project_out(part, free) for part in (white[:, -1], white[:, count:-1]))
    square = max(float(left @ left) + _huber_excess(fitted) / arma_variance_ratio(law), _least_square(fitted.channel))
    return square, term_columns.T @ term_columns / (square / _degrees_of_freedom(fitted.channel))


def _huber_excess(fitted: FittedHypothesis) -> float:
    """Compute the excess of Huber's loss over the clipped squares: clipping alone would ignore temporary offsets."""
    clip = finding.MOST_WIDTHS * fitted.scale_deg
    beyond = np.maximum(np.abs(fitted.residual_deg) - clip, 0.0) * (not fitted.channel.independent)
    return float(2.0 * clip * np.sum(beyond))


def _degrees_of_freedom(channel: ShortComparison) -> float:
    return float(max(len(channel) - int(np.count_nonzero(channel.steps)), 1))


def _least_square(channel: ShortComparison) -> float:
    return len(channel) * short_fit.FINEST_DEG**2


@dataclass(frozen=True)
class LocalOffset(Effect):
    """A constant offset of the reading in a limited range, without a physical cause."""

    stage: ClassVar = "readout"
    acts_on: ClassVar = "reading"
    literature: ClassVar[str] = "none: what no term of the catalogue is and some of them imitate"
    along: ClassVar[tuple[str, ...]]  # covariates, one of which is required

    offset_deg: float = parameter("degrees", "recorded minus what the compass would have recorded", 1.0)

    @classmethod
    def fits(cls, channel: ShortComparison) -> bool:
        """Return whether a comparison has a compass reading and one of the covariates."""
        return channel.reads and any(name in channel.covariates for name in cls.along)

    def invert(self, reading_deg: Floats, scene: Scene) -> Floats:
        """Return the reading without the error, which is evaluated at the reading itself."""
        return 2.0 * reading_deg - self.apply(reading_deg, scene)


@dataclass(frozen=True)
class SectorOffset(LocalOffset):
    """Offset of the reading in a sector of headings: a compass card that is pulled or sticks."""

    name: ClassVar[str] = "composed:reading/heading/bump"
    along: ClassVar[tuple[str, ...]] = ("heading",)

    centre_deg: float = place_parameter("degrees")
    reach_deg: float = place_parameter("degrees")

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the error."""
        return x + self.offset_deg * self.share(x)

    def share(self, x: Floats) -> Floats:
        """Compute the share of the error that acts, (n,) 0 to 1."""
        return bump(x, self.centre_deg, self.reach_deg)


@dataclass(frozen=True)
class SpellOffset(LocalOffset):
    """Temporary offset of the reading: no known physical effect comes and goes by the same amount."""

    name: ClassVar[str] = "composed:reading/time/box"
    along: ClassVar[tuple[str, ...]] = ("time", "reading")

    begin_s: float = place_parameter("s")
    end_s: float = place_parameter("s")

    def apply(self, x: Floats, scene: Scene) -> Floats:
        """Return the reading with the error."""
        return x + self.offset_deg * self.share(scene.time_s)

    def share(self, x: Floats) -> Floats:
        """Compute the share of the error that acts, (n,) 0 to 1."""
        return ((x >= self.begin_s) & (x < self.end_s)).astype(float)


LOCAL_OFFSETS = (SectorOffset, SpellOffset)


def candidate_places(fitted: FittedHypothesis, kind: type[Effect], near: Effect | None = None) -> list[Effect]:
    """List the terms of one kind, at zero size, at all candidate places or dates; one term where there are none.

    Args:
        fitted: hypothesis to which the term is added.
        near: the term at its best place so far, around which places are then refined.
    """
    channel = fitted.channel
    if kind is SectorOffset:
        if isinstance(near, SectorOffset):
            made = [kind(0.0, near.centre_deg + away, near.reach_deg) for away in FINER_SECTORS_DEG]
        else:
            made = [kind(0.0, 360.0 / SECTORS * k, reach) for k in range(SECTORS) for reach in REACHES_DEG]
        return [term for term in made if np.count_nonzero(term.share(channel.covariates["heading"])) >= FEWEST_AFFECTED]
    if kind is SpellOffset:
        return [kind(0.0, begin, end) for begin, end in _spell_places(channel, near)]
    if kind.dated():
        return [_at_place(near or kind(), date_s=date) for date in _date_places(channel, near)]
    return [kind()] if near is None else []


def place_columns(fitted: FittedHypothesis, terms: Sequence[Effect]) -> Floats:
    """Differentiate the simulated heading by the parameters of a term at each of its places, (n, g, p)."""
    channel, first = fitted.channel, terms[0]
    if isinstance(first, LOCAL_OFFSETS):
        always = short_fit.term_derivative(fitted, SpellOffset(0.0, -np.inf, np.inf))
        x = channel.time_s if isinstance(first, SpellOffset) else channel.covariates["heading"]
        acting = np.stack([term.share(x) for term in terms if isinstance(term, LOCAL_OFFSETS)], axis=1)
    elif first.dated():
        always = short_fit.term_derivative(fitted, _at_place(first, date_s=-np.inf))
        acting = (channel.time_s[:, None] >= np.array([term.date for term in terms])).astype(float)
    else:
        always, acting = short_fit.term_derivative(fitted, first), np.ones((len(channel), 1))
    return always[:, None, :] * acting[:, :, None]


def _at_place(term: Effect, **places_: Any) -> Effect:
    return replace(term, **places_)


def _spell_places(channel: ShortComparison, near: Effect | None) -> list[tuple[float, float]]:
    n = len(channel)
    most = SPELL_EDGES[n < SHORT_RECORDING]
    if isinstance(near, SpellOffset):
        reach = -(-n // most)
        middle = [int(np.searchsorted(channel.time_s, edge)) for edge in (near.begin_s, near.end_s)]
        edges = [np.unique(np.linspace(m - reach, m + reach, FINER_EDGES).astype(int).clip(1, n - 1)) for m in middle]
    else:
        edges = [np.unique(np.linspace(1, n - 1, min(n - 1, most)).astype(int))] * 2
    both = [(int(a), int(b)) for a in edges[0] for b in edges[1] if b - a >= FEWEST_AFFECTED]
    return [(_time_between(channel, a), _time_between(channel, b)) for a, b in both]


def _date_places(channel: ShortComparison, near: Effect | None) -> list[float]:
    """List the candidate dates, midway between samples."""
    n = len(channel)
    if near is None:
        first = max(2, int(STEP_MARGIN * n))
        at = np.unique(np.linspace(first, n - first, min(STEP_DATES, n - 2 * first + 1)).astype(int))
    else:
        inside = np.flatnonzero(np.abs(channel.time_s - near.date) <= float(np.ptp(channel.time_s)) / STEP_DATES)
        inside = inside[(inside > 0) & (inside < n - 1)]
        at = inside[np.unique(np.linspace(0, len(inside) - 1, FINER_DATES).astype(int))] if len(inside) else inside
    return [_time_between(channel, int(k)) for k in at]


def _time_between(channel: ShortComparison, k: int) -> float:
    return float((channel.time_s[k - 1] + channel.time_s[k]) / 2.0)
