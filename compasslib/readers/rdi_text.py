"""Read text exports of RDI's WinADCP: a preamble, three header lines and one row per ensemble, separated by tabs.

The header lines hold names, in any selection (velocities: Eas and Nor, or else Mag and Dir, a column a bin), units and
bin numbers.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import times
from compasslib.readers.delimited import Body, Head, Layout, find_head, open_body
from compasslib.readers.matlab import NO_BIAS, Content, to_record
from compasslib.readers.pd12 import BEAM_ANGLE_DEG
from compasslib.records import Record, join_records
from compasslib.types import Floats

CLOCK = ("YR", "MO", "DA", "HH", "MM", "SS")  # a second HH holds the hundredths of a second
SERIES = {
    "Hea": "heading", "Pit": "tilt_x", "Rol": "tilt_y", "Pre": "pressure", "Dep": "depth", "Tem": "temperature",
    "Bat": "voltage",
}  # fmt: skip
VERTICAL = {"Ver": "up", "Err": "error_velocity"}
SPEEDS = {"mm/s": 0.001, "cm/s": 0.01, "m/s": 1.0}
LAYOUT = Layout(delimiter="\t", missing=("-32768", "32768"))
FIRST_BIN = re.compile(r"1st Bin Range \(m\)[\s=\",]*(\d{1,4}(?:\.\d*)?)(?![\d.])")
BIN_SIZE = re.compile(r"Bin Size \(m\)[\s=\",]*(\d{1,4}(?:\.\d*)?)(?![\d.])")
PINGS = re.compile(r"Pings/Ens[\s=\",]*(\d{1,5})(?![\d.])")
BETWEEN_PINGS = re.compile(r"Time/Ping[\s=\",]*(\d{1,2}):(\d\d(?:\.\d*)?)(?![\d.:])")
EXPORT = "export the series as text with WinADCP, names and units in the header, or give the PD0 file: format: pd0"


def read(paths: Sequence[Path], *, orientation: str | None) -> Record:
    """Read the ensembles of one instrument from files in order of time.

    Raises:
        InputError: a file is not such an export, lacks required columns, or has a damaged row.
    """
    return join_records([_read_file(Path(path), orientation) for path in paths])


def _read_file(path: Path, orientation: str | None) -> Record:
    head = find_head(path, lambda names: names[:7] == ["Ens", *CLOCK], LAYOUT, must=True)
    preamble = "" if head is None else head.source[: head.begin].decode(errors="replace")
    first, size = FIRST_BIN.search(preamble), BIN_SIZE.search(preamble)
    if head is None or first is None or size is None:
        expected = "a WinADCP text export: 1st Bin Range, Bin Size, and headers Ens YR MO DA HH MM SS"
        advice = f"{EXPORT}; of another text table write format: table"
        raise InputError(str(path), expected=expected, found="one without", advice=advice)
    places = {name: _places(head, name) for name in (*CLOCK, "Ori", *SERIES, *VERTICAL)}
    pair, flow, cells, factor = _find_currents(path, head)
    body = open_body(path, head, {k for each in (*places.values(), *flow) for k in each}, LAYOUT, skip=2)
    width = len(head.names) - (head.names[-1] == "")
    if (short := np.flatnonzero(body.rows.width < width)).size:
        shown = f"a line of {body.rows.width[short[0]]} cells"
        raise body.error(int(short[0]), 0, f"{width} cells as in the header", shown)
    if not len(body.rows.lines):
        raise InputError(str(path), expected="a row an ensemble", found="none", advice=EXPORT)
    clock = [places[name][0] for name in CLOCK]
    parts = [*_numbers(body, clock).T]
    parts[0] = times.full_years(parts[0])
    if hundredths := places["HH"][1:]:
        parts[-1] = parts[-1] + _numbers(body, hundredths)[:, 0] / 100.0
    time_s, wrong = times.from_parts(parts)
    if wrong is not None:
        shown = " ".join(body.column(k).text(wrong) for k in clock)
        raise body.error(wrong, clock[0], " ".join(("YR", *CLOCK[1:])), shown)
    series, _ = body.numbers({role: places[name][0] for name, role in SERIES.items() if len(places[name]) == 1})
    first_flow, second = (_numbers(body, each) for each in flow)
    series |= dict(zip(pair, (factor * first_flow, second * (factor if pair[1] == "north" else 1.0)), strict=True))
    # Upward and error velocities, if exported for the same number of bins.
    upward = {role: places[name] for name, role in VERTICAL.items() if len(places[name]) == len(cells)}
    series |= {role: factor * _numbers(body, each) for role, each in upward.items()}
    series |= {"time": time_s, "range": float(first[1]) + float(size[1]) * (cells - 1.0)}
    words = {text.lower()[:1] for k in places["Ori"][:1] for text in body.column(k)}
    pings, between = PINGS.search(preamble), BETWEEN_PINGS.search(preamble)
    average_s = int(pings[1]) * (60.0 * int(between[1]) + float(between[2])) if pings and between else 0.0
    content = Content(
        series,
        orientation or {"u": "up", "d": "down"}.get("".join(words)),
        beam_angle_deg=BEAM_ANGLE_DEG,
        dated=True,
        counts={"rows": len(time_s) + body.cut, "rows_cut": body.cut},
        notes=(
            NO_BIAS,
            *body.notes,
            *times.describe_averages(average_s, time_s),
        ),
    )
    return to_record(path, content)


def _places(head: Head, name: str) -> list[int]:
    """Find the indices of the columns with a name."""
    return [k for k, other in enumerate(head.names) if re.fullmatch(rf"{name}(\.\d+)?", other)]


def _numbers(body: Body, places: Sequence[int]) -> Floats:
    """Read columns of numbers, (rows, columns)."""
    columns, _ = body.numbers({str(k): k for k in places})
    return np.column_stack([*columns.values()])


def _find_currents(path: Path, head: Head) -> tuple[tuple[str, str], list[list[int]], Floats, float]:
    """Find the roles and columns of velocities, their bin numbers, (m,), and the factor of their unit to m/s."""
    units, bins = ([*row, *[""] * len(head.names)] for row in (*head.sample[:2], [], [])[:2])
    for pair, roles in ((("Eas", "Nor"), ("east", "north")), (("Mag", "Dir"), ("speed", "direction"))):
        first, second = (_places(head, name) for name in pair)
        if not first or len(first) != len(second):
            continue
        unit, numbers = units[first[0]].strip(), [bins[k].strip() for k in first]
        if unit not in SPEEDS or not all(number.isdigit() for number in numbers):
            shown = f"unit {unit or 'none'}, bins {' '.join(numbers[:5])}"
            expected = "a unit of mm/s, cm/s or m/s, and a number a bin below it"
            raise InputError(f"{path}: column {pair[0]}", expected=expected, found=shown, advice=EXPORT)
        return roles, [first, second], np.array(numbers, dtype=float), SPEEDS[unit]
    expected, there = "columns Eas and Nor, or Mag and Dir, of the same bins", " ".join(head.names)
    raise InputError(str(path), expected=expected, found=there, advice=EXPORT)
