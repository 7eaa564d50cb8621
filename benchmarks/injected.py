"""False alarms of the search for unmodelled effects on real currents: bins of three records, with a simulated compass.

    python benchmarks/injected.py 210 1 --rows ROWS         210 recordings without an effect, by seed 1

Bins of one profile differ by the water only, and any finding on a compass is false (benchmarks/real.py). The reference
bin is turned by the errors of a compass of its own; the headings of the others are re-read by a compass near iron
(tests/world/pairs.py). In two of three recordings the logged covariates are reversed in time or shifted by weeks. eh2
and papa were used to tune the layers of the simulated currents, and eh2 the largest lag of the water; aqd9330 was used
for no choice. Recordings with a cause are those of benchmarks/power.py.
"""

import sys
from collections.abc import Callable
from dataclasses import replace

import discrepancy as bench
import numpy as np
import real
import targets

from compasslib import angles
from compasslib.deviation import fit_deviation
from compasslib.deviation.assessment import assess_correction
from compasslib.deviation.correction import correct_headings, readings_at_pairs
from compasslib.deviation.model import DeviationFit
from compasslib.effects import side_of
from compasslib.inference.comparison import Options
from compasslib.inference.diagnosis import Diagnosis
from compasslib.records import EarthField, take
from tests.world import pairs as sea

KINDS = ("null",)


def errors(
    drawn: sea.Drawn, own: real.Seen, fit: DeviationFit, field: EarthField, found: Diagnosis
) -> dict[str, float]:
    """Compute rms heading errors as recorded, by each method of correction, and of the best level compass."""
    level, _ = sea.five_term_residual(drawn.pairs.heading_deg, drawn.heading)
    return bench.heading_errors(drawn, fit, field, found) | {
        "error_published": published(drawn, own),
        "error_level": angles.rms(level),
        "refuted": bool(assess_correction(drawn.pairs, fit)["refuted"]),
    }


def published(drawn: sea.Drawn, own: real.Seen) -> float:
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
    some = real.cases(record)
    case = some[k % len(some)]
    own = real.seen(case)
    drawn = real.in_water_of(sea.planted(real.world(own, 100_000 * seed + index), {}), own)
    drawn = bench.referred(drawn, index, seed)
    fit, field, found, row = bench.diagnosed(drawn, 0.0, Options(reference_magnetic=False))
    row |= {"kind": kind, "index": index, "record": record, "water": case.water, "case": vars(case)}
    return row if found.verdict == "insufficient" else row | errors(drawn, own, fit, field, found)


def shares(table: targets.Report, what: str, rows: list[dict], told: Callable[[dict], bool], **target: float) -> None:
    """Print a share of all and of each record."""
    # Windows share their water: the interval may be that by resampling them.
    table.share(what, map(told, rows), **target, groups=[row["water"] for row in rows])
    for record in dict.fromkeys(row["record"] for row in rows):
        own = targets.share_of(told(row) for row in rows if row["record"] == record)
        table.note(f"- {record}", own, "used for no choice" if record == real.STANDS_IN else "")


def named(row: dict) -> bool:
    """Return whether the first name of any finding is an effect on the compass or a clock."""
    return any(side_of(names[0]) in ("compass", "clock") for names in row["sets"])


def report(rows: list[dict]) -> int:
    """Print the score; return 1 if any target is outside its interval."""
    short = [row for row in rows if row["verdict"] == "insufficient"]
    rows = [row for row in rows if row["verdict"] != "insufficient"]
    print(f"\n{len(rows)} recordings, {len(short)} too short")
    table = targets.Report()
    shares(table, "no effect: attributed to compass or clock", rows, named, most=0.02)
    shares(table, "no effect: P(compass) + P(clock) at least 1/2", rows, bench.accused, most=0.02)
    shares(table, "no effect: unexplained", rows, bench.unexplained)
    shares(table, "no effect: attributed to anything", rows, lambda row: bool(row["sets"]))
    for logged in real.LOGGED:
        some = [row for row in rows if row["case"]["logged"] == logged]
        table.share(f"no effect, covariates {logged}: attributed to compass or clock", map(named, some))
    headings(table, rows)
    return int(table.missed)


def headings(table: targets.Report, rows: list[dict]) -> None:
    """Print heading errors and the coverage of their 95 % intervals.

    If held-out pairs refute the fit, the product flags all headings doubtful: these are counted and left out.
    """
    ways = ("recorded", "published", "plain", "after", "level")
    for record in dict.fromkeys(row["record"] for row in rows):
        refuted = (row["refuted"] for row in rows if row["record"] == record)
        table.share(f"{record}: refuted by held-out pairs, all headings doubtful", refuted)
    rows = [row for row in rows if not row["refuted"]]
    for record in (*dict.fromkeys(row["record"] for row in rows), "all") if rows else ():
        own = [row for row in rows if record in ("all", row["record"])]
        each = {way: np.array([row[f"error_{way}"] for row in own], dtype=float) for way in ways}
        fitted = f"published method ({np.isfinite(each['published']).sum()} of {len(own)} fitted)"
        errors = ", ".join(f"{np.sqrt(np.nanmean(one**2)):.2f}" for one in each.values())
        table.note(f"{record}: rms error in degrees: recorded, {fitted}, fit, product, best five coefficients", errors)
        worse = (row["error_after"] > row["error_plain"] + 0.1 for row in own)
        table.share(f"{record}: worse than the fit by over 0.1 degree", worse)
        both = [100.0 * np.array([row[name] for row in own]) for name in ("covered", "centred")]
        told = f"{targets.middle(both[0], np.mean, unit=' %', fewest=5)}; {both[1].mean():.1f} %"
        table.note(f"{record}: headings within 95 %; the same without their mean error", told)


def main() -> None:
    asked = targets.parser(__doc__, 42, KINDS, rows=True).parse_args()
    records = real.available()
    if not records:
        print(f"not measured: there is no real record in {real.DATA} to inject into")
        return
    rows = targets.resumed(asked, KINDS, lambda *one: measure(*one, asked.seed, records), records=records)
    sys.exit(report(rows))


if __name__ == "__main__":
    main()
