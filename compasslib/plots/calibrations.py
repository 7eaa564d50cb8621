"""Figures of a calibration: the deviation with its curves and residuals, and the certificate.

They draw what is available: recorded_deg, deviation_deg and residual_deg of the points, the table, and ``models``.
Those of other kinds are in ``instruments``.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from compasslib import angles, compass
from compasslib.archive.calibrations import StoredCalibration
from compasslib.calibrations import MODELS
from compasslib.calibrations.curves import harmonic_design
from compasslib.calibrations.result import LETTERS
from compasslib.calibrations.swing import adjustment
from compasslib.deviation.series import series_design
from compasslib.plots import instruments
from compasslib.plots.instruments import BAND, POINT, TURN_DEG
from compasslib.plots.page import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WIDE_IN,
    degrees,
    empty,
    legend,
    nearest_turn,
    page,
    signed,
)
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

COLOURS = {"smith": GREEN, "exact": SKY, "polynomial": ORANGE, "one_cycle": PURPLE, "empirical": BLUE}
PALE_BAND: dict[str, Any] = BAND | {"alpha": 0.22}
LIMIT: dict[str, Any] = {"color": VERMILION, "linewidth": 0.8, "linestyle": "--"}
EDGE: dict[str, Any] = {"color": GREY, "linewidth": 1.0, "linestyle": (0, (4, 2))}
MOST_BARS, LOG = 100, 1000  # points above which no error bars are drawn, and of a log that may have spikes
GAMMA, DEVIATION = "Recorded heading γ (° magnetic)", "Deviation β − γ (°)"


def draw_figure(figure: str, path: str | Path, shown: StoredCalibration) -> None:
    """Draw one figure of a calibration: ``compared``, or one of ``calibrations.FIGURES`` or ``calibrations.KINDS``."""
    common = {"deviation": draw_deviation, "certificate": draw_certificate, "compared": draw_compared}
    if draw := common.get(figure):
        draw(path, shown)
    else:
        getattr(instruments, f"draw_{figure}")(path, shown)


def draw_deviation(path: str | Path, shown: StoredCalibration) -> None:
    """Draw readings, curves with the 95 % band of the chosen one, a swing's limit of ISO 25862, and residuals."""
    with page(path, 5.6) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2.2, 1.0))
        handles = deviation_panel(above, shown)
        above.set(xlabel="", title="")
        if handles and shown.content["kind"] == "swing":
            limits = [above.axhline(edge, **LIMIT) for edge in (-adjustment.LIMIT_DEG, adjustment.LIMIT_DEG)]
            limits[0].set_label(f"{adjustment.LIMIT_DEG:g}° (ISO 25862)")
            handles.append(limits[0])
        off, recorded = shown.points.get("residual_deg"), shown.points.get("recorded_deg")
        if off is None or recorded is None or not np.isfinite(off).any():
            empty(below, words="no residuals")
        else:
            below.plot(recorded, off, **_point(len(off)))
            expanded = shown.content["uncertainty"]["expanded_deg"] or 0.0
            edges = [below.axhline(edge, **EDGE) for edge in (-expanded, expanded)]
            edges[0].set_label("expanded uncertainty (k = 2)")
            handles.append(edges[0])
            below.axhline(0.0, color=BLACK, linewidth=0.6)
            below.set(xlabel=GAMMA, ylabel="Observed minus\ncurve (°)")
        figure.align_ylabels()
        legend(figure, handles, columns=1)


