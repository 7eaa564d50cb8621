"""The record along time: what was recorded, what was corrected and how surely, and how deep the instrument was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, StepPatch
from numpy.typing import NDArray

from compasslib.plots.curves import emptiest, placed
from compasslib.plots.page import (
    BLACK,
    CORRECTED,
    DAY_S,
    GREEN,
    MAGNETIC,
    PURPLE,
    RECORDED,
    SKY,
    dates,
    degrees,
    empty,
    legend,
    page,
)
from compasslib.records import PROBABLY_BAD, Corrected, Pairs
from compasslib.types import Floats

DRAWN = 12_000  # samples; of a longer record every second, third, ... is drawn
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.2, "markeredgewidth": 0}
SLICES = 60  # of the strip, where the record is too short for days
GUESS = 0.75  # a branch less probable is drawn as a guess
SURE, DOUBTFUL, GUESSED, LOST = 0, 1, 2, 3
KINDS = {
    SURE: ("corrected (flags 1, 2)", CORRECTED),
    DOUBTFUL: (f"doubtful (flag 3), probability ≥ {GUESS:g}", SKY),
    GUESSED: (f"doubtful (flag 3), probability < {GUESS:g}", PURPLE),
    LOST: ("not corrected (flag 4)", BLACK),
}


def timeline(path: str | Path, product: Corrected, pairs: Pairs) -> None:
    """Draw recorded and corrected headings, how sure they are, and the instrument's depth, along time.

    Args:
        product: the corrected record, perhaps without corrected headings.
        pairs: overlapping measurements, perhaps none.
    """
    time_s = product.record.time_s
    with page(path, 5.6) as figure:
        panels = figure.subplots(4, 1, sharex=True, height_ratios=(3.0, 3.0, 1.0, 1.4))
        if not len(time_s):
            for axes in panels:
                empty(axes)
            return
        kind = kinds(product)
        _headings(panels[0], panels[1], product, kind)
        _strip(panels[2], product, pairs, kind)
        _depth(panels[3], product)
        dates(panels[3], (float(time_s[0]), float(time_s[-1])))
        legend(figure, _handles(kind, pairs), columns=1)
        figure.align_ylabels(panels)


def kinds(product: Corrected) -> NDArray[np.int_]:
    """Return what became of each sample's heading, (n,): SURE, DOUBTFUL, GUESSED or LOST; -1 without one."""
    with np.errstate(invalid="ignore"):
        guessed = product.branch_probability < GUESS
    flagged = product.heading_corrected_quality >= PROBABLY_BAD
    kind = np.where(flagged, np.where(guessed, GUESSED, DOUBTFUL), SURE)
    kind = np.where(np.isfinite(product.heading_corrected_deg), kind, LOST)
    return np.where(np.isfinite(product.record.heading_deg), kind, -1)


