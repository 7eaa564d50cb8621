"""How well upper and lower instrument agree before and after the correction (von Appen 2015, Figs 8 and 9)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from compasslib.core import angles
from compasslib.core.records import Corrected, Pairs
from compasslib.core.types import Floats
from compasslib.plots import curves
from compasslib.plots.curves import emptiest, placed
from compasslib.plots.page import (
    BLACK,
    CORRECTED,
    MAGNETIC,
    NO_PAIRS,
    RECORDED,
    TRUE,
    TRUSTED,
    degrees,
    legend,
    page,
    product_notes,
    say,
    title_of,
)

HEXAGONS = 40  # across a panel: 9 degrees each
COUNTS = ListedColormap(colormaps["viridis_r"](np.linspace(0.1, 1.0, 256)))  # its palest end is lost on white
TRUSTED_ALPHA = 0.5
BAR: dict[str, Any] = {"aspect": 30, "shrink": 0.8, "pad": 0.02, "label": "Pairs per hexagon"}


def histograms(path: str | Path, pairs: Pairs, product: Corrected, name: str, *, method: str = "") -> None:
    """Draw how often each heading and each direction occurs, before and after (von Appen's Figs 8 and 9, a and b).

    Args:
        pairs: overlapping measurements, perhaps none.
        product: the corrected record, perhaps without corrected headings.
        method: of the correction, for the title.
    """
    recorded = curves.usable_headings(product)
    lower, upper, corrected = curves.directions(pairs, product)
    title = title_of(name, "headings and current directions", method)
    with page(path, title, 2.95, product_notes(product)) as figure:
        a, b = figure.subplots(1, 2)
        a.set(xlabel=f"Heading {MAGNETIC}", title="(a) headings of all samples")
        b.set(xlabel=f"Direction towards {TRUE}", title=f"(b) current directions of {len(pairs)} pairs")
        drawn = _stairs(a, {RECORDED: recorded, CORRECTED: product.heading_corrected_deg}, "No heading was recorded.")
        drawn |= _stairs(b, {TRUSTED: lower, RECORDED: upper, CORRECTED: corrected}, NO_PAIRS)
        handles: list[Artist] = [
            Line2D([], [], color=RECORDED, label="upper, recorded"),
            Line2D([], [], color=CORRECTED, label="upper, corrected"),
            Patch(color=TRUSTED, alpha=TRUSTED_ALPHA, linewidth=0, label="lower, trusted"),
        ]
        shown = zip(handles, (RECORDED, CORRECTED, TRUSTED), strict=True)
        legend(figure, [handle for handle, colour in shown if colour in drawn])


def scatter(path: str | Path, pairs: Pairs, product: Corrected, name: str, *, method: str = "") -> None:
    """Draw the upper against the lower current direction, before and after (von Appen's Figs 8 and 9, c).

    These are all pairs, the fit's own; the assessment judges on pairs that the fit has not seen.

    Args:
        pairs: overlapping measurements, perhaps none.
        product: the corrected record, perhaps without corrected headings.
        method: of the correction, for the title.
    """
    lower, upper, corrected = curves.directions(pairs, product)
    begin = emptiest(lower)
    title = title_of(name, "upper against lower current direction", method)
    with page(path, title, 3.1, product_notes(product)) as figure:
        panels = figure.subplots(1, 2)
        drawn = [
            _agreement(panels[0], "(a) recorded", (lower, upper), begin),
            _agreement(panels[1], "(b) corrected", (lower, corrected), begin),
        ]
        _count_bar(figure, panels, [hexagons for hexagons in drawn if hexagons is not None])


def _stairs(axes: Axes, series: dict[str, Floats], otherwise: str) -> set[str]:
    """Draw one histogram a colour on a circle that is cut at its emptiest part; return the colours that were drawn."""
    axes.set_ylabel("Share per 10° (%)")
    shown = {colour: angle for colour, angle in series.items() if np.isfinite(angle).any()}
    if not shown:
        say(axes, otherwise)
        return set()
    begin = emptiest(np.concatenate(list(shown.values())))
    edges = begin + curves.SECTOR_DEG * np.arange(37.0)
    for colour, angle in shown.items():
        shares = curves.sectors(angle, begin)
        if colour == TRUSTED:
            axes.stairs(shares, edges, color=colour, fill=True, alpha=TRUSTED_ALPHA)
        else:
            axes.stairs(shares, edges, color=colour, linewidth=1.4)
    degrees(axes.xaxis, (begin, begin + 360.0))
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))
    return set(shown)


def _agreement(axes: Axes, letter: str, xy: tuple[Floats, Floats], begin: float) -> PolyCollection | None:
    """Draw one direction against another, counted in hexagons; None where there is nothing to draw."""
    known = np.isfinite(xy[0]) & np.isfinite(xy[1])
    limits = (begin, begin + 360.0)
    axes.set(title=letter, xlabel=f"Lower direction {TRUE}", ylabel=f"Upper direction {TRUE}")
    if not known.any():
        say(axes, NO_PAIRS if not len(known) else "No pair could be corrected.")
        return None
    lower, upper = (placed(angle[known], begin) for angle in xy)
    axes.set_title(f"{letter}: rms {angles.rms(upper - lower):.1f}°, n = {known.sum()}")
    hexagons = axes.hexbin(
        lower, upper, gridsize=HEXAGONS, extent=(*limits, *limits), mincnt=1, cmap=COUNTS, linewidths=0.1
    )
    axes.plot(limits, limits, color=BLACK, linewidth=0.8)
    for axis in (axes.xaxis, axes.yaxis):
        degrees(axis, limits)
    return hexagons


def _count_bar(figure: Figure, panels: Sequence[Axes], counted: Sequence[PolyCollection]) -> None:
    """Give all panels the same colours for the same counts."""
    if not counted:
        return
    most = max(5.0, *(float(np.max(np.asarray(hexagons.get_array()))) for hexagons in counted))
    for hexagons in counted:
        hexagons.set_norm(LogNorm(1.0, most))
    ticks, text = LogLocator(subs=(1.0, 2.0, 5.0)), FuncFormatter(lambda count, _: f"{count:g}")
    figure.colorbar(counted[0], ax=panels, ticks=ticks, format=text, **BAR).minorticks_off()
