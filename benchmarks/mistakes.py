"""Mistakes of users in a real record (eh2): verdict, flags, uncertainty and errors, also by another checkout.

    python benchmarks/mistakes.py               all mistakes
    python benchmarks/mistakes.py --older PATH  each by both checkouts

The heading of E0 is correct as recorded, that of E1 is known; mistakes are made in the reference's table, in YAML keys.
"""

from __future__ import annotations

import argparse
import csv
import json
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import targets
import yaml
from runs import DATA, PROJECT, environment

from compasslib import angles

CRUISE, DECLINATION_DEG, REFERENCE_M = DATA / "cruise_eh2", 17.97, 19.2
PROCESS = "import sys; from compasslib.pipeline.process import process_mooring; process_mooring(*sys.argv[1:])"
Change = Callable[[np.ndarray], np.ndarray]  # of the reference's east + i north


def turned(by: Callable[[np.ndarray], np.ndarray] | float) -> Change:
    """Turn the reference's directions, by degrees or by a function of them, clockwise."""

    def change(flow: np.ndarray) -> np.ndarray:
        off = by(angles.direction(flow.real, flow.imag)) if callable(by) else by
        east, north = angles.turn(flow.real, flow.imag, np.zeros(len(flow)) + off)
        return east + 1j * north

    return change


def fouled(flow: np.ndarray) -> np.ndarray:
    """Let a rotor foul: its gain falls from 1 to 0.35 over the second half."""
    return flow * np.interp(np.arange(len(flow)), [len(flow) // 2, len(flow)], [1.0, 0.35])


OTHER = {"declination": 6.3}  # the reference is true: the constant differs by the difference of the declinations
MISTAKES: dict[str, tuple[str, Change, dict]] = {
    "none": ("E1", turned(0.0), {}),
    "axes rotated by 33°": ("E1", turned(33.0), {}),
    "axes rotated by 60°": ("E1", turned(60.0), {}),
    "steady veer of 9°": ("E1", turned(9.0), {}),
    "reference deviates by 8°·sin(direction)": ("E1", turned(lambda towards: 8.0 * angles.sin_cos(towards)[0]), {}),
    "declination 6.3°, constant 7°": ("E0", turned(7.0 + OTHER["declination"] - DECLINATION_DEG), OTHER),
    "declination 6.3°, constant 10°": ("E0", turned(10.0 + OTHER["declination"] - DECLINATION_DEG), OTHER),
    "true reference taken for magnetic": ("E1", turned(0.0), {"direction_reference": "magnetic"}),
    "directions random": ("E1", turned(lambda towards: np.random.default_rng(1).uniform(0, 360, len(towards))), {}),
    "rotor fouls, gain 1 to 0.35": ("E1", fouled, {"kind": "rotor"}),
}


def write(cruise: Path, name: str, change: Change, keys: dict, library: Path) -> None:
    """Write a cruise with one mooring of eh2 and a mistake; keys that a checkout does not know are left out."""
    mooring = yaml.safe_load((CRUISE / f"config/moorings/{name}.yaml").read_text())
    if (library / "compasslib/deviation/reference.py").exists() or "kind" not in keys:
        mooring["instruments"]["deep"] |= {key: x for key, x in keys.items() if key != "declination"}
    mooring |= {key: x for key, x in keys.items() if key == "declination"}
    (cruise / "config/moorings").mkdir(parents=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    (cruise / f"config/moorings/{name}.yaml").write_text(yaml.safe_dump(mooring))
    (cruise / f"raw/{name}").mkdir(parents=True)
    (cruise / f"raw/{name}/top.000").symlink_to(CRUISE / f"raw/{name}/top.000")
    table = pd.read_csv(CRUISE / f"raw/{name}/deep.csv")
    flow = change(table["u_cm_s"].to_numpy() + 1j * table["v_cm_s"].to_numpy())
    table.assign(u_cm_s=flow.real, v_cm_s=flow.imag).to_csv(cruise / f"raw/{name}/deep.csv", index=False)


def measure(mistake: str, library: Path) -> list[object]:
    """Process the record by one checkout; return the cells of its line."""
    name, change, keys = MISTAKES[mistake]
    with tempfile.TemporaryDirectory() as folder:
        cruise, made = Path(folder) / "cruise", Path(folder) / "made"
        write(cruise, name, change, keys, library)
        command = [sys.executable, "-c", PROCESS, str(cruise), name, str(made)]
        subprocess.run(command, check=True, env=environment(library), cwd=library)
        verdict = json.loads((made / "diagnosis.json").read_text())["verdict"]
        use = json.loads((made / "assessment.json").read_text()).get("use", {"answer": ""})["answer"]
        with netCDF4.Dataset(made / "corrected.nc") as nc:
            names = ("HEADING", "HEADING_CORRECTED", "HEADING_CORRECTED_UNCERTAINTY")
            recorded, heading, sigma = (np.ma.filled(nc[x][:], np.nan) for x in names)
            good = np.mean(nc["HEADING_CORRECTED_QC"][:] == 1)
            time_s = np.rint(np.ma.filled(nc["TIME"][:], np.nan) * 86400.0)
        with netCDF4.Dataset(made / "gridded.nc") as nc:
            late, deep = slice(-len(nc["TIME"]) // 8, None), int(np.argmin(np.abs(nc["DEPTH"][:] - REFERENCE_M)))
            speed = float(np.ma.mean(np.hypot(nc["UCUR"][late, deep], nc["VCUR"][late, deep])))
    truth = recorded
    if name != "E0":
        with (CRUISE / f"truth_{name}.csv").open() as stream:
            rows = {row["time_utc"]: float(row["heading_true_magnetic_deg"]) for row in csv.DictReader(stream)}
        times = pd.to_datetime(time_s, unit="s", origin="1950-01-01").strftime("%Y-%m-%d %H:%M:%S")
        truth = np.array([rows.get(time, np.nan) for time in times])
    off = np.abs(angles.difference(heading, truth))
    known = np.isfinite(off) & np.isfinite(sigma)
    within = np.mean(off[known] < 1.96 * sigma[known])
    shown = (f"{np.nanmedian(sigma):.1f}°", f"{angles.rms(off[known]):.1f}°", f"{within:.0%}", f"{speed:.3f} m/s")
    return [verdict, use, f"{good:.0%}", *shown]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--older", type=Path, help="checkout that is compared")
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    libraries = {"before": asked.older.resolve()} if asked.older else {}
    libraries |= {"now": PROJECT}
    jobs = list(product(MISTAKES, libraries))
    with ThreadPoolExecutor(asked.cores) as pool:
        lines = list(pool.map(lambda job: measure(job[0], libraries[job[1]]), jobs))
    targets.head(
        "mistake", "by", "verdict", "use", "flags 1", "σ", "rms error", "within 95 %", "speed at the reference"
    )
    for (mistake, by), line in zip(jobs, lines, strict=True):
        targets.line(mistake, by, *line)


if __name__ == "__main__":
    main()
