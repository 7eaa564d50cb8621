"""Write one record in the netCDF layouts of other software, with their names, dimensions, units and attributes.

OceanSITES follows its manual 1.4; IMOS the parameters of imos-toolbox and its magneticDeclinationPP; EPIC ADCPy, with
time and time2; stglib its aqdutils and rdi modules. All are imitations; only dolfyn writes its files itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from numpy.typing import NDArray

from compasslib import angles

N, M, START = 60, 5, 1_188_864_000.0  # 2007-09-04
DECLINATION = -17.4
EPIC_FILL = 1e35
OCEANSITES = (
    "unknown good_data probably_good_data potentially_correctable_bad_data bad_data nominal_value interpolated_value "
    "missing_value"
)
IMOS = (
    "No_QC_performed Good_data Probably_good_data Bad_data_that_are_potentially_correctable Bad_data Value_changed "
    "Not_used Not_used Interpolated_values Missing_values"
)
Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Truth:
    """Measured values, magnetic; the last bin of the first profile and the second heading are missing."""

    time_s: Floats
    range_m: Floats
    east: Floats
    north: Floats
    heading_deg: Floats
    pitch_deg: Floats
    roll_deg: Floats
    pressure_dbar: Floats
    temperature_c: Floats

    def true(self) -> tuple[Floats, Floats, Floats]:
        """Compute east, north and heading relative to true north."""
        east, north = angles.turn(self.east, self.north, DECLINATION)
        return east, north, np.where(np.isnan(self.heading_deg), np.nan, angles.wrap360(self.heading_deg + DECLINATION))


def truth() -> Truth:
    """Draw a record in which every value is distinct."""
    rng = np.random.default_rng(11)
    east, north = rng.normal(0.0, 0.2, (2, N, M))
    east[0, -1] = north[0, -1] = np.nan
    heading = rng.uniform(0.0, 360.0, N)
    heading[1] = np.nan
    tilts = rng.normal(0.0, 3.0, (2, N))
    return Truth(
        START + 3600.0 * np.arange(N),
        6.2 + 4.0 * np.arange(M),
        *(east, north, heading, *tilts),
        100.0 + rng.uniform(0.0, 8.0, N),
        rng.uniform(2.0, 5.0, N),
    )


def put(
    nc: netCDF4.Dataset,
    name: str,
    dimensions: tuple[str, ...],
    values: Any,
    fill: float | None = None,
    **attributes: Any,
) -> None:
    """Write a variable from values of shape (time, bin); NaN is replaced by the fill value."""
    values = np.asarray(values)
    variable = nc.createVariable(name, values.dtype, dimensions, fill_value=fill)
    bins = [d for d in dimensions if nc.dimensions[d].size not in (1, N)]
    order = [d for d in dimensions if nc.dimensions[d].size != 1]
    if values.ndim == 2 and order and order[0] in bins:
        values = values.T
    shape = [nc.dimensions[d].size for d in dimensions]
    variable[...] = np.ma.masked_invalid(values).reshape(shape) if values.dtype.kind == "f" else values.reshape(shape)
    variable.setncatts(attributes)


def dimensions(nc: netCDF4.Dataset, **sizes: int) -> None:
    """Create dimensions of the given sizes."""
    for name, size in sizes.items():
        nc.createDimension(name, size)


def flags() -> NDArray[np.int8]:
    """Compose flags that are good but for two velocities."""
    codes = np.ones((N, M), dtype="i1")
    codes[3, 2], codes[4, 2] = 4, 8
    return codes


def oceansites(nc: netCDF4.Dataset, t: Truth) -> None:
    """Write OceanSITES: velocities from true north, bin depths, flags with meanings; the manual has no heading."""
    east, north, _ = t.true()
    dimensions(nc, TIME=N, DEPTH=M, LATITUDE=1, LONGITUDE=1)
    nc.setncatts({"Conventions": "CF-1.6, OceanSITES-1.4, ACDD-1.2", "orientation": "upward"})
    since = {"units": "days since 1950-01-01T00:00:00Z", "standard_name": "time"}
    put(nc, "TIME", ("TIME",), t.time_s / 86400.0 + 7305.0, **since)
    below = {"units": "meters", "standard_name": "depth", "positive": "down"}
    put(nc, "DEPTH", ("DEPTH",), (100.0 - t.range_m).astype("f4"), **below)
    meanings = {"flag_values": np.array([0, 1, 2, 3, 4, 7, 8, 9], "i1"), "flag_meanings": OCEANSITES}
    where = ("TIME", "DEPTH", "LATITUDE", "LONGITUDE")
    for name, word, values in (("UCUR", "eastward", east), ("VCUR", "northward", north)):
        said = {"standard_name": f"{word}_sea_water_velocity", "units": "meters/second"}
        put(nc, name, where, values.astype("f4"), 99999.0, **said, ancillary_variables=f"{name}_QC")
        put(nc, f"{name}_QC", where, flags(), **meanings)
    put(nc, "TEMP", ("TIME",), t.temperature_c, standard_name="sea_water_temperature", units="degree_Celsius")


def _imos(
    nc: netCDF4.Dataset, t: Truth, east: Floats, north: Floats, heading: Floats, suffix: str, said: Mapping[str, Any]
) -> None:
    dimensions(nc, TIME=N, HEIGHT_ABOVE_SENSOR=M)
    nc.setncatts({"Conventions": "CF-1.6,IMOS-1.4", "instrument_serial_number": "1367"})
    since = {"units": "days since 1950-01-01 00:00:00 UTC", "calendar": "gregorian"}
    put(nc, "TIME", ("TIME",), t.time_s / 86400.0 + 7305.0, **since)
    above = {"units": "m", "positive": "up", "standard_name": "height"}
    put(nc, "HEIGHT_ABOVE_SENSOR", ("HEIGHT_ABOVE_SENSOR",), t.range_m, **above)
    meanings = {"flag_values": np.arange(10, dtype="i1"), "flag_meanings": IMOS}
    mag, where = "magnetic_" if suffix else "", ("TIME", "HEIGHT_ABOVE_SENSOR")
    for name, word, values in (("UCUR", "eastward", east), ("VCUR", "northward", north)):
        qc, name = f"{name}{suffix}_quality_control", name + suffix
        own = {"long_name": f"{mag}{word}_sea_water_velocity", "units": "m s-1", "ancillary_variables": qc}
        own |= {} if suffix else {"standard_name": f"{word}_sea_water_velocity"}
        put(nc, name, where, values.astype("f4"), 999999.0, **own, **said)
        put(nc, qc, where, flags(), **meanings)
    put(nc, f"HEADING{suffix}", ("TIME",), heading, 999999.0, units="degree", **said)
    put(nc, "PITCH", ("TIME",), t.pitch_deg, units="degree", standard_name="platform_pitch")
    put(nc, "ROLL", ("TIME",), t.roll_deg, units="degree", standard_name="platform_roll")
    put(nc, "PRES_REL", ("TIME",), t.pressure_dbar, units="dbar", standard_name="sea_water_pressure_due_to_sea_water")
    put(nc, "TEMP", ("TIME",), t.temperature_c, units="degrees_Celsius", standard_name="sea_water_temperature")


def imos_magnetic(nc: netCDF4.Dataset, t: Truth) -> None:
    """Write the layout of imos-toolbox before its magneticDeclinationPP."""
    _imos(nc, t, t.east, t.north, t.heading_deg, "_MAG", {})


def imos_true(nc: netCDF4.Dataset, t: Truth) -> None:
    """Write the layout of imos-toolbox after it: names without _MAG, the declination as attribute of each variable."""
    east, north, heading = t.true()
    said = dict.fromkeys(("compass_correction_applied", "magnetic_declination"), DECLINATION)
    _imos(nc, t, east, north, heading, "", said)


def epic(nc: netCDF4.Dataset, t: Truth) -> None:
    """Write the EPIC layout of ADCPy: two time variables, four dimensions, cm/s."""
    east, north, heading = t.true()
    dimensions(nc, time=N, depth=M, lat=1, lon=1)
    nc.setncatts(
        {"Conventions": "PMEL/EPIC", "orientation": "UP", "magnetic_variation_applied": DECLINATION, "beam_angle": 20}
    )
    days = t.time_s / 86400.0
    put(nc, "time", ("time",), (np.floor(days) + 2440588).astype("i4"), units="True Julian Day", epic_code=624)
    milliseconds = np.round((days % 1.0) * 86_400_000).astype("i4")
    put(nc, "time2", ("time",), milliseconds, units="msec since 0:00 GMT", epic_code=624)
    put(nc, "depth", ("depth",), 100.0 - t.range_m, units="m", epic_code=3)
    put(nc, "bindist", ("depth",), t.range_m, units="m", note="distance from transducer head")
    at = ("time", "depth", "lat", "lon")
    for name, values in (("u_1205", east), ("v_1206", north)):
        put(nc, name, at, (100.0 * values).astype("f4"), EPIC_FILL, units="cm/s")
    point = ("time", "lat", "lon")
    put(nc, "Hdg_1215", point, heading.astype("f4"), EPIC_FILL, units="degrees")
    put(nc, "Ptch_1216", point, t.pitch_deg.astype("f4"), units="degrees")
    put(nc, "Roll_1217", point, t.roll_deg.astype("f4"), units="degrees")
    put(nc, "P_1", point, t.pressure_dbar.astype("f4"), units="dbar")
    put(nc, "Tx_1211", point, t.temperature_c.astype("f4"), units="C")


def stglib(nc: netCDF4.Dataset, t: Truth) -> None:
    """Write the CF layout of stglib: bins first, rotation stated in the history, z and depth besides bindist."""
    east, north, heading = t.true()
    dimensions(nc, time=N, z=M)
    nc.setncatts({"Conventions": "CF-1.9", "orientation": "UP", "magnetic_variation": DECLINATION, "beam_angle": 25})
    nc.history = f"2024-01-01T00:00:00: Rotating heading and horizontal velocities by {DECLINATION} degrees."
    put(nc, "time", ("time",), t.time_s - START, units="seconds since 2007-09-04 00:00:00", standard_name="time")
    put(nc, "z", ("z",), t.range_m - 100.0, units="m", standard_name="height", positive="up")
    put(nc, "depth", ("z",), 100.0 - t.range_m, units="m", standard_name="depth", positive="down")
    put(nc, "bindist", ("z",), t.range_m, units="m", long_name="distance from transducer head")
    for name, word, values in (("u_1205", "eastward", east), ("v_1206", "northward", north)):
        said = {"units": "m s-1", "standard_name": f"{word}_sea_water_velocity"}
        put(nc, name, ("z", "time"), values.astype("f4"), 1e35, **said)
    put(nc, "Hdg_1215", ("time",), heading, 1e35, units="degrees", standard_name="platform_orientation")
    put(nc, "Ptch_1216", ("time",), t.pitch_deg, units="degrees", standard_name="platform_pitch")
    put(nc, "Roll_1217", ("time",), t.roll_deg, units="degrees", standard_name="platform_roll")
    put(nc, "P_1", ("time",), 10.0 * t.pressure_dbar, units="kPa", standard_name="sea_water_pressure")
    put(nc, "Tx_1211", ("time",), t.temperature_c + 273.15, units="K")


LAYOUTS = {layout.__name__: layout for layout in (oceansites, imos_magnetic, imos_true, epic, stglib)}


def write(path: Path, layout: str) -> Truth:
    """Write the record in one layout and return its true values."""
    made = truth()
    with netCDF4.Dataset(path, "w") as nc:
        LAYOUTS[layout](nc, made)
    return made
