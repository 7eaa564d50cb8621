"""Would catch a figure that is missing or illegible, a line across a cut, bytes that differ from run to run."""

import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text

from benchmarks.papers import SYNTHETIC_B_DEG, draw_angles, draw_synthetic_curves
from compasslib import angles, compass
from compasslib.archive import files as archive_files
from compasslib.archive import gridded
from compasslib.archive import summary as archive_currents
from compasslib.deviation import assessment
from compasslib.deviation.assessment import build_histograms, directions_at_pairs
from compasslib.deviation.correction import correct
from compasslib.deviation.exact import correct_roots
from compasslib.deviation.likelihood import CELLS
from compasslib.deviation.model import DeviationFit, nearest_root, observed_heading, unfitted
from compasslib.deviation.series import fit_series, series_deviation
from compasslib.plots import deviation, diagnosis, timeseries
from compasslib.plots import moorings as moorings_together
from compasslib.plots import page as plots_page
from compasslib.plots.deviation import deviation_curve
from compasslib.plots.page import BLACK, DPI, WIDE_IN, WIDTH_IN
from compasslib.records import BAD, CorrectedRecord, EarthField, Pairs, Record, take
from compasslib.report.sections import diagnosis_caption
from compasslib.stages import Files
from compasslib.stages import figures as stages
from tests.world.figures import saved
from tests.world.sea import pairs as draw_pairs
from tests.world.sea import record_of

START_S, SAMPLES = 1188864000.0, 700
UNFOLDED, FOLDED = [0.02, 0.3, 0.1, 0.03, -0.02], [0.0, -1.1, 0.7, 0.03, -0.02]
DRAWN = ("deviation", "histograms", "progressive", "roses", "scatter", "sticks")


@dataclass(frozen=True)
class Mooring:
    """Data from which the figures of one mooring are drawn."""

    pairs: Pairs
    fit: DeviationFit
    product: CorrectedRecord

    def draw(self, figure: str, path) -> None:
        pairs, product = self.pairs, self.product
        if figure == "deviation":
            deviation.draw_deviation(path, pairs, self.fit)
        elif figure == "scatter":
            deviation.draw_scatter(path, pairs, product)
        elif figure == "histograms":
            content = assessed("", pairs, self.fit).assessment
            counts = build_histograms(
                product.record, product.heading_corrected_deg, pairs, content["difference_counts"]
            )
            deviation.draw_histograms(path, counts)
        else:
            time_s = product.record.time_s
            velocities = (product.east_recorded + 1j * product.north_recorded, product.east + 1j * product.north)
            flows = [archive_currents.CurrentSeries(time_s, velocity[:, 0]) for velocity in velocities]
            shown, reference = archive_currents.BinCurrents(96.0, *flows), archive_currents.reference_current(pairs)
            if figure == "roses":
                headings = {"recorded": product.record.heading_deg, "corrected": product.heading_corrected_deg}
                timeseries.draw_roses(path, shown, reference, headings)
            else:
                getattr(timeseries, f"draw_{figure}")(path, timeseries.average_currents(shown, reference))


def assessed(name: str, pairs: Pairs, fit: DeviationFit) -> moorings_together.AssessedMooring:
    """Return a mooring as the cruise figures take it, with all pairs treated as held out."""
    heading = np.full(len(pairs), np.nan)
    if fit.fitted:
        heading = nearest_root(correct_roots(fit, pairs.heading_deg), observed_heading(pairs))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assessment, "held_out_headings", lambda plain, made: heading)
        return moorings_together.AssessedMooring(name, fit, assessment.assess_correction(pairs, fit))


def record(pairs: Pairs, samples: int = SAMPLES) -> Record:
    """Make the record of the affected instrument for the same series, in which it dives."""
    depth_m = 100.0 + 80.0 * np.sin(pairs.time_s / 3e5) ** 8
    return take(replace(record_of(pairs), depth_m=depth_m, direction_reference="true"), np.arange(samples))


