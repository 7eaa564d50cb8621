"""What every figure stands on: width, style, colours, axes in degrees and dates, legend, and the file itself.

A figure is as wide as one column of print, so that its letters can be read on a phone too. Its caption is not in it:
the report says in HTML what it shows.
"""

from __future__ import annotations

import re
import textwrap
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import Collection, QuadMesh
from matplotlib.dates import DAILY, HOURLY, MINUTELY, MONTHLY, SECONDLY, AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.textpath import text_to_path
from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter, MultipleLocator
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from compasslib import angles, compass
from compasslib.archive.files import atomic_write
from compasslib.deviation.model import DeviationFit, observed_deviation, observed_heading
from compasslib.deviation.series import inverse_table, series_design, series_deviation
from compasslib.records import BAD, CorrectedRecord, Pairs
from compasslib.types import Floats

Limits = tuple[float, float]

WIDTH_IN, WIDE_IN, DPI = 3.5, 7.0, 200  # one column of print, and two
LINE_IN = 0.16  # height of a line of a name
WORD_IN = 1.8  # widest word of a title
LETTERS = FontProperties(family="DejaVu Sans", size=8.0)
COLLAPSED = "constrained_layout not applied"  # matplotlib's warning where labels leave a panel no room
MAX_VECTORS = 2000  # points or lines of one kind that a PDF draws as such
DAY_S = 86400.0  # matplotlib counts time in days since 1970
DEFLATE = 3  # of the PNG: half the time of the usual 6, and without the alpha channel still fewer bytes
# Colours that the colour-blind can tell apart (Okabe and Ito 2008).
BLACK, GREY = "#000000", "#8C8C8C"
ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
RECORDED, CORRECTED, REFERENCE = ORANGE, BLUE, GREY
STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "figure.titlesize": 9.0,
    "figure.constrained_layout.wspace": 0.06,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.0,
    "legend.handletextpad": 0.6,
    "lines.linewidth": 1.3,
    "text.parse_math": False,  # a dollar in a mooring's name is a dollar
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}
MAGNETIC, TRUE = "(° magnetic)", "(° true)"


@contextmanager
def page(path: str | Path, height_in: float, *, width_in: float = WIDTH_IN, title: str = "") -> Iterator[Figure]:
    """Give an empty figure that becomes a PNG or PDF once the block has ended well, with the same bytes each time.

    Panels get letters where there are several; titles and names of axes that are too long are broken into lines.

    Args:
        title: of a figure that is handed on by itself.

    Raises:
        UserWarning: the labels leave a panel no room.
    """
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a user's own matplotlibrc does not count
        matplotlib.rcParams.update(STYLE)
        layout = ConstrainedLayoutEngine()
        figure = Figure(figsize=(width_in, height_in), dpi=DPI, layout=layout)
        canvas = FigureCanvasAgg(figure)
        if title:
            figure.suptitle(title)
        yield figure
        panels = [
            axes for axes in figure.axes if axes.get_visible() and axes.axison and axes.get_label() != "<colorbar>"
        ]
        for letter, axes in zip("abcdefghijklmnopqrstuvwxyz", panels if len(panels) > 1 else (), strict=False):
            axes.set_title(f"({letter}) {axes.get_title('left')}".rstrip())
        for axes in figure.axes:
            for text in (axes.title, axes._left_title, axes.xaxis.label, axes.yaxis.label):  # type: ignore[attr-defined]
                text.set_text(re.sub(r"\S+", lambda word: wrapped(word[0], WORD_IN), text.get_text()))
                text.set_wrap(True)
        # What savefig does, without its first drawing of all artists, which serves the layout alone.
        with warnings.catch_warnings():
            warnings.filterwarnings("error", COLLAPSED)
            layout.execute(figure)
        figure.set_layout_engine("none")
        if Path(path).suffix == ".pdf":
            for artist in figure.findobj(Collection):  # clouds of points and long lists of lines are pixels in it
                # The cells of a mesh are counted by its values: to make a path of each takes long.
                counts = [np.asarray(artist.get_array()).size, len(np.asarray(artist.get_offsets()))]
                counts += [] if isinstance(artist, QuadMesh) else [len(artist.get_paths())]
                artist.set_rasterized(max(counts) > MAX_VECTORS)
            with atomic_write(path) as temporary:
                figure.savefig(temporary, format="pdf", metadata={"CreationDate": None})
            return
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # the page is opaque
        with atomic_write(path) as temporary:
            Image.fromarray(np.ascontiguousarray(pixels)).save(temporary, "PNG", dpi=(DPI, DPI), compress_level=DEFLATE)


