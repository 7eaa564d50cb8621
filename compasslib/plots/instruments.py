"""Figures of one kind of calibration: tilt, magnetometer, two heads on a frame, observatory declination."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.calibrations.result import Calibration
from compasslib.calibrations.two_heads.motion import down, lean, tilt_angles
from compasslib.deviation.series import series_design, series_deviation
from compasslib.plots.page import (
    BLACK,
    BLUE,
    CORRECTED,
    GAP,
    GREEN,
    GREY,
    MAGNETIC,
    ORANGE,
    RECORDED,
    SKY,
    VERMILION,
    Limits,
    dates,
    degrees,
    empty,
    legend,
    page,
    signed,
    thinned,
)
from compasslib.statistics.resampling import NORMAL_95, blocks_by_count
from compasslib.types import DAY_S, Floats

TURN_DEG = np.arange(0.0, 361.0, 1.0)
DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.6, "markeredgewidth": 0}
POINT: dict[str, Any] = DOT | {"markersize": 3.5, "color": BLACK}
BAND: dict[str, Any] = {"color": GREEN, "alpha": 0.25, "linewidth": 0}

# A tilt sensor.


def draw_tilt(path: str | Path, calibration: Calibration) -> None:
    """Draw the corrections of pitch and roll against the recorded tilt, with the curves and their 95 % band."""
    axes, points = calibration.details.get("axes", {}), calibration.points
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

SERIES: dict[str, Any] = {"color": BLACK, "linestyle": (0, (2.5, 1.5)), "linewidth": 1.0}


def draw_magnetometer(path: str | Path, calibration: Calibration) -> None:
    """Draw readings before and after calibration, the modulus against the heading, and the deviation."""
    if not calibration.points:
        with page(path, 1.0) as figure:
            empty(figure.subplots(), words="nothing fitted")
        return
    points, rows = calibration.points, ["ab", "cc"]
    if "recorded_deg" in points or calibration.table is not None:  # the correction needs the dip, or headings
        rows += ["dd"]
    with page(path, 2.2 * len(rows)) as figure:
        panels = list(figure.subplot_mosaic("\n".join(rows), height_ratios=(1.1, 1, 1)[: len(rows)]).values())
        if calibration.details["field_is"] == "horizontal":
            _draw_level_plane(panels[0], calibration)
            if "z" in points:
                look = DOT | {"color": RECORDED, "alpha": _alpha(len(points["z"]))}
                panels[1].plot(points["recorded_deg"], points["z"], **look)
                degrees(panels[1].xaxis, (0.0, 360.0))
                panels[1].set(xlabel="Recorded heading γ (°)", ylabel="z (file's unit)")
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
            Line2D([], [], color=VERMILION, linewidth=1.0, label=f"fitted {calibration.model}"),
            Line2D([], [], color=BLACK, linewidth=1.0, label="without iron"),
        ]
        if calibration.table is not None:
            handles += [Line2D([], [], color=GREEN, label="exact correction"), Patch(**BAND, label="95 % band")]
            handles += [Line2D([], [], **SERIES, label="five-term series")]
        legend(figure, handles)


def _draw_level_plane(axes: Axes, calibration: Calibration) -> None:
    """Draw the levelled field q = X - iY in the frame of a compass that turns about the vertical."""
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


def _square(axes: Axes) -> None:
    axes.axhline(0.0, color=BLACK, linewidth=0.4)
    axes.axvline(0.0, color=BLACK, linewidth=0.4)
    axes.set_aspect("equal", adjustable="datalim")


def _draw_plane(axes: Axes, calibration: Calibration, names: tuple[str, str]) -> None:
    """Draw the readings in a plane, with the outlines of the ellipsoid b + F S u, |u| = 1, and of the sphere F u."""
    points, details = calibration.points, calibration.details
    for ending, colour in (("", RECORDED), ("_corrected", CORRECTED)):
        axes.plot(*(points[k + ending] for k in names), **DOT, color=colour, alpha=_alpha(len(points["x"])))
    index = ["xyz".index(name) for name in names]
    size, centre, rows = details["field_in_file_unit"], np.array(details["hard_iron"])[index], details["soft_iron"]
    soft = np.array([[float(i == j) if s is None else s for j, s in enumerate(row)] for i, row in enumerate(rows)])
    circle = np.stack(angles.sin_cos(TURN_DEG))
    ellipse = centre[:, None] + size * np.linalg.cholesky((soft @ soft.T)[np.ix_(index, index)]) @ circle
    axes.plot(*ellipse, color=VERMILION, linewidth=1.0)
    axes.plot(*(size * circle), color=BLACK, linewidth=1.0)
    _square(axes)
    axes.set(xlabel=f"{names[0]} (file's unit)", ylabel=f"{names[1]} (file's unit)")


def _draw_modulus(axes: Axes, calibration: Calibration) -> None:
    """Draw the departure of the modulus from its mean, percent, against the heading if there is one."""
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
            sector = (along // angles.SECTOR_DEG).astype(int)
            count = np.bincount(sector, minlength=36)
            mean = np.bincount(sector, off, minlength=36) / np.maximum(count, 1)
            middle = angles.SECTOR_DEG * (np.arange(36) + 0.5)
            axes.plot(middle, np.where(count >= 3, mean, np.nan), color=colour)
    if "recorded_deg" in points:
        degrees(axes.xaxis, (0.0, 360.0))
        axes.set_xlabel("Heading, recorded or corrected (°)")
    else:
        axes.set_xlabel("Reading")


def _draw_correction(axes: Axes, calibration: Calibration) -> None:
    """Draw the deviation against the recorded heading: readings, exact curve with its 95 % band, five-term series."""
    points, table = calibration.points, calibration.table
    if "recorded_deg" in points:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
        axes.plot(recorded, deviation, **DOT, color=CORRECTED, alpha=_alpha(len(recorded)))
    if table is not None:
        heading, value, sigma = (np.append(v, v[0]) for v in (table.heading_deg, table.deviation_deg, table.sigma_deg))
        heading[-1] = 360.0
        axes.fill_between(heading, value - NORMAL_95 * sigma, value + NORMAL_95 * sigma, **BAND)
        axes.plot(heading, value, color=GREEN)
        series = series_deviation(calibration.coefficients, TURN_DEG)
        axes.plot(TURN_DEG, series, **SERIES)
    axes.axhline(0.0, color=BLACK, linewidth=0.7)
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel="Recorded heading γ (°)", ylabel="Deviation β − γ (°)")


def _alpha(n: int) -> float:
    return float(np.clip(12.0 / np.sqrt(max(n, 1)), 0.12, 0.8))


# Two heads on one frame.

BLOCKS = 40
SAMPLE: dict[str, Any] = DOT | {"color": GREY}
SHOWN: dict[str, Any] = SAMPLE | {"markersize": 3.0}  # in a legend
SAMPLES, BLOCK_MEANS = "single samples", "block means"


def draw_difference(path: str | Path, result: Calibration) -> None:
    """Draw the deviation of head b from head a by the recorded heading of b, and the residual of the fitted series."""
    with page(path, 4.4) as figure:
        panels = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
        if not result.points or result.table is None:
            empty(*panels)
            return
        heading, thin = result.points["recorded_b_deg"], thinned(len(result.points["time_s"]))
        panels[0].plot(heading[thin], result.points["deviation_deg"][thin], **SAMPLE)
        panels[1].plot(heading[thin], result.points["residual_deg"][thin], **SAMPLE)
        _draw_offset_curve(panels[0], result)
        _draw_sector_means(panels[1], result)
        _set_limits(panels[0], result.points["deviation_deg"], panels[0].lines[-1].get_ydata())
        _set_limits(panels[1], result.points["residual_deg"])
        panels[0].set_ylabel("Deviation of b\nagainst a (°)")
        panels[1].set_ylabel("Residual (°)")
        panels[1].set_xlabel("Recorded heading of b (° magnetic)")
        degrees(panels[1].xaxis, (0.0, 360.0))
        figure.align_ylabels(panels)
        terms = f"fit of {result.model.split(': ')[-1]}" if result.coefficients.size else "offset only"
        curve = Line2D([], [], color=GREEN, label=terms)
        legend(figure, [Line2D([], [], label=SAMPLES, **SHOWN), curve, Patch(label="95 % of the curve", **BAND)])


def draw_tilt_check(path: str | Path, result: Calibration) -> None:
    """Draw the tilts of b against those of a rotated to the frame of b, and the residual angle along time."""
    with page(path, 4.2) as figure:
        panels = figure.subplot_mosaic([["pitch", "roll"], ["left", "left"]], height_ratios=(2.0, 1.0))
        if "frame" not in result.details:
            empty(*panels.values())
            return
        there = down(lean(result.points["pitch_a_deg"], result.points["roll_a_deg"]))
        rotated = there @ np.array(result.details["frame"]["rotation"]).T
        turned = tilt_angles(rotated[:, 0] + 1j * rotated[:, 1])
        for key, here in (("pitch", turned[0]), ("roll", turned[1])):
            axes = panels[key]
            recorded_tilt, thin = result.points[f"{key}_b_deg"], thinned(len(result.points["time_s"]))
            axes.plot(here[thin], recorded_tilt[thin], **SAMPLE)
            low, high = np.percentile(np.concatenate([here, recorded_tilt]), (0.2, 99.8))
            room = max(0.06 * (high - low), 0.1)
            ends = (low - room, high + room)
            axes.plot(ends, ends, color=BLACK, linewidth=0.8)
            axes.set(xlim=ends, ylim=ends, aspect="equal")
            axes.set_xlabel(f"{key.capitalize()} of a, turned (°)")
            axes.set_ylabel(f"{key.capitalize()} of b (°)")
        _draw_along_time(panels["left"], result, result.points["tilt_residual_deg"])
        panels["left"].set_ylim(bottom=0.0)
        panels["left"].set_ylabel("Angle between\nverticals (°)")
        entry = Line2D([], [], color=BLACK, linewidth=0.8, label="equal")
        mean = Line2D([], [], label=BLOCK_MEANS, **POINT)
        legend(figure, [Line2D([], [], label=SAMPLES, **SHOWN), entry, mean])


def draw_along_time(path: str | Path, result: Calibration) -> None:
    """Draw the heading offset of b from a, and the recorded headings of both, along time."""
    with page(path, 4.8) as figure:
        panels = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        if not result.points or "frame" not in result.details:
            empty(*panels)
            return
        offset = result.details["offset_deg"]
        # The heading-dependent part is removed; the remainder should be constant.
        _draw_along_time(panels[0], result, offset - result.points["residual_deg"])
        handles = [Line2D([], [], label=SAMPLES, **SHOWN), Line2D([], [], label=BLOCK_MEANS, **POINT)]
        handles.append(_draw_offset(panels[0], offset, result.details["offset_sigma_deg"], "headings", BLUE))
        if result.details["offset_from_tilts_deg"] is not None:
            near = offset + float(angles.difference(result.details["offset_from_tilts_deg"], offset))
            handles.append(
                _draw_offset(panels[0], near, result.details["offset_from_tilts_sigma_deg"], "tilts", ORANGE)
            )
        panels[0].set_xlabel("")
        panels[0].set_ylabel("Offset of b\nfrom a (°)")
        thin, days = thinned(len(result.points["time_s"])), result.points["time_s"] / DAY_S
        for key, colour in (("a", BLUE), ("b", VERMILION)):
            panels[1].plot(days[thin], result.points[f"recorded_{key}_deg"][thin], **{**SAMPLE, "color": colour})
            handles.append(Line2D([], [], **{**SHOWN, "color": colour}, label=f"head {key}"))
        degrees(panels[1].yaxis, (0.0, 360.0))
        panels[1].set_ylabel(f"Recorded heading\n{MAGNETIC}")
        _by_clock(panels[1])
        figure.align_ylabels(panels)
        legend(figure, handles, columns=1)


def _draw_offset_curve(axes: Axes, result: Calibration) -> None:
    """Draw the fitted series by its coefficients, and its 95 % band interpolated in the table."""
    assert result.table is not None
    fine = np.arange(0.0, 360.5, 1.0)
    heading = np.append(result.table.heading_deg, 360.0)
    sigma = np.interp(fine, heading, np.append(result.table.sigma_deg, result.table.sigma_deg[0]))
    terms = np.isfinite(result.coefficients)
    value = series_design(fine)[:, : terms.size][:, terms] @ result.coefficients[terms]
    value = np.where(np.isfinite(sigma), value, np.nan)
    axes.fill_between(fine, value - NORMAL_95 * sigma, value + NORMAL_95 * sigma, **BAND)
    axes.plot(fine, value, color=GREEN)


def _draw_sector_means(axes: Axes, result: Calibration) -> None:
    used = result.points["kept"] > 0
    residual = result.points["residual_deg"][used]
    sector = (result.points["recorded_b_deg"][used] / 10.0).astype(int)
    # Each block of time counts once per sector, as successive samples are not independent.
    visit = np.unique(36 * blocks_by_count(result.points["time_s"], BLOCKS)[used] + sector, return_inverse=True)
    means = np.bincount(visit[1], residual) / np.bincount(visit[1])
    place = visit[0] - 36 * (visit[0] // 36)
    count = np.bincount(place, minlength=36)
    there = count >= 3
    mean, square = (np.bincount(place, x, 36)[there] / count[there] for x in (means, means**2))
    error = NORMAL_95 * np.sqrt(np.maximum(square - mean**2, 0.0) / (count[there] - 1.0))
    style = {**POINT, "markersize": 3.0, "elinewidth": 0.8}
    axes.errorbar(10.0 * np.flatnonzero(there) + 5.0, mean, yerr=error, **style)
    axes.axhline(0.0, color=GREEN, linewidth=0.8)


def _set_limits(axes: Axes, points: Floats, line: Any = ()) -> None:
    """Set vertical limits that contain 99 % of the points and the whole line."""
    low, high = np.percentile(points, (0.5, 99.5))
    curve = np.asarray(line, dtype=float)
    curve = curve[np.isfinite(curve)]
    low, high = min([low, *curve]), max([high, *curve])
    room = max(0.08 * (high - low), 0.2)
    axes.set_ylim(low - room, high + room)


def _draw_along_time(axes: Axes, result: Calibration, values: Floats) -> None:
    time, thin = result.points["time_s"], thinned(len(result.points["time_s"]))
    axes.plot(time[thin] / DAY_S, values[thin], **SAMPLE)
    used = result.points["kept"] > 0
    stretch = blocks_by_count(time, BLOCKS)
    for k in np.unique(stretch[used]):
        mine = used & (stretch == k)
        axes.plot(time[mine].mean() / DAY_S, values[mine].mean(), **POINT)
    _set_limits(axes, values)
    _by_clock(axes)


def _draw_offset(axes: Axes, value: float, sigma: float, source: str, colour: str) -> Line2D:
    axes.axhspan(value - NORMAL_95 * sigma, value + NORMAL_95 * sigma, color=colour, alpha=0.25, linewidth=0)
    label = f"offset by {source}: {signed(value, '.2f')}° ± {NORMAL_95 * sigma:.2f}° (95 %)"
    return axes.axhline(value, color=colour, linewidth=1.0, label=label)


def _by_clock(axes: Axes) -> None:
    dates(axes)
    axes.set_xlabel("b's clock (UTC)")


# An observatory's declination.

LINE: dict[str, Any] = {"color": BLACK, "linewidth": 0.8}
STORM: dict[str, Any] = {"color": VERMILION, "alpha": 0.18, "linewidth": 0}


def draw_series(path: str | Path, result: Calibration) -> None:
    """Draw the observed declination, the model, the model plus a constant, and the quiet-day variation added to it."""
    quiet = result.details["quiet_day"] if result.points else None
    with page(path, 4.8 if quiet else 3.2) as figure:
        ratios = (1.5, 1.0) if quiet else (1.0,)
        top, *below = figure.subplots(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
        if not result.points:
            empty(top)
            return
        points, constant = result.points, result.details["constant_deg"]
        _draw_line(top, points, points["declination_deg"], **LINE)
        _draw_line(top, points, points["model_deg"], color=GREY, linewidth=1.2, linestyle=(0, (4, 2)))
        shown = bool(quiet) and result.details["days"] <= 10  # else it cannot be seen
        if shown:
            _draw_line(top, points, points["model_deg"] + constant + points["quiet_day_deg"], color=SKY, linewidth=1.0)
        _draw_line(top, points, points["model_deg"] + constant, color=GREEN, linewidth=1.2)
        _finish(top, result, "Declination (° east)")
        for axes in below:
            by_hour = np.array(result.details["quiet_day"]["by_hour_deg"])
            axes.plot(np.arange(24) + 0.5, by_hour, color=SKY, marker="o", markersize=3)
            axes.axhline(0.0, color=BLACK, linewidth=0.6)
            axes.set(xlim=(0, 24), xticks=range(0, 25, 3), xlabel="Hour (UTC)", ylabel="Quiet day (°)")
        model = result.model.removesuffix(" plus a constant")
        sigma = NORMAL_95 * result.details["constant_sigma_deg"]
        handles: list[Artist] = [
            Line2D([], [], label="observed", **LINE),
            Line2D([], [], color=GREY, linestyle=(0, (4, 2)), label=model),
            Line2D([], [], color=GREEN, label=f"{model} {signed(constant, '+.3f')}° ± {sigma:.3f}° (95 %)"),
        ]
        handles += [Line2D([], [], color=SKY, label="with the quiet-day variation")] if shown else []
        legend(figure, handles + _storm_handle(result), columns=1)


def draw_disturbance(path: str | Path, result: Calibration, *, days: float = 3.0) -> None:
    """Draw the residual with its slow level, and the disturbance with the 95 % range of its calm hours.

    Of long records, only ``days`` about the largest storm are shown of the disturbance.
    """
    with page(path, 4.4) as figure:
        panels = figure.subplots(2, 1)
        if not result.points:
            empty(*panels)
            return
        points = result.points
        _draw_line(panels[0], points, points["residual_deg"], **LINE)
        _draw_line(panels[0], points, points["level_deg"] - result.details["constant_deg"], color=ORANGE, linewidth=1.2)
        _draw_line(panels[1], points, points["disturbance_deg"], **LINE)
        calm = points["disturbance_deg"][points["storm"] == 0.0]
        half = float(np.quantile(np.abs(calm), 0.95)) if calm.size else 0.0
        panels[1].axhspan(-half, half, **BAND)
        _finish(panels[0], result, "Observed minus model\nand constant (°)")
        storms, window = result.details["storms"], None
        if storms and np.ptp(points["time_s"]) >= 3.0 * days * DAY_S:
            largest = max(storms, key=lambda entry: entry["range_deg"])
            window = (_day(largest["from"]) - days / 2.0, _day(largest["to"]) + days / 2.0)
        _finish(panels[1], result, "Without slow level\nand quiet day (°)", window)
        figure.align_ylabels(panels)
        handles: list[Artist] = [Line2D([], [], label="observed, 10-minute means or samples", **LINE)]
        handles.append(Line2D([], [], color=ORANGE, label="slow level"))
        handles.append(Patch(label=f"95 % range of calm hours: ±{half:.2f}°", **BAND))
        legend(figure, handles + _storm_handle(result), columns=1)


def _draw_line(axes: Axes, points: Mapping[str, Floats], values: Floats, **look: Any) -> None:
    """Draw a series along time, broken at gaps."""
    time = points["time_s"]
    step = np.diff(time)
    ends = np.flatnonzero(step > GAP * np.median(step)) + 1
    axes.plot(np.insert(time, ends, time[ends]) / DAY_S, np.insert(values, ends, np.nan), **look)


def _finish(axes: Axes, result: Calibration, label: str, window: Limits | None = None) -> None:
    for storm in result.details["storms"]:
        axes.axvspan(*(_day(storm[end]) for end in ("from", "to")), **STORM)
    axes.set_ylabel(label)
    axes.margins(x=0.01)
    if window:
        axes.set_xlim(window)
    dates(axes)


def _day(stamp: str) -> float:
    return float(np.datetime64(stamp.removesuffix("Z"), "s").astype(float)) / DAY_S


def _storm_handle(result: Calibration) -> list[Artist]:
    storms = result.details["storms"]
    if not storms:
        return []
    largest = max(storms, key=lambda entry: entry["range_deg"])
    return [Patch(label=f"storm: {len(storms)}, largest range {largest['range_deg']:.1f}°", **STORM)]
