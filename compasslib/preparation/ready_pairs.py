"""Pairs that others made: read from a table or MATLAB file, at the samples of the affected instrument's record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles, earthfield
from compasslib.errors import InputError
from compasslib.preparation.gridding import nearest_index
from compasslib.preparation.pairs import check_pairs, find_identical_velocities
from compasslib.readers.delimited import read_table
from compasslib.records import BAD, EarthField, Pairs, Record, take
from compasslib.types import DAY_S, Floats

AGREEING_DEG = 5.0  # median difference of headings beyond which the pairs are of another record


def match_ready_pairs(columns: Mapping[str, Floats], scale: float, record: Record, field: EarthField) -> Pairs:
    """Place ready-made pairs at the nearest samples of the record; those farther off than half a sample are left out.

    Depths and separations are unknown. Both velocities refer to one north, whichever that is.

    Args:
        columns: time (UTC seconds), heading, velocities of both instruments by their role, (n,) each.
        record: the affected instrument inside the deployment.
    """
    order = np.argsort(columns["time"], kind="stable")
    rows = {role: column[order] for role, column in columns.items()}
    known = np.all([np.isfinite(column) for column in rows.values()], axis=0)
    rows = {role: column[known] for role, column in rows.items()}
    n, samples = int(known.sum()), record.time_s
    near, at = np.zeros(n, dtype=bool), np.zeros(n, dtype=np.intp)
    if len(samples) > 1:
        at = nearest_index(samples, rows["time"])
        near = np.abs(samples[at] - rows["time"]) <= 0.5 * np.median(np.diff(samples))
        near &= np.diff(at, prepend=-1) > 0  # one pair a sample, the first
    rows, at = {role: column[near] for role, column in rows.items()}, at[near]
    unknown = np.full(len(at), np.nan)
    pairs = Pairs(
        time_s=samples[at],
        heading_deg=angles.wrap360(rows["heading"]),
        pitch_deg=record.pitch_deg[at],
        roll_deg=record.roll_deg[at],
        upper_east=scale * rows["upper_east"],
        upper_north=scale * rows["upper_north"],
        lower_east=scale * rows["lower_east"],
        lower_north=scale * rows["lower_north"],
        upper_depth_m=unknown,
        lower_depth_m=unknown,
        separation_minutes=unknown,
        declination_deg=earthfield.declination_at(field, samples[at]),
    )
    flows = np.hypot(pairs.upper_east, pairs.upper_north), np.hypot(pairs.lower_east, pairs.lower_north)
    pairs = take(pairs, (flows[0] > 0.0) & (flows[1] > 0.0) & (record.heading_quality[at] < BAD))
    if reason := find_identical_velocities(pairs):
        return replace(take(pairs, np.zeros(0, dtype=np.intp)), warnings=(reason,))
    pairs = check_pairs(pairs, record, [])
    left_out = n - len(pairs)
    notes = [f"{left_out} of {n} ready-made pairs lie at no usable sample of the record"] * bool(left_out)
    off = angles.difference(pairs.heading_deg, record.heading_deg[np.searchsorted(samples, pairs.time_s)])
    if len(pairs) and (size := float(np.median(np.abs(off)))) > AGREEING_DEG:
        notes.append(
            f"headings of the ready-made pairs differ from the record's by {size:.0f}° in the median: check times and "
            "headings of both"
        )
    return replace(pairs, warnings=(*pairs.warnings, *notes))


ROLES = ("time", "heading", "upper_east", "upper_north", "lower_east", "lower_north")
ADVICE = "correct fit.columns in the mooring file"
DATENUM_OF_1970 = 719529.0
DATENUMS = (6.5e5, 8.0e5)  # years 1780 to 2190; seconds since 1970 are beyond
HDF5 = b"\x89HDF"  # after the text header of 512 bytes in a MATLAB 7.3 file
HDF5_AT = 512


def read_ready_pairs(path: Path, columns: Mapping[str, str]) -> dict[str, Floats]:
    """Read time (UTC seconds since 1970), heading (degrees) and velocities (in the file's unit), (n,) each.

    Times of a MATLAB file are datenum or seconds since 1970.

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
    try:
        with h5py.File(path) as file:
            return {name: item[()] for name, item in file.items() if isinstance(item, h5py.Dataset)}
    except OSError as error:
        advice = "copy it again from where it was made"
        raise InputError(str(path), expected="a whole MATLAB file", found=error, advice=advice) from error
