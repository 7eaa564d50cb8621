"""Would catch an export that other programs read otherwise, a PD0 file changed in more than its directions."""

import json
import shutil
import sys
import zipfile
from pathlib import Path

import netCDF4
import numpy as np
import pandas
import pytest

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.cli import main
from compasslib.pipeline.process import process_mooring
from compasslib.readers import pd0
from compasslib.readers.pd0.fields import rewrite
from compasslib.readers.pd0.frames import find_ensembles
from compasslib.records import MISSING
from tests.world.launch import change
from tests.world.pd0_encoder import ensemble
from tests.world.sea import SHARED, START, cruise, mhkit

EH2 = SHARED / "pd0/eh2_20060530_20060717_0007m.000"
READ = {"declination_applied": None, "heading_alignment": None}
BEAM, INSTRUMENT, SHIP, EARTH = 0b00111, 0b01111, 0b10111, 0b11111  # EX


def deviation(heading_deg):
    return 25.0 * angles.sin_cos(heading_deg)[0] - 3.0


def turn(leaders):
    return np.where(leaders.heading_deg < 300.0, deviation(leaders.heading_deg), np.nan)


@pytest.fixture(scope="module")
def world(tmp_path_factory) -> Path:
    """Process a cruise that is deployed five hours after its raw file begins, with a clock two minutes fast."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), n=80)
    top = {"format": "pd0", "files": "raw/M1/top.000", "depth": 100, "orientation": "up", "clock_offset_seconds": 120}
    deep = {"format": "table", "files": "raw/M1/deep.csv", "depth": 105}
    deep["columns"] = {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}
    begin = START.replace(hour=5).strftime("%Y-%m-%dT%H:%M:%SZ")
    change(folder / "config/moorings/M1.yaml", start=begin, instruments={"top": top, "deep": deep})
    process_mooring(folder, "M1", folder / "corrected/M1")
    return folder


def exported(capsys, world: Path, form: str, into: Path) -> list[Path]:
    assert main(["export", "M1", "--cruise", str(world), "--to", form, "--into", str(into)]) == 0
    return [Path(line) for line in capsys.readouterr().out.split()]


def refused(capsys, *words: str) -> str:
    assert main(["export", *words]) == 1
    out, err = capsys.readouterr()
    assert out == "" and err.startswith("error: ") and err.count("\n") == 1
    return err


def test_pandas_reads_the_table_and_its_sidecar(world, tmp_path, capsys):
    table, sidecar = exported(capsys, world, "csv", tmp_path)
    read = pandas.read_csv(table, parse_dates=["TIME"])
    with netCDF4.Dataset(world / "corrected/M1/corrected.nc") as nc:
        n, m = nc["UCUR"].shape
        assert len(read) == n * m and read.TIME.iloc[0] == pandas.Timestamp("2007-09-04T05:58:00Z")
        names = ("UCUR", "HEADING_TRUE", "CORRELATION_3", "UCUR_QC")
        wide = {name: read[name].to_numpy().reshape(n, m) for name in names}
        # The table is written with seven digits.
        np.testing.assert_allclose(wide["UCUR"], nc["UCUR"][:].filled(np.nan), rtol=1e-6)
        np.testing.assert_allclose(wide["HEADING_TRUE"][:, 1], nc["HEADING_TRUE"][:].filled(np.nan), rtol=1e-6)
        np.testing.assert_array_equal(wide["CORRELATION_3"], nc["CORRELATION"][2])
        np.testing.assert_array_equal(wide["UCUR_QC"], nc["UCUR_QC"][:])
        told = json.loads(sidecar.read_text())
        assert [told["columns"][name]["units"] for name in ("UCUR", "HEADING_TRUE")] == ["m s-1", "degree"]
        assert told["for_all_rows"]["LATITUDE"] == 65.3333 and told["attributes"]["id"] == nc.id
        columns = {column.rsplit("_", 1)[0] if column[-1].isdigit() else column for column in read.columns}
        assert columns == set(told["columns"])


def test_parquet_has_the_rows_of_the_table(world, tmp_path, capsys):
    parquet = pytest.importorskip("pyarrow.parquet")
    (file,) = exported(capsys, world, "parquet", tmp_path)
    table, sidecar = exported(capsys, world, "csv", tmp_path)
    read, written = pandas.read_parquet(file), pandas.read_csv(table, parse_dates=["TIME"])
    assert list(read.columns) == list(written.columns) and (read.TIME == written.TIME).all()
    np.testing.assert_allclose(read.UCUR, written.UCUR, rtol=1e-6)
    told = json.loads(parquet.read_schema(file).metadata[b"compasslib"])
    same = json.loads(sidecar.read_text())
    assert [*told["columns"]["UCUR"]] == [*same["columns"]["UCUR"]] and told["for_all_rows"] == same["for_all_rows"]


def test_zarr_has_the_values_and_attributes_of_the_product_once(world, tmp_path, capsys, recwarn):
    xarray, zarr = pytest.importorskip("xarray"), pytest.importorskip("zarr")
    (file,) = exported(capsys, world, "zarr", tmp_path / "a")
    assert not [warning for warning in recwarn if "zarr" in str(warning.message)]
    with zipfile.ZipFile(file) as packed:
        assert len({*packed.namelist()}) == len(packed.namelist())
    assert (
        xarray.open_zarr(zarr.storage.ZipStore(file, mode="r"))
        .load()
        .identical(xarray.load_dataset(world / "corrected/M1/corrected.nc"))
    )
    assert exported(capsys, world, "zarr", tmp_path / "b")[0].read_bytes() == file.read_bytes()


def test_erddap_gets_one_set_of_axes(world, tmp_path, capsys):
    pytest.importorskip("xarray")
    (file,) = exported(capsys, world, "erddap", tmp_path)
    with netCDF4.Dataset(file) as nc, netCDF4.Dataset(world / "corrected/M1/gridded.nc") as whole:
        kept = {name: v.dimensions for name, v in nc.variables.items() if not name.endswith("_bnds")}
        assert {axes for axes in kept.values() if len(axes) > 1} == {("TIME", "DEPTH")} and "UCUR_UNCERTAINTY" in kept
        np.testing.assert_array_equal(nc["UCUR"][:], whole["UCUR"][:])
        assert nc["TIME"].units == whole["TIME"].units and whole.cdm_profile_variables == "TIME"
        assert nc.cdm_data_type == "Grid" and not {"featureType", "cdm_timeseries_variables"} & {*nc.ncattrs()}
        assert set(nc["UCUR"].ancillary_variables.split()) <= set(kept)
        assert not any("_FillValue" in nc[name].ncattrs() for name in ("TIME", "DEPTH", "LATITUDE", "TIME_bnds"))


def test_packages_that_a_form_needs_are_named(world, tmp_path, capsys, monkeypatch):
    for form, module, package in (("parquet", "pyarrow", "pyarrow"), ("zarr", "zarr.storage", "zarr")):
        monkeypatch.setitem(sys.modules, module, None)
        line = refused(capsys, "M1", "--cruise", str(world), "--to", form, "--into", str(tmp_path))
        assert f"expected the package {package}, found it is not installed; pip install {package}" in line
    assert not any(tmp_path.iterdir())


def test_scipy_reads_the_structures(world, tmp_path, capsys):
    from scipy.io import loadmat

    (file,) = exported(capsys, world, "mat", tmp_path / "a")
    read = loadmat(file, simplify_cells=True)
    with netCDF4.Dataset(world / "corrected/M1/corrected.nc") as nc:
        assert set(read["data"]) == {*nc.variables, "DATENUM"} == set(read["units"]) == set(read["long_name"])
        for name in ("UCUR", "HEADING_CORRECTED_UNCERTAINTY", "CORRELATION", "ERROR_VELOCITY_QC", "DEPTH"):
            np.testing.assert_array_equal(read["data"][name], np.ma.filled(nc[name][:].astype(float), np.nan), name)
            assert read["units"][name] == getattr(nc[name], "units", "1")
        assert read["attributes"]["id"] == nc.id and read["data"]["STATION"] == "M1"
        days = np.datetime64("2007-09-04T05:58") - np.datetime64("0000-01-01")  # this is day 1 in MATLAB
    assert read["data"]["DATENUM"][0] == pytest.approx(days / np.timedelta64(1, "D") + 1.0, abs=1e-8)
    assert exported(capsys, world, "mat", tmp_path / "b")[0].read_bytes() == file.read_bytes()


def test_oceansites_export_is_the_renamed_product(world, tmp_path, capsys):
    xarray = pytest.importorskip("xarray")
    (file,) = exported(capsys, world, "oceansites", tmp_path)
    assert file.name == "OS_M1_200709_D_compass-corrected.nc"
    assert file.read_bytes() == (world / "corrected/M1/corrected.nc").read_bytes()
    with xarray.open_dataset(file, decode_cf=True) as data:
        assert {"TIME", "BIN", "BEAM", "DEPTH", "LATITUDE", "LONGITUDE"} <= set(data.coords)
        for name in ("UCUR", "WCUR", "CORRELATION", "HEADING_TRUE"):
            assert data[name].attrs["units"] and data[name].dims[-1] == ("TIME" if name == "HEADING_TRUE" else "BIN")


@pytest.mark.parametrize("form", ["csv", "mat", "pd0", "oceansites"])
def test_existing_files_are_not_overwritten(world, tmp_path, capsys, form):
    first, *_ = exported(capsys, world, form, tmp_path)
    first.write_bytes(b"mine")
    line = refused(capsys, "M1", "--cruise", str(world), "--to", form, "--into", str(tmp_path))
    assert f"{first.name}: expected a file that is not there yet" in line and first.read_bytes() == b"mine"


def test_pd0_reader_recovers_the_corrected_headings(world, tmp_path, capsys):
    file, sidecar = exported(capsys, world, "pd0", tmp_path)
    assert file.name == "M1_top_corrected.000" and sidecar.name == "M1_top_corrected.000.json"
    back = pd0.read([file], orientation="up", **READ)
    product = netcdf.read_corrected(world / "corrected/M1/corrected.nc")
    at = np.searchsorted(back.time_s - 120.0, product.record.time_s)
    assert len(back.time_s) == 80 and len(at) == 74
    off = angles.difference(back.heading_deg[at], product.heading_corrected_deg)
    assert np.abs(off).max() <= 0.005 + 1e-9  # a count is 0.01 degrees
    east, north = angles.turn(back.east[at], back.north[at], product.declination_deg[:, None])
    assert max(np.abs(east - product.east).max(), np.abs(north - product.north).max()) < 0.001  # a count is 1 mm/s
    outside = np.setdiff1d(np.arange(80), at)
    assert np.isnan(back.heading_deg[outside]).all() and (back.quality[outside] == MISSING).all()
    told = json.loads(sidecar.read_text())
    assert told["ensembles"] == {"corrected": 74, "without_heading": 6}
    assert told["original"]["sha256"] in str(netCDF4.Dataset(world / "corrected/M1/corrected.nc").history)


@pytest.mark.parametrize("change_it", ["raw", "clock", "mooring", "format"])
def test_changed_raw_files_or_settings_are_refused(world, tmp_path, capsys, change_it):
    copied, name = Path(shutil.copytree(world, tmp_path / "c")), "M1"
    yaml_file = copied / "config/moorings/M1.yaml"
    if change_it == "raw":
        (copied / "raw/M1/top.000").write_bytes((copied / "raw/M1/top.000").read_bytes() + b"more")
    if change_it == "clock":
        yaml_file.write_text(yaml_file.read_text().replace("clock_offset_seconds: 120", "clock_offset_seconds: 60"))
    if change_it == "mooring":
        (copied / "corrected/M1").rename(copied / "corrected/M2")
        name = "M2"
    if change_it == "format":
        yaml_file.write_text(yaml_file.read_text().replace("compromised: top\nreference: deep", "compromised: deep"))
    expected = {
        "raw": "raw/M1/top.000: expected the raw file behind",
        "clock": "found none for 74; clock or reader settings have changed since: run the cruise again",
        "mooring": "M2: expected a mooring of the cruise (M1)",
        "format": "M1: deep: expected raw files in PD0, found table; export it to csv, mat or oceansites",
    }
    said = refused(capsys, name, "--cruise", str(copied), "--to", "pd0", "--into", str(tmp_path / "out"))
    assert expected[change_it] in said and not list((tmp_path / "out").glob("*"))


@pytest.mark.parametrize(("ex", "turned"), [(BEAM, False), (INSTRUMENT, False), (SHIP, False), (EARTH, True)])
def test_only_heading_checksum_and_earth_velocities_change(tmp_path, ex, turned):
    counts = [[100 * k, -50, 7, 3] for k in range(1, 4)] + [[-32768] * 4]
    raw = b"".join(
        ensemble(counts, fixed={"ex": ex, "eb": 700}, number=k, heading=heading)
        for k, heading in enumerate((0, 8999, 35999, 36001))
    )
    (tmp_path / "raw.000").write_bytes(raw)
    said = rewrite(tmp_path / "raw.000", tmp_path / "new.000", turn)
    old, new = (
        np.concatenate([run.rows for run in find_ensembles(file)[0]])
        for file in (tmp_path / "raw.000", tmp_path / "new.000")
    )
    assert (said.corrected, said.flagged, said.skipped) == (2, 2, ())
    layout = find_ensembles(tmp_path / "new.000")[0][0].layout
    heading, velocity = layout.blocks[0x80][0] + 18, layout.blocks[0x100][0] + 2
    may = np.zeros(old.shape[1], dtype=bool)
    may[[heading, heading + 1, -2, -1]] = True
    flows = np.zeros_like(may)
    flows[velocity : velocity + 32] = True
    assert (old[:, ~(may | flows)] == new[:, ~(may | flows)]).all()
    assert (old[:2, flows] == new[:2, flows]).all() == (not turned)
    assert (new[2:, flows].copy().view("<i2") == -32768).all()
    assert new[:, heading : heading + 2].copy().view("<u2").ravel().tolist() == [35700, 11199, 65535, 65535]
    if turned:
        east, north = angles.turn(np.array([100.0, 200.0, 300.0]), -50.0, deviation(89.99))
        got = new[1, flows].copy().view("<i2").reshape(4, 4)
        np.testing.assert_array_equal(got[:3, :2], np.rint(np.stack([east, north], axis=1)))
        assert (got[:3, 2:] == [7, 3]).all() and (got[3] == -32768).all()


def test_bottom_track_is_rotated_like_the_water_velocities(tmp_path):
    track = bytearray(81)
    for at, counts in ((0, [0x0600]), (24, [300, -40, 5, 1]), (50, [-32768, -32768, 5, 1])):
        track[at : at + 2 * len(counts)] = np.array(counts).astype("<u2" if at == 0 else "<i2").tobytes()
    raw = b"".join(ensemble([[300, -40, 5, 1]], number=k, heading=k * 4000, extra=[bytes(track)]) for k in (1, 8))
    (tmp_path / "raw.000").write_bytes(raw)
    rewrite(tmp_path / "raw.000", tmp_path / "new.000", turn)
    (run,) = find_ensembles(tmp_path / "new.000")[0]
    at, water = run.layout.blocks[0x0600][0], run.layout.blocks[0x0100][0] + 2
    moved, layer, seen = (run.rows[:, a : a + 8].copy().view("<i2").tolist() for a in (at + 24, at + 50, water))
    assert moved == seen and moved[0] != [300, -40, 5, 1] and moved[1] == [-32768] * 4
    assert layer == [[-32768, -32768, 5, 1], [-32768] * 4]


def test_speeds_beyond_the_range_of_the_format_become_bad(tmp_path):
    (tmp_path / "raw.000").write_bytes(ensemble([[32000, 32000, 0, 0]], heading=4000))
    rewrite(tmp_path / "raw.000", tmp_path / "new.000", lambda leaders: np.full(1, 45.0))
    assert np.isnan(pd0.decode(tmp_path / "new.000").velocity).all()


@pytest.mark.skipif(not EH2.exists(), reason="needs the recordings beside the project")
def test_real_file_with_new_headings_is_read_by_mhkit(tmp_path):
    new = tmp_path / "eh2.000"
    said = rewrite(EH2, new, turn)
    old, back = (pd0.read([file], orientation="down", **READ) for file in (EH2, new))
    assert said.corrected + said.flagged == len(old.time_s) == len(back.time_s) and len(said.skipped) > 0
    by = turn(old)
    kept = np.isfinite(by)
    expected = angles.wrap360(old.heading_deg + by)[kept]
    assert np.abs(angles.difference(back.heading_deg[kept], expected)).max() <= 0.005 + 1e-9
    east, _ = angles.turn(old.east[kept], old.north[kept], by[kept][:, None])
    assert np.nanmax(np.abs(back.east[kept] - east)) <= 0.0005 + 1e-9 and np.isnan(back.east[~kept]).all()
    assert back.counts["bytes_skipped"] == 0  # damaged bytes were left out
    with mhkit() as dolfyn:
        seen = dolfyn.read(str(new))
    n = len(seen.time)  # mhkit leaves the last ensemble out
    np.testing.assert_allclose(seen.heading.values[kept[:n]], expected[: kept[:n].sum()], atol=0.0051)
    # mhkit returns float32.
    for found, expected in ((seen.vel[0], back.east), (seen.vel[1], back.north), (seen.vel[2], back.profiles["up"])):
        np.testing.assert_allclose(found.values.T, expected[:n], atol=1e-5)
    good = np.moveaxis(seen.prcnt_gd.values, 0, 2).swapaxes(0, 1)
    np.testing.assert_array_equal(good, old.profiles["percent_good"][:n])
