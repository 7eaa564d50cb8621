"""Score of the search for unmodelled effects on new simulated moorings of one year, hourly (tests/world/pairs.py).

    python benchmarks/discrepancy.py 300 1 --kind null     one kind: null, single, two, unknown, control, clock, limit
    python benchmarks/discrepancy.py 100 1 --rows PATH     with one line of JSON per mooring; an interrupted run resumes

Visible sizes are residuals after a fit of five coefficients. The reference's compass has errors of its own, and every
other reference logs its heading. It uses one core.
"""

from __future__ import annotations

import itertools
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import targets

from compasslib import angles, compass
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.deviation.model import DeviationFit, nearest_root, pair_speeds
from compasslib.effects import CATALOGUE, SIDES, side_of
from compasslib.inference import design, diagnosis, product
from compasslib.inference.comparison import Options, compare_pairs
from compasslib.inference.kinds.mooring import diagnose
from compasslib.preparation import water
from compasslib.records import EarthField, SlowShear
from tests.world import pairs as sea

QUIET = ("current_shear_slow", "reference_deviation")  # correct findings if no effect was planted
KINDS = ("null", "single", "two", "unknown", "control", "clock", "limit")
SIZES = {"control": (3.0, 0.0), "clock": (0.0,), "null": (0.0,), "limit": (0.0,)}
SIZES |= dict.fromkeys(("single", "two", "unknown"), (1.5, 3.0))
SINGLES = tuple(x for x in sea.SINGLES if sea.FAMILIES[x] != "clock")
LISTED = tuple(name for name in SINGLES if side_of(name) == "compass")
BINS, SPREAD = 6, 0.4  # bins of a profile, and spread of the logarithm of the shear between them (eh2, papa: 1.5 x)
PRODUCT = (
    *("heeling", "hard_iron_drift", "compass_drift", "hard_iron_step", "heading_slip", "supply_voltage", "temperature"),
    *("sextantal", "octantal", "compass_lag"),
)


def draw(
    kind: str, index: int, seed: int, *, red: bool = False, given: dict[str, float] | None = None
) -> tuple[sea.Drawn, dict[str, float]]:
    """Draw one mooring, in slowly veering water if ``red``, and its requested effects with their sizes, degrees.

    Args:
        given: effects of a kind that plants none by itself.
    """
    own = 100_000 * seed + 1000 * KINDS.index(kind) + index
    size = SIZES[kind][index % len(SIZES[kind])]
    turn, wide = index // len(SIZES[kind]), index % 3 == 2
    noise = 24.0 if kind == "control" and not size else 12.0
    slow = sea.some_slow_water(np.random.default_rng(own)) if red else None
    world = sea.make(own, wide=wide, noise_deg=noise, slow_water=slow)
    wanted = dict(given or {})
    if kind == "single":
        wanted = {SINGLES[turn % len(SINGLES)]: size}
    elif kind == "clock":
        wanted = {("clock_offset", "clock_drift")[index % 2]: 1.0}
    elif kind == "two":
        wanted = dict.fromkeys(two(world.rng), size)
    elif kind == "unknown":
        wanted = {sea.UNKNOWN[turn % len(sea.UNKNOWN)]: size}
    elif kind == "control" and size:
        wanted = {"temperature": size}
    drawn = sea.planted(world, wanted)
    if slow:
        drawn = in_slow_water(drawn, slow, world, profiled=False)
    if kind == "control" and size:  # the logged temperature is not the cause
        drawn.covariates["temperature"] = np.roll(drawn.covariates["temperature"], 24 * world.rng.integers(50, 110))
    return drawn, wanted


def in_slow_water(drawn: sea.Drawn, slow: sea.SlowWater, world: sea.World, *, profiled: bool) -> sea.Drawn:
    """State the turn of slow water over the record, and its shear if the affected instrument is a profiler."""
    shown = {"slow_shear": profile(slow, world)} if profiled else {}
    return replace(drawn, pairs=replace(drawn.pairs, veer_deg=mean_veer(slow, world.flow), **shown))


