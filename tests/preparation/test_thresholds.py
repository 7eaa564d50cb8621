"""Would catch a threshold of a test of velocities that is ignored, or a failed test that is not recorded."""

from dataclasses import replace

import netCDF4
import numpy as np
import pytest

from compasslib.archive import netcdf
from compasslib.preparation.quality import CHECKS, MASKS, Thresholds, flag_quality
from compasslib.records import BAD, GOOD, MISSING, PROBABLY_BAD, PROBABLY_GOOD, Record
from tests.world.products import make_product, write
from tests.world.sea import plain_record

N, M = 40, 5
SHARES = np.array([80, 30, 20, 10, 60])  # percent good of each bin


def record(**columns) -> Record:
    """Make a sound profiler record whose percent good, correlation, echo and error velocity differ between bins."""
    rng = np.random.default_rng(3)
    percent = np.zeros((N, M, 4), dtype=np.int16)
    percent[..., 3] = SHARES
    counts = np.broadcast_to(np.array([120, 70, 60, 90, 100], dtype=np.int16)[None, :, None], (N, M, 4))
    error = np.broadcast_to(np.array([0.0, 0.1, -0.3, np.nan, 0.05]), (N, M))
    pitch, roll = rng.normal(2.0, 0.5, (2, N))
    sound = {
        "heading_deg": rng.uniform(0.0, 360.0, N),
        "pitch_deg": pitch,
        "roll_deg": roll,
        "depth_m": np.full(N, 100.0),
        "quality": np.where(np.broadcast_to(SHARES < 25, (N, M)), BAD, GOOD).astype(np.int8),
        "recorded_in": "earth",
        "profiles": {"percent_good": percent, "correlation": counts, "echo": counts + 40, "error_velocity": error},
    }
    flow = rng.normal(0.0, 0.1, (N, M)) + 1j * rng.normal(0.0, 0.1, (N, M))
    return plain_record(3600.0 * np.arange(N), flow, np.linspace(4.0, 20.0, M), **(sound | columns))


def bad_bins(flagged: Record) -> list[int]:
    assert ((flagged.quality == flagged.quality[0]).all()) and flagged.tests is not None
    return np.flatnonzero(flagged.quality[0] == BAD).tolist()


@pytest.mark.parametrize(
    ("thresholds", "bad", "test"),
    [
        ({}, [2, 3], "low_percent_good"),
        ({"percent_good": 50.0}, [1, 2, 3], "low_percent_good"),
        ({"correlation": 80.0}, [1, 2, 3], "low_correlation"),
        ({"echo": 115.0}, [1, 2, 3], "weak_echo"),
        ({"error_velocity": 0.08}, [1, 2, 3], "large_error_velocity"),
    ],
)
def test_threshold_flags_velocities_and_sets_its_bit(thresholds, bad, test):
    probably = np.where(record().quality == GOOD, PROBABLY_GOOD, BAD).astype(np.int8)
    for read in (record(quality=probably), record()):
        flagged = flag_quality(read, 500.0, thresholds=Thresholds(**thresholds))
        assert bad_bins(flagged) == bad
    counts = np.array([120, 70, 60, 90, 100])
    failed = {
        "low_percent_good": thresholds.get("percent_good", 25.0) > SHARES,
        "low_correlation": counts < thresholds.get("correlation", 0.0),
        "weak_echo": counts + 40 < thresholds.get("echo", 0.0),
        "large_error_velocity": np.array([False, True, True, False, False]),
    }
    assert ((flagged.tests[0] & MASKS[test] > 0) == failed[test]).all()


def test_two_weak_beams_of_four_fail_and_one_does_not():
    weak = np.full((N, M, 4), 100, dtype=np.int16)
    weak[:, 0, 0], weak[:, 1, :2], weak[:, 2, 0] = 30, 30, -1  # one beam, two beams, one missing
    flagged = flag_quality(record(profiles={"correlation": weak}, quality=np.ones((N, M), np.int8)), 500.0,
                           thresholds=Thresholds(correlation=64.0))  # fmt: skip
    assert bad_bins(flagged) == [1] and "(20 %)" in flagged.warnings[0]


