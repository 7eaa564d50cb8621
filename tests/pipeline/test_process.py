"""Would catch values of ``compass correct`` unlike the workflow's, or incomplete results."""

import shutil
import signal
import subprocess
import sys
import time
from datetime import timedelta
from pathlib import Path
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
import yaml
from threadpoolctl import threadpool_info, threadpool_limits

from compasslib.archive import crate
from compasslib.archive.files import read_json, write_json, write_reason
from compasslib.deviation import METHODS, fit_deviation
from compasslib.errors import InputError
from compasslib.pipeline import process as processing
from compasslib.stages import Files
from compasslib.stages.cruise import usable
from tests.world.launch import change, completed, environment, jobs_in, snakemake
from tests.world.sea import START, cruise

BENCH = {"kind": "platform", "file": "raw/bench.csv", "latitude": 65.0, "longitude": -33.0, "date": "2007-08-01"}


@pytest.fixture(scope="module")
def processed(tmp_path_factory) -> Path:
    """Cruise processed by the workflow: M1 with a fit to its pairs, M2 with a calibration that its pairs refute."""
    folder = cruise(tmp_path_factory.mktemp("cruise"), ("M1", "M2"), n=600)
    (folder / "config/calibrations").mkdir()
    (folder / "config/calibrations/bench.yaml").write_text(yaml.safe_dump(BENCH))
    rows = [f"{heading},{heading + 4.0 * (heading % 90 - 45) / 45}" for heading in range(0, 360, 15)]
    (folder / "raw/bench.csv").write_text("\n".join(["reference_deg,recorded_deg", *rows]))
    change(folder / "config/moorings/M2.yaml", fit={"method": "calibration", "name": "bench"})
    head, *rows = (folder / "raw/M2/deep.csv").read_text().splitlines()  # of a reference with wrong signs
    cells = (row.split(",") for row in rows)
    rows = [f"{time},{depth},{-float(east)},{-float(north)}" for time, depth, east, north in cells]
    (folder / "raw/M2/deep.csv").write_text("\n".join([head, *rows]))
    with (folder / "config/config.yaml").open("a") as stream:
        stream.write("product: {daily: true, grid: {step_m: 4, from_m: 80}}\n")
    for k in (1, 2):
        change(folder / f"config/moorings/M{k}.yaml", site="S")
    wanted = [f"results/M{k}/gridded.nc" for k in (1, 2)]
    return completed(folder, *wanted, "results/sites/S/gridded_daily.nc")


def test_daily_means_of_a_site_are_joined(processed):
    with netCDF4.Dataset(processed / "results/sites/S/gridded_daily.nc") as nc:
        names = nc["HEADING_ERROR_MODE"].mode_names.split(", ")
        assert names[:2] == ["declination", "M1: compass of deep"] and "M2: compass of deep" in names
        assert nc["SOURCE"].flag_meanings == "none M1_top M2_top M1_deep M2_deep" and nc.deployments == "M1, M2"
        assert "common days; later minus earlier" in nc.seams
    assert "S: daily means of M1, M2 joined" in (processed / "results/sites/S/logs/join.log").read_text()


@pytest.mark.parametrize(("mooring", "refuted"), [("M1", False), ("M2", True)])
def test_products_are_identical_to_those_of_the_workflow(processed, tmp_path, monkeypatch, mooring, refuted):
    said: list[str] = []
    monkeypatch.chdir(processed.parent)
    there = processing.process_mooring(processed.name, mooring, tmp_path / "new/here", say=said.append)
    assert there == tmp_path / "new/here" and any("headings corrected" in line for line in said)
    assert Path.cwd() == processed.parent and bool(read_json(there / "assessment.json")["refuted"]) is refuted
    results = processed / "results" / mooring
    theirs = {path.relative_to(results) for path in results.rglob("*") if path.is_file()}
    theirs = {file for file in theirs if file.parts[0] not in ("logs", "benchmarks")}
    own = {path.relative_to(there) for path in there.rglob("*") if path.is_file()}
    calibration = {Path(f"work/calibrations/bench/{file}") for file in ("calibration.json", "table.csv", "points.csv")}
    assert own == theirs | (calibration if mooring == "M2" else set())
    for file in theirs:
        assert (there / file).read_bytes() == (results / file).read_bytes(), file


