"""A swing: what was seen at each heading, the fitted curve with its interval, and the limit of the norm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.calibrations.result import Calibration
from compasslib.calibrations.swing import adjustment
from compasslib.deviation import von_appen
from compasslib.plots.page import BLUE, GREY, VERMILION, degrees, empty, legend, page
from compasslib.types import Floats

TWO_SIGMA = adjustment.TWO_SIGMA
STEP_DEG = 1.0
FULL = (0.0, 360.0)
MOST_POINTS = 2000
MINUS = "\N{MINUS SIGN}"


def swing(path: str | Path, result: Calibration, name: str) -> None:
    """Draw what was seen on a swing, the curve with its interval, and the limit of the norm."""
    with page(path, 3.2) as figure:
        _curve(figure.subplots(), result)
        if result.table is not None:
            legend(figure, _handles(result))


def _curve(axes: Axes, result: Calibration) -> None:
    degrees(axes.xaxis, FULL)
    axes.set(xlabel="Recorded heading γ (°)", ylabel="Deviation β − γ (°)")
    shown = result.points.get("deviation_deg")
    if result.table is None or shown is None:
        empty(axes, "no curve")
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
    for limit in (-adjustment.LIMIT_DEG, adjustment.LIMIT_DEG):
        axes.axhline(limit, color=VERMILION, linewidth=0.8, linestyle="--")
    _level(axes, np.concatenate([curve - half, curve + half, *np.percentile(shown, [[1.0], [99.0]])]))


def _level(axes: Axes, values: Floats) -> None:
    low, high = min(float(values.min()), -adjustment.LIMIT_DEG), max(float(values.max()), adjustment.LIMIT_DEG)
    margin = 0.06 * (high - low)
    axes.set_ylim(low - margin, high + margin)
    axes.yaxis.set_major_formatter(lambda x, _: f"{x:g}".replace("-", MINUS))
    axes.axhline(0.0, color=GREY, linewidth=0.5)


def _handles(result: Calibration) -> list[Any]:
    drift = result.details.get("drift")
    seen = "courses corrected for drift" if drift else "true headings"
    return [
        Line2D([], [], color="#333333", marker="o", linestyle="", markersize=3, label=seen),
        Line2D([], [], color=BLUE, label="fitted series"),
        Patch(color=BLUE, alpha=0.2, linewidth=0, label="95 % of the fit"),
        Line2D([], [], color=VERMILION, linewidth=0.8, linestyle="--", label="4° (ISO 25862)"),
    ]