def exact_fit(coefficients, pairs: Pairs) -> DeviationFit:
    """Build a fit of the exact model from known coefficients, as estimating them takes seconds."""
    habit = 1.0 + np.histogram(observed_heading(pairs), CELLS, (0.0, 360.0))[0]
    return DeviationFit(
        method="exact",
        n_pairs=len(pairs),
        coefficients=np.array(coefficients),
        covariance=np.diag([0.02, 0.04, 0.04, 0.01, 0.01]) ** 2,
        recorded_range_deg=compass.recorded_range(coefficients),
        folded=not compass.turns_full_circle(coefficients),
        heading_density=habit / habit.sum(),
    )


def corrected(recorded: Record, fit: DeviationFit, pairs: Pairs) -> CorrectedRecord:
    field = EarthField(np.array([START_S, START_S + 1e8]), np.zeros(2), *np.full((2, 2), 12000.0), np.zeros(2))
    return correct(recorded, fit, field, pairs)


SMALL, LARGE = (draw_pairs(coefficients, n=SAMPLES, seed=5)[0] for coefficients in (UNFOLDED, FOLDED))
NONE, FEW = take(SMALL, np.zeros(0, dtype=int)), take(SMALL, np.arange(7))
SMALL_FIT, LARGE_FIT = exact_fit(UNFOLDED, SMALL), exact_fit(FOLDED, LARGE)
UNREFERENCED = unfitted("exact", 0)
DEAF = replace(record(SMALL), heading_deg=np.full(SAMPLES, np.nan), depth_m=np.full(SAMPLES, np.nan))
KINDS = {
    "unfolded": (SMALL, SMALL_FIT, record(SMALL)),
    "folded": (LARGE, LARGE_FIT, record(LARGE)),
    "published and folded": (LARGE, fit_series(LARGE), record(LARGE)),
    "no fit and no pairs": (NONE, UNREFERENCED, record(SMALL)),
    "too few pairs": (FEW, unfitted("exact", 7), record(SMALL)),
    "fit from elsewhere": (NONE, replace(LARGE_FIT, n_pairs=0), record(LARGE)),
    "nothing recorded": (NONE, UNREFERENCED, DEAF),
    "one sample": (NONE, UNREFERENCED, record(SMALL, 1)),
    "no sample": (NONE, UNREFERENCED, record(SMALL, 0)),
}


CHECKED = dict.fromkeys(("unfolded", "folded", "published and folded", "no fit and no pairs"), DRAWN) | {
    "too few pairs": ("deviation", "scatter"),
    "fit from elsewhere": ("deviation",),
    "nothing recorded": ("roses", "sticks", "progressive"),
    "one sample": ("sticks",),
    "no sample": ("sticks", "progressive", "roses"),
}


@pytest.fixture(scope="module")
def moorings() -> dict[str, Mooring]:
    return {kind: Mooring(pairs, fit, corrected(own, fit, pairs)) for kind, (pairs, fit, own) in KINDS.items()}


@pytest.fixture(scope="module")
def show(tmp_path_factory, moorings):
    """Return a function that draws a figure of a mooring once and returns its path and Figure."""
    folder = tmp_path_factory.mktemp("figures")

    @cache
    def shown(kind: str, figure: str) -> tuple[Path, Figure]:
        path = folder / kind / f"{figure}.png"
        return path, saved(lambda: moorings[kind].draw(figure, path))

    return shown


def words(figure: Figure) -> str:
    return " ".join(text.get_text().replace("\n", " ") for text in figure.findobj(Text) if text.get_visible())


def boxes(figure: Figure):
    """Return the bounding boxes of the legends and of each panel with its labels, pixels."""
    artists = [*figure.legends, *figure.axes]
    with matplotlib.rc_context(plots_page.STYLE):  # the number of ticks depends on the size of letters
        return [artist.get_tightbbox(figure.canvas.get_renderer()) for artist in artists]


