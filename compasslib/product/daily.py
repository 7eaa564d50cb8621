"""Means of a gridded product over UTC days, and its low-passed values at noon, accumulated piece by piece."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compasslib import angles
from compasslib.product.cells import NONE, Axes, empty_cells
from compasslib.product.errors import HeadingErrors, mean_factor
from compasslib.product.grid import INTERPOLATED, GriddedProduct, Piece, empty_piece
from compasslib.records import MISSING
from compasslib.types import DAY_S, HOUR_S, Floats

GODIN_H = (24.0, 24.0, 25.0)  # running means whose succession removes the tides (Godin 1972, The Analysis of Tides)


@dataclass(frozen=True)
class Daily:
    """Means over d days, or values of a filter at their noons."""

    time_s: Floats  # (d,) noon
    piece: Piece
    errors: HeadingErrors
    deviation_deg: Floats  # (a, d)
    count: NDArray[np.int_]  # (d, z) number of averaged times
    shrinkage: Floats  # (d,) exp(-heading variance / 2) of the first instrument


@dataclass
class DailyMeans:
    """Daily sums of a product: over the UTC day, or by a filter of successive running means about noon."""

    axes: Axes
    errors: HeadingErrors
    running_h: tuple[float, ...] = ()  # lengths of running means; none for the mean of the UTC day
    sums: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def days(self) -> NDArray[np.intp]:
        """Day number of each time, counted from the first day, (t,)."""
        day = np.floor(self.axes.time_s / DAY_S).astype(np.intp)
        return day - day[0] if len(day) else day

    @cached_property
    def kernel(self) -> tuple[Floats, Floats]:
        """Lags from noon, s, and weights relative to the largest."""
        if not self.running_h:
            return np.array([-0.5, 0.5]) * DAY_S, np.ones(2)
        step_s = HOUR_S / 4.0
        weights = np.ones(1)
        for hours in self.running_h:
            weights = np.convolve(weights, np.ones(round(hours * HOUR_S / step_s)))
        return step_s * (np.arange(len(weights)) - (len(weights) - 1) / 2.0), weights / weights.max()

    def add(self, piece: Piece) -> None:
        """Add a piece to the daily sums."""
        there, flow, sources = piece.source >= 0, piece.cells.velocity, np.maximum(piece.source, 0)
        flow = np.where(there, flow, 0.0)
        modes, random = self.errors.modes[:, piece.slots], self.errors.random[:, piece.slots]
        of_affected = there & (sources < len(random))
        here = np.arange(random.shape[1])[:, None]
        random2 = np.where(of_affected, random[np.minimum(sources, len(random) - 1), here] ** 2, 0.0)
        quality = piece.quality
        columns = {
            "weight": there.astype(float), "flow": flow, "spread": np.where(there, piece.spread, 0.0),
            "interpolated": (quality == INTERPOLATED).astype(float),
            "east2": np.where(of_affected, random2 * flow.imag**2, 0.0),
            "north2": np.where(of_affected, random2 * flow.real**2, 0.0),
            "cross": np.where(of_affected, -random2 * flow.real * flow.imag, 0.0),
        }  # fmt: skip
        for k, mode in enumerate(modes):
            columns[f"mode{k}"] = flow * np.nan_to_num(mode)[:, None] * self.errors.shares[sources, k]
        for s in range(len(self.errors.shares)):
            columns[f"source{s}"] = (there & (piece.source == s)).astype(float)
        squared = {"weight2": columns["weight"], "noise": np.where(there, piece.noise, 0.0)}
        plain = {"count": there.astype(int), "cells": np.where(there, piece.cells.count, 0)}
        worst = np.where(there & (quality != INTERPOLATED), quality, 0)
        noon_s = DAY_S * (np.floor(self.axes.time_s[:1] / DAY_S) + 0.5 + self.days[piece.slots])
        for shift in (-1, 0, 1) if self.running_h else (0,):
            lag = self.axes.time_s[piece.slots] - noon_s - DAY_S * shift
            weight = np.interp(lag, *self.kernel, left=0.0, right=0.0)[:, None]
            day = self.days[piece.slots] + shift
            inside = np.flatnonzero((day >= 0) & (day <= self.days[-1]) & (weight[:, 0] > 0.0))
            if not len(inside):
                continue
            begin = np.flatnonzero(np.diff(day[inside], prepend=-1))
            rows = day[inside][begin]
            for factor, group in ((weight, columns), (weight**2, squared), (1, plain)):
                for name, values in group.items():
                    total = self._total(name, values.dtype, there.shape[1])
                    total[rows] += np.add.reduceat((factor * values)[inside], begin, axis=0)
            total = self._total("worst", np.dtype(np.int8), there.shape[1])
            total[rows] = np.maximum(total[rows], np.maximum.reduceat(worst[inside], begin, axis=0))

    def _total(self, name: str, dtype: np.dtype[Any], depths: int) -> NDArray[Any]:
        if name not in self.sums:
            self.sums[name] = np.zeros((int(self.days[-1]) + 1, depths), dtype=dtype)
        return self.sums[name]

    def means(self, product: GriddedProduct) -> Daily:
        """Compute the means; errors common to the velocities of a mean are not reduced by averaging.

        A mean needs half of a day's times, except for profilers; a filter needs 0.99 of its weights, as a missing hour
        brings back tides.
        """
        axes, sums, depths = self.axes, self.sums, len(self.axes.depth_m)
        if not sums:
            nothing, count = np.zeros(0), np.zeros((0, depths), dtype=int)
            return Daily(nothing, empty_piece(depths, False), self.errors, product.deviation_deg, count, nothing)
        count, weight = sums["count"], sums["weight"]
        per_source = np.array([sums[f"source{s}"] for s in range(len(self.errors.shares))])
        source = np.argmax(per_source, axis=0)
        moving = np.array([s.profiles for s in product.sources])[source]
        lags, weights = self.kernel
        expected = float(np.trapezoid(weights, lags)) / axes.step_s
        enough = weight >= 0.99 * expected if self.running_h else moving | (weight >= 0.5 * expected)
        there = (count > 0) & enough
        safe = np.where(there, weight, 1.0)
        number = safe**2 / np.where(there, sums["weight2"], 1.0)  # of equally weighted times with the same variance
        flow = np.where(there, sums["flow"] / safe, NONE)
        remembered = mean_factor(number, self.errors.memory_s / axes.step_s) / safe
        variances = [sums[name] * remembered for name in ("east2", "north2", "cross")]
        for k in range(len(self.errors.modes)):
            turned = sums[f"mode{k}"] / safe
            squares = turned.imag**2, turned.real**2, -turned.real * turned.imag
            for variance, square in zip(variances, squares, strict=True):
                variance += square
        # Missing times are no random sample: they are consecutive, and the current sets the depth of a sphere. Their
        # velocities differ from the rest of the day as those six hours apart.
        apart = float(product.learnt[0].by_time.at(np.array([6 * HOUR_S]))[0])
        missing = 0.5 * np.maximum(1.0 - weight / expected, 0.0) ** 2 * apart  # means differ less than single values
        spread = sums["spread"] / safe * mean_factor(number, product.memory_s / axes.step_s) + missing
        noise = sums["noise"] / safe**2
        quality = np.where(sums["interpolated"] > 0.5 * weight, INTERPOLATED, np.maximum(sums["worst"], 1))
        quality = np.where(there, quality, MISSING).astype(np.int8)
        cells = replace(
            empty_cells(len(count), slice(0, depths), False),
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
