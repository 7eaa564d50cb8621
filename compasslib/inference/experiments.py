"""Experimental design: the probability that a further observation leaves a single explanation.

An observation adds information to the linear model from which the posterior of the hypotheses was computed. Outcomes
are drawn from the hypotheses by their probability, and the posterior is updated with each (preposterior analysis;
Raiffa and Schlaifer, Applied Statistical Decision Theory, 1961).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from compasslib.effects import Effect, Scene
from compasslib.effects.effect import DAY_S
from compasslib.effects.forward import added_term_jacobian, heading_jacobian
from compasslib.inference import design
from compasslib.inference.design import FittedModel
from compasslib.inference.evidence import MOST_EFFECTS
from compasslib.inference.finding import SURE
from compasslib.inference.search import Inference
from compasslib.types import Floats

ANYTHING = 1e6  # prior variance of free coefficients, in units of one sample's noise
LEAST, MOST = 0.002, 40  # least probability of the hypotheses that are considered, and their maximum number
COURSES, SWUNG_DEG = 24, 1.0  # headings of a swing, and the error of each
SHARED = 0.5  # share of a pair's noise that is the affected instrument's own, and common to a second reference
DRAWS = 400  # outcomes of an observation, for a standard error of 2.5 % of a probability


@dataclass(frozen=True)
class Recording:
    """The linear model of a recording: p columns of candidate terms, q of slow noise, b of compass and nuisances."""

    midpoint: FittedModel  # linearization point of the columns
    freed: FittedModel  # model that whitens
    scale: float  # factor that scales whitened columns to noise of unit variance
    terms: Sequence[Effect]
    ends: NDArray[np.intp]  # boundaries between the columns of the terms, from 0
    usual: Floats  # (p,) prior standard deviations
    candidates: Floats  # (n, p) whitened
    slow: Floats  # (n, q) whitened
    base: Floats  # (n, b) whitened
    variance: Floats  # (q,) prior variance of slow noise
    score: Floats  # (p + q + b,)

    def columns(self, scene: Scene, heading_deg: Floats) -> Floats:
        """Compute the candidates' columns in another scene, for one prior standard deviation, (n, p) degrees."""
        simulation = self.midpoint.simulation
        each = [added_term_jacobian(simulation, scene, heading_deg, term) for term in self.terms]
        return np.nan_to_num(np.concatenate(each, axis=1)) * self.usual

    def of_sides(self, *sides: str) -> NDArray[np.bool_]:
        """Mark the candidates' columns that act on some sides, (p,)."""
        return np.repeat([term.side in sides for term in self.terms], np.diff(self.ends))


def rank_observations(inferred: Inference) -> tuple[tuple[str, float], ...]:
    """Rank observations by the probability that each leaves a single explanation; none without alternatives."""
    combined = [(p, each) for p, each in inferred.combinations if p >= LEAST][:MOST]
    numbers = sorted({k for _, each in combined for k in each})
    if not numbers:
        return ()
    recording = _linearize(inferred, numbers)
    names = [tuple(sorted(inferred.model.options[k].name for k in each)) for _, each in combined]
    hypotheses = [tuple(numbers.index(k) for k in each) for _, each in combined]
    probability = np.array([p for p, _ in combined]) / sum(p for p, _ in combined)
    days = float(np.ptp(inferred.fitted.comparison.scene.time_s)) / DAY_S
    observations = {
        f"another {days:.0f} days of the same mooring": _longer(recording),
        "a second reference instrument at another depth, throughout": _second(recording),
        f"a swing of {COURSES} headings after recovery, each to {SWUNG_DEG:.0f} degree": _swing(recording),
    }
    chances = [
        (what, _single_name_share(names, _update(recording, hypotheses, probability, information)))
        for what, information in observations.items()
    ]
    return tuple(sorted(chances, key=lambda item: -item[1]))


