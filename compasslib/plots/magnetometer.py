"""The calibration of a magnetometer as one page: readings in two planes, modulus, and the correction of the heading."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.calibrations.result import Calibration
from compasslib.deviation import von_appen
from compasslib.plots.page import BLACK, CORRECTED, GREEN, RECORDED, VERMILION, degrees, empty, legend, page
from compasslib.types import Floats

TURN_DEG = np.arange(0.0, 361.0, 1.0)
SECTOR_DEG, FEWEST_IN_SECTOR = 10.0, 3
DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.6, "markeredgewidth": 0}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}


def magnetometer(path: str | Path, calibration: Calibration, name: str) -> None:
    """Draw readings before and after, the modulus against the heading, and what to add to a recorded heading."""
    if not calibration.points:
        with page(path, 1.0) as figure:
            empty(figure.subplots(), "nothing fitted")
        return
    points, rows = calibration.points, ["ab", "cc"]
    if "recorded_deg" in points or calibration.table is not None:  # the correction needs the dip, or headings
        rows += ["dd"]
    with page(path, 2.2 * len(rows)) as figure:
        panels = list(figure.subplot_mosaic("\n".join(rows), height_ratios=(1.1, 1, 1)[: len(rows)]).values())
        if calibration.details["field_is"] == "horizontal":
            _level_plane(panels[0], calibration)
            _third_axis(panels[1], calibration)
        else:
            _plane(panels[0], calibration, ("x", "y"))
            _plane(panels[1], calibration, ("x", "z"))
        _modulus(panels[2], calibration)
        if len(panels) > 3:
            _heading(panels[3], calibration)
        _explain(figure, calibration)


def _level_plane(axes: Axes, calibration: Calibration) -> None:
    """Draw the levelled field of a platform that turns about the vertical, q = X - iY as the compass sees it."""
    points, size = calibration.points, calibration.details["field_in_file_unit"]
    q = points["modulus"] * angles.phasor(points["recorded_deg"])
    after = points["modulus_corrected"] * angles.phasor(points["corrected_deg"])
    for field, colour in ((q, RECORDED), (after, CORRECTED)):
        axes.plot(field.real, -field.imag, **DOT, color=colour, alpha=_alpha(len(q)))
    fitted = size * compass.level_field(calibration.exact, TURN_DEG)
    for field, colour in ((fitted, VERMILION), (size * angles.phasor(TURN_DEG), BLACK)):
        axes.plot(field.real, -field.imag, color=colour, linewidth=1.0)
    _square(axes)
    axes.set(xlabel="Forward (file's unit)", ylabel="Starboard (file's unit)")


def _third_axis(axes: Axes, calibration: Calibration) -> None:
    points = calibration.points
    if "z" not in points:
        empty(axes, "no z")
        return
    axes.plot(points["recorded_deg"], points["z"], **DOT, color=RECORDED, alpha=_alpha(len(points["z"])))
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel="Recorded heading γ (°)", ylabel="z (file's unit)")


def _square(axes: Axes) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.4)
    axes.axvline(0.0, color=BLACK, linewidth=0.4)
    axes.set_aspect("equal", adjustable="datalim")


def _plane(axes: Axes, calibration: Calibration, names: tuple[str, str]) -> None:
    """Draw the readings in a plane, with the outline of the fitted ellipsoid and of the sphere it becomes."""
    points = calibration.points
    for ending, colour in (("", RECORDED), ("_corrected", CORRECTED)):
        axes.plot(*(points[k + ending] for k in names), **DOT, color=colour, alpha=_alpha(len(points["x"])))
    for outline, colour in zip(_outlines(calibration.details, names), (VERMILION, BLACK), strict=True):
        axes.plot(*outline, color=colour, linewidth=1.0)
    _square(axes)
    axes.set(xlabel=f"{names[0]} (file's unit)", ylabel=f"{names[1]} (file's unit)")


def _outlines(details: Mapping[str, Any], names: tuple[str, str]) -> tuple[Floats, Floats]:
    """Return the silhouettes in a plane of the ellipsoid b + F S u, |u| = 1, and of the sphere F u, (2, m) each."""
    index = ["xyz".index(name) for name in names]
    size, centre, rows = details["field_in_file_unit"], np.array(details["hard_iron"])[index], details["soft_iron"]
    soft = np.array([[float(i == j) if s is None else s for j, s in enumerate(row)] for i, row in enumerate(rows)])
    circle = np.stack(angles.sin_cos(TURN_DEG))
    return centre[:, None] + size * np.linalg.cholesky((soft @ soft.T)[np.ix_(index, index)]) @ circle, size * circle


def _modulus(axes: Axes, calibration: Calibration) -> None:
    """Draw the modulus over its mean, against the heading where there is one."""
    points, details = calibration.points, calibration.details
    axes.axhline(0.0, color=BLACK, linewidth=0.7)
    axes.set_ylabel(f"{details['field_is'].capitalize()} modulus\noff its mean (%)")
    for column, heading, colour in (
        ("modulus", "recorded_deg", RECORDED),
        ("modulus_corrected", "corrected_deg", CORRECTED),
    ):
        off = 100.0 * (points[column] / points[column].mean() - 1.0)
        along = points.get(heading, np.arange(len(off), dtype=float))
        axes.plot(along, off, **DOT, color=colour, alpha=_alpha(len(off)))
        if heading in points:
            axes.plot(*_sector_means(along, off), color=colour)
    if "recorded_deg" in points:
        degrees(axes.xaxis, (0.0, 360.0))
        axes.set_xlabel("Heading, recorded or corrected (°)")
    else:
        axes.set_xlabel("Reading")


def _sector_means(heading: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return the mean of the values in each sector that holds enough."""
    sector = (heading // SECTOR_DEG).astype(int)
    count = np.bincount(sector, minlength=36)
    mean = np.bincount(sector, values, minlength=36) / np.maximum(count, 1)
    return SECTOR_DEG * (np.arange(36) + 0.5), np.where(count >= FEWEST_IN_SECTOR, mean, np.nan)


def _heading(axes: Axes, calibration: Calibration) -> None:
    """Draw what to add to a recorded heading: readings, exact curve with its 95 % band, five-term series."""
    points, table = calibration.points, calibration.table
    if "recorded_deg" in points:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
        axes.plot(recorded, deviation, **DOT, color=CORRECTED, alpha=_alpha(len(recorded)))
    if table is not None:
        heading, value, sigma = (np.append(v, v[0]) for v in (table.heading_deg, table.deviation_deg, table.sigma_deg))
        heading[-1] = 360.0
        axes.fill_between(heading, value - 1.96 * sigma, value + 1.96 * sigma, **BAND)
        axes.plot(heading, value, color=GREEN)
        series = von_appen.predict(calibration.coefficients, TURN_DEG)
        axes.plot(TURN_DEG, series, color=BLACK, linestyle=(0, (2.5, 1.5)), linewidth=1.0)
    axes.axhline(0.0, color=BLACK, linewidth=0.7)
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel="Recorded heading γ (°)", ylabel="Deviation β − γ (°)")


def _alpha(n: int) -> float:
    return float(np.clip(12.0 / np.sqrt(max(n, 1)), 0.12, 0.8))


def _explain(figure: Figure, calibration: Calibration) -> None:
    handles: list[Any] = [
        Line2D([], [], **DOT | {"markersize": 4.0}, color=RECORDED, label="before"),
        Line2D([], [], **DOT | {"markersize": 4.0}, color=CORRECTED, label="after"),
        Line2D([], [], color=VERMILION, linewidth=1.0, label=f"fitted {calibration.model}"),
        Line2D([], [], color=BLACK, linewidth=1.0, label="without iron"),
    ]
    if calibration.table is not None:
        dashed = Line2D([], [], color=BLACK, linestyle=(0, (2.5, 1.5)), linewidth=1.0, label="five-term series")
        handles += [
            Line2D([], [], color=GREEN, label="exact correction"),
            Patch(**BAND, label="95 % band"),
            dashed,
        ]
    legend(figure, handles)
