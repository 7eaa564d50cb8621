"""Would catch a simulated sea without the published statistics, or files unlike an instrument's."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from compasslib.demo import adcp, compass, demonstration, water
from compasslib.demo.demonstration import DEPLOYED_S, MOORINGS, RECOVERED_S
from compasslib.deviation.model import observed_heading
from compasslib.deviation.series import fit_series_about_mean, inverse_table
from compasslib.readers.mmp import scans as mmp_scans
from compasslib.readers.pd0 import currents, decode
from compasslib.readers.pd0.fields import Coordinates
from compasslib.records import Pairs
from tests.world import pairs as sea
from tests.world.sea import mhkit

PROJECT = Path(__file__).resolve().parents[2]
VECTORS = PROJECT.parent / "shared" / "data" / "vectors.json"
NAMES = list(MOORINGS)
SEED = 2007
WRITTEN = ("EG2", "EG3", "EG5", "EG6")


@pytest.fixture(scope="module")
def cruise(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cruise")
    for name in WRITTEN:
        demonstration.write_mooring(name, folder / "raw", folder / "truth" / f"{name}.csv", SEED)
    return folder


@pytest.fixture(scope="module")
def worlds():
    return {name: demonstration.make_world(MOORINGS[name], SEED) for name in ("EG1", "EG4", "EG6")}


def wrap(angle_deg):
    return (np.asarray(angle_deg) + 180.0) % 360.0 - 180.0


def table(path):
    """Read a CSV file: seconds since 1970, and all columns."""
    columns = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="ascii")
    seconds = np.array([stamp[:-1] for stamp in columns["time_utc"]], dtype="datetime64[s]").astype(float)
    return seconds, columns


def truth(cruise, name):
    return table(cruise / "truth" / f"{name}.csv")


def test_same_seed_gives_the_same_files(cruise, tmp_path, name="EG6"):
    demonstration.write_mooring(name, tmp_path / "raw", tmp_path / "truth.csv", SEED)
    for file in (cruise / f"raw/{name}").iterdir():
        assert (tmp_path / f"raw/{name}/{file.name}").read_bytes() == file.read_bytes(), file
    assert (tmp_path / "truth.csv").read_bytes() == (cruise / "truth" / f"{name}.csv").read_bytes()


@pytest.mark.parametrize("name", NAMES)
def test_configuration_matches_the_simulation(cruise, name):
    mooring = yaml.safe_load((PROJECT / "config" / "moorings" / f"{name}.yaml").read_text())
    spec = MOORINGS[name]
    assert (mooring["latitude"], mooring["longitude"]) == pytest.approx(
        (spec.latitude_deg, spec.longitude_deg), abs=1e-6
    )
    assert mooring["water_depth"] == spec.water_depth_m
    deep = mooring["instruments"]["deep"]
    files = [mooring["instruments"]["top"]["files"], deep["files"], deep.get("pressure_files")]
    if name in WRITTEN:
        assert {cruise / file for file in files if file} == set((cruise / f"raw/{name}").iterdir())
    assert mooring["start"].timestamp() == DEPLOYED_S
    assert mooring["end"].timestamp() == RECOVERED_S


def test_compass_reproduces_known_solutions():
    if not VECTORS.exists():
        pytest.skip(f"{VECTORS} is absent")
    for known in json.loads(VECTORS.read_text())["compass_with_tilt"]:
        recorded = compass.recorded_heading(
            (known["H_nT"], known["Z_nT"]),
            [known["heading_magnetic"]],
            tilt_deg=([known["pitch"]], [known["roll"]]),
            iron=compass.Iron(tuple(known["hard_nT"]), tuple(map(tuple, known["soft"]))),
        )
        assert wrap(recorded - known["recorded"]) == pytest.approx(0.0, abs=1e-6)  # the known values have six decimals


@pytest.mark.parametrize("name", ["EG1", "EG4", "EG6"])
def test_sphere_tilts_as_published(worlds, name):
    tilt = np.hypot(worlds[name].motion.pitch_deg, worlds[name].motion.roll_deg)
    assert 4.0 < np.median(tilt) < 6.0
    assert np.percentile(tilt, 1) > 2.5
    assert tilt.max() < 10.0


def test_series_of_eg4_folds_as_published(worlds):
    """Von Appen 2015, Fig. 7: inverted from 29 to 84 degrees, where 55 recorded are some 185 correct ones."""
    world = worlds["EG4"]
    top, deep = demonstration.top_stance(world), demonstration.deep_stance(world, world.spec.deep)
    wet, white = top.in_water, water.white_vector(np.random.default_rng(0), top.in_water.sum(), 0.02)
    upper, lower = (
        water.clockwise(adcp.near_bins(instrument, stance, world.currents)[wet], -top.declination_deg[wet])
        for instrument, stance in ((world.spec.top, top), (world.spec.deep, deep))
    )
    upper, none = water.clockwise(upper + white, (top.recorded_deg - top.heading_deg)[wet]), np.zeros(wet.sum())
    pairs = Pairs(
        top.time_s[wet], top.recorded_deg[wet], none, none, upper.real, upper.imag, lower.real, lower.imag, none, none,
        none, none,
    )  # fmt: skip
    recorded, correct = inverse_table(fit_series_about_mean(pairs), observed_heading(pairs))
    assert (recorded[0] % 360.0, recorded[-1] % 360.0) == pytest.approx((29.0, 84.0), abs=4.0)
    assert np.ptp(recorded) == pytest.approx(55.0, abs=5.0) and 160.0 < np.ptp(correct) < 190.0


def test_deep_moorings_are_blown_down(worlds):
    depth = {name: world.motion.sphere_depth_m for name, world in worlds.items()}
    assert 400.0 < depth["EG6"].max() < 600.0
    assert depth["EG4"].max() > 250.0
    assert depth["EG1"].max() < 110.0
    assert all(abs(np.percentile(d, 2) - 100.0) < 2.0 for d in depth.values())


def test_velocity_differences_grow_with_vertical_distance(worlds):
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
    assert 0.5 < np.mean(rms) < 1.2  # half a tidal cycle later much of it has changed


@pytest.mark.parametrize(
    ("file", "clock", "setup"),
    [
        ("EG3/top.000", "00:00", (True, 300.0, True, Coordinates.BEAM)),
        ("EG3/deep.000", "00:07", (True, 75.0, True, Coordinates.EARTH)),
    ],
)
def test_every_ensemble_is_valid_and_numbered(cruise, file, clock, setup):
    found, size = decode(cruise / "raw" / file), (cruise / "raw" / file).stat().st_size
    assert np.array_equal(found.offset, size // len(found) * np.arange(len(found))) and size % len(found) == 0
    assert np.array_equal(np.diff(found.number), np.ones(len(found) - 1))
    assert found.time_s[0] == np.datetime64(f"2007-09-03T{clock}").astype("datetime64[s]").astype(float)
    said = (found.looks_up, found.frequency_khz, found.convex, found.coordinates)
    assert tuple(column[100] for column in said) == setup


def test_mhkit_reads_the_simulated_files(cruise):
    path = cruise / "raw" / "EG2" / "top.000"
    with mhkit() as dolfyn:
        read = dolfyn.read(str(path), nens=200)
    ours = decode(path)
    assert np.allclose(read.heading, ours.heading_deg[:200], atol=0.006)
    assert np.allclose(read.range, adcp.ranges(MOORINGS["EG2"].top), atol=0.01)
    theirs = np.moveaxis(read.vel.values, 0, -1)
    theirs = theirs if theirs.shape[0] == 200 else np.swapaxes(theirs, 0, 1)
    assert np.isfinite(theirs[30:, :15]).all()
    assert np.allclose(theirs, ours.velocity[:200], atol=0.001, equal_nan=True)


def test_earth_coordinates_contain_the_compass_error(cruise):
    seconds, true = truth(cruise, "EG2")
    found = decode(cruise / "raw" / "EG2" / "top.000")
    wet = slice(24, 24 + len(seconds))
    recorded = found.velocity[wet, :2, :2].mean(axis=1)
    turn = wrap(true["heading_true_magnetic_deg"] - found.heading_deg[wet]) - 23.4
    corrected = (recorded[:, 0] + 1j * recorded[:, 1]) * np.exp(-1j * np.deg2rad(turn))
    assert_is_the_current(corrected, true)


def test_beam_coordinates_are_independent_of_the_compass(cruise):
    seconds, true = truth(cruise, "EG3")
    found = decode(cruise / "raw" / "EG3" / "top.000")
    wet = slice(24, 24 + len(seconds))
    beams = found.velocity[wet, :2].mean(axis=1)
    x, y, z, _ = currents.beams_to_instrument(beams, 20.0)
    heading = true["heading_true_magnetic_deg"] - 23.4
    tilts = found.tilt1_deg[wet], found.tilt2_deg[wet]
    east, north, _ = currents.instrument_to_earth((x, y, z), heading, *tilts, True)
    assert_is_the_current(east + 1j * north, true)


def assert_is_the_current(found, true):
    wrong = found - (true["east_true_m_s"] + 1j * true["north_true_m_s"])
    assert abs(wrong.mean()) < 0.002 and wrong.std() < 0.02


def test_profiler_sticks_and_its_climb_rate_is_measured(cruise):
    """``readers/test_mmp_acm.py`` tests that currents and depths are recovered."""
    seconds, columns = table(cruise / "raw/EG5/engineering.csv")
    dbar = columns["pressure_dbar"]
    scans = mmp_scans.read_scans([cruise / "raw/EG5/acm.txt"])
    assert len(scans.blocks) == 792 and scans.damaged == 792 // 97
    sound = scans.place > 0
    time_s, values = scans.clock_s[sound], scans.values[sound]
    times, true = truth(cruise, "EG5")
    depth = np.interp(time_s, seconds, dbar) / 1.01
    near = np.abs(depth - true["depth_m"][np.searchsorted(times, time_s - 1800.0)]) < 15.0
    assert 0.05 < 1 - np.unique(scans.profile[sound][near]).size / 792 < 0.3
    sinking = np.interp(time_s, seconds[:-1], np.diff(dbar) / np.diff(seconds))
    x = -(values[:, 6] + values[:, 8]) / np.sqrt(2)
    up, down = (np.abs(sinking - speed) < 0.02 for speed in (-0.25, 0.25))
    assert np.median((x - np.sqrt(2) * values[:, 9])[up]) == pytest.approx(-25.0, abs=0.5)
    assert np.median((-x + np.sqrt(2) * values[:, 7])[down]) == pytest.approx(25.0, abs=0.5)
    assert (np.percentile(depth, 0.1), depth.max()) == pytest.approx((102.0, 1158.0), abs=5.0)  # Table 1


def test_missing_samples_do_not_shift_the_reference_flow():
    """With gaps, as in real records, the reference's flow belongs to the time of a sample and not to its index."""
    whole = sea.make(3, wide=True, n=400)
    kept = np.flatnonzero(np.arange(400) % 7 != 3)
    some = {name: x[..., kept] for name, x in vars(whole).items() if np.ndim(x) and np.shape(x)[-1] == 400}
    drawn = sea.planted(replace(whole, **some), {})
    lower = (whole.flow + whole.difference)[kept]
    assert len(drawn.pairs) == len(kept)
    assert np.allclose(drawn.pairs.lower_east + 1j * drawn.pairs.lower_north, lower)


