"""What the simulation leaves of the recording, ready to be tested.

The residual is observed minus simulated heading at the recorded one; it is never regressed on the observed heading,
whose noise it shares. The compass's own coefficients and the nuisances are projected out of everything that is tested:
what remains of an effect after their refit is its visible size.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles
from compasslib.deviation import branches, model
from compasslib.effects import Term, composition
from compasslib.effects.composition import Simulation
from compasslib.effects.term import slices
from compasslib.inference.case import Case
from compasslib.statistics import whitening
from compasslib.statistics.whitening import Whitener
from compasslib.types import Floats

ROUNDS = 2  # of widths and fit
FEWEST = 50  # samples that show where they are, below which there is nothing to examine
TINY = 1e-12  # of any unit: a parameter of which nothing is expected
STIFFEST = 1e-4  # prior precision of a baseline column in whitened units, against columns that hardly vary


class Lost(ArithmeticError):
    """Hardly any sample shows on which branch of the simulated compass it is, or any direction at all."""


@dataclass(frozen=True)
class State:
    """A simulation held against a recording, everything else refitted; n samples."""

    case: Case
    simulation: Simulation
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

    def ridge(self, terms: Iterable[type[Term] | Term]) -> Floats:
        """Return the prior precision of terms' parameters, in units of products of whitened columns, (k,).

        Args:
            terms: in the order of the columns.
        """
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

    def told(self) -> tuple[Floats, Floats]:
        """Return what other records of the compass tell of the base's columns: information (b, b) and score (b,)."""
        information, score = np.zeros((self.base.shape[1],) * 2), np.zeros(self.base.shape[1])
        if self.case.prior is not None:
            information[:5, :5] = self.case.prior.precision
            score[:5] = self.case.prior.precision @ self.case.prior.mean
        for term, own in zip(self.simulation.terms, slices(self.simulation.terms, 5), strict=True):
            if type(term) in self.case.shared:
                information[own, own], score[own] = self.case.shared[type(term)]
        return information, score

    def projected(self, columns_deg: Floats) -> Floats:
        """Return columns whitened, the base projected out, (n, k).

        Args:
            columns_deg: (n, k), degrees a unit.
        """
        return self.bare(self.whitener(np.nan_to_num(columns_deg, posinf=0.0, neginf=0.0)))

    def bare(self, white: Floats) -> Floats:
        """Return whitened columns, the base projected out, (n, k).

        Args:
            white: (n, k).
        """
        return whitening.without(white, self.basis.astype(white.dtype))

    def visible(self, columns_deg: Floats) -> Floats:
        """Return columns with what the base can take of them taken, (n, k) degrees: by the widths, not whitened.

        Args:
            columns_deg: (n, k), degrees a unit.
        """
        weight = 1.0 / self.whitener.width_deg
        columns = np.where(np.isfinite(columns_deg), columns_deg, 0.0)
        taken, *_ = np.linalg.lstsq(self.base * weight[:, None], columns * weight[:, None], rcond=1e-9)
        left = columns - self.base @ taken
        return left[np.isfinite(weight) & (weight > 0)]


