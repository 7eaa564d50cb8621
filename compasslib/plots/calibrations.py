"""Figures of a calibration: deviation with its curves, tilt, magnetometer, observatory declination.

They draw what is available: recorded_deg, deviation_deg and residual_deg of the points, the table, and ``models``.
"""

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import MODELS
from compasslib.calibrations.curves import harmonic_design
from compasslib.calibrations.swing import adjustment
from compasslib.deviation.series import series_design
from compasslib.plots import page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import DAY_S, Floats

COLOURS = {
    "smith": page.GREEN, "exact": page.SKY, "polynomial": page.ORANGE, "one_cycle": page.PURPLE,
    "empirical": page.BLUE,
}  # fmt: skip
PALE_BAND: dict[str, Any] = page.BAND | {"alpha": 0.22}
LIMIT: dict[str, Any] = {"color": page.VERMILION, "linewidth": 0.8, "linestyle": "--"}
EDGE: dict[str, Any] = {"color": page.GREY, "linewidth": 1.0, "linestyle": (0, (4, 2))}
DOT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 1.6, "markeredgewidth": 0}
POINT: dict[str, Any] = DOT | {"markersize": 3.5, "color": page.BLACK}
MODEL: dict[str, Any] = {"color": page.GREY, "linewidth": 1.2, "linestyle": (0, (4, 2))}
STORM: dict[str, Any] = {"color": page.VERMILION, "alpha": 0.18, "linewidth": 0}
MOST_BARS, LOG = 100, 1000  # points above which no error bars are drawn, and of a log that may have spikes
TURN_DEG = np.arange(0.0, 361.0, 1.0)
GAMMA, DEVIATION, FILE_UNIT = "Recorded heading γ (° magnetic)", "Deviation β − γ (°)", "(file's unit)"


def draw_figure(figure: str, path: str | Path, shown: StoredCalibration) -> None:
    """Draw one figure of a calibration: ``compared``, or one of ``calibrations.FIGURES`` or ``calibrations.KINDS``."""
    draw = {
        "deviation": draw_deviation, "compared": draw_compared,
        "tilt": draw_tilt, "magnetometer": draw_magnetometer, "series": draw_series,
    }  # fmt: skip
    draw[figure](path, shown)


def _by_heading(axes: Axes, label: str = DEVIATION) -> None:
    """Label axes of a quantity by recorded heading, with a line at zero."""
    axes.axhline(0.0, color=page.BLACK, linewidth=0.6)
    page.degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel=GAMMA, ylabel=label)


def draw_deviation(path: str | Path, shown: StoredCalibration) -> None:
    """Draw readings, curves with the 95 % band of the chosen one, a swing's limit of ISO 25862, and residuals."""
    with page.create(path, 5.6) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        handles = deviation_panel(above, shown)
        above.set(xlabel="", title="")
        if handles and shown.content["kind"] == "swing":
            limits = [above.axhline(edge, **LIMIT) for edge in (-adjustment.LIMIT_DEG, adjustment.LIMIT_DEG)]
            limits[0].set_label(f"{adjustment.LIMIT_DEG:g}° (ISO 25862)")
            handles.append(limits[0])
        off, recorded = shown.points.get("residual_deg"), shown.points.get("recorded_deg")
        if off is None or recorded is None or not np.isfinite(off).any():
            page.empty(below, words="no residuals")
        else:
            below.plot(recorded, off, **_point(len(off)))
            expanded = shown.content["uncertainty"]["expanded_deg"] or 0.0
            edges = [below.axhline(edge, **EDGE) for edge in (-expanded, expanded)]
            edges[0].set_label("expanded uncertainty (k = 2)")
            handles.append(edges[0])
            _by_heading(below, "Observed minus\ncurve (°)")
        figure.align_ylabels()
        page.legend(figure, handles, columns=1)


