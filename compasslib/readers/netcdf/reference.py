"""Which north the directions of a netCDF file count from, and how many degrees of declination they hold.

What the file says comes first; where it says true north and the mooring file does not, or the other way round, it is
refused: a wrong north turns every current. The words of the file are those of CF (eastward is true), of IMOS
(``UCUR_MAG``, ``compass_correction_applied``), dolfyn (``declination``), ADCPy (``magnetic_variation_applied``), stglib
(a sentence of its history) and of this program's own product (``reference``, ``DECLINATION``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import netCDF4
import numpy as np

from compasslib.earthfield import AppliedDeclination
from compasslib.readers.netcdf.variables import File, find, values
from compasslib.types import Floats

MAGNETIC, TRUE = "magnetic", "true"
STGLIB = re.compile(r"[Rr]otating heading and horizontal velocities by ([-+]?[\d.]+) degrees")
# Such as IMOS' compass_correction_applied, EPIC's magnetic_variation_applied, WHOI's magnetic_correction_applied.
APPLIED = re.compile(r"(?=.*(?:compass|magnetic|magvar|declination)).*_applied")
ALIGNMENTS = {"heading_misalign_deg": 1.0, "heading_alignment": 0.01}  # of dolfyn; of ADCPy and stglib, degrees of one
ALIGNMENTS |= {"TRDI_Heading_Alignment_Hundredths_of_Deg": 0.01, "TRDI_Heading_Alignment_Hundredths_of_Deg.": 0.01}
SAME_DEG = 0.01
WHICH = "write direction_reference: true, or declination_applied: DEGREES where the declination is to be taken out"


@dataclass(frozen=True)
class North:
    """The north that a file states; its declination None where it does not tell how many degrees."""

    word: str  # magnetic, true or nothing
    degrees: Floats | None  # inside the velocities
    heading_degrees: Floats | None
    why: str  # what says so


@dataclass(frozen=True)
class Turn:
    """The degrees to take out of velocities and headings; None where headings cannot be used."""

    velocity: Floats
    heading: Floats | None


def stated_north(file: File, east: netCDF4.Variable, heading: netCDF4.Variable | None) -> North:
    """Find the north that the file states for its velocities and headings."""
    word, degrees, why = _velocity_north(file, east)
    in_heading = np.zeros(()) if heading is None else degrees
    if heading is not None:
        names = filter(APPLIED.fullmatch, heading.ncattrs())
        stated = [_number(file.attribute(name, variable=heading)) for name in names]
        in_heading = next((np.asarray(degrees) for degrees in stated if degrees is not None), in_heading)
        in_heading = np.zeros(()) if MAGNETIC in _words(file, heading) else in_heading
    return North(word, degrees, in_heading, why)


def resolve_north(file: File, north: North, reference: str, applied: AppliedDeclination | None) -> Turn:
    """Decide what is to be taken out, by the file's words and the mooring file's; note the decision.

    Raises:
        InputError: the two contradict each other, or neither tells.
    """
    if applied is not None:
        if applied.velocity and (reference == TRUE or north.word == MAGNETIC):
            said = "direction_reference: true" if reference == TRUE else north.why
            advice = "delete one of the two" if reference == TRUE else "delete declination_applied"
            raise file.refuse("directions", f"no declination_applied beside {said}", str(applied), advice)
        if north.degrees is not None and np.any(np.abs(north.degrees - applied.velocity) > SAME_DEG):
            reason = f"although {north.why} says {_shown(north.degrees)}"
            file.notes.append(f"declination_applied of {applied} degrees was taken out of the directions, {reason}.")
        if applied.differs:
            return Turn(np.asarray(applied.velocity), np.asarray(applied.heading))
        magnetic = north.heading_degrees is not None and north.word == TRUE and not np.any(north.heading_degrees)
        return Turn(np.asarray(applied.velocity), np.asarray(0.0 if magnetic else applied.heading))
    if reference == TRUE:
        return _keep_true(file, north)
    if north.degrees is not None and np.any(north.degrees):
        file.notes.append(f"{north.why}: {_shown(north.degrees)} of declination were taken out of the directions.")
    if north.word == TRUE and north.degrees is None:
        expected = "magnetic north, as direction_reference says"
        raise file.refuse("directions", expected, f"true north by {north.why}", WHICH)
    if not north.word:
        for name in ("magnetic_variation", "magnetic_variation_at_site", "magnetic_declination"):
            if stated := _number(file.attribute(name)):
                advice = f"write declination_applied: {stated:g} where the directions hold it, 0 where they do not"
                raise file.refuse(name, "a word whether it was applied", f"{stated:g} degrees without one", advice)
        file.notes.append(
            "The file does not say which north its directions count from; direction_reference: magnetic counts."
        )
    degrees = np.zeros(()) if north.degrees is None else north.degrees
    return Turn(degrees, degrees if north.heading_degrees is None else north.heading_degrees)


def heading_alignment(file: File, heading: netCDF4.Variable | None, stated: float | None) -> float:
    """Find the degrees to add to headings for the instrument's heading alignment EA.

    Raises:
        InputError: the file tells an EA and the mooring file does not say how to take it, or the other way round.
    """
    if heading is None:
        return 0.0
    holders = [(name, holder) for name in ALIGNMENTS for holder in (heading, None)]
    values = ((name, _number(file.attribute(name, variable=holder))) for name, holder in holders)
    name, degrees = next(((name, x) for name, x in values if x), ("heading alignment EA", 0.0))
    degrees *= ALIGNMENTS.get(name, 1.0)
    if stated is None and degrees:
        advice = "give heading_alignment: degrees to add to the file's heading to get beam 3's, or 0 to ignore EA"
        raise file.refuse(name, "a heading alignment EA of 0 degrees", f"{degrees:g} degrees", advice)
    if stated and not degrees:
        expected = f"one that is not 0, as heading_alignment is {stated:g}"
        advice = "delete heading_alignment: it only says how to take an EA that the file holds"
        raise file.refuse(name, expected, "none", advice)
    if degrees:
        added = f"heading_alignment of {stated or 0.0:g} degrees was added to the headings"
        file.note(f"{added}; {name} is {degrees:g} degrees.")
    return stated or 0.0


def _keep_true(file: File, north: North) -> Turn:
    if north.word == MAGNETIC:
        advice = "write direction_reference: magnetic"
        expected = "true north, as direction_reference says"
        raise file.refuse("directions", expected, f"magnetic north by {north.why}", advice)
    if north.heading_degrees is None:
        file.notes.append(
            "Headings are left out, as the file does not tell the declination in them; declination_applied: DEGREES, "
            "beside direction_reference: magnetic, takes it out of headings and velocities, declination_applied: "
            "{heading: DEGREES, velocity: 0} out of headings alone."
        )
    return Turn(np.zeros(()), north.heading_degrees)


def _velocity_north(file: File, east: netCDF4.Variable) -> tuple[str, Floats | None, str]:
    for holder in (east, file.nc):
        for name in filter(APPLIED.fullmatch, map(str.lower, holder.ncattrs())):
            if (applied_deg := _number(file.attribute(name, variable=holder))) is not None:
                return (TRUE if applied_deg else MAGNETIC), np.asarray(applied_deg), f"{name} {applied_deg:g}"
    if rotated := STGLIB.findall(file.text("history")):
        return TRUE, np.asarray(float(rotated[-1])), "stglib's history"
    if file.attribute("coord_sys") is not None:  # dolfyn turns by declination alone, and says so
        applied_deg = _number(file.attribute("declination")) or 0.0
        return (TRUE if applied_deg else MAGNETIC), np.asarray(applied_deg), f"dolfyn's declination {applied_deg:g}"
    words = _words(file, east)
    if MAGNETIC in words:
        return MAGNETIC, np.zeros(()), east.name
    if "true north" in words or file.text("standard_name", east) == "eastward_sea_water_velocity":
        series = find(file, "declination", (file.time,), ())
        degrees = None if series is None else values(file, "declination", series)
        why = "standard_name" if "true north" not in words else "reference"
        return TRUE, degrees, f"{east.name}'s {why}" + (f" and {series.name}" if series is not None else "")
    return "", None, ""


def _words(file: File, variable: netCDF4.Variable) -> str:
    names = ("standard_name", "long_name", "reference", "reference_datum", "units")
    parts = [file.text(name, variable) for name in names]
    return " ".join([*parts, "magnetic" * variable.name.upper().endswith("_MAG")]).lower()


def _number(value: object) -> float | None:
    try:
        return None if value is None else float(np.asarray(value, dtype=float).ravel()[0])
    except (TypeError, ValueError, IndexError):
        return None


def _shown(degrees: Floats) -> str:
    low, high = float(np.nanmin(degrees)), float(np.nanmax(degrees))
    return f"{low:.2f} degrees" if high - low < SAME_DEG else f"{low:.2f} to {high:.2f} degrees"
