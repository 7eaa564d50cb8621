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
from compasslib.readers import vocabulary
from compasslib.readers.delimited import COLUMN_MAP, Layout, Table, read_table, table_notes
from compasslib.records import GOOD, MISSING, PROBABLY_BAD, Record, new_record
from compasslib.types import Bools, Floats

MAGNETIC, TRUE = "magnetic", "true"
SERIES = {  # role -> field of a record
    "tilt_x": "pitch_deg", "tilt_y": "roll_deg", "pressure": "pressure_dbar", "depth": "depth_m",
    "temperature": "temperature_c",
}  # fmt: skip
FLOW_FLAGS = ("flag", "flag_time", *(f"flag_{role}" for role in (*vocabulary.FLOWS, "direction")))
LOSSES = {
    "rows_repeated": "rows repeat time and depth of another and were left out",
    "rows_contradict": "rows repeat time and depth of another with other values; none of them was used",
    "directions_impossible": "headings or directions are no angles and count as missing",
    "values_flagged": "pressures, depths, tilts or temperatures are flagged as bad and count as missing",
    "fillers": "fill values (speeds of nines only, or powers of ten) count as missing",
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
        columns: role -> header or number, and ``scale``, the factor of velocities to m/s, by default that of the unit
            in headers or unit lines, else 1; x is forward, y to port.
        **layout: fields of ``delimited.Layout``.

    Raises:
        InputError: a file or a column is missing, a time or number cannot be parsed, or the table contradicts
            ``scale`` or ``direction_reference``.
    """
    headers = {role: column for role, column in columns.items() if role != "scale" and column is not None}
    if not {"time", "date"} & headers.keys():
        shown, advice = ", ".join(headers), "write for example time: time_utc"
        raise InputError("columns", "the column of the time, or those of date and clock", shown, advice)
    known, form = vocabulary.parse_flag_settings(flags), Layout.from_settings(layout)
    tables = [read_table(path, headers, COLUMN_MAP, form, known) for path in paths]
    return to_record(paths, tables, columns.get("scale"), direction_reference)


def to_record(
    paths: Sequence[Path], files: Sequence[Table], stated_scale: float | None, direction_reference: str | None
) -> Record:
    """Convert the tables of one instrument to a record; arguments and errors as for ``read``."""
    scale, reference, said = _stated(paths, files, stated_scale, direction_reference)
    tables = [_in_units(file, said) for file in files]
    tables.sort(key=lambda table: float(np.nanmin(table["time"], initial=np.inf)))  # files may be listed in any order
    table = {role: np.concatenate([each[role] for each in tables]) for role in tables[0]}
    cut = sum(file.cut for file in files)
    counts = {"rows": sum(file.rows for file in files) + cut, "rows_cut": cut} | _remove_invalid(table)
    keep, counts["rows_repeated"], counts["rows_contradict"] = _unrepeated(table)
    order, counts["rows_sorted"] = _order({role: column[keep] for role, column in table.items()})
    table = {role: column[keep][order] for role, column in table.items()}

    # Rows with the same time as the previous row are further bins of its sample.
    new = np.append(True, np.diff(table["time"]) != 0.0)[: len(table["time"])]
    first, row = np.flatnonzero(new), np.cumsum(new) - 1
    cell = np.arange(len(row)) - first[row]
    shape = len(first), int(cell.max(initial=0)) + 1

    def spread(values: Floats) -> Floats:
        grid = np.full(shape, np.nan)
        grid[row, cell] = values
        return grid

    if "east" in table:
        components = table["east"], table["north"]
    elif "speed" in table:
        components = angles.components(table["speed"], table["direction"])
    else:
        components = angles.turn(-table["y"], table["x"], table["heading"])
    of_flow = [table[role] for role in FLOW_FLAGS if role in table]
    level = table.get("depth", table.get("pressure", np.zeros(len(row))))
    series = {field: table[role][first] for role, field in SERIES.items() if role in table}
    if "heading" in table:
        heading = table["heading"][first]
        series["heading_deg"] = np.where(np.isfinite(heading), angles.wrap360(heading), np.nan)
        series["heading_quality"] = table.get("flag_heading", np.full(len(row), GOOD))[first]
    if of_flow:
        worst = vocabulary.worst_flag([flag.astype(int) for flag in of_flow])
        series["quality"] = np.nan_to_num(spread(worst.astype(float)), nan=MISSING)
    lost = [f"{counts[key]} {text}" for key, text in LOSSES.items() if counts[key]]
    return new_record(
        table["time"][first],
        *(spread(scale * component) for component in components),
        bin_range_m=spread(level - level[first][row]) if shape[1] > 1 else np.zeros(shape),
        **series,
        looks_up=False,
        direction_reference=reference,
        counts=counts,
        warnings=(*table_notes(files), *dict.fromkeys(said), *lost),
    )


def _stated(
    paths: Sequence[Path], files: Sequence[Table], scale: str | float | None, reference: str | None
) -> tuple[float, str, list[str]]:
    """Determine the factor of velocities and the north of directions, and say which of them the table decides."""
    said = []
    factor = None if scale is None else float(scale)
    for path, file in zip(paths, files, strict=True):
        for role in (role for role in vocabulary.FLOWS if role in file.said):
            found = vocabulary.stated_factor(role, file.said[role])
            if found and factor is not None and not np.isclose(found[0], factor):
                raise InputError(
                    f"{path}: column {file.said[role][0]!r}",
                    expected=f"velocities of which one is {factor:g} m/s",
                    found=found[1],
                    advice="correct scale" if scale is not None else "write velocities in one unit",
                )
            if found and factor is None:
                factor = found[0]
                said += [f"velocities were multiplied by {factor:.6g}, as they are in {found[1]}"] * (factor != 1.0)
        north = vocabulary.stated_north(file.said)
        if north and reference not in (None, north):
            expected, advice = f"directions from {reference} north", f"write direction_reference: '{north}'"
            raise InputError(f"{path}: headers and units", expected=expected, found=f"{north} north", advice=advice)
        reference = north or reference
    said += ["directions count from true north, as the table says"] * (reference == TRUE and north == TRUE)
    return 1.0 if factor is None else factor, reference or MAGNETIC, said


def _in_units(file: Table, said: list[str]) -> dict[str, Floats]:
    """Convert the columns of a table other than velocities to the units of records, by headers and unit lines."""
    columns = dict(file.columns)
    for role in vocabulary.FACTORS.keys() & columns.keys() - {*vocabulary.FLOWS}:
        if found := vocabulary.stated_factor(role, file.said[role]):
            shift = vocabulary.ZERO_CELSIUS if role == "temperature" and found[1] in vocabulary.KELVIN else 0.0
            columns[role] = found[0] * columns[role] - shift
            said += [f"{role} was converted from {found[1]}"] * (found[0] != 1.0 or shift > 0.0)
    return columns


def _remove_invalid(table: dict[str, Floats]) -> dict[str, int]:
    """Set fill values, invalid angles and flagged series to NaN in place, and count them."""
    angle_roles = [role for role in ("heading", "direction") if role in table]
    invalid = {role: (table[role] < -180.0) | (table[role] > 360.0) for role in angle_roles}
    flagged = {role: table[flag] >= PROBABLY_BAD for role in SERIES if (flag := f"flag_{role}") in table}
    filled = _fillers(table)
    for role, wrong in (invalid | flagged | {role: filled for role in vocabulary.FLOWS if role in table}).items():
        table[role] = np.where(wrong, np.nan, table[role])
    return {
        "directions_impossible": int(sum(wrong.sum() for wrong in invalid.values())),
        "values_flagged": int(sum(wrong.sum() for wrong in flagged.values())),
        "fillers": int(filled.sum()),
    }


def _fillers(table: Mapping[str, Floats], far: float = 2.0) -> Bools:
    """Flag rows whose velocity is a fill value: of nines only, such as -99.9 or 9999, or a large power of ten.

    It is repeated, and both components hold it or it exceeds the largest measured speed by a factor ``far``; once is
    enough where both apply.
    """
    speeds = [table[role] for role in vocabulary.FLOWS if role in table]
    known = [(10.0**n - 1.0) / 10.0**k for n in range(2, 7) for k in range(n) if (n, k) != (2, 0)]  # 9.9, 999, 99.9 ...
    known += [1e5, 1e6, 1e34, 1e35, 1e36]
    nines = [np.isin(np.abs(column), known) for column in speeds]
    both = np.logical_and.reduce(nines) & (speeds[0] == speeds[-1]) & (len(speeds) > 1)
    candidates, alone = [both], np.zeros_like(both)
    for column, nine in zip(speeds, nines, strict=True):
        if nine.any():
            others = np.abs(column[~nine & np.isfinite(column)])
            candidates.append(nine & (np.abs(column) > far * others.max(initial=0.0)))
            alone |= both & candidates[-1]
    return np.logical_or.reduce([rows for rows in candidates if rows.sum() > 1] + [alone])


def _unrepeated(table: Mapping[str, Floats]) -> tuple[Any, int, int]:
    """Select one of several equal rows, and none that differ at one time and depth; count both kinds of loss."""
    time_s = table["time"]
    if (np.diff(time_s) > 0.0).all():
        return slice(None), 0, 0
    level = np.nan_to_num(table.get("depth", table.get("pressure", np.zeros(len(time_s)))))
    order = np.lexsort((level, time_s))
    if not ((np.diff(time_s[order]) == 0.0) & (np.diff(level[order]) == 0.0)).any():
        return slice(None), 0, 0
    rows = np.nan_to_num(np.column_stack([time_s, level, *table.values()]), nan=np.inf)
    _, distinct = np.unique(rows, axis=0, return_index=True)
    _, which, size = np.unique(rows[distinct, :2], axis=0, return_inverse=True, return_counts=True)
    alone = distinct[size[which.ravel()] == 1]
    return np.sort(alone), len(rows) - len(distinct), len(distinct) - len(alone)


def _order(table: Mapping[str, Floats], unordered: float = 0.1, by_level: float = 0.75) -> tuple[Any, int]:
    """Find the order in time of rows that are listed newest first, level by level or unordered; count the last's steps.

    A few steps back (a share up to ``unordered``) are a clock adjustment, left to the checks of the deployment. Rows
    are listed level by level if few runs of equal time have a time of their own (a share up to ``by_level``).
    """
    steps = np.diff(table["time"])
    back, groups = int((steps < 0.0).sum()), int((steps != 0.0).sum()) + 1
    mixed = back > unordered * (groups - 1)
    levels = {"depth", "pressure"} & {*table} and len(np.unique(table["time"])) <= by_level * groups
    if not back or not (mixed or levels):
        return slice(None), 0
    return np.argsort(table["time"], kind="stable"), back if mixed and (steps > 0.0).any() else 0


def read_series(covariate: Mapping[str, Any]) -> tuple[Floats, Floats, tuple[str, ...]]:
    """Read the tables of a covariate: increasing UTC seconds since 1970 and finite values, (n,) each, and notes.

    Rows of equal time are merged if their values agree, and dropped otherwise.

    Args:
        covariate: section of the mooring file: files, columns (time or date and clock, value) and the keys of tables.

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
