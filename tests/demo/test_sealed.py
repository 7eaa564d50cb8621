"""Would catch a planted effect that does not act by its formula, or not in the requested size."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib.demo import compass, sealed
from compasslib.demo.compass import Magnetometer
from compasslib.demo.sealed import Effect
from tests.world import draw

PLAIN = Magnetometer((), (np.array([9.0, 0.0, 0.0]), 0.0), np.zeros((3, 3)), np.eye(3))


@pytest.fixture(scope="module")
def ground():
    return sealed.make(4, "T", sealed.Wish(wide=True, hours=1500))


def turned(ground, effect, meter=PLAIN):
    """Compute the change of a plain compass's reading by an effect, degrees, and the reading without it."""
    bare = sealed.read(replace(ground, meter=meter), (), ground.stamp_s)
    with_it = sealed.read(replace(ground, meter=meter), (effect,), ground.stamp_s)
    return (with_it.recorded_deg - bare.recorded_deg + 180.0) % 360.0 - 180.0, bare


def test_dipole_field_decays_cubically_and_doubles_on_axis():
    along = compass.dipole_nt(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 0.5]))
    across = compass.dipole_nt(np.array([0.0, 0.0, 2.0]), np.array([0.5, 0.0, 0.0]))
    assert along == pytest.approx([0.0, 0.0, 2 * 100.0 * 2.0 / 0.5**3]) and across == pytest.approx(-along / 2)
    twice = compass.dipole_nt(np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 1.0]))
    assert twice == pytest.approx(along / 8)


def test_iron_ball_response_along_and_across():
    meter = replace(PLAIN, ball=(np.array([0.0, 0.0, 0.8]), 0.2))
    matrix, added = compass.response(meter)
    share = (0.2 / 0.8) ** 3
    assert matrix == pytest.approx(np.diag([1 - share, 1 - share, 1 + 2 * share])) and not added.any()


def test_iron_has_requested_strength_and_readings_are_quantized(ground):
    meter = compass.build(np.random.default_rng(1), (14000.0, 48000.0), 0.35)
    assert np.hypot(*compass.response(meter)[1][:2]) == pytest.approx(0.35 * 14000.0)
    given = compass.felt(meter, np.array([[14000.0, 0.0, 48000.0]]))
    assert np.allclose(given % meter.step_nt, 0.0)
    assert np.std(draw.residual_deg(ground, ())) < 0.35  # below the size at which an effect is named


@pytest.mark.parametrize("iron_nt", [(0.0, 0.0, 1000.0), (150.0, -120.0, 0.0)])
def test_iron_deviates_by_its_transverse_part_and_vertical_iron_through_tilt(ground, iron_nt):
    x, y, z = iron_nt
    off, bare = turned(ground, Effect(body_nt=np.array(iron_nt) * np.ones((ground.stamp_s.size, 1))))
    heading, horizontal = np.deg2rad(bare.heading_deg), ground.field.at(ground.stamp_s)[1]
    pitch, roll = (
        np.deg2rad(np.interp(ground.stamp_s, ground.motion.time_s, tilt))
        for tilt in (ground.motion.pitch_deg, ground.motion.roll_deg)
    )
    # To first order z adds (pitch, -roll) z forward and starboard.
    across = (x + z * pitch) * np.sin(heading) + (y - z * roll) * np.cos(heading)
    assert np.abs(off + np.rad2deg(across / horizontal)).max() < 0.15


def test_effect_on_the_reading_is_added_to_it(ground):
    off, bare = turned(ground, Effect(reading=lambda gamma: np.sin(np.deg2rad(3 * gamma) + 0.7)))
    assert off == pytest.approx(np.sin(np.deg2rad(3 * bare.recorded_deg) + 0.7), abs=1e-6)
    off, _ = turned(ground, draw.effect_of(ground, "heading_slip")(0.5))
    assert off[0] == pytest.approx(0.0) and off[-1] == pytest.approx(0.5) and np.sum(np.diff(off) > 0.1) == 1


def test_quadratic_sensor_response_gives_a_third_harmonic():
    turn = np.deg2rad(np.arange(0.0, 360.0, 5.0))
    level = np.stack([14000.0 * np.cos(turn), -14000.0 * np.sin(turn), np.zeros(turn.size)], axis=-1)
    x, y, _ = compass.felt(replace(PLAIN, even=(0.05, 0.0, 0.0)), level, stepped=False).T
    off = np.rad2deg(np.angle((x - 1j * y) * np.exp(-1j * turn)))
    # The square of the cosine times the sine consists of a quarter each of the first and the third harmonic.
    expected = -np.rad2deg(0.05 * 14000.0 / 50000.0 / 4.0) * (np.sin(turn) + np.sin(3 * turn))
    assert off == pytest.approx(expected, abs=0.01)


def test_effects_are_planted_with_the_requested_size(ground):
    for name in draw.EFFECTS:
        assert draw.plant(ground, name, 1.5)[1] == pytest.approx(1.5, rel=0.05), name
