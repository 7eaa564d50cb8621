"""Would catch an archive file that breaks CF, ACDD or OceanSITES, and a check of these that overlooks it."""

from __future__ import annotations

import shutil
import socket
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from compasslib.archive import attributes as archive_attributes
from compasslib.archive import netcdf
from tests.world import conventions
from tests.world.products import PROCESSING, USUAL, make_pairs, make_product, make_record, measured, write

# CF has no standard names for these: its orientation is relative to north; deviation and declination have none.
WITHOUT_STANDARD_NAME = {
    *("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "HEADING_COMMON_UNCERTAINTY"),
    *("DEVIATION", "BRANCH_PROBABILITY"),
    *(
        "DECLINATION",
        "UCUR_RECORDED",
        "VCUR_RECORDED",
    ),  # so that a selection by standard name yields the corrected current
}
HISTORY = {"history": PROCESSING["history"]}


@pytest.fixture(scope="module")
def corrected(tmp_path_factory) -> Path:
    return write(tmp_path_factory.mktemp("archive") / "corrected.nc", make_product(**measured()))


@pytest.fixture
def offline(monkeypatch):
    def refuse(*_):
        raise OSError("no network in tests")

    monkeypatch.setattr(socket.socket, "connect", refuse)


def checked(path: Path, checker: str) -> list[str]:
    if not conventions.installed():
        pytest.skip("compliance-checker is not installed")
    return conventions.checked(path, checker)


# ----------------------------------------------------------------------------------------------- CF and ACDD, by others
@pytest.mark.filterwarnings("ignore")  # warnings of the checker
@pytest.mark.parametrize("m", [6, 1])
def test_product_has_no_cf_remarks(tmp_path, offline, m):
    assert checked(write(tmp_path / "c.nc", make_product(200, m, **measured(200, m))), conventions.CF) == []


@pytest.mark.filterwarnings("ignore")
def test_pairs_and_records_have_no_cf_remarks(tmp_path, offline):
    netcdf.write_pairs(tmp_path / "overlap.nc", make_pairs(), attributes=HISTORY)
    netcdf.write_record(tmp_path / "top.nc", make_record(**measured()), attributes=HISTORY)
    for file in ("overlap.nc", "top.nc"):
        assert checked(tmp_path / file, conventions.CF) == [], file


@pytest.mark.filterwarnings("ignore")
def test_acdd_remarks_are_only_nonexistent_standard_names(tmp_path, offline):
    missing = {f'variable "{name}" missing the following attributes: standard_name' for name in WITHOUT_STANDARD_NAME}
    given = USUAL | dict.fromkeys(archive_attributes.ASKED_FOR, "given")
    assert set(checked(write(tmp_path / "c.nc", attributes=given), conventions.ACDD)) == missing
    assert missing < conventions.UNAVOIDABLE  # which also contains those of gridded.nc


# ------------------------------------------------------------------------------------------ OceanSITES, by its manual
@pytest.mark.parametrize(("n", "m"), [(200, 6), (1, 1), (0, 6)])
@pytest.mark.parametrize("uncorrectable", [0, 200])
def test_product_has_no_oceansites_remarks(tmp_path, n, m, uncorrectable):
    path = write(tmp_path / "c.nc", make_product(n, m, uncorrectable=uncorrectable))
    assert conventions.oceansites_remarks(path) == []


def attribute(name: str, value: object, variable: str | None = None):
    """Return a function that sets an attribute, or deletes it if the value is None."""

    def change(nc: netCDF4.Dataset) -> None:
        holder = nc if variable is None else nc[variable]
        if value is None:
            holder.delncattr(name)
        else:
            holder.setncattr(name, value)

    return change


def value(variable: str, index: object, new: object):
    def change(nc: netCDF4.Dataset) -> None:
        nc.set_auto_mask(False)
        nc[variable][index] = new

    return change


def renamed(old: str, new: str):
    return lambda nc: nc.renameVariable(old, new)


BROKEN = [
    (attribute("site_code", None), "global attribute site_code is ''"),
    (attribute("data_mode", "X"), "global attribute data_mode is 'X'"),
    (attribute("data_type", "mooring"), "global attribute data_type is 'mooring'"),
    (attribute("format_version", "1.3"), "format_version is not the one in Conventions"),
    (attribute("Conventions", "CF-1.8"), "global attribute Conventions is 'CF-1.8'"),
    (attribute("id", "OS_EG_4_200709_D_a_b"), "global attribute id is"),
    (attribute("history", "corrected by me"), "global attribute history is"),
    (attribute("update_interval", "yearly"), "global attribute update_interval is 'yearly'"),
    (attribute("time_coverage_start", "2007-09-05 13:46"), "global attribute time_coverage_start is"),
    (attribute("time_coverage_duration", "66 hours"), "global attribute time_coverage_duration is"),
    (attribute("processing_level", "level 2"), "global attribute processing_level is"),
    (attribute("QC_indicator", "fine"), "global attribute QC_indicator is 'fine'"),
    (attribute("summary", None), "global attribute summary is missing"),
    (attribute("geospatial_lat_max", 95.0), "global attribute geospatial_lat_max is 95.0"),
    (attribute("geospatial_lon_min", None), "global attribute geospatial_lon_min is None"),
    (attribute("geospatial_vertical_max", None), "global attribute geospatial_vertical_max is missing"),
    (attribute("units", "seconds since 1970-01-01T00:00:00Z", "TIME"), "TIME:units is 'seconds since 1970"),
    (attribute("axis", None, "TIME"), "TIME:axis is ''"),
    (attribute("QC_indicator", None, "TIME"), "TIME has neither QC_indicator nor TIME_QC"),
    (value("TIME", 3, 0.0), "TIME does not increase"),
    (value("TIME", 3, np.nan), "TIME may have no missing values"),
    (attribute("reference", "NAD27", "LATITUDE"), "LATITUDE:reference is 'NAD27'"),
    (attribute("coordinate_reference_frame", None, "DEPTH"), "DEPTH:coordinate_reference_frame is ''"),
    (attribute("positive", "up", "DEPTH"), "DEPTH:positive is 'up'"),
    (renamed("LATITUDE", "latitude"), "variable LATITUDE is missing"),
    (renamed("PITCH", "pitch"), "variable pitch is not named in capitals"),
    (attribute("standard_name", "sea_water_speed", "UCUR"), "UCUR:standard_name is not eastward_sea_water_velocity"),
    (attribute("long_name", None, "ROLL"), "ROLL:long_name is missing"),
    (attribute("units", None, "DEVIATION"), "DEVIATION:units is missing"),
    (attribute("coordinates", None, "VCUR"), "VCUR:coordinates is missing"),
    (attribute("coordinates", "TIME HEIGHT", "VCUR"), "VCUR:coordinates names HEIGHT, which is not in the file"),
    (attribute("ancillary_variables", "NONE", "VCUR"), "VCUR:ancillary_variables names NONE"),
    (attribute("ancillary_variables", "NONE", "VCUR"), "VCUR:ancillary_variables does not name VCUR_QC"),
    (attribute("sensor_orientation", "up", "UCUR"), "UCUR:sensor_orientation is 'up'"),
    (attribute("units", "cm s-1", "UCUR_UNCERTAINTY"), "UCUR_UNCERTAINTY:units are not those of UCUR"),
    (attribute("long_name", "error", "UCUR_UNCERTAINTY"), "UCUR_UNCERTAINTY:long_name is not"),
    (renamed("ROLL_QC", "ROLL_FLAG"), "ROLL has neither QC_indicator nor ROLL_QC"),
    (value("UCUR_QC", (0, 0), 1), "UCUR_QC calls a missing value usable"),
    (value("UCUR_QC", (0, 0), 5), "UCUR_QC holds a flag that table 2 has not"),
    (attribute("flag_values", np.arange(8, dtype=np.int8), "UCUR_QC"), "UCUR_QC:flag_values are not those of table 2"),
    (attribute("flag_meanings", "good bad", "UCUR_QC"), "UCUR_QC:flag_meanings are not those of table 2"),
    (attribute("long_name", "flag", "UCUR_QC"), "UCUR_QC:long_name is not 'quality flag for UCUR'"),
]


@pytest.mark.parametrize(("change", "remark"), BROKEN, ids=[remark for _, remark in BROKEN])
def test_each_violated_rule_is_reported(tmp_path, corrected, change, remark):
    path = Path(shutil.copy(corrected, tmp_path / "c.nc"))
    with netCDF4.Dataset(path, "a") as nc:
        change(nc)
    remarks = conventions.oceansites_remarks(path)
    assert any(one.startswith(remark) for one in remarks), remarks


def test_invalid_dimensions_and_types_are_reported(tmp_path):
    with netCDF4.Dataset(tmp_path / "c.nc", "w") as nc:
        nc.createDimension("TIME", 3)
        nc.createDimension("DEPTH", 2)
        nc.createVariable("TIME", "f4", ("TIME",))[:] = [1, 2, 3]
        nc.createVariable("TEMP", "f4", ("DEPTH", "TIME"))
        nc.createVariable("TEMP_QC", "i4", ("TIME",))[:] = 1
    said = conventions.oceansites_remarks(tmp_path / "c.nc")
    for remark in (
        "TIME is not double TIME(TIME)",
        "TEMP: TIME is not the first of its dimensions",
        "TEMP:_FillValue is missing",
        "TEMP_QC has other dimensions than TEMP",
        "TEMP_QC is not of type byte",
        "TEMP:standard_name is not sea_water_temperature",
    ):
        assert remark in said, said
