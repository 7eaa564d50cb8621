"""A diagnosis.json in words, for moorings, compasses and calibrations alike: the answer, the findings, the limits."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from compasslib.effects import COMPOSED, meanings
from compasslib.effects.composed import effect_formula
from compasslib.inference import wording
from compasslib.report import sections, words
from compasslib.report.sections import ReportedFinding, ReportTable

MAX_NAMES = 3  # of one finding in the answer; the finding lists all of them
CLAUSES = {
    **wording.PHYSICS,
    "hard_iron": "iron near by adds a constant field",
    "mounting_offset": "the mount turns all headings by a constant",
    "field_disturbance": "magnetic north moved with storms or the daily variation",  # shown by a series, or an index
}


def report_findings(diagnosis: Mapping[str, Any], *, product: bool) -> tuple[ReportedFinding, ...]:
    """Word the findings, strongest first, and after them what stays unexplained.

    Args:
        diagnosis: content of diagnosis.json.
        product: whether there is a corrected record to which a finding may be applied.
    """
    findings = []
    for entry in diagnosis["findings"]:
        parts = entry.get("composition")
        title = words.plain(f"{COMPOSED}{'/'.join(parts.values())}" if parts else entry["effect"])
        given = {"alternatives": candidate_names(entry)[1:], "formula": effect_formula(**parts) if parts else ""}
        facts = words.facts("diagnosis", "facts", e=entry, product=product, **given)
        fitted = sections.table("diagnosis", "parameters", e=entry, known=meanings(entry["effect"]))
        findings.append(ReportedFinding(title[0].upper() + title[1:], entry["text"], facts, next(iter(fitted), None)))
    findings += [ReportedFinding("Current", entry["text"], ()) for entry in diagnosis.get("current") or ()]
    if left := diagnosis["unexplained"]:
        facts = words.facts("diagnosis", "facts", e=left, product=product, alternatives=(), formula="")
        findings.append(ReportedFinding("Unexplained", left["text"], facts))
    return tuple(findings)


def candidate_names(finding: Mapping[str, Any]) -> list[str]:
    """Name the candidates of a finding, the best first: physics, and in brackets its name and probability."""
    chances = {finding["effect"]: finding.get("probability"), **(finding.get("alternatives_probability") or {})}
    if composed := finding.get("composition"):
        chances = {f"{COMPOSED}{'/'.join(composed.values())}": chances.pop(finding["effect"]), **chances}
    texts = []
    for name in dict.fromkeys([*chances, *finding["alternatives"]]):
        chance = chances.get(name)
        sure = [] if chance is None else [f"probability {words.chance(chance)}"]
        if name.startswith(COMPOSED):
            texts.append(" ".join([words.plain(name), *(f"({each})" for each in sure)]))
        else:
            clause = re.split(r" \(|[;:]", CLAUSES.get(name, words.plain(name)))[0]
            texts.append(f"{clause} ({', '.join([words.plain(name), *sure])})")
    return texts


def describe_findings(diagnosis: Mapping[str, Any]) -> str:
    """Summarize the findings beyond the fitted deviation in a clause, with their probabilities."""
    clauses = []
    for names in map(candidate_names, diagnosis["findings"]):
        more = len(names) - MAX_NAMES
        clauses.append(
            " or ".join([*names[:MAX_NAMES], *([f"one of {more} others"] if more > 1 else names[MAX_NAMES:])])
        )
    return words.paragraphs("diagnosis", "findings", d=diagnosis, clauses=clauses)[0]


def describe_limits(diagnosis: Mapping[str, Any]) -> tuple[str, ...]:
    """List what the recording cannot show, and what would."""
    reasons: dict[str, dict[str, None]] = {}
    for entry in diagnosis["not_testable"]:
        reasons.setdefault(entry["effect"], {})[words.sentence(entry["why"])] = None
    tested = {entry["effect"] for entry in diagnosis.get("hypotheses") or []}  # in another form
    closed: dict[tuple[bool, str], list[str]] = {}
    for effect, whys in reasons.items():
        closed.setdefault((effect in tested, " ".join(whys)), []).append(words.plain(effect))
    untested = [(partly, effects, why) for (partly, why), effects in closed.items()]
    return words.paragraphs("diagnosis", "limits", d=diagnosis, untested=untested)


def hypotheses_table(diagnosis: Mapping[str, Any]) -> tuple[ReportTable, ...]:
    """Tabulate the single effects that were tested, the best first; no table where none was."""
    return sections.table("diagnosis", "hypotheses", d=diagnosis)


def diagnosis_caption(diagnosis: Mapping[str, Any]) -> str:
    """Caption the figure of a diagnosis."""
    curves, changed = [], False
    for shown in wording.displayed_residuals(diagnosis):
        before, after = (
            max((abs(x) for x in shown[k] if x is not None), default=None) for k in ("before_deg", "after_deg")
        )
        same = shown["before_deg"] == shown["after_deg"]
        curves.append((shown["covariate"], before, before if same else after))
        changed |= not same
    curves = [curve for curve in curves if curve[0].startswith(wording.TURN_PREFIX)] or curves
    parts = [entry["composition"] for entry in diagnosis["findings"] if entry.get("composition")]
    composed = [(entry["acts_on"], effect_formula(**entry)) for entry in parts]
    return words.caption("diagnosis", "diagnosis", d=diagnosis, curves=curves, changed=changed, composed=composed)
