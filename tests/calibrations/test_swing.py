"""Would catch published headings missed, water or delay taken for a deviation, wrong courses that are not left out."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from compasslib import angles, compass
from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import result, swing
from compasslib.calibrations.result import Calibration
from compasslib.deviation.series import series_deviation
from compasslib.errors import InputError
from compasslib.plots.calibrations import draw_deviation as page
from compasslib.plots.page import DPI, WIDTH_IN
from tests.world import recordings
from tests.world import swing as world

REAL = Path(__file__).resolve().parents[3] / "shared/data/swing/2010-11-03.Taiohae.nmea"
DEVIATIONS = np.array([-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123])  # MM section 5.3
COURSES = np.array([0, 46, 91, 136, 179, 226, 269, 315])  # MM section 5.2
DECLINATION = -0.135
TRUTH = np.array([0.6, 5.0, -3.0, 1.2, -0.5])
SURE = {"declination_deg": 0.0, "declination_sigma_deg": 1e-6}


def written(tmp_path, **columns) -> Path:
    path = tmp_path / "swing.csv"
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerow(columns)
        csv.writer(stream).writerows(zip(*(np.asarray(x).tolist() for x in columns.values()), strict=True))
    return path


def recorded(heading_deg, truth=TRUTH):
    """Return headings recorded by a compass whose deviation is this series in the recorded heading."""
    gamma = np.asarray(heading_deg, dtype=float)
    for _ in range(60):
        gamma = heading_deg - series_deviation(truth, gamma)
    return angles.wrap360(gamma)


def at_sea(n=36, *, speed_kn=6.0, water=(0.4, -0.3), noise_deg=0.5, seed=0, truth=TRUTH):
    """Simulate a log of readings round the circle in a current (east, north; knots)."""
    rng = np.random.default_rng(seed)
    heading = 360.0 * np.arange(n) / n
    through = np.broadcast_to(speed_kn, n)
    east, north = (a + b for a, b in zip(angles.components(through, heading), water, strict=True))
    course = angles.wrap360(angles.direction(east, north) + noise_deg * rng.normal(size=n))
    return {"compass_deg": recorded(heading, truth), "cog_deg": course, "speed_kn": np.hypot(east, north)}


def sigmas(found: Calibration) -> np.ndarray:
    return np.sqrt(np.diag(found.covariance))


@pytest.fixture
def eight(tmp_path):
    true = 45.0 * np.arange(8)
    recorded_deg = angles.wrap360(true - DECLINATION - DEVIATIONS)
    return written(tmp_path, compass_deg=recorded_deg, true_deg=true, cog_deg=COURSES)


def test_the_eight_headings_by_true_heading(eight):
    found = swing.calibrate([eight], {"declination_deg": DECLINATION, "withhold": ["cog_deg"]})
    cardinal = found.details["cardinal"]
    assert round(cardinal["A"], 4) == -0.0775
    assert round(cardinal["B_bar"], 4) == -7.0005
    assert round(cardinal["D_from"]["NW"], 3) == -11.947
    assert found.residual_rms_deg == pytest.approx(4.05, abs=0.005)  # physics page, section 7
    assert (found.n, found.coverage, found.kind, found.model) == (8, 8, "swing", "series")
    assert found.details["drift"] is None
    told = " ".join(found.warnings)
    assert "8 headings determine at most 8 coefficients" in told
    assert "sin 4 of the heading is not observable" in told
    assert "swing 16 to 24 headings" in told


def test_the_eight_headings_by_course_over_ground(eight):
    found = swing.calibrate([eight], {"declination_deg": DECLINATION, "withhold": ["true_deg"]})
    cardinal = found.details["cardinal"]
    printed = {"A_bar": -0.4625, "A": -0.3275, "B_bar": -6.0005, "C_bar": -1.8985, "D": 1.725, "E": 1.049}
    assert {k: round(cardinal[k], 4) for k in printed} == printed
    assert found.details["drift"]["separable"] is False
    assert "no speeds were logged" in " ".join(found.warnings)
    by_heading = swing.calibrate([eight], {"declination_deg": DECLINATION, "withhold": ["cog_deg"]})
    assert sigmas(found)[1] > sigmas(by_heading)[1]  # B contains the current


def test_true_heading_is_preferred_over_the_course(eight):
    found = swing.calibrate([eight], {"declination_deg": DECLINATION})
    assert found.residual_rms_deg == pytest.approx(4.05, abs=0.005)
    assert "the true heading is used" in " ".join(found.warnings)
    table_3 = {k: round(x, 4) for k, x in found.details["pseudo_minus_true"].items()}
    assert table_3 == {"A": -0.25, "D": 0.25, "E": -0.25}  # MM Table 3 and its note


def test_series_is_recovered_exactly_without_noise(tmp_path):
    heading = np.arange(5.0, 360.0, 15.0)
    path = written(tmp_path, compass_deg=recorded(heading), true_deg=angles.wrap360(heading + 4.0))
    found = swing.calibrate([path], SURE | {"declination_deg": 4.0, "table_step_deg": 15.0})
    assert found.coefficients == pytest.approx(TRUTH, abs=1e-6)
    assert found.table.heading_deg.tolist() == (15.0 * np.arange(24)).tolist()
    assert found.table.deviation_deg == pytest.approx(series_deviation(TRUTH, found.table.heading_deg), abs=1e-6)


@pytest.mark.parametrize("declination", [10.7, -10.7])
def test_recorded_headings_already_true_are_reported_first(tmp_path, declination):
    columns = at_sea(truth=np.array([0.0, 5.0, -3.0, 1.2, -0.5]), noise_deg=0.1)
    true = written(tmp_path, **columns)
    first = swing.calibrate([true], SURE | {"declination_deg": declination}).warnings[0]
    assert f"minus the declination of {declination:+.1f}°: the recorded headings are probably true" in first
    assert "write declination: 0" in first
    advised = swing.calibrate([true], SURE | {"declination_deg": 0.0})
    assert abs(advised.coefficients[0]) < 0.5 and "the declination" not in advised.warnings[0]
    magnetic = written(tmp_path, **columns | {"compass_deg": angles.wrap360(columns["compass_deg"] - declination)})
    right = swing.calibrate([magnetic], SURE | {"declination_deg": declination})
    assert not any("minus the declination" in text for text in right.warnings)
    wrong = swing.calibrate([magnetic], SURE | {"declination_deg": -declination})
    assert "twice minus the declination" in wrong.warnings[0] and "has the wrong sign" in wrong.warnings[0]


def test_place_date_and_courses_that_do_not_fit_are_told(tmp_path):
    columns = at_sea(noise_deg=0.1)
    turned = written(tmp_path, **columns | {"compass_deg": angles.wrap360(columns["compass_deg"] - 30.0)})
    assert "A is +30." in " ".join(swing.calibrate([turned], SURE).warnings)
    dated = written(tmp_path, time_utc=[f"2022-09-29T10:{k:02d}:00Z" for k in range(36)], **columns)
    (told,) = [text for text in swing.calibrate([dated], SURE | {"date_s": 5e8}).warnings if "the log is of" in text]
    assert told == "the log is of 2022-09-29, the declination of 1985-11-05 (date)"
    courses = np.random.default_rng(1).uniform(0.0, 360.0, 36)
    random = swing.calibrate([written(tmp_path, **columns | {"cog_deg": courses})], SURE)
    assert any("where those of real swings scatter by 1 to 4°" in text for text in random.warnings)


def test_strong_iron_is_fitted_by_the_exact_compass(tmp_path):
    iron, heading = np.array([0.02, 0.45, -0.2, 0.05, -0.03]), np.arange(0.0, 360.0, 10.0)
    path = written(tmp_path, compass_deg=compass.recorded_heading(iron, heading), true_deg=heading)
    found = swing.calibrate([path], SURE)
    assert found.exact == pytest.approx(iron, abs=1e-6)
    assert "exceed the validity of the five-term series" in " ".join(found.warnings)


def test_one_speed_cannot_separate_the_current_from_b_and_c(tmp_path):
    found = swing.calibrate([written(tmp_path, **at_sea())], SURE)
    drift = found.details["drift"]
    assert drift["separable"] is False
    assert "set and drift cannot be separated from B and C" in drift["text"]
    assert np.all(sigmas(found)[1:3] > 3.0)  # 57.3 x 0.5 kn / 6 kn is 4.8
    assert np.all(sigmas(found)[[0, 3, 4]] < 0.75)  # second order of 1 kn at 6 kn
    assert found.coefficients[1:3] == pytest.approx([7.9, 0.8], abs=0.4)  # B bar, C bar: B - x, C + y
    assert np.all(np.abs(found.coefficients - TRUTH) < 2.0 * sigmas(found))


@pytest.mark.parametrize("water", [(0.9, 0.4), (-0.7, 0.7), (0.2, -0.9)])
def test_courses_without_scatter_do_not_separate_the_current(tmp_path, water):
    """A file rounded to 0.1 degree agrees better than a receiver measures; second-order effects then decide nothing."""
    columns = {name: np.round(x, 1) for name, x in at_sea(24, speed_kn=8.0, water=water, noise_deg=0.0).items()}
    found = swing.calibrate([written(tmp_path, **columns, time_utc=1.2e9 + 30.0 * np.arange(24.0))], SURE)
    assert np.all(np.abs(found.coefficients - TRUTH) < 2.0 * sigmas(found))


def test_varied_speeds_determine_the_current(tmp_path):
    speed = np.tile([3.0, 5.0, 8.0, 12.0], 18)
    found = swing.calibrate([written(tmp_path, **at_sea(72, speed_kn=speed, noise_deg=0.3))], SURE)
    drift = found.details["drift"]
    assert drift["separable"] is True
    assert drift["drift_kn"] == pytest.approx(0.5, abs=3.0 * drift["sigma_drift_kn"])
    assert abs(float(angles.difference(drift["set_deg"], 126.87))) < 3.0 * drift["sigma_set_deg"]
    assert np.all(np.abs(found.coefficients - TRUTH) < 3.0 * sigmas(found))
    assert sigmas(found)[1] < 1.0


def test_eight_courses_are_corrected_for_a_known_current(tmp_path):
    """Half a knot of current at 6 kn by the ship's log; B and C are recovered within the approximations of MM."""
    columns = at_sea(64, noise_deg=0.02)
    logged = 6.0 + 0.02 * np.random.default_rng(3).normal(size=64)
    found = swing.calibrate([written(tmp_path, **columns, water_speed_kn=logged)], SURE)
    freed, bars = found.details["cardinal_without_water"], found.details["cardinal"]
    assert abs(bars["B_bar"] - 5.0) > 2.0
    assert freed["B"] == pytest.approx(5.0, abs=0.8)  # B bar is a mean over 45 degrees of heading
    assert freed["C"] == pytest.approx(-3.0, abs=0.8)


