"""Would catch impossible values that parse, uncounted or unsaid in record, summary or report."""

import html
from dataclasses import replace

import numpy as np
import pytest

from compasslib import angles, report
from compasslib.archive import netcdf, summary
from compasslib.config import cruise as config
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.quality import flag_quality, flag_unit
from compasslib.readers import pd0
from compasslib.records import BAD, GOOD, PROBABLY_BAD
from compasslib.stages import settings
from tests.world import chain
from tests.world.hourly import HOUR, turning
from tests.world.hourly import record as one_record
from tests.world.sea import SHARED, cruise

LONG = {"start_s": 0.0, "end_s": 60 * HOUR, "water_depth": 500.0, "latitude": 65.0, "nominal_depth": 100.0}
N = 60


def changed(name: str, where, value):
    column = np.array(getattr(turning(), name), dtype=float)
    column[where] = value
    return replace(turning(), **{name: column})


def wake_locked(n: int = 60, seed: int = 4):
    """Simulate a compass that follows the tide within some degrees, and the flow past it."""
    rng, hours = np.random.default_rng(seed), np.arange(n)
    heading = 150.0 + 60.0 * np.sin(hours / 30.0) + rng.normal(0.0, 4.0, n)
    given = one_record(HOUR * hours, heading=heading.round(2))
    flow = (0.2 + 0.15 * np.sin(hours / 7.0))[:, None] + rng.normal(0.0, 0.02, given.east.shape)
    pitch, roll = rng.normal(0.0, 2.0, (2, n))
    return replace(given, east=flow, north=0.1 * flow, pitch_deg=pitch, roll_deg=roll)


def filled_with_zeros():
    rows = [5, 10, 15, 48, 55]  # where the current is above 20 cm/s
    flow = [np.where(np.isin(np.arange(N), rows)[:, None], 0.0, x) for x in (wake_locked().east, wake_locked().north)]
    return replace(wake_locked(), east=flow[0], north=flow[1])


# Faulty versions of a good record of 60 hours at 100 m in 500 m of water, by their count, with the number expected.
FAULTS = {
    "impossible_speed": (changed("east", (7, 1), 30.0), 1),
    "steep_tilt": (changed("pitch_deg", slice(5, 9), 90.0), 12),
    "impossible_depth": (changed("depth_m", slice(None), np.linspace(90.0, 900.0, N)), 66),
    "bins_without_length": (changed("bin_range_m", 3, 10.0), 3),
    "frozen_velocity": (replace(turning(), east=np.full((N, 3), 0.1), north=np.full((N, 3), 0.2)), 180),
    "zero_filled": (filled_with_zeros(), 15),
    "heading_stuck": (changed("heading_deg", slice(20, 40), 33.0 + 0.02 * np.arange(20)), 19),
    "heading_frozen": (changed("heading_deg", slice(None), 33.0), 60),
    "tilt_frozen": (replace(turning(), pitch_deg=np.full(N, 3.0), roll_deg=np.full(N, 1.0)), 60),
    "time_wild": (changed("time_s", 9, 1e9), 1),
    "clock_unsure": (changed("time_s", slice(30, None), HOUR * np.arange(5, 35)), 30),
    "time_backwards": (changed("time_s", [4, 5], [5 * HOUR, 4 * HOUR]), 1),
    "time_repeated": (changed("time_s", 5, 4 * HOUR), 1),
    "outside_deployment": (changed("time_s", slice(20, None), 1e9 + HOUR * np.arange(40)), 40),
    "out_of_water": (changed("depth_m", slice(20), 0.5), 60),
}


def settled(fault: str):
    return apply_deployment(FAULTS[fault][0], **LONG)


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_counted_and_reported(fault):
    record, number = settled(fault), FAULTS[fault][1]
    assert record.counts[fault] == number
    throughout = ("all the time", "never change", "all headings")
    assert any(word in said for said in record.warnings for word in (f"{number} ", *throughout)), record.warnings


