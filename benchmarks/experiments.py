"""Calibration of the stated probabilities that an additional observation leaves a single finding.

    python benchmarks/experiments.py 40 1                  40 ambiguous moorings by seed 1, in slowly veering water
    python benchmarks/experiments.py 40 1 --rows ROWS      with one line of JSON per mooring; an interrupted run resumes

Half a year of each is diagnosed; then its second half, or a second reference at another depth, is added, and the search
is repeated. A swing of all headings after recovery and a log of the field strength are simulated by formulae
independent of the engine, and weigh the hypotheses again. A single finding counts as left if the verdict is
``explained``, or if the probability of no effect is 95 %.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import discrepancy as bench
import numpy as np
import targets

from compasslib import angles
from compasslib.deviation.model import nearest_root
from compasslib.effects import Scene
from compasslib.effects.forward import earth_field_in_body, invert_heading, north_shift, sensed_field
from compasslib.inference import design, experiments
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.finding import SURE
from compasslib.inference.kinds.mooring import diagnose
from compasslib.inference.weighing import Inference
from compasslib.preparation.references import combine_references, join_references
from compasslib.records import Pairs, take
from tests.world import pairs as sea

HALF, MOST = 4000, 1000
SWING, STRENGTH = "a swing", "the strength"
OBSERVED = ("another", "a second", SWING, STRENGTH)
STAYS = ("heading_slip", "compass_drift", "hard_iron_step", "hard_iron_drift")  # remain on deck as at the record's end
NONE_ON_DECK = ("compass_lag", "current_veer")
INFERRED: list[Inference] = []  # of the recording that was diagnosed last


def judged(drawn: sea.Drawn, pairs: Pairs) -> Diagnosis:
    some = np.searchsorted(drawn.pairs.time_s, pairs.time_s)
    own = replace(drawn, pairs=pairs, heading=drawn.heading[some])
    series = {name: column[some] for name, column in drawn.covariates.items()}
    return diagnose(pairs, series, bench.fitted(own), bench.field_of(own), Options())


def remembered(found: Inference) -> tuple[tuple[str, float], ...]:
    INFERRED[:] = [found]
    return STATED(found)


STATED = experiments.rank_observations
experiments.rank_observations = remembered  # the search does not return its posterior otherwise


def settled(found: Diagnosis) -> float:
    return float(found.verdict == "explained" or (found.verdict == "consistent" and found.sides["none"] >= SURE))


def left(after: experiments.Prospects, begin: str, seen: np.ndarray) -> float:
    return after.after(next(what for what in after.observations if what.startswith(begin)), seen)


def swung(found: Inference, drawn: sea.Drawn, rng: np.random.Generator) -> np.ndarray:
    """Simulate the residual of a swing on a level deck from the compass without terms, in units of its noise."""
    heading = np.arange(experiments.COURSES) * 360.0 / experiments.COURSES
    none = np.zeros((2, len(heading)))
    deck = replace(drawn.world, heading=heading, tilt=none, sensed=none)
    parts = [(*one, name) for one, name in zip(drawn.parts, drawn.truth, strict=True) if name not in NONE_ON_DECK]
    extra = np.zeros((3, len(heading)))
    for part, size, name in parts:
        if part.extra is not None:
            extra += size * at_deck(part.extra, name)[:, None]

    def offset(gamma):
        own = ((part.offset(gamma), size, name) for part, size, name in parts if part.offset is not None)
        return sum((size * (turn if name in LOBES else at_deck(turn, name)) for turn, size, name in own), 0)

    mark, noise = rng.normal(0.0, 3.0), rng.normal(0.0, experiments.SWUNG_DEG, len(heading))
    recorded = sea.compass(deck, extra=extra, offset=offset)
    bare = design.refit(found.state, []).simulation  # to which the terms of hypotheses are added
    h, z = (np.full(len(heading), nT) for nT in (drawn.horizontal, drawn.vertical))
    scene = Scene(0.0 * heading, h, z, *none, 0.0)
    foretold = nearest_root(invert_heading(bare, scene, recorded), heading)
    return np.nan_to_num(angles.difference(heading + mark + noise, foretold)) / experiments.SWUNG_DEG


LOBES = ("sextantal", "octantal")


def at_deck(series: np.ndarray, name: str) -> np.ndarray:
    """Compute an effect's value on deck: that at the end of the record, or its mean over the record."""
    return series[..., HALF - 1] if name in STAYS else series[..., :HALF].mean(axis=-1)


