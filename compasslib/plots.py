"""Figures for a paper, each one PNG: the deviation, the agreement before and after, the record along time, the theory.

Figures 5 to 9 of von Appen 2015 and a timeline. Nothing else in the house knows matplotlib. A figure appears whole or
not at all, and the same data give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm, to_rgb
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator
from numpy.typing import NDArray

from compasslib import angles, plots_curves
from compasslib.deviation import model, von_appen
from compasslib.deviation.model import Fit
from compasslib.plots_curves import BACKWARDS, GIVEN_UP, INVERTED, Curve, beside, emptiest, placed
from compasslib.plots_page import (
    BLACK,
    BLUE,
    CORRECTED,
    GREEN,
    GREY,
    MAGNETIC,
    METHODS,
    ORANGE,
    PURPLE,
    RECORDED,
    SKY,
    TRUE,
    TRUSTED,
    VERMILION,
    degrees,
    label,
    legend,
    page,
    product_notes,
    say,
    span_of,
    title_of,
)
from compasslib.plots_timeline import timeline
from compasslib.records import Corrected, Pairs

__all__ = ["deviation", "histograms", "scatter", "theory", "timeline"]

Floats = NDArray[np.floating]

STRETCH_COLOURS = {GIVEN_UP: VERMILION, INVERTED: GREEN, BACKWARDS: BLUE}
STRETCH_NAMES = {
    "von_appen": {INVERTED: "fit, inverted", GIVEN_UP: "fit, given up"},
    "folded": {INVERTED: "fit, compass turns with the instrument", BACKWARDS: "fit, compass turns backwards"},
    "exact": {INVERTED: "fit, invertible"},
}
# Von Appen 2015, Fig. 5: amplitude B; the fourth is the largest that can be inverted all round.
THEORY = dict(
    zip((0.0, 20.0, 45.0, float(np.rad2deg(1.0)), 90.0, 135.0), (BLACK, SKY, BLUE, GREEN, ORANGE, VERMILION), strict=True)
)
CORRECT, RECORDS, DEVIATES = "Correct heading β (°)", "Recorded heading γ (°)", "Deviation Δ = β − γ (°)"
HEXAGONS = 40  # across a panel: 9 degrees each


def deviation(path: str | Path, pairs: Pairs, fit: Fit, name: str) -> None:
    """Draw deviation against correct heading, and recorded against correct heading both ways (von Appen's Figs 6, 7).

    Args:
        path: the PNG to write.
        pairs: overlapping measurements, perhaps none.
        fit: the deviation, perhaps without coefficients.
        name: of the mooring.
    """
    heading = model.observed_heading(pairs)
    begin = emptiest(heading)
    curve = plots_curves.curve(fit, begin, heading) if fit.fitted else None
    beta, delta = plots_curves.observed(pairs, curve, begin)
    title = title_of(name, "compass deviation, headings to magnetic north", fit.method)
    with page(path, title, 3.3, _fit_notes(pairs, fit)) as figure:
        panels = figure.subplots(1, 3)
        _deviation_axes(panels, (beta, delta), curve, begin)
        if not (len(pairs) or curve):
            for axes in panels:
                say(axes, "No pairs of the two instruments, no curve.", characters=24)
            return
        _draw_points(panels, beta, delta, _faded(*model.speeds(pairs)))
        _draw_identity(panels)
        if curve is not None:
            _draw_curve(panels, curve)
            _draw_inverse(panels[2], fit, curve)
        legend(figure, _deviation_handles(pairs, fit, curve))


def histograms(path: str | Path, pairs: Pairs, product: Corrected, name: str, *, method: str = "") -> None:
    """Draw how often each heading and each direction occurs, before and after (von Appen's Figs 8 and 9, a and b).

    Args:
        path: the PNG to write.
        pairs: overlapping measurements, perhaps none.
        product: the corrected record, perhaps without corrected headings.
        name: of the mooring.
        method: of the correction, for the title.
    """
    recorded = plots_curves.usable_headings(product)
    lower, upper, corrected = plots_curves.directions(pairs, product)
    title = title_of(name, "headings and current directions", method)
    with page(path, title, 3.1, product_notes(product)) as figure:
        a, b = figure.subplots(1, 2)
        a.set_title(f"(a) headings of {np.isfinite(recorded).sum()} samples")
        b.set_title(f"(b) current directions of {len(pairs)} pairs")
        _stairs(a, {RECORDED: recorded, CORRECTED: product.heading_corrected_deg}, "No heading was recorded.")
        _stairs(
            b,
            {TRUSTED: lower, RECORDED: upper, CORRECTED: corrected},
            "No pairs: the trusted instrument measured nothing near enough to compare.",
        )
        label(a, f"Heading {MAGNETIC}", "Share per 10° (%)")
        label(b, f"Direction towards {TRUE}", "Share per 10° (%)")
        handles: list[Artist] = [
            Line2D([], [], color=RECORDED, label="upper, recorded"),
            Line2D([], [], color=CORRECTED, label="upper, corrected"),
            Patch(color=TRUSTED, alpha=0.5, linewidth=0, label="lower, trusted"),
        ]
        legend(figure, handles)


def scatter(path: str | Path, pairs: Pairs, product: Corrected, name: str, *, method: str = "") -> None:
    """Draw the upper against the lower current direction, before and after (von Appen's Figs 8 and 9, c).

    These are all pairs, the fit's own; the assessment judges on pairs that the fit has not seen.

    Args:
        path: the PNG to write.
        pairs: overlapping measurements, perhaps none.
        product: the corrected record, perhaps without corrected headings.
        name: of the mooring.
        method: of the correction, for the title.
    """
    lower, upper, corrected = plots_curves.directions(pairs, product)
    begin = emptiest(lower)
    title = title_of(name, "upper against lower current direction", method)
    with page(path, title, 3.4, product_notes(product)) as figure:
        panels = figure.subplots(1, 2)
        drawn = [
            _agreement(panels[0], "(a) recorded", (lower, upper), begin),
            _agreement(panels[1], "(b) corrected", (lower, corrected), begin),
        ]
        counted = [hexagons for hexagons in drawn if hexagons is not None]
        most = max([2.0, *(float(np.max(hexagons.get_array())) for hexagons in counted)])
        for hexagons in counted:
            hexagons.set_norm(LogNorm(1.0, most))
        if counted:
            bar = figure.colorbar(counted[0], ax=panels, aspect=30, shrink=0.8, pad=0.02, label="Pairs per hexagon")
            bar.set_ticks(LogLocator(subs=(1.0, 2.0, 5.0)), format=FuncFormatter(lambda count, _: f"{count:g}"))
            bar.minorticks_off()


def theory(path: str | Path) -> None:
    """Draw deviations B sin β of growing amplitude, solid where they can be inverted (von Appen 2015, Fig. 5).

    Args:
        path: the PNG to write.
    """
    with page(path, "Deviation Δ = B sin β: solid where it can be inverted, dashed elsewhere", 3.2) as figure:
        panels = figure.subplots(1, 3)
        for amplitude, colour in THEORY.items():
            fit = Fit("von_appen", 0, coefficients=np.array([0.0, amplitude, 0.0, 0.0, 0.0]))
            curve = plots_curves.curve(fit, -180.0, [])
            for stretch, line in ((INVERTED, "-"), (GIVEN_UP, (0, (2.5, 1.5)))):
                _along(panels, curve, stretch, color=colour, linestyle=line)
        for axes in panels:
            degrees(axes.xaxis, (-180.0, 180.0), signed=True)
            degrees(axes.yaxis, (-180.0, 180.0), signed=True)
        _name_panels(panels)
        handles = [Line2D([], [], color=colour, label=f"B = {b:.3g}°") for b, colour in THEORY.items()]
        legend(figure, handles, columns=6)


def _fit_notes(pairs: Pairs, fit: Fit) -> list[str]:
    if not fit.fitted:
        return [f"No curve was fitted: {fit.why or 'the fit gives no reason'}."]
    notes = [] if len(pairs) else ["No pairs: the curve comes from elsewhere, no measurement of this mooring shows it."]
    if fit.folded and fit.recorded_range_deg:
        first, last = (float(angles.wrap360(round(end))) for end in fit.recorded_range_deg)
        what = "Only recorded headings from" if fit.method == "von_appen" else "The compass only shows headings from"
        how = "are inverted" if fit.method == "von_appen" else ", each for two correct ones"
        notes.append(f"{what} {first:.0f}° to {last:.0f}°{'' if how.startswith(',') else ' '}{how}.")
    return notes


def _deviation_axes(panels: Sequence[Axes], points: tuple[Floats, Floats], curve: Curve | None, begin: float) -> None:
    """Cut all axes: the correct heading at its gap, the others where they hold the curve and most points."""
    beta, delta = points
    line = (curve.deviation_deg, curve.recorded_deg) if curve else (np.zeros(0), np.zeros(0))
    heading, recorded = (begin, begin + 360.0), span_of(beta - delta, line[1])
    for axes, x in zip(panels, (heading, heading, recorded), strict=True):
        degrees(axes.xaxis, x)
    for axes, y in zip(panels, (span_of(delta, line[0]), recorded, heading), strict=True):
        degrees(axes.yaxis, y, signed=axes is panels[0])
    _name_panels(panels)


def _name_panels(panels: Sequence[Axes]) -> None:
    panels[0].set(title="(a) β → Δ", xlabel=CORRECT, ylabel=DEVIATES)
    panels[1].set(title="(b) β → γ", xlabel=CORRECT, ylabel=RECORDS)
    panels[2].set(title="(c) γ → β", xlabel=RECORDS, ylabel=CORRECT)


def _faded(upper_speed: Floats, lower_speed: Floats) -> NDArray[np.floating]:
    """Return a colour for each pair, (n, 4): paler where there are many, and where the water is slow."""
    if not len(upper_speed):
        return np.zeros((0, 4))
    slower = np.minimum(upper_speed, lower_speed)
    clear = np.clip(slower / max(float(np.percentile(slower, 75.0)), 1e-6), 0.1, 1.0)
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


def _draw_curve(panels: Sequence[Axes], curve: Curve) -> None:
    """Draw the curve with its 95 % band in the three panels."""
    half = np.minimum(1.96 * curve.sigma_deg, 180.0)
    beta, delta, gamma = curve.heading_deg, curve.deviation_deg, curve.recorded_deg
    look = {"color": GREEN, "alpha": 0.25, "linewidth": 0}
    panels[0].fill_between(beta, delta - half, delta + half, **look)
    panels[1].fill_between(beta, gamma - half, gamma + half, **look)
    panels[2].fill_betweenx(beta, gamma - half, gamma + half, **look)
    for stretch, colour in STRETCH_COLOURS.items():
        _along(panels, curve, stretch, color=colour)


def _along(panels: Sequence[Axes], curve: Curve, stretch: int, **look: object) -> None:
    """Draw one kind of stretch of a curve as deviation, as recorded and as correct heading."""
    here = curve.stretch == stretch
    beta, delta, gamma = curve.heading_deg, curve.deviation_deg, np.where(here, curve.recorded_deg, np.nan)
    panels[0].plot(beta, np.where(here, delta, np.nan), **look)
    panels[1].plot(beta, gamma, **look)
    panels[2].plot(gamma, beta, **look)


def _draw_inverse(axes: Axes, fit: Fit, curve: Curve) -> None:
    """Mark what the method's own inverse gives every few degrees, beside the curve that it must meet."""
    low, high = axes.get_xlim()
    recorded = np.arange(np.ceil(low / 5.0) * 5.0, high, 5.0 if high - low < 190.0 else 15.0)
    beta = placed(plots_curves.inverse(fit, recorded), curve.heading_deg[0])
    gamma = beside(recorded[:, None], np.interp(beta, curve.heading_deg, curve.recorded_deg))
    axes.plot(gamma.ravel(), beta.ravel(), "o", markersize=2.6, color=BLACK, markerfacecolor="white", markeredgewidth=0.7)


def _deviation_handles(pairs: Pairs, fit: Fit, curve: Curve | None) -> list[Artist]:
    dot = Line2D([], [], linestyle="", marker="o", markersize=2.5, color="#333333", markeredgewidth=0)
    dot.set_label(f"{len(pairs)} pairs, pale where slow")
    handles: list[Artist] = [dot] if len(pairs) else []
    handles.append(Line2D([], [], color=BLACK, linewidth=0.7, label="no deviation"))
    if curve is None:
        return handles
    names = STRETCH_NAMES["folded" if fit.folded and fit.method != "von_appen" else fit.method]
    there = [stretch for stretch in names if (curve.stretch == stretch).any()]
    handles += [Line2D([], [], color=STRETCH_COLOURS[stretch], label=names[stretch]) for stretch in there]
    if np.isfinite(curve.sigma_deg).any():
        handles.append(Patch(color=GREEN, alpha=0.25, linewidth=0, label="95 % band of the fit"))
    ring = Line2D([], [], linestyle="", marker="o", markersize=2.6, color=BLACK, markerfacecolor="white")
    ring.set(markeredgewidth=0.7, label="inverse in closed form" if fit.method != "von_appen" else "lookup table")
    return [*handles, ring]


def _stairs(axes: Axes, series: dict[str, Floats], otherwise: str) -> None:
    """Draw one histogram a colour on a circle that is cut at its emptiest part."""
    shown = {colour: angle for colour, angle in series.items() if np.isfinite(angle).any()}
    if not shown:
        say(axes, otherwise)
        return
    begin = emptiest(np.concatenate(list(shown.values())))
    edges = begin + plots_curves.SECTOR_DEG * np.arange(37.0)
    for colour, angle in shown.items():
        look = {"color": colour, "linewidth": 1.4} if colour != TRUSTED else {"color": GREY, "fill": True, "alpha": 0.5}
        axes.stairs(plots_curves.sectors(angle, begin), edges, **look)
    degrees(axes.xaxis, (begin, begin + 360.0))
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_locator(MaxNLocator(6, integer=True))


def _agreement(axes: Axes, letter: str, xy: tuple[Floats, Floats], begin: float) -> PolyCollection | None:
    """Draw one direction against another, counted in hexagons; None where there is nothing to draw."""
    known = np.isfinite(xy[0]) & np.isfinite(xy[1])
    limits = (begin, begin + 360.0)
    axes.set_title(letter)
    label(axes, f"Lower direction {TRUE}", f"Upper direction {TRUE}")
    if not known.any():
        say(axes, "No pairs." if not len(known) else "No pair could be corrected.")
        return None
    lower, upper = (placed(angle[known], begin) for angle in xy)
    axes.set_title(f"{letter}: rms {angles.rms(upper - lower):.1f}°, n = {known.sum()}")
    hexagons = axes.hexbin(
        lower, upper, gridsize=HEXAGONS, extent=(*limits, *limits), mincnt=1, cmap="viridis_r", linewidths=0.1
    )
    axes.plot(limits, limits, color=BLACK, linewidth=0.8)
    for axis in (axes.xaxis, axes.yaxis):
        degrees(axis, limits)
    axes.set_aspect("equal")
    return hexagons
