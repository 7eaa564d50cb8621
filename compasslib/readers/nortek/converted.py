"""Read the text files to which Nortek's programs convert a recording (.hdr with .dat, or .sen, .v1, .a1 ...).

The header file states the configuration and, for every other file, its columns by number and name; the samples are
those of the binary file, in the same coordinates. Source: Nortek, Comprehensive Manual (2018), data conversion.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from compasslib.errors import InputError
from compasslib.readers.delimited import Layout, read_head, read_table
from compasslib.readers.files import read_text
from compasslib.readers.nortek.packets import SLANT_DEG, Coordinates, Samples
from compasslib.readers.times import Ints
from compasslib.records import BAD, GOOD, MISSING
from compasslib.types import Floats

HEADER = ".hdr"
LAYOUT = Layout(header=0, delimiter=" ")
CLOCK = ("year", "month", "day", "hour", "minute", "second")
SENSORS = ("heading", "pitch", "roll", "pressure", "temperature", "battery voltage", "error code", "status code")
SYSTEMS = {"ENU": Coordinates.EARTH, "XYZ": Coordinates.INSTRUMENT, "BEAM": Coordinates.BEAM}
_SECTION = re.compile(r"^\[(?:.*[\\/])?[^\]\\/]*\.(\w+)\]\s*$", re.MULTILINE)
_COLUMN = re.compile(r"^ *(\d+) +(\S.*?)(?:  .*|\t.*| *\([^)]*\) *)?$", re.MULTILINE)


def header_of(path: Path) -> Path | None:
    """Find the header file that belongs to a text file, or is it; None without one, or for a recording (A5)."""
    candidates = (path, *(path.with_suffix(suffix) for suffix in (HEADER, HEADER.upper())))
    match = next((each for each in candidates if each.suffix.lower() == HEADER and each.is_file()), None)
    if match is None or not path.is_file():
        return match
    with path.open("rb") as stream:
        return None if stream.read(1) == b"\xa5" else match


def decode(header: Path) -> Samples:
    """Decode the samples of a conversion by its header file.

    Raises:
        InputError: a file is absent or damaged, or the header does not state what its columns are.
    """
    text = read_text(header)[0].decode()
    pieces = _SECTION.split(text)
    columns = {
        suffix.lower(): {name.lower(): int(k) for k, name in reversed(_COLUMN.findall(body))}  # dbar stands before m
        for suffix, body in zip(pieces[1::2], pieces[2::2], strict=True)
    }
    source = next((suffix for suffix in ("sen", "dat") if {*CLOCK, "heading"} <= columns.get(suffix, {}).keys()), None)
    system = SYSTEMS.get(_stated(text, "Coordinate system"))
    if source is None or system is None:
        expected = "a conversion of an Aquadopp or AWAC: a coordinate system, and columns of the time and heading"
        advice = "give the file that the instrument recorded"
        raise InputError(
            str(header), expected=expected, found=", ".join(columns) or "no list of columns", advice=advice
        )
    names = columns[source]
    wanted = {name: names[name] for name in SENSORS if name in names}
    velocities = sorted(k for name, k in names.items() if name.startswith("velocity"))
    wanted |= {f"velocity {beam}": k for beam, k in enumerate(velocities)}
    table = read_table(_sibling(header, source), {"time": [names[part] for part in CLOCK], **wanted}, layout=LAYOUT)
    values = {name: table.columns.get(name, np.full(table.rows, np.nan)) for name in SENSORS}
    cells, ranges = 1, (0.0,)
    if velocities:
        velocity = np.stack([table.columns[f"velocity {beam}"] for beam in range(3)], axis=-1)[:, None]
    else:
        cells = int(_number(header, text, "Number of cells"))
        velocity = np.stack([_matrix(header, f"v{beam}", cells, table.rows) for beam in (1, 2, 3)], axis=-1)
        size, blanking = _number(header, text, "Cell size"), _number(header, text, "Blanking distance")
        ranges = tuple((blanking + size * (1.0 + np.arange(cells))).tolist())
    failed, status = _bits(values["error code"]), _bits(values["status code"])
    flags = np.where((failed & 7 > 0) | (status & 12 > 0), BAD, GOOD)
    heading = np.where((values["heading"] >= 0.0) & (values["heading"] <= 360.0), values["heading"], np.nan)
    matrix: tuple[tuple[float, ...], ...] = ()
    if system == Coordinates.BEAM:
        if (match := re.search(r"Transformation matrix((?:\s+-?\d+\.\d+){9})", text)) is None:
            advice = "give the file that the instrument recorded"
            raise InputError(str(header), expected="a transformation matrix of 9 numbers", found="none", advice=advice)
        matrix = tuple(map(tuple, np.reshape(match[1].split(), (3, 3)).astype(float).tolist()))
    return Samples(
        offset=np.zeros(table.rows, dtype=np.int64),
        time_s=table.columns["time"],
        heading_deg=heading,
        pitch_deg=values["pitch"],
        roll_deg=values["roll"],
        pressure_dbar=values["pressure"],
        temperature_c=values["temperature"],
        supply_voltage=values["battery voltage"],
        velocity=velocity[..., :2] if system == Coordinates.EARTH else velocity,
        up=velocity[..., 2] if system == Coordinates.EARTH else None,
        quality=np.where(np.isnan(velocity).any(axis=-1), MISSING, flags[:, None]).astype(np.int8),
        heading_quality=np.where((failed & 1 > 0) | (status & 12 > 0), BAD, GOOD).astype(np.int8),
        looks_up=status & 1 == 0,
        bin_range_m=ranges,
        recorded=system,
        beam_angle_deg=0.0 if velocities else SLANT_DEG,
        serial=(_stated(text, "Serial number") or _stated(text, "Hardware serial number")),
        beams_to_axes=matrix,
        average_s=_number(header, text, "Average interval"),
        counts={"diagnostic_samples": 0, "other_lengths": 0},
    )


def _stated(text: str, name: str) -> str:
    """Find the value of a line of the header; empty without one."""
    match = re.search(rf"^{name} {{2,}}(.*\S)", text, re.MULTILINE)
    return match[1] if match else ""


def _number(header: Path, text: str, name: str) -> float:
    """Find the number of a line of the header, centimetres converted to metres."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(\S*)", value := _stated(text, name))
    if match is None:
        raise InputError(
            f"{header}: {name}", expected="a number", found=value or "none", advice="convert the recording again"
        )
    return float(match[1]) * (0.01 if match[2] == "cm" else 1.0)


