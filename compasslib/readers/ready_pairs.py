"""Read ready-made pairs (``fit: {method: pairs}``) from a text table or a MATLAB file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import matlab, times
from compasslib.readers.delimited import read_table
from compasslib.types import Floats

ROLES = ("time", "heading", "upper_east", "upper_north", "lower_east", "lower_north")
ADVICE = "correct fit.columns in the mooring file"
LARGEST_DATENUM = 8.0e5  # year 2190; seconds since 1970 are larger


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times in a MATLAB file may be datenum or seconds since 1970.

    Raises:
        InputError: the file or a column is missing, or cannot be read within the limits of raw files.
    """
    if path.suffix.lower() != ".mat":
        return read_table(path, columns, ADVICE).columns
    variables = matlab.load(path)
    series = {role: np.atleast_1d(matlab.find_numbers(path, variables, name, role)) for role, name in columns.items()}
    if len({values.shape for values in series.values()}) != 1 or series["time"].ndim > 1:
        shapes = (f"{columns[role]} {' x '.join(map(str, values.shape))}" for role, values in series.items())
        expected = "series of one length, 1 x n or n x 1"
        raise InputError(str(path), expected=expected, found=", ".join(shapes), advice=ADVICE)
    scale = "datenum" if np.nanmin(series["time"], initial=np.inf) < LARGEST_DATENUM else "epoch"
    try:
        series["time"], _ = times.from_numbers(series["time"], scale)
    except times.Unreadable as error:
        where, expected = f"{path}: {columns['time']}", "times as datenum or as seconds since 1970"
        raise InputError(where, expected=expected, found=error.shown, advice=ADVICE) from None
    return series
