"""Comparison of simulated with real currents, by differences between the bins of one profile.

    python benchmarks/sea.py --figure docs/sea.png      and the numbers as a table

Two real moored profiles (../shared/data; reported if absent) and EG4 of the demonstration, whose profile is read from
its raw file. The bins of one instrument share its compass, so they differ by the water only.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import water
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator
from scipy.signal import coherence, welch

from compasslib import angles, readers
from compasslib.demo import demonstration
from compasslib.plots.page import BLUE, GREEN, VERMILION, WIDE_IN, page
from compasslib.preparation.deployment import apply_deployment
from compasslib.preparation.water import usable_velocities
from compasslib.records import Record

COLOURS = {"eh2 (real, 2 m)": BLUE, "papa (real, 20 m)": GREEN, "EG4 (simulated, 4 m)": VERMILION}
APART = 2  # cells between the two bins whose difference is analysed by speed and by period
FIRST, MOST = 2, 10  # bin from which distances are counted; cells to the farthest bin
BANDS = {"tides": (10.0, 14.0), "days to weeks": (48.0, 400.0)}  # hours
SLOW_DAYS, FEWEST = 20.0, 20
SEGMENT = 512  # hours
PERIODS, BANDS_SHOWN = (2.0, 256.0), 8  # range and number of bands for the gain by period, hours


def simulated() -> Record:
    """Simulate the profile of EG4 during its deployment."""
    with tempfile.TemporaryDirectory() as folder:
        demonstration.write_mooring("EG4", Path(folder) / "raw", Path(folder) / "truth.csv")
        record = readers.read("pd0", [Path(folder) / "raw/EG4/top.000"], {})
    span = record.time_s[[200, -200]]
    settled = apply_deployment(
        record, start_s=span[0], end_s=span[1], latitude=65.3, water_depth=900.0, nominal_depth=None
    )
    return replace(settled, depth_m=np.full(len(settled.time_s), float(np.median(settled.depth_m))))


def profiles() -> dict[str, Record]:
    """Read the available profiles, by name."""
    found = {}
    for name in COLOURS:
        short = name.split()[0]
        if short == "EG4":
            found[name] = simulated()
        elif (water.DATA / water.FILES[short]).exists():
            found[name] = water.profile(short)
        else:
            print(f"not measured: {water.FILES[short]} is not in {water.DATA}")
    return found


def flow(record: Record, bin_: int) -> np.ndarray:
    """Select the currents in one bin, east + i north, m/s, NaN if bad."""
    good = usable_velocities(record)[:, bin_]
    return np.where(good, record.east[:, bin_] + 1j * record.north[:, bin_], np.nan)


def across(near: np.ndarray, far: np.ndarray) -> np.ndarray:
    """Compute the cross-flow component of a difference, m/s, NaN if either is bad."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.imag((near - far) * np.conj(far) / np.abs(far))