def deviation_panel(axes: Axes, shown: StoredCalibration) -> list[Artist]:
    """Draw points, band and curves into a panel and return the handles of its legend."""
    content, points, table = shown.content, shown.points, shown.table
    models = {name: model for name, model in content.get("models", {}).items() if "coefficients" in model}
    readings = {"recorded_deg", "deviation_deg"} <= set(points)
    if not (models or table.heading_deg.size or readings):
        page.empty(axes, words="no readings")
        return []
    handles, ends = list[Artist](), list[Floats]([np.zeros(1)])
    if readings:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
        scatter, bar = content["uncertainty"]["rows"].get("fit_residual", {}).get("standard_deg"), ""
        if scatter is not None and len(recorded) <= MOST_BARS:
            axes.errorbar(recorded, deviation, 2.0 * scatter, fmt="none", ecolor=page.GREY, elinewidth=0.8)
            bar = f", ±{2.0 * scatter:.2f}° (k = 2)"
        axes.plot(recorded, deviation, **_point(len(recorded)))
        handles.append(page.line(f"{len(recorded)} readings{bar}", **POINT))
        ends.append(np.percentile(deviation, (0.5, 99.5)) if len(recorded) > LOG else deviation)  # without spikes
    heading, middle, half = np.append(table.heading_deg, 360.0), table.deviation_deg, NORMAL_95 * table.sigma_deg
    ends += [middle - half, middle + half]
    if np.isfinite(half).any():
        middle, half = (np.append(x, x[0]) for x in (middle, half))
        kept = slice(None, -1 if content["model"] == "polynomial" else None)  # discontinuous at north
        axes.fill_between(heading[kept], (middle - half)[kept], (middle + half)[kept], **PALE_BAND)
        handles.append(Patch(**PALE_BAND, label="95 % interval, budget included"))
    if not models and table.heading_deg.size:
        axes.plot(heading, np.append(table.deviation_deg, table.deviation_deg[0]), color=page.GREEN)
        handles.append(page.line(MODELS.get(content["model"], content["model"]), color=page.GREEN))
    for name in sorted(models, key=lambda name: name == content["model"]):  # the chosen one lies on top
        chosen = name == content["model"]
        recorded, off = _curve(name, models[name]["coefficients"], shown)
        label = f"{MODELS[name]}, cross-validated rms {models[name]['left_out_rms_deg']:.2f}°"
        look: dict[str, Any] = {"color": COLOURS[name], "linewidth": 1.8 if chosen else 1.0}
        look |= {} if chosen else {"linestyle": (0, (4, 1.5))}
        axes.plot(recorded, off, **look)
        handles.append(page.line(label + (" (used)" if chosen else ""), **look))
        ends += [off] if chosen else []
    low, high = float(np.nanmin(np.concatenate(ends))), float(np.nanmax(np.concatenate(ends)))
    room = max(0.08 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)
    _by_heading(axes)
    return handles


def _curve(name: str, coefficients: Mapping[str, float], shown: StoredCalibration) -> tuple[Floats, Floats]:
    """Evaluate recorded heading and deviation along a curve, with NaN at jumps by a full turn."""
    turn, numbers = np.arange(0.0, 360.01, 0.5), np.array(list(coefficients.values()))
    if name == "polynomial":
        return turn, np.polynomial.Polynomial(numbers)(turn)
    if name == "empirical":
        return turn, harmonic_design(turn) @ numbers
    if name != "exact":
        return turn, series_design(turn)[:, : len(numbers)] @ numbers
    # By the correct heading, as the recorded heading of a two-valued compass does not cover the full circle.
    recorded = compass.recorded_heading(numbers, turn)
    middle = float(angles.mean(shown.points["deviation_deg"])) if "deviation_deg" in shown.points else 0.0
    off = page.nearest_turn(angles.difference(turn, recorded), angles.wrap180(middle))
    breaks = [np.abs(np.diff(x, append=x[-1])) > 180.0 for x in (recorded, off)]
    return recorded, np.where(breaks[0] | breaks[1], np.nan, off)


def _point(count: int) -> dict[str, Any]:
    """Choose the style of a number of points: smaller markers for many points."""
    return POINT if count <= MOST_BARS else POINT | {"markersize": 1.6}


