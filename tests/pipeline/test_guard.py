"""Would catch measured files overwritten by a simulation, and settings or versions that no archive records."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest

from compasslib import __version__
from compasslib.archive import provenance
from compasslib.archive.files import HALF_WRITTEN
from compasslib.errors import InputError
from compasslib.pipeline import guard

RAW = ["raw/EG1/top.000", "raw/EG1/deep.000"]
TRUTH = "truth/EG1.csv"


@pytest.fixture(autouse=True)
def there(tmp_path, monkeypatch):
    """Change into an empty cruise folder, and restore the environment that ``enter`` prepares for the jobs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guard.os, "environ", dict(guard.os.environ))
    return tmp_path


@pytest.mark.parametrize(("config", "version", "line"), [
    ({"without": "M1"}, "0.9", f"compasslib: expected version 0.9, as the rules, found {__version__}"),
    ({"fit": "exact"}, __version__, "--config: expected without, and other settings in .* found fit"),
])  # fmt: skip
def test_another_version_and_settings_of_the_command_line_are_refused(config, version, line):
    guard.enter({"without": "M1"}, __version__, is_module=False)
    guard.enter({"samples": "of the workflow that uses this one"}, __version__, is_module=True)
    with pytest.raises(InputError, match=line):
        guard.enter(config, version, is_module=False)


def test_only_own_incomplete_files_are_deleted(there):
    kept, half = [".DS_Store.1", ".corrected.nc.99", "notes.txt"], f".corrected.nc.99{HALF_WRITTEN}"
    for name in (*kept, half):
        put(f"results/M1/{name}")
        put(f"other/{name}")
    (there / "results/linked").symlink_to(there / "other")
    guard.delete_incomplete()
    assert sorted(path.name for path in (there / "results/M1").iterdir()) == sorted(kept)
    assert (there / "other" / half).exists() and not list((there / "results").glob(f".begun*{HALF_WRITTEN}"))


def test_messages_at_the_end_name_warnings_and_killed_jobs():
    for name, said in (("read_top", "M1 top: warning: no tilts"), ("fit", "error: mooring M1: no"), ("diagnose", "")):
        put(f"results/M1/logs/{name}.log", said)
    put("results/M1/logs/read_top.json", "{}")
    lines = guard.closing_text().splitlines()
    assert lines[:3] == ["Warnings: 1", "  M1 top: warning: no tilts", "Killed: 1"] and len(lines) == 4
    assert lines[3].startswith("  results/M1/logs/diagnose.log: killed before it could say why")
    assert guard.closing_text(started_s=2e10) == ""


def test_moorings_are_left_out_with_all_of_their_instruments():
    parts = ["M1/top", "M1/mid"]
    cruise = SimpleNamespace(
        moorings=dict.fromkeys([*parts, "M2"]), whole={"M1": parts, "M2": ["M2"]}, calibrations=["b"]
    )
    assert guard.left_out(cruise, {}) == {"moorings": [], "calibrations": []}
    assert guard.left_out(cruise, {"without": "M1,b"}) == {"moorings": parts, "calibrations": ["b"]}
    assert guard.left_out(cruise, {"without": "M1/mid"})["moorings"] == ["M1/mid"]
    with pytest.raises(InputError, match=r"--config without: expected .* found M3"):
        guard.left_out(cruise, {"without": "M1,M3"})


def demonstration(files: dict[str, list[str]], *, on: bool = True) -> SimpleNamespace:
    """Return a stand-in for a cruise with the attributes that the guard uses."""
    made = {
        name: SimpleNamespace(instruments={"top": SimpleNamespace(files=listed, pressure_files=[])})
        for name, listed in files.items()
    }
    return SimpleNamespace(options=SimpleNamespace(demonstration=on), moorings=made)


def may_write() -> bool:
    return "EG1" in guard.to_simulate(demonstration({"EG1": RAW}))


def simulate(content: str) -> None:
    """Write the simulated files and their record, as the job does."""
    for file in [*RAW, TRUTH]:
        put(file, content + file)
    put("results/EG1/logs/simulate.json", json.dumps({"read": {}, "wrote": provenance.hashes([*RAW, TRUTH])}))


def put(file: str, content: str = "measured") -> None:
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    Path(file).write_text(content)


def test_only_a_demonstration_is_simulated_and_may_write_new_files_and_its_own():
    assert guard.to_simulate(demonstration({"EG1": RAW}, on=False)) == {}
    assert may_write()
    for content in ("simulated", "by another seed"):
        simulate(content)
        assert may_write() and Path(RAW[0]).read_text() == f"{content}{RAW[0]}"


def test_complete_measured_files_are_only_read_unless_a_record_says_that_they_are_simulated():
    for file in RAW:
        put(file)
    assert not may_write()
    put("results/EG1/logs/simulate.json", json.dumps({"read": {}, "wrote": provenance.hashes(RAW)}))
    assert may_write()
    put(RAW[0], "edited")
    assert not may_write()


@pytest.mark.parametrize("taken", [*RAW, TRUTH])
def test_measured_file_is_never_overwritten(taken):
    put(taken)
    with pytest.raises(InputError, match=f"{taken}: expected what the simulation wrote, or nothing"):
        may_write()
