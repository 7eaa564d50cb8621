"""The sealed proof: locks that hold, scores that mean something, and the same card for the same seed."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.proof import __main__ as command
from benchmarks.proof import measure, recordings, score, seal, tally
from compasslib.simulation import draw

HOURS, SEED = 1300, 3
FILES = ("scorecard.json", "scorecard.md", "scorecard.html", "seal.json", "left.json")


def truth(kind: str, *names: str, rivals: tuple[str, ...] = ()) -> dict:
    effects = [{"name": name, "visible_deg": 2.0, "parameters": {}} for name in names]
    errors = {"background_deg": 0.1, "five_deg": 1.0, "oracle_deg": 0.5}
    return {"kind": kind, "effects": effects, "rivals": list(rivals), "wide": True, **errors}


def said(*sets: tuple[str, ...], left: bool = False) -> dict:
    findings = [{"effect": one[0], "alternatives": list(one[1:]), "parameters": {}} for one in sets]
    unexplained = {"where": {"text": "along time"}, "rms_effect_deg": 1.0} if left else None
    verdict = "unexplained" if left else "explained" if sets else "consistent"
    return {"verdict": verdict, "findings": findings, "unexplained": unexplained}


TRUTHS = [
    truth("null"), truth("noisy"), truth("strange", "teeth"), truth("shifted", "temperature"),
    truth("single", "heeling"), truth("pair", "heeling", "temperature"), truth("undecidable", "field_disturbance"),
    truth("undecidable", "supply_voltage", rivals=("compass_drift", "hard_iron_drift")),
]  # fmt: skip


@pytest.fixture(scope="module")
def proofs(tmp_path_factory):
    """Two proofs by one seed in two places: two short moorings each, nothing else."""
    folders = []
    for _ in range(2):
        folder = tmp_path_factory.mktemp("proof")
        places = ["--work", str(folder / "work"), "--out", str(folder / "out"), "--no-published", "--no-recordings"]
        given = ["--seed", str(SEED), "--count", "2", "--hours", str(HOURS), *places]
        assert command.main(given) == 0
        folders.append(folder)
    return folders


def test_the_same_seed_gives_the_same_card(proofs):
    for file in FILES:
        first, second = ((folder / "out" / file).read_bytes() for folder in proofs)
        assert first == second, file
    card = json.loads((proofs[0] / "out/scorecard.json").read_text())
    assert [row["name"] for row in card["moorings"]] == ["P001", "P002"]
    assert {row["kind"] for row in card["moorings"]} == {"null", "single"}
    assert all(row["oracle_deg"] < 1.0 < row["recorded_deg"] for row in card["moorings"])
    quiet, _ = sorted(card["moorings"], key=lambda row: row["kind"])
    # Nothing to take out: the same fit made again, from where it ended.
    assert quiet["sampled_deg"] == pytest.approx(quiet["before_deg"], abs=0.02)


def scored(folder: Path) -> dict:
    return command.write(folder / "out", folder / "work/cruise", folder / "work/locked")


def changed(path: Path, before: str, after: str) -> str:
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    return text


@pytest.mark.parametrize(
    ("path", "key", "match"),
    [
        ("work/locked/P001.json", '"kind"', r"sealed before the run: P001\.json"),
        ("work/cruise/results/P002/diagnosis.json", '"verdict"', r"the pipeline left: results/P002/diagnosis\.json"),
    ],
)
def test_a_changed_truth_and_an_edited_verdict_are_refused(proofs, path, key, match):
    text = changed(proofs[0] / path, key, key + " ")
    with pytest.raises(seal.Broken, match=match):
        scored(proofs[0])
    (proofs[0] / path).write_text(text)
    scored(proofs[0])


def test_a_changed_list_and_an_absent_file_are_refused(tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    (folder / "a").write_text("one")
    seal.publish(tmp_path / "seal.json", folder, folder.iterdir(), seed=1)
    seal.check(tmp_path / "seal.json", folder, "changed")
    text = changed(tmp_path / "seal.json", '"sha256": "', '"sha256": "0')
    with pytest.raises(seal.Broken, match="does not give its own hash"):
        seal.check(tmp_path / "seal.json", folder, "changed")
    (tmp_path / "seal.json").write_text(text)
    (folder / "a").unlink()
    with pytest.raises(seal.Broken, match="changed: a"):
        seal.check(tmp_path / "seal.json", folder, "changed")


def test_a_perfect_tool_scores_perfectly_and_the_silly_ones_badly():
    assert score.mean_points(TRUTHS, score.perfect) == 1.0
    assert all(score.judge(one, score.perfect(one)) in ("right", "in the set") for one in TRUTHS)
    assert score.mean_points(TRUTHS, score.always_unexplained) < 0.5
    assert score.mean_points(TRUTHS, score.whole_catalogue) < 0.1


@pytest.mark.parametrize(
    ("true", "diagnosis", "outcome", "points"),
    [
        (truth("null"), said(), "right", 1.0),
        (truth("null"), said(("heeling",)), "false name", 0.0),
        (truth("noisy"), said(left=True), "false alarm", 0.0),
        (truth("single", "heeling"), said(("heeling",)), "right", 1.0),
        (truth("single", "heeling"), said(("temperature", "heeling")), "in the set", 0.5),
        (truth("single", "heeling"), said(("heeling",), ("octantal",)), "one too many", 0.5),
        (truth("single", "heeling"), said(("octantal",)), "wrong name", 0.0),
        (truth("single", "heeling"), said(left=True), "unexplained", 0.0),
        (truth("single", "heeling"), said(), "missed", 0.0),
        (truth("pair", "heeling", "temperature"), said(("heeling",)), "half", 0.5),
        (truth("strange", "teeth"), said(("octantal",)), "bare name", 0.0),
        (truth("strange", "teeth"), said(("composed", "composed:lobe4/time/box")), "right", 1.0),
        (truth("strange", "teeth"), said(("octantal",), left=True), "name beside", 0.5),
        (truth("undecidable", "supply_voltage"), said(("supply_voltage",)), "guessed", 0.0),
        (truth("undecidable", "supply_voltage"), said(("supply_voltage", "compass_drift")), "right", 1.0),
        (truth("undecidable", "field_disturbance"), said(("temperature",)), "wrong name", 0.0),
    ],
)
def test_verdicts_are_judged(true, diagnosis, outcome, points):
    assert score.judge(true, diagnosis) == outcome
    assert score.points(true, diagnosis) == pytest.approx(points)


def test_errors_of_parameters_dates_and_gain():
    true = truth("single", "hard_iron_step")
    true["effects"][0]["parameters"] = {"b_x_nT": 400.0, "date_s": 1.0e9}
    diagnosis = said(("hard_iron_step",))
    diagnosis["findings"][0] |= {
        "parameters": {"b_x_nT": {"value": 460.0, "sigma": 30.0}},
        "when": {"from": "2001-09-10T01:46:40Z", "to": "2002-01-01T00:00:00Z"},  # a day after 1e9 s
        "heldout": {"rms_before_deg": 10.0, "rms_after_deg": 9.9},
    }
    row = score.row(
        "P001", true, diagnosis, {"before_deg": 2.0, "after_deg": 0.7, "sampled_deg": 0.3, "covered_95": 0.9}
    )
    assert row["z"] == {"hard_iron_step.b_x_nT": 2.0} and row["dates_d"] == [1.0]
    assert row["gain"] == pytest.approx((10.0**2 - 9.9**2) / 2.0**2)
    numbers = tally.numbers([row])
    found = numbers["headings"]["effects of the catalogue"]
    assert found["near_oracle"] == 1.0 and found["near_sampled"] == 0.0


def test_intervals_are_those_of_clopper_and_pearson():
    assert score.limits(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)  # their tables
    assert score.limits(3, 10) == pytest.approx((0.0667, 0.6525), abs=1e-4)
    assert score.limits(10, 10)[1] == 1.0


def test_a_proof_is_drawn_in_the_promised_shares():
    drawn = draw.draw(1, 200)
    kinds = [one.kind for one in drawn]
    assert sum(kinds.count(kind) for kind in score.QUIET) == 50
    assert kinds.count("undecidable") == 20 and kinds.count("strange") + kinds.count("shifted") == 40
    assert {name for one in drawn for name in one.wanted} >= {*draw.SINGLES, *draw.UNNAMED}
    sizes = [size for one in drawn if one.kind == "single" for size in one.wanted.values()]
    assert min(sizes) >= 0.7 and max(sizes) <= 4.0
    assert draw.draw(1, 200) == drawn != draw.draw(2, 200)


def test_a_reading_is_turned_back_by_the_coefficients_that_made_it():
    letters = dict(zip("ABCDE", (0.02, 0.3, -0.2, 0.03, 0.01), strict=True))
    heading = np.arange(0.0, 360.0, 7.0)
    w = np.exp(1j * np.deg2rad(heading))
    q = (1 - 0.02j) * w + 0.3 + 0.2j + (0.03 - 0.01j) / w
    found = measure.corrected_by(letters, np.rad2deg(np.angle(q)), heading + 5.0)
    assert np.abs(measure.turn(found, heading)).max() < 1e-6


def test_only_drawing_knows_the_world_and_the_scorer_only_files():
    folder = Path(command.__file__).parent
    for path in folder.glob("*.py"):
        used = set(re.findall(r"^(?:from|import) (compasslib[.\w]*)", path.read_text(), re.MULTILINE))
        # The fit of the mooring without effects is by definition the library's own.
        knowing = {"__main__": "compasslib.simulation", "figures": "compasslib.plots.page", "sampled": "compasslib"}
        allowed = knowing.get(path.stem)
        assert all(allowed is not None and name.startswith(allowed) for name in used), path.name


def test_recordings_say_why_they_are_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr(recordings, "DATA", tmp_path)
    lines = {line[0]: line for line in recordings.rows(tmp_path)}
    assert "absent" in lines["E0"][-1] and "absent" in lines["signature500"][-1]
    assert all(len(line) == len(recordings.COLUMNS) for line in lines.values())
