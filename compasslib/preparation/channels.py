"""Other series beside a record: what a user gives is brought to the instrument's times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from compasslib.core.errors import InputError
from compasslib.core.records import Record
from compasslib.core.types import Floats
from compasslib.readers.cells import columns_of

LONGEST_GAP = 3.0  # usual steps of the series over which it is read between two values


def beside(record: Record, series: Mapping[str, Mapping[str, Any]]) -> Record:
    """Return a record with other series at its times, missing where they do not reach.

    Args:
        series: files, columns (time, value) and unit of each, by name.

    Raises:
        InputError: a table cannot be read, or holds nothing at the record's times.
    """
    found = {name: _at(record, name, **one) for name, one in series.items()}
    units = {name: str(one["unit"]) for name, one in series.items()}
    return replace(record, channels={**record.channels, **found}, channel_units={**record.channel_units, **units})


def _at(record: Record, name: str, files: list[str], columns: Mapping[str, str], unit: str) -> Floats:
    tables = [columns_of(Path(file), columns) for file in files]
    time_s, value = (np.concatenate([table[role] for table in tables]) for role in ("time", "value"))
    known = np.isfinite(time_s + value)
    time_s, first = np.unique(time_s[known], return_index=True)
    value = value[known][first]
    at = interpolated(record.time_s, time_s, value)
    if len(at) and not np.isfinite(at).any():
        span = "nothing" if not len(time_s) else " to ".join(str(np.datetime64(int(t), "s")) for t in time_s[[0, -1]])
        raise InputError(
            ", ".join(files),
            expected=f"values of {name} while the mooring was deployed",
            found=span,
            advice="check times and columns, or delete the covariate",
        )
    return at


def interpolated(at_s: Floats, time_s: Floats, value: Floats) -> Floats:
    """Return a series at other times, NaN outside of it and in its gaps, (n,).

    Args:
        at_s: (n,) wanted.
        time_s: (k,) increasing.
        value: (k,).
    """
    if len(time_s) < 2:
        return np.full(len(at_s), np.nan)
    steps = np.diff(time_s)
    after = np.clip(np.searchsorted(time_s, at_s), 1, len(time_s) - 1)
    inside = (at_s >= time_s[0]) & (at_s <= time_s[-1]) & (steps[after - 1] <= LONGEST_GAP * np.median(steps))
    return np.where(inside, np.interp(at_s, time_s, value), np.nan)
