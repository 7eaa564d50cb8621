"""Identify netCDF variables by column map, name or standard name, and read their values in the units of records.

Names are those of OceanSITES, IMOS (imos-toolbox), EPIC (stglib, ADCPy), dolfyn and MHKiT, and of this program's own
product; standard names are CF's. Dimensions are identified by name, never by order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib.errors import InputError
from compasslib.readers.cells import LARGEST
from compasslib.readers.files import refuse_large_arrays
from compasslib.readers.times import DATENUM_1970, JULIAN_DAY_1970, Unreadable, parse_origin
from compasslib.readers.units import ANGLE, FACTORS, KELVIN, SPEED, TEMPERATURE, ZERO_CELSIUS
from compasslib.types import DAY_S, HOUR_S, Floats

EPIC_DAY, EPIC_MS = "true julian day", "msec since 0:00 gmt"
DATENUM = "MatlabTimeStamp"  # of OceanContour
DOLFYN = ("vel", "vel_avg")  # all components in one variable: of single pings, and of averages
UNIT_WORDS = {  # duration of a unit in seconds -> its UDUNITS names, without plurals
    604800.0: ("week",),
    DAY_S: ("day", "d"),
    HOUR_S: ("hour", "hr", "h"),
    60.0: ("minute", "min"),
    1.0: ("second", "sec", "s"),
    1e-3: ("millisecond", "millisec", "msec", "ms"),
    1e-6: ("microsecond", "microsec", "us"),
    1e-9: ("nanosecond", "nanosec", "ns"),
}
SECONDS = {form: step for step, words in UNIT_WORDS.items() for word in words for form in (word, f"{word}s")}
CALENDARS = {"": "standard", "gregorian": "standard", "standard": "standard"}
CALENDARS |= {name: name for name in ("proleptic_gregorian", "julian")}
PLACE_NAMES = {  # variables of one value, or attributes: OceanSITES, IMOS (imos-toolbox), EPIC (stglib), dolfyn
    "latitude": ("LATITUDE", "latitude", "lat", "geospatial_lat_min"),
    "longitude": ("LONGITUDE", "longitude", "lon", "geospatial_lon_min"),
    "water_depth": ("water_depth", "WATER_DEPTH", "site_nominal_depth", "sea_floor_depth_below_sea_surface"),
}
NAMES = {  # variable names of each role, by preference
    "east": "UCUR_RECORDED UCUR_MAG UCUR EWCT u_1205 LCEWAP01 east vel_east Velocity_East Vel_East u",
    "north": "VCUR_RECORDED VCUR_MAG VCUR NSCT v_1206 LCNSAP01 north vel_north Velocity_North Vel_North v",
    "speed": "HCSP CSPD",
    "direction": "HCDT CDIR CDIR_MAG",
    "heading": "HEADING HEADING_MAG Hdg_1215 heading Hdg Heading",
    "tilt_x": "PITCH Ptch_1216 pitch Ptch Pitch",
    "tilt_y": "ROLL Roll_1217 roll Roll",
    "pressure": "PRES_REL PRES PRESSURE P_1 P_1ac pressure Pressure",
    "depth": "INSTRUMENT_DEPTH instrument_depth DEPTH DEPH D_3 depth",
    "temperature": "TEMP TEMPERATURE Tx_1211 T_1211 T_28 T_20 temp temperature WaterTemperature",
    "declination": "DECLINATION MAGNETIC_DECLINATION",
    "range": "HEIGHT_ABOVE_SENSOR DIST_ALONG_BEAMS BIN_RANGE bindist range distance DISTANCE Range",
    "cell_depth": "DEPTH bin_depth depth DEPTHS DEPH",
}
STANDARD_NAMES = {  # minus: opposite sign
    "east": "eastward_sea_water_velocity magnetic_eastward_sea_water_velocity",
    "north": "northward_sea_water_velocity magnetic_northward_sea_water_velocity",
    "speed": "sea_water_speed",
    "direction": "sea_water_velocity_to_direction direction_of_sea_water_velocity",
    "heading": "platform_orientation platform_yaw platform_azimuth_angle",
    "tilt_x": "platform_pitch platform_pitch_fore_up -platform_pitch_fore_down",
    "tilt_y": "platform_roll platform_roll_starboard_down -platform_roll_starboard_up",
    "pressure": "sea_water_pressure_due_to_sea_water sea_water_pressure",
    "depth": "depth",
    "temperature": "sea_water_temperature temperature_of_sensor_for_oxygen_in_sea_water",
    "cell_depth": "depth",
}


@dataclass(frozen=True)
class File:
    """An open file with its time and bin dimensions, and the notes of its reader."""

    path: Path
    nc: netCDF4.Dataset
    columns: Mapping[str, Any]  # role -> variable name, as set in the mooring file
    meanings: Mapping[str, int] = field(default_factory=dict)  # flag value or meaning -> OceanSITES flag
    suffix: str = ""  # that dolfyn appends to the names of an averaged series, including the underscore
    time: str = ""  # name of the time dimension
    bins: str | None = None  # name of the bin dimension
    notes: list[str] = field(default_factory=list)

    def note(self, sentence: str) -> None:
        """Add a sentence to the notes, unless it is there already."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def attribute(self, *names: str, variable: Any = None) -> Any:
        """Read the first existing of several attributes, of the file or of a variable; None without any."""
        holder = self.nc if variable is None else variable
        lower = {name.lower(): name for name in holder.ncattrs()}
        return next((holder.getncattr(lower[n.lower()]) for n in names if n.lower() in lower), None)

    def text(self, name: str, variable: Any = None) -> str:
        """Read an attribute as text; empty if it does not exist."""
        value = self.attribute(name, variable=variable)
        return "" if value is None else str(value)

    def labels(self, dimension: str) -> list[str]:
        """Read the coordinate labels along a dimension."""
        refuse_size(self.path, self.nc.variables[dimension])
        return [str(label) for label in self.nc.variables[dimension][:]]

    def refuse(self, variable: str, expected: str, shown: object, advice: str) -> InputError:
        """Create the error for a variable of this file."""
        return InputError(f"{self.path}: {variable}", expected=expected, found=shown, advice=advice)


