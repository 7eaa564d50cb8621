"""Would catch results of a whole run that are incomplete, differ from another run's, or are made in vain."""

import json
import re
import shutil
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import yaml

from compasslib.archive import crate
from tests.world import chain, conventions
from tests.world.launch import PROJECT, change, completed, copied_project, hashes, keeps_contract, snakemake
from tests.world.sea import cruise, real

HOURS = 240  # too short for the search, which other test files run through the same stages


def two(folder: Path) -> Path:
    """Write a cruise of a mooring and one without a reference instrument, each with its own recording."""
    change(cruise(folder, ("M1", "ALONE"), n=HOURS) / "config/moorings/ALONE.yaml", reference=None)
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Process the cruise of two moorings on two cores."""
    folder = two(tmp_path_factory.mktemp("cruise"))
    ran = snakemake(folder)
    assert ran.returncode == 0, ran.stderr
    (folder / "screen").write_text(ran.stderr)
    return folder


def test_results_satisfy_the_contract(done):
    keeps_contract(done, "--without", "calibrations")
    for file in ("M1/table.csv", "M1/histograms.csv", "M1/figures/histograms.png", "figures/array.png"):
        assert (done / "results" / file).is_file()
    assessment = json.loads((done / "results/M1/assessment.json").read_text())
    assert assessment["after"]["rms_deg"] < assessment["before"]["rms_deg"]


def test_summary_is_shown_with_warnings_last(done):
    said = (done / "screen").read_text().splitlines()
    shown, warnings = said.index("results/summary.csv: 2 moorings"), said.index("Warnings: 2")
    assert [line.split()[0] for line in said[shown - 3 : shown]] == ["name", "ALONE", "M1"]
    tail = said[warnings + 1 : warnings + 3]
    assert sorted(line.partition(" pitch")[0] for line in tail) == ["  ALONE top: warning:", "  M1 top: warning:"]


def test_mooring_without_reference_is_flagged_without_error(done):
    deviation = json.loads((done / "results/ALONE/deviation.json").read_text())
    assert deviation["n_pairs"] == 0 and deviation["coefficients"] is None
    with netCDF4.Dataset(done / "results/ALONE/corrected.nc") as nc:
        assert np.isnan(nc["HEADING_CORRECTED"][:].filled(np.nan)).all()
        assert (nc["HEADING_CORRECTED_QC"][:] == 4).all()
        assert np.isfinite(nc["UCUR_RECORDED"][:].filled(np.nan)).any()


def test_results_are_valid_for_copied_files_and_for_the_project_at_another_path(done, tmp_path):
    """Only the content of the raw files counts, not their dates; the results may be in another folder."""
    for file in (*(done / "raw/M1").iterdir(), *(done / "config").rglob("*.yaml")):
        file.touch()
    shutil.move(done / "results", tmp_path / "scratch")
    (done / "results").symlink_to(tmp_path / "scratch")
    project = copied_project(tmp_path / "project", "compasslib", "workflow", "Snakefile")
    for where in (PROJECT, project):
        assert "Nothing to be done" in snakemake(done, "--dry-run", project=where).stdout
    assert not crate.differences(done, None)
    (done / "results").unlink()
    shutil.move(tmp_path / "scratch", done / "results")


def test_another_run_gives_identical_results(done, tmp_path):
    """netCDF, JSON, CSV, PNG, HTML, the manifest, and even the logs and the records of the jobs."""
    again = two(tmp_path / "again")
    completed(again, server=1)  # with another hash seed
    first, second = (hashes(folder / "results", "benchmarks") for folder in (done, again))
    assert sorted(first) == sorted(second) and "ro-crate-metadata.json" in first
    assert [name for name in first if first[name] != second[name]] == []


@pytest.mark.filterwarnings("ignore")  # warnings of the checker
def test_real_mooring_satisfies_the_conventions(tmp_path):
    """Files with all variables of a real overlap."""
    folder = Path(shutil.copytree(real("cruise_eh2"), tmp_path / "c"))
    (folder / "config/config.yaml").write_text("{moorings: config/moorings, diagnose: {enabled: false}}\n")
    files = [*chain.make(folder, "E1", tmp_path / "made", gridded=True).rglob("*.nc")]
    assert len(files) > 4 and not [remark for file in files for remark in conventions.remarks(file)]


def test_missing_raw_file_is_refused_before_processing(tmp_path):
    folder = cruise(tmp_path / "c", ("EG1",), n=50)
    (folder / "raw/EG1/top.000").unlink()
    ran = snakemake(folder)
    assert ran.returncode != 0 and not (folder / "results").exists() and not (folder / "raw/EG1/top.000").exists()
    said = [line for line in ran.stderr.splitlines() if "error:" in line]
    assert len(said) == 1 and "config/moorings/EG1.yaml: instruments.top.files" in said[0]


NAMES = ("M.1", "M11", "0-1", "EGEGEGEG", "a" * 19, "CON", "nul.txt", "results", "work.", "none")


def test_unusual_names_are_planned_separately(tmp_path):
    """As a pattern, M.1 would also match M11, whose fit is made by another rule."""
    folder = cruise(tmp_path / "c", NAMES, n=5)
    calibration = {"latitude": 48.4, "longitude": -4.5, "date": "2007-01-01", "kind": "platform", "file": "raw/cal.csv"}
    (folder / "config/calibrations").mkdir()
    (folder / "config/calibrations/a.c.yaml").write_text(yaml.safe_dump(calibration))
    (folder / "raw/cal.csv").write_text("reference_deg,recorded_deg\n")
    change(folder / "config/moorings/M11.yaml", fit={"method": "calibration", "name": "a.c"})
    files = [f"results/{name}/work/fit.json" for name in NAMES]
    ran = snakemake(folder, "--dry-run", "--quiet=progress", *files)
    assert ran.returncode == 0, ran.stderr
    made = re.findall(r"rule (fit|transfer_calibration):\n.*\n\s+output: results/(.+)/work/fit.json", ran.stdout)
    assert sorted(made) == sorted(("transfer_calibration" if name == "M11" else "fit", name) for name in NAMES)


def test_demonstration_of_an_unknown_mooring_is_refused(tmp_path):
    folder = cruise(tmp_path / "c", n=50)
    (folder / "config/config.yaml").write_text("demonstration: true\n")
    ran = snakemake(folder)
    assert ran.returncode != 0 and "config/moorings/M1.yaml: name: expected EG1 or EG2" in ran.stderr
    assert "Traceback" not in ran.stderr and not (folder / "results").exists()
