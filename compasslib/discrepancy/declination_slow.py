"""What is slow in an observatory's series: a trend beyond the model, and jumps of its baseline.

Records of some weeks go through the general search with the two terms that apply. Shorter ones hold no trend; a jump in
them is a change from one level to another that leaves nothing that a storm is made of.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, observatory
from compasslib.discrepancy import declination_told, diagnosis, show, verdict
from compasslib.discrepancy.case import Case
from compasslib.discrepancy.diagnosis import Options
from compasslib.discrepancy.show import Curve
from compasslib.discrepancy.verdict import Finding, Parameter, Unexplained, Where
from compasslib.observatory import Held
from compasslib.physics import Scene
from compasslib.physics.composition import Simulation
from compasslib.physics.heading_slip import HeadingSlip
from compasslib.physics.secular_variation import SecularVariation
from compasslib.physics.term import YEAR_S
from compasslib.records import EarthField, FieldSeries

Floats = NDArray[np.floating]
Jumps = tuple[tuple[float, float], ...]  # (date, degrees that the series rises by)

HOURS_OF_YEARS = 3.0  # a longer record is searched by days
DAILY_HARMONICS = range(1, 5)
PRECISION_DEG = 0.01
NEAR_S = 3 * observatory.DAY_S  # reach of the finer search of a jump's date
LEAST_SIDE_S = 3 * observatory.HOUR_S  # of either level of a jump in a short record
LEAST_AFTER_S = observatory.DAY_S  # of a level that no storm keeps
LIKE_THE_MODEL = 0.25  # share by which a trend may miss the model's own and still be it
FEWEST_PIECES = 6  # of 27 days
LEAST_COVERED = 0.5  # share of the days below which the general search does not know the noise of what is slow
SURE = 5.0  # standard errors of a trend through pieces
STEADY = 0.5  # of the limit: what a jump may leave


@dataclass(frozen=True)
class Slow:
    """What was found, and what could not be looked for."""

    findings: tuple[Finding, ...] = ()
    jumps: Jumps = ()
    unexplained: Unexplained | None = None
    negligible: tuple[tuple[str, float], ...] = ()
    not_testable: tuple[tuple[str, str], ...] = ()
    curves: tuple[Curve, ...] = ()
    threshold: Mapping[str, float] = field(default_factory=dict)


def judge(held: Held, series: FieldSeries, model: EarthField, options: Options) -> Slow:
    """Return trend and jumps of a series.

    Args:
        held: the series held against the model.
        series: as it was read.
        model: declination along time.
        options: what may be chosen.
    """
    if why := _too_short(held):
        jump = _short_jump(held, options.min_effect_deg) if held.storms else None
        missing = [("secular_variation", why)] + ([] if jump else [("heading_slip", why)])
        return Slow((jump[0],) if jump else (), (jump[1],) if jump else (), not_testable=tuple(missing))
    if _covered(held) < LEAST_COVERED:
        return _of_pieces(held, series, model, options.min_effect_deg)
    found = diagnosis.judge(case(held, model), options)
    dates = {id(one): _dated(held, one) for one in found.findings if one.effect == "heading_slip"}
    return Slow(
        findings=tuple(_told(one, series, model, dates.get(id(one))) for one in found.findings),
        jumps=tuple(dates.values()),
        unexplained=found.unexplained,
        negligible=found.negligible,
        curves=found.curves,
        threshold=found.threshold,
    )


def without(series: FieldSeries, jumps: Jumps) -> FieldSeries:
    """Return a series with its jumps taken out.

    Args:
        series: of an observatory.
        jumps: dates and degrees.
    """
    risen = np.sum([size * (series.time_s >= date) for date, size in jumps], axis=0) if jumps else 0.0
    return replace(series, declination_deg=angles.wrap180(series.declination_deg - risen))


def case(held: Held, model: EarthField) -> Case:
    """Return the series as a case of the general search: a compass that stays where it is while north moves.

    Args:
        held: the series held against the model.
        model: of the field along time.
    """
    years = float(np.ptp(held.time_s)) / YEAR_S
    step = observatory.HOUR_S if years < HOURS_OF_YEARS else observatory.DAY_S
    time_s, off = _averaged(held.time_s, held.residual_deg - held.constant_deg, step)
    n, width = len(time_s), 1.4826 * float(np.median(np.abs(off - np.median(off))))
    still = np.zeros(n)
    h, z = (np.interp(time_s, model.time_s, x) for x in (model.horizontal_nT, model.vertical_nT))
    hour = 15.0 * (time_s / observatory.HOUR_S % 24.0)
    waves = [x for k in DAILY_HARMONICS for x in angles.sin_cos(k * hour)] if step < observatory.DAY_S else []
    return Case(
        kind="declination",
        simulation=Simulation(np.zeros(5), float(np.mean(h))),
        scene=Scene(time_s, h, z, still, still, float(time_s[0])),
        recorded_deg=still,
        observed_deg=off,
        slowness=still,
        expected_deg=np.full(n, width),
        precision_deg=PRECISION_DEG,
        covariates={"time": time_s},
        nuisance=np.column_stack(waves) if waves else np.zeros((n, 0)),
        terms=(SecularVariation, HeadingSlip),
    )


def _too_short(held: Held) -> str:
    days = float(np.ptp(held.time_s)) / observatory.DAY_S
    hours = len(np.unique(np.floor(held.time_s / observatory.HOUR_S)))
    if days >= diagnosis.SHORTEST_DAYS and hours >= diagnosis.FEWEST:
        return ""
    return (
        f"the series has {hours} hours over {days:.0f} days; {diagnosis.FEWEST} hours over "
        f"{diagnosis.SHORTEST_DAYS:.0f} days are needed for what is slow"
    )


def _covered(held: Held) -> float:
    return held.days / (float(np.ptp(held.time_s)) / observatory.DAY_S + 1.0)


def _of_pieces(held: Held, series: FieldSeries, model: EarthField, limit_deg: float) -> Slow:
    """Return the trend through the medians of 27 days of a record that is mostly gaps; a jump may hide in a gap."""
    missing = (("heading_slip", "most of the record is gaps: a jump in one looks like a trend or like nothing"),)
    number = np.unique(np.floor(held.time_s / observatory.DAY_S / observatory.BLOCK_DAYS), return_inverse=True)[1]
    years = (held.time_s - held.time_s[0]) / YEAR_S
    off = held.residual_deg
    middle = np.array([(np.median(years[number == k]), np.median(off[number == k])) for k in range(number[-1] + 1)])
    if len(middle) < FEWEST_PIECES:
        why = f"the series has {len(middle)} stretches of 27 days; {FEWEST_PIECES} are needed for a trend"
        return Slow(not_testable=(("secular_variation", why), *missing))
    about = middle[:, 0] - middle[:, 0].mean()
    slope = float(about @ middle[:, 1] / (about @ about))
    rest = middle[:, 1] - middle[:, 1].mean() - slope * about
    sigma = float(np.sqrt(rest @ rest / (len(rest) - 2) / (about @ about)))
    size = float(abs(slope) * np.std(years))
    if abs(slope) <= SURE * sigma:
        return Slow(not_testable=missing)
    if size < limit_deg:
        return Slow(not_testable=missing, negligible=(("secular_variation", size),))
    bare, left = (x - np.median(x) for x in (off, off - slope * years))
    proof = show.compared(bare, left, np.full(len(off), angles.rms(left)), held.time_s)
    span = (float(held.time_s[0]), float(held.time_s[-1]))
    place = Where("time", *span, f"from {verdict.stamp(span[0])} to {verdict.stamp(span[1])}")
    parameters = {"deg_year": Parameter(slope, sigma, "degrees/year")}
    made = Finding("secular_variation", "compass", ("heading_slip",), place, span, parameters, size, proof, "")
    return Slow((_told(made, series, model, None),), not_testable=missing)


def _averaged(time_s: Floats, off: Floats, step_s: float) -> tuple[Floats, Floats]:
    number, which = np.unique(np.floor(time_s / step_s), return_inverse=True)
    return (number + 0.5) * step_s, np.bincount(which, off) / np.bincount(which)


def _told(one: Finding, series: FieldSeries, model: EarthField, jump: tuple[float, float] | None) -> Finding:
    """Return a finding of the search in the words of an observatory, with what it could also be."""
    if jump is not None:
        sigma = next(iter(one.parameters.values())).sigma
        size = {"offset_deg": Parameter(-jump[1], sigma, "degrees")}
        text = declination_told.jump(jump, sigma, one.held_out, one.alternatives)
        span = (jump[0], one.when_s[1])
        return replace(one, parameters=size, when_s=span, text=text, applied=False)
    trend = one.parameters["deg_year"]
    by_model = float(np.ptp(model.model_declination_deg)) / max(float(np.ptp(model.time_s)) / YEAR_S, 1e-9)
    slope = float(np.copysign(by_model, model.model_declination_deg[-1] - model.model_declination_deg[0]))
    as_model = model.source != "IGRF" and abs(trend.value - slope) <= LIKE_THE_MODEL * abs(slope)
    known = as_model or series.definitive
    others = () if as_model else one.alternatives if known else (*dict.fromkeys((*one.alternatives, "compass_drift")),)
    text = declination_told.trend(trend, one, slope if as_model else None, others)
    return replace(one, alternatives=others, text=text, applied=False)


def _dated(held: Held, one: Finding) -> tuple[float, float]:
    """Return the date of a jump among the means around where the search has it, and by how much the series rises."""
    near = np.abs(held.time_s - one.when_s[0]) <= NEAR_S
    time_s, off = held.time_s[near], (held.residual_deg - held.quiet_deg)[near]
    size = -next(iter(one.parameters.values())).value
    if len(off) < 4:
        return one.when_s[0], size
    at, _, _ = _best_split(off, 2)
    return float(time_s[at]) - held.step_s / 2.0, size


def _best_split(off: Floats, least: int) -> tuple[int, float, Floats]:
    """Return where a series changes its level best, by how much, and what the two levels leave."""
    tried = range(least, len(off) - least + 1, max(1, len(off) // 600))
    spread = [np.sum(np.abs(part - np.median(part))) for k in tried for part in (off[:k], off[k:])]
    at = tried[int(np.argmin(np.add(spread[::2], spread[1::2])))]
    low, high = np.median(off[:at]), np.median(off[at:])
    return at, float(high - low), np.concatenate([off[:at] - low, off[at:] - high])


def _short_jump(held: Held, limit_deg: float) -> tuple[Finding, tuple[float, float]] | None:
    """Return the jump of a short record, if two levels leave nothing of what else would be a storm."""
    off = held.residual_deg - held.quiet_deg
    least = int(LEAST_SIDE_S / held.step_s)
    if len(off) < 2 * least + 2:
        return None
    at, size, left = _best_split(off, least)
    rest = float(observatory.worst(held.time_s, left)[0].max())
    if abs(size) < limit_deg or rest >= STEADY * limit_deg:
        return None
    date, last = float(held.time_s[at]) - held.step_s / 2.0, float(held.time_s[-1])
    others = ("field_disturbance",) if min(last - date, date - held.time_s[0]) < LEAST_AFTER_S else ()
    sigma = angles.rms(left) / np.sqrt(min(at, len(off) - at) * held.step_s / observatory.WINDOW_S)
    block = np.floor((held.time_s - held.time_s[0]) / observatory.WINDOW_S).astype(int)
    bare = off - np.median(off)
    proof = show.judged(
        (bare**2 - left**2) / (2.0 * angles.rms(left) ** 2), block, (angles.rms(bare), angles.rms(left))
    )
    text = declination_told.jump((date, size), sigma, proof, others)
    parameters = {"offset_deg": Parameter(-size, sigma, "degrees")}
    place = Where("time", date, last, f"from {verdict.stamp(date)} on")
    found = Finding("heading_slip", "compass", others, place, (date, last), parameters, angles.rms(bare), proof, text)
    return found, (date, size)
