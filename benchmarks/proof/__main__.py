"""Draw moorings, seal their truth, process and score them. An interrupted run resumes where it stopped."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from benchmarks.proof import run, standing, steps
from benchmarks.proof.world import draw

DATA = standing.PROJECT.parent / "shared" / "data"


def main(given: Sequence[str] | None = None) -> int:
    """Run one proof; return exit status 1 if a target is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.proof", description=__doc__)
    parser.add_argument("--commit", nargs="?", const="HEAD", metavar="REV", help="print the seed of a commit, and exit")
    parser.add_argument("--frozen", default="HEAD", metavar="REV", help="commit that gives the seed (HEAD)")
    parser.add_argument("--seed", type=int, help="another seed, chosen by hand; the scorecard says so")
    parser.add_argument("--count", type=int, default=16, help="moorings in simulated water (16)")
    parser.add_argument("--real", type=int, help="moorings in the water of real records (half as many)")
    parser.add_argument("--hours", type=int, default=8800, help="of each record in simulated water (8800)")
    parser.add_argument(
        "--second", action="store_true", help="the second world: internal waves, a leaning string, no real water"
    )
    parser.add_argument("--kind", choices=sorted({*draw.MADE, *draw.REAL}), help="moorings of one kind only")
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--data", type=Path, default=DATA, help="folder of recordings (../shared/data)")
    parser.add_argument("--records", type=Path, help="folder with descriptions of more real records")
    parser.add_argument("--work", type=Path, default=Path("build/proof"), help="folder of moorings and truth")
    parser.add_argument("--out", type=Path, default=Path("build/proof"), help="folder of the scorecard")
    asked = parser.parse_args(given)
    try:
        if asked.commit:
            print(standing.explained(asked.commit))
            return 0
        return prove(asked)
    except standing.Broken as broken:
        print(f"error: {broken}", file=sys.stderr)
        return 1


def prove(asked: argparse.Namespace) -> int:
    """Draw moorings, seal their truth, run the pipeline, score, and print the card."""
    work = asked.work.resolve()
    names = steps.make(asked, steps.said(asked), work)
    wanted = [name for name in names if not (work / "results" / name).exists()]
    run.each(partial(steps.correct, work), wanted, asked.cores, "run")
    standing.publish(asked.out / "left.json", work, [f for name in names for f in steps.left(work / "results" / name)])
    made = steps.write(asked.out, work)
    print((asked.out / "targets.csv").read_text())
    print(f"The truth is in {work / 'locked'}; the whole card in {asked.out}.")
    return int(any(one["missed"] for one in made["goals"]))


if __name__ == "__main__":
    sys.exit(main())
