"""Would catch a predicted velocity of the water that takes a compass error with it."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles, compass, readers
from compasslib.preparation.pairs import find_pairs
from compasslib.preparation.water import (
    VEER_S,
    _predict_veer,
    delay_of_current,
    fails_speed_check,
    fit_slow_shear,
    fit_structure,
    predict_water,
    veer_of_nearest_bins,
)
from compasslib.records import BAD, Record
from tests.world.layers import ALL_NEAR, BINS, CELL_M, FIELD, HOURS, error_deg, instrument, layers, seen
from tests.world.pairs import red, red_from_rest
from tests.world.sea import FOLDED, MILD, real

BY_BIN = ("east", "north", "bin_range_m", "quality")


def errors(top: Record, trusted: Record, heading: np.ndarray, coefficients=MILD, **rules) -> float:
    return error_deg(find_pairs(top, [trusted], FIELD, replace(ALL_NEAR, **rules)), top, heading, coefficients)


def test_weights_sum_to_one_and_preserve_uniform_water():
    learnt = fit_structure(seen(MILD, layers(1))[0])
    for away in (np.array([8.0, 12.0, 16.0]), np.array([-4.0, 4.0, 8.0, 12.0]), np.array([40.0])):
        assert learnt.weights(away).sum() == pytest.approx(1.0)
    top, trusted, _ = seen(MILD, np.tile(layers(1)[:, :1], (1, BINS + 2)))
    assert predict_water(top, trusted.bin_depth_m()[:, 0], 2) is None  # no estimate: the mean of bins is used
    noisy = seen(MILD, layers(1)[:, :1] + 1e-4 * layers(2))[0]
    predicted = predict_water(noisy, trusted.bin_depth_m()[:, 0], 2)
    assert np.abs(predicted.velocity - (top.east[:, 0] + 1j * top.north[:, 0])).max() < 1e-3


def test_prediction_at_the_depth_of_a_bin_equals_it():
    top, _, _ = seen(MILD, layers(2, noise_m_s=1e-4))
    found = predict_water(top, top.bin_depth_m()[:, 3], 2)
    off = found.velocity - (top.east[:, 3] + 1j * top.north[:, 3])
    assert np.sqrt(np.mean(np.abs(off) ** 2)) < 0.1 * np.std(top.east[:, 4] - top.east[:, 3])


def test_prediction_beats_the_mean_and_states_its_error():
    flow = layers(3)
    top, trusted, _ = seen((0.0,) * 5, flow)
    found = predict_water(top, trusted.bin_depth_m()[:, 0], 2)
    mean = flow[:, 2:4].mean(axis=1)
    real = [float(np.sqrt(np.mean(np.abs(x - flow[:, 0]) ** 2) / 2.0)) for x in (mean, found.velocity)]
    assert real[1] < 0.75 * real[0]
    assert found.published_m_s == pytest.approx(real[0], rel=0.3)
    assert found.expected_m_s == pytest.approx(real[1], rel=0.4)


def test_delay_within_the_profile_is_that_of_its_bins_and_0_without_distances():
    hour, z = np.arange(HOURS)[:, None], CELL_M * np.arange(BINS + 2)
    waves = np.exp(-1j * (2 * np.pi * hour / 14.0 + 2 * np.pi * z / 150.0))  # 1.12 h later 12 m above
    top = seen(MILD, 0.12 + 0.15 * waves + 0.2 * layers(4))[0]
    assert delay_of_current(top, 12.0) == pytest.approx(1.12, rel=0.4)
    assert delay_of_current(replace(top, bin_range_m=0.0 * top.bin_range_m), 12.0) == 0.0


@pytest.mark.parametrize("at", [0, 4])
def test_a_wrong_depth_of_the_reference_is_told_with_the_bin_it_agrees_with(at):
    top, trusted, _ = seen(MILD, layers(2))
    velocity = {name: column[:, at : at + 1] + 0.01 for name, column in (("east", top.east), ("north", top.north))}
    found = find_pairs(top, [replace(trusted, **velocity)], FIELD, ALL_NEAR)
    told = f"nearer to those of the bin at {np.median(top.bin_depth_m()[:, at]):.0f} m"
    assert any(told in text for text in found.warnings) == (at > 0)


@pytest.mark.parametrize("coefficients", [MILD, FOLDED], ids=["mild", "folded"])
def test_prediction_rotates_with_the_profile(coefficients):
    """Deviation, slip and drift rotate all bins alike and must be preserved completely."""
    flow = layers(4)
    plain, trusted, heading = seen((0.0,) * 5, flow)
    hours = np.arange(HOURS)
    turn = angles.difference(compass.recorded_heading(coefficients, heading), heading)
    turn = turn + np.where(hours > 1200, 12.0, 0.0) + 5e-3 * hours  # a slipped mount and a drifting compass
    by = np.exp(-1j * np.deg2rad(turn))[:, None]
    velocity = (plain.east + 1j * plain.north) * by
    turned = replace(plain, east=velocity.real, north=velocity.imag)
    depth = trusted.bin_depth_m()[:, 0]
    before, after = (predict_water(one, depth, 2).velocity for one in (plain, turned))
    assert np.abs(after - before * by[:, 0]).max() < 1e-9


@pytest.mark.parametrize("shear", [0.0, 0.004 + 0.003j])  # m/s per bin, from a mean current that changes with depth
def test_prediction_reduces_heading_errors_even_with_shear(shear):
    off = []
    for seed in range(5, 9):
        moored = seen(MILD, layers(seed) + shear * np.arange(BINS + 2), seed)
        off.append([errors(*moored, predict=on) for on in (False, True)])
        assert off[-1][1] < off[-1][0] + 0.2
    before, after = np.sqrt(np.mean(np.square(off), axis=0))
    assert after < 0.75 * before


def test_persistent_veer_is_predicted_and_its_residual_stated():
    """As in an Ekman spiral of 3 degrees per bin; water that does not veer is not rotated."""
    left, stated = [], []
    for seed in range(20, 28):
        for by_cell in (0.0, 3.0):
            flow = layers(seed) * angles.phasor(by_cell * np.arange(BINS + 2))
            top, trusted, _ = seen((0.0,) * 5, flow)
            found = predict_water(top, trusted.bin_depth_m()[:, 0], 2)
            turned = angles.argument(np.sum(found.velocity * np.conj(flow[:, 0] / np.abs(flow[:, 0]))))
            left.append(float(angles.wrap180(turned)))
            stated.append(found.veer.mean_deg)
    assert np.sqrt(np.mean(np.square(left))) < 1.0  # out of 6 degrees
    assert 0.5 < np.sqrt(np.mean(np.square(left)) / np.mean(np.square(stated))) < 2.0


def test_short_profile_states_its_possible_veer(bins=5):
    flow = layers(3, bins=bins + 2) * angles.phasor(4.0 * np.arange(bins + 2))
    top, trusted, _ = seen((0.0,) * 5, np.delete(np.column_stack([flow, flow[:, -1:]]), 1, axis=1))
    found = predict_water(top, trusted.bin_depth_m()[:, 0], 2)
    assert 2.0 < found.veer.mean_deg < 20.0


@pytest.mark.parametrize(("bins", "apart"), [(2, 1.0), (8, 2.0), (8, 0.5)])
def test_mean_of_bins_states_its_possible_veer(bins, apart):
    """At any depth of the reference, also between two bins; without veer the stated angle is small."""
    stated = []
    for by_cell in (0.0, 4.0):
        top, trusted, _ = seen((0.0,) * 5, layers(3, bins=bins + 2) * angles.phasor(by_cell * np.arange(bins + 2)))
        away = (trusted.bin_depth_m() - top.bin_depth_m()[:, :1]) * apart / 2.0  # the reference is two bins away
        stated.append(veer_of_nearest_bins(top, top.bin_depth_m()[:, 0] + away[:, 0], 2).mean_deg)
    still, turning = stated
    assert still < 2.5 and 0.5 < turning / (4.0 * max(apart, 1.0)) < 3.0


def test_veer_is_continuous_across_180_degrees():
    hours = np.arange(HOURS)
    turn = np.where(hours // (VEER_S / 3600.0) % 2 == 0, 170.0, 190.0)
    flow = 0.3 * np.exp(1j * np.deg2rad(turn[:, None] * np.arange(6)))
    top = instrument(flow, CELL_M, heading_deg=np.zeros(HOURS))
    away = CELL_M * np.arange(1, 7)
    turned, _ = _predict_veer(top, away, CELL_M, lambda bins_m: np.full(len(bins_m), 1.0 / len(bins_m)), 1)
    assert np.abs(turned).min() > 150.0


def test_single_bin_gives_no_veer_estimate():
    top, trusted, _ = seen((0.0,) * 5, layers(3, bins=3))
    few = replace(top, **{name: getattr(top, name)[:, :1] for name in BY_BIN})
    assert veer_of_nearest_bins(few, trusted.bin_depth_m()[:, 0], 2).mean_deg == 0.0


def test_bad_bins_are_excluded_and_short_profiles_averaged():
    top, trusted, _ = seen(MILD, layers(9))
    wild = np.where(np.arange(HOURS) % 3 == 0, 5.0, 0.0)[:, None] * (np.arange(BINS) == 2)
    quality = np.where(wild > 0, BAD, 1).astype(np.int8)
    spoilt = replace(top, east=top.east + wild, quality=quality)
    depth = trusted.bin_depth_m()[:, 0]
    clean, left_out = (predict_water(one, depth, 2).velocity for one in (top, spoilt))
    assert np.sqrt(np.mean(np.abs(clean - left_out) ** 2)) < 0.015  # the veer is estimated without them
    for some in (slice(0, 1), slice(0, 3)):
        few = replace(top, **{name: getattr(top, name)[:, some] for name in BY_BIN})
        assert predict_water(few, depth, 2) is None
        found = [find_pairs(few, [trusted], FIELD, replace(ALL_NEAR, predict=on)) for on in (False, True)]
        assert found[0].upper_east == pytest.approx(found[1].upper_east) and found[1].expected_m_s is None


def test_prediction_reduces_heading_errors_of_a_real_profile():
    """``benchmarks/water.py`` covers all depths, gaps and iron strengths."""
    path = real("pd0/eh2_20060530_20060717_0007m.000")
    record = replace(readers.read("pd0", [path], {}), serial_number=None)
    record = replace(record, depth_m=np.full(len(record.time_s), 7.0))
    cut = {name: getattr(record, name) for name in BY_BIN}
    trusted = replace(record, **{name: column[:, 3:4] for name, column in cut.items()})
    recorded = compass.recorded_heading(FOLDED, record.heading_deg)
    turn = angles.difference(recorded, record.heading_deg)[:, None]
    east, north = angles.turn(record.east, record.north, turn)
    above = {name: column[:, 5:] for name, column in (cut | {"east": east, "north": north}).items()}
    top = replace(record, **above, heading_deg=recorded)
    before, after = (errors(top, trusted, record.heading_deg, FOLDED, predict=on) for on in (False, True))
    assert after < 0.75 * before


def test_worse_prediction_fails_the_speed_check():
    """As for a depth wrong by tens of metres: the mean of the bins is used, and no expected error is stated."""
    flow = layers(11)
    time_s, rng = 1.19e9 + 3600.0 * np.arange(HOURS), np.random.default_rng(3)
    mean, trusted = flow[:, 2:4].mean(axis=1), flow[:, 0]
    wild = mean + 0.1 * (red_from_rest(rng, HOURS, 6, 1.0) + 1j * red_from_rest(rng, HOURS, 6, 1.0))
    better = (mean + trusted) / 2.0
    assert fails_speed_check(time_s, mean, wild, trusted)
    assert not fails_speed_check(time_s, mean, better, trusted)
    equal = [fails_speed_check(time_s, *layers(seed)[:, [3, 2, 0]].T) for seed in range(20, 40)]
    assert np.mean(equal) < 0.2


def test_wrong_reference_depth_is_reported():
    """The reference is at the depth of the fourth bin, and is stated at that of the eighth."""
    flow = layers(12, noise_m_s=0.005)
    top, _, heading = seen(MILD, flow)
    right = float(top.bin_depth_m()[0, 3])
    for depth, expected in ((right, ""), (float(top.bin_depth_m()[0, 7]), "check depths, clocks")):
        trusted = instrument(flow[:, 5:6], 0.0, heading_deg=heading, depth=depth)
        warnings = find_pairs(top, [trusted], FIELD, replace(ALL_NEAR, predict=True)).warnings
        assert any(expected in one for one in warnings) if expected else not warnings


def test_size_and_memory_of_slow_shear_are_estimated_within_their_errors():
    """Of 12 records of four windows, each with slow shear of 2 cm/s and 15 days beside tides and noise."""
    hours, off = np.arange(24 * 300.0), []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        common = red(rng, len(hours), 15 * 24, 0.02)
        own = np.array([red(rng, len(hours), 15 * 24, 0.005) for _ in range(4)])
        fast = 0.05 * np.sin(2.0 * np.pi * hours / 12.4206) + rng.normal(0.0, 0.03, own.shape)
        known = rng.random(own.shape) > 0.1
        found = fit_slow_shear(1.2e9 + 3600.0 * hours, common + own + fast, known)
        size = np.log(found.size_m_s / np.hypot(0.02, 0.005)) / found.log_sigma
        off.append((size, np.log(found.memory_days / 15.0) / found.memory_log_sigma))
    assert np.all(np.sqrt(np.mean(np.square(off), axis=0)) < 1.5) and found.log_sigma < 0.6


def test_a_short_record_shows_no_slow_shear():
    time_s = 1.2e9 + 3600.0 * np.arange(24 * 20)
    assert fit_slow_shear(time_s, np.ones((3, len(time_s))), np.ones((3, len(time_s)), dtype=bool)) is None
