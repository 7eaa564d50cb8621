"""Score of the search for unmodelled effects on new simulated moorings of one year, hourly (tests/world/pairs.py).

    python benchmarks/discrepancy.py 300 1 --kind null     one kind: null, single, two, unknown, control, clock
    python benchmarks/discrepancy.py 100 1 --rows PATH     with one line of JSON per mooring; an interrupted run resumes

Visible sizes are residuals after a fit of five coefficients. The reference's compass has errors of its own, and every
other reference logs its heading. It uses one core. Detection limits and stated probabilities are those of the sealed
proof (benchmarks/proof), which is another simulation.
"""

import sys
import time
from types import SimpleNamespace

import numpy as np
import targets

from compasslib import angles
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.deviation.model import DeviationFit, pair_speeds
from compasslib.effects import SIDES, side_of
from compasslib.inference import diagnosis, product
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.inference.kinds.mooring import diagnose
from compasslib.records import EarthField
from tests.world import pairs as sea

KINDS = ("null", "single", "two", "unknown", "control", "clock")
SIZES = {"control": (3.0, 0.0), "clock": (0.0,), "null": (0.0,)}
SIZES |= dict.fromkeys(("single", "two", "unknown"), (1.5, 3.0))
SINGLES = tuple(x for x in sea.SINGLES if sea.FAMILIES[x] != "clock")
LISTED = tuple(name for name in SINGLES if side_of(name) == "compass")


def draw(kind: str, index: int, seed: int) -> tuple[sea.Drawn, dict[str, float]]:
    """Draw one mooring, and its requested effects with their sizes, degrees."""
    own = 100_000 * seed + 1000 * KINDS.index(kind) + index
    size = SIZES[kind][index % len(SIZES[kind])]
    turn, wide = index // len(SIZES[kind]), index % 3 == 2
    world = sea.make(own, wide=wide, noise_deg=24.0 if kind == "control" and not size else 12.0)
    wanted: dict[str, float] = {}
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
    if kind == "control" and size:  # the logged temperature is not the cause
        drawn.covariates["temperature"] = np.roll(drawn.covariates["temperature"], 24 * world.rng.integers(50, 110))
    return drawn, wanted


def referred(drawn: sea.Drawn, index: int, seed: int) -> sea.Drawn:
    """Turn the reference by the errors of an ordinary compass; half are vanes, half of which log headings."""
    rng = np.random.default_rng([seed, index])
    errors = rng.normal(size=3) * sea.reference_sizes((drawn.horizontal, drawn.vertical))
    return sea.refer(drawn, errors, rng, vane=index % 2 == 1, logged=index % 4 != 3)


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


def measure(kind: str, index: int, seed: int) -> dict:
    """Diagnose one mooring and return its row of the score."""
    drawn, wanted = draw(kind, index, seed)
    drawn = referred(drawn, index, seed)
    fit, field, found, row = diagnosed(drawn, max(wanted.values(), default=0.0))
    if found.current and "current_veer" in drawn.truth:  # otherwise it describes the slow shear of the simulation
        row["sets"].append(["current_veer"])
    row |= {"kind": kind, "index": index}
    if kind not in ("null", "single", "two") or found.verdict == "insufficient":
        return row
    z = errors_over_sigma([one for one in found.findings if not one.alternatives], drawn.truth)
    return row | heading_errors(drawn, fit, field, found) | {"z": z}


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
    }  # fmt: skip


