"""Whether the headings that a 3D-ACM logged are those of its own magnetometer and tilts, logged beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.readers import mmp_geometry
from compasslib.readers.mmp_clock import Bools
from compasslib.records import Floats

OFF_DEG = 2.0  # the logger's rule gives its heading to 0.14 degrees in a genuine record of 17,917 scans
MOST_OFF = 0.5  # of the headings: with more it is the magnetometer that may be wrong


@dataclass(frozen=True, eq=False)
class Compared:
    """How logged headings stand to those of the magnetometer."""

    off: Bools  # (n,) further apart than tilts explain, beyond the constant
    known: int  # headings with a magnetometer's beside them
    constant_deg: float  # logged minus computed, in the middle; 0 where they do not follow each other

    @property
    def follows(self) -> bool:
        """Return whether most headings are the magnetometer's."""
        return int(self.off.sum()) <= MOST_OFF * self.known


def compare(heading_deg: Floats, field: Floats, tilts_deg: Floats) -> Compared:
    """Return which logged headings are not those of the magnetometer, levelled or not.

    Args:
        heading_deg: as logged, (n,); NaN where there is none.
        field: HX, HY, HZ, (n, 3), any unit.
        tilts_deg: TX, TY, (n, 2).
    """
    rules = [mmp_geometry.logged_heading(field, *(share * tilts_deg.T)) for share in (1.0, 0.0)]
    apart = np.array([angles.difference(heading_deg, rule) for rule in rules])
    known = np.isfinite(apart).all(axis=0)
    constant = _middle(apart[0][known])
    off = known & (np.abs(angles.difference(apart, constant)) > OFF_DEG).all(axis=0)
    found = Compared(off, int(known.sum()), constant)
    return found if found.follows else Compared(known & (np.abs(apart) > OFF_DEG).all(axis=0), found.known, 0.0)


def sentences(found: Compared) -> list[str]:
    """Return what to say of logged headings that are not the magnetometer's.

    Args:
        found: by ``compare``.
    """
    number = int(found.off.sum())
    apart = f"{number} of {found.known} logged headings stand more than {OFF_DEG:g} degrees off those of HX HY HZ TX TY"
    if not found.follows:
        return [f"{apart}: one of the two is wrong, and nothing tells which"]
    said = [f"{apart} and were flagged"] if number else []
    if abs(found.constant_deg) > OFF_DEG:
        constant = f"the logged headings stand {found.constant_deg:+.1f} degrees off those of HX HY HZ TX TY throughout"
        said.append(f"{constant}: give it as declination_applied if the logger added it")
    return said


def _middle(degrees: Floats) -> float:
    if not degrees.size:
        return 0.0
    mean = angles.mean(degrees)
    return float(angles.wrap180(mean + np.median(angles.difference(degrees, mean))))
