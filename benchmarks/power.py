"""Power of the search against the size of concealed causes, in simulated and in real water.

    python benchmarks/power.py 100 1 --rows ROWS            moorings by seed 1; an interrupted run resumes
    python benchmarks/power.py 100 1 --rows ROWS --keep     and docs/proof/power.json and docs/power.png by the rows
    python benchmarks/power.py --moored 2007                and the moorings on real water of results/concealed.html

A cause has the signal-to-noise ratio z if the likelihood ratio of a tool that knows the noise is z^2 / 2 on average: in
simulated water by the processes that were simulated, in real water by the spectrum of the difference of the currents,
where z of slow causes is an upper limit (compasslib.demo.concealed.signal_to_noise). Sizes are given as z over the z
that such a test of two unknown parameters detects in 90 % of moorings at p <= 0.01. The published method fits one
deviation and tests nothing else: it detects none. Real water is that of benchmarks/real.py, and needs ../shared/data.
"""

import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import discrepancy as bench
import injected
import numpy as np
import real
import targets
from matplotlib.lines import Line2D
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from benchmarks.proof import seal
from benchmarks.proof.score import first, says
from compasslib.demo.concealed import beyond, signal_to_noise, waves
from compasslib.effects import driver_of
from compasslib.inference.comparison import Options
from compasslib.inference.wording import display_name
from compasslib.plots.page import BLUE, GREEN, GREY, VERMILION, WIDE_IN, create, legend
from compasslib.preparation.water import fit_slow_shear
from compasslib.stages.demonstration import conclude
from tests.world import pairs as sea

PROJECT = Path(__file__).resolve().parents[1]
KEPT, PICTURE = PROJECT / "docs/proof/power.json", PROJECT / "docs/power.png"
KINDS = {"listed": "one listed cause", "unlisted": "one cause that is not listed", "pair": "two listed causes"}
WATERS = ("simulated", "real")
MEASURES = {"detected": "fault of the compass detected", "driver": "its driver named", "effect": "the effect named"}
DRAWN = (0.5, 4.0)  # size over the limit, by spectra; its logarithm is drawn evenly
EDGES = (0.25, 0.5, 1.0, 1.5, 2.25, 4.0)
DETECTED = float(chi2.isf(0.01, 2))
LIMIT = float(np.sqrt(brentq(lambda squared: ncx2.sf(DETECTED, 2, squared) - 0.9, 1.0, 100.0)))  # as z
BINS, SPREAD = 6, 0.4  # bins of a profile, and spread of the logarithm of the shear between them (eh2, papa: 1.5 x)
# Causes of tests/world/pairs.py that the catalogue does not list: their drivers, and what they are.
UNLISTED = {
    "sector": ("heading", "readings wrong in one sector of headings"),
    "teeth": ("heading", "a reading that errs with the teeth of a wheel"),
    "hour": ("hour time", "a reading that follows the hour of the day"),
    "episode": ("time", "a compass turned for some weeks and turned back"),
    "wander": ("time", "a compass that turns to and fro over some months"),
    "depth_threshold": ("depth", "a compass turned below a certain depth"),
    "warm_sextantal": (
        "temperature heading temperature*heading heading*temperature", "a lobed card whose lobes follow the temperature"
    ),
    "tilt_squared": ("tilt", "a reading that errs with the square of the tilt"),
}  # fmt: skip
MOORED = PROJECT / "compasslib/demo/recordings/moored.json"
INSTRUMENTS = {"eh2": "RDI 300 kHz, 47.6° N 124.6° W, 2006", "papa": "RDI 75 kHz, 50.0° N 144.3° W, 2013–14"}


def plant(world: sea.World, names: Sequence[str], z: float) -> tuple[sea.Drawn, float]:
    """Simulate the recording with causes of one signal-to-noise ratio; return the smallest ratio that was reached."""
    made = {name: sea.effect(world, name) for name in names}
    noise = np.imag(world.difference * np.conj(world.flow) / np.abs(world.flow))
    bare, speed = sea.compass(world), np.abs(world.flow)

    def turn(name: str) -> np.ndarray:
        return np.deg2rad(sea.wrap(sea.combined(world, [(made[name], sizes[name])])[0] - bare))

    sizes = dict.fromkeys(names, 1.0)
    for name in (*names, *names):  # twice, as the effect of iron is not quite proportional to its size
        most, reached = sea.STRONGEST.get(name, np.inf), signal_to_noise(speed, world.heading, turn(name), noise)
        sizes[name] = float(np.clip(sizes[name] * z / max(reached, 1e-3), -most, most))
    drawn = sea.recorded(world, {name: (made[name], size) for name, size in sizes.items()})
    ratio = known_noise_ratio if world.slow_water else lambda _, x: signal_to_noise(speed, world.heading, x, noise)
    return drawn, min((ratio(world, turn(name)) for name in names), default=0.0)


