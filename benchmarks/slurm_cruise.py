"""CPU time and files of a cruise of eight moorings by a local Slurm, by Snakemake alone, and by one process each.

    python benchmarks/slurm_cruise.py [MOORINGS]

Needs what ``tests/slurm.py`` starts, and root. CPU seconds are those of the whole machine: nothing else may run. The
exit status is 1 if files differ.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import growth
import runs
import targets
from runs import PROJECT, hashes, snakemake

sys.path.insert(0, str(PROJECT / "tests"))
import slurm

YEARS = 0.25  # of each record
STAGES = [option.replace("mooring_cores=1", "mooring_cores=0") for option in slurm.OPTIONS]


def machine_s() -> float:
    """Read the CPU seconds (user and system) that the machine has used so far."""
    user, nice, system = map(int, Path("/proc/stat").read_text().split()[1:4])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def main(scratch: Path, moorings: int) -> int:
    """Run all ways of execution, print the cost of each, and compare their files."""
    if slurm.missing():
        raise SystemExit(slurm.missing())
    forms = {
        "on this machine, a job a mooring": (os.cpu_count() or 1, ("--config", "mooring_cores=1")),
        "Slurm, a job a mooring": (None, slurm.OPTIONS),
        "Slurm, a job a stage": (None, STAGES),
    }
    names = growth.fleet(scratch / "alone", moorings, YEARS)
    one_process = sum(growth.one_process(scratch / "alone", name)[0] for name in names)
    targets.head("form", "s by the clock", "CPU s a mooring", "over one process without figures")
    targets.line("one process a mooring, no figures", "–", f"{one_process / moorings:.1f}", "1.00")
    made = []
    with slurm.cluster(scratch / "slurm"):
        for number, (form, (cores, options)) in enumerate(forms.items()):
            cruise = scratch / f"cruise{number}"
            growth.fleet(cruise, moorings, YEARS)
            begun, cpu = time.monotonic(), machine_s()
            runs.cost(snakemake(cruise, *options, cores=cores))
            wall, cpu = time.monotonic() - begun, machine_s() - cpu
            targets.line(form, f"{wall:.0f}", f"{cpu / moorings:.1f}", f"{cpu / one_process:.2f}")
            made.append(hashes(cruise / "results", ".snakemake"))
    differ = [
        name for each in made[1:] for name in sorted(each.keys() | made[0]) if each.get(name) != made[0].get(name)
    ]
    print(f"\n{len(made[0])} files of each form; {len(differ)} differ", *differ)
    return bool(differ)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(main(Path(folder), int(sys.argv[1]) if len(sys.argv) > 1 else 8))
