"""Which compositions a recording may show: all of them tried against what is left, the likeliest kept.

There are some thousands. Each is linear in its size, so that a product of two series is all that one costs; those that
are kept are weighed like any effect of the catalogue, by odds that share one effect's among all of them: equally among
what is acted on, the drivers, their forms and their places (description length).
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

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
LISTED = {  # what the catalogue has under a name of its own
    "field_horizontal": {"time/linear", "time/step", "temperature/linear", "depth/linear", "voltage/linear",
                         "pitch/linear", "roll/linear"},
    "reading": {"time/linear", "time/step", "temperature/linear", "voltage/linear", "turn_rate/linear",
                "turn_rate/sign"},
    "flow_direction": {"speed/linear", "depth/linear"},
}  # fmt: skip
THRESHOLDS = (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.96)  # quantiles of the driver
CENTRES = (0.2, 0.5, 0.8)  # quantiles of the driver, of what saturates
LATCHES = (0.98, 0.995)  # quantiles that a driver exceeds rarely
SCALES, WIDTHS = (0.3, 1.0), (1.0, 2.5)  # of the driver's standard deviation
LAGS_S = (0.5 * DAY_S, 3 * DAY_S, 15 * DAY_S)  # time constants, of a sphere's warming to a month of the sea
DATES, EDGES, LIVES = 30, 13, (0.04, 0.12, 0.35)  # dates tried, begins and ends, lives in shares of the record
SECTORS, REACHES_DEG = 24, (20.0, 40.0)  # of what acts around one heading
AROUND = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)  # steps, or powers of 2, between the places that are tried
MOST, MOST_OF_KIND, MOST_RIVALS = 40, 3, 8  # compositions that are weighed: seconds
MOST_NUMBERS = 1_500_000  # of columns that are held at once, which sets the memory of long records


@dataclass(frozen=True)
class Found:
    """A composition that may be there."""

    term: ComposedEffect
    log_share: float  # of the odds of one effect
    usual: Floats  # (p,) standard deviation that is expected of each parameter
    moved: bool = False  # whether it is at a place between those that are tried of all


def screen(state: FittedModel) -> list[Found]:
    """Return the compositions that would make what a simulation leaves likeliest, each with its share of the odds."""
    if not state.case.has_slow_noise:
        return []
    acted = {
        name: design.term_columns(state, compose_effect(name, "time", "always")()).columns
        for name in TARGETS
        if _acts(name, state)
    }
    places = _places(state.case.scene, state.case.units)
    forms = {name: Counter(one[0] for one in places if _nameless(name, *one)) for name in acted}
    tried: list[tuple[float, Found]] = []
    for batch in _batches(state, places):
        for name, bare in acted.items():
            own = [k for k, (driver, form, _) in enumerate(batch.places) if _nameless(name, driver, form)]
            if not own:
                continue
            gains, usual = _gains(state, bare, batch.only(own))
            for k, gain, expected in zip(own, gains, usual, strict=True):
                driver, form, at = batch.places[k]
                alike = forms[name][driver] * len(places[driver, form])
                log_count = float(np.log(len(acted) * len(forms[name]) * alike))
                term = place_effect(compose_effect(name, driver, form), *at)
                tried.append((gain - log_count, Found(term, -log_count, expected)))
    return _best(tried)


def near(term: ComposedEffect, scene: Scene) -> list[ComposedEffect]:
    """Return a composition at places around its own, at no size.

    Args:
        scene: of the recording.
    """
    steps = _steps(term, scene)
    places = {f.name: float(getattr(term, f.name)) for f in fields(term) if not f.metadata["step"]}
    tried = [
        [at + steps[name] * away for away in AROUND] if name in steps else [at * 2.0**away for away in AROUND]
        for name, at in places.items()
    ]
    bare = term.at(0.0 * term.values)
    return [replace(bare, **dict(zip(places, one, strict=True))) for one in itertools.product(*tried)]


def spacings(term: ComposedEffect, scene: Scene) -> dict[str, float]:
    """Return how far apart the places of a composition were tried in the end, by their names, dates left out.

    Args:
        scene: of the recording.
    """
    if not term.placed:
        return {}
    steps, apart = _steps(term, scene), AROUND[1] - AROUND[0]
    names = [f.name for f in fields(term) if not f.metadata["step"] and f.name not in ("begin_s", "end_s")]
    return {name: apart * steps.get(name, abs(float(getattr(term, name))) * float(np.log(2.0))) for name in names}


def _steps(term: ComposedEffect, scene: Scene) -> dict[str, float]:
    """Return the distance of the places that are tried of all, those that are tried in proportion left out."""
    spread, span = float(np.std(driver_series(scene, term.composition[1]))), float(np.ptp(scene.time_s))
    return {
        "begin_s": span / (EDGES + 1), "end_s": span / (EDGES + 1), "centre_deg": 360.0 / SECTORS,
        "threshold": spread / 3.0, "middle": spread / 2.0,
    }  # fmt: skip


def rivals(term: ComposedEffect, composed: Sequence[Found]) -> list[Found]:
    """Return a composition and others of its driver, those that have places, each kind at its best place so far."""
    alike = [one for one in composed if one.term.composition[1] == term.composition[1] and one.term.placed]
    coarse, moved = ([one for one in alike if one.moved is is_moved] for is_moved in (False, True))
    each = {type(one.term): one for one in (*reversed(coarse), *moved)}
    return sorted(each.values(), key=lambda one: type(one.term) is not type(term))[:MOST_RIVALS]


def with_more(first: Sequence[Found], second: Sequence[Found]) -> list[Found]:
    """Return compositions that were kept at one place and at another, each once."""
    return list({one.term: one for one in (*first, *second)}.values())


def _best(tried: list[tuple[float, Found]]) -> list[Found]:
    kept: list[Found] = []
    seen: dict[type, int] = {}
    for _, one in sorted(tried, key=lambda each: -each[0]):
        kind = type(one.term)
        if seen.get(kind, 0) < MOST_OF_KIND and len(kept) < MOST:
            seen[kind] = seen.get(kind, 0) + 1
            kept.append(one)
    return kept


def _acts(name: str, state: FittedModel) -> bool:
    """Tell whether the recording has what must be known to act on something."""
    return all(one in state.case.scene.departures for one in TARGETS[name].needs)


@dataclass(frozen=True)
class Batch:
    """Drivers in a form at a place, and the series that each makes, m of c columns."""

    places: list[tuple[str, str, tuple[float, ...]]]
    series: Floats  # (n, m, c) float32
    square: Floats  # (n, m, c)

    def only(self, some: Sequence[int]) -> Batch:
        """Return some of them."""
        if len(some) == len(self.places):
            return self
        return Batch([self.places[k] for k in some], self.series[:, some], self.square[:, some])


def _batches(state: FittedModel, places: Mapping[tuple[str, str], Sequence[tuple[float, ...]]]) -> Iterator[Batch]:
    """Return every driver in every form at every place, together those that have as many columns each."""
    scene, most = state.case.scene, max(MOST_NUMBERS // len(state.case), 1)
    for _, alike in itertools.groupby(places, key=lambda one: len(FORMS[one[1]].suffixes)):
        every = [(*one, at) for one in alike for at in places[one]]
        for own in (every[k : k + most] for k in range(0, len(every), most)):
            terms = [place_effect(compose_effect("reading", driver, form), *at) for driver, form, at in own]
            makers = [term.series if term.composition[2] == "memory" else term.made for term in terms]  # slow: kept
            series = np.stack([make(scene, state.case.recorded_deg) for make in makers], axis=1)
            yield Batch(own, series.astype(np.float32), series**2)


def _gains(state: FittedModel, bare: Floats, batch: Batch) -> tuple[list[float], Floats]:
    """Return the log evidence of each composition alone, its sizes integrated over, and what they usually are, (m, k).

    Args:
        bare: derivative of the heading by what is acted on, (n, p).
    """
    n, m, c = batch.series.shape
    turn = ((bare**2).T @ batch.square.reshape(n, -1) / n) ** 0.5
    usual = USUAL_DEG / np.maximum(turn, 1e-9).reshape(-1, m, c).transpose(1, 0, 2).reshape(m, -1)
    standard = (bare / state.whitener.width_deg[:, None] * state.response / state.sigma).astype(np.float32)
    made = standard[:, None, :, None] * batch.series[:, :, None, :]
    white = state.project_out_nuisance(state.whitener.filtered(made.reshape(n, -1)))
    pull = (white.T @ (state.innovation / state.sigma).astype(np.float32)).reshape(m, -1) * usual
    products = np.array([part.T @ part for part in np.split(white, m, axis=1)])
    lower = np.linalg.cholesky(products * usual[:, :, None] * usual[:, None, :] + np.eye(usual.shape[1]))
    half = np.linalg.solve(lower, pull[:, :, None])[:, :, 0]
    gains = 0.5 * np.sum(half**2, axis=1) - np.log(np.einsum("mkk->mk", lower)).sum(axis=1)
    return gains.tolist(), usual


def _nameless(name: str, driver: str, form: str) -> bool:
    """Tell whether a driver and a form compose with what is acted on, and the catalogue has no name for it."""
    if driver == "heading":
        return name == "reading"
    if driver == "time" and name == "flow_direction":
        return False  # what the water does along time stands in the noise
    return f"{driver}/{form}" not in LISTED.get(name, set()) and not ("*" in driver and name in LOBES)


def _varies(scene: Scene, driver: str) -> bool:
    name = DRIVERS[driver][0] if driver in DRIVERS else driver
    if name not in scene.departures:
        return False
    some = scene.departures[name][:: max(len(scene) // 500, 1)]
    return len(np.unique(some)) >= covariates.FEWEST_VALUES


def _places(scene: Scene, channels: Iterable[str]) -> dict[tuple[str, str], list[tuple[float, ...]]]:
    """Return every driver that the recording has with every form, and the places at which it is tried.

    Args:
        channels: series that have no name of their own here.
    """
    there = [one for one in (*VALUES, *channels) if _varies(scene, one)]
    joined = [one for one in there if one in VALUES and one != "tilt"]
    alone = [*itertools.product(there, OF_VALUE), *(("time", form) for form in OF_TIME)]
    if _varies(scene, "turn_rate"):
        alone.append(("turn_rate", "sign"))
    pairs = [(f"{a}*{b}", "linear") for a, b in itertools.combinations(sorted([*joined, "time"]), 2)]
    return {
        **{one: _places_of(scene, *one) for one in (*alone, *pairs)},
        ("hour", "periodic"): [(DAY_S,), (DAY_S / 2.0,)],
        ("tide", "periodic"): [(TIDE_S,)],
        ("heading", "bump"): [(360.0 / SECTORS * k, reach) for k in range(SECTORS) for reach in REACHES_DEG],
    }


def _places_of(scene: Scene, driver: str, form: str) -> list[tuple[float, ...]]:
    """Return the places at which a form is tried."""
    time_s, x = scene.time_s, driver_series(scene, driver)
    span, width = float(np.ptp(time_s)), float(np.std(x))
    if form == "threshold":
        return [(float(one),) for one in np.unique(np.quantile(x, THRESHOLDS))]
    if form == "latch":
        return [(float(one),) for one in np.unique(np.quantile(x, LATCHES))]
    if form == "saturating":
        return [(float(np.quantile(x, centre)), share * width) for centre in CENTRES for share in SCALES]
    if form == "memory":
        return [(share * width,) for share in WIDTHS]
    if form == "lagged":
        return [(one,) for one in LAGS_S]
    edges = time_s[0] + span * np.linspace(0.0, 1.0, EDGES + 2)[1:-1]
    if form == "step":
        return [(float(one),) for one in time_s[0] + span * np.linspace(0.0, 1.0, DATES + 2)[1:-1]]
    if form in ("box", "ramp"):
        ends = [time_s[0], *edges, time_s[-1]] if form == "ramp" else edges
        return [(float(a), float(b)) for a, b in itertools.combinations(ends, 2) if (a, b) != (ends[0], ends[-1])]
    if form in ("decay", "growth"):
        begins = [float(time_s[0 if form == "decay" else -1])]
        return [(begin, share * span) for begin in begins for share in LIVES]
    return [()]
