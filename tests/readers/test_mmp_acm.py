"""Would catch a wrong current, time or depth of a profiling 3D-ACM, in any variant of its files."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compasslib import angles
from compasslib.demo import demonstration, profiler, water
from compasslib.demo.demonstration import DEPLOYED_S
from compasslib.errors import InputError
from compasslib.readers import mmp as acm
from compasslib.readers.mmp import scans as mmp_scans
from compasslib.records import GOOD, MISSING, PROBABLY_BAD, Record
from tests.world.sea import real

TEXT, BINARY = "acm/mmp_global_A0000001.TXT", "acm/mmp_global_A0000001.DAT"
METER = profiler.Acm(1405, "ML1405-01D", 65.27, -32.88, rate_hz=2.0)
ON_S, PROFILE_S = 1189000000, 43200
HEAD, ROW = 279, 47


def read(*paths: Path, pressure: tuple[Path, ...] = (), offset: float = 0.0) -> Record:
    return acm.read(paths, pressure_files=pressure, start_offset_seconds=offset)


def logged(sizes: tuple[int, ...] = (40, 40, 40), *, first_number: int = 1, rate: int = 2) -> profiler.Scans:
    """Simulate profiles twelve hours apart whose distinct scans are consistent with the logger's heading algorithm."""
    rng = np.random.default_rng(len(sizes))
    profile = np.repeat(np.arange(len(sizes)), sizes)
    place = np.concatenate([np.arange(size) for size in sizes])
    heading, tilts = rng.uniform(0, 360, place.size), rng.uniform(-3, 3, (2, place.size))
    level = 0.25 * np.exp(1j * np.deg2rad(heading))
    cos, sin = np.cos(np.deg2rad(tilts)), np.sin(np.deg2rad(tilts))
    hz = np.full(place.size, -0.97)
    field = ((level.real + hz * sin[0]) / cos[0], (level.imag + hz * sin[1]) / cos[1], hz)
    values = np.column_stack([heading, *tilts, *field, *rng.uniform(-40, 40, (4, place.size))])
    on = ON_S + PROFILE_S * np.arange(len(sizes))
    time = on[profile] + 15 + place // rate
    return profiler.Scans(first_number + np.arange(len(sizes)), np.array(sizes), on, on + 60, time, np.round(values, 4))


def refused(read: Callable[[], object]) -> str:
    with pytest.raises(InputError) as caught:
        read()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def text_file(folder: Path, scans: profiler.Scans, name: str = "acm.txt") -> Path:
    profiler.write_text(folder / name, METER, scans)
    return folder / name


def binary_file(folder: Path, scans: profiler.Scans, name: str = "acm.dat") -> Path:
    profiler.write_binary(folder / name, METER, scans)
    return folder / name


def is_row(line: str) -> bool:
    return line.strip()[:2].isdigit()


def variant(text: str, *, comma: bool, header: bool = True) -> str:
    """Rewrite a file as the unpacker writes it with other settings."""
    lines = text.replace("\r\n", "\n").split("\n")
    if comma:
        lines = [",".join(line.split()).replace(",", " ", 1) if is_row(line) else line for line in lines]
    return "\r\n".join(lines if header else [lines[0], "", "", *(line for line in lines if is_row(line))]) + "\r\n"


def without_clock(text: str) -> str:
    """Reduce each row to the nine numbers that an early instrument logs."""
    return "\n".join(" ".join(line.split()[3:]) if is_row(line) else line for line in text.splitlines()) + "\n"


def stamp(time_s: float) -> str:
    return np.datetime64(int(time_s), "s").item().strftime("%m/%d/%Y %H:%M:%S")


