"""Figures of a calibration: the deviation with the curves that were compared, its residuals, a certificate.

They draw what a kind has: the points recorded_deg with deviation_deg and residual_deg, a table, the detail ``models``.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from compasslib import angles, compass, plots_certificate
from compasslib.archive_calibrations import Page
from compasslib.calibration import KINDS
from compasslib.deviation import von_appen
from compasslib.plots_curves import beside
from compasslib.plots_page import BLACK, GREEN, GREY, ORANGE, PURPLE, SKY, degrees, legend, page, say

Floats = NDArray[np.floating]

NAMES = {
    "smith": ("Smith's five terms", GREEN),
    "exact": ("exact compass", SKY),
    "polynomial": ("polynomial of degree 6", ORANGE),
    "one_cycle": ("one cycle", PURPLE),
}
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 3.5, "color": BLACK, "markeredgewidth": 0}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.22, "linewidth": 0}
MOST_BARS = 100  # points that still have a bar of their own
RECORDED, DEVIATION = "Recorded heading γ (° magnetic)", "Deviation Δ = β − γ (°)"


def draw(figure: str, path: str | Path, shown: Page) -> None:
    """Draw one figure of a calibration.

    Args:
        figure: a name of ``calibration.FIGURES``, or of the kind's own in ``calibration.KINDS``.
        path: the PNG to write.
        shown: the calibration.
    """
    common = {"deviation": deviation, "residuals": residuals, "certificate": certificate}
    if figure in common:
        common[figure](path, shown)
        return
    own = import_module(f"compasslib.plots_calibration_{KINDS[shown.content['kind']].module}")
    getattr(own, figure)(path, shown.calibration, shown.content["name"])


def deviation(path: str | Path, shown: Page) -> None:
    """Draw what was observed, the curve with its 95 % band, and the other curves that were tried.

    Args:
        path: the PNG to write.
        shown: the calibration.
    """
    content = shown.content
    with page(
        path, f"{content['name']}: deviation of a compass, kind {content['kind']}", 3.6, _notes(content)
    ) as figure:
        axes = figure.subplots()
        handles = deviation_panel(axes, shown)
        legend(figure, handles, columns=2)


def deviation_panel(axes: Axes, shown: Page) -> list[Artist]:
    """Draw points, band and curves into a panel and return what its legend explains.

    Args:
        axes: the panel.
        shown: the calibration.
    """
    curves = {name: _curve(name, model, shown) for name, model in _models(shown.content).items()}
    if not (curves or shown.table.heading_deg.size or "deviation_deg" in shown.points):
        say(axes, "There is neither a reading nor a curve of deviation to show.")
        return []
    handles = [*_draw_points(axes, shown), *_draw_band(axes, shown), *_draw_curves(axes, curves, shown)]
    chosen = curves.get(shown.content["model"], (np.zeros(0),) * 2)[1]
    half = 1.96 * shown.table.sigma_deg
    line = np.concatenate([chosen, shown.table.deviation_deg - half, shown.table.deviation_deg + half])
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set_xticks(np.arange(0.0, 361.0, 45.0))
    axes.set_ylim(_limits(shown.points.get("deviation_deg", np.zeros(0)), line))
    axes.set(xlabel=RECORDED, ylabel=DEVIATION)
    return handles


def residuals(path: str | Path, shown: Page) -> None:
    """Draw what the curve leaves at each reading, with the expanded uncertainty beside it.

    Args:
        path: the PNG to write.
        shown: the calibration.
    """
    content = shown.content
    with page(path, f"{content['name']}: residuals of {_model_name(content)}", 2.8, _notes(content)) as figure:
        axes = figure.subplots()
        off, recorded = shown.points.get("residual_deg"), shown.points.get("recorded_deg")
        if off is None or recorded is None or not np.isfinite(off).any():
            say(axes, "There is no curve, and so nothing that it leaves.")
            return
        axes.plot(recorded, off, **_point(len(off)))
        expanded = content["uncertainty"]["expanded_deg"] or 0.0
        for edge in (-expanded, expanded):
            axes.axhline(edge, color=GREY, linewidth=1.0, linestyle=(0, (4, 2)))
        axes.axhline(0.0, color=BLACK, linewidth=0.6)
        degrees(axes.xaxis, (0.0, 360.0))
        axes.set_xticks(np.arange(0.0, 361.0, 45.0))
        axes.set(xlabel=RECORDED, ylabel="Observed minus curve (°)")
        marks = [Line2D([], [], **POINT, label=f"{len(off)} readings, {angles.rms(off):.2f}° rms")]
        edges = Line2D(
            [], [], color=GREY, linewidth=1.0, linestyle=(0, (4, 2)), label=f"expanded uncertainty ±{expanded:.2f}°"
        )
        legend(figure, [*marks, edges])


def certificate(path: str | Path, shown: Page) -> None:
    """Draw one page to keep with the instrument: curve, table, coefficients, uncertainty, date and place.

    Args:
        path: the PNG to write.
        shown: the calibration.
    """
    title = f"{shown.content['name']}: calibration of a compass, kind {shown.content['kind']}"
    text, high = plots_certificate.writing(shown), plots_certificate.CURVE_IN
    with page(path, title, high + plots_certificate.LEGEND_IN + text.height_in) as figure:
        curve, below = figure.subplots(2, 1, height_ratios=(high, text.height_in))
        handles = deviation_panel(curve, shown)
        if handles:
            curve.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
        plots_certificate.write(below, text)


def _notes(content: Mapping[str, Any]) -> list[str]:
    if content["why"]:
        return [f"No curve: {plots_certificate.sentence(content['why'])}"]
    compared = content.get("comparison") or {}
    return [compared["text"]] if compared.get("text") else []


def _model_name(content: Mapping[str, Any]) -> str:
    return NAMES.get(content["model"], (content["model"], BLACK))[0]


def _models(content: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """Return the coefficients of the curves that were fitted, the chosen one last so that it lies on top."""
    models = {name: model for name, model in content.get("models", {}).items() if "coefficients" in model}
    order = sorted(models, key=lambda name: name == content["model"])
    return {name: models[name]["coefficients"] for name in order}


def _curve(name: str, coefficients: Mapping[str, float], shown: Page) -> tuple[Floats, Floats]:
    """Return recorded heading and deviation along a curve, broken where it passes north."""
    turn = np.arange(0.0, 360.01, 0.5)
    numbers = np.array(list(coefficients.values()))
    if name == "polynomial":
        return turn, np.polynomial.Polynomial(numbers)(turn)
    if name != "exact":
        return turn, von_appen.design(turn)[:, : len(numbers)] @ numbers
    # Along the correct heading, so that a compass that cannot turn full circle is drawn whole.
    recorded = compass.recorded_heading(numbers, turn)
    middle = float(angles.mean(shown.points["deviation_deg"])) if "deviation_deg" in shown.points else 0.0
    off = beside(angles.difference(turn, recorded), angles.wrap180(middle))
    breaks = [np.abs(np.diff(x, append=x[-1])) > 180.0 for x in (recorded, off)]
    return recorded, np.where(breaks[0] | breaks[1], np.nan, off)


def _draw_points(axes: Axes, shown: Page) -> list[Artist]:
    points, rows = shown.points, shown.content["uncertainty"]["rows"]
    if not {"recorded_deg", "deviation_deg"} <= set(points):
        return []
    scatter = rows.get("fit_residual", {}).get("standard_deg")
    few = scatter is not None and len(points["recorded_deg"]) <= MOST_BARS
    if few:
        axes.errorbar(
            points["recorded_deg"], points["deviation_deg"], 2.0 * scatter, fmt="none", ecolor=GREY, elinewidth=0.8
        )
    axes.plot(points["recorded_deg"], points["deviation_deg"], **_point(len(points["recorded_deg"])))
    bar = f", ±{2.0 * scatter:.2f}° (k = 2)" if few else ""
    return [Line2D([], [], **POINT, label=f"{len(points['recorded_deg'])} readings{bar}")]


def _point(count: int) -> dict[str, Any]:
    """Return the look of so many points: many are small."""
    return POINT if count <= MOST_BARS else POINT | {"markersize": 1.6}


def _draw_band(axes: Axes, shown: Page) -> list[Artist]:
    table = shown.table
    if not np.isfinite(table.sigma_deg).any():
        return []
    heading = np.append(table.heading_deg, 360.0)
    middle, half = (np.append(x, x[0]) for x in (table.deviation_deg, 1.96 * table.sigma_deg))
    if shown.content["model"] == "polynomial":  # it jumps at north
        heading, middle, half = heading[:-1], middle[:-1], half[:-1]
    axes.fill_between(heading, middle - half, middle + half, **BAND)
    return [Patch(**BAND, label="95 % band, budget included")]


def _draw_curves(axes: Axes, curves: Mapping[str, tuple[Floats, Floats]], shown: Page) -> list[Artist]:
    if not curves and shown.table.heading_deg.size:
        table = shown.table
        heading, off = np.append(table.heading_deg, 360.0), np.append(table.deviation_deg, table.deviation_deg[0])
        axes.plot(heading, off, color=GREEN)
        return [Line2D([], [], color=GREEN, label=_model_name(shown.content))]
    handles: list[Artist] = []
    for name, (recorded, off) in curves.items():
        chosen = name == shown.content["model"]
        score = shown.content["models"][name]["left_out_rms_deg"]
        label = f"{NAMES[name][0]}, {score:.2f}° left out" + (" (used)" if chosen else "")
        look: dict[str, Any] = {"color": NAMES[name][1], "linewidth": 1.8 if chosen else 1.0}
        look |= {} if chosen else {"linestyle": (0, (4, 1.5))}
        axes.plot(recorded, off, **look)
        handles.append(Line2D([], [], **look, label=label))
    return handles


def _limits(points: Floats, line: Floats) -> tuple[float, float]:
    ends = np.concatenate([points[np.isfinite(points)], line[np.isfinite(line)], [0.0]])
    low, high = float(ends.min()), float(ends.max())
    room = max(0.08 * (high - low), 0.5)
    return low - room, high + room