def test_speed_log_determines_the_current_at_one_speed(tmp_path):
    columns = at_sea(60, noise_deg=0.5)
    logged = 1.07 * 6.0 + 0.05 * np.random.default_rng(3).normal(size=60)
    found = swing.calibrate([written(tmp_path, **columns, water_speed_kn=logged)], SURE)
    drift = found.details["drift"]
    assert drift["separable"] is True
    assert (drift["east"], drift["north"]) == pytest.approx((0.4, -0.3), abs=0.06)  # 3 sigma
    assert drift["log_scale"] == pytest.approx(1 / 1.07, abs=0.01)
    withheld = swing.calibrate([tmp_path / "swing.csv"], SURE | {"withhold": ["water_speed_kn"]})
    assert withheld.details["drift"]["separable"] is False


def test_visual_marks_determine_b_and_c(tmp_path):
    columns = at_sea(8, noise_deg=0.05)
    marks = [{"compass_deg": float(recorded(np.array([h]))[0]), "true_deg": h} for h in (40.0, 130.0)]
    path = written(tmp_path, **columns)
    bare = swing.calibrate([path], SURE)
    one = swing.calibrate([path], SURE | {"visual": marks[:1]})
    two = swing.calibrate([path], SURE | {"visual": marks, "visual_sigma_deg": 0.3})
    assert set(bare.details["residual_b_c"]) == {"opposite_courses"}
    across = np.array(angles.sin_cos(40.0))
    left = [float(across @ f.covariance[1:3, 1:3] @ across) for f in (bare, one)]
    assert left[1] < 0.15 * left[0]  # a mark determines the component across it, not that along it
    assert np.trace(two.covariance[1:3, 1:3]) < 0.1 * np.trace(one.covariance[1:3, 1:3])
    both = two.details["residual_b_c"]["two_headings"]
    assert (both["B"], both["C"]) == pytest.approx((5.0, -3.0), abs=0.3)  # second order of the drift
    assert {"B", "C", "drift"} == set(one.details["residual_b_c"]["one_heading"])


