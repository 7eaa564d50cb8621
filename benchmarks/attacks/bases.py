"""Moorings to which a campaign adds errors: simulated ones and a real record, with weak to two-valued deviations."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from cruises import VARIABLE, Pd0, Table, stamps
from gridding import in_plain_water, with_iron
from runs import DATA

from compasslib.demo import sealed
from compasslib.demo.sealed import Export, Wish
from tests.world import draw

REAL = DATA / "cruise_eh2"
REAL_MOORING, REAL_DAYS = "E0", 70  # the original record, by a compass without iron


@dataclass(frozen=True)
class Base:
    """One mooring, simulated from its seed."""

    name: str
    seed: int
    strength: float  # of the iron's field over the earth's horizontal field; above 1 a reading has two headings
    water: str = "structured"  # structured (the standard simulation), plain (little shear, no turn with depth), real
    wide: bool = True  # whether the headings cover the full circle
    hours: int = 2160
    deep: str = "table"  # format of the reference, pd0 or table
    top: str = "earth"  # the affected instrument: PD0 in earth or beam coordinates, or a table
    every: int = 1  # step of the samples of the reference, as of a profiler that passes twice a day


BASES = (
    Base("plain", 11, 0.05, water="plain"),
    Base("weak", 12, 0.2, wide=False),
    Base("fast", 13, 0.75),
    Base("strong", 14, 1.3),
    Base("pd0", 15, 0.35, hours=1680, deep="pd0"),
    Base("beam", 16, 0.2, hours=1680, deep="pd0", top="beam"),
    Base("profiler", 17, 0.35, hours=2880, every=12),
    Base("text", 18, 0.35, top="table"),
    Base("real", 19, 0.2, water="real"),
    Base("real_strong", 20, 1.3, water="real"),
)
WATERS = ("plain", "structured", "real")
STRENGTHS = {"weak": 0.2, "strong": 0.5, "fast": 0.75, "two-valued": 1.3}


def nulls(count: int, seed: int) -> list[Base]:
    """Define moorings without errors, cycling through all combinations of water and strength."""
    kinds = [(water, name) for name in STRENGTHS for water in WATERS if water != "real" or REAL.is_dir()]
    drawn = []
    for k in range(count):
        turn, (water, name) = k // len(kinds), kinds[k % len(kinds)]
        keys = {"wide": turn % 2 == 0, "every": 12 if turn % 4 == 3 else 1}
        drawn.append(Base(f"null-{water}-{name}-{seed}.{k}", 1000 * seed + k, STRENGTHS[name], water, **keys))
    return drawn


def available() -> list[Base]:
    """List the bases, those of the real record only if it is available."""
    return [base for base in BASES if base.water != "real" or REAL.is_dir()]


def write(base: Base, folder: Path) -> None:
    """Write a cruise of one mooring M, and its times and correct headings to a separate file."""
    cruise = folder / base.name
    shutil.rmtree(cruise, ignore_errors=True)
    (cruise / "config").mkdir(parents=True)
    (cruise / "config/config.yaml").write_text("moorings: config/moorings\n")
    truth = _write_real(base, cruise) if base.water == "real" else _write_simulated(base, cruise)
    if base.top == "table":
        _write_top_as_table(cruise)
    if base.every > 1:
        path = cruise / "raw/M/deep.csv"
        pd.read_csv(path).iloc[:: base.every].to_csv(path, index=False)
    np.save(folder / f"{base.name}.npy", truth)


def iron(base: Base) -> complex:
    """Draw the hard iron for the real record, forward and starboard as a complex number, over the horizontal field."""
    return complex(base.strength * np.exp(1j * np.random.default_rng(base.seed).uniform(0.0, 2.0 * np.pi)))


def read_by(iron_in_field: complex, heading_deg: np.ndarray) -> np.ndarray:
    """Compute the recorded heading of a level compass near hard iron from correct headings, degrees."""
    return np.mod(-np.rad2deg(np.angle(np.exp(-1j * np.deg2rad(heading_deg)) + iron_in_field)), 360.0)


def _write_simulated(base: Base, cruise: Path) -> np.ndarray:
    export = Export(deep=base.deep, coordinates="beam" if base.top == "beam" else "earth")
    drawn = draw.Sealed("M", wish=Wish(wide=base.wide, hours=base.hours), export=export, seed=base.seed)
    draw.write(drawn, cruise, cruise)  # for its YAML file; the compass is built below
    (cruise / "M.npy").unlink()
    ground = with_iron(sealed.make(base.seed, "M", drawn.wish), base.strength)
    if base.water == "plain":
        ground = in_plain_water(ground)
    written = sealed.write(ground, [], cruise / "raw/M", export)
    return np.stack([written.time_s, written.heading_deg])


def _write_real(base: Base, cruise: Path) -> np.ndarray:
    """Write the first ``REAL_DAYS`` days of the real record as logged by a compass near iron."""
    raw = cruise / "raw/M"
    raw.mkdir(parents=True)
    settings = yaml.safe_load((REAL / f"config/moorings/{REAL_MOORING}.yaml").read_text().replace("raw/E0", "raw/M"))
    begin = pd.Timestamp(settings["start"])
    settings |= {"name": "M", "end": (begin + pd.Timedelta(days=REAL_DAYS)).strftime("%Y-%m-%dT%H:%M:%SZ")}
    (cruise / "config/moorings").mkdir()
    (cruise / "config/moorings/M.yaml").write_text(yaml.safe_dump(settings, sort_keys=False))
    last_s = begin.timestamp() + REAL_DAYS * 86400.0
    top = Pd0(REAL / "raw/E0/top.000")
    top.rows = top.rows[top.time_s <= last_s]
    truth = top.heading
    top.turn(read_by(iron(base), truth) - truth)
    top.set_heading(read_by(iron(base), truth))
    top.save(raw / "top.000")
    deep = Table(REAL / "raw/E0/deep.csv")
    deep.frame[deep.time_s <= last_s].to_csv(raw / "deep.csv", index=False)
    return np.stack([top.time_s, truth])


def _write_top_as_table(cruise: Path) -> None:
    """Replace the PD0 file of the affected instrument by a table of its first bins and headings."""
    top, path = Pd0(cruise / "raw/M/top.000"), cruise / "config/moorings/M.yaml"
    flow = top.velocity[:, :2, :2].mean(axis=1) / 10.0
    depth = top.get(VARIABLE, 16) / 10.0
    columns = {"time_utc": stamps(top.time_s), "depth_m": depth, "u_cm_s": flow[:, 0], "v_cm_s": flow[:, 1]}
    frame = pd.DataFrame(columns | {"heading_deg": top.heading})
    frame.round(2).to_csv(cruise / "raw/M/top.csv", index=False)
    (cruise / "raw/M/top.000").unlink()
    settings = yaml.safe_load(path.read_text())
    settings["instruments"]["top"] = {
        "format": "table", "files": "raw/M/top.csv", "depth": 100, "direction_reference": "magnetic",
        "columns": {
            "time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01,
            "heading": "heading_deg",
        },
    }  # fmt: skip
    path.write_text(yaml.safe_dump(settings, sort_keys=False))
