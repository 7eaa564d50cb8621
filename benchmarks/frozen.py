"""Comparison of all results of six cruises between this checkout and another commit.

    python benchmarks/frozen.py e368bdf                  against that commit, in a checkout of its own
    python benchmarks/frozen.py e368bdf --kept FOLDER    keeps cruises and results, and resumes from existing ones

Headings and velocities may differ by 1e-9, other numbers by ``DIGITS`` significant digits; verdicts and names must be
equal. Changed sentences, figures, flags and sets of intermediate files are counted and listed. The exit status is 1 if
a number, a verdict, a name or the set of products differs.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import netCDF4
import numpy as np
import pandas as pd
import yaml
from matplotlib import image
from runs import DATA, PROJECT, cost

from benchmarks.proof.world import draw
from compasslib import earthfield, readers
from compasslib.demo import demonstration
from compasslib.demo.sealed import Wish
from tests.world import draw as paper
from tests.world import nortek_encoder as nortek
from tests.world import observatory, package, recordings, redeployed, swing
from tests.world.nortek_encoder import Sample

NEAR = 1e-9
DIGITS = 6  # significant digits of numbers other than headings and velocities
EXACT = re.compile(r"HEADING|DEVIATION|[UV]CUR|BRANCH|corrected_deg")
NAMES = re.compile(r"(^|/)(verdict|effect|side|alternatives|method|kind|model|name|folded|effects)(/|$)")
OF_THE_RUN = re.compile(
    r"(^|/)(software.*|product_version|history|date_.*|source_files|metadata_link|.*sha256.*|conventions)(/|$)"
)
COMPASS = "import sys; from compasslib.cli import main; sys.exit(main())"
# Paths that earlier versions had, and files that a version may lack, as no user reads them.
RENAMED = {"wide/overlap.nc": "work/pairs/wide.nc", "work/alone/assessment.json": "work/alone/agreement.json"}
INTERNAL = re.compile(r"(^|/)work/|^usable\.json$")
SKIPPED = ("ro-crate-metadata.json", "report.html", "pictures.json")


def worktree(commit: str, folder: Path) -> Path:
    """Create a checkout of the commit in a folder."""
    if not folder.is_dir():
        subprocess.run(["git", "-C", PROJECT, "worktree", "prune"], check=True)
        subprocess.run(["git", "-C", PROJECT, "worktree", "add", "--detach", "--quiet", folder, commit], check=True)
    return folder


def write_raw(into: Path) -> list[str]:
    """Write the cruises that both versions process, by this checkout's simulation; return their names."""
    names = ["demonstration", "sealed", "calibrations", "shared", "formats"]
    names += ["eh2"] if (DATA / "cruise_eh2").is_dir() else []
    if (into / "written").exists():
        return names
    shutil.copytree(PROJECT / "config", into / "demonstration/config", dirs_exist_ok=True)
    settings = into / "demonstration/config/config.yaml"
    settings.write_text(settings.read_text().replace("demonstration: true", "demonstration: false"))
    for concealed in (into / "demonstration/config/moorings").glob("C*.yaml"):
        concealed.unlink()
    for k in range(1, 8):
        demonstration.write_mooring(f"EG{k}", into / "demonstration/raw", into / f"truth/EG{k}.csv")
    for cruise, moorings in (("sealed", "config/moorings"), ("calibrations", "[]")):
        (into / cruise / "config").mkdir(parents=True, exist_ok=True)
        (into / cruise / "config/config.yaml").write_text(f"moorings: {moorings}\n")
    (into / "locked").mkdir(exist_ok=True)
    for drawn in draw.draw(5, (24, 0), 2000, {}):
        draw.write(drawn, into / "sealed", into / "locked", DATA)
    _write_calibrations(into / "calibrations")
    shutil.copytree(PROJECT / "examples/redeployed/config", into / "shared/config")
    redeployed.write_cruise(into / "shared", seed=1)
    _write_formats(into / "formats")
    if "eh2" in names:
        for part in ("config", "raw"):
            shutil.copytree(DATA / "cruise_eh2" / part, into / "eh2" / part, dirs_exist_ok=True)
        subprocess.run(["chmod", "-R", "u+w", into / "eh2"], check=True)
    (into / "written").touch()
    return names


