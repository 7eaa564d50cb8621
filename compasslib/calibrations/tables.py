"""Columns of the tables from which compasses are calibrated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import delimited
from compasslib.types import Floats

ADVICE = "correct columns in the calibration's file"
TWO_TURNS = {"deg": (-720.0, 720.0)}


def read_columns(
    files: Sequence[str | Path],
    settings: Mapping[str, Any],
    needed: Sequence[str],
    optional: Sequence[str] = (),
    *,
    bounds: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Read columns by role, concatenated over the files, and notes on the tables.

    In the settings, ``columns`` gives headers that differ from the roles (``date`` and ``clock`` may replace
    ``time_utc``), ``withhold`` roles or headers to ignore, and the keys of ``delimited.Layout`` the format of the
    tables. An optional column is read if it is named or in all files. Bounds are by unit, with which a role ends.

    Raises:
        InputError: a file or column is absent or withheld, or a value cannot be read or is out of bounds.
    """
    paths, named = [Path(file) for file in files], settings.get("columns") or {}
    layout, withheld = delimited.Layout.from_settings(settings), set(settings.get("withhold") or ())
    headers = {role: str(named.get(role) or role) for role in (*needed, *optional)}
    for role in needed:
        if {role, headers[role]} & withheld:
            expected, actual = "columns that the calibration can do without", f"{role}, which it needs"
            raise InputError("withhold", expected=expected, found=actual, advice="take it out of withhold")
    heads = [delimited.read_head(path, [headers[role] for role in needed], layout) for path in paths]
    there = set.intersection(*(set(head.names) for head in heads))
    wanted = {
        role: header
        for role, header in headers.items()
        if role in needed or (not {role, header} & withheld and (header != role or header in there))
    }
    wanted |= delimited.date_and_clock(named, withheld)
    tables = [delimited.read_table(path, wanted, ADVICE, layout) for path in paths]
    columns = {role: np.concatenate([table.columns[role] for table in tables]) for role in tables[0].columns}
    if "time" in columns:
        columns["time_utc"] = columns.pop("time")
    for role, values in columns.items():
        low, high = bounds.get(role.rpartition("_")[2], (-np.inf, np.inf))
        beyond = values[(values < low) | (values > high)]
        if beyond.size:
            raise InputError(
                f"{', '.join(map(str, paths))}: {role}",
                expected=f"numbers from {low:g} to {high:g}, or nothing",
                found=f"{beyond.size} beyond, {beyond[0]:g} first",
                advice="correct the column or its unit; leave cells without a reading empty",
            )
    return columns, delimited.table_notes(tables)
