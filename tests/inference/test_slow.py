"""Would catch slow veer of the water taken for a compass error, or masking one."""

from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal import lfilter

from benchmarks.discrepancy import field_of, fitted
from compasslib import angles
from compasslib.inference.comparison import Options
from compasslib.inference.kinds.mooring import diagnose
from tests.world import pairs as world
from tests.world.diagnosed import every_second

HOURS, MEMORY_H = 6000, 480.0


@cache
def told(size_deg, seed, slip_deg=0.0):
    """Diagnose a simulated mooring whose lower current veers by a first-order process with a memory of twenty days."""
    wanted = {"heading_slip": slip_deg} if slip_deg else {}
    drawn = world.planted(world.make(seed, wide=True, n=HOURS), wanted)
    rng, keep = np.random.default_rng(seed), np.exp(-1.0 / MEMORY_H)
    kicks = size_deg * np.sqrt(1.0 - keep**2) * rng.normal(size=len(drawn.pairs))
    veer, _ = lfilter([1.0], [1.0, -keep], kicks, zi=[keep * size_deg * rng.normal()])
    east, north = angles.turn(drawn.pairs.lower_east, drawn.pairs.lower_north, veer)
    drawn = replace(drawn, pairs=replace(drawn.pairs, lower_east=east, lower_north=north))
    drawn = every_second(drawn)
    return diagnose(drawn.pairs, drawn.covariates, fitted(drawn), field_of(drawn), Options(surrogates=99))


def test_the_size_of_a_slow_veer_is_estimated():
    (calm, _), *slow = (told(size, seed).noise["slow_rms_deg"] for size, seed in ((0.0, 1), (4.0, 1), (4.0, 2)))
    assert calm < min(slow)[0] and all(abs(size - 4.0) < 2.0 * sigma < 4.0 for size, sigma in slow)


def test_slow_veer_widens_the_uncertainty_of_the_constant():
    calm, slow = (told(size, 1) for size in (0.0, 4.0))
    assert np.sqrt(slow.covariance[0, 0]) > 2.0 * np.sqrt(calm.covariance[0, 0])
    assert slow.fit.covariance[0, 0] >= slow.covariance[0, 0] * 0.99


def test_slow_veer_alone_is_no_finding():
    """Of eight seeds, 0 is a false alarm: its evidence ranks first."""
    for found in (told(4.0, 1), told(4.0, 2)):
        assert found.verdict == "consistent" and found.sides["compass"] < 0.5


def test_a_large_slip_is_found_despite_slow_veer():
    found = told(1.5, 5, slip_deg=8.0)
    assert "heading_slip" in {name for one in found.findings for name in (one.effect, *one.alternatives)}
    assert found.findings[0].driver == "time" and found.findings[0].held_out.method == "fifths"
