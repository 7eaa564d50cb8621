"""Processing of one mooring without Snakemake: the same bytes as the workflow, complete or none."""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import netCDF4
import numpy as np
import pytest
import yaml
from launch import change, environment, snakemake
from sea import cruise
from threadpoolctl import threadpool_info, threadpool_limits

from compasslib.archive.files import read_json
from compasslib.config.cruise import load_cruise
from compasslib.deviation import METHODS, fit_deviation
from compasslib.errors import InputError
from compasslib.pipeline import plan, records
from compasslib.pipeline import process as processing
from compasslib.pipeline.plan import Stage
from compasslib.pipeline.settings import Wildcards
from compasslib.stages import correct

OF_THE_RUN = ("logs",)  # differ between runs
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
    ran = snakemake(folder, "--until", "grid", "compare")
    assert ran.returncode == 0, ran.stderr
    return folder


@pytest.mark.parametrize(("mooring", "refuted"), [("M1", False), ("M2", True)])
def test_products_are_identical_to_those_of_the_workflow(processed, tmp_path, mooring, refuted):
    said: list[str] = []
    there = processing.process_mooring(processed, mooring, tmp_path / "new/here", say=said.append)
    assert there == tmp_path / "new/here" and any("headings corrected" in line for line in said)
    assert bool(read_json(there / "assessment.json")["refuted"]) is refuted
    files = {path.relative_to(there) for path in there.rglob("*") if path.is_file()}
    elsewhere = {Path(f"work/calibrations/bench/{file}") for file in ("calibration.json", "table.csv", "points.csv")}
    results = processed / "results"
    theirs = {path.relative_to(results / mooring) for path in (results / mooring).rglob("*") if path.is_file()}
    theirs = {file for file in theirs if file.parts[0] not in OF_THE_RUN}
    assert files == theirs | (elsewhere if mooring == "M2" else set())
    for file in files:
        of = results if file in elsewhere else results / mooring
        other = of / file.relative_to("work") if file in elsewhere else of / file
        assert (there / file).read_bytes() == other.read_bytes(), file


def threads_of_linear_algebra() -> set[int]:
    return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}


def test_stages_and_library_use_one_thread_and_restore_the_limit(processed, tmp_path, monkeypatch):
    seen: dict[str, set[int]] = {}

    def fit(*_):
        seen["library"] = threads_of_linear_algebra()
        return SimpleNamespace(fitted=False)

    monkeypatch.setitem(METHODS, "exact", fit)
    monkeypatch.setattr(correct, "compare", lambda *_, **__: seen.update(stage=threads_of_linear_algebra()))
    with threadpool_limits(2, user_api="blas"):
        processing.run_stage(Stage("correct.compare", "", "", str), Wildcards("M1"), {})
        fit_deviation("exact", None)
        assert threads_of_linear_algebra() == {2}
    assert seen == {"stage": {1}, "library": {1}}


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


def test_the_working_directory_is_not_changed(processed, tmp_path, monkeypatch):
    monkeypatch.chdir(processed.parent)
    change(processed / "config/config.yaml", diagnose={"enabled": False})
    processing.process_mooring(processed.name, "M1", tmp_path / "here")
    assert Path.cwd() == processed.parent and (tmp_path / "here/corrected.nc").is_file()


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
        ("M1", ".", "expected a folder that is not there yet, found it there; name another folder, or move"),
        ("M1", "c/results/M1", "expected a folder outside the workflow's results, found one inside; name another"),
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
    jobs = plan.plan(load_cruise(folder)).jobs
    assert {"results/M1/logs/grid.json", "results/M1/top/logs/correct.json"} <= jobs.keys()


def test_a_shared_compass_splits_the_jobs_of_its_moorings(tmp_path):
    folder = cruise(tmp_path / "c", ("M1", "M2"), n=5)
    assert [*load_cruise(folder, plan.moorings_of(["--target-jobs", "mooring_M2:", "--cores", "1"])).moorings] == ["M2"]
    for name, start, end in (("M1", "2007-09-04", "2007-10-04"), ("M2", "2008-09-04", "2008-10-04")):
        path = folder / f"config/moorings/{name}.yaml"
        instruments = yaml.safe_load(path.read_text())["instruments"]
        instruments["top"]["compass"] = "wh1"
        change(path, instruments=instruments, start=start, end=end)
    loaded = load_cruise(folder, ["M2"])
    groups = plan.plan(loaded).mooring_jobs()
    assert [*groups] == ["alone_M1", "mooring_M1", "alone_M2", "mooring_M2"] and [*loaded.moorings] == ["M1", "M2"]
    assert groups["alone_M1"][-1].endswith("diagnose_alone.json") and groups["mooring_M1"][0].endswith("diagnose.json")
    assert plan.moorings_of(["--target-jobs", "alone_M1:", "mooring_M1:"]) is None


@pytest.mark.parametrize(("stops", "expected"), [(("top",), None), (("top", "mid"), "why")])
def test_a_grid_is_stopped_only_if_all_instruments_are(stops, expected):
    before = [{"of": {"mooring": f"M1/{r}"}, "stopped": {"why": "why"} if r in stops else None} for r in ("top", "mid")]
    inherited = records.inherited(before, "mooring", "M1")
    assert (inherited and inherited["why"]) == expected


def half_done(folder: Path) -> list[Path]:
    return list((folder / "corrected").glob(".*"))


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Cruise that takes seconds to process after the first file, which is enough to notice on a busy machine."""
    return cruise(tmp_path_factory.mktemp("long") / "c", n=20_000)


@pytest.fixture
def running(long, tmp_path):
    """Cruise with a running ``compass correct``, and its process."""
    folder = Path(shutil.copytree(long, tmp_path / "c"))
    code = "import sys; from compasslib.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "correct", "M1", "--cruise", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not any((left / "work/top.nc").exists() for left in half_done(folder)):
        time.sleep(0.01)
    yield folder, process
    process.kill()
    process.wait()
    process.stderr.close()


def test_a_terminated_run_leaves_no_output(running):
    folder, process = running
    process.terminate()
    assert process.wait() == 130 and "interrupted; no file is left half written" in process.stderr.read()
    assert list((folder / "corrected").iterdir()) == []


def begin_and_end(folder: Path) -> None:
    with suppress(KeyboardInterrupt), processing._whole(folder):
        raise KeyboardInterrupt


def test_leftovers_of_a_killed_run_are_removed_by_the_next(running):
    folder, process = running
    (living,) = half_done(folder)
    begin_and_end(folder / "corrected/M1")
    assert living.is_dir(), "another run is at work there"
    process.kill()
    process.wait()
    theirs = [folder / f"corrected/{name}" for name in (".M1.old", ".M1.compass-correct.mine", ".M2.compass-correct.x")]
    for other in theirs:
        other.mkdir()
    (theirs[2] / processing.MARK).touch()
    link = folder / "corrected/.M1.compass-correct.link"
    link.symlink_to(theirs[2])
    begin_and_end(folder / "corrected/M1")
    assert sorted(half_done(folder)) == sorted([*theirs, link]) and (theirs[2] / processing.MARK).exists()
