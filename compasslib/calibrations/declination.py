"""Comparison of an observatory's declination with IGRF: their constant difference, mostly the crustal field.

No compass is calibrated: A is the observed minus the model's declination, B to E have no meaning here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.calibrations import observatory
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.errors import InputError
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries
from compasslib.types import DAY_S

KIND = "declination"
CONSTANT_HOW = "blocks of 27 days; under 135 days a middle latitude's spread of daily levels, assumed"
AMBIGUITY = (
    "A includes the crustal field, the error of IGRF and an error of the observatory's azimuth mark; one series cannot "
    "separate them."
)
CRUST_NT = 600.0  # largest crustal field that is accepted; most stations have less than 300
ADVICE = "correct the file's columns, units or place, or take the observatory's own file"


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the constant difference of an observatory's declination from the model, the quiet day and the storms.

    The settings are ``latitude`` and ``longitude``, which override the headers', ``declination``, auto or a number that
    replaces the model, and ``table_step_deg``.

    Raises:
        InputError: a file cannot be read, the position is unknown, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    place, header = observatory.station_place(series, settings), (series.latitude, series.longitude)
    warnings = [*series.warnings]
    if np.any(np.abs(angles.difference(place, header)) > 0.5):  # degrees
        warnings.append("the file has the station at {:g} N {:g} E; the YAML's place counts".format(*header))
    of_file = {
        "station": series.station,
        "latitude": _known(place[0]),
        "longitude": _known(place[1]),
        "elevation_m": _known(series.elevation_m),
        "date": _stamp(float(np.mean(series.time_s[[0, -1]])))[:10],
        "definitive": series.definitive,
        "rows": dict(series.counts),
    }
    if why := observatory.too_short_reason(series):
        return Calibration(KIND, "none", 0, 0, details=of_file, why=why, warnings=tuple(warnings))
    field = observatory.model_field(series, settings, str(files[0]))
    warnings += check_field(series, place)
    compared = observatory.compare(series, field)
    if compared.spikes:
        warnings.append(f"{compared.spikes} isolated outliers: spikes, or storms shorter than three hours")
    constant, sigma = compared.constant_deg, compared.constant_sigma_deg
    covariance = np.full((5, 5), np.nan)
    covariance[0, 0] = sigma**2
    # The same constant at every heading: the correction of headings converted to true with the model's declination.
    heading = np.arange(0.0, 360.0, float(settings.get("table_step_deg", 10.0)))
    curve = compared.curve_deg - np.mean(compared.curve_deg)
    residual, calm = compared.residual_deg - constant, compared.disturbed_deg[~compared.stormy]
    observed = angles.difference(series.declination_deg, compared.observed_deg[0])
    quiet_day = {"days": compared.quiet_days, "amplitude_deg": float(np.ptp(curve)) / 2.0, "by_hour_deg": curve}
    return Calibration(
        kind=KIND,
        model=f"{'IGRF' if field.source == 'IGRF' else 'the given declination'} plus a constant",
        n=len(compared.time_s),
        coverage=0,
        coefficients=np.append(constant, np.full(4, np.nan)),
        covariance=covariance,
        residual_rms_deg=angles.rms(residual),
        sources=(
            Source("constant", sigma, CONSTANT_HOW),
            Source(
                "daily variation",
                float(np.std(np.nan_to_num(curve))),
                f"rms of the curve of {compared.quiet_days} days",
            ),
            Source("disturbance", angles.rms(calm), "rms of what level and quiet day leave, storms left out"),
        ),
        table=DeviationTable(heading, np.full(len(heading), constant), np.full(len(heading), sigma)),
        points={
            "time_s": compared.time_s,
            "declination_deg": compared.observed_deg,
            "model_deg": compared.model_deg,
            "level_deg": compared.level_deg,
            "quiet_day_deg": observatory.interpolate_daily_curve(curve, compared.time_s),
            "residual_deg": residual,
            "disturbance_deg": compared.disturbed_deg,
            "storm": compared.stormy.astype(float),
        },
        details=of_file
        | {
            "constant_deg": constant,
            "constant_sigma_deg": sigma,
            "model_source": field.source,
            "days": compared.days,
            "from": _stamp(series.time_s[0]),
            "to": _stamp(series.time_s[-1]),
            "range_deg": float(np.ptp(observed[np.isfinite(observed)])),
            "quiet_day": quiet_day if compared.quiet_days else None,
            "storms": [
                {"from": _stamp(x.begin_s), "to": _stamp(x.end_s), "range_deg": x.range_deg, "rms_deg": x.rms_deg}
                for x in compared.storms
            ],
            "cannot_tell": [AMBIGUITY],
        },
        warnings=(*warnings, *field.warnings),
    )


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _stamp(time_s: float) -> str:
    return f"{np.datetime64(round(time_s), 's')}Z"


def check_field(
    series: FieldSeries,
    place: tuple[float, float],
    *,
    impossible_nT: float = 5000.0,  # more than any crustal field at an observatory
    no_baseline: float = 0.1,
    no_baseline_deg: float = 0.3,
) -> list[str]:
    """Warn if the medians of a month of a file are not the model's at its place, (latitude, longitude), if known.

    Args:
        no_baseline, no_baseline_deg: share of the model's horizontal field, and declination, below which a series is a
            variation about zero.

    Raises:
        InputError: a mistake that affects the declination is identified, or the field is impossible at that place.
    """
    warnings: dict[str, str] = {}
    known = np.isfinite(series.declination_deg)
    if not (np.isfinite(place).all() and known.any()):
        return []
    file = series.origin if len(series.origin) == len(series) else np.zeros(len(series), dtype=np.intp)
    months = np.stack([file, np.floor(series.time_s / (observatory.BLOCK_DAYS * DAY_S)).astype(np.intp)])
    for month in np.unique(months[:, known], axis=1).T:
        part = np.all(months == month[:, None], axis=0)
        first = series.declination_deg[part & known][0]
        off = np.nanmedian(angles.difference(series.declination_deg[part], first))
        declination = float(angles.wrap180(first + off))
        horizontal, vertical = (
            float(np.nanmedian(x[part])) if np.isfinite(x[part]).any() else float("nan")
            for x in (series.horizontal_nT, series.vertical_nT)
        )
        time_s = float(np.median(series.time_s[part]))
        model = [float(x[0]) for x in earthfield.igrf(*place, [time_s])]
        across = model[1] * angles.DEGREE * float(np.abs(angles.chord(angles.difference(declination, model[0]))))
        if not np.nanmax([across, abs(horizontal - model[1]), abs(vertical - model[2])]) > CRUST_NT:
            continue
        variation = abs(declination) < no_baseline_deg < abs(model[0]) or horizontal < no_baseline * model[1]
        why = f"rocks rarely make more than {CRUST_NT:.0f} nT; check columns, units, place and dates"
        why = "a variation about zero: the baseline is missing" if variation else why
        parts = [f"D {declination:+.2f} degrees"]
        parts += [f" H {horizontal:.0f} nT"] if np.isfinite(horizontal) else []
        parts += [f" Z {vertical:+.0f} nT"] if np.isfinite(vertical) else []
        year = np.datetime64(int(time_s), "s").astype("datetime64[Y]")
        by_model = "D {:+.1f} degrees, H {:.0f} nT, Z {:+.0f} nT at {:g} N {:g} E in {}".format(*model, *place, year)
        where = series.files[month[0]] if series.files else series.station
        observed = f"{','.join(parts)} ({why})"
        if variation or across > impossible_nT:
            raise InputError(where, expected=f"about {by_model}, as IGRF has", found=observed, advice=ADVICE)
        warnings.setdefault(where, f"{where}: {observed}, where IGRF has {by_model}")
    return list(warnings.values())


def with_observatory_warnings(field: EarthField, files: Sequence[str | Path]) -> EarthField:
    """Add warnings about a mooring's observatory to its field: mistakes in the file, days not covered.

    Raises:
        InputError: a file cannot be read, or as for ``check_field``.
    """
    if not files:
        return field
    series = iaga2002.read(files)
    warnings = check_field(series, (series.latitude, series.longitude))
    days = np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / DAY_S))
    first, last = np.floor(field.time_s[[0, -1]] / DAY_S)
    covered = float(np.sum((days >= first) & (days <= last)) / (last - first + 1.0))
    if covered < 0.5:
        warnings.append(
            f"the observatory {series.station} covers {100.0 * covered:.0f} % of the deployment's days; elsewhere the "
            "disturbance of the field is taken as zero"
        )
    return replace(field, warnings=(*field.warnings, *warnings))