def wrapped(text: str, width_in: float) -> str:
    """Break a text into lines no wider than a width, words only where they must be."""
    if _width_in(text) <= width_in:
        return text
    tries = (textwrap.wrap(text, characters) for characters in range(len(text), 0, -1))
    return "\n".join(
        next(lines for lines in tries if max(map(_width_in, lines)) <= width_in or len(lines) == len(text))
    )


def _width_in(line: str) -> float:
    return float(text_to_path.get_text_width_height_descent(line, LETTERS, ismath=False)[0]) / 72.0


@dataclass(frozen=True)
class Rows:
    """Rows of a panel from the top down, each as high as the lines of its name."""

    names: Sequence[str]
    width_in: float = 1.1  # of the longest line

    @cached_property
    def wrapped(self) -> list[str]:
        """The names in lines."""
        return [wrapped(name, self.width_in) for name in self.names]

    @cached_property
    def _ends(self) -> Floats:
        return np.cumsum([0.0, *(1.0 + 1.2 * name.count("\n") for name in self.wrapped)])

    @property
    def places(self) -> Floats:
        """The middle of each row, lines from the top, (n,)."""
        return (self._ends[1:] + self._ends[:-1]) / 2.0

    @property
    def height_in(self) -> float:
        """The height of the panel without its axis."""
        return LINE_IN * float(self._ends[-1])

    def name(self, axes: Axes) -> None:
        """Write the names beside the vertical axis."""
        axes.set_yticks(self.places, self.wrapped, multialignment="right")
        axes.set_ylim(float(self._ends[-1]), 0.0)


def dates(axes: Axes, span_s: Limits | None = None, *, most: int = 6) -> None:
    """Set limits and ticks of a horizontal axis in days since 1970.

    Args:
        span_s: first and last time, seconds since 1970; the limits stay where absent.
        most: ticks, at most.
    """
    if span_s is not None:
        first, last = span_s
        pad = max(0.01 * (last - first), 1.0)
        axes.set_xlim((first - pad) / DAY_S, (last + pad) / DAY_S)
    locator = AutoDateLocator(minticks=3, maxticks=most)
    # Its own steps end where those of the next unit are still too few, and it warns: at 2.5 to 3 hours or years.
    longest = {SECONDLY: 60, MINUTELY: 60, HOURLY: 24, DAILY: 31, MONTHLY: 12}
    locator.intervald |= {unit: [*locator.intervald[unit], step] for unit, step in longest.items()}
    locator.set_axis(axes.xaxis)
    ticks, words = locator(), ConciseDateFormatter(locator)
    labels = FixedFormatter(words.format_ticks(ticks))
    labels.set_offset_string(words.get_offset())
    # Sought and worded once, not at each look of the layout.
    axes.xaxis.set(major_locator=FixedLocator(ticks), major_formatter=labels)
    axes.set_xlabel("Date (UTC)")


