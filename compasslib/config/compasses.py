"""What hangs together: the records of one compass, declared by ``compass: NAME`` and never inferred."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from compasslib.config.calibrations import CalibrationFile
from compasslib.config.schema import Mooring
from compasslib.config.values import iso, shown
from compasslib.errors import InputError

SERIAL = ("serial_number", "sensor_serial_number")


@dataclass(frozen=True)
class Stay:
    """Where a compass was, and when; of a calibration the date is both."""

    compass: str
    where: str
    begin_s: float
    end_s: float


Stays = dict[str, list[Stay]]  # by the compass's name in small letters


def calibrated(calibrations: Mapping[str, CalibrationFile]) -> Stays:
    """Return when each compass was calibrated."""
    found: Stays = {}
    for name, one in calibrations.items():
        if one.compass is not None and one.date_s is not None:
            stay = Stay(one.compass, f"calibration {name}", one.date_s, one.date_s)
            found.setdefault(one.compass.lower(), []).append(stay)
    return found


def refuse_overlap(name: str, mooring: Mooring, file: str, stays: Stays) -> None:
    """Refuse a mooring whose compass was elsewhere at the time, or is confused with another by a name.

    Args:
        file: of this mooring.
        stays: of what was looked at before; the mooring's are added.

    Raises:
        InputError: it was, or is.
    """
    for role, compass in _compasses(mooring):
        known = stays.setdefault(compass.lower(), [])
        for other in known:
            _refuse(f"{file}: instruments.{role}.compass", compass, mooring, other)
        known.append(Stay(compass, f"{name} ({role})", mooring.start_s, mooring.end_s))


def _refuse(where: str, compass: str, mooring: Mooring, other: Stay) -> None:
    if compass != other.compass:
        found, advice = f"{shown(compass)}, and {other.where} has {other.compass}", "write both alike, or rename one"
        raise InputError(where, expected="a name that no other has in other letters", found=found, advice=advice)
    if other.where == f"calibration {mooring.name}":
        expected, advice = "another name of the mooring than of the compass's calibration", "rename one of the two"
        raise InputError(where, expected=expected, found=f"{mooring.name} for both", advice=advice)
    if other.begin_s < mooring.end_s and mooring.start_s < other.end_s:
        span = iso(other.begin_s) + (f" to {iso(other.end_s)}" if other.end_s > other.begin_s else "")
        expected = f"a compass that is in one place from {iso(mooring.start_s)} to {iso(mooring.end_s)}"
        advice = "correct the dates, or give one of the two compasses another name"
        raise InputError(where, expected=expected, found=f"{compass} at {other.where}, {span}", advice=advice)


def _compasses(mooring: Mooring) -> list[tuple[str, str]]:
    return [(role, one.compass) for role, one in mooring.instruments.items() if one.compass is not None]


def members(
    moorings: Mapping[str, Mooring], calibrations: Mapping[str, CalibrationFile]
) -> dict[str, tuple[list[str], list[str]]]:
    """Return the moorings whose affected compass it is, and the calibrations, of each compass, in their orders."""
    found: dict[str, tuple[list[str], list[str]]] = {}
    for name, mooring in moorings.items():
        if (compass := mooring.instruments[mooring.compromised].compass) is not None:
            found.setdefault(compass, ([], []))[0].append(name)
    for name, calibration in calibrations.items():
        if calibration.compass is not None:
            found.setdefault(calibration.compass, ([], []))[1].append(name)
    return dict(sorted(found.items()))


def suggestions(moorings: Mapping[str, Mooring]) -> list[str]:
    """Return a line for each serial number that several moorings' affected instruments carry without ``compass``."""
    numbers: dict[str, list[str]] = {}
    for name, mooring in moorings.items():
        instrument = mooring.instruments[mooring.compromised]
        given = {**mooring.attributes, **instrument.attributes}
        number = next((str(given[key]) for key in SERIAL if key in given), None)
        if number is not None and instrument.compass is None:
            numbers.setdefault(number, []).append(name)
    return [
        f"{', '.join(names)}: serial number {number} in each; if it is one compass, compass: NAME in each says so"
        for number, names in numbers.items()
        if len(names) > 1
    ]
