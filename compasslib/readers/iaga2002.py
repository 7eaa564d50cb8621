"""IAGA-2002: the exchange format of magnetic observatories (IAGA Division V-DAT, December 2001).

A header of labelled lines, a line DATE that names the four components, then one row an instant. The components and
their order change from year to year, so that only the line DATE counts. D and I are minutes of arc, the others nT.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers import octets
from compasslib.records import FieldSeries

Floats = NDArray[np.floating]

MISSING = 88888.0  # and 99999; nothing on earth is as large
LABEL_ENDS = 24  # column before which a header's label stands
MINUTES = 60.0  # of arc in a degree
CELL = r"(?:\s+|(?=[+-]))([+-]?\d+\.?\d*)"  # a sign may stand against the number before
ROW = re.compile(r"(\d{4})-(\d\d)-(\d\d)\s+(\d\d):(\d\d):(\d\d(?:\.\d*)?)\s+(\d{1,3})" + CELL * 4 + r"\s*\|?\s*")
SETS = ("D", "XY")  # components of which either gives the declination
KILOMETRE_DEG = 0.01  # by which the positions of one station may differ between files


@dataclass(frozen=True)
class _File:
    """One file: its header by label, and its rows."""

    path: Path
    header: Mapping[str, str]
    time_s: Floats
    values: Mapping[str, Floats]  # (n,) by component letter, NaN where missing
    damaged: int


def read(paths: Sequence[str | Path]) -> FieldSeries:
    """Return the series of one observatory from its files, in the order of time, each instant once.

    Args:
        paths: IAGA-2002 files of one station, in any order.

    Raises:
        InputError: a file is not of this format, holds no rows or no declination, or is of another station.
    """
    files = [_file(Path(path)) for path in paths]
    _one_station(files)
    parts = [np.array([one.time_s, *_field(one.values)]) for one in files]
    every = np.concatenate(parts, axis=1)
    _, first = np.unique(every[0], return_index=True)
    time_s, declination, horizontal, vertical = every[:, first]
    counts = {
        "rows": every.shape[1],
        "damaged": sum(one.damaged for one in files),
        "repeated": every.shape[1] - len(first),
        "missing": int(np.sum(~np.isfinite(declination))),
    }
    headers = [one.header for one in files]
    names = [_first(headers, label) for label in ("station name", "iaga code")]
    return FieldSeries(
        time_s=time_s,
        declination_deg=declination,
        horizontal_nT=horizontal,
        vertical_nT=vertical,
        station=next((name for name in names if name), "unnamed"),
        latitude=_number(_first(headers, "geodetic latitude")),
        longitude=_number(_first(headers, "geodetic longitude")),
        elevation_m=_number(_first(headers, "elevation")),
        definitive=all(one.get("data type", "").lower().startswith("definitive") for one in headers),
        counts=counts,
        warnings=_warnings(counts),
    )


def _file(path: Path) -> _File:
    lines = octets.of_lines(path).decode("latin-1").splitlines()
    begin = next((k for k, line in enumerate(lines) if line.startswith("DATE")), None)
    if begin is None or "IAGA-2002" not in "".join(lines[:1]).upper():
        found = "nothing" if not lines else repr(lines[0][:40])
        raise _refused(path, "a header that begins with Format IAGA-2002 and ends with a line DATE", found)
    letters = [name[-1].upper() for name in lines[begin].replace("|", " ").split()[3:]]
    if len(letters) != 4 or not any(set(known) <= set(letters) for known in SETS):
        found = f"{''.join(letters) or 'none'} in the line DATE"
        advice = "variations such as HEZ hold no direction: take a file with D, or with X and Y"
        raise _refused(path, "four components with D, or with X and Y", found, advice)
    rows = [line for line in lines[begin + 1 :] if line.strip()]
    matches = [match.groups() for line in rows if (match := ROW.fullmatch(line))]
    cells = np.array(matches, dtype=float).reshape(-1, 7 + len(letters))
    time_s, sound = _instants(cells[:, :7])
    if not sound.any():
        raise _refused(path, "rows of date, time, day of year and four numbers", f"{len(rows)} rows, none of them so")
    values = np.where(np.abs(cells[:, 7:]) >= MISSING, np.nan, cells[:, 7:])[sound]
    header = {line[:LABEL_ENDS].strip().lower(): line[LABEL_ENDS:].rstrip(" |").strip() for line in lines[:begin]}
    damaged = len(rows) - int(sound.sum())
    return _File(path, header, time_s[sound], dict(zip(letters, values.T, strict=True)), damaged)


def _instants(cells: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the instants of rows, and which rows have a date that exists and agrees with their day of the year."""
    year, month, date, hour, minute, second, day_of_year = cells.T
    ok = (month >= 1) & (month <= 12) & (date >= 1) & (date <= 31) & (hour <= 23) & (minute <= 59) & (second < 61)
    months = np.where(ok, 12 * (year - 1970) + month - 1, 0).astype(int)
    day = months.astype("datetime64[M]").astype("datetime64[D]").astype(int) + np.where(ok, date, 1).astype(int) - 1
    began = (months // 12).astype("datetime64[Y]").astype("datetime64[D]").astype(int)
    ok &= day - began + 1 == day_of_year  # refuses 30 February too: its day is another month's
    ok &= day.astype("datetime64[D]").astype("datetime64[M]").astype(int) == months
    return 86400.0 * day + 3600.0 * hour + 60.0 * minute + second, ok


def _field(values: Mapping[str, Floats]) -> tuple[Floats, Floats, Floats]:
    """Return declination, horizontal and vertical field from the components that are there, (n,) each."""
    nothing = np.full(len(next(iter(values.values()))), np.nan)
    if "D" in values:
        declination = angles.wrap180(values["D"] / MINUTES)
        horizontal = values.get("H", nothing)
    else:
        declination = angles.wrap180(angles.direction(values["Y"], values["X"]))
        horizontal = np.hypot(values["X"], values["Y"])
    vertical = values.get("Z", nothing)
    if {"I", "F"} <= set(values) and "Z" not in values:
        vertical = values["F"] * angles.sin_cos(values["I"] / MINUTES)[0]
    return declination, horizontal, vertical


def _one_station(files: Sequence[_File]) -> None:
    first = files[0].header.get("iaga code", "").upper()
    for one in files[1:]:
        code = one.header.get("iaga code", "").upper()
        if code != first:
            raise _refused(one.path, f"station {first or 'without code'} as in {files[0].path}", code or "no code")
        for label in ("geodetic latitude", "geodetic longitude"):
            here, there = _number(one.header.get(label, "")), _number(_first([f.header for f in files], label))
            if abs(angles.difference(here, there)) > KILOMETRE_DEG:
                raise _refused(one.path, f"{label} {there:g} as in the other files", f"{here:g}")


def _first(headers: Sequence[Mapping[str, str]], label: str) -> str:
    return next((header[label] for header in headers if header.get(label)), "")


def _number(text: str) -> float:
    try:
        value = float(text.split()[0]) if text else float("nan")
    except ValueError:
        return float("nan")
    return value if abs(value) < MISSING else float("nan")


def _warnings(counts: Mapping[str, int]) -> tuple[str, ...]:
    said = {
        "damaged": "rows are damaged, or their date and day of the year disagree; they are left out",
        "repeated": "rows repeat an instant; the first of each counts",
        "missing": "rows have no declination",
    }
    return tuple(f"{counts[key]} {text}" for key, text in said.items() if counts[key])


def _refused(path: Path, expected: str, found: str, advice: str = "") -> InputError:
    return InputError(
        str(path), expected=expected, found=found, advice=advice or "give IAGA-2002 files of one observatory"
    )
