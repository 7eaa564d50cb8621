"""Would catch a wrong velocity on a fixed depth, a filled gap, an uncertainty of sums that is too small."""

import shutil
from dataclasses import replace

import netCDF4
import numpy as np
import pytest
from PIL import Image

from compasslib.archive import gridded, netcdf, sites
from compasslib.archive.attributes import Site
from compasslib.errors import InputError
from compasslib.plots import moorings, timeseries
from compasslib.product.cells import Differences, Source, Velocities, average_slots
from compasslib.product.errors import (
    AffectedHeadings,
    HeadingErrors,
    compress,
    heading_errors,
    learn_bin_noise,
    marginals,
    sum_sigma,
)
from compasslib.product.grid import GODIN_H, DailyMeans, GridRules, describe_parking, grid, make_axes, survey
from compasslib.records import BAD, GOOD, EarthField, ReferenceCompass
from tests.world import conventions

HOUR_S, N, AUTO = 3600.0, 24 * 12, GridRules()
TIMES = 1.2e9 + HOUR_S * np.arange(N)
SHEAR = 0.001  # 1/s; constant, as linear interpolation in depth is then exact


def sea(time_s, depth_m):
    """Compute a current that is linear in depth."""
    return 0.2 * np.exp(1j * time_s / 2e5) + (0.3 + SHEAR * depth_m)


def source(name, depth_m, *, bins=10, cell_m=8.0, up=True, time_s=TIMES, lost=(), beam=20.0, noise=0.0):
    """Simulate an instrument in that current; ``lost``: indices of its missing velocities."""
    depth = depth_m[:, None] + (-1.0 if up else 1.0) * (cell_m * np.arange(1, bins + 1) if bins > 1 else np.zeros(1))
    velocity = sea(time_s[:, None], depth)
    velocity = velocity + noise * np.random.default_rng(1).normal(size=(*velocity.shape, 2)) @ [1.0, 1j]
    quality = np.full(depth.shape, GOOD, dtype=np.int8)
    for place in lost:
        velocity[place], quality[place] = np.nan, BAD
    return Source(name, time_s, depth_m, np.full(len(time_s), 3.0), bins, beam, lambda rows: Velocities(
        velocity[rows], depth[rows], quality[rows]
    ))  # fmt: skip


def gridded_of(*sources, rules=AUTO, errors=None):
    """Grid instruments; get the product and its only piece."""
    surveys = [survey(each) for each in sources]
    axes = make_axes(sources, surveys, rules)
    count = len(axes.time_s)
    errors = errors or HeadingErrors(("one",), np.full((1, count), 0.05), np.full((1, count), 0.02), 7200.0,
                                     np.ones((len(sources), 1)))  # fmt: skip
    product = grid(sources, surveys, axes, rules, errors, np.zeros((1, count)), water_depth_m=800.0)
    (piece,) = product
    return product, piece


DIVING = 100.0 + 24.0 * np.sqrt(2.0) * np.sin(np.arange(N) / 9.0)


def test_diving_sphere_is_interpolated_to_fixed_depths():
    product, piece = gridded_of(source("top", DIVING))
    axes, there = product.axes, piece.source >= 0
    truth = sea(axes.time_s[:, None], axes.depth_m)
    first, last = DIVING[:, None] - 80.0, DIVING[:, None] - 8.0
    inside, off = (axes.depth_m >= first) & (axes.depth_m <= last), np.abs(piece.cells.velocity - truth)
    assert np.nanmax(off[inside]) < 1e-6  # linear between bins
    assert there[inside].all() and not there[(axes.depth_m < first - 4.001) | (axes.depth_m > last + 4.001)].any()
    assert np.nanmax(off[there & ~inside]) <= 4.001 * SHEAR  # within the outermost bin its value is used
    assert set(np.unique(piece.quality)) == {GOOD, 9} and axes.step_m == 8.0
    assert np.isnan(piece.cells.velocity.imag[~there]).all()


