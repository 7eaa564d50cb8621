"""Would catch results lost, stale or half-written after a kill, a second run or a full disk."""

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.world.bench import readings, write_calibration
from tests.world.launch import command, completed, environment, hashes, snakemake
from tests.world.sea import FOLDED, cruise

KILLS = {
    "job": "os.kill(os.getpid(), 9)",
    "Snakemake": "os.kill(os.getppid(), 9)",  # while its job goes on
    "all": "os.killpg(0, 9)",
}
# What is killed before a file of each stage, most often the last of its results, is renamed from its half-written form.
# Jobs that do not wait for each other are killed in the same run.
KILLED = {
    "M1/work/top.nc": "job",
    "M1/work/pairs/wide.nc": "Snakemake",
    "usable.json": "all",
    "calibrations/bench/calibration.json": "job",
    "M1/work/fit.json": "job",
    "M1/work/alone/summary.json": "all",
    "compasses/X/diagnosis.json": "Snakemake",
    "M1/deviation.json": "all",
    "M1/histograms.csv": "job",
    "M1/gridded.nc": "Snakemake",
    "M1/figures/profile.png": "job",
    "summary.csv": "all",
    "report.html": "job",
    "ro-crate-metadata.json": "Snakemake",
    "logs/complete.json": "all",
}
# Code for the process of a run.
KILLING = f"""
import os, pathlib
os.setsid()
pathlib.Path("killed").mkdir(exist_ok=True)
kills = { {f"results/{file}": KILLS[which] for file, which in KILLED.items()} }
def replace(temporary, path, move=os.replace):
    mark = pathlib.Path("killed", str(path).replace("/", " "))
    if str(path) in kills and not mark.exists():
        mark.touch()
        exec(kills[str(path)])
    move(temporary, path)
os.replace = replace
"""


def new_cruise(folder: Path, seed: int, **drawn) -> Path:
    """Write a mooring that shares a compass with a calibration."""
    cruise(folder, n=60, **drawn)
    (folder / "config/config.yaml").write_text("{fit: {method: exact}, diagnose: {enabled: false}}\n")
    file = folder / "config/moorings/M1.yaml"
    file.write_text(file.read_text().replace("format: pd0", "format: pd0\n    compass: X"))
    write_calibration(folder, "bench", readings(seed=seed), compass="X")
    return folder


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """Process a cruise."""
    folder = new_cruise(tmp_path_factory.mktemp("done") / "c", 1)
    return completed(folder, drawn=False)


@pytest.fixture(scope="module")
def changed(done, tmp_path_factory) -> Path:
    """Process a cruise, and put the raw files of ``done`` in place of its own."""
    folder = new_cruise(tmp_path_factory.mktemp("changed") / "c", 2, coefficients=FOLDED)
    completed(folder, drawn=False)
    shutil.copytree(done / "raw", folder / "raw", dirs_exist_ok=True, copy_function=shutil.copy)
    return folder


def products(folder: Path) -> dict[str, str]:
    """Hash all results but logs and benchmarks, which contain times."""
    return hashes(folder / "results", "logs", "benchmarks")


def test_run_killed_in_each_stage_resumes_to_the_results_of_an_uninterrupted_one(done, changed, tmp_path):
    """As the cruise has results of other raw files, no older or half-written result is taken for a whole one."""
    folder, rounds = Path(shutil.copytree(changed, tmp_path / "c")), 0
    raw = hashes(folder / "raw")
    while (ran := snakemake(folder, drawn=False, first=KILLING)).returncode:
        rounds += 1
        assert rounds <= len(KILLED), ran.stderr
        if ran.returncode < 0:
            assert snakemake(folder, "--unlock").returncode == 0
    assert len(list((folder / "killed").iterdir())) == len(KILLED)
    assert products(folder) == products(done) and hashes(folder / "raw") == raw


def errors(ran: subprocess.CompletedProcess) -> list[str]:
    assert "Traceback" not in ran.stderr
    return [line for line in ran.stderr.splitlines() if line.startswith("error: ")]


def test_second_run_is_refused_and_a_lock_left_by_a_kill_is_removed_as_the_line_says(changed, tmp_path):
    folder = Path(shutil.copytree(changed, tmp_path / "c"))
    line = (
        f"error: {folder}: expected one run at a time, found the lock of another; wait until it has ended; if it was "
        f"killed: compass run {folder} -- --unlock"
    )
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    running = subprocess.Popen([*command(folder), "--cores", "1"], env=environment(), cwd=folder, **quiet)
    while not list((folder / ".snakemake/locks").glob("*.lock")):
        assert running.poll() is None
        time.sleep(0.01)
    assert snakemake(folder).stderr.splitlines() == [line]
    os.killpg(running.pid, signal.SIGKILL)
    running.wait()
    assert snakemake(folder).stderr.splitlines() == [line]
    assert snakemake(folder, "--unlock").returncode == 0
    assert snakemake(folder, "results/M1/work/top.nc").returncode == 0


@contextmanager
def mounted(folder: Path, *options: str, then: str) -> Iterator[None]:
    """Mount a file system on a folder, and mount it again with options; skip the test without the right to do so."""
    folder.mkdir(exist_ok=True)
    if shutil.which("mount") is None or subprocess.run(["mount", *options, folder], check=False).returncode:
        pytest.skip("no right to mount a file system")
    try:
        subprocess.run(["mount", "-o", f"remount,{then}", folder], check=True)
        yield
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)


def test_full_disk_is_reported_and_the_run_resumes_once_there_is_room(done, tmp_path):
    """The raw files are on a read-only file system."""
    folder = new_cruise(tmp_path / "c", 1)
    results, raw = folder / "results", folder / "raw"
    with mounted(raw, "--bind", raw, then="bind,ro"), mounted(results, "-t", "tmpfs", "tmpfs", then="size=300k"):
        ran = snakemake(folder, "results/M1/gridded.nc")
        assert ran.returncode == 1 and errors(ran)
        for line in errors(ran):
            assert ": expected room and the right to write it, found " in line
            assert line.endswith("; free some space or correct the permissions, and run again")
        subprocess.run(["mount", "-o", "remount,size=8m", results], check=True)
        assert snakemake(folder, "results/M1/gridded.nc").returncode == 0
        assert products(folder).items() < products(done).items()
