"""Job records: jobs to re-run by recorded hashes, inputs that may be read, and the inheritance of stops."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from compasslib.archive import provenance
from compasslib.errors import InputError, TransientError
from compasslib.pipeline import records

CHAIN = {
    "read": ("raw/a", "work/a.nc"),
    "overlap": ("work/a.nc", "overlap.nc"),
    "correct": ("overlap.nc", "corrected.nc"),
}
PATHS = [f"results/M1/logs/{rule}.json" for rule in CHAIN]


def place(name: str) -> str:
    return name if name.startswith("raw") else f"results/M1/{name}"


def record(rule: str, read: str, wrote: str) -> None:
    said = {"read": provenance.hashes([place(read)]), "wrote": provenance.hashes([place(wrote)])}
    made = {"rule": rule, "of": {"mooring": "M1"}, "stopped": None, **said}
    Path(f"results/M1/logs/{rule}.json").write_text(json.dumps(made))


@pytest.fixture
def chain(tmp_path, monkeypatch):
    """Create a mooring of three jobs, each of which wrote its input with its own name appended."""
    monkeypatch.chdir(tmp_path)
    for folder in ("raw", "results/M1/work", "results/M1/logs", ".snakemake"):
        Path(folder).mkdir(parents=True)
    Path("raw/a").write_text("measured")
    for rule, (read, wrote) in CHAIN.items():
        Path(place(wrote)).write_text(Path(place(read)).read_text() + rule)
        record(rule, read, wrote)


def stale() -> set[str]:
    known = records.read_hashes()
    found = {Path(path).stem for path in records.stale([*PATHS, "results/M1/logs/none.json"], known)}
    known.keep()
    return found


def flip(path: str) -> None:
    """Change one byte and restore the times of access and modification."""
    before = os.stat(path)
    content = bytearray(Path(path).read_bytes())
    content[0] ^= 1
    with open(path, "r+b") as stream:
        stream.write(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_unchanged_files_are_neither_rerun_nor_rehashed(chain, monkeypatch):
    assert stale() == set()
    monkeypatch.setattr(provenance, "sha256", lambda path: pytest.fail("looked at again"))
    assert stale() == set()


def test_changed_byte_with_restored_time_reruns_writer_and_reader(chain):
    stale()
    flip("results/M1/overlap.nc")
    assert stale() == {"overlap", "correct"}


def test_raw_file_replaced_by_an_older_one_is_detected(chain):
    stale()
    Path("other").write_text("measured before")
    os.utime("other", (0, 0))
    os.replace("other", "raw/a")
    assert stale() == {"read"}


def test_missing_results_and_invalid_records_are_rerun(chain):
    Path("results/M1/overlap.nc").unlink()
    assert stale() == {"overlap", "correct"}
    Path(PATHS[2]).write_text("{half")
    assert stale() == {"overlap", "correct"}
    older = json.loads(Path(PATHS[0]).read_text())
    del older["stopped"]
    Path(PATHS[0]).write_text(json.dumps(older))
    assert stale() == {"read", "overlap", "correct"}


def test_damaged_hash_cache_only_costs_rehashing(chain):
    stale()
    whole = Path(records.HASHES).read_text()
    Path(records.HASHES).write_text(whole[: len(whole) // 2] + "\n\n1 2\n")
    assert stale() == set()


def test_hash_cache_does_not_grow_with_every_run(chain, monkeypatch):
    monkeypatch.setattr(records, "MANY", 0)
    for _ in range(20):
        records.write_hashes(records.read_hashes().known)
        assert stale() == set()
    assert len(Path(records.HASHES).read_text().splitlines()) <= 3 * len(records.read_hashes().known)


def test_input_changed_since_its_job_is_refused(chain):
    known = records.load(PATHS[1])["wrote"]
    records.check_inputs(provenance.hashes(["results/M1/overlap.nc", "raw/a"]), known)
    flip("results/M1/overlap.nc")
    with pytest.raises(TransientError, match=r"results/M1/overlap.nc: expected the file that its job wrote"):
        records.check_inputs(provenance.hashes(["results/M1/overlap.nc"]), known)


def test_file_that_changes_while_read_is_refused(chain):
    before = records.sign(["raw/a"])
    os.utime("raw/a")
    records.check_unchanged(before)
    flip("raw/a")
    with pytest.raises(TransientError, match="raw/a: expected a file that stays as it is"):
        records.check_unchanged(before)


def test_missing_raw_file_is_an_input_error_unlike_a_result(chain):
    with pytest.raises(InputError, match="raw/b: expected a file that can be read") as caught:
        records.sign(["raw/b"])
    assert not isinstance(caught.value, TransientError)
    with pytest.raises(TransientError):
        records.sign(["results/M1/nothing"])


WHY = {"stage": "read", "why": "raw/a: expected b, found c; d", "file": "raw/a", "advice": "d"}


def stop(kind: str, name: str) -> records.Record:
    return {"of": {kind: name}, "stopped": WHY, "wrote": {}}


def test_stop_is_inherited_and_names_its_calibration():
    sound = {"of": {"mooring": "M1"}, "stopped": None, "wrote": {}}
    assert records.inherited([sound], "mooring", "M1") is None
    assert records.inherited([sound, stop("mooring", "M1")], "mooring", "M1") == WHY
    assert records.inherited([stop("calibration", "B")], "calibration", "B") == WHY
    by_another = records.inherited([stop("calibration", "B"), sound], "mooring", "M1")
    assert by_another == WHY | {"why": f"it needs calibration B, which was stopped: {WHY['why']}"}
    assert records.reasons([sound, stop("mooring", "M1")]) == {
        "moorings": {"M1": WHY["why"]},
        "calibrations": {},
        "compasses": {},
    }


def test_compass_stops_only_if_all_its_records_stopped():
    stops = [stop("mooring", "M1"), stop("calibration", "B")]
    sound = {"of": {"mooring": "M2"}, "stopped": None, "wrote": {}}
    assert records.inherited([*stops, sound], "compass", "C") is None
    assert records.inherited(stops, "compass", "C") == WHY
    assert records.inherited(stops, "", "") is None


def test_unchanged_results_dated_in_the_future_are_redated(chain):
    now = os.stat("raw/a").st_mtime + 60.0
    wrote = [place(made) for _, made in CHAIN.values()]
    for path in [*wrote, "raw/a"]:
        os.utime(path, (now + 1e6, now + 1e6))
    Path("results/M1/corrected.nc").write_text("edited by hand")
    os.utime("results/M1/corrected.nc", (now + 1e6, now + 1e6))
    restored = records.restore_times(PATHS, records.read_hashes(), now)
    assert sorted(restored) == ["results/M1/overlap.nc", "results/M1/work/a.nc"]
    assert [os.stat(path).st_mtime for path in restored] == [now, now]
    assert records.is_future("raw/a", now) and records.is_future("results/M1/corrected.nc", now)
    assert stale() == {"correct"} and records.restore_times(PATHS, records.read_hashes(), now) == []


@pytest.mark.parametrize("earlier", [{}, {"said": [], "stopped": None}, {"said": 1, "stopped": None, "wrote": 2}])
def test_job_with_an_incomplete_record_is_rerun(earlier):
    now = {"rule": "fit", "of": {}, "code": "a", "parameters": {}, "read": {}}
    assert not records.holds(earlier, now, [])
    assert records.holds(now | {"said": [], "stopped": None, "wrote": {}}, now, [])