def profile(slow: sea.SlowWater, world: sea.World) -> SlowShear | None:
    """Estimate slow water from the bins of the affected instrument, whose shear is like that over the same distance."""
    rng = np.random.default_rng([int(world.time_s[0]), 1])
    between = np.array([rng.lognormal(0.0, SPREAD) * slow.beside(rng, world.flow) for _ in range(BINS)])
    across = np.imag(between * np.conj(world.flow) / np.abs(world.flow))
    across += rng.normal(0.0, world.noise[2], across.shape)
    return water.fit_slow_shear(world.time_s, across, np.ones(across.shape, dtype=bool))


def mean_veer(slow: sea.SlowWater, flow: np.ndarray) -> float:
    """Compute the standard deviation of the mean turn over a record between the depths, degrees."""
    days = len(flow) / 24.0

    def of_mean(memory: float) -> float:  # of first-order noise with unit standard deviation
        return np.sqrt(2.0 * memory / days * (1.0 - memory / days * (1.0 - np.exp(-days / memory))))

    shear_deg = np.rad2deg(slow.shear_m_s / np.median(np.abs(flow)))
    return float(np.hypot(slow.veer_deg * of_mean(slow.veer_days), shear_deg * of_mean(slow.shear_days)))


def referred(drawn: sea.Drawn, index: int, seed: int) -> sea.Drawn:
    """Turn the reference by the errors of an ordinary compass; every other reference logs its heading."""
    rng = np.random.default_rng([seed, index])
    errors = rng.normal(size=3) * sea.reference_sizes((drawn.horizontal, drawn.vertical))
    return sea.refer(drawn, errors, rng, logged=index % 2 == 0)


def two(rng) -> list[str]:
    while True:
        pair = rng.choice(sea.TWO, 2, replace=False).tolist()
        if sea.FAMILIES[pair[0]] != sea.FAMILIES[pair[1]]:
            return pair


def field_of(drawn: sea.Drawn) -> EarthField:
    zero, one = np.zeros(2), np.ones(2)
    return EarthField(drawn.pairs.time_s[[0, -1]], zero, drawn.horizontal * one, drawn.vertical * one, zero)


def fitted(drawn: sea.Drawn) -> DeviationFit:
    """Fit the deviation, starting near the truth, as the search for the correct branch is not tested here."""
    _, coefficients = sea.five_term_residual(drawn.pairs.heading_deg, drawn.heading)
    near = DeviationFit("exact", len(drawn.pairs), coefficients, heading_density=np.full(120, 1 / 120))
    return fit_deviation("exact", drawn.pairs, near)


def measure(kind: str, index: int, seed: int, *, red: bool = False) -> dict:
    """Diagnose one mooring and return its row of the score."""
    drawn, wanted = draw(kind, index, seed, red=red)
    drawn = referred(drawn, index, seed)
    if kind == "limit":  # an effect at the limit that the same mooring states without it
        name = LISTED[index % len(LISTED)]
        *_, before, row = diagnosed(drawn, 0.0)
        limit = before.detectable_deg.get(name)
        if limit is None:
            return row | {"kind": kind, "index": index, "limit": None}
        drawn, wanted = draw(kind, index, seed, red=red, given={name: limit})
        drawn = referred(drawn, index, seed)
    fit, field, found, row = diagnosed(drawn, max(wanted.values(), default=0.0))
    if found.current and "current_veer" in drawn.truth:  # otherwise it describes the slow shear of the simulation
        row["sets"].append(["current_veer"])
    row |= {"kind": kind, "index": index, "applied": bool(found.applied)}
    scored = kind in ("null", "single", "two") and set(drawn.truth) <= {*PRODUCT, "current_veer"}
    return row | against_oracle(drawn, fit, field, found) if scored and found.verdict != "insufficient" else row


