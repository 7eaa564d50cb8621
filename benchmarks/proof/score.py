"""Score diagnoses against unsealed truths, by pure functions of the content of files."""

from collections.abc import Callable
from typing import Any

import numpy as np

from compasslib.effects import SIDES

QUIET = ("null", "noisy", "turned", "veering", "reference", "rolled", "mirrored")  # nothing is wrong with the compass
UNNAMED = ("strange", "shifted")  # no name in the catalogue is right for the planted effect
KNOWN = ("single", "pair")
CURRENT = ("current_veer", "mooring_motion", "beam_gain", "velocity_bias")  # effects reported under ``current``
LIKE = {"moving_iron": "heeling"}  # a magnet that swings with tilt has the same effect as vertical iron
FIELD = "field_forward field_starboard field_down"
# A composed effect is equivalent to a name if it acts at the same place and has the same driver.
SAME = {
    "hard_iron_drift": (FIELD, "time"), "hard_iron_step": (FIELD, "time"), "battery_change": (FIELD, "time voltage"),
    "temperature": (f"{FIELD} reading", "temperature"), "supply_voltage": (f"{FIELD} reading", "voltage"),
    "heading_slip": ("reading", "time"), "compass_drift": ("reading", "time"), "sextantal": ("lobe3", "heading"),
    "octantal": ("lobe4", "heading"), "current_veer": ("flow_direction", "speed depth flow_direction"),
    "tilt_uncompensated": (FIELD, "pitch roll tilt"), "heeling": (FIELD, "pitch roll tilt"),
    "compass_lag": ("reading", "turn_rate"), "field_disturbance": ("north", "observatory time"),
}  # fmt: skip
# Drivers of other effects, including those outside the catalogue.
DRIVERS = {
    "hysteresis": "heading turn_rate", "rolling_shackle": "tilt", "neighbour": "time", "chirp": "time",
    "crackle": "time", "strumming": "speed", "detent": "heading", "thermal_shock": "temperature",
    "leak": "time heading", "warm_and_fast": "temperature speed", "summer_noon": "hour time",
    "fine_teeth": "heading", "lost_chain": "time",
    "stuck_tilt": "tilt time", "clock_offset": "time", "clock_drift": "time",
}  # fmt: skip
OWN, PERFECT, WHOLE = "this pipeline", "perfect knowledge", "always the whole catalogue"  # tools that are scored
FEWEST_NAMES = 2  # of a set that expresses doubt
WORST = 1e-4  # lower limit of probabilities in scores


def sets(diagnosis: dict[str, Any]) -> list[list[str]]:
    """List the names of each finding, best first, with composed effects spelt out."""
    return [[first(one), *one["alternatives"]] for one in diagnosis["findings"]]


def scorable(truth: dict[str, Any], diagnosis: dict[str, Any]) -> list[dict[str, Any]]:
    """List the findings that are right or wrong.

    Every reference is drawn with iron of its own, or is a real instrument: `reference_deviation` is neither right nor
    wrong unless it was planted.
    """
    planted = truth["kind"] == "reference" or any("reference_deviation" in one["right"] for one in truth["effects"])
    return [one for one in diagnosis["findings"] if planted or one["effect"] != "reference_deviation"]


def named_sets(truth: dict[str, Any], diagnosis: dict[str, Any]) -> list[list[str]]:
    """List the names of each scorable finding, and a right name where a planted effect on the current is stated.

    Real currents at two depths always differ: if no such effect was planted, the statement is neither right nor wrong.
    """
    found = sets({"findings": scorable(truth, diagnosis)})
    planted = [name for one in truth["effects"] for name in one["right"] if name in CURRENT]
    return [*found, planted[:1]] if planted and diagnosis.get("current") else found


def first(finding: dict[str, Any]) -> str:
    """Compose the name of a finding in the form of its alternatives."""
    made = finding.get("composition")
    return f"composed:{made['acts_on']}/{made['driver']}/{made['form']}" if made else str(finding["effect"])


def says(name: str, wanted: str) -> bool:
    """Return whether a name, possibly a composed one, is equivalent to a wanted one."""
    if not name.startswith("composed:"):
        return wanted in (name, LIKE.get(name))
    acts, driver, _ = name.removeprefix("composed:").split("/")
    places, drivers = SAME.get(wanted, ("", ""))
    return acts in places.split() and driver in drivers.split()


def right(name: str, effect: dict[str, Any]) -> bool:
    """Return whether a name is right for a planted effect."""
    return any(says(name, wanted) for wanted in effect["right"])


