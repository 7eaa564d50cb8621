"""Figures of one kind of calibration: tilt, magnetometer, observatory declination."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.archive.calibrations import StoredCalibration
from compasslib.deviation.series import series_deviation
from compasslib.plots.page import (
    BLACK,
    CORRECTED,
    GAP,
    GREEN,
    GREY,
    RECORDED,
    SKY,
    VERMILION,
    dates,
    degrees,
    empty,
    legend,
    page,
    signed,
)
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import DAY_S, Floats

TURN_DEG = np.arange(0.0, 361.0, 1.0)
DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.6, "markeredgewidth": 0}
POINT: dict[str, Any] = DOT | {"markersize": 3.5, "color": BLACK}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}
SERIES: dict[str, Any] = {"color": BLACK, "linestyle": (0, (2.5, 1.5)), "linewidth": 1.0}
LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.8}
MODEL: dict[str, Any] = {"color": GREY, "linewidth": 1.2, "linestyle": (0, (4, 2))}
STORM: dict[str, Any] = {"color": VERMILION, "alpha": 0.18, "linewidth": 0}
FILE_UNIT = "(file's unit)"


def draw_tilt(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw the corrections of pitch and roll against the recorded tilt, with the curves and their 95 % band."""
    axes, points = calibration.content.get("axes", {}), calibration.points
    with page(path, 3.0) as figure:
        for k, (panel, axis) in enumerate(zip(figure.subplots(1, 2, sharey=True), ("pitch", "roll"), strict=True)):
            here, fit = points.get("axis", np.zeros(0)) == k, axes.get(axis, {})
            if "coefficients" not in fit:
                empty(panel, words=f"{axis}: no curve")
                continue
            panel.axhline(0.0, color=BLACK, linewidth=0.6)
            low, high = fit["recorded_range_deg"]
            along = np.linspace(low, high, 101)
            design = np.vander(along, len(fit["coefficients"]), increasing=True)
            curve = design @ list(fit["coefficients"].values())
            variance = np.einsum("ni,ij,nj->n", design, np.array(fit["covariance"]), design) + fit["common_deg"] ** 2
            half = NORMAL_95 * np.sqrt(variance)
            panel.fill_between(along, curve - half, curve + half, **BAND)
            panel.plot(along, curve, color=GREEN)
            panel.plot(points["recorded_tilt_deg"][here], points["correction_deg"][here], **POINT)
            panel.set_xlabel(f"Recorded {axis} (°)")
        figure.axes[0].set_ylabel("Correction (°)")
        handles = [
            Line2D([], [], **POINT, label="reference minus recorded tilt"),
            Line2D([], [], color=GREEN, label="fitted curve"),
            Patch(**BAND, label="95 % interval, budget included"),
        ]
        legend(figure, handles, columns=1)


# A magnetometer.


