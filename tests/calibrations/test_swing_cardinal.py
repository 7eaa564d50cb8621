"""Would catch a formula or printed number of Moncunill Marimon et al. 2023, the sun or a magnet gone wrong."""

from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from compasslib import angles, compass
from compasslib.calibrations import swing
from compasslib.calibrations.swing import adjustment
from compasslib.deviation.series import series_design

DEVIATIONS = dict(zip(adjustment.POINTS, (-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123), strict=True))
PSEUDO = dict(zip(adjustment.POINTS, (-1.312, 2.888, -7.512, -3.414, 2.485, 15.586, 4.489, 14.988), strict=True))
DECLINATION = -0.135


def test_coefficients_from_deviations():  # MM section 5.3 and Table 4
    found = adjustment.principal_coefficients(DEVIATIONS, 0.0)
    printed = {"A": -0.0775, "B_bar": -7.0005, "C_bar": -2.3985, "E": 1.299, "D": 1.475}
    assert {k: round(found[k], 4) for k in printed} == printed
    assert round(found["D_from"]["NE"], 4) == 8.7456
    assert round(found["D_from"]["SE"], 4) == 0.9479
    assert [round(x, 3) for x in found["D_from"].values()] == [8.746, 0.948, 8.153, -11.947]


def test_coefficients_from_pseudo_deviations():  # MM section 5.4 and Table 4
    found = adjustment.principal_coefficients(PSEUDO, DECLINATION)
    printed = {"A_bar": -0.4625, "A": -0.3275, "B_bar": -6.0005, "C_bar": -1.8985, "E": 1.049, "D": 1.725}
    assert {k: round(found[k], 4) for k in printed} == printed
    assert round(found["D_from"]["NE"], 4) == 8.9351
    assert [round(x, 3) for x in found["D_from"].values()] == [8.935, 0.051, 10.464, -12.550]


def test_pseudo_deviations_of_table_2():
    true = 45.0 * np.arange(8)
    recorded = angles.wrap360(true - DECLINATION - np.array(list(DEVIATIONS.values())))
    found = adjustment.pseudo_deviations([0, 46, 91, 136, 179, 226, 269, 315], recorded)
    assert {k: round(x, 3) for k, x in found.items()} == PSEUDO


def test_error_bound():  # MM Table 1 and section 7.3
    assert round(float(adjustment.error_bound_deg(1 / 7)), 3) == 0.585
    assert float(adjustment.error_bound_deg(1 / 8)) < 0.5 < float(adjustment.error_bound_deg(1 / 7.5))


@given(st.floats(0.0, 1 / 7), st.floats(0.0, 360.0))
def test_set_and_drift_by_the_triangle_of_speeds(ratio, set_deg):
    """The exact triangle is the sum of (d/S)^k sin(k phi)/k, of which MM omit the terms from k = 3."""
    heading = np.arange(0.0, 360.0, 15.0)
    (east, north), (de, dn) = angles.components(1.0, heading), angles.components(ratio, set_deg)
    beta = angles.difference(angles.direction(east + de, north + dn), heading)
    terms = adjustment.set_and_drift_terms(ratio, set_deg)
    by_terms = series_design(heading) @ [0.0, -terms["x"], terms["y"], terms["D"], -terms["E"]]
    assert np.max(np.abs(beta - by_terms)) <= 57.3 * ratio**3 / 3.0 * (1.0 + ratio) + 1e-9
    assert max(abs(terms["D"]), abs(terms["E"])) <= adjustment.error_bound_deg(ratio) + 1e-12


def test_missing_course_leaves_out_dependent_coefficients():
    found = adjustment.principal_coefficients({**PSEUDO, "NW": np.nan}, DECLINATION)
    assert np.isnan(found["D_from"]["NW"])
    assert found["D"] == pytest.approx(np.mean([8.9351, 0.0514, 10.4639]), abs=1e-3)
    none = adjustment.principal_coefficients({**PSEUDO, "N": np.nan}, DECLINATION)
    assert np.isnan([none["A"], none["C_bar"], none["E"], none["D"]]).all()
    assert round(none["B_bar"], 4) == -6.0005


KNOWN = {"A": 0.4, "D": 1.5, "E": -0.6}


def deviation(b: float, c: float, heading: float) -> float:
    return (series_design([heading]) @ [KNOWN["A"], b, c, KNOWN["D"], KNOWN["E"]]).item()


@given(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), st.floats(0.0, 360.0), st.floats(60.001, 119.999))
def test_two_headings_give_b_and_c(b, c, first, apart):
    headings = (first, first + apart)
    found = adjustment.residual_from_two_headings(KNOWN, *((h, deviation(b, c, h)) for h in headings))
    assert (found["B"], found["C"]) == pytest.approx((b, c), abs=1e-9)


def test_two_headings_too_near_are_refused():
    found = adjustment.residual_from_two_headings(KNOWN, (350.0, 1.0), (20.0, 1.0))
    assert "the two headings are 30 degrees apart" in found["why"] and "B" not in found


