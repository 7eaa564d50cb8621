"""From recorded PD0 ensembles to currents east and north of magnetic north, and how good each of them is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.readers.pd0_fields import BEAM, EARTH, INSTRUMENT, SHIP, Ensembles, chosen
from compasslib.readers.pd0_geometry import beams_to_instrument, instrument_to_earth, ship_to_earth, three_beam
from compasslib.records import BAD, GOOD, MISSING, Flags, Floats

LEAST_PERCENT_GOOD = 25
ALL_PINGS, PINGS_ROUNDED, TWO_BEAMS = 100, 4, 50  # percent
SOME = 200  # ensembles of a piece tell which columns percent good has

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Choices:
    """What the metadata say about a recording; None leaves it to the file."""

    orientation: str | None = None  # up | down
    declination_applied: float | None = None  # degrees inside the recorded headings, instead of EB
    heading_alignment: float | None = None  # degrees from the recorded heading to that of beam 3
    serial_number: str | None = None


def heading_bias(ensembles: Ensembles, choices: Choices) -> Floats:
    """Return the degrees that stand inside the recorded headings, (n,): EB, unless the metadata know better.

    Args:
        ensembles: n ensembles.
        choices: the metadata's word.
    """
    applied = choices.declination_applied
    return ensembles.heading_bias_deg if applied is None else np.full(len(ensembles), float(applied))


def magnetic_heading(ensembles: Ensembles, choices: Choices) -> Floats:
    """Return the heading of beam 3 as the compass recorded it, without heading bias, (n,) degrees.

    Args:
        ensembles: n ensembles.
        choices: the metadata's word.
    """
    alignment = choices.heading_alignment or 0.0
    return angles.wrap360(ensembles.heading_deg - heading_bias(ensembles, choices) + alignment)


def looks_up(ensembles: Ensembles, choices: Choices) -> Mask:
    """Return the orientation of each ensemble, (n,): the metadata's, or where they are silent its own.

    Args:
        ensembles: n ensembles.
        choices: the metadata's word.
    """
    word = choices.orientation
    return ensembles.looks_up if word is None else np.full(len(ensembles), word == "up")


def currents(ensembles: Ensembles, choices: Choices) -> tuple[Floats, Floats, int]:
    """Return (east, north), (n, m) m/s to magnetic north, and how many of them come from three beams.

    Args:
        ensembles: n ensembles of m cells, in any mixture of coordinates.
        choices: the metadata's word.
    """
    codes = np.unique(ensembles.coordinates)
    if len(codes) == 1:
        return _TURNS[int(codes[0])](ensembles, choices)
    east, north = np.full((2, *ensembles.velocity.shape[:2]), np.nan)
    count = 0
    for code in codes:
        mine = ensembles.coordinates == code
        east[mine], north[mine], more = _TURNS[int(code)](chosen(ensembles, mine), choices)
        count += more
    return east, north, count


def quality(ensembles: Ensembles, east: Floats, north: Floats) -> Flags:
    """Return the OceanSITES flag of each current, (n, m): missing, bad where too few pings were good, or good.

    In earth, ship and instrument coordinates columns 1 and 4 of the percent-good block are the solutions of three and
    of four beams; in beam coordinates each column is a beam, and those that are missing do not count.

    Args:
        ensembles: n ensembles of m cells.
        east: (n, m) m/s.
        north: (n, m) m/s.
    """
    percent, by_beam = ensembles.percent_good, ensembles.coordinates == BEAM
    share = percent[..., 0].astype(np.int16) + percent[..., 3]
    if by_beam.any():
        share[by_beam] = np.where(np.isnan(ensembles.velocity[by_beam]), 255, percent[by_beam]).min(axis=-1)
    flags = np.where(share < LEAST_PERCENT_GOOD, BAD, GOOD)
    return np.where(np.isnan(east) | np.isnan(north), MISSING, flags).astype(np.int8)


def of_other_coordinates(ensembles: Ensembles) -> tuple[int, int]:
    """Return how many cells contradict the coordinates that EX tells, and how many could, of some ensembles.

    Percent good has a column a beam in beam coordinates; in others its columns part all pings, and add up to 100.
    Beams, too, agree on their error velocity.

    Args:
        ensembles: n ensembles of m cells.
    """
    some = slice(None, None, 1 + len(ensembles) // SOME)
    percent, velocity = ensembles.percent_good[some], ensembles.velocity[some]
    total = percent.sum(axis=-1, dtype=np.int16)
    told = (total > 0) & np.isfinite(velocity).all(axis=-1)
    parts = np.abs(total - ALL_PINGS) <= PINGS_ROUNDED
    b1, b2, b3, b4 = np.moveaxis(velocity, -1, 0)
    agree = 2.0 * np.abs(b1 + b2 - b3 - b4) < np.abs(b1 - b2) + np.abs(b3 - b4)
    beams = (total > ALL_PINGS + TWO_BEAMS) & agree
    other = np.where((ensembles.coordinates[some] == BEAM)[:, None], parts, beams)
    return int(np.sum(other & told)), int(np.sum(told))


def _from_beams(ensembles: Ensembles, choices: Choices) -> tuple[Floats, Floats, int]:
    beams, solved = three_beam(ensembles.velocity)
    angle, convex = ensembles.beam_angle_deg[:, None], ensembles.convex[:, None]
    x, y, z, _ = beams_to_instrument(beams, angle, convex)
    east, north = _with_tilts(ensembles, choices, (x, y, z), magnetic_heading(ensembles, choices))
    return east, north, int(solved.sum())


def _from_instrument(ensembles: Ensembles, choices: Choices) -> tuple[Floats, Floats, int]:
    x, y, z, _ = np.moveaxis(ensembles.velocity, -1, 0)
    east, north = _with_tilts(ensembles, choices, (x, y, z), magnetic_heading(ensembles, choices))
    return east, north, _without_error_velocity(ensembles)


def _from_ship(ensembles: Ensembles, choices: Choices) -> tuple[Floats, Floats, int]:
    """Turn by the recorded heading only, as EA has turned these axes to where the heading points."""
    x, y, z, _ = np.moveaxis(ensembles.velocity, -1, 0)
    heading = angles.wrap360(ensembles.heading_deg - heading_bias(ensembles, choices))
    east, north = ship_to_earth(x, y, heading)
    if not ensembles.tilts_used.all():
        tilted = _with_tilts(ensembles, choices, (x, y, z), heading)
        level = ensembles.tilts_used[:, None]
        east, north = np.where(level, east, tilted[0]), np.where(level, north, tilted[1])
    return east, north, _without_error_velocity(ensembles)


def _from_earth(ensembles: Ensembles, choices: Choices) -> tuple[Floats, Floats, int]:
    """Turn back by the heading bias, which the instrument turned its velocities by as well."""
    bias = heading_bias(ensembles, choices)
    east, north = ensembles.velocity[..., 0].copy(), ensembles.velocity[..., 1].copy()
    if bias.any():
        east, north = angles.turn(east, north, -bias[:, None])
    return east, north, _without_error_velocity(ensembles)


def _with_tilts(
    ensembles: Ensembles, choices: Choices, xyz: tuple[Floats, Floats, Floats], heading_deg: Floats
) -> tuple[Floats, Floats]:
    up = looks_up(ensembles, choices)
    east, north, _ = instrument_to_earth(xyz, heading_deg, ensembles.tilt1_deg, ensembles.tilt2_deg, up)
    return east, north


def _without_error_velocity(ensembles: Ensembles) -> int:
    """Count the instrument's own solutions from three beams, which have no error velocity."""
    missing = np.isnan(ensembles.velocity)
    return int(np.sum(missing[..., 3] & ~missing[..., 0]))


_TURNS: dict[int, Callable[[Ensembles, Choices], tuple[Floats, Floats, int]]] = {
    BEAM: _from_beams,
    INSTRUMENT: _from_instrument,
    SHIP: _from_ship,
    EARTH: _from_earth,
}
