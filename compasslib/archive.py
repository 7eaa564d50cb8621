"""CF netCDF in and out: the record between two stages, overlap.nc and corrected.nc; and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import netCDF4
import numpy as np

from compasslib import angles
from compasslib import archive_layout as layout
from compasslib.archive_attributes import Site, global_attributes, plain, sensor_attributes
from compasslib.archive_files import (
    get,
    new,
    opened,
    put,
    read_attribute,
    read_json,
    replacing,
    write_json,
)
from compasslib.archive_layout import Variable, quality_of
from compasslib.records import BAD, MISSING, PROBABLY_GOOD, Corrected, Flags, Floats, Pairs, Record

__all__ = [
    "Site",
    "read_corrected",
    "read_counts",
    "read_json",
    "read_pairs",
    "read_record",
    "read_warnings",
    "replacing",
    "write_corrected",
    "write_json",
    "write_pairs",
    "write_record",
]

DAYS_1950_TO_1970 = 7305.0
TIME_DECIMALS = 5  # of seconds; days since 1950 in float64 resolve 0.3 microseconds
Columns = dict[str, tuple[Floats, Flags | None]]  # values, and flags where there are any


def write_record(path: str | Path, record: Record, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write a record between two stages; series in float64, velocities and ranges in float32.

    Args:
        path: the file.
        record: any record, also one without samples.
        attributes: further global attributes.
    """
    with new(path) as nc:
        nc.setncatts({"Conventions": "CF-1.8", "title": "record of one instrument"} | plain(attributes or {}))
        for name, size in zip(("TIME", "BIN"), record.east.shape, strict=True):
            nc.createDimension(name, size)
        _put_bins(nc, record.east.shape[1], record.looks_up)
        for field in fields(Record):
            value = getattr(record, field.name)
            if field.name in layout.RECORD:
                put(nc, layout.RECORD[field.name], value)
            elif field.name not in layout.NOT_STORED:
                nc.setncattr(field.name, json.dumps(value, default=lambda number: number.item()))


def read_record(path: str | Path) -> Record:
    """Return a record that ``write_record`` wrote.

    Args:
        path: the file.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with opened(path) as nc:
        arrays = {name: get(nc, variable.name) for name, variable in layout.RECORD.items()}
        others = {field.name for field in fields(Record)} - set(layout.RECORD) - layout.NOT_STORED
        rest = {name: json.loads(nc.getncattr(name)) for name in others}
    if len(arrays["bin_range_m"]) and (arrays["bin_range_m"] == arrays["bin_range_m"][0]).all():
        # One setting throughout: one row that all samples share.
        arrays["bin_range_m"] = np.broadcast_to(arrays["bin_range_m"][0].copy(), arrays["bin_range_m"].shape)
    return Record(**arrays | rest | {"warnings": tuple(rest["warnings"])})


def read_counts(path: str | Path) -> dict[str, int]:
    """Return what was read, skipped and flagged in a record that ``write_record`` wrote; its series are not read.

    Args:
        path: the file.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    counts: dict[str, int] = json.loads(read_attribute(path, "counts"))
    return counts


def read_warnings(path: str | Path) -> list[str]:
    """Return the warnings of a record that ``write_record`` wrote; see ``read_counts``.

    Args:
        path: the file.
    """
    warnings: list[str] = json.loads(read_attribute(path, "warnings"))
    return warnings


