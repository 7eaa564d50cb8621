"""Global attributes of corrected.nc according to CF, ACDD-1.3 and OceanSITES-1.4.

Attributes that describe the file itself are computed; otherwise the user's take precedence. Unknown ones are omitted.
"""

import re
from collections.abc import Container, Mapping
from dataclasses import dataclass

import numpy as np

from compasslib import angles
from compasslib.config import values
from compasslib.records import iso_time
from compasslib.types import Bools, Floats

Attributes = dict[str, str | int | float]
CONVENTIONS = "CF-1.11, ACDD-1.3, OceanSITES-1.4"
DECLINATION = {"IGRF": "IGRF-14 at sea level, along time", "metadata": "a constant given in the mooring's YAML file"}
DATES = ("date_created", "date_modified", "date_issued", "date_metadata_modified")
ASKED_FOR = (
    *("institution", "project", "principal_investigator", "creator_name", "creator_email", "creator_url"),
    *("publisher_name", "publisher_email", "publisher_url", "license", "acknowledgement", "naming_authority"),
)
SPELLINGS = {"acknowledgement": "acknowledgment"}
SENSOR_KEYS = ("manufacturer", "model", "serial_number", "mount")
# ACDD attributes, and the OceanSITES attributes with the same meaning.
SAME = {
    "creator_name": "principal_investigator",
    "creator_email": "principal_investigator_email",
    "creator_url": "principal_investigator_url",
    "creator_institution": "institution",
}
CONSTANT: Attributes = {
    "Conventions": CONVENTIONS,
    "featureType": "timeSeriesProfile",
    "cdm_data_type": "TimeSeriesProfile",
    "cdm_timeseries_variables": "STATION, LATITUDE, LONGITUDE",  # ERDDAP needs both
    "cdm_profile_variables": "TIME",
    "data_type": "OceanSITES time-series data",
    "format_version": "1.4",
    "data_mode": "D",
    "update_interval": "void",
    "source": "subsurface mooring",
    "platform": "subsurface mooring",
    "platform_vocabulary": "SeaVoX Platform Categories (L06)",
    "keywords": "EARTH SCIENCE > OCEANS > OCEAN CIRCULATION > OCEAN CURRENTS",
    "keywords_vocabulary": "GCMD Science Keywords",
    "standard_name_vocabulary": "CF Standard Name Table v93",
    "references": (
        "von Appen (2015), doi:10.1175/JTECH-D-14-00043.1; "
        "OceanSITES Data Format Reference Manual 1.4, http://www.oceansites.org"
    ),
}


@dataclass(frozen=True)
class Site:
    """Name and position of a mooring."""

    name: str  #: name of the mooring
    latitude: float  #: degrees north
    longitude: float  #: degrees east
    water_depth_m: float | None = None  #: m; None where it is not known
    instrument: str = ""  #: name of the affected instrument, where several of the mooring are corrected

    def signed_longitude(self) -> float:
        """Wrap the longitude to [-180, 180]; a value in that range is returned unchanged."""
        return self.longitude if -180.0 <= self.longitude <= 180.0 else float(angles.wrap180(self.longitude))

    def holds_water(self, depth_m: Floats) -> Bools:
        """Return whether each depth is known and lies between the sea surface and the bottom."""
        return (depth_m >= 0.0) & (depth_m <= (np.inf if self.water_depth_m is None else self.water_depth_m))


def global_attributes(
    site: Site,
    *,
    time_s: Floats,
    depth_m: Floats,
    headings: tuple[int, int],
    attributes: Mapping[str, object],
    processing: Mapping[str, object],
) -> Attributes:
    """Compose the global attributes of corrected.nc.

    Args:
        time_s: (n,) time of the samples, UTC seconds since 1970.
        depth_m: depths of the measurements, any shape, metres, NaN where unknown.
        headings: numbers of recorded and of corrected headings.
        attributes: the user's, which take precedence except over ``config.values.STATED``, which the file states.
        processing: how the product was made, as of ``provenance.processing``, possibly in part.
    """
    user, made = plain(attributes), plain(processing)
    named = {"method": "correction_method", "coefficients": "correction_coefficients"}
    # A file is never modified after its creation, so that ACDD's four dates are equal.
    dated = dict.fromkeys(DATES, made["date_created"]) if "date_created" in made else {}
    computed = CONSTANT | _what(site, time_s, headings, str(made.get("method", "unknown")))
    computed |= {acdd: user[same] for acdd, same in SAME.items() if same in user}
    computed |= _where(site, depth_m)
    if len(time_s):
        computed |= {f"time_coverage_{end}": iso_time(time_s[k]) for end, k in (("start", 0), ("end", -1))}
        computed["time_coverage_duration"] = iso_duration(time_s[-1] - time_s[0])
    if len(time_s) > 1:
        computed["time_coverage_resolution"] = iso_duration(float(np.median(np.diff(time_s))))
    computed |= {"product_version": made["software_version"]} if "software_version" in made else {}
    computed |= {named.get(key, key): value for key, value in made.items()} | dated
    return computed | {key: value for key, value in user.items() if not values.stated(key)}


