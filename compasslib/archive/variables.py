"""Variables of the netCDF files, one entry each.

The variable names of corrected.nc, overlap.nc and gridded.nc are a public interface. Standard names are from the CF
table and are omitted where it has none: it has an orientation from true north, but no magnetic heading, deviation or
declination. Flags are those of OceanSITES reference table 2.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from compasslib.preparation.quality import CHECKS, MASKS
from compasslib.records import PROFILES as PROFILE_KEYS

FILL = 99999.0
FLAG_VALUES = np.array([0, 1, 2, 3, 4, 7, 8, 9], dtype=np.int8)
FLAG_MEANINGS = (
    "unknown good_data probably_good_data potentially_correctable_bad_data bad_data "
    "nominal_value interpolated_value missing_value"
)
NOMINAL = 7  # "not observed but reported": flag of values from metadata or a model

UNIT_CODES = {  # codes and labels in the NERC vocabulary P06
    **{"m s-1": ("UVAA", "Metres per second"), "degree": ("UAAA", "Degrees"), "dbar": ("UPDB", "Decibars")},
    **{"degree_Celsius": ("UPAA", "Degrees Celsius"), "m": ("ULAA", "Metres"), "percent": ("UPCT", "Percent")},
    **{"degrees_north": ("DEGN", "Degrees north"), "degrees_east": ("DEGE", "Degrees east")},
    "days since 1950-01-01T00:00:00Z": ("UTAA", "Days"),
}
LABELS = {  # of codes in the NERC vocabulary P01
    "ELTJLD01": "Elapsed time (since 1950-01-01T00:00:00Z)",
    "ALATZZ01": "Latitude north",
    "ALONZZ01": "Longitude east",
    "ADEPZZ01": "Depth (spatial coordinate) relative to water surface in the water body",
    "LCEWZZ01": "Eastward velocity of water current in the water body",
    "LCNSZZ01": "Northward velocity of water current in the water body",
    "LERRAP01": "Current velocity error in the water body by moored acoustic doppler current profiler (ADCP)",
    "HEADCM01": "Orientation (horizontal relative to true north) of measurement device {heading}",
    "PTCHGP01": "Orientation (pitch) of measurement platform by inclinometer",
    "ROLLGP01": "Orientation (roll angle) of measurement platform by inclinometer (second sensor)",
    "TEMPPR01": "Temperature of the water body",
}

SERIES, BINS = ("TIME",), ("TIME", "BIN")
CELLS, MODES, SHARES = ("TIME", "DEPTH"), ("MODE", "TIME"), ("SOURCES", "MODE")
BEAMS = ("BEAM", *BINS)  # CF 2.4: dimensions of neither time nor space stand to the left
MAGNETIC, TRUE = "magnetic north", "true north"
EASTWARD, NORTHWARD = "eastward_sea_water_velocity", "northward_sea_water_velocity"
PITCH, ROLL = "platform_pitch_fore_up", "platform_roll_starboard_down"
SEA_LEVEL: Mapping[str, object] = {"positive": "down", "reference": "sea_level"}


@dataclass(frozen=True)
class Variable:
    """One variable of a file: name, meaning, shape, type and attributes."""

    name: str
    long_name: str
    units: str = ""
    standard_name: str = ""  # in the CF table, empty where it has none
    dimensions: tuple[str, ...] = SERIES
    dtype: str = "f8"
    valid: tuple[float, float] | None = None
    reference: str = ""
    comment: str = ""
    ancillary: tuple[str, ...] = ()  # names of the variables that qualify each value, except its flags
    fill: float | None = FILL  # None where no value can be missing
    also: Mapping[str, object] = field(default_factory=dict)
    parameter: str = ""  # code of the vocabulary P01 of the NERC Vocabulary Server
    content: str = ""  # ACDD ``coverage_content_type``
    coordinates: str = ""  # names of the coordinate variables
    sensed: bool = False  # measured by the affected instrument, whose make and serial number become attributes
    by_declination: bool = False  # depends on the declination, whose model and dates become attributes

    def attributes(self) -> dict[str, object]:
        """Compose the attributes, omitting empty ones."""
        attributes: dict[str, object] = {
            "standard_name": self.standard_name,
            "long_name": self.long_name,
            "units": self.units,
            "reference": self.reference,
            "comment": self.comment,
            "ancillary_variables": " ".join(self.ancillary),
            "coverage_content_type": self.content,
            "coordinates": "" if self.name in self.coordinates.split() else self.coordinates,
            **self.also,
        }
        codes = {"parameter": ("P01", self.parameter, LABELS.get(self.parameter, ""))}
        codes["uom"] = ("P06", *UNIT_CODES.get(self.units, ("", "")))
        for kind, (vocabulary, code, label) in codes.items():
            attributes |= {f"sdn_{kind}_urn": f"SDN:{vocabulary}::{code}", f"sdn_{kind}_name": label} if code else {}
        if self.valid is not None:
            attributes["valid_min"], attributes["valid_max"] = np.array(self.valid, dtype=self.dtype)
        return {key: value for key, value in attributes.items() if not (isinstance(value, str) and value == "")}


def quality_variable(variable: Variable) -> Variable:
    """Create the quality flag variable of a variable."""
    attributes = {"conventions": "OceanSITES QC Flags", "flag_values": FLAG_VALUES, "flag_meanings": FLAG_MEANINGS}
    return Variable(
        f"{variable.name}_QC", f"quality flag for {variable.name}", "", "status_flag", variable.dimensions, "i1",
        fill=None, also=attributes, coordinates=variable.coordinates,
    )  # fmt: skip


# Records, by the name of the field.
BIN = Variable(
    "BIN", "number of the bin, counted from the transducer", "1", "", ("BIN",), "i4", fill=None, also={"axis": "Z"}
)
BEAM = Variable("BEAM", "number of the beam, as the instrument counts them", "1", "", ("BEAM",), "i4", fill=None)
_SECONDS = Variable("TIME", "time", "seconds since 1970-01-01T00:00:00Z", "time", fill=None, also={"axis": "T"})

# The first two only serve the deployment and drafts; the others hold several.
NOT_STORED = {"unstated", "channels", "profiles"}
CHANNEL = "CHANNEL_"  # prefix of the variables of ``channels``
_ON_SCALE = {"units_metadata": "temperature: on_scale"}
_TESTS = Variable(
    "VELOCITY_QC_TESTS", "tests that the velocity failed", "", "status_flag", BINS, "i4", fill=None,
    also={"flag_masks": np.array(list(MASKS.values())), "flag_meanings": " ".join(check.meaning for check in CHECKS)},
)  # fmt: skip

RECORD = {
    "time_s": _SECONDS,
    "east": Variable("EAST", "eastward velocity, from direction_reference", "m s-1", "", BINS, "f4"),
    "north": Variable("NORTH", "northward velocity, from direction_reference", "m s-1", "", BINS, "f4"),
    "bin_range_m": Variable("BIN_RANGE", "vertical distance from the transducer", "m", "", BINS, "f4"),
    "heading_deg": Variable("HEADING", "recorded heading", "degree", reference=MAGNETIC),
    "pitch_deg": Variable("PITCH", "pitch", "degree", PITCH),
    "roll_deg": Variable("ROLL", "roll", "degree", ROLL),
    "pressure_dbar": Variable("PRESSURE", "pressure", "dbar", "sea_water_pressure_due_to_sea_water"),
    "depth_m": Variable("INSTRUMENT_DEPTH", "depth of the instrument", "m", "depth", also=SEA_LEVEL),
    "temperature_c": Variable("TEMP", "temperature", "degree_Celsius", "sea_water_temperature", also=_ON_SCALE),
    "supply_voltage": Variable("SUPPLY_VOLTAGE", "supply voltage, counts or volts", "1"),
    "quality": quality_variable(Variable("VELOCITY", "", dimensions=BINS)),
    "heading_quality": quality_variable(Variable("HEADING", "")),
    "tests": _TESTS,
}

# Pairs, by the name of the field.
_BY_RECORDED = "velocity of the affected instrument, by its recorded heading plus declination"
_OF_TRUSTED = "velocity of the reference"

PAIRS = {
    "time_s": _SECONDS,
    "heading_deg": Variable("HEADING", "heading of the affected compass", "degree", reference=MAGNETIC),
    "pitch_deg": RECORD["pitch_deg"],
    "roll_deg": RECORD["roll_deg"],
    "upper_east": Variable("UPPER_UCUR", f"eastward {_BY_RECORDED}", "m s-1", reference=TRUE),
    "upper_north": Variable("UPPER_VCUR", f"northward {_BY_RECORDED}", "m s-1", reference=TRUE),
    "lower_east": Variable("LOWER_UCUR", f"eastward {_OF_TRUSTED}", "m s-1", EASTWARD, reference=TRUE),
    "lower_north": Variable("LOWER_VCUR", f"northward {_OF_TRUSTED}", "m s-1", NORTHWARD, reference=TRUE),
    "upper_depth_m": Variable("UPPER_DEPTH", "depth of the affected velocity", "m", "depth", also=SEA_LEVEL),
    "lower_depth_m": Variable("LOWER_DEPTH", "depth of the reference velocity", "m", "depth", also=SEA_LEVEL),
    "separation_minutes": Variable("SEPARATION_MINUTES", "time, reference minus affected velocity", "minute"),
    "declination_deg": Variable("DECLINATION", "magnetic declination, east positive", "degree"),
    # The following ones are written only where the pairs have them.
    "lower_heading_deg": Variable("LOWER_HEADING", "heading of the reference compass", "degree", reference=MAGNETIC),
    "reference_index": Variable("REFERENCE_INDEX", "reference of the pair", dtype="i1", fill=None),
}
SEPARATION_METRES = Variable("SEPARATION_METRES", "depth, reference minus affected velocity", "m")

# corrected.nc, by name.
_WGS84 = {"coordinate_reference_frame": "urn:ogc:def:crs:EPSG::4326", "QC_indicator": "nominal value"}
_BELOW_SEA_LEVEL = {**SEA_LEVEL, "coordinate_reference_frame": "urn:ogc:def:crs:EPSG::5831"}
_RANGE_ONLY = "Flagged by its valid range alone."
_RECORDED = "Turned by the recorded heading plus DECLINATION, before the correction."
_NOT_CORRECTED = "What cannot be corrected is missing and flagged 4, never guessed."
_CORRECTED = f"The recorded velocity turned clockwise by DEVIATION; its speed is unchanged. {_NOT_CORRECTED}"
_STANDARD_DEVIATION = "One standard deviation."
_BY_DIRECTION = f"{_STANDARD_DEVIATION} Of the error of the direction alone; gridded.nc has all errors."
_MEASURED = "physicalMeasurement"
_QUALITY, _UNKNOWN = "qualityInformation", {"QC_indicator": "unknown"}
_OF_BINS, _OF_MOORING = "TIME LATITUDE LONGITUDE DEPTH", "LATITUDE LONGITUDE"

TIME = Variable(
    "TIME", "time of measurement", "days since 1950-01-01T00:00:00Z", "time", valid=(0.0, 90000.0), fill=None,
    also={"axis": "T", "QC_indicator": "probably good data"}, parameter="ELTJLD01", comment="UTC",
)  # fmt: skip
LATITUDE = Variable(
    "LATITUDE", "latitude of the mooring", "degrees_north", "latitude", dimensions=(), valid=(-90.0, 90.0),
    reference="WGS84", fill=None, also={"axis": "Y", **_WGS84}, parameter="ALATZZ01",
)  # fmt: skip
LONGITUDE = Variable(
    "LONGITUDE", "longitude of the mooring", "degrees_east", "longitude", dimensions=(), valid=(-180.0, 180.0),
    reference="WGS84", fill=None, also={"axis": "X", **_WGS84}, parameter="ALONZZ01",
)  # fmt: skip
STATION = Variable(
    "STATION", "name of the mooring", "", "", ("NAME_LENGTH",), "S1", fill=None, also={"cf_role": "timeseries_id"}
)


def _by_name(content: str, coordinates: Mapping[tuple[str, ...], str], *entries: Variable) -> dict[str, Variable]:
    """Return variables by name, with content type, and coordinates by dimensions, unless they have their own."""
    return {
        entry.name: replace(
            entry,
            content=entry.content or content,
            coordinates=entry.coordinates or coordinates[entry.dimensions],
        )
        for entry in entries
    }


def _current(name: str, towards: str, standard_name: str, parameter: str) -> list[Variable]:
    """Describe a component of the current by the corrected and by the recorded heading, and its uncertainty."""
    # Without a standard name of the recorded one, a selection by it yields the corrected one.
    corrected = Variable(
        name, f"{towards} velocity of the water, by the corrected heading", "m s-1", standard_name, BINS, "f4",
        valid=(-10.0, 10.0), reference=TRUE, comment=_CORRECTED, parameter=parameter, sensed=True, by_declination=True,
        ancillary=(f"{name}_UNCERTAINTY", "UCUR_QC_TESTS", "HEADING_CORRECTED", "DECLINATION"),
    )  # fmt: skip
    recorded = replace(
        corrected, name=f"{name}_RECORDED", long_name=f"{towards} velocity of the water, by the recorded heading",
        standard_name="", comment=_RECORDED, parameter="", ancillary=("HEADING", "DECLINATION"),
    )  # fmt: skip
    return [corrected, recorded, _uncertainty(name, standard_name, BINS, _BY_DIRECTION, reference=TRUE)]


def _uncertainty(
    name: str, standard_name: str, dimensions: tuple[str, ...], comment: str, reference: str = ""
) -> Variable:
    return Variable(
        f"{name}_UNCERTAINTY", f"uncertainty of {name}", "m s-1", standard_name and f"{standard_name} standard_error",
        dimensions, "f4", valid=(0.0, 10.0), reference=reference, comment=comment, content=_QUALITY,
    )  # fmt: skip


def _counts(name: str, what: str, standard_name: str, comment: str, *, units: str = "1") -> Variable:
    # The classic netCDF model has no unsigned byte; the high bytes are almost all zero and compress to nothing.
    return Variable(
        name, what, units, standard_name, BEAMS, "i2", valid=(0, 255), comment=comment, fill=-1,
        also=_UNKNOWN, sensed=True,
    )  # fmt: skip


CORRECTED = _by_name(
    _MEASURED, {SERIES: "TIME LATITUDE LONGITUDE INSTRUMENT_DEPTH", BINS: _OF_BINS, BEAMS: _OF_BINS},
    Variable(
        "INSTRUMENT_DEPTH", "depth of the instrument", "m", "depth", valid=(-10.0, 12000.0), comment=_RANGE_ONLY,
        also=_BELOW_SEA_LEVEL, content="coordinate", parameter="ADEPZZ01",
    ),
    Variable(
        "DEPTH", "depth of each bin, including blow-down", "m", "depth", BINS, "f4", valid=(-1000.0, 12000.0),
        also=_BELOW_SEA_LEVEL, content="coordinate", parameter="ADEPZZ01",
        comment="Negative where a bin lies above the sea surface. Flagged 4 above the surface and below the bottom.",
    ),
    Variable(
        "HEADING", "heading of the instrument as its compass recorded it", "degree", valid=(0.0, 360.0),
        reference=MAGNETIC, sensed=True, comment="Clockwise; without declination and without any correction.",
    ),
    Variable(
        "HEADING_CORRECTED", "heading of the instrument, corrected for magnetic deviation", "degree",
        valid=(0.0, 360.0), reference=MAGNETIC,
        ancillary=(
            "HEADING_CORRECTED_UNCERTAINTY", "HEADING_COMMON_UNCERTAINTY", "DEVIATION", "BRANCH_PROBABILITY",
        ),
        comment="Clockwise. HEADING_CORRECTED + DECLINATION is the heading from true north. " + _NOT_CORRECTED,
    ),
    Variable(
        "HEADING_CORRECTED_UNCERTAINTY", "uncertainty of HEADING_CORRECTED", "degree", valid=(0.0, 180.0),
        comment=f"{_STANDARD_DEVIATION} Whole: reading, coefficients, uncorrected effects, the reference's compass and "
        "the mean directional shear; the declination only where the reference's north is true.",
        content=_QUALITY,
    ),
    Variable(
        "HEADING_COMMON_UNCERTAINTY", "common part of the uncertainty of HEADING_CORRECTED", "degree",
        valid=(0.0, 180.0), content=_QUALITY,
        comment=f"{_STANDARD_DEVIATION} All but the reading's random error; it does not average out. Sums and means "
        "need the modes of gridded.nc.",
    ),
    Variable(
        "DEVIATION", "magnetic deviation of the compass, HEADING_CORRECTED minus HEADING", "degree",
        valid=(-180.0, 180.0), content="modelResult", comment="Positive where the compass reads too low.",
    ),
    Variable(
        "BRANCH_PROBABILITY", "probability of HEADING_CORRECTED among the headings that give the same reading", "1",
        valid=(0.0, 1.0), content=_QUALITY,
        comment="1 where one heading alone gives the recorded one.",
    ),
    Variable(
        "DECLINATION", "magnetic declination, angle from true to magnetic north", "degree", valid=(-180.0, 180.0),
        reference=TRUE, content="modelResult", by_declination=True,
        comment="East positive; from a model of the earth's field or from metadata, not measured.",
    ),
    *_current("UCUR", "eastward", EASTWARD, "LCEWZZ01"),
    *_current("VCUR", "northward", NORTHWARD, "LCNSZZ01"),
    replace(
        _TESTS, name="UCUR_QC_TESTS", long_name="tests that UCUR and VCUR failed", content=_QUALITY,
        comment="Bits of all tests that a velocity failed; names after QARTOD's tests and the IMOS toolbox.",
    ),
    Variable(
        "HEADING_TRUE", "heading of the instrument from true north, corrected for magnetic deviation", "degree",
        "platform_orientation", valid=(0.0, 360.0), reference=TRUE,
        ancillary=("HEADING_CORRECTED_UNCERTAINTY", "DECLINATION"), by_declination=True, parameter="HEADCM01",
        comment="Clockwise; HEADING_CORRECTED + DECLINATION. " + _NOT_CORRECTED,
    ),
    Variable(
        "PITCH", "pitch", "degree", PITCH, valid=(-180.0, 180.0), comment=f"Forward up. {_RANGE_ONLY}", sensed=True,
        parameter="PTCHGP01",
    ),
    Variable(
        "ROLL", "roll", "degree", ROLL, valid=(-180.0, 180.0), comment=f"Starboard down. {_RANGE_ONLY}", sensed=True,
        parameter="ROLLGP01",
    ),
    Variable(
        "TEMP", "temperature at the transducer", "degree_Celsius", "sea_water_temperature", valid=(-5.0, 45.0),
        comment=_RANGE_ONLY, also=_ON_SCALE, sensed=True, parameter="TEMPPR01",
    ),
    Variable(
        "PRES", "pressure at the instrument", "dbar", "sea_water_pressure", valid=(-10.0, 12000.0), sensed=True,
        comment="By the instrument's sensor, which is usually set to zero in air; pressure_offset is "
        f"subtracted. {_RANGE_ONLY}",
    ),
    Variable(
        "WCUR", "upward velocity of the water", "m s-1", "upward_sea_water_velocity", BINS, "f4", valid=(-10.0, 10.0),
        sensed=True, comment="As measured; no heading changes it.",
    ),
    Variable(
        "ERROR_VELOCITY", "error velocity, the misfit of four beams", "m s-1",
        "indicative_error_from_multibeam_acoustic_doppler_velocity_profiler_in_sea_water", BINS, "f4",
        valid=(-10.0, 10.0), sensed=True, parameter="LERRAP01",
        comment="As measured; velocities from three beams have none.",
    ),
    _counts(
        "ECHO_INTENSITY", "intensity of the echo of each beam",
        "signal_intensity_from_multibeam_acoustic_doppler_velocity_sensor_in_sea_water",
        "Counts of the instrument, of some 0.45 dB (RDI) or 0.5 dB (Nortek).",
    ),
    _counts(
        "CORRELATION", "correlation of the pings of each beam",
        "beam_consistency_indicator_from_multibeam_acoustic_doppler_velocity_profiler_in_sea_water",
        "Counts of 255 (RDI), or percent (Nortek).",
    ),
    _counts(
        "PERCENT_GOOD", "share of the pings that were good",
        "proportion_of_acceptable_signal_returns_from_acoustic_instrument_in_sea_water",
        "RDI: of each beam where recorded_in is beam; else the shares of solutions from three beams, of those rejected "
        "by their error velocity, of more than one bad beam, and of solutions from four beams.",
        units="percent",
    ),
)  # fmt: skip
# Names of the variables that hold a record's ``profiles``.
PROFILES = dict(
    zip(PROFILE_KEYS, ("WCUR", "ERROR_VELOCITY", "ECHO_INTENSITY", "CORRELATION", "PERCENT_GOOD"), strict=True)
)


# gridded.nc and gridded_daily.nc, by name.
GRID_TIME = replace(TIME, comment="UTC; the middle of each interval", also={**TIME.also, "bounds": "TIME_bnds"})
# CF 7.1: bounds inherit units and meaning from their coordinate.
BOUNDS = {name: Variable(f"{name}_bnds", "", dimensions=(name, "NV"), fill=None) for name in ("TIME", "DEPTH")}
SECTION_SIGMA = (
    "An error delta of a heading is transverse, du = v delta and dv = -u delta, and is common to all cells of one "
    "time and source. Of a sum Q = sum(a UCUR + b VCUR) over times t and depths z, let g(s, t) = sum over the depths "
    "of source s of a VCUR - b UCUR. Then var(Q) = sum over modes m of [sum over s, t of HEADING_ERROR_SHARE(s, m) "
    "HEADING_ERROR_MODE(m, t) g(s, t)]^2 + sum over pairs of times t, t' of r(t) r(t') exp(-|t - t'| / memory_hours) "
    "+ sum over cells of rest^2 (a^2 + b^2) (1 + 2 error_memory_hours / step of TIME; 1 of one time), where r(t) = "
    "HEADING_ERROR_RANDOM(t) g(1, t), source 1 being the affected instrument (several are sources 1, 2, ..., each "
    "with its own row of HEADING_ERROR_RANDOM and its own sum), memory_hours is an attribute of HEADING_ERROR_RANDOM "
    "and error_memory_hours of UCUR_UNCERTAINTY, and rest^2 = (UCUR_UNCERTAINTY^2 + VCUR_UNCERTAINTY^2 - h^2 (UCUR^2 "
    "+ VCUR^2)) / 2 with h^2 the variance of the heading of the cell's source."
)
GRID_DEPTH = Variable(
    "DEPTH", "depth", "m", "depth", ("DEPTH",), fill=None, valid=(0.0, 12000.0),
    also={"axis": "Z", "bounds": "DEPTH_bnds", **_BELOW_SEA_LEVEL, "QC_indicator": "nominal value"},
    content="coordinate", parameter="ADEPZZ01",
)  # fmt: skip
MODE = Variable("MODE", "number of the mode", "1", "", ("MODE",), "i4", fill=None)
SOURCES = Variable("SOURCES", "number of the instrument, as in SOURCE", "1", "", ("SOURCES",), "i4", fill=None)
_MEAN = {"cell_methods": "TIME: mean"}
_HELPERS = ("UV_COVARIANCE", "SOURCE", "N_CELLS", "HEADING_ERROR_MODE", "HEADING_ERROR_RANDOM")
_TOTAL = "One standard deviation, all errors together; for sums and means the modes of the heading error are needed."


def _gridded_current(name: str, towards: str, standard_name: str, parameter: str) -> list[Variable]:
    """Describe a component of the gridded current and without tides, and the uncertainty of each."""
    # Without a standard name of the tide-free one, a selection by it yields the means.
    low = f"{name}_LOWPASS"
    velocity = Variable(
        name, f"{towards} velocity of the water", "m s-1", standard_name, CELLS, "f4", valid=(-10.0, 10.0),
        reference=TRUE, ancillary=(f"{name}_UNCERTAINTY", *_HELPERS), content=_MEASURED, parameter=parameter,
        also=_MEAN,
        comment="By the corrected heading of the affected instrument, or by a reference; SOURCE tells which.",
    )  # fmt: skip
    without_tides = replace(
        velocity, name=low, long_name=f"{velocity.long_name}, without tides", standard_name="", parameter="",
        ancillary=(f"{low}_UNCERTAINTY",), also={},
        comment="Successive running means of 24, 24 and 25 hours (Godin 1972), at noon; missing where less than 0.99 "
        "of the weights have a velocity.",
    )  # fmt: skip
    uncertainties = (_uncertainty(base, known, CELLS, _TOTAL) for base, known in ((name, standard_name), (low, "")))
    return [velocity, without_tides, *uncertainties]


GRIDDED = _by_name(
    _QUALITY, {CELLS: "TIME LATITUDE LONGITUDE DEPTH", SERIES: "TIME LATITUDE LONGITUDE"},
    *_gridded_current("UCUR", "eastward", EASTWARD, "LCEWZZ01"),
    *_gridded_current("VCUR", "northward", NORTHWARD, "LCNSZZ01"),
    Variable(
        "WCUR", "upward velocity of the water", "m s-1", "upward_sea_water_velocity", CELLS, "f4", valid=(-10.0, 10.0),
        ancillary=("SOURCE",), content=_MEASURED, also=_MEAN,
        comment="Relative to the instrument, whose own rise is that of its depth. No heading changes it.",
    ),
    Variable("UV_COVARIANCE", "covariance of the errors of UCUR and VCUR", "m2 s-2", "", CELLS, "f4"),
    Variable("SOURCE", "instrument that measured the velocity", "", "", CELLS, "i1", fill=None),
    Variable("N_CELLS", "number of measured velocities used", "1", "", CELLS, "i4", fill=None),
    Variable(
        "HEADING_ERROR_MODE", "error of the heading, radians per standard normal variate", "radian", "", MODES, "f4",
        comment=SECTION_SIGMA, coordinates=_OF_MOORING, also=_UNKNOWN,
    ),
    Variable(
        "HEADING_ERROR_RANDOM", "random error of the heading of the affected instrument", "radian",
        comment="One standard deviation; its correlation falls off as exp(-lag / memory_hours).",
        coordinates=_OF_MOORING, also=_UNKNOWN,
    ),
    Variable(
        "HEADING_ERROR_SHARE", "share of a mode in the heading error of an instrument", "1", "", SHARES, "f4",
        coordinates=_OF_MOORING, also=_UNKNOWN,
    ),
    Variable(
        "HEADING_CORRECTION", "corrected minus recorded heading of the affected instrument", "degree",
        content="modelResult", coordinates=_OF_MOORING, also=_UNKNOWN,
        comment="Clockwise; its UCUR and VCUR turned back by this angle are those by the recorded heading.",
    ),
    Variable("N_SAMPLES", "number of times in the mean", "1", "", CELLS, "i4", fill=None, also=_UNKNOWN),
    Variable(
        "SHRINKAGE", "factor by which the heading error shortens a mean velocity", "1", also=_UNKNOWN,
        comment="exp(-sigma^2 / 2), sigma the standard deviation of the heading; not undone in UCUR and VCUR.",
    ),
)  # fmt: skip
