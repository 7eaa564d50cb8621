"""Whole runs through Snakemake: unreadable input stops only its mooring; recorded hashes decide what is re-run."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import pytest
import yaml
from bench import readings, write_calibration
from launch import change, copied_project, planned, snakemake
from sea import cruise
from test_archive_provenance import flip, page_of, verify

from compasslib.archive import crate

HOURS = 60


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Process two moorings, a calibration, and a mooring that is corrected by the calibration."""
    folder = cruise(tmp_path_factory.mktemp("running") / "c", ("GOOD", "BAD", "CARRIED"), n=HOURS)
    (folder / "config/config.yaml").write_text("{fit: {method: von_appen}, diagnose: {enabled: false}}\n")
    change(folder / "config/moorings/CARRIED.yaml", fit={"method": "calibration", "name": "bench"})
    write_calibration(folder, "bench", readings())
    ran = snakemake(folder)
    assert ran.returncode == 0, ran.stderr
    return folder


@pytest.fixture
def copied(done, tmp_path):
    return Path(shutil.copytree(done, tmp_path / "c"))


def errors(said: str) -> list[str]:
    return [line for line in said.splitlines() if line.startswith("error:")]


def rows(folder: Path) -> dict[str, dict[str, str]]:
    return {row["name"]: row for row in csv.DictReader((folder / "results/summary.csv").read_text().splitlines())}


def files(folder: Path) -> set[str]:
    made = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in made if not {"logs", "benchmarks"} & set(name.split("/"))}


def test_unreadable_input_stops_only_its_mooring_until_repaired(copied):
    """A first run, a run without changes, and a run after both files were repaired."""
    top, bench = copied / "raw/BAD/top.000", copied / "raw/cal/bench.csv"
    sound = {path: path.read_bytes() for path in (top, bench)}
    product = (copied / "results/GOOD/corrected.nc").read_bytes()
    top.write_text("not a recording\n" * 100)
    bench.write_text("reference_deg,recorded_deg\n1,two\n")

    ran = snakemake(copied)
    assert ran.returncode != 0 and "Traceback" not in ran.stderr
    said = sorted(errors(ran.stderr))
    assert said[0] in (copied / "results/calibrations/bench/logs/calibrate.log").read_text()
    why = json.loads((copied / "results/BAD/stopped.json").read_text())
    assert set(why) == {"stage", "why", "file", "advice"} and why["stage"] == "read_top"
    assert why["file"] == "raw/BAD/top.000" and why["why"] in said[1] and why["why"].endswith(why["advice"])
    assert len(said) == 2 and said[0].startswith("error: calibration bench: raw/cal/bench.csv: line 2")
    assert said[1].startswith("error: mooring BAD: raw/BAD/top.000: expected an RDI PD0 file")
    table = rows(copied)
    assert [table[name]["verdict"] for name in ("BAD", "CARRIED", "GOOD")] == ["stopped", "stopped", "insufficient"]
    assert list(table) == ["BAD", "CARRIED", "GOOD"] and table["BAD"]["warnings"] in said[1]
    assert table["CARRIED"]["warnings"].startswith("it needs calibration bench, which was stopped: raw/cal/bench.csv")
    page = (copied / "results/report.html").read_text()
    assert "moorings (1 insufficient, 2 stopped)" in page
    assert page.count("raw/BAD/top.000: expected an RDI PD0 file") == 2 and "Cross:" in page
    assert page.count("<title>BAD</title></path>") == page.count("<title>GOOD</title></circle>") == 1
    actions = [one for one in page_of(copied)["@graph"] if "actionStatus" in one]
    failed = {one["name"]: one for one in actions if one["actionStatus"].endswith("FailedActionStatus")}
    assert set(failed) == {"mooring BAD", "mooring CARRIED", "calibration bench"}
    assert failed["mooring BAD"]["error"] == table["BAD"]["warnings"]
    assert verify(copied)[0] == 0
    # No partial or older products remain; only results of readable input do.
    assert files(copied / "results/BAD") == {"work/deep.nc", "stopped.json"}
    assert files(copied / "results/calibrations/bench") == {"stopped.json"}
    assert not (copied / "results/CARRIED/corrected.nc").exists()
    assert (copied / "results/GOOD/corrected.nc").read_bytes() == product

    before = {path: path.stat().st_mtime_ns for path in (copied / "results").rglob("*.*") if "BAD" not in path.parts}
    again = snakemake(copied)
    assert again.returncode != 0 and sorted(errors(again.stderr)) == said
    changed = [path for path, when in before.items() if path.stat().st_mtime_ns != when]
    assert not [path for path in changed if "logs" not in path.parts]

    for path, content in sound.items():
        path.write_bytes(content)
    mended = snakemake(copied)
    assert mended.returncode == 0, mended.stderr
    assert {row["verdict"] for row in rows(copied).values()} == {"insufficient"}
    assert "stopped." not in (copied / "results/report.html").read_text().split("</header>")[0]
    assert not list((copied / "results").rglob("stopped.json")) and (copied / "results/BAD/corrected.nc").exists()


