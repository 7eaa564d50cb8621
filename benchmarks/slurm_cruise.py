"""The demonstration cruise by a Slurm on loopback and on this machine alone: seconds, and how many files are equal.

    python benchmarks/slurm_cruise.py

Needs what ``tests/slurm.py`` starts: Debian's slurm-wlm and munge, make slurm, and root. Exits 1 where a file differs.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT / "tests"))
import slurm  # noqa: E402


def demonstration(folder: Path) -> Path:
    shutil.copytree(PROJECT / "config", folder / "config")
    return folder


def seconds(folder: Path, *options: str) -> float:
    """Return what one run of the workflow takes by the clock."""
    command = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder]
    begun = time.monotonic()
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(PROJECT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run([*command, *options], env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(done.stderr[-4000:])
    return time.monotonic() - begun


def hashes(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of raw files, truth and results; benchmarks alone hold times."""
    files = [path for part in ("raw", "truth", "results") for path in sorted((folder / part).rglob("*"))]
    kept = [path for path in files if path.is_file() and path.parent.name != "benchmarks"]
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in kept}


def main(scratch: Path) -> int:
    if slurm.missing():
        raise SystemExit(slurm.missing())
    here, there = (demonstration(scratch / name) for name in ("here", "there"))
    alone = seconds(here, "--cores", str(os.cpu_count()))
    with slurm.cluster(scratch / "slurm"):
        queued = seconds(there, *slurm.OPTIONS)
    first, second = hashes(here), hashes(there)
    names = sorted(first.keys() | second.keys())
    differ = [name for name in names if first.get(name) != second.get(name)]
    print(f"on this machine {alone:.0f} s, by Slurm {queued:.0f} s, {os.cpu_count()} cores each")
    print(f"{len(names) - len(differ)} files equal, {len(differ)} not", *differ)
    return bool(differ)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(Path(folder)))
