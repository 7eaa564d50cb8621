"""Would catch several records of one compass that do not share their iron, or an outlier that spoils the others."""

import json
from dataclasses import replace

import numpy as np
import pytest

from compasslib.deviation import fit_deviation
from compasslib.deviation.exact import start_from_prior
from compasslib.deviation.model import CoefficientPrior, fit_from_json
from compasslib.inference import joint, joint_compass, noise
from compasslib.inference.joint_compass import EffectInformation, Member
from tests.world import pairs as sea

FIELDS = ((12000.0, 52000.0), (15000.0, 50000.0), (20000.0, 42000.0))
ELSE = np.array([0.0, 0.15, -0.1, 0.02, 0.02])  # difference of another compass
IRON = np.array([900.0, -500.0, 0.01, -0.005, 0.02, 0.01])  # in the order of joint_compass.IRON_NAMES


def member(
    name: str, field: tuple[float, float], *, sigma: float = 0.004, off: float = 0.0, rng=None, **keys
) -> Member:
    bare = Member(name, "mooring", None, *field, np.zeros(5), np.eye(5) * sigma**2)
    there = joint_compass._design(bare) @ IRON + (0.0 if rng is None else rng.normal(0.0, sigma, 4)) + off * sigma
    return replace(bare, coefficients=np.append(0.01, there), **keys)


def test_shared_iron_is_estimated_from_different_fields():
    joined = joint_compass.join_records([member(f"M{k}", field, sigma=1e-4) for k, field in enumerate(FIELDS)])
    sigma = np.sqrt(np.diag(joined.shared.covariance))
    assert joined.consistent == ("M0", "M1", "M2") and not joined.rejected
    assert (np.abs(joined.shared.mean - IRON) < 2.0 * sigma).all()


def test_prior_of_a_record_excludes_its_own_data():
    three = [member(f"M{k}", field) for k, field in enumerate(FIELDS)]
    moved = [replace(three[0], coefficients=three[0].coefficients + 0.002), *three[1:]]
    first, second = (joint_compass.join_records(some) for some in (three, moved))
    assert np.array_equal(first.prior("M0").mean, second.prior("M0").mean)
    assert not np.array_equal(first.prior("M1").mean, second.prior("M1").mean)
    assert first.prior("M0").precision[0].tolist() == [0.0] * 5  # A is never shared


def test_a_record_without_pairs_gets_a_prior_on_a_too():
    dumb = replace(member("M9", FIELDS[0]), coefficients=np.zeros(0), covariance=np.zeros(0))
    prior = joint_compass.join_records([member("M0", FIELDS[0]), member("M1", FIELDS[1]), dumb]).prior("M9")
    sigma_deg = np.degrees(prior.precision[0, 0] ** -0.5)
    assert prior.mean[0] == pytest.approx(0.01) and 2.0 < sigma_deg < 3.0


def test_only_records_of_another_compass_are_rejected():
    rng, odd, lost = np.random.default_rng(3), 0, 0
    for _ in range(12):
        three = [member(f"M{k}", field, rng=rng) for k, field in enumerate(FIELDS)]
        lost += len(joint_compass.join_records(three).rejected)
        another = replace(three[0], coefficients=three[0].coefficients + ELSE)
        odd += [one.name for one in joint_compass.join_records([another, *three[1:]]).rejected] == ["M0"]
    assert (odd, lost) == (12, 0)


def test_two_inconsistent_records_are_both_rejected():
    two = [member("M0", FIELDS[0]), member("M1", FIELDS[1], off=60.0)]
    joined = joint_compass.join_records(two)
    assert {one.name for one in joined.rejected} == {"M0", "M1"} and joined.prior("M0") is None
    page, diagnosis = joint.join_compass("wh1", two, 0.5)
    assert page["coefficients"] is None and page["returned"] == {"M0": None, "M1": None}
    assert diagnosis.verdict == "insufficient"


def test_records_in_one_sphere_are_more_informative():
    alone = [member(f"M{k}", FIELDS[0]) for k in range(3)]
    together = [replace(one, sphere="s1") for one in alone]
    widths = [np.linalg.det(joint_compass.predict_compass(some[0], some[1:]).covariance) for some in (alone, together)]
    assert widths[1] < widths[0]


