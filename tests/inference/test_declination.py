"""Would catch a storm, jump or trend of an observatory's series given a wrong cause or size."""

import json
from dataclasses import replace

import numpy as np
import pytest

from compasslib import earthfield
from compasslib.archive.files import read_json
from compasslib.calibrations import observatory
from compasslib.calibrations.observatory import with_observatory_warnings
from compasslib.inference.comparison import Options
from compasslib.inference.kinds import declination
from compasslib.stages import demonstration
from tests.world.iaga_files import DAY_S, HOUR_S, LATITUDE, LONGITUDE, START_S, series, write
from tests.world.sea import SHARED

REAL = SHARED / "observatory"
real = pytest.mark.skipif(not REAL.is_dir(), reason="no observatory files in ../shared/data")
PLACE = {"latitude": 55.3, "longitude": 356.8}


def judged(made, number=None):
    field = earthfield.field_along(LATITUDE, LONGITUDE, made.time_s[0], made.time_s[-1], number)
    found = declination.diagnose_series(made, field, Options())
    json.dumps(found.to_json())
    return found


def added(made, extra_deg):
    return replace(made, declination_deg=made.declination_deg + extra_deg)


@pytest.mark.parametrize(("days", "step_s"), [(1, 60.0), (60, HOUR_S), (365, HOUR_S)])
def test_a_quiet_series_is_consistent(days, step_s):
    found = judged(series(days, step_s=step_s, seed=days))
    assert found.verdict == "consistent" and not found.findings
    assert dict(found.negligible)["declination_error"] == pytest.approx(0.2, abs=0.1)
    slow = {effect for effect, _ in found.not_testable}
    fewest = {"secular_variation": 150, "heading_slip": 20}
    assert slow == {effect for effect, least in fewest.items() if days < least}


def jumped(days, height_deg, share, **drawn):
    made = series(days, **drawn)
    return added(made, height_deg * (made.time_s >= START_S + share * days * DAY_S))


def drifting(**changed):
    made = series(300, seed=3)
    return replace(added(made, 4.0 * (made.time_s - START_S) / (365.25 * DAY_S)), **changed)


@pytest.mark.parametrize(
    ("made", "number", "verdict", "effect", "alternatives", "truth"),
    [
        (jumped(120, 3.0, 50 / 120, seed=1), None, "explained", "heading_slip", (), ("offset_deg", -3.0)),
        (jumped(1, 2.0, 0.5, step_s=60.0, seed=2), None, "ambiguous", "heading_slip", ("field_disturbance",), None),
        (drifting(), None, "ambiguous", "secular_variation", ("compass_drift",), ("deg_year", 4.0)),
        (drifting(definitive=True), None, "explained", "secular_variation", (), ("deg_year", 4.0)),
        (series(90, seed=5, swing_deg=1.5), None, "explained", "field_disturbance", (), ("amplitude_deg", 1.5)),
        (
            added(series(30, seed=7), 6.0),
            None,
            "ambiguous",
            "declination_error",
            ("hard_iron", "mounting_offset"),
            None,
        ),
        (series(30, seed=7), 4.8, "explained", "declination_error", (), None),  # a number of the wrong sign
    ],
)
def test_one_effect_is_identified_with_its_size(made, number, verdict, effect, alternatives, truth):
    found = judged(made, number)
    (one,) = found.findings
    assert (found.verdict, one.effect, one.alternatives) == (verdict, effect, alternatives)
    if truth is not None:  # a step turns the reading opposite to the declination
        told = one.parameters[truth[0]]
        assert abs(told.value - truth[1]) < 4.0 * max(told.sigma, 0.02) < 0.4
    if "compass_drift" in alternatives:
        assert "absolute measurements" in found.separated_by
    if number is not None:
        assert "the given number is wrong" in one.text
    if truth == ("offset_deg", -3.0):
        assert abs(one.when_s[0] - START_S - 50 * DAY_S) <= HOUR_S and one.held_out.p_value < 0.01
        assert one.held_out.rms_after_deg < 0.1 < one.held_out.rms_before_deg


