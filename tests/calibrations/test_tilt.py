"""Would catch a tilt sensor's polynomial, sign, axis or uncertainty that is wrong."""

import numpy as np
import pytest
from PIL import Image

from compasslib import calibrations, earthfield
from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import platform, result
from compasslib.calibrations.platform import BenchReadings
from compasslib.calibrations.result import DeviationTable
from compasslib.inference import kinds
from compasslib.inference.comparison import Options
from compasslib.plots import calibrations as plots
from compasslib.report import words

STEPS = np.arange(-20.0, 20.1, 2.5)
TRUE = {"pitch": (0.8, 0.03), "roll": (-0.5, -0.02)}  # correction: degrees, and fraction of the recorded tilt
BREST = {"latitude": 48.4, "longitude": -4.5, "date_s": 1664409600.0}


def bench(rng, noise_deg=0.1, sign=1.0):
    """Return rows of reference tilt, pitch and roll: one run along each axis."""
    rows = []
    for k, (a, b) in enumerate(TRUE.values()):
        recorded = (STEPS - a) / (1.0 + b) + rng.normal(0.0, noise_deg, len(STEPS))
        offset = -list(TRUE.values())[1 - k][0]
        both = np.stack([recorded, offset + rng.normal(0.0, noise_deg, len(STEPS))])
        rows.append(np.stack([sign * STEPS, *(both if k == 0 else both[::-1])]))
    return np.concatenate(rows, axis=1)


def calibrated(tmp_path, rows, **settings):
    path = tmp_path / "tilts.csv"
    lines = [",".join(f"{x:.3f}" for x in row) for row in np.transpose(rows)]
    path.write_text("\n".join([",".join(platform.TILT_ROLES), *lines]) + "\n")
    return calibrations.calibrate("tilt", [path], settings)


@pytest.mark.parametrize("sign", [1.0, -1.0, np.sign(STEPS)], ids=["signed", "other sense", "sizes"])
def test_both_axes_are_recovered_for_any_sign_of_the_reference(tmp_path, sign):
    made = calibrated(tmp_path, bench(np.random.default_rng(1), sign=sign), budget="le_menn", **BREST)
    for axis, (a, b) in TRUE.items():
        fit = made.details["axes"][axis]
        found, sigma = list(fit["coefficients"].values()), np.sqrt(np.diag(fit["covariance"]))
        assert fit["form"] == "cubic" and np.all(np.abs(np.subtract(found, (a, b, 0.0, 0.0))) < 3.5 * sigma)
        assert abs(fit["max_error_deg"]) == pytest.approx(abs(a) + 20.0 * abs(b), abs=0.25)
        assert fit["expanded_deg"] == pytest.approx(np.hypot(0.384, 2.0 * 0.1), abs=0.08)
    page = result.to_json("tilts", made, earthfield.resolve_settings(BREST))
    assert set(page["uncertainty"]["rows"]) == {"slope_deg", "ruggedness_deg", "protractor_deg", result.FIT_RESIDUAL}
    assert any("sign" in text for text in made.warnings) != np.array_equal(sign, 1.0)


@pytest.mark.parametrize("factor", [1.0, 10.0])
def test_tilts_in_another_unit_are_told(tmp_path, factor):
    rows = bench(np.random.default_rng(1)) * np.array([[1.0], [factor], [factor]])
    assert any("check the unit of both" in text for text in calibrated(tmp_path, rows).warnings) == (factor > 1.0)


def test_oblique_and_short_runs_are_reported(tmp_path):
    foreign = calibrated(tmp_path, bench(np.random.default_rng(2)), uncertainty={"graduation_deg": 0.1})
    assert any("not of kind tilt are excluded from the budget" in text for text in foreign.warnings)
    skew = calibrated(tmp_path, [STEPS, 0.7 * STEPS, 0.7 * STEPS])
    assert "no reading leans this axis alone" in skew.why and any("tilt one axis at a time" in x for x in skew.warnings)
    assert result.to_json("x", skew, {})["uncertainty"]["expanded_deg"] is None
    few = calibrated(tmp_path, [[0.0, 10.0], [0.5, 10.4], [0.0, 0.0]])
    assert "2 coefficients need at least 3" in few.why


def test_stated_intervals_cover_the_truth():
    """With 300 platforms; benchmarks/calibrations.py simulates 1000."""
    rng, inside = np.random.default_rng(3), []
    for _ in range(300):
        reads = {axis: BenchReadings(STEPS, (STEPS - a) / (1 + b) + rng.normal(0, 0.1, 17))
                 for axis, (a, b) in TRUE.items()}  # fmt: skip
        made = platform.calibrate_axes(reads, ())
        for axis, (a, b) in TRUE.items():
            table = made.details["axes"][axis]["table"]
            off = table["correction_deg"] - a - b * table["recorded_deg"]
            inside.append(np.mean(np.abs(off) <= 1.96 * table["sigma_deg"]))
    assert 0.93 < np.mean(inside) < 0.975


@pytest.mark.parametrize("whole", [True, False])
def test_figure_page_and_diagnosis_of_a_tilt(tmp_path, whole):
    rows = bench(np.random.default_rng(4))
    made = calibrated(tmp_path, rows if whole else rows[:, :2], budget="le_menn")
    page = result.to_json("tilts", made, {})
    path = tmp_path / "tilt.png"
    plots.draw_figure("tilt", path, StoredCalibration(page, DeviationTable(*np.zeros((3, 0))), made.points))
    assert np.ptp(np.asarray(Image.open(path))) > 0
    table = words.cells("calibration", "tilts", c=page)
    assert len(table) == (2 + 2 * 8 if whole else 0)  # every 5 degrees from -20 to 15
    diagnosed = kinds.diagnose("tilt", [tmp_path / "tilts.csv"], {}, Options())
    assert diagnosed.verdict == "insufficient" and "no headings" in diagnosed.why
