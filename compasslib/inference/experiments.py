"""Experimental design: the probability that a further observation leaves a single explanation.

An observation adds rows to the linear model from which the posterior of the hypotheses was computed. Outcomes are drawn
from the hypotheses by their probability, and the posterior is updated with each (preposterior analysis; Raiffa and
Schlaifer, Applied Statistical Decision Theory, 1961).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky, solve_triangular

from compasslib.effects import Effect, Scene
from compasslib.effects.effect import DAY_S
from compasslib.effects.forward import (
    added_term_jacobian,
    earth_field_in_body,
    heading_jacobian,
    north_shift,
    sensed_field,
)
from compasslib.inference import design
from compasslib.inference.design import FittedModel
from compasslib.inference.finding import SURE
from compasslib.inference.inference import MOST_EFFECTS, Inference
from compasslib.types import Floats

ANYTHING = 1e6  # prior variance of free coefficients, in units of one sample's noise
LEAST, MOST = 0.002, 40  # least probability of the hypotheses that are considered, and their maximum number
COURSES, SWUNG_DEG = 24, 1.0  # headings of a swing, and the error of each
STRENGTH_NT, STRENGTH_S = 50.0, DAY_S  # error of a field strength including geomagnetic variation, and its memory
SOFT_NT = 100.0  # scales the columns of constant soft iron
SHARED = 0.5  # share of a pair's noise that is the affected instrument's own, and common to a second reference


@dataclass(frozen=True)
class Rows:
    """Rows that an observation adds to the linear model, in units of its noise; m rows."""

    known: Floats  # (m, p + q + b) derivatives by candidates, slow noise and base of the recording
    free: Floats  # (m, f) derivatives by nuisance parameters of the observation itself
    precision: Floats  # (f,) prior precision of these parameters

    @property
    def information(self) -> Floats:
        """Information on the recording's unknowns, own parameters marginalized, (p + q + b, p + q + b)."""
        cross = self.free.T @ self.known
        free_information = self.free.T @ self.free + np.diag(self.precision)
        return self.known.T @ self.known - cross.T @ np.linalg.solve(free_information, cross)


@dataclass(frozen=True)
class Model:
    """The linear model of a recording: candidates of the likely hypotheses, slow noise, compass and nuisances."""

    state: FittedModel  # linearization point of the columns
    view: FittedModel  # model that whitens
    scale: float  # factor that scales whitened columns to noise of unit variance
    terms: list[Effect]
    ends: NDArray[np.intp]  # boundaries between the columns of the terms, from 0
    usual: Floats  # (p,) prior standard deviations
    rows: Floats  # (n, p + q + b) whitened columns
    slow: int  # q, the number of columns of slow noise
    score: Floats  # (p + q + b,)

    @property
    def n_candidates(self) -> int:
        """Number of columns of the candidates, p."""
        return int(self.ends[-1])

    def columns(self, scene: Scene, heading_deg: Floats) -> Floats:
        """Compute the candidates' columns in another scene, for one prior standard deviation, (n, p) degrees."""
        simulation = self.state.simulation
        each = [added_term_jacobian(simulation, scene, heading_deg, term) for term in self.terms]
        return np.nan_to_num(np.concatenate(each, axis=1)) * self.usual

    def of_terms(self, chosen: Sequence[bool]) -> NDArray[np.bool_]:
        """Mark the candidates' columns that belong to some terms, (p,)."""
        return np.repeat(np.asarray(chosen, dtype=bool), np.diff(self.ends))


