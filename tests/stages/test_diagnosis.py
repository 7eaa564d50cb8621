"""Would catch an effect identified in memory and lost or misapplied on the way through the stages."""

import runpy
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import pytest
import yaml

from compasslib import angles, compass
from compasslib.archive import summary
from compasslib.archive.files import read_json
from tests.world import chain
from tests.world import pairs as world
from tests.world.launch import CONTRACT

HOURS = 3000
SEARCH = {"surrogates": 39}
OPTIONS = {"FOUND": SEARCH, "LEFT": SEARCH | {"apply": False}, "OFF": {"enabled": False}}


def describe(folder: Path, name: str, drawn: world.Drawn, diagnose: dict) -> None:
    """Write the files of a mooring: an instrument that recorded in its own frame, and the reference below it."""
    pairs = drawn.pairs
    time = np.datetime_as_string(pairs.time_s.astype("datetime64[s]"), unit="s")
    water = (pairs.upper_east + 1j * pairs.upper_north) * np.conj(angles.phasor(90.0 - pairs.heading_deg))
    top = {"time": time, "depth": pairs.upper_depth_m, "x": water.real, "y": water.imag, "heading": pairs.heading_deg}
    top |= {"tilt_x": pairs.pitch_deg, "tilt_y": pairs.roll_deg, "temperature": drawn.covariates["temperature"]}
    deep = {"time": time, "depth": pairs.lower_depth_m, "east": pairs.lower_east, "north": pairs.lower_north}
    (folder / "raw").mkdir(exist_ok=True)
    instruments = {}
    for role, columns, depth in (("top", top, 100), ("deep", deep, 120)):
        file, names = f"raw/{role}.csv", {column: column for column in columns}
        pd.DataFrame(columns).to_csv(folder / file, index=False, float_format="%.4f")
        instruments[role] = {"format": "table", "files": file, "depth": depth, "columns": names}
    mooring = {
        "name": name, "latitude": 65.0, "longitude": -33.0, "water_depth": 2000, "start": "2000-01-01",
        "end": "2020-01-01", "declination": 0, "compromised": "top", "reference": "deep", "instruments": instruments,
        "diagnose": diagnose,
    }  # fmt: skip
    path = folder / f"config/moorings/{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(yaml.safe_dump(mooring))


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """One record with two planted effects, processed with findings applied, not applied, and the search disabled."""
    folder = tmp_path_factory.mktemp("diagnosis")
    drawn = world.planted(world.make(4, wide=True, n=HOURS), {"sextantal": 3.0, "temperature": 3.0})
    for name, diagnose in OPTIONS.items():
        describe(folder, name, drawn, diagnose)
    (folder / "config/config.yaml").write_text("moorings: config/moorings\noverlap: {max_metres: 200}\n")
    for name in OPTIONS:
        chain.make(folder, name, folder / "results" / name)
    return folder, drawn


def read(folder: Path, name: str, file: str) -> dict:
    return read_json(folder / "results" / name / file)


def error(folder: Path, name: str, drawn: world.Drawn) -> tuple[float, float]:
    """Compute the rms error of the corrected headings and the coverage of their 95 % intervals."""
    with netCDF4.Dataset(folder / "results" / name / "corrected.nc") as file:
        off = angles.difference(file["HEADING_CORRECTED"][:].filled(np.nan), drawn.heading)
        sigma = file["HEADING_CORRECTED_UNCERTAINTY"][:].filled(np.nan)
    return angles.rms(off), float(np.mean(np.abs(off) < 1.96 * sigma))


def test_planted_effects_are_identified_and_corrected(done):
    folder, drawn = done
    found = read(folder, "FOUND", "diagnosis.json")
    assert {one["effect"] for one in found["findings"]} == {"sextantal", "temperature"}
    applied = read(folder, "FOUND", "deviation.json")["applied"]
    assert set(applied["effects"]) == {"sextantal", "temperature"} and applied["compasses"][0]["compass"] is not None
    rms, covered = error(folder, "FOUND", drawn)
    assert rms < 1.5 < 3.5 < error(folder, "LEFT", drawn)[0] and covered > 0.9
    on_held_out_days = [read(folder, name, "assessment.json")["after"]["rms_deg"] for name in ("FOUND", "LEFT")]
    assert on_held_out_days[0] < on_held_out_days[1]
    with netCDF4.Dataset(folder / "results/FOUND/corrected.nc") as file:
        assert "sextantal" in file.effects and "with" in file.history


def test_findings_can_be_left_unapplied_and_the_search_disabled(done):
    folder, _ = done
    left, off = read(folder, "LEFT", "diagnosis.json"), read(folder, "OFF", "diagnosis.json")
    assert left["findings"] and not any(one["applied"] for one in left["findings"])
    assert read(folder, "LEFT", "deviation.json")["applied"]["effects"] == []
    assert off["verdict"] == "insufficient" and "switched off" in off["why"]
    found, off = (summary.summary_row(name, folder / "results" / name) for name in ("FOUND", "OFF"))
    assert {*found["effects"].split()} == {"sextantal", "temperature"}
    assert "switched off" in off["warnings"]


@pytest.mark.parametrize("name", ["LEFT", "OFF"])
def test_coefficients_of_deviation_json_make_the_corrected_headings(done, name):
    """One compass without an effect; its covariance and coefficients are not those of the configured fit."""
    deviation = read(done[0], name, "deviation.json")
    with netCDF4.Dataset(done[0] / "results" / name / "corrected.nc") as file:
        recorded, corrected = (file[key][:].filled(np.nan) for key in ("HEADING", "HEADING_CORRECTED"))
    roots = compass.inverse([deviation["coefficients"][letter] for letter in "ABCDE"], recorded)
    off = np.nanmin(np.abs(angles.difference(roots, corrected[:, None])), axis=1)
    assert np.isfinite(off).all() and off.max() < 1e-9
    assert not deviation["averaged"] and read(done[0], "FOUND", "deviation.json")["averaged"]
    assert deviation["fitted"] | {"warnings": []} == read(done[0], name, "work/fit.json") | {"warnings": []}
    assert deviation["fitted"]["coefficients"] != deviation["coefficients"]


@pytest.mark.parametrize("name", OPTIONS)
def test_the_contract_holds_with_a_diagnosis(done, name):
    """Run only the checks that concern a diagnosis; figures and report, which are required too, are not made here."""
    if not CONTRACT.exists():
        pytest.skip("no ../shared/tools")
    contract, misses = runpy.run_path(str(CONTRACT)), []
    contract["check_diagnosis"](done[0] / "results" / name / "diagnosis.json", misses)
    contract["check_archive"](done[0] / "results" / name / "corrected.nc", misses)
    assert misses == []
    assert set(contract["DEVIATION"]) <= set(read(done[0], name, "deviation.json"))