def told(z: float, *, season: float = 0.0, forms: tuple[str, ...] = ("TemperatureOfReading",)) -> EffectInformation:
    """Make the information on an effect of z standard errors whose column is correlated with a season."""
    size = len(forms) + noise.SEASON_COLUMNS
    information = np.eye(size) * 100.0
    information[0, len(forms)] = information[len(forms), 0] = 100.0 * season
    score = 10.0 * z * information[:, 0] / 100.0
    return EffectInformation(forms, np.ones(len(forms)), np.eye(len(forms)), information, score, 9.0, 900)


@pytest.mark.parametrize(
    ("scores", "season", "named"),
    [
        ((3.5, 3.5, 3.5), 0.0, True),  # significant only together
        ((0.5, -0.5, 0.3), 0.0, False),
        ((9.0, 0.0, 0.0), 0.0, False),  # only in one record
        ((3.5, 3.5, 3.5), 0.999, False),  # confounded with a seasonal current
    ],
)
def test_a_shared_effect_requires_joint_evidence_beyond_season(scores, season, named):
    members = [member(f"M{k}", FIELDS[k], effects=told(z, season=season)) for k, z in enumerate(scores)]
    found = joint.infer_shared(members)
    assert [one.kind.name for one in found.effects] == ["temperature"] * named
    if named:
        assert found.effects[0].finding.parameters["deg_K"].value == pytest.approx(0.35, abs=0.01)
        alone = joint.information_from_others(members[1:], found)["TemperatureOfReading"]
        assert alone[1] / alone[0][0] == pytest.approx([0.35], abs=0.01)


def test_effect_information_is_restored_from_json():
    first = told(2.0)
    written = member("M0", FIELDS[0], effects=first)
    again = joint_compass.mooring_member(json.loads(json.dumps(written.to_json())), "red")
    assert again.sphere == "red" and again.effects.forms == first.forms
    assert np.array_equal(again.effects.score, first.score) and np.array_equal(again.covariance, written.covariance)


def test_a_second_shared_effect_is_found_beside_the_first():
    both = [told(4.0, forms=("TemperatureOfReading", "Heeling")) for _ in range(3)]
    both = [replace(one, score=one.score + 40.0 * np.eye(len(one.score))[1]) for one in both]
    members = [member(f"M{k}", field, effects=one) for k, (field, one) in enumerate(zip(FIELDS, both, strict=True))]
    found = joint.infer_shared(members)
    assert sorted(one.kind.name for one in found.effects) == ["heeling", "temperature"]
    assert found.sides["compass"] > 0.99 and all(one.finding.held_out.gain > 10.0 for one in found.effects)


def test_amplitudes_by_each_record_alone_are_told():
    members = [member(f"M{k}", FIELDS[k], effects=told(z)) for k, z in enumerate((3.0, 4.0, 5.0))]
    (found,) = joint.infer_shared(members).effects
    assert [x[0] for x, _ in found.each.values()] == pytest.approx([0.3, 0.4, 0.5], abs=0.03)
    assert [sigma[0] for _, sigma in found.each.values()] == pytest.approx([0.1] * 3, abs=0.01)
    assert found.finding.parameters["deg_K"].sigma == pytest.approx(0.1 / 3**0.5, abs=0.005)


TRUE = (0.02, 0.25, -0.1, 0.02, -0.01)


def test_a_short_record_gains_from_the_prior_of_others():
    pairs, _ = sea.under_a_compass(TRUE, n=480, seed=4, spread=20.0)
    alone = fit_deviation("exact", pairs)
    precision = np.diag([0.0, *([0.01**-2.0] * 4)])
    beside = fit_deviation("exact", pairs, start_from_prior(CoefficientPrior(np.array(TRUE), precision), pairs))
    off = [np.abs(fit.coefficients - TRUE)[1:].max() for fit in (alone, beside)]
    assert off[1] < 0.03 < off[0]
    assert (np.sqrt(np.diag(beside.covariance))[1:] < 0.02).all()
    assert np.array_equal(fit_from_json(beside.to_json() | {"warnings": ()}).prior.mean, TRUE)


def test_no_size_of_a_shared_effect_is_excluded_a_priori():
    members = [member(f"M{k}", FIELDS[k], effects=told(3.5, forms=("TiltUncompensated",))) for k in range(3)]
    (found,) = joint.infer_shared(members).effects
    assert found.kind.name == "tilt_uncompensated"
    assert found.finding.parameters["share"].value == pytest.approx(0.35, abs=0.05)
