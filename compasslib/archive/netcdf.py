"""CF netCDF input and output: records between two stages, overlap.nc and corrected.nc."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.archive import variables
from compasslib.archive.attributes import (
    SENSOR_KEYS,
    Attributes,
    Site,
    declination_attributes,
    global_attributes,
    plain,
    sensor_attributes,
)
from compasslib.archive.files import (
    StoredVariable,
    create_netcdf,
    open_netcdf,
    read_attribute,
    read_variable,
    write_beams,
    write_bins,
    write_variable,
)
from compasslib.archive.variables import Variable, quality_variable
from compasslib.errors import InputError
from compasslib.preparation.quality import MASKS
from compasslib.records import (
    BAD,
    MISSING,
    PROBABLY_BAD,
    PROBABLY_GOOD,
    CorrectedRecord,
    Flags,
    Pairs,
    Record,
    ReferenceCompass,
    SlowShear,
)
from compasslib.types import DAY_S, Bools, Floats


def write_record(path: str | Path, record: Record, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write a record for the stages that follow, series in float64, velocities and ranges in float32.

    It is not compressed, because it is read five times; it is still smaller than most raw files.
    """
    with create_netcdf(path) as nc:
        nc.setncatts({"Conventions": "CF-1.11", "title": "record of one instrument"} | plain(attributes or {}))
        for name, size in zip(("TIME", "BIN"), record.east.shape, strict=True):
            nc.createDimension(name, size)
        write_bins(nc, record.east.shape[1], record.looks_up)
        for field in fields(Record):
            value = getattr(record, field.name)
            if field.name == "tests" and value is None:
                continue
            if field.name in variables.RECORD:
                write_variable(nc, variables.RECORD[field.name], value, level=0)
            elif field.name not in variables.NOT_STORED:
                nc.setncattr(field.name, json.dumps(value, default=lambda number: number.item()))
        for name, series in record.channels.items():
            write_variable(nc, variables.channel_variable(name, record.channel_units.get(name, "1")), series, level=0)
        write_beams(nc, _beams(record))
        for name, profile in record.profiles.items():
            values = _beams_first(profile[:])
            write_variable(
                nc, variables.profile_variable(name, values.dtype.str[1:], values.ndim == 3), values, level=0
            )


def _beams_first(values: NDArray[Any]) -> NDArray[Any]:
    return np.moveaxis(values, 2, 0) if values.ndim == 3 else values


def _beams(record: Record) -> int:
    """Return the number of beams of the profiles, 0 where none of them has a beam dimension."""
    shapes = [profile[:1].shape for profile in record.profiles.values()]
    return max((shape[2] for shape in shapes if len(shape) == 3), default=0)


def read_record(path: str | Path, *, velocities: bool = True) -> Record:
    """Read a record written by ``write_record``, without its profiles, which are large and rarely needed.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    bins = None if velocities else 0
    with open_netcdf(path) as nc:
        # Ranges are read before velocities to save memory: constant ones are reduced to one row.
        ranges = read_variable(nc, variables.RECORD["bin_range_m"].name, bins)
        if ranges.size and (ranges == ranges[0]).all():  # one setting throughout: all samples share this row
            ranges = np.broadcast_to(ranges[0].copy(), ranges.shape)
        arrays = {"bin_range_m": ranges}
        arrays |= {
            name: read_variable(nc, entry.name, bins)
            for name, entry in variables.RECORD.items()
            if name not in arrays and (name != "tests" or entry.name in nc.variables)
        }
        others = {field.name for field in fields(Record)} - set(variables.RECORD) - variables.NOT_STORED
        metadata = {name: json.loads(nc.getncattr(name)) for name in others & {*nc.ncattrs(), "counts", "warnings"}}
        metadata["channels"] = {
            name.removeprefix(variables.CHANNEL): read_variable(nc, name)
            for name in nc.variables
            if name.startswith(variables.CHANNEL)
        }
    return Record(**arrays | metadata | {"warnings": tuple(metadata["warnings"])})


def read_profiles(path: str | Path) -> dict[str, Any]:
    """Open the profiles of a record written by ``write_record``; their rows are read on access.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    with open_netcdf(path) as nc:
        return {
            key: StoredVariable(str(path), name) for key, name in variables.PROFILES.items() if name in nc.variables
        }


