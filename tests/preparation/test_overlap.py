"""Would catch pairs against the rules of von Appen's appendix."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles
from compasslib.errors import InputError
from compasslib.preparation.clocks import ClockOffset, grid_indices, interpolate_series
from compasslib.preparation.pairs import PairRules, check_pairs, estimate_clock_offset, find_pairs
from compasslib.records import BAD, EarthField, Pairs, Record, take
from tests.world import sea
from tests.world.hourly import HOUR, record
from tests.world.pairs import red_from_rest as red_noise
from tests.world.sea import FOLDED, MILD, pairs

NORTH_FIELD = EarthField(np.array([0.0, 1e9]), np.array([10.0, 10.0]), *(np.ones((3, 2)) * 12000.0))


def test_grid_adopts_the_phase_of_the_series_subsamples_and_omits_gaps():
    assert list(grid_indices(1000.0 + HOUR * np.arange(10), step_s=HOUR, tolerance_s=1800.0)) == list(range(10))
    times = np.concatenate([600.0 * np.arange(60), 100000.0 + 600.0 * np.arange(6)])
    index = grid_indices(times, step_s=HOUR, tolerance_s=1800.0)
    assert list(times[index][:10]) == list(HOUR * np.arange(10))
    assert len(index) == 13  # at the edges of a gap the nearest sample is used


def test_interpolation_is_linear_nearest_or_nan_by_gap():
    series, values = np.array([0.0, HOUR, 10 * HOUR]), np.array([0.0, 2.0, 8.0])
    at = np.array([HOUR / 2, 1.25 * HOUR, 5 * HOUR, 9.75 * HOUR])
    found = interpolate_series(series, values, at, tolerance_s=1800.0)
    assert found == pytest.approx([1.0, 2.0, np.nan, 8.0], nan_ok=True)


def test_first_upper_and_nearest_lower_bins_are_averaged():
    upper = record(HOUR * np.arange(5), ranges=(4.0, 8.0, 12.0))
    lower = record(HOUR * np.arange(5) + 300.0, depth=130.0, ranges=(5.0, 15.0, 25.0, 35.0), up=True)
    lower = replace(lower, east=np.tile([0.1, 0.2, 0.3, 0.5], (5, 1)))
    found = find_pairs(upper, [lower], NORTH_FIELD, PairRules())
    assert found.upper_depth_m == pytest.approx(94.0)
    assert found.lower_depth_m == pytest.approx(100.0)  # bins at 95 and 105 m lie nearest to the sphere at 100 m
    speed = np.hypot(found.lower_east, found.lower_north)
    assert speed == pytest.approx(np.hypot(0.4, 0.1))
    assert found.separation_minutes[:-1] == pytest.approx(5.0)


@pytest.mark.parametrize(("minutes", "depth", "pairs"), [(19.0, 104.0, 4), (21.0, 104.0, 0), (0.0, 120.0, 0)])
def test_pairs_are_less_than_20_minutes_and_20_metres_apart(minutes, depth, pairs):
    upper = record(12 * HOUR * np.arange(4))
    lower = record(12 * HOUR * np.arange(4) + 60 * minutes, depth=depth, ranges=(0.0,), up=False)
    assert len(find_pairs(upper, [lower], NORTH_FIELD, PairRules())) == pairs


def test_profiler_is_averaged_only_near_the_sphere():
    times = np.concatenate([12 * HOUR * k + np.arange(0.0, 600.0, 2.0) for k in range(3)])
    depth = np.tile(np.linspace(90.0, 390.0, 300), 3)
    lower = record(times, depth=depth, ranges=(0.0,), up=False)
    upper = record(HOUR * np.arange(30))
    found = find_pairs(upper, [lower], NORTH_FIELD, PairRules())
    assert len(found) == 3 and np.abs(found.lower_depth_m - found.upper_depth_m).max() < 20.0


def test_declination_is_added_to_magnetic_directions_only():
    upper = record(HOUR * np.arange(3), east=0.0, north=0.2)
    lower = replace(record(HOUR * np.arange(3), ranges=(0.0,), east=0.0, north=0.2), direction_reference="true")
    found = find_pairs(upper, [lower], NORTH_FIELD, PairRules())
    assert np.rad2deg(np.arctan2(found.upper_east, found.upper_north)) == pytest.approx(10.0)
    assert np.rad2deg(np.arctan2(found.lower_east, found.lower_north)) == pytest.approx(0.0)


def test_no_pairs_from_flagged_values_or_without_reference():
    upper = record(HOUR * np.arange(3))
    lower = record(HOUR * np.arange(3), ranges=(0.0,), depth=90.0)
    bad = replace(lower, quality=np.full((3, 1), BAD, dtype=np.int8))
    assert len(find_pairs(upper, [lower], NORTH_FIELD, PairRules())) == 3
    assert len(find_pairs(upper, [bad], NORTH_FIELD, PairRules())) == 0
    assert len(find_pairs(upper, [], NORTH_FIELD, PairRules())) == 0


@pytest.mark.parametrize("coefficients", [MILD, FOLDED])
def test_frame_check_passes_for_any_deviation(coefficients):
    seen, _ = pairs(coefficients, seed=1)
    assert check_pairs(seen, record([0.0]), [record([0.0])]).warnings == ()


def test_frame_check_passes_for_an_instrument_that_follows_the_flow_near_strong_iron():
    """The compass reads half of the turns of the instrument, whose velocities keep their direction in its frame."""
    rng, n = np.random.default_rng(1), 2000
    flow, zero = rng.uniform(0.0, 360.0, n), np.zeros(n)
    recorded, slip = 90.0 + flow / 2.0, rng.normal(0.0, 10.0, n)
    upper, lower = angles.components(0.3, recorded + 40.0 + slip), angles.components(0.3, flow)
    locked = Pairs(HOUR * np.arange(n), recorded, zero, zero, *upper, *lower, zero + 90.0, zero + 105.0, zero, zero)
    assert len(check_pairs(locked, record([0.0]), [record([0.0])])) == n


def test_iron_as_strong_as_the_field_is_not_refused_as_a_wrong_frame():
    """The compass reads half of each turn: twice its readings are the headings up to a constant."""
    rng, n = np.random.default_rng(1), 2000
    flow, heading, zero = rng.uniform(0.0, 360.0, n), rng.uniform(-180.0, 180.0, n), np.zeros(n)
    recorded = angles.wrap360(40.0 + heading / 2.0)
    upper = angles.components(0.3, flow + recorded - heading + rng.normal(0.0, 10.0, n))
    lower = angles.components(0.3, flow)
    halved = Pairs(HOUR * np.arange(n), recorded, zero, zero, *upper, *lower, zero + 90.0, zero + 105.0, zero, zero)
    found = check_pairs(halved, record([0.0]), [record([0.0])])
    assert len(found) == n and "iron is as strong as the earth's field" in found.warnings[0]


@pytest.mark.parametrize(("sign", "turns"), [(1, 1), (1, -1), (-1, 2), (-1, 0)])
def test_velocities_in_a_wrong_frame_are_refused(sign, turns):
    """Ship coordinates declared as earth coordinates, or the reverse, or an up-looker declared as a down-looker."""
    seen, _ = pairs(MILD)
    upper = angles.turn(sign * seen.upper_east, seen.upper_north, turns * seen.heading_deg)
    with pytest.raises(InputError, match=r"only where they are (turned|mirrored).*; check coordinates"):
        check_pairs(replace(seen, upper_east=upper[0], upper_north=upper[1]), record([0.0]), [record([0.0])])


def test_equal_serial_numbers_are_refused():
    upper, lower = (replace(record([0.0]), serial_number=number) for number in ("8104", "7514"))
    seen, _ = pairs(MILD)
    assert len(check_pairs(seen, upper, [lower])) == len(seen)
    with pytest.raises(InputError, match="expected two instruments, found serial number 8104 in the files of both"):
        check_pairs(seen, upper, [upper])


def instruments(n=6000, *, seed=3, cell_m=4.0) -> tuple[Record, Record]:
    """Simulate an upper profiler of six bins in sheared water and a meter below it, hourly, with independent noise."""
    rng, seen = np.random.default_rng(seed), sea.pairs(n=n, seed=seed)[0]
    ranges = 4.0 + cell_m * np.arange(6)
    upper, lower = record(seen.time_s, ranges=ranges), record(seen.time_s, depth=105.0, ranges=(0.0,))
    shear = np.cumsum([red_noise(rng, n, 10, 0.015) for _ in ranges], axis=0).T
    parts = (seen.upper_east, seen.upper_north, seen.lower_east, seen.lower_north)
    tops = [x[:, None] + shear + rng.normal(0.0, 0.012, shear.shape) for x in parts[:2]]
    return replace(upper, east=tops[0], north=tops[1]), replace(lower, east=parts[2][:, None], north=parts[3][:, None])


def test_meter_within_the_profile_is_paired_with_the_bins_around_it():
    upper, lower = instruments(400)
    upper = replace(upper, looks_up=False, bin_range_m=upper.bin_range_m + 20.0)  # 24 to 44 m below the instrument
    for below_m, expected in ((40.0, 400), (80.0, 0)):
        meter = replace(lower, depth_m=upper.depth_m + below_m)
        assert len(find_pairs(upper, [meter], NORTH_FIELD, PairRules(max_metres=10.0))) == expected


def late(lower: Record, hours) -> Record:
    return replace(lower, time_s=lower.time_s + HOUR * np.broadcast_to(hours, lower.time_s.shape))


@pytest.mark.parametrize("hours", [-744, -12, 7, 24])
def test_clock_offset_of_hours_to_a_month_is_corrected(hours):
    upper, lower = instruments()
    found = estimate_clock_offset(upper, [late(lower, hours)], PairRules())
    assert found.ahead_h == hours
    said = f"the clock of the reference is {abs(hours)} h {'ahead of' if hours > 0 else 'behind'} the affected one"
    assert said in found.warnings[0]
    pairs, right = (
        find_pairs(upper, [one], NORTH_FIELD, PairRules(), clocks)
        for one, clocks in ((late(lower, hours), found), (lower, None))
    )
    assert len(pairs) >= len(right) - abs(hours) and found.warnings[0] in pairs.warnings
    assert np.isin(pairs.time_s, right.time_s).all()
    at = np.searchsorted(right.time_s, pairs.time_s)
    assert pairs.lower_east == pytest.approx(right.lower_east[at])


def test_small_clock_offsets_are_not_corrected():
    for seed in range(2):
        upper, lower = instruments(1500 * (seed + 1), seed=seed)
        for hours in (-0.4, 0.0, 4.0):
            assert estimate_clock_offset(upper, [late(lower, hours)], PairRules()) == ClockOffset()


def test_uncorrelated_speeds_are_reported_without_correction():
    upper, other = instruments(seed=3)[0], instruments(seed=4)[1]
    found = estimate_clock_offset(upper, [other], PairRules())
    assert not found.ahead_h and "uncorrelated" in found.uncorrelated
    # Three weeks in eleven months with a correlation of 0.74 were once rejected, as the score counted all windows.
    few = take(instruments(seed=3)[1], np.arange(24 * 14))
    assert estimate_clock_offset(upper, [few], PairRules()) == ClockOffset()


@pytest.mark.parametrize(("water", "hours"), [("tide", 0), ("tide", 12), ("slow", 25)])
def test_tides_and_slow_changes_alone_give_no_clock_offset(water, hours):
    upper, lower = instruments()
    noise = np.random.default_rng(1).normal(0.0, 0.01, (2, len(upper.time_s), 2)) @ [1.0, 1j]
    tide = 0.3 * np.exp(2j * np.pi * upper.time_s / HOUR / 12.4206)
    slow = 0.2 + 0.1 * np.sin(np.arange(len(tide)) / 200.0)  # over weeks
    for flow in noise:
        flow += {"tide": 0.1 + tide.real + 0.3j * tide.imag, "slow": slow}[water]
    upper, lower = (
        replace(one, east=flow.real[:, None] + 0.0 * one.east, north=flow.imag[:, None] + 0.0 * one.north)
        for one, flow in zip((upper, lower), noise, strict=True)
    )
    found = estimate_clock_offset(upper, [late(lower, hours)], PairRules())
    assert not found.ahead_h and not found.uncorrelated


@pytest.mark.parametrize("hours", [-6, 5])
def test_clocks_half_a_tide_apart_are_corrected(hours):
    """The speeds as stated are opposite, so that neither a fit nor the search can begin; once called uncorrelated."""
    upper, lower = instruments()
    tide = 0.1 + 0.3 * np.cos(2.0 * np.pi * upper.time_s / HOUR / 12.4206)
    upper, lower = (replace(one, east=one.east + tide[:, None]) for one in (upper, lower))
    found = estimate_clock_offset(upper, [late(lower, hours)], PairRules())
    assert found.ahead_h == hours and not found.uncorrelated


@pytest.mark.parametrize("turned", [None, 0.0, 60.0])
def test_own_record_is_refused_as_reference(turned):
    """All of it, or the mean of its nearest bins, turned by a constant or by another compass."""
    upper, _ = instruments(1500)
    near = (upper.east + 1j * upper.north)[:, :2].mean(axis=1)
    meter = record(upper.time_s, depth=105.0, ranges=(0.0,))
    if turned is not None:
        current = near * np.exp(1j * (0.4 + np.linspace(0.0, turned, len(near))))
        meter = replace(meter, east=current.real[:, None], north=current.imag[:, None])
    trusted = [upper if turned is None else meter]
    found = find_pairs(upper, trusted, NORTH_FIELD, PairRules(), estimate_clock_offset(upper, trusted, PairRules()))
    assert not len(found) and "one recording was given twice" in found.warnings[0]


def test_shuffled_days_make_all_headings_doubtful():
    upper, lower = instruments(6000)
    days = np.random.default_rng(1).permutation(250)
    shuffled = (24 * days[:, None] + np.arange(24)).ravel()
    lower = replace(lower, east=lower.east[shuffled], north=lower.north[shuffled])
    clocks = estimate_clock_offset(upper, [lower], PairRules())
    ((sigma_deg, why),) = find_pairs(upper, [lower], NORTH_FIELD, PairRules(), clocks).doubts
    assert "uncorrelated" in why and sigma_deg == angles.UNIFORM_SIGMA_DEG


@pytest.mark.parametrize(("factor", "doubted"), [(0.01, True), (0.1, False), (1.0, False)])
def test_reference_speeds_in_a_wrong_unit_are_reported(factor, doubted):
    upper, lower = instruments(1500)
    lower = replace(lower, east=factor * lower.east, north=factor * lower.north)
    found = find_pairs(upper, [lower], NORTH_FIELD, PairRules())
    assert bool(found.doubts) == doubted and ("unit and scale" in " ".join(found.warnings)) == (factor == 0.1)