@pytest.mark.parametrize("logged", [True, False])
def test_reference_errs_by_constant_and_iron_of_its_own_heading(logged):
    bare = sea.planted(sea.make(3, wide=True, n=500), {})
    constant, sine, cosine = sea.reference_sizes((11_980.0, 52_078.0))
    # 525 nT of 11,980 are 2.51 degrees, and 0.4 degrees times the dip's tangent of 4.35 are 1.74.
    assert (constant, sine, cosine) == pytest.approx((2.0, 3.05, 3.05), abs=0.01)
    made = sea.refer(bare, np.array([5.0, 3.0, 0.0]), np.random.default_rng(1), vane=not logged, logged=logged)
    before, after = (sea.towards(x.pairs.lower_east + 1j * x.pairs.lower_north) for x in (bare, made))
    wrong = sea.wrap(after - before)
    np.testing.assert_allclose(wrong, made.reference_deg, atol=1e-9)
    own = made.pairs.lower_heading_deg
    assert (own is not None) == logged
    heading = own - wrong if logged else sea.towards(bare.world.water)
    # A vane lies along the flow within 10 degrees, of whose sine the tenth part of 3 degrees is 0.5.
    assert np.std(wrong - 5.0 - 3.0 * np.sin(np.deg2rad(heading))) < (1e-9 if logged else 0.6)
