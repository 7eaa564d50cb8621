"""Score of the search for unmodelled effects on real currents: bins of three records, with a simulated compass.

    python benchmarks/injected.py 210 1 --kind null --rows ROWS     210 recordings without an effect, by seed 1
    python benchmarks/injected.py 60 1                              every kind

The bins of one profile share their compass: they differ by the water only, and any finding on a compass is false. One
bin is the reference, turned by the errors of a compass of its own; the headings of those beyond a gap are re-read by a
compass near iron (tests/world/pairs.py). Of aqd9330, a point meter, the mean of the hours 3 h before and after is the
second instrument. In two of three nulls the logged covariates are reversed in time or shifted by weeks. eh2 and papa
were used to tune the layers of the simulated currents, and eh2 the largest lag of the water; aqd9330 was used for no
choice. Needs ../shared/data.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import discrepancy as bench
import numpy as np
import targets
import water

from compasslib import angles
from compasslib.deviation import fit_deviation
from compasslib.deviation.assessment import assess_correction
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.effects import side_of
from compasslib.inference import covariates
from compasslib.inference.comparison import Options
from compasslib.preparation.pairs import PairRules, find_pairs
from compasslib.records import EarthField, Pairs, take
from tests.world import pairs as sea

KINDS = ("null", "single", "two", "unknown")
HOUR_S = 3600.0
SIDE_H = 3  # hours before and after, whose mean serves as the second instrument
DEEP_DBAR = 200.0
GAPS = {"eh2": (2, 4), "papa": (1, 2), "aqd9330": (0,)}  # cells between the reference bin and the nearest other
PARTS = {"eh2": (1, 2), "papa": (1, 2), "aqd9330": (4,)}  # windows: the whole, halves, quarters
LOGGED = ("as logged", "backwards", "of other weeks")
LEFT_OUT = "aqd9330"
AQUADOPP = water.DATA / "moored/aqd9330.npz"
EARTH_NT = (18900.0, 49800.0)


@dataclass(frozen=True)
class Seen:
    """Pairs of a real record, logged covariates, and the same pairs by the mean of two bins."""

    pairs: Pairs
    logged: dict[str, np.ndarray]
    published: Pairs

    def between(self, first_s: float, last_s: float) -> Seen:
        some, other = ((x.time_s >= first_s) & (x.time_s < last_s) for x in (self.pairs, self.published))
        logged = {name: column[some] for name, column in self.logged.items()}
        return Seen(take(self.pairs, some), logged, take(self.published, other))


@dataclass(frozen=True)
class Case:
    """One pair of bins of one record in one window."""

    record: str
    depth: int
    gap: int
    part: int  # index of the window among ``of``
    of: int
    logged: str

    @property
    def water(self) -> str:
        """Name of the window, whose cases share their water."""
        return f"{self.record} {self.part + 1}/{self.of}"


def file_of(record: str) -> Path:
    """Locate the file of a record."""
    return AQUADOPP if record == LEFT_OUT else water.DATA / water.FILES[record]


@cache
def whole(record: str, depth: int, gap: int) -> Seen:
    """Compute pairs of one bin with those beyond a gap of ``gap`` cells; of a point meter with neighbours in time."""
    if record == LEFT_OUT:
        return stood_in()
    own = water.profile(record)
    trusted, top = water.as_trusted(own, depth), water.bins_of(own, slice(depth + gap, None))
    field = EarthField(own.time_s[[0, -1]], *np.zeros((4, 2)))
    rules = [PairRules(max_metres=1000.0, predict=predict) for predict in (True, False)]
    predicted, published = (find_pairs(top, [trusted], field, one) for one in rules)
    return Seen(predicted, covariates.logged_series(top, (), predicted), published)


def stood_in() -> Seen:
    """Compute pairs of hourly means of the point meter with the mean of those ``SIDE_H`` hours before and after."""
    file = np.load(AQUADOPP)
    deep = file["pressure"] > DEEP_DBAR
    time_s = file["time"].astype("datetime64[s]").astype(float)[deep]
    hour, begins = np.unique(np.floor(time_s / HOUR_S), return_index=True)
    count = np.diff(np.append(begins, len(time_s)))

    def hourly(name: str, column=None) -> np.ndarray:
        series = file[name][deep] if column is None else file[name][deep][:, column]
        return np.add.reduceat(series.astype(float), begins) / count

    turns = np.add.reduceat(angles.phasor(file["heading"][deep]), begins)
    flow = hourly("vel", 0) + 1j * hourly("vel", 1)
    inner = np.arange(SIDE_H, len(hour) - SIDE_H)
    inner = inner[hour[inner + SIDE_H] - hour[inner - SIDE_H] == 2 * SIDE_H]
    second, flow, none = (flow[inner - SIDE_H] + flow[inner + SIDE_H]) / 2.0, flow[inner], np.zeros(len(inner))
    depth = hourly("pressure")[inner]
    pairs = Pairs(
        (hour[inner] + 0.5) * HOUR_S, angles.wrap360(angles.argument(turns[inner])), hourly("pitch")[inner],
        hourly("roll")[inner], flow.real, flow.imag, second.real, second.imag, depth, depth, none, none,
    )  # fmt: skip
    logged = {"temperature": hourly("temperature")[inner], "supply_voltage": hourly("volts")[inner], "depth": depth}
    return Seen(pairs, logged | {"speed": np.abs(flow)}, pairs)


@cache
def cases(record: str) -> list[Case]:
    """List all cases of a record in random order."""
    depths = (0,) if record == LEFT_OUT else tuple(water.DEPTHS)
    windows = [(part, of) for of in PARTS[record] for part in range(of)]
    every = [
        Case(record, depth, gap, *window, logged)
        for depth, gap, window, logged in itertools.product(depths, GAPS[record], windows, LOGGED)
    ]
    return [every[k] for k in np.random.default_rng(0).permutation(len(every))]


def seen(case: Case) -> Seen:
    """Select the pairs of a case, with covariates as logged, reversed or shifted."""
    every = whole(case.record, case.depth, case.gap)
    edges = np.linspace(every.pairs.time_s[0], every.pairs.time_s[-1] + 1.0, case.of + 1)
    own = every.between(*edges[case.part : case.part + 2])
    if case.logged == LOGGED[0]:
        return own
    away = len(own.pairs) // 3
    moved = {
        name: column[::-1] if case.logged == LOGGED[1] else np.roll(column, away)
        for name, column in own.logged.items()
        if name not in ("depth", "speed")
    }
    return replace(own, logged={**own.logged, **moved})


def world(own: Seen, seed: int) -> sea.World:
    """Convert the real record to a simulated world with a compass near iron."""
    pairs, rng = own.pairs, np.random.default_rng(seed)
    upper, lower = pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north
    tilt, none = np.nan_to_num(np.stack([pairs.pitch_deg, pairs.roll_deg])), np.zeros(len(pairs))
    return sea.World(
        rng=rng, time_s=pairs.time_s, heading=pairs.heading_deg, flow=upper, difference=lower - upper, tilt=tilt,
        sensed=tilt + rng.normal(0, 0.02, tilt.shape), depth=pairs.upper_depth_m,
        separation=pairs.lower_depth_m - pairs.upper_depth_m,
        temperature=covariates.fill_gaps(own.logged.get("temperature", none)),
        voltage=covariates.fill_gaps(own.logged.get("supply_voltage", none)), earth=EARTH_NT, **sea.iron(rng),
    )  # fmt: skip


def draw(case: Case, own: Seen, kind: str, turn: int, seed: int) -> tuple[sea.Drawn, float]:
    """Simulate one recording with the effects of its turn; return it with their requested size, degrees."""
    here = world(own, seed)
    sizes = bench.SIZES[kind]
    size, turn = sizes[turn % len(sizes)], turn // len(sizes)
    needed = {"supply_voltage": here.voltage, "temperature": here.temperature, "depth_threshold": here.depth,
              "heeling": here.tilt, "tilt_squared": here.tilt}  # fmt: skip
    there = [name for name in (*bench.SINGLES, *sea.UNKNOWN) if name not in needed or np.ptp(needed[name]) > 0.0]
    singles, unknown = ([x for x in some if x in there] for some in (bench.SINGLES, sea.UNKNOWN))
    wanted: dict[str, float] = {}
    if kind == "single":
        wanted = {singles[turn % len(singles)]: size}
    elif kind == "two":
        while not wanted or not set(wanted) <= set(there):
            wanted = dict.fromkeys(bench.two(here.rng), size)
    elif kind == "unknown":
        wanted = {unknown[turn % len(unknown)]: size}
    return in_water_of(sea.planted(here, wanted), own), max(wanted.values(), default=0.0)


def in_water_of(drawn: sea.Drawn, own: Seen) -> sea.Drawn:
    """State the slow water of the real record, and its logged covariates."""
    pairs = replace(drawn.pairs, veer_deg=own.pairs.veer_deg, slow_shear=own.pairs.slow_shear)
    return replace(drawn, pairs=pairs, covariates=own.logged)


def errors(drawn: sea.Drawn, own: Seen, fit, field, found) -> dict[str, float]:
    """Compute rms heading errors as recorded, by each method of correction, and of the best level compass."""
    made, bare = bench.corrected(drawn, fit, field, found)
    off = angles.difference(made.heading_deg, drawn.heading)
    recorded = drawn.pairs.heading_deg
    level, _ = sea.five_term_residual(recorded, drawn.heading)
    return {
        "error_recorded": angles.rms(angles.difference(recorded, drawn.heading)),
        "error_plain": bench.error(bare.heading_deg, drawn),
        "error_after": bench.error(made.heading_deg, drawn),
        "error_published": published(drawn, own),
        "error_level": angles.rms(level),
        "refuted": bool(assess_correction(drawn.pairs, fit)["refuted"]),
        "covered": float(np.nanmean(np.abs(off) < 1.96 * made.sigma_deg)),
        "centred": float(np.nanmean(np.abs(off - np.nanmean(off)) < 1.96 * made.sigma_deg)),
    }


def published(drawn: sea.Drawn, own: Seen) -> float:
    """Compute the rms heading error of von Appen's series fitted to the mean of two bins, degrees."""
    _, one, other = np.intersect1d(drawn.pairs.time_s, own.published.time_s, return_indices=True)
    pairs = take(own.published, other)
    recorded = drawn.pairs.heading_deg[one]
    turn = angles.difference(recorded, pairs.heading_deg)
    east, north = angles.turn(pairs.upper_east, pairs.upper_north, turn)
    pairs = replace(pairs, heading_deg=recorded, upper_east=east, upper_north=north)
    fit = fit_deviation("von_appen", pairs)
    if not fit.fitted:
        return float("nan")
    made = correct_headings(readings_at_pairs(drawn.pairs), fit, pairs)
    return bench.error(made.heading_deg, drawn)


