"""The simulated sea: independent, repeatable, its files genuine in form and its statistics those of the array."""

from __future__ import annotations

import ast
import json
import re
import struct
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib.simulation import adcp, compass, demonstration, pd0, water
from compasslib.simulation.demonstration import DEPLOYED_S, MOORINGS, RECOVERED_S

HERE = Path(__file__).parent
VECTORS = HERE.parent.parent / "shared" / "data" / "vectors.json"
NAMES = [spec.name for spec in MOORINGS]
SEED = 2007
WRITTEN = ("EG2", "EG3", "EG4", "EG5", "EG6")


@pytest.fixture(scope="module")
def cruise(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cruise")
    for name in WRITTEN:
        demonstration.write_mooring(name, folder / "raw", folder / "truth" / f"{name}.csv", SEED)
    return folder


@pytest.fixture(scope="module")
def worlds():
    return {spec.name: demonstration.make_world(spec, SEED) for spec in MOORINGS if spec.name in ("EG1", "EG4", "EG6")}


def wrap(angle_deg):
    return (np.asarray(angle_deg) + 180.0) % 360.0 - 180.0


def middle(angle_deg):
    return np.rad2deg(np.angle(np.exp(1j * np.deg2rad(angle_deg)).mean()))


def ensembles(path):
    """Read a PD0 file with six blocks an ensemble, all alike, as rows of bytes and a few decoded columns."""
    octets = np.fromfile(path, dtype=np.uint8)
    size = struct.unpack("<H", octets[2:4].tobytes())[0] + 2
    rows = octets.reshape(-1, size)
    offsets = rows[0, 6:18].view("<u2").astype(int)
    leader = rows[:, offsets[1] :]
    velocity = np.ascontiguousarray(rows[:, offsets[2] + 2 : offsets[3]]).view("<i2").reshape(len(rows), -1, 4)

    def column(at, kind):
        return np.ascontiguousarray(leader[:, at : at + 2]).view(kind)[:, 0]

    return {
        "rows": rows,
        "fixed": rows[:, offsets[0] : offsets[1]],
        "number": column(2, "<u2") + 65536 * leader[:, 11].astype(int),
        "clock": leader[:, 57:65],
        "heading": column(18, "<u2") / 100,
        "pitch": column(20, "<i2") / 100,
        "roll": column(22, "<i2") / 100,
        "velocity": np.where(velocity == -32768, np.nan, velocity / 1000),
    }


def truth(cruise, name):
    columns = np.genfromtxt(cruise / "truth" / f"{name}.csv", delimiter=",", names=True, dtype=None, encoding="ascii")
    seconds = np.array([stamp[:-1] for stamp in columns["time_utc"]], dtype="datetime64[s]").astype(float)
    return seconds, columns


def test_it_shares_no_code_with_the_analysis():
    allowed = {*sys.stdlib_module_names, "numpy", "scipy", "ppigrf", "yaml"}
    for path in sorted((HERE.parent / "compasslib" / "simulation").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path.name}: relative import"
                names = [node.module or ""]
            for name in names:
                ours = name == "compasslib.simulation" or name.startswith("compasslib.simulation.")
                assert ours or name.split(".")[0] in allowed, f"{path.name} imports {name}"


@pytest.mark.parametrize("name", ["EG2", "EG6"])
def test_the_same_seed_gives_the_same_bytes_with_or_without_the_other_moorings(cruise, tmp_path, name):
    demonstration.write_mooring(name, tmp_path / "raw", tmp_path / "truth.csv", SEED)
    for file in demonstration.raw_files(name):
        assert (tmp_path / "raw" / file).read_bytes() == (cruise / "raw" / file).read_bytes(), file
    assert (tmp_path / "truth.csv").read_bytes() == (cruise / "truth" / f"{name}.csv").read_bytes()


def test_another_seed_gives_another_sea(cruise, tmp_path):
    demonstration.write_mooring("EG2", tmp_path / "raw", tmp_path / "truth.csv", SEED + 1)
    assert (tmp_path / "truth.csv").read_bytes() != (cruise / "truth" / "EG2.csv").read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_the_configuration_of_the_cruise_says_the_same_as_the_simulation(name):
    mooring = yaml.safe_load((HERE.parent / "config" / "moorings" / f"{name}.yaml").read_text())
    spec = demonstration.spec_of(name)
    assert (mooring["latitude"], mooring["longitude"]) == pytest.approx(
        (spec.latitude_deg, spec.longitude_deg), abs=1e-6
    )
    assert mooring["water_depth"] == spec.water_depth_m
    deep = mooring["instruments"]["deep"]
    files = [mooring["instruments"]["top"]["files"], deep["files"], deep.get("pressure_files")]
    assert [file for file in files if file] == [f"raw/{file}" for file in demonstration.raw_files(name)]
    assert mooring["start"].timestamp() == DEPLOYED_S
    assert mooring["end"].timestamp() == RECOVERED_S


def test_the_compass_gives_the_known_answers():
    if not VECTORS.exists():
        pytest.skip(f"{VECTORS} is absent")
    for known in json.loads(VECTORS.read_text())["compass_with_tilt"]:
        recorded = compass.recorded_heading(
            (known["H_nT"], known["Z_nT"]),
            [known["heading_magnetic"]],
            tilt_deg=([known["pitch"]], [known["roll"]]),
            iron=compass.Iron(tuple(known["hard_nT"]), tuple(map(tuple, known["soft"]))),
        )
        assert wrap(recorded - known["recorded"]) == pytest.approx(0.0, abs=1e-6)  # the vectors' six decimals


@pytest.mark.parametrize(
    ("name", "strength"),
    [("EG1", 0.35), ("EG2", 0.1), ("EG3", 0.55), ("EG4", 1.3), ("EG5", 0.75), ("EG6", 1.5), ("EG7", 0.45)],
)
def test_the_iron_is_as_strong_as_it_is_meant_to_be(name, strength):
    iron, (horizontal, vertical) = demonstration.spec_of(name).iron, (11_985.0, 52_078.0)
    soft = np.array(iron.soft)
    scale = 1 + (soft[0, 0] + soft[1, 1] - 2) / 2
    across = [(iron.hard_nt[k] + soft[k, 2] * vertical) / (scale * horizontal) for k in (0, 1)]
    assert np.hypot(*across) == pytest.approx(strength, abs=0.05)


@pytest.mark.parametrize("name", ["EG1", "EG4", "EG6"])
def test_the_sphere_tilts_as_the_paper_says(worlds, name):
    tilt = np.hypot(worlds[name].motion.pitch_deg, worlds[name].motion.roll_deg)
    assert 4.0 < np.median(tilt) < 6.0
    assert np.percentile(tilt, 1) > 2.5
    assert tilt.max() < 10.0


def test_the_currents_blow_the_deep_moorings_down(worlds):
    depth = {name: world.motion.sphere_depth_m for name, world in worlds.items()}
    assert 400.0 < depth["EG6"].max() < 600.0
    assert depth["EG4"].max() > 250.0
    assert depth["EG1"].max() < 110.0
    assert all(abs(np.percentile(d, 2) - 100.0) < 2.0 for d in depth.values())


def test_the_flow_is_that_of_the_slope(worlds):
    for world in worlds.values():
        stance = demonstration.top_stance(world)
        flow = adcp.near_bins(world.spec.top.setup, stance, world.currents)[stance.in_water]
        assert 0.1 < abs(flow.mean()) < 0.4
        assert abs(wrap(np.rad2deg(np.arctan2(flow.mean().real, flow.mean().imag)) - 238.0)) < 10.0
        assert np.abs(flow).max() < 2.0


def test_layers_part_with_distance_within_hours_and_over_months(worlds):
    apart = {}
    for metres in (4.0, 14.0, 40.0):
        differences = []
        for world in worlds.values():
            still = replace(world.currents, surface=0 * world.currents.surface, wave=0 * world.currents.wave)
            time = still.time_s
            at = [water.velocity(still, time, np.full(time.size, depth)) for depth in (100.0, 100.0 + metres)]
            differences.append((at[1] - at[0])[::6])
        apart[metres] = differences
    sizes = {metres: np.sqrt(np.mean(np.abs(np.concatenate(x)) ** 2) / 2.0) for metres, x in apart.items()}
    assert sizes[4.0] < 0.6 * sizes[14.0] < 0.6 * sizes[40.0]
    assert sizes[14.0] == pytest.approx(0.037, rel=0.25)
    monthly = [x[: len(x) // 720 * 720].reshape(-1, 720).mean(axis=1) for x in apart[14.0]]
    slow = np.sqrt(np.mean(np.abs(np.concatenate(monthly)) ** 2) / 2.0)
    assert 0.15 * sizes[14.0] < slow < 0.5 * sizes[14.0]
    rms = [np.sqrt(np.mean(np.abs(x[6:] - x[:-6]) ** 2) / np.mean(np.abs(x) ** 2) / 2.0) for x in apart[14.0]]
    assert 0.5 < np.mean(rms) < 1.2  # half a tide later much of it is another


def test_headings_are_locked_to_the_wake_but_go_round(worlds):
    for name, widest in (("EG4", 35.0), ("EG6", 45.0)):
        heading = worlds[name].motion.heading_deg
        assert 12.0 < np.std(wrap(heading - middle(heading))) < widest
    occupied = np.unique(worlds["EG6"].motion.heading_deg % 360 // 10)
    assert occupied.size >= 34


def test_the_strong_iron_keeps_the_recorded_headings_of_eg4_within_110_degrees(worlds):
    stance = demonstration.top_stance(worlds["EG4"])
    recorded = stance.recorded_deg[stance.in_water]
    away = wrap(recorded - middle(recorded))
    assert np.diff(np.percentile(away, [2.5, 97.5])) < 110.0
    assert np.ptp(away) < 120.0
    assert np.ptp(wrap(stance.heading_deg[stance.in_water] - 232.0)) > 150.0


@pytest.mark.parametrize("file", ["EG3/top.000", "EG4/deep.000"])
def test_every_ensemble_has_its_checksum_and_its_number(cruise, file):
    found = ensembles(cruise / "raw" / file)
    rows = found["rows"]
    assert np.array_equal(rows[:, :-2].sum(axis=1) & 0xFFFF, rows[:, -2:].copy().view("<u2")[:, 0])
    assert np.array_equal(np.diff(found["number"]), np.ones(len(rows) - 1))
    assert found["clock"][0].tolist() == [20, 7, 9, 3, 0, {"EG3": 0, "EG4": 2}[file[:3]], 0, 0]
    assert found["fixed"][100, 4] == {"EG3": 0b1100_1010, "EG4": 0b0100_1000}[file[:3]]
    assert found["fixed"][100, 25] == {"EG3": 0b00111, "EG4": 0b11111}[file[:3]]


def test_ensemble_numbers_beyond_sixteen_bits_are_carried():
    spec = demonstration.spec_of("EG7")
    world = demonstration.make_world(spec, SEED)
    stance = demonstration.top_stance(world)
    made = adcp.measure(world.random("top"), spec.top, stance, world.currents, latitude_deg=spec.latitude_deg)
    octets = pd0.encode(spec.top.setup, made)
    number = octets[:, 79].astype(int) + 256 * octets[:, 80].astype(int) + 65536 * octets[:, 88].astype(int)
    assert number[-1] == 60001 + len(octets) - 1 > 65535


def test_mhkit_reads_what_was_written(cruise):
    dolfyn = pytest.importorskip("mhkit.dolfyn")
    path = cruise / "raw" / "EG2" / "top.000"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = dolfyn.read(str(path), nens=200)
    ours = ensembles(path)
    assert np.allclose(read.heading, ours["heading"][:200], atol=0.006)
    assert np.allclose(read.range, adcp.ranges(demonstration.spec_of("EG2").top.setup), atol=0.01)
    theirs = np.moveaxis(read.vel.values, 0, -1)
    theirs = theirs if theirs.shape[0] == 200 else np.swapaxes(theirs, 0, 1)
    assert np.isfinite(theirs[30:, :15]).all()
    assert np.allclose(theirs, ours["velocity"][:200], atol=0.001, equal_nan=True)


def test_a_recording_in_earth_coordinates_is_turned_by_its_own_compass(cruise):
    seconds, true = truth(cruise, "EG2")
    found = ensembles(cruise / "raw" / "EG2" / "top.000")
    wet = slice(24, 24 + len(seconds))
    recorded = found["velocity"][wet, :2, :2].mean(axis=1)
    turn = wrap(true["heading_true_magnetic_deg"] - found["heading"][wet]) - 23.4
    corrected = (recorded[:, 0] + 1j * recorded[:, 1]) * np.exp(-1j * np.deg2rad(turn))
    assert_is_the_current(corrected, true, bias=0.002, scatter=0.02)


def test_a_recording_in_beam_coordinates_knows_nothing_of_the_compass(cruise):
    seconds, true = truth(cruise, "EG3")
    found = ensembles(cruise / "raw" / "EG3" / "top.000")
    wet = slice(24, 24 + len(seconds))
    beams = found["velocity"][wet, :2].mean(axis=1)
    s, c = np.sin(np.deg2rad(20)), np.cos(np.deg2rad(20))
    x, y = (beams[:, 0] - beams[:, 1]) / (2 * s), (beams[:, 3] - beams[:, 2]) / (2 * s)
    z = beams.sum(axis=1) / (4 * c)
    roll = np.deg2rad(found["roll"][wet]) + np.pi
    pitch = np.arctan(np.tan(np.deg2rad(found["pitch"][wet])) * np.cos(roll - np.pi))
    # Across the heading, and along it, in the level frame; then to true north by the correct heading.
    level_x = x * np.cos(roll) + z * np.sin(roll)
    level_y = x * np.sin(pitch) * np.sin(roll) + y * np.cos(pitch) - z * np.sin(pitch) * np.cos(roll)
    turn = np.deg2rad(true["heading_true_magnetic_deg"] - 23.4)
    corrected = (level_x + 1j * level_y) * np.exp(-1j * turn)
    assert_is_the_current(corrected, true, bias=0.002, scatter=0.02)


def assert_is_the_current(found, true, *, bias, scatter):
    wrong = found - (true["east_true_m_s"] + 1j * true["north_true_m_s"])
    assert abs(wrong.mean()) < bias
    assert wrong.std() < scatter


def test_hours_on_deck_have_no_velocity(cruise):
    found = ensembles(cruise / "raw" / "EG2" / "top.000")
    assert np.isnan(found["velocity"][:24]).all()
    assert np.isnan(found["velocity"][-24:]).all()
    assert (np.abs(found["roll"][:24]) > 45).all()


LINES = [
    r"Sample rate: 1\.0000 Hz", r"", r" Profile \d+", r"   MM-DD-YYYY HH:MM:SS     HDNG .* VPGH",
    r"   \d\d-\d\d-20\d\d \d\d:\d\d:\d\d( +-?\d+\.\d+){10}",
    r"   \d\d-\d\d-20\d\d \d\d:\d\d:\d\d( +-?\d+\.?\d*){4,5}",
    r"  ACM turned o(n|ff) at \d\d/\d\d/20\d\d \d\d:\d\d:\d\d", r"ACM\+ Header Contents:", r"[\w]+ *: .*",
]  # fmt: skip
PROFILE, ROW, PARTIAL = 2, 4, 5


def read_text(path):
    """Read the ASCII file line by line: profile, time and ten values of whole rows; the number of partial rows."""
    patterns = [re.compile(line) for line in LINES]
    profile, partial, rows = 0, 0, []
    for line in path.read_bytes().decode("ascii").split("\r\n")[:-1]:
        kind = next((k for k, pattern in enumerate(patterns) if pattern.fullmatch(line)), None)
        assert kind is not None, line
        if kind == PROFILE:
            profile = int(line.split()[1])
        elif kind == ROW:
            date, clock, *values = line.split()
            stamp = f"{date[6:]}-{date[:5]}T{clock}"
            rows.append((profile, stamp, *map(float, values)))
        partial += kind == PARTIAL
    numbers = np.array([row[0] for row in rows])
    seconds = np.array([row[1] for row in rows], dtype="datetime64[s]").astype(float)
    return numbers, seconds, np.array([row[2:] for row in rows]), partial


def read_binary(path):
    octets, begin, parts = path.read_bytes(), 0, []
    kind = np.dtype([("clock", "u1", (3,)), ("date", "u1", (2,)), ("year", "<u2"), ("values", "<f4", (10,))])
    while begin < len(octets):
        (length,) = struct.unpack_from(">I", octets, begin)
        assert octets[begin + 4 + 275 : begin + 4 + 279] == b"DATA"
        records = np.frombuffer(octets, kind, (length - 279) // 47, begin + 4 + 279)
        assert (length - 279) % 47 == 0
        on, off = struct.unpack_from(">II", octets, begin + 4 + length)
        parts.append((on, off, records))
        begin += length + 12
    assert begin == len(octets)
    return parts


def earth_velocity(values):
    heading, ab, ef = values[:, 0], values[:, 6], values[:, 8]
    x, y = (-ab - ef) / np.sqrt(2), (ab - ef) / np.sqrt(2)
    return (x + 1j * y) / 100 * np.exp(1j * np.deg2rad(90 - heading + 23.4))


@pytest.fixture(scope="module")
def unpacked(cruise):
    number, seconds, values, partial = read_text(cruise / "raw" / "EG5" / "acm.txt")
    first = np.append(True, np.diff(number) > 0)
    return {
        "all": number,
        "partial": partial,
        "number": number[~first],
        "time": seconds[~first],
        "values": values[~first],
    }


@pytest.fixture(scope="module")
def engineering(cruise):
    rows = np.genfromtxt(
        cruise / "raw" / "EG5" / "engineering.csv", delimiter=",", names=True, dtype=None, encoding="ascii"
    )
    seconds = np.array([stamp[:-1] for stamp in rows["time_utc"]], dtype="datetime64[s]").astype(float)
    return seconds, rows["pressure_dbar"]


def test_the_unpacked_acm_file_is_read_line_by_line(unpacked):
    assert np.array_equal(np.unique(unpacked["all"]), np.arange(1, 793))
    assert unpacked["partial"] == 792 // 97
    assert (np.diff(unpacked["time"]) > 0).all()


def test_the_acm_obeys_its_loggers_rule(unpacked):
    heading, tx, ty, hx, hy, hz = unpacked["values"][:, :6].T
    tx, ty = np.deg2rad(tx), np.deg2rad(ty)
    x, y = hx * np.cos(tx) - hz * np.sin(tx), hy * np.cos(ty) - hz * np.sin(ty)
    # Four decimals of the cosines and two of the tilts are worth up to 0.03 degrees where the field is this steep.
    assert np.abs(wrap(np.rad2deg(np.arctan2(y, x)) - heading)).max() < 0.04
    assert np.abs(hx**2 + hy**2 + hz**2 - 1).max() < 2e-4


def test_the_acm_measures_the_current_near_its_bumper_unless_the_profiler_is_stuck(cruise, unpacked, engineering):
    times, true = truth(cruise, "EG5")
    depth = np.interp(unpacked["time"], *engineering) / 1.01
    hour = np.searchsorted(times, unpacked["time"] - 1800.0)
    near = np.abs(depth - true["depth_m"][hour]) < 15.0
    lost = 1 - np.unique(unpacked["number"][near]).size / 792
    assert 0.05 < lost < 0.3
    current = (true["east_true_m_s"] + 1j * true["north_true_m_s"])[hour]
    wrong = (earth_velocity(unpacked["values"]) - current)[near]
    assert abs(wrong.mean()) < 0.01
    assert 0.04 < wrong.std() < 0.08  # shear, turbulence, and the minutes between the two


def test_the_acm_shows_its_own_climb_in_the_path_outside_the_wake(unpacked, engineering):
    seconds, dbar = engineering
    sinking = np.interp(unpacked["time"], seconds[:-1], np.diff(dbar) / np.diff(seconds))
    x = -(unpacked["values"][:, 6] + unpacked["values"][:, 8]) / np.sqrt(2)
    up, down = (np.abs(sinking - speed) < 0.02 for speed in (-0.25, 0.25))
    assert np.median((x - np.sqrt(2) * unpacked["values"][:, 9])[up]) == pytest.approx(-25.0, abs=0.5)
    assert np.median((-x + np.sqrt(2) * unpacked["values"][:, 7])[down]) == pytest.approx(25.0, abs=0.5)


def test_the_binary_acm_file_is_a_chain_of_whole_profiles(cruise):
    profiles = read_binary(cruise / "raw" / "EG6" / "acm.dat")
    assert len(profiles) > 780
    for on, off, records in profiles:
        clock = records["clock"].astype(int)
        day = np.datetime64(f"{records['year'][0]}-{records['date'][0, 0]:02}-{records['date'][0, 1]:02}").astype(int)
        begin = day * 86400 + clock[0] @ (3600, 60, 1)
        assert 5 <= begin - on <= 10
        assert off - begin == len(records)
        assert np.isfinite(records["values"]).all()


def test_files_stay_small_enough(cruise):
    for name in WRITTEN:
        size = sum((cruise / "raw" / file).stat().st_size for file in demonstration.raw_files(name))
        assert size < 32e6, name