def read_notes(path: str | Path, name: str) -> Any:
    """Read the ``counts`` (read, skipped, flagged) or the ``warnings`` of a record without its series.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    return json.loads(read_attribute(path, name))


def read_sources(paths: Iterable[str | Path]) -> dict[str, str]:
    """Read the SHA-256 of the raw files behind records and ready-made pairs, by path relative to the cruise folder."""
    sources: dict[str, str] = {}
    for path in paths:
        with open_netcdf(path) as nc:
            sources |= json.loads(getattr(nc, SOURCES, "{}"))
    return sources


def read_applied_declinations(paths: Iterable[str | Path]) -> dict[str, float]:
    """Read the declination removed from each record, separately for headings and velocities where they differ.

    Degrees, east positive. Records of older versions store one number for both, or none, which means 0.
    """
    applied: dict[str, float] = {}
    for path in map(Path, paths):
        with open_netcdf(path) as nc:
            heading = float(json.loads(getattr(nc, "heading_bias_deg", "0")))
            velocity = json.loads(getattr(nc, "velocity_bias_deg", "null"))
        if velocity in (None, heading):
            applied[path.stem] = heading
        else:
            applied |= {f"{path.stem} (headings)": heading, f"{path.stem} (velocities)": float(velocity)}
    return applied


# Attributes of overlap.nc that hold a field of ``Pairs`` as JSON; all but warnings only where there is one.
PAIR_NOTES = {"warnings": "warnings", "reference_compass": "compass"} | {
    name: name for name in ("slow_shear", "doubts", "slowed")
}


def write_pairs(path: str | Path, pairs: Pairs, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write overlap.nc, possibly without pairs."""
    with create_netcdf(path) as nc:
        nc.setncatts({"Conventions": "CF-1.11", "title": "pairs of overlapping velocities"} | plain(attributes or {}))
        notes = {name: getattr(pairs, field) for name, field in PAIR_NOTES.items()}
        written = {name: note for name, note in notes.items() if note or name == "warnings"}
        nc.setncatts({name: json.dumps(note, default=vars) for name, note in written.items()})
        if pairs.expected_m_s is not None:
            nc.setncattr("water_error_of_mean_and_of_prediction_m_s", np.array(pairs.expected_m_s))
        nc.setncattr("water_turned_for_good_deg", pairs.veer_deg)
        nc.createDimension("TIME", len(pairs))
        for name, variable in variables.PAIRS.items():
            write_variable(nc, variable, getattr(pairs, name))
        for name, variable in variables.PAIRS_PERHAPS.items():
            if (column := getattr(pairs, name)) is not None:
                write_variable(nc, variable, column)
        if pairs.reference_names:
            flags = np.arange(len(pairs.reference_names), dtype=np.int8)
            meanings = " ".join(pairs.reference_names)
            nc[variables.REFERENCE_INDEX].setncatts({"flag_values": flags, "flag_meanings": meanings})
        write_variable(nc, variables.SEPARATION_METRES, pairs.lower_depth_m - pairs.upper_depth_m)