def rank_observations(inferred: Inference) -> tuple[tuple[str, float], ...]:
    """Rank observations by the probability that each leaves a single explanation; none without alternatives."""
    combined = [(p, each) for p, each in inferred.combinations if p >= LEAST][:MOST]
    numbers = sorted({k for _, each in combined for k in each})
    if inferred.slow is None or not numbers:
        return ()
    model = _model(inferred, numbers)
    variance = np.zeros(model.slow) if inferred.water is None else inferred.slow.variances(inferred.water)
    weighed = _Weighed(model, variance, [tuple(numbers.index(k) for k in each) for _, each in combined])
    probability = np.array([p for p, _ in combined])
    probability /= probability.sum()
    names = [tuple(sorted(inferred.model.options[k].name for k in each)) for _, each in combined]
    days = float(np.ptp(model.state.case.scene.time_s)) / DAY_S
    observations = {
        f"another {days:.0f} days of the same mooring": _longer(model, variance),
        "a second reference instrument at another depth, throughout": _second(model, variance),
        f"a swing of {COURSES} headings after recovery, each to {SWUNG_DEG:.0f} degree": _swing(model),
    }
    if any(term.acts_on == "field" for term in model.terms):
        logged = f"the strength of the field logged beside the compass, to {STRENGTH_NT:.0f} nT"
        observations[logged] = _strength(model)
    ranked = [(what, weighed.decided(rows, names, probability)) for what, rows in observations.items()]
    return tuple(sorted(ranked, key=lambda item: -item[1]))


def _model(inferred: Inference, numbers: Sequence[int]) -> Model:
    view, half = design.freed_model(inferred.state)
    options = [inferred.model.options[k] for k in numbers]
    amplitudes = [
        dict(inferred.entered).get(k) or inferred.model.likeliest_amplitude(k, inferred.water) for k in numbers
    ]
    sized = [(size * option.usual, size * option.columns) for size, option in zip(amplitudes, options, strict=True)]
    assert inferred.slow is not None
    scale = 1.0 / view.sigma / np.sqrt(inferred.model.scatter)
    columns = [*(part for _, part in sized), inferred.slow.columns, view.base]
    rows = view.whitener(np.nan_to_num(np.concatenate(columns, axis=1))) * view.response * scale
    return Model(
        state=half,
        view=view,
        scale=view.response * scale,
        terms=[option.term for option in options],
        ends=np.cumsum([0, *(option.columns.shape[1] for option in options)]),
        usual=np.concatenate([usual for usual, _ in sized]),
        rows=rows,
        slow=inferred.slow.columns.shape[1],
        score=rows.T @ (view.innovation * scale),
    )


def _parts(model: Model) -> tuple[Floats, Floats, Floats]:
    candidates_end, slow = model.n_candidates, model.n_candidates + model.slow
    return model.rows[:, :candidates_end], model.rows[:, candidates_end:slow], model.rows[:, slow:]


def _longer(model: Model, variance: Floats) -> Rows:
    """Build the rows of as many pairs again, with independent slow noise of the same size and memory.

    Headings and logged series repeat; series that are mostly a trend, such as a battery voltage, are extrapolated.
    """
    _, slow, base = _parts(model)
    scene = model.state.case.scene
    span = float(np.ptp(scene.time_s))
    departures = {name: _continued(column, scene.time_s, span) for name, column in scene.departures.items()}
    later = replace(scene, time_s=scene.time_s + span, departures=departures)
    repeated = model.view.whitener(model.columns(later, model.state.heading_deg)) * model.scale
    free = variance > 0.0
    return Rows(np.concatenate([repeated, 0.0 * slow, base], axis=1), slow[:, free], 1.0 / variance[free])


def _continued(column: Floats, time_s: Floats, span_s: float, least_correlation: float = 0.9) -> Floats:
    """Extrapolate a series by a time span, (n,): repeated, or along its trend from a correlation with time on."""
    spread = float(np.std(column))
    if not spread:
        return column
    slope = float(np.cov(column, time_s, bias=True)[0, 1] / np.var(time_s))
    return column + slope * span_s if abs(slope) * np.std(time_s) > least_correlation * spread else column


