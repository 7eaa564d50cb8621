"""The page that every figure stands on: style, colours, axes in degrees, sentences, legend, and the file itself."""

from __future__ import annotations

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
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.ticker import FuncFormatter, MultipleLocator
from PIL import Image

from compasslib.archive.files import replacing
from compasslib.core import angles
from compasslib.core.records import Corrected
from compasslib.core.types import Floats

Limits = tuple[float, float]

WIDTH_IN, DPI = 7.0, 200
DEFLATE = 3  # of the PNG: half the time of the usual 6, and without the alpha channel still fewer bytes
# Colours that the colour-blind can tell apart (Okabe and Ito 2008).
BLACK, GREY = "#000000", "#8C8C8C"
ORANGE, SKY, GREEN, BLUE, VERMILION, PURPLE = "#E69F00", "#56B4E9", "#009E73", "#0072B2", "#D55E00", "#CC79A7"
RECORDED, CORRECTED, TRUSTED = ORANGE, BLUE, GREY
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
    "legend.handlelength": 1.8,
    "legend.columnspacing": 1.5,
    "lines.linewidth": 1.3,
    "text.parse_math": False,  # a dollar in a mooring's name is a dollar
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
}
METHODS = {"exact": "exact compass", "von_appen": "series of von Appen 2015", "calibration": "calibration elsewhere"}
NO_PAIRS = "No pairs: there is no trusted measurement near enough to compare."
LINE_IN = 0.16  # of the title and the notes
SENTENCE_CHARACTERS = 105  # of 8 points in the page's width
MAGNETIC, TRUE = "(° magnetic)", "(° true)"


@contextmanager
def page(path: str | Path, title: str, height_in: float, notes: Sequence[str] = ()) -> Iterator[Figure]:
    """Give an empty figure that becomes a PNG once the block has ended well, the same bytes for the same drawing.

    Args:
        height_in: without the title and notes, inches; every figure is as wide as two columns of print.
        notes: sentences below the title, for what the reader would look for in vain.
    """
    with matplotlib.rc_context():
        matplotlib.rcdefaults()  # a user's own matplotlibrc does not count
        matplotlib.rcParams.update(STYLE)
        lines = [title, *(line for note in notes for line in textwrap.wrap(note, SENTENCE_CHARACTERS))]
        layout = ConstrainedLayoutEngine()
        figure = Figure(figsize=(WIDTH_IN, height_in + LINE_IN * len(lines)), dpi=DPI, layout=layout)
        canvas = FigureCanvasAgg(figure)
        figure.suptitle("\n".join(lines))
        yield figure
        # What savefig does, without its first drawing of all artists, which serves the layout alone.
        layout.execute(figure)
        figure.set_layout_engine("none")
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[..., :3]  # the page is opaque
        with replacing(path) as temporary:
            Image.fromarray(np.ascontiguousarray(pixels)).save(temporary, "PNG", dpi=(DPI, DPI), compress_level=DEFLATE)


def title_of(name: str, what: str, method: str) -> str:
    """Return the first line of a figure.

    Args:
        method: of the correction; left out where it is empty.
    """
    return f"{name}: {what}" + (f" ({METHODS.get(method, method)})" if method else "")


def product_notes(product: Corrected) -> list[str]:
    """Return the sentence on headings that could not be corrected, if there are any."""
    recorded = np.isfinite(product.record.heading_deg)
    lost = recorded & ~np.isfinite(product.heading_corrected_deg)
    if not lost.any():
        return []
    if lost.sum() == recorded.sum():
        return ["No heading could be corrected: no usable deviation model covers them."]
    return [f"{lost.sum()} of {recorded.sum()} headings could not be corrected."]


def degrees(axis: Axis, limits: Limits, *, signed: bool = False) -> None:
    """Set limits and ticks of an axis in degrees; headings are labelled 0 to 359 on whichever turn they stand.

    Args:
        limits: degrees.
        signed: label deviations as they are.
    """
    span = limits[1] - limits[0]
    step = 90.0 if span > 260.0 else 45.0 if span > 120.0 else 30.0 if span > 75.0 else 15.0
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


def say(axes: Axes, sentence: str, *, characters: int = 30, hide_x: bool = True) -> None:
    """Put a sentence where a panel has nothing to show, and take its ticks away.

    Args:
        hide_x: take the ticks of the horizontal axis too, which panels below may share.
    """
    axes.tick_params(left=False, labelleft=False)
    if hide_x:
        axes.tick_params(bottom=False, labelbottom=False)
    text = textwrap.fill(sentence, characters)
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#444444")


def legend(figure: Figure, handles: Sequence[Artist], *, columns: int = 3) -> None:
    """Put one legend under all panels, where it covers nothing.

    Args:
        columns: at most.
    """
    if handles:
        figure.legend(handles=handles, loc="outside lower center", ncols=min(columns, len(handles)))
