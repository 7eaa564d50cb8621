"""Evidence and probability of candidate effects, in long and short recordings alike.

An option is one form of a block, which is a target and a driver. All blocks are equally probable beforehand, and so are
the forms of a block; dates and places share the probability of their form by the part that each represents.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from compasslib.effects import Effect
from compasslib.effects.composed import ComposedEffect
from compasslib.inference.finding import TILTS
from compasslib.types import Floats

PAIRS_SHARE = 0.15  # of the prior odds, for products of two drivers
GROUPS = {"field_horizontal": "field", "field_down": "field", "lobe3": "lobe", "lobe4": "lobe"}  # of targets
HARMONIC_NAMES = ("sextantal", "octantal")
DATE_MARGIN, MOST_DATES = 0.04, 60  # share of a record without dates at each end; dates of a step, at first
MOST_EFFECTS = 3  # in a record; limits the run time
# Probability of no effect up to which one enters and stays: a Bayes factor of 3 (Kass and Raftery, JASA 90, 773, 1995).
UNLIKELY = 0.25
# Kinds of noise for surrogates and covariances: fewest, and least probability relative to the likeliest.
FEWEST_NOISES, LEAST_PROBABILITY = 8, 1e-3
NEGLIGIBLE = 8.0  # log likelihood below the best from which a date, or a kind of noise, is left out
SIDES_IN_ORDER = ("compass", "clock", "reference", "water")


@dataclass(frozen=True)
class Option:
    """One form of a block: an effect at zero size, with its columns."""

    term: Effect
    block: tuple[str, str, str]  # side, target, driver
    columns: Floats  # (n, k) degrees for one prior standard deviation at an amplitude of 1 degree
    usual: Floats  # (k,) values of the term's parameters at that standard deviation
    sized: bool = False  # whether physics gives the size, so that the amplitude is 1
    cell: float = 1.0  # share of its form, where a form has several dates or places
    share: float = 0.0  # log prior probability, given one effect
    log_ratio: float = 0.0  # log likelihood ratio by data other than the residual

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.term.name


def scale_option(term: Effect, derivative: Floats, turn: Floats, least: float = 0.0, cell: float = 1.0) -> Option:
    """Scale the derivative by a term's parameters, (n, k) degrees a unit, to equal sizes and a mean square of 1.

    Args:
        turn: size of each column, (k,) degrees a unit.
        least: size up to which a column is left out.
    """
    acting = turn > least
    usual = np.where(acting, 1.0 / np.where(acting, turn, 1.0), 0.0) / np.sqrt(max(acting.sum(), 1))
    columns = derivative * usual if acting.any() else derivative[:, :0]
    return Option(term, block_of(type(term)), columns, usual[: columns.shape[1]], cell=cell)


def block_of(kind: type[Effect]) -> tuple[str, str, str]:
    """Name the block of an effect: side, target and driver."""
    target: str = kind.acts_on
    if issubclass(kind, ComposedEffect):
        target = GROUPS.get(kind.composition[0], kind.composition[0])
    elif kind.side == "reference":
        target = "reference"
    elif kind.name in HARMONIC_NAMES:
        target = "lobe"
    return kind.side, target, TILTS.get(kind.driver, kind.driver)


def with_shares(options: Sequence[Option]) -> Iterator[Option]:
    """Divide the prior probability of one effect among blocks, forms and dates."""
    forms = Counter(block for block, _ in {(each.block, type(each.term)) for each in options})
    cells = Counter[type[Effect]]()
    for each in options:
        cells[type(each.term)] += each.cell  # type: ignore[assignment]
    pairs = sum("*" in block[2] for block in forms)
    single = len(forms) - pairs
    for each in options:
        of_block = PAIRS_SHARE / pairs if "*" in each.block[2] else (1.0 - PAIRS_SHARE * (pairs > 0)) / single
        share = np.log(of_block / forms[each.block] * each.cell / cells[type(each.term)])
        yield replace(each, share=float(share))


def log_bayes_factors(
    values: Floats, along: Floats, amplitude: Floats | float, square: Floats | None = None, freedom: float = np.inf
) -> Floats:
    """Compute the log Bayes factor of options over none at a prior amplitude, (..., g, r).

    If the variance of the noise is unknown, its Student's law of few residuals is used, and all are in its units.

    Args:
        values: eigenvalues of each option's information, (g, k).
        along: squared scores along the eigenvectors, (g, k, r).
        amplitude: a number, or (..., g, 1).
        square: sum of squares of the residuals without options, (r,).
        freedom: degrees of freedom of the noise's variance; infinite if it is known.
    """
    grown = amplitude**2 * values
    gain = ((0.5 * amplitude**2 / (1.0 + grown)).astype(along.dtype)[..., None, :] @ along)[..., 0, :]
    if square is not None:
        gain = -0.5 * freedom * np.log1p(-2.0 * gain / square)
    return np.asarray(gain - 0.5 * np.log1p(grown).sum(axis=-1)[..., None])


def log_sum(logs: Floats) -> Floats:
    """Compute the logarithm of a sum of exponentials along the first axis, faster than ``numpy.logaddexp``."""
    top = np.maximum(logs.max(axis=0), np.finfo(logs.dtype).min)
    with np.errstate(divide="ignore"):  # of nothing but impossible ones
        return np.asarray(top + np.log(np.exp(logs - top).sum(axis=0)))


@dataclass(frozen=True)
class Evidence:
    """Evidence of no further effect and of each of g options, under each of w kinds of noise, for r residuals."""

    options: tuple[Option, ...]
    noises: tuple[Any, ...]  # parameters of each kind of noise
    log_prior: Floats  # (w, 1) of the kinds of noise
    none: Floats  # (w, r) log likelihood
    factors: Floats  # (w, g, r) log Bayes factor over none

    @cached_property
    def log_bayes_factors(self) -> Floats:
        """Log Bayes factor of each option over none, times its prior share, noise marginalized, (g, r)."""
        none = self.none + self.log_prior
        shares = np.array([option.share + option.log_ratio for option in self.options])
        total = np.logaddexp.reduce(none, axis=0)
        return log_sum((none[:, None] - total).astype(self.factors.dtype) + self.factors) + shares[:, None]

    @cached_property
    def statistic(self) -> Floats:
        """Log Bayes factor of any option over none, (r,), by which an effect is detected."""
        return np.asarray(np.logaddexp.reduce(self.log_bayes_factors, axis=0))

    def noise_probability(self, option: int | None = None) -> Floats:
        """Compute the probability of each kind of noise for the first residual, given an option or none, (w,)."""
        log = self.none[:, 0] + self.log_prior[:, 0] + (0.0 if option is None else self.factors[:, option, 0])
        weight = np.exp(log - log.max())
        return np.asarray(weight / weight.sum())

    @property
    def likely_noises(self) -> list[Any]:
        """The kinds of noise that are not improbable without a further effect."""
        probability = self.noise_probability()
        most = max(FEWEST_NOISES, int(np.sum(probability > LEAST_PROBABILITY)))
        return [self.noises[w] for w in np.argsort(-probability)[:most]]

    @property
    def possible_noises(self) -> list[Any]:
        """The kinds of noise that are not negligible without a further effect or with any option, in order."""
        none = (self.none + self.log_prior)[:, 0]
        shares = np.array([option.share for option in self.options])
        best = np.max(none[:, None] + self.factors[:, :, 0] + shares, axis=1, initial=-np.inf)
        possible = (none > none.max() - NEGLIGIBLE) | (best > best.max() - NEGLIGIBLE)
        return [noise for noise, stays in zip(self.noises, possible, strict=True) if stays]

    def weighted_noises(self) -> Iterator[tuple[float, Any]]:
        """Yield the kinds of noise that are not improbable without a further effect, with weights that sum to 1."""
        weight = self.noise_probability()
        likely = np.flatnonzero(weight > LEAST_PROBABILITY * weight.max())
        yield from zip((weight[likely] / weight[likely].sum()).tolist(), (self.noises[w] for w in likely), strict=True)

    def likeliest_noise(self, option: int | None = None) -> Any:
        """Select the likeliest noise for the first residual, given an option or none."""
        return self.noises[int(np.argmax(self.noise_probability(option)))]


@dataclass(frozen=True)
class Place:
    """The place of one effect in a model: the probability of each option in it, the other effects given."""

    evidence: Evidence
    probability: Floats  # (g,) of each option; the rest is that of none

    @classmethod
    def weigh(cls, evidence: Evidence, odds: float, taken: Collection[int] = ()) -> Place:
        """Compute the probabilities from the evidence, and from the prior odds of a fault of compass or clock."""
        fault = np.array([option.block[0] in ("compass", "clock") for option in evidence.options])
        log = evidence.log_bayes_factors[:, 0] + np.where(fault, np.log(odds), 0.0)
        log[list(taken)] = -np.inf
        top = max(float(log.max(initial=-np.inf)), 0.0)
        weight = np.exp(log - top)
        return cls(evidence, weight / (weight.sum() + np.exp(-top)))

    @property
    def none(self) -> float:
        """Probability that no effect is there."""
        return float(max(1.0 - self.probability.sum(), 0.0))

    @property
    def names(self) -> dict[str, float]:
        """Probability of each effect, its forms and dates together."""
        sums: dict[str, float] = {}
        for option, probability in zip(self.evidence.options, self.probability.tolist(), strict=True):
            sums[option.name] = sums.get(option.name, 0.0) + probability
        return sums

    def alike(self, form: type[Effect]) -> list[int]:
        """List the options of one form, at its various dates or places."""
        return [k for k, option in enumerate(self.evidence.options) if type(option.term) is form]

    def likeliest(self, taken: Collection[type[Effect]] = ()) -> int:
        """Select the likeliest form, dates together, that is not in the model yet, at its likeliest date."""
        sums, log = dict[type[Effect], float](), self.evidence.log_bayes_factors[:, 0].tolist()
        for option, each in zip(self.evidence.options, log, strict=True):
            if type(option.term) not in taken:
                sums[type(option.term)] = float(np.logaddexp(sums.get(type(option.term), -np.inf), each))
        return max(self.alike(max(sums, key=sums.__getitem__)), key=log.__getitem__)

    def not_favoured(self, odds: float) -> Self:
        """Limit the odds of an effect that is not detected to those beforehand: surrogates have evidence like it."""
        most = odds / (1.0 + odds)
        return replace(self, probability=self.probability * min(most / max(float(self.probability.sum()), 1e-12), 1.0))


def side_probabilities(places: Sequence[Place], dropped: Collection[str] = ()) -> dict[str, float]:
    """Compute the probability of each side, the first in order if several act, and of none; some names dropped."""
    result, before = dict[str, float](), 1.0
    for number in range(1, len(SIDES_IN_ORDER) + 1):
        without = 1.0
        for place in places:
            acts = [o.block[0] in SIDES_IN_ORDER[:number] and o.name not in dropped for o in place.evidence.options]
            without *= 1.0 - float(place.probability[acts].sum())
        result[SIDES_IN_ORDER[number - 1]], before = max(before - without, 0.0), without
    return {"none": before} | result
