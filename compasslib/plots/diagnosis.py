"""What the search for left-out physics found, of a mooring and of a calibration: where the two part, and why."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter

from compasslib.plots.page import (
    BLACK,
    BLUE,
    CORRECTED,
    GREY,
    LINE_IN,
    RECORDED,
    VERMILION,
    degrees,
    legend,
    page,
    say,
)
from compasslib.search.wording import TURN, UNITS, UNITS_OF_CALIBRATIONS, VERDICTS, plain

DAY_S = 86400.0  # matplotlib counts time in days since 1970
MOST_PANELS = 6
PANEL_IN = 1.75
CHARACTERS = 106
NAMES = {
    "heading": "Recorded heading", "time": "", "separation": "Distance of the two layers",
    "speed": "Speed of the upper water", "hour_of_day": "Hour of the day, UTC",
}  # fmt: skip


def of_mooring(path: str | Path, found: Mapping[str, Any], name: str) -> None:
    """Draw a mooring's diagnosis: binned residual before and after along each covariate, and the findings in words.

    Args:
        found: content of diagnosis.json.
    """
    curves, words = _curves(found)[:MOST_PANELS], _words(found)
    rows = max(1, (len(curves) + 1) // 2)
    title = f"{name}: {found['verdict']} \N{EN DASH} {VERDICTS[found['verdict']]}"
    text_in = LINE_IN * (len(words) + 1)
    with page(path, title, PANEL_IN * rows + text_in + 0.3) as figure:
        grid = figure.add_gridspec(rows + 1, 2, height_ratios=[PANEL_IN] * rows + [text_in])
        panels = [figure.add_subplot(grid[k // 2, k % 2]) for k in range(len(curves))]
        reach = _simultaneous(sum(len(curve["centre"]) for curve in curves))
        for axes, curve in zip(panels, curves, strict=True):
            _panel(axes, curve, reach)
        if not curves:
            say(figure.add_subplot(grid[0, :]), "There is no residual to show.", characters=80)
        below = figure.add_subplot(grid[rows, :])
        below.set_axis_off()
        below.text(0.0, 1.0, "\n".join(words), va="top", transform=below.transAxes, linespacing=1.35)
        if curves:
            legend(figure, _handles(found), columns=3)


def _curves(found: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the curves, those of what stays unexplained first, each covariate once."""
    left = found["unexplained"]["curves"] if found["unexplained"] else []
    every = {curve["covariate"]: curve for curve in [*found.get("curves", []), *left]}
    first = [curve["covariate"] for curve in left]
    return [every[name] for name in dict.fromkeys([*first, *every]) if len(every[name]["centre"]) > 1]


def _panel(axes: Axes, curve: Mapping[str, Any], reach: float) -> None:
    x, before, after, sigma = (
        np.array(curve[key], dtype=float) for key in ("centre", "before_deg", "after_deg", "sigma_deg")
    )
    covariate = curve["covariate"]
    x = x / DAY_S if covariate == "time" else x
    band = reach * sigma
    axes.fill_between(x, -band, band, color=GREY, alpha=0.25, linewidth=0)
    axes.axhline(0.0, color=GREY, linewidth=0.6)
    if covariate.startswith(TURN):
        axes.plot(x, x, color=BLACK, linewidth=0.6, linestyle="--")
    if np.any(before != after):
        axes.plot(x, before, color=VERMILION, marker="o", markersize=2.5)
    axes.plot(x, after, color=BLUE, marker="s", markersize=2.5)
    axes.set_ylabel("Residual (°)")
    axes.set_xlabel(_label(covariate, NAMES, UNITS))
    if covariate == "time":
        axes.xaxis.set_major_locator(locator := AutoDateLocator(maxticks=6))
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    elif covariate == "heading":
        degrees(axes.xaxis, (0.0, 360.0))


def _label(covariate: str, names: Mapping[str, str], units: Mapping[str, str]) -> str:
    """Return what an axis is called: the covariate's name, and the unit that the sentences have, abbreviated."""
    name = names.get(covariate, covariate.replace("_", " ").capitalize())
    unit = "degrees" if covariate.startswith(TURN) else units.get(covariate, "")
    unit = unit.replace("degrees C", "°C").replace("degrees", "°")
    return f"{name} ({unit})" if unit else name


def _simultaneous(bins: int) -> float:
    """Return how many standard errors a band reaches that all bins of noise stay within, 95 times in 100 (Šidák)."""
    return NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / max(bins, 1)))


