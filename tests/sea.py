"""A small simulated sea for tests: currents seen through a known compass, as pairs or as a cruise folder."""

from __future__ import annotations

import csv
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import yaml
from pd0_encoder import ensemble
from scipy.signal import lfilter

from compasslib.core import angles, compass
from compasslib.core.records import Pairs

SHARED = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
START = datetime(2007, 9, 4, tzinfo=UTC)
MILD = (0.02, 0.3, 0.1, 0.03, -0.02)
FOLDED = (0.0, -1.1, 0.7, 0.02, -0.01)


def red_noise(rng: np.random.Generator, n: int, memory: float, sd: float) -> np.ndarray:
    """Return noise with an exponential memory in samples."""
    keep = np.exp(-1.0 / memory)
    noise = rng.normal(size=n) * sd * np.sqrt(1.0 - keep**2)
    return lfilter([1.0], [1.0, -keep], noise)


def pairs(coefficients=MILD, *, n: int = 3000, seed: int = 1, spread: float | None = None) -> tuple[Pairs, np.ndarray]:
    """Return hourly pairs and the correct headings; headings follow the wake, or spread about one direction."""
    rng = np.random.default_rng(seed)
    east = 0.15 + red_noise(rng, n, 40, 0.12)
    north = -0.05 + red_noise(rng, n, 40, 0.12)
    flow = angles.direction(east, north)
    heading = flow + red_noise(rng, n, 6, 20.0) if spread is None else 210.0 + red_noise(rng, n, 20, spread)
    recorded = angles.wrap360(compass.recorded_heading(coefficients, heading) + rng.normal(0.0, 0.7, n))
    upper = angles.turn(east + rng.normal(0, 0.02, n), north + rng.normal(0, 0.02, n), recorded - heading)
    lower = [x + red_noise(rng, n, 10, 0.03) + rng.normal(0.0, 0.02, n) for x in (east, north)]
    time, zero = START.timestamp() + 3600.0 * np.arange(n), np.zeros(n)
    return (
        Pairs(time, recorded, zero, zero, *upper, *lower, zero + 90.0, zero + 105.0, zero, zero),
        angles.wrap360(heading),
    )


def cruise(folder: Path, names=("M1",), *, coefficients=MILD, n: int = 1200, reference: bool = True) -> Path:
    """Write a cruise folder of hourly moorings: a PD0 top of four bins and a CSV below; magnetic, no declination."""
    (folder / "config/moorings").mkdir(parents=True)
    (folder / "config/config.yaml").write_text("moorings: config/moorings\n")
    for k, name in enumerate(names):
        seen, _ = pairs(coefficients, n=n, seed=10 + k)
        (folder / "raw" / name).mkdir(parents=True)
        (folder / "raw" / name / "top.000").write_bytes(b"".join(_ensembles(seen)))
        _write_table(folder / "raw" / name / "deep.csv", seen)
        text = yaml.safe_dump(mooring(name, n, reference=reference), sort_keys=False)
        (folder / f"config/moorings/{name}.yaml").write_text(text)
    return folder


def mooring(name: str, n: int, *, reference: bool = True) -> dict:
    """Return the mooring file of ``cruise``."""
    columns = {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}
    deep = {"format": "table", "files": f"raw/{name}/deep.csv", "depth": 105, "columns": columns}
    top = {"format": "pd0", "files": f"raw/{name}/top.000", "depth": 100, "orientation": "up"}
    said = {
        "name": name,
        "latitude": 65.3333,
        "longitude": -32.955,
        "water_depth": 894,
        "start": "2007-09-04T00:00:00Z",
        "end": (START + timedelta(hours=n)).strftime("%Y-%m-%dT%H:%M:%SZ"),
        "compromised": "top",
        "reference": "deep",
        "instruments": {"top": top, "deep": deep},
    }
    if not reference:
        del said["reference"]
    return said


def _ensembles(seen: Pairs):
    for i in range(len(seen)):
        velocity = [round(1000 * seen.upper_east[i]), round(1000 * seen.upper_north[i]), 3, 2]
        yield ensemble(
            [velocity] * 4,
            fixed={"up": True},
            number=i + 1,
            when=(START + timedelta(hours=i)).replace(tzinfo=None),
            heading=round(100 * float(seen.heading_deg[i])) % 36000,
            tilt1=300,
            tilt2=-200,
        )


def _write_table(path: Path, seen: Pairs) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_utc", "depth_m", "u_cm_s", "v_cm_s"])
        for i in range(len(seen)):
            time = (START + timedelta(hours=i)).strftime("%Y-%m-%dT%H:%M:%SZ")
            writer.writerow([time, 105.0, round(100 * seen.lower_east[i], 3), round(100 * seen.lower_north[i], 3)])
