"""Read text exports of RDI's WinADCP: a preamble, three header lines and one row per ensemble, separated by tabs.

The preamble states the range of the first bin and the bin size; the header lines hold column names (one per bin:
Eas Eas Eas ...), units and bin numbers. Columns are identified by name, in any selection; velocities are Eas and Nor,
or else Mag and Dir. The ASCII formats of WinRiver and VMDAS are not supported.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compasslib import angles
from compasslib.errors import InputError
from compasslib.readers.files import count_unprintable, read_text_bytes
from compasslib.readers.pd0.currents import true_pitch
from compasslib.readers.pd0.fields import LAST_YEAR
from compasslib.readers.pd12 import BEAM_ANGLE_DEG
from compasslib.readers.times import FIRST_YEAR, civil_seconds, describe_averages
from compasslib.records import Record, join_records, new_record
from compasslib.types import Floats

CLOCK = ("YR", "MO", "DA", "HH", "MM", "SS", "HH")  # the second HH: hundredths
VERTICAL = {"Ver": "up", "Err": "error_velocity"}
SPEEDS = {"mm/s": 0.001, "cm/s": 0.01, "m/s": 1.0}
MISSING_TEXT = ("", "-32768", "32768")
NO_BIAS = "A text export does not hold the heading bias EB: none was taken out but for declination_applied."
NUMBER = re.compile(r"[-+]?(\d{1,9}(\.\d*)?|\.\d+)", re.ASCII)
FIRST_BIN = re.compile(r"1st Bin Range \(m\)[\s=\",]*(\d{1,4}(?:\.\d*)?)(?![\d.])")
BIN_SIZE = re.compile(r"Bin Size \(m\)[\s=\",]*(\d{1,4}(?:\.\d*)?)(?![\d.])")
PINGS = re.compile(r"Pings/Ens[\s=\",]*(\d{1,5})(?![\d.])")
BETWEEN_PINGS = re.compile(r"Time/Ping[\s=\",]*(\d{1,2}):(\d\d(?:\.\d*)?)(?![\d.:])")
EXPORT = "export the series as text with WinADCP, names and units in the header, or give the PD0 file: format: pd0"


@dataclass(frozen=True)
class _Table:
    """Rows of a file, and the contents of its preamble and header lines."""

    path: Path
    names: list[str]
    units: list[str]
    bins: list[str]
    rows: list[list[str]]
    first_bin: float  # metres, range of the first bin
    bin_size: float  # metres
    average_s: float  # averaging time of an ensemble, 0 if the preamble does not state it
    cut: int  # number of truncated last lines dropped, 0 or 1

    def places(self, name: str) -> list[int]:
        """Find the indices of the columns with a name."""
        return [k for k, other in enumerate(self.names) if other == name]


def read(paths: Sequence[Path], *, orientation: str | None) -> Record:
    """Read the ensembles of one instrument from files in order of time.

    Args:
        orientation: up or down; None uses the column Ori of the file.

    Raises:
        InputError: a file is not such an export, lacks required columns, or has a damaged row.
    """
    return join_records([_to_record(_read_table(Path(path)), orientation) for path in paths])


def _to_record(table: _Table, orientation: str | None) -> Record:
    time_s = _times(table)
    n = len(time_s)
    east, north, cells = _currents(table)
    heading = _series(table, "Hea", n)
    heading = np.where((heading >= 0.0) & (heading <= 360.0), angles.wrap360(np.nan_to_num(heading)), np.nan)
    pitch, roll = _series(table, "Pit", n), _series(table, "Rol", n)
    # Upward and error velocities, if exported for the same number of bins, (n, m) m/s.
    profiles = {}
    for name, key in VERTICAL.items():
        places = table.places(name)
        if len(places) == east.shape[1] and (unit := table.units[places[0]]) in SPEEDS:
            profiles[key] = SPEEDS[unit] * np.column_stack([_column(table, k) for k in places]).astype(np.float32)
    return new_record(
        time_s,
        east,
        north,
        bin_range_m=table.first_bin + table.bin_size * (cells - 1.0),
        heading_deg=heading,
        pitch_deg=true_pitch(pitch, roll),
        roll_deg=roll,
        pressure_dbar=_series(table, "Pre", n),
        depth_m=_series(table, "Dep", n),
        temperature_c=_series(table, "Tem", n),
        supply_voltage=_series(table, "Bat", n),
        looks_up=_looks_up(table, orientation),
        beam_angle_deg=BEAM_ANGLE_DEG,
        profiles=profiles,
        counts={"rows": n + table.cut, "rows_cut": table.cut},
        warnings=(
            NO_BIAS,
            *["the last line was cut short and left out"] * table.cut,
            *describe_averages(table.average_s, time_s),
        ),
    )


def _read_table(path: Path) -> _Table:
    data = read_text_bytes(path)
    text = data.decode("latin-1")
    lines = text.splitlines()
    cells = [[cell.strip().strip('"').strip() for cell in line.split("\t")] for line in lines]
    at = next((k for k, row in enumerate(cells[:100]) if row[:7] == ["Ens", *CLOCK[:6]]), None)
    first, size = FIRST_BIN.search(text[:10000]), BIN_SIZE.search(text[:10000])
    if at is None or first is None or size is None or count_unprintable(data[:10000]):
        raise InputError(
            str(path),
            expected="a WinADCP text export: 1st Bin Range, Bin Size, and headers Ens YR MO DA HH MM SS",
            found=_kind(lines, data),
            advice=f"{EXPORT}; of another text table write format: table",
        )
    names, units, bins = (cells[at + k] if len(cells) > at + k else [] for k in range(3))
    numbered = [(k, row) for k, row in enumerate(cells[at + 3 :], at + 4) if any(row)]
    width = len(names) - (names[-1] == "")
    cut = int(bool(numbered) and not text.endswith(("\n", "\r")) and len(numbered[-1][1]) < width)
    rows = numbered[: len(numbered) - cut]
    for line, row in rows:
        if not width <= len(row) <= width + 1 or any(row[width:]):
            raise InputError(
                f"{path}: line {line}",
                expected=f"{width} cells as in the header",
                found=f"a line of {len(row)} cells",
                advice="mend or remove the line",
            )
    pings, between = PINGS.search(text[:10000]), BETWEEN_PINGS.search(text[:10000])
    average_s = int(pings[1]) * (60.0 * int(between[1]) + float(between[2])) if pings and between else 0.0
    cells = [row for _, row in rows]
    return _Table(path, names[:width], units, bins, cells, float(first[1]), float(size[1]), average_s, cut)


def _kind(lines: Sequence[str], data: bytes) -> str:
    """Describe the apparent kind of an unsupported file."""
    if data[:2] == b"\x7f\x7f":
        return "a binary PD0 file"
    if any("Ens" in line and "YR" in line for line in lines[:100]):
        return "such headers without the range of the first bin, its size, or tabs"
    leader = [line.split() for line in lines[2:4]]
    if len(leader) == 2 and len(leader[0]) == 7 and len(leader[1]) == 13:
        return "what looks like the ASCII output of WinRiver, whose headings are corrected by an unknown declination"
    return f"a file that begins with {data[:16]!r}" if data else "an empty file"


def _column(table: _Table, place: int) -> Floats:
    texts = [row[place] for row in table.rows]
    wrong = next((text for text in texts if text not in MISSING_TEXT and not NUMBER.fullmatch(text)), None)
    if wrong is not None:
        where = f"{table.path}: column {table.names[place]}"
        raise InputError(where, expected="numbers", found=repr(wrong), advice="mend or remove the line")
    return np.array([np.nan if text in MISSING_TEXT else float(text) for text in texts])


def _series(table: _Table, name: str, n: int) -> Floats:
    places = table.places(name)
    return _column(table, places[0]) if len(places) == 1 else np.full(n, np.nan)


def _times(table: _Table) -> Floats:
    hundredths = table.places("HH")[1:]
    if not table.rows:
        raise InputError(str(table.path), expected="a row an ensemble", found="none", advice=EXPORT)
    later = _column(table, hundredths[0]) if hundredths else np.zeros(len(table.rows))
    clock = np.column_stack([*(_column(table, k) for k in range(1, 7)), later])
    whole = np.nan_to_num(clock, nan=-1.0).astype(np.int64)
    century = np.where(whole[:, 0] >= 1900, 0, np.where(whole[:, 0] >= FIRST_YEAR - 1900, 1900, 2000))
    time_s = civil_seconds(whole[:, 0] + century, *whole[:, 1:].T, last_year=LAST_YEAR)
    if (wrong := np.isnan(time_s)).any():
        where, shown = f"{table.path}: time", " ".join(table.rows[int(np.argmax(wrong))][1:7])
        raise InputError(where, expected="YR MO DA HH MM SS", found=shown, advice="mend or remove the line")
    return time_s


def _currents(table: _Table) -> tuple[Floats, Floats, Floats]:
    """Compute east and north velocities, (n, m) m/s, and their bin numbers, (m,)."""
    for pair in (("Eas", "Nor"), ("Mag", "Dir")):
        first_places, second_places = (table.places(name) for name in pair)
        if not first_places or len(first_places) != len(second_places):
            continue
        unit = table.units[first_places[0]] if len(table.units) > first_places[0] else ""
        numbers = [table.bins[k] if len(table.bins) > k else "" for k in first_places]
        if unit not in SPEEDS or not all(number.isdigit() for number in numbers):
            shown = f"unit {unit or 'none'}, bins {' '.join(numbers[:5])}"
            expected = "a unit of mm/s, cm/s or m/s, and a number a bin below it"
            raise InputError(f"{table.path}: column {pair[0]}", expected=expected, found=shown, advice=EXPORT)
        each = ([_column(table, k) for k in places] for places in (first_places, second_places))
        first, second = map(np.column_stack, each)
        cells = np.array([float(number) for number in numbers])
        if pair[0] == "Eas":
            return SPEEDS[unit] * first, SPEEDS[unit] * second, cells
        return *angles.components(SPEEDS[unit] * first, second), cells
    there = " ".join(dict.fromkeys(table.names))
    expected = "columns Eas and Nor, or Mag and Dir, of the same bins"
    raise InputError(str(table.path), expected=expected, found=there, advice=EXPORT)


def _looks_up(table: _Table, orientation: str | None) -> bool:
    places = table.places("Ori")
    words = {row[places[0]].lower()[:1] for row in table.rows} if places else set()
    stated = "up" if words == {"u"} else "down" if words == {"d"} else None
    if not (orientation or stated):
        shown = f"{len(words)} kinds of column Ori" if places else "no column Ori"
        advice = "write orientation: up or down"
        raise InputError(str(table.path), expected="the orientation", found=shown, advice=advice)
    return (orientation or stated) == "up"
