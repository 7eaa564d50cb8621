"""Would catch headings of the lowered example beyond the stated uncertainty."""

import csv
import shutil
import subprocess
import sys
from pathlib import Path

import netCDF4
import numpy as np
import pytest

from compasslib import angles
from compasslib.preparation.deployment import apply_deployment
from compasslib.readers import table
from tests.world.launch import PROJECT, completed, keeps_contract

EXAMPLE = PROJECT / "examples/lowered_adcp"


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("station")
    shutil.copytree(EXAMPLE / "config", folder / "config")
    command = [sys.executable, str(EXAMPLE / "make.py"), str(folder)]
    subprocess.run(command, check=True, env={"PYTHONPATH": str(PROJECT)})
    return completed(folder, drawn=False)


def errors(folder: Path) -> dict[str, np.ndarray]:
    """Compute the heading error before and after correction, the stated sigma and the depth of each sample."""
    with (folder / "truth/LADCP1.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    times = np.array([row["time_utc"].removesuffix("Z") for row in rows], dtype="datetime64[s]").astype(float)
    truth, depth = (np.array([float(row[k]) for row in rows]) for k in ("heading_true_magnetic_deg", "depth_m"))
    with netCDF4.Dataset(folder / "results/LADCP1/corrected.nc") as nc:
        stamps = netCDF4.num2date(nc["TIME"][:], nc["TIME"].units, only_use_cftime_datetimes=False)
        seconds = np.array(stamps, dtype="datetime64[s]").astype(float)
        series = {name: nc[name][:].filled(np.nan) for name in nc.variables if name.startswith("HEADING")}
    here = np.searchsorted(times, seconds)
    assert (times[here] == seconds).all()
    return {
        "before": angles.difference(series["HEADING"], truth[here]),
        "after": angles.difference(series["HEADING_CORRECTED"], truth[here]),
        "sigma": series["HEADING_CORRECTED_UNCERTAINTY"],
        "depth": depth[here],
    }


def test_heading_errors_match_the_stated_uncertainty(done):
    keeps_contract(done)
    off = errors(done)
    assert np.isfinite(off["after"]).all() and off["depth"].max() > 1990.0
    assert angles.rms(off["before"]) > 8.0
    below = off["depth"] > 750.0
    for part in (below, ~below):
        assert angles.rms(off["after"][part]) < 3.0
        assert np.mean(np.abs(off["after"][part]) < 1.96 * off["sigma"][part]) > 0.9
    # The uncertainty is not inflated: it is far below the error before correction.
    assert np.median(off["sigma"]) < 0.5 * angles.rms(off["before"])


def test_pairs_cover_the_depth_range_of_the_ship(done):
    with netCDF4.Dataset(done / "results/LADCP1/overlap.nc") as nc:
        upper, lower = (nc[name][:].filled(np.nan) for name in ("UPPER_DEPTH", "LOWER_DEPTH"))
    # The ship's ADCP reaches 696 m; between its profiles, a minute apart, the frame sinks 60 m.
    assert len(upper) > 150 and upper.min() < 60.0 and 630.0 < lower.max() <= 696.0
    assert np.abs(upper - lower).max() < 20.0


def test_nominal_depth_does_not_shift_the_bins_of_tables(tmp_path):
    path = tmp_path / "vessel.csv"
    rows = [f"2010-05-07T12:0{minute}:00Z,{z},10,5\n" for minute in range(5) for z in (24, 40, 56)]
    path.write_text("time,z,u,v\n" + "".join(rows))
    read = table.read([path], columns={"time": "time", "depth": "z", "east": "u", "north": "v"})
    span = {"start_s": read.time_s[0], "end_s": read.time_s[-1], "water_depth": 2300.0, "latitude": 36.5}
    settled = apply_deployment(read, **span, nominal_depth=5.0)
    assert settled.bin_depth_m()[0] == pytest.approx([24.0, 40.0, 56.0])
