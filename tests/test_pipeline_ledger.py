"""Recorded hashes decide: which files are made again, what a job may read, what no longer fits."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from compasslib.archive import provenance
from compasslib.errors import InputError, TransientError
from compasslib.pipeline import ledger

CHAIN = {
    "read": ("raw/a", "work/a.nc"),
    "overlap": ("work/a.nc", "overlap.nc"),
    "correct": ("overlap.nc", "corrected.nc"),
}
MADE = frozenset(f"results/M1/{made}" for _, made in CHAIN.values())


def place(name: str) -> str:
    return name if name.startswith("raw") else f"results/M1/{name}"


def record(rule: str, read: str, wrote: str) -> None:
    said = {"read": provenance.hashes([place(read)]), "wrote": provenance.hashes([place(wrote)])}
    Path(f"results/M1/logs/{rule}.json").write_text(json.dumps(said))


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
    known = ledger.seen()
    found = {path.removeprefix("results/M1/") for path in ledger.stale(MADE, ["M1"], known)}
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


def test_what_is_as_recorded_is_not_made_again_nor_hashed_again(chain, monkeypatch):
    assert stale() == set()
    monkeypatch.setattr(provenance, "sha256", lambda path: pytest.fail("looked at again"))
    assert stale() == set()


def test_a_flipped_byte_whose_time_was_set_back_is_seen_with_what_was_made_from_it(chain):
    stale()
    flip("results/M1/overlap.nc")
    assert stale() == {"overlap.nc", "corrected.nc"}


def test_a_raw_file_replaced_by_an_older_one_is_seen(chain):
    stale()
    Path("other").write_text("measured before")
    os.utime("other", (0, 0))
    os.replace("other", "raw/a")
    assert stale() == {"work/a.nc"}


def test_what_is_missing_or_without_record_is_made_again(chain):
    Path("results/M1/overlap.nc").unlink()
    assert stale() == {"overlap.nc", "corrected.nc"}
    record_of_last = Path("results/M1/logs/correct.json")
    record_of_last.write_text("{half")
    assert stale() == {"overlap.nc", "corrected.nc"}


def test_a_record_that_a_rule_of_another_name_left_does_not_count(chain):
    Path("results/M1/logs/old.json").write_text(json.dumps({"read": {}, "wrote": {"results/M1/overlap.nc": "0"}}))
    assert stale() == set()


def test_a_torn_line_of_the_memory_costs_a_second_look_and_no_more(chain):
    stale()
    whole = Path(ledger.SEEN).read_text()
    Path(ledger.SEEN).write_text(whole[: len(whole) // 2] + "\n\n1 2\n")
    assert stale() == set()


def test_the_memory_does_not_grow_with_every_run(chain, monkeypatch):
    monkeypatch.setattr(ledger, "MANY", 0)
    for _ in range(20):
        ledger.remember(ledger.seen().known)
        assert stale() == set()
    assert len(Path(ledger.SEEN).read_text().splitlines()) <= 3 * len(ledger.seen().known)


def test_an_input_that_is_not_what_its_job_wrote_is_refused_in_one_line(chain):
    good = ledger.looked_at(["results/M1/overlap.nc", "raw/a"])
    ledger.hold({path: digest for path, (_, digest) in good.items()})
    flip("results/M1/overlap.nc")
    bad = ledger.looked_at(["results/M1/overlap.nc"])
    with pytest.raises(
        TransientError, match=r"results/M1/overlap.nc: expected the file that its job wrote, found another"
    ):
        ledger.hold({path: digest for path, (_, digest) in bad.items()})


def test_a_file_that_changes_while_it_is_read_is_refused_and_one_touched_is_not(chain):
    before = ledger.looked_at(["raw/a"])
    os.utime("raw/a")
    ledger.unchanged(before)
    flip("raw/a")
    with pytest.raises(TransientError, match="raw/a: expected a file that stays as it is"):
        ledger.unchanged(before)


def test_a_raw_file_that_is_gone_is_an_error_of_the_input_and_a_result_that_is_gone_is_not(chain):
    with pytest.raises(InputError, match="raw/b: expected a file that can be read") as caught:
        ledger.looked_at(["raw/b"])
    assert not isinstance(caught.value, TransientError)
    with pytest.raises(TransientError):
        ledger.looked_at(["results/M1/nothing"])


def test_what_was_made_from_a_result_that_is_no_more_is_deleted_and_what_a_person_changed_stays(chain):
    Path("results/M1/notes.txt").write_text("mine")
    Path("results/M1/corrected.nc").write_text("edited by hand")
    Path("results/M1/work/a.nc").unlink()
    assert ledger.clear_orphans("M1") == ["results/M1/overlap.nc"]
    assert {path.name for path in Path("results/M1").iterdir()} == {"corrected.nc", "logs", "notes.txt", "work"}
    assert [path.name for path in Path("results/M1/logs").iterdir()] == ["read.json"]


def test_no_link_is_followed_when_orphans_are_deleted(chain, tmp_path):
    content = Path("results/M1/overlap.nc").read_bytes()
    (tmp_path / "elsewhere").write_bytes(content)
    Path("results/M1/overlap.nc").unlink()
    Path("results/M1/overlap.nc").symlink_to(tmp_path / "elsewhere")
    Path("results/M1/work/a.nc").unlink()
    ledger.clear_orphans("M1")
    assert (tmp_path / "elsewhere").read_bytes() == content and Path("results/M1/overlap.nc").is_symlink()


def test_results_as_recorded_but_dated_in_the_future_are_dated_anew_and_no_others(chain, tmp_path):
    now = os.stat("raw/a").st_mtime + 60.0
    for path in [*MADE, "raw/a"]:
        os.utime(path, (now + 1e6, now + 1e6))
    Path("results/M1/corrected.nc").write_text("edited by hand")
    os.utime("results/M1/corrected.nc", (now + 1e6, now + 1e6))
    restored = ledger.restore_times(["M1"], ledger.seen(), now)
    assert sorted(restored) == ["results/M1/overlap.nc", "results/M1/work/a.nc"]
    assert [os.stat(path).st_mtime for path in restored] == [now, now]
    assert ledger.is_future("raw/a", now) and ledger.is_future("results/M1/corrected.nc", now)
    assert stale() == {"corrected.nc"} and ledger.restore_times(["M1"], ledger.seen(), now) == []