@pytest.mark.parametrize(("kind", "figure"), [(k, each) for k, own in CHECKED.items() for each in own])
def test_figure_is_whole_and_legible(kind, figure, show):
    check_page(*show(kind, figure))


def residuals(covariate: str, low: float, high: float) -> dict:
    """Return binned residuals in the form of diagnosis.json."""
    centre = np.linspace(low, high, 12)
    wave = 3.0 * np.sin(centre / (high - low) * 6.0)
    return {
        "covariate": covariate,
        "centre": centre.tolist(),
        "before_deg": wave.tolist(),
        "after_deg": (0.2 * wave).tolist(),
        "sigma_deg": np.full(12, 0.4).tolist(),
    }


def test_diagnosis_figure_shows_effects_and_held_out_slope(tmp_path):
    """A panel with the held-out slope and its wedge, sizes before and after a date, a row of held-out sizes."""
    slope, placebo = {"value": 0.5, "low": -0.25, "high": 1.25}, {"n": 19, "rank_p": 0.15}
    size = {"fitted_elsewhere": 2.0, "held_out": 1.0, "low": -0.5, "high": 2.5}
    proof = {"rms_before_deg": 4.0, "rms_after_deg": 3.0, "amplitude_deg": size, "slope": slope, "placebo": placebo}
    found = {"effect": "temperature", "alternatives": [], "text": "", "heldout": proof}
    found["when"] = {"from": "2007-12-04T00:00:00Z", "to": None}
    dated = residuals("size_of_temperature", START_S, START_S + 3e7)
    curves = [residuals("turn_by_temperature", -2.0, 4.0), residuals("heading", 5.0, 355.0), dated]
    content = {"verdict": "ambiguous", "findings": [found], "unexplained": None, "curves": curves}
    page = saved(lambda: diagnosis.draw_diagnosis(tmp_path / "d.png", content, dated=True))
    check_page(tmp_path / "d.png", page)
    turn, heading, sized, held_out = page.axes
    assert sized.get_title("left") == "(c) temperature" and "date of the change" in words(page)
    assert "slope 0.50 (−0.25 to 1.25), better predicted than 17 of 19" in turn.get_title("left").replace("\n", " ")
    assert heading.get_title("left") == "(b) residual" and held_out.get_xlabel() == "Size (° rms)"
    (wedge,) = turn.collections[0].get_paths()
    assert {(-2.0, 0.5), (-2.0, -2.5), (4.0, -1.0), (4.0, 5.0)} <= {tuple(point) for point in wedge.vertices.round(9)}
    assert "25 of 36 bins outside the 95 % range of noise without, 0 with correction" in diagnosis_caption(content)


LONG = "the deviation of a compass whose gimbal sticks at the temperature of the water changing with the echo"


def test_diagnosis_of_many_effects_with_long_names_is_legible(tmp_path):
    proof = {"rms_before_deg": 4.0, "rms_after_deg": 3.0, "p_value": 0.001}
    found = [{"effect": LONG, "side": "compass", "alternatives": [], "text": "", "heldout": proof}] * 14
    curves = [residuals(("heading", "speed", "time")[k % 3], 5.0, 355.0) | {"compared": LONG} for k in range(6)]
    content = {"verdict": "explained", "findings": found, "unexplained": None, "curves": curves}
    page = saved(lambda: diagnosis.draw_diagnosis(tmp_path / "d.png", content, dated=False))
    check_page(tmp_path / "d.png", page)
    assert all(axes.bbox.width >= 0.45 * page.bbox.width for axes in page.axes)
    renderer = page.canvas.get_renderer()
    for axes in page.axes[6:]:
        # The extent of a text includes a margin of one or two pixels.
        names = [text.get_window_extent(renderer).padded(-1.0) for text in axes.get_yticklabels()]
        assert not any(a.overlaps(b) for a, b in pairwise(sorted(names, key=lambda box: box.y0)))