def _linearize(inferred: Inference, numbers: Sequence[int]) -> Recording:
    model, entered = inferred.model, dict(inferred.entered)
    freed, midpoint = design.freed_model(inferred.fitted)
    scale = freed.response / freed.sigma / np.sqrt(model.scatter)
    options = [model.options[k] for k in numbers]
    sizes = [entered.get(k) or model.likeliest_amplitude(k, inferred.slow_noise) for k in numbers]
    columns = [size * option.columns for size, option in zip(sizes, options, strict=True)]
    ends = np.cumsum([0, *(option.columns.shape[1] for option in options)])
    rows = freed.whitener(np.nan_to_num(np.concatenate([*columns, inferred.slow.columns, freed.base], axis=1))) * scale
    candidates, slow, base = np.split(rows, [ends[-1], ends[-1] + inferred.slow.columns.shape[1]], axis=1)
    return Recording(
        midpoint=midpoint,
        freed=freed,
        scale=scale,
        terms=[option.term for option in options],
        ends=ends,
        usual=np.concatenate([size * option.usual for size, option in zip(sizes, options, strict=True)]),
        candidates=candidates,
        slow=slow,
        base=base,
        variance=inferred.slow.variances(inferred.slow_noise),
        score=rows.T @ (freed.innovation * scale / freed.response),
    )


def _information(known: Floats, free: Floats, precision: Floats) -> Floats:
    """Compute the information of an observation on the recording's unknowns, its own parameters marginalized.

    Args:
        known: derivatives by the recording's unknowns, (m, p + q + b), in units of the observation's noise.
        free: derivatives by parameters of the observation itself, (m, f), of a given prior precision.
    """
    cross = free.T @ known
    return np.asarray(known.T @ known - cross.T @ np.linalg.solve(free.T @ free + np.diag(precision), cross))


def _longer(recording: Recording) -> Floats:
    """Observe as many pairs again, with independent slow noise of the same size and memory.

    Headings and logged series repeat; series that are mostly a trend, such as a battery voltage, are extrapolated.
    """
    scene, heading = recording.midpoint.comparison.scene, recording.midpoint.heading_deg
    span = float(np.ptp(scene.time_s))
    departures = {name: extrapolate(column, scene.time_s, span) for name, column in scene.departures.items()}
    later = replace(scene, time_s=scene.time_s + span, departures=departures)
    repeated = recording.freed.whitener(recording.columns(later, heading)) * recording.scale
    free = recording.variance > 0.0
    known = np.concatenate([repeated, 0.0 * recording.slow, recording.base], axis=1)
    return _information(known, recording.slow[:, free], 1.0 / recording.variance[free])


def extrapolate(column: Floats, time_s: Floats, span_s: float, least_correlation: float = 0.9) -> Floats:
    """Continue a series by a time span, (n,): repeated, or along its trend from a correlation with time on."""
    spread = float(np.std(column))
    if not spread:
        return column
    slope = float(np.cov(column, time_s, bias=True)[0, 1] / np.var(time_s))
    return column + slope * span_s if abs(slope) * np.std(time_s) > least_correlation * spread else column


def _second(recording: Recording) -> Floats:
    """Observe as many pairs with a second reference at another depth, whose noise is only partly new.

    The affected instrument's noise is common to both pairs: the rows are the second pair minus ``SHARED`` of the first.
    """
    new, present = np.sqrt(1.0 - SHARED**2), recording.variance > 0.0
    compass, nuisances = recording.base[:, :5], recording.base[:, 5:]
    share = np.where(recording.of_sides("compass", "clock"), 1.0 - SHARED, -SHARED)
    known = [recording.candidates * share, -SHARED * recording.slow, (1.0 - SHARED) * compass, -SHARED * nuisances]
    # A constant veer looks like A.
    free = np.concatenate([recording.slow[:, present], compass[:, :1], nuisances], axis=1)
    precision = np.full(free.shape[1], 1.0 / ANYTHING)
    precision[: present.sum()] = 1.0 / recording.variance[present]
    return _information(np.concatenate(known, axis=1) / new, free / new, precision)


