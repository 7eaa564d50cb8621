"""Would catch a damaged file or an error that stops other moorings, and results that are stale or made in vain."""

import csv
import shutil
import subprocess
from argparse import Namespace
from pathlib import Path

import pytest

from compasslib.archive import crate
from compasslib.archive.files import read_json
from compasslib.cli.results import explain
from compasslib.errors import InputError
from tests.world.bench import readings, write_calibration
from tests.world.launch import change, copied_project, jobs_in, planned, snakemake
from tests.world.sea import cruise, pairs

HOURS = 60
NAMES = ("GOOD", "BAD", "CARRIED", "TURNED")  # TURNED is the fourth, which is simulated with seed 13
PAGES = {("summary", ""), ("cruise_figures", ""), ("report", ""), ("provenance", "")}
OPTIONS = "{fit: {method: von_appen}, diagnose: {enabled: false}, product: {grid: false}}\n"


def mirror(table: Path) -> None:
    """Replace the reference's velocities by those of the affected instrument, mirrored about the meridian."""
    seen, _ = pairs(n=HOURS, seed=13)
    head, *rows = table.read_text().splitlines()
    values = zip(rows, -100.0 * seen.upper_east, 100.0 * seen.upper_north, strict=True)
    rows = [",".join([*row.split(",")[:2], f"{east:.3f}", f"{north:.3f}"]) for row, east, north in values]
    table.write_text("\n".join([head, *rows]) + "\n")


@pytest.fixture(scope="module")
def first(tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess]:
    """Process a sound mooring, one with a damaged file, one with a damaged calibration, and one in a wrong frame."""
    folder = cruise(tmp_path_factory.mktemp("running") / "c", NAMES, n=HOURS)
    (folder / "config/config.yaml").write_text(OPTIONS)
    change(folder / "config/moorings/CARRIED.yaml", fit={"method": "calibration", "name": "bench"})
    write_calibration(folder, "bench", readings())
    shutil.copytree(folder / "raw", folder / "sound")
    (folder / "raw/BAD/top.000").write_text("not a recording\n" * 100)
    (folder / "raw/cal/bench.csv").write_text("reference_deg,recorded_deg\n1,two\n")
    mirror(folder / "raw/TURNED/deep.csv")
    return folder, snakemake(folder, drawn=False)


@pytest.fixture(scope="module")
def stopped(first) -> Path:
    return first[0]


@pytest.fixture(scope="module")
def done(stopped, tmp_path_factory) -> Path:
    """Restore the files of the cruise with their older dates, and run it again."""
    folder = Path(shutil.copytree(stopped, tmp_path_factory.mktemp("repaired") / "c"))
    shutil.copytree(folder / "sound", folder / "raw", dirs_exist_ok=True)
    ran = snakemake(folder, drawn=False)
    assert ran.returncode == 0, ran.stderr
    assert not {name for rule, name in jobs_in(ran.stderr) if name == "GOOD"}
    return folder


@pytest.fixture
def copied(done, tmp_path) -> Path:
    return Path(shutil.copytree(done, tmp_path / "c"))


def errors(ran: subprocess.CompletedProcess) -> list[str]:
    assert "Traceback" not in ran.stderr
    return sorted(line for line in ran.stderr.splitlines() if line.startswith("error:"))


def rows(folder: Path) -> dict[str, dict[str, str]]:
    return {row["name"]: row for row in csv.DictReader((folder / "results/summary.csv").read_text().splitlines())}


def products(folder: Path) -> set[str]:
    """List the files in a result folder, except work, logs and benchmarks."""
    made = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    return {name for name in made if name.split("/")[0] not in ("work", "logs", "benchmarks")}


def test_unusable_content_stops_only_its_mooring_in_one_pass(first):
    folder, ran = first
    said = errors(ran)
    assert ran.returncode == 1 and len(said) == 3
    assert said[0].startswith("error: calibration bench: raw/cal/bench.csv: line 2")
    assert said[1].startswith("error: mooring BAD: raw/BAD/top.000: expected an RDI PD0 file")
    assert said[2].startswith("error: mooring TURNED: compromised and reference: expected velocities as")
    assert said[0] in (folder / "results/calibrations/bench/logs/calibrate.log").read_text()
    table, verdicts = rows(folder), dict.fromkeys(NAMES, "stopped") | {"GOOD": "insufficient"}
    assert {name: row["verdict"] for name, row in table.items()} == verdicts
    assert table["CARRIED"]["warnings"].startswith("it needs calibration bench, which was stopped: raw/cal/bench.csv")
    bench = ("calibrate", "raw/cal/bench.csv")
    places = {"BAD": ("read_top", "raw/BAD/top.000"), "TURNED": ("overlap", None), "CARRIED": bench}
    for name, place in (places | {"calibrations/bench": bench}).items():
        why = read_json(folder / f"results/{name}/stopped.json")
        assert list(why) == ["stage", "why", "file", "advice"] and (why["stage"], why["file"]) == place
        assert why["why"].endswith(why["advice"]) and (name not in table or why["why"] == table[name]["warnings"])
        assert products(folder / "results" / name) == {"stopped.json"}
    with pytest.raises(InputError, match=r"it stopped: raw/BAD/top\.000: expected an RDI PD0 file"):
        explain(Namespace(cruise=str(folder), mooring="BAD"))
    assert "corrected.nc" in products(folder / "results/GOOD") and not (folder / "results/GOOD/stopped.json").exists()


