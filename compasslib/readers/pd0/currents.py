"""Compute currents relative to magnetic north, and their quality flags, from recorded PD0 ensembles.

The geometry is that of four slanted beams. Y points along beam 3, which is forward. X is starboard and Z up on a
down-looker; X is port and Z down on an up-looker. Recorded tilts: tilt 1 positive with beam 3 up, tilt 2 positive
with starboard down, in both orientations. Source: RDI, ADCP Coordinate Transformation; the signs are tested against
known solutions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compasslib import angles
from compasslib.earthfield import AppliedDeclination
from compasslib.readers.pd0.fields import STRAY, Coordinates, Ensembles
from compasslib.records import BAD, GOOD, LEAST_PERCENT_GOOD, MISSING, Flags, take
from compasslib.types import Bools, Floats

# Error velocity is a multiple of b1 + b2 - b3 - b4.
_ERROR_SIGNS = np.array([1.0, 1.0, -1.0, -1.0])


@dataclass(frozen=True)
class Settings:
    """Settings of a recording from the metadata; None defers to the file."""

    orientation: str | None = None  # up | down
    # Declination contained in recorded headings and earth velocities, degrees, instead of EB.
    declination_applied: AppliedDeclination | None = None
    heading_alignment: float | None = None  # degrees from the recorded heading to that of beam 3
    serial_number: str | None = None
    sound_speed: str | Mapping[str, float] | None = None  # auto (as None) | keep | {salinity: S}


def heading_bias(ensembles: Ensembles, settings: Settings) -> Floats:
    """Get the bias contained in the recorded headings, (n,) degrees: EB, unless the metadata override it."""
    applied = settings.declination_applied
    return ensembles.heading_bias_deg if applied is None else np.full(len(ensembles), applied.heading)


def velocity_bias(ensembles: Ensembles, settings: Settings) -> Floats:
    """Get the bias to remove from velocities, (n,) degrees: that of headings unless earth velocities have their own."""
    bias, applied = heading_bias(ensembles, settings), settings.declination_applied
    return bias if applied is None else np.where(ensembles.coordinates == Coordinates.EARTH, applied.velocity, bias)


def magnetic_heading(ensembles: Ensembles, settings: Settings) -> Floats:
    """Compute the magnetic heading of beam 3 from the recorded one: bias removed, alignment added; (n,) degrees."""
    alignment = settings.heading_alignment or 0.0
    return angles.wrap360(ensembles.heading_deg - heading_bias(ensembles, settings) + alignment)


def looks_up(ensembles: Ensembles, settings: Settings) -> Bools:
    """Get the orientation of each ensemble, (n,): that of the metadata, or else the recorded one."""
    word = settings.orientation
    return ensembles.looks_up if word is None else np.full(len(ensembles), word == "up")


def compute_currents(ensembles: Ensembles, settings: Settings) -> tuple[Floats, Floats, Floats, Floats, int]:
    """Compute the velocities of ensembles, whose coordinate systems may be mixed.

    Return east, north and up relative to magnetic north and the error velocity, (n, m) m/s each, NaN where missing (the
    error velocity of three-beam solutions too), and the number of three-beam solutions.
    """
    codes = np.unique(ensembles.coordinates)
    if len(codes) == 1:
        return _turn(ensembles, settings, int(codes[0]))
    whole, count = np.full((4, *ensembles.velocity.shape[:2]), np.nan), 0
    for code in codes:
        mine = ensembles.coordinates == code
        *flow, three_beam = _turn(take(ensembles, mine), settings, int(code))
        whole[:, mine] = flow
        count += three_beam
    return whole[0], whole[1], whole[2], whole[3], count


def flag_currents(ensembles: Ensembles, east: Floats, north: Floats) -> Flags:
    """Assign OceanSITES flags to currents, (n, m): missing, bad where too few pings were good, or good.

    In earth, ship and instrument coordinates, columns 1 and 4 of the percent-good block are three-beam and four-beam
    solutions; in beam coordinates each column is a beam, and missing beams are ignored.
    """
    percent, by_beam = ensembles.percent_good, ensembles.coordinates == Coordinates.BEAM
    share = percent[..., 0].astype(np.int16) + percent[..., 3]
    if by_beam.any():
        share[by_beam] = np.where(np.isnan(ensembles.velocity[by_beam]), 255, percent[by_beam]).min(axis=-1)
    flags = np.where(share < LEAST_PERCENT_GOOD, BAD, GOOD)
    return np.where(np.isnan(east) | np.isnan(north), MISSING, flags).astype(np.int8)


def fill_missing_beam(beams: Floats) -> tuple[Floats, Bools]:
    """Fill a single missing beam of four for zero error velocity, and flag where this was done.

    Two or more missing beams remain NaN.
    """
    missing = np.isnan(beams)
    alone = missing.sum(axis=-1) == 1
    if not alone.any():
        return beams, alone
    error = np.nansum(beams * _ERROR_SIGNS, axis=-1, keepdims=True)
    return np.where(missing & alone[..., None], -_ERROR_SIGNS * error, beams), alone


def map_cells(
    beams: Floats, reach: Floats, bin1_m: Floats, cell_m: Floats, cells: NDArray[np.int_], most: float = 0.4
) -> Floats:
    """Interpolate the velocities of each beam to the bin depths of a level instrument, (n, m, k).

    A tilt reduces the vertical distance of the bins of one beam and increases that of the opposite one, so the same bin
    of several beams samples different depths. Depths outside the measured range become NaN. Samples with large tilts,
    as of an instrument lying on deck, are not mapped.

    Args:
        beams: (n, m, k) m/s.
        reach: (n, k) vertical distance along a beam relative to that of a level instrument.
        bin1_m: (n,) vertical distance of the first bin of a level instrument; ``cell_m`` is the bin size, (n,).
        cells: (n,) number of bins.
        most: relative change of a reach from which bins are not mapped: some 30 degrees of tilt.
    """
    index = np.arange(beams.shape[1])
    reach = np.where((np.abs(reach - 1.0) < most).all(axis=-1, keepdims=True), reach, 1.0)
    range_m = bin1_m[:, None] + cell_m[:, None] * index
    place = (range_m[..., None] / reach[:, None] - bin1_m[:, None, None]) / cell_m[:, None, None]
    place = np.where(np.isfinite(place), place, index[:, None])
    last = cells[:, None, None] - 1
    outside = (place < -0.5) | (place > last + 0.5)
    place = np.clip(place, 0, last)
    before = np.floor(place).astype(np.intp)
    share = place - before
    nearer, farther = (np.take_along_axis(beams, np.minimum(at, last), axis=1) for at in (before, before + 1))
    mapped = np.where(share > 0.0, (1.0 - share) * nearer + share * farther, nearer)
    mapped = np.where(np.isfinite(mapped), mapped, np.where(share < 0.5, nearer, farther))
    return np.where(outside, np.nan, mapped)


def beams_to_instrument(
    beams: Floats, beam_angle_deg: ArrayLike, convex: ArrayLike = True
) -> tuple[Floats, Floats, Floats, Floats]:
    """Convert beam velocities, (..., 4), to (x, y, z, error) in instrument axes, (...) each.

    The angle of the beams from the vertical and ``convex`` broadcast with (...).
    """
    b1, b2, b3, b4 = (beams[..., i] for i in range(4))
    sine, cosine = angles.sin_cos(beam_angle_deg)
    # The beams of a concave head cross, so each points to the opposite side.
    across = np.where(convex, 1.0, -1.0) / (2.0 * sine)
    x, y = across * (b1 - b2), across * (b4 - b3)
    return x, y, (b1 + b2 + b3 + b4) / (4.0 * cosine), (b1 + b2 - b3 - b4) / (2.0 * np.sqrt(2.0) * sine)


def true_pitch(tilt1_deg: ArrayLike, tilt2_deg: ArrayLike) -> Floats:
    """Compute the true pitch, atan(tan tilt1 cos tilt2), degrees, from recorded pitch and roll.

    The tilt sensor measures pitch in the rolled frame of the instrument.
    """
    (sine, cosine), (_, across) = angles.sin_cos(tilt1_deg), angles.sin_cos(tilt2_deg)
    return angles.wrap180(angles.direction(sine * across, cosine))


def instrument_to_earth(
    xyz: Sequence[Floats], heading_deg: Floats, tilt1_deg: Floats, tilt2_deg: Floats, looks_up: ArrayLike
) -> tuple[Floats, Floats, Floats]:
    """Rotate velocities by heading and tilts to (east, north, up), relative to the reference north of the heading.

    Args:
        xyz: velocities in instrument axes, (n, m) or (n,), m/s.
        looks_up: (n,) or scalar; RDI defines an up-looker as rotated by 180 degrees about its roll axis.
    """
    x, y, z = xyz
    roll = np.asarray(tilt2_deg) + np.where(looks_up, 180.0, 0.0)
    pitch = true_pitch(tilt1_deg, tilt2_deg)
    (sp, cp), (sr, cr) = ((_column(a, x), _column(b, x)) for a, b in (angles.sin_cos(pitch), angles.sin_cos(roll)))
    starboard = x * cr + z * sr
    forward = x * (sp * sr) + y * cp - z * (sp * cr)
    up = -x * (cp * sr) + y * sp + z * (cp * cr)
    return *angles.turn(starboard, forward, _column(heading_deg, starboard)), up


def _column(per_sample: ArrayLike, like: Floats) -> Floats:
    values = np.asarray(per_sample, dtype=float)
    return values.reshape(values.shape + (1,) * (like.ndim - values.ndim)) if values.ndim else values


def _turn(ensembles: Ensembles, settings: Settings, code: int) -> tuple[Floats, Floats, Floats, Floats, int]:
    """Compute the velocities of ensembles in a single coordinate system ``code``, see ``compute_currents``."""
    heading, upward = magnetic_heading(ensembles, settings), looks_up(ensembles, settings)
    by = heading, ensembles.tilt1_deg, ensembles.tilt2_deg, upward
    if code == Coordinates.BEAM:
        sine, cosine = angles.sin_cos(ensembles.beam_angle_deg)
        across = np.where(ensembles.convex, sine, -sine)
        roll = ensembles.tilt2_deg + np.where(upward, 180.0, 0.0)
        sp, cp = angles.sin_cos(true_pitch(ensembles.tilt1_deg, ensembles.tilt2_deg))
        sr, cr = angles.sin_cos(roll)
        # Vertical reach of each beam relative to that of a level instrument.
        along, x, y = cosine * cp * cr, across * cp * sr, across * sp
        reach = np.abs(np.stack([along - x, along + x, along - y, along + y], axis=-1) / cosine[:, None])
        mapped = map_cells(ensembles.velocity, reach, ensembles.bin1_m, ensembles.cell_m, ensembles.cells)
        beams, solved = fill_missing_beam(mapped)
        *xyz, error = beams_to_instrument(beams, ensembles.beam_angle_deg[:, None], ensembles.convex[:, None])
        return *instrument_to_earth(xyz, *by), np.where(solved, np.nan, error), int(solved.sum())
    x, y, z, error = np.moveaxis(ensembles.velocity, -1, 0)
    if code == Coordinates.INSTRUMENT:
        turned = instrument_to_earth((x, y, z), *by)
    elif code == Coordinates.SHIP:  # without heading_alignment, as the instrument already rotated these axes by EA
        heading = angles.wrap360(ensembles.heading_deg - heading_bias(ensembles, settings))
        turned = *angles.turn(x, y, heading[:, None]), z
        if not ensembles.tilts_used.all():
            tilted = instrument_to_earth((x, y, z), heading, *by[1:])
            east, north, up = (
                np.where(ensembles.tilts_used[:, None], a, b) for a, b in zip(turned, tilted, strict=True)
            )
            turned = east, north, up
    else:  # remove the heading bias, by which the instrument rotated its velocities as well
        bias = velocity_bias(ensembles, settings)
        turned = *(angles.turn(x, y, -bias[:, None]) if bias.any() else (x.copy(), y.copy())), z
    # The instrument's own solutions from three beams have no error velocity.
    missing = np.isnan(ensembles.velocity)
    return *turned, error, int(np.sum(missing[..., 3] & ~missing[..., 0]))


# Speed of sound.
#
# The instrument computes EC from temperature, depth and the salinity ES, or uses a constant. The velocity of slanted
# pistons is proportional to the speed of sound at the transducer, and ranges to its mean along the path, for which that
# at the transducer is taken: both are multiplied by true / EC (RDI, Principles of Operation: A Practical Primer, 1996).
# A phased array sets the horizontal wavelength by the spacing of its elements, so that its horizontal velocity does not
# depend on the speed of sound (TRDI, Ocean Surveyor Technical Manual).

EC, ES = (1400.0, 1600.0), (0.0, 40.0)  # m/s and practical salinity that the commands EC and ES accept


@dataclass(frozen=True, eq=False)
class SoundCorrection:
    """Correction of n ensembles for the speed of sound."""

    factor: Floats  # (n,) of the velocities, 1 where they are kept
    range_factor: float  # of the distances of all bins
    doubtful: Bools  # (n,) whether velocities were kept although EC is not that of the water
    sentence: str = ""  # for the report; empty where EC agrees with the water


def correct_sound_speed(
    ensembles: Ensembles, choice: str | Mapping[str, float] | None, *, tolerance: float = 0.01, default: float = 35.0
) -> SoundCorrection:
    """Determine the correction from EC, ES, temperature and depth of each ensemble.

    Args:
        choice: auto (as None), keep or {salinity: S}. With auto nothing is corrected where EC agrees with ES; where it
            does not, ES is the salinity of the water only if it was measured or set to other than its default.
        tolerance: twice the accuracy of a WorkHorse 300 (0.5 % of the velocity). In the moored record eh2 the EC that
            the instrument computed differs from that by the mean temperature of the ensemble by up to 0.6 %.
        default: of the command ES, also in files of other water.
    """
    ec, es, declared = ensembles.sound_m_s, ensembles.salinity, isinstance(choice, Mapping)
    stated = (es > ES[0]) & (es != default)
    known = (stated | ((ensembles.measured & 2) > 0)) & (es <= ES[1])
    if isinstance(choice, Mapping):
        es, known = np.full_like(es, choice["salinity"]), np.full_like(known, True)
    true = _true_over_used(ensembles, es)
    differs = ~(np.abs(true - 1.0) <= tolerance)  # also where it is unknown
    kept = SoundCorrection(np.ones_like(true), 1.0, np.zeros_like(differs))
    if not declared and differs.mean() <= STRAY:
        return kept
    said = f"EC, the speed of sound that the instrument used, is {_span(ec, '.0f')} m/s"
    if choice == "keep" or ensembles.phased_array.all():
        why = "sound_speed: keep" if choice == "keep" else "those of a phased array do not depend on it"
        return replace(kept, sentence=f"{said}; horizontal velocities were kept as recorded ({why}).")
    corrected = known & np.isfinite(true)
    factor, doubtful = np.where(corrected, true, 1.0), differs & ~corrected
    range_factor = float(np.median(factor))
    if corrected.any():
        source = "by sound_speed" if declared else "by ES in the file"
        said += f"; velocities of {corrected.sum()} of {len(ec)} ensembles were multiplied by "
        said += f"{_span(factor[corrected], '.3f')} and ranges by {range_factor:.3f}, those of water of salinity "
        said += f"{_span(es[corrected], 'g')} ({source})"
    if doubtful.any():
        part = take(ensembles, doubtful)
        off = [100.0 * (1.0 / np.median(_true_over_used(part, salinity)) - 1.0) for salinity in reversed(ES)]
        why = "EC cannot be compared with the water, as some have no measured temperature or no possible EC"
        if np.isfinite(off).all():
            why = f"their speeds are {off[0]:+.1f} to {off[1]:+.1f} % off for salinities of {ES[1]:g} to {ES[0]:g}"
            why += " (the salinity alone: up to 3 %); sound_speed: {salinity: S} corrects them"
        said += f"; velocities of {doubtful.sum()} of {len(ec)} ensembles were kept and flagged 2: {why}"
    return SoundCorrection(factor, range_factor, doubtful, f"{said}.")


def _true_over_used(ensembles: Ensembles, salinity: ArrayLike) -> Floats:
    """Divide the speed of sound in water of a practical salinity (TEOS-10) by EC, (n,).

    NaN without a measured temperature, and where EC is none that the command accepts.
    """
    import gsw  # takes 0.1 s

    temperature = np.where(ensembles.measured & 1, ensembles.temperature_c, np.nan)
    pressure = np.where(np.isfinite(ensembles.pressure_dbar), ensembles.pressure_dbar, ensembles.depth_m)
    used = np.where((ensembles.sound_m_s >= EC[0]) & (ensembles.sound_m_s <= EC[1]), ensembles.sound_m_s, np.nan)
    absolute = gsw.SR_from_SP(salinity)
    with np.errstate(invalid="ignore"):
        return np.asarray(gsw.sound_speed(absolute, gsw.CT_from_t(absolute, temperature, pressure), pressure) / used)


def _span(values: Floats, form: str) -> str:
    return " to ".join(dict.fromkeys(format(value, form) for value in (values.min(), values.max())))
