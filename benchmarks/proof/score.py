"""Judges diagnoses against opened truths: pure functions of what stands in the files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from typing import Any

import numpy as np

QUIET = ("null", "noisy", "locked")  # nothing is planted
UNNAMED = ("strange", "shifted")  # what is planted has no name that would be right
KNOWN = ("single", "pair")
CATALOGUE = (
    "heeling", "hard_iron_drift", "hard_iron_step", "battery_change", "temperature", "supply_voltage", "sextantal",
    "octantal", "heading_slip", "compass_drift", "compass_lag", "tilt_uncompensated", "stuck_tilt", "current_veer",
    "clock_offset", "clock_drift", "field_disturbance", "mooring_motion", "large_deviation", "declination_error",
)  # fmt: skip
FEWEST_NAMES = 2  # in a set that doubts
DAY_S = 86400.0


def sets(diagnosis: dict[str, Any]) -> list[list[str]]:
    """Return the names of each finding, the best first."""
    return [[one["effect"], *one["alternatives"]] for one in diagnosis["findings"]]


def judge(truth: dict[str, Any], diagnosis: dict[str, Any]) -> str:
    """Return in a few words how a diagnosis stands to the truth."""
    named, left = sets(diagnosis), diagnosis["unexplained"] is not None
    if truth["kind"] in QUIET:
        return "false name" if named else "false alarm" if left else "right"
    if not named and not left:
        return "refused" if diagnosis["verdict"] == "insufficient" else "missed"
    if truth["kind"] in UNNAMED:
        listed = [each for each in named if not all(name.startswith("composed") for name in each)]
        told = left or len(listed) < len(named)  # what is composed says that no listed effect does it
        return "bare name" if not told else "name beside" if listed else "right"
    if truth["kind"] == "undecidable":
        return _doubt(truth, named, left)
    return _name(truth, named)


def _name(truth: dict[str, Any], named: list[list[str]]) -> str:
    wanted = {one["name"] for one in truth["effects"]}
    met = [wanted & set(each) for each in named]
    found = set().union(*met)
    if not named:
        return "unexplained"
    if not found:
        return "wrong name"
    if found != wanted:
        return "half"
    if not all(met):
        return "one too many"
    return "in the set" if any(len(each) > 1 for each in named) else "right"


def _doubt(truth: dict[str, Any], named: list[list[str]], left: bool) -> str:
    """Where nobody can know, a lone name is a guess, even the right one."""
    wanted = {one["name"] for one in truth["effects"]}
    holds = any(wanted & set(each) and len(each) >= FEWEST_NAMES for each in named)
    if holds or (left and not named):
        return "right"
    return "guessed" if wanted & {name for each in named for name in each} else "wrong name"


def points(truth: dict[str, Any], diagnosis: dict[str, Any]) -> float:
    """Return 1 for what a perfect tool would say, less for every name too many, 0 for what is wrong."""
    outcome, named = judge(truth, diagnosis), sets(diagnosis)
    if truth["kind"] in QUIET or truth["kind"] in UNNAMED:
        return {"right": 1.0, "name beside": 0.5}.get(outcome, 0.0)
    if truth["kind"] == "undecidable":
        if outcome != "right" or not named:
            return 0.0 if outcome != "right" else 0.5 if truth["rivals"] else 1.0
        return min(1.0, max(FEWEST_NAMES, 1 + len(truth["rivals"])) / sum(map(len, named)))
    wanted = [one["name"] for one in truth["effects"]]
    worth = [max((1.0 / len(each) for each in named if name in each), default=0.0) for name in wanted]
    false = sum(not set(each) & set(wanted) for each in named)
    return float(np.mean(worth)) * len(wanted) / (len(wanted) + false)


def row(name: str, truth: dict[str, Any], diagnosis: dict[str, Any], heads: dict[str, Any]) -> dict[str, Any]:
    """Return one mooring's line of the scorecard."""
    left = diagnosis["unexplained"]
    return {
        "name": name,
        "kind": truth["kind"],
        "wide": truth["wide"],
        "truth": [one["name"] for one in truth["effects"]],
        "visible_deg": [round(one["visible_deg"], 2) for one in truth["effects"]],
        "background_deg": truth["background_deg"],
        "verdict": diagnosis["verdict"],
        "sets": sets(diagnosis),
        "unexplained": None if left is None else [left["where"]["text"], round(left["rms_effect_deg"], 2)],
        "negligible": [one["effect"] for one in diagnosis.get("negligible", [])],
        "outcome": judge(truth, diagnosis),
        "points": points(truth, diagnosis),
        "z": _z(truth, diagnosis),
        "dates_d": _dates(truth, diagnosis),
        "gain": _gain(truth, diagnosis),
        "why": why(truth, diagnosis),
        "five_deg": truth["five_deg"],
        "oracle_deg": truth["oracle_deg"],
        **heads,
    }


