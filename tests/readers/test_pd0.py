"""Would catch values unlike mhkit's or a known solution, and damage that costs more than its ensemble."""

import gc
import json
import time
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from compasslib import angles
from compasslib.demo import adcp
from compasslib.errors import InputError
from compasslib.readers import files, pd0
from compasslib.readers.pd0 import currents, frames
from compasslib.readers.pd0.fields import Coordinates
from compasslib.records import PROBABLY_GOOD, Record, take
from compasslib.types import Floats
from tests.world.pd0_encoder import MISSING, START, assemble, ensemble, fixed_leader, variable_leader
from tests.world.sea import mhkit, real

EH2 = "eh2_20060530_20060717_0007m.000"
GOOD_ENSEMBLES = {
    EH2: 3265,
    "03160000.000": 3660,
    "RDI_withBT.000": 1721,
    "winriver02_transect.PD0": 831,
    "adp_12.000": 313,
    "adp_sentinel_v.pd0": 444,
}
BEAM, INSTRUMENT, SHIP, EARTH = Coordinates
PROFILE = [[100, 200, 30, 4], [110, -210, 31, 5], [MISSING] * 4]
EX = {BEAM: 0b00111, INSTRUMENT: 0b01111, SHIP: 0b10111, EARTH: 0b11111}


def series(count: int, *, first: int = 1, skip_h: float = 0.0, **choices: Any) -> list[bytes]:
    """Encode ``count`` hourly ensembles with headings 10 degrees apart."""
    times = [START + timedelta(hours=i + skip_h) for i in range(count)]
    steps = [{"number": first + i, "when": when, "heading": 1000 * (i % 36)} for i, when in enumerate(times)]
    return [ensemble(PROFILE, **(step | choices)) for step in steps]


def written(folder: Path, *parts: bytes, name: str = "a.000") -> Path:
    path = folder / name
    path.write_bytes(b"".join(parts))
    return path


def read(*paths: Path, **choices: Any) -> Record:
    silent: dict[str, Any] = {"orientation": None, "declination_applied": None, "heading_alignment": None}
    return pd0.read(paths, **(silent | choices))


def refused(*paths: Path, **choices: Any) -> str:
    with pytest.raises(InputError) as caught:
        read(*paths, **choices)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def framed(path: Path, window: int = files.CHUNK_BYTES) -> tuple[list[int], list[frames.Skipped]]:
    """Get offsets of intact ensembles and the skipped ranges; assert that together they cover the file in order."""
    runs, skipped = frames.scan(path.read_bytes(), window)
    starts = [run.offset + run.rows.shape[1] * i for run in runs for i in range(len(run.rows))]
    spans = sorted([(run.offset, run.rows.size) for run in runs] + [(each.offset, each.length) for each in skipped])
    ends = np.cumsum([0, *(length for _, length in spans)]).tolist()
    assert [offset for offset, _ in spans] + [path.stat().st_size] == ends and all(length for _, length in spans)
    return starts, skipped


def test_file_in_beam_coordinates_reproduces_known_solutions(tmp_path: Path) -> None:
    for i, case in enumerate(json.loads(real("vectors.json").read_text())["pd0_beam_to_earth"]):
        beams = [round(1000 * b) for b in case["beams"]]
        angles_ = {name: round(100 * case[name]) for name in ("heading", "tilt1", "tilt2")}
        fixed = {"ex": EX[BEAM], "up": case["facing"] == "up"}
        record = read(written(tmp_path, ensemble([beams], fixed=fixed, **angles_), name=f"{i}.000"))
        flow = [record.east[0, 0], record.north[0, 0], record.profiles["up"][0, 0]]
        np.testing.assert_allclose(flow, case["east_north_up"], atol=1e-6)
        np.testing.assert_allclose(record.profiles["error_velocity"][0, 0], case["error"], atol=1e-6)
        assert record.looks_up == (case["facing"] == "up") and record.beam_angle_deg == 20.0


@given(
    beams=st.lists(st.floats(-3, 3), min_size=4, max_size=4),
    lost=st.integers(0, 3),
    angle=st.sampled_from([15.0, 20.0, 25.0, 30.0]),
)
@settings(derandomize=True, max_examples=50, deadline=None)
def test_three_beam_solution_is_exact_for_zero_error_velocity(beams: list[float], lost: int, angle: float) -> None:
    beams[3] = beams[0] + beams[1] - beams[2]
    whole = np.array([beams])
    holed = whole.copy()
    holed[0, lost] = np.nan
    filled, where = currents.fill_missing_beam(holed)
    assert where.tolist() == [True]
    found, known = (currents.beams_to_instrument(each, angle) for each in (filled, whole))
    for a, b in zip(found, known, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)


def test_two_missing_beams_are_not_filled() -> None:
    beams, where = currents.fill_missing_beam(np.array([[np.nan, np.nan, 1.0, 2.0], [1.0, 2.0, np.nan, 4.0]]))
    assert where.tolist() == [False, True] and np.isnan(beams[0, :2]).all()


