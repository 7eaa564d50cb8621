"""Conventions of the products: CF and ACDD by an independent checker, OceanSITES by the rules below."""

from __future__ import annotations

import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np

from compasslib.archive import variables
from compasslib.archive.attributes import SPELLINGS, missing
from compasslib.archive.files import open_netcdf
from tests.world.netcdf_layouts import OCEANSITES

CHECKER = "compliance_checker"
CF, ACDD = "cf:1.11", "acdd:1.3"
PRODUCTS = ("corrected.nc", "gridded.nc", "gridded_daily.nc")  # files that claim ACDD and OceanSITES as well as CF
# The CF table has no name for these: its orientation is from true north, and it has no deviation or declination.
UNNAMED = tuple(
    name
    for table in (variables.CORRECTED, variables.GRIDDED)
    for name, variable in table.items()
    if not variable.standard_name
)
UNAVOIDABLE = {f'variable "{name}" missing the following attributes: standard_name' for name in UNNAMED}


def installed() -> bool:
    """Return whether the checker of CF and ACDD is installed."""
    return importlib.util.find_spec(CHECKER) is not None


def remarks(path: str | Path) -> list[str]:
    """Check a file of the archive against each convention and list the remarks, except unavoidable ones.

    Args:
        path: one of ``PRODUCTS``, or another netCDF file, which is checked against CF only.

    Raises:
        InputError: the file is missing or damaged.
    """
    product = Path(path).name in PRODUCTS
    issues = [f"OceanSITES: {remark}" for remark in oceansites_remarks(path)] if product else []
    if not installed():
        return issues
    issues += [f"CF: {remark}" for remark in checked(path, CF)]
    absent = (f"{SPELLINGS[name]}/{name}" if name in SPELLINGS else name for name in not_given(path))
    unavoidable = UNAVOIDABLE | {f"Global Attributes {name} not present" for name in absent}
    asked = set(checked(path, ACDD)) - unavoidable if product else set()
    # The checker counts bins beyond surface and bottom, which are not part of the extent and have flag 4.
    asked = {remark for remark in asked if not remark.startswith("geospatial_vertical_extents_match")}
    return issues + [f"ACDD: {remark}" for remark in sorted(asked)]


def not_given(path: str | Path) -> list[str]:
    """List the global attributes that the conventions request and the YAML files do not give."""
    with open_netcdf(path) as nc:
        return missing(nc.ncattrs())


def checked(path: str | Path, checker: str) -> list[str]:
    """List the errors and warnings of a check of the compliance checker, such as ``cf:1.11``, without suggestions."""
    from compliance_checker.suite import CheckSuite  # heavy, and only in the test environment

    CheckSuite.load_all_available_checkers()
    suite = CheckSuite()
    dataset = suite.load_dataset(str(path))
    groups, errors = suite.run_all(dataset, [checker])[checker]
    dataset.close()
    failed = [group for group in groups if group.value[0] < group.value[1] and group.weight > 1]  # 1: mere suggestions
    broken = [f"the checker broke in {name}: {error[0]}" for name, error in errors.items()]
    return sorted(f"{group.name} {message}" for group in failed for message in group.msgs) + broken


# Checks of a mooring's netCDF file against the OceanSITES manual.
#
# Data Format Reference Manual 1.4 (July 2020); numbers in brackets are its sections. Checked are elements that it
# requires, and values that it prescribes for optional ones; discrete sampling geometries (2.3, notes), which it
# permits, have their own dimensions.

Rules = Iterator[tuple[str, Any]]  # a remark, and whether the file breaks the rule

