"""Two heads on one frame: their difference by heading, what their tilts say of the frame, the offset along time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.two_heads.motion import down, lean, tilt_angles
from compasslib.deviation import von_appen
from compasslib.plots.page import (
    BLACK,
    BLUE,
    DAY_S,
    GREEN,
    GREY,
    MAGNETIC,
    ORANGE,
    VERMILION,
    dates,
    degrees,
    empty,
    legend,
    page,
    signed,
)
from compasslib.statistics import blocks
from compasslib.types import Floats

DRAWN = 8_000
WITHIN = 1.96
STRETCHES = 40
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.6, "markeredgewidth": 0, "color": GREY}
SHOWN: dict[str, Any] = POINT | {"markersize": 3.0}  # in a legend
MEAN: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3.5, "color": BLACK, "markeredgewidth": 0}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}
SINGLE, STRETCH_MEANS = "single samples", "block means"


def difference(path: str | Path, found: Calibration, name: str) -> None:
    """Draw what b must add to agree with a, by b's recorded heading, and what the series leaves of it."""
    with page(path, 4.4) as figure:
        panels = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
        if not found.points or found.table is None:
            _empty(panels)
            return
        heading, thin = found.points["recorded_b_deg"], _thin(found)
        panels[0].plot(heading[thin], found.points["deviation_deg"][thin], **POINT)
        panels[1].plot(heading[thin], found.points["residual_deg"][thin], **POINT)
        _curve(panels[0], found)
        _sector_means(panels[1], found)
        _limits(panels[0], found.points["deviation_deg"], panels[0].lines[-1].get_ydata())
        _limits(panels[1], found.points["residual_deg"])
        panels[0].set_ylabel("Deviation of b\nagainst a (°)")
        panels[1].set_ylabel("Residual (°)")
        panels[1].set_xlabel("Recorded heading of b (° magnetic)")
        degrees(panels[1].xaxis, (0.0, 360.0))
        figure.align_ylabels(panels)
        terms = f"fit of {found.model.split(': ')[-1]}" if found.coefficients.size else "offset only"
        curve = Line2D([], [], color=GREEN, label=terms)
        legend(figure, [Line2D([], [], label=SINGLE, **SHOWN), curve, Patch(label="95 % of the curve", **BAND)])


def tilt_check(path: str | Path, found: Calibration, name: str) -> None:
    """Draw b's tilts against a's, turned into b's body by one rotation, and the angle that is left along time."""
    with page(path, 4.2) as figure:
        panels = figure.subplot_mosaic([["pitch", "roll"], ["left", "left"]], height_ratios=(2.0, 1.0))
        if "frame" not in found.details:
            _empty(list(panels.values()))
            return
        turned = _turned_tilts(found)
        for key, here in (("pitch", turned[0]), ("roll", turned[1])):
            _against(panels[key], key, here, found)
        _along(panels["left"], found, found.points["tilt_residual_deg"])
        panels["left"].set_ylim(bottom=0.0)
        panels["left"].set_ylabel("Angle between\nverticals (°)")
        one = Line2D([], [], color=BLACK, linewidth=0.8, label="equal")
        mean = Line2D([], [], label=STRETCH_MEANS, **MEAN)
        legend(figure, [Line2D([], [], label=SINGLE, **SHOWN), one, mean])


def along_time(path: str | Path, found: Calibration, name: str) -> None:
    """Draw the offset between the heads along time, and how the frame turned."""
    with page(path, 4.8) as figure:
        panels = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        if not found.points or "frame" not in found.details:
            _empty(panels)
            return
        offset = found.details["offset_deg"]
        # Without the heading-dependent part: what is left should be level.
        _along(panels[0], found, offset - found.points["residual_deg"])
        handles = [Line2D([], [], label=SINGLE, **SHOWN), Line2D([], [], label=STRETCH_MEANS, **MEAN)]
        handles.append(_level(panels[0], offset, found.details["offset_sigma_deg"], "headings", BLUE))
        if found.details["offset_from_tilts_deg"] is not None:
            near = offset + float(angles.difference(found.details["offset_from_tilts_deg"], offset))
            handles.append(_level(panels[0], near, found.details["offset_from_tilts_sigma_deg"], "tilts", ORANGE))
        panels[0].set_xlabel("")
        panels[0].set_ylabel("Offset of b\nfrom a (°)")
        thin, days = _thin(found), found.points["time_s"] / DAY_S
        for key, colour in (("a", BLUE), ("b", VERMILION)):
            panels[1].plot(days[thin], found.points[f"recorded_{key}_deg"][thin], **{**POINT, "color": colour})
            handles.append(Line2D([], [], **{**SHOWN, "color": colour}, label=f"head {key}"))
        degrees(panels[1].yaxis, (0.0, 360.0))
        panels[1].set_ylabel(f"Recorded heading\n{MAGNETIC}")
        _by_clock(panels[1])
        figure.align_ylabels(panels)
        legend(figure, handles, columns=1)


