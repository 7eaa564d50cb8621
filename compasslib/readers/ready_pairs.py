"""Read ready-made pairs (``fit: {method: pairs}``) from a text table or a MATLAB file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.delimited import read_table
from compasslib.readers.files import DAMAGE_ERRORS, refuse_large_arrays
from compasslib.readers.times import DATENUM_1970
from compasslib.types import DAY_S, Floats

ROLES = ("time", "heading", "upper_east", "upper_north", "lower_east", "lower_north")
ADVICE = "correct fit.columns in the mooring file"
DATENUMS = (6.5e5, 8.0e5)  # years 1780 to 2190; seconds since 1970 are larger
HDF5 = b"\x89HDF"  # after the text header of 512 bytes in a MATLAB 7.3 file
NUMBERS = re.compile(r"double|single|u?int\d+|float\d+")  # types by scipy and h5py


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times in a MATLAB file may be datenum or seconds since 1970.

    Raises:
        InputError: the file or a column is missing, or cannot be read within the limits of raw files.
    """
    if path.suffix.lower() != ".mat":
        return read_table(path, columns, ADVICE).columns
    variables = _read_matlab(path, columns)
    if other := [name for name in columns.values() if np.iscomplexobj(variables[name])]:
        raise InputError(f"{path}: {other[0]}", expected="real numbers", found="complex ones", advice=ADVICE)
    series = {role: np.asarray(variables[name], dtype=float).ravel() for role, name in columns.items()}
    first = float(np.nanmin(series["time"], initial=np.inf))
    if DATENUMS[0] < first < DATENUMS[1]:
        series["time"] = (series["time"] - DATENUM_1970) * DAY_S
    elif first < DATENUMS[1]:
        expected = "times as datenum or as seconds since 1970"
        raise InputError(f"{path}: {columns['time']}", expected=expected, found=first, advice=ADVICE)
    return series


def _read_matlab(path: Path, columns: Mapping[str, str]) -> Mapping[str, Any]:
    """Read series from a MATLAB file of version 4 to 7, or 7.3 where h5py is installed."""
    from scipy.io import loadmat, whosmat  # only where such a file is given
    from scipy.io.matlab import MatReadError

    try:
        with path.open("rb") as stream:
            stream.seek(512)
            is_hdf5 = stream.read(len(HDF5)) == HDF5
        if not is_hdf5:
            _refuse_others(path, columns, {name: (form, shape) for name, shape, form in whosmat(path)})
            return {**loadmat(path, variable_names=[*columns.values()])}
    except (*DAMAGE_ERRORS, MatReadError) as error:
        advice = "save it in MATLAB with save -v7, or as a table"
        raise InputError(str(path), expected="a MATLAB file", found=error, advice=advice) from error
    try:
        import h5py
    except ImportError as error:
        expected, found = "h5py, which reads MATLAB 7.3", "it not installed"
        advice = "pip install 'compasslib[matlab73]', or save -v7 in MATLAB"
        raise InputError(str(path), expected=expected, found=found, advice=advice) from error
    try:
        with h5py.File(path) as file:
            series = {name: item for name, item in file.items() if isinstance(item, h5py.Dataset)}
            _refuse_others(path, columns, {name: (str(x.dtype), x.shape or ()) for name, x in series.items()})
            return {name: series[name][()] for name in columns.values()}
    except DAMAGE_ERRORS as error:
        advice = "copy it again from where it was made"
        raise InputError(str(path), expected="a whole MATLAB file", found=error, advice=advice) from error


def _refuse_others(path: Path, columns: Mapping[str, str], listed: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Refuse variables other than series of numbers of one length by their type and shape, before they are read."""
    for role, name in columns.items():
        where = f"{path}: {name} ({role})"
        if name not in listed:
            there = ", ".join(sorted(listed)) or "no variable"
            raise InputError(where, expected="one of its variables", found=there, advice=ADVICE)
        form, shape = listed[name]
        if not NUMBERS.fullmatch(form) or math.prod(shape) != max(shape, default=0):
            found = f"{form}, {' x '.join(map(str, shape))}"
            raise InputError(where, expected="a series of numbers, 1 x n or n x 1", found=found, advice=ADVICE)
    sizes = {name: math.prod(listed[name][1]) for name in columns.values()}
    if len({*sizes.values()}) != 1:
        found = ", ".join(f"{name} {size}" for name, size in sizes.items())
        raise InputError(str(path), expected="variables of one length", found=found, advice=ADVICE)
    refuse_large_arrays(str(path), 8 * sum(sizes.values()), path.stat().st_size)
