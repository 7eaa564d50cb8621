"""Screening of composed effects: all compositions are scored against a residual, and the most probable are selected.

There are some thousands. Each is linear in its size, so that its score costs one product of two series. Selected
compositions enter the posterior like effects of the catalogue. The prior odds of a single effect are divided among all
of them: equally among targets, drivers, forms and places (description length).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from compasslib.effects import CATALOGUE
from compasslib.effects.composed import (
    DRIVERS,
    FORMS,
    LOBES,
    TARGETS,
    TIDE_S,
    ComposedEffect,
    compose_effect,
    driver_series,
    place_effect,
)
from compasslib.effects.effect import DAY_S, USUAL_DEG, Scene
from compasslib.inference import covariates, design
from compasslib.inference.design import FittedModel
from compasslib.types import Floats

VALUES = ("temperature", "depth", "speed", "pitch", "roll", "tilt", "voltage")
OF_VALUE = ("linear", "quadratic", "threshold", "saturating", "lagged", "memory", "latch")
OF_TIME = ("linear", "quadratic", "step", "box", "ramp", "decay", "growth")
LISTED = {  # driver/form by target that the catalogue has as a class of its own
    "field_horizontal": {"time/linear", "time/step", "temperature/linear", "voltage/linear"},
    "reading": {"time/linear", "time/step", "temperature/linear", "voltage/linear", "turn_rate/linear"},
}
NAMED = {kind.composition for kind in CATALOGUE if issubclass(kind, ComposedEffect)}
THRESHOLDS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.96)  # quantiles of the driver
CENTRES = (0.2, 0.5, 0.8)  # quantiles of the driver at the middle of a saturating form
LATCHES = (0.98, 0.995)  # quantiles of the driver at the threshold of a latch, rarely exceeded
SCALES, WIDTHS = (0.3, 1.0), (1.0, 2.5)  # range of saturation and width of hysteresis, in driver standard deviations
LAGS_S = (0.5 * DAY_S, 3 * DAY_S, 15 * DAY_S)  # time constants, from warming of an instrument to monthly changes
DATES, EDGES, LIFETIMES = 30, 13, (0.04, 0.12, 0.35)  # step dates; box and ramp edges; time constants over duration
SECTORS, REACHES_DEG = 24, (20.0, 40.0)  # centres and half-widths of a bump along heading
AROUND = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)  # refinement of places, in grid steps or powers of 2
MOST, MOST_OF_KIND, MOST_RIVALS = 40, 3, 8  # compositions selected, of one kind, and refined; limited for speed
MOST_NUMBERS = 1_500_000  # values of series held at once, which limits the memory for long records


@dataclass(frozen=True)
class Composition:
    """A composition that passed the screening."""

    term: ComposedEffect
    log_share: float  # of the prior odds of a single effect
    usual: Floats  # (p,) prior standard deviation of each parameter
    moved: bool = False  # whether its place is refined between those of the screening


def screen(state: FittedModel, drivers: Collection[str] = ()) -> list[Composition]:
    """Select the compositions of highest posterior probability given the residual of a simulation.

    Args:
        drivers: only effects on the reading with one of these drivers; all compositions if empty.
    """
    if not state.case.has_slow_noise:
        return []
    target = (state.innovation / state.sigma).astype(np.float32)[:, None]
    scored = [
        (gain + composition.log_share, composition)
        for batch, gains in _screened(state, target, np.full(len(state.case), -1), drivers)
        for composition, gain in zip(batch, gains[:, 0, 0].tolist(), strict=True)
    ]
    chosen: list[Composition] = []
    counts: dict[type, int] = {}
    for _, composition in sorted(scored, key=lambda each: -each[0]):
        kind = type(composition.term)
        if counts.get(kind, 0) < MOST_OF_KIND and len(chosen) < MOST:
            counts[kind] = counts.get(kind, 0) + 1
            chosen.append(composition)
    return chosen


def screen_folds(
    state: FittedModel, targets: Floats, fold: NDArray[np.intp], most: int
) -> dict[tuple[int, int], list[Composition]]:
    """Screen compositions with each fold of the recording left out, for several residuals at once.

    Args:
        targets: whitened residuals, (n, r).
        fold: number of the fold of each sample, (n,).
        most: number of compositions selected for each fold and residual.

    Returns:
        Compositions by number of fold and residual, most probable first.
    """
    best: dict[tuple[int, int], list[tuple[float, Composition]]] = {}
    if not state.case.has_slow_noise:
        return {}
    for batch, gains in _screened(state, targets, fold):
        scores = gains + np.array([composition.log_share for composition in batch])[:, None, None]
        first = np.argsort(-scores, axis=0)[:most]
        for f, r in np.ndindex(scores.shape[1:]):
            better = [(float(scores[k, f, r]), batch[k]) for k in first[:, f, r]]
            best[f, r] = sorted([*best.get((f, r), []), *better], key=lambda each: -each[0])[:most]
    return {key: [composition for _, composition in each] for key, each in best.items()}


def _screened(
    state: FittedModel, targets: Floats, fold: NDArray[np.intp], drivers: Collection[str] = ()
) -> Iterator[tuple[list[Composition], Floats]]:
    """Yield compositions with the log evidence of each alone, one fold left out, (m, f, r); a fold of -1 is none."""
    acted = {
        name: design.term_columns(state, compose_effect(name, "time", "always")()).columns
        for name, target in TARGETS.items()
        if target.side != "water" and all(needed in state.case.scene.departures for needed in TARGETS[name].needs)
    }
    places = _places(state.case.scene, state.case.units)
    forms = {name: Counter(pair[0] for pair in places if _is_unlisted(name, *pair)) for name in acted}
    selected = {key: at for key, at in places.items() if not drivers or key[0] in drivers}
    for batch in _batches(state, selected):
        for name, derivative in acted.items():
            if drivers and name != "reading":
                continue
            unlisted = [k for k, (driver, form, _) in enumerate(batch.places) if _is_unlisted(name, driver, form)]
            if not unlisted:
                continue
            gains, usual = _gains(state, derivative, batch.only(unlisted), targets, fold)
            compositions = []
            for k, expected in zip(unlisted, usual, strict=True):
                driver, form, at = batch.places[k]
                alike = forms[name][driver] * len(places[driver, form])
                log_count = float(np.log(len(acted) * len(forms[name]) * alike))
                term = place_effect(compose_effect(name, driver, form), *at)
                compositions.append(Composition(term, -log_count, expected))
            yield compositions, gains


def near(term: ComposedEffect, scene: Scene) -> list[ComposedEffect]:
    """List a composition, at zero size, at places around its own."""
    steps = _steps(term, scene)
    places = {f.name: float(getattr(term, f.name)) for f in fields(term) if not f.metadata["step"]}
    grid = [
        [at + steps[name] * away for away in AROUND] if name in steps else [at * 2.0**away for away in AROUND]
        for name, at in places.items()
    ]
    zero_term = term.at(0.0 * term.values)
    return [replace(zero_term, **dict(zip(places, place, strict=True))) for place in itertools.product(*grid)]


def spacings(term: ComposedEffect, scene: Scene) -> dict[str, float]:
    """Compute the spacing of the refined places of a composition, by name, without begin and end."""
    if not term.placed:
        return {}
    steps, apart = _steps(term, scene), AROUND[1] - AROUND[0]
    names = [f.name for f in fields(term) if not f.metadata["step"] and f.name not in ("begin_s", "end_s")]
    return {name: apart * steps.get(name, abs(float(getattr(term, name))) * float(np.log(2.0))) for name in names}


def _steps(term: ComposedEffect, scene: Scene) -> dict[str, float]:
    """Compute the grid steps of the places, by name, without those that are refined by powers of 2."""
    spread, span = float(np.std(driver_series(scene, term.composition[1]))), float(np.ptp(scene.time_s))
    return {
        "begin_s": span / (EDGES + 1), "end_s": span / (EDGES + 1), "centre_deg": 360.0 / SECTORS,
        "threshold": spread / 3.0, "middle": spread / 2.0,
    }  # fmt: skip


def rivals(term: ComposedEffect, composed: Sequence[Composition]) -> list[Composition]:
    """Select a composition and its alternatives with the same driver and with places, each kind at its best place."""
    driver = term.composition[1]
    alike = [rival for rival in composed if rival.term.composition[1] == driver and rival.term.placed]
    alike = [*(rival for rival in reversed(alike) if not rival.moved), *(rival for rival in alike if rival.moved)]
    each = {type(rival.term): rival for rival in alike}
    return sorted(each.values(), key=lambda rival: type(rival.term) is not type(term))[:MOST_RIVALS]


def merge_compositions(first: Sequence[Composition], second: Sequence[Composition]) -> list[Composition]:
    """Merge two selections of compositions without duplicates."""
    return list({each.term: each for each in (*first, *second)}.values())


@dataclass(frozen=True)
class Batch:
    """Combinations of driver, form and place, with the series of each; m combinations of c columns."""

    places: list[tuple[str, str, tuple[float, ...]]]
    series: Floats  # (n, m, c) float32
    square: Floats  # (n, m, c) squares of ``series`` in full precision

    def only(self, indices: Sequence[int]) -> Batch:
        """Select combinations by index."""
        if len(indices) == len(self.places):
            return self
        return Batch([self.places[k] for k in indices], self.series[:, indices], self.square[:, indices])


def _batches(state: FittedModel, places: Mapping[tuple[str, str], Sequence[tuple[float, ...]]]) -> Iterator[Batch]:
    """Yield every driver in every form at every place, in batches with the same number of columns each."""
    scene, most = state.case.scene, max(MOST_NUMBERS // len(state.case), 1)
    for _, alike in itertools.groupby(places, key=lambda pair: len(FORMS[pair[1]].suffixes)):
        combinations = [(*pair, at) for pair in alike for at in places[pair]]
        for chunk in (combinations[k : k + most] for k in range(0, len(combinations), most)):
            terms = [place_effect(compose_effect("reading", driver, form), *at) for driver, form, at in chunk]
            makers = [term.series if term.composition[2] == "memory" else term.made for term in terms]  # cached if slow
            series = np.stack([make(scene, state.case.recorded_deg) for make in makers], axis=1)
            yield Batch(chunk, series.astype(np.float32), series**2)


def _gains(
    state: FittedModel, derivative: Floats, batch: Batch, targets: Floats, fold: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Compute log evidence of each composition alone, one fold left out, (m, f, r), and prior sizes, (m, k).

    Args:
        derivative: derivative of the heading with respect to the target's parameters, (n, p).
        targets: whitened residuals, (n, r).
        fold: number of the fold of each sample, (n,).
    """
    n, m, c = batch.series.shape
    turn = ((derivative**2).T @ batch.square.reshape(n, -1) / n) ** 0.5
    usual = USUAL_DEG / np.maximum(turn, 1e-9).reshape(-1, m, c).transpose(1, 0, 2).reshape(m, -1)
    standard = (derivative / state.whitener.width_deg[:, None] * state.response / state.sigma).astype(np.float32)
    made = standard[:, None, :, None] * batch.series[:, :, None, :]
    white = state.project_out_nuisance(state.whitener.filtered(made.reshape(n, -1)))
    left_out = [fold == f for f in np.unique(fold)] if fold[0] >= 0 else [np.zeros(len(fold), dtype=bool)]
    pull, square = white.T @ targets, _squares(white, m)
    gains = np.empty((m, len(left_out), targets.shape[1]))
    for f, out in enumerate(left_out):
        part = white[out]
        products = (square - _squares(part, m)) * usual[:, :, None] * usual[:, None, :]
        lower = np.linalg.cholesky(products + np.eye(usual.shape[1]))
        training = (pull - part.T @ targets[out]).reshape(m, -1, targets.shape[1]) * usual[:, :, None]
        half = np.linalg.solve(lower, training)
        gains[:, f] = 0.5 * np.sum(half**2, axis=1) - np.log(np.einsum("mkk->mk", lower)).sum(axis=1)[:, None]
    return gains, usual