def _second(model: Model, variance: Floats) -> Rows:
    """Build the rows of as many pairs with a second reference at another depth, whose noise is only partly new.

    The affected instrument's noise is common to both pairs: the rows are the second pair minus ``SHARED`` of the first.
    """
    candidate_columns, slow, base = _parts(model)
    new = np.sqrt(1.0 - SHARED**2)
    of_compass = model.of_terms([term.side in ("compass", "clock") for term in model.terms])
    compass, nuisances = base[:, :5], base[:, 5:]
    known = [candidate_columns * np.where(of_compass, 1.0 - SHARED, -SHARED), -SHARED * slow]
    known += [(1.0 - SHARED) * compass, -SHARED * nuisances]
    present, veer = variance > 0.0, compass[:, :1]  # a constant veer looks like A
    free = np.concatenate([slow[:, present], veer, nuisances], axis=1)
    precision = np.concatenate([1.0 / variance[present], np.full(free.shape[1] - int(present.sum()), 1.0 / ANYTHING)])
    return Rows(np.concatenate(known, axis=1) / new, free / new, precision)


def _swing(model: Model) -> Rows:
    """Build the rows of a swing on a level deck, all departures 0; the alignment of the mount is free."""
    scene, none = model.state.case.scene, np.zeros(COURSES)
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
    of_compass = model.of_terms([term.side == "compass" for term in model.terms])
    candidate_columns = model.columns(deck, heading) * of_compass
    base = np.zeros((COURSES, model.rows.shape[1] - model.n_candidates))
    base[:, model.slow : model.slow + 5] = heading_jacobian(model.state.simulation, deck, heading)[:, :5]
    known = np.concatenate([candidate_columns, np.nan_to_num(base)], axis=1) / SWUNG_DEG
    return Rows(known, np.ones((COURSES, 1)) / SWUNG_DEG, np.full(1, 1.0 / ANYTHING))


def _strength(model: Model) -> Rows:
    """Build the rows of a logged total field strength; constant iron on all three axes is free."""
    scene, simulation = model.state.case.scene, model.state.simulation
    fitted = model.state.heading_deg
    heading = np.where(np.isfinite(fitted), fitted, model.state.case.recorded_deg)
    earth = earth_field_in_body(scene, heading - north_shift(simulation, scene))

    def sensed(*terms: Effect) -> Floats:
        return sensed_field(replace(simulation, terms=(*terms, *simulation.terms)), scene, earth)

    body, columns = sensed(), []
    length = np.linalg.norm(body, axis=1)
    for term in model.terms:
        moved = [term.values + step * unit for step, unit in zip(term.steps(), np.eye(len(term.steps())), strict=True)]
        on_field = term.acts_on == "field"
        columns += [
            (np.linalg.norm(sensed(term.at(values)), axis=1) - length) / step if on_field else 0.0 * length
            for values, step in zip(moved, term.steps(), strict=True)
        ]
    independent = min(float(np.median(np.diff(scene.time_s))) / (2.0 * STRENGTH_S), 1.0)  # share of the samples
    unit = float(np.sqrt(independent)) / STRENGTH_NT
    no_noise = np.zeros((len(heading), model.rows.shape[1] - model.n_candidates))
    hard = body / length[:, None]
    soft = [body[:, i] * hard[:, j] / SOFT_NT for i, j in itertools.combinations_with_replacement(range(3), 2)]
    free = np.column_stack([hard, *soft]) * unit
    known = np.concatenate([np.column_stack(columns) * model.usual * unit, no_noise], axis=1)
    return Rows(known, free, np.full(free.shape[1], 1.0 / ANYTHING))


