"""Would catch curves that miss published numbers, intervals that miss the truth, a fit to too few headings."""

import numpy as np
import pytest

from compasslib import angles
from compasslib.calibrations import curves, platform, result
from compasslib.calibrations.curves import EMPIRICAL, EXACT, ONE_CYCLE, POLYNOMIAL, SMITH, FittedCurve
from compasslib.calibrations.platform import BenchReadings
from compasslib.deviation.series import series_deviation
from tests.world.bench import FOLDED, MILD, readings, ring

SERIES = np.array([0.6, 5.0, -3.0, 1.2, -0.7])  # degrees
# Moncunill Marimón et al. 2023, section 5.3: deviations on N, NE, E, SE, S, SW, W, NW.
EIGHT = np.array([-1.177, 2.023, -8.377, -4.279, 3.620, 14.721, 5.624, 15.123])


def smith_bench(n: int = 36, noise_deg: float = 0.3, seed: int = 1) -> BenchReadings:
    recorded = ring(n) + 3.0
    noise = np.random.default_rng(seed).normal(0.0, noise_deg, n)
    return BenchReadings(angles.wrap360(recorded + series_deviation(SERIES, recorded) + noise), recorded)


def calibrated(read: BenchReadings, **keys):
    return platform.calibrate_readings(read, **keys)


@pytest.mark.parametrize("form", [SMITH, EXACT, POLYNOMIAL, ONE_CYCLE, EMPIRICAL], ids=lambda form: form.name)
def test_gradient_of_every_form_matches_finite_differences(form):
    coefficients = np.append([0.02, 0.15, 0.1, 0.03, -0.02, 0.01, 0.02], np.full(6, 0.03))[: len(form.letters)]
    heading, step = np.arange(1.0, 360.0, 13.0), 1e-6
    moved = [form.deviation(coefficients + step * unit, heading) for unit in np.eye(len(coefficients))]
    numeric = np.transpose(moved - form.deviation(coefficients, heading)) / step
    assert np.allclose(form.gradient(coefficients, heading), numeric, atol=1e-3)


@pytest.mark.parametrize("form", [SMITH, EXACT, POLYNOMIAL], ids=lambda form: form.name)
def test_left_out_residual_is_that_of_a_fit_without_the_point(form):
    seen = curves.deviation_points(smith_bench().recorded_deg, smith_bench().reference_deg)
    whole, k = curves.fit_curve(form, seen), 7
    without = curves.fit_curve(form, curves.Points(*(np.delete(column, k) for column in vars(seen).values())))
    assert isinstance(whole, FittedCurve) and isinstance(without, FittedCurve)
    alone = seen.deviation_deg[k] - without.deviation(seen.recorded_deg[[k]])[0]
    # The hat matrix of the exact compass is that of its linearisation, whose slope differs by a few per cent.
    assert whole.left_out_deg[k] == pytest.approx(alone, abs=1e-9 if form is not EXACT else 0.05)


def test_exact_compass_is_recovered_exactly_without_noise():
    for true in (MILD, FOLDED, (0.1, 0.6, -0.2, 0.1, 0.05)):
        made = calibrated(readings(ring(24), true, noise_deg=0.0))
        assert np.allclose(made.exact, true, atol=1e-9) and made.residual_rms_deg < 1e-6


def test_le_menn_5_exchanges_the_letters_d_and_e():
    made = calibrated(smith_bench(noise_deg=0.0))
    assert np.allclose(made.coefficients, SERIES, atol=1e-9)
    recorded = np.arange(0.0, 360.0, 10.0)
    printed = SERIES[[0, 1, 2, 4, 3]]  # D with cos 2, E with sin 2
    (s, k), (s2, k2) = angles.sin_cos(recorded), angles.sin_cos(2.0 * recorded)
    a, b, c, d, e = printed
    assert np.allclose(a + b * s + c * k + d * k2 + e * s2, series_deviation(made.coefficients, recorded))