def why(truth: dict[str, Any], diagnosis: dict[str, Any]) -> str:
    """Return what the diagnosis itself says of effects that it did not name."""
    if diagnosis["verdict"] == "insufficient":
        return str(diagnosis["why"])
    named = {name for each in sets(diagnosis) for name in each}
    untested = {one["effect"]: one["why"] for one in diagnosis.get("not_testable", [])}
    small = {one["effect"]: one["rms_effect_deg"] for one in diagnosis.get("negligible", [])}
    needed = diagnosis.get("detectable_deg", {})
    said = []
    for name in (name for name in _names(truth) if name not in named and truth["kind"] in (*KNOWN, "undecidable")):
        if name in untested:
            said.append(f"{name}: not testable, {untested[name]}")
        elif name in small:
            said.append(f"{name}: seen as {small[name]:.2f}°, too small to matter")
        elif name in needed:
            said.append(f"{name}: this record shows {needed[name]:.1f}° nine times in ten")
    return "; ".join(said)


def _names(truth: dict[str, Any]) -> list[str]:
    return [one["name"] for one in truth["effects"]]


def _matched(truth: dict[str, Any], diagnosis: dict[str, Any]) -> Iterable[tuple[dict[str, Any], dict[str, Any]]]:
    """Give the planted effects with the finding that names them first."""
    for one in truth["effects"]:
        for finding in diagnosis["findings"]:
            if finding["effect"] == one["name"]:
                yield one, finding
                break


def _z(truth: dict[str, Any], diagnosis: dict[str, Any]) -> dict[str, float]:
    """Return errors of parameters in their own standard errors, where truth and finding speak of the same ones."""
    result = {}
    for one, finding in _matched(truth, diagnosis):
        for name, value in one["parameters"].items():
            got = finding["parameters"].get(name)
            if name != "date_s" and got is not None and got["sigma"] > 0.0:
                result[f"{one['name']}.{name}"] = (got["value"] - value) / got["sigma"]
    return result


def _dates(truth: dict[str, Any], diagnosis: dict[str, Any]) -> list[float]:
    """Return by how many days the date of a step was missed."""
    return [
        (datetime.fromisoformat(finding["when"]["from"]).timestamp() - one["parameters"]["date_s"]) / DAY_S
        for one, finding in _matched(truth, diagnosis)
        if "date_s" in one["parameters"]
    ]


def _gain(truth: dict[str, Any], diagnosis: dict[str, Any]) -> float | None:
    """Return the variance that held-out days gave back, over what was planted; compass and water only."""
    planted = sum(one["visible_deg"] ** 2 for one in truth["effects"])
    clocks = any(name.startswith("clock") for name in _names(truth))
    if not diagnosis["findings"] or not planted or clocks or truth["kind"] not in KNOWN:
        return None
    proofs = [one["heldout"] for one in diagnosis["findings"]]
    return float(sum(p["rms_before_deg"] ** 2 - p["rms_after_deg"] ** 2 for p in proofs) / planted)


def always_unexplained(_: dict[str, Any]) -> dict[str, Any]:
    """Return what a tool says that calls everything unexplained."""
    left = {"where": {"text": "somewhere"}, "rms_effect_deg": 1.0}
    return {"verdict": "unexplained", "findings": [], "unexplained": left}


def whole_catalogue(_: dict[str, Any]) -> dict[str, Any]:
    """Return what a tool says that lists every effect there is."""
    finding = {"effect": CATALOGUE[0], "alternatives": list(CATALOGUE[1:]), "parameters": {}}
    return {"verdict": "ambiguous", "findings": [finding], "unexplained": None}


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """Return what a tool says that knows the truth."""
    if truth["kind"] in QUIET:
        return {"verdict": "consistent", "findings": [], "unexplained": None}
    if truth["kind"] in UNNAMED or (truth["kind"] == "undecidable" and not truth["rivals"]):
        return always_unexplained(truth)
    findings = [{"effect": n, "alternatives": list(truth["rivals"]), "parameters": {}} for n in _names(truth)]
    return {"verdict": "ambiguous" if truth["rivals"] else "explained", "findings": findings, "unexplained": None}


def mean_points(truths: Sequence[dict[str, Any]], tool: Callable[[dict[str, Any]], dict[str, Any]]) -> float:
    """Return the mean points of a tool that answers from the truth, or without looking.

    Args:
        truths: of all moorings.
        tool: from truth to diagnosis.
    """
    return float(np.mean([points(truth, tool(truth)) for truth in truths]))


def limits(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Clopper and Pearson 1934)."""
    from scipy.special import betaincinv

    low = 0.0 if hits == 0 else float(betaincinv(hits, count - hits + 1, 0.025))
    high = 1.0 if hits == count else float(betaincinv(hits + 1, count - hits, 0.975))
    return low, high
