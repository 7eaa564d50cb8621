"""Campaign of planted mistakes with known truth: whether a wrong heading is ever flagged good.

    python benchmarks/attacks                               300 mistakes and 150 harmless changes by seed 1
    python benchmarks/attacks --kind local --count 60 --seed 7
    python benchmarks/attacks --only local-heading_stuck-017    one case, or all of one attack
    python benchmarks/attacks --nulls 48 --older ../main    flags 1 lost in moorings without errors

Each case is a copy of a mooring with known truth, or a calibration, with one mistake, processed as ``compass correct``
does. It is *wrong* if its headings flagged 1 have an rms error over 2 degrees and over twice that of the unmodified
case, and their stated 95 % intervals contain the truth for under 85 % or over 1 % of the errors exceed 6 sigma.
A wrong case is *silent* if it has no warning, finding or verdict that the unmodified one did not have, and is *called
good* if more than half of the original flags 1 are still set, regardless of warnings. A harmless change *harms* if it
is refused, if over 1 % of the samples lose their flag 1, or if there is a new warning. Rows are stored in ``--into`` by
a hash of the library, and an interrupted run continues from them; use another folder if the attacks were changed. The
exit status is 1 if any case was silent, called good, or ended in a traceback.
"""

from __future__ import annotations

import argparse
import hashlib
import multiprocessing
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # also of the processes that are spawned
sys.path.append(str(Path(__file__).resolve().parents[1]))  # last: attacks has a calibrations of its own

import bases
import cases
import numpy as np
import targets
from runs import ONE_THREAD, PROJECT

Row = dict[str, Any]


def label(library: Path) -> str:
    """Compose the name of a checkout with a hash of its code."""
    code = b"".join(path.read_bytes() for path in sorted((library / "compasslib").rglob("*.py")))
    return f"{library.name}-{hashlib.sha256(code).hexdigest()[:10]}"


def in_processes(cores: int, work: Callable[..., Any], arguments: Iterable[tuple[Any, ...]]) -> list[Any]:
    """Call a function in new processes; return the results in the order of the arguments."""
    with ProcessPoolExecutor(cores, mp_context=multiprocessing.get_context("spawn")) as pool:
        futures = [pool.submit(work, *each) for each in arguments]
        for done, _ in enumerate(as_completed(futures), 1):
            targets.progress(f"{work.__name__}: {done} of {len(futures)}   ")
        print(file=sys.stderr)
        return [future.result() for future in futures]


def write_bases(wanted: list[bases.Base], into: Path, cores: int) -> None:
    """Simulate, by this checkout, the moorings that do not exist yet."""
    absent = [base for base in wanted if not (into / f"{base.name}.npy").exists()]
    if absent:
        into.mkdir(parents=True, exist_ok=True)
        in_processes(cores, bases.write, [(base, into) for base in absent])


def run(chosen: list[cases.Case], into: Path, cores: int) -> list[Row]:
    """Process the cases that have no rows yet, and return all rows."""
    here, kept = into / label(PROJECT), into / "bases"
    write_bases(bases.available(), kept, cores)
    in_processes(cores, cases.untouched, [(base, kept, here / "untouched") for base in bases.available()])
    return in_processes(cores, cases.attempt, [(case, kept, here / "cases") for case in chosen])


def run_nulls(count: int, seed: int, old: Path, into: Path, cores: int) -> None:
    """Process moorings without errors here and by an older checkout; print how many flags 1 were lost."""
    wanted, kept = bases.nulls(count, seed), into / "bases"
    write_bases(wanted, kept, cores)
    folders = [into / label(library) / "nulls" for library in (PROJECT, old)]
    in_processes(cores, cases.untouched, [(base, kept, folders[0]) for base in wanted])
    in_processes(cores, cases.untouched_by_workflow, [(base, kept, folders[1], old) for base in wanted])
    groups: dict[str, list[tuple[int, int]]] = {}
    lost_of = {base.name: lost(*(folder / base.name / "made/errors.npz" for folder in folders)) for base in wanted}
    for name, pair in lost_of.items():
        groups.setdefault(name.rsplit("-", 1)[0].removeprefix("null-"), []).append(pair)
    targets.head("nothing wrong", "moorings", "flags 1 with right headings", "lost now", "moorings that lost over 1 %")
    for name, pairs in [*sorted(groups.items()), ("all", list(lost_of.values()))]:
        before, gone = (sum(pair[k] for pair in pairs) for k in (0, 1))
        many = [pair for pair in pairs if pair[1] > cases.HARM * max(pair[0], 1)]
        share = f"{gone / before:.2%}" if before else "–"
        targets.line(name, len(pairs), before, f"{gone} ({share})", targets.text_of(len(many), len(pairs)))
    for name, (before, gone) in lost_of.items():
        if gone > cases.HARM * max(before, 1):
            print(f"  {name}: {gone} of {before}; {folders[0] / name}")


