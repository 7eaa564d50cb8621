"""The same Snakefile through Slurm, by its profile alone: the results are those of a local run, bit for bit."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import slurm
from sea import cruise

PROJECT = Path(__file__).resolve().parents[1]
COMPARED = ("corrected.nc", "overlap.nc", "deviation.json", "diagnosis.json", "assessment.json")


def run(folder: Path, *options: str) -> None:
    command = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder]
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    done = subprocess.run([*command, *options], capture_output=True, text=True, env=environment, cwd=folder)
    assert done.returncode == 0, done.stderr[-4000:]


@pytest.mark.skipif(bool(slurm.missing()), reason=slurm.missing() or "Slurm can be started")
def test_a_cluster_gives_what_this_machine_gives(tmp_path):
    here, there = cruise(tmp_path / "here"), cruise(tmp_path / "there")
    run(here, "--cores", "2")
    with slurm.cluster(tmp_path / "slurm"):
        profile = str(PROJECT / "workflow/profiles/slurm")
        # The loopback keeps no accounts, so that the queue itself must be asked.
        asked = ("--slurm-status-command", "squeue", "--slurm-init-seconds-before-status-checks", "5")
        kept = "--slurm-keep-successful-logs"
        run(there, "--workflow-profile", profile, *asked, kept)
        logs = sorted((there / ".snakemake/slurm_logs").iterdir())
    assert any(log.name.startswith("group_mooring") for log in logs)
    for file in [*(f"M1/{name}" for name in COMPARED), "summary.csv", "report.html"]:
        assert (there / "results" / file).read_bytes() == (here / "results" / file).read_bytes(), file
