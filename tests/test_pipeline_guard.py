"""Safeguards of a run: measured files overwritten by a simulation, and settings or versions that no archive records."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from sea import cruise

from compasslib import __version__
from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN
from compasslib.config.cruise import load_cruise
from compasslib.errors import InputError
from compasslib.pipeline import guard
from compasslib.stages import simulate as stage

RAW = ["raw/EG1/top.000", "raw/EG1/deep.000"]
TRUTH = "truth/EG1.csv"


@pytest.fixture(autouse=True)
def there(tmp_path, monkeypatch):
    """Change into an empty cruise folder, and restore the environment that ``enter`` prepares for the jobs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guard.os, "environ", dict(guard.os.environ))
    monkeypatch.setattr(guard.sys, "path", [*guard.sys.path])
    return tmp_path


def enter(config: dict | None = None, version: str = __version__, *, is_module: bool = False) -> None:
    guard.enter(config or {}, version, is_module=is_module)


def test_rules_of_another_version_are_refused():
    with pytest.raises(InputError, match=rf"compasslib: expected version 0.9, as the rules, found {__version__}"):
        enter(version="0.9")


def test_settings_on_the_command_line_are_refused():
    enter({"without": "M1"})
    enter({"samples": "of the workflow that uses this one"}, is_module=True)
    with pytest.raises(InputError, match=r"--config: expected without, and other settings in .* found fit"):
        enter({"fit": "exact"})


@pytest.mark.parametrize("profile", ["default", "default/config.yaml", "profiles/default/config.v9+.yaml"])
def test_profile_in_a_cruise_folder_is_refused(profile):
    Path(profile).parent.mkdir(parents=True, exist_ok=True)
    Path(profile).write_text("forceall: true\n")
    with pytest.raises(InputError, match="default: expected no profile of Snakemake in a cruise folder"):
        enter()


def test_modules_are_not_imported_from_the_cruise_folder():
    guard.sys.path[:0] = ["", str(Path.cwd())]
    enter()
    assert not {"", str(Path.cwd())} & {*guard.sys.path} and guard.os.environ["PYTHONSAFEPATH"] == "1"


def test_only_own_incomplete_files_are_deleted(there):
    kept, half = [".hidden", ".DS_Store.1", ".corrected.nc.99", "notes.txt"], f".corrected.nc.99{HALF_WRITTEN}"
    for folder in (there / "results/M1", there / "other"):
        folder.mkdir(parents=True)
        for name in (*kept, half):
            (folder / name).write_text("x")
    (there / "results/linked").symlink_to(there / "other")
    guard.begin(pytest.fail)
    assert sorted(path.name for path in (there / "results/M1").iterdir()) == sorted(kept)
    assert sorted(path.name for path in (there / "other").iterdir()) == sorted([*kept, half])
    assert [path.name for path in (there / "results").iterdir() if path.is_file()] == []


def test_messages_at_the_end_name_warnings_and_killed_jobs():
    logs = Path("results/M1/logs")
    logs.mkdir(parents=True)
    for name, said in (("read_top", "M1 top: warning: no tilts"), ("fit", "error: mooring M1: no"), ("diagnose", "")):
        (logs / f"{name}.log").write_text(f"{said}\n")
    (logs / "read_top.json").write_text("{}")
    lines = guard.closing_lines()
    assert lines[:3] == ["Warnings: 1", "  M1 top: warning: no tilts", "Killed: 1"] and len(lines) == 4
    assert lines[3].startswith("  results/M1/logs/diagnose.log: killed before it could say why")
    assert guard.closing_lines(begun=2e10) == []


def test_moorings_are_left_out_with_all_of_their_instruments(there):
    loaded = load_cruise(cruise(there, ("M1", "M2"), n=5))
    parts = {"M1/top": loaded.moorings["M1"], "M1/mid": loaded.moorings["M1"], "M2": loaded.moorings["M2"]}
    several = SimpleNamespace(moorings=parts, whole={"M1": ["M1/top", "M1/mid"]}, calibrations={"bench": None})
    assert guard.left_out(loaded, {}) == {"moorings": [], "calibrations": []}
    both = {"moorings": ["M1/top", "M1/mid"], "calibrations": ["bench"]}
    assert guard.left_out(several, {"without": "M1,bench"}) == both
    assert guard.left_out(several, {"without": "M1/mid"})["moorings"] == ["M1/mid"]
    with pytest.raises(InputError, match="--config without: expected M1, M2, found M3"):
        guard.left_out(loaded, {"without": "M1,M3"})


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


def test_simulated_files_are_recognized_by_their_job_record():
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
def test_nothing_is_simulated_through_a_link(link):
    Path(link).parent.mkdir(parents=True, exist_ok=True)
    Path(link).symlink_to("nowhere")
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
