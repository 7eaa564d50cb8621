"""An observatory's declination: the series against the model, and what constant and quiet day leave, storms marked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.calibrations.result import Calibration
from compasslib.plots.page import (
    BLACK,
    DAY_S,
    GREEN,
    GREY,
    ORANGE,
    SKY,
    VERMILION,
    Limits,
    dates,
    empty,
    legend,
    page,
    signed,
)
from compasslib.types import Floats

WITHIN = 1.96
GAP = 3.0  # times the usual step at which a line is broken
MOST_DAYS = 10  # of a longer record the quiet day would be a smear
ZOOM_DAYS = 3.0  # of a longer record the days around its largest storm are drawn too
LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.8}
STORM: dict[str, Any] = {"color": VERMILION, "alpha": 0.18, "linewidth": 0}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}


def series(path: str | Path, found: Calibration, name: str) -> None:
    """Draw the declination with the model, the model plus the constant, and the quiet day on top of it."""
    quiet = found.details["quiet_day"] if found.points else None
    with page(path, 4.8 if quiet else 3.2) as figure:
        top, *below = figure.subplots(2 if quiet else 1, 1, squeeze=False, height_ratios=(1.5, 1.0) if quiet else None)[
            :, 0
        ]
        if not found.points:
            empty(top)
            return
        points, constant = found.points, found.details["constant_deg"]
        _line(top, points, points["declination_deg"], **LINE)
        _line(top, points, points["model_deg"], color=GREY, linewidth=1.2, linestyle=(0, (4, 2)))
        shown = bool(quiet) and found.details["days"] <= MOST_DAYS
        if shown:
            _line(top, points, points["model_deg"] + constant + points["quiet_day_deg"], color=SKY, linewidth=1.0)
        _line(top, points, points["model_deg"] + constant, color=GREEN, linewidth=1.2)
        _finish(top, found, "Declination (° east)")
        for axes in below:
            _quiet_day(axes, found.details["quiet_day"])
        model = found.model.removesuffix(" plus a constant")
        sigma = WITHIN * found.details["constant_sigma_deg"]
        handles: list[Artist] = [
            Line2D([], [], label="observed", **LINE),
            Line2D([], [], color=GREY, linestyle=(0, (4, 2)), label=model),
            Line2D([], [], color=GREEN, label=f"{model} {signed(constant, '+.3f')}° ± {sigma:.3f}° (95 %)"),
        ]
        handles += [Line2D([], [], color=SKY, label="with the quiet-day variation")] if shown else []
        legend(figure, handles + _storm_handle(found), columns=1)


def disturbance(path: str | Path, found: Calibration, name: str) -> None:
    """Draw what constant, slow level and quiet day leave, with the band of 95 % of its calm hours."""
    with page(path, 4.4) as figure:
        panels = figure.subplots(2, 1)
        if not found.points:
            for axes in panels:
                empty(axes)
            return
        points = found.points
        _line(panels[0], points, points["residual_deg"], **LINE)
        _line(panels[0], points, points["level_deg"] - found.details["constant_deg"], color=ORANGE, linewidth=1.2)
        _line(panels[1], points, points["disturbance_deg"], **LINE)
        calm = points["disturbance_deg"][points["storm"] == 0.0]
        half = float(np.quantile(np.abs(calm), 0.95)) if calm.size else 0.0
        panels[1].axhspan(-half, half, **BAND)
        _finish(panels[0], found, "Observed minus model\nand constant (°)")
        _finish(panels[1], found, "Without slow level\nand quiet day (°)", _around_the_largest(found))
        figure.align_ylabels(panels)
        handles: list[Artist] = [Line2D([], [], label="observed, 10-minute means or samples", **LINE)]
        handles.append(Line2D([], [], color=ORANGE, label="slow level"))
        handles.append(Patch(label=f"95 % range of calm hours: ±{half:.2f}°", **BAND))
        legend(figure, handles + _storm_handle(found), columns=1)


def _quiet_day(axes: Axes, quiet: Mapping[str, Any]) -> None:
    axes.plot(np.arange(24) + 0.5, np.array(quiet["by_hour_deg"]), color=SKY, marker="o", markersize=3)
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    axes.set(xlim=(0, 24), xticks=range(0, 25, 3), xlabel="Hour (UTC)", ylabel="Quiet day (°)")


def _line(axes: Axes, points: Mapping[str, Floats], values: Floats, **look: Any) -> None:
    """Draw a series along time, broken at gaps."""
    time = points["time_s"]
    step = np.diff(time)
    ends = np.flatnonzero(step > GAP * np.median(step)) + 1
    axes.plot(np.insert(time, ends, time[ends]) / DAY_S, np.insert(values, ends, np.nan), **look)


def _finish(axes: Axes, found: Calibration, label: str, window: Limits | None = None) -> None:
    for storm in found.details["storms"]:
        axes.axvspan(*(_day(storm[end]) for end in ("from", "to")), **STORM)
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    if window:
        axes.set_xlim(window)
    dates(axes)


def _day(stamp: str) -> float:
    return float(np.datetime64(stamp.removesuffix("Z"), "s").astype(float)) / DAY_S


def _storm_handle(found: Calibration) -> list[Artist]:
    storms = found.details["storms"]
    if not storms:
        return []
    largest = max(storms, key=lambda one: one["range_deg"])
    return [Patch(label=f"storm: {len(storms)}, largest range {largest['range_deg']:.1f}°", **STORM)]


def _around_the_largest(found: Calibration) -> Limits | None:
    storms = found.details["storms"]
    if not storms or np.ptp(found.points["time_s"]) < 3.0 * ZOOM_DAYS * DAY_S:
        return None
    largest = max(storms, key=lambda one: one["range_deg"])
    return _day(largest["from"]) - ZOOM_DAYS / 2.0, _day(largest["to"]) + ZOOM_DAYS / 2.0
