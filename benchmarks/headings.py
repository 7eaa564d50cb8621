"""Errors of corrected headings over many simulated moorings of one year.

    python benchmarks/headings.py                     120 moorings: the tables, each with its target
    python benchmarks/headings.py 400 7               400 moorings by seed 7
    python benchmarks/headings.py --heeling           with tilt and vertical iron
    python benchmarks/headings.py --heeling --tilt    the same, with tilt in the fit

Currents, shear across the sphere and headings aligned by the wake are those of compasslib.demo; iron near the compass
has random direction and up to twice the earth's horizontal field. The reference gives pairs hourly or twice a day;
headings are corrected every hour. The same seed draws the same moorings.
"""

from __future__ import annotations

import argparse
import itertools
import multiprocessing
import os
import sys
import time
from dataclasses import replace
from types import SimpleNamespace as Mooring

import numpy as np
import targets
from runs import ONE_THREAD
from scipy.optimize import least_squares
from targets import Measured

from compasslib import angles, compass
from compasslib.demo import compass as needle
from compasslib.demo import demonstration, water
from compasslib.demo.water import HOUR_S, clockwise, stream, white_vector
from compasslib.deviation import fit_deviation
from compasslib.deviation.correction import correct_headings, to_body_frame
from compasslib.deviation.model import observed_heading
from compasslib.deviation.series import invert_series, multistart_least_squares, series_design
from compasslib.records import Pairs, Readings, take

STRENGTHS = (0.0, 0.1, 0.2, 0.35, 0.6, 0.85, 1.1, 1.3, 1.6, 2.0)  # hard iron over the earth's horizontal field
SPREADS, OVERLAPS = ("narrow", "wide"), ("hourly", "twice a day")
GRID = tuple(itertools.product(STRENGTHS, SPREADS, OVERLAPS))
SPECS = {"narrow": demonstration.MOORINGS[2:], "wide": demonstration.MOORINGS}  # on the shelf all headings are wide
WOBBLE_DEG, MEAN_FLOW = {"narrow": (16.0, 26.0), "wide": (25.0, 35.0)}, {"narrow": 1.0, "wide": 0.5}
FIELD_NT = (11980.0, 52078.0)  # horizontal and vertical at 65.3 N 33 W in 2007
UPPER_M, LOWER_M = -7.1, 11.6  # means of the two nearest bins of either instrument, below the sphere
METER_M_S = 0.008  # noise of their mean, each component
RATIO, SURE = 0.45, 0.95  # target of the ratio of errors; probability from which a branch counts as sure
BINS = (*itertools.pairwise((0.5, 0.7, 0.9, 0.94, 0.96, 0.98, 0.99, 1.01)), (0.94, 0.96))


def draw(index: int, seed: int, heeling: bool) -> Mooring:
    """Simulate one mooring: the input of the methods, and the truth."""
    strength, spread, overlap = GRID[index % len(GRID)]
    rng = stream(seed, name := f"M{index:04d}", "benchmark")
    spec = SPECS[spread][rng.integers(len(SPECS[spread]))]
    time_s = demonstration.DEPLOYED_S + HOUR_S * np.arange(rng.integers(8000, 9505))
    rig = replace(spec.rig, heading_offset_deg=rng.uniform(0.0, 360.0), wobble_deg=rng.uniform(*WOBBLE_DEG[spread]))
    site, span_s = (spec.latitude_deg, spec.water_depth_m), (time_s[0], time_s[-1] + HOUR_S)
    climate = replace(spec.climate, mean_m_s=spec.climate.mean_m_s * MEAN_FLOW[spread])
    currents = water.make_water(seed, name, climate, site=site, span_s=span_s)
    motion = water.make_motion(seed, name, rig, currents, declination_deg=0.0)
    series = (motion.heading_deg, motion.sphere_depth_m, heeling * motion.pitch_deg, heeling * motion.roll_deg)
    heading, sphere, *tilt = (np.interp(time_s, motion.time_s, x) for x in series)
    iron, (level_nt, down_nt) = draw_iron(rng, strength, heeling), FIELD_NT
    sensed = [x + heeling * rng.normal(0.0, needle.TILT_NOISE_DEG, x.size) for x in tilt]
    recorded = needle.recorded_heading((level_nt, down_nt), heading, tilt_deg=tilt, sensed_tilt_deg=sensed, iron=iron)
    recorded = angles.wrap360(recorded + rng.normal(0.0, needle.NOISE_DEG, recorded.size))
    upper, lower = (
        water.velocity(currents, time_s, sphere + below) + white_vector(rng, time_s.size, METER_M_S)
        for below in (UPPER_M, LOWER_M)
    )
    upper = clockwise(upper, recorded - heading)
    flow, zero = (upper.real, upper.imag, lower.real, lower.imag), np.zeros(time_s.size)
    columns = (time_s, recorded, *tilt, *flow, sphere + UPPER_M, sphere + LOWER_M, zero, zero)
    step = slice(None) if overlap == "hourly" else slice(int(rng.integers(12)), None, 12)
    return Mooring(
        key=(strength, spread, overlap),
        coefficients=compass.level_coefficients(iron.soft, iron.hard_nt, horizontal_nT=level_nt, vertical_nT=down_nt),
        time_s=time_s,
        heading_deg=angles.wrap360(heading),
        recorded_deg=recorded,
        readings=Readings(time_s, recorded, *tilt, to_body_frame(upper.real, upper.imag, recorded)),
        pairs=Pairs(*(x[step] for x in columns)),
    )