def engineering(number: int, on_s: float, dbar: list[float], *, comma: bool = False, header: bool = True) -> str:
    """Compose an E file with rows every ten seconds from two minutes after switch-on."""
    times = [on_s + 120 + 10 * k for k in range(len(dbar))]
    form = "{},{},{:.1f},{:.3f},0.00,142" if comma else "{}{:7d}{:7.1f}{:10.3f}{:16.2f}{:10d}"
    rows = [form.format(stamp(t), 150, 11.3, p, 351.27, 53) for t, p in zip(times, dbar, strict=True)]
    names = "               Date   [mA]    [V]    [dbar]      Oxygen[uM]"
    names = "Date,[mA],[V],[dbar],Par[mV],scatSig" if comma else names
    began = [f" Vehicle began profiling at {stamp(times[0])}", "", names]
    head = ["", f" Profile {number}", "", f" Sensors were turned on at  {stamp(on_s)}", *began]
    ended = ["", " Ramp exit:    SMOOTH RUNNING", " Profile exit: TOP PRESSURE", ""]
    tail = [f" Vehicle motion stopped at {stamp(times[-1])}", f" Sensor logging stopped at {stamp(times[-1] + 120)}"]
    return "\r\n".join([*head, *rows, *ended, *tail] if header else rows) + "\r\n"


def ctd(number: int, on_s: float, off_s: float, dbar: list[float], *, times: bool = True) -> str:
    rows = [f"  32.9041    4.5847{p:10.3f}      0" for p in dbar]
    tail = [f"  CTD turned on at {stamp(on_s)}", f"  CTD turned off at {stamp(off_s)}"] if times else []
    head = ["", "", f" Profile {number}", "", "  mmho/cm   Celsius     dbars    hz", ""]
    lines = [*head, *rows, "", f" Profile {number}"]
    return "\r\n".join([*lines, *tail]) + "\r\n"