def heading_errors(drawn: sea.Drawn, fit: DeviationFit, field: EarthField, found: Diagnosis) -> dict[str, float]:
    """Compute rms heading errors as recorded, by the fit alone and of the product, degrees, and its coverage."""
    made, bare = corrected(drawn, fit, field, found)
    off = angles.difference(made.heading_deg, drawn.heading)
    return {
        "error_recorded": error(drawn.pairs.heading_deg, drawn),
        "error_plain": error(bare.heading_deg, drawn),
        "error_after": error(made.heading_deg, drawn),
        "covered": float(np.nanmean(np.abs(off) < 1.96 * made.sigma_deg)),
        "centred": float(np.nanmean(np.abs(off - np.nanmean(off)) < 1.96 * made.sigma_deg)),
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
    table, nulls, clocks = targets.Report(), kind["null"], kind["clock"]
    table.share("nulls: P(compass) + P(clock) at least 1/2", map(accused, nulls), most=0.01)
    table.share("nulls called unexplained", map(unexplained, nulls), most=0.02)
    table.share("nulls with any name", (r["sets"] for r in nulls))
    for size in SIZES["single"]:
        what, some = f"single {size}", of_size("single", size)
        seen = [r for r in some if detected(r)]
        alone = [r for r in seen if [len(one) for one in r["sets"]] == [1] and not unexplained(r)]
        table.share(f"{what}: P of the truth's side at least 1/2", map(detected, some))
        table.share(f"{what}: truth in the set, where detected", map(covered, seen), least=0.97)
        table.share(f"{what}: right where one name is given", map(covered, alone), least=0.97)
        table.share(f"{what}: unexplained beside or instead", map(unexplained, some))
        for name in SINGLES:
            each = [r for r in some if name in r["truth"]]
            detection = f"{targets.share_of(map(detected, each))}; {targets.share_of(map(covered, each))}"
            table.note(f"- {name}, {size}: detected; in the set", detection)
        table.share(f"two effects, {size} each: set covers both", map(covered, of_size("two", size)),
                    least=0.9 * (size == 3.0))  # fmt: skip
        strangers = of_size("unknown", size)
        table.share(f"out of the catalogue, {size}: unexplained or composed", map(strange, strangers),
                    least=0.9 * (size == 3.0))  # fmt: skip
        bare = (r["sets"] and not strange(r) for r in strangers)
        table.share(f"out of the catalogue, {size}: a bare name", bare, most=0.05)
    table.share("clocks: named", map(covered, clocks))
    table.share("clocks: nothing else named", (len(r["sets"]) == 1 for r in clocks if covered(r)))
    shifted, noisy = ([r for r in kind["control"] if bool(r["truth"]) == x] for x in (True, False))
    warm = (any("temperature" in one[:1] for one in r["sets"]) for r in shifted)
    table.share("shifted covariate: temperature named", warm, most=0.05)
    table.share("doubled noise: named", (r["sets"] for r in noisy), most=0.02)
    headings(table, nulls, "nulls")
    headings(table, kind["single"] + kind["two"], "singles and pairs")
    if rows:
        table.add(targets.limit("seconds a mooring, median", float(np.median([r["seconds"] for r in rows])), most=6.0))
    return int(table.missed)


def unexplained(row: dict) -> bool:
    return row["left"] is not None


def strange(row: dict) -> bool:
    """Return whether a mismatch outside the catalogue was found, unexplained or composed."""
    return unexplained(row) or any(one[0].startswith("composed") for one in row["sets"])


def accused(row: dict) -> bool:
    """Return whether the probability of a fault of the compass or a clock is at least 1/2."""
    return row["sides"].get("compass", 0.0) + row["sides"].get("clock", 0.0) >= 0.5


def detected(row: dict) -> bool:
    """Return whether the probability of the true side is at least 1/2."""
    return any(row["sides"].get(SIDES[name], 0.0) >= 0.5 for name in row["truth"])


def headings(table: targets.Report, rows: list[dict], what: str) -> None:
    """Print heading errors, their coverage, and the errors of parameters."""
    rows = [r for r in rows if "error_after" in r]
    table.add(targets.mean(f"{what}: headings within 95 %", [r["covered"] for r in rows], least=0.93, most=0.97,
                           percent=True))  # fmt: skip
    worse = (r["error_after"] > r["error_plain"] + 0.1 for r in rows)
    table.share(f"{what}: headings worse than by the fit alone by over 0.1 degree", worse, most=0.05)
    errors = [rms([r[k] for r in rows]) for k in ("error_plain", "error_after")]
    table.note(f"{what}: true heading error of the fit and of the product, rms", ", ".join(f"{x:.2f}" for x in errors))
    for size in SIZES["single"]:
        z = [z for r in rows if r["size"] == size and len(r["truth"]) == 1 for z in r["z"]]
        square = f"parameter z of single effects, mean square at {size}"
        table.add(targets.mean(square, np.square(z), least=0.9**2, most=1.1**2))


def main() -> None:
    asked = targets.parser(__doc__, 60, KINDS, rows=True).parse_args()
    sys.exit(report(targets.resumed(asked, KINDS, lambda *one: measure(*one, asked.seed))))


if __name__ == "__main__":
    main()
