"""How well the two instruments agree before and after the correction (von Appen 2015, Figs 8 and 9, c)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator

from compasslib import angles
from compasslib.plots import curves
from compasslib.plots.curves import emptiest, placed
from compasslib.plots.page import BLACK, TRUE, degrees, empty, page, signed
from compasslib.records import Corrected, Pairs
from compasslib.types import Floats

HEXAGONS = 40  # across a panel: 9 degrees each
COUNTS = ListedColormap(colormaps["viridis_r"](np.linspace(0.1, 1.0, 256)))  # its palest end is lost on white
BAR: dict[str, Any] = {"aspect": 40, "location": "top", "pad": 0.02, "label": "Pairs per hexagon"}


def scatter(path: str | Path, pairs: Pairs, product: Corrected) -> None:
    """Draw the affected against the reference current direction, before and after.

    These are all pairs, the fit's own; the assessment judges on pairs that the fit has not seen.

    Args:
        pairs: overlapping measurements, perhaps none.
        product: the corrected record, perhaps without corrected headings.
    """
    lower, upper, corrected = curves.directions(pairs, product)
    begin = emptiest(lower)
    with page(path, 2.7) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        drawn = [
            _agreement(panels[0], "recorded", (lower, upper), begin),
            _agreement(panels[1], "corrected", (lower, corrected), begin),
        ]
        panels[0].set_ylabel(f"Affected, towards {TRUE}")
        figure.supxlabel(f"Reference, towards {TRUE}", fontsize=8.0)
        _count_bar(figure, panels, [hexagons for hexagons in drawn if hexagons is not None])


def _agreement(axes: Axes, title: str, xy: tuple[Floats, Floats], begin: float) -> PolyCollection | None:
    """Draw one direction against another, counted in hexagons; None where there is nothing to draw."""
    known = np.isfinite(xy[0]) & np.isfinite(xy[1])
    limits = (begin, begin + 360.0)
    axes.set_title(title)
    if not known.any():
        empty(axes, "no pairs")
        return None
    off = angles.difference(xy[1], xy[0])[known]
    axes.set_title(
        f"{title}, n = {off.size}\nmean {signed(float(angles.wrap180(angles.mean(off))))}°, rms {angles.rms(off):.1f}°"
    )
    lower, upper = (placed(angle[known], begin) for angle in xy)
    hexagons = axes.hexbin(
        lower, upper, gridsize=HEXAGONS, extent=(*limits, *limits), mincnt=1, cmap=COUNTS, linewidths=0.1
    )
    axes.plot(limits, limits, color=BLACK, linewidth=0.8)
    for axis in (axes.xaxis, axes.yaxis):
        degrees(axis, limits)
    axes.set_aspect("equal")
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