def written(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def pressures(folder: Path, rows: Sequence[tuple[float, float]]) -> Path:
    """Write a table of pressure, from pairs of UTC seconds since 1970 and dbar."""
    lines = [f"{np.datetime64(int(time), 's')},{dbar}" for time, dbar in rows]
    return written(folder, "p.csv", "\n".join(["time,pressure", *lines, ""]))


def rows_of(record: Record) -> set[tuple[float, ...]]:
    """Get rows that identify the scans of ``logged``; times in whole seconds, as a lost scan shifts its neighbours."""
    columns = (np.floor(record.time_s), record.heading_deg, record.pitch_deg, record.roll_deg)
    return set(zip(*(np.round(column, 3).tolist() for column in columns), strict=True))


def accounted(record: Record) -> int:
    return sum(record.counts[key] for key in ("scans", "aliased_dropped", "damaged_rows", "without_time"))


def test_real_ascii_and_binary_files_agree():
    text, binary = read(real(TEXT)), read(real(BINARY))
    for record in (text, binary):
        assert record.counts["aliased_dropped"] == 1 and accounted(record) == 17917
        assert record.counts["scans"] == len(record.time_s) == 17916
        assert set(record.quality.ravel()) == set(record.heading_quality) == {GOOD}
    assert (text.time_s == binary.time_s).all() and np.unique(np.diff(binary.time_s)).tolist() == [0.5]
    # The first second contains one scan only, which is aliased and dropped.
    assert binary.time_s[0] == np.datetime64("2018-06-10T04:00:18").astype("datetime64[s]").astype(int)
    # Headings and tilts have two decimals in the text file, as have path velocities (cm/s).
    assert np.abs(angles.difference(text.heading_deg, binary.heading_deg)).max() < 0.006
    assert np.abs([text.pitch_deg - binary.pitch_deg, text.roll_deg - binary.roll_deg]).max() < 0.006
    # The swing rate comes from rounded headings.
    assert np.hypot(text.east - binary.east, text.north - binary.north).max() < 3e-4


@pytest.mark.parametrize("name", [TEXT, BINARY])
def test_logger_algorithm_reproduces_the_recorded_heading(name):
    values = mmp_scans.read_scans([real(name)]).values[1:]
    heading = acm.logged_heading(values[:, 3:6], values[:, 1], values[:, 2])
    assert angles.rms(angles.difference(heading, values[:, 0])) < 0.05


def same_record(one: Record, other: Record) -> None:
    for name in ("time_s", "east", "north", "heading_deg", "pitch_deg", "roll_deg"):
        assert np.array_equal(getattr(one, name), getattr(other, name)), name
    assert one.counts == other.counts


def test_removing_the_swing_reduces_variance_in_a_real_record():
    scans = mmp_scans.read_scans([real(BINARY)])
    heading, (_, y) = scans.values[1:, 0], acm.instrument_axes(scans.values[1:, 6:] / 100.0)
    rate = acm.swing_rate(heading, np.full(len(y), 2.0), np.ones(len(y) - 1, dtype=bool))
    quieter = acm.remove_swing(y, rate)
    # A moving average over two minutes: longer than a swing, shorter than changes of the current with depth.
    before, after = (np.std(v - np.convolve(v, np.ones(241) / 241, "same")) for v in (y, quieter))
    assert after < 0.93 * before


def test_path_to_earth_transformation_reproduces_known_solutions():
    cases = json.loads(real("vectors.json").read_text())["acm_paths_to_earth"]
    assert len(cases) == 12
    for case in cases:
        paths = np.array(case["paths_cm_s"]) / 100.0
        heading = case["heading_magnetic"] + case["declination"]
        east, north = acm.to_earth(*acm.instrument_axes(paths), heading)
        assert [float(east), float(north)] == pytest.approx(case["east_north_up"][:2], abs=1e-5)


@given(
    heading=st.floats(0, 359.999),
    tilts=st.tuples(st.floats(-20, 20), st.floats(-20, 20)),
    strength=st.floats(0.05, 1.0),
)
@settings(deadline=None, derandomize=True)
def test_logger_algorithm_compensates_tilt(heading, tilts, strength):
    (sx, cx), (sy, cy) = (angles.sin_cos(tilt) for tilt in tilts)
    sine, cosine = angles.sin_cos(heading)
    field = np.array([[(strength * cosine - 0.9 * sx) / cx, (strength * sine - 0.9 * sy) / cy, -0.9]])
    found = acm.logged_heading(field, tilts[0], tilts[1])
    assert abs(angles.difference(found, heading)[0]) < 1e-9


@given(amplitude=st.floats(1, 30), period=st.floats(30, 120), rate=st.sampled_from([0.5, 1.0, 2.0, 4.0]))
@settings(deadline=None, derandomize=True)
def test_swing_in_still_water_is_removed(amplitude, period, rate):
    time = np.arange(0, 300, 1 / rate)
    phase = 2 * np.pi * time / period
    turning = amplitude * 2 * np.pi / period * np.cos(phase)
    y = 0.43 * np.deg2rad(turning)
    joined = np.ones(len(time) - 1, dtype=bool)
    found = acm.swing_rate(amplitude * np.sin(phase) + 355.0, np.full(len(time), rate), joined)
    inner = np.s_[int(2 * rate) : -int(2 * rate)]
    # Averaging over four seconds underestimates the peak swing rate by a sinc factor: 3 % at a period of 30 s.
    assert np.abs(acm.remove_swing(y, found))[inner].max() < 0.031 * np.abs(y).max()


def test_swing_rate_is_zero_across_gaps_and_at_low_rates():
    heading = np.array([0.0, 10.0, 20.0, 200.0, 210.0, 220.0])
    joined = np.array([True, True, False, True, True])
    assert acm.swing_rate(heading, np.ones(6), joined) == pytest.approx(np.full(6, 10.0))
    assert not acm.swing_rate(heading, np.full(6, 0.4), joined).any()
    assert not acm.swing_rate(heading, np.ones(6), np.zeros(5, dtype=bool)).any()
    assert acm.swing_rate(heading[:1], np.ones(1), np.zeros(0, dtype=bool)).tolist() == [0.0]


def test_profiles_in_one_or_many_files_are_read_identically(tmp_path):
    scans = logged((40, 25, 61))
    single = [text_file(tmp_path, one, f"A000000{one.number[0]}.TXT") for one in apart(scans)]
    record = read(text_file(tmp_path, scans))
    same_record(record, read(*single))
    assert (record.counts["profiles"], record.counts["aliased_dropped"], record.counts["scans"]) == (3, 3, 123)
    binary = read(binary_file(tmp_path, scans))
    assert (binary.time_s == record.time_s).all()
    assert np.hypot(binary.east - record.east, binary.north - record.north).max() < 3e-4
    assert record.east.shape == record.quality.shape == record.bin_range_m.shape == (123, 1)
    assert not record.looks_up and not record.bin_range_m.any()
    same_record(record, read(written(tmp_path, "comma.txt", variant((tmp_path / "acm.txt").read_text(), comma=True))))
    late = read(tmp_path / "acm.txt", offset=7.0)
    assert any(w.startswith("start_offset_seconds has no effect") for w in late.warnings)
    assert (record.pitch_deg[0], record.roll_deg[0]) == pytest.approx(tuple(np.round(scans.values[1, 1:3], 2)))


@pytest.mark.parametrize("comma", [False, True])
def test_rows_without_header_are_split_at_clock_gaps(tmp_path, comma):
    path = text_file(tmp_path, logged())
    bare = variant(path.read_text(), comma=comma, header=False)
    assert read(written(tmp_path, "bare.txt", bare)).counts["aliased_dropped"] == 3
    no_rate = bare[bare.index("\r\n") :]
    assert rows_of(read(written(tmp_path, "none.txt", no_rate))) == rows_of(read(path))


def test_exceptions_and_profiles_without_scans_are_tolerated(tmp_path):
    text = text_file(tmp_path, logged()).read_text()
    second = text.index(" Profile 2\n")
    tail = text.rindex(" Profile 1\n", 0, second)
    cut = text[:tail] + " Exception Encountered\n End of file reached\n" + text[text.rindex("Sample rate", 0, second) :]
    none = "Sample rate: 0.0000 Hz\r\n\r\n\r\n Profile 9\r\n\r\n End of file reached\r\n"
    empty = written(tmp_path, "A0000009.TXT", none)
    nothing = written(tmp_path, "A0000010.TXT", "")
    record = read(written(tmp_path, "cut.txt", cut), empty, nothing)
    assert rows_of(record) == rows_of(read(tmp_path / "acm.txt"))
    assert record.counts["damaged_rows"] == 0
    assert any(w.startswith("2 files hold no scan") for w in record.warnings)


def test_decimated_file_keeps_its_swing(tmp_path):
    scans = logged((40,))
    rare = profiler.Scans(scans.number, scans.size, scans.on_s, scans.off_s, ON_S + 25 * np.arange(40), scans.values)
    record = read(text_file(tmp_path, rare))
    assert any("shows 0.04 scans a second where the file says 2" in w for w in record.warnings)
    paths = np.round(scans.values[1:, 6:], 2) / 100.0
    east, north = acm.to_earth(*acm.instrument_axes(paths), record.heading_deg)
    # The difference is rounding to two decimals of cm/s; a swing would change velocities by centimetres per second.
    assert np.hypot(record.east[:, 0] - east, record.north[:, 0] - north).max() < 2e-4


def test_times_of_unclocked_real_scans_are_reconstructed(tmp_path):
    text = real(TEXT).read_text(encoding="latin-1")
    bare = written(tmp_path, "A0000001.TXT", without_clock(variant(text, comma=False, header=False)))
    on_s = np.datetime64("2018-06-10T04:00:02").astype(int)
    e_file = written(tmp_path, "E0000001.TXT", engineering(1, on_s, np.linspace(2558, 171, 880).tolist()))
    record, clocked = read(bare, pressure=(e_file,), offset=15.5), read(real(TEXT))
    assert np.abs(record.time_s - clocked.time_s).max() < 0.01
    # Tolerance: error of the computed heading, which affects velocities most during a swing.
    assert angles.rms(angles.difference(record.heading_deg, clocked.heading_deg)) < 0.05
    assert np.hypot(record.east - clocked.east, record.north - clocked.north).max() < 2e-3
    assert record.counts["headings_by_rule"] == record.counts["scans"] == 17916
    assert any("scans carry no clock" in w for w in record.warnings)


def apart(scans: profiler.Scans) -> list[profiler.Scans]:
    """Split scans into those of each profile."""
    own = np.repeat(np.arange(len(scans.number)), scans.size)
    first = (scans.number, scans.size, scans.on_s, scans.off_s)
    return [
        profiler.Scans(*(column[k : k + 1] for column in first), scans.time_s[own == k], scans.values[own == k])
        for k in range(len(scans.number))
    ]


def bare_profiles(folder: Path, scans: profiler.Scans, *, said: bool) -> list[Path]:
    """Write one file without clock per profile, without the switch-on and switch-off lines unless ``said``."""
    paths = []
    for one in apart(scans):
        text = text_file(folder, one).read_text()
        text = text if said else "".join(line for line in text.splitlines(keepends=True) if "turned" not in line)
        paths.append(written(folder, f"A{one.number[0]:07d}.TXT", without_clock(text)))
    return paths


def test_profile_starts_come_from_own_header_or_matching_e_file(tmp_path):
    scans = logged()
    times = set(np.round(read(text_file(tmp_path, scans)).time_s, 3))
    own = read(*bare_profiles(tmp_path, scans, said=True), offset=15.0)
    assert set(np.round(own.time_s, 3)) == times
    files = bare_profiles(tmp_path, scans, said=False)
    e_files = [
        written(tmp_path, f"E{n:07d}.TXT", engineering(n, on, [100.0 + k for k in range(5)]))
        for n, on in [(0, ON_S - PROFILE_S), *zip(scans.number, scans.on_s, strict=True)]
    ]
    numbered = read(*files, pressure=tuple(reversed(e_files)), offset=15.0)
    assert set(np.round(numbered.time_s, 3)) == times
    fewer = read(*files, pressure=tuple(e_files[:3]), offset=15.0)
    assert fewer.counts["without_time"] == 40
    assert accounted(fewer) == 120
    assert any(w.startswith("40 scans were left out") for w in fewer.warnings)


def test_table_matches_profiles_by_number_or_order(tmp_path):
    scans = logged()
    expected = rows_of(read(*bare_profiles(tmp_path, scans, said=True), offset=15.0))
    files = bare_profiles(tmp_path, scans, said=False)
    rows = [(n, on + 15 + 10 * k, 200 - k) for n, on in zip(scans.number, scans.on_s, strict=True) for k in range(5)]
    iso = [(n, f"{np.datetime64(int(t), 's')}Z", p) for n, t, p in rows]
    numbered = "Profile,Time,Pressure\n" + "".join(f"{n},{t},{p}\n" for n, t, p in iso)
    plain = "time_utc,pressure_dbar\n" + "".join(f"{t},{p}\n" for _, t, p in iso)
    for table in (numbered, plain):
        record = read(*files, pressure=(written(tmp_path, "eng.csv", table),))
        assert rows_of(record) == expected
        assert any("were matched in order" in w for w in record.warnings) == (table == plain)


def test_missing_sample_rate_is_inferred_or_assumed(tmp_path):
    scans = logged((121, 121))

    def files(said: bool) -> list[Path]:
        texts = [path.read_text().split("ACM+")[0] for path in bare_profiles(tmp_path, scans, said=said)]
        without = [text.replace("Sample rate: 2.0000 Hz", "") for text in texts]
        return [written(tmp_path, f"A{k}.TXT", text) for k, text in enumerate(without, 101)]

    assert np.diff(read(*files(said=True)).time_s)[:9] == pytest.approx(60.0 / 121)
    table = pressures(tmp_path, [(on + k, k) for on in scans.on_s for k in range(9)])
    assumed = read(*files(said=False), pressure=(table,))
    assert np.diff(assumed.time_s)[:9] == pytest.approx(0.5)
    assert any("no file states the sample rate of 2 profiles: 2 Hz was assumed" in w for w in assumed.warnings)


def test_scans_without_any_time_information_are_refused(tmp_path):
    files = bare_profiles(tmp_path, logged(), said=False)
    found = "found 0 profile starts for 3 profiles without a common number; give the E files of the same profiles"
    assert refused(lambda: read(*files)).endswith(found)


@pytest.mark.parametrize("comma", [False, True])
@pytest.mark.parametrize("header", [False, True])
def test_engineering_files_are_read_in_four_variants(tmp_path, comma, header):
    dbar = [0.0, 0.0, 500.0, 497.5, 495.0]
    path = written(tmp_path, "E0000007.TXT", engineering(7, ON_S, dbar, comma=comma, header=header))
    found = acm.read_companions([path])
    # Zeros precede the first reading.
    assert found.time_s.tolist() == [ON_S + 140.0, ON_S + 150.0, ON_S + 160.0]
    assert found.pressure_dbar.tolist() == [500.0, 497.5, 495.0]
    start, first_row = found.starts[0], ON_S + 120.0
    assert (start.number, start.on_s) == (7, float(ON_S) if header else first_row)


def test_ctd_file_is_timed_and_yields_to_engineering_file(tmp_path):
    dbar = np.linspace(500, 400, 400).tolist()
    c_file = written(tmp_path, "C0000007.TXT", ctd(7, ON_S, ON_S + 400, dbar))
    alone = acm.read_companions([c_file])
    assert alone.time_s[[0, -1]].tolist() == [ON_S + 0.5, ON_S + 399.5]
    assert [(each.number, each.on_s, each.off_s) for each in alone.starts] == [(7, ON_S, ON_S + 400)]
    e_file = written(tmp_path, "E0000007.TXT", engineering(7, ON_S, [470.0 - k for k in range(17)]))
    both = acm.read_companions([c_file, e_file])
    inside = (both.time_s > ON_S + 60) & (both.time_s < ON_S + 340)
    assert both.pressure_dbar[inside].tolist() == [470.0 - k for k in range(17)]
    assert both.at(np.array([ON_S + 30.0]))[0] == pytest.approx(np.interp(29.5, np.arange(400), dbar))
    assert [start.number for start in both.starts] == [7]


def test_table_columns_are_identified_by_their_header(tmp_path):
    rows = ["2007-09-05 13:46:40,500,x", "", "2007-09-05T13:46:50Z,,x", "2007-09-05T13:47:00.5,495.5,"]
    table = "\n".join(['\ufeff"Date_Time", Pressure ,other', *rows]) + "\n"
    found = acm.read_companions([written(tmp_path, "p.csv", table)])
    assert found.time_s.tolist() == [ON_S + 0.0, ON_S + 20.5]
    assert found.pressure_dbar.tolist() == [500.0, 495.5]


def test_pressure_is_not_interpolated_across_long_gaps(tmp_path):
    found = acm.read_companions([pressures(tmp_path, [(ON_S + t, 100 + t) for t in (0, 10, 20, 400, 410)])])
    at = found.at(ON_S + np.array([-1.0, 0.0, 5.0, 20.0, 21.0, 399.0, 405.0, 410.0, 411.0, np.nan]))
    assert np.isnan(at).tolist() == [True, False, False, False, True, True, False, False, True, True]
    assert at[[1, 2, 3, 6, 7]].tolist() == [100.0, 105.0, 120.0, 505.0, 510.0]


def test_scans_far_from_any_pressure_are_flagged(tmp_path):
    scans = logged((40, 40, 40))
    on = scans.on_s
    table = pressures(tmp_path, [(on[0] + 10, 90), (on[0] + 60, 80), (on[1] + 100, 70)])
    record = read(text_file(tmp_path, scans), pressure=(table,))
    profile = np.repeat([0, 1, 2], 39)
    assert np.isfinite(record.pressure_dbar).tolist() == (profile == 0).tolist()
    assert record.quality[:, 0].tolist() == np.where(profile == 2, PROBABLY_BAD, GOOD).tolist()
    assert record.counts["without_pressure"] == 78
    assert "no pressure within 180 s of 39 scans: flagged, as their depth is unknown" in record.warnings


def test_without_pressure_files_the_depth_is_unknown(tmp_path):
    record = read(text_file(tmp_path, logged()))
    assert np.isnan([record.pressure_dbar, record.depth_m]).all()
    assert set(record.quality.ravel()) == {GOOD}
    assert any(w.startswith("no pressure_files") for w in record.warnings)
    nothing = acm.read([tmp_path / "acm.txt"], pressure_files=None, start_offset_seconds=None)
    same_record(nothing, record)


def test_files_of_scans_and_of_pressure_are_not_confused(tmp_path):
    e_file, a_file = written(tmp_path, "e.txt", engineering(1, ON_S, [1.0, 2.0])), binary_file(tmp_path, logged((9,)))
    assert f"{e_file}: expected unpacked ASCII or binary scans" in refused(lambda: read(e_file))
    for path, found in ((a_file, "found scans"), (written(tmp_path, "p.csv", "when,depth\n"), "found a first line")):
        line = refused(lambda path=path: acm.read_companions([path]))
        assert f"{path}: expected an unpacked engineering (E) or CTD (C) file" in line and found in line


def test_ctd_file_without_times_is_refused(tmp_path):
    path = written(tmp_path, "C0000007.TXT", ctd(7, 0, 0, [1.0, 2.0, 3.0], times=False))
    with pytest.raises(InputError, match=r"unpack with header lines, or give the engineering \(E\) files"):
        acm.read_companions([path])


@pytest.mark.parametrize("filler", [b"\0", b"\xff"])
def test_truncated_scan_with_filler_is_dropped(tmp_path, filler):
    """Cut a record at each byte and fill up the record, five more bytes, or a disk block."""
    path = binary_file(tmp_path, logged((40,)))
    whole, known = path.read_bytes(), rows_of(read(path))
    end = len(whole) - 8 - 20 * ROW
    for cut in range(end - ROW + 1, end):
        for more in (end - cut, end - cut + 5, 4096):
            found = rows_of(read(written(tmp_path, "filled.dat", whole[:cut] + filler * more)))
            assert found < known and len(found) == 18


@pytest.mark.parametrize("keep", ["2.", "2.1", "-", ""])
def test_truncated_last_number_is_not_used(tmp_path, keep):
    text = text_file(tmp_path, logged((30,))).read_text()
    rows = [k for k, line in enumerate(text.split("\n")) if is_row(line)]
    lines = text.split("\n")[: rows[-1] + 1]
    lines[-1] = lines[-1].rsplit(maxsplit=1)[0] + "      " + keep
    record = read(written(tmp_path, "cut.txt", "\n".join(lines)))
    assert (record.counts["scans"], record.counts["damaged_rows"]) == (28, 1)


def test_profile_with_damaged_header_is_recovered(tmp_path):
    whole = binary_file(tmp_path, logged((30, 30, 30)))
    data, truth = whole.read_bytes(), read(whole)
    block = 4 + HEAD + 30 * ROW + 8
    for front in (0, block, 2 * block):
        for at, octets in ((0, b"\xff\xff\xff\xff"), (2, b"\x01"), (4 + HEAD - 4, b"data"), (4 + 20, b"?" * 30)):
            damaged = bytearray(data)
            damaged[front + at : front + at + len(octets)] = octets
            record = read(written(tmp_path, "header", bytes(damaged)))
            assert rows_of(record) == rows_of(truth), (front, at)
            assert record.counts["profiles"] == 3


MALFORMED = [
    ("13:46:57", "18:46:57"),
    ("09-05-2007", "02-30-2007"),
    ("13:46:57", "13:61:57"),
    ("2007 ", "2007_"),
    (".", ";"),
    (".", "0"),
]
MALFORMED += [("-0.9700", new) for new in ("-0.97-0", "--.9700", "-.97.00", "-0.9700,", "    nan")]


@pytest.mark.parametrize(("old", "new"), MALFORMED)
def test_malformed_row_is_dropped(tmp_path, old, new):
    lines = text_file(tmp_path, logged((30,))).read_text().split("\n")
    row = [k for k, line in enumerate(lines) if is_row(line)][4]
    assert old in lines[row]
    lines[row] = lines[row].replace(old, new, 1)
    record = read(written(tmp_path, "bad.txt", "\n".join(lines)))
    assert (record.counts["scans"], record.counts["damaged_rows"]) == (28, 1)
    assert rows_of(record) <= rows_of(read(tmp_path / "acm.txt"))


def test_numbers_with_varying_decimals_are_accepted(tmp_path):
    rng = np.random.default_rng(3)
    rows = [" ".join(f"{x:g}" for x in rng.uniform(-1, 1, 9).round(4)) for _ in range(300)]
    parsed = mmp_scans.parse("\n".join(rows).encode(), lambda form: form == (False, 9), Path("acm.txt"))
    assert parsed.values.shape == (300, 9)
    assert parsed.values.tolist() == [[float(x) for x in row.split()] for row in rows]


def test_dead_compass_gives_no_heading_and_no_current(tmp_path):
    text = without_clock(text_file(tmp_path, logged((9,))).read_text())
    rows = [line.split() for line in text.splitlines()]
    dead = [" ".join([*r[:2], *["0.0000"] * 3, *r[5:]] if len(r) == 9 and "." in r[0] else r) for r in rows]
    record = read(written(tmp_path, "A0000001.TXT", "\n".join(dead)), offset=15.0)
    assert set(record.heading_quality) == {MISSING}
    assert set(record.quality.ravel()) == {MISSING}
    assert np.isnan(record.heading_deg).all()


@pytest.fixture(scope="module")
def mooring(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mooring")
    world = demonstration.make_world(demonstration.MOORINGS["EG5"], 2007)
    span = (DEPLOYED_S, DEPLOYED_S + 50 * 86400.0)
    schedule = profiler.plan(world.random("profiler"), world.spec.deep, world.motion, span)
    scans = profiler.log(world.random("acm"), schedule, world.currents, world.motion, field=world.field)
    meter = profiler.Acm(1405, "ML1405-01D", world.spec.latitude_deg, world.spec.longitude_deg)
    profiler.write_text(folder / "acm.txt", meter, scans)
    profiler.write_binary(folder / "acm.dat", meter, scans)
    profiler.write_engineering(folder / "engineering.csv", schedule, world.motion, world.spec.latitude_deg)
    return folder, world, schedule, scans


@pytest.mark.parametrize("name", ["acm.txt", "acm.dat"])
def test_currents_and_depths_of_a_simulated_mooring_are_recovered(mooring, name):
    folder, world, schedule, scans = mooring
    record = read(folder / name, pressure=(folder / "engineering.csv",))
    assert record.counts["profiles"] == record.counts["aliased_dropped"] == len(schedule.number)
    # The text's 97th profile ends in the middle of a row.
    partial = int(name == "acm.txt" and len(schedule.number) >= profiler.PARTIAL_EVERY)
    assert record.counts["damaged_rows"] == partial
    assert accounted(record) == len(scans.time_s)
    assert record.counts["without_pressure"] == 0
    depth = np.interp(record.time_s, *depths(folder))
    assert np.abs(record.pressure_dbar - depth).max() < 0.02
    truth = water.velocity(world.currents, record.time_s, record.pressure_dbar / 1.009)
    east, north = angles.turn(record.east[:, 0], record.north[:, 0], world.field.at(record.time_s)[0])
    missed = east + 1j * north - truth
    # Errors: compass 0.35 degrees, each path 0.5 cm/s, depth 1 m.
    assert np.sqrt(np.mean(np.abs(missed) ** 2)) < 0.03
    assert abs(missed.mean()) < 0.005


def depths(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    table = np.genfromtxt(folder / "engineering.csv", delimiter=",", skip_header=1, dtype=None, encoding=None)
    time = np.array([row[0].rstrip("Z") for row in table], dtype="datetime64[s]").astype(float)
    return time, np.array([row[1] for row in table])
