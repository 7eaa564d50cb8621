"""Upper bound, set by the noise, of the share of planted effects that any search can detect.

    python benchmarks/reach.py 110 71 --red           110 moorings with one and 110 with two effects, in slow water
    python benchmarks/reach.py 110 71 --red --kind single --engine ROWS    beside the engine's detections: rows of
                                                      discrepancy.py by the same seed
    python benchmarks/reach.py 120 71 --heldout ROWS  held-out days against the prediction of the others:
                                                      120 effects of 4 to 8 standard errors, 200 nulls, 100 days each

Each effect is tested with everything known except its size, the size of the other effect and the five coefficients. No
search with less knowledge can have more power. The exit status is 1 if the interval of the engine's shortfall lies
above 5 points, or if held-out slopes, their intervals or the ranks of records without an effect miss their targets.
"""

from __future__ import annotations

import itertools
import sys
from pathlib import Path

import discrepancy as bench
import numpy as np
import targets
from scipy.stats import chi2, kstest, ncx2, norm

from compasslib.inference import design, finding, heldout, inference
from compasslib.statistics.resampling import blocks_by_count
from tests.world import pairs as sea

INDEPENDENT = 17  # effective number of independent scores in a search of the catalogue, by draws of the noise
VEERS_DEG = (0.0, 1.0, 2.0, 4.0, 8.1)  # edges of the sizes of slow veer
MISSED = 0.05  # largest shortfall of the engine's detected share of singles below the upper bound
HELD_OUT_HOURS, SMALLEST_Z, LARGEST_Z = 2400, 4.0, 8.0  # records and effects in the test of held-out days
NULLS, SURROGATES = 200, 19  # records without an effect, and surrogates of each
KNOWN, SEARCHED = norm.isf(0.01), norm.isf(1.0 - 0.99 ** (1.0 / INDEPENDENT))  # for 1 % of false alarms


def whitened(world: sea.World, columns: np.ndarray) -> np.ndarray:
    """Whiten columns, degrees, by the innovations of a Kalman filter of the noise.

    Its state is the red-noise velocity difference, east and north, and in slow water also its shear and veer.
    """
    red, memory, white = world.noise
    size, hours, flow = [red, red], [memory, memory], world.between
    across = np.stack([-flow.imag, flow.real], axis=1) / np.abs(flow)[:, None] ** 2 / sea.RAD  # degrees per m/s
    if (slow := world.slow_water) is not None:
        size += [slow.shear_m_s, slow.shear_m_s, slow.veer_deg]
        hours += [24.0 * slow.shear_days, 24.0 * slow.shear_days, 24.0 * slow.veer_days]
        across = np.column_stack([across, across, np.ones(len(across))])
    keep, whole = np.exp(-1.0 / np.array(hours)), np.diag(np.square(size))
    width = white / np.abs(flow) / sea.RAD
    mean, spread, result = np.zeros((len(size), columns.shape[1])), whole.copy(), np.empty_like(columns)
    for t, h in enumerate(across):
        gain = spread @ h
        total = h @ gain + width[t] ** 2
        off = columns[t] - h @ mean
        result[t] = off / np.sqrt(total)
        mean = keep[:, None] * (mean + np.outer(gain / total, off))
        spread = np.outer(keep, keep) * (spread - np.outer(gain, gain) / total) + whole * (1.0 - keep**2)
    return result


def signals(drawn: sea.Drawn) -> tuple[np.ndarray, np.ndarray]:
    """Compute the residual signal of each effect given the others, and the columns of five coefficients, degrees."""
    world, parts = drawn.world, drawn.parts

    def left(some):
        gamma, veer, _ = sea.combined(world, some)
        return sea.five_term_residual(gamma - veer, world.heading)

    total, (a, b, c, d, e) = left(parts)
    w = np.exp(1j * sea.RAD * world.heading)
    q = (1 - 1j * a) * w + b - 1j * c + (d - 1j * e) / w
    slope = np.maximum(np.real(((1 - 1j * a) * w - (d - 1j * e) / w) / q), 0.2)
    each = [total - left([p for p in parts if p is not own])[0] for own in parts]
    five = [np.imag(change / q) / slope for change in (-1j * w, w**0, -1j * w**0, 1 / w, -1j / w)]
    return np.column_stack(each), np.column_stack(five)


def noncentrality(drawn: sea.Drawn) -> dict[str, float]:
    """Compute the squared size of each effect in standard errors, with the others and the coefficients refitted."""
    each, five = signals(drawn)
    white = whitened(drawn.world, np.column_stack([each, five]))
    squares = {}
    for k, name in enumerate(drawn.truth):
        others = np.delete(white, k, axis=1)
        fitted, *_ = np.linalg.lstsq(others, white[:, k], rcond=1e-10)
        squares[name] = float(np.sum((white[:, k] - others @ fitted) ** 2))
    return squares


