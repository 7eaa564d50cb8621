"""An observatory's declination against IGRF at its place and time: what a constant, the field of the rocks, adds.

No compass is calibrated: A is what must be added to the model's declination, B to E have no meaning here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, observatory
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.observatory import FieldComparison, Storm
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries
from compasslib.types import Floats

KIND = "declination"
STORM_DEG = 0.5  # rms over three hours from which a disturbance is listed as a storm
FARTHEST_DEG = 0.5  # between header and YAML
CONSTANT_HOW = "blocks of 27 days; under 135 days a middle latitude's spread of daily levels, assumed"
CANNOT_TELL = (
    "A holds the field of the rocks, the error of IGRF and an error of the observatory's azimuth mark: one series does "
    "not tell them apart."
)


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Return the constant between an observatory's declination and the model's, with its quiet day and its storms.

    Args:
        files: IAGA-2002 files of one observatory.
        settings: ``latitude``, ``longitude`` where the headers lack them; ``declination``: auto, or a number in the
            model's place; ``table_step_deg``.

    Raises:
        InputError: a file cannot be read, the place is not known, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    warnings = [*series.warnings, *_moved(series, settings)]
    if why := observatory.refusal(series):
        return Calibration(KIND, "none", 0, 0, details=_header(series, settings), why=why, warnings=tuple(warnings))
    field = observatory.field_of(series, settings, str(files[0]))
    warnings += observatory.check(series, observatory.place_of(series, settings))
    compared = observatory.compare(series, field, limit_deg=STORM_DEG)
    if compared.spikes:
        warnings.append(
            f"{compared.spikes} values stand alone and far off: a spike, or a storm of less than three hours"
        )
    by_model = field.source == "IGRF"
    return Calibration(
        kind=KIND,
        model=f"{'IGRF' if by_model else 'the given declination'} plus a constant",
        n=len(compared.time_s),
        coverage=0,
        coefficients=np.append(compared.constant_deg, np.full(4, np.nan)),
        covariance=_covariance(compared.constant_sigma_deg),
        residual_rms_deg=angles.rms(compared.residual_deg - compared.constant_deg),
        sources=_sources(compared),
        table=_table(compared, float(settings.get("table_step_deg", 10.0))),
        points=_points(compared),
        details=_header(series, settings) | _details(compared, series, field),
        warnings=(*warnings, *field.warnings),
    )


def _covariance(sigma_deg: float) -> Floats:
    result = np.full((5, 5), np.nan)
    result[0, 0] = sigma_deg**2
    return result


def _table(compared: FieldComparison, step_deg: float) -> DeviationTable:
    """Return the same constant at every heading: what a heading made true by the model lacks, whatever it is."""
    heading = np.arange(0.0, 360.0, step_deg)
    alike = np.ones(len(heading))
    return DeviationTable(heading, compared.constant_deg * alike, compared.constant_sigma_deg * alike)


def _sources(compared: FieldComparison) -> tuple[Source, ...]:
    quiet = np.nan_to_num(compared.curve_deg)
    calm = compared.disturbed_deg[~compared.stormy]
    return (
        Source("constant", compared.constant_sigma_deg, CONSTANT_HOW),
        Source("daily variation", float(np.std(quiet)), f"rms of the curve of {compared.quiet_days} days"),
        Source("disturbance", angles.rms(calm), "rms of what level and quiet day leave, storms left out"),
    )


def _points(compared: FieldComparison) -> dict[str, Floats]:
    return {
        "time_s": compared.time_s,
        "declination_deg": compared.observed_deg,
        "model_deg": compared.model_deg,
        "level_deg": compared.level_deg,
        "quiet_day_deg": compared.quiet_deg - np.mean(np.nan_to_num(compared.curve_deg)),  # about zero, as A is a mean
        "residual_deg": compared.residual_deg - compared.constant_deg,
        "disturbance_deg": compared.disturbed_deg,
        "storm": compared.stormy.astype(float),
    }


def _header(series: FieldSeries, settings: Mapping[str, Any]) -> dict[str, Any]:
    latitude, longitude = observatory.place_of(series, settings)
    return {
        "station": series.station,
        "latitude": _known(latitude),
        "longitude": _known(longitude),
        "elevation_m": _known(series.elevation_m),
        "date": _stamp(float(np.mean(series.time_s[[0, -1]])))[:10],
        "definitive": series.definitive,
        "rows": dict(series.counts),
    }


def _details(compared: FieldComparison, series: FieldSeries, field: EarthField) -> dict[str, Any]:
    curve = compared.curve_deg if compared.quiet_days else None
    return {
        "constant_deg": compared.constant_deg,
        "constant_sigma_deg": compared.constant_sigma_deg,
        "model_source": field.source,
        "days": compared.days,
        "from": _stamp(series.time_s[0]),
        "to": _stamp(series.time_s[-1]),
        "range_deg": float(np.ptp(angles.difference(series.declination_deg, compared.observed_deg[0])[_seen(series)])),
        "quiet_day": None
        if curve is None
        else {
            "days": compared.quiet_days,
            "amplitude_deg": float(np.ptp(curve)) / 2.0,
            "by_hour_deg": curve - np.mean(curve),
        },
        "storms": [_storm(storm) for storm in compared.storms],
        "cannot_tell": [CANNOT_TELL],
    }


def _storm(storm: Storm) -> dict[str, Any]:
    return {
        "from": _stamp(storm.begin_s),
        "to": _stamp(storm.end_s),
        "range_deg": storm.range_deg,
        "rms_deg": storm.rms_deg,
    }


def _moved(series: FieldSeries, settings: Mapping[str, Any]) -> list[str]:
    here = np.array(observatory.place_of(series, settings))
    apart = np.abs(angles.difference(here, (series.latitude, series.longitude)))
    if not np.any(apart > FARTHEST_DEG):
        return []
    return [f"the file has the station at {series.latitude:g} N {series.longitude:g} E; the YAML's place counts"]


def _seen(series: FieldSeries) -> NDArray[np.bool_]:
    return np.isfinite(series.declination_deg)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _stamp(time_s: float) -> str:
    return f"{np.datetime64(round(time_s), 's')}Z"