@pytest.mark.parametrize(("covariate", "dated"), [("heading", True), ("time", True), ("time", False), ("speed", False)])
def test_nothing_is_drawn_where_there_are_no_data(tmp_path, dated, covariate):
    """Bins from 5 to 95 and from 265 to 355: neither the band nor the effect spans the gap of 170."""
    scale = {"heading": 1.0, "time": 86400.0, "speed": 0.01}[covariate]
    curve = residuals(covariate, 5.0, 355.0)
    curve["centre"] = (scale * np.r_[5.0:96.0:18.0, 265.0:356.0:18.0]).tolist()
    content = {"verdict": "explained", "findings": [], "unexplained": None, "curves": [curve]}
    (axes,) = saved(lambda: diagnosis.draw_diagnosis(tmp_path / "d.png", content, dated=dated)).axes
    drawn = scale / {"time": 86400.0 if dated else 3600.0}.get(covariate, 1.0)
    begin = drawn * 5.0 if covariate == "time" and not dated else 0.0
    bars = [(bar.get_x() + begin, bar.get_x() + begin + bar.get_width()) for bar in axes.patches]
    assert len(bars) == 12 and not any(high > drawn * 123.0 and low < drawn * 237.0 for low, high in bars)
    (effect,) = (line for line in axes.lines if line.get_color() == BLACK)
    assert np.isnan(effect.get_ydata()).sum() == 1 and np.isnan(effect.get_ydata()[6])


@pytest.mark.parametrize("span_s", np.geomspace(2.0, 4e8, 30))
def test_date_axis_has_two_to_seven_ticks(span_s):
    axes = Figure(figsize=(3.5, 2.0)).subplots()
    plots_page.dates(axes, (START_S, START_S + span_s))
    assert 2 <= len(axes.get_xticks()) <= 7


def test_scatter_titles_state_count_mean_and_rms(show, moorings):
    before, after = (axes.get_title("left") for axes in show("unfolded", "scatter")[1].axes[:2])
    product = moorings["unfolded"].product
    times = product.record.time_s
    lower, upper, corrected = directions_at_pairs(SMALL, times, product.heading_corrected_deg)
    for title, name, above in ((before, "(a) recorded", upper), (after, "(b) corrected", corrected)):
        off = angles.difference(above, lower)
        mean = float(angles.wrap180(angles.mean(off)))
        said = f"{name}, n = {SAMPLES}\nmean {mean:+.1f}°, rms {np.sqrt(np.mean(off**2)):.1f}°"
        assert title == said.replace("-", "\N{MINUS SIGN}")


def check_page(path, page):
    """Check that a figure suits a column of print and a phone: size, fonts, labelled axes, nothing clipped.

    On a phone 360 pixels wide, its letters (at least 8 points at a width of 3.5 inches) are 10 pixels or larger.
    """
    pixels = imread(path)
    assert pixels.shape[1] == round(WIDTH_IN * DPI)
    assert pixels[..., :3].min() < 0.5 < pixels[..., :3].mean()
    assert all(text.get_fontsize() >= 8.0 for text in page.findobj(Text) if text.get_text())
    named = [axes for axes in page.axes if any(label.get_text() for label in axes.get_xticklabels())]
    assert all(
        axes.get_xlabel() or page._supxlabel or axes.get_shared_x_axes().get_siblings(axes)[1:] for axes in named
    )
    standing = boxes(page)
    for i, box in enumerate(standing):
        assert box.x0 >= -1 and box.y0 >= -1 and box.x1 <= page.bbox.x1 + 1 and box.y1 <= page.bbox.y1 + 1
        for other in standing[i + 1 :]:
            assert not box.padded(-1).overlaps(other.padded(-1))


