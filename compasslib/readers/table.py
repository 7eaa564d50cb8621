"""Read text tables with a header line: decoded data of current meters and profilers, and time series of covariates.

The column map of the mooring file assigns columns to roles. Consecutive rows of equal time become bins of one sample.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers import flags as vocabularies
from compasslib.readers import units
from compasslib.readers.delimited import COLUMN_MAP, Layout, Table, read_table, table_notes
from compasslib.records import GOOD, MISSING, PROBABLY_BAD, Record, new_record
from compasslib.types import Bools, Floats

MAGNETIC, TRUE = "magnetic", "true"
SERIES = {  # role -> field of a record
    "tilt_x": "pitch_deg", "tilt_y": "roll_deg", "pressure": "pressure_dbar", "depth": "depth_m",
    "temperature": "temperature_c",
}  # fmt: skip
LOSSES = {
    "rows_cut": "last lines were cut short and left out",
    "rows_repeated": "rows repeat time and depth of another and were left out",
    "rows_contradict": "rows repeat time and depth of another with other values; none of them was used",
    "directions_impossible": "headings or directions are no angles and count as missing",
    "values_flagged": "pressures, depths, tilts or temperatures are flagged as bad and count as missing",
    "fillers": "fill values (speeds of nines only) count as missing",
    "rows_sorted": "rows are earlier than the one before; all were put in order: check the form of the times",
}


def read(
    paths: Sequence[Path],
    *,
    columns: Mapping[str, Any],
    flags: Mapping[str, Sequence[object]] | None = None,
    direction_reference: str | None = None,
    **layout: Any,
) -> Record:
    """Read one record from one or several tables, sorted by their first times.

    Args:
        columns: role -> header or number: time (several: its parts), or date and clock; depth or pressure; east+north,
            speed+direction, or x+y+heading (x forward, y to port); tilt_x, tilt_y, temperature; flag. ``scale`` is the
            factor of velocities to m/s, by default that of the unit in headers or unit lines, else 1.
        flags: good, bad and unchecked -> flag meanings or values that are in no known vocabulary.
        direction_reference: magnetic or true; None uses that stated in headers or unit lines, else magnetic.
        **layout: format of the files, by the fields of ``delimited.Layout``.

    Raises:
        InputError: a file or a column is missing, a time or number cannot be parsed, or the table contradicts
            ``scale`` or ``direction_reference``.
    """
    headers = {role: column for role, column in columns.items() if role != "scale" and column is not None}
    known, form = vocabularies.parse_flag_settings(flags), Layout.from_settings(layout)
    tables = [read_table(path, headers, COLUMN_MAP, form, known) for path in paths]
    return to_record(paths, tables, columns.get("scale"), direction_reference)


def to_record(
    paths: Sequence[Path], files: Sequence[Table], stated_scale: float | None, direction_reference: str | None
) -> Record:
    """Convert the tables of one instrument to a record; arguments and errors as for ``read``."""
    scale, reference, said = _stated(paths, files, stated_scale, direction_reference)
    # The files may be listed in any order.
    tables = sorted(
        (_in_units(file, said) for file in files), key=lambda table: float(np.nanmin(table["time"], initial=np.inf))
    )
    rows, cut = sum(file.rows for file in files), sum(file.cut for file in files)
    joined = {role: np.concatenate([table[role] for table in tables]) for role in tables[0]}
    table, counts = _clean(joined, {"rows": rows + cut, "rows_cut": cut})
    table, counts["rows_sorted"] = _sort_rows(table)
    samples = _Grid(table.pop("time"))
    n, m = len(samples.first), int(samples.bin.max(initial=0)) + 1
    if "east" in table:
        components = table["east"], table["north"]
    elif "speed" in table:
        components = angles.components(table["speed"], table["direction"])
    else:
        components = angles.turn(-table["y"], table["x"], table["heading"])
    east, north = (_spread(scale * x, samples, (n, m)) for x in components)
    of_flow = ["flag", "flag_time", *(f"flag_{role}" for role in (*units.FLOWS, "direction"))]
    quality = vocabularies.worst_flag([GOOD, *(table[role].astype(int) for role in of_flow if role in table)])
    series = {role: values[samples.first] for role, values in table.items()}
    if (heading := series.get("heading")) is not None:
        series["heading"] = np.where(np.isfinite(heading), angles.wrap360(heading), np.nan)
    return new_record(
        samples.time_s,
        east,
        north,
        bin_range_m=_ranges(table, samples, (n, m)),
        heading_quality=series.get("flag_heading", GOOD),
        **{field: series[role] for role, field in (SERIES | {"heading": "heading_deg"}).items() if role in series},
        quality=quality
        if not quality.ndim
        else np.nan_to_num(_spread(quality.astype(float), samples, (n, m)), nan=MISSING),
        looks_up=False,
        direction_reference=reference,
        counts=counts,
        warnings=(
            *table_notes(files),
            *dict.fromkeys(said),
            *(f"{counts[key]} {text}" for key, text in LOSSES.items() if counts[key]),
        ),
    )


def _stated(
    paths: Sequence[Path], files: Sequence[Table], scale: str | float | None, reference: str | None
) -> tuple[float, str, list[str]]:
    """Determine the factor of velocities and the north of directions, and say which of them the table decides.

    Raises:
        InputError: headers and unit lines contradict the keys or each other.
    """
    said = []
    factor = None if scale is None else float(scale)
    for path, file in zip(paths, files, strict=True):
        for role in (role for role in units.FLOWS if role in file.said):
            found = units.stated_factor(role, file.said[role])
            if found and factor is not None and not np.isclose(found[0], factor):
                expected = f"velocities of which one is {factor:g} m/s" + ", as scale says" * (scale is not None)
                advice = "correct scale" if scale is not None else "write velocities in one unit"
                raise InputError(
                    f"{path}: column {file.said[role][0]!r}", expected=expected, found=found[1], advice=advice
                )
            if found and factor is None:
                factor = found[0]
                said += [f"velocities were multiplied by {factor:.6g}, as they are in {found[1]}"] * (factor != 1.0)
        north = units.stated_north(file.said)
        if north and reference not in (None, north):
            expected, advice = f"directions from {reference} north", f"write direction_reference: '{north}'"
            raise InputError(f"{path}: headers and units", expected=expected, found=f"{north} north", advice=advice)
        reference = north or reference
    said += ["directions count from true north, as the table says"] * (reference == TRUE and north == TRUE)
    return 1.0 if factor is None else factor, reference or MAGNETIC, said


def _in_units(file: Table, said: list[str]) -> dict[str, Floats]:
    """Convert the columns of a table other than velocities to the units of records, by headers and unit lines."""
    columns = dict(file.columns)
    for role in units.FACTORS.keys() & columns.keys() - {*units.FLOWS}:
        if found := units.stated_factor(role, file.said[role]):
            shift = units.ZERO_CELSIUS if role == "temperature" and found[1] in units.KELVIN else 0.0
            columns[role] = found[0] * columns[role] - shift
            said += [f"{role} was converted from {found[1]}"] * (found[0] != 1.0 or shift > 0.0)
    return columns


def _clean(table: dict[str, Floats], counts: dict[str, int]) -> tuple[dict[str, Floats], dict[str, int]]:
    """Set fill values, invalid angles and flagged series to NaN, drop repeated rows, and count what is removed."""
    filled = _fillers(table)
    with np.errstate(invalid="ignore"):
        directions = {role: table[role] for role in ("heading", "direction") if role in table}
        wrong = {role: (degrees < -180.0) | (degrees > 360.0) for role, degrees in directions.items()}
    flagged = {role: table[flag] >= PROBABLY_BAD for role in SERIES if (flag := f"flag_{role}") in table}
    blank = {role: filled for role in units.FLOWS if role in table} | wrong | flagged
    table = {role: np.where(blank[role], np.nan, x) if role in blank else x for role, x in table.items()}
    keep, repeated, contradict = _first_of_repeated(table)
    if not keep.all():
        table = {role: column[keep] for role, column in table.items()}
    return table, counts | {
        "rows_repeated": repeated,
        "rows_contradict": contradict,
        "directions_impossible": int(sum(where.sum() for where in wrong.values())),
        "values_flagged": int(sum(where.sum() for where in flagged.values())),
        "fillers": int(filled.sum()),
    }


def _sort_rows(
    table: dict[str, Floats], *, unordered: float = 0.1, by_level: float = 0.75
) -> tuple[dict[str, Floats], int]:
    """Sort rows by time if they are listed newest first, level by level or unordered; count the last's steps back.

    A few steps back are a clock adjustment, left to the checks of the deployment.

    Args:
        unordered: share of backward time steps above which rows count as unordered.
        by_level: ratio of distinct times to runs of equal time up to which rows are listed level by level.
    """
    steps = np.diff(table["time"])
    back, groups = int((steps < 0.0).sum()), int((steps != 0.0).sum()) + 1
    mixed = back > unordered * (groups - 1)
    levels = {"depth", "pressure"} & set(table) and len(np.unique(table["time"])) <= by_level * groups
    if not back or not (mixed or levels):
        return table, 0
    order = np.argsort(table["time"], kind="stable")
    return {role: column[order] for role, column in table.items()}, back if mixed and (steps > 0.0).any() else 0


def _fillers(table: Mapping[str, Floats], far: float = 2.0) -> Bools:
    """Flag rows whose velocity is a repeated fill value consisting of nines only, such as -99.9 or 9999.

    Unless both components hold it, it exceeds the largest measured speed by a factor ``far``.
    """
    speeds = [table[role] for role in units.FLOWS if role in table]
    texts = ("9" * whole + ".9"[: 2 * bool(rest)] + "9" * (rest - 1) for whole in range(7) for rest in range(6))
    known = np.unique([float(text) for text in texts if 2 <= text.count("9") <= 6 and len(text) > 2 and text[0] == "9"])
    nines = [np.isin(np.abs(column), known) for column in speeds]
    alike = np.logical_and.reduce(nines) & (speeds[0] == speeds[-1]) & (len(speeds) > 1)
    filled = alike if alike.sum() > 1 else np.zeros(alike.shape, dtype=bool)
    for column, nine in zip(speeds, nines, strict=True):
        if nine.any():
            others = np.abs(column[~nine & np.isfinite(column)])
            beyond = nine & (np.abs(column) > far * others.max(initial=0.0))
            filled = filled | (beyond if beyond.sum() > 1 else False)
    return np.asarray(filled)


def _first_of_repeated(table: Mapping[str, Floats]) -> tuple[Bools, int, int]:
    """Select one of several rows with equal time and depth if they agree, none otherwise; count both kinds of loss."""
    if (np.diff(table["time"]) > 0.0).all():
        return np.ones(len(table["time"]), dtype=bool), 0, 0
    key = np.column_stack([table["time"], np.nan_to_num(table.get("depth", table.get("pressure", 0 * table["time"])))])
    _, first, which, size = np.unique(key, axis=0, return_index=True, return_inverse=True, return_counts=True)
    if (size == 1).all():
        return np.ones(len(key), dtype=bool), 0, 0
    which = which.ravel()
    values = np.column_stack([x for role, x in table.items() if role != "time"])
    same = ((values == values[first[which]]) | (np.isnan(values) & np.isnan(values[first[which]]))).all(axis=1)
    torn = np.bincount(which, ~same)[which] > 0
    keep = ~torn & (np.arange(len(key)) == first[which])
    return keep, int(np.sum(~keep & ~torn)), int(torn.sum())


class _Grid:
    """Sample and bin index of each row; rows with the same time as the previous row are further bins of its sample."""

    def __init__(self, time_s: Floats):
        new = np.append(True, np.diff(time_s) != 0)[: len(time_s)]
        self.first = np.flatnonzero(new)
        self.row = np.cumsum(new) - 1
        self.bin = np.arange(len(time_s)) - self.first[self.row] if len(time_s) else np.zeros(0, dtype=int)
        self.time_s = time_s[self.first]


def _spread(values: Floats, samples: _Grid, shape: tuple[int, int]) -> Floats:
    grid = np.full(shape, np.nan)
    grid[samples.row, samples.bin] = values
    return grid


def _ranges(table: Mapping[str, Floats], samples: _Grid, shape: tuple[int, int]) -> Floats:
    """Compute the depth of each bin below the first bin of its sample, (n, m)."""
    level = table.get("depth", table.get("pressure"))
    if level is None or shape[1] == 1:
        return np.zeros(shape)
    return _spread(level - level[samples.first][samples.row], samples, shape)


def read_series(covariate: Mapping[str, Any]) -> tuple[Floats, Floats, tuple[str, ...]]:
    """Read the tables of a covariate: increasing UTC seconds since 1970 and finite values, (n,) each, and notes.

    Rows of equal time are merged if their values agree, and dropped otherwise.

    Args:
        covariate: section of the mooring file, as given by ``Covariate.model_dump``: ``files``, ``columns`` (time or
            date and clock, value) and the keys of tables.

    Raises:
        InputError: a file or a column is missing, a cell cannot be parsed, or no row has both a time and a value.
    """
    headers = {role: header for role, header in covariate["columns"].items() if header is not None}
    paths = [Path(file) for file in covariate["files"]]
    advice = "correct columns of the covariate in the mooring file"
    parts = [read_table(path, headers, advice, Layout.from_settings(covariate)) for path in paths]
    time_s, value = (np.concatenate([part.columns[role] for part in parts]) for role in ("time", "value"))
    known = np.isfinite(time_s) & np.isfinite(value)
    time_s, first, which = np.unique(time_s[known], return_index=True, return_inverse=True)
    values = value[known]
    torn = np.bincount(which, values != values[first][which], minlength=len(time_s)) > 0
    if torn.all():
        expected, advice = "rows with a time and a value", "check columns and missing"
        raise InputError(", ".join(map(str, paths)), expected=expected, found="none", advice=advice)
    return time_s[~torn], values[first][~torn], table_notes(parts)