def measure(kind: str, index: int, seed: int, records: list[str]) -> dict:
    """Simulate and diagnose one recording and return its row of the score."""
    record, k = records[index % len(records)], index // len(records)
    some = [one for one in cases(record) if kind == "null" or one.logged == LOGGED[0]]
    case = some[k % len(some)]
    own = seen(case)
    drawn, size = draw(case, own, kind, k, 100_000 * seed + 10_000 * KINDS.index(kind) + index)
    drawn = bench.referred(drawn, index, seed)
    fit, field, found, row = bench.diagnosed(drawn, size, Options(reference_magnetic=False))
    row |= {"kind": kind, "index": index, "record": record, "water": case.water, "case": vars(case)}
    return row if found.verdict == "insufficient" else row | errors(drawn, own, fit, field, found)


# The report.


def shares(table: targets.Report, what: str, rows: list[dict], told, **target: float) -> None:
    """Print a share of all and of each record."""
    # Windows share their water: the interval may be that by resampling them.
    table.share(what, map(told, rows), **target, groups=[row["water"] for row in rows])
    for record in dict.fromkeys(row["record"] for row in rows):
        own = targets.share_of(told(row) for row in rows if row["record"] == record)
        table.note(f"- {record}", own, "used for no choice" if record == LEFT_OUT else "")


