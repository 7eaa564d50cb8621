"""Would catch a calibration that needs a mooring, or that does not reach the one that it corrects."""

import csv
import shutil
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from compasslib import angles, earthfield
from compasslib.archive.files import read_json
from compasslib.pipeline.process import process_mooring
from tests.world.bench import readings, ring, write_calibration
from tests.world.iaga_files import ROCKS_DEG, series, write
from tests.world.launch import change, completed, keeps_contract, planned
from tests.world.sea import cruise, pairs

AT_SEA = (0.02, 0.3, 0.1, 0.03, -0.02)
SAMPLES = 600
FIGURES = {"deviation.png", "diagnosis.png"}


def at_brest(coefficients) -> np.ndarray:
    """Transfer a mooring's coefficients, all of hard iron, to a bench at Brest."""
    places = (65.3333, -32.955, 1191000000.0), (48.4, -4.5, 1664409600.0)
    moored, home = (float(earthfield.igrf(*place)[1][0]) for place in places)
    return np.array(coefficients) * [1.0, moored / home, moored / home, 1.0, 1.0]


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Process a cruise whose mooring is corrected by a calibration at Brest."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("M1",), coefficients=AT_SEA, n=SAMPLES)
    fit, search = {"method": "calibration", "name": "bench"}, {"enabled": False}
    change(folder / "config/moorings/M1.yaml", fit=fit, diagnose=search)
    write_calibration(folder, "bench", readings(coefficients=at_brest(AT_SEA)), budget="le_menn")
    write_calibration(folder, "later", readings(seed=3), compare_with="bench", table_step_deg=15)
    write_calibration(folder, "few", readings(ring(3)), latitude=None, longitude=None)
    return completed(folder, drawn=False)


@pytest.fixture(scope="module")
def alone(done, tmp_path_factory) -> Path:
    """Process the same mooring alone, without a reference instrument."""
    folder = tmp_path_factory.mktemp("alone")
    for part in ("config", "raw"):
        shutil.copytree(done / part, folder / part)
    change(folder / "config/moorings/M1.yaml", reference=None)
    return process_mooring(folder, "M1", folder / "out")


def result(folder: Path, name: str, file: str = "calibration") -> dict:
    return read_json(folder / f"results/calibrations/{name}/{file}.json")


def test_every_calibration_has_its_files(done):
    for name in ("bench", "later", "few"):
        there = done / "results/calibrations" / name
        files = {"calibration.json", "diagnosis.json", "table.csv", "points.csv", "figures"}
        assert files <= {path.name for path in there.iterdir()}
        drawn = FIGURES | ({"compared.png"} if name == "later" else set())
        assert {path.name for path in (there / "figures").iterdir()} == drawn
    bench, later, few = (result(done, name) for name in ("bench", "later", "few"))
    assert (bench["kind"], bench["n"], bench["why"]) == ("platform", 36, "")
    assert bench["place"]["field"]["horizontal_nT"] == pytest.approx(21299.0, abs=30.0)
    assert later["comparison"]["with"] == "bench" and later["comparison"]["differ"] is True
    assert few["coefficients"] is None and few["why"].startswith("3 headings in 3 of 36 sectors")
    rows = (done / "results/calibrations/later/table.csv").read_text().splitlines()
    assert [float(row.split(",")[0]) for row in rows[1:]] == list(np.arange(0.0, 360.0, 15.0))


@pytest.mark.parametrize("whole", [True, False])
def test_mooring_is_corrected_by_a_calibration_made_elsewhere(done, alone, whole):
    """All iron is hard here, but one calibration does not tell how much of it is induced, which is stated."""
    there = done / "results/M1" if whole else alone
    deviation = read_json(there / "deviation.json")
    assert deviation["method"] == "calibration" and not deviation["folded"]
    assert "are known to" in deviation["warnings"][0] and deviation["calibration"]["name"] == "bench"
    _, heading = pairs(AT_SEA, n=SAMPLES, seed=10)
    names = ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY")
    with netCDF4.Dataset(there / "corrected.nc") as nc:
        recorded, found, sigma = (nc[name][:].filled(np.nan) for name in names)
    off = angles.difference(found, heading)
    assert angles.rms(off) < 3.0 < 10.0 < angles.rms(recorded - heading)
    assert np.mean(np.abs(off) <= 1.96 * sigma) >= 0.93 and np.median(sigma) < 3.0


def test_pairs_assess_the_calibration_without_changing_it(done, alone):
    both, other = (read_json(there / "deviation.json") for there in (done / "results/M1", alone))
    assert both["coefficients"] == other["coefficients"] and both["n_pairs"] > 500 and other["n_pairs"] == 0
    assessment = read_json(done / "results/M1/assessment.json")
    assert assessment["after"]["rms_deg"] < assessment["before"]["rms_deg"]
    (row,) = csv.DictReader((done / "results/summary.csv").read_text().splitlines())
    assert row["method"] == "calibration" and "calibration bench: B and C are known to" in row["warnings"]


def test_calibrations_are_diagnosed_and_the_contract_holds(done):
    keeps_contract(done)
    bench, few = (result(done, name, "diagnosis") for name in ("bench", "few"))
    assert bench["verdict"] == "consistent" and bench["findings"] == []
    assert few["verdict"] == "insufficient" and few["why"].startswith("3 headings in 3 of 36 sectors")


def test_observatory_calibration_runs_without_moorings(tmp_path):
    (tmp_path / "config/calibrations").mkdir(parents=True)
    (tmp_path / "config/config.yaml").write_text("moorings: []\n")
    (tmp_path / "config/calibrations/station.yaml").write_text("kind: declination\nfile: station.hor\n")
    write(tmp_path / "station.hor", series(30), "DHZF")
    completed(tmp_path, drawn=False)
    said, there = result(tmp_path, "station"), tmp_path / "results/calibrations/station"
    assert abs(said["coefficients"]["A"] - ROCKS_DEG) < 0.05 and said["coefficients"]["B"] is None
    assert said["place"]["latitude"] == 55.3 and said["place"]["field"]["horizontal_nT"] > 15_000
    assert {path.name for path in (there / "figures").iterdir()} == {"diagnosis.png", "series.png"}
    assert len((there / "table.csv").read_text().splitlines()) == 37
    assert not planned(tmp_path) and not (tmp_path / "results/summary.csv").exists()
