"""Diagnose an observatory's declination against a model of the earth's field plus a constant.

Jumps are changes of the daily level, a trend that of medians over rotations of the sun, storms three-hour windows of
what level and quiet-day curve leave.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import FieldComparison
from compasslib.effects import Effect
from compasslib.effects.effect import DAY_S, HOUR_S, YEAR_S
from compasslib.effects.readout import HeadingSlip
from compasslib.effects.reference import DeclinationError, FieldDisturbance, SecularVariation
from compasslib.inference import diagnosis, finding
from compasslib.inference.comparison import Comparison, Options, build_finding, equal_chances
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import BinnedResidual, CovariateRange, Finding, Parameter
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries, iso_time
from compasslib.statistics.least_squares import robust_width
from compasslib.statistics.resampling import blocks_by_count, blocks_by_span
from compasslib.types import Floats

SEPARATED_BY = {
    "compass_drift": "absolute measurements of the declination at the station, or its definitive data",
    "field_disturbance": "a day more of the series: a storm's level does not stay",
    "hard_iron": "a survey of the field around the station",
    "mounting_offset": "the azimuth mark measured again",
}
DRIFTS = "the declination drifts beyond the simulation, and so its constant depends on the date"
RESTLESS = "at all times (restless, as in the auroral zone or by noise of the recording, so that no storm stands out)"
GAPS = "most of the record is gaps: a jump in one looks like a trend or like nothing"
MOST_STORMS = 5  # most storm findings; the last sentence of each gives the number of smaller storms
LEVELS = 5  # days on either side whose median shows a jump
JUMP_WIDTHS = 8.0  # least change of the level at a jump, in robust widths of such changes
FEWEST_PIECES = 6  # rotations of the sun, for a trend
TREND_SIGMAS = 5.0  # least trend, in standard errors
PRECISION_DEG = 0.01  # least width of a residual: resolution of a published declination


@dataclass(frozen=True)
class Jump:
    """A jump of the declination, in degrees."""

    date_s: float
    rise_deg: float
    sigma_deg: float
    may_be_storm: bool = False  # whether either level lasts for less than a day


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None) -> Diagnosis:
    """Diagnose an observatory's declination, of IAGA-2002 files, against a field model plus a constant.

    Raises:
        InputError: a file cannot be read, the place is not known, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    if why := observatory.too_short_reason(series):
        return diagnosis.insufficient(why)
    field, _ = observatory.station_field(series, settings, str(files[0]))
    return diagnose_series(series, field, options or Options())


def diagnose_series(series: FieldSeries, field: EarthField, options: Options) -> Diagnosis:
    """Diagnose a series of at least half a day against a declination along time plus a constant."""
    limit = options.min_effect_deg
    jumps, jump_untested = find_jumps(observatory.compare(series, field, limit_deg=limit), limit)
    risen = sum((jump.rise_deg * (series.time_s >= jump.date_s) for jump in jumps), np.zeros(len(series)))
    steady = replace(series, declination_deg=angles.wrap180(series.declination_deg - risen))
    compared = observatory.compare(steady, field, limit_deg=limit)
    trend, trend_untested = _trend_finding(compared, series, field)
    drifts = trend is not None and trend.rms_effect_deg >= limit
    single = (trend, None if drifts else _constant_finding(compared, series, field), _daily_finding(compared))
    several = [*(_jump_finding(compared, jump) for jump in jumps), *_storm_findings(compared, steady)]
    found = [*several, *(item for item in single if item is not None)]
    matter = [item for item in found if item.rms_effect_deg >= limit]
    findings = tuple(sorted(matter, key=lambda item: -item.rms_effect_deg))
    largest = float(observatory.three_hour_rms(compared.time_s, compared.disturbed_deg)[0].max())
    sizes = {"field_disturbance": largest} | ({} if drifts else {"declination_error": abs(compared.constant_deg)})
    sizes |= {item.effect: max(item.rms_effect_deg, sizes.get(item.effect, 0.0)) for item in found}
    untested = {"secular_variation": trend_untested, "heading_slip": jump_untested}
    untested["declination_error"] = DRIFTS if drifts else ""
    unexplained, along_time = None, _along_time(compared)
    if compared.ordinary_deg >= limit:  # disturbed at all times: then no storm stands out
        place = CovariateRange("time", *along_time.span_s, RESTLESS)
        unexplained = along_time.unexplained([], compared.ordinary_deg, [item.effect for item in findings], place)
    pairs = [(item.effect, other) for item in findings for other in item.alternatives]
    separated = [f"{a} or {b}: {SEPARATED_BY.get(b, 'a second observatory near by')}" for a, b in pairs]
    quiet = f"quiet day from {compared.quiet_days} days" if compared.quiet_days else "no quiet day known"
    return Diagnosis(
        verdict=diagnosis.overall_verdict(findings, unexplained),
        findings=findings,
        unexplained=unexplained,
        separated_by="; ".join(dict.fromkeys(separated)) or None,
        not_testable=tuple((effect, why) for effect, why in untested.items() if why),
        negligible=tuple((name, size) for name, size in sizes.items() if name not in {x.effect for x in findings}),
        why=f"{len(compared.time_s)} means over {compared.days} days against {_model_name(field)} plus "
        f"{compared.constant_deg:+.3f} ± {1.96 * compared.constant_sigma_deg:.3f} degrees (95 %), {quiet}"
        + ("" if findings else "; the residual is negligible"),
        curves=(_curve(compared, steady, series),) if compared.days > finding.CURVE_BINS else (),
    )