def named(row: dict) -> bool:
    """Return whether the first name of any finding is an effect on the compass or a clock."""
    return any(side_of(names[0]) in ("compass", "clock") for names in row["sets"])


def report(rows: list[dict]) -> int:
    """Print the score; return 1 if any target is outside its interval."""
    short = [row for row in rows if row["verdict"] == "insufficient"]
    rows = [row for row in rows if row["verdict"] != "insufficient"]
    rows = [r for r in rows if all(r["visible"][x] > 0.8 * r["size"] for x in r["truth"] if x in sea.STRONGEST)]
    print(f"\n{len(rows)} recordings, {len(short)} too short")
    table, of = targets.Report(), {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    shares(table, "no effect: attributed to compass or clock", of["null"], named, most=0.02)
    shares(table, "no effect: P(compass) + P(clock) at least 1/2", of["null"], bench.accused, most=0.02)
    shares(table, "no effect: unexplained", of["null"], bench.unexplained)
    shares(table, "no effect: attributed to anything", of["null"], lambda row: bool(row["sets"]))
    for logged in LOGGED:
        some = [row for row in of["null"] if row["case"]["logged"] == logged]
        table.share(f"no effect, covariates {logged}: attributed to compass or clock", map(named, some))
    for size in bench.SIZES["single"]:
        what, some = f"single {size}", [row for row in of["single"] if row["size"] == size]
        got = [row for row in some if bench.detected(row)]
        alone = [row for row in got if bench.named_alone(row)]
        shares(table, f"{what}: true side with a probability of at least 1/2", some, bench.detected)
        shares(table, f"{what}: truth in the set, where detected", got, bench.covered, least=0.97)
        shares(table, f"{what}: right where one name is given", alone, bench.covered, least=0.97)
    bench.reliability(table, of["null"] + of["single"] + of["two"])
    for kind in KINDS:
        headings(table, kind, of[kind])
    if rows:
        seconds = [row["seconds"] for row in rows]
        times = f"{np.median(seconds):.1f}, {np.quantile(seconds, 0.95):.1f}"
        table.note("seconds per recording: median, 95 %", times)
    return int(table.missed)


def headings(table: targets.Report, kind: str, rows: list[dict]) -> None:
    """Print heading errors and the coverage of their 95 % intervals.

    If held-out pairs refute the fit, the product flags all headings doubtful: these are counted and left out.
    """
    ways = ("recorded", "published", "plain", "after", "level")
    for record in dict.fromkeys(row["record"] for row in rows):
        refuted = (row["refuted"] for row in rows if row["record"] == record)
        table.share(f"{kind}, {record}: refuted by held-out pairs, all headings doubtful", refuted)
    rows = [row for row in rows if not row["refuted"]]
    for record in (*dict.fromkeys(row["record"] for row in rows), "all") if rows else ():
        what, own = f"{kind}, {record}", [row for row in rows if record in ("all", row["record"])]
        each = {way: np.array([row[f"error_{way}"] for row in own], dtype=float) for way in ways}
        fitted = f"published method ({np.isfinite(each['published']).sum()} of {len(own)} fitted)"
        errors = ", ".join(f"{np.sqrt(np.nanmean(one**2)):.2f}" for one in each.values())
        table.note(f"{what}: rms error in degrees: recorded, {fitted}, fit, product, best five coefficients", errors)
        worse = (row["error_after"] > row["error_plain"] + 0.1 for row in own)
        table.share(f"{what}: worse than the fit by over 0.1 degree", worse)
        both = [100.0 * np.array([row[name] for row in own]) for name in ("covered", "centred")]
        told = f"{targets.middle(both[0], np.mean, unit=' %', fewest=5)}; {both[1].mean():.1f} %"
        table.note(f"{what}: headings within 95 %; the same without their mean error", told)


def main() -> None:
    asked = targets.parser(__doc__, 42, KINDS, rows=True).parse_args()
    records = [name for name in GAPS if file_of(name).exists()]
    if not records:
        print(f"not measured: there is no real record in {water.DATA} to inject into")
        return
    rows = targets.resumed(asked, KINDS, lambda *one: measure(*one, asked.seed, records), records=records)
    sys.exit(report(rows))


if __name__ == "__main__":
    main()