def test_write_error_does_not_mark_a_mooring_as_stopped(copied):
    """A folder blocks the path of a result, while the input is valid."""
    shutil.rmtree(copied / "results/BAD")
    (copied / "results/summary.csv").unlink()
    (copied / "results/BAD/work/.top.nc.blocked").mkdir(parents=True)
    (copied / "results/BAD/work/top.nc/in the way").mkdir(parents=True)
    ran = snakemake(copied)
    assert ran.returncode != 0 and not (copied / "results/summary.csv").exists()
    assert not list((copied / "results").rglob("stopped.json"))


def test_program_error_stops_only_its_mooring(copied, tmp_path):
    project = copied_project(tmp_path / "project", "compasslib", "workflow", "Snakefile")
    stage = project / "compasslib/stages/fit.py"
    stage.write_text(stage.read_text().replace("    there = ", "    1 / (mooring != 'BAD')\n    there = ", 1))
    snakemake(copied, "--config", "mooring_cores=1", "--", "results/summary.csv", project=project)
    assert rows(copied)["BAD"]["warnings"].startswith("an error of this program in fit, ZeroDivisionError")
    assert rows(copied)["GOOD"]["verdict"] == "insufficient" and not (copied / "results/BAD/corrected.nc").exists()


def test_changed_intermediate_file_is_remade_before_use(copied):
    whole = {name: (copied / "results" / name).read_bytes() for name in files(copied / "results")}
    flip(copied / "results/GOOD/overlap.nc")
    assert ("overlap", "GOOD") in planned(copied) and ("read", "GOOD") not in planned(copied)
    assert snakemake(copied).returncode == 0 and verify(copied)[0] == 0
    assert {name: (copied / "results" / name).read_bytes() for name in files(copied / "results")} == whole


@pytest.mark.parametrize("gone", ["diagnosis.json", "work/top.nc", "wide/overlap.nc"])
def test_deleted_result_is_remade(copied, gone):
    (copied / "results/GOOD" / gone).unlink()
    assert {mooring for _, mooring in planned(copied)} == {"GOOD", ""}


def test_changed_calibration_reruns_only_its_own_moorings(copied):
    change(copied / "config/calibrations/bench.yaml", uncertainty={"graduation_deg": 0.5})
    assert {name for _, name in planned(copied)} == {"bench", "CARRIED", ""}


def test_all_jobs_rerun_if_snakemake_metadata_are_lost(copied):
    assert planned(copied) == set()
    shutil.rmtree(copied / ".snakemake")
    assert {("read", "GOOD"), ("overlap", "BAD"), ("calibrate", "bench")} <= planned(copied)


def test_dry_run_changes_only_files_of_snakemake(copied):
    for name in ("results/GOOD/.hidden.1", ".snakemake/locks/0.input.lock"):
        (copied / name).write_text("x")

    def state() -> dict[Path, int]:
        there = [path for path in copied.rglob("*") if not {"iocache", "log"} & set(path.parts)]
        return {path: path.lstat().st_mtime_ns for path in there if path.is_file()}

    (copied / "results/GOOD/overlap.nc").touch()
    before = state()
    planned(copied)
    assert state() == before


def test_concurrent_run_is_refused_in_one_line(copied):
    import fcntl

    (copied / "results/summary.csv").unlink()  # a run that has nothing to do needs no lock
    with (copied / ".snakemake/compasslib.lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        ran = snakemake(copied)
    assert ran.returncode != 0 and "expected one run at a time, found another" in ran.stderr + ran.stdout
    assert snakemake(copied, "results/summary.csv").returncode == 0


def test_a_raw_file_below_results_is_refused(copied):
    moved = yaml.safe_load((copied / "config/moorings/GOOD.yaml").read_text())
    moved["instruments"]["deep"]["files"] = "results/GOOD/work/deep.nc"
    (copied / "config/moorings/GOOD.yaml").write_text(yaml.safe_dump(moved))
    ran = snakemake(copied, "--dry-run")
    message = "expected a file outside results/, which each run may write over"
    assert ran.returncode != 0 and message in ran.stdout + ran.stderr


def test_the_manifest_refuses_an_intermediate_file_that_no_job_wrote():
    jobs = {
        "overlap": {"read": {}, "wrote": {"results/M1/overlap.nc": "as written"}},
        "correct": {"read": {"results/M1/overlap.nc": "flipped"}, "wrote": crate.provenance.hashes([__file__])},
    }
    with pytest.raises(crate.InputError, match=r"results/M1/overlap.nc: expected the file that its job wrote"):
        crate.lineage(jobs, [__file__])
