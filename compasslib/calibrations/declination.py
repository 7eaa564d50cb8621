"""An observatory's declination against IGRF at its place and time: what a constant, the field of the rocks, adds.

No compass is calibrated: A is what must be added to the model's declination, B to E have no meaning here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles, earthfield
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import DAY_S, FieldComparison, Storm
from compasslib.calibrations.result import Calibration, DeviationTable, Source
from compasslib.errors import InputError
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
    warnings += check_field(series, observatory.place_of(series, settings))
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


CRUST_NT = 600.0  # field of rocks that is accepted; assumed, most stations have under 300
SUSPECT_NT = 200.0  # from which a mistake that explains it several times better is reported
IMPOSSIBLE_NT = 5000.0  # no rocks under an observatory
EXPLAINED, SUSPECTED = 3.0, 6.0  # times smaller that the misfit becomes without the mistake
MOST_LIKELY = 3
BLOCK_S, YEAR_S = 27 * DAY_S, 365.25 * DAY_S
FARTHEST_KM = 2000.0  # over which storms are hardly alike any more
DEGREE_KM = 111.2
COVERED = 0.5  # of a deployment
NO_BASELINE_DEG, NO_BASELINE_SHARE = 0.3, 0.1  # of a variation about zero: its declination, its horizontal field
ADVICE = "correct the file's columns, units or place, or take the observatory's own file"
PAIRS = (("X", "Y"), ("X", "Z"), ("Y", "Z"))
TENS = {"ten times too small": 10.0, "ten times too large": 0.1, "a hundred times too small": 100.0,
        "a hundred times too large": 0.01, "a thousand times too small": 1000.0}  # fmt: skip


@dataclass(frozen=True)
class FieldMedian:
    """The middle field of a stretch of one file; NaN where it is not known."""

    where: str
    time_s: float
    declination_deg: float
    horizontal_nT: float
    vertical_nT: float
    latitude: float
    longitude: float


def check_field(series: FieldSeries, place: tuple[float, float]) -> list[str]:
    """Return warnings of a field that is not the model's at its place.

    Args:
        place: latitude and longitude, degrees; there is no warning where they are not known.

    Raises:
        InputError: a mistake that turns the declination is recognised, or the field is none of that place.
    """
    if not np.isfinite(place).all():
        return []
    found = {key: text for one in reversed(list(_medians(series, place))) for key, text in _warnings(one).items()}
    return list(reversed(found.values()))


def with_observatory_warnings(field: EarthField, files: Sequence[str | Path], place: Mapping[str, float]) -> EarthField:
    """Return the field at a mooring with warnings about the observatory that is given beside it.

    Args:
        files: IAGA-2002 files of the observatory, perhaps none.
        place: of the mooring: ``latitude``, ``longitude``, degrees.

    Raises:
        InputError: a file cannot be read, or as for ``check_field``.
    """
    if not files:
        return field
    series = iaga2002.read(files)
    found = check_field(series, (series.latitude, series.longitude))
    return replace(
        field,
        warnings=(
            *field.warnings,
            *found,
            *_far(series, (place["latitude"], place["longitude"])),
            *_covers(series, field),
        ),
    )


def _medians(series: FieldSeries, place: tuple[float, float]) -> Iterator[FieldMedian]:
    """Yield the middle field of every month of every file."""
    file = series.origin if len(series.origin) == len(series) else np.zeros(len(series), dtype=np.intp)
    stretch = np.stack([file, np.floor(series.time_s / BLOCK_S).astype(np.intp)])
    for one in np.unique(stretch, axis=1).T:
        part = np.all(stretch == one[:, None], axis=0)
        declination = series.declination_deg[part]
        horizontal, vertical = (_median(column[part]) for column in (series.horizontal_nT, series.vertical_nT))
        yield FieldMedian(
            where=series.files[one[0]] if series.files else series.station,
            time_s=float(np.median(series.time_s[part])),
            declination_deg=_median_angle(declination[np.isfinite(declination)]),
            horizontal_nT=horizontal,
            vertical_nT=vertical,
            latitude=place[0],
            longitude=place[1],
        )


def _median(column: Floats) -> float:
    return float(np.nanmedian(column)) if np.isfinite(column).any() else float("nan")


def _median_angle(declination_deg: Floats) -> float:
    """Return the middle of angles that are known, NaN of none."""
    if not len(declination_deg):
        return float("nan")
    first = declination_deg[0]
    return float(angles.wrap180(first + np.median(angles.difference(declination_deg, first))))


def _warnings(seen: FieldMedian) -> dict[tuple[str, ...], str]:
    """Return the warning of one stretch, by its file and its mistakes, after refusing what cannot be a declination."""
    misfit = _misfit(seen)
    across, worst = misfit.get("across", 0.0), max(misfit.values(), default=0.0)
    if worst <= SUSPECT_NT or not np.isfinite(seen.declination_deg):
        return {}
    named = _likely_mistakes(seen, worst / (EXPLAINED if worst > CRUST_NT else SUSPECTED))
    sure = named if worst > CRUST_NT else []
    if across > IMPOSSIBLE_NT or (sure and across > min(CRUST_NT, worst / EXPLAINED)):
        expected = f"about {_expected(seen)}, as IGRF has"
        raise InputError(seen.where, expected=expected, found=_found(seen, named), advice=ADVICE)
    if worst <= CRUST_NT and not (named and len(misfit) > 1):
        return {}
    unnamed = f"rocks rarely make more than {CRUST_NT:.0f} nT; check columns, units, place and dates"
    text = f"{seen.where}: {_found(seen, named or [unnamed])}, where IGRF has {_expected(seen)}"
    return {(seen.where, *named): text}


def _misfit(seen: FieldMedian) -> dict[str, float]:
    """Return by how much each component that is known is off the model, nT."""
    declination, horizontal, vertical = _model(seen)
    off_deg = angles.difference(seen.declination_deg, declination)
    off = {
        "across": horizontal * angles.DEGREE * float(np.abs(angles.chord(off_deg))),
        "H": abs(seen.horizontal_nT - horizontal),
        "Z": abs(seen.vertical_nT - vertical),
    }
    return {name: value for name, value in off.items() if np.isfinite(value)}


def _model(seen: FieldMedian) -> tuple[float, float, float]:
    declination, horizontal, vertical = earthfield.igrf(seen.latitude, seen.longitude, [seen.time_s])
    return float(declination[0]), float(horizontal[0]), float(vertical[0])


def _likely_mistakes(seen: FieldMedian, below: float) -> list[str]:
    """Return the mistakes without which the field is the model's, the likeliest first."""
    known, fits = set(_misfit(seen)), {text: _misfit(undo(seen)) for text, undo in _mistakes(seen).items()}
    sizes = [(max(misfit.values()), text) for text, misfit in fits.items() if set(misfit) == known]
    found = sorted((size, text) for size, text in sizes if size < min(below, CRUST_NT))
    if not found and below >= CRUST_NT / EXPLAINED:
        found = _of_another_year(seen, below)
    if not found and _without_baseline(seen):
        return ["a variation about zero: the baseline is missing"]
    best = found[0][0] if found else 0.0
    return [text for size, text in found if size <= max(2.0 * best, SUSPECT_NT)][:MOST_LIKELY]


