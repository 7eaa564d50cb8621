"""Tilts that stick: where they stop to move, and what the tilt then was by how the instrument leaned in the flow."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.preparation import overlap
from compasslib.records import Record
from compasslib.types import Floats

LEANS = ("lean_pitch", "lean_roll")  # names of the series, degrees
NEAR_CELLS = 2  # whose mean is the water at the instrument
SHORTEST_S, FEWEST = 10 * 86400.0, 100  # of a stretch without any change, and of moving tilts beside it
LEARNT = 0.25  # share of the moving tilts' variance that the flow must explain


def leans(record: Record) -> dict[str, Floats]:
    """Return true minus recorded pitch and roll while the tilts stick, (n,) each, 0 elsewhere; nothing if they do not.

    A moored instrument leans with the drag of the water. The flow in its own frame needs no compass, so that what the
    healthy part of the record shows of lean against flow tells the tilt when the sensor no longer does.

    Args:
        record: the affected instrument.
    """
    if not np.isfinite(record.pitch_deg + record.roll_deg).any():
        return {}
    stretch = longest_still(record)
    moving = np.isfinite(record.pitch_deg + record.roll_deg)
    moving[stretch] = False
    if stretch.stop == stretch.start or moving.sum() < FEWEST:
        return {}
    columns, known = _flow(record)
    if (moving & known).sum() < FEWEST:
        return {}
    tilts = np.column_stack([record.pitch_deg, record.roll_deg])
    learnt, *_ = np.linalg.lstsq(columns[moving & known], tilts[moving & known], rcond=None)
    left = tilts[moving & known] - columns[moving & known] @ learnt
    if np.sum(left.var(axis=0)) > (1.0 - LEARNT) * np.sum(tilts[moving & known].var(axis=0)):
        return {}
    lean = np.zeros_like(tilts)
    lean[stretch] = np.where(known[stretch, None], columns[stretch] @ learnt - tilts[stretch], 0.0)
    return dict(zip(LEANS, lean.T, strict=True))


def longest_still(record: Record) -> slice:
    """Return the longest stretch in which neither tilt changes by anything, empty where none is long enough."""
    still = (np.diff(record.pitch_deg) == 0.0) & (np.diff(record.roll_deg) == 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    if not len(edges):
        return slice(0, 0)
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    first, last = int(begins[k]), int(ends[k])
    long = record.time_s[last] - record.time_s[first] >= SHORTEST_S and last - first >= FEWEST
    return slice(first, last + 1) if long else slice(0, 0)


def _flow(record: Record) -> tuple[Floats, NDArray[np.bool_]]:
    """Return powers of the flow along and across the instrument, (n, 5), and where it is known, (n,)."""
    velocity, _ = overlap.near_bins(record, np.zeros(len(record.time_s)), NEAR_CELLS)
    sine, cosine = angles.sin_cos(record.heading_deg)
    along, across = velocity.imag * cosine + velocity.real * sine, velocity.real * cosine - velocity.imag * sine
    speed = np.abs(velocity)
    columns = np.column_stack([np.ones(len(speed)), speed * along, speed * across, along, across])
    known = np.asarray(np.isfinite(columns).all(axis=1))
    return np.where(known[:, None], columns, 0.0), known