MOMENT = r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d+)?)?Z"
INTERVAL = r"P(?=.)(\d+Y)?(\d+M)?(\d+D)?(T(\d+H)?(\d+M)?(\d+(\.\d+)?S)?)?"
# Global attributes that the manual requires or whose values it prescribes [2.2, 3.1 to 3.4, 4.1.1].
FIXED = {
    "site_code": r".+",
    "platform_code": r".+",
    "data_mode": r"[RPDM]",
    "data_type": r"OceanSITES (profile|time-series|trajectory) data",
    "format_version": r"1\.[1345]",
    "Conventions": r"(?=.*CF-1\.\d)(?=.*ACDD-1\.\d)(?=.*OceanSITES-1\.\d).*",
    "id": r"OS(_[^_]+){3,4}",
    "cdm_data_type": r"Station|TimeSeriesProfile",  # the manual's, and the CDM's name of this featureType
    "featureType": r"timeSeries(Profile)?",
    "source": r"(subsurface mooring|moored surface buoy|ship)",
    "update_interval": rf"void|{INTERVAL}",
    "keywords_vocabulary": r"GCMD Science Keywords|SeaDataNet Parameter Discovery Vocabulary|AGU Index Terms",
    "time_coverage_start": MOMENT,
    "time_coverage_end": MOMENT,
    "time_coverage_duration": INTERVAL,
    "time_coverage_resolution": INTERVAL,
    "date_created": MOMENT,
    "history": rf"({MOMENT} ?:? .+\n?)+",
    "QC_indicator": r"unknown|excellent|probably good|mixed",
    "processing_level": (
        r"Raw instrument data|Instrument data that has been converted to geophysical values|"
        r"Post-recovery calibrations have been applied|Data has been scaled using contextual information|"
        r"Known bad data has been replaced with (null values|values based on surrounding data)|"
        r"Ranges applied, bad data flagged|Data interpolated|Data manually reviewed|"
        r"Data verified against model or other contextual information|Other QC process applied"
    ),
}
FROM_SAMPLES = {"time_coverage_start": 1, "time_coverage_end": 1, "time_coverage_duration": 1}  # number that defines it
FROM_SAMPLES |= {"time_coverage_resolution": 2}
GIVEN = ("title", "summary")  # required too; for those that only the user can give see ``not_given``
RANGES = {
    "geospatial_lat_min": 90.0,
    "geospatial_lat_max": 90.0,
    "geospatial_lon_min": 180.0,
    "geospatial_lon_max": 180.0,
}
# Attributes of coordinates [2.4].
COORDINATES: dict[str, dict[str, str]] = {
    "TIME": {"standard_name": "time", "units": "days since 1950-01-01T00:00:00Z", "axis": "T"},
    "LATITUDE": {"standard_name": "latitude", "units": "degrees_north", "axis": "Y", "reference": "WGS84"},
    "LONGITUDE": {"standard_name": "longitude", "units": "degrees_east", "axis": "X", "reference": "WGS84"},
    "DEPTH": {"standard_name": "depth", "positive": "down", "reference": "sea_level"},
}
FRAMES = {"LATITUDE": "4326", "LONGITUDE": "4326", "DEPTH": "5831"}
# Names of table 6 that a moored current record can have.
NAMES = {
    "UCUR": "eastward_sea_water_velocity",
    "VCUR": "northward_sea_water_velocity",
    "TEMP": "sea_water_temperature",
    "PRES": "sea_water_pressure",
    "CDIR": "direction_of_sea_water_velocity",
    "CSPD": "sea_water_speed",
}
FLAGS = dict(zip((0, 1, 2, 3, 4, 7, 8, 9), OCEANSITES.split(), strict=True))  # table 2
USABLE = (1, 2, 7, 8)  # flags that a missing value must not have
ORIENTATIONS = ("upward", "downward", "horizontal")  # table 8


def oceansites_remarks(path: str | Path) -> list[str]:
    """Check a file against the OceanSITES manual and return the remarks, one sentence each.

    Raises:
        InputError: the file is missing or damaged.
    """
    with open_netcdf(path) as nc:
        apart = {*nc.dimensions, "TIME", "LATITUDE", "LONGITUDE"} | _bounds(nc)
        rules = [*_attributes(nc), *_coordinates(nc), *_names(nc)]
        for name, variable in nc.variables.items():
            rules += _data(nc, name) if variable.dtype.kind == "f" and name not in apart else []
            rules += _flags(nc, name) if name.endswith("_QC") else []
        return [remark for remark, broken in rules if broken]


def _attributes(nc: netCDF4.Dataset) -> Rules:
    samples = len(nc.dimensions.get("TIME", ()))
    for name, form in FIXED.items():
        value, defined = _attribute(nc, name), samples >= FROM_SAMPLES.get(name, 0)
        yield f"global attribute {name} is {value!r}, not one of {form}", defined and not re.fullmatch(form, value)
    there = "DEPTH" in nc.variables and np.any(_usable(nc["DEPTH"]))
    for name in (*GIVEN, *("geospatial_vertical_min", "geospatial_vertical_max") * bool(there)):
        yield f"global attribute {name} is missing", not _attribute(nc, name)
    version = f"OceanSITES-{_attribute(nc, 'format_version')}"
    yield "format_version is not the one in Conventions", version not in _attribute(nc, "Conventions")
    for name, limit in RANGES.items():
        bound = getattr(nc, name, None)
        outside = bound is None or not -limit <= float(bound) <= limit
        yield f"global attribute {name} is {bound}, not between {-limit:g} and {limit:g}", outside


def _coordinates(nc: netCDF4.Dataset) -> Rules:
    for name, expected in COORDINATES.items():
        if name not in nc.variables:
            yield f"variable {name} is missing", True
            continue
        crs = {"coordinate_reference_frame": f"urn:ogc:def:crs:EPSG::{FRAMES[name]}"} if name in FRAMES else {}
        for key, value in (expected | crs).items():
            yield f"{name}:{key} is {_attribute(nc[name], key)!r}, not {value!r}", _attribute(nc[name], key) != value
        yield f"{name} has neither QC_indicator nor {name}_QC", not _has_quality(nc, name)
    if time := nc.variables.get("TIME"):
        times = np.asarray(time[...], dtype=float)
        yield "TIME is not double TIME(TIME)", time.dtype != np.float64 or time.dimensions != ("TIME",)
        yield "TIME may have no missing values", "_FillValue" in time.ncattrs() or not np.isfinite(times).all()
        yield "TIME does not increase", not (np.diff(times) > 0).all()


