"""The campaign of mistakes: definitions of wrong, called good and new warnings; every attack changes a mooring."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

ATTACKS = Path(__file__).resolve().parents[1] / "benchmarks/attacks"
sys.path[:0] = [str(ATTACKS), str(ATTACKS.parent)]

import bases  # noqa: E402
import cases  # noqa: E402
import cruises  # noqa: E402
import harmless  # noqa: E402

del sys.path[:2]  # other modules of the tests have the same names

RIGHT = cruises.Outcome(rms_deg=1.0, covered=0.97, good=0.9, verdict="consistent", warnings=("a scatter of 3 degrees",))
FAR_OFF = replace(RIGHT, rms_deg=9.0, covered=0.5)
EVERY = [(kind, attack) for kind, several in cases.MISTAKES.items() for attack in dict.fromkeys(several)]
EVERY += [(cases.HARMLESS_KIND, attack) for attack in harmless.HARMLESS]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("bases")
    for base in bases.BASES:
        if base.water != "real":
            bases.write(replace(base, hours=1200), folder)
            (folder / f"{base.name}.declination.json").write_text('{"time_s": [0, 3e9], "declination_deg": [-12, -12]}')
    return folder


@pytest.mark.parametrize(("kind", "attack"), EVERY, ids=[f"{kind}-{attack.__name__}" for kind, attack in EVERY])
def test_attack_changes_the_files_of_a_mooring(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str, attack: cruises.Attack
) -> None:
    monkeypatch.setattr(bases, "REAL", kept / "none")
    case = cases.Case("x", kind, attack.__name__, 0, (1, 2), kind == cases.HARMLESS_KIND)
    cruise, done = cases.applied(case, kept, tmp_path)
    cruise.save()
    before, after = ({p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()} for f in _folders(cruise))
    assert done
    assert before != after
    assert b"&id" not in after[Path("config/moorings/M.yaml")]  # an alias, which the schema refuses


def _folders(cruise: cruises.Cruise) -> tuple[Path, Path]:
    return cruise.bases / cruise.base, cruise.folder


@pytest.mark.parametrize(
    ("changed", "wrong", "good"),
    [
        ({}, True, True),
        ({"rms_deg": 1.9}, False, False),
        ({"covered": 0.9}, False, False),
        ({"covered": 0.9, "far": 0.02}, True, True),
        ({"good": 0.4}, True, False),
        ({"good": 0.0, "rms_deg": float("nan")}, False, False),
        ({"refused": "no"}, False, False),
    ],
)
def test_outcomes_are_classified_as_wrong_and_called_good(changed: dict, wrong: bool, good: bool) -> None:
    outcome = replace(FAR_OFF, **changed)
    assert cruises.is_wrong(outcome, RIGHT) == wrong
    assert cruises.is_called_good(outcome, RIGHT) == good


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, []),
        ({"warnings": ("a scatter of 44.1 degrees",)}, []),
        ({"warnings": (*RIGHT.warnings, "the clocks differ")}, ["the clocks differ"]),
        ({"findings": ("heading_slip",)}, ["finding heading_slip"]),
        ({"verdict": "unexplained"}, ["verdict unexplained"]),
    ],
)
def test_new_warnings_exclude_those_of_the_original(changed: dict, said: list[str]) -> None:
    assert cruises.new_warnings(replace(FAR_OFF, **changed), RIGHT) == said


def test_larger_campaign_contains_the_smaller_one() -> None:
    few, many = ({case.name: case for case in cases.draw(count, count // 2, 5)} for count in (60, 300))
    assert len(many) == 450
    assert all(many[name] == case for name, case in few.items())
    attacks = {(case.kind, case.attack) for case in many.values() if case.base >= 0}
    assert attacks == {(kind, attack.__name__) for kind, attack in EVERY}


def test_changed_record_is_compared_with_its_own_truth(kept: Path, tmp_path: Path) -> None:
    cruise = cruises.Cruise.copy(kept, "text", tmp_path / "cruise")
    top, before = cruise.record(), cruise.truth_at(cruise.record().time_s)
    cruise.shift("top", 3600.0)
    assert np.array_equal(cruise.truth_at(top.time_s), before, equal_nan=True)
    top.turn(90.0)
    assert top.flow == pytest.approx(-1j * type(top)(cruise.path("top")).flow)