@pytest.mark.parametrize("set_deg", [0.0, 40.0, 130.0, 220.0])
def test_five_courses_and_one_mark_state_the_error_by_drift(tmp_path, set_deg):
    """Moncunill's complete method on exact data with S/d = 10: B and C err only along the heading of the mark."""
    truth = np.array([0.4, 1.6, -2.0, 1.5, -0.6])
    gamma = np.array([0.0, 90.0, 180.0, 270.0, 45.0])
    through = angles.components(8.0, gamma + series_deviation(truth, gamma))
    east, north = np.add(through, angles.components([0.8], set_deg))
    columns = {"compass_deg": gamma, "cog_deg": angles.direction(east, north), "speed_kn": np.hypot(east, north)}
    mark = [{"compass_deg": float(recorded(np.array([40.0]), truth)[0]), "true_deg": 40.0}]
    found = swing.calibrate([written(tmp_path, **columns)], SURE | {"visual": mark})
    off = found.coefficients - truth
    assert np.all(np.abs(off) < 1.96 * sigmas(found)) and result.expanded(found.sources) < 8.0
    drift = found.details["residual_b_c"]["one_heading"]["drift"]
    by_mark = [found.details["residual_b_c"]["one_heading"][k] for k in "BC"]
    error = 5.73 * np.cos(np.deg2rad(set_deg - 40.0)) * np.array([np.cos(np.deg2rad(40.0)), -np.sin(np.deg2rad(40.0))])
    assert np.subtract(by_mark, truth[1:3]) == pytest.approx(-error, abs=0.6)  # second order
    assert not any("lies in the quadrant of" in text for text in found.warnings)
    elsewhere = swing.calibrate([tmp_path / "swing.csv"], SURE | {"visual": [{"compass_deg": 130, "true_deg": 130}]})
    assert any("lies in the quadrant of SE and D comes from NE alone" in text for text in elsewhere.warnings)
    assert np.hypot(*error) <= drift["largest_deg"] and "second mark 60 to 120° away" in drift["text"]
    by_speed = [found.details["residual_b_c"]["opposite_courses"][k] for k in "BC"]
    assert by_speed == pytest.approx(truth[1:3], abs=0.6)


