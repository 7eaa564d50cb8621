"""Angles: properties on which all other subpackages rely."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from compasslib import angles

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


def test_tiny_negative_angle_is_not_360():
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


def test_zero_vector_has_no_direction():
    assert np.isnan(angles.direction(0.0, 0.0))


def test_circular_statistics_cross_north_and_ignore_nan():
    assert angles.mean([350.0, 10.0, np.nan]) == pytest.approx(0.0, abs=1e-9)
    assert np.isnan(angles.mean([np.nan]))
    assert angles.resultant_length([10.0, 190.0]) == pytest.approx(0.0, abs=1e-12)
    assert angles.rms([359.0, -1.0, np.nan]) == pytest.approx(1.0)
