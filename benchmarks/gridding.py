"""Gridded product compared with the true currents at fixed depths: errors and coverage.

    python benchmarks/gridding.py [MOORINGS_A_KIND] [SEED]

Moorings in plain and structured water, with a diving sphere, with a profiler as reference, with a two-valued compass.
Each has a random error of the reference's compass (2 degrees) and of the declination. Intervals are over moorings.
"""

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import netCDF4
import numpy as np
import pandas as pd
import targets  # makes tests/world importable
import yaml

from compasslib.archive.gridded import open_gridded
from compasslib.config import cruise as config
from compasslib.demo import adcp, compass, sealed, water
from compasslib.demo import water as sea
from compasslib.demo.adcp import Setup
from compasslib.demo.sealed import Effect, Ground, Wish
from compasslib.deviation.model import declination_sigma
from compasslib.earthfield import field_from_json
from compasslib.pipeline import process
from tests.world import draw

KINDS = ("plain", "structured", "diving", "profiler", "two-valued")
STRENGTH = {"two-valued": 1.3}
HOURS, CELLS, CELL_M, REFERENCE_DEG, DAY_S = 1200, 16, 4.0, 2.0, 86400.0
PLAIN_SHEAR, WEAK = 0.25, 0.3  # factors of the layers in plain water, and of the buoyancy of a diving sphere
TOP = Setup(kilohertz=300, looks_up=True, cells=CELLS, cell_m=CELL_M, blank_m=1.76, first_bin_m=6.0, pings=4,
            coordinates="earth", serial=9001)  # fmt: skip


def ground_of(kind: str, seed: int) -> Ground:
    """Simulate a mooring of a kind."""
    ground = sealed.make(seed, "M", Wish(wide=True, hours=HOURS))
    strength = STRENGTH.get(kind, float(np.random.default_rng(seed).choice([0.1, 0.2, 0.35])))
    ground = with_iron(ground, strength)
    if kind == "plain":
        ground = in_plain_water(ground)
    if kind == "diving":
        rig = water.Rig(WEAK * (500.0 + 1.7 * ground.water_depth_m), 30.0, 26.0, 1.0, -1.0)
        declination = float(ground.field.at(ground.stamp_s)[0].mean())
        motion = water.make_motion(seed, "M", rig, ground.currents, declination_deg=declination)
        ground = replace(ground, motion=motion)
    return ground


def with_iron(ground: Ground, strength: float) -> Ground:
    """Place iron near the compass whose field has a strength relative to the earth's horizontal field."""
    _, horizontal, vertical = (float(x.mean()) for x in ground.field.at(ground.stamp_s))
    return replace(ground, meter=compass.build(ground.random("iron"), (horizontal, vertical), strength))


def in_plain_water(ground: Ground) -> Ground:
    """Reduce the shear, and let the current not turn with depth."""
    currents, level = ground.currents, np.full(ground.currents.time_s.size, PLAIN_SHEAR)
    layers, veer = currents.layers.times(level), 0.0 * currents.veer_deg_m
    return replace(ground, currents=replace(currents, layers=layers, veer_deg_m=veer))


def write(kind: str, ground: Ground, folder: Path) -> None:
    """Write the cruise of one mooring."""
    wrong = float(np.random.default_rng(ground.seed + 1).normal(0.0, REFERENCE_DEG))
    effects = [Effect(trusted=lambda heading: np.full(heading.shape, wrong))]
    raw = folder / "raw/M"
    sealed.write(ground, effects, raw, TOP)
    settings = draw.described(ground) | {"diagnose": {"enabled": False}, "product": {"daily": True}}
    settings["instruments"]["deep"] = write_point(ground, effects, raw / "deep.csv")
    if kind == "profiler":
        settings["instruments"]["deep"] = write_profiles(ground, wrong, raw / "deep.csv")
    (folder / "config/moorings").mkdir(parents=True)
    (folder / "config/config.yaml").write_text("moorings: config/moorings\n")
    (folder / "config/moorings/M.yaml").write_text(yaml.safe_dump(settings))


