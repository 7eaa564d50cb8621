"""Would catch wrong branches, headings or velocities, an uncertainty too small, an assessment of seen pairs."""

from dataclasses import replace

import netCDF4
import numpy as np
import pytest

from compasslib import angles
from compasslib.archive import netcdf
from compasslib.archive.attributes import Site
from compasslib.deviation import deviation_json, find_implausibility
from compasslib.deviation.assessment import assess_correction, vector_correlation
from compasslib.deviation.average import compass_series
from compasslib.deviation.branches import MERGED_DEG, MotionModel, WaterTurns, _water_turns, forward_backward
from compasslib.deviation.correction import (
    MIN_PROBABILITY,
    correct,
    correct_headings,
    correct_in_pieces,
    readings_at_pairs,
    tilted_iron_sigma,
)
from compasslib.deviation.doubts import doubt_whole_record
from compasslib.deviation.exact import fit_exact
from compasslib.deviation.likelihood import CELL_CENTRES, CELLS
from compasslib.deviation.model import IRON_SIGMA_NT, unfitted
from compasslib.deviation.series import fit_series
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_BAD, take
from tests.world.products import measured
from tests.world.sea import FOLDED, MILD, field_of, pairs, record_of


@pytest.fixture(scope="module")
def folded():
    seen, heading = pairs(FOLDED, n=4000, seed=4)
    return seen, heading, fit_exact(seen)


def test_mild_record_is_corrected_within_its_stated_uncertainty():
    seen, heading = pairs(MILD, n=4000, seed=3)
    product = correct(record_of(seen), fit_exact(seen), field_of(seen), seen)
    off = angles.difference(product.heading_corrected_deg, heading)
    assert angles.rms(off) < 2.5 < angles.rms(angles.difference(seen.heading_deg, heading))
    assert np.mean(np.abs(off) < 1.96 * product.heading_uncertainty_deg) > 0.9
    assert (product.heading_corrected_quality == GOOD).all()


@pytest.mark.parametrize(("horizontal_nT", "vertical_nT"), [(12_000.0, 48_000.0), (6_000.0, 55_000.0), (30_000.0, 0.0)])
def test_uncertainty_by_tilt_is_twice_that_of_vertical_iron(horizontal_nT, vertical_nT):
    """At random headings, in a weak field as at the equator."""
    seen, _ = pairs(MILD, n=2000)
    way, rng = np.arange(2000) * 0.1, np.random.default_rng(0)
    record = replace(record_of(seen), pitch_deg=5.0 * np.cos(way), roll_deg=5.0 * np.sin(way))
    field = replace(field_of(seen), horizontal_nT=0 * way + horizontal_nT, vertical_nT=0 * way + vertical_nT)
    iron_nT = IRON_SIGMA_NT * rng.normal(size=2000) + 0.01 * vertical_nT * rng.normal(size=2000)
    leaning = np.sin(np.deg2rad(record.pitch_deg)) + 1j * np.sin(np.deg2rad(record.roll_deg))
    turned = np.angle(horizontal_nT + iron_nT * leaning * np.exp(1j * rng.uniform(0, 2 * np.pi, 2000)), deg=True)
    assert np.mean(tilted_iron_sigma(record, field)) == pytest.approx(2.0 * turned.std(), rel=0.1)


def test_corrected_velocity_is_the_recorded_one_turned_by_deviation_and_declination():
    seen, _ = pairs(MILD, n=400)
    product = correct(record_of(seen), fit_exact(seen), field_of(seen, 18.0), seen)
    speed = np.hypot(product.east_recorded, product.north_recorded)
    assert np.hypot(product.east, product.north) == pytest.approx(speed)
    before = angles.direction(seen.upper_east, seen.upper_north)
    after = angles.direction(product.east[:, 0], product.north[:, 0])
    assert np.abs(angles.difference(after - before, product.deviation_deg + 18.0)).max() < 1e-6
    turned = np.deg2rad(product.heading_uncertainty_deg)[:, None]  # an error of the direction acts across the velocity
    across = np.abs(np.stack([product.north, product.east])) * turned
    off = np.stack([product.east_uncertainty, product.north_uncertainty]) - across
    assert (np.abs(off) < turned**2 * speed).all()


def test_correction_in_pieces_yields_the_same_file(tmp_path, monkeypatch):
    seen, _ = pairs(MILD, n=400)
    record = replace(record_of(seen), **measured(400, 1))
    asked = (record, fit_exact(seen), field_of(seen, 18.0), seen)
    monkeypatch.setattr("compasslib.records.PIECE", 150)
    several = correct_in_pieces(*asked)
    assert [len(piece.record.time_s) for piece in several] == [150, 150, 100]
    for name, product in (("whole.nc", correct(*asked)), ("pieces.nc", several)):
        netcdf.write_corrected(tmp_path / name, product, site=Site("M", 60.0, -30.0))
    with netCDF4.Dataset(tmp_path / "whole.nc") as one, netCDF4.Dataset(tmp_path / "pieces.nc") as other:
        assert list(one.variables) == list(other.variables) and str(one.__dict__) == str(other.__dict__)
        for name in one.variables:
            np.testing.assert_array_equal(one[name][...], other[name][...], err_msg=name)
            assert str(one[name].__dict__) == str(other[name].__dict__)


