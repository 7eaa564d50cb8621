"""What a benchmark measured beside what it should be: one place for shares, their intervals and the exit status.

A target is missed where the 95 % interval excludes it; a script that misses one ends with status 1.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

DRAWS = 4000
FEWEST = 20  # cases of which resampling tells an interval


@dataclass(frozen=True)
class Measured:
    """One line: what was measured, with its 95 % interval, and the target where there is one."""

    what: str
    value: str
    low: float = 0.0
    high: float = 0.0
    least: float = -np.inf
    most: float = np.inf
    target: str = ""

    @property
    def held(self) -> bool:
        """Whether the interval does not exclude the target."""
        return self.low <= self.most and self.high >= self.least

    @property
    def verdict(self) -> str:
        """The target, and whether it was missed."""
        return self.target if self.held else f"{self.target}, MISSED"


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Clopper and Pearson 1934)."""
    found = binomtest(hits, count).proportion_ci(method="exact")
    return float(found.low), float(found.high)


def text_of(hits: int, count: int) -> str:
    """Return a share with its n and 95 % interval."""
    if not count:
        return "–"
    low, high = interval(hits, count)
    return f"{100 * hits / count:.1f} % of {count} ({100 * low:.1f}–{100 * high:.1f})"


def share(what: str, values: Iterable[object], *, least: float = 0.0, most: float = 1.0) -> Measured:
    """Return a share beside its target.

    Args:
        values: of each case, whether it holds.
        least: share that should be reached.
        most: share that should not be passed.
    """
    held = [bool(one) for one in values]
    low, high = interval(sum(held), len(held)) if held else (0.0, 1.0)
    return Measured(what, text_of(sum(held), len(held)), low, high, least, most, _said(least, most, " %", 100.0))


def mean(
    what: str,
    values: Sequence[float],
    *,
    least: float = -np.inf,
    most: float = np.inf,
    unit: str = "",
    times: float = 1.0,
) -> Measured:
    """Return a mean with the interval that resampling gives it, beside its target.

    Args:
        unit: that is printed behind numbers.
        times: factor of the numbers that are printed.
    """
    found = resampled(np.asarray(values, dtype=float), lambda some: some.mean(axis=-1))
    low, high = found or (-np.inf, np.inf)
    between = f"{times * low:.3g} to {times * high:.3g}" if found else "too few for an interval"
    told = f"{times * np.mean(values):.3g}{unit} of {len(values)} ({between})"
    return Measured(what, told, low, high, least, most, _said(least, most, unit, times))


def limit(what: str, value: float, *, most: float, unit: str = "") -> Measured:
    """Return a number that has no interval beside its limit."""
    return Measured(what, f"{value:.3g}{unit}", value, value, most=most, target=_said(-np.inf, most, unit, 1.0))


def resampled(values: np.ndarray, of: Callable[[np.ndarray], np.ndarray], seed: int = 1) -> tuple[float, float] | None:
    """Return the 95 % interval of a statistic by resampling the cases (Efron 1979), None of too few.

    Args:
        values: (n,), finite.
        of: the statistic along the last axis.
    """
    if values.size < FEWEST:
        return None
    drawn = of(np.random.default_rng(seed).choice(values, (DRAWS, values.size)))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)


def report(lines: Sequence[Measured]) -> int:
    """Print a table, and return the exit status: 1 where a target is missed."""
    print("\n| measure | value | target |\n|---|---|---|")
    for one in lines:
        print(f"| {one.what} | {one.value} | {one.verdict} |", flush=True)
    return int(not all(one.held for one in lines))


def _said(least: float, most: float, unit: str, times: float) -> str:
    low, high = times * least, times * most
    if least == most:
        return f"{low:g}{unit}"
    # Of shares, from nothing to all is no target.
    below, above = least > (0.0 if unit == " %" else -np.inf), most < (1.0 if unit == " %" else np.inf)
    if below and above:
        return f"{low:g} to {high:g}{unit}"
    return f"≥ {low:g}{unit}" if below else f"≤ {high:g}{unit}" if above else ""
