"""Find the series of Nortek's OceanContour in its netCDF files: groups Data/Avg, Data/Burst ... and Config.

The declinations that the instrument and the program added to the directions stand in Config and add up; the
orientation stands in the status word of each sample. Sources: aodn/imos-toolbox, OceanContour parser; Nortek,
Integrators Guide AD2CP.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from compasslib.errors import InputError
from compasslib.readers.netcdf.variables import attributes_of

DECLINATIONS = ("datainfo_transformsandcorrections_magneticdeclination", "instrument_user_decl")
NAMES = {  # attribute as in other files -> of Config
    "beam_angle": "datainfo_slantangles", "serial_number": "instrument_serialnumberdoppler",
    "model": "instrument_instrumentname",
}  # fmt: skip
ORIENTATIONS = {4: "up", 5: "down"}  # bits 25 to 27 of the status word: Z up, Z down


def is_ocean_contour(path: Path) -> bool:
    """Return whether a netCDF file has the groups of OceanContour; not if it cannot be opened."""
    try:
        with netCDF4.Dataset(path) as nc:
            return {"Data", "Config"} <= {*nc.groups}
    except OSError:
        return False


def find_series(path: Path, nc: netCDF4.Dataset) -> tuple[netCDF4.Group, dict[str, Any]]:
    """Find the averages of a file, or else its bursts, and attributes by the names of other netCDF files.

    Raises:
        InputError: it has no series of velocities to east and north.
    """
    data = dict(_groups(nc.groups["Data"])) if {"Data", "Config"} <= {*nc.groups} else {}
    flows = {name: group for name, group in data.items() if any(re.search("(?i)vel.*east", v) for v in group.variables)}
    if not flows:
        expected, advice = "a group below Data with velocities to east and north", "export them from OceanContour"
        raise InputError(str(path), expected=expected, found=", ".join(data) or "none", advice=advice)
    name = next((name for name in flows if name.lower().startswith("av")), next(iter(flows)))
    stated = attributes_of(nc.groups["Config"])
    attributes: dict[str, Any] = {
        "magnetic_declination_applied": sum(float(stated.get(key) or 0.0) for key in DECLINATIONS)
    }
    attributes |= {key: stated[there] for key, there in NAMES.items() if there in stated}
    if (status := flows[name].variables.get("Status")) is not None:
        words = np.ma.compressed(status[...]).astype(np.int64) >> 25 & 7
        orientation = ORIENTATIONS.get(int(np.bincount(words).argmax())) if len(words) else None
        attributes |= {"orientation": orientation} if orientation else {}
    return flows[name], attributes


def _groups(group: netCDF4.Group) -> Iterator[tuple[str, netCDF4.Group]]:
    for name, inner in group.groups.items():
        yield name, inner
        yield from _groups(inner)
