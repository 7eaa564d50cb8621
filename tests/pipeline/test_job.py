"""Would catch reasons that get lost, errors of many lines, settings that change on their way."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from snakemake.iocontainers import Namedlist

from compasslib.archive import files, netcdf, provenance
from compasslib.errors import InputError, TransientError, Unusable
from compasslib.pipeline.job import flatten, parameters, run_stage, unflatten

LOG, RECORD = Path("results/M1/logs/read.log"), Path("results/M1/logs/read.json")
MADE = {"record": "results/M1/work/top.nc", "field": "results/M1/work/field.json", "table": "results/M1/work/table.csv"}
DAMAGED = InputError("raw/a: line 2", expected="a number", found="two", advice="mend it")


@pytest.fixture(autouse=True)
def raw(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    LOG.parent.mkdir(parents=True)
    Path("raw").mkdir()
    Path("raw/a").write_text("measured")
    return Path("raw/a")


def run(act: Callable[[], object] = lambda: None, *, always_ends: bool = False, **settings: object) -> None:
    """Run a stage that writes its outputs and then acts, as the rule ``read`` of the mooring M1."""

    def stage(mooring: str, files, say, *, method: str = "") -> None:
        for path in (files.record, files.field, files.table):
            Path(path).parent.mkdir(exist_ok=True)
            Path(path).write_text(f"{mooring} {method}")
        say(f"{mooring} read from {files.raw}")
        act()

    given = {
        "input": Namedlist(fromdict={"raw": ["raw/a"]}),
        "output": Namedlist(fromdict={**MADE, "job": str(RECORD)}),
        "wildcards": Namedlist(fromdict={"mooring": "M1"}),
        "params": [None, *flatten(settings).values(), 'library="abc"'],
    }
    run_stage(SimpleNamespace(rule="read", log=[str(LOG)], **given), stage, always_ends=always_ends)


def failing(error: BaseException) -> Callable[[], object]:
    def act() -> None:
        raise error

    return act


def test_the_record_states_settings_and_hashes():
    run(method="exact", unknown=1)
    record = files.read_json(RECORD)
    assert (record["rule"], record["of"], record["library"]) == ("read", {"mooring": "M1"}, "abc")
    assert record["parameters"] == {"method": "exact", "unknown": 1} and record["software"] == provenance.software()
    assert record["read"] == provenance.hashes(["raw/a"]) and record["wrote"] == provenance.hashes(MADE.values())
    assert LOG.read_text() == "M1 read from ['raw/a']\n" and Path(MADE["table"]).read_text() == "M1 exact"


def test_reason_is_handed_on_in_place_of_data(capsys):
    run(failing(DAMAGED), always_ends=True)
    reason = {"stage": "read", "why": str(DAMAGED), "file": "raw/a", "advice": "mend it"}
    assert files.read_reason(MADE["field"]) == reason and Path(MADE["table"]).read_text() == ""
    assert capsys.readouterr().err == f"stopped: mooring M1: {DAMAGED}\n"
    assert LOG.read_text().splitlines()[-1] == f"error: mooring M1: {DAMAGED}"
    assert files.read_json(RECORD)["wrote"] == provenance.hashes(MADE.values())
    for read in (lambda: netcdf.read_record(MADE["record"]), lambda: files.read_json(MADE["field"])):
        with pytest.raises(Unusable) as caught:
            read()
        assert caught.value.reason == reason and str(caught.value) == reason["why"]
    run(failing(caught.value), always_ends=True)  # a later stage, which read one of these files
    assert files.read_reason(MADE["field"]) == reason


PROGRAM = "an error of this program in read, ZeroDivisionError: 1 by 0; report it, and make the pages of the cruise"
MEMORY = "read ran out of memory; run again with fewer --cores, so that fewer jobs share it, or on a larger machine"


ENDED = "an error of this program in read, SystemExit: 0; report it, and make the pages of the cruise"


@pytest.mark.parametrize(("error", "said"), [
    (DAMAGED, "raw/a: line 2: expected a number, found two; mend it"),
    (ZeroDivisionError("1\nby 0"), f"{PROGRAM} without it: --config without=M1"),
    (MemoryError(), MEMORY),
    (TransientError("results/x", expected="room", found="none", advice="free some"),
     "results/x: expected room, found none; free some"),
    (SystemExit(0), f"{ENDED} without it: --config without=M1"),
    (KeyboardInterrupt(), "read was interrupted; run again to take it up"),
])  # fmt: skip
def test_failed_job_says_why_in_one_line(capsys, error, said):
    """Only content that cannot be used is a reason to go on without it."""
    with pytest.raises(SystemExit) as caught:
        run(failing(error), always_ends=error is not DAMAGED)
    assert caught.value.code == 1 and not RECORD.exists() and Path(MADE["table"]).read_text() == "M1 "
    line = f"error: mooring M1: {said}"
    assert capsys.readouterr().err == f"{line}\n" and LOG.read_text().splitlines()[-1] == line
    assert ("Traceback" in LOG.read_text()) is isinstance(error, ZeroDivisionError | SystemExit)


SETTINGS = {"method": "a=b", "place": {"latitude": 66.5, "dates": [1, None]}, "empty": {}, "given": None}


def test_settings_are_the_same_after_their_way_through_texts():
    texts = flatten(SETTINGS)
    assert texts["place.latitude"] == "place.latitude=66.5" and texts["given"] == "given=null"
    assert unflatten(texts.values()) == SETTINGS


def test_exchanged_settings_differ_and_a_key_of_one_mooring_does_not_concern_others():
    """Snakemake compares the sets of values."""

    def values(settings: dict[str, dict], name: str) -> set[str | None]:
        made = parameters(lambda subject: settings[subject], [(subject,) for subject in settings])
        return {each([name]) if callable(each) else each for each in made.values()}

    before = {"M1": {"start": 1, "end": 2}, "M2": {"start": 1, "end": 2}}
    after = {"M1": {"start": 2, "end": 1}, "M2": {"start": 1, "end": 2, "more": 3}}
    third = {**after, "M1": before["M1"]}
    assert values(before, "M1") != values(after, "M1") and values(before, "M1") == values(third, "M1")
    assert values(before, "M2") != values(after, "M2")
