"""The door: hold a recording against its simulation and say what was left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from compasslib import deviation
from compasslib.core.records import EarthField, Pairs, take
from compasslib.core.types import Floats
from compasslib.deviation.model import Fit
from compasslib.effects.term import HOUR_S, slices
from compasslib.effects.water import VeerWithDirection
from compasslib.search import (
    applied,
    baseline,
    clocks,
    columns,
    covariates,
    experiments,
    findings,
    inference,
    model,
    posterior,
    scan,
    sectors,
    sharing,
    show,
    storms,
    verdict,
    wording,
)
from compasslib.search.applied import Applied, Member
from compasslib.search.baseline import State
from compasslib.search.case import Case, Shared, mooring_case
from compasslib.search.clocks import ClockError
from compasslib.search.columns import Group
from compasslib.search.inference import Inference
from compasslib.search.posterior import Slot
from compasslib.search.sectors import Heap
from compasslib.search.show import BinnedResidual
from compasslib.search.verdict import Diagnosis, Finding, Unexplained
from compasslib.stats import whitening

FEWEST, SHORTEST_DAYS = 200, 20.0  # below which an effect is not told from the water
MOST_PAIRS = 20_000  # hourly pairs of two years; of more, every second, third, ... is searched, to hold memory
OMNIBUS = 1.0 / 3.0  # of the alarm: splines and products feign more than the draws of the noise show


@dataclass(frozen=True)
class Options:
    """What may be chosen about a diagnosis."""

    min_effect_deg: float = 0.5  # visible size, rms, below which a mismatch does not matter
    apply: bool = True  # whether findings on the compass side are handed to the correction
    alarm: float = 0.006  # probability that noise alone gives a name, and that it gives an unexplained mismatch
    reference_magnetic: bool = True  # whether the reference has a compass too
    tell: bool = False  # whether other records of the compass are to know what this one tells


@dataclass(frozen=True)
class Repair:
    """Pairs freed of a clock error, the compass fitted to them, and what was found."""

    pairs: Pairs
    fit: Fit
    findings: list[Finding]


@dataclass(frozen=True)
class Rest:
    """What the omnibus tests find: groups that are significant with their visible sizes, the strongest first."""

    threshold: float  # score that noise alone hardly exceeds
    strong: tuple[tuple[Group, float], ...]
    min_effect_deg: float

    @property
    def curve(self) -> Group:
        """All that is significant along the covariates of the strongest."""
        first = self.strong[0][0]
        alike = [group.columns for group, _ in self.strong if group.covariates == first.covariates]
        return replace(first, columns=np.concatenate(alike, axis=1))

    @property
    def worth(self) -> list[tuple[Group, float]]:
        """Those that matter."""
        return [one for one in self.strong if one[1] >= self.min_effect_deg]

    @property
    def small(self) -> list[tuple[Group, float]]:
        """Those that do not, one of a name."""
        return list({one[0].name: one for one in self.strong if one[1] < self.min_effect_deg}.values())


def diagnose(
    pairs: Pairs,
    logged: Mapping[str, Floats],
    fit: Fit,
    field: EarthField,
    options: Options | None = None,
    *,
    wide: Pairs | None = None,
    units: Mapping[str, str] | None = None,
    shared: Shared | None = None,
) -> Diagnosis:
    """Return what a mooring's overlap shows that its fitted compass does not hold.

    Args:
        logged: other series at their times, ``temperature`` and ``supply_voltage`` where there are, (n,) each.
        fit: the configured fit, which is the simulation that is diagnosed.
        wide: pairs that may stand further apart, by which the clocks are compared; the pairs where absent.
        units: of logged series that have no name of their own here.
        shared: what other records of the same compass tell of its effects; of its coefficients the fit holds it.
    """
    options = options or Options()
    wide = pairs if wide is None else wide
    some = slice(None, None, 1 + len(pairs) // MOST_PAIRS)
    pairs, logged = take(pairs, some), {name: series[some] for name, series in logged.items()}
    if why := _too_little(pairs, fit):
        return verdict.insufficient(why)
    is_series = fit.method == "von_appen"
    exact = deviation.fit("exact", pairs) if is_series else fit
    first = [] if not is_series else findings.of_exact_compass(pairs, exact, fit, options.min_effect_deg)
    clock = clocks.compare(wide)
    repair, doubted = _repaired(pairs, exact, clock)
    if repair is not None:
        kept = clocks.kept(pairs, repair.pairs)
        logged = {name: column[kept] for name, column in logged.items()}
        first += repair.findings
        pairs, exact = repair.pairs, repair.fit
    case = mooring_case(pairs, logged, exact, field, reference_magnetic=options.reference_magnetic, units=units)
    case = replace(case, shared=shared or {})
    if repair is not None:
        case = _without_direction(case)
    if is_series:  # it was looked for already
        case = replace(case, not_testable=tuple(one for one in case.not_testable if one[0] != "large_deviation"))
    found = replace(_joined(first, judge(case, options, exact)), warnings=doubted)
    if not options.apply:
        return replace(found, applied=(), findings=tuple(replace(one, applied=False) for one in found.findings))
    if is_series and not any(one.applied for one in found.findings):
        return replace(found, applied=())
    if found.covariance is not None and exact.method != "calibration":  # what slow water may do to the constants
        exact = applied.as_unsure(exact, found.covariance)
    return replace(found, fit=exact, applied=tuple(applied.no_surer(one, exact) for one in found.applied))


def _repaired(pairs: Pairs, fit: Fit, clock: ClockError) -> tuple[Repair | None, tuple[str, ...]]:
    """Return the pairs freed of a clock error, and what is to be said where held-out directions deny it."""
    if not clock.named:
        return None, ()
    again = clocks.repaired(pairs, clock)
    if not (short := len(again) < FEWEST):
        freed = deviation.fit(fit.method, again, _near(fit), dip_ratio=fit.dip_ratio)
        found = findings.of_clock(pairs, again, (fit, freed), clock)
        if freed.fitted and not any(one.held_out.refuted for one in found):
            return Repair(again, freed, found), ()
    why = "too few pairs are left once corrected" if short else "held-out directions then agree less"
    hours = clock.ahead_s(pairs.time_s)[[0, -1]] / HOUR_S
    warning = (
        f"by the speeds the two clocks differ by {hours[0]:+.1f} h at the start and {hours[1]:+.1f} h at the end, but "
        f"{why}: nothing was corrected; check clocks, time zones and dates of both"
    )
    return None, (warning,)


def _near(fit: Fit) -> Fit | None:
    """Return what a fit without the clock's error starts from: anew, or a calibration that no pair changes."""
    return fit if fit.method == "calibration" or fit.prior is not None else None


