"""Findings made of fitted terms: where, when, how large, how sure, in numbers and in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from compasslib import observatory
from compasslib.core import angles, compass
from compasslib.core.records import Pairs, take
from compasslib.core.types import Floats
from compasslib.deviation import exact, von_appen
from compasslib.deviation.forms import EXACT, SeriesInCorrect
from compasslib.deviation.model import Fit, nearest_root, observed_heading
from compasslib.effects import COMPOSED, Term, composition
from compasslib.effects.composed import Composed
from compasslib.effects.term import DAY_S
from compasslib.search import covariates, folds, grammar, model, show, stuck, verdict, wording
from compasslib.search.baseline import State
from compasslib.search.case import Case
from compasslib.search.clocks import ClockError, kept
from compasslib.search.columns import Group
from compasslib.search.inference import Inference
from compasslib.search.sectors import Heap
from compasslib.search.show import BinnedResidual, HeldOut
from compasslib.search.verdict import Finding, Parameter, Unexplained, Where
from compasslib.stats import blocks, robust, whitening

NOTHING = 1e-6  # standard error of a parameter that nothing depends on, in any unit
OUTSIDE = 2.5  # standard errors by which a bin leaves the band
PAIRS = 1000  # of the exact compass against the series: as many, evenly taken, tell the curves apart
SURE = 0.01  # p-value


def of_terms(found: Inference) -> list[Finding]:
    """Return one finding for each term of the likeliest hypothesis, in the terms' order."""
    covariances = found.estimate(found.state).term_covariances
    return [_of_term(found, k, covariance) for k, covariance in enumerate(covariances)]


def _of_term(found: Inference, k: int, covariance: Floats) -> Finding:
    state, slot = found.state, found.slots[k]
    term = state.simulation.terms[k]
    others = {found.said(name): p for name, p in slot.alternatives.items()}
    effect, composition = _words_of(term)
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters = {
        name: Parameter(float(value), float(s), _unit(state.case, term, unit))
        for name, value, s, unit in zip(term.fitted(), term.values, sigma, term.units(), strict=True)
        if value or s > NOTHING  # a third battery that never came has neither
    }
    if isinstance(term, Composed):
        parameters |= _places(found, term)
    size, proof = model.effect_deg(state, k, covariance), folds.proof(found, k)
    first, last = _span(state, term)
    lasting = (first, last) == (float(state.case.scene.time_s[0]), float(state.case.scene.time_s[-1]))
    place = lives(state, term) if lasting else where(state.case, "time", (first, last))
    begin = term.date if term.dated() else first
    return Finding(
        effect=effect,
        side=term.side,
        alternatives=tuple(others),
        where=place,
        when_s=(begin, last),
        parameters=parameters,
        rms_effect_deg=size,
        held_out=proof,
        text=wording.finding(
            term.name,
            tuple(others),
            where=f"From {verdict.stamp(begin)[:10]} on" if term.dated() else place.text[0].upper() + place.text[1:],
            parameters={name: (p.value, p.sigma, p.unit) for name, p in parameters.items()},
            size_deg=size,
            proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
            physics=" changes ".join(wording.of_composed(*composition.values())) + ", which no listed effect does"
            if composition
            else "",
        ),
        applied=term.side == "compass",
        probability=slot.probability,
        alternatives_probability=others,
        composition=composition,
    )


def _places(found: Inference, term: Composed) -> dict[str, Parameter]:
    """Return where along its driver a composition acts: dates are told apart, what is counted from a mean is not.

    How sure a place is tell the probabilities of the other places that were tried, and the spacing between them.
    """
    groups, means = found.posterior.candidates.groups, covariates.references(found.state.case.covariates)
    each = list(zip(found.posterior.hypotheses, found.posterior.probability.tolist(), strict=True))
    alike = [(k, group.term) for k, group in enumerate(groups) if type(group.term) is type(term)]
    tried = [(other, sum(p for one, p in each if k in one)) for k, other in alike]
    weight = np.array([p for _, p in tried])
    result = {}
    for name, spacing in grammar.spacings(term, found.state.case.scene).items():
        value = float(getattr(term, name))
        off = np.array([float(getattr(other, name)) for other, _ in tried]) - value
        sigma = float(np.sqrt(weight @ off**2 / max(float(weight.sum()), 1e-12) + spacing**2 / 12.0))
        unit = _unit(found.state.case, term, next(f.metadata["unit"] for f in fields(term) if f.name == name))
        if name in ("threshold", "middle"):
            value += sum(means.get(one, 0.0) for one in term.needs[:1])
        in_days = unit == "s"
        result[name.replace("_s", "_days") if in_days else name] = (
            Parameter(value / DAY_S, sigma / DAY_S, "days") if in_days else Parameter(value, sigma, unit)
        )
    return result