def missing(attributes: Container[str]) -> list[str]:
    """List the global attributes that ACDD and OceanSITES request, only the user can give, and are not present."""
    return [name for name in ASKED_FOR if name not in attributes and SPELLINGS.get(name) not in attributes]


def sensor_attributes(attributes: Attributes, looks_up: bool) -> Attributes:
    """Select those global attributes that describe the instrument that measured a variable, as of OceanSITES."""
    named = {f"sensor_{key}": attributes[key] for key in SENSOR_KEYS if key in attributes}
    given = {key: value for key, value in attributes.items() if key.startswith("sensor_")}
    usual = {"sensor_mount": "mounted_on_mooring_line"}
    return usual | named | given | {"sensor_orientation": "upward" if looks_up else "downward"}


def declination_attributes(attributes: Attributes, time_s: Floats, declination_deg: Floats) -> dict[str, object]:
    """Compose the attributes that describe the declination applied to a variable: model, dates and values.

    Args:
        attributes: global attributes; ``declination_source`` is used.
    """
    if not len(time_s):
        return {}
    source = str(attributes.get("declination_source", "unknown"))
    return {
        "declination_model": DECLINATION.get(source, source),
        "declination_date": f"{iso_time(time_s[0])}/{iso_time(time_s[-1])}",
        "declination_degrees": declination_deg[[0, -1]],
        "declination_comment": "Degrees east of true north at the two dates; in between by declination_model.",
    }


def plain(attributes: Mapping[str, object]) -> Attributes:
    """Return attributes as netCDF stores them: without None, and whole numbers beyond 32 bits as text."""
    written: Attributes = {}
    for name, value in attributes.items():
        if isinstance(value, (str, float)) or (isinstance(value, int) and abs(value) < 2**31):
            written[name] = value
        elif value is not None:
            written[name] = str(value)
    return written


def iso_duration(seconds: float) -> str:
    """Format a duration, not negative, as ISO 8601 in days, hours, minutes and seconds."""
    minutes, second = divmod(round(float(seconds), 3), 60.0)
    hours, minute = divmod(int(minutes), 60)
    days, hour = divmod(hours, 24)
    clock = "".join(f"{x:g}{unit}" for x, unit in ((hour, "H"), (minute, "M"), (round(second, 3), "S")) if x)
    return "P" + (f"{days}D" if days or not clock else "") + (f"T{clock}" if clock else "")


def _what(site: Site, time_s: Floats, headings: tuple[int, int], method: str) -> Attributes:
    recorded, corrected = headings
    named = f"{site.name} {site.instrument}".strip()
    platform = re.sub(r"[\s_]+", "-", named)  # OceanSITES reserves the underscore as field separator
    deployment = [iso_time(time_s[0])[:7].replace("-", "")] if len(time_s) else []
    levels = ("Known bad data has been replaced with null values", "Post-recovery calibrations have been applied")
    return {
        "title": f"Currents of mooring {named}, corrected for the magnetic deviation of the compass",
        "summary": (
            f"Currents of mooring {site.name} at {site.latitude:.4f}, {site.signed_longitude():.4f} (degrees north, "
            "east), from an instrument whose compass is subject to magnetic deviation: headings and velocities as "
            "recorded and as corrected, the deviation, and the uncertainties."
        ),
        "comment": (
            f"{corrected} of {recorded} recorded headings could be corrected (method: {method}); the others are "
            "missing and flagged 4. Velocities were turned clockwise by HEADING_CORRECTED minus HEADING, their speeds "
            "unchanged."
        ),
        "id": "_".join(["OS", platform, *deployment, "D", "compass-corrected"]),
        "site_code": site.name,
        "platform_code": site.name,
        "headings_recorded": recorded,
        "headings_corrected": corrected,
        "processing_level": levels[corrected > 0],
        "QC_indicator": "probably good" if corrected == recorded > 0 else "mixed",
    }


def _where(site: Site, depth_m: Floats) -> Attributes:
    longitude, known = site.signed_longitude(), depth_m[site.holds_water(depth_m)]
    ranges: Attributes = {
        **dict.fromkeys(("geospatial_lat_min", "geospatial_lat_max"), site.latitude),
        **dict.fromkeys(("geospatial_lon_min", "geospatial_lon_max"), longitude),
        "geospatial_lat_units": "degree_north",
        "geospatial_lon_units": "degree_east",
        "geospatial_bounds": f"POINT ({site.latitude:g} {longitude:g})",
        "geospatial_bounds_crs": "EPSG:4326",
        "geospatial_bounds_vertical_crs": "EPSG:5831",
        "geospatial_vertical_positive": "down",
        "geospatial_vertical_units": "m",
    }
    if len(known):
        ranges |= {"geospatial_vertical_min": float(known.min()), "geospatial_vertical_max": float(known.max())}
    if site.water_depth_m is not None:
        ranges |= {"water_depth": float(site.water_depth_m), "water_depth_units": "m"}
    return ranges