def _sibling(header: Path, suffix: str) -> Path:
    """Find a file of the same conversion, whose suffix may have capital letters."""
    there = [header.with_suffix(f".{each}") for each in (suffix, suffix.upper())]
    if path := next(filter(Path.is_file, there), None):
        return path
    advice = "give all files of the conversion in one folder"
    raise InputError(str(there[0]), expected="a file of the conversion beside its header", found="none", advice=advice)


def _matrix(header: Path, suffix: str, cells: int, rows: int) -> Floats:
    """Read one component or beam of all profiles, (n, cells), behind any counters of bursts."""
    path = _sibling(header, suffix)
    width = len(read_head(path, [1], LAYOUT).names)
    table = read_table(path, {str(k): width - cells + k for k in range(1, cells + 1)}, layout=LAYOUT)
    if table.rows != rows:
        expected, advice = f"{rows} rows, as the sensors have", "convert the recording again"
        raise InputError(str(path), expected=expected, found=f"{table.rows}", advice=advice)
    return np.column_stack([*table.columns.values()])


def _bits(digits: Floats) -> Ints:
    """Read numbers of which each digit is a bit, as 110000."""
    whole = np.nan_to_num(digits).astype(np.int64)
    return sum(((whole // 10**k % 10) << k for k in range(8)), np.zeros(len(whole), dtype=np.int64))
