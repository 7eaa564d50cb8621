"""compass init: a cruise drafted from its exports, that runs once a person has decided what files cannot tell."""

from __future__ import annotations

import os
from pathlib import Path

import netCDF4
import netcdf_layouts
import pytest
import yaml
from bench import readings, write_table
from launch import PROJECT
from sea import cruise

from compasslib.command import main
from compasslib.readers import headers

DATA = PROJECT.parent / "shared/data"
PLACE = ("--latitude", "65.3333", "--longitude", "-32.955", "--water-depth", "894")


def draft(folder: Path, name: str) -> dict:
    return yaml.safe_load((folder / f"config/moorings/{name}.yaml").read_text())


def test_a_folder_of_exports_becomes_a_cruise_that_is_ready(tmp_path, capsys, monkeypatch):
    made, new = cruise(tmp_path / "made", ("M1", "M2"), n=50), tmp_path / "new"
    assert main(["init", str(made / "raw"), "--into", str(new), *PLACE]) == 0
    mooring = draft(new, "M1")
    assert mooring["compromised"] == "top" and mooring["reference"] == "deep"
    assert mooring["instruments"]["top"]["format"] == "pd0" and mooring["instruments"]["top"]["orientation"]
    assert {"east", "north", "time", "scale"} <= set(mooring["instruments"]["deep"]["columns"])
    assert (new / "raw/M1/top.000").resolve() == made / "raw/M1/top.000"
    capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    assert main(["check", "new"]) == 0  # by a path from where one stands
    said = capsys.readouterr().out
    assert "2 moorings: ready" in said and "M1.yaml: 8 values still to decide" in said
    path = new / "config/moorings/M1.yaml"
    path.write_text(path.read_text().replace("DECIDE:", ""))
    assert main(["check", str(new)]) == 0 and "M1.yaml: " not in capsys.readouterr().out


def test_what_the_files_cannot_tell_is_asked_and_refused_until_it_is_decided(tmp_path, capsys):
    made = cruise(tmp_path, n=50)
    os.rename(made / "config", made / "old")
    assert main(["init", str(made / "raw"), "--into", str(made)]) == 0
    text = (made / "config/moorings/M1.yaml").read_text()
    assert (
        "latitude: null  # DECIDE" in text and f"{text.count('# DECIDE:')} values to decide" in capsys.readouterr().out
    )
    assert main(["check", str(made)]) == 1 and "M1.yaml: latitude: expected" in capsys.readouterr().err


def test_no_file_that_is_there_is_touched(tmp_path, capsys):
    made = cruise(tmp_path, n=5)
    before = {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    assert main(["init", str(made / "raw"), "--into", str(made)]) == 1
    assert "M1.yaml: expected no such file yet" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in made.rglob("*") if path.is_file()} == before


