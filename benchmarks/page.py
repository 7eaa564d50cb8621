"""Write the quick measurements to one page, results/bench/README.md, each with a ratio within the same run.

    python benchmarks/page.py [OUTPUT]

Times are CPU seconds (user and system, of all processes) unless stated otherwise, as they depend less on other work of
the machine than wall time. The demonstration cruise is simulated again in a temporary folder.
"""

from __future__ import annotations

import ast
import json
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import runs
import targets
import yaml
from numbers_of_pages import table
from runs import PROJECT
from targets import Measured

from compasslib import angles
from compasslib.deviation.series import multistart_least_squares, series_design, series_deviation

SCRIPTS = PROJECT / "workflow/scripts"
FLEETS = (10, 100, 1000)
EDITED = "EG5"
LIMITS = {"whole": 60.0, "without": 25.0, "edit": 12.0, "nothing": 3.0}


def change(path: Path, **keys: object) -> None:
    """Set keys of a YAML file."""
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | keys, sort_keys=False))


def took(folder: Path, *options: str) -> tuple[float, float]:
    """Run the workflow; return wall time and CPU time, seconds."""
    return runs.cost(runs.snakemake(folder, *options))[:2]


def cpu_of(code: str) -> float:
    """Measure the CPU seconds that a new interpreter takes for some code."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PROJECT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def of_cruise(temporary: Path) -> tuple[str, list[Measured]]:
    """Time the whole cruise, no diagnosis and figures, an edit, and an up-to-date cruise."""
    whole, bare = temporary / "whole", temporary / "bare"
    for folder in (whole, bare):
        shutil.copytree(PROJECT / "config", folder / "config")
    change(bare / "config/config.yaml", diagnose={"enabled": False})
    rows = [("whole cruise, diagnosis and figures", *took(whole), LIMITS["whole"])]
    rows.append(("without: to summary.csv", *took(bare, "--", "results/summary.csv"), LIMITS["without"]))
    change(whole / f"config/moorings/{EDITED}.yaml", declination=-20.5)
    rows.append((f"{EDITED}'s declination edited", *took(whole), LIMITS["edit"]))
    rows.append(("nothing to do", *took(whole), LIMITS["nothing"]))
    cells = [
        (name, f"{s:.1f}", f"{limit:.0f}", f"{cpu:.1f}", f"{cpu / rows[0][2]:.2f}") for name, s, cpu, limit in rows
    ]
    kept = [targets.limit(f"{name}, s by the clock", s, most=limit) for name, s, _, limit in rows]
    return table(cells, ("run, two cores", "s by the clock", "budget s", "CPU s", "of the whole")), kept


def of_imports() -> str:
    """Time the imports of each job in new interpreters."""
    bare = min(cpu_of("pass") for _ in range(3))
    rows, numpy = [], min(cpu_of("import numpy") for _ in range(3)) - bare
    for script in sorted(SCRIPTS.glob("*.py")):
        body = ast.parse(script.read_text()).body
        imports = "\n".join(ast.unparse(node) for node in body if isinstance(node, ast.Import | ast.ImportFrom))
        seconds = min(cpu_of(imports) for _ in range(3)) - bare
        rows.append((script.stem, f"{seconds:.2f}", f"{seconds / numpy:.1f}"))
    return table(rows, ("job", "imports, CPU s", "of numpy's"))


def of_fits() -> str:
    """Compare fits of the published series to known curves by SciPy's curve_fit and by this library."""
    from scipy.optimize import curve_fit

    rng, n = np.random.default_rng(1), 9000
    heading = rng.uniform(0.0, 360.0, n)
    columns = series_design(heading)
    rows = []
    for size in (10.0, 60.0, 130.0):
        true = size * np.array([0.1, 0.7, -0.4, 0.1, 0.05])
        deviation = angles.wrap180(columns @ true + rng.normal(0.0, 8.0, n))

        slow, other = timed(
            lambda y: curve_fit(lambda x, *c: series_deviation(c, x), heading, y, p0=np.zeros(5))[0], deviation
        )
        fast, own = timed(lambda y: multistart_least_squares(columns, y), deviation)
        errors = [float(np.abs(found - true).max()) for found in (other, own)]
        largest = float(np.abs(columns @ true).max())
        times = (f"{slow * 1e3:.1f}", f"{fast * 1e3:.1f}", f"{slow / fast:.1f}")
        rows.append((f"{largest:.0f}°", "8°", *times, *(f"{error:.2f}°" for error in errors)))
    head = ("largest deviation", "scatter", "curve_fit ms", "ours ms", "ratio", "its worst error", "ours")
    return table(rows, head)


