"""Diagnose an observatory's declination against a model of the earth's field plus a constant.

Trends and jumps are tested by the general search, on hourly means with daily harmonics as nuisance or on daily means.
Storms and daily variation are detected in the declination itself, storms in three-hour windows of its residual from
slow level and quiet-day curve. Up to a limit the constant is plausible as the crustal field.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.calibrations import declination as field_check
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import FieldComparison, Storm
from compasslib.inference import diagnosis, long_record
from compasslib.inference import finding as findings
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import CovariateRange, Finding, HeldOut, Parameter, Unexplained
from compasslib.inference.kinds import declination_slow
from compasslib.inference.kinds.declination_slow import (
    DRIFTS,
    LEAST_COVERED,
    SlowFindings,
    compare_series,
    date_jump,
    large_jumps,
    remove_jumps,
    reword_finding,
    short_jump,
    trend_of_pieces,
    why_too_short,
)
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries, iso_time
from compasslib.types import Floats

SEPARATED_BY = {
    "compass_drift": "absolute measurements of the declination at the station, or its definitive data",
    "field_disturbance": "a day more of the series: a storm's level does not stay",
    "hard_iron": "a survey of the field around the station",
    "mounting_offset": "the azimuth mark measured again",
    "heading_slip": "more of the series around the date, or the observatory's log",
    "secular_variation": "more years, or a second observatory near by",
}

MOST_STORMS = 5  # most storm findings; their texts give the number of smaller storms
LEFT_OUT_S = 600.0  # length of the stretches of a storm that are held out alternately
FEWEST_DAYS = 5  # fewest quiet days for a finding on the quiet-day curve


def slow_findings(compared: FieldComparison, series: FieldSeries, model: EarthField, options: Options) -> SlowFindings:
    """Find the trend and the jumps of a series."""
    if why := why_too_short(compared):
        jump = short_jump(compared, options.min_effect_deg) if compared.storms else None
        missing = [("secular_variation", why)] + ([] if jump else [("heading_slip", why)])
        return SlowFindings((jump[0],) if jump else (), (jump[1],) if jump else (), not_testable=tuple(missing))
    if compared.days / (float(np.ptp(compared.time_s)) / observatory.DAY_S + 1.0) < LEAST_COVERED:
        return trend_of_pieces(compared, series, model, options.min_effect_deg)
    limit = options.min_effect_deg
    large = large_jumps(compared, limit)
    level = observatory.compare(remove_jumps(series, tuple(finding[1] for finding in large)), model, limit_deg=limit)
    searched = long_record.diagnose(compare_series(level, model), options)
    dates = {
        id(finding): date_jump(level, finding) for finding in searched.findings if finding.effect == "heading_slip"
    }
    drifts = any(finding.effect == "secular_variation" for finding in searched.findings)
    matter = [finding[0] for finding in large if finding[0].rms_effect_deg >= limit]
    small = [(finding[0].effect, finding[0].rms_effect_deg) for finding in large if finding[0].rms_effect_deg < limit]
    return SlowFindings(
        findings=(
            *matter,
            *(reword_finding(finding, series, model, dates.get(id(finding))) for finding in searched.findings),
        ),
        jumps=(*(finding[1] for finding in large), *dates.values()),
        unexplained=searched.unexplained,
        negligible=(*searched.negligible, *small),
        not_testable=(("declination_error", DRIFTS),) if drifts else (),
        curves=searched.curves,
        threshold=searched.threshold,
    )


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None) -> Diagnosis:
    """Diagnose an observatory's declination against a field model plus a constant.

    Args:
        files: IAGA-2002 files of one observatory.
        settings: settings of a calibration of this kind.

    Raises:
        InputError: a file cannot be read, the place is not known, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    if why := observatory.too_short_reason(series):
        return diagnosis.insufficient(why)
    field = observatory.model_field(series, settings, str(files[0]))
    field_check.check_field(series, observatory.station_place(series, settings))
    return diagnose_series(series, field, options or Options())


