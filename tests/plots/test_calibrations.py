"""Would catch a figure of a calibration that is missing or illegible."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread

from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import FIGURES, platform, result
from compasslib.calibrations.platform import BenchReadings
from compasslib.calibrations.result import Calibration, DeviationTable
from compasslib.plots import calibrations, deviation
from compasslib.plots.page import DPI, WIDTH_IN
from tests.world.bench import FOLDED, readings, ring
from tests.world.figures import saved

FIELD = {"horizontal_nT": 21299.0, "vertical_nT": 42888.0, "declination_deg": -0.68}
PLACE = {"latitude": -48.4, "longitude": 184.5, "date_s": 1664409600.0, "field": FIELD}
BEND = BenchReadings((ring(36) - 2.0 + 0.03 * ring(36) + 1e-4 * ring(36) ** 2), ring(36))
CASES = {
    "whole": readings(),
    "four": readings(ring(4)),
    "polynomial": BEND,
    "folded": readings(ring(24), FOLDED),
    "one": readings([30.0]),
    "none": readings([]),
}


def shown(made: Calibration) -> StoredCalibration:
    """Return a calibration as read back from its files."""
    said = result.to_json("aqd $2", made, PLACE)
    return StoredCalibration(said, made.table or DeviationTable(*np.zeros((3, 0))), made.points)


@cache
def page(case: str) -> StoredCalibration:
    rows, _ = result.sources({"maker_accuracy_deg": 2.0}, "le_menn")
    return shown(platform.calibrate_readings(CASES[case], rows))


def draw(folder: Path, case: str, figure: str) -> tuple[Path, Figure]:
    path = folder / "a.png"
    return path, saved(lambda: calibrations.draw_figure(figure, path, page(case)))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("figure", FIGURES)
def test_figures_of_every_outcome_are_complete_with_full_size_panels(tmp_path, case, figure):
    path, behind = draw(tmp_path, case, figure)
    image = imread(path)
    assert image.shape[1] == round(WIDTH_IN * DPI) and image[..., :3].std() > 0.02
    assert all(min(axes.bbox.size) >= 0.8 * DPI for axes in behind.axes)


def test_calibration_without_curves_still_has_figures(tmp_path):
    """A calibration may yield a table without coefficients, or neither."""
    for table in (DeviationTable(ring(36), np.full(36, 2.0), np.full(36, 0.3)), None):
        made = Calibration(kind="two_heads", model="offset", n=100, coverage=9, table=table)
        for figure in FIGURES:
            calibrations.draw_figure(figure, tmp_path / "a.png", shown(made))
            assert (tmp_path / "a.png").stat().st_size > 5000


@pytest.mark.parametrize("name", ["R1", "Name_of_a_mooring_that_has_no_gap_anywhere_2007"])
def test_each_record_of_a_shared_compass_has_its_row(tmp_path, name):
    letters, field = dict.fromkeys("ABCDE", 0.05), {"horizontal_nT": 2e4, "vertical_nT": 4e4}
    names = [f"{name} {k}" for k in range(9)]
    records = [{"name": one, "coefficients": letters, "sigma": letters, "fits": True} | field for one in names]
    each = {one: {"values": [2.0, 3.0], "sigma": [0.5, 0.5]} for one in names}
    effect = {"effect": "temperature", "parameters": ["cos_deg", "sin_deg"], "units": ["degrees"] * 2, "each": each}
    iron = dict.fromkeys(("P_nT", "Q_nT", "c", "f", "D", "E"), 0.01)
    content = {"deployments": records, "effects": [effect | {"values": [2.0, 3.0], "sigma": [0.2, 0.2]}]}
    content |= {"rejected": [], "sigma_between": 0.0, "coefficients": iron, "covariance": np.eye(6).tolist()}
    figure = saved(lambda: deviation.draw_shared_coefficients(tmp_path / "a.png", content))
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert len(panels) == 6 and all(a.bbox.width >= 0.3 * figure.bbox.width for a in panels)
    labels = [text.get_window_extent(figure.canvas.get_renderer()) for text in panels[0].get_yticklabels()]
    assert len(labels) == len(names) and not any(a.overlaps(b) for k, a in enumerate(labels) for b in labels[:k])
