"""Would catch a changed truth that is scored, wrong points for a verdict, a resumed proof with another scorecard."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import targets
from benchmarks.proof import run, score, seal, tally
from benchmarks.proof.world import compass, draw, families, records, scene, seas
from compasslib.effects import SIDES

HOURS, SEED = 500, 3
FILES = ("scorecard.json", "scorecard.md", "targets.csv", "every_mooring.csv", "seal.json", "left.json")


def truth(kind: str, *names: str, rivals: tuple[str, ...] = (), real: bool = False) -> dict:
    named = kind not in score.UNNAMED
    effects = [{"name": f"a {name}", "right": [name] * named, "side": "compass", "visible_deg": 2.0} for name in names]
    errors = {"background_deg": 0.1, "five_deg": 1.0, "oracle_deg": 0.5}
    where = {"wide": True, "water": "made", "real": real, "stands_in": False}
    return {"kind": kind, "effects": effects, "rivals": list(rivals), **where, **errors}


def said(*sets: tuple[str, ...], left: bool = False, side: str = "compass") -> dict:
    found = score.said(*map(list, sets), left=left)
    for one in found["findings"]:
        one["side"] = side
        if one["effect"].startswith("composed:"):
            parts = one["effect"].removeprefix("composed:").split("/")
            one |= {"effect": "composed", "composition": dict(zip(("acts_on", "driver", "form"), parts, strict=True))}
    return found


TRUTHS = [
    truth("null"), truth("noisy"), truth("mirrored", real=True), truth("strange", "teeth"),
    truth("shifted", "temperature"), truth("single", "heeling"), truth("pair", "heeling", "temperature"),
    truth("undecidable", "field_disturbance"),
    truth("undecidable", "supply_voltage", rivals=("compass_drift", "hard_iron_drift")),
]  # fmt: skip


@pytest.fixture(scope="module")
def proof(tmp_path_factory):
    """Run a proof of two short moorings, in this process."""
    folder = tmp_path_factory.mktemp("proof")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "each", lambda job, names, *_: [job(name) for name in names])
        assert run.main(asked(folder)) == 0
    return folder


def asked(folder: Path) -> list[str]:
    places = ["--work", str(folder / "work"), "--out", str(folder / "out"), "--data", str(folder / "none")]
    return ["--seed", str(SEED), "--count", "2", "--cores", "1", "--hours", str(HOURS), *places]


def test_interrupted_run_resumes_with_the_same_scorecard(proof):
    before = {file: (proof / "out" / file).read_bytes() for file in FILES}
    for kept in ("results/P002", "locked/P002.json"):  # as if killed while drawing and running
        path = proof / "work" / kept
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    (proof / "work/sealed").unlink()
    assert run.main(asked(proof)) == 0
    assert {file: (proof / "out" / file).read_bytes() for file in FILES} == before
    card = json.loads((proof / "out/scorecard.json").read_text())
    assert [row["name"] for row in card["moorings"]] == ["P001", "P002"]
    assert all(row["oracle_deg"] < 1.0 < row["recorded_deg"] for row in card["moorings"])
    assert card["seal"]["seed_of"] == "chosen by hand"
    quiet = [row for row in card["moorings"] if row["kind"] == "null"]
    # No effect to remove: the fit is repeated from its own optimum.
    assert all(row["sampled_deg"] == pytest.approx(row["before_deg"], abs=0.03) for row in quiet)


def scored(folder: Path) -> dict:
    return run.write(folder / "out", folder / "work")


def changed(path: Path, before: str, after: str) -> str:
    text = path.read_text()
    assert before in text
    path.write_text(text.replace(before, after))
    return text


@pytest.mark.parametrize(
    ("path", "key", "match"),
    [
        ("work/locked/P001.json", '"kind"', r"sealed before the run: P001\.json"),
        ("work/results/P002/diagnosis.json", '"verdict"', r"the pipeline left: results/P002/diagnosis\.json"),
    ],
)
def test_changed_truth_or_result_is_refused(proof, path, key, match):
    text = changed(proof / path, key, key + " ")
    with pytest.raises(seal.Broken, match=match):
        scored(proof)
    (proof / path).write_text(text)
    scored(proof)


def test_perfect_tool_scores_one_and_blind_tools_low():
    diagnoses = {str(k): said(("heeling",)) for k in range(len(TRUTHS))}
    truths = {str(k): one for k, one in enumerate(TRUTHS)}
    mean = {name: one["all"] for name, one in tally.points(truths, diagnoses).items()}
    assert mean[score.PERFECT] == 1.0
    assert all(score.judge(one, score.perfect(one)) in ("right", "in the set") for one in TRUTHS)
    assert mean[score.WHOLE] < 0.1
    assert max(value for name, value in mean.items() if name.startswith(("always", "no "))) < 0.5


@pytest.mark.parametrize(
    ("true", "diagnosis", "outcome", "points"),
    [
        (truth("null"), said(), "right", 1.0),
        (truth("null"), said(("heeling",)), "false name", 0.0),
        (truth("null"), said(("current_veer",), side="water"), "right", 1.0),
        (truth("null"), said() | {"current": [{"driver": "speed"}]}, "right", 1.0),
        (truth("single", "current_veer"), said() | {"current": [{"driver": "speed"}]}, "right", 1.0),
        (truth("single", "heeling"), said(("heeling",)) | {"current": [{"driver": "speed"}]}, "right", 1.0),
        (truth("null"), said(("reference_slip",), side="reference"), "false name", 0.0),
        (truth("null"), said(("reference_deviation",), side="reference"), "right", 1.0),
        (truth("single", "heeling"), said(("heeling",), ("reference_deviation",)), "right", 1.0),
        (truth("single", "heeling"), said(("reference_deviation",)), "missed", 0.0),
        (truth("single", "reference_deviation"), said(("reference_deviation",)), "right", 1.0),
        (truth("null"), said() | {"verdict": "insufficient"}, "refused", 0.0),
        (truth("noisy"), said(left=True), "false alarm", 0.0),
        (truth("single", "heeling"), said(("heeling",)), "right", 1.0),
        (truth("single", "heeling"), said(("temperature", "heeling")), "in the set", 0.5),
        (truth("single", "heeling"), said(("heeling",), ("octantal",)), "one too many", 0.5),
        (truth("single", "heeling"), said(("octantal",)), "wrong name", 0.0),
        (truth("single", "heeling"), said(left=True), "unexplained", 0.0),
        (truth("single", "heeling"), said(), "missed", 0.0),
        (truth("single", "temperature"), said(("composed:reading/temperature/linear",)), "right", 1.0),
        (truth("single", "temperature"), said(("composed:reading/time/linear",)), "wrong name", 0.0),
        (truth("pair", "heeling", "temperature"), said(("heeling",)), "half", 0.5),
        (truth("strange", "teeth"), said(("octantal",)), "bare name", 0.0),
        (truth("strange", "teeth"), said(("composed:lobe4/time/box",)), "right", 1.0),
        (truth("strange", "teeth"), said(("octantal",), left=True), "name beside", 0.5),
        (truth("undecidable", "supply_voltage"), said(("supply_voltage",)), "guessed", 0.0),
        (truth("undecidable", "supply_voltage"), said(("supply_voltage", "compass_drift")), "right", 1.0),
        (truth("undecidable", "field_disturbance"), said(("temperature",)), "wrong name", 0.0),
    ],
)
def test_outcomes_and_points_of_verdicts(true, diagnosis, outcome, points):
    assert score.judge(true, diagnosis) == outcome
    assert score.points(true, diagnosis) == pytest.approx(points)


def test_calibrated_probabilities_beat_the_base_rate():
    rng = np.random.default_rng(1)
    stated = rng.uniform(size=400)
    came = (rng.uniform(size=400) < stated).astype(float)
    rows = [
        {"place": tally.PLACES[1], "of_compass": [p, y], "of_names": [[p, y]]}
        for p, y in zip(stated, came, strict=True)
    ]
    good = tally.probabilities(rows)[tally.NAMED]
    assert good["brier"]["better"][0] > 0.0 and good["log"]["better"][0] > 0.0
    assert good["brier"]["own"] == pytest.approx(np.mean((stated - came) ** 2))
    assert sum(one["count"] for one in good["bins"]) == 400
    assert tally.probabilities([*rows, rows[0] | {"place": tally.PLACES[-1]}])[tally.NAMED]["count"] == 400
    swapped = [row | {"of_names": [[1.0 - p, y] for p, y in row["of_names"]]} for row in rows]
    assert tally.probabilities(swapped)[tally.NAMED]["brier"]["better"][1] < 0.0


def test_stated_name_is_right_if_it_matches_the_truth():
    finding = said(("heeling", "temperature", "octantal"))
    finding["findings"][0] |= {"probability": 0.6, "alternatives_probability": {"temperature": 0.3, "octantal": 0.1}}
    assert score.names(truth("single", "temperature"), finding) == [[0.3, 1.0], [0.6, 0.0], [0.1, 0.0]]
    assert score.names(truth("null"), finding) == [[0.6, 0.0], [0.3, 0.0], [0.1, 0.0]]
    finding["sides"] = {"none": 0.2, "compass": 0.7, "clock": 0.05, "water": 0.05}
    assert score.at_fault(truth("single", "heeling"), finding) == [0.75, 1.0]
    assert score.at_fault(truth("null"), finding) == [0.75, 0.0]


def test_stated_driver_is_right_if_the_truth_depends_on_it():
    driven = {"effect": "composed", "alternatives": [], "side": "compass", "level": "driver", "level_probability": 0.97}
    for planted, driver, right in (
        (truth("single", "heeling"), "roll", True),
        (truth("single", "heeling"), "time", False),
        (truth("single", "battery_change"), "voltage", True),
        (truth("single", "temperature"), "temperature*time", True),
        (truth("strange") | {"effects": [{"name": "strumming", "right": []}]}, "speed", True),
        (truth("strange") | {"effects": [{"name": "strumming", "right": []}]}, "depth", False),
    ):
        composition = {"acts_on": "reading", "driver": driver, "form": "square"}
        made = score.statement(driven | {"driver": driver, "composition": composition}, planted)
        assert made["driver_right"] is right, (planted, driver)


def test_target_is_missed_if_its_interval_excludes_it(capsys):
    assert targets.interval(0, 10) == pytest.approx((0.0, 0.3085), abs=1e-4)  # tables of Clopper and Pearson
    assert targets.interval(3, 10) == pytest.approx((0.0667, 0.6525), abs=1e-4)
    few, many = ([True] * n + [False] * (9 * n) for n in (1, 30))
    assert targets.share("few", few, most=0.02).held and not targets.share("many", many, most=0.02).held
    assert targets.share("none", [], most=0.02).held
    wide = np.tile([0.8, 1.0], 40)
    assert targets.mean("covered", wide, least=0.88, most=0.97).held
    assert not targets.mean("covered", wide, least=0.97).held
    assert targets.mean("too few", wide[:4], least=0.97).held
    assert targets.report([targets.share("few", few, most=0.02)]) == 0
    assert targets.report([targets.share("many", many, most=0.02), targets.limit("s", 3.0, most=4.0)]) == 1
    assert "| many | 10.0 % of 300 (6.8–14.0) | ≤ 2 %, MISSED |" in capsys.readouterr().out


@pytest.fixture(scope="module")
def here():
    return seas.make(np.random.default_rng(4), seas.Weather(wide=True, hours=1500, battery="change"))


@pytest.fixture(scope="module")
def plain(here):
    return compass.Meter(np.eye(3), np.zeros(3))


@pytest.mark.parametrize("family", (*families.NAMED, *families.STRANGE), ids=lambda one: one.name)
def test_every_family_is_planted_with_the_requested_size(here, plain, family):
    made = compass.plant(here, plain, family, 2.0, np.random.default_rng(3))
    if family.sized and made.size < family.most:
        assert made.visible_deg == pytest.approx(2.0, rel=0.1)
    assert made.visible_deg > 0.2 and made.size <= family.most
    assert set(family.right) <= set(SIDES)
    nothing = compass.visible_deg(here, plain, made.make(0.0)) if family.sized else 0.0
    assert nothing == pytest.approx(0.0, abs=1e-9)


def profile(count: int = 2000) -> scene.Scene:
    made = seas.make(np.random.default_rng(9), seas.Weather(wide=True, hours=count))
    flow = made.flow.copy()
    flow[5:9, 2] = np.nan
    return replace(made, flow=flow, real=True)


def test_cut_extended_and_mirrored_records_keep_their_statistics():
    one = records.Described("own", {"gaps": [1]}, Path())
    base = profile()
    cut = records.cut(np.random.default_rng(1), one, base)
    assert cut.lower.size == base.time_s.size and np.isnan(cut.flow).any()
    for k in range(2):  # by random phases and by permuted segments
        long = records.longer(np.random.default_rng(k), cut, seas.Weather(hours=5000))
        assert long.flow.shape[1] == cut.flow.shape[1] and np.isfinite(long.flow).all()
        assert len(np.unique(long.flow[:, 0])) == len(long.flow)  # no sample of the water is repeated
        assert len(long.flow) == 5000 if len(long.flow) > len(cut.flow) else 0.95 * len(cut.flow) < len(long.flow)
        off = [np.sqrt(np.nanmean(np.abs(x.lower - x.near) ** 2)) for x in (cut, long)]
        assert off[1] == pytest.approx(off[0], rel=0.5)  # segments are chosen at random
    glass = records._mirrored(base)
    port = scene.wrap(scene.towards(glass.near) - glass.declination_deg - glass.heading_deg)
    starboard = scene.wrap(scene.towards(base.flow[:, -1]) - base.declination_deg - base.heading_deg)
    assert np.nanmax(np.abs(scene.wrap(port + starboard))) < 1e-6


def test_moorings_are_drawn_in_the_stated_shares():
    there = {"eh2": False, "papa": False, "aqd": True}
    drawn = draw.draw(1, (200, 100), 8800, there)
    made, real = ([one.kind for one in drawn if one.real is which] for which in (False, True))
    assert sum(made.count(kind) for kind in score.QUIET) == 68 and made.count("undecidable") == 10
    assert sum(real.count(kind) for kind in score.QUIET) == 34 and real.count("strange") == 18
    named = {name for one in drawn for name, _ in one.wanted}
    assert named == {one.name for one in (*families.NAMED, *families.STRANGE)}
    sizes = [size for one in drawn if one.kind == "single" for _, size in one.wanted]
    assert min(sizes) >= 0.8 and max(sizes) <= 4.5
    waters = [{one.water for one in drawn if one.real is real} for real in (False, True)]
    assert waters == [{"made", "eh2", "papa"}, {"eh2", "papa", "aqd"}]  # stand-in references are never extended
    assert draw.draw(1, (200, 100), 8800, there) == drawn != draw.draw(2, (200, 100), 8800, there)
