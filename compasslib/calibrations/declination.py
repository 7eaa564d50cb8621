"""Comparison of an observatory's declination with IGRF: their constant difference, mostly the crustal field.

No compass is calibrated: A is the observed minus the model's declination, B to E have no meaning here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import DAY_S, FieldComparison
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.errors import InputError
from compasslib.readers import iaga2002
from compasslib.records import EarthField, FieldSeries
from compasslib.types import Floats

KIND = "declination"
STORM_DEG = 0.5  # rms over three hours from which a disturbance is listed as a storm
FARTHEST_DEG = 0.5  # largest difference between the positions in header and YAML
CONSTANT_HOW = "blocks of 27 days; under 135 days a middle latitude's spread of daily levels, assumed"
AMBIGUITY = (
    "A includes the crustal field, the error of IGRF and an error of the observatory's azimuth mark; one series cannot "
    "separate them."
)
CRUST_NT = 600.0  # largest crustal field that is accepted, assumed; most stations have less than 300
SUSPECT_NT = 200.0  # misfit from which a mistake that explains it several times better is reported
IMPOSSIBLE_NT = 5000.0  # more than any crustal field at an observatory
EXPLAINED, SUSPECTED = 3.0, 6.0  # factors by which undoing a mistake must reduce the misfit, above and below CRUST_NT
MOST_LIKELY = 3
BLOCK_S, YEAR_S = 27 * DAY_S, 365.25 * DAY_S
FARTHEST_KM = 2000.0  # beyond which storms are hardly similar
COVERED = 0.5  # fraction of a deployment that a series should cover
NO_BASELINE_DEG, NO_BASELINE_SHARE = 0.3, 0.1  # largest declination and relative horizontal field without a baseline
ADVICE = "correct the file's columns, units or place, or take the observatory's own file"
EXCHANGES = {"X and Y": (1, 0, 2), "X and Z": (2, 1, 0), "Y and Z": (0, 2, 1)}
TENS = {"ten times too small": 10.0, "ten times too large": 0.1, "a hundred times too small": 100.0,
        "a hundred times too large": 0.01, "a thousand times too small": 1000.0}  # fmt: skip


def calibrate(files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Estimate the constant difference of an observatory's declination from the model, the quiet day and the storms.

    Args:
        files: IAGA-2002 files of one observatory.
        settings: ``latitude``, ``longitude``, which override the headers'; ``declination``: auto, or a number that
            replaces the model; ``table_step_deg``.

    Raises:
        InputError: a file cannot be read, the position is unknown, a date lies outside the model, or the field is not
            that of the place.
    """
    series = iaga2002.read(files)
    place, header = observatory.station_place(series, settings), (series.latitude, series.longitude)
    warnings = [*series.warnings]
    if np.any(np.abs(angles.difference(place, header)) > FARTHEST_DEG):
        warnings.append("the file has the station at {:g} N {:g} E; the YAML's place counts".format(*header))
    if why := observatory.too_short_reason(series):
        return Calibration(KIND, "none", 0, 0, details=_header(series, place), why=why, warnings=tuple(warnings))
    field = observatory.model_field(series, settings, str(files[0]))
    warnings += check_field(series, place)
    compared = observatory.compare(series, field, limit_deg=STORM_DEG)
    if compared.spikes:
        warnings.append(f"{compared.spikes} isolated outliers: spikes, or storms shorter than three hours")
    covariance = np.full((5, 5), np.nan)
    covariance[0, 0] = compared.constant_sigma_deg**2
    # The same constant at every heading: the correction of headings converted to true with the model's declination.
    heading = np.arange(0.0, 360.0, float(settings.get("table_step_deg", 10.0)))
    alike = (np.full(len(heading), x) for x in (compared.constant_deg, compared.constant_sigma_deg))
    quiet, calm = np.nan_to_num(compared.curve_deg), compared.disturbed_deg[~compared.stormy]
    return Calibration(
        kind=KIND,
        model=f"{'IGRF' if field.source == 'IGRF' else 'the given declination'} plus a constant",
        n=len(compared.time_s),
        coverage=0,
        coefficients=np.append(compared.constant_deg, np.full(4, np.nan)),
        covariance=covariance,
        residual_rms_deg=angles.rms(compared.residual_deg - compared.constant_deg),
        sources=(
            Source("constant", compared.constant_sigma_deg, CONSTANT_HOW),
            Source("daily variation", float(np.std(quiet)), f"rms of the curve of {compared.quiet_days} days"),
            Source("disturbance", angles.rms(calm), "rms of what level and quiet day leave, storms left out"),
        ),
        table=DeviationTable(heading, *alike),
        points=_points(compared),
        details=_header(series, place) | _details(compared, series, field),
        warnings=(*warnings, *field.warnings),
    )