def test_stopped_moorings_stand_on_the_pages_and_in_the_manifest(stopped):
    page = (stopped / "results/report.html").read_text()
    assert "moorings (1 insufficient, 3 stopped)" in page
    assert page.count("raw/BAD/top.000: expected an RDI PD0 file") == 2
    actions = [one for one in read_json(stopped / crate.FILE)["@graph"] if "actionStatus" in one]
    failed = {one["name"]: one["error"] for one in actions if one["actionStatus"].endswith("FailedActionStatus")}
    assert set(failed) == {"mooring BAD", "mooring CARRIED", "mooring TURNED", "calibration bench"}
    assert all(failed[f"mooring {name}"] == row["warnings"] for name, row in rows(stopped).items() if name != "GOOD")
    assert crate.differences(stopped, None) == []


def test_a_run_without_changes_makes_nothing_and_reports_the_same(first):
    folder, ran = first
    again = snakemake(folder)
    assert again.returncode == 1 and errors(again) == errors(ran) and jobs_in(again.stderr) == set()


def test_products_of_a_sound_and_a_stopped_mooring_can_be_requested(stopped, tmp_path):
    folder = Path(shutil.copytree(stopped, tmp_path / "c"))
    (folder / "results/GOOD/corrected.nc").unlink()
    reason = "error: calibration bench: raw/cal/bench.csv: line 2"
    for name, said in (("GOOD", []), ("CARRIED", [reason])):
        ran = snakemake(folder, f"results/{name}/corrected.nc")
        assert ran.returncode == len(said) and [line[: len(reason)] for line in errors(ran)] == said
        assert (folder / f"results/{name}/corrected.nc").exists() is not bool(said)


def test_the_run_after_the_repair_is_complete(done):
    assert {row["verdict"] for row in rows(done).values()} == {"insufficient"}
    assert "stopped." not in (done / "results/report.html").read_text().split("</header>")[0]
    assert not list((done / "results").rglob("stopped.json")) and crate.differences(done, None) == []
    assert "Nothing to be done" in snakemake(done, "--dry-run").stdout


def test_changed_raw_file_reruns_its_mooring(copied):
    with (copied / "raw/GOOD/deep.csv").open("a") as stream:
        stream.write("\n")
    stages = {"read", "overlap", "fit", "diagnose", "correct", "figures"}
    assert planned(copied) == {*((stage, "GOOD") for stage in stages), ("usable", ""), *PAGES}


def test_program_error_fails_its_job_and_its_mooring_is_left_out_on_request(copied, tmp_path):
    """Even where a raw file of that mooring was never read."""
    project = copied_project(tmp_path / "project", "compasslib", "workflow", "Snakefile")
    stage = project / "compasslib/stages/read.py"
    stage.write_text(stage.read_text().replace("    settled = ", "    1 / (mooring != 'BAD')\n    settled = ", 1))
    wanted = [copied / f"results/{name}/corrected.nc" for name in ("GOOD", "BAD")]
    for path in (*wanted, *(copied / f"results/BAD/work/{name}" for name in ("top.nc", "field.json"))):
        path.unlink()
    targets = [path.relative_to(copied).as_posix() for path in wanted]
    ran = snakemake(copied, "--rerun-triggers", "mtime", "--", *targets, project=project)
    assert ran.returncode == 1 and [path.exists() for path in wanted] == [True, False]
    (line,) = errors(ran)
    assert line.startswith("error: mooring BAD: an error of this program in read_top, ZeroDivisionError: division by")
    assert line.endswith("make the pages of the cruise without it: --config without=BAD")

    ran = snakemake(copied, "--config", "without=BAD", drawn=False)
    why = "BAD was left out of this run (--config without=BAD)"
    assert ran.returncode == 1 and errors(ran) == [f"error: mooring BAD: {why}"]
    assert rows(copied)["BAD"]["warnings"] == why and rows(copied)["GOOD"]["verdict"] == "insufficient"
    assert why in (copied / "results/report.html").read_text() and crate.differences(copied, None) == []
    assert products(copied / "results/BAD") == {"stopped.json"}

    ran = snakemake(copied, drawn=False)
    assert ran.returncode == 0 and not list((copied / "results").rglob("stopped.json"))
    assert "corrected.nc" in products(copied / "results/BAD") and planned(copied) == set()
