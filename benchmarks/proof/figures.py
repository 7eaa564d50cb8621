"""Figures of the scorecard: detection by size, and heading errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator, NullLocator

from benchmarks import targets
from benchmarks.proof import score, tally
from compasslib.plots.page import BLUE, GREY, WIDE_IN, page

TICKS_DEG = (0.2, 0.5, 1, 2, 5, 10, 20, 50)


def write(folder: Path, made: dict[str, Any]) -> None:
    """Draw power.png and headings.png."""
    folder.mkdir(parents=True, exist_ok=True)
    power(folder / "power.png", made["power"])
    headings(folder / "headings.png", made["moorings"])


def power(path: Path, bins: Sequence[dict[str, Any]]) -> None:
    """Draw the share of single effects that were detected and named against their visible size."""
    title = "Single effects detected and named, by visible size\n"
    title += "Bars are 95 % intervals (Clopper and Pearson); n is the number of moorings."
    with page(path, 2.9, width_in=WIDE_IN, title=title) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (place, water) in zip(panels, {"made": "simulated", "real": "real"}.items(), strict=True):
            some = [one for one in bins if one["place"] == place]
            for key, colour, shift in (("detected", GREY, -0.08), ("named", BLUE, 0.08)):
                _bars(axes, np.arange(len(some)) + shift, [(one[key], one["count"]) for one in some], colour, key)
            axes.set_xticks(range(len(some)), [f"{_range(one)}\nn = {one['count']}" for one in some])
            axes.set(xlabel=f"Visible size, {water} water, rms (°)", ylim=(-0.03, 1.03))
        panels[0].set_ylabel("Share")
        panels[0].legend(loc="upper left", ncols=2, bbox_to_anchor=(0.08, 1.15))


def _bars(axes: Any, at: np.ndarray, counts: Sequence[tuple[int, int]], colour: str, label: str) -> None:
    if counts:
        middle = np.array([hits / count for hits, count in counts])
        ends = np.array([targets.interval(*each) for each in counts])
        axes.errorbar(at, middle, np.abs(ends.T - middle), fmt="o", color=colour, label=label, capsize=2)


def headings(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Draw the rms heading error of the product against that of the fit for every mooring."""
    title = "True error of the heading, rms, a dot for each mooring\n"
    title += "Below the line the product is better than the fit."
    groups = {"No fault": score.QUIET, "Listed effects": score.KNOWN, "Unlisted effects": ("strange",)}
    with page(path, 2.9, width_in=WIDE_IN, title=title) as figure:
        panels = figure.subplots(1, len(groups), sharex=True, sharey=True)
        for axes, (what, kinds) in zip(panels, groups.items(), strict=True):
            some = [row for row in rows if row["kind"] in kinds and row["before_deg"] and row["after_deg"]]
            axes.axline((1.0, 1.0), (2.0, 2.0), color=GREY, linewidth=0.6)
            axes.plot([row["before_deg"] for row in some], [row["after_deg"] for row in some], "o", color=BLUE,
                      markersize=3, alpha=0.5, markeredgewidth=0.0)  # fmt: skip
            axes.set(xscale="log", yscale="log", title=f"{what}, n = {len(some)}", xlabel="Fit (°)")
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_locator(FixedLocator(TICKS_DEG))
                axis.set_major_formatter("{x:g}")
                axis.set_minor_locator(NullLocator())
        panels[0].set_ylabel("Product (°)")


def _range(one: dict[str, Any]) -> str:
    if one["to_deg"] == tally.BINS_DEG[-1]:
        return f"over {one['from_deg']:g}"
    return f"{one['from_deg']:g}–{one['to_deg']:g}" if one["from_deg"] else f"under {one['to_deg']:g}"
