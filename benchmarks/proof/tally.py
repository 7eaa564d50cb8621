"""Counts the rows of a proof: shares with their intervals, points, probabilities, errors of headings, targets."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks import targets
from benchmarks.proof import score
from benchmarks.targets import Measured

Row = dict[str, Any]
Truths = dict[str, dict[str, Any]]  # of moorings, by name; so diagnoses

BINS_DEG = (0.0, 0.7, 1.0, 1.5, 2.0, 3.0, 99.0)
EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.001)  # of stated probabilities
NEAR_DEG, WORSE_DEG = 0.3, 0.1
HEADINGS = ("before", "after", "published", "sampled", "five", "oracle")
SURE = 0.95  # probability from which something is stated
EASY_DEG = 2.0  # visible size of an effect that most records show
SHARES_AT_FAULT = (0.1, 0.3, 0.75)  # to which the score of faults is weighted
PLACES = ("all", "made water", "real records", "reference stands in")


def measures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the table of shares: what, and of all, made and real moorings how many of how many."""
    return [
        {"what": what} | {place: [int(sum(map(holds, some))), len(some)] for place, some in _places(chosen).items()}
        for what, chosen, holds in _questions(rows)
        if chosen
    ]


def _questions(rows: Sequence[Row]) -> list[tuple[str, list[Row], Callable[[Row], bool]]]:
    known = _of(rows, *score.KNOWN)
    strange, shifted, doubt = (_of(rows, kind) for kind in ("strange", "shifted", "undecidable"))
    named = [row for row in known if row["sets"]]
    alone = [row for row in named if all(len(one) == 1 for one in row["sets"])]
    quiet = [(f"{QUIET[kind]}: compass or clock named", _of(rows, kind), falsely) for kind in score.QUIET]
    told = ("right", "name beside")
    names, driven = _statements(rows, "effect"), _statements(rows, "effect", "driver", side="compass")
    large = [row for row in _of(rows, "single") if row["visible_deg"][0] >= EASY_DEG and _acts_on_compass(row)]
    planted = _single_effects(rows)
    veered, whole = [row for row in known if _veered(row)], [row for row in rows if _whole(row)]
    return [
        ("nothing wrong with the compass, all kinds: compass or clock named", _of(rows, *score.QUIET), falsely),
        ("the same: unexplained, nothing named", _of(rows, *score.QUIET), lambda row: row["outcome"] == "false alarm"),
        ("the same: the water named", _of(rows, *score.QUIET), lambda row: "water" in row["found_sides"]),
        *quiet,
        ("effects with a name: seen", known, seen),
        ("all that was planted is among the names", known, covered),
        ("the same, of those where anything is named", named, covered),
        ("the same, of those where every name stands alone", alone, covered),
        (f"names stated at {SURE:g}: right", names, lambda one: one["right"]),
        (f"compass's drivers stated at {SURE:g}: right", driven, lambda one: one["driver_right"]),
        (f"single effect of {EASY_DEG:g}° and more on the compass: stated by name", large, _by_name),
        ("the same: its driver stated", large, _by_driver),
        (
            "each effect above the limit that its record states, alone: among the names",
            [one for one in planted if one["alone"]],
            lambda one: one["named"],
        ),
        ("the same, one of two", [one for one in planted if not one["alone"]], lambda one: one["named"]),
        (f"current of {EASY_DEG:g}° and more: stated", veered, lambda row: bool(row["current"])),
        ("a finding that has nothing to do with it", named, lambda row: row["outcome"] == "one too many" or wrong(row)),
        ("nobody listed it: unexplained or composed", strange, lambda row: row["outcome"] in told),
        ("nobody listed it: a bare name", strange, lambda row: row["outcome"] == "bare name"),
        ("nobody listed it: findings, all with a wrong driver", strange, _misled),
        ("nobody listed it, seen: the right driver first", list(filter(seen, strange)), _driver_first),
        ("temperature shifted in time: temperature named first", shifted, lambda row: "temperature" in _first(row)),
        ("temperature shifted in time: a bare name", shifted, lambda row: row["outcome"] == "bare name"),
        ("undecidable: doubt, with the truth in it", doubt, lambda row: row["outcome"] == "right"),
        ("undecidable: guessed", doubt, lambda row: row["outcome"] in ("guessed", "wrong name")),
        ("all: as a perfect tool would say", list(rows), lambda row: row["points"] == 1.0),
        (f"heading better than by the fit alone, by over {WORSE_DEG}°", whole, better),
        (f"heading worse than by the fit alone, by over {WORSE_DEG}°", whole, worse),
        ("all: refused", list(rows), lambda row: row["outcome"] == "refused"),
    ]