def test_the_polynomial_is_that_of_le_menn_7_and_jumps_at_north():
    heading = np.arange(0.0, 360.0, 10.0)
    deviation = -2.0 + 0.03 * heading + 1e-4 * heading**2
    curve = curves.fit_curve(POLYNOMIAL, curves.deviation_points(heading, heading + deviation))
    assert isinstance(curve, FittedCurve)
    assert np.allclose([*curve.to_json()["coefficients"].values()][:3], [-2.0, 0.03, 1e-4], rtol=1e-6)
    made = calibrated(BenchReadings(angles.wrap360(heading + deviation), heading))
    assert made.model == "polynomial" and any("not periodic: it jumps by -23.8" in text for text in made.warnings)


def test_wrong_firmware_table_is_fitted_by_the_empirical_curve():
    """Von Appen 2015, footnote 1: a table wrong in one section, for which at most 3 of 60 compasses are taken."""
    rng, recorded = np.random.default_rng(5), ring(36) + 4.0
    wrong = 6.0 * np.exp(-0.5 * (angles.difference(recorded, 120.0) / 35.0) ** 2)
    read = BenchReadings(angles.wrap360(recorded + wrong + rng.normal(0.0, 0.3, 36)), recorded)
    made = calibrated(read)
    assert made.model == "empirical" and any("wrong table in the firmware" in text for text in made.warnings)
    truth = 6.0 * np.exp(-0.5 * (angles.difference(made.table.heading_deg, 120.0) / 35.0) ** 2)
    assert angles.rms(made.table.deviation_deg - truth) < 0.35
    assert made.details["models"]["exact"]["residual_rms_deg"] > 0.45
    assert sum(calibrated(smith_bench(seed=seed)).model == "empirical" for seed in range(60)) <= 3


def test_five_terms_leave_4_05_degrees_of_the_published_headings():
    """Physics page, section 7: the residual has third and fourth harmonics, which eight headings cannot establish."""
    made = calibrated(BenchReadings(ring(8), angles.wrap360(ring(8) - EIGHT)))
    smith = made.details["models"]["smith"]
    assert smith["residual_rms_deg"] == pytest.approx(4.05, abs=0.005) and smith["dof"] == 3
    assert any("third and fourth harmonics cannot be tested" in text for text in made.warnings)
    assert made.sources[-1].standard_deg > 1.5 * 4.0  # Student's t with three degrees of freedom


def test_student_widening_matches_the_gum():
    assert curves.student_widening(3) == pytest.approx(3.307 / 2.0, abs=1e-3)  # GUM, table G.2, p = 95.45 %
    assert curves.student_widening(1) == pytest.approx(13.97 / 2.0, abs=1e-2)
    assert curves.student_widening(10**6) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("n", [36, 8])
def test_stated_intervals_cover_the_truth(n):
    """More designs, with 1000 benches of each, are in benchmarks/calibrations.py."""
    inside = []
    for seed in range(120):
        made = calibrated(smith_bench(n, seed=seed))
        inside.append(np.abs(made.coefficients - SERIES) <= 1.96 * np.sqrt(np.diag(made.covariance)))
    assert 0.92 <= np.mean(inside) <= 0.985  # 600 draws: two standard errors are 1.8 %


def test_repeated_readings_do_not_count_as_more_headings():
    once = readings(ring(12), seed=3)
    often = BenchReadings(np.repeat(once.reference_deg, 50), np.repeat(once.recorded_deg, 50))
    first, second = calibrated(once), calibrated(often)
    assert np.allclose(first.covariance, second.covariance) and second.n == 600
    assert any("600 readings at 12 headings" in text for text in second.warnings)


def test_form_that_generated_the_data_is_chosen():
    assert calibrated(readings(ring(), (0.0, 0.4, 0.2, 0.05, 0.0))).model == "exact"
    recorded, noise = ring() + 3.0, np.random.default_rng(1).normal(0.0, 0.1, 36)
    correct = angles.wrap360(recorded + series_deviation(4.0 * SERIES, recorded) + noise)
    made = calibrated(BenchReadings(correct, recorded))
    assert made.model == "smith"
    assert set(made.details["models"]) == {form.name for form in platform.FORMS}


