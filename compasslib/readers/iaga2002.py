"""Read IAGA-2002, the exchange format of magnetic observatories (IAGA Division V-DAT, December 2001).

A header of labelled lines, a line DATE that names the four components, then one row per time. As the components and
their order vary between years, they are taken from the line DATE only. D and I are in minutes of arc, the others in nT.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers import detect
from compasslib.readers.files import read_text_bytes, refuse_mostly_damaged
from compasslib.records import FieldSeries
from compasslib.types import DAY_S, HOUR_S, Floats

MISSING = 88888.0  # this, 99999 and anything larger is missing: no geomagnetic field is as strong
CELL = r"(?:\s+|(?=[+-]))([+-]?\d+\.?\d*)"  # a sign may follow the previous number without a blank
ROW = re.compile(r"(\d{4})-(\d\d)-(\d\d)\s+(\d\d):(\d\d):(\d\d(?:\.\d*)?)\s+(\d{1,3})" + CELL * 4 + r"\s*\|?\s*")
DATED = re.compile(r"\d{4}-\d\d-\d\d\s")  # rows, damaged or not; concatenated files have headers in between
ADVICE = "give IAGA-2002 files of one observatory"
SETS = ("D", "XY")  # sets of components that determine the declination


@dataclass(frozen=True)
class _File:
    path: Path
    header: Mapping[str, str]
    time_s: Floats
    values: Mapping[str, Floats]  # (n,) by component letter, NaN where missing
    damaged: int  # number of rows


def read(paths: Sequence[str | Path]) -> FieldSeries:
    """Read the series of one observatory from its files, sorted by time without repeated times.

    Raises:
        InputError: a file is not of this format, holds no rows or no declination, or is of another station.
    """
    with detect.format_hints("iaga2002", paths, advice=ADVICE):
        files = [_read_file(Path(path)) for path in paths]
    headers = [file.header for file in files]
    station = headers[0].get("iaga code", "").upper()
    for file in files[1:]:
        code = file.header.get("iaga code", "").upper()
        if code != station:
            raise _error(file.path, f"station {station or 'without code'} as in {files[0].path}", code or "no code")
    rows = np.concatenate([np.array([file.time_s, *_field(file.values)]) for file in files], axis=1)
    _, first = np.unique(rows[0], return_index=True)
    time_s, declination, horizontal, vertical = rows[:, first]
    counts = {
        "rows": rows.shape[1],
        "damaged": sum(file.damaged for file in files),
        "repeated": rows.shape[1] - len(first),
        "missing": int(np.sum(~np.isfinite(declination))),
    }
    order_warnings = []
    for file in files:
        reported, letters = file.header.get("reported", "").upper(), "".join(file.values)
        if reported != letters and sorted(reported) == sorted(letters):
            text = f"the header reports {reported}, the line DATE has {letters}, which counts"
            order_warnings.append(f"{file.path}: {text}")
    names = [_first(headers, label) for label in ("station name", "iaga code")]
    texts = {
        "damaged": "rows are damaged, or their date and day of the year disagree; they are left out",
        "repeated": "rows repeat an instant; the first of each counts",
        "missing": "rows have no declination",
    }
    return FieldSeries(
        time_s=time_s,
        declination_deg=declination,
        horizontal_nT=horizontal,
        vertical_nT=vertical,
        station=next((name for name in names if name), "unnamed"),
        latitude=_number(_first(headers, "geodetic latitude")),
        longitude=_number(_first(headers, "geodetic longitude")),
        elevation_m=_number(_first(headers, "elevation")),
        definitive=all(header.get("data type", "").lower().startswith("definitive") for header in headers),
        counts=counts,
        warnings=(*(f"{counts[key]} {text}" for key, text in texts.items() if counts[key]), *order_warnings),
        files=tuple(str(file.path) for file in files),
        origin=np.repeat(np.arange(len(files)), [len(file.time_s) for file in files])[first],
    )


def _read_file(path: Path) -> _File:
    lines = read_text_bytes(path).decode("latin-1").splitlines()
    begin = next((k for k, line in enumerate(lines) if line.startswith("DATE")), None)
    if begin is None or "IAGA-2002" not in "".join(lines[:1]).upper():
        shown = "nothing" if not lines else repr(lines[0][:40])
        raise _error(path, "a header that begins with Format IAGA-2002 and ends with a line DATE", shown)
    letters = [name[-1].upper() for name in lines[begin].replace("|", " ").split()[3:]]
    if len(letters) != 4 or not any(set(known) <= set(letters) for known in SETS):
        shown = f"{''.join(letters) or 'none'} in the line DATE"
        advice = "variations such as HEZ hold no direction: take a file with D, or with X and Y"
        raise _error(path, "four components with D, or with X and Y", shown, advice)
    rows = [line for line in lines[begin + 1 :] if line.strip()]
    matches = [match.groups() for line in rows if (match := ROW.fullmatch(line))]
    numbers = np.array(matches, dtype=float).reshape(-1, 7 + len(letters))
    year, month, date, hour, minute, second, day_of_year = numbers[:, :7].T
    sound = (month >= 1) & (month <= 12) & (date >= 1) & (date <= 31) & (hour <= 23) & (minute <= 59) & (second < 61)
    months = np.where(sound, 12 * (year - 1970) + month - 1, 0).astype(int)
    day = months.astype("datetime64[M]").astype("datetime64[D]").astype(int) + np.where(sound, date, 1).astype(int) - 1
    began = (months // 12).astype("datetime64[Y]").astype("datetime64[D]").astype(int)
    sound &= day - began + 1 == day_of_year  # and excludes dates such as 30 February, by the month
    sound &= day.astype("datetime64[D]").astype("datetime64[M]").astype(int) == months
    time_s = DAY_S * day + HOUR_S * hour + 60.0 * minute + second
    lost = sum(bool(DATED.match(line)) for line in rows) - int(sound.sum())
    refuse_mostly_damaged(path, "rows", damaged=lost, whole=int(sound.sum()))
    if not sound.any():
        raise _error(path, "rows of date, time, day of year and four numbers", f"{len(rows)} rows, none of them so")
    values = np.where(np.abs(numbers[:, 7:]) >= MISSING, np.nan, numbers[:, 7:])[sound]
    header = {line[:24].strip().lower(): line[24:].rstrip(" |").strip() for line in lines[:begin]}
    columns = dict(zip(letters, values.T, strict=True))
    return _File(path, header, time_s[sound], columns, len(rows) - int(sound.sum()))


def _field(values: Mapping[str, Floats]) -> tuple[Floats, Floats, Floats]:
    """Compute declination (degrees), horizontal and vertical field (nT) from the available components, (n,) each."""
    nothing = np.full(len(next(iter(values.values()))), np.nan)
    if "D" in values:
        declination = angles.wrap180(values["D"] / 60.0)
        horizontal = values.get("H", nothing)
    else:
        declination = angles.wrap180(angles.direction(values["Y"], values["X"]))
        horizontal = np.hypot(values["X"], values["Y"])
    vertical = values.get("Z", nothing)
    if {"I", "F"} <= set(values) and "Z" not in values:
        vertical = values["F"] * angles.sin_cos(values["I"] / 60.0)[0]
    return declination, horizontal, vertical


def _first(headers: Sequence[Mapping[str, str]], label: str) -> str:
    return next((header[label] for header in headers if header.get(label)), "")


def _number(text: str) -> float:
    try:
        value = float(text.split()[0]) if text else float("nan")
    except ValueError:
        return float("nan")
    return value if abs(value) < MISSING else float("nan")


def _error(path: Path, expected: str, shown: str, advice: str = "") -> InputError:
    return InputError(str(path), expected=expected, found=shown, advice=advice or ADVICE)
