"""Columns of headings that hold copies of themselves, or no degrees of a full circle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from compasslib.records import PROBABLY_BAD, Record, iso_time
from compasslib.types import Bools

SEQUENCE, DISTINCT = 12, 8  # length of the sequences compared, and fewest distinct readings in them
# Ranges other than the circle, from 0: width of their ends as a share of the range, fewest headings there, causes.
RANGE_END, RANGE_END_COUNT = 1 / 90, 5
RANGES = {
    180.0: "half of the circle was folded on the other (modulo 180, halved, or without a sign)",
    6.29: "they are radians",
}


def flag_column(record: Record) -> Record:
    """Flag as doubtful headings that occur twice in the same sequence, and all that fill half a circle or radians."""
    later = np.diff(np.maximum.accumulate(record.time_s), prepend=-np.inf) > 0.0  # a sample given twice is no copy
    known = np.flatnonzero(later & np.isfinite(record.heading_deg) & (record.heading_quality < PROBABLY_BAD))
    heading, doubtful = record.heading_deg[known], np.zeros(record.heading_deg.shape, dtype=bool)
    if len(known) < SEQUENCE:
        return record
    for full, cause in RANGES.items():
        ends = [np.count_nonzero(np.abs(heading - end) <= RANGE_END * full) for end in (0.0, full)]
        if heading.max() <= full and min(ends) >= RANGE_END_COUNT:
            doubtful[known] = True
            note = f"all recorded headings lie between 0 and {full:.4g}, up to both limits: {cause}, all are doubtful"
            return flag_headings(record, doubtful, f"{note}; check the column of headings")
    # A working compass that turns does not repeat a sequence of readings to the last digit.
    runs = np.lib.stride_tricks.sliding_window_view(heading.round(2), SEQUENCE)
    varied = np.flatnonzero(np.count_nonzero(np.diff(np.sort(runs, axis=1), axis=1), axis=1) + 1 >= DISTINCT)
    _, index, count = np.unique(runs[varied], axis=0, return_inverse=True, return_counts=True)
    begins = varied[count[index.ravel()] > 1]
    doubtful[known[(begins[:, None] + np.arange(SEQUENCE)).ravel()]] = True
    if not doubtful.any():
        return record
    first, last = (iso_time(when) for when in record.time_s[doubtful][[0, -1]])
    note = (
        f"{int(doubtful.sum())} recorded headings between {first} and {last} repeat others to the last digit: part of "
        "the record was copied, and both places are flagged doubtful"
    )
    return flag_headings(record, doubtful, note)


def flag_headings(record: Record, which: Bools, *notes: str) -> Record:
    """Flag the selected headings as doubtful unless already worse, and add notes to the warnings."""
    flags = np.where(which & (record.heading_quality < PROBABLY_BAD), PROBABLY_BAD, record.heading_quality)
    return replace(record, heading_quality=flags.astype(np.int8), warnings=record.warnings + notes)
