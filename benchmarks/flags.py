"""Flags 1 of corrected headings that moorings without a fault have lost since another checkout.

    python benchmarks/flags.py ../main                    demonstration, eh2, aqd, papa, and 48 simulated moorings
    python benchmarks/flags.py ../main --only eh2 aqd     of these those whose name begins so

Results are kept in ``--into`` by a hash of the library. The exit status is 1 if over 0.5 % of all flags 1 are lost, or
over 2 % of those of a mooring. Real records are taken from ../shared/data, and left out if it is absent.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import netCDF4
import numpy as np
import targets
import yaml
from gridding import in_plain_water, with_iron
from runs import DATA, PROJECT, environment

from benchmarks.proof.world import draw
from compasslib.demo import demonstration, sealed
from compasslib.demo.sealed import Export, Wish
from tests.world import draw as paper

MOST, MOST_OF_ONE = 0.005, 0.02  # shares that may be lost
STRENGTHS = (0.2, 0.5, 0.75, 1.3)  # of the iron's field over the earth's horizontal field; above 1 two-valued
# Correct a mooring by the library that is imported.
CORRECT = """
import sys
from pathlib import Path
from compasslib.errors import InputError
from compasslib.pipeline.process import process_mooring

try:
    process_mooring(*sys.argv[1:])
except InputError as error:
    Path(sys.argv[3]).mkdir(parents=True)
    Path(sys.argv[3], "refused").write_text(str(error))
"""
COUNT, HOURS, PROFILER = 48, 2160, 12  # simulated moorings; step of the samples of a reference seen twice a day


def write(into: Path) -> list[tuple[Path, str]]:
    """Write the cruises that do not exist yet; return the cruise folder and the name of each mooring."""
    cruise = into / "demonstration"
    shutil.copytree(PROJECT / "config", cruise / "config", dirs_exist_ok=True)
    found = [(cruise, f"EG{k}") for k in range(1, 8)]
    for _, name in () if (cruise / "raw").exists() else found:
        demonstration.write_mooring(name, cruise / "raw", into / f"truth/{name}.csv")
    if (DATA / "cruise_eh2").is_dir():
        found += [(DATA / "cruise_eh2", name) for name in ("E0", "E1", "E2")]
        for record, seed in product(("aqd9330", "papa_node59p1"), (0, 1)):
            one = draw.Drawn(f"{record[:4]}{seed}", "null", record, real=True, seed=seed)
            found.append((into / one.name, one.name))
            if not (into / one.name).exists():
                draw.write(one, into / one.name, into / "truth", DATA)
    kinds = list(product((True, False), (1, PROFILER), (False, True), STRENGTHS))
    for k in range(COUNT):
        found.append((into / f"sea{k}", "M"))
        if not (into / f"sea{k}").exists():
            write_simulated(into / f"sea{k}", k, *kinds[k % len(kinds)])
    return found


def write_simulated(cruise: Path, seed: int, wide: bool, every: int, plain: bool, strength: float) -> None:
    """Write a simulated mooring with iron of a strength, in water that shears little if ``plain``."""
    drawn = paper.Sealed("M", wish=Wish(wide=wide, hours=HOURS), export=Export(deep="table"), seed=seed)
    ground = with_iron(sealed.make(seed, "M", drawn.wish), strength)
    sealed.write(in_plain_water(ground) if plain else ground, [], cruise / "raw/M", drawn.export)
    deep = cruise / "raw/M/deep.csv"
    head, *rows = deep.read_text().splitlines()
    deep.write_text("\n".join([head, *rows[::every]]) + "\n")
    (cruise / "config/moorings").mkdir(parents=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    (cruise / "config/moorings/M.yaml").write_text(yaml.safe_dump(paper._described(drawn, ground)))


def good(folder: Path) -> np.ndarray:
    """Read the times of the headings flagged 1, seconds; none without a product."""
    if not (folder / "corrected.nc").exists():
        return np.zeros(0)
    with netCDF4.Dataset(folder / "corrected.nc") as nc:
        return np.rint(np.ma.filled(nc["TIME"][:], np.nan)[nc["HEADING_CORRECTED_QC"][:] == 1] * 86400.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("older", type=Path, help="checkout that is compared")
    parser.add_argument("--only", nargs="+", default=[""], help="beginnings of names of moorings or cruises")
    parser.add_argument("--into", type=Path, default=PROJECT / "results/flags")
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    os.environ |= environment()
    into = asked.into.resolve()
    moorings = [(c, n) for c, n in write(into) if c.name.startswith(tuple(asked.only)) or n in asked.only]
    places = []
    for library in (asked.older.resolve(), PROJECT):
        code = b"".join(path.read_bytes() for path in sorted((library / "compasslib").rglob("*.py")))
        places.append((library, into / hashlib.sha256(code).hexdigest()[:10]))

    def run(job: tuple[tuple[Path, Path], tuple[Path, str]]) -> None:
        (library, kept), (cruise, name) = job
        made = kept / f"{cruise.name}-{name}"
        if not made.exists():
            command = [sys.executable, "-c", CORRECT, str(cruise), name, str(made)]
            subprocess.run(command, check=True, env=environment(library), cwd=library)

    with ThreadPoolExecutor(asked.cores) as pool:
        list(pool.map(run, product(places, moorings)))
    targets.head("mooring", "flags 1 before", "lost", "gained")
    counts = []
    for cruise, name in moorings:
        before, after = (good(kept / f"{cruise.name}-{name}") for _, kept in places)
        counts.append((len(before), int((~np.isin(before, after)).sum()), int((~np.isin(after, before)).sum())))
        targets.line(f"{cruise.name} {name}", *counts[-1])
    total, lost, gained = np.sum(counts, axis=0)
    worst = max(gone / max(there, 1) for there, gone, _ in counts)
    targets.line("all", total, f"{lost} ({lost / max(total, 1):.2%}, worst {worst:.2%})", gained)
    sys.exit(bool(lost > MOST * total or worst > MOST_OF_ONE))


if __name__ == "__main__":
    main()