def test_short_gaps_are_interpolated_and_flagged():
    still = np.full(N, 100.0)
    lost = [(slice(10, 12), slice(None)), (slice(30, 34), slice(None)), (50, 3), (60, slice(3, 6))]
    product, piece = gridded_of(source("top", still, lost=lost))
    level = {bin_: int(np.flatnonzero(product.axes.depth_m == 100.0 - 8.0 * (bin_ + 1))[0]) for bin_ in range(10)}
    assert (piece.quality[10:12] == 8).all() and (piece.cells.count[10:12] == 2).all()
    assert (piece.quality[30:34] == 9).all() and (piece.source[30:34] == -1).all()  # a gap of five hours
    assert piece.quality[50, level[3]] == 8 and piece.quality[60, level[4]] == 8
    assert piece.cells.noise[60, level[4]] > 0.0  # bridged in time, as three bins are too wide a gap in depth
    assert np.sum(piece.quality == 8) == 2 * 10 + 1 + 3
    _, tight = gridded_of(source("top", still, lost=lost), rules=GridRules(max_gap_m=0.0, max_gap_minutes=0.0))
    assert not (tight.quality == 8).any() and (tight.source[50, level[3]] == -1)
    _, profiles = gridded_of(source("top", still, lost=lost, beam=0.0))  # a profiler: its profiles have separate times
    assert (profiles.quality[10:12] == 9).all() and profiles.quality[50, level[3]] == 8


