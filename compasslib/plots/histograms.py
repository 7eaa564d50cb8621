"""Histograms of headings, directions and their differences before and after (von Appen 2015, Figs 8 and 9)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.deviation.histograms import BIN_DEG, BINS, Counts
from compasslib.plots.curves import emptiest
from compasslib.plots.page import (
    CORRECTED,
    MAGNETIC,
    RECORDED,
    REFERENCE,
    TRUE,
    Limits,
    degrees,
    empty,
    legend,
    page,
    signed,
)

COLOURS = {
    "recorded": RECORDED,
    "corrected": CORRECTED,
    "reference": REFERENCE,
    "before": RECORDED,
    "after": CORRECTED,
}
STATISTICS = {"mean_deg": "mean", "median_absolute_deg": "median |Δ|", "rms_deg": "rms"}  # degrees


def draw_histograms(path: str | Path, counts: Mapping[str, Counts], assessment: Mapping[str, Any]) -> None:
    """Draw how often headings, directions and held-out differences occur, and the differences' statistics.

    Args:
        counts: of histograms.csv, by quantity.
        assessment: content of assessment.json.
    """
    groups = [("heading", f"Heading {MAGNETIC}"), ("direction", f"Current towards {TRUE}")]
    with page(path, 5.9) as figure:
        panels = figure.subplots(4, 1, height_ratios=(1.0, 1.0, 1.0, 0.5))
        for axes, (group, label) in zip(panels, groups, strict=False):
            known = {name.partition("_")[2]: n for name, n in counts.items() if name.startswith(group) and n.any()}
            centres = [np.repeat(BIN_DEG * (np.arange(BINS) + 0.5), n) for n in known.values()]
            begin = emptiest(np.concatenate([*centres, np.zeros(0)]))
            _draw_counts(axes, known, (begin, begin + 360.0), 0.0)
            axes.set_xlabel(label)
        differences = {when: counts[f"difference_{when}"] for when in ("before", "after")}
        _draw_counts(panels[2], {when: n for when, n in differences.items() if n.any()}, (-180.0, 180.0), -180.0)
        panels[2].set_xlabel("Affected minus reference, held-out pairs (°)")
        for axes in panels[:3]:
            axes.set_ylabel("Share (%)")
        figure.align_ylabels(panels[:3])
        _write_statistics(panels[3], assessment)
        there = {name for quantity, n in counts.items() if n.any() for name in [quantity.partition("_")[2]]}
        words = {"recorded": "recorded, before", "corrected": "corrected, after"}
        handles: list[Artist] = [
            Line2D([], [], color=COLOURS[name], label=text) for name, text in words.items() if name in there
        ]
        if "reference" in there:
            handles.append(Patch(color=REFERENCE, alpha=0.4, linewidth=0, label="reference"))
        legend(figure, handles, columns=3)


def _draw_counts(axes: Axes, counts: Mapping[str, Counts], limits: Limits, first_deg: float) -> None:
    """Draw the share of each bin as steps, the reference's filled.

    Args:
        first_deg: where the first bin of the counts begins.
    """
    degrees(axes.xaxis, limits, as_is=first_deg < 0.0)
    if not counts:
        empty(axes)
        return
    edges = limits[0] + BIN_DEG * np.arange(BINS + 1)
    for name in sorted(counts, key=list(COLOURS).index, reverse=True):
        share = 100.0 * np.roll(counts[name], -round((limits[0] - first_deg) / BIN_DEG)) / counts[name].sum()
        filled: dict[str, Any] = {"fill": True, "alpha": 0.4, "linewidth": 0} if name == "reference" else {}
        axes.stairs(share, edges, color=COLOURS[name], **filled)
    axes.set_ylim(bottom=0.0)


def _write_statistics(axes: Axes, assessment: Mapping[str, Any]) -> None:
    """Write number of pairs, mean, median size and rms of the differences with 95 % intervals in two columns."""
    axes.set_axis_off()
    axes.set(xticks=[], yticks=[])
    rows = [["", "pairs", *STATISTICS.values()]]
    for when in ("before", "after"):
        entry = assessment[when]
        cells = [_with_interval(entry, key) for key in STATISTICS] if entry["n"] else ["–"] * len(STATISTICS)
        rows.append([f"{when} (°)", str(entry["n"]), *cells])
    for texts, x in zip(rows, (-0.12, 0.11, 0.62), strict=True):
        for row, text in enumerate(texts):
            colour = COLOURS.get(texts[0].partition(" ")[0], "#444444") if row == 0 else "#222222"
            axes.text(x, 1.0 - 0.25 * row, text, transform=axes.transAxes, color=colour, va="top", fontsize=8.0)


def _with_interval(entry: Mapping[str, Any], key: str) -> str:
    low, high = entry["interval_95"][key]
    form = "+.1f" if key == "mean_deg" else ".1f"
    return f"{signed(entry[key], form)} ({signed(low, '.1f')}, {signed(high, '.1f')})"
