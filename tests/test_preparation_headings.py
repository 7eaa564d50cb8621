"""Detection of headings that were altered after the instrument had rotated its velocities by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from sea import SHARED
from test_preparation_overlap import HOUR
from test_preparation_overlap import record as steady

from compasslib import angles, compass, readers
from compasslib.preparation import headings
from compasslib.records import PROBABLY_BAD, Record, take
from tests.world.pairs import red_from_rest as red_noise

N = 2000


def moored(seed: int = 1) -> Record:
    """Simulate twelve weeks of an instrument that follows the flow at an offset of 130 degrees, within about 30."""
    rng = np.random.default_rng(seed)
    tide, eddies = np.exp(1j * np.arange(N) / 1.98), (red_noise(rng, N, 60, 0.1) for _ in range(2))
    flow = next(eddies) + 1j * next(eddies) + 0.08 * tide
    heading = angles.wrap360(130.0 + angles.direction(flow.real, flow.imag) + red_noise(rng, N, 30, 30.0))
    ranges = (10.0, 14.0, 18.0)
    column = np.repeat(flow[:, None], len(ranges), axis=1)
    plain = steady(HOUR * np.arange(N), ranges=ranges)
    return replace(plain, heading_deg=heading.round(2), east=column.real, north=column.imag)


def altered(some: slice, change) -> Record:
    record = moored()
    heading = record.heading_deg.copy()
    heading[some] = angles.wrap360(change(heading[some])).round(2)
    return replace(record, heading_deg=heading)


HEADING = moored().heading_deg
MIDDLE, ALL = slice(800, 1200), slice(None)
EVERY_SIXTH = np.arange(N) // 6 * 6
AVERAGED = angles.direction(*(np.convolve(x, np.ones(12) / 12, "same") for x in angles.sin_cos(HEADING)))
WITHOUT_A_BIT = (np.rint(100 * HEADING).astype(int) & ~(1 << 12)) / 100  # the bit of 40.96 degrees


def running_mean(values):
    return np.convolve(values, np.ones(6) / 6, "same")


def across_north(heading_deg):
    """Replace headings within 20 degrees of north by arithmetic means of numbers from both sides of it."""
    share = np.random.default_rng(1).uniform(size=N)
    return np.where(
        np.abs(angles.wrap180(heading_deg)) < 20.0, heading_deg + share * (180.0 - heading_deg), heading_deg
    )


CUT = np.flatnonzero(HEADING <= 40.0)


ALTERED = {  # altered record, words of the warning, flagged part
    "half a turn": (altered(MIDDLE, lambda h: h + 180.0), "not those by which the velocities were turned", MIDDLE),
    "mirrored": (altered(ALL, lambda h: -h), "mirrored (counted anticlockwise)", ALL),
    "copied": (altered(MIDDLE, lambda h: HEADING[100:500]), "repeat others to the last digit", MIDDLE),
    "held": (altered(MIDDLE, lambda h: HEADING[EVERY_SIXTH][MIDDLE]), "stands for several samples", MIDDLE),
    "averaged": (altered(MIDDLE, lambda h: AVERAGED[MIDDLE]), "far smoother than the flow", MIDDLE),
    "late": (altered(MIDDLE, lambda h: HEADING[795:1195]), "lag the direction of flow by 5 samples", MIDDLE),
    "stuck bit": (altered(MIDDLE, lambda h: WITHOUT_A_BIT[MIDDLE]), "a bit of the reading is stuck", MIDDLE),
    "low byte": (altered(ALL, lambda h: h % 2.56), "higher bits of the reading are missing", ALL),
    "folded": (altered(ALL, lambda h: np.minimum(h, 360.0 - h)), "folded on the other", ALL),
    "radians": (altered(ALL, np.deg2rad), "they are radians", ALL),
    "shuffled": (altered(ALL, np.random.default_rng(3).permutation), "in another order", ALL),
    "degrees averaged": (altered(ALL, running_mean), "are running means", ALL),
    "across north": (altered(ALL, across_north), "average them as directions", ALL),
    "every third": (altered(slice(None, None, 3), lambda h: h + 30.0), "one heading in 3 differs", ALL),
    "every second": (altered(slice(None, None, 2), lambda h: h + 30.0), "one heading in 2 differs", ALL),
    "clipped": (replace(moored(), heading_deg=np.maximum(HEADING, 40.0)), "exactly 40 degrees", CUT),
}


@pytest.mark.parametrize("name", ALTERED)
def test_altered_headings_are_flagged_and_described(name):
    record, words, some = ALTERED[name]
    found = headings.flag_altered(record)
    assert any(words in warning for warning in found.warnings)
    assert (found.heading_quality[some] == PROBABLY_BAD).mean() > 0.7
    doubtful = (found.heading_quality == PROBABLY_BAD).mean()
    assert doubtful < 0.55 or some == ALL


@pytest.mark.parametrize("seed", range(6))
def test_unaltered_headings_keep_their_flags_despite_iron(seed):
    record = moored(seed)
    assert headings.flag_altered(record) is record
    turned = 25.0 * np.sin(np.deg2rad(record.heading_deg))  # headings and earth velocities of the same wrong compass
    east, north = angles.turn(record.east, record.north, turned[:, None])
    bent = replace(record, heading_deg=angles.wrap360(record.heading_deg + turned), east=east, north=north)
    assert headings.flag_altered(bent) is bent
    direction = angles.direction(*(running_mean(x) for x in angles.sin_cos(record.heading_deg)))
    velocity = {name: np.apply_along_axis(running_mean, 0, getattr(record, name)) for name in ("east", "north")}
    means = replace(record, heading_deg=direction, **velocity)  # all series averaged, as in some exports
    assert headings.flag_altered(means) is means


def test_fixed_frame_and_natural_delay_keep_their_flags(monkeypatch):
    record, rng = moored(), np.random.default_rng(2)
    still = np.where(np.arange(N) // 240 % 3 == 1, 40.0, 40.0 + rng.integers(-1, 2, N))
    assert headings.flag_altered(replace(record, heading_deg=still)).heading_quality.max() < PROBABLY_BAD
    noisy = replace(record, heading_deg=(40.0 + rng.normal(0.0, 0.3, N)).round(2))
    assert headings.flag_altered(noisy).heading_quality.max() < PROBABLY_BAD
    sparse = take(record, np.arange(0, N, 6))  # too few samples per window
    assert headings.flag_altered(sparse) is sparse
    for hours in (1, 2):  # a mooring may always turn with a delay
        late = replace(record, heading_deg=np.roll(record.heading_deg, hours))
        assert headings.flag_altered(late) is late
    for hours in (-1, 8):
        wrong = replace(record, heading_deg=np.roll(record.heading_deg, hours))
        assert headings.flag_altered(wrong).heading_quality.min() == PROBABLY_BAD
    monkeypatch.setattr(headings, "LEAST_LAG_S", 2.0 * HOUR)
    lead = replace(record, heading_deg=np.roll(record.heading_deg, -1))
    assert headings.flag_altered(lead) is lead


def test_weakly_following_instrument_is_not_called_mirrored():
    """In a real record the correlation with the flow was 0.26 for mirrored headings and 0.11 for recorded ones."""
    record, rng = moored(), np.random.default_rng(2)
    mirrored = angles.wrap360(-angles.direction(record.east[:, 0], record.north[:, 0]))
    heading = np.where(rng.random(N) < 0.28, mirrored, rng.uniform(0.0, 360.0, N)).round(2)
    warnings = headings.flag_altered(replace(record, heading_deg=heading)).warnings
    assert not any("mirrored" in said for said in warnings)


def test_outliers_about_north_may_be_chance(monkeypatch):
    """As in a real record, where 11 of 30 readings about north were outliers, and a quarter of those elsewhere."""
    steps = np.array(
        [
            (30.0 * k - 5.0, 30.0 * k + 180.0 * astray, 30.0 * k + 5.0)
            for k, n, share in [(0, 12, 0.75), *((k, 60, 0.5) for k in range(1, 12))]
            for astray in np.arange(n) < share * n
        ]
    )
    record = moored()
    heading = np.resize(angles.wrap360(steps.ravel()), N)
    record = replace(record, heading_deg=heading, east=0.0 * record.east, north=0.0 * record.north)
    said = [warning for warning in headings.flag_altered(record).warnings if "averaged as numbers" in warning]
    monkeypatch.setattr(headings, "ACROSS_SIGMAS", 0.0)
    without = [warning for warning in headings.flag_altered(record).warnings if "averaged as numbers" in warning]
    assert not said and without


def test_bursts_and_sparse_readings_keep_their_flags():
    record, rng = moored(), np.random.default_rng(3)
    turning = replace(record, heading_deg=angles.wrap360(6.37 * np.arange(N) + rng.normal(0.0, 1.0, N)).round(2))
    bursts = take(turning, np.flatnonzero(np.arange(N) % 12 < 3))
    assert not any("put together" in said for said in headings.flag_altered(bursts).warnings)
    # A freely turning sphere, read every 6 hours.
    apart = replace(record, time_s=6 * HOUR * np.arange(N), heading_deg=rng.uniform(0.0, 360.0, N).round(2))
    assert not any("in another order" in said for said in headings.flag_altered(apart).warnings)


def test_spinning_sphere_near_iron_is_not_called_mirrored():
    """Its headings and the directions rotated by them cluster about one value, counted in either sense."""
    record, rng, spun = moored(), np.random.default_rng(2), 25.37 * np.arange(N)
    recorded = compass.recorded_heading((0.0, -0.45, -0.6, 0.0, 0.0), angles.wrap360(spun))
    towards = 40.0 + rng.normal(0.0, 20.0, N) + recorded - spun
    east, north = (np.repeat(x[:, None], 3, axis=1) for x in angles.components(0.3, towards))
    spinning = replace(record, heading_deg=recorded.round(2), east=east, north=north)
    assert not any("mirrored" in said for said in headings.flag_altered(spinning).warnings)


@pytest.mark.parametrize(
    ("turned_deg", "windows", "far"), [(79.0, 1, 0), (79.0, 2, 4), (120.0, 1, 3)], ids=["one", "two", "one by far"]
)
def test_rotated_windows_are_flagged_by_angle_and_number(turned_deg, windows, far):
    """As one of the 553 windows of the demonstration cruise; neighbours of a far window are flagged with it."""
    number = np.repeat(np.arange(40), 100)
    inside = (number >= 20) & (number < 20 + windows)
    direction = np.where(inside, 0.54, 0.71) * angles.phasor(np.where(inside, turned_deg, 0.0))
    assert headings._far_windows(number, direction, np.ones(number.size)).sum() == far


def test_real_headings_keep_their_flags():
    files = sorted((SHARED / "pd0").glob("eh2_*.000"))
    if not files:
        pytest.skip(f"no {SHARED}/pd0/eh2_*")
    record = readers.read("pd0", files, {})
    assert headings.flag_altered(record).heading_quality.max() < PROBABLY_BAD
