"""The current between the two depths: its contribution to the noise of every hypothesis, and statements on it.

The directions at two depths differ with the speed, depth, tide and direction of the flow, with mooring motion, and by
errors of the velocity measurement (bias, beam gain). None of this changes a heading. The noise of every hypothesis
contains all these columns with Gaussian coefficients of typical size; which of them act, and how strongly, is inferred
under the most probable hypothesis and used when a compass is refitted.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compasslib.effects.effect import USUAL_DEG
from compasslib.inference import covariates
from compasslib.inference.comparison import TIDE_RESOLVING_STEP_S, LongComparison, tide_waves
from compasslib.inference.finding import SURE
from compasslib.types import Floats

KNOTS = 6  # of the directional shear along speed or depth
USUAL_TIDE_DEG = 2.0  # prior standard deviation of each sine and cosine of tidal directional shear
PRESENT = 0.75  # probability from which a driver enters the noise of a refit: a Bayes factor of 3
LEAN_SHARE = 0.05  # of the scatter of directions, prior standard deviation by tilt: the flow leans the instrument
# Drivers that vary together: by mooring knock-down, and by the lean of the instrument.
COUPLED = (frozenset({"speed", "depth", "separation"}), frozenset({"tilt", "pitch", "roll"}))
VELOCITY_ERRORS, MODULATORS = ("velocity_bias", "beam_gain"), ("speed", "depth")  # that may modulate the former
LEAST_SPREAD = 1e-6  # standard deviation, degrees, below which a column is left out
WORDS = {
    "speed": "with the speed of the flow",
    "depth": "with depth",
    "separation": "with the distance between the two layers",
    "tide": "with the tide",
    "tilt": "with the lean of the instrument",
    "flow_direction": "with the direction of the flow",
    "motion": "as the mooring's own motion makes them",
    "velocity_bias": "as a constant velocity in the instrument's frame makes them",
    "beam_gain": "as unequal gain of the beam pairs makes them",
}
NONE_ASSUMED = "The simulation assumed none."
ON_VELOCITY = "It acts on the velocity, not on the heading: headings are unchanged, their uncertainty includes it."
RIVAL = (
    "A compass whose reading follows {driver}, or what varies with it, would show nearly the same (P = {rival:.2f}): "
    "headings are the average of both by these probabilities, their uncertainty includes the difference. "
    "{separated_by} would separate them."
)
SEPARATED_BY = "a second current meter at the depth of the affected instrument"
CONTESTED = 0.05  # probability of a compass effect instead, from which a statement on the current is qualified


@dataclass(frozen=True)
class CurrentBlock:
    """Columns of the current by one driver."""

    driver: str
    columns: Floats  # (n, k) degrees per prior standard deviation


@dataclass(frozen=True)
class CurrentStatement:
    """An effect of the current, or of the velocity measurement, that the simulation does not contain."""

    driver: str | None  #: variable on which it depends; None if only the side is established
    probability: float  #: that its size exceeds ``min_effect_deg``
    size_deg: float  #: visible size, degrees rms
    low_deg: float  #: lower end of the 95 % interval of ``size_deg``
    high_deg: float  #: upper end of the 95 % interval of ``size_deg``
    text: str  #: the statement in sentences

    def contested(self, rival: float, followed: str) -> CurrentStatement:
        """Reduce the probability by that of a compass reading that depends on the driver, and mention it.

        Args:
            rival: probability of such a compass.
            followed: driver on which its reading depends.
        """
        if rival < CONTESTED:
            return self
        left = self.probability * (1.0 - rival)
        text = _text(self.driver, left, (self.size_deg, self.low_deg, self.high_deg))
        said = RIVAL.format(driver=followed, rival=rival, separated_by=SEPARATED_BY.capitalize())
        return replace(self, probability=left, text=f"{text} {NONE_ASSUMED} {said}")

    def to_json(self) -> dict[str, Any]:
        """Encode an entry of ``current`` in diagnosis.json."""
        return {
            "level": "side" if self.driver is None else "driver",
            "driver": self.driver,
            "probability": self.probability,
            "size": self.size_deg,
            "unit": "degrees",
            "low": self.low_deg,
            "high": self.high_deg,
            "heldout": None,  # not tested on held-out days
            "text": self.text,
        }


def coupled_drivers(driver: str) -> frozenset[str]:
    """Collect the drivers of the current that cannot be separated from a driver, including itself."""
    return next((group for group in COUPLED if driver in group), frozenset({driver}))


def current_blocks(comparison: LongComparison) -> tuple[CurrentBlock, ...]:
    """Build the columns of the current of a mooring by driver."""
    columns: dict[str, list[Floats]] = {}
    for name in ("speed", "depth"):
        if name in comparison.covariates:
            hats = covariates.hat_columns(comparison.covariates[name], KNOTS)
            columns[name] = [USUAL_DEG * (hats - hats.mean(axis=0))]
    leans = [comparison.scene.departures[name] for name in ("pitch", "roll") if name in comparison.covariates]
    usual_deg = LEAN_SHARE * float(np.median(comparison.expected_deg))
    columns["tilt"] = [usual_deg * covariates.standardize(lean)[:, None] for lean in leans if np.std(lean)]
    if np.median(np.diff(comparison.scene.time_s)) < TIDE_RESOLVING_STEP_S:
        columns["tide"] = [USUAL_TIDE_DEG * tide_waves(comparison.scene.time_s)]
    for kind in comparison.terms:
        if kind.side == "water" and kind.driver not in ("speed", "depth"):
            # The turn by each parameter at its prior standard deviation, (n, k) degrees.
            unit, still = np.eye(len(kind.fitted())), np.zeros(len(comparison))
            turn = np.stack([kind().at(values).apply(still, comparison.scene) for values in unit], axis=1)
            size, usual = np.sqrt(np.mean(turn**2, axis=0)), kind.expected()
            with np.errstate(divide="ignore"):
                scale = np.where(usual > 0.0, usual**-0.5, USUAL_DEG / np.maximum(size, 1e-12))
            turn = np.asarray(turn * np.where(size > 0.0, scale, 0.0))
            columns.setdefault(kind.driver, []).append(turn)
            if kind.driver in VELOCITY_ERRORS:
                series = (comparison.scene.departures.get(name) for name in MODULATORS)
                varying = [x for x in series if x is not None and np.std(x) > LEAST_SPREAD]
                columns[kind.driver] += [turn * covariates.standardize(x)[:, None] for x in varying]
    blocks = [CurrentBlock(driver, np.concatenate(each, axis=1)) for driver, each in columns.items() if each]
    return tuple(block for block in blocks if np.max(block.columns.std(axis=0), initial=0.0) > LEAST_SPREAD)


@dataclass(frozen=True)
class CurrentPosterior:
    """Posterior over all subsets of drivers, with coefficients drawn from the mixture."""

    drivers: tuple[str, ...]  # of each column, (p,)
    values: Floats  # (d, p) drawn coefficients, in prior standard deviations; 0 if the driver does not act
    acting: float  # posterior probability that any driver acts; the prior is 0.5

    @property
    def variances(self) -> Floats:
        """Mean square of each coefficient whose driver is likely to act, 0 for the others, (p,).

        A driver that hardly acts would otherwise widen the covariance of a compass where the data do not constrain it.
        """
        present = np.mean(self.values != 0.0, axis=0) >= PRESENT
        return np.asarray(np.where(present, np.mean(self.values**2, axis=0), 0.0))

    def statements(self, visible: Floats, min_effect_deg: float) -> tuple[float, tuple[CurrentStatement, ...]]:
        """Compute the probability that the current exceeds a size, and state by which drivers it does.

        Args:
            visible: mean products of the columns with the compass projected out, square degrees, (p, p).
            min_effect_deg: size, degrees rms, below which an effect is negligible.
        """
        sizes = _sizes(self.values[np.any(self.values != 0.0, axis=1)], visible)
        probability = self.acting * float(np.mean(sizes > min_effect_deg)) if len(sizes) else 0.0
        if probability < SURE:
            return probability, ()
        stated = []
        for name in dict.fromkeys(self.drivers):
            each = _sizes(self.values * [driver == name for driver in self.drivers], visible)
            if (established := float(np.mean(each > min_effect_deg))) >= SURE:
                stated.append(_statement(name, established, each[each > min_effect_deg]))
        return probability, tuple(stated) or (_statement(None, probability, sizes),)


def infer_current(drivers: Sequence[str], information: Floats, score: Floats, draws: int = 2000) -> CurrentPosterior:
    """Infer which drivers of the current act, each with even prior odds.

    With these odds it would be nearly certain a priori that some driver acts. For the probability that any acts, the
    prior odds of each driver are lowered until those of any driver are even.

    Args:
        drivers: driver of each column, (p,).
        information: products of the columns, all other unknowns marginalized, in units of the noise, (p, p).
        score: products of the columns with the residual, (p,).
        draws: of the current's size; the standard error of a probability of 0.95 is 0.5 %.
    """
    names = list(dict.fromkeys(drivers))
    at = np.array([names.index(driver) for driver in drivers])
    subsets = [np.flatnonzero(np.array(subset)[at]) for subset in itertools.product((False, True), repeat=len(names))]
    fits = []
    for subset in subsets:
        lower = np.linalg.cholesky(information[np.ix_(subset, subset)] + np.eye(len(subset)))
        half, root = np.linalg.solve(lower, score[subset]), np.linalg.inv(lower).T
        fits.append((root @ half, root, float(0.5 * half @ half - np.sum(np.log(np.diag(lower))))))
    log = np.array([fit[2] for fit in fits])  # even prior odds of each driver
    weight = np.exp(log - log.max())
    rng, values = np.random.default_rng(5), np.zeros((draws, len(at)))
    chosen = rng.choice(len(subsets), draws, p=weight / weight.sum())
    for k in np.unique(chosen):
        mine, (mean, root, _) = np.flatnonzero(chosen == k), fits[k]
        values[np.ix_(mine, subsets[k])] = mean + rng.normal(size=(len(mine), len(mean))) @ root.T
    each = 1.0 - 0.5 ** (1.0 / len(names))  # prior probability of a driver for which none acts with probability 0.5
    count = np.array([len(set(at[subset])) for subset in subsets])
    few = log + count * np.log(each / (1.0 - each))
    return CurrentPosterior(tuple(drivers), values, float(1.0 - np.exp(few[0] - np.logaddexp.reduce(few))))


def _sizes(values: Floats, visible: Floats) -> Floats:
    return np.asarray(np.sqrt(np.maximum(np.einsum("di,ij,dj->d", values, visible, values), 0.0)))


def _statement(driver: str | None, probability: float, sizes: Floats) -> CurrentStatement:
    size, low, high = (float(x) for x in np.quantile(sizes, [0.5, 0.025, 0.975]))
    text = f"{_text(driver, probability, (size, low, high))} {NONE_ASSUMED} {ON_VELOCITY}"
    return CurrentStatement(driver, probability, size, low, high, text)


def _text(driver: str | None, probability: float, sizes_deg: tuple[float, float, float]) -> str:
    size, low, high = sizes_deg
    how = f", {WORDS.get(driver, f'with {driver}')}" if driver else ""
    return (
        f"Directions at the two depths differ by {size:.1f}° rms ({low:.1f} to {high:.1f}°, 95 %){how} "
        f"(P = {probability:.2f})."
    )
