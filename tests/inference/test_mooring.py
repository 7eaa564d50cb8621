"""Would catch an effect of a half-year mooring missed, misnamed or invented."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from benchmarks import discrepancy as bench
from benchmarks.discrepancy import field_of, fitted
from compasslib import angles, compass
from compasslib.archive.files import read_json, write_json
from compasslib.demo import demonstration
from compasslib.deviation import fit_deviation
from compasslib.deviation.average import average_coefficients
from compasslib.deviation.model import DeviationFit, nearest_root, pair_speeds, unfitted
from compasslib.effects.composed import compose_effect
from compasslib.effects.forward import ForwardModel
from compasslib.inference import covariates, diagnosis, long_record
from compasslib.inference import finding as findings
from compasslib.inference import product as products
from compasslib.inference.comparison import Options, compare_pairs
from compasslib.inference.kinds import mooring
from compasslib.inference.kinds.mooring import diagnose
from compasslib.preparation.pairs import find_pairs
from compasslib.records import EarthField, Pairs, take
from tests.world import chain
from tests.world import pairs as world
from tests.world.diagnosed import HOURS, diagnosed, every_second, seen, state_of
from tests.world.layers import ALL_NEAR, BINS, CELL_M, FIELD, layers
from tests.world.layers import seen as profile_and_cell
from tests.world.pairs import red_from_rest as red_noise
from tests.world.sea import FOLDED, MILD, pairs, plain_record, real

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def two():
    return seen({"sextantal": 3.0, "temperature": 3.0}, seed=4)


def test_a_mooring_without_effects_is_consistent():
    _, found = seen({})
    assert found.verdict == "consistent" and not found.findings and found.unexplained is None
    assert found.experiments == ()
    assert found.applied[0].compass is None and found.applied[0].weight > 0.5
    assert 0.2 < found.detectable_deg["sextantal"] < 4.0 and found.why.startswith(
        "Effects are detected with a probability of 90 % from "
    )
    told = dict(found.not_testable)
    assert "both compasses alike" in told["field_disturbance"] and "separated from A" in told["declination_error"]
    assert "current_veer" not in found.detectable_deg and not told.keys() & found.detectable_deg.keys()
    noise = found.to_json()["noise"]
    assert set(noise) == {"white_deg", "short_hours", "slow_rms_deg", "slow_memory_days", "slow_shear_m_s"}
    assert all(one["value"] >= 0.0 and one["sigma"] >= 0.0 for one in noise.values())
    assert 5.0 < noise["white_deg"]["value"] < 20.0 and noise["slow_rms_deg"]["value"] < 2.0


def test_no_effect_is_both_tested_and_not_testable(two):
    """``Diagnosis`` enforces this itself, whichever function builds it."""
    _, found = two
    tested = {*found.detectable_deg, *(one.effect for one in found.findings)}
    every = tuple((name, "no series") for name in [*tested, "field_disturbance"])
    again = replace(found, not_testable=every)
    assert again.not_testable == (("field_disturbance", "no series"),)
    limited = replace(diagnosis.insufficient("", every), detectable_deg={"field_disturbance": 1.0})
    assert limited.not_testable == every[:-1]
    assert [one["effect"] for one in again.to_json()["not_testable"]] == ["field_disturbance"]


def test_residual_follows_the_turn_predicted_by_each_effect(two):
    _, found = two
    turns = [curve for curve in found.curves if curve.covariate.startswith("turn_by_")]
    assert {curve.covariate for curve in turns} == {f"turn_by_{one.effect}" for one in found.findings}
    for curve in turns:
        assert np.all(np.diff(curve.centre) > 0.0) and np.ptp(curve.centre) > 4.0
        slope = np.polyfit(curve.centre, curve.before_deg, 1)[0]
        assert slope == pytest.approx(1.0, abs=0.15)
        assert abs(np.polyfit(curve.centre, curve.after_deg, 1)[0]) < 0.15


def test_residual_bins_without_effects_scatter_by_their_sigma():
    far = []
    for seed in range(4):
        state = state_of(world.planted(world.make(seed, wide=True, n=HOURS), {}))
        curves = [
            long_record.residual_curve(state, state, name) for name in ("time", "heading", "speed", "supply_voltage")
        ]
        far += [curve.after_deg / curve.sigma_deg for curve in curves]
    far = np.abs(np.concatenate(far))
    # About 250 bins, correlated as they share days: 5 % are expected beyond 1.96, one in a thousand beyond 3.3.
    assert 0.01 < np.mean(far > 1.96) < 0.1 and far.max() < 4.5


def test_samples_of_infinite_width_have_no_heading_bin():
    drawn = world.planted(world.make(0, wide=True, n=HOURS), {})
    state = state_of(drawn)
    lost = (drawn.pairs.heading_deg >= 60.0) & (drawn.pairs.heading_deg < 80.0)
    width = np.where(lost, np.inf, state.whitener.width_deg)
    folded = replace(state, whitener=replace(state.whitener, width_deg=width))
    all_round, without = (long_record.residual_curve(state, x, "heading") for x in (state, folded))
    assert set(all_round.centre) - set(without.centre) == {65.0, 75.0} and without.sigma_deg.max() < 30.0


def test_two_simultaneous_effects_are_identified_and_estimated(two):
    drawn, found = two
    assert found.verdict in ("explained", "ambiguous")
    assert {finding.effect for finding in found.findings} == {"sextantal", "temperature"}
    for finding in found.findings:
        assert finding.held_out.p_value < 0.01 and finding.held_out.gain_interval[0] > 0.0
        for name, value in drawn.truth[finding.effect].items():
            if name in finding.parameters:  # within four of its own standard errors
                assert abs(finding.parameters[name].value - value) < 4.0 * finding.parameters[name].sigma
    sizes = [finding.rms_effect_deg for finding in found.findings]
    assert sizes == sorted(sizes, reverse=True) and min(sizes) > 2.0


def test_correction_removes_the_identified_effects(two):
    drawn, found = two
    sample, applied = drawn.pairs, found.applied[0].compass
    tilt, recorded = (sample.pitch_deg, sample.roll_deg), sample.heading_deg
    scene = applied.scene(sample.time_s, recorded, tilt, drawn.covariates, field=field_of(drawn))
    at = applied.along(scene, recorded)
    after = nearest_root(at.roots(), drawn.heading)
    level = compass.inverse(fitted(drawn).coefficients, recorded)
    before = nearest_root(level, drawn.heading)
    error = [angles.rms(angles.difference(heading, drawn.heading)) for heading in (before, after)]
    assert error[0] > 3.5 and error[1] < 1.5
    sigma = at.sigma(after)
    assert 0.2 < np.median(sigma) < 4.0


def test_applied_covariance_is_not_smaller_than_that_of_the_fit_with_the_same_priors(two):
    _, found = two
    of_fit = average_coefficients(found.fit.coefficients, found.fit.covariance, found.fit)[1]
    more = found.applied[0].compass.covariance[:5, :5] - of_fit
    assert np.linalg.eigvalsh(more).min() > -0.03 * np.trace(of_fit)


def test_a_coefficient_that_an_effect_leaves_free_is_limited_by_its_prior():
    fit = DeviationFit(
        "exact", 1000, np.array([0.02, 0.0, -0.05, 0.0, 0.0]), np.diag([0.03, 0.02, 0.02, 0.01, 0.01]) ** 2
    )
    covariance = np.diag([0.15, 0.02, 0.02, 0.01, 0.01, 0.5]) ** 2
    covariance[0, 5] = covariance[5, 0] = -0.9 * 0.15 * 0.5  # A beside an effect that turns all headings nearly alike
    parameters = np.array([0.17, 0.0, -0.05, 0.0, 0.0, -1.0])
    mean, averaged, _, _ = average_coefficients(parameters, covariance, fit)
    assert abs(mean[0]) < 0.09 and averaged[0, 0] < 0.6 * covariance[0, 0]
    assert mean[5] - parameters[5] == pytest.approx(-0.9 * 0.5 / 0.15 * (mean[0] - parameters[0]), rel=0.05)
    assert averaged[5, 5] < covariance[5, 5] and np.linalg.eigvalsh(averaged).min() > 0.0


def test_priors_do_not_make_an_effect_impossible():
    """Regression test: readings whose effect the priors made ambiguous lost every heading of the record."""
    fit = DeviationFit(
        "exact", 1000, np.array([0.02, 0.0, -0.05, 0.0, 0.0]), np.diag([0.03, 0.02, 0.02, 0.01, 0.01]) ** 2
    )
    term = compose_effect("reading", "heading", "teeth")()
    largest = max(x for x in np.arange(0.5, 30.0, 0.5) if term.at(np.append(x, np.zeros(33))).possible)
    covariance = np.diag([0.15, 0.02, 0.02, 0.01, 0.01, 3.0, *[0.1] * 33]) ** 2
    covariance[0, 5] = covariance[5, 0] = -0.9 * 0.15 * 3.0
    simulation = ForwardModel(
        np.array([0.17, 0.0, -0.05, 0.0, 0.0]), 12000.0, (term.at(np.append(largest, np.zeros(33))),)
    )
    member = products.WeightedCompass(1.0, term.name, products.AppliedCompass(simulation, covariance, {}, ()))
    assert all(term.possible for term in products.with_priors(member, fit).compass.simulation.terms)


def test_diagnosis_json_has_the_specified_keys(two, tmp_path):
    _, found = two
    write_json(tmp_path / "diagnosis.json", found.to_json())
    told = read_json(tmp_path / "diagnosis.json")
    assert set(told) >= {"verdict", "findings", "unexplained", "separated_by", "not_testable", "negligible"}
    first = told["findings"][0]
    keys = {"effect", "side", "alternatives", "where", "when", "parameters", "rms_effect_deg", "heldout", "text"}
    assert set(first) >= keys and set(first["where"]) == {"covariate", "from", "to", "text"}
    assert set(first["heldout"]) >= {"rms_before_deg", "rms_after_deg", "p_value"}
    assert first["when"]["from"].endswith("Z")


def test_missing_tilt_compensation_is_distinguished_from_heeling_iron():
    sea = world.make(2, wide=True, n=HOURS)
    recorded = world.compass(sea, uncompensated=True)
    drawn = world.planted(sea, {})
    east, north = angles.turn(sea.flow.real, sea.flow.imag, recorded - sea.heading)
    heading = angles.wrap360(recorded)
    drawn = replace(drawn, pairs=replace(drawn.pairs, heading_deg=heading, upper_east=east, upper_north=north))
    found = diagnosed(drawn)
    (finding,) = found.findings
    assert finding.effect == "tilt_uncompensated"
    share = finding.parameters["share"]
    assert abs(share.value - 1.0) < 4.0 * share.sigma < 0.6


def test_series_is_inadequate_for_iron_stronger_than_the_field():
    sample, _ = pairs(FOLDED, n=1200, seed=3)
    exact, series = fit_deviation("exact", sample), fit_deviation("von_appen", sample)
    (finding,) = mooring.exact_compass_findings(sample, exact, series, 0.5)
    assert (finding.effect, finding.side, finding.applied) == ("large_deviation", "compass", True)
    assert finding.held_out.p_value < 0.01 and finding.rms_effect_deg > 5.0
    ones = np.ones(2)
    earth = EarthField(sample.time_s[[0, -1]], 0 * ones, 12000.0 * ones, 52000.0 * ones, 0 * ones)
    found = diagnose(sample, {}, series, earth)
    assert found.verdict == "explained" and found.fit is not None and found.fit.method == "exact"


def test_an_unlisted_effect_is_composed_and_applied():
    drawn, found = seen({"warm_sextantal": 4.0}, seed=3)
    first = found.findings[0]
    assert first.effect == "composed" and first.side == "compass" and first.applied
    assert first.composition == {"acts_on": "lobe3", "driver": "temperature", "form": "linear"}
    assert "the third harmonic of the compass's reading changes in proportion to the temp" in first.text
    assert first.where.covariate == "temperature" and first.parameters["sine"].unit == "degrees/K"
    assert first.probability + sum(first.alternatives_probability.values()) > 0.95
    product = diagnosis.product_of_diagnosis(fitted(drawn), found)
    again = products.from_json(json.loads(json.dumps({**product.fit.to_json(), "applied": product.to_json()})))
    assert again.applied[0].compass.simulation.terms == product.applied[0].compass.simulation.terms


def test_iron_that_creeps_is_no_effect_of_the_voltage():
    """Both change slowly and one way."""
    _, found = seen({"creep": 4.0}, seed=5)
    (only,) = found.findings
    assert only.named.startswith("composed:field_") and only.named.endswith("/time/creep") and only.level == "effect"


def test_composition_is_a_candidate_by_quantity_driver_and_form():
    _, found = seen({"hour": 3.5}, seed=7)
    names = {name for one in found.findings for name in (one.named, *one.alternatives)}
    assert "composed:reading/hour/periodic" in names


def test_compass_fault_and_veering_current_are_both_stated():
    _, found = seen({"hard_iron_step": 4.0, "current_veer": 4.0}, seed=14)
    assert {finding.side for finding in found.findings} == {"compass"} and found.current
    assert found.sides["compass"] > 0.95 and found.bayes_factor > 20.0
    weights = {one.effect: one.weight for one in found.applied}
    for finding in found.findings:  # stated probabilities equal the weights of the product
        of_name = sum(weight for effect, weight in weights.items() if finding.effect in effect.split("+"))
        assert of_name == pytest.approx(finding.probability, abs=0.03)
    (size,) = (curve for curve in found.curves if curve.covariate == "size_of_hard_iron_step")
    since = size.centre > found.findings[0].where.low
    jump = [size_deg[since].mean() - size_deg[~since].mean() for size_deg in (size.before_deg, size.after_deg)]
    assert jump[0] > 3.0 and abs(jump[1]) < 0.6 * jump[0]
    assert found.curves[-1].covariate not in ("heading", "time", size.covariate)  # largest other residual


def test_a_sector_in_which_the_compass_sticks_is_located():
    drawn = world.planted(world.make(3, wide=False, n=HOURS), {})
    recorded = drawn.pairs.heading_deg
    away = angles.difference(recorded, np.median(recorded))
    shift = np.where(np.abs(away) < 8.0, -away, 0.0)
    east, north = angles.turn(drawn.pairs.upper_east, drawn.pairs.upper_north, shift)
    hung = replace(drawn.pairs, heading_deg=angles.wrap360(recorded + shift), upper_east=east, upper_north=north)
    found = diagnose(hung, drawn.covariates, fitted(drawn), field_of(drawn))
    assert found.verdict == "unexplained" and not found.findings and "sticks" in found.unexplained.text
    where, size = found.unexplained.where, angles.rms(shift)
    assert where.covariate == "heading" and where.low < np.median(recorded) < where.high
    assert 0.7 * size < found.unexplained.rms_effect_deg < 1.4 * size


def test_a_turn_beyond_a_depth_threshold_is_attributed_to_depth():
    """A reading that depends on depth and a current that does so yield nearly the same pairs."""
    drawn = world.planted(world.make(6, wide=False, n=HOURS), {"depth_threshold": 3.5})
    found = diagnosed(drawn)
    assert {one.driver for one in (*found.findings, *found.current)} == {"depth"}


def test_real_water_under_a_sound_compass_is_not_attributed_to_it(tmp_path):
    """Recorded bins (eh2), 4 m apart, whose current at a speed differs while it rises and while it falls.

    The reference is a vane, which logs the direction of the current as its heading.
    """
    folder = Path(shutil.copytree(real("cruise_eh2"), tmp_path / "c"))
    file, log = folder / "config/moorings/E0.yaml", folder / "raw/E0/deep.csv"
    file.write_text(file.read_text().replace("      depth: depth_m\n", "      heading: heading_deg\n"))
    rows = pd.read_csv(log)
    turned = np.random.default_rng(1).normal(2.0, 5.0, len(rows))
    rows["heading_deg"] = angles.wrap360(angles.direction(rows["u_cm_s"], rows["v_cm_s"]) + turned)
    rows.to_csv(log, index=False)
    made = chain.run(folder, "E0")
    found, product = made["diagnosis"], made["product"]
    assert not found["findings"] and [one["driver"] for one in found["current"]] == ["speed"]
    assert angles.rms(angles.difference(product.heading_corrected_deg, product.record.heading_deg)) < 1.5


def test_a_negligible_effect_counts_on_no_side():
    _, small = seen({"octantal": 3.0}, min_effect_deg=9.0)
    assert small.verdict == "consistent" and "octantal" in dict(small.negligible)
    assert small.sides["none"] + small.sides["water"] > 0.65


def test_a_reading_that_changes_for_a_while_is_given_no_other_driver_than_time():
    _, found = seen({"episode": 4.0}, seed=1)
    assert {one.driver for one in found.findings} <= {"time"}


def test_octantal_is_selected_over_sextantal_in_narrow_headings():
    drawn, _ = bench.draw("single", 60, 70)  # narrow headings: the sextantal's columns at size 0 score higher
    found = diagnosed(drawn)
    assert set(drawn.truth) == {"octantal"}
    assert [one.effect for one in found.findings] == ["octantal"] and found.unexplained is None


def test_an_effect_masked_by_a_current_keeps_its_weight():
    drawn, _ = bench.draw("two", 8, 9701)  # 1.5 degrees each
    found = diagnosed(every_second(drawn))
    assert set(drawn.truth) == {"heeling", "current_veer"} and found.sides["compass"] > 0.4
    weights = {one.effect: one.weight for one in found.applied}
    assert max(weights, key=lambda name: weights[name] * (name != "none")) == "heeling" and weights["heeling"] > 0.15


def test_a_slip_of_13_degrees_is_dated_and_said_of_one_of_the_two_instruments():
    """Two-hourly, in water that veers slowly by 1 degree rms; steps tried every ten days missed it."""
    made = world.make(200030, wide=False, n=8760, slow_water=world.some_slow_water(np.random.default_rng(200107)))
    drawn = every_second(world.planted(made, {"heading_slip": 6.0}))
    found = diagnosed(drawn, surrogates=199)
    (finding,) = found.findings
    assert found.verdict == "ambiguous" and found.detection.rank_p == 0.005
    chances = [one["probability"] for one in found.to_json()["experiments"]]
    assert len(chances) >= 3 and all(0.0 <= one <= 1.0 for one in chances) and chances == sorted(chances, reverse=True)
    assert found.sides["compass"] + found.sides["reference"] > 0.95
    assert {finding.effect, *finding.twins} == {"heading_slip", "reference_slip"}
    assert (finding.level, finding.driver) == ("driver", "time") and "one of the two instruments" in finding.text
    assert abs(finding.where.low - drawn.truth["heading_slip"]["date_s"]) < 86400.0


@pytest.mark.parametrize("step_s", [3600.0, 43200.0])
def test_heading_of_a_vane_shares_no_shear_with_the_residual(step_s):
    rng, n = np.random.default_rng(3), 20000
    zero, shear = np.zeros(n), np.array(angles.components(0.04, rng.uniform(0.0, 360.0, n)))
    flow = 0.25 + np.array([red_noise(rng, n, 50, 0.1), red_noise(rng, n, 50, 0.1)])
    upper, lower = flow - shear, flow + shear
    heading = {"vane": angles.direction(*lower) - 45.0, "own": red_noise(rng, n, 100, 150.0)}
    residual = angles.difference(angles.direction(*upper), angles.direction(*lower))
    fast = np.hypot(*flow) > 0.1
    for kind, turned in heading.items():
        sample = Pairs(step_s * np.arange(n), zero, zero, zero, *upper, *lower, zero + 90.0, zero + 105.0, zero, zero)
        told = covariates.departures(sample, {"reference_heading": turned}, {}, zero)["reference_sine"]
        sine, _ = angles.sin_cos(turned)
        apart, kept = (np.corrcoef(x[fast], y[fast])[0, 1] for x, y in ((told, residual), (told, sine)))
        assert abs(apart) < 0.03 and kept > (0.99 if kind == "own" else 0.8)
        assert kind == "own" or abs(np.corrcoef(sine[fast], residual[fast])[0, 1]) > 0.1


@pytest.mark.parametrize("own_m_s", [(0.02, 0.05), (0.05, 0.02)])
def test_flow_direction_covariate_shares_no_noise_with_the_residual(own_m_s):
    rng, n = np.random.default_rng(3), 20000
    time_s, zero, turns = 3600.0 * np.arange(n), np.zeros(n), red_noise(rng, n, 50, 0.05)
    shear = red_noise(rng, n, 12, 0.03)
    upper, lower = (
        turns + side * shear + rng.normal(0.0, own, n) for side, own in zip((-0.5, 0.5), own_m_s, strict=True)
    )
    east = zero + 0.3
    sample = Pairs(time_s, zero, zero, zero, east, upper, east, lower, zero + 90.0, zero + 105.0, zero, zero)
    told = covariates.departures(sample, {}, {}, zero)["flow_north"]
    apart = [np.corrcoef(x, upper - lower)[0, 1] for x in (told, upper, lower, (upper + lower) / 2.0)]
    assert abs(apart[0]) < 0.03 < 0.2 < np.min(np.abs(apart[1:]))  # 0.012 by chance, with autocorrelation
    assert np.corrcoef(told, turns)[0, 1] > 0.95


def test_clock_offset_is_attributed_to_the_clock_and_interpolation_not_to_veer():
    drawn, _ = bench.draw("clock", 4, 9903)
    found = diagnosed(drawn)
    (finding,) = found.findings
    assert (finding.effect, finding.side) == ("clock_offset", "clock") and found.applied[0].compass is None
    hours = finding.parameters["hours"]
    assert abs(hours.value - drawn.truth["clock_offset"]["hours"]) < 4.0 * hours.sigma
    assert "flow_direction" not in {stated.driver for stated in found.current}


def test_clock_error_refuted_by_held_out_directions_only_warns(monkeypatch):
    drawn = world.planted(world.make(5, wide=True, n=HOURS), {})
    wrong = mooring.ClockError(-9.0, 0.0, 0.1, 0.1, True, False)
    monkeypatch.setattr(mooring, "estimate_clock_error", lambda pairs, sigmas: wrong)
    found = diagnosed(drawn)
    assert not [one for one in found.findings if one.side == "clock"]
    assert "held-out directions then agree less" in found.warnings[0] and found.to_json()["warnings"]


def test_held_out_days_refute_by_gain_or_rms():
    assert findings.HeldOut(7.7, 13.2, 0.3, (-9.0, 9.0), 0.52).refuted
    assert findings.HeldOut(7.7, 7.6, -1.0, (-9.0, 3.0), 0.6).refuted
    assert not findings.HeldOut(7.7, 7.8, 2.0, (-1.0, 5.0), 0.1).refuted
    assert not findings.HeldOut(7.7, 7.1, 30.0, (20.0, 40.0), 0.001).refuted


def test_large_deviation_states_the_rms_on_held_out_pairs():
    seen, _ = pairs(FOLDED, n=2000, seed=3)
    exact, series = (fit_deviation(method, seen) for method in ("exact", "von_appen"))
    (finding,) = mooring.exact_compass_findings(seen, exact, series, 0.5)
    some = take(seen, np.arange(0, len(seen), 2))
    assert finding.held_out.rms_after_deg == angles.rms(mooring.held_out_residual(some, exact))
    # Only the first ten days are turned, about one block, which the fit to the other half does not contain.
    first = np.arange(len(seen)) < 240
    turned = replace(seen, heading_deg=angles.wrap360(seen.heading_deg + 60.0 * first))
    left = mooring.held_out_residual(turned, fit_deviation("exact", take(seen, ~first)))
    assert angles.rms(left[first]) > 2.5 * angles.rms(left[~first])


def test_clock_error_is_estimated_from_the_wider_pairs_if_given():
    drawn = world.planted(world.make(5, wide=True, n=HOURS), {"clock_offset": 1.0})
    ahead = drawn.truth["clock_offset"]["hours"]
    upper, lower = pair_speeds(drawn.pairs)
    few = take(drawn.pairs, np.flatnonzero(np.abs(upper - lower) < np.quantile(np.abs(upper - lower), 0.6)))
    near, every = mooring.estimate_clock_error(few), mooring.estimate_clock_error(drawn.pairs)
    assert abs(every.offset_h - ahead) < 0.15 < abs(near.offset_h - ahead)
    found = diagnose(few, {}, fitted(drawn), field_of(drawn), wide=drawn.pairs)
    assert found.findings[0].parameters["hours"].value == pytest.approx(every.offset_h)


@pytest.mark.parametrize("late_h", [0, 3])
def test_inertial_waves_that_reach_one_depth_later_are_not_a_clock_error(late_h):
    water = layers(3)
    hour, z = np.arange(len(water))[:, None], CELL_M * np.arange(BINS + 2)
    waves = 0.15 * np.exp(-1j * (2 * np.pi * hour / 14.0 + 2 * np.pi * z / 150.0))  # 1 h later 11 m above
    eddies = 0.05 * red_noise(np.random.default_rng(1), len(water), 6, 1.0)[:, None]  # without a delay
    top, trusted, _ = profile_and_cell(MILD, 0.12 + waves + eddies + 0.05 * water)
    late = replace(trusted, time_s=trusted.time_s + 3600.0 * late_h)
    clock = mooring.estimate_clock_error(find_pairs(top, [late], FIELD, ALL_NEAR))
    assert clock.named == (late_h > 0) and abs(clock.offset_h + late_h) < 4.0 * clock.offset_sigma_h


def test_a_season_alone_does_not_identify_temperature():
    drawn, _ = bench.draw("control", 8, 9802)  # the logged temperature is shifted by months
    found = diagnosed(every_second(drawn), surrogates=99)
    assert not any("temperature" in (one.effect, *one.alternatives) for one in found.findings)
    assert found.findings or found.unexplained is not None  # no logged series follows this iron


def leaning(stuck_from=None):
    """Return a record whose tilts follow the flow, optionally stuck from some sample on, and the true tilts."""
    drawn = world.make(3, wide=True, n=HOURS)
    tilts = drawn.tilt.copy()
    if stuck_from is not None:
        tilts[:, stuck_from:] = tilts[:, stuck_from : stuck_from + 1]
    attitude = {"heading_deg": drawn.heading % 360.0, "pitch_deg": tilts[0], "roll_deg": tilts[1]}
    record = plain_record(drawn.time_s, drawn.flow[:, None], (1.0,), depth_m=np.full(HOURS, 100.0), **attitude)
    return record, drawn.tilt


def test_stuck_tilts_are_estimated_from_the_flow():
    record, true = leaning(stuck_from=HOURS // 2)
    found = covariates.tilt_corrections(record)
    for name, recorded, tilt in zip(
        covariates.TILT_CORRECTIONS, (record.pitch_deg, record.roll_deg), true, strict=True
    ):
        assert not found[name][: HOURS // 2 - 1].any()
        off = (recorded + found[name] - tilt)[HOURS // 2 :]
        assert np.std(off) < 0.8 * np.std(tilt[HOURS // 2 :])  # one degree of the tilt is independent of the flow
    assert covariates.tilt_corrections(leaning()[0]) == {}


def test_stuck_tilts_independent_of_flow_get_their_mean():
    record, _ = leaning()
    rng, stuck = np.random.default_rng(5), np.arange(HOURS) >= HOURS // 2
    pitch, roll = (np.where(stuck, 4.0, rng.normal(mean, 1.0, HOURS)) for mean in (1.0, -2.0))
    found = covariates.tilt_corrections(replace(record, pitch_deg=pitch, roll_deg=roll))
    for name, mean in zip(covariates.TILT_CORRECTIONS, (1.0, -2.0), strict=True):
        assert not found[name][~stuck].any()
        assert found[name][stuck] == pytest.approx(mean - 4.0, abs=0.1)
    drawn = world.planted(world.make(3, wide=True, n=HOURS), {})
    assert set(covariates.TILT_CORRECTIONS) <= set(covariates.pair_covariates(drawn.pairs, found))


def test_too_few_pairs_are_insufficient_and_counted():
    drawn = world.planted(world.make(7, wide=True, n=1000), {})
    fit = fitted(drawn)
    few = take(drawn.pairs, np.arange(150))
    found = diagnose(few, {}, fit, field_of(drawn))
    assert found.verdict == "insufficient" and "150 overlapping pairs over 6.2 days" in found.why
    nothing = unfitted("exact", 3)
    assert "3 overlapping pairs" in diagnose(few, {}, nothing, field_of(drawn)).why


def test_effects_without_tilt_or_logs_are_not_testable():
    drawn = world.planted(world.make(8, wide=True, n=2000), {})
    flat = replace(drawn.pairs, pitch_deg=np.full(2000, np.nan), roll_deg=np.full(2000, np.nan))
    found = diagnose(flat, {}, fitted(drawn), field_of(drawn))
    told = dict(found.not_testable)
    assert {"heeling", "tilt_uncompensated", "temperature", "supply_voltage", "battery_change"} <= set(told)
    assert diagnosis.insufficient("x").to_json()["findings"] == []


def test_storm_is_identified_with_observatory_and_nonmagnetic_reference():
    sea = world.make(9, wide=True, n=HOURS)
    storm = world.red(sea.rng, HOURS, 8, 3.0)  # declination at the observatory, east positive
    quiet = world.planted(sea, {})
    recorded = quiet.pairs.heading_deg - storm
    east, north = angles.turn(quiet.pairs.upper_east, quiet.pairs.upper_north, -storm)
    stormy = replace(quiet.pairs, heading_deg=angles.wrap360(recorded), upper_east=east, upper_north=north)
    drawn = replace(quiet, pairs=stormy)
    logged = drawn.covariates | {"declination_observatory": storm}
    fit, field = fitted(drawn), field_of(drawn)
    (finding,) = diagnose(stormy, logged, fit, field, Options(reference_magnetic=False)).findings
    share = finding.parameters["share"]
    assert finding.effect == "field_disturbance" and abs(share.value - 1.0) < 4.0 * share.sigma < 1.0
    without = compare_pairs(stormy, drawn.covariates, fit, field, reference_magnetic=False)
    assert dict(without.not_testable)["field_disturbance"] == "no observatory series given"
    magnetic = compare_pairs(stormy, logged, fit, field, reference_magnetic=True)
    assert "cancels in the difference" in dict(magnetic.not_testable)["field_disturbance"]


def test_columns_that_were_exchanged_leave_too_few_pairs_and_no_traceback():
    """A mirrored current is fitted by a compass at the edge of folding, whose branch hardly any pair determines."""
    mirrored, _ = pairs(n=500, seed=10)
    mirrored = replace(mirrored, lower_east=mirrored.lower_north, lower_north=mirrored.lower_east)
    earth = EarthField(mirrored.time_s[[0, -1]], *np.full((4, 2), 12000.0))
    found = diagnose(mirrored, {}, fit_deviation("exact", mirrored), earth)
    assert found.verdict == "insufficient" and "the branch of the compass is known for" in found.why


def test_each_battery_has_its_own_iron(monkeypatch):
    """Regression test: two battery changes constrained to equal iron were explained by temperature."""
    hours = np.arange(6000)
    first, second = hours >= 2000, hours >= 4000
    volts = 150.0 - hours / 80.0 + 25.0 * first + 25.0 * second + np.random.default_rng(0).normal(0.0, 0.5, 6000)
    steps = np.array([300.0 * first + 900.0 * second, -900.0 * first + 700.0 * second, 0.0 * hours])
    iron = world.Effect({}, 1.3 * steps)
    here = replace(world.make(9000, wide=True, n=6000), voltage=volts.round())
    monkeypatch.setattr(world, "effect", lambda *asked: iron)
    monkeypatch.setattr(world, "visible", lambda *asked: 1.0)
    drawn = world.planted(here, {"battery_change": 1.0})
    found = diagnosed(drawn)
    (finding,) = found.findings
    assert finding.effect == "battery_change" and finding.applied
    sizes = {name: one.value / 1.3 for name, one in finding.parameters.items()}
    assert list(sizes) == ["b_x_nT", "b_y_nT", "second_x_nT", "second_y_nT"]
    # In a horizontal field of about 12,000 nT, 200 nT turn the compass by one degree, roughly the fit's uncertainty.
    assert np.abs(np.array(list(sizes.values())) - [300.0, -900.0, 900.0, 700.0]).max() < 250.0


def test_aliased_tides_of_a_profiler_do_not_replace_a_constant(tmp_path):
    # Two of the five aliased waves are nearly constant, and coefficient A was confounded with them.
    shutil.copytree(ROOT / "config", tmp_path / "config")
    demonstration.write_mooring("EG5", tmp_path / "raw", tmp_path / "truth.csv", 2007)
    made = chain.make(tmp_path, "EG5", tmp_path / "EG5")
    assert read_json(made / "diagnosis.json")["verdict"] == "consistent"
