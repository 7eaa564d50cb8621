"""How much a compass deviates, as fitted to a mooring (von Appen 2015, Figs 6 and 7)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from compasslib.deviation import model
from compasslib.deviation.model import Fit
from compasslib.plots import curves
from compasslib.plots.curves import BACKWARDS, GIVEN_UP, INVERTED, DeviationByHeading, beside, emptiest, placed
from compasslib.plots.page import (
    BLACK,
    BLUE,
    GREEN,
    VERMILION,
    degrees,
    empty,
    legend,
    page,
    span_of,
)
from compasslib.records import Pairs
from compasslib.types import Floats

STRETCH_COLOURS = {GIVEN_UP: VERMILION, INVERTED: GREEN, BACKWARDS: BLUE}
PUBLISHED_STRETCHES = {INVERTED: "fit, invertible", GIVEN_UP: "fit, not invertible"}
FOLDED_STRETCHES = {INVERTED: "fit, reading turns with the instrument", BACKWARDS: "fit, reading turns backwards"}
WHOLE_STRETCH = {INVERTED: "fit, invertible"}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 2.5, "color": "#333333", "markeredgewidth": 0}
RING: dict[str, Any] = {**POINT, "color": BLACK, "markerfacecolor": "white", "markeredgewidth": 0.7}
CORRECT, RECORDS, DEVIATES = "Correct β (°)", "Recorded γ (°)", "Deviation β − γ (°)"


def deviation(path: str | Path, pairs: Pairs, fit: Fit) -> None:
    """Draw deviation against correct heading, and recorded against correct heading both ways (von Appen's Figs 6, 7).

    Axes hold the curve and 98 % of the pairs.

    Args:
        pairs: overlapping measurements, perhaps none.
        fit: the deviation, perhaps without coefficients.
    """
    heading = model.observed_heading(pairs)
    begin = emptiest(heading)
    curve = curves.curve(fit, begin, heading) if fit.fitted else None
    beta, delta = curves.observed(pairs, curve, begin)
    handles = _deviation_handles(pairs, fit, curve)
    with page(path, 4.0 + 0.16 * len(handles)) as figure:
        panels = _three(figure)
        _deviation_axes(panels, (beta, delta), curve, begin)
        if not (len(pairs) or curve):
            for axes in panels:
                empty(axes)
            return
        _draw_points(panels, beta, delta, _faded(*model.speeds(pairs)))
        _draw_identity(panels)
        if curve is not None:
            _draw_curve(panels, curve)
            _draw_inverse(panels[2], fit, curve)
        legend(figure, handles, columns=1)


def _three(figure: Figure) -> list[Axes]:
    """Return a wide panel above two narrow ones."""
    return list(figure.subplot_mosaic([["a", "a"], ["b", "c"]]).values())


def _deviation_axes(
    panels: Sequence[Axes], points: tuple[Floats, Floats], curve: DeviationByHeading | None, begin: float
) -> None:
    """Cut all axes: the correct heading at its gap, the others where they hold the curve and most points."""
    beta, delta = points
    line = (curve.deviation_deg, curve.recorded_deg) if curve else (np.zeros(0), np.zeros(0))
    heading, recorded = (begin, begin + 360.0), span_of(beta - delta, line[1])
    for axes, x in zip(panels, (heading, heading, recorded), strict=True):
        degrees(axes.xaxis, x)
    for axes, y in zip(panels, (span_of(delta, line[0]), recorded, heading), strict=True):
        degrees(axes.yaxis, y, as_is=axes is panels[0])
    _name_panels(panels)


def _name_panels(panels: Sequence[Axes]) -> None:
    panels[0].set(xlabel="Correct heading β (°)", ylabel=DEVIATES)
    panels[1].set(xlabel=CORRECT, ylabel=RECORDS)
    panels[2].set(xlabel=RECORDS, ylabel=CORRECT)


def _faded(upper_speed: Floats, lower_speed: Floats) -> NDArray[np.floating]:
    """Return a colour for each pair, (n, 4): paler where there are many, and where the water is slow."""
    if not len(upper_speed):
        return np.zeros((0, 4))
    slower = np.minimum(upper_speed, lower_speed)
    clear = np.clip(np.nan_to_num(slower) / max(float(np.nanpercentile(slower, 75.0)), 1e-6), 0.1, 1.0)
    alpha = np.clip(15.0 / np.sqrt(len(slower)), 0.08, 0.8) * clear
    return np.column_stack([np.tile(to_rgb("#333333"), (len(slower), 1)), alpha])


def _draw_points(panels: Sequence[Axes], beta: Floats, delta: Floats, colours: Floats) -> None:
    for axes, x, y in zip(panels, (beta, beta, beta - delta), (delta, beta - delta, beta), strict=True):
        axes.scatter(x, y, s=4.0, c=colours, linewidths=0)


def _draw_identity(panels: Sequence[Axes]) -> None:
    """Draw where an iron-free compass stands."""
    panels[0].axhline(0.0, color=BLACK, linewidth=0.7)
    for axes in panels[1:]:
        axes.axline((0.0, 0.0), slope=1.0, color=BLACK, linewidth=0.7)


def _draw_curve(panels: Sequence[Axes], curve: DeviationByHeading) -> None:
    """Draw the curve with its 95 % band in the three panels."""
    half = np.minimum(1.96 * curve.sigma_deg, 180.0)
    beta, delta, gamma = curve.heading_deg, curve.deviation_deg, curve.recorded_deg
    panels[0].fill_between(beta, delta - half, delta + half, **BAND)
    panels[1].fill_between(beta, gamma - half, gamma + half, **BAND)
    panels[2].fill_betweenx(beta, gamma - half, gamma + half, **BAND)
    for stretch, colour in STRETCH_COLOURS.items():
        _along(panels, curve, stretch, color=colour)


def _along(panels: Sequence[Axes], curve: DeviationByHeading, stretch: int, **look: Any) -> None:
    """Draw one kind of stretch of a curve as deviation, as recorded and as correct heading."""
    here = curve.stretch == stretch
    beta, delta, gamma = curve.heading_deg, curve.deviation_deg, np.where(here, curve.recorded_deg, np.nan)
    panels[0].plot(beta, np.where(here, delta, np.nan), **look)
    panels[1].plot(beta, gamma, **look)
    panels[2].plot(gamma, beta, **look)


def _draw_inverse(axes: Axes, fit: Fit, curve: DeviationByHeading) -> None:
    """Mark what the method's own inverse gives every few degrees, beside the curve that it must meet."""
    covered = curve.recorded_deg[curve.stretch != GIVEN_UP]
    low, high = float(covered.min()), float(covered.max())
    rings = int(np.clip((high - low) / 5.0, 4.0, 24.0))
    recorded = low + (high - low) * (np.arange(rings) + 0.5) / rings
    beta = placed(curves.inverse(fit, recorded), curve.heading_deg[0])
    gamma = beside(recorded[:, None], np.interp(beta, curve.heading_deg, curve.recorded_deg))
    axes.plot(gamma.ravel(), beta.ravel(), **RING)


def _deviation_handles(pairs: Pairs, fit: Fit, curve: DeviationByHeading | None) -> list[Artist]:
    handles: list[Artist] = []
    if len(pairs):
        handles.append(Line2D([], [], **POINT, label=f"{len(pairs)} pairs, paler at low speed"))
    handles.append(Line2D([], [], color=BLACK, linewidth=0.7, label="no deviation"))
    if curve is None:
        return handles
    names = PUBLISHED_STRETCHES if fit.method == "von_appen" else FOLDED_STRETCHES if fit.folded else WHOLE_STRETCH
    for stretch, text in names.items():
        if (curve.stretch == stretch).any():
            handles.append(Line2D([], [], color=STRETCH_COLOURS[stretch], label=text))
    if np.isfinite(curve.sigma_deg).any():
        handles.append(Patch(**BAND, label="95 % band of the fit"))
    text = "correction by lookup table" if fit.method == "von_appen" else "correction, exact inverse"
    return [*handles, Line2D([], [], **RING, label=text)]
