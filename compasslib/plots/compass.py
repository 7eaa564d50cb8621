"""One compass and its records: the iron that each shows beside what all show, and the curve that they share."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.plots.page import BLUE, GREEN, GREY, MAGNETIC, VERMILION, Rows, degrees, empty, legend, page
from compasslib.types import Floats

FIGURES = ("coefficients", "curve")
WITHIN = 1.96
LETTERS = "ABCDE"
COLUMNS = 2
NAMES_IN, LEAST_IN = 0.8, 0.4  # width of the records' names, and the least height of a panel
IRON = (("P_nT", "c"), ("Q_nT", "f"))  # of B and C


def draw(figure: str, path: str | Path, content: Mapping[str, Any]) -> None:
    """Draw one of FIGURES."""
    {"coefficients": coefficients, "curve": curve}[figure](path, content)


def coefficients(path: str | Path, content: Mapping[str, Any]) -> None:
    """Draw what each record shows of the iron, with its 95 % interval, beside what the compass has."""
    deployments = [one for one in content["deployments"] if one["coefficients"]]
    effects = content["effects"]
    panels = [*"BCDE", *((one, k) for one in effects for k in range(len(one["values"])))]
    rows = -(-len(panels) // COLUMNS)
    names = Rows([one["name"] for one in deployments], NAMES_IN)
    with page(path, rows * (0.65 + max(names.height_in, LEAST_IN)) + 0.6) as figure:
        for axes, panel in zip(figure.subplots(rows, COLUMNS, squeeze=False, sharey=True).flat, panels, strict=False):
            if isinstance(panel, str):
                _iron(axes, panel, deployments, content, names)
            else:
                _effect(axes, names, *panel)
            axes.locator_params(axis="x", nbins=3)
        names.name(figure.axes[0])
        for axes in figure.axes[len(panels) :]:
            axes.set_visible(False)
        handles = [Line2D([], [], color=BLUE, marker="o", markersize=3, label="a record alone")]
        legend(figure, [*handles, *_odd(content), Patch(color=GREEN, alpha=0.25, label="the compass, 95 %")])


def curve(path: str | Path, content: Mapping[str, Any]) -> None:
    """Draw the deviation by correct heading of each record, and of the compass in the middle of their fields."""
    deployments = [one for one in content["deployments"] if one["coefficients"]]
    heading = np.arange(0.0, 360.5, 2.0)
    with page(path, 2.8) as figure:
        axes = figure.subplots()
        axes.set_xlabel(f"Correct heading {MAGNETIC}")
        axes.set_ylabel("Deviation (°)")
        degrees(axes.xaxis, (0.0, 360.0))
        if not deployments:
            empty(axes, "no record determines the compass")
            return
        for one in deployments:
            values = np.array([one["coefficients"][letter] for letter in LETTERS])
            values[0] = 0.0
            axes.plot(heading, _deviation(values, heading), color=BLUE if one["fits"] else VERMILION, linewidth=0.8)
        if content["coefficients"]:
            middle, spread = _shared_curve(content, deployments, heading)
            axes.fill_between(
                heading, middle - WITHIN * spread, middle + WITHIN * spread, color=GREEN, alpha=0.25, lw=0
            )
            axes.plot(heading, middle, color=GREEN)
        axes.axhline(0.0, color=GREY, linewidth=0.5)
        handles = [Line2D([], [], color=BLUE, linewidth=0.8, label="a record alone, A left out")]
        legend(figure, [*handles, *_odd(content), Line2D([], [], color=GREEN, label="the compass, 95 %")])


def _odd(content: Mapping[str, Any]) -> list[Line2D]:
    """Return the entry of the legend for records that do not fit, none where all do."""
    return [Line2D([], [], color=VERMILION, label="one that does not fit")] if content["rejected"] else []


def _iron(axes: Axes, letter: str, deployments: list[dict[str, Any]], content: Mapping[str, Any], names: Rows) -> None:
    """Draw B and C as iron in nT, D and E as they are."""
    hard = letter in "BC"
    axes.set_title(f"{letter} times H (µT)" if hard else letter)
    for k, one in zip(names.places, deployments, strict=True):
        unit = one["horizontal_nT"] / 1000.0 if hard else 1.0
        value, sigma = one["coefficients"][letter] * unit, one["sigma"][letter] * unit
        axes.errorbar(
            value, k, xerr=WITHIN * sigma, color=BLUE if one["fits"] else VERMILION, marker="o", markersize=3, lw=1.0
        )
        if content["coefficients"]:
            middle, spread = (x / (1000.0 if hard else 1.0) for x in _expected(letter, one, content))
            axes.fill_betweenx([k - 0.35, k + 0.35], middle - WITHIN * spread, middle + WITHIN * spread, color=GREEN,
                               alpha=0.25, lw=0)  # fmt: skip


def _expected(letter: str, one: Mapping[str, Any], content: Mapping[str, Any]) -> tuple[float, float]:
    """Return what the compass makes of a coefficient at a record's place, iron that varies between them included."""
    names = list(content["coefficients"])
    weight = np.zeros(len(names))
    if letter in "BC":
        iron, induced = IRON["BC".index(letter)]
        weight[names.index(iron)], weight[names.index(induced)] = 1.0, one["vertical_nT"]
    else:
        weight[names.index(letter)] = 1.0
    values, covariance = np.array(list(content["coefficients"].values())), np.array(content["covariance"])
    between = content["sigma_between"] if letter in "BC" else 0.0
    return float(weight @ values), float(np.sqrt(weight @ covariance @ weight + between**2))


def _effect(axes: Axes, names: Rows, effect: Mapping[str, Any], k: int) -> None:
    unit = "°" if effect["units"][k] == "degrees" else effect["units"][k]
    name, parameter = effect["effect"].replace("_", " "), effect["parameters"][k].split("_")[0]
    axes.set_title(f"{name}, {parameter} ({unit})")
    value, sigma = effect["values"][k], effect["sigma"][k]
    axes.axvspan(value - WITHIN * sigma, value + WITHIN * sigma, color=GREEN, alpha=0.25, lw=0)
    place = dict(zip(names.names, names.places, strict=True))
    for name, one in effect["each"].items():
        axes.errorbar(
            one["values"][k], place[name], xerr=WITHIN * one["sigma"][k], color=BLUE, marker="o", markersize=3, lw=1.0
        )


def _shared_curve(
    content: Mapping[str, Any], deployments: list[dict[str, Any]], heading: Floats
) -> tuple[Floats, Floats]:
    """Return the deviation of the compass in the mean field and its standard error, (n,) each."""
    fitting = [one for one in deployments if one["fits"]] or deployments
    level, down = (float(np.mean([one[name] for one in fitting])) for name in ("horizontal_nT", "vertical_nT"))
    design = np.zeros((5, 6))
    design[1, [0, 2]] = design[2, [1, 3]] = 1.0 / level, down / level
    design[3, 4] = design[4, 5] = 1.0
    values = design @ np.array(list(content["coefficients"].values()))
    covariance = design @ np.array(content["covariance"]) @ design.T
    slope = compass.gradient(values, heading)
    return _deviation(values, heading), np.sqrt(np.einsum("in,ij,jn->n", slope, covariance, slope))


def _deviation(values: Floats, heading: Floats) -> Floats:
    return angles.difference(heading, compass.recorded_heading(values, heading))