def draw_iron(rng: np.random.Generator, strength: float, heeling: bool) -> needle.Iron:
    """Draw hard iron of random direction and soft iron of a few percent; no iron at strength 0."""
    towards = np.exp(2j * np.pi * rng.uniform())
    if strength == 0.0:
        return needle.Iron()
    soft, vertical = np.eye(3), 0.0
    soft[:2, :2] += rng.normal(0.0, [[0.025, 0.01], [0.01, 0.025]])
    hard = strength * FIELD_NT[0] * 0.5 * (soft[0, 0] + soft[1, 1]) * towards
    if heeling:
        vertical = float(rng.normal(0.0, 0.3)) * FIELD_NT[0]
        soft[2] += rng.normal(0.0, [0.005, 0.005, 0.01])
        soft[:2, 2] += rng.normal(0.0, 0.003, 2)
        hard -= FIELD_NT[1] * (soft[0, 2] + 1j * soft[1, 2])  # keeps the total strength unchanged
    return needle.Iron((hard.real, hard.imag, vertical), tuple(map(tuple, soft.tolist())))


def measure(task: tuple[int, int, bool, bool]) -> Mooring:
    """Draw one mooring, correct it by both methods and by both models fitted to the truth."""
    *task, tilted = task
    drawn = draw(*task)
    recorded, heading, pairs = drawn.recorded_deg, drawn.heading_deg, drawn.pairs
    fit = fit_deviation("exact", pairs, dip_ratio=tilted * FIELD_NT[1] / FIELD_NT[0])
    decision = correct_headings(drawn.readings, fit, pairs)
    error = angles.difference(decision.heading_deg, heading)
    rival = np.abs(angles.difference(decision.other_deg, heading))
    published = correct_headings(drawn.readings, fit_deviation("von_appen", pairs), pairs).heading_deg

    missed = lambda known: angles.difference(recorded, compass.recorded_heading(known, heading))  # noqa: E731
    exact = least_squares(missed, drawn.coefficients).x
    left = np.abs(angles.difference(compass.inverse(exact, recorded), heading[:, None]))
    series = multistart_least_squares(series_design(heading), angles.difference(heading, recorded))
    series_left = angles.difference(invert_series(series, recorded), heading)
    scatter = angles.difference(observed_heading(pairs), heading[np.isin(drawn.time_s, pairs.time_s)])
    return Mooring(
        **vars(drawn),
        folded=fit.folded,
        error_deg=error,
        sigma_deg=decision.sigma_deg,
        probability=decision.probability,
        right=np.where(np.isfinite(rival), np.abs(error) < rival, np.nan),  # where there is another root
        published_deg=angles.difference(published, heading),
        floors_deg=(rms(np.fmin(left[:, 0], left[:, 1])), rms(series_left)),  # of both models fitted to the truth
        z=(fit.coefficients - exact) / np.sqrt(np.diag(fit.covariance))[:5],
        spread_deg=float(np.sqrt(-2 * np.log(angles.resultant_length(heading)))) / angles.DEGREE,
        scatter_deg=1.4826 * float(np.median(np.abs(scatter))),
    )


def rms(x) -> float:  # of finite values, as is the median
    return share(np.square(x)[np.isfinite(x)] / 100.0) ** 0.5


def median(values) -> float:
    return float(np.median(finite)) if (finite := [x for x in values if np.isfinite(x)]) else float("nan")


def share(values) -> float:
    return 100.0 * float(np.mean(values)) if np.size(values) else float("nan")


def those(told: list[Mooring], *names, least: float = 0.0, most: float = 9.0) -> list[Mooring]:
    """Select moorings by bounds of the strength and by names (strength, spread, overlap or all)."""
    return [x for x in told if {"all", *x.key}.issuperset(names) and least <= x.key[0] <= most]


