"""Choice of the temperature of the evidence by cross-validation over families of effects, on simulated moorings.

    python benchmarks/temperature.py 58 6262 --rows PATH    58 moorings by seed 6262; an interrupted run resumes

Each mooring is inferred once, and its posterior is computed at every temperature. The score is the log score of the
probability of a fault of compass or clock, and of that of each driver with 5 % or more. The temperature of the search
was fixed by seeds that are used in no other measurement.
"""

from __future__ import annotations

import discrepancy as bench
import families
import numpy as np
import targets

from compasslib.inference import inference
from compasslib.inference.finding import TILTS
from tests.world import pairs as sea

GRID = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.85, 1.0)
SIZES = (3.0, 1.5)
LEAST, WORST = 0.05, 1e-4  # minimum probability of a driver that is scored; lower limit of probabilities in scores
KEPT = 25  # most probable models of slow water
DRIVERS = {kind.name: TILTS.get(kind.driver, kind.driver) for kind in reversed(bench.CATALOGUE)}


def draw(index: int, seed: int) -> tuple[sea.Drawn, str, set[str]]:
    """Simulate a mooring; return it with the family of its effect and the drivers that are correct for it."""
    own, red, size = 100_000 * seed + index, index % 2 == 1, SIZES[index // 6 % 2]
    slow = sea.some_slow_water(np.random.default_rng(own)) if red else None
    world = sea.make(own, wide=index % 3 == 2, slow_water=slow)
    if index % 3 == 0:
        return sea.planted(world, {}), "nothing", set()
    if index % 3 == 1:
        names = [name for name in bench.SINGLES if sea.FAMILIES[name] != "water"]
        name = names[index // 3 % len(names)]
        return sea.planted(world, {name: size}), name, {DRIVERS[name]}
    inside = [name for name in families.FAMILIES if name not in ("tide", "deep", "beams_by_depth", "veer_limit")]
    name = inside[index // 3 % len(inside)]
    effect, right = families.FAMILIES[name](world)
    drivers = {TILTS.get(driver, driver) for _, driver, _ in right}
    return sea.planted(world, {name: 2.0 * size}, {name: effect}), name, drivers


def measure(index: int, seed: int) -> dict:
    """Infer one mooring and return its row: scores of the fault and of drivers at each temperature."""
    drawn, family, right = draw(index, seed)
    found = inference.infer(bench.bare_state(drawn), 1.0).posterior
    candidates, kinds = found.candidates, found.candidates.kinds
    waters = [found.waters[i] for i in np.argsort(-found.water_probability)[:KEPT]]
    tried = candidates.index(found.hypotheses)
    table = [
        products.log_likelihood + candidates.log_evidence(products, tried, found.best)
        for products in map(candidates.marginalize, waters)
    ]
    water = np.array([[0.0 if one is None else one.log_prior] for one in waters])
    acting = [{TILTS.get(kinds[k].driver, kinds[k].driver) for k in one} for one in found.hypotheses]
    fault = np.array([any(kinds[k].side in ("compass", "clock") for k in one) for one in found.hypotheses])
    scores = []
    for eta in GRID:
        log = eta * np.array(table) + water + found.prior
        probability = np.exp(log - log.max()).sum(axis=0)
        probability /= probability.sum()
        told = {name: probability[[name in one for one in acting]].sum() for name in set().union(*acting)}
        each = [score(p, name in right) for name, p in told.items() if p >= LEAST]
        scores.append([score(probability[fault].sum(), bool(right)), float(np.mean(each)) if each else 0.0])
    return {"kind": "mooring", "index": index, "family": family, "scores": scores}


def score(stated: float, came: bool) -> float:
    return float(-np.log(max(stated if came else 1.0 - stated, WORST)))


def main() -> None:
    asked = targets.parser(__doc__, 58, rows=True).parse_args()
    wanted = [("mooring", index) for index in range(asked.count)]
    rows = targets.resumed(asked.rows, {"seed": asked.seed}, wanted, lambda kind, index: measure(index, asked.seed))
    each = np.array([row["scores"] for row in rows])
    family = np.array([row["family"] for row in rows])
    targets.head("temperature", "log score of faults, nats", "of drivers", "both")
    for eta, (fault, driver) in zip(GRID, each.mean(axis=0), strict=True):
        targets.line(f"{eta:g}", f"{fault:.3f}", f"{driver:.3f}", f"{fault + driver:.3f}")
    both = each.sum(axis=2)
    chosen = {name: GRID[int(np.argmin(both[family != name].mean(axis=0)))] for name in dict.fromkeys(family)}
    left_out = np.array([both[k, GRID.index(chosen[name])] for k, name in enumerate(family)])
    targets.line("chosen without each family", " ".join(f"{eta:g}" for eta in sorted(chosen.values())))
    gained = targets.mean("gained on 1, families left out, nats", both[:, -1] - left_out, least=0.0)
    targets.line(gained.what, gained.value, gained.verdict)


if __name__ == "__main__":
    main()