def test_heading_for_the_sun(tmp_path):
    path, settings = written(tmp_path, **at_sea()), SURE | {"latitude": 43.4, "longitude": -3.4}
    sun = [{"compass_deg": 200.0, "time_utc": "2021-05-24T13:00:00Z"}]
    found = swing.calibrate([path], settings | {"sun": sun})
    assert found.details["marks"][0]["true_deg"] == pytest.approx(208.55, abs=0.05)
    with pytest.raises(InputError, match="sun: expected latitude and longitude"):
        swing.calibrate([path], SURE | {"sun": sun})


def test_budget_adds_up_to_the_uncertainty_of_the_table(tmp_path):
    found = swing.calibrate([written(tmp_path, **at_sea())], {"declination_deg": 0.0})
    total = sum(source.standard_deg**2 for source in found.sources)
    assert total == pytest.approx(np.mean(found.table.sigma_deg**2), rel=1e-9)
    names = {source.name: source.standard_deg for source in found.sources}
    assert names["declination"] == pytest.approx(0.4, abs=0.003)
    assert {"scatter of the courses about the curve", "set and drift of the water"} <= set(names)


def test_outliers_hardly_move_the_fit(tmp_path):
    columns = at_sea(72, noise_deg=0.5)
    clean = swing.calibrate([written(tmp_path, **columns)], SURE)
    columns["cog_deg"][[5, 30, 61]] += 60.0
    columns["cog_deg"] = angles.wrap360(columns["cog_deg"])
    spoilt = swing.calibrate([written(tmp_path, **columns)], SURE)
    # Clipped to 1.25 degrees, they change a coefficient by 0.1 degrees, and B, along the drift, by slightly more.
    assert np.max(np.abs(spoilt.coefficients - clean.coefficients)) < 0.8


def test_intervals_cover_the_truth(tmp_path):
    """60 swings of 16 headings, drift up to 1 kn: a coverage below 88 % of 300 has a probability below 0.001."""
    inside = []
    for k in range(60):
        rng = np.random.default_rng(k)
        radius, towards = np.sqrt(rng.uniform()), 2.0 * np.pi * rng.uniform()
        water = (radius * np.cos(towards), radius * np.sin(towards))
        columns = at_sea(16, speed_kn=7.0 + rng.normal(size=16), water=water, noise_deg=1.0, seed=k)
        found = swing.calibrate([written(tmp_path, **columns)], SURE)
        inside.append(np.abs(found.coefficients - TRUTH) < 1.96 * sigmas(found))
    assert 0.88 < np.mean(inside) < 0.995


