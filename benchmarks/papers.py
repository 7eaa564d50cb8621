"""Figures 4 and 5 of von Appen (2015) as pictures of the documentation: angles, and series with B alone."""

from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Arc

from compasslib import angles
from compasslib.deviation.series import inverse_table, series_deviation, series_slope
from compasslib.plots.page import (
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WIDE_IN,
    create,
    degrees,
    legend,
)

SYNTHETIC_B_DEG = {0.0: BLACK, 20.0: SKY, 45.0: GREEN, 57.29: PURPLE, 90.0: ORANGE, 135.0: VERMILION}


def draw_synthetic_curves(path: str | Path) -> None:
    """Draw deviation, recorded heading and lookup table of series with B alone, dashed where they are not inverted."""
    beta = np.linspace(-180.0, 180.0, 721)
    with create(path, 3.4, width_in=WIDE_IN) as figure:
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


def draw_angles(path: str | Path) -> None:
    """Draw the directions and angles of von Appen (2015), Fig. 4, seen from above, true north up."""
    magnetic, recorded, forward, current = -23.5, 26.5, 61.5, 131.5  # degrees from geographic north
    arrows = {
        "geographic north": (0.0, BLACK),
        "magnetic north": (magnetic, BLUE),
        "needle's north": (recorded, VERMILION),
        "forward, beam 3": (forward, GREEN),
        "current": (current, PURPLE),
    }
    arcs = {
        "δ": (0.0, magnetic, 0.35),
        "β": (magnetic, forward, 0.75),
        "γ": (recorded, forward, 0.5),
        "α": (forward, current, 0.6),
    }
    with create(path, 2.7) as figure:
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