def write_point(ground: Ground, effects: Sequence[Effect], path: Path) -> dict[str, object]:
    """Write a table of the reference's velocity beside the sphere."""
    stance = sealed.deep_stance(ground, effects)
    flow = adcp.near_bins(sealed.DEEP, stance, ground.currents)
    flow = flow + water.white_vector(ground.random("deep"), flow.size, 0.02 / np.sqrt(2.0))
    flow = water.clockwise(flow, stance.recorded_deg - stance.heading_deg - stance.declination_deg)
    depth = stance.depth_m + adcp.ranges(sealed.DEEP)[:2].mean()
    write_table(path, "time_utc", stance.time_s, depth_m=depth, u_cm_s=100.0 * flow.real, v_cm_s=100.0 * flow.imag)
    columns = {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}
    return {"format": "table", "files": "raw/M/deep.csv", "depth": 112, "direction_reference": "magnetic",
            "columns": columns}  # fmt: skip


def write_table(path: Path, time: str, time_s: np.ndarray, **columns: np.ndarray) -> None:
    """Write a CSV file with a column of times of the given name."""
    stamps = np.char.add(np.datetime_as_string(time_s.astype("datetime64[s]")), "Z")
    pd.DataFrame({time: stamps, **columns}).to_csv(path, index=False, float_format="%.4f")


def write_profiles(ground: Ground, wrong_deg: float, path: Path) -> dict[str, object]:
    """Write scans of a profiler, every 30 s of an ascent at 25 cm/s to below the sphere, every four hours."""
    ends = ground.stamp_s[::4]
    time_s = (ends[:, None] - 30.0 * np.arange(12)[::-1]).ravel()
    sphere = np.interp(time_s, ground.motion.time_s, ground.motion.sphere_depth_m)
    depth = sphere + 5.0 + np.tile(7.5 * np.arange(12)[::-1], len(ends))
    flow = sea.velocity(ground.currents, time_s, depth)
    flow = flow + np.random.default_rng(ground.seed).normal(0.0, 0.01, (2, len(flow))).T @ np.array([1.0, 1j])
    turn = np.deg2rad(ground.field.at(time_s)[0] - wrong_deg)
    flow = flow * np.exp(1j * turn)
    write_table(path, "time", time_s, depth=depth, u=flow.real, v=flow.imag)
    columns = {"time": "time", "depth": "depth", "east": "u", "north": "v"}
    return {"format": "table", "files": "raw/M/deep.csv", "direction_reference": "magnetic", "columns": columns}


def measure(kind: str, seed: int, folder: Path) -> dict[str, float]:
    """Process a mooring and compare its product with the truth."""
    ground = ground_of(kind, seed)
    write(kind, ground, folder)
    results = folder / "results/M"
    with chdir(folder):
        results.mkdir(parents=True)
        process.process(config.load_cruise(Path()), "M", results.absolute())
    field = field_from_json(yaml.safe_load((results / "work/field.json").read_text()))
    turn = np.random.default_rng(seed + 2).normal(0.0, np.deg2rad(declination_sigma(field)))
    with netCDF4.Dataset(results / "gridded.nc") as nc:
        g = Grid(nc, lambda t, z: sea.velocity(ground.currents, t, np.tile(z, (len(t), 1))) * np.exp(1j * turn))
        found = dict(g.compare(), **g.section(np.random.default_rng(seed + 3).uniform(0, 2 * np.pi)))
    with netCDF4.Dataset(results / "corrected.nc") as nc:
        found |= beside_bins(nc, g)
    with netCDF4.Dataset(results / "gridded_daily.nc") as nc:
        daily = Grid(nc, g.of_days)
        found |= {f"daily {name}": value for name, value in daily.compare().items() if name.startswith("cover")}
    return found