def _points(compared: FieldComparison) -> dict[str, Floats]:
    return {
        "time_s": compared.time_s,
        "declination_deg": compared.observed_deg,
        "model_deg": compared.model_deg,
        "level_deg": compared.level_deg,
        "quiet_day_deg": compared.quiet_deg - np.mean(np.nan_to_num(compared.curve_deg)),  # zero mean, as A is a mean
        "residual_deg": compared.residual_deg - compared.constant_deg,
        "disturbance_deg": compared.disturbed_deg,
        "storm": compared.stormy.astype(float),
    }


def _header(series: FieldSeries, place: tuple[float, float]) -> dict[str, Any]:
    return {
        "station": series.station,
        "latitude": _known(place[0]),
        "longitude": _known(place[1]),
        "elevation_m": _known(series.elevation_m),
        "date": _stamp(float(np.mean(series.time_s[[0, -1]])))[:10],
        "definitive": series.definitive,
        "rows": dict(series.counts),
    }


def _details(compared: FieldComparison, series: FieldSeries, field: EarthField) -> dict[str, Any]:
    off_deg, curve = angles.difference(series.declination_deg, compared.observed_deg[0]), compared.curve_deg
    quiet_day = {
        "days": compared.quiet_days,
        "amplitude_deg": float(np.ptp(curve)) / 2.0,
        "by_hour_deg": curve - np.mean(curve),
    }
    return {
        "constant_deg": compared.constant_deg,
        "constant_sigma_deg": compared.constant_sigma_deg,
        "model_source": field.source,
        "days": compared.days,
        "from": _stamp(series.time_s[0]),
        "to": _stamp(series.time_s[-1]),
        "range_deg": float(np.ptp(off_deg[np.isfinite(off_deg)])),
        "quiet_day": quiet_day if compared.quiet_days else None,
        "storms": [
            {"from": _stamp(x.begin_s), "to": _stamp(x.end_s), "range_deg": x.range_deg, "rms_deg": x.rms_deg}
            for x in compared.storms
        ],
        "cannot_tell": [AMBIGUITY],
    }


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _stamp(time_s: float) -> str:
    return f"{np.datetime64(round(time_s), 's')}Z"


@dataclass(frozen=True)
class FieldMedian:
    """Median field over a period of one file; NaN where unknown."""

    where: str
    time_s: float
    declination_deg: float
    horizontal_nT: float
    vertical_nT: float
    latitude: float
    longitude: float


def check_field(series: FieldSeries, place: tuple[float, float]) -> list[str]:
    """Warn if an observatory's field is not the model's at its place, (latitude, longitude), provided that is known.

    Raises:
        InputError: a mistake that affects the declination is identified, or the field is impossible at that place.
    """
    if not np.isfinite(place).all():
        return []
    months = reversed(list(_medians(series, place)))
    warnings = {key: text for month in months for key, text in _field_warnings(month).items()}
    return list(reversed(warnings.values()))


def with_observatory_warnings(field: EarthField, files: Sequence[str | Path], place: Mapping[str, float]) -> EarthField:
    """Add warnings about a mooring's observatory to the mooring's field: mistakes in its file, distance and coverage.

    Raises:
        InputError: a file cannot be read, or as for ``check_field``.
    """
    if not files:
        return field
    series = iaga2002.read(files)
    there = np.array([series.latitude, series.longitude])
    warnings = check_field(series, (series.latitude, series.longitude))
    if np.isfinite(there).all():
        here = place["latitude"], place["longitude"]
        (sine, cosine), (east, north) = (angles.sin_cos(x) for x in np.transpose([there, here]))
        station, other = np.stack([cosine * north, cosine * east, sine], axis=-1)
        across = float(np.linalg.norm(np.cross(station, other)))
        apart = earthfield.DEGREE_KM * float(angles.argument(complex(station @ other, across)))
        if apart > FARTHEST_KM:
            warnings.append(
                f"the observatory {series.station} is {apart:.0f} km from the mooring; disturbances are similar within "
                f"some {FARTHEST_KM:.0f} km: use a nearer one, or check both positions"
            )
    # Where the series covers little of the deployment, most of the disturbance is taken as zero.
    days = np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / DAY_S))
    first, last = np.floor(field.time_s[[0, -1]] / DAY_S)
    covered = float(np.sum((days >= first) & (days <= last)) / (last - first + 1.0))
    if covered < COVERED:
        warnings.append(
            f"the observatory {series.station} covers {100.0 * covered:.0f} % of the deployment's days; elsewhere the "
            "disturbance of the field is taken as zero"
        )
    return replace(field, warnings=(*field.warnings, *warnings))


