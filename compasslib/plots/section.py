"""Currents on fixed depths: sections of time and depth before and after, mean profiles with principal axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from compasslib.archive.gridded import MeanProfile, SectionMeans
from compasslib.plots.page import CORRECTED, DAY_S, RECORDED, dates, empty, legend, page
from compasslib.statistics.resampling import NORMAL_95
from compasslib.types import Floats

COLUMNS = 400  # of a section: as many as a column of print has dots
CM, WIDEST = 100.0, 98.0  # the colours end at this percentile of the speeds of a component
COLOUR_MAP = "RdBu_r"
MAX_AXES = 8  # principal axes along a profile


def draw_section(path: str | Path, section: SectionMeans) -> None:
    """Draw eastward and northward velocity by time and depth, before and after, and how well directions are known.

    Args:
        section: perhaps without any velocity.
    """
    fields = {
        "U, recorded": section.before.real, "U, corrected": section.after.real,
        "V, recorded": section.before.imag, "V, corrected": section.after.imag,
    }  # fmt: skip
    with page(path, 6.6) as figure:
        panels = figure.subplots(5, 1, sharex=True, height_ratios=(2.0, 2.0, 2.0, 2.0, 1.3))
        if not np.isfinite(section.after).any():
            for axes in panels:
                empty(axes)
            return
        known = np.abs(np.concatenate([x[np.isfinite(x)] for x in fields.values()]))
        limit = max(CM * float(np.percentile(known, WIDEST)), 1.0)
        step = float(np.median(np.diff(section.depth_m))) if len(section.depth_m) > 1 else 1.0
        depths = np.append(section.depth_m - step / 2.0, section.depth_m[-1] + step / 2.0)
        there = np.flatnonzero(np.isfinite(section.after).any(axis=0))
        for axes, (title, values) in zip(panels[:4], fields.items(), strict=True):
            image = axes.pcolormesh(
                section.edges_s / DAY_S, depths, CM * values.T, cmap=COLOUR_MAP, norm=Normalize(-limit, limit),
                rasterized=True,
            )  # fmt: skip
            axes.set_title(title)
            axes.set_facecolor("#DDDDDD")
            axes.set_ylim(depths[there[-1] + 1], depths[there[0]])
            axes.set_ylabel("Depth (m)")
            axes.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
        bar = figure.colorbar(image, ax=list(panels[:4]), aspect=40, pad=0.02, extend="both")
        bar.set_label("cm/s")
        # Draw the standard deviation of the affected instrument's directions.
        middle = (section.edges_s[1:] + section.edges_s[:-1]) / 2.0
        panels[4].plot(middle / DAY_S, section.heading_sigma_deg, color=CORRECTED, linewidth=0.8)
        known = section.heading_sigma_deg[np.isfinite(section.heading_sigma_deg)]
        panels[4].set_ylim(0.0, 1.15 * float(known.max()) if known.size else 1.0)
        panels[4].set_title("Direction, one standard deviation")
        panels[4].set_ylabel("σ (°)")
        dates(panels[4], (float(section.edges_s[0]), float(section.edges_s[-1])))
        figure.align_ylabels(panels)


def draw_profile(path: str | Path, section: SectionMeans) -> None:
    """Draw the mean velocity by depth before and after, with the ellipses' axes of its variance.

    Args:
        section: perhaps without any velocity.
    """
    before, after = section.profiles
    with page(path, 3.6) as figure:
        panels = figure.subplots(1, 3, sharey=True, width_ratios=(1.0, 1.0, 1.2))
        there = np.flatnonzero(np.isfinite(after.mean))
        if not there.size:
            for axes in panels:
                empty(axes)
            return
        for axes, part, sigma, name in zip(panels, ("real", "imag"), section.profile_sigma, "UV", strict=False):
            middle, half = CM * getattr(after.mean, part), CM * NORMAL_95 * sigma
            axes.fill_betweenx(section.depth_m, middle - half, middle + half, color=CORRECTED, alpha=0.25, linewidth=0)
            for profile, colour in ((before, RECORDED), (after, CORRECTED)):
                axes.plot(CM * getattr(profile.mean, part), section.depth_m, color=colour)
            axes.axvline(0.0, color="#444444", linewidth=0.5)
            axes.set_xlabel(f"Mean {name}\n(cm/s)")
            axes.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
        shown = there[:: max(1, -(-len(there) // MAX_AXES))]
        _draw_axes(panels[2], section.depth_m, (before, after), shown)
        room = 0.12 * float(np.ptp(section.depth_m[there])) + 1.0  # for the axes at the ends
        panels[0].set_ylim(section.depth_m[there[-1]] + room, section.depth_m[there[0]] - room)
        panels[0].set_ylabel("Depth (m)")
        names = {"recorded": RECORDED, "corrected": CORRECTED}
        legend(figure, [Line2D([], [], color=colour, label=name) for name, colour in names.items()])


def principal_axis(profile: MeanProfile) -> tuple[Floats, Floats]:
    """Return the standard deviation along the major axis of the variance ellipse, and its angle from east, radians."""
    half = 0.5 * (profile.east_variance - profile.north_variance)
    size = 0.5 * (profile.east_variance + profile.north_variance) + np.hypot(half, profile.covariance)
    return np.sqrt(np.maximum(size, 0.0)), 0.5 * np.arctan2(profile.covariance, half)


def _draw_axes(axes: Axes, depth_m: Floats, profiles: tuple[MeanProfile, MeanProfile], shown: NDArray[np.intp]) -> None:
    """Draw major axes as lines about their depth, north up, all to one scale along the panel's width."""
    sizes = [principal_axis(profile) for profile in profiles]
    longest = CM * max(float(np.nanmax(size[shown])) for size, _ in sizes)
    for (size, way), colour in zip(sizes, (RECORDED, CORRECTED), strict=True):
        axes.quiver(
            np.zeros(len(shown)), depth_m[shown], CM * (size * np.cos(way))[shown], CM * (size * np.sin(way))[shown],
            color=colour, angles="uv", scale_units="x", scale=1.0, units="inches", width=0.014, pivot="mid",
            headwidth=0.0, headlength=0.0, headaxislength=0.0,
        )  # fmt: skip
    axes.set_xlim(-0.6 * longest, 0.6 * longest)
    axes.set_xlabel("Principal axes\n(cm/s, north up)")
    axes.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 5, 10]))
