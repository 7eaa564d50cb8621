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


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times in a MATLAB file may be datenum or seconds since 1970.

    Raises:
        InputError: the file or a column is missing, or cannot be read within the limits of raw files.
    """
    if path.suffix.lower() != ".mat":
        return read_table(path, columns, ADVICE).columns
    variables, series = matlab.load(path), dict[str, Floats]()
    for role, name in columns.items():
        values = np.atleast_1d(matlab.find_numbers(path, variables, name, role))
        if values.ndim > 1:
            shown = " x ".join(map(str, values.shape))
            raise InputError(
                f"{path}: {name} ({role})", expected="a series, 1 x n or n x 1", found=shown, advice=ADVICE
            )
        series[role] = values
    if len({len(values) for values in series.values()}) != 1:
        shown = ", ".join(f"{columns[role]} {len(values)}" for role, values in series.items())
        raise InputError(str(path), expected="variables of one length", found=shown, advice=ADVICE)
    try:
        series["time"], _ = times.from_numbers(series["time"])
    except times.Unreadable as error:
        where, expected = f"{path}: {columns['time']}", "times as datenum or as seconds since 1970"
        raise InputError(where, expected=expected, found=error.shown, advice=ADVICE) from None
    return series