def by_distance(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Compute the rms cross-flow difference, cm/s, by distance, m."""
    last = min(FIRST + MOST, record.east.shape[1] - 1)
    range_m = np.median(np.abs(record.bin_range_m), axis=0)
    pairs = [
        (range_m[k] - range_m[FIRST], across(flow(record, FIRST), flow(record, k))) for k in range(FIRST + 1, last)
    ]
    return np.array([x for x, _ in pairs]), np.array([100.0 * np.sqrt(np.nanmean(y**2)) for _, y in pairs])


def by_speed(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Compute the median difference of directions of two bins, degrees, by speed, cm/s."""
    one, other = flow(record, FIRST), flow(record, FIRST + APART)
    known = np.isfinite(one * other) & (np.abs(one) > 0.0) & (np.abs(other) > 0.0)
    speed, off = 100.0 * np.abs(one[known]), np.abs(np.angle(one[known] * np.conj(other[known]))) / angles.DEGREE
    edges = np.quantile(speed, np.linspace(0.0, 1.0, 9))
    which = np.clip(np.searchsorted(edges, speed, side="right") - 1, 0, 7)
    return np.array([np.median(speed[which == k]) for k in range(8)]), np.array(
        [np.median(off[which == k]) for k in range(8)]
    )


def slow_share(record: Record) -> float:
    """Compute the share of the variance of the difference of two bins in means over ``SLOW_DAYS``."""
    off = flow(record, FIRST) - flow(record, FIRST + APART)
    known = np.isfinite(off)
    block = np.floor((record.time_s[known] - record.time_s[0]) / (SLOW_DAYS * 86400.0)).astype(int)
    count = np.bincount(block)
    mean = (np.bincount(block, off[known].real) + 1j * np.bincount(block, off[known].imag)) / np.maximum(count, 1)
    return float(np.var(mean[count > FEWEST]) / np.var(off[known]))


def hourly(series: np.ndarray, time_s: np.ndarray) -> np.ndarray | None:
    """Interpolate a complex series to every hour, including gaps; None if it was sampled less often."""
    if np.median(np.diff(time_s)) > 3700.0:
        return None
    known = np.isfinite(series)
    at = np.arange(time_s[known][0], time_s[known][-1], 3600.0)
    return np.interp(at, time_s[known], series[known])


def spectrum(record: Record) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute the spectrum of the cross-flow difference, (cm/s)^2 per cycle per day, by period, hours."""
    series = hourly(100.0 * across(flow(record, FIRST), flow(record, FIRST + APART)) + 0j, record.time_s)
    if series is None:
        return None
    frequency, power = welch(series.real, fs=24.0, nperseg=SEGMENT)
    return 24.0 / frequency[1:], power[1:]


def coherences(record: Record, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute the coherence of the eastward currents of two bins in a band of periods, by distance, m."""
    first = hourly(flow(record, FIRST), record.time_s)
    if first is None:
        return None
    range_m, distance, found = np.median(np.abs(record.bin_range_m), axis=0), [], []
    for k in range(FIRST + 1, min(FIRST + MOST, record.east.shape[1] - 1)):
        other = hourly(flow(record, k), record.time_s)
        assert other is not None
        n = min(len(first), len(other))
        frequency, squared = coherence(first.real[:n], other.real[:n], fs=1.0, nperseg=SEGMENT)
        inside = (frequency > 1.0 / band[1]) & (frequency < 1.0 / band[0])
        distance.append(range_m[k] - range_m[FIRST])
        found.append(np.sqrt(np.mean(squared[inside])))
    return np.array(distance), np.array(found)


def gain(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """Compute the reduction of the noise by the prediction, percent, median over depths, by gap in cells."""
    gaps = np.array([1, 2, 3, 4])
    depths = range(min(8, record.east.shape[1] - 9))
    return gaps, np.array([np.median([water.fall(record, depth, int(gap))[0] for depth in depths]) for gap in gaps])


def gain_by_period(record: Record, gap: int) -> tuple[np.ndarray, np.ndarray] | None:
    """Compute the reduction of the noise by the prediction, percent, by period, hours."""
    power = []
    for depth in range(min(8, record.east.shape[1] - 9)):
        series = [hourly(100.0 * x + 0j, record.time_s) for x in water.across(record, depth, gap)[:2]]
        if series[0] is None:
            return None
        frequency, both = welch(np.real(series), fs=24.0, nperseg=SEGMENT)
        power.append(both)
    edges = np.geomspace(1.0 / PERIODS[1], 1.0 / PERIODS[0], BANDS_SHOWN + 1) * 24.0
    inside = np.digitize(frequency, edges) - 1
    total = np.sum(power, axis=0)
    sums = [np.bincount(inside[inside >= 0], side[inside >= 0], BANDS_SHOWN + 1)[:BANDS_SHOWN] for side in total]
    return 24.0 / np.sqrt(edges[1:] * edges[:-1]), 100.0 * (1.0 - np.sqrt(sums[1] / sums[0]))


def draw(found: dict[str, Record], path: Path) -> None:
    """Draw the figure."""
    with page(path, 5.2, width_in=WIDE_IN) as figure:
        panels = figure.subplots(2, 3)
        for name, record in found.items():
            style = {"color": COLOURS[name], "marker": "o", "markersize": 3.0, "label": name}
            panels[0, 0].plot(*by_distance(record), **style)
            panels[0, 1].plot(*by_speed(record), **style)
            panels[1, 2].plot(*gain(record), **style)
            for gap, line in zip((1, 2, 4), ("-", "--", ":"), strict=True):
                if (made := gain_by_period(record, gap)) is not None:
                    panels[1, 1].plot(*made, line, color=COLOURS[name], marker="o", markersize=2.0)
            if (made := spectrum(record)) is not None:
                panels[0, 2].plot(*made, color=COLOURS[name], linewidth=0.8)
            for band, line in zip(BANDS, ("-", ":"), strict=True):
                if (made := coherences(record, BANDS[band])) is not None:
                    panels[1, 0].plot(*made, line, color=COLOURS[name], marker="o", markersize=2.0)
        panels[0, 0].set(
            xscale="log", yscale="log", xlabel="Distance of the bins (m)", ylabel="Across the flow, rms (cm/s)"
        )
        panels[0, 1].set(xlabel="Speed (cm/s)", ylabel="Directions, median (°)", ylim=(0.0, None))
        panels[0, 2].set(xscale="log", yscale="log", xlabel="Period (h)", ylabel="(cm/s)² d")
        panels[1, 0].set(xlabel="Distance of the bins (m)", ylabel="Coherence", ylim=(0.0, 1.02))
        panels[1, 1].set(xscale="log", xlabel="Period (h)", ylabel="Noise less by prediction (%)")
        panels[1, 2].set(xlabel="Gap (cells)", ylabel="Noise less by prediction (%)", xticks=[1, 2, 3, 4])
        for axes, title in (
            (panels[0, 0], "Difference by distance"),
            (panels[0, 1], f"By speed, {APART} cells apart"),
            (panels[0, 2], f"Spectrum, {APART} cells apart"),
            (panels[1, 0], "10–14 h; dotted: 2–17 days"),
            (panels[1, 1], "Noise less, 1 / 2 / 4 cells (– / -- / ⋯)"),
            (panels[1, 2], "Noise less by gap"),
        ):
            axes.set_title(title)
        spectral = (panels[0, 2].xaxis, panels[0, 2].yaxis, panels[1, 1].xaxis)
        for axis in (panels[0, 0].xaxis, panels[0, 0].yaxis, *spectral):
            axis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.set_major_formatter(FuncFormatter(lambda x, _: f"{x:g}"))
            axis.set_minor_locator(NullLocator())
        panels[0, 1].legend(frameon=False)


def main() -> None:
    """Print the table, and draw the figure if requested."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--figure", type=Path)
    asked = parser.parse_args()
    found = profiles()
    heads = (
        "profile",
        "across the flow at 1, 4, 8 cells, rms, cm/s",
        "directions 2 cells apart, slowest, fastest eighth, median, °",
        "noise less by prediction at 1, 2, 4 cells, %",
        "of means of 20 days, %",
    )
    print(f"| {' | '.join(heads)} |")
    print("|---|---|---|---|---|")
    for name, record in found.items():
        off, speeds, gains = by_distance(record)[1], by_speed(record)[1], gain(record)[1]
        cells = f"{off[0]:.1f} / {off[min(3, len(off) - 1)]:.1f} / {off[min(7, len(off) - 1)]:.1f}"
        falls = " / ".join(f"{gains[k]:.0f}" for k in (0, 1, 3))
        print(f"| {name} | {cells} | {speeds[0]:.0f} / {speeds[-1]:.1f} | {falls} | {100 * slow_share(record):.1f} |")
    if asked.figure:
        draw(found, asked.figure)


if __name__ == "__main__":
    main()
