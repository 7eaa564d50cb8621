"""Records of a shared compass (``compass: NAME``, never inferred)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

from compasslib.config.calibrations import CalibrationFile
from compasslib.config.schema import Mooring
from compasslib.errors import InputError
from compasslib.records import iso_time

SERIAL_KEYS = ("serial_number", "sensor_serial_number")


@dataclass(frozen=True)
class Deployment:
    """Place and time span of one use of a compass; a calibration begins and ends at its date."""

    where: str
    begin_s: float
    end_s: float


Deployments = dict[str, list[Deployment]]  # by the name of the compass


def calibration_dates(calibrations: Mapping[str, CalibrationFile]) -> Deployments:
    """List the dated calibrations of each compass."""
    actual: Deployments = {}
    for name, entry in calibrations.items():
        if entry.compass is not None and entry.date_s is not None:
            stay = Deployment(f"calibration {name}", entry.date_s, entry.date_s)
            actual.setdefault(entry.compass, []).append(stay)
    return actual


def refuse_overlap(name: str, mooring: Mooring, file: str, stays: Deployments) -> None:
    """Check that no compass of a mooring was elsewhere at the same time or has the name of a mooring.

    Args:
        stays: deployments and calibrations checked before, by compass; those of the mooring are added.

    Raises:
        InputError: if a compass was elsewhere, or a calibration has the name of the mooring.
    """
    for role, entry in mooring.instruments.items():
        if (compass := entry.compass) is None:
            continue
        where = f"{file}: instruments.{role}.compass"
        known = stays.setdefault(compass, [])
        for other in known:
            if other.where == f"calibration {mooring.name}":
                expected = "another name of the mooring than of the compass's calibration"
                actual, advice = f"{mooring.name} for both", "rename one of the two"
                raise InputError(where, expected=expected, found=actual, advice=advice)
            if other.begin_s < mooring.end_s and mooring.start_s < other.end_s:
                span = " to ".join(dict.fromkeys([iso_time(other.begin_s), iso_time(other.end_s)]))
                own = f"{iso_time(mooring.start_s)} to {iso_time(mooring.end_s)}"
                expected = f"a compass that is in one place from {own}"
                advice = "correct the dates, or give one of the two compasses another name"
                raise InputError(where, expected=expected, found=f"{compass} at {other.where}, {span}", advice=advice)
        known.append(Deployment(f"{name} ({role})", mooring.start_s, mooring.end_s))


def members(
    moorings: Mapping[str, Mooring], calibrations: Mapping[str, CalibrationFile]
) -> dict[str, tuple[list[str], list[str]]]:
    """List, for each compass, the moorings with it as the affected compass and its calibrations, in input order."""
    actual: dict[str, tuple[list[str], list[str]]] = {}
    for name, mooring in moorings.items():
        if (compass := mooring.instruments[mooring.compromised].compass) is not None:
            actual.setdefault(compass, ([], []))[0].append(name)
    for name, calibration in calibrations.items():
        if calibration.compass is not None:
            actual.setdefault(calibration.compass, ([], []))[1].append(name)
    return dict(sorted(actual.items()))


def suggest_shared(moorings: Mapping[str, Mooring]) -> list[str]:
    """Suggest ``compass`` for each serial number shared by affected instruments of several moorings, one line each."""
    numbers: dict[str, list[str]] = {}
    for name, mooring in moorings.items():
        instrument = mooring.instruments[mooring.compromised]
        given = {**mooring.attributes, **instrument.attributes}
        number = next((str(given[key]) for key in SERIAL_KEYS if key in given), None)
        if number is not None and instrument.compass is None:
            numbers.setdefault(number, []).append(name)
    return [
        f"{', '.join(names)}: serial number {number} in each; if it is one compass, compass: NAME in each says so"
        for number, names in numbers.items()
        if len(names) > 1
    ]


def mixed_serials(moorings: Mapping[str, Mooring], serials: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Describe each compass whose instruments have different serial numbers, by their files or their attributes.

    Args:
        serials: serial numbers in the files, by mooring and instrument.
    """
    numbers: dict[str, dict[str, str]] = {}
    for name, mooring in moorings.items():
        for role, instrument in mooring.instruments.items():
            stated = next((str(instrument.attributes[key]) for key in SERIAL_KEYS if key in instrument.attributes), "")
            number = serials.get(name, {}).get(role, "") or stated
            if instrument.compass is not None and number:
                numbers.setdefault(instrument.compass, {})[f"{name} ({role})"] = number
    return [
        f"compass {compass}: serial number {first} at {this}, {second} at {other}: two instruments under one name; "
        "correct compass or files"
        for compass, places in numbers.items()
        for (this, first), (other, second) in combinations(places.items(), 2)
        if not {*map(int, re.findall(r"\d+", first))} & {*map(int, re.findall(r"\d+", second))}
    ]