def draw_compared(path: str | Path, shown: StoredCalibration) -> None:
    """Draw the series of several calibrations with their shift from the first (k = 2), and the readings of this one."""
    curves, points = [each for each in shown.content["compared"] if each["coefficients"]], shown.points
    with page.create(path, 3.6) as figure:
        axes, handles = figure.subplots(), list[Artist]()
        for colour, each in zip(
            cycle((page.BLACK, page.SKY, page.ORANGE, page.GREEN, page.PURPLE, page.BLUE, page.VERMILION)), curves
        ):
            letters = np.nan_to_num(np.array(list(each["coefficients"].values()), dtype=float))
            axes.plot(TURN_DEG, series_design(TURN_DEG) @ letters, color=colour)
            name, texts = textwrap.shorten(each["name"], 20, placeholder="…"), ["no phase"]
            if phase := each["phase_deg"]:
                texts = [f"shift {page.signed(phase['shift'], '+.0f')}° ± {2.0 * phase['sigma']:.0f}°"]
            if size := each["amplitude_deg"]:
                texts.append(f"amplitude {page.signed(size['difference'], '+.1f')}° ± {2.0 * size['sigma']:.1f}°")
            label = f"{name} (first)" if each is curves[0] else f"{name}: {', '.join(texts)}"
            handles.append(page.line(label, color=colour))
        if not curves:
            page.empty(axes, words="no curves")
            return
        if {"recorded_deg", "deviation_deg"} <= set(points):
            axes.plot(points["recorded_deg"], points["deviation_deg"], **_point(len(points["recorded_deg"])))
            handles.append(page.line("readings of the last", **POINT))
        _by_heading(axes)
        page.legend(figure, handles, columns=1)


