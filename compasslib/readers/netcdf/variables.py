"""Identify netCDF variables by column map, name or standard name, and read their values in the units of records.

Names are those of OceanSITES, IMOS (imos-toolbox), EPIC (stglib, ADCPy), dolfyn and MHKiT, and of this program's own
product; standard names are CF's. Dimensions are identified by name, never by order. Sources for OceanContour, whose
series stand in groups: aodn/imos-toolbox, OceanContour parser; Nortek, Integrators Guide AD2CP.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib.earthfield import AppliedDeclination
from compasslib.errors import InputError
from compasslib.readers.cells import LARGEST
from compasslib.readers.files import refuse_large_arrays
from compasslib.readers.times import DATENUM_1970, JULIAN_DAY_1970, Unreadable, parse_origin
from compasslib.readers.vocabulary import ANGLE, FACTORS, KELVIN, SPEED, TEMPERATURE, ZERO_CELSIUS
from compasslib.types import DAY_S, HOUR_S, Floats

EPIC_DAY, EPIC_MS = "true julian day", "msec since 0:00 gmt"
DATENUM = "MatlabTimeStamp"  # of OceanContour
COMPONENTS = "dir"  # dolfyn's dimension of the components of velocities
SECONDS = {  # UDUNITS names, without plurals -> duration in seconds
    "week": 604800.0, "day": DAY_S, "d": DAY_S, "hour": HOUR_S, "hr": HOUR_S, "h": HOUR_S, "minute": 60.0, "min": 60.0,
    "second": 1.0, "sec": 1.0, "s": 1.0, "millisecond": 1e-3, "millisec": 1e-3, "msec": 1e-3, "ms": 1e-3,
    "microsecond": 1e-6, "microsec": 1e-6, "us": 1e-6, "nanosecond": 1e-9, "nanosec": 1e-9, "ns": 1e-9,
}  # fmt: skip
CALENDARS = {"": "standard", "gregorian": "standard", "standard": "standard"}
CALENDARS |= {name: name for name in ("proleptic_gregorian", "julian")}
PLACE_NAMES = {  # variables of one value, or attributes: OceanSITES, IMOS (imos-toolbox), EPIC (stglib), dolfyn
    "latitude": ("LATITUDE", "latitude", "lat", "geospatial_lat_min"),
    "longitude": ("LONGITUDE", "longitude", "lon", "geospatial_lon_min"),
    "water_depth": ("water_depth", "WATER_DEPTH", "site_nominal_depth", "sea_floor_depth_below_sea_surface"),
}
# OceanContour: attributes of the declinations that the instrument and the program added, which add up; attribute as in
# other files -> attribute of Config; orientation of the z axis in bits 25 to 27 of the status word.
DECLINATIONS = ("datainfo_transformsandcorrections_magneticdeclination", "instrument_user_decl")
OF_CONFIG = {
    "beam_angle": "datainfo_slantangles", "serial_number": "instrument_serialnumberdoppler",
    "model": "instrument_instrumentname",
}  # fmt: skip
ORIENTATIONS = {4: "up", 5: "down"}
NAMES = {  # variable names of each role, by preference
    "east": "UCUR_RECORDED UCUR_MAG UCUR EWCT u_1205 LCEWAP01 east vel_east Velocity_East Vel_East u vel[E] vel_avg[E]",
    "north": "VCUR_RECORDED VCUR_MAG VCUR NSCT v_1206 LCNSAP01 north vel_north Velocity_North Vel_North v "
    "vel[N] vel_avg[N]",
    "speed": "HCSP CSPD",
    "direction": "HCDT CDIR CDIR_MAG",
    "heading": "HEADING HEADING_MAG Hdg_1215 heading Hdg Heading",
    "tilt_x": "PITCH Ptch_1216 pitch Ptch Pitch",
    "tilt_y": "ROLL Roll_1217 roll Roll",
    "pressure": "PRES_REL PRES PRESSURE P_1 P_1ac pressure Pressure",
    "depth": "INSTRUMENT_DEPTH instrument_depth DEPTH DEPH D_3 depth",
    "temperature": "TEMP TEMPERATURE Tx_1211 T_1211 T_28 T_20 temp temperature WaterTemperature",
    "declination": "DECLINATION MAGNETIC_DECLINATION",
    "range": "HEIGHT_ABOVE_SENSOR DIST_ALONG_BEAMS BIN_RANGE bindist range distance DISTANCE Range "
    "AvgVelocityENU_Range BurstVelocityENU_Range",
    "cell_depth": "DEPTH bin_depth depth DEPTHS DEPH",
}
STANDARD_NAMES = {  # minus: opposite sign
    "east": "eastward_sea_water_velocity magnetic_eastward_sea_water_velocity",
    "north": "northward_sea_water_velocity magnetic_northward_sea_water_velocity",
    "speed": "sea_water_speed",
    "direction": "sea_water_velocity_to_direction direction_of_sea_water_velocity",
    "heading": "platform_orientation platform_yaw platform_yaw_angle platform_azimuth_angle",
    "tilt_x": "platform_pitch platform_pitch_angle platform_pitch_fore_up -platform_pitch_fore_down",
    "tilt_y": "platform_roll platform_roll_angle platform_roll_starboard_down -platform_roll_starboard_up",
    "pressure": "sea_water_pressure_due_to_sea_water sea_water_pressure",
    "depth": "depth",
    "temperature": "sea_water_temperature temperature_of_sensor_for_oxygen_in_sea_water",
    "cell_depth": "depth",
}


@dataclass(frozen=True, eq=False)
class Attributes:
    """Attributes of a file or variable; their names are in lower case."""

    attributes: Mapping[str, Any]

    def attribute(self, *names: str) -> Any:
        """Get the first existing of several attributes; None without any."""
        return next((self.attributes[name] for name in names if name in self.attributes), None)

    def text(self, name: str) -> str:
        """Get an attribute as text; empty if it does not exist."""
        return str(self.attributes.get(name, ""))


def attributes_of(holder: Any) -> dict[str, Any]:
    """Read the attributes of a netCDF file, group or variable."""
    return {name.lower(): holder.getncattr(name) for name in holder.ncattrs()}


@dataclass(frozen=True, eq=False)
class Variable(Attributes):
    """A variable of a file, or a component of dolfyn's variable of all of them, as ``vel[E]``."""

    path: Path
    source: netCDF4.Variable
    name: str
    dimensions: tuple[str, ...]
    shape: tuple[int, ...]
    key: Any = ...  # selects a component of the source

    @property
    def dtype(self) -> Any:
        """Data type, ``str`` for texts of variable length."""
        return self.source.dtype

    @property
    def is_number(self) -> bool:
        """Whether the values are numbers."""
        return bool(np.issubdtype(self.dtype, np.number))

    @property
    def spans(self) -> set[str]:
        """The dimensions that are longer than one."""
        return {name for name, size in zip(self.dimensions, self.shape, strict=True) if size > 1}

    def numbers(self) -> Floats:
        """Read unpacked values, with NaN for fill values and values out of range; errors as of ``refuse_size``."""
        refuse_size(self.path, self.source)
        with np.errstate(invalid="ignore"):
            data = np.ma.filled(np.ma.asarray(self.source[self.key]).astype(float), np.nan)
            return np.where(np.abs(data) < LARGEST, data, np.nan)

    def stored(self) -> NDArray[Any]:
        """Read values as stored, including fill values; errors as for ``numbers``."""
        refuse_size(self.path, self.source)
        self.source.set_auto_maskandscale(False)
        self.source.set_auto_chartostring(False)
        return np.asarray(self.source[self.key])


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


