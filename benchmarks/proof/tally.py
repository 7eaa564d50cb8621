"""Count the rows of a proof: rates with intervals, scores, probabilities, errors of headings, targets."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np

from benchmarks import targets
from benchmarks.proof import score
from benchmarks.targets import Measured

Row = dict[str, Any]
Truths = dict[str, dict[str, Any]]  # of moorings, by name; so diagnoses

EDGES = (0.0, 0.05, 0.2, 0.5, 0.8, 0.95, 1.001)  # of stated probabilities
NEAR_DEG, WORSE_DEG = 0.3, 0.1
HEADINGS = ("before", "after", "published", "sampled", "five", "oracle")
SURE = 0.95  # probability from which something is stated
EASY_DEG = 2.0  # visible size of an effect that most records show
FAULT, NAMED = "fault of compass or clock", "effect named"  # what probabilities are stated of
PLACES = ("all", "simulated water", "real records", "stand-in reference")


@dataclass(frozen=True)
class Rate:
    """How many of some cases hold, and the target of this share where there is one."""

    what: str
    cases: list[Row]
    holds: Callable[[Row], bool]
    target: dict[str, float] = field(default_factory=dict)


def rates(rows: Sequence[Row]) -> list[Rate]:
    """List every rate of the scorecard with its cases."""
    no_fault, listed = _of(rows, *score.QUIET), _of(rows, *score.KNOWN)
    single, strange, shifted, undecidable = (_of(rows, x) for x in ("single", "strange", "shifted", "undecidable"))
    named = [row for row in listed if row["sets"]]
    lone = [row for row in named if all(len(one) == 1 for one in row["sets"])]
    of_one = [row for row in single if [len(one) for one in row["sets"]] == [1]]
    names, driven = _statements(rows, "effect"), _statements(rows, "effect", "driver", side="compass")
    stated = sum(one["probability"] for one in names) / max(len(names), 1)
    beside = {*score.CURRENT, "clock_offset", "clock_drift"}  # that do not act on the compass
    large = [row for row in single if row["visible_deg"][0] >= EASY_DEG and not {*row["right"][0]} & beside]
    detectable, corrected = _detectable_effects(rows, "single"), [row for row in rows if _whole(row)]
    blamed, above = "attributed to compass or clock", "above its stated detection limit"
    mistimed = "temperature logged at wrong times"
    return [
        Rate(f"no fault: {blamed}", no_fault, falsely, {"most": 0.02}),
        Rate(f"no fault, real records: {blamed}", _at(no_fault, PLACES[2]), falsely, {"most": 0.02}),
        Rate("no fault: unexplained", no_fault, _outcome("false alarm"), {"most": 0.02}),
        Rate("no fault: attributed to the current", no_fault, lambda row: "water" in row["found_sides"]),
        *(Rate(f"{QUIET[kind]}: {blamed}", _of(rows, kind), falsely) for kind in score.QUIET),
        Rate("listed effects: detected", listed, seen),
        Rate("listed effects: all among the names", listed, covered),
        Rate("listed effects, any named: all among the names", named, covered),
        Rate("listed effects, each finding of one name: all correct", lone, covered),
        Rate("listed effects, any named: a finding unrelated to them", named, unrelated),
        Rate("one listed effect, one name: correct", of_one, covered, {"least": 0.92}),
        Rate(f"effects stated at {SURE:g} ({stated:.3f} on average): correct", names, itemgetter("right"),
             {"least": max(0.93, round(stated - 0.02, 3))}),
        Rate(f"drivers of the compass stated at {SURE:g}: correct", driven, itemgetter("driver_right"),
             {"least": 0.96}),
        Rate(f"one effect of {EASY_DEG:g}° or more on the compass: stated", large, _by_name),
        Rate(f"one effect of {EASY_DEG:g}° or more on the compass: its driver stated", large, _by_driver),
        Rate(f"one effect {above}: named", detectable, itemgetter("named")),
        Rate(f"one effect {above}: stated", detectable, _by_name, {"least": 0.6}),
        Rate(f"one effect {above}: its driver stated", detectable, _by_driver, {"least": 0.85}),
        Rate(f"one of two effects {above}: named", _detectable_effects(rows, "pair"), itemgetter("named")),
        Rate(f"effect of {EASY_DEG:g}° or more on the current: stated", list(filter(_veered, listed)),
             lambda row: bool(row["current"]), {"least": 0.8}),
        Rate("unlisted effects: unexplained or composed", strange, _outcome("right", "name beside")),
        Rate("unlisted effects: attributed to a listed one", strange, _outcome("bare name"), {"most": 0.07}),
        Rate("unlisted effects: wrong drivers only", strange, _misled, {"most": 0.07}),
        Rate("unlisted effects, detected: correct driver first", list(filter(seen, strange)),
             lambda row: bool(row["stated"]) and row["stated"][0]["driver_right"]),
        Rate(f"{mistimed}: temperature first", shifted,
             lambda row: "temperature" in {one[0] for one in row["sets"]}, {"most": 0.05}),
        Rate(f"{mistimed}: attributed to a listed effect", shifted, _outcome("bare name")),
        Rate("undecidable: the true effect among several names", undecidable, _outcome("right")),
        Rate("undecidable: attributed to one effect", undecidable, _outcome("guessed", "wrong name"), {"most": 0.1}),
        Rate("all: diagnosis entirely correct", list(rows), lambda row: row["points"] == 1.0, {"least": 0.58}),
        Rate("all: too few data for a diagnosis", list(rows), _outcome("refused")),
        Rate(f"all: headings improved by over {WORSE_DEG}° on the fit", corrected, better),
        Rate(f"all: headings worsened by over {WORSE_DEG}° from the fit", corrected, worse, {"most": 0.04}),
    ]  # fmt: skip


def measures(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Count every rate: of all, simulated and real moorings how many of how many."""
    made = []
    for rate in filter(lambda rate: rate.cases, rates(rows)):
        some = {place: _at(rate.cases, place) for place in PLACES}
        made.append({"what": rate.what} | {k: [int(sum(map(rate.holds, x))), len(x)] for k, x in some.items()})
    return made


