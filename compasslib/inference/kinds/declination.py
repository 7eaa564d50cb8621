"""An observatory's declination held against the model of the field plus a constant: what else moved it.

Trends and jumps are judged by the general search, on hourly means with the daily harmonics as nuisance. Storms and
daily variation need no catalogue: the recording is the declination itself. What is left of it after its slow level and
its quiet days is looked at over three hours. Up to a limit the constant is plausible as the field of rocks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, observatory
from compasslib.inference import show, verdict
from compasslib.inference.comparison import Options
from compasslib.inference.finding import Finding, Parameter, Unexplained, Where
from compasslib.inference.kinds import declination_slow, declination_wording
from compasslib.inference.show import HeldOut
from compasslib.inference.verdict import Diagnosis
from compasslib.observatory import FieldComparison, Storm
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries, stamp
from compasslib.types import Floats

MOST_STORMS = 5  # findings; smaller ones are counted in the text of the last
LEFT_OUT_S = 600.0  # stretches of a storm that are left out in turn
FEWEST_DAYS = 5  # that a quiet-day curve must come from to be held against days left out


def diagnose(files: Sequence[str | Path], settings: Mapping[str, Any], options: Options | None = None) -> Diagnosis:
    """Return what an observatory's declination shows that model and constant do not hold.

    Args:
        files: IAGA-2002 files of one observatory.
        settings: as for the calibration of this kind.

    Raises:
        InputError: a file cannot be read, the place is not known, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    if why := observatory.refusal(series):
        return verdict.insufficient(why)
    field = observatory.field_of(series, settings, str(files[0]))
    observatory.check(series, observatory.place_of(series, settings))
    return judge(series, field, options or Options())


def judge(series: FieldSeries, field: EarthField, options: Options) -> Diagnosis:
    """Return the diagnosis of a series that is held against a declination along time plus a constant.

    Args:
        series: of an observatory, at least half a day.
        field: the model's declination along time, or the number in its place.
    """
    limit = options.min_effect_deg
    first = observatory.compare(series, field, limit_deg=limit)
    slow = declination_slow.judge(first, series, field, options)
    compared = observatory.compare(declination_slow.without(series, slow.jumps), field, limit_deg=limit)
    found, small = list(slow.findings), dict(slow.negligible)
    open_constant = "declination_error" not in dict(slow.not_testable)
    constant = [_constant(compared, series, field)] if open_constant else []
    for finding, name, size in (*constant, _daily(compared, limit), *_storms(compared, series)):
        if finding is not None:
            found.append(finding)
        elif size > 0.0:
            small[name] = max(size, small.get(name, 0.0))
    rest = _always_disturbed(compared, limit) or slow.unexplained
    ordered = tuple(sorted(found, key=lambda one: -one.rms_effect_deg))
    return Diagnosis(
        verdict=verdict.of(ordered, rest),
        findings=ordered,
        unexplained=rest,
        separated_by=declination_wording.separated_by(ordered),
        not_testable=slow.not_testable,
        negligible=tuple(small.items()),
        why=declination_wording.why(compared, field.source, ordered),
        curves=slow.curves,
        threshold=slow.threshold,
    )


def plausible_deg(series: FieldSeries, field: EarthField) -> float:
    """Return the largest plausible constant of the rocks of a place, degrees."""
    strength = np.nanmedian(np.append(series.horizontal_nT, field.horizontal_nT))
    return float(np.arctan2(observatory.CRUST_NT, strength)) / angles.DEGREE


def _constant(compared: FieldComparison, series: FieldSeries, field: EarthField) -> tuple[Finding | None, str, float]:
    size, most = abs(compared.constant_deg), plausible_deg(series, field)
    if size - 1.96 * compared.constant_sigma_deg <= most:
        return None, "declination_error", size
    by_model = np.interp(compared.time_s, field.time_s, field.model_declination_deg)
    off = abs(float(np.median(angles.difference(compared.observed_deg, by_model))))
    wrong_number = field.source != "IGRF" and off <= most
    alternatives = () if wrong_number else ("hard_iron", "mounting_offset")
    off_deg = compared.residual_deg
    text = declination_wording.constant(compared, most, field.source, alternatives)
    return (
        _finding(
            "declination_error",
            alternatives,
            span=_span(compared),
            parameters={"error_deg": Parameter(compared.constant_deg, compared.constant_sigma_deg, "degrees")},
            size=(size, _by_folds(off_deg, compared.time_s)),
            text=text,
        ),
        "declination_error",
        size,
    )


def _daily(compared: FieldComparison, limit_deg: float) -> tuple[Finding | None, str, float]:
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
        size=(size, _by_folds(off, compared.time_s, daily=True)),
        text=declination_wording.daily(amplitude, size, compared.quiet_days),
    )
    return (
        replace(finding, where=Where("hour_of_day", 0.0, 24.0, "daily variation, at every hour of the day")),
        "",
        size,
    )