def draw_tilt(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw the corrections of pitch and roll against the recorded tilt, with the curves and their 95 % band."""
    axes, points = calibration.content.get("axes", {}), calibration.points
    with page.create(path, 3.0) as figure:
        for k, (panel, axis) in enumerate(zip(figure.subplots(1, 2, sharey=True), ("pitch", "roll"), strict=True)):
            here, fit = points.get("axis", np.zeros(0)) == k, axes.get(axis, {})
            if "coefficients" not in fit:
                page.empty(panel, words=f"{axis}: no curve")
                continue
            panel.axhline(0.0, color=page.BLACK, linewidth=0.6)
            low, high = fit["recorded_range_deg"]
            along = np.linspace(low, high, 101)
            design = np.vander(along, len(fit["coefficients"]), increasing=True)
            curve = design @ list(fit["coefficients"].values())
            variance = np.einsum("ni,ij,nj->n", design, np.array(fit["covariance"]), design) + fit["common_deg"] ** 2
            half = NORMAL_95 * np.sqrt(variance)
            panel.fill_between(along, curve - half, curve + half, **page.BAND)
            panel.plot(along, curve, color=page.GREEN)
            panel.plot(points["recorded_tilt_deg"][here], points["correction_deg"][here], **POINT)
            panel.set_xlabel(f"Recorded {axis} (°)")
        figure.axes[0].set_ylabel("Correction (°)")
        handles = [
            page.line("reference minus recorded tilt", **POINT),
            page.line("fitted curve", color=page.GREEN),
            Patch(**page.BAND, label="95 % interval, budget included"),
        ]
        page.legend(figure, handles, columns=1)


def draw_magnetometer(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw readings before and after calibration, and the modulus against the heading."""
    points = calibration.points
    if not points:
        with page.create(path, 1.0) as figure:
            page.empty(figure.subplots(), words="nothing fitted")
        return
    with page.create(path, 4.4) as figure:
        panels = list(figure.subplot_mosaic("ab\ncc", height_ratios=(1.1, 1)).values())
        if calibration.content["field_is"] == "horizontal":
            _draw_level_plane(panels[0], calibration)
            if "z" in points:
                panels[1].plot(points["recorded_deg"], points["z"], **_dots(page.RECORDED, len(points["z"])))
                page.degrees(panels[1].xaxis, (0.0, 360.0))
                panels[1].set(xlabel="Recorded heading γ (°)", ylabel=f"z {FILE_UNIT}")
            else:
                page.empty(panels[1], words="no z")
        else:
            _draw_plane(panels[0], calibration, ("x", "y"))
            _draw_plane(panels[1], calibration, ("x", "z"))
        _draw_modulus(panels[2], calibration)
        dot = DOT | {"markersize": 4.0}
        handles: list[Artist] = [
            page.line("before", **dot, color=page.RECORDED),
            page.line("after", **dot, color=page.CORRECTED),
            page.line(f"fitted {calibration.content['model']}", color=page.VERMILION, linewidth=1.0),
            page.line("without iron", color=page.BLACK, linewidth=1.0),
        ]
        page.legend(figure, handles)


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
    for field, colour in zip(readings, (page.RECORDED, page.CORRECTED), strict=True):
        axes.plot(*field, **_dots(colour, field.shape[1]))
    for outline, colour in zip(outlines, (page.VERMILION, page.BLACK), strict=True):
        axes.plot(*outline, color=colour, linewidth=1.0)
    for line in (axes.axhline, axes.axvline):
        line(0.0, color=page.BLACK, linewidth=0.4)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{names[0]} {FILE_UNIT}", ylabel=f"{names[1]} {FILE_UNIT}")


def _draw_modulus(axes: Axes, calibration: StoredCalibration) -> None:
    """Draw the departure of the modulus from its mean, percent, against the heading if there is one."""
    points = calibration.points
    axes.axhline(0.0, color=page.BLACK, linewidth=0.7)
    axes.set(xlabel="Reading", ylabel=f"{calibration.content['field_is'].capitalize()} modulus\noff its mean (%)")
    looks = (("modulus", "recorded_deg", page.RECORDED), ("modulus_corrected", "corrected_deg", page.CORRECTED))
    for column, heading, colour in looks:
        off = 100.0 * (points[column] / points[column].mean() - 1.0)
        along = points.get(heading, np.arange(len(off), dtype=float))
        axes.plot(along, off, **_dots(colour, len(off)))
        if heading in points:
            sector = (along // angles.SECTOR_DEG).astype(int)
            count, total = (np.bincount(sector, weights, minlength=36) for weights in (None, off))
            middle = angles.SECTOR_DEG * (np.arange(36) + 0.5)
            axes.plot(middle, np.where(count >= 3, total / np.maximum(count, 1), np.nan), color=colour)
            page.degrees(axes.xaxis, (0.0, 360.0))
            axes.set_xlabel("Heading, recorded or corrected (°)")


def _dots(colour: str, count: int) -> dict[str, Any]:
    """Choose the style of a number of readings, paler if there are many."""
    return DOT | {"color": colour, "alpha": float(np.clip(12.0 / np.sqrt(max(count, 1)), 0.12, 0.8))}


def draw_series(path: str | Path, calibration: StoredCalibration) -> None:
    """Draw the observed declination, the model, the model plus a constant, and the quiet-day variation added to it."""
    quiet = calibration.content["quiet_day"] if calibration.points else None
    with page.create(path, 4.8 if quiet else 3.2) as figure:
        ratios = (1.5, 1.0) if quiet else (1.0,)
        top, *below = figure.subplots(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
        if not calibration.points:
            page.empty(top)
            return
        points, constant = calibration.points, calibration.content["constant_deg"]
        model, sigma = (
            calibration.content["model"].removesuffix(" plus a constant"),
            NORMAL_95 * calibration.content["constant_sigma_deg"],
        )
        lines: dict[str, tuple[Floats, dict[str, Any]]] = {
            "observed": (points["declination_deg"], {"color": page.BLACK, "linewidth": 0.8}),
            model: (points["model_deg"], MODEL),
        }
        if quiet and calibration.content["days"] <= 10:  # else it cannot be seen
            varying = points["model_deg"] + constant + points["quiet_day_deg"]
            lines["with the quiet-day variation"] = (varying, {"color": page.SKY, "linewidth": 1.0})
        label = f"{model} {page.signed(constant, '+.3f')}° ± {sigma:.3f}° (95 %)"
        lines[label] = (points["model_deg"] + constant, {"color": page.GREEN, "linewidth": 1.2})
        gaps, handles = page.find_gaps(points["time_s"]), list[Artist]()
        days = np.insert(points["time_s"] / DAY_S, gaps, np.nan)
        for label, (values, look) in lines.items():
            handles += top.plot(days, np.insert(values, gaps, np.nan), **look, label=label)
        storms = calibration.content["storms"]
        for storm in storms:
            ends = (np.datetime64(storm[end].removesuffix("Z"), "s").astype(float) / DAY_S for end in ("from", "to"))
            top.axvspan(*ends, **STORM)
        if storms:
            largest = max(storm["range_deg"] for storm in storms)
            handles.append(Patch(label=f"storm: {len(storms)}, largest range {largest:.1f}°", **STORM))
        top.margins(x=0.01)
        top.set_ylabel("Declination (° east)")
        page.dates(top)
        for axes in below:
            by_hour = np.array(calibration.content["quiet_day"]["by_hour_deg"])
            axes.plot(np.arange(24) + 0.5, by_hour, color=page.SKY, marker="o", markersize=3)
            axes.axhline(0.0, color=page.BLACK, linewidth=0.6)
            axes.set(xlim=(0, 24), xticks=range(0, 25, 3), xlabel="Hour (UTC)", ylabel="Quiet day (°)")
        page.legend(figure, handles, columns=1)