def deviation_panel(axes: Axes, shown: StoredCalibration) -> list[Artist]:
    """Draw points, band and curves into a panel and return the handles of its legend."""
    content, points, table = shown.content, shown.points, shown.table
    models = {name: model for name, model in content.get("models", {}).items() if "coefficients" in model}
    readings = {"recorded_deg", "deviation_deg"} <= set(points)
    if not (models or table.heading_deg.size or readings):
        empty(axes, words="no readings")
        return []
    handles, ends = list[Artist](), list[Floats]([np.zeros(1)])
    if readings:
        recorded, deviation = points["recorded_deg"], points["deviation_deg"]
        scatter, bar = content["uncertainty"]["rows"].get("fit_residual", {}).get("standard_deg"), ""
        if scatter is not None and len(recorded) <= MOST_BARS:
            axes.errorbar(recorded, deviation, 2.0 * scatter, fmt="none", ecolor=GREY, elinewidth=0.8)
            bar = f", ±{2.0 * scatter:.2f}° (k = 2)"
        axes.plot(recorded, deviation, **_point(len(recorded)))
        handles.append(Line2D([], [], **POINT, label=f"{len(recorded)} readings{bar}"))
        ends.append(np.percentile(deviation, (0.5, 99.5)) if len(recorded) > LOG else deviation)  # without spikes
    heading, middle, half = np.append(table.heading_deg, 360.0), table.deviation_deg, NORMAL_95 * table.sigma_deg
    ends += [middle - half, middle + half]
    if np.isfinite(half).any():
        middle, half = (np.append(x, x[0]) for x in (middle, half))
        kept = slice(None, -1 if content["model"] == "polynomial" else None)  # discontinuous at north
        axes.fill_between(heading[kept], (middle - half)[kept], (middle + half)[kept], **PALE_BAND)
        handles.append(Patch(**PALE_BAND, label="95 % interval, budget included"))
    if not models and table.heading_deg.size:
        axes.plot(heading, np.append(table.deviation_deg, table.deviation_deg[0]), color=GREEN)
        name = MODELS.get(content["model"], content["model"])
        handles.append(Line2D([], [], color=GREEN, label=name))
    for name in sorted(models, key=lambda name: name == content["model"]):  # the chosen one lies on top
        chosen = name == content["model"]
        recorded, off = _curve(name, models[name]["coefficients"], shown)
        label = f"{MODELS[name]}, cross-validated rms {models[name]['left_out_rms_deg']:.2f}°"
        look: dict[str, Any] = {"color": COLOURS[name], "linewidth": 1.8 if chosen else 1.0}
        look |= {} if chosen else {"linestyle": (0, (4, 1.5))}
        axes.plot(recorded, off, **look)
        handles.append(Line2D([], [], **look, label=label + (" (used)" if chosen else "")))
        ends += [off] if chosen else []
    low, high = float(np.nanmin(np.concatenate(ends))), float(np.nanmax(np.concatenate(ends)))
    room = max(0.08 * (high - low), 0.5)
    axes.set_ylim(low - room, high + room)
    axes.axhline(0.0, color=BLACK, linewidth=0.6)
    degrees(axes.xaxis, (0.0, 360.0))
    axes.set(xlabel=GAMMA, ylabel=DEVIATION)
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
    off = nearest_turn(angles.difference(turn, recorded), angles.wrap180(middle))
    breaks = [np.abs(np.diff(x, append=x[-1])) > 180.0 for x in (recorded, off)]
    return recorded, np.where(breaks[0] | breaks[1], np.nan, off)


def _point(count: int) -> dict[str, Any]:
    """Choose the style of a number of points: smaller markers for many points."""
    return POINT if count <= MOST_BARS else POINT | {"markersize": 1.6}


def draw_compared(path: str | Path, shown: StoredCalibration) -> None:
    """Draw the series of several calibrations with their shift from the first (k = 2), and the readings of this one."""
    curves, points = [each for each in shown.content["compared"] if each["coefficients"]], shown.points
    with page(path, 3.6) as figure:
        axes, handles = figure.subplots(), list[Artist]()
        for colour, each in zip(cycle((BLACK, SKY, ORANGE, GREEN, PURPLE, BLUE, VERMILION)), curves):
            letters = np.nan_to_num(np.array(list(each["coefficients"].values()), dtype=float))
            axes.plot(TURN_DEG, series_design(TURN_DEG) @ letters, color=colour)
            label, phase, size = (
                textwrap.shorten(each["name"], 20, placeholder="…"),
                each["phase_deg"],
                each["amplitude_deg"],
            )
            if each is curves[0]:
                label += " (first)"
            else:
                shift = (
                    f"shift {signed(phase['shift'], '+.0f')}° ± {2.0 * phase['sigma']:.0f}°" if phase else "no phase"
                )
                label += f": {shift}"
                if size:
                    label += f", amplitude {signed(size['difference'], '+.1f')}° ± {2.0 * size['sigma']:.1f}°"
            handles.append(Line2D([], [], color=colour, label=label))
        if not curves:
            empty(axes, words="no curves")
            return
        if {"recorded_deg", "deviation_deg"} <= set(points):
            axes.plot(points["recorded_deg"], points["deviation_deg"], **_point(len(points["recorded_deg"])))
            handles.append(Line2D([], [], **POINT, label="readings of the last"))
        axes.axhline(0.0, color=BLACK, linewidth=0.6)
        degrees(axes.xaxis, (0.0, 360.0))
        axes.set(xlabel=GAMMA, ylabel=DEVIATION)
        legend(figure, handles, columns=1)


def draw_certificate(path: str | Path, shown: StoredCalibration) -> None:
    """Draw the one-page certificate of a calibration: curve, table, coefficients, uncertainty, date and place."""
    title = f"{shown.content['name']}: calibration of a compass, kind {shown.content['kind']}"
    text, high = writing(shown), 3.1
    first = max(len(text.about), len(text.budget)) + 1  # line at which the table begins
    last = first + len(text.table) + 1
    height_in = LINE_IN * (last + len(text.notes) + 2)
    with page(path, high + 0.7 + height_in, width_in=WIDE_IN, title=title) as figure:
        curve, below = figure.subplots(2, 1, height_ratios=(high, height_in))
        if handles := deviation_panel(curve, shown):
            curve.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
        below.set_axis_off()
        parts = ((0.0, 0, text.about), (0.52, 0, text.budget), (0.0, first, text.table), (0.0, last, text.notes))
        for across, line, lines in parts:
            family = "sans-serif" if lines is text.notes else "monospace"
            offset = (0.0, -72.0 * LINE_IN * line)
            below.annotate("\n".join(lines), (across, 1.0), offset, family=family, **TEXT)


