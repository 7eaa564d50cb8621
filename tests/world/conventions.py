"""Conventions of the products: CF and ACDD by an independent checker, OceanSITES by the rules below."""

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

CF, ACDD = "cf:1.11", "acdd:1.3"
PRODUCTS = ("corrected.nc", "gridded.nc", "gridded_daily.nc")  # files that claim ACDD and OceanSITES as well as CF
# The CF table has no name for these: its orientation is from true north, and it has no deviation or declination.
UNAVOIDABLE = {
    f'variable "{name}" missing the following attributes: standard_name'
    for table in (variables.CORRECTED, variables.GRIDDED)
    for name, variable in table.items()
    if not variable.standard_name
}


def installed() -> bool:
    """Return whether the checker of CF and ACDD is installed."""
    return importlib.util.find_spec("compliance_checker") is not None


def remarks(path: str | Path) -> list[str]:
    """Check one of ``PRODUCTS``, or another file against CF only, and list the remarks, except unavoidable ones."""
    product = Path(path).name in PRODUCTS
    issues = [f"OceanSITES: {remark}" for remark in oceansites_remarks(path)] if product else []
    if not installed():
        return issues
    issues += [f"CF: {remark}" for remark in checked(path, CF)]
    with open_netcdf(path) as nc:
        not_given = missing(nc.ncattrs())
    absent = (f"{SPELLINGS[name]}/{name}" if name in SPELLINGS else name for name in not_given)
    unavoidable = UNAVOIDABLE | {f"Global Attributes {name} not present" for name in absent}
    asked = set(checked(path, ACDD)) - unavoidable if product else set()
    # The checker counts bins beyond surface and bottom, which are not part of the extent and have flag 4.
    asked = {remark for remark in asked if not remark.startswith("geospatial_vertical_extents_match")}
    return issues + [f"ACDD: {remark}" for remark in sorted(asked)]


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