def _without_direction(case: Case) -> Case:
    """Return the case without the veer by direction, whose flow knows nothing of noise that was interpolated."""
    why = "directions read between two samples, after the clocks, share their noise with the direction of the flow"
    return replace(
        case,
        terms=tuple(kind for kind in case.terms if kind is not VeerWithDirection),
        not_testable=(*case.not_testable, (VeerWithDirection.name, why)),
    )


def judge(case: Case, options: Options, fit: Fit | None = None) -> Diagnosis:
    """Return the diagnosis of any recording that is held against its simulation.

    Args:
        fit: of the exact compass, where what the recording tells is asked for.
    """
    none = np.zeros(case.nuisance.shape[1])
    if (usable := baseline.usable(case, case.simulation, none)) < FEWEST:
        why = f"the branch of the compass is known for {usable} of {len(case)} pairs; {FEWEST} are needed"
        return verdict.insufficient(why, case.not_testable)
    try:
        return _judged(case, options, fit)
    except baseline.Lost as lost:  # from the beginning, or once refitted
        return verdict.insufficient(f"{lost}; there is nothing to compare the compass with", case.not_testable)


def _judged(case: Case, options: Options, fit: Fit | None) -> Diagnosis:
    none = np.zeros(case.nuisance.shape[1])
    empty = baseline.examine(case, case.simulation, none)
    heap = sectors.heap(empty)
    outside = case if heap is None else replace(case, observed_deg=sectors.outside(case, heap))
    if heap is not None and baseline.usable(outside, case.simulation, none) >= FEWEST:
        empty = baseline.examine(outside, case.simulation, none)  # what hangs tells nothing of terms, and feigns some
    empty = model.refit(empty, [])  # where the record, its memory counted, has compass and nuisances
    found = inference.infer(empty, options.alarm)
    rest, told = _left(found.state, options), found.slots
    if rest.worth and found.chosen:
        found = _without_stand_ins(empty, found, rest.curve, options)
        rest = _left(found.state, options)
    state = found.state
    every = findings.of_terms(found)
    stormy = storms.of(state, options.alarm)
    both = every if stormy is None else [*every, stormy]
    stands = [one for one in both if one.rms_effect_deg >= options.min_effect_deg]
    small = [(one.effect, one.rms_effect_deg) for one in both if one.rms_effect_deg < options.min_effect_deg]
    ordered = tuple(sorted(stands, key=lambda one: -one.rms_effect_deg))
    sides = _sides(found, told, [slot for slot, one in zip(found.slots, every, strict=True) if one in stands])
    names = [one.named for one in ordered]
    unexplained = _unexplained(state, rest.worth[0] if rest.worth else None, heap, options.min_effect_deg, names)
    detectable = posterior.detectable(found.posterior)
    bare = model.refit(state, []) if state.simulation.terms else state
    return Diagnosis(
        verdict=verdict.of(ordered, unexplained),
        findings=ordered,
        unexplained=unexplained,
        separated_by="; ".join(wording.separated_by(f.named, f.alternatives) for f in ordered if f.alternatives)
        or None,
        not_testable=case.not_testable,
        negligible=(*small, *((group.name, size) for group, size in rest.small)),
        curves=_curves(bare, state, every, ordered),
        applied=_applied(found) if options.apply else (),
        covariance=found.estimate(bare).covariance[:5, :5],
        why=_why(detectable, options.min_effect_deg),
        detectable_deg=detectable,
        threshold={"omnibus": rest.threshold},
        sides=_with("compass", sides) if stormy in ordered else sides,
        noise=inference.noise_of(found),
        experiments=experiments.of(found) if verdict.of(ordered, unexplained) == "ambiguous" else (),
        told=sharing.of(found, fit) if options.tell and fit is not None else None,
    )


