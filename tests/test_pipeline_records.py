"""Recorded hashes decide: which jobs run again, what a job may read, what a stopped one leaves."""

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
    """A mooring of three jobs, each of which wrote what it had read and its name."""
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
    """Change one byte and set the times back, as far as anybody can."""
    before = os.stat(path)
    content = bytearray(Path(path).read_bytes())
    content[0] ^= 1
    with open(path, "r+b") as stream:
        stream.write(content)
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))


def test_what_is_as_recorded_does_not_run_again_nor_is_it_hashed_again(chain, monkeypatch):
    assert stale() == set()
    monkeypatch.setattr(provenance, "sha256", lambda path: pytest.fail("looked at again"))
    assert stale() == set()


def test_a_flipped_byte_whose_time_was_set_back_is_seen_by_who_wrote_and_who_reads_it(chain):
    stale()
    flip("results/M1/overlap.nc")
    assert stale() == {"overlap", "correct"}


def test_a_raw_file_replaced_by_an_older_one_is_seen(chain):
    stale()
    Path("other").write_text("measured before")
    os.utime("other", (0, 0))
    os.replace("other", "raw/a")
    assert stale() == {"read"}


def test_what_is_missing_and_a_record_that_is_damaged_or_of_an_earlier_version_run_again(chain):
    Path("results/M1/overlap.nc").unlink()
    assert stale() == {"overlap", "correct"}
    Path(PATHS[2]).write_text("{half")
    assert stale() == {"overlap", "correct"}
    older = json.loads(Path(PATHS[0]).read_text())
    del older["stopped"]
    Path(PATHS[0]).write_text(json.dumps(older))
    assert stale() == {"read", "overlap", "correct"}


def test_a_torn_line_of_the_memory_costs_a_second_look_and_no_more(chain):
    stale()
    whole = Path(records.HASHES).read_text()
    Path(records.HASHES).write_text(whole[: len(whole) // 2] + "\n\n1 2\n")
    assert stale() == set()


def test_the_memory_does_not_grow_with_every_run(chain, monkeypatch):
    monkeypatch.setattr(records, "MANY", 0)
    for _ in range(20):
        records.write_hashes(records.read_hashes().known)
        assert stale() == set()
    assert len(Path(records.HASHES).read_text().splitlines()) <= 3 * len(records.read_hashes().known)


def test_an_input_that_is_not_what_its_job_wrote_is_refused_in_one_line(chain):
    known = records.load(PATHS[1])["wrote"]
    records.check_inputs(provenance.hashes(["results/M1/overlap.nc", "raw/a"]), known)
    flip("results/M1/overlap.nc")
    with pytest.raises(TransientError, match=r"results/M1/overlap.nc: expected the file that its job wrote"):
        records.check_inputs(provenance.hashes(["results/M1/overlap.nc"]), known)


def test_a_file_that_changes_while_it_is_read_is_refused_and_one_touched_is_not(chain):
    before = records.sign(["raw/a"])
    os.utime("raw/a")
    records.check_unchanged(before)
    flip("raw/a")
    with pytest.raises(TransientError, match="raw/a: expected a file that stays as it is"):
        records.check_unchanged(before)


def test_a_raw_file_that_is_gone_is_an_error_of_the_input_and_a_result_that_is_gone_is_not(chain):
    with pytest.raises(InputError, match="raw/b: expected a file that can be read") as caught:
        records.sign(["raw/b"])
    assert not isinstance(caught.value, TransientError)
    with pytest.raises(TransientError):
        records.sign(["results/M1/nothing"])


WHY = {"stage": "read", "why": "raw/a: expected b, found c; d", "file": "raw/a", "advice": "d"}


def stop(kind: str, name: str) -> records.Record:
    return {"of": {kind: name}, "stopped": WHY, "wrote": {}}


def test_a_stop_is_passed_on_and_names_the_calibration_that_it_comes_from():
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


def test_a_compass_stops_with_the_last_of_its_records_and_the_cruise_never():
    stops = [stop("mooring", "M1"), stop("calibration", "B")]
    sound = {"of": {"mooring": "M2"}, "stopped": None, "wrote": {}}
    assert records.inherited([*stops, sound], "compass", "C") is None
    assert records.inherited(stops, "compass", "C") == WHY
    assert records.inherited(stops, "", "") is None


def test_results_as_recorded_but_dated_in_the_future_are_dated_anew_and_no_others(chain):
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
def test_a_job_whose_record_is_damaged_is_run_again(earlier):
    now = {"rule": "fit", "of": {}, "code": "a", "parameters": {}, "read": {}}
    assert not records.holds(earlier, now, [])
    assert records.holds(now | {"said": [], "stopped": None, "wrote": {}}, now, [])
