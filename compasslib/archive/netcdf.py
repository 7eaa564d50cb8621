"""CF netCDF input and output: records between two stages, overlap.nc and corrected.nc."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles, records
from compasslib.archive import files, variables
from compasslib.archive.attributes import (
    SENSOR_KEYS,
    Site,
    declination_attributes,
    global_attributes,
    plain,
    sensor_attributes,
)
from compasslib.archive.variables import CORRECTED, PAIRS, RECORD, Variable
from compasslib.errors import InputError
from compasslib.preparation.quality import MASKS
from compasslib.types import DAY_S, Bools, Floats

if TYPE_CHECKING:
    from compasslib.deviation.correction import CorrectedPieces

SOURCES = "sources"  # attribute of records and pairs: SHA-256 of the raw files by path, as JSON
Columns = dict[str, tuple[NDArray[Any], records.Flags | None]]  # values and flags, by name of the variable


def write_record(path: str | Path, record: records.Record, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write a record for the stages that follow, series in float64, velocities and ranges in float32."""
    # Not compressed, as it is read five times; it is still smaller than most raw files.
    with files.create_netcdf(path) as nc:
        nc.setncatts({"Conventions": "CF-1.11", "title": "record of one instrument"} | plain(attributes or {}))
        nc.createDimension("TIME", len(record.time_s))
        files.write_bins(nc, record.east.shape[1], _beams(record), record.looks_up)
        for name in (field.name for field in fields(records.Record)):
            value = getattr(record, name)
            if name in RECORD and value is not None:
                _write_pieces(nc, RECORD[name], value)
            elif name not in RECORD and name not in variables.NOT_STORED:
                nc.setncattr(name, json.dumps(value, default=lambda number: number.item()))
        for name, series in record.channels.items():
            unit, meaning = record.channel_units.get(name, "1"), f"{name.replace('_', ' ')}, as logged or given"
            files.write_variable(nc, Variable(f"{variables.CHANNEL}{name}", meaning, unit), series, level=0)
        for name, profile in record.profiles.items():
            first = profile[:1]
            shape = variables.BEAMS if first.ndim == 3 else variables.BINS
            variable = replace(CORRECTED[variables.PROFILES[name]], dimensions=shape, coordinates="")
            if first.dtype == np.uint8:
                bits = {**variable.also, "_Unsigned": "true"}
                variable = replace(variable, dtype="i1", fill=None, valid=None, also=bits)
            else:
                variable = replace(variable, dtype=first.dtype.str[1:])
            _write_pieces(nc, variable, profile)


def _write_pieces(nc: netCDF4.Dataset, variable: Variable, values: Any) -> None:
    """Write a variable along TIME piece by piece, as its copies in other types fill the memory."""
    for rows in records.pieces(len(nc.dimensions["TIME"])):
        files.write_variable(nc, variable, _beams_first(values[rows]), level=0, rows=rows)


def _beams_first(values: NDArray[Any]) -> NDArray[Any]:
    return np.moveaxis(values, 2, 0) if values.ndim == 3 else values


def _beams(record: records.Record) -> int:
    """Return the number of beams of the profiles, 0 where none of them has a beam dimension."""
    shapes = [profile[:1].shape for profile in record.profiles.values()]
    return max((shape[2] for shape in shapes if len(shape) == 3), default=0)


def read_record(path: str | Path, *, velocities: bool = True) -> records.Record:
    """Read a record written by ``write_record``, without its profiles, and without any bins if not for ``velocities``.

    Rows of its bins are read on access.
    """
    with files.open_netcdf(path) as nc:
        content: dict[str, Any] = {
            name: files.StoredVariable(str(path), entry.name, nc[entry.name].shape)
            if velocities and nc[entry.name].ndim > 1
            else files.read_variable(nc, entry.name, bins=slice(0))
            for name, entry in RECORD.items()
            if name != "tests" or entry.name in nc.variables
        }
        others = {field.name for field in fields(records.Record)} - {*RECORD} - variables.NOT_STORED
        content |= {name: json.loads(nc.getncattr(name)) for name in others & {*nc.ncattrs(), "counts", "warnings"}}
        channels = [name for name in nc.variables if name.startswith(variables.CHANNEL)]
        content["channels"] = {name.removeprefix(variables.CHANNEL): files.read_variable(nc, name) for name in channels}
    return records.Record(**content | {"warnings": tuple(content["warnings"])})