def find(file: File, role: str, *dimensions: tuple[str | None, ...]) -> netCDF4.Variable | None:
    """Find the variable of a role that spans one of several sets of dimensions; None without any.

    Raises:
        InputError: the column map names a variable that does not exist, or several are equally likely.
    """
    if name := file.columns.get(role):
        if name not in file.nc.variables:
            there = ", ".join(file.nc.variables)
            shown = f"{name!r}; it has {there}"
            raise file.refuse(f"columns.{role}", "a variable of the file", shown, "correct columns")
        return file.nc.variables[name]
    long = [{name for name in names if name and file.nc.dimensions[name].size > 1} for names in dimensions]
    fitting = {n: v for n, v in file.nc.variables.items() if spans(v) in long and np.issubdtype(v.dtype, np.number)}
    if "HEADING_CORRECTED" in file.nc.variables:  # own product: only the recorded values are used
        fitting = {name: v for name, v in fitting.items() if name not in ("HEADING_TRUE", "UCUR", "VCUR")}
    wanted = {name.lstrip("-") for name in STANDARD_NAMES.get(role, "").split()}
    named = [n for n, v in fitting.items() if file.text("standard_name", v) in wanted]
    names = NAMES[role].split()
    names = [*(f"{name}{file.suffix}" for name in names if file.suffix), *names]
    known = [name for name in names if name in fitting]
    likely = [name for name in known if name in named] or named
    if len(named) > 1 and likely is named:
        advice = f"name one of them in the mooring file: columns: {{{role}: {named[0]}}}"
        raise file.refuse(role, "one variable by its standard name", ", ".join(named), advice)
    if not likely:  # a different standard name excludes a variable of a matching name
        stated = {name: file.text("standard_name", fitting[name]) for name in known}
        likely = [name for name in known if not (stated[name] and wanted and stated[name] not in wanted)]
    return fitting[likely[0]] if likely else None