@pytest.mark.parametrize("kind", ["unfolded", "folded", "published and folded"])
def test_no_curve_crosses_the_cut_of_an_axis(kind, show):
    _, page = show(kind, "deviation")
    lines = [line for axes in page.axes for line in axes.lines if line.get_linestyle() == "-"]
    curves = [line.get_xydata() for line in lines if len(line.get_xdata()) > 1000]
    assert len(curves) >= 3
    assert max(np.nanmax(np.abs(np.diff(curve, axis=0))) for curve in curves) < 20.0


def array_row(name: str) -> dict:
    """Describe a mooring with a profiler, which has no nominal depth."""
    instruments = [{"depth_m": 100.0, "orientation": "up", "role": "affected"},
                   {"depth_m": None, "orientation": None, "role": "reference"}]  # fmt: skip
    place = {"latitude": 65.0 + 0.1 * len(name), "longitude": 180.0 - 0.2 * len(name)}
    return {"name": name, **place, "water_depth_m": 300.0, "instruments": instruments}


@pytest.mark.parametrize("copies", [0, 2, 9])
@pytest.mark.parametrize("figure", ["map", "array", "curves", "differences", "currents"])
def test_cruise_figures_name_moorings_only_if_few(figure, copies, tmp_path):
    """With no mooring, with a few, and with more than can be named."""
    kinds = ("unfolded", "folded", "published and folded", "too few pairs", "no fit and no pairs")
    cruise = [assessed(f"{kind} {k}", *KINDS[kind][:2]) for k in range(copies) for kind in kinds]
    rows = [array_row(mooring.name) for mooring in cruise] if figure in ("map", "array") else cruise
    page = saved(lambda: getattr(moorings_together, f"draw_{figure}")(tmp_path / "a.png", rows))
    shown = {mooring.name for mooring in cruise if mooring.fit.fitted or figure != "curves"}
    shown -= {name for name in shown if name.startswith("no fit") and figure not in ("map", "array")}
    named = {name for name in shown if name in words(page)}
    assert named == (shown if 0 < len(shown) <= moorings_together.NAMED else set())
    assert copies or "no data" in words(page)
    standing = boxes(page)
    assert all(box.x0 >= -1 and box.y0 >= -1 and box.x1 <= page.bbox.x1 + 1 for box in standing)


def test_synthetic_curves_and_angles_match_the_published_figures(tmp_path):
    """Von Appen 2015, Fig. 5: the deviation at 90° is B; for B above 57.3° only the sluggish side is inverted."""
    synthetic = saved(lambda: draw_synthetic_curves(tmp_path / "curves.png"))
    for line, b in zip(synthetic.axes[0].get_lines()[::2], SYNTHETIC_B_DEG, strict=True):
        assert np.interp(90.0, *np.transpose(line.get_xydata())) == pytest.approx(b, abs=0.01)
    spans = [np.ptp(line.get_xdata()) for line in synthetic.axes[2].get_lines()]
    assert min(spans[:4]) > 350.0 and max(spans[4:]) < 120.0
    sketch = words(saved(lambda: draw_angles(tmp_path / "angles.png")))
    assert all(name in sketch for name in ("α", "β", "γ", "δ", "magnetic north", "current"))


def test_section_masks_the_reference_in_recorded_and_draws_its_profiles_as_columns(tmp_path):
    """Of 40 hours the reference at 300 m has every eighth; it is not corrected, and reaches half-way to the next."""
    flow = np.full((40, 2), 0.1 + 0.2j)
    flow[np.arange(40) % 8 != 7, 1] = complex(np.nan, np.nan)
    affected = np.where([True, False], flow, complex(np.nan, np.nan))
    nothing = gridded.MeanProfile(flow[0], *np.zeros((3, 2)))
    section = gridded.SectionMeans(
        START_S + 3600.0 * np.arange(41.0), np.array([100.0, 300.0]), affected, flow, affected, np.full(40, 2.0),
        (nothing, nothing), (np.zeros(2), np.zeros(2)), np.array([0.0, 1.0]),
    )  # fmt: skip
    page = saved(lambda: timeseries.draw_section(tmp_path / "s.png", section))
    assert imread(tmp_path / "s.png").shape[1] == round(WIDE_IN * DPI)
    cells = {axes.get_title("left")[4:]: axes.collections[0].get_array() for axes in page.axes[:6]}
    for name in ("U, recorded", "V, corrected minus recorded"):
        assert len(cells[name]) == 1 and np.isfinite(cells[name]).all()  # the reference is left out
    assert np.isfinite(cells["V, corrected"][1]).sum() == 37  # nothing is drawn long before the first profile