def judge(truth: dict[str, Any], diagnosis: dict[str, Any]) -> str:
    """Classify a diagnosis by comparison with the truth."""
    named, left = named_sets(truth, diagnosis), diagnosis["unexplained"] is not None
    if diagnosis["verdict"] in ("insufficient", "stopped"):
        return "refused"
    if truth["kind"] in QUIET:
        return "false name" if _accused(diagnosis) else "false alarm" if left else "right"
    if not named and not left:
        return "missed"
    if truth["kind"] in UNNAMED:
        listed = [each for each in named if not all(name.startswith("composed") for name in each)]
        told = left or len(listed) < len(named)  # a composed name states that no listed effect explains it
        return "bare name" if not told else "name beside" if listed else "right"
    held = [[any(right(name, one) for name in each) for one in truth["effects"]] for each in named]  # by set and effect
    if truth["kind"] == "undecidable":  # even a right name is a guess if it is the only one
        met = [each for each, of in zip(named, held, strict=True) if any(of)]
        if any(len(each) >= FEWEST_NAMES for each in met) or (left and not named):
            return "right"
        return "guessed" if met else "wrong name"
    if not named:
        return "unexplained"
    found = [any(of) for of in zip(*held, strict=True)]
    if not all(found):
        return "half" if any(found) else "wrong name"
    if not all(map(any, held)):
        return "one too many"
    return "in the set" if any(len(each) > 1 for each in named) else "right"


def _accused(diagnosis: dict[str, Any]) -> bool:
    """Return whether a fault of compass, clock or reference is named, other than the deviation of every reference."""
    named = [one for one in diagnosis["findings"] if one["effect"] != "reference_deviation"]
    return any(one.get("side", "compass") != "water" for one in named)


def points(truth: dict[str, Any], diagnosis: dict[str, Any]) -> float:
    """Score a diagnosis: 1 for that of a perfect tool, less for each superfluous name, 0 for a wrong one."""
    outcome, named = judge(truth, diagnosis), named_sets(truth, diagnosis)
    if truth["kind"] in (*QUIET, *UNNAMED):
        return {"right": 1.0, "name beside": 0.5}.get(outcome, 0.0)
    if truth["kind"] == "undecidable":
        if outcome != "right" or not named:
            return 0.0 if outcome != "right" else 0.5 if truth["rivals"] else 1.0
        return min(1.0, max(FEWEST_NAMES, 1 + len(truth["rivals"])) / sum(map(len, named)))
    share = [[np.mean([right(name, one) for name in each]) for each in named] for one in truth["effects"]]
    false = sum(not any(of) for of in zip(*share, strict=True))
    return float(sum(max(of, default=0.0) for of in share) / (len(share) + false))


def row(name: str, truth: dict[str, Any], diagnosis: dict[str, Any], heads: dict[str, Any]) -> dict[str, Any]:
    """Compute one mooring's row of the scorecard."""
    left = diagnosis["unexplained"]
    return {
        "name": name,
        "kind": truth["kind"],
        "water": truth["water"],
        "real": truth["real"],
        "place": place(truth),
        "wide": truth["wide"],
        "truth": [one["name"] for one in truth["effects"]],
        "right": [one["right"] for one in truth["effects"]],
        "visible_deg": [round(one["visible_deg"], 2) for one in truth["effects"]],
        "verdict": diagnosis["verdict"],
        "reported": sets(diagnosis),
        "sets": sets({"findings": scorable(truth, diagnosis)}),
        "sides": diagnosis.get("sides", {}),
        "found_sides": [one.get("side", "compass") for one in diagnosis["findings"]],
        "unexplained": None if left is None else [left["where"]["text"], round(left["rms_effect_deg"], 2)],
        "outcome": judge(truth, diagnosis),
        "points": points(truth, diagnosis),
        "of_compass": at_fault(truth, diagnosis),
        "of_names": names(truth, diagnosis),
        "stated": [statement(one, truth) for one in scorable(truth, diagnosis)],
        "current": [one["level"] for one in diagnosis.get("current", [])],
        "limits_deg": [limit_deg(one, diagnosis) for one in truth["effects"]],
        "five_deg": truth["five_deg"],
        "oracle_deg": truth["oracle_deg"],
        **heads,
    }


def place(truth: dict[str, Any]) -> str:
    """Name the kind of water of a mooring, and whether its reference is a real instrument."""
    if not truth["real"]:
        return "simulated water"
    return "stand-in reference" if truth["stands_in"] else "real records"


