"""From export to deployment: clock, window, order, depth, flags."""

from dataclasses import replace

import numpy as np
import pytest
from test_grid_overlap import HOUR, record

from compasslib import deployment
from compasslib.records import BAD, GOOD

SETTINGS = {"start_s": 0.0, "end_s": 20 * HOUR, "water_depth": 500.0, "latitude": 65.0, "nominal_depth": 100.0}


def test_clock_offset_and_drift_are_taken_out():
    drifting = record(HOUR * np.arange(21) + 30.0 + np.linspace(0.0, 60.0, 21))
    begin = SETTINGS | {"start_s": -10.0}
    settled = deployment.settle(drifting, **begin, clock_offset_seconds=30.0, clock_drift_seconds=60.0)
    assert settled.time_s[:20] == pytest.approx(HOUR * np.arange(20), abs=1.0)


def test_samples_outside_the_deployment_are_counted_and_left_out():
    settled = deployment.settle(record(HOUR * np.arange(-3, 30)), **SETTINGS)
    assert len(settled.time_s) == 21 and settled.counts["outside_deployment"] == 12


def test_time_is_put_in_order_and_repeats_are_dropped_both_said():
    settled = deployment.settle(record(HOUR * np.array([0, 1, 3, 2, 2, 4])), **SETTINGS)
    assert list(settled.time_s / HOUR) == [0, 1, 2, 3, 4]
    assert settled.counts["time_backwards"] == 1 and settled.counts["time_repeated"] == 1
    assert any("backwards" in sentence for sentence in settled.warnings)


@pytest.mark.parametrize(
    ("pressure", "field", "expected"),
    [
        (np.linspace(101.0, 303.0, 11), np.full(11, 90.0), (99.0, 301.0)),  # pressure varies
        (np.full(11, 101.0), np.linspace(100.0, 400.0, 11), (99.0, 401.0)),  # only the depth field varies
        (np.full(11, np.nan), np.full(11, 90.0), (100.0, 100.0)),  # neither: the metadata
    ],
)
def test_depth_comes_from_pressure_then_depth_field_then_metadata(pressure, field, expected):
    given = replace(record(HOUR * np.arange(11)), pressure_dbar=pressure, depth_m=field)
    settled = deployment.settle(given, **SETTINGS)
    assert settled.depth_m[[0, -1]] == pytest.approx(expected, abs=3.0)


def test_pressure_offset_is_subtracted():
    given = replace(record(HOUR * np.arange(11)), pressure_dbar=np.linspace(101.0, 201.0, 11))
    depth = [deployment.settle(given, **SETTINGS, pressure_offset=offset).depth_m[0] for offset in (0.0, 10.0)]
    assert depth[0] - depth[1] == pytest.approx(9.9, abs=0.1)


def test_bins_above_the_surface_and_in_the_side_lobes_are_flagged():
    given = replace(record(HOUR * np.arange(3), ranges=(10.0, 88.0, 97.0, 110.0)), beam_angle_deg=20.0)
    settled = deployment.settle(given, **SETTINGS)
    # cos 20 degrees of 100 m is 94 m, less half a bin
    assert settled.counts["side_lobe"] == 2 * 3 and settled.counts["beyond_boundary"] == 3
    assert list(settled.quality[0]) == [GOOD, BAD, BAD, BAD]
    down = deployment.settle(replace(given, looks_up=False), **(SETTINGS | {"water_depth": 205.0}))
    assert down.counts["beyond_boundary"] == 3


def test_excluded_windows_are_flagged_not_deleted():
    settled = deployment.settle(record(HOUR * np.arange(10)), **SETTINGS, exclude=[(2 * HOUR, 3 * HOUR)])
    assert list(np.flatnonzero(settled.heading_quality == BAD)) == [2, 3]
    assert (settled.quality[2:4] == BAD).all() and len(settled.time_s) == 10


def test_impossible_speeds_and_tilts_are_flagged_and_said():
    given = record(HOUR * np.arange(4))
    east = given.east.copy()
    east[1] = 9.0
    settled = deployment.settle(replace(given, east=east, pitch_deg=np.array([3.0, 3.0, 80.0, 3.0])), **SETTINGS)
    assert settled.counts["impossible_speed"] == 3 and settled.counts["steep_tilt"] == 3
    assert len([said for said in settled.warnings if "velocities flagged" in said]) == 2


def test_applied_declination_is_turned_back():
    given = record(HOUR * np.arange(3), east=0.0, north=0.2, heading=5.0)
    settled = deployment.settle(given, **SETTINGS, declination_applied=18.0)
    assert settled.heading_deg == pytest.approx(347.0)
    assert np.rad2deg(np.arctan2(settled.east, settled.north)) == pytest.approx(-18.0)
