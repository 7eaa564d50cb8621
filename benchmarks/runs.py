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
import json, resource, subprocess, sys, time
begun = time.monotonic()
done = subprocess.run(sys.argv[1:], capture_output=True, text=True)
wall, used = time.monotonic() - begun, resource.getrusage(resource.RUSAGE_CHILDREN)
took = [wall, used.ru_utime + used.ru_stime, used.ru_maxrss / 1024]
print(json.dumps([done.returncode, done.stdout + done.stderr, *took]))
"""


class Cost(NamedTuple):
    """Cost of a command: wall time, CPU seconds and peak memory of its largest process, MB; and its output."""

    wall_s: float
    cpu_s: float
    peak_mb: float
    said: str


def environment(project: Path = PROJECT, date: str | None = "0") -> dict[str, str]:
    """Compose the environment in which jobs import one project's library and use a fixed date, if one is given."""
    path = os.pathsep.join(filter(None, (str(project), os.environ.get("PYTHONPATH"))))
    dated = {} if date is None else {"SOURCE_DATE_EPOCH": date}
    return dated | os.environ | ONE_THREAD | {"PYTHONPATH": path}


def snakemake(folder: Path, *options: object, cores: int | None = 2, project: Path = PROJECT) -> list[str]:
    """Compose the command that runs the workflow on a cruise; without ``cores``, options must define the resources."""
    where = ("--snakefile", project / "Snakefile", "--directory", folder, *(("--cores", cores) if cores else ()))
    return [sys.executable, "-m", "snakemake", *map(str, (*where, *options))]


def cost(command: Sequence[str], project: Path = PROJECT) -> Cost:
    """Run a command and measure its cost; if it fails, the benchmark ends with its output."""
    run = [sys.executable, "-c", MEASURED, *command]
    done = subprocess.run(run, capture_output=True, text=True, check=True, env=environment(project), cwd=project)
    code, said, *took = json.loads(done.stdout)
    if code:
        raise SystemExit(said[-4000:])
    return Cost(*took, said)
