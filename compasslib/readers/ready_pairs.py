"""Ready-made pairs of others: a table, or a MATLAB file whose variables are columns of one length."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.delimited import read_table
from compasslib.types import DAY_S, Floats

ROLES = ("time", "heading", "upper_east", "upper_north", "lower_east", "lower_north")
ADVICE = "correct fit.columns in the mooring file"
DATENUM_OF_1970 = 719529.0
DATENUMS = (6.5e5, 8.0e5)  # years 1780 to 2190; seconds since 1970 are beyond
HDF5 = b"\x89HDF"  # after the text header of 512 bytes in a MATLAB 7.3 file
HDF5_AT = 512


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times of a MATLAB file are datenum or seconds since 1970.

    Args:
        columns: header or variable of each of ``ROLES``.

    Raises:
        InputError: the file or a column is absent, or cannot be read.
    """
    if path.suffix.lower() != ".mat":
        return read_table(path, columns, ADVICE).columns
    variables = _read_matlab(path)
    for role, name in columns.items():
        if name not in variables:
            there = ", ".join(sorted(variables)) or "no variable"
            raise InputError(f"{path}: {name} ({role})", expected="one of its variables", found=there, advice=ADVICE)
    try:
        series = {role: np.asarray(variables[name], dtype=float).ravel() for role, name in columns.items()}
    except (TypeError, ValueError) as error:
        raise InputError(str(path), expected="variables of numbers", found=error, advice=ADVICE) from error
    if len({column.size for column in series.values()}) != 1:
        sizes = ", ".join(f"{columns[role]} {column.size}" for role, column in series.items())
        raise InputError(str(path), expected="variables of one length", found=sizes, advice=ADVICE)
    first = float(np.nanmin(series["time"], initial=np.inf))
    if DATENUMS[0] < first < DATENUMS[1]:
        series["time"] = (series["time"] - DATENUM_OF_1970) * DAY_S
    elif first < DATENUMS[1]:
        expected = "times as datenum or as seconds since 1970"
        raise InputError(f"{path}: {columns['time']}", expected=expected, found=first, advice=ADVICE)
    return series


def _read_matlab(path: Path) -> dict[str, Any]:
    """Read the variables of a MATLAB file of version 4 to 7, or 7.3 where h5py is installed."""
    from scipy.io import loadmat  # only where such a file is given

    try:
        with path.open("rb") as stream:
            stream.seek(HDF5_AT)
            is_hdf5 = stream.read(len(HDF5)) == HDF5
        if not is_hdf5:
            return {name: value for name, value in loadmat(path).items() if not name.startswith("__")}
    except (OSError, ValueError, TypeError, NotImplementedError) as error:
        advice = "save it in MATLAB with save -v7, or as a table"
        raise InputError(str(path), expected="a MATLAB file", found=error, advice=advice) from error
    try:
        import h5py
    except ImportError as error:
        expected, found = "h5py, which reads MATLAB 7.3", "it not installed"
        advice = "pip install 'compasslib[matlab73]', or save -v7 in MATLAB"
        raise InputError(str(path), expected=expected, found=found, advice=advice) from error
    with h5py.File(path) as file:
        return {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