def joined(told: list[Mooring], name: str) -> np.ndarray:
    return np.concatenate([np.zeros(0), *(getattr(one, name) for one in told)])


def table(title: str, head: str, rows) -> None:
    print(f"\n**{title}**")
    targets.head(*head.split(", "))
    for row in rows:
        targets.line(*(f"{x:.2f}" if isinstance(x, float) else x for x in row))


def overview(told: list[Mooring]) -> None:
    rows = []
    for key in (key for key in GRID if those(told, *key)):
        some = those(told, *key)
        ours, theirs = ([rms(getattr(one, name)) for one in some] for name in ("error_deg", "published_deg"))
        corrects = share(np.isfinite(joined(some, "published_deg")))
        drawn = (median(one.spread_deg for one in some), median(one.scatter_deg for one in some))
        drawn += (f"{sum(one.folded for one in some)} of {len(some)}",)
        rows.append((*key, *drawn, median(ours), max(ours), median(theirs), max(theirs), corrects))
    head = "iron, headings, overlaps, spread, scatter, fitted folded, rms, worst, published rms, worst, corrects %"
    table("Heading error after correction, degrees", head, rows)


def weak_iron(told: list[Mooring]) -> list[Measured]:
    rows, beyond = [], []
    for name in ("all", *SPREADS, *OVERLAPS):
        over = []
        for one in (some := those(told, name, least=0.1, most=0.6)):
            left = np.square([rms(one.error_deg), rms(one.published_deg)]) - np.square(one.floors_deg)
            over.append(np.sqrt(np.maximum(left, 0.0)))
        ours, theirs = (median(x[i] for x in over) for i in (0, 1))
        rows.append((name, len(some), ours, theirs, ours / theirs))
        beyond = beyond or [float(x[0] - RATIO * x[1]) for x in over]
    head = "moorings, n, error beyond the truth's own fit, published method's, ratio"
    table("1. Iron 0.1-0.6 H, degrees, medians over moorings", head, rows)
    what = f"1. error beyond the truth's own fit, less {RATIO} of the published method's, degrees"
    return [targets.mean(what, beyond, most=0.0)] if beyond else []


def strong_iron(told: list[Mooring]) -> list[Measured]:
    lines: list[Measured] = []
    for number, overlap in zip((2, 3), OVERLAPS, strict=True):
        rows = []
        for name in ("all", *SPREADS, *STRENGTHS[6:]):
            some = those(told, overlap, name, least=1.1)
            error, sure = joined(some, "error_deg"), joined(some, "probability") >= 0.95
            each = [rms(one.error_deg) for one in some]
            each_sure = median(rms(one.error_deg[one.probability >= 0.95]) for one in some)
            every = (share(np.isfinite(error)), median(each), rms(error), max(each, default=np.nan))
            rows.append((name, len(some), *every, share(sure), each_sure, rms(error[sure])))
        head = "moorings, n, corrected %, rms median, pooled, worst, sure %, rms where sure median, pooled"
        table(f"{number}. Iron 1.1-2 H, {overlap}, degrees", head, rows)
        lines += strong_targets(number, those(told, overlap, least=1.1))
    return lines


def strong_targets(number: int, some: list[Mooring]) -> list[Measured]:
    """Compute shares and errors of two-valued compasses with their targets: all headings, or only sure ones."""
    if not some:
        return []
    if number == 2:
        corrected = [float(np.isfinite(one.error_deg).mean()) for one in some]
        return [
            targets.mean("2. corrected", corrected, least=0.95, unit=" %", times=100.0),
            targets.mean("2. rms, degrees", [rms(one.error_deg) for one in some], most=6.0),
        ]
    sure = [one.probability >= SURE for one in some]
    errors = [rms(one.error_deg[is_sure]) for one, is_sure in zip(some, sure, strict=True) if is_sure.any()]
    return [
        targets.mean("3. sure", [float(is_sure.mean()) for is_sure in sure], least=0.75, unit=" %", times=100.0),
        targets.mean("3. rms where sure, degrees", errors, most=12.0),
    ]


