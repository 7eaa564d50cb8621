"""Draw moorings, seal their truth, process and score them. An interrupted run resumes where it stopped."""

import argparse
import json
import multiprocessing
import os
import shutil
import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

from benchmarks import runs
from benchmarks.proof import card, score, seal, tally
from benchmarks.proof.headings import heading_errors
from benchmarks.proof.world import draw, records
from compasslib.pipeline.process import process_mooring

SCORED = ("corrected.nc", "diagnosis.json", "deviation.json")
KEPT = (*SCORED, "overlap.nc")
TASKS = 20  # per process before it is replaced, to limit the growth of memory


def main(given: Sequence[str] | None = None) -> int:
    """Run one proof; return exit status 1 if a target is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.proof", description=__doc__)
    parser.add_argument("--frozen", default="HEAD", metavar="REV", help="commit that gives the seed (HEAD)")
    parser.add_argument("--seed", type=int, help="another seed, chosen by hand; the scorecard says so")
    parser.add_argument("--count", type=int, default=16, help="moorings in simulated water (16)")
    parser.add_argument("--real", type=int, help="moorings in the water of real records (half as many)")
    parser.add_argument("--hours", type=int, default=8800, help="of each record in simulated water (8800)")
    parser.add_argument(
        "--second", action="store_true", help="the second world: internal waves, a leaning string, no real water"
    )
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--data", type=Path, default=runs.DATA, help="folder of recordings (../shared/data)")
    parser.add_argument("--work", type=Path, default=Path("build/proof"), help="folder of moorings and truth")
    parser.add_argument("--out", type=Path, default=Path("build/proof"), help="folder of the scorecard")
    asked = parser.parse_args(given)
    work = asked.work.resolve()
    try:
        names = draw_sealed(asked, metadata(asked), work)
        wanted = [name for name in names if not (work / "results" / name).exists()]
        each(partial(process, work), wanted, asked.cores, "run")
        left = [work / "results" / name / file for name in names for file in (*SCORED, "stopped.txt")]
        seal.publish(asked.out / "left.json", work, filter(Path.exists, left))
        made = write(asked.out, work)
    except seal.Broken as broken:
        print(f"error: {broken}", file=sys.stderr)
        return 1
    print((asked.out / "targets.csv").read_text())
    print(f"The truth is in {work / 'locked'}; the whole card in {asked.out}.")
    return int(any(one["missed"] for one in made["goals"]))


def metadata(asked: argparse.Namespace) -> dict[str, Any]:
    """Compose what is published with the hash of the truth: seed and its origin, counts, hashes of code."""
    by_hand = asked.seed is not None
    known = () if asked.second else records.described(asked.data)
    there = {one.name: one.stands_in for one in known if one.there}
    real = (asked.count // 2 if asked.real is None else asked.real) if there else 0
    origin = "chosen by hand" if by_hand else f"commit {seal.commit(asked.frozen)} and the sealed families"
    return {
        "seed": asked.seed if by_hand else seal.seed(asked.frozen), "seed_of": origin,
        "count": asked.count, "real": real, "hours": asked.hours, "records": there, "second": asked.second,
        "families": seal.families(), "commit": seal.commit(),
    }  # fmt: skip


def draw_sealed(asked: argparse.Namespace, said: dict[str, Any], work: Path) -> list[str]:
    """Simulate all moorings, publish the hash of the truth, and return their names.

    Raises:
        seal.Broken: if the folder contains another proof, or its truth was changed.
    """
    locked, begun, published = work / "locked", work / "begun.json", asked.out / "seal.json"
    locked.mkdir(parents=True, exist_ok=True)
    if begun.exists() and json.loads(begun.read_text()) != said:
        raise seal.Broken(f"{work} holds another proof: delete it, or name another --work")
    begun.write_text(json.dumps(said, indent=1) + "\n")
    counts = (said["count"], said["real"])
    made = draw.draw(said["seed"], counts, said["hours"], said["records"], second=said["second"])
    drawn = {one.name: one for one in made}
    if not published.exists() or not (work / "sealed").exists():
        wanted = [name for name in drawn if not (locked / f"{name}.json").exists()]
        each(partial(_draw, drawn, work, asked.data), wanted, asked.cores, "draw")
        seal.publish(published, locked, locked.iterdir(), **said)
        (work / "sealed").touch()
    seal.check(published, locked, seal.TRUTH_CHANGED)
    return list(drawn)


def _draw(drawn: dict[str, draw.Drawn], work: Path, data: Path, name: str) -> tuple[str, str]:
    draw.write(drawn[name], work / "cruises" / name, work / "locked", data)
    return name, ""


def process(work: Path, name: str) -> tuple[str, str]:
    """Run the stages of the workflow on one mooring, without an interpreter for each; return why it stopped if so."""
    folder = work / "results" / name
    try:
        process_mooring(work / "cruises" / name, name, folder)
    except Exception as error:  # a mooring that stops is scored as such
        wrong = f"{type(error).__name__}: {error}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "stopped.txt").write_text(wrong + "\n")
        return name, wrong
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name not in KEPT:
            path.unlink()
    return name, ""


def each(job: Callable[[str], tuple[str, str]], names: Sequence[str], cores: int, what: str) -> None:
    """Run a job for every mooring in new processes, with messages of its progress and of what stopped."""
    with (
        mock.patch.dict(os.environ, runs.ONE_THREAD),  # of the new processes
        multiprocessing.get_context("spawn").Pool(cores, maxtasksperchild=TASKS) as pool,
    ):
        for done, (name, wrong) in enumerate(pool.imap_unordered(job, names), 1):
            stopped = f", {name} stopped: {wrong}" if wrong else ""
            print(f"{what}: {done} of {len(names)}{stopped}", file=sys.stderr, flush=True)


def write(out: Path, work: Path) -> dict[str, Any]:
    """Check all hashes, unseal the truth, score, and write the scorecard.

    Raises:
        seal.Broken: if truth or results were changed.
    """
    locked, results = work / "locked", work / "results"
    seal.check(out / "seal.json", locked, seal.TRUTH_CHANGED)
    seal.check(out / "left.json", work, seal.RESULTS_CHANGED)
    truths = {path.stem: json.loads(path.read_text()) for path in sorted(locked.glob("*.json"))}
    diagnoses = {name: diagnosis(results / name) for name in truths}
    rows = [
        score.row(name, truth, diagnoses[name], heading_errors(results / name, locked / f"{name}.npy"))
        for name, truth in truths.items()
    ]
    sealed = json.loads((out / "seal.json").read_text())
    scored, stated = tally.points(truths, diagnoses), tally.probabilities(rows)
    goals = tally.goals(rows, scored, stated)
    made = {
        "seal": {key: value for key, value in sealed.items() if key != "files"},
        "goals": [{"what": g.what, "value": g.value, "target": g.target, "missed": not g.held} for g in goals],
        "points": scored,
        "measures": tally.measures(rows),
        "probabilities": stated,
        "headings": tally.headings(rows),
        "moorings": rows,
    }
    card.write(out, made)
    return made


def diagnosis(results: Path) -> dict[str, Any]:
    """Read the diagnosis of a mooring; for one that stopped, construct one with the verdict ``stopped``."""
    stopped = results / "stopped.txt"
    if stopped.exists():
        return {"verdict": "stopped", "findings": [], "unexplained": None, "why": stopped.read_text().strip()}
    found: dict[str, Any] = json.loads((results / "diagnosis.json").read_text())
    return found