def test_every_count_of_the_deployment_has_a_fault():
    # No faults: natural, or set by the user.
    quiet = {"side_lobe", "beyond_boundary", "excluded", "flagged_by_hand"}
    assert set(apply_deployment(turning(), **LONG).counts) == {*FAULTS, *quiet}


def test_constant_velocity_is_bad_and_a_compass_with_minimal_variation_is_stuck():
    assert (settled("frozen_velocity").quality[1:] == BAD).all()
    still = replace(turning(), east=np.zeros((N, 3)), north=np.zeros((N, 3)))
    assert apply_deployment(still, **LONG).counts["frozen_velocity"] == 0
    assert list(np.flatnonzero(settled("heading_stuck").heading_quality == PROBABLY_BAD)) == list(range(21, 40))


@pytest.mark.parametrize(("digits", "expected"), [(3, 100), (2, 0)])
def test_zeros_in_sequence_are_missing_values_where_slower_speeds_are_resolved(digits, expected):
    rng, hours = np.random.default_rng(2), np.arange(2000)
    flow = (0.03 * rng.normal(size=(2, 2000, 1))).round(digits)
    flow[:, 500:600] = 0.0
    given = one_record(HOUR * hours, heading=rng.uniform(0.0, 360.0, 2000))
    east, north = np.broadcast_to(flow, (2, *given.east.shape))
    found = flag_quality(replace(given, east=east, north=north), 500.0)
    assert (found.quality == BAD).all(axis=1).sum() == expected


@pytest.mark.parametrize("amplitude_m_s", [0.08, 0.3, 1.0])
@pytest.mark.parametrize("by_rotor", [True, False])
def test_slack_water_is_not_taken_for_missing_values(amplitude_m_s, by_rotor):
    hours = np.arange(0.0, 8766.0, 0.25)  # a rectilinear tide in whole cm/s, or hourly means of a rotor from 2 cm/s on
    flow = amplitude_m_s * np.sin(2.0 * np.pi * hours / 12.42) * (1.0 + 0.3 * np.sin(hours / 54.0))
    east = np.abs(flow).reshape(-1, 4).mean(axis=1) if by_rotor else flow[::4]
    east = (np.where(east < 0.02, 0.0, east) if by_rotor else east.round(2))[:, None]
    given = one_record(HOUR * np.arange(float(len(east))), heading=np.linspace(0.0, 3000.0, len(east)) % 360.0)
    found = flag_quality(replace(given, east=east + 0.0 * given.east, north=0.0 * given.north), 500.0)
    assert found.counts["zero_filled"] == 0


@pytest.mark.parametrize("name", ["eh2", "03160000", "adp_sentinel", "winriver02"])
def test_genuine_headings_keep_their_flags(name):
    files = [path for path in (SHARED / "pd0").glob("*") if path.name.startswith(name) and path.suffix != ".csv"]
    if not files:
        pytest.skip(f"no {SHARED}/pd0/{name}*")
    read = pd0.read(files, orientation=None, declination_applied=None, heading_alignment=None)
    level = replace(read, pitch_deg=0.0 * read.pitch_deg, roll_deg=0.0 * read.roll_deg)
    found = flag_quality(level, 1e5, affected=True)
    np.testing.assert_array_equal(found.heading_quality, read.heading_quality)


