"""Two terms at once: what neither shows alone, because the other hides it, the two together may show."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from compasslib.discrepancy import scan
from compasslib.discrepancy.scan import THINNEST, Tested

Floats = NDArray[np.floating]


def test(alone: Tested) -> Tested:
    """Return the test of all terms together with another one, each at the score of its best couple.

    The noise of a couple is that of its noisier half, or what the draws make of it, if that is more. Two dated terms
    are no couple: a slip and a step at any two dates feign too much.

    Args:
        alone: the test of the terms one by one.
    """
    ends = np.cumsum(alone.freedom).astype(int)
    parts = [np.arange(end - int(freedom), end) for end, freedom in zip(ends, alone.freedom, strict=True)]
    score, highest = np.full(len(parts), -np.inf), np.full(len(alone.drawn), -np.inf)
    for a, b in itertools.combinations(range(len(parts)), 2):
        if not _couple(alone, a, b):
            continue
        pull, drawn = _together(alone, np.concatenate([parts[a], parts[b]]))
        freedom, handicap = np.array(float(len(pull))), float(max(alone.handicap[a], alone.handicap[b]))
        noise = np.sum(drawn**2, axis=1)
        inflation = float(noise.mean() / freedom)
        highest = np.maximum(highest, scan.normal_score(noise / inflation, freedom) - handicap)
        inflation = max(inflation, alone.inflation[a], alone.inflation[b])
        seen = float(scan.normal_score(np.sum(pull**2) / inflation, freedom)) - handicap
        score[[a, b]] = np.maximum(score[[a, b]], seen)
    return replace(alone, score=score, highest=highest)


def _couple(alone: Tested, a: int, b: int) -> bool:
    first, second = alone.groups[a].term, alone.groups[b].term
    if first is None or second is None or type(first) is type(second):
        return False
    return not (first.dated() and second.dated())


def _together(alone: Tested, index: NDArray[np.intp]) -> tuple[Floats, Floats]:
    """Return data and draws along the directions that the columns span together, (d,) and (r, d)."""
    values, vectors = np.linalg.eigh(alone.gram[np.ix_(index, index)].astype(float))
    kept = values > max(THINNEST * values[-1], 1e-5)
    turned = vectors[:, kept] / np.sqrt(values[kept])
    return alone.pull[index] @ turned, alone.drawn[:, index] @ turned