def _too_little(pairs: Pairs, fit: Fit) -> str:
    if not fit.fitted:
        return f"no compass was fitted: {fit.why}"
    days = float(np.ptp(pairs.time_s)) / 86400.0 if len(pairs) else 0.0
    if len(pairs) < FEWEST or days < SHORTEST_DAYS:
        return (
            f"{len(pairs)} overlapping pairs over {days:.0f} days; at least {FEWEST} over {SHORTEST_DAYS:.0f} days are "
            "needed to separate unmodelled effects from the water"
        )
    return ""


def _joined(first: Sequence[Finding], rest: Diagnosis) -> Diagnosis:
    """Return the diagnosis with findings that were made before the search, strongest first."""
    if not first:
        return rest
    found = tuple(sorted((*first, *rest.findings), key=lambda one: -one.rms_effect_deg))
    return replace(
        rest, findings=found, verdict=verdict.of(found, rest.unexplained), sides=_with(first[0].side, rest.sides)
    )


def _sides(found: Inference, told: Sequence[Slot], stands: Sequence[Slot]) -> dict[str, float]:
    """Return the probability of each side: what is too small to matter or was taken back counts as nothing.

    Args:
        told: what may fill each place that the search found.
        stands: the places that are findings.
    """
    fallen, kept = (
        {name for slot in slots for name in (slot.effect, *slot.alternatives)}
        for slots in ([slot for slot in told if slot not in stands], stands)
    )
    return found.posterior.sides(fallen - kept)


def _with(side: str, sides: Mapping[str, float]) -> dict[str, float]:
    """Return the probabilities of sides where something surely acts on one: what is left out is not nothing."""
    if not sides:
        return {}
    yielding = ("none", "water") if side == "clock" else ("none", "water", "clock", "reference")
    return {
        name: value + sum(sides[x] for x in yielding) if name == side else value * (name not in yielding)
        for name, value in sides.items()
    }


