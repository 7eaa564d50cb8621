"""Figures of von Appen 2015 without recordings: the array (Fig. 2), the angles (Fig. 4), synthetic curves (Fig. 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Arc, Patch
from matplotlib.ticker import FixedLocator, MaxNLocator

from compasslib import angles
from compasslib.deviation.series import inverse_table, series_deviation, series_slope
from compasslib.plots.page import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WIDE_IN,
    degrees,
    empty,
    legend,
    page,
)
from compasslib.types import Floats

DEGREE_KM = 111.2
NAMED = 28  # moorings; more have no names in the figure
APART_KM, MOST_ARRAYS = 30.0, 6  # between moorings of different arrays; panels, more are one
ROLES = {"affected": VERMILION, "reference": BLUE, "other": GREY}
MARKERS = {"up": "^", "down": "v", None: "o"}
SYNTHETIC_B_DEG = {0.0: BLACK, 20.0: SKY, 45.0: GREEN, 57.29: PURPLE, 90.0: ORANGE, 135.0: VERMILION}
STEP_DEG = 0.5


def draw_array(path: str | Path, moorings: Sequence[Mapping[str, Any]]) -> None:
    """Draw the moorings along the line that they stand on: water depth, instruments, which way they look.

    Args:
        moorings: name, latitude, longitude (degrees), water_depth_m and instruments, each with depth_m (None of a
            profiler), orientation (up, down or None) and role (affected, reference or other).
    """
    groups = _split_arrays(moorings)
    with page(path, 3.8, width_in=WIDE_IN) as figure:
        if not groups:
            empty(figure.subplots())
            return
        ratios = [len(group) + 2 for group in groups]
        deepest = 1.08 * max(mooring["water_depth_m"] for mooring in moorings)
        panels = figure.subplots(1, len(groups), sharey=True, squeeze=False, width_ratios=ratios)[0]
        for axes, group in zip(panels, groups, strict=True):
            _draw_section(axes, group, deepest)
            if len(moorings) <= NAMED:
                # Name the moorings above the panel, upright where several stand in it.
                above = axes.secondary_xaxis("top")
                names = [str(mooring["name"]) for mooring in group]
                above.set_xticks(_along_array(group), names, rotation=90 * (len(names) > 1))
                above.tick_params(length=0)
        panels[0].set_ylim(deepest, -0.02 * deepest)
        panels[0].set_ylabel("Depth (m)")
        panels[int(np.argmax(ratios))].set_xlabel("Along the array (km)")
        point: dict[str, Any] = {"linestyle": "", "markersize": 5, "markeredgewidth": 0}
        handles: list[Artist] = [Line2D([], [], **point, marker="s", color=ROLES[role], label=role) for role in ROLES]
        handles += [Line2D([], [], **point, marker="^", color=BLACK, label="looks up")]
        handles += [Line2D([], [], **point, marker="v", color=BLACK, label="looks down")]
        handles += [Line2D([], [], color=BLACK, linewidth=3.0, alpha=0.5, label="profiler")]
        handles += [Patch(color=GREY, alpha=0.4, linewidth=0, label="bottom, interpolated")]
        legend(figure, handles, columns=4)


def _split_arrays(moorings: Sequence[Mapping[str, Any]]) -> list[list[Mapping[str, Any]]]:
    """Split moorings where the next along their line is further than an array's spacing; none where too many stand."""
    if not moorings:
        return []
    along = _along_array(moorings)
    order = np.argsort(along, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(along[order]) > APART_KM) + 1)
    parts = parts if len(parts) <= MOST_ARRAYS else [order]
    return [[moorings[k] for k in sorted(part)] for part in parts]


def _draw_section(axes: Axes, moorings: Sequence[Mapping[str, Any]], deepest_m: float) -> None:
    along, depth = _along_array(moorings), np.array([mooring["water_depth_m"] for mooring in moorings], dtype=float)
    order, room = np.argsort(along, kind="stable"), 0.05 * max(float(np.ptp(along)), 1.0)
    x = np.concatenate([[along.min() - room], along[order], [along.max() + room]])
    bottom = np.concatenate([depth[order][:1], depth[order], depth[order][-1:]])
    axes.fill_between(x, bottom, deepest_m, color=GREY, alpha=0.4, linewidth=0)
    for at, mooring in zip(along, moorings, strict=True):
        _draw_mooring(axes, float(at), mooring)
    axes.set_xlim(x[0], x[-1])
    several = MaxNLocator(len(moorings), steps=[1, 2, 5, 10])
    axes.xaxis.set_major_locator(several if len(moorings) > 1 else FixedLocator([0.0]))


def _along_array(moorings: Sequence[Mapping[str, Any]]) -> Floats:
    """Project the positions on their principal axis, km from the first end, the first mooring nearer to it."""
    north = np.array([mooring["latitude"] for mooring in moorings], dtype=float)
    longitude = np.array([mooring["longitude"] for mooring in moorings], dtype=float)
    east = angles.difference(longitude, longitude[0]) * angles.sin_cos(float(np.mean(north)))[1]
    place = DEGREE_KM * np.stack([east - np.mean(east), north - np.mean(north)])
    along = np.linalg.svd(place, full_matrices=False)[0][:, 0] @ place
    along = along if along[0] <= along[-1] else -along
    return np.asarray(along - along.min())


