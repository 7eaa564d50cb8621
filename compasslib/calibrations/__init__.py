"""Calibrations that need no mooring; ``KINDS`` lists them, and a kind is imported only when it is used.

A compass turned on a bench, with a deviation of one cycle:

>>> from pathlib import Path
>>> from tempfile import TemporaryDirectory
>>> from compasslib import calibrations
>>> from compasslib.angles import sin_cos
>>> turned = range(0, 360, 15)
>>> rows = [f"{heading},{heading - 4.0 * sin_cos(heading)[0]:.1f}" for heading in turned]
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "bench.csv")
...     _ = path.write_text("\\n".join(["reference_deg,recorded_deg", *rows, ""]))
...     bench = calibrations.calibrate("platform", [path], {})
>>> round(float(bench.coefficients[1]), 1)  # B, degrees
4.0
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from compasslib.errors import InputError
from compasslib.readers import delimited, detect
from compasslib.statistics import single_threaded
from compasslib.types import Floats

if TYPE_CHECKING:  # the Snakefile needs ``KINDS`` only
    from compasslib.calibrations.result import Calibration


@dataclass(frozen=True)
class Kind:
    """Function, figures and file formats of a kind of calibration."""

    function: str  # MODULE.NAME in this package: (files, settings) -> Calibration
    figures: tuple[str, ...] = ()  # drawn by draw_NAME(path, calibration) of plots.calibrations
    by_heading: bool = True  # whether it has a deviation curve, and thus the common ``FIGURES``
    formats: tuple[str, ...] = ("table",)  # of its files, the default first


KINDS: dict[str, Kind] = {
    "platform": Kind("platform.calibrate"),
    "tilt": Kind("platform.calibrate_tilt", ("tilt",), by_heading=False),
    "magnetometer": Kind("magnetometer.calibrate", ("magnetometer",), formats=("table", "mmp_acm")),
    "swing": Kind("swing.calibrate", formats=("table", "nmea0183")),
    "declination": Kind("observatory.calibrate", ("series",), by_heading=False, formats=("iaga2002",)),
    "two_heads": Kind("two_heads.calibrate", formats=("pd0",)),
}
FIGURES = ("deviation",)  # common to all kinds with a deviation curve

MODELS = {  # descriptions of the deviation curves
    "smith": "Smith's five terms",
    "exact": "exact compass",
    "polynomial": "polynomial of degree 6",
    "one_cycle": "one cycle",
    "empirical": "empirical, six harmonics",
}

TWO_TURNS = {"deg": (-720.0, 720.0)}


def figure_names(kind: str) -> list[str]:
    """List the names of the figures of a kind of calibration."""
    return [*(FIGURES if KINDS[kind].by_heading else ()), *KINDS[kind].figures]


@single_threaded()
def calibrate(kind: str, files: Sequence[str | Path], settings: Mapping[str, Any]) -> Calibration:
    """Calibrate a compass from raw files in the order of the YAML file, with its keys as settings.

    Raises:
        InputError: a file cannot be used.
    """
    from compasslib import earthfield  # imported late: the Snakefile needs ``KINDS`` only

    module, name = KINDS[kind].function.split(".")
    function, offered = getattr(import_module(f"compasslib.calibrations.{module}"), name), KINDS[kind].formats
    form, advice = settings.get("format") or offered[0], "correct file or kind in the calibration's file"
    with detect.format_hints(form, files, offered=offered, advice=advice):
        made: Calibration = function(files, earthfield.resolve_settings(settings))
    return made


def read_columns(
    files: Sequence[str | Path],
    settings: Mapping[str, Any],
    needed: Sequence[str],
    optional: Sequence[str] = (),
    *,
    bounds: Mapping[str, tuple[float, float]] = MappingProxyType({}),
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Read columns of tables by role, concatenated over the files, within bounds by unit, and notes on the tables.

    Raises:
        InputError: a file or column is absent or withheld, or a value cannot be read or is out of bounds.
    """
    paths, named = [Path(file) for file in files], settings.get("columns") or {}
    layout, withheld = delimited.Layout.from_settings(settings), set(settings.get("withhold") or ())
    headers = {role: named.get(role) or role for role in (*needed, *optional)}
    withheld_roles = {role for role, header in headers.items() if {role, header} & withheld}
    for role in needed:
        if role in withheld_roles:
            expected, actual = "columns that the calibration can do without", f"{role}, which it needs"
            raise InputError("withhold", expected=expected, found=actual, advice="take it out of withhold")
    heads = [delimited.read_head(path, [headers[role] for role in needed], layout) for path in paths]
    there = set.intersection(*(set(head.names) for head in heads))
    wanted = {
        role: header
        for role, header in headers.items()
        if role in needed or (role not in withheld_roles and (header != role or header in there))
    }
    wanted |= delimited.date_and_clock(named, withheld)
    advice = "correct columns in the calibration's file"
    tables = [delimited.read_table(path, wanted, advice, layout) for path in paths]
    columns = {role: np.concatenate([table.columns[role] for table in tables]) for role in tables[0].columns}
    if "time" in columns:
        columns["time_utc"] = columns.pop("time")
    for role, values in columns.items():
        low, high = bounds.get(role.rpartition("_")[2], (-np.inf, np.inf))
        beyond = values[(values < low) | (values > high)]
        if beyond.size:
            raise InputError(
                f"{', '.join(map(str, paths))}: {role}",
                expected=f"numbers from {low:g} to {high:g}, or nothing",
                found=f"{beyond.size} beyond, {beyond[0]:g} first",
                advice="correct the column or its unit; leave cells without a reading empty",
            )
    return columns, delimited.table_notes(tables)
