"""The posterior over hypotheses: normalization, prior odds, slow noise, held-out days, model averaging."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_inference_mooring import bench, diagnose, field_of, fitted, seen, state_of

from compasslib import angles
from compasslib.deviation.tilt import CompassSeries, average_compasses
from compasslib.effects import SIDES, SLOW_WATER
from compasslib.inference import design, heldout, inference, noise, posterior, weighing
from compasslib.inference.current import infer_current
from tests.world import pairs as world


def inferred(wanted, seed, n=6000):
    drawn = world.planted(world.make(seed, wide=True, n=n), wanted)
    return drawn, inference.infer(design.refit(state_of(drawn), []), 1.0)


@pytest.fixture(scope="module")
def lobes():
    return inferred({"octantal": 3.0}, 8)


@pytest.fixture(scope="module")
def iron():
    return inferred({"hard_iron_drift": 2.0}, 5, n=2500)


def test_probabilities_add_up(lobes, iron):
    for _, found in (lobes, iron):
        assert found.posterior.probability.sum() == pytest.approx(1.0)
        assert sum(found.posterior.sides().values()) == pytest.approx(1.0)
        assert found.posterior.water_probability.sum() == pytest.approx(1.0)
        for slot in found.finding_posteriors:
            total = slot.probability + sum(slot.alternatives.values())
            assert 0.95 <= total <= 1.0 + 1e-9 and slot.effect not in slot.alternatives
            assert {name for name in slot.alternatives if not name.startswith("composed:")} <= set(SIDES)


def test_the_true_effect_and_its_side_are_most_probable(lobes):
    drawn, found = lobes
    assert [slot.effect for slot in found.finding_posteriors] == list(drawn.truth)
    assert found.posterior.sides()["compass"] > 0.99


def test_slow_water_is_found_for_a_hypothesis_not_retained(lobes):
    """Effects are withdrawn after the weighing: the remaining ones may not be among the retained hypotheses."""
    _, found = lobes
    whole = found.posterior
    pair = next(one for one in whole.hypotheses if len(one) == 2)
    without = replace(whole, hypotheses=[pair if one == pair[:1] else one for one in whole.hypotheses])
    assert pair[:1] not in without.hypotheses
    assert without.water_of(pair[:1]) in without.waters


def test_prior_odds_change_probabilities_but_not_statements(lobes):
    """Statements depend on the Bayes factor; the prior odds of a fault are one setting, divided over the effects."""
    _, found = lobes
    candidates, waters = found.posterior.candidates, found.posterior.waters
    even, rare = (weighing.compute_posterior(candidates, odds, waters) for odds in (1.0, 1e-6))
    assert rare.stated_count == even.stated_count == 1 and rare.best == even.best
    faults = [one.sides()["compass"] for one in (even, rare)]
    odds = np.array(faults) / (1.0 - np.array(faults) + 1e-300)
    assert odds[1] / odds[0] == pytest.approx(1e-6, rel=0.01) or faults[1] > 0.999
    alone = posterior.log_shares(candidates.kinds)
    of_faults = [k for k, kind in enumerate(candidates.kinds) if kind.side != "reference" and not kind.always_present]
    listed = [k for k in of_faults if not candidates.kinds[k].name.startswith("composed")]
    each = [alone[k] + candidates.shares[k] for k in listed]
    assert np.exp(each).sum() == pytest.approx(2.0 / 3.0)  # the other third is that of composed effects


def test_a_veering_current_is_stated_by_its_driver():
    _, found = seen({"current_veer": 4.0}, seed=14)
    assert found.verdict in ("explained", "ambiguous") and not found.findings and found.sides["water"] > 0.5
    written = found.to_json()["current"]
    assert {one["level"] for one in written} <= {"driver", "side"} and written[0]["unit"] == "degrees"
    assert written[0]["driver"] == "speed" and written[0]["low"] < 4.0 < 1.3 * written[0]["high"]
    assert not found.applied or not any(one.compass for one in found.applied[:1] if one.effect == "none")


@pytest.mark.parametrize("driver", ["tide", "tilt"])
@pytest.mark.parametrize("acts_on", ["offset", "veer"])
def test_reading_and_current_with_the_same_driver_share_the_probability(acts_on, driver):
    """Both yield nearly the same pairs. Regression test: the current, treated as noise, took all of the probability."""
    made = world.make(3, wide=True, n=4000)
    series = {"tide": np.cos(2.0 * np.pi * made.hours / 12.4206), "tilt": made.tilt[1] - made.tilt[1].mean()}[driver]
    effect = world.Effect({}, **{acts_on: series if acts_on == "veer" else lambda gamma: series})
    drawn = world.planted(made, {driver: 3.0}, {driver: effect})
    fit, field = fitted(drawn), field_of(drawn)
    found = diagnose(drawn.pairs, drawn.covariates, fit, field)
    corrected, _ = bench.corrected(drawn, fit, field, found)
    off = np.abs(angles.difference(corrected.heading_deg, drawn.heading))
    assert np.mean(off < 1.96 * corrected.sigma_deg) > 0.9
    right = "compass" if acts_on == "offset" else "water"
    assert found.sides[right] > 0.2 and found.sides["compass"] + found.sides["water"] > 0.9
    contested = [stated for stated in found.current if stated.probability < 0.95]
    if contested:
        assert found.verdict == "ambiguous" and "second current meter" in found.separated_by
        assert contested[0].driver == driver and "whose reading follows" in contested[0].text


def test_an_uninformative_record_states_no_current():
    drivers = ("speed", "depth", "tide", "tilt", "motion", "flow_direction", "velocity_bias", "beam_gain")
    unknown = infer_current(drivers, 1e-9 * np.eye(8), np.zeros(8))
    assert unknown.acting == pytest.approx(0.5, abs=0.01)
    probability, stated = unknown.state(16.0 * np.eye(8), 0.5)
    assert probability < 0.51 and not stated
    known = infer_current(drivers, np.diag([1e3, *[1e-9] * 7]), np.array([1e3, *[0.0] * 7]))
    probability, stated = known.state(16.0 * np.eye(8), 0.5)
    assert probability > 0.95 and stated[0].driver == "speed" and 3.5 < stated[0].size_deg < 4.5


def test_slow_noise_is_the_alternative_to_a_weak_drift():
    _, found = inferred({"compass_drift": 3.0}, 6, n=4000)
    sides = found.posterior.sides()
    if found.finding_posteriors:
        assert found.finding_posteriors[0].alternatives.get(SLOW_WATER, 0.0) == pytest.approx(sides["none"], abs=0.06)
    else:
        assert sides["compass"] < weighing.STATED * (sides["none"] + sides["water"])


def test_slow_noise_columns_have_the_variance_of_the_process(lobes):
    _, found = lobes
    slow = noise.slow_noise_basis(found.state.case)
    water = noise.SlowNoiseParams(noise.Process(3.0, 20.0), noise.Process(0.0, 5.0))
    count = len(slow.frequency)
    square = slow.columns[:, :count] ** 2 @ slow.variances(water)[:count]
    # Periods below eight days are not represented; the variance is larger at both ends of the recording.
    assert 0.85 * 9.0 < np.mean(square) < 1.1 * 9.0


def test_tidal_columns_represent_tidal_shear(lobes):
    drawn, found = lobes
    slow, pairs = noise.slow_noise_basis(found.state.case), drawn.pairs
    waves = slow.columns[:, 3 * len(slow.frequency) : -len(slow.drivers)]
    moon = np.sin(2.0 * np.pi * (pairs.time_s - pairs.time_s[0]) / 3600.0 / 12.4206)
    still = angles.direction(pairs.lower_east, pairs.lower_north)
    turned = angles.difference(angles.direction(pairs.lower_east + 0.01 * moon, pairs.lower_north), still)
    fast = np.hypot(pairs.lower_east, pairs.lower_north) > 0.05
    sizes, *_ = np.linalg.lstsq(waves[fast], turned[fast], rcond=None)
    assert sizes[0] == pytest.approx(0.01, rel=0.3) and np.abs(sizes[1:]).max() < 0.003


def test_held_out_days_confirm_a_true_effect(lobes, monkeypatch):
    _, found = lobes
    made, predict = [], heldout._PartitionedRecord.predict
    monkeypatch.setattr(heldout._PartitionedRecord, "predict", lambda *given: made.append(given) or predict(*given))
    proof = heldout.cross_validate(found, 0, design.refit(found.state, []), surrogates=19)
    # No day enters its own prediction: other residuals in the first fold change only predictions of the other folds.
    record, white, targets, choices = made[0]
    other = np.where(record.folds[0][:, None], -targets, targets)
    before, after = (predict(record, white, each, choices).values for each in (targets, other))
    assert np.allclose(before[0], after[0], rtol=1e-6, atol=1e-9) and not np.allclose(before[1:], after[1:], rtol=0.01)
    points, slope = proof.points, proof.slope.value
    assert np.allclose(points.after_deg, points.before_deg - points.centre) and len(points.centre) == 8
    assert np.sum((points.before_deg - slope * points.centre) ** 2 / points.sigma_deg**2) < 20.0  # 8 points, 1 slope
    assert np.all(slope * points.centre[[0, 1, -2, -1]] / points.sigma_deg[[0, 1, -2, -1]] * [-1, -1, 1, 1] > 2.0)
    assert abs(slope - 1.0) < 0.1 and proof.slope.high - proof.slope.low < 0.5
    assert proof.method == "fifths" and proof.gain > 10.0 and proof.p_value < 0.01
    assert proof.rms_after_deg < proof.rms_before_deg
    assert proof.placebo.n == 19 and proof.placebo.rank_p == 0.05 and proof.confirmed  # no surrogate gains as much
    assert proof.anew.low > 0.0 and proof.slope.low < 1.0 < proof.slope.high
    assert 2.0 < proof.amplitude.low < proof.amplitude.fitted_elsewhere < proof.amplitude.high < 4.0


def test_an_event_within_one_fold_is_held_out_within_it(lobes):
    _, found = lobes
    last = found.state.case.scene.time_s[int(0.9 * len(found.state.case))]
    (kind,) = (term for term in found.state.case.terms if term.name == "heading_slip")
    k = next(k for k, group in enumerate(found.posterior.candidates.groups) if type(group.term) is kind)
    late = replace(
        found,
        state=design.refit(found.state, [kind(offset_deg=1.0, date_s=float(last))]),
        chosen=(k,),
        finding_posteriors=(replace(found.finding_posteriors[0], effect="heading_slip"),),
    )
    proof = heldout.cross_validate(late, 0, design.refit(late.state, []), surrogates=0)
    assert proof.method == "within_event" and proof.placebo.rank_p is None and not proof.confirmed


def compass_off_by(deg: float, weight: float, others: tuple[CompassSeries, ...] = ()) -> CompassSeries:
    """Make a compass without deviation whose reading is off by a constant, with a standard error of 1°."""
    reading = np.arange(0.0, 360.0, 30.0) + deg
    turned = lambda heading_deg: np.ones((len(heading_deg), 1))  # noqa: E731
    return CompassSeries(reading, np.zeros(5), np.eye(1), turned, weight=weight, others=others)


def test_equal_weights_average_headings_and_widen_sigma():
    at = compass_off_by(0.0, 0.5, (compass_off_by(4.0, 0.5),))
    made = average_compasses(at, np.arange(0.0, 360.0, 30.0))
    assert made.shift_deg == pytest.approx(2.0, abs=1e-9)
    assert made.sigma_deg == pytest.approx(np.hypot(1.0, 2.0))
    assert np.all(made.agreed == 0.5)  # they are four standard errors apart
    sure = average_compasses(replace(at, weight=0.97, others=(compass_off_by(4.0, 0.03),)), np.zeros(12))
    assert np.all(sure.agreed > 0.9) and np.all(np.abs(angles.wrap180(sure.shift_deg)) < 0.2)
