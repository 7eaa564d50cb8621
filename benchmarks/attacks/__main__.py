"""A campaign of mistakes with known truth: is a wrong heading ever flagged good without a word?

    python benchmarks/attacks                        240 mistakes and 120 harmless changes by seed 1
    python benchmarks/attacks 240 7 --rows rows.jsonl    by seed 7; a run that was cut goes on from its rows

Each case is a copy of a cruise with known truth (three simulated years, and the real record of ../shared/data where it
is there), or a calibration, spoilt in one place: metadata, clocks, tables, contents of PD0, readings. It is processed
as ``compass correct`` does. *Silent wrong* is: headings flagged 1 with an rms error over 2 degrees and over twice the
untouched one's, whose stated 95 % intervals hold under 85 % of the truth or whose errors pass 6 sigma more than once in
100, and no warning that the untouched cruise had not. Of harmless changes those are counted that were refused, lost
over 2 % of their good headings, or got a new warning. What no record can tell is listed apart: a constant between the
two instruments is the same as A. Exit status 1 where anything was silently wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[1]))  # last: attacks has a calibrations of its own

import calibrations
import cruises
import moorings
import targets

from compasslib.core.errors import InputError

SHARES = {"mistake": (0.8, 0.2), "harmless": (0.8, 0.2)}  # of moorings, of calibrations
LOST = 0.02
# What no record can tell is counted apart: a constant between the instruments is A; a level log without a heading does
# not show in which sense its axes stand, nor two columns of headings which of them is the compass.
UNDECIDABLE = (": declination: ", "magnetometer: x of other sign", "magnetometer: axes exchanged", "columns exchanged")


def draw(count: int, seed: int, kind: str, bases: list[str]) -> list[dict[str, Any]]:
    """Return the cases: every attack in turn, so that none is drawn by chance alone."""
    attacks = moorings.HARMFUL if kind == "mistake" else moorings.HARMLESS
    whole = round(count * SHARES[kind][0])
    cases = [
        {"kind": kind, "attack": attacks[k % len(attacks)].__name__, "base": k // len(attacks), "seed": [seed, k]}
        for k in range(whole)
    ]
    kinds = list(calibrations.SPOILERS)
    return cases + [
        {"kind": kind, "attack": kinds[k % 4], "base": -1, "seed": [seed, whole + k]} for k in range(count - whole)
    ]


def measure(case: dict[str, Any], bases: Path, names: list[str]) -> dict[str, Any]:
    """Return one row: what was done and what came of it."""
    with tempfile.TemporaryDirectory() as scratch:
        row = _calibration(case, Path(scratch)) if case["base"] < 0 else _mooring(case, bases, names, Path(scratch))
    return case | row


def _mooring(case: dict[str, Any], bases: Path, names: list[str], scratch: Path) -> dict[str, Any]:
    attack, rng = getattr(moorings, case["attack"]), np.random.default_rng(case["seed"])
    for turn in range(len(names)):  # the first base in turn that the attack goes with
        base = names[(case["base"] + turn) % len(names)]
        cruise = cruises.Cruise.copy(bases, base, scratch / f"cruise{turn}")
        done = moorings.spoil(attack, cruise, rng)
        if done is not None:
            break
    cruise.save()
    untouched = cruises.Outcome(**json.loads((bases / f"{base}.json").read_text()))
    outcome = cruises.run(cruise, scratch / "made")
    return _row(f"{base}: {done}", outcome, untouched, cruises.silent_wrong(outcome, untouched))


def _calibration(case: dict[str, Any], scratch: Path) -> dict[str, Any]:
    kind, (first, second) = case["attack"], case["seed"]
    plain = calibrations.make(kind, [first, second, 0], scratch)
    untouched = calibrations.run(plain, scratch / "plain")
    made = calibrations.make(kind, [first, second, 0], scratch)
    spoil = calibrations.SPOILERS[kind][1] if case["kind"] == "mistake" else calibrations.harmless
    done = spoil(made, np.random.default_rng([first, second, 1]))
    outcome = calibrations.run(made, scratch / "spoilt")
    return _row(f"{kind}: {done}", outcome, untouched, calibrations.silent_wrong(outcome, untouched))


def _row(done: str, outcome: cruises.Outcome, untouched: cruises.Outcome, wrong: bool) -> dict[str, Any]:
    said = cruises.new_warnings(outcome, untouched)
    hurt = bool(outcome.refused) or outcome.good < untouched.good - LOST or bool(said)
    before = {"untouched_rms_deg": untouched.rms_deg, "untouched_covered": untouched.covered}
    return {"done": done, "silent_wrong": wrong, "hurt": hurt, "said": said} | asdict(outcome) | before


def untouched(bases: Path, base: str) -> None:
    """Run a base as it is and keep the outcome."""
    with tempfile.TemporaryDirectory() as scratch:
        cruise = cruises.Cruise.copy(bases, base, Path(scratch) / "cruise")
        made = Path(scratch) / "made"
        cruises.keep_declination(cruise, cruises.pipeline.process(cruise.folder, "M", Path(scratch) / "first"))
        (bases / f"{base}.json").write_text(json.dumps(asdict(cruises.run(cruise, made))))


def safely(case: dict[str, Any], bases: Path, names: list[str]) -> dict[str, Any]:
    """Return a row also of a case that ended in a traceback: that is a failure of its own."""
    try:
        return measure(case, bases, names)
    except InputError:
        raise
    except Exception as error:  # what the campaign is to find, whatever it is
        return case | {"done": case["attack"], "crashed": f"{type(error).__name__}: {error}"}


def report(rows: list[dict[str, Any]]) -> int:
    """Print what came of all cases; return how many were silently wrong or crashed."""
    crashed = [row for row in rows if "crashed" in row]
    mistakes = [row for row in rows if row["kind"] == "mistake" and row not in crashed]
    wrong = [row for row in mistakes if row["silent_wrong"]]
    apart = [row for row in wrong if any(word in row["done"] for word in UNDECIDABLE)]
    ways = Counter(_way(row) for row in mistakes)
    print(f"mistakes: {len(mistakes)}; " + ", ".join(f"{way} {n}" for way, n in sorted(ways.items())))
    for title, some in (("silently wrong", [r for r in wrong if r not in apart]), ("no record can tell", apart)):
        print(f"{title}: {len(some)}")
        for row in some:
            shown = f"rms {row['rms_deg']:.1f} (untouched {row['untouched_rms_deg']:.1f}), covered {row['covered']:.2f}"
            print(f"  {row['seed']} {row['done']}: {shown}, beyond 6 sigma {row['far']:.3f}, {row['verdict']}")
    print(f"tracebacks: {len(crashed)}")
    for row in crashed:
        print(f"  {row['seed']} {row['done']}: {row['crashed'][:200]}")
    harmless = [row for row in rows if row["kind"] == "harmless" and row not in crashed]
    hurt = [row for row in harmless if row["hurt"]]
    print(f"harmless changes: {len(harmless)}; flagged or refused {len(hurt)}")
    for row in hurt:
        print(f"  {row['seed']} {row['done']}: {(row['refused'] or '; '.join(row['said']) or 'flags')[:300]}")
    return len(wrong) - len(apart) + len(crashed)


def _way(row: dict[str, Any]) -> str:
    if row["silent_wrong"]:
        return "silent wrong"
    if row["refused"]:
        return "refused"
    right = row["good"] and row["rms_deg"] <= max(cruises.MARGIN_DEG, cruises.TIMES * row["untouched_rms_deg"])
    if right:
        return "right"
    return "warned" if row["said"] else "flagged or its uncertainty says so"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", type=int, nargs="?", default=240)
    parser.add_argument("seed", type=int, nargs="?", default=1)
    parser.add_argument("--harmless", type=int, help="harmless changes; half as many by default")
    parser.add_argument("--rows", type=Path, help="JSON lines; kept, and taken up again")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", help="one attack")
    asked = parser.parse_args()
    rows = targets.rows_of(asked.rows, {})
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor(asked.workers) as pool:
        bases = Path(folder)
        names = cruises.build(bases)
        list(pool.map(untouched, [bases] * len(names), names))
        cases = draw(asked.count, asked.seed, "mistake", names)
        cases += draw(asked.count // 2 if asked.harmless is None else asked.harmless, asked.seed + 1, "harmless", names)
        done = {(row["kind"], tuple(row["seed"])) for row in rows}
        cases = [c for c in cases if (c["kind"], tuple(c["seed"])) not in done and asked.only in (None, c["attack"])]
        for k, row in enumerate(pool.map(safely, cases, [bases] * len(cases), [names] * len(cases))):
            rows.append(targets.added(asked.rows, row))
            targets.progress(f"{k + 1} of {len(cases)}")
    print(file=sys.stderr)
    sys.exit(1 if report(rows) else 0)


if __name__ == "__main__":
    main()
