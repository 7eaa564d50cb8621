"""Would catch wrong clocks or axes of two heads on one frame, compasses exchanged, an ambiguity not stated."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from compasslib import angles, calibrations
from compasslib.archive import calibrations as calibration_files
from compasslib.archive.files import read_csv, read_json
from compasslib.calibrations import result
from compasslib.calibrations import two_heads as heads
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.two_heads import motion as heads_motion
from compasslib.errors import InputError
from compasslib.inference import kinds
from compasslib.inference.comparison import Options
from compasslib.plots import calibrations as figures
from tests.world import package
from tests.world.package import Head, Sea
from tests.world.pd0_encoder import START, ensemble
from tests.world.sea import SHARED
from tests.world.two_heads_files import PLAIN, START_S, TURNED, cast, rewritten

NARROW = Sea(turns=0.0, wander_deg=14.0)
EH2 = SHARED / "pd0/eh2_20060530_20060717_0007m.000"
FOUR_SIGMA = 4.0  # exceeded by one seed in 16,000 if the stated sigma is correct


@pytest.fixture(scope="module")
def full(tmp_path_factory) -> Calibration:
    """Calibrate a cast of four turns, with head b upward-looking, rotated by 47 degrees and 7.3 seconds ahead."""
    return heads.calibrate(cast(tmp_path_factory.mktemp("full")), {})


@pytest.fixture(scope="module")
def narrow(tmp_path_factory) -> Calibration:
    return heads.calibrate(cast(tmp_path_factory.mktemp("narrow"), sea=NARROW), {})


def lowered(seed: int):
    """Simulate the motion of a lowered frame; return also the generator, for the noise of its heads."""
    rng = np.random.default_rng(seed)
    return rng, package.lower(rng, Sea(), START_S)


def of_files(folder: Path, *contents: bytes) -> Calibration:
    paths = [folder / "a.000", folder / "b.000"]
    for path, content in zip(paths, contents, strict=True):
        path.write_bytes(content)
    return heads.calibrate(paths, {})


def test_a_turning_cast_gives_offset_coefficients_and_clock(full):
    said = full.details
    assert full.kind == "two_heads" and full.why == "" and full.coverage == 36 and said["terms"] == 5
    assert abs(said["offset_deg"] - 47.0) < FOUR_SIGMA * said["offset_sigma_deg"]
    sigma = np.sqrt(np.diag(full.covariance))
    assert (np.abs(full.coefficients - TURNED.deviation_deg)[1:] < FOUR_SIGMA * sigma[1:]).all()
    assert full.coefficients[0] == 0.0 and (sigma < 0.1).all()
    assert abs(said["clock"]["offset_s"] - TURNED.clock_s) < FOUR_SIGMA * said["clock"]["sigma_s"] < 0.05
    # Noise of 0.5 degrees in each compass, changed in b by up to 13 % by the slope of its deviation.
    assert full.residual_rms_deg == pytest.approx(0.5 * np.sqrt(2.0), rel=0.1)


def test_tilts_show_the_rigid_frame_of_an_up_looker(full):
    assert full.details["frame"]["verdict"] == "rigid"
    # Noise of 0.1 degrees in two inclinometers, each on two axes.
    assert full.details["frame"]["residual_rms_deg"] == pytest.approx(0.2, abs=0.03)


def test_narrow_headings_determine_only_an_offset(narrow):
    said = narrow.details
    assert 6 <= narrow.coverage <= 10 and said["terms"] == 1 and narrow.coefficients.size == 0
    assert "B, C, D and E are refused" in narrow.why and f"cover {narrow.coverage} of 36 sectors" in narrow.why
    assert said["offset_sigma_deg"] > 1.0  # includes the leakage of refused terms
    assert abs(said["offset_deg"] - 47.0) < FOUR_SIGMA * said["offset_sigma_deg"]
    assert narrow.table is not None
    assert np.isnan(narrow.table.sigma_deg).sum() >= 36 - narrow.coverage - 4
    assert any("offset_deg is the mean difference over" in warning for warning in narrow.warnings)


@pytest.mark.parametrize(("width", "terms"), [(87, 1), (140, 1), (175, 3), (210, 3), (245, 5), (360, 5)])
def test_number_of_terms_by_width_of_the_arc(width, terms):
    rng, n = np.random.default_rng(3), 4000
    heading = angles.wrap360(20.0 + width * rng.random(n))
    fitted = heads.fit_difference(np.arange(float(n)), heading, rng.normal(0.0, 1.0, n), np.zeros(n))
    assert fitted.terms == terms
    assert ("D and E are refused" in fitted.refused) == (terms < 5)


def test_uncertainty_widens_away_from_the_headings(tmp_path):
    found = heads.calibrate(cast(tmp_path, sea=Sea(turns=0.0, wander_deg=48.0)), {})
    assert found.details["terms"] == 3 and np.isnan(found.coefficients[3:]).all()
    assert found.table is not None
    sigma = found.table.sigma_deg[np.isfinite(found.table.sigma_deg)]
    assert max(sigma[0], sigma[-1]) > 3.0 * sigma.min()


def test_spikes_are_left_out(tmp_path):
    paths = cast(tmp_path)
    rng = np.random.default_rng(2)
    hit = {}

    def spoil(heading):
        hit["n"] = np.flatnonzero(rng.random(len(heading)) < 0.02)
        heading[hit["n"]] = 360.0 * rng.random(len(hit["n"]))
        return heading

    paths[1].write_bytes(rewritten(paths[1].read_bytes(), spoil))
    found = heads.calibrate(paths, {})
    assert abs(found.details["spikes"] - len(hit["n"])) < 0.1 * len(hit["n"])
    assert found.details["offset_deg"] == pytest.approx(47.0, abs=0.1)
    assert found.coefficients[1:] == pytest.approx(TURNED.deviation_deg[1:], abs=0.15)


def test_clock_drift_is_estimated_and_removed(tmp_path):
    found = heads.calibrate(cast(tmp_path, b=replace(TURNED, drift_s=0.5)), {})
    clock, a_day = found.details["clock"], 0.5 * 86400.0 / 4000.0
    assert clock["drift_applied"] and abs(clock["drift_s_per_day"] - a_day) < 4.0 * clock["drift_sigma_s_per_day"]
    assert found.details["offset_deg"] == pytest.approx(47.0, abs=0.06)


def test_headings_give_the_clock_offset_without_swell(tmp_path):
    found = heads.calibrate(cast(tmp_path, sea=Sea(swell_deg=0.01, lean_deg=0.0)), {})
    clock = found.details["clock"]
    assert found.details["frame"]["verdict"] == "not testable"
    assert np.isnan(clock["from_tilts_s"]).all()
    assert abs(clock["offset_s"] - TURNED.clock_s) < 4.0 * clock["sigma_s"]


def test_lagging_compass_is_distinguished_from_a_clock_error(tmp_path):
    rng, motion = lowered(1)
    seen = package.stand(rng, motion, TURNED)
    ahead = package.stand(rng, motion, replace(TURNED, first_s=TURNED.first_s + 0.8)).recorded_deg
    # Headings are 0.8 s early in the file, the last one repeated at its end.
    ahead = np.append(ahead, np.repeat(ahead[-1], len(seen.time_s) - len(ahead)))
    a, b = package.stand(rng, motion, PLAIN), replace(seen, recorded_deg=ahead)
    found = of_files(tmp_path, package.encoded(a), package.encoded(b))
    clock = found.details["clock"]
    assert clock["from_headings_s"][0] - clock["from_tilts_s"][0] == pytest.approx(-0.8, abs=0.05)
    assert clock["offset_s"] == pytest.approx(TURNED.clock_s, abs=0.03)
    assert any("one compass lags" in warning for warning in found.warnings)


def test_roll_counted_the_other_way_is_no_rigid_frame(tmp_path):
    a, b = (package.stand(rng, motion, head) for rng, motion in [lowered(3)] for head in (PLAIN, TURNED))
    found = of_files(tmp_path, package.encoded(a), package.encoded(b, looks_up=True, mirrored=True))
    assert found.details["frame"]["verdict"] == "not rigid"
    assert found.details["offset_deg"] == pytest.approx(47.0, abs=0.1)


def test_heads_on_two_frames_are_refused(tmp_path):
    paths = cast(tmp_path)
    (tmp_path / "other").mkdir()
    other = cast(tmp_path / "other", seed=9, sea=Sea(turns=-5.0))
    found = heads.calibrate([paths[0], other[1]], {})
    assert found.coefficients.size == 0 and "do not stand on one frame" in found.why
    assert "offset_deg" not in found.details


def test_files_without_common_time_are_refused(tmp_path):
    rng, sea = np.random.default_rng(1), Sea(deepest_m=300.0)
    motions = [package.lower(rng, sea, start) for start in (START_S, START_S + 1e6)]
    found = of_files(tmp_path, *(package.encoded(package.stand(rng, motion, Head())) for motion in motions))
    assert found.n == 0 and "share no time" in found.why and found.table is None


def test_time_window_and_clock_offset_are_applied(tmp_path):
    paths = cast(tmp_path)
    settings = {"start_s": START_S + 500.0, "end_s": START_S + 2500.0, "clock_offset_seconds": 7.3}
    found = heads.calibrate(paths, settings)
    # The window is in the time of a, the points in that of b, 7.3 s ahead.
    assert found.points["time_s"][0] == pytest.approx(START_S + 507.3, abs=3.0)
    assert found.points["time_s"][-1] == pytest.approx(START_S + 2507.3, abs=3.0)
    assert found.details["offset_deg"] == pytest.approx(47.0, abs=0.1)


def test_one_file_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"file: expected two files, of head a and head b, found 1; write file: \["):
        heads.calibrate([tmp_path / "a.000"], {})


def test_rotated_heading_is_that_of_the_tilted_body():
    rng = np.random.default_rng(5)
    heading, pitch, roll = rng.uniform(0, 360, 50), rng.uniform(-12, 12, 50), rng.uniform(-12, 12, 50)
    wanted, pitch_b, roll_b = package.mounted(heading, (pitch, roll), (65.0, 4.0, -6.0))
    lean_a, lean_b = heads_motion.lean(pitch, roll), heads_motion.lean(pitch_b, roll_b)
    frame = heads.fit_frame(np.arange(50.0), lean_a, lean_b)
    assert frame.residual_rms_deg < 1e-5
    for rotation in (frame.rotation, heads.upright(65.0, lean_a, lean_b)):
        turned = heads.turned_heading(heading, lean_a, rotation)
        off = angles.difference(turned, wanted)
        # ``upright`` matches only the mean leans; the fitted rotation is exact.
        assert np.abs(off).max() < (1e-9 if rotation is frame.rotation else 0.2)


def test_coefficients_are_recovered_from_a_rotated_real_record(tmp_path):
    if not EH2.exists():
        pytest.skip("no ../shared/data")
    rng = np.random.default_rng(0)
    series = (0.0, 8.0, -5.0, 2.0, 1.0)
    other = tmp_path / "b.000"
    noisy = rewritten(EH2.read_bytes(), lambda h: package.read_through(h - 33.0, series) + rng.normal(0.0, 0.5, len(h)))
    other.write_bytes(noisy)
    found = heads.calibrate([EH2, other], {})
    sigma = np.sqrt(np.diag(found.covariance))
    assert found.n > 3200 and found.coverage == 36
    assert abs(found.details["offset_deg"] + 33.0) < 4.0 * found.details["offset_sigma_deg"]
    assert (np.abs(found.coefficients - series)[1:] < 4.0 * sigma[1:]).all() and sigma.max() < 0.05


def test_real_headings_of_87_degrees_are_refused(tmp_path):
    path = SHARED / "pd0/03160000.000"
    if not path.exists():
        pytest.skip("no ../shared/data")
    other = tmp_path / "b.000"
    other.write_bytes(rewritten(path.read_bytes(), lambda h: h + 12.0))
    found = heads.calibrate([path, other], {})
    assert found.details["terms"] == 1 and "B, C, D and E are refused" in found.why
    assert found.details["offset_deg"] == pytest.approx(12.0, abs=0.01)


def _still(path, n, heading):
    """Write a head with given headings (hundredths of a degree) and constant tilts."""
    cells, fixed = [[100, 200, 3, 2]] * 4, {"up": True}
    times = [START + timedelta(seconds=10 * i) for i in range(n)]
    made = [
        ensemble(cells, fixed=fixed, number=i + 1, when=when, heading=heading(i), tilt1=300)
        for i, when in enumerate(times)
    ]
    path.write_bytes(b"".join(made))
    return path


@pytest.mark.parametrize(("n", "turning"), [(1, 0), (1, 700), (100, 0), (100, 700), (400, 700)])
def test_steady_still_or_identical_heads_raise_no_error(tmp_path, n, turning):
    few = n == 1 or (n, turning) == (100, 700)  # too few in each sector
    a = _still(tmp_path / "a.000", n, lambda i: (i * turning) % 36000)
    b = _still(tmp_path / "b.000", n, lambda i: (i * turning + 4500) % 36000)
    for other in (a, b):
        made = calibrations.calibrate("two_heads", [a, other], {})
        kinds.diagnose("two_heads", [a, other], {}, Options())
        assert (made.model == "none") == few
        files = {file: tmp_path / f"{file}.x" for file in ("calibration", "table", "points")}
        calibration_files.write(page=result.to_json("h", made, {}), made=made, **files)
        table, points = calibration_files.read_table(files["table"]), read_csv(files["points"])
        stored = calibration_files.StoredCalibration(read_json(files["calibration"]), table, points)
        for figure in calibrations.figure_names("two_heads"):
            figures.draw_figure(figure, tmp_path / f"{figure}.png", stored)