def degrees(axis: Axis, limits: Limits, *, as_is: bool = False) -> None:
    """Set limits and ticks of an axis in degrees; headings are labelled 0 to 359, and 360 at the end of a turn from 0.

    Args:
        limits: degrees.
        as_is: label deviations as they are.
    """
    span = limits[1] - limits[0]
    if as_is:  # three ticks at least: zero alone is no scale
        step = next((each for each in (90.0, 45.0, 30.0, 15.0, 10.0, 5.0) if span >= 3.0 * each), 2.0)
    else:
        step = 90.0 if span > 150.0 else 45.0 if span > 110.0 else 30.0 if span > 75.0 else 15.0
    if isinstance(axis, XAxis):
        axis.axes.set_xlim(limits)
    else:
        axis.axes.set_ylim(limits)
    axis.set_major_locator(MultipleLocator(step))
    whole_turn = limits == (0.0, 360.0)
    axis.set_major_formatter(FuncFormatter(lambda x, _: signed(x, ".0f") if as_is else _heading(x, whole_turn)))


def signed(x: float, form: str = "+.1f") -> str:
    """Format a number with the minus sign of print."""
    return f"{x:{form}}".replace("-", "\N{MINUS SIGN}")


def _heading(x: float, whole_turn: bool) -> str:
    return "360" if whole_turn and x == 360.0 else f"{float(angles.wrap360(round(x))):.0f}"


def span_of(points: Floats, line: Floats, *, least: float = 60.0) -> Limits:
    """Find limits that hold a whole line and 98 % of the points, degrees.

    Args:
        points: (n,) degrees, perhaps none.
        line: (k,) degrees, perhaps none.
    """
    finite = points[np.isfinite(points)]
    ends = np.concatenate([line[np.isfinite(line)], np.percentile(finite, (1.0, 99.0)) if finite.size else []])
    if not ends.size:
        return -180.0, 180.0
    low, high = float(ends.min()), float(ends.max())
    half = max((high - low) * 0.53, least / 2.0)
    return (low + high) / 2.0 - half, (low + high) / 2.0 + half


def empty(axes: Axes, words: str = "no data") -> None:
    """State in a word or two that a panel has nothing to show, and take its ticks away."""
    axes.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color="#444444")


def legend(figure: Figure, handles: Sequence[Artist], *, columns: int = 2) -> None:
    """Put one legend under all panels, where it covers nothing.

    Args:
        columns: at most.
    """
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, len(handles)))


STEP_DEG = 0.25  # along a curve
SECTOR_DEG = 10.0  # of a histogram
GAP_WIDTH_DEG = 25.0  # over which a circle's occupation is smoothed before its gap is sought
INVERTED, BACKWARDS, GIVEN_UP = 0, 1, 2  # stretches of a curve


@dataclass(frozen=True)
class DeviationByHeading:
    """A deviation along one turn of the correct heading, continuous: nothing in it jumps by 360 degrees."""

    heading_deg: Floats  # (n,) correct heading, increasing
    deviation_deg: Floats  # (n,)
    sigma_deg: Floats  # (n,) of the deviation, from the coefficients' covariance; NaN where that is unknown
    stretch: NDArray[np.int_]  # (n,) INVERTED, BACKWARDS or GIVEN_UP

    @property
    def recorded_deg(self) -> Floats:
        """The recorded heading along the curve, (n,), continuous too."""
        return self.heading_deg - self.deviation_deg


def emptiest(angle_deg: ArrayLike) -> float:
    """Find where a circle is best cut: the middle of its emptiest part, to the sector, -180 where it is all empty.

    Args:
        angle_deg: angles of any shape, degrees, NaN left out.
    """
    occupied = sectors(angle_deg, 0.0)
    if not occupied.any():
        return -180.0
    cuts = SECTOR_DEG * np.arange(len(occupied))
    away = angles.difference(cuts[:, None], cuts + SECTOR_DEG / 2.0)
    around = np.exp(-0.5 * (away / GAP_WIDTH_DEG) ** 2) @ occupied
    return float(angles.wrap180(cuts[np.argmin(around)]))


