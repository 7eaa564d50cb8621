"""Other series beside a record: what a user gives at the instrument's times, and what its own magnetometer saw."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers import table
from compasslib.records import MAGNETOMETER, Record
from compasslib.types import Floats

FIELD_STRENGTH = "field_strength"
FEWEST = 100  # samples of a magnetometer beside heading and tilt
LONGEST_GAP = 3.0  # usual steps of the series over which it is read between two values


def beside(record: Record, series: Mapping[str, Mapping[str, Any]]) -> Record:
    """Return a record with other series at its times, missing where they do not reach.

    Args:
        series: the part of the mooring file of each, by name.

    Raises:
        InputError: a table cannot be read, or holds nothing at the record's times.
    """
    read = {name: _at(record, name, one) for name, one in series.items()}
    units = {name: str(one["unit"] or "1") for name, one in series.items()}
    return replace(
        record,
        channels={**record.channels, **{name: values for name, (values, _) in read.items()}},
        channel_units={**record.channel_units, **units},
        warnings=(*record.warnings, *(f"{name}: {note}" for name, (_, notes) in read.items() for note in notes)),
    )


def witnessed(record: Record) -> Record:
    """Return a record with the change of the field's strength, percent, where the instrument logged its magnetometer.

    What follows the heading, twice the heading or the tilts is taken off: it is iron and scales at the sensor, which a
    fit of the headings knows already. The axes themselves are the heading once more.
    """
    if not set(MAGNETOMETER) <= set(record.channels):
        return record
    size = np.linalg.norm([record.channels[axis] for axis in MAGNETOMETER], axis=0)
    waves = [wave for k in (1.0, 2.0) for wave in angles.sin_cos(k * record.heading_deg)]
    columns = np.column_stack([np.ones(len(size)), *waves, record.pitch_deg, record.roll_deg])
    known = np.isfinite(size + columns.sum(axis=1))
    if known.sum() < FEWEST or not np.any(size[known]):
        return record
    percent = 100.0 * size / np.median(size[known])
    percent = np.where(
        known, percent - columns @ np.linalg.lstsq(columns[known], percent[known], rcond=None)[0], np.nan
    )
    note = (
        f"Beyond what follows heading and tilt, its own magnetometer saw the field's strength change by "
        f"{np.nanstd(percent):.2f} % rms; the search looks along it for effects."
    )
    return replace(
        record,
        channels={**record.channels, FIELD_STRENGTH: percent},
        channel_units={**record.channel_units, FIELD_STRENGTH: "percent"},
        warnings=(*record.warnings, note),
    )


def _at(record: Record, name: str, one: Mapping[str, Any]) -> tuple[Floats, tuple[str, ...]]:
    time_s, value, notes = table.read_series(one)
    at = interpolated(record.time_s, time_s, value)
    if len(at) and not np.isfinite(at).any():
        span = " to ".join(str(np.datetime64(int(t), "s")) for t in time_s[[0, -1]])
        raise InputError(
            ", ".join(one["files"]),
            expected=f"values of {name} while the mooring was deployed",
            found=span,
            advice="check times and columns, or delete the covariate",
        )
    return at, notes


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