def at_fault(truth: dict[str, Any], diagnosis: dict[str, Any]) -> list[float] | None:
    """Compute the stated probability of a fault of compass or clock, and whether there is one (1 or 0)."""
    sides = diagnosis.get("sides")
    if not sides:
        return None
    stated = sides.get("compass", 0.0) + sides.get("clock", 0.0)
    return [round(float(stated), 6), float(any(one["side"] in ("compass", "clock") for one in truth["effects"]))]


def names(truth: dict[str, Any], diagnosis: dict[str, Any]) -> list[list[float]]:
    """List for every name its stated probability, and whether it is right (1 or 0).

    Without a fault of the compass, names of the water are right; the right names of one set are counted together.
    """
    given = []
    for one in scorable(truth, diagnosis):
        stated = {first(one): one.get("probability", 1.0)} | one.get("alternatives_probability", {})
        held = {name: _true(name, one, truth) for name in stated}
        together = [p for name, p in stated.items() if held[name]]
        given += [[round(float(min(sum(together), 1.0)), 6), 1.0]] if together else []
        given += [[round(float(p), 6), 0.0] for name, p in stated.items() if not held[name]]
    return given


def _true(name: str, finding: dict[str, Any], truth: dict[str, Any]) -> bool:
    if any(right(name, one) for one in truth["effects"]):
        return True
    if truth["kind"] in UNNAMED:
        return name.startswith("composed")
    return truth["kind"] in QUIET and not _accused({"findings": [finding]})


def statement(finding: dict[str, Any], truth: dict[str, Any]) -> dict[str, Any]:
    """Extract the most specific statement of a finding, its probability, and whether name and driver are right.

    A driver that is a product counts for both factors.
    """
    driver = str(finding.get("driver") or "")
    return {
        "level": finding.get("level"),
        "probability": finding.get("level_probability"),
        "side": finding.get("side", "compass"),
        "right": _true(first(finding), finding, truth),
        "driver_right": bool(_axes(driver.replace("*", " ")) & set().union(*map(drivers, truth["effects"]))),
    }


def drivers(effect: dict[str, Any]) -> set[str]:
    """List the drivers of a planted effect, with pitch and roll as tilt."""
    listed = [SAME[name][1] if name in SAME else DRIVERS.get(name, "") for name in effect["right"] or [effect["name"]]]
    return _axes(" ".join(listed))


def _axes(listed: str) -> set[str]:
    return {"tilt" if name in ("pitch", "roll") else name for name in listed.split()}


def limit_deg(effect: dict[str, Any], diagnosis: dict[str, Any]) -> float | None:
    """Look up the detection limit that a diagnosis states for an effect, degrees; None if it states none."""
    said = [diagnosis.get("detectable_deg", {}).get(name) for name in effect["right"]]
    return min((one for one in said if one is not None), default=None)


# Tools for comparison, which ignore the data or do not attribute.

Tool = Callable[[dict[str, Any], dict[str, Any]], dict[str, Any]]


def said(*findings: list[str], left: bool = False) -> dict[str, Any]:
    """Construct a diagnosis that names sets of effects."""
    found = [{"effect": one[0], "alternatives": list(one[1:]), "side": "compass"} for one in findings]
    rest = {"where": {"text": "somewhere"}, "rms_effect_deg": 1.0} if left else None
    verdict = "unexplained" if left else "explained" if found else "consistent"
    return {"verdict": verdict, "findings": found, "unexplained": rest}


def seen(diagnosis: dict[str, Any]) -> bool:
    """Return whether anything was found."""
    return bool(diagnosis["findings"]) or diagnosis["unexplained"] is not None


def perfect(truth: dict[str, Any]) -> dict[str, Any]:
    """Construct the diagnosis of a tool that knows the truth."""
    if truth["kind"] in QUIET:
        return said()
    if truth["kind"] in UNNAMED or (truth["kind"] == "undecidable" and not truth["rivals"]):
        return said(left=True)
    return said(*([one["right"][0], *truth["rivals"]] for one in truth["effects"]))


TOOLS: dict[str, Tool] = {  # with which the pipeline is compared
    "no attribution (as the published method)": lambda truth, own: said(),
    "always unexplained": lambda truth, own: said(left=True),
    WHOLE: lambda truth, own: said(list(SIDES)),
    "same detections, no attribution": lambda truth, own: said(left=seen(own)),
    OWN: lambda truth, own: own,
    PERFECT: lambda truth, own: perfect(truth),
}