def _without_stand_ins(empty: State, found: Inference, curve: Group, options: Options) -> Inference:
    """Return what the recording tells without names that only stand for what nothing explains.

    Args:
        curve: what is left beside the names; free to be anything, it takes what they only stood for.
    """
    free = replace(empty.case, nuisance=np.column_stack([empty.case.nuisance, whitening.orthonormal(curve.columns)]))
    zero = np.zeros(free.nuisance.shape[1])
    beside = inference.infer(model.refit(baseline.examine(free, empty.simulation, zero), []), options.alarm)
    kept = {type(term) for term in beside.state.simulation.terms}
    return found.only([type(term) in kept or term.evident for term in found.state.simulation.terms])


def _left(state: State, options: Options) -> Rest:
    """Return what the omnibus tests find beside the terms of a simulation."""
    tested = scan.test(state, columns.omnibus(state), seed=99)
    threshold = tested.threshold(options.alarm * OMNIBUS)
    strong = [int(k) for k in np.argsort(-tested.score) if tested.score[k] > threshold]
    sized = [(tested.groups[k], scan.size_of(state, tested.groups[k], float(tested.inflation[k]))) for k in strong]
    return Rest(threshold, tuple(sized), options.min_effect_deg)


def _unexplained(
    state: State, left: tuple[Group, float] | None, heap: Heap | None, min_effect_deg: float, named: Sequence[str]
) -> Unexplained | None:
    """Return what nothing explains: what the mean residual shows, or a sector in which the compass hangs."""
    size = 0.0 if left is None else left[1]
    if heap is not None and heap.rms_deg > max(size, min_effect_deg):
        return findings.hanging(state, heap, named)
    return None if left is None else findings.unexplained(state, *left, named)


def _why(detectable: Mapping[str, float], min_effect_deg: float) -> str:
    """Return the detection limits in a sentence."""
    sizes = sorted((max(size, min_effect_deg), name) for name, size in detectable.items())
    if not sizes:
        return ""
    (best, first), (worst, last) = (
        (f"{size:.1f}° rms", name.replace("_", " ")) for size, name in (sizes[0], sizes[-1])
    )
    if best == worst:
        return f"Detection limit (90 % power): {best} for every effect that was tried."
    return f"Detection limits (90 % power): {best} ({first}) to {worst} ({last})."


def _curves(
    before: State, after: State, every: Sequence[Finding], found: Sequence[Finding]
) -> tuple[BinnedResidual, ...]:
    """Return the residual along the turn by each effect that was found, and along what they live in.

    Args:
        every: findings of all terms, in their order.
    """
    turns = [
        show.turn(after, one.effect, model.visible(after, k) @ term.values)
        for k, (term, one) in enumerate(zip(after.simulation.terms, every, strict=True))
        if one in found
    ]
    names = dict.fromkeys(["heading", "time", *(one.where.covariate for one in found)])
    return (*turns, *(show.curve(before, after, name) for name in names if name in before.case.covariates))


def _applied(found: Inference) -> tuple[Member, ...]:
    """Return the compasses that correct the record: each hypothesis with what stands on the compass side of it."""
    return tuple(
        Member(weight, "+".join(term.name for term in state.simulation.terms) or "none", _compass(found, state))
        for weight, state in found.weighted
    )


def _compass(found: Inference, state: State) -> Applied | None:
    """Return the compass of a state with the terms on its side; None where none stands: the fit by itself is that."""
    terms = state.simulation.terms
    if not terms:
        return None
    estimate = found.estimate(state)
    places = zip(terms, slices(terms, 5), strict=True)
    index = np.r_[:5, *(own for term, own in places if term.side == "compass")]
    simulation = replace(state.simulation, terms=tuple(term for term in terms if term.side == "compass"))
    means = covariates.references(state.case.covariates)
    needed = {name for term in simulation.terms for name in term.needs}
    return Applied(
        simulation=simulation,
        covariance=estimate.covariance[np.ix_(index, index)],
        references={name: means[name] for name in {*needed & means.keys(), "time"}},
        logged=tuple(sorted(needed & means.keys())),
    )
