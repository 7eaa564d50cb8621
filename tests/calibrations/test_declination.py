"""Would catch a storm, wrong dates or a wrong file that pass for an observatory's constant, or sound days refused."""

from dataclasses import replace

import numpy as np
import pytest

from compasslib import earthfield
from compasslib.archive.calibrations import StoredCalibration
from compasslib.archive.files import read_json, write_json
from compasslib.calibrations import observatory, result
from compasslib.errors import InputError
from compasslib.plots import calibrations as plots
from tests.world.iaga_files import DAY_S, HOUR_S, LATITUDE, LONGITUDE, ROCKS_DEG, START_S, series, write
from tests.world.sea import SHARED

REAL = SHARED / "observatory"
real = pytest.mark.skipif(not REAL.is_dir(), reason="no observatory files in ../shared/data")
PLACE = {"latitude": 55.3, "longitude": 356.8}


def held(made, limit_deg=0.5):
    field = earthfield.field_along(LATITUDE, LONGITUDE, made.time_s[0], made.time_s[-1])
    return observatory.compare(made, field, limit_deg=limit_deg)


def test_constant_and_daily_variation_are_recovered(tmp_path):
    made = observatory.calibrate([write(tmp_path / "a.hor", series(60))], {"declination": "auto"})
    assert made.why == "" and made.model == "IGRF plus a constant" and made.n == 60 * 24
    assert abs(made.coefficients[0] - ROCKS_DEG) < 2.0 * np.sqrt(made.covariance[0, 0]) < 0.06
    assert np.isnan(made.coefficients[1:]).all() and made.details["storms"] == []
    quiet = made.details["quiet_day"]
    assert quiet["amplitude_deg"] == pytest.approx(0.07, abs=0.02)  # median of twelve days of noise of 0.02
    assert (made.table.deviation_deg == made.coefficients[0]).all()


def test_storm_is_dated_with_little_effect_on_the_constant():
    quiet = series(30)
    hours = (quiet.time_s - START_S - 10 * DAY_S) / HOUR_S
    burst = np.where((hours >= 0) & (hours < 12), 1.5 * np.cos(hours), 0.0)
    found = held(replace(quiet, declination_deg=quiet.declination_deg + burst))
    (storm,) = found.storms
    assert abs(storm.begin_s - START_S - 10 * DAY_S) <= HOUR_S
    assert abs(storm.end_s - START_S - 10.5 * DAY_S) <= 2 * HOUR_S
    assert storm.range_deg == pytest.approx(3.0, abs=0.3)
    assert abs(found.constant_deg - held(quiet).constant_deg) < 0.01


def test_spike_is_not_a_storm():
    quiet = series(30)
    wild = quiet.declination_deg + 8.0 * (np.arange(len(quiet)) == 300)
    found = held(replace(quiet, declination_deg=wild))
    assert found.storms == () and found.spikes == 1


