"""corrected.nc in the forms that others read: a table as CSV, MATLAB's structures, and under its OceanSITES name."""

from __future__ import annotations

import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib.archive import layout
from compasslib.archive.files import opened, read_attribute, replacing, write_json
from compasslib.archive.netcdf import DAYS_1950_TO_1970

PIECE = 4096  # samples that are written at once
DIGITS = "%.7g"  # float32 holds as many
DATENUM_1950 = 712_224.0  # MATLAB's datenum of 1950-01-01
PREAMBLE = b"MATLAB 5.0 MAT-file, by compass export".ljust(116)  # scipy's tells the time of writing
FOR_ALL = ("LATITUDE", "LONGITUDE", layout.STATION.name, layout.BIN.name, layout.BEAM.name)


def to_oceansites(source: Path, target: Path) -> None:
    """Copy corrected.nc under another name.

    Raises:
        Passing: it cannot be written.
    """
    with replacing(target) as temporary:
        shutil.copyfile(source, temporary)


def oceansites_name(source: Path) -> str:
    """Return the file name that OceanSITES has for corrected.nc.

    Raises:
        InputError: the file is absent or damaged.
    """
    return f"{read_attribute(source, 'id')}.nc"


def to_csv(source: Path, table: Path, sidecar: Path) -> None:
    """Write a row a sample and bin, empty where a value is missing; units and meanings go into a JSON file.

    Args:
        source: corrected.nc.

    Raises:
        InputError: the file is absent or damaged.
    """
    import pandas as pd  # 0.4 s: only who asks for a table waits for it

    with opened(source) as nc, replacing(table) as temporary:
        with temporary.open("w", encoding="utf-8", newline="") as stream:
            for begin in range(0, max(len(nc.dimensions["TIME"]), 1), PIECE):
                rows = pd.DataFrame(dict(_columns(nc, slice(begin, begin + PIECE))))
                rows.to_csv(stream, index=False, header=begin == 0, float_format=DIGITS, lineterminator="\n")
        write_json(sidecar, _described(nc))


def to_mat(source: Path, target: Path) -> None:
    """Write structures of MATLAB: data, units, long_name, and attributes of the whole file; NaN where missing.

    Args:
        source: corrected.nc.

    Raises:
        InputError: the file is absent or damaged.
    """
    from scipy.io import savemat

    with opened(source) as nc:
        data = {name: _values(nc, name) for name in nc.variables}
        data["DATENUM"] = np.asarray(data["TIME"]) + DATENUM_1950
        told = {key: {n: str(getattr(v, key, "1")) for n, v in nc.variables.items()} for key in ("units", "long_name")}
        told["units"]["DATENUM"], told["long_name"]["DATENUM"] = "days", "TIME as MATLAB's datenum, UTC"
        attributes = {name: nc.getncattr(name) for name in nc.ncattrs()}
    stream = io.BytesIO()
    everything = {"data": data, **told, "attributes": attributes}
    savemat(stream, everything, long_field_names=True, do_compression=True, oned_as="column")
    with replacing(target) as temporary:
        temporary.write_bytes(PREAMBLE + stream.getvalue()[len(PREAMBLE) :])


def _columns(nc: netCDF4.Dataset, some: slice) -> Iterator[tuple[str, Any]]:
    """Give the columns of some samples, a value a sample and bin."""
    bins = len(nc.dimensions["BIN"])
    time = np.round((nc["TIME"][some] - DAYS_1950_TO_1970) * 86400e3).astype("datetime64[ms]")
    yield "TIME", np.repeat(np.char.add(np.datetime_as_string(time, unit="ms"), "Z"), bins)
    yield "BIN", np.tile(nc["BIN"][:], len(time))
    for name, variable in nc.variables.items():
        if variable.dimensions == layout.SERIES and name != "TIME":
            yield name, np.repeat(_values(nc, name, some), bins)
        elif variable.dimensions == layout.BINS:
            yield name, _values(nc, name, some).ravel()
        elif variable.dimensions == layout.BEAMS:
            each = _values(nc, name, (slice(None), some))
            yield from ((f"{name}_{beam}", one.ravel()) for beam, one in zip(nc["BEAM"][:], each, strict=True))


def _values(nc: netCDF4.Dataset, name: str, which: Any = ...) -> Any:
    """Return what a variable holds, NaN where a number is missing; flags as they are, text as text."""
    values: NDArray[Any] = np.asarray(nc[name][which])
    if values.dtype.kind == "S":
        return values.tobytes().decode()
    fill = getattr(nc[name], "_FillValue", None)
    if fill is None:
        return values
    known = values if values.dtype.kind == "f" else values.astype(np.float32)
    return np.where(values == fill, known.dtype.type(np.nan), known)


def _described(nc: netCDF4.Dataset) -> dict[str, Any]:
    """Return what stands in no column: units and meanings by column, what holds for all rows, global attributes."""
    columns = {name: variable for name, variable in nc.variables.items() if name not in FOR_ALL or name == "BIN"}
    meanings = {name: {key: getattr(v, key) for key in v.ncattrs() if key[0] != "_"} for name, v in columns.items()}
    meanings["TIME"] |= {"units": "ISO 8601, UTC"}
    return {
        "rows": "a row a sample and bin; empty: missing; NAME_1, NAME_2 ...: by beam",
        "columns": meanings,
        "for_all_rows": {name: _values(nc, name) for name in FOR_ALL[:3]},
        "attributes": {name: nc.getncattr(name) for name in nc.ncattrs()},
    }
