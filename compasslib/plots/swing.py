"""A swing as the page that goes with a compass: curve, table of deviations, coefficients, verdict, place and date."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import Bbox

from compasslib.calibration.result import LETTERS, Calibration
from compasslib.calibration.swing import nullify
from compasslib.core.types import Floats
from compasslib.deviation import von_appen
from compasslib.plots.page import BLUE, GREY, VERMILION, degrees, legend, page, say

TWO_SIGMA = nullify.TWO_SIGMA
STEP_DEG = 1.0
FULL = (0.0, 360.0)
MOST_POINTS = 2000
TEXT_CHARACTERS = 54
MINUS = "\N{MINUS SIGN}"


def swing(path: str | Path, result: Calibration, name: str) -> None:
    """Draw the page of a swing; where nothing could be fitted it says why."""
    notes = [_where(result.details), *([f"No deviation was fitted: {result.why}."] if result.why else [])]
    with page(path, f"{name}: compass deviation by swing, headings to magnetic north", 6.6, notes) as figure:
        above, below = figure.subplots(2, 1, height_ratios=(1.0, 1.15))
        _curve(above, result)
        below.set_axis_off()
        if result.table is None:
            return
        left, right = below.inset_axes((0.0, 0.0, 0.52, 1.0)), below.inset_axes((0.55, 0.0, 0.45, 1.0))
        _table(left, result.table)
        _words(right, result)
        legend(figure, _handles(result), columns=4)


def _where(details: Any) -> str:
    latitude, longitude = details.get("latitude"), details.get("longitude")
    place = "place not given"
    if latitude is not None and longitude is not None:
        north, east = "N" if latitude >= 0 else "S", "E" if longitude >= 0 else "W"
        place = f"{abs(latitude):.3f}° {north} {abs(longitude):.3f}° {east}"
    speed = details.get("speed_kn")
    facts = [place, details.get("date") or "date not given", f"declination {_signed(details['declination_deg'])}°"]
    return ", ".join(facts + ([f"speed {speed:.1f} kn"] if speed else []))


def _curve(axes: Axes, result: Calibration) -> None:
    degrees(axes.xaxis, FULL)
    axes.set(xlabel="Recorded heading γ (°)", ylabel="Deviation Δ = β − γ (°)")
    shown = result.points.get("deviation_deg")
    if result.table is None or shown is None:
        say(axes, "There is no curve to show.")
        return
    heading = np.arange(0.0, 360.0 + STEP_DEG / 2.0, STEP_DEG)
    columns = von_appen.design(heading)
    curve = columns @ result.coefficients
    half = TWO_SIGMA * np.sqrt(np.einsum("ij,jk,ik->i", columns, result.covariance, columns))
    few = slice(None, None, 1 + len(shown) // MOST_POINTS)
    size = 2.0 if len(shown) > 100 else 4.0
    axes.fill_between(heading, curve - half, curve + half, color=BLUE, alpha=0.2, linewidth=0)
    axes.plot(result.points["recorded_deg"][few], shown[few], "o", color="#333333", markersize=size, markeredgewidth=0)
    axes.plot(heading, curve, color=BLUE)
    for limit in (-nullify.LIMIT_DEG, nullify.LIMIT_DEG):
        axes.axhline(limit, color=VERMILION, linewidth=0.8, linestyle="--")
    _level(axes, np.concatenate([curve - half, curve + half, *np.percentile(shown, [[1.0], [99.0]])]))


def _level(axes: Axes, values: Floats) -> None:
    low, high = min(float(values.min()), -nullify.LIMIT_DEG), max(float(values.max()), nullify.LIMIT_DEG)
    margin = 0.06 * (high - low)
    axes.set_ylim(low - margin, high + margin)
    axes.yaxis.set_major_formatter(lambda x, _: f"{x:g}".replace("-", MINUS))
    axes.axhline(0.0, color=GREY, linewidth=0.5)


def _table(axes: Axes, table: Any) -> None:
    """Write the table of deviations, two headings a line so that a step of 10 degrees fits."""
    axes.set_axis_off()
    half = (len(table.heading_deg) + 1) // 2
    cells = [[cell for k in (row, row + half) for cell in _cells(table, k)] for row in range(half)]
    names = ["Compass", "Deviation", "± 95 %"] * 2
    drawn = axes.table(cells, colLabels=names, loc="upper left", bbox=Bbox.unit(), cellLoc="center", edges="B")
    drawn.auto_set_font_size(False)
    drawn.set_fontsize(7.0)
    for cell in drawn.get_celld().values():
        cell.set(linewidth=0.3, edgecolor=GREY)


def _cells(table: Any, k: int) -> tuple[str, str, str]:
    if k >= len(table.heading_deg):
        return "", "", ""
    return (
        f"{table.heading_deg[k]:03.0f}°",
        f"{_signed(table.deviation_deg[k])}°",
        f"{TWO_SIGMA * table.sigma_deg[k]:.1f}°",
    )


def _words(axes: Axes, result: Calibration) -> None:
    axes.set_axis_off()
    sigma = np.sqrt(np.diag(result.covariance))
    lines = ["Coefficients (95 %), series in the recorded heading"]
    lines += [
        f"    {k}   {_signed(x, 2)}° ± {TWO_SIGMA * s:.2f}°"
        for k, x, s in zip(LETTERS, result.coefficients, sigma, strict=True)
    ]
    sentences = [
        f"{result.n} observations in {result.coverage} of 36 sectors, residual {result.residual_rms_deg:.2f}° rms."
    ]
    sentences += [result.details["iso_25862"]["text"], *result.details["iso_25862"]["conditions"]]
    sentences += [result.details["nullify"]["text"]]
    lines += ["", *(line for sentence in sentences for line in textwrap.wrap(sentence, TEXT_CHARACTERS))]
    axes.text(0.0, 1.0, "\n".join(lines), transform=axes.transAxes, va="top", fontsize=7.2, linespacing=1.35)


def _handles(result: Calibration) -> list[Any]:
    drift = result.details.get("drift")
    seen = "courses, water taken off" if drift else "true headings"
    return [
        Line2D([], [], color="#333333", marker="o", linestyle="", markersize=3, label=seen),
        Line2D([], [], color=BLUE, label="series, least squares"),
        Patch(color=BLUE, alpha=0.2, linewidth=0, label="95 %"),
        Line2D([], [], color=VERMILION, linewidth=0.8, linestyle="--", label="4° (ISO 25862)"),
    ]


def _signed(x: float, digits: int = 1) -> str:
    return f"{x:+.{digits}f}".replace("-", MINUS)
