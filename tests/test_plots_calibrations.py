"""Figures of calibrations: whole PNGs for every outcome, the same bytes twice, texts that do not overlap."""

from __future__ import annotations

import numpy as np
import pytest
from bench import FOLDED, readings, ring
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread
from matplotlib.text import Annotation

from compasslib.archive.calibrations import Page
from compasslib.calibration import FIGURES, budget, content, curves
from compasslib.calibration.curves import BenchReadings
from compasslib.calibration.result import Calibration, DeviationTable
from compasslib.plots import calibrations
from compasslib.plots import calibrations as plots_certificate
from compasslib.plots.page import DPI, WIDE_IN, WIDTH_IN

FIELD = {"horizontal_nT": 21299.0, "vertical_nT": 42888.0, "declination_deg": -0.68}
PLACE = {"latitude": -48.4, "longitude": 184.5, "date_s": 1664409600.0, "field": FIELD}
BEND = BenchReadings((ring(36) - 2.0 + 0.03 * ring(36) + 1e-4 * ring(36) ** 2), ring(36))
CASES = {
    "whole": readings(),
    "dense": readings(ring(180)),
    "eight": readings(ring(8)),
    "four": readings(ring(4)),
    "half": readings(np.arange(0.0, 180.0, 10.0)),
    "polynomial": BEND,
    "folded": readings(ring(24), FOLDED),
    "one": readings([30.0]),
    "none": readings([]),
}


def shown(made: Calibration) -> Page:
    """Return a calibration as its files give it back."""
    said = content.described("aqd $2", made, PLACE, {})
    return Page(said, made.table or DeviationTable(*np.zeros((3, 0))), made.points)


def page(case: str) -> Page:
    rows = budget.sources({"maker_accuracy_deg": 2.0}, "le_menn")
    return shown(curves.calibration("platform", CASES[case], rows))


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("figure", FIGURES)
def test_every_figure_of_every_outcome_is_a_whole_page_and_the_same_twice(tmp_path, case, figure):
    paths = [tmp_path / f"{k}.png" for k in (1, 2)]
    for path in paths:
        calibrations.draw(figure, path, page(case))
    assert paths[0].read_bytes() == paths[1].read_bytes()
    image = imread(paths[0])
    width_in = WIDE_IN if figure == "certificate" else WIDTH_IN  # a certificate is a page of its own
    assert image.shape[1] == round(width_in * DPI) and image[..., :3].std() > 0.02


@pytest.mark.parametrize("case", CASES)
def test_the_writing_of_a_certificate_stays_on_the_page_and_its_parts_apart(tmp_path, case, monkeypatch):
    drawn, save = [], FigureCanvasAgg.draw

    def keep(canvas, *arguments, **named):
        drawn.append(canvas.figure)
        save(canvas, *arguments, **named)

    monkeypatch.setattr(FigureCanvasAgg, "draw", keep)
    calibrations.certificate(tmp_path / "a.png", page(case))
    figure = drawn[0]
    figure.draw_without_rendering()
    boxes = [
        text.get_window_extent()
        for axes in figure.axes
        for text in axes.texts
        if isinstance(text, Annotation) and text.get_text()
    ]
    height = figure.bbox.height
    assert all(box.y0 >= 0.0 and box.x1 <= figure.bbox.width and box.y1 <= height for box in boxes)
    assert not any(a.overlaps(b) for k, a in enumerate(boxes) for b in boxes[:k])


def test_a_certificate_says_where_when_and_how_sure():
    text = plots_certificate.writing(page("whole"))
    assert "date        2022-09-29" in text.about and "place       48.4000° S, 175.5000° W" in text.about
    assert len(text.table) == 13 and text.table[1].startswith("    0° ")
    assert any(line.startswith("  expanded (k = 2)") for line in text.budget)
    assert "maker accuracy" in "".join(text.budget) and "A constant shift of" in text.notes[0]
    assert plots_certificate.writing(page("one")).table == ["table of deviations: none"]
    assert plots_certificate.writing(page("folded")).about[7] == "exact compass, ± standard"


def test_a_kind_without_curves_still_has_its_figures(tmp_path):
    """Another kind may give a table alone, or nothing but an offset."""
    heading = ring(36)
    table = DeviationTable(heading, np.full(36, 2.0), np.full(36, 0.3))
    made = Calibration(kind="two_heads", model="offset", n=100, coverage=9, table=table)
    for case, made_so in enumerate((made, Calibration(kind="two_heads", model="offset", n=100, coverage=9))):
        for figure in FIGURES:
            calibrations.draw(figure, tmp_path / f"{case}{figure}.png", shown(made_so))
            assert (tmp_path / f"{case}{figure}.png").stat().st_size > 5000
