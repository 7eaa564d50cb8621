"""What the search for left-out physics found: where the recording leaves its simulation, and what explains it."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.plots.page import BLUE, GREY, LINE_IN, VERMILION, degrees, legend, page, say
from compasslib.search.wording import VERDICTS

DAY_S = 86400.0  # matplotlib counts time in days since 1970
MOST_PANELS = 6
PANEL_IN = 1.75
CHARACTERS = 112
AXES = {
    "heading": "Recorded heading (°)",
    "time": "",
    "pitch": "Pitch (°)",
    "roll": "Roll (°)",
    "depth": "Depth (m)",
    "separation": "Distance of the two layers (m)",
    "speed": "Speed of the upper water (m/s)",
    "hour_of_day": "Hour of the day (UTC)",
    "temperature": "Temperature (°C)",
    "supply_voltage": "Supply voltage (as recorded)",
}


def diagnosis(path: str | Path, found: Mapping[str, Any], name: str) -> None:
    """Draw a diagnosis: binned residual before and after along each covariate, and the findings in words.

    Args:
        found: content of diagnosis.json.
        name: of the mooring or calibration.
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
    if np.any(before != after):
        axes.plot(x, before, color=VERMILION, marker="o", markersize=2.5)
    axes.plot(x, after, color=BLUE, marker="s", markersize=2.5)
    axes.set_ylabel("Residual (°)")
    axes.set_xlabel(AXES.get(covariate, covariate))
    if covariate == "time":
        axes.xaxis.set_major_locator(locator := AutoDateLocator(maxticks=6))
        axes.xaxis.set_major_formatter(ConciseDateFormatter(locator))
    elif covariate == "heading":
        degrees(axes.xaxis, (0.0, 360.0))


def _simultaneous(bins: int) -> float:
    """Return how many standard errors a band reaches that all bins of noise stay within, 95 times in 100 (Šidák)."""
    from statistics import NormalDist

    return NormalDist().inv_cdf(0.5 + 0.5 * 0.95 ** (1.0 / max(bins, 1)))


def _words(found: Mapping[str, Any]) -> list[str]:
    said = [_finding(k, finding) for k, finding in enumerate(found["findings"], start=1)]
    said += [found["unexplained"]["text"]] if found["unexplained"] else []
    said += [f"What would separate them: {_plain(found['separated_by'])}."] if found["separated_by"] else []
    said += [found["why"][0].upper() + found["why"][1:].rstrip(".") + "."] if found.get("why") else []
    said += [f"Too small to matter: {_small(found['negligible'])}."] if found.get("negligible") else []
    absent = dict.fromkeys(_plain(one["effect"]) for one in found["not_testable"])
    said += [f"Not testable here: {', '.join(absent)}."] if absent else []
    return [line for text in said for line in textwrap.wrap(text, CHARACTERS)]


def _finding(number: int, finding: Mapping[str, Any]) -> str:
    others = [_plain(effect) for effect in finding["alternatives"]]
    rival = f"; also possible: {', '.join(others)}" if others else ""
    return f"{number}. {_plain(finding['effect']).capitalize()} ({finding['side']} side{rival}). {finding['text']}"


def _small(negligible: Sequence[Mapping[str, Any]]) -> str:
    return ", ".join(f"{_plain(one['effect'])} ({one['rms_effect_deg']:.2f}°)" for one in negligible)


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _handles(found: Mapping[str, Any]) -> list[Any]:
    beside = any(finding["effect"] != "large_deviation" for finding in found["findings"])
    alone = Line2D([], [], color=VERMILION, marker="o", markersize=3, label="fit alone")
    label = "with what was found" if beside else "what the fit leaves"
    return [
        *([alone] if beside else []),
        Line2D([], [], color=BLUE, marker="s", markersize=3, label=label),
        Patch(color=GREY, alpha=0.25, linewidth=0, label="95 % band of all panels together"),
    ]
