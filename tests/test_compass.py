"""Would catch a wrong angle function, and an exact compass with wrong inverse, derivatives or special cases."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from compasslib import angles, compass
from compasslib.deviation.series import series_deviation
from tests.world.sea import SHARED

ANGLES = st.floats(-1e6, 1e6)


@given(ANGLES)
def test_wrapping_is_idempotent_and_stays_inside(a):
    for wrap, low in ((angles.wrap360, 0.0), (angles.wrap180, -180.0)):
        once = wrap(a)
        assert low <= once < low + 360.0
        assert wrap(once) == pytest.approx(once, abs=1e-9)


@given(ANGLES, st.integers(-5, 5))
def test_whole_turns_change_nothing(a, turns):
    assert abs(angles.difference(a + 360.0 * turns, a)) < 1e-6
    assert angles.wrap360(-1e-17) == 0.0


@given(st.floats(0.01, 10), st.floats(0, 359.9))
def test_components_and_direction_are_inverse(speed, towards):
    assert abs(angles.difference(angles.direction(*angles.components(speed, towards)), towards)) < 1e-9


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-720, 720))
def test_rotation_preserves_length_and_changes_direction(east, north, by):
    turned = angles.turn(east, north, by)
    assert np.hypot(*turned) == pytest.approx(np.hypot(east, north), abs=1e-12)
    if np.hypot(east, north) > 1e-6:
        moved = angles.difference(angles.direction(*turned), angles.direction(east, north))
        assert abs(angles.difference(moved, by)) < 1e-6


def test_circular_statistics_cross_north_and_ignore_nan():
    assert angles.mean([350.0, 10.0, np.nan]) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(angles.mean([np.nan])) and np.isnan(angles.direction(0.0, 0.0))
    assert angles.resultant_length([10.0, 190.0]) == pytest.approx(0.0, abs=1e-12)
    assert angles.rms([359.0, -1.0, np.nan]) == pytest.approx(1.0)


SOFT = st.floats(-0.15, 0.15)
HARD = st.floats(-1.6, 1.6)
COEFFICIENTS = st.tuples(SOFT, HARD, HARD, SOFT, SOFT)


@pytest.mark.skipif(not SHARED.exists(), reason="no ../shared/data")
def test_known_answers_with_tilt():
    for case in json.loads((SHARED / "vectors.json").read_text())["compass_with_tilt"]:
        field = {"horizontal_nT": case["H_nT"], "vertical_nT": case["Z_nT"]}
        tilt = {"pitch_deg": case["pitch"], "roll_deg": case["roll"]}
        level = compass.level_coefficients(case["soft"], case["hard_nT"], **field, **tilt)
        recorded = compass.recorded_heading(level, case["heading_magnetic"])
        assert abs(angles.difference(recorded, case["recorded"])) < 1e-5  # the file has six decimals
        roots = compass.inverse(level, np.array([case["recorded"]]))
        assert np.nanmin(np.abs(angles.difference(roots, case["heading_magnetic"]))) < 1e-3


@given(COEFFICIENTS, st.floats(0, 359.99))
def test_inverse_recovers_the_heading(coefficients, heading):
    if abs(compass.level_field(coefficients, heading)) < 1e-3 or abs(compass.slope(coefficients, heading)) < 1e-3:
        return  # no horizontal field, or at the fold
    roots = compass.inverse(coefficients, np.array([compass.recorded_heading(coefficients, heading)]))
    assert np.nanmin(np.abs(angles.difference(roots, heading))) < 1e-4


@given(COEFFICIENTS)
def test_full_circle_means_one_root_everywhere(coefficients):
    u, p, v = 1 - 1j * coefficients[0], coefficients[1] - 1j * coefficients[2], coefficients[3] - 1j * coefficients[4]
    margin = abs(u) ** 2 - abs(v) ** 2 - abs(np.conj(u) * p - v * np.conj(p))
    if abs(margin) < 0.02:
        return
    count = np.isfinite(compass.inverse(coefficients, np.arange(0.0, 360.0, 3.0))).sum(axis=1)
    if compass.turns_full_circle(coefficients):
        assert (count == 1).all()
    else:
        assert set(count) <= {0, 2}


def test_hard_iron_of_1_3_covers_100_degrees_and_inverts_to_roots_that_agree():
    low, high = compass.recorded_range((0.0, 1.3, 0.0, 0.0, 0.0))
    assert high - low == pytest.approx(2 * np.rad2deg(np.arcsin(1 / 1.3)), abs=0.01)
    roots = compass.inverse((0.0, 1.3, 0.0, 0.0, 0.0), np.array([20.0, 90.0]))
    assert np.isfinite(roots[0]).all() and np.isnan(roots[1]).all()
    assert compass.recorded_heading((0.0, 1.3, 0.0, 0.0, 0.0), roots[0]) == pytest.approx([20.0, 20.0])


@given(COEFFICIENTS)
def test_slope_and_gradient_are_the_derivatives(coefficients):
    heading = np.array([12.0, 100.0, 215.0, 303.0])
    if np.abs(compass.level_field(coefficients, heading)).min() < 0.05:
        return
    k, h = np.array(coefficients), 1e-6
    ahead, behind = (compass.recorded_heading(k, heading + s * h) for s in (1, -1))
    assert angles.difference(ahead, behind) / (2 * h) == pytest.approx(compass.slope(k, heading), rel=1e-4, abs=1e-5)
    for j, unit in enumerate(np.eye(5)):
        ahead, behind = (compass.recorded_heading(k + s * h * unit, heading) for s in (1, -1))
        numeric = angles.difference(ahead, behind) / (2 * h)
        assert numeric == pytest.approx(compass.gradient(k, heading)[j], rel=1e-4, abs=1e-3)


def test_first_order_is_the_published_series():
    small = np.array([0.2, 1.0, -0.7, 0.4, 0.3])
    heading = np.arange(0.0, 360.0, 10.0)
    exact = angles.difference(heading, compass.recorded_heading(np.deg2rad(small), heading))
    assert exact == pytest.approx(series_deviation(small, heading), abs=0.05)  # second order of one degree


def test_le_menn_4_with_atan2_is_the_same_compass():
    a, b, c, d, e = 0.1, 0.9, -0.5, 0.1, 0.05
    heading = np.arange(0.0, 360.0, 7.0)
    s, k = angles.sin_cos(heading)
    s2, k2 = angles.sin_cos(2 * heading)
    top, bottom = a + b * s + c * k + d * s2 + e * k2, 1 + b * k - c * s + d * k2 - e * s2
    deviation = np.rad2deg(np.arctan2(top, bottom))
    recorded = compass.recorded_heading((a, b, c, d, e), heading)
    assert np.abs(angles.difference(heading - deviation, recorded)).max() < 1e-9
