"""Benchmark measures and their targets: shares, intervals, exit status, and rows to resume interrupted runs from.

A target is missed if the 95 % interval excludes it; a script that misses one ends with status 1.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
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


def parser(doc: str, count: int, kinds: Sequence[str], *, rows: bool = False) -> argparse.ArgumentParser:
    """Make the parser of a benchmark: count, seed, one of its kinds, and the file of rows where it has one."""
    made = argparse.ArgumentParser(description=doc.splitlines()[0])
    made.add_argument("count", type=int, nargs="?", default=count, help=f"cases, of each kind (default {count})")
    made.add_argument("seed", type=int, nargs="?", default=1)
    made.add_argument("--kind", choices=kinds)
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


def share(
    what: str, values: Iterable[object], *, least: float = 0.0, most: float = 1.0, groups: Sequence[object] = ()
) -> Measured:
    """Compute a share with its target.

    Args:
        groups: of each case, if cases depend on each other in groups; resampling them may widen the interval.
    """
    held = np.array([bool(one) for one in values])
    value, low, high = share_of(held), *(interval(int(held.sum()), len(held)) if len(held) else (0.0, 1.0))
    if len(groups):
        group = np.unique(np.array(groups), return_inverse=True)[1]
        sums, counts = np.bincount(group, held), np.bincount(group)
        picked = np.random.default_rng(0).integers(0, len(sums), (DRAWS, len(sums)))
        ends = np.quantile(sums[picked].sum(axis=1) / counts[picked].sum(axis=1), [0.025, 0.975]).tolist()
        low, high = min(low, ends[0]), max(high, ends[1])
        value = f"{100 * held.mean():.1f} % of {len(held)} ({100 * low:.1f}–{100 * high:.1f})"
    return Measured(what, value, low, high, least, most, _said(least, most, " %", 100.0))


def mean(
    what: str, values: Sequence[float], *, least: float = -np.inf, most: float = np.inf, percent: bool = False
) -> Measured:
    """Compute a mean with its interval by resampling, and its target; shares are printed in percent if asked."""
    each, (times, unit) = np.asarray(values, dtype=float), (100.0, " %") if percent else (1.0, "")
    low, high = resampled(each, lambda some: some.mean(axis=-1)) or (-np.inf, np.inf)
    return Measured(
        what, middle(times * each, np.mean, unit=unit), low, high, least, most, _said(least, most, unit, times)
    )


def middle(values: np.ndarray, of: Callable[..., Any] = np.median, *, unit: str = "", fewest: int = FEWEST) -> str:
    """Format a statistic with its n and its 95 % interval by resampling the cases, if these are not too few."""
    if not len(values):
        return "–"
    found = resampled(values, lambda some: of(some, axis=-1), fewest=fewest)
    between = f"{found[0]:.3g} to {found[1]:.3g}" if found else "too few for an interval"
    return f"{of(values):.3g}{unit} of {len(values)} ({between})"


def limit(what: str, value: float, *, most: float) -> Measured:
    """Return a number without an interval, with its upper limit as the target."""
    return Measured(what, f"{value:.3g}", value, value, most=most, target=_said(-np.inf, most, "", 1.0))


def resampled(
    values: np.ndarray, of: Callable[[np.ndarray], np.ndarray], *, fewest: int = FEWEST
) -> tuple[float, float] | None:
    """Compute the 95 % interval of a statistic by resampling the cases (Efron 1979); None if they are too few."""
    if values.size < fewest:
        return None
    drawn = of(np.random.default_rng(1).choice(values, (DRAWS, values.size)))
    low, high = np.quantile(drawn, [0.025, 0.975])
    return float(low), float(high)


class Report:
    """A table of measures, printed line by line."""

    def __init__(self) -> None:
        self.missed = False  # whether the interval of any measure excludes its target
        head("measure", "value", "target")

    def add(self, one: Measured) -> None:
        """Print a measure and note whether its target is missed."""
        self.note(one.what, one.value, one.verdict)
        self.missed |= not one.held

    def share(self, what: str, values: Iterable[object], **target: Any) -> None:
        """Print a share with its target, if it has one."""
        self.add(share(what, values, **target))

    def note(self, what: str, value: str, target: str = "") -> None:
        """Print a line, unless there are no data."""
        if not value.startswith(("–", "nan")):
            line(what, value, target)


def report(lines: Iterable[Measured]) -> int:
    """Print a table and return the exit status: 1 if any target is missed."""
    table = Report()
    for one in lines:
        table.add(one)
    return int(table.missed)


def head(*names: str) -> None:
    """Print the head of a table."""
    print()
    line(*names)
    print("|---" * len(names) + "|")


def line(*cells: object) -> None:
    """Print a line of a table."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def resumed(
    asked: argparse.Namespace, kinds: Sequence[str], measure: Callable[[str, int], dict[str, Any]], **run: Any
) -> list[dict[str, Any]]:
    """Measure the cases asked for, of one kind or of all; those in the file ``asked.rows`` are read from it.

    Args:
        run: settings of the run, which all rows of the file must have.
    """
    file, run = asked.rows, {"seed": asked.seed, **run}
    made = [json.loads(text) for text in file.read_text().splitlines()] if file and file.exists() else []
    if any(row.get(key) != value for row in made for key, value in run.items()):
        sys.exit(f"{file}: expected rows of {run}, found those of another run; name another file")
    known = {(row["kind"], row["index"]): row for row in made}
    wanted = [(kind, index) for kind in ([asked.kind] if asked.kind else kinds) for index in range(asked.count)]
    for done, one in enumerate(wanted, 1):
        if one not in known:
            text = json.dumps(run | measure(*one), default=float)
            if file:
                with file.open("a") as stream:
                    stream.write(text + "\n")
            known[one] = json.loads(text)
            print(f"\r{one[0]} {one[1] + 1}, {done} of {len(wanted)}", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return [known[one] for one in wanted]


def _said(least: float, most: float, unit: str, times: float) -> str:
    low, high = times * least, times * most
    if least == most:
        return f"{low:g}{unit}"
    # For shares, the range from 0 to 1 is no target.
    below, above = least > (0.0 if unit == " %" else -np.inf), most < (1.0 if unit == " %" else np.inf)
    if below and above:
        return f"{low:g} to {high:g}{unit}"
    return f"≥ {low:g}{unit}" if below else f"≤ {high:g}{unit}" if above else ""
