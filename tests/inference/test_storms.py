"""Would catch moving iron, shifted tilts or storms that the forward models do not recover from another simulation."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from compasslib import angles
from compasslib.demo.water import DAY_S, red_noise
from compasslib.effects import Scene
from compasslib.effects.composed import IronMovedByPitch, IronMovedByRoll
from compasslib.effects.forward import ForwardModel, recorded_heading
from compasslib.effects.readout import TemperatureOfTilt
from compasslib.effects.reference import VectorDisturbance
from compasslib.inference import covariates, design, long_record
from tests.world import pairs as world
from tests.world.diagnosed import state_of as any_state_of

HOURS, WEAK_NT = 5000, (5000.0, 55000.0)  # the earth's field near the magnetic pole


state_of = partial(any_state_of, magnetic=False)


def swung(drawn, north_deg):
    """Displace magnetic north in a recording by angles, (n,) degrees east."""
    pairs = drawn.pairs
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, -north_deg)
    heading = angles.wrap360(pairs.heading_deg - north_deg)
    return replace(drawn, pairs=replace(pairs, heading_deg=heading, upper_east=east, upper_north=north))


def disturbed_north(rng, time_s):
    """Simulate the displacement of magnetic north, degrees east, (n,): daily variation and thirty storms."""
    day = 2.0 * np.pi * (time_s / DAY_S - 0.55)
    swing = 0.08 * np.sin(day) + 0.04 * np.sin(2.0 * day)
    activity = 0.05 * np.ones(time_s.size)
    for begin in rng.uniform(time_s[0], time_s[-1], 30):
        since = (time_s - begin) / DAY_S
        activity += np.where(since > 0.0, rng.lognormal(0.0, 0.6) * np.exp(-since / 0.8), 0.0)
    return swing + activity * red_noise(rng, time_s.size, memory=2.0, deviation=1.0)


def storm_index(rng, time_s):
    """Simulate an index like ap, constant over three hours, with thirty storms, (n,)."""
    index = np.repeat(4.0 + rng.gamma(2.0, 2.0, time_s.size // 3 + 1), 3)[: time_s.size]
    for begin in rng.uniform(time_s[0], time_s[-1], 30):
        since = (time_s - begin) / DAY_S
        index += np.where(since > 0.0, 30.0 * rng.lognormal(0.0, 0.8) * np.exp(-since / 0.8), 0.0)
    return index.clip(0.0, 400.0)


@pytest.fixture(scope="module")
def polar():
    return world.planted(replace(world.make(3, wide=True, n=HOURS), earth=WEAK_NT), {})


def test_iron_moving_with_tilt_is_estimated_with_its_size():
    drawn = world.planted(world.make(4, wide=True, n=HOURS), {"moving_iron": 3.0})
    (truth,) = drawn.truth.values()
    kind = IronMovedByRoll if any("roll" in name for name in truth) else IronMovedByPitch
    term = design.refit(state_of(drawn), [kind()]).simulation.terms[0]
    expected = np.array(list(truth.values())) / 5.0  # nT per 5 degrees
    assert np.hypot(*(term.values - expected)) < 0.25 * np.hypot(*expected)


def test_temperature_drift_of_tilts_matches_the_other_simulation():
    sea = world.make(5, wide=True, n=500)
    sea = replace(sea, soft=np.eye(3), hard=np.zeros(3), sensed=sea.tilt)
    warm = 20.0 * (sea.temperature - sea.temperature.mean())
    off = replace(sea, sensed=sea.tilt + np.outer([0.6, -0.4], warm))
    north, down = (np.full(500, nT) for nT in sea.earth)
    scene = Scene(sea.time_s, north, down, *off.sensed, sea.time_s[0], {"temperature": warm})
    term = ForwardModel(np.zeros(5), sea.earth[0], (TemperatureOfTilt(0.6, -0.4),))
    read = recorded_heading(term, scene, sea.heading)
    assert np.ptp(warm) > 4.0 and np.abs(angles.difference(read, world.compass(off))).max() < 1e-6
    assert angles.rms(angles.difference(world.compass(off), world.compass(sea))) > 0.5


def test_both_observatory_components_determine_a_rotated_storm(polar):
    rng = np.random.default_rng(2)
    across, along = (20.0 * disturbed_north(rng, polar.pairs.time_s) for _ in range(2))
    state = state_of(
        swung(polar, 0.5 * across - 0.8 * along), dict(zip(covariates.OBSERVATORY, (across, along), strict=True))
    )
    term = design.refit(state, [VectorDisturbance()]).simulation.terms[0]
    assert term.values == pytest.approx([0.5, -0.8], abs=0.2)


def test_an_index_identifies_storms_and_corrects_nothing(polar):
    rng = np.random.default_rng(3)
    index = storm_index(rng, polar.pairs.time_s)
    size_deg = np.rad2deg(8.0 / WEAK_NT[0])
    stormy = swung(polar, size_deg * index * red_noise(rng, index.size, memory=3.0, deviation=1.0))
    found = long_record.storm_finding(state_of(stormy, {"ap": index}))
    size = found.parameters["nT_ap"]
    assert (found.effect, found.side, found.applied) == ("field_disturbance", "compass", False)
    assert abs(size.value - 8.0) < 3.0 * size.sigma < 12.0 and "Nothing is corrected" in found.text
    assert found.held_out.p_value <= 0.006 and found.where.low > np.median(index)
    assert long_record.storm_finding(state_of(stormy, {"ap": np.roll(index, 24 * 70)})) is None
    assert long_record.storm_finding(state_of(stormy, {"ap": index}, magnetic=True)) is None
    assert long_record.storm_finding(state_of(stormy)) is None
    for tenfold in (1.0, 10.0):
        kp = tenfold * np.array([0.0, 1.0 / 3.0, 4.0, 8.667, 9.0])
        assert covariates.storm_index({"kp": kp}) == pytest.approx([0, 2, 27, 300, 400], abs=0.2)