def read_pairs(path: str | Path) -> Pairs:
    """Read pairs written by ``write_pairs``.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    with open_netcdf(path) as nc:
        there = {name: each for name, each in variables.PAIRS_PERHAPS.items() if each.name in nc.variables}
        values: dict[str, Any] = {
            name: read_variable(nc, variable.name) for name, variable in (variables.PAIRS | there).items()
        }
        errors = getattr(nc, "water_error_of_mean_and_of_prediction_m_s", None)
        values["expected_m_s"] = None if errors is None else tuple(map(float, errors))
        names = nc[variables.REFERENCE_INDEX].flag_meanings.split() if "reference_index" in there else []
        values |= {"reference_names": tuple(names), "veer_deg": float(getattr(nc, "water_turned_for_good_deg", 0.0))}
        notes = {field: json.loads(getattr(nc, name, "null")) for name, field in PAIR_NOTES.items()}
        values |= {field: tuple(map(tuple, notes[field] or ())) for field in ("doubts", "slowed")}
        for field, made in (("compass", ReferenceCompass), ("slow_shear", SlowShear)):
            values[field] = None if notes[field] is None else made(**notes[field])
        return Pairs(**values, warnings=tuple(notes["warnings"]))


# corrected.nc (CF, ACDD and OceanSITES): written in pieces along time, to bound the memory that a decade takes.

SOURCES = "sources"  # attribute of records and pairs: SHA-256 of the raw files by path, as JSON
Column = tuple[NDArray[Any], Flags | None]  # values, and their flags if they have any
Columns = dict[str, Column]


def days_since_1950(time_s: Floats) -> Floats:
    """Convert UTC seconds since 1970 to the time of OceanSITES."""
    return time_s / DAY_S + 7305.0


def seconds_since_1970(days: Floats) -> Floats:
    """Convert days since 1950, which resolve 0.3 microseconds, to UTC seconds rounded to 10 microseconds."""
    return np.round((days - 7305.0) * DAY_S, 5)


def write_corrected(
    path: str | Path,
    product: CorrectedRecord | Iterable[CorrectedRecord],
    *,
    site: Site,
    attributes: Mapping[str, object] | None = None,
    processing: Mapping[str, object] | None = None,
) -> None:
    """Write corrected.nc according to CF, ACDD and OceanSITES, without reading the system clock.

    Args:
        product: the corrected record, possibly without samples or corrected headings; or its pieces along time, at
            least one, which are iterated over twice.
        attributes: the user's global attributes, including make and serial number of the instrument.
        processing: how and when the product was made; see ``archive.attributes.global_attributes``.
    """
    pieces = [product] if isinstance(product, CorrectedRecord) else product
    whole = _scan_pieces(pieces, site)
    attributes = global_attributes(
        site,
        time_s=whole.time_s,
        depth_m=whole.depths_m,
        headings=whole.headings,
        attributes=whole.instrument | dict(attributes or {}),
        processing=processing or {},
    )
    of_sensor = dict.fromkeys(variables.SENSED, sensor_attributes(attributes, whole.looks_up) | whole.recorded_in)
    of_model = dict.fromkeys(
        variables.BY_DECLINATION, declination_attributes(attributes, whole.time_s, whole.declination)
    )
    end = 0
    with create_netcdf(path, "NETCDF4_CLASSIC") as nc:
        nc.setncatts(attributes)
        _put_coordinates(nc, whole, site)
        for piece in pieces:
            begin, end = end, end + len(piece.record.time_s)
            for name, column in _columns(piece, whole).items():
                sensor = of_sensor.get(name, {}) | of_model.get(name, {})
                variable = variables.CORRECTED[name]
                if variable.dimensions == variables.BEAMS and column[0].ndim == 2:  # counts without a beam dimension
                    variable = replace(variable, dimensions=variables.BINS)
                _put_placed(nc, variable, column, sensor, slice(begin, end))


@dataclass(frozen=True)
class _Whole:
    """Properties of all pieces together, for the header of the file."""

    time_s: Floats  # (n,)
    bins: int
    looks_up: bool
    site: Site
    depths_m: Floats  # m, smallest and largest depth of the bins in the water in each piece that has any
    nominal_depth: bool
    headings: tuple[int, int]  # numbers of recorded and of corrected headings
    declination: tuple[float, float]  # at the first and last sample, degrees, east positive
    measured: tuple[str, ...]  # names of the optional variables that were measured
    beams: int
    recorded_in: Attributes  # of the measured variables: coordinates of the recorded velocities, their speed of sound
    instrument: dict[str, str]  # manufacturer, model and serial number, as far as its files state them


def _scan_pieces(pieces: Iterable[CorrectedRecord], site: Site) -> _Whole:
    times, instrument, depths, counts = [], [], [], np.zeros(4, dtype=int)
    declination: list[float] = []
    for piece in pieces:
        record = piece.record
        times.append(record.time_s)
        instrument += _ends(record.depth_m)
        depth = record.bin_depth_m()
        depths += _ends(depth[site.holds_water(depth)])
        declination += piece.declination_deg[[0, -1]].tolist() if len(piece.declination_deg) else []
        several = (record.heading_deg, piece.heading_corrected_deg, record.temperature_c, record.pressure_dbar)
        counts += [np.isfinite(each).sum() for each in several]
    recorded, corrected, *series = counts.tolist()
    perhaps = [name for name, count in zip(("TEMP", "PRES"), series, strict=True) if count]
    return _Whole(
        time_s=np.concatenate(times),
        bins=record.east.shape[1],
        looks_up=record.looks_up,
        site=site,
        depths_m=np.array(depths),
        # A measured depth varies; a constant one comes from metadata.
        nominal_depth=len(set(instrument)) == 1,
        headings=(recorded, corrected),
        declination=(declination[0], declination[-1]) if declination else (np.nan, np.nan),
        measured=(*perhaps, *(variables.PROFILES[name] for name in record.profiles)),
        beams=_beams(record),
        recorded_in={key: told for key in ("recorded_in", "sound_speed") if (told := getattr(record, key))},
        instrument={key: told for key in SENSOR_KEYS[:3] if (told := getattr(record, key))},
    )


def _ends(values: Floats) -> list[float]:
    known = values[np.isfinite(values)]
    return [float(known.min()), float(known.max())] if known.size else []


def read_corrected(path: str | Path, *, velocities: bool = True) -> CorrectedRecord:
    """Read a product written by ``write_corrected``, as far as figures need it.

    Its ``record`` has no supply voltage, profiles, counts or warnings, and its velocities are those by the recorded
    heading, relative to true north.

    Args:
        velocities: whether to read the bins; otherwise the product has none.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    bins = None if velocities else 0
    with open_netcdf(path) as nc:
        return CorrectedRecord(
            record=_record_of(nc, bins),
            heading_corrected_deg=read_variable(nc, "HEADING_CORRECTED"),
            heading_uncertainty_deg=read_variable(nc, "HEADING_CORRECTED_UNCERTAINTY"),
            heading_common_deg=read_variable(nc, "HEADING_COMMON_UNCERTAINTY"),
            heading_corrected_quality=read_variable(nc, "HEADING_CORRECTED_QC"),
            deviation_deg=read_variable(nc, "DEVIATION"),
            branch_probability=read_variable(nc, "BRANCH_PROBABILITY"),
            declination_deg=read_variable(nc, "DECLINATION"),
            east=read_variable(nc, "UCUR", bins),
            north=read_variable(nc, "VCUR", bins),
            east_recorded=read_variable(nc, "UCUR_RECORDED", bins),
            north_recorded=read_variable(nc, "VCUR_RECORDED", bins),
            velocity_uncertainty=read_variable(nc, "UCUR_UNCERTAINTY", bins),
            velocity_quality=read_variable(nc, "UCUR_QC", bins),
        )


