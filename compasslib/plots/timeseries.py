"""Figures of the currents of a mooring: sticks, progressive vectors, roses, section and mean profile."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from matplotlib.projections.polar import PolarAxes
from matplotlib.ticker import MaxNLocator

from compasslib import angles
from compasslib.archive.gridded import MeanProfile, SectionMeans
from compasslib.archive.summary import GAP, BinCurrents, CurrentSeries
from compasslib.plots import page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import DAY_S, HOUR_S, Complexes, Floats

LINES: dict[str, dict[str, Any]] = {name: {"color": colour} for name, colour in page.COLOURS.items()}
LINES["reference"] |= {"linewidth": 3.0, "alpha": 0.6, "zorder": 1.5}  # the corrected one often lies on it
STICK: dict[str, Any] = {
    "angles": "uv", "scale_units": "y", "scale": 1.0, "units": "inches", "width": 0.007,
    "headwidth": 0.0, "headlength": 0.0, "headaxislength": 0.0,
}  # fmt: skip
AXIS = STICK | {"scale_units": "x", "width": 0.014, "pivot": "mid"}


INTERVALS_H = (1.0, 6.0, 24.0, 48.0, 120.0, 240.0, 720.0, 2400.0)  # of means


@dataclass(frozen=True)
class AveragedCurrents:
    """Mean currents over equal time intervals."""

    middle_s: Floats  # (n,) seconds since 1970
    hours: float
    means: Mapping[str, Complexes]  # (n,) each, m/s; NaN in empty intervals; series without data are left out


def average_currents(shown: BinCurrents, reference: CurrentSeries, most: int = 420) -> AveragedCurrents:
    """Average the recorded, corrected and reference currents over at most ``most`` equal time intervals."""
    begin_s, end_s = shown.recorded.time_s[[0, -1]] if len(shown.recorded.time_s) else (0.0, -1.0)
    hours = next((hours for hours in INTERVALS_H if end_s - begin_s <= most * hours * HOUR_S), INTERVALS_H[-1])
    count, means = int(np.floor((end_s - begin_s) / (hours * HOUR_S))) + 1, dict[str, Complexes]()
    for name, flow in (("recorded", shown.recorded), ("corrected", shown.corrected), ("reference", reference)):
        place = np.floor((flow.time_s - begin_s) / (hours * HOUR_S)).astype(int)
        inside = np.isfinite(flow.velocity) & (place >= 0) & (place < count)
        place, velocity = place[inside], flow.velocity[inside]
        number = np.bincount(place, minlength=count)
        sums = np.bincount(place, velocity.real, count) + 1j * np.bincount(place, velocity.imag, count)
        if number.any():
            means[name] = np.where(number > 0, sums / np.maximum(number, 1), GAP)
    return AveragedCurrents(begin_s + hours * HOUR_S * (np.arange(count) + 0.5), hours, means)


def draw_sticks(path: str | Path, plotted: AveragedCurrents) -> None:
    """Draw stick plots of the mean currents, pointing in the direction of flow, north up, none of them cut."""
    count = max(len(plotted.means), 1)
    with page.create(path, 0.75 + 0.95 * count) as figure:
        panels = figure.subplots(count, 1, sharex=True, sharey=True, squeeze=False)[:, 0]
        if not plotted.means:
            page.empty(panels[0])
            return
        flow = page.CM * np.concatenate([np.zeros(1), *plotted.means.values()])
        low, high = float(np.nanmin(flow.imag)), float(np.nanmax(flow.imag))
        room = max(0.05 * (high - low), 0.5)
        half_s = plotted.hours * HOUR_S / 2.0
        first, last = float(plotted.middle_s[0]) - half_s, float(plotted.middle_s[-1]) + half_s
        # What a stick reaches along the axis, which it lengthens: its scale is that of the vertical axis, of a panel of
        # 2.7 by 0.83 inches.
        limits = first, last
        for _ in range(10):
            second = (limits[1] - limits[0]) / 2.7 * 0.83 / (high - low + 2.0 * room)
            tips = plotted.middle_s + second * page.CM * np.stack([mean.real for mean in plotted.means.values()])
            limits = min(first, float(np.nanmin(tips))), max(last, float(np.nanmax(tips)))
        for axes, (name, mean) in zip(panels, plotted.means.items(), strict=True):
            there = np.isfinite(mean)
            u, v = page.CM * mean[there].real, page.CM * mean[there].imag
            sticks = axes.quiver(
                plotted.middle_s[there] / DAY_S, np.zeros(u.shape), u, v, color=page.COLOURS[name], **STICK
            )
            if axes is panels[0]:
                scale = round_down(float(np.percentile(np.hypot(u, v), 90.0)))
                axes.quiverkey(sticks, 0.8, 1.12, scale, f"{scale:g} cm/s", labelpos="E", fontproperties=page.LETTERS)
            axes.axhline(0.0, color=page.COLOURS[name], linewidth=0.5)
            axes.set(title=name, ylabel="North\n(cm/s)", ylim=(low - room, high + room))
            axes.locator_params(axis="y", nbins=4, steps=page.ROUND)
        page.dates(panels[-1], limits)
        interval = f"{plotted.hours:g} h" if plotted.hours < 24.0 else f"{plotted.hours / 24.0:g} d"
        panels[-1].set_xlabel(f"Date (UTC), means of {interval}")
        figure.align_ylabels(panels)


def round_down(value: float) -> float:
    """Round a positive number down to 1, 2 or 5 times a power of ten, for a scale bar."""
    steps = np.outer(10.0 ** np.arange(-3, 4), (1.0, 2.0, 5.0)).ravel()
    return float(steps[steps <= max(value, steps[0])].max())


def draw_progressive(path: str | Path, plotted: AveragedCurrents) -> None:
    """Draw progressive vector diagrams of the mean currents over the intervals that all series have."""
    paths = {name: way / 1000.0 for name, way in displacements(plotted).items()}  # km
    points = np.concatenate([*paths.values(), [0.0]])
    wide, high = float(np.ptp(points.real)), float(np.ptp(points.imag))
    with page.create(path, 0.9 + 2.7 * float(np.clip(high / max(wide, 1e-9), 0.4, 1.1))) as figure:
        axes = figure.subplots()
        if not paths:
            page.empty(axes)
            return
        for name, way in paths.items():
            axes.plot(way.real, way.imag, **LINES[name])
            axes.plot(way.real[-1], way.imag[-1], "o", color=page.COLOURS[name], markersize=4)
        axes.plot(0.0, 0.0, "k+", markersize=7)
        axes.set(xlabel="East (km)", ylabel="North (km)")
        axes.set_aspect("equal", adjustable="datalim")
        axes.locator_params(nbins=5, steps=page.ROUND)
        handles = [page.line(name, **LINES[name]) for name in paths]
        begin = page.line("begin", color="k", marker="+", linestyle="")
        page.legend(figure, [*handles, begin], columns=4)


def displacements(plotted: AveragedCurrents) -> dict[str, Complexes]:
    """Integrate currents to displacements, (k,) metres east + i north, over the intervals that all series have."""
    both = np.all([np.isfinite(mean) for mean in plotted.means.values()], axis=0)
    steps = {name: mean[both] * plotted.hours * HOUR_S for name, mean in plotted.means.items()}
    return {name: np.concatenate([[0.0], np.cumsum(step)]) for name, step in steps.items()}


def draw_roses(path: str | Path, shown: BinCurrents, reference: CurrentSeries, headings: Mapping[str, Floats]) -> None:
    """Draw roses of the current direction and of the ``recorded`` and ``corrected`` headings."""
    flows = {"recorded": shown.recorded, "corrected": shown.corrected, "reference": reference}
    towards = {name: angles.direction(flow.velocity.real, flow.velocity.imag) for name, flow in flows.items()}
    handles: dict[str, Any] = {name: page.line(name, color=page.COLOURS[name]) for name in flows}
    handles["reference"] = Patch(color=page.REFERENCE, alpha=0.5, linewidth=0, label="reference")
    with page.create(path, 2.6) as figure:
        visible: set[str] = set()
        titles = (f"current towards\n{page.TRUE}", f"heading\n{page.MAGNETIC}")
        panels = figure.subplots(1, 2, subplot_kw={"projection": "polar"})
        for axes, title, series in zip(panels, titles, (towards, headings), strict=True):
            known = {name: angle for name, angle in series.items() if np.isfinite(angle).any()}
            axes.set_title(title)
            _draw_rose(axes, known)
            visible |= set(known)
        page.legend(figure, [handle for name, handle in handles.items() if name in visible], columns=3)


def _draw_rose(axes: PolarAxes, series: Mapping[str, Floats]) -> None:
    """Draw a rose whose radius is the share of the samples in each sector of 10 degrees, each ring labelled."""
    axes.set_theta_zero_location("N")
    axes.set_theta_direction(-1)
    axes.set_xticks(np.linspace(0.0, 2.0 * np.pi, 4, endpoint=False), ["N", "E", "S", "W"])
    axes.tick_params(axis="x", pad=-1.0)
    axes.set_xlabel("% of samples per 10°")
    if not series:
        axes.set_yticks([])
        axes.annotate("no data", (0.5, 0.5), xycoords="axes fraction", ha="center", va="center")
        return
    shares = {name: page.sectors(series[name], 0.0) for name in reversed(page.COLOURS) if name in series}
    for name, share in shares.items():
        edges = np.linspace(0.0, 2.0 * np.pi, len(share) + 1)
        around, radius = np.repeat(edges, 2)[1:-1], np.repeat(share, 2)
        if name == "reference":
            axes.fill(around, radius, color=page.COLOURS[name], alpha=0.5, linewidth=0)
        else:
            axes.plot(
                np.append(around, around[0]), np.append(radius, radius[0]), color=page.COLOURS[name], linewidth=1.2
            )
    most = 1.02 * max(float(share.max()) for share in shares.values())
    ticks = MaxNLocator(3, steps=[1, 2, 5, 10], integer=True).tick_values(0.0, most)
    rings = [ring for ring in ticks if 0.0 < ring < most]
    quarters = np.sum(list(shares.values()), axis=0).reshape(4, -1)
    free = 45.0 + 90.0 * float(np.argmin(quarters.max(axis=1)))  # the quarter least covered by data
    white = {"facecolor": "white", "alpha": 0.7, "linewidth": 0, "pad": 0.5}
    axes.set_rgrids(rings, [f"{ring:g} %" for ring in rings], angle=free, ha="center", va="center", bbox=white)
    axes.set_rmax(most)
    axes.grid(linewidth=0.4)


def draw_section(path: str | Path, section: SectionMeans, *, most_depths: int = 100) -> None:
    """Draw velocity by time and depth before and after correction, the difference, and the uncertainty of direction.

    Depths above and below those that were measured a tenth as often as any are left out; more than ``most_depths`` are
    averaged, as a profiler leaves many of them out in each profile, and a print shows no more.
    """
    by_reference, depth_m = np.nan_to_num(section.reference_share) >= 0.5, section.depth_m
    after = section.after.copy()
    after[:, by_reference] = _as_columns(after[:, by_reference])
    rows = {"recorded": section.before, "corrected": after, "corrected minus recorded": section.change}
    with page.create(path, 6.6, width_in=page.WIDE_IN) as figure:
        layout: list[Any] = [[f"U, {row}", f"V, {row}"] for row in rows]
        panels = figure.subplot_mosaic([*layout, ["σ", "σ"]], height_ratios=[2.0, 2.0, 2.0, 1.2])
        if not np.isfinite(section.after).any():
            page.empty(*panels.values())
            return
        span = (float(section.edges_s[0]), float(section.edges_s[-1]))
        half = float(np.median(np.diff(depth_m))) / 2.0 if len(depth_m) > 1 else 0.5
        edges = np.append(depth_m - half, depth_m[-1] + half)
        for row, values in rows.items():
            scale = np.concatenate([section.before, after] if row in ("recorded", "corrected") else [values])
            sizes = np.abs(np.concatenate([part[np.isfinite(part)] for part in (scale.real, scale.imag)]))
            limit = max(page.CM * float(np.percentile(sizes, 98.0)), 1.0) if sizes.size else 1.0
            often = np.isfinite(values).sum(axis=0)
            shown = np.flatnonzero(often >= max(0.1 * often.max(initial=0), 1))
            top, bottom = (shown[0], shown[-1] + 1) if shown.size else (0, len(depth_m))
            begin = np.arange(top, bottom, -(-(bottom - top) // most_depths))
            known = np.isfinite(values[:, :bottom])
            with np.errstate(invalid="ignore"):  # NaN where there are none
                means = np.add.reduceat(np.where(known, values[:, :bottom], 0.0), begin, axis=1)
                means /= np.add.reduceat(known.astype(float), begin, axis=1)
            for name, part in (("U", means.real), ("V", means.imag)):
                axes = panels[f"{name}, {row}"]
                axes.set_title(f"{name}, {row}")
                look: dict[str, Any] = {"cmap": "RdBu_r", "norm": Normalize(-limit, limit), "rasterized": True}
                image = axes.pcolormesh(section.edges_s / DAY_S, edges[[*begin, bottom]], page.CM * part.T, **look)
                axes.set_facecolor("#DDDDDD")
                axes.set_ylim(edges[bottom], edges[top])
                axes.locator_params(axis="y", nbins=4, steps=page.ROUND)
                page.dates(axes, span)
                axes.set(xlabel="", ylabel="Depth (m)" if name == "U" else "")
                axes.tick_params(labelbottom=row == "corrected minus recorded", labelleft=name == "U")
            bar = figure.colorbar(image, cax=axes.inset_axes((1.06, 0.0, 0.025, 1.0)), extend="both")
            bar.set_label("cm/s")
            if row == "corrected":  # at the right edge, the instrument that provides most values at each depth
                place: dict[str, Any] = {"transform": axes.get_yaxis_transform(), "clip_on": False, "linewidth": 4.0}
                place["colors"] = [page.REFERENCE if by_reference[k] else page.CORRECTED for k in shown]
                axes.vlines(np.full(len(shown), 1.02), edges[shown], edges[shown + 1], **place)
        # Standard deviation of the affected instrument's directions.
        axes, sigma = panels["σ"], section.heading_sigma_deg
        axes.plot(
            (section.edges_s[1:] + section.edges_s[:-1]) / 2.0 / DAY_S, sigma, color=page.CORRECTED, linewidth=0.8
        )
        axes.set_ylim(0.0, 1.15 * float(np.nanmax(sigma)) if np.isfinite(sigma).any() else 1.0)
        axes.set(title="uncertainty of the corrected directions (1σ)", ylabel="σ (°)")
        page.dates(axes, span)
        sources = {"affected instrument": page.CORRECTED, "reference": page.REFERENCE}
        page.legend(figure, [page.line(name, color=colour, linewidth=4.0) for name, colour in sources.items()])


def _as_columns(values: Complexes) -> Complexes:
    """Widen profiles that are further apart than the intervals of time, each to half-way to the next."""
    there = np.flatnonzero(np.isfinite(values).any(axis=1))
    if not 1 < len(there) < 0.5 * len(values):
        return values
    near = there[np.abs(np.arange(len(values))[:, None] - there).argmin(axis=1)]
    reached = np.abs(np.arange(len(values)) - near) <= np.median(np.diff(there)) / 2.0
    return np.where(reached[:, None], values[near], complex(np.nan, np.nan))


def draw_profile(path: str | Path, section: SectionMeans) -> None:
    """Draw profiles of the mean velocity before and after, and of the major axes of the variance ellipses."""
    before, after = section.profiles
    with page.create(path, 3.6) as figure:
        panels = figure.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.0, 1.2))
        there = np.flatnonzero(np.isfinite(after.mean))
        if not there.size:
            page.empty(*panels)
            return
        reference = section.reference_share >= 0.5
        for axes, part, sigma, name in zip(panels, ("real", "imag"), section.profile_sigma, "UV", strict=False):
            middle, half = page.CM * getattr(after.mean, part), page.CM * NORMAL_95 * sigma
            axes.fill_betweenx(section.depth_m, middle - half, middle + half, **page.SHADE)
            affected = ((before, ~reference, page.RECORDED), (after, ~reference, page.CORRECTED))
            for profile, here, colour in (*affected, (after, reference, page.REFERENCE)):
                mean = np.where(here, page.CM * getattr(profile.mean, part), np.nan)
                axes.plot(mean, section.depth_m, color=colour, marker="o", markersize=2.5)
            axes.axvline(0.0, color="#444444", linewidth=0.5)
            axes.set(title=f"mean {name}", xlabel="(cm/s)")
            axes.locator_params(axis="x", nbins=3, steps=page.ROUND)
        # Major axes of the variance, north up, to a common scale along the panel's width.
        shown = there[:: max(1, -(-len(there) // 8))]
        sizes = [principal_axis(profile) for profile in (before, after)]
        for (size, way), colour in zip(sizes, (page.RECORDED, page.CORRECTED), strict=True):
            along = page.CM * (size * np.exp(1j * way))[shown]
            look = AXIS | {"color": [page.REFERENCE if trusted else colour for trusted in reference[shown]]}
            panels[2].quiver(np.zeros(len(shown)), section.depth_m[shown], along.real, along.imag, **look)
        longest = page.CM * max(float(np.nanmax(size[shown])) for size, _ in sizes)
        panels[2].set(xlim=(-0.6 * longest, 0.6 * longest), xlabel="(cm/s), north up", title="principal axes")
        panels[2].locator_params(axis="x", nbins=3, steps=page.ROUND)
        room = 0.12 * float(np.ptp(section.depth_m[there])) + 1.0  # for the axes at the ends
        panels[0].set_ylim(section.depth_m[there[-1]] + room, section.depth_m[there[0]] - room)
        panels[0].set_ylabel("Depth (m)")
        names = ["recorded", "corrected", *["reference"] * bool(reference[there].any())]
        handles: list[Artist] = [page.line(name, color=page.COLOURS[name]) for name in names]
        page.legend(figure, [*handles, Patch(**page.SHADE, label="95 %, heading alone")])


def principal_axis(profile: MeanProfile) -> tuple[Floats, Floats]:
    """Return the standard deviation along the major axis of the variance ellipse, and its angle from east, radians."""
    half = 0.5 * (profile.east_variance - profile.north_variance)
    size = 0.5 * (profile.east_variance + profile.north_variance) + np.hypot(half, profile.covariance)
    return np.sqrt(np.maximum(size, 0.0)), 0.5 * np.arctan2(profile.covariance, half)