def read_profiles(path: str | Path) -> dict[str, Any]:
    """Open the profiles of a record written by ``write_record``; their rows are read on access."""
    with files.open_netcdf(path) as nc:
        return {
            key: files.StoredVariable(str(path), name, nc[name].shape)
            for key, name in variables.PROFILES.items()
            if name in nc.variables
        }


def read_notes(path: str | Path, name: str) -> Any:
    """Read the ``counts`` (read, skipped, flagged) or the ``warnings`` of a record without its series."""
    return json.loads(files.read_attribute(path, name))


def read_sources(paths: Iterable[str | Path]) -> dict[str, str]:
    """Read the SHA-256 of the raw files behind records and ready-made pairs, by path relative to the cruise folder."""
    sources: dict[str, str] = {}
    for path in paths:
        with files.open_netcdf(path) as nc:
            sources |= json.loads(getattr(nc, SOURCES, "{}"))
    return sources


def read_applied_declinations(paths: Iterable[str | Path]) -> dict[str, float]:
    """Read the declination removed from each record, degrees, of headings and of velocities where they differ."""
    applied: dict[str, float] = {}
    for path in map(Path, paths):
        heading, velocity = (read_notes(path, f"{part}_bias_deg") for part in ("heading", "velocity"))
        if velocity in (None, heading):
            applied[path.stem] = heading
        else:
            applied |= {f"{path.stem} (headings)": heading, f"{path.stem} (velocities)": velocity}
    return applied


# Attributes of overlap.nc that hold a field of ``Pairs`` as JSON; all but warnings only where there is one.
PAIR_NOTES = {
    "warnings": "warnings",
    "reference_compass": "compass",
    **{name: name for name in ("slow_shear", "doubts", "slowed")},
}
ERRORS, VEER = "water_error_of_mean_and_of_prediction_m_s", "water_turned_for_good_deg"
DELAYS = "delay_of_current_and_of_reference_speeds_hours"