def _model_name(field: EarthField) -> str:
    return "IGRF" if field.source == "IGRF" else "the given declination"


def _along_time(compared: FieldComparison) -> Comparison:
    return Comparison(time_s=compared.time_s, terms=(), covariates={"time": compared.time_s})


def _curve(compared: FieldComparison, steady: FieldSeries, series: FieldSeries) -> BinnedResidual:
    """Average the residual along time, with and without the jumps."""
    off = compared.residual_deg - compared.quiet_deg
    risen = angles.difference(series.declination_deg, steady.declination_deg)
    with_jumps = off + np.interp(compared.time_s, series.time_s, risen)
    bins = blocks_by_count(compared.time_s, finding.CURVE_BINS)
    each = [bins == k for k in np.unique(bins)]
    days = np.array([len(np.unique(np.floor(compared.time_s[k] / DAY_S))) for k in each])
    means = [np.array([np.mean(x[k]) for k in each]) for x in (compared.time_s, with_jumps, off)]
    return BinnedResidual(
        "time", means[0], means[1], means[2], np.array([np.std(off[k]) for k in each]) / np.sqrt(days)
    )


def find_jumps(compared: FieldComparison, limit_deg: float) -> tuple[list[Jump], str]:
    """Find jumps of the baseline beyond the trend, not over gaps, and explain where they cannot be found."""
    off, time_s, step_s = compared.residual_deg - compared.quiet_deg, compared.time_s, compared.step_s
    days, begins = np.unique(np.floor(time_s / DAY_S), return_index=True)
    if len(days) < 4 * LEVELS:
        least = int(observatory.WINDOW_S / step_s)
        untested = f"the series has {len(days)} days; in fewer than {4 * LEVELS} only a jump between calm levels shows"
        if len(off) < 2 * least + 2:
            return [], untested
        at, size, left = _best_split(off, least)
        # The rms without the largest value, since the jump may fall into one mean.
        if abs(size) < limit_deg or 2.0 * observatory.three_hour_rms(time_s, left)[1].max() >= limit_deg:
            return [], untested
        shorter_s = float(min(time_s[-1] - time_s[at], time_s[at] - time_s[0]))
        sigma = angles.rms(left) / np.sqrt(max(shorter_s / observatory.WINDOW_S, 1.0))
        return [Jump(float(time_s[at]) - step_s / 2.0, size, sigma, may_be_storm=shorter_s < DAY_S)], ""
    levels = np.array([np.median(part) for part in np.split(off, begins[1:])])
    middle = np.median(np.lib.stride_tricks.sliding_window_view(levels, LEVELS), axis=1)
    change = middle[LEVELS:] - middle[:-LEVELS]
    near = days[2 * LEVELS - 1 :] - days[: 1 - 2 * LEVELS] < 3 * LEVELS
    change = np.where(near, change - np.median(change), 0.0)
    least_deg, jumps = max(limit_deg, JUMP_WIDTHS * robust_width(change)), []
    while np.max(np.abs(change)) > least_deg:
        at = int(np.argmax(np.abs(change)))
        around = slice(begins[at], begins[at + 2 * LEVELS] if at + 2 * LEVELS < len(begins) else len(off))
        split, size, left = _best_split(off[around], 2)
        date_s = float(time_s[around][split]) - step_s / 2.0
        jumps.append(Jump(date_s, size, angles.rms(left) * float(np.sqrt(2.0 / LEVELS))))
        change[max(at - 2 * LEVELS, 0) : at + 2 * LEVELS] = 0.0
    return jumps, GAPS if _mostly_gaps(time_s) else ""


def _mostly_gaps(time_s: Floats) -> bool:
    return 2 * len(np.unique(np.floor(time_s / DAY_S))) < float(np.ptp(time_s)) / DAY_S


