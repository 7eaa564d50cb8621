"""What every figure stands on: width, style, colours, axes in degrees and dates, legend, and the file itself.

A figure is as wide as one column of print, so that its letters can be read on a phone too. Its caption is not in it:
the report says in HTML what it shows.
"""

from __future__ import annotations

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
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FixedFormatter, FixedLocator, FuncFormatter, MultipleLocator
from PIL import Image

from compasslib.archive.files import replacing
from compasslib.core import angles
from compasslib.core.types import Floats

Limits = tuple[float, float]

WIDTH_IN, WIDE_IN, DPI = 3.5, 7.0, 200  # one column of print, and two
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
    """Give an empty figure that becomes a PNG once the block has ended well, the same bytes for the same drawing.

    Args:
        title: of a figure that is handed on by itself.
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
        # What savefig does, without its first drawing of all artists, which serves the layout alone.
        layout.execute(figure)
        figure.set_layout_engine("none")
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # the page is opaque
        with replacing(path) as temporary:
            Image.fromarray(np.ascontiguousarray(pixels)).save(temporary, "PNG", dpi=(DPI, DPI), compress_level=DEFLATE)


def dates(axes: Axes, span_s: Limits, *, most: int = 6) -> None:
    """Set limits and ticks of a horizontal axis in days since 1970.

    Args:
        span_s: first and last time, seconds since 1970.
        most: ticks, at most.
    """
    first, last = span_s
    pad = max(0.01 * (last - first), 1.0)
    axes.set_xlim((first - pad) / DAY_S, (last + pad) / DAY_S)
    locator = AutoDateLocator(minticks=3, maxticks=most)
    locator.set_axis(axes.xaxis)
    ticks, words = locator(), ConciseDateFormatter(locator)
    labels = FixedFormatter(words.format_ticks(ticks))
    labels.set_offset_string(words.get_offset())
    # Sought and worded once, not at each look of the layout.
    axes.xaxis.set(major_locator=FixedLocator(ticks), major_formatter=labels)
    axes.set_xlabel("Date (UTC)")


def degrees(axis: Axis, limits: Limits, *, signed: bool = False) -> None:
    """Set limits and ticks of an axis in degrees; headings are labelled 0 to 359 on whichever turn they stand.

    Args:
        limits: degrees.
        signed: label deviations as they are.
    """
    span = limits[1] - limits[0]
    step = 90.0 if span > 150.0 else 45.0 if span > 110.0 else 30.0 if span > 75.0 else 15.0
    if isinstance(axis, XAxis):
        axis.axes.set_xlim(limits)
    else:
        axis.axes.set_ylim(limits)
    axis.set_major_locator(MultipleLocator(step))
    axis.set_major_formatter(FuncFormatter(_signed if signed else _heading))


def _signed(x: float, _: object) -> str:
    return f"{x:.0f}".replace("-", "\N{MINUS SIGN}")


def _heading(x: float, _: object) -> str:
    return f"{float(angles.wrap360(round(x))):.0f}"


def span_of(points: Floats, line: Floats, *, least: float = 60.0) -> Limits:
    """Return limits that hold a whole line and 98 % of the points, degrees.

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
    """Say in a word or two that a panel has nothing to show, and take its ticks away."""
    axes.tick_params(left=False, labelleft=False, bottom=False, labelbottom=False)
    axes.text(0.5, 0.5, words, transform=axes.transAxes, ha="center", va="center", color="#444444")


def legend(figure: Figure, handles: Sequence[Artist], *, columns: int = 2) -> None:
    """Put one legend under all panels, where it covers nothing.

    Args:
        columns: at most.
    """
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, len(handles)))
