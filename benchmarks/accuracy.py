"""Heading errors of the product and of both methods alone, with known truth: the tables of README and accuracy.md.

    python benchmarks/accuracy.py            the demonstration cruise, after make run
    python benchmarks/accuracy.py CRUISE     any cruise folder with truth/NAME.csv or truth_NAME.csv
    python benchmarks/accuracy.py --product  only the existing results of the cruise

Copies of the cruise are run by ``exact`` and by ``von_appen``, without the search. ``by eye`` is the published series
about the mean deviation, inverted where most pairs lie. Without a truth file, the recorded headings of a mooring are
taken as the truth. Currents on fixed depths are those of benchmarks/gridding.py.
"""

import argparse
import csv
import json
import shutil
import sys
import tempfile
from pathlib import Path

import netCDF4
import numpy as np
import targets
import yaml
from runs import PROJECT, cost, snakemake

from compasslib.angles import difference, rms
from compasslib.archive.netcdf import read_pairs
from compasslib.deviation.model import observed_heading
from compasslib.deviation.series import fit_series_about_mean, invert_series
from compasslib.preparation.references import combine_references

METHODS = ("exact", "von_appen")
BY_EYE = "by eye"
HEADINGS = ("mooring", "recorded", "product", "stated 1σ, rms", "within 95 %", "`exact` alone", "`von_appen`", BY_EYE)


def run(source: Path, folder: Path, method: str) -> None:
    """Run a copy of the cruise by one method; raw files are linked and not modified."""
    shutil.copytree(source / "config", folder / "config", copy_function=shutil.copyfile)
    (folder / "raw").symlink_to((source / "raw").resolve())
    for path in (folder / "config/moorings").glob("*.yaml"):
        path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {"fit": {"method": method}}))
    settings = yaml.safe_load((folder / "config/config.yaml").read_text())
    settings |= {"diagnose": {"enabled": False}, "demonstration": False}
    (folder / "config/config.yaml").write_text(yaml.safe_dump(settings))  # the methods without the diagnosis
    names = [path.stem for path in (folder / "config/moorings").glob("*.yaml")]
    cost(snakemake(folder, "--quiet", "all", "--", *(f"results/{name}/corrected.nc" for name in names)))


def truth(source: Path, name: str, time_s: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """Read the correct magnetic heading of each sample, degrees, NaN if unknown."""
    concealed = source / f"concealed/{name}.json"
    if concealed.exists():
        told = json.loads(concealed.read_text())
        headings = [np.nan if heading is None else heading for heading in told["heading_deg"]]
        known = dict(zip(map(round, told["time_s"]), headings, strict=True))
        return np.array([known.get(int(t), np.nan) for t in time_s])
    paths = [path for path in (source / f"truth/{name}.csv", source / f"truth_{name}.csv") if path.exists()]
    if not paths:
        return recorded
    with paths[0].open() as stream:
        rows = list(csv.DictReader(stream))
    times = np.array([row["time_utc"].removesuffix("Z") for row in rows], dtype="datetime64[s]").astype(np.int64)
    known = dict(zip(times.tolist(), (float(row["heading_true_magnetic_deg"]) for row in rows), strict=True))
    return np.array([known.get(int(t), np.nan) for t in time_s])


def errors(source: Path, folder: Path, name: str, *, by_eye: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute the errors of recorded and of corrected headings, degrees, and the stated standard deviation."""
    with netCDF4.Dataset(folder / "results" / name / "corrected.nc") as nc:
        names = ("TIME", "HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY")
        days, recorded, corrected, sigma = (np.ma.filled(nc[v][:].astype(float), np.nan) for v in names)
    if by_eye:
        pairs = combine_references(read_pairs(folder / "results" / name / "overlap.nc"))
        corrected = invert_series(fit_series_about_mean(pairs), recorded, observed_heading(pairs))
    real = truth(source, name, np.rint((days - 7305.0) * 86400.0), recorded)
    return difference(recorded, real), difference(corrected, real), sigma


def told(error: np.ndarray) -> str:
    """State the rms of the known errors, and their share where it is not all."""
    share = np.isfinite(error).mean()
    return f"{rms(error):.2f}°" + (f" ({100 * share:.0f} %)" if share < 0.995 else "")


def headings(source: Path, name: str, methods: list[Path]) -> list[str]:
    """Compute the cells of ``HEADINGS``; those of the methods alone need the folders of their runs."""
    before, after, sigma = errors(source, source, name)
    known = np.isfinite(after)
    within = 100 * np.mean(np.abs(after[known]) < 1.96 * sigma[known]) if known.any() else np.nan
    alone = [told(errors(source, folder, name)[1]) for folder in methods]
    alone += [told(errors(source, methods[-1], name, by_eye=True)[1])] if methods else ["–"] * 3
    return [name, f"{rms(before):.1f}°", told(after), f"{rms(sigma):.2f}°", f"{within:.0f} %", *alone]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cruise", nargs="?", type=Path, default=PROJECT)
    parser.add_argument("--product", action="store_true", help="what stands in the cruise's results")
    asked = parser.parse_args()
    if not (asked.cruise / "raw").is_dir():
        sys.exit(f"{asked.cruise}: no raw files; run make run first, or name a cruise folder")
    names = [path.stem for path in sorted((asked.cruise / "config/moorings").glob("*.yaml"))]
    with tempfile.TemporaryDirectory() as scratch:
        folders = [] if asked.product else [Path(scratch) / method for method in METHODS]
        for folder in folders:
            run(asked.cruise, folder, folder.name)
        targets.head(*HEADINGS)
        for name in names:
            targets.line(*headings(asked.cruise, name, folders))


if __name__ == "__main__":
    main()
