"""Candidate effects in blocks of one target and one driver, each with a few forms, linearized at a fitted model.

The effects of the catalogue are forms of their blocks. All blocks are equally probable beforehand, and so are the forms
of a block; dates share the probability of their form by the time that each represents.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib.effects import Effect, Scene
from compasslib.effects.composed import (
    DRIVERS,
    LOBES,
    TARGETS,
    TIDE_S,
    ComposedEffect,
    compose_effect,
    driver_series,
    place_effect,
)
from compasslib.effects.effect import DAY_S
from compasslib.inference import covariates, design
from compasslib.inference.design import FittedModel
from compasslib.inference.finding import TILTS
from compasslib.statistics.whitening import sampling_interval_s
from compasslib.types import Floats

VALUES = ("temperature", "depth", "speed", "pitch", "roll", "tilt", "voltage")
WITH_HISTORY = ("temperature", "depth", "voltage")  # whose effects may lag behind them; so does the current by speed
OF_FIELD = ("time", "temperature", "depth", "speed", "pitch", "roll", "voltage")  # may magnetize iron, or move it
OF_LOBES = ("time", "temperature", "depth", "speed")  # may bend a sensor's axes
PLAYS = (1.0, 2.5)  # widths of hysteresis, standard deviations of the driver
PAIRS_SHARE = 0.15  # of the prior odds, for products of two drivers
BOX_LENGTHS, BOX_STEP = (0.08, 0.16), 0.08  # of temporary offsets, as shares of the record
GROUPS = {"field_horizontal": "field", "field_down": "field", "lobe3": "lobe", "lobe4": "lobe"}  # of targets
HARMONIC_NAMES = ("sextantal", "octantal")

DATE_MARGIN, COARSEST_S, MOST_DATES = 0.04, 10 * DAY_S, 60  # share without dates at each end; first spacing of dates
MOST_PLACES, CLOSE_S = 2, 12 * DAY_S  # places that are refined, and their least distance
STEEP = 1.0  # difference in log likelihood between neighbouring dates from which dates are tried between them
NEGLIGIBLE = 8.0  # log likelihood below the best from which a refined date is left out
LEAST_TURN_DEG = 1e-9  # rms, below which columns are left out


@dataclass(frozen=True)
class Option:
    """One form of a block: an effect at zero size, with its columns."""

    term: Effect
    block: tuple[str, str, str]  # side, target, driver
    columns: Floats  # (n, k) float32, degrees for one prior standard deviation at an amplitude of 1 degree
    usual: Floats  # (k,) values of the term's parameters at that standard deviation
    sized: bool = False  # whether physics gives the size, so that the amplitude is 1
    cell: float = 1.0  # share of its form, where a form has several dates or places
    share: float = 0.0  # log prior probability, given one effect

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.term.name


def enumerate_options(freed: FittedModel, midpoint: FittedModel) -> tuple[Option, ...]:
    """Enumerate the forms of all blocks that a recording can show.

    Args:
        freed: model whose residual and whitener determine the dates that are tried; its terms are freed.
        midpoint: the model at which columns are linearized.
    """
    standing = {type(term): term for term in midpoint.simulation.terms}
    made = (*_listed(freed, midpoint, standing), *_composed(midpoint))
    return tuple(with_shares([option for option in made if option.columns.shape[1]]))


def _listed(freed: FittedModel, midpoint: FittedModel, standing: Mapping[type[Effect], Effect]) -> Iterator[Option]:
    """Yield the effects of the catalogue, dated ones at each date."""
    for kind in midpoint.comparison.terms:
        if kind.side == "water":
            continue  # part of the noise
        block = block_of(kind)
        if not kind.dated():
            yield scaled_option(midpoint, kind(), block)
            continue
        derivative = design.term_columns(midpoint, kind())
        known = (standing[kind].date,) if kind in standing else ()
        dates, shares = search_dates(freed, derivative, known)
        since = midpoint.comparison.scene.since
        for date, share in zip(dates.tolist(), shares.tolist(), strict=True):
            term = replace(kind(), date_s=date)  # type: ignore[call-arg]
            yield _scaled(term, block, derivative * since(date)[:, None], share)


def _composed(midpoint: FittedModel) -> Iterator[Option]:
    """Yield the forms that the catalogue does not list."""
    scene = midpoint.comparison.scene
    acted = {
        target: design.term_columns(midpoint, compose_effect(target, "time", "always")())
        for target, place in TARGETS.items()
        if place.side != "water"
    }
    listed = {kind.composition for kind in midpoint.comparison.terms if issubclass(kind, ComposedEffect)}
    for target, driver, form, *places in _compositions(scene, midpoint.comparison.units):
        for at in places or [()]:
            kind = compose_effect(target, driver, form)
            if kind.composition in listed or (target, driver, form) in LISTED:
                continue
            term = place_effect(kind, *at)
            series = term.evaluate(scene, midpoint.comparison.recorded_deg)
            columns = (acted[target][:, :, None] * series[:, None, :]).reshape(len(series), -1)
            block = "compass", GROUPS.get(target, target), TILTS.get(driver, driver)
            yield _scaled(term, block, columns, 1.0 / max(len(places), 1))


LISTED = {  # compositions that classes of the catalogue represent
    *(("field_horizontal", driver, "linear") for driver in ("time", "temperature", "voltage")),
    *(("reading", driver, "linear") for driver in ("time", "temperature", "voltage", "turn_rate")),
}


def _compositions(scene: Scene, channels: Mapping[str, str]) -> Iterator[tuple]:
    """Yield target, driver, form and the places that are tried of each composition."""
    time_s = scene.time_s
    first, last = float(time_s[0]), float(time_s[-1])
    there = [driver for driver in (*VALUES, *channels) if _varies(scene, driver)]
    for driver in there:
        x = driver_series(scene, driver)
        middle, width = float(np.median(x)), float(np.std(x))
        forms = [("linear",), ("smooth", (middle, width)), ("memory", *((play * width,) for play in PLAYS))]
        forms += [("bands",)] if driver in WITH_HISTORY or driver in channels else []
        targets = ["reading"] + ["field_horizontal"] * (driver in OF_FIELD)
        yield from ((target, driver, *form) for target in targets for form in forms)
        yield from ((lobe, driver, "linear") for lobe in LOBES if driver in OF_LOBES)
        if driver in OF_LOBES:
            yield "field_down", driver, "linear"
    if _varies(scene, "turn_rate"):
        x = driver_series(scene, "turn_rate")
        yield "reading", "turn_rate", "sign"
        yield "reading", "turn_rate", "smooth", (0.0, float(np.std(x)))
    for target in ("reading", "field_horizontal"):
        yield target, "time", "linear"
        yield target, "time", "slow", (first, last)
        yield target, "hour", "periodic", (DAY_S,)
        yield target, "hour", "daily"
        yield target, "tide", "periodic", (TIDE_S,)
        yield target, "tide", "tidal"
    yield "field_horizontal", "time", "free", (first, last)
    yield "field_down", "time", "linear"
    yield from ((lobe, "time", "linear") for lobe in LOBES)
    begins = np.arange(BOX_STEP / 2.0, 1.0 - BOX_STEP, BOX_STEP)
    spans = [(begin, begin + length) for length in BOX_LENGTHS for begin in begins if begin + length < 1.0]
    yield "reading", "time", "box", *((first + (last - first) * a, first + (last - first) * b) for a, b in spans)
    yield "reading", "heading", "harmonics"
    yield "reading", "heading", "teeth"
    joined = sorted([*(driver for driver in there if driver in VALUES and driver != "tilt"), "time"])
    yield from (("reading", f"{a}*{b}", "linear") for a, b in itertools.combinations(joined, 2))


def _varies(scene: Scene, driver: str) -> bool:
    name = DRIVERS[driver][0] if driver in DRIVERS else driver
    if name not in scene.departures:
        return False
    sample = scene.departures[name][:: max(len(scene) // 500, 1)]
    return len(np.unique(sample)) >= covariates.FEWEST_VALUES


def block_of(kind: type[Effect]) -> tuple[str, str, str]:
    """Name the block of an effect: side, target and driver."""
    return kind.side, _target(kind), TILTS.get(kind.driver, kind.driver)


def _target(kind: type[Effect]) -> str:
    if issubclass(kind, ComposedEffect):
        return GROUPS.get(kind.composition[0], kind.composition[0])
    if kind.side == "reference":
        return "reference"
    return "lobe" if kind.name in HARMONIC_NAMES else kind.acts_on


def scaled_option(midpoint: FittedModel, term: Effect, block: tuple[str, str, str] = ("", "", "")) -> Option:
    """Linearize one effect at a fitted model."""
    return _scaled(term, block, design.term_columns(midpoint, term))


def _scaled(term: Effect, block: tuple[str, str, str], derivative: Floats, cell: float = 1.0) -> Option:
    """Scale columns, (n, k) degrees per unit, to equal sizes and a mean square of 1 together."""
    with np.errstate(divide="ignore"):
        expected = type(term).expected() ** -0.5
    if np.all(np.isfinite(expected)):
        return Option(term, block, (derivative * expected).astype(np.float32), expected, True, cell)
    turn = np.std(derivative, axis=0)
    acting = turn > LEAST_TURN_DEG * max(float(turn.max(initial=0.0)), 1.0)
    if not acting.any():
        return Option(term, block, np.zeros((len(derivative), 0), dtype=np.float32), np.zeros(0), cell=cell)
    usual = np.where(acting, 1.0 / np.where(acting, turn, 1.0), 0.0) / np.sqrt(acting.sum())
    return Option(term, block, (derivative * usual).astype(np.float32), usual, cell=cell)


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


def search_dates(freed: FittedModel, derivative: Floats, known: tuple[float, ...] = ()) -> tuple[Floats, Floats]:
    """Choose the dates at which a step is tried, coarse to fine, and the share of the record that each represents.

    Where the likelihood changes steeply between dates ten days apart, days and then samples are tried between them.

    Args:
        derivative: columns of the step's effect throughout, (n, k) degrees per unit.
        known: dates that are tried in any case.
    """
    time_s = freed.comparison.scene.time_s
    step = sampling_interval_s(time_s)
    low, high = np.quantile(time_s, [DATE_MARGIN, 1.0 - DATE_MARGIN])
    coarse = np.union1d(np.arange(low, high, max(COARSEST_S, (high - low) / MOST_DATES)), known)
    gains = _step_gains(freed, derivative)
    dates, gain = coarse, gains(coarse)
    for spacing in (DAY_S, step):
        places: list[int] = []
        for k in np.argsort(-gain).tolist():
            if len(places) < MOST_PLACES and all(abs(dates[k] - dates[other]) > CLOSE_S for other in places):
                places.append(k)
        between = [np.zeros(0)]
        for k in places:
            left, right = max(k - 1, 0), min(k + 1, len(dates) - 1)
            if gain[k] - min(gain[left], gain[right]) >= STEEP:
                inside = time_s[(time_s > dates[left]) & (time_s < dates[right])] - step / 2.0
                between.append(inside if spacing == step else np.arange(dates[left] + spacing, dates[right], spacing))
        if len(new := np.setdiff1d(np.concatenate(between), dates)):
            dates, gain = np.append(dates, new), np.append(gain, gains(new))
            order = np.argsort(dates)
            dates, gain = dates[order], gain[order]
    kept = np.isin(dates, coarse) | (gain > gain.max() - NEGLIGIBLE)
    dates = dates[kept]
    edges = np.concatenate([[time_s[0]], (dates[1:] + dates[:-1]) / 2.0, [time_s[-1]]])
    return dates, np.diff(edges) / float(np.ptp(time_s))


def _step_gains(freed: FittedModel, derivative: Floats) -> Callable[[Floats], Floats]:
    """Return a function that computes the gain in log likelihood by a step at each of several dates, (d,)."""
    scale = np.std(derivative, axis=0)
    unit = (derivative / np.where(scale > 0.0, scale, 1.0)).astype(np.float32)
    target = (freed.innovation / freed.sigma).astype(np.float32)

    def gains(dates_s: Floats) -> Floats:
        since = (freed.comparison.scene.time_s[:, None] >= dates_s).astype(np.float32)
        steps = (unit[:, None, :] * since[:, :, None]).reshape(len(unit), -1)
        white = freed.whiten_and_project(steps).reshape(len(unit), len(dates_s), -1) * np.float32(
            freed.response / freed.sigma
        )
        information = np.einsum("ndi,ndj->dij", white, white, optimize=True).astype(float)
        score = np.einsum("ndi,n->di", white, target, optimize=True).astype(float)
        ridge = np.eye(unit.shape[1]) * np.maximum(1e-6 * np.trace(information, axis1=1, axis2=2), 1e-12)[:, None, None]
        return np.asarray(
            0.5 * np.sum(score * np.linalg.solve(information + ridge, score[:, :, None])[:, :, 0], axis=1)
        )

    return gains
