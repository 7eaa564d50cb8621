"""The figure of a calibration's diagnosis: where the mismatch lives, before and after, and the hypotheses ranked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from compasslib.plots.page import BLACK, CORRECTED, GREY, RECORDED, VERMILION, legend, page, say

COLUMNS, ROW_IN = 2, 2.1
MOST_PANELS, MOST_BARS = 5, 10
SIMULTANEOUS = 0.95
AXES = {
    "heading": "Heading (°)", "time": "Time since the begin (h)", "reading": "Number of the reading",
    "pitch": "Pitch (°)", "roll": "Roll (°)", "turn_rate": "Rate of turn (°/s)", "temperature": "Temperature (°C)",
    "vertical_field": "Vertical field over its mean", "speed": "Speed (kn)",
}  # fmt: skip
RESIDUAL = "Observed − simulated (°)"
BEFORE: dict[str, Any] = {"color": RECORDED, "marker": "o", "markersize": 3.0, "linewidth": 0.8}
AFTER: dict[str, Any] = {"color": CORRECTED, "marker": "s", "markersize": 3.0, "linewidth": 0.8}


def diagnosis(path: str | Path, content: Mapping[str, Any], name: str) -> None:
    """Draw the binned residual along each covariate with its simultaneous band, and the hypotheses."""
    curves, ranked = content["curves"][:MOST_PANELS], content["hypotheses"][:MOST_BARS]
    count = max(len(curves) + bool(ranked), 1)
    rows = -(-count // COLUMNS)
    title = f"{name}: what the simulation leaves out: {content['verdict']}"
    with page(path, title, 0.6 + ROW_IN * rows, _notes(content)) as figure:
        panels = list(np.ravel(figure.subplots(rows, COLUMNS if count > 1 else 1)))
        for axes, curve in zip(panels, curves, strict=False):
            _residual(axes, curve)
        if ranked:
            _ranking(panels[len(curves)], ranked, [one["effect"] for one in content["findings"]])
        elif not curves:
            say(panels[0], "There was too little to hold against a simulation.")
        for axes in panels[count:]:
            axes.set_axis_off()
        if curves:
            legend(figure, _handles())


def _notes(content: Mapping[str, Any]) -> list[str]:
    return [one["text"] for one in content["findings"]] or [content["why"]]


def _handles() -> list[Line2D | Patch]:
    band = Patch(color=GREY, alpha=0.3, linewidth=0, label="what noise leaves in all bins, 95 %")
    return [Line2D([], [], label="before", **BEFORE), Line2D([], [], label="after", **AFTER), band]


def _residual(axes: Axes, curve: Mapping[str, Any]) -> None:
    centre, before, after, sigma = (
        np.array(curve[key], dtype=float) for key in ("centre", "before_deg", "after_deg", "sigma_deg")
    )
    if curve["covariate"] == "time" and len(centre):
        centre = (centre - centre[0]) / 3600.0
    half = NormalDist().inv_cdf(1.0 - (1.0 - SIMULTANEOUS) / (2.0 * max(len(centre), 1))) * sigma
    axes.fill_between(centre, -half, half, color=GREY, alpha=0.3, linewidth=0)
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    axes.plot(centre, before, **BEFORE)
    axes.plot(centre, after, **AFTER)
    axes.set_xlabel(AXES.get(curve["covariate"], curve["covariate"].replace("_", " ").capitalize()))
    axes.set_ylabel(RESIDUAL)
    axes.set_title(curve.get("compared", ""))
    if curve["covariate"] == "heading":
        axes.set_xlim(0.0, 360.0)
        axes.set_xticks(np.arange(0.0, 361.0, 90.0))


def _ranking(axes: Axes, ranked: Sequence[Mapping[str, Any]], named: Sequence[str]) -> None:
    """Draw how well each effect does alone; those that were named in the end stand out."""
    place = np.arange(len(ranked))[::-1]
    colours = [VERMILION if one["effect"] in named else GREY for one in ranked]
    axes.barh(place, [max(one["score"], 0.0) for one in ranked], color=colours, height=0.7)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set_yticks(place, [one["effect"].replace("_", " ") for one in ranked])
    axes.set_xlabel("Score alone (named: red)")
    axes.set_xlim(0.0, max(10.0, 1.1 * max(one["score"] for one in ranked)))