def test_one_heading_determines_the_component_across_it():
    """Lushnikov: one heading gives the component across it for any drift; that along it keeps the error of the bars."""
    b, c, x, y = 3.0, -2.0, 4.0, -1.5
    for true_heading in (10.0, 80.0, 200.0, 300.0):
        off = deviation(b, c, true_heading)
        found = adjustment.residual_by_lushnikov(KNOWN, (b - x, c + y), true_heading - off, off)
        sine, cosine = angles.sin_cos(true_heading)
        assert found["B"] * sine + found["C"] * cosine == pytest.approx(b * sine + c * cosine, abs=1e-9)
        along = (b - x) * cosine - (c + y) * sine
        assert found["B"] * cosine - found["C"] * sine == pytest.approx(along, abs=1e-9)


def test_sun_by_the_almanac_of_the_solar_position_algorithm():
    """Reda and Andreas 2004, section A.5: azimuth 194.34024 degrees; parallax and delta T amount to 0.01 degrees."""
    time_s = datetime(2003, 10, 17, 19, 30, 30, tzinfo=UTC).timestamp()
    assert swing.azimuth(39.742476, -105.1786, time_s) == pytest.approx(194.34024, abs=0.01)


def test_nullifying():  # MM section 7.2, point 7
    b = adjustment.nullifying("B", 6.0)
    assert "steer 084.0° (or 276.0°)" in b and "shows 090° (or 270°)" in b
    assert "longitudinal magnets, red ends forward" in b
    assert angles.difference(90.0, compass.recorded_heading([0.0, 0.1, 0.0, 0.0, 0.0], 90.0)) > 5.0  # B > 0: easterly
    c = adjustment.nullifying("C", -3.0)
    assert "steer 003.0° (or 177.0°)" in c and "shows 000° (or 180°)" in c
    assert "transversal magnets, red ends to port" in c
    found = adjustment.plan_magnets(np.array([0.2, 6.0, -3.0, 0.5, 0.1]), np.arange(0.0, 360.0, 15.0))
    assert found["largest_deg"]["none"] > 4.0 > found["largest_deg"]["B"]
    assert found["text"].startswith("Nullify B:")
    without = series_design(np.arange(0.0, 360.0, 15.0)) @ [0.2, 0.0, -3.0, 0.5, 0.1]
    assert found["largest_deg"]["B"] == pytest.approx(np.max(np.abs(without)))


@pytest.mark.parametrize("first", [("E", "N"), ("W", "S"), ("N", "W")])
def test_adjustment_leaves_only_the_effect_of_the_drift(first):
    """MM (6) to (9), (16), (17), with a current (27) to (34): A, D and E remain, B and C become x and -y."""
    a, b, c, _, e = before = np.array([0.7, 6.0, -4.0, 1.5, -0.6])
    x, y = 2.0, -1.0
    nullified = {step["course"]: step for step in adjustment.adjust(before, first)}
    for course, left in (("E", ("B", e - a)), ("W", ("B", a - e)), ("N", ("C", -a - e)), ("S", ("C", a + e))):
        if course in first:  # (6), (6 bis), (7), (7 bis)
            assert nullified[course][left[0]] == pytest.approx(left[1]) and nullified[course]["after_deg"] == 0.0
    assert abs(nullified["W" if "E" in first else "E"]["before_deg"]) == pytest.approx(2.0 * abs(a - e))  # (8)
    last = adjustment.adjust(before, first)[-1]
    assert (last["B"], last["C"]) == pytest.approx((0.0, 0.0), abs=1e-12)  # (16), (17) halved
    last = adjustment.adjust(before, first, (x, y))[-1]
    assert (last["B"], last["C"]) == pytest.approx((x, -y))  # (31), (32) with equal pseudo-deviations
    first_step = adjustment.adjust(before, ("E", "N"))[0]
    assert first_step["before_deg"] == pytest.approx(a + b - e) and first_step["magnets"] == "longitudinal"
    assert "shows 090.0" in first_step["text"] and c == before[2]


def test_the_directive_force_is_that_of_the_exact_compass_at_first_order():  # MM (53)
    exact, heading = np.array([0.0, 0.06, -0.04, 0.03, 0.02]), np.arange(0.0, 360.0, 10.0)
    q = compass.level_field(exact, heading)
    force = adjustment.directive_force(exact / angles.DEGREE, heading)
    assert np.max(np.abs(force - np.real(q * np.conj(angles.phasor(heading))))) < 0.01


@pytest.mark.parametrize(
    ("b", "sigma", "length", "word"),
    [
        (3.0, 0.2, 20.0, "within"),
        (3.8, 0.3, 20.0, "undecided"),
        (6.0, 0.3, None, "exceeds"),
        (6.0, 0.3, 90.0, "not judged"),
    ],
)
def test_verdict(b, sigma, length, word):
    table = adjustment.deviation_table(np.array([0.0, b, 0.0, 0.0, 0.0]), np.eye(5) * sigma**2 / 3.0, 10.0)
    found = adjustment.verdict(table, length, 6.0)
    assert found["verdict"] == word
    assert "the method asks for at least 7 kn" in " ".join(found["conditions"])
    assert adjustment.verdict(table, 20.0, 8.0)["conditions"] == []
