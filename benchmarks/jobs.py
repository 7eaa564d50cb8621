"""CPU seconds a job of a processed cruise, by rule, and how much of it is imports.

python benchmarks/jobs.py [CRUISE]
"""

from __future__ import annotations

import ast
import csv
import resource
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
SCRIPTS = PROJECT / "workflow/scripts"


def cpu_of(code: str) -> float:
    """Return the CPU seconds that a fresh interpreter takes for some code."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PROJECT)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def imports_of(script: Path) -> str:
    """Return the import lines of a script."""
    lines = [ast.unparse(n) for n in ast.parse(script.read_text()).body if isinstance(n, ast.Import | ast.ImportFrom)]
    return "\n".join(lines)


def main(cruise: Path) -> None:
    jobs: dict[str, list[float]] = defaultdict(list)
    for path in sorted(cruise.glob("results/**/benchmarks/*.tsv")):
        with path.open() as stream:
            row = next(csv.DictReader(stream, delimiter="\t"))
        jobs["read" if path.stem.startswith("read_") else path.stem].append(float(row["s"]))
    bare = min(cpu_of("pass") for _ in range(3))
    print(f"{'rule':12} {'jobs':>4} {'wall s a job':>12} {'sum':>7} {'imports s':>10} {'share':>6}")
    for rule, walls in sorted(jobs.items(), key=lambda item: -sum(item[1])):
        imports = min(cpu_of(imports_of(SCRIPTS / f"{rule}.py")) for _ in range(3)) - bare
        mean = sum(walls) / len(walls)
        print(f"{rule:12} {len(walls):4} {mean:12.2f} {sum(walls):7.1f} {imports:10.2f} {imports / mean:6.0%}")
    print(f"{'all':12} {sum(map(len, jobs.values())):4} {'':12} {sum(map(sum, jobs.values())):7.1f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else PROJECT)