# OceanSITES Data Format Reference Manual 1.4 (July 2020): elements that it requires, and values that it prescribes.
MOMENT = r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d+)?)?Z"
INTERVAL = r"P(?=.)(\d+Y)?(\d+M)?(\d+D)?(T(\d+H)?(\d+M)?(\d+(\.\d+)?S)?)?"
# Global attributes that the manual requires or whose values it prescribes [2.2, 3.1 to 3.4, 4.1.1].
FIXED = {
    **dict.fromkeys(("site_code", "platform_code", "title", "summary"), r"[\s\S]+"),
    "data_mode": r"[RPDM]",
    "data_type": r"OceanSITES (profile|time-series|trajectory) data",
    "format_version": r"1\.[1345]",
    "Conventions": r"(?=.*CF-1\.\d)(?=.*ACDD-1\.\d)(?=.*OceanSITES-1\.4).*",
    "id": r"OS(_[^_]+){3,4}",
    "cdm_data_type": r"Station|TimeSeriesProfile",  # the manual's, and the CDM's name of this featureType
    "featureType": r"timeSeries(Profile)?",
    "source": r"(subsurface mooring|moored surface buoy|ship)",
    "update_interval": rf"void|{INTERVAL}",
    "keywords_vocabulary": r"GCMD Science Keywords|SeaDataNet Parameter Discovery Vocabulary|AGU Index Terms",
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
OF_SAMPLES = {  # with the number of samples from which they are defined
    **{f"time_coverage_{end}": (MOMENT, 1) for end in ("start", "end")},
    "time_coverage_duration": (INTERVAL, 1),
    "time_coverage_resolution": (INTERVAL, 2),
}
# Attributes of coordinates [2.4].
EPSG = "urn:ogc:def:crs:EPSG::"
COORDINATES: dict[str, dict[str, str]] = {
    "TIME": {"standard_name": "time", "units": "days since 1950-01-01T00:00:00Z", "axis": "T"},
    "LATITUDE": {"standard_name": "latitude", "units": "degrees_north", "axis": "Y", "reference": "WGS84"},
    "LONGITUDE": {"standard_name": "longitude", "units": "degrees_east", "axis": "X", "reference": "WGS84"},
    "DEPTH": {"standard_name": "depth", "positive": "down", "reference": "sea_level"},
}
for _name, _frame in (("LATITUDE", "4326"), ("LONGITUDE", "4326"), ("DEPTH", "5831")):
    COORDINATES[_name]["coordinate_reference_frame"] = EPSG + _frame
# Names of table 6 that a moored current record can have.
NAMES = {
    "UCUR": "eastward_sea_water_velocity",
    "VCUR": "northward_sea_water_velocity",
    "TEMP": "sea_water_temperature",
    "PRES": "sea_water_pressure",
}
FLAGS = {  # table 2
    0: "unknown",
    1: "good_data",
    2: "probably_good_data",
    3: "potentially_correctable_bad_data",
    4: "bad_data",
    7: "nominal_value",
    8: "interpolated_value",
    9: "missing_value",
}
USABLE = (1, 2, 7, 8)  # flags that a missing value must not have
NOT_OF_TIME = (variables.BEAM.name, "MODE", "AFFECTED")  # CF 2.4: dimensions of neither space nor time stand first


def oceansites_remarks(path: str | Path) -> list[str]:
    """Check a file against the OceanSITES manual and return the remarks, one sentence each."""
    with open_netcdf(path) as nc:
        bounds = {_attribute(variable, "bounds") for variable in nc.variables.values()}  # exempt by CF 7.1
        apart = {*nc.dimensions, "TIME", "LATITUDE", "LONGITUDE"} | bounds
        data = [name for name, variable in nc.variables.items() if variable.dtype.kind == "f" and name not in apart]
        issues = [*_whole(nc), *(remark for name in nc.variables if name not in bounds for remark in _named(nc, name))]
        issues += [remark for name in data for remark in _data(nc, name)]
        return issues + [remark for name in nc.variables if name.endswith("_QC") for remark in _flags(nc, name)]


def _whole(nc: netCDF4.Dataset) -> Iterator[str]:
    """Check global attributes, coordinates and times."""
    samples = len(nc.dimensions.get("TIME", ()))
    of_samples = {name: form for name, (form, least) in OF_SAMPLES.items() if samples >= least}
    for name, form in (FIXED | of_samples).items():
        if not re.fullmatch(form, _attribute(nc, name)):
            yield f"global attribute {name} is {_attribute(nc, name)!r}, not one of {form}"
    for name, limit in (("lat_min", 90.0), ("lat_max", 90.0), ("lon_min", 180.0), ("lon_max", 180.0)):
        if not abs(float(getattr(nc, f"geospatial_{name}", np.inf))) <= limit:
            yield f"global attribute geospatial_{name} is not between {-limit:g} and {limit:g}"
    if "DEPTH" in nc.variables and np.any(_usable(nc["DEPTH"])):
        ends = {f"geospatial_vertical_{end}" for end in ("min", "max")} - {*nc.ncattrs()}
        yield from (f"global attribute {name} is missing" for name in ends)
    for name, expected in COORDINATES.items():
        if name not in nc.variables:
            yield f"variable {name} is missing"
            continue
        for key, value in expected.items():
            if _attribute(nc[name], key) != value:
                yield f"{name}:{key} is {_attribute(nc[name], key)!r}, not {value!r}"
        if not _attribute(nc[name], "QC_indicator") and f"{name}_QC" not in nc.variables:
            yield f"{name} has neither QC_indicator nor {name}_QC"
    times = np.asarray(nc["TIME"][...], dtype=float)
    if nc["TIME"].dtype != np.float64 or nc["TIME"].dimensions != ("TIME",) or "_FillValue" in nc["TIME"].ncattrs():
        yield "TIME is not double TIME(TIME) without a fill value"
    if not np.isfinite(times).all() or not (np.diff(times) > 0).all():
        yield "TIME does not increase"


def _named(nc: netCDF4.Dataset, name: str) -> Iterator[str]:
    variable = nc[name]
    if not re.fullmatch(r"[A-Z][A-Z0-9_]*", name) or not _attribute(variable, "long_name"):
        yield f"variable {name} is not named in capitals, or has no long_name"
    if name in NAMES and _attribute(variable, "standard_name") != NAMES[name]:
        yield f"{name}:standard_name is not {NAMES[name]}"
    if "TIME" in [other for other in variable.dimensions if other not in NOT_OF_TIME][1:]:
        yield f"{name}: TIME is not the first of its dimensions"


def _data(nc: netCDF4.Dataset, name: str) -> Iterator[str]:
    """Check units, fill value, coordinates and flags of a data variable [2.5, 2.6]."""
    variable, flags = nc[name], f"{name}_QC"
    if not _attribute(variable, "units") or "_FillValue" not in variable.ncattrs():
        yield f"{name}:units or _FillValue is missing"
    if name not in COORDINATES and not name.endswith("_DEPTH") and not _attribute(variable, "coordinates"):
        yield f"{name}:coordinates is missing"
    for key in ("coordinates", "ancillary_variables"):
        absent = [other for other in _attribute(variable, key).split() if other not in nc.variables]
        yield from (f"{name}:{key} names {other}, which is not in the file" for other in absent)
    if _attribute(variable, "sensor_orientation") not in ("", "upward", "downward", "horizontal"):  # table 8
        yield f"{name}:sensor_orientation is {_attribute(variable, 'sensor_orientation')!r}, not of table 8"
    base = name.removesuffix("_UNCERTAINTY")
    if base != name and base != "HEADING_COMMON":  # a part of that of HEADING_CORRECTED
        if base not in nc.variables or _attribute(variable, "units") != _attribute(nc[base], "units"):
            yield f"{name}:units are not those of {base}"
        if _attribute(variable, "long_name") != f"uncertainty of {base}":
            yield f"{name}:long_name is not 'uncertainty of {base}'"
    helpers = {other for v in nc.variables.values() for other in _attribute(v, "ancillary_variables").split()}
    if flags not in nc.variables:
        if name not in helpers and not _attribute(variable, "QC_indicator"):
            yield f"{name} has neither QC_indicator nor {flags}"
    elif flags not in _attribute(variable, "ancillary_variables").split():
        yield f"{name}:ancillary_variables does not name {flags}"
    elif nc[flags].dimensions != variable.dimensions:
        yield f"{flags} has other dimensions than {name}"
    elif np.any(~_usable(variable) & np.isin(nc[flags][...], USABLE)):
        yield f"{flags} calls a missing value usable"


def _flags(nc: netCDF4.Dataset, name: str) -> Iterator[str]:
    """Check type, name and scale of a flag variable [2.6, table 2]."""
    variable, long_name = nc[name], f"quality flag for {name.removesuffix('_QC')}"
    if variable.dtype != np.int8 or _attribute(variable, "long_name") != long_name:
        yield f"{name} is not of type byte, or its long_name is not {long_name!r}"
    values = np.atleast_1d(getattr(variable, "flag_values", [])).tolist()
    if values != list(FLAGS) or _attribute(variable, "flag_meanings").split() != list(FLAGS.values()):
        yield f"{name}:flag_meanings are not those of table 2"
    if not np.isin(variable[...], list(FLAGS)).all():
        yield f"{name} holds a flag that table 2 has not"


def _usable(variable: netCDF4.Variable) -> Any:
    values = np.asarray(variable[...])
    return np.isfinite(values) & (values != getattr(variable, "_FillValue", np.nan))


def _attribute(holder: Any, name: str) -> str:
    return str(getattr(holder, name, ""))
