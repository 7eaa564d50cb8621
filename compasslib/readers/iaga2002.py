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
from compasslib.types import DAY_S, HOUR_S, Bools, Floats

MISSING = 88888.0  # this, 99999 and anything larger is missing: no geomagnetic field is as strong
LABEL_ENDS = 24  # number of columns of a header label
MINUTES = 60.0  # minutes of arc per degree
CELL = r"(?:\s+|(?=[+-]))([+-]?\d+\.?\d*)"  # a sign may follow the previous number without a blank
ROW = re.compile(r"(\d{4})-(\d\d)-(\d\d)\s+(\d\d):(\d\d):(\d\d(?:\.\d*)?)\s+(\d{1,3})" + CELL * 4 + r"\s*\|?\s*")
DATED = re.compile(r"\d{4}-\d\d-\d\d\s")  # rows, damaged or not; concatenated files have headers in between
ADVICE = "give IAGA-2002 files of one observatory"
SETS = ("D", "XY")  # sets of components that determine the declination
KILOMETRE_DEG = 0.01  # largest difference in position of one station between files, about a kilometre
MOST_MISSING = 10  # largest number of distinct values that may stand for missing ones
MOST_WRONG = 0.02  # share of rows up to which invalid values are taken for damage
LEAST_MINUTES, LARGEST_MINUTES = -10800.0, 21600.0  # minutes of arc: -180 to 360 degrees
FILLERS = (0.0, 99.0, 99.99, 999.0, 999.9, 999.99, 9999.0, 9999.9, 9999.99, 32767.0, 32768.0)  # of either sign
ALONE_NT, ALONE_MINUTES = 200.0, 35.0  # distance to other values beyond any storm's
STUCK_S, FEWEST_STUCK = DAY_S, 24  # duration and rows: no declination is constant for a day at any resolution
CONTRADICTION = 0.01  # relative to F; differences between pillars of one observatory are a tenth of this
LEAST_F_NT = 10000.0  # a smaller F is a difference between two instruments
NO_BASELINE_DEG, NO_BASELINE_SHARE = 0.3, 0.02  # limits of median D, and of H relative to F, of data without baseline
SAME_DEG = 0.1  # largest difference in declination between rows of equal time


