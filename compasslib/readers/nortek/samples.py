"""What a Nortek file recorded, in either of the two formats: fields with units, nothing turned to the earth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from compasslib.readers.nortek.packets import Bytes, Places
from compasslib.records import Flags
from compasslib.types import Bools, Floats

EARTH, INSTRUMENT, BEAM = 0, 1, 2  # as both formats number them
MISSING_COUNT = -32768


@dataclass(frozen=True, eq=False)
class Samples:
    """Samples in the order of the file; n of them, m cells."""

    offset: Places  # (n,) in the file, bytes
    time_s: Floats  # (n,) since 1970-01-01 by the instrument's clock; NaN where impossible
    heading_deg: Floats  # (n,) of the x axis
    pitch_deg: Floats  # (n,) x axis up
    roll_deg: Floats  # (n,) y axis, which is port on an up-looker, up
    pressure_dbar: Floats  # (n,) NaN without a sensor
    temperature_c: Floats  # (n,)
    supply_voltage: Floats  # (n,) volts
    velocity: Floats  # (n, m, 2 or 3) m/s: east and north (earth), else x, y, z of the head
    quality: Flags  # (n, m)
    heading_quality: Flags  # (n,)
    looks_up: Bools  # (n,) the instrument's own word
    sideways: Bools  # (n,) it lay on its side by its own word
    bin_range_m: tuple[float, ...]  # (m,) vertical distance from the head; 0 for a point meter
    recorded: int  # EARTH, INSTRUMENT or BEAM; beams are combined already
    beam_angle_deg: float  # from the vertical; 0 for a point meter
    serial: str
    declination_deg: float = 0.0  # that the instrument added to its headings
    average_s: float = 0.0  # over which a sample is a mean; its time is the beginning
    magnetometer: Floats | None = None  # (n, 3) counts along x, y, z
    up: Floats | None = None  # (n, m) m/s, where velocities were recorded as the earth's
    profiles: Mapping[str, Bytes] = field(default_factory=dict)  # (n, m, beams) or (n, m), as the record's
    counts: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # sentences for the report


def by_beam(rows: Bytes, at: int, beams: int, cells: int) -> Bytes:
    """Return bytes of which the records hold those of one beam after those of another, (n, cells, beams).

    Args:
        at: where the first stands in the record.
    """
    return np.moveaxis(rows[:, at : at + beams * cells].reshape(len(rows), beams, cells), 1, 2).copy()


def axes_of(matrix: Floats) -> Floats:
    """Return the rows of x, y and z, (3, k), of a matrix from beams to axes; of two estimates of z their mean."""
    return matrix if len(matrix) == 3 else np.vstack([matrix[:2], matrix[2:].mean(axis=0)])
