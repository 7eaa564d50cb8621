"""Coverage of the stated uncertainty of corrected headings where the reference's compass errs as well, by moorings.

    python benchmarks/headings.py 400 1 --kind plain --rows ROWS    one kind; an interrupted run resumes
    python benchmarks/headings.py 60 1 --cores 2                    every kind

Simulated half-years in plain and structured water (gridding.py) and windows of real records (injected.py) are corrected
without the search, moorings of discrepancy.py with it. All errors have the priors of the product: constant and iron of
the reference's compass, the constant of the affected one (4 degrees), and a mean veer by the water. Half of the
references log their heading, the others are vanes. As draws from the prior prove its arithmetic only, the reference's
errors are also drawn at half of it, at one and a half, and with the tails of Student's t. Each mooring is corrected
once more without the reference's errors and the mean veer, and compared with the uncertainty less their modes.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import partial

import discrepancy as bench
import injected
import numpy as np
import targets
from gridding import in_plain_water

from compasslib import angles
from compasslib.demo import adcp, sealed, water
from compasslib.deviation import fit_deviation
from compasslib.deviation.constant import find_constant_offset
from compasslib.deviation.correction import correct, record_readings, reference_modes
from compasslib.inference.comparison import Options
from compasslib.inference.conclusion import conclude
from compasslib.inference.diagnosis import insufficient
from compasslib.inference.kinds.mooring import diagnose
from compasslib.inference.product import compass_along_record
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.records import GOOD, CorrectedRecord, EarthField, Pairs, Record
from tests.world import pairs as sea

HOURS, OWN_DEG = 4400, 4.0  # length of a record; constant of the affected compass, one standard deviation
PRIORS = {"half the prior": 0.5, "1.5 times the prior": 1.5, "Student's tails": 1.0}
WATERS, REAL, SEARCHED = ("plain", "structured"), tuple(injected.GAPS), ("null", "single", "unknown")
KINDS = (*WATERS, *PRIORS, *REAL, *SEARCHED)
WANTED = {name: {"least": 0.93, "most": 0.97} for name in WATERS} | {"1.5 times the prior": {"least": 0.85}}


def record_of(time_s, heading_deg, tilt_deg, depth_m, flow, range_m) -> Record:
    """Compose the record of an instrument from recorded columns, (n,), and velocities, (n, m) m/s."""
    none, good = np.full(len(time_s), np.nan), np.ones(flow.shape, dtype=np.int8)
    columns = (flow.real, flow.imag, np.broadcast_to(range_m, flow.shape), heading_deg, *tilt_deg, none, depth_m)
    return Record(time_s, *columns, none, none, good, good[:, 0])


def simulated(kind: str, index: int, seed: int) -> sea.Drawn:
    """Simulate a mooring in plain or structured water, and find its pairs as the workflow does."""
    ground = sealed.make(seed, f"M{index:04d}", sealed.Wish(wide=index % 4 >= 2, hours=HOURS))
    ground = in_plain_water(ground) if kind == "plain" else ground
    rng, time_s, field = ground.random("coverage"), ground.stamp_s, ground.field
    top = sealed.read(ground, [], time_s, ground.random("readings"))
    noises, ranges = (sealed.TOP_NOISE_M_S, sealed.DEEP_NOISE_M_S), [*map(adcp.ranges, (sealed.TOP, sealed.DEEP))]
    spheres = top.depth_m, top.depth_m + sealed.DEEP_BELOW_M
    turns = top.recorded_deg - top.heading_deg - top.declination_deg, -top.declination_deg
    each = []
    for side, noise, away, sphere, turn in zip((-1.0, 1.0), noises, ranges, spheres, turns, strict=True):
        flow = water.velocity(ground.currents, time_s, sphere[:, None] + side * away)
        flow = water.clockwise(flow + water.white_vector(rng, flow.shape, noise), turn[:, None])
        heading = top.recorded_deg if side < 0.0 else np.full(HOURS, np.nan)
        each.append(record_of(time_s, heading, top.sensed_tilt_deg, sphere, flow, away))
    nodes = field.declination_deg, field.horizontal_nt, field.vertical_nt, field.declination_deg
    upper, lower = each[0], replace(each[1], looks_up=False)
    pairs = find_pairs(upper, [lower], EarthField(field.time_s, *nodes), PairRules(predict=True))
    heading = top.heading_deg[np.searchsorted(time_s, pairs.time_s)]
    return sea.Drawn(pairs, {}, heading, *(float(node.mean()) for node in nodes[1:3]))


def draw(kind: str, index: int, seed: int) -> tuple[sea.Drawn, str]:
    """Draw a mooring with all errors, and the name of the water that it shares with others."""
    window = f"{index}"
    if kind in REAL:
        cases = [each for each in injected.cases(kind) if each.logged == injected.LOGGED[0]]
        own = injected.seen(case := cases[index % len(cases)])
        drawn, window = sea.planted(injected.world(own, 100_000 * seed + index), {}), case.water
        drawn = replace(drawn, pairs=replace(drawn.pairs, veer_deg=own.pairs.veer_deg, slow_shear=own.pairs.slow_shear))
    elif kind in SEARCHED:
        drawn, _ = bench.draw(kind, index, seed)
    else:
        drawn = simulated(kind if kind in WATERS else WATERS[index // 4 % 2], index, seed)
    rng = np.random.default_rng([seed, index])
    drawn = replace(drawn, pairs=with_turned(drawn.pairs, own_deg=OWN_DEG * rng.normal()))
    shape = rng.standard_t(4, 3) / np.sqrt(2.0) if kind == "Student's tails" else rng.normal(size=3)
    errors = PRIORS.get(kind, 1.0) * shape * sea.reference_sizes((drawn.horizontal, drawn.vertical))
    return sea.refer(drawn, errors, rng, logged=index % 2 == 0), window


def with_turned(pairs: Pairs, own_deg: float = 0.0, reference_deg: np.ndarray | float = 0.0) -> Pairs:
    """Turn the readings of the affected compass with its velocities, and the velocities of the reference, clockwise."""
    upper = angles.turn(pairs.upper_east, pairs.upper_north, np.full(len(pairs), own_deg))
    lower = angles.turn(pairs.lower_east, pairs.lower_north, np.zeros(len(pairs)) + reference_deg)
    velocities = dict(zip(("upper_east", "upper_north", "lower_east", "lower_north"), (*upper, *lower), strict=True))
    return replace(pairs, heading_deg=angles.wrap360(pairs.heading_deg + own_deg), **velocities)


def without_reference(drawn: sea.Drawn) -> sea.Drawn:
    """Remove the realised errors of the reference, and the mean veer between the depths, from the pairs."""
    pairs = with_turned(drawn.pairs, reference_deg=-drawn.reference_deg)
    upper, lower = pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north
    product = sea.turned(lower, angles.difference(pairs.heading_deg, drawn.heading)) * np.conj(upper)
    veer_deg = -float(np.rad2deg(np.angle(np.sum(product / np.sqrt(np.abs(product))))))  # weighted by speed
    return replace(drawn, pairs=with_turned(pairs, reference_deg=-veer_deg))


def corrected(drawn: sea.Drawn, *, search: bool) -> tuple[CorrectedRecord, np.ndarray]:
    """Correct a mooring as the workflow does, and sum the variances of the modes of reference and mean veer, (n,)."""
    pairs, field, flow = drawn.pairs, bench.field_of(drawn), drawn.pairs.upper_east + 1j * drawn.pairs.upper_north
    tilts, depth = (pairs.pitch_deg, pairs.roll_deg), pairs.upper_depth_m
    record = record_of(pairs.time_s, pairs.heading_deg, tilts, depth, flow[:, None], 0.0)
    series = {**drawn.covariates, "depth": depth, "speed": np.abs(flow)}
    fit = fit_deviation("exact", pairs)

    def searched(some: Pairs):
        if not search:
            return insufficient("not searched")
        at = np.searchsorted(pairs.time_s, some.time_s)
        return diagnose(some, {name: column[at] for name, column in drawn.covariates.items()}, fit, field, Options())

    constant = partial(find_constant_offset, pairs=pairs, declination_deg=0.0)
    made = conclude(searched, pairs, record, field, series, fit=fit, find_constant=constant).product
    at = compass_along_record(made, record, field, series)
    result = correct(record, made.fit, field, pairs, at, unmodelled_deg=made.left_deg, doubts=made.doubts)
    modes = reference_modes(made.fit, record_readings(record), result.heading_corrected_deg)
    included = made.fit.reference is not None and made.fit.reference.veer_included
    return result, np.sum(modes**2, axis=1) + included * pairs.veer_deg**2


def measure(kind: str, index: int, seed: int) -> dict:
    """Correct a mooring with and, by a perfect reference, without the errors of its reference."""
    drawn, window = draw(kind, index, seed)
    row = {"kind": kind, "index": index, "window": window}
    cases = {"without": without_reference(drawn)} | ({} if kind in SEARCHED else {"whole": drawn})
    for name, case in cases.items():
        made, variance = corrected(case, search=kind in SEARCHED)
        off = angles.difference(made.heading_corrected_deg, drawn.heading)
        known = np.isfinite(off)
        left = made.heading_uncertainty_deg**2 - (name == "without") * variance
        off, sigma = off[known], np.sqrt(np.maximum(left, 0.0))[known]
        good = (made.heading_corrected_quality == GOOD).mean()
        within = (np.abs(off) < 1.96 * sigma).mean() if known.any() else np.nan
        row[name] = {"within": within, "error": angles.rms(off), "sigma": angles.rms(sigma), "good": good}
    return row


def report(rows: list[dict]) -> list[targets.Measured]:
    """Compute the shares of headings within the stated 95 %, with intervals over moorings, or windows of real water."""
    lines, told = [], {"whole": "whole uncertainty", "without": "less reference and veer"}
    for kind in KINDS:
        for name, what in told.items():
            some = [row for row in rows if row["kind"] == kind and name in row]
            groups = {"": some}
            if kind in WATERS and name == "whole":
                groups |= {", reference logs its heading": some[::2], ", vane": some[1::2]}
            for group, own in groups.items():
                if not own:
                    continue
                windows = list(dict.fromkeys(row["window"] for row in own))
                each = [np.mean([row[name]["within"] for row in own if row["window"] == one]) for one in windows]
                wanted = {} if group or name == "without" else WANTED.get(kind, {})
                one = targets.mean(f"{kind}{group}: within 95 %, {what}", each, unit=" %", times=100.0, **wanted)
                error, sigma = (angles.rms(np.array([row[name][key] for row in own])) for key in ("error", "sigma"))
                good = np.mean([row[name]["good"] for row in own])
                value = f"{one.value}; error {error:.2f}°, stated {sigma:.2f}°, good {100.0 * good:.1f} %"
                lines.append(replace(one, value=value))
    return lines


def main() -> None:
    parser = targets.parser(__doc__, 60, KINDS, rows=True)
    parser.add_argument("--cores", type=int, default=1)
    asked = parser.parse_args()
    there = {*KINDS} - {name for name in REAL if not injected.file_of(name).exists()}
    kinds = [kind for kind in KINDS if kind in there and asked.kind in (None, kind)]
    wanted = [(kind, index) for kind in kinds for index in range(asked.count)]
    rows = targets.resumed(asked.rows, {"seed": asked.seed}, wanted, partial(measure, seed=asked.seed), asked.cores)
    sys.exit(targets.report(report(rows)))


if __name__ == "__main__":
    main()
