"""Which compositions a recording may show: all of them tried against what is left, the likeliest kept.

There are some thousands. Each is linear in its size, so that a product of two series is all that one costs; those that
are kept are weighed like any effect of the catalogue, by odds that share one effect's among all of them: equally among
what is acted on, the drivers, their forms and their places (description length).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from compasslib.core.types import Floats
from compasslib.effects.composed import (
    ACTED_ON,
    DAY_S,
    DRIVERS,
    LOBES,
    TIDE_S,
    Composed,
    composed,
    driven,
    placed,
)
from compasslib.effects.term import USUAL_DEG, Scene
from compasslib.search import columns
from compasslib.search.baseline import State

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
CENTRES = (0.2, 0.5, 0.8)
LATCHES = (0.98, 0.995)
SCALES, WIDTHS = (0.3, 1.0), (1.0, 2.5)  # of the driver's standard deviation
LAGS_S = (0.5 * DAY_S, 3 * DAY_S, 15 * DAY_S)
DATES, EDGES, LIVES = 30, 13, (0.04, 0.12, 0.35)  # dates tried, begins and ends, lives in shares of the record
SECTORS, REACHES_DEG = 24, (20.0, 40.0)
AROUND = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)  # steps, or powers of 2, between the places that are tried
MOST, MOST_OF_KIND, MOST_RIVALS = 40, 3, 8
SEEN = 5  # different values of a driver below which it says nothing
MOST_NUMBERS = 3_000_000  # of columns that are held at once, which sets the memory of long records


@dataclass(frozen=True)
class Found:
    """A composition that may be there."""

    term: Composed
    log_share: float  # of the odds of one effect
    usual: Floats  # (p,) standard deviation that is expected of each parameter
    moved: bool = False  # whether it is at a place between those that are tried of all


def screen(state: State) -> list[Found]:
    """Return the compositions that would make what a simulation leaves likeliest, each with its share of the odds."""
    if state.case.kind != "mooring":
        return []
    scene, reading = state.case.scene, state.case.recorded_deg
    acted = [name for name in ACTED_ON if _acts(name, state)]
    tried: list[tuple[float, Found]] = []
    for name in acted:
        bare = columns.of_term(state, composed(name, "time", "always")()).columns
        every = list(_terms(name, scene, (*VALUES, *state.case.channels)))
        drivers = {term.composition[1] for term in every}
        forms = {driver: {t.composition[2] for t in every if t.composition[1] == driver} for driver in drivers}
        places: dict[tuple[str, str, str], int] = {}
        for term in every:
            places[term.composition] = places.get(term.composition, 0) + 1
        series = [term.series(scene, reading) for term in every]
        size = max(MOST_NUMBERS // (len(bare) * bare.shape[1]), 1)
        batches = (series[k : k + size] for k in range(0, len(series), size))
        gains = [gain for batch in batches for gain in _gains(state, bare, batch)]
        for term, (gain, usual) in zip(every, gains, strict=True):
            _, driver, _ = term.composition
            count = len(acted) * len(drivers) * len(forms[driver]) * places[term.composition]
            tried.append((gain - float(np.log(count)), Found(term, -float(np.log(count)), usual)))
    scene.__dict__.pop("composed", None)  # hundreds of series: what is kept is few
    return _best(tried)


def near(term: Composed, scene: Scene) -> list[Composed]:
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


def spacings(term: Composed, scene: Scene) -> dict[str, float]:
    """Return how far apart the places of a composition were tried in the end, by their names, dates left out.

    Args:
        scene: of the recording.
    """
    if not term.placed:
        return {}
    steps, apart = _steps(term, scene), AROUND[1] - AROUND[0]
    names = [f.name for f in fields(term) if not f.metadata["step"] and f.name not in ("begin_s", "end_s")]
    return {name: apart * steps.get(name, abs(float(getattr(term, name))) * float(np.log(2.0))) for name in names}


def _steps(term: Composed, scene: Scene) -> dict[str, float]:
    """Return the distance of the places that are tried of all, those that are tried in proportion left out."""
    spread, span = float(np.std(driven(scene, term.composition[1]))), float(np.ptp(scene.time_s))
    return {
        "begin_s": span / (EDGES + 1), "end_s": span / (EDGES + 1), "centre_deg": 360.0 / SECTORS,
        "threshold": spread / 3.0, "middle": spread / 2.0,
    }  # fmt: skip


def rivals(term: Composed, composed: Sequence[Found]) -> list[Found]:
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


def _acts(name: str, state: State) -> bool:
    """Tell whether the recording has what must be known to act on something."""
    return all(one in state.case.scene.departures for one in ACTED_ON[name].needs)


def _gains(state: State, bare: Floats, series: list[Floats]) -> list[tuple[float, Floats]]:
    """Return the log evidence of each composition alone, its sizes integrated over, and what they usually are.

    Args:
        bare: derivative of the heading by what is acted on, (n, p).
        series: of each composition, (n, c).
    """
    made, expected = [], []
    for one in series:
        both = (bare[:, :, None] * one[:, None, :]).reshape(len(bare), -1).astype(np.float32)
        turn = np.sqrt(np.mean(both.astype(float) ** 2, axis=0))
        usual = USUAL_DEG / np.maximum(turn, 1e-9)
        made.append(both * usual.astype(np.float32))
        expected.append(usual)
    white = state.projected(np.concatenate(made, axis=1)) * np.float32(state.response / state.sigma)
    pulls = white.T @ (state.innovation / state.sigma).astype(np.float32)
    result, at = [], 0
    for usual in expected:
        width = len(usual)
        own, pull = white[:, at : at + width], pulls[at : at + width].astype(float)
        information = np.eye(width) + (own.T @ own).astype(float)
        gain = 0.5 * pull @ np.linalg.solve(information, pull) - 0.5 * np.linalg.slogdet(information)[1]
        result.append((float(gain), usual))
        at += width
    return result


def _terms(name: str, scene: Scene, values: Sequence[str]) -> Iterator[Composed]:
    """Return every composition of what is acted on with what the recording has, at every place."""
    listed = LISTED.get(name, set())
    there = [one for one in values if _varies(scene, one)]
    for driver, form in [*itertools.product(there, OF_VALUE), *(("time", form) for form in OF_TIME)]:
        if f"{driver}/{form}" in listed or (driver == "time" and name == "flow_direction"):
            continue  # what the water does along time stands in the noise
        kind = composed(name, driver, form)
        yield from (placed(kind, *at) for at in _places(scene, driver, form))
    if _varies(scene, "turn_rate") and "turn_rate/sign" not in listed:
        yield composed(name, "turn_rate", "sign")()
    for period_s in (DAY_S, DAY_S / 2.0):
        yield placed(composed(name, "hour", "periodic"), period_s)
    yield placed(composed(name, "tide", "periodic"), TIDE_S)
    if name == "reading":
        kind = composed(name, "heading", "bump")
        yield from (placed(kind, 360.0 / SECTORS * k, reach) for k in range(SECTORS) for reach in REACHES_DEG)
    joined = [one for one in there if one in VALUES and one != "tilt"]
    for first, second in itertools.combinations(sorted([*joined, "time"]), 2):
        if name not in LOBES:
            yield composed(name, f"{first}*{second}", "linear")()


def _varies(scene: Scene, driver: str) -> bool:
    name = DRIVERS[driver][0] if driver in DRIVERS else driver
    return name in scene.departures and len(np.unique(scene.departures[name][:: max(len(scene) // 500, 1)])) >= SEEN


def _places(scene: Scene, driver: str, form: str) -> list[tuple[float, ...]]:
    """Return the places at which a form is tried."""
    time_s, x = scene.time_s, driven(scene, driver)
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
