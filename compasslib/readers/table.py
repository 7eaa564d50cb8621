"""Comma-separated tables with a header line: current meters and profiles that others have decoded already.

The column map of the mooring file says which column is what. Rows that share a time become the bins of one sample.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.errors import InputError
from compasslib.records import GOOD, MISSING, Record

Floats = NDArray[np.floating]

MISSING_TEXT = frozenset({"", "nan", "na", "n/a", "null", "none", "-"})
COLUMN_MAP = "correct columns in the mooring file"
TIMES = ("time", "time_utc")  # roles that hold times
TIME_FORM = "an ISO time like 2007-09-04T00:00:00Z"


def read(paths: Sequence[Path], *, columns: Mapping[str, str | float]) -> Record:
    """Return the series of one or several tables, in the order given.

    Args:
        paths: CSV files.
        columns: role -> header: time; depth or pressure; east+north, speed+direction, or x+y+heading (x forward, y to
            port); tilt_x, tilt_y, temperature; ``scale`` turns velocities into m/s.

    Raises:
        InputError: a file or a column is absent, or a time or number cannot be read.
    """
    scale = float(columns.get("scale", 1.0))
    headers = {role: str(header) for role, header in columns.items() if role != "scale" and header is not None}
    tables = [columns_of(path, headers) for path in paths]
    table = {role: np.concatenate([t[role] for t in tables]) for role in headers}
    samples = _Samples(table.pop("time"))
    n, m = len(samples.first), int(samples.bin.max(initial=0)) + 1
    east, north = (_spread(scale * x, samples, (n, m)) for x in _east_north(table))
    series = {role: values[samples.first] for role, values in table.items()}
    empty = np.full(n, np.nan)
    heading = series.get("heading", empty)
    return Record(
        time_s=samples.time_s,
        east=east,
        north=north,
        bin_range_m=_ranges(table, samples, (n, m)),
        heading_deg=np.where(np.isfinite(heading), angles.wrap360(heading), np.nan),
        pitch_deg=series.get("tilt_x", empty),
        roll_deg=series.get("tilt_y", empty),
        pressure_dbar=series.get("pressure", empty),
        depth_m=series.get("depth", empty),
        temperature_c=series.get("temperature", empty),
        supply_voltage=empty,
        quality=np.where(np.isfinite(east + north), GOOD, MISSING).astype(np.int8),
        heading_quality=np.where(np.isfinite(heading), GOOD, MISSING).astype(np.int8),
        looks_up=False,
        counts={"rows": len(samples.row), "velocities_missing": int(np.sum(~np.isfinite(east + north)))},
    )


class _Samples:
    """Where each row goes: rows with the same time as the one before are further bins of that sample."""

    def __init__(self, time_s: Floats):
        new = np.append(True, np.diff(time_s) != 0)[: len(time_s)]
        self.first = np.flatnonzero(new)
        self.row = np.cumsum(new) - 1
        self.bin = np.arange(len(time_s)) - self.first[self.row] if len(time_s) else np.zeros(0, dtype=int)
        self.time_s = time_s[self.first]


def _spread(values: Floats, samples: _Samples, shape: tuple[int, int]) -> Floats:
    grid = np.full(shape, np.nan)
    grid[samples.row, samples.bin] = values
    return grid


def _ranges(table: Mapping[str, Floats], samples: _Samples, shape: tuple[int, int]) -> Floats:
    """Return each bin's depth below the first bin of its sample."""
    level = table.get("depth", table.get("pressure"))
    if level is None or shape[1] == 1:
        return np.zeros(shape)
    return _spread(level - level[samples.first][samples.row], samples, shape)


def _east_north(table: Mapping[str, Floats]) -> tuple[Floats, Floats]:
    if "east" in table:
        return table["east"], table["north"]
    if "speed" in table:
        return angles.components(table["speed"], table["direction"])
    return angles.turn(-table["y"], table["x"], table["heading"])


def columns_of(path: Path, headers: Mapping[str, str], advice: str = COLUMN_MAP) -> dict[str, Floats]:
    """Return columns of one table, times as UTC seconds since 1970, nothing as NaN.

    Args:
        path: a CSV file with a header line.
        headers: role -> header; the roles ``time`` and ``time_utc`` hold times, all others numbers.
        advice: what to do where a column is absent.

    Raises:
        InputError: the file or a column is absent, or a time or number cannot be read.
    """
    rows = _rows(path)
    names = rows[0][1] if rows else []
    for role, header in headers.items():
        if header not in names:
            raise InputError(
                f"{path}: column {header!r} ({role})",
                expected="one of the file's columns",
                found=", ".join(names) or "an empty file",
                advice=advice,
            )
    return {role: _parsed(path, rows, names.index(header), role, header) for role, header in headers.items()}


def header_of(path: Path) -> list[str]:
    """Return the names of a table's columns, none for an empty file.

    Args:
        path: a CSV file with a header line.

    Raises:
        InputError: the file cannot be read.
    """
    rows = _rows(path)
    return rows[0][1] if rows else []


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """Return (line number, cells) of every line that is not empty, cells stripped, comments left out."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.reader(stream)
            rows = [(reader.line_num, [cell.strip() for cell in row]) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(
            str(path), expected="a readable CSV file in UTF-8", found=error, advice="check path and format"
        ) from None
    return [(line, row) for line, row in rows if any(row) and not row[0].startswith("#")]


def _parsed(path: Path, rows: list[tuple[int, list[str]]], column: int, role: str, header: str) -> Floats:
    parse = _time if role in TIMES else _number
    expected = TIME_FORM if role in TIMES else "a number or nothing"
    values = np.empty(len(rows) - 1)
    for i, (line, row) in enumerate(rows[1:]):
        try:
            values[i] = parse(row[column])
        except (ValueError, IndexError):
            found = repr(row[column]) if column < len(row) else f"a line of {len(row)} cells"
            raise InputError(
                f"{path}: line {line}, {header}", expected=expected, found=found, advice="mend or remove the line"
            ) from None
    return values


def _number(text: str) -> float:
    return float("nan") if text.lower() in MISSING_TEXT else float(text)


def _time(text: str) -> float:
    return float(np.datetime64(text.removesuffix("Z").replace("/", "-"), "us").astype(np.int64)) / 1e6