def test_branches_of_a_folded_compass_are_resolved(folded):
    seen, heading, fit = folded
    product = correct(record_of(seen), fit, field_of(seen), seen)
    off = np.abs(angles.difference(product.heading_corrected_deg, heading))
    assert np.isfinite(off).all() and np.median(off) < 3.0
    sure = product.branch_probability >= MIN_PROBABILITY
    assert 0.7 < sure.mean() < 1.0 and np.mean(off[sure] < 40.0) > 0.94
    assert (product.heading_corrected_quality[~sure] == PROBABLY_BAD).all()


def test_branches_with_two_overlaps_a_day_and_a_gap_of_a_week(folded):
    seen, heading, fit = folded
    kept = np.ones(len(seen), dtype=bool)
    kept[1000:1168] = False
    few = take(seen, np.flatnonzero(np.arange(len(seen)) % 12 == 0))
    few = take(few, np.isin(few.time_s, seen.time_s[kept]))
    decision = correct_headings(take(readings_at_pairs(seen), kept), fit, few)
    off = np.abs(angles.difference(decision.heading_deg, heading[kept]))
    two = np.isfinite(decision.other_deg)
    assert np.median(off) < 4.0
    right = off <= np.abs(angles.difference(decision.other_deg, heading[kept]))
    assert abs(decision.probability[two].mean() - right[two].mean()) < 0.05  # probabilities are calibrated


def test_posterior_is_normalized_and_forgets_over_a_long_gap():
    evidence = np.ones((3, CELLS))
    evidence[0, 10] = 1e9
    flat = np.full(CELLS, 1.0 / CELLS)
    habit = MotionModel(width_deg=6.0, water_m_s=10.0, leaps=0.01)
    near, far = (
        forward_backward(evidence, WaterTurns(np.array([1.0, gap]), np.zeros(2), np.zeros(2)), habit, flat)
        for gap in (1.0, 5000.0)
    )
    assert near.sum(axis=1) == pytest.approx(np.ones(3))
    assert near[2, 10] > 5 * flat[0] and far[2] == pytest.approx(flat)


def test_an_instrument_turning_in_steady_flow_is_followed():
    """If it turns clockwise by 30 degrees, the flow turns by -30 in its frame, and the heading changes by +30."""
    heading = np.array([40.0, 70.0])
    water = 0.4 * angles.phasor(200.0 - heading)
    evidence = np.ones((2, CELLS))
    evidence[0] = np.exp(-0.5 * (angles.difference(CELL_CENTRES, 40.0) / 4.0) ** 2)
    flat = np.full(CELLS, 1.0 / CELLS)
    moves = _water_turns(np.array([0.0, 3600.0]), water)
    posterior = forward_backward(evidence, moves, MotionModel(80.0, 0.03, 0.003), flat)
    assert angles.mean(CELL_CENTRES, weights=posterior[1]) == pytest.approx(70.0, abs=3.0)


def test_published_method_yields_nan_outside_its_invertible_range():
    seen, _ = pairs((0.0, 1.1, 0.7, 0.0, 0.0), n=3000, spread=35.0, seed=3)
    fit = fit_series(seen)
    product = correct(record_of(seen), fit, field_of(seen), seen)
    lost = ~np.isfinite(product.heading_corrected_deg)
    assert fit.folded and lost.any()
    assert (product.heading_corrected_quality[lost] == BAD).all()
    assert np.isnan(product.east[lost]).all() and np.isfinite(product.east_recorded[lost]).all()


@pytest.mark.parametrize("method", ["exact", "von_appen"])
def test_without_a_fit_headings_are_nan_and_flagged_bad(method):
    seen, _ = pairs(n=5)
    fit = unfitted(method, 5)
    product = correct(record_of(seen), fit, field_of(seen), seen)
    assert np.isnan(product.heading_corrected_deg).all() and (product.heading_corrected_quality == BAD).all()
    verdict = assess_correction(seen, fit)
    assert verdict["before"]["n"] == 5 and verdict["after"]["n"] == 0
    assert deviation_json(fit, record_of(seen))["correctable_fraction"] == 0.0


