"""Figure of heading errors along time for records with known truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib.plots.page import BLACK, CORRECTED, DAY_S, VERMILION, dates, legend, page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

FIT = "#555555"
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.5, "markeredgewidth": 0}
REACHED = 0.99  # share of the errors within the limits of the vertical axis


def error_reach(errors_deg: Sequence[Floats]) -> float:
    """Compute a common limit of the vertical axis for the figures of several moorings, degrees.

    Args:
        errors_deg: heading errors of each mooring, degrees; NaN are ignored.
    """
    known = np.concatenate([np.abs(error[np.isfinite(error)]) for error in errors_deg] or [np.zeros(0)])
    return 5.0 * float(np.ceil(np.quantile(known, REACHED) / 5.0)) if known.size else 5.0


def draw_errors(
    path: str | Path, time_s: Floats, fit_deg: Floats, corrected_deg: Floats, sigma_deg: Floats,
    dates_utc: Sequence[str | None], reach_deg: float,
) -> None:  # fmt: skip
    """Draw heading errors of the fitted coefficients alone and of the corrected headings, with the stated 95 % range.

    Args:
        fit_deg: heading by the fitted coefficients minus truth, (n,), NaN if missing.
        corrected_deg: corrected heading minus truth, (n,).
        sigma_deg: stated standard deviation of the corrected headings, (n,).
        dates_utc: dates of true changes, which are marked; None are ignored.
        reach_deg: limit of the vertical axis; larger errors are drawn at its edge.
    """
    day, half = time_s / DAY_S, NORMAL_95 * sigma_deg
    marks = [np.datetime64(date).astype("datetime64[s]").astype(float) / DAY_S for date in dates_utc if date]
    beyond = np.abs(corrected_deg) > half
    with page(path, 4.2) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        panels[0].plot(day, np.clip(fit_deg, -reach_deg, reach_deg), color=FIT, **POINT)
        panels[0].set_title("coefficients alone")
        panels[1].fill_between(day, -half, half, color=CORRECTED, alpha=0.25, linewidth=0)
        for here, colour in ((~beyond, CORRECTED), (beyond, VERMILION)):
            panels[1].plot(day[here], np.clip(corrected_deg[here], -reach_deg, reach_deg), color=colour, **POINT)
        panels[1].set_title("as corrected")
        for axes in panels:
            axes.axhline(0.0, color="#444444", linewidth=0.5)
            axes.set_ylabel("Heading error (°)")
            for mark in marks:
                axes.axvline(mark, color=BLACK, linestyle=":")
        panels[1].set_ylim(-1.05 * reach_deg, 1.05 * reach_deg)
        dates(panels[1], (float(time_s[0]), float(time_s[-1])))
        handles: list[Artist] = [Patch(color=CORRECTED, alpha=0.25, linewidth=0, label="stated 95 % range")]
        handles.append(Line2D([], [], color=VERMILION, **(POINT | {"markersize": 3.0}), label="errors outside it"))
        legend(
            figure, [*handles, *[Line2D([], [], color=BLACK, linestyle=":", label="true change") for _ in marks[:1]]]
        )
