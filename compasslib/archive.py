"""CF netCDF in and out: the record between two stages and overlap.nc; and the doors to corrected.nc and JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from compasslib import archive_layout as layout
from compasslib.archive_attributes import Site, plain
from compasslib.archive_files import (
    get,
    new,
    opened,
    put,
    put_bins,
    read_attribute,
    read_json,
    replacing,
    write_json,
)
from compasslib.archive_product import read_corrected, write_corrected
from compasslib.records import Floats, Pairs, Record

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


def write_record(path: str | Path, record: Record, *, attributes: Mapping[str, object] | None = None) -> None:
    """Write a record between two stages; series in float64, velocities and ranges in float32.

    Not compressed, as it is read five times; it stays smaller than most raw files.

    Args:
        path: the file.
        record: any record, also one without samples.
        attributes: further global attributes.
    """
    with new(path) as nc:
        nc.setncatts({"Conventions": "CF-1.8", "title": "record of one instrument"} | plain(attributes or {}))
        for name, size in zip(("TIME", "BIN"), record.east.shape, strict=True):
            nc.createDimension(name, size)
        put_bins(nc, record.east.shape[1], record.looks_up)
        for field in fields(Record):
            value = getattr(record, field.name)
            if field.name in layout.RECORD:
                put(nc, layout.RECORD[field.name], value, level=0)
            elif field.name not in layout.NOT_STORED:
                nc.setncattr(field.name, json.dumps(value, default=lambda number: number.item()))


def read_record(path: str | Path, *, velocities: bool = True) -> Record:
    """Return a record that ``write_record`` wrote.

    Args:
        path: the file.
        velocities: whether its bins are wanted; else it comes without any.

    Raises:
        InputError: the file is absent, damaged or something else.
    """
    bins = None if velocities else 0
    with opened(path) as nc:
        # The ranges first: they shrink to a row before the velocities come.
        arrays = {"bin_range_m": _shared(get(nc, layout.RECORD["bin_range_m"].name, bins))}
        arrays |= {name: get(nc, one.name, bins) for name, one in layout.RECORD.items() if name not in arrays}
        others = {field.name for field in fields(Record)} - set(layout.RECORD) - layout.NOT_STORED
        rest = {name: json.loads(nc.getncattr(name)) for name in others}
    return Record(**arrays | rest | {"warnings": tuple(rest["warnings"])})


def _shared(bin_range_m: Floats) -> Floats:
    """Return one row that all samples share where there was one setting throughout."""
    if not bin_range_m.size or not (bin_range_m == bin_range_m[0]).all():
        return bin_range_m
    return np.broadcast_to(bin_range_m[0].copy(), bin_range_m.shape)


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
