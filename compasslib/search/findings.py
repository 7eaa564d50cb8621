"""Findings made of fitted terms: where, when, how large, how sure, in numbers and in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from compasslib import observatory
from compasslib.core import angles
from compasslib.core.records import Pairs
from compasslib.core.types import Floats
from compasslib.deviation.model import Fit, observed_heading
from compasslib.effects import SIDES, Term
from compasslib.search import model, show, stuck, verdict, wording
from compasslib.search.baseline import State
from compasslib.search.case import Case
from compasslib.search.clocks import Clock, kept
from compasslib.search.columns import Group
from compasslib.search.episodes import Episode
from compasslib.search.naming import Named
from compasslib.search.sectors import Heap
from compasslib.search.show import Curve
from compasslib.search.verdict import Finding, Parameter, Unexplained, Where
from compasslib.stats import robust, whitening

OBSERVATORY = "declination_observatory"
RANGE = (0.05, 0.95)  # quantiles of a covariate that tell where an effect lives
NOTHING = 1e-6  # standard error of a parameter that nothing depends on, in any unit
OUTSIDE = 2.5  # standard errors by which a bin leaves the band


def of_terms(named: Named) -> list[Finding]:
    """Return one finding for each chosen term, in the terms' order."""
    covariances = model.estimate(named.state).term_covariances
    return [_of_term(named.state, k, others, covariances[k]) for k, others in enumerate(named.alternatives)]


def _of_term(state: State, k: int, alternatives: tuple[str, ...], covariance: Floats) -> Finding:
    term = state.simulation.terms[k]
    sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    parameters = {
        name: Parameter(float(value), float(s), unit)
        for name, value, s, unit in zip(term.fitted(), term.values, sigma, term.units(), strict=True)
        if value or s > NOTHING  # a third battery that never came has neither
    }
    size, proof = model.effect_deg(state, k, covariance), show.held_out(state, [k])
    first, last = _span(state, term)
    lasting = (first, last) == (float(state.case.scene.time_s[0]), float(state.case.scene.time_s[-1]))
    place = lives(state, term) if lasting else where(state.case, "time", (first, last))
    begin = term.date if term.dated() else first
    same_side = all(SIDES[name] == "compass" for name in alternatives)
    return Finding(
        effect=term.name,
        side=term.side,
        alternatives=alternatives,
        where=place,
        when_s=(begin, last),
        parameters=parameters,
        rms_effect_deg=size,
        held_out=proof,
        text=wording.finding(
            term.name,
            alternatives,
            where=f"From {verdict.stamp(begin)[:10]} on" if term.dated() else place.text[0].upper() + place.text[1:],
            parameters={name: (p.value, p.sigma, p.unit) for name, p in parameters.items()},
            size_deg=size,
            proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        ),
        applied=term.side == "compass" and same_side and proof.p_value < verdict.PROVEN,
    )


def of_clock(before: Pairs, after: Pairs, fits: tuple[Fit, Fit], clock: Clock) -> list[Finding]:
    """Return the findings on the clocks, with what re-pairing does to the residual of fits that have not seen it.

    Args:
        before: pairs as they were.
        after: pairs with the trusted instrument read at the true times.
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
        told = wording.finding(
            effect,
            others,
            where=place.text[0].upper() + place.text[1:],
            parameters={name: (value, sigma, unit)},
            size_deg=size,
            proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        )
        parameters = {name: Parameter(value, sigma, unit)}
        result.append(Finding(effect, "clock", others, place, span, parameters, size, proof, told))
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
    said = " and ".join(place.text for place in places)
    time_s = state.case.scene.time_s
    when = next(((p.low, p.high) for p in places if p.covariate == "time"), (float(time_s[0]), float(time_s[-1])))
    told = wording.unexplained(said, size_deg, named)
    return Unexplained(group.covariates, places[0], when, size_deg, curves, told)


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
    said = f"{place.text}, where the compass hangs: its readings heap up at {heap.recorded_deg:.0f} degrees"
    told = wording.unexplained(said, heap.rms_deg, named)
    curves = (show.curve(state, state, "heading"),)
    return Unexplained(("heading",), place, (float(time_s[0]), float(time_s[-1])), heap.rms_deg, curves, told)


def episode(state: State, found: Episode, named: Sequence[str]) -> Unexplained:
    """Return weeks in which the reading was off, and then was not, or what comes and goes, as what stays unexplained.

    Args:
        state: with the named terms, without the steps.
        found: what the steps amounted to.
        named: effects that stand beside it.
    """
    span = (found.begin_s, found.end_s)
    place = where(state.case, "time", span)
    how = ", to and fro" if found.swings else ", and not after"
    told = wording.unexplained(place.text + how, found.rms_deg, named)
    return Unexplained(("time",), place, span, found.rms_deg, (show.curve(state, state, "time"),), told)


def where(case: Case, name: str, span: tuple[float, float] | None = None) -> Where:
    """Return a range of a covariate, by default the one that it covers."""
    low, high = span or tuple(np.quantile(case.covariates[name], RANGE).tolist())
    if name != "time":
        return Where(name, low, high, wording.place(name, low, high))
    return Where(name, low, high, f"from {verdict.stamp(low)[:10]} to {verdict.stamp(high)[:10]}")


def lives(state: State, term: Term) -> Where:
    """Return the covariate along which an effect lives.

    Args:
        state: with the term.
    """
    known = [name for name in wording.WHERE.get(term.name, ("time",)) if name in state.case.covariates]
    needed = [name for name in known if name in term.needs] or known or ["time"]
    return where(state.case, max(needed, key=lambda name: float(np.std(state.case.covariates[name]))))


def _span(state: State, term: Term) -> tuple[float, float]:
    """Return when an effect acts: a storm has dates, everything else lasts."""
    time_s = state.case.scene.time_s
    if OBSERVATORY in term.needs:
        return observatory.strongest_disturbance(time_s, state.case.scene.departures[OBSERVATORY])
    if set(stuck.LEANS) <= set(term.needs):
        leaning = np.flatnonzero(state.case.scene.departures[stuck.LEANS[0]])
        return float(time_s[leaning[0]]), float(time_s[leaning[-1]])
    return float(time_s[0]), float(time_s[-1])


def _outside(case: Case, curve: Curve) -> Where:
    """Return the range in which the binned residual leaves its band; all of the covariate where no bin does alone."""
    far = np.abs(curve.before_deg) > OUTSIDE * curve.sigma_deg
    if not far.any():
        return where(case, curve.covariate)
    half = float(np.median(np.diff(curve.centre))) / 2.0 if len(curve.centre) > 1 else 0.0
    inside = curve.centre[far]
    return where(case, curve.covariate, (float(inside.min()) - half, float(inside.max()) + half))
