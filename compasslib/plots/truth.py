"""Errors of headings along time where the truth is known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.plots.page import CORRECTED, DAY_S, dates, legend, page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

FIT = "#999999"


def draw_errors(
    path: str | Path, time_s: Floats, fit_deg: Floats, corrected_deg: Floats, sigma_deg: Floats,
    planted: Sequence[str | None],
) -> None:  # fmt: skip
    """Draw daily means of heading errors by the fitted coefficients alone and after correction, with the stated band.

    Args:
        fit_deg: heading by the fitted coefficients minus truth, (n,), NaN where there is none.
        corrected_deg: corrected heading minus truth, (n,).
        sigma_deg: stated standard deviation of the corrected headings, (n,).
        planted: dates, UTC, at which something changed; None without a date.
    """
    day = np.floor(time_s / DAY_S).astype(int)
    begin, middle = day[0], (np.unique(day) + 0.5)

    def daily(values: Floats) -> Floats:
        known = np.isfinite(values)
        count = np.bincount(day[known] - begin, minlength=int(day[-1] - begin + 1))
        total = np.bincount(day[known] - begin, values[known], len(count))
        with np.errstate(invalid="ignore", divide="ignore"):
            return (total / count)[np.unique(day) - begin]

    half = NORMAL_95 * daily(sigma_deg)
    with page(path, 2.9) as figure:
        axes = figure.subplots()
        axes.fill_between(middle, -half, half, color=CORRECTED, alpha=0.15, linewidth=0)
        for series, colour in ((fit_deg, FIT), (corrected_deg, CORRECTED)):
            axes.plot(middle, daily(series), color=colour, linewidth=1.0)
        axes.axhline(0.0, color="#444444", linewidth=0.5)
        for date in filter(None, planted):
            axes.axvline(
                np.datetime64(date).astype("datetime64[s]").astype(float) / DAY_S, color="#222222", linestyle=":"
            )
        axes.set_ylabel("Heading error (°)")
        dates(axes, (float(time_s[0]), float(time_s[-1])))
        lines = {"fitted coefficients alone": FIT, "corrected": CORRECTED}
        handles = [Line2D([], [], color=colour, label=name) for name, colour in lines.items()]
        legend(figure, [*handles, Patch(color=CORRECTED, alpha=0.15, linewidth=0, label="stated 95 %")], columns=3)