# Text of a certificate: date, place and model, coefficients, uncertainty budget, and table of deviations.

LINE_IN = 0.131  # line height of this text
UNKNOWN, SPACE = "–", " " * 8
TEXT: dict[str, Any] = {
    "xycoords": "axes fraction", "textcoords": "offset points", "va": "top", "fontsize": 7.0, "linespacing": 1.35,
    "annotation_clip": False,
}  # fmt: skip


class Writing(NamedTuple):
    """Lines of text below the curve of a certificate."""

    about: list[str]
    budget: list[str]
    table: list[str]
    notes: list[str]


def writing(shown: StoredCalibration) -> Writing:
    """Compose the text of a certificate."""
    content = shown.content
    extras = [content.get("constant_shift"), content.get("comparison")]
    texts = [f"No curve: {content['why'].rstrip('.')}."] if content["why"] else []
    texts += [f"Note: {text.rstrip('.')}." for text in content["warnings"]]
    texts += [extra["text"] for extra in extras if extra and extra.get("text")]
    uncertainty = content["uncertainty"]
    names = {name: name.removesuffix("_deg").replace("_", " ") for name in uncertainty["rows"]}
    wide = max([18, *(1 + len(text) for text in names.values())])
    rows = [f"  {names[name]:<{wide}}{row['standard_deg']:6.2f}°" for name, row in uncertainty["rows"].items()]
    ends = (("combined", "standard_deg"), ("expanded (k = 2)", "expanded_deg"))
    totals = [f"  {name:<{wide}}{_number(uncertainty[key], '6.2f')}°" for name, key in ends]
    return Writing(
        [*_about(content), "", *_coefficients(content)],
        ["standard uncertainties", *rows, "", *totals],
        _table(shown),
        [line for text in texts for line in textwrap.wrap(text, 118)],
    )


def _about(content: Mapping[str, Any]) -> list[str]:
    place, field = content["place"], content["place"]["field"]
    where = UNKNOWN
    if place["latitude"] is not None:
        north, east = place["latitude"], float(angles.wrap180(place["longitude"]))
        where = f"{abs(north):.4f}° {'N' if north >= 0 else 'S'}, {abs(east):.4f}° {'E' if east >= 0 else 'W'}"
    strength = UNKNOWN if field is None else f"H {field['horizontal_nT']:.0f} nT, Z {field['vertical_nT']:.0f} nT"
    late, model = content["lag_s"] if content.get("delay") else None, MODELS.get(content["model"], content["model"])
    return [
        f"date        {place['date'] or UNKNOWN}",
        f"place       {where}",
        f"field       {strength}",
        f"readings    {content['n']} in {content['coverage']} of 36 sectors",
        f"model       {textwrap.shorten(model, 40, placeholder=' …')}",
        f"residual    {_number(content['residual_rms_deg'], '.2f')}° rms",
        *([f"course late {late[0]:.1f} ± {NORMAL_95 * late[1]:.1f} s (95 %), applied"] if late else []),
    ]


def _coefficients(content: Mapping[str, Any]) -> list[str]:
    letters, exact = content["coefficients"], content["exact"]
    if not (letters or exact):
        return ["coefficients: none"]
    covariance = content["covariance"] if letters else exact["covariance"]
    sigma = dict(zip(LETTERS, np.sqrt(np.diag(np.array(covariance, dtype=float))), strict=True))
    if letters:
        rows = [f"    {k}   {_number(letters[k], '+7.2f')}°  ± {_number(s, '.2f')}°" for k, s in sigma.items()]
        return ["series in the recorded heading, ± standard", *rows]
    rows = [f"    {k}   {exact['coefficients'][k]:+8.4f}  ± {s:.4f}" for k, s in sigma.items()]
    return ["exact compass, ± standard", *rows]


def _table(shown: StoredCalibration, columns: int = 3) -> list[str]:
    table = shown.table
    if not np.isfinite(table.deviation_deg).any():
        return ["table of deviations: none"]
    rows = [
        f"{h:5.0f}° {_number(d, '+.2f'):>7}° {_number(s, '.2f'):>6}°"
        for h, d, s in zip(table.heading_deg, table.deviation_deg, table.sigma_deg, strict=True)
    ]
    high = -(-len(rows) // columns)
    head = SPACE.join([f"{'head.':>6} {'dev.':>8} {'unc.':>7}"] * columns)
    return [head, *(SPACE.join(rows[k::high]) for k in range(high))]


def _number(value: float | None, form: str) -> str:
    return UNKNOWN if value is None or not np.isfinite(value) else format(value, form)