class Grid:
    """A gridded file and the true currents at its cells."""

    def __init__(self, nc: netCDF4.Dataset, truth: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self.grid = open_gridded(Path(nc.filepath()))
        self.time_s, self.depth_m, self.quality = np.round(self.grid.time_s), self.grid.depth_m, self.grid.quality
        self.flow, self.sigma = self.grid.velocity, (self.grid.east_sigma, self.grid.north_sigma)
        self.source = self.grid.source + 1
        self.truth = truth(self.time_s, self.depth_m)

    def of_days(self, noon_s: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
        """Compute true daily means from the hours of this file."""
        return np.array([self.truth[np.abs(self.time_s + 1.0 - noon) <= DAY_S / 2].mean(axis=0) for noon in noon_s])

    def compare(self) -> dict[str, float]:
        """Compute rms error and coverage of both components."""
        off, good = self.flow - self.truth, np.isfinite(self.flow) & np.isfinite(self.sigma[0])
        parts = zip("uv", (off.real, off.imag), self.sigma, strict=True)
        cover = {f"cover {name}": np.mean(np.abs(x[good]) < 1.96 * s[good]) for name, x, s in parts}
        return {"rms_cm_s": 100.0 * np.sqrt(np.mean(np.abs(off[good]) ** 2) / 2.0)} | cover

    def section(self, angle: float) -> dict[str, float]:
        """Compute coverage and squared z of the mean of all cells in a given direction, radians from east."""
        good = np.isfinite(self.flow) & np.isfinite(self.sigma[0])
        weight = np.where(good, 1.0 / good.sum(), 0.0)
        east, north = weight * np.cos(angle), weight * np.sin(angle)
        _, sigma = self.grid.sum_cells(east, north)
        off = np.nansum(east * (self.flow - self.truth).real + north * (self.flow - self.truth).imag)
        return {"cover section": float(abs(off) < 1.96 * sigma), "section z2": float((off / sigma) ** 2)}


def beside_bins(nc: netCDF4.Dataset, g: Grid) -> dict[str, float]:
    """Compare the errors of cells from the affected instrument with those of a mean per bin."""
    read = lambda name: np.ma.filled(nc[name][:].astype(float), np.nan)  # noqa: E731
    flow, middle = read("UCUR") + 1j * read("VCUR"), np.nanmedian(read("DEPTH"), axis=0)
    flow = np.where(read("UCUR_QC") <= 2, flow, np.nan)
    row = np.rint((np.round((read("TIME") - 7305.0) * DAY_S) - g.time_s[0]) / 3600.0).astype(int)
    nearest = np.argmin(np.abs(middle[:, None] - g.depth_m), axis=0)
    naive = np.full((len(g.time_s), len(g.depth_m)), np.nan + 0j)
    naive[row] = np.where(np.abs(middle[nearest] - g.depth_m) <= CELL_M / 2.0, flow[:, nearest], np.nan)
    both = (g.source == 1) & np.isfinite(naive)
    rms = [np.sqrt(np.mean(np.abs((x - g.truth)[both]) ** 2) / 2.0) for x in (g.flow, naive)]
    return {"over a mean per bin": rms[0] / rms[1]}


def report(count: int, seed: int) -> None:
    """Print means over the moorings of each kind; the rows of single moorings go to standard error."""
    rows: dict[str, list[dict[str, float]]] = {}
    for k in range(count):
        for n, kind in enumerate(KINDS):  # each with its own currents, iron and reference
            with tempfile.TemporaryDirectory() as folder:
                made = measure(kind, 1000 * seed + 10 * k + n, Path(folder))
            rows.setdefault(kind, []).append(made)
            rounded = {name: round(value, 4) for name, value in made.items()}
            print(json.dumps({"kind": kind} | rounded), file=sys.stderr, flush=True)
    targets.head("moorings", "n", "rms of U and V, cm/s", "over a mean per bin", "U, V within 95 %",
                 "daily U, V within 95 %", "mean transport within 95 %")  # fmt: skip
    rows["all"] = [row for each in rows.values() for row in each]
    for kind, each in rows.items():
        inside = int(sum(row["cover section"] for row in each))
        targets.line(
            kind, len(each), mean(each, "rms_cm_s"), mean(each, "over a mean per bin"),
            f"{mean(each, 'cover u', 100.0)}, {mean(each, 'cover v', 100.0)} %",
            f"{mean(each, 'daily cover u', 100.0)}, {mean(each, 'daily cover v', 100.0)} %",
            targets.text_of(inside, len(each)),
        )  # fmt: skip


def mean(rows: list[dict[str, float]], name: str, times: float = 1.0) -> str:
    """Format a mean over moorings with its 95 % interval."""
    values = times * np.array([row[name] for row in rows])
    return f"{values.mean():.2f} ± {1.96 * values.std(ddof=1) / np.sqrt(len(values)):.2f}"


if __name__ == "__main__":
    report(*(int(x) for x in [*sys.argv[1:], "12", "7"][:2]))
