"""Would catch wrong clocks, covariates, held-out gains or suggested observations in the search."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles
from compasslib.deviation.model import observed_deviation
from compasslib.effects.composed import compose_effect, place_effect
from compasslib.effects.effect import YEAR_S
from compasslib.effects.iron import TemperatureOfField, TemperatureOfReading
from compasslib.effects.readout import HeadingSlip
from compasslib.effects.reference import ReferenceSlip
from compasslib.inference import comparison, covariates, experiments, finding
from compasslib.inference.experiments import ANYTHING
from compasslib.inference.kinds import mooring
from compasslib.inference.linear_model import _turn_ratio
from compasslib.records import take
from tests.world.sea import pairs

TIME_S = 1.19e9 + 3600.0 * np.arange(4000)


@pytest.mark.parametrize("ahead_h", [-0.8, 1.0, 2.3])
def test_clock_offset_is_estimated_with_its_sign_and_corrected(ahead_h):
    seen, _ = pairs(n=4000, seed=5)
    wrong = mooring.repair_pairs(seen, mooring.ClockError(-ahead_h, 0.0, 0.01, 0.01, True, False))
    found = mooring.estimate_clock_error(wrong)
    assert found.offset_named and not found.drift_named
    assert found.offset_h == pytest.approx(ahead_h, abs=4 * found.offset_sigma_h + 0.05)
    again = mooring.repair_pairs(wrong, found)
    assert angles.rms(observed_deviation(again)) < angles.rms(observed_deviation(wrong))


def test_clock_drift_is_distinguished_from_an_offset():
    seen, _ = pairs(n=6000, seed=6)
    wrong = mooring.repair_pairs(seen, mooring.ClockError(0.0, -2.0, 0.01, 0.01, False, True))
    found = mooring.estimate_clock_error(wrong)
    assert found.drift_named and not found.offset_named
    assert found.drift_h_year == pytest.approx(2.0, abs=4 * found.drift_sigma_h_year)
    assert found.ahead_s(wrong.time_s)[-1] == pytest.approx(7200.0 * np.ptp(wrong.time_s) / YEAR_S, rel=0.2)


@pytest.mark.parametrize(
    ("beside", "level"),
    [
        (place_effect(compose_effect("reading", "temperature", "bands")), "driver"),
        (place_effect(compose_effect("reading", "depth", "linear")), "side"),
        (TemperatureOfField(200.0, 0.0), "effect"),
    ],
)
def test_beside_an_unlisted_form_only_the_driver_that_both_share_or_the_side_is_stated(beside, level):
    """A reading proportional to the rate of temperature is fitted as a linear response minus one by its history."""
    of_mooring = comparison.Comparison(time_s=TIME_S, terms=(), covariates={})
    built = comparison.build_finding(
        of_mooring, TemperatureOfReading(25.0), {"temperature": 0.99}, {}, size_deg=26.0, proof=finding.UNTESTED,
        place=finding.CovariateRange("temperature", 3.0, 7.0, "along temperature"), others=[beside],
    )  # fmt: skip
    assert built.level == level and ("neither has the right form" in built.text) == (level == "driver")


def test_a_delay_of_the_current_between_depths_is_not_a_clock_error():
    years = np.linspace(0.03, 0.97, 16)
    scatter = np.random.default_rng(2).normal(0.0, 0.03, 16)
    late = mooring._select_clock(years, -0.35 + scatter, 1.0, mooring.DELAY_SIGMA_H)
    assert not late.named and abs(late.offset_h + 0.35) < 0.02 and late.offset_sigma_h >= mooring.DELAY_SIGMA_H
    assert mooring._select_clock(years, -1.0 + scatter, 1.0, mooring.DELAY_SIGMA_H).offset_named
    half = [mooring._select_clock(years, -0.5 + scatter, 1.0, mooring.DELAY_SIGMA_H, sigmas) for sigmas in (4.0, 2.0)]
    assert [each.offset_named for each in half] == [False, True]  # the second where a constant corroborates it
    # In a short record the few windows are fitted together with a delay of given variance.
    assert mooring._select_clock(years[:6] / 15.0, 2.9 + 10.0 * scatter[:6], 0.07, mooring.DELAY_SIGMA_H).offset_named
    # A delay in addition to a drift does not bias the rate.
    drift = mooring._select_clock(years, 0.2 + 0.9 * years + scatter, 1.0, mooring.DELAY_SIGMA_H)
    assert drift.drift_named and not drift.offset_named
    assert abs(drift.drift_h_year - 0.9) < 3.0 * drift.drift_sigma_h_year < 0.5


@pytest.mark.parametrize(("turned_deg", "likely"), [(8.0, True), (0.0, False)])
def test_a_step_is_of_the_reference_if_the_axis_of_its_currents_turns_too(turned_deg, likely):
    seen, _ = pairs(n=4000, seed=3)
    scatter = np.exp(0.1j * np.random.default_rng(1).normal(size=4000))
    tide = 0.3 * np.exp(0.4j) * np.cos(2 * np.pi * seen.time_s / 44714.0) * scatter
    after = seen.time_s >= seen.time_s[2000]
    east, north = angles.turn(tide.real, tide.imag, turned_deg * after)
    dates_s, ratio = covariates.reference_turns(replace(seen, lower_east=east, lower_north=north), 8.0 * after)
    at = float(np.interp(seen.time_s[2000], dates_s, ratio))
    assert (at > 3.0 if likely else at < -3.0) and np.all(
        np.abs(ratio[np.abs(dates_s - seen.time_s[2000]) > 3e6]) < 0.1
    )


def test_currents_of_the_reference_only_count_against_a_step():
    turns = np.array([0.0, 1e6]), np.array([3.0, 3.0])  # the reference turned
    assert _turn_ratio(ReferenceSlip(date_s=5e5), turns) == 0.0 and _turn_ratio(HeadingSlip(date_s=5e5), turns) == -3.0
    held = turns[0], -turns[1]
    assert _turn_ratio(ReferenceSlip(date_s=5e5), held) == -3.0 and _turn_ratio(HeadingSlip(date_s=5e5), held) == 0.0


def test_no_clock_error_is_named_for_good_clocks_or_sparse_pairs():
    seen, _ = pairs(n=4000, seed=7)
    assert not mooring.estimate_clock_error(seen).named
    assert not mooring.estimate_clock_error(take(seen, np.arange(0, 4000, 12))).named


def test_aliased_tides_of_a_profiler_do_not_span_the_constant():
    twice_a_day = 1.2e9 + np.arange(700) * 12 * 3600.0 + np.random.default_rng(4).normal(0.0, 600.0, 700)
    waves = comparison._aliased_tides(twice_a_day)
    assert waves.shape[1] >= 8  # without those of the sun, which alias to a constant
    constant = np.ones(700)
    told = waves @ np.linalg.lstsq(waves, constant, rcond=None)[0]
    assert np.square(constant - told).mean() > 0.9  # near 0 if they spanned it


def test_turn_rate_is_not_tested_with_pairs_half_a_day_apart():
    """Regression test: its column was zero, and its detectable size was stated as 0 degrees."""
    hourly, _ = pairs(n=500, seed=8)
    sparse = replace(hourly, time_s=hourly.time_s[0] + 12 * 3600.0 * np.arange(500))
    for seen, tested in ((hourly, True), (sparse, False)):
        along = covariates.pair_covariates(seen, {})
        made = covariates.departures(seen, along, covariates.reference_values(along), seen.heading_deg)
        assert ("turn_rate" in made) == tested


def test_constant_covariates_are_left_out_and_gaps_filled():
    seen, _ = pairs(n=500, seed=8)
    warm = np.linspace(2.0, 5.0, 500)
    warm[::7] = np.nan
    found = covariates.pair_covariates(seen, {"temperature": warm, "supply_voltage": np.full(500, 40.0)})
    assert "supply_voltage" not in found and "pitch" not in found and "depth" not in found
    assert np.isfinite(found["temperature"]).all() and np.ptp(found["hour_of_day"]) > 20.0


def test_a_new_battery_is_counted_and_a_discharge_is_not():
    falling = 43.0 - np.linspace(0.0, 6.0, 3000) + np.random.default_rng(9).normal(0.0, 0.05, 3000)
    assert covariates.battery_count(falling).max() == 0.0
    changed = falling + 5.0 * (np.arange(3000) > 1800)
    number = covariates.battery_count(changed)
    assert number[-1] == 1.0 and abs(int(np.argmax(number)) - 1800) < 30
    # Equal maxima of a quantized voltage are one battery.
    number = covariates.battery_count(np.r_[np.linspace(150, 120, 400), np.linspace(170, 140, 400)].round())
    assert number.max() == 1.0 and number[360] == 0.0 and number[440] == 1.0


def test_the_p_value_of_a_clear_gain_is_small_and_of_none_is_not():
    block = np.repeat(np.arange(40), 100)
    rng = np.random.default_rng(10)
    clear = finding.bootstrap_gain(rng.normal(0.2, 1.0, 4000), block, (12.0, 11.9))
    none = finding.bootstrap_gain(rng.normal(0.0, 1.0, 4000), block, (12.0, 12.0))
    assert clear.p_value < 0.01 < 0.05 < none.p_value and clear.gain_interval[0] > 0.0


def test_free_nuisances_reduce_the_information_of_an_observation():
    rng = np.random.default_rng(3)
    known = rng.normal(size=(50, 2))
    free = experiments._information(known, np.ones((50, 1)), np.full(1, 1.0 / ANYTHING))
    centred = known - known.mean(axis=0)
    np.testing.assert_allclose(free, centred.T @ centred, rtol=1e-5)
    fixed = experiments._information(known, np.ones((50, 1)), np.full(1, 1e9))
    np.testing.assert_allclose(fixed, known.T @ known, rtol=1e-5)


def test_a_trend_is_extrapolated_and_other_series_are_repeated():
    time_s = np.arange(1000.0)
    falling, season = 40.0 - 0.004 * time_s, np.sin(time_s / 30.0)
    np.testing.assert_allclose(experiments.extrapolate(falling, time_s, 1000.0), falling - 4.0)
    np.testing.assert_array_equal(experiments.extrapolate(season, time_s, 1000.0), season)


def test_the_share_of_single_names_follows_the_verdict():
    """An effect is certain by its total probability; equal ones leave two names; no effect at 0.8 is uncertain."""
    names = [(), ("heeling",), ("current_veer", "heeling"), ("temperature",)]
    draws = np.array([[0.0, 0.6, 0.38, 0.02], [0.0, 0.5, 0.0, 0.5], [0.8, 0.2, 0.0, 0.0], [0.97, 0.03, 0.0, 0.0]]).T
    each = [experiments._single_name_share(names, draws[:, k : k + 1]) for k in range(4)]
    assert each == [1.0, 0.0, 0.0, 1.0] and experiments._single_name_share(names, draws) == 0.5
