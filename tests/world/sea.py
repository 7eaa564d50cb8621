"""A small simulated sea for tests: currents rotated by a known compass, as pairs or as a cruise folder."""

import contextlib
import csv
import io
import logging
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from compasslib.records import GOOD, EarthField, Pairs, Record
from tests.world import pairs as world
from tests.world.pd0_encoder import ensemble

SHARED = Path(__file__).resolve().parents[2] / ".." / "shared" / "data"
START = datetime.fromtimestamp(world.BEGIN_S, UTC)
MILD = (0.02, 0.3, 0.1, 0.03, -0.02)
FOLDED = (0.0, -1.1, 0.7, 0.02, -0.01)


def real(name: str) -> Path:
    """Get the path of a genuine recording; skip the test if it is absent."""
    if not (SHARED / name).exists():
        pytest.skip(f"{name} is not in ../shared/data")
    return SHARED / name


@contextlib.contextmanager
def mhkit() -> Iterator[Any]:
    """Give mhkit's reader without its prints, warnings and log lines; skip the test if it is absent."""
    logging.disable(logging.CRITICAL)
    try:
        with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield pytest.importorskip("mhkit.dolfyn")
    finally:
        logging.disable(logging.NOTSET)


def pairs(coefficients=MILD, **drawn) -> tuple[Pairs, np.ndarray]:
    """Draw hourly pairs by ``under_a_compass``, and the correct headings."""
    return world.under_a_compass(coefficients, **drawn)


def plain_record(time_s, flow, ranges_m=(0.0,), **columns) -> Record:
    """Make a record of good quality from its current, east + i north, (n, m) m/s; columns not given are missing."""
    n, flow = len(time_s), np.asarray(flow)
    names = ["heading_deg", "pitch_deg", "roll_deg", "pressure_dbar", "depth_m", "temperature_c", "supply_voltage"]
    plain = {name: np.full(n, np.nan) for name in names} | {
        "east": flow.real.copy(),
        "north": flow.imag.copy(),
        "bin_range_m": np.tile(np.array(ranges_m), (n, 1)),
        "quality": np.full(flow.shape, GOOD, dtype=np.int8),
        "heading_quality": np.full(n, GOOD, dtype=np.int8),
    }
    return Record(time_s=time_s, **(plain | columns))


def record_of(seen: Pairs) -> Record:
    """Make the record of one bin of which pairs were made."""
    flow = (seen.upper_east + 1j * seen.upper_north)[:, None]
    return plain_record(seen.time_s, flow, heading_deg=seen.heading_deg, depth_m=np.full(len(seen), 100.0))


def field_of(seen: Pairs, declination: float = 0.0) -> EarthField:
    """Make a constant field of 12,000 nT, horizontal and vertical, for the time of pairs."""
    return EarthField(seen.time_s[[0, -1]], np.full(2, declination), *np.full((3, 2), 12000.0))


def cruise(folder: Path, names=("M1",), *, coefficients=MILD, n: int = 1200, reference: bool = True) -> Path:
    """Write a cruise folder of hourly moorings: PD0 with four bins on top, CSV below; magnetic, no declination."""
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
    """Compose the mooring file of ``cruise``."""
    columns = {"time": "time_utc", "depth": "depth_m", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}
    deep = {"format": "table", "files": f"raw/{name}/deep.csv", "depth": 105, "columns": columns}
    top = {"format": "pd0", "files": f"raw/{name}/top.000", "depth": 100, "orientation": "up"}
    end = (START + timedelta(hours=n)).strftime("%Y-%m-%dT%H:%M:%SZ")
    said = {"name": name, "latitude": 65.3333, "longitude": -32.955, "water_depth": 894}
    said |= {"start": "2007-09-04T00:00:00Z", "end": end, "compromised": "top"}
    return said | ({"reference": "deep"} if reference else {}) | {"instruments": {"top": top, "deep": deep}}


def _ensembles(seen: Pairs):
    for i in range(len(seen)):
        velocity = [round(1000 * seen.upper_east[i]), round(1000 * seen.upper_north[i]), 3, 2]
        when, heading = START.replace(tzinfo=None) + timedelta(hours=i), round(100 * float(seen.heading_deg[i])) % 36000
        more = {"number": i + 1, "when": when, "heading": heading, "tilt1": 300, "tilt2": -200}
        yield ensemble([velocity] * 4, fixed={"up": True}, **more)


def _write_table(path: Path, seen: Pairs) -> None:
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["time_utc", "depth_m", "u_cm_s", "v_cm_s"])
        for i in range(len(seen)):
            time = (START + timedelta(hours=i)).strftime("%Y-%m-%dT%H:%M:%SZ")
            writer.writerow([time, 105.0, round(100 * seen.lower_east[i], 3), round(100 * seen.lower_north[i], 3)])
