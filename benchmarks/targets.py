"""Benchmark measures and their targets: shares, intervals, exit status, and rows to resume interrupted runs from.

A target is missed if the 95 % interval excludes it; a script that misses one ends with status 1.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

sys.path.append(str(Path(__file__).resolve().parent.parent))  # for tests/world
DRAWS = 4000
FEWEST = 20  # minimum number of cases for an interval by resampling


@dataclass(frozen=True)
class Measured:
    """One line of a table: a measure with its 95 % interval, and its target if there is one."""

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
        """The target, marked if it was missed."""
        return self.target if self.held else f"{self.target}, MISSED"


def parser(
    doc: str, count: int, kinds: Sequence[str] = (), *, red: bool = False, rows: bool = False
) -> argparse.ArgumentParser:
    """Make the parser of a benchmark: count, seed, and the options that several benchmarks have."""
    made = argparse.ArgumentParser(description=doc.splitlines()[0])
    made.add_argument("count", type=int, nargs="?", default=count, help=f"cases, of each kind (default {count})")
    made.add_argument("seed", type=int, nargs="?", default=1)
    if kinds:
        made.add_argument("--kind", choices=kinds)
    if red:
        made.add_argument("--red", action="store_true", help="the water of the two depths differs for days to seasons")
    if rows:
        made.add_argument("--rows", type=Path, help="file of a line of JSON a case; what is in it is not made again")
    return made


def interval(hits: int, count: int) -> tuple[float, float]:
    """Compute the 95 % interval of a share (Clopper and Pearson 1934)."""
    found = binomtest(hits, count).proportion_ci(method="exact")
    return float(found.low), float(found.high)


def text_of(hits: int, count: int) -> str:
    """Format a share with its n and 95 % interval."""
    if not count:
        return "–"
    low, high = interval(hits, count)
    return f"{100 * hits / count:.1f} % of {count} ({100 * low:.1f}–{100 * high:.1f})"


def share_of(values: Iterable[object]) -> str:
    """Format the share of true cases with its n and 95 % interval."""
    held = [bool(one) for one in values]
    return text_of(sum(held), len(held))


def share(what: str, values: Iterable[object], *, least: float = 0.0, most: float = 1.0) -> Measured:
    """Compute a share with its target."""
    held = [bool(one) for one in values]
    low, high = interval(sum(held), len(held)) if held else (0.0, 1.0)
    return Measured(what, text_of(sum(held), len(held)), low, high, least, most, _said(least, most, " %", 100.0))


def grouped(plain: Measured, values: Sequence[object], groups: Sequence[object]) -> Measured:
    """Widen the interval of a share to that by resampling groups of dependent cases, if this is wider."""
    if not values:
        return plain
    held, group = np.array([bool(one) for one in values]), np.unique(np.array(groups), return_inverse=True)[1]
    sums, counts = np.bincount(group, held), np.bincount(group)
    picked = np.random.default_rng(0).integers(0, len(sums), (DRAWS, len(sums)))
    ends = np.quantile(sums[picked].sum(axis=1) / counts[picked].sum(axis=1), [0.025, 0.975]).tolist()
    low, high = min(plain.low, ends[0]), max(plain.high, ends[1])
    value = f"{100 * held.mean():.1f} % of {len(held)} ({100 * low:.1f}–{100 * high:.1f})"
    return replace(plain, value=value, low=low, high=high)


def mean(
    what: str,
    values: Sequence[float],
    *,
    least: float = -np.inf,
    most: float = np.inf,
    unit: str = "",
    times: float = 1.0,
) -> Measured:
    """Compute a mean with its interval by resampling, and its target; printed numbers are multiplied by ``times``."""
    each = np.asarray(values, dtype=float)
    low, high = resampled(each, lambda some: some.mean(axis=-1)) or (-np.inf, np.inf)
    told = middle(times * each, np.mean, unit=unit)
    return Measured(what, told, low, high, least, most, _said(least, most, unit, times))


def middle(values: np.ndarray, of: Callable[..., Any] = np.median, *, unit: str = "", fewest: int = FEWEST) -> str:
    """Format a statistic with its n and its 95 % interval by resampling the cases, if these are not too few."""
    if not len(values):
        return "–"
    found = resampled(values, lambda some: of(some, axis=-1), fewest=fewest)
    between = f"{found[0]:.3g} to {found[1]:.3g}" if found else "too few for an interval"
    return f"{of(values):.3g}{unit} of {len(values)} ({between})"


def limit(what: str, value: float, *, most: float, unit: str = "") -> Measured:
    """Return a number without an interval, with its upper limit as the target."""
    return Measured(what, f"{value:.3g}{unit}", value, value, most=most, target=_said(-np.inf, most, unit, 1.0))


def resampled(
    values: np.ndarray, of: Callable[[np.ndarray], np.ndarray], seed: int = 1, *, fewest: int = FEWEST
) -> tuple[float, float] | None:
    """Compute the 95 % interval of a statistic by resampling the cases (Efron 1979); None if they are too few."""
    if values.size < fewest:
        return None
    drawn = of(np.random.default_rng(seed).choice(values, (DRAWS, values.size)))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)


def report(lines: Sequence[Measured]) -> int:
    """Print a table and return the exit status: 1 if any target is missed."""
    head("measure", "value", "target")
    missed = [one for one in lines if not told(one)]
    return int(bool(missed))


def told(one: Measured) -> bool:
    """Print one line; return False if its target is missed."""
    line(one.what, one.value, one.verdict)
    return one.held


def head(*names: str) -> None:
    """Print the head of a table."""
    print()
    line(*names)
    print("|---" * len(names) + "|")


def line(*cells: object) -> None:
    """Print a line of a table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def rows_of(file: Path | None, run: dict[str, Any]) -> list[dict[str, Any]]:
    """Read the rows of a file of this run; without a file there are none."""
    made = [json.loads(text) for text in file.read_text().splitlines()] if file and file.exists() else []
    if any(row.get(key) != value for row in made for key, value in run.items()):
        sys.exit(f"{file}: expected rows of {run}, found those of another run; name another file")
    return made


