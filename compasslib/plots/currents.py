"""The current before and after the correction: sticks along time, progressive vectors, roses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from compasslib import angles
from compasslib.archive import currents
from compasslib.archive.currents import HOUR_S, Currents, Flow
from compasslib.plots import curves
from compasslib.plots.page import CORRECTED, DAY_S, RECORDED, REFERENCE, dates, empty, legend, page
from compasslib.types import Complexes, Floats

COLOURS = {"recorded": RECORDED, "corrected": CORRECTED, "reference": REFERENCE}
LINES: dict[str, dict[str, Any]] = {name: {"color": colour} for name, colour in COLOURS.items()}
LINES["reference"] |= {"linewidth": 3.0, "alpha": 0.6, "zorder": 1.5}  # the corrected one often lies on it
CM, KM = 100.0, 1e-3
STICK: dict[str, Any] = {
    "angles": "uv", "scale_units": "y", "scale": 1.0, "units": "inches", "width": 0.007,
    "headwidth": 0.0, "headlength": 0.0, "headaxislength": 0.0,
}  # fmt: skip


@dataclass(frozen=True)
class Averaged:
    """Currents as means over equal spans of time."""

    begin_s: float
    hours: float
    means: Mapping[str, Complexes]  # (n,) each, m/s; NaN where a span has none; those that have any

    @property
    def middle_s(self) -> Floats:
        """Return the middle of each span, (n,)."""
        count = len(next(iter(self.means.values()), ()))
        return self.begin_s + self.hours * HOUR_S * (np.arange(count) + 0.5)


def averaged(shown: Currents, reference: Flow) -> Averaged:
    """Return recorded and corrected current, and the reference's where it overlaps, as means of the same spans."""
    time_s = shown.recorded.time_s
    hours = currents.span_of_means(time_s)
    begin_s = float(time_s[0]) if len(time_s) else 0.0
    count = int((time_s[-1] - begin_s) / (hours * HOUR_S)) + 1 if len(time_s) else 0
    flows = {"recorded": shown.recorded, "corrected": shown.corrected, "reference": reference}
    means = {name: currents.means(flow, begin_s, hours, count) for name, flow in flows.items()}
    return Averaged(begin_s, hours, {name: mean for name, mean in means.items() if np.isfinite(mean).any()})


