"""A mooring's overlap against its fitted compass: what is mended before the search, and what is found beside it.

Clocks that differ are found by the speeds, which have no compass in them, and pairs are made anew; and where the
small-angle series was asked for, the exact compass is held against it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from compasslib import angles, compass, deviation
from compasslib.deviation import exact, von_appen
from compasslib.deviation.forms import EXACT, SeriesInCorrect
from compasslib.deviation.model import Fit, nearest_root, observed_heading
from compasslib.effects.term import HOUR_S
from compasslib.effects.water import VeerWithDirection
from compasslib.inference import applied, clocks, diagnosis, findings, long_record, show, verdict, wording
from compasslib.inference.case import Case, Shared, mooring_case
from compasslib.inference.clocks import ClockError, kept
from compasslib.inference.comparison import Options
from compasslib.inference.finding import Finding, Parameter, Where
from compasslib.inference.long_record import FEWEST, SHORTEST_DAYS
from compasslib.inference.show import HeldOut
from compasslib.inference.verdict import Diagnosis
from compasslib.records import EarthField, Pairs, take
from compasslib.statistics import blocks, robust, whitening
from compasslib.threads import single_threaded
from compasslib.types import Floats

MOST_PAIRS = 20_000  # hourly pairs of two years; of more, every second, third, ... is searched, to hold memory
PAIRS = 1000  # of the exact compass against the series: as many, evenly taken, tell the curves apart
SURE = 0.01  # p-value
MOST_LOST = 0.02  # share of headings that the series may leave without a root and still be large enough a model


@dataclass(frozen=True)
class Repair:
    """Pairs freed of a clock error, the compass fitted to them, and what was found."""

    pairs: Pairs
    fit: Fit
    findings: list[Finding]


@single_threaded()
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
    first = [] if not is_series else of_exact_compass(pairs, exact, fit, options.min_effect_deg)
    clock = clocks.compare(wide)
    repair, doubted = _repaired(pairs, exact, clock)
    if repair is not None:
        held = kept(pairs, repair.pairs)
        logged = {name: column[held] for name, column in logged.items()}
        first += repair.findings
        pairs, exact = repair.pairs, repair.fit
    case = mooring_case(pairs, logged, exact, field, reference_magnetic=options.reference_magnetic, units=units)
    case = replace(case, shared=shared or {})
    if repair is not None:
        case = _without_direction(case)
    if is_series:  # it was looked for already
        case = replace(case, not_testable=tuple(one for one in case.not_testable if one[0] != "large_deviation"))
    found = replace(diagnosis.joined(first, long_record.judge(case, options, exact)), warnings=doubted)
    if not options.apply:
        return replace(found, applied=(), findings=tuple(replace(one, applied=False) for one in found.findings))
    if is_series and not any(one.applied for one in found.findings):
        return replace(found, applied=())
    if found.covariance is not None and exact.method != "calibration":  # what slow water may do to the constants
        exact = applied.as_unsure(exact, found.covariance)
    return replace(found, fit=exact, applied=tuple(applied.no_surer(one, exact) for one in found.applied))


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


def _repaired(pairs: Pairs, fit: Fit, clock: ClockError) -> tuple[Repair | None, tuple[str, ...]]:
    """Return the pairs freed of a clock error, and what is to be said where held-out directions deny it."""
    if not clock.named:
        return None, ()
    again = clocks.repaired(pairs, clock)
    if not (short := len(again) < FEWEST):
        freed = deviation.fit(fit.method, again, _near(fit), dip_ratio=fit.dip_ratio)
        found = of_clock(pairs, again, (fit, freed), clock)
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


def of_clock(before: Pairs, after: Pairs, fits: tuple[Fit, Fit], clock: ClockError) -> list[Finding]:
    """Return the findings on the clocks, with what re-pairing does to the residual of fits that have not seen it.

    Args:
        after: pairs with the reference read at the true times.
    """
    same = kept(before, after)
    moved = angles.difference(observed_heading(after), observed_heading(before)[same])
    left = [left_out(pairs, fit) for pairs, fit in zip((before, after), fits, strict=True)]
    left[0] = left[0][same]
    width = whitening.widths(left[1], np.zeros(len(after)))
    proof = show.improved(left[0], left[1], width, blocks.of_span(after.time_s, show.BLOCK_S))
    size = robust.width(moved)  # robust: slow water may point anywhere
    numbers = {
        "clock_offset": (clock.offset_named, "hours", clock.offset_h, clock.offset_sigma_h, "h"),
        "clock_drift": (clock.drift_named, "hours_year", clock.drift_h_year, clock.drift_sigma_h_year, "h/year"),
    }
    span = (float(after.time_s[0]), float(after.time_s[-1]))
    place = Where("time", *span, wording.place("time", *span))
    result = []
    for effect, (is_named, name, value, sigma, unit) in numbers.items():
        if not is_named:
            continue
        others = tuple(name for name in numbers if name != effect) if clock.ambiguous else ()
        text = wording.finding(
            effect,
            others,
            where=place.text,
            parameters={name: (value, sigma, unit)},
            size_deg=size,
            proof=(proof.rms_before_deg, proof.rms_after_deg, proof.p_value),
        )
        parameters = {name: Parameter(value, sigma, unit)}
        result.append(Finding(effect, "clock", others, place, span, parameters, size, proof, text))
    return result


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
    if not (size >= min_effect_deg or lost > MOST_LOST):
        return []
    proof = _by_blocks(pairs, fit, series)
    if proof.p_value > SURE or proof.refuted:
        return []
    span = (float(pairs.time_s[0]), float(pairs.time_s[-1]))
    return [replace(findings.large_deviation(size, proof), when_s=span, applied=True)]


def _by_blocks(pairs: Pairs, fit: Fit, series: Fit) -> HeldOut:
    """Return the gain of the exact compass over the best series on blocks that neither was fitted to."""
    some = take(pairs, np.arange(0, len(pairs), max(1, len(pairs) // PAIRS)))
    block = blocks.of_span(some.time_s, show.BLOCK_S)
    scores = [
        exact.held_out_scores(form, some, block % 2, near) for form, near in ((SeriesInCorrect(), None), (EXACT, fit))
    ]
    left = [left_out(some, near) for near in (series, fit)]
    return show.judged(scores[1] - scores[0], block, (angles.rms(left[0]), angles.rms(left[1])))


def left_out(pairs: Pairs, fit: Fit) -> Floats:
    """Return the observed heading minus that of a fit of the same method to the other half of the blocks, (n,) degrees.

    What no heading explains is as far off as chance takes it.

    Args:
        fit: to all of them.
    """
    block = blocks.of_span(pairs.time_s, show.BLOCK_S)
    observed, left = observed_heading(pairs), np.full(len(pairs), show.LOST_DEG)
    for out in (block % 2 == 0, block % 2 == 1):
        again = deviation.fit(fit.method, take(pairs, ~out), fit)
        if again.fitted:
            left[out] = angles.difference(observed, _corrected(again, pairs, observed))[out]
    return np.where(np.isfinite(left), left, show.LOST_DEG)


def _corrected(fit: Fit, pairs: Pairs, observed_deg: Floats) -> Floats:
    if fit.method == "von_appen":
        return von_appen.invert(fit.coefficients, pairs.heading_deg)
    return nearest_root(compass.inverse(fit.coefficients, pairs.heading_deg), observed_deg)
