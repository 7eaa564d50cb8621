"""Read IAGA-2002, the exchange format of magnetic observatories (IAGA Division V-DAT, December 2001).

The line DATE below the header names the four components, which vary between years; D and I are in minutes of arc.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers import detect
from compasslib.readers.files import read_text_bytes, refuse_mostly_damaged
from compasslib.readers.times import civil_seconds, new_year
from compasslib.records import FieldSeries
from compasslib.types import DAY_S, Floats

MISSING = 88888.0  # this, 99999 and anything larger is missing: no geomagnetic field is as strong
CELL = r"(?:\s+|(?=[+-]))([+-]?\d+\.?\d*)"  # a sign may follow the previous number without a blank
ROW = re.compile(r"(\d{4})-(\d\d)-(\d\d)\s+(\d\d):(\d\d):(\d\d(?:\.\d*)?)\s+(\d{1,3})" + CELL * 4 + r"\s*\|?\s*")
DATED = re.compile(r"\d{4}-\d\d-\d\d\s")  # rows, damaged or not; concatenated files have headers in between
ADVICE = "give IAGA-2002 files of one observatory"
SETS = ("D", "XY")  # sets of components that determine the declination


def read(paths: Sequence[str | Path]) -> FieldSeries:
    """Read the series of one observatory from its files, sorted by time without repeated times.

    Raises:
        InputError: a file is not of this format, holds no rows or no declination, or is of another station.
    """
    with detect.format_hints("iaga2002", paths, advice=ADVICE):
        headers, tables, damaged = zip(*(_read_file(Path(path)) for path in paths), strict=True)
    stations = [header.get("iaga code", "").upper() for header in headers]
    for path, station in zip(paths, stations, strict=True):
        if station != stations[0]:
            expected = f"station {stations[0] or 'without code'} as in {paths[0]}"
            raise InputError(str(path), expected=expected, found=station or "no code", advice=ADVICE)
    rows = np.concatenate(tables, axis=1)
    _, first = np.unique(rows[0], return_index=True)
    time_s, declination, horizontal, vertical = rows[:, first]
    counts = {
        "rows": rows.shape[1],
        "damaged": sum(damaged),
        "repeated": rows.shape[1] - len(first),
        "missing": int(np.sum(~np.isfinite(declination))),
    }
    texts = {
        "damaged": "rows are damaged, or their date and day of the year disagree; they are left out",
        "repeated": "rows repeat an instant; the first of each counts",
        "missing": "rows have no declination",
    }
    labels = ("station name", "iaga code", "geodetic latitude", "geodetic longitude", "elevation")
    said = {label: next(filter(None, (header.get(label) for header in headers)), "") for label in labels}
    return FieldSeries(
        time_s=time_s,
        declination_deg=declination,
        horizontal_nT=horizontal,
        vertical_nT=vertical,
        station=said["station name"] or said["iaga code"] or "unnamed",
        latitude=_number(said["geodetic latitude"]),
        longitude=_number(said["geodetic longitude"]),
        elevation_m=_number(said["elevation"]),
        definitive=all(header.get("data type", "").lower().startswith("definitive") for header in headers),
        counts=counts,
        warnings=tuple(f"{counts[key]} {text}" for key, text in texts.items() if counts[key]),
        files=tuple(map(str, paths)),
        origin=np.repeat(np.arange(len(tables)), [table.shape[1] for table in tables])[first],
    )


def _read_file(path: Path) -> tuple[dict[str, str], Floats, int]:
    """Read the header, (4, n) time, declination, horizontal and vertical field, and the number of damaged rows."""
    lines = read_text_bytes(path).decode("latin-1").splitlines()
    begin = next((k for k, line in enumerate(lines) if line.startswith("DATE")), None)
    if begin is None or "IAGA-2002" not in lines[0].upper():
        expected = "a header that begins with Format IAGA-2002 and ends with a line DATE"
        raise InputError(str(path), expected=expected, found=repr(lines[0][:40]) if lines else "nothing", advice=ADVICE)
    letters = "".join(name[-1].upper() for name in lines[begin].replace("|", " ").split()[3:])
    if len(letters) != 4 or not any({*known} <= {*letters} for known in SETS):
        shown = f"{letters or 'none'} in the line DATE"
        advice = "variations such as HEZ hold no direction: take a file with D, or with X and Y"
        raise InputError(str(path), expected="four components with D, or with X and Y", found=shown, advice=advice)
    texts = [line for line in lines[begin + 1 :] if line.strip()]
    matches = [match.groups() for line in texts if (match := ROW.fullmatch(line))]
    numbers = np.array(matches, dtype=float).reshape(-1, 7 + len(letters))
    year, month, day, hour, minute, second, day_of_year = numbers[:, :7].T
    whole = (part.astype(np.int64) for part in (year, month, day, hour, minute, np.zeros_like(year)))
    time_s = civil_seconds(*whole, first_year=1, last_year=9999) + second
    sound = (np.floor((time_s - new_year(year)) / DAY_S) + 1.0 == day_of_year) & (second < 60.0)
    lost = sum(bool(DATED.match(line)) for line in texts) - int(sound.sum())
    refuse_mostly_damaged(path, "rows", damaged=lost, whole=int(sound.sum()))
    if not sound.any():
        expected, shown = "rows of date, time, day of year and four numbers", f"{len(texts)} rows, none of them so"
        raise InputError(str(path), expected=expected, found=shown, advice=ADVICE)
    values = np.where(np.abs(numbers[:, 7:]) >= MISSING, np.nan, numbers[:, 7:])[sound]
    header = {line[:24].strip().lower(): line[24:].rstrip(" |").strip() for line in lines[:begin]}
    known, nothing = dict(zip(letters, values.T, strict=True)), np.full(len(values), np.nan)
    if "D" in known:
        declination, horizontal = angles.wrap180(known["D"] / 60.0), known.get("H", nothing)
    else:
        declination = angles.wrap180(angles.direction(known["Y"], known["X"]))
        horizontal = np.hypot(known["X"], known["Y"])
    vertical = known.get("Z", nothing)
    if {"I", "F"} <= {*known} and "Z" not in known:
        vertical = known["F"] * angles.sin_cos(known["I"] / 60.0)[0]
    return header, np.stack([time_s[sound], declination, horizontal, vertical]), len(texts) - int(sound.sum())


def _number(text: str) -> float:
    """Parse the first word of a text, NaN if it is no number."""
    try:
        value = float((text.split() or ["nan"])[0])
    except ValueError:
        return float("nan")
    return value if abs(value) < MISSING else float("nan")