def _words(found: Mapping[str, Any]) -> list[str]:
    texts = [_finding(k, finding) for k, finding in enumerate(found["findings"], start=1)]
    texts += [found["unexplained"]["text"]] if found["unexplained"] else []
    texts += [f"What would separate them: {plain(found['separated_by'])}."] if found["separated_by"] else []
    texts += [found["why"][0].upper() + found["why"][1:].rstrip(".") + "."] if found.get("why") else []
    texts += [f"Too small to matter: {_small(found['negligible'])}."] if found.get("negligible") else []
    absent = dict.fromkeys(plain(one["effect"]) for one in found["not_testable"])
    texts += [f"Not testable here: {', '.join(absent)}."] if absent else []
    return [line for text in texts for line in textwrap.wrap(text, CHARACTERS)]


def _finding(number: int, finding: Mapping[str, Any]) -> str:
    others = [plain(effect) for effect in finding["alternatives"]]
    rival = f"; also possible: {', '.join(others)}" if others else ""
    return f"{number}. {plain(finding['effect']).capitalize()} ({finding['side']} side{rival}). {finding['text']}"


def _small(negligible: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{plain(one['effect'])} ({one['rms_effect_deg']:.2f}°)" for one in negligible)


def _handles(found: Mapping[str, Any]) -> list[Any]:
    beside = any(finding["effect"] != "large_deviation" for finding in found["findings"])
    alone = Line2D([], [], color=VERMILION, marker="o", markersize=3, label="fit alone")
    label = "with what was found" if beside else "what the fit leaves"
    return [
        *([alone] if beside else []),
        Line2D([], [], color=BLUE, marker="s", markersize=3, label=label),
        Patch(color=GREY, alpha=0.25, linewidth=0, label="95 % band of all panels together"),
    ]


# Of a calibration: also how well each effect does alone.

COLUMNS, ROW_IN = 2, 2.1
MOST_CURVES, MOST_BARS = 5, 10
NAMES_OF_CALIBRATIONS = {
    "heading": "Heading", "time": "Time since the begin (h)", "reading": "Number of the reading",
    "turn_rate": "Rate of turn",
}  # fmt: skip
RESIDUAL = "Observed − simulated (°)"
BEFORE: dict[str, Any] = {"color": RECORDED, "marker": "o", "markersize": 3.0, "linewidth": 0.8}
AFTER: dict[str, Any] = {"color": CORRECTED, "marker": "s", "markersize": 3.0, "linewidth": 0.8}


def of_calibration(path: str | Path, content: Mapping[str, Any], name: str) -> None:
    """Draw a calibration's diagnosis: binned residuals with their simultaneous band, and the hypotheses."""
    curves, ranked = content["curves"][:MOST_CURVES], content["hypotheses"][:MOST_BARS]
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
            legend(figure, _handles_of_calibration())


def _notes(content: Mapping[str, Any]) -> list[str]:
    return [one["text"] for one in content["findings"]] or [content["why"]]


def _handles_of_calibration() -> list[Line2D | Patch]:
    band = Patch(color=GREY, alpha=0.3, linewidth=0, label="what noise leaves in all bins, 95 %")
    return [Line2D([], [], label="before", **BEFORE), Line2D([], [], label="after", **AFTER), band]


def _residual(axes: Axes, curve: Mapping[str, Any]) -> None:
    centre, before, after, sigma = (
        np.array(curve[key], dtype=float) for key in ("centre", "before_deg", "after_deg", "sigma_deg")
    )
    if curve["covariate"] == "time" and len(centre):
        centre = (centre - centre[0]) / 3600.0
    half = _simultaneous(len(centre)) * sigma
    axes.fill_between(centre, -half, half, color=GREY, alpha=0.3, linewidth=0)
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    axes.plot(centre, before, **BEFORE)
    axes.plot(centre, after, **AFTER)
    axes.set_xlabel(_label(curve["covariate"], NAMES_OF_CALIBRATIONS, UNITS_OF_CALIBRATIONS))
    axes.set_ylabel(RESIDUAL)
    axes.set_title(curve.get("compared", ""))
    if curve["covariate"] == "heading":
        degrees(axes.xaxis, (0.0, 360.0))


def _ranking(axes: Axes, ranked: Sequence[Mapping[str, Any]], named: Sequence[str]) -> None:
    """Draw how well each effect does alone; those that were named in the end stand out."""
    place = np.arange(len(ranked))[::-1]
    colours = [VERMILION if one["effect"] in named else GREY for one in ranked]
    axes.barh(place, [max(one["score"], 0.0) for one in ranked], color=colours, height=0.7)
    axes.set_xscale("symlog", linthresh=10.0)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
    axes.set_yticks(place, [plain(one["effect"]) for one in ranked])
    axes.set_xlabel("Score alone (named: red)")
    axes.set_xlim(0.0, max(10.0, 1.1 * max(one["score"] for one in ranked)))