def _medians(series: FieldSeries, place: tuple[float, float]) -> Iterator[FieldMedian]:
    """Yield the median field of each month of each file."""
    file = series.origin if len(series.origin) == len(series) else np.zeros(len(series), dtype=np.intp)
    stretch = np.stack([file, np.floor(series.time_s / BLOCK_S).astype(np.intp)])
    for number in np.unique(stretch, axis=1).T:
        part = np.all(stretch == number[:, None], axis=0)
        known = np.flatnonzero(part & np.isfinite(series.declination_deg))
        first = series.declination_deg[known[0]] if len(known) else 0.0
        turned = angles.difference(series.declination_deg[part], first)
        off, horizontal, vertical = (
            float(np.nanmedian(column)) if np.isfinite(column).any() else float("nan")
            for column in (turned, series.horizontal_nT[part], series.vertical_nT[part])
        )
        where = series.files[number[0]] if series.files else series.station
        time_s, declination = float(np.median(series.time_s[part])), float(angles.wrap180(first + off))
        yield FieldMedian(where, time_s, declination, horizontal, vertical, *place)


def _field_warnings(median: FieldMedian) -> dict[tuple[str, ...], str]:
    """Warn of likely mistakes in one month's field; raise an error if its declination cannot be right."""
    misfit = _misfit(median)
    across, worst = misfit.get("across", 0.0), max(misfit.values(), default=0.0)
    if worst <= SUSPECT_NT or not np.isfinite(median.declination_deg):
        return {}
    named = _likely_mistakes(median, worst / (EXPLAINED if worst > CRUST_NT else SUSPECTED))
    sure = named if worst > CRUST_NT else []
    if across > IMPOSSIBLE_NT or (sure and across > min(CRUST_NT, worst / EXPLAINED)):
        expected = f"about {_describe_model(median)}, as IGRF has"
        raise InputError(median.where, expected=expected, found=_describe_field(median, named), advice=ADVICE)
    if worst <= CRUST_NT and not (named and len(misfit) > 1):
        return {}
    unnamed = f"rocks rarely make more than {CRUST_NT:.0f} nT; check columns, units, place and dates"
    text = f"{median.where}: {_describe_field(median, named or [unnamed])}, where IGRF has {_describe_model(median)}"
    return {(median.where, *named): text}


def _misfit(median: FieldMedian) -> dict[str, float]:
    """Compute the misfit of each known component to the model, nT."""
    declination, horizontal, vertical = _model_field(median)
    off_deg = angles.difference(median.declination_deg, declination)
    off = {
        "across": horizontal * angles.DEGREE * float(np.abs(angles.chord(off_deg))),
        "H": abs(median.horizontal_nT - horizontal),
        "Z": abs(median.vertical_nT - vertical),
    }
    return {name: value for name, value in off.items() if np.isfinite(value)}


def _model_field(median: FieldMedian) -> tuple[float, float, float]:
    declination, horizontal, vertical = earthfield.igrf(median.latitude, median.longitude, [median.time_s])
    return float(declination[0]), float(horizontal[0]), float(vertical[0])


def _likely_mistakes(median: FieldMedian, below: float) -> list[str]:
    """List the mistakes whose correction makes the field agree with the model, likeliest first."""
    known, fits = set(_misfit(median)), {text: _misfit(undone) for text, undone in _corrections(median).items()}
    sizes = [(max(misfit.values()), text) for text, misfit in fits.items() if set(misfit) == known]
    likely = sorted((size, text) for size, text in sizes if size < min(below, CRUST_NT))
    if not likely and below >= CRUST_NT / EXPLAINED:
        likely = _other_year(median, below)
    declination, horizontal, _ = _model_field(median)
    about_zero = abs(median.declination_deg) < NO_BASELINE_DEG < abs(declination)
    if not likely and (about_zero or median.horizontal_nT < NO_BASELINE_SHARE * horizontal):
        return ["a variation about zero: the baseline is missing"]
    best = likely[0][0] if likely else 0.0
    return [text for size, text in likely if size <= max(2.0 * best, SUSPECT_NT)][:MOST_LIKELY]