def _best_split(off: Floats, least: int) -> tuple[int, float, Floats]:
    """Find the best change of level of a series: its index, its size, and the residual from the two levels."""
    splits = range(least, len(off) - least + 1, max(1, len(off) // 600))
    spread = [np.sum(np.abs(part - np.median(part))) for k in splits for part in (off[:k], off[k:])]
    at = splits[int(np.argmin(np.add(spread[::2], spread[1::2])))]
    low, high = np.median(off[:at]), np.median(off[at:])
    return at, float(high - low), np.concatenate([off[:at] - low, off[at:] - high])


def _jump_finding(compared: FieldComparison, jump: Jump) -> Finding:
    """Describe a jump, given the comparison without any."""
    after = compared.time_s >= jump.date_s
    off, share = compared.residual_deg - compared.quiet_deg + jump.rise_deg * after, float(np.mean(after))
    off = off - np.median(off)
    return _finding(
        compared,
        HeadingSlip(date_s=jump.date_s),
        {"offset_deg": Parameter(-jump.rise_deg, jump.sigma_deg, "degrees")},
        off,
        lambda use: np.where(after, np.median(off[use & after]), np.median(off[use & ~after])),
        alternatives=("field_disturbance",) if jump.may_be_storm else (),
        size_deg=float(abs(jump.rise_deg) * np.sqrt(share * (1.0 - share))),
        physics=f"the baseline of the declination jumped by {jump.rise_deg:+.2f}°, as where a sensor turned",
    )


def _trend_finding(compared: FieldComparison, series: FieldSeries, field: EarthField) -> tuple[Finding | None, str]:
    """Find a trend beyond the model, or explain why the record is too short for one."""
    time_s, years = compared.time_s, (compared.time_s - compared.time_s[0]) / YEAR_S
    off = compared.residual_deg - np.median(compared.residual_deg)
    pieces = len(np.unique(np.floor(time_s / DAY_S / observatory.BLOCK_DAYS)))
    if pieces < FEWEST_PIECES:
        return None, f"the series has {pieces} stretches of 27 days; {FEWEST_PIECES} are needed for a trend"
    slope, sigma = _slope(time_s, off)
    if abs(slope) <= TREND_SIGMAS * sigma:
        return None, ""

    def line(use: NDArray[np.bool_]) -> Floats:
        drift = _slope(time_s[use], off[use])[0] * years
        return np.asarray(drift + np.median((off - drift)[use]))

    rise, span_s = (float(x[-1] - x[0]) for x in (field.model_declination_deg, field.time_s))
    by_model = rise / span_s * YEAR_S
    of_model = field.source != "IGRF" and abs(slope - by_model) <= abs(by_model) / 4.0
    others = [*["heading_slip"] * _mostly_gaps(time_s), *["compass_drift"] * (not series.definitive)]
    told = f", as IGRF does ({by_model:+.3f}° a year): the given declination is constant" if of_model else ""
    made = _finding(
        compared,
        SecularVariation(),
        {"deg_year": Parameter(slope, sigma, "degrees/year")},
        off,
        line,
        alternatives=() if of_model else tuple(others),
        size_deg=float(abs(slope) * np.std(years)),
        unit_s=finding.HELD_OUT_BLOCK_S,
        physics=f"the declination drifts beyond the simulation{told}",
    )
    return made, ""


def _slope(time_s: Floats, off: Floats) -> tuple[float, float]:
    """Fit a line to medians over rotations of the sun: slope and standard error, degrees a year."""
    number = np.floor(time_s / DAY_S / observatory.BLOCK_DAYS)
    each = np.array([(np.median(time_s[number == k]), np.median(off[number == k])) for k in np.unique(number)])
    (slope, _), covariance = np.polyfit((each[:, 0] - each[:, 0].mean()) / YEAR_S, each[:, 1], 1, cov=True)
    return float(slope), float(np.sqrt(covariance[0, 0]))


def _constant_finding(compared: FieldComparison, series: FieldSeries, field: EarthField) -> Finding | None:
    """Find a constant that is larger than the crustal field explains."""
    size, sigma, off = abs(compared.constant_deg), compared.constant_sigma_deg, compared.residual_deg
    strength = np.nanmedian(np.append(series.horizontal_nT, field.horizontal_nT))
    most = float(np.arctan2(observatory.CRUST_NT, strength)) / angles.DEGREE
    if size - 1.96 * sigma <= most:
        return None
    by_model = np.interp(compared.time_s, field.time_s, field.model_declination_deg)
    from_model = abs(float(np.median(angles.difference(compared.observed_deg, by_model))))
    wrong_number = field.source != "IGRF" and from_model <= most
    why = "and IGRF agrees with the recording: the given number is wrong" if wrong_number else f"rocks make {most:.1f}°"
    return _finding(
        compared,
        DeclinationError(),
        {"error_deg": Parameter(compared.constant_deg, sigma, "degrees")},
        off,
        lambda use: np.full(len(use), np.median(off[use])),
        alternatives=() if wrong_number else ("hard_iron", "mounting_offset"),
        size_deg=size,
        physics=f"the declination differs from {_model_name(field)} by a constant, {why}",
    )


def _daily_finding(compared: FieldComparison) -> Finding | None:
    """Find a daily variation; its amplitude is half of its range."""
    if compared.quiet_days < observatory.MIN_DAYS:
        return None
    time_s, off = compared.time_s, compared.disturbed_deg + compared.quiet_deg
    sigma = angles.rms(compared.disturbed_deg[~compared.stormy]) / np.sqrt(compared.quiet_days)
    return _finding(
        compared,
        FieldDisturbance(),
        {"amplitude_deg": Parameter(float(np.ptp(compared.curve_deg)) / 2.0, sigma, "degrees")},
        off,
        lambda use: observatory.interpolate_daily_curve(observatory.hourly_median(time_s, off, use), time_s),
        size_deg=float(np.std(compared.curve_deg)),
        physics=f"magnetic north swings every day, by the median of {compared.quiet_days} quiet days",
        place=CovariateRange("hour_of_day", 0.0, 24.0, "at every hour of the day"),
    )


def _storm_findings(compared: FieldComparison, series: FieldSeries) -> list[Finding]:
    """Describe the largest storms, each scored by interpolation between held-out stretches: it is no noise."""
    calm, more = compared.disturbed_deg[~compared.stormy], max(len(compared.storms) - MOST_STORMS, 0)
    noise_deg = angles.rms(calm) if calm.size else float("nan")
    result = []
    for storm in sorted(compared.storms, key=lambda item: -item.rms_deg)[:MOST_STORMS]:
        inside = (series.time_s >= storm.begin_s) & (series.time_s <= storm.end_s) & np.isfinite(series.declination_deg)
        time_s, span = series.time_s[inside], (storm.begin_s, storm.end_s)
        base = np.interp(time_s, compared.time_s, compared.model_deg + compared.level_deg)
        off = angles.difference(series.declination_deg[inside], base)
        off -= observatory.interpolate_daily_curve(compared.curve_deg, time_s)
        physics = f"a disturbance of the earth's field, {storm.worst_deg:.2f}° rms in its worst three hours"
        physics += "" if compared.quiet_days else "; no quiet day is known: daily variation is part of it"
        physics += f"; {more} smaller storms are not listed" if more else ""
        made = _finding(
            compared,
            FieldDisturbance(),
            {
                "range_deg": Parameter(storm.range_deg, float(np.sqrt(2.0)) * noise_deg, "degrees"),
                "worst_three_hours_deg": Parameter(storm.worst_deg, noise_deg, "degrees"),
            },
            off,
            lambda use, time_s=time_s, off=off: np.interp(time_s, time_s[use], off[use]),  # type: ignore[misc]
            time_s=time_s,
            size_deg=storm.rms_deg,
            unit_s=max(observatory.AVERAGED_S, float(np.median(np.diff(series.time_s)))),
            physics=physics,
            place=CovariateRange("time", *span, f"from {iso_time(span[0])} to {iso_time(span[1])}"),
            span_s=span,
        )
        result.append(made)
    return result


def _finding(
    compared: FieldComparison,
    term: Effect,
    parameters: Mapping[str, Parameter],
    off_deg: Floats,
    predict: Callable[[NDArray[np.bool_]], Floats],
    *,
    time_s: Floats | None = None,
    unit_s: float = 0.0,
    alternatives: tuple[str, ...] = (),
    place: CovariateRange | None = None,
    **described: Any,
) -> Finding:
    """Build a finding, scored by its prediction of held-out stretches, shown along time unless a place is given."""
    time_s = compared.time_s if time_s is None else time_s
    unit_s = unit_s or (DAY_S if np.ptp(time_s) > finding.FOLDS * DAY_S else HOUR_S)
    fold, left = blocks_by_span(time_s, unit_s) % finding.FOLDS, np.array(off_deg)
    for out in (fold == k for k in range(finding.FOLDS)):
        if out.any() and not out.all():
            left[out] -= predict(~out)[out]
    block = blocks_by_span(time_s, max(unit_s, observatory.WINDOW_S))
    proof = finding.compare_residuals(off_deg, left, max(angles.rms(left), PRECISION_DEG), block)
    of_series, chances = _along_time(compared), equal_chances(term.name, *alternatives)
    place = place or of_series.where("time", of_series.span_s)
    return build_finding(of_series, term, chances, parameters, proof=proof, place=place, **described)
