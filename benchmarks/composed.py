"""Score of the search on effects outside the catalogue, defined in a separate file.

    python benchmarks/composed.py 54 1                   families.py; 54 moorings, a third of 1.5 and the rest of 3°
    python benchmarks/composed.py 54 1 --families PATH   families of another file
    python benchmarks/composed.py 54 1 --red             in slowly veering water

The file defines FAMILIES: name -> function of a World that returns an Effect and its correct descriptions, (acts_on,
driver, form) each. Its hash is printed to prove that a file written before the search was not changed.
"""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from pathlib import Path

import discrepancy as bench
import numpy as np
import targets

from compasslib.effects import COMPOSED, side_of
from tests.world import pairs as sea

SIZES = (3.0, 3.0, 1.5)
LISTED = {"pressure": ("field_forward", "depth", "linear"), "pivot_friction": ("reading", "turn_rate", "sign")}


def families(path: Path) -> dict:
    spec = importlib.util.spec_from_file_location("families", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.FAMILIES


def described(name: str) -> tuple[str, ...] | None:
    """Return acts_on, driver and form of a composed name or one in ``LISTED``, None for other names."""
    return tuple(name.removeprefix(COMPOSED).split("/")) if name.startswith(COMPOSED) else LISTED.get(name)


def measure(every: dict, index: int, seed: int, *, red: bool) -> dict:
    """Simulate and diagnose one mooring; return its row of planted effect and findings."""
    own = 100_000 * seed + 77_000 + index
    name, size = list(every)[index % len(every)], SIZES[index % len(SIZES)]
    slow = sea.some_slow_water(np.random.default_rng(own)) if red else None
    world = sea.make(own, wide=index % 3 == 2, slow_water=slow)
    effect, right = every[name](world)
    drawn = sea.planted(world, {name: size}, {name: effect})
    fit, field, found, diagnosed = bench.diagnosed(drawn, size)
    first = [one.named for one in found.findings]
    told = {n for one in found.findings for n in (one.named, *one.alternatives)}
    words = {described(n) for n in told} - {None}
    drivers = {one[1] for one in words} | {one.driver for one in found.current}
    sides = {side_of(COMPOSED + "/".join(one)) for one in right}
    row = {
        "family": name, "size": size, "verdict": found.verdict, "first": first, "set": sorted(told),
        "seconds": diagnosed["seconds"],
        "side": max(found.sides.get(side, 0.0) for side in sides) >= 0.5 if found.sides else False,
        "in_set": bool(words & right),
        "is_first": bool({described(n) for n in first} & right),
        "driver": bool(drivers & {one[1] for one in right}),
        "wrong_only": bool(told) and not drivers & {one[1] for one in right},
        "consistent": found.verdict == "consistent",
    }  # fmt: skip
    if effect.veer is None and found.verdict != "insufficient":
        none = sea.planted(sea.make(own, wide=index % 3 == 2, slow_water=slow), {})
        drawn.truth.clear()
        row |= bench.against_oracle(drawn, fit, field, found)
        row["error_without"] = bench.against_oracle(none, bench.fitted(none), field, found)["error_before"]
    return row


def main() -> None:
    parser = targets.parser(__doc__, 54, red=True, rows=True)
    parser.add_argument("--families", type=Path, default=Path(__file__).with_name("families.py"))
    asked = parser.parse_args()
    every, sha256 = families(asked.families), hashlib.sha256(asked.families.read_bytes()).hexdigest()
    print(f"{len(every)} families, sha256 {sha256}")
    run = {"seed": asked.seed, "red": asked.red, "families": sha256}
    rows = targets.rows_of(asked.rows, run)[: asked.count]
    for index in range(len(rows), asked.count):
        rows.append(targets.added(asked.rows, run | measure(every, index, asked.seed, red=asked.red)))
        targets.progress(f"{index + 1} of {asked.count}")
    targets.head("measure", "value", "target")
    good = [_of_size(rows, size) for size in (3.0, 1.5)]
    own = [row for row in rows if "covered" in row]
    if own:
        excess = [max(row["error_before"] - row["error_without"], 0.1) for row in own]
        gained = [row["error_before"] - row["error_after"] for row in own]
        lacks = np.array(gained) - 0.6 * np.array(excess)
        line = targets.mean("heading error taken off beyond 60 % of its excess, degrees", lacks, least=0.0)
        covers = [row["covered"] for row in own]
        within = targets.mean("headings within 95 %", covers, least=0.9, unit=" %", times=100.0)
        good += [bench.told(line), bench.told(within)]
    seconds = float(np.median([row["seconds"] for row in rows]))
    good.append(bench.told(targets.limit("seconds a mooring, median", seconds, most=10.0)))
    sys.exit(0 if all(good) else 1)


def _of_size(rows: list[dict], size: float) -> bool:
    own = [row for row in rows if row["size"] == size]
    at_3 = size == 3.0
    return all([
        bench.held(f"{size}: side at least as probable as not", [row["side"] for row in own]),
        bench.held(f"{size}: in the set", [row["in_set"] for row in own], least=0.6 * at_3),
        bench.held(f"{size}: first", [row["is_first"] for row in own], least=0.45 * at_3),
        bench.held(f"{size}: driver in the set", [row["driver"] for row in own], least=0.75 * at_3),
        bench.held(f"{size}: only wrong names", [row["wrong_only"] for row in own], most=0.05),
        bench.held(f"{size}: called consistent", [row["consistent"] for row in own], most=0.05 if at_3 else 1.0),
        bench.held(f"{size}: called unexplained", [row["verdict"] == "unexplained" for row in own]),
    ])  # fmt: skip


if __name__ == "__main__":
    main()
