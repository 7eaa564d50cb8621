"""Would catch an archive file that breaks CF, ACDD or OceanSITES."""

import socket
from pathlib import Path

import netCDF4
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


@pytest.mark.parametrize(
    ("variable", "name", "value", "remark"),
    [
        ("", "site_code", "", "global attribute site_code is ''"),
        ("TIME", "units", "seconds since 1970-01-01T00:00:00Z", "TIME:units is 'seconds since 1970"),
        ("VCUR", "coordinates", "TIME HEIGHT", "VCUR:coordinates names HEIGHT, which is not in the file"),
        ("UCUR_QC", "flag_meanings", "good bad", "UCUR_QC:flag_meanings are not those of table 2"),
    ],
)
def test_a_violated_rule_is_reported(tmp_path, variable, name, value, remark):
    path = write(tmp_path / "c.nc")
    with netCDF4.Dataset(path, "a") as nc:
        (nc[variable] if variable else nc).setncattr(name, value)
    assert any(one.startswith(remark) for one in conventions.oceansites_remarks(path))
