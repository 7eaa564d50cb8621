"""Runs the ordinary pipeline on a cruise folder: the same Snakefile and rules, only the targets are chosen."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1]
SCORED = ("corrected.nc", "diagnosis.json", "deviation.json")


def pipeline(cruise: Path, names: Sequence[str], cores: int) -> None:
    """Process moorings up to what is scored; figures and the page are left out.

    Args:
        cruise: its folder.
        names: of the moorings.
        cores: how many jobs at once.

    Raises:
        SystemExit: Snakemake failed; its last lines are told.
    """
    targets = [f"results/{name}/{file}" for name in names for file in SCORED]
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile"), "--directory", str(cruise)]
    options = ["--workflow-profile", "none", "--cores", str(cores), "--keep-going", "--quiet", "all"]
    path = os.pathsep.join(filter(None, (str(PROJECT), os.environ.get("PYTHONPATH"))))
    threads = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(
        [*command, *options, "--", *targets], capture_output=True, text=True, check=False, env=os.environ | threads
    )
    if ran.returncode:
        sys.exit("the pipeline failed:\n" + ran.stderr[-3000:])
