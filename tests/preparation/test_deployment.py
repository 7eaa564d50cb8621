"""Would catch a wrong clock, window, order or depth, and faults that are not flagged."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib.errors import InputError
from compasslib.preparation.deployment import apply_deployment, follow_neighbour
from compasslib.preparation.quality import MASKS
from compasslib.records import BAD, GOOD
from tests.world.hourly import HOUR, record, turning

SETTINGS = {"start_s": 0.0, "end_s": 20 * HOUR, "water_depth": 500.0, "latitude": 65.0, "nominal_depth": 100.0}


def test_clock_offset_and_drift_are_removed():
    drifting = record(HOUR * np.arange(21) + 30.0 + np.linspace(0.0, 60.0, 21))
    begin = SETTINGS | {"start_s": -10.0}
    settled = apply_deployment(drifting, **begin, clock_offset_seconds=30.0, clock_drift_seconds=60.0)
    assert settled.time_s[:20] == pytest.approx(HOUR * np.arange(20), abs=1.0)


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
    settled = apply_deployment(given, **SETTINGS)
    assert settled.depth_m[[0, -1]] == pytest.approx(expected, abs=3.0)


def test_a_named_column_of_constant_depths_counts_and_its_disagreement_is_reported():
    given = replace(record(HOUR * np.arange(11)), depth_m=np.full(11, 96.2))
    settled = apply_deployment(given, **SETTINGS, depth_named=True)
    assert (settled.depth_m == 96.2).all()
    assert "depth by the column of depths is 96.2 m throughout, the metadata say 100.0 m" in settled.warnings[-1]
    for stuck in (0.0, np.nan):  # no sensor
        settled = apply_deployment(replace(given, depth_m=np.full(11, stuck)), **SETTINGS, depth_named=True)
        assert (settled.depth_m == 100.0).all()
    assert (apply_deployment(given, **SETTINGS).depth_m == 100.0).all()


def test_pressure_offset_is_subtracted():
    given = replace(record(HOUR * np.arange(11)), pressure_dbar=np.linspace(101.0, 201.0, 11))
    settled = [apply_deployment(given, **SETTINGS, pressure_offset=offset) for offset in (0.0, 10.0)]
    assert settled[0].depth_m[0] - settled[1].depth_m[0] == pytest.approx(9.9, abs=0.1)
    np.testing.assert_allclose(settled[0].pressure_dbar - settled[1].pressure_dbar, 10.0)


def test_profiles_without_data_in_the_deployment_are_dropped():
    given = record(HOUR * np.arange(-3, 9))
    shape = given.east.shape
    up, counts = np.full(shape, np.nan, np.float32), np.zeros((*shape, 4), np.uint8)
    up[1], error = 0.1, np.full(shape, 0.02, np.float32)  # upward velocities only before the deployment
    settled = apply_deployment(replace(given, profiles={"up": up, "error_velocity": error, "echo": counts}), **SETTINGS)
    assert list(settled.profiles) == ["error_velocity"] and settled.profiles["error_velocity"].shape[0] == 9


def test_bins_above_the_surface_and_in_the_side_lobes_are_flagged():
    given = replace(record(HOUR * np.arange(3), ranges=(10.0, 88.0, 97.0, 110.0)), beam_angle_deg=20.0)
    settled = apply_deployment(given, **SETTINGS)
    # The side-lobe limit is 100 m times cos 20 degrees, 94 m, less half a bin.
    assert settled.counts["side_lobe"] == 2 * 3 and settled.counts["beyond_boundary"] == 3
    assert list(settled.quality[0]) == [GOOD, BAD, BAD, BAD]
    down = apply_deployment(replace(given, looks_up=False), **(SETTINGS | {"water_depth": 205.0}))
    assert down.counts["beyond_boundary"] == 3


def test_excluded_windows_are_flagged_not_deleted():
    settled = apply_deployment(record(HOUR * np.arange(10)), **SETTINGS, exclude=[(2 * HOUR, 3 * HOUR)])
    assert list(np.flatnonzero(settled.heading_quality == BAD)) == [2, 3]
    assert (settled.quality[2:4] == BAD).all() and len(settled.time_s) == 10


def test_flags_by_hand_replace_others_in_their_depths():
    given = record(HOUR * np.arange(10), ranges=(10.0, 30.0, 110.0))  # the last bin above the surface
    flags = [
        {"from_s": 2 * HOUR, "to_s": 3 * HOUR, "depths": (0.0, 75.0), "flag": 3},
        {"from_s": 3 * HOUR, "to_s": 3 * HOUR, "depths": None, "flag": 2},
        {"from_s": 5 * HOUR, "to_s": 6 * HOUR, "depths": (300.0, 400.0), "flag": 4},
    ]
    settled = apply_deployment(given, **SETTINGS, flags_by_hand=flags)
    assert settled.quality[1:5].tolist() == [[1, 1, 4], [1, 3, 4], [2, 2, 2], [1, 1, 4]]
    assert settled.counts["flagged_by_hand"] == 4 and (settled.heading_quality == GOOD).all()
    assert "flags_by_hand of 1970-01-01T05:00:00 to 1970-01-01T06:00:00: no velocity" in settled.warnings[-1]
    bits = settled.tests & MASKS["flagged_by_hand"] > 0
    assert np.argwhere(bits).tolist() == [[2, 1], [3, 0], [3, 1], [3, 2]]


def test_depth_follows_a_neighbour_on_a_leaning_wire():
    given, hours = record(HOUR * np.arange(12)), HOUR * np.arange(2, 20)
    wire = {"depths_m": [100.0, 300.0], "water_depth": 500.0, "name": "deep"}
    dips = 10.0 * np.sin(hours / HOUR) ** 2
    placed = follow_neighbour(given, hours, 300.0 + dips, **wire)
    # 400 m of wire below it and 200 m below the neighbour: it dips twice as far.
    assert placed.depth_m[2:] == pytest.approx(100.0 + 2.0 * dips[:10])
    assert "+200 m along the wire; 2 samples outside its record" in placed.warnings[-1]
    with pytest.raises(InputError, match="depth_from: deep: expected a pressure that varies, found none"):
        follow_neighbour(given, hours, np.full(len(hours), 300.0), **wire)


@pytest.mark.parametrize("applied", [18.0, {"heading": 18.0, "velocity": 0.0}, {"heading": 0.0, "velocity": 18.0}])
def test_applied_declination_is_removed(applied):
    given = record(HOUR * np.arange(3), east=0.0, north=0.2, heading=20.0)
    settled = apply_deployment(given, **SETTINGS, declination_applied=applied)
    inside = applied if isinstance(applied, dict) else {"heading": applied, "velocity": applied}
    assert settled.heading_deg == pytest.approx(20.0 - inside["heading"])
    assert np.rad2deg(np.arctan2(settled.east, settled.north)) == pytest.approx(-inside["velocity"])


def test_samples_after_a_clock_was_set_back_are_dropped():
    hours = np.concatenate([np.arange(12.0), np.arange(9.0)])
    given = replace(record(HOUR * hours), heading_deg=np.arange(21.0))
    settled = apply_deployment(given, **SETTINGS)
    assert list(settled.heading_deg) == list(range(12)) and settled.counts["clock_unsure"] == 9
    assert any("the clock was set back 1 times" in said for said in settled.warnings)


def test_unsorted_or_repeated_files_are_not_a_clock_step():
    parts = [np.arange(11.0, 16.0), np.arange(0.0, 8.0), np.arange(4.0, 8.0)]
    hours = np.concatenate(parts)
    settled = apply_deployment(replace(record(HOUR * hours), heading_deg=hours), **SETTINGS)
    assert list(settled.heading_deg) == [*range(8), *range(11, 16)]
    assert settled.counts["clock_unsure"] == 0 and settled.counts["time_repeated"] == 4


def test_overlapping_downloads_are_merged_and_contradictions_reported():
    hours = np.concatenate([np.arange(0.0, 12.0), np.arange(8.0, 21.0)])
    twice = replace(record(HOUR * hours), heading_deg=10.0 * hours)
    settled = apply_deployment(twice, **SETTINGS)
    assert list(settled.time_s / HOUR) == list(range(21))
    assert settled.counts["time_repeated"] == 4 and settled.counts["time_backwards"] == 0
    assert not any("time" in said or "clock" in said for said in settled.warnings)
    heading = np.where(np.arange(len(hours)) == 12, 3.0, twice.heading_deg)
    settled = apply_deployment(replace(twice, heading_deg=heading), **SETTINGS)
    assert any("1 samples repeat a time" in said for said in settled.warnings)


@pytest.mark.parametrize(("wrong", "at"), [(-5000.0, 1), (5000.0, 10), (9e9, 18)])
def test_single_erroneous_time_loses_its_sample(wrong, at):
    hours = np.arange(20.0)
    hours[at] += wrong
    settled = apply_deployment(record(HOUR * hours), **SETTINGS)
    assert len(settled.time_s) == 19 and settled.counts["time_wild"] + settled.counts["outside_deployment"] == 1
    assert settled.counts["clock_unsure"] == 0


def test_record_outside_its_deployment_is_reported():
    settled = apply_deployment(record(HOUR * np.arange(5000, 5020)), **SETTINGS)
    assert len(settled.time_s) == 0 and "20 of 20 samples (1970-07-28 to 1970-07-29) lie outside" in settled.warnings[0]
    assert apply_deployment(record([]), **SETTINGS).warnings == ("there is no sample with a time",)
    short = apply_deployment(record(HOUR * np.arange(5)), **SETTINGS)
    assert "the record covers 20% of the deployment (1970-01-01 to 1970-01-01)" in short.warnings


LONG = SETTINGS | {"end_s": 60 * HOUR}


def test_good_record_has_no_flags_or_warnings():
    settled = apply_deployment(turning(), **LONG)
    assert settled.warnings == () and (settled.heading_quality == GOOD).all()
    assert not any(n for key, n in settled.counts.items() if key != "side_lobe")


def test_advice_that_was_followed_is_not_repeated():
    advised = replace(turning(), warnings=("its middle is 95 s later; clock_offset_seconds: -95 moves it there.",))
    assert apply_deployment(advised, **LONG).warnings
    assert not apply_deployment(advised, **LONG, clock_offset_seconds=-95.0).warnings


def test_unused_depth_contradicting_metadata_is_reported():
    settled = apply_deployment(replace(turning(), depth_m=np.full(60, 505.0)), **LONG)
    assert any("the file's depth of 505 m never varies and was not used" in said for said in settled.warnings)