def write_pairs(path: str | Path, pairs: records.Pairs, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write overlap.nc, possibly without pairs."""
    with files.create_netcdf(path) as nc:
        nc.setncatts({"Conventions": "CF-1.11", "title": "pairs of overlapping velocities"} | plain(attributes or {}))
        notes = {name: getattr(pairs, field) for name, field in PAIR_NOTES.items()}
        written = {name: note for name, note in notes.items() if note or name == "warnings"}
        nc.setncatts({name: json.dumps(note, default=vars) for name, note in written.items()})
        if pairs.expected_m_s is not None:
            nc.setncattr(ERRORS, np.array(pairs.expected_m_s))
        nc.setncattr(VEER, pairs.veer_deg)
        nc.setncattr(DELAYS, [pairs.delay_h, pairs.speed_late_h])
        nc.createDimension("TIME", len(pairs))
        for name, variable in PAIRS.items():
            if (column := getattr(pairs, name)) is not None:
                files.write_variable(nc, variable, column)
        if pairs.reference_names:
            flags = np.arange(len(pairs.reference_names), dtype=np.int8)
            meanings = {"flag_values": flags, "flag_meanings": " ".join(pairs.reference_names)}
            nc[PAIRS["reference_index"].name].setncatts(meanings)
        files.write_variable(nc, variables.SEPARATION_METRES, pairs.lower_depth_m - pairs.upper_depth_m)


def read_pairs(path: str | Path) -> records.Pairs:
    """Read pairs written by ``write_pairs``."""
    with files.open_netcdf(path) as nc:
        perhaps = {"lower_heading_deg", "reference_index"}
        values: dict[str, Any] = {
            name: files.read_variable(nc, variable.name)
            for name, variable in PAIRS.items()
            if name not in perhaps or variable.name in nc.variables
        }
        values["expected_m_s"] = tuple(map(float, getattr(nc, ERRORS))) if ERRORS in nc.ncattrs() else None
        names = nc[PAIRS["reference_index"].name].flag_meanings.split() if "reference_index" in values else []
        values |= {"reference_names": tuple(names), "veer_deg": float(nc.getncattr(VEER))}
        values["delay_h"], values["speed_late_h"] = map(float, nc.getncattr(DELAYS))
        notes = {field: json.loads(getattr(nc, name, "null")) for name, field in PAIR_NOTES.items()}
        values |= {field: tuple(map(tuple, notes[field] or ())) for field in ("doubts", "slowed")}
        for field, made in (("compass", records.ReferenceCompass), ("slow_shear", records.SlowShear)):
            values[field] = None if notes[field] is None else made(**notes[field])
        return records.Pairs(**values, warnings=tuple(notes["warnings"]))


def days_since_1950(time_s: Floats) -> Floats:
    """Convert UTC seconds since 1970 to the time of OceanSITES."""
    return time_s / DAY_S + 7305.0


def seconds_since_1970(days: Floats) -> Floats:
    """Convert days since 1950, which resolve 0.3 microseconds, to UTC seconds rounded to 10 microseconds."""
    return np.round((days - 7305.0) * DAY_S, 5)


def write_corrected(
    path: str | Path,
    product: records.CorrectedRecord | CorrectedPieces,
    *,
    site: Site,
    attributes: Mapping[str, object] | None = None,
    processing: Mapping[str, object] | None = None,
) -> None:
    """Write corrected.nc according to CF, ACDD and OceanSITES, without reading the system clock.

    Args:
        product: the corrected record, possibly without samples or corrected headings; or its pieces along time, to
            bound the memory that a decade takes.
        attributes: the user's global attributes, including make and serial number of the instrument.
        processing: how and when the product was made; see ``archive.attributes.global_attributes``.
    """
    record, end, corrected = product.record, 0, 0
    depths, declination = list[float](), list[Floats]()
    # A measured depth varies; a constant one comes from metadata.
    nominal = len(np.unique(record.depth_m[np.isfinite(record.depth_m)])) == 1
    with files.create_netcdf(path, "NETCDF4_CLASSIC") as nc:
        write_frame(nc, variables.TIME, record.time_s, site)
        # In the classic model only the unlimited dimension, TIME, may have length 0.
        files.write_bins(nc, max(record.east.shape[1], 1), _beams(record), record.looks_up)
        for piece in [product] if isinstance(product, records.CorrectedRecord) else product:
            begin, end = end, end + len(piece.record.time_s)
            for name, (values, flags) in _columns(piece, record, site, nominal).items():
                variable = CORRECTED[name]
                if variable.dimensions == variables.BEAMS and values.ndim == 2:  # counts without a beam dimension
                    variable = replace(variable, dimensions=variables.BINS)
                files.write_variable(nc, variable, values, flags, level=4, rows=slice(begin, end))
            depth = piece.record.bin_depth_m()
            known = depth[site.holds_water(depth)]
            depths += [known.min(), known.max()] if known.size else []
            corrected += int(np.isfinite(piece.heading_corrected_deg).sum())
            declination.append(piece.declination_deg)
        instrument = {key: value for key in SENSOR_KEYS[:3] if (value := getattr(record, key))}
        described = global_attributes(
            site,
            time_s=record.time_s,
            depth_m=np.array(depths),
            headings=(int(np.isfinite(record.heading_deg).sum()), corrected),
            attributes={**instrument, **(attributes or {})},
            processing=processing or {},
        )
        nc.setncatts(described)
        of_sensor = sensor_attributes(described, record.looks_up)
        of_sensor |= {key: value for key in ("recorded_in", "sound_speed") if (value := getattr(record, key))}
        of_model = declination_attributes(described, record.time_s, np.concatenate(declination))
        for variable in (entry for name, entry in CORRECTED.items() if name in nc.variables):
            nc[variable.name].setncatts(of_sensor if variable.sensed else {})
            nc[variable.name].setncatts(of_model if variable.by_declination else {})


def write_frame(nc: netCDF4.Dataset, time: Variable, time_s: Floats, site: Site) -> None:
    """Write the coordinates that corrected.nc and gridded.nc have in common."""
    name = np.frombuffer(site.name.encode(), dtype="S1")
    nc.createDimension("TIME", len(time_s))
    nc.createDimension("NAME_LENGTH", len(name))
    files.write_variable(nc, time, days_since_1950(time_s))
    files.write_variable(nc, variables.LATITUDE, site.latitude)
    files.write_variable(nc, variables.LONGITUDE, site.signed_longitude())
    files.write_variable(nc, variables.STATION, name)


# Variables of corrected.nc by the field of ``CorrectedRecord`` and of its ``record`` that they hold.
_PRODUCT = {
    "heading_corrected_deg": "HEADING_CORRECTED",
    "heading_uncertainty_deg": "HEADING_CORRECTED_UNCERTAINTY",
    "heading_common_deg": "HEADING_COMMON_UNCERTAINTY",
    "heading_corrected_quality": "HEADING_CORRECTED_QC",
    "deviation_deg": "DEVIATION",
    "branch_probability": "BRANCH_PROBABILITY",
    "declination_deg": "DECLINATION",
    "east": "UCUR",
    "north": "VCUR",
    "east_recorded": "UCUR_RECORDED",
    "north_recorded": "VCUR_RECORDED",
    "east_uncertainty": "UCUR_UNCERTAINTY",
    "north_uncertainty": "VCUR_UNCERTAINTY",
    "velocity_quality": "UCUR_QC",
}
_RECORDED = {
    "east": "UCUR_RECORDED",
    "north": "VCUR_RECORDED",
    "heading_deg": "HEADING",
    "pitch_deg": "PITCH",
    "roll_deg": "ROLL",
    "pressure_dbar": "PRES",
    "depth_m": "INSTRUMENT_DEPTH",
    "temperature_c": "TEMP",
    "quality": "UCUR_RECORDED_QC",
    "tests": "UCUR_QC_TESTS",
    "heading_quality": "HEADING_QC",
}


def read_corrected(path: str | Path, *, velocities: bool = True) -> records.CorrectedRecord:
    """Read a product written by ``write_corrected``, as far as figures need it; without ``velocities``, without bins.

    Its ``record`` has no supply voltage, profiles, counts or warnings, and its velocities are those by the recorded
    heading, relative to true north.
    """
    bins = None if velocities else slice(0)
    with files.open_netcdf(path) as nc:
        absent = {"PRES", "TEMP"} - {*nc.variables}
        made: dict[str, Any] = {field: files.read_variable(nc, name, bins=bins) for field, name in _PRODUCT.items()}
        known: dict[str, Any] = {
            field: files.read_variable(nc, name, bins=bins) for field, name in _RECORDED.items() if name not in absent
        }
        time_s, depth = seconds_since_1970(files.read_variable(nc, "TIME")), files.read_variable(nc, "DEPTH", bins=bins)
        unknown = np.full(time_s.shape, np.nan)
        looks_up = nc["HEADING"].getncattr("sensor_orientation") == "upward"
    missing = dict.fromkeys(("pressure_dbar", "temperature_c", "supply_voltage"), unknown)
    known["bin_range_m"] = (1.0 if looks_up else -1.0) * (known["depth_m"][:, None] - depth)
    record = records.Record(time_s=time_s, looks_up=looks_up, direction_reference="true", **{**missing, **known})
    return records.CorrectedRecord(record=record, **made)


def open_product(path: str | Path) -> records.CorrectedRecord:
    """Load a corrected.nc, or that of a folder of results; its ``to_xarray()`` loads the whole file into a dataset."""
    path = Path(path) / "corrected.nc" if Path(path).is_dir() else Path(path)
    with files.open_netcdf(path) as nc:
        if "HEADING_ERROR_MODE" in nc.variables:
            raise InputError(str(path), "corrected.nc", "gridded velocities", "open it by compasslib.open_gridded")
    return replace(read_corrected(path), path=str(path))


def _columns(product: records.CorrectedRecord, whole: records.Record, site: Site, nominal: bool) -> Columns:
    """Collect the variables of a piece of the product; optional ones as far as the ``whole`` record has values."""
    record = product.record
    depth, instrument_depth = record.bin_depth_m(), record.depth_m
    heading, quality = product.heading_corrected_deg, product.heading_corrected_quality
    corrected = _flag_missing(quality, heading, records.BAD)
    true = angles.wrap360(heading + product.declination_deg)
    tests = np.zeros(record.quality.shape, dtype=np.int32) if record.tests is None else record.tests
    doubtful = np.where(quality >= records.PROBABLY_BAD, MASKS["heading"], 0)
    east, north = product.east_recorded, product.north_recorded
    columns: Columns = {
        "DEPTH": (depth, _judged("DEPTH", depth, nominal, site.holds_water(depth))),
        "INSTRUMENT_DEPTH": (instrument_depth, _judged("INSTRUMENT_DEPTH", instrument_depth, nominal)),
        "HEADING": (
            angles.wrap360(record.heading_deg),
            _flag_missing(record.heading_quality, record.heading_deg, records.MISSING),
        ),
        "HEADING_CORRECTED": (angles.wrap360(heading), corrected),
        "HEADING_CORRECTED_UNCERTAINTY": (product.heading_uncertainty_deg, corrected),
        "HEADING_COMMON_UNCERTAINTY": (product.heading_common_deg, corrected),
        "DEVIATION": (product.deviation_deg, corrected),
        "BRANCH_PROBABILITY": (product.branch_probability, None),
        "DECLINATION": (product.declination_deg, _judged("DECLINATION", product.declination_deg, True)),
        "UCUR": (product.east, _flag_missing(product.velocity_quality, product.east, records.BAD)),
        "VCUR": (product.north, _flag_missing(product.velocity_quality, product.north, records.BAD)),
        "UCUR_RECORDED": (east, _flag_missing(record.quality, east, records.MISSING)),
        "VCUR_RECORDED": (north, _flag_missing(record.quality, north, records.MISSING)),
        "UCUR_QC_TESTS": (tests | doubtful[:, None], None),
        "UCUR_UNCERTAINTY": (product.east_uncertainty, None),
        "VCUR_UNCERTAINTY": (product.north_uncertainty, None),
        "HEADING_TRUE": (true, _flag_missing(quality, true, records.BAD)),
        "PITCH": (record.pitch_deg, _judged("PITCH", record.pitch_deg)),
        "ROLL": (record.roll_deg, _judged("ROLL", record.roll_deg)),
    }
    for name, field in (("TEMP", "temperature_c"), ("PRES", "pressure_dbar")):
        if np.isfinite(getattr(whole, field)).any():
            columns[name] = (getattr(record, field), _judged(name, getattr(record, field)))
    for name, profile in record.profiles.items():
        values = profile[:]
        flags = _flag_missing(record.quality, values, records.MISSING) if values.dtype.kind == "f" else None
        columns[variables.PROFILES[name]] = (_beams_first(values), flags)
    return columns


def _flag_missing(flags: records.Flags, values: Floats, absent: int) -> records.Flags:
    """Set the flag ``absent`` where a value is missing and its flag is neither bad nor missing."""
    given = np.isfinite(values) | np.isin(flags, (records.BAD, records.MISSING))
    return np.where(given, flags, absent).astype(np.int8)


def _judged(name: str, values: Floats, nominal: bool = False, within: Bools | bool = True) -> records.Flags:
    """Flag the values of a variable that no earlier stage has flagged, by its valid range and ``within`` alone."""
    low, high = CORRECTED[name].valid or (-np.inf, np.inf)
    good = (values >= low) & (values <= high) & within
    flags = np.where(good, variables.NOMINAL if nominal else records.PROBABLY_GOOD, records.BAD)
    return np.where(np.isfinite(values), flags, records.MISSING).astype(np.int8)