QUIET = {
    "null": "nothing planted", "noisy": "doubled noise", "turned": "sphere that turns by itself",
    "veering": "water that veers slowly, 2 to 4°", "reference": "trusted compass bent by 1 to 2°",
    "rolled": "real record, its log shifted in time", "mirrored": "real record in a mirror",
}  # fmt: skip


def points(truths: Truths, diagnoses: Truths) -> dict[str, Any]:
    """Return the mean points of every tool by place, and by how much this one is ahead, with its 95 % interval."""
    made = {}
    for name, tool in score.tools(list(truths.values())).items():
        each = np.array([score.points(truths[k], tool(truths[k], diagnoses[k])) for k in truths])
        where = np.array([score.place(one) for one in truths.values()])
        made[name] = {"each": each, "all": _mean(each)} | {one: _mean(each[where == one]) for one in PLACES[1:]}
    own = made["this pipeline"]["each"]
    for one in made.values():
        each = one.pop("each")
        one["ahead"] = targets.resampled(own - each, lambda some: some.mean(axis=-1))
    return made


def probabilities(rows: Sequence[Row]) -> dict[str, Any]:
    """Return how good stated probabilities are: Brier and log score beside those of the mere share, and the diagram.

    Where a reference only stands in they are left out, as of all shares that have a target.
    """
    rows = [row for row in rows if row["place"] != PLACES[-1]]
    compass = [[row["of_compass"]] for row in rows if row["of_compass"]]
    mixed = len({came for ((_, came),) in compass}) > 1
    at_fault = {
        f"compass or clock at fault, weighted to a share of {share:g}": _forecast(compass, share)
        for share in SHARES_AT_FAULT
        if mixed
    }
    return {
        "compass or clock at fault": _forecast(compass),
        **at_fault,
        "a name that is given": _forecast([row["of_names"] for row in rows if row["of_names"]]),
    }


def _forecast(groups: Sequence[Sequence[Sequence[float]]], share: float | None = None) -> dict[str, Any]:
    """Score forecasts, those of one mooring together in an interval (Brier 1950; Good 1952).

    Args:
        share: of what came, to which the moorings are weighted; as it is where None.
    """
    if not groups:
        return {"count": 0}
    every = np.array([one for group in groups for one in group])
    came = every[:, 1].mean()
    base = came if share is None else share
    weights = (1.0, 1.0) if share is None else ((1.0 - share) / (1.0 - came), share / came)
    scored = np.array([np.sum([_scores(p, y, base, weights[int(y)]) for p, y in group], axis=0) for group in groups])
    return {
        "count": len(every), "moorings": len(groups), "share": float(base), "weighted": share is not None,
        "brier": _ratio(scored[:, :2], scored[:, 4]), "log": _ratio(scored[:, 2:4], scored[:, 4]),
        "bins": _bins(every) if share is None else [],
    }  # fmt: skip


def _scores(p: float, came: float, base: float, weight: float) -> tuple[float, ...]:
    """Score one forecast and the mere share by Brier's and the logarithmic rule, times a weight, which is last."""
    scores = ((p - came) ** 2, (base - came) ** 2, _surprise(p, came), _surprise(base, came), 1.0)
    return tuple(weight * one for one in scores)


def _surprise(stated: float, came: float) -> float:
    return float(-np.log(max(stated if came else 1.0 - stated, score.WORST)))


def _ratio(pairs: np.ndarray, counts: np.ndarray) -> dict[str, Any]:
    """Return a mean score, that of the share alone, and by how much it is better, with its 95 % interval."""
    own, base = pairs.T
    gained = np.arange(len(own))
    better = targets.resampled(gained, lambda some: (base - own)[some].sum(axis=-1) / counts[some].sum(axis=-1))
    total = counts.sum()
    return {"own": own.sum() / total, "share": base.sum() / total, "better": better}


def _bins(every: np.ndarray) -> list[dict[str, Any]]:
    stated, came = every.T
    found = []
    for low, high in itertools.pairwise(EDGES):
        inside = (stated >= low) & (stated < high)
        if inside.any():
            hits, count = int(came[inside].sum()), int(inside.sum())
            found.append({"stated": float(stated[inside].mean()), "hits": hits, "count": count})
    return found


