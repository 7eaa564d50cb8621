"""Variables of gridded.nc and gridded_daily.nc, one entry each; their names are a public interface."""

from __future__ import annotations

from typing import Any

from compasslib.archive.variables import CURRENT_CODES, EASTWARD, NORTHWARD, SEA_LEVEL, TRUE, Variable

CELLS, MODES, SHARES = ("TIME", "DEPTH"), ("MODE", "TIME"), ("SOURCES", "MODE")
COORDINATES = {CELLS: "TIME LATITUDE LONGITUDE DEPTH", ("TIME",): "TIME LATITUDE LONGITUDE"}
SECTION_SIGMA = (
    "An error delta of a heading is transverse, du = v delta and dv = -u delta, and is common to all cells of one "
    "time and source. Of a sum Q = sum(a UCUR + b VCUR) over times t and depths z, let g(s, t) = sum over the depths "
    "of source s of a VCUR - b UCUR. Then var(Q) = sum over modes m of [sum over s, t of HEADING_ERROR_SHARE(s, m) "
    "HEADING_ERROR_MODE(m, t) g(s, t)]^2 + sum over pairs of times t, t' of r(t) r(t') exp(-|t - t'| / memory_hours) "
    "+ sum over cells of rest^2 (a^2 + b^2) (1 + 2 error_memory_hours / step of TIME), where r(t) = "
    "HEADING_ERROR_RANDOM(t) g(1, t), source 1 being the affected instrument (several are sources 1, 2, ..., each "
    "with its own row of HEADING_ERROR_RANDOM and its own sum), memory_hours is an attribute of HEADING_ERROR_RANDOM "
    "and error_memory_hours of UCUR_UNCERTAINTY, and rest^2 = (UCUR_UNCERTAINTY^2 + VCUR_UNCERTAINTY^2 - h^2 (UCUR^2 "
    "+ VCUR^2)) / 2 with h^2 the variance of the heading of the cell's source."
)
DEPTH = Variable(
    "DEPTH",
    "depth",
    "m",
    "depth",
    ("DEPTH",),
    fill=None,
    valid=(0.0, 12000.0),
    also={
        "axis": "Z",
        **SEA_LEVEL,
        "QC_indicator": "nominal value",
        "coverage_content_type": "coordinate",
        "coordinate_reference_frame": "urn:ogc:def:crs:EPSG::5831",
    },
    parameter="ADEPZZ01",
)
MODE = Variable("MODE", "number of the mode", "1", "", ("MODE",), "i4", fill=None)
SOURCES = Variable("SOURCES", "number of the instrument, as in SOURCE", "1", "", ("SOURCES",), "i4", fill=None)

_QUALITY = {"coverage_content_type": "qualityInformation"}
_MEASURED = {"coverage_content_type": "physicalMeasurement"}
_HELPERS = ("UV_COVARIANCE", "SOURCE", "N_CELLS", "HEADING_ERROR_MODE", "HEADING_ERROR_RANDOM")
_BY_WHAT = "By the corrected heading of the affected instrument, or by a reference; SOURCE tells which."
_TOTAL = "One standard deviation, all errors together; for sums and means the modes of the heading error are needed."


def _cells(name: str, long_name: str, units: str, standard_name: str = "", **others: Any) -> Variable:
    return Variable(name, long_name, units, standard_name, CELLS, **{"dtype": "f4", "also": _QUALITY, **others})


def _current(name: str, towards: str, standard_name: str) -> Variable:
    return _cells(
        name,
        f"{towards} velocity of the water",
        "m s-1",
        standard_name,
        valid=(-10.0, 10.0),
        reference=TRUE,
        comment=_BY_WHAT,
        ancillary=(f"{name}_QC", f"{name}_UNCERTAINTY", *_HELPERS),
        also=_MEASURED,
        parameter=CURRENT_CODES[name],
    )


def _uncertainty(name: str, standard_name: str) -> Variable:
    relation = f"{standard_name} standard_error"
    return _cells(f"{name}_UNCERTAINTY", f"uncertainty of {name}", "m s-1", relation, valid=(0.0, 10.0), comment=_TOTAL)


def _number(name: str, long_name: str) -> Variable:
    return _cells(name, long_name, "1", dtype="i4", fill=None)


_TABLE = (
    _current("UCUR", "eastward", EASTWARD),
    _current("VCUR", "northward", NORTHWARD),
    _cells(
        "WCUR",
        "upward velocity of the water",
        "m s-1",
        "upward_sea_water_velocity",
        valid=(-10.0, 10.0),
        comment="Relative to the instrument, whose own rise is that of its depth. No heading changes it.",
        ancillary=("WCUR_QC", "SOURCE"),
        also=_MEASURED,
    ),
    _uncertainty("UCUR", EASTWARD),
    _uncertainty("VCUR", NORTHWARD),
    _cells("UV_COVARIANCE", "covariance of the errors of UCUR and VCUR", "m2 s-2"),
    _cells("SOURCE", "instrument that the velocity is of", "", dtype="i1", fill=None),
    _number("N_CELLS", "number of measured velocities that went in"),
    Variable(
        "HEADING_ERROR_MODE",
        "error of the heading, radians per unit normal number",
        "radian",
        dimensions=MODES,
        dtype="f4",
        comment=SECTION_SIGMA,
        also=_QUALITY,
    ),
    Variable(
        "HEADING_ERROR_RANDOM",
        "random error of the heading of the affected instrument",
        "radian",
        comment="One standard deviation; its correlation falls off as exp(-lag / memory_hours).",
        also=_QUALITY,
    ),
    Variable(
        "HEADING_ERROR_SHARE",
        "share of a mode in the heading error of an instrument",
        "1",
        dimensions=SHARES,
        dtype="f4",
        also=_QUALITY,
    ),
    Variable(
        "HEADING_CORRECTION",
        "corrected minus recorded heading of the affected instrument",
        "degree",
        comment="Clockwise; its UCUR and VCUR turned back by this angle are those by the recorded heading.",
        also={"coverage_content_type": "modelResult"},
    ),
    _number("N_SAMPLES", "number of times that went into the mean"),
    Variable(
        "SHRINKAGE",
        "factor by which the heading error shortens a mean velocity",
        "1",
        comment="exp(-sigma^2 / 2), sigma the standard deviation of the heading; not undone in UCUR and VCUR.",
        also=_QUALITY,
    ),
)
GRIDDED = {variable.name: variable for variable in _TABLE}