def spans(variable: netCDF4.Variable) -> set[str]:
    """Select the dimensions of a variable that are longer than one."""
    return {name for name, size in zip(variable.dimensions, variable.shape, strict=True) if size > 1}


def values(file: File, role: str, variable: netCDF4.Variable, part: tuple[str, int] | None = None) -> Floats:
    """Read a variable in the units and sign of records, (n,) or (n, m), NaN where missing.

    Raises:
        InputError: unknown units.
    """
    data = arranged(file, variable, numbers(file, variable), part)
    factors, unit = FACTORS[role], file.text("units", variable).strip()
    factor = factors.get(unit.lower())
    scale = file.columns.get("scale")
    if factor is None and factors is SPEED and not unit:
        factor = scale
    if factor is None and factors is ANGLE and not unit:
        factor = 1.0
    if factor is None:
        known = ", ".join(list(factors)[:4])
        advice = "give the variable its units" + ", or columns: {scale: 0.01} for cm/s" * (factors is SPEED)
        raise file.refuse(variable.name, f"units such as {known}", repr(unit) if unit else "none", advice)
    if factors is SPEED and unit and scale not in (None, factor):
        raise file.refuse(variable.name, f"scale {factor:g} or none, as units are {unit}", f"{scale:g}", "delete scale")
    if f"-{file.text('standard_name', variable)}" in STANDARD_NAMES.get(role, "").split():
        factor = -factor
    return factor * data - (ZERO_CELSIUS if factors is TEMPERATURE and unit.lower() in KELVIN else 0.0)


def numbers(file: File, variable: netCDF4.Variable) -> Floats:
    """Read unpacked values, with NaN for fill values and values out of range; errors as for ``refuse_size``."""
    refuse_size(file.path, variable)
    with np.errstate(invalid="ignore"):
        data = np.ma.filled(np.ma.asarray(variable[...]).astype(float), np.nan)
        return np.where(np.abs(data) < LARGEST, data, np.nan)


def raw(file: File, variable: netCDF4.Variable) -> NDArray[Any]:
    """Read values as stored, including fill values; errors as for ``numbers``."""
    refuse_size(file.path, variable)
    variable.set_auto_maskandscale(False)
    variable.set_auto_chartostring(False)
    return np.asarray(variable[...])


def refuse_size(path: Path, variable: netCDF4.Variable) -> None:
    """Reject a variable that declares far more values than its file can contain.

    A few bytes can declare any number of values: those never written are not stored, and read as fill values.

    Raises:
        InputError: see ``files.refuse_large_arrays``.
    """
    stored = variable.chunking()  # chunks are decompressed as a whole
    width = variable.dtype.itemsize if isinstance(variable.dtype, np.dtype) else 8
    chunk = width * math.prod(int(size) for size in stored) if isinstance(stored, list) else 0
    declared = max(8 * math.prod(variable.shape), chunk)
    refuse_large_arrays(f"{path}: {variable.name}", declared, path.stat().st_size)


def arranged(file: File, variable: netCDF4.Variable, data: Any, part: tuple[str, int] | None = None) -> Any:
    """Transpose an array to (time, bin), with dimensions of length 1 squeezed.

    Raises:
        InputError: it has other dimensions longer than 1.
    """
    names = list(variable.dimensions)
    if part:
        data = np.take(data, part[1], axis=names.index(part[0]))
        names.remove(part[0])
    wanted = [name for name in (file.time, file.bins) if name in names]
    other = [name for name, size in zip(names, data.shape, strict=True) if name not in wanted and size > 1]
    if other:
        shown = ", ".join(f"{name} ({file.nc.dimensions[name].size})" for name in other)
        advice = "write one station, depth or beam a file, or name another variable in columns"
        raise file.refuse(variable.name, "dimensions of time and of one profile", shown, advice)
    return transposed(data, names, wanted)