def _headings(above: Axes, below: Axes, product: Corrected, kind: NDArray[np.int_]) -> None:
    """Draw the recorded and the corrected heading on the same turn."""
    record, corrected = product.record, product.heading_corrected_deg
    begin = emptiest(np.concatenate([record.heading_deg, corrected]))
    some = np.arange(len(kind)) % (1 + len(kind) // DRAWN) == 0
    day = record.time_s / DAY_S
    for here, colour in ((kind != LOST, RECORDED), (kind == LOST, BLACK)):
        above.plot(day[here & some], placed(record.heading_deg[here & some], begin), color=colour, **POINT)
    _band(below, day[some], placed(corrected[some], begin), product.heading_uncertainty_deg[some], begin)
    for k in (SURE, DOUBTFUL, GUESSED):
        here = (kind == k) & some
        below.plot(day[here], placed(corrected[here], begin), color=KINDS[k][1], **POINT)
    for axes, name, drawn in ((above, "Recorded", record.heading_deg), (below, "Corrected", corrected)):
        degrees(axes.yaxis, (begin, begin + 360.0))
        axes.set_ylabel(f"{name} heading\n{MAGNETIC}")
        if not np.isfinite(drawn).any():
            axes.annotate("none", (0.5, 0.5), xycoords="axes fraction", ha="center")


def _band(axes: Axes, day: Floats, heading: Floats, sigma: Floats, begin: float) -> None:
    """Draw one standard deviation to either side, what leaves the turn on the other side too."""
    for turn in (-360.0, 0.0, 360.0):
        low, high = heading - sigma + turn, heading + sigma + turn
        seen = (high > begin) & (low < begin + 360.0)  # of the other turns few reach into this one
        ends = np.stack([np.stack([day, low], axis=1), np.stack([day, high], axis=1)], axis=1)[seen]
        # Axes.vlines masks every line by itself and takes ten times as long.
        axes.add_collection(LineCollection(list(ends), colors=CORRECTED, alpha=0.12, linewidths=0.7), autolim=False)


def _strip(axes: Axes, product: Corrected, pairs: Pairs, kind: NDArray[np.int_]) -> None:
    """Draw the share of each kind day by day, and above it the days on which the reference overlaps."""
    edges = slices(product.record.time_s)
    counts = [np.histogram(product.record.time_s[kind == k], edges)[0] for k in KINDS]
    tops = 100.0 * np.cumsum(counts, axis=0) / np.maximum(np.sum(counts, axis=0), 1)
    bottom = np.zeros(len(edges) - 1)
    for top, (_, colour) in zip(tops, KINDS.values(), strict=True):
        _step(axes, edges, bottom, top, colour)
        bottom = top
    overlaps = np.histogram(pairs.time_s, edges)[0] > 0
    _step(axes, edges, 112.0, np.where(overlaps, 135.0, 112.0), GREEN)
    axes.set(ylim=(0.0, 140.0), yticks=[0.0, 100.0], ylabel="Samples\n(%)")


def _step(axes: Axes, edges: Floats, bottom: Any, top: Floats, colour: str) -> None:
    # Axes.stairs looks for its limits step by step, which here are set anyway.
    axes.add_artist(StepPatch(top, edges / DAY_S, baseline=bottom, fill=True, color=colour, linewidth=0))


def slices(time_s: Floats) -> Floats:
    """Return the edges of days, or of shorter slices where the record is short, seconds.

    Args:
        time_s: increasing times, (n,), n > 0.
    """
    first, last = float(time_s[0]), float(time_s[-1])
    step = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 1.0
    width = min(DAY_S, max((last - first) / SLICES, 2.0 * step))
    return first + width * np.arange(int((last - first) / width) + 2)


def _depth(axes: Axes, product: Corrected) -> None:
    """Draw the instrument's depth, downwards, broken where samples are missing."""
    time_s, depth = product.record.time_s, product.record.depth_m
    axes.set_ylabel("Depth\n(m)")
    if not np.isfinite(depth).any():
        axes.annotate("unknown", (0.5, 0.5), xycoords="axes fraction", ha="center")
        return
    step = np.diff(time_s, prepend=time_s[0])
    gaps = np.flatnonzero(step > 5.0 * np.median(step))
    day = np.insert(time_s / DAY_S, gaps, np.nan)
    axes.plot(day, np.insert(depth, gaps, np.nan), color="#444444", linewidth=0.7)
    shallow, deep = float(np.nanmin(depth)), float(np.nanmax(depth))
    half = max(0.55 * (deep - shallow), 5.0)
    axes.set_ylim((shallow + deep) / 2.0 + half, (shallow + deep) / 2.0 - half)


def _handles(kind: NDArray[np.int_], pairs: Pairs) -> list[Artist]:
    """Explain the kinds that occur, and the overlaps where there are any."""
    handles: list[Artist] = [Patch(color=KINDS[k][1], label=KINDS[k][0]) for k in KINDS if (kind == k).any()]
    if (kind >= 0).any() and (kind != LOST).any():
        handles.insert(0, Line2D([], [], linestyle="", marker="o", markersize=3, color=RECORDED, markeredgewidth=0))
        handles[0].set_label("recorded")
        handles.append(Patch(color=CORRECTED, alpha=0.25, linewidth=0, label="one standard deviation"))
    return [*handles, *([Patch(color=GREEN, label="reference overlaps")] if len(pairs) else [])]
