"""Would catch a draft that guesses what no file tells, or asks for what one does."""

import functools
import operator
import os
from pathlib import Path

import netCDF4
import pytest
import yaml

from compasslib.cli import main
from compasslib.readers import detect
from tests.world import netcdf_layouts
from tests.world.bench import readings, write_table
from tests.world.launch import PROJECT
from tests.world.sea import cruise

DATA = PROJECT.parent / "shared/data"
PLACE = ("--latitude", "65.3333", "--longitude", "-32.955", "--water-depth", "894")


def sentences(*bodies: str) -> str:
    """Compose NMEA 0183 sentences with their checksums."""
    return "".join(f"${body}*{functools.reduce(operator.xor, body.encode()):02X}\r\n" for body in bodies)


def log(heading: str | None, course: str = "RMC", n: int = 72) -> str:
    """Compose an NMEA log of a turn in n steps of 5 degrees."""
    bodies = []
    for k in range(n):
        bodies += [heading.format(5 * k)] if heading else []
        bodies += [f"GPRMC,18{k // 60:02d}{k % 60:02d},A,0854.0,S,14006.0,W,5.0,{5 * k}.0,031110,10.7,E"]
        bodies += [f"GPVTG,{5 * k}.0,T,,M,5.0,N,9.3,K"] if course == "VTG" else []
    return sentences(*bodies)


def draft(folder: Path, name: str) -> dict:
    return yaml.safe_load((folder / f"config/moorings/{name}.yaml").read_text())