def _empty(panels: Any) -> None:
    for axes in panels:
        empty(axes)


def _thin(found: Calibration) -> slice:
    return slice(None, None, max(1, len(found.points["time_s"]) // DRAWN))


def _curve(axes: Axes, found: Calibration) -> None:
    """Draw the series between the table's headings by its own coefficients, the band by the table's."""
    assert found.table is not None
    fine = np.arange(0.0, 360.5, 1.0)
    heading = np.append(found.table.heading_deg, 360.0)
    sigma = np.interp(fine, heading, np.append(found.table.sigma_deg, found.table.sigma_deg[0]))
    terms = np.isfinite(found.coefficients)
    value = von_appen.design(fine)[:, : terms.size][:, terms] @ found.coefficients[terms]
    value = np.where(np.isfinite(sigma), value, np.nan)
    axes.fill_between(fine, value - WITHIN * sigma, value + WITHIN * sigma, **BAND)
    axes.plot(fine, value, color=GREEN)


def _sector_means(axes: Axes, found: Calibration) -> None:
    kept = found.points["kept"] > 0
    residual = found.points["residual_deg"][kept]
    sector = (found.points["recorded_b_deg"][kept] / 10.0).astype(int)
    # A stretch of time counts once in a sector: samples that follow each other are not independent.
    visit = np.unique(36 * blocks.in_time(found.points["time_s"], STRETCHES)[kept] + sector, return_inverse=True)
    means = np.bincount(visit[1], residual) / np.bincount(visit[1])
    place = visit[0] - 36 * (visit[0] // 36)
    count = np.bincount(place, minlength=36)
    there = count >= 3
    mean, square = (np.bincount(place, x, 36)[there] / count[there] for x in (means, means**2))
    error = WITHIN * np.sqrt(np.maximum(square - mean**2, 0.0) / (count[there] - 1.0))
    style = {**MEAN, "markersize": 3.0, "elinewidth": 0.8}
    axes.errorbar(10.0 * np.flatnonzero(there) + 5.0, mean, yerr=error, **style)
    axes.axhline(0.0, color=GREEN, linewidth=0.8)


def _limits(axes: Axes, points: Floats, line: Any = ()) -> None:
    """Hold 99 % of the points and the whole line."""
    low, high = np.percentile(points, (0.5, 99.5))
    curve = np.asarray(line, dtype=float)
    curve = curve[np.isfinite(curve)]
    low, high = min([low, *curve]), max([high, *curve])
    room = max(0.08 * (high - low), 0.2)
    axes.set_ylim(low - room, high + room)


def _turned_tilts(found: Calibration) -> tuple[Floats, Floats]:
    there = down(lean(found.points["pitch_a_deg"], found.points["roll_a_deg"]))
    turned = there @ np.array(found.details["frame"]["rotation"]).T
    return tilt_angles(turned[:, 0] + 1j * turned[:, 1])


def _against(axes: Axes, key: str, turned: Floats, found: Calibration) -> None:
    own, thin = found.points[f"{key}_b_deg"], _thin(found)
    axes.plot(turned[thin], own[thin], **POINT)
    low, high = np.percentile(np.concatenate([turned, own]), (0.2, 99.8))
    room = max(0.06 * (high - low), 0.1)
    ends = (low - room, high + room)
    axes.plot(ends, ends, color=BLACK, linewidth=0.8)
    axes.set(xlim=ends, ylim=ends, aspect="equal")
    axes.set_xlabel(f"{key.capitalize()} of a, turned (°)")
    axes.set_ylabel(f"{key.capitalize()} of b (°)")


def _along(axes: Axes, found: Calibration, values: Floats) -> None:
    time, thin = found.points["time_s"], _thin(found)
    axes.plot(time[thin] / DAY_S, values[thin], **POINT)
    kept = found.points["kept"] > 0
    stretch = blocks.in_time(time, STRETCHES)
    for k in np.unique(stretch[kept]):
        mine = kept & (stretch == k)
        axes.plot(time[mine].mean() / DAY_S, values[mine].mean(), **MEAN)
    _limits(axes, values)
    _by_clock(axes)


def _level(axes: Axes, value: float, sigma: float, source: str, colour: str) -> Line2D:
    axes.axhspan(value - WITHIN * sigma, value + WITHIN * sigma, color=colour, alpha=0.25, linewidth=0)
    label = f"offset by {source}: {signed(value, '.2f')}° ± {WITHIN * sigma:.2f}° (95 %)"
    return axes.axhline(value, color=colour, linewidth=1.0, label=label)


def _by_clock(axes: Axes) -> None:
    dates(axes)
    axes.set_xlabel("b's clock (UTC)")
