"""A genuine record by telemetry as a cruise: what does the pipeline make of it, with and without planted iron?

    python benchmarks/telemetry.py FOLDER
    snakemake --snakefile Snakefile --directory FOLDER --cores 2

Writes a cruise of ../shared/data/moored/papa_node59p1.dat: its first two bins, sent again as PD12, are the affected
profiler, the two bins 40 m further up the trusted table. P0 has the headings as they are; P1 has them re-read by a
compass beside iron of 0.25 H forward and 0.1 H starboard, and its velocities turned with them: B and C of its fit, less
those of P0, should be 0.25 and 0.10.
"""

from __future__ import annotations

import sys
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

import pd12_files  # noqa: E402

from compasslib import readers  # noqa: E402
from compasslib.core import angles  # noqa: E402
from compasslib.core.records import Record  # noqa: E402

RAW = ROOT / ".." / "shared" / "data" / "moored" / "papa_node59p1.dat"
DEPTH, FIRST, SIZE = 490.0, 25.0, 20.0  # metres; the file does not tell
IRON = {"P0": (0.0, 0.0), "P1": (0.25, 0.1)}  # forward and starboard, of the horizontal field
MOORING = """\
name: {name}
latitude: 49.98
longitude: -144.25
water_depth: 4200
start: 2013-07-25T12:00:00Z
end: 2014-02-23T12:00:00Z
compromised: top
reference: deep
instruments:
  top: {{format: pd12, files: raw/{name}.dat, depth: 490, orientation: up, bin_size: 20, first_bin: 25}}
  deep: {{format: table, files: raw/deep.csv, columns: {{time: t, depth: z, east: u, north: v}}}}
"""


def recorded(heading_deg: NDArray[np.floating], forward: float, starboard: float) -> NDArray[np.floating]:
    """Return what a compass beside iron reads."""
    sine, cosine = angles.sin_cos(heading_deg)
    return angles.wrap360(angles.direction(sine - starboard, cosine + forward))


def telemetry(record: Record, name: str) -> bytes:
    """Return the first two bins as PD12, their headings and velocities by the compass beside iron."""
    heading = recorded(record.heading_deg, *IRON[name])
    turned = angles.turn(record.east, record.north, angles.difference(heading, record.heading_deg)[:, None])
    counts = np.nan_to_num(np.round(1000.0 * np.stack(turned, axis=2)[:, :2]), nan=-32768.0).astype(int)
    return b"".join(
        pd12_files.ensemble(i, _date(time_s), heading[i], [[*bin, 0, 0] for bin in counts[i].tolist()])
        for i, time_s in enumerate(record.time_s)
    )


def _date(time_s: float) -> datetime:
    return datetime.fromtimestamp(float(time_s), UTC)


def _row(record: Record, i: int, k: int) -> str:
    depth = DEPTH - FIRST - SIZE * k
    return f"{_date(record.time_s[i]):%Y-%m-%dT%H:%M:%SZ},{depth:g},{record.east[i, k]:.3f},{record.north[i, k]:.3f}"


def main(folder: Path) -> None:
    """Write the cruise."""
    record = readers.read("pd12", [RAW], {"orientation": "up", "bin_size": SIZE, "first_bin": FIRST})
    order = np.argsort(record.time_s, kind="stable")
    (folder / "config/moorings").mkdir(parents=True, exist_ok=True)
    (folder / "raw").mkdir(exist_ok=True)
    (folder / "config/config.yaml").write_text("overlap: {max_metres: 50, max_minutes: 30}\n")
    rows = [_row(record, i, k) for i in order for k in (2, 3) if np.isfinite(record.east[i, k] + record.north[i, k])]
    (folder / "raw/deep.csv").write_text("\n".join(["t,z,u,v", *rows]) + "\n")
    for name in IRON:
        (folder / f"raw/{name}.dat").write_bytes(telemetry(record, name))
        (folder / f"config/moorings/{name}.yaml").write_text(MOORING.format(name=name))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
