"""The covariance of a fitted deviation against a bootstrap over blocks of five days.

    python benchmarks/bootstrap.py CRUISE MOORING [N]    a processed cruise, one mooring, N refits (default 60)

The stated covariance is a jackknife along time plus what flow directions and the wake add; a bootstrap over time shows
the first part only, so that the stated errors should be as large or larger.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from compasslib import deviation
from compasslib.archive import netcdf
from compasslib.core.records import take
from compasslib.deviation.spread import BLOCK_S


def main(cruise: Path, mooring: str, count: int) -> None:
    folder = cruise / "results" / mooring
    pairs = netcdf.read_pairs(folder / "overlap.nc")
    whole = deviation.fit("exact", pairs)
    block = np.floor((pairs.time_s - pairs.time_s[0]) / BLOCK_S).astype(int)
    of_block = [np.flatnonzero(block == b) for b in np.unique(block)]
    rng, found = np.random.default_rng(1), []
    for _ in range(count):
        chosen = rng.integers(0, len(of_block), len(of_block))
        some = take(pairs, np.concatenate([of_block[k] for k in chosen]))
        moved = np.repeat(np.arange(len(chosen)) * BLOCK_S, [len(of_block[k]) for k in chosen])
        some = replace(some, time_s=moved + np.mod(some.time_s - pairs.time_s[0], BLOCK_S))
        found.append(deviation.fit("exact", some, near=whole).coefficients)
    stated, resampled = np.sqrt(np.diag(whole.covariance)), np.std(found, axis=0, ddof=1)
    print(f"{mooring}: {len(pairs)} pairs in {len(of_block)} blocks, {count} refits\n")
    print("| | A | B | C | D | E |\n" + "|---" * 6 + "|")
    for name, row in (("stated", stated), ("bootstrap", resampled), ("stated / bootstrap", stated / resampled)):
        print(f"| {name} | " + " | ".join(f"{x:.4f}" for x in row) + " |")


if __name__ == "__main__":
    given = sys.argv[1:] or [str(Path(__file__).resolve().parents[1]), "EG1"]
    main(Path(given[0]), given[1], int(given[2]) if len(given) > 2 else 60)