def _names(nc: netCDF4.Dataset) -> Rules:
    for name in {*nc.variables} - _bounds(nc):
        variable, standard = nc[name], NAMES.get(name)
        yield f"variable {name} is not named in capitals", not re.fullmatch(r"[A-Z][A-Z0-9_]*", name)
        yield f"{name}:standard_name is not {standard}", standard and _attribute(variable, "standard_name") != standard
        left = (variables.BEAM.name, "MODE", "AFFECTED")  # CF 2.4: dimensions of neither space nor time stand first
        late = "TIME" in [other for other in variable.dimensions if other not in left][1:]
        yield f"{name}: TIME is not the first of its dimensions", late
        yield f"{name}:long_name is missing", not _attribute(variable, "long_name")


def _data(nc: netCDF4.Dataset, name: str) -> Rules:
    """Check units, fill value, coordinates and flags of a data variable [2.5, 2.6]."""
    variable, flag = nc[name], f"{name}_QC"
    placed = name in COORDINATES or name.endswith("_DEPTH") or _attribute(variable, "coordinates")
    yield f"{name}:units is missing", not _attribute(variable, "units")
    yield f"{name}:_FillValue is missing", "_FillValue" not in variable.ncattrs()
    yield f"{name}:coordinates is missing", not placed
    for key in ("coordinates", "ancillary_variables"):
        for other in _attribute(variable, key).split():
            yield f"{name}:{key} names {other}, which is not in the file", other not in nc.variables
    facing = _attribute(variable, "sensor_orientation")
    yield f"{name}:sensor_orientation is {facing!r}, not of table 8", facing not in ("", *ORIENTATIONS)
    if name.endswith("_UNCERTAINTY") and name != "HEADING_COMMON_UNCERTAINTY":  # a part of that of HEADING_CORRECTED
        base = name.removesuffix("_UNCERTAINTY")
        other = base not in nc.variables or _attribute(variable, "units") != _attribute(nc[base], "units")
        yield f"{name}:units are not those of {base}", other
        named = _attribute(variable, "long_name") == f"uncertainty of {base}"
        yield f"{name}:long_name is not 'uncertainty of {base}'", not named
    if flag not in nc.variables:
        helpers = {other for v in nc.variables.values() for other in _attribute(v, "ancillary_variables").split()}
        yield f"{name} has neither QC_indicator nor {flag}", name not in helpers and not _has_quality(nc, name)
        return
    linked = flag in _attribute(variable, "ancillary_variables").split()
    yield f"{name}:ancillary_variables does not name {flag}", not linked
    alike = nc[flag].dimensions == variable.dimensions
    yield f"{flag} has other dimensions than {name}", not alike
    yield f"{flag} calls a missing value usable", alike and np.any(~_usable(variable) & np.isin(nc[flag][...], USABLE))


def _flags(nc: netCDF4.Dataset, name: str) -> Rules:
    """Check type, name and scale of a flag variable [2.6, table 2]."""
    variable, base = nc[name], name.removesuffix("_QC")
    values, meanings = (
        np.atleast_1d(getattr(variable, "flag_values", [])),
        _attribute(variable, "flag_meanings").split(),
    )
    named = _attribute(variable, "long_name") == f"quality flag for {base}"
    yield f"{name} is not of type byte", variable.dtype != np.int8
    yield f"{name}:long_name is not 'quality flag for {base}'", not named
    yield f"{name}:flag_values are not those of table 2", values.tolist() != list(FLAGS)
    yield f"{name}:flag_meanings are not those of table 2", meanings != list(FLAGS.values())
    yield f"{name} holds a flag that table 2 has not", not np.isin(variable[...], list(FLAGS)).all()


def _has_quality(nc: netCDF4.Dataset, name: str) -> bool:
    return bool(_attribute(nc[name], "QC_indicator")) or f"{name}_QC" in nc.variables


def _bounds(nc: netCDF4.Dataset) -> set[str]:
    """Return the names of the variables of coordinate bounds, which CF exempts from attributes [7.1]."""
    return {_attribute(variable, "bounds") for variable in nc.variables.values()}


def _usable(variable: netCDF4.Variable) -> Any:
    values = np.asarray(variable[...])
    return np.isfinite(values) & (values != getattr(variable, "_FillValue", np.nan))


def _attribute(holder: Any, name: str) -> str:
    return str(getattr(holder, name, ""))
