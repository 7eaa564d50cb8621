"""Common parts of all figures: size, style, colours, axes in degrees and dates, legend, and the output file."""

import re
import textwrap
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis, XAxis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import DAILY, HOURLY, MINUTELY, MONTHLY, SECONDLY, AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter, MultipleLocator
from numpy.typing import ArrayLike, NDArray
from PIL import Image

from compasslib import angles
from compasslib.archive.files import atomic_write
from compasslib.records import BAD, CorrectedRecord
from compasslib.types import DAY_S, Floats

Limits = tuple[float, float]

# Widths of a column and of a page, and dots per inch, as journals of the AGU and AMS ask for.
WIDTH_IN, WIDE_IN, DPI = 3.5, 7.0, 300
GAP_IN = 0.06  # between labels of neighbouring panels, and at the edge of the page
CM = 100.0  # in a metre
GAP = 3.0  # multiple of the median step above which there are no data between two points
LETTERS = FontProperties(family="DejaVu Sans", size=8.0)
# Colours that the colour-blind can tell apart (Okabe and Ito 2008).
BLACK, GREY = "#000000", "#8C8C8C"
ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
RECORDED, CORRECTED, REFERENCE = ORANGE, BLUE, GREY
COLOURS = {"recorded": RECORDED, "corrected": CORRECTED, "reference": REFERENCE, "before": RECORDED, "after": CORRECTED}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}  # the 95 % interval of a fit
SHADE: dict[str, Any] = {"color": CORRECTED, "alpha": 0.25, "linewidth": 0}  # an interval of corrected values
ROUND = (1, 2, 5, 10)  # steps of ticks
STYLE: dict[Any, Any] = {
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.labelsize": 8.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
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
def create(path: str | Path, height_in: float, *, width_in: float = WIDTH_IN, title: str = "") -> Iterator[Figure]:
    """Create an empty figure and write it as PNG or PDF, reproducibly, when the block ends without an error.

    If there are several panels, they are lettered; long titles and axis labels are wrapped. Only a figure that is used
    without a caption has a title.

    Raises:
        ValueError: if the labels leave no room for a panel.
    """
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # ignore a user's matplotlibrc
        matplotlib.rcParams.update(STYLE)
        figure = Figure(figsize=(width_in, height_in), dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        if title:
            figure.suptitle(title, fontsize=9.0)
        yield figure
        panels = [
            axes for axes in figure.axes if axes.get_visible() and axes.axison and axes.get_label() != "<colorbar>"
        ]
        for letter, axes in zip("abcdefghijklmnopqrstuvwxyz", panels if len(panels) > 1 else (), strict=False):
            axes.set_title(f"({letter}) {axes.get_title('left')}".rstrip())
        texts = [text for axes in figure.axes for text in (axes._left_title, axes.xaxis.label, axes.yaxis.label)]  # type: ignore[attr-defined]
        for text in texts:
            text.set_text(re.sub(r"\S{25,}", lambda word: textwrap.fill(word[0], 24), text.get_text()))
            text.set_wrap(True)
        _arrange(figure)
        if any(text._get_wrapped_text() != text.get_text() for text in texts):  # type: ignore[union-attr]
            _arrange(figure)  # titles wrap at the width that the first pass sets
        if Path(path).suffix == ".pdf":
            with atomic_write(path) as temporary:
                figure.savefig(temporary, format="pdf", metadata={"CreationDate": None})
            return
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # the page is opaque
        with atomic_write(path) as temporary:  # level 3 takes half the time of the usual 6
            Image.fromarray(np.ascontiguousarray(pixels)).save(temporary, "PNG", dpi=(DPI, DPI), compress_level=3)


def _arrange(figure: Figure) -> None:
    """Set margins and gaps of the grid of panels from one measurement of their labels."""
    # The constrained layout of matplotlib measures all artists, twice, and takes as long as drawing them.
    panels = [axes for axes in figure.axes if axes.get_subplotspec() is not None]
    if not panels:
        return
    renderer, width, height = figure.canvas.get_renderer(), figure.bbox.width, figure.bbox.height  # type: ignore[attr-defined]
    gap = GAP_IN * figure.dpi
    grid: Any = panels[0].get_subplotspec().get_gridspec()  # type: ignore[union-attr]
    beside, above = np.zeros((grid.ncols, 2)), np.zeros((grid.nrows, 2))  # pixels, before and after each panel
    for axes in panels:
        place, labels = axes.get_subplotspec(), axes.get_tightbbox(renderer, bbox_extra_artists=axes.child_axes)
        box = axes.get_window_extent(renderer)
        if place is None or labels is None:
            continue
        for reached, span, around in (
            (beside, place.colspan, (box.x0 - labels.x0, labels.x1 - box.x1)),
            (above, place.rowspan, (labels.y1 - box.y1, box.y0 - labels.y0)),
        ):
            reached[span.start, 0] = max(reached[span.start, 0], around[0])
            reached[span.stop - 1, 1] = max(reached[span.stop - 1, 1], around[1])
    bottom, left = gap, gap
    for each in figure.legends:
        bottom += each.get_window_extent(renderer).height + gap
    if label := figure._supxlabel:  # type: ignore[attr-defined]
        label.set(y=bottom / height, verticalalignment="bottom")
        bottom += label.get_window_extent(renderer).height + gap
    if label := figure._supylabel:  # type: ignore[attr-defined]
        left += label.get_window_extent(renderer).width + gap
    left, right = left + beside[0, 0], width - beside[-1, 1] - gap
    low, high = bottom + above[-1, 1], height - above[0, 0] - gap
    if title := figure._suptitle:  # type: ignore[attr-defined]
        high -= title.get_window_extent(renderer).height + gap
    spaces = []
    for reached, span in ((beside, right - left), (above, high - low)):
        between = max((reached[:-1, 1] + reached[1:, 0] + gap), default=0.0)
        each = (span - between * (len(reached) - 1)) / len(reached)  # mean size of a panel
        if each <= 0.0:
            raise ValueError(f"the labels leave no room for a panel: {[axes.get_ylabel() for axes in panels]}")
        spaces.append(between / each)
    edges = {"left": left / width, "right": right / width, "bottom": low / height, "top": high / height}
    grid.update(**edges, wspace=spaces[0], hspace=spaces[1])
    for axes in panels:  # a grid moves the panels of pyplot's figures only
        axes.set_position(axes.get_subplotspec().get_position(figure))  # type: ignore[union-attr]


class Rows:
    """Rows of a panel from top to bottom, each as high as the lines of its name, which is wrapped."""

    def __init__(self, names: Sequence[str], characters: int = 18):
        self.names = names
        self._wrapped = [textwrap.fill(name, characters) for name in names]
        ends = np.cumsum([0.0, *(1.0 + 1.2 * name.count("\n") for name in self._wrapped)])
        self._lines = float(ends[-1])
        self.places = (ends[1:] + ends[:-1]) / 2.0  # middle of each row, (n,), in lines from the top
        self.height_in = 0.16 * self._lines  # of the panel without its axis

    def name(self, axes: Axes) -> None:
        """Label the vertical axis with the names."""
        axes.set_yticks(self.places, self._wrapped, multialignment="right")
        axes.set_ylim(self._lines, 0.0)


def dates(axes: Axes, span_s: Limits | None = None) -> None:
    """Set ticks of a horizontal axis in days since 1970, as matplotlib counts time; and its limits, given a span."""
    if span_s is not None:
        first, last = span_s
        pad = max(0.01 * (last - first), 1.0)
        axes.set_xlim((first - pad) / DAY_S, (last + pad) / DAY_S)
    locator = AutoDateLocator(minticks=3, maxticks=6)
    # With the default steps it finds too few ticks between two units (at 2.5 to 3 hours or years), and warns.
    longest = {SECONDLY: 60, MINUTELY: 60, HOURLY: 24, DAILY: 31, MONTHLY: 12}
    locator.intervald |= {unit: [*locator.intervald[unit], step] for unit, step in longest.items()}
    locator.set_axis(axes.xaxis)
    ticks, words = locator(), ConciseDateFormatter(locator)
    labels = FixedFormatter(words.format_ticks(ticks))
    labels.set_offset_string(words.get_offset())
    # Ticks and labels are computed once rather than at every evaluation of the layout.
    axes.xaxis.set(major_locator=FixedLocator(ticks), major_formatter=labels)
    axes.set_xlabel("Date (UTC)")


def degrees(axis: Axis, limits: Limits, *, as_is: bool = False) -> None:
    """Set limits and ticks of an axis in degrees.

    Headings are labelled 0 to 359, and 360 at the end of a turn from 0; deviations and differences ``as_is``.
    """
    span = limits[1] - limits[0]
    if as_is:  # at least three ticks, as zero alone gives no scale
        step = next((each for each in (90.0, 45.0, 30.0, 15.0, 10.0, 5.0) if span >= 3.0 * each), 2.0)
    else:
        step = 90.0 if span > 150.0 else 45.0 if span > 110.0 else 30.0 if span > 75.0 else 15.0
    if isinstance(axis, XAxis):
        axis.axes.set_xlim(limits)
    else:
        axis.axes.set_ylim(limits)
    axis.set_major_locator(MultipleLocator(step))
    whole_turn = limits == (0.0, 360.0)

    def label(x: float, _: int) -> str:
        heading = 360.0 if whole_turn and x == 360.0 else float(angles.wrap360(round(x)))
        return signed(x if as_is else heading, ".0f")

    axis.set_major_formatter(FuncFormatter(label))


def find_gaps(time_s: Floats) -> NDArray[np.intp]:
    """Find the samples before which others are missing, where a line is to be interrupted."""
    step = np.diff(time_s, prepend=time_s[:1])
    return np.flatnonzero(step > GAP * np.median(step))


def signed(x: float, form: str = "+.1f") -> str:
    """Format a number with a typographic minus sign."""
    return f"{x:{form.replace('.', 'z.')}}".replace("-", "\N{MINUS SIGN}")  # z: no minus before zero


def empty(*panels: Axes, words: str = "no data") -> None:
    """Write a short text into empty panels and remove their ticks."""
    for axes in panels:
        axes.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
        axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color="#444444")


def legend(figure: Figure, handles: Sequence[Artist], *, columns: int = 2) -> None:
    """Add one legend below all panels, with at most ``columns`` columns."""
    if handles:
        figure.legend(handles=handles, loc="lower center", borderaxespad=0.2, ncols=min(columns, len(handles)))


def line(label: str, **look: Any) -> Line2D:
    """Create the entry of a legend for a line or a marker."""
    return Line2D([], [], label=label, **look)


def emptiest(angle_deg: ArrayLike, smoothing_deg: float = 25.0) -> float:
    """Find the angle at which to cut a circular axis, the middle of the largest gap in the data; -180 without data."""
    occupied = sectors(angle_deg, 0.0)
    if not occupied.any():
        return -180.0
    cuts = angles.SECTOR_DEG * np.arange(len(occupied))
    away = angles.difference(cuts[:, None], cuts + angles.SECTOR_DEG / 2.0)
    around = np.exp(-0.5 * (away / smoothing_deg) ** 2) @ occupied
    return float(angles.wrap180(cuts[np.argmin(around)]))


def placed(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Wrap angles to [begin, begin + 360)."""
    return begin_deg + angles.wrap360(np.asarray(angle_deg, dtype=float) - begin_deg)


def nearest_turn(angle_deg: ArrayLike, reference_deg: ArrayLike) -> Floats:
    """Unwrap angles to within half a turn of a reference, which need not be wrapped itself."""
    reference = np.asarray(reference_deg, dtype=float)
    return reference + angles.difference(angle_deg, reference)


def sectors(angle_deg: ArrayLike, begin_deg: float) -> Floats:
    """Compute the share of the finite angles in each sector clockwise from ``begin_deg``, (36,), percent."""
    angle = np.asarray(angle_deg, dtype=float)
    turn = placed(angle[np.isfinite(angle)], begin_deg) - begin_deg
    count = np.histogram(turn, bins=round(360.0 / angles.SECTOR_DEG), range=(0.0, 360.0))[0]
    return 100.0 * count / max(int(count.sum()), 1)


def usable_headings(product: CorrectedRecord) -> Floats:
    """Select the recorded headings, (n,) degrees, NaN where they are flagged bad."""
    return np.where(product.record.heading_quality < BAD, product.record.heading_deg, np.nan)