def headings(rows: Sequence[Row]) -> dict[str, Any]:
    """Return pooled errors of the heading: by the fit alone, of the product, by the published series, at best."""
    known = _of(rows, *score.KNOWN)
    groups = {
        "nothing wrong with the compass": _of(rows, *score.QUIET),
        "effects with a name": known,
        "of these, seen": [row for row in known if seen(row)],
        "nobody listed it": _of(rows, *score.UNNAMED),
        **{place: some for place, some in _places(rows).items() if place in PLACES[1:]},
    }
    return {name: _pooled([row for row in some if _whole(row)]) for name, some in groups.items()}


def _pooled(some: Sequence[Row]) -> dict[str, Any]:
    return {
        "count": len(some),
        **{f"{key}_deg": _rms(row[f"{key}_deg"] for row in some) for key in HEADINGS},
        "near_sampled": _mean([row["after_deg"] <= row["sampled_deg"] + NEAR_DEG for row in some]),
        "worse": _mean([worse(row) for row in some]),
        "covered_95": _mean([row["covered_95"] for row in some]),
    }


def power(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return how many single effects were seen and named, by their visible size."""
    single = _of(rows, "single")
    result = []
    for low, high in itertools.pairwise(BINS_DEG):
        for place, real in (("made", False), ("real", True)):
            some = [row for row in single if low <= row["visible_deg"][0] < high and row["real"] == real]
            if some:
                part = {"from_deg": low, "to_deg": high, "place": place, "count": len(some)}
                result.append(part | {"seen": sum(map(seen, some)), "named": sum(map(covered, some))})
    return result


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return by what was planted alone how often each name came first."""
    result: dict[str, Counter[str]] = {}
    for row in rows:
        if row["kind"] != "pair":
            planted = row["truth"][0] if row["truth"] else f"({row['kind']})"
            said = row["sets"][0][0] if row["sets"] else "(unexplained)" if row["unexplained"] else "(nothing)"
            said = "/".join(said.split("/")[:2]) if said.startswith("composed:") else said
            result.setdefault(planted, Counter())[said] += 1
    return {name: dict(sorted(counts.items())) for name, counts in sorted(result.items())}


def goals(rows: Sequence[Row], scored: dict[str, Any], stated: dict[str, Any]) -> list[Measured]:
    """Return what is asked of the search, each beside what was measured.

    Where a reference only stands in, its water is none that two instruments could measure: targets leave it out.

    Args:
        scored: of ``points``.
        stated: of ``probabilities``.
    """
    rows = [row for row in rows if row["place"] != "reference stands in"]
    quiet, known = _of(rows, *score.QUIET), _of(rows, *score.KNOWN)
    lone = [row for row in _of(rows, "single") if [len(one) for one in row["sets"]] == [1]]
    strange, shifted, doubt = (_of(rows, kind) for kind in ("strange", "shifted", "undecidable"))
    whole = [row for row in rows if _whole(row)]
    names, driven = _statements(rows, "effect"), _statements(rows, "effect", "driver", side="compass")
    mean_stated = sum(one["probability"] for one in names) / max(len(names), 1)
    shares = [
        ("nothing wrong with the compass: compass or clock named", map(falsely, quiet), {"most": 0.02}),
        (
            "the same, real records alone",
            (falsely(row) for row in quiet if row["place"] == "real records"),
            {"most": 0.02},
        ),
        ("the same: unexplained", (row["outcome"] == "false alarm" for row in quiet), {"most": 0.02}),
        (
            f"names stated at {SURE:g}, {100 * mean_stated:.1f} % on the mean: right",
            (one["right"] for one in names),
            {"least": max(0.93, round(mean_stated - 0.02, 3))},
        ),
        (f"compass's drivers stated at {SURE:g}: right", (one["driver_right"] for one in driven), {"least": 0.96}),
        ("all: as a perfect tool would say", (row["points"] == 1.0 for row in rows), {"least": 0.58}),
        ("one effect planted, one name alone: right", map(covered, lone), {"least": 0.92}),
        ("nobody listed it: a bare name", (row["outcome"] == "bare name" for row in strange), {"most": 0.07}),
        ("nobody listed it: findings, all with a wrong driver", map(_misled, strange), {"most": 0.07}),
        (
            f"current of {EASY_DEG:g}° and more: stated",
            (bool(row["current"]) for row in known if _veered(row)),
            {"least": 0.8},
        ),
        ("temperature shifted in time: named first", ("temperature" in _first(row) for row in shifted), {"most": 0.05}),
        ("undecidable: guessed", (row["outcome"] in ("guessed", "wrong name") for row in doubt), {"most": 0.1}),
        (f"heading worse than by the fit alone, by over {WORSE_DEG}°", map(worse, whole), {"most": 0.04}),
    ]
    found = [targets.share(what, values, **goal) for what, values, goal in shares]
    for what, some, goal in (
        ("nothing wrong with the compass", quiet, {"least": 0.95, "most": 0.95}),
        ("listed effects", known, {"least": 0.95, "most": 0.95}),
        ("nobody listed it", strange, {"least": 0.9}),
    ):
        covers = [row["covered_95"] for row in some if row["covered_95"] is not None]
        if covers:
            found.append(targets.mean(f"headings within their 95 %: {what}", covers, **goal, unit=" %", times=100.0))
    found += [
        _ahead(f"points ahead of: {tool}", one["ahead"])
        for tool, one in scored.items()
        if tool not in ("this pipeline", "knows the truth") and one["ahead"]
    ]
    found += [
        _ahead(f"{what}: {rule} score better than the mere share's", one[rule]["better"])
        for what, one in stated.items()
        if one["count"]
        for rule in (("log",) if one["weighted"] else ("brier", "log"))
        if one[rule]["better"]
    ]
    return [one for one in found if one.value != "–"]


def _ahead(what: str, interval: Sequence[float]) -> Measured:
    low, high = interval
    return Measured(what, f"{low:+.3f} to {high:+.3f}", low, high, least=0.0, target="> 0")


def _statements(rows: Sequence[Row], *levels: str, side: str | None = None) -> list[Row]:
    """Return what is stated of findings at some levels, on one side or on any, with the place of each mooring."""
    return [
        one | {"place": row["place"]}
        for row in rows
        for one in row["stated"]
        if one["level"] in levels and side in (None, one["side"])
    ]


def _single_effects(rows: Sequence[Row]) -> list[Row]:
    """Return every planted effect above the limit that its own record states: whether alone, and among the names."""
    found = []
    for row in _of(rows, *score.KNOWN):
        for names, size, limit in zip(row["right"], row["visible_deg"], row["limits_deg"], strict=True):
            if limit is not None and size > limit:
                named = any(score.right(name, {"right": names}) for each in row["sets"] for name in each)
                found.append({"place": row["place"], "alone": row["kind"] == "single", "named": named})
    return found


def _acts_on_compass(row: Row) -> bool:
    return not {*row["right"][0]} & {*score.CURRENT, "clock_offset", "clock_drift"}


def _veered(row: Row) -> bool:
    effects = zip(row["right"], row["visible_deg"], strict=True)
    return any(size >= EASY_DEG and {*names} & {*score.CURRENT} for names, size in effects)


def _by_name(row: Row) -> bool:
    return any(one["right"] and one["level"] == "effect" for one in row["stated"])


def _by_driver(row: Row) -> bool:
    return any(one["driver_right"] and one["level"] in ("effect", "driver") for one in row["stated"])


def _misled(row: Row) -> bool:
    """Tell whether there are findings, none of which has a right driver, and nothing is left unexplained."""
    return bool(row["stated"]) and row["unexplained"] is None and not any(one["driver_right"] for one in row["stated"])


def _driver_first(row: Row) -> bool:
    return bool(row["stated"]) and row["stated"][0]["driver_right"]


def seen(row: Row) -> bool:
    """Tell whether anything was found."""
    return bool(row["sets"]) or row["unexplained"] is not None


def falsely(row: Row) -> bool:
    """Tell whether compass or clock were blamed where nothing was wrong with them."""
    return row["outcome"] == "false name"


def covered(row: Row) -> bool:
    """Tell whether all that was planted is among the names."""
    return row["outcome"] in ("right", "in the set", "one too many")


def wrong(row: Row) -> bool:
    """Tell whether a finding holds nothing of what was planted."""
    effects = [{"right": names} for names in row["right"]]
    return any(not any(score.right(name, one) for one in effects for name in each) for each in row["sets"])


def worse(row: Row) -> bool:
    """Tell whether the product's headings are worse than those of the fit alone."""
    return row["after_deg"] > row["before_deg"] + WORSE_DEG


def better(row: Row) -> bool:
    """Tell whether the product's headings are better than those of the fit alone."""
    return row["after_deg"] < row["before_deg"] - WORSE_DEG


def _whole(row: Row) -> bool:
    return all(row[key] is not None for key in ("before_deg", "after_deg", "sampled_deg"))


def _places(rows: Sequence[Row]) -> dict[str, list[Row]]:
    return {place: [row for row in rows if place in ("all", row["place"])] for place in PLACES}


def _of(rows: Iterable[Row], *kinds: str) -> list[Row]:
    return [row for row in rows if row["kind"] in kinds]


def _first(row: Row) -> set[str]:
    return {one[0] for one in row["sets"]}


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _rms(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None
