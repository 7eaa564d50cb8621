"""Figures of moorings: map, array, deviations, differences from the reference, currents, rotary spectra."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from compasslib import angles
from compasslib.archive.gridded import DepthSeries
from compasslib.deviation.assessment import BIN_DEG, BINS
from compasslib.deviation.model import DeviationFit
from compasslib.plots import page
from compasslib.plots.deviation import GIVEN_UP, deviation_curve
from compasslib.plots.timeseries import round_down
from compasslib.statistics.noise import rotary_spectrum
from compasslib.types import Complexes, Floats

NAMED = 20  # number of moorings above which a figure shows no names


@dataclass(frozen=True)
class AssessedMooring:
    """Data of one mooring for the figures of a cruise."""

    name: str
    fit: DeviationFit  # as used for the product, may lack coefficients
    assessment: Mapping[str, Any]  # content of assessment.json


def draw_curves(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw the deviation of each mooring's compass by correct heading, few moorings in panels of their own."""
    curves = {}
    for mooring in (mooring for mooring in moorings if mooring.fit.fitted):
        fitted = deviation_curve(mooring.fit, 0.0, np.zeros(0))
        deviation = angles.wrap180(fitted.deviation_deg)
        jumps = np.abs(np.diff(deviation, prepend=deviation[0])) > 180.0
        curves[mooring.name] = (fitted.heading_deg, np.where((fitted.stretch == GIVEN_UP) | jumps, np.nan, deviation))
    names = list(curves) if 0 < len(curves) <= NAMED else [""]
    columns = min(len(names), 4)
    rows = -(-len(names) // columns)
    with page.create(path, 0.6 + (1.4 * rows if columns > 1 else 2.8), width_in=page.WIDE_IN) as figure:
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        for axes, name in zip(panels.flat, names, strict=False):
            page.degrees(axes.xaxis, (0.0, 360.0))
            axes.grid(alpha=0.3, linewidth=0.5)
            axes.axhline(0.0, color=page.BLACK, linewidth=0.7)
            for k, (other, curve) in enumerate(curves.items()):
                colour = page.GREY if name else colormaps["viridis"](k / len(curves))
                if other != name:
                    axes.plot(*curve, color=colour, linewidth=0.6, alpha=0.6)
            if name:
                axes.plot(*curves[name], color=page.BLUE, linewidth=1.5)
                axes.set_title(name)
        for axes in panels.flat[max(len(names) - columns, 0) : len(names)]:
            axes.tick_params(labelbottom=True)  # the lowest of its column
        for axes in panels.flat[len(names) :]:
            axes.remove()
        if not curves:
            page.empty(panels[0, 0])
        figure.supxlabel("Correct heading β (° magnetic)", fontsize=8.0)
        figure.supylabel("Deviation β − γ (°)", fontsize=8.0, x=0.005)


def draw_differences(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw histograms and rms of each mooring's held-out differences from the reference, before and after."""
    shown = [mooring for mooring in moorings if mooring.assessment["before"]["n"]]
    names = [mooring.name for mooring in shown] if len(shown) <= NAMED else [""] * len(shown)
    rows = page.Rows(names)
    panel = 2.0 * rows.height_in if len(shown) <= NAMED else 5.0
    with page.create(path, 0.9 + max(panel, 0.8), width_in=page.WIDE_IN) as figure:
        axes, intervals = figure.subplots(1, 2, width_ratios=(3.0, 1.0), sharey=True)
        page.degrees(axes.xaxis, (-180.0, 180.0), as_is=True)
        axes.set(xlabel="Affected minus reference, held out pairs (°)", title="difference")
        intervals.set(xlabel="Rms, 95 % (°)", title="rms")
        if not shown:
            page.empty(axes, intervals)
            return
        edges = -180.0 + BIN_DEG * np.arange(BINS + 1)
        for place, mooring in zip(rows.places, shown, strict=True):
            base = place + 0.5
            tallest = max(_shares(mooring, when).max() for when in ("before", "after"))
            for when, colour, shift in (("before", page.RECORDED, -0.12), ("after", page.CORRECTED, 0.12)):
                top = base - 0.95 * _shares(mooring, when) / max(tallest, 1e-9)
                axes.stairs(top, edges, baseline=base, color=colour)
                if mooring.assessment[when]["n"]:
                    low, end = mooring.assessment[when]["interval_95"]["rms_deg"]
                    intervals.plot([low, end], [place + shift] * 2, color=colour)
                    intervals.plot(mooring.assessment[when]["rms_deg"], place + shift, "o", color=colour, markersize=3)
        axes.axvline(0.0, color=page.BLACK, linewidth=0.7)
        intervals.set_xlim(left=0.0)
        intervals.grid(axis="x", alpha=0.3, linewidth=0.5)
        intervals.tick_params(left=False)
        rows.name(axes)
        if len(shown) > NAMED:
            axes.tick_params(left=False, labelleft=False)
        words = {"before": page.RECORDED, "after": page.CORRECTED}
        page.legend(figure, [page.line(when, color=colour) for when, colour in words.items()])


def _shares(mooring: AssessedMooring, when: str) -> Floats:
    """Compute the share of the differences in each bin, (72,)."""
    counts = np.array(mooring.assessment["difference_counts"][when], dtype=float)
    return counts / max(float(counts.sum()), 1.0)


def draw_currents(path: str | Path, moorings: list[AssessedMooring]) -> None:
    """Draw each mooring's mean current and variance ellipse at the pairs, recorded, corrected and of the reference."""
    outlines = [(m.name, outlined) for m in moorings if (outlined := _outline_currents(m.assessment["currents"]))]
    if not outlines:
        with page.create(path, 1.5, width_in=page.WIDE_IN) as figure:
            page.empty(figure.subplots())
        return
    corners = [np.concatenate([[0.0], *(z[np.isfinite(z)] for z in outlined.values())]) for _, outlined in outlines]
    middles = [complex(np.ptp(z.real) / 2.0 + z.real.min(), np.ptp(z.imag) / 2.0 + z.imag.min()) for z in corners]
    wide, high = (1.15 * max(float(np.ptp(part(z))) for z in corners) for part in (np.real, np.imag))
    named = len(outlines) <= NAMED
    high += named * 0.15 * wide
    columns = min(len(outlines), 5 if named else 12)
    lines, across = -(-len(outlines) // columns), max(columns, 3)
    with page.create(path, 0.5 + page.WIDE_IN / across * high / wide * lines, width_in=page.WIDE_IN) as figure:
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_aspect("equal")
        for k, ((name, outlined), middle) in enumerate(zip(outlines, middles, strict=True)):
            cell = complex(wide * (k % columns), -high * (k // columns))
            for series, outline in outlined.items():
                points = cell - middle + outline
                below = series == "reference"
                look: dict[str, Any] = {"linewidth": 3.5, "alpha": 0.6} if below else {"linewidth": 1.2}
                axes.plot(points.real, points.imag, color=page.COLOURS[series], **look)
            axes.plot((cell - middle).real, (cell - middle).imag, "k+", markersize=6)
            if named:
                axes.text(cell.real, cell.imag + 0.45 * high, name, ha="center", va="center")
        axes.set_xlim(wide * (columns - across - 1) / 2.0, wide * (columns + across - 1) / 2.0)
        axes.set_ylim(high * (0.5 - lines) - 0.15 * wide, high * 0.5)
        scale, left = round_down(wide / 3.0), axes.get_xlim()[0]
        axes.plot([left, left + scale], [high * (0.5 - lines) - 0.1 * wide] * 2, color=page.BLACK)
        handles = [page.line(name, color=page.COLOURS[name]) for name in SERIES]
        handles.append(page.line(f"{scale:g} cm/s; north is up", color=page.BLACK))
        page.legend(figure, handles, columns=4)


def _outline_currents(currents: Mapping[str, Any]) -> dict[str, Complexes]:
    """Compute outlines of the currents, cm/s east + i north: a line from the origin to the mean, and the ellipse."""
    outlines: dict[str, Complexes] = {}
    turn = angles.phasor(np.linspace(0.0, 360.0, 73))
    for name in ("reference", "recorded", "corrected"):
        if (current := currents[name]) is None:
            continue
        mean = page.CM * complex(current["east_m_s"], current["north_m_s"])
        along = angles.phasor(90.0 - (current["major_towards_deg"] or 0.0))
        ellipse = page.CM * along * (current["major_m_s"] * turn.real + 1j * current["minor_m_s"] * turn.imag)
        outlines[name] = np.concatenate([[0.0, mean, complex(np.nan, np.nan)], mean + ellipse])
    return outlines


ROLES = {"affected": page.VERMILION, "reference": page.BLUE, "other": page.GREY}
SERIES = ("recorded", "corrected", "reference")
MARKERS = {"up": "^", "down": "v", None: "o"}


def draw_rotary(path: str | Path, series: DepthSeries) -> None:
    """Draw rotary spectra with their 95 % interval, and the inertial, diurnal and semidiurnal frequencies."""
    spectra = {name: rotary_spectrum(flow, series.step_s) for name, flow in series.velocity.items()}
    known = {name: each for name, each in spectra.items() if np.isfinite(each.clockwise).any()}
    sidereal_cpd = 1.00273791  # turns of the earth in a day, the frequency of K1
    inertial_cpd = 2.0 * abs(float(angles.sin_cos(series.latitude)[0])) * sidereal_cpd
    marks = {"K1": sidereal_cpd, "M2": 24.0 / 12.4206, "f": inertial_cpd}  # cycles per day
    if not known:
        with page.create(path, 0.8) as figure:
            page.empty(figure.subplots(), words="no 15 days without a gap")
        return
    with page.create(path, 4.4) as figure:
        panels = figure.subplots(2, 1, sharex=True, sharey=True)
        for axes, sense in zip(panels, ("clockwise", "counterclockwise"), strict=True):
            for name in (name for name in SERIES if name in known):
                density = page.CM**2 * getattr(known[name], sense)
                axes.loglog(known[name].frequency_cpd, density, color=page.COLOURS[name], linewidth=1.0)
            for frequency in marks.values():
                axes.axvline(frequency, color="#444444", linewidth=0.5, linestyle=":")
            axes.minorticks_off()  # each takes as long as a line
            axes.xaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_major_formatter("{x:g}")
            axes.set(title=sense.capitalize(), ylabel="Density ((cm/s)²/cpd)")
        low, high = np.array([known[name].interval for name in known]).T
        floor = page.CM**2 * min(float(np.nanmin(each.clockwise)) for each in known.values())
        at = floor * np.array([low.min(), 1.0, high.max()]) * 3.0
        left = 1.3 * min(float(each.frequency_cpd[0]) for each in known.values())
        panels[0].errorbar(
            left, at[1], [[at[1] - at[0]], [at[2] - at[1]]], color=page.BLACK, capsize=2.0, linewidth=0.8
        )
        panels[0].annotate("95 %", (left, at[1]), xytext=(4.0, 0.0), textcoords="offset points", va="center")
        for name, frequency in marks.items():
            side = {"ha": "right", "xytext": (-2.0, -1.0)} if name == "f" else {"xytext": (2.0, -1.0)}
            place: dict[str, Any] = {"textcoords": "offset points", "va": "top", **side}
            panels[int(name == "f")].annotate(name, (frequency, 1.0), xycoords=("data", "axes fraction"), **place)
        panels[1].set_xlabel("Frequency (cycles per day)")
        labels = {name: f"{name}, {series.depth_m[name]:g} m" for name in SERIES if name in known}
        page.legend(figure, [page.line(label, color=page.COLOURS[name]) for name, label in labels.items()])


def draw_map(path: str | Path, moorings: Sequence[Mapping[str, Any]]) -> None:
    """Draw the positions from above, given by name, latitude and longitude; if many lie close together, these again."""
    north, east = (np.array([mooring[key] for mooring in moorings]) for key in ("latitude", "longitude"))
    names = [str(mooring["name"]) if len(moorings) <= NAMED else "" for mooring in moorings]
    if not names:
        with page.create(path, 1.5, width_in=page.WIDE_IN) as figure:
            page.empty(figure.subplots())
        return
    middle = float(angles.wrap180(angles.mean(east)))
    east = middle + angles.difference(east, middle)  # one side of the date line
    away = np.maximum(np.abs(north - np.median(north)), np.abs(east - np.median(east)))
    close = np.flatnonzero(away < 0.1 * away.max())
    several = len(close) > 2 and any(names)
    with page.create(path, 3.8, width_in=page.WIDE_IN) as figure:
        panels = figure.subplots(1, 1 + several, squeeze=False)[0]
        if several:
            _draw_positions(panels[1], north[close], east[close], [names[k] for k in close])
            names = [("(b)" if k == close[0] else "") if k in close else name for k, name in enumerate(names)]
        _draw_positions(panels[0], north, east, names)


def _draw_positions(axes: Axes, north: Floats, east: Floats, names: Sequence[str]) -> None:
    """Draw positions, (n,) degrees, with a scale bar; names stand at the right, by latitude."""
    narrow = max(float(angles.sin_cos(north.mean())[1]), 0.01)  # degrees of longitude are shorter than of latitude
    half = 0.6 * np.array([narrow * np.ptp(east), np.ptp(north)])
    half = np.maximum(half, max(0.4 * float(half.max()), 0.01)) / (narrow, 1.0)
    middle = np.array([east.min() + east.max(), north.min() + north.max()]) / 2.0
    (left, bottom), (right, top) = middle - half, middle + half
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect=1.0 / narrow)
    axes.plot(east, north, linestyle="", marker="o", markersize=3.0, color=page.VERMILION)
    margin = axes.inset_axes((1.0, 0.0, 0.05, 1.0))
    margin.set_axis_off()
    named = [k for k in np.argsort(-north) if names[k]]
    look: dict[str, Any] = {"va": "center", "xycoords": axes.transData, "textcoords": "axes fraction"}
    look["arrowprops"] = {"arrowstyle": "-", "color": page.GREY, "linewidth": 0.5, "relpos": (0.0, 0.5)}
    for row, k in enumerate(named):
        margin.annotate(names[k], (east[k], north[k]), (1.0, 1.0 - (row + 0.5) / len(named)), **look)
    degree_km = 111.2 * narrow
    scale_km = round_down(degree_km * half[0])
    bar: dict[str, Any] = {"color": page.BLACK, "linewidth": 4.0, "solid_capstyle": "butt", "clip_on": False}
    axes.plot([right - scale_km / degree_km, right], [top, top], **bar)
    axes.set_title(f"{scale_km:g} km", loc="right")
    axes.locator_params(nbins=4, steps=[1, 2, 5, 10])
    axes.set(xlabel="Longitude (° E)", ylabel="Latitude (° N)")


def draw_array(path: str | Path, moorings: Sequence[Mapping[str, Any]]) -> None:
    """Draw the moorings side by side: water depth, and depth and orientation of the instruments.

    Args:
        moorings: name, water_depth_m and instruments, each with depth_m (None for a profiler), orientation (up, down or
            None) and role (affected, reference or other).
    """
    with page.create(path, 3.8, width_in=page.WIDE_IN) as figure:
        axes = figure.subplots()
        if not moorings:
            page.empty(axes)
            return
        bottom = [mooring["water_depth_m"] for mooring in moorings]
        deepest = 1.08 * max(bottom)
        axes.bar(range(len(moorings)), [deepest - depth for depth in bottom], 0.9, bottom, color=page.GREY, alpha=0.4)
        for k, mooring in enumerate(moorings):
            depths = [each["depth_m"] for each in mooring["instruments"] if each["depth_m"] is not None]
            line = [min(depths, default=0.0), bottom[k]]
            axes.plot([k, k], line, color=page.BLACK, linewidth=0.7)
            for each in mooring["instruments"]:
                colour = ROLES[each["role"]]
                if each["depth_m"] is None:
                    axes.plot([k, k], line, color=colour, linewidth=3.0, alpha=0.5)
                else:
                    size = 8.0 if each["role"] == "affected" else 5.0
                    marker = MARKERS[each["orientation"]]
                    axes.plot(k, each["depth_m"], marker, color=colour, markersize=size, markeredgewidth=0, zorder=3)
        named = len(moorings) <= NAMED
        names = [str(mooring["name"]) for mooring in moorings] if named else []
        axes.set_xticks(range(len(names)), names, rotation=90 if len(names) > 12 else 0)
        axes.set(xlabel="" if named else f"{len(moorings)} moorings", ylabel="Depth (m)")
        axes.set_ylim(deepest, -0.02 * deepest)
        point: dict[str, Any] = {"linestyle": "", "markersize": 5, "markeredgewidth": 0}
        handles: list[Artist] = [page.line(role, **point, marker="s", color=ROLES[role]) for role in ROLES]
        handles += [page.line("looks up", **point, marker="^", color=page.BLACK)]
        handles += [page.line("looks down", **point, marker="v", color=page.BLACK)]
        handles += [page.line("profiler", color=page.BLACK, linewidth=3.0, alpha=0.5)]
        handles += [Patch(color=page.GREY, alpha=0.4, linewidth=0, label="bottom")]
        page.legend(figure, handles, columns=4)