QUIET = {
    "null": "no effect", "noisy": "doubled noise", "turned": "sphere that turns by itself",
    "veering": "slow directional shear of 2 to 4°", "reference": "errors of the reference's compass 1.5 times as large",
    "rolled": "real record, covariates shifted in time", "mirrored": "real record in mirror image",
}  # fmt: skip


def points(truths: Truths, diagnoses: Truths) -> dict[str, Any]:
    """Compute the mean score of every tool by place, and the lead of this one with its 95 % interval."""
    made = {}
    for name, tool in score.TOOLS.items():
        each = np.array([score.points(truths[k], tool(truths[k], diagnoses[k])) for k in truths])
        where = np.array([score.place(one) for one in truths.values()])
        made[name] = {"each": each, "all": _mean(each)} | {one: _mean(each[where == one]) for one in PLACES[1:]}
    own = made[score.OWN]["each"]
    for one in made.values():
        each = one.pop("each")
        one["ahead"] = targets.resampled(own - each, lambda some: some.mean(axis=-1))
    return made


def probabilities(rows: Sequence[Row]) -> dict[str, Any]:
    """Score stated probabilities beside the base rate (Brier and log score), and bin them for a reliability diagram.

    Moorings with a stand-in reference are left out, as for all rates with a target.
    """
    rows = [row for row in rows if row["place"] != PLACES[-1]]
    compass = [[row["of_compass"]] for row in rows if row["of_compass"]]
    return {FAULT: _forecast(compass), NAMED: _forecast([row["of_names"] for row in rows if row["of_names"]])}


def _forecast(groups: Sequence[Sequence[Sequence[float]]]) -> dict[str, Any]:
    """Score forecasts by Brier's (1950) and the logarithmic rule (Good 1952), those of one mooring together."""
    if not groups:
        return {"count": 0}
    mooring = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    stated, came = np.array([one for group in groups for one in group]).T
    base = came.mean()
    rules = {
        "brier": lambda p: (p - came) ** 2,
        "log": lambda p: -np.log(np.maximum(np.where(came > 0.0, p, 1.0 - p), score.WORST)),
    }
    made = {"count": came.size, "moorings": len(groups), "share": float(base)}
    for name, rule in rules.items():
        own, of_base, count = (np.bincount(mooring, x) for x in (rule(stated), rule(base), came**0))
        gain = lambda some, a=own, b=of_base, n=count: (b - a)[some].sum(axis=-1) / n[some].sum(axis=-1)  # noqa: E731
        better = targets.resampled(np.arange(len(groups)), gain)
        made[name] = {"own": own.sum() / count.sum(), "share": of_base.sum() / count.sum(), "better": better}
    return made | {"bins": _bins(stated, came)}


def _bins(stated: np.ndarray, came: np.ndarray) -> list[dict[str, Any]]:
    found = []
    for low, high in itertools.pairwise(EDGES):
        inside = (stated >= low) & (stated < high)
        if inside.any():
            hits, count = int(came[inside].sum()), int(inside.sum())
            found.append({"stated": float(stated[inside].mean()), "hits": hits, "count": count})
    return found


def headings(rows: Sequence[Row]) -> dict[str, Any]:
    """Pool the errors of the heading: of the fit, the product, the published series, and at best."""
    known = _of(rows, *score.KNOWN)
    groups = {
        "no fault": _of(rows, *score.QUIET),
        "listed effects": known,
        "of these, detected": [row for row in known if seen(row)],
        "unlisted effects, mistimed temperature": _of(rows, *score.UNNAMED),
        **{place: _at(rows, place) for place in PLACES[1:]},
    }
    pooled = {}
    for name, some in groups.items():
        some = [row for row in some if _whole(row)]
        pooled[name] = {
            "count": len(some),
            **{f"{key}_deg": _rms(row[f"{key}_deg"] for row in some) for key in HEADINGS},
            "near_sampled": _mean([row["after_deg"] <= row["sampled_deg"] + NEAR_DEG for row in some]),
            "worse": _mean([worse(row) for row in some]),
            "covered_95": _mean([row["covered_95"] for row in some]),
        }
    return pooled


