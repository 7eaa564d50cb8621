"""Figures of the deviation, and of the agreement of currents before and after (von Appen 2015, Figs 6 to 9)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator
from numpy.typing import ArrayLike, NDArray

from compasslib import angles, compass
from compasslib.deviation import model
from compasslib.deviation.assessment import BIN_DEG, BINS, Counts, directions_at_pairs
from compasslib.deviation.correction import reference_modes
from compasslib.deviation.exact import correct_roots, reading_slope
from compasslib.deviation.series import inverse_table, series_design, series_deviation
from compasslib.plots import page
from compasslib.records import CorrectedRecord, Pairs
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

INVERTED, BACKWARDS, GIVEN_UP = "inverted", "recorded heading decreasing", "not inverted"  # parts of a curve
STRETCH_COLOURS = {GIVEN_UP: page.VERMILION, INVERTED: page.GREEN, BACKWARDS: page.BLUE}
PUBLISHED_STRETCHES = {INVERTED: "fit, invertible", GIVEN_UP: "fit, not invertible"}
FOLDED_STRETCHES = {INVERTED: "fit, reading turns with the instrument", BACKWARDS: "fit, reading turns backwards"}
WHOLE_STRETCH = {INVERTED: "fit, invertible"}
POINT: dict[str, Any] = {"linestyle": "", "marker": "o", "markersize": 2.5, "color": "#333333", "markeredgewidth": 0}
RING: dict[str, Any] = {**POINT, "color": page.BLACK, "markerfacecolor": "white", "markeredgewidth": 0.7}
CORRECT, RECORDS, DEVIATES = "Correct β (°)", "Recorded γ (°)", "Deviation β − γ (°)"


def draw_deviation(path: str | Path, pairs: Pairs, fit: model.DeviationFit) -> None:
    """Draw deviation by correct heading, recorded by correct heading, and the inverse (von Appen 2015, Figs 6, 7)."""
    heading = model.observed_heading(pairs)
    begin = page.emptiest(heading)
    curve = deviation_curve(fit, begin, heading) if fit.fitted else None
    beta, deviation = page.placed(heading, begin), model.observed_deviation(pairs)
    middle = angles.wrap180(angles.mean(deviation))
    if curve:
        middle = np.interp(beta, curve.heading_deg, curve.deviation_deg)
    delta = page.nearest_turn(deviation, middle)  # unwrapped to the curve; without one, to the mean
    handles = _deviation_handles(pairs, fit, curve)
    with page.create(path, 4.0 + 0.16 * len(handles)) as figure:
        panels = list(figure.subplot_mosaic([["a", "a"], ["b", "c"]]).values())  # a wide one above two narrow ones
        line = (curve.deviation_deg, curve.recorded_deg) if curve else (np.zeros(0), np.zeros(0))
        turn, recorded = (begin, begin + 360.0), span_of(beta - delta, line[1])  # the correct heading is cut at its gap
        for axes, across, up, xlabel, ylabel, title in (
            (panels[0], turn, span_of(delta, line[0]), CORRECT, DEVIATES, "deviation"),
            (panels[1], turn, recorded, CORRECT, RECORDS, "recorded"),
            (panels[2], recorded, turn, RECORDS, CORRECT, "inverse"),
        ):
            page.degrees(axes.xaxis, across)
            page.degrees(axes.yaxis, up, as_is=ylabel == DEVIATES)
            axes.set(xlabel=xlabel, ylabel=ylabel, title=title)
        if not (len(pairs) or curve):
            page.empty(*panels)
            return
        slower = np.minimum(
            *model.pair_speeds(pairs)
        )  # pairs are paler where the current is slow, and if there are many
        clear = np.nan_to_num(slower) / max(float(np.nanpercentile(slower, 75.0)) if len(slower) else 1.0, 1e-6)
        faint = float(np.clip(15.0 / np.sqrt(max(len(slower), 1)), 0.08, 0.8))
        for level in (0.2, 0.4, 0.6, 0.8, 1.0):
            here = np.ceil(5.0 * np.clip(clear, 0.1, 1.0)) == 5.0 * level
            for axes, x, y in zip(panels, (beta, beta, beta - delta), (delta, beta - delta, beta), strict=True):
                axes.plot(x[here], y[here], **POINT | {"markersize": 2.0, "rasterized": True}, alpha=level * faint)
        panels[0].axhline(0.0, color=page.BLACK, linewidth=0.7)  # of an iron-free compass
        for axes in panels[1:]:
            axes.axline((0.0, 0.0), slope=1.0, color=page.BLACK, linewidth=0.7)
        if curve is not None:
            _draw_curve(panels, fit, curve)
        page.legend(figure, handles, columns=1)


@dataclass(frozen=True)
class DeviationByHeading:
    """Deviation over one turn of the correct heading, unwrapped: without jumps of 360 degrees."""

    heading_deg: Floats  # (n,) correct heading, increasing
    deviation_deg: Floats  # (n,)
    sigma_deg: Floats  # (n,) standard error of the deviation, by the covariance of the coefficients; NaN if unknown
    stretch: NDArray[np.str_]  # (n,) INVERTED, BACKWARDS or GIVEN_UP

    @property
    def recorded_deg(self) -> Floats:
        """Recorded heading along the curve, (n,), unwrapped."""
        return self.heading_deg - self.deviation_deg


def deviation_curve(fit: model.DeviationFit, begin_deg: float, headings_deg: ArrayLike) -> DeviationByHeading:
    """Evaluate a fitted deviation over one turn from ``begin_deg``.

    Args:
        headings_deg: correct headings at which the median deviation is in [-180, 180); the whole turn if empty.
    """
    beta = begin_deg + np.linspace(0.0, 360.0, 1441)
    if fit.method == "von_appen":
        deviation = series_deviation(fit.coefficients, beta)
    else:
        deviation = angles.difference(beta, compass.recorded_heading(fit.coefficients, beta))
    deviation = deviation[0] + np.concatenate([[0.0], np.cumsum(angles.difference(deviation[1:], deviation[:-1]))])
    where = page.placed(headings_deg, begin_deg)
    there = np.interp(where[np.isfinite(where)], beta, deviation)
    level = np.median(there if there.size else deviation)
    deviation = deviation - (level - angles.wrap180(level))
    sigma = np.full(beta.shape, np.nan)
    if fit.covariance.size:
        by = series_design(beta).T if fit.method == "von_appen" else compass.gradient(fit.coefficients, beta)
        reference = reference_modes(fit, beta) * reading_slope(fit, beta)[:, None]
        variance = np.einsum("in,ij,jn->n", by, fit.covariance[:5, :5], by)
        sigma = np.sqrt(variance + np.sum(reference**2, axis=1))
    # The exact compass is inverted at all headings, but two of them may have the same recorded heading.
    if fit.method == "von_appen":
        inverted = inverse_table(fit.coefficients)[1]
        first, last = inverted.min(), inverted.max()
        stretch = np.where(angles.wrap360(beta - first) <= last - first, INVERTED, GIVEN_UP)
    else:
        stretch = np.where(compass.slope(fit.coefficients, beta) >= 0.0, INVERTED, BACKWARDS)
    return DeviationByHeading(beta, deviation, sigma, stretch)


def span_of(points: Floats, line: Floats) -> page.Limits:
    """Compute axis limits that contain a whole line and 98 % of the points, degrees; either may be empty."""
    finite = points[np.isfinite(points)]
    ends = np.concatenate([line[np.isfinite(line)], np.percentile(finite, (1.0, 99.0)) if finite.size else []])
    if not ends.size:
        return -180.0, 180.0
    low, high = float(ends.min()), float(ends.max())
    half = max((high - low) * 0.53, 30.0)
    return (low + high) / 2.0 - half, (low + high) / 2.0 + half


def _draw_curve(panels: Sequence[Axes], fit: model.DeviationFit, curve: DeviationByHeading) -> None:
    """Draw the curve with its 95 % band in the three panels, and the inverse used in the correction as rings."""
    half = np.minimum(NORMAL_95 * curve.sigma_deg, 180.0)
    beta, delta, gamma = curve.heading_deg, curve.deviation_deg, curve.recorded_deg
    panels[0].fill_between(beta, delta - half, delta + half, **page.BAND)
    panels[1].fill_between(beta, gamma - half, gamma + half, **page.BAND)
    panels[2].fill_betweenx(beta, gamma - half, gamma + half, **page.BAND)
    for axes, x, y in zip(panels, (beta, beta, gamma), (delta, gamma, beta), strict=True):
        for stretch, colour in STRETCH_COLOURS.items():
            axes.plot(x, np.where(curve.stretch == stretch, y, np.nan), color=colour)
    covered = curve.recorded_deg[curve.stretch != GIVEN_UP]
    low, high = float(covered.min()), float(covered.max())
    rings = int(np.clip((high - low) / 5.0, 4.0, 24.0))
    recorded = low + (high - low) * (np.arange(rings) + 0.5) / rings
    inverted = page.placed(correct_roots(fit, recorded), curve.heading_deg[0])
    nearest = page.nearest_turn(recorded[:, None], np.interp(inverted, curve.heading_deg, curve.recorded_deg))
    panels[2].plot(nearest.ravel(), inverted.ravel(), **RING)


def _deviation_handles(pairs: Pairs, fit: model.DeviationFit, curve: DeviationByHeading | None) -> list[Artist]:
    handles: list[Artist] = []
    if len(pairs):
        handles.append(page.line(f"{len(pairs)} pairs, paler at low speed", **POINT))
    handles.append(page.line("no deviation", color=page.BLACK, linewidth=0.7))
    if curve is None:
        return handles
    names = PUBLISHED_STRETCHES if fit.method == "von_appen" else FOLDED_STRETCHES if fit.folded else WHOLE_STRETCH
    for stretch, text in names.items():
        if (curve.stretch == stretch).any():
            handles.append(page.line(text, color=STRETCH_COLOURS[stretch]))
    if np.isfinite(curve.sigma_deg).any():
        handles.append(Patch(**page.BAND, label="95 % band of the fit"))
    text = "correction by lookup table" if fit.method == "von_appen" else "correction, exact inverse"
    return [*handles, page.line(text, **RING)]


COUNTS = ListedColormap(colormaps["viridis_r"](np.linspace(0.1, 1.0, 256)))  # the palest colours vanish on white


def draw_scatter(path: str | Path, pairs: Pairs, product: CorrectedRecord) -> None:
    """Draw the affected against the reference current direction, before and after correction, of all pairs."""
    lower, upper, corrected = directions_at_pairs(pairs, product.record.time_s, product.heading_corrected_deg)
    limits = (begin := page.emptiest(lower), begin + 360.0)
    with page.create(path, 3.0) as figure:
        layout = figure.subplot_mosaic([["recorded", "corrected"], ["bar", "bar"]], height_ratios=(1.0, 0.06))
        counted: list[PolyCollection] = []
        for title, directions in (("recorded", upper), ("corrected", corrected)):
            axes, known = layout[title], np.isfinite(lower) & np.isfinite(directions)
            axes.set(title=title, xlabel=f"Reference {page.TRUE}")
            if not known.any():
                page.empty(axes, words="no pairs")
                continue
            off = angles.difference(directions, lower)[known]
            mean = page.signed(float(angles.wrap180(angles.mean(off))))
            axes.set_title(f"{title}, n = {off.size}\nmean {mean}°, rms {angles.rms(off):.1f}°")
            both = (page.placed(angle[known], begin) for angle in (lower, directions))
            look: dict[str, Any] = {"mincnt": 1, "cmap": COUNTS, "linewidths": 0.1}
            counted.append(axes.hexbin(*both, gridsize=40, extent=(*limits, *limits), **look))
            axes.plot(limits, limits, color=page.BLACK, linewidth=0.8)
            for axis in (axes.xaxis, axes.yaxis):
                page.degrees(axis, limits)
            axes.set_aspect("equal")
        layout["recorded"].set_ylabel(f"Affected {page.TRUE}")
        layout["corrected"].tick_params(labelleft=False)
        layout["bar"].set_label("<colorbar>")
        if not counted:
            layout["bar"].remove()
            return
        most = max(5.0, *(float(np.max(np.asarray(hexagons.get_array()))) for hexagons in counted))
        for hexagons in counted:  # on a common colour scale
            hexagons.set_norm(LogNorm(1.0, most))
        ticks, text = LogLocator(subs=(1.0, 2.0, 5.0)), FuncFormatter(lambda count, _: f"{count:g}")
        bar = figure.colorbar(counted[0], cax=layout["bar"], ticks=ticks, format=text, orientation="horizontal")
        bar.minorticks_off()
        bar.set_label("Pairs per hexagon, of all pairs")


def draw_shared_coefficients(path: str | Path, content: Mapping[str, Any]) -> None:
    """Draw coefficients and effects by each record alone and of the shared compass, with 95 % intervals."""
    deployments = [entry for entry in content["deployments"] if entry["coefficients"]]
    panels = [*"BCDE", *((entry, k) for entry in content["effects"] for k in range(len(entry["values"])))]
    rows = -(-len(panels) // 2)
    names = page.Rows([entry["name"] for entry in deployments], 12)
    with page.create(path, rows * (0.65 + max(names.height_in, 0.4)) + 0.6) as figure:
        grid = figure.subplots(rows, 2, squeeze=False, sharey=True).flat
        for axes, panel in zip(grid, panels, strict=False):
            if isinstance(panel, str):
                _shared_iron(axes, panel, deployments, content, names)
            else:
                _shared_effect(axes, names, *panel)
            axes.locator_params(axis="x", nbins=3)
        names.name(figure.axes[0])
        for axes in figure.axes[len(panels) :]:
            axes.set_visible(False)
        alone = page.line("a record alone", color=page.BLUE, marker="o", markersize=3)
        rejected = [page.line("one that does not fit", color=page.VERMILION)] * bool(content["rejected"])
        page.legend(figure, [alone, *rejected, Patch(color=page.GREEN, alpha=0.25, label="the compass, 95 %")])


def _shared_iron(
    axes: Axes, letter: str, deployments: list[dict[str, Any]], content: Mapping[str, Any], names: page.Rows
) -> None:
    """Draw one coefficient of all records: B and C times the horizontal field in µT, D and E as fractions."""
    hard = letter in "BC"
    scale = 1000.0 if hard else 1.0
    axes.set_title(f"{letter} times H (µT)" if hard else letter)
    for k, entry in zip(names.places, deployments, strict=True):
        unit = entry["horizontal_nT"] / scale if hard else 1.0
        value, sigma = entry["coefficients"][letter] * unit, entry["sigma"][letter] * unit
        colour = page.BLUE if entry["fits"] else page.VERMILION
        axes.errorbar(value, k, xerr=NORMAL_95 * sigma, color=colour, marker="o", markersize=3, lw=1.0)
        if content["coefficients"]:
            # Predicted from the shared iron, variation between deployments included; B and C in nT.
            weight = model.iron_design(model.FieldAtPlace(1.0, entry["vertical_nT"]))["ABCDE".index(letter), 1:]
            between = content["sigma_between"] if hard else 0.0
            middle = float(weight @ np.array(list(content["coefficients"].values()))) / scale
            variance = weight @ np.array(content["covariance"]) @ weight + between**2
            half = NORMAL_95 * (float(np.sqrt(variance)) / scale)
            axes.fill_betweenx([k - 0.35, k + 0.35], middle - half, middle + half, **page.BAND)


def _shared_effect(axes: Axes, names: page.Rows, effect: Mapping[str, Any], k: int) -> None:
    unit = "°" if effect["units"][k] == "degrees" else effect["units"][k]
    axes.set_title(f"{effect['effect'].replace('_', ' ')}, {effect['parameters'][k].split('_')[0]} ({unit})")
    value, half = effect["values"][k], NORMAL_95 * effect["sigma"][k]
    axes.axvspan(value - half, value + half, **page.BAND)
    place = dict(zip(names.names, names.places, strict=True))
    for name, entry in effect["each"].items():
        half = NORMAL_95 * entry["sigma"][k]
        axes.errorbar(entry["values"][k], place[name], xerr=half, color=page.BLUE, marker="o", markersize=3, lw=1.0)


GROUPS = {
    "heading": ("instrument heading", f"Heading {page.MAGNETIC}"),
    "direction": ("current, all pairs", f"Towards {page.TRUE}"),
    "difference": ("difference, held out pairs", "Affected minus reference (°)"),
}


def draw_histograms(path: str | Path, counts: Mapping[str, Counts]) -> None:
    """Draw histograms of headings, directions and held-out differences, from histograms.csv."""
    with page.create(path, 4.8) as figure:
        panels = figure.subplots(3, 1)
        there: set[str] = set()
        for axes, (group, (title, label)) in zip(panels, GROUPS.items(), strict=False):
            known = {name.partition("_")[2]: n for name, n in counts.items() if name.startswith(group) and n.any()}
            first_deg = begin = -180.0 if group == "difference" else 0.0
            if group != "difference":
                centres = [np.repeat(BIN_DEG * (np.arange(BINS) + 0.5), n) for n in known.values()]
                begin = page.emptiest(np.concatenate([*centres, np.zeros(0)]))
            page.degrees(axes.xaxis, (begin, begin + 360.0), as_is=group == "difference")
            axes.set(xlabel=label, ylabel="Share (%)", title=title)
            edges = begin + BIN_DEG * np.arange(BINS + 1)
            for name in sorted(known, key=list(page.COLOURS).index, reverse=True):
                share = 100.0 * np.roll(known[name], -round((begin - first_deg) / BIN_DEG)) / known[name].sum()
                filled: dict[str, Any] = {"fill": True, "alpha": 0.4, "linewidth": 0} if name == "reference" else {}
                axes.stairs(share, edges, color=page.COLOURS[name], **filled)
            if known:
                axes.set_ylim(bottom=0.0)
            else:
                page.empty(axes)
            there |= set(known)
        figure.align_ylabels(panels)
        words = {"recorded": "recorded, before", "corrected": "corrected, after"}
        handles: list[Artist] = [
            page.line(text, color=page.COLOURS[name]) for name, text in words.items() if name in there
        ]
        if "reference" in there:
            handles.append(Patch(color=page.REFERENCE, alpha=0.4, linewidth=0, label="reference"))
        page.legend(figure, handles, columns=3)
