"""Would catch results that depend on where jobs run and files lie: through Slurm on loopback, or a storage plug-in."""

import json
import shutil
import subprocess
from datetime import timedelta
from importlib.util import find_spec
from pathlib import Path

import netCDF4
import pytest

from tests.world import slurm
from tests.world.bench import readings, write_calibration
from tests.world.launch import PROJECT, change, command, completed, environment, hashes, snakemake
from tests.world.sea import START, cruise

# Jobs that stop without a word, as one that a node kills, if their script is that of the rule figures.
KILLED = """import os, sys
if sys.orig_argv[-1].endswith(".stage.py") and "figures.figures" in open(sys.orig_argv[-1]).read():
    os._exit(1)
"""
NO_STORAGE = "" if find_spec("snakemake_storage_plugin_fs") else "no snakemake-storage-plugin-fs: make cluster"
NO_STORAGE = NO_STORAGE or ("" if shutil.which("rsync") else "no rsync: apt-get install rsync")


@pytest.fixture(scope="module")
def processed(tmp_path_factory):
    """Process a mooring alone, two that share a compass, and a calibration, on this machine."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("M1", "M2", "M3"), n=120)
    (folder / "config/config.yaml").write_text("diagnose: {enabled: false}\n")
    write_calibration(folder, "bench", readings())
    for name, first in (("M2", 0), ("M3", 60)):  # one compass is in one place at a time
        path = folder / f"config/moorings/{name}.yaml"
        dates = [f"{START + timedelta(hours=hours):%Y-%m-%dT%H:%M:%SZ}" for hours in (first, first + 60)]
        path.write_text(path.read_text().replace("orientation: up", "orientation: up\n    compass: w1"))
        change(path, start=dates[0], end=dates[1], product={"grid": False})
    return completed(folder)


def results(folder: Path) -> dict[str, str]:
    """Hash what jobs wrote, their records among it."""
    return hashes(folder / "results", "benchmarks")


@pytest.mark.skipif(bool(slurm.missing()), reason=slurm.missing() or "Slurm can be started")
def test_cluster_run_gives_identical_results(processed, tmp_path):
    """By Slurm with its profile alone; in a first run the figures fail, and nothing else is lost or made again."""
    there = tmp_path / "there"
    for part in ("config", "raw"):
        shutil.copytree(processed / part, there / part)
    (tmp_path / "sitecustomize.py").write_text(KILLED)

    def run(*beside: Path) -> subprocess.CompletedProcess:
        queued = [*command(there), *slurm.OPTIONS, "--slurm-keep-successful-logs"]
        into = environment(PROJECT, *beside)
        return subprocess.run(queued, capture_output=True, text=True, check=False, env=into, cwd=there)

    with slurm.cluster(tmp_path / "slurm"):
        failed = run(tmp_path)
        assert failed.returncode == 1 and "results/M1/logs/figures.log: killed" in failed.stderr
        products = [f"results/{name}/corrected.nc" for name in ("M1", "M2", "M3")]
        made = {path: (there / path).stat().st_mtime_ns for path in products}
        ran = run()
        assert ran.returncode == 0, ran.stderr[-4000:]
        logs = there / ".snakemake/slurm_logs"
        jobs = {path.name.removeprefix("group_").partition("_M")[0] for path in logs.glob("group_*")}
        single = sorted(path.name for path in logs.glob("rule_*"))
    assert made == {path: (there / path).stat().st_mtime_ns for path in products}
    assert jobs == {"read", "alone", "mooring"}
    # Jobs of the cruise as a whole run where Snakemake was started.
    assert {"rule_figures", "rule_combine_records"} < set(single) and "rule_summary" not in single
    assert {"M1/corrected.nc", "M1/gridded.nc", "report.html", "ro-crate-metadata.json"} < results(processed).keys()
    assert results(there) == results(processed)


@pytest.mark.skipif(bool(NO_STORAGE), reason=NO_STORAGE or "the plug-in is there")
def test_run_with_files_in_storage_gives_identical_results(processed, tmp_path):
    """Raw files in, results out, both in a folder that the cruise folder does not contain, which has the YAML files."""
    here, storage = tmp_path / "here", tmp_path / "storage"
    shutil.copytree(processed / "config", here / "config")
    shutil.copytree(processed / "raw", storage / "raw")
    where = ("--workflow-profile", str(PROJECT / "workflow/profiles/storage"))
    where = (*where, "--default-storage-prefix", str(storage))
    completed(here, *where)
    assert results(storage) == results(processed)
    assert not [path for path in (here / "results").rglob("*") if path.is_file()]
    with netCDF4.Dataset(storage / "results/M1/corrected.nc") as nc:
        assert nc.source_files == "raw/M1/top.000, raw/M1/deep.csv"
    record = json.loads((storage / "results/logs/provenance.json").read_text())
    assert {path.split("/")[0] for path in record["read"]} == {"config", "results"}
    again = snakemake(here, *where, "--dry-run")
    assert "Nothing to be done" in again.stderr + again.stdout