def _unit(case: Case, term: Term, unit: str) -> str:
    """Return a parameter's unit, with that of a driver which the grammar knows by its name only."""
    if isinstance(term, Composed):
        for driver in term.composition[1].split("*"):
            own = case.channels.get(driver, driver)
            unit = unit.replace(driver, f"({own})" if "/" in own or " " in own else own)
    return unit


def _words_of(term: Term) -> tuple[str, dict[str, str] | None]:
    """Return the name of an effect, and what it is composed of where nobody listed it."""
    if not isinstance(term, Composed) or not term.name.startswith(COMPOSED):
        return term.name, None
    return "composed", dict(zip(("acts_on", "driver", "form"), term.said(), strict=True))


def of_clock(before: Pairs, after: Pairs, fits: tuple[Fit, Fit], clock: ClockError) -> list[Finding]:
    """Return the findings on the clocks, with what re-pairing does to the residual of fits that have not seen it.

    Args:
        after: pairs with the reference read at the true times.
    """
    same = kept(before, after)
    moved = angles.difference(observed_heading(after), observed_heading(before)[same])
    left = [show.left_out(pairs, fit) for pairs, fit in zip((before, after), fits, strict=True)]
    left[0] = left[0][same]
    width = whitening.widths(left[1], np.zeros(len(after)))
    proof = show.compared(left[0], left[1], width, after.time_s)
    size = robust.width(moved)  # robust: slow water may point anywhere
    numbers = {
        "clock_offset": (clock.offset_named, "hours", clock.offset_h, clock.offset_sigma_h, "h"),
        "clock_drift": (clock.drift_named, "hours_year", clock.drift_h_year, clock.drift_sigma_h_year, "h/year"),
    }
    span = (float(after.time_s[0]), float(after.time_s[-1]))
    place = Where("time", *span, f"from {verdict.stamp(span[0])[:10]} to {verdict.stamp(span[1])[:10]}")
    result = []
    for effect, (is_named, name, value, sigma, unit) in numbers.items():
        if not is_named:
            continue
        others = tuple(name for name in numbers if name != effect) if clock.ambiguous else ()
        text = wording.finding(
            effect,
            others,
            where=place.text[0].upper() + place.text[1:],
            parameters={name: (value, sigma, unit)},
            size_deg=size,
            proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        )
        parameters = {name: Parameter(value, sigma, unit)}
        result.append(Finding(effect, "clock", others, place, span, parameters, size, proof, text))
    return result


def unexplained(state: State, group: Group, size_deg: float, named: Sequence[str]) -> Unexplained:
    """Return what is left after the named terms: where it lives, how large, its empirical curve.

    Args:
        state: with the named terms.
        group: the omnibus group that is strongest.
        size_deg: its visible size, rms.
        named: effects that stand beside it.
    """
    curves = tuple(show.curve(state, state, name) for name in group.covariates)
    places = [_outside(state.case, curve) for curve in curves]
    places_text = " and ".join(place.text for place in places)
    time_s = state.case.scene.time_s
    when = next(((p.low, p.high) for p in places if p.covariate == "time"), (float(time_s[0]), float(time_s[-1])))
    text = wording.unexplained(places_text, size_deg, named)
    return Unexplained(group.covariates, places[0], when, size_deg, curves, text)


def hanging(state: State, heap: Heap, named: Sequence[str]) -> Unexplained:
    """Return a sector in which the compass hangs as what stays unexplained.

    Args:
        state: with the named terms.
        heap: where readings heap up.
        named: effects that stand beside it.
    """
    low, high = (heap.recorded_deg + side * heap.width_deg / 2.0 for side in (-1.0, 1.0))
    place = where(state.case, "heading", (low, high))
    time_s = state.case.scene.time_s
    places_text = f"{place.text}, where the compass sticks: its readings accumulate at {heap.recorded_deg:.0f}°"
    text = wording.unexplained(places_text, heap.rms_deg, named)
    curves = (show.curve(state, state, "heading"),)
    return Unexplained(("heading",), place, (float(time_s[0]), float(time_s[-1])), heap.rms_deg, curves, text)