def write_pairs(path: str | Path, pairs: Pairs, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write overlap.nc.

    Args:
        path: the file.
        pairs: any pairs, also none.
        attributes: further global attributes.
    """
    with new(path) as nc:
        nc.setncatts({"Conventions": "CF-1.8", "title": "pairs of overlapping velocities"} | plain(attributes or {}))
        nc.setncattr("warnings", json.dumps(pairs.warnings))
        nc.createDimension("TIME", len(pairs))
        for name, variable in layout.PAIRS.items():
            put(nc, variable, getattr(pairs, name))
        put(nc, layout.SEPARATION_METRES, pairs.lower_depth_m - pairs.upper_depth_m)


def read_pairs(path: str | Path) -> Pairs:
    """Return pairs that ``write_pairs`` wrote.

    Args:
        path: the file.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with opened(path) as nc:
        arrays = {name: get(nc, variable.name) for name, variable in layout.PAIRS.items()}
        return Pairs(**arrays, warnings=tuple(json.loads(nc.getncattr("warnings"))))


def write_corrected(
    path: str | Path,
    product: Corrected,
    *,
    site: Site,
    attributes: Mapping[str, object] | None = None,
    processing: Mapping[str, object] | None = None,
) -> None:
    """Write corrected.nc: CF, ACDD and OceanSITES; no clock is read.

    Args:
        path: the file.
        product: the corrected instrument, also without samples or without any corrected heading.
        site: name and place of the mooring.
        attributes: global attributes of the user, and make and number of the instrument.
        processing: how and when the product was made; see ``archive_attributes.global_attributes``.
    """
    columns = _columns(product)
    said = global_attributes(
        site,
        time_s=product.record.time_s,
        depth_m=columns["DEPTH"][0],
        headings=(_count(columns["HEADING"][0]), _count(columns["HEADING_CORRECTED"][0])),
        attributes=attributes or {},
        processing=processing or {},
    )
    sensor = sensor_attributes(said, product.record.looks_up)
    with new(path, "NETCDF4_CLASSIC") as nc:
        nc.setncatts(said)
        _put_coordinates(nc, product.record, site)
        for name, (values, flags) in columns.items():
            _put_placed(nc, layout.CORRECTED[name], values, flags, sensor if name in layout.SENSED else {})


def read_corrected(path: str | Path) -> Corrected:
    """Return the product that ``write_corrected`` wrote, for looking at it.

    The record inside has no pressure, no supply voltage, no counts and no warnings, and its velocities are the recorded
    ones from true north.

    Args:
        path: the file.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    with opened(path) as nc:
        return Corrected(
            record=_record_of(nc),
            heading_corrected_deg=get(nc, "HEADING_CORRECTED"),
            heading_uncertainty_deg=get(nc, "HEADING_CORRECTED_UNCERTAINTY"),
            heading_corrected_quality=get(nc, "HEADING_CORRECTED_QC"),
            deviation_deg=get(nc, "DEVIATION"),
            branch_probability=get(nc, "BRANCH_PROBABILITY"),
            declination_deg=get(nc, "DECLINATION"),
            east=get(nc, "UCUR"),
            north=get(nc, "VCUR"),
            east_recorded=get(nc, "UCUR_RECORDED"),
            north_recorded=get(nc, "VCUR_RECORDED"),
            velocity_uncertainty=get(nc, "UCUR_UNCERTAINTY"),
            velocity_quality=get(nc, "UCUR_QC"),
        )


def _record_of(nc: netCDF4.Dataset) -> Record:
    time_s = np.round((get(nc, "TIME") - DAYS_1950_TO_1970) * 86400.0, TIME_DECIMALS)
    unknown = np.full(time_s.shape, np.nan)
    looks_up = nc["HEADING"].getncattr("sensor_orientation") == "upward"
    depth = get(nc, "INSTRUMENT_DEPTH")
    return Record(
        time_s=time_s,
        east=get(nc, "UCUR_RECORDED"),
        north=get(nc, "VCUR_RECORDED"),
        bin_range_m=(1.0 if looks_up else -1.0) * (depth[:, None] - get(nc, "DEPTH")),
        heading_deg=get(nc, "HEADING"),
        pitch_deg=get(nc, "PITCH"),
        roll_deg=get(nc, "ROLL"),
        pressure_dbar=unknown,
        depth_m=depth,
        temperature_c=get(nc, "TEMPERATURE") if "TEMPERATURE" in nc.variables else unknown,
        supply_voltage=unknown,
        quality=get(nc, "UCUR_RECORDED_QC"),
        heading_quality=get(nc, "HEADING_QC"),
        looks_up=looks_up,
        direction_reference="true",
    )


def _columns(product: Corrected) -> Columns:
    record = product.record
    depth, instrument_depth = record.bin_depth_m(), record.depth_m
    # A measured depth varies; one that does not was written down, not observed.
    nominal = _count(instrument_depth) > 0 and np.nanmin(instrument_depth) == np.nanmax(instrument_depth)
    corrected = _kept(product.heading_corrected_quality, product.heading_corrected_deg, BAD)
    columns: Columns = {
        "DEPTH": (depth, _judged("DEPTH", depth, nominal)),
        "INSTRUMENT_DEPTH": (instrument_depth, _judged("INSTRUMENT_DEPTH", instrument_depth, nominal)),
        "HEADING": (angles.wrap360(record.heading_deg), _kept(record.heading_quality, record.heading_deg, MISSING)),
        "HEADING_CORRECTED": (angles.wrap360(product.heading_corrected_deg), corrected),
        "HEADING_CORRECTED_UNCERTAINTY": (product.heading_uncertainty_deg, corrected),
        "DEVIATION": (product.deviation_deg, corrected),
        "BRANCH_PROBABILITY": (product.branch_probability, None),
        "DECLINATION": (product.declination_deg, _judged("DECLINATION", product.declination_deg, True)),
        "UCUR": (product.east, _kept(product.velocity_quality, product.east, BAD)),
        "VCUR": (product.north, _kept(product.velocity_quality, product.north, BAD)),
        "UCUR_RECORDED": (product.east_recorded, _kept(record.quality, product.east_recorded, MISSING)),
        "VCUR_RECORDED": (product.north_recorded, _kept(record.quality, product.north_recorded, MISSING)),
        "UCUR_UNCERTAINTY": (product.velocity_uncertainty, None),
        "VCUR_UNCERTAINTY": (product.velocity_uncertainty, None),
        "PITCH": (record.pitch_deg, _judged("PITCH", record.pitch_deg)),
        "ROLL": (record.roll_deg, _judged("ROLL", record.roll_deg)),
    }
    if _count(record.temperature_c):
        columns["TEMPERATURE"] = (record.temperature_c, _judged("TEMPERATURE", record.temperature_c))
    return columns


def _count(values: Floats) -> int:
    return int(np.isfinite(values).sum())


def _kept(flags: Flags, values: Floats, absent: int) -> Flags:
    """Return the flags, with one that says so where a value is absent and its flag does not."""
    said = np.isfinite(values) | np.isin(flags, (BAD, MISSING))
    return np.where(said, flags, absent).astype(np.int8)


def _judged(name: str, values: Floats, nominal: bool = False) -> Flags:
    """Return flags by the valid range alone, for what no earlier stage has flagged."""
    low, high = layout.CORRECTED[name].valid or (-np.inf, np.inf)
    flags = np.where((values >= low) & (values <= high), layout.NOMINAL if nominal else PROBABLY_GOOD, BAD)
    return np.where(np.isfinite(values), flags, MISSING).astype(np.int8)


def _put_coordinates(nc: netCDF4.Dataset, record: Record, site: Site) -> None:
    n, m = record.east.shape
    name = np.frombuffer(site.name.encode(), dtype="S1")
    bins = max(m, 1)  # only one dimension may have no length in the classic model, and that is TIME
    for dimension, size in (("TIME", n), ("BIN", bins), ("NAME_LENGTH", len(name))):
        nc.createDimension(dimension, size)
    put(nc, layout.TIME, record.time_s / 86400.0 + DAYS_1950_TO_1970)
    _put_bins(nc, bins, record.looks_up)
    put(nc, layout.LATITUDE, site.latitude)
    put(nc, layout.LONGITUDE, site.signed_longitude())
    put(nc, layout.STATION, name)


def _put_bins(nc: netCDF4.Dataset, bins: int, looks_up: bool) -> None:
    away = {"positive": "up" if looks_up else "down"}
    put(nc, replace(layout.BIN, also={**layout.BIN.also, **away}), np.arange(1, bins + 1))


def _put_placed(
    nc: netCDF4.Dataset, variable: Variable, values: Floats, flags: Flags | None, sensor: Mapping[str, object]
) -> None:
    coordinates = layout.COORDINATES[variable.dimensions]
    placed = {} if variable.name in coordinates.split() else {"coordinates": coordinates}
    quality = quality_of(variable)
    ancillary = variable.ancillary if flags is None else (quality.name, *variable.ancillary)
    put(nc, replace(variable, ancillary=ancillary, also={**variable.also, **placed, **sensor}), values, level=4)
    if flags is not None:
        put(nc, replace(quality, also={**quality.also, "coordinates": coordinates}), flags, level=4)