def known_noise_ratio(world: sea.World, turn: np.ndarray) -> float:
    """Compute the signal-to-noise ratio of a turn of the readings, radians, by the simulated processes of the noise.

    The Kalman filter of first-order turn and shear (slow), and red noise, whitens the turn and what is fitted.
    """
    slow, (red_m_s, red_h, white_m_s) = world.slow_water, world.noise
    assert slow is not None
    speed, angle = np.abs(world.flow), np.angle(world.flow)
    deviations = [np.deg2rad(slow.veer_deg), *[slow.shear_m_s] * 2, *[red_m_s] * 2]
    memories_h = np.array([24.0 * slow.veer_days, *[24.0 * slow.shear_days] * 2, *[red_h] * 2])
    across = np.array([speed, -np.sin(angle), np.cos(angle), -np.sin(angle), np.cos(angle)]).T
    columns = speed[:, None] * np.column_stack([turn, waves(world.heading)])
    keep, spread = np.exp(-1.0 / memories_h), np.diag(np.square(deviations))
    state, covariance, white = np.zeros((5, columns.shape[1])), spread, np.empty_like(columns)
    for k, row in enumerate(across):
        variance = row @ covariance @ row + white_m_s**2 + (np.deg2rad(0.5) * speed[k]) ** 2  # 0.5 deg: of a reading
        gain, left = covariance @ row / variance, columns[k] - row @ state
        white[k] = left / np.sqrt(variance)
        state = keep[:, None] * (state + np.outer(gain, left))
        covariance = np.outer(keep, keep) * (covariance - np.outer(gain, gain) * variance - spread) + spread
    return float(np.linalg.norm(beyond(white)))


def in_slow_water(drawn: sea.Drawn, slow: sea.SlowWater, world: sea.World) -> sea.Drawn:
    """State the turn of slow water over the record, and its shear between the bins of the affected instrument.

    The shear of these is like that over the same distance.
    """
    rng = np.random.default_rng([int(world.time_s[0]), 1])
    between = np.array([rng.lognormal(0.0, SPREAD) * slow.beside(rng, world.flow) for _ in range(BINS)])
    across = np.imag(between * np.conj(world.flow) / np.abs(world.flow))
    across += rng.normal(0.0, world.noise[2], across.shape)
    shear = fit_slow_shear(world.time_s, across, np.ones(across.shape, dtype=bool))
    return replace(drawn, pairs=replace(drawn.pairs, veer_deg=mean_veer(slow, world.flow), slow_shear=shear))


def mean_veer(slow: sea.SlowWater, flow: np.ndarray) -> float:
    """Compute the standard deviation of the mean turn over a record between the depths, degrees."""
    days = len(flow) / 24.0

    def of_mean(memory: float) -> float:  # of first-order noise with unit standard deviation
        return np.sqrt(2.0 * memory / days * (1.0 - memory / days * (1.0 - np.exp(-days / memory))))

    shear_deg = np.rad2deg(slow.shear_m_s / np.median(np.abs(flow)))
    return float(np.hypot(slow.veer_deg * of_mean(slow.veer_days), shear_deg * of_mean(slow.shear_days)))


def choose(kind: str, world: sea.World, rng: np.random.Generator) -> list[str]:
    """Draw the names of the causes of a mooring from those whose driver varies there."""
    needed = {"supply_voltage": world.voltage, "temperature": world.temperature, "depth_threshold": world.depth}
    needed |= {"warm_sextantal": world.temperature, "heeling": world.tilt[0], "tilt_squared": world.tilt[0]}
    possible = [n for n in (*bench.LISTED, *sea.UNKNOWN) if n not in needed or np.ptp(needed[n]) > 0.0]
    among = [name for name in possible if (name in sea.UNKNOWN) == (kind == "unlisted")]
    names: list[str] = rng.permutation(among)[: {"pair": 2, "null": 0}.get(kind, 1)].tolist()
    return names


