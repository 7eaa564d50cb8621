"""Would catch known iron, axes or mounting not recovered, noise that biases the fit, an accelerometer taken in."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import magnetometer, result
from compasslib.calibrations.magnetometer import ellipsoid
from compasslib.calibrations.magnetometer.ellipsoid import ELLIPSE, ELLIPSOID, ScaledReadings
from compasslib.calibrations.result import Calibration, DeviationTable
from compasslib.deviation.series import series_design
from compasslib.errors import InputError
from compasslib.plots.calibrations import draw_magnetometer as draw
from tests.world import iron
from tests.world.sea import real

SAFE = 4.5  # standard deviations, not exceeded by any of a few tens of normal numbers


def field_of(true: iron.Iron) -> dict[str, float]:
    horizontal, vertical = true.level
    return {"horizontal_nT": 80.0 * horizontal, "vertical_nT": 80.0 * vertical, "declination_deg": 0.0}


def log(path: Path, values: np.ndarray, motion: np.ndarray | None = None, **more: np.ndarray) -> Path:
    columns = dict(zip("xyz", values.T, strict=False))
    if motion is not None:
        columns |= {"pitch_deg": motion[:, 1], "roll_deg": motion[:, 2]}
    return iron.write(path / "log.csv", **columns, **more)


@cache
def of_real_log(name: str) -> Calibration:
    return magnetometer.calibrate([real(f"magnetometer/{name}.csv")], {})


def off(a, b):
    return (np.asarray(a) - b + 180.0) % 360.0 - 180.0


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def harmonics_percent(modulus, heading_deg):
    """Fit the first and second harmonic of a modulus against the heading, percent of its mean."""
    k = np.linalg.lstsq(series_design(heading_deg), modulus)[0]
    return 100.0 * np.hypot(k[1], k[2]) / k[0], 100.0 * np.hypot(k[3], k[4]) / k[0]


def test_signature500_has_the_published_harmonics_and_no_vertical_offset():
    found = of_real_log("signature500")
    before, after = (
        harmonics_percent(found.points[f"modulus{after}"], found.points[f"{heading}_deg"])
        for after, heading in (("", "recorded"), ("_corrected", "corrected"))
    )
    assert before[0] == pytest.approx(22.6, abs=0.1)  # ten readings in breaking waves are left out
    assert np.rad2deg(before[0] / 100.0) == pytest.approx(12.9, abs=0.06)
    assert before[1] < 1.3
    assert max(after) < 0.5
    assert found.details["axes"].startswith("x forward, y starboard, z down (from the logged heading)")
    assert {"z offset", "S33", "S13", "S23"} <= set(found.details["undetermined"])
    assert found.details["hard_iron"][2] is None
    assert "tilts of up to 12°" in found.details["undetermined_why"]["z offset"]
    assert np.hypot(*found.coefficients[1:3]) == pytest.approx(12.9, abs=0.4)  # uncertain by 0.2 degrees
    assert found.coverage == 36 and found.n + found.details["left_out"] == 2117
    residual = found.details["modulus_residual_percent"]
    assert residual["after"] < 0.5 * residual["before"]


def test_hmc5883l_needs_the_whole_ellipsoid():
    found = of_real_log("hmc5883l_sphere")
    assert found.model == "ellipsoid"
    assert found.details["modulus_residual_percent"]["after"] <= 0.4604  # published 0.46 %
    assert found.coefficients.size == 0 and "depends on the dip" in found.why


def test_an_accelerometer_is_recognised():
    settings = {"columns": {"x": "ax", "y": "ay", "z": "az"}}
    for withhold in ([], ["pitch_deg"]):
        found = magnetometer.calibrate([real("magnetometer/signature500.csv")], settings | {"withhold": withhold})
        assert "this is gravity" in found.why and found.details["hard_iron"] is None


@pytest.mark.parametrize("memory", [0.0, 0.8])
def test_iron_over_the_sphere_is_recovered_within_uncertainty(tmp_path, rng, memory):
    true = iron.some(rng)
    values = iron.readings(rng, true, iron.tumble(rng, 1500), memory=memory)
    found = magnetometer.calibrate([log(tmp_path, values)], {"field": field_of(true)})
    details, soft = found.details, true.soft / np.mean(np.diag(true.soft))
    assert np.all(np.abs(np.array(details["hard_iron"]) - true.hard) < SAFE * np.array(details["hard_iron_sigma"]))
    assert np.all(np.abs(np.array(details["soft_iron"]) - soft) < SAFE * np.array(details["soft_iron_sigma"]))
    wrong = off(found.table.deviation_deg, true.deviation(found.table.heading_deg))
    assert np.all(np.abs(wrong) < SAFE * found.table.sigma_deg)
    assert max(details["hard_iron_sigma"]) < 0.01 * iron.FIELD


def test_iron_of_a_level_platform_is_recovered_except_vertically(tmp_path, rng):
    true = iron.some(rng)
    true.soft[2, :2] = true.soft[:2, 2] = true.hard[2] = 0.0
    motion = iron.level_motion(rng, 3000, tilt_deg=8.0)
    assert 10.0 < np.percentile(np.hypot(motion[:, 1], motion[:, 2]), 99.0) < 14.0
    values = iron.readings(rng, true, motion, noise=0.001)  # low noise must not make the offset seem determined
    found = magnetometer.calibrate([log(tmp_path, values, motion)], {})
    assert found.model == "ellipse" and {"z offset", "S33"} <= set(found.details["undetermined"])
    hard, sigma = (np.array(found.details[k][:2]) for k in ("hard_iron", "hard_iron_sigma"))
    assert np.all(np.abs(hard - true.hard[:2]) < SAFE * sigma)
    assert np.max(sigma) < 0.02 * iron.FIELD


def test_vertical_iron_under_a_mean_tilt_widens_the_uncertainty(tmp_path, rng):
    true = iron.Iron(np.eye(3), np.array([40.0, -25.0, 45.0]), 60.0)
    motion = iron.level_motion(rng, 1500, tilt_deg=2.0) + np.array([0.0, 6.0, 0.0])
    found = magnetometer.calibrate([log(tmp_path, iron.readings(rng, true, motion), motion)], {})
    wrong = np.array(found.details["hard_iron"][:2]) - true.hard[:2]
    sigma = np.array(found.details["hard_iron_sigma"][:2])
    assert wrong[0] == pytest.approx(45.0 * np.sin(np.deg2rad(6.0)), abs=1.0)
    assert sigma[0] > 0.8 * abs(wrong[0]) and sigma[1] < 1.0
    off_deg = off(found.table.deviation_deg, true.deviation(found.table.heading_deg))
    assert np.all(np.abs(off_deg) < 2.5 * found.table.sigma_deg + 0.1)


def test_partial_turn_gives_hard_iron_but_no_soft_iron(tmp_path, rng):
    true = iron.Iron(np.eye(3), np.array([40.0, -25.0, 0.0]), 60.0)
    motion = np.column_stack([np.linspace(0.0, 150.0, 600), np.zeros((600, 2))])
    values = iron.readings(rng, true, motion, noise=0.002)[:, :2]
    found = magnetometer.calibrate([log(tmp_path, values)], {})
    assert found.model == "circle" and {"S11", "S22", "S12"} <= set(found.details["undetermined"])
    assert found.details["soft_iron"] == [[None] * 3] * 3
    assert any("assume that there is none" in warning for warning in found.warnings)
    sigma = np.array(found.details["hard_iron_sigma"][:2])
    assert np.all(np.abs(np.array(found.details["hard_iron"][:2]) - true.hard[:2]) < SAFE * sigma)


def test_modulus_in_another_unit_or_place_is_told(tmp_path, rng):
    true = iron.Iron(np.eye(3), np.array([4.0, -2.5, 0.0]), 60.0)
    motion = iron.level_motion(rng, 600)
    path = log(tmp_path, iron.readings(rng, true, motion)[:, :2])
    path.write_text(path.read_text().replace("x,y", "mag_x_nT,mag_y_nT", 1))
    place = {"horizontal_nT": 0.5 * iron.FIELD, "vertical_nT": 0.0}  # at a dip of 60 degrees
    for factor, told in ((1.0, False), (1.5, True)):
        there = {key: factor * value for key, value in place.items()}
        asked = {"columns": {"x": "mag_x_nT", "y": "mag_y_nT"}, "field": there}
        assert any("nT by IGRF" in text for text in magnetometer.calibrate([path], asked).warnings) == told


def test_the_fit_has_no_noise_bias(rng):
    true, draws = iron.Iron(np.diag([1.08, 0.95, 0.97]), np.array([60.0, -30.0, 45.0]), 60.0), 60
    truth = np.concatenate([true.hard / iron.FIELD, 1.0 / np.diag(true.soft), np.zeros(3)])
    off = []
    for _ in range(draws):
        field = iron.readings(rng, true, iron.tumble(rng, 800), noise=0.05) / iron.FIELD
        data = ScaledReadings(field, np.zeros_like(field))
        off.append(ellipsoid.solve(ELLIPSOID, data, truth[:3])[0] - truth)
    error = np.std(off, axis=0) / np.sqrt(draws)
    assert np.all(np.abs(np.mean(off, axis=0)) < 3.5 * error)  # nine numbers, just over three standard errors


@pytest.mark.parametrize("model", [ELLIPSOID, ELLIPSE], ids=lambda m: m.name)
def test_scores_are_the_gradient_of_the_adjusted_loss(rng, model):
    motion = iron.level_motion(rng, 40, tilt_deg=30.0)
    data = ScaledReadings(rng.normal(size=(40, 3)), iron.turned(motion)[:, :, 2])
    at, s = rng.normal(size=len(model.parameters)), 0.02

    def loss(parameters):
        centre, matrix = np.split(parameters @ model.chain, [3])
        matrix = matrix.reshape(3, 3)
        total = 0.0
        for m, t in zip(data.field, data.down, strict=True):
            squared, v = matrix.T @ (np.eye(3) - np.outer(t, t)) @ matrix, m - centre
            rho = v @ squared @ v - 1.0
            total += (rho - s * np.trace(squared)) ** 2 - 4 * s * np.sum((squared @ v) ** 2)
            total += 2 * s**2 * np.trace(squared @ squared)
        return total / 2.0

    steps = 1e-6 * np.eye(len(at))
    numeric = [(loss(at + step) - loss(at - step)) / 2e-6 for step in steps]
    _, score, _ = ellipsoid.adjusted_scores(model, at, data, s)
    assert score.sum(axis=0) == pytest.approx(np.array(numeric), rel=1e-6, abs=1e-4)


@pytest.mark.parametrize(
    ("to_file", "words"),
    [
        (np.diag([1.0, -1.0, -1.0]), "x forward, y port, z up"),
        (np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]), "x starboard, y forward, z up"),
        (np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), "x port, y forward, z down"),
        (np.diag([1.0, -1.0, 1.0]), "x forward, y port, z down"),
    ],
)
def test_axes_are_identified_from_the_logged_heading(tmp_path, rng, to_file, words):
    true = iron.Iron(np.eye(3), np.array([30.0, -20.0, 0.0]), 65.0)
    motion = iron.level_motion(rng, 1500, tilt_deg=6.0)
    values = iron.readings(rng, true, motion, noise=0.003)
    level = np.einsum("nij,nj->ni", _levelling(motion), values)
    logged = np.rad2deg(np.arctan2(-level[:, 1], level[:, 0])) % 360.0
    path = log(tmp_path, values @ to_file.T, motion, heading_deg=logged)
    found = magnetometer.calibrate([path], {})
    assert found.details["axes"] == f"{words} (from the logged heading)"
    expected = (to_file @ true.hard)[:2]
    sigma = np.array(found.details["hard_iron_sigma"][:2])
    assert np.all(np.abs(np.array(found.details["hard_iron"][:2]) - expected) < SAFE * sigma)
    assert "turn about vertical" not in found.details["undetermined"]


def _levelling(motion: np.ndarray) -> np.ndarray:
    return np.swapaxes(iron.turned(motion * [0.0, 1.0, 1.0]), 1, 2)


def test_misalignment_is_recovered_from_tilts_and_heading(tmp_path, rng):
    true, motion = iron.some(rng), iron.tumble(rng, 3000)
    askew = iron.turned(np.array([[4.0, -2.0, 3.0]]))[0]  # instrument to magnetometer
    values = iron.readings(rng, iron.Iron(true.soft @ askew, true.hard, true.dip_deg), motion, noise=0.003)
    found = magnetometer.calibrate([log(tmp_path, values, motion, heading_deg=motion[:, 0] % 360.0)], {})
    assert not any(name.startswith("turn") for name in found.details["undetermined"])
    raw, corrected = found.points["recorded_deg"], found.points["corrected_deg"]
    steep = np.abs(motion[:, 1]) < 60.0  # headings are ill-defined near the vertical
    assert np.sqrt(np.mean(off(corrected, motion[:, 0])[steep] ** 2)) < 1.5
    assert np.sqrt(np.mean(off(raw, motion[:, 0])[steep] ** 2)) > 5.0


def test_misalignment_is_undetermined_without_tilts_and_heading(tmp_path, rng):
    true = iron.some(rng)
    path = log(tmp_path, iron.readings(rng, true, iron.tumble(rng, 1000)))
    found = magnetometer.calibrate([path], {"field": field_of(true)})
    turns = [f"turn about {name}" for name in ("forward", "starboard", "vertical")]
    assert found.details["undetermined"] == turns


def test_exact_coefficients_and_series_agree_with_the_known_compass():
    true = iron.Iron(np.diag([1.02, 0.98, 1.0]), np.array([12.0, -8.0, 0.0]), 60.0)
    matrix = np.linalg.inv(true.soft)
    parts = np.concatenate([true.hard / iron.FIELD, matrix.ravel()])
    exact = magnetometer.exact_coefficients(parts, np.tan(np.deg2rad(60.0)))
    recorded = np.arange(0.0, 360.0, 7.0)
    wrong = off(magnetometer.exact_deviation(exact, recorded), true.deviation(recorded))
    assert np.max(np.abs(wrong)) < 1e-3
    a, b, c, d, e = magnetometer.series_coefficients(exact)
    # First order of von Appen's eq. (1): B = 57.3 P/H, C = 57.3 Q/H, D = 57.3 (a - e)/2; second order is p^2/2.
    assert [b, c, d] == pytest.approx(np.rad2deg([0.048, -0.032, 0.02]), abs=0.15)
    assert abs(a) < 0.1 and abs(e) < 0.15


def test_iron_stronger_than_the_earth_gives_no_table(tmp_path, rng):
    true = iron.Iron(np.eye(3), np.array([400.0, 0.0, 0.0]), 60.0)
    motion = iron.level_motion(rng, 1000, tilt_deg=0.0)
    found = magnetometer.calibrate([log(tmp_path, iron.readings(rng, true, motion)[:, :2])], {})
    assert "two correct headings" in found.why and found.table is None
    assert np.hypot(*found.exact[1:3]) == pytest.approx(1.6, abs=0.01)
    assert found.details["hard_iron"][0] == pytest.approx(400.0, abs=2.0)


def turning(n: int = 400, radius: float = 200.0) -> np.ndarray:
    towards = np.linspace(0.0, 6 * np.pi, n)
    return np.column_stack([radius * np.cos(towards), -radius * np.sin(towards), 400.0 + np.sin(7.0 * towards)])


def quarters(n: int) -> np.ndarray:
    towards = np.deg2rad(np.repeat([3.0, 93.0, 183.0, 273.0], n))
    return np.column_stack([200 * np.cos(towards), -200 * np.sin(towards)])


@pytest.mark.parametrize(
    ("values", "why"),
    [
        (turning(40), "13 different readings in 40 rows, at least 50"),
        (turning() * [0.0, 1.0, 1.0], "Column x is 0 throughout: the sensor is stuck"),
        (np.repeat(turning(10), 20, axis=0), "3 different readings in 200 rows"),
        (turning() / np.linalg.norm(turning(), axis=1)[:, None], "this is gravity"),
        (turning() / np.linalg.norm(turning(), axis=1)[:, None] * 16384, "16384 throughout: this is gravity"),
        (np.tile([300.0, 50.0, 400.0], (400, 1)) + np.random.default_rng(3).normal(size=(400, 3)), "did not turn"),
        (turning()[:30].repeat(9, axis=0) + np.random.default_rng(3).normal(size=(270, 3)), "at least 120°"),
        (quarters(100) + 0.5 * np.random.default_rng(3).normal(size=(400, 2)), "repeat 4 headings"),
    ],
)
def test_unusable_logs_are_refused_with_the_reason(tmp_path, values, why):
    found = magnetometer.calibrate([log(tmp_path, values)], {})
    assert why in found.why and found.coefficients.size == 0
    assert found.details["hard_iron"] is None and len(found.details["undetermined"]) == 9


def test_zero_tilts_stuck_axis_gaps_and_spikes_are_reported(tmp_path, rng):
    values = turning() + rng.normal(size=(400, 3))
    values[:, 2], values[7, 0], values[20:23, 1] = 400.0, np.nan, 900.0
    path = log(tmp_path, values, np.zeros((400, 3)))
    found = magnetometer.calibrate([path], {})
    said = " ".join(found.warnings)
    assert "1 of 400 rows lack a number" in said and "Column z is 400 throughout" in said
    assert "All tilts are zero" in said and "3 of 399 readings are spikes" in said
    assert found.details["left_out"] == 4 and found.n == 396
    assert np.hypot(*found.details["hard_iron"][:2]) < 1.0


def test_outliers_of_the_modulus_are_left_out_and_counted(tmp_path, rng):
    values = turning() + rng.normal(size=(400, 3))
    values[20:400:50, :2] *= 1.2
    found = magnetometer.calibrate([log(tmp_path, values[:, :2])], {})
    assert "8 of 400 readings are outliers of the fitted modulus" in found.warnings[0]
    assert found.details["noise"] == pytest.approx(1.0, rel=0.15)


def test_withheld_columns_are_not_used(tmp_path, rng):
    true, motion = iron.some(rng), iron.level_motion(rng, 800)
    path = log(tmp_path, iron.readings(rng, true, motion), motion, heading_deg=motion[:, 0] % 360.0)
    found = magnetometer.calibrate([path], {"withhold": ["heading_deg", "pitch_deg", "roll_deg"]})
    assert not {"logged_deg", "pitch_deg", "roll_deg"} & found.points.keys()
    with pytest.raises(InputError, match="expected columns that the calibration can do without"):
        magnetometer.calibrate([path], {"withhold": ["x"]})


@pytest.mark.parametrize("kind", ["sphere", "level", "flat", "refused"])
def test_figure_of_every_outcome_is_drawn(tmp_path, rng, kind):
    motion = iron.tumble(rng, 500) if kind == "sphere" else iron.level_motion(rng, 500)
    values = iron.readings(rng, iron.some(rng), motion)
    values = values[:, :2] if kind == "flat" else values[:20] if kind == "refused" else values
    found = magnetometer.calibrate([log(tmp_path, values, motion if kind == "level" else None)], {})
    table = found.table or DeviationTable(*np.zeros((3, 0)))
    draw(tmp_path / "a.png", StoredCalibration(result.to_json("log", found, {}), table, found.points))
    assert (tmp_path / "a.png").stat().st_size > 5_000