def power(square: float, freedom: int, score: float) -> float:
    """Compute the probability that the statistic of an effect exceeds the threshold of a normal score."""
    return float(ncx2.sf(chi2.isf(norm.sf(score), freedom), freedom, max(square, 1e-9)))


def row(kind: str, index: int, seed: int, *, red: bool) -> dict:
    """Compute the power for each effect of one mooring, as a hypothesis that is known or found by a search."""
    drawn, wanted = bench.draw(kind, index, seed, red=red)
    freedom = {name: len(set(values) - {"date_s"}) for name, values in drawn.truth.items()}
    slow = drawn.world.slow_water
    power_of = {
        name: [power(square, freedom[name], score) for score in (KNOWN, SEARCHED)]
        for name, square in noncentrality(drawn).items()
    }
    return {
        "kind": kind, "index": index, "size": max(wanted.values()), "power": power_of, "visible": drawn.visible_deg,
        "veer_deg": 0.0 if slow is None else slow.veer_deg,
    }  # fmt: skip


def report(kind: str, rows: list[dict]) -> None:
    for size in bench.SIZES[kind]:
        some = [row["power"] for row in rows if row["size"] == size]
        if not some:
            continue
        both = np.mean([np.prod(list(each.values()), axis=0) for each in some], axis=0)
        print(f"| {kind}, {size} each, n = {len(some)}: all effects within reach | {text(both)} |")
        for name in dict.fromkeys(name for each in some for name in each):
            own = [each[name] for each in some if name in each]
            print(f"| - {name}, n = {len(own)} | {text(np.mean(own, axis=0))} |")


def text(share) -> str:
    return " | ".join(f"{100 * x:.0f} %" for x in share)


# Comparison with the engine.


def beside(rows: list[dict], found: list[dict]) -> bool:
    """Print the engine's detections and the upper bound; return False if the shortfall is too large."""
    engine = {row["index"]: row for row in found if row["kind"] == "single"}
    joined = [(row, engine[row["index"]]) for row in rows if row["kind"] == "single" and row["index"] in engine]
    for row, own in joined:
        if set(row["power"]) != set(own["truth"]) or not np.isclose(row["size"], own["size"]):
            sys.exit(f"index {row['index']}: expected {list(row['power'])}, the engine's row has {list(own['truth'])}")
    joined = [both for both in joined if all(both[0]["visible"][x] > 0.8 * both[0]["size"] for x in both[0]["power"]
                                             if x in sea.STRONGEST)]  # fmt: skip
    targets.head("one effect", "known beforehand", "found by a search", "the engine", "short by, points", "target")
    good = []
    for size in bench.SIZES["single"]:
        some = [both for both in joined if both[0]["size"] == size]
        good.append(compared(f"{size}, all", some))
        for low, high in itertools.pairwise(VEERS_DEG):
            veering = [both for both in some if low <= both[0]["veer_deg"] < high]
            compared(f"{size}, slow veer {low:g} to {high:g}", veering)
        for name in bench.SINGLES:
            compared(f"{size}, {name}", [both for both in some if name in both[0]["power"]])
    return all(good)


def compared(what: str, joined: list[tuple[dict, dict]]) -> bool:
    """Print one line; return False if the interval of the engine's shortfall lies above the target."""
    if not joined:
        return True
    reach = np.array([next(iter(row["power"].values())) for row, _ in joined])
    seen = np.array([bench.detected(own) for _, own in joined])
    short = targets.mean(what, reach[:, 1] - seen, most=MISSED, times=100.0)
    targets.line(what, text(reach.mean(axis=0)), targets.share_of(seen), short.value, short.verdict)
    return short.held


# Held-out days.


