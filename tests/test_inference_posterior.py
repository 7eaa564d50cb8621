"""The posterior over hypotheses: what it sums to, what the alarm holds back, what it averages, what it leaves out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_inference_mooring import field_of, fitted, seen

from compasslib import angles
from compasslib.deviation.tilt import CompassSeries, average_compasses
from compasslib.effects import SIDES, SLOW_WATER
from compasslib.inference import design, inference, long_record, noise
from compasslib.inference.comparison import compare_pairs
from compasslib.types import Floats
from tests.world import pairs as world


def inferred(wanted, seed, n=6000, alarm=0.006):
    drawn = world.planted(world.make(seed, wide=True, n=n), wanted)
    case = compare_pairs(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn))
    empty = design.refit(design.evaluate_model(case, case.simulation, np.zeros(case.nuisance.shape[1])), [])
    return drawn, inference.infer(empty, alarm)


@pytest.fixture(scope="module")
def lobes():
    return inferred({"octantal": 3.0}, 8)


@pytest.fixture(scope="module")
def iron():
    return inferred({"hard_iron_drift": 2.0}, 5)


def test_probabilities_add_up(lobes, iron):
    for _, found in (lobes, iron):
        assert found.posterior.probability.sum() == pytest.approx(1.0)
        assert sum(found.posterior.sides().values()) == pytest.approx(1.0)
        assert found.posterior.water_probability.sum() == pytest.approx(1.0)
        for slot in found.slots:
            total = slot.probability + sum(slot.alternatives.values())
            assert 0.95 <= total <= 1.0 + 1e-9 and slot.effect not in slot.alternatives
            assert set(slot.alternatives) <= set(SIDES)


def test_what_is_there_is_the_likeliest_and_acts_on_its_side(lobes):
    drawn, found = lobes
    assert [slot.effect for slot in found.slots] == list(drawn.truth)
    assert found.posterior.sides()["compass"] > 0.99 and not found.slots[0].alternatives


def test_a_name_that_is_left_of_a_hypothesis_stands_in_its_water(lobes):
    """Names are taken back after the weighing: what stays need not be among the hypotheses that were kept."""
    _, found = lobes
    whole = found.posterior
    pair = next(one for one in whole.hypotheses if len(one) == 2)
    without = replace(
        whole,
        hypotheses=[pair if one == pair[:1] else one for one in whole.hypotheses],
    )
    assert pair[:1] not in without.hypotheses
    assert without.water_of(pair[:1]) in without.waters


def test_a_smaller_alarm_takes_names_away():
    _, found = inferred({"octantal": 1.0}, 8)
    _, careful = inferred({"octantal": 1.0}, 8, alarm=1e-15)
    assert found.slots and not careful.slots and careful.posterior.sides()["none"] > 0.9


def test_slow_water_is_the_rival_of_a_change_that_hardly_shows():
    _, found = inferred({"compass_drift": 3.0}, 6, n=4000)
    sides = found.posterior.sides()
    if found.slots:
        assert found.slots[0].alternatives.get(SLOW_WATER, 0.0) == pytest.approx(sides["none"], abs=0.06)
    else:
        assert sides["none"] + sides["water"] > 0.5


def test_columns_of_slow_water_have_the_variance_of_its_size(lobes):
    _, found = lobes
    slow = noise.slow_noise_basis(found.state.case)
    water = noise.SlowNoiseParams(noise.Process(3.0, 20.0), noise.Process(0.0, 5.0))
    count = len(slow.frequency)
    square = slow.columns[:, :count] ** 2 @ slow.variances(water)[:count]
    # What is faster than eight days is missing; both ends of the recording have more than their share.
    assert 0.85 * 9.0 < np.mean(square) < 1.1 * 9.0


def test_tides_that_differ_between_the_depths_turn_directions_as_their_waves_do(lobes):
    drawn, found = lobes
    slow, pairs = noise.slow_noise_basis(found.state.case), drawn.pairs
    waves = slow.columns[:, 3 * len(slow.frequency) :]
    moon = np.sin(2.0 * np.pi * (pairs.time_s - pairs.time_s[0]) / 3600.0 / 12.4206)
    still = angles.direction(pairs.lower_east, pairs.lower_north)
    turned = angles.difference(angles.direction(pairs.lower_east + 0.01 * moon, pairs.lower_north), still)
    fast = np.hypot(pairs.lower_east, pairs.lower_north) > 0.05
    sizes, *_ = np.linalg.lstsq(waves[fast], turned[fast], rcond=None)
    assert sizes[0] == pytest.approx(0.01, rel=0.3) and np.abs(sizes[1:]).max() < 0.003


def test_days_that_were_left_out_confirm_what_is_there(lobes):
    _, found = lobes
    proof = long_record.cross_validate(found, 0)
    assert proof.method == "fifths" and proof.gain > 10.0 and proof.p_value < 0.01
    assert proof.rms_after_deg < proof.rms_before_deg


def test_what_lives_in_one_fifth_is_held_out_within_it(lobes):
    _, found = lobes
    last = found.state.case.scene.time_s[int(0.9 * len(found.state.case))]
    (kind,) = (term for term in found.state.case.terms if term.name == "heading_slip")
    k = next(k for k, group in enumerate(found.posterior.candidates.groups) if type(group.term) is kind)
    late = replace(
        found,
        state=design.refit(found.state, [kind(offset_deg=1.0, date_s=float(last))]),
        chosen=(k,),
        slots=(replace(found.slots[0], effect="heading_slip"),),
    )
    assert long_record.cross_validate(late, 0).method == "within_event"


def compass_off_by(
    deg: float, sigma_deg: float, weight: float, others: tuple[CompassSeries, ...] = ()
) -> CompassSeries:
    def turned(heading_deg: Floats) -> Floats:
        return np.ones((len(heading_deg), 1))

    reading = np.arange(0.0, 360.0, 30.0) + deg
    return CompassSeries(reading, np.zeros(5), np.array([[sigma_deg**2]]), turned, weight=weight, others=others)


def test_an_even_contest_moves_the_heading_half_way_and_says_so():
    at = compass_off_by(0.0, 1.0, 0.5, (compass_off_by(4.0, 1.0, 0.5),))
    made = average_compasses(at, np.arange(0.0, 360.0, 30.0))
    assert made.shift_deg == pytest.approx(2.0, abs=1e-9)
    assert made.sigma_deg == pytest.approx(np.hypot(1.0, 2.0))
    assert np.all(made.agreed == 0.5)  # they are four standard errors apart
    sure = average_compasses(replace(at, weight=0.97, others=(compass_off_by(4.0, 1.0, 0.03),)), np.zeros(12))
    assert np.all(sure.agreed > 0.9) and np.all(np.abs(angles.wrap180(sure.shift_deg)) < 0.2)


def test_noise_is_told_with_its_errors():
    _, found = seen({})
    told = found.to_json()["noise"]
    assert set(told) == {"white_deg", "short_hours", "slow_rms_deg", "slow_memory_days", "slow_shear_m_s"}
    assert all(one["value"] >= 0.0 and one["sigma"] >= 0.0 for one in told.values())
    assert 5.0 < told["white_deg"]["value"] < 20.0 and told["slow_rms_deg"]["value"] < 2.0
