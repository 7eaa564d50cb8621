"""Safeguards of a run: it follows no links, and deletes or overwrites only files that are provably its own."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN
from compasslib.errors import InputError
from compasslib.pipeline import guard
from compasslib.stages import simulate as stage

RAW = ["raw/EG1/top.000", "raw/EG1/deep.000"]
TRUTH = "truth/EG1.csv"


@pytest.fixture(autouse=True)
def there(tmp_path, monkeypatch):
    """Create an empty cruise folder next to another cruise, and change into it."""
    for folder in ("cruise/.snakemake", "cruise/results/M1/logs", "other/config", "other/results", "scratch"):
        (tmp_path / folder).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "cruise")
    return tmp_path


@pytest.mark.parametrize(
    "path",
    [
        *(f"results{below}" for below in ("", "/M1", "/M1/logs", "/M1/work", "/logs", "/calibrations")),
        ".snakemake/locks",
    ],
)
def test_a_link_where_results_are_written_is_refused(there, path):
    place = Path(path)
    place.rename(there / "moved") if place.exists() else place.parent.mkdir(exist_ok=True)
    place.symlink_to(there / "other/results")
    with pytest.raises(InputError, match=f"{path}: expected no link where results are written"):
        guard.refuse_links(["results/M1"])


def test_links_to_raw_files_and_settings_are_allowed(there):
    for name in ("raw", "config"):
        Path(name).symlink_to(there / "other")
    Path("results/latest").symlink_to("M1")
    guard.refuse_links(["results/M1", "results/M2", "results/calibrations/C1"])


def test_results_may_link_to_a_folder_outside_any_cruise(there):
    Path("results").rename(there / "scratch/results")
    Path("results").symlink_to(there / "scratch/results")
    guard.refuse_links(["results/M1"])


def test_only_own_incomplete_files_are_swept(there):
    kept = [".hidden", ".DS_Store.1", ".corrected.nc.99", "notes.txt", "0.input.lock"]
    half = f".corrected.nc.99{HALF_WRITTEN}"
    for name in (*kept, half):
        Path("results/M1", name).write_text("x")
        (there / "other" / name).write_text("x")
    Path("results/M1/link").symlink_to(there / "other")
    Path(f"results/M1/.linked.nc.9{HALF_WRITTEN}").symlink_to(there / "other/notes.txt")
    guard.sweep()
    assert not Path("results/M1", half).exists() and all(Path("results/M1", name).exists() for name in kept)
    assert {path.name for path in (there / "other").iterdir()} >= {*kept, half}


def demonstration(files: dict[str, list[str]], *, on: bool = True) -> SimpleNamespace:
    """Return a stand-in for a cruise with the attributes that the guard uses."""
    made = {
        name: SimpleNamespace(instruments={"top": SimpleNamespace(files=listed, pressure_files=[])})
        for name, listed in files.items()
    }
    there = {name: f"config/moorings/{name}.yaml" for name in files}
    return SimpleNamespace(options=SimpleNamespace(demonstration=on), moorings=made, mooring_files=there)


def may_write() -> bool:
    return "EG1" in guard.to_simulate(demonstration({"EG1": RAW}))


def simulate(content: str = "simulated", stop_after: int = 3) -> None:
    """Write the simulated files, or only the first ``stop_after`` as if the job was killed."""
    for file in [*RAW, TRUTH]:
        Path(file).unlink(missing_ok=True)  # as Snakemake does before a job
    with stage.put("EG1", [*RAW, TRUTH][:stop_after]) as folder:
        for file in [*RAW, TRUTH]:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(content + file)


def put(file: str, content: str = "measured") -> None:
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_text(content)


def test_nothing_is_simulated_outside_a_demonstration():
    assert guard.to_simulate(demonstration({"EG1": RAW}, on=False)) == {}


def test_simulation_may_write_new_files_and_its_own():
    assert may_write()
    simulate()
    assert may_write() and Path(RAW[0]).read_text() == f"simulated{RAW[0]}"
    simulate("by another seed")
    assert may_write()


def test_killed_simulation_recognizes_its_files():
    simulate(stop_after=1)
    assert Path(RAW[0]).exists() and not Path(RAW[1]).exists()
    assert may_write()


def test_simulated_files_are_recognized_by_their_job_record(there):
    for file in RAW:
        put(file)
    Path("results/EG1/logs").mkdir(parents=True)
    Path("results/EG1/logs/simulate.json").write_text(json.dumps({"read": {}, "wrote": provenance.hashes(RAW)}))
    assert may_write()


@pytest.mark.parametrize("taken", [RAW[0], RAW[1], TRUTH])
def test_measured_file_is_never_overwritten(taken):
    put(taken)
    with pytest.raises(InputError, match=f"{taken}: expected what the simulation wrote, or nothing"):
        may_write()


def test_edited_simulated_file_counts_as_measured():
    simulate()
    put(RAW[0], "edited")
    assert not may_write()  # all files exist and are read as they are
    Path(RAW[1]).unlink()
    with pytest.raises(InputError, match="measured files are never written over"):
        may_write()


def test_complete_measured_files_are_only_read():
    for file in RAW:
        put(file)
    assert not may_write()


def test_file_name_in_another_case_counts_as_the_file():
    put("raw/EG1/TOP.000")
    with pytest.raises(InputError, match=r"raw/EG1/top.000: expected what the simulation wrote"):
        may_write()


@pytest.mark.parametrize("link", ["raw", "raw/EG1", RAW[0], "truth"])
def test_nothing_is_simulated_through_a_link(there, link):
    Path(link).parent.mkdir(parents=True, exist_ok=True)
    Path(link).symlink_to(there / "other" / "leads/nowhere")
    with pytest.raises(InputError, match="expected what the simulation wrote, or nothing, found a file or link"):
        may_write()


def test_file_shared_by_two_moorings_is_refused():
    with pytest.raises(InputError, match=r"EG2.yaml: raw/EG1/top.000: expected a file of one simulated mooring"):
        guard.to_simulate(demonstration({"EG1": RAW, "EG2": RAW[:1]}))


def test_unrequested_simulated_file_is_not_written():
    put(RAW[1])
    with stage.put("EG1", RAW[:1]) as folder:
        for file in RAW:
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text("simulated")
    assert Path(RAW[0]).read_text() == "simulated" and Path(RAW[1]).read_text() == "measured"
    assert [path.name for path in Path("raw").iterdir()] == ["EG1"]


def test_input_dated_in_the_future_is_refused(there):
    put(RAW[0])
    now = guard.file_clock()
    assert os.stat(RAW[0]).st_mtime <= now and not list(Path(".snakemake").iterdir())
    guard.refuse_future([*RAW, "."], now)
    os.utime(RAW[0], (now + 3600.0, now + 3600.0))
    with pytest.raises(InputError, match=rf"{RAW[0]}: expected a date of change before now.*touch {RAW[0]}$"):
        guard.refuse_future(RAW, now)


def test_read_only_output_is_refused(there, monkeypatch):
    put("results/M1/work/top.nc")
    outputs = ["results/M1/work/top.nc", "results/M2/new/overlap.nc"]
    guard.refuse_read_only(outputs)
    for place in ("results/M1/work/top.nc", "results/M1/work", "results"):
        monkeypatch.setattr(os, "access", lambda path, mode, place=place: path != place)
        with pytest.raises(InputError, match=f"^{place}: expected the right to write here, found no right to write"):
            guard.refuse_read_only(outputs)
