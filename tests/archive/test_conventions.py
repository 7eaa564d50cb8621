"""Would catch an archive file that breaks CF, ACDD or OceanSITES, and a check of these that overlooks it."""

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
# Nor have recorded currents any, so that a selection by standard name yields the corrected ones.
WITHOUT_STANDARD_NAME = {
    *("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY", "HEADING_COMMON_UNCERTAINTY"),
    *("DEVIATION", "BRANCH_PROBABILITY", "DECLINATION", "UCUR_RECORDED", "VCUR_RECORDED"),
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


# Variable, attribute, its new value (None: deleted), and the remark.
BROKEN = [
    ("", "site_code", None, "global attribute site_code is ''"),
    ("", "format_version", "1.3", "format_version is not the one in Conventions"),
    ("", "history", "corrected by me", "global attribute history is"),
    ("", "geospatial_lat_max", 95.0, "global attribute geospatial_lat_max is 95.0"),
    ("TIME", "units", "seconds since 1970-01-01T00:00:00Z", "TIME:units is 'seconds since 1970"),
    ("TIME", "QC_indicator", None, "TIME has neither QC_indicator nor TIME_QC"),
    ("UCUR", "standard_name", "sea_water_speed", "UCUR:standard_name is not eastward_sea_water_velocity"),
    ("DEVIATION", "units", None, "DEVIATION:units is missing"),
    ("VCUR", "coordinates", "TIME HEIGHT", "VCUR:coordinates names HEIGHT, which is not in the file"),
    ("VCUR", "ancillary_variables", "NONE", "VCUR:ancillary_variables does not name VCUR_QC"),
    ("UCUR", "sensor_orientation", "up", "UCUR:sensor_orientation is 'up'"),
    ("UCUR_UNCERTAINTY", "units", "cm s-1", "UCUR_UNCERTAINTY:units are not those of UCUR"),
    ("UCUR_QC", "flag_meanings", "good bad", "UCUR_QC:flag_meanings are not those of table 2"),
]


@pytest.mark.parametrize(("variable", "name", "value", "remark"), BROKEN, ids=[remark for *_, remark in BROKEN])
def test_each_violated_rule_is_reported(tmp_path, corrected, variable, name, value, remark):
    path = Path(shutil.copy(corrected, tmp_path / "c.nc"))
    with netCDF4.Dataset(path, "a") as nc:
        holder = nc[variable] if variable else nc
        if value is None:
            holder.delncattr(name)
        else:
            holder.setncattr(name, value)
    remarks = conventions.oceansites_remarks(path)
    assert any(one.startswith(remark) for one in remarks), remarks


@pytest.mark.parametrize(
    ("variable", "index", "value", "remark"),
    [
        ("TIME", 3, 0.0, "TIME does not increase"),
        ("TIME", 3, np.nan, "TIME may have no missing values"),
        ("UCUR_QC", (0, 0), 1, "UCUR_QC calls a missing value usable"),
        ("UCUR_QC", (0, 0), 5, "UCUR_QC holds a flag that table 2 has not"),
    ],
)
def test_invalid_values_are_reported(tmp_path, corrected, variable, index, value, remark):
    path = Path(shutil.copy(corrected, tmp_path / "c.nc"))
    with netCDF4.Dataset(path, "a") as nc:
        nc.set_auto_mask(False)
        nc[variable][index] = value
    assert remark in conventions.oceansites_remarks(path)
