"""Other series beside a record: what a user gives is brought to the instrument's times."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib.core.errors import InputError
from compasslib.core.records import Record
from compasslib.core.types import Floats
from compasslib.readers import covariate

LONGEST_GAP = 3.0  # usual steps of the series over which it is read between two values


def beside(record: Record, series: Mapping[str, Mapping[str, Any]]) -> Record:
    """Return a record with other series at its times, missing where they do not reach.

    Args:
        series: the part of the mooring file of each, by name.

    Raises:
        InputError: a table cannot be read, or holds nothing at the record's times.
    """
    found = {name: _at(record, name, one) for name, one in series.items()}
    units = {name: str(one["unit"] or "1") for name, one in series.items()}
    return replace(record, channels={**record.channels, **found}, channel_units={**record.channel_units, **units})


def _at(record: Record, name: str, one: Mapping[str, Any]) -> Floats:
    time_s, value = covariate.series(one)
    at = interpolated(record.time_s, time_s, value)
    if len(at) and not np.isfinite(at).any():
        span = " to ".join(str(np.datetime64(int(t), "s")) for t in time_s[[0, -1]])
        raise InputError(
            ", ".join(one["files"]),
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