def diagnosed(drawn: sea.Drawn, size: float, options: Options | None = None) -> tuple:
    """Diagnose a recording with effects of a requested size; return fit, field, diagnosis, and what its row says."""
    fit, field = fitted(drawn), field_of(drawn)
    begin = time.perf_counter()
    found = diagnose(drawn.pairs, drawn.covariates, fit, field, options or Options())
    left = found.unexplained
    return fit, field, found, {
        "truth": drawn.truth, "size": size, "visible": drawn.visible_deg, "verdict": found.verdict,
        "sets": [[one.named, *one.alternatives] for one in found.findings], "seconds": time.perf_counter() - begin,
        "left": None if left is None else [left.covariates, left.rms_effect_deg], "sides": found.sides,
        "probability": [{one.named: one.probability, **one.alternatives_probability} for one in found.findings],
    }  # fmt: skip


def against_oracle(drawn, fit, field, found) -> dict:
    """Compute heading errors, coverage and parameter errors, and the heading error of the true model after a fit."""
    case = compare_pairs(drawn.pairs, drawn.covariates, fit, field)
    empty = design.evaluate_model(case, case.simulation, np.zeros(case.nuisance.shape[1]))
    oracle = design.refit(empty, [true_term(name, values) for name, values in drawn.truth.items()])
    level = compass.inverse(fit.coefficients, drawn.pairs.heading_deg)
    made, bare = corrected(drawn, fit, field, found)
    off = angles.difference(made.heading_deg, drawn.heading)
    return {
        "error_before": error(nearest_root(level, drawn.heading), drawn),
        "error_oracle": error(oracle.heading_deg, drawn),
        "error_after": angles.rms(off),
        "error_plain": error(bare.heading_deg, drawn),
        "covered": float(np.nanmean(np.abs(off) < 1.96 * made.sigma_deg)),
        "z": errors_over_sigma([one for one in found.findings if not one.alternatives], drawn.truth),
    }


def errors_over_sigma(findings, truth) -> list[float]:
    """Compute the errors of the parameters of findings on planted effects in their own standard errors."""
    return [
        (one.parameters[name].value - value) / one.parameters[name].sigma
        for one in findings
        for name, value in truth.get(one.effect, {}).items()
        if name in one.parameters
    ]


def corrected(drawn, fit, field, found) -> tuple:
    """Correct the headings by the diagnosed product, and by the fit alone."""
    pairs, zero = drawn.pairs, np.zeros(len(drawn.pairs))
    readings = readings_at_pairs(pairs)
    record = SimpleNamespace(
        time_s=pairs.time_s, heading_deg=pairs.heading_deg, heading_quality=zero, pitch_deg=pairs.pitch_deg,
        roll_deg=pairs.roll_deg,
    )  # fmt: skip
    speed, _ = pair_speeds(pairs)
    series = {**drawn.covariates, "depth": pairs.upper_depth_m, "speed": speed}
    at = product.compass_along_record(diagnosis.product_of_diagnosis(fit, found), record, field, series)
    made = correct_headings(readings, fit if found.fit is None else found.fit, pairs, at)
    return made, correct_headings(readings, fit, pairs)


def true_term(name: str, values: dict[str, float]):
    kind = next(k for k in CATALOGUE if k.name == name and set(values) - {"date_s"} <= set(k.fitted()))
    return kind(**values)


def error(heading, drawn) -> float:
    return angles.rms(angles.difference(heading, drawn.heading))


def held(what: str, values, *, most: float = 1.0, least: float = 0.0) -> bool:
    """Print a share with its target; return False if the interval excludes the target."""
    return told(targets.share(what, values, least=least, most=most))


def told(one: targets.Measured) -> bool:
    """Print a measure unless it has no data; return False if its target is missed."""
    line(one.what, one.value, one.verdict)
    return one.held


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def covered(row: dict) -> bool:
    names = {name for one in row["sets"] for name in one}
    return set(row["truth"]) <= names


