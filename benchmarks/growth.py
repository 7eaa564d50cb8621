"""Scaling of time and memory with the length of a record, the number of moorings, and the number of effects.

    python benchmarks/growth.py                  a quarter of an hour on one core
    python benchmarks/growth.py --plan           only the planning of fleets of up to 1000 moorings
    python benchmarks/growth.py --plan 10000     of a fleet of this size

CPU seconds are user and system of all processes; peaks are those of the largest process.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from contextlib import chdir
from pathlib import Path

import memory
import numpy as np
import page
import runs
import targets
from targets import Measured

from compasslib.config.cruise import load_cruise
from compasslib.demo.sealed import Wish
from compasslib.pipeline import plan
from tests.world import draw

YEARS, MOORINGS, FLEETS, HOURS = (0.25, 0.5, 1.0, 2.0), (1, 2, 4), (10, 100, 1000), 4000
EFFECTS = ((), ("heeling",), ("heeling", "temperature"))
MOST_RATIO, STEEPEST = 1.5, 1.2  # limits of workflow over one process, and of the exponent of growth with length
ONE_PROCESS = "import sys; from compasslib.pipeline.process import process_mooring; process_mooring(*sys.argv[1:])"


def one_process(cruise: Path, name: str, *, published: bool = False) -> tuple[float, float]:
    """Correct a mooring in one process, by the published method alone if asked; return CPU seconds and peak MB."""
    if published:
        plain = {"fit": {"method": "von_appen"}, "diagnose": {"enabled": False}, "name": f"{name}P"}
        path = cruise / f"config/moorings/{name}P.yaml"
        path.write_text((cruise / f"config/moorings/{name}.yaml").read_text())
        page.change(path, **plain)
        name = f"{name}P"
    with tempfile.TemporaryDirectory() as folder:
        took = runs.cost([sys.executable, "-c", ONE_PROCESS, str(cruise), name, str(Path(folder) / name)])
    return took.cpu_s, took.peak_mb


def by_length(folder: Path) -> list[Measured]:
    """Measure records of increasing length, of 10-minute ensembles of 40 bins."""
    rows = []
    for years in YEARS:
        cruise = folder / f"years{years:g}"
        memory.write_cruise(cruise, years, np.random.default_rng(1))
        whole, published = one_process(cruise, "M"), one_process(cruise, "M", published=True)
        rows.append((years, *whole, *published, whole[0] / published[0]))
    table("record, years", "CPU s, peak MB, published alone CPU s, peak MB, ratio of CPU", rows)
    lengths, cpu, peak = np.array(rows).T[:3]
    powers = [float(np.polyfit(np.log(lengths), np.log(series), 1)[0]) for series in (cpu, peak)]
    what = "power of the length that {} grows by".format
    return [targets.limit(what(x), power, most=STEEPEST) for x, power in zip(("CPU", "memory"), powers, strict=True)]


def fleet(cruise: Path, count: int, years: float) -> list[str]:
    """Write a cruise of identical moorings and return their names."""
    memory.write_cruise(cruise, years, np.random.default_rng(1))
    first = cruise / "config/moorings/M.yaml"
    for k in range(1, count):
        first.with_name(f"M{k}.yaml").write_text(first.read_text().replace("name: M\n", f"name: M{k}\n"))
    return sorted(path.stem for path in first.parent.glob("*.yaml"))


def by_plan(folder: Path, fleets: Sequence[int] = FLEETS) -> None:
    """Measure the planning of the workflow for fleets of increasing size."""
    rows = []
    for count in fleets:
        fleet(folder / f"fleet{count}", count, 0.02)
        command = runs.snakemake(folder / f"fleet{count}", "--dry-run", "--quiet", "all")
        took, whole = runs.cost(command), runs.cost([*command, "--config", "mooring_cores=1"])
        rows.append((count, took.cpu_s, took.peak_mb, whole.cpu_s, whole.peak_mb, took.cpu_s / whole.cpu_s))
    table("moorings planned", "CPU s, peak MB, a job a mooring CPU s, peak MB, ratio of CPU", rows)


def by_moorings(folder: Path) -> list[Measured]:
    """Measure cruises of increasing size by the workflow, and by one process per mooring."""
    rows = []
    for count in MOORINGS:
        cruise = folder / f"moorings{count}"
        names = fleet(cruise, count, YEARS[0])
        with chdir(cruise):
            writers = plan.plan(load_cruise(Path())).writers
        wanted = [writers[f"results/{name}/gridded.nc"] for name in names]
        alone = sum(one_process(cruise, name)[0] for name in names)
        cpu = runs.cost(runs.snakemake(cruise, "--quiet", "all", "--", *wanted, cores=1)).cpu_s
        rows.append((count, cpu, alone, cpu / alone))
    table("moorings", "workflow CPU s, one process each CPU s, ratio", rows)
    return [targets.limit("CPU of the workflow over one process's", rows[-1][-1], most=MOST_RATIO)]


def by_effects(folder: Path) -> None:
    """Measure moorings with none, one and two effects."""
    rows = []
    for k, names in enumerate(EFFECTS):
        sealed = draw.Sealed(f"S{k}", dict.fromkeys(names, 3.0), wish=Wish(wide=True, hours=HOURS), seed=3)
        cruise, _ = draw.write_alone(sealed, folder / f"effects{k}")
        rows.append((len(names), *one_process(cruise, sealed.name)))
    table(f"effects of 3°, {HOURS} hourly ensembles", "CPU s, peak MB", rows)


def table(first: str, others: str, rows: Sequence[tuple[float, ...]]) -> None:
    """Print a table."""
    targets.head(first, *others.split(", "))
    for row in rows:
        targets.line(*(f"{value:.3g}" for value in row))


def main() -> int:
    """Print the tables; return 1 if a target is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plan", type=int, nargs="*", metavar="MOORINGS")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        by_plan(Path(name), asked.plan or FLEETS)
        if asked.plan is not None:
            return 0
        lines = by_length(Path(name)) + by_moorings(Path(name))
        by_effects(Path(name))
    return targets.report(lines)


if __name__ == "__main__":
    sys.exit(main())