def test_missing_velocities_stay_missing_and_bad_headings_are_not_corrected():
    seen, _ = pairs(MILD, n=400)
    record = record_of(seen)
    quality, heading = record.quality.copy(), record.heading_quality.copy()
    quality[3], heading[5] = MISSING, BAD
    changed = replace(record, quality=quality, heading_quality=heading)
    product = correct(changed, fit_exact(seen), field_of(seen), seen)
    assert product.velocity_quality[3, 0] == MISSING
    assert np.isnan(product.heading_corrected_deg[5]) and product.velocity_quality[5, 0] == BAD


def test_vector_correlation_angle_is_the_turn_of_the_upper_water():
    lower = np.array([0.1 + 0.2j, -0.3 + 0.1j, 0.2 - 0.2j])
    found = vector_correlation(lower * angles.phasor(-30.0), lower)  # clockwise by 30 degrees
    assert found == {"magnitude": pytest.approx(1.0), "angle_deg": pytest.approx(30.0)}


READ_WRONGLY = {"exchanged": lambda z: 1j * np.conj(z), "both signs": np.negative, "sign of north": np.conj}


@pytest.mark.parametrize(
    ("iron", "mistake"), [(MILD, "exchanged"), (FOLDED, "exchanged"), (MILD, "both signs"), (FOLDED, "sign of north")]
)
def test_no_heading_is_good_where_the_reference_is_read_wrongly(iron, mistake):
    seen, _ = pairs(iron, n=600, seed=31)
    velocity = READ_WRONGLY[mistake](seen.lower_east + 1j * seen.lower_north)
    wrong = replace(seen, lower_east=velocity.real, lower_north=velocity.imag)
    fit, record = fit_exact(wrong), record_of(wrong)
    said = find_implausibility(fit, record) or assess_correction(wrong, fit)["refuted"]
    assert "flagged doubtful" in said
    denied = [doubt_whole_record(angles.UNIFORM_SIGMA_DEG, said)]
    product = correct(record, fit, field_of(wrong), wrong, doubts=denied)
    assert (product.heading_corrected_quality >= PROBABLY_BAD).all()
    assert (product.heading_uncertainty_deg > 100.0).all()


def test_a_reading_outside_the_recorded_range_is_flagged(folded):
    seen, _, fit = folded
    low, high = fit.recorded_range_deg
    outside = angles.wrap360(high + (360.0 - (high - low)) / 2.0)
    record = record_of(seen)
    heading = np.where(np.arange(len(seen)) % 50 == 7, outside, record.heading_deg)
    product = correct(replace(record, heading_deg=heading), fit, field_of(seen), seen)
    assert (product.heading_corrected_quality[heading == outside] == PROBABLY_BAD).all()
    assert not find_implausibility(fit, record)
    never = replace(record, heading_deg=np.full(len(seen), outside))
    assert "cannot have recorded 100%" in find_implausibility(fit, never)


def test_both_roots_stay_possible_if_pairs_hardly_determine_the_branch(folded):
    seen, heading, fit = folded
    told = replace(fit, noise=replace(fit.noise, floor_deg=60.0))  # scatter that hides the difference of the branches
    product = correct(record_of(seen), told, field_of(seen), seen)
    roots = compass_series(told, readings_at_pairs(seen)).roots()
    two = np.abs(angles.difference(roots[:, 0], roots[:, 1])) > 2.0 * MERGED_DEG
    assert two.sum() > 100 and (product.heading_corrected_quality[two] == PROBABLY_BAD).all()
    off = np.abs(angles.difference(product.heading_corrected_deg, heading))[two]
    assert np.mean(off < 1.96 * product.heading_uncertainty_deg[two]) > 0.95


def test_uncertainty_from_pairs_of_a_few_days_covers_the_error():
    covered = []
    for seed in range(11, 16):
        seen, heading = pairs(MILD, n=1000, seed=seed)
        few = take(seen, slice(0, 80))
        product = correct(record_of(seen), fit_exact(few), field_of(seen), few)
        off = np.abs(angles.difference(product.heading_corrected_deg, heading))
        covered.append(np.mean(off < 1.96 * product.heading_uncertainty_deg))
    assert min(covered) > 0.85


def test_agreement_no_better_than_with_other_days_refutes_the_correction():
    seen, _ = pairs(MILD, n=3000, seed=5)
    flow = angles.direction(seen.lower_east, seen.lower_north)
    # A dominant mean flow reduces the scatter of unrelated directions.
    seen = take(seen, np.abs(angles.difference(flow, angles.mean(flow))) < 110.0)
    other = replace(seen, lower_east=np.roll(seen.lower_east, 700), lower_north=np.roll(seen.lower_north, 700))
    own, strange = (assess_correction(x, fit_exact(x)) for x in (seen, other))
    assert own["refuted"] == "" and own["after"]["rms_deg"] < own["rms_of_other_days_deg"]
    assert "of other days" in strange["refuted"]
