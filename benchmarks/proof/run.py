"""Run the pipeline: moorings one by one through the stages of the workflow, with the same values.

It does not start an interpreter for each stage (tests/pipeline/test_process.py).
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from unittest import mock

from benchmarks import runs
from compasslib.pipeline.process import process_mooring

SCORED = ("corrected.nc", "diagnosis.json", "deviation.json")
KEPT = (*SCORED, "overlap.nc")
TASKS = 20  # per process before it is replaced, to limit the growth of memory


def each(job: Callable[[str], str], names: Sequence[str], cores: int, what: str) -> None:
    """Run one job for every mooring on several cores with progress messages; a job that returns a text has failed."""
    begun, done, failed = time.monotonic(), 0, []
    with (
        mock.patch.dict(os.environ, runs.ONE_THREAD),  # of the new processes
        multiprocessing.get_context("spawn").Pool(cores, maxtasksperchild=TASKS) as pool,
    ):
        for name, wrong in pool.imap_unordered(partial(_named, job), names):
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


def _named(job: Callable[[str], str], name: str) -> tuple[str, str]:
    return name, job(name)