def test_freely_turning_or_coarse_compass_is_not_flagged():
    free = np.random.default_rng(9).uniform(0.0, 360.0, 2000).round(2)
    slack = 13.0 + 10.0 * (np.arange(2000) // 10 % 36)  # repeats itself nine times in ten
    for heading in (free, (wake_locked(2000).heading_deg / 5.0).round() * 5.0, slack):
        found = flag_quality(replace(wake_locked(2000), heading_deg=heading), 500.0)
        assert (found.heading_quality == GOOD).all() and not found.warnings


def test_samples_on_deck_are_flagged_by_their_depth():
    n = 2000
    sound = replace(wake_locked(n), depth_m=100.0 + np.random.default_rng(3).uniform(0.0, 20.0, n))
    deck = np.arange(n) < 300
    found = flag_quality(replace(sound, depth_m=np.where(deck, 0.5, sound.depth_m)), 500.0)
    assert (found.heading_quality[deck] >= PROBABLY_BAD).all() and (found.quality[deck] >= BAD).all()
    assert (found.heading_quality[~deck] == GOOD).all() and "out of the water" in " ".join(found.warnings)
    assert found.counts["out_of_water"] == deck.sum() * found.quality.shape[1]
    profiling = replace(sound, depth_m=60.0 - 55.0 * np.cos(np.arange(n) / 6.0))
    assert flag_quality(profiling, 500.0).counts["out_of_water"] == 0


def test_correct_headings_near_strong_iron_stay_good(tmp_path):
    """Iron of 0.86 of the horizontal field amplifies turns up to sevenfold; 11 % of such headings were once flagged."""
    folder = cruise(tmp_path / "c", coefficients=(0.02, 0.43, 0.74, 0.02, -0.01), n=1200)
    (folder / "config/config.yaml").write_text("diagnose: {enabled: false}\n")
    made = chain.run(folder)
    assert made["error"] is None
    assert (made["product"].heading_corrected_quality == GOOD).mean() > 0.999
    assert (made["product"].velocity_quality <= GOOD).mean() > 0.999


def test_counts_and_warnings_reach_summary_and_report(tmp_path):
    """Each faulty record is added to a small mooring as one of its instruments."""
    folder = cruise(tmp_path / "c", n=40)
    (folder / "config/config.yaml").write_text("{fit: {method: von_appen}, diagnose: {enabled: false}}\n")
    assert chain.run(folder)["error"] is None
    results, records = folder / "results", {fault: settled(fault) for fault in FAULTS}
    for fault, record in records.items():
        netcdf.write_record(results / f"M1/work/{fault}.nc", record)
    row = summary.summary_row("M1", results / "M1")
    summary.write_summary(results / "summary.csv", [row])
    described = settings.report(config.load_cruise(folder))["moorings"]
    made = report.gather(results, attributes={}, moorings=described, calibrations=[])
    report.write(results / "report.html", made)
    page = html.unescape((results / "report.html").read_text())
    for fault, record in records.items():
        assert record.warnings
        for said in record.warnings:
            assert f"{fault}: {said}" in row["warnings"].split(" | ") and f"{fault}: {said}" in page


@pytest.mark.parametrize(
    ("change", "words"),
    [(np.deg2rad, "they are radians"), (lambda h: h / 2.0, "half of the circle was folded")],
    ids=["radians", "halved"],
)
def test_headings_in_other_units_are_doubtful(change, words):
    rng = np.random.default_rng(1)
    heading = angles.wrap360(3.0 * np.arange(1200) + rng.normal(0.0, 4.0, 1200)).round(2)
    sound = replace(one_record(HOUR * np.arange(1200)), heading_deg=heading)
    assert flag_unit(sound) is sound
    found = flag_unit(replace(sound, heading_deg=change(heading).round(2)))
    assert words in found.warnings[-1] and (found.heading_quality == PROBABLY_BAD).all()


@pytest.mark.parametrize("free", [False, True])
def test_a_fill_value_among_headings_is_bad(free):
    given = wake_locked(2000)
    turned = np.random.default_rng(9).uniform(0.0, 360.0, 2000).round(2) if free else given.heading_deg
    filled = np.arange(2000) % 90 == 7
    found = flag_quality(replace(given, heading_deg=np.where(filled, 0.0, turned)), 500.0)
    np.testing.assert_array_equal(found.heading_quality == BAD, filled)
    assert "23 headings flagged: they read 0.00 degrees" in found.warnings[0]
