"""Would catch a depth that does not follow a neighbour's pressure, or a site whose deployments cannot be joined."""

from datetime import timedelta

import numpy as np
import pytest
import yaml

from compasslib.config.cruise import load_cruise
from compasslib.errors import InputError
from compasslib.stages.read import record_of
from compasslib.stages.settings import Moorings, check_cruise
from tests.world.launch import change
from tests.world.sea import START, cruise

HOURS = 48


@pytest.mark.parametrize("kind", ["instrument", "table"])
def test_depth_follows_the_pressure_of_a_neighbour(tmp_path, monkeypatch, kind):
    folder = cruise(tmp_path / "c", n=HOURS)
    file, pressure = folder / "config/moorings/M1.yaml", 303.0 + 4.0 * np.sin(np.arange(HOURS) / 5.0) ** 2
    times = [(START + timedelta(hours=k)).strftime("%Y-%m-%dT%H:%M:%SZ") for k in range(HOURS)]
    rows = [f"{times[k]},{pressure[k]:.3f},{10 + k % 7},{5 - k % 3}" for k in range(HOURS)]
    (folder / "raw/M1/ctd.csv").write_text("\n".join(["time_utc,dbar,u_cm_s,v_cm_s", *rows]))
    instruments = yaml.safe_load(file.read_text())["instruments"]
    instruments["top"]["depth_from"] = "ctd"
    ctd = {"format": "table", "files": "raw/M1/ctd.csv", "depth": 300}
    if kind == "table":
        ctd |= {"columns": {"time": "time_utc", "value": "dbar"}, "unit": "dbar"}
        change(file, instruments=instruments, covariates={"ctd": ctd})
    else:
        columns = {"time": "time_utc", "pressure": "dbar", "east": "u_cm_s", "north": "v_cm_s", "scale": 0.01}
        change(file, instruments=instruments | {"ctd": ctd | {"columns": columns}})
    monkeypatch.chdir(folder)
    settings = Moorings(load_cruise(folder))
    assert "raw/M1/ctd.csv" in settings.companion_files("M1", "top")
    read = record_of(settings.raw_files("M1", "top"), **settings.read("M1", "top"))
    dip = np.interp(read.time_s, START.timestamp() + 3600.0 * np.arange(HOURS), pressure) - 303.0
    # Of 894 m of water; one decibar is 0.99 m, and 303 dbar 300 m.
    assert read.depth_m - 100.0 == pytest.approx(0.99 * dip * 794.0 / 594.0, abs=0.7)
    assert np.ptp(read.depth_m) == pytest.approx(0.99 * np.ptp(dip) * 794.0 / 594.0, abs=0.05)
    assert any("depth by the pressure of ctd, +200 m along the wire" in said for said in read.warnings)


def test_deployments_of_a_site_need_one_axis_of_depths(tmp_path):
    folder = cruise(tmp_path / "c", ("M1", "M2"), n=HOURS)
    for k, step_m in (("1", 4), ("2", 8)):
        product = {"daily": True, "grid": {"step_m": step_m, "from_m": 80}}
        change(folder / f"config/moorings/M{k}.yaml", site="S", product=product)
    with pytest.raises(
        InputError, match=r"M2\.yaml: product\.grid: expected .step_m: 4, from_m: 80. as M1, found .step_m: 8"
    ):
        check_cruise(load_cruise(folder))