def test_a_storm_and_a_jump_are_separated_in_one_series():
    made = series(200, seed=4)
    hours = (made.time_s - START_S - 150 * DAY_S) / HOUR_S
    storm = np.where((hours >= 0) & (hours < 20), 1.5 * np.sin(1.3 * hours), 0.0)
    found = judged(added(made, storm + 2.0 * (made.time_s >= START_S + 60 * DAY_S)))
    when = {one.effect: one.when_s for one in found.findings}
    assert set(when) == {"field_disturbance", "heading_slip"}
    truth = START_S + 150 * DAY_S + np.array([0.0, 20.0]) * HOUR_S
    np.testing.assert_allclose(when["field_disturbance"], truth, atol=2 * HOUR_S)


def test_a_noisy_series_is_unexplained_without_storms():
    made = series(60, seed=6)
    found = judged(added(made, np.random.default_rng(0).normal(0.0, 1.0, len(made))))
    assert found.verdict == "unexplained" and "restless" in found.unexplained.text
    assert not found.findings


@real
def test_the_storm_day_of_eskdalemuir_is_identified_with_dates_and_a_quiet_day_is_consistent():
    quiet = declination.diagnose([REAL / "esk20030610dmin.min"], {})
    assert quiet.verdict == "consistent" and dict(quiet.negligible)["field_disturbance"] < 0.1
    found = declination.diagnose([REAL / "esk20031029dmin.min"], {})
    (one,) = found.findings
    assert (found.verdict, one.effect, one.alternatives) == ("explained", "field_disturbance", ())
    said = one.to_json()["when"]
    assert (said["from"], said["to"]) == ("2003-10-29T06:10:00Z", "2003-10-30T00:00:00Z")
    assert one.parameters["range_deg"].value == pytest.approx(4.2, abs=0.05)
    stored = read_json(demonstration.FOLDER / "storm.json")["cases"]  # on the page of concealed causes
    assert stored[0]["heldout_deg"] == pytest.approx([one.held_out.rms_before_deg, one.held_out.rms_after_deg])
    assert one.held_out.p_value < 0.01 and all(case["expected"] for case in stored)


@real
def test_a_constant_declination_lacks_the_secular_variation_of_23_years():
    files = sorted(REAL.glob("*.hor"))
    assert "secular_variation" not in {f.effect for f in declination.diagnose(files, PLACE).findings}
    one = declination.diagnose(files, PLACE | {"declination": -6.5}).findings[0]
    assert (one.effect, one.alternatives) == ("secular_variation", ())
    assert one.parameters["deg_year"].value == pytest.approx(0.157, abs=0.005)  # as in IGRF


def test_an_observatory_series_becomes_a_covariate_of_a_mooring(tmp_path):
    made = series(40, seed=8)
    hours = (made.time_s - START_S - 20 * DAY_S) / HOUR_S
    storm = np.where((hours >= 0) & (hours < 30), 2.0, 0.0)
    path = write(tmp_path / "a.hor", added(made, storm), "HDZF")
    at = np.arange(START_S - 5 * DAY_S, START_S + 50 * DAY_S, HOUR_S) + 600.0
    found, _ = observatory.covariates([path], at)
    assert np.isnan(found[at < START_S]).all() and np.isnan(found[at > START_S + 40.1 * DAY_S]).all()
    inside = (at > START_S + 20 * DAY_S + HOUR_S) & (at < START_S + 21 * DAY_S)
    assert np.median(found[inside]) == pytest.approx(2.0, abs=0.1)
    begin, end = observatory.strongest_disturbance(at, np.nan_to_num(found))
    assert abs(begin - START_S - 20 * DAY_S) <= HOUR_S and abs(end - START_S - 21.25 * DAY_S) <= HOUR_S


def test_observatory_of_a_mooring_is_checked_for_mistakes_and_time(tmp_path):
    path = write(tmp_path / "a.hor", series(40))
    field = earthfield.field_along(56.0, -5.0, START_S, START_S + 40 * DAY_S)

    def warned(field, path):
        return with_observatory_warnings(field, [path]).warnings

    assert with_observatory_warnings(field, []) is field
    assert warned(field, path) == ()
    later = earthfield.field_along(56.0, -5.0, START_S + 30 * DAY_S, START_S + 90 * DAY_S)
    assert "covers 16 % of the deployment's days" in warned(later, path)[0]
    empty = replace(series(40), declination_deg=np.full(960, np.nan))
    nothing = warned(field, write(tmp_path / "b.hor", empty, "DHZF"))
    assert "covers 0 % of the deployment's days" in nothing[0]
    wrong = replace(series(40), declination_deg=-series(40).declination_deg)
    assert "rocks rarely make more than 600 nT" in warned(field, write(tmp_path / "c.hor", wrong))[0]
