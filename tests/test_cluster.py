"""The same Snakefile through Slurm, by its profile alone: the results are those of a local run, bit for bit."""

import subprocess
from pathlib import Path

import pytest
import slurm
from launch import command, environment
from sea import cruise

COMPARED = ("corrected.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json")


def started(folder: Path, *options: str) -> subprocess.Popen:
    quiet, said, whole = subprocess.DEVNULL, subprocess.PIPE, [*command(folder), *options]
    return subprocess.Popen(whole, stdout=quiet, stderr=said, text=True, env=environment(), cwd=folder)


def ended(run: subprocess.Popen) -> None:
    _, said = run.communicate()
    assert run.returncode == 0, said[-4000:]


@pytest.mark.skipif(bool(slurm.missing()), reason=slurm.missing() or "Slurm can be started")
def test_a_cluster_gives_what_this_machine_gives(tmp_path):
    """One mooring; benchmarks/slurm_cruise.py does the same with the whole demonstration cruise."""
    here, there = cruise(tmp_path / "here"), cruise(tmp_path / "there")
    with slurm.cluster(tmp_path / "slurm"):
        queued = started(there, *slurm.OPTIONS, "--slurm-keep-successful-logs")
        try:
            ended(started(here, "--cores", "1"))  # meanwhile, on the other core
            ended(queued)
        finally:
            queued.kill()
        logs = sorted(log.name for log in (there / ".snakemake/slurm_logs").iterdir())
    assert [name.split("_")[1] for name in logs] == ["mooring"]  # what belongs to the cruise ran here
    for file in [*(f"M1/{name}" for name in COMPARED), "summary.csv", "report.html", "ro-crate-metadata.json"]:
        assert (there / "results" / file).read_bytes() == (here / "results" / file).read_bytes(), file