@dataclass(frozen=True)
class _File:
    path: Path
    header: Mapping[str, str]
    time_s: Floats
    values: Mapping[str, Floats]  # (n,) by component letter, NaN where missing
    counts: Mapping[str, int]  # number of rows that are damaged, with fill values, or stuck


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
        for label in ("geodetic latitude", "geodetic longitude"):
            here, there = _number(file.header.get(label, "")), _number(_first(headers, label))
            if abs(angles.difference(here, there)) > KILOMETRE_DEG:
                raise _error(file.path, f"{label} {there:g} as in the other files", f"{here:g}")
    rows = np.concatenate([np.array([file.time_s, *_field(file.values)]) for file in files], axis=1)
    _, first, which = np.unique(rows[0], return_index=True, return_inverse=True)
    time_s, declination, horizontal, vertical = rows[:, first]
    counts = {
        "rows": rows.shape[1],
        **{name: sum(file.counts[name] for file in files) for name in ("damaged", "fillers", "stuck")},
        "repeated": rows.shape[1] - len(first),
        "contradicting": int(np.sum(np.abs(angles.difference(rows[1], declination[which])) > SAME_DEG)),
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
        "fillers": "rows hold a value that stands for a missing one beside 88888 and 99999; it is not used",
        "stuck": "rows do not vary for a day and longer, as no field does; they are not used",
        "repeated": "rows repeat an instant; the first of each counts",
        "contradicting": "rows repeat an instant with another declination: two versions of the data are mixed",
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
    large = np.abs(numbers[sound, 7:]) >= MISSING
    beyond = np.unique(numbers[sound, 7:][large])
    if len(beyond) > MOST_MISSING and np.mean(np.any(large, axis=1)) > MOST_WRONG:
        # Too large for a geomagnetic field, and too many distinct values to stand for missing ones.
        raise _error(path, f"nT under {MISSING:g}", f"{beyond[-1]:g}", "write the components in nT")
    values = np.where(np.abs(numbers[:, 7:]) >= MISSING, np.nan, numbers[:, 7:])[sound]
    header = {line[:LABEL_ENDS].strip().lower(): line[LABEL_ENDS:].rstrip(" |").strip() for line in lines[:begin]}
    # Set fill values and stuck values to NaN, and count the affected rows.
    columns = dict(zip(letters, values.T, strict=True))
    filled = {letter: _fillers(letter, column) for letter, column in columns.items()}
    known = {letter: np.where(filled[letter], np.nan, column) for letter, column in columns.items()}
    stuck = {letter: _stuck(known[letter], time_s[sound]) for letter in known if letter in "DY"}
    known |= {letter: np.where(stuck[letter], np.nan, known[letter]) for letter in stuck}
    counts = {"damaged": len(rows) - int(sound.sum())}
    for name, flagged in (("fillers", filled), ("stuck", stuck)):
        counts[name] = int(np.sum(np.any([*flagged.values()], axis=0)))
    file = _File(path, header, time_s[sound], known, counts)
    _refuse_contradiction(file)
    return file


def _fillers(letter: str, column: Floats) -> Bools:
    """Flag common fill values that are isolated from all others."""
    alone = ALONE_MINUTES if letter in "DI" else ALONE_NT
    value = np.unique(column[np.isfinite(column)])
    apart = np.diff(value, prepend=-np.inf, append=np.inf)
    isolated = (np.minimum(apart[:-1], apart[1:]) > alone) & (len(value) > 1)
    return np.isin(column, value[isolated & np.isin(np.abs(value), FILLERS)])


def _stuck(column: Floats, time_s: Floats) -> Bools:
    """Flag values of a component that stay constant for a day or longer."""
    begins = np.flatnonzero(np.diff(column, prepend=np.inf) != 0.0)
    lasts = np.append(begins[1:], len(column)) - 1
    still = (time_s[lasts] - time_s[begins] >= STUCK_S) & (lasts - begins >= FEWEST_STUCK - 1)
    return np.repeat(still, lasts - begins + 1) & np.isfinite(column)


def _refuse_contradiction(file: _File) -> None:
    """Reject a declination outside its range, and a total intensity F that contradicts the components.

    Variations without a baseline are exempt, as if F were absent, because F cannot verify them.
    """
    beyond = ~_within_a_turn(file.values.get("D", np.zeros(1)))
    if np.mean(beyond) > MOST_WRONG:
        shown = f"{file.values['D'][beyond][0]:g}; seconds of arc, or another component, in its column"
        expected = f"D in minutes of arc, {LEAST_MINUTES:g} to {LARGEST_MINUTES:g}"
        raise _error(file.path, expected, shown, "correct the column")
    total = np.abs(file.values.get("F", np.full(len(file.time_s), np.nan)))
    names = "XYZ" if "X" in file.values else "HZ"
    made = np.sqrt(sum(file.values.get(name, np.nan * total) ** 2 for name in names))
    known = np.isfinite(total + made)
    if not known.any() or (middle := float(np.median(total[known]))) < LEAST_F_NT:
        return
    if np.abs(np.median((made - total)[known])) > CONTRADICTION * middle:
        declination, horizontal, _ = (column[np.isfinite(column)] for column in _field(file.values))
        about_zero = len(declination) > 0 and abs(float(np.median(declination))) < NO_BASELINE_DEG
        if about_zero or (len(horizontal) > 0 and float(np.median(horizontal)) < NO_BASELINE_SHARE * middle):
            return
        expected = f"F as {', '.join(names)} make it, {np.median(made[known]):.0f} nT"
        advice = "a component has another unit, or stands in another's column"
        raise _error(file.path, expected, f"{middle:.0f} nT", advice)


def _within_a_turn(minutes: Floats) -> Bools:
    return ~((minutes < LEAST_MINUTES) | (minutes > LARGEST_MINUTES))


def _field(values: Mapping[str, Floats]) -> tuple[Floats, Floats, Floats]:
    """Compute declination (degrees), horizontal and vertical field (nT) from the available components, (n,) each."""
    nothing = np.full(len(next(iter(values.values()))), np.nan)
    if "D" in values:
        declination = angles.wrap180(np.where(_within_a_turn(values["D"]), values["D"], np.nan) / MINUTES)
        horizontal = values.get("H", nothing)
    else:
        declination = angles.wrap180(angles.direction(values["Y"], values["X"]))
        horizontal = np.hypot(values["X"], values["Y"])
    vertical = values.get("Z", nothing)
    if {"I", "F"} <= set(values) and "Z" not in values:
        vertical = values["F"] * angles.sin_cos(values["I"] / MINUTES)[0]
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