@pytest.mark.parametrize(
    ("headings", "why"),
    [
        ([], "no usable observations"),
        ([30.0], "one heading cannot carry the five coefficients"),
        ([0.0, 90.0, 200.0], "3 headings cannot carry the five coefficients"),
        ([0.0, 90.0, 200.0] * 8, "3 headings cannot carry"),
        ([0.0, 72.0, 144.0, 216.0, 288.0], "5 observations leave no degree of freedom for the uncertainty"),
        (list(range(100, 160, 4)), "the headings cover 6 of 36 sectors and leave a gap of 304°"),
    ],
)
def test_insufficient_headings_are_refused_with_the_reason(tmp_path, headings, why):
    heading = np.array(headings, dtype=float)
    found = swing.calibrate([written(tmp_path, compass_deg=heading, true_deg=heading)], SURE)
    assert found.why.startswith(why)
    assert found.coefficients.size == found.covariance.size == 0
    assert found.table is None
    json.dumps(found.details)


def test_a_two_valued_compass_is_refused_with_the_way_out(tmp_path):
    """As in a car whose iron is 1.9 times the earth's horizontal field: it shows 66 of 360 degrees."""
    heading = np.arange(0.0, 360.0, 15.0)
    shown = compass.recorded_heading(np.array([0.0, 1.2, 1.4, 0.0, 0.0]), heading)
    found = swing.calibrate([written(tmp_path, compass_deg=shown, true_deg=heading)], SURE)
    assert "for two headings" in found.why and "kind: platform" in found.why


def test_few_headings_widen_intervals_and_repeats_do_not_narrow(tmp_path):
    """Third harmonic of 3 degrees: six headings leave one degree of freedom; repeated readings of eight add none."""

    def swung(n, times):
        heading = np.tile(360.0 * np.arange(n) / n + 7.0, times)
        bent = heading - 3.0 * angles.sin_cos(3.0 * heading)[0]
        return swing.calibrate([written(tmp_path, compass_deg=angles.wrap360(bent), true_deg=heading)], SURE)

    six, eight, often, many = swung(6, 1), swung(8, 1), swung(8, 8), swung(24, 1)
    assert sigmas(six)[1] > 2.0 * sigmas(eight)[1]
    assert sigmas(often)[1] == pytest.approx(sigmas(eight)[1], rel=0.05)
    assert sigmas(many)[1] < 0.5 * sigmas(eight)[1]
    assert "56 of 64 observations repeat a heading" in " ".join(often.warnings)
    assert not any("determine at most" in line for line in many.warnings)


def circling(seconds: int, rate_deg_s: float) -> dict[str, np.ndarray]:
    """Simulate the log of a circling boat whose course over ground is three seconds late."""
    rng, time = np.random.default_rng(2), np.arange(seconds)
    heading = np.cumsum(np.broadcast_to(rate_deg_s, seconds))
    columns = {"compass_deg": recorded(heading), "cog_deg": heading - 3.0 * rate_deg_s + rng.normal(size=seconds)}
    stamps = np.datetime64("2021-05-24T11:00:00") + time.astype("timedelta64[s]")
    others = {"speed_kn": 5.0 + np.sin(time / 40.0), "time_utc": np.datetime_as_string(stamps)}
    return {k: angles.wrap360(x) for k, x in columns.items()} | others


def test_delay_is_confounded_with_a_unless_turning_both_ways(tmp_path):
    one_way = swing.calibrate([written(tmp_path, **circling(900, 0.8))], SURE)
    assert any("swing to both sides" in line for line in one_way.warnings)
    assert sigmas(one_way)[0] > 2.0
    assert abs(one_way.coefficients[0] - TRUTH[0]) < 2.0 * sigmas(one_way)[0]
    rates = np.where(np.arange(1800) < 900, 0.8, -0.8)
    both = swing.calibrate([written(tmp_path, **circling(1800, rates))], SURE)
    assert both.details["lag_s"][0] == pytest.approx(3.0, abs=0.5)
    assert both.coefficients[0] == pytest.approx(TRUTH[0], abs=3.0 * sigmas(both)[0])
    assert sigmas(both)[0] < 0.3