def open_product(path: str | Path) -> CorrectedRecord:
    """Load a product into memory; its ``to_xarray()`` loads the whole file into a dataset.

    Args:
        path: a corrected.nc, or the folder of a mooring's results.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    path = Path(path) / "corrected.nc" if Path(path).is_dir() else Path(path)
    with open_netcdf(path) as nc:
        if "HEADING_ERROR_MODE" in nc.variables:
            advice = "open it by compasslib.open_gridded"
            raise InputError(str(path), expected="corrected.nc", found="gridded velocities", advice=advice)
    return replace(read_corrected(path), path=str(path))


def _record_of(nc: netCDF4.Dataset, bins: int | None) -> Record:
    time_s = seconds_since_1970(read_variable(nc, "TIME"))
    unknown = np.full(time_s.shape, np.nan)
    looks_up = nc["HEADING"].getncattr("sensor_orientation") == "upward"
    depth = read_variable(nc, "INSTRUMENT_DEPTH")
    return Record(
        time_s=time_s,
        east=read_variable(nc, "UCUR_RECORDED", bins),
        north=read_variable(nc, "VCUR_RECORDED", bins),
        bin_range_m=(1.0 if looks_up else -1.0) * (depth[:, None] - read_variable(nc, "DEPTH", bins)),
        heading_deg=read_variable(nc, "HEADING"),
        pitch_deg=read_variable(nc, "PITCH"),
        roll_deg=read_variable(nc, "ROLL"),
        pressure_dbar=read_variable(nc, "PRES") if "PRES" in nc.variables else unknown,
        depth_m=depth,
        temperature_c=read_variable(nc, "TEMP") if "TEMP" in nc.variables else unknown,
        supply_voltage=unknown,
        quality=read_variable(nc, "UCUR_RECORDED_QC", bins),
        tests=read_variable(nc, "UCUR_QC_TESTS", bins) if "UCUR_QC_TESTS" in nc.variables else None,
        heading_quality=read_variable(nc, "HEADING_QC"),
        looks_up=looks_up,
        direction_reference="true",
    )


def _columns(product: CorrectedRecord, whole: _Whole) -> Columns:
    record, nominal = product.record, whole.nominal_depth
    depth, instrument_depth = record.bin_depth_m(), record.depth_m
    corrected = _flag_missing(product.heading_corrected_quality, product.heading_corrected_deg, BAD)
    true = angles.wrap360(product.heading_corrected_deg + product.declination_deg)
    tests = np.zeros(record.quality.shape, dtype=np.int32) if record.tests is None else record.tests
    doubtful = np.where(product.heading_corrected_quality >= PROBABLY_BAD, MASKS["heading"], 0)
    columns: Columns = {
        "DEPTH": (depth, _judged("DEPTH", depth, nominal, whole.site.holds_water(depth))),
        "INSTRUMENT_DEPTH": (instrument_depth, _judged("INSTRUMENT_DEPTH", instrument_depth, nominal)),
        "HEADING": (
            angles.wrap360(record.heading_deg),
            _flag_missing(record.heading_quality, record.heading_deg, MISSING),
        ),
        "HEADING_CORRECTED": (angles.wrap360(product.heading_corrected_deg), corrected),
        "HEADING_CORRECTED_UNCERTAINTY": (product.heading_uncertainty_deg, corrected),
        "HEADING_COMMON_UNCERTAINTY": (product.heading_common_deg, corrected),
        "DEVIATION": (product.deviation_deg, corrected),
        "BRANCH_PROBABILITY": (product.branch_probability, None),
        "DECLINATION": (product.declination_deg, _judged("DECLINATION", product.declination_deg, True)),
        "UCUR": (product.east, _flag_missing(product.velocity_quality, product.east, BAD)),
        "VCUR": (product.north, _flag_missing(product.velocity_quality, product.north, BAD)),
        "UCUR_RECORDED": (product.east_recorded, _flag_missing(record.quality, product.east_recorded, MISSING)),
        "VCUR_RECORDED": (product.north_recorded, _flag_missing(record.quality, product.north_recorded, MISSING)),
        "UCUR_QC_TESTS": (tests | doubtful[:, None], None),
        "UCUR_UNCERTAINTY": (product.velocity_uncertainty, None),
        "VCUR_UNCERTAINTY": (product.velocity_uncertainty, None),
        "HEADING_TRUE": (true, _flag_missing(product.heading_corrected_quality, true, BAD)),
        "PITCH": (record.pitch_deg, _judged("PITCH", record.pitch_deg)),
        "ROLL": (record.roll_deg, _judged("ROLL", record.roll_deg)),
    }
    series = {"TEMP": record.temperature_c, "PRES": record.pressure_dbar}
    columns |= {name: (values, _judged(name, values)) for name, values in series.items() if name in whole.measured}
    for name, profile in record.profiles.items():
        values = profile[:]
        flags = _flag_missing(record.quality, values, MISSING) if values.dtype.kind == "f" else None
        columns[variables.PROFILES[name]] = (_beams_first(values), flags)
    return columns


def _flag_missing(flags: Flags, values: Floats, absent: int) -> Flags:
    """Set the flag ``absent`` where a value is missing and its flag is neither bad nor missing."""
    given = np.isfinite(values) | np.isin(flags, (BAD, MISSING))
    return np.where(given, flags, absent).astype(np.int8)


def _judged(name: str, values: Floats, nominal: bool = False, within: Bools | bool = True) -> Flags:
    """Flag the values of a variable that no earlier stage has flagged, by its valid range and ``within`` alone."""
    low, high = variables.CORRECTED[name].valid or (-np.inf, np.inf)
    good = (values >= low) & (values <= high) & within
    flags = np.where(good, variables.NOMINAL if nominal else PROBABLY_GOOD, BAD)
    return np.where(np.isfinite(values), flags, MISSING).astype(np.int8)


def _put_coordinates(nc: netCDF4.Dataset, whole: _Whole, site: Site) -> None:
    name = np.frombuffer(site.name.encode(), dtype="S1")
    bins = max(whole.bins, 1)  # in the classic model only the unlimited dimension, TIME, may have length 0
    for dimension, size in (("TIME", len(whole.time_s)), ("BIN", bins), ("NAME_LENGTH", len(name))):
        nc.createDimension(dimension, size)
    write_variable(nc, variables.TIME, days_since_1950(whole.time_s))
    write_bins(nc, bins, whole.looks_up)
    write_beams(nc, whole.beams)
    write_variable(nc, variables.LATITUDE, site.latitude)
    write_variable(nc, variables.LONGITUDE, site.signed_longitude())
    write_variable(nc, variables.STATION, name)


def _put_placed(
    nc: netCDF4.Dataset, variable: Variable, column: Column, sensor: Mapping[str, object], rows: slice
) -> None:
    """Write a piece of one variable and of its flags, with its ``coordinates`` attribute."""
    values, flags = column
    coordinates = variables.COORDINATES[variable.dimensions]
    placed = {} if variable.name in coordinates.split() else {"coordinates": coordinates}
    quality = quality_variable(variable)
    ancillary = variable.ancillary if flags is None else (quality.name, *variable.ancillary)
    described = replace(variable, ancillary=ancillary, also={**variable.also, **placed, **sensor})
    write_variable(nc, described, values, level=4, rows=rows)
    if flags is not None:
        flagged = replace(quality, also={**quality.also, "coordinates": coordinates})
        write_variable(nc, flagged, flags, level=4, rows=rows)