def diagnose_series(series: FieldSeries, field: EarthField, options: Options) -> Diagnosis:
    """Diagnose a series against a declination along time plus a constant.

    Args:
        series: series of an observatory, at least half a day.
        field: declination along time by the model, or a given constant.
    """
    limit = options.min_effect_deg
    first = observatory.compare(series, field, limit_deg=limit)
    slow = slow_findings(first, series, field, options)
    compared = observatory.compare(declination_slow.remove_jumps(series, slow.jumps), field, limit_deg=limit)
    findings, small = list(slow.findings), dict(slow.negligible)
    open_constant = "declination_error" not in dict(slow.not_testable)
    constant = [_constant_finding(compared, series, field)] if open_constant else []
    for finding, name, size in (*constant, _daily_finding(compared, limit), *_storm_findings(compared, series)):
        if finding is not None:
            findings.append(finding)
        elif size > 0.0:
            small[name] = max(size, small.get(name, 0.0))
    unexplained, span = slow.unexplained, _span(compared)
    if compared.ordinary_deg >= limit:  # disturbed at all times: then no storm stands out
        place = CovariateRange("time", *span, f"from {iso_time(span[0])} to {iso_time(span[1])}")
        text = (
            f"The declination is restless at all times, by {compared.ordinary_deg:.2f}° rms over three hours in the "
            "middle of the record: the ordinary weather of a station in the auroral zone, or noise of the recording. "
            "No storm stands out."
        )
        unexplained = Unexplained(("time",), place, span, compared.ordinary_deg, (), text)
    ordered = tuple(sorted(findings, key=lambda item: -item.rms_effect_deg))
    pairs = [(item.effect, other) for item in ordered for other in item.alternatives]
    separated = [f"{a} or {b}: {SEPARATED_BY.get(b, 'a second observatory near by')}" for a, b in pairs]
    quiet = f"quiet day from {compared.quiet_days} days" if compared.quiet_days else "no quiet day known"
    return Diagnosis(
        verdict=diagnosis.overall_verdict(ordered, unexplained),
        findings=ordered,
        unexplained=unexplained,
        separated_by="; ".join(dict.fromkeys(separated)) or None,
        not_testable=slow.not_testable,
        negligible=tuple(small.items()),
        why=f"{len(compared.time_s)} means over {compared.days} days against {_model_name(field)} plus "
        f"{compared.constant_deg:+.3f} ± {1.96 * compared.constant_sigma_deg:.3f} degrees (95 %), {quiet}"
        + ("" if ordered else "; the residual is negligible"),
        curves=slow.curves,
        threshold=slow.threshold,
    )


def _model_name(field: EarthField) -> str:
    return "IGRF" if field.source == "IGRF" else "the given declination"


def _constant_finding(
    compared: FieldComparison, series: FieldSeries, field: EarthField
) -> tuple[Finding | None, str, float]:
    """Find a constant that is larger than the crustal field explains."""
    size, sigma = abs(compared.constant_deg), compared.constant_sigma_deg
    strength = np.nanmedian(np.append(series.horizontal_nT, field.horizontal_nT))
    most = float(np.arctan2(field_check.CRUST_NT, strength)) / angles.DEGREE
    if size - 1.96 * sigma <= most:
        return None, "declination_error", size
    by_model = np.interp(compared.time_s, field.time_s, field.model_declination_deg)
    off = abs(float(np.median(angles.difference(compared.observed_deg, by_model))))
    wrong_number = field.source != "IGRF" and off <= most
    text = (
        f"The declination differs from {_model_name(field)} by {compared.constant_deg:+.2f} ± {1.96 * sigma:.2f} "
        f"degrees (95 %) at all times; rocks make up to {most:.1f}. "
    )
    text += (
        "IGRF agrees with the recording: the given number is wrong."
        if wrong_number
        else "A wrong declination or place, strong rocks and a turned azimuth mark look the same here."
    )
    finding = _finding(
        "declination_error",
        () if wrong_number else ("hard_iron", "mounting_offset"),
        span=_span(compared),
        parameters={"error_deg": Parameter(compared.constant_deg, sigma, "degrees")},
        size=(size, _fold_gain(compared.residual_deg, compared.time_s)),
        text=text,
    )
    return finding, "declination_error", size


def _daily_finding(compared: FieldComparison, limit_deg: float) -> tuple[Finding | None, str, float]:
    """Find a daily variation; its amplitude is half of its range."""
    size = float(np.std(np.nan_to_num(compared.curve_deg)))
    if size < limit_deg or compared.quiet_days < FEWEST_DAYS:
        return None, "field_disturbance", size
    amplitude = float(np.ptp(compared.curve_deg)) / 2.0
    off = compared.disturbed_deg + compared.quiet_deg
    sigma = angles.rms(compared.disturbed_deg[~compared.stormy]) / np.sqrt(compared.quiet_days)
    finding = _finding(
        "field_disturbance",
        (),
        span=_span(compared),
        parameters={"amplitude_deg": Parameter(amplitude, sigma, "degrees")},
        size=(size, _fold_gain(off, compared.time_s, daily=True)),
        text=f"Every day magnetic north swings by {amplitude:.2f}° to either side, {size:.2f}° rms: the daily "
        f"variation, by the median of {compared.quiet_days} quiet days.",
    )
    place = CovariateRange("hour_of_day", 0.0, 24.0, "daily variation, at every hour of the day")
    return replace(finding, where=place), "", size