@pytest.mark.parametrize("up", [True, False])
def test_bin_mapping_removes_tilt_from_linear_shear(up: bool, tmp_path: Path) -> None:
    """A current linear in depth is recovered despite the tilt, except in bins that the beams do not reach."""
    setup = adcp.Setup(300, up, 12, 4.0, 1.76, 6.0, 60, "beam", 1)
    tilts, shear = ((12.0, -7.0), (-5.0, 11.0), (0.0, 0.0)), 0.004 - 0.002j

    def current(water: object, time_s: Floats, depth_m: Floats) -> NDArray[np.complexfloating]:
        return (0.2 - 0.1j) + shear * (depth_m - 100.0)

    for tilt in tilts:
        one = [np.array([x]) for x in (0.0, 100.0, 30.0, 30.0, *tilt, *tilt, 0.0)]
        stance = adcp.Stance(*one[:4], tuple(one[4:6]), tuple(one[6:8]), one[8], np.array([True]))
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(adcp.sea, "velocity", current)
            beams = np.rint(1000.0 * adcp._beams(setup, stance, None)[0]).astype(int).tolist()
        sensed = adcp.inclinometers(*stance.sensed_tilt_deg)
        turned = {name: round(100 * float(x[0])) for name, x in zip(("tilt1", "tilt2"), sensed, strict=True)}
        fixed = {"ex": EX[BEAM], "up": up, "cell_cm": 400, "bin1_cm": 600}
        record = read(written(tmp_path, ensemble(beams, fixed=fixed, heading=3000, **turned)))
        known = np.isfinite(record.east[0])
        wanted = current(None, record.time_s, 100.0 + (-1.0 if up else 1.0) * record.bin_range_m[0])
        assert known[:9].all() and known.sum() >= 9
        np.testing.assert_allclose((record.east + 1j * record.north)[0][known], wanted[known], atol=0.004)


def test_concave_head_reverses_the_horizontal_axes() -> None:
    beams = np.array([0.3, -0.1, 0.2, 0.5])
    convex, concave = (currents.beams_to_instrument(beams, 20.0, head) for head in (True, False))
    np.testing.assert_allclose(concave, np.multiply(convex, [-1, -1, 1, 1]))


def test_true_pitch_from_recorded_tilts() -> None:
    np.testing.assert_allclose(
        currents.true_pitch([10.0, -20.0, 5.0], [0.0, 60.0, 180.0]), [10.0, -10.3141, -5.0], atol=1e-4
    )


@pytest.mark.parametrize(("name", "count"), GOOD_ENSEMBLES.items())
def test_real_files_are_read_completely(name: str, count: int) -> None:
    path = real(f"pd0/{name}")
    starts, skipped = framed(path)
    assert len(starts) == count
    assert framed(path, 10_007) == (starts, skipped)
    record = read(path)
    assert record.counts["ensembles"] == count == len(record.time_s)
    assert record.counts["bytes_skipped"] == sum(each.length for each in skipped)
    assert record.counts["bytes_total"] == path.stat().st_size
    assert record.sound_speed == "" and (record.quality != PROBABLY_GOOD).all()  # EC was computed


def test_eh2_reports_damage_and_orientation() -> None:
    record = read(real(f"pd0/{EH2}"), orientation="down")
    expected = {"damaged": 32, "lost": 20, "bytes_skipped": 30287, "orientation_disagrees": 7, "configurations": 1}
    assert {name: record.counts[name] for name in expected} == expected
    assert not record.looks_up and record.beam_angle_deg == 20.0
    assert record.east.shape == (3265, 27)
    text = " ".join(record.warnings)
    assert "bytes 769872 to 771583 (checksum)" in text and "2276464 to 2276606 (length runs past the end" in text
    assert "looked up" not in text  # seven ensembles recorded on deck are counted without a warning
    assert str(np.datetime64(int(record.time_s[0]), "s")) == "2006-05-30T06:00:00"


def test_sentinel_v_is_read_from_its_four_slanted_beams() -> None:
    ensembles = pd0.decode(real("pd0/adp_sentinel_v.pd0"))
    assert ensembles.velocity.shape == (444, 95, 4) and set(ensembles.beam_angle_deg) == {25.0}
    assert np.isfinite(read(real("pd0/adp_sentinel_v.pd0")).east).all()


def test_heading_bias_of_a_real_file_is_removed() -> None:
    path = real("pd0/adp_12.000")
    record, ensembles = read(path), pd0.decode(path)
    np.testing.assert_allclose(angles.difference(record.heading_deg, ensembles.heading_deg), 18.1)