def test_the_library_uses_one_thread_and_restores_the_limit(monkeypatch):
    def threads() -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    seen: list[set[int]] = []
    monkeypatch.setitem(METHODS, "exact", lambda *_: seen.append(threads()) or SimpleNamespace(fitted=False))
    with threadpool_limits(2, user_api="blas"):
        fit_deviation("exact", None)
        assert threads() == {2} and seen == [{1}]


def test_a_library_loaded_inside_the_limit_uses_one_thread():
    """Run in a separate process, as an environment variable takes effect only when a library is loaded."""
    code = (
        "from compasslib.statistics import single_threaded\n"
        "import os, numpy, threadpoolctl\n"
        "with single_threaded():\n"
        "    import scipy.linalg\n"
        "    found = [library['num_threads'] for library in threadpoolctl.threadpool_info()]\n"
        "print(len(found) > 1, set(found), 'OMP_NUM_THREADS' in os.environ)\n"
    )
    free = {name: value for name, value in environment().items() if not name.endswith("_NUM_THREADS")}
    ran = subprocess.run([sys.executable, "-c", code], env=free, capture_output=True, text=True, check=True)
    assert ran.stdout == "True {1} False\n"


def test_a_damaged_raw_file_leaves_no_output(tmp_path):
    folder = cruise(tmp_path / "c", n=50)
    (folder / "raw/M1/top.000").write_bytes(b"no recording" * 100)
    with pytest.raises(InputError, match=r"raw/M1/top\.000"):
        processing.process_mooring(folder, "M1", tmp_path / "out/M1")
    assert list((tmp_path / "out").iterdir()) == []


@pytest.mark.parametrize(
    ("mooring", "into", "line"),
    [
        ("M9", "new", r"M9: expected a mooring of \S+ \(M1\), found another name; write one of these names"),
        ("M1", "c/results/M1", "expected a folder that is not there yet, outside the workflow's results, found"),
    ],
)
def test_invalid_requests_are_refused(tmp_path, mooring, into, line):
    folder = cruise(tmp_path / "c", n=5)
    with pytest.raises(InputError, match=line):
        processing.process_mooring(folder, mooring, tmp_path / into)
    assert [path.name for path in tmp_path.iterdir()] == ["c"] and not (folder / "results").exists()


def test_affected_instruments_have_separate_folders_and_one_grid(tmp_path):
    folder = cruise(tmp_path / "c", n=300)
    mid = {"format": "pd0", "files": "raw/M1/top.000", "depth": 112, "orientation": "up"}
    mid["fit"] = {"method": "von_appen"}
    file, made = folder / "config/moorings/M1.yaml", tmp_path / "out"
    instruments = yaml.safe_load(file.read_text())["instruments"] | {"mid": mid}
    change(file, compromised=["top", "mid"], instruments=instruments)
    processing.process_mooring(folder, "M1", made)
    assert [read_json(made / f"{role}/deviation.json")["method"] for role in ("top", "mid")] == ["exact", "von_appen"]
    assert not (made / "top/gridded.nc").exists()
    with netCDF4.Dataset(made / "gridded.nc") as nc:
        assert nc["SOURCE"].flag_meanings == "none top mid deep" and set(np.unique(nc["SOURCE"][:])) >= {1, 2, 3}
        random, share, modes = (nc[f"HEADING_ERROR_{x}"][:].filled(np.nan) for x in ("RANDOM", "SHARE", "MODE"))
        assert random.shape[0] == 2 and len(nc["MODE"]) <= 8 and np.isfinite(nc["UCUR_UNCERTAINTY"][:]).any()
        assert (share[:2, 0] == 1.0).all() and (share[:2, 1] > 0.0).all()  # the declination, the reference's compass
        assert not (share[0, 2:] * share[1, 2:]).any()  # modes of single instruments
        whole = np.sqrt((share[0, 1:] ** 2) @ modes[1:] ** 2 + random[0] ** 2)  # of a magnetic heading
    with netCDF4.Dataset(made / "top/corrected.nc") as nc:
        sigma = np.deg2rad(nc["HEADING_CORRECTED_UNCERTAINTY"][:])
        assert np.all(nc["HEADING_COMMON_UNCERTAINTY"][:] < nc["HEADING_CORRECTED_UNCERTAINTY"][:])
    np.testing.assert_allclose(whole[: len(sigma)], sigma, rtol=1e-4)  # single precision in the file