def _corrections(median: FieldMedian) -> dict[str, FieldMedian]:
    """Map the description of each mistake that a parser does not detect to the field without it."""
    degrees = median.declination_deg
    sine, cosine = (float(x) for x in angles.sin_cos(degrees))
    xyz = np.array([median.horizontal_nT * cosine, median.horizontal_nT * sine, median.vertical_nT])

    def with_declination(declination_deg: float) -> FieldMedian:
        return replace(median, declination_deg=float(angles.wrap180(declination_deg)))

    def with_vector(vector: Floats) -> FieldMedian:
        north, east, down = (float(x) for x in vector)
        declination, horizontal = float(angles.wrap180(angles.direction(east, north))), float(np.hypot(north, east))
        return replace(median, declination_deg=declination, horizontal_nT=horizontal, vertical_nT=down)

    def scaled(k: int, by: float) -> FieldMedian:
        return with_vector(xyz * np.where(np.arange(3) == k, by, 1.0))

    latitude, longitude = median.latitude, float(angles.wrap180(median.longitude))
    places = {
        "the longitude's sign looks exchanged, east is positive": (latitude, -longitude),
        "the latitude's sign looks exchanged, north is positive": (-latitude, longitude),
        "latitude and longitude look exchanged": (longitude, latitude),
        "the latitude looks like a colatitude": (90.0 - latitude, longitude),
    }
    exchanged = replace(median, horizontal_nT=abs(median.vertical_nT), vertical_nT=median.horizontal_nT)
    looks_like_degrees = f"D looks like degrees, {60.0 * degrees:+.2f}, where IAGA-2002 has minutes of arc"
    corrections = {
        f"{looks_like_degrees}: multiply it by 60": with_declination(60.0 * degrees),
        "D looks like radians, where IAGA-2002 has minutes of arc": with_declination(60.0 / angles.DEGREE * degrees),
        "D looks like tenths of a minute of arc": with_declination(0.1 * degrees),
        "D looks like seconds of arc, where IAGA-2002 has minutes": with_declination(1.0 / 60.0 * degrees),
        "the sign of D (or of Y) looks exchanged, IAGA-2002 counts east positive": with_declination(-degrees),
        "the signs of X and Y look exchanged, or D counts from south": with_declination(degrees + 180.0),
        "the sign of X looks exchanged": with_declination(180.0 - degrees),
        "the columns H and Z look exchanged": exchanged,
        "the sign of Z looks exchanged, it counts downward": scaled(2, -1.0),
    }
    for names, order in EXCHANGES.items():
        corrections[f"the columns {names} look exchanged"] = with_vector(xyz[list(order)])
    for text, by in TENS.items():
        corrections |= {f"{name} looks {text}": scaled(k, by) for k, name in enumerate("XYZ")}
        corrections[f"H looks {text}"] = replace(median, horizontal_nT=by * median.horizontal_nT)
    for text, (north, east) in places.items():
        if abs(north) <= 90.0:
            corrections[text] = replace(median, latitude=north, longitude=east)
    return corrections


def _other_year(median: FieldMedian, below: float) -> list[tuple[float, str]]:
    """Find the year whose model field agrees with the series, if all components are known and fit far better."""
    if not np.isfinite(median.horizontal_nT + median.vertical_nT):
        return []
    years = np.arange(earthfield.FIRST_YEAR, earthfield.LAST_YEAR)
    times = (years + 0.5 - 1970.0) * YEAR_S
    off = [max(_misfit(replace(median, time_s=float(time_s))).values()) for time_s in times]
    best = int(np.argmin(off))
    if off[best] >= min(below, SUSPECT_NT):
        return []
    return [(off[best], f"the field is that of about {years[best]}: the dates look wrong")]


def _describe_model(median: FieldMedian) -> str:
    declination, horizontal, vertical = _model_field(median)
    return (
        f"D {declination:+.1f} degrees, H {horizontal:.0f} nT, Z {vertical:+.0f} nT at {median.latitude:g} N "
        f"{median.longitude:g} E in {np.datetime64(int(median.time_s), 's').astype('datetime64[Y]')}"
    )


def _describe_field(median: FieldMedian, named: Sequence[str]) -> str:
    horizontal, vertical = (
        f", {name} {value:{form}} nT" if np.isfinite(value) else ""
        for name, value, form in (("H", median.horizontal_nT, ".0f"), ("Z", median.vertical_nT, "+.0f"))
    )
    why = f" ({'; or '.join(named)})" if named else ""
    return f"D {median.declination_deg:+.2f} degrees{horizontal}{vertical}{why}"
