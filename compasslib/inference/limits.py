"""Detection limits: the size at which an effect is detected in nine of ten simulations of the recording."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.effects.composed import COMPOSED
from compasslib.inference.linear_model import Entered, Evidence, LinearModel, Marginal
from compasslib.types import Floats

POWER = 0.9  # share of simulations in which an effect at its limit is detected
SIZES_DEG = np.geomspace(0.25, 32.0, 22)  # visible sizes that are simulated, rms
MOST_PLACES = 8  # dates of one effect that are simulated


@dataclass(frozen=True)
class _Planted:
    """Surrogates with an effect of unit visible size, under one kind of slow noise; r surrogates."""

    prior: float  # log prior of the slow noise
    none: Floats  # (3, r) log likelihood of no effect: constant, linear and quadratic in the size
    score: Floats  # (2, k, r) score along each eigenvector of the information: constant and linear in the size
    values: Floats  # (k,) eigenvalues
    amplitudes: Floats  # (a,) prior rms of the effect, degrees

    def log_likelihoods(self, size_deg: float) -> tuple[Floats, Floats]:
        """Compute the log likelihood of no effect, and that of the effect that was planted, (r,) each."""
        none = self.prior + self.none[0] + size_deg * self.none[1] + size_deg**2 * self.none[2]
        along = (self.score[0] + size_deg * self.score[1]) ** 2
        variance = self.amplitudes[:, None, None] ** 2
        grown = variance * self.values[:, None]
        gain = 0.5 * variance / (1.0 + grown) * along - 0.5 * np.log1p(grown)
        return none, none + np.logaddexp.reduce(gain.sum(axis=1), axis=0) - np.log(len(variance))


def detection_limits(
    model: LinearModel, evidence: Evidence, entered: Entered, residuals: Floats, threshold: float
) -> dict[str, float | None]:
    """Find the visible size of each listed effect, rms degrees, that is detected with ``POWER``; None if there is none.

    Args:
        residuals: whitened surrogates without further effects, (n, r).
        threshold: statistic from which an effect is detected.
    """
    score, rng = model.scores(residuals), np.random.default_rng(0)
    taken = {model.options[k].name for k, _ in entered}
    listed: dict[str, list[int]] = {}
    for k, option in enumerate(model.options):
        if not option.name.startswith(COMPOSED) and option.name not in taken:
            listed.setdefault(option.name, []).append(k)
    products = replace(model.products, score=score)
    marginals = [
        (
            0.0 if slow_noise is None else slow_noise.log_prior,
            products.marginalize(model.noise_variances(slow_noise), entered),
        )
        for slow_noise in evidence.likely_noises
    ]
    result: dict[str, float | None] = {}
    for name, options in listed.items():
        places = [options[i] for i in np.linspace(0, len(options) - 1, min(MOST_PLACES, len(options))).astype(int)]
        parts = np.array_split(np.arange(score.shape[1]), len(places))
        power = np.zeros(len(SIZES_DEG))
        for k, part in zip(places, parts, strict=True):
            for s, statistic in enumerate(_statistics(model, marginals, k, part, rng)):
                power[s] += np.sum(statistic >= threshold) / score.shape[1]
        result[name] = _crossing(power)
    return result


def _statistics(
    model: LinearModel,
    marginals: Sequence[tuple[float, Marginal]],
    k: int,
    part: NDArray[np.intp],
    rng: np.random.Generator,
) -> Iterator[Floats]:
    """Yield the statistic of an option in some surrogates with its effect, in random directions, at each size, (r,).

    Args:
        marginals: log prior of each kind of slow noise, and the products of all surrogates with it marginalized.
        part: numbers of the surrogates.
    """
    at = model.products.columns(k)
    visible = model.freed.visible(model.options[k].columns)
    direction = rng.normal(size=(len(at), len(part)))
    direction /= np.sqrt(np.mean((visible @ direction) ** 2, axis=0))
    planted = []
    for prior, marginal in marginals:
        half, taken = marginal.half(model.products.information[:, at]) @ direction, marginal.taken[:, part]
        information, left = marginal.left(at)
        values, vectors = np.linalg.eigh(information)
        none = np.array([marginal.none[part], np.sum(half * taken, axis=0), 0.5 * np.sum(half**2, axis=0)])
        along = np.array([vectors.T @ left[:, part], vectors.T @ information @ direction])
        planted.append(_Planted(prior, none, along, np.maximum(values, 0.0), model.products.amplitudes[:, k]))
    for size in SIZES_DEG:
        each = [slow_noise.log_likelihoods(float(size)) for slow_noise in planted]
        none, effect = (np.logaddexp.reduce(np.array(logs), axis=0) for logs in zip(*each, strict=True))
        yield effect - none + model.options[k].share


def _crossing(power: Floats) -> float | None:
    """Interpolate the size at which the power reaches ``POWER``."""
    reached: NDArray[np.intp] = np.flatnonzero(power >= POWER)
    if not len(reached):
        return None
    k = int(reached[0])
    if k == 0:
        return float(SIZES_DEG[0])
    share = (POWER - power[k - 1]) / (power[k] - power[k - 1])
    return float(SIZES_DEG[k - 1] * (SIZES_DEG[k] / SIZES_DEG[k - 1]) ** share)


def limits_text(limits: Sequence[tuple[float, str]]) -> str:
    """State the smallest and the largest limit in a sentence."""
    (best, first), (worst, last) = (
        (f"{size:.1f}° rms", name.replace("_", " ")) for size, name in (limits[0], limits[-1])
    )
    if best == worst:
        return f"Any effect that was tried is detected with a probability of 90 % from {best} on."
    return f"Effects are detected with a probability of 90 % from {best} ({first}) to {worst} ({last}) on."
