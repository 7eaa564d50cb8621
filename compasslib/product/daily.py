"""Daily means of the gridded product."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.product.cells import NONE, Axes, empty_cells
from compasslib.product.errors import HeadingErrors, mean_factor
from compasslib.product.grid import INTERPOLATED, GriddedProduct, Piece
from compasslib.records import MISSING
from compasslib.types import Floats

DAY_S, TIDE_S = 86400.0, 6 * 3600.0  # hours of a day that are missing differ from the others as these do
LEAST_SHARE = 0.5  # of a day's times that a mean needs, but for a profiler's few


@dataclass(frozen=True)
class Daily:
    """Means of d days."""

    time_s: Floats  # (d,) noon
    piece: Piece
    errors: HeadingErrors
    deviation_deg: Floats  # (a, d)
    count: NDArray[np.int_]  # (d, z) times that went in
    shrinkage: Floats  # (d,)


@dataclass
class DailyMeans:
    """Sums over the days of a product, piece by piece."""

    axes: Axes
    errors: HeadingErrors
    sums: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def days(self) -> NDArray[np.intp]:
        """The day of each time, counted from the first, (t,)."""
        day = np.floor(self.axes.time_s / DAY_S).astype(np.intp)
        return day - day[0] if len(day) else day

    def add(self, piece: Piece) -> None:
        """Add some of the times."""
        there, flow, sources = piece.source >= 0, piece.cells.velocity, np.maximum(piece.source, 0)
        flow = np.where(there, flow, 0.0)
        modes, random = self.errors.modes[:, piece.slots], self.errors.random[:, piece.slots]
        of_affected = there & (sources < len(random))
        here = np.arange(random.shape[1])[:, None]
        random2 = np.where(of_affected, random[np.minimum(sources, len(random) - 1), here] ** 2, 0.0)
        quality = piece.quality
        columns = {
            "count": there.astype(float), "flow": flow,
            "noise": np.where(there, piece.noise, 0.0), "spread": np.where(there, piece.spread, 0.0),
            "cells": np.where(there, piece.cells.count, 0), "interpolated": (quality == INTERPOLATED).astype(float),
            "east2": np.where(of_affected, random2 * flow.imag**2, 0.0),
            "north2": np.where(of_affected, random2 * flow.real**2, 0.0),
            "cross": np.where(of_affected, -random2 * flow.real * flow.imag, 0.0),
        }  # fmt: skip
        for k, mode in enumerate(modes):
            columns[f"mode{k}"] = flow * np.nan_to_num(mode)[:, None] * self.errors.shares[sources, k]
        for s in range(len(self.errors.shares)):
            columns[f"source{s}"] = (there & (piece.source == s)).astype(float)
        worst = np.where(there & (quality != INTERPOLATED), quality, 0)
        day = self.days[piece.slots]
        begin = np.flatnonzero(np.diff(day, prepend=-1))
        for name, values in columns.items():
            self._total(name, values.dtype, there.shape[1])[day[begin]] += np.add.reduceat(values, begin, axis=0)
        total = self._total("worst", np.dtype(np.int8), there.shape[1])
        total[day[begin]] = np.maximum(total[day[begin]], np.maximum.reduceat(worst, begin, axis=0))

    def _total(self, name: str, dtype: np.dtype[Any], depths: int) -> NDArray[Any]:
        if name not in self.sums:
            self.sums[name] = np.zeros((int(self.days[-1]) + 1, depths), dtype=dtype)
        return self.sums[name]

    def means(self, product: GriddedProduct) -> Daily:
        """Return the means; what is common to a day's velocities is not divided by the root of their number."""
        axes, sums, depths = self.axes, self.sums, len(self.axes.depth_m)
        if not sums:
            none, nothing = np.zeros((0, depths)), np.zeros(0)
            piece = Piece(
                slice(0, 0), empty_cells(0, depths, False), none.astype(np.intp), none.astype(np.int8), *[none] * 5
            )
            return Daily(nothing, piece, self.errors, product.deviation_deg, none.astype(int), nothing)
        count = sums["count"]
        per_source = np.array([sums[f"source{s}"] for s in range(len(self.errors.shares))])
        source = np.argmax(per_source, axis=0)
        moving = np.array([s.profiles for s in product.sources])[source]
        expected = DAY_S / axes.step_s
        there = (count > 0) & (moving | (count >= LEAST_SHARE * expected))
        number = np.maximum(count, 1.0)
        flow = np.where(there, sums["flow"] / number, NONE)
        remembered = mean_factor(number, self.errors.memory_s / axes.step_s) / number
        variances = [sums[name] * remembered for name in ("east2", "north2", "cross")]
        for k in range(len(self.errors.modes)):
            turned = sums[f"mode{k}"] / number
            for variance, product_of in zip(
                variances, (turned.imag**2, turned.real**2, -turned.real * turned.imag), strict=True
            ):
                variance += product_of
        # The times that are missing follow each other, and a sphere is at a depth when the current lets it be there.
        apart = float(product.learnt[0].by_time.at(np.array([TIDE_S]))[0])
        missing = 0.5 * np.maximum(1.0 - count / expected, 0.0) ** 2 * apart  # means differ less than moments
        spread = sums["spread"] / number * mean_factor(number, product.memory_s / axes.step_s) + missing
        noise = sums["noise"] / number**2
        quality = np.where(sums["interpolated"] > 0.5 * count, INTERPOLATED, np.maximum(sums["worst"], 1))
        quality = np.where(there, quality, MISSING).astype(np.int8)
        cells = replace(
            empty_cells(len(count), depths, False),
            velocity=flow, quality=quality, count=sums["cells"].astype(np.int32),
        )  # fmt: skip
        east, north, cross = (np.where(there, v, np.nan) for v in variances)
        piece = Piece(
            slice(0, len(count)), cells, np.where(there, source, -1), quality, east + noise + spread,
            north + noise + spread, cross, noise, spread,
        )  # fmt: skip
        days = self.days
        first = np.floor(axes.time_s[0] / DAY_S) * DAY_S
        size = len(count)

        def mean(series: Floats) -> Floats:
            known = np.isfinite(series)
            n = np.bincount(days[known], minlength=size)
            return np.where(n > 0, np.bincount(days[known], series[known], size) / np.maximum(n, 1), np.nan)

        random2 = np.array([mean(series) for series in self.errors.random**2])
        per_day = np.bincount(days, minlength=size)
        errors = replace(
            self.errors,
            modes=np.array([mean(mode) for mode in self.errors.modes]).reshape(len(self.errors.modes), size),
            random=np.sqrt(random2 * mean_factor(per_day, self.errors.memory_s / axes.step_s)),
        )
        sine, cosine = (np.array([mean(series) for series in part]) for part in angles.sin_cos(product.deviation_deg))
        return Daily(
            first + DAY_S * (np.arange(size) + 0.5), piece, errors,
            np.asarray(angles.wrap180(angles.direction(sine, cosine))), np.where(there, count, 0).astype(int),
            np.exp(-0.5 * mean(self.errors.variance(0))),
        )  # fmt: skip