def held_out(kind: str, index: int, seed: int) -> dict:
    """Compute size and slope of one named effect on held-out days, or the rank of their gain without an effect.

    Half of the records are in slow water. In records without an effect, days are held out although none is named.
    """
    own = 100_000 * seed + 70_000 + 10_000 * (kind == "null") + index
    rng = np.random.default_rng(own)
    slow, z = sea.some_slow_water(rng) if index % 2 else None, rng.uniform(SMALLEST_Z, LARGEST_Z)
    names = [name for name in bench.SINGLES if name != "current_veer"]  # no days are held out for the current
    name, size, row = names[index // 2 % len(names)], 2.0, {"kind": kind, "index": index}

    def drawn(wanted: dict[str, float]) -> sea.Drawn:
        return sea.planted(sea.make(own, wide=index % 3 == 2, n=HELD_OUT_HOURS, slow_water=slow), wanted)

    if kind == "planted":
        for _ in range(2):
            size *= z / np.sqrt(noncentrality(drawn({name: size}))[name])
        made = drawn({name: size})
        row |= {"effect": name, "z": np.sqrt(noncentrality(made)[name]), "visible_deg": made.visible_deg[name]}
    else:
        made = drawn({})
    found = inference.infer(bench.bare_state(made), odds=1.0)
    if kind == "null":
        fold = blocks_by_count(found.state.case.time_s, finding.FOLDS)
        proof = heldout.refit_folds(found, design.refit(found.state, []), fold, SURROGATES)
        return row | {"rank_p": proof["placebo"].rank_p}
    terms = found.state.simulation.terms
    row |= {"named": [term.name for term in terms], "slope": None}
    if not terms:
        return row
    k = next((k for k, term in enumerate(terms) if term.name == name), 0)
    without = design.refit(found.state, [term for j, term in enumerate(terms) if j != k])
    proof = heldout.cross_validate(found, k, without, 0)
    return row | {"amplitude": vars(proof.amplitude), "slope": proof.slope and vars(proof.slope)}


def left_out(rows: list[dict]) -> int:
    """Print the statistics of slopes and ranks, and return the exit status."""
    planted, nulls = ([row for row in rows if row["kind"] == kind] for kind in ("planted", "null"))
    within = [row for row in planted if SMALLEST_Z <= row["z"] <= LARGEST_Z]
    given = [row for row in within if row["slope"]]
    value, low, high = (np.array([row["slope"][key] for row in given]) for key in ("value", "low", "high"))
    covered = {
        right: [
            row["amplitude"]["low"] <= row["visible_deg"] <= row["amplitude"]["high"]
            for row in given
            if (row["effect"] in row["named"]) == right
        ]
        for right in (True, False)
    }
    ranks = np.array([row["rank_p"] for row in nulls])
    spread = ranks - np.random.default_rng(0).uniform(size=len(ranks)) / (
        1 + SURROGATES
    )  # ranks are discrete, hence they are spread uniformly
    print(f"\n{len(within)} of {len(planted)} effects are of 4 to 8 standard errors; a slope is given for {len(given)}")
    tested = kstest(spread, "uniform")
    print(
        f"ranks of {len(ranks)} records without an effect: Kolmogorov-Smirnov {tested.statistic:.3f}, "
        f"p = {tested.pvalue:.2f}"
    )
    return targets.report([
        targets.mean("slope, mean", value, least=0.95, most=1.05),
        targets.share("interval of the slope covers 1", (low <= 1.0) & (high >= 1.0), least=0.93, most=0.97),
        targets.share("interval of the size covers the planted one, rightly named", covered[True], least=0.95),
        targets.share("the same, named as another effect", covered[False]),
        targets.share("the planted effect is named", [row["effect"] in row["named"] for row in within]),
        targets.share("rank of 0.05 or less without an effect", ranks <= 0.05 + 1e-9, most=0.08),
        targets.limit("ranks are uniform: 1 - p", 1.0 - tested.pvalue, most=0.95),
    ])  # fmt: skip


def main() -> None:
    parser = targets.parser(__doc__, 44, ("single", "two"), red=True, rows=True)
    parser.add_argument("--engine", type=Path, help="rows of discrepancy.py, by the same seed")
    parser.add_argument("--heldout", type=Path, help="file for rows of the trial of held-out days, as of --rows")
    asked = parser.parse_args()
    if asked.heldout:
        wanted = [("planted", k) for k in range(asked.count)] + [("null", k) for k in range(NULLS)]
        trial = {"seed": asked.seed}
        rows = targets.resumed(asked.heldout, trial, wanted, lambda kind, index: held_out(kind, index, asked.seed))
        sys.exit(left_out(rows))
    kinds, run = (asked.kind,) if asked.kind else ("single", "two"), {"seed": asked.seed, "red": asked.red}
    wanted = [(kind, index) for kind in kinds for index in range(asked.count)]
    rows = targets.resumed(asked.rows, run, wanted, lambda kind, index: row(kind, index, asked.seed, red=asked.red))
    targets.head("planted, 1 % of false alarms", "known beforehand", "found by a search")
    for kind in kinds:
        report(kind, [one for one in rows if one["kind"] == kind])
    if asked.engine is not None:
        found = targets.rows_of(asked.engine, run)
        sys.exit(0 if beside(rows, found) else 1)


if __name__ == "__main__":
    main()
