"""Run the pipeline: moorings one by one through the stages of the workflow, real recordings by the workflow itself.

Both give identical bytes (tests/test_stages_pipeline.py); the first does not start an interpreter for each stage.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from compasslib.pipeline.process import process_mooring

PROJECT = Path(__file__).resolve().parents[2]
SCORED = ("corrected.nc", "diagnosis.json", "deviation.json")
KEPT = (*SCORED, "overlap.nc")
TASKS = 20  # per process before it is replaced, to limit the growth of memory
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # a process has one core


def each(job: Callable[[str], str], names: Sequence[str], cores: int, what: str) -> None:
    """Run one job for every mooring on several cores with progress messages; a job that returns a text has failed."""
    begun, done, failed = time.monotonic(), 0, []
    with _one_thread_each(), multiprocessing.get_context("spawn").Pool(cores, maxtasksperchild=TASKS) as pool:
        for name, wrong in pool.imap_unordered(_Named(job), names):
            done += 1
            failed += [name] if wrong else []
            left_s = (time.monotonic() - begun) / done * (len(names) - done)
            said = f"{what}: {done} of {len(names)}, {left_s / 60.0:.0f} min left"
            print(f"{said}{f', {name} stopped: {wrong}' if wrong else ''}", file=sys.stderr, flush=True)
    if failed:
        print(f"{what}: {len(failed)} stopped: {', '.join(failed)}", file=sys.stderr, flush=True)


def process(cruise: Path, name: str, folder: Path) -> str:
    """Correct one mooring, keep the files in ``KEPT``, and return the reason if it stopped, else an empty text."""
    try:
        process_mooring(cruise, name, folder)
    except Exception as error:  # a mooring that stops is scored as such
        folder.mkdir(parents=True, exist_ok=True)
        wrong = f"{type(error).__name__}: {error}"
        (folder / "stopped.txt").write_text(wrong + "\n")
        return wrong
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name not in KEPT:
            path.unlink()
    return ""


def workflow(cruise: Path, wanted: Sequence[str], cores: int) -> str:
    """Create files of a cruise by Snakemake, as a user would, and return an error in one line, if any."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(PROJECT / "Snakefile"), "--directory", str(cruise)]
    options = ["--workflow-profile", "none", "--cores", str(cores), "--keep-going", "--quiet", "rules", "progress"]
    path = os.pathsep.join(filter(None, (str(PROJECT), os.environ.get("PYTHONPATH"))))
    environment = os.environ | THREADS | {"PYTHONPATH": path}
    whole = [*command, *options, "--", *wanted]
    ran = subprocess.run(whole, capture_output=True, text=True, check=False, env=environment)
    said = [line.strip() for line in ran.stderr.splitlines() if line.strip()]
    errors = [line for line in said if "error: " in line or "Exception" in line]
    return (errors or said or ["no reason was given"])[0] if ran.returncode else ""


class _Named:
    """A job that returns the name with its result; a class, as it must be picklable."""

    def __init__(self, job: Callable[[str], str]) -> None:
        self.job = job

    def __call__(self, name: str) -> tuple[str, str]:
        return name, self.job(name)


class _one_thread_each:
    """Context in which new processes have one thread each, to avoid oversubscription."""

    def __enter__(self) -> None:
        self.before = {key: os.environ.get(key) for key in THREADS}
        os.environ.update(THREADS)

    def __exit__(self, *_: object) -> None:
        for key, value in self.before.items():
            if value is None:
                os.environ.pop(key, None)
            else:
                os.environ[key] = value