def _write_formats(cruise: Path) -> None:
    """Write a mooring with an AWAC as the affected instrument and a netCDF reference, and one that stops."""
    (cruise / "truth").mkdir(parents=True, exist_ok=True)
    for name in ("AWAC", "STOPS"):
        paper.write(paper.Sealed(name, wish=Wish(hours=2000, wide=True), seed=11), cruise, cruise / "truth")
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    raw, page = cruise / "raw/AWAC", cruise / "config/moorings/AWAC.yaml"
    top, deep = (readers.read("pd0", [raw / f"{role}.000"], {}) for role in ("top", "deep"))
    samples = [
        Sample(
            round((top.time_s[k] - top.time_s[0]) / 3600.0),
            np.nan_to_num(np.stack([top.east[k], top.north[k], 0.0 * top.east[k]]), nan=-32.768),
            heading=top.heading_deg[k], pitch=top.pitch_deg[k], roll=top.roll_deg[k], pressure=top.depth_m[k],
            begin=datetime.fromtimestamp(round(top.time_s[0]), UTC), minutes=60.0,
        )
        for k in range(len(top.time_s))
    ]  # fmt: skip
    head = nortek.configuration(nortek.ENU, top.east.shape[1])
    (raw / "top.wpr").write_bytes(head + b"".join(nortek.older(sample) for sample in samples))
    with netCDF4.Dataset(raw / "deep.nc", "w") as nc:
        nc.createDimension("TIME", len(deep.time_s))
        said = {"units": "seconds since 1970-01-01T00:00:00Z", "standard_name": "time"}
        nc.createVariable("TIME", "f8", ("TIME",)).setncatts(said)
        nc["TIME"][:] = deep.time_s
        for variable, values in (("UCUR_MAG", deep.east), ("VCUR_MAG", deep.north)):
            nc.createVariable(variable, "f4", ("TIME",), fill_value=99999.0)
            nc[variable].units = "m s-1"
            nc[variable][:] = np.ma.masked_invalid(values[:, 0])
    settings = yaml.safe_load(page.read_text())
    depth = round(float(np.nanmedian(deep.depth_m)), 1) + 4
    netcdf = {"format": "netcdf", "files": "raw/AWAC/deep.nc", "depth": depth, "direction_reference": "magnetic"}
    nortek_file = {"format": "nortek", "files": "raw/AWAC/top.wpr", "orientation": "up"}
    settings["instruments"] = {"top": nortek_file, "deep": netcdf}
    page.write_text(yaml.safe_dump(settings))
    for role in ("top", "deep"):
        (raw / f"{role}.000").unlink()
    (cruise / "raw/STOPS/top.000").write_bytes(np.random.default_rng(1).bytes(100_000))


def _write_calibrations(cruise: Path) -> None:
    """Write one calibration of each kind."""
    for folder in ("config/calibrations", "raw"):
        (cruise / folder).mkdir(parents=True, exist_ok=True)
    rng, raw, year_s = np.random.default_rng(1), cruise / "raw", 1.6e9 + 3600.0 * np.arange(8784)
    place = {"latitude": 48.4, "longitude": -4.5, "date": "2022-09-29"}
    settings = {
        kind: {"kind": kind, "file": f"raw/{kind}.csv"} | place for kind in ("platform", "swing", "magnetometer")
    }
    bench, log = recordings.bench(rng, "large_deviation"), recordings.log(rng, "hard_iron")
    columns = {"reference_deg": bench.correct_deg, "recorded_deg": bench.recorded_deg}
    pd.DataFrame(columns).to_csv(raw / "platform.csv", index=False)
    pd.DataFrame(dict(zip("xyz", log.field_nt.T, strict=True))).to_csv(raw / "magnetometer.csv", index=False)
    declination = float(earthfield.igrf(48.4, -4.5, 1.6e9)[0][0])
    recordings.written(swing.sail(rng, recordings.boat(rng, "")[0], declination), raw / "swing.csv")
    field = tuple(
        np.broadcast_to(x, year_s.size) + rng.normal(0.0, 0.05, year_s.size)
        for x in earthfield.igrf(58.0, -30.0, year_s)
    )
    observatory.write(raw / "declination.hor", year_s, field, (58.0, -30.0))
    settings["declination"] = {"kind": "declination", "file": "raw/declination.hor", "format": "iaga2002"}
    motion = package.lower(rng, package.Sea(), 1.2e9)
    second = package.Head(mount_deg=(47.0, 2.0, -1.5), first_s=0.37, ping_s=1.3, clock_s=7.3)
    for letter, head in {"a": package.Head(), "b": second}.items():
        stood = package.stand(rng, motion, head)
        (cruise / f"raw/{letter}.000").write_bytes(package.encoded(stood, looks_up=head.looks_up))
    settings["heads"] = {"kind": "two_heads", "file": ["raw/a.000", "raw/b.000"], "format": "pd0"}
    for name, text in settings.items():
        (cruise / f"config/calibrations/{name}.yaml").write_text(yaml.safe_dump(text))


