"""Which way a profiler looked, by the echo of the surface or of the bottom, where that can be told.

Overhead, or straight below, a boundary at the distance h is met by the side lobes first, in the bin at h cos(beam
angle), and by the beams themselves in the bin at h.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.records import Record

Floats = NDArray[np.floating]
Bools = NDArray[np.bool_]

BEYOND = 1.05  # of the distance: tilts, depths and the speed of sound are known to that
CLEARLY = 1.2  # of the distance; water heard from beyond that would have followed the boundary's own echo
MOST, FEW = 0.5, 0.05  # of the samples that show a boundary, or that would
ENOUGH = 24  # samples before anything is said
SOME = 100  # rows of bins that tell the length of a cell


def checked(record: Record, water_depth: float) -> Record:
    """Return the record with samples counted whose echo shows surface or bottom, and a wrong orientation said.

    Nothing is said where no echo was recorded, where neither boundary is near enough to be heard, or where both stand
    at one distance.

    Args:
        record: n samples of a profiler inside the deployment, depth known.
        water_depth: metres.
    """
    if record.echo_range_m is None or not len(record.time_s):
        return replace(record, echo_range_m=None)
    boundary, heard = record.echo_range_m.T
    below = water_depth - record.depth_m
    room, other = (record.depth_m, below) if record.looks_up else (below, record.depth_m)
    right, wrong = _at(boundary, room, record), _at(boundary, other, record)
    with np.errstate(invalid="ignore"):
        near = room < record.bin_range_m[:, :2].max(axis=1)  # within the first bins it stands out from nothing
        absent = np.isnan(boundary) & (heard > CLEARLY * room) & ~near
    names = ("echo_of_boundary", "echo_of_other_boundary", "echo_without_boundary")
    counts = {name: int(where.sum()) for name, where in zip(names, (right, wrong & ~right, absent), strict=True)}
    notes = _sentences(record, counts, room, other)
    return replace(record, echo_range_m=None, counts=record.counts | counts, warnings=(*record.warnings, *notes))


def _at(boundary: Floats, room: Floats, record: Record) -> Bools:
    """Tell samples whose boundary stands where this one should."""
    steps = np.diff(record.bin_range_m[:: 1 + len(room) // SOME])
    cell = float(np.median(known)) if (known := steps[np.isfinite(steps)]).size else 0.0
    with np.errstate(invalid="ignore"):
        above = boundary >= room * angles.sin_cos(record.beam_angle_deg)[1] / BEYOND - cell
        return np.asarray(above & (boundary <= room * BEYOND + cell))


def _sentences(record: Record, counts: dict[str, int], room: Floats, other: Floats) -> list[str]:
    right, wrong, absent = counts.values()
    told = right + wrong + absent
    if told < max(ENOUGH, MOST * len(record.time_s)) or right > FEW * told:
        return []
    own, opposite = ("surface", "bottom") if record.looks_up else ("bottom", "surface")
    where = f"the {own}, {np.nanmedian(room):.0f} m away"
    advice = "check orientation, depth and water_depth"
    if wrong > MOST * told:
        shown = f"{wrong} samples show the echo of the {opposite}, {np.nanmedian(other):.0f} m away"
        return [f"{shown}, and {right} that of {where}: it looked the other way; {advice}"]
    if absent > MOST * told:
        return [f"{absent} samples heard water from beyond {where}, and {right} its echo: {advice}"]
    return []