def _storm_findings(compared: FieldComparison, series: FieldSeries) -> list[tuple[Finding | None, str, float]]:
    """Describe the largest storms; the last sentence of each gives the number of smaller ones."""
    if not compared.storms:
        largest = float(observatory.three_hour_rms(compared.time_s, compared.disturbed_deg)[0].max())
        return [(None, "field_disturbance", largest)]
    calm, more = compared.disturbed_deg[~compared.stormy], max(len(compared.storms) - MOST_STORMS, 0)
    noise_deg = angles.rms(calm) if calm.size else float("nan")
    quiet = "" if compared.quiet_days else " No quiet day is known: daily variation is part of it."
    others = f" {more} smaller storms are not listed." if more else ""
    result: list[tuple[Finding | None, str, float]] = []
    for storm in sorted(compared.storms, key=lambda item: -item.rms_deg)[:MOST_STORMS]:
        proof = _interpolation_gain(compared, series, storm)
        text = (
            f"From {iso_time(storm.begin_s)} to {iso_time(storm.end_s)} a disturbance of the earth's field moves "
            f"magnetic north by {storm.rms_deg:.2f}° rms in its disturbed hours, {storm.worst_deg:.2f}° in its worst "
            f"three; highest minus lowest declination is {storm.range_deg:.1f}°.{quiet} The model of it is the "
            f"recorded course itself: on held-out stretches the residual goes from {proof.rms_before_deg:.2f}° to "
            f"{proof.rms_after_deg:.2f}° rms (p = {proof.p_value:.3g}); it predicts no other day or place.{others}"
        )
        numbers = {
            "range_deg": Parameter(storm.range_deg, np.sqrt(2.0) * noise_deg, "degrees"),
            "worst_three_hours_deg": Parameter(storm.worst_deg, noise_deg, "degrees"),
        }
        span, size = (storm.begin_s, storm.end_s), (storm.rms_deg, proof)
        finding = _finding("field_disturbance", (), span=span, parameters=numbers, size=size, text=text)
        result.append((finding, "field_disturbance", storm.rms_deg))
    return result


def _finding(
    effect: str,
    alternatives: tuple[str, ...],
    *,
    span: tuple[float, float],
    parameters: Mapping[str, Parameter],
    size: tuple[float, HeldOut],
    text: str,
) -> Finding:
    place = CovariateRange("time", *span, f"from {iso_time(span[0])} to {iso_time(span[1])}")
    return Finding(effect, "compass", alternatives, place, span, parameters, size[0], size[1], text)


def _span(compared: FieldComparison) -> tuple[float, float]:
    return float(compared.time_s[0]), float(compared.time_s[-1])


def _interpolation_gain(compared: FieldComparison, series: FieldSeries, storm: Storm) -> HeldOut:
    """Score the storm's own curve on held-out stretches, interpolated between their neighbours.

    This predicts no other day or place; it shows that the disturbance is continuous in time and not noise.
    """
    inside = (series.time_s >= storm.begin_s) & (series.time_s <= storm.end_s) & np.isfinite(series.declination_deg)
    time_s, observed = series.time_s[inside], series.declination_deg[inside]
    base = np.interp(time_s, compared.time_s, compared.model_deg + compared.level_deg)
    before = angles.difference(observed, base) - observatory.interpolate_daily_curve(compared.curve_deg, time_s)
    stretch = np.floor((time_s - storm.begin_s) / max(LEFT_OUT_S, float(np.median(np.diff(series.time_s)))))
    left = np.array(before)
    for fold in (0, 1):
        out = stretch % 2 == fold
        if out.any() and not out.all():
            left[out] = before[out] - np.interp(time_s[out], time_s[~out], before[~out])
    block = np.floor((time_s - storm.begin_s) / observatory.WINDOW_S).astype(int)
    return _residual_gain(before, left, block)


def _fold_gain(off_deg: Floats, time_s: Floats, *, daily: bool = False) -> HeldOut:
    """Score a constant, or a daily curve, on held-out days, or on held-out hours of a single day."""
    day = np.floor(time_s / observatory.DAY_S).astype(int)
    unit = day if day[-1] > day[0] else np.floor(time_s / observatory.HOUR_S).astype(int)
    left = np.array(off_deg)
    for fold in range(findings.FOLDS):
        out = unit % findings.FOLDS == fold
        if not out.any() or out.all():
            continue
        simulated = np.full(int(out.sum()), float(np.median(off_deg[~out])))
        if daily:
            simulated = observatory.interpolate_daily_curve(
                observatory.hourly_median(time_s, off_deg, ~out), time_s[out]
            )
        left[out] = off_deg[out] - simulated
    return _residual_gain(off_deg, left, unit - unit[0])


def _residual_gain(before: Floats, after: Floats, block: NDArray[np.intp]) -> HeldOut:
    width = max(angles.rms(after), 1e-6)
    each = (before**2 - after**2) / (2.0 * width**2)
    return findings.bootstrap_gain(each, block, (angles.rms(before), angles.rms(after)))