def process(project: Path, raw: Path, into: Path) -> None:
    """Run ``compass run`` of one project on a copy of a cruise that links to its raw files."""
    if (into / "done").exists():
        return
    shutil.copytree(raw / "config", into / "config", dirs_exist_ok=True)
    for file in (raw / "raw").rglob("*"):
        if file.is_file():
            there = into / file.relative_to(raw)
            there.parent.mkdir(parents=True, exist_ok=True)
            there.unlink(missing_ok=True)
            os.link(file, there)
    try:
        cost([sys.executable, "-P", "-c", COMPASS, "run", str(into), "--", "--quiet"], project)
    except SystemExit:  # a mooring stopped
        if not (into / "results/summary.csv").exists():
            raise
    (into / "done").touch()


def leaves(content: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of every leaf of a JSON document."""
    if isinstance(content, dict):
        for key, value in content.items():
            yield from leaves(value, f"{path}/{key}")
    elif isinstance(content, list):
        for k, value in enumerate(content):
            yield from leaves(value, f"{path}/{k}")
    else:
        yield path, content


def content(path: Path) -> dict[str, Any]:
    """Read the content of a file by name: numbers, arrays and texts."""
    found: dict[str, Any] = {}
    if path.suffix == ".png":
        found = {"/figure": hashlib.sha256(image.imread(path).tobytes()).hexdigest()}
    elif path.suffix == ".json":
        found = dict(leaves(json.loads(path.read_text())))
    elif path.suffix == ".csv":
        rows = list(csv.DictReader(path.open()))
        found = {f"/{k}/{key}": _value(text) for k, row in enumerate(rows) for key, text in row.items()}
    else:
        with netCDF4.Dataset(path) as data:
            for name, variable in data.variables.items():
                values = np.ma.asarray(variable[:])
                numeric = values.dtype.kind in "iufb"
                found[f"/{name}"] = values.astype(float).filled(np.nan) if numeric else str(values.tolist())
            found |= {f"/{key}": _value(str(data.getncattr(key))) for key in data.ncattrs()}
    return {key: value for key, value in found.items() if not OF_THE_RUN.search(key)}


def _value(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def differs(key: str, old: Any, new: Any) -> str:
    """Classify the difference of two values: ``number``, ``name``, ``sentence``, ``figure``, or empty if equal."""
    if key == "/figure":
        return "" if old == new else "figure"
    if isinstance(old, str) or isinstance(new, str):
        kind = "name" if NAMES.search(key) else "sentence"
        return "" if old == new else kind
    if old is None or new is None or isinstance(old, bool):
        return "" if old == new else "name" if NAMES.search(key) else "number"
    a, b = np.asarray(old, dtype=float), np.asarray(new, dtype=float)
    if a.shape != b.shape:
        return "number"
    exact = EXACT.search(key) and "UNCERTAINTY" not in key
    limit = NEAR if exact else 0.5 * 10.0**-DIGITS * np.maximum(np.abs(a), 1e-300)
    with np.errstate(invalid="ignore"):
        return "" if ((np.abs(a - b) <= limit) | (a == b) | (np.isnan(a) & np.isnan(b))).all() else "number"


def compare(old: Path, new: Path) -> tuple[Counter[str], dict[str, list[str]]]:
    """Count equal and different values by kind of difference, and list the places where they differ."""
    counted: Counter[str] = Counter()
    where: dict[str, list[str]] = defaultdict(list)
    earlier, later = _files(old), _files(new)
    for file in sorted(earlier.keys() | later.keys()):
        if file not in earlier or file not in later:
            kind = "internal file" if INTERNAL.search(file) else "file"
            where[kind].append(f"{file}: only in the {'earlier' if file in earlier else 'later'}")
            counted[kind] += 1
            continue
        before, after = content(earlier[file]), content(later[file])
        for key in before.keys() | after.keys():
            one_sided = key not in before or key not in after
            kind = "key" if one_sided else differs(key, before[key], after[key])
            counted[kind or "same"] += 1 if one_sided or isinstance(before[key], str) else int(np.size(before[key]))
            if kind:
                where[kind].append(f"{file}{key}{'' if one_sided else _shown(before[key], after[key])}")
    return counted, where


def _files(results: Path) -> dict[str, Path]:
    """Find the files that are compared, by their paths in this version."""
    paths = {path.relative_to(results).as_posix(): path for path in results.rglob("*")}
    for old, new in RENAMED.items():
        paths = {name.removesuffix(old) + new if name.endswith(old) else name: path for name, path in paths.items()}
    apart = {"logs", "benchmarks", *SKIPPED}
    compared = (".json", ".csv", ".nc", ".png")
    return {name: path for name, path in paths.items() if path.suffix in compared and not apart & set(path.parts)}


def flags_changed(old: Path, new: Path) -> Iterator[str]:
    """Describe, for each mooring with changed flags of corrected headings, their number and the new warnings."""
    for after in sorted(new.glob("*/corrected.nc")):
        mooring, before = after.parent.name, old / after.relative_to(new)
        if not before.exists():
            continue
        flags = {}
        for path in (before, after):
            with netCDF4.Dataset(path) as data:
                seconds = np.rint(np.ma.filled(data["TIME"][:], np.nan) * 86400.0)
                flags[path] = dict(zip(seconds, data["HEADING_CORRECTED_QC"][:].tolist(), strict=True))
        pairs = Counter((flags[before][t], flags[after][t]) for t in flags[before].keys() & flags[after].keys())
        changes = {f"{a} to {b}": n for (a, b), n in sorted(pairs.items()) if a != b}
        if changes:
            said = [set(_warnings(path.parent)) for path in (before, after)]
            verdicts = [json.loads((path.parent / "diagnosis.json").read_text())["verdict"] for path in (before, after)]
            new = "; ".join(sorted(said[1] - said[0]))
            yield f"{mooring}: {changes} of {len(flags[after])}; {' -> '.join(verdicts)}; {new}"


def _warnings(folder: Path) -> Iterator[str]:
    """Yield the warnings and doubts of a mooring's results."""
    for path in folder.glob("*.json"):
        for key, value in leaves(json.loads(path.read_text())):
            if re.search(r"/(warnings|doubts)/\d+(/why)?$", key):
                yield str(value)


def _shown(old: Any, new: Any) -> str:
    if isinstance(old, np.ndarray):
        if old.shape != new.shape:
            return f": {old.shape} and {new.shape}"
        apart = np.abs(old - new)
        number = int((apart > NEAR).sum() + (np.isnan(old) != np.isnan(new)).sum())
        return f": up to {np.nanmax(apart, initial=0.0):.3g}, {number} of {old.size}"
    return f": {str(old)[:90]} -> {str(new)[:90]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("commit")
    parser.add_argument("--kept", type=Path, help="folder that is kept")
    parser.add_argument("--shown", type=int, default=12, help="differences that are listed of each way")
    asked = parser.parse_args()
    os.environ["SOURCE_DATE_EPOCH"] = "0"  # the same date for both commits
    with tempfile.TemporaryDirectory() as scratch:
        folder = (asked.kept or Path(scratch)).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        earlier = worktree(asked.commit, folder / "checkout")
        names = write_raw(folder / "raw")
        failed = 0
        for name in names:
            for project, side in ((earlier, "earlier"), (PROJECT, "later")):
                print(f"{name}, {side}", file=sys.stderr, flush=True)
                process(project, folder / "raw" / name, folder / side / name)
            counted, where = compare(folder / "earlier" / name / "results", folder / "later" / name / "results")
            print(f"{name}: " + ", ".join(f"{kind} {n}" for kind, n in sorted(counted.items())))
            for kind, places in sorted(where.items()):
                print("\n".join(f"  {kind}: {place}" for place in sorted(places)[: asked.shown]))
            for changed in flags_changed(folder / "earlier" / name / "results", folder / "later" / name / "results"):
                print(f"  flags: {changed}")
            failed += counted["number"] + counted["name"] + counted["file"]
        if not asked.kept:
            subprocess.run(["git", "-C", PROJECT, "worktree", "remove", "--force", earlier], check=True)
    sys.exit(bool(failed))


if __name__ == "__main__":
    main()
