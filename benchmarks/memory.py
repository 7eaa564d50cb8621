"""Peak memory and CPU time of each stage for one long record: years of 10-minute ensembles of 40 bins.

    python benchmarks/memory.py [YEARS]

Only the length of the record matters: it is simple (tide, slow current, weak iron). Ten years may take 1 GB per job.
"""

import sys
import tempfile
from itertools import pairwise
from pathlib import Path

import numpy as np
import runs
import targets
import yaml

from compasslib import angles, compass
from compasslib.demo import adcp

START_S, YEAR_S, STEP_S, CELLS = 1_262_304_000, 31_557_600, 600, 40  # from 2010-01-01
LIMIT_MB = 1000
IRON = (0.01, 0.2, -0.1, 0.02, 0.01)
SETUP = adcp.Setup(300, True, CELLS, 2.0, 1.76, 4.0, 30, "earth", 1)
STAGES = (
    *("work/top.nc", "work/deep.nc", "work/pairs/overlap.nc", "work/fit.json", "diagnosis.json", "corrected.nc"),
    *("gridded.nc", "figures/roses.png"),
)


def write_cruise(folder: Path, years: float, rng: np.random.Generator) -> None:
    """Write the raw files and the YAML files of one mooring."""
    (folder / "raw").mkdir(parents=True)
    (folder / "config/moorings").mkdir(parents=True)
    edges = np.arange(START_S, START_S + years * YEAR_S + 1, min(years, 0.5) * YEAR_S)
    with (folder / "raw/top.000").open("wb") as top, (folder / "raw/deep.csv").open("w") as deep:
        deep.write("time_utc,depth_m,east,north\n")
        for begin, end in pairwise(edges):
            time_s = np.arange(begin, end, STEP_S)
            east, north = water(time_s)
            top.write(adcp.encode(SETUP, ensembles(time_s, east, north, rng)).tobytes())
            dates = (time_s * 1e9).astype("datetime64[ns]").astype("datetime64[s]").astype(str)
            noise = rng.normal(0.0, 0.01, (2, len(time_s)))
            rows = zip(dates, east + noise[0], north + noise[1], strict=True)
            deep.writelines(f"{date}Z,105,{x:.4f},{y:.4f}\n" for date, x, y in rows)
    (folder / "config/config.yaml").write_text("moorings: config/moorings\n")
    (folder / "config/moorings/M.yaml").write_text(yaml.safe_dump(mooring(years)))


def mooring(years: float) -> dict[str, object]:
    """Compose the settings of the mooring's YAML file."""
    deep = {"format": "table", "files": "raw/deep.csv", "depth": 105, "direction_reference": "true"}
    deep["columns"] = {"time": "time_utc", "depth": "depth_m", "east": "east", "north": "north", "scale": 1.0}
    top = {"format": "pd0", "files": "raw/top.000", "depth": 100, "orientation": "up"}
    ends = np.array([START_S, START_S + int(years * YEAR_S)], dtype="datetime64[s]").astype(str)
    return {
        "name": "M", "latitude": 60.0, "longitude": -30.0, "water_depth": 800, "declination": 0,
        "start": f"{ends[0]}Z", "end": f"{ends[1]}Z", "compromised": "top", "reference": "deep",
        "instruments": {"top": top, "deep": deep},
    }  # fmt: skip


def water(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Simulate true east and north velocities, m/s: a rotary tide and currents that vary over weeks."""
    tide, slow = 360.0 * time_s / 44_712.0, 360.0 * time_s / (17.3 * 86_400.0)
    flow = 0.15 * angles.phasor(-tide) + 0.2 * angles.phasor(slow) + 0.1 * angles.phasor(2.7 * slow)
    return flow.real, flow.imag


def ensembles(time_s: np.ndarray, east: np.ndarray, north: np.ndarray, rng: np.random.Generator) -> adcp.Ensembles:
    """Simulate the record of a profiler near iron that turns with the current; declination 0."""
    n = len(time_s)
    heading = angles.direction(east, north) + rng.normal(0.0, 5.0, n)
    recorded = angles.wrap360(compass.recorded_heading(IRON, heading) + rng.normal(0.0, 0.5, n))
    seen = np.stack(angles.turn(east, north, recorded - heading), axis=-1)
    velocity = np.zeros((n, CELLS, 4))
    velocity[..., :2] = seen[:, None, :] + rng.normal(0.0, 0.02, (n, CELLS, 2))
    counts = np.full((n, CELLS, 4), 100, dtype=np.uint8)
    depth = 100.0 + 2.0 * np.hypot(east, north)
    level, steady = np.ones(n), np.full(n, 4.0)
    return adcp.Ensembles(
        time_s, np.arange(n), np.ones(n, dtype=bool), recorded, level, level, depth, depth, steady,
        np.full(n, 150, dtype=np.uint8), velocity, counts, counts, counts,
    )  # fmt: skip


def main(years: float) -> int:
    """Write the record, run it stage by stage, print the table; return 1 if a stage exceeds ``LIMIT_MB``."""
    targets.head("up to", "peak MB", "CPU s")
    peaks = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        write_cruise(folder, years, np.random.default_rng(1))
        size = (folder / "raw/top.000").stat().st_size / 1e6
        for target in STAGES:
            took = runs.cost(runs.snakemake(folder, "--quiet", "all", "--", f"results/M/{target}", cores=1))
            peaks.append(took.peak_mb)
            targets.line(target, f"{took.peak_mb:.0f}", f"{took.cpu_s:.1f}")
    print(f"\n{years:g} years, {round(years * YEAR_S / STEP_S)} ensembles of {CELLS} bins, {size:.0f} MB of PD0")
    return targets.report([targets.limit("largest peak, MB", max(peaks), most=LIMIT_MB)])


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0))