def line(what: str, value: str, target: str = "") -> None:
    if not value.startswith(("–", "nan")):
        targets.line(what, value, target)


def report(rows: list[dict]) -> bool:
    """Print the score; return False if any target is outside its interval."""
    # Some effects are limited to plausible sizes; moorings whose effect is smaller than requested are left out.
    rows = [r for r in rows if all(r["visible"][x] > 0.8 * r["size"] for x in r["truth"] if x in sea.STRONGEST)]
    kind = {name: [row for row in rows if row["kind"] == name] for name in KINDS}
    targets.head("measure", "value", "target")
    nulls = kind["null"]
    good = [
        held("nulls: P(compass) + P(clock) at least 1/2", map(accused, nulls), most=0.01),
        held("nulls called unexplained", (r["left"] is not None for r in nulls), most=0.02),
    ]
    line("nulls with any name", targets.share_of(bool(r["sets"]) for r in nulls))
    for size in SIZES["single"]:
        some = [r for r in kind["single"] if r["size"] == size]
        seen = [r for r in some if detected(r)]
        alone = [r for r in seen if len(r["sets"]) == 1 and len(r["sets"][0]) == 1 and r["left"] is None]
        what = f"single {size}: P of the truth's side at least 1/2"
        line(what, targets.share_of(map(detected, some)))
        good.append(held(f"single {size}: truth in the set, where detected", map(covered, seen), least=0.97))
        good.append(held(f"single {size}: right where one name is given", map(covered, alone), least=0.97))
        good.append(held(f"single {size}: family right where one name is given", map(family, alone), least=0.99))
        names = np.mean([sum(map(len, r["sets"])) for r in seen or [{"sets": []}]])
        line(f"single {size}: names in a set, mean", f"{names:.2f}")
        line(f"single {size}: unexplained beside or instead", targets.share_of(r["left"] is not None for r in some))
    reliability(nulls + kind["single"] + kind["two"])
    for name in SINGLES:
        some = [r for r in kind["single"] if name in r["truth"]]
        each = [targets.share_of(detected(r) for r in some if r["size"] == size) for size in SIZES["single"]]
        line(f"- {name}: detected at {SIZES['single']}", ", ".join(each))
    clock = kind["clock"]
    line("clocks: named", targets.share_of(covered(r) for r in clock))
    line("clocks: nothing else named", targets.share_of(len(r["sets"]) == 1 for r in clock if covered(r)))
    at = [r for r in kind["limit"] if r.get("limit", 0.0) is not None]
    good.append(held("at the stated limit: P of the side at least 1/2", map(detected, at), least=0.85, most=0.95))
    good.append(held("moorings without a limit of an effect", (r not in at for r in kind["limit"]), most=0.2))
    for size in SIZES["two"]:
        some = [r for r in kind["two"] if r["size"] == size]
        good.append(held(f"two effects, {size} each: set covers both", map(covered, some), least=0.9 * (size == 3.0)))
    for size in SIZES["unknown"]:
        some = [r for r in kind["unknown"] if r["size"] == size]
        seen, bare = ([each(r) for r in some] for each in (strange, bare_name))
        good.append(held(f"out of the catalogue, {size}: unexplained or composed", seen, least=0.9 * (size == 3.0)))
        good.append(held(f"out of the catalogue, {size}: a bare name", bare, most=0.05))
    shifted, noisy = ([r for r in kind["control"] if bool(r["truth"]) == x] for x in (True, False))
    named = [any(one[0] == "temperature" for one in r["sets"]) for r in shifted]
    good.append(held("shifted covariate: temperature named", named, most=0.05))
    among = targets.share_of(any("temperature" in one for one in r["sets"]) for r in shifted)
    line("shifted covariate: temperature among the names", among)
    good.append(held("doubled noise: named", (bool(r["sets"]) for r in noisy), most=0.02))
    good.append(oracle(nulls, "nulls"))
    good.append(oracle(kind["single"] + kind["two"], "singles and pairs"))
    if rows:
        times = [r["seconds"] for r in rows]
        line("seconds a mooring: 95 %, most", f"{np.quantile(times, 0.95):.1f}, {max(times):.1f}")
        good.append(told(targets.limit("seconds a mooring, median", float(np.median(times)), most=6.0)))
    return all(good)