def test_pdf_is_reproducible_with_large_scatters_rasterized(moorings, tmp_path):
    for name in ("a", "b"):
        moorings["folded"].draw("deviation", tmp_path / f"{name}.pdf")
    content = (tmp_path / "a.pdf").read_bytes()
    assert content == (tmp_path / "b.pdf").read_bytes() and content.startswith(b"%PDF")
    assert content.count(b"/Subtype /Image") >= 1


def test_figures_do_not_depend_on_rcparams(moorings, show, tmp_path):
    first, _ = show("folded", "deviation")
    with matplotlib.rc_context({"font.size": 20.0, "axes.grid": True, "savefig.bbox": "tight"}):
        before = dict(matplotlib.rcParams)
        moorings["folded"].draw("deviation", tmp_path / "b.png")
        assert dict(matplotlib.rcParams) == before
    assert first.read_bytes() == (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize(
    ("kind", "figure", "word"),
    [
        ("no fit and no pairs", "deviation", "no data"),
        ("too few pairs", "scatter", "no pairs"),
        ("nothing recorded", "roses", "no data"),
        ("no sample", "sticks", "no data"),
    ],
)
def test_panel_without_data_says_so(kind, figure, word, show):
    assert word in words(show(kind, figure)[1])


def test_stick_and_progressive_vectors_are_mean_currents():
    """One knot to the east for a day is 44 km; a gap in one series is omitted from both displacements."""
    time_s = START_S + 3600.0 * np.arange(96.0)
    east = np.full(96, 0.514444 + 0.0j)
    gap = np.where(np.arange(96) < 24, np.nan, 1j * east.real)
    shown = archive_currents.BinCurrents(
        50.0, archive_currents.CurrentSeries(time_s, east), archive_currents.CurrentSeries(time_s, gap)
    )
    drawn = timeseries.average_currents(shown, archive_currents.CurrentSeries(np.zeros(0), np.zeros(0, complex)))
    assert drawn.hours == 1.0 and set(drawn.means) == {"recorded", "corrected"}
    ways = timeseries.displacements(drawn)
    assert ways["recorded"][-1] == pytest.approx(3 * 44448.0, rel=1e-4) and len(ways["recorded"]) == 73
    assert ways["corrected"][-1] == pytest.approx(3j * 44448.0, rel=1e-4)
    before, after = shown.mean
    assert before == pytest.approx(0.514444) and after == pytest.approx(0.514444j)
    year = archive_currents.CurrentSeries(START_S + 86400.0 * np.arange(401.0), np.ones(401, complex))
    assert timeseries.average_currents(archive_currents.BinCurrents(50.0, year, year), year).hours == 24.0


def test_displayed_bin_is_the_nearest_with_enough_samples(tmp_path, moorings):
    """The nearest of three bins has a fifth of its samples flagged bad, so the second is shown."""
    one = moorings["unfolded"].product
    quality = np.ones((SAMPLES, 3), dtype=np.int8)
    quality[: SAMPLES // 5, 0] = BAD
    with archive_files.create_netcdf(tmp_path / "c.nc") as nc:
        nc.createDimension("TIME", SAMPLES)
        nc.createDimension("BIN", 3)
        nc.createVariable("TIME", "f8", "TIME")[:] = one.record.time_s / 86400.0 + 7305.0
        for k, name in enumerate(("UCUR", "VCUR", "UCUR_RECORDED", "VCUR_RECORDED", "DEPTH")):
            values = np.broadcast_to(10.0 * k + np.arange(3.0), (SAMPLES, 3))
            nc.createVariable(name, "f8", ("TIME", "BIN"))[:] = values
            nc.createVariable(f"{name}_QC", "i1", ("TIME", "BIN"))[:] = quality
    shown = archive_currents.read_bin_currents(tmp_path / "c.nc")
    assert shown.depth_m == 41.0 and shown.mean == (21.0 + 31.0j, 1.0 + 11.0j)
    np.testing.assert_allclose(shown.recorded.time_s, one.record.time_s, atol=1e-5)


def test_pyplot_is_not_imported():
    code = "import sys, compasslib.plots.deviation; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


ANGLES = st.floats(-1000.0, 1000.0)
IRON = st.tuples(*(st.floats(-low, low) for low in (0.3, 2.0, 2.0, 0.3, 0.3)))


@given(IRON, ANGLES)
@settings(max_examples=40, deadline=None)
def test_deviation_curve_matches_the_compass_over_one_turn(iron, begin):
    for method, coefficients in (("exact", iron), ("von_appen", 60.0 * np.array(iron))):
        fit = DeviationFit(method, 0, coefficients=np.array(coefficients))
        curve = deviation_curve(fit, begin, [])
        assert curve.heading_deg[0] == begin and curve.heading_deg[-1] == pytest.approx(begin + 360.0)
        if method == "exact":
            expected = compass.recorded_heading(coefficients, curve.heading_deg)
        else:
            expected = curve.heading_deg - series_deviation(coefficients, curve.heading_deg)
        np.testing.assert_allclose(angles.difference(curve.recorded_deg, expected), 0.0, atol=1e-6)
        assert np.abs(np.diff(curve.deviation_deg)).max() <= 180.0
        assert -180.0 <= np.median(curve.deviation_deg) < 180.0 + 1e-6


@given(ANGLES, st.floats(5.0, 300.0), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_circular_axis_is_cut_in_the_largest_gap(begin, width, seed):
    angle = begin + width * np.random.default_rng(seed).random(300)
    cut = plots_page.emptiest(np.append(angle, np.nan))
    assert -180.0 <= cut < 180.0 and cut % 10.0 == 0.0 and plots_page.emptiest([]) == -180.0
    assert float(angles.wrap360(cut - begin)) >= width - 10.0 or float(angles.wrap360(cut - begin)) < 10.0


def test_sector_shares_ignore_missing_angles():
    shares = plots_page.sectors([5.0, 365.0, np.nan, 355.0, 725.0], -10.0)
    assert shares.shape == (36,) and shares[0] == 25.0 and shares[1] == 75.0
    assert plots_page.sectors([np.nan], 0.0).sum() == 0.0


def test_headings_flagged_bad_are_not_counted():
    five = corrected(record(SMALL, 5), SMALL_FIT, NONE)
    flagged = replace(five.record, heading_quality=np.array([1, BAD, 1, 2, 3], dtype=np.int8))
    usable = plots_page.usable_headings(replace(five, record=flagged))
    assert np.isfinite(usable).tolist() == [True, False, True, True, True]


def test_figures_that_are_no_longer_asked_for_are_deleted(tmp_path):
    """The report would show those of earlier results."""
    (tmp_path / "figures").mkdir()
    for name in ("map.png", "map.pdf", "curves.png", "mine.png"):
        (tmp_path / "figures" / name).touch()
    files = Files(
        usable=f"{tmp_path}/usable.json", deviations=[], assessments=[], figures=[f"{tmp_path}/figures/map.png"]
    )
    stages.cruise_figures(files, print, array=[])
    assert {path.name for path in (tmp_path / "figures").iterdir()} == {"map.png", "mine.png"}
