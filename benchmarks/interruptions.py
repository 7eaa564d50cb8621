"""Comparison of runs that were killed by SIGKILL at random times and restarted with an undisturbed run.

    python benchmarks/interruptions.py [KILLS] [SEED]

Each run is killed with its jobs, repeatedly until it ends by itself or was killed eight times (otherwise a late job
would take most of the kills on a busy machine); it is then restarted and left to finish, and a new cruise begins.
"""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from runs import PROJECT, environment, hashes, snakemake

sys.path.insert(0, str(PROJECT / "tests"))
from sea import cruise

OPTIONS = "{diagnose: {enabled: false}, fit: {method: von_appen}}\n"
MOST = 8  # kills of one cruise


def started(folder: Path) -> subprocess.Popen:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(snakemake(folder), cwd=PROJECT, env=environment(), start_new_session=True, **quiet)


def left(folder: Path) -> dict[str, str]:
    """Compute the hashes of all files except logs and benchmarks, which contain times."""
    return hashes(folder, "logs", "benchmarks")


def killed(folder: Path, after_s: float) -> bool:
    """Start a run and kill it after a time; return False if it had ended before."""
    run = started(folder)
    try:
        assert run.wait(after_s) == 0, f"a restart ended with {run.returncode}"
        return False
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
        run.wait()
        return True


def main(kills: int, seed: int) -> None:
    draw = random.Random(seed)
    with tempfile.TemporaryDirectory() as scratch:
        whole = cruise(Path(scratch) / "whole", n=60)
        (whole / "config/config.yaml").write_text(OPTIONS)
        shutil.copytree(whole, Path(scratch) / "clean")
        begun = time.monotonic()
        assert started(whole).wait() == 0
        lasted = time.monotonic() - begun
        done, ends, different, raw_changed = 0, 0, 0, 0
        while done < kills:
            folder = Path(scratch) / f"run{ends}"
            shutil.copytree(Path(scratch) / "clean", folder)
            last = min(kills, done + MOST)
            while done < last and killed(folder, draw.uniform(0.0, lasted)):
                done += 1
            assert started(folder).wait() == 0, "a plain restart after a kill failed"
            ends += 1
            different += left(folder / "results") != left(whole / "results")
            raw_changed += left(folder / "raw") != left(whole / "raw")
            shutil.rmtree(folder)
            print(
                f"{done} kills, {ends} cruises ended, {different} differ, {raw_changed} with raw data touched",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100, int(sys.argv[2]) if len(sys.argv) > 2 else 7)