def test_fine_grids_are_made_in_shorter_pieces_and_finer_ones_refused(monkeypatch):
    """As the memory of a piece is bounded; its length changes nothing."""
    product, piece = gridded_of(source("top", DIVING, lost=[(slice(10, 12), slice(None))]))
    monkeypatch.setattr("compasslib.product.grid.CELLS", 7 * len(product.axes.depth_m))
    short = [*product]
    assert len(short) == -(-N // 7)
    for name in ("quality", "source", "east_variance"):
        assert np.array_equal(np.concatenate([getattr(x, name) for x in short]), getattr(piece, name), equal_nan=True)
    with pytest.raises(InputError, match="grid: expected up to 6000 depths, found 100001 from 0 to 100 m; "):
        gridded_of(source("top", DIVING), rules=GridRules(step_m=1e-3, from_m=0.0, to_m=100.0))


def test_instrument_without_samples_gives_an_empty_grid():
    absent = source("top", np.zeros(0), time_s=np.zeros(0))
    axes = make_axes([absent], [survey(absent)], AUTO)
    assert not len(axes.time_s) and average_slots(np.zeros((0, 2)), absent.time_s, axes, 10800.0).shape == (0, 2)


def test_profiler_keeps_its_times_and_reference_takes_precedence():
    seconds = 1.2e9 + 43200.0 + 6.0 * np.arange(60)  # six minutes of climbing at 25 cm/s
    profiler = source("mmp", 300.0 - 0.25 * (seconds - seconds[0]), bins=1, up=False, time_s=seconds)
    assert profiler.profiles and not source("top", DIVING, bins=1).profiles
    product, piece = gridded_of(source("top", np.full(N, 100.0), up=False), profiler)
    rows = np.flatnonzero((piece.source == 1).any(axis=1))
    assert rows.tolist() == [12]  # the only hour with a profile in twelve days
    reached = profiler.depth_m.min(), profiler.depth_m.max()
    taken = product.axes.depth_m[piece.source[12] == 1]
    assert taken.min() >= reached[0] - 4.0 and taken.max() <= reached[1] + 4.0 and len(taken) > 10
    lowest = product.axes.depth_m <= 180.0  # where the affected instrument measured too
    assert not (piece.source[12, lowest & (product.axes.depth_m < reached[0] - 4.0)] == 1).any()
    point = source("point", np.full(N, 140.0), bins=1)
    both, overlapping = gridded_of(source("top", np.full(N, 100.0), up=False), point)
    level = int(np.argmin(np.abs(both.axes.depth_m - 140.0)))
    assert (overlapping.source[:, level] == 1).all() and (overlapping.source[:, level - 1] == 0).all()


def test_depths_that_few_profiles_or_strong_currents_reach_are_left_out():
    seconds = 1.2e9 + 6.0 * np.arange(24 * 3600 // 6 * 12)  # twelve days, hourly profiles
    turning = 200.0 + 100.0 * np.abs((seconds / 3600.0) % 2.0 - 1.0)
    deep = np.where(seconds < seconds[0] + 2 * 3600.0, turning + 400.0, turning)  # two of 288 go deeper
    parked = np.where(seconds > seconds[-1] - 24 * 3600.0, 250.0, deep)
    mmp = source("mmp", parked, bins=1, up=False, time_s=seconds)
    assert mmp.profiles
    axes = make_axes([mmp], [survey(mmp)], GridRules(step_m=10.0, from_m=None))
    assert (axes.depth_m[0], axes.depth_m[-1]) == (200.0, 300.0)
    assert describe_parking(mmp) == "mmp was parked 1 times, 24 hours in all, near 250 m"
    dives = np.where(np.arange(N) % 20 == 0, 160.0, 100.0)  # one time in twenty
    product, _ = gridded_of(source("top", dives))
    assert (product.axes.depth_m[0], product.axes.depth_m[-1]) == (16.0, 96.0)  # not 152


def test_samples_are_averaged_on_the_configured_levels():
    minutes = 1.2e9 + 600.0 * np.arange(6 * N)
    product, piece = gridded_of(
        source("top", np.full(6 * N, 100.0), time_s=minutes), rules=GridRules(minutes=60.0, from_m=40.0, to_m=80.0)
    )
    assert product.axes.depth_m.tolist() == [40.0, 48.0, 56.0, 64.0, 72.0, 80.0]
    assert (product.axes.time_s % 3600.0 == 1800.0).all() and product.axes.step_s == 3600.0
    whole = np.isclose(piece.cells.count, 12)  # six samples of two bins each
    assert whole[2:-2].all()
    lag = np.abs(piece.cells.velocity - sea(product.axes.time_s[:, None], product.axes.depth_m))[2:-2]
    assert lag.max() < 0.2 * 600.0 / 2e5  # the mean time of six samples is within half a step of the middle of the hour


@pytest.mark.parametrize("memory_s", [0.0, 20 * HOUR_S])
def test_variance_of_sums_matches_simulated_heading_errors(memory_s):
    rng = np.random.default_rng(3)
    t, z, draws = 200, 4, 4000
    flow = 0.3 * np.exp(1j * rng.normal(0.5, 0.3, (t, z)))
    modes = 0.04 * np.array([np.ones(t), np.sin(np.arange(t) / 20.0)])
    shares = np.array([[1.0, 1.0], [1.0, 0.0]])
    source_of = np.repeat([[0, 0, 1, -1]], t, axis=0)
    errors = HeadingErrors(("a", "b"), modes, np.full((1, t), 0.05), memory_s, shares)
    east, north = rng.uniform(0.0, 1.0, (2, t, z)) / t
    step = np.exp(-HOUR_S / memory_s) if memory_s else 0.0
    noise = rng.normal(size=(draws, t))
    for k in range(1, t):
        noise[:, k] = step * noise[:, k - 1] + np.sqrt(1.0 - step**2) * noise[:, k]
    common = rng.normal(size=(draws, 2)) @ (modes[:, None, :] * 1.0).reshape(2, t)
    only = rng.normal(size=(draws, 2))
    both = only[:, :1] * modes[0]
    first = both + only[:, 1:] * modes[1] + 0.05 * noise
    delta = np.stack([first, first, both, np.zeros_like(first)], axis=2)
    assert common.shape == first.shape
    sums = np.einsum("dtz,tz->d", delta, east * flow.imag - north * flow.real)
    sigma = sum_sigma(east, north, flow, np.zeros((t, z)), source_of, errors, HOUR_S)
    assert sigma == pytest.approx(sums.std(), rel=0.05)  # 4000 draws: 1.1 % standard error


@pytest.mark.parametrize("sigma", [0.05, 0.6, 3.0])
def test_marginals_match_randomly_rotated_velocities(sigma):
    delta = np.random.default_rng(5).normal(0.0, sigma, 200_000)
    flow = np.array([[0.3 - 0.1j]])
    off = flow * np.exp(1j * delta)[:, None] - flow
    made = marginals(flow, np.array([[sigma**2]]), np.array([[0.0]]))
    expected = np.mean(off.real**2), np.mean(off.imag**2), np.mean(off.real * off.imag)
    scale = float(made[0][0, 0] + made[1][0, 0])
    assert np.allclose([x[0, 0] for x in made], expected, atol=0.01 * scale)


def affected(count, **others):
    """Make headings with the columns of two coefficients, a constant and a random part of one degree."""
    turn = np.arange(count) / 30.0
    columns = np.stack([np.full(count, 1.5), np.sin(turn)], axis=1)
    further = np.hypot(others.get("unexplained_deg", 0.0), others.get("constant_deg", 0.0))
    sigma = np.sqrt(1.0 + np.sum(columns**2, axis=1) + further**2)
    made = {
        "name": "top", "time_s": TIMES[:count], "used": np.ones(count, dtype=bool), "heading_deg": np.full(count, 40.0),
        "sigma_deg": sigma, "probability": np.ones(count), "columns_deg": columns, "doubted_deg": np.zeros(count),
        "unexplained_deg": 0.0, "constant_deg": 0.0, "weights": np.ones(1),
    }  # fmt: skip
    return AffectedHeadings(**made | others)


@pytest.mark.parametrize(
    ("others", "names", "shares"),
    [
        ({"constant_deg": 1.0}, 2, [1.0, 0.5]),  # the constant of the headings is better known than the reference's
        ({"unexplained_deg": 2.0, "constant_deg": 2.0}, 3, [1.0, 1.0]),
        ({"constant_deg": 3.0}, 3, [1.0, 1.0]),  # the mean veer beside it is a mode of its own
        ({"weights": np.zeros(1)}, 2, [1.0, 0.0]),  # a calibration does not depend on the reference's compass
    ],
)
def test_error_modes_and_random_part_add_up_to_the_total(others, names, shares):
    given = affected(N, **others)
    product, _ = gridded_of(source("top", np.full(N, 100.0)))
    errors = heading_errors([given], [ReferenceCompass("deep", 2.0)], product.axes, 10800.0, 0.5)
    assert len(errors.names) == 2 + names and errors.shares[0, :2].tolist() == shares
    assert errors.shares[1].tolist() == [1.0, 1.0, *[0.0] * names]
    total = errors.variance(0) / np.deg2rad(1.0) ** 2
    assert np.allclose(total, given.sigma_deg**2 + 0.5**2)  # no part is counted twice, none is missing
    assert np.allclose(errors.random, np.deg2rad(1.0))


def test_ambiguous_branch_gives_nan_and_columns_are_compressed():
    probability = np.where(np.arange(N) < 20, 0.6, 1.0)
    product, _ = gridded_of(source("top", np.full(N, 100.0)))
    errors = heading_errors([affected(N, probability=probability, weights=np.zeros(0))], [], product.axes, 10800.0, 0.5)
    assert np.isnan(errors.variance(0)[:20]).all() and np.isfinite(errors.variance(0)[20:]).all()
    columns = np.random.default_rng(2).normal(size=(500, 12)) * 0.5 ** np.arange(12)
    kept, left = compress(columns, 5)
    assert kept.shape == (500, 5) and np.allclose(np.sum(kept**2, axis=1) + left, np.sum(columns**2, axis=1))
    assert left.mean() < 0.01 * np.mean(np.sum(columns**2, axis=1))


def test_series_are_interpolated_like_velocities():
    product, _ = gridded_of(source("top", np.full(N, 100.0)))
    series = np.arange(N, dtype=float)
    series[[5, 6, *range(20, 26)]] = np.nan
    along = average_slots(series, TIMES, product.axes, 10800.0)
    assert np.allclose(along[:20], np.arange(20)) and np.isnan(along[20:26]).all() and along[26] == 26.0


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Write gridded.nc and gridded_daily.nc of a diving sphere and a point meter; get their folder and the product."""
    folder = tmp_path_factory.mktemp("grid")
    product, piece = gridded_of(source("top", DIVING, noise=0.02), source("deep", DIVING + 12.0, bins=1))
    field = EarthField(TIMES[[0, -1]], *np.full((4, 2), 10.0))
    about = gridded.FileDescription(
        site=Site("M1", 60.0, -30.0, 800.0), field=field, headings=(N, N), also={"seam_pairs": 3},
        attributes={"institution": "I", "project": "P", "principal_investigator": "N", "license": "L",
                       "naming_authority": "A"},
        processing={"method": "exact", "software_version": "1", "date_created": "2020-01-01T00:00:00Z",
                       "history": "2020-01-01T00:00:00Z: made", "declination_source": "IGRF"},
    )  # fmt: skip
    daily = [DailyMeans(product.axes, product.errors, running_h) for running_h in ((), GODIN_H)]
    counts = gridded.write_gridded(folder / "gridded.nc", product, about, daily)
    gridded.write_daily(folder / "gridded_daily.nc", product, about, *daily)
    assert counts["filled"] == np.sum(piece.source >= 0) and counts["cells"] == piece.source.size
    return folder, product, piece


def _mean(rows):
    there = np.isfinite(rows)
    return np.where(
        there.any(axis=0), np.where(there, rows, 0.0).sum(axis=0) / np.maximum(there.sum(axis=0), 1), np.nan
    )


@pytest.mark.filterwarnings("ignore")  # warnings of the checker itself
def test_files_contain_the_grid_and_follow_conventions(written):
    folder, product, piece = written
    with netCDF4.Dataset(folder / "gridded.nc") as nc:
        assert nc["DEPTH"].ndim == 1 and nc["HEADING_ERROR_MODE"].dimensions == ("MODE", "TIME")
        assert nc["SOURCE"].flag_meanings == "none top deep" and "HEADING_ERROR_SHARE" in nc.comment
        missing = np.ma.getmaskarray(nc["UCUR"][:])
        assert (missing == np.ma.getmaskarray(nc["VCUR"][:])).all() and (missing == (piece.source < 0)).all()
    shown = gridded.read_section(folder / "gridded.nc", 100)
    flow = piece.cells.velocity
    means = [flow[k : k + 3] for k in range(0, N, 3)]
    assert np.allclose(shown.after, [_mean(x) for x in means], atol=1e-6, equal_nan=True)
    affected = np.where(piece.source == 0, flow, complex(np.nan, np.nan))
    alone = np.array([_mean(affected[k : k + 3]) for k in range(0, N, 3)])
    assert np.allclose(shown.before + shown.change, alone, atol=1e-6, equal_nan=True)
    assert np.allclose(shown.heading_sigma_deg, np.rad2deg(np.hypot(0.05, 0.02)), atol=1e-4)
    whole = np.isfinite(flow).all(axis=0)  # depths without gaps always have a mean
    profile = shown.profiles[1]
    assert whole.any() and np.allclose(profile.mean[whole], flow[:, whole].mean(axis=0), atol=1e-6)
    expected = [np.cov(x.real, x.imag, bias=True) for x in flow[:, whole].T]
    assert np.allclose(profile.east_variance[whole], [c[0, 0] for c in expected], atol=1e-7)
    assert np.allclose(profile.covariance[whole], [c[0, 1] for c in expected], atol=1e-7)
    assert np.allclose(shown.profile_sigma[0][whole], 0.05 * np.abs(flow[:, whole].imag.mean(axis=0)), atol=1e-6)
    for file, step in (("gridded.nc", 1.0 / 24.0), ("gridded_daily.nc", 1.0)):
        assert conventions.remarks(folder / file) == []
        with netCDF4.Dataset(folder / file) as nc:
            for name, width in (("TIME", step), ("DEPTH", product.axes.step_m)):
                around = np.maximum(nc[name][:][:, None] + width * np.array([-0.5, 0.5]), 0.0)
                assert np.allclose(nc[nc[name].bounds][:], around, rtol=0.0, atol=1e-9)  # days resolve 0.3 us
            assert nc["UCUR"].cell_methods == "TIME: mean" and "velocities put on fixed depths" in nc.history
            assert "DECLINATION" not in nc["UCUR"].declination_comment and "metadata_link" not in nc.ncattrs()
        data = gridded.open_gridded(folder / file).to_xarray()
        assert {"TIME", "DEPTH", "TIME_bnds", "DEPTH_bnds"} <= {*data.coords} and data.UCUR.dims == ("TIME", "DEPTH")
        with pytest.raises(InputError, match=r"found gridded velocities; open it by compasslib\.open_gridded"):
            netcdf.open_product(folder / file)


def test_daily_mean_keeps_common_error_and_reduces_noise(written):
    folder, product, piece = written
    with netCDF4.Dataset(folder / "gridded_daily.nc") as nc:
        count, u, v = nc["N_SAMPLES"][:], nc["UCUR"][:], nc["VCUR"][:]
        sigma, shrinkage = nc["UCUR_UNCERTAINTY"][:], nc["SHRINKAGE"][:]
    full = np.asarray(count == 24)
    day = int(np.flatnonzero(full.any(axis=1))[0])
    level = int(np.flatnonzero(full[day])[0])
    inside = product.axes.time_s // 86400.0 == product.axes.time_s[0] // 86400.0 + day
    flow = piece.cells.velocity[inside, level]
    assert inside.sum() == 24 and complex(u[day, level], v[day, level]) == pytest.approx(flow.mean(), abs=1e-6)
    common = 0.05 * abs(flow.imag.mean())
    single = np.sqrt(piece.east_variance[inside, level].mean())
    assert common < sigma[day, level] < single
    assert np.allclose(shrinkage, np.exp(-0.5 * (0.05**2 + 0.02**2)), atol=1e-6)
    assert np.ma.getmaskarray(u)[np.asarray(count) == 0].all()


def test_transport_has_the_sigma_of_turned_velocities(written):
    folder, product, piece = written
    currents = gridded.open_gridded(folder)
    span = float(product.axes.depth_m[2]) - 1.0, float(product.axes.depth_m[5]) + 2.0  # parts of the outermost cells
    height = np.zeros(len(product.axes.depth_m))
    height[2:6] = [5.0, 8.0, 8.0, 6.0]
    made = currents.transport(*span, width_m=2000.0, along_deg=90.0)
    whole = (piece.source[:, 2:6] >= 0).all(axis=1)
    assert made.units == "m3 s-1" and (np.isfinite(made.values) == whole).all() and 0 < whole.sum() < N
    at = int(np.flatnonzero(whole)[3])
    flow = currents.velocity[at] * 2000.0 * height
    assert made.values[at] == pytest.approx(np.nansum(flow.real))
    turned = [np.nansum(np.where(currents.source[at] == s, flow.imag, 0.0)) for s in range(2)]
    rest = np.nansum((currents.east_sigma[at] * 2000.0 * height) ** 2)
    least = np.hypot(0.05 * sum(turned), 0.02 * turned[0])
    assert least < made.sigma.values[at] <= np.sqrt(least**2 + rest)  # cells' sigma holds the heading's part too
    assert made.mean_sigma > 0.05 * abs(np.nanmean(np.nansum(currents.velocity.imag * 2000.0 * height, axis=1)[whole]))
    assert (made.TIME == currents.to_xarray().TIME).all()
    part = currents.transport(*span, width_m=2000.0, along_deg=90.0, least_share=0.5)
    assert np.isfinite(part.values).sum() > whole.sum() and (part.values[whole] == made.values[whole]).all()
    with pytest.raises(InputError, match=r"expected from_m and to_m within .* found 0 to 900; name other depths"):
        currents.transport(0.0, 900.0, width_m=1.0, along_deg=0.0)


def test_filter_removes_tides_and_keeps_slow_currents():
    tide = sum(0.3 * np.exp(2j * np.pi * TIMES / (3600.0 * period)) for period in (12.42, 12.0, 23.93, 25.82))
    slow = 0.2 * np.exp(2j * np.pi * (TIMES - TIMES[0]) / (86400.0 * 40.0))
    still = source("top", np.full(N, 100.0))
    values = Velocities((tide + slow)[:, None] + np.zeros((1, 10)), *list(vars(still.rows(slice(None))).values())[1:3])
    moving = replace(
        still, rows=lambda rows: Velocities(values.velocity[rows], values.depth_m[rows], values.quality[rows])
    )
    product, piece = gridded_of(moving)
    box, low = (DailyMeans(product.axes, product.errors, running_h) for running_h in ((), GODIN_H))
    box.add(piece)
    low.add(piece)
    means, filtered = box.means(product), low.means(product)
    there = np.isfinite(filtered.piece.cells.velocity[:, 3].real)
    assert there.sum() == N // 24 - 2 and not there[[0, -1]].any()  # the ends lack a day and a half
    expected = np.interp(filtered.time_s, TIMES, slow.real) + 1j * np.interp(filtered.time_s, TIMES, slow.imag)
    off = [np.abs(x.piece.cells.velocity[there, 3] - expected[there]).max() for x in (means, filtered)]
    assert off[1] < 0.004 < 0.02 < off[0]  # what a daily mean leaves of diurnal tides, the filter takes
    assert (filtered.piece.noise[there, 3] < means.piece.noise[there, 3]).all()


@pytest.mark.filterwarnings("ignore")  # warnings of the checker itself
@pytest.mark.parametrize("days", [20, 11])
def test_deployments_of_a_site_are_joined_with_their_errors(written, tmp_path, days):
    first, later = written[0] / "gridded_daily.nc", tmp_path / "later.nc"
    shutil.copyfile(first, later)
    with netCDF4.Dataset(later, "a") as nc:
        for name in ("TIME", "TIME_bnds"):
            nc[name][:] = nc[name][:] + days
        nc["UCUR"][:] = nc["UCUR"][:] + 0.05
    seams = sites.join_daily(tmp_path / "joined.nc", {"A": first, "B": later}, "S", {})
    single, both = gridded.open_gridded(first), gridded.open_gridded(tmp_path / "joined.nc")
    count = len(single.time_s)
    assert len(both.time_s) == count + days and conventions.remarks(tmp_path / "joined.nc") == []
    assert both.instruments == ("A_top", "B_top", "A_deep", "B_deep") and both.errors.random.shape[0] == 2
    alone = min(days, count)
    assert both.velocity[:alone] == pytest.approx(single.velocity[:alone], nan_ok=True)
    assert both.velocity[-count + 3 :] == pytest.approx(single.velocity[3:] + 0.05, nan_ok=True)
    there = np.isfinite(single.velocity) & np.isfinite(single.east_sigma)
    value, sigma = single.sum_cells(there / there.sum(), 0.0)
    inside = np.zeros(both.velocity.shape, dtype=bool)
    inside[:count] = there  # of the first deployment alone, where no day is common
    if days == 20:
        assert seams == ["A to B, 0.0 km apart: 7 days between them"]
        assert both.sum_cells(inside / there.sum(), 0.0) == (pytest.approx(value), pytest.approx(sigma))
    else:
        assert "2 common days; later minus earlier" in seams[0]
        # The fixture's one mode stands for the declination, which is common; the random parts are not.
        everywhere = np.isfinite(both.velocity) & np.isfinite(both.east_sigma)
        assert 0.9 * sigma < both.sum_cells(everywhere / everywhere.sum(), 0.0)[1] < 1.1 * sigma


def test_section_figures_are_drawn_with_and_without_velocities(written, tmp_path):
    shown = gridded.read_section(written[0] / "gridded.nc", 50)
    nothing = np.full(shown.after.shape, complex(np.nan, np.nan))
    none = replace(shown, before=nothing, after=nothing, change=nothing,
                   profiles=tuple(replace(p, mean=nothing[0]) for p in shown.profiles))  # fmt: skip
    series = gridded.read_depth_series(written[0] / "gridded.nc")
    assert series.depth_m["recorded"] == series.depth_m["corrected"] and series.step_s == HOUR_S
    long = np.exp(2j * np.pi * np.arange(40 * 24) / 12.42)
    of_long = replace(series, velocity=dict.fromkeys(series.velocity, long))
    for draw, some, empty in (
        (timeseries.draw_section, shown, none), (timeseries.draw_profile, shown, none),
        (moorings.draw_rotary, of_long, series),
    ):  # fmt: skip
        counts = []
        for content in (some, empty):
            draw(tmp_path / "a.png", content)
            with Image.open(tmp_path / "a.png") as image:
                counts.append(len(image.convert("RGB").getcolors(1 << 20)))
        assert counts[0] > 300 >= counts[1], draw
    some = np.array([[0.02, 0.011], [0.011, 0.01]])
    size, angle = timeseries.principal_axis(gridded.MeanProfile(0j, some[0, 0], some[1, 1], some[0, 1]))
    values, vectors = np.linalg.eigh(some)
    assert size == pytest.approx(np.sqrt(values[1])) and np.tan(angle) == pytest.approx(vectors[1, 1] / vectors[0, 1])


def test_noise_of_far_bins_is_estimated_separately():
    noise = 0.01 * np.array([1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
    draws = np.random.default_rng(4).normal(size=(6000, 10, 2)) @ np.array([1.0, 1j])
    learnt = learn_bin_noise(0.3 + noise * draws, Differences(1.0, np.zeros(1), 2.0 * noise[0] ** 2))
    assert np.allclose(learnt[[0, 3, 8, 9]], 2.0 * noise[[0, 3, 8, 9]] ** 2, rtol=0.1)