def test_a_mooring_is_stopped_only_if_all_of_its_instruments_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names, fields = ["M1/top", "M1/mid"], ["results/M1/top/work/field.json", "results/M1/mid/work/field.json"]
    why = {"stage": "read_top", "why": "damaged", "file": "raw/a", "advice": "mend it"}
    without = dict.fromkeys(("moorings", "calibrations"), ())
    alone = {"needed": {name: [] for name in names}, "shared": {"c": (names, [])}, "without": without}
    write_json(fields[1], {})
    for field, reason in zip(fields, (None, why), strict=True):
        write_reason(field, why)
        Path("results/M1/gridded.nc").touch()
        usable(Files(moorings=fields, calibrations=[], usable="results/usable.json"), print, **alone)
        found, there = read_json("results/usable.json"), {path.name for path in Path("results/M1").glob("*.*")}
        assert found["moorings"]["M1/top"] == why and found["compasses"] == {"c": reason}
        assert there == {"stopped.json" if reason else "gridded.nc"}


def test_a_shared_compass_is_combined_from_the_members_present(tmp_path, monkeypatch):
    """Of three deployments of one compass, the recording of one is damaged."""
    folder = tmp_path / "c"
    for k, name in enumerate(("M1", "M2", "M3")):
        begin = START + timedelta(days=10 * k)
        monkeypatch.setattr("tests.world.sea.START", begin)
        one = cruise(tmp_path / name, (name,), n=60)
        file = one / f"config/moorings/{name}.yaml"
        instruments = yaml.safe_load(file.read_text())["instruments"]
        instruments["top"]["compass"] = "wh1"
        change(file, start=begin.isoformat(), instruments=instruments)
        shutil.copytree(one, folder, dirs_exist_ok=True)
    (folder / "config/config.yaml").write_text("{diagnose: {enabled: false}, product: {grid: false}}\n")
    (folder / "raw/M2/top.000").write_text("damaged")
    ran = snakemake(folder, drawn=False)
    assert ran.returncode == 1 and "error: mooring M2: raw/M2/top.000" in ran.stderr
    made, joined = jobs_in(ran.stderr), read_json(folder / "results/compasses/wh1/compass.json")
    assert {name for rule, name in made if rule == "diagnose_alone"} == {"M1", "M3"}
    assert {name for rule, name in made if rule == "diagnose_jointly"} == {"M1", "M3"}
    there = processing.process_mooring(folder, "M1", tmp_path / "M1 again")
    assert read_json(there / "work/compasses/compass.json") == joined
    for file in ("deviation.json", "corrected.nc", "work/alone/summary.json"):
        assert (there / file).read_bytes() == (folder / "results/M1" / file).read_bytes()
    assert "results/M1/work/alone/summary.json" in crate.listed(crate.read_manifest(folder))


def test_a_terminated_run_leaves_no_output(tmp_path):
    """Terminated in the fit, after the instruments were read."""
    folder = cruise(tmp_path / "c", n=50)
    code = (
        "import sys, time; from compasslib.cli import main; from compasslib.stages import fit\n"
        "fit.fit = lambda *_, **__: time.sleep(600)\nsys.exit(main())"
    )
    command = [sys.executable, "-c", code, "correct", "M1", "--cruise", str(folder)]
    ignored = {"preexec_fn": lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)}  # as by nohup
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, **ignored) as process:
        while not list((folder / "corrected").glob(".*/whole/work/field.json")):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGHUP)
        time.sleep(0.1)
        assert process.poll() is None
        process.terminate()
        assert process.wait() == 130 and "interrupted; no file is left half written" in process.stderr.read()
    assert list((folder / "corrected").iterdir()) == []
