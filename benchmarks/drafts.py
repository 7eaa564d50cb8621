"""Texts and binaries, drawn by seed and genuine, each drafted by ``compass init``: right, asked or wrong.

Asked means that the draft leaves a unit or a key of the table to a person (DECIDE), or says that the header is not
known. What no instrument left must be named as what it is.

python benchmarks/drafts.py [SEED] [N]
"""

import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))
import drafts


def main(seed: int = 1, n: int = 40) -> int:
    """Print each file's outcome and how many there are of each; return 1 where a draft is wrong."""
    counts: Counter[str] = Counter()
    for case in [*drafts.drawn(seed, n), *drafts.genuine()]:
        result, said = drafts.outcome(case)
        counts[result] += 1
        print(f"{result:6s} {case.name:38s} {said[:150] if result != 'wrong' else said}")
    print(f"{sum(counts.values())} files: {counts['right']} right, {counts['asked']} asked, {counts['wrong']} wrong")
    return int(counts["wrong"] > 0)


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
