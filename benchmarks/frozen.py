"""Comparison of all results of some cruises between this checkout and another commit.

    python benchmarks/frozen.py e368bdf                        the demonstration, and eh2 where ../shared/data has it
    python benchmarks/frozen.py e368bdf CRUISE ... --kept DIR  these cruises; DIR keeps the results, which are reused

Headings and velocities may differ by 1e-9, other numbers by ``DIGITS`` significant digits; verdicts and names must be
equal. Changed sentences are counted and listed. The exit status is 1 if a number, a flag, a verdict, a name or the
set of files differs.
"""

import argparse
import csv
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
from runs import DATA, PROJECT, cost

NEAR = 1e-9
DIGITS = 6  # significant digits of numbers other than headings and velocities
SHOWN = 12  # differences of each kind that are listed
EXACT = re.compile(r"HEADING(?!.*UNCERTAINTY)|DEVIATION|[UV]CUR|BRANCH|corrected_deg")
NAMES = re.compile(r"(^|/)(verdict|effect|side|alternatives|method|kind|model|name|folded|effects)(/|$)")
OF_THE_RUN = re.compile(r"(^|/)(software.*|product_version|history|date_.*|source_files|metadata_link|.*sha256.*)(/|$)")
COMPASS = "import sys; from compasslib.cli import main; sys.exit(main())"


def process(project: Path, source: Path, folder: Path) -> Path:
    """Run ``compass run`` of a checkout on a copy of a cruise that links to its raw files; return the results."""
    if not (folder / "done").exists():
        shutil.copytree(source / "config", folder / "config", dirs_exist_ok=True)
        for part in ("raw", "concealed"):
            if (source / part).exists():
                shutil.copytree(source / part, folder / part, copy_function=shutil.copyfile, dirs_exist_ok=True)
        try:
            cost([sys.executable, "-P", "-c", COMPASS, "run", str(folder), "--", "--quiet"], project)
        except SystemExit:  # a mooring stopped
            if not (folder / "results/summary.csv").exists():
                raise
        (folder / "done").touch()
    return folder / "results"


def read(path: Path) -> dict[str, Any]:
    """Read the content of a file by name: numbers, arrays and texts."""
    found: dict[str, Any] = {}

    def add(content: Any, name: str) -> None:
        if isinstance(content, dict | list):
            for key, value in content.items() if isinstance(content, dict) else enumerate(content):
                add(value, f"{name}/{key}")
        else:
            found[name] = content

    if path.suffix == ".json":
        add(json.loads(path.read_text()), "")
    elif path.suffix == ".csv":
        with path.open(newline="") as stream:
            add(list(csv.DictReader(stream)), "")
    else:
        with netCDF4.Dataset(path) as data:
            for name, variable in data.variables.items():
                values = np.ma.asarray(variable[:])
                numeric = values.dtype.kind in "iufb"
                found[f"/{name}"] = values.astype(float).filled(np.nan) if numeric else str(values.tolist())
            found |= {f"/{key}": str(data.getncattr(key)) for key in data.ncattrs()}
    return {key: value for key, value in found.items() if not OF_THE_RUN.search(key)}


def difference(key: str, old: Any, new: Any) -> tuple[str, str]:
    """Classify the difference of two values as ``number``, ``name`` or ``sentence``, and show it; empty if equal."""
    try:
        a, b = np.asarray(old, dtype=float), np.asarray(new, dtype=float)
    except (TypeError, ValueError):
        kind = "name" if NAMES.search(key) else "sentence"
        return ("", "") if old == new else (kind, f": {str(old)[:90]} -> {str(new)[:90]}")
    if a.shape != b.shape:
        return "number", f": {a.shape} and {b.shape}"
    limit = NEAR if EXACT.search(key) else 0.5 * 10.0**-DIGITS * np.abs(a)
    with np.errstate(invalid="ignore"):
        apart = ~((np.abs(a - b) <= limit) | (a == b) | (np.isnan(a) & np.isnan(b)))
    if not apart.any():
        return "", ""
    changed = f": up to {np.nanmax(np.abs(a - b)):.3g} in {apart.sum()} of {a.size}"
    if key.endswith("_QC"):
        changed = f": {dict(Counter(f'{x:.0f} to {y:.0f}' for x, y in zip(a[apart], b[apart], strict=True)))}"
    return "flags" if key.endswith("_QC") else "number", changed


def compare(old: Path, new: Path) -> dict[str, list[str]]:
    """List the places where the results of two runs differ, by kind of difference."""
    where: dict[str, list[str]] = defaultdict(list)
    earlier, later = (
        {str(path.relative_to(results)): path for path in results.rglob("*") if path.suffix in (".json", ".csv", ".nc")}
        for results in (old, new)
    )
    for name in sorted(earlier.keys() | later.keys()):
        if {"logs", "benchmarks"} & set(Path(name).parts) or name == "ro-crate-metadata.json":
            continue
        if name not in earlier or name not in later:
            kind = "internal file" if "work" in Path(name).parts else "file"
            where[kind].append(f"{name}: only in the {'earlier' if name in earlier else 'later'}")
            continue
        before, after = read(earlier[name]), read(later[name])
        where["key"] += [f"{name}{key}" for key in sorted(before.keys() ^ after.keys())]
        for key in sorted(before.keys() & after.keys()):
            kind, shown = difference(key, before[key], after[key])
            where[kind].append(f"{name}{key}{shown}")
    return {kind: places for kind, places in sorted(where.items()) if kind and places}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit")
    parser.add_argument("cruises", nargs="*", type=Path, help="cruise folders whose raw files exist")
    parser.add_argument("--kept", type=Path, help="folder that is kept")
    asked = parser.parse_args()
    cruises = asked.cruises or [PROJECT, *(path for path in [DATA / "cruise_eh2"] if path.is_dir())]
    if not (cruises[0] / "raw").is_dir():
        sys.exit(f"{cruises[0]}: no raw files; run make run first, or name cruise folders")
    failed = False
    with tempfile.TemporaryDirectory() as scratch:
        folder = (asked.kept or Path(scratch)).absolute()
        earlier = folder / "checkout"
        if not earlier.is_dir():
            subprocess.run(["git", "clone", "--quiet", "--no-checkout", PROJECT, earlier], check=True)
            subprocess.run(["git", "-C", earlier, "checkout", "--quiet", asked.commit], check=True)
        for cruise in cruises:
            sides = ((earlier, "earlier"), (PROJECT, "later"))
            where = compare(*(process(project, cruise, folder / side / cruise.name) for project, side in sides))
            print(f"{cruise.name}: " + (", ".join(f"{kind} {len(w)}" for kind, w in where.items()) or "equal"))
            for kind, places in where.items():
                print("\n".join(f"  {kind}: {place}" for place in places[:SHOWN]))
            failed |= bool({"number", "flags", "name", "file"} & where.keys())
    sys.exit(failed)


if __name__ == "__main__":
    main()