def examine(case: Case, simulation: Simulation, nuisance: Floats, *, freed_deg: Floats | None = None) -> State:
    """Return the residual of a simulation, whitened, with its base projected out.

    Args:
        nuisance: values of the nuisances, (k,).
        freed_deg: the terms' effects, (n,), which are then given back to the residual, so that other terms can be tried
            in their place; else the terms belong to the base.

    Raises:
        Lost: too few samples are left to be examined.
    """
    heading, residual, width_floor = _residual(case, simulation, nuisance)
    if (usable := int(np.isfinite(residual).sum())) < FEWEST:
        raise Lost(f"{usable} of {len(case)} samples show on which branch of the compass they are")
    derivative = np.nan_to_num(composition.derivative(simulation, case.scene, heading))
    base = np.column_stack([derivative[:, : None if freed_deg is None else 5], case.nuisance])
    left, width, shift = residual, np.full(len(case), np.inf), np.zeros(base.shape[1])
    for _ in range(ROUNDS):
        width = np.hypot(whitening.widths(left, case.slowness), width_floor)
        if (usable := int(np.isfinite(width).sum())) < FEWEST:
            raise Lost(f"{usable} of {len(case)} samples show a direction")
        weighted = np.where(np.isfinite(width)[:, None], base, 0.0) / width[:, None]
        step = np.linalg.solve(_precise(weighted), weighted.T @ whitening.clipped(left, width))
        left, shift = left - base @ step, shift + step
    white = replace(whitening.whitener(left, width, case.scene.time_s), louder=case.louder)
    basis = whitening.orthonormal(white(base))
    standard = whitening.clipped(left, width)
    innovation = white.filtered(standard[:, None])[:, 0]
    response = whitening.response(left, width)
    bare = innovation - basis @ (basis.T @ innovation)
    counts = np.isfinite(width)
    sigma = float(np.sqrt(bare @ bare / max(counts.sum() - basis.shape[1], 1)))
    if freed_deg is not None:  # the clip and the filter are those of what is left, not of the effect
        innovation = innovation + response * white(freed_deg[:, None])[:, 0]
    innovation = innovation - basis @ (basis.T @ innovation)
    return State(
        case=case, simulation=simulation, nuisance=nuisance, heading_deg=heading, residual_deg=left, base=base,
        whitener=white, basis=basis, standard=standard, shift=shift, innovation=innovation, sigma=sigma,
        response=response,
    )  # fmt: skip


def halfway(state: State) -> State:
    """Return the state with its terms at half their sizes, for columns only: nothing is refitted there.

    There the slopes are those of the chord from none to all of an effect; where it stands whole they are not, and what
    would do as well in its place looks worse than it is.
    """
    terms = tuple(term.at(term.values / 2.0) for term in state.simulation.terms)
    simulation = replace(state.simulation, terms=terms)
    roots = composition.headings(simulation, state.case.scene, state.case.recorded_deg)
    return replace(state, simulation=simulation, heading_deg=model.nearest_root(roots, state.heading_deg))


def usable(case: Case, simulation: Simulation, nuisance: Floats) -> int:
    """Return how many samples show on which branch of a simulation's compass they are.

    Args:
        nuisance: values of the nuisances, (k,).
    """
    return int(np.isfinite(_residual(case, simulation, nuisance)[1]).sum())


def _residual(case: Case, simulation: Simulation, nuisance: Floats) -> tuple[Floats, Floats, Floats]:
    """Return simulated heading, residual, and what the compass's own noise makes of it, (n,) each."""
    shown = case.observed_deg - composition.veer(simulation, case.scene) - case.nuisance @ nuisance
    roots = composition.headings(simulation, case.scene, case.recorded_deg)
    heading = model.nearest_root(roots, shown)
    slope = np.maximum(np.abs(composition.steepness(simulation, case.scene, heading)), composition.FLATTEST)
    # Where a folded compass leaves two headings close together, the nearer one to a noisy direction is no residual.
    heading = np.where(branches.resolved(roots, case.expected_deg), heading, np.nan)
    return heading, angles.difference(shown, heading), case.precision_deg / slope


def trend(time_s: Floats) -> Floats:
    """Return hat functions of time that follow what changes over weeks, (n, k)."""
    knots = np.linspace(time_s[0], time_s[-1], max(int(np.ptp(time_s) / whitening.spacing_s(time_s)), 1) + 1)
    return np.column_stack([np.interp(time_s, knots, row) for row in np.eye(len(knots))])


def _precise(columns: Floats) -> Floats:
    gram = columns.T @ columns
    return gram + STIFFEST * np.trace(gram) / len(gram) * np.eye(len(gram))