def test_averages_preserve_gaps():
    made = series(1, step_s=60.0)
    missing = replace(made, declination_deg=np.where(np.arange(1440) // 600 == 1, np.nan, made.declination_deg))
    time_s, mean = observatory.average(missing, 600.0)
    assert len(time_s) == 84 and mean[0] == pytest.approx(made.declination_deg[:10].mean())


def test_covariates_are_unaffected_by_wrapping_at_180(tmp_path):
    made = series(10)
    turned = replace(made, declination_deg=(made.declination_deg - 175.3 + 180.0) % 360.0 - 180.0)
    paths = write(tmp_path / "turned.hor", turned), write(tmp_path / "made.hor", made)
    there, here = (observatory.covariates([path], made.time_s)[0] for path in paths)
    assert np.isfinite(here).all() and np.allclose(there, here, atol=0.01)  # as rounded in the files


def test_a_series_that_is_too_short_is_refused(tmp_path):
    made = series(1)
    short = replace(made, declination_deg=np.where(np.arange(24) < 8, made.declination_deg, np.nan))
    found = observatory.calibrate([write(tmp_path / "a.hor", short)], {})
    assert found.why == "the series has a declination in 8 hours; 12 are needed" and not found.coefficients.size
    plots.draw_series(tmp_path / "a.png", found)
    assert (tmp_path / "a.png").stat().st_size > 5_000


def test_position_of_yaml_counts_and_one_is_needed(tmp_path):
    path = write(tmp_path / "a.hor", series(2), place=False)
    with pytest.raises(InputError, match=r"a\.hor: expected geodetic latitude and longitude in the header, found none"):
        observatory.calibrate([path], {"latitude": None, "longitude": None})
    assert observatory.calibrate([path], PLACE).coefficients[0] == pytest.approx(ROCKS_DEG, abs=0.1)
    found = observatory.calibrate([write(tmp_path / "b.hor", series(2))], {"latitude": 57.0, "longitude": -3.2})
    assert any("the file has the station at 55.3 N 356.8 E" in said for said in found.warnings)


def test_calibration_round_trips_through_json_and_is_drawn(tmp_path):
    made = observatory.calibrate([write(tmp_path / "a.hor", series(40))], {})
    page = result.to_json("quiet", made, PLACE)
    write_json(tmp_path / "calibration.json", page)
    again = read_json(tmp_path / "calibration.json")
    assert again["coefficients"]["A"] == pytest.approx(made.coefficients[0]) and again["coefficients"]["B"] is None
    assert "A +0.2" in result.log_line(again) and "nan" not in result.log_line(page)
    plots.draw_series(tmp_path / "a.png", StoredCalibration(again, made.table, made.points))
    assert (tmp_path / "a.png").stat().st_size > 20_000


def at_igrf(days):
    """Return a quiet series with intensities of IGRF, except for 60 nT of local rocks in the horizontal one."""
    made = series(days)
    _, horizontal, vertical = earthfield.igrf(LATITUDE, LONGITUDE, [START_S])
    return replace(made, horizontal_nT=0.0 * made.time_s + horizontal - 60.0, vertical_nT=0.0 * made.time_s + vertical)


def test_missing_baseline_is_named_and_refused(tmp_path):
    made = at_igrf(40)
    about_zero = replace(made, declination_deg=made.declination_deg - 4.0, horizontal_nT=made.horizontal_nT - 17_000.0)
    with pytest.raises(InputError, match="a variation about zero: the baseline is missing"):
        observatory.calibrate([write(tmp_path / "a.hor", about_zero, "DHZF")], {})


def test_large_constant_gives_a_warning_and_a_huge_one_is_refused(tmp_path):
    made = at_igrf(40)
    lava, turned = (replace(made, declination_deg=made.declination_deg + x) for x in (-3.4, 25.0))
    found = observatory.calibrate([write(tmp_path / "a.hor", lava)], {})
    assert "rocks rarely make more than 600 nT" in " ".join(found.warnings)
    with pytest.raises(InputError, match=r"as IGRF has, found D \+20"):
        observatory.calibrate([write(tmp_path / "a.hor", turned)], {})


@real
def test_eskdalemuir_gives_no_warnings():
    for name in ("esk20030610dmin.min", "esk20031029dmin.min", "esk20031120dmin.min", "esk1980dhor.hor"):
        assert observatory.calibrate([REAL / name], PLACE).warnings == ()


@real
def test_eskdalemuir_is_a_tenth_of_a_degree_west_of_igrf():
    quiet = observatory.calibrate([REAL / "esk20030610dmin.min"], {})
    year = observatory.calibrate([REAL / "esk2003dhor.hor"], PLACE)
    assert year.coefficients[0] == pytest.approx(-0.114, abs=0.005)
    assert abs(quiet.coefficients[0] - year.coefficients[0]) < 1.96 * np.sqrt(quiet.covariance[0, 0])
    assert quiet.details["range_deg"] < 0.3 and quiet.details["storms"] == []


@real
def test_intervals_of_single_days_cover_the_annual_constant():
    from compasslib.readers import iaga2002

    year = iaga2002.read([REAL / "esk2003dhor.hor"])
    whole = held(year).constant_deg
    days = [slice(24 * k, 24 * k + 24) for k in range(0, 365, 3)]
    parts = [held(replace(year, time_s=year.time_s[d], declination_deg=year.declination_deg[d])) for d in days]
    within = [abs(one.constant_deg - whole) <= 1.96 * one.constant_sigma_deg for one in parts]
    assert np.mean(within) > 0.92  # 95 % less 1.5 standard errors of 122 days