def placed(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Wrap angles to the turn that begins at the cut, [begin, begin + 360).

    Args:
        angle_deg: angles of any shape, degrees.
    """
    return begin_deg + angles.wrap360(np.asarray(angle_deg, dtype=float) - begin_deg)


def nearest_turn(angle_deg: ArrayLike, reference_deg: ArrayLike) -> Floats:
    """Unwrap angles to less than half a turn from a reference that may stand on any turn.

    Args:
        angle_deg: angles, degrees.
        reference_deg: what they are to stand beside, degrees.
    """
    reference = np.asarray(reference_deg, dtype=float)
    return reference + angles.difference(angle_deg, reference)


def sectors(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Compute the share of the angles in each sector clockwise from the cut, (36,), percent.

    Args:
        angle_deg: angles of any shape, degrees, NaN left out.
        begin_deg: the cut, at an edge of a sector.
    """
    angle = np.asarray(angle_deg, dtype=float)
    turn = placed(angle[np.isfinite(angle)], begin_deg) - begin_deg
    count = np.histogram(turn, bins=round(360.0 / SECTOR_DEG), range=(0.0, 360.0))[0]
    return 100.0 * count / max(int(count.sum()), 1)


def deviation_curve(fit: DeviationFit, begin_deg: float, headings_deg: ArrayLike) -> DeviationByHeading:
    """Evaluate a fitted deviation over one turn.

    Args:
        begin_deg: heading at which the turn begins.
        headings_deg: correct headings at which the deviation is to be in [-180, 180) on average; all where empty.
    """
    beta = begin_deg + np.arange(0.0, 360.0 + STEP_DEG / 2.0, STEP_DEG)
    if fit.method == "von_appen":
        deviation = series_deviation(fit.coefficients, beta)
    else:
        deviation = angles.difference(beta, compass.recorded_heading(fit.coefficients, beta))
    deviation = deviation[0] + np.concatenate([[0.0], np.cumsum(angles.difference(deviation[1:], deviation[:-1]))])
    where = placed(headings_deg, begin_deg)
    there = np.interp(where[np.isfinite(where)], beta, deviation)
    level = np.median(there if there.size else deviation)
    deviation = deviation - (level - angles.wrap180(level))
    sigma = np.full(beta.shape, np.nan)
    if fit.covariance.size:
        by = series_design(beta).T if fit.method == "von_appen" else compass.gradient(fit.coefficients, beta)
        sigma = np.sqrt(np.einsum("in,ij,jn->n", by, fit.covariance[:5, :5], by))
    # The exact compass gives up no heading, but two of its headings may read the same.
    if fit.method == "von_appen":
        inverted = inverse_table(fit.coefficients)[1]
        first, last = inverted.min(), inverted.max()
        stretch = np.where(angles.wrap360(beta - first) <= last - first, INVERTED, GIVEN_UP)
    else:
        stretch = np.where(compass.slope(fit.coefficients, beta) >= 0.0, INVERTED, BACKWARDS)
    return DeviationByHeading(beta, deviation, sigma, stretch)


def observed(pairs: Pairs, shape: DeviationByHeading | None, begin_deg: float) -> tuple[Floats, Floats]:
    """Compute correct heading and deviation of each pair, (n,) each, the deviation on the curve's turn.

    Args:
        shape: the curve; the mean deviation takes its place where absent.
        begin_deg: heading at which the turn begins.
    """
    beta, deviation = placed(observed_heading(pairs), begin_deg), observed_deviation(pairs)
    if shape is None:
        return beta, nearest_turn(deviation, angles.wrap180(angles.mean(deviation)))
    return beta, nearest_turn(deviation, np.interp(beta, shape.heading_deg, shape.deviation_deg))


def usable_headings(product: CorrectedRecord) -> Floats:
    """Select the recorded headings, (n,) degrees, NaN where they are flagged bad."""
    return np.where(product.record.heading_quality < BAD, product.record.heading_deg, np.nan)
