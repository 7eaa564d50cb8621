"""Runs of the workflow for benchmarks: commands and their cost."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parent.parent
sys.path.append(str(PROJECT))  # for tests/world
DATA = PROJECT.parent / "shared/data"
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# Run in a separate process, whose only child is the command, to measure its resources.
MEASURED = """
import json, resource, subprocess, sys
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(json.dumps([done.returncode, done.stdout + done.stderr, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]))
"""


class Cost(NamedTuple):
    """Cost of a command: CPU seconds, and peak memory of its largest process, MB."""

    cpu_s: float
    peak_mb: float


def snakemake(folder: Path, *options: object, cores: int | None = 2) -> list[str]:
    """Compose the command that runs the workflow on a cruise."""
    where = ("--snakefile", PROJECT / "Snakefile", "--directory", folder, "--cores", cores)
    return [sys.executable, "-m", "snakemake", *map(str, (*where, *options))]


def cost(command: Sequence[str], project: Path = PROJECT, date: str | None = "0") -> Cost:
    """Run a command by the library of a project, and measure its cost; if it fails, end with its output.

    Args:
        date: of the results, seconds since 1970; None: the present one.
    """
    path = os.pathsep.join(filter(None, (str(project), os.environ.get("PYTHONPATH"))))
    into = ({} if date is None else {"SOURCE_DATE_EPOCH": date}) | os.environ | ONE_THREAD | {"PYTHONPATH": path}
    run = [sys.executable, "-c", MEASURED, *command]
    done = subprocess.run(run, capture_output=True, text=True, check=True, env=into, cwd=project)
    code, said, *took = json.loads(done.stdout)
    if code:
        raise SystemExit(said[-4000:])
    return Cost(*took)
