"""Would catch an effect of a bench, magnetometer or two heads missed, misnamed or invented."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from compasslib import angles, compass
from compasslib.archive.files import write_json
from compasslib.calibrations.magnetometer import log
from compasslib.effects import CATALOGUE
from compasslib.inference import kinds, short_search
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds import magnetometer as magnetometer_kind
from compasslib.inference.kinds import platform
from compasslib.inference.short_model import AMPLITUDES, WHITE, ShortComparison, log_evidence
from compasslib.statistics.noise import arma_innovations, arma_series
from tests.world import recordings as drawn
from tests.world import swing
from tests.world.bench import MILD, readings, ring, write_table
from tests.world.sea import real
from tests.world.two_heads_files import TURNED, cast, rewritten

OPTIONS = Options(surrogates=39)
MM = np.array([-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123])  # Moncunill Marimón 2023, section 5.3
ACM = "acm/mmp_global_A0000001.TXT"


def magnetometer(path: Path, **settings: object) -> Diagnosis:
    return kinds.diagnose("magnetometer", [path], settings, OPTIONS)


def names(found: Diagnosis) -> list[str]:
    return [one.effect for one in found.findings]


def bench(error, n: int = 24, rounds: int = 1, *, iron=MILD, seed: int = 1) -> Diagnosis:
    """Diagnose some headings a round, with noise of 0.3 degrees and an error, a function of reading and share."""
    correct = np.tile(ring(n), rounds)
    recorded = compass.recorded_heading(iron, correct)
    recorded = recorded + error(recorded, np.linspace(0.0, 1.0, len(correct)))
    noise = np.random.default_rng(seed).normal(0.0, 0.3, len(correct))
    return platform.diagnose_readings(correct, angles.wrap360(recorded + noise), field=None, options=OPTIONS)


def wave(cycles: float):
    """Make an error of 2 degrees with some cycles a turn."""
    return lambda g, t: 2.0 * angles.sin_cos(cycles * g)[0]


def none(g, t):
    return 0.0


def test_evidence_is_that_of_students_law():
    rng = np.random.default_rng(1)
    base, columns, residual = rng.normal(size=(14, 3)), rng.normal(size=(14, 2)), rng.normal(size=14)
    found = log_evidence(WHITE, base, columns, np.array([0, 2]), residual[:, None])(1.0)
    logs = []
    for amplitude in (0.0, *AMPLITUDES):
        precision = np.linalg.inv(np.eye(14) + amplitude**2 * columns @ columns.T)
        fitted = base.T @ precision @ base
        left = residual - base @ np.linalg.solve(fitted, base.T @ precision @ residual)
        determinants = np.linalg.slogdet(fitted)[1] - np.linalg.slogdet(precision)[1]
        logs.append(-0.5 * determinants - 0.5 * (14 - 3) * np.log(left @ precision @ left))
    assert found[0][0] == pytest.approx(logs[0], abs=1e-6)
    expected = np.logaddexp.reduce(logs[1:]) - np.log(len(AMPLITUDES)) - logs[0]
    assert found[1][0, 0] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("law", [(0.0, 0.0), (0.9, -0.4)])
def test_a_series_has_its_innovations_back(law):
    white = np.random.default_rng(2).normal(size=(400, 3))
    np.testing.assert_allclose(arma_innovations(arma_series(white, law), law), white, atol=1e-9)


def test_benches_without_effects_are_consistent_and_their_ranks_even():
    found = [bench(none, rounds=2, seed=seed) for seed in range(40)]
    ranks = np.array([each.detection.rank_p for each in found])
    assert np.sum(ranks <= 0.01) <= 1 and 0.3 < np.median(ranks) < 0.7
    assert [each.verdict for each in found].count("consistent") >= 39


@pytest.mark.parametrize(("effect", "cycles", "n"), [("sextantal", 3, 16), ("octantal", 4, 36)])
def test_a_harmonic_on_a_bench_is_identified_with_its_size(effect, cycles, n, tmp_path):
    found = bench(wave(cycles), n)
    assert (found.verdict, names(found)) == ("explained", [effect]) and found.findings[0].probability > 0.95
    assert found.detection.rank_p == 1 / 40 and found.detection.n_surrogates == 39
    sine = found.findings[0].parameters["sine_deg"]
    assert abs(sine.value - 2.0) < 4.0 * sine.sigma + 0.1  # fitted in the final reading, simulated in that before it
    assert sine.sigma == pytest.approx(0.3 * np.sqrt(2.0 / n), rel=0.5)
    assert found.findings[0].held_out.rms_after_deg < 0.6 < found.findings[0].held_out.rms_before_deg
    write_json(tmp_path / "diagnosis.json", found.to_json())
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert content["findings"][0]["when"] is None
    assert {"covariate", "compared", "centre", "before_deg", "after_deg", "sigma_deg"} == set(content["curves"][0])


@pytest.mark.parametrize(
    ("error", "seed", "effects"),
    [
        (lambda g, t: wave(3)(g, t) + 3.0 * (t > 0.6), 4, {"sextantal", "heading_slip"}),
        (lambda g, t: wave(3)(g, t) + wave(4)(g, t), 1, {"sextantal", "octantal"}),  # not one composed effect
    ],
)
def test_two_effects_are_both_named(error, seed, effects):
    found = bench(error, rounds=2, seed=seed)
    assert (found.verdict, {*names(found)}) == ("explained", effects)


def test_what_only_a_composed_effect_describes_is_unexplained():
    found = bench(wave(7), rounds=2, seed=5)
    assert found.verdict == "unexplained" and found.unexplained.covariates == ("heading",)
    assert found.unexplained.rms_effect_deg == pytest.approx(2.0 / np.sqrt(2.0), rel=0.2)


def test_a_slip_halfway_is_identified_on_a_bench():
    found = bench(lambda g, t: 3.0 * (np.arange(48) >= 24), 16, 3).findings[0]
    assert (found.effect, found.where.low, found.when_s) == ("heading_slip", 25.0, None)
    offset = found.parameters["offset_deg"]
    assert abs(offset.value - 3.0) < 4.0 * offset.sigma


@pytest.mark.parametrize("strength", [0.7, 1.3])
def test_strong_iron_is_too_large_for_the_series(strength):
    found = bench(none, 36, iron=(0.02, strength, 0.1, 0.03, -0.02))
    assert (found.verdict, names(found)) == ("explained", ["large_deviation"])
    assert found.sides["compass"] > 0.9, "a finding that was made apart from the search counts"
    assert found.findings[0].held_out.rms_after_deg < found.findings[0].held_out.rms_before_deg


def test_few_headings_are_insufficient_with_advice(tmp_path):
    true = ring(8)
    rows = [f"{(45 * k - d) % 360:.3f},{45 * k}" for k, d in enumerate(MM)]
    (tmp_path / "swing.csv").write_text("\n".join(["compass_deg,true_deg", *rows]) + "\n")
    swung = kinds.diagnose("swing", [tmp_path / "swing.csv"], {"declination": 0.0}, OPTIONS)
    assert "water_drift" in dict(swung.not_testable)
    for found in (swung, platform.diagnose_readings(true, true - MM, field=None, options=OPTIONS)):
        assert found.verdict == "insufficient" and not found.findings
        assert "8 headings determine at most 8 coefficients" in found.why and "swing 16 to 24" in found.why
    path = write_table(tmp_path / "few.csv", readings(ring(3)))
    found = kinds.diagnose("platform", [path], {}, OPTIONS)
    assert found.verdict == "insufficient" and found.why.startswith("3 headings in 3 of 36 sectors")


def test_missing_tilt_compensation_is_found_in_both_file_formats():
    found, binary = (magnetometer(real(ACM).with_suffix(end), format="mmp_acm") for end in (".TXT", ".DAT"))
    assert (found.verdict, names(found)) == ("explained", ["tilt_uncompensated"])
    proof = found.findings[0].held_out
    assert proof.rms_before_deg == pytest.approx(7.82, abs=0.05) and proof.rms_after_deg < 0.1
    assert found.findings[0].parameters["share"].value == pytest.approx(1.0, abs=0.02)
    assert found.findings[0].where.covariate in ("pitch", "roll")
    assert names(binary) == names(found)
    share = [one.findings[0].parameters["share"].value for one in (found, binary)]
    assert share[0] == pytest.approx(share[1], abs=0.005)  # tilts have two decimals in the text format


def test_tilt_compensation_is_not_testable_without_tilts():
    found = magnetometer(real(ACM), format="mmp_acm", withhold=["TX", "TY"])
    assert found.verdict in ("unexplained", "ambiguous")
    assert all("tilt_uncompensated" in one.alternatives for one in found.findings)
    assert "tilts" in found.separated_by and ("tilt_uncompensated", "no tilts were logged") in found.not_testable


def test_direction_cosines_without_heading_are_insufficient():
    found = magnetometer(real(ACM), format="mmp_acm", withhold=["HDNG"])
    assert found.verdict == "insufficient" and "no heading was logged" in found.why


@pytest.mark.parametrize("withhold", [[], ["heading_deg"]])
def test_hard_iron_of_a_signature_is_identified(withhold):
    found = magnetometer(real("magnetometer/signature500.csv"), withhold=withhold)
    iron = next(one for one in found.findings if one.effect == "hard_iron")
    size = np.hypot(*(iron.parameters[name].value for name in ("b_x", "b_y")))
    assert size / 215.3 == pytest.approx(0.226, abs=0.015)  # horizontal field 215.3 counts, one-cycle modulation 22.6 %
    assert found.verdict == "explained" and not iron.alternatives
    assert set(names(found)) <= {"hard_iron", "tilt_uncompensated"}


def test_iron_is_identified_from_rotation_over_the_sphere():
    found = magnetometer(real("magnetometer/hmc5883l_sphere.csv"))
    assert (found.verdict, names(found)) == ("explained", ["hard_iron", "soft_iron"])
    values = [found.findings[0].parameters[name].value for name in ("b_x", "b_y", "b_z")]
    assert values == pytest.approx([-0.0064, -0.1054, 0.0203], abs=0.003)  # as by the calibration's ellipsoid


CLEAN = replace(TURNED, clock_s=0.0, deviation_deg=(0.0,) * 5)


def heads(folder: Path, head=CLEAN, turned=None) -> Diagnosis:
    paths = cast(folder, b=head)
    if turned is not None:
        paths[1].write_bytes(rewritten(paths[1].read_bytes(), turned))
    return kinds.diagnose("two_heads", paths, {}, OPTIONS)


def late(heading: np.ndarray) -> np.ndarray:
    """Delay headings by three ensembles, 3.9 s."""
    n, turned = np.arange(len(heading)), np.cumsum(np.append(heading[:1], angles.difference(heading[1:], heading[:-1])))
    return angles.wrap360(np.interp(n - 3.0, n, turned))


def test_a_slip_of_a_mount_is_dated_but_not_attributed_to_a_head(tmp_path):
    found = heads(tmp_path, turned=lambda h: angles.wrap360(h + 3.0 * (np.arange(len(h)) > 0.6 * len(h))))
    assert names(found) == ["heading_slip"] and "which of the two heads" in (found.separated_by or "")
    begin, end = found.findings[0].when_s or (0.0, 0.0)
    assert begin - 1.2e9 == pytest.approx(2400.0, abs=30.0) and end > begin
    assert found.findings[0].parameters["offset_deg"].value == pytest.approx(3.0, abs=0.2)


def test_a_compass_lag_is_not_a_clock_error(tmp_path):
    assert heads(tmp_path).verdict == "consistent"
    found = heads(tmp_path, turned=late)
    assert [(one.effect, one.side) for one in found.findings] == [("compass_lag", "compass")]
    assert found.findings[0].parameters["lag_s"].value == pytest.approx(3.9, abs=0.1)


def test_a_clock_offset_is_attributed_to_the_clock(tmp_path):
    found = heads(tmp_path, replace(CLEAN, clock_s=2000.0))
    assert [(one.effect, one.side) for one in found.findings] == [("clock_offset", "clock")]
    assert found.findings[0].parameters["offset_s"].value == pytest.approx(2000.0, abs=0.05)


def test_iron_near_one_head_is_identified(tmp_path):
    found = heads(tmp_path, replace(TURNED, clock_s=0.0))
    assert names(found) == ["hard_iron", "soft_iron"]
    b_percent = 100.0 * np.sin(np.radians(TURNED.deviation_deg[1]))  # of the horizontal field, to first order
    assert found.findings[0].parameters["b_x"].value == pytest.approx(b_percent, abs=0.7)


def test_a_disabled_diagnosis_says_so():
    assert kinds.chosen({"enabled": False, "apply": True, "min_effect_deg": 0.5}) is None
    found = kinds.diagnose("platform", [], {}, None)
    assert found.verdict == "insufficient" and "switched off" in found.why


def axes_of(effect: str, seed: int = 1) -> log.Log:
    made = drawn.log(np.random.default_rng(seed), effect)
    tilts = made.pitch_deg, made.roll_deg
    return log.Log(made.field_nt, True, *tilts, made.heading_deg, made.time_s, 0, (), made.temperature_c)


def over_the_sphere() -> log.Log:
    """Simulate a log of axes that were turned to all directions, without headings."""
    towards = np.random.default_rng(3).normal(size=(600, 3))
    field = 50_000.0 * towards / np.linalg.norm(towards, axis=1)[:, None] + np.array([3000.0, -2000.0, 1000.0])
    return log.Log(field, True, None, None, None, None, 0)


def test_every_effect_is_tested_in_the_recordings_it_lists(monkeypatch, tmp_path):
    tried: dict[type, set[str]] = {}
    kind = ""

    def noted(channel: ShortComparison, options: Options) -> short_search.ShortInference:
        for term in channel.terms:
            tried.setdefault(term, set()).add(kind)
        return searched(replace(channel, terms=()), options)  # the result is not needed

    searched = short_search.search_effects
    monkeypatch.setattr(short_search, "search_effects", noted)
    kind = "platform"
    bench(none)
    kind = "two_heads"
    heads(tmp_path)
    kind = "magnetometer"
    field = {"horizontal_nT": drawn.H_NT, "vertical_nT": drawn.Z_NT}
    for one in (axes_of(""), axes_of("tilt_uncompensated"), over_the_sphere()):
        magnetometer_kind.diagnose_log(one, field=field, options=OPTIONS)
    kind = "swing"
    made = swing.sail(np.random.default_rng(1), swing.Boat(log_scale=1.02), 5.0)
    kinds.diagnose("swing", [drawn.written(made, tmp_path / "swing.csv")], {"declination": 5.0}, OPTIONS)
    for term in (term for term in CATALOGUE if not term.detector):
        assert set(term.recordings) - {"mooring", "declination"} == tried.get(term, set()), term.__name__
    assert set(tried) <= set(CATALOGUE)


@pytest.mark.parametrize(("effect", "seed"), [("hard_iron_step", 903), ("temperature", 903), ("compass_lag", 902)])
def test_parameters_of_magnetometer_logs_are_within_their_errors(effect, seed):
    """Regression test: biased scale and delay put these logs off by five, five and three standard errors."""
    truth = drawn.log(np.random.default_rng(seed), effect).truth
    field = {"horizontal_nT": drawn.H_NT, "vertical_nT": drawn.Z_NT}
    found = magnetometer_kind.diagnose_log(axes_of(effect, seed), field=field, options=OPTIONS)
    (own,) = (one for one in found.findings if one.effect == effect)
    off = [(own.parameters[name].value - value) / own.parameters[name].sigma for name, value in truth.items()]
    assert max(np.abs(off)) < 2.6