def strange(row: dict) -> bool:
    """Return whether a mismatch outside the catalogue was found, unexplained or composed."""
    return row["left"] is not None or any(name.startswith("composed") for one in row["sets"] for name in one[:1])


def bare_name(row: dict) -> bool:
    """Return whether only effects of the catalogue were named."""
    return bool(row["sets"]) and not strange(row)


def accused(row: dict) -> bool:
    """Return whether the probability of a fault of the compass or a clock is at least 1/2."""
    return row["sides"].get("compass", 0.0) + row["sides"].get("clock", 0.0) >= 0.5


def detected(row: dict) -> bool:
    """Return whether the probability of the true side is at least 1/2."""
    return any(row["sides"].get(SIDES[name], 0.0) >= 0.5 for name in row["truth"])


def reliability(rows: list[dict]) -> None:
    """Print the share of correct names, first or alternative, by their stated probability."""
    told = [
        (p, name in (r["truth"] or QUIET)) for r in rows for one in r["probability"] for name, p in one.items()
    ]  # fmt: skip
    for low, high in itertools.pairwise((0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.01)):
        some = [(p, right) for p, right in told if low <= p < high]
        if some:
            what = f"effects named with {100 * np.mean([p for p, _ in some]):.0f} % on average: correct"
            line(what, targets.share_of(right for _, right in some))


def oracle(rows: list[dict], what: str) -> bool:
    rows = [r for r in rows if "error_oracle" in r]
    if not rows:
        return True
    covers = [r["covered"] for r in rows]
    within = targets.mean(f"{what}: headings within 95 %", covers, least=0.93, most=0.97, unit=" %", times=100.0)
    good = told(within)
    worse = (r["error_after"] > r["error_plain"] + 0.1 for r in rows)
    good &= held(f"{what}: headings worse than by the fit alone by over 0.1 degree", worse, most=0.05)
    made = [r for r in rows if set(r["truth"]) <= set(PRODUCT)]
    for name, some in (("all", made), ("applied", [r for r in made if r["applied"]])):
        errors = [rms([r[k] for r in some]) for k in ("error_before", "error_after", "error_oracle")]
        shown = ", ".join(f"{x:.2f}" for x in errors)
        line(f"true heading error before, after, oracle, rms ({name})", shown, "<= oracle + 0.3")
        near = targets.share_of(r["error_after"] <= r["error_oracle"] + 0.3 for r in some)
        line(f"after <= oracle + 0.3 ({name})", near)
    for size in (1.5, 3.0):
        z = [z for r in rows if r["size"] == size and len(r["truth"]) == 1 for z in r["z"]]
        if z:
            square = f"parameter z of single effects, mean square at {size}"
            good &= told(targets.mean(square, np.square(z), least=0.9**2, most=1.1**2))
    return bool(good)


def family(row: dict) -> bool:
    names = {sea.FAMILIES.get(name) for one in row["sets"] for name in one}
    return {sea.FAMILIES[name] for name in row["truth"]} <= names


def main() -> None:
    parser = targets.parser(__doc__, 60, KINDS, red=True, rows=True)
    asked = parser.parse_args()
    kinds = KINDS if asked.kind is None else (asked.kind,)
    wanted = [(kind, index) for kind in kinds for index in range(asked.count)]
    run = {"seed": asked.seed, "red": asked.red}
    rows = targets.resumed(asked.rows, run, wanted, lambda kind, index: measure(kind, index, asked.seed, red=asked.red))
    sys.exit(0 if report(rows) else 1)


if __name__ == "__main__":
    main()
