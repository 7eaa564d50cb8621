"""Runs killed by SIGKILL at random moments, then started again plainly: are the results those of an undisturbed run?

    python benchmarks/interruptions.py [KILLS] [SEED]

Every run is killed with its jobs at a moment drawn between nothing and the time that a whole run takes, again and again
until it ends by itself or was killed eight times (a late job would else take most of the kills of a busy machine); it
is started plainly then, and a new cruise begins. Logs and benchmarks, which hold times, are not compared.
"""

from __future__ import annotations

import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT / "tests"))
from sea import cruise  # noqa: E402

OPTIONS = "{diagnose: {enabled: false}, fit: {method: von_appen}}\n"
MOST = 8  # kills of one cruise


def command(folder: Path) -> list[str]:
    whole = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder]
    return [*map(str, whole), "--cores", "2"]


def started(folder: Path) -> subprocess.Popen:
    quiet = subprocess.DEVNULL
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    return subprocess.Popen(
        command(folder), cwd=PROJECT, env=environment, stdout=quiet, stderr=quiet, start_new_session=True
    )


def hashes(folder: Path) -> dict[str, str]:
    files = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    kept = [path for path in files if not {"logs", "benchmarks"} & set(path.parts)]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in kept}


def killed(folder: Path, after_s: float) -> bool:
    """Return whether a run was still going when it was killed."""
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
            different += hashes(folder / "results") != hashes(whole / "results")
            raw_changed += hashes(folder / "raw") != hashes(whole / "raw")
            shutil.rmtree(folder)
            print(
                f"{done} kills, {ends} cruises ended, {different} differ, {raw_changed} with raw data touched",
                flush=True,
            )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100, int(sys.argv[2]) if len(sys.argv) > 2 else 7)
