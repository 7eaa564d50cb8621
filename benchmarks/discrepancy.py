"""Score of the search for unmodelled effects on new simulated moorings of one year, hourly (tests/world/pairs.py).

    python benchmarks/discrepancy.py 300 1 --kind null     one kind: null, single, two, unknown, control, clock, limit
    python benchmarks/discrepancy.py 100 1 --rows PATH     with one line of JSON per mooring; an interrupted run resumes

Visible sizes are residuals after a fit of five coefficients. The reference's compass has errors of its own, and every
other reference logs its heading. It uses one core.
"""

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


def rms(values) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def covered(row: dict) -> bool:
    names = {name for one in row["sets"] for name in one}
    return set(row["truth"]) <= names


def report(rows: list[dict]) -> int:
    """Print the score; return 1 if any target is outside its interval."""
    # Some effects are limited to plausible sizes; moorings whose effect is smaller than requested are left out.
    rows = [r for r in rows if all(r["visible"][x] > 0.8 * r["size"] for x in r["truth"] if x in sea.STRONGEST)]
    kind = {name: [row for row in rows if row["kind"] == name] for name in KINDS}
    of_size = lambda name, size: [row for row in kind[name] if row["size"] == size]  # noqa: E731
    table, nulls = targets.Report(), kind["null"]
    table.share("nulls: P(compass) + P(clock) at least 1/2", map(accused, nulls), most=0.01)
    table.share("nulls called unexplained", map(unexplained, nulls), most=0.02)
    table.share("nulls with any name", (r["sets"] for r in nulls))
    for size in SIZES["single"]:
        what, some = f"single {size}", of_size("single", size)
        seen = [r for r in some if detected(r)]
        alone = [r for r in seen if named_alone(r)]
        table.share(f"{what}: P of the truth's side at least 1/2", map(detected, some))
        table.share(f"{what}: truth in the set, where detected", map(covered, seen), least=0.97)
        table.share(f"{what}: right where one name is given", map(covered, alone), least=0.97)
        table.share(f"{what}: family right where one name is given", map(family, alone), least=0.99)
        names = np.mean([sum(map(len, r["sets"])) for r in seen or [{"sets": []}]])
        table.note(f"{what}: names in a set, mean", f"{names:.2f}")
        table.share(f"{what}: unexplained beside or instead", map(unexplained, some))
    reliability(table, nulls + kind["single"] + kind["two"])
    for name in SINGLES:
        each = [[r for r in of_size("single", size) if name in r["truth"]] for size in SIZES["single"]]
        shares = ", ".join(targets.share_of(map(detected, some)) for some in each)
        table.note(f"- {name}: detected at {SIZES['single']}", shares)
    clocks = [r for r in kind["clock"] if covered(r)]
    table.share("clocks: named", map(covered, kind["clock"]))
    table.share("clocks: nothing else named", (len(r["sets"]) == 1 for r in clocks))
    at = [r for r in kind["limit"] if r.get("limit", 0.0) is not None]
    table.share("at the stated limit: P of the side at least 1/2", map(detected, at), least=0.85, most=0.95)
    table.share("moorings without a limit of an effect", (r not in at for r in kind["limit"]), most=0.2)
    for size in SIZES["two"]:
        each = map(covered, of_size("two", size))
        table.share(f"two effects, {size} each: set covers both", each, least=0.9 * (size == 3.0))
    for size in SIZES["unknown"]:
        what, some = f"out of the catalogue, {size}", of_size("unknown", size)
        table.share(f"{what}: unexplained or composed", map(strange, some), least=0.9 * (size == 3.0))
        table.share(f"{what}: a bare name", (r["sets"] and not strange(r) for r in some), most=0.05)
    shifted, noisy = ([r for r in kind["control"] if bool(r["truth"]) == x] for x in (True, False))
    firsts, anywhere = ([["temperature" in one[:n] for one in r["sets"]] for r in shifted] for n in (1, None))
    table.share("shifted covariate: temperature named", map(any, firsts), most=0.05)
    table.share("shifted covariate: temperature among the names", map(any, anywhere))
    table.share("doubled noise: named", (r["sets"] for r in noisy), most=0.02)
    oracle(table, nulls, "nulls")
    oracle(table, kind["single"] + kind["two"], "singles and pairs")
    if rows:
        times = [r["seconds"] for r in rows]
        table.note("seconds a mooring: 95 %, most", f"{np.quantile(times, 0.95):.1f}, {max(times):.1f}")
        table.add(targets.limit("seconds a mooring, median", float(np.median(times)), most=6.0))
    return int(table.missed)