def refuse_truncated(path: Path, nc: netCDF4.Dataset) -> None:
    """Refuse a classic file that ends before its last value: the netCDF library reads zeros there.

    Raises:
        InputError: the file is shorter than its header declares.
    """
    if nc.data_model not in ("NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET"):
        return
    from scipy.io import netcdf_file

    try:
        with path.open("rb") as file:
            netcdf_file(file, mmap=True)  # maps the variables, without reading them
    except (ValueError, TypeError):
        expected, shown = "as many bytes as its header declares", f"{path.stat().st_size}: it is truncated"
        raise InputError(str(path), expected=expected, found=shown, advice="copy it again") from None


def is_ocean_contour(path: Path) -> bool:
    """Return whether a netCDF file has the groups of OceanContour; not if it cannot be opened."""
    try:
        with netCDF4.Dataset(path) as nc:
            return {"Data", "Config"} <= {*nc.groups}
    except OSError:
        return False


def find_series(path: Path, nc: netCDF4.Dataset) -> tuple[netCDF4.Dataset | netCDF4.Group, dict[str, Any]]:
    """Find the variables of a file and its attributes; of OceanContour's groups the averages, or else the bursts.

    Raises:
        InputError: no group has velocities to east and north.
    """
    if not nc.groups or nc.variables:
        return nc, attributes_of(nc)
    groups: dict[str, netCDF4.Group] = {}
    if {"Data", "Config"} <= {*nc.groups}:
        below = [*nc.groups["Data"].groups.values()]
        for group in below:  # extended by the groups inside
            groups |= {group.name: group} if any(re.search("(?i)vel.*east", name) for name in group.variables) else {}
            below += group.groups.values()
    if not groups:
        expected, advice = (
            "variables, or groups Config and Data of OceanContour",
            "write the group as a file of its own",
        )
        raise InputError(str(path), expected=expected, found=f"groups {', '.join(nc.groups)}", advice=advice)
    group = next(
        (group for name, group in groups.items() if name.lower().startswith("av")), next(iter(groups.values()))
    )
    config = attributes_of(nc.groups["Config"])
    stated = {key: config[name] for key, name in OF_CONFIG.items() if name in config}
    stated["magnetic_declination_applied"] = sum(float(config.get(name) or 0.0) for name in DECLINATIONS)
    if (status := group.variables.get("Status")) is not None:
        codes = np.ma.compressed(status[...]).astype(np.int64) >> 25 & 7
        usual = int(np.bincount(codes).argmax()) if len(codes) else None
        stated |= {"orientation": ORIENTATIONS[usual]} if usual in ORIENTATIONS else {}
    return group, stated


