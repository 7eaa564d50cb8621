"""Runs the ordinary pipeline on a cruise folder: the same Snakefile and rules, only the targets are chosen."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[2]
SCORED = ("corrected.nc", "diagnosis.json", "deviation.json")


def targets(names: Sequence[str]) -> list[str]:
    """Return the files of moorings that are scored; figures and the page are left out."""
    return [f"results/{name}/{file}" for name in names for file in SCORED]


def pipeline(cruise: Path, wanted: Sequence[str], cores: int, *, strict: bool = True) -> str:
    """Make files of a cruise and return what went wrong in a line, nothing where all went well.

    Args:
        wanted: the files, relative to it.
        strict: whether a failure ends the proof; where not, what could not be made is absent.

    Raises:
        SystemExit: Snakemake failed; its last lines are told.
    """
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile"), "--directory", str(cruise)]
    options = ["--workflow-profile", "none", "--cores", str(cores), "--keep-going", "--quiet", "rules", "progress"]
    path = os.pathsep.join(filter(None, (str(PROJECT), os.environ.get("PYTHONPATH"))))
    threads = {"PYTHONPATH": path, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(
        [*command, *options, "--", *wanted], capture_output=True, text=True, check=False, env=os.environ | threads
    )
    if ran.returncode and strict:
        sys.exit("the pipeline failed:\n" + ran.stderr[-3000:])
    said = [line.strip() for line in ran.stderr.splitlines() if line.strip()]
    errors = [line for line in said if "error: " in line or "Exception" in line]
    return (errors or said or ["no reason was given"])[0] if ran.returncode else ""
