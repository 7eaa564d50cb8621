"""What to measure next: stated chances that an observation leaves one name, and what came of it.

    python benchmarks/experiments.py 40 1 ROWS     40 ambiguous moorings by seed 1, in water that veers slowly

Moorings with one effect are drawn until as many are ambiguous. Of each, half a year is judged; then its second half is
added, and apart from that a second reference at another depth, both simulated and judged by the whole search. ROWS gets
one line of JSON a mooring, from which a cut run goes on.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import discrepancy as bench
import numpy as np

from compasslib.core.records import Pairs, take
from compasslib.preparation import several
from compasslib.search.diagnosis import Options, diagnose
from compasslib.search.verdict import Diagnosis
from compasslib.simulation import pairs as sea

HALF, MOST = 4000, 1000
SETTLED = ("explained", "consistent")


def of_house(drawn: sea.Drawn) -> Pairs:
    return Pairs(**{name: value for name, value in vars(drawn.pairs).items() if name not in ("warnings",)})


def judged(drawn: sea.Drawn, pairs: Pairs) -> Diagnosis:
    some = np.searchsorted(drawn.pairs.time_s, pairs.time_s)
    own = replace(drawn, pairs=pairs, heading=drawn.heading[some])
    series = {name: column[some] for name, column in drawn.covariates.items()}
    return diagnose(pairs, series, bench.fitted(own), bench.field_of(own), Options())


def beside(world: sea.World, pairs: Pairs, rng: np.random.Generator) -> Pairs:
    """Return pairs with a second reference, in water and with noise of its own."""
    (slow, memory, white), n = world.noise, len(world.time_s)
    noise = (sea.red(rng, n, memory, slow) + 1j * sea.red(rng, n, memory, slow)) / 2.0
    noise = noise + np.sqrt(0.5) * white * (rng.normal(size=n) + 1j * rng.normal(size=n))
    lower = (world.water + noise + world.slow_water.beside(rng, world.water))[: len(pairs)]
    second = replace(pairs, lower_east=lower.real, lower_north=lower.imag, lower_depth_m=pairs.lower_depth_m + 20.0)
    return several.together(several.joined([pairs, second], ["first", "second"]))


def measure(index: int, seed: int) -> dict:
    """Return what was stated of a mooring and what came, nothing stated where it is not ambiguous."""
    own = 100_000 * seed + 55_000 + index
    slow = sea.some_slow_water(np.random.default_rng(own))
    world = sea.make(own, wide=index % 3 == 2, slow_water=slow, n=2 * HALF)
    effect = bench.SINGLES[index % len(bench.SINGLES)]
    drawn = sea.planted(world, {effect: float(np.random.default_rng(own).choice([1.5, 3.0]))})
    whole = of_house(drawn)
    first = take(whole, np.arange(HALF))
    found = judged(drawn, first)
    row = {"index": index, "effect": effect, "verdict": found.verdict, "stated": [], "before": names(found)}
    if found.verdict != "ambiguous":
        return row
    after = {
        "another": judged(drawn, whole),
        "a second": judged(drawn, beside(world, first, np.random.default_rng(own))),
    }
    for what, chance in found.experiments:
        for begin, then in after.items():
            if what.startswith(begin):
                row["stated"].append([begin, chance, then.verdict, names(then)])
    return row


def names(found: Diagnosis) -> list[list[str]]:
    return [[one.named, *one.alternatives] for one in found.findings]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("ambiguous", type=int)
    parser.add_argument("seed", type=int)
    parser.add_argument("rows", type=Path)
    asked = parser.parse_args()
    rows = [json.loads(line) for line in asked.rows.read_text().splitlines()] if asked.rows.exists() else []
    while sum(bool(row["stated"]) for row in rows) < asked.ambiguous and len(rows) < MOST:
        rows.append(measure(len(rows), asked.seed))
        with asked.rows.open("a") as file:
            file.write(json.dumps(rows[-1]) + "\n")
        print(f"\r{sum(bool(row['stated']) for row in rows)} of {asked.ambiguous}", end="", file=sys.stderr, flush=True)
    print(f"\n{len(rows)} moorings, {sum(bool(row['stated']) for row in rows)} ambiguous")
    print("| observation | n | stated | came | 95 % of what may come if the chances are right |\n|---|---|---|---|---|")
    sys.exit(0 if all([calibrated(rows, one) for one in ("another", "a second")]) else 1)  # noqa: C419  both are printed


def calibrated(rows: list[dict], begin: str) -> bool:
    """Print stated chances beside what came; tell whether chance allows their difference."""
    own = [(chance, verdict in SETTLED) for row in rows for b, chance, verdict, _ in row["stated"] if b == begin]
    good = True
    for low, high in ((0.0, 1.0), (0.0, 0.2), (0.2, 0.8), (0.8, 1.0)):
        some = [one for one in own if low <= one[0] < high or one[0] == high == 1.0]
        if not some:
            continue
        chances, came = (np.array(x, dtype=float) for x in zip(*some, strict=True))
        drawn = (np.random.default_rng(1).random((4000, len(some))) < chances).mean(axis=1)
        between = np.quantile(drawn, [0.025, 0.975])
        good &= (low, high) != (0.0, 1.0) or bool(between[0] <= came.mean() <= between[1])
        print(f"| {begin} ({low:.1f}-{high:.1f}) | {len(some)} | {chances.mean():.2f} | {came.mean():.2f} | "
              f"{between[0]:.2f}-{between[1]:.2f} |")  # fmt: skip
    return good


if __name__ == "__main__":
    main()