def sticks(path: str | Path, drawn: Averaged) -> None:
    """Draw each mean current as a stick from its time towards where the water goes, north up."""
    with page(path, 0.55 + 0.95 * max(len(drawn.means), 1)) as figure:
        panels = figure.subplots(max(len(drawn.means), 1), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        if not drawn.means:
            empty(panels[0])
            return
        north = CM * np.concatenate([[0.0], *(mean.imag for mean in drawn.means.values())])
        low, high = float(np.nanmin(north)), float(np.nanmax(north))
        room = max(0.05 * (high - low), 0.5)
        for axes, (name, mean) in zip(panels, drawn.means.items(), strict=True):
            there = np.isfinite(mean)
            u, v = CM * mean[there].real, CM * mean[there].imag
            axes.quiver(drawn.middle_s[there] / DAY_S, np.zeros(u.shape), u, v, color=COLOURS[name], **STICK)
            axes.axhline(0.0, color=COLOURS[name], linewidth=0.5)
            axes.set_ylabel(f"{name.capitalize()}\n(cm/s)")
            axes.set_ylim(low - room, high + room)
            axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        half_s = drawn.hours * HOUR_S / 2.0
        dates(panels[-1], (drawn.middle_s[0] - half_s, drawn.middle_s[-1] + half_s))
        figure.align_ylabels(panels)


def progressive(path: str | Path, drawn: Averaged) -> None:
    """Draw where water would go that moved as the means say, over the spans that all of them have."""
    paths = ways(drawn)
    every = KM * np.concatenate([*paths.values(), [0.0]])
    wide, high = float(np.ptp(every.real)), float(np.ptp(every.imag))
    with page(path, 0.9 + 2.7 * float(np.clip(high / max(wide, 1e-9), 0.4, 1.1))) as figure:
        axes = figure.subplots()
        if not paths:
            empty(axes)
            return
        for name, way in paths.items():
            axes.plot(KM * way.real, KM * way.imag, **LINES[name])
            axes.plot(KM * way.real[-1], KM * way.imag[-1], "o", color=COLOURS[name], markersize=4)
        axes.plot(0.0, 0.0, "k+", markersize=7)
        axes.set(xlabel="East (km)", ylabel="North (km)")
        axes.set_aspect("equal", adjustable="datalim")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        handles = [Line2D([], [], **LINES[name], label=name) for name in paths]
        begin = Line2D([], [], color="k", marker="+", linestyle="", label="begin")
        legend(figure, [*handles, begin], columns=4)


def ways(drawn: Averaged) -> dict[str, Complexes]:
    """Return the way from the begin, (k,) metres east + i north, over the spans that all have."""
    both = np.all([np.isfinite(mean) for mean in drawn.means.values()], axis=0)
    steps = {name: mean[both] * drawn.hours * HOUR_S for name, mean in drawn.means.items()}
    return {name: np.concatenate([[0.0], np.cumsum(step)]) for name, step in steps.items()}


def roses(path: str | Path, shown: Currents, reference: Flow, headings: Mapping[str, Floats]) -> None:
    """Draw how often the current goes each way, and how often the instrument headed each way, before and after.

    Args:
        headings: ``recorded`` and ``corrected`` ones, (n,) degrees each.
    """
    flows = {"recorded": shown.recorded, "corrected": shown.corrected, "reference": reference}
    towards = {name: angles.direction(flow.velocity.real, flow.velocity.imag) for name, flow in flows.items()}
    handles: dict[str, Any] = {name: Line2D([], [], color=colour, label=name) for name, colour in COLOURS.items()}
    handles["reference"] = Patch(color=REFERENCE, alpha=0.5, linewidth=0, label="reference")
    with page(path, 2.45) as figure:
        seen: set[str] = set()
        for k, (title, series) in enumerate((("Current towards", towards), ("Heading (magnetic)", headings))):
            known = {name: angle for name, angle in series.items() if np.isfinite(angle).any()}
            _rose(figure, k, title, known)
            seen |= set(known)
        legend(figure, [handle for name, handle in handles.items() if name in seen], columns=3)


def _rose(figure: Figure, place: int, title: str, series: Mapping[str, Floats]) -> None:
    """Draw the share of each sector of 10 degrees as its radius."""
    axes = figure.add_subplot(1, 2, place + 1, projection="polar")
    assert isinstance(axes, PolarAxes)
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    for name in sorted(series, key=list(COLOURS).index, reverse=True):
        _outline(axes, curves.sectors(series[name], 0.0), COLOURS[name], filled=name == "reference")
    axes.set_xticks(np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False), ["N", "E", "S", "W"])
    axes.yaxis.set_major_locator(MaxNLocator(3, integer=True))
    axes.yaxis.set_major_formatter("{x:.0f} %")
    axes.grid(linewidth=0.4)
    quarters = np.sum([curves.sectors(x, 0.0) for x in series.values()] or [np.zeros(36)], axis=0).reshape(4, -1)
    axes.set_rlabel_position(45.0 + 90.0 * float(np.argmin(quarters.max(axis=1))))  # where nothing hides its numbers
    axes.set_xlabel(f"{title}\n(% per 10°)")
    if not series:
        axes.set_yticks([])
        axes.annotate("no data", (0.5, 0.5), xycoords="axes fraction", ha="center", va="center")


def _outline(axes: Axes, shares: Floats, colour: str, *, filled: bool) -> None:
    edges = np.linspace(0.0, 2.0 * np.pi, len(shares) + 1)
    around, radius = np.repeat(edges, 2)[1:-1], np.repeat(shares, 2)
    if filled:
        axes.fill(around, radius, color=colour, alpha=0.5, linewidth=0)
    else:
        axes.plot(np.append(around, around[0]), np.append(radius, radius[0]), color=colour, linewidth=1.2)