def _draw_mooring(axes: Axes, at: float, mooring: Mapping[str, Any]) -> None:
    depths = [each["depth_m"] for each in mooring["instruments"] if each["depth_m"] is not None]
    top, bottom = min(depths, default=0.0), mooring["water_depth_m"]
    axes.plot([at, at], [top, bottom], color=BLACK, linewidth=0.7)
    for each in mooring["instruments"]:
        colour = ROLES[each["role"]]
        if each["depth_m"] is None:
            axes.plot([at, at], [top, bottom], color=colour, linewidth=3.0, alpha=0.5)
        else:
            marker, size = MARKERS[each["orientation"]], 8.0 if each["role"] == "affected" else 5.0
            axes.plot(at, each["depth_m"], marker=marker, color=colour, markersize=size, markeredgewidth=0, zorder=3)


def draw_synthetic_curves(path: str | Path) -> None:
    """Draw deviation, recorded heading and lookup table of series with B alone, dashed where they are not inverted."""
    beta = np.arange(-180.0, 180.0 + STEP_DEG / 2.0, STEP_DEG)
    with page(path, 3.4, width_in=WIDE_IN) as figure:
        panels, handles = figure.subplots(1, 3), []
        for b, colour in SYNTHETIC_B_DEG.items():
            coefficients = (0.0, b, 0.0, 0.0, 0.0)
            deviation, (gamma, inverted) = series_deviation(coefficients, beta), inverse_table(coefficients)
            folded = series_slope(coefficients, beta).min() < 0.0
            here = angles.wrap360(beta - inverted.min()) <= np.ptp(inverted) if folded else np.full(beta.shape, True)
            for panel, y in ((panels[0], deviation), (panels[1], beta - deviation)):
                panel.plot(beta, y, color=colour, linewidth=0.9, linestyle=(0, (3, 2)))
                panel.plot(beta, np.where(here, y, np.nan), color=colour)
            shown = (angles.wrap180(gamma), angles.wrap180(inverted))
            breaks = np.any([np.abs(np.diff(x, append=x[-1])) > 180.0 for x in shown], axis=0)
            panels[2].plot(shown[0], np.where(breaks, np.nan, shown[1]), color=colour)
            handles.append(Line2D([], [], color=colour, label=f"B = {b:.3g}°"))
        for panel in panels:
            degrees(panel.xaxis, (-180.0, 180.0), as_is=True)
        panels[0].set(xlabel="Correct heading β (°)", ylabel="Deviation β − γ (°)")
        panels[1].set(xlabel="Correct heading β (°)", ylabel="Recorded heading γ (°)")
        panels[2].set(xlabel="Recorded heading γ (°)", ylabel="Correct heading β (°)")
        handles.append(Line2D([], [], color=BLACK, linewidth=0.9, linestyle=(0, (3, 2)), label="not inverted"))
        legend(figure, handles, columns=4)


def draw_angles(path: str | Path, *, heading_deg: float = 85.0, deviation_deg: float = 50.0, current_deg: float = 70.0,
                declination_deg: float = -23.5) -> None:  # fmt: skip
    """Draw the directions and angles of the paper's Fig. 4, seen from above, true north up.

    Args:
        heading_deg: correct heading β to magnetic north.
        deviation_deg: β − γ.
        current_deg: α, from beam 3.
        declination_deg: δ, east positive.
    """
    magnetic, recorded = declination_deg, declination_deg + deviation_deg
    forward = magnetic + heading_deg
    arrows = {
        "geographic north": (0.0, BLACK),
        "magnetic north": (magnetic, BLUE),
        "needle's north": (recorded, VERMILION),
        "forward, beam 3": (forward, GREEN),
        "current": (forward + current_deg, PURPLE),
    }
    arcs = {
        "δ": (0.0, magnetic, 0.35),
        "β": (magnetic, forward, 0.75),
        "γ": (recorded, forward, 0.5),
        "α": (forward, forward + current_deg, 0.6),
    }
    with page(path, 2.7) as figure:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_aspect("equal")
        for name, (towards, colour) in arrows.items():
            x, y = (float(each) for each in angles.components(1.0, towards))
            axes.annotate("", (x, y), (0.0, 0.0), arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.6})
            side = "left" if x > 0.1 else "right" if x < -0.1 else "center"
            place = (1.06 * x, 1.06 * y + 0.06 * (side == "center"))
            axes.text(*place, name, color=colour, ha=side, va="bottom" if y > 0.9 else "center")
        for name, (begin, end, radius) in arcs.items():
            low, high = sorted((90.0 - begin, 90.0 - end))
            axes.add_patch(Arc((0.0, 0.0), 2.0 * radius, 2.0 * radius, theta1=low, theta2=high, linewidth=0.8))
            x, y = (float(each) for each in angles.components(radius + 0.08, (begin + end) / 2.0))
            axes.text(x, y, name, ha="center", va="center")
        axes.set_xlim(-1.3, 1.75)
        axes.set_ylim(-0.75, 1.2)