def honesty(told: list[Mooring]) -> list[Measured]:
    probability, right, rows = joined(told, "probability"), joined(told, "right"), []
    for i, (low, high) in enumerate(BINS):
        inside = np.isfinite(right) & (probability >= low) & (probability < high)
        where = f"{low:g}-{min(high, 1):g}" if i < len(BINS) - 1 else "of those given 95 % (0.94-0.96)"
        rows.append((where, int(inside.sum()), share(probability[inside]), share(right[inside])))
    table("4. Branch probability, records with two roots", "stated, n, mean stated %, right %", rows)

    recorded, rows = np.concatenate([one.recorded_deg for one in told]), []
    error, sigma = joined(told, "error_deg"), joined(told, "sigma_deg")
    folded = np.repeat([one.key[0] > 1.0 for one in told], [one.error_deg.size for one in told])
    kinds = {"all": folded | True, "folded": folded, "unfolded": ~folded}
    kinds |= {f"recorded {a}-{a + 30}": recorded // 30 == a // 30 for a in range(0, 360, 30)}
    for name, inside in kinds.items():
        some = inside & np.isfinite(error)
        off = error[some] / sigma[some]
        rows.append((name, off.size, share(np.abs(off) < 1.96), rms(error[some]), rms(sigma[some]), rms(off)))
    table("5. 95 % intervals", "records, n, covered %, rms error, rms stated, rms error/stated", rows)
    each = [np.abs(one.error_deg / one.sigma_deg)[np.isfinite(one.error_deg)] < 1.96 for one in told]
    covered = [float(one.mean()) for one in each if one.size]
    return [targets.mean("5. headings within their 95 %", covered, least=0.93, most=0.97, unit=" %", times=100.0)]


def coefficients(told: list[Mooring]) -> list[Measured]:
    rows, lines = [], []
    for overlap in OVERLAPS:
        z = np.array([one.z for one in those(told, "narrow", overlap, most=0.85)]).reshape(-1, 5)
        for letter, column in zip("ABCDE", z.T, strict=True):
            rows.append((overlap, letter, column.size, share(column) / 100, column.size**-0.5, rms(column)))
            if column.size:
                lines.append(targets.mean(f"6. mean z of {letter}, {overlap}", column, least=0.0, most=0.0))
                lines.append(targets.mean(f"6. mean square z of {letter}, {overlap}", column**2, least=1.0, most=1.0))
    head = "overlaps, coefficient, n, mean z, its standard error, rms z"
    table("6. Coefficients, narrow headings, iron under 1 H", head, rows)

    null = those(told, 0.0)
    change = [angles.wrap180(one.error_deg + one.heading_deg - one.recorded_deg) for one in null]
    over = [rms(x / one.sigma_deg) for x, one in zip(change, null, strict=True)]
    rms_of = [median(map(rms, x)) for x in (change, [one.sigma_deg for one in null], [[x] for x in over])]
    row = (len(null), *rms_of, max(over, default=np.nan), share(np.less(over, 1)))
    head = "n, applied, stated, applied/stated rms median, worst, under 1 %"
    table("7. Compasses without iron, degrees", head, [row])
    if over:
        lines.append(targets.mean("7. applied over stated", over, most=1.0))
    return lines


def clock(seed: int, heeling: bool) -> Measured:
    seconds = []
    for index in (4, 6, 16, 18, 24, 26, 36, 38):  # hourly overlaps, iron 0.1, 0.6, 1.1 and 2 H
        drawn = draw(index, seed, heeling)
        pairs, readings = (take(x, np.arange(8000)) for x in (drawn.pairs, drawn.readings))
        begin = time.perf_counter()
        fit = fit_deviation("exact", pairs)
        correct_headings(readings, fit, pairs)
        seconds.append(time.perf_counter() - begin)
    title = "8. Fit and headings of 8000 pairs, one core"
    table(title, "n, seconds, most", [(len(seconds), median(seconds), max(seconds))])
    return targets.limit("8. seconds a fit, median", median(seconds), most=3.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=120, help="moorings (default 120)")
    parser.add_argument("seed", nargs="?", type=int, default=2007)
    parser.add_argument("--heeling", action="store_true", help="tilt and vertical iron")
    parser.add_argument("--tilt", action="store_true", help="tilt in the fit")
    asked = parser.parse_args()
    told, begin = [], time.perf_counter()
    with multiprocessing.Pool(2) as pool:
        for one in pool.imap(measure, [(index, asked.seed, asked.heeling, asked.tilt) for index in range(asked.count)]):
            told.append(one)
            targets.progress(f"{len(told)} of {asked.count}, {time.perf_counter() - begin:.0f} s")
    print(file=sys.stderr)
    overview(told)
    lines = [line for tell in (weak_iron, strong_iron, honesty, coefficients) for line in tell(told)]
    lines.append(clock(asked.seed, asked.heeling))
    sys.exit(targets.report(lines))


if __name__ == "__main__":
    if not ONE_THREAD.items() <= os.environ.items():  # read when numpy loads
        os.execve(sys.executable, [sys.executable, *sys.argv], os.environ | ONE_THREAD)
    main()
