"""The search for left-out physics on a real record: currents, headings and tilts of eh2, physics injected.

    python benchmarks/injected.py 60 1                     60 injections of each kind by seed 1
    python benchmarks/injected.py 60 1 --kind single
    python benchmarks/injected.py 60 1 --gap 2             one bin is the trusted instrument, 2 cells off
    python benchmarks/injected.py 60 1 --gap 2 --published the same by the mean of two bins, nothing predicted

The recorded headings of E0 in ../shared/data/cruise_eh2 count as the true ones, an iron compass of
compasslib/simulation/pairs.py reads them again with an effect, and the engine is told nothing. Kinds and measures are
those of benchmarks/discrepancy.py, without clocks.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import discrepancy as bench
import numpy as np
import water

from compasslib.archive import netcdf
from compasslib.core.records import EarthField, Pairs
from compasslib.preparation import overlap
from compasslib.search import covariates
from compasslib.search.diagnosis import Options, diagnose
from compasslib.simulation import pairs as sea
from compasslib.stages import pipeline

KINDS = ("null", "single", "two", "unknown")
DATA = Path(__file__).resolve().parents[1] / ".." / "shared" / "data" / "cruise_eh2"


@dataclass(frozen=True)
class Seen:
    """The real overlap, and what was logged beside it."""

    pairs: Pairs
    logged: dict[str, np.ndarray]


def of_cruise(folder: Path) -> Seen:
    """Return the overlap of E0 as the pipeline finds it."""
    made = pipeline.process(DATA, "E0", folder / "E0")
    pairs = netcdf.read_pairs(made / "overlap.nc")
    return Seen(pairs, covariates.logged(netcdf.read_record(made / "work/top.nc"), (), pairs))


def mirrored(depth: int, gap: int, *, predict: bool) -> Seen:
    """Return the overlap of one bin of the same record with those beyond it, ``gap`` cells away."""
    whole = water.profile("eh2")
    trusted = water.as_trusted(whole, depth)
    top = water.bins_of(whole, slice(depth + gap, None))
    field = EarthField(whole.time_s[[0, -1]], *np.zeros((4, 2)))
    pairs = overlap.find(top, [trusted], field, overlap.Rules(predict=predict))
    return Seen(pairs, covariates.logged(top, (), pairs))


def world(seen: Seen, seed: int) -> tuple[sea.World, dict[str, np.ndarray]]:
    """Return the real record as a world that a compass can be put into, and what was logged beside it."""
    pairs, logged = seen.pairs, seen.logged
    rng = np.random.default_rng(seed)
    upper, lower = pairs.upper_east + 1j * pairs.upper_north, pairs.lower_east + 1j * pairs.lower_north
    tilt = np.nan_to_num(np.stack([pairs.pitch_deg, pairs.roll_deg]))
    zero = np.zeros(len(pairs))
    return sea.World(
        rng=rng, time_s=pairs.time_s, heading=pairs.heading_deg, flow=upper, difference=lower - upper, tilt=tilt,
        sensed=tilt + rng.normal(0, 0.02, tilt.shape), depth=pairs.upper_depth_m,
        separation=pairs.lower_depth_m - pairs.upper_depth_m, temperature=logged.get("temperature", zero),
        voltage=logged.get("supply_voltage", zero), earth=(18900.0, 49800.0), **sea.iron(rng),
    ), logged  # fmt: skip


def draw(seen: Seen, kind: str, index: int, seed: int) -> tuple[sea.Drawn, dict[str, float]]:
    """Return one injection and the effects that were asked for."""
    own, logged = world(seen, 100_000 * seed + 1000 * KINDS.index(kind) + index)
    size = bench.SIZES[kind][index % len(bench.SIZES[kind])]
    turn = index // len(bench.SIZES[kind])
    singles = [x for x in bench.SINGLES if np.ptp(getattr(own, {"supply_voltage": "voltage"}.get(x, "heading")))]
    singles = [x for x in singles if x != "temperature" or np.ptp(own.temperature)]
    wanted: dict[str, float] = {}
    if kind == "single":
        wanted = {singles[turn % len(singles)]: size}
    elif kind == "two":
        wanted = dict.fromkeys(bench._two(own.rng), size)
    elif kind == "unknown":
        unknown = [x for x in sea.UNKNOWN if x != "depth_threshold" or np.ptp(own.depth)]
        wanted = {unknown[turn % len(unknown)]: size}
    drawn = sea.planted(own, wanted)
    return replace(drawn, covariates=logged), wanted


def measure(seen: Seen, kind: str, index: int, seed: int) -> dict:
    """Return one row of the score."""
    drawn, wanted = draw(seen, kind, index, seed)
    fit, field = bench.fitted(drawn), bench.field_of(drawn)
    begin = time.perf_counter()
    found = diagnose(drawn.pairs, drawn.covariates, fit, field, Options(reference_magnetic=False))
    row = {
        "kind": kind, "index": index, "truth": drawn.truth, "size": max(wanted.values(), default=0.0),
        "visible": drawn.visible_deg, "verdict": found.verdict,
        "sets": [[one.effect, *one.alternatives] for one in found.findings], "seconds": time.perf_counter() - begin,
        "left": None if found.unexplained is None else [found.unexplained.covariates, found.unexplained.rms_effect_deg],
        "negligible": found.negligible, "applied": bool(found.applied), "sides": found.sides,
        "probability": [{one.effect: one.probability, **one.alternatives_probability} for one in found.findings],
        "gain": [one.held_out.gain for one in found.findings],
        "p": [one.held_out.p_value for one in found.findings],
        "detectable": found.detectable_deg,
    }  # fmt: skip
    known = set(drawn.truth) <= {*bench.PRODUCT, "current_veer"} and "deg_m" not in drawn.truth.get("current_veer", {})
    if kind in ("single", "two") and known:  # its two layers keep their distance
        row |= bench.against_oracle(drawn, fit, field, found)
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=40)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--rows", type=Path)
    parser.add_argument("--gap", type=int, help="cells between the trusted bin and the nearest one")
    parser.add_argument("--published", action="store_true", help="nothing is predicted")
    asked = parser.parse_args()
    if not DATA.is_dir():
        print(f"{DATA} is absent: there is no real record to inject into")
        return
    if asked.gap is not None:
        overlaps = [mirrored(depth, asked.gap, predict=not asked.published) for depth in water.DEPTHS]
        sys.exit(0 if bench.report(rows_of(asked, overlaps)) else 1)
    with tempfile.TemporaryDirectory() as folder:
        sys.exit(0 if bench.report(rows_of(asked, [of_cruise(Path(folder))])) else 1)


def rows_of(asked: argparse.Namespace, overlaps: Sequence[Seen]) -> list[dict]:
    """Return the rows that were asked for."""
    rows = []
    for kind in KINDS if asked.kind is None else (asked.kind,):
        for index in range(asked.count):
            rows.append(measure(overlaps[index // 2 % len(overlaps)], kind, index, asked.seed))
            print(f"\r{kind} {index + 1} of {asked.count}", end="", file=sys.stderr)
            if asked.rows:
                with asked.rows.open("a") as stream:
                    stream.write(json.dumps(rows[-1], default=float) + "\n")
    print(file=sys.stderr)
    return rows


if __name__ == "__main__":
    main()