def test_table_includes_the_uncertainty_common_to_all_headings():
    made = calibrated(smith_bench(), table_step_deg=15.0)
    assert len(made.table.heading_deg) == 24 and made.table.heading_deg[1] == 15.0
    off = made.table.deviation_deg - series_deviation(SERIES, made.table.heading_deg)
    assert np.all(np.abs(off) < 4.0 * made.table.sigma_deg)
    rows, _ = result.sources({"graduation_deg": 3.0})
    shared = calibrated(smith_bench(), sources=rows)
    assert np.all(shared.table.sigma_deg > 3.0) and np.all(shared.table.sigma_deg < 3.1)
    maker = calibrated(smith_bench(), sources=result.sources({"maker_accuracy_deg": 6.0})[0])
    assert np.all(maker.table.sigma_deg < 0.3)  # the maker's accuracy is that of a single reading


def test_constant_shift_is_reported_with_its_uncertainty():
    shift = calibrated(smith_bench()).details["constant_shift"]
    assert shift["differs_from_none"] and abs(shift["value_deg"] - SERIES[0]) < 3.0 * shift["sigma_deg"]
    unsure = calibrated(smith_bench(), sources=result.sources({"graduation_deg": 2.0})[0]).details["constant_shift"]
    assert not unsure["differs_from_none"] and "is not significant" in unsure["text"]


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ([], "no reading with both headings; swing 16 to 24"),
        ([30.0], "one heading only: the deviation there is +"),
        ([30.0, 30.0, 30.0], "one heading only: the deviation there is +"),
        ([0.0, 120.0, 240.0], "3 headings in 3 of 36 sectors determine no curve (five terms: 5 coefficients need at"),
        (np.arange(0.0, 60.0, 5.0), "12 headings in 6 of 36 sectors determine no curve (five terms: the headings do"),
        # One cycle would absorb the quadrantal deviation: B = 11.3 ± 0.6 degrees instead of 8.6.
        (np.arange(0.0, 180.0, 10.0), "would look like one cycle"),
    ],
    ids=["none", "one", "one repeated", "three", "a sixth of the circle", "half"],
)
def test_too_few_headings_are_refused_with_the_reason(settings, why):
    made = calibrated(readings(settings))
    assert why in made.why and made.model == "none"
    assert not made.coefficients.size and not made.exact.size and made.table is None
    assert set(made.points) == {"reference_deg", "recorded_deg", "deviation_deg"}


def test_four_headings_determine_only_one_cycle():
    made = calibrated(readings(ring(4)))
    assert made.model == "one_cycle" and np.isfinite(made.coefficients[:3]).all()
    assert np.isnan(made.coefficients[3:]).all() and np.isnan(made.covariance[3:]).all() and not made.exact.size
    assert any("reduced to one cycle" in text and "D and E stay unknown" in text for text in made.warnings)
    assert made.sources[-1].how.startswith("scatter about the curve, 1 degrees of freedom")


def test_two_thirds_of_a_circle_determine_five_terms():
    made = calibrated(readings(np.arange(0.0, 240.0, 10.0)))
    assert made.coefficients.size == 5 and any("no reading between recorded" in text for text in made.warnings)
    gap, middle = made.table.sigma_deg[[30, 12]]
    assert gap > 2.0 * middle


def test_folded_compass_has_exact_coefficients_and_no_table():
    made = calibrated(readings(ring(24), FOLDED))
    assert made.model == "exact" and np.allclose(made.exact, FOLDED, atol=0.02)
    assert not made.coefficients.size and np.isnan(made.table.deviation_deg).all()
    assert any(text.startswith("the compass cannot turn full circle: it shows 16") for text in made.warnings)
    assert made.details["models"]["one_cycle"]["why"].startswith("it misses the readings by 3")