def _squares(white: Floats, m: int) -> Floats:
    """Compute the products of the columns of each composition with each other, (m, k, k)."""
    return np.array([part.T @ part for part in np.split(white, m, axis=1)])


def _is_unlisted(name: str, driver: str, form: str) -> bool:
    """Return whether a driver and a form can be combined with a target and are not an effect of the catalogue."""
    if driver == "heading":
        return name == "reading"
    listed = (name, driver, form) in NAMED or f"{driver}/{form}" in LISTED.get(name, set())
    return not listed and not ("*" in driver and name in LOBES)


def _varies(scene: Scene, driver: str) -> bool:
    name = DRIVERS[driver][0] if driver in DRIVERS else driver
    if name not in scene.departures:
        return False
    sample = scene.departures[name][:: max(len(scene) // 500, 1)]
    return len(np.unique(sample)) >= covariates.FEWEST_VALUES


def _places(scene: Scene, channels: Iterable[str]) -> dict[tuple[str, str], list[tuple[float, ...]]]:
    """List every available driver with every form, and the places at which each is screened.

    Args:
        channels: names of instrument-specific series.
    """
    there = [driver for driver in (*VALUES, *channels) if _varies(scene, driver)]
    joined = [driver for driver in there if driver in VALUES and driver != "tilt"]
    alone = [*itertools.product(there, OF_VALUE), *(("time", form) for form in OF_TIME)]
    if _varies(scene, "turn_rate"):
        alone.append(("turn_rate", "sign"))
    pairs = [(f"{a}*{b}", "linear") for a, b in itertools.combinations(sorted([*joined, "time"]), 2)]
    return {
        **{pair: _places_of(scene, *pair) for pair in (*alone, *pairs)},
        ("hour", "periodic"): [(DAY_S,), (DAY_S / 2.0,)],
        ("tide", "periodic"): [(TIDE_S,)],
        ("heading", "bump"): [(360.0 / SECTORS * k, reach) for k in range(SECTORS) for reach in REACHES_DEG],
    }


def _places_of(scene: Scene, driver: str, form: str) -> list[tuple[float, ...]]:
    """List the places at which a form is screened."""
    time_s, x = scene.time_s, driver_series(scene, driver)
    span, width = float(np.ptp(time_s)), float(np.std(x))
    if form == "threshold":
        return [(float(value),) for value in np.unique(np.quantile(x, THRESHOLDS))]
    if form == "latch":
        return [(float(value),) for value in np.unique(np.quantile(x, LATCHES))]
    if form == "saturating":
        return [(float(np.quantile(x, centre)), share * width) for centre in CENTRES for share in SCALES]
    if form == "memory":
        return [(share * width,) for share in WIDTHS]
    if form == "lagged":
        return [(value,) for value in LAGS_S]
    edges = time_s[0] + span * np.linspace(0.0, 1.0, EDGES + 2)[1:-1]
    if form == "step":
        return [(float(value),) for value in time_s[0] + span * np.linspace(0.0, 1.0, DATES + 2)[1:-1]]
    if form in ("box", "ramp"):
        ends = [time_s[0], *edges, time_s[-1]] if form == "ramp" else edges
        return [(float(a), float(b)) for a, b in itertools.combinations(ends, 2) if (a, b) != (ends[0], ends[-1])]
    if form in ("decay", "growth"):
        begins = [float(time_s[0 if form == "decay" else -1])]
        return [(begin, share * span) for begin in begins for share in LIFETIMES]
    return [()]