def _storms(compared: FieldComparison, series: FieldSeries) -> list[tuple[Finding | None, str, float]]:
    ordered = sorted(compared.storms, key=lambda storm: -storm.rms_deg)
    calm = compared.disturbed_deg[~compared.stormy]
    noise = angles.rms(calm) if calm.size else float("nan")
    if not ordered:
        largest = float(observatory.three_hour_rms(compared.time_s, compared.disturbed_deg)[0].max())
        return [(None, "field_disturbance", largest)]
    return [
        (
            _storm(compared, series, storm, noise, more=max(len(ordered) - MOST_STORMS, 0)),
            "field_disturbance",
            storm.rms_deg,
        )
        for storm in ordered[:MOST_STORMS]
    ]


def _storm(compared: FieldComparison, series: FieldSeries, storm: Storm, noise_deg: float, *, more: int) -> Finding:
    proof = _interpolated(compared, series, storm)
    numbers = {
        "range_deg": Parameter(storm.range_deg, np.sqrt(2.0) * noise_deg, "degrees"),
        "worst_three_hours_deg": Parameter(storm.worst_deg, noise_deg, "degrees"),
    }
    text = declination_wording.storm(storm, compared, proof, more)
    return _finding(
        "field_disturbance",
        (),
        span=(storm.begin_s, storm.end_s),
        parameters=numbers,
        size=(storm.rms_deg, proof),
        text=text,
    )


def _finding(
    effect: str,
    alternatives: tuple[str, ...],
    *,
    span: tuple[float, float],
    parameters: Mapping[str, Parameter],
    size: tuple[float, HeldOut],
    text: str,
) -> Finding:
    place = Where("time", *span, f"from {stamp(span[0])} to {stamp(span[1])}")
    return Finding(effect, "compass", alternatives, place, span, parameters, size[0], size[1], text)


def _span(compared: FieldComparison) -> tuple[float, float]:
    return float(compared.time_s[0]), float(compared.time_s[-1])


def _interpolated(compared: FieldComparison, series: FieldSeries, storm: Storm) -> HeldOut:
    """Return what the storm's own curve adds on stretches left out of it, between its neighbours.

    It foretells no other day and no other place; it shows that the disturbance is a course in time and not noise.
    """
    inside = (series.time_s >= storm.begin_s) & (series.time_s <= storm.end_s) & np.isfinite(series.declination_deg)
    time_s, observed = series.time_s[inside], series.declination_deg[inside]
    base = np.interp(time_s, compared.time_s, compared.model_deg + compared.level_deg)
    before = angles.difference(observed, base) - observatory.daily_curve_at(compared.curve_deg, time_s)
    stretch = np.floor((time_s - storm.begin_s) / max(LEFT_OUT_S, float(np.median(np.diff(series.time_s)))))
    left = np.array(before)
    for fold in (0, 1):
        out = stretch % 2 == fold
        if out.any() and not out.all():
            left[out] = before[out] - np.interp(time_s[out], time_s[~out], before[~out])
    block = np.floor((time_s - storm.begin_s) / observatory.WINDOW_S).astype(int)
    return _proof(before, left, block)


def _by_folds(off_deg: Floats, time_s: Floats, *, daily: bool = False) -> HeldOut:
    """Return what a constant, or a daily curve, adds on days that it was not made from."""
    day = np.floor(time_s / observatory.DAY_S).astype(int)
    unit = day if day[-1] > day[0] else np.floor(time_s / observatory.HOUR_S).astype(int)
    left = np.array(off_deg)
    for fold in range(show.FOLDS):
        out = unit % show.FOLDS == fold
        if not out.any() or out.all():
            continue
        simulated = np.full(int(out.sum()), float(np.median(off_deg[~out])))
        if daily:
            simulated = observatory.daily_curve_at(observatory.hourly_median(time_s, off_deg, ~out), time_s[out])
        left[out] = off_deg[out] - simulated
    return _proof(off_deg, left, unit - unit[0])


def _proof(before: Floats, after: Floats, block: NDArray[np.intp]) -> HeldOut:
    width = max(angles.rms(after), 1e-6)
    each = (before**2 - after**2) / (2.0 * width**2)
    return show.judged(each, block, (angles.rms(before), angles.rms(after)))


def _always_disturbed(compared: FieldComparison, limit_deg: float) -> Unexplained | None:
    """Return that the series is restless at all times, if it is: then no storm stands out."""
    if compared.ordinary_deg < limit_deg:
        return None
    span = _span(compared)
    place = Where("time", *span, f"from {stamp(span[0])} to {stamp(span[1])}")
    text = declination_wording.restless(compared.ordinary_deg)
    return Unexplained(("time",), place, span, compared.ordinary_deg, (), text)