def measure(kind: str, index: int, seed: int) -> dict[str, Any]:
    """Diagnose one mooring and return its row."""
    own = 1_000_000 * seed + 10_000 * (1 + [*KINDS, "null"].index(kind)) + index
    rng, water = np.random.default_rng(own), WATERS[index % 2]
    record, options = water, Options()
    if water == "real":
        there = real.available()
        record, options = there[index // 2 % len(there)], Options(reference_magnetic=False)
        some = [case for case in real.cases(record) if case.logged == real.LOGGED[0]]
        seen = real.seen(some[index // 2 % len(some)])
        world = real.world(seen, own)
    else:
        slow = sea.some_slow_water(np.random.default_rng(own))
        world = sea.make(own, wide=bool(rng.integers(2)), slow_water=slow)
    names = choose(kind, world, rng)
    drawn, z = plant(world, names, LIMIT * float(np.exp(rng.uniform(*np.log(DRAWN)))))
    drawn = real.in_water_of(drawn, seen) if water == "real" else in_slow_water(drawn, slow, world)
    *_, found, row = bench.diagnosed(bench.referred(drawn, index, seed), 0.0, options)
    row = {key: row[key] for key in ("truth", "verdict", "sides", "seconds")}
    return row | {
        "kind": kind, "index": index, "water": water, "record": record, "relative": z / LIMIT,
        **named(names, found.to_json()),
    }  # fmt: skip


def moored(record: str, kind: str, seed: int) -> dict[str, Any]:
    """Diagnose a whole real record whose compass is re-read near simulated iron, with a cause drawn by a seed."""
    seen = real.seen(real.Case(record, 0, real.GAPS[record][0], 0, 1, real.LOGGED[0]))
    world = real.world(seen, 1000 * seed + 10 * list(INSTRUMENTS).index(record) + [*KINDS, "null"].index(kind))
    names, wanted = choose(kind, world, world.rng), float(world.rng.uniform(4.0, 15.0))
    drawn, z = plant(world, names, wanted)
    drawn = bench.referred(real.in_water_of(drawn, seen), 0, seed)
    fit, field, found, _ = bench.diagnosed(drawn, 0.0, Options(reference_magnetic=False))
    made = injected.errors(drawn, seen, fit, field, found)
    return {
        "record": record,
        "instrument": INSTRUMENTS[record],
        "pairs": len(drawn.pairs),
        "days": round(float(np.ptp(drawn.pairs.time_s)) / 86400.0),
        "planted": [UNLISTED[name][1] if name in UNLISTED else display_name(name) for name in names],
        "listed": kind != "unlisted",
        "z": round(z, 1) if names else None,
        "verdict": found.verdict,
        "conclusion": conclude(found),
        **named(names, found.to_json()),
        **{key: round(made[f"error_{key}"], 2) for key in ("recorded", "plain", "after", "published")},
        "covered": round(made["covered"], 3),
    }


def named(names: Sequence[str], diagnosis: dict[str, Any]) -> dict[str, bool]:
    """Return whether a fault was detected, and whether drivers and effects of all causes were named with 0.95.

    Without a cause, whether any driver and any effect of the compass or clock was.
    """
    sides = diagnosis["sides"] or {}
    likely = sides.get("compass", 0.0) + sides.get("clock", 0.0) >= 0.5
    stated = [one for one in diagnosis["findings"] if one["level"] in ("driver", "effect")]
    accused = ("compass",) if names else ("compass", "clock")
    stated = [one for one in stated if one["side"] in accused or (names and one["level"] == "driver")]
    drivers = {"tilt" if one["driver"] in ("pitch", "roll") else one["driver"] for one in stated}
    effects = [one for one in stated if one["level"] == "effect"]

    def right(name: str, one: dict[str, Any]) -> bool:
        if name in UNLISTED:
            return one["effect"] == "composed" and one["composition"]["driver"] in UNLISTED[name][0].split()
        return says(first(one), name)

    wanted = [(UNLISTED[name][0] if name in UNLISTED else driver_of(name)).split() for name in names]
    driver = all(drivers & set(each) for each in wanted) if names else bool(stated)
    return {
        "detected": likely or diagnosis["unexplained"] is not None,
        "driver": driver,
        "effect": driver and all(any(right(name, one) for one in effects) for name in names) and bool(effects),
    }


def summary(rows: Sequence[dict[str, Any]], seed: int) -> dict[str, Any]:
    """Count moorings and successes by water, kind and size; moorings without a cause are false alarms."""

    def count(some: Sequence[dict[str, Any]]) -> dict[str, int]:
        return {"n": len(some)} | {what: sum(row[what] for row in some) for what in MEASURES}

    curves: dict[str, dict[str, list[dict[str, int]]]] = {
        water: {
            kind: [count([r for r in rows if r["water"] == water and r["kind"] == kind and low <= r["relative"] < high])
                   for low, high in itertools.pairwise(EDGES)]
            for kind in KINDS
        }
        for water in WATERS
    }  # fmt: skip
    return {
        "command": f"benchmarks/power.py {1 + max(row['index'] for row in rows)} {seed} --rows ROWS --keep",
        "commit": seal.commit()[:12],
        "seed": seed,
        "limit_z": round(LIMIT, 2),
        "relative_size": EDGES,
        "curves": curves,
        "no_cause": {
            water: count([r for r in rows if r["water"] == water and r["kind"] == "null"]) for water in WATERS
        },
        "all": {record: count([r for r in rows if r["record"] == record and r["kind"] != "null"])
                for record in dict.fromkeys(row["record"] for row in rows)},
    }  # fmt: skip


def draw(made: dict[str, Any], path: Path) -> None:
    """Draw shares with their 95 % intervals against the size, a panel for each kind of water and cause."""
    edges = np.array(made["relative_size"])
    middles = np.sqrt(edges[:-1] * edges[1:])
    with create(path, 5.6, width_in=WIDE_IN) as figure:
        panels = figure.subplots(2, 3, sharex=True, sharey=True)
        for (row, water), (column, kind) in ((w, k) for w in enumerate(WATERS) for k in enumerate(KINDS)):
            axes, bins = panels[row, column], made["curves"][water][kind]
            axes.plot(edges[[0, -1]], [0.0, 0.0], color=GREY, linewidth=2.0)
            for k, (what, colour) in enumerate(zip(MEASURES, (BLUE, GREEN, VERMILION), strict=True)):
                there = [(x, each[what], each["n"]) for x, each in zip(middles, bins, strict=True) if each["n"]]
                x = np.array([one[0] for one in there]) * 1.06 ** (k - 1)
                share = np.array([100.0 * hits / n for _, hits, n in there])
                ends = np.array([targets.interval(hits, n) for _, hits, n in there]).T.reshape(2, -1) * 100.0
                look = {"color": colour, "marker": "os^"[k], "markersize": 4.0, "capsize": 2.0, "elinewidth": 0.8}
                axes.errorbar(x, share, np.abs(ends - share), **look)
            axes.set_title(f"{kind}, {water}, n = {sum(each['n'] for each in bins)}")
            axes.set(xscale="log", ylim=(-4.0, 104.0), xticks=(0.5, 1, 2, 4), xticklabels=("0.5", "1", "2", "4"))
            axes.minorticks_off()
        for axes in panels[1]:
            axes.set_xlabel("Size / limit")
        for axes in panels[:, 0]:
            axes.set_ylabel("Moorings (%)")
        legend(figure, [
            *(Line2D([], [], color=colour, marker=mark, markersize=4.0, label=what)
              for what, colour, mark in zip(MEASURES.values(), (BLUE, GREEN, VERMILION), "os^", strict=True)),
            Line2D([], [], color=GREY, linewidth=2.0, label="published method: nothing"),
        ])  # fmt: skip


def report(made: dict[str, Any]) -> None:
    """Print the counts as a table, the shares of all moorings first."""
    targets.head("water", "cause", "size over the limit", *MEASURES.values())

    def line(water: str, kind: str, size: str, some: Iterable[dict[str, int]]) -> None:
        total = {key: sum(one[key] for one in (*some,)) for key in ("n", *MEASURES)}
        targets.line(water, kind, size, *(targets.text_of(total[what], total["n"]) for what in MEASURES))

    line("all", "all", "all", (*made["all"].values(),))
    for record, counted in made["all"].items():
        line(record, "all", "all", [counted])
    for water in WATERS:
        line(water, "none: false alarms", "0", [made["no_cause"][water]])
        for kind in KINDS:
            for (low, high), one in zip(itertools.pairwise(EDGES), made["curves"][water][kind], strict=True):
                line(water, KINDS[kind], f"{low:g} to {high:g}", [one])


def main() -> None:
    parser = targets.parser(__doc__, 60, (*KINDS, "null"), rows=True)
    parser.add_argument("--keep", action="store_true", help="write docs/proof/power.json and docs/power.png")
    parser.add_argument("--moored", type=int, metavar="SEED", help="write the moorings on real water of a seed")
    asked = parser.parse_args()
    if asked.moored is not None:
        made = [moored(record, kind, asked.moored) for record in INSTRUMENTS for kind in ("listed", "unlisted", "null")]
        files = [real.FILES[record] for record in INSTRUMENTS]
        kept = seal.source(f"benchmarks/power.py --moored {asked.moored}", files) | {"moorings": made}
        MOORED.write_text(json.dumps(kept, ensure_ascii=False) + "\n")
        return
    rows = targets.resumed(asked, (*KINDS, "null"), lambda *one: measure(*one, asked.seed))
    made = summary(rows, asked.seed)
    if asked.keep:
        KEPT.write_text(json.dumps(made, indent=1) + "\n")
        draw(made, PICTURE)
    report(made)


if __name__ == "__main__":
    main()
