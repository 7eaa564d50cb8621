"""Gridding and pairing: the rules of von Appen's appendix on hand-made records."""

from dataclasses import replace

import numpy as np
import pytest
from sea import FOLDED, MILD, pairs

from compasslib import angles, grid, overlap, overlap_words
from compasslib.errors import InputError
from compasslib.overlap import Rules
from compasslib.records import BAD, GOOD, EarthField, Record

HOUR = 3600.0
NORTH_FIELD = EarthField(np.array([0.0, 1e9]), np.array([10.0, 10.0]), *(np.ones((3, 2)) * 12000.0))


def record(times, *, depth=100.0, ranges=(10.0, 14.0, 18.0), east=0.2, north=0.1, up=True, heading=30.0) -> Record:
    times = np.asarray(times, dtype=float)
    shape, flat = (len(times), len(ranges)), np.full(len(times), np.nan)
    return Record(
        times,
        np.full(shape, east),
        np.full(shape, north),
        np.tile(np.array(ranges), (len(times), 1)),
        np.full(len(times), heading),
        flat,
        flat,
        flat,
        np.broadcast_to(depth, times.shape).astype(float),
        flat,
        flat,
        np.full(shape, GOOD, dtype=np.int8),
        np.full(len(times), GOOD, dtype=np.int8),
        looks_up=up,
    )


def test_grid_takes_the_phase_of_the_series_so_headings_are_never_mixed():
    times = 1000.0 + HOUR * np.arange(10)
    assert list(grid.on_grid(times, step_s=HOUR, tolerance_s=1800.0)) == list(range(10))


def test_grid_thins_fast_sampling_and_leaves_gaps_out():
    times = np.concatenate([600.0 * np.arange(60), 100000.0 + 600.0 * np.arange(6)])
    index = grid.on_grid(times, step_s=HOUR, tolerance_s=1800.0)
    assert list(times[index][:10]) == list(HOUR * np.arange(10))
    assert len(index) == 13  # at a gap's edges the nearest sample stands for its node


def test_interpolation_is_linear_in_short_gaps_nearest_in_long_ones_else_nan():
    series, values = np.array([0.0, HOUR, 10 * HOUR]), np.array([0.0, 2.0, 8.0])
    at = np.array([HOUR / 2, 1.25 * HOUR, 5 * HOUR, 9.75 * HOUR])
    found = grid.interpolate(series, values, at, tolerance_s=1800.0)
    assert found == pytest.approx([1.0, 2.0, np.nan, 8.0], nan_ok=True)


def test_first_two_bins_of_the_upper_and_nearest_two_of_the_lower_are_averaged():
    upper = record(HOUR * np.arange(5), ranges=(4.0, 8.0, 12.0))
    lower = record(HOUR * np.arange(5) + 300.0, depth=130.0, ranges=(5.0, 15.0, 25.0, 35.0), up=True)
    lower = replace(lower, east=np.tile([0.1, 0.2, 0.3, 0.5], (5, 1)))
    found = overlap.find(upper, [lower], NORTH_FIELD, Rules())
    assert found.upper_depth_m == pytest.approx(94.0)
    assert found.lower_depth_m == pytest.approx(100.0)  # bins at 95 and 105 m lie nearest to the sphere at 100 m
    speed = np.hypot(found.lower_east, found.lower_north)
    assert speed == pytest.approx(np.hypot(0.4, 0.1))
    assert found.separation_minutes[:-1] == pytest.approx(5.0)


@pytest.mark.parametrize(("minutes", "depth", "pairs"), [(19.0, 104.0, 4), (21.0, 104.0, 0), (0.0, 120.0, 0)])
def test_pairs_are_less_than_20_minutes_and_20_metres_apart(minutes, depth, pairs):
    upper = record(12 * HOUR * np.arange(4))
    lower = record(12 * HOUR * np.arange(4) + 60 * minutes, depth=depth, ranges=(0.0,), up=False)
    assert len(overlap.find(upper, [lower], NORTH_FIELD, Rules())) == pairs


def test_blow_down_is_followed_by_both():
    depth = np.array([100.0, 180.0, 300.0, 180.0])
    upper, lower = record(HOUR * np.arange(4), depth=depth), record(HOUR * np.arange(4), depth=104.0, ranges=(0.0,))
    assert len(overlap.find(upper, [lower], NORTH_FIELD, Rules())) == 1


def test_a_profiler_is_averaged_near_the_sphere_only():
    times = np.concatenate([12 * HOUR * k + np.arange(0.0, 600.0, 2.0) for k in range(3)])
    depth = np.tile(np.linspace(90.0, 390.0, 300), 3)
    lower = record(times, depth=depth, ranges=(0.0,), up=False)
    upper = record(HOUR * np.arange(30))
    found = overlap.find(upper, [lower], NORTH_FIELD, Rules())
    assert len(found) == 3 and np.abs(found.lower_depth_m - found.upper_depth_m).max() < 20.0


def test_magnetic_directions_get_the_declination_and_true_ones_do_not():
    upper = record(HOUR * np.arange(3), east=0.0, north=0.2)
    lower = replace(record(HOUR * np.arange(3), ranges=(0.0,), east=0.0, north=0.2), direction_reference="true")
    found = overlap.find(upper, [lower], NORTH_FIELD, Rules())
    assert np.rad2deg(np.arctan2(found.upper_east, found.upper_north)) == pytest.approx(10.0)
    assert np.rad2deg(np.arctan2(found.lower_east, found.lower_north)) == pytest.approx(0.0)


def test_flagged_values_make_no_pairs_and_no_reference_makes_none():
    upper = record(HOUR * np.arange(3))
    lower = record(HOUR * np.arange(3), ranges=(0.0,), depth=90.0)
    bad = replace(lower, quality=np.full((3, 1), BAD, dtype=np.int8))
    assert len(overlap.find(upper, [lower], NORTH_FIELD, Rules())) == 3
    assert len(overlap.find(upper, [bad], NORTH_FIELD, Rules())) == 0
    assert len(overlap.find(upper, [], NORTH_FIELD, Rules())) == 0


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("coefficients", [MILD, FOLDED])
def test_pairs_of_a_compass_however_wrong_are_in_the_frame_that_is_told(coefficients, seed):
    seen, _ = pairs(coefficients, seed=seed)
    assert overlap_words.checked(seen, record([0.0]), [record([0.0])]).warnings == ()


@pytest.mark.parametrize(("sign", "turns"), [(1, 1), (1, -1), (-1, 1), (-1, 2), (-1, 0)])
def test_velocities_in_another_frame_than_told_are_refused(sign, turns):
    """Ship's velocities told to be the earth's, or the reverse, or of an up-looker taken for a down-looker's."""
    seen, _ = pairs(MILD)
    upper = angles.turn(sign * seen.upper_east, seen.upper_north, turns * seen.heading_deg)
    with pytest.raises(InputError, match=r"only where they are (turned|mirrored).*; check coordinates"):
        overlap_words.checked(replace(seen, upper_east=upper[0], upper_north=upper[1]), record([0.0]), [record([0.0])])


def test_one_serial_number_in_the_files_of_both_is_refused():
    upper, lower = (replace(record([0.0]), serial_number=number) for number in ("8104", "7514"))
    seen, _ = pairs(MILD)
    assert len(overlap_words.checked(seen, upper, [lower])) == len(seen)
    with pytest.raises(InputError, match="expected two instruments, found serial number 8104 in the files of both"):
        overlap_words.checked(seen, upper, [upper])
