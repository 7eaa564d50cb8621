"""The demonstration cruise by a Slurm on loopback and on this machine alone: seconds, and how many files are equal.

    python benchmarks/slurm_cruise.py

Needs what ``tests/slurm.py`` starts: Debian's slurm-wlm and munge, make slurm, and root. Exits 1 where a file differs.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from runs import PROJECT, cost, hashes, snakemake

sys.path.insert(0, str(PROJECT / "tests"))
import slurm


def demonstration(folder: Path) -> Path:
    shutil.copytree(PROJECT / "config", folder / "config")
    return folder


def main(scratch: Path) -> int:
    if slurm.missing():
        raise SystemExit(slurm.missing())
    here, there = (demonstration(scratch / name) for name in ("here", "there"))
    alone = cost(snakemake(here, cores=os.cpu_count() or 1)).wall_s
    with slurm.cluster(scratch / "slurm"):
        queued = cost(snakemake(there, *slurm.OPTIONS, cores=None)).wall_s
    first, second = (hashes(folder, "config", ".snakemake") for folder in (here, there))
    names = sorted(first.keys() | second.keys())
    differ = [name for name in names if first.get(name) != second.get(name)]
    print(f"on this machine {alone:.0f} s, by Slurm {queued:.0f} s, {os.cpu_count()} cores each")
    print(f"{len(names) - len(differ)} files equal, {len(differ)} not", *differ)
    return bool(differ)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(Path(folder)))