def test_bins_from_a_jump_of_the_echo_on_are_flagged_in_the_farther_half():
    echo = np.full((N, M, 4), 80, dtype=np.int16)
    echo[:, 0, :], echo[:, 3, :2], echo[:5, 3, 1] = 200, 130, 80  # a school of fish nearby; the surface; one beam only
    flagged = flag_quality(record(profiles={"echo": echo}, quality=np.ones((N, M), np.int8)), 500.0,
                           thresholds=Thresholds(echo_jump=30.0))  # fmt: skip
    assert (flagged.quality[5:, 3:] == BAD).all() and (flagged.quality[:5] == GOOD).all()
    assert (flagged.quality[:, :3] == GOOD).all() and flagged.counts["echo_jump"] == 2 * (N - 5)


def test_single_outliers_are_spikes_and_steps_of_the_current_are_not():
    sound = record(profiles={}, quality=np.ones((N, M), np.int8))
    east = sound.east + np.where(np.arange(N) >= 20, 0.8, 0.0)[:, None]
    east[7, 2] += 3.0
    flagged = flag_quality(replace(sound, east=east), 500.0, thresholds=Thresholds(spike=10.0))
    assert np.argwhere(flagged.quality == BAD).tolist() == [[7, 2]]
    assert flagged.tests[7, 2] == MASKS["spike"] == 1 << 16


def test_all_failed_tests_are_recorded_except_for_missing_velocities():
    east, pitch = record().east.copy(), record().pitch_deg.copy()
    east[3, 2], pitch[3] = 7.0, 50.0
    quality = record().quality.copy()
    quality[3, 4] = MISSING
    flagged = flag_quality(record(east=east, pitch_deg=pitch, quality=quality), 500.0)
    names = {name for name in MASKS if flagged.tests[3, 2] & MASKS[name]}
    assert names == {"low_percent_good", "impossible_speed", "steep_tilt"}
    assert flagged.tests[3, 4] == 0 and flagged.quality[3, 4] == MISSING
    assert flagged.counts["impossible_speed"] == 0 and flagged.counts["steep_tilt"] == 2  # of those good before
    lax = flag_quality(record(east=east, pitch_deg=pitch), 500.0, thresholds=Thresholds(speed=8.0, tilt_deg=60.0))
    assert not (lax.tests & (MASKS["impossible_speed"] | MASKS["steep_tilt"])).any()


def test_flags_of_the_file_are_kept_without_percent_good():
    flagged = flag_quality(record(profiles={}), 500.0, thresholds=Thresholds(percent_good=50.0, correlation=99.0))
    assert bad_bins(flagged) == [2, 3] and (flagged.tests[:, 2:4] == MASKS["flagged_in_file"]).all()


def test_archive_stores_tests_with_masks_and_meanings(tmp_path):
    product = make_product(30, 4)
    tests = np.zeros((30, 4), dtype=np.int32)
    tests[2, 1] = MASKS["side_lobe"] | MASKS["impossible_speed"]
    product = replace(product, record=replace(product.record, tests=tests))
    write(tmp_path / "corrected.nc", product)
    with netCDF4.Dataset(tmp_path / "corrected.nc") as nc:
        stored = nc["UCUR_QC_TESTS"]
        meanings = [check.meaning for check in CHECKS]
        assert stored.dimensions == ("TIME", "BIN") and stored.flag_meanings.split() == meanings
        assert stored.flag_masks.tolist() == [1 << k for k in range(len(CHECKS))]
        assert stored.flag_masks.dtype == stored.dtype
        doubtful = nc["HEADING_CORRECTED_QC"][:] >= PROBABLY_BAD
        assert (stored[:] == tests | np.where(doubtful, MASKS["heading"], 0)[:, None]).all()
    netcdf.write_record(tmp_path / "record.nc", product.record)
    assert (netcdf.read_record(tmp_path / "record.nc").tests == tests).all()
    netcdf.write_record(tmp_path / "older.nc", replace(product.record, tests=None))
    assert netcdf.read_record(tmp_path / "older.nc").tests is None
