"""The pipeline on a real moored record whose real headings are known, for both methods.

    python benchmarks/real_record.py ../shared/data/cruise_eh2

Copies the cruise to a temporary folder, runs it once with every mooring by ``exact`` and once by ``von_appen``, and holds
the headings of corrected.nc against truth_NAME.csv (E0's own compass is the truth there: it was left untouched).
"""

from __future__ import annotations

import csv
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import netCDF4
import numpy as np

PROJECT = Path(__file__).resolve().parent.parent


def run(source: Path, folder: Path, method: str) -> None:
    shutil.copytree(source, folder, copy_function=shutil.copyfile)
    for path in (folder / "config/moorings").glob("*.yaml"):
        path.write_text(re.sub(r"method: \w+", f"method: {method}", path.read_text()))
    command = [sys.executable, "-m", "snakemake", "--snakefile", PROJECT / "Snakefile", "--directory", folder]
    subprocess.run([*map(str, command), "--cores", "2", "--quiet", "all"], check=True, capture_output=True)


def truth(folder: Path, name: str, time: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    path = folder / f"truth_{name}.csv"
    if not path.exists():
        return recorded
    with path.open() as stream:
        rows = list(csv.reader(stream))[1:]
    days = np.array([np.datetime64(row[0].removesuffix("Z")) for row in rows]) - np.datetime64("1950-01-01")
    known = dict(zip(np.rint(days / np.timedelta64(1, "s")).astype(int), (float(row[1]) for row in rows), strict=True))
    return np.array([known.get(int(t), np.nan) for t in np.rint(time * 86400.0)])


def off(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a - b + 180.0) % 360.0 - 180.0


def line(folder: Path, name: str, method: str) -> str:
    with netCDF4.Dataset(folder / "results" / name / "corrected.nc") as nc:
        get = lambda v: np.ma.filled(nc[v][:].astype(float), np.nan)  # noqa: E731
        time, recorded, corrected = get("TIME"), get("HEADING"), get("HEADING_CORRECTED")
        sigma, probability = get("HEADING_CORRECTED_UNCERTAINTY"), get("BRANCH_PROBABILITY")
    real = truth(folder, name, time, recorded)
    before, after = off(recorded, real), off(corrected, real)
    known = np.isfinite(after)
    rms = lambda x: float(np.sqrt(np.nanmean(x**2)))  # noqa: E731
    sure = known & (probability >= 0.95)
    return (
        f"{name:4} {method:10} {known.mean():9.3f} {rms(before):10.2f} {rms(after):9.2f} "
        f"{np.nanmedian(np.abs(after)):9.2f} {rms(sigma):12.2f} {np.mean(np.abs(after[known]) < 1.96 * sigma[known]):9.3f} "
        f"{sure.mean():10.3f} {rms(after[sure]) if sure.any() else float('nan'):9.2f}"
    )


def main(source: Path) -> None:
    print("name method     corrected rms before rms after |median| stated sigma covered95 share P>.95 rms there")
    with tempfile.TemporaryDirectory() as scratch:
        for method in ("exact", "von_appen"):
            folder = Path(scratch) / method
            run(source, folder, method)
            for path in sorted((folder / "config/moorings").glob("*.yaml")):
                print(line(folder, path.stem, method))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