def unexplained(row: dict) -> bool:
    return row["left"] is not None


def named_alone(row: dict) -> bool:
    """Return whether one name was given, with nothing unexplained beside it."""
    return [len(one) for one in row["sets"]] == [1] and not unexplained(row)


def strange(row: dict) -> bool:
    """Return whether a mismatch outside the catalogue was found, unexplained or composed."""
    return unexplained(row) or any(one[0].startswith("composed") for one in row["sets"])


def accused(row: dict) -> bool:
    """Return whether the probability of a fault of the compass or a clock is at least 1/2."""
    return row["sides"].get("compass", 0.0) + row["sides"].get("clock", 0.0) >= 0.5


def detected(row: dict) -> bool:
    """Return whether the probability of the true side is at least 1/2."""
    return any(row["sides"].get(SIDES[name], 0.0) >= 0.5 for name in row["truth"])


def reliability(table: targets.Report, rows: list[dict]) -> None:
    """Print the share of correct names, first or alternative, by their stated probability."""
    told = [
        (p, name in (r["truth"] or QUIET)) for r in rows for one in r["probability"] for name, p in one.items()
    ]  # fmt: skip
    for low, high in itertools.pairwise((0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.01)):
        some = [(p, right) for p, right in told if low <= p < high]
        if some:
            what = f"effects named with {100 * np.mean([p for p, _ in some]):.0f} % on average: correct"
            table.share(what, (right for _, right in some))


def oracle(table: targets.Report, rows: list[dict], what: str) -> None:
    """Print heading errors beside those of the true model, and the errors of parameters."""
    rows = [r for r in rows if "error_oracle" in r]
    covers = [r["covered"] for r in rows]
    table.add(targets.mean(f"{what}: headings within 95 %", covers, least=0.93, most=0.97, percent=True))
    worse = (r["error_after"] > r["error_plain"] + 0.1 for r in rows)
    table.share(f"{what}: headings worse than by the fit alone by over 0.1 degree", worse, most=0.05)
    made = [r for r in rows if set(r["truth"]) <= set(PRODUCT)]
    for name, some in (("all", made), ("applied", [r for r in made if r["applied"]])):
        errors = [rms([r[k] for r in some]) for k in ("error_before", "error_after", "error_oracle")]
        shown = ", ".join(f"{x:.2f}" for x in errors)
        table.note(f"true heading error before, after, oracle, rms ({name})", shown, "<= oracle + 0.3")
        near = (r["error_after"] <= r["error_oracle"] + 0.3 for r in some)
        table.share(f"after <= oracle + 0.3 ({name})", near)
    for size in (1.5, 3.0):
        z = [z for r in rows if r["size"] == size and len(r["truth"]) == 1 for z in r["z"]]
        square = f"parameter z of single effects, mean square at {size}"
        table.add(targets.mean(square, np.square(z), least=0.9**2, most=1.1**2))


def family(row: dict) -> bool:
    names = {sea.FAMILIES.get(name) for one in row["sets"] for name in one}
    return {sea.FAMILIES[name] for name in row["truth"]} <= names


def main() -> None:
    parser = targets.parser(__doc__, 60, KINDS, rows=True)
    parser.add_argument("--red", action="store_true", help="the water of the two depths differs for days to seasons")
    asked = parser.parse_args()
    rows = targets.resumed(asked, KINDS, lambda *one: measure(*one, asked.seed, red=asked.red), red=asked.red)
    sys.exit(report(rows))


if __name__ == "__main__":
    main()