def transposed(data: Any, names: Sequence[str], wanted: Sequence[str]) -> Any:
    """Transpose an array to the wanted of its named dimensions; the others must have length 1 and are squeezed."""
    others = [k for k, name in enumerate(names) if name not in wanted]
    ordered = data.transpose([*(names.index(name) for name in wanted), *others])
    return ordered.reshape([data.shape[names.index(name)] for name in wanted])


def time_variable(file_columns: str | None, nc: netCDF4.Dataset) -> netCDF4.Variable | None:
    """Find the time variable: that of the column map, EPIC's, or one with a unit "since"; None without any.

    Among several, the one along the velocities takes precedence.
    """
    if file_columns:
        return nc.variables.get(file_columns)
    along = [v for v in nc.variables.values() if v.ndim >= 1 and _unit(v)]
    epic = [v for v in along if _unit(v).startswith(EPIC_DAY)]
    since = [v for v in along if " since " in _unit(v) and _unit(v) != EPIC_MS]
    coordinates = [v for v in since if v.dimensions == (v.name,) or v.name.lower() in ("time", "time_cf")]
    named = [v for v in since if getattr(v, "standard_name", "") == "time"]
    flows = [nc.variables[name] for name in (*NAMES["east"].split(), *DOLFYN) if name in nc.variables]
    candidates = [*coordinates, *named, *epic, *since]
    along_flow = [v for flow in flows for v in candidates if v.dimensions[0] in flow.dimensions]
    return next(iter([*along_flow, *candidates]), nc.variables.get(DATENUM))


def read_times(file: File, variable: netCDF4.Variable) -> Floats:
    """Read times as UTC seconds since 1970.

    Raises:
        InputError: the unit or calendar is not one of real-world times.
    """
    unit, calendar = _unit(variable), str(getattr(variable, "calendar", "")).lower()
    value = arranged(file, variable, numbers(file, variable)).ravel()
    if variable.name == DATENUM:
        return (value - DATENUM_1970) * DAY_S
    if unit.startswith(EPIC_DAY):
        time2 = next((v for v in file.nc.variables.values() if _unit(v) == EPIC_MS), None)
        if time2 is None:
            advice = "add EPIC's time2 (msec since 0:00 GMT), without which the hours are unknown"
            raise file.refuse(variable.name, "EPIC's second variable of time", "none", advice)
        return (value - JULIAN_DAY_1970) * DAY_S + arranged(file, time2, numbers(file, time2)).ravel() / 1000.0
    word, _, since = unit.partition(" since ")
    step, known = SECONDS.get(word), CALENDARS.get(calendar)
    if step is None or known is None:
        shown = f"{unit!r}, calendar {calendar or 'not told'}"
        raise file.refuse(variable.name, "days, hours or seconds since a date", shown, "write CF's units of time")
    try:
        return parse_origin(since, known) + step * value
    except Unreadable as error:
        shown = f"{unit!r}: {error.shown}"
        raise file.refuse(f"{variable.name}: units", error.expected, shown, error.advice) from None


def _unit(variable: netCDF4.Variable) -> str:
    unit = " ".join(str(getattr(variable, "units", "")).split()).lower()
    return unit if np.issubdtype(variable.dtype, np.number) else ""


def read_position(path: Path) -> dict[str, float]:
    """Read latitude, longitude and water depth (m), as far as the file states each as one finite number."""
    with netCDF4.Dataset(path) as nc:
        each = {key: [_number(path, nc, name) for name in names] for key, names in PLACE_NAMES.items()}
    values = {key: next(filter(np.isfinite, numbers), np.nan) for key, numbers in each.items()}
    return {key: float(value) for key, value in values.items() if np.isfinite(value)}


def _number(path: Path, nc: netCDF4.Dataset, name: str) -> float:
    """Read the only distinct number in a variable or attribute; NaN if it has none or several."""
    if name in nc.variables:
        refuse_size(path, nc.variables[name])
    value = nc.variables[name][...] if name in nc.variables else getattr(nc, name, np.nan)
    try:
        values: Floats = np.unique(np.ma.filled(np.ma.asarray(value, dtype=float), np.nan))
    except (TypeError, ValueError):
        return float("nan")
    return float(values[0]) if values.size == 1 else float("nan")