def _mistakes(seen: FieldMedian) -> Mapping[str, Correction]:
    """Return what undoes each mistake, by what to say of it."""
    minutes = 60.0 * seen.declination_deg
    units = {
        f"D looks like degrees, {minutes:+.2f}, where IAGA-2002 has minutes of arc: multiply it by 60": 60.0,
        "D looks like radians, where IAGA-2002 has minutes of arc": 60.0 / angles.DEGREE,
        "D looks like tenths of a minute of arc": 0.1,
        "D looks like seconds of arc, where IAGA-2002 has minutes": 1.0 / 60.0,
    }
    return (
        {text: _times(by) for text, by in units.items()}
        | {
            "the sign of D (or of Y) looks exchanged, IAGA-2002 counts east positive": _declination(lambda d: -d),
            "the signs of X and Y look exchanged, or D counts from south": _declination(lambda d: d + 180.0),
            "the sign of X looks exchanged": _declination(lambda d: 180.0 - d),
        }
        | {f"the columns {a} and {b} look exchanged": _exchanged("XYZ".index(a), "XYZ".index(b)) for a, b in PAIRS}
        | {"the columns H and Z look exchanged": _horizontal_and_vertical}
        | {f"{'XYZ'[k]} looks {text}": _scaled(k, by) for k in range(3) for text, by in TENS.items()}
        | {f"H looks {text}": _scaled_horizontal(by) for text, by in TENS.items()}
        | {"the sign of Z looks exchanged, it counts downward": _scaled(2, -1.0)}
        | {text: _at_place(seen, there) for text, there in _places(seen).items()}
    )


def _times(by: float) -> Correction:
    return _declination(lambda declination: by * declination)


def _declination(undo: Callable[[float], float]) -> Correction:
    return lambda one: replace(one, declination_deg=float(angles.wrap180(undo(one.declination_deg))))


def _exchanged(a: int, b: int) -> Correction:
    order = np.arange(3)
    order[[a, b]] = order[[b, a]]
    return lambda one: _of_vector(one, _vector(one)[order])


def _of_vector(one: FieldMedian, vector: Floats) -> FieldMedian:
    north, east, down = (float(x) for x in vector)
    declination = float(angles.wrap180(angles.direction(east, north)))
    return replace(one, declination_deg=declination, horizontal_nT=float(np.hypot(north, east)), vertical_nT=down)