def timed(action: Callable[[np.ndarray], np.ndarray], data: np.ndarray) -> tuple[float, np.ndarray]:
    """Measure the minimum CPU seconds of some repetitions, and return them with the result."""
    fastest = float("inf")
    for _ in range(5):
        begun = time.process_time()
        result = action(data)
        fastest = min(fastest, time.process_time() - begun)
    return fastest, result


def of_fleets(temporary: Path) -> str:
    """Time the planning of fleets of moorings by dry runs: of the jobs before the checkpoint, and of those after it."""
    rows = []
    for count in FLEETS:
        folder = fleet(temporary / f"fleet{count}", count)
        for part in ("reading", "the rest"):
            took = runs.cost(runs.snakemake(folder, "--dry-run", "--quiet", "rules"))
            found = re.search(r"^total +(\d+)", took.said, re.MULTILINE)
            planned = found[1] if found else "0"
            rows.append((str(count), part, planned, f"{took.cpu_s:.1f}", f"{took.peak_mb:.0f}"))
            pass_checkpoint(folder)
    return table(rows, ("moorings", "planned", "jobs", "CPU s", "peak MB"))


def fleet(folder: Path, count: int) -> Path:
    """Write a cruise of a given number of moorings, all with the same two empty raw files."""
    (folder / "config/moorings").mkdir(parents=True)
    (folder / "raw").mkdir()
    (folder / "config/config.yaml").write_text("moorings: config/moorings\n")
    mooring = yaml.safe_load((PROJECT / "config/moorings/EG4.yaml").read_text())
    for role, instrument in mooring["instruments"].items():
        instrument["files"] = f"raw/{role}.000"
        (folder / f"raw/{role}.000").touch()
    for k in range(count):
        (folder / f"config/moorings/M{k}.yaml").write_text(yaml.safe_dump(mooring | {"name": f"M{k}"}))
    return folder


def pass_checkpoint(folder: Path) -> None:
    """Write what the jobs up to the checkpoint write, without content, for all moorings of a fleet."""
    names = [path.stem for path in (folder / "config/moorings").iterdir()]
    roles = [path.stem for path in (folder / "raw").iterdir()]
    read = [file for role in roles for file in (f"work/{role}.nc", f"logs/read_{role}.json")]
    found = ["work/field.json", "work/pairs/overlap.nc", "work/pairs/wide.nc", "logs/overlap.json"]
    files = [f"{name}/{file}" for stage in (read, found) for name in names for file in stage]
    for file in (*files, "logs/usable.json"):
        (folder / "results" / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / "results" / file).touch()
    usable = {"moorings": dict.fromkeys(names), "calibrations": {}, "compasses": {}}
    (folder / "results/usable.json").write_text(json.dumps(usable))


def said_by(*command: str) -> str:
    """Run another benchmark and return its output."""
    run = [sys.executable, *command]
    done = subprocess.run(run, capture_output=True, text=True, check=False, env=runs.environment(), cwd=PROJECT)
    return done.stdout or f"Not measured: {(done.stderr.splitlines() or ['no reason'])[-1]}\n"


def main(output: Path) -> int:
    """Measure and write the page; return 1 if a budget is exceeded."""
    with tempfile.TemporaryDirectory() as name:
        cruise, budgets = of_cruise(Path(name))
        sections = {
            "The demonstration cruise": cruise,
            "Imports of the jobs": of_imports(),
            "Readers against mhkit and plain reading": said_by("benchmarks/throughput.py"),
            "The published series against curve_fit": of_fits(),
            "Planning 10, 100 and 1000 moorings": of_fleets(Path(name)),
            "Memory of one year at 10 minutes, 40 bins": said_by("benchmarks/memory.py", "1"),
        }
    body = "\n\n".join(f"## {title}\n\n{text}" for title, text in sections.items())
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(f"# Measurements\n\nBy `make bench`; ratios are within this run.\n\n{body}\n")
    print(output.read_text())
    return targets.report(budgets) or int("MISSED" in body)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else PROJECT / "results/bench/README.md"))