@pytest.mark.parametrize(
    ("late", "applied"), [({"filter_s": 6.0}, 5.5), ({"clock_s": -7.0}, 7.0), ({"lag_s": 6.0}, -6.0), ({}, 0.0)]
)
def test_a_delay_that_explains_most_of_the_misfit_is_applied(tmp_path, late, applied):
    """Legs with quick turns: the delay of the course or compass is recovered, and turns are not excluded."""
    boat = world.Boat(plan=world.LEGS, speed_kn=8.0, leeway_deg=0.5, wander_deg=1.0, **late)
    path = recordings.written(world.sail(np.random.default_rng(3), boat, 5.0), tmp_path / "swing.csv")
    found = swing.calibrate([path], SURE | {"declination_deg": 5.0})
    assert np.all(np.abs(found.coefficients) < 3.0 * sigmas(found))
    turning = [text for text in found.warnings if "turning quicker" in text]
    if not applied:
        assert found.details["delay"] is None and turning
        return
    delay_s, sigma_s = found.details["lag_s"]
    assert abs(delay_s - applied) < max(3.0 * sigma_s, 0.5) and not turning
    late_ones = "courses" if applied > 0 else "readings"
    assert f"The {late_ones} are late by {abs(delay_s):.1f}" in found.details["delay"]["text"]
    without = swing.calibrate([path], SURE | {"declination_deg": 5.0, "max_lag_s": 0.0})
    assert without.n < found.n and result.expanded(found.sources) < result.expanded(without.sources)


def test_invalid_swing_files_are_refused_with_the_reason(tmp_path):
    path = written(tmp_path, compass_deg=[1.0], heading=[2.0])
    with pytest.raises(InputError, match=r"a column of the course over ground \(cog_deg\) or of the true heading"):
        swing.calibrate([path], SURE)
    with pytest.raises(InputError, match=r"'hdg' \(compass_deg\): expected one of the file's columns, found comp"):
        swing.calibrate([path], SURE | {"columns": {"compass_deg": "hdg", "true_deg": "heading"}})
    columns = at_sea(36)
    columns["compass_deg"][3] = 999.0
    with pytest.raises(InputError, match=r"numbers from -180 to 360, or nothing, found 1 beyond, 999 first"):
        swing.calibrate([written(tmp_path, **columns)], SURE)
    path = written(tmp_path, compass_deg=[1.0], heading=[2.0])
    with pytest.raises(InputError, match="declination: expected a number, or position and date"):
        swing.calibrate([path], {"columns": {"true_deg": "heading"}})


@pytest.mark.skipif(not REAL.exists(), reason="no ../shared/data")
def test_real_nmea_log():
    found = swing.calibrate([REAL], {"format": "nmea0183"})
    assert found.details["date"] == "2010-11-03"
    assert found.details["declination_deg"] == pytest.approx(10.7, abs=0.05)
    assert found.details["left_out"]["not above 2 kn"] == 1088 - 715
    assert "the log states a declination of +10.0°" in " ".join(found.warnings)
    assert found.details["drift"]["separable"] is True
    with pytest.raises(InputError, match=r"the place of the log's own positions, -8.92, -140.10, found -8.92, 140.10"):
        swing.calibrate([REAL], {"format": "nmea0183", "latitude": -8.92, "longitude": 140.10, "date_s": 1288742400.0})
    bare = swing.calibrate([REAL], {"format": "nmea0183", "withhold": ["water_speed_kn"]})
    assert bare.details["drift"]["separable"] is False
    assert np.all(sigmas(bare)[1:3] > 5.0)
    assert np.all(np.abs(bare.coefficients - found.coefficients) < 2.0 * sigmas(bare))
    json.dumps(found.details)


def test_figure_is_drawn_of_a_swing_and_of_a_refused_one(tmp_path, eight):
    found = swing.calibrate([eight], {"declination_deg": DECLINATION, "latitude": 43.4, "longitude": -3.4})
    refused = swing.calibrate([written(tmp_path, compass_deg=[1.0], true_deg=[2.0])], SURE)
    for made in (found, refused):
        table = made.table or result.DeviationTable(*np.zeros((3, 0)))
        page(tmp_path / "a.png", StoredCalibration(result.to_json("swing", made, {}), table, made.points))
        assert imread(tmp_path / "a.png").shape[1] == WIDTH_IN * DPI