def _vector(one: FieldMedian) -> Floats:
    sine, cosine = (float(x) for x in angles.sin_cos(one.declination_deg))
    return np.array([one.horizontal_nT * cosine, one.horizontal_nT * sine, one.vertical_nT])


def _horizontal_and_vertical(one: FieldMedian) -> FieldMedian:
    return replace(one, horizontal_nT=abs(one.vertical_nT), vertical_nT=one.horizontal_nT)


def _scaled(k: int, by: float) -> Correction:
    return lambda one: _of_vector(one, _vector(one) * np.where(np.arange(3) == k, by, 1.0))


def _scaled_horizontal(by: float) -> Correction:
    return lambda one: replace(one, horizontal_nT=by * one.horizontal_nT)


def _at_place(seen: FieldMedian, there: tuple[float, float]) -> Correction:
    return lambda one: replace(one, latitude=there[0], longitude=there[1])


def _places(seen: FieldMedian) -> dict[str, tuple[float, float]]:
    latitude, longitude = seen.latitude, float(angles.wrap180(seen.longitude))
    every = {
        "the longitude's sign looks exchanged, east is positive": (latitude, -longitude),
        "the latitude's sign looks exchanged, north is positive": (-latitude, longitude),
        "latitude and longitude look exchanged": (longitude, latitude),
        "the latitude looks like a colatitude": (90.0 - latitude, longitude),
    }
    return {text: there for text, there in every.items() if abs(there[0]) <= 90.0}


def _of_another_year(seen: FieldMedian, below: float) -> list[tuple[float, str]]:
    """Return the year whose field the series has, where all of it fits far better there."""
    if not np.isfinite(seen.horizontal_nT + seen.vertical_nT):
        return []
    years = np.arange(earthfield.FIRST_YEAR, earthfield.LAST_YEAR)
    times = (years + 0.5 - 1970.0) * YEAR_S
    off = [max(_misfit(replace(seen, time_s=float(time_s))).values()) for time_s in times]
    best = int(np.argmin(off))
    if off[best] >= min(below, SUSPECT_NT):
        return []
    return [(off[best], f"the field is that of about {years[best]}: the dates look wrong")]


def _without_baseline(seen: FieldMedian) -> bool:
    declination, horizontal, _ = _model(seen)
    about_zero = abs(seen.declination_deg) < NO_BASELINE_DEG < abs(declination)
    return about_zero or seen.horizontal_nT < NO_BASELINE_SHARE * horizontal


def _expected(seen: FieldMedian) -> str:
    declination, horizontal, vertical = _model(seen)
    return (
        f"D {declination:+.1f} degrees, H {horizontal:.0f} nT, Z {vertical:+.0f} nT at {seen.latitude:g} N "
        f"{seen.longitude:g} E in {np.datetime64(int(seen.time_s), 's').astype('datetime64[Y]')}"
    )


def _found(seen: FieldMedian, named: Sequence[str]) -> str:
    horizontal, vertical = (
        f", {name} {value:{form}} nT" if np.isfinite(value) else ""
        for name, value, form in (("H", seen.horizontal_nT, ".0f"), ("Z", seen.vertical_nT, "+.0f"))
    )
    why = f" ({'; or '.join(named)})" if named else ""
    return f"D {seen.declination_deg:+.2f} degrees{horizontal}{vertical}{why}"


def _far(series: FieldSeries, place: tuple[float, float]) -> list[str]:
    there = np.array([series.latitude, series.longitude])
    if not np.isfinite(there).all():
        return []
    one, other = (_upward(*where) for where in (there, place))
    apart = DEGREE_KM * float(angles.argument(complex(one @ other, float(np.linalg.norm(np.cross(one, other))))))
    if apart <= FARTHEST_KM:
        return []
    return [
        f"the observatory {series.station} is {apart:.0f} km from the mooring: storms are alike over some "
        f"{FARTHEST_KM:.0f} km; take a nearer one, or check both positions"
    ]


def _upward(latitude: float, longitude: float) -> Floats:
    (sine, cosine), (east, front) = (angles.sin_cos(angle) for angle in (latitude, longitude))
    return np.array([cosine * front, cosine * east, sine], dtype=float)


def _covers(series: FieldSeries, field: EarthField) -> list[str]:
    """Say where most of a deployment is without the observatory: there its disturbance counts as none."""
    days = np.unique(np.floor(series.time_s[np.isfinite(series.declination_deg)] / DAY_S))
    first, last = np.floor(field.time_s[[0, -1]] / DAY_S)
    covered = float(np.sum((days >= first) & (days <= last)) / (last - first + 1.0))
    if covered >= COVERED:
        return []
    return [
        f"the observatory {series.station} has a declination on {100.0 * covered:.0f} % of the deployment's days: "
        "elsewhere the disturbance of the field counts as none"
    ]


Correction = Callable[[FieldMedian], FieldMedian]
