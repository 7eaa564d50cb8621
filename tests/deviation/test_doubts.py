"""Would catch sound moorings accused, mistakes unasked for, doubts without consequence in the product."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.archive.files import read_json
from compasslib.deviation.assessment import answer_use
from compasslib.deviation.constant import (
    ConstantOffset,
    find_constant_offset,
    find_declination_error,
    question_constant,
)
from compasslib.deviation.correction import correct
from compasslib.deviation.doubts import (
    Doubt,
    doubt_whole_record,
    doubts_from_json,
    evaluate_doubts,
    find_doubtful_windows,
)
from compasslib.deviation.exact import fit_exact, recognize_frame
from compasslib.deviation.model import DeviationFit
from compasslib.inference import conclusion
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import UNTESTED, CovariateRange, Finding, Parameter, Unexplained
from compasslib.records import GOOD, PROBABLY_BAD, EarthField, Pairs, take
from tests.world import chain
from tests.world.sea import FOLDED, MILD, cruise, field_of, pairs, real, record_of

DECLINATION_DEG = 18.0


@pytest.fixture(scope="module")
def mild() -> tuple[Pairs, DeviationFit]:
    """Pairs under mild iron, and their fit."""
    seen, _ = pairs(MILD, n=1500, seed=6)
    return seen, fit_exact(seen)


@pytest.mark.parametrize(
    ("angle_deg", "sigma_deg", "effect", "words"),
    [
        (18.9, 1.3, "declination_error", "equal to the declination (+18.0°): the directions of the reference hold"),
        (-17.0, 1.3, "declination_error", "equal to minus the declination (+18.0°): the directions of the ref"),
        (35.0, 1.3, "declination_error", "equal to twice the declination (+18.0°): it was applied with the wrong"),
        (178.5, 1.3, "mounting_offset", "half a turn: the instrument is mounted backwards"),
        (27.0, 1.3, "mounting_offset", "more than mountings and iron explain: the axes of a processed file may be"),
        (14.0, 1.3, "", "(1σ 1.3°): a mounting offset or a mistake; check declination"),
        (17.0, 4.0, "", "equal to the declination (+18.0°)"),  # four standard errors, but three of mountings are within
        (4.5, 0.3, "", ""),  # plausible for a mount
        (18.0, 5.0, "", ""),  # 3.6 of its standard errors
    ],
)
def test_a_large_constant_is_questioned_and_a_significant_one_told(angle_deg, sigma_deg, effect, words):
    found = question_constant(angle_deg, sigma_deg, DECLINATION_DEG, {})
    assert found.effect == effect and (words in found.text if words else not found.text)
    assert found.probability > 0.8 if effect else found.probability == 0.0


@pytest.mark.parametrize("declination_deg", [0.0, 6.3, 20.0])
def test_one_sound_mooring_in_a_hundred_is_accused_at_any_declination(declination_deg):
    """Mountings of 4° and errors of the reference of 2° (Student's t), standard errors as of real records: 0.8 %."""
    rng, n = np.random.default_rng(1), 2000
    sigma = rng.choice([0.3, 0.9, 1.3, 3.7], n)
    angle = rng.normal(0.0, np.hypot(4.0, sigma), n) + 2.0 * rng.standard_t(4.0, n)
    found = [question_constant(a, s, declination_deg, {}).effect for a, s in zip(angle, sigma, strict=True)]
    assert np.mean([bool(effect) for effect in found]) == pytest.approx(0.008, abs=0.006)  # three standard errors


def test_no_constant_is_told_where_iron_alone_explains_few_headings():
    """Of a sound mooring whose headings vary by 6°: another solution, without a constant, fits as well."""
    seen, _ = pairs((0.0, -0.66, -0.54, 0.0, 0.0), n=1500, seed=104, spread=6.0)
    fit = fit_exact(seen)
    other = replace(fit, coefficients=fit.coefficients + 0.6 * np.eye(5)[0], covariance=1e-4 * np.eye(5))
    assert not find_constant_offset(other, seen, DECLINATION_DEG).text


def test_only_a_declination_of_wrong_sign_is_questioned():
    fields = [EarthField(*(np.full(2, x) for x in (0.0, d, 1e4, 5e4, -20.0))) for d in (20.0, 8.0, -17.0)]
    wrong, unknown, local = map(find_declination_error, fields)
    assert unknown is None and local is None
    assert wrong.effect == "declination_error" and wrong.angle_deg == 40.0
    assert "+40.0° off IGRF (-20.0°), which has the other sign" in wrong.text


def test_a_subtracted_heading_bias_is_identified_with_its_instrument():
    found = question_constant(-45.5, 1.3, DECLINATION_DEG, {"top": 0.0, "deep": 45.0})
    assert found.effect == "declination_error"
    assert "equal to the +45.0° that were subtracted from the directions of deep" in found.text


def turned(seen: Pairs, side: str, angle_deg: float) -> Pairs:
    """Rotate the upper or lower velocities of pairs clockwise."""
    names = (f"{side}_east", f"{side}_north")
    velocity = angles.turn(*(getattr(seen, name) for name in names), angle_deg)
    return replace(seen, **dict(zip(names, velocity, strict=True)))


def test_constant_of_a_calibration_is_the_mean_residual(mild):
    seen, fit = mild
    carried = replace(fit, method="calibration")
    found = find_constant_offset(carried, turned(seen, "lower", 24.0), 24.0)
    assert found.effect == "declination_error" and found.angle_deg == pytest.approx(24.0, abs=3.0)
    assert found.sigma_deg == pytest.approx(find_constant_offset(carried, seen, 24.0).sigma_deg, rel=0.1)


def test_fit_of_a_folded_compass_recovers_a_constant(angle_deg=-36.0):
    """From starting values without a constant, the fit converges to an implausible soft iron of 60 %."""
    seen, _ = pairs(FOLDED, n=3000, seed=5)
    wrong = replace(turned(seen, "upper", angle_deg), heading_deg=angles.wrap360(seen.heading_deg + angle_deg))
    fit = fit_exact(wrong)
    assert float(angles.wrap180(angles.direction(fit.coefficients[0], 1.0))) == pytest.approx(-angle_deg, abs=4.0)
    assert not fit.has_implausible_iron


def test_strong_iron_is_found_in_the_few_readings_that_it_leaves():
    """EG4's iron, 3.3 times the earth's field; half of its months were fitted by iron at the fold instead."""
    seen, _ = pairs((0.07, 2.77, -1.76, -0.02, 0.03), n=1500, seed=2, spread=20.0)
    fit = fit_exact(seen)
    assert np.hypot(*fit.coefficients[1:3]) > 2.0 and fit.residual_rms_deg < 30.0 and not fit.has_implausible_iron


@pytest.mark.parametrize(("east", "north", "words"), [(-1, -1, "turned by 180°"), (1, -1, "mirrored"), (1, 1, "")])
def test_components_of_the_wrong_sign_are_named(east, north, words):
    seen, _ = pairs((0.0, 0.4, 0.4, 0.03, 0.02), n=700, seed=3)
    wrong = replace(seen, lower_east=east * seen.lower_east, lower_north=north * seen.lower_north)
    fit = fit_exact(wrong)
    said = recognize_frame(wrong, fit)
    assert words in said and bool(said) == bool(words)
    if words:  # the constant of a wrong fit is compared with no mistake
        assert find_constant_offset(replace(fit, mistake=said), wrong, DECLINATION_DEG) is None


# ------------------------------------------------------------------------------------------------------------- windows
def spoilt(seen: Pairs, some: slice) -> Pairs:
    """Replace headings and velocities of the upper instrument in some pairs by those of another time."""
    at = np.arange(len(seen))
    at[some] = (at[some] + 900) % len(seen)
    return replace(
        seen, heading_deg=seen.heading_deg[at], upper_east=seen.upper_east[at], upper_north=seen.upper_north[at]
    )


@pytest.mark.parametrize(
    ("iron", "some"), [(MILD, slice(0, 240)), (FOLDED, slice(1000, 1400)), (MILD, slice(2600, 3000))]
)
def test_a_repeated_period_is_doubted_and_the_rest_is_not(iron, some):
    seen, _ = pairs(iron, n=3000, seed=21)
    wrong = spoilt(seen, some)
    found = find_doubtful_windows(wrong, fit_exact(wrong))
    inside, _ = evaluate_doubts(found, wrong.time_s)
    assert inside[some].mean() > 0.6 and np.delete(inside, np.arange(3000)[some]).mean() < 0.1
    assert all(doubt.sigma_deg >= 10.0 and "directions differ from the reference" in doubt.why for doubt in found)


@pytest.mark.parametrize(("iron", "seed"), [(MILD, 0), (MILD, 1), (FOLDED, 2), (FOLDED, 3)])
def test_a_sound_record_has_no_doubtful_period(iron, seed):
    seen, _ = pairs(iron, n=3000, seed=seed)
    assert find_doubtful_windows(seen, fit_exact(seen)) == ()


@pytest.mark.parametrize("name", ["E0", "E2"])
def test_real_water_without_a_fault_is_not_doubted(tmp_path, name):
    folder = Path(shutil.copytree(real("cruise_eh2"), tmp_path / "c"))
    (folder / "config/config.yaml").write_text("{moorings: config/moorings, diagnose: {enabled: false}}\n")
    seen = netcdf.read_pairs(chain.make(folder, name, tmp_path / "made") / "overlap.nc")
    assert find_doubtful_windows(seen, fit_exact(seen)) == () and seen.slowed == ()


def test_slack_water_is_not_another_compass():
    """Of a profiler's pairs with a scatter of 1 degree, two of a last window of 22 are slow and point elsewhere."""
    seen, heading = pairs(MILD, n=12 * 262, seed=3)
    rng, off = np.random.default_rng(1), angles.difference(seen.heading_deg, heading)
    east, north = angles.turn(seen.upper_east, seen.upper_north, -off + rng.normal(0.0, 1.0, len(seen)))
    speed = np.hypot(east, north)
    size = np.maximum(speed, 0.1)
    size[12 * 245], size[12 * 250] = 0.006, 0.019  # m/s
    along = {name: size / speed * x for name, x in zip(("lower_east", "lower_north"), (east, north), strict=True)}
    above = {name: size / speed * getattr(seen, name) for name in ("upper_east", "upper_north")}
    slack = np.zeros(len(seen))
    slack[12 * 245], slack[12 * 250] = -39.0, -11.0
    sparse = take(turned(replace(seen, **along, **above), "lower", slack), np.arange(0, len(seen), 12))
    assert find_doubtful_windows(sparse, fit_exact(sparse)) == ()


@pytest.mark.parametrize(("angle_deg", "days", "doubted"), [(18.0, 12, True), (18.0, 5, False), (8.0, 12, False)])
def test_two_consecutive_turned_windows_are_doubted_but_not_one(angle_deg, days, doubted):
    seen, _ = pairs(MILD, n=3000, seed=21)
    turn = np.where((np.arange(3000) >= 1200) & (np.arange(3000) < 1200 + 24 * days), angle_deg, 0)
    moved = turned(seen, "upper", turn)
    inside, _ = evaluate_doubts(find_doubtful_windows(moved, fit_exact(moved)), moved.time_s)
    assert inside[1230 : 1170 + 24 * days].mean() > 0.9 if doubted else not inside.any()


@pytest.mark.parametrize(("until", "whole"), [(450, False), (1000, True)])
def test_whole_record_is_doubted_if_a_large_part_disagrees(until, whole):
    """If the reference is turned by 52° for a third of the record, the fit may be to the wrong part."""
    seen, _ = pairs(MILD, n=3000, seed=21)
    wrong = turned(seen, "lower", np.where(np.arange(3000) < until, -52.0, 0.0))
    found = find_doubtful_windows(wrong, fit_exact(wrong))
    inside, sigma = evaluate_doubts(found, wrong.time_s)
    assert inside[:until].mean() > 0.9 and inside[until + 130 :].any() == whole
    assert not whole or sigma[until:].min() > 40.0


def test_doubts_change_flags_and_uncertainty_only_in_their_period():
    seen, _ = pairs(MILD, n=600, seed=2)
    record, fit = record_of(seen), fit_exact(seen)
    stretch = Doubt(float(record.time_s[100]), float(record.time_s[199]), 20.0, "for a test")
    plain, doubted = (correct(record, fit, field_of(seen), seen, doubts=said) for said in ((), (stretch,)))
    inside = np.zeros(len(record.time_s), dtype=bool)
    inside[100:200] = True
    assert (doubted.heading_corrected_quality[inside] == PROBABLY_BAD).all()
    assert (doubted.heading_corrected_quality[~inside] == GOOD).all()
    np.testing.assert_array_equal(doubted.heading_corrected_deg, plain.heading_corrected_deg)
    np.testing.assert_allclose(
        doubted.heading_uncertainty_deg[inside], np.hypot(plain.heading_uncertainty_deg[inside], 20.0)
    )
    np.testing.assert_array_equal(doubted.heading_uncertainty_deg[~inside], plain.heading_uncertainty_deg[~inside])


def test_doubts_are_restored_from_deviation_json():
    every = (Doubt(1.2e9, 1.3e9, 12.0, "why"), doubt_whole_record(30.0, "all of it"))
    assert doubts_from_json([doubt.to_json() for doubt in every]) == every


# ------------------------------------------------------------------------------------- coarse headings, other faults
def test_uncertainty_includes_the_resolution_of_coarse_headings():
    seen, heading = pairs(MILD, n=2000, seed=4)
    record, fit = record_of(seen), fit_exact(seen)
    part = np.arange(2000) < 1000
    coarse = replace(record, heading_deg=np.where(part, 10.0 * np.floor(record.heading_deg / 10.0), record.heading_deg))
    plain, found = (correct(each, fit, field_of(seen), seen) for each in (record, coarse))
    error = np.abs(angles.difference(found.heading_corrected_deg, heading))
    assert np.mean(error[part] < 1.96 * found.heading_uncertainty_deg[part]) > 0.9
    np.testing.assert_array_equal(found.heading_uncertainty_deg[~part], plain.heading_uncertainty_deg[~part])


def test_samples_inconsistent_with_any_heading_make_the_record_doubtful():
    seen, _ = pairs(MILD, n=2000, seed=8)
    wrong = spoilt(seen, slice(None, None, 12))
    assert conclusion._doubt_outliers(fit_exact(seen)) == ()
    (doubt,) = conclusion._doubt_outliers(fit_exact(wrong))
    assert "disagree with the fitted compass altogether" in doubt.why and doubt.sigma_deg > 15.0


# --------------------------------------------------------------------------------------------- verdict, flags and words
CONSISTENT = Diagnosis("consistent")


def concluded(
    seen: Pairs,
    fit: DeviationFit,
    *,
    find: Callable[[DeviationFit], ConstantOffset | None] = lambda fit: None,
    calibration: str = "",
    diagnosis: Diagnosis = CONSISTENT,
):
    return conclusion.conclude(
        lambda _, **how: diagnosis, seen, record_of(seen), field_of(seen), {}, fit=fit, find_constant=find,
        calibration=calibration,
    )  # fmt: skip


@pytest.mark.parametrize(
    "rest", [ConstantOffset(2.0, 1.0), ConstantOffset(18.5, 1.0, "declination_error", "said", 0.9)]
)
def test_a_clock_error_may_explain_a_questioned_constant(mild, rest):
    seen, first = mild
    refitted = replace(first, coefficients=first.coefficients + 0.01 * np.eye(5)[0])
    where = CovariateRange("turn_rate", -10.0, 10.0, "all along")
    hours = {"hours": Parameter(1.5, 0.1, "h")}
    clock = Finding("clock_offset", "clock", (), where, None, hours, 20.0, UNTESTED, "A clock.", 0.99)
    searched = Diagnosis("explained", findings=(clock,), fit=refitted)
    questioned = ConstantOffset(18.0, 1.0, "declination_error", "equal to the declination", 0.9)
    made = concluded(seen, first, diagnosis=searched, find=lambda fit: questioned if fit is first else rest)
    assert made.diagnosis.findings[0].effect == ("declination_error" if rest.effect else "clock_offset")
    assert bool(made.product.doubts) == bool(rest.effect)


def test_an_implausible_or_contradicted_fit_is_insufficient(mild):
    seen, sound = mild
    wrong = replace(sound, coefficients=np.array([0.0, 0.2, 0.1, 0.7, 0.1]), covariance=1e-4 * np.eye(5))
    other = replace(wrong, method="calibration", coefficients=np.array([0.0, -0.7, 0.7, 0.0, 0.0]))
    searched = concluded(seen, wrong, diagnosis=Diagnosis("explained", fit=sound))
    carried = concluded(seen, other, calibration="bench")
    for made, why in ((searched, "soft iron of 7"), (carried, "calibration bench: ")):
        assert made.diagnosis.verdict == "insufficient" and why in made.diagnosis.why
        assert made.product.doubts[0].sigma_deg == angles.UNIFORM_SIGMA_DEG


def test_a_doubtful_period_makes_the_verdict_unexplained_with_dates():
    wrong = spoilt(pairs(MILD, n=3000, seed=21)[0], slice(1000, 1400))
    made = concluded(wrong, fit_exact(wrong))
    assert made.diagnosis.verdict == "unexplained" and made.diagnosis.unexplained.where.covariate == "time"
    begin, end = made.diagnosis.unexplained.when_s
    assert wrong.time_s[900] < begin < wrong.time_s[1150] and wrong.time_s[1250] < end < wrong.time_s[1500]
    assert any("directions differ from the reference" in warning for warning in made.diagnosis.warnings)


@pytest.mark.parametrize(("size_deg", "doubted"), [(9.0, False), (12.0, True)])
def test_a_large_mismatch_without_a_settled_cause_makes_all_headings_doubtful(mild, size_deg, doubted):
    place = CovariateRange("heading", 0.0, 360.0, "all round")
    left = Unexplained(("heading",), place, None, size_deg, (), "A mismatch.")
    made = concluded(*mild, diagnosis=Diagnosis("unexplained", unexplained=left))
    assert [doubt.from_s for doubt in made.product.doubts] == [-np.inf] * doubted
    rivals = ("temperature", "compass", ("current_veer",), place, None, {}, size_deg, UNTESTED, "A turn.")
    found = Finding(*rivals, True, 0.7, {"current_veer": 0.3})
    made = concluded(*mild, diagnosis=Diagnosis("ambiguous", findings=(found,)))
    assert [doubt.sigma_deg for doubt in made.product.doubts] == [size_deg] * doubted
    assert "temperature is the likeliest cause (70 %), but current veer would" in made.diagnosis.why


@pytest.mark.parametrize(
    ("verdict", "flag", "share", "sigma_deg", "answer"),
    [
        ("consistent", 3, 0.04, 2.0, "yes"),
        ("explained", 2, 0.06, 2.0, "with care"),
        ("consistent", 4, 0.4, 2.0, "yes"),
        ("consistent", 4, 0.6, 2.0, "no"),
        ("consistent", 1, 1.0, 5.1, "with care"),
        ("ambiguous", 1, 1.0, 2.0, "with care"),
        ("unexplained", 1, 1.0, 2.1, "with care"),  # a mismatch of 6 degrees
        ("unexplained", 1, 1.0, 1.9, "no"),
        ("insufficient", 1, 1.0, 2.0, "no"),
    ],
)
def test_use_follows_from_verdict_flags_and_uncertainty(verdict, flag, share, sigma_deg, answer):
    left = {"rms_effect_deg": 6.0, "where": {"text": "along speed"}} if verdict == "unexplained" else None
    limits = {"a": 3.0, "b": 4.0}
    diagnosis = {"verdict": verdict, "unexplained": left, "why": "A reason. Limits.", "detectable_deg": limits}
    flags = np.where(np.arange(100) < 100 * share, flag, GOOD)
    use = answer_use(diagnosis, flags, np.where(flags < 4, sigma_deg, np.nan))
    assert (use["answer"], use["sigma_deg"], use["unseen_deg"]) == (answer, sigma_deg, 4.0) and use["why"]
    without_limit = {**diagnosis, "detectable_deg": {"a": 3.0, "b": None}}
    assert answer_use(without_limit, flags, np.full(100, sigma_deg))["unseen_deg"] is None


@pytest.mark.parametrize(("sigma_deg", "verdict"), [(angles.UNIFORM_SIGMA_DEG, "insufficient"), (30.0, "unexplained")])
def test_doubts_of_the_pairs_determine_the_verdict(mild, sigma_deg, verdict):
    seen, fit = replace(mild[0], doubts=((sigma_deg, "the reference cannot be believed"),)), mild[1]
    made = concluded(seen, fit)
    assert made.diagnosis.verdict == verdict and made.product.doubts[0].sigma_deg == sigma_deg
    assert "cannot be believed" in made.diagnosis.why or "cannot be believed" in made.diagnosis.warnings[0]
    kept = concluded(seen, replace(fit, method="calibration"))
    assert kept.product.doubts == () and "cannot be believed" in kept.diagnosis.warnings[-1]


def test_a_record_that_contradicts_its_fit_makes_all_headings_doubtful(mild):
    few = Diagnosis("insufficient", why="the branch of the compass is known for 11 of 1500 pairs", refutes_fit=True)
    made = concluded(*mild, diagnosis=few)
    assert made.diagnosis.why == few.why and made.product.doubts[0].sigma_deg == angles.UNIFORM_SIGMA_DEG
    assert concluded(*mild, diagnosis=replace(few, refutes_fit=False)).product.doubts == ()


@pytest.mark.parametrize("confirmed", [False, True])
def test_declination_error_is_ambiguous_unless_confirmed(tmp_path, confirmed):
    folder = cruise(tmp_path / "c", n=1200)
    settings = folder / "config/moorings/M1.yaml"
    content = yaml.safe_load(settings.read_text())
    content["instruments"]["top"]["declination_applied"] = -27.0
    settings.write_text(yaml.safe_dump(content | {"confirmed": {"constant": confirmed}}))
    made = chain.make(folder, "M1", tmp_path / "out")
    diagnosis, product = read_json(made / "diagnosis.json"), netcdf.read_corrected(made / "corrected.nc")
    questioned = [finding["effect"] for finding in diagnosis["findings"]] == ["declination_error"]
    assert questioned is not confirmed
    if questioned:
        assert diagnosis["verdict"] == "ambiguous" and diagnosis["findings"][0]["heldout"] is None
        assert (product.heading_corrected_quality == PROBABLY_BAD).all()
        assert (product.heading_uncertainty_deg > 20.0).all() and "equal to" in diagnosis["warnings"][0]
    else:
        assert (product.heading_corrected_quality == GOOD).mean() > 0.9