def decide(path: Path, **values: object) -> None:
    """Replace every DECIDE of a draft by the value given for its key, or else by that for ``otherwise``."""
    lines = path.read_text().splitlines()
    keys = [line.strip().partition(":")[0] for line in lines]
    lines = [
        line.replace(": DECIDE", f": {values.get(key, values['otherwise'])}")
        for key, line in zip(keys, lines, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n")


def test_drafted_cruise_can_run_once_decisions_are_made(tmp_path, capsys, monkeypatch):
    made, new = cruise(tmp_path / "made", ("M1", "M2"), n=50), tmp_path / "new"
    assert main(["init", str(made / "raw"), "--into", str(new), *PLACE]) == 0
    mooring = draft(new, "M1")
    assert mooring["compromised"] == "top" and mooring["reference"] == "deep"  # top alone has headings
    assert mooring["instruments"]["top"]["format"] == "pd0" and mooring["instruments"]["top"]["orientation"]
    assert {"east", "north", "time", "scale"} <= set(mooring["instruments"]["deep"]["columns"])
    assert (new / "raw/M1/top.000").resolve() == made / "raw/M1/top.000"
    capsys.readouterr()
    monkeypatch.chdir(tmp_path)
    assert main(["check", "new"]) == 1  # by a relative path
    out, err = capsys.readouterr()
    asked = "start, end, instruments.top.depth, instruments.top.declination_applied, instruments.deep.depth"
    expected = "expected a value of every key, found 6 DECIDE entries; replace each DECIDE by a value"
    assert f"M1.yaml: {expected}: {asked}" in err
    assert out.splitlines()[-1] == "cannot run, 2 problems"
    times = {"start": "2007-09-04T00:00:00Z", "end": "2007-09-06T02:00:00Z", "direction_reference": "magnetic"}
    for name in ("M1", "M2"):
        decide(new / f"config/moorings/{name}.yaml", **times, depth=100, otherwise=0)
    assert main(["check", str(new)]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "2 moorings: can run, 0 problems"


def test_undecided_entries_are_listed_and_refused(tmp_path, capsys):
    made = cruise(tmp_path, n=50)
    os.rename(made / "config", made / "old")
    assert main(["init", str(made / "raw"), "--into", str(made)]) == 0
    path = made / "config/moorings/M1.yaml"
    count = path.read_text().count(": DECIDE")
    assert "latitude: DECIDE  # degrees north" in path.read_text()
    assert f"{count} DECIDE entries to replace" in capsys.readouterr().out
    path.write_text(path.read_text().replace("compromised: top", "compromised: DECIDE").replace("auto", "strong"))
    assert main(["check", str(made)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert f"found {count + 1} DECIDE entries" in lines[0] and "water_depth, start, end, compromised, inst" in lines[0]
    assert "M1.yaml: declination: expected auto" in lines[1] and len(lines) == 2  # undecided keys are reported once


def test_affected_instrument_is_asked_for_where_two_have_headings(tmp_path):
    rows = [f"2007-09-04T{k:02d}:00:00Z,100,0.1,0.2,{15 * k}" for k in range(24)]
    for name in ("top", "deep"):
        (tmp_path / "M").mkdir(exist_ok=True)
        (tmp_path / f"M/{name}.csv").write_text("\n".join(["time_utc,depth_m,u_m_s,v_m_s,heading_deg", *rows, ""]))
    assert main(["init", str(tmp_path / "M"), "--into", str(tmp_path / "new"), *PLACE]) == 0
    assert draft(tmp_path / "new", "M")["compromised"] == draft(tmp_path / "new", "M")["reference"] == "DECIDE"
    text = (tmp_path / "new/config/moorings/M.yaml").read_text()
    assert "top: 1 bin at 100 m, headings in 24 of 36 sectors" in text


def test_records_and_series_are_grouped_into_moorings_by_time(tmp_path, capsys):
    made = cruise(tmp_path / "made", n=50)
    table = (made / "raw/M1/deep.csv").read_text()
    (made / "raw/M1/later.csv").write_text(table.replace("2007-", "2011-"))
    for year in (2007, 2011, 2015):
        rows = [f"{year}-09-04T0{k}:00:00Z,{k}" for k in range(9)]
        (made / f"raw/M1/pump{year}.csv").write_text("\n".join([f"time,pump{year}_mA", *rows, ""]))
    assert main(["init", str(made / "raw"), "--into", str(tmp_path / "new"), *PLACE]) == 0
    early, late = draft(tmp_path / "new", "M1_2007"), draft(tmp_path / "new", "M1_2011")
    assert set(early["instruments"]) == {"top", "deep"} and set(late["instruments"]) == {"later"}
    assert list(early["covariates"]) == ["pump2007_mA"] and list(late["covariates"]) == ["pump2011_mA"]
    assert "pump2015.csv: no instrument of M1 recorded at the time of this series" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("content", "drafted"),
    [
        (log("HCHDG,{}.0,,,10.7,E", "RMC"), {"kind": "swing"}),
        (log("HCHDM,{}.0,M", "RMC"), {"columns": {"compass_deg": "HDM", "cog_deg": "RMC"}}),
        (log("HEHDT,{}.0,T", "RMC"), "no magnetic heading"),
        (log(None, "VTG"), "no magnetic heading"),
        (log("HCHDG,{}.0,,,10.7,E", "RMC", n=20), "of the circle empty: no swing"),
        (
            sentences("PNORS,011626,010336,00000000,3EC40002,23.7,1530.2,310.0,-40.8,84.3,0.0,23.32,0,0"),
            "telemetry of a Nortek",
        ),
        (
            sentences("PNORI1,4,123,4,20,0.2,1.0,ENU", "PNORC1,083013,132455,3,11.0,0.33,0.3,0.4,0.1"),
            "telemetry of a Nortek",
        ),
    ],
)
def test_log_is_a_swing_only_with_magnetic_headings_all_round(tmp_path, capsys, content, drafted):
    (tmp_path / "ship.nmea").write_text(content, newline="")
    assert main(["init", str(tmp_path / "ship.nmea"), "--into", str(tmp_path / "new")]) == isinstance(drafted, str)
    if isinstance(drafted, str):
        assert drafted in capsys.readouterr().err
    else:
        found = yaml.safe_load((tmp_path / "new/config/calibrations/ship.yaml").read_text())
        assert found | drafted == found


def test_existing_files_are_not_overwritten(tmp_path, capsys):
    made = cruise(tmp_path, n=5)
    before = {path: path.read_bytes() for path in made.rglob("*") if path.is_file()}
    assert main(["init", str(made / "raw"), "--into", str(made)]) == 1
    assert "M1.yaml: expected no such file yet" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in made.rglob("*") if path.is_file()} == before


def test_file_pieces_are_joined_and_unknown_files_skipped(tmp_path, capsys):
    made = cruise(tmp_path / "made", n=50)
    whole = (made / "raw/M1/top.000").read_bytes()
    half = len(whole) // 2
    (made / "raw/M1/top.000").write_bytes(whole[:half])
    (made / "raw/M1/top.001").write_bytes(whole[half:])
    (made / "raw/M1/photo.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    (made / "raw/M1/log.csv").write_bytes(b"a,b\n" + b"1,2\n" * 50 + b"\x81\n")  # in no encoding that is known
    assert main(["init", str(made / "raw"), "--into", str(tmp_path / "new"), *PLACE]) == 0
    assert draft(tmp_path / "new", "M1")["instruments"]["top"]["files"] == ["raw/M1/top.000", "raw/M1/top.001"]
    said = capsys.readouterr().err
    assert "photo.png: an image" in said and "log.csv: expected a text in UTF-8" in said


def test_bench_table_is_drafted_as_a_calibration(tmp_path, capsys):
    table = write_table(tmp_path / "aqd.csv", readings())
    assert main(["init", str(table), "--into", str(tmp_path / "new")]) == 0
    text = (tmp_path / "new/config/calibrations/aqd.yaml").read_text()
    assert yaml.safe_load(text)["kind"] == "platform"
    capsys.readouterr()
    assert main(["check", str(tmp_path / "new")]) == 0 and "aqd: platform" in capsys.readouterr().out


def test_netcdf_provides_its_position_and_north_reference(tmp_path):
    netcdf_layouts.write(tmp_path / "imos.nc", "imos_magnetic")
    with netCDF4.Dataset(tmp_path / "imos.nc", "a") as nc:
        nc.setncatts({"geospatial_lat_min": 65.3, "geospatial_lon_min": -33.0, "water_depth": 894.0})
    assert main(["init", str(tmp_path / "imos.nc"), "--into", str(tmp_path / "new"), "--name", "X"]) == 0
    told = draft(tmp_path / "new", "X")
    assert (told["latitude"], told["longitude"], told["water_depth"]) == (65.3, -33.0, 894.0)
    assert "declination_applied" not in told["instruments"]["imos"]


def test_folder_without_exports_is_refused_in_one_line(tmp_path, capsys):
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
        ("time_utc,pressure_dbar", "pressure", None),
        ("Record Time,Abs Speed[cm/s],Direction[Deg.M],North[cm/s],East[cm/s]", "instrument", 0.01),
        ("Sample Time (UTC),Velocity_E (m/s),Velocity_N (m/s)", "instrument", 1.0),
        ("time_utc,Ve true [cm/s],Vn true [cm/s]", "instrument", 0.01),
        ("Heading,SET,DRIFT,Ext_COG,Ext_SOG", "swing", None),
    ],
)
def test_table_kind_is_recognized_from_its_header(header, kind, scale):
    found = detect.guess_from_names(header.split(","))
    assert (found.kind, found.scale) == (kind, scale) and set(found.columns.values()) <= set(header.split(","))


@pytest.mark.parametrize("header", ["foo,bar", "time,a,b", "u,v", "x,y,heading", "heading true,cog"])
def test_ambiguous_header_is_not_recognized(header):
    assert detect.guess_from_names(header.split(",")) is None


@pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} is not there")
def test_real_exports_are_drafted_with_their_metadata(tmp_path, capsys):
    names = ("moored/aqd9330.aqd", "cruise_eh2/raw/E0/top.000", "observatory/esk1980dhor.hor")
    files = [str(DATA / name) for name in names]
    assert main(["init", *files, "--into", str(tmp_path / "new"), "--name", "X", *PLACE]) == 0
    aquadopp, workhorse = draft(tmp_path / "new", "X_2011"), draft(tmp_path / "new", "X_2006")  # disjoint in time
    instrument = aquadopp["instruments"]["aqd9330"]
    assert instrument["format"] == "nortek" and instrument["attributes"] == {"serial_number": "AQD 9330"}
    assert workhorse["instruments"]["top"]["orientation"] == "down" and workhorse["start"] == "DECIDE"
    assert workhorse["compromised"] == "top" and "reference" not in workhorse
    assert "covariates" not in aquadopp and "covariates" not in workhorse  # the observatory's year is another
    hourly = yaml.safe_load((tmp_path / "new/config/calibrations/esk1980dhor.yaml").read_text())
    assert hourly["latitude"] == 65.3333  # as given, as its header has none


@pytest.mark.parametrize("name", [b"t\xffop.000", b"t\nop.000"])
def test_file_name_invalid_in_yaml_is_skipped_and_reported(tmp_path, capsys, name):
    made, new = cruise(tmp_path / "made", n=50), tmp_path / "new"
    os.rename(made / "raw/M1/top.000", os.fsencode(made / "raw/M1") + b"/" + name)
    assert main(["init", str(made / "raw"), "--into", str(new), *PLACE]) == 0
    said = capsys.readouterr()
    told = [
        line for line in (said.out + said.err).splitlines() if "rename it in UTF-8, without control characters" in line
    ]
    assert len(told) == 1 and "op.000" in told[0]
    assert list(draft(new, "M1")["instruments"]) == ["deep"] and not [*new.rglob("*op.000")]