def variables_of(path: Path, nc: netCDF4.Dataset | netCDF4.Group) -> dict[str, Variable]:
    """List the variables of a file or group, and the components of dolfyn's variables as such."""
    made: dict[str, Variable] = {}
    for name, source in nc.variables.items():
        known, dimensions, shape = attributes_of(source), source.dimensions, source.shape
        made[name] = Variable(known, path, source, name, dimensions, shape)
        if COMPONENTS not in dimensions or COMPONENTS not in nc.variables or name == COMPONENTS:
            continue
        refuse_size(path, nc.variables[COMPONENTS])
        at = dimensions.index(COMPONENTS)
        for k, label in enumerate(nc.variables[COMPONENTS][:]):
            key = tuple(k if axis == at else slice(None) for axis in range(len(dimensions)))
            left, sizes = ((*each[:at], *each[at + 1 :]) for each in (dimensions, shape))
            made[f"{name}[{label}]"] = Variable(known, path, source, f"{name}[{label}]", left, sizes, key)
    return made


@dataclass(frozen=True, eq=False)
class File(Attributes):
    """An open file with its time and bin dimensions, the settings of the mooring file, and the notes of its reader."""

    path: Path
    variables: Mapping[str, Variable]
    sizes: Mapping[str, int]  # of the dimensions
    columns: Mapping[str, Any]  # role -> variable name
    meanings: Mapping[str, int]  # flag value or meaning -> OceanSITES flag
    orientation: str | None  # None defers to the file, here and below
    reference: str  # direction_reference
    declination: AppliedDeclination | None
    alignment: float | None  # heading_alignment
    suffix: str = ""  # that dolfyn appends to the names of an averaged series, including the underscore
    time: str = ""  # name of the time dimension
    bins: str | None = None  # name of the bin dimension
    notes: list[str] = field(default_factory=list)

    def note(self, sentence: str) -> None:
        """Add a sentence to the notes, unless it is there already."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    def refuse(self, variable: str, expected: str, shown: object, advice: str) -> InputError:
        """Create the error for a variable of this file."""
        return InputError(f"{self.path}: {variable}", expected=expected, found=shown, advice=advice)


def find(file: File, role: str, *dimensions: tuple[str | None, ...]) -> Variable | None:
    """Find the variable of a role that spans one of several sets of dimensions; None without any.

    Raises:
        InputError: the column map names a variable that does not exist, or several are equally likely.
    """
    if name := file.columns.get(role):
        if name not in file.variables:
            shown = f"{name!r}; it has {', '.join(file.variables)}"
            raise file.refuse(f"columns.{role}", "a variable of the file", shown, "correct columns")
        return file.variables[name]
    long = [{name for name in names if name and file.sizes[name] > 1} for names in dimensions]
    fitting = {name: v for name, v in file.variables.items() if v.spans in long and v.is_number}
    if "HEADING_CORRECTED" in file.variables:  # own product: only the recorded values are used
        fitting = {name: v for name, v in fitting.items() if name not in ("HEADING_TRUE", "UCUR", "VCUR")}
    wanted = {name.lstrip("-") for name in STANDARD_NAMES.get(role, "").split()}
    stated = {name: variable.text("standard_name") for name, variable in fitting.items()}
    named = [name for name, standard in stated.items() if standard in wanted]
    names = NAMES[role].split()
    known = [each for each in (*(f"{name}{file.suffix}" for name in names if file.suffix), *names) if each in fitting]
    likely = [name for name in known if name in named] or named
    if len(named) > 1 and likely is named:
        advice = f"name one of them in the mooring file: columns: {{{role}: {named[0]}}}"
        raise file.refuse(role, "one variable by its standard name", ", ".join(named), advice)
    if not likely:  # a different standard name excludes a variable of a matching name
        likely = [name for name in known if not (stated[name] and wanted)]
    return fitting[likely[0]] if likely else None


def values(file: File, role: str, variable: Variable) -> Floats:
    """Read a variable in the units and sign of records, (n,) or (n, m), NaN where missing.

    Raises:
        InputError: unknown units, or it has other dimensions longer than 1.
    """
    factors, unit, scale = FACTORS[role], variable.text("units").strip(), file.columns.get("scale")
    factor = factors.get(unit.lower())
    if not unit:
        factor = scale if factors is SPEED else 1.0 if factors is ANGLE else None
    if factor is None:
        known = ", ".join(list(factors)[:4])
        advice = "give the variable its units" + ", or columns: {scale: 0.01} for cm/s" * (factors is SPEED)
        raise file.refuse(variable.name, f"units such as {known}", repr(unit) if unit else "none", advice)
    if factors is SPEED and unit and scale not in (None, factor):
        raise file.refuse(variable.name, f"scale {factor:g} or none, as units are {unit}", f"{scale:g}", "delete scale")
    if f"-{variable.text('standard_name')}" in STANDARD_NAMES.get(role, "").split():
        factor = -factor
    zero = ZERO_CELSIUS if factors is TEMPERATURE and unit.lower() in KELVIN else 0.0
    return factor * arranged(file, variable) - zero


def arranged(file: File, variable: Variable, *last: str) -> Floats:
    """Read a variable along time, bins and further dimensions, as far as it has them; others must have length 1.

    Raises:
        InputError: it has other dimensions longer than 1.
    """
    names = variable.dimensions
    wanted = [name for name in (file.time, file.bins, *last) if name and name in names]
    if other := sorted(variable.spans - {*wanted}, key=names.index):
        shown = ", ".join(f"{name} ({file.sizes[name]})" for name in other)
        advice = "write one station, depth or beam a file, or name another variable in columns"
        raise file.refuse(variable.name, "dimensions of time and of one profile", shown, advice)
    data, present = variable.numbers(), [names.index(name) for name in wanted]
    others = [k for k in range(len(names)) if k not in present]
    return data.transpose([*present, *others]).reshape([data.shape[k] for k in present])


def time_variable(named: str | None, variables: Mapping[str, Variable]) -> Variable | None:
    """Find the time variable: that of the column map, EPIC's, or one with a unit "since"; None without any.

    Among several, the one along the velocities takes precedence.
    """
    if named:
        return variables.get(named)
    along = [v for v in variables.values() if v.dimensions and _unit(v)]
    epic = [v for v in along if _unit(v).startswith(EPIC_DAY)]
    since = [v for v in along if " since " in _unit(v) and _unit(v) != EPIC_MS]
    coordinates = [v for v in since if v.dimensions == (v.name,) or v.name.lower() in ("time", "time_cf")]
    candidates = [*coordinates, *(v for v in since if v.text("standard_name") == "time"), *epic, *since]
    flows = [variables[name] for name in NAMES["east"].split() if name in variables]
    along_flow = [v for flow in flows for v in candidates if v.dimensions[0] in flow.dimensions]
    return next(iter([*along_flow, *candidates]), variables.get(DATENUM))


def read_times(file: File, variable: Variable) -> Floats:
    """Read times as UTC seconds since 1970.

    Raises:
        InputError: the unit or calendar is not one of real-world times.
    """
    unit, calendar = _unit(variable), variable.text("calendar").lower()
    value = arranged(file, variable).ravel()
    if variable.name == DATENUM:
        return (value - DATENUM_1970) * DAY_S
    if unit.startswith(EPIC_DAY):
        time2 = next((v for v in file.variables.values() if _unit(v) == EPIC_MS), None)
        if time2 is None:
            advice = "add EPIC's time2 (msec since 0:00 GMT), without which the hours are unknown"
            raise file.refuse(variable.name, "EPIC's second variable of time", "none", advice)
        return (value - JULIAN_DAY_1970) * DAY_S + arranged(file, time2).ravel() / 1000.0
    word, _, since = unit.partition(" since ")
    step, known = SECONDS.get(word) or SECONDS.get(word.removesuffix("s")), CALENDARS.get(calendar)
    if step is None or known is None:
        shown = f"{unit!r}, calendar {calendar or 'not told'}"
        raise file.refuse(variable.name, "days, hours or seconds since a date", shown, "write CF's units of time")
    try:
        return parse_origin(since, known) + step * value
    except Unreadable as error:
        shown = f"{unit!r}: {error.shown}"
        raise file.refuse(f"{variable.name}: units", error.expected, shown, error.advice) from None


def _unit(variable: Variable) -> str:
    return " ".join(variable.text("units").split()).lower() if variable.is_number else ""


def read_position(path: Path) -> dict[str, float]:
    """Read latitude, longitude and water depth (m), as far as the file states each as one finite number."""
    position: dict[str, float] = {}
    with netCDF4.Dataset(path) as nc:
        variables, attributes = variables_of(path, nc), {name: nc.getncattr(name) for name in nc.ncattrs()}
        for key, names in PLACE_NAMES.items():
            for name in names:
                try:
                    value = variables[name].numbers() if name in variables else float(attributes.get(name, np.nan))
                except (TypeError, ValueError):
                    continue
                distinct = np.unique(value)
                if distinct.size == 1 and np.isfinite(distinct[0]):
                    position.setdefault(key, float(distinct[0]))
    return position