def draw_magnetometer(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw readings before and after calibration, the modulus against the heading, and the deviation."""
    points, table = calibration.points, calibration.table
    if not points:
        with page(path, 1.0) as figure:
            empty(figure.subplots(), words="nothing fitted")
        return
    rows = ["ab", "cc"]
    if "recorded_deg" in points or table.heading_deg.size:  # the correction needs the dip, or headings
        rows += ["dd"]
    with page(path, 2.2 * len(rows)) as figure:
        panels = list(figure.subplot_mosaic("\n".join(rows), height_ratios=(1.1, 1, 1)[: len(rows)]).values())
        if calibration.content["field_is"] == "horizontal":
            _draw_level_plane(panels[0], calibration)
            if "z" in points:
                look = DOT | {"color": RECORDED, "alpha": _alpha(len(points["z"]))}
                panels[1].plot(points["recorded_deg"], points["z"], **look)
                degrees(panels[1].xaxis, (0.0, 360.0))
                panels[1].set(xlabel="Recorded heading γ (°)", ylabel=f"z {FILE_UNIT}")
            else:
                empty(panels[1], words="no z")
        else:
            _draw_plane(panels[0], calibration, ("x", "y"))
            _draw_plane(panels[1], calibration, ("x", "z"))
        _draw_modulus(panels[2], calibration)
        if len(panels) > 3:
            _draw_correction(panels[3], calibration)
        dot = DOT | {"markersize": 4.0}
        handles: list[Artist] = [
            Line2D([], [], **dot, color=RECORDED, label="before"),
            Line2D([], [], **dot, color=CORRECTED, label="after"),
            Line2D([], [], color=VERMILION, linewidth=1.0, label=f"fitted {calibration.content['model']}"),
            Line2D([], [], color=BLACK, linewidth=1.0, label="without iron"),
        ]
        if table.heading_deg.size:
            handles += [Line2D([], [], color=GREEN, label="exact correction"), Patch(**BAND, label="95 % band")]
            handles += [Line2D([], [], **SERIES, label="five-term series")]
        legend(figure, handles)


def _draw_level_plane(axes: Axes, calibration: StoredCalibration) -> None:
    """Draw the levelled field q = X - iY in the frame of a compass that turns about the vertical."""
    points, size = calibration.points, calibration.content["field_in_file_unit"]
    exact = np.array([*calibration.content["exact"]["coefficients"].values()])
    before = points["modulus"] * angles.phasor(points["recorded_deg"])
    after = points["modulus_corrected"] * angles.phasor(points["corrected_deg"])
    fitted, circle = size * compass.level_field(exact, TURN_DEG), size * angles.phasor(TURN_DEG)
    readings = [np.stack([field.real, -field.imag]) for field in (before, after)]
    outlines = [np.stack([field.real, -field.imag]) for field in (fitted, circle)]
    _draw_field(axes, readings, outlines, ("Forward", "Starboard"))


def _draw_plane(axes: Axes, calibration: StoredCalibration, names: tuple[str, str]) -> None:
    """Draw the readings in a plane, with the outlines of the ellipsoid b + F S u, |u| = 1, and of the sphere F u."""
    points, details = calibration.points, calibration.content
    index = ["xyz".index(name) for name in names]
    size, centre, rows = details["field_in_file_unit"], np.array(details["hard_iron"])[index], details["soft_iron"]
    soft = np.array([[float(i == j) if s is None else s for j, s in enumerate(row)] for i, row in enumerate(rows)])
    circle = np.stack(angles.sin_cos(TURN_DEG))
    ellipse = centre[:, None] + size * np.linalg.cholesky((soft @ soft.T)[np.ix_(index, index)]) @ circle
    readings = [np.stack([points[name + ending] for name in names]) for ending in ("", "_corrected")]
    _draw_field(axes, readings, [ellipse, size * circle], names)


def _draw_field(axes: Axes, readings: Sequence[Floats], outlines: Sequence[Floats], names: tuple[str, str]) -> None:
    for field, colour in zip(readings, (RECORDED, CORRECTED), strict=True):
        axes.plot(*field, **DOT, color=colour, alpha=_alpha(field.shape[1]))
    for outline, colour in zip(outlines, (VERMILION, BLACK), strict=True):
        axes.plot(*outline, color=colour, linewidth=1.0)
    axes.axhline(0.0, color=BLACK, linewidth=0.4)
    axes.axvline(0.0, color=BLACK, linewidth=0.4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{names[0]} {FILE_UNIT}", ylabel=f"{names[1]} {FILE_UNIT}")


def _draw_modulus(axes: Axes, calibration: StoredCalibration) -> None:
    """Draw the departure of the modulus from its mean, percent, against the heading if there is one."""
    points = calibration.points
    axes.axhline(0.0, color=BLACK, linewidth=0.7)
    axes.set(xlabel="Reading", ylabel=f"{calibration.content['field_is'].capitalize()} modulus\noff its mean (%)")
    looks = (("modulus", "recorded_deg", RECORDED), ("modulus_corrected", "corrected_deg", CORRECTED))
    for column, heading, colour in looks:
        off = 100.0 * (points[column] / points[column].mean() - 1.0)
        along = points.get(heading, np.arange(len(off), dtype=float))
        axes.plot(along, off, **DOT, color=colour, alpha=_alpha(len(off)))
        if heading in points:
            sector = (along // angles.SECTOR_DEG).astype(int)
            count = np.bincount(sector, minlength=36)
            mean = np.bincount(sector, off, minlength=36) / np.maximum(count, 1)
            middle = angles.SECTOR_DEG * (np.arange(36) + 0.5)
            axes.plot(middle, np.where(count >= 3, mean, np.nan), color=colour)
            degrees(axes.xaxis, (0.0, 360.0))
            axes.set_xlabel("Heading, recorded or corrected (°)")


def _draw_correction(axes: Axes, calibration: StoredCalibration) -> None:
    """Draw the deviation against the recorded heading: readings, exact curve with its 95 % band, five-term series."""
    points, table = calibration.points, calibration.table
    if "recorded_deg" in points:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
        axes.plot(recorded, deviation, **DOT, color=CORRECTED, alpha=_alpha(len(recorded)))
    if table.heading_deg.size:
        heading, value, sigma = (np.append(v, v[0]) for v in (table.heading_deg, table.deviation_deg, table.sigma_deg))
        heading[-1] = 360.0
        axes.fill_between(heading, value - NORMAL_95 * sigma, value + NORMAL_95 * sigma, **BAND)
        axes.plot(heading, value, color=GREEN)
        series = np.array([*calibration.content["coefficients"].values()])
        axes.plot(TURN_DEG, series_deviation(series, TURN_DEG), **SERIES)
    axes.axhline(0.0, color=BLACK, linewidth=0.7)
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel="Recorded heading γ (°)", ylabel="Deviation β − γ (°)")


def _alpha(n: int) -> float:
    return float(np.clip(12.0 / np.sqrt(max(n, 1)), 0.12, 0.8))


# An observatory's declination.


def draw_series(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw the observed declination, the model, the model plus a constant, and the quiet-day variation added to it."""
    quiet = calibration.content["quiet_day"] if calibration.points else None
    with page(path, 4.8 if quiet else 3.2) as figure:
        ratios = (1.5, 1.0) if quiet else (1.0,)
        top, *below = figure.subplots(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
        if not calibration.points:
            empty(top)
            return
        points, constant = calibration.points, calibration.content["constant_deg"]
        model, sigma = (
            calibration.content["model"].removesuffix(" plus a constant"),
            NORMAL_95 * calibration.content["constant_sigma_deg"],
        )
        lines: list[tuple[Floats, dict[str, Any]]] = [
            (points["declination_deg"], LINE | {"label": "observed"}),
            (points["model_deg"], MODEL | {"label": model}),
        ]
        if quiet and calibration.content["days"] <= 10:  # else it cannot be seen
            look = {"color": SKY, "linewidth": 1.0, "label": "with the quiet-day variation"}
            lines.append((points["model_deg"] + constant + points["quiet_day_deg"], look))
        label = f"{model} {signed(constant, '+.3f')}° ± {sigma:.3f}° (95 %)"
        lines.append((points["model_deg"] + constant, {"color": GREEN, "linewidth": 1.2, "label": label}))
        handles = [_draw_line(top, points["time_s"], values, **look) for values, look in lines]
        handles += _draw_storms(top, calibration)
        top.set_ylabel("Declination (° east)")
        dates(top)
        for axes in below:
            by_hour = np.array(calibration.content["quiet_day"]["by_hour_deg"])
            axes.plot(np.arange(24) + 0.5, by_hour, color=SKY, marker="o", markersize=3)
            axes.axhline(0.0, color=BLACK, linewidth=0.6)
            axes.set(xlim=(0, 24), xticks=range(0, 25, 3), xlabel="Hour (UTC)", ylabel="Quiet day (°)")
        legend(figure, handles, columns=1)


def _draw_line(axes: Axes, time_s: Floats, values: Floats, **look: Any) -> Artist:
    """Draw a series along time, broken at gaps."""
    step = np.diff(time_s)
    ends = np.flatnonzero(step > GAP * np.median(step)) + 1
    return axes.plot(np.insert(time_s, ends, time_s[ends]) / DAY_S, np.insert(values, ends, np.nan), **look)[0]


def _draw_storms(axes: Axes, calibration: StoredCalibration) -> list[Artist]:
    storms = calibration.content["storms"]
    for storm in storms:
        axes.axvspan(_day(storm["from"]), _day(storm["to"]), **STORM)
    axes.margins(x=0.01)
    if not storms:
        return []
    largest = max(storm["range_deg"] for storm in storms)
    return [Patch(label=f"storm: {len(storms)}, largest range {largest:.1f}°", **STORM)]


def _day(stamp: str) -> float:
    return float(np.datetime64(stamp.removesuffix("Z"), "s").astype(float)) / DAY_S