class _Weighed:
    """Hypotheses with the posterior of their unknowns from the recording."""

    def __init__(self, model: Model, variance: Floats, hypotheses: Sequence[tuple[int, ...]]):
        present = np.flatnonzero(variance > 0.0)
        information = model.rows.T @ model.rows
        nuisances = np.concatenate(
            [model.n_candidates + present, np.arange(model.n_candidates + model.slow, len(information))]
        )
        known = np.full(len(nuisances), 0.0)
        known[: len(present)] = 1.0 / variance[present]
        known[len(present) :] = 1.0 / ANYTHING * np.diag(information)[nuisances[len(present) :]] + 1.0 / ANYTHING
        self.score = model.score
        self.index, self.precision = [], []
        for hypothesis in hypotheses:
            columns = np.concatenate(
                [np.zeros(0, dtype=int), *(np.arange(model.ends[k], model.ends[k + 1]) for k in hypothesis)]
            )
            at = np.concatenate([columns, nuisances])
            self.index.append(at)
            self.precision.append(information[np.ix_(at, at)] + np.diag(np.concatenate([np.ones(len(columns)), known])))

    def decided(self, rows: Rows, names: Sequence[tuple[str, ...]], probability: Floats, draws: int = 400) -> float:
        """Estimate the probability that an observation leaves a single explanation, by simulation to 2.5 %."""
        rng, information = np.random.default_rng(7), rows.information
        values, vectors = np.linalg.eigh((information + information.T) / 2.0)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        true = rng.choice(len(names), draws, p=probability)
        shown = root @ rng.normal(size=(len(information), draws))
        for h in np.unique(true):
            at, mine = self.index[h], np.flatnonzero(true == h)
            lower = cholesky(self.precision[h], lower=True)
            middle = cho_solve((lower, True), self.score[at])[:, None]
            unknowns = middle + solve_triangular(lower.T, rng.normal(size=(len(at), len(mine))))
            shown[:, mine] += information[:, at] @ unknowns
        return _single_name_share(names, self.updated(information, shown, probability))

    def updated(self, information: Floats, shown: Floats, probability: Floats) -> Floats:
        """Update the probability of each hypothesis with observations, (h, d).

        Args:
            information: information of the observation, (p + q + b, p + q + b).
            shown: score of the observations for the recording's unknowns, (p + q + b, d).
            probability: of each hypothesis before the observation, (h,).
        """
        log = np.empty((len(probability), shown.shape[1]))
        for h, at in enumerate(self.index[: len(probability)]):  # log probability of the observations, up to a constant
            before = cholesky(self.precision[h], lower=True)
            after = cholesky(self.precision[h] + information[np.ix_(at, at)], lower=True)
            score = self.score[at]
            pulled = solve_triangular(after, score[:, None] + shown[at], lower=True)
            before_half = solve_triangular(before, score, lower=True)
            volume = np.sum(np.log(np.diag(after))) - np.sum(np.log(np.diag(before)))
            log[h] = 0.5 * np.sum(pulled**2, axis=0) - 0.5 * before_half @ before_half - volume
        log = np.log(probability)[:, None] + log
        weight = np.exp(log - log.max(axis=0))
        return np.asarray(weight / weight.sum(axis=0))


def _single_name_share(names: Sequence[tuple[str, ...]], probability: Floats) -> float:
    """Compute the share of draws in which every stated effect, or their absence, is at least as probable as ``SURE``.

    Args:
        names: effects of each hypothesis.
        probability: of each hypothesis in each draw, (h, d).
    """
    count = np.array([len(names_left) for names_left in names])
    most = sum((probability[count >= k].sum(axis=0) > 0.5).astype(int) for k in range(1, MOST_EFFECTS + 1))
    sets = list(dict.fromkeys(names))
    each = np.array([probability[[other == names_left for other in names]].sum(axis=0) for names_left in sets])
    chosen = np.argmax(
        np.where(np.array([len(names_left) for names_left in sets])[:, None] == most, each, -1.0), axis=0
    )
    acting = {
        effect: probability[[effect in names_left for names_left in names]].sum(axis=0)
        for effect in {x for names_left in names for x in names_left}
    }
    sure = [
        each[k] >= SURE if not names_left else np.all([acting[x] >= SURE for x in names_left], axis=0)
        for k, names_left in enumerate(sets)
    ]
    return float(np.mean(np.array(sure)[chosen, np.arange(probability.shape[1])]))