def by_mhkit(path: Path) -> Any:
    """Read a file with mhkit; None if mhkit fails."""
    try:
        with mhkit() as dolfyn:
            return dolfyn.read(str(path))
    except (KeyError, ValueError, TypeError, IndexError, RecursionError, OverflowError):
        return None
    finally:
        gc.collect()  # mhkit leaves the file open when it fails


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning", "ignore::ResourceWarning")
@pytest.mark.parametrize("name", GOOD_ENSEMBLES)
def test_mhkit_decodes_the_same_values(name: str, tmp_path: Path) -> None:
    path = real(f"pd0/{name}")
    # Compare a subset of intact ensembles only: mhkit rejects a whole file for one flipped byte, as in eh2.
    good = [row.tobytes() for run in frames.find_ensembles(path)[0] for row in run.rows]
    every = max(1, len(good) // 300)
    theirs = by_mhkit(written(tmp_path, *good[::every]))
    if theirs is None:
        pytest.skip(f"mhkit cannot read {name}, not even its good ensembles alone")
    decoded, count = pd0.decode(path), theirs.sizes["time"]
    ours = take(decoded, np.arange(0, len(decoded), every))
    # mhkit drops the last ensemble if the file ends with it.
    assert count in (len(ours), len(ours) - 1)
    np.testing.assert_allclose(theirs.time.values.astype("M8[ns]").astype(float) / 1e9, ours.time_s[:count], atol=1e-3)
    # mhkit stores single precision.
    pairs = {"heading": ours.heading_deg, "pitch": ours.tilt1_deg, "roll": ours.tilt2_deg, "temp": ours.temperature_c}
    for key, value in pairs.items():
        np.testing.assert_allclose(theirs[key].values, value[:count], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(theirs.vel.values.transpose(2, 1, 0), ours.velocity[:count], rtol=1e-6, atol=1e-7)


def test_truncation_at_any_byte_loses_one_ensemble(tmp_path: Path) -> None:
    parts = series(3)
    for cut in range(1, len(parts[2])):
        starts, skipped = framed(written(tmp_path, *parts[:2], parts[2][:cut]))
        assert starts == [0, len(parts[0])]
        reason = frames.PAST_THE_END if cut > 1 else frames.NO_ENSEMBLE
        assert skipped == [frames.Skipped(2 * len(parts[0]), cut, reason, 0)]


def velocity_of(count: int) -> NDArray[np.float64]:
    """Get the profile in m/s, repeated ``count`` times: (count, 3, 4)."""
    rows = np.where(np.array(PROFILE) == MISSING, np.nan, np.array(PROFILE) / 1000.0)
    return np.broadcast_to(rows, (count, 3, 4))


@pytest.mark.parametrize("filler", [b"\x7f", b"\xff", b"\x00", b"\x7f\x7f\x46\x00\x00\x01\x08\x00"])
def test_malicious_filler_is_scanned_in_linear_time(filler: bytes, tmp_path: Path) -> None:
    path = written(tmp_path, filler * (2_000_000 // len(filler)))
    begun = time.process_time()
    starts, skipped = framed(path)
    # Linear cost: 0.2 s for 2 MB in which every byte is a candidate; quadratic cost would take many minutes.
    assert time.process_time() - begun < 8.0
    assert starts == [] and len(skipped) == 1
    assert "expected PD0 ensembles" in refused(path)


def test_alternating_layouts_and_damage_are_read_in_linear_time(tmp_path: Path) -> None:
    parts = ensemble(PROFILE[:1]), ensemble(PROFILE), ensemble(PROFILE)[:-1] + b"\0"
    path, begun = written(tmp_path, b"".join(parts) * 1000), time.process_time()
    record = read(path)
    assert time.process_time() - begun < 8.0
    assert (record.counts["ensembles"], record.counts["damaged"], record.counts["configurations"]) == (2000, 1000, 2)


def test_lost_ensembles_are_counted_only_across_skipped_bytes(tmp_path: Path) -> None:
    numbered = [ensemble(PROFILE, number=number) for number in (5, 6, 9, 20, 1, 2)]
    junk = b"\0" * 9
    # 7 and 8 are lost; 10 to 19 were never recorded, as no bytes were skipped; after 20 the numbering restarts.
    path = written(tmp_path, *numbered[:2], junk, *numbered[2:4], junk, *numbered[4:], junk)
    assert read(path).counts["lost"] == 2


def test_ensemble_without_both_leaders_is_rejected(tmp_path: Path) -> None:
    no_fixed = assemble([variable_leader(), b"\x00\x01" + bytes(60)])
    short = assemble([fixed_leader(cells=1, length=30), variable_leader(), b"\x00\x01" + bytes(8)])
    no_variable = assemble([fixed_leader(cells=1), b"\x00\x01" + bytes(80)])
    starts, skipped = framed(written(tmp_path, no_fixed, short, no_variable, *series(1)))
    assert starts == [len(no_fixed + short + no_variable)]
    assert [each.damaged for each in skipped] == [0]


def test_ensembles_without_velocity_are_counted_and_dropped(tmp_path: Path) -> None:
    bare = assemble([fixed_leader(cells=3), variable_leader()])
    lying = assemble([fixed_leader(cells=200), variable_leader(), b"\x00\x01" + bytes(24)])
    record = read(written(tmp_path, *series(2), bare, lying, bare))
    assert record.counts["ensembles"] == 2 and record.counts["without_velocity"] == 3
    assert "a.000: 3 good ensembles hold no velocities and were left out." in record.warnings
    assert "found 2 ensembles without velocities" in refused(written(tmp_path, bare, bare))


def test_directory_and_missing_file_are_refused(tmp_path: Path) -> None:
    assert "expected a readable file, found Is a directory; check" in refused(tmp_path)
    assert "none.000: expected a readable file, found No such file" in refused(tmp_path / "none.000")


def test_every_field_is_decoded_as_encoded(tmp_path: Path) -> None:
    good = [[10, 0, 5, 80], [5, 3, 2, 10], [0, 0, 0, 0]]
    fixed = {"bin1_cm": 423, "cell_cm": 250, "up": True}
    path = written(tmp_path, ensemble(PROFILE, fixed=fixed, percent_good=good, heading=35999, tilt1=1000, tilt2=6000))
    record, ensembles = read(path), pd0.decode(path)
    np.testing.assert_array_equal(ensembles.velocity, velocity_of(1))
    np.testing.assert_array_equal(ensembles.percent_good, [good])
    np.testing.assert_array_equal(ensembles.correlation, [[[70, 71, 72, 73]] * 3])
    np.testing.assert_array_equal(record.east, np.float32([[0.1, 0.11, np.nan]]))
    np.testing.assert_array_equal(record.north, np.float32([[0.2, -0.21, np.nan]]))
    np.testing.assert_array_equal(record.quality, [[1, 4, 9]])
    np.testing.assert_allclose(record.bin_range_m, [[4.23, 6.73, 9.23]])
    np.testing.assert_allclose(record.pitch_deg, currents.true_pitch(10.0, 60.0))
    assert (record.heading_deg[0], record.roll_deg[0]) == (359.99, 60.0)
    assert (record.pressure_dbar[0], record.depth_m[0], record.temperature_c[0]) == (101.0, 100.0, 4.5)
    assert (record.supply_voltage[0], record.heading_quality[0], record.looks_up) == (150.0, 1, True)
    near = {name: column[0] for name, column in record.channels.items()}
    assert near["transmit_current"] == 90.0 and near["heading_spread"] == 2.0 and np.isnan(near["echo"])  # absent
    assert record.direction_reference == "magnetic" and record.warnings == ()
    assert record.time_s[0] == datetime.fromisoformat("2007-09-04T12:00+00:00").timestamp()
    assert ensembles.frequency_khz[0] == 300.0


def test_short_leaders_of_old_firmware_are_read(tmp_path: Path) -> None:
    old = ensemble(PROFILE, fixed={"length": 42}, length=42, century=19, when=(99, 1, 2, 3, 4, 5, 6))
    record = read(written(tmp_path, old))
    assert np.isnan(record.pressure_dbar[0]) and record.supply_voltage[0] == 150.0
    assert record.beam_angle_deg == 20.0
    assert record.time_s[0] == datetime.fromisoformat("1999-01-02T03:04:05.060+00:00").timestamp()
    shortest = read(written(tmp_path, ensemble(PROFILE, fixed={"length": 34}, length=28)))
    assert np.isnan(shortest.supply_voltage[0]) and shortest.temperature_c[0] == 4.5
    no_sensor = read(written(tmp_path, ensemble(PROFILE, fixed={"sensors": 0b0001_1101})))
    assert np.isnan(no_sensor.pressure_dbar[0])


@pytest.mark.parametrize(
    ("century", "year", "expected"), [(20, 7, 2007), (19, 99, 1999), (0, 7, 2007), (0, 79, 2079), (0, 80, 1980)]
)
def test_century_clock_and_pivot_of_two_digit_years(century: int, year: int, expected: int, tmp_path: Path) -> None:
    record = read(written(tmp_path, ensemble(PROFILE, century=century, when=(year, 2, 28, 23, 59, 59, 99))))
    assert record.time_s[0] == datetime.fromisoformat(f"{expected}-02-28T23:59:59.990+00:00").timestamp()


@pytest.mark.parametrize(
    "clock",
    [
        *((7, 0, 4, 0, 0, 0, 0), (7, 13, 4, 0, 0, 0, 0), (7, 2, 29, 0, 0, 0, 0), (7, 9, 0, 0, 0, 0, 0)),
        *((7, 9, 4, 24, 0, 0, 0), (7, 9, 4, 0, 60, 0, 0), (7, 9, 4, 0, 0, 60, 0), (7, 9, 4, 0, 0, 0, 100)),
        (255, 255, 255, 255, 255, 255, 255),
    ],
)
@pytest.mark.parametrize("century", [0, 20])
def test_impossible_dates_are_counted_and_dropped(clock: tuple[int, ...], century: int, tmp_path: Path) -> None:
    wrong = ensemble(PROFILE, when=clock, century=century)
    record = read(written(tmp_path, *series(2), wrong, *series(1)))
    assert record.counts["bad_dates"] == 1 and record.counts["ensembles"] == 3
    assert "a.000: 1 good ensembles have an impossible date and were left out." in record.warnings


def test_ensemble_numbers_continue_past_65535(tmp_path: Path) -> None:
    path = written(tmp_path, *(ensemble(PROFILE, number=number) for number in (65535, 65536, 200_000)))
    assert pd0.decode(path).number.tolist() == [65535, 65536, 200_000]


def test_impossible_heading_becomes_missing_and_flagged(tmp_path: Path) -> None:
    parts = [ensemble(PROFILE, heading=heading, fixed={"ex": EX[INSTRUMENT]}) for heading in (35999, 36000, 65535)]
    record = read(written(tmp_path, *parts))
    assert np.isnan(record.heading_deg).tolist() == [False, True, True]
    assert record.heading_quality.tolist() == [1, 9, 9]
    assert np.isnan(record.east[1:]).all() and (record.quality[1:] == 9).all()
    assert "2 of 3 ensembles have no valid heading." in record.warnings


def test_percent_good_of_zeros_throughout_a_file_is_ignored(tmp_path: Path) -> None:
    zeros = [[0, 0, 0, 0]] * 3
    empty = written(tmp_path, *series(2, percent_good=zeros), name="empty.000")
    assert read(empty).quality.tolist() == [[1, 1, 9]] * 2
    filled = written(tmp_path, *series(1, percent_good=zeros), *series(1, percent_good=[[0, 0, 0, 90]] * 3))
    assert read(filled).quality.tolist() == [[4, 4, 9], [1, 1, 9]]
    # Each file is assessed separately.
    assert read(empty, filled).quality.tolist() == [[1, 1, 9]] * 2 + [[4, 4, 9], [1, 1, 9]]


def test_counts_absent_from_some_ensembles_are_missing_there(tmp_path: Path) -> None:
    first = ensemble(PROFILE, percent_good=[[0, 1, 2, 97]] * len(PROFILE), number=1)
    later = ensemble(PROFILE[:-1], number=2, when=START + timedelta(hours=1))
    profiles = read(written(tmp_path, first, later)).profiles
    assert profiles["percent_good"][0].tolist() == [[0, 1, 2, 97]] * len(PROFILE)
    assert (profiles["percent_good"][1] == -1).all() and "echo" not in profiles  # no ensemble has an echo block
    assert (profiles["correlation"][1, :-1] == [70, 71, 72, 73]).all() and (profiles["correlation"][1, -1] == -1).all()
    whole = read(written(tmp_path, first, name="whole.000")).profiles
    assert whole["percent_good"].dtype == whole["correlation"].dtype == np.uint8


def test_percent_good_is_the_minimum_of_the_beams_used(tmp_path: Path) -> None:
    beams = [[1, 2, 3, 4], [1, 2, 3, 4], [1, 2, 3, MISSING]]
    good = [[90, 90, 90, 25], [90, 24, 90, 90], [90, 90, 90, 0]]
    record = read(written(tmp_path, ensemble(beams, fixed={"ex": EX[BEAM]}, percent_good=good)))
    assert record.quality.tolist() == [[1, 4, 1]] and record.counts["three_beam"] == 1


def fixed_sound(folder: Path, *, salinity: int = 35, sound: int = 1500, **fixed: Any) -> Path:
    """Write two ensembles in water of 4 and 6 degrees at 101 dbar, with an EC that was set to 1500 m/s."""
    echo = b"\x00\x03" + bytes([40] * 8 + [120] * 4)  # of a boundary in the third bin
    same = {"salinity": salinity, "sound": sound, "fixed": {"ez": 0x3D} | fixed, "extra": [echo]}
    first, second = ({"number": k, "when": START + timedelta(hours=k), "temperature": 200 + 200 * k} for k in (1, 2))
    return written(folder, ensemble(PROFILE, **first, **same), ensemble(PROFILE, **second, **same))


def mackenzie(temperature: Floats, salinity: float, depth: float) -> Floats:
    """Compute the speed of sound in sea water by Mackenzie (1981), nine-term equation, m/s."""
    t, s, d = temperature, salinity - 35.0, depth
    polynomial = 1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * s
    return polynomial + 1.630e-2 * d + 1.675e-7 * d**2 - 1.025e-2 * t * s - 7.139e-13 * t * d**3


@pytest.mark.parametrize(
    ("choice", "told", "salinity"),
    [
        ({"salinity": 35.0}, {}, 35.0),
        ({"salinity": 33.0}, {"ez": 0x7D, "sound": 1470}, 33.0),  # EC computed by the instrument with the default ES
        ("auto", {"salinity": 34}, 34.0),  # set by someone
        (None, {"ez": 0x3F, "sensors": 0x3F}, 35.0),  # measured
    ],
)
def test_known_salinity_corrects_velocities_and_ranges(tmp_path, choice, told, salinity) -> None:
    path = fixed_sound(tmp_path, **told)
    record, kept = read(path, sound_speed=choice), read(path, sound_speed="keep")
    ratio = mackenzie(np.array([4.0, 6.0]), salinity, 100.0) / told.get("sound", 1500)
    for name in ("east", "north"):  # the two equations differ by up to 0.1 m/s
        np.testing.assert_allclose(getattr(record, name), ratio[:, None] * getattr(kept, name), rtol=1e-4)
    np.testing.assert_allclose(record.profiles["up"], ratio[:, None] * kept.profiles["up"], rtol=1e-4)
    np.testing.assert_allclose(record.bin_range_m, ratio.mean() * kept.bin_range_m, rtol=1e-4)
    assert record.quality.tolist() == kept.quality.tolist() == [[1, 1, 9]] * 2
    assert record.counts["sound_speed_corrected"] == 2 and f"salinity {salinity:g} (by" in record.warnings[-1]
    assert record.sound_speed == record.warnings[-1]


@pytest.mark.parametrize(
    ("choice", "told", "flag", "sentence"),
    [
        (None, {"ez": 0x7D, "sound": 1470}, 1, ""),  # that of its own temperatures within 1 %: nothing to correct
        (None, {}, 2, "+1.4 to +5.1 % off for salinities of 40 to 0 (the salinity alone: up to 3 %)"),
        (None, {"salinity": 0}, 2, "sound_speed: {salinity: S} corrects them"),
        (None, {"salinity": 34, "ez": 0x3C}, 2, "cannot be compared with the water"),  # no thermometer
        ({"salinity": 35.0}, {"sound": 0}, 2, "cannot be compared with the water"),
        ({"salinity": 35.0}, {"firmware": 23}, 1, "those of a phased array do not depend on it"),
        ("keep", {}, 1, "kept as recorded (sound_speed: keep)"),
    ],
)
def test_unknown_or_irrelevant_speed_of_sound_keeps_velocities(tmp_path, choice, told, flag, sentence) -> None:
    record = read(fixed_sound(tmp_path, **told), sound_speed=choice)
    np.testing.assert_array_equal(record.east[:, :2], np.float32([[0.1, 0.11]] * 2))
    np.testing.assert_allclose(record.bin_range_m[0], [4.2, 6.2, 8.2])
    assert record.quality.tolist() == [[flag, flag, 9]] * 2 and record.heading_quality.tolist() == [1, 1]
    assert record.counts["sound_speed_doubtful"] == 2 * (flag == 2) and record.counts["sound_speed_corrected"] == 0
    assert sentence in record.sound_speed and bool(record.warnings) == bool(sentence)


@pytest.mark.parametrize(
    ("pings", "between", "half"),
    [(60, (1, 0, 0), 1800), (120, (0, 1, 0), 60), (180, (0, 1, 50), 135), (50, (0, 1, 0), 0), (90, (1, 0, 0), 0)],
    ids=["an hour", "two minutes", "four and a half", "under two minutes", "longer than the ensembles are apart"],
)
def test_timestamps_at_the_start_of_long_averages_are_reported(
    pings: int, between: tuple[int, ...], half: int, tmp_path: Path
) -> None:
    fixed = {"pings": pings, "between_pings": between}
    said = (
        f"Each sample is the mean of {2 * half} s from its time on: its middle is {half} s later; "
        f"clock_offset_seconds: -{half} moves it there."
    )
    assert read(written(tmp_path, *series(30, fixed=fixed))).warnings == (said,) * (half > 0)


def test_two_configurations_in_one_file_are_read(tmp_path: Path) -> None:
    first = series(2)
    second = series(2, fixed={"cell_cm": 400, "bin1_cm": 600, "ex": EX[BEAM]})
    third = ensemble([[1, 2, 3, 4]] * 5, fixed={"cell_cm": 100, "bin1_cm": 300})
    record = read(written(tmp_path, *first, *second, third))
    assert record.east.shape == (5, 5) and record.counts["configurations"] == 3
    ranges = np.array([[4.2, 6.2, 8.2], [6, 10, 14], [3, 4, 5]])
    np.testing.assert_allclose(record.bin_range_m[[0, 2, 4], :3], ranges)
    assert np.isnan(record.bin_range_m[:4, 3:]).all() and np.isnan(record.east[:4, 3:]).all()
    assert (record.quality[:4, 3:] == 9).all() and (record.quality[4] == 1).all()
    assert any("3 configurations" in line for line in record.warnings)


def test_two_instruments_in_one_file_are_refused(tmp_path: Path) -> None:
    down = series(20, skip_h=100, fixed={"up": False, "cell_cm": 400})
    said = refused(written(tmp_path, *series(30, fixed={"up": True}), *down))
    assert "expected ensembles of one instrument, found 30 of 300 kHz with" in said
    assert "cells of 2 m looking up and 20 of 300 kHz" in said


@pytest.mark.parametrize("field", ["serial", "board"])
def test_files_of_two_instruments_are_refused_and_few_ensembles_flagged(field: str, tmp_path: Path) -> None:
    """The two instruments have equal settings but different serial numbers or CPU board numbers."""
    numbers = (8104, 7514) if field == "serial" else (b"a" * 8, b"b" * 8)
    one, other = ({"fixed": {field: number}} for number in numbers)
    first = written(tmp_path, *series(30, **one), name="a.000")
    second = written(tmp_path, *series(20, skip_h=30, **other), name="b.000")
    expected = r"expected ensembles of one instrument, found .* in 30 and .* in 20; name one instrument's files only"
    with pytest.raises(InputError, match=expected):
        read(first, second)
    strange = written(tmp_path, *series(150, **one), *series(1, first=151, skip_h=150, **other))
    assert read(strange).heading_quality.tolist() == [1] * 150 + [4] and read(strange).counts["other_instrument"] == 1


@pytest.mark.parametrize("told", [8104, "08104", "WH8104", "SN 8104", "WHS300-8104", 8104.0, "unknown", None])
def test_matching_or_unknown_serial_number_is_accepted(told: object, tmp_path: Path) -> None:
    path = written(tmp_path, *series(5, fixed={"serial": 8104}))
    record = read(path, serial_number=None if told is None else str(told))
    assert record.serial_number == "8104" and record.warnings == ()


def test_serial_number_contradicting_the_metadata_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, *series(5, fixed={"serial": 7514}))
    assert "expected serial number SN 8104, found 7514" in refused(path, serial_number="SN 8104")


def test_unwritten_short_and_varying_bytes_give_no_serial_number(tmp_path: Path) -> None:
    """After a leader of 53 bytes, the next block occupies the bytes of a longer leader's serial number."""
    fixed = [{"serial": 0}, {"serial": 2**32 - 1}]
    unwritten = [[ensemble(PROFILE, number=i + 1, fixed=each) for i in range(5)] for each in fixed]
    short = [ensemble(PROFILE, number=i + 1, fixed={"serial": 5 + i, "length": 53}) for i in range(200)]
    noise = [ensemble(PROFILE, number=i + 1, fixed={"serial": 5 + i, "board": bytes([i] * 8)}) for i in range(200)]
    for parts in (*unwritten, short, noise):
        record = read(written(tmp_path, *parts), serial_number="8104")
        assert record.serial_number == "" and not record.counts["other_instrument"]


@pytest.mark.parametrize(("name", "number"), [("03160000.000", "3160"), ("adp_sentinel_v.pd0", "125")])
def test_serial_number_of_real_files_is_read(name: str, number: str) -> None:
    assert read(real(f"pd0/{name}")).serial_number == number


def of_five(columns: int, beams: int) -> bytes:
    """Encode an ensemble of three bins whose velocity and correlation blocks have this many columns."""
    blocks = [fixed_leader(cells=3, beams=beams), variable_leader()]
    blocks += [b"\x00\x01" + bytes(6 * columns), b"\x00\x02" + bytes(3 * columns)]
    return assemble(blocks)


@pytest.mark.parametrize(
    ("columns", "beams", "found"),
    [
        (5, 5, "found others, perhaps of five beams, in 9 of 9 ensembles"),
        (5, 4, "found others, perhaps of five beams"),
        (8, 4, "found others, perhaps of five beams"),  # twice as many bins as the leader states
        (4, 5, "expected 4 beams, found 5 in 9 ensembles"),
        (4, 3, "expected 4 beams, found 3 in 9 ensembles"),
    ],
)
def test_files_without_four_beams_are_refused(columns: int, beams: int, found: str, tmp_path: Path) -> None:
    assert found in refused(written(tmp_path, *[of_five(columns, beams)] * 9))


def test_few_ensembles_of_other_layout_are_dropped_and_counted(tmp_path: Path) -> None:
    record = read(written(tmp_path, *series(200), of_five(5, 5)))
    assert len(record.time_s) == 200 and record.counts["not_of_four_beams"] == 1
    assert any("1 good ensembles hold other columns than those of four beams" in line for line in record.warnings)


def test_all_coordinate_systems_give_the_same_velocity(tmp_path: Path) -> None:
    heading, tilt1, tilt2 = 123.0, 5.0, -8.0
    beams = np.array([[327, 494, -465, -241]])
    x, y, z, error = currents.beams_to_instrument(beams / 1000.0, 20.0)
    tilts = np.array([heading]), np.array([tilt1]), np.array([tilt2])
    east, north, up = currents.instrument_to_earth((x, y, z), *tilts, False)
    starboard, forward = angles.turn(east, north, -heading)
    rows: dict[int, NDArray[Any]] = {
        BEAM: beams,
        INSTRUMENT: 1000 * np.stack([x, y, z, error], axis=1),
        SHIP: 1000 * np.stack([starboard, forward, up, error], axis=1),
        EARTH: 1000 * np.stack([east, north, up, error], axis=1),
    }
    where: dict[str, Any] = {"heading": 12300, "tilt1": 500, "tilt2": -800}
    parts = [ensemble(np.rint(rows[c]).astype(int).tolist(), fixed={"ex": EX[c]}, **where) for c in rows]
    level = ensemble(np.rint(rows[INSTRUMENT]).astype(int).tolist(), fixed={"ex": 0b10011}, **where)
    record = read(written(tmp_path, *parts, level))
    # Velocities are recorded in mm/s.
    np.testing.assert_allclose(record.east[:, 0], east[0], atol=1.5e-3)
    np.testing.assert_allclose(record.north[:, 0], north[0], atol=1.5e-3)
    assert record.counts["configurations"] == 4
    assert any("ship coordinates were recorded without tilts" in line for line in record.warnings)


@pytest.mark.parametrize("coordinates", [BEAM, INSTRUMENT, SHIP, EARTH])
def test_heading_bias_is_removed_from_headings_and_earth_velocities(coordinates: int, tmp_path: Path) -> None:
    """EB is added to the heading; velocities in earth coordinates are rotated by it as well."""
    rows = np.array([[300, 400, 10, 0], [-200, 100, 0, 20]])
    plain = read(written(tmp_path, ensemble(rows.tolist(), fixed={"ex": EX[coordinates]}, heading=35000)))
    if coordinates == EARTH:
        turned = angles.turn(rows[:, 0], rows[:, 1], 20.0)
        rows[:, :2] = np.rint(np.stack(turned, axis=1)).astype(int)
    part = ensemble(rows.tolist(), fixed={"ex": EX[coordinates], "eb": 2000}, heading=1000)
    biased = read(written(tmp_path, part))
    np.testing.assert_allclose(biased.heading_deg, plain.heading_deg)
    np.testing.assert_allclose(biased.east, plain.east, atol=1e-3)
    np.testing.assert_allclose(biased.north, plain.north, atol=1e-3)
    assert biased.warnings == ("The file's heading bias EB of 20 degrees was taken out of the headings.",)


DECLINATIONS = [  # declination_applied, coordinates, degrees taken from headings and from velocities, warning
    (-15.0, EARTH, -15.0, -15.0, "declination_applied of -15 degrees was taken out of the directions, although"),
    (20.005, EARTH, 20.005, 20.005, ""),
    (20.0, BEAM, 20.0, 20.0, ""),
    ({"heading": 20.0, "velocity": 0.0}, BEAM, 20.0, 20.0, "{heading: 20, velocity: 0} degrees was taken out"),
    ({"heading": 20.0, "velocity": 0.0}, EARTH, 20.0, 0.0, "{heading: 20, velocity: 0} degrees was taken out"),
]


@pytest.mark.parametrize(("stated", "coordinates", "heading", "velocity", "said"), DECLINATIONS)
def test_declination_applied_replaces_the_heading_bias(
    stated: Any, coordinates: int, heading: float, velocity: float, said: str, tmp_path: Path
) -> None:
    path = written(tmp_path, ensemble(PROFILE, fixed={"ex": EX[coordinates], "eb": 2000}, heading=1000))
    record = read(path, declination_applied=stated)
    np.testing.assert_allclose(record.heading_deg, (10.0 - heading) % 360.0)
    assert (record.heading_bias_deg, record.velocity_bias_deg) == (heading, velocity)
    assert said in " ".join(record.warnings) and bool(record.warnings) == bool(said)
    if coordinates == EARTH:
        flow = [record.east[0, 0], record.north[0, 0]]
        np.testing.assert_allclose(flow, np.ravel(angles.turn(0.1, 0.2, -velocity)), atol=1e-12)
    else:  # rotated by the headings on reading
        np.testing.assert_array_equal(record.east, read(path, declination_applied=20.0).east)
        line = refused(path, declination_applied={"heading": 20.0, "velocity": 5.0})
        assert "velocity: 0, as velocities are not in earth coordinates" in line


def test_heading_alignment_is_refused_without_a_setting(tmp_path: Path) -> None:
    path = written(tmp_path, ensemble(PROFILE, fixed={"ea": 4500, "ex": EX[INSTRUMENT]}, heading=35000))
    assert "expected 0 degrees, found 45 degrees; give heading_alignment" in refused(path)
    ignored, added = read(path, heading_alignment=0.0), read(path, heading_alignment=45.0)
    assert (ignored.heading_deg[0], added.heading_deg[0]) == (350.0, 35.0)
    np.testing.assert_allclose((added.east, added.north), angles.turn(ignored.east, ignored.north, 45.0), atol=1e-7)
    assert "heading alignment EA is 45 degrees" in added.warnings[0]


@pytest.mark.parametrize("written_ea", [(0, 0), (4500, 0), (4500, 3000)])
def test_heading_alignment_contradicting_the_file_is_refused(written_ea: tuple[int, int], tmp_path: Path) -> None:
    path = written(tmp_path, *(ensemble(PROFILE, fixed={"ea": ea}) for ea in written_ea))
    with pytest.raises(InputError, match=r"one that is not 0, as heading_alignment is 45, found .*; delete head"):
        read(path, heading_alignment=45.0)
    assert read(path, heading_alignment=0.0).heading_deg.tolist() == [0.0, 0.0]


def test_orientation_of_the_metadata_takes_precedence(tmp_path: Path) -> None:
    beams = [[327, 494, -465, -241]]
    parts = [ensemble(beams, fixed={"ex": EX[BEAM], "up": i == 1}, heading=3000, tilt1=300) for i in range(3)]
    path = written(tmp_path, *parts)
    down, silent = read(path, orientation="down"), read(path)
    assert not down.looks_up and not silent.looks_up
    assert down.counts["orientation_disagrees"] == silent.counts["orientation_disagrees"] == 1
    assert down.east[0] == down.east[1] and silent.east[0] != silent.east[1]
    up = read(path, orientation="up")
    assert up.looks_up and up.counts["orientation_disagrees"] == 2 and up.east[0] == silent.east[1]
    assert up.warnings == ("2 of 3 ensembles say that they looked down; up counts, as the metadata do.",)


def test_files_are_sorted_by_time(tmp_path: Path) -> None:
    whole = series(5)
    a, b = written(tmp_path, *whole[:2], name="a.000"), written(tmp_path, *whole[2:], name="b.000")
    assert np.diff(read(b, a).time_s).tolist() == [3600.0] * 4
