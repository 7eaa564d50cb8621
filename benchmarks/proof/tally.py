"""Counts the rows of a proof: shares with their intervals, sizes, errors."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.proof import score

Row = dict[str, Any]

BINS_DEG = (0.0, 0.7, 1.0, 1.5, 2.0, 3.0, 99.0)
NEAR_DEG = 0.3
HEADINGS = ("before", "after", "sampled", "five", "oracle")


def measures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the table of shares: what, how many of how many, the 95 % interval."""
    known = _of(rows, *score.KNOWN)
    named = [row for row in known if row["sets"]]
    alone = [row for row in named if all(len(one) == 1 for one in row["sets"])]
    strange, shifted, doubt = (_of(rows, kind) for kind in ("strange", "shifted", "undecidable"))
    quiet, noisy, locked = (_of(rows, kind) for kind in score.QUIET)
    table = [
        _share("nothing planted: falsely named", quiet, lambda row: bool(row["sets"])),
        _share("nothing planted: falsely unexplained", quiet, lambda row: row["outcome"] == "false alarm"),
        _share("doubled noise: named or unexplained", noisy, lambda row: row["outcome"] != "right"),
        _share("sphere turned by the lower water: named or unexplained", locked, lambda row: row["outcome"] != "right"),
        _share("effects of the catalogue: seen", known, seen),
        _share("all that was planted is among the names", known, covered),
        _share("the same, of those where anything is named", named, covered),
        _share("the same, of those where every name stands alone", alone, covered),
        _share("a name that has nothing to do with it", named, has_false_name),
        _share("unexplained beside the names", named, lambda row: row["unexplained"] is not None),
        _share(
            "out of the catalogue: unexplained or composed",
            strange,
            lambda row: row["outcome"] in ("right", "name beside"),
        ),
        _share("out of the catalogue: a bare name", strange, lambda row: row["outcome"] == "bare name"),
        _share("shifted temperature: temperature named first", shifted, lambda row: "temperature" in _first(row)),
        _share("shifted temperature: temperature among the names", shifted, lambda row: "temperature" in _every(row)),
        _share("undecidable: doubt, with the truth in it", doubt, lambda row: row["outcome"] == "right"),
        _share("undecidable: guessed", doubt, lambda row: row["outcome"] in ("guessed", "wrong name")),
        _share("all: as a perfect tool would say", rows, lambda row: row["points"] == 1.0),
    ]
    return [one for one in table if one["count"]]


def numbers(rows: Sequence[Row]) -> dict[str, Any]:
    """Return sizes of sets, errors of parameters and dates, gains, and errors of headings."""
    named = [row for row in _of(rows, *score.KNOWN) if row["sets"]]
    z = {clocks: _errors(rows, clocks=clocks) for clocks in (False, True)}
    dates = [abs(value) for row in rows for value in row["dates_d"]]
    gains = [row["gain"] for row in rows if row["gain"] is not None]
    return {
        "names_in_a_set": _mean([len(one) for row in named for one in row["sets"]]),
        "z": z[False],
        "z_clocks": z[True],
        "dates": {"count": len(dates), "median_d": _median(dates), "largest_d": max(dates, default=None)},
        "gain": {"count": len(gains), "median": _median(gains)},
        "headings": {group: _headings(some) for group, some in _groups(rows).items()},
    }


def power(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return how many single effects were seen and named, by their visible size."""
    single = _of(rows, "single")
    result = []
    for low, high in itertools.pairwise(BINS_DEG):
        some = [row for row in single if low <= row["visible_deg"][0] < high]
        if some:
            part = {"from_deg": low, "to_deg": high, "count": len(some)}
            result.append(part | {"seen": sum(map(seen, some)), "named": sum(map(covered, some))})
    return result


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return by what was planted alone how often each name came first."""
    result: dict[str, Counter[str]] = {}
    for row in _of(rows, "single", "undecidable", *score.UNNAMED):
        planted = row["truth"][0] if row["kind"] not in score.UNNAMED else "(out of the catalogue)"
        said = row["sets"][0][0] if row["sets"] else "(unexplained)" if row["unexplained"] else "(nothing)"
        result.setdefault(planted, Counter())[said] += 1
    for row in _of(rows, *score.QUIET):
        said = row["sets"][0][0] if row["sets"] else "(unexplained)" if row["unexplained"] else "(nothing)"
        result.setdefault("(nothing)", Counter())[said] += 1
    return {name: dict(sorted(counts.items())) for name, counts in sorted(result.items())}


def seen(row: Row) -> bool:
    """Tell whether anything was found."""
    return bool(row["sets"]) or row["unexplained"] is not None


def covered(row: Row) -> bool:
    """Tell whether all that was planted is among the names."""
    return set(row["truth"]) <= _every(row)


def has_false_name(row: Row) -> bool:
    """Tell whether a finding holds nothing of what was planted."""
    return any(not set(one) & set(row["truth"]) for one in row["sets"])


def _errors(rows: Sequence[Row], *, clocks: bool) -> dict[str, Any]:
    """Return errors of parameters in their own standard errors, of clocks or of all others."""
    every = [(name, value) for row in rows for name, value in row["z"].items()]
    z = [value for name, value in every if name.startswith("clock") == clocks]
    return {"count": len(z), "rms": _rms(z), "within_196": _mean([abs(value) < 1.96 for value in z])}


def _groups(rows: Sequence[Row]) -> dict[str, list[Row]]:
    known = _of(rows, *score.KNOWN)
    return {
        "nothing planted": _of(rows, *score.QUIET),
        "effects of the catalogue": known,
        "of these, seen": [row for row in known if seen(row)],
        "out of the catalogue": _of(rows, *score.UNNAMED),
    }


def _headings(rows: Sequence[Row]) -> dict[str, Any]:
    """Return pooled errors of the heading: by the fit alone, of the product, and what nobody can beat."""
    some = [row for row in rows if row["before_deg"] is not None and row["after_deg"] is not None]
    near = {k: [row["after_deg"] <= row[f"{k}_deg"] + NEAR_DEG for row in some] for k in ("sampled", "oracle")}
    return {
        "count": len(some),
        **{f"{key}_deg": _rms([row[f"{key}_deg"] for row in some]) for key in HEADINGS},
        **{f"near_{key}": _mean(holds) for key, holds in near.items()},
        "covered_95": _mean([row["covered_95"] for row in some]),
    }


def _share(what: str, rows: Sequence[Row], holds: Callable[[Row], bool]) -> dict[str, Any]:
    hits = sum(map(holds, rows))
    interval = list(score.limits(hits, len(rows))) if rows else None
    return {"what": what, "hits": hits, "count": len(rows), "interval": interval}


def _of(rows: Iterable[Row], *kinds: str) -> list[Row]:
    return [row for row in rows if row["kind"] in kinds]


def _every(row: Row) -> set[str]:
    return {name for one in row["sets"] for name in one}


def _first(row: Row) -> set[str]:
    return {one[0] for one in row["sets"]}


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _rms(values: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else None
