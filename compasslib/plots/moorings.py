"""All moorings of a cruise on one figure each: deviations, differences from the reference, currents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.lines import Line2D

from compasslib import angles
from compasslib.deviation.histograms import BIN_DEG, BINS
from compasslib.deviation.model import DeviationFit
from compasslib.plots import curves
from compasslib.plots.page import (
    BLACK,
    CORRECTED,
    GREEN,
    PURPLE,
    RECORDED,
    REFERENCE,
    SKY,
    VERMILION,
    WIDE_IN,
    Rows,
    degrees,
    empty,
    legend,
    page,
)
from compasslib.types import Complexes, Floats

CYCLE = (GREEN, VERMILION, SKY, PURPLE, BLACK)
DASHES = ("-", "--", ":", "-.")
NAMED = len(CYCLE) * len(DASHES)  # moorings; more have no names in a figure
PANEL_IN = 5.0  # height of a panel of more moorings than can be named
SERIES = {"recorded": RECORDED, "corrected": CORRECTED, "reference": REFERENCE}
CM = 100.0


@dataclass(frozen=True)
class AssessedMooring:
    """What the figures of a cruise show of one mooring."""

    name: str
    fit: DeviationFit  # of the product, perhaps without coefficients
    assessment: Mapping[str, Any]  # content of assessment.json


def draw_curves(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw the deviation of each mooring's compass by the correct heading, where it can be inverted."""
    fitted = [mooring for mooring in moorings if mooring.fit.fitted]
    with page(path, 3.4, width_in=WIDE_IN) as figure:
        axes = figure.subplots()
        degrees(axes.xaxis, (0.0, 360.0))
        axes.set(xlabel="Correct heading β (° magnetic)", ylabel="Deviation β − γ (°)")
        axes.axhline(0.0, color=BLACK, linewidth=0.7)
        if not fitted:
            empty(axes)
            return
        handles = []
        for k, mooring in enumerate(fitted):
            curve = curves.curve(mooring.fit, 0.0, np.zeros(0))
            look: dict[str, Any] = {"color": CYCLE[k % len(CYCLE)], "linestyle": DASHES[k // len(CYCLE) % len(DASHES)]}
            if len(fitted) > NAMED:
                look = {"color": colormaps["viridis"](k / len(fitted)), "linewidth": 0.6, "alpha": 0.6}
            deviation = angles.wrap180(curve.deviation_deg)
            jumps = np.abs(np.diff(deviation, prepend=deviation[0])) > 180.0
            deviation = np.where((curve.stretch == curves.GIVEN_UP) | jumps, np.nan, deviation)
            axes.plot(curve.heading_deg, deviation, **look)
            handles.append(Line2D([], [], **look, label=mooring.name))
        axes.grid(alpha=0.3, linewidth=0.5)
        legend(figure, handles if len(fitted) <= NAMED else [], columns=7)


def draw_differences(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw each mooring's held-out differences of direction from the reference, before and after, in a row."""
    shown = [mooring for mooring in moorings if mooring.assessment["before"]["n"]]
    names = [mooring.name for mooring in shown] if len(shown) <= NAMED else [""] * len(shown)
    rows = Rows(names)
    panel = 2.0 * rows.height_in if len(shown) <= NAMED else PANEL_IN
    with page(path, 0.9 + max(panel, 0.8), width_in=WIDE_IN) as figure:
        axes, intervals = figure.subplots(1, 2, width_ratios=(3.0, 1.0), sharey=True)
        degrees(axes.xaxis, (-180.0, 180.0), as_is=True)
        axes.set_xlabel("Affected minus reference, held-out pairs (°)")
        intervals.set_xlabel("Rms, 95 % (°)")
        if not shown:
            empty(axes)
            empty(intervals)
            return
        edges = -180.0 + BIN_DEG * np.arange(BINS + 1)
        for place, mooring in zip(rows.places, shown, strict=True):
            high = 1.0
            tallest = max(_shares(mooring, when).max() for when in ("before", "after"))
            for when, colour, shift in (("before", RECORDED, -0.12), ("after", CORRECTED, 0.12)):
                base = place + high / 2.0
                top = base - high * 0.95 * _shares(mooring, when) / max(tallest, 1e-9)
                axes.stairs(top, edges, baseline=base, color=colour)
                if mooring.assessment[when]["n"]:
                    low, end = mooring.assessment[when]["interval_95"]["rms_deg"]
                    intervals.plot([low, end], [place + shift] * 2, color=colour)
                    intervals.plot(mooring.assessment[when]["rms_deg"], place + shift, "o", color=colour, markersize=3)
        axes.axvline(0.0, color=BLACK, linewidth=0.7)
        intervals.set_xlim(left=0.0)
        intervals.grid(axis="x", alpha=0.3, linewidth=0.5)
        intervals.tick_params(left=False)
        rows.name(axes)
        if len(shown) > NAMED:
            axes.tick_params(left=False, labelleft=False)
        words = {"before": RECORDED, "after": CORRECTED}
        legend(figure, [Line2D([], [], color=colour, label=when) for when, colour in words.items()])


def _shares(mooring: AssessedMooring, when: str) -> Floats:
    """Compute the share of each bin, (72,)."""
    counts = np.array(mooring.assessment["difference_counts"][when], dtype=float)
    return counts / max(float(counts.sum()), 1.0)


def draw_currents(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw each mooring's mean current and variance ellipse at the pairs, recorded, corrected and of the reference."""
    outlines = [(m.name, outlined) for m in moorings if (outlined := _outline_currents(m.assessment["currents"]))]
    if not outlines:
        with page(path, 1.5, width_in=WIDE_IN) as figure:
            empty(figure.subplots())
        return
    corners = [np.concatenate([[0.0], *(z[np.isfinite(z)] for z in outlined.values())]) for _, outlined in outlines]
    middles = [complex(np.ptp(z.real) / 2.0 + z.real.min(), np.ptp(z.imag) / 2.0 + z.imag.min()) for z in corners]
    wide, high = (1.15 * max(float(np.ptp(part(z))) for z in corners) for part in (np.real, np.imag))
    named = len(outlines) <= NAMED
    high += named * 0.15 * wide
    columns = min(len(outlines), 5 if named else 12)
    lines, across = -(-len(outlines) // columns), max(columns, 3)
    with page(path, 0.5 + WIDE_IN / across * high / wide * lines, width_in=WIDE_IN) as figure:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_aspect("equal")
        for k, ((name, outlined), middle) in enumerate(zip(outlines, middles, strict=True)):
            cell = complex(wide * (k % columns), -high * (k // columns))
            for series, outline in outlined.items():
                points = cell - middle + outline
                below = series == "reference"
                look: dict[str, Any] = {"linewidth": 3.5, "alpha": 0.6} if below else {"linewidth": 1.2}
                axes.plot(points.real, points.imag, color=SERIES[series], **look)
            axes.plot((cell - middle).real, (cell - middle).imag, "k+", markersize=6)
            if named:
                axes.text(cell.real, cell.imag + 0.45 * high, name, ha="center", va="center")
        axes.set_xlim(wide * (columns - across - 1) / 2.0, wide * (columns + across - 1) / 2.0)
        axes.set_ylim(high * (0.5 - lines) - 0.15 * wide, high * 0.5)
        steps = np.outer(10.0 ** np.arange(-3, 4), (1.0, 2.0, 5.0)).ravel()
        scale, left = float(steps[steps <= max(wide / 3.0, steps[0])].max()), axes.get_xlim()[0]
        axes.plot([left, left + scale], [high * (0.5 - lines) - 0.1 * wide] * 2, color=BLACK)
        handles = [Line2D([], [], color=colour, label=name) for name, colour in SERIES.items()]
        handles.append(Line2D([], [], color=BLACK, label=f"{scale:g} cm/s; north is up"))
        legend(figure, handles, columns=4)


def _outline_currents(currents: Mapping[str, Any]) -> dict[str, Complexes]:
    """Outline the currents of a mooring, cm/s east + i north: from the origin to the mean, then around its ellipse."""
    outlines: dict[str, Complexes] = {}
    turn = angles.phasor(np.linspace(0.0, 360.0, 73))
    for name in ("reference", "recorded", "corrected"):
        if (current := currents[name]) is None:
            continue
        mean = CM * complex(current["east_m_s"], current["north_m_s"])
        along = angles.phasor(90.0 - (current["major_towards_deg"] or 0.0))
        ellipse = CM * along * (current["major_m_s"] * turn.real + 1j * current["minor_m_s"] * turn.imag)
        outlines[name] = np.concatenate([[0.0, mean, complex(np.nan, np.nan)], mean + ellipse])
    return outlines


FIGURES = {"curves": draw_curves, "differences": draw_differences, "currents": draw_currents}


def draw_figure(name: str, path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw one of the figures that hold all moorings.

    Args:
        name: of ``FIGURES``.
    """
    FIGURES[name](path, moorings)
