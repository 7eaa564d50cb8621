"""The command: draw, seal, run, open, score, write."""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmarks.proof import card, figures, measure, recordings, run, sampled, score, seal
from compasslib.simulation import draw

CONFIG = "moorings: config/moorings\n"


def main(given: Sequence[str] | None = None) -> int:
    """Make one proof.

    Args:
        given: arguments; those of the command line where absent.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.proof", description=__doc__)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--count", type=int, default=24, help="moorings")
    parser.add_argument("--hours", type=int, default=8800, help="of each record")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--work", type=Path, default=Path("build/proof"), help="where cruise and truth stand")
    parser.add_argument("--out", type=Path, default=Path("results/proof"), help="where the scorecard is written")
    parser.add_argument("--no-published", dest="published", action="store_false", help="leave the paper's case out")
    parser.add_argument("--no-recordings", dest="recordings", action="store_false", help="leave real recordings out")
    asked = parser.parse_args(given)
    try:
        prove(asked)
    except seal.Broken as broken:
        print(f"error: {broken}", file=sys.stderr)
        return 1
    print((asked.out / "scorecard.md").read_text())
    return 0


def prove(asked: argparse.Namespace) -> None:
    """Draw moorings, seal their truth, run the pipeline, and score.

    Args:
        asked: seed, count and places.
    """
    cruise, locked = asked.work / "cruise", asked.work / "locked"
    names, took = _made(asked, cruise, locked), {}
    took["run"] = _timed(lambda: run.pipeline(cruise.resolve(), run.targets(names), asked.cores))
    keep(asked.out, cruise, names)
    real = asked.work / "recordings"
    if asked.recordings:
        took["recordings"] = _timed(lambda: recordings.run(real, asked.cores))
    took["score"] = _timed(lambda: write(asked.out, cruise, locked, recordings.rows(real) if asked.recordings else ()))
    (asked.out / "times.json").write_text(json.dumps(took | {"jobs": card.jobs(cruise)}, indent=1) + "\n")


def _made(asked: argparse.Namespace, cruise: Path, locked: Path) -> list[str]:
    """Write cruise and truth, publish the hash of the truth, and return the names."""
    for folder in (cruise, locked):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
    drawn = draw.draw(asked.seed, asked.count, asked.hours)
    for one in drawn:
        draw.write(one, cruise, locked)
    (cruise / "config").mkdir(exist_ok=True)
    (cruise / "config/config.yaml").write_text(CONFIG)
    if asked.published:
        draw.write_published(asked.seed, cruise, locked)
    said = {"seed": asked.seed, "count": asked.count, "hours": asked.hours}
    seal.publish(asked.out / "seal.json", locked, locked.iterdir(), **said)
    return [path.stem for path in sorted((cruise / "config/moorings").glob("*.yaml"))]


def keep(out: Path, cruise: Path, names: Sequence[str]) -> None:
    """Write the hashes of what the pipeline left, before anything is opened."""
    files = [cruise / "results" / name / file for name in names for file in run.SCORED]
    seal.publish(out / "left.json", cruise, files)


def write(out: Path, cruise: Path, locked: Path, concealed: Sequence[list[str]] = ()) -> dict[str, Any]:
    """Open the truth if all hashes hold, score, and write the card.

    Args:
        out: folder of the scorecard, with the published hashes.

    Raises:
        seal.Broken: truth or results were changed.
    """
    seal.check(out / "seal.json", locked, seal.TRUTH_CHANGED)
    seal.check(out / "left.json", cruise, seal.RESULTS_CHANGED)
    truths = {path.stem: json.loads(path.read_text()) for path in sorted(locked.glob("*.json"))}
    rows = []
    for name, truth in truths.items():
        left = measure.results(cruise, name)
        heads: dict[str, Any] = dict(measure.headings(cruise, locked, name, left["deviation"]))
        heads["sampled_deg"] = sampled.error_deg(cruise, locked, name, left["deviation"])
        rows.append(score.row(name, truth, left["diagnosis"], heads))
    paper = None
    if (locked / "published.csv").exists():
        cases = {"found": draw.PUBLISHED, "series": draw.SERIES}
        paper = {what: measure.published(cruise, locked, name) for what, name in cases.items()}
    sealed = json.loads((out / "seal.json").read_text()) | {"code": measure.software(cruise, next(iter(truths)))}
    made = card.content(sealed, list(truths.values()), rows, paper, concealed)
    figures.write(out / "figures", made)
    card.write(out, made)
    return made


def _timed(job: Callable[[], object]) -> float:
    begin = time.perf_counter()
    job()
    return round(time.perf_counter() - begin, 1)


if __name__ == "__main__":
    sys.exit(main())