def _swing(recording: Recording) -> Floats:
    """Observe a swing on a level deck, all departures 0; the alignment of the mount is free."""
    midpoint, none = recording.midpoint, np.zeros(COURSES)
    scene = midpoint.comparison.scene
    deck = replace(
        scene,
        time_s=none + scene.time_s[-1],
        horizontal_nT=none + float(np.mean(scene.horizontal_nT)),
        vertical_nT=none + float(np.mean(scene.vertical_nT)),
        pitch_deg=none,
        roll_deg=none,
        departures=dict.fromkeys(scene.departures, none),
    )
    heading = np.arange(COURSES) * 360.0 / COURSES
    base = np.zeros((COURSES, recording.base.shape[1]))
    base[:, :5] = np.nan_to_num(heading_jacobian(midpoint.simulation, deck, heading)[:, :5])
    candidates = recording.columns(deck, heading) * recording.of_sides("compass")
    known = np.concatenate([candidates, np.zeros((COURSES, len(recording.variance))), base], axis=1)
    return _information(known / SWUNG_DEG, np.ones((COURSES, 1)) / SWUNG_DEG, np.full(1, 1.0 / ANYTHING))


def _update(
    recording: Recording, hypotheses: Sequence[tuple[int, ...]], probability: Floats, information: Floats
) -> Floats:
    """Draw outcomes of an observation and update the probability of each set of terms with each, (h, d)."""
    rows, score = np.concatenate([recording.candidates, recording.slow, recording.base], axis=1), recording.score
    known, present = rows.T @ rows, np.flatnonzero(recording.variance > 0.0)
    free = np.arange(recording.ends[-1] + len(recording.variance), len(known))
    prior = np.concatenate([1.0 / recording.variance[present], (np.diag(known)[free] + 1.0) / ANYTHING])
    of_term = np.repeat(np.arange(len(recording.terms)), np.diff(recording.ends))
    index, before = [], []  # unknowns of each hypothesis, and the Cholesky factor of their precision
    for terms in hypotheses:
        own = np.flatnonzero(np.isin(of_term, terms))
        index.append(np.concatenate([own, recording.ends[-1] + present, free]))
        precision = known[np.ix_(index[-1], index[-1])] + np.diag(np.append(np.ones(len(own)), prior))
        before.append(cholesky(precision, lower=True))
    rng = np.random.default_rng(7)
    values, vectors = np.linalg.eigh((information + information.T) / 2.0)
    true = rng.choice(len(hypotheses), DRAWS, p=probability)
    shown = vectors * np.sqrt(np.maximum(values, 0.0)) @ rng.normal(size=(len(information), DRAWS))
    for h in np.unique(true):
        at, these, lower = index[h], np.flatnonzero(true == h), before[h]
        mean = cho_solve((lower, True), score[at])[:, None]
        unknowns = mean + solve_triangular(lower.T, rng.normal(size=(len(at), len(these))))
        shown[:, these] += information[:, at] @ unknowns
    log = np.empty((len(hypotheses), DRAWS))  # log probability of the outcomes, up to a constant
    for h, (at, lower) in enumerate(zip(index, before, strict=True)):
        after = cholesky(lower @ lower.T + information[np.ix_(at, at)], lower=True)
        pulled = solve_triangular(after, score[at][:, None] + shown[at], lower=True)
        without = solve_triangular(lower, score[at], lower=True)
        volume = np.sum(np.log(np.diag(after))) - np.sum(np.log(np.diag(lower)))
        log[h] = 0.5 * np.sum(pulled**2, axis=0) - 0.5 * without @ without - volume + np.log(probability[h])
    weight = np.exp(log - log.max(axis=0))
    return np.asarray(weight / weight.sum(axis=0))


def _single_name_share(names: Sequence[tuple[str, ...]], probability: Floats) -> float:
    """Compute the share of draws in which every stated effect, or their absence, is at least as probable as ``SURE``.

    Args:
        names: effects of each hypothesis, with its probability in each draw, (h, d).
    """
    count = np.array([len(each) for each in names])
    most = sum((probability[count >= k].sum(axis=0) > 0.5).astype(int) for k in range(1, MOST_EFFECTS + 1))
    effects, sets = {effect for each in names for effect in each}, list(dict.fromkeys(names))
    chance = np.array([probability[[other == each for other in names]].sum(axis=0) for each in sets])
    chosen = np.argmax(np.where(np.array([len(each) for each in sets])[:, None] == most, chance, -1.0), axis=0)
    acting = {effect: probability[[effect in each for each in names]].sum(axis=0) for effect in effects}
    least = [np.min([acting[effect] for effect in each] or [chance[k]], axis=0) for k, each in enumerate(sets)]
    return float(np.mean(np.array(least)[chosen, np.arange(probability.shape[1])] >= SURE))