def added(file: Path | None, row: dict[str, Any]) -> dict[str, Any]:
    """Append a row to the file, and return it as it would be read."""
    text = json.dumps(row, default=float)
    if file:
        with file.open("a") as stream:
            stream.write(text + "\n")
    made: dict[str, Any] = json.loads(text)
    return made


def resumed(
    file: Path | None,
    run: dict[str, Any],
    wanted: Sequence[tuple[str, int]],
    measure: Callable[[str, int], Any],
    cores: int = 1,
) -> list[dict[str, Any]]:
    """Return a row for each wanted (kind, index), read from a file of this run, or measured and added to it."""
    known = {(row["kind"], row["index"]): row for row in rows_of(file, run)}
    missing = [one for one in wanted if one not in known]
    with ProcessPoolExecutor(cores) if cores > 1 else nullcontext() as pool:
        made = (pool.map if pool else map)(measure, *zip(*missing, strict=True)) if missing else ()
        for count, (one, row) in enumerate(zip(missing, made, strict=True), 1):
            known[one] = added(file, run | row)
            progress(f"{one[0]} {one[1] + 1}, {count} of {len(missing)}")
    print(file=sys.stderr)
    return [known[one] for one in wanted]


def progress(text: str) -> None:
    """Print the progress of a run over the previous message."""
    print(f"\r{text}", end="", file=sys.stderr, flush=True)


def _said(least: float, most: float, unit: str, times: float) -> str:
    low, high = times * least, times * most
    if least == most:
        return f"{low:g}{unit}"
    # For shares, the range from 0 to 1 is no target.
    below, above = least > (0.0 if unit == " %" else -np.inf), most < (1.0 if unit == " %" else np.inf)
    if below and above:
        return f"{low:g} to {high:g}{unit}"
    return f"≥ {low:g}{unit}" if below else f"≤ {high:g}{unit}" if above else ""