def lost(new: Path, old: Path) -> tuple[int, int]:
    """Count the samples with correct headings that an older library flagged 1, and those not flagged 1 any more.

    A heading is correct if its error is within 3 sigma as stated by the older library, or within 2 degrees.
    """
    if not old.exists():
        return 0, 0
    with np.load(old) as before:
        right = np.abs(before["error_deg"]) <= np.maximum(3.0 * before["sigma_deg"], 2.0)
        kept = np.rint(before["time_s"][(before["flag"] == 1) & right])
    if not new.exists():
        return len(kept), len(kept)
    with np.load(new) as after:
        still = np.rint(after["time_s"][after["flag"] == 1])
    return len(kept), int((~np.isin(kept, still)).sum())


def way(row: Row) -> str:
    """Classify the outcome of a case."""
    if row.get("crashed"):
        return "traceback"
    if row["refused"]:
        return "refused"
    if row["wrong"]:
        return "silent" if row["silent"] else "wrong, warned"
    return "warned or flagged" if row["hurt"] else "right"


def report(rows: list[Row]) -> int:
    """Print the outcome of all cases and return the number that were silent, called good or a traceback."""
    crashed = [row for row in rows if row.get("crashed")]
    mistakes = [row for row in rows if not row["harmless"] and row not in crashed]
    bad = [row for row in mistakes if row["silent"] or row["called_good"]]
    targets.head("mistakes", "n", "silent", "called good", "refused", "wrong, warned", "warned or flagged", "right")
    for kind in [*dict.fromkeys(row["kind"] for row in mistakes), "all"]:
        some = [row for row in mistakes if kind in (row["kind"], "all")]
        ways = Counter(way(row) for row in some)
        shares = [targets.share_of(row[key] for row in some) for key in ("silent", "called_good")]
        others = [ways[key] for key in ("refused", "wrong, warned", "warned or flagged", "right")]
        targets.line(kind, len(some), *shares, *others)
    decidable = [row for row in mistakes if not row["undecidable"]]
    for what, too in (("without those that no record can tell", False), ("of these, the currents are wrong too", True)):
        print(f"\n{what}:", end="")
        for key in ("silent", "called_good"):
            share = targets.share_of(row[key] and (row["currents_wrong"] or not too) for row in decidable)
            print(f" {key.replace('_', ' ')} {share};", end="")
    print(f"\n\nsilent or called good: {len(bad)}")
    for row in sorted(bad, key=lambda row: row["name"]):
        _print_bad(row)
    print(f"\ntracebacks: {len(crashed)}")
    for row in crashed:
        print(f"  {row['name']}: {row['crashed'][:300]}; {row['folder']}")
    harmless = [row for row in rows if row["harmless"] and row not in crashed]
    for title, key in (("harm", "hurt"), ("of them fewer flags 1", "lost"), ("refused", "refused")):
        print(f"\nharmless changes, {title}: {targets.share_of(row[key] for row in harmless)}", end="")
    print()
    for row in (row for row in harmless if row["hurt"]):
        flags = f"flags 1 {row['untouched']['good']:.2f} -> {row['good']:.2f}; " if row["lost"] else ""
        said = (row["refused"] or " | ".join(row["said"]))[:300]
        print(f"  {row['name']} on {row['on']}: {row['done']}: {flags}{said}")
    print(f"\n{sum(row['cpu_s'] for row in rows) / 60:.0f} CPU minutes")
    return len(bad) + len(crashed)


def _print_bad(row: Row) -> None:
    words = [word for word in ("silent", "called_good", "undecidable") if row[word]]
    words += [] if row["currents_wrong"] else ["currents right"]
    before = row["untouched"]
    print(
        f"  {row['name']} on {row['on']}: {row['done']}\n"
        f"    {', '.join(words).replace('_', ' ')}: rms {row['rms_deg']:.1f} (untouched {before['rms_deg']:.1f}), "
        f"covered {row['covered']:.2f}, beyond 6 sigma {row['far']:.3f}, flag 1 {row['good']:.2f} "
        f"({before['good']:.2f}), {row['verdict']} ({before['verdict']}) {' '.join(row['findings'])}\n"
        f"    {row['folder']}"
    )
    for text in row["said"]:
        print(f"    said: {text[:240]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=300, help="mistakes")
    parser.add_argument("--harmless", type=int, help="harmless changes; half as many by default")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", action="append", choices=cases.KINDS, help="of this kind alone; may be given again")
    parser.add_argument("--only", help="the case, or all cases of the attack, of this name")
    parser.add_argument("--nulls", type=int, help="process so many moorings with nothing wrong instead")
    parser.add_argument("--older", type=Path, help="checkout with which these are compared")
    parser.add_argument("--into", type=Path, default=PROJECT / "results/attacks", help="folder of rows and wrong cases")
    parser.add_argument("--cores", type=int, default=2)
    asked = parser.parse_args()
    os.environ |= ONE_THREAD
    into = asked.into.resolve()
    if asked.nulls:
        if not asked.older:
            parser.error("--nulls needs --older, a checkout to compare with")
        run_nulls(asked.nulls, asked.seed, asked.older.resolve(), into, asked.cores)
        return
    drawn = cases.draw(asked.count, asked.count // 2 if asked.harmless is None else asked.harmless, asked.seed)
    chosen = [case for case in drawn if asked.only in (None, case.name, case.attack)]
    chosen = [case for case in chosen if not asked.kind or case.kind in asked.kind]
    sys.exit(1 if report(run(chosen, into, asked.cores)) else 0)


if __name__ == "__main__":
    main()