def goals(rows: Sequence[Row], scored: dict[str, Any], stated: dict[str, Any]) -> list[Measured]:
    """Compare what was measured with every target, moorings with a stand-in reference left out."""
    rows = [row for row in rows if row["place"] != PLACES[-1]]
    found = [
        targets.share(rate.what, map(rate.holds, rate.cases), **rate.target) for rate in rates(rows) if rate.target
    ]
    exactly = {"least": 0.95, "most": 0.95}
    for what, kinds, target in (
        ("all", {row["kind"] for row in rows}, exactly),
        ("no fault", score.QUIET, exactly),
        ("listed effects", score.KNOWN, exactly),
        ("unlisted effects", ("strange",), {"least": 0.9}),
    ):
        covers = [row["covered_95"] for row in _of(rows, *kinds) if row["covered_95"] is not None]
        if covers:
            what = f"headings within their 95 % interval: {what}"
            found.append(targets.mean(what, covers, **target, percent=True))
    found += [
        _ahead(f"score above that of: {tool}", one["ahead"])
        for tool, one in scored.items()
        if tool not in (score.OWN, score.PERFECT) and one["ahead"]
    ]
    found += [
        _ahead(f"{what}: {name} better than the base rate's", one[rule]["better"])
        for what, one in stated.items()
        if one["count"]
        for rule, name in (("brier", "Brier score"), ("log", "log score"))
        if one[rule]["better"]
    ]
    return [one for one in found if one.value != "–"]


def _ahead(what: str, interval: Sequence[float]) -> Measured:
    low, high = interval
    return Measured(what, f"{low:+.3f} to {high:+.3f}", low, high, least=0.0, target="> 0")


def _statements(rows: Sequence[Row], *levels: str, side: str | None = None) -> list[Row]:
    """Select the statements of findings at some levels, on one side or any, with the place of each mooring."""
    return [
        one | {"place": row["place"]}
        for row in rows
        for one in row["stated"]
        if one["level"] in levels and side in (None, one["side"])
    ]


def _detectable_effects(rows: Sequence[Row], kind: str) -> list[Row]:
    """List, for every planted effect above the detection limit of its record, the row and whether it is named."""
    found = []
    for row in _of(rows, kind):
        for names, size, limit in zip(row["right"], row["visible_deg"], row["limits_deg"], strict=True):
            if limit is not None and size > limit:
                named = any(score.right(name, {"right": names}) for each in row["sets"] for name in each)
                found.append(row | {"named": named})
    return found


def _outcome(*names: str) -> Callable[[Row], bool]:
    return lambda row: row["outcome"] in names


falsely = _outcome("false name")  # compass or clock were blamed where nothing was wrong with them
covered = _outcome("right", "in the set", "one too many")  # all that was planted is among the names


def _veered(row: Row) -> bool:
    effects = zip(row["right"], row["visible_deg"], strict=True)
    return any(size >= EASY_DEG and {*names} & {*score.CURRENT} for names, size in effects)


def _by_name(row: Row) -> bool:
    return any(one["right"] and one["level"] == "effect" for one in row["stated"])


def _by_driver(row: Row) -> bool:
    return any(one["driver_right"] and one["level"] in ("effect", "driver") for one in row["stated"])


def _misled(row: Row) -> bool:
    """Return whether there are findings, none of which has a right driver, and nothing is left unexplained."""
    return bool(row["stated"]) and row["unexplained"] is None and not any(one["driver_right"] for one in row["stated"])


def seen(row: Row) -> bool:
    """Return whether anything was found, in the current too where the effect acts on it."""
    return bool(row["sets"]) or row["unexplained"] is not None or covered(row)


def unrelated(row: Row) -> bool:
    """Return whether a finding has none of the planted effects among its names."""
    effects = [{"right": names} for names in row["right"]]
    return row["outcome"] == "one too many" or any(
        not any(score.right(name, one) for one in effects for name in each) for each in row["sets"]
    )


def worse(row: Row) -> bool:
    """Return whether the product's headings are worse than those of the fit alone."""
    return row["after_deg"] > row["before_deg"] + WORSE_DEG


def better(row: Row) -> bool:
    """Return whether the product's headings are better than those of the fit alone."""
    return row["after_deg"] < row["before_deg"] - WORSE_DEG


def _whole(row: Row) -> bool:
    return all(row[key] is not None for key in ("before_deg", "after_deg", "sampled_deg"))


def _at(rows: Sequence[Row], place: str) -> list[Row]:
    return [row for row in rows if place in ("all", row["place"])]


def _of(rows: Iterable[Row], *kinds: str) -> list[Row]:
    return [row for row in rows if row["kind"] in kinds]


def _mean(values: Sequence[float] | np.ndarray) -> float | None:
    return float(np.mean(values)) if len(values) else None


def _rms(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None