def test_pieces_are_one_instrument_and_what_nobody_knows_is_left_out(tmp_path, capsys):
    made = cruise(tmp_path / "made", n=50)
    whole = (made / "raw/M1/top.000").read_bytes()
    half = len(whole) // 2
    (made / "raw/M1/top.000").write_bytes(whole[:half])
    (made / "raw/M1/top.001").write_bytes(whole[half:])
    (made / "raw/M1/photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert main(["init", str(made / "raw"), "--into", str(tmp_path / "new"), *PLACE]) == 0
    assert draft(tmp_path / "new", "M1")["instruments"]["top"]["files"] == ["raw/M1/top.000", "raw/M1/top.001"]
    assert "photo.png: an image" in capsys.readouterr().err


def test_a_bench_s_table_is_a_calibration(tmp_path, capsys):
    table = write_table(tmp_path / "aqd.csv", readings())
    assert main(["init", str(table), "--into", str(tmp_path / "new")]) == 0
    text = (tmp_path / "new/config/calibrations/aqd.yaml").read_text()
    assert yaml.safe_load(text)["kind"] == "platform"
    capsys.readouterr()
    assert main(["check", str(tmp_path / "new")]) == 0 and "aqd: platform" in capsys.readouterr().out


def test_a_netcdf_file_tells_its_place_and_keeps_its_own_word_on_north(tmp_path):
    netcdf_layouts.write(tmp_path / "imos.nc", "imos_magnetic")
    with netCDF4.Dataset(tmp_path / "imos.nc", "a") as nc:
        nc.setncatts({"geospatial_lat_min": 65.3, "geospatial_lon_min": -33.0, "water_depth": 894.0})
    assert main(["init", str(tmp_path / "imos.nc"), "--into", str(tmp_path / "new"), "--name", "X"]) == 0
    told = draft(tmp_path / "new", "X")
    assert (told["latitude"], told["longitude"], told["water_depth"]) == (65.3, -33.0, 894.0)
    assert "declination_applied" not in told["instruments"]["imos"]


def test_nothing_to_draft_from_is_one_line(tmp_path, capsys):
    (tmp_path / "notes.txt").write_text("deployed on Tuesday\n")
    assert main(["init", str(tmp_path), "--into", str(tmp_path / "new")]) == 1
    assert "expected exports of instruments" in capsys.readouterr().err and not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("header", "kind", "scale"),
    [
        ("time_utc,depth_m,u_cm_s,v_cm_s", "instrument", 0.01),
        ("Date,Time,Speed (mm/s),Direction (deg)", "instrument", 0.001),
        ("DateTime,Eastward velocity [m s-1],Northward velocity [m s-1]", "instrument", 1.0),
        ("t,u,v", "instrument", None),
        ("time_utc,vx_cm_s,vy_cm_s,heading_deg", "instrument", 0.01),
        ("time_utc,x,y,z,heading_deg", "magnetometer", None),
        ("compass_deg,cog_deg,speed_kn", "swing", None),
        ("reference_deg,recorded_deg", "platform", None),
        ("time,current_mA", "series", None),
    ],
)
def test_a_table_s_meaning_is_told_by_its_header(header, kind, scale):
    found = headers.of_header(header.split(","))
    assert (found.kind, found.scale) == (kind, scale) and set(found.columns.values()) <= set(header.split(","))


@pytest.mark.parametrize("header", ["foo,bar", "time,a,b", "u,v", "x,y,heading"])
def test_a_header_that_tells_too_little_tells_nothing(header):
    assert headers.of_header(header.split(",")) is None


@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not there")
def test_real_exports_are_drafted_with_what_they_tell(tmp_path, capsys):
    names = ("moored/aqd9330.aqd", "cruise_eh2/raw/E0/top.000", "observatory/esk1980dhor.hor")
    files = [str(DATA / name) for name in names]
    assert main(["init", *files, "--into", str(tmp_path / "new"), "--name", "X", *PLACE]) == 0
    told = draft(tmp_path / "new", "X")
    aquadopp, workhorse = told["instruments"]["aqd9330"], told["instruments"]["top"]
    assert aquadopp["format"] == "nortek" and aquadopp["attributes"] == {"serial_number": "AQD 9330"}
    assert workhorse["orientation"] == "down" and told["start"] == "2006-05-30T19:00:00Z"
    assert told["compromised"] == "top" and "reference" not in told  # no time in common
    hourly = yaml.safe_load((tmp_path / "new/config/calibrations/esk1980dhor.yaml").read_text())
    assert hourly["latitude"] == 65.3333  # as said: its header has none


@pytest.mark.parametrize("name", [b"t\xffop.000", b"t\nop.000"])
def test_a_name_that_no_yaml_file_can_hold_is_left_out_and_told(tmp_path, capsys, name):
    made, new = cruise(tmp_path / "made", n=50), tmp_path / "new"
    os.rename(made / "raw/M1/top.000", os.fsencode(made / "raw/M1") + b"/" + name)
    assert main(["init", str(made / "raw"), "--into", str(new), *PLACE]) == 0
    said = capsys.readouterr()
    told = [
        line for line in (said.out + said.err).splitlines() if "rename it in UTF-8, without control characters" in line
    ]
    assert len(told) == 1 and "op.000" in told[0]
    assert list(draft(new, "M1")["instruments"]) == ["deep"] and not [*new.rglob("*op.000")]
