"""Ready-made pairs at the samples of the affected instrument's record."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from compasslib import angles, earthfield
from compasslib.preparation.gridding import nearest_index
from compasslib.preparation.pairs import check_pairs, find_identical_velocities
from compasslib.records import BAD, EarthField, Pairs, Record, take
from compasslib.types import Floats

AGREEING_DEG = 5.0  # median difference of headings beyond which the pairs are of another record


def match_ready_pairs(columns: Mapping[str, Floats], scale: float, record: Record, field: EarthField) -> Pairs:
    """Place ready-made pairs at the nearest samples of the record; those farther off than half a sample are left out.

    Depths and separations are unknown. Both velocities refer to one north, whichever that is.

    Args:
        columns: time (UTC seconds), heading, velocities of both instruments by their role, (n,) each.
        scale: turns the velocities into m/s.
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