def where(case: Case, name: str, span: tuple[float, float] | None = None) -> Where:
    """Return a range of a covariate, by default the one that it covers."""
    low, high = span or tuple(np.quantile(case.covariates[name], show.RANGE).tolist())
    if name != "time":
        return Where(name, low, high, wording.place(name, low, high))
    return Where(name, low, high, f"from {verdict.stamp(low)[:10]} to {verdict.stamp(high)[:10]}")


def lives(state: State, term: Term) -> Where:
    """Return the covariate along which an effect lives."""
    listed = wording.WHERE.get(term.name, term.needs if isinstance(term, Composed) else ("time",))
    known = [name for name in listed if name in state.case.covariates]
    needed = [name for name in known if name in term.needs] or known or ["time"]
    return where(state.case, max(needed, key=lambda name: float(np.std(state.case.covariates[name]))))


def _span(state: State, term: Term) -> tuple[float, float]:
    """Return when an effect acts: a storm has dates, everything else lasts."""
    time_s = state.case.scene.time_s
    if set(covariates.OBSERVATORY) & set(term.needs):
        moved = np.broadcast_to(
            composition.north(replace(state.simulation, terms=(term,)), state.case.scene), time_s.shape
        )
        return observatory.strongest_disturbance(time_s, moved)
    if isinstance(term, Composed):
        return term.span(float(time_s[0]), float(time_s[-1]))
    if set(stuck.LEANS) <= set(term.needs):
        leaning = np.flatnonzero(state.case.scene.departures[stuck.LEANS[0]])
        return float(time_s[leaning[0]]), float(time_s[leaning[-1]])
    return float(time_s[0]), float(time_s[-1])


def _outside(case: Case, curve: BinnedResidual) -> Where:
    """Return the range in which the binned residual leaves its band; all of the covariate where no bin does alone."""
    far = np.abs(curve.before_deg) > OUTSIDE * curve.sigma_deg
    if not far.any():
        return where(case, curve.covariate)
    half = float(np.median(np.diff(curve.centre))) / 2.0 if len(curve.centre) > 1 else 0.0
    inside = curve.centre[far]
    return where(case, curve.covariate, (float(inside.min()) - half, float(inside.max()) + half))


def of_exact_compass(pairs: Pairs, fit: Fit, series: Fit, min_effect_deg: float) -> list[Finding]:
    """Return the finding that the exact compass fits where the small-angle series does not, or none.

    Both have five parameters, so the comparison on held-out days needs no charge for complexity.

    Args:
        min_effect_deg: size below which the difference does not matter, rms.
    """
    observed = observed_heading(pairs)
    by_exact = nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed)
    by_series = von_appen.invert(series.coefficients, pairs.heading_deg)
    size, lost = angles.rms(angles.difference(by_exact, by_series)), float(np.mean(~np.isfinite(by_series)))
    if not (size >= min_effect_deg or lost > 0.02):
        return []
    proof = _by_blocks(pairs, fit, series)
    if proof.p_value > SURE or proof.refuted:
        return []
    text = wording.finding(
        "large_deviation",
        (),
        where="Along the recorded heading",
        parameters={},
        size_deg=size,
        proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
    )
    low, high = np.quantile(pairs.heading_deg, [0.05, 0.95]).tolist()
    place = Where("heading", low, high, wording.place("heading", low, high))
    span = (float(pairs.time_s[0]), float(pairs.time_s[-1]))
    share = {"share": Parameter(1.0, 0.0, "1")}
    return [Finding("large_deviation", "compass", (), place, span, share, size, proof, text, applied=True)]


def _by_blocks(pairs: Pairs, fit: Fit, series: Fit) -> HeldOut:
    """Return the gain of the exact compass over the best series on blocks that neither was fitted to."""
    some = take(pairs, np.arange(0, len(pairs), max(1, len(pairs) // PAIRS)))
    block = blocks.of_span(some.time_s, show.BLOCK_S)
    scores = [
        exact.held_out_scores(form, some, block % 2, near) for form, near in ((SeriesInCorrect(), None), (EXACT, fit))
    ]
    left = [show.left_out(some, near) for near in (series, fit)]
    return show.judged(scores[1] - scores[0], block, (angles.rms(left[0]), angles.rms(left[1])))