def strength(found: Inference, drawn: sea.Drawn, rng: np.random.Generator) -> np.ndarray:
    """Simulate the residual of a log of the field strength from the compass without terms, in units of its noise."""
    extra = sum((size * part.extra for part, size in drawn.parts if part.extra is not None), np.zeros((3, 2 * HALF)))
    noise = sea.red(rng, HALF, experiments.STRENGTH_S / sea.HOUR_S, experiments.STRENGTH_NT)
    logged = np.linalg.norm(sea.in_body(drawn.world, extra), axis=0)[:HALF] + noise
    scene, north = found.state.case.scene, north_shift(found.state.simulation, found.state.case.scene)
    earth = earth_field_in_body(scene, experiments.known_heading(found.state) - north)
    bare = np.linalg.norm(sensed_field(design.refit(found.state, []).simulation, scene, earth), axis=1)
    return (logged - bare) * experiments.strength_unit(scene.time_s)


def beside(world: sea.World, pairs: Pairs, rng: np.random.Generator) -> Pairs:
    """Add a second reference, with currents and noise of its own, to pairs."""
    (slow, memory, white), n = world.noise, len(world.time_s)
    # Half of the red noise of the first pairs is that of the affected instrument; noise of the second adds as much.
    noise = np.sqrt(0.75) * (sea.red(rng, n, memory, slow) + 1j * sea.red(rng, n, memory, slow))
    noise = noise + np.sqrt(0.5) * white * (rng.normal(size=n) + 1j * rng.normal(size=n))
    lower = (world.water + noise + world.slow_water.beside(rng, world.water))[: len(pairs)]
    second = replace(pairs, lower_east=lower.real, lower_north=lower.imag, lower_depth_m=pairs.lower_depth_m + 20.0)
    return combine_references(join_references([pairs, second], ["first", "second"]))


def measure(index: int, seed: int) -> dict:
    """Compute stated probabilities and outcomes for a mooring; none are stated if it is not ambiguous."""
    own = 100_000 * seed + 55_000 + index
    slow = sea.some_slow_water(np.random.default_rng(own))
    world = sea.make(own, wide=index % 3 == 2, slow_water=slow, n=2 * HALF)
    effect = bench.SINGLES[index % len(bench.SINGLES)]
    drawn = sea.planted(world, {effect: float(np.random.default_rng(own).choice([1.5, 3.0]))})
    whole = drawn.pairs
    first = take(whole, np.arange(HALF))
    found = judged(drawn, first)
    row = {"index": index, "effect": effect, "verdict": found.verdict, "stated": []}
    row["before"] = [[one.named, *one.alternatives] for one in found.findings]
    if found.verdict != "ambiguous":
        return row
    ahead, inferred, rng = experiments.prospects(INFERRED[0]), INFERRED[0], np.random.default_rng(own)
    assert ahead is not None
    came = {SWING: left(ahead, SWING, swung(inferred, drawn, rng))}
    if any(what.startswith(STRENGTH) for what in ahead.observations):
        came[STRENGTH] = left(ahead, STRENGTH, strength(inferred, drawn, rng))
    came["another"] = settled(judged(drawn, whole))
    came["a second"] = settled(judged(drawn, beside(world, first, np.random.default_rng(own))))
    for what, chance in found.experiments:
        row["stated"] += [[begin, chance, came[begin]] for begin in OBSERVED if what.startswith(begin)]
    return row


def main() -> None:
    asked = targets.parser(__doc__, 40, rows=True).parse_args()
    run = {"seed": asked.seed}
    rows = targets.rows_of(asked.rows, run)
    while sum(bool(row["stated"]) for row in rows) < asked.count and len(rows) < MOST:
        rows.append(targets.added(asked.rows, run | measure(len(rows), asked.seed)))
        targets.progress(f"{sum(bool(row['stated']) for row in rows)} of {asked.count}")
    print(f"\n{len(rows)} moorings, {sum(bool(row['stated']) for row in rows)} ambiguous")
    targets.head("observation", "n", "stated", "came", "95 % of what may come if the chances are right")
    sys.exit(0 if all([calibrated(rows, one) for one in OBSERVED]) else 1)  # noqa: C419  both are printed


def calibrated(rows: list[dict], begin: str) -> bool:
    """Print stated probabilities and frequencies; return whether their difference is compatible with chance."""
    own = [(chance, came) for row in rows for b, chance, came in row["stated"] if b == begin]
    good = True
    for low, high in ((0.0, 1.0), (0.0, 0.2), (0.2, 0.8), (0.8, 1.0)):
        some = [one for one in own if low <= one[0] < high or one[0] == high == 1.0]
        if not some:
            continue
        chances, came = (np.array(x, dtype=float) for x in zip(*some, strict=True))
        drawn = (np.random.default_rng(1).random((4000, len(some))) < chances).mean(axis=1)
        between = np.quantile(drawn, [0.025, 0.975])
        good &= (low, high) != (0.0, 1.0) or bool(between[0] <= came.mean() <= between[1])
        numbers = f"{chances.mean():.2f}", f"{came.mean():.2f}", f"{between[0]:.2f}–{between[1]:.2f}"
        targets.line(f"{begin} ({low:.1f}–{high:.1f})", len(some), *numbers)
    return good


if __name__ == "__main__":
    main()
